"""The study of feedback linearization: its cells are runs of `flexgen.control`, and its question
has an answer.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws.study import (
    ARM,
    FAMILIES,
    FL,
    MOTOR_NOISE,
    PD,
    PID,
    PLANTS,
    PREDICTED,
    SETTINGS,
    STATE_LQ,
    Setting,
    Trial,
)

pytestmark = needs_compiler


@pytest.fixture(scope="module")
def study():
    return flexgen.feedback_study(
        settings=(Setting(1e-3, 1e-3, False),), families=(FL, STATE_LQ), tunings=4, progress=False
    )


@pytest.fixture(scope="module")
def quick():
    """Five families at one setting; with the exact state one more."""
    late = Setting(2e-3, 2e-3, False)
    exact = Setting(2e-3, 0.0, True)
    found = flexgen.feedback_study(settings=(late,), tunings=2, progress=False)
    more = flexgen.feedback_study(
        settings=(exact,), families=(STATE_LQ,), tunings=2, progress=False
    )
    return replace(found, settings=(late, exact), trials=found.trials + more.trials)


def motor_law(model, q_a, hz, integral):
    """k_p = w^2 J and k_d = 2 w J of the motors with stiff springs, integral part from w/8 on."""
    back = np.linalg.inv(model.eta)
    M = np.array(flexgen.derive(model).function("mass_matrix")(q_a))
    J = np.diag(back.T @ M @ back) + [m.inertia for m in model.motors]
    w = 2 * np.pi * hz
    return flexgen.Cascade(np.full(3, w / 2), 2 * w * J, np.full(3, integral * w / 8))


def laws(solution):
    """One tuning of each family."""
    model = flexgen.read(ARM)
    q_a = solution.trajectory["q_a"][0]
    return {
        PD: ("3 Hz", motor_law(model, q_a, 3.0, 0.0)),
        PID: ("64 Hz", motor_law(model, q_a, 64.0, 1.0)),
        FL: ("discrete, 8.0 Hz", flexgen.FeedbackLinearisation(8.0, "discrete")),
        PREDICTED: ("continuous, 60.0 Hz", flexgen.FeedbackLinearisation(60.0, predict=True)),
        STATE_LQ: ("rho 4.6e-03", flexgen.LQ(10 ** (1 - 10 / 3))),
    }


@pytest.mark.parametrize(
    ("family", "late"), [*((family, True) for family in FAMILIES), (STATE_LQ, False)]
)
def test_a_cell_is_a_run_of_control(quick, family, late):
    """On the same robots, or refused with the same words; torque noise is peak to peak at rest."""
    tuning, law = laws(quick.solution)[family]
    setting = quick.settings[0 if late else 1]
    (cell,) = (trial for trial in quick.of(setting, family) if trial.tuning == tuning)
    pushes = [flexgen.Disturbance("step", motor, 0.5, 0.1) for motor in ("m1", "m2", "m3")]
    pushes.append(flexgen.Disturbance("pulse", "tool.x", 300.0, 0.25, 0.02))
    options = {
        "sample_time": 2e-3,
        "delay": 2e-3 * late,
        "plants": PLANTS,
        "disturbances": {"disturbed": pushes},
        "encoder_noise": MOTOR_NOISE * late,
        "exact_state": not late,
        "torque_limits": False,
        "solution": quick.solution,
    }
    if cell.refused:
        with pytest.raises(ArgumentError) as refused:
            flexgen.control(ARM, controller=law, progress=False, **options)
        assert str(refused.value) == cell.refused and cell.worst_m == np.inf
        return
    run = flexgen.control(ARM, controller=law, progress=False, **options)
    figures = [run.figures(robot) for robot in run.runs]
    for key, found in (
        ("error_max_m", cell.error_m),
        ("dynamic_error_max_m", cell.dynamic_error_m),
    ):
        assert np.allclose([x[key] for x in figures], found, rtol=1e-6, equal_nan=True)
    at_rest = (run.reference.time > -1.0) & (run.reference.time < run.reference.begin)
    noise = np.ptp(run.nominal.tau_m[at_rest], axis=0).max()
    expected = np.nan if run.nominal.failure else noise
    assert cell.torque_noise_Nm == pytest.approx(expected, rel=1e-6, nan_ok=True)


def test_the_best_tuning_is_quiet_and_has_the_smallest_worst_error(quick):
    """Noise counts where the state is not exact; a failed robot has no error."""
    late, exact = quick.settings
    rows = (
        (exact, PD, "a", (1e-3, 4e-3), 99.0),
        (exact, PD, "b", (2e-3, 3e-3), 1.0),
        (exact, PD, "c", (1e-3, np.nan), 1.0),
        (exact, FL, "d", (6e-3, 1e-3), 1.0),
        (exact, PREDICTED, "e", (5e-3,), 1.0),
        (exact, STATE_LQ, "f", (2e-3,), 1.0),
        (late, PD, "g", (1e-3,), 4.1),
        (late, PD, "h", (7e-3,), 4.0),
        (late, FL, "i", (), np.nan),
    )
    trials = tuple(
        Trial(x[0], x[1], x[2], x[3], x[3], x[4], "no" if x[2] == "i" else "") for x in rows
    )
    made = replace(quick, trials=trials, torque_noise_Nm=4.0)
    assert [made.best(s, PD).tuning for s in (exact, late)] == ["b", "h"]
    assert made.best(late, FL) is None and made.ratio(exact) == pytest.approx(2.5)
    assert str(made) == made.table and made.table == (
        "| state exact | motor PD | motor PID | FL | FL, predicted | LQ |\n"
        "|---|---|---|---|---|---|\n"
        "| 2 ms, no delay | 3.00 (b) | none | 6.00 (d) | 5.00 (e) | 2.00 (f) |\n"
        "\n"
        "| measured angles | motor PD | motor PID | FL | FL, predicted | LQ |\n"
        "|---|---|---|---|---|---|\n"
        "| 2 ms, 1 sample | 7.00 at 4.0 N m (h) | none | none | none | none |\n"
    )
    assert str(Setting(1e-3, 2e-3, True)) == "1 ms, 2 samples"
    first, second = json.loads(json.dumps(made.to_dict()))["settings"]
    assert (first["sample_time_s"], first["delay_s"], first["exact_state"]) == (2e-3, 2e-3, False)
    assert second["families"][PD]["best"] == "b"
    assert second["families"][PD]["tunings"][2]["error_m"] == [1e-3, None]
    refused = first["families"][FL]["tunings"][0]
    assert refused["refused"] == "no" and refused["worst_m"] is refused["torque_noise_Nm"] is None


@pytest.mark.slow
def test_tunings_above_the_noise_and_unstable_ones_are_not_chosen(study):
    (setting,) = study.settings
    trials = study.of(setting, FL)
    assert any("unstable" in t.refused for t in trials)
    best = study.best(setting, FL)
    quiet = replace(study, torque_noise_Nm=0.5).best(setting, STATE_LQ)
    assert quiet.torque_noise_Nm <= 0.5 and quiet.worst_m > study.best(setting, STATE_LQ).worst_m
    assert best is not None and best.torque_noise_Nm <= study.torque_noise_Nm and not best.refused
    data = json.loads(json.dumps(study.to_dict()))
    assert data["settings"][0]["families"][FL]["best"] == best.tuning
    assert best.tuning in study.table and len(study.plot().axes) == 1


@pytest.mark.full
@pytest.mark.slow
def test_feedforward_with_lq_is_better_than_feedback_linearisation_where_noise_limits_the_gain():
    """Twice at the least at 0.5 ms, with 4 N m of torque noise, 12 frequencies; measured 3.2."""
    setting = SETTINGS[3]
    found = flexgen.feedback_study(
        settings=(setting,), families=(FL, STATE_LQ), tunings=12, progress=False
    )
    assert found.ratio(setting) > 2


@pytest.mark.slow
def test_slow_poles_are_worse_under_wrong_stiffness(study):
    """Linearizing feedback computes with the wrong model: 8 Hz is unstable where LQ of any weight
    is not.
    """
    (setting,) = study.settings
    slow = study.of(setting, FL)[0]
    assert (
        slow.tuning == "continuous, 8.0 Hz"
        and not np.isfinite(slow.worst_m)
        and slow.error_m[0] < 4e-3
    )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"model": "planar5_nmp"}, "coordinates without motor"),
        ({"families": ("PI",)}, "given families"),
        ({"tunings": 1}, "1 tunings"),
        ({"settings": ()}, "0 settings"),
        ({"torque_noise": 0.0}, "torque_noise 0.0, expected"),
    ],
)
def test_wrong_arguments_are_refused(arguments, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.feedback_study(progress=False, **arguments)
