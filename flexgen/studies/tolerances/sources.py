"""Sources of uncertainty: uncertain numbers of a model, and robots drawn from them.

A source is a number of the model, or some that change together: all numbers of a spring, or mass
and inertia of a body. Source i of value p_i has the relative error

    x_i = s_i sum_j L_ij z_j,   p_i (1 + x_i),   z_j independent, normal, of variance 1,
    s_i: its standard deviation

A number whose standard deviation is above `WEAK` is drawn log-normally, with the median of the
file and the same ratio of standard deviation to mean: it stays positive. Centers of mass and
products of inertia have any sign and are drawn normally. A mass that is added to
the payload may be negative, down to none. The delay of the drives is a time [s] by which the
torques are later than the loop knows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from flexgen.base.errors import ArgumentError
from flexgen.base.spec.parts import Tolerances
from flexgen.dynamics.mechanics.parameters import Parameter, select
from flexgen.feedback.loop.plants import FORCES
from flexgen.model.elements import RobotModel
from flexgen.model.friction import bristled_motors, hysteretic_joints

# relative standard deviation; a normal number of this one is negative once in 3.5 million
WEAK = 0.2
PAYLOAD = "payload.mass"
LOST = "lost_motion"
DELAY = "delay"
SIGNED = ("com_x", "com_y", "com_z", "inertia_xy", "inertia_yz", "inertia_xz")
NONE = -1
ROUNDING = 1e-9  # relative to the largest eigenvalue of a correlation matrix


@dataclass(frozen=True)
class Sources:
    """Sources of uncertainty of a model.

    Attributes
    ----------
    names : tuple of str (n,)
    kinds : tuple of str (n,)
        ``stiffness``, ``damping``, ``friction``, ``masses``, ``motor_inertia``, ``lost_motion``,
        ``payload``, ``delay`` or ``parameters``.
    sd : array (n,)
        Relative standard deviations, of the payload [kg], of the delay [s].
    root : array (n, m)
        Rows of length 1: errors of the sources, over their standard deviations, from independent
        ones.
    parameters : tuple of Parameter (n_p,)
        The numbers of the model.
    owner : array (n_p,)
        The source of each; `NONE`: none.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    sd: np.ndarray
    root: np.ndarray
    parameters: tuple[Parameter, ...]
    owner: np.ndarray

    @property
    def nominal(self) -> np.ndarray:
        """The values of the file, (n_p,)."""
        return np.array([parameter.value for parameter in self.parameters])

    @property
    def added(self) -> np.ndarray:
        """Which sources are added to their number, (n,); the others multiply it."""
        return np.array([kind in ("payload", DELAY) for kind in self.kinds])

    @property
    def signed(self) -> np.ndarray:
        """Which sources are single numbers of any sign, (n,): centers of mass, products of
        inertia.
        """
        owned = {
            int(k)
            for k, p in zip(self.owner, self.parameters, strict=True)
            if p.name.rpartition(".")[2] in SIGNED
        }
        single = np.array([kind == "parameters" for kind in self.kinds])
        return single & np.array([k in owned for k in range(len(self.names))])

    @property
    def springs(self) -> np.ndarray:
        """Which sources are stiffnesses, (n,)."""
        stiff = {
            k
            for k, p in zip(self.owner, self.parameters, strict=True)
            if p.name.endswith(".stiffness")
        }
        return np.array([k in stiff for k in range(len(self.names))])

    def errors(self, z: np.ndarray) -> np.ndarray:
        """Relative errors, of the payload [kg], of the delay [s], from independent normal numbers
        ``z`` (robots, m).
        """
        x: np.ndarray = z @ self.root.T
        log_sd = np.sqrt(np.log1p(self.sd**2))
        linear = self.added | self.signed
        x = np.where((self.sd > WEAK) & ~linear, np.expm1(x * log_sd), x * self.sd)
        lowest = np.where(linear, -np.inf, -1.0)
        for k, parameter in zip(self.owner, self.parameters, strict=True):
            if k != NONE and self.kinds[k] == "payload":
                lowest[k] = -parameter.value
        return np.maximum(x, lowest)

    @property
    def directions(self) -> np.ndarray:
        """Derivatives of the numbers with respect to the errors of the sources, (n_p, n)."""
        out = np.zeros((len(self.owner), len(self.names)))
        slopes = np.where(self.added[self.owner], 1.0, self.nominal) * (self.owner != NONE)
        out[np.arange(len(self.owner)), self.owner] = slopes
        return out

    def values(self, errors: np.ndarray) -> np.ndarray:
        """The numbers (..., n_p) of robots with these errors (..., n)."""
        own = errors[..., self.owner] * (self.owner != NONE)
        added = self.added[self.owner]
        return np.where(added, self.nominal + own, self.nominal * (1.0 + own))


def of_equations(sources: Sources, model: RobotModel) -> Sources:
    """The sources with those of their numbers that equations of motion without states have.

    If there is none, the mass of the payload, which no source changes.
    """
    kept = [
        k
        for k, p in enumerate(sources.parameters)
        if ".hysteresis." not in p.key and ".lugre." not in p.key
    ]
    if not kept:
        return replace(sources, parameters=select(model, [PAYLOAD]), owner=np.array([NONE]))
    return replace(
        sources, parameters=tuple(sources.parameters[k] for k in kept), owner=sources.owner[kept]
    )


def sources_of(model: RobotModel, given: Tolerances) -> Sources:
    """The sources of a model with these tolerances.

    Raises
    ------
    ArgumentError
        The model does not have a number with one of the names, or the correlation has a negative
        eigenvalue.
    """
    named = select(model, given.parameters) if given.parameters else ()
    missing = [name for name in given.parameters if name not in {p.name for p in named}]
    if missing or len(named) != len(given.parameters):
        raise ArgumentError(
            f"uncertainty, parameters: given {(missing or given.parameters)[0]!r}, expected "
            "names of single numbers, such as q1.stiffness"
        )
    taken = {parameter.name for parameter in named}
    rows: list[tuple[str, str, float, list[Parameter]]] = []
    for kind, sd, groups in _kinds(model, given):
        for name, parameters in groups.items():
            free = [
                p
                for p in parameters
                if p.name not in taken and (p.value != 0.0 or kind == "payload")
            ]
            if sd > 0.0 and (free or kind == DELAY):
                rows.append((name, kind, sd, free))
    uncertain = [p for p in named if given.sd[given.parameters.index(p.name)] > 0.0]
    order = [given.parameters.index(p.name) for p in uncertain]
    rows += [
        (p.name, "parameters", given.sd[k], [p]) for k, p in zip(order, uncertain, strict=True)
    ]
    if not rows:
        raise ArgumentError(
            f"uncertainty of {model.title}: given standard deviations of no number that the "
            "model has, expected a table [uncertainty] in the model file, such as stiffness = "
            "0.1"
        )
    every = select(model, [p.name for row in rows for p in row[3]])
    owner = {p.name: k for k, row in enumerate(rows) for p in row[3]}
    root = _root(rows, given, order)
    names, kinds, spreads, _ = zip(*rows, strict=True)
    return Sources(
        names, kinds, np.array(spreads), root, every, np.array([owner[p.name] for p in every])
    )


def _kinds(
    model: RobotModel, given: Tolerances
) -> list[tuple[str, float, dict[str, list[Parameter]]]]:
    """Kind, standard deviation and the numbers of each source of that kind by its name.

    A source may change several numbers alike: all of a spring, mass and inertia of a body. The
    delay is a source without a number of the model.
    """
    bodies = [element.name for element in model.elements if element.body.mass > 0.0]
    inertias = [f"inertia_{axes}" for axes in ("xx", "yy", "zz", "xy", "yz", "xz")]
    springs: dict[str, list[Parameter]] = {}
    for parameter in _forces(model, "stiffness"):
        springs.setdefault(f"{parameter.name.partition('.')[0]}.stiffness", []).append(parameter)
    masses = {
        f"{body}.mass": list(select(model, [f"{body}.{x}" for x in ("mass", *inertias)]))
        for body in bodies
    }
    single = {
        kind: {p.name: [p] for p in _forces(model, kind)} for kind in ("damping", "friction")
    }
    rotors = {
        f"{m.name}.inertia": list(select(model, [f"{m.name}.inertia"])) for m in model.motors
    }
    payload = {PAYLOAD: list(select(model, [PAYLOAD]))}
    lost: dict[str, list[Parameter]] = {}
    for parameter in select(model, [LOST]) if hysteretic_joints(model) else ():
        lost.setdefault(f"{parameter.name.partition('.')[0]}.{LOST}", []).append(parameter)
    for motor in bristled_motors(model):
        single["friction"][f"{motor}.lugre"] = list(
            select(model, [f"{motor}.lugre_{x}" for x in ("coulomb", "static")])
        )
    found = {
        "stiffness": springs,
        **single,
        "masses": masses,
        "motor_inertia": rotors,
        LOST: lost,
        "payload": payload,
    }
    found |= {DELAY: {DELAY: []}}
    return [(kind, getattr(given, kind), groups) for kind, groups in found.items()]


def _forces(model: RobotModel, kind: str) -> list[Parameter]:
    """The numbers of a kind that forces are proportional to; without gaps and speeds of laws."""
    try:
        return [parameter for parameter in select(model, [kind]) if parameter.unit in FORCES]
    except ArgumentError:  # the model has none
        return []


def _root(
    rows: Sequence[tuple[str, str, float, list[Parameter]]], given: Tolerances, order: list[int]
) -> np.ndarray:
    """The rows of `Sources.root`: one column for each independent cause, common to a kind or
    single, and columns of the correlation given.

    ``rows``: name, kind, standard deviation and numbers of each source; ``order``: index in
    `given` of the last ones.
    """
    n = len(rows)
    columns = []
    for k, (_, kind, _, _) in enumerate(rows):
        if kind in given.common:
            if kind not in [row[1] for row in rows[:k]]:
                columns.append(np.array([1.0 if row[1] == kind else 0.0 for row in rows]))
        elif kind != "parameters" or not given.correlation:
            columns.append(np.eye(n)[k])
    if given.correlation and order:
        size = len(order)
        count = len(given.parameters)
        matrix = np.array(given.correlation).reshape(count, count)[np.ix_(order, order)]
        values, vectors = np.linalg.eigh(matrix)
        if values[0] < -ROUNDING * values[-1]:
            raise ArgumentError(
                f"uncertainty, correlation: given a matrix with the eigenvalue {values[0]:.3g}, "
                "expected none below 0"
            )
        part = np.zeros((n, size))
        part[n - size :] = vectors * np.sqrt(np.clip(values, 0.0, None))
        columns += list(part.T)
    return np.array(columns).T
