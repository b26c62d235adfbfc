"""Calibration of a mobile arm on a lifting column from its static points and two inclinometers.

    python examples/hilti_column/calibrate_column.py FOLDER

FOLDER: flat.yaml, pallet.yaml, seesaw.yaml and trailblazer.urdf of the data of a drilling robot by
Hilti and ETH Zuerich (CC BY-NC-SA 3.0). The chain is read from the URDF file: a platform on the
ground, a column of two stages that lift by half of the height each, six axes. Elastic axes are
added: two tilts of the platform and of each stage, the gears, and two axes across each joint. The
accelerometers at the foot and at the top of the column are levels: the components of their
direction of gravity are inclinations of two of their axes.

Calibrates with the points of flat.yaml, then states the error of the prism in all three files,
where only the pose of the robot in the frame of the total station, and the direction of gravity in
its base, are those of the file.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import yaml

import flexgen

FILES = ("flat", "pallet", "seesaw")
G = 9.81  # m/s^2
STIFF = (5e5, 5e5, 3e5, 1e5, 1e5, 1e5)  # N m/rad, of the gears: plausible numbers
STATION = 0.75e-3  # m, standard deviation of an axis of the total station
LEVEL = 3e-5  # m/m, of an inclination
LEVELS = (("foot", "platform"), ("top", "upper"))


def rotation(rpy: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) of roll, pitch and yaw [rad]."""
    c = np.cos(rpy)
    s = np.sin(rpy)
    x = np.array([[1, 0, 0], [0, c[0], -s[0]], [0, s[0], c[0]]])
    y = np.array([[c[1], 0, s[1]], [0, 1, 0], [-s[1], 0, c[1]]])
    z = np.array([[c[2], -s[2], 0], [s[2], c[2], 0], [0, 0, 1]])
    return z @ y @ x


class Urdf:
    """Places of joints, and masses, of a URDF file."""

    def __init__(self, file: Path) -> None:
        root = ET.parse(file).getroot()
        self.joints = {joint.attrib["name"]: joint for joint in root.findall("joint")}
        self.links = {link.attrib["name"]: link for link in root.findall("link")}

    def place(self, joint: str) -> np.ndarray:
        """Pose (4, 4) of a joint in its parent."""
        origin = self.joints[joint].find("origin")
        assert origin is not None
        pose = np.eye(4)
        pose[:3, 3] = [float(x) for x in origin.attrib["xyz"].split()]
        pose[:3, :3] = rotation(np.array([float(x) for x in origin.attrib["rpy"].split()]))
        return pose

    def body(self, *links: tuple[str, np.ndarray]) -> dict[str, Any]:
        """The body of links at poses, as points: statics needs masses and centers only."""
        masses = []
        centers = []
        for name, pose in links:
            inertial = self.links[name].find("inertial")
            assert inertial is not None
            mass = inertial.find("mass")
            origin = inertial.find("origin")
            assert mass is not None and origin is not None
            masses.append(float(mass.attrib["value"]))
            center = [float(x) for x in origin.attrib["xyz"].split()]
            centers.append(pose[:3, :3] @ center + pose[:3, 3])
        com = np.average(centers, axis=0, weights=masses)
        return {"mass": sum(masses), "com": com.tolist(), "inertia": [1.0, 1.0, 1.0]}


def turning(name: str, axis: list[int], stiffness: float) -> str:
    """An elastic axis of an element."""
    return (
        f'[[element.dof]]\nname = "{name}"\ntype = "rotation"\naxis = {axis}\n'
        f'spring = {{ type = "linear", stiffness = {stiffness} }}\n'
    )


def element(name: str, pose: np.ndarray, body: dict[str, Any]) -> str:
    """The head of an element at a pose (4, 4) in its parent."""
    R = pose[:3, :3].ravel().tolist()
    return (
        f'[[element]]\nname = "{name}"\n'
        f"origin = {{ position = {pose[:3, 3].tolist()}, rotation = {R} }}\n"
        f"body = {{ mass = {body['mass']}, com = {body['com']}, inertia = {body['inertia']} }}\n"
    )


def model_text(urdf: Urdf) -> str:
    """The model file."""
    I = np.eye(4)
    top = urdf.place("column_top_to_tip") @ urdf.place("column_tip_to_tip_mount")
    arm = top @ urdf.place("column_tip_to_tool") @ urdf.place("column_to_dsr")
    foot = urdf.place("tracks_base_link_to_column_base")
    down = I.copy()
    down[2, 3] = -0.03  # offset of the upper stage from the lower one [m]
    text = f'name = "column"\ngravity = [0, 0, {-G}]\nhome_rad = [0.5, 0, 0, 0, 0, 0, 0]\n'
    text += element("platform", I, urdf.body(("tracks_base_link", I), ("column_base", foot)))
    text += turning("platform_x", [1, 0, 0], 1e6) + turning("platform_y", [0, 1, 0], 1e6)
    text += element("lower", foot, urdf.body(("column_middle", I)))
    text += (
        '[[element.dof]]\nname = "lift"\ntype = "translation"\naxis = [0, 0, 1]\n'
        'gear = { type = "rigid" }\n'
    )
    text += turning("lower_x", [1, 0, 0], 3e5) + turning("lower_y", [0, 1, 0], 3e5)
    mount = urdf.place("column_top_to_tip") @ urdf.place("column_tip_to_tip_mount")
    text += element(
        "upper",
        down,
        urdf.body(("column_top", I), ("column_tip_mount", mount), ("dsr_base_0", arm)),
    )
    text += (
        '[[element.dof]]\nname = "second"\ntype = "translation"\naxis = [0, 0, 1]\n'
        "mimic = { lift = 1.0 }\n"
    )
    text += turning("upper_x", [1, 0, 0], 3e5) + turning("upper_y", [0, 1, 0], 3e5)
    for k, stiffness in enumerate(STIFF, 1):
        pose = urdf.place(f"dsr_joint{k}")
        links = [(f"dsr_link{k}", I)]
        if k == 6:
            links.append(("tool_link", urdf.place("dsr_tool_to_tool")))
        text += element(f"link{k}", arm @ pose if k == 1 else pose, urdf.body(*links))
        text += (
            f'[[element.dof]]\nname = "q{k}"\ntype = "rotation"\naxis = [0, 0, 1]\n'
            'gear = { type = "elastic", side = "arm", spring = { type = "linear", stiffness = '
            f"{stiffness} }} }}\n"
        )
        text += turning(f"q{k}_x", [1, 0, 0], 3 * stiffness)
        text += turning(f"q{k}_y", [0, 1, 0], 3 * stiffness)
    for name, ratio in (("lift", 1000), *((f"q{k}", 100) for k in range(1, 7))):
        text += (
            f'[[motor]]\nname = "m_{name}"\ndrives = "{name}"\nratio = {ratio}\ninertia = 1e-4\n'
        )
    joints = ", ".join(f'"q{k}"' for k in range(1, 7))
    text += f'[output]\ntype = "joint"\njoints = ["lift", {joints}]\n'
    prism = urdf.place("dsr_tool_to_tool") @ urdf.place("prism_calib")
    sensors = [("prism", "link6", prism[:3, 3].tolist())]
    sensors += [
        (f"{name}_{axis}", carrier, [0.0, 0.0, 0.0]) for name, carrier in LEVELS for axis in "xy"
    ]
    for name, carrier, position in sensors:
        text += (
            f'[[sensor]]\nname = "{name}"\ntype = "tracker"\nunit = "m"\nelement = "{carrier}"\n'
            f"position = {position}\n"
        )
    return text


def read_points(file: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Commands (N, 7), positions (N, 3) [m], and inclinations (N, 4) of a file."""
    data = yaml.load(
        file.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    )
    rows = [
        row
        for height in data["column_heights"].values()
        for space in height["solution_spaces"].values()
        for kind in ("stationing_measurements", "evaluation_measurements")
        for row in space[kind]
    ]
    joints = np.array([row["joint_states"] for row in rows], float)
    joints[:, 0] = 0.5 * joints[:, 0] - 0.706  # travel of the lower stage
    felt = [
        np.array([row[f"tilt_sensor_{name}_accel"] for row in rows], float)
        for name in ("base", "column")
    ]
    level = [a[:, :2] / np.linalg.norm(a, axis=1, keepdims=True) for a in felt]
    return joints, np.array([row["prism_position"] for row in rows], float), np.hstack(level)


def poses_of(
    points: tuple[np.ndarray, np.ndarray, np.ndarray], levels: bool
) -> flexgen.StaticPoses:
    """Static poses of the prism and, with ``levels``, of the four inclinations."""
    joints, prism, inclined = points
    N = len(joints)
    positions = np.full((N, 5, 3), np.nan)
    positions[:, 0] = prism
    touches = np.full((N, 5), "", dtype="<U16")
    readings = np.full((N, 5), np.nan)
    sd = np.full((N, 5), STATION)
    for k, (name, axis) in enumerate((n, a) for n, _ in LEVELS for a in "xy"):
        touches[:, k + 1] = f"level {name} {axis}"
        readings[:, k + 1] = inclined[:, k]
        sd[:, k + 1] = LEVEL if levels else 1e3 * LEVEL
    return flexgen.StaticPoses(joints, positions, "points", None, touches, readings, sd)


def best_frame(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Distances (N,) [m] of points from where they were seen, after the best rigid motion."""
    a = points - points.mean(axis=0)
    b = seen - seen.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    return np.asarray(np.linalg.norm(a @ R.T - b, axis=1))


def main(folder: Path, out: Path) -> dict[str, float]:
    """Calibrate with flat.yaml; root mean square errors of the prism [m] in all files."""
    out.mkdir(parents=True, exist_ok=True)
    nominal = out / "column.toml"
    nominal.write_text(model_text(Urdf(folder / "trailblazer.urdf")), encoding="utf-8")
    points = {name: read_points(folder / f"{name}.yaml") for name in FILES}
    errors: dict[str, float] = {}
    still = points["flat"][2][:, :2].mean(axis=0)
    for kind, levels in (("positions", False), ("with levels", True)):
        found = flexgen.calibrate(
            nominal,
            poses_of(points["flat"], levels),
            free=["zeros", "placements", "compliances"],
            priors=flexgen.Priors(tracker=0.02, position=5e-3, rotation=5e-3),
            folds=0,
            progress=False,
        )
        print(f"{kind}: {found.status.value}, {len(found.x)} numbers, {len(found.kept)} kept")
        for name in FILES:
            joints, prism, inclined = points[name]
            # gravity in the base of this file, relative to flat.yaml
            down = np.append(still - inclined[:, :2].mean(axis=0), -1.0)
            robot = flexgen.read(
                found.nominal.file,
                overrides={**found.changes, "gravity": (G * down / np.linalg.norm(down)).tolist()},
            )
            there = flexgen.tracker_positions(robot, joints)[:, 0]
            away = best_frame(there, prism)
            errors[f"{kind}, {name}"] = float(np.sqrt(np.mean(away**2)))
            print(f"  {name}: rms {1e3 * errors[f'{kind}, {name}']:.2f} mm, {len(joints)} points")
    return errors


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path("reports") / "hilti_column")
