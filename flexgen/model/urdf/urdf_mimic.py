"""Joints of a URDF file that follow others, by <mimic> or by an overlay: what their position
is.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from flexgen.base.spec.tables import Table, bare, show
from flexgen.model.urdf.urdf import Joint, Mimic, Urdf, among, key


@dataclass(frozen=True)
class Motion:
    """The position of a joint [rad or m]: ``offset + sum factor q``.

    ``joints``: factors of joints by their names in the URDF file; ``coordinates``: factors of
    coordinates of the model.
    A joint that is fixed has neither.
    """

    line: int
    offset: float = 0.0
    joints: Mapping[str, float] = field(default_factory=dict)
    coordinates: Mapping[str, float] = field(default_factory=dict)
    own: bool = False  # a coordinate: the only joint is itself

    @property
    def fixed(self) -> bool:
        """Whether the joint does not move."""
        return not self.joints and not self.coordinates

    @property
    def follows(self) -> bool:
        """Whether a mechanism moves the joint."""
        return not self.own and not self.fixed

    def scale(self, mimic: Mimic) -> Motion:
        """The motion of a joint that follows the one with this motion."""
        return Motion(
            mimic.line,
            mimic.factor * self.offset + mimic.offset,
            {name: mimic.factor * x for name, x in self.joints.items()},
            {name: mimic.factor * x for name, x in self.coordinates.items()},
        )


class Motions:
    """Motions of all joints of a URDF file; a chain of <mimic> is folded to its first joint.

    Parameters
    ----------
    urdf : Urdf
    locked : mapping
        Positions of joints that are fixed [rad or m]; joints that follow them are fixed too.
    tables : mapping
        Tables of the joints in the overlay: one with ``mimic`` replaces the factors of the file,
        one with a gear or a
        spring makes a coordinate of the joint.
    passive : collection of str
        Joints that closed loops move: they follow no other joint.
    """

    def __init__(
        self,
        urdf: Urdf,
        locked: Mapping[str, float],
        tables: Mapping[str, Table] | None = None,
        passive: Collection[str] = (),
    ) -> None:
        """``locked``: joints that keep a value [rad, m]; ``tables``: those of the model file, by
        joint.
        """
        self.urdf = urdf
        self.passive = passive
        self.locked = locked
        self.tables = tables or {}
        self._found: dict[str, Motion] = {}

    def __call__(self, joint: Joint) -> Motion:
        """The motion of a joint; ModelError where it follows no joint of the file, or itself."""
        chain: list[tuple[str, Mimic]] = []
        names = {joint.name}
        here = joint
        while (motion := self._begin(here)) is None:
            mimic = self.urdf.mimic(here)
            assert mimic is not None
            chain.append((here.name, mimic))
            here = self._leader(here, mimic)
            if here.name in names:
                given = f"a joint that mimics {show(here.name)}, which follows it"
                expected = f"a joint that does not follow it {_lock(joint)}"
                self.urdf.fail(mimic.line, f"{key('joint', joint.name)}.mimic", given, expected)
            names.add(here.name)
        for name, mimic in reversed(chain):
            motion = motion.scale(mimic)
            self._found[name] = motion
        return motion

    def _begin(self, joint: Joint) -> Motion | None:
        """The motion of a joint that needs no other one, or that is known; else None."""
        line = joint.node.line
        table = self.tables.get(joint.name)
        if joint.name in self._found:
            return self._found[joint.name]
        if joint.name in self.locked:
            return Motion(line, self.locked[joint.name])
        if not joint.movable:
            return Motion(line)
        if joint.name in self.passive:
            return Motion(line, joints={joint.name: 1.0}, own=True)
        mimic = self.urdf.mimic(joint)
        factors = None if table is None else table.table("mimic")
        if factors is not None:
            numbers = {name: factors.number(name) for name in factors.entries}
            return Motion(line, 0.0 if mimic is None else mimic.offset, coordinates=numbers)
        if mimic is None or (table is not None and ("gear" in table or "spring" in table)):
            return Motion(line, joints={joint.name: 1.0}, own=True)
        return None

    def _leader(self, joint: Joint, mimic: Mimic) -> Joint:
        """The joint that another one follows."""
        leader = self.urdf.joints.get(mimic.leader)
        if leader is None:
            given = f"a joint that mimics {show(mimic.leader)}"
            expected = f"{among(mimic.leader, self.urdf.joints)} {_lock(joint)}"
            self.urdf.fail(mimic.line, f"{key('joint', joint.name)}.mimic", given, expected)
        return leader


def _lock(joint: Joint) -> str:
    """Key of an overlay that locks the joint instead, for a message."""
    return f"(or in the overlay: [urdf] lock = {{ {bare(joint.name)} = 0.0 }})"


def check_leaders(urdf: Urdf, joint: Joint, motion: Motion, moving: Mapping[str, Joint]) -> None:
    """Refuse a joint that follows one which is neither in the chain, ``moving``, nor locked."""
    for name in motion.joints:
        if name not in moving:
            child = urdf.joints[name].child
            given = f"a joint that follows {show(name)}, which is outside the chain"
            expected = (
                f"a joint of the chain (in the overlay: [urdf] branches = [{show(child)}] moves "
                f"it too, lock = {{ {bare(name)} = 0.0 }} fixes both, lock = {{ "
                f"{bare(joint.name)} = 0.0 }} only this one)"
            )
            urdf.fail(motion.line, f"{key('joint', joint.name)}.mimic", given, expected)
