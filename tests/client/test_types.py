"""Static types as a client sees them: right calls pass, mistakes are found, from the wheel and
from `make setup`.
"""

from __future__ import annotations

import importlib.util
import inspect
import json
import os
import subprocess
import sys
import typing
from pathlib import Path

import pytest
from installations import ROOT, built, clone_at, environment_at, install, need_setuptools

import flexgen
from flexgen.inversion.methods.method_table import method_names
from flexgen.simulation.integration.hold_names import HOLDS, HoldName

RIGHT = """
from pathlib import Path
from typing import assert_type

import numpy as np
import numpy.typing as npt

import flexgen
from flexgen import Analysis, Equations, Library, RobotModel, Solution

model: RobotModel = flexgen.read("elbow", overrides={"payload.mass": 2.0})
equations: Equations = flexgen.derive(model)
analysis: Analysis = flexgen.analyze(equations, pose=[0.1, 0.2])
solution = flexgen.solve("elbow", "line", hold="zoh", sample_time=1e-3, \
limits=flexgen.Limits(torque=(10.0, 5.0)))
assert_type(solution, Solution)
assert_type(solution.status, flexgen.Status)
assert_type(solution.tool_error_max_m, float | None)
assert_type(solution.trajectory, flexgen.Trajectory)
assert_type(solution.simulation, flexgen.Simulation | None)
assert_type(flexgen.solve(model, flexgen.plan(model).move, progress=print), Solution)
library: Library = flexgen.load(flexgen.generate(equations, precision="single").directory)
assert_type(flexgen.simulate("elbow", solution.trajectory), flexgen.Simulation)
assert_type(flexgen.sweep(flexgen.Grid(models=["elbow"]), Path("out")), flexgen.SweepResult)
assert_type(flexgen.control("elbow").worst, flexgen.PlantRun)
assert_type(flexgen.Notch(12.0, pole_damping=0.5), flexgen.Notch)
assert_type(flexgen.export_fmu("elbow", version="3.0"), flexgen.Exported)
try:
    flexgen.read("nosuch")
except flexgen.FlexgenError as error:
    print(error)


class Mine:
    def reset(self) -> None: ...

    def step(self, k: int, y: flexgen.Measurement, ref: flexgen.Reference) -> \
npt.NDArray[np.float64]:
        return np.asarray(ref.tau_m + 20.0 * (ref.q_m - y.q_m), dtype=float)


flexgen.control("elbow", controller=Mine())
"""

WRONG = """
import flexgen

flexgen.solve("elbow", methd="lq")  # wrong
flexgen.solve("elbow", hold=3)  # wrong
flexgen.solve("elbow", hold="cubic")  # wrong
flexgen.solve("elbow").statsu  # wrong
flexgen.solve("elbow").trajectory.colums()  # wrong
flexgen.slove("elbow")  # wrong
flexgen.generate("elbow", precision="half")  # wrong
flexgen.generate(3)  # wrong
flexgen.simulate("elbow")  # wrong
flexgen.analyze("elbow", poses="many")  # wrong
flexgen.control("elbow", sample_time="1 ms")  # wrong
flexgen.export_fmu("elbow", version=2.0)  # wrong
flexgen.identify("elbow", None)  # wrong
flexgen.Notch(None)  # wrong
flexgen.Limits(torque=b"x")  # wrong
flexgen.derive("elbow").modle  # wrong
flexgen.read("elbow").motor_count  # wrong
flexgen.learn("elbow", itertions=3)  # wrong
"""


def mistakes() -> set[int]:
    return {
        number for number, line in enumerate(WRONG.splitlines(), 1) if line.endswith("# wrong")
    }


def test_values_of_literal_types_are_those_of_the_tables() -> None:
    assert tuple(HOLDS) == typing.get_args(HoldName)
    assert "lq" in method_names()


@pytest.mark.slow
def test_every_class_that_a_public_function_returns_is_public() -> None:
    """Classes that public methods return too, besides interfaces between rooms."""
    internal = {
        "BoundLaw",
        "Compiled",
        "Row",
        "Heading",
        "Inner",
        "JointMotion",
        "Prose",
        "Data",
        "FitStatus",
        "FittedNumber",
        "ImplicitDae",
        "Table",
        "LoopResponse",
        "Growth",
        "Friction",
        "Interval",
        "Lagrangian",
        "Limit",
        "Coordinate",
    }
    public = {name: getattr(flexgen, name) for name in flexgen.__all__ if name != "__version__"}
    hidden = set()
    for name, what in public.items():
        members = (
            inspect.getmembers(what)
            if inspect.isclass(what) and not issubclass(what, (str, Exception))
            else []
        )
        calls = [
            getattr(m, "fget", None) or getattr(m, "func", None) or m
            for key, m in members
            if not key.startswith("_")
        ]
        for call in [*calls, *([] if inspect.isclass(what) else [what])]:
            if not inspect.isfunction(inspect.unwrap(call)) and not inspect.ismethod(call):
                continue
            for found in classes(typing.get_type_hints(call, localns=public).get("return")):
                if public.get(found.__name__) is not found and found.__name__ not in internal:
                    hidden.add(f"{name}: {found.__name__}")
    assert hidden == set()


def classes(annotation: object) -> set[type]:
    """Classes of flexgen in an annotation."""
    if inspect.isclass(annotation) and annotation.__module__.startswith("flexgen"):
        return {annotation}
    return {found for part in typing.get_args(annotation) for found in classes(part)}


@pytest.fixture(scope="module", params=["make setup", "wheel"])
def interpreter(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment in which flexgen is installed."""
    need_setuptools()
    folder = tmp_path_factory.mktemp("types")
    python = environment_at(folder / "environment")
    clone = clone_at(folder / "clone")
    if request.param == "wheel":
        install(python, built(clone, folder / "dist"))
        return python
    (line,) = [
        line
        for line in (ROOT / "Makefile").read_text("utf-8").splitlines()
        if line.startswith("INSTALL :=")
    ]
    assert line.endswith("-m pip install --quiet --no-compile --editable")
    install(python, "--editable", clone)
    return python


@pytest.fixture
def scripts(tmp_path: Path) -> Path:
    (tmp_path / "right.py").write_text(RIGHT, encoding="utf-8")
    (tmp_path / "wrong.py").write_text(WRONG, encoding="utf-8")
    return tmp_path


@pytest.mark.slow
def test_mypy_finds_the_mistakes_of_a_client_and_nothing_else(
    interpreter: Path, scripts: Path, tmp_path: Path
) -> None:
    pytest.importorskip("mypy")
    environment = {
        name: text for name, text in os.environ.items() if name not in ("MYPYPATH", "PYTHONPATH")
    }
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--strict",
        "--config-file=",
        "--python-executable",
        str(interpreter),
    ]
    command += ["--no-error-summary", "--hide-error-context", "right.py", "wrong.py"]
    done = subprocess.run(
        command, cwd=scripts, env=environment, capture_output=True, text=True, check=False
    )
    lines = [line.split(":") for line in done.stdout.splitlines() if ": error:" in line]
    assert done.returncode == 1 and [row for row in lines if row[0] != "wrong.py"] == [], (
        done.stdout + done.stderr
    )
    assert {int(row[1]) for row in lines} == mistakes(), done.stdout


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("basedpyright") is None, reason="needs basedpyright: make setup-lint"
)
def test_pyright_finds_the_mistakes_of_a_client_and_nothing_else(
    interpreter: Path, scripts: Path
) -> None:
    settings = {
        "typeCheckingMode": "standard",
        "reportUnusedExpression": False,
        "reportMissingTypeStubs": False,
    }
    (scripts / "pyrightconfig.json").write_text(json.dumps(settings), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "basedpyright",
        "--pythonpath",
        str(interpreter),
        "--outputjson",
    ]
    done = subprocess.run(command, cwd=scripts, capture_output=True, text=True, check=False)
    found = [
        (Path(d["file"]).name, d["range"]["start"]["line"] + 1, d["message"])
        for d in json.loads(done.stdout)["generalDiagnostics"]
        if d["severity"] == "error"
    ]
    assert [row for row in found if row[0] != "wrong.py"] == []
    assert {line for _, line, _ in found} == mistakes(), found
