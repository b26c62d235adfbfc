"""Signals of a robot at one instant as CasADi expressions with names.

The symbols of an instant are the coordinates ``y = (q_a, q_me)`` with ``q_me`` the motors behind
elastic gears, and, where the path parameter is free, ``s`` after them; their velocities and
accelerations; the motor torques; the time; the durations of the phases and further unknown
numbers. All signals are expressions in these symbols, SI units.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import casadi as ca

from flexgen.base.errors import ArgumentError
from flexgen.codegen.recursion.functions import fast_function
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.motor_harmonics import friction_function
from flexgen.dynamics.mechanics.output_columns import output_labels, output_units
from flexgen.model.abilities import obstacle

COMPARED = (ca.OP_LE, ca.OP_LT, ca.OP_EQ)


@dataclass(frozen=True)
class Signal:
    """A named expression (k,) with a label and a unit for each entry, and what it is."""

    name: str
    value: ca.SX
    labels: tuple[str, ...]
    units: tuple[str, ...]
    doc: str


class Signals(Mapping[str, ca.SX]):
    """All signals of one instant by name; ``signals["tau_m[m1]"]`` is one entry.

    Attributes
    ----------
    y, dy, ddy : SX (n,)
        Coordinates of the transcription with their derivatives in time.
    tau : SX (n_m,)
    time : SX
    reference : SX (n_t,)
        Target of the output, a number at each instant; only with ``tracked``.
    """

    def __init__(
        self, equations: Equations, *, with_path: bool, tracked: bool, name: str = ""
    ) -> None:
        """``with_path``: the path parameter is the last coordinate of y; ``tracked``: there is a
        reference of the output; ``name``: added to those of symbols, as phases differ.
        """
        model = equations.model
        self.equations = equations
        self.with_path = with_path
        n = model.dof + with_path
        self.y, self.dy, self.ddy = (ca.SX.sym(f"{x}{name}", n) for x in ("y", "dy", "ddy"))
        self.tau = ca.SX.sym(f"tau_m{name}", model.n_m)
        self.time = ca.SX.sym(f"t{name}")
        n_t = model.output.target_size
        self.reference = ca.SX.sym(f"reference{name}", n_t if tracked else 0)
        self._signals: dict[str, Signal] = {}
        for signal in self._make():
            self._signals[signal.name] = signal

    @property
    def symbols(self) -> list[ca.SX]:
        """Coordinates, velocities, accelerations, torques, time and reference."""
        return [self.y, self.dy, self.ddy, self.tau, self.time, self.reference]

    def __iter__(self) -> Iterable[str]:  # type: ignore[override]
        return iter(self._signals)

    def __len__(self) -> int:
        return len(self._signals)

    def __getitem__(self, name: str) -> ca.SX:
        return self.find(name)[0].value[self.find(name)[1]]

    def find(self, name: str) -> tuple[Signal, list[int]]:
        """The signal of a name and the entries that are meant; ArgumentError for an unknown
        name.
        """
        if not isinstance(name, str):
            raise ArgumentError(
                f"signal: given {name!r}, expected a name, one of {', '.join(self._signals)}"
            )
        base, bracket, label = name.partition("[")
        if base not in self._signals:
            raise ArgumentError(
                f"signal: given {name!r}, expected {_suggest(base, self._signals)}"
            )
        signal = self._signals[base]
        if not bracket:
            return signal, list(range(len(signal.labels)))
        label = label.rstrip("]")
        if label not in signal.labels:
            raise ArgumentError(
                f"signal {base}: given entry {label!r}, expected {_suggest(label, signal.labels)}"
            )
        return signal, [signal.labels.index(label)]

    def _motors(self, part: ca.SX) -> ca.SX:
        """Quantity of all motors (n_m,) from that of the coordinates."""
        model = self.equations.model
        geared = ca.mtimes(ca.SX(ca.DM(model.eta)), part[list(model.i_g)])
        at = {j: model.n_a + k for k, j in enumerate(model.i_m)}
        return ca.vertcat(*[part[at[j]] if j in at else geared[j] for j in range(model.n_m)])

    def _make(self) -> Iterable[Signal]:
        """All signals of the robot: coordinates, torques, powers, deflections, tool, output and
        time, each with labels and units.
        """
        equations = self.equations
        model = self.equations.model
        n_a = self.equations.model.n_a
        names_a = tuple(c.name for c in model.coordinates)
        units_a = tuple(c.unit for c in model.coordinates)
        names_m = tuple(m.name for m in model.motors)
        names_g, names_e = (tuple(names_a[i] for i in part) for part in (model.i_g, model.i_e))
        arm = [part[:n_a] for part in (self.y, self.dy, self.ddy)]
        for name, value, end in zip(("q_a", "v_a", "a_a"), arm, ("", "/s", "/s^2"), strict=True):
            yield Signal(name, value, names_a, tuple(u + end for u in units_a), "arm coordinates")
        motors = [self._motors(part) for part in (self.y, self.dy, self.ddy)]
        for name, value, end in zip(
            ("q_m", "v_m", "a_m"), motors, ("", "/s", "/s^2"), strict=True
        ):
            yield Signal(
                name, value, names_m, ("rad" + end,) * model.n_m, "motor angles, motor side"
            )
        yield Signal("tau_m", self.tau, names_m, ("N m",) * model.n_m, "motor torques, motor side")
        yield Signal(
            "power_m", self.tau * motors[1], names_m, ("W",) * model.n_m, "power of the motors"
        )
        gear = ca.mtimes(ca.inv(ca.DM(model.eta)), motors[0]) - arm[0][list(model.i_g)]
        yield Signal(
            "gear_deflection",
            gear,
            names_g,
            tuple(units_a[i] for i in model.i_g),
            "eta^-1 q_m - q_g",
        )
        elastic = ca.vertcat(ca.SX(0, 1), *[arm[0][i] for i in model.i_e])
        of_e = tuple(units_a[i] for i in model.i_e)
        yield Signal("elastic_deflection", elastic, names_e, of_e, "coordinates without motor")
        p, R = equations.function("forward_kinematics")(arm[0])
        J = fast_function(equations, "jacobian") or equations.function("jacobian")
        v = ca.mtimes(J(arm[0]), arm[1])
        yield Signal(
            "tool_position", p, ("x", "y", "z"), ("m",) * 3, "origin of the tool, world axes"
        )
        yield Signal(
            "tool_rotation",
            ca.vec(R),
            tuple(f"{r}{c}" for c in "xyz" for r in "xyz"),
            ("1",) * 9,
            "columns",
        )
        yield Signal(
            "tool_velocity",
            v[:3],
            ("x", "y", "z"),
            ("m/s",) * 3,
            "of the tool's origin, world axes",
        )
        yield Signal(
            "tool_turn_rate",
            v[3:],
            ("x", "y", "z"),
            ("rad/s",) * 3,
            "angular velocity, world axes",
        )
        y = equations.function("output")(arm[0])
        yield Signal(
            "output", y, output_labels(model)["y_ref"], output_units(model), "declared output"
        )
        yield Signal(
            "time", self.time, ("time",), ("s",), "time from the start of the first phase"
        )
        if self.with_path:
            for name, part in (("s", self.y), ("s_rate", self.dy), ("s_acceleration", self.ddy)):
                unit = {"s": "1", "s_rate": "1/s"}.get(name, "1/s^2")
                yield Signal(name, part[-1], (name,), (unit,), "path parameter, 0 to 1")


def residual_of(
    equations: Equations, y: ca.SX, dy: ca.SX, ddy: ca.SX, tau: ca.SX, force: ca.SX | None = None
) -> ca.SX:
    """Equations of motion (n,) in the coordinates (q_a, q_me): zero where the torques cause the
    accelerations.

    ``force`` (6,): on the tool.

    By the recursion where the robot has one, else by the Lagrangian; both are tested against each
    other.
    """
    model = equations.model
    n_a = equations.model.n_a
    pushed, pushing = (equations, []) if force is None else (equations.pushed, [force])
    full = []
    for part in (y, dy, ddy):
        motors = ca.SX.zeros(model.n_m)
        for k, j in enumerate(model.i_m):
            motors[j] = part[n_a + k]
        full += [part[:n_a], motors]
    q_a, q_m, v_a, v_m, a_a, a_m = full
    inverse = (
        fast_function(equations, "inverse_dynamics")
        if obstacle(model, "simplified coupling") is None
        else None
    )
    if inverse is None or len(model.i_m) < model.n_m:
        r_a, r_m = pushed.function("residual")(q_a, v_a, a_a, q_m, v_m, a_m, tau, *pushing)
        return ca.vertcat(r_a, *[r_m[j] for j in model.i_m])
    tau_g = equations.function("gear_torque")(q_a, v_a, q_m, v_m)
    forces = pushed.function("arm_forces")(q_a, v_a, *pushing)
    rows = inverse(q_a, v_a, a_a) - forces
    acting = ca.SX.zeros(n_a)
    acting[list(model.i_g)] = tau_g
    if model.n_e:
        acting[list(model.i_e)] = equations.function("elastic_torque")(q_a, v_a)
    inertia = ca.DM([motor.inertia for motor in model.motors])
    load = ca.mtimes(ca.inv(ca.DM(model.eta)).T, tau_g)
    r_m = inertia * a_m + motor_frictions(equations, v_m, tau_g) + load - tau
    return ca.vertcat(rows - acting, r_m)


def motor_frictions(equations: Equations, v_m: ca.SX, tau_g: ca.SX) -> ca.SX:
    """Friction torques of the motors (n_m,) at their speeds and the torques of the elastic gears,
    arm side.
    """
    carried = ca.mtimes(ca.inv(ca.DM(equations.model.eta)).T, tau_g)
    name, given = friction_function(equations.model, v_m, carried)
    return equations.function(name)(*given)


def split_comparison(expression: ca.SX | ca.MX, what: str) -> tuple[ca.SX | ca.MX, list[bool]]:
    """An expression that shall be <= 0, and which of its entries shall be = 0, from a comparison
    of expressions.
    """
    wrong = (
        f"{what}: given {str(expression)[:60]!r}, expected a comparison such as problem['v_m'] "
        "<= 10, or bounds"
    )
    if isinstance(expression, ca.MX):
        if not (expression.n_dep() == 2 and any(expression.is_op(op) for op in COMPARED)):
            raise ArgumentError(wrong)
        value = ca.vec(ca.densify(expression.dep(0) - expression.dep(1)))
        return value, [expression.is_op(ca.OP_EQ)] * value.numel()
    if not isinstance(expression, ca.SX):
        raise ArgumentError(wrong)
    values = []
    equal = []
    for entry in ca.vertsplit(ca.vec(ca.densify(expression))):
        if not (entry.n_dep() == 2 and any(entry.is_op(op) for op in COMPARED)):
            raise ArgumentError(wrong)
        values.append(entry.dep(0) - entry.dep(1))
        equal.append(bool(entry.is_op(ca.OP_EQ)))
    return ca.vertcat(*values), equal


def _suggest(name: str, known: Iterable[str]) -> str:
    """The text of what was expected: the nearest name first."""
    names = list(known)
    near = difflib.get_close_matches(name, names, 1, 0.5)
    listed = ", ".join(names)
    return f"one of {listed}; did you mean {near[0]!r}?" if near else f"one of {listed}"
