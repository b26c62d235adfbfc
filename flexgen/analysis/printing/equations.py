"""Closed-form equations of motion of a small model, through SymPy: to be read, and to check the
numeric ones.

Independent of the CasADi equations (which differentiate the Lagrangian): here the inertia matrix
is put together from the Jacobians of the bodies, the velocity terms from its Christoffel symbols,
gravity from the heights of the centers.

    M = sum_i m_i Jv_i' Jv_i + Jw_i' I_i Jw_i,
    c_i = sum_jk (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i)/2 v_j v_k

Source: L. Sciavicco and B. Siciliano, Modelling and Control of Robot Manipulators, 2000,
chapter 4.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import sympy as sp

from flexgen.analysis.printing import printing
from flexgen.analysis.printing.chain import SymbolicChain, polynomial_ring
from flexgen.analysis.printing.elements import Expr3, Forces, Symbols, chain_steps, placement_steps
from flexgen.analysis.printing.printing import Entry, Name, Row, Section, Sheet
from flexgen.base.errors import ArgumentError
from flexgen.model.abilities import check_ability
from flexgen.model.elements import Coordinate, RobotModel

MAX_COORDINATES = 4


@dataclass(frozen=True)
class SymbolicEquations:
    """Closed-form equations of motion of a model.

        M a_a + S a_m + c + g + friction + drag = tau,      motor_equations[j] = tau_m[j]

    ``tau`` is what springs and dampers do (``torques``), or the free torque of a rigid gear
    (``gear_equations``). With the simplified motor coupling ``S`` is zero and ``M`` without the
    rotors; with the complete one ``M`` has the share of the rotors for motors at rest, and ``c``
    depends on ``v_m`` too.

    Attributes
    ----------
    model : RobotModel
        Where the equations come from.
    q_a, v_a, a_a, tau : tuple of Symbol
        Arm coordinates [rad or m], speeds, accelerations, and torques on the arm side [N m or N].
    q_m, v_m, a_m, tau_m : tuple of Symbol
        Motor coordinates [rad], speeds, accelerations and torques, on the motor side.
    entries : tuple of Entry
        All symbols with unit, meaning, and (parameters) value.
    M, S, c, g, friction, drag : Matrix
        Inertia (n_a, n_a), coupling to the rotors (n_a, n_m); velocity terms, gravity, joint
        friction, drag of the bodies (n_a, 1).
    deflections : dict
        Twist symbols of nonlinear gear springs and their expressions.
    torques : tuple of Expr or None
        Spring and damper torques of elastic gears and non-actuated elements, as they act on the
        arm.
    motor_equations : tuple of Expr
        Left-hand sides; the right-hand sides are ``tau_m``.
    gear_equations : tuple of (Symbol, Expr)
        ``q_m`` of the motors behind rigid gears.
    tool : Matrix
        Position of the tool in the world (3, 1) [m].
    output : Matrix
        What the model's reference prescribes: a combination of coordinates (n_y, 1), or rows of
        ``tool``; of a pose, or with the angle of the tool, its position.
    """

    model: RobotModel
    q_a: tuple[sp.Symbol, ...]
    v_a: tuple[sp.Symbol, ...]
    a_a: tuple[sp.Symbol, ...]
    tau: tuple[sp.Symbol, ...]
    q_m: tuple[sp.Symbol, ...]
    v_m: tuple[sp.Symbol, ...]
    a_m: tuple[sp.Symbol, ...]
    tau_m: tuple[sp.Symbol, ...]
    entries: tuple[Entry, ...] = field(repr=False)
    M: sp.Matrix
    S: sp.Matrix
    c: sp.Matrix
    g: sp.Matrix
    friction: sp.Matrix
    drag: sp.Matrix
    deflections: dict[sp.Symbol, sp.Expr]
    torques: tuple[sp.Expr | None, ...]
    motor_equations: tuple[sp.Expr, ...]
    gear_equations: tuple[tuple[sp.Symbol, sp.Expr], ...]
    tool: sp.Matrix
    output: sp.Matrix

    @cached_property
    def parameters(self) -> dict[sp.Symbol, float]:
        """Values of the parameters, from the model, SI units."""
        return {entry.symbol: entry.value for entry in self.entries if entry.value is not None}

    def function(self, *expressions: sp.Expr | sp.Matrix) -> Callable[..., list[np.ndarray]]:
        """Expressions as a numpy function of ``(q_a, v_a, a_a, q_m, v_m, a_m)``, parameters as in
        the model.

        Arguments that are left out are zero. Torques of springs and dampers are put in for their
        symbols.
        """
        state = [*self.q_a, *self.v_a, *self.a_a, *self.q_m, *self.v_m, *self.a_m]
        known = {
            symbol: torque
            for symbol, torque in zip(self.tau, self.torques, strict=True)
            if torque is not None
        }
        explicit = [sp.sympify(e).xreplace(known).xreplace(self.deflections) for e in expressions]
        compiled = sp.lambdify([*state, *self.parameters], explicit, "numpy", cse=True)
        sizes = [len(self.q_a)] * 3 + [len(self.q_m)] * 3
        values = list(self.parameters.values())

        def evaluate(*arguments: np.ndarray) -> list[np.ndarray]:
            """Values of the printed expressions at arrays q_a, v_a, ...; those left out
            are zero.
            """
            given = [*arguments, *([None] * (6 - len(arguments)))]
            parts = [
                np.zeros(n) if x is None else np.ravel(x).astype(float)
                for x, n in zip(given, sizes, strict=True)
            ]
            return [np.asarray(x, dtype=float) for x in compiled(*np.concatenate(parts), *values)]

        return evaluate

    @cached_property
    def _numeric(self) -> Callable[..., list[np.ndarray]]:
        return self.function(self.M, self.c, self.g)

    def numeric(
        self, q_a: np.ndarray, v_a: np.ndarray, v_m: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers for ``M`` (n_a, n_a), ``c`` (n_a), ``g`` (n_a); ``v_m`` matters in complete
        coupling only.
        """
        M, c, g = self._numeric(q_a, v_a, None, None, v_m)
        return M, c.ravel(), g.ravel()

    def text(self) -> str:
        """The equations as plain text, one entry per line."""
        return printing.text(self._sheet)

    def latex(self) -> str:
        """The equations as a complete LaTeX document."""
        return printing.latex(self._sheet)

    @cached_property
    def _sheet(self) -> Sheet:
        """The equations as a sheet that text and LaTeX are made from: sections with rows, those
        that are all zero left out, and the symbols that occur in them.
        """
        names = {entry.symbol: entry.name for entry in self.entries}
        n_a = len(self.q_a)
        n_m = len(self.q_m)

        def vector(title: str, head: str, values: sp.Matrix) -> list[Section]:
            rows = tuple(Row(head, (i + 1,), value) for i, value in enumerate(values))
            return [Section(title, rows)] if any(value != 0 for value in values) else []

        def name_rows(pairs: list[tuple[sp.Symbol, sp.Expr]]) -> tuple[Row, ...]:
            return tuple(Row("", (), value, names[symbol]) for symbol, value in pairs)

        terms = [("M", "a_a"), ("S", "a_m"), ("c", ""), ("g", ""), ("f", ""), ("r", "")]
        present = [True, any(self.S), any(self.c), any(self.g), any(self.friction), any(self.drag)]
        shown = [term for term, yes in zip(terms, present, strict=True) if yes]
        plain = " + ".join(f"{a} {b}".strip() for a, b in shown) + " = tau"
        formula = " + ".join(rf"{a} \, {b[0]}_{b[2]}" if b else a for a, b in shown) + r" = \tau"
        upper = tuple(
            Row("M", (i + 1, j + 1), self.M[i, j]) for i in range(n_a) for j in range(i, n_a)
        )
        coupling = tuple(
            Row("S", (i + 1, j + 1), self.S[i, j]) for i in range(n_a) for j in range(n_m)
        )
        sections = [
            Section("Equations of the arm", (), plain, formula),
            Section("Inertia M (symmetric)", upper),
        ]
        sections += [Section("Coupling of rotors and arm S", coupling)] if any(self.S) else []
        sections += vector("Coriolis and centrifugal terms c", "c", self.c) + vector(
            "Gravity g", "g", self.g
        )
        sections += vector("Friction f", "f", self.friction) + vector(
            "Drag of the bodies r", "r", self.drag
        )
        given = [
            (symbol, torque)
            for symbol, torque in zip(self.tau, self.torques, strict=True)
            if torque is not None
        ]
        if given:
            sections.append(
                Section("Springs and dampers", name_rows([*self.deflections.items(), *given]))
            )
        if self.gear_equations:
            sections.append(Section("Rigid gears", name_rows(list(self.gear_equations))))
        if self.motor_equations:
            rows = name_rows(list(zip(self.tau_m, self.motor_equations, strict=True)))
            sections.append(Section("Motors", rows))
        sections += self._output_sections()
        used = {
            symbol
            for section in sections
            for row in section.rows
            for symbol in row.value.free_symbols
        }
        used |= {*self.q_a, *self.v_a, *self.a_a, *self.tau, *self.tau_m}
        symbols = tuple(entry for entry in self.entries if entry.symbol in used)
        model = self.model
        title = model.name + (f"@{model.variant}" if model.variant else "")
        return Sheet(title, model.description, model.source, symbols, tuple(sections), self.q_a)

    def _output_sections(self) -> list[Section]:
        """The declared output; the tool's position where it moves, with the rows that are the
        output.
        """
        output = self.model.output
        position = tuple(Row("p", (i + 1,), self.tool[i]) for i in range(3))
        if output.type == "combination":
            unit = "rad or m" if output.unit == "mixed" else output.unit
            rows = tuple(Row("y", (i + 1,), value) for i, value in enumerate(self.output))
            moving = self.tool.free_symbols & set(self.q_a)
            rest = [Section("Position of the tool p", position)] if moving else []
            return [Section(f"Declared output y, {unit}", rows), *rest]
        rows = tuple(position[i] for i in output.tool_rows)
        plain = f"y = ({', '.join(row.text() for row in rows)})"
        formula = rf"y = ({', '.join(row.latex() for row in rows)})"
        if output.type == "tool_pose":
            plain = f"{plain} and the rotation"
            formula = rf"{formula} \text{{ and the rotation}}"
        if output.has_angle:
            angle = f"and the angle of the tool about {output.axis_text} [rad]"
            plain = f"{plain} {angle}"
            formula = rf"{formula} \text{{ {angle}}}"
        return [Section("Position of the tool p, declared output y", position, plain, formula)]


def _coordinate_name(name: str) -> Name:
    match = re.match(r"([a-z])([0-9]+)\Z", name)
    return Name(match[1], (match[2],)) if match else Name("q", (name,), plain=name)


def _subscripts(names: Sequence[Name], coordinates: Sequence[Coordinate]) -> list[tuple[str, ...]]:
    """Subscripts of speeds and torques: the number of a coordinate where it is told by that, else
    its full name.
    """
    texts = {name.text() for name in names}
    shared = [n.subscripts for n in names]
    return [
        (c.name,)
        if shared.count(n.subscripts) > 1 or texts & {f"{x}{n.subscripts[0]}" for x in "va"}
        else n.subscripts
        for n, c in zip(names, coordinates, strict=True)
    ]


def _role(model: RobotModel, coordinate: Coordinate) -> str:
    """Meaning of a coordinate, for the table of symbols."""
    if coordinate.dof is None or coordinate.dof.gear is None:
        return "arm coordinate without a motor"
    motors = " and ".join(motor.name for motor in model.motors if coordinate.name in motor.drives)
    return (
        f"arm coordinate, {'rigid' if coordinate.dof.gear.rigid else 'elastic'} gear to {motors}"
    )


def _gravity(model: RobotModel, symbols: Symbols) -> Expr3:
    """Gravity in the frame of the base, where the equations of motion are put together."""
    pull = np.array(model.base.rotation).T @ np.array(model.gravity)
    pull[np.abs(pull) < 1e-14 * np.abs(pull).max()] = 0.0
    if np.count_nonzero(pull) > 1:
        return symbols.vector(
            "g", "", tuple(pull), "m/s^2", "acceleration of gravity in the frame of the base"
        )
    size = float(np.abs(pull).max())
    name = Name("g", ("0",), plain="g_0")
    strength = (
        symbols.new(name, "m/s^2", "acceleration of gravity", size) if size else sp.Integer(0)
    )
    x, y, z = (strength * int(np.sign(part)) for part in pull)
    return x, y, z


def _output(model: RobotModel, q_a: tuple[sp.Symbol, ...], position: sp.Matrix) -> sp.Matrix:
    """The declared output; of a pose or with an angle its position."""
    output = model.output
    if output.type == "combination":
        weights = [
            [sp.Integer(w) if float(w).is_integer() else sp.Float(w) for w in row]
            for row in output.weights
        ]
        return sp.Matrix(weights) * sp.Matrix(q_a)
    return position.extract(list(output.tool_rows), [0])


def _check_small(model: RobotModel) -> None:
    """ArgumentError where the equations would be too long to be read."""
    numeric = "the numeric (CasADi) equations are available for any model"
    check_ability(model, "symbolic")
    if model.n_a > MAX_COORDINATES:
        raise ArgumentError(
            f"symbolic: given a model with {model.n_a} arm coordinates, expected at most "
            f"{MAX_COORDINATES} for a closed form; {numeric}"
        )


@dataclass(frozen=True)
class _Coordinates:
    """Symbols of the coordinates of arm and motors, as in `SymbolicEquations`.

    ``torque_units``: units of torque and coordinate of each arm coordinate.
    """

    q_a: tuple[sp.Symbol, ...]
    v_a: tuple[sp.Symbol, ...]
    a_a: tuple[sp.Symbol, ...]
    tau: tuple[sp.Symbol, ...]
    q_m: tuple[sp.Symbol, ...]
    v_m: tuple[sp.Symbol, ...]
    a_m: tuple[sp.Symbol, ...]
    tau_m: tuple[sp.Symbol, ...]
    torque_units: list[tuple[str, str]]


def _coordinates(model: RobotModel, symbols: Symbols) -> _Coordinates:
    """New symbols for the coordinates of a model."""
    q_names = [_coordinate_name(c.name) for c in model.coordinates]
    units = [c.unit for c in model.coordinates]
    q_a = tuple(
        symbols.new(n, c.unit, _role(model, c))
        for n, c in zip(q_names, model.coordinates, strict=True)
    )
    subscripts = _subscripts(q_names, model.coordinates)

    def along(head: str, suffix: str, what: str) -> tuple[sp.Symbol, ...]:
        made = zip(subscripts, units, model.coordinates, strict=True)
        return tuple(
            symbols.new(Name(head, sub), u + suffix, f"{what} of {c.name}") for sub, u, c in made
        )

    v_a = along("v", "/s", "speed")
    a_a = along("a", "/s^2", "acceleration")
    torque_units = [("N m", "rad") if unit == "rad" else ("N", "m") for unit in units]
    tau = tuple(
        symbols.new(
            Name("tau", sub),
            u,
            f"torque on {c.name}, arm side" if u == "N m" else f"force on {c.name}",
        )
        for sub, (u, _), c in zip(subscripts, torque_units, model.coordinates, strict=True)
    )
    taken = {sub[0] for sub in subscripts}
    of_motors = [(m.name, "motor") if m.name in taken else (m.name,) for m in model.motors]
    motor_symbols = [
        tuple(
            symbols.new(Name(head, sub), unit, f"{what} of {m.name}")
            for sub, m in zip(of_motors, model.motors, strict=True)
        )
        for head, unit, what in (
            ("q", "rad", "motor angle"),
            ("v", "rad/s", "speed"),
            ("a", "rad/s^2", "acceleration"),
            ("tau", "N m", "torque"),
        )
    ]
    q_m, v_m, a_m, tau_m = motor_symbols
    return _Coordinates(q_a, v_a, a_a, tau, q_m, v_m, a_m, tau_m, torque_units)


def symbolic(model: RobotModel) -> SymbolicEquations:
    """Closed-form equations of motion of a small model, simplified with care.

    Parameters
    ----------
    model : RobotModel
        Rigid bodies only, at most four arm coordinates.

    Returns
    -------
    SymbolicEquations

    Raises
    ------
    ArgumentError
        Where the model has beams, more than four arm coordinates, or equations too long to be
        read.
    """
    _check_small(model)
    symbols = Symbols()
    x = _coordinates(model, symbols)
    rotor = [
        symbols.parameter(
            "J", (m.name,), m.inertia, "kg m^2", f"rotor inertia of {m.name}, motor side"
        )
        for m in model.motors
    ]
    steps = chain_steps(model, symbols, rotor)
    base = placement_steps(symbols, "b", "base", model.base, "pose of the base")
    gravity = _gravity(model, symbols)
    ring = polynomial_ring(symbols, [*base, *steps], x.q_a, [*x.v_a, *x.v_m])
    chain, ground = (SymbolicChain(ring, x.q_a, model.n_m, gravity) for _ in range(2))
    for step in steps:
        chain.element(step)
    for step in base:
        ground.element(step)
    tool = [
        ring.reduce(a + b) for a, b in zip(ground.p, ring.multiply(ground.R, chain.p), strict=True)
    ]

    n = model.n_a
    n_all = model.n_a + model.n_m
    full = [
        [ring.expression(chain.M[min(i, j)][max(i, j)]) for j in range(n_all)] for i in range(n)
    ]
    c = [ring.expression(term) for term in chain.velocity_terms([*x.v_a, *x.v_m])]
    drag = [ring.dot(row, [ring.element(v) for v in x.v_a]) for row in chain.D]
    S = sp.Matrix(n, model.n_m, lambda i, j: full[i][n + j])
    forces = Forces(model, symbols, x.q_a, x.v_a, x.tau, x.q_m, x.v_m, x.torque_units)
    position = sp.Matrix([ring.expression(part) for part in tool])
    carried = S.T * sp.Matrix(x.a_a)
    motors = [
        rotor[j] * x.a_m[j] + carried[j] + c[n + j] + forces.on_motors[j] for j in range(model.n_m)
    ]
    return SymbolicEquations(
        model=model,
        q_a=x.q_a,
        v_a=x.v_a,
        a_a=x.a_a,
        tau=x.tau,
        q_m=x.q_m,
        v_m=x.v_m,
        a_m=x.a_m,
        tau_m=x.tau_m,
        entries=tuple(symbols.entries),
        M=sp.Matrix([row[:n] for row in full]),
        S=S,
        c=sp.Matrix(c[:n]),
        g=sp.Matrix([ring.expression(ring.diff(chain.potential, q)) for q in x.q_a]),
        friction=sp.Matrix(forces.friction),
        drag=sp.Matrix([ring.expression(row) for row in drag]),
        deflections=forces.deflections,
        torques=tuple(forces.torques),
        motor_equations=tuple(motors),
        gear_equations=tuple(forces.gear_equations),
        tool=position,
        output=_output(model, x.q_a, position),
    )
