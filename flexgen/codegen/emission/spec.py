"""Specification of the emitted library: its functions, their ports and equations, sizes, names and
status codes.

One table, rendered as the C header, the manifest and, through the manifest, the Python wrapper.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from flexgen.base.errors import ArgumentError, BuildError
from flexgen.base.spec.parts import KINDS
from flexgen.base.spec.ports import Port, c_name_problem, identifier_problem
from flexgen.codegen.emission.c_functions import offered_c_functions
from flexgen.codegen.emission.clib_types import CFunction, Enum, Struct, signature_of
from flexgen.codegen.emission.digest import model_digest
from flexgen.codegen.emission.interface import DERIVATIVES, ENUMS, FORCE, POSITION, structs_with
from flexgen.codegen.emission.kinematic_functions import (
    FREE,
    KinematicConstants,
    kinematic_constants,
)
from flexgen.codegen.emission.motor_constants import MotorConstants, motor_constants
from flexgen.dynamics.mechanics.ports import port
from flexgen.dynamics.mechanics.signatures import (
    COTANGENT,
    DIFFERENTIATED,
    FUNCTIONS,
    OPTIONAL,
    PORTS,
    PRODUCTS,
    TABLE,
    TANGENT,
    Row,
    function_obstacles,
    split_product,
)
from flexgen.model.abilities import obstacle
from flexgen.model.elements import RobotModel

if TYPE_CHECKING:
    from flexgen.codegen.statements.routine import Routine
    from flexgen.dynamics.mechanics.parameters import Parameter

PrecisionName = Literal["double", "single"]
PRECISIONS: tuple[PrecisionName, ...] = get_args(PrecisionName)


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
    program : Routine
        The mathematics, with the ports as dense arguments.
    """

    name: str
    summary: str
    equation: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    extents: dict[str, tuple[str, ...]]
    program: Routine


@dataclass(frozen=True)
class Constants:
    """Numbers of the model for the public header.

    Parameters
    ----------
    gear_ratio : tuple of tuple of float
        ``eta``, ``q_m = eta q_g``: a row per motor.
    rotor_inertia : tuple of float
        Motor side [kg m^2].
    gear_stiffness : tuple of float
        Arm side, at zero deflection [N m/rad, N/m]; 0 for rigid gears.
    """

    gear_ratio: tuple[tuple[float, ...], ...] = ()
    rotor_inertia: tuple[float, ...] = ()
    gear_stiffness: tuple[float, ...] = ()


@dataclass(frozen=True)
class StreamDefaults:
    """Recommended options of a stream, from the zero dynamics at the home pose.

    Parameters
    ----------
    slowest_unstable_zero : float
        Smallest real part of an unstable zero [1/s]; 0 where there is none.
    look_ahead : float
        Length of the horizon [s].
    period : float
        Time from update to update [s].
    intervals, samples_per_interval : int
    tolerance : float
        Largest relative residual.
    share : float
        Part of a change of the path that is still felt after the look-ahead.
    """

    slowest_unstable_zero: float
    look_ahead: float
    period: float
    intervals: int
    samples_per_interval: int
    tolerance: float
    share: float


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
        ``n_a``, ``n_g``, ``n_e``, ``n_m``, ``n_x``; ``n_y``, ``n_t`` where the model inverts;
        ``n_s`` with sensors; ``n_p`` with parameters; ``n_packed`` with a packed mass matrix.
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
    loops : tuple of str
        Names of the closed loops.
    accuracy : tuple of str
        Standard deviations of the numbers, such as ``"q1.stiffness 3 %"``, where the model file
        has them.
    precision : str
        ``"double"`` or ``"single"``: the type of every number in the library.
    parameters : tuple of Parameter
        Numbers that are arguments of the functions instead of constants.
    per_point, force : bool
        Batches take one vector of them for each point, not one for all; inversion takes forces on
        the output.
    c_functions : tuple of CFunction
        Hand-written functions that come with the library.
    motor_constants : MotorConstants, optional
        Numbers that those of the inversion use.
    kinematic_constants : KinematicConstants, optional
        Numbers that inverse kinematics uses.
    constants : Constants
        Numbers of the public header.
    stream : StreamDefaults, optional
        Recommended options of a stream.
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
    loops: tuple[str, ...] = ()
    accuracy: tuple[str, ...] = ()
    precision: str = "double"
    parameters: tuple[Parameter, ...] = ()
    per_point: bool = False
    force: bool = False
    c_functions: tuple[CFunction, ...] = ()
    motor_constants: MotorConstants | None = None
    kinematic_constants: KinematicConstants | None = None
    constants: Constants = Constants()
    stream: StreamDefaults | None = None

    def declared_in(self, header: str) -> tuple[CFunction, ...]:
        """The hand-written functions of a public header, ``"inversion"`` or
        ``"inverse_kinematics"``.
        """
        return tuple(function for function in self.c_functions if function.header == header)

    @property
    def structs(self) -> tuple[Struct, ...]:
        """The structs that its hand-written functions take or return."""
        used = {a.base for f in self.declared_in("inversion") for a in f.arguments}
        used |= {f.returns for f in self.declared_in("inversion")}
        position = any(f.part == POSITION for f in self.c_functions)
        return tuple(
            struct for struct in structs_with(self.force, position) if struct.name in used
        )

    @property
    def enums(self) -> tuple[Enum, ...]:
        """The enumerations that are members of its structs."""
        used = {field.kind for struct in self.structs for field in struct.fields}
        return tuple(enum for enum in ENUMS if enum.name in used)

    @property
    def inverts(self) -> bool:
        """Whether the library has inverse dynamics along paths."""
        return bool(self.declared_in("inversion"))

    @property
    def interface(self) -> str:
        """SHA-256 of the names and shapes of all functions, such as
        ``mass_matrix(q_a[3])(M[3,3])`` per line.

        The loader computes it from the manifest and compares it with what the library says.
        """

        def join(ports: tuple[Port, ...]) -> str:
            return "".join(f"{port.name}[{','.join(map(str, port.shape))}]" for port in ports)

        lines = [f"{f.name}({join(f.inputs)})({join(f.outputs)})\n" for f in self.functions]
        lines += ["parameters for each point\n"] if self.per_point else []
        lines += [f"{signature_of(struct)}\n" for struct in self.structs]
        lines += [f"{function.signature}\n" for function in self.c_functions]
        return hashlib.sha256("".join(lines).encode()).hexdigest()


# <name>.h must not be found instead of a header of C, lib<name>.a not instead of a library of the
# system, <name>.c and <name>.h not be another file of the directory or a device of Windows.
_TAKEN = frozenset(
    """
    assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal \
stdalign stdarg stdatomic
    stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype
    alloca arm_neon dirent dlfcn endian features fcntl immintrin malloc memory omp poll pthread \
regex resource sched
    semaphore strings syslog termios unistd x86intrin
    c m dl rt util gcc gcc_s gomp iomp5 omp5 stdc anl resolv crypt nsl asan tsan ubsan
    example aux con nul prn com1 com2 com3 com4 lpt1 lpt2 lpt3
    """.split()
)


def library_name(model: RobotModel) -> str:
    """First part of every symbol of the model's library: its name, with the variant; BuildError if
    C forbids it.
    """
    name = f"{model.name}_{model.variant}" if model.variant else model.name
    problem = c_name_problem(name)
    if problem is None and name.lower() in _TAKEN:
        problem = "a name that no header, file or library with it has"
    if problem is not None:
        raise BuildError(
            f"name of the model, with its variant: given {name!r}, expected {problem}"
        )
    return name


def choose_functions(
    names: Sequence[str] | None, model: RobotModel, parts: Sequence[str] = ()
) -> tuple[str, ...]:
    """The functions asked for (all that the model has for None), in the order of the table.

    Where ``"derivatives"`` is one of the optional parts, also the products with their derivatives.

    ArgumentError for one that is unknown, or that the model does not have.
    """
    obstacles = function_obstacles(model)
    offered = tuple(name for name in FUNCTIONS if obstacles[name] is None)
    if names is None:
        return _with_products(offered) if DERIVATIVES in parts else offered
    if isinstance(names, str):
        raise ArgumentError(f"functions: given the text {names!r}, expected a sequence of names")
    for name in names:
        if name not in obstacles:
            known = [each for each in (*FUNCTIONS, *OPTIONAL) if not split_product(each)[1]]
            products = ", ".join(pattern for pattern, _ in PRODUCTS)
            raise ArgumentError(
                f"functions: given {name!r}, expected some of {', '.join(known)}, {products}"
            )
        reason = obstacles[name]
        if reason is not None:
            raise ArgumentError(
                f"functions: given {name!r}, but {reason}; expected some of {', '.join(offered)}"
            )
    if not names:
        raise ArgumentError(
            "functions: given none, expected at least one name, or None for all of them"
        )
    return (
        _with_products(names)
        if DERIVATIVES in parts
        else tuple(row.name for row in TABLE if row.name in names)
    )


def _with_products(names: Sequence[str]) -> tuple[str, ...]:
    """The functions, and the products with derivatives of all that have them; ArgumentError where
    none has.
    """
    products = {
        f"{name}_{kind}" for name in names if name in DIFFERENTIATED for kind in ("jvp", "vjp")
    }
    if not products:
        raise ArgumentError(
            f"parts: given 'derivatives' with the functions {', '.join(names)}, expected one "
            "that is not a derivative itself; choose more functions, or leave it out"
        )
    return tuple(row.name for row in TABLE if row.name in {*names, *products})


def library_spec(
    equations: Any,
    functions: Sequence[str] | None = None,
    *,
    precision: str = "double",
    per_point: bool = False,
    parts: Sequence[str] = (),
) -> LibrarySpec:
    """Specification of the library of a model.

    Parameters
    ----------
    equations : Equations
        Of the model; with parameters, these become arguments of the functions that depend on them.
    functions : sequence of str, optional
        Names of the functions wanted; all of `FUNCTIONS` where not given.
    precision : str
        ``"double"`` or ``"single"``.
    per_point : bool
        Batches take one vector of parameters for each point.
    parts : sequence of str
        Optional parts, of `flexgen.codegen.emission.interface.PARTS`.

    Returns
    -------
    LibrarySpec

    Raises
    ------
    BuildError
        Where a name is not fit for C, or a function is not the one its ports describe.
    """
    if precision not in PRECISIONS:
        raise ArgumentError(
            f"precision: given {precision!r}, expected one of {', '.join(PRECISIONS)}"
        )
    model: RobotModel = equations.model
    names = choose_functions(functions, model)
    parameters: tuple[Parameter, ...] = tuple(getattr(equations, "parameters", ()))
    sizes = _sizes(model, names, len(parameters))
    coordinates = tuple(c.name for c in model.coordinates)
    motors = tuple(m.name for m in model.motors)
    for name in (*coordinates, *motors):
        problem = identifier_problem(name)
        if problem is not None:
            raise BuildError(f"name of a coordinate or motor: given {name!r}, expected {problem}")
    q_a = np.zeros(model.n_a)
    q_a[list(model.i_g)] = model.home
    c_functions = (
        () if per_point else offered_c_functions(model, names, parameters, precision, parts)
    )
    inverts = _inverts(c_functions, parameters)
    half = [*coordinates, *(motors[j] for j in model.i_m)]
    return LibrarySpec(
        name=library_name(model),
        functions=tuple(
            _function_spec(row, equations, sizes) for row in TABLE if row.name in names
        ),
        sizes=sizes,
        coordinates=coordinates,
        coordinate_units=tuple(c.unit for c in model.coordinates),
        motors=motors,
        states=(*half, *(f"d({name})/dt" for name in half)),
        home={"q_a": (*map(float, q_a),), "q_m": (*map(float, model.eta @ q_a[list(model.i_g)]),)},
        digest=model_digest(model),
        gravity=tuple(float(x) for x in model.gravity),
        gears=tuple(
            tuple((j, float(r)) for j, r in zip(m.drives, m.ratio, strict=True))
            for m in model.motors
        ),
        rotor_inertias=tuple(float(m.inertia) for m in model.motors),
        loops=tuple(loop.name for loop in model.loops),
        accuracy=_accuracy(model),
        precision=precision,
        parameters=parameters,
        per_point=per_point,
        force=FORCE in parts,
        c_functions=c_functions,
        motor_constants=motor_constants(model, POSITION in parts, equations, parameters)
        if inverts
        else None,
        kinematic_constants=kinematic_constants(model) if model.n_g >= FREE else None,
        constants=_constants(model),
    )


_ADDED = (("payload", "kg"), ("delay", "s"))  # whose standard deviations are not relative


def _accuracy(model: RobotModel) -> tuple[str, ...]:
    """Standard deviations from ``[uncertainty]``; names of the model's numbers, never the text of
    the file.
    """
    given = model.uncertainty
    if given is None:
        return ()
    # loads CasADi, which a library that exists does not need
    from flexgen.dynamics.mechanics.parameters import select

    lines = [f"{kind} {100 * sd:.3g} %" for kind in KINDS if (sd := getattr(given, kind))]
    lines += [f"{name} {sd:.3g} {unit}" for name, unit in _ADDED if (sd := getattr(given, name))]
    spread = dict(zip(given.parameters, given.sd, strict=True))
    named = [p.name for p in select(model, given.parameters) if p.name in spread]
    return (*lines, *(f"{name} {100 * spread[name]:.3g} %" for name in named))


def _sizes(model: RobotModel, functions: Sequence[str], parameters: int) -> dict[str, int]:
    """The sizes of the library by name, as ``n_a``; ``parameters``: how many there are at run
    time. BuildError for a model without coordinates or motors.
    """
    sizes = {
        "n_a": model.n_a,
        "n_g": model.n_g,
        "n_e": model.n_e,
        "n_m": model.n_m,
        "n_x": 2 * model.dof,
    }
    for what in ("n_a", "n_m"):
        if sizes[what] == 0:
            raise BuildError(
                f"model {model.name}: given {what} = 0, expected at least one coordinate and "
                "one motor"
            )
    if obstacle(model, "reduced problem") is None:
        sizes |= {"n_y": model.output.size, "n_t": model.output.target_size}
    if model.sensors:
        sizes["n_s"] = sum(len(sensor.channels) for sensor in model.sensors)
    if parameters:
        sizes["n_p"] = parameters
    if "mass_matrix_packed" in functions:
        sizes["n_packed"] = model.n_a * (model.n_a + 1) // 2
    return sizes


def _inverts(c_functions: Sequence[CFunction], parameters: Sequence[Parameter]) -> bool:
    """Whether the library has inverse dynamics along paths; BuildError for parameters that are
    constants of it.
    """
    inverts = any(function.header == "inversion" for function in c_functions)
    for parameter in parameters if inverts else ():
        if parameter.inertia:
            raise BuildError(
                f"parameters: given {parameter.name!r}, expected payload, stiffness, damping or "
                "friction: bodies and rotors are constants of the inversion along paths; "
                "choose functions without it, or set them by overrides"
            )
    return inverts


def _constants(model: RobotModel) -> Constants:
    """Gear ratios, rotor inertias [kg m^2] and gear stiffness, arm side, of a model."""
    from flexgen.dynamics.mechanics.lagrangian import gear_stiffness  # here, as it needs CasADi

    return Constants(
        gear_ratio=tuple(tuple(float(x) for x in row) for row in model.eta),
        rotor_inertia=tuple(float(motor.inertia) for motor in model.motors),
        gear_stiffness=tuple(float(x) for x in gear_stiffness(model)),
    )


def _function_spec(row: Row, equations: Any, sizes: dict[str, int]) -> FunctionSpec:
    """One row of the table with its mathematics, checked against the ports."""
    # here, so that a library that is there already needs no CasADi
    from flexgen.codegen.emission.routines import (
        PARAMETERS,
        mathematics_of,
        needs_parameters,
        parameters_port,
        program_of,
    )

    inputs, outputs = (
        tuple(port(name, equations.model, sizes) for name in names.split())
        for names in (row.inputs, row.outputs)
    )
    # (rows without motor where every coordinate has one)
    inputs, outputs = (tuple(p for p in ports if p.size) for ports in (inputs, outputs))
    if split_product(row.name)[1]:  # products know the parameters that their function has
        known = mathematics_of(equations, row.name)
        more = {PARAMETERS + TANGENT, PARAMETERS + COTANGENT}
        inputs += tuple(
            port(name, equations.model, sizes) for name in known.name_in() if name in more
        )
        outputs += tuple(
            port(name, equations.model, sizes) for name in known.name_out() if name in more
        )
    extents_of = {p.name: PORTS[p.name][0] for p in (*inputs, *outputs)}
    program = program_of(row.name, equations, inputs, outputs)
    if needs_parameters(program):
        inputs = (*inputs, parameters_port(equations))
        extents_of[PARAMETERS] = ("n_p",)
    return FunctionSpec(row.name, row.summary, row.equation, inputs, outputs, extents_of, program)
