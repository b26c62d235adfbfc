"""What the emitted library offers: its functions, their ports and equations, sizes, names and status codes.

One table, rendered as the C header, the manifest and, through the manifest, the Python wrapper.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from flexgen.errors import ArgumentError, BuildError
from flexgen.model.elements import RobotModel
from flexgen.ports import Port, identifier_problem

if TYPE_CHECKING:
    from flexgen.codegen.program import Program
    from flexgen.mechanics.parameters import Parameter

ABI_VERSION = 2
PRECISIONS = ("double", "single")


@dataclass(frozen=True)
class Status:
    """What an emitted function returns: its name and value in C, its meaning, and the exception that Python raises."""

    name: str
    code: int
    text: str
    exception: str = ""  # a class of flexgen.errors


STATUSES = (
    Status("OK", 0, "success"),
    Status("NULL_ARGUMENT", -1, "an argument is a null pointer", "ArgumentError"),
    Status("INPUT_NOT_FINITE", -2, "an input is not finite, and so is the result", "ArgumentError"),
    Status("RESULT_NOT_FINITE", -3, "the result is not finite: a singular or an extreme state", "SolverError"),
    Status("BAD_COUNT", -4, "the number of points is negative", "ArgumentError"),
)


@dataclass(frozen=True)
class FunctionSpec:
    """One function of the library.

    Parameters
    ----------
    name : str
        Noun; in C ``<library>_<name>``.
    summary, equation : str
        One sentence and the equation, for the header.
    inputs, outputs : tuple of Port
        The arrays in the order of the arguments.
    extents : dict of str to tuple of str
        For each port its sizes in symbols (``"n_a"``) or digits, for the header.
    program : Program
        The mathematics, with the ports as dense arguments.
    """

    name: str
    summary: str
    equation: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    extents: dict[str, tuple[str, ...]]
    program: Program


@dataclass(frozen=True)
class LibrarySpec:
    """The library of one model.

    Parameters
    ----------
    name : str
        First part of every symbol, type and macro: the name of the model, with its variant.
    functions : tuple of FunctionSpec
        In the order of the header.
    sizes : dict of str to int
        ``n_a``, ``n_g``, ``n_e``, ``n_m``, ``n_x``.
    coordinates, coordinate_units : tuple of str
        Names and units ("rad" or "m") of ``q_a`` in chain order.
    motors : tuple of str
        Names of the motors, the order of ``q_m``.
    states : tuple of str
        What the entries of the state x of a linearisation are.
    home : dict of str to tuple of float
        ``q_a`` and ``q_m`` of the home pose with relaxed springs; every other input is zero there.
    digest : str
        SHA-256 of the model's data.
    gravity : tuple of float
        Acceleration of gravity in world axes [m/s^2].
    gears : tuple of tuple of (str, float)
        For each motor the coordinates it drives and the ratios: its row of ``eta``.
    rotor_inertias : tuple of float
        Of each motor, motor side [kg m^2].
    precision : str
        ``"double"`` or ``"single"``: the type of every number in the library.
    parameters : tuple of Parameter
        Numbers that are arguments of the functions instead of constants.
    """

    name: str
    functions: tuple[FunctionSpec, ...]
    sizes: dict[str, int]
    coordinates: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    motors: tuple[str, ...]
    states: tuple[str, ...]
    home: dict[str, tuple[float, ...]]
    digest: str
    gravity: tuple[float, ...]
    gears: tuple[tuple[tuple[str, float], ...], ...]
    rotor_inertias: tuple[float, ...]
    precision: str = "double"
    parameters: tuple[Parameter, ...] = ()

    @property
    def interface(self) -> str:
        """SHA-256 of the names and shapes of all functions, such as ``mass_matrix(q_a[3])(M[3,3])`` per line.

        The loader computes it from the manifest and compares it with what the library says.
        """

        def listed(ports: tuple[Port, ...]) -> str:
            return "".join(f"{port.name}[{','.join(map(str, port.shape))}]" for port in ports)

        lines = [f"{f.name}({listed(f.inputs)})({listed(f.outputs)})\n" for f in self.functions]
        return hashlib.sha256("".join(lines).encode()).hexdigest()


@dataclass(frozen=True)
class _Row:
    """A row of the table: name, summary, equation, names of inputs and outputs in `_PORTS`."""

    name: str
    summary: str
    equation: str
    inputs: str
    outputs: str


_TABLE = (
    _Row(
        "forward_kinematics",
        "Position and rotation matrix of the tool in the world.",
        "p_world = p + R p_tool",
        "q_a",
        "p R",
    ),
    _Row(
        "jacobian",
        "Jacobian of the tool: its linear, then its angular velocity, in world axes.",
        "(v_tool, omega_tool) = J(q_a) v_a",
        "q_a",
        "J",
    ),
    _Row("mass_matrix", "Mass matrix of the arm, without rotors.", "T = v_a' M(q_a) v_a / 2", "q_a", "M"),
    _Row("bias", "Coriolis, centripetal and gravity forces of the arm.", "h = c(q_a, v_a) + g(q_a)", "q_a v_a", "h"),
    _Row("gravity", "Gravity forces of the arm.", "g = dU(q_a)/dq_a", "q_a", "g"),
    _Row(
        "inverse_dynamics",
        "Forces that the arm needs for a given motion, without friction and springs.",
        "tau_a = M(q_a) a_a + c(q_a, v_a) + g(q_a)",
        "q_a v_a a_a",
        "tau_a",
    ),
    _Row(
        "inverse_dynamics_derivatives",
        "First derivatives of the inverse dynamics.",
        "d tau_a = dtau_dq d q_a + dtau_dv d v_a + dtau_da d a_a",
        "q_a v_a a_a",
        "dtau_dq dtau_dv dtau_da",
    ),
    _Row(
        "arm_forward_dynamics",
        "Accelerations of the arm under given forces on its coordinates, without rotors, friction and springs: the "
        "inverse of inverse_dynamics.",
        "a_a = M(q_a)^-1 (tau_a - c(q_a, v_a) - g(q_a))",
        "q_a v_a tau_a",
        "a_a",
    ),
    _Row(
        "arm_forward_derivatives",
        "First derivatives of the arm's forward dynamics.",
        "d a_a = da_dq d q_a + da_dv d v_a + da_dtau d tau_a,  da_dtau = M^-1",
        "q_a v_a tau_a",
        "da_dq da_dv da_dtau",
    ),
    _Row(
        "forward_dynamics",
        "Accelerations of arm and motors under the motors' torques, with springs, dampers and friction. "
        "Entries of q_m and v_m behind rigid gears are ignored; those of a_m are filled in.",
        "M a_a + c + g = tau_a,  J_m a_m + f(v_m) + eta^-T tau_g = tau_m",
        "q_a v_a q_m v_m tau_m",
        "a_a a_m",
    ),
    _Row(
        "linearize",
        "Linearisation of the forward dynamics in the state x = (q_a, q_m, v_a, v_m), "
        "of the motors only those behind elastic gears.",
        "d(dx/dt) = A dx + B d(tau_m)",
        "q_a v_a q_m v_m tau_m",
        "A B",
    ),
)

FUNCTIONS = tuple(row.name for row in _TABLE)

# <name>.h must not be found instead of a header of C, lib<name>.a not instead of a library of the system, <name>.c and
# <name>.h not be another file of the directory or a device of Windows.
_TAKEN = frozenset(
    """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic
    stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype
    alloca arm_neon dirent dlfcn endian features fcntl immintrin malloc memory omp poll pthread regex resource sched
    semaphore strings syslog termios unistd x86intrin
    c m dl rt util gcc gcc_s gomp iomp5 omp5 stdc anl resolv crypt nsl asan tsan ubsan
    example aux con nul prn com1 com2 com3 com4 lpt1 lpt2 lpt3
    """.split()
)

# name: sizes, unit (templates: see _unit), meaning
_PORTS: dict[str, tuple[tuple[str, ...], str, str]] = {
    "q_a": (("n_a",), "{q}", "arm coordinates in chain order"),
    "v_a": (("n_a",), "{q}/s", "arm velocities"),
    "a_a": (("n_a",), "{q}/s^2", "arm accelerations"),
    "q_m": (("n_m",), "rad", "motor angles, motor side"),
    "v_m": (("n_m",), "rad/s", "motor speeds, motor side"),
    "a_m": (("n_m",), "rad/s^2", "motor accelerations, motor side"),
    "tau_m": (("n_m",), "N m", "motor torques, motor side"),
    "tau_a": (("n_a",), "{tau}", "forces on the arm coordinates, arm side"),
    "h": (("n_a",), "{tau}", "bias forces, arm side"),
    "g": (("n_a",), "{tau}", "gravity forces, arm side"),
    "M": (("n_a", "n_a"), "{M}", "mass matrix, symmetric"),
    "p": (("3",), "m", "position of the tool, world axes"),
    "R": (("3", "3"), "1", "rotation matrix, columns: axes of the tool in the world"),
    "J": (("6", "n_a"), "mixed", "rows 0-2 in m/s, rows 3-5 in rad/s, per unit of the column's velocity"),
    "dtau_dq": (("n_a", "n_a"), "mixed", "unit of the row's force per unit of the column's coordinate"),
    "dtau_dv": (("n_a", "n_a"), "mixed", "unit of the row's force per unit of the column's velocity"),
    "dtau_da": (("n_a", "n_a"), "{M}", "mass matrix, symmetric"),
    "da_dq": (("n_a", "n_a"), "mixed", "unit of the row's acceleration per unit of the column's coordinate"),
    "da_dv": (("n_a", "n_a"), "mixed", "unit of the row's acceleration per unit of the column's velocity"),
    "da_dtau": (("n_a", "n_a"), "mixed", "inverse of the mass matrix, symmetric"),
    "A": (("n_x", "n_x"), "mixed", "unit of the row's x/s per unit of the column's x"),
    "B": (("n_x", "n_m"), "mixed", "unit of the row's x/s per N m"),
}


def _unit(template: str, units: Sequence[str]) -> tuple[str, str]:
    """Unit of a port, and what to add to its meaning where the coordinates' units differ."""
    kinds = sorted(set(units))
    rad = {"q": "rad", "tau": "N m", "M": "kg m^2"}
    metre = {"q": "m", "tau": "N", "M": "kg"}
    if "{" not in template or kinds == ["rad"]:
        return template.format(**rad), ""
    if kinds == ["m"]:
        return template.format(**metre), ""
    if template == "{M}":
        return "mixed", "; kg m^2, kg m or kg"
    return "mixed", f"; {template.format(**rad)} for rotations, {template.format(**metre)} for translations"


def library_name(model: RobotModel) -> str:
    """First part of every symbol of the model's library: its name, with the variant; BuildError if C forbids it."""
    name = f"{model.name}_{model.variant}" if model.variant else model.name
    problem = identifier_problem(name)
    if problem is None and name.lower() in _TAKEN:
        problem = "a name that no header, file or library beside it has"
    if problem is not None:
        raise BuildError(f"name of the model, with its variant: given {name!r}, expected {problem}")
    return name


def model_digest(model: RobotModel) -> str:
    """SHA-256 of the model's data: canonical text and every field, but not the file that it came from.

    The fields too, as ``dataclasses.replace`` changes them and leaves the text behind.
    """
    return hashlib.sha256(f"{model.text}\n{replace(model, file='', text='')!r}".encode()).hexdigest()


def chosen_functions(names: Sequence[str] | None) -> tuple[str, ...]:
    """The functions asked for (all of them for None), in the order of the table; ArgumentError for an unknown one."""
    if names is None:
        return FUNCTIONS
    if isinstance(names, str):
        raise ArgumentError(f"functions: given the text {names!r}, expected a sequence of names")
    for name in names:
        if name not in FUNCTIONS:
            raise ArgumentError(f"functions: given {name!r}, expected some of {', '.join(FUNCTIONS)}")
    if not names:
        raise ArgumentError("functions: given none, expected at least one name, or None for all of them")
    return tuple(name for name in FUNCTIONS if name in names)


def library_spec(equations: Any, functions: Sequence[str] | None = None, *, precision: str = "double") -> LibrarySpec:
    """What the library of a model offers.

    Parameters
    ----------
    equations : Equations
        Of the model; with parameters, these become arguments of the functions that depend on them.
    functions : sequence of str, optional
        Names of the functions wanted; all of `FUNCTIONS` where not given.
    precision : str
        ``"double"`` or ``"single"``.

    Returns
    -------
    LibrarySpec

    Raises
    ------
    BuildError
        Where a name is not fit for C, or a function is not the one its ports describe.
    """
    if precision not in PRECISIONS:
        raise ArgumentError(f"precision: given {precision!r}, expected one of {', '.join(PRECISIONS)}")
    model: RobotModel = equations.model
    names = chosen_functions(functions)
    sizes = {"n_a": model.n_a, "n_g": model.n_g, "n_e": model.n_e, "n_m": model.n_m, "n_x": 2 * model.dof}
    for what in ("n_a", "n_m"):
        if sizes[what] == 0:
            raise BuildError(f"model {model.name}: given {what} = 0, expected at least one coordinate and one motor")
    parameters: tuple[Parameter, ...] = tuple(getattr(equations, "parameters", ()))
    if parameters:
        sizes["n_p"] = len(parameters)
    coordinates = tuple(c.name for c in model.coordinates)
    units = tuple(c.unit for c in model.coordinates)
    motors = tuple(m.name for m in model.motors)
    for name in (*coordinates, *motors):
        problem = identifier_problem(name)
        if problem is not None:
            raise BuildError(f"name of a coordinate or motor: given {name!r}, expected {problem}")
    q_a = np.zeros(model.n_a)
    q_a[list(model.i_g)] = model.home
    q_m = model.eta @ q_a[list(model.i_g)]
    half = [*coordinates, *(motors[j] for j in model.i_m)]
    return LibrarySpec(
        name=library_name(model),
        functions=tuple(_function_spec(row, equations, sizes, units) for row in _TABLE if row.name in names),
        sizes=sizes,
        coordinates=coordinates,
        coordinate_units=units,
        motors=motors,
        states=(*half, *(f"d({name})/dt" for name in half)),
        home={"q_a": tuple(float(x) for x in q_a), "q_m": tuple(float(x) for x in q_m)},
        digest=model_digest(model),
        gravity=tuple(float(x) for x in model.gravity),
        gears=tuple(tuple((j, float(r)) for j, r in zip(m.drives, m.ratio, strict=True)) for m in model.motors),
        rotor_inertias=tuple(float(m.inertia) for m in model.motors),
        precision=precision,
        parameters=parameters,
    )


def _function_spec(row: _Row, equations: Any, sizes: dict[str, int], units: Sequence[str]) -> FunctionSpec:
    """One row of the table with its mathematics, checked against the ports."""
    # here, so that a library that is there already needs no CasADi
    from flexgen.codegen.programs import PARAMETERS, needs_parameters, parameters_port, program_of

    ports: dict[str, Port] = {}
    for name in (*row.inputs.split(), *row.outputs.split()):
        extents, template, meaning = _PORTS[name]
        unit, remark = _unit(template, units)
        shape = tuple(sizes[extent] if extent in sizes else int(extent) for extent in extents)
        ports[name] = Port(name, shape, unit, meaning + remark)
    inputs = tuple(ports[name] for name in row.inputs.split())
    outputs = tuple(ports[name] for name in row.outputs.split())
    extents_of = {name: _PORTS[name][0] for name in ports}
    program = program_of(row.name, equations, inputs, outputs)
    if needs_parameters(program):
        inputs = (*inputs, parameters_port(equations))
        extents_of[PARAMETERS] = ("n_p",)
    return FunctionSpec(row.name, row.summary, row.equation, inputs, outputs, extents_of, program)
