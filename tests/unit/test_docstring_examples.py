"""Public functions and classes have an example in their docstring, which runs; classes without are listed."""

from __future__ import annotations

import doctest
import inspect

import pytest

import flexgen

NOT_RUN = {"export"}  # needs a package of another author; tests/client/test_extensions.py installs one
SLOW = set(
    """
    export_mex export_plcopen export_fmu export_simulink export_ros2 plan_problem sweep refine fit_motion control
    feedback_study tune fastest identify_load learn score view
    Cascade CollisionDetector Disturbance ExtendedKalmanFilter Library PathSampler PID PlanProblem PPI Simulation
    Solution Stream TorqueCommand Trajectory
    """.split()
)
# Classes without an example, by reason; none may be added.
CLASSES = {
    "result of a function, whose example shows it": """
    Configuration ControlRun Detection Estimate Experiment FastestMove FeedbackStudy Frf GeneratedLibrary
    IdentificationResult LearningResult Load MotionFit PathSample Plan RandomMove Score Status SweepResult TuningResult
    """,
    "part of another object, whose example or page shows it": """
    Equilibrium Finding Function InverseKinematics Inverter LimitedInverter LoopAtPose LowPass Margins Measurement MoveC
    MoveJ Notch Phase PlantRun Port PoseTarget Reference Scenario Segment Setting Trial Window
    """,
    "law or observer: docs/control.md compares them on one robot": """
    ComputedTorque ConstantGainObserver Controller FeedbackLinearisation JointTorqueFeedback Linear LoopShaping LQ LQG
    TomeiPD
    """,
}


def functions() -> dict[str, object]:
    return {name: what for name in flexgen.__all__ if inspect.isfunction(what := getattr(flexgen, name))}


def without_example(named: dict[str, object]) -> set[str]:
    return {name for name, what in named.items() if "\n    Examples\n    --------\n" not in (what.__doc__ or "")}


def classes() -> dict[str, object]:
    return {name: what for name in flexgen._NOUNS if inspect.isclass(what := getattr(flexgen, name))}


def failures(name: str, what: object) -> int:
    """Examples of a docstring that fail; they are run with flexgen imported."""
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner(verbose=False)
    (test,) = finder.find(what, name, globs={"flexgen": flexgen})
    assert test.examples, f"{name}: an example begins with >>>"
    return runner.run(test, out=lambda text: None).failed


def test_each_public_function_states_returns_and_has_an_example():
    named = functions()
    assert len(named) > 35 and not without_example(named)
    assert not {name for name, what in named.items() if "\n    Returns\n" not in (what.__doc__ or "")}


def test_each_public_class_has_an_example_or_is_listed_with_a_reason():
    listed = [name for names in CLASSES.values() for name in names.split()]
    assert without_example(classes()) == set(listed) and len(listed) == len(set(listed)) == 53


def test_planted_functions_without_or_with_a_wrong_example_are_seen():
    def planted():
        """Return nothing.

        Examples
        --------
        >>> 1 + 1
        3
        """

    assert without_example({"planted": functions}) == {"planted"} and failures("planted", planted) == 1


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW))
        for name in sorted({*functions(), *classes()} - NOT_RUN - without_example(classes()))
    ],
)
def test_the_example_of_a_docstring_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert failures(name, getattr(flexgen, name)) == 0
