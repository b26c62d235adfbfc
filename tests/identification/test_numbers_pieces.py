"""Pieces of several rooms by hand: searches, memory of gears, steps of chains, recordings at their
limits, plug-ins.
"""

from __future__ import annotations

import ctypes
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hysteretic import hysteretic
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

import flexgen
from flexgen.analysis.printing.elements import Return, chain_steps
from flexgen.analysis.printing.equations import Symbols
from flexgen.base.errors import ArgumentError
from flexgen.codegen.emission import constants_header as header
from flexgen.dynamics.hysteresis.lugre import MotorBristles, bristle_rates, bristle_torques
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.interface import PlugIn
from flexgen.identification.records import description
from flexgen.identification.responses.residuals import Residuals
from flexgen.model import inertia
from flexgen.simulation.integration.hysteretic_rate import hysteretic_rate, slip_torques


# --- memory --------------------------------------------------------------------------------------
def test_torques_of_hysteresis_follow_the_law_of_dahl() -> None:
    """``dz/dt = K_h (w - |w| z / W)``: w is the rate of deflection, W the torque at which gears
    slip.
    """
    model = hysteretic("elbow", share=0.4)
    inputs, outputs = hysteretic_rate(derive(model))
    at = ca.Function("at", inputs, outputs[:2])
    rng = np.random.default_rng(3)
    n = model.dof
    x = 0.1 * rng.normal(size=2 * n)
    z = np.array([0.3, -0.6]) * slip_torques(model)
    _, found = at(x, z, np.zeros(2))
    arm = x[n : n + 2]
    motor = x[n + 2 :]
    rate = np.linalg.inv(model.eta) @ motor - arm
    springs = np.array([e.dofs[0].gear.spring.stiffness for e in model.elements])
    slip = 0.5 * np.pi / 180 / 60 * springs
    assert_allclose(slip_torques(model), slip)
    expected = 0.4 * springs * (rate - np.abs(rate) * z / slip)
    assert_allclose(np.array(found).ravel(), expected, rtol=1e-6)


def test_torques_of_bristles_follow_their_law() -> None:
    """``z' = v - |v| s0 z / g(v)``, torque ``s0 z + s1 z'``: in expressions, and along a motion
    that reverses.
    """
    rows = [(0.4, 0.6, 2.0, 300.0, 0.5), (0.3, 0.3, 1.0, 200.0, 0.2), (0.0, 0.0, 1.0, 0.0, 0.0)]
    law = MotorBristles(*np.array(rows).T)

    def rate(j: int, v: float, y: float) -> float:
        coulomb, static, speed = rows[j][:3]
        return v - abs(v) * y / (coulomb + (static - coulomb) * np.exp(-((v / speed) ** 2)))

    v, y = (ca.SX.sym(name, 3) for name in "vy")
    at = ca.Function("at", [v, y], list(bristle_rates(law, v, y)))
    speeds = [1.3, -0.7, 2.0]
    torques = [0.2, -0.1, 0.0]
    found = [np.array(x).ravel() for x in at(speeds, torques)]
    z = [rate(j, speeds[j], torques[j]) for j in range(2)]
    assert_allclose(found[0], [300.0 * z[0], 200.0 * z[1], 0.0])
    assert_allclose(found[1], [0.2 + 0.5 * z[0], -0.1 + 0.2 * z[1], 0.0])
    # from rest to rest
    t = np.linspace(0.0, 0.5, 501)
    w = 4 * np.pi
    way = np.outer(3.0 * np.sin(w * t) ** 3, [1.0, -0.5, 1.0])
    slope = np.outer(9.0 * w * np.sin(w * t) ** 2 * np.cos(w * t), [1.0, -0.5, 1.0])
    along = bristle_torques(law, t, way, slope)
    for j, gain in enumerate((1.0, -0.5)):
        speed = lambda x, gain=gain: gain * 3.0 * np.sin(w * x) ** 3  # noqa: E731
        stiffness, damping = rows[j][3:]

        def right(x, y, j=j, speed=speed, k=stiffness):
            return [k * rate(j, speed(x), y[0])]

        exact = solve_ivp(
            right, (0.0, 0.5), [0.0], "LSODA", t, rtol=1e-8, atol=1e-10, max_step=2e-3
        ).y[0]
        expected = [y + damping * rate(j, speed(x), y) for x, y in zip(t, exact, strict=True)]
        assert_allclose(along[:, j], expected, atol=2e-6)
    assert not along[:, 2].any()


# --- equations as text ---------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["elbow", "manutec_r3", "two_arm"])
def test_steps_return_where_a_branch_begins_and_for_the_tool(name: str) -> None:
    model = flexgen.read(name)
    found = [
        step.name
        for step in chain_steps(model, Symbols(), [0] * model.n_m)
        if isinstance(step, Return)
    ]
    expected = []
    here = "base"
    for element in model.elements:
        if model.parents[element.name] != here:
            expected.append(model.parents[element.name])
        here = element.name
    assert found == expected + [model.tip] * (model.tip != here)
    assert bool(found) is model.branched


# --- headers -------------------------------------------------------------------------------------
def test_contents_of_a_library_are_those_of_its_functions() -> None:
    def spec(**function: str) -> Any:
        return Made(
            c_functions=[Made(**{"name": "solve", "file": "invert.c", **function})],
            motor_constants=None,
        )

    assert header.has_growth(spec(file="growth.c")) and not header.has_growth(spec())
    assert header.has_bounds(spec(name="stream_all_limits")) and not header.has_bounds(spec())
    assert header.filter_sizes(spec()) == (0, 0, 0)


# --- models --------------------------------------------------------------------------------------
def test_coordinates_without_inertia_are_named() -> None:
    """Those that carry the direction in which nothing moves: at least a tenth of its largest
    part.
    """
    model: Any = Made(coordinates=[Made(name=f"q{k}") for k in range(3)])
    v = np.array([0.6, 0.04, 1.0])
    v = v / np.linalg.norm(v)
    scale = np.diag([1.0, 10.0, 100.0])

    def matrix(least: float) -> np.ndarray:
        M = np.eye(3) - (1.0 - least) * np.outer(v, v)
        size = 1 / np.sqrt(np.diag(M))
        return np.asarray(scale @ (M * np.outer(size, size)) @ scale)

    found = inertia._massless(model, matrix(0.0))
    weights = v * np.sqrt(np.diag(np.eye(3) - np.outer(v, v)))
    assert (
        found
        == tuple(f"q{k}" for k in range(3) if weights[k] > 0.1 * weights.max())
        == ("q0", "q2")
    )
    assert inertia._massless(model, matrix(1e-11)) == ()
    assert inertia._massless(model, np.diag([1.0, 0.0, 2.0])) == ("q1",)


# --- recordings ----------------------------------------------------------------------------------
def recording(
    monkeypatch: pytest.MonkeyPatch, limit: float | None = None, **arrays: np.ndarray
) -> Any:
    """A file with time [ms], a torque, an angle [deg] and a signal."""
    t = np.arange(200.0)
    given = {
        "t": t,
        "tau": np.sin(0.1 * t),
        "q": 10 * np.cos(0.05 * t),
        "a": np.sin(0.2 * t),
    } | arrays
    monkeypatch.setattr(description, "read_arrays", lambda file, most: given)
    names = {"torque": "tau", "angle": "q", "signal": "a"}
    factors = {"torque": 0.5, "angle": description.ANGLE_UNITS["deg"], "signal": 2.0}
    kinds: Any = tuple([description._Channel("m1", names[k], factors[k], 0.25)] for k in names)
    clock = description._Channel("", "t", description.TIME_UNITS["ms"])
    model = Made(motors=[Made(torque_max=limit)])
    return description.Recording(Path("run.csv"), clock, (*kinds, []), model)


def test_columns_of_a_recording_are_in_si_units(monkeypatch: pytest.MonkeyPatch) -> None:
    """Offsets are in the units of the file."""
    found = recording(monkeypatch)
    t = np.arange(200.0)
    assert found.sample_s == pytest.approx(1e-3)
    assert_allclose(found.t, 1e-3 * (t + 0.0))
    assert_allclose(found.tau_m[:, 0], 0.5 * (np.sin(0.1 * t) + 0.25))
    assert_allclose(found.q_m[:, 0], np.deg2rad(10 * np.cos(0.05 * t) + 0.25))
    assert_allclose(found.signals[:, 0], 2 * (np.sin(0.2 * t) + 0.25))
    assert found.references.shape == (200, 0)
    times = {name: description.TIME_UNITS[name] for name in ("s", "ms", "us")}
    assert times == {"s": 1.0, "ms": 1e-3, "us": 1e-6}
    angles = [description.ANGLE_UNITS[name] for name in ("rad", "mrad", "deg")]
    assert_allclose(angles, [1.0, 1e-3, np.deg2rad(1.0)])


def test_recordings_at_a_limit_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three equal samples in a row at the largest torque, or 99.9 % of the limit of the motor;
    where time jumps.
    """
    tau = np.sin(0.1 * np.arange(200.0))
    recording(monkeypatch, tau=np.where(np.isin(np.arange(200), (50, 51)), 2.0, tau))
    text = (
        r"^run\.csv: torque of motor m1 \('tau'\): at its limit of 1\.125 N m at t = 0\.05 s: "
        r"excite less$"
    )
    for more in (0.0, 1e-10):  # rounding of the file
        clipped = np.where(np.isin(np.arange(200), (50, 51, 52)), 2.0, tau)
        clipped[51] -= more
        with pytest.raises(ArgumentError, match=text):
            recording(monkeypatch, tau=clipped)
    clipped[51] -= 1e-6
    recording(monkeypatch, tau=clipped)
    top = 0.5 * (np.abs(tau).max() + 0.25)
    recording(monkeypatch, limit=top / 0.998)
    with pytest.raises(ArgumentError, match="at its limit"):
        recording(monkeypatch, limit=top / 0.9995)
    with pytest.raises(ArgumentError, match="the same value at all times, expected a signal"):
        recording(monkeypatch, a=np.ones(200))
    late = np.arange(200.0) + 0.015 * (np.arange(200) == 100)
    assert not recording(monkeypatch, t=late).resampled
    late[100] += 0.02
    assert recording(monkeypatch, t=late).resampled
    late[100:] -= 50.0
    with pytest.raises(ArgumentError, match=r"^run\.csv: time goes from 0\.099 to 0\.0500.* at s"):
        recording(monkeypatch, t=late)
    angle = 10 * np.cos(0.05 * np.arange(200.0))
    recording(monkeypatch, q=angle + np.rad2deg(0.9) * (np.arange(200) > 77))
    with pytest.raises(
        ArgumentError,
        match=r"angle of motor m1 \('q'\): jumps by 1\.1\d rad at t = 0\.07\d s: the e",
    ):
        recording(monkeypatch, q=angle + np.rad2deg(1.1) * (np.arange(200) > 77))
    with pytest.raises(
        ArgumentError,
        match=r"signal of m1 \('a'\): given 199 samples, expected 200 as of the time",
    ):
        recording(monkeypatch, a=np.sin(np.arange(199.0)))


@pytest.mark.parametrize(
    ("own", "kind", "of_force", "units"),
    [
        ("N m", "wrench", True, {"N m": 1.0}),
        ("N", "wrench", True, {"N": 1.0, "kN": 1e3}),
        ("rad", "link_encoder", False, {"rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180}),
        ("m", "link_encoder", False, {"m": 1.0, "mm": 1e-3}),
        ("m/s^2", "accelerometer", False, {"m/s^2": 1.0, "g": 9.80665}),
    ],
)
def test_signals_have_units_of_their_channels(
    own: str, kind: str, of_force: bool, units: dict[str, float]
) -> None:
    sensor = Made(channels=("a", "b"), units=("?", own), type=kind, of_force=of_force)
    asked: dict[str, Any] = {}

    class Row(dict[str, Any]):
        def only(self, *names: str) -> None:
            asked["names"] = names

        def choice(self, name: str, among: tuple[str, ...]) -> str:
            asked[name] = among
            return str(self[name])

        def number(self, name: str, default: float) -> float:
            return float(self.get(name, default))

        def whole(self, name: str, low: int, high: int) -> int:
            assert (low, high) == (0, 1000)
            return int(self[name])

        def text(self, name: str) -> str:
            return str(self[name])

    for unit, factor in units.items():
        row = Row(sensor="b", unit=unit, name="c", scale=-3.0, index=4, offset=0.5)
        root: Any = Made(tables=lambda name, required, row=row: [row])
        model: Any = Made(sensors=[sensor])
        (found,) = description._signals(root, model)
        assert (found.of, found.name, found.offset, found.index) == ("b", "c", 0.5, 4)
        assert found.factor == pytest.approx(-3 * factor)
        assert set(asked["unit"]) == set(units) and asked["sensor"] == ("a", "b")


# --- identification ------------------------------------------------------------------------------
def test_directions_that_are_noise_of_the_torques_are_not_determined() -> None:
    """Those of which more than 8 % of the information is noise: they get a deviation of the
    logarithm of 1.
    """
    share = np.array([0.05, 0.0799, 0.0801, 0.5])
    A = np.diag([4.0, 9.0, 16.0, 25.0])
    made: Any = object.__new__(Residuals)
    J = np.sqrt(np.diag(A))[:, None] * np.eye(4)
    vars(made).update(
        kind="structured", vector=Made(prior_sd=np.full(4, np.inf)), data=Made(periods=5.0)
    )
    vars(made).update(weight=lambda x, slopes: (None, J.reshape(4, 1, 1, 1, 4)))
    for k, part in enumerate(share):
        made._noisy = (np.eye(1), np.full((4, 1, 1), 0.7), np.full((4, 1, 1), part))
        found = made.covariance(np.zeros(4), A)
        expected = 0.5 * 0.7 * (1 + part / 4.0) / np.diag(A) / (1 - part) ** 2
        assert_allclose(found, np.diag(expected) if k < 2 else np.eye(4), atol=1e-12)
    made._noisy = None
    assert_allclose(made.covariance(np.zeros(4), A), 0.5 * np.linalg.inv(A))
    made.vector.prior_sd = np.full(4, 0.5)
    assert_allclose(
        made.covariance(np.zeros(4), A), np.diag((0.5 * np.diag(A) + 4) / (np.diag(A) + 4) ** 2)
    )


# --- controllers of a user -----------------------------------------------------------------------
@pytest.mark.parametrize(("size", "taken"), [(0, 16), (8, 16), (16, 16), (17, 32), (1000, 1008)])
def test_memory_of_a_plug_in_is_its_size_in_steps_of_16_bytes(size: int, taken: int) -> None:
    setups: list[tuple[int, ...]] = []

    def reset(memory: ctypes.c_void_p, setup: Any) -> int:
        own = setup._obj
        angles = ctypes.cast(own.q_m, ctypes.POINTER(ctypes.c_double))
        setups.append((own.n_a, own.n_m, own.n_y, own.n_ref, own.sample_s, angles[0], angles[1]))
        return 7 if angles[0] > 5 else 0

    made: Any = object.__new__(PlugIn)
    step = ctypes.CFUNCTYPE(ctypes.c_int)(lambda: 0)
    vars(made).update(
        path=Path("own.so"), _size=lambda setup: size, _reset=reset, _step=step, _library="library"
    )
    setup: Any = Made(
        n_a=3, n_m=2, n_y=4, n_ref=9, sample_s=1e-3, q_m=np.array([[1.0, 2.0], [3.0, 4.0]])
    )
    found = made.compiled(setup)
    assert (
        found.memory.shape == (2, taken)
        and found.memory.dtype == np.uint8
        and not found.memory.any()
    )
    assert setups == [(3, 2, 4, 9, 1e-3, 1.0, 2.0), (3, 2, 4, 9, 1e-3, 3.0, 4.0)]
    assert (found.fixed, found.errors, found.keep, found.foreign) == (0, {}, "library", True)
    assert found.address == ctypes.cast(step, ctypes.c_void_p).value
    setup.q_m = np.array([[6.0, 2.0]])
    text = (
        r"^own\.so: its reset refused the robot with status 7 \(2 motors, 4 measured channels, "
        r"0\.001 s\)$"
    )
    with pytest.raises(ArgumentError, match=text):
        made.compiled(setup)
