"""Overlays of `flexgen new --urdf` against Pinocchio: files with drawn faults, and real ones."""

from __future__ import annotations

import re
import sysconfig
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from odd_urdfs import OddUrdf, odd_urdf
from urdf_peer import UrdfPeer

import flexgen
from flexgen.base.spec.toml_text import toml_key
from flexgen.dynamics.mechanics.equations import derive
from flexgen.model.inertia import mass_matrix
from flexgen.model.reader import read
from flexgen.model.urdf.urdf_mimic import Motion
from flexgen.studies.templates.new_model import new_overlay

ROBOTS = Path(
    sysconfig.get_paths()["purelib"], "cmeel.prefix", "share", "example-robot-data", "robots"
)
QUICK = (
    "panda_description/urdf/panda.urdf",
    "kinova_description/robots/kinova.urdf",
    "tiago_description/robots/tiago.urdf",
)
CLOSE = 1e-10  # of the largest entry: rounding times the number of bodies
SMALL = 1e-6  # N m or N: gravity of a robot whose axes are vertical is rounding
LAGRANGE = 12  # coordinates up to which Lagrange's equations are compared too
ODD = 6  # random files


def difference(urdf: Path, text: str, twin: Path | None = None, right: str = "") -> float:
    """Largest relative difference of an overlay from Pinocchio, of M, bias and gravity.

    ``twin``: the file for Pinocchio; ``right``: the text from which Pinocchio takes the locks.
    """
    overlay = urdf.with_name("overlay.toml")
    overlay.write_text(text, encoding="utf-8")
    robot = read(overlay)
    peer = UrdfPeer(twin or urdf, right or text, [c.name for c in robot.coordinates])
    still = replace(robot, motors=tuple(replace(motor, inertia=0.0) for motor in robot.motors))
    equations = derive(robot) if robot.n_a <= LAGRANGE else None
    rng = np.random.default_rng(3)
    worst = 0.0
    for _ in range(3):
        q, v = rng.uniform(-1.0, 1.0, (2, robot.n_a))
        M = peer.mass_matrix(q)
        h = peer.bias(q, v)
        g = peer.gravity(q)
        pairs = [(mass_matrix(still, q), M)]
        if equations is not None:
            pairs += [
                (equations.function("mass_matrix")(q), M),
                (equations.function("bias")(q, v), h),
                (equations.function("gravity")(q), g),
            ]
        for found, expected in pairs:
            size = max(np.abs(expected).max(), np.abs(g).max(), SMALL)
            error = np.abs(np.array(found).reshape(expected.shape) - expected).max()
            worst = max(worst, float(error / size))
    return worst


def made(folder: Path, odd: OddUrdf, name: str = "odd") -> tuple[Path, Path, str]:
    """The file, its twin, and the overlay."""
    file = folder / f"{name}.urdf"
    twin = folder / f"{name}_clean.urdf"
    file.write_text(odd.text, encoding="utf-8")
    twin.write_text(odd.clean, encoding="utf-8")
    return file, twin, new_overlay("odd", urdf=f"{file}#base:{odd.tip}", folder=folder).text


def test_files_with_all_faults_are_read_and_equal_pinocchio(tmp_path):
    faults: dict[str, int] = {}
    for seed in range(ODD):
        odd = odd_urdf(np.random.default_rng(seed))
        file, twin, text = made(tmp_path, odd)
        assert difference(file, text, twin) < CLOSE, seed
        for kind, count in odd.faults.items():
            faults[kind] = faults.get(kind, 0) + count
    assert len(faults) == 11
    assert all(faults.values()), faults


@pytest.mark.slow
def test_many_files_with_all_faults_are_read_and_equal_pinocchio(tmp_path):
    for seed in range(ODD, 60):
        odd = odd_urdf(np.random.default_rng(seed), joints=3 + seed % 6)
        file, twin, text = made(tmp_path, odd)
        assert difference(file, text, twin) < CLOSE, seed


def without_offset(self, mimic):
    """The planted error: the offset of a joint that follows another one is lost."""
    return replace(scale(self, mimic), offset=mimic.factor * self.offset)


def twice_as_fast(self, mimic):
    """The planted error: the factor of <mimic> counts twice."""
    return scale(self, replace(mimic, factor=2.0 * mimic.factor))


scale = Motion.scale


@pytest.mark.parametrize("wrong", [without_offset, twice_as_fast])
def test_a_wrong_follower_is_found(tmp_path, monkeypatch, wrong):
    monkeypatch.setattr(Motion, "scale", wrong)
    worst = 0.0
    for seed in range(3):
        file, twin, text = made(tmp_path, odd_urdf(np.random.default_rng(seed)))
        worst = max(worst, difference(file, text, twin))
    assert worst > 1e-3


def heavier(text: str) -> str:
    """The planted error: a body that was repaired has another mass."""
    return re.sub(r"body = \{ mass = ", r"\g<0>1", text, count=1)


def elsewhere(text: str) -> str:
    """The planted error: a joint is locked at another place."""
    names = tomllib.loads(text)["urdf"]["lock"]
    lines = "".join(f"lock.{toml_key(name)} = 0.01\n" for name in names)
    return re.sub(r"lock = \[.*?\][^\n]*\n", lambda _: lines, text, count=1, flags=re.DOTALL)


@pytest.mark.parametrize("wrong", [heavier, elsewhere])
def test_a_wrong_repair_is_found(tmp_path, wrong):
    found = []
    for seed in range(ODD):
        file, twin, text = made(tmp_path, odd_urdf(np.random.default_rng(seed)))
        if wrong(text) != text:
            found.append(difference(file, wrong(text), twin, text))
    assert found
    assert max(found) > 1e-4


def check_robot(file: Path, folder: Path) -> str:
    """Compare the overlay of a real file; what was done with it."""
    copy = folder / "robot.urdf"
    copy.write_bytes(file.read_bytes())
    overlay = new_overlay("robot", urdf=str(copy), folder=folder)
    if overlay.unfinished:
        (folder / "overlay.toml").write_text(overlay.text, encoding="utf-8")
        with pytest.raises(flexgen.ModelError, match="unfinished: given bodies without mass"):
            read(folder / "overlay.toml")
        return "unfinished"
    assert difference(copy, overlay.text) < CLOSE, file
    return "equal"


@pytest.mark.parametrize("file", QUICK)
def test_real_robots_equal_pinocchio(file, tmp_path):
    if not (ROBOTS / file).is_file():
        pytest.skip("no example-robot-data; run: make setup-test")
    assert check_robot(ROBOTS / file, tmp_path) == "equal"


@pytest.mark.slow
def test_all_real_robots_equal_pinocchio(tmp_path):
    """Nothing of the package is refused."""
    moving = re.compile(rb'type="(revolute|continuous|prismatic)"')
    files = [file for file in sorted(ROBOTS.rglob("*.urdf")) if moving.search(file.read_bytes())]
    if not files:
        pytest.skip("no example-robot-data; run: make setup-test")
    done = [check_robot(file, tmp_path) for file in files]
    assert len(done) > 50 and done.count("equal") > 0.97 * len(done)
