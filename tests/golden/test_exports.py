"""The files of all exports are what they were, their numbers to nine digits: hashes in ``exports.txt``.

A net, not a proof: ``make golden`` writes them again; compare the exports of two commits to see which lines changed.
"""

from __future__ import annotations

import functools
import hashlib
import re
import sys
import zipfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest

sys.path.append(str(Path(__file__).resolve().parents[1] / "support"))
from emitted_hashes import GOLDEN_CASADI

import flexgen
from flexgen.errors import FlexgenError

GOLDEN = Path(__file__).with_name("exports.txt")
NUMBER = re.compile(r"-?\d+\.\d{3,}(?:e[-+]\d+)?|-?\d(?:\.\d+)?e[-+]\d+")
OF_TODAY = re.compile(
    rf"{re.escape(flexgen.__version__)}|\d{{4}}-\d\d-\d\dT[0-9:]+Z|\{{?[0-9a-f]{{8}}-[0-9a-f-]{{27}}\}}?|\b[0-9a-f]{{32,64}}\b"
)
ROBOTS = ("elbow", "planar5_nmp", "manutec_r3", "kr300_efjm", "urdf_arm", "four_mass", "beam_arm")


def digest(text: str) -> str:
    """A hash of a text without versions, dates and the last digits of its numbers."""

    def short(found: re.Match[str]) -> str:
        value = float(found.group())
        return f"{0.0 if abs(value) < 1e-12 else value:.9g}"

    return hashlib.sha256(NUMBER.sub(short, OF_TODAY.sub("", text)).encode()).hexdigest()[:12]


def hashes(path: Path) -> list[str]:
    """File and hash; of an FMU its members; without the emitted library, which has its own test."""
    if path.suffix == ".fmu":
        with zipfile.ZipFile(path) as archive:
            texts = {name: archive.read(name) for name in archive.namelist()}
    else:
        files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
        files += [path.with_suffix(".toml")] if path.suffix == ".urdf" else []
        texts = {file.relative_to(path.parent).as_posix(): file.read_bytes() for file in files}
    kept = {name: text for name, text in texts.items() if not name.endswith((".json", ".png"))}
    return [f"{name} {digest(text.decode('utf-8', 'replace'))}" for name, text in sorted(kept.items())]


@functools.cache
def cases() -> dict[str, Callable[[Path], Any]]:
    """Exports by name, functions of the folder."""
    found: dict[str, Callable[[Path], Any]] = {}
    for name in ROBOTS:
        for friction in ("exact", "viscous", "dry"):
            found[f"mujoco {name} {friction}"] = lambda folder, n=name, f=friction: flexgen.export_mujoco(
                n, folder / f"{n}.xml", friction=f
            )
        found[f"urdf {name}"] = lambda folder, n=name: flexgen.export_urdf(n, folder / f"{n}.urdf")
    for block in ("plant", "feedforward"):
        for standard in ("2.0", "3.0"):
            found[f"fmu {block} {standard}"] = lambda folder, b=block, v=standard: flexgen.export_fmu(
                "planar5_nmp" if v == "3.0" else "elbow",
                folder / "a.fmu",
                version=v,
                block=b,
                binary=False,
                progress=False,
            )
    found["fmu of a method"] = lambda folder: flexgen.export_fmu(
        "urdf_arm", folder / "a.fmu", binary=False, method="sdirk4", step=2e-4, progress=False
    )
    for name in ("elbow", "planar5_nmp"):
        found[f"mex {name}"] = lambda folder, n=name: flexgen.export_mex(n, folder / "mex")
        found[f"plc {name}"] = lambda folder, n=name: flexgen.export_plcopen(n, folder / "plc")
        found[f"simulink {name}"] = lambda folder, n=name: flexgen.export_simulink(n, folder / "simulink")
        found[f"ros2 {name}"] = lambda folder, n=name: flexgen.export_ros2(n, folder / "ros2", gains=False)
    found["ros2 with gains"] = lambda folder: flexgen.export_ros2("elbow", folder / "ros2", package="my_arm")
    found["plc without stream"] = lambda folder: flexgen.export_plcopen("elbow", folder / "plc", stream=False)
    found["self test"] = lambda folder: flexgen.export_selftest("elbow", folder / "selftest")
    found["self test of points"] = lambda folder: flexgen.export_selftest(
        "elbow", folder / "selftest", motion=False, precision="single"
    )
    return found


def lines(name: str, folder: Path) -> list[str]:
    """The hashes of an export, or why it is refused."""
    try:
        made = cases()[name](folder)
    except FlexgenError as error:
        return [f"{type(error).__name__}: " + re.sub(r"\S*models/", "models/", str(error))]
    return hashes(Path(made.path))


def kept() -> dict[str, list[str]]:
    """The lines of each export in the file."""
    parts = GOLDEN.read_text(encoding="utf-8").split("== ")[1:] if GOLDEN.exists() else []
    return {name: text.splitlines() for name, _, text in (part.partition("\n") for part in parts)}


@pytest.mark.parametrize("name", kept())
def test_the_files_of_an_export_are_what_they_were(name: str, tmp_path: Path) -> None:
    """Of `flexgen.exports`: mujoco, urdf, fmu, mex, plcopen, ros2, selftest, simulink."""
    if not version("casadi").startswith(f"{GOLDEN_CASADI}."):
        pytest.skip(f"recorded with CasADi {GOLDEN_CASADI}, which orders the operations in its own way")
    found, expected = lines(name, tmp_path), kept()[name]
    assert found == expected, f"run: make golden; changed: {sorted(set(found) ^ set(expected))}"


def test_the_file_has_all_exports() -> None:
    assert list(kept()) == list(cases())


def test_a_digit_of_a_number_changes_the_hash_and_rounding_does_not() -> None:
    assert digest("a 0.123456789 b") == digest("a 0.1234567890001 b") != digest("a 0.123456788 b")
    assert digest("2 steps") != digest("3 steps")


if __name__ == "__main__":
    import tempfile

    text = []
    for case in cases():
        with tempfile.TemporaryDirectory() as place:
            text += [f"== {case}", *lines(case, Path(place))]
    GOLDEN.write_text("\n".join(text) + "\n", encoding="utf-8")
