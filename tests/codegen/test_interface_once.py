"""Numbers of statuses and limits, members of enums and defaults of options of the C interface are
stated once.
"""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import get_args

import pytest
from emitted import ROOT

from flexgen.codegen.emission.interface import ENUMS, LIMITS, STATUSES, STRUCTS
from flexgen.runtime import identity
from flexgen.runtime.inversion.limited_inversion import LimitedInverter
from flexgen.runtime.inversion.path_inversion import Inversion, Inverter, tolerance_of
from flexgen.runtime.streams.stream import Interval, Stream
from flexgen.simulation.integration.hold_names import HoldName

SOURCE = ROOT / "flexgen"
ROWS = SOURCE / "codegen" / "emission" / "interface.py"
# numbers that C and Python have
OF_RUNTIME = ("CONFIGURATIONS_MAX", "STARTS", "STARTS_MAX", "TOLERANCES")
NUMBERS = {status.name: status.code for status in STATUSES} | {
    limit.name: limit.value for limit in LIMITS
}
NUMBERS |= {name: getattr(identity, name) for name in OF_RUNTIME}
CODES = {status.code for status in STATUSES if status.code}
MEMBERS = {frozenset(enum.names): enum.name for enum in ENUMS}
# of the simulation, for type checkers; compared below
OWN_NAMES = SOURCE / "simulation" / "integration" / "hold_names.py"


def _value(node: ast.expr | None) -> object:
    """The number or table that an expression is; None for something else."""
    try:
        value = ast.literal_eval(node) if node is not None else None
    except ValueError:
        return None
    return value if type(value) in (int, dict) else None


def _assigned(node: ast.AST) -> Iterable[tuple[ast.expr, ast.expr | None]]:
    """Names and values of an assignment."""
    if isinstance(node, ast.AnnAssign):
        yield node.target, node.value
    for target in node.targets if isinstance(node, ast.Assign) else ():
        if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
            yield from zip(target.elts, node.value.elts, strict=False)
        yield target, node.value  # type: ignore[attr-defined]


def _compared(node: ast.AST) -> Iterable[str]:
    """The numbers that a status is compared with."""
    if isinstance(node, ast.Compare):
        for other in node.comparators:
            for entry in (
                other.elts if isinstance(other, ast.Tuple | ast.Set | ast.List) else [other]
            ):
                value = _value(entry)
                if (
                    isinstance(value, int)
                    and value in CODES
                    and "status" in ast.unparse(node.left)
                ):
                    yield f"status {ast.unparse(entry)}"


def restated(text: str) -> list[str]:
    """Names that are given the number of a status or limit, statuses compared with numbers,
    members of an enum.
    """
    found = []
    for node in ast.walk(ast.parse(text)):
        for target, value in _assigned(node):
            name = target.id.lstrip("_") if isinstance(target, ast.Name) else ""
            if name in NUMBERS and _value(value) == NUMBERS[name]:
                found.append(name)
        found += _compared(node)
        entries = node.elts if isinstance(node, ast.Tuple | ast.List | ast.Set) else []
        entries = [*node.keys] if isinstance(node, ast.Dict) else entries
        words = [entry.value for entry in entries if isinstance(entry, ast.Constant)]
        if words and len(words) == len(entries) and all(isinstance(word, str) for word in words):
            found += [MEMBERS[frozenset(words)]] if frozenset(words) in MEMBERS else []
    return found


@pytest.mark.slow
def test_no_module_states_a_number_or_the_members_of_an_enum_again():
    modules = [
        path
        for path in SOURCE.rglob("*.py")
        if path not in (ROWS, OWN_NAMES, Path(identity.__file__))
    ]
    again = {
        str(path.relative_to(SOURCE)): restated(path.read_text(encoding="utf-8"))
        for path in modules
    }
    # what Python calls them, by the names of the members
    assert again.pop("runtime/streams/stream.py") == ["cause"]
    # for type checkers, and the formula of each
    assert again.pop("feedback/positions/samples.py") == ["interpolation"] * 2
    assert {name: found for name, found in again.items() if found} == {}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("_LIMITS_INFEASIBLE = -14", ["LIMITS_INFEASIBLE"]),
        ("LIMITS_ACTIVE: int = 2", ["LIMITS_ACTIVE"]),
        ('HOLDS = ("spline", "linear", "zoh")', ["hold"]),
        ('names = {"linear": 1, "spline": 0, "zoh": 2}', ["hold"]),
        ("HOLD_DELAY_MAX = 4", ["HOLD_DELAY_MAX"]),
        ("CONFIGURATIONS_MAX, STARTS = 16, 1536", ["CONFIGURATIONS_MAX", "STARTS"]),
        ('TOLERANCES = {"double": 1e-6, "single": 1e-3}', ["TOLERANCES"]),
        ("if status == -14:\n    pass", ["status -14"]),
        ("ok = self.status in (0, 2)", ["status 2"]),
        ("failed = status < 0 or status == len(x)", []),
        ('OK, HOLDS = 5, ("zoh", "none")', []),
    ],
)
def test_a_planted_second_statement_is_found(text, found):
    assert restated(text) == found


def test_the_simulation_has_the_holds_of_the_c_interface():
    (hold,) = (enum for enum in ENUMS if enum.name == "hold")
    assert get_args(HoldName) == hold.names


# --- defaults and names of options and results ---------------------------------------------------

FIELDS = {struct.name: {field.name: field for field in struct.fields} for struct in STRUCTS}
CALLS = {
    "inversion_options": (Inverter.__call__, LimitedInverter.__call__),
    "inversion_limits": (LimitedInverter.__call__,),
    "stream_options": (Stream.__init__,),
}
# of the limits: an array of the caller, and the size of one
OWN = {"deviation", "torque_speed_points"}
NOT_OPTIONS = {
    "y",
    "dy",
    "ddy",
    "force",
    "period",
    "q_start",
    "parameters",
    "servo",
    "self",
    "sizes",
    "entries",
}


def different_options(struct: str, parameters: Mapping[str, inspect.Parameter]) -> list[str]:
    """Members of options whose parameter in Python is missing or has another default."""
    found = []
    for name, field in FIELDS[struct].items():
        parameter = parameters.get(name)
        expected = {"HOLD_SPLINE": "spline", "tolerance": "None"}.get(field.default, field.default)
        expected = (
            "False"
            if parameter is not None and parameter.default is False and expected == "0"
            else expected
        )
        if parameter is None:
            found += [name] if name not in OWN else []
        elif (
            expected and not expected.startswith("STREAM_") and str(parameter.default) != expected
        ):
            found.append(f"{name} = {parameter.default}, in C {expected}")
    return found


@pytest.mark.parametrize("struct", CALLS)
def test_options_in_python_are_those_of_the_c_struct_with_its_defaults(struct):
    for function in CALLS[struct]:
        parameters = inspect.signature(function).parameters
        assert different_options(struct, parameters) == []
        documented = (
            FIELDS["inversion_options"] | FIELDS["inversion_limits"] | FIELDS["stream_options"]
        )
        assert set(parameters) - NOT_OPTIONS <= set(documented)
    assert different_options(struct, {}) == [name for name in FIELDS[struct] if name not in OWN]


def test_a_planted_default_is_found():
    def planted(samples_per_interval: int = 2, delay: float = 0.0) -> None: ...

    found = different_options("inversion_options", inspect.signature(planted).parameters)
    assert "samples_per_interval = 2, in C 1" in found and not any(
        text.startswith("delay") for text in found
    )


@pytest.mark.parametrize(
    ("result", "structs"),
    [
        (Inversion, ("invert_info", "bvp_info", "invert_limited_info")),
        (Interval, ("stream_info",)),
    ],
)
def test_results_in_python_have_all_members_that_c_reports(result, structs):
    text = inspect.getdoc(result) or ""
    for name in (name for struct in structs for name in FIELDS[struct]):
        assert name in result.__dataclass_fields__ and name in text, name


def test_tolerances_of_the_runtime_are_those_of_the_rows():
    assert {
        kind: tolerance_of(identity.REALS[kind]) for kind in identity.REALS
    } == identity.TOLERANCES
