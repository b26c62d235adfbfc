"""Picture of the rooms of flexgen, drawn from the imports of their modules.

A wing is a room that only the rooms in front import. Arrows that follow from others are left out,
and those of the front.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs" / "rooms.svg"
FRONT = ("cli", "views")  # what a user sees: they may import everything
# the margin is for the labels
MARGIN = 70
ROW = 64
HEIGHT = 30
GAP = 14
LETTER = 7.6
COLORS = {"front": "#f3d9b1", "wing": "#cfe3f5", "middle": "#dcebd2"}


def graph_of(arrows: Iterable[tuple[str, str]], single: set[str]) -> dict[str, set[str]]:
    """Rooms and what they import, without the modules outside of folders."""
    graph: dict[str, set[str]] = {}
    for here, there in arrows:
        if here in single or there in single:
            continue
        graph.setdefault(here, set())
        graph.setdefault(there, set())
        if here != there:
            graph[here].add(there)
    return graph


def reduced(graph: dict[str, set[str]]) -> dict[str, set[str]]:
    """Without the arrows that follow from others."""

    @cache
    def below(room: str) -> set[str]:
        return set().union(*({x} | below(x) for x in graph[room]))

    return {
        room: {x for x in seen if not any(x in below(y) for y in seen - {x})}
        for room, seen in graph.items()
    }


def rows_of(graph: dict[str, set[str]]) -> list[list[str]]:
    """Rooms by rows from the ground up: a room stands above all that it imports; then the wings,
    then the front.
    """
    wings = [
        room
        for room in graph
        if room not in FRONT and not any(room in graph[x] for x in graph if x not in FRONT)
    ]
    rank: dict[str, int] = {}

    def place(room: str) -> int:
        if room not in rank:
            rank[room] = 1 + max((place(x) for x in graph[room]), default=-1)
        return rank[room]

    middle = [room for room in graph if room not in (*FRONT, *wings)]
    top = 1 + max(place(room) for room in middle)
    rows = [sorted(room for room in middle if rank[room] == k) for k in range(top)]
    half = (len(wings) + 1) // 2
    return [
        *rows,
        sorted(wings)[:half],
        sorted(wings)[half:],
        sorted(room for room in FRONT if room in graph),
    ]


def svg(graph: dict[str, set[str]]) -> str:
    """The picture as text."""
    rows = rows_of(graph)
    kinds = {room: "middle" for row in rows[:-3] for room in row}
    kinds |= dict.fromkeys([*rows[-3], *rows[-2]], "wing") | dict.fromkeys(rows[-1], "front")
    at: dict[str, tuple[float, float, float]] = {}
    sizes = [[LETTER * len(room) + 22 for room in row] for row in rows]
    spans = [sum(row) + GAP * (len(row) - 1) for row in sizes]
    width = round(max(spans) + 2 * MARGIN)
    height = ROW * len(rows)
    for k, row in enumerate(rows):
        x = (width - spans[k]) / 2
        for room, size in zip(row, sizes[k], strict=True):
            at[room] = (x, height - ROW * (k + 1) + 10, size)
            x += size + GAP
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}"',
        ' font-family="sans-serif" font-size="13">',
        '<rect width="100%" height="100%" fill="white"/>',
    ]
    for room, seen in sorted(reduced(graph).items()):
        for other in sorted(seen if room not in FRONT else ()):
            (x, y, size) = at[room]
            (x2, y2, size2) = at[other]
            a = x + size / 2
            b = y + HEIGHT
            c = x2 + size2 / 2
            d = y2
            bend = (d - b) / 2
            lines.append(
                f'<path d="M{a:.0f} {b:.0f} C{a:.0f} {b + bend:.0f} {c:.0f} {d - bend:.0f} '
                f'{c:.0f} {d:.0f}" fill="none" stroke="#888" stroke-width="1"/>'
            )
    for room, (x, y, size) in sorted(at.items()):
        lines.append(
            f'<rect x="{x:.0f}" y="{y:.0f}" width="{size:.0f}" height="{HEIGHT}" rx="5" '
            f'fill="{COLORS[kinds[room]]}" stroke="#555"/>'
        )
        lines.append(
            f'<text x="{x + size / 2:.0f}" y="{y + 20:.0f}" text-anchor="middle">{room}</text>'
        )
    for k, label in ((len(rows) - 1, "front"), (len(rows) - 2, "wings"), (0, "middle")):
        lines.append(f'<text x="8" y="{height - ROW * (k + 1) + 30}" fill="#777">{label}</text>')
    return "\n".join([*lines, "</svg>", ""])


def graph() -> dict[str, set[str]]:
    """The rooms of the source as it is."""
    import test_architecture as rules

    texts = rules.sources()
    single = {
        rules.room(name)
        for name in texts
        if (ROOT / "flexgen" / f"{rules.room(name)}.py").is_file()
    } | {""}
    arrows = [
        (rules.room(found.module), rules.room(found.target))
        for found in rules.inner(rules.all_imports(texts))
    ]
    return graph_of([x for x in arrows if x[0] not in ("", "__main__")], single)


def picture() -> str:
    """Their picture."""
    return svg(graph())
