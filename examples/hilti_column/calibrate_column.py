"""Calibration of a mobile arm on a lifting column from its static points and two inclinometers.

    python examples/hilti_column/calibrate_column.py FOLDER

FOLDER: flat.yaml, pallet.yaml, seesaw.yaml and trailblazer.urdf of the data of a drilling robot by
Hilti and ETH Zuerich (CC BY-NC-SA 3.0). The chain is read from the URDF file: a platform on the
ground, a column of two stages that lift by half of the height each, six axes. The
accelerometers at the foot and at the top of the column measure how it leans and bends in each
pose: their inclinations are commands of four axes without springs, as the encoders' angles are of
the joints. The gears and two axes across each joint are elastic.

Calibrates with the points of flat.yaml, without and with the inclinations, then states the error
of the prism in all files. Only the pose of the robot in the frame of the total station is that of
the file.

The robot is used otherwise: before it works at a height of its column and on one of its sides, it
measures eight points there. The last figures are those of the points that follow: place and yaw of
the robot are those of these stations, its tilt and the zero of the second joint, the first of the
causes that are named, one of a file; all are found from the points of the stations alone.
"""

from __future__ import annotations

import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import flexgen

FILES = ("flat", "pallet", "seesaw")
UNIT = np.eye(4)
G = 9.81  # m/s^2
STIFF = (5e5, 5e5, 3e5, 1e5, 1e5, 1e5)  # N m/rad, of the gears: plausible numbers
MIDDLE = 0.706  # m, of the column, above the lower stage: a bent column turns about its middle
TILTS = ("platform_x", "platform_y", "bend_x", "bend_y")
FREE = ("zeros", "placements", "compliances", "mechanisms")
SECOND = 6  # column of the second joint in the commands
PRIORS = flexgen.Priors(tracker=0.03, position=5e-3, rotation=0.01)


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


def known(name: str, axis: list[int], kind: str = "rotation") -> str:
    """An axis of an element whose value is measured."""
    return (
        f'[[element.dof]]\nname = "{name}"\ntype = "{kind}"\naxis = {axis}\n'
        'gear = { type = "rigid" }\n'
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
    top = urdf.place("column_top_to_tip") @ urdf.place("column_tip_to_tip_mount")
    arm = top @ urdf.place("column_tip_to_tool") @ urdf.place("column_to_dsr")
    foot = urdf.place("tracks_base_link_to_column_base")
    middle = np.eye(4)
    middle[2, 3] = MIDDLE
    down = np.eye(4)
    down[2, 3] = -0.706 - 0.03 + 0.706 - MIDDLE  # of the upper stage, from there
    joints = [*TILTS[:2], "lift", *TILTS[2:], *(f"q{k}" for k in range(1, 7))]
    home = [0.0, 0.0, 0.5, *(0.0,) * 8]
    text = f'name = "column"\ngravity = [0, 0, {-G}]\nhome_rad = {home}\n'
    text += element("platform", UNIT, urdf.body(("tracks_base_link", UNIT), ("column_base", foot)))
    text += known("platform_x", [1, 0, 0]) + known("platform_y", [0, 1, 0])
    text += element("lower", foot, urdf.body(("column_middle", UNIT)))
    text += known("lift", [0, 0, 1], "translation")
    text += element("bend", middle, {"mass": 0.01, "com": [0, 0, 0], "inertia": [0.01] * 3})
    text += known("bend_x", [1, 0, 0]) + known("bend_y", [0, 1, 0])
    mount = urdf.place("column_top_to_tip") @ urdf.place("column_tip_to_tip_mount")
    text += element(
        "upper",
        down,
        urdf.body(("column_top", UNIT), ("column_tip_mount", mount), ("dsr_base_0", arm)),
    )
    text += (
        '[[element.dof]]\nname = "second"\ntype = "translation"\naxis = [0, 0, 1]\n'
        "mimic = { lift = 1.0 }\n"
    )
    for k, stiffness in enumerate(STIFF, 1):
        pose = urdf.place(f"dsr_joint{k}")
        links = [(f"dsr_link{k}", UNIT)]
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
    for name in joints:
        ratio = 1000 if name == "lift" else 100
        text += (
            f'[[motor]]\nname = "m_{name}"\ndrives = "{name}"\nratio = {ratio}\ninertia = 1e-4\n'
        )
    text += f'[output]\ntype = "joint"\njoints = {joints}\n'.replace("'", '"')
    prism = urdf.place("dsr_tool_to_tool") @ urdf.place("prism_calib")
    return text + (
        '[[sensor]]\nname = "prism"\ntype = "tracker"\nunit = "m"\nelement = "link6"\n'
        f"position = {prism[:3, 3].tolist()}\n"
    )


@dataclass(frozen=True)
class Points:
    """Points of a file.

    ``commands`` (N, 11) [rad, m]; ``prism`` (N, 3) [m]; ``station`` (N,): number of the height and
    the side of the robot, -1 where it has no stationing points; ``of_station`` (N,): whether the
    point is one of them.
    """

    commands: np.ndarray
    prism: np.ndarray
    station: np.ndarray
    of_station: np.ndarray


def read_points(file: Path) -> Points:
    """The points of a file."""
    data = yaml.load(
        file.read_text(encoding="utf-8"), getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    )
    rows = []
    station = []
    of_station = []
    count = 0
    for height in data["column_heights"].values():
        for space in height["solution_spaces"].values():
            stationing = space["stationing_measurements"]
            measured = [*stationing, *space["evaluation_measurements"]]
            rows += measured
            station += [count if stationing else -1] * len(measured)
            of_station += [k < len(stationing) for k in range(len(measured))]
            count += bool(stationing)
    joints = np.array([row["joint_states"] for row in rows], float)
    lift = 0.5 * joints[:, :1] - 0.706  # travel of the lower stage [m]
    foot, top = (
        _tilts(np.array([row[f"tilt_sensor_{name}_accel"] for row in rows], float))
        for name in ("base", "column")
    )
    return Points(
        commands=np.hstack([foot, lift, top - foot, joints[:, 1:]]),
        prism=np.array([row["prism_position"] for row in rows], float),
        station=np.array(station),
        of_station=np.array(of_station),
    )


def _tilts(felt: np.ndarray) -> np.ndarray:
    """Angles (N, 2) [rad] about x and y from the vertical, of accelerations (N, 3)."""
    up = felt / np.linalg.norm(felt, axis=1, keepdims=True)
    return np.column_stack([np.arcsin(up[:, 1]), -np.arcsin(up[:, 0])])


def best_frame(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Distances (N,) [m] of points from where they were seen, after the best rigid motion."""
    a = points - points.mean(axis=0)
    b = seen - seen.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = Vt.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))]) @ U.T
    return np.asarray(np.linalg.norm(a @ R.T - b, axis=1))


def after_stationing(found: flexgen.Calibration, points: Points) -> tuple[np.ndarray, float]:
    """Distances (M,) [m] of the points after the stationing from where they were seen, and the
    zero of the second joint that the stationing points give [rad].
    """
    step = 1e-3
    moved = points.commands.copy()
    moved[:, SECOND] += step
    model = found.predict(points.commands)[:, 0]
    by_zero = (found.predict(moved)[:, 0] - model) / step
    center = model.mean(axis=0)
    first = points.of_station
    start = Rotation.align_vectors(
        points.prism[first] - points.prism[first].mean(axis=0),
        model[first] - model[first].mean(axis=0),
    )[0]
    where = np.clip(points.station, 0, None)
    count = int(points.station.max()) + 1
    vertical = np.array([0.0, 0.0, 1.0])

    def away(numbers: np.ndarray) -> np.ndarray:
        """Model less measurement (N, 3) [m]: of the zero, the tilt, and of each station its yaw
        [rad] and its place [m].
        """
        zero, tilt, rest = np.split(numbers, [1, 3])
        turned = rest[:count][where, None] * vertical
        place = rest[count:].reshape(count, 3)[where]
        level = Rotation.from_rotvec([*tilt, 0.0])
        own = Rotation.from_rotvec(turned).apply(model + zero[0] * by_zero - center)
        return np.asarray(start.apply(level.apply(own)) + place - points.prism)

    guess = np.zeros(3 + 4 * count)
    guess[3 + count :] = np.tile(points.prism[first].mean(axis=0), count)
    best = least_squares(lambda x: away(x)[first].ravel(), guess, x_scale="jac").x
    later = ~first & (points.station >= 0)
    return np.linalg.norm(away(best)[later], axis=1), float(best[0])


def main(folder: Path, out: Path) -> dict[str, float]:
    """Calibrate with flat.yaml; root mean square errors of the prism [m] in all files."""
    out.mkdir(parents=True, exist_ok=True)
    nominal = out / "column.toml"
    nominal.write_text(model_text(Urdf(folder / "trailblazer.urdf")), encoding="utf-8")
    points = {name: read_points(folder / f"{name}.yaml") for name in FILES}
    errors: dict[str, float] = {}
    for kind in ("without tilts", "with tilts"):
        used = {name: (one.commands.copy(), one.prism) for name, one in points.items()}
        if kind == "without tilts":
            for commands, _ in used.values():  # the mean of each file: the floor is not level
                commands[:, [0, 1, 3, 4]] = commands[:, [0, 1, 3, 4]].mean(axis=0)
        commands, prism = used["flat"]
        found = flexgen.calibrate(
            nominal,
            flexgen.StaticPoses(commands, prism[:, None], "flat.yaml"),
            free=FREE,
            priors=PRIORS,
            folds=0,
            progress=False,
        )
        print(f"{kind}: {found.sentence}; {len(found.kept)} kept, minimum: {found.converged}")
        for cause in found.causes[:3]:
            print(f"  possible cause: {cause}")
        for name, (commands, prism) in used.items():
            away = best_frame(found.predict(commands)[:, 0], prism)
            errors[f"{kind}, {name}"] = float(np.sqrt(np.mean(away**2)))
            print(f"  {name}: rms {1e3 * errors[f'{kind}, {name}']:.2f} mm, {len(away)} points")
        if kind == "without tilts":
            continue
        for name in FILES[1:]:
            apart, zero = after_stationing(found, points[name])
            errors[f"after stationing, {name}"] = float(np.sqrt(np.mean(apart**2)))
            print(
                f"  {name}, after stationing: rms {1e3 * errors[f'after stationing, {name}']:.2f} "
                f"mm, {len(apart)} points, zero of joint 2 {1e3 * zero:.2f} mrad"
            )
    return errors


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path("reports") / "hilti_column")
