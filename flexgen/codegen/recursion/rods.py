"""Rods with mass as bodies of the tree: the same kinetic energy and weight without line elements.

A uniform rod of mass m whose ends move with v1, v2 has

    T = m/6 (v1.v1 + v1.v2 + v2.v2) = (m/6) v1.v1/2 + (m/6) v2.v2/2 + (2 m/3) v.v/2,

v = (v1 + v2)/2: particles at its ends and at its middle (Simpson's rule). Where a closed loop
leads along the rod, its middle is a point of the tree: half of the stretch behind its direction.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.spec.lines import Anchor, Line
from flexgen.model.elements import Body, Dof, Element, LoopFrame, Placement, RobotModel, Tool

# Distance, relative to the length of the rod, of points that are one.
SAME = 1e-12


@dataclass(frozen=True)
class _Rod:
    """An element that leads from one end of a line to the other: from its origin by rotations,
    then along its ``stretch``, to ``tip`` (3,) [m] in the frame behind the rotations.

    ``stretch`` is None where the length is constant.
    """

    element: Element
    stretch: Dof | None
    tip: np.ndarray


def with_rods_as_bodies(model: RobotModel) -> RobotModel:
    """The model without the masses of those lines along which a closed loop leads: bodies of equal
    motion and weight have them.

    Its coordinates have other numbers, its joints are constant sums of those of the model given.
    """
    elements = list(model.elements)
    parents = dict(model.parents)
    lines = []
    for line in model.lines:
        rod = _find_rod(model, line) if line.mass else None
        if rod is None:
            lines.append(line)
            continue
        lines.append(replace(line, mass=0.0))
        at = [e.name for e in elements].index(rod.element.name)
        made = _split(rod, line, parents[rod.element.name])
        elements[at : at + 1] = made
        parents |= {e.name: e.parent or "" for e in made}
        for end, anchor in (("start", line.start), ("end", line.end)):
            if anchor.element != "base":
                body = Body(mass=line.mass / 6.0)
                name = f"{line.name}_{end}"
                origin = Placement(anchor.position)
                elements.append(Element(name, (), origin, body=body, parent=anchor.element))
                parents[name] = anchor.element
    if len(elements) == len(model.elements):
        return model
    fixed = tuple(replace(e, parent=parents[e.name]) for e in elements)
    tool = Tool(model.tool.position, model.tool.rotation, model.tip)
    return replace(model, elements=fixed, lines=tuple(lines), tool=tool)


def _split(rod: _Rod, line: Line, parent: str) -> list[Element]:
    """The rod's element with a particle at the middle, at half of the stretch."""
    element = rod.element
    middle = Body(mass=2.0 * line.mass / 3.0, com=tuple((rod.tip / 2.0).tolist()))
    name = f"{line.name}_middle"
    if rod.stretch is None:
        made = Element(name, element.dofs, element.origin, body=middle, parent=parent)
        return [made, replace(element, dofs=(), origin=Placement(), parent=name)]
    halves = [
        Dof(f"{rod.stretch.name}_{k}", "translation", rod.stretch.axis, mimic=half)
        for k, half in enumerate([((rod.stretch.name, 0.5),)] * 2)
    ]
    turns = element.dofs[:-1]
    first = Element(name, (*turns, halves[0]), element.origin, body=middle, parent=parent)
    rest = replace(element, dofs=(halves[1],), origin=Placement(), parent=name)
    return [first, rest]


def _find_rod(model: RobotModel, line: Line) -> _Rod | None:
    """The element that leads from one end of a line to the other in a closed loop."""
    elements = {element.name: element for element in model.elements}
    for loop in model.loops:
        for tip, far in ((loop.start, loop.end), (loop.end, loop.start)):
            element = elements.get(tip.element)
            if loop.type != "point" or element is None:
                continue
            rod = _leads(element, tip)
            if rod is None:
                continue
            near = Anchor(model.parents[element.name], tuple(element.origin.position))
            ends = (line.start, line.end)
            other = Anchor(far.element, tuple(far.position))
            if _same(ends, (near, other), rod) or _same(ends, (other, near), rod):
                return rod
    return None


def _leads(element: Element, tip: LoopFrame) -> _Rod | None:
    """The `_Rod` of an element whose rotations are about its origin, with at most one translation
    behind them.
    """
    kinds = [dof.type for dof in element.dofs]
    stretch = element.dofs[-1] if kinds[-1:] == ["translation"] else None
    turns = kinds[:-1] if stretch is not None else kinds
    mixed = any(dof.mimic for dof in element.dofs)
    if element.beam is not None or mixed or any(kind != "rotation" for kind in turns):
        return None
    at = np.array(element.link.position) + np.array(element.link.rotation) @ np.array(tip.position)
    return _Rod(element, stretch, at)


def _same(ends: Sequence[Anchor], others: Sequence[Anchor], rod: _Rod) -> bool:
    """Whether two pairs of ends are one."""
    size = max(float(np.abs(rod.tip).max()), 1e-300)
    return all(
        a.element == b.element
        and np.abs(np.array(a.position) - np.array(b.position)).max() <= SAME * size
        for a, b in zip(ends, others, strict=True)
    )
