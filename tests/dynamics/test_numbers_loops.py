"""Hysteresis along reversing deflections, gears with transmission errors, and rotors that turn
with their carriers.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ModelError
from flexgen.base.spec.memory import Hysteresis
from flexgen.dynamics.hysteresis.hysteresis import Layer, torque_along
from flexgen.dynamics.hysteresis.hysteresis_law import shape_of
from flexgen.dynamics.mechanics import motor_harmonics
from flexgen.exports.mujoco import mujoco_checks
from flexgen.planning.fastest import residual_vibration


def stepped(law: Hysteresis, K: float, W: float, p: np.ndarray, parts: int = 40) -> np.ndarray:
    """Torques at the samples by the written law of Bouc and Wen, with steps of Runge and Kutta."""

    def rate(z: float, s: float) -> float:
        x = z / W
        power = abs(x) ** law.exponent
        return K * (s * (1 - law.gamma * power) - (1 - law.gamma) * power * np.sign(x))

    z = 0.0
    out = [0.0]
    for change in np.diff(p):
        h = abs(change) / parts
        s = float(np.sign(change))
        for _ in range(parts):
            a = rate(z, s)
            b = rate(z + h * a / 2, s)
            c = rate(z + h * b / 2, s)
            z += h * (a + 2 * b + 2 * c + rate(z + h * c, s)) / 6
        out.append(z)
    return np.array(out)


def test_torques_of_two_layers_along_reversing_deflections() -> None:
    """Dahl's law and one with a sharp knee, of two gears, one of which rests for a sample."""
    p = np.array(
        [
            [0.0, 0.0],
            [1.0, -0.5],
            [1.8, -0.9],
            [0.9, -0.9],
            [-0.4, 0.3],
            [0.2, 1.5],
            [2.0, 0.2],
            [1.5, -2.0],
        ]
    )
    dahl = Hysteresis(1.0, 1.0)
    sharp = Hysteresis(1.0, 1.0, 2.0, 0.5)
    laws = [(dahl, sharp), (dahl, dahl)]
    numbers = [
        (np.array([4.0, 2.0]), np.array([3.0, 1.0])),
        (np.array([1.0, 5.0]), np.array([0.5, 4.0])),
    ]
    layers = [
        Layer(K, W, tuple(map(shape_of, each))) for (K, W), each in zip(numbers, laws, strict=True)
    ]
    found = torque_along(layers, p)
    for gear in range(2):
        expected = sum(
            stepped(each[gear], K[gear], W[gear], p[:, gear])
            for (K, W), each in zip(numbers, laws, strict=True)
        )
        assert_allclose(found[:, gear], expected, rtol=1e-4, atol=1e-5)


def test_forces_of_a_hysteresis_after_a_motion() -> None:
    """Torques of the layers on the arm, and over the ratio and reversed on the motors."""
    model = flexgen.read("elbow")
    layers = [Made(slip=np.array([2.0, 3.0])), Made(slip=np.array([10.0, 0.0]))]
    made: Any = Made(_laws=[None, Made(gears=layers)], model=model)
    found = residual_vibration.ResidualVibration._memory(
        made, 1, np.array([0.5, -1.0, 0.25, 9.0]), np.zeros(2)
    )
    z = np.array([2.0 * 0.5 + 10.0 * 0.25, -3.0])
    assert_allclose(found, [*z, *(-z / np.diag(model.eta))], rtol=1e-14)
    made._laws = []
    assert residual_vibration.ResidualVibration._memory(made, 0, np.zeros(4), np.zeros(2)) == 0.0


# --- transmission errors -------------------------------------------------------------------------
def test_gears_with_a_transmission_error_along_a_motion() -> None:
    """``q_g = q_m/n - e(q_m)``, and motors carry ``(1/n - e') tau_g``, by hand."""
    error = {"harmonics": [1, 2], "cos": [1e-4, 0.0], "sin": [0.0, 2e-4]}
    model = flexgen.read(
        "elbow", overrides={"element.upper.dof.q1.gear.transmission_error": error}
    )
    n = np.diag(model.eta)
    q = np.array([[0.3, 5.0], [40.0, -7.0], [2.0, 0.1]])
    tau = np.array([[2.0, 3.0], [-100.0, 5.0], [7.0, 0.0]])
    e = 1e-4 * np.cos(q[:, 0]) + 2e-4 * np.sin(2 * q[:, 0])
    rate = -1e-4 * np.sin(q[:, 0]) + 4e-4 * np.cos(2 * q[:, 0])
    assert_allclose(
        motor_harmonics.gear_angles_along(model, q),
        q / n - np.stack([e, 0 * e], axis=1),
        rtol=1e-12,
    )
    carried = np.stack([(1 / n[0] - rate) * tau[:, 0], tau[:, 1] / n[1]], axis=1)
    assert_allclose(motor_harmonics.carried_along(model, q, tau), carried, rtol=1e-12)
    plain = flexgen.read("elbow")
    assert_allclose(motor_harmonics.gear_angles_along(plain, q), q / n, rtol=1e-14)
    assert_allclose(motor_harmonics.carried_along(plain, q, tau), tau / n, rtol=1e-14)
    assert motor_harmonics.highest_harmonics(model).tolist() == [2.0, 0.0]
    assert (
        motor_harmonics.transmission_errors(model).keys() == {0}
        and motor_harmonics.transmission_errors(plain) == {}
    )


# --- rotors for MuJoCo ---------------------------------------------------------------------------
def test_a_rigid_rotor_turns_with_the_joints_of_its_carrier(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By the cosine between its axis and theirs; not at all across, and refused where they turn
    about several.
    """
    motor = {"name": "m", "carrier": "arm", "inertia": 1e-3, "axis": (0.0, 0.6, 0.8)}
    spins: dict[str, Any] = {
        "arm": (np.array([0.0, 0.0, 1.0]), {"q1": 1.0, "q2": -1.0}),
        "odd": None,
    }
    spins["across"] = (np.array([1.0, 0.0, 0.0]), {"q1": 1.0})
    monkeypatch.setattr(mujoco_checks, "common_axis", lambda model, name: spins[name])

    def turning(coupling: str = "complete", elastic: bool = False, **changes: Any) -> Any:
        model: Any = Made(
            motor_coupling=coupling,
            motors=[Made(**(motor | changes))],
            i_m=[0] if elastic else [],
            file="a.toml",
        )
        return mujoco_checks._turning(model, 0)

    assert turning() == {"q1": pytest.approx(0.8), "q2": pytest.approx(-0.8)}
    assert turning(carrier="across") == {}
    assert (
        turning(coupling="simplified") == {}
        and turning(carrier="base") == {}
        and turning(inertia=0.0) == {}
    )
    assert turning(elastic=True) is None
    with pytest.raises(
        ModelError,
        match=r"motor\.m\.carrier: given complete coupling of a motor with a rigid gear on odd",
    ):
        turning(carrier="odd")
