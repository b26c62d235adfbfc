"""The elastic robot as a block: motor torques and tool forces in, motor angles, tool pose and
deflections out.

    dx/dt = f(x, u, payload),   y = g(x),   x = (q_a, q_m, v_a, v_m, z),   u = (tau_m, f_tool)

of the motors only those behind elastic gears; z: see `flexgen.exports.fmu.plant_memory`. The
outputs do not depend on the inputs. The Jacobians are emitted, too.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.ports import Port
from flexgen.codegen.build.stream_defaults import PERIOD
from flexgen.codegen.emission.amalgamation import merge_files
from flexgen.codegen.emission.emit import emit, function_texts
from flexgen.codegen.emission.routines import expand, mathematics_of
from flexgen.codegen.emission.spec import FunctionSpec, LibrarySpec, library_name, library_spec
from flexgen.codegen.statements.routine import Block as Part
from flexgen.codegen.statements.routine import Expressions, Routine, Solve, profile
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.statics import Equilibrium, hold_joints
from flexgen.exports.fmu.block import FASTEST, Block, time_variable
from flexgen.exports.fmu.plant_memory import memory_variables, plant_memory
from flexgen.exports.fmu.variables import (
    INPUT,
    OUTPUT,
    PARAMETER,
    RATE,
    SETTING,
    STATE,
    Variable,
    array,
)
from flexgen.model.elements import RobotModel

METHODS = {"rk4": 1, "sdirk4": 2}  # numbers of flexgen_fmu_plant.h
PAYLOAD = ("payload.mass", "payload.com_x", "payload.com_y", "payload.com_z")
# of the fastest pole, by default: within the stability of Runge-Kutta by a factor of 50
STEPS_PER_TIME_CONSTANT = 20
STEP_MAX = 1e-3  # s


@dataclass(frozen=True)
class Graphs:
    """The functions of the block as CasADi functions; ``jacobians`` has the outputs ``M_y`` and
    ``R_y``.

    ``fastest``: the bound of `PlantMemory`; None where the robot has no torques with states.
    """

    rate: ca.Function
    accelerations: ca.Function
    jacobians: ca.Function
    output: ca.Function
    output_jacobian: ca.Function
    fastest: ca.Function | None


def plant(model: RobotModel, method: str, step: float | None) -> Block:
    """The block of a model.

    Parameters
    ----------
    model : RobotModel
    method : str
        A key of `METHODS`: the method of Co-Simulation at the start.
    step : float or None
        Its largest step [s]; None: from the fastest pole at home.
    """
    equations = derive(model, ("payload",))
    held = hold_joints(derive(model), np.array(model.home))
    graphs = graphs_of(equations)
    start = _start(model, held, graphs.rate.size1_in(0))
    step = _default_step(graphs, equations, start, held) if step is None else step
    texts, calls, work = _emit(equations, graphs)
    name = library_name(model)
    variables = _variables(equations, graphs, start, held, method, step)
    names = [v.name for v in variables if v.kind == PARAMETER]
    calls |= {
        "P_STEP": str(names.index("integration.step")),
        "P_MASS": str(names.index("payload.mass")),
    }
    return Block(
        name=name,
        title=name,
        text=model.description,
        macro="FMU_PLANT",
        variables=tuple(variables),
        sources={file: text for file, text in texts.items() if file != "example.c"},
        header=f"{name}.h",
        defines=calls,
        constants={"SETTING_LEAST": [1], "SETTING_MOST": [len(METHODS)]},
        sample_time=0.0,
        step=PERIOD / 5,
        memory="0",
        work=work,
        derivatives=True,
        straight=True,
    )


# --- mathematics ---------------------------------------------------------------------------------


def graphs_of(equations: Equations) -> Graphs:
    """The functions of the plant in the state x = (q_a, q_me, v_a, v_me, torques with states) and
    the input u = (motor torques, force and torque on the tool): rate, accelerations, Jacobians,
    outputs.

    The Jacobians are those of the equations of motion, ``M_y a = -R_y (x, u)``, so that C solves
    one linear system.
    """
    model = equations.model
    memory = plant_memory(equations)
    n_a = model.n_a
    n = model.dof
    i_m = model.i_m
    n_z = 0 if memory is None else memory.size
    robot = equations if memory is None else memory.equations
    x = ca.SX.sym("state", 2 * n + n_z)
    u = ca.SX.sym("input", model.n_m + 6)
    p = ca.SX.sym("parameters", len(equations.parameters))
    q_a = x[:n_a]
    v_a = x[n : n + n_a]
    q_g, v_g = (ca.vertcat(*[part[i] for i in model.i_g]) for part in (q_a, v_a))
    q_m, v_m = (ca.mtimes(ca.SX(ca.DM(model.eta)), part) for part in (q_g, v_g))
    for k, j in enumerate(i_m):
        q_m[j] = x[n_a + k]
        v_m[j] = x[n + n_a + k]
    f_tool = u[model.n_m :]
    values = {
        "q_a": q_a,
        "v_a": v_a,
        "q_m": q_m,
        "v_m": v_m,
        "tau_m": u[: model.n_m],
        "f_tool": f_tool,
    }
    values |= {"parameters": p, "memory": x[2 * n :]}

    def call(name: str, more: Mapping[str, Any] | None = None) -> list[ca.SX]:
        function = expand(name, mathematics_of(robot, name))
        given = values | dict(more or {})
        out: list[ca.SX] = function.call([given[key] for key in function.name_in()])
        return out

    a_a, a_m, _ = call("forward_dynamics_tool_force")
    inputs = [x, u, p]
    names = ["state", "input", "parameters"]
    z_rates = ca.SX(0, 1)
    fastest = None
    by_z = ca.SX(n, 0)
    if memory is not None:
        z_rates, bound, by_z = memory.function(q_a, v_a, q_m, v_m, x[2 * n :])
        fastest = ca.Function("plant_fastest", [x], [bound], ["state"], ["fastest"])
    a_me = ca.vertcat(ca.SX(0, 1), *[a_m[j] for j in i_m])
    rate = ca.Function(
        "plant_rate",
        inputs,
        [ca.densify(ca.vertcat(x[n : 2 * n], a_a, a_me, z_rates))],
        names,
        ["rate"],
    )
    accelerations = ca.Function("plant_accelerations", inputs, [a_a, a_m], names, ["a_a", "a_m"])
    s_a = ca.SX.sym("a_a", n_a)
    s_m = ca.SX.sym("a_m", model.n_m)
    M, R = call("residual_jacobians", {"a_a": s_a, "a_m": s_m})
    R = ca.SX(R)
    R_f = ca.SX.zeros(n, 6)
    J = call("jacobian")[0]
    R[:n_a, :n_a] = R[:n_a, :n_a] - ca.jacobian(ca.mtimes(J.T, f_tool), q_a)
    R_f[:n_a, :] = -J.T
    right = ca.horzcat(R[:, : 2 * n], -by_z, R[:, 2 * n :], R_f)
    if memory is not None:
        M = ca.diagcat(M, ca.SX.eye(n_z))
        right = ca.vertcat(right, ca.horzcat(-ca.jacobian(z_rates, x), ca.SX(n_z, u.numel())))
    jacobians = ca.Function(
        "plant_jacobians",
        [*inputs, s_a, s_m],
        [ca.densify(M), ca.densify(right)],
        [*names, "a_a", "a_m"],
        ["M_y", "R_y"],
    )
    y = _output(model, call, q_m, v_m, q_g, q_a, ca.mtimes(J, v_a))
    output = ca.Function("plant_output", [x], [y], ["state"], ["output"])
    C = ca.Function(
        "plant_output_jacobian", [x], [ca.densify(ca.jacobian(y, x))], ["state"], ["C"]
    )
    return Graphs(rate, accelerations, jacobians, output, C, fastest)


def _output(
    model: RobotModel, called: Any, q_m: ca.SX, v_m: ca.SX, q_g: ca.SX, q_a: ca.SX, v_tool: ca.SX
) -> ca.SX:
    """Motor angles and speeds, tool position, rotation by rows and velocity, deflections of all
    arm coordinates.
    """
    p, R = called("forward_kinematics")
    gear = ca.mtimes(ca.SX(ca.DM(np.linalg.inv(model.eta))), q_m) - q_g
    deflection = ca.SX(q_a)
    for k, i in enumerate(model.i_g):
        dof = model.coordinates[i].dof
        assert dof is not None and dof.gear is not None
        deflection[i] = 0.0 if dof.gear.rigid else gear[k]
    return ca.densify(ca.vertcat(q_m, v_m, p, ca.vec(R.T), v_tool, deflection))


def _emit(equations: Equations, graphs: Graphs) -> tuple[dict[str, str], dict[str, str], str]:
    """The model part: its files, how flexgen_fmu_config.h calls its functions, and the size of the
    workspace.
    """
    model = equations.model
    base = library_spec(equations, ("forward_kinematics",))
    n = model.dof
    n_u = model.n_m + 6
    n_x = graphs.rate.size1_in(0)
    n_y = graphs.output.size1_out(0)
    rows = n_x - model.dof
    behind = "; torques of hysteresis and bristles" if graphs.fastest else ""
    text = f"q_a, q_m, v_a, v_m; of the motors those behind elastic gears{behind}"
    ports = {
        "state": Port("state", (n_x,), "mixed", text),
        "input": Port(
            "input", (n_u,), "mixed", "motor torques [N m], force [N] and torque [N m] on the tool"
        ),
        "parameters": Port(
            "parameters", (len(equations.parameters),), "mixed", "payload, listed at the top"
        ),
        "rate": Port("rate", (n_x,), "mixed", "time derivative of the state"),
        "A": Port("A", (n_x, n_x), "mixed", "d rate/d state"),
        "B": Port("B", (n_x, n_u), "mixed", "d rate/d input"),
        "output": Port("output", (n_y,), "mixed", "motors, tool, deflections"),
        "C": Port("C", (n_y, n_x), "mixed", "d output/d state"),
        "fastest": Port("fastest", (1,), "1/s", "rate at which small changes of the torques fade"),
    }
    parts = (Part("A", n, 0, n_x), Part("B", n, n_x, n_u))
    ones = tuple(("A", i, n + i) for i in range(n))
    solve = Solve(
        "M_y", "R_y", rows, n_x + n_u, False, profile(graphs.jacobians, "M_y"), parts, ones
    )
    steps = (Expressions(graphs.accelerations, pivots=True), Expressions(graphs.jacobians), solve)
    table = [
        (
            "plant_rate",
            "Right-hand side of the equations of motion.",
            "dx/dt = f(x, u)",
            "state input parameters",
            "rate",
            Routine((Expressions(graphs.rate, pivots=True),)),
        ),
        (
            "plant_linearization",
            "Its Jacobians.",
            "d(dx/dt) = A dx + B du",
            "state input parameters",
            "A B",
            Routine(steps),
        ),
        (
            "plant_output",
            "Outputs.",
            "y = g(x)",
            "state",
            "output",
            Routine((Expressions(graphs.output),)),
        ),
        (
            "plant_output_jacobian",
            "Their Jacobian.",
            "dy = C dx",
            "state",
            "C",
            Routine((Expressions(graphs.output_jacobian),)),
        ),
    ]
    if graphs.fastest is not None:
        summary = "Largest rate at which torques of hysteresis and bristles fade."
        table.append(
            (
                "plant_fastest",
                summary,
                "",
                "state",
                "fastest",
                Routine((Expressions(graphs.fastest),)),
            )
        )
    functions = []
    for name, summary, equation, given, got, routine in table:
        ins, outs = (tuple(ports[word] for word in words.split()) for words in (given, got))
        extents = {port.name: tuple(map(str, port.shape)) for port in (*ins, *outs)}
        functions.append(FunctionSpec(name, summary, equation, ins, outs, extents, routine))
    return _write(replace(base, functions=tuple(functions), c_functions=()))


def _write(spec: LibrarySpec) -> tuple[dict[str, str], dict[str, str], str]:
    """The C of the functions: files by name, calls by macro of flexgen_fmu_config.h, and the macro
    of the size of the workspace.
    """
    written = function_texts(spec)
    calls = {}
    arguments = {
        "state": "x",
        "input": "u",
        "parameters": "p",
        "rate": "r",
        "output": "r",
        "A": "r",
        "B": "s",
        "C": "r",
        "fastest": "r",
    }
    macros = {
        "plant_rate": "MODEL_RATE(x, u, p, r, w)",
        "plant_linearization": "MODEL_LINEARIZATION(x, u, p, r, s, w)",
        "plant_output": "MODEL_OUTPUT(x, u, p, r, w)",
        "plant_output_jacobian": "MODEL_OUTPUT_JACOBIAN(x, u, p, r, w)",
        "plant_fastest": FASTEST,
    }
    for f in spec.functions:
        given = [arguments[port.name] for port in (*f.inputs, *f.outputs)]
        given += ["w"] if written[f.name].work > 0 else []
        calls[macros[f.name]] = f"{spec.name}_{f.name}({', '.join(given)})"
    return merge_files(spec.name, emit(spec, written)), calls, f"{spec.name.upper()}_WORK"


# --- numbers -------------------------------------------------------------------------------------


def _start(model: RobotModel, held: Equilibrium, size: int) -> np.ndarray:
    """The state of the equilibrium (size,), without torques that have states."""
    return np.concatenate([held.q_a, held.q_m[list(model.i_m)], np.zeros(size - model.dof)])


def _default_step(graphs: Graphs, equations: Equations, x: np.ndarray, held: Equilibrium) -> float:
    """1, 2 or 5 times a power of ten [s]: a twentieth of the time constant of the fastest pole at
    home, at most.
    """
    n = equations.model.dof
    u = np.concatenate([held.tau_m, np.zeros(6)])
    p = np.array([parameter.value for parameter in equations.parameters])
    a_a, a_m = evaluate(graphs.accelerations, x, u, p)
    M, R = evaluate(graphs.jacobians, x, u, p, a_a[0], a_m[0])
    rows = len(x) - n
    lower = -np.linalg.solve(M[0].reshape(rows, rows), R[0].reshape(rows, -1)[:, : len(x)])
    A = np.vstack([np.eye(n, len(x), n), lower])
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    most = min(STEP_MAX, 1.0 / (STEPS_PER_TIME_CONSTANT * fastest)) if fastest > 0.0 else STEP_MAX
    power = 10.0 ** math.floor(math.log10(most) + 1e-12)
    return float(f"{max(k * power for k in (1, 2, 5) if k * power <= most * (1 + 1e-12)):.0e}")


def _variables(
    equations: Equations,
    graphs: Graphs,
    x: np.ndarray,
    held: Equilibrium,
    method: str,
    step: float,
) -> list[Variable]:
    """All variables of the block."""
    model = equations.model
    return [
        time_variable(),
        *_inputs(model, held),
        *_outputs(model, graphs),
        *_states(model, graphs, x),
        *payload_variables(equations),
        Variable(
            "integration.step", PARAMETER, 4, "s", "Co-Simulation: largest step", step, fixed=True
        ),
        Variable(
            "integration.method",
            SETTING,
            0,
            "",
            "Co-Simulation: 1 Runge-Kutta 4 (explicit), 2 SDIRK 4 (implicit, L-stable)",
            METHODS[method],
        ),
    ]


def payload_variables(equations: Equations) -> list[Variable]:
    """The parameters of equations with the payload as parameter."""
    rows = [("mass", "kg", "mass of the payload")]
    rows += [
        (f"com[{k}]", "m", f"its center of mass in the frame that the tool is attached to, {axis}")
        for k, axis in enumerate("xyz", 1)
    ]
    return [
        Variable(f"payload.{name}", PARAMETER, k, unit, text, float(equations.parameters[k].value))
        for k, (name, unit, text) in enumerate(rows)
    ]


def _inputs(model: RobotModel, held: Equilibrium) -> list[Variable]:
    """Inputs of the plant: motor torques [N m], at the start those of equilibrium, and force and
    torque on the tool [N, N m].
    """
    torques = [
        Variable(
            f"motor.{m.name}.torque",
            INPUT,
            k,
            "N.m",
            "motor torque, motor side; at the start of equilibrium",
            float(held.tau_m[k]),
        )
        for k, m in enumerate(model.motors)
    ]
    axes = [f"on the tool at its origin, world axis {axis}" for axis in "xyz"]
    zero = [0.0, 0.0, 0.0]
    force = array("tool.force", INPUT, model.n_m, "N", [f"force {text}" for text in axes], zero)
    torque = array(
        "tool.torque", INPUT, model.n_m + 3, "N.m", [f"torque {text}" for text in axes], zero
    )
    return [*torques, *force, *torque]


def _outputs(model: RobotModel, graphs: Graphs) -> list[Variable]:
    """Outputs of the plant with the states on which they depend: motors, tool, deflections."""
    rows = _pattern(graphs.output, 0)
    names: list[tuple[str, str, str]] = []
    names += [(f"motor.{m.name}.angle", "rad", "motor angle, motor side") for m in model.motors]
    names += [(f"motor.{m.name}.speed", "rad/s", "motor speed, motor side") for m in model.motors]
    names += [
        (f"tool.position[{i + 1}]", "m", f"position of the tool, world axis {axis}")
        for i, axis in enumerate("xyz")
    ]
    names += [
        (
            f"tool.rotation[{i},{j}]",
            "1",
            "rotation matrix; its columns are the axes of the tool in the world",
        )
        for i in (1, 2, 3)
        for j in (1, 2, 3)
    ]
    names += [
        (f"tool.velocity[{i + 1}]", "m/s", f"of the tool's origin, world axis {a}")
        for i, a in enumerate("xyz")
    ]
    names += [
        (f"tool.angular_velocity[{i + 1}]", "rad/s", f"of the tool, world axis {a}")
        for i, a in enumerate("xyz")
    ]
    for c in model.coordinates:
        text = (
            "deflection of the gear, arm side: motor angle / ratio - joint"
            if c.actuated
            else "elastic deflection"
        )
        names.append((f"deflection.{c.name}", c.unit, text))
    return [
        Variable(
            name,
            OUTPUT,
            k,
            unit,
            text,
            depends=tuple(1000 * STATE + int(i) for i in np.flatnonzero(rows[k])),
        )
        for k, (name, unit, text) in enumerate(names)
    ]


def _pattern(function: ca.Function, argument: int) -> np.ndarray:
    """Which results depend on which entries of an argument, by structure."""
    found: np.ndarray = np.array(ca.DM(function.jac_sparsity(0, argument), 1)) != 0
    return found


def _states(model: RobotModel, graphs: Graphs, x: np.ndarray) -> list[Variable]:
    """States and their derivatives, with start values ``x``, and the states and inputs on which a
    derivative depends.
    """
    half = [
        (f"arm.{c.name}", "position", c.unit, f"of the arm coordinate {c.name}", 1.0)
        for c in model.coordinates
    ]
    half += [
        (
            f"rotor.{model.motors[j].name}",
            "angle",
            "rad",
            "of the rotor behind an elastic gear, motor side",
            float(np.abs(model.eta[j]).max()),
        )
        for j in model.i_m
    ]
    n = len(half)
    out = []
    for k, (name, what, unit, text, nominal) in enumerate(half):
        out.append(
            Variable(
                f"{name}.{what}", STATE, k, unit, f"{what} {text}", float(x[k]), nominal=nominal
            )
        )
    for k, (name, _, unit, text, nominal) in enumerate(half):
        out.append(
            Variable(
                f"{name}.speed", STATE, n + k, f"{unit}/s", f"speed {text}", 0.0, nominal=nominal
            )
        )
    out += memory_variables(model, 2 * n)
    by_state = _pattern(graphs.rate, 0)
    by_input = _pattern(graphs.rate, 1)
    for k, state in enumerate(out[:]):
        own = f"der({state.name})"
        rate = f"{state.unit}2" if state.unit.endswith("/s") else f"{state.unit}/s"
        depends = [1000 * STATE + int(i) for i in np.flatnonzero(by_state[k])]
        depends += [1000 * INPUT + int(i) for i in np.flatnonzero(by_input[k])]
        out.append(Variable(own, RATE, k, rate, "its time derivative", depends=tuple(depends)))
    return out
