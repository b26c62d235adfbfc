"""Frequency responses and their residuals by other routes: loops over lines, differences, closed
forms, whole files.
"""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from identification_cases import exact_responses, poses_of, small_plan, without_coulomb
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.loop.controllers import Cascade
from flexgen.identification.experiments.experiment import Experiment
from flexgen.identification.responses import frequency_response as fr
from flexgen.identification.responses import residuals as weights
from flexgen.identification.responses.noise_structure import structured_covariance
from flexgen.identification.responses.parameters import ParameterVector, cascade_at
from flexgen.identification.responses.residuals import Residuals
from flexgen.identification.responses.response_inputs import Drive, with_drive
from flexgen.identification.responses.response_outputs import OutputRows

RNG = np.random.default_rng


def complex_(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.normal(size=shape) + 1j * rng.normal(size=shape)


@pytest.mark.parametrize("average", ["arithmetic", "harmonic", "logarithmic", "h1"])
def test_an_estimate_is_that_of_each_line(average: str) -> None:
    """Least squares, covariance of the misfit and means over realizations, line by line; with
    noise as given, too.

    Shown to see: each count of periods, experiments and realizations, and each mean.
    """
    k = 2
    R = 3
    P = 4
    L = 3
    n = 2
    E = 3
    rng = RNG(0)
    U = complex_(rng, k, R, P, L, n, E)
    G = complex_(rng, k, 1, 1, L, n, n)
    Y = (G + 0.1 * complex_(rng, k, R, 1, L, n, n)) @ U + 0.1 * complex_(rng, k, R, P, L, n, E)
    noise = 0.1 * complex_(rng, k, R, 5, L, n, E), 0.1 * complex_(rng, k, R, 5, L, n, E)
    plain = fr.estimate(U, Y, average)
    given = fr.estimate(U, Y, average, noise)
    for a in range(k):
        for line in range(L):
            each = []
            UU = np.zeros((n, n), complex)
            C = np.zeros((n, n), complex)
            Cn = np.zeros((n, n), complex)
            for r in range(R):
                u = U[a, r, :, line]
                y = Y[a, r, :, line]
                one = np.hstack(list(u)) if average == "h1" else u.mean(axis=0)
                two = np.hstack(list(y)) if average == "h1" else y.mean(axis=0)
                g = np.linalg.lstsq(one.T, two.T, rcond=None)[0].T
                each.append(g)
                UU += one @ one.conj().T / (P if average == "h1" else 1)
                for p in range(P):
                    v = y[p] - g @ u[p]
                    C += v @ v.conj().T / ((P - 1) * E * R)
                for p in range(5):
                    v = noise[1][a, r, p, line] - g @ noise[0][a, r, p, line]
                    Cn += v @ v.conj().T / (E * R)
            all_of_them = np.array(each)
            mean = all_of_them.mean(axis=0)
            if average == "harmonic":
                mean = np.linalg.inv(np.linalg.inv(all_of_them).mean(axis=0))
            if average == "logarithmic":
                ratio = all_of_them / mean
                mean = mean * np.exp((np.log(np.abs(ratio)) + 1j * np.angle(ratio)).mean(axis=0))
            for found, cov, periods in ((plain, C, P), (given, Cn, 1)):
                assert_allclose(found.G[a, line], mean, rtol=1e-9)
                assert_allclose(found.UU[a, line], UU, rtol=1e-9)
                assert_allclose(found.C[a, line], cov, rtol=1e-9)
                S = np.linalg.inv(UU).diagonal().real / periods
                assert_allclose(
                    found.variance[a, line], np.outer(cov.diagonal().real, S), rtol=1e-9
                )
                spread = (
                    (np.abs(all_of_them - all_of_them.mean(axis=0)) ** 2).sum(axis=0) / (R - 1)
                ) / R
                assert_allclose(found.total[a, line], spread, rtol=1e-9)
    single = fr.estimate(U[:, :1, :1], Y[:, :1, :1], average)
    assert single.total is None
    wanted = Y[:, 0, 0] @ np.linalg.pinv(U[:, 0, 0])
    assert_allclose(single.G[:, 0] if single.G.ndim == 5 else single.G, wanted, rtol=1e-9)
    same = U.copy()
    same[..., 1, :] = 2 * same[..., 0, :]
    for bad in (same, U[..., :1]):
        with pytest.raises(np.linalg.LinAlgError):
            fr.estimate(bad[:, :, :1], Y[..., : bad.shape[-1]][:, :, :1], average)


def test_a_period_that_differs_is_named() -> None:
    """Six times the scatter of the others; an error from a tenth of the signal on, fewer than
    three periods never.
    """
    rng = RNG(1)
    Y = 1.0 + 1e-3 * complex_(rng, 2, 1, 4, 40, 2, 3)
    assert fr._check_repeats(Y, "data") == ()
    some = Y.copy()
    some[1, 0, 2, :, :, 1] += 0.05
    (text,) = fr._check_repeats(some, "data")
    assert text.startswith(
        "pose 2, realization 1, experiment 2: period 3 differs from the others by 0.049 of the "
        "signal"
    )
    assert fr._check_repeats(some[:, :, 1:3], "data") == ()
    some[1, 0, 2, :, :, 1] += 0.1
    with pytest.raises(
        ArgumentError,
        match=r"data: pose 2, .* by 0\.1[45] of the signal .*; leave out more transient peri",
    ):
        fr._check_repeats(some, "data")
    (text,) = fr._check_repeats(complex_(rng, 1, 1, 5, 40, 2, 3), "data")
    assert text.startswith("the periods differ from each other by 0.96 of") and text.endswith(
        "than was excited"
    )
    exact = np.ones((1, 1, 3, 5, 1, 1), complex)
    assert fr._check_repeats(exact, "data") == ()
    exact[0, 0, 1] += 5e-3
    assert fr._check_repeats(exact, "data") == ()  # below six thousandths
    exact[0, 0, 1] += 2e-3
    assert len(fr._check_repeats(exact, "data")) == 1


@pytest.fixture(scope="module")
def data() -> flexgen.Frf:
    model = without_coulomb("planar5_nmp")
    w = 2 * np.pi * np.array([3.0, 8.0, 21.0, 55.0])
    made = exact_responses(model, poses_of(model, 2), w, Drive(1e-3, 1e-3), 1e-2)
    rng = RNG(2)
    root = complex_(rng, 2, 4, 2, 2)
    other = complex_(rng, 2, 4, 2, 3)
    C = root @ root.conj().swapaxes(-1, -2) * np.abs(made.G).mean() ** 2 * 1e-4
    UU = other @ other.conj().swapaxes(-1, -2)
    S = np.linalg.inv(UU).real / 5
    variance = (
        np.einsum("klaa->kla", C).real[..., :, None] * np.einsum("klbb->klb", S)[..., None, :]
    )
    return replace(made, C=C, UU=UU, variance=variance, periods=5, experiments=3)


def moved(vector: ParameterVector) -> np.ndarray:
    return vector.start + 0.05 * np.cos(np.arange(len(vector)))


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
    assert_allclose(weights._smooth_variances(variance, data.G), relative * np.abs(data.G) ** 2)
    model = without_coulomb("planar5_nmp")
    total = Residuals(
        ParameterVector(model, ["stiffness"]), replace(data, total=variance)
    ).variance
    assert_allclose(
        total,
        np.maximum(relative * np.abs(data.G) ** 2, data.variance) + 1e-18 * np.abs(data.G) ** 2,
    )


def test_files_of_responses_are_checked(data: flexgen.Frf) -> None:
    """Each array that does not fit, and numbers at their limits."""
    arrays, meta = data.data()
    again = flexgen.Frf.from_data(arrays, meta)
    assert_allclose(again.G, data.G)
    assert (again.periods, again.experiments, again.sample_s, again.delay_s) == (5, 3, 1e-3, 1e-3)
    assert repr(again) == "<Frf planar5_nmp: 2 poses, 4 lines 3 .. 55 Hz, 2 x 2>"
    assert again.relative_sd() == pytest.approx(np.median(np.sqrt(data.variance) / np.abs(data.G)))
    skew = data.C.copy()
    flat = data.UU.copy()
    large = data.UU * 1e101
    skew[..., 0, 1] *= 1.01
    flat[0, 0] = np.outer([1.0, 2.0], [1.0, 2.0])
    bad: list[tuple[dict[str, Any], dict[str, Any], str]] = [
        ({"G": data.G[:1]}, {}, "arrays of different sizes"),
        ({"poses": data.poses[:, :1]}, {}, "arrays of different sizes"),
        ({"speed_sd": np.zeros((2, 3))}, {}, "arrays of different sizes"),
        ({"total": np.zeros((1, 1))}, {}, "arrays of different sizes"),
        ({}, {"orders": [1]}, "arrays of different sizes"),
        ({"noise_UU": data.UU}, {}, "noise_UU, noise_YU: expected both"),
        (
            {"noise_UU": data.UU[:, 1:], "noise_YU": data.G},
            {},
            "noise_UU, noise_YU: expected both",
        ),
        ({"w": data.w[::-1]}, {}, "expected rising frequencies > 0 and variances >= 0"),
        ({"w": data.w * 0}, {}, "expected rising frequencies > 0"),
        ({"w": data.w[[0, 1, 1, 3]]}, {}, "expected rising frequencies > 0"),
        ({"variance": -data.variance}, {}, "expected rising frequencies > 0"),
        ({"C": skew}, {}, "C: expected Hermitian matrices, positive definite"),
        ({"UU": flat}, {}, "UU: expected Hermitian matrices, positive definite"),
        ({"C": -data.C}, {}, "C: expected Hermitian matrices, positive definite"),
        ({"UU": large}, {}, r"G, UU, C: expected numbers between 0 and 1e\+100"),
        ({"G": 0 * data.G}, {}, "G, UU, C: expected numbers between 0"),
        ({"G": 1e130 * data.G}, {}, "G, UU, C: expected numbers between 0"),
        (
            {},
            {"periods": 0},
            "periods, experiments, sample_s, delay_s: expected numbers > 0 and times >= 0",
        ),
        ({}, {"experiments": 0}, "periods, experiments, sample_s"),
        ({}, {"delay_s": -1e-9}, "periods, experiments, sample_s"),
        ({}, {"sample_s": float("inf")}, "periods, experiments, sample_s"),
    ]
    for changed, other, text in bad:
        with pytest.raises(ValueError, match=text):
            flexgen.Frf.from_data({**arrays, **changed}, {**meta, **other})
    k = len(data.poses)
    n = len(data.motors)
    numbers = np.array([1, 2, 4, 7])
    torques = np.ones((k, 1, 4, n, n), complex)
    motion = {"torques": torques, "numbers": numbers, "gains": np.ones((3, n))}
    moved: list[tuple[dict[str, Any], str]] = [
        ({"numbers": numbers - 1}, "those of lines rising from 1"),
        ({"numbers": np.array([1, 2, 2, 7])}, "those of lines rising from 1"),
        ({"gains": np.full((3, n), 1.01 * fr.LARGEST)}, "numbers up to"),
        ({"gains": np.ones((2, n))}, "arrays of different sizes"),
        ({"torques": torques[:1]}, "torques: expected those of each pose"),
        ({"torques": torques[..., :1]}, "torques: expected those of each pose"),
        ({"torques": None}, "expected all of them or none"),
    ]
    for changed, text in moved:
        with pytest.raises(ValueError, match=text):
            fr._check_motion([(motion | changed)[name] for name in motion], k, 4, n)
    fr._check_motion([*(motion | {"gains": np.full((3, n), fr.LARGEST)}).values()], k, 4, n)
    fr._check_motion([None, None, None], k, 4, n)
    wide = {"G": np.ones((k, 4, n + 3, n), complex), "variance": np.ones((k, 4, n + 3, n))}
    wide["C"] = np.tile(np.eye(n + 3, dtype=complex), (k, 4, 1, 1))
    plain = {x: y for x, y in arrays.items() if x != "total"}
    named = {"sensors": ["a.x", "b.y", "c"]}
    for orders in ([0, 1, 2], [2, 2, 0], [0, 0, 0]):
        assert flexgen.Frf.from_data(
            plain | wide, meta | named | {"orders": orders}
        ).orders == tuple(orders)
    for orders in ([0, 1, 3], [-1, 1, 2], [0, 1]):
        with pytest.raises(ValueError, match="arrays of different sizes"):
            flexgen.Frf.from_data(plain | wide, meta | named | {"orders": orders})
    kept = flexgen.Frf.from_data(
        {**arrays, "C": 0 * data.C}, {**meta, "sample_s": 0.0, "delay_s": 0.0, "periods": 1}
    )
    assert kept.sample_s == kept.delay_s == 0.0
    for pose in (-1, 2):
        with pytest.raises(ArgumentError, match=rf"pose: given {pose}, expected 0 to 1"):
            data.to_control(pose)


def test_an_experiment_gives_its_hold_its_delay_and_its_warnings() -> None:
    """Each refusal and each branch of `frf` on one experiment with changed parts."""
    model = without_coulomb("planar5_nmp")
    plan = small_plan(model, poses_of(model, 1), period_s=0.25, f_max=60.0, lines=4, periods=3)
    measured = flexgen.measure(plan, model, seed=1)
    experiment: Experiment = replace(measured, offsets=None, beside=None)
    found = flexgen.frf(experiment)
    assert (found.sample_s, found.periods, found.experiments) == (
        plan.hardware.sample_s,
        3,
        2,
    ) and found.total is None
    assert flexgen.frf(replace(experiment, hold="none")).sample_s == 0.0
    w = 2 * np.pi * plan.frequencies
    Y, U = (x[0, 0].mean(axis=1).transpose(1, 2, 0) for x in (experiment.q_m, experiment.tau_m))
    by_hand = -(w[:, None, None] ** 2) * Y @ np.linalg.inv(U)
    assert_allclose(found.G[0], by_hand, rtol=1e-6)
    turned = flexgen.frf(replace(experiment, periodic=False))
    assert turned.warnings[0].startswith(
        "the motion is not periodic: estimated from 3 windowed segments; leakage"
    )
    factor = turned.variance / flexgen.frf(experiment, average="h1").variance
    assert_allclose(factor, 1 + 2 / 36, rtol=1e-9)
    torque_only = flexgen.frf(replace(experiment, lines_by_torque=True))
    assert torque_only.warnings[-1].startswith(
        f"the {len(w)} lines are those where the torques are large: distortion"
    )
    with pytest.raises(
        ArgumentError,
        match=r"torques were at their limits at the poses 1; a saturated motor is not lin",
    ):
        flexgen.frf(replace(experiment, saturated=np.ones(1, np.int64)))
    with pytest.raises(
        ArgumentError,
        match=r"transients: .* has no spectra beside the lines; keep them with measure\(",
    ):
        flexgen.frf(experiment, transients=True)
    named = replace(plan, sensors=("acc.x",))
    still = np.zeros((*experiment.q_m.shape[:-1], 1), complex)
    for changes, text in (
        (
            {"plan": named, "signals": still, "orders": (0,)},
            "the sensor channels acc.x do not move at all; leave them out",
        ),
        ({"plan": named, "signals": still + 1.0}, "the kinds of the sensors are not known"),
    ):
        with pytest.raises(ArgumentError, match=text):
            flexgen.frf(replace(experiment, **changes))
    with pytest.raises(
        ArgumentError, match="given 'harmonic' with sensors, expected as many outputs as motors"
    ):
        flexgen.frf(
            replace(experiment, plan=named, signals=still + 1.0, orders=(0,)), average="harmonic"
        )
    sensed = flexgen.frf(
        replace(experiment, plan=named, signals=2 * experiment.q_m[..., :1], orders=(1,))
    )
    assert_allclose(sensed.G[0, :, 2], 2 * found.G[0, :, 0] / (1j * w[:, None]), rtol=1e-9)
    noise = np.einsum("klaa->kla", found.C).real
    power = (np.abs(w[:, None] ** 2 * experiment.q_m) ** 2).mean(axis=(1, 2, 3))
    assert_allclose(fr.coherence(experiment), 1 - noise / power, rtol=1e-9)


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
    rows: Any = SimpleNamespace(
        sensors=("", "acc", "link"), delays=np.array([0.0, 1e-3, 2e-3]), orders=np.array([2, 0, 1])
    )
    found = OutputRows.transfer(rows, w, {"acc": 3e-3})
    wanted = np.stack([(1j * w) ** 2, np.exp(-3e-3j * w), 1j * w * np.exp(-2e-3j * w)], axis=1)
    assert_allclose(found, wanted)
    assert OutputRows.of(rows, "acc").tolist() == [False, True, False]
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
        ([], {}, "free: given no parameter, expected some, such as 'stiffness', 'q1.damping'"),
        (
            ["q1.stiffness"],
            {"start": {"q9": 1.0}},
            "start: given 'q9', expected one of the free q1.stiffness",
        ),
        (
            ["q1.stiffness"],
            {"ties": {"q2.stiffness": "q3"}},
            "ties: given 'q3', expected one of the free q1.stiffness",
        ),
        (
            ["m1.speed_gain"],
            {},
            "free: given 'm1.speed_gain', which only 'refine' can fit: it simulates the drives",
        ),
        (
            ["m9.speed_gain"],
            {},
            r"free: given 'm9.speed_gain', expected one of m1.torque_constant, m2",
        ),
        (["x.delay"], {}, "free: given 'x.delay', expected one of seen.delay"),
        (
            ["q1.stiffness"],
            {"start": {"q1.stiffness": 0.0}},
            "start of q1.stiffness: given 0.0 .* a number > 0",
        ),
        (
            ["q1.stiffness"],
            {"bounds": {"q1.stiffness": (0.0, 1e9)}},
            "interval that contains the start .*, above 0",
        ),
        (
            ["q1.stiffness"],
            {"bounds": {"q1.stiffness": (1.0, 2.0)}},
            "bounds of q1.stiffness: given 1.0 to 2.0",
        ),
        (["delay"], {"bounds": {"delay": (1.0, 2.0)}}, r"interval that contains the start 0\.0$"),
        (
            ["delay"],
            {"priors": {"delay": 0.0}},
            "prior of delay: given a standard deviation of 0.0, expected",
        ),
    ]
    for names, more, text in refused:
        with pytest.raises(ArgumentError, match=text):
            ParameterVector(model, names, **more)
