"""Rigid arms part by part: columns by closed forms, deviations by derivatives, fits that leave
recordings out, and deflections of gears by least squares.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from enlarged import rescaled
from numpy.testing import assert_allclose
from rigid_records import H, described, swung

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.numerics.polynomial_filter import smooth_forces
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.records.description import read_description
from flexgen.identification.records.gear_deflection import gear_deflection
from flexgen.identification.rigid import rigid_accuracy, rigid_body, rigid_file, rigid_model
from flexgen.identification.rigid.feasible_bodies import numbers_of, pseudo_inertia
from flexgen.identification.rigid.rests_of_motors import MOVING
from flexgen.identification.rigid.rigid_body import RigidFit, identify_rigid
from flexgen.identification.rigid.rigid_columns import COULOMB_SPEED, Columns
from flexgen.identification.rigid.rigid_regressor import Motion, Regressor
from flexgen.model.elements import Body, RobotModel


def balanced() -> RobotModel:
    """The rigid elbow with two harmonics in the counterbalance of q1."""
    model = flexgen.read("elbow@rigid")
    e0 = model.elements[0]
    dofs = tuple(
        replace(d, counterbalance=((40.0, -15.0), (9.0, 4.0))) if d.name == "q1" else d
        for d in e0.dofs
    )
    return replace(model, elements=(replace(e0, dofs=dofs), *model.elements[1:]))


def test_columns_are_those_of_bodies_rotors_frictions_and_harmonics() -> None:
    """Term by term on filtered samples, for harmonics that the file has and for those that are
    fitted.
    """
    model = balanced()
    motion = swung(model)
    found = Columns(Regressor(model), [motion, motion], {"q2": 2, "q1": 1})
    q, v, a = motion.derivatives
    ratio = np.abs(np.diag(model.eta))
    assert found.step == pytest.approx(H) and found.F[0].shape == (600, 2, 8)
    F = found.F[1]
    assert_allclose(F[:, :, 0], v * np.sign(np.diag(model.eta)))
    top = np.abs(v).max()
    slope = smooth_forces(np.tanh(v * np.diag(model.eta) / (COULOMB_SPEED * top * ratio)))
    assert_allclose(F[:, :, 1], slope)
    assert_allclose(F[:, :, 2], 1.0)
    assert_allclose(F[:, :, 3], a * np.sign(np.diag(model.eta)))
    zero = np.zeros(600)
    for column, (first, second) in enumerate(
        (
            (np.sin(2 * q[:, 0]), np.sin(2 * q[:, 1])),
            (np.cos(2 * q[:, 0]), np.cos(2 * q[:, 1])),
            (zero, np.sin(3 * q[:, 1])),
            (zero, np.cos(3 * q[:, 1])),
        ),
        4,
    ):
        assert_allclose(F[:, 0, column], first)
        assert_allclose(F[:, 1, column], second)
    inertia = np.array([m.inertia for m in model.motors])
    assert_allclose(found.known[0], inertia * (a @ model.eta.T))
    inverse = np.linalg.inv(model.eta)
    pi = Regressor(model).of_model()
    friction = np.arange(16.0).reshape(2, 8) / 10
    first = np.stack([40.0 * np.sin(q[:, 0]) - 15.0 * np.cos(q[:, 0]), zero], axis=1)
    second = np.stack([9.0 * np.sin(2 * q[:, 0]) + 4.0 * np.cos(2 * q[:, 0]), zero], axis=1)
    held = found.held[0] @ model.eta
    assert min(np.abs(held + x).max() for x in (first, first + second)) < 1e-9
    body = np.einsum("nip,p->ni", Regressor(model)(q, v, a), pi)
    total = body @ inverse + found.held[0] + found.known[0] + np.einsum("njc,jc->nj", F, friction)
    assert_allclose(found.torques(pi, friction)[1], total, rtol=1e-9, atol=1e-9)
    moving = np.abs(v * ratio) > MOVING * top * ratio
    assert (found.moving[0] == moving).all()
    part = found.part([(1, slice(0, 50))])
    assert len(part.Y) == 1 and part.measured[0].shape == (50, 2)
    error, scale = found.errors(pi, friction)
    for j in range(2):
        tau = motion.torques[:, j]
        at = moving[:, j]
        assert error[j] == pytest.approx(np.sqrt(((tau - total[:, j])[at] ** 2).mean()))
        assert scale[j] == pytest.approx(tau[at].std())


def test_the_sample_time_of_a_rounded_clock_is_that_of_all_samples() -> None:
    """At 2048 Hz the median of steps in whole microseconds is 0.06 % short, and frictions were
    four deviations off.
    """
    t = 1.7e9 + np.round(1e6 * np.arange(600) / 2048) / 1e6
    assert Motion(t, np.zeros((600, 2)), np.zeros((600, 2))).step == pytest.approx(
        1 / 2048, rel=3e-6
    )


def test_a_fit_without_noise_returns_bodies_rotors_and_frictions() -> None:
    model = flexgen.read("elbow@rigid")
    motion = swung(model)
    found = identify_rigid(model, [motion], parts=2)
    assert (
        found.status == FitStatus.FITTED
        and found.left_out is not None
        and (found.left_out < 0.02).all()
    )
    assert (found.relative_errors(motion) < 0.01).all()
    e = found.torques(motion) - motion.torques
    assert np.sqrt((e**2).mean()) < 0.01 * np.std(motion.tau_m)
    eta = np.diag(model.eta)
    found = replace(found, lags=np.zeros(3))  # torques at the times of the angles
    gear = (found.torques(motion) - Columns(Regressor(model), [motion], {}).known[0]) @ model.eta
    F = Columns(Regressor(model), [motion], {}).F[0]
    load = gear - np.einsum("njc,jc->nj", F, found.friction) @ model.eta
    assert_allclose(
        found.gear_torques(motion),
        load + (motion.torques - found.torques(motion)) @ model.eta,
        atol=1e-6,
    )
    for j, motor in enumerate(found.model.motors):
        viscous, coulomb, offset, rotor = found.friction[j, :4]
        assert (
            motor.friction.viscous == pytest.approx(viscous / abs(eta[j]))
            and motor.friction.offset == offset
        )
        assert motor.friction.viscous == pytest.approx([0.02, 0.03][j], rel=0.05)
        assert motor.friction.coulomb == coulomb == pytest.approx([0.5, 0.8][j], rel=0.05)
        assert motor.friction.beta == pytest.approx(
            1 / (COULOMB_SPEED * found.speed[j] * abs(eta[j]))
        )
        assert motor.inertia == pytest.approx(model.motors[j].inertia + rotor / abs(eta[j]))
    negative = rigid_model.motors_of(
        model, np.array([[-1.0, -1.0, 0.5, -1e9]] * 2), np.zeros(2), np.ones(2)
    )
    for motor, old in zip(negative, model.motors, strict=True):
        assert motor.inertia == old.inertia
        assert vars(motor.friction) | {"offset": 0.0} == vars(type(motor.friction)()) | {
            "offset": 0.0
        }


def test_parts_are_predicted_by_the_fit_to_the_others() -> None:
    """Half of a recording with a load, half without: each by the fit to the other half."""
    model = flexgen.read("elbow@rigid")
    empty = swung(model, 1200)
    loaded = swung(flexgen.read("elbow@rigid", overrides={"payload": {"mass": 60.0}}), 1200)
    tau = np.vstack([empty.tau_m[:600], loaded.tau_m[600:]])
    found = identify_rigid(model, [replace(empty, tau_m=tau)], parts=2)
    assert found.left_out is not None
    assert identify_rigid(model, [empty], parts=0).left_out is None
    halves = [
        Motion(empty.t[at], empty.q[at], tau[at]) for at in (slice(0, 600), slice(600, None))
    ]
    errors = []
    for one, other in (halves, halves[::-1]):
        errors.append(identify_rigid(model, [other], parts=0).torques(one) - one.torques)
    expected = np.sqrt((np.vstack(errors) ** 2).mean(axis=0)) / tau.std(axis=0)
    assert (found.left_out > 0.02).all()
    assert_allclose(found.left_out, expected, rtol=0.15)


@pytest.mark.slow
def test_a_tiny_quick_arm_has_the_numbers_of_the_large_one() -> None:
    """Lengths, masses and times by powers of two: the torques are those of the large arm,
    scaled.
    """
    large = flexgen.read("elbow@rigid")
    length = 2.0**-6
    mass = 2.0**-20
    time = 2.0**-4
    unit = mass * length**2
    tiny = rescaled(large, length, mass, time)
    motion = swung(large, 1500)
    found = identify_rigid(large, [motion], parts=2)
    scaled = identify_rigid(
        tiny, [Motion(time * motion.t, motion.q, motion.tau_m * (unit / time**2))], parts=2
    )
    assert scaled.status == found.status == FitStatus.FITTED
    assert_allclose(scaled.friction[:, 1] * time**2 / unit, found.friction[:, 1], rtol=1e-5)
    # of it
    assert_allclose(scaled.numbers_sd[21] * time**2 / unit, found.numbers_sd[21], rtol=0.02)
    assert_allclose(scaled.left_out, found.left_out, rtol=0.02)


def test_deviations_of_numbers_of_the_file_follow_by_their_derivatives() -> None:
    """Mass, center, inertia about the center from (m, m c, I about the origin); rotors and
    frictions by the ratio.
    """
    model = flexgen.read("elbow@rigid")
    pi = Regressor(model).of_model()
    n = len(pi)
    rng = np.random.default_rng(0)
    root = rng.normal(size=(n + 15, n + 15)) * 1e-3
    covariance = root @ root.T
    fit = RigidFit(
        model,
        model,
        pi,
        np.zeros((2, 6)),
        np.ones(2),
        7,
        {"q2": 1},
        covariance,
        None,
        FitStatus.FITTED,
        np.zeros(3),
        np.zeros(2),
        np.ones(2),
        5.0,
    )
    assert_allclose(fit.lags_sd, np.sqrt(np.diag(covariance))[-3:])
    sd = rigid_file.rigid_deviations(fit)
    eta = np.abs(np.diag(model.eta))
    phi = np.sqrt(np.diag(covariance)[n : n + 12]).reshape(2, 6)
    for j, motor in enumerate(model.motors):
        assert sd[f"{motor.name}.viscous"] == pytest.approx(phi[j, 0] / eta[j])
        assert (
            sd[f"{motor.name}.coulomb"] == pytest.approx(phi[j, 1])
            and sd[f"{motor.name}.offset"] == phi[j, 2]
        )
        assert sd[f"{motor.name}.inertia"] == pytest.approx(phi[j, 3] / eta[j])
    assert sd["q2.counterbalance_sin_2"] == pytest.approx(phi[1, 4] * eta[1])
    assert sd["q2.counterbalance_cos_2"] == pytest.approx(phi[1, 5] * eta[1])
    for k, element in enumerate(model.elements):
        row = pi[10 * k : 10 * k + 10]
        block = covariance[10 * k : 10 * k + 10, 10 * k : 10 * k + 10]
        assert sd[f"{element.name}.mass"] == pytest.approx(np.sqrt(block[0, 0]), rel=1e-6)
        for axis, name in enumerate(("com_x", "com_y", "com_z")):
            slope = np.zeros(10)
            slope[0] = -row[1 + axis] / row[0] ** 2
            slope[1 + axis] = 1 / row[0]
            assert sd[f"{element.name}.{name}"] == pytest.approx(
                np.sqrt(slope @ block @ slope), rel=1e-4
            )
    assert rigid_file.rigid_deviations(replace(fit, status=FitStatus.MODEL_ERROR)) == {}
    numbers = rigid_file.rigid_numbers(
        replace(fit, model=rigid_file.with_places(fit), counterbalance={})
    )
    assert (
        numbers["m1.inertia"] == model.motors[0].inertia
        and numbers["upper.mass"] == model.elements[0].body.mass
    )
    longer = rigid_file.with_places(replace(fit, model=balanced()))
    assert [d.counterbalance for e in longer.elements for d in e.dofs] == [((0.0, 0.0),) * 2, ()]
    same = rigid_file.with_places(replace(fit, model=balanced(), file=balanced()))
    assert next(d.counterbalance for e in same.elements for d in e.dofs) == (
        (40.0, -15.0),
        (9.0, 4.0),
    )
    with pytest.raises(
        ArgumentError,
        match=r"model file: given a payload of 1e\+04 kg, expected less: of the body \w+ of",
    ):
        rigid_file.write_rigid(replace(fit, file=replace(model, payload=Body(1e4))), "x.toml", "")


def test_the_last_body_carries_the_payload() -> None:
    """Mass, first and second moments about the joint add up."""
    model = flexgen.read("elbow@rigid")
    payload = Body(3.0, (0.1, -0.2, 0.3), ((0.4, 0.01, 0.0), (0.01, 0.5, 0.0), (0.0, 0.0, 0.6)))
    plain, loaded = (
        Regressor(replace(model, payload=x)).of_model().reshape(-1, 10) for x in (Body(), payload)
    )
    assert_allclose(loaded[:-1], plain[:-1])
    more = loaded[-1] - plain[-1]
    c = np.array(payload.com)
    second = np.array(payload.inertia) + 3.0 * (c @ c * np.eye(3) - np.outer(c, c))
    assert more[0] == pytest.approx(3.0) and sorted(more[1:4]) == pytest.approx(sorted(3.0 * c))
    assert sorted(more[4:]) == pytest.approx(sorted(second[np.triu_indices(3)]))


def test_errors_of_a_rigid_fit_decide_on_its_status() -> None:
    one = np.array([1.0, 1.0])
    scale = np.array([10.0, 10.0])
    status = rigid_accuracy.status_of
    assert status(np.array([3.34, 1.0]), scale, None, None) == FitStatus.MODEL_ERROR
    assert status(np.array([3.33, 1.0]), scale, None, None) == FitStatus.NOT_CHECKED
    assert status(one, scale, np.array([1.0, 2.01]), scale) == FitStatus.POORLY_VALIDATED
    assert status(one, scale, np.array([1.0, 1.99]), scale) == FitStatus.FITTED
    # of the torque not worse
    assert status(one, scale, np.array([1.0, 2.5]), 2 * scale) == FitStatus.FITTED
    assert status(0.1 * one, scale, np.array([0.1, 0.99]), scale) == FitStatus.FITTED  # too small
    t = np.r_[0.0, 0.1, 0.2, 0.31, np.arange(0.4, 9.0, 0.1)]
    for bad, text in (
        ({"t": t}, r"the time goes from 0\.2 to 0\.31 s, expected equal steps"),
        (
            {"t": np.r_[t[:60], 5.0] * 0 + np.r_[np.arange(60) * H, 1.0]},
            r"the time goes from 0\.236 to 1 s",
        ),
    ):
        n = len(bad["t"])
        with pytest.raises(ArgumentError, match=text):
            Motion(bad["t"], np.zeros((n, 2)), np.zeros((n, 2)))


def test_a_deflection_is_that_of_least_squares() -> None:
    """Compliance and skew by `numpy.linalg.lstsq`; the interval by blocks of half a second; words
    of each result.
    """
    rng = np.random.default_rng(0)
    t = np.arange(1400) * H
    q = 0.5 * np.sin(2.5 * t)
    tau = 900.0 * np.sin(4.4 * t + 1)
    link = np.interp(t - 2e-3, t, q - tau / 1e7) - 1e-3 + 2e-6 * rng.standard_normal(len(t))
    found = gear_deflection(t, q, link, tau)
    columns = np.column_stack([tau, np.gradient(q, H), np.ones_like(t)])
    used = (len(t) // 125) * 125
    x = np.linalg.lstsq(columns[:used], (q - link)[:used], rcond=None)[0]
    assert found.stiffness == pytest.approx(1 / x[0], rel=1e-6) and found.skew_s == pytest.approx(
        x[1], rel=1e-6
    )
    without = np.linalg.lstsq(columns[:, 1:], q - link, rcond=None)[0]
    rest = q - link - columns @ x
    whole = q - link - columns[:, 1:] @ without
    assert found.explained == pytest.approx(1 - rest.var() / whole.var(), rel=1e-3)
    each = [
        np.linalg.lstsq(columns[k : k + 125], (q - link)[k : k + 125], rcond=None)[0][0]
        for k in range(0, used, 125)
    ]
    low, high = found.interval
    assert 1 / max(each) < low < found.stiffness < high < 1 / min(each)
    assert (
        found.sentence
        == f"{found.stiffness:.3g} ({low:.3g} to {high:.3g}), skew {1e3 * found.skew_s:.2f} ms"
    )
    assert gear_deflection(t, q, link, tau, seed=1).interval != found.interval
    open_end = replace(found, stiffness=None, interval=(5e6, np.inf))
    none = replace(found, stiffness=None, interval=(np.inf,) * 2)
    assert (
        open_end.sentence
        == "not identifiable: the stiffness is above 5e+06, a rigid gear is possible"
    )
    assert none.sentence == "not identifiable: no deflection follows the torque"
    assert gear_deflection(t[:1250], q[:1250], link[:1250], tau[:1250]).stiffness is not None
    with pytest.raises(ArgumentError, match=r"deflection: given 5 s, expected 5\.0 s at least"):
        gear_deflection(t[:1249], q[:1249], link[:1249], tau[:1249])


def test_bodies_are_identified_from_described_recordings(tmp_path: Path) -> None:
    """Judged by parts that are left out, or by other recordings, and written to a file."""
    model = flexgen.read("elbow@rigid")
    first = described(tmp_path, "first", swung(model), model)
    other = described(tmp_path, "other", swung(model, 900), model)
    told: list[str] = []
    found = rigid_file.identify_bodies(model, first, progress=told.append)
    assert told[0] == "fitting the bodies of elbow to 1 recordings"
    assert list(found.errors) == ["fitted", "left out"] and found.fit.status.agrees
    checked = rigid_file.identify_bodies(model, first, validate=other)
    assert list(checked.errors) == ["fitted", "validated"] and checked.fit.left_out is None
    assert np.max(checked.errors["validated"]) < 0.02 and checked.fit.status == FitStatus.FITTED
    units = [(name, unit) for name, unit, _, _ in found.lags]
    rigid = "rad/(N m)"
    assert units == [("q1.compliance", rigid), ("q2.compliance", rigid), ("delay", "s")]
    assert [row["name"] for row in found.to_dict()["lags"]] == [name for name, _ in units]
    assert flexgen.read(found.write(tmp_path / "new.toml")).motors == found.fit.model.motors


def test_the_file_keeps_its_payload_and_bodies_near_cad(tmp_path: Path) -> None:
    """Bodies 4 % off and noise: the last body has what is not payload, no body is far from CAD."""
    text = Path(flexgen.read("elbow@rigid").file).read_text(encoding="utf-8")
    assert "[payload]" not in text
    load = "\n[payload]\nmass = 4.0\ncom = [0.1, 0.0, 0.05]\ninertia = [0.1, 0.1, 0.1]\n"
    (tmp_path / "arm.toml").write_text(text + load, encoding="utf-8")
    model = flexgen.read(f"{tmp_path / 'arm.toml'}@rigid")
    random = np.random.default_rng(0)
    true = tuple(
        replace(e, body=replace(e.body, mass=e.body.mass * (1 + 0.04 * random.uniform(-1, 1))))
        for e in model.elements
    )
    motion = swung(replace(model, elements=true), 1200)
    noise = 0.05 * random.normal(size=motion.tau_m.shape)
    first = described(tmp_path, "first", replace(motion, tau_m=motion.tau_m + noise), model)
    found = rigid_file.identify_bodies(model, first)
    again = flexgen.read(f"{found.write(tmp_path / 'new.toml')}@rigid")
    assert again.payload == model.payload
    assert_allclose(Regressor(again).of_model(), found.fit.pi, rtol=1e-9, atol=1e-9)
    wrong = replace(again, payload=replace(again.payload, mass=4.1))  # a fault that is found
    assert not np.allclose(Regressor(wrong).of_model(), found.fit.pi, rtol=1e-9, atol=1e-9)
    for before, after in zip(model.elements, again.elements, strict=True):
        assert after.body.mass == pytest.approx(before.body.mass, rel=0.2)
    wide = identify_rigid(model, rigid_file.motions_of(read_description(first)), parts=0)
    limit = np.maximum(
        rigid_file.AS_GOOD * np.array(wide.relative_errors(motion)), rigid_file.GOOD
    )
    assert (np.array(found.fit.relative_errors(motion)) <= limit + 1e-3).all()


@pytest.mark.parametrize("seed", [1, 3])
def test_a_heavy_payload_is_a_constant_of_the_fit(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A short record of bodies that are not those of CAD, whose moments are at the bound: a body
    is left below the payload. Planted: a fit that does not know the payload.
    """
    text = Path(flexgen.read("elbow@rigid").file).read_text(encoding="utf-8")
    load = "\n[payload]\nmass = 150.0\ncom = [0.1, 0.0, 0.05]\ninertia = [0.5, 0.5, 0.5]\n"
    (tmp_path / "arm.toml").write_text(text + load, encoding="utf-8")
    model = flexgen.read(f"{tmp_path / 'arm.toml'}@rigid")
    random = np.random.default_rng(seed)

    def off(body: Body) -> Body:
        mass = body.mass * (1 + 0.05 * random.uniform(-1, 1))
        com = tuple(x * (1 + 0.1 * random.uniform(-1, 1)) for x in body.com)
        return replace(body, mass=mass, com=com)

    elements = tuple(replace(e, body=off(e.body)) for e in model.elements)
    motion = swung(replace(model, elements=elements), 400)
    noise = 0.5 * random.normal(size=motion.tau_m.shape)
    record = described(tmp_path, "short", replace(motion, tau_m=motion.tau_m + noise), model)

    def is_kept(name: str) -> bool:
        found = rigid_file.identify_bodies(model, record)
        again = flexgen.read(f"{found.write(tmp_path / name)}@rigid")
        assert again.payload == model.payload
        assert (found.fit.relative_errors(motion) < 0.01).all()
        rows = Regressor(again).of_model()
        positive = np.linalg.eigvalsh(pseudo_inertia(numbers_of(again.elements[-1].body)))[0] > 0
        return bool(positive and np.allclose(rows, found.fit.pi, rtol=1e-9, atol=1e-9))

    assert is_kept("new.toml")
    if seed == 1:
        monkeypatch.setattr(rigid_body, "payload_in", lambda robot: np.zeros(20))
        with pytest.raises(ArgumentError, match="given a payload of 150 kg"):
            is_kept("wrong.toml")
