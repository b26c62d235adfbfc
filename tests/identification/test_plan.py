"""Plans of experiments by other routes: spectra of the loop, information by differences, choices
by trying all, and the limits that a plan keeps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from identification_cases import NOISY, poses_of, small_plan
from numpy.testing import assert_allclose
from scipy.linalg import eigh

import flexgen
from flexgen.analysis.linear import linearize
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.feedback.loop.controllers import Cascade
from flexgen.identification.experiments import operating_points as op
from flexgen.identification.experiments import plan as plans
from flexgen.identification.experiments.excitation import (
    Plan,
    motor_speeds,
    odd_lines,
    speed_amplitudes,
)
from flexgen.identification.experiments.optimal_spectrum import (
    optimal_power,
    with_optimal_spectrum,
)
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.response_inputs import Drive
from flexgen.model.elements import RobotModel

SENSORS = [
    {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2", "noise": 0.02},
    {
        **{"name": "rate", "type": "gyro", "element": "tool", "unit": "rad/s", "noise": 1e-3},
        "sample_s": 1e-3,
    },
    {"name": "seen", "type": "tracker", "unit": "m", "noise": 1e-4},
    {"name": "link", "type": "link_encoder", "coordinate": "q1", "unit": "rad", "noise": 1e-5},
]
SHORT = {"hardware": NOISY, "period_s": 0.25, "f_max": 90.0, "periods": 3, "realizations": 2}


@pytest.fixture(scope="module")
def plan() -> Plan:
    model = flexgen.read("planar5_nmp", overrides={"sensor": SENSORS})
    return with_gains(small_plan(model, poses_of(model, 1), lines=6, **SHORT))


def with_gains(plan: Plan) -> Plan:
    """The plan with all gains of the drives, each another number."""
    gains = np.array([[7.0, 9.0], [30.0, 4.0], [2.0, 3.0]])
    return replace(plan, controller=Cascade(*gains))


def test_torques_of_the_loop_and_their_noise_are_those_of_each_line(plan: Plan) -> None:
    """Line by line, for experiments whose references are orthogonal; white noise of N samples has
    4 / N of its power.
    """
    w = 2 * np.pi * plan.frequencies
    rng = np.random.default_rng(0)
    G = 0.3 * (rng.normal(size=(6, 9, 2)) + 1j * rng.normal(size=(6, 9, 2)))
    found = op.torque_spectra(G[:, :2] * w[:, None, None], w, plan)
    fourier = np.array([[1, 1], [1, -1]])
    for k, at in enumerate(w):
        c = plan.controller
        d = (1 - np.exp(-1j * at * plan.hardware.sample_s)) / plan.hardware.sample_s
        # kv (d + kp) (1 + ki / d)
        K = np.diag(c.speed_gain * (d + c.position_gain) * (1 + c.integral_gain / d))
        r = np.diag(plan.amplitudes[k] / (1j * at)) @ fourier
        U = np.linalg.solve(np.eye(2) - K @ (G[k, :2] * at) / at**2, K @ r)
        assert_allclose(found[k], U @ U.conj().T, rtol=1e-9)


def test_files_of_plans_are_checked(plan: Plan) -> None:
    """Each array that does not fit, and numbers next to their bounds on both sides."""
    arrays, meta = plan.data()
    sample_s = meta["hardware"]["sample_s"]
    period = meta["period_s"]
    n = len(meta["motors"])
    lines = arrays["lines"]
    bad: list[tuple[dict[str, Any], dict[str, Any], str]] = [
        ({"poses": arrays["poses"][:, :1]}, {}, "poses: given the shape"),
        ({"poses": arrays["poses"][:0]}, {}, "poses: given the shape"),
        ({"amplitudes": arrays["amplitudes"][1:]}, {}, "amplitudes: given the shape"),
        ({"phases": arrays["phases"][:, 1:]}, {}, "phases: given the shape"),
        ({"position_gain": np.ones(n + 1)}, {}, "gain 0: given the shape"),
        ({"integral_gain": np.ones(n - 1)}, {}, "gain 2: given the shape"),
        ({}, {"period_s": 1.9 * sample_s}, "lines below half of 2 to 10000000 samples"),
        ({}, {"period_s": (10_000_000 + 1) * sample_s}, "lines and period"),
        ({"lines": lines - lines[0]}, {}, "lines and period"),
        ({"lines": lines + round(period / sample_s / 2) - lines[0]}, {}, "lines and period"),
        ({}, {"periods": 0}, "periods, transients: expected at most 100000"),
        ({}, {"transients": -1}, "periods, transients"),
        ({}, {"transients": 100_001}, "periods, transients"),
    ]
    for changed, other, text in bad:
        with pytest.raises(ValueError, match=text):
            Plan.from_data({**arrays, **changed}, {**meta, **other})
    for more in ({"periods": 1, "transients": 100_000}, {"period_s": 10_000_000 * sample_s}):
        found = Plan.from_data(arrays, meta | more)
        assert {name: getattr(found, name) for name in more} == more
    again, more = Plan.from_data(arrays, meta).data()
    assert more == meta and all(np.array_equal(again[name], arrays[name]) for name in arrays)


def test_references_are_sums_of_sines_that_turn_from_experiment_to_experiment(plan: Plan) -> None:
    """The phase of motor j grows by 2 pi j e / E; the speed has the stated deviation."""
    for r, e in {(0, 0), (plan.realizations - 1, plan.experiments - 1)}:
        t = plan.hardware.sample_s * np.arange(plan.samples)
        found = plan.reference(r, e)
        for j in range(len(plan.motors)):
            w = 2 * np.pi * plan.lines / plan.period_s
            phase = plan.phases[r, :, j] + 2 * np.pi * j * e / plan.experiments
            expected = (plan.amplitudes[:, j] / w * np.sin(np.outer(t, w) + phase)).sum(axis=1)
            assert_allclose(found[:, j], expected, atol=1e-12)
    speed = np.gradient(np.vstack([found, found[:3]]), plan.hardware.sample_s, axis=0)[1:-3]
    assert_allclose(speed.std(axis=0), plan.speed_sd, rtol=0.05)
    assert plan.experiments > 1


def test_noise_of_outputs_has_the_power_of_its_kind() -> None:
    """Angles twice, rates once, accelerations not differentiated; a sensor that samples half as
    often has twice.
    """
    model = flexgen.read("planar5_nmp", overrides={"sensor": SENSORS})
    plan = small_plan(
        model, poses_of(model, 1), hardware=replace(NOISY, encoder_resolution_rad=3e-5), lines=4
    )
    w = 2 * np.pi * plan.frequencies
    assert plan.sensors[:3] == ("acc.x", "acc.y", "acc.z") and plan.sensors[-1] == "link"
    known = {
        "acc": (0.02**2, 0),
        "rate": (2 * 1e-3**2, 1),
        "seen": (1e-4**2, 2),
        "link": (1e-5**2, 2),
    }
    variances = [(1e-4**2 + 3e-5**2 / 12, 2)] * 2 + [
        known[name.partition(".")[0]] for name in plan.sensors
    ]
    n = len(variances)
    G = np.random.default_rng(1).normal(size=(4, n, 2)) + 0.5j
    C = op.noise_covariance(G, w, plan, model)
    samples = round(plan.period_s / 5e-4)
    for k, at in enumerate(w):
        white = np.diag([v * at ** (2 * m) for v, m in variances])
        assert_allclose(C[k], 4 / samples * (0.02**2 * G[k] @ G[k].conj().T + white), rtol=1e-9)
    quiet = op.noise_covariance(
        0 * G,
        w,
        replace(
            plan,
            hardware=replace(
                plan.hardware,
                encoder_noise_rad=0.0,
                encoder_resolution_rad=0.0,
                torque_noise_Nm=0.0,
            ),
        ),
        model,
    )
    assert_allclose(quiet[:, 0, 0].real, 4 / samples * 1e-24 * w**4)


def test_information_is_that_of_differences_of_the_responses() -> None:
    """``2 P R sum Re tr (dG U)^H C^-1 (dG U)`` with central differences in x: delays, constants
    and ties included.
    """
    model = flexgen.read("planar5_nmp", overrides={"sensor": SENSORS[1:2]})
    plan = with_gains(small_plan(model, poses_of(model, 1), lines=5, **SHORT))
    free = [
        "q1.stiffness",
        "q2.damping",
        "q3.stiffness",
        "m1.torque_constant",
        "delay",
        "rate.delay",
    ]
    vector = ParameterVector(
        model, free, ties={"q2.stiffness": "q1.stiffness"}, start={"m1.torque_constant": 1.1}
    )
    local = LocalModel(model, vector.of_model, plan.sensors)
    w = 2 * np.pi * plan.frequencies
    x = vector.start

    def responses(x: np.ndarray) -> np.ndarray:
        named = vector.named(x)
        drive = vector.drive_at(x, Drive(5e-4, plan.hardware.delay_s, has_images=False))
        values = np.array([named[name] for name in local.names])
        return local.response(
            values, plan.poses, w, drive, speed_sd=plan.speed_sd, derivatives=False
        ).G[0]

    steps = np.array([1e-8 if name.endswith("delay") else 1e-5 for name in vector.names])
    slopes = [
        (responses(x + h * e) - responses(x - h * e)) / (2 * h)
        for h, e in zip(steps, np.eye(len(x)), strict=True)
    ]
    G = responses(x)
    U2 = op.torque_spectra(G[:, :2], w, plan)
    C = op.noise_covariance(G, w, plan, model)
    expected = np.zeros((5, len(x), len(x)))
    for k in range(5):
        inverse = np.linalg.inv(C[k])
        for a in range(len(x)):
            for b in range(len(x)):
                part = np.trace(slopes[a][k].conj().T @ inverse @ slopes[b][k] @ U2[k])
                expected[k, a, b] = 2 * 3 * 2 * part.real
    found = op.information_by_line(vector, plan, plan.poses[0])
    size = np.sqrt(np.einsum("kaa,kbb->kab", expected, expected))
    assert np.abs((found - expected) / size).max() < 1e-4
    whole, used = op.information(vector, plan, plan.poses)
    assert (
        used.tolist() == [0]
        and np.abs(whole[0] - found.sum(axis=0)).max() <= 1e-9 * np.abs(whole).max()
    )
    thinned, _ = op.information(vector, plan, plan.poses, every=2)
    assert_allclose(thinned[0], 2 * found[1::2].sum(axis=0), rtol=1e-9)
    said: list[str] = []
    op.information(vector, plan, np.vstack([plan.poses, plan.poses + 0.1]), progress=said.append)
    assert said == ["pose 1 of 2", "pose 2 of 2"]


def test_the_best_poses_are_those_of_all_pairs() -> None:
    """Variances and determinants of all pairs, priors included; frictions do not count unless they
    are named.
    """
    model = flexgen.read("planar5_nmp")
    vector = ParameterVector(
        model, ["q1.stiffness", "q2.stiffness", "m1.viscous"], priors={"q1.stiffness": 0.7}
    )
    rng = np.random.default_rng(3)
    roots = rng.normal(size=(7, 3, 3)) * np.array([1.0, 2.0, 9.0])
    F = roots @ roots.swapaxes(-1, -2)
    assert_allclose(
        op.covariance(F, vector.prior_sd),
        [np.linalg.inv(f + np.diag([0.7**-2, 0.25, 0.25])) for f in F],
    )
    for names, target in ((None, [0, 1]), (["m1.viscous"], [2]), (["none"], [0, 1, 2])):
        assert op.count_parameters(vector, names).nonzero()[0].tolist() == target
        for criterion in ("A", "D"):
            costs = {}
            for pair in combinations(range(7), 2):
                block = np.linalg.inv(F[list(pair)].sum(axis=0) + np.diag(vector.prior_sd**-2.0))[
                    np.ix_(target, target)
                ]
                costs[pair] = np.trace(block) if criterion == "A" else np.linalg.det(block)
            found = op.choose(F, 2, vector, criterion, names)
            assert tuple(sorted(found)) == min(costs, key=lambda pair: costs[pair])
    assert sorted(op.choose(F, 7, vector, "A")) == list(range(7))
    with pytest.raises(
        ArgumentError, match=r"poses: given 8, expected at most 7, the number of candidates"
    ):
        op.choose(F, 8, vector, "A")
    with pytest.raises(
        ArgumentError, match=r"criterion: given 'random', expected one of A, D, random"
    ):
        op.choose(F, 2, vector, "random")


@pytest.mark.parametrize("criterion", ["A", "D"])
def test_no_exchange_of_one_pose_helps(criterion: str) -> None:
    """Of draws in which the greedy choice and one round of exchanges end elsewhere."""
    names = ["q1.stiffness", "q2.stiffness", "q3.stiffness", "q1.damping", "q2.damping"]
    vector = ParameterVector(flexgen.read("planar5_nmp"), names)

    def cost(F: np.ndarray, chosen: Sequence[int]) -> float:
        C = np.linalg.inv(F[list(chosen)].sum(axis=0) + np.diag(vector.prior_sd**-2.0))
        return float(np.trace(C) if criterion == "A" else np.linalg.slogdet(C)[1])

    for seed in (0, 8, 14, 53, 100, 124):
        roots = (
            np.random.default_rng(seed).normal(size=(14, 5, 1)) * 10.0 ** np.arange(-1, 4)[:, None]
        )
        F = roots @ roots.swapaxes(-1, -2)
        found = op.choose(F, 5, vector, criterion)
        best = cost(F, found)
        for k, other in product(range(5), set(range(14)) - set(found)):
            swapped = [*found[:k], other, *found[k + 1 :]]
            assert cost(F, swapped) > best - 1e-8 * abs(best)


def test_candidates_fill_the_limits_of_the_joints() -> None:
    model = flexgen.read("planar5_nmp")
    e0 = model.elements[0]
    dofs = tuple(replace(d, lower=-0.3, upper=0.1) if d.name == "q1" else d for d in e0.dofs)
    model = replace(model, elements=(replace(e0, dofs=dofs), *model.elements[1:]))
    q = op.candidates(model, 400, 0) @ np.linalg.inv(model.eta).T
    assert q.shape == (400, 2) and -0.3 <= q[:, 0].min() < -0.29 and 0.09 < q[:, 0].max() <= 0.1
    away = q[:, 1] - model.home[1]
    assert -1.0 <= away.min() < -0.98 and 0.98 < away.max() <= 1.0
    assert_allclose(q, op.candidates(model, 400, 0) @ np.linalg.inv(model.eta).T)


def test_the_optimal_spectrum_keeps_half_of_the_power_and_its_sum() -> None:
    model = flexgen.read("planar5_nmp")
    names = ("q1.stiffness", "q2.stiffness")
    vector = ParameterVector(model, names, priors=dict.fromkeys(names, 1e6))
    plan = small_plan(
        model, poses_of(model, 2), hardware=NOISY, period_s=0.25, f_max=90.0, lines=5
    )
    found = with_optimal_spectrum(plan, vector)
    assert_allclose((found.amplitudes**2).sum(axis=0), (plan.amplitudes**2).sum(axis=0))
    share = plan.amplitudes[:, 0] ** 2 / (plan.amplitudes[:, 0] ** 2).sum()
    lines = sum(op.information_by_line(vector, plan, pose) for pose in plan.poses)
    best = optimal_power(lines / share[:, None, None], vector)
    assert_allclose(
        found.amplitudes[:, 0] ** 2 / (plan.amplitudes[:, 0] ** 2).sum(),
        (share + best) / 2,
        rtol=1e-6,
    )


def test_the_drive_of_a_plan_follows_from_the_inertias() -> None:
    """8 Hz with stiff springs; less where the motors alone are light: 0.3 of the inertia over the
    sample time.
    """
    model = flexgen.read("elbow")
    q = np.array(model.home)
    M = np.array(flexgen.derive(model).function("mass_matrix")(q))
    inertia = np.array([m.inertia for m in model.motors])
    inverse = np.linalg.inv(model.eta)
    stiff = np.diag(inverse.T @ M @ inverse) + inertia
    slow = plans.default_cascade(model, 1e-6)
    assert_allclose(slow.speed_gain, stiff * 16 * np.pi, rtol=1e-6)
    assert_allclose(slow.position_gain, 8.0)
    assert_allclose(slow.integral_gain, 0.0)
    fast = plans.default_cascade(model, 0.05)
    assert_allclose(fast.speed_gain, 0.3 * inertia / 0.05, rtol=1e-6)


def test_poses_at_random_are_the_candidates_and_chosen_ones_are_the_best(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = flexgen.read("planar5_nmp")
    common = {"period_s": 0.5, "f_max": 60.0, "lines": 4, "free": ["stiffness"]}
    loose = flexgen.excite(model, poses=3, criterion="random", seed=5, **common)
    assert_allclose(loose.poses, op.candidates(model, 3, 5))
    monkeypatch.setattr(plans, "CANDIDATES", 6)
    plan = flexgen.excite(model, poses=2, criterion="D", seed=5, **common)
    vector = ParameterVector(model, ["stiffness"])
    offered = op.candidates(model, 6, 5)
    F, used = op.information(vector, plan, offered)
    assert_allclose(plan.poses, offered[used[sorted(op.choose(F, 2, vector, "D"))]])
    total = np.linalg.inv(
        F[[np.abs(offered - p).sum(axis=1).argmin() for p in plan.poses]].sum(axis=0)
        + np.eye(3) / 4
    )
    assert_allclose(list(plan.predicted.values()), np.sqrt(np.diag(total)), rtol=1e-6)
    assert list(plan.predicted) == list(vector.names)


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


def test_a_band_reaches_from_an_eighth_of_the_lowest_frequency() -> None:
    """To one and a half of the highest, a fifth of the sample rate at most, unless it is given."""
    model = flexgen.read("elbow")
    equations = flexgen.derive(model)
    linear = linearize(equations, hold_joints(equations, np.array(model.home)))
    squares = np.sort(eigh(linear.K, linear.M, eigvals_only=True))
    hz = np.sqrt(squares[model.n_m :]) / (2 * np.pi)  # the motors are free

    def ends(sample_s: float, name: str = "elbow", **given: float) -> np.ndarray:
        hardware = replace(NOISY, sample_s=sample_s)
        found = flexgen.excite(
            name, poses=[[0.1, 0.2]], period_s=10.0, lines=3, hardware=hardware, **given
        )
        return found.frequencies[[0, -1]]

    # odd multiples of a tenth
    assert_allclose(ends(1e-3), [hz[0] / 8 + 0.1, 1.5 * hz[-1] - 0.1], atol=0.1)
    assert_allclose(ends(0.01), [hz[0] / 8 + 0.1, 19.9], atol=0.1)
    assert_allclose(ends(0.01, f_min=1.0, f_max=44.0), [1.1, 43.9], atol=1e-9)
    with pytest.raises(
        ArgumentError,
        match=r"f_max: given 46.0 Hz, expected at most 45 Hz for a sample time of 0.01 s",
    ):
        ends(0.01, f_max=46.0)
    with pytest.raises(
        ArgumentError, match=r"the model elbow has no elastic natural frequency; name a band in Hz"
    ):
        ends(0.01, "elbow@rigid", f_max=10.0)


def test_a_plan_that_leaves_limits_is_refused() -> None:
    """Reach: angle and swing of a joint; speed: differences of the references, of motors and of
    joints.
    """
    model = flexgen.read("elbow")
    pose = np.array([[0.1, 0.2]])

    def made(robot: RobotModel, **given: Any) -> Plan:
        free = {"free": ["stiffness"], "period_s": 0.5, "lines": 4, "speed_rms": 0.02}
        return flexgen.excite(robot, **{"poses": pose, **free, **given})

    def limited(**limits: float) -> RobotModel:
        e0 = model.elements[0]
        dofs = tuple(replace(d, **limits) if d.name == "q1" else d for d in e0.dofs)
        return replace(model, elements=(replace(e0, dofs=dofs), *model.elements[1:]))

    plan = made(model)
    turns = [plan.reference(0, e) for e in range(2)]
    inverse = np.linalg.inv(model.eta)
    room = float((np.abs(inverse) @ np.max([np.abs(x).max(axis=0) for x in turns], axis=0))[0])
    for name, sign in (("upper", 1.0), ("lower", -1.0)):
        edge = 0.1 + sign * room
        made(limited(**{name: edge + sign * 1e-9}))
        reaches = f"pose 1: the motion of q1 reaches {edge:.4g}, expected within .*; take less"
        with pytest.raises(ArgumentError, match=reaches):
            made(limited(**{name: edge - sign * 1e-9}))
        with pytest.raises(
            ArgumentError, match="no pose has room for the motion; for example, the motion of"
        ):
            made(limited(lower=0.1 - 0.5 * room, upper=0.1 + 0.5 * room), poses=2)
    rates = [np.diff(np.vstack([x, x[:1]]), axis=0) / 5e-4 for x in turns]
    joint = max(np.abs(x @ inverse.T).max(axis=0)[0] for x in rates)
    motor = max(np.abs(x).max(axis=0)[1] for x in rates)
    fast = replace(model.motors[1], speed_max=motor * 1.0001)
    made(replace(limited(speed_max=joint * 1.0001), motors=(model.motors[0], fast)))
    slow = replace(model, motors=(model.motors[0], replace(fast, speed_max=motor * 0.9999)))
    for robot, text in (
        (limited(speed_max=joint * 0.9999), f"speed_rms: joint q1 would reach {joint:.4g}, exp"),
        (slow, f"speed_rms: motor m2 would reach {motor:.4g}, expected at most"),
    ):
        with pytest.raises(ArgumentError, match=text):
            made(robot)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        (
            {"poses": np.zeros((1, 3))},
            "poses: given an array of shape (1, 3), expected (poses, 2)",
        ),
        ({"poses": 0}, "poses, criterion: given 0, 'A', expected >= 1 and one of A, D, random"),
        ({"poses": 2, "criterion": "worst"}, "criterion: given 'worst', expected "),
        ({"spectrum": "best"}, "spectrum: given 'best', expected a power of the frequency, or "),
    ],
)
def test_arguments_of_a_plan_that_are_refused(given: dict[str, Any], text: str) -> None:
    with pytest.raises(ArgumentError) as caught:
        flexgen.excite("elbow", **{"poses": [[0.1, 0.2]], **given})
    assert text in str(caught.value)
