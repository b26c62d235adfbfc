"""Rows of `flexgen.verbs`: names and defaults are those of the public functions; exceptions have a reason each."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
from pathlib import Path

import export_tables
import pytest

import flexgen
from flexgen.cli.defaults import defaults_of
from flexgen.cli.parser import parse
from flexgen.verb_rows import Verb, verbs_of
from flexgen.verbs import VERBS, choices_of

WRITTEN = {"out", "report", "force"}  # what is written, by the function or by methods of its result

# Options without a parameter of the function, with the reason.
OPTIONS = {
    ("derive", "text"): "text and LaTeX are made by flexgen.equations_text",
    ("derive", "latex"): "text and LaTeX are made by flexgen.equations_text",
    ("analyze", "move"): "Python takes the planned path",
    ("solve", "moves"): "flexgen.read_moves reads a file",
    ("plan", "moves"): "flexgen.read_moves reads a file",
    ("solve", "robustness"): "a part of the report",
    ("sweep", "parquet"): "SweepResult.results.save",
    ("excite", "sample_time"): "a field of DriveHardware",
    ("excite", "delay"): "a field of DriveHardware",
    ("excite", "encoder_noise"): "a field of DriveHardware",
    ("excite", "encoder_resolution"): "a field of DriveHardware",
    ("excite", "torque_noise"): "a field of DriveHardware",
    ("excite", "references"): "Plan.write_references",
    ("identify", "structure"): "another search of the identification room",
    ("identify", "refine"): "flexgen.refine",
    ("identify", "rigid"): "another fit of the identification room",
    ("identify", "counterbalance"): "of the fit of rigid bodies",
    ("identify", "segments"): "flexgen.fit_motion",
    ("identify", "validate"): "flexgen.fit_motion",
    ("identify", "move"): "IdentificationResult.verdict",
    ("identify", "truth"): "IdentificationResult.verdict",
    ("fastest", "torque"): "a field of Limits",
    ("fastest", "speed"): "a field of Limits",
    ("kinematics", "joints"): "Python takes a pose",
    ("score", "scenario"): "the parameter is name",
    ("tune", "scenario"): "the parameter is name",
    ("view", "robot"): "the parameter is model; MODEL is what is shown",
}
# Options with another name than the parameter, with the reason.
WORDS = {
    ("generate", "parts"): "reads as a sentence: generate MODEL --with bvp",
    ("control", "plants"): "one robot for each --plant",
    ("control", "disturbances"): "one for each --disturb",
    ("export fmu", "version"): "--version is of flexgen",
}
# Options whose value is another one than that of the parameter, with the reason.
VALUES = {
    ("solve", "limits"): "a switch: those of the model",
    ("solve", "move"): "several moves, solved one by one",
    ("solve", "fastest"): "calls flexgen.fastest; the parameter is old",
    ("export ros2", "no_gains"): "a switch: no gains; the default is a text",
}


def called() -> list[str]:
    return [name for name, verb in VERBS.items() if verb.function]


def without_parameter(verb: Verb) -> list[str]:
    """Options that are neither parameters of the public function nor what is written."""
    parameters = inspect.signature(getattr(flexgen, verb.function)).parameters
    return [
        option.name
        for option in verb.options()
        if option.parameter not in parameters and option.parameter not in WRITTEN
    ]


@pytest.mark.parametrize("name", called())
def test_each_option_is_a_parameter_or_has_a_reason(name):
    assert without_parameter(VERBS[name]) == [option for verb, option in OPTIONS if verb == name]


@pytest.mark.parametrize("name", called())
def test_defaults_read_from_the_source_are_those_of_the_function(name):
    function = VERBS[name].function
    parameters = inspect.signature(getattr(flexgen, function)).parameters
    expected = {p.name: p.default for p in parameters.values() if p.default is not p.empty}
    read = defaults_of(function)
    assert read.keys() == expected.keys()
    assert {
        key: value for key, value in expected.items() if isinstance(value, (int, float, str, tuple, type(None)))
    } == read


@pytest.mark.parametrize("name", called())
def test_a_switch_off_is_of_a_parameter_that_is_on(name):
    defaults = defaults_of(VERBS[name].function)
    for option in VERBS[name].options():
        if option.parameter in defaults and not option.takes_value and (name, option.name) not in VALUES:
            assert defaults[option.parameter] is option.name.startswith("no_"), option.name


def test_each_option_with_another_name_than_its_parameter_has_a_reason():
    assert {(verb.name, option.name) for verb in VERBS.values() for option in verb.options() if option.word} == set(
        WORDS
    )


FORMER = [(verb.name, option, old) for verb in VERBS.values() for option in verb.options() for old in option.old]


@pytest.mark.parametrize(("verb", "option", "old"), FORMER, ids=[f"{verb} {old}" for verb, _, old in FORMER])
def test_a_former_option_is_accepted_with_a_note(verb, option, old):
    word, _, value = old.partition("=")
    required = [w for o in VERBS[verb].options() if o.required for w in (o.option, "x.npz")]
    args = parse([*verb.split(), "elbow", *required, word, *(["1"] if option.takes_value and not value else [])])
    assert args.notes == [
        f"{word} is the old name of {' '.join(filter(None, (option.option, value)))}, please use the new one"
    ]
    assert option.parameter in args.given and (not value or getattr(args, option.parameter) == value)


def test_the_former_name_of_a_verb_is_accepted_with_a_note():
    args = parse(["path", "elbow", "--move", "line"])
    assert args.verb == "plan" and args.notes == ["path is the old name of plan, please use the new one"]


def test_the_page_of_the_command_line_names_each_verb_once():
    page = Path(__file__).resolve().parents[2] / "docs" / "command_line.md"
    table = page.read_text(encoding="utf-8").partition("| verb |")[2].partition("\n\n")[0]
    named = [name for line in table.splitlines()[2:] for name in re.findall(r"`(\w+)[^`]*`", line.split("|")[1])]
    assert sorted(named) == sorted({name.partition(" ")[0] for name in VERBS})


def test_the_tables_of_exports_are_those_of_the_rows():
    for page, text in export_tables.pages().items():
        assert page.read_text(encoding="utf-8") == text, f"{page}: make golden writes it"


PLANTED_MODULE = """
def export_planted(model, path, *, digits: int = 7):
    return f"{model} {path} {digits}"
"""
PLANTED_ROW = """registry.EXPORTS |= {
    "planted": registry.Export(
        "flexgen.exports.planted", "[planted](planted.md)", "Write a name.",
        "\\n    files\\n        digits N whole_1: of the name; default: {default}"
        "\\n        out FILE required: write this file"
    ),
"""
USED = """
import sys
sys.path.append(sys.argv[1])
import flexgen, export_tables
from flexgen.cli.main import main
from flexgen.registry import EXPORTS
print(flexgen.export_planted("elbow", "elbow.txt"), "export_planted" in dir(flexgen))
print(export_tables.readme_table(EXPORTS), export_tables.command_row(EXPORTS))
main(["export", "planted", "--help"])
"""


def test_a_new_export_needs_its_module_and_its_row(tmp_path):
    package = Path(flexgen.__file__).parent
    for source, copy in ((package, tmp_path / "flexgen"), (package / "exports", tmp_path / "flexgen" / "exports")):
        copy.mkdir()
        for entry in source.iterdir():
            if entry.name not in ("__init__.py", "exports", "__pycache__"):
                (copy / entry.name).symlink_to(entry)
        (copy / "__init__.py").write_text((source / "__init__.py").read_text(encoding="utf-8"), encoding="utf-8")
    front = tmp_path / "flexgen" / "__init__.py"
    before = front.read_text(encoding="utf-8")
    front.write_text(before.replace("registry.EXPORTS |= {\n", PLANTED_ROW), encoding="utf-8")  # file 1
    (tmp_path / "flexgen" / "exports" / "planted.py").write_text(PLANTED_MODULE, encoding="utf-8")  # file 2
    support = str(Path(export_tables.__file__).parent)
    command = [sys.executable, "-c", USED, support]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for found in (
        "elbow elbow.txt 7 True",
        "| `planted` | `export_planted` | `planted.py` | Write a name | [planted](../../docs/planted.md) |",
        "writes the robot for another tool: `planted` ([planted](planted.md)), `fmu`",
        "usage: flexgen export planted",
        "of the name; default: 7",
    ):
        assert found in done.stdout


def test_choices_contain_the_default():
    for verb in VERBS.values():
        for option in verb.options():
            default = defaults_of(verb.function).get(option.parameter) if verb.function else None
            if choices_of(option) and default is not None:
                assert default in choices_of(option), (verb.name, option.name)


def test_a_planted_option_without_parameter_is_seen():
    planted = verbs_of("check MODEL | check:check | check\n    files\n        colour NAME: of the table", "")
    assert without_parameter(planted["check"]) == ["colour"]


def test_a_word_without_meaning_is_refused():
    with pytest.raises(ValueError, match="given the word 'once!'"):
        verbs_of("check MODEL | check:check\n    files\n        colour NAME once!: of the table", "")


def restated_defaults(help_text: str, default: object) -> bool:
    """Whether a help states the number that is the default of the function, instead of ``{default}``."""
    stated = re.findall(r"default: ([-+.\de]+)(?=[;,. ]|$)", help_text)
    return isinstance(default, int | float) and any(float(text.rstrip(".")) == default for text in stated)


def test_no_help_states_the_default_of_the_function_again():
    for verb in VERBS.values():
        defaults = defaults_of(verb.function) if verb.function else {}
        again = [x.name for x in verb.options() if restated_defaults(x.help, defaults.get(x.parameter))]
        assert again == [], verb.name
    assert restated_defaults("sample time [s]; default: 0.001", 1e-3)
    assert not restated_defaults("sample time [s]; default: {default}", 1e-3)
    assert not restated_defaults("sample time [s]; default: 0.001", None)
