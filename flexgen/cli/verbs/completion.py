"""The verb ``completion``: scripts that complete the command line in bash, zsh and fish, made from
the parser.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator
from typing import Any

FILES = ("FILE", "DIR", "GRID", "TRAJECTORY")  # placeholders of arguments that are paths


def completion(args: argparse.Namespace, log: Callable[[str], None]) -> Any:
    """Print a script that completes verbs, options and models in a shell."""
    from flexgen.cli.result import VerbResult
    from flexgen.model.catalogue.catalogue import models

    names = [str(row["name"]) for row in models({})]
    script = {"bash": bash, "zsh": zsh, "fish": fish}[args.shell](args.root, names)
    return VerbResult({"shell": args.shell, "script": script}, script.rstrip("\n"))


def verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """The parsers of the verbs by name."""
    (group,) = (
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    )
    return dict(group.choices)


def _options(parser: argparse.ArgumentParser) -> Iterator[tuple[str, argparse.Action]]:
    """The long options of a verb with their actions."""
    for action in parser._actions:
        for word in action.option_strings:
            if word.startswith("--") and action.help != argparse.SUPPRESS:
                yield word, action


def _help(action: argparse.Action) -> str:
    """First words of the help of an option, without quotes."""
    text = re.split(r"[;:,(]", (action.help or "").replace("%%", "%"))[0]
    return re.sub(r"['\"`$\\\[\]]", "", text).strip()


def _words(parser: argparse.ArgumentParser, models: list[str]) -> list[str]:
    """Words that the positional argument of a verb may be, without files."""
    for action in parser._actions:
        if action.option_strings:
            continue
        return (
            list(models)
            if action.dest == "model"
            else [str(choice) for choice in action.choices or ()]
        )
    return []


def _values(parser: argparse.ArgumentParser) -> dict[str, list[str]]:
    """Words that may follow an option, by option; an empty list: a path."""
    found = {}
    for word, action in _options(parser):
        if action.choices:
            found[word] = [str(choice) for choice in action.choices]
        elif action.metavar in FILES:
            found[word] = []
    return found


def bash(parser: argparse.ArgumentParser, models: list[str]) -> str:
    """The script for bash."""
    cases = []
    for name, verb in verbs(parser).items():
        inner = [
            f"            {word}) "
            + (
                f'COMPREPLY=($(compgen -W "{" ".join(words)}" -- "$word")); '
                if words
                else "COMPREPLY=(); "
            )
            + "return ;;"
            for word, words in _values(verb).items()
        ]
        options = " ".join(word for word, _ in _options(verb))
        lines = [f"    {name})", '        case "$before" in', *inner, "        esac"]
        lines += [f'        options="{options}"; words="{" ".join(_words(verb, models))}" ;;']
        cases.append("\n".join(lines))
    return f"""# Completion of flexgen for bash. Use: source <(flexgen completion bash)
_flexgen() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" options="" \
words=""
    COMPREPLY=()
    if [ "$COMP_CWORD" -eq 1 ]; then
        COMPREPLY=($(compgen -W "{" ".join(verbs(parser))} --help --version" -- "$word"))
        return
    fi
    case "${{COMP_WORDS[1]}}" in
{chr(10).join(cases)}
    esac
    case "$word" in
        -*) COMPREPLY=($(compgen -W "$options" -- "$word")) ;;
        *) COMPREPLY=($(compgen -W "$words" -- "$word")) ;;
    esac
}}
complete -o default -F _flexgen flexgen
"""


def zsh(parser: argparse.ArgumentParser, models: list[str]) -> str:
    """The script for zsh."""
    cases = []
    for name, verb in verbs(parser).items():
        values = _values(verb)
        specs = []
        for word, action in _options(verb):
            spec = f"{word}[{_help(action)}]"
            if word in values:
                spec += f":value:({' '.join(values[word])})" if values[word] else ":file:_files"
            elif action.nargs != 0:
                spec += ":value: "
            specs.append(f"'{spec}'")
        words = _words(verb, models)
        if words:
            specs.append(
                "'1:model:_flexgen_models'" if words == models else f"'1:word:({' '.join(words)})'"
            )
        cases.append(f"        {name}) _arguments {' '.join(specs)} '*:file:_files' ;;")
    listed = " ".join(f"'{name}:{_help_of(verb)}'" for name, verb in verbs(parser).items())
    return f"""#compdef flexgen
# Completion of flexgen for zsh. Use: flexgen completion zsh > a file _flexgen in a folder of \
$fpath
_flexgen_models() {{
    _alternative 'names:model:({" ".join(models)})' 'files:file:_files'
}}
_flexgen() {{
    local -a verbs=({listed})
    if (( CURRENT == 2 )); then
        _describe 'verb' verbs
        return
    fi
    local verb="$words[2]"
    shift words
    (( CURRENT-- ))
    case "$verb" in
{chr(10).join(cases)}
    esac
}}
if [ "$funcstack[1]" = "_flexgen" ]; then _flexgen "$@"; else compdef _flexgen flexgen; fi
"""


def fish(parser: argparse.ArgumentParser, models: list[str]) -> str:
    """The script for fish."""
    lines = [
        (
            "# Completion of flexgen for fish. Use: flexgen completion fish > "
            "~/.config/fish/completions/flexgen.fish"
        ),
    ]
    for name, verb in verbs(parser).items():
        lines.append(
            f"complete -c flexgen -n __fish_use_subcommand -f -a {name} -d '{_help_of(verb)}'"
        )
        here = f"complete -c flexgen -n '__fish_seen_subcommand_from {name}'"
        values = _values(verb)
        for word, action in _options(verb):
            line = f"{here} -l {word[2:]} -d '{_help(action)}'"
            if action.nargs != 0:
                line += " -r" + (f" -f -a '{' '.join(values[word])}'" if values.get(word) else "")
            lines.append(line)
        words = _words(verb, models)
        if words:
            lines.append(f"{here} -a '{' '.join(words)}'")
    return "\n".join(lines) + "\n"


def _help_of(parser: argparse.ArgumentParser) -> str:
    """First words of the description of a verb, without quotes."""
    return (
        re.sub(r"['\"`$\\\[\]:]", "", (parser.description or "").partition(":")[0])
        .strip()
        .rstrip(".")
    )
