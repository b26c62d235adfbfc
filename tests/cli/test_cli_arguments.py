"""Arguments of all verbs: numbers, names of outputs, sections of the help, hints."""

from __future__ import annotations

import argparse
import json

import pytest

from flexgen.cli.argument_types import numbers, toml_file
from flexgen.cli.main import main
from flexgen.cli.parser import UsageError, build_parser, parse
from flexgen.cli.result import VerbResult

PARSER = build_parser()
VERBS = {" ".join(verb.prog.split()[1:]): verb for verb in PARSER.verbs()}
VALUES = [
    (verb, action)
    for verb, parser in VERBS.items()
    for action in parser._actions
    if action.option_strings and action.nargs is None and action.help != argparse.SUPPRESS
]


def words_of(verb: str, *options: str) -> list[str]:
    """A command line of a verb with words for all that it requires."""
    required = [action for action in VERBS[verb]._actions if action.required]
    options_ = [action for action in required if action.option_strings]
    files = {a.option_strings[0]: "x.toml" if a.type is toml_file else "x.npz" for a in options_}
    words = [word for pair in files.items() for word in pair]
    places = [
        str(next(iter(action.choices))) if action.choices else "x"
        for action in required
        if not action.option_strings
    ]
    return [*verb.split(), *places, *words, *options]


@pytest.mark.parametrize("text", ["-1e-3", "-.5", "-3", "-1E6,2", "-inf", "-nan"])
def test_a_negative_number_is_a_value_of_each_option(text):
    assert len(VALUES) > 80
    for verb, action in VALUES:
        try:
            PARSER.parse_known_args(words_of(verb, action.option_strings[-1], text))
        except UsageError as error:  # refused by its type, with a sentence
            assert f"given {text!r}, expected " in str(error) or "given twice" in str(error), (
                verb,
                action.dest,
                error,
            )


def test_noise_below_zero_is_refused_by_its_range():
    with pytest.raises(
        UsageError, match=r"--encoder-noise: given '-1e-3', expected a number >= 0"
    ):
        parse(["control", "elbow", "--encoder-noise", "-1e-3"])


@pytest.mark.parametrize(
    "several", [["-20.5", "1e1", "-.5"], ["-20.5,1e1,-.5"], ["-20.5,", "1e1,", "-.5"]]
)
def test_options_of_several_numbers_take_them_with_spaces_or_commas(several):
    options = [(verb, action) for verb, action in VALUES if action.type is numbers]
    assert {action.dest for _, action in options} >= {
        "pose",
        "torque",
        "speed",
        "joints",
        "position",
        "rotation",
    }
    for verb, action in options:
        option = action.option_strings[0]
        places = VERBS[verb]._positionals._group_actions
        model = places[0].dest
        given = ["x"] * len(places)
        for words in (
            [option, *several, *given],
            [*given, option, *several],
            [*given, f"{option}={several[0]}", *several[1:]],
        ):
            args = PARSER.parse_args([*verb.split(), *words])
            assert (
                getattr(args, action.dest) == [-20.5, 10.0, -0.5] and getattr(args, model) == "x"
            )


@pytest.mark.parametrize("verb", VERBS)
def test_the_result_of_each_verb_goes_to_out(verb):
    shown = VERBS[verb].options()
    assert not {"--directory", "--output", "--table"} & {
        word for word in shown if "--out" not in shown
    }


@pytest.mark.parametrize(
    "verb",
    [verb for verb, parser in VERBS.items() if "--directory" in parser._option_string_actions],
)
def test_the_old_name_of_out_is_accepted_with_a_warning(verb, monkeypatch, capsys, tmp_path):
    seen = []
    parser = build_parser()
    words = [*words_of(verb, "--directory", str(tmp_path)), "--json"]
    monkeypatch.setattr("flexgen.cli.parser.parse", lambda words: with_action(parse(words), seen))
    assert "--out" in VERBS[verb].options() and "--directory" not in parser.format_help()
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert seen == [tmp_path] and json.loads(out) == {}
    assert (
        err == "flexgen: warning: --directory is the old name of --out, please use the new one\n"
    )
    with pytest.raises(UsageError, match="given twice"):
        parse([*words, "--out", "other"])


def with_action(args, seen):
    """The arguments, with an action that records the folder."""

    def record(given, log):
        seen.append(given.out)
        return VerbResult({}, "")

    args.action = record
    return args


@pytest.mark.parametrize("verb", VERBS)
def test_each_option_is_in_a_named_section_of_the_help(verb):
    sections = [group for group in VERBS[verb]._action_groups if group._group_actions]
    titles = [group.title for group in sections]
    shown = [
        a.dest
        for group in sections
        if group.title == "options"
        for a in group._group_actions
        if a.help != argparse.SUPPRESS
    ]
    assert not shown and titles[-1] == "messages"
    assert all(len(group._group_actions) <= 10 for group in sections)
    if "files" in titles:
        assert titles[-2] == "files"


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["solve", "elbow", "--mesh", "0.01", "0.02"], "; --mesh takes one number"),
        (
            ["solve", "elbow", "--plant", "soft:stiffness=0.8"],
            "; --plant is an option of 'flexgen control', 'flexgen learn'",
        ),
        (["generate", "elbow", "--ouy", "x"], "; did you mean '--out'?"),
        (["fastest", "elbow", "--torque", "a"], "expected numbers such as"),
        (
            ["solve", "elbow", "--mesh", "fine"],
            "given 'fine', expected a number > 0, such as 0.01",
        ),
        (["control", "elbow", "--seed", "1.5"], "given '1.5', expected an integer >= 0"),
        (["generate", "elbow", "--out", "a", "--out", "b"], "given twice (a and b), expected one"),
    ],
)
def test_a_wrong_argument_gets_a_hint_that_fits(words, hint):
    with pytest.raises(UsageError) as caught:
        parse(words)
    assert hint in str(caught.value).partition("\n")[0]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "identify elbow x.npz --rigid --starts 5",
            "--rigid: given with --starts, expected without",
        ),
        (
            "identify elbow x.npz --rigid --residual lls --report r",
            "--rigid: given with --residual, --report, expected",
        ),
        (
            "identify elbow x.npz --segments 1 --free a --floor 0.1",
            "--segments: given with --floor, expected without",
        ),
        ("identify elbow x.npz --truth elbow", "--truth: given without --move"),
        (
            "kinematics manutec_r3 --joints 0 0 0 0 0 0 --rotation 1 2 3",
            "--joints: given with --rotation",
        ),
        (
            "solve elbow --no-verify --accuracy 1e-9",
            "--no-verify: given with --accuracy, expected without",
        ),
    ],
)
def test_options_without_effect_are_refused(words, message, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main([*words.split(), "-q"]) == 1
    assert message in capsys.readouterr().err and not list(tmp_path.iterdir())


def test_a_method_names_arguments_that_it_does_not_use(capsys):
    assert (
        main(
            ["solve", "elbow", "--mesh", "0.01", "--preview", "0.2", "--json", "-q", "--no-verify"]
        )
        == 0
    )
    warnings = json.loads(capsys.readouterr().out)["warnings"]
    assert [text.split(",")[0] for text in warnings] == [
        "preview: given 0.2 s",
        "mesh: given 0.01 s",
    ]
    assert all("no effect: method closed-form" in text for text in warnings)
