"""`identify_spring` on loops of independent simulations: Bouc and Wen's law in small steps, chains
of Coulomb sliders, springs in closed form; creep and late torques as planted faults.
"""

from __future__ import annotations

import numpy as np
import pytest

import flexgen
from flexgen.identification.gears import identify_spring as module

KEY = "element.upper.dof.q1.gear"
STEPS = 4000


def ramps(*ends: float) -> np.ndarray:
    """Deflections that move at equal steps from zero to each of these ends [rad]."""
    corners = np.array([0.0, *ends])
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners)))])
    return np.interp(np.linspace(0.0, way[-1], STEPS), way, corners)


def bouc_wen(d: np.ndarray, stiffness: float, slip: float, exponent: float) -> np.ndarray:
    """Bouc and Wen's law by the midpoint rule in steps a twentieth of those of the record."""
    fine = np.interp(np.arange(20 * len(d)) / 20, np.arange(len(d)), d)
    z = np.zeros(len(fine))

    def rate(change: float, torque: float) -> float:
        x = torque / slip
        return stiffness * (change - abs(change) * np.sign(x) * abs(x) ** exponent)

    for k, change in enumerate(np.diff(fine)):
        z[k + 1] = z[k] + rate(change, z[k] + rate(change, z[k]) / 2)
    return z[::20]


def sliders(d: np.ndarray, stiffness: float, slip: float, count: int = 40) -> np.ndarray:
    """Springs behind Coulomb sliders (Iwan); slip torques rise from 0 to twice their mean."""
    each = stiffness / count
    limits = slip / count * 2 * (np.arange(count) + 0.5) / count
    z = np.zeros(count)
    out = np.zeros(len(d))
    for k, change in enumerate(np.diff(d)):
        z = np.clip(z + each * change, -limits, limits)
        out[k + 1] = z.sum()
    return out


def record(d: np.ndarray, torque: np.ndarray, noise: float = 0.0, seed: int = 0):
    """A record of 40 s with noise, in parts of the ranges."""
    draw = np.random.default_rng(seed).normal(size=(2, len(d)))
    values = {
        "deflection": d + noise * np.ptp(d) * draw[0],
        "torque": torque + noise * np.ptp(torque) * draw[1],
    }
    return {"time": np.linspace(0.0, 40.0, len(d))} | values


def fit(data, **options):
    """The fit of the first joint of elbow."""
    return flexgen.identify_spring("elbow", data, joint="q1", progress=False, **options)


LOOP = ramps(1e-3, -1e-3, 1e-3, -0.4e-3, 0.6e-3, -1e-3)


def test_bouc_wen_in_small_steps_is_recovered_behind_noise():
    """K 4e4, K_h 6e4, W 8 N m, exponent 3: within 3 standard deviations and 3 %."""
    torque = 4e4 * LOOP + bouc_wen(LOOP, 6e4, 8.0, 3.0)
    found = fit(record(LOOP, torque, 1e-3), exponents=True)
    truth = {
        "q1.spring.stiffness": 4e4,
        "q1.hysteresis.lost_motion": 2 * 8.0 / 4e4,
        "q1.hysteresis.stiffness": 6e4,
        "q1.hysteresis.exponent": 3.0,
    }
    assert found.status == "fitted" and not found.causes
    for name, value in truth.items():
        assert found.values[name] == pytest.approx(value, rel=0.03)
        assert abs(found.values[name] - value) < 3 * found.sd[name]


def test_a_planted_sign_of_the_branches_is_seen(monkeypatch):
    """Elements that turn the wrong way at reversals do not fit the same record."""
    torque = 4e4 * LOOP + bouc_wen(LOOP, 6e4, 8.0, 1.0)
    assert fit(record(LOOP, torque)).status != "model error"
    right = module.loop_torque
    monkeypatch.setattr(
        module, "loop_torque", lambda elements, one, start: -right(elements, one, start)
    )
    assert fit(record(LOOP, torque)).status not in ("fitted", "small error")


@pytest.mark.parametrize("size", [0.5, 1.6])
def test_a_chain_of_sliders_is_predicted_at_another_size(size):
    """Two elements with exponents, fitted to one size: another one within 3 % of its torques."""
    torque = 4e4 * LOOP + sliders(LOOP, 6e4, 8.0)
    other = size * LOOP
    held = record(other, 4e4 * other + sliders(other, 6e4, 8.0), 1e-3, 1)
    found = fit(
        record(LOOP, torque, 1e-3),
        more=[record(0.3 * LOOP, 12e3 * LOOP + sliders(0.3 * LOOP, 6e4, 8.0), 1e-3, 2)],
        validate=[held],
        elements=2,
        exponents=True,
    )
    last = found.records[-1]
    assert not last.is_fitted and last.error < 0.03
    assert last.width_of_model == pytest.approx(last.width, abs=0.03 * np.ptp(other))


@pytest.mark.parametrize(
    ("kind", "numbers", "torque"),
    [
        ("cubic", {"stiffness": 4e4, "cubic": 3e10}, lambda d: 4e4 * d + 3e10 * d**3),
        (
            "piecewise",
            {"low": 2e4, "high": 6e4, "break_at": 4e-4},
            lambda d: 6e4 * d - 4e4 * np.clip(d, -4e-4, 4e-4),
        ),
        (
            "backlash",
            {"stiffness": 4e4, "gap": 2e-4, "smoothing": 3e-5},
            lambda d: 4e4 * (d - (np.hypot(d + 2e-4, 3e-5) - np.hypot(d - 2e-4, 3e-5)) / 2),
        ),
    ],
)
def test_springs_that_are_not_straight(kind, numbers, torque):
    """With an unknown zero of the encoder, the numbers within 2 %."""
    data = record(LOOP + 3e-4, torque(LOOP) + 1.5, 1e-4)
    found = fit(data, spring=kind, elements=0)
    assert found.status == "fitted"
    for name, value in numbers.items():
        assert found.values[f"q1.spring.{name}"] == pytest.approx(value, rel=0.02)
    assert found.changes[f"{KEY}.spring"]["type"] == kind


def test_creep_and_late_torques_are_named():
    """A damper in series, and torques 60 ms late, next to the same loop without them."""
    d = LOOP
    torque = 4e4 * d + bouc_wen(d, 6e4, 8.0, 1.0)
    h = 40.0 / (STEPS - 1)
    creep = np.zeros(STEPS)
    for k, change in enumerate(np.diff(d)):
        creep[k + 1] = (creep[k] + 1.5e4 * change) * (1 - h / 3.0)
    late = np.interp(np.arange(STEPS) * h - 0.06, np.arange(STEPS) * h, torque)
    named = {
        "creeps": fit(record(d, torque + creep, 1e-4)),
        "late": fit(record(d, late, 1e-4)),
    }
    for word, found in named.items():
        assert found.status != "fitted"
        assert word in found.causes[0]
    assert not fit(record(d, torque, 1e-4)).causes


def test_both_sides_of_a_gear_and_of_its_spring():
    """A test on the motor side is that on the arm side, and so is a spring on the motor side."""
    torque = 4e4 * LOOP + bouc_wen(LOOP, 6e4, 8.0, 1.0)
    arm = fit(record(LOOP, torque))
    robot = flexgen.read("elbow")
    ratio = abs(next(m for m in robot.motors if m.drives == ("q1",)).ratio[0])
    motor = fit(record(ratio * LOOP, torque / ratio), side="motor")
    assert motor.values == pytest.approx(arm.values, rel=1e-6)
    turned = flexgen.read("elbow", overrides={f"{KEY}.side": "motor"})
    other = flexgen.identify_spring(turned, record(LOOP, torque), joint="q1", progress=False)
    assert other.values["q1.spring.stiffness"] * ratio**2 == pytest.approx(
        arm.values["q1.spring.stiffness"], rel=1e-6
    )
    assert other.values["q1.hysteresis.lost_motion"] == pytest.approx(
        arm.values["q1.hysteresis.lost_motion"], rel=1e-6
    )


def test_the_written_model_has_the_loop(tmp_path):
    """The gear of the new file, driven along the deflection by `torque_along`, is the record."""
    torque = 4e4 * LOOP + bouc_wen(LOOP, 6e4, 8.0, 1.0)
    found = fit(record(LOOP, torque))
    path = found.save(tmp_path / "new.toml")
    gear = flexgen.read(f"{path}@identified").elements[0].dofs[0].gear
    assert gear.spring.stiffness == pytest.approx(4e4, rel=2e-3)
    assert gear.hysteresis.lost_motion == pytest.approx(4e-4, rel=5e-3)
    assert gear.hysteresis.stiffness == pytest.approx(6e4, rel=5e-3)


def test_columns_of_a_logger(tmp_path):
    """Names and units of columns; a header that is missing."""
    torque = 4e4 * LOOP
    rows = np.column_stack([np.linspace(0, 4e4, STEPS), np.rad2deg(LOOP), torque / 1e3])
    file = tmp_path / "log.csv"
    np.savetxt(file, rows, "%.12g", ",", header="time ms,spring_deg,load_kN_m", comments="")
    options = {"elements": 0, "names": ("spring", "load")}
    text = file.read_text().replace("load_kN_m", "load kN m")
    file.write_text(text)
    assert fit(file, **options).values["q1.spring.stiffness"] == pytest.approx(4e4, rel=1e-6)
    file.write_text(text.split("\n", 1)[1])
    columns = ["t ms", "deflection deg", "torque kN m"]
    found = fit(file, elements=0, columns=columns)
    assert found.values["q1.spring.stiffness"] == pytest.approx(4e4, rel=1e-6)


T = np.linspace(0.0, 1.0, 50)
WRONG = {
    "does not reverse": ({"deflection": T, "torque": T}, {}),
    "falls with the deflection": ({"deflection": np.sin(9 * T), "torque": -np.sin(9 * T)}, {}),
    "given a constant": ({"deflection": T, "torque": 0 * T}, {}),
    "expected also torque": ({"deflection": T}, {}),
    "expected one of q1, q2": ({"deflection": T, "torque": T}, {"joint": "q9"}),
    "from 0 to 8": ({"deflection": T, "torque": T}, {"elements": 9}),
    "those of deflection and torque": ({"deflection": T, "torque": T}, {"names": ["a"]}),
}


@pytest.mark.parametrize("words", WRONG)
def test_bad_input_is_refused(words):
    channels, options = WRONG[words]
    with pytest.raises(flexgen.ArgumentError, match=words):
        flexgen.identify_spring(
            "elbow",
            {"time": T} | channels,
            **{"joint": "q1", "progress": False} | options,
        )
