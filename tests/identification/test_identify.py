"""Gray-box identification: what it finds, how sure it says to be, and what it does not claim."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from gear_friction import loaded
from identification_cases import (
    NOISY,
    another,
    exact_responses,
    poses_of,
    small_plan,
    without_coulomb,
)
from measured_numbers import check_numbers
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, ModelError, SolverError
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.motions.time_domain import Simulated, validate
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.response_inputs import Drive
from flexgen.identification.responses.result import FitStatus
from flexgen.views.reports.identification_page import write_identification

W = 2 * np.pi * np.geomspace(1.0, 120.0, 40)
DRIVE = Drive(5e-4)
FREE = ("stiffness", "damping")
ROBOTS = Path(__file__).parents[1] / "support" / "robots"


def truth_of(model, names=FREE):
    return {p.name: p.value for p in select(model, names)}


def errors(found, true):
    """Errors of the logarithms."""
    return {name: float(np.log(found.values[name] / value)) for name, value in true.items()}


# --- exact data ----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "name", ["planar5_nmp", "manutec_r3", pytest.param("manutec_r3_18", marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("residual", ["nls", "lls"])
def test_exact_responses_give_exact_parameters(name, residual):
    """From start values off by factors up to 3."""
    truth = without_coulomb(name)
    data = exact_responses(truth, poses_of(truth, 3), W, DRIVE)
    start = another(truth, 3, np.log(3.0))
    found = flexgen.identify(
        start, data, free=FREE, residual=residual, starts=2, spread=1.5, progress=False
    )
    assert max(map(abs, errors(found, truth_of(truth)).values())) < 1e-6
    assert found.agreed == found.starts == 2 and found.cost < 1e-6


@pytest.mark.slow
def test_delay_torque_constants_inertias_and_new_frictions_are_found():
    """Terms that the file does not have, and those of the drives."""
    plain = without_coulomb("planar5_nmp")
    true = {"m1.viscous": 0.02, "m2.viscous": 0.01, "m1.inertia": 1.1 * plain.motors[0].inertia}
    truth = with_values(plain, true)
    drive = Drive(5e-4, 1.3e-4, (1.0, 0.97))
    data = replace(exact_responses(truth, poses_of(truth, 3), W, drive), delay_s=0.0)
    base = with_values(plain, {"m1.viscous": 0.0, "m2.viscous": 0.0})
    free = [*FREE, "m1.viscous", "m2.viscous", "m1.inertia", "delay", "m2.torque_constant"]
    found = flexgen.identify(
        base,
        data,
        free=free,
        start={"m1.viscous": 5e-3, "m2.viscous": 5e-3},
        starts=1,
        progress=False,
    )
    for name, value in {**true, "delay": 1.3e-4, "m2.torque_constant": 0.97}.items():
        assert found.values[name] == pytest.approx(value, rel=1e-5), name
    left_out = flexgen.identify(base, data, free=FREE, starts=1, progress=False)
    assert left_out.status == FitStatus.MODEL_ERROR and left_out.model_error > 0.01


@pytest.mark.parametrize("bug", ["transposed", "damper", "spring missing", "hold"])
def test_a_wrong_model_is_a_model_error(bug):
    """Planted: what a fit cannot explain must not end as 'fitted'."""
    truth = without_coulomb("planar5_nmp")
    data = exact_responses(truth, poses_of(truth, 3), W, DRIVE)
    model = truth
    if bug == "transposed":
        data = replace(data, G=data.G.conj())  # a phase of the wrong sign
    if bug == "damper":
        # losses that no damper of the model has
        data = replace(data, G=data.G * (1 + 0.05j * np.eye(2)[0]))
    if bug == "spring missing":
        stiff = {"q3.stiffness": 1e9, "q3.damping": 1e3}
        model = with_values(truth, stiff)
    if bug == "hold":
        data = replace(data, sample_s=0.0)
    fixed = ["q3.stiffness", "q3.damping"] if bug == "spring missing" else []
    found = flexgen.identify(model, data, free=FREE, fixed=fixed, starts=1, progress=False)
    assert found.status in (FitStatus.MODEL_ERROR, FitStatus.AT_BOUND, FitStatus.NOT_CONVERGED)
    assert found.status.sentence and found.status.advice


@pytest.mark.parametrize("fault", ["mass of the last body 20 % larger", "sample time 1 % shorter"])
def test_under_a_model_error_no_standard_deviations_are_stated(fault, tmp_path):
    """The largest error is more than 10 formal deviations; result, report and model file state
    none.
    """
    truth = without_coulomb("planar5_nmp")
    last = truth.elements[-1]
    robot = (
        with_values(truth, {f"{last.name}.mass": 1.2 * last.body.mass})
        if "mass" in fault
        else truth
    )
    data = exact_responses(robot, poses_of(truth, 3), W, DRIVE)
    if "sample" in fault:
        # times 1.01 times as long as they are
        data = replace(data, w=data.w / 1.01, G=data.G / 1.01**2)
    found = flexgen.identify(truth, data, free=FREE, starts=1, progress=False)
    assert found.status == FitStatus.MODEL_ERROR
    away = np.abs(list(errors(found, truth_of(truth)).values()))
    assert (away / np.sqrt(np.diag(found.formal_covariance))).max() > 10
    assert found.covariance is None and set(found.sd.values()) == {None}
    assert {row["sd"] for row in found.to_dict()["parameters"]} == {None}
    if "sample" in fault:  # pictures take seconds, and that case is slow
        page = write_identification(found, tmp_path / "page").read_text()
        cells = re.findall(r"stiffness</td><td[^>]*>.*?</td><td>[^<]*</td><td[^>]*>([^<]*)", page)
        assert cells == ["-"] * 3
    old = tmp_path / "old.toml"  # whose comments are those of an earlier identification
    exact = flexgen.identify(
        truth,
        exact_responses(truth, data.poses @ np.linalg.inv(truth.eta), W, DRIVE),
        free=FREE,
        starts=1,
        progress=False,
    )
    assert "# q1.stiffness: sd " in exact.write(old).read_text()
    text = found.write(tmp_path / "new.toml", old).read_text()
    assert ": sd " not in text and text.startswith("# Status: model error.\n")
    assert "model error, no standard deviations" in text.splitlines()[2]
    assert flexgen.read(tmp_path / "new.toml").elements == found.model.elements
    with pytest.raises(ArgumentError, match="which has no covariance to draw robots from"):
        found.verdict("line", progress=False)


def test_a_parameter_at_its_bound_is_named():
    truth = without_coulomb("planar5_nmp")
    data = exact_responses(truth, poses_of(truth, 2), W, DRIVE)
    value = truth_of(truth)["q1.stiffness"]
    found = flexgen.identify(
        truth,
        data,
        free=FREE,
        start={"q1.stiffness": 2 * value},
        bounds={"q1.stiffness": (1.5 * value, 3 * value)},
        starts=1,
        floor=0.0,
        progress=False,
    )
    assert found.status == FitStatus.AT_BOUND and found.at_bound == ("q1.stiffness",)


def test_parameters_that_the_data_do_not_show_are_reported_and_kept(tmp_path):
    """A motor friction far below what the band can show."""
    truth = without_coulomb("planar5_nmp")
    tiny = with_values(truth, {"m1.viscous": 1e-9})
    data = exact_responses(tiny, poses_of(tiny, 2), W, DRIVE)
    found = flexgen.identify(tiny, data, free=[*FREE, "m1.viscous"], starts=1, progress=False)
    assert found.is_weak("m1.viscous") and any(
        line.startswith("m1.viscous is not") for line in found.weak
    )
    assert "m1.viscous" not in found.used()
    assert found.model.motors[0].friction.viscous == 1e-9


def test_tied_parameters_keep_their_ratio():
    truth = without_coulomb("planar5_nmp")
    data = exact_responses(truth, poses_of(truth, 2), W, DRIVE)
    base = with_values(
        truth,
        {
            "q1.damping": 2 * truth_of(truth)["q1.damping"],
            "q2.damping": 2 * truth_of(truth)["q2.damping"],
        },
    )
    found = flexgen.identify(
        base, data, free=FREE, ties={"q2.damping": "q1.damping"}, starts=1, progress=False
    )
    named = found.vector.named(found.x)
    true = truth_of(truth)
    assert named["q2.damping"] / named["q1.damping"] == pytest.approx(
        true["q2.damping"] / true["q1.damping"]
    )
    assert named["q1.damping"] == pytest.approx(true["q1.damping"], rel=1e-6)


# --- experiments with noise ----------------------------------------------------------------------
@needs_compiler
def test_an_experiment_gives_springs_within_their_standard_deviations(tmp_path):
    """The whole chain: plan, experiment with noise on another robot, responses, fit, new model
    file.
    """
    model = without_coulomb("planar5_nmp")
    truth = another(model, 7)
    plan = flexgen.excite(model, poses=4, speed_rms=0.02, hardware=NOISY, seed=2, progress=False)
    data = flexgen.frf(flexgen.measure(plan, truth, seed=5, progress=False))
    found = flexgen.identify(model, data, progress=False, source="test")
    assert found.status == FitStatus.FITTED and found.weights == "structured" and found.agreed == 3
    check_numbers("identify", 1e-5, plan=plan, data=data, found=found, figures=found.to_dict())
    away = errors(found, truth_of(truth))
    assert max(abs(away[name]) / found.sd[name] for name in away) < 4
    assert max(abs(away[name]) for name in away if "stiffness" in name) < 5e-3
    # predicted from the model, not from the truth
    ratios = [found.sd[name] / plan.predicted[name] for name in away]
    assert 0.5 < np.median(ratios) < 2
    written = flexgen.read(found.write(tmp_path / "new.toml"))
    assert (
        written.elements == found.model.elements
        and written.motors[0].inertia == model.motors[0].inertia
    )
    hostile = replace(found, source="x)\n[payload]\nmass = 9.0 #").write(tmp_path / "hostile.toml")
    assert flexgen.read(hostile).payload == model.payload
    text = (tmp_path / "new.toml").read_text()
    assert "# q1.stiffness: sd " in text and "Identified parameters (test)" in text


@needs_compiler
@pytest.mark.parametrize(
    ("name", "chains"),
    [
        pytest.param("planar5_nmp", 20, marks=pytest.mark.slow),
        pytest.param("manutec_r3_18", 12, marks=pytest.mark.full),
    ],
)
def test_standard_deviations_are_those_of_repeated_experiments(name, chains):
    model = without_coulomb(name)
    truth = another(model, 3)
    plan = flexgen.excite(
        model,
        poses=8 if name == "manutec_r3_18" else 4,
        speed_rms=0.02,
        hardware=NOISY,
        seed=2,
        progress=False,
    )
    true = truth_of(truth)
    away = []
    claimed = []
    costs = []
    elementwise = []
    for chain in range(chains):
        data = flexgen.frf(flexgen.measure(plan, truth, seed=chain, progress=False))
        for structured, out in ((True, away), (False, elementwise)):
            found = flexgen.identify(model, data, starts=1, structured=structured, progress=False)
            assert found.status == FitStatus.FITTED
            out.append(list(errors(found, true).values()))
            if structured:
                claimed.append([found.sd[p] for p in true])
                costs.append(found.cost)
    ratio = np.array(away) / np.array(claimed)
    assert 0.85 < np.sqrt(np.mean(ratio**2)) < 1.25
    bias = np.mean(away, axis=0) / (np.array(claimed).mean(axis=0) / np.sqrt(chains))
    assert np.abs(bias).max() < 3.5  # the largest of 6 to 24 numbers
    assert np.sqrt(np.mean(np.square(away))) < np.sqrt(np.mean(np.square(elementwise)))
    assert 0.8 < np.mean(costs) < 1.2


# --- what is refused -----------------------------------------------------------------------------
@pytest.fixture(scope="module")
def exact():
    truth = without_coulomb("planar5_nmp")
    return truth, exact_responses(truth, poses_of(truth, 2), W, DRIVE)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"free": ["stifness"]}, "parameters: given 'stifness', expected some of"),
        ({"free": []}, "free: given no parameter"),
        ({"free": ["m9.torque_constant"]}, "expected one of m1.torque_constant"),
        (
            {"free": ["m1.coulomb"]},
            r"given m1.coulomb of a friction with beta = 0, expected beta > 0",
        ),
        (
            {"free": ["m1.coulomb", "m1.beta"]},
            r"start of m1.coulomb: given 0.0 N m, expected a number > 0",
        ),
        (
            {"start": {"q9.stiffness": 1.0}},
            "start: given 'q9.stiffness', expected one of the free",
        ),
        ({"start": {"q1.stiffness": -1.0}}, "start of q1.stiffness: given -1.0"),
        ({"bounds": {"q1.stiffness": (5.0, 1.0)}}, "bounds of q1.stiffness"),
        ({"priors": {"q1.stiffness": 0.0}}, "prior of q1.stiffness"),
        ({"ties": {"q2.damping": "q9.damping"}}, "ties: given 'q9.damping'"),
        ({"residual": "huber"}, "residual: given 'huber', expected one of nls, lls"),
        ({"floor": -0.1}, "floor: given -0.1"),
        ({"starts": 0}, "starts: given 0"),
    ],
)
def test_wrong_arguments_are_refused(exact, arguments, words):
    truth, data = exact
    with pytest.raises(ArgumentError, match=words):
        flexgen.identify(truth, data, progress=False, **arguments)


def test_channels_in_another_order_are_refused(exact):
    truth, data = exact
    with pytest.raises(
        ArgumentError, match=r"data: given the motors m2, m1, expected m1, m2 in this order"
    ):
        flexgen.identify(truth, replace(data, motors=("m2", "m1")), progress=False)


def test_a_variant_that_sets_an_identified_number_is_refused(tmp_path):
    model = flexgen.read("four_mass@high")
    data = exact_responses(model, np.zeros((1, 1)), W, DRIVE)
    found = flexgen.identify(model, data, free=["stiffness", "damping"], starts=1, progress=False)
    with pytest.raises(
        (ModelError, ArgumentError), match=r"a number that the variant .high. sets to another one"
    ):
        found.write(tmp_path / "new.toml")


# --- refinement in the time domain ---------------------------------------------------------------
def with_friction(name):
    """A model with Coulomb friction in its motors."""
    model = flexgen.read(name)
    if any(motor.friction.coulomb for motor in model.motors):
        return model
    return with_values(
        model,
        {f"{m.name}.{k}": x for m in model.motors for k, x in (("coulomb", 1.0), ("beta", 2.0))},
    )


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(
    "name", ["planar5_nmp", pytest.param("manutec_r3", marks=pytest.mark.full)]
)
def test_coulomb_friction_is_found_in_the_time_domain(name):
    """Friction biases the frequency responses; the simulation of the experiment does not care."""
    model = with_friction(name)
    truth = another(model, 4, 0.2)
    true = {
        f"{m.name}.coulomb": 1.2 * m.friction.coulomb for m in model.motors if m.friction.coulomb
    }
    truth = with_values(truth, true)
    drives = replace(NOISY, delay_s=1e-4)
    plan = small_plan(model, poses_of(model, 3), hardware=drives, periods=3, speed_rms=0.1)
    experiment = flexgen.measure(plan, truth, seed=1, progress=False)
    coarse = flexgen.identify(model, flexgen.frf(experiment), starts=1, progress=False)
    fine = flexgen.refine(coarse, experiment, progress=False)
    assert coarse.status == FitStatus.MODEL_ERROR and fine.status == FitStatus.FITTED
    # Frequency responses show the mean slope of a friction law: its viscous part is not used.
    assert coarse.is_weak("m1.viscous") and "m1.viscous" not in coarse.used()
    assert any("m1.viscous" in line and "Coulomb" in line for line in coarse.weak)
    assert not fine.is_weak("m1.viscous") and "m1.viscous" in fine.used()
    springs = truth_of(truth, ["stiffness"])
    before, after = (max(map(abs, errors(found, springs).values())) for found in (coarse, fine))
    assert after < 1e-2 and before > 3 * after, (before, after)
    away = errors(fine, true | springs)
    assert max(abs(away[name]) for name in true) < 0.02
    assert max(abs(away[name]) / fine.sd[name] for name in away) < 4.5
    assert 0.5 < fine.cost < 2.0 and fine.weights == "time domain"
    checked = validate(fine, experiment)
    before = validate(replace(fine, x=fine.vector.start), experiment)
    assert min(checked.fit_percent) > 97 and 0.5 < checked.cost < 2.0 and max(checked.white) > 0.7
    assert before.cost > 5 * checked.cost and min(before.fit_percent) < min(checked.fit_percent)


@needs_compiler
@pytest.mark.slow
def test_friction_of_the_load_is_found_and_missed_by_a_law_without_it():
    """0.08 in the robot, 0.05 in the file; a law that fades less with the speed fits to 0.1 %,
    without deviations.
    """
    plan = flexgen.excite(
        loaded("elbow"),
        poses=3,
        period_s=2.0,
        lines=30,
        speed_rms=0.3,
        hardware=NOISY,
        seed=1,
        progress=False,
    )
    experiment = flexgen.measure(plan, loaded("elbow"), progress=False)
    free = ["stiffness", "damping", "m1.load_coulomb", "m2.load_coulomb", "m2.coulomb", "m2.beta"]
    found = {}
    for fades in (0.04, 0.02):
        model = loaded("elbow", load_coulomb=0.05, load_stribeck=fades)
        coarse = flexgen.identify(
            model, flexgen.frf(experiment), free=FREE, starts=1, progress=False
        )
        found[fades] = flexgen.refine(coarse, experiment, free=free, progress=False)
    fine = found[0.04]
    assert fine.status == FitStatus.FITTED and 0.5 < fine.cost < 2.0
    away = errors(fine, truth_of(loaded("elbow"), free))
    assert max(abs(away[name]) / fine.sd[name] for name in free[2:]) < 3.0
    assert max(fine.sd[name] for name in free[2:]) < 0.02 and max(map(abs, away.values())) < 0.02
    assert found[0.02].status == FitStatus.SMALL_ERROR and not any(found[0.02].sd.values())


@needs_compiler
@pytest.mark.slow
def test_a_wrong_mass_stays_a_model_error():
    """The angles of one experiment hardly show 1.5 % of a mass, which moves the springs by many
    deviations.
    """
    model = without_coulomb("planar5_nmp")
    truth = another(model, 1, 0.15)
    mass = next(p.value for p in select(truth, ["arm3.mass"]))
    plan = small_plan(
        model,
        poses_of(model, 2),
        hardware=NOISY,
        lines=20,
        period_s=1.0,
        periods=4,
        speed_rms=0.05,
    )
    experiment = flexgen.measure(
        plan, with_values(truth, {"arm3.mass": 1.015 * mass}), seed=1, progress=False
    )
    coarse = flexgen.identify(model, flexgen.frf(experiment), starts=1, progress=False)
    fine = flexgen.refine(coarse, experiment, progress=False)
    assert coarse.status == fine.status == FitStatus.MODEL_ERROR and fine.cost < 2.0
    formal = np.sqrt(np.diag(fine.formal_covariance))[fine.vector.names.index("q1.stiffness")]
    assert abs(
        errors(fine, truth_of(truth, ["stiffness"]))["q1.stiffness"]
    ) > 5 * formal and not any(fine.sd.values())


@needs_compiler
@pytest.mark.slow
def test_wrong_drive_gains_are_seen_in_the_cost_and_identified():
    """Wrong gains are seen in the cost; as parameters they are found, and are not written to the
    model.
    """
    model = with_friction("planar5_nmp")
    plan = small_plan(model, poses_of(model, 3), hardware=NOISY, periods=3, speed_rms=0.1)
    experiment = flexgen.measure(plan, another(model, 4, 0.2), seed=1, progress=False)
    coarse = flexgen.identify(model, flexgen.frf(experiment), starts=1, progress=False)
    fine = flexgen.refine(coarse, experiment, progress=False)
    wrong = replace(
        experiment,
        plan=replace(
            plan, controller=replace(plan.controller, speed_gain=1.1 * plan.controller.speed_gain)
        ),
    )
    other = flexgen.refine(coarse, wrong, progress=False)
    assert other.cost > 2  # a drive that is not the one of the experiment is seen
    gains = flexgen.refine(coarse, wrong, free=[*fine.vector.names, "speed_gain"], progress=False)
    for motor, gain in zip(plan.motors, plan.controller.speed_gain, strict=True):
        assert gains.values[f"{motor}.speed_gain"] == pytest.approx(
            gain, rel=5 * gains.sd[f"{motor}.speed_gain"]
        )
        assert gains.sd[f"{motor}.speed_gain"] < 0.01
    assert gains.cost < 2.0 and not {f"{motor}.speed_gain" for motor in plan.motors} & set(
        gains.used()
    )
    with pytest.raises(ArgumentError, match="which only 'refine' can fit"):
        flexgen.identify(
            model, flexgen.frf(experiment), free=["stiffness", "speed_gain"], progress=False
        )


@needs_compiler
@pytest.mark.full
def test_gears_with_low_and_high_stiffness():
    """Local models with averaged springs find the way; the simulation of the experiment gives the
    numbers.
    """
    model = flexgen.read(str(ROBOTS / "two_smooth_gears.toml"))
    names = [f"{joint}.{kind}" for joint in ("q1", "q2") for kind in ("low", "high", "break_at")]
    true = truth_of(model, names)
    rng = np.random.default_rng(0)
    friction = {
        f"{m.name}.{k}": x for m in model.motors for k, x in (("coulomb", 0.3), ("beta", 0.5))
    }
    for robot, speed in ((model, 0.003), (with_values(model, friction), 0.02)):
        drives = replace(NOISY, torque_noise_Nm=0.05)
        plan = flexgen.excite(
            robot,
            poses=12,
            free=names,
            speed_rms=speed,
            periods=4,
            f_min=1.0,
            f_max=60.0,
            hardware=drives,
            transients=2,
            realizations=3,
            progress=False,
        )
        experiment = flexgen.measure(plan, robot, progress=False)
        start = with_values(
            robot, {name: value * np.exp(rng.uniform(-0.3, 0.3)) for name, value in true.items()}
        )
        found = flexgen.identify(start, flexgen.frf(experiment), progress=False)
        if robot is model:  # small motion at poses that twist the gears by different amounts
            assert max(map(abs, errors(found, true).values())) < 0.03
            continue
        fine = flexgen.refine(found, experiment, progress=False)
        assert (
            max(map(abs, errors(fine, true).values())) < 3e-3 and fine.status == FitStatus.FITTED
        )
        assert errors(fine, {"m1.coulomb": 0.3, "m2.coulomb": 0.3})["m1.coulomb"] == pytest.approx(
            0.0, abs=0.02
        )


@needs_compiler
def test_an_experiment_that_does_not_belong_to_the_fit_is_refused():
    model = without_coulomb("planar5_nmp")
    plan = small_plan(model, poses_of(model, 1), hardware=NOISY)
    experiment = flexgen.measure(plan, model, progress=False)
    found = flexgen.identify(model, flexgen.frf(experiment), starts=1, progress=False)
    other = replace(experiment, plan=replace(plan, poses=plan.poses + 0.1))
    with pytest.raises(ArgumentError, match="given other motors or poses"):
        flexgen.refine(found, other, progress=False)
    with pytest.raises(ArgumentError, match=r"runs: given 9, expected 1 to 2, the"):
        flexgen.refine(found, experiment, runs=9, progress=False)
    with pytest.raises(ArgumentError, match=r"free: given m1\.inertia, expected stiffness"):
        flexgen.refine(found, experiment, free=["m1.inertia"], progress=False)
    # The simulation of the experiment: without noise, or with that of a seed.
    simulated = Simulated(ParameterVector(model, ["delay"]), experiment, [(0, 0, 0)])
    quiet, one, other = (
        simulated.spectra(simulated.vector.start, noise=seed) for seed in (None, 1, 2)
    )
    check_numbers("spectra", quiet=quiet, one=one, measured=simulated.measured)
    noise = np.abs(one - other)
    assert (
        noise.min() > 0.0
        and np.abs(quiet - simulated.measured).max() < 8 * noise.max() < np.abs(quiet).max()
    )


# --- what it is worth ----------------------------------------------------------------------------
@needs_compiler
@pytest.mark.full
def test_feedforward_with_the_identified_model_is_as_good_as_with_the_true_one():
    """Also the distribution that is predicted without knowing the robot contains the error on the
    true one.
    """
    model = without_coulomb("planar5_nmp")
    truth = another(model, 7)
    plan = small_plan(model, poses_of(model, 4), hardware=NOISY, periods=4, period_s=4.0)
    found = flexgen.identify(
        model, flexgen.frf(flexgen.measure(plan, truth, progress=False)), starts=1, progress=False
    )
    known = found.verdict("line", truth=truth, progress=False)
    before, after, rigid = (known[name].error_m[0] for name in ("file", "identified", "rigid"))
    assert after < 30e-6 and before > 20 * after and rigid > before
    guessed = found.verdict("line", samples=6, progress=False)
    assert (
        guessed["identified"].quantile(0.0) / 5 < after < 5 * guessed["identified"].quantile(1.0)
    )
    with pytest.raises(ArgumentError, match="samples: given 0"):
        found.verdict("line", samples=0, progress=False)


def test_zeros_of_a_group_of_parameters_stay_zero():
    """The cubic part of the springs of abb_arm is zero: a group leaves it, its name frees it."""
    model = flexgen.read("abb_arm")
    names = ParameterVector(model, FREE).names
    assert "q1.stiffness" in names and not any(name.endswith("cubic") for name in names)
    assert "q1.cubic" in ParameterVector(model, [*FREE, "q1.cubic"], start={"q1.cubic": 1.0}).names


@needs_compiler
@pytest.mark.slow
def test_the_drives_are_stable_where_little_inertia_follows_fast():
    """Springs next to massless motors: at high frequencies a motor moves little."""
    plan = flexgen.excite(
        str(ROBOTS / "ur5_elastic.toml"),
        poses=1,
        lines=5,
        period_s=1.0,
        speed_rms=0.01,
        progress=False,
    )
    assert np.isfinite(flexgen.measure(plan, progress=False).tau_m).all()
    wild = replace(
        plan, controller=replace(plan.controller, speed_gain=30 * plan.controller.speed_gain)
    )
    with pytest.raises(SolverError, match="lower the gains"):
        flexgen.measure(wild, progress=False)


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


def test_stiffnesses_of_responses_with_friction_are_marked(tmp_path):
    """A model error of a model with Coulomb friction says at which load its stiffnesses are, in
    the text, the page's data and the file; one without friction does not.
    """
    truth = without_coulomb("planar5_nmp")
    data = replace(exact_responses(truth, poses_of(truth, 2), W, DRIVE), sample_s=0.0)
    law = {"viscous": 2e-3, "coulomb": 0.5, "beta": 100.0}
    rough = flexgen.read("planar5_nmp", overrides={"motor.m1.friction": law})
    found = flexgen.identify(rough, data, free=FREE, starts=1, progress=False)
    assert found.status == FitStatus.MODEL_ERROR
    sentence, advice = found.load_note
    assert "gears at small torques" in sentence and "commission" in advice
    assert sentence in " ".join(found.to_text().split())
    assert sentence in found.to_dict()["sentence"] and advice in found.to_dict()["advice"]
    text = found.write(tmp_path / "new.toml").read_text(encoding="utf-8")
    assert "# Status: model error." in text and f"# {sentence}" in text
    plain = flexgen.identify(truth, data, free=FREE, starts=1, progress=False)
    assert plain.status == FitStatus.MODEL_ERROR and not any(plain.load_note)
