"""Targets of the fuzzer: readers of files, and valid files that the mutations begin with."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
from flexgen.base.spec.ports import Port
from flexgen.codegen.build import generate
from flexgen.codegen.build.directory import read_manifest
from flexgen.feedback.loop.controller_files import file_controller
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.paths.samples.sample_files import read_samples
from flexgen.studies.scenarios.scenario_file import scenario
from flexgen.studies.sweeps.grid_file import read_grid

ROOT = Path(__file__).resolve().parents[2]
LINKED = "linked"  # a folder among the seeds: what a mutated file refers to, unchanged

SENSORS = """
[[sensor]]
name = "acc"
type = "accelerometer"
element = "tool"
position = [0.0, 0.1, 0.0]
axes = ["x", [1, 1, 0]]
unit = "m/s^2"
noise = 0.02
sample_s = 5e-4
delay_s = 1e-3

[[sensor]]
name = "link"
type = "link_encoder"
coordinate = "q1"
unit = "deg"
"""

Reader = Callable[[Path], Any]


@dataclass(frozen=True)
class Target:
    """A reader of files.

    ``seeds`` writes valid files into a folder. ``begin`` takes that folder and returns the reader
    of a mutated file. ``names``: of these file names one must stand in each message; the first
    word of a name is enough.
    """

    seeds: Callable[[Path], None]
    begin: Callable[[Path], Reader]
    names: tuple[str, ...]


def _each(steps: Sequence[Reader], names: Sequence[str], needed: int) -> Reader:
    """All readers one after the other; a refusal is raised where fewer than ``needed`` read the
    file.
    """

    def read(path: Path) -> None:
        refusals = []
        for step in steps:
            try:
                step(path)
            except flexgen.FlexgenError as error:
                if not any(name in str(error) for name in names):
                    raise
                refusals.append(error)
        if len(steps) - len(refusals) < needed:
            raise refusals[-1]

    return read


# --- models and URDF -----------------------------------------------------------------------------


def _model_seeds(folder: Path) -> None:
    for path in sorted((ROOT / "models").glob("*.toml")):
        shutil.copy(path, folder)
    planar = (ROOT / "models" / "planar5_nmp.toml").read_text(encoding="utf-8")
    (folder / "planar5_sensors.toml").write_text(planar + SENSORS, encoding="utf-8")
    (folder / LINKED).mkdir()
    shutil.copy(ROOT / "models" / "urdf_arm.urdf", folder / LINKED)


def _urdf_seeds(folder: Path) -> None:
    shutil.copy(ROOT / "tests/support/urdf/two_link.urdf", folder)
    shutil.copy(ROOT / "models" / "urdf_arm.urdf", folder)
    (folder / LINKED).mkdir()
    overlay = (ROOT / "models" / "urdf_arm.toml").read_text(encoding="utf-8")
    (folder / LINKED / "overlay.toml").write_text(
        overlay.replace("urdf_arm.urdf", "mutated.urdf"), encoding="utf-8"
    )


def _urdf(path: Path) -> None:
    """A URDF file with the ends of its chain, or by an overlay."""
    if b"finger" in path.read_bytes():
        flexgen.describe(path.with_name("overlay.toml"))
    else:
        flexgen.describe(flexgen.read(path, base="ground", tip="tip"))


# --- samples of paths ----------------------------------------------------------------------------


def _path_seeds(folder: Path) -> None:
    u = np.linspace(0.0, 1.0, 9)
    q = np.column_stack([0.3 + 0.4 * u, -1.1 - 0.3 * u])
    turned = np.column_stack([np.cos(u / 8), np.sin(u / 8), 0 * u, 0 * u])
    p = np.column_stack([0.9 + 0.1 * u, 0.2 * u, 1 - 0.1 * u**2])
    tables = {
        "joints": ("q1,q2,t", np.column_stack([q, u])),
        "tool": ("u,x,y,z", np.column_stack([u, p])),
        "pose": ("t,x,y,z,qw,qx,qy,qz", np.column_stack([u, p, turned])),
        "vector": ("x,y,z,rx,ry,rz", np.column_stack([p, 0.1 * p])),
        "output": ("t,y1", np.column_stack([u, u**2])),
    }
    for name, (head, table) in tables.items():
        rows = "".join(",".join(map(repr, row)) + "\n" for row in table.tolist())
        (folder / f"{name}.csv").write_text(f"# samples\n{head}\n{rows}")
    np.savez(folder / "joints.npz", q_g=q, t=u)
    np.savez_compressed(folder / "pose.npz", p=p, quaternion=turned, u=u)


def _path_reader(folder: Path) -> Reader:
    robots = [flexgen.read(name) for name in ("planar5_nmp", "manutec_r3", "four_mass")]
    return _each(
        [lambda path, robot=robot: read_samples(str(path), robot, 2) for robot in robots],
        ["mutated"],
        1,
    )


# --- trajectories --------------------------------------------------------------------------------


def _trajectory_seeds(folder: Path) -> None:
    t = np.linspace(0.0, 0.3, 11)
    channels = {"q_a": np.column_stack([t, np.sin(t)]), "tau_m": np.cos(t)[:, None]}
    ports = {
        "q_a": Port("q_a", (2,), "rad or m", "arm"),
        "tau_m": Port("tau_m", (1,), "N m", "torque"),
    }
    meta = {"model": "elbow", "variant": "", "move": "line", "kind": "solution"}
    labels = {"q_a": ("q1", "q2"), "tau_m": ("m1",)}
    for suffix in ("csv", "npz"):
        flexgen.Trajectory(t, channels, ports, labels, meta).save(folder / f"a.{suffix}")


# --- manifests of libraries ----------------------------------------------------------------------


def _manifest_seeds(folder: Path) -> None:
    made = flexgen.generate("elbow", folder / LINKED)
    (made.directory / "manifest.json").rename(folder / "mutated.json")


def _load(path: Path) -> None:
    """The loader, and a call of what it loaded."""
    shutil.copy(path, path.with_name("manifest.json"))
    with flexgen.load(path.parent) as library:
        library.gravity([0.1, 0.2])


def _known(path: Path) -> None:
    """Checks by `generate` of an existing manifest before it writes."""
    shutil.copy(path, path.with_name("manifest.json"))
    found = read_manifest(path.parent, "elbow")
    if found is not None:
        generate._built(path.parent, found, {"native": False, "openmp": False}, None)
        generate._intact(path.parent, found)
        generate._result(path.parent, found, 0.0, cached=True, written=False)


# --- identification ------------------------------------------------------------------------------


def _identification_seeds(folder: Path) -> None:
    """A plan, an experiment and responses of a planar arm; the spectra are random numbers."""
    rng = np.random.default_rng(0)
    plan = flexgen.excite(
        "planar5_nmp", poses=[[0.3, -1.1]], lines=4, period_s=1.0, periods=3, progress=False
    )
    shape = (1, 1, 2, 3, len(plan.lines), 2)
    tau, q = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape) for _ in range(2))
    # periods that repeat
    tau[:] = tau[:, :, :, :1]
    q[:] = q[:, :, :, :1]
    experiment = flexgen.Experiment(plan, tau, q, np.ones((1, 2)), np.zeros(1, np.int64), "seed")
    sensed = replace(
        experiment,
        plan=replace(plan, sensors=("acc.x",)),
        signals=q[..., :1],
        orders=(0,),
        offsets=np.array([-2, -1, 1, 2]),
        beside=1e-3 * rng.standard_normal((1, 1, 2, 4, len(plan.lines), 5)) + 0j,
    )
    sensed.save(folder / "sensed.npz")
    flexgen.frf(sensed).save(folder / "sensed_frf.npz")
    plan.save(folder / "plan.npz")
    experiment.save(folder / "experiment.npz")
    flexgen.frf(experiment).save(folder / "frf.npz")


def _identification(path: Path) -> None:
    """Each file is of one kind; what is read is used."""

    def plan(file: Path) -> None:
        found = flexgen.Plan.load(file)
        if found.samples <= 100_000:
            found.reference(0, 0)

    def experiment(file: Path) -> None:
        found = flexgen.Experiment.load(file)
        flexgen.frf(found)
        if found.beside is not None:
            flexgen.frf(found, transients=True)

    def responses(file: Path) -> None:
        found = flexgen.Frf.load(file)
        found.relative_sd()
        if len(found.poses) <= 4 and found.motors == ("m1", "m2"):
            sensor = {"name": "acc", "type": "accelerometer", "element": "tool", "unit": "m/s^2"}
            robot = flexgen.read("planar5_nmp", overrides={"sensor": [sensor]})
            # quick: few numbers
            flexgen.identify(robot, found, free=["q1.stiffness"], starts=1, progress=False)

    _each(
        [plan, experiment, responses],
        ["mutated", "seed", "equilibrium", "motors", "sensor channel"],
        1,
    )(path)


def _recording_seeds(folder: Path) -> None:
    (folder / LINKED).mkdir()
    bench = ROOT / "examples" / "motor_bench"
    shutil.copy(bench / "bench.toml", folder / LINKED)
    t = np.arange(4000) * 1e-3
    torque = np.cos(2 * np.pi * 11 * t) + np.sin(2 * np.pi * 20 * t)
    np.savez(
        folder / LINKED / "run.npz",
        time=1e6 * t,
        iq_adx=torque,
        theta_mx=0.01 * np.roll(torque, 3),
    )
    text = (
        (bench / "recordings.toml")
        .read_text()
        .replace("MultisineTypeA.mat", "run.npz")
        .replace("250.0", "100.0")
    )
    (folder / "mutated.toml").write_text(text)
    link = '\n[[sensor]]\nname = "link"\ntype = "link_encoder"\ncoordinate = "q1"\nunit = "rad"\n'
    (folder / LINKED / "linked.toml").write_text((bench / "bench.toml").read_text() + link)
    signal = (
        "[[signal]]\n"
        'sensor = "link"\n'
        'name = "both"\n'
        "index = 1\n"
        'unit = "mrad"\n'
        "offset = 2.0\n"
        "\n"
        "[[recording]]"
    )
    np.savez(
        folder / LINKED / "run.npz",
        time=1e6 * t,
        iq_adx=torque,
        theta_mx=0.01 * np.roll(torque, 3),
        both=np.stack([torque, np.roll(torque, 4)]),
    )
    text = text.replace("bench.toml", "linked.toml").replace("[[recording]]", signal)
    (folder / "signals.toml").write_text(
        text.replace("period_s = 1.0", "segment_s = 0.5").replace("transients = 1", "")
    )


def _recordings(path: Path) -> None:
    """Recordings that are read have to yield frequency responses."""
    experiment = read_experiment(path)
    if experiment.tau_m.size <= 100_000:
        flexgen.frf(experiment)


# --- controllers, scenarios and grids ------------------------------------------------------------

LAWS = {
    "cascade": (
        "position_gain = [2.0]\n"
        "speed_gain = [0.5]\n"
        "integral_gain = [0.1]\n"
        "[[low_pass]]\n"
        "frequency_hz = 50.0\n"
    ),
    "linear": "A = [[0.5]]\nB = [[1.0, 0.0]]\nC = [[0.2]]\nD = [[0.0, 3.0]]\n",
    "tomei_pd": "k_p = [1.0, 2.0]\nk_d = [0.1, 0.2]\nfeedforward = true\n",
}


def _table_seeds(folder: Path) -> None:
    for path in sorted((ROOT / "flexgen" / "studies" / "scenarios").glob("*.toml")):
        shutil.copy(path, folder)
    shutil.copy(ROOT / "examples" / "sweep.toml", folder)
    for kind, text in LAWS.items():
        (folder / f"{kind}.toml").write_text(f'type = "{kind}"\n{text}', encoding="utf-8")


def _tables(path: Path) -> None:
    """Each file is of one kind; models that a scenario names may have errors of their own."""
    readers = [lambda file: file_controller(str(file)), scenario, read_grid]
    _each(readers, ["mutated", "four_mass", "elbow"], 1)(path)


_LIBRARY = ("cases", "libelbow")

TARGETS = {
    "model": Target(
        _model_seeds, lambda folder: flexgen.describe, ("mutated.toml", "urdf_arm.urdf")
    ),
    "urdf": Target(_urdf_seeds, lambda folder: _urdf, ("mutated.urdf", "overlay.toml")),
    "path": Target(_path_seeds, _path_reader, ("mutated",)),
    "trajectory": Target(_trajectory_seeds, lambda folder: flexgen.Trajectory.load, ("mutated",)),
    "identification": Target(
        _identification_seeds,
        lambda folder: _identification,
        ("mutated", "seed", "equilibrium", "motors", "sensor channel"),
    ),
    "recordings": Target(
        _recording_seeds,
        lambda folder: _recordings,
        ("mutated.toml", "bench.toml", "linked.toml", "run.npz"),
    ),
    "tables": Target(_table_seeds, lambda folder: _tables, ("mutated", "four_mass", "elbow")),
    "manifest": Target(
        _manifest_seeds, lambda folder: _each([_known, _load], _LIBRARY, 2), _LIBRARY
    ),
}
