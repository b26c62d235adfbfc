"""Estimates of frequency responses line by line, their files, and each branch of `frf`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from identification_cases import noisy_responses, poses_of, small_plan, without_coulomb
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.identification.responses import frequency_response as fr

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
    assert fr.check_repeats(Y, "data") == ()
    some = Y.copy()
    some[1, 0, 2, :, :, 1] += 0.05
    (text,) = fr.check_repeats(some, "data")
    assert text.startswith(
        "pose 2, realization 1, experiment 2: period 3 differs from the others by 0.049 of the "
        "signal"
    )
    assert fr.check_repeats(some[:, :, 1:3], "data") == ()
    some[1, 0, 2, :, :, 1] += 0.1
    with pytest.raises(
        ArgumentError,
        match=r"data: pose 2, .* by 0\.1[45] of the signal .*; leave out more transient peri",
    ):
        fr.check_repeats(some, "data")
    (text,) = fr.check_repeats(complex_(rng, 1, 1, 5, 40, 2, 3), "data")
    assert text.startswith("the periods differ from each other by 0.96 of") and text.endswith(
        "than was excited"
    )
    exact = np.ones((1, 1, 3, 5, 1, 1), complex)
    assert fr.check_repeats(exact, "data") == ()
    exact[0, 0, 1] += 5e-3
    assert fr.check_repeats(exact, "data") == ()  # below six thousandths
    exact[0, 0, 1] += 2e-3
    assert len(fr.check_repeats(exact, "data")) == 1


def test_files_of_responses_are_checked() -> None:
    """Each array that does not fit, and numbers at their limits."""
    data = noisy_responses()
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
    motion = {"torques": torques, "numbers": numbers, "gains": np.full((3, n), fr.LARGEST)}
    flexgen.Frf.from_data(arrays | motion, meta)
    moved: list[tuple[dict[str, Any], str]] = [
        ({"numbers": numbers - 1}, "those of lines rising from 1"),
        ({"numbers": np.array([1, 2, 2, 7])}, "those of lines rising from 1"),
        ({"gains": np.full((3, n), 1.01 * fr.LARGEST)}, "numbers up to"),
        ({"gains": np.ones((2, n))}, "arrays of different sizes"),
        ({"torques": torques[:1]}, "torques: expected those of each pose"),
        ({"torques": torques[..., :1]}, "torques: expected those of each pose"),
    ]
    for changed, text in moved:
        with pytest.raises(ValueError, match=text):
            flexgen.Frf.from_data(arrays | motion | changed, meta)
    with pytest.raises(ValueError, match="expected all of them or none"):
        flexgen.Frf.from_data(arrays | {"numbers": numbers}, meta)
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
    experiment = replace(measured, offsets=None, beside=None)
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
