"""The files of all exports are what they were, their numbers to nine digits: hashes in
``exports.txt``.

A net, not a proof: ``make golden`` writes them again; compare the exports of two commits to see
which lines changed.

Of `flexgen.exports.c_code.added`, `flexgen.exports.c_code.emitted`, `flexgen.exports.exported`,
`flexgen.exports.fmu.block`, `flexgen.exports.fmu.controller`, `flexgen.exports.fmu.description`,
`flexgen.exports.fmu.export`, `flexgen.exports.fmu.feedforward`, `flexgen.exports.fmu.plant`,
`flexgen.exports.fmu.variables`, `flexgen.exports.c_code.mex.export`,
`flexgen.exports.mujoco.mujoco`, `flexgen.exports.mujoco.mujoco_checks`,
`flexgen.exports.mujoco.mujoco_forces`, `flexgen.exports.mujoco.mujoco_inertia`,
`flexgen.exports.urdf.overlay_tables`, `flexgen.exports.c_code.plcopen.blocks`,
`flexgen.exports.c_code.plcopen.export`, `flexgen.exports.c_code.plcopen.text`,
`flexgen.exports.poses`, `flexgen.exports.ros2.export`, `flexgen.exports.c_code.selftest.cases`,
`flexgen.exports.c_code.selftest.export`, `flexgen.exports.c_code.selftest.golden`,
`flexgen.exports.c_code.selftest.motion`, `flexgen.exports.c_code.simulink.export`,
`flexgen.codegen.build.source_folder`, `flexgen.codegen.build.template_files`,
`flexgen.exports.urdf.urdf`, `flexgen.exports.xml_text`.
"""

from __future__ import annotations

import functools
import hashlib
import re
import tempfile
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from golden_texts import nine_digits

import flexgen
from flexgen.base.errors import FlexgenError

OF_TODAY = re.compile(
    rf"{re.escape(flexgen.__version__)}|\d{{4}}-\d\d-\d\dT[0-9:]+Z|"
    rf"\{{?[0-9a-f]{{8}}-[0-9a-f-]{{27}}\}}?|\b[0-9a-f]{{32,64}}\b"
)
ROBOTS = {
    "elbow": "exact",
    "planar5_nmp": "dry",
    "manutec_r3": "exact",
    "kr300_efjm": "exact",
    "urdf_arm": "viscous",
    "four_mass": "viscous",
    "beam_arm": "exact",
}


def digest(text: str) -> str:
    """A hash of a text without versions, dates and the last digits of its numbers."""
    return hashlib.sha256(nine_digits(OF_TODAY.sub("", text)).encode()).hexdigest()[:12]


def hashes(path: Path) -> list[str]:
    """File and hash; of an FMU its members; without the emitted library, which has its own
    test.
    """
    if path.suffix == ".fmu":
        with zipfile.ZipFile(path) as archive:
            texts = {name: archive.read(name) for name in archive.namelist()}
    else:
        files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file()]
        files += [path.with_suffix(".toml")] if path.suffix == ".urdf" else []
        texts = {file.relative_to(path.parent).as_posix(): file.read_bytes() for file in files}
    kept = {name: text for name, text in texts.items() if not name.endswith((".json", ".png"))}
    return [
        f"{name} {digest(text.decode('utf-8', 'replace'))}" for name, text in sorted(kept.items())
    ]


@functools.cache
def cases() -> dict[str, Callable[[Path], Any]]:
    """Exports by name, functions of the folder."""
    found: dict[str, Callable[[Path], Any]] = {}
    for name, friction in ROBOTS.items():
        found[f"mujoco {name} {friction}"] = lambda folder, n=name, f=friction: (
            flexgen.export_mujoco(n, folder / f"{n}.xml", friction=f)
        )
        found[f"urdf {name}"] = lambda folder, n=name: flexgen.export_urdf(n, folder / f"{n}.urdf")
    load = {
        "mass": 2.0,
        "com": [0.1, 0.0, 0.0],
        "inertia": [0.0, 0.5, 0.0],
        "inertia_reduced": True,
    }
    loaded = flexgen.read("elbow", overrides={"payload": load})
    found["urdf with a payload"] = lambda folder: flexgen.export_urdf(
        loaded, folder / "loaded.urdf"
    )
    point = flexgen.read("elbow", overrides={"payload": {"mass": 2.0, "com": [0.1, 0.0, 0.0]}})
    found["mujoco with a point mass"] = lambda folder: flexgen.export_mujoco(
        point, folder / "point.xml"
    )
    found["ros2 with forces"] = lambda folder: flexgen.export_ros2(
        "elbow", folder / "pushed", package="my_arm", parts=("force",)
    )
    source = functools.partial(flexgen.export_fmu, binary=False, progress=False)
    name = "planar5_nmp"
    found["fmu plant"] = lambda folder: source("elbow", folder / "a.fmu")
    found["fmu plant of FMI 3"] = lambda folder: source(
        name, folder / "a.fmu", version="3.0", method="sdirk4", step=2e-4
    )
    found["fmu feedforward"] = lambda folder: source(name, folder / "a.fmu", block="feedforward")
    found["mex"] = lambda folder: flexgen.export_mex(name, folder / "mex")
    found["plc"] = lambda folder: flexgen.export_plcopen(name, folder / "plc")
    found["simulink"] = lambda folder: flexgen.export_simulink(name, folder / "simulink")
    found["ros2"] = lambda folder: flexgen.export_ros2("elbow", folder / "ros2", package="my_arm")
    found["self test"] = lambda folder: flexgen.export_selftest("elbow", folder / "selftest")
    found["self test, single"] = lambda folder: flexgen.export_selftest(
        "elbow", folder / "single", precision="single"
    )
    return found


def lines(name: str) -> list[str]:
    """The hashes of an export, or why it is refused."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            made = cases()[name](Path(folder))
        except FlexgenError as error:
            return [f"{type(error).__name__}: " + re.sub(r"\S*models/", "models/", str(error))]
        return hashes(Path(made.path))
