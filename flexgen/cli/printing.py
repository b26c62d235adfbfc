"""Printed text of the command line: aligned tables, numbers, JSON without NaN, results of the verbs.

The texts are rendered from JSON data, as `plain` makes it: a number that is not finite is None.
"""

from __future__ import annotations

import difflib
import math
import shutil
import sys
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any

from flexgen.display import plain

if TYPE_CHECKING:
    from flexgen.inversion.solution import Solution
    from flexgen.simulation.result import Simulation

GAP = "  "  # between columns
NARROW = 16  # characters; columns of text are not wrapped to less

_width: ContextVar[int | None] = ContextVar("width", default=None)


def number(value: Any, digits: int = 4) -> str:
    """A value as text; a dash for None and for numbers that are not finite."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        if not math.isfinite(value):
            return "-"
        return f"{value:.0f}" if 1e3 <= abs(value) < 1e7 else f"{value:.{digits}g}"
    return str(value)


def suggestion(word: str, known: Iterable[str]) -> str:
    """``; did you mean 'solve'?`` if a known word is similar; else an empty text."""
    similar = difflib.get_close_matches(word, list(known), 1)
    return f"; did you mean {similar[0]!r}?" if similar else ""


def duration(seconds: float) -> str:
    """A time as text: ``4 s``, ``3 min``."""
    return f"{max(seconds, 1.0):.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"


def one_line(text: str) -> str:
    """The text with each run of white space replaced by one space."""
    return " ".join(text.split())


def complex_number(pair: Sequence[float | None]) -> str:
    """A root ``[re, im]`` as text; a complex root includes its conjugate."""
    re, im = pair
    if re is None or im is None:
        return "-"
    return number(float(re)) if im == 0 else f"{number(float(re))} +/- {number(abs(float(im)))}i"


def roots(pairs: Iterable[Sequence[float | None]]) -> list[str]:
    """Roots as texts: one text per conjugate pair, equal roots counted."""
    texts = [complex_number(pair) for pair in pairs if pair[1] is None or pair[1] >= 0]
    counted: dict[str, int] = {}
    for text in texts:
        counted[text] = counted.get(text, 0) + 1
    return [text if n == 1 else f"{text} ({n} times)" for text, n in counted.items()]


@contextmanager
def fit_tables(width: int | None) -> Iterator[None]:
    """Within: tables have at most this number of characters per line; None: any number."""
    token = _width.set(width)
    try:
        yield
    finally:
        _width.reset(token)


def terminal_width() -> int | None:
    """Characters per line of standard output; None if it is not a terminal."""
    try:
        return shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    except (AttributeError, ValueError, OSError):  # no stream, or a closed one
        return None


def paragraph(text: str) -> str:
    """The text, wrapped to the width of the terminal."""
    width = _width.get()
    return text if width is None else textwrap.fill(text, width, break_on_hyphens=False)


def table(rows: Sequence[Sequence[Any]], head: Sequence[str] = ()) -> str:
    """A table with aligned columns; columns of numbers (and dashes) are right-aligned.

    On a terminal it is never wider than the terminal: long texts are wrapped; if that is not enough, the last columns
    are left out and named below the table.
    """
    width = len(head) if head else max((len(row) for row in rows), default=0)
    right = [bool(rows) and all(_is_figure(row[k]) for row in rows) for k in range(width)]
    lines = [[number(cell) for cell in row] for row in rows]
    if head:
        lines.insert(0, list(head))
    widths = [max((len(line[k]) for line in lines), default=0) for k in range(width)]
    kept = _narrow(widths, right, _width.get())
    if head:
        lines.insert(1, ["-" * w for w in widths])
    text = "\n".join(_wrap_row(line, widths, right, kept) for line in lines)
    if kept == width:
        return text
    left_out = ", ".join(head[kept:]) or f"{width - kept} columns"
    return f"{text}\n{paragraph(f'(left out: {left_out}; a wider terminal, a pipe or --json shows all)')}"


def _narrow(widths: list[int], right: Sequence[bool], limit: int | None) -> int:
    """Reduce the widths of texts in place, the widest first, until a line fits; the number of columns that do."""
    if limit is None:
        return len(widths)

    def excess(count: int) -> int:
        return sum(widths[:count]) + len(GAP) * (count - 1) - limit

    texts = [k for k in range(len(widths)) if not right[k]]
    while texts and excess(len(widths)) > 0:
        widest = max(texts, key=lambda k: widths[k])
        if widths[widest] <= NARROW:
            break
        widths[widest] -= 1
    kept = len(widths)
    while kept > 1 and excess(kept) > 0:
        kept -= 1
    if kept == 1 and excess(1) > 0:
        widths[0] = max(limit, 1)
    return kept


def _wrap_row(line: Sequence[str], widths: Sequence[int], right: Sequence[bool], kept: int) -> str:
    """One row as text, of several lines where a cell is wrapped."""
    cells = [
        textwrap.wrap(cell, w, break_on_hyphens=False) if len(cell) > w else [cell]
        for cell, w in zip(line[:kept], widths, strict=False)
    ]
    out = []
    for k in range(max(map(len, cells), default=0)):
        parts = [cell[k] if k < len(cell) else "" for cell in cells]
        padded = [x.rjust(w) if r else x.ljust(w) for x, w, r in zip(parts, widths, right, strict=False)]
        out.append(GAP.join(padded).rstrip())
    return "\n".join(out)


def _is_figure(value: Any) -> bool:
    return value is None or (isinstance(value, int | float) and not isinstance(value, bool))


def figures(rows: Iterable[tuple[str, Any, str]]) -> str:
    """A table of quantities, values and units; rows without a value are left out."""
    kept = [(what, number(value), unit) for what, value, unit in rows if value is not None]
    return table(kept, ("quantity", "value", "unit"))


# --- results of the verbs --------------------------------------------------------------------------------------------

Row = tuple[str, Any, str]  # quantity, value, unit


def description_text(data: dict[str, Any]) -> str:
    """The description of a model as text, from the data of `flexgen.describe`."""
    name = data["name"]
    parts = [
        paragraph(name + (f"@{data['variant']}" if data["variant"] else "") + f": {one_line(data['description'])}"),
        figures(
            [
                ("file", data["file"], ""),
                ("motors n_m", data["n_m"], ""),
                ("actuated arm coordinates n_g", data["n_g"], ""),
                ("non-actuated arm coordinates n_e", data["n_e"], ""),
                ("degrees of freedom", data["dof"], ""),
                ("mass of the arm", sum(body["mass"] for body in data["bodies"]), "kg"),
                ("motor coupling", data["motor_coupling"], ""),
                ("output", _output(data["output"]), ""),
            ]
        ),
        table(
            [[c["name"], c["unit"], c["element"], c["type"], _drive(c), *_stiffness(c)] for c in data["coordinates"]],
            ("coordinate", "unit", "element", "type", "drive or spring", "stiffness", "damping"),
        ),
        table(
            [
                [
                    m["name"],
                    ", ".join(m["drives"]),
                    ", ".join(_ratio(*row) for row in zip(m["ratio"], m["ratio_unit"], strict=True)),
                    m["inertia"],
                    m["torque_max"],
                    m["speed_max"],
                ]
                for m in data["motors"]
            ],
            ("motor", "drives", "ratio", "inertia kg m^2", "torque max N m", "speed max rad/s"),
        ),
    ]
    if data["sensors"]:
        rows = [
            [s["name"], s["type"], s["place"], ", ".join(s["channels"]), s["unit"], s["noise"]] for s in data["sensors"]
        ]
        parts.append(table(rows, ("sensor", "type", "place", "channels", "unit", "noise")))
    if data["moves"]:
        rows = [[m["name"], m["type"], m["duration"], m["smoothness"]] for m in data["moves"]]
        parts.append(table(rows, ("move", "type", "duration s", "smoothness")))
    if data["variants"]:
        parts.append(paragraph("variants: " + ", ".join(f"{name}@{variant}" for variant in data["variants"])))
    if data["source"]:
        parts.append(paragraph(f"source: {one_line(data['source'])}"))
    return "\n\n".join(parts)


def _ratio(ratio: float, unit: str) -> str:
    """A gear ratio; of a translation with its unit."""
    return number(float(ratio)) + ("" if unit == "rad/rad" else f" {unit}")


def _output(output: dict[str, Any]) -> str:
    axes = f" {output['axes']}" if output["axes"] else ""
    return f"{output['type']}{axes} ({output['size']} scalars)"


def _drive(coordinate: dict[str, Any]) -> str:
    """The gear of a coordinate, or its spring if no motor drives it."""
    gear, spring = coordinate.get("gear"), coordinate.get("spring")
    if gear is not None:
        elastic = gear["type"] != "rigid"
        return f"elastic gear, {gear['spring']['type']}, {gear['side']} side" if elastic else "rigid gear"
    return "beam bending" if spring is None else f"spring, {spring['type']}"


def _stiffness(coordinate: dict[str, Any]) -> tuple[str | None, str | None]:
    """Stiffness (of a nonlinear spring the low one) and damping, on the side given in the model file."""
    holder = coordinate.get("gear") or coordinate
    spring = holder.get("spring")
    if spring is None:
        return None, None
    stiffness, damping = float(spring.get("stiffness", spring.get("low"))), float(holder.get("damping") or 0.0)
    force, unit = ("N m", "rad") if coordinate["unit"] == "rad" or holder.get("side") == "motor" else ("N", "m")
    return f"{number(stiffness)} {force}/{unit}", f"{number(damping)} {force} s/{unit}"


def analysis_text(data: dict[str, Any], coordinates: Sequence[tuple[str, str]], motors: Sequence[str]) -> str:
    """The result of `flexgen.analyze` as text; needs the names and units of coordinates and the names of motors."""
    equilibrium = table(
        [[name, q, unit] for (name, unit), q in zip(coordinates, data["pose"], strict=True)],
        ("coordinate", "equilibrium", "unit"),
    )
    torques = table(
        [[name, tau, "N m"] for name, tau in zip(motors, data["motor_torque_Nm"], strict=True)],
        ("motor", "torque", "unit"),
    )
    rows = zip(data["modes_hz"] or [], data.get("modes_damping") or [], strict=True)
    modes = table([[k, f, d] for k, (f, d) in enumerate(rows, 1)], ("mode", "frequency Hz", "damping ratio"))
    zeros, inner = roots(data["zeros"] or []), data["zeros_motor"] or []
    notches = sorted(math.hypot(*root) / (2 * math.pi) for root in inner if None not in root and root[1] > 0)
    verdict = figures(
        [
            ("phase of the output", data["phase"], ""),
            ("zeros of the output", ", ".join(zeros) if zeros else "none", "1/s" if zeros else ""),
            ("zeros, motor torque to motor angle", ", ".join(map(number, notches)) or None, "Hz"),
            ("time constant of the slowest unstable zero", data["unstable_time_constant_s"] or None, "s"),
            ("structural index", data["structural_index"], ""),
            ("preview required for exact tracking", data["preview_s"], "s"),
            *_dae_rows(data),
        ]
    )
    warnings = "\n".join(paragraph(f"note: {line}") for line in (data.get("solvability") or {}).get("warnings", ()))
    along = data.get("zeros_along_path")
    along_text = paragraph(f"along the path, {along['verdict']}") if along else ""
    return "\n\n".join(part for part in (equilibrium, torques, modes, verdict, warnings, along_text) if part)


def _dae_rows(data: dict[str, Any]) -> list[Row]:
    """Rows of the DAE of inverse dynamics, if it was analyzed."""
    structure, ranks, solvable = (data.get(key) or {} for key in ("structure", "kunkel_mehrmann", "solvability"))
    rows: list[Row] = []
    if structure.get("blocks"):
        sizes = ", ".join(str(len(block["equations"])) for block in structure["blocks"])
        rows.append(("equations per block of the DAE", sizes, ""))
        rows.append(("structural analysis at this pose", structure["verdict"], ""))
    if ranks.get("verdict") == "regular":
        rows.append(("strangeness index; a, d, v", f"{ranks['mu']}; {ranks['a']}, {ranks['d']}, {ranks['v']}", ""))
        rows.append(("singular value gap of the rank decisions", ranks["gap"], "relative"))
    elif ranks:
        rows.append(("strangeness index", ranks.get("verdict"), ""))
    if solvable.get("singular_values"):
        rows.append(("solvability, smallest singular value", min(solvable["singular_values"]), "relative"))
    if solvable.get("controllability") is not None:
        rows.append(("controllability, smallest singular value", solvable["controllability"], "relative"))
    return rows


def _small_row(what: str, value: float | None, unit: str) -> Row:
    """A row of a small length [m] or angle [rad]: below 1e-3 in millionths, else in thousandths."""
    if value is None:
        return what, None, ""
    return (what, 1e3 * value, f"m{unit}") if value >= 1e-3 else (what, 1e6 * value, f"u{unit}")


def figure_rows(result: Solution | Simulation) -> list[Row]:
    """Label, value and unit of the figures of a result; lengths and angles in millionths or thousandths."""
    rows = []
    for label, value, unit, _ in result.figures():
        value = plain(value)
        rows.append(
            _small_row(label, value, unit) if unit in ("m", "rad") else (label, None if value == "" else value, unit)
        )
    return rows
