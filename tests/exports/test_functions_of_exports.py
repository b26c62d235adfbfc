"""MATLAB and Simulink have the functions of one point that the header of the library declares."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from flexgen.exports.c_code.mex.export import export_mex
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
