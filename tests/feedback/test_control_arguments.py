"""Arguments of control, learning, benchmarks and filters: texts, lists, NaN and booleans for
numbers are refused.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import FlexgenError

pytestmark = needs_compiler
BAD = ("a", [1, 2], float("nan"), -1.0, True, float("inf"))
ARGUMENTS = {
    "control": (
        "sample_time delay encoder_noise encoder_resolution seed plants disturbances controller"
    ),
    "learn": (
        "iterations gain frequency_hz sample_time delay encoder_noise seed plant measured_by "
        "controller"
    ),
    "fastest": "torque_rate vibration coefficients limits",
    "score": "seed steps controller",
    "tune": "evaluations starts workers seed controller",
    "ExtendedKalmanFilter": "outputs sample_time noise torque_noise disturbance_rate tool_force",
    "ConstantGainObserver": (
        "outputs sample_time noise torque_noise disturbance_rate tool_force parts"
    ),
    "PPI": "position_hz speed_hz integral_hz filters",
    "LQ": "rho",
    "LQG": "rho encoder_noise torque_noise disturbance_rate",
    "LoopShaping": "crossover_hz integral_hz low_pass_hz factor",
    "TomeiPD": "frequency_hz damping k_p k_d",
    "ComputedTorque": "frequency_hz",
    "FeedbackLinearisation": "frequency_hz form",
    "Impedance": "tool_stiffness joint_stiffness damping damping_ratio frequency_hz torque_gain",
    "JointTorqueFeedback": "frequency_hz k_p k_d k_t k_s",
}


@cache
def solution() -> flexgen.Solution:
    return flexgen.solve("planar5_nmp")


def call(verb: str, name: str, value: object) -> None:
    function = getattr(flexgen, verb)
    if verb in ("control", "learn"):
        function("planar5_nmp", solution=solution(), **{name: value})
    elif verb == "ConstantGainObserver":
        function(solution(), **{name: value})
    elif verb in ("fastest", "ExtendedKalmanFilter"):
        function("planar5_nmp", **{name: value})
    elif verb in ("score", "tune"):
        function("four_mass", **{name: value})
    else:  # refused when the controller is made or used
        flexgen.control("planar5_nmp", solution=solution(), controller=function(**{name: value}))


@pytest.mark.parametrize(
    ("verb", "name"), [(verb, name) for verb, names in ARGUMENTS.items() for name in names.split()]
)
def test_wrong_values_are_refused_with_the_name_of_the_argument(verb, name):
    for value in BAD:
        with pytest.raises(FlexgenError, match=r"given .*expected") as caught:
            call(verb, name, value)
        assert name.partition("_")[0].rstrip("s") in str(caught.value), (value, str(caught.value))


@pytest.mark.slow
def test_numbers_of_numpy_are_numbers():
    """Scalars and arrays without dimensions; generators and dict views of disturbances; a seed of
    numpy.
    """
    push = {"a": flexgen.Disturbance("pulse", "m1", 1.0, 0.1, 0.05)}
    run = flexgen.control(
        "planar5_nmp",
        solution=solution(),
        sample_time=np.array(1e-3),
        encoder_noise=np.float32(1e-5),
        seed=np.int64(3),
        disturbances=push.values(),
        progress=False,
    )
    same = flexgen.control(
        "planar5_nmp",
        solution=solution(),
        sample_time=1e-3,
        encoder_noise=float(np.float32(1e-5)),
        seed=3,
        disturbances=(x for x in push.values()),
        progress=False,
    )
    assert np.array_equal(run.runs[0].q_a, same.runs[0].q_a)
    flexgen.score("four_mass@1", seed=np.int64(2))
    flexgen.ExtendedKalmanFilter("planar5_nmp", np.array(["motors"]), noise=np.float32(1e-4))
