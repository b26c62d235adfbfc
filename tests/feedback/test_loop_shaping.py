"""H-infinity loop shaping: closed forms of the margin, the norm of the closed loop, loops in
simulation.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from law_cases import at_rest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.laws.loop_shaping import (
    LoopShaping,
    coprime_controller,
    linear_plant,
    pade,
    series,
)
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.control import case_controller, run_case
from flexgen.feedback.loop.controller_files import file_controller
from flexgen.feedback.loop.gains import motor_inertias
from flexgen.feedback.loop.margins import LoopAtPose
from flexgen.feedback.loop.plants import LocalDynamics
from flexgen.feedback.loop.sampled_model import PoseModels


def system(*matrices):
    return tuple(np.atleast_2d(np.array(x, dtype=float)) for x in matrices)


INTEGRATOR = system(0, 1, 1, 0)
TWO_INTEGRATORS = system([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], 0)


def response(s, w):
    A, B, C, D = s
    return C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) + D


def largest_norm(plant, controller):
    """Largest singular value over frequencies of [I; K](I + PK)^-1 [I, P], the norm that the
    margin is about.
    """
    largest = 0.0
    for w in np.logspace(-4, 5, 4000):
        P = response(plant, w)
        K = response(controller, w)
        S = np.linalg.inv(np.eye(len(P)) + P @ K)
        largest = max(
            largest, np.linalg.norm(np.vstack([S, K @ S]) @ np.hstack([np.eye(len(P)), P]), 2)
        )
    return largest


@pytest.mark.parametrize(
    ("plant", "margin"), [(INTEGRATOR, np.sqrt(0.5)), (TWO_INTEGRATORS, np.sin(np.pi / 8))]
)
def test_the_largest_margin_of_integrators(plant, margin):
    """1/s: 1/sqrt 2; 1/s^2: sin(pi/8); both follow from the two Riccati equations by hand."""
    _, gamma = coprime_controller(plant, 1.0 + 1e-9)
    assert 1 / gamma == pytest.approx(margin, rel=1e-6)


@pytest.mark.parametrize("hz", [0.5, 3.0, 40.0, 300.0])
def test_the_weight_of_the_loop_is_that_of_its_formula(hz):
    """Inertia times w_c^2, an integral part and a low pass of second order."""
    law = LoopShaping(20.0, integral_hz=2.0, low_pass_hz=100.0)
    s = 2j * np.pi * hz
    w_c, w_i, w_l = 2 * np.pi * np.array([20.0, 2.0, 100.0])
    expected = w_c**2 * (1 + w_i / s) * w_l**2 / (s**2 + np.sqrt(2) * w_l * s + w_l**2)
    found = response(law._shape(np.array([0.3, 0.7])), 2 * np.pi * hz)
    assert np.allclose(found, expected * np.diag([0.3, 0.7]), rtol=1e-9, atol=0)


def test_systems_in_series_multiply_their_responses():
    """Of random matrices with one, two and three channels."""
    rng = np.random.default_rng(1)
    first, second = (
        tuple(rng.normal(size=shape) for shape in shapes)
        for shapes in (((2, 2), (2, 3), (1, 2), (1, 3)), ((3, 3), (3, 1), (2, 3), (2, 1)))
    )
    found = response(series(first, second), 3.0)
    assert np.allclose(found, response(second, 3.0) @ response(first, 3.0))


@pytest.mark.parametrize("factor", [1.05, 1.3])
def test_the_closed_loop_has_the_norm_that_is_promised(factor):
    """At most gamma, at least gamma_min; with the sign of the controller changed the loop is
    unstable.
    """
    for plant in (TWO_INTEGRATORS, series(pade(0.1, 1), TWO_INTEGRATORS)):
        controller, gamma = coprime_controller(plant, factor)
        norm = largest_norm(plant, controller)
        assert gamma / factor * (1 - 1e-4) <= norm <= gamma * (1 + 1e-9)
        closed = series(controller, plant)
        A, B, C, _ = closed
        assert (
            np.linalg.eigvals(A - B @ C).real.max() < 0 < np.linalg.eigvals(A + B @ C).real.max()
        )


def test_the_delay_is_approximated():
    """Of order two: the phase is right to (w T)^5/720."""
    for w in (0.1, 1.0):
        found = response(pade(1.0, 1), w)[0, 0]
        assert abs(found) == pytest.approx(1.0) and abs(found - np.exp(-1j * w)) < w**5 / 700


def test_the_plant_is_the_linearized_robot():
    """Against central differences of the forward dynamics, whose error is their step squared."""
    forward = derive("planar5_nmp").function("forward_dynamics")
    model = flexgen.read("planar5_nmp")
    start = np.array([0.3, -1.1, 0.0])
    q_m = model.eta @ start[:2]
    q_a, tau = LocalDynamics(derive("planar5_nmp")).rest(q_m, np.zeros(0), start)

    def accelerations(y, v, tau):
        a_a, a_m = forward(y[:3], v[:3], y[3:], v[3:], tau)
        return np.concatenate([a_a.full().ravel(), a_m.full().ravel()])

    y = np.concatenate([q_a, q_m])
    step = 1e-5
    assert np.abs(accelerations(y, np.zeros(5), tau)).max() < 1e-9
    parts = []
    for k, size in enumerate((5, 5, 2)):
        point = [y, np.zeros(5), tau]
        columns = []
        for j in range(size):
            ahead, behind = (
                [x + s * step * (i == k) * (np.arange(len(x)) == j) for i, x in enumerate(point)]
                for s in (1, -1)
            )
            columns.append((accelerations(*ahead) - accelerations(*behind)) / (2 * step))
        parts.append(np.array(columns).T)
    motion = [q_a[None], *np.zeros((2, 1, 3)), q_m[None], *np.zeros((2, 1, 2)), tau[None]]
    A, B, C, D = linear_plant(model, motion)
    assert np.allclose(A[5:], np.hstack(parts[:2]), atol=1e-8 * np.abs(A).max())
    assert np.allclose(B[5:], parts[2], atol=1e-8 * np.abs(B).max())
    assert (
        np.array_equal(C, np.eye(10)[3:5])
        and not D.any()
        and np.array_equal(A[:5], np.eye(10)[5:])
    )


@pytest.mark.slow
@needs_compiler
def test_a_robot_follows_its_path(tmp_path):
    run = flexgen.control(
        "planar5_nmp",
        controller=flexgen.LoopShaping(2.0),
        plants={"soft": {"stiffness": 0.8}},
        progress=False,
    )
    assert run.status == "done" and all(margin.stable for margin in run.margins().values())
    assert run.figures(run.runs[0])["error_max_m"] < 1e-6
    (tmp_path / "mine.toml").write_text('type = "loop_shaping"\ncrossover_hz = 2.0\n')
    assert file_controller(str(tmp_path / "mine.toml")) == flexgen.LoopShaping(2.0)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"crossover_hz": 0.0}, "crossover_hz: given 0.0"),
        ({"factor": 1.0}, "factor: given 1.0, expected a number > 1"),
        ({"low_pass_hz": float("nan")}, "low_pass_hz: given nan"),
        ({"crossover_hz": "2"}, "crossover_hz: given '2'"),
        ({"factor": None}, "factor: given None"),
    ],
)
def test_wrong_numbers_are_refused(given, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.LoopShaping(**given)


def test_a_shaped_loop_is_the_continuous_one_by_the_bilinear_rule() -> None:
    """Frequency responses at ``s = 2/T (z - 1)/(z + 1)``, T/2 of the hold in the delay; the gains
    are those of the first pose, or of a slower model.
    """
    model = flexgen.read("elbow")
    motion = at_rest(model)
    law = LoopShaping(2.0, integral_hz=0.2)
    h = 1e-3
    made, margin = law.design(model, h, 2e-3, motion)
    A, B, C, D = (x[0] for x in made.matrices)
    shape = law._shape(motor_inertias(model, motion)[0])
    delay = pade(2e-3 + h / 2, model.n_m)
    central, gamma = coprime_controller(
        series(series(shape, delay), linear_plant(model, motion)), law.factor
    )
    assert margin == pytest.approx(1 / gamma) and 0.2 < margin < 1.0
    whole = series(central, shape)
    for hz in (0.3, 2.0, 20.0):
        z = np.exp(2j * np.pi * hz * h)
        sampled = C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D
        exact = response(whole, (2 / h * (z - 1) / (z + 1)).imag)
        assert np.allclose(sampled, exact, rtol=1e-6, atol=1e-9 * np.abs(exact).max())
    path = [np.vstack([x, x + 1.0]) for x in motion]
    for own in (law, replace(law, model=model)):
        for one, other in zip(
            own.linear(model, h, 2e-3, path).matrices, made.matrices, strict=True
        ):
            assert np.allclose(one, other)
    loop = LoopAtPose(PoseModels(model).at(motion), made, h, 2e-3)
    assert loop.largest_eigenvalue() < 1.0


def test_the_error_of_an_unstable_loop_names_a_stable_frequency() -> None:
    model = flexgen.read("elbow")
    motion = at_rest(model)
    text = (
        "crossover_hz: given 12 Hz, with which the sampled loop is unstable at 5 ms and a delay "
        r"of 20 ms .*a lower one, such as (.*) Hz, or a shorter sample time"
    )
    with pytest.raises(ArgumentError, match=text) as caught:
        LoopShaping(12.0).linear(model, 5e-3, 2e-2, motion)
    found = re.search(text, str(caught.value))
    assert found is not None
    LoopShaping(float(found[1])).linear(model, 5e-3, 2e-2, motion)
    assert float(found[1]) < 12.0
    with pytest.raises(ArgumentError, match="a shorter sample time or delay, or another low_pass"):
        LoopShaping(400.0).linear(model, 0.1, 1.0, motion)


def test_a_plant_that_no_controller_stabilizes_is_an_error() -> None:
    plant = system([[1.0]], [[0.0]], [[0.0]], [[0.0]])
    with pytest.raises(SolverError, match="the Riccati equations have no solution at the pose"):
        coprime_controller(plant, 1.1)


@needs_compiler
@pytest.mark.slow
def test_an_unstable_sampled_loop_is_refused():
    """The refused controllers make the simulated robot run away; the frequency of the message does
    not.
    """
    solution = flexgen.solve("planar5_nmp", progress=False)
    for crossover, sample_s in ((60.0, 4e-3), (150.0, 1e-3)):
        case = control_case(
            "planar5_nmp", sample_time=sample_s, solution=solution, encoder_noise=1e-6
        )
        law = flexgen.LoopShaping(crossover, low_pass_hz=5 * crossover)
        with pytest.raises(
            ArgumentError, match=f"crossover_hz: given {crossover:g} Hz, .*unstable"
        ) as error:
            case_controller(case, law)
        refused, _ = law.design(case.model, sample_s, 0.0, case.reference.points(np.array([0])))
        assert run_case(case, refused, "refused").nominal.failure == "not finite"
        lower = replace(law, crossover_hz=float(str(error.value).split("such as ")[1].split()[0]))
        assert lower.crossover_hz > 0.3 * crossover
        for good in (lower, flexgen.LoopShaping(2.0)):
            found = run_case(case, *case_controller(case, good))
            assert found.tool_error_max_m < 1e-5
            # the proposed frequency is that of the pose of the design, the first one
            assert found.status == "done" or (
                good is lower and "loop at begin" not in found.status
            )


@needs_compiler
@pytest.mark.slow
@pytest.mark.parametrize("controller", ["lqg", flexgen.LoopShaping(2.0)])
def test_linear_controllers_ignore_the_exact_state(controller):
    """With it among the channels the torques have the same bits, and the margins are the same."""
    solution = flexgen.solve("elbow", progress=False)
    runs = [
        flexgen.control(
            "elbow", controller=controller, exact_state=exact, solution=solution, progress=False
        )
        for exact in (True, False)
    ]
    assert runs[0].status == "done" and np.array_equal(
        runs[0].nominal.tau_m, runs[1].nominal.tau_m
    )
    sizes = [[m.largest_eigenvalue for m in r.margins().values()] for r in runs]
    assert sizes[0] and np.allclose(*sizes, rtol=1e-12, atol=0)


@pytest.mark.slow
def test_sensors_of_the_model_are_not_fed_back():
    """A model with and without an accelerometer: equal torques."""
    sensor = {
        "name": "acc",
        "type": "accelerometer",
        "element": "tool",
        "unit": "m/s^2",
        "noise": 0.05,
    }
    runs = [
        flexgen.control(
            flexgen.read("four_mass", overrides=changes),
            controller=flexgen.LoopShaping(),
            sample_time=1e-3,
            plants={"soft": {"stiffness": 0.9}},
            progress=False,
        )["soft"]
        for changes in ({}, {"sensor": [sensor]})
    ]
    assert np.abs(runs[0].tau_m - runs[1].tau_m).max() < 1e-9 * np.abs(runs[0].tau_m).max()
