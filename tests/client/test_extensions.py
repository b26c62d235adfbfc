"""A package of others adds a method, a law, an exporter and a friction law, for Python and the
command line.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

import pytest
from installations import ROOT, need_setuptools
from toolchain import needs_compiler

pytestmark = needs_compiler

PROJECT = """
[build-system]
requires = ["setuptools"]
build-backend = "setuptools.build_meta"
[project]
name = "stranger"
version = "1"
[tool.setuptools]
py-modules = ["stranger"]
[project.entry-points]
"flexgen.methods".softened = "stranger:METHOD"
"flexgen.exports".inertias = "stranger:write_inertias"
"flexgen.frictions".quadratic = "stranger:Quadratic"
"flexgen.laws".quiet = "stranger:Quiet"
"flexgen.hysteresis".logistic = "stranger:Logistic"
"""
MODULE = """
from dataclasses import dataclass
import casadi as ca
from flexgen.inversion.methods.method_table import Method
from flexgen.inversion.methods.lq import solve as lq
from flexgen.feedback.laws.lq import LQG
from flexgen.model.elements import Friction, friction_key
from flexgen.base.spec.memory import HysteresisLaw

METHOD = Method("softened", "lq, with a message", "stranger", "softened")
def softened(problem, h):
    problem.log("softened")
    return lq(problem, h)

def write_inertias(model, out):
    out.write_text(",".join(str(motor.inertia) for motor in model.motors))
    return out

@dataclass(frozen=True)
class Quadratic(Friction):
    quadratic: float = friction_key("N m s^2/rad^2")
    def torque(self, w):
        return self.viscous * w + self.quadratic * w * ca.fabs(w)

@dataclass(frozen=True)
class Logistic(HysteresisLaw):
    bend: float = friction_key("1", default=0.5)
    def slope(self, y):
        return (1 - y) * (1 + self.bend * y)

@dataclass(frozen=True)
class Quiet(LQG):
    rho: float = 1e4
"""
USED = """
import numpy as np, flexgen
s = flexgen.solve("planar5_nmp", method="softened", progress=False)
twin = flexgen.solve("planar5_nmp", method="lq", progress=False)
print(s.method, s.status, np.abs(s.trajectory["tau_m"] - twin.trajectory["tau_m"]).max())
friction = {"type": "quadratic", "viscous": 0.5, "quadratic": 0.25}
model = flexgen.read("planar5_nmp", overrides={"motor.m1.friction": friction})
print(np.array(flexgen.derive(model).function("motor_friction")(np.array([-3.0, 2.0]))).ravel()[0])
print(flexgen.describe(model)["motors"][0]["friction"]["type"], "quadratic" in \
str(flexgen.schema()))
loop = {"type": "logistic", "lost_motion": 1e-4, "stiffness": 2e5, "bend": 0.25}
lossy = flexgen.read("planar5_nmp", overrides={"element.arm1.dof.q1.gear.hysteresis": loop})
solved, file = flexgen.solve(lossy, progress=False), flexgen.export_urdf(lossy, \
"lossy.urdf").details["overlay"]
print(solved.status, solved.tool_error_max_m < 5e-8, \
flexgen.read(file).coordinates[0].dof.gear.hysteresis)
made = flexgen.generate(lossy, "lossy", build=False).directory
print("hysteresis_curve[" in "".join(path.read_text() for path in made.rglob("*.[ch]")))
print(flexgen.export("inertias", "planar5_nmp", "inertias.csv").files[0])
"""


@pytest.fixture(scope="module")
def environment(tmp_path_factory):
    """Where the package is installed next to flexgen."""
    need_setuptools()
    folder = tmp_path_factory.mktemp("stranger")
    (folder / "pyproject.toml").write_text(PROJECT, encoding="utf-8")
    (folder / "stranger.py").write_text(MODULE, encoding="utf-8")
    lines = [line for text in (PROJECT, MODULE) for line in text.splitlines() if line.strip()]
    assert len([line for line in MODULE.splitlines() if line.strip()]) <= 30 and len(lines) <= 45
    command = (
        "-m pip install --quiet --no-deps --no-index --no-build-isolation --no-compile --target"
    )
    subprocess.run(
        [sys.executable, *command.split(), str(folder / "site"), str(folder)], check=True
    )
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder / "site"), str(ROOT)])}


def run(environment, folder, *arguments, fails=False):
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode != 0) == fails, done.stderr
    return done.stdout + done.stderr


def test_extensions_are_used_from_python(environment, tmp_path):
    lines = run(environment, tmp_path, "-c", USED).splitlines()
    method, status, difference = lines[0].split()
    assert (method, status) == ("softened", "solved") and float(difference) == 0.0
    assert float(lines[1]) == pytest.approx(0.5 * -3.0 - 0.25 * 9.0, rel=1e-15)
    assert lines[2] == "quadratic True" and lines[-1] == "inertias.csv"
    assert lines[3:-1] == [
        "solved True Logistic(lost_motion=0.0001, stiffness=200000.0, bend=0.25)",
        "True",
    ]
    assert (tmp_path / "inertias.csv").read_text(encoding="utf-8").count(",") == 1


def test_extensions_are_used_from_the_command_line(environment, tmp_path):
    cli = [str(ROOT / "cli.py")]
    assert "softened" in run(
        environment, tmp_path, *cli, "solve", "planar5_nmp", "--method", "softened"
    )
    text = run(environment, tmp_path, *cli, "export", "inertias", "planar5_nmp", "--out", "i.csv")
    assert "wrote i.csv" in text and (tmp_path / "i.csv").is_file()
    changed = ["--set", 'motor.m1.friction={type="quadratic", viscous=0.5, quadratic=0.25}']
    assert "quadratic" in run(
        environment, tmp_path, *cli, "describe", "planar5_nmp", *changed, "--json"
    )
    loop = '{type="logistic", lost_motion=1e-4, stiffness=2e5, bent=1.0}'
    loop = ["--set", f"element.arm1.dof.q1.gear.hysteresis={loop}"]
    text = run(environment, tmp_path, *cli, "describe", "planar5_nmp", *loop, fails=True)
    assert (
        "bent: given an unknown key, expected bend (there are: bend, lost_motion, stiffness, type)"
        in text
    )
    wrong = ["--set", 'motor.m1.friction={type="cubic"}']
    assert "expected one of gear, quadratic, smooth" in run(
        environment, tmp_path, *cli, "describe", "planar5_nmp", *wrong, fails=True
    )
    text = run(
        environment,
        tmp_path,
        *cli,
        "control",
        "planar5_nmp",
        "--controller",
        "unknown",
        fails=True,
    )
    assert "quiet" in text


def test_library_is_written_again_after_the_code_of_a_friction_law_has_changed(
    environment, tmp_path
):
    site = tmp_path / "site"
    shutil.copytree(environment["PYTHONPATH"].split(os.pathsep)[0], site)
    changed = {**environment, "PYTHONPATH": os.pathsep.join([str(site), str(ROOT)])}
    command = [
        str(ROOT / "cli.py"),
        "generate",
        "planar5_nmp",
        "--no-build",
        "--out",
        "lib",
        "--functions",
        "motor_friction",
    ]
    command += ["--set", 'motor.m1.friction={type="quadratic", viscous=0.5, quadratic=0.25}']
    texts = []
    for factor in ("self.quadratic", "2 * self.quadratic"):
        (site / "stranger.py").write_text(
            MODULE.replace("self.quadratic * w", f"{factor} * w"), encoding="utf-8"
        )
        run(changed, tmp_path, *command)
        texts.append(
            "".join(
                path.read_text(encoding="utf-8")
                for path in sorted((tmp_path / "lib").rglob("*.[ch]"))
            )
        )
    assert texts[0] != texts[1]


def test_extension_that_cannot_be_imported_is_refused_with_its_name(environment, tmp_path):
    site = environment["PYTHONPATH"].split(os.pathsep)[0]
    broken = {**environment, "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), str(ROOT)])}
    (tmp_path / "site" / "stranger-1.dist-info").mkdir(parents=True)
    for name in ("METADATA", "entry_points.txt"):
        with open(os.path.join(site, "stranger-1.dist-info", name), encoding="utf-8") as file:
            (tmp_path / "site" / "stranger-1.dist-info" / name).write_text(
                file.read(), encoding="utf-8"
            )
    (tmp_path / "site" / "stranger.py").write_text(
        "raise RuntimeError('planted')\n", encoding="utf-8"
    )
    code = "import flexgen; flexgen.export('inertias', 'elbow', 'x')"
    text = run(broken, tmp_path, "-c", code, fails=True)
    assert "entry point inertias = 'stranger:write_inertias'" in text and "planted" in text
    unused = (
        "import flexgen; flexgen.describe('elbow'); print(flexgen.solve('elbow', "
        "progress=False).status)"
    )
    # what is not used does no harm
    assert run(broken, tmp_path, "-c", unused).split()[-1] == "solved"


@pytest.mark.parametrize(
    ("line", "code", "expected"),
    [
        (
            "exports]\nros2 = stranger:write_inertias",
            "import flexgen; flexgen.export('ros2', 'elbow', 'x')",
            "given 'ros2'",
        ),
        (
            "frictions]\nhollow = stranger:Hollow",
            (
                "import flexgen; flexgen.read('elbow', overrides={'motor.m1.friction': {'type': "
                "'hollow'}})"
            ),
            "expected a subclass of Friction with a method torque",
        ),
        (
            "laws]\nneedy = stranger:Needy",
            "import flexgen; flexgen.control('elbow', controller='needy', progress=False)",
            "given 'needy', which cannot be made without parameters",
        ),
    ],
)
def test_extension_of_the_wrong_kind_is_refused(tmp_path, line, code, expected):
    info = tmp_path / "site" / "stranger-1.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: stranger\nVersion: 1\n", encoding="utf-8"
    )
    (info / "entry_points.txt").write_text(f"[flexgen.{line}\n", encoding="utf-8")
    module = (
        "class Hollow(Friction):\n    pass\nclass Needy(LQG):\n    def __init__(self, rho): pass\n"
    )
    (tmp_path / "site" / "stranger.py").write_text(MODULE + module, encoding="utf-8")
    there = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), str(ROOT)])}
    text = run(there, tmp_path, "-c", code, fails=True)
    assert expected in text and "ArgumentError" in text
    assert "gains" in run(there, tmp_path, str(ROOT / "cli.py"), "export", "ros2", "--help")
