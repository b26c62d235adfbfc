"""A move in the closed loop: exact for the model, true to equilibria, disturbances and margins for
other robots.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from measured_numbers import check_numbers
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.model_library import library_with
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.closed_loop import ClosedLoop
from flexgen.feedback.loop.control import case_controller, run_case
from flexgen.feedback.loop.controllers import Cascade
from flexgen.feedback.loop.hardware import DriveHardware
from flexgen.feedback.loop.interface import PythonController
from flexgen.feedback.loop.margins import LoopAtPose, as_linear
from flexgen.feedback.loop.named_controllers import controller_of
from flexgen.feedback.loop.sampled_model import PoseModels

pytestmark = needs_compiler

MODEL = "planar5_nmp"


@pytest.fixture(scope="module")
def case():
    return control_case(MODEL, sample_time=5e-4)


def law_of(case, name="ppi"):
    return controller_of(name, case.model, 5e-4, 0.0, case.reference.points(np.array([0])))[0]


def test_feedforward_and_feedback_track_the_model_exactly(case):
    """0.05 um; the verified error of the feedforward alone is 6e-5 um."""
    found = run_case(case, law_of(case), "ppi")
    assert found.status == "done" and found.tool_error_max_m < 5e-8
    assert np.abs(found.nominal.tau_m - case.reference.held).max() < 1e-4  # the feedback is silent


class ExactSpeed:
    """Planted bug: the exact speed as reference, while the measured one is a difference of
    samples.
    """

    def __init__(self, law: Cascade) -> None:
        self.law = law
        self.last = None

    def reset(self) -> None:
        self.last = None

    def step(self, k, y, ref):
        last = y.q_m if self.last is None else self.last
        self.last = y.q_m.copy()
        w = ref.v_m + self.law.position_gain * (ref.q_m - y.q_m) - (y.q_m - last) / 5e-4
        return ref.tau_m + self.law.speed_gain * w


class TorqueAtTheSample(ExactSpeed):
    """Planted bug: the feedforward of another instant."""

    def step(self, k, y, ref):
        late = self.law.speed_gain * 0 if self.last is None else self.last
        self.last = ref.tau_m.copy()
        return late if k else ref.tau_m


@pytest.mark.parametrize("planted", [ExactSpeed, TorqueAtTheSample])
def test_a_planted_error_of_the_reference_is_seen(case, planted):
    found = run_case(case, PythonController(planted(law_of(case))), "planted")
    assert found.tool_error_max_m > 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("delay", [2e-4, 5e-4, 1.3e-3])
def test_delays_are_in_the_feedforward(delay):
    found = flexgen.control(MODEL, delay=delay, progress=False)
    assert found.tool_error_max_m < 5e-8
    assert found.delay_s == pytest.approx(delay)


def test_other_robots_rest_where_their_springs_hold_them(case):
    """The static error before the motion is the sag of softer springs: linear springs deflect by
    1/0.8 as much.
    """
    found = flexgen.control(
        MODEL, plants={"soft": {"stiffness": 0.8}}, solution=case.solution, progress=False
    )
    soft = found["soft"]
    q_m = found.reference.motion["q_m"][0]
    i_g = list(found.model.i_g)
    sag = found.reference.motion["q_a"][0][i_g] - np.linalg.solve(found.model.eta, q_m)
    deeper = soft.q_a[0][i_g] - np.linalg.solve(found.model.eta, q_m)
    assert np.allclose(deeper, sag / 0.8, rtol=0.05)  # gravity turns a little with the sag
    assert np.ptp(soft.q_a[:1000], axis=0).max() < 1e-6  # at rest until the motion begins
    figures = found.figures(soft)
    assert figures["dynamic_error_max_m"] > 0 and figures["static_error_start_m"] > 1e-5


@pytest.mark.parametrize(
    "given",
    [
        {},
        pytest.param({"payload": {"mass": 0.1}}, marks=pytest.mark.slow),
        pytest.param({"payload": {"mass": 0.1, "com": [0.45, 0.0, 0.0]}}, marks=pytest.mark.slow),
    ],
)
def test_load_at_the_tool_sags_as_statics_say_with_and_without_payload_in_the_file(given):
    """Half a kilogram more, motors held: the tool sags by the compliance of the linear model, to
    first order.
    """
    found = flexgen.control(
        flexgen.read(MODEL, overrides=given), plants={"loaded": {"payload": 0.5}}, progress=False
    )
    model = found.model
    assert "loaded: " in str(
        found
    ) and "load +0.5 kg at the tool, [0.45, 0, 0] m in the frame of" in str(found)
    pose = PoseModels(model).at(found.reference.points(np.array([0])))
    n = model.dof
    motors = pose.C[:, :n]
    none = np.zeros((model.n_m, model.n_m))
    load = -pose.push[n:] @ (0.5 * np.array(model.gravity))
    moved = np.linalg.solve(
        np.block([[pose.A[n:, :n], pose.B[n:]], [motors, none]]),
        np.concatenate([load, np.zeros(model.n_m)]),
    )
    assert np.allclose(found["loaded"].error[0], pose.W[:, :n] @ moved[:n], rtol=0.005)
    if not given:
        check_numbers(
            "control",
            found=found.to_dict(),
            errors=[run.error for run in found.runs],
            margins=found.margins(),
        )


def test_disturbances_push_and_an_integral_part_takes_constant_ones_away(case):
    step = flexgen.Disturbance("step", "m1", 1.0, start_s=0.0)
    pulse = flexgen.Disturbance("pulse", "tool.x", 100.0, start_s=0.1, length_s=0.02)
    found = flexgen.control(
        MODEL,
        plants={"same": {}},
        disturbances={"same": [step, pulse]},
        solution=case.solution,
        progress=False,
        controller=flexgen.PPI(5.0, 30.0, 5.0),
    )
    assert found.tool_error_max_m < 5e-8  # the model itself has none
    check_numbers(
        "disturbed", found=found.to_dict(), error=found["same"].error, tau=found["same"].tau_m
    )
    error = found.distance(found["same"])
    at = np.searchsorted(found.reference.time, 0.12)
    assert error[at] > 1e-4 and error[-1] < 0.1 * error.max()
    assert found["same"].tau_m[-1, 0] == pytest.approx(found.nominal.tau_m[-1, 0] - 1.0, abs=0.1)


@pytest.mark.slow
def test_margins_are_where_the_simulated_loop_becomes_unstable(case):
    """The linear loop at rest with 0.9 and 1.1 of the gain margin, and of the delay margin,
    simulated.
    """
    model = flexgen.read("four_mass@high")
    rest = control_case(model, "step")
    motion = rest.reference.points(np.array([0]))
    law, _ = controller_of("ppi_notch", model, 5e-4, 0.0, motion)
    pose = PoseModels(model).at(motion)
    linear = as_linear(law, 5e-4, 1)
    assert linear is not None
    loop = LoopAtPose(pose, linear, 5e-4, 0.0)
    margins = loop.margins()
    assert margins.stable and 1.5 < margins.gain < 50 and 1e-3 < margins.delay_s < 0.016
    assert abs(loop.largest_eigenvalue(margins.gain) - 1) < 1e-3
    assert abs(loop.largest_eigenvalue(1.0, margins.delay_s) - 1) < 1e-3

    def swing(gain: float, delay: float) -> float:
        samples = round(delay / 5e-4)
        run = ClosedLoop(
            model,
            library_with(model, ("forward_dynamics",)),
            DriveHardware(5e-4),
            linear,
            np.zeros((1, 3)),
            np.full((1, 1), 1e-3),
            400.0,
            delay_samples=samples,
            gain=np.array([gain]),
        )
        run.hold(np.zeros((1, 1)))
        q = run.run(np.zeros((1, 1, 2)), 8000, check=False).q_m[:, 0, 0]
        return (
            float("inf")
            if run.failures[0]
            else float(np.abs(q[-2000:]).max() / np.abs(q[:2000]).max())
        )

    assert swing(0.9 * margins.gain, 0.0) < 1 < swing(1.1 * margins.gain, 0.0)
    below = np.floor(margins.delay_s / 5e-4) * 5e-4
    above = np.ceil(margins.delay_s / 5e-4) * 5e-4
    assert swing(1.0, below) < 1 < swing(1.0, above + 5e-4)


def test_a_linear_controller_ignores_the_exact_state_that_is_measured_too(case):
    """As it is without the exact state; with it the channels of the state, the last ones, have the
    weight zero.
    """
    given = as_linear(law_of(case), 5e-4, case.model.n_m)
    n_y = case.model.n_m
    states = 2 * (case.model.n_a + case.model.n_m)
    for exact in (False, True):
        found, _ = case_controller(replace(case, exact_state=exact), given)
        for name, one, other in zip("ABCD", given.matrices, found.matrices, strict=True):
            wider = states if exact and name in "BD" else 0
            assert other.shape == (*one.shape[:2], one.shape[2] + wider)
            assert (
                np.array_equal(other[..., : one.shape[2]], one)
                and not other[..., one.shape[2] :].any()
            )
        assert found.matrices[1].shape[2] == n_y + (states if exact else 0)
    cascade = law_of(case)
    assert case_controller(replace(case, exact_state=True), cascade)[0] is cascade


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"sample_time": 0.0}, "sample_time: given 0.0"),
        ({"delay": 1.0}, "delay: given 1.0, expected 0 to 64 samples"),
        ({"plants": {"x": {"stiffness": -1.0}}}, "plant x, stiffness: given the factor -1.0"),
        ({"plants": {"x": {"payload": -9.0}}}, "plant x, payload: given -9.0 kg"),
        ({"plants": {"x": {"wrong": 1.0}}}, "given 'wrong', expected some of"),
        ({"plants": {"x": {"stiffness": "1"}}}, "given '1', expected a number"),
        (
            {"controller": "pid2"},
            "given 'pid2', expected one of ppi, ppi_notch, none, lqg, .*, a file",
        ),
        ({"controller": "no.toml"}, "no.toml., which cannot be read .*expected a readable file"),
        ({"controller": "no.py"}, "expected a file no.py that is there"),
        ({"controller": object()}, "object without reset"),
        ({"disturbances": {"x": []}}, "disturbances: given plant 'x', expected one of nominal"),
        (
            {"disturbances": [flexgen.Disturbance("step", "m9", 1.0)]},
            "given the place 'm9', expected one of m1, m2",
        ),
    ],
)
def test_wrong_arguments_are_refused(case, arguments, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.control(MODEL, solution=case.solution, progress=False, **arguments)


def test_an_unstable_loop_is_reported_without_an_exception(case):
    wild = flexgen.PPI(50.0, 5000.0, 0.0).cascade(
        case.model, 1e-9, case.reference.points(np.array([0]))
    )
    found = run_case(case, wild, "wild")
    assert found.status.startswith("unstable: nominal:") and np.isnan(found.tool_error_max_m)
    assert json.loads(json.dumps(found.to_dict()))["plants"][0]["error_max_m"] is None
    assert "unstable" in str(found)


@pytest.mark.slow
def test_a_run_has_a_trajectory_and_a_page(case, tmp_path):
    found = flexgen.control(
        MODEL, plants={"soft": {"stiffness": 0.8}}, solution=case.solution, progress=False
    )
    saved = found.trajectory("soft").save(tmp_path / "run.csv")
    assert saved.exists() and "tau_ff" in found.trajectory()
    page = found.report(tmp_path / "page").read_text()
    assert (
        "Margins of the linear loop" in page
        and "soft" in page
        and (tmp_path / "page" / "loops.png").exists()
    )
    with pytest.raises(ArgumentError, match="given 'hard', expected one of nominal, soft"):
        found.trajectory("hard")
