"""Rigid-body identification: regressor, base parameters, feasible bodies, and recordings of a KUKA
KR300.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.evaluate import evaluate
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.records.gear_deflection import gear_deflection
from flexgen.identification.rigid.feasible_bodies import pseudo_inertia
from flexgen.identification.rigid.rigid_body import identify_rigid
from flexgen.identification.rigid.rigid_file import (
    rigid_deviations,
    rigid_numbers,
    write_rigid,
)
from flexgen.identification.rigid.rigid_regressor import Motion, Regressor
from flexgen.model.elements import Body

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data" / "kr300"
PANDA = str(ROOT / "tests" / "support" / "robots" / "panda.toml")
HOME_DEG = np.array([0.0, -90.0, 90.0, 0.0, 0.0, 0.0])


def states(n_a: int, count: int = 40, seed: int = 0):
    rng = np.random.default_rng(seed)
    return [rng.uniform(-1.5, 1.5, (count, n_a)) for _ in range(3)]


@pytest.mark.parametrize(
    "name", ["kr300", "elbow@rigid", PANDA], ids=["kr300", "elbow@rigid", "panda"]
)
def test_the_torques_are_linear_in_the_bodies(name):
    """Against the inverse dynamics of the same model, which has its bodies as constants."""
    model = flexgen.read(name)
    regressor = Regressor(model)
    q, v, a = states(model.n_a)
    expected = evaluate(flexgen.derive(model).function("inverse_dynamics"), q, v, a)[0].reshape(
        len(q), -1
    )
    found = regressor(q, v, a) @ regressor.of_model()
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()
    transposed = regressor(q, v, -a) @ regressor.of_model()
    assert np.abs(transposed - expected).max() > 1e-3 * np.abs(expected).max()


def test_base_parameters_are_those_of_the_literature():
    """Six joints, the first one vertical: 36 (M. Gautier and W. Khalil, 1990, for arms of this
    kind).
    """
    assert Regressor(flexgen.read("kr300")).base_parameters() == 36


def recorded(model, seed: int = 0, noise: float = 0.0) -> Motion:
    """A motion by sums of sines with the torques of a model, friction included."""
    t = np.arange(1500) * 4e-3
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.array([0.2, 0.37, 0.7])
    amplitude = rng.uniform(0.1, 0.5, (model.n_a, 3))
    phase = rng.uniform(0, 6, (model.n_a, 3))
    angle = w[:, None] * t + phase[:, :, None]
    q = (amplitude[:, :, None] * np.sin(angle)).sum(axis=1).T
    v = (amplitude[:, :, None] * w[:, None] * np.cos(angle)).sum(axis=1).T
    a = -(amplitude[:, :, None] * w[:, None] ** 2 * np.sin(angle)).sum(axis=1).T
    arm = evaluate(flexgen.derive(model).function("inverse_dynamics"), q, v, a)[0].reshape(
        len(t), -1
    )
    motor = np.array([m.inertia for m in model.motors]) * (a @ model.eta.T)
    tau = np.linalg.solve(model.eta.T, arm.T).T + motor + 0.3 * v + 0.5 * np.tanh(v / 5e-4) + 0.1
    return Motion(t, q, tau + noise * rng.standard_normal(tau.shape))


@pytest.mark.slow
def test_another_robot_is_found_and_its_bodies_are_possible():
    """Torques on motions that were not used; the reader refuses bodies that are not physically
    consistent.
    """
    model = flexgen.read("kr300")
    rng = np.random.default_rng(3)
    heavier = tuple(
        replace(e, body=_scaled(e.body, rng.uniform(0.7, 1.4))) for e in model.elements
    )
    truth = replace(model, elements=heavier)
    found = identify_rigid(model, [recorded(truth, k, noise=0.02) for k in range(3)], parts=0)
    held_out = recorded(truth, 9)
    assert np.nanmax(found.relative_errors(held_out)) < 0.05  # axis 6 turns next to nothing
    assert found.friction[:, 0] == pytest.approx(0.3, rel=0.1) and found.friction[
        :, 1
    ] == pytest.approx(0.5, rel=0.1)
    for row in found.pi.reshape(-1, 10):
        assert np.linalg.eigvalsh(pseudo_inertia(row)).min() > 0
    before = identify_rigid(
        model, [recorded(truth, k, noise=0.02) for k in range(3)], prior=1e-6, parts=0
    )  # the file's bodies
    for axis in (0, 1, 2):  # those that carry most
        assert before.relative_errors(held_out)[axis] > 1.5 * found.relative_errors(held_out)[axis]


@pytest.mark.slow
def test_a_zero_that_is_off_is_named():
    """Of the third of six axes; the last one has none, since the body turned about it has the same
    torques.
    """
    model = flexgen.read("kr300")
    motions = [recorded(model, k, noise=0.02) for k in range(3)]
    moved = [replace(motion, q=motion.q + 0.1 * np.eye(6)[2]) for motion in motions]
    found = identify_rigid(model, moved, parts=0)
    assert (
        found.status == FitStatus.MODEL_ERROR and found.mistake.what == "a zero of q3 [rad] off by"
    )
    assert found.mistake.value == pytest.approx(0.1, rel=0.15)


def _scaled(body: Body, factor: float) -> Body:
    inertia = tuple(tuple(x * factor for x in row) for row in body.inertia)
    return replace(body, mass=body.mass * factor, inertia=inertia)


@pytest.fixture(scope="module")
def runs():
    files = [DATA / f"kr300_run_{name}.npz" for name in "AB"]
    if not all(file.exists() for file in files):
        pytest.skip("no recordings of the KR300 (J. Weigand et al., TU Kaiserslautern)")
    out = []
    for file in files:
        data = np.load(file, allow_pickle=False)
        out.append(
            Motion(
                data["t"],
                np.deg2rad(data["q_mot_deg"] + HOME_DEG[:, None]).T,
                data["tau_motor_Nm"].T,
            )
        )
    return out


@pytest.mark.slow
def test_recordings_of_a_kr300(runs):
    """Both runs: at most 17 % of the torque is unexplained on any axis of B, of samples that
    move.
    """
    model = flexgen.read("kr300")
    joint = model.coordinates[model.i_g[1]].name
    found = identify_rigid(model, runs, counterbalance={joint: 2}, parts=0)
    assert np.max(found.relative_errors(runs[1])) < 0.17
    assert np.max(found.relative_errors(runs[0])) < 0.19
    plain = identify_rigid(model, runs, prior=1e-6, parts=0)
    # the bodies of the file and friction alone
    assert np.max(plain.relative_errors(runs[1])) > 0.25


@pytest.mark.slow
def test_gear_stiffness_of_a_kr300(runs):
    """Link encoders of axes 1 to 3: skew near 3 ms, axes 2 and 3 with intervals, axis 1 not
    identifiable.
    """
    model = flexgen.read("kr300")
    joint = model.coordinates[model.i_g[1]].name
    found = identify_rigid(model, runs, counterbalance={joint: 2}, parts=0)
    data = [np.load(DATA / f"kr300_run_{name}.npz", allow_pickle=False) for name in "AB"]
    results = []
    for axis in range(3):
        parts = [
            (
                motion.derivatives[0][:, axis],
                np.deg2rad(d["q_se_deg"][axis] + HOME_DEG[axis]),
                tau[:, axis],
            )
            for motion, d, tau in zip(
                runs, data, [found.gear_torques(m) for m in runs], strict=True
            )
        ]
        q, link, tau = (np.concatenate(x) for x in zip(*parts, strict=True))
        results.append(gear_deflection(np.arange(len(q)) * 4e-3, q, link, tau))
    assert results[0].stiffness is None and "not identifiable" in results[0].sentence
    for result, stiffness in zip(results[1:], (1.1e7, 6.4e6), strict=True):
        assert (
            result.stiffness is not None
            and result.interval[0] < result.stiffness < result.interval[1]
        )
        assert stiffness / 2 < result.stiffness < 2 * stiffness
        assert 2.5e-3 < result.skew_s < 3.3e-3


def test_a_known_deflection_is_found_and_noise_is_not():
    """A spring, a skew and an offset; then noise alone."""
    rng = np.random.default_rng(0)
    t = np.arange(4000) * 4e-3
    q = 0.5 * np.sin(2 * np.pi * 0.4 * t)
    tau = 1e3 * np.sin(2 * np.pi * 0.7 * t + 1)
    noise = 2e-6 * rng.standard_normal(len(t))
    link = np.interp(t - 2e-3, t, q - tau / 1e7) - 1e-3 + noise
    found = gear_deflection(t, q, link, tau)
    assert found.stiffness == pytest.approx(1e7, rel=0.02) and found.skew_s == pytest.approx(
        2e-3, rel=0.02
    )
    assert found.interval[0] < 1e7 < found.interval[1] and found.explained > 0.6
    nothing = gear_deflection(t, q, q + 1e-3 * rng.standard_normal(len(t)), tau)
    assert nothing.stiffness is None and nothing.interval[1] == np.inf
    with pytest.raises(ArgumentError, match=r"expected 5\.0 s at least"):
        gear_deflection(t[:500], q[:500], link[:500], tau[:500])
    with pytest.raises(ArgumentError, match="expected four"):
        gear_deflection(t, q, link[:-1], tau)
    with pytest.raises(ArgumentError, match="not finite"):
        gear_deflection(t, q, link * np.nan, tau)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"q": np.zeros((5, 6))}, r"expected \(n,\), \(n, n_g\)"),
        ({"tau_m": np.full((1500, 6), np.nan)}, "tau_m is not finite at sample 0"),
        ({"t": np.arange(1500.0) ** 1.1}, "expected equal steps"),
    ],
)
def test_motions_that_cannot_be_used_are_refused(change, words):
    good = {"t": np.arange(1500) * 4e-3, "q": np.zeros((1500, 6)), "tau_m": np.zeros((1500, 6))}
    with pytest.raises(ArgumentError, match=words):
        Motion(**{**good, **change})


def test_arguments_that_do_not_fit_are_refused():
    model = flexgen.read("kr300")
    motion = recorded(model)
    words = r"given coordinates without motor \(t1x, .*\), expected a motor for each"
    with pytest.raises(ArgumentError, match=words):
        Regressor(flexgen.read("kr300_efjm"))
    with pytest.raises(ArgumentError, match="counterbalance: given 'q9'"):
        identify_rigid(model, [motion], counterbalance={"q9": 1})
    with pytest.raises(ArgumentError, match="given 6 joints and 6 motors, expected"):
        identify_rigid("elbow@rigid", [motion])
    with pytest.raises(ArgumentError, match="at least one motion"):
        identify_rigid(model, [])


SINE = 60.0  # N m
COSINE = -25.0  # of the second harmonic


def balanced_elbow(path: Path) -> str:
    """The rigid elbow with a counterbalance of its first joint, as a file."""
    text = Path(flexgen.read("elbow").file).read_text()
    line = f'name = "q1"\ncounterbalance = {{ sin = [0.0, {SINE}], cos = [0.0, {COSINE}] }}'
    path.write_text(text.replace('name = "q1"', line, 1))
    return f"{path}@rigid"


def swung(model, center: float, width: float, seed: int, noise: float) -> Motion:
    """A motion of both joints about a center of the first one; torques of the definition, noise, a
    bit of friction.
    """
    t = np.arange(2000) * 4e-3
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.array([0.23, 0.41, 0.83])
    phase = rng.uniform(0, 6, (2, 3))
    angle = w[:, None] * t + phase[:, :, None]
    size = np.array([width, 0.6])[:, None, None] / 3
    q = (size * np.sin(angle)).sum(axis=1).T + np.array([center, 0.0])
    v = (size * w[:, None] * np.cos(angle)).sum(axis=1).T
    a = -(size * w[:, None] ** 2 * np.sin(angle)).sum(axis=1).T
    equations = flexgen.derive(model)
    arm = evaluate(equations.function("inverse_dynamics"), q, v, a)[0]
    arm[:, 0] -= SINE * np.sin(2 * q[:, 0]) + COSINE * np.cos(2 * q[:, 0])
    motor = np.array([m.inertia for m in model.motors]) * (a @ model.eta.T)
    tau = arm @ np.linalg.inv(model.eta) + motor + 0.3 * np.tanh(v / 5e-4)
    return Motion(t, q, tau + noise * rng.standard_normal(tau.shape))


def test_a_fitted_counterbalance_and_its_deviations_are_in_the_new_file(tmp_path):
    """A gas spring of the first joint: the written model has its torque, within the stated
    deviations.
    """
    model = flexgen.read("elbow@rigid")
    found = identify_rigid(
        model,
        [swung(model, c, 1.2, k, 0.02) for k, c in enumerate((0.0, 0.8))],
        counterbalance={"q1": 1},
    )
    assert found.status == FitStatus.FITTED and (found.left_out < 0.1).all()
    numbers = rigid_numbers(found)
    sd = rigid_deviations(found)
    for name, true in (("q1.counterbalance_sin_2", SINE), ("q1.counterbalance_cos_2", COSINE)):
        assert abs(numbers[name] - true) < 4 * sd[name] < 40.0
    assert abs(numbers["m1.coulomb"] - 0.3) < 4 * sd["m1.coulomb"]
    text = write_rigid(found, tmp_path / "new.toml", "test").read_text()
    assert "q1.counterbalance_sin_2: sd " in text and "each has its standard deviation" in text
    again = flexgen.read(tmp_path / "new.toml", "rigid")
    q = np.random.default_rng(1).uniform(-1, 1, (30, 2))
    held = [
        evaluate(flexgen.derive(m).function("gravity"), q)[0]
        - evaluate(flexgen.derive(m).function("arm_forces"), q, 0 * q)[0]
        for m in (again, flexgen.read(balanced_elbow(tmp_path / "true.toml")))
    ]
    assert np.abs(held[0] - held[1])[:, 0].max() < 0.02 * np.abs(held[1][:, 0]).max()
    refit = identify_rigid(
        again, [swung(model, 0.4, 1.2, 3, 0.02)], counterbalance={"q1": 1}, parts=0
    )
    # the file's counterbalance is fitted anew, and not added
    assert refit.status == FitStatus.NOT_CHECKED
    assert refit.model.elements[0].dofs[0].counterbalance[1][0] == pytest.approx(SINE, rel=0.5)


def test_a_fit_that_fails_on_other_motions_has_no_deviations_and_says_so(tmp_path):
    """Five harmonics fitted to a small motion: the torque elsewhere is anything; so says a
    held-out motion.
    """
    model = flexgen.read("elbow@rigid")
    near = swung(model, 0.0, 0.15, 0, 0.3)
    far = swung(model, 1.0, 1.2, 1, 0.3)
    found = identify_rigid(model, [near], counterbalance={"q1": 5}, parts=0)
    assert found.numbers_sd is not None
    failed = found.validated([near], [far])
    assert failed.relative_errors(far)[0] > 0.5
    assert (
        failed.status == FitStatus.POORLY_VALIDATED
        and failed.numbers_sd is None
        and rigid_deviations(failed) == {}
    )
    text = write_rigid(failed, tmp_path / "new.toml", "test").read_text()
    assert "poorly validated, no standard deviations" in text and ": sd " not in text


@pytest.mark.slow
def test_one_run_of_a_kr300_is_seen_not_to_determine_its_counterbalance(runs):
    """Without the other run: quarters of the run that were left out tell what the other run
    shows.
    """
    model = flexgen.read("kr300")
    both = identify_rigid(model, runs, counterbalance={"q2": 2})
    assert both.status == FitStatus.FITTED
    alone = identify_rigid(model, runs[:1], counterbalance={"q2": 2})
    assert alone.relative_errors(runs[1])[1] > 1.0  # more than the torque itself
    assert alone.status == alone.validated(runs[:1], runs[1:]).status == FitStatus.POORLY_VALIDATED
