"""Laws that evaluate the model: bounds of stability found by the loop, exact tracking, limits,
bits, refusals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from law_cases import arm, case_of, coupled, one_joint, solution_of
from measured_numbers import check_numbers
from scipy.linalg import expm
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws.bound import BoundLaw
from flexgen.feedback.laws.chain import chain_gains, largest_eigenvalue, largest_frequency
from flexgen.feedback.laws.study import ARM
from flexgen.feedback.loop.case import control_case
from flexgen.feedback.loop.control import case_controller, run_case
from flexgen.feedback.loop.interface import PythonController
from flexgen.feedback.loop.timing import Timing
from flexgen.model.elements import Gear

pytestmark = needs_compiler
H = 1e-3


def run(case, law):
    return run_case(case, *case_controller(case, law))


# --- four integrators ----------------------------------------------------------------------------


def polynomial_bound(delay: int) -> float:
    """Largest stable w of (s + w)^4 on four integrators with unit sample time: roots of the
    z-polynomial.

    The integrators with a hold are B(z) / (z - 1)^n over n! with the Euler polynomials B: a route
    without matrices.
    """
    euler = {1: [1], 2: [1, 1], 3: [1, 4, 1], 4: [1, 11, 11, 1]}
    factorial = {1: 1.0, 2: 2.0, 3: 6.0, 4: 24.0}
    gains = {4: 1.0, 3: 4.0, 2: 6.0, 1: 4.0}  # of w^n times the n-fold integral

    def radius(w: float) -> float:
        whole = np.poly([1.0] * 4)
        closed = np.polymul(whole, [1.0] + [0.0] * delay)
        for n, gain in gains.items():
            part = np.polymul(euler[n], np.poly([1.0] * (4 - n))) * gain * w**n / factorial[n]
            closed = np.polyadd(closed, part)
        return float(np.abs(np.roots(closed)).max())

    low = 0.1
    high = 0.7
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1 else (low, middle)
    return low


@pytest.mark.parametrize(("delay", "bound"), [(0, 0.5113), (1, 0.1983)])
def test_bound_of_the_chain(delay, bound):
    """The bounds are those of 1 + L(z) = 0; just above them, at 0.5113 and 0.1983, the largest |z|
    is 1.001.
    """
    found = 2 * np.pi * largest_frequency(4, "continuous", Timing(1.0, float(delay)))
    assert found == pytest.approx(polynomial_bound(delay), rel=1e-6)
    assert found == pytest.approx(bound, rel=3e-3) and found < bound
    gains = chain_gains(bound / (2 * np.pi), 4, "continuous", 1.0)
    assert largest_eigenvalue(gains, Timing(1.0, float(delay))) == pytest.approx(1.001, abs=2e-4)


def test_discrete_gains_place_the_poles_of_the_sampled_chain():
    for n in (2, 4):
        gains = chain_gains(16.0, n, "discrete", H)
        w = 2 * np.pi * 16.0
        whole = np.zeros((n + 1, n + 1))
        whole[:-1, 1:] = np.eye(n)
        held = expm(whole * H)
        closed = held[:n, :n] - np.outer(held[:n, n], gains)
        wanted = np.poly([np.exp(-w * H)] * n)
        # the coefficients: the roots are multiple
        assert np.allclose(np.poly(closed), wanted, rtol=0, atol=1e-12)


def growth(case, law) -> float:
    """Growth of the error between two windows after a pulse on the motor, before the motion, in
    the loop in C.
    """
    found = run(case, law)
    if found.nominal.failure:
        return np.inf
    error = np.abs(found.nominal.error[:, 0])
    time = case.reference.time
    early, late = (error[(time > begin) & (time < begin + 0.4)].max() for begin in (-1.6, -0.5))
    return late / early


@pytest.mark.parametrize("delay", [0, 1])
def test_the_loop_finds_the_bound_of_four_integrators(tmp_path, delay):
    """A joint on a soft spring, in C at 1 ms: (1 rad/s / w)^2 < 3e-5 from four integrators;
    bisected to 5e-5.
    """
    model = one_joint(tmp_path)
    bound = polynomial_bound(delay)
    pulse = flexgen.Disturbance("pulse", "m1", 1e-3, -1.9, 0.01)
    case = case_of(model, H, delay * H, disturbances=[pulse])
    low = 0.97 * bound
    high = 1.03 * bound
    while high - low > 5e-5:
        w = 0.5 * (low + high)
        law = flexgen.FeedbackLinearisation(w / (2 * np.pi * H), allow_unstable=True)
        low, high = (w, high) if growth(case, law) < 1 else (low, w)
    assert 0.5 * (low + high) == pytest.approx(bound, abs=1e-4)
    with pytest.raises(ArgumentError, match="a chain of 4 integrators is unstable"):
        case_controller(case, flexgen.FeedbackLinearisation(1.001 * bound / (2 * np.pi * H)))


# --- tracking ------------------------------------------------------------------------------------

FL = flexgen.FeedbackLinearisation


@pytest.mark.slow
def test_the_error_of_the_nominal_arm_vanishes_with_the_sample_time():
    """Without damping of the gears: first order in the sample time, second with the predicted
    state; no noise.
    """
    model = arm(damped=False)
    plain, predicted = (
        [run(case_of(model, h), FL(16.0, predict=p)).tool_error_max_m for h in (1e-3, 2.5e-4)]
        for p in (False, True)
    )
    assert plain[1] < 0.3 * plain[0] < 3e-5
    assert predicted[1] < 0.07 * predicted[0] and predicted[1] < 1e-6


@pytest.mark.slow
def test_prediction_removes_the_effect_of_the_delay():
    model = arm(damped=False)
    late, none = (
        run(case_of(model, H, d), FL(16.0, predict=True)).tool_error_max_m for d in (1.3e-3, 0.0)
    )
    assert late == pytest.approx(none, rel=2e-2)
    assert run(case_of(model, H, 1.3e-3), FL(16.0)).tool_error_max_m > 5 * none


class WrongAcceleration(BoundLaw):
    """Planted bug: three percent of the acceleration is not in the torque."""

    def _call(self, key, *arguments):
        if key == "torque":
            q, v, a, j, *rest = arguments
            arguments = (q, v, 0.97 * a, j, *rest)
        return super()._call(key, *arguments)


class LateReference(BoundLaw):
    """Planted bug: the reference of another sample."""

    def step(self, k, y, ref):
        return super().step(max(k - 1, 0), y, ref) if k else super().step(k, y, ref)


class StaleTorque(BoundLaw):
    """Planted bug: the prediction uses a torque that is a sample too old."""

    def _integrate(self, x, tau, h, steps):
        old = self._now.get("old", tau)
        self._now["old"] = tau
        return super()._integrate(x, old, h, steps)


@pytest.mark.slow
@pytest.mark.parametrize("planted", [WrongAcceleration, LateReference, StaleTorque])
def test_planted_bugs_are_seen(planted):
    """Each more than doubles the error of the sample time."""
    model = arm(damped=False)
    case = case_of(model, H, H)
    law, _ = case_controller(case, FL(16.0, predict=True))
    wrong = planted(
        **{name: getattr(law, name) for name in law.__dataclass_fields__ if name != "_now"}
    )
    right = run_case(case, law, "right").tool_error_max_m
    assert right < 1.3e-5  # the second order of the sample time
    assert run_case(case, PythonController(wrong), "wrong").tool_error_max_m > 2 * right


LAWS = (
    FL(16.0), FL(16.0, "discrete", predict=True), flexgen.ComputedTorque(2.0), flexgen.TomeiPD(),
    flexgen.JointTorqueFeedback(), flexgen.LQ(),
)  # fmt: skip


def test_feedback_linearisation_in_python_and_c_gives_the_same_bits():
    case = case_of(arm(), 2e-3, exact_state=False, encoder_noise=1e-5)
    made, name = case_controller(case, FL(14.0))
    runs = [run_case(case, x, name).nominal for x in (made, PythonController(made))]
    assert np.array_equal(runs[0].tau_m, runs[1].tau_m) and np.array_equal(
        runs[0].q_a, runs[1].q_a
    )
    check_numbers("linearized", tau=runs[0].tau_m, table=made.table, gains=made.gains)
    other = replace(made, gains=np.nextafter(made.gains, np.inf))  # the comparison is one of bits
    assert not np.array_equal(runs[0].tau_m, run_case(case, other, name).nominal.tau_m)


@pytest.mark.slow
@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.title)
def test_python_and_c_give_the_same_bits(law, exact):
    case = case_of(
        arm(),
        H,
        1.3e-3,
        exact_state=exact,
        encoder_noise=1e-5,
        plants={"soft": {"stiffness": 0.9}},
    )
    made, name = case_controller(case, law)
    runs = [run_case(case, x, name) for x in (made, PythonController(made))]
    assert runs[0].status == runs[1].status == "done"
    for a, b in zip(runs[0].runs, runs[1].runs, strict=True):
        assert np.array_equal(a.tau_m, b.tau_m) and np.array_equal(a.q_a, b.q_a)


@pytest.mark.slow
def test_motors_that_drive_several_joints():
    """A full matrix of gear ratios: the error vanishes with the sample time, and both twins give
    the same bits.
    """
    model = coupled()
    errors = [
        run(case_of(model, h), FL(16.0, predict=True)).tool_error_max_m for h in (1e-3, 2.5e-4)
    ]
    assert errors[1] < 0.07 * errors[0] and errors[1] < 1e-6
    case = case_of(model, 2e-3, exact_state=False, encoder_noise=1e-5)
    gains = {
        "k_p": (6.0,) * 3,
        "k_d": (0.3,) * 3,
        "k_t": (0.1, 0.2, 0.3),
        "k_s": (0.001, 0.002, 0.003),
    }
    for law in (
        flexgen.ComputedTorque(1.0),
        flexgen.JointTorqueFeedback(**gains),
        flexgen.TomeiPD(),
        flexgen.LQ(),
    ):
        made, name = case_controller(case, law)
        runs = [run_case(case, x, name) for x in (made, PythonController(made))]
        assert runs[0].status == "done" and np.array_equal(
            runs[0].nominal.tau_m, runs[1].nominal.tau_m
        )
        if not isinstance(law, flexgen.ComputedTorque | flexgen.TomeiPD):
            assert runs[0].tool_error_max_m < 1e-4


# --- the motors' laws ----------------------------------------------------------------------------


@pytest.mark.slow
def test_tomei_rests_at_the_path_and_tracks_with_feedforward():
    model = arm(rubbing=False)  # Coulomb friction would hold it elsewhere
    case = case_of(model, H, exact_state=False)
    rests = run(case, flexgen.TomeiPD(6.0))
    assert rests.tool_error_max_m > 1e-3 and rests.figures(rests.nominal)["error_end_m"] < 1e-6
    # that of the sample time
    assert run(case, flexgen.TomeiPD(6.0, feedforward=True)).tool_error_max_m < 2e-6


# --- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "law", "words"),
    [
        ("planar5_nmp", FL(), r"coordinates without motor \(q3\)"),
        ("planar5_nmp", flexgen.ComputedTorque(), r"coordinates without motor \(q3\)"),
        ("planar5_nmp", flexgen.TomeiPD(), r"TomeiPD: model planar5_nmp"),
        ("planar5_nmp", flexgen.LQ(), "without a sensor of type link_encoder for q1, q2, q3"),
        ("elbow", FL(), "without a sensor of type link_encoder for q1, q2"),
        ("elbow", flexgen.JointTorqueFeedback(), "without a sensor of type link_encoder"),
    ],
)
def test_models_that_do_not_fit_are_refused(model, law, words):
    with pytest.raises(ArgumentError, match=words):
        flexgen.control(model, controller=law, solution=_solution(model), progress=False)


def test_computed_torque_refuses_friction_of_the_load():
    law = {"type": "gear", "beta": 1.0, "load_coulomb": 0.1, "load_smoothing": 0.1}
    model = flexgen.read("elbow", overrides={"motor.m1.friction": law})
    with pytest.raises(
        ArgumentError,
        match="controller ComputedTorque: motor m1 has a friction that depends on the torque",
    ):
        flexgen.control(model, controller=flexgen.ComputedTorque(), progress=False)


def _solution(name):
    return solution_of(flexgen.read(name))


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (FL(40.0), "unstable at 1 ms and a delay of 1 ms .*expected at most 31.5 Hz"),
        (flexgen.ComputedTorque(60.0), "given 60 Hz, with which the loop is unstable"),
        (flexgen.TomeiPD(0.2), "gravity changes by .* larger gains"),
        (flexgen.TomeiPD(60.0), "the loop is unstable"),
        (
            flexgen.TomeiPD(k_p=(1.0, 2.0), k_d=(1.0, 2.0)),
            r"k_p: given \(1.0, 2.0\), expected 3 numbers > 0",
        ),
        (
            flexgen.JointTorqueFeedback(60.0),
            "frequency_hz: given 60 Hz, with which the loop is unstable",
        ),
        (
            flexgen.JointTorqueFeedback(k_p=(1,), k_d=(1,), k_t=(0,), k_s=(0,)),
            "expected 3 finite numbers",
        ),
    ],
)
def test_gains_that_are_unstable_or_do_not_fit_are_refused(law, words):
    with pytest.raises(ArgumentError, match=words):
        case_controller(case_of(arm(), H, H), law)


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: FL(-1.0), "frequency_hz: given -1.0, expected more than 0"),
        (lambda: FL(float("nan")), "frequency_hz: given nan"),
        (lambda: FL(form="fast"), "form: given 'fast', expected one of continuous, discrete"),
        (lambda: flexgen.TomeiPD(k_p=(1.0,)), "given one of them, expected both or none"),
        (
            lambda: flexgen.JointTorqueFeedback(k_p=(1.0,)),
            "given some of them, expected all four or none",
        ),
        (lambda: flexgen.LQ(0.0), "rho: given 0.0"),
        (lambda: flexgen.LQ(None), "rho: given None"),
        (lambda: FL("abc"), "frequency_hz: given 'abc'"),
        (lambda: flexgen.ComputedTorque(None), "frequency_hz: given None"),
        (lambda: flexgen.TomeiPD([1]), r"frequency_hz: given \[1\]"),
        (lambda: flexgen.JointTorqueFeedback(True), "frequency_hz: given True"),
        (lambda: FL(10**400), "frequency_hz: given 1000"),
        (lambda: flexgen.TomeiPD(k_p=["a"]), r"k_p: given \['a'\], expected numbers > 0"),
        (lambda: flexgen.TomeiPD(k_p=(1.0,), k_d=["1"]), r"k_d: given \['1'\]"),
        (lambda: flexgen.JointTorqueFeedback(k_p=3.0), "k_p: given 3.0, expected finite numbers"),
    ],
)
def test_wrong_parameters_are_refused(made, words):
    with pytest.raises(ArgumentError, match=words):
        made()


@pytest.mark.slow
def test_a_loop_that_is_unstable_at_some_poses_is_refused():
    """In the middle of this move the loop at 40 Hz is stable; unstable near the start, the arm ran
    away by 1.5 m.
    """
    move = flexgen.Move(
        "far", "joint", (0.0, 0.0, 0.0), 1.5, 5, end=tuple(np.deg2rad([30.0, 60.0, 150.0]))
    )
    model = replace(arm(), moves=(move,))
    case = control_case(model, sample_time=H, solution=solution_of(model))
    with pytest.raises(
        ArgumentError,
        match=r"given 40 Hz, with which the loop is unstable at the pose 0\.25\d* s after",
    ):
        case_controller(case, flexgen.JointTorqueFeedback(40.0))
    assert run(case, flexgen.JointTorqueFeedback(20.0)).tool_error_max_m < 1e-4


def stiff(*axes: int):
    """The three-axis arm with rigid gears in some axes."""
    model = arm()
    elements = list(model.elements)
    for k in axes:
        (dof,) = elements[k].dofs
        elements[k] = replace(elements[k], dofs=(replace(dof, gear=Gear(True)),))
    return replace(model, elements=tuple(elements))


@pytest.mark.slow
@pytest.mark.parametrize("axes", [(0, 1, 2), (0, 2)])
def test_computed_torque_with_rigid_gears_is_refused_where_it_is_unstable(axes):
    """Joints alone, 2 ms delay, exact state: z^2 (z - 1)^2 + (w h)^2 (z + 1)/2 + 2 w h
    (z - 1) = 0.
    """

    def radius(x: float) -> float:
        return float(np.abs(np.roots([1, -2, 1, x * x / 2 + 2 * x, x * x / 2 - 2 * x])).max())

    case = case_of(stiff(*axes), H, 2 * H)
    bound = max(x for x in np.linspace(1e-3, 1.0, 1000) if radius(x) < 1) / (2 * np.pi * H)
    with pytest.raises(ArgumentError, match="a chain of 2 integrators is unstable") as error:
        case_controller(case, flexgen.ComputedTorque(100.0))
    assert float(str(error.value).split("at most ")[1].split()[0]) == pytest.approx(
        bound, rel=5e-3
    )
    assert run(case, flexgen.ComputedTorque(4.0)).status == "done"


def test_late_link_encoders_are_refused():
    """The laws take all angles at one instant: with 5 ms the loop is another one than that which
    was tested.
    """
    model = arm()
    first, *others = model.sensors
    late = replace(model, sensors=(replace(first, delay_s=5e-3), *others))
    motion = case_of(model, H, exact_state=False).law_motion()
    for law in (FL(14.0), flexgen.JointTorqueFeedback(), flexgen.LQ()):
        with pytest.raises(
            ArgumentError, match=f"sensor {first.name}: given delay_s = 0.005 s, expected 0 s"
        ):
            law.bound(replace(motion, model=late))
    assert (
        replace(motion, model=replace(late, sensors=(*late.sensors, first))).link_channels("x")
        == [6, 4, 5]
    ).all()


def test_a_law_needs_a_planned_motion():
    with pytest.raises(
        ArgumentError, match="expected one that regulates without the planned motion"
    ):
        flexgen.score("two_link", FL(), progress=False)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            'type = "feedback_linearisation"\nhz = 3.0',
            (
                "2:hz: given an unknown key, expected one of allow_unstable, description, form, "
                "frequency_hz"
            ),
        ),
        ('type = "lq"\nrho = "big"', '2:rho: given "big", expected a finite number'),
        (
            'type = "tomei_pd"\nk_p = [1.0, true]\nk_d = [1.0, 1.0]',
            "2:k_p: given .*, expected a sequence with a number in each place",
        ),
        (
            'type = "fuzzy"',
            '1:type: given "fuzzy", expected one of cascade, .*, feedback_linearisation',
        ),
    ],
)
def test_wrong_files_are_refused(tmp_path, text, words):
    (tmp_path / "law.toml").write_text(text)
    with pytest.raises(ArgumentError, match=words):
        flexgen.control(
            ARM, controller=str(tmp_path / "law.toml"), solution=solution_of(arm()), progress=False
        )


def test_a_file_is_the_same_law(tmp_path):
    (tmp_path / "law.toml").write_text(
        'type = "feedback_linearisation"\nfrequency_hz = 14.0\nform = "discrete"\n'
    )
    runs = [
        flexgen.control(
            ARM, controller=c, solution=solution_of(arm()), sample_time=H, progress=False
        )
        for c in (str(tmp_path / "law.toml"), FL(14.0, "discrete"))
    ]
    assert np.array_equal(runs[0].nominal.tau_m, runs[1].nominal.tau_m)


class Watch:
    """Records what it is shown."""

    def __init__(self) -> None:
        self.shown = []

    def reset(self) -> None:
        pass

    def step(self, k, y, ref):
        self.shown.append((y.sensors[3:].copy(), ref.sensors[3:].copy()))
        return ref.tau_m


def test_the_exact_state_is_that_of_the_plant():
    case = case_of(arm(), H)
    watch = PythonController(Watch())
    seen = []
    watch.controller.__class__.__deepcopy__ = lambda self, memo: seen.append(self) or self
    found = run_case(case, watch, "watch")
    state, reference = (np.array(x) for x in zip(*seen[0].shown, strict=True))
    assert np.array_equal(state[:, :3], found.nominal.q_a) and np.array_equal(
        state[:, 6:9], found.nominal.q_m
    )
    motion = case.reference.motion
    assert np.array_equal(
        reference, np.hstack([motion[name] for name in ("q_a", "v_a", "q_m", "v_m")])
    )
