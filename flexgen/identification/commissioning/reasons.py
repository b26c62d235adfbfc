"""One reason for a fit that is far from its datasheet: a payload, a scale of positions or torques.

A wrong number that the fit holds near the file, or a scale that it does not have, hides in many
others that move a little each. At the minimum, with the information A of the records and the
changes z in units of the deviations of the priors, priors that are shifted by D p have the
objective

    c(p) - c(0) = p' I p - 2 p' s,      s = D' z,      I = D' (1 - (A + 1)^-1) D,

so that p = I^-1 s explains s' I^-1 s of it. A reason is named where it explains most of what
priors that are wide would, and no other number explains more.

Source: C. R. Rao, Proc. Cambridge Philosophical Society 44, 1948 (score test).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from flexgen.base.errors import FlexgenError
from flexgen.identification.commissioning.motion_block import Motion
from flexgen.identification.commissioning.unknowns import Unknowns
from flexgen.identification.estimator.score import LEAST_TAIL, Explanation, Limit
from flexgen.identification.rigid import rigid_regressor
from flexgen.identification.rigid.missing_springs import without
from flexgen.identification.rigid.payload_test import NOT_TESTED, PayloadTest
from flexgen.identification.rigid.rigid_body import identify_rigid
from flexgen.model.elements import RobotModel

SURE = 4.0  # standard deviations
FAR = 3.0  # tolerances of the datasheet by which a number has to be wrong
SHARE = 0.5  # of the objective of what wide priors remove that a reason explains
AS_GOOD = 6.0  # loss of the objective by which a reason is more likely than another one
INFLATED = 2.0  # variance of the errors of a model over that of noise
WIDE = 3.0  # wide priors over those of the datasheet
# Prior of a shift, in tolerances: a reason without any effect stays at zero.
WEAK = 100.0
HIDDEN = 0.25  # part of the mass of the payload that is stated where records do not show it
POSITIONS = "the scale of the measured positions"
TORQUES = "the scale of all torques"


@dataclass(frozen=True)
class Reasons:
    """``found``, the best first; ``limits`` below which a wrong payload is not visible."""

    found: tuple[Explanation, ...] = ()
    limits: tuple[Limit, ...] = ()


NO_REASONS = Reasons()


@dataclass(frozen=True)
class _Candidate:
    """Shifts of priors (n, m), ``columns``, for a step of one; ``is_log``: a step is that of the
    logarithm.
    """

    name: str
    columns: np.ndarray
    held: np.ndarray
    unit: str
    is_log: bool = False

    @property
    def is_reported(self) -> bool:
        """Whether the number is one that the user states: not of bodies, which are fitted."""
        return not _is_of_body(self.name) or self.name.startswith("payload.")

    def value(self, step: np.ndarray) -> np.ndarray:
        """The value with a step."""
        if self.is_log:
            return np.asarray(self.held * np.exp(step))
        return np.asarray(self.held + step)


def find_reasons(unknowns: Unknowns, A: np.ndarray, z: np.ndarray) -> Reasons:
    """Test all reasons at a minimum.

    Parameters
    ----------
    unknowns : Unknowns
    A : array (n, n)
        Information of the records, in units of the priors.
    z : array (n,)
        Changes from the file over the deviations of the priors.
    """
    M = np.eye(len(z)) - np.linalg.inv(A + np.eye(len(z)))
    stated = _find_stated(unknowns)
    own = M[np.ix_(stated, stated)] + np.eye(len(stated)) / WIDE**2
    excess = float(z[stated] @ np.linalg.solve(own, z[stated]))
    rows = []
    limits = []
    for one in _candidates(unknowns):
        D = one.columns
        size = (D**2).sum(axis=0)
        I = D.T @ M @ D + np.diag(size) / WEAK**2  # noqa: E741
        s = D.T @ z
        step = np.linalg.solve(I, s)
        gain = float(s @ step)
        is_far = bool(np.sqrt(((D @ step) ** 2).max()) > FAR)
        rows.append((gain, is_far, one, step))
        if one.name == "payload.mass":
            sd = float(1.0 / np.sqrt(I[0, 0]))
            limit = one.held[0] * np.expm1(min(SURE * np.sqrt(INFLATED) * sd, 20.0))
            if limit > HIDDEN * one.held[0]:
                limits.append(Limit(one.name, float(limit), one.unit))
    best = max((row[0] for row in rows), default=0.0)
    found = []
    for gain, is_far, one, step in sorted(rows, key=lambda row: -row[0]):
        tail = chi2.sf(gain / INFLATED, len(step)) / 2
        score = float(norm.isf(max(tail, LEAST_TAIL)))
        share = min(gain / max(excess, 1e-300), 1.0)
        is_likely = gain > best - AS_GOOD and one.is_reported
        if is_far and score > SURE and share > SHARE and is_likely:
            held = tuple(one.held.tolist())
            value = tuple(one.value(step).tolist())
            left = "the tolerances of the datasheet leave"
            found.append(Explanation(one.name, held, value, one.unit, score, share, left))
    named = [reason.name for reason in found]
    return Reasons(tuple(found), tuple(one for one in limits if one.name not in named))


def check_payload_of(robot: RobotModel, motions: Sequence[Motion]) -> PayloadTest:
    """Whether the torques of slow motions contradict the payload, of a robot whose bearings and
    links are rigid; not tested where there is none, or where a rigid robot cannot follow.
    """
    stiff = robot
    for element in robot.elements:
        for dof in element.dofs:
            if dof.gear is None and dof.spring is not None:
                stiff = without(stiff, dof.name)
    inverse = np.linalg.inv(robot.eta)
    try:
        recorded = [
            rigid_regressor.Motion(
                motion.trajectory.time,
                motion.trajectory["q_m"] @ inverse.T,
                motion.trajectory["tau_m"],
            )
            for motion in motions
        ]
        return identify_rigid(stiff, recorded, parts=0).payload if recorded else NOT_TESTED
    except (FlexgenError, ArithmeticError, np.linalg.LinAlgError):
        return NOT_TESTED


def _find_stated(unknowns: Unknowns) -> np.ndarray:
    """Indices of the numbers that the file states within narrow tolerances: not of springs."""
    parts = unknowns.parts
    every = np.arange(parts.size)
    springs = [k for k, u in enumerate(unknowns.vector.unknowns) if not _is_of_body(u.name)]
    model = np.delete(every[parts.model], springs)
    return np.concatenate([model, every[parts.zeros], every[parts.lengths], every[parts.trackers]])


def _is_of_body(name: str) -> bool:
    return name.rpartition(".")[2].startswith(("mass", "com_", "inertia"))


def _candidates(unknowns: Unknowns) -> Iterator[_Candidate]:
    """Masses, centers of mass and lengths one by one; the scales of positions and torques."""
    parts = unknowns.parts
    names = unknowns.names
    count = parts.size
    scale = 1.0 / unknowns.sd
    model = range(*parts.model.indices(count))
    groups: dict[str, list[int]] = {}
    for k in model:
        body, _, kind = names[k].rpartition(".")
        if kind.startswith("com_"):
            groups.setdefault(f"{body}.com", []).append(k)
        elif kind == "mass":
            groups.setdefault(names[k], []).append(k)
    for k in range(*parts.lengths.indices(count)):
        groups.setdefault(names[k], []).append(k)
    units = {unknown.name: unknown.unit for unknown in unknowns.places}
    for name, at in groups.items():
        columns = np.zeros((count, len(at)))
        columns[at, range(len(at))] = scale[at]
        is_mass = name.endswith(".mass")
        held = np.exp(unknowns.start[at]) if is_mass else unknowns.start[at]
        unit = "kg" if is_mass else units.get(name, "m")
        yield _Candidate(name, columns, held, unit, is_mass)
    heavy = [k for k in model if names[k].rpartition(".")[2].startswith(("mass", "inertia"))]
    heavy = [k for k in heavy if unknowns.vector.unknowns[k - parts.model.start].scale == "log"]
    if heavy:
        columns = np.zeros((count, 1))
        columns[heavy, 0] = scale[heavy]
        yield _Candidate(TORQUES, columns, np.ones(1), "", True)
    places = _places(unknowns)
    if np.count_nonzero(places) > 1:
        # lengths of the file that are all too long by a part: positions that are too small
        yield _Candidate(POSITIONS, (places * scale)[:, None], np.ones(1), "", True)


def _places(unknowns: Unknowns) -> np.ndarray:
    """Change (n,) of lengths and trackers where all are larger by a part."""
    parts = unknowns.parts
    out = np.zeros(parts.size)
    elements = {element.name: element for element in unknowns.robot.elements}
    for k in range(*parts.lengths.indices(parts.size)):
        name, _, axis = unknowns.names[k].rpartition(".")
        if name in elements and axis in "xyz":
            origin = elements[name].origin
            place = np.array(origin.rotation).T @ np.array(origin.position)
            out[k] = place["xyz".index(axis)]
    tool = unknowns.robot.tool
    at = parts.trackers.start
    for sensor in unknowns.sensors:
        if parts.trackers.stop > parts.trackers.start:
            place = np.array(sensor.position, float)
            if sensor.place == "tool" and tool is not None:
                place = place + np.array(tool.position)
            out[at : at + 3] = place
            at += 3
    return out
