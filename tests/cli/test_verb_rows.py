"""Rows of `flexgen.cli.verb_tables.verbs`: names and defaults are those of the public functions;
exceptions have a reason each.
"""

from __future__ import annotations

import argparse
import inspect
import re
import subprocess
import sys
from pathlib import Path

import export_tables
import pytest

import flexgen
from flexgen.base.checks.type_checks import checks_of
from flexgen.base.checks.types_of_values import Check
from flexgen.base.registry import Option
from flexgen.cli import argument_types
from flexgen.cli.parser import parse
from flexgen.cli.verb_tables.signature_source import defaults_of
from flexgen.cli.verb_tables.verb_rows import Verb
from flexgen.cli.verb_tables.verb_texts import choices_of
from flexgen.cli.verb_tables.verbs import VERBS

# what is written, by the function or by methods of its result
WRITTEN = {"out", "report", "force"}

# Options without a parameter of the function, with the reason.
OPTIONS = {
    ("derive", "text"): "text and LaTeX are made by flexgen.analysis.printing",
    ("derive", "latex"): "text and LaTeX are made by flexgen.analysis.printing",
    ("analyze", "move"): "Python takes the planned path",
    ("solve", "moves"): "flexgen.read_moves reads a file",
    ("plan", "moves"): "flexgen.read_moves reads a file",
    ("solve", "details"): "what is printed: Solution.to_text",
    ("solve", "robustness"): "a part of the report",
    ("sweep", "parquet"): "SweepResult.results.save",
    ("excite", "pose"): "entries of poses, one at a time",
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
    ("identify", "move"): "IdentificationResult.verdict",
    ("identify", "truth"): "IdentificationResult.verdict",
    ("control", "no_compare"): "another function: flexgen.compare_feedforward",
    ("control", "passivity"): "flexgen.check_passivity",
    ("fastest", "torque"): "a field of Limits",
    ("fastest", "speed"): "a field of Limits",
    ("fastest", "reserve"): "a field of Limits",
    ("calibrate", "prior"): "a field of Priors",
    ("calibrate", "add_poses"): "Calibration.propose_poses",
    ("calibrate", "world"): "Calibration.write",
    ("learn", "measured"): "flexgen.next_run",
    ("learn", "folder"): "flexgen.next_run",
    ("learn", "clock"): "a field of LearningOptions",
    ("learn", "clock_of"): "a field of LearningOptions",
    ("learn", "frame"): "a field of LearningOptions",
    ("learn", "poses"): "a field of LearningOptions",
    ("kinematics", "joints"): "Python takes a pose",
    ("kinematics", "command"): "flexgen.tracker_positions",
    ("score", "scenario"): "the parameter is name",
    ("tune", "scenario"): "the parameter is name",
    **{
        ("tune", name): "of a model: flexgen.tune_cascade"
        for name in (
            "move",
            "plants",
            "disturbances",
            "sample_time",
            "delay",
            "encoder_noise",
            "gain_margin_db",
            "phase_margin_deg",
        )
    },
    ("view", "robot"): "the parameter is model; MODEL is what is shown",
}
# Options with another name than the parameter, with the reason.
WORDS = {
    ("generate", "parts"): "reads as a sentence: generate MODEL --with bvp",
    ("control", "plants"): "one robot for each --plant",
    ("control", "disturbances"): "one for each --disturb",
    ("export fmu", "version"): "--version is of flexgen",
    ("tune", "plants"): "one robot for each --plant",
    ("tune", "disturbances"): "one for each --disturb",
    ("tune", "gain_margin_db"): "the unit stands in the help",
    ("tune", "phase_margin_deg"): "the unit stands in the help",
}
# Options with the name of a parameter whose value is another one, with the reason.
VALUES = {
    ("solve", "limits"): "a switch: those of the model",
    ("solve", "fastest"): "calls flexgen.fastest; the parameter is old",
    ("measure", "raw"): "a folder; Python takes a function",
    ("kinematics", "rotation"): "a rotation vector; Python takes the axes",
    ("export ros2", "no_gains"): "a switch: no gains; the default is a text",
    ("commission", "curves"): "a switch: always; default: where records ask for them",
}
# Options with a help of their own, because the verb calls two functions; the rest is derived.
TWO_FUNCTIONS = {
    ("identify", "validate"): "flexgen.identify, and flexgen.fit_motion and the rigid arm",
    ("tune", "controller"): "flexgen.tune and flexgen.tune_cascade",
    ("tune", "evaluations"): "flexgen.tune and flexgen.tune_cascade",
    ("tune", "seed"): "flexgen.tune and flexgen.tune_cascade",
}
# Numbers or arrays, and each number is an array: the function checks the number itself.
ARRAYS = {("excite", "poses")}
# A default, or the words that a value may be, in what a row says more.
STATES_VALUE = re.compile(r"default|expected|one of")


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


def stated(verb: Verb) -> list[tuple[str, str]]:
    """Options of a row and what they state although a parameter has it: its type, its allowed
    values, its default, its help.
    """
    found = []
    for row in (row for rows in (verb.rows or {}).values() for row in rows):
        option = Option(row) if isinstance(row, str) else row
        owner, _, name = option.of.rpartition(".")
        owner = owner or verb.function
        names = {name or option.name, option.name.removeprefix("no_")}
        if not owner or not names & set(inspect.signature(getattr(flexgen, owner)).parameters):
            continue
        for what in ("help", "kind", "choices"):
            if getattr(option, what):
                found.append((option.name, what))
        if STATES_VALUE.search(option.more):
            found.append((option.name, "default"))
    return found


@pytest.mark.parametrize("name", VERBS)
def test_no_row_states_what_a_parameter_has(name):
    found = [
        (option, what)
        for option, what in stated(VERBS[name])
        if (name, option) not in VALUES
        and not ((name, option) in TWO_FUNCTIONS and what == "help")
    ]
    assert found == []


def refused_differently(option: Option, check: Check) -> list[str]:
    """Numbers that the command line refuses and the function takes."""
    kind, _, least = option.kind.partition(" ")
    read = argument_types.whole(int(least)) if least else getattr(argument_types, kind)
    found = []
    for text in ("-1", "0", "0.37", "1", "2", "5", "30"):
        number = float(text) if "." in text else int(text)
        try:
            read(text)
        except argparse.ArgumentTypeError:
            found += [text] if check.passes(number) else []
    return found


@pytest.mark.parametrize("name", called())
def test_a_number_that_the_command_line_refuses_is_refused_by_the_function(name):
    checks = checks_of(getattr(flexgen, VERBS[name].function))
    for option in VERBS[name].options():
        is_number = option.kind in ("positive", "not_negative") or option.kind.startswith("whole")
        if (name, option.name) in (*VALUES, *ARRAYS) or option.parameter not in checks:
            continue
        if is_number:
            assert refused_differently(option, checks[option.parameter]) == [], option.name


def test_another_bound_on_the_command_line_is_seen():
    robots = checks_of(flexgen.predict)["robots"]
    assert refused_differently(Option("robots", kind="whole 1"), robots) == []
    assert refused_differently(Option("robots", kind="whole 5"), robots) == ["1", "2"]


@pytest.mark.parametrize(
    ("option", "seen"),
    [
        (Option("robots", "that are simulated", "N", "whole 1"), ["help", "kind"]),
        (Option("robots", kind="whole 16"), ["kind"]),
        (Option("method", choices=("lq", "full")), ["choices"]),
        (Option("robots", more="; default: 48"), ["default"]),
        (Option("x", kind="positive", of="control.delay"), ["kind"]),
        (Option("no_verify", "without the verification"), ["help"]),
        (Option("robots", metavar="N", once=True, old=("--draws",), word="--number"), []),
        (Option("colour", "of the table", "NAME", choices=("red", "blue")), []),
    ],
)
def test_a_planted_second_statement_is_seen(option, seen):
    function = "predict" if option.name in ("robots", "x") else "solve"
    planted = Verb("planted", function=function, rows={"planted": ("time_limit", option)})
    assert stated(planted) == [(option.name, what) for what in seen]


def test_a_row_with_the_name_of_no_parameter_is_refused():
    planted = Verb("planted", function="predict", rows={"draws": ("robot",)})
    with pytest.raises(ValueError, match="given 'robot', no parameter of predict"):
        list(planted.options())
    with pytest.raises(ValueError, match="solution cannot be given as a text"):
        list(Verb("planted", function="predict", rows={"draws": ("solution",)}).options())


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
        key: value
        for key, value in expected.items()
        if isinstance(value, (int, float, str, tuple, type(None)))
    } == read


@pytest.mark.parametrize("name", called())
def test_a_switch_off_is_of_a_parameter_that_is_on(name):
    defaults = defaults_of(VERBS[name].function)
    for option in VERBS[name].options():
        if (
            option.parameter in defaults
            and not option.takes_value
            and (name, option.name) not in VALUES
        ):
            assert defaults[option.parameter] is option.name.startswith("no_"), option.name


def test_each_option_with_another_name_than_its_parameter_has_a_reason():
    assert {
        (verb.name, option.name)
        for verb in VERBS.values()
        for option in verb.options()
        if option.word
    } == set(WORDS)


FORMER = [
    (verb.name, option, old)
    for verb in VERBS.values()
    for option in verb.options()
    for old in option.old
]


@pytest.mark.parametrize(
    ("verb", "option", "old"), FORMER, ids=[f"{verb} {old}" for verb, _, old in FORMER]
)
def test_a_former_option_is_accepted_with_a_note(verb, option, old):
    word, _, value = old.partition("=")
    required = [w for o in VERBS[verb].options() if o.required for w in (o.option, "x.npz")]
    args = parse(
        [
            *verb.split(),
            "elbow",
            *required,
            word,
            *(["1"] if option.takes_value and not value else []),
        ]
    )
    assert args.notes == [
        (
            f"{word} is the old name of {' '.join(filter(None, (option.option, value)))}, "
            "please use the new one"
        )
    ]
    assert option.parameter in args.given and (
        not value or getattr(args, option.parameter) == value
    )


def test_the_former_name_of_a_verb_is_accepted_with_a_note():
    args = parse(["path", "elbow", "--move", "line"])
    assert args.verb == "plan" and args.notes == [
        "path is the old name of plan, please use the new one"
    ]


def test_the_page_of_the_command_line_names_each_verb_once():
    page = Path(__file__).resolve().parents[2] / "docs" / "command_line.md"
    named = export_tables.verbs_of_table(page.read_text(encoding="utf-8"))
    assert sorted(named) == sorted({name.partition(" ")[0] for name in VERBS}), (
        "`make golden` writes a row for a new verb; remove those of verbs that are gone"
    )


PLANTED_MODULE = '''
def export_planted(model, path, *, digits: int = 7):
    """Write a name.

    Parameters
    ----------
    model : str
    path : str
    digits : int
        Of the name.
    """
    return f"{model} {path} {digits}"
'''
PLANTED_ROW = """registry.EXPORTS |= {
    "planted": registry.Export(
        "flexgen.exports.planted", "[planted](planted.md)", "Write a name.",
        {"files": ("digits", registry.Option("out", "write this file", "FILE", required=True))},
    ),
"""
USED = """
import sys
sys.path.append(sys.argv[1])
import flexgen, export_tables
from flexgen.cli.main import main
from flexgen.base.registry import EXPORTS
print(flexgen.export_planted("elbow", "elbow.txt"), "export_planted" in dir(flexgen))
print(export_tables.readme_table(EXPORTS), export_tables.command_row(EXPORTS))
main(["export", "planted", "--help"])
"""


def plant(folder: Path, room: str, module: str, rows: dict[str, str], used: str) -> str:
    """Output of a script run with a copy of the package that has one more module and changes in
    ``__init__.py``.
    """
    package = Path(flexgen.__file__).parent
    # Each folder down to the room is a copy, with links to its other entries.
    levels = ["", *(str(path) for path in reversed(Path(room).parents[:-1])), room]
    for level in levels:
        source = package / level
        copy = folder / "flexgen" / level
        copy.mkdir()
        for entry in source.iterdir():
            inner = entry.relative_to(package).as_posix()
            if entry.name not in ("__init__.py", "__pycache__") and inner not in levels:
                (copy / entry.name).symlink_to(entry)
        (copy / "__init__.py").write_text(
            (source / "__init__.py").read_text(encoding="utf-8"), encoding="utf-8"
        )
    front = folder / "flexgen" / "__init__.py"
    text = front.read_text(encoding="utf-8")
    for before, after in rows.items():
        assert before in text
        text = text.replace(before, after)
    front.write_text(text, encoding="utf-8")  # file 1
    (folder / "flexgen" / room / "planted.py").write_text(module, encoding="utf-8")  # file 2
    command = [sys.executable, "-c", used, str(Path(export_tables.__file__).parent)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


PLANTED_VERB = '''
from __future__ import annotations
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal
from pathlib import Path
from flexgen.model.elements import RobotModel
from flexgen.base.results import Result

@dataclass(frozen=True)
class Weight(Result):
    kg: float
    text: str

    @property
    def problem(self):
        return "too heavy" if self.kg > 100.0 else ""

def weigh(model: str | Path | RobotModel, load: float, *, factor: float = 2.0, parts: \
Sequence[str] = (),
          unit: Literal["kg", "g"] = "kg", round: bool = True, hook: Any = None, progress: Any = \
None) -> Weight:
    """Weigh a robot.

    Parameters
    ----------
    model : name, path or RobotModel
    load : float [kg]
        Of the `tool`.
    factor : float
        Of the load.
    unit : str
        Of the weight.
    """
    progress("weighing")
    return Weight(factor * load, f"{model.name} {unit} {round} {'+'.join(parts)}")
'''
WEIGHED = """
from flexgen.cli.main import main
main(["weigh", "--help"])
print(main("weigh elbow 3 --factor 4 --parts a,b --unit g --no-round --out w.json --json".split()))
print(open("w.json").read(), main("weigh elbow 300".split()), main("weigh elbow x".split()))
"""


def test_a_new_verb_and_its_command_need_a_module_and_rows_of_one_file(tmp_path):
    module = "flexgen.planning.fastest.planted"
    rows = {
        "_VERBS = {\n": f'_VERBS = {{\n    "weigh": "{module}",\n',
        "_NOUNS = {\n": f'_NOUNS = {{\n    "Weight": "{module}",\n',
        "_COMMANDS = (": '_COMMANDS = ("weigh", ',
    }
    out = plant(tmp_path, "planning/fastest", PLANTED_VERB, rows, WEIGHED)
    for found in (
        "Weigh a robot.",
        "of the tool [kg]",
        "of the load; default: 2",
        "--unit {kg,g}",
        "--no-round",
        "--report DIR",
        '"kg": 12.0,\n  "text": "elbow g False a+b",\n  "out": "w.json"\n}\n0\n',
        '"kg": 12.0,\n  "text": "elbow g False a+b"\n}\n 1 2\n',
    ):
        assert found in out
    assert "--hook" not in out and "--progress" not in out and "--model" not in out


def test_a_new_export_needs_its_module_and_its_row(tmp_path):
    out = plant(
        tmp_path, "exports", PLANTED_MODULE, {"registry.EXPORTS |= {\n": PLANTED_ROW}, USED
    )
    for found in (
        "elbow elbow.txt 7 True",
        (
            "| `planted` | `export_planted` | `planted.py` | Write a name | "
            "[planted](../../docs/planted.md) |"
        ),
        "writes the robot for another tool: `planted` ([planted](planted.md)), `fmu`",
        "usage: flexgen export planted",
        "of the name; default: 7",
    ):
        assert found in out


def test_choices_contain_the_default():
    for verb in VERBS.values():
        for option in verb.options():
            default = defaults_of(verb.function).get(option.parameter) if verb.function else None
            if choices_of(option) and default is not None:
                assert default in choices_of(option), (verb.name, option.name)


def test_a_planted_option_without_parameter_is_seen():
    colour = Option("colour", "of the table", "NAME")
    planted = Verb("check", function="check", rows={"files": (colour,)})
    assert without_parameter(planted) == ["colour"]


def restated_defaults(help_text: str, default: object) -> bool:
    """Whether a help states the number that is the default of the function, instead of
    ``{default}``.
    """
    stated = re.findall(r"default: ([-+.\de]+)(?=[;,. ]|$)", help_text)
    return isinstance(default, int | float) and any(
        float(text.rstrip(".")) == default for text in stated
    )


def test_no_help_states_the_default_of_the_function_again():
    for verb in VERBS.values():
        defaults = defaults_of(verb.function) if verb.function else {}
        again = [
            x.name for x in verb.options() if restated_defaults(x.help, defaults.get(x.parameter))
        ]
        assert again == [], verb.name
    assert restated_defaults("sample time [s]; default: 0.001", 1e-3)
    assert not restated_defaults("sample time [s]; default: {default}", 1e-3)
    assert not restated_defaults("sample time [s]; default: 0.001", None)
