"""MATLAB and Simulink have the functions of one point that the header of the library declares."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flexgen.exports.c_code.emitted import emit
from flexgen.exports.c_code.mex.export import export_mex
from flexgen.exports.c_code.selftest.export import export_selftest
from flexgen.exports.c_code.simulink.export import export_simulink

# Files of the package of MATLAB of other functions: a path, a stream, options.
OF_PATHS = {"invert", "Stream", "options_"}


def declared(header: str) -> set[str]:
    """Functions of one point, by name: their first argument is an array of a fixed size."""
    first = r"const elbow_real \w+\[ELBOW_N[AGM]\]"
    return set(re.findall(rf"^elbow_status elbow_(\w+)\({first}", header, re.MULTILINE))


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exports")
    export_mex("elbow", folder / "mex")
    export_simulink("elbow", folder / "simulink")
    return folder


def test_matlab_and_simulink_have_the_functions_of_the_header(exported: Path) -> None:
    names = {path.stem for path in (exported / "mex" / "+elbow").glob("*.m")}
    header = (exported / "simulink" / "elbow_ccaller.h").read_text(encoding="ascii")
    blocks = set(re.findall(r"\bint elbow_ccaller_(\w+)\(", header))
    functions = declared((exported / "mex" / "elbow.h").read_text(encoding="ascii"))
    assert {"inverse_dynamics", "forward_kinematics"} <= functions
    assert functions == declared((exported / "simulink" / "elbow.h").read_text(encoding="ascii"))
    assert names - OF_PATHS == functions
    assert blocks == functions


def test_functions_of_matlab_have_their_equations_as_help(exported: Path) -> None:
    manifest = {row["name"]: row for row in emit("elbow").functions}
    for path in (exported / "mex" / "+elbow").glob("*.m"):
        equation = manifest.get(path.stem, {}).get("equation")
        if equation:
            words = path.read_text(encoding="utf-8").replace("%", " ").split()
            assert " ".join(equation.split()) in " ".join(words), path


def test_matlab_has_paths_and_streams(exported: Path) -> None:
    files = {path.stem for path in (exported / "mex" / "+elbow").glob("*.m")}
    assert files >= OF_PATHS


ARRAY = r"(given|expected)_\w+(?:\[[^]]*\])+ = \{(.*?)\};"


@pytest.mark.parametrize("precision", ["double", "single"])
def test_states_of_a_selftest_have_literals_of_its_precision(
    precision: str, tmp_path: Path
) -> None:
    """Expected results are of double precision in both."""
    made = export_selftest("elbow", tmp_path / "test", precision=precision, motion=False)
    folder = made.directory
    texts = [path.read_text(encoding="ascii") for path in folder.rglob("*.h")]
    arrays = [
        found
        for text in texts
        for found in re.findall(
            r"(given|expected)_\w+(?:\[[^]]*\])+ = \{(.*?)\};", text, re.DOTALL
        )
    ]
    assert {kind for kind, _ in arrays} == {"given", "expected"}
    for kind, values in arrays:
        numbers = re.findall(r"-?\d[\d.]*(?:e[-+]?\d+)?f?", values)
        floats = [number.endswith("f") for number in numbers]
        assert numbers and set(floats) == {kind == "given" and precision == "single"}
