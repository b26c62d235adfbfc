"""FMUs for the tests: exported once a run, instances by FMPy, and a reference from Lagrange's
equations and SciPy.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import fmpy
import numpy as np
from scipy.integrate import solve_ivp

import flexgen
from flexgen.exports.fmu.variables import INPUT, OUTPUT, STATE

FORCE = np.array([30.0, -20.0, 10.0, 1.0, 2.0, 3.0])  # on the tool [N, N m]
COMMUNICATION = 1e-3  # s


_FOLDER = tempfile.TemporaryDirectory(prefix="flexgen-fmus-")  # removed at the end of the run


def folder() -> Path:
    return Path(_FOLDER.name)


@cache
def exported(
    model: str, version: str, block: str = "plant", **options: object
) -> flexgen.Exported:
    given = dict(options)
    if block == "controller":
        given["controller"] = cascade(flexgen.read(model).n_m)
    path = folder() / f"{model}_{block}_{version[0]}.fmu"
    return flexgen.export_fmu(model, path, version=version, block=block, **given)


def cascade(n: int) -> flexgen.Cascade:
    k = np.arange(1.0, n + 1.0)
    filters = (flexgen.LowPass(120.0), flexgen.Notch(60.0))
    return flexgen.Cascade(20.0 + k, 0.1 * k, 3.0 + k, filters, np.full(n, 5.0))


@cache
def description(path: Path) -> fmpy.model_description.ModelDescription:
    return fmpy.read_model_description(str(path))


@cache
def unzipped(path: Path) -> str:
    return fmpy.extract(str(path), unzipdir=tempfile.mkdtemp(dir=folder()))


class Instance:
    """An instance in initialized state."""

    def __init__(self, written, kind="CoSimulation", start=(), time=0.0, hold_first=False):
        self.version = written.details["version"][0]
        self.described = description(written.path)
        self.of = {v.name: v for v in self.described.modelVariables}
        self.fmu = fmpy.instantiate_fmu(
            unzipped(written.path), self.described, fmi_type=kind, logger=quiet
        )
        for name, value in dict(start).items():
            self.set_start(name, value)
        if self.version == "2":
            self.fmu.setupExperiment(startTime=time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=time)
        self.fmu.exitInitializationMode()
        if kind == "ModelExchange" and not hold_first:
            if self.version == "2":
                self.events = self.fmu.newDiscreteStates()
            else:
                self.events = self.fmu.updateDiscreteStates()
            self.fmu.enterContinuousTimeMode()

    def set_start(self, name, value):
        v = self.of[name]
        if v.type in ("Integer", "Int32"):
            (self.fmu.setInteger if self.version == "2" else self.fmu.setInt32)(
                [v.valueReference], [int(value)]
            )
        else:
            self.put([v.valueReference], [value])

    def put(self, references, values):
        (self.fmu.setReal if self.version == "2" else self.fmu.setFloat64)(
            list(references), [float(x) for x in values]
        )

    def get(self, references):
        get = self.fmu.getReal if self.version == "2" else self.fmu.getFloat64
        return np.array(get(list(references)))

    def step(self, k, length=COMMUNICATION):
        self.fmu.doStep(k * length, length)

    def close(self):
        self.fmu.terminate()
        self.fmu.freeInstance()


def quiet(*arguments):
    pass


def references(written, kind):
    return [v.reference for v in written.details["variables"] if v.kind == kind]


def starts(written, kind):
    return np.array([v.start for v in written.details["variables"] if v.kind == kind], dtype=float)


def inputs_over(written, n):
    """Inputs of n communication steps, held in each, (n, n_u): torques about the equilibrium, a
    force on the tool.
    """
    u = np.tile(starts(written, INPUT), (n, 1))
    n_m = u.shape[1] - 6
    t = COMMUNICATION * np.arange(n)[:, None]
    frequency = 3.0 + np.arange(n_m) % 3
    u[:, :n_m] += (0.5 + 0.1 * np.abs(u[0, :n_m])) * np.sin(2 * np.pi * frequency * t)
    u[:, n_m:] = FORCE
    return u


@cache
def lagrange(model):
    return Lagrange(model)


class Lagrange:
    """The right-hand side of Lagrange's equations, evaluated by CasADi; nothing of it comes from
    emitted C.
    """

    def __init__(self, model):
        self.equations = flexgen.derive(model)
        self.model = self.equations.model
        self.function = self.equations.function("forward_dynamics_tool_force")

    def split(self, x):
        m = self.model
        n_a = m.n_a
        n = m.dof
        i_m = list(m.i_m)
        i_g = list(m.i_g)
        q_m = m.eta @ x[:n_a][i_g]
        v_m = m.eta @ x[n : n + n_a][i_g]
        q_m[i_m] = x[n_a:n]
        v_m[i_m] = x[n + n_a :]
        return x[:n_a], x[n : n + n_a], q_m, v_m

    def rate(self, t, x, u):
        n_m = self.model.n_m
        i_m = list(self.model.i_m)
        parts = self.split(x)
        a_a, a_m, _ = self.function(*parts, u[:n_m], u[n_m:])
        return np.concatenate(
            [parts[1], parts[3][i_m], np.array(a_a).ravel(), np.array(a_m).ravel()[i_m]]
        )

    @cache  # noqa: B019, instances are few
    def _known(self, start, inputs):
        return self._motion(np.array(start), np.array(inputs))

    def motion(self, x, inputs):
        return self._known(tuple(x), tuple(map(tuple, inputs)))

    def _motion(self, x, inputs):
        """States at the communication points: DOP853, a step of which is far below the tolerances
        of the tests.
        """
        out = [x]
        for u in inputs:
            found = solve_ivp(
                self.rate,
                (0.0, COMMUNICATION),
                out[-1],
                "DOP853",
                args=(u,),
                rtol=1e-12,
                atol=1e-13,
            )
            assert found.success
            out.append(found.y[:, -1])
        return np.array(out)

    def output(self, x):
        """Outputs of the plant: motors, tool, deflections."""
        m = self.model
        q_a, v_a, q_m, v_m = self.split(x)
        p, R = (np.array(y) for y in self.equations.function("forward_kinematics")(q_a))
        J = np.array(self.equations.function("jacobian")(q_a))
        deflection = q_a.copy()
        deflection[list(m.i_g)] = np.linalg.solve(m.eta, q_m) - q_a[list(m.i_g)]
        return np.concatenate([q_m, v_m, p.ravel(), R.ravel(), J @ v_a, deflection])


def co_simulated(written, inputs, start=()):
    """States and outputs at the communication points."""
    fmu = Instance(written, start=start)
    states = references(written, STATE)
    outputs = references(written, OUTPUT)
    x = [fmu.get(states)]
    y = [fmu.get(outputs)]
    for k, u in enumerate(inputs):
        fmu.put(references(written, INPUT), u)
        fmu.step(k)
        x.append(fmu.get(states))
        y.append(fmu.get(outputs))
    fmu.close()
    return np.array(x), np.array(y)


def largest_difference(found, expected):
    """Largest difference of a channel, relative to its largest value (at least 1)."""
    return float(
        (
            np.abs(found - expected).max(axis=0) / np.maximum(np.abs(expected).max(axis=0), 1.0)
        ).max()
    )
