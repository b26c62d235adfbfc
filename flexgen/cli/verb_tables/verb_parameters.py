"""Options of the command line from the parameters of public functions: type, default and allowed
values from the annotation, the help from the first sentence of the docstring.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from flexgen.base.registry import Option, Sections
from flexgen.cli.verb_tables.signature_source import (
    Parameter,
    constant,
    defaults_of,
    definition,
    public_names,
    signature_of,
)

LEFT_OUT = ("model", "progress")  # read and given by the command line
FILES = (
    Option("out", "write the result to this file", "FILE"),
    Option("report", "write a self-contained HTML page to DIR", "DIR"),
)


class Form(NamedTuple):
    """The text of a value of a type on the command line.

    ``kind``: the function of `flexgen.cli.argument_types` that reads it; ``text``: what the help
    says of it, after the help of the parameter; ``file``: the whole help, of a file that an action
    reads; ``choices``: the list of its words in `flexgen.cli.verb_tables.verb_texts`, where these
    are not in the annotation.
    """

    metavar: str
    kind: str = ""
    text: str = ""
    several: bool = False
    choices: tuple[str, ...] = ()
    file: str = ""


_FORCE = "np.ndarray | Callable[[np.ndarray], np.ndarray] | "
_CHANGES = ": {FACTORS}; such as "
# By the annotation of a parameter without None, or by the name of a type in it.
FORMS = {
    "bool": Form(""),
    "int": Form("N", "integer"),
    "float": Form("X", "number"),
    "str": Form("TEXT", "text"),
    "str | Path": Form("FILE"),
    "str | Move": Form("NAME", "text"),
    "np.ndarray": Form("X ...", "numbers"),
    "Sequence[float]": Form("X ...", "numbers"),
    "Sequence[int]": Form("N ...", "integers"),
    "Sequence[str]": Form("NAME,NAME,...", "names"),
    "str | Sequence[str]": Form("NAME,NAME,...", "names"),
    "TimeLimit": Form("SECONDS", "not_negative"),
    "MethodName": Form("NAME", text=": {METHODS}", choices=("METHODS",)),
    "IsaName": Form("ISA", "isa"),
    "TargetName": Form("NAME", text=": {choices}"),
    "Trajectory | str | Path": Form("TRAJECTORY"),
    "Mapping[str, np.ndarray] | str | Path": Form("FILE"),
    "Sequence[Mapping[str, np.ndarray] | str | Path]": Form("FILE,FILE,...", "names"),
    "ServoRecord | str | Path": Form("DATA"),
    "StaticPoses | str | Path": Form("DATA"),
    "Records | str | Path": Form("FOLDER"),
}
# Of objects that an action makes of the text: they need a row.
OBJECTS = {
    # objects of flexgen, from files
    "Trajectory": Form("TRAJECTORY", file="file written by 'flexgen solve --out'"),
    "Plan": Form("PLAN", file="file written by 'flexgen excite'"),
    "Experiment": Form(
        "EXPERIMENT",
        file="file written by 'flexgen measure', or a .toml file that describes recordings",
    ),
    "Frf": Form("DATA", file="file written by 'flexgen frf'"),
    "Sequence[Frf]": Form("FRF", text=" (files of 'flexgen frf'); may be repeated", several=True),
    "Grid": Form("GRID", file="TOML file with models, moves, methods and parameters"),
    # what a text describes
    "Any": Form("NAME", "text"),  # a controller or a servo
    f"{_FORCE}Trajectory | str | Path": Form("FILE"),
    f"{_FORCE}str | Path": Form("FILE"),
    f"float | {_FORCE}Trajectory | str | Path": Form("FACTOR", "factor_or_file"),
    "float | str": Form("POWER", "spectrum"),
    "Wall": Form(
        "PLACE",
        "wall",
        ", X,Y,Z:NX,NY,NZ:K[:C[:GAP]]: point [m], normal towards the tool, stiffness [N/m], "
        "damping [N s/m], gap [m]; such as 1.2,0,0:-1,0,0:1e5:500",
    ),
    "Sequence[Box]": Form(
        "X,Y,Z:X,Y,Z",
        "box",
        ": lower and upper corner [m], such as -inf,-inf,-inf:inf,inf,0 for a floor; may be "
        "repeated",
        several=True,
    ),
    "Mapping[str, Mapping[str, float]]": Form(
        "NAME:KEY=X,...",
        "plant",
        f"{_CHANGES}soft:stiffness=0.8,payload=5; may be repeated",
        several=True,
    ),
    "PlantChanges": Form("KEY=X,...", "changes", f"{_CHANGES}stiffness=0.8,payload=5"),
    "Iterable[Disturbance] | Mapping[str, Iterable[Disturbance]]": Form(
        "KIND:WHERE=SIZE@START+LENGTH",
        "disturbance",
        ": step, pulse, ramp, chirp or noise on a motor [N m] or on the tool (tool.x [N], "
        "tool.rz [N m], world axes), times in s; chirp and noise: ,LOW-HIGH in Hz; such as "
        "pulse:tool.x=300@0.4+0.02; may be repeated",
        several=True,
    ),
    "dict[str, float]": Form("NAME=X", "joint_value", "; may be repeated", several=True),
    "Mapping[str, float]": Form("NAME=VALUE", "setting", "; may be repeated", several=True),
}
ALL_FORMS = FORMS | OBJECTS
# Placeholders of one number with a unit.
UNITS = {"[s]": "S", "[Hz]": "HZ", "[rad]": "RAD", "[m]": "M", "[dB]": "DB", "[deg]": "DEG"}


def options_of(function: str, rows: Sections | None) -> dict[str, list[Option]]:
    """The options of a verb by the titles of their sections.

    Parameters
    ----------
    function : str
        The public function of the verb; empty: none.
    rows : mapping of str to sequences of str or Option, optional
        A text is the name of a parameter. Default: all parameters that a text can be the value
        of, and the files of the result.
    """
    if rows is None:
        return _all_options(function)
    return {
        title: [
            _complete(function, Option(row) if isinstance(row, str) else row, title)
            for row in section
        ]
        for title, section in rows.items()
    }


def _all_options(function: str) -> dict[str, list[Option]]:
    """Options of all parameters: without a default they are positional arguments.

    Raises
    ------
    ValueError
        A parameter without default has an annotation that is not in `FORMS`.
    """
    signature = signature_of(function)
    sections: dict[str, list[Option]] = {}
    for name, parameter in signature.parameters.items():
        is_needed = parameter.default is None
        title = "arguments" if is_needed else "settings"
        form = form_of(signature.module, parameter.annotation, FORMS)
        if form is None and is_needed and name not in LEFT_OUT:
            raise ValueError(
                f"{function}: parameter {name} cannot be given as a text, expected a row in "
                "verbs.py"
            )
        if form is None or name in LEFT_OUT:
            continue
        off = "no_" if defaults_of(function).get(name) is True else ""
        sections.setdefault(title, []).append(_complete(function, Option(off + name), title))
    if signature.returns in public_names() and "out" not in signature.parameters:
        sections["files"] = list(FILES)
    return sections


def _complete(function: str, row: Option, title: str) -> Option:
    """An option with what the parameter says; as it is, where it has a help of its own.

    Raises
    ------
    ValueError
        There is no such parameter, or a text cannot be its value.
    """
    owner, _, name = row.of.rpartition(".")
    owner = owner or function
    name = name or row.name
    if not owner or (row.help and not row.of):
        return row
    signature = signature_of(owner)
    parameters = signature.parameters
    off = name not in parameters and name.startswith("no_")
    parameter = parameters.get(name.removeprefix("no_") if off else name)
    if parameter is None:
        raise ValueError(
            f"row of an option: given {name!r}, no parameter of {owner}, expected one, or a help"
        )
    form = form_of(signature.module, parameter.annotation)
    if form is None:
        raise ValueError(
            f"{owner}: parameter {name} cannot be given as a text, expected a row with its help"
        )
    described = _refer(name, parameter)
    metavar = form.metavar
    if metavar == "X":
        metavar = UNITS.get(described.unit, metavar)
    default = defaults_of(owner).get(name)
    text = row.help or help_text(described, form, row.more, default, off=off)
    if row.of and owner != function and default is not None:
        text = text.replace("{default}", show_default(default))
    if form.choices and not all(re.search(rf"\b{x}\b", text) for x in form.choices):
        metavar = ""  # the usage lists them
    if "METHODS" in form.choices:
        metavar = form.metavar
    return row._replace(
        help=text,
        metavar=metavar if row.metavar is None else row.metavar,
        kind=form.kind,
        choices=form.choices,
        several=row.several or form.several,
        place=row.place or (title == "arguments" and parameter.default is None),
    )


def _refer(name: str, parameter: Parameter) -> Parameter:
    """A parameter, or that of another public function which its description refers to."""
    found = re.match(r"As (?:for|of) `(?:flexgen\.)?(\w+)`", parameter.text)
    return parameter if found is None else signature_of(found[1]).parameters[name]


def show_default(value: Any) -> str:
    """A default as the help shows it."""
    return f"{value:g}" if isinstance(value, float) else str(value)


# --- help ----------------------------------------------------------------------------------------
def help_text(
    parameter: Parameter, form: Form, more: str, default: Any, *, off: bool = False
) -> str:
    """The help of an option: the first sentence about a parameter, with unit and default.

    Parameters
    ----------
    parameter : Parameter
    form : Form
        Of its value.
    more : str
        What the command line says more.
    default : object
        Of the function; a number or a text is stated, unless the sentence does it.
    off : bool
        The option switches the parameter off: what follows ``False:`` in the description.
    """
    if form.file:
        return form.file + more
    if off:
        found = re.search(r"\bFalse: (.*)", parameter.text)
        return _sentence(found[1]) if found is not None else f"not: {_sentence(parameter.text)}"
    head, *tail = re.split(r"; (?=default|\d)", _sentence(parameter.text), maxsplit=1)
    head = _with_unit(head, parameter.unit) if head else ""
    ends = "; may be repeated"
    shown = form.text.removesuffix(ends).replace("{choices}", ", ".join(form.choices))
    head += shown + ("" if more.startswith(";") else more)
    is_stated = "default" in " ".join([head, *(tail if tail[:1] != ["0"] else [])])
    if isinstance(default, int | float | str) and not isinstance(default, bool) and not is_stated:
        tail.insert(0, "default: {default}")
    text = "; ".join([head, *tail])
    text += more if more.startswith(";") else ""
    return text + (ends if form.text.endswith(ends) else "")


def _sentence(text: str) -> str:
    """The first sentence of a description as a help: without markup, small first letter, without
    the period.
    """
    text = re.split(r"(?<=\.)\s+(?=[A-Z0-9`\"(\[])", text, maxsplit=1)[0]
    text = re.sub(r'``"([^"`]*)"``', r"\1", text).replace("`", "")
    if not text.endswith("..."):
        text = text.removesuffix(".")
    is_word = re.match(r"[A-Z]([a-z]|-[a-z]| )", text) is not None
    return text[:1].lower() + text[1:] if is_word else text


def _with_unit(text: str, unit: str) -> str:
    """A sentence with its unit, behind its first clause; as it is where it has one."""
    if not unit or "[" in text:
        return text
    end = re.search(r"[;:]|, such as|$", text)
    at = len(text) if end is None else end.start()
    return f"{text[:at]} {unit}{text[at:]}"


# --- forms of annotations ------------------------------------------------------------------------
def form_of(
    module: str, annotation: ast.expr | None, forms: Mapping[str, Form] = ALL_FORMS
) -> Form | None:
    """Form by which a text of the command line becomes a value of an annotation.

    The form of the whole union, if ``forms`` has it, else that of its first part that has one.
    None: no text can be such a value. ``module``: where the names of the annotation are defined.
    """
    if annotation is None:
        return None
    parts = [*_parts(module, annotation)]
    whole = " | ".join(_words(part) for _, part in parts)
    if len(parts) > 1 and whole in forms:
        return forms[whole]
    for place, part in parts:
        found = _form_of_part(place, part, forms)
        if found is not None:
            return found
    return None


def _form_of_part(module: str, part: ast.expr, forms: Mapping[str, Form]) -> Form | None:
    """The form of values of one type of a union."""
    words = _words(part)
    form = forms.get(words)
    resolved = definition(module, part)
    if isinstance(part, ast.Subscript) and _words(part.value) == "Literal":
        choices = ast.literal_eval(part.slice)
        choices = choices if isinstance(choices, tuple) else (choices,)
        is_text = all(isinstance(choice, str) for choice in choices)
        return Form("NAME", choices=choices) if is_text else None
    if isinstance(part, ast.Subscript) and _words(part.value) == "Annotated":
        return _form_of_number(module, part.slice)
    if form is not None and (form.kind or form.choices or resolved is None):
        return form
    if resolved is None:
        return form
    inner = form_of(*resolved, forms)
    if form is None or inner is None:
        return form or inner
    return form._replace(choices=inner.choices)


def _form_of_number(module: str, inner: ast.expr) -> Form | None:
    """The form of a number from the words ``kind, Bound(...)`` in its annotation: whole from the
    least one, positive, or not negative.
    """
    if not isinstance(inner, ast.Tuple):
        return None
    kind, bound = inner.elts[:2]
    if not isinstance(bound, ast.Call):
        return form_of(module, kind)
    least = constant(module, bound.args[0])
    if _words(kind) == "int":
        return Form("N", f"whole {least}")
    is_excluded = any(
        word.arg == "excluded" and ast.literal_eval(word.value) for word in bound.keywords
    )
    return Form("X", "positive" if is_excluded or least > 0 else "not_negative")


def _parts(module: str, annotation: ast.expr) -> Iterator[tuple[str, ast.expr]]:
    """The types of a union but None, with the module in which each is written."""
    if isinstance(annotation, ast.BinOp):
        yield from _parts(module, annotation.left)
        yield from _parts(module, annotation.right)
    elif ast.unparse(annotation) != "None":
        yield module, annotation


def _words(annotation: ast.expr) -> str:
    """An annotation as text; paths have one name."""
    return ast.unparse(annotation).replace("FilePath", "Path")
