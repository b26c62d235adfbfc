"""Former names of arguments work with a warning in the line of the caller; functions have few parameters."""

from __future__ import annotations

import inspect
from pathlib import Path

import pytest

import flexgen
from flexgen.deprecation import renamed
from flexgen.errors import ArgumentError

MOST = 8  # parameters of a public function; more of them belong into an object of options

# Public functions with more parameters; each number may only fall.
LARGER = {
    "control": 14,
    "excite": 17,
    "export_fmu": 11,
    "export_ros2": 9,
    "fit_motion": 10,
    "generate": 14,
    "identify": 16,
    "learn": 14,
    "simulate": 9,
    "solve": 17,
    "tune": 9,
}


def larger(functions: dict[str, object]) -> dict[str, int]:
    """Functions with more than `MOST` parameters, and how many they have."""
    counts = {name: len(inspect.signature(what).parameters) for name, what in functions.items()}  # type: ignore[arg-type]
    return {name: count for name, count in counts.items() if count > MOST}


def test_no_further_public_function_has_more_than_eight_parameters():
    functions = {name: getattr(flexgen, name) for name in flexgen.__all__ if inspect.isfunction(getattr(flexgen, name))}
    found = larger(functions)
    assert found.keys() == LARGER.keys() and all(found[name] <= LARGER[name] for name in found)


def test_a_planted_function_with_nine_parameters_is_seen():
    assert larger({"f": lambda a, b, c, d, e, f, g, h, i: None, "g": lambda a: None}) == {"f": 9}


def test_generate_takes_its_former_first_argument_with_a_warning(tmp_path):
    with pytest.warns(DeprecationWarning, match="given model_or_equations=, expected its new name, model=") as caught:
        made = flexgen.generate(model_or_equations="elbow", directory=tmp_path / "e", build=False)  # type: ignore[call-arg]
    assert made.directory == tmp_path / "e"
    assert [Path(warning.filename).name for warning in caught] == [Path(__file__).name]


def test_both_names_of_an_argument_are_refused():
    call = renamed(old="new")(lambda new=0: new)
    with pytest.raises(TypeError, match="unexpected keyword argument 'old'"):
        call(new=1, old=2)


def test_limits_from_a_model_are_those_of_its_file_or_those_given():
    limits = flexgen.Limits.from_model("four_mass")
    assert limits == flexgen.Limits.from_model(flexgen.derive("four_mass")) and limits.torque == (20.0,)
    assert flexgen.Limits.from_model("elbow", torque=20.0, speed=[100.0, 200.0]) == flexgen.Limits(
        (20.0, 20.0), (100.0, 200.0)
    )
    with pytest.raises(ArgumentError, match="states none"):
        flexgen.Limits.from_model("planar5_mp")
