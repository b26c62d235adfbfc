"""Small identifications of a robot that is known: its springs are found; other numbers are those
measured before.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from identification_cases import NOISY, another, poses_of, small_plan, without_coulomb
from measured_numbers import check_numbers
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.identification.experiments.excitation import motor_speeds, odd_lines, speed_amplitudes
from flexgen.identification.motions import time_domain
from flexgen.identification.motions.motion_fit import fit_motion
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.responses.result import FitStatus
from flexgen.views.reports.identification_texts import text_of_responses


def springs(model: object) -> dict[str, float]:
    coordinates = [model.coordinates[i] for i in model.i_g]
    return {f"{c.name}.stiffness": c.dof.gear.spring.stiffness for c in coordinates}


@pytest.mark.slow
def test_a_short_experiment_is_refined_in_the_time_domain() -> None:
    model = without_coulomb("planar5_nmp")
    truth = another(model, 3)
    plan = small_plan(
        model, poses_of(model, 1), hardware=NOISY, period_s=0.25, f_max=60.0, lines=5
    )
    experiment = flexgen.measure(plan, truth, seed=1, progress=False)
    free = ["q1.stiffness", "q2.damping"]
    data = flexgen.frf(experiment)
    first = flexgen.identify(truth, data, free=free, starts=1, progress=False)
    found = flexgen.refine(first, experiment, runs=1, free=free, progress=False)
    known = springs(truth)["q1.stiffness"]
    assert springs(found.model)["q1.stiffness"] == pytest.approx(known, rel=0.02)
    assert springs(first.model)["q1.stiffness"] == pytest.approx(known, rel=0.1)
    figures = first.to_dict(), found.to_dict()
    check_numbers("refine", 1e-5, data=data, first=first, found=found, figures=figures)


def test_a_tenth_of_a_second_of_motion_gives_a_spring(tmp_path: Path) -> None:
    model = flexgen.read("planar5_nmp")
    truth = another(model, seed=5)
    plan = flexgen.excite(
        model,
        poses=poses_of(model, 1),
        speed_rms=0.1,
        f_max=80.0,
        hardware=DriveHardware(1e-3),
        period_s=0.05,
        periods=2,
        lines=4,
    )
    writer = RecordingWriter(tmp_path, plan, model)
    flexgen.measure(plan, truth, raw=writer)
    path = writer.finish()
    rows = [
        x for x in path.read_text().splitlines() if not x.startswith(("period_s", "line_numbers"))
    ]
    path.write_text("\n".join(rows))
    values = {
        f"{c.name}.{kind}": x
        for c in (truth.coordinates[i] for i in truth.i_g)
        for kind, x in (
            ("stiffness", c.dof.gear.spring.stiffness),
            ("damping", c.dof.gear.damping),
        )
    }
    start = {"q1.stiffness": 1.2 * values["q1.stiffness"]}
    found = fit_motion(truth, path, free=["q1.stiffness"], segment_s=0.02, start=start)
    assert 0 < found.wall_s < 600
    assert springs(found.model)["q1.stiffness"] == pytest.approx(values["q1.stiffness"], rel=1e-3)
    figures = found.to_dict()
    del figures["parameters"][0]["sd"]  # without noise it is that of rounding
    check_numbers("motion_fit", 1e-5, found=found, figures=figures)
    # Priors that are far narrower than what the data show: the deviations are those of the priors.
    priors = {"q1.stiffness": 1e-11, "q2.stiffness": 2e-11}
    known = fit_motion(
        truth, path, free=list(priors), segment_s=0.02, priors=priors, validate=path
    )
    assert_allclose(known.formal_covariance, np.diag([1e-22, 4e-22]), rtol=1e-3, atol=1e-26)
    assert springs(known.model) == pytest.approx(springs(truth), rel=1e-9)
    # Validated by the same recordings: what was not fitted is explained as well as what was.
    assert_allclose(known.held_out_percent, known.fit_percent, atol=1e-3)
    assert repr(known).endswith(f" {found.segments} segments>") and "fit 100.0 %, 100.0 %" in repr(
        known
    )
    assert found.held_out_percent == () and known.segments == found.segments
    for given, text in (
        ({"segment_s": 1e-3}, "expected at least 4 samples"),
        ({"free": []}, "free: given no parameter"),
    ):
        with pytest.raises(ArgumentError, match=text):
            fit_motion(truth, path, **{"free": ["q1.stiffness"], **given})


def test_odd_lines_are_spaced_evenly_in_the_logarithm() -> None:
    assert odd_lines(0.5, 10.0, 12, 2.0).tolist() == list(range(1, 20, 2))
    assert odd_lines(0.6, 9.4, 12, 2.0).tolist() == list(range(3, 18, 2))
    assert odd_lines(1.0, 500.0, 3, 1.0).tolist() == [1, 23, 499]
    some = odd_lines(0.5, 10.0, 6, 2.0)
    assert len(some) <= 6 and some[0] == 1 and some[-1] == 19 and np.all(some % 2 == 1)
    for given, text in (
        ((0.0, 1.0, 3, 1.0), r"f_min, f_max: given 0\.0, 1\.0, expected 0 < f_min < f_max in Hz"),
        ((2.0, 2.0, 3, 1.0), "f_min, f_max: given"),
        (
            (2.1, 2.9, 3, 1.0),
            r"period_s: given 1\.0 s, which has no odd multiple of 1 Hz between 2\.1 and 2\.9 Hz",
        ),
    ):
        with pytest.raises(ArgumentError, match=text):
            odd_lines(*given)


def test_speeds_of_motors_add_up_over_the_joints_that_they_drive() -> None:
    model = flexgen.read("planar5_nmp")
    expected = np.sqrt((np.array(model.eta) ** 2) @ [0.04, 0.09])
    assert_allclose(motor_speeds(model, np.array([0.2, 0.3])), expected)
    assert_allclose(motor_speeds(model, 0.2), np.sqrt((np.array(model.eta) ** 2) @ [0.04, 0.04]))
    for bad in (0.0, np.inf, np.array([0.1, -0.1])):
        with pytest.raises(
            ArgumentError, match=r"speed_rms: given .*, expected a speed > 0 in rad/s or m/s"
        ):
            motor_speeds(model, bad)
    amplitudes = speed_amplitudes(np.array([1.0, 4.0]), np.array([3.0, 5.0]), 0.5)
    assert_allclose(amplitudes[1], 2 * amplitudes[0])
    assert_allclose(amplitudes[:, 1], 5 / 3 * amplitudes[:, 0])


def test_references_for_a_drive_are_periods_about_the_pose(tmp_path: Path) -> None:
    """The folder may be new; the mean of a period is the pose, and speeds are the slopes of the
    angles.
    """
    pose = [0.5, -0.3]
    plan = flexgen.excite("elbow", poses=[pose], period_s=1.0, lines=10)
    files = plan.write_references(tmp_path / "new" / "folder")
    assert [file.name for file in files] == [
        f"pose1_realization1_experiment{k}.csv" for k in (1, 2)
    ]
    for file in files:
        head, *rows = file.read_text().splitlines()
        assert head == "t,m1_q_ref_rad,m2_q_ref_rad,m1_v_ref_rad_s,m2_v_ref_rad_s"
        t, q, v = np.split(
            np.array([[float(x) for x in row.split(",")] for row in rows]), [1, 3], axis=1
        )
        step = plan.hardware.sample_s
        assert_allclose(t[:, 0], step * np.arange(len(t)), atol=1e-12)
        assert len(t) * step == pytest.approx(1.0)
        assert_allclose(q.mean(axis=0), flexgen.read("elbow").eta @ pose, atol=1e-9)
        slope = (np.roll(q, -1, axis=0) - np.roll(q, 1, axis=0)) / (2 * step)
        assert_allclose(v, slope, atol=0.05 * np.abs(v).max())  # of the fastest line, 67 Hz
        assert_allclose(v.std(axis=0), plan.speed_sd, rtol=1e-6)


def test_responses_in_words_have_their_relative_deviation() -> None:
    size = np.array([[[[2.0]], [[4.0]], [[5.0]]]])
    data = flexgen.frf(
        flexgen.measure(flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10))
    )
    data = replace(data, G=size + 0j, variance=(size * [[[[0.01]], [[0.03]], [[0.2]]]]) ** 2)
    assert text_of_responses(data).endswith("median standard deviation by noise: 3 %")


@pytest.mark.parametrize(
    ("experiments", "realizations", "several"), [(1, 1, False), (2, 1, True), (1, 2, True)]
)
def test_parameters_are_validated_where_there_is_another_experiment(
    experiments: int, realizations: int, several: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    early = SimpleNamespace(status=SimpleNamespace(ended_early=False))
    monkeypatch.setattr(time_domain, "refine", lambda found, experiment, **more: early)
    monkeypatch.setattr(time_domain, "validate", lambda fine, experiment: "checked")
    monkeypatch.setattr(time_domain, "validate_on_others", lambda fine, checked: (fine, checked))
    given: Any = SimpleNamespace(
        plan=SimpleNamespace(experiments=experiments, realizations=realizations)
    )
    found: Any = "fit"
    expected: Any = ((early, "checked"), "checked") if several else (early, None)
    assert time_domain.refine_and_validate(found, given) == expected


def test_frictions_of_a_model_are_those_of_its_motors_and_joints() -> None:
    """Numbers above zero; beta only with a Coulomb friction."""
    none = SimpleNamespace(viscous=0.0, coulomb=0.0, beta=9.0)
    motor = SimpleNamespace(
        name="m1", friction=SimpleNamespace(viscous=0.5, coulomb=0.9, beta=9.0)
    )
    joints = [
        SimpleNamespace(name="q1", dof=SimpleNamespace(friction=none)),
        SimpleNamespace(
            name="q2",
            dof=SimpleNamespace(friction=SimpleNamespace(viscous=0.1, coulomb=0.0, beta=9.0)),
        ),
        SimpleNamespace(name="bend", dof=None),
        SimpleNamespace(
            name="q3",
            dof=SimpleNamespace(friction=SimpleNamespace(load_coulomb=0.1, coulomb=0.0, beta=9.0)),
        ),
    ]
    found: Any = SimpleNamespace(
        vector=SimpleNamespace(model=SimpleNamespace(motors=[motor], coordinates=joints))
    )
    assert sorted(time_domain.frictions_of(found)) == [
        "m1.beta",
        "m1.coulomb",
        "m1.viscous",
        "q2.viscous",
        "q3.beta",
        "q3.load_coulomb",
    ]


def test_deviations_of_spectra_are_means_over_seven_lines() -> None:
    """Of robots together; a millionth of the signal is added, so that nothing is divided by
    zero.
    """
    rng = np.random.default_rng(4)
    x = 0.1 * (rng.normal(size=(3, 5, 12, 2)) + 1j * rng.normal(size=(3, 5, 12, 2))) + 7.0
    found = time_domain._standard_deviation(x)
    variance = np.array(
        [[np.var(x[r, :, line], axis=0, ddof=1) for line in range(12)] for r in range(3)]
    ).mean(axis=0)
    for line in range(12):
        near = range(max(0, line - 3), min(12, line + 4))
        expected = np.mean([variance[k] for k in near], axis=0) / 5 + 1e-12 * (
            np.abs(x[:, :, line]) ** 2
        ).mean((0, 1))
        assert_allclose(found[0, line], np.sqrt(expected), rtol=1e-9)
    still = time_domain._standard_deviation(np.full((1, 2, 3, 1), 5.0 + 0j))
    assert_allclose(still, 5e-6, rtol=1e-9)


@pytest.mark.parametrize(
    ("converged", "at_bound", "cost", "error", "bent", "before", "status"),
    [
        (False, False, 1.0, 0.0, False, "FITTED", "NOT_CONVERGED"),
        (False, True, 1.0, 0.0, False, "FITTED", "NOT_CONVERGED"),
        (True, True, 1.0, 0.0, False, "FITTED", "AT_BOUND"),
        (True, False, 2.0, 1.01, False, "FITTED", "FITTED"),
        (True, False, 2.01, 0.99, False, "FITTED", "SMALL_ERROR"),
        (True, False, 2.01, 1.01, True, "FITTED", "MODEL_ERROR"),
        (True, False, 1.0, 0.0, False, "MODEL_ERROR", "MODEL_ERROR"),
        (True, False, 1.0, 0.0, True, "MODEL_ERROR", "FITTED"),
    ],
)
def test_the_status_of_a_fit_in_time_follows_from_search_cost_and_size(
    converged: bool,
    at_bound: bool,
    cost: float,
    error: float,
    bent: bool,
    before: str,
    status: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """``error``: of the angles, over the largest that is small; ``bent``: friction that responses
    do not describe.
    """
    monkeypatch.setattr(
        time_domain, "frictions_of", lambda found: ["m1.load_coulomb"] if bent else ["m1.viscous"]
    )
    fit: Any = SimpleNamespace(converged=converged, at_bound=np.array([False, at_bound]), x=2.0)
    measured = np.array([3.0, 4.0])
    simulated: Any = SimpleNamespace(
        residual=lambda x: x * error * time_domain.SMALL_ERROR * measured / 2.0 / 0.5,
        sd=0.5,
        measured=measured,
        local=SimpleNamespace(springs=()),
    )
    found: Any = SimpleNamespace(status=FitStatus[before])
    assert time_domain.refined_status(fit, cost, simulated, found) == FitStatus[status]
    assert FitStatus[status].agrees == (status in ("FITTED", "SMALL_ERROR"))


def test_the_damping_of_a_robot_with_one_joint_is_found(tmp_path: Path) -> None:
    """Within four standard deviations, which are relative, of a simulated experiment."""
    (tmp_path / "arm.toml").write_text(
        'name = "arm"\n'
        'description = "one link"\n'
        "gravity = [0.0, 0.0, -9.81]\n"
        "home_rad = [0.5]\n"
        "[[element]]\n"
        'name = "link"\n'
        "body = { mass = 10.0, com = [0, 0, 0.4], inertia = [0.5, 0.5, 0.1] }\n"
        "[[element.dof]]\n"
        'name = "q1"\n'
        'type = "rotation"\n'
        "axis = [0, 1, 0]\n"
        'gear = { type = "rigid" }\n'
        'friction = { type = "smooth", viscous = 60.0 }\n'
        "[[motor]]\n"
        'name = "m1"\n'
        'drives = "q1"\n'
        "ratio = 100.0\n"
        "inertia = 1e-4\n"
        "[output]\n"
        'type = "joint"\n'
        'joints = ["q1"]\n'
    )
    model = flexgen.read(tmp_path / "arm.toml")
    drive = flexgen.DriveHardware(1e-3, encoder_noise_rad=1e-5, torque_noise_Nm=1e-3)
    plan = flexgen.excite(
        model,
        poses=[[0.5], [1.0]],
        period_s=1.0,
        lines=10,
        f_min=1.0,
        f_max=50.0,
        free=["q1.viscous"],
        hardware=drive,
    )
    responses = flexgen.frf(flexgen.measure(plan, model, progress=False))
    found = flexgen.identify(model, responses, starts=1, free=["q1.viscous"], progress=False)
    assert found.status == FitStatus.FITTED and found.sd["q1.viscous"] < 0.01
    assert abs(np.log(found.values["q1.viscous"] / 60.0)) < 4 * found.sd["q1.viscous"]
