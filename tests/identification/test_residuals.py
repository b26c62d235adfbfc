"""Residuals of responses, their weights and derivatives, and the vector of parameters."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identification_cases import exact_responses, noisy_responses, poses_of, without_coulomb
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.controllers import Cascade
from flexgen.identification.responses import residuals as weights
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.noise_structure import structured_covariance
from flexgen.identification.responses.parameters import ParameterVector, cascade_at
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.response_inputs import Drive, with_drive

RNG = np.random.default_rng


def moved(vector: ParameterVector) -> np.ndarray:
    return vector.start + 0.05 * np.cos(np.arange(len(vector)))


@pytest.fixture(scope="module")
def data() -> flexgen.Frf:
    return noisy_responses()


def test_springs_are_averaged_over_the_deflections_of_one_experiment() -> None:
    """The matrix of a cubic spring averaged over a deviation, k + 3 k3 sd^2, has the deviation
    that the torques cause: the mean over three experiments, which `UU` adds.
    """
    stiffness = 10.0
    cubic = 3e4
    spring = {"type": "cubic", "stiffness": stiffness, "cubic": cubic}
    model = flexgen.read("four_mass", overrides={"element.mass1.dof.q1.gear.spring": spring})
    w = 2 * np.pi * np.array([0.11, 0.6, 1.7])
    made = exact_responses(model, poses_of(model, 1), w, Drive(0.0, 0.0))
    # (experiments, lines)
    u = np.array([[0.010, 0.020, 0.011], [0.015, 0.006, 0.02j], [0.012j, 0.03, 0.01]])
    UU = (np.abs(u) ** 2).sum(axis=0)[None, :, None, None] + 0j
    vector = ParameterVector(model, ["q1.damping"])
    residuals = Residuals(vector, replace(made, UU=UU, experiments=3))
    residuals.average_springs(vector.start)
    local = residuals.local
    M, D, K, B = (x[0] for x in local.matrices(local.values, made.poses))
    row = local.deflection_rows[0]
    sd = 0.0
    for _ in range(50):
        K_mean = K + 3 * cubic * sd**2 * np.outer(row, row)
        X = np.array([row @ np.linalg.solve(K_mean + 1j * s * D - s**2 * M, B[:, 0]) for s in w])
        sd = float(np.sqrt(np.mean([(np.abs(X * one) ** 2).sum() / 2 for one in u])))
    assert 3 * cubic * sd**2 > 0.02 * stiffness  # so that the average matters
    assert_allclose(residuals.deflection_sd, [[sd]], rtol=1e-3)


def test_a_response_of_zero_has_no_logarithm(data: flexgen.Frf) -> None:
    """Axes at right angles; the logarithm was minus infinity, and eigenvalues did not converge."""
    vector = ParameterVector(without_coulomb("planar5_nmp"), ["q1.stiffness"])
    G = data.G.copy()
    G[1, 2, 0, 1] = 0.0
    with pytest.raises(
        ArgumentError,
        match='residual: given "lls", expected "nls": a response is zero, and has no',
    ):
        Residuals(vector, replace(data, G=G), "lls").weight(moved(vector), False)
    assert np.isfinite(Residuals(vector, replace(data, G=G)).weight(moved(vector), False)[0]).all()


@pytest.mark.parametrize("kind", ["nls", "lls", "structured"])
def test_residuals_have_their_weights_and_derivatives(data: flexgen.Frf, kind: str) -> None:
    """Residuals by loops, derivatives by differences, sums, and the covariance of all entries."""
    model = without_coulomb("planar5_nmp")
    vector = ParameterVector(
        model, ["q1.stiffness", "q3.stiffness", "m2.torque_constant", "delay"]
    )
    made = Residuals(vector, data, "nls" if kind == "structured" else kind, 0.02)
    made.drive = replace(made.drive, has_images=False)  # which derivatives leave out
    x = moved(vector)
    x[3] = 1.2e-3
    if kind == "structured":
        torque, output = made.use_structure(x)
        assert (torque >= 0).all() and (output >= 0).all()
    G = made.response(x).G
    r, J = made.weight(x, True)
    assert J is not None
    variance = data.variance + (0.02**2 + 1e-18) * np.abs(data.G) ** 2
    assert_allclose(made.variance, variance)
    for at in np.ndindex(2, 4):
        if kind == "structured":
            C = (G[at] * torque**2) @ G[at].conj().T + data.w[at[1]] ** 4 * np.diag(output**2)
            wanted = (
                np.linalg.inv(np.linalg.cholesky(C))
                @ (G[at] - data.G[at])
                @ np.linalg.cholesky(data.UU[at])
                * 5**0.5
            )
            assert_allclose(r[at], wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())
        elif kind == "nls":
            assert_allclose(r[at], (G[at] - data.G[at]) / np.sqrt(variance[at]))
        else:
            assert_allclose(
                r[at], np.log(G[at] / data.G[at]) * np.abs(data.G[at]) / np.sqrt(variance[at])
            )
    for i, h in enumerate((1e-5, 1e-5, 1e-5, 1e-8)):
        e = h * (np.arange(4) == i)
        slope = (made.weight(x + e, False)[0] - made.weight(x - e, False)[0]) / (2 * h)
        assert np.abs(slope - J[..., i]).max() < 1e-4 * np.abs(slope).max()
    cost, gradient, A = made.sums(x)
    assert cost == pytest.approx((np.abs(r) ** 2).sum()) == pytest.approx(made.cost(x))
    assert_allclose(gradient, np.einsum("klabi,klab->i", J.conj(), r).real)
    assert_allclose(A, np.einsum("klabi,klabj->ij", J.conj(), J).real, atol=1e-12 * A.max())
    prior = np.diag(vector.prior_sd**-2.0)
    H = np.linalg.inv(A + prior)
    if kind == "structured":
        expected = H @ (A / 2 + prior) @ H
    else:
        size = np.abs(G) if kind == "lls" else 1.0
        Z = J * ((np.abs(data.G) if kind == "lls" else 1.0) / size / np.sqrt(variance))[..., None]
        B = np.zeros((4, 4))
        for at in np.ndindex(2, 4):
            S = np.linalg.inv(data.UU[at]).T / 5
            full = np.einsum("ac,bd->abcd", data.C[at], S)  # cov G_ab, G_cd
            for extra in np.ndindex(2, 2):
                full[(*extra, *extra)] += variance[(*at, *extra)] - data.variance[(*at, *extra)]
            B += np.einsum("abi,abcd,cdj->ij", Z[at].conj(), full, Z[at]).real
        expected = H @ (B / 2 + prior) @ H
    found = made.covariance(x, A)
    d = np.sqrt(np.diag(expected))
    assert np.abs((found - expected) / np.outer(d, d)).max() < 1e-5


def test_levels_of_noise_are_found_in_exact_covariances(data: flexgen.Frf) -> None:
    """``G S_u G^H + w^4 S_y`` gives its variances back; means over neighboring lines are those of
    slices.
    """
    torque = np.array([0.3, 0.02])
    output = np.array([2e-9, 7e-9])
    powers = weights.output_powers(data, data.w)
    assert_allclose(powers, np.stack([data.w**4] * 2, axis=1))
    C = structured_covariance(data.G, powers, torque, output)
    plain = (data.G * torque) @ data.G.conj().swapaxes(-1, -2) + np.einsum(
        "lo,ab->lab", powers[:, :1] * 0, np.eye(2)
    )
    plain = plain + np.array([np.diag(w**4 * output) for w in data.w])
    assert_allclose(C, plain, rtol=1e-8, atol=1e-8 * np.abs(plain).max())
    assert (np.einsum("klaa->kla", C - plain).real > 0).all()
    found = weights.noise_levels(replace(data, C=C), data.G)
    assert_allclose(found[0], torque, rtol=1e-4)
    assert_allclose(found[1], output, rtol=1e-4)
    x = RNG(3).normal(size=(2, 9, 2))
    smooth = weights.over_lines(x, 7)
    assert_allclose(smooth[:, 4], x[:, 1:8].mean(axis=1))
    assert_allclose(smooth[:, 0], x[:, :4].mean(axis=1))
    assert_allclose(smooth[:, 8], x[:, 5:].mean(axis=1))
    variance = RNG(4).uniform(1, 2, data.G.shape)
    relative = weights.over_lines(variance / np.abs(data.G) ** 2, 7)
    model = without_coulomb("planar5_nmp")
    total = Residuals(
        ParameterVector(model, ["stiffness"]), replace(data, total=variance)
    ).variance
    assert_allclose(
        total,
        np.maximum(relative * np.abs(data.G) ** 2, data.variance) + 1e-18 * np.abs(data.G) ** 2,
    )


def test_drives_and_sensors_are_late_by_their_delays() -> None:
    w = np.array([10.0, 200.0])
    drive = with_drive(
        Drive(1e-3, 2e-3, (1.5, 1.0)), {"m2.torque_constant": 0.9, "acc.delay": 4e-3}, ("m1", "m2")
    )
    assert drive == Drive(1e-3, 2e-3, (1.5, 0.9), {"acc": 4e-3})
    late = with_drive(drive, {"delay": 7e-3, "acc.delay": 5e-3}, ("m1", "m2"))
    assert late == Drive(1e-3, 7e-3, (1.5, 0.9), {"acc": 5e-3})
    hold = np.array([(1 - np.exp(-1j * x * 1e-3)) / (1j * x * 1e-3) for x in w])
    assert_allclose(drive.transfer(w, 2), (hold * np.exp(-2e-3j * w))[:, None] * [1.5, 0.9])
    assert_allclose(Drive().transfer(w, 2), 1.0)
    sensors = [
        {"name": "acc", "type": "accelerometer", "element": "fore", "unit": "m/s^2"},
        {"name": "link", "type": "gyro", "element": "fore", "unit": "rad/s", "delay_s": 2e-3},
    ]
    model = flexgen.read("elbow", overrides={"sensor": sensors})
    rows = LocalModel(model, (), ("acc.x", "link.x")).outputs
    found = rows.transfer(w, {"acc": 3e-3})
    late = np.stack([np.exp(-3e-3j * w), 1j * w * np.exp(-2e-3j * w)], axis=1)
    assert_allclose(found, np.column_stack([(1j * w) ** 2] * 2 + [late]))
    assert rows.of("acc").tolist() == [False, False, True, False]
    cascade = Cascade(np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([5.0, 6.0]))
    other = cascade_at(cascade, {"m2.speed_gain": 9.0, "m1.integral_gain": 7.0}, ("m1", "m2"))
    assert other.position_gain.tolist() == [1.0, 2.0]
    assert (other.speed_gain.tolist(), other.integral_gain.tolist()) == ([3.0, 9.0], [7.0, 6.0])


def test_a_vector_of_parameters_has_scales_bounds_and_messages() -> None:
    """Logarithms and lines, gains of drives, ties, and each refusal with its words."""
    model = flexgen.read(
        "planar5_nmp", overrides={"sensor": [{"name": "seen", "type": "tracker", "unit": "m"}]}
    )
    cascade = Cascade(np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.array([5.0, 0.0]))
    free = [
        "q1.stiffness",
        "delay",
        "speed_gain",
        "integral_gain",
        "seen.delay",
        "torque_constant",
        "payload.com_x",
    ]
    vector = ParameterVector(
        model, free, controller=cascade, start={"delay": 2e-3}, bounds={"q1.stiffness": (1e3, 1e9)}
    )
    logs = {u.name: (u.scale, u.start, u.prior_sd) for u in vector.unknowns}
    k = vector.names.index("q1.stiffness")
    value = vector.unknowns[k].start
    assert logs["delay"] == ("linear", 2e-3, 1e-2) and logs["seen.delay"] == ("linear", 0.0, 1e-2)
    assert logs["payload.com_x"][0::2] == ("linear", 1e3) and logs["q1.stiffness"] == (
        "log",
        value,
        2.0,
    )
    assert logs["m1.speed_gain"] == ("log", 3.0, 2.0) and logs["m2.torque_constant"] == (
        "log",
        1.0,
        2.0,
    )
    assert "m1.integral_gain" in logs and "m2.integral_gain" not in logs
    assert (
        vector.unknowns[vector.names.index("m1.speed_gain")].parameter.doc
        == "speed gain of the drive of m1"
    )
    x = vector.start
    lower, upper = vector.bounds
    assert x[k] == pytest.approx(np.log(value))
    assert (lower[k], upper[k]) == (pytest.approx(np.log(1e3)), pytest.approx(np.log(1e9)))
    c = vector.names.index("m1.speed_gain")
    assert (np.exp(lower[c]), np.exp(upper[c])) == (pytest.approx(3e-6), pytest.approx(3e6))
    d = vector.names.index("delay")
    assert (x[d], lower[d], upper[d]) == (2e-3, -np.inf, np.inf)
    at = x + 0.1
    assert vector.values(at)[k] == pytest.approx(value * np.exp(0.1)) and vector.values(at)[
        d
    ] == pytest.approx(0.102)
    assert (
        vector.dvalues(at)[k] == pytest.approx(value * np.exp(0.1))
        and vector.dvalues(at)[d] == 1.0
    )
    assert_allclose(vector.x(vector.values(at)), at)
    tied = ParameterVector(
        model, ["stiffness"], ties={"q2.stiffness": "q1.stiffness"}, fixed=["q3.stiffness"]
    )
    assert tied.names == ("q1.stiffness",) and len(tied) == 1
    named = tied.named(tied.start + np.log(3.0))
    second = model.coordinates[1].dof
    assert second is not None and second.gear is not None
    assert named == pytest.approx(
        {"q1.stiffness": 3 * value, "q2.stiffness": 3 * second.gear.spring.stiffness}
    )
    refused: list[tuple[list[str], dict[str, Any], str]] = [
        (
            ["m1.speed_gain"],
            {},
            "free: given 'm1.speed_gain', which only 'refine' can fit: it simulates the drives",
        ),
        (["x.delay"], {}, "free: given 'x.delay', expected one of seen.delay"),
        (
            ["q1.stiffness"],
            {"bounds": {"q1.stiffness": (0.0, 1e9)}},
            "interval that contains the start .*, above 0",
        ),
        (["delay"], {"bounds": {"delay": (1.0, 2.0)}}, r"interval that contains the start 0\.0$"),
    ]
    for names, more, text in refused:
        with pytest.raises(ArgumentError, match=text):
            ParameterVector(model, names, **more)


def test_directions_that_are_noise_of_the_torques_are_not_determined(data: flexgen.Frf) -> None:
    """Where the noise excites more than 8 % of the information of a number, its deviation is that
    of a factor e; the other numbers hardly change.
    """
    vector = ParameterVector(without_coulomb("planar5_nmp"), ["q1.stiffness", "q2.stiffness"])
    sd = {}
    misfits = []
    for part in (0.0, 0.02, 0.2):
        noise_UU = part * data.UU * np.array([[1.0, 0.0], [0.0, 0.9]])
        made = Residuals(vector, replace(data, noise_UU=noise_UU, noise_YU=data.G @ noise_UU))
        made.use_structure(vector.start)
        misfits.append(made.misfit(moved(vector)))
        covariance = made.covariance(vector.start, made.sums(vector.start)[2])
        sd[part] = np.sqrt(np.diag(covariance))
    assert (sd[0.0] < 0.1).all() and (np.abs(sd[0.02] / sd[0.0] - 1.0) < 0.1).all()
    assert (sd[0.2] >= 1.0).all() and (sd[0.2] < 1.5).all()
    # the squares in the directions of the noise are those in all directions
    assert_allclose(misfits, misfits[0], rtol=0.05)


def test_deflections_have_the_spectrum_of_the_torques_that_drives_give() -> None:
    """Experiment by experiment from amplitudes, through the hold and the delay of the drives."""
    model = without_coulomb("planar5_nmp")
    cubic = {"type": "cubic", "stiffness": 4e5, "cubic": 1e9}
    model = flexgen.read("planar5_nmp", overrides={"element.arm1.dof.q1.gear.spring": cubic})
    local = LocalModel(model, ())
    q_m = poses_of(model, 1) @ model.eta.T
    w = np.array([7.0, 19.0])
    drive = Drive(1e-3, 2e-3, (1.5, 1.0))
    U = RNG(8).normal(size=(1, 2, 2, 3, 2)) @ [1, 1j]
    found = local.deflection_sd(local.values, q_m, w, drive, U @ U.conj().swapaxes(-1, -2))
    M, D, K, B = (x[0] for x in local.matrices(local.values, q_m))
    power = 0.0
    for k, at in enumerate(w):
        torque = drive.transfer(w, 2)[k][:, None] * U[0, k]
        x = np.linalg.solve(-(at**2) * M + 1j * at * D + K, B @ torque)
        power += (np.abs(local.deflection_rows[0] @ x) ** 2).sum() / 2
    assert found[0, 0] == pytest.approx(np.sqrt(power))
