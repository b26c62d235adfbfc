"""Public functions and classes have an example in their docstring, which runs."""

from __future__ import annotations

import doctest
import inspect

import pytest

import flexgen

# needs a package of another author; tests/client/test_extensions.py installs one
NOT_RUN = {"export"}
SLOW = set(
    """
    export_mex export_plcopen export_fmu export_simulink export_ros2 plan_problem sweep refine \
fit_motion control
    feedback_study tune fastest identify_load learn predict score view
    Cascade CollisionDetector ControlRun Disturbance ExtendedKalmanFilter Estimate FastestMove \
FeedbackStudy Inverter
    Library Load MotionFit PathSampler PID PlanProblem PPI Prediction Simulation Solution Stream
    SweepResult TorqueCommand Trajectory TuningResult
    ManyInverter Impedance sense LearningResult identify_gears GearFit ComputedTorque \
PositionCommands
    check_passivity Passivity LoopShaping identify_servo Trial Score identify Detection ServoFit \
Comparison
    Servo ConstantGainObserver
    """.split()
)


def functions() -> dict[str, object]:
    return {
        name: what
        for name in flexgen.__all__
        if inspect.isfunction(what := getattr(flexgen, name))
    }


def without_example(named: dict[str, object]) -> set[str]:
    return {
        name
        for name, what in named.items()
        if "\n    Examples\n    --------\n" not in (what.__doc__ or "")
    }


def classes() -> dict[str, object]:
    """The public classes but the errors."""
    named = {name: getattr(flexgen, name) for name in flexgen.__all__}
    return {
        name: what
        for name, what in named.items()
        if inspect.isclass(what) and not issubclass(what, Exception)
    }


def without_returns(named: dict[str, object]) -> set[str]:
    """Methods of classes that return something, whose docstring has sections, but not this one."""
    return {
        f"{name}.{member}"
        for name, what in named.items()
        for member in vars(what)
        if not member.startswith("_")
        and callable(method := getattr(what, member))
        and inspect.isroutine(method)
        if inspect.signature(method).return_annotation
        not in (None, "None", inspect.Signature.empty)
        if "\n---" in (text := inspect.cleandoc(method.__doc__ or ""))
        and "\nReturns\n---" not in text
    }


def failures(name: str, what: object) -> int:
    """Examples of a docstring that fail; they are run with flexgen imported."""
    finder = doctest.DocTestFinder(recurse=False)
    runner = doctest.DocTestRunner(verbose=False)
    (test,) = finder.find(what, name, globs={"flexgen": flexgen})
    assert test.examples, f"{name}: an example begins with >>>"
    return runner.run(test).failed  # it prints the failures


def test_each_public_function_states_returns_and_has_an_example():
    named = functions()
    assert len(named) > 35 and not without_example(named)
    assert not {
        name for name, what in named.items() if "\n    Returns\n" not in (what.__doc__ or "")
    }


def test_each_public_class_has_an_example():
    assert len(classes()) > 80 and not without_example(classes())


def test_methods_whose_docstrings_have_sections_state_returns():
    class Planted:
        def count(self) -> int:
            """A number.

            Raises
            ------
            """

    assert without_returns({"Planted": Planted}) == {"Planted.count"} and not without_returns(
        classes()
    )


def test_planted_functions_without_or_with_a_wrong_example_are_seen():
    def planted():
        """Return nothing.

        Examples
        --------
        >>> 1 + 1
        3
        """

    assert (
        without_example({"planted": functions}) == {"planted"}
        and failures("planted", planted) == 1
    )


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW))
        for name in sorted({*functions(), *classes()} - NOT_RUN)
    ],
)
def test_the_example_of_a_docstring_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert failures(name, getattr(flexgen, name)) == 0
