"""Each option of the command line gives its value to the parameter of the public function."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.registry import Option
from flexgen.cli import result
from flexgen.cli.main import main
from flexgen.cli.parser import parse
from flexgen.cli.verb_tables.signature_source import defaults_of, signature_of
from flexgen.cli.verb_tables.verb_texts import choices_of
from flexgen.cli.verb_tables.verbs import VERBS

# Texts of the values, by the kind that reads them.
TEXTS = {
    "integer": "3",
    "number": "0.37",
    "positive": "0.37",
    "not_negative": "0.37",
    "names": "a,b",
    "numbers": "0.1,0.2,0.3",
    "integers": "1,2",
    "spectrum": "0.7",
    "factor_or_file": "0.7",
    "isa": "v3",
    "setting": "gain=2.5",
    "joint_value": "q1=0.5",
    "plant": "soft:stiffness=0.8",
    "changes": "stiffness=0.8",
    "disturbance": "step:m1=2@0.5",
    "wall": "1.2,0,0:-1,0,0:1e5",
    "box": "-1,-1,-2:1,1,-1.5",
}
# Options whose value the command line uses itself, with the reason.
USED_BEFORE = {
    ("calibrate", "columns"): "StaticPoses.read reads the file",
    ("identify", "validate"): "Frf.load reads the files",
    ("frf", "time_limit"): "the reading of the experiment is limited too",
    ("score", "time_limit"): "limits the scores of all controllers together",
    ("score", "controller"): "several controllers, by name",
    ("solve", "fastest"): "calls flexgen.fastest",
    ("solve", "limits"): "a switch: the limits of the model",
    ("measure", "raw"): "a folder: RecordingWriter",
    ("sweep", "resume"): "of a folder that has a sweep",
    ("kinematics", "rotation"): "a rotation vector: ToolPose",
}
BEFORE = {  # words that a verb needs
    "calibrate": ["--columns", "q1"],
    "kinematics": ["--position", "0.1", "0.2", "0.3"],
    "sweep": ["--out", "swept"],
}
LOADED = {  # what is read from files
    "flexgen.identification.experiments.excitation:Plan.load": SimpleNamespace(duration_s=1.0),
    "flexgen.identification.responses.frequency_response:Frf.load": "frf",
    "flexgen.identification.records.experiment_file:load_experiment": "experiment",
    "flexgen.identification.poses.poses:StaticPoses.read": "poses",
    "flexgen.studies.sweeps.grid_file:read_grid": [1, 2],
    "flexgen.base.motion.trajectory:Trajectory.load": "trajectory",
}


class Recorder:
    """A public function that records its arguments and refuses them."""

    def __init__(self, function: Any) -> None:
        self.signature = inspect.signature(function)
        self.given: dict[str, Any] | None = None

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        self.given = dict(self.signature.bind(*args, **kwargs).arguments)
        raise ArgumentError("recorded")


def taken(verb: str) -> list[Option]:
    """The options of a verb that are parameters of its function."""
    row = VERBS[verb]
    parameters = signature_of(row.function).parameters if row.function else {}
    return [
        option
        for option in row.options()
        if option.parameter in parameters
        and not option.of
        and (verb, option.parameter) not in USED_BEFORE
    ]


def words_of(verb: str, option: Option) -> list[str]:
    """A command line with one option."""
    row = VERBS[verb]
    words = [*verb.split(), *(["elbow"] if row.takes_model != "none" else [])]
    places = [x for x in row.options() if x.place and x.parameter != option.parameter]
    words += ["four_mass" if x.name == "scenario" else "model" for x in places if x.name != "kind"]
    for other in row.options():
        if other.required and other.parameter != option.parameter:
            ending = "toml" if other.kind == "toml_file" else "npz"
            words += [other.option, f"needed.{ending}"]
    before = BEFORE.get(verb, [])
    words += before if option.option not in before else []
    text = text_of(option)
    if option.place:
        return [*words, text]
    return [*words, option.option, *([text] if option.takes_value else [])]


def text_of(option: Option) -> str:
    """A value as it is written."""
    name, _, least = option.kind.partition(" ")
    if choices_of(option):
        return choices_of(option)[-1]
    if least:
        return str(int(least) + 3)
    if option.parameter == "move":
        return "line"
    return TEXTS.get(name, "file.npz" if option.metavar != "DIR" else "folder")


def is_same(found: Any, expected: Any) -> bool:
    """Whether a function got the value of an option, or the object that it describes."""
    if isinstance(found, np.ndarray):
        return found.tolist() == expected
    if expected == found or any(found is made for made in LOADED.values()):
        return True
    if isinstance(expected, list) and isinstance(expected[0], dict) and "kind" not in expected[0]:
        return all(is_same(one, each) for one, each in zip(found, expected, strict=True))  # boxes
    if isinstance(expected, list) and isinstance(expected[0], dict):  # disturbances
        return all(
            vars(one)["kind"] == each["kind"] for one, each in zip(found, expected, strict=True)
        )
    if isinstance(expected, list | tuple) and isinstance(expected[0], tuple):  # several NAME=VALUE
        return found == dict(expected)
    if isinstance(expected, dict):  # a wall
        return all(
            tuple(getattr(found, key)) == value
            if isinstance(value, tuple)
            else getattr(found, key) == value
            for key, value in expected.items()
        )
    if isinstance(expected, list) and len(expected) == 1:
        first = found[0] if isinstance(found, list) else found
        return is_same(first, expected[0])
    return getattr(found, "name", None) == expected


def check_option(verb: str, option: Option, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run a verb with one option; its function must get the value."""
    function = VERBS[verb].function
    module = importlib.import_module(vars(flexgen)["_PUBLIC"][function])
    recorder = Recorder(getattr(module, function))
    monkeypatch.setattr(module, function, recorder)
    for place, made in LOADED.items():
        home, _, name = place.partition(":")
        owner: Any = importlib.import_module(home)
        for part in name.split(".")[:-1]:
            owner = getattr(owner, part)
        monkeypatch.setattr(owner, name.split(".")[-1], lambda *args, made=made: made)
    words = words_of(verb, option)
    main([*words, "-q"])
    expected = getattr(parse(words), option.parameter)
    assert recorder.given is not None, f"{words} does not call {function}"
    assert option.parameter in recorder.given, f"{words}: {option.parameter} is not passed"
    found = recorder.given[option.parameter]
    assert is_same(found, expected), f"{words}: given {expected!r}, {function} got {found!r}"


def cases() -> list[Any]:
    """Options of all verbs; one of each verb, drawn, runs with the quick tests."""
    drawn = Random(71)
    found = []
    for verb in VERBS:
        options = taken(verb)
        quick = drawn.randrange(len(options)) if options else 0
        for k, option in enumerate(options):
            marks = () if k == quick and verb != "run" else pytest.mark.slow
            found.append(pytest.param(verb, option, id=f"{verb} {option.name}", marks=marks))
    return found


@pytest.mark.parametrize(("verb", "option"), cases())
def test_an_option_gives_its_value_to_the_function(
    verb: str, option: Option, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    check_option(verb, option, monkeypatch)


def test_a_value_under_a_wrong_name_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    right = result.keywords

    def keywords(*args: Any) -> dict[str, Any]:
        found = right(*args)
        return {"seed" if name == "robots" else name: value for name, value in found.items()}

    monkeypatch.setattr(result, "keywords", keywords)
    (robots,) = (option for option in taken("predict") if option.name == "robots")
    with pytest.raises(AssertionError, match="robots is not passed"):
        check_option("predict", robots, monkeypatch)


def test_a_changed_value_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    right = result.keywords
    monkeypatch.setattr(
        result, "keywords", lambda *args: {key: value + 1 for key, value in right(*args).items()}
    )
    (robots,) = (option for option in taken("predict") if option.name == "robots")
    with pytest.raises(AssertionError, match="given 4, predict got 5"):
        check_option("predict", robots, monkeypatch)


def test_each_exception_is_an_option_with_a_default() -> None:
    for verb, name in USED_BEFORE:
        assert name in signature_of(VERBS[verb].function).parameters, (verb, name)
        assert name in {option.parameter for option in VERBS[verb].options()}
    assert defaults_of("predict")["robots"] == 48
