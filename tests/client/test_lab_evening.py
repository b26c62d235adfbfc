"""From two CSV files, static poses and a record of motion, to torques for the robot that was
measured: three commands.

The robot is MuJoCo's: its link is longer, the zero of a joint is wrong, springs are softer, and
its gears have hysteresis.
"""

from __future__ import annotations

import csv
import shutil
from pathlib import Path

import numpy as np
import pytest
from gear_records import motor_record, record_in_mujoco, with_noise
from hysteretic import ARCMIN, tool_error_in_mujoco, with_lost_motion
from scipy.optimize import root
from toolchain import needs_compiler

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.cli.main import main
from flexgen.exports.mujoco.mujoco import mjcf

pytestmark = [needs_compiler, pytest.mark.slow]
ZERO = np.array([0.0, 3e-3])  # rad: what the joints turn more than is commanded
TRUTH = {
    "position = [0.80, 0, 0]": "position = [0.803, 0, 0]",
    "stiffness = 4.0e5": "stiffness = 3.6e5",
    "stiffness = 1.5e5": "stiffness = 1.2e5",
}
SENSORS = """
[[sensor]]
name = "hand"
type = "tracker"
position = [0.0, 0.0, 0.0]
unit = "m"

[[sensor]]
name = "elbow"
type = "tracker"
element = "arm2"
position = [0.35, 0.1, 0.0]
unit = "m"
"""
RATIO = 100.0


class Still:
    """The robot of a model file in MuJoCo at rest."""

    def __init__(self, name: str) -> None:
        import mujoco

        self.mujoco = mujoco
        model = flexgen.read(name)
        self.m = mujoco.MjModel.from_xml_string(mjcf(model))
        self.d = mujoco.MjData(self.m)
        joints = [self.m.joint(c.name).id for c in model.coordinates]
        rotors = [self.m.joint(f"rotor.{motor.name}").id for motor in model.motors]
        self.arm = self.m.jnt_qposadr[joints]
        self.rotors = self.m.jnt_qposadr[rotors]
        self.dofs = self.m.jnt_dofadr[joints]

    def coordinates(self, q: np.ndarray) -> np.ndarray:
        """Those of the arm with the rotors at RATIO q: no torque on any of its joints."""
        self.d.qpos[self.rotors] = RATIO * q

        def torques(x: np.ndarray) -> np.ndarray:
            self.d.qpos[self.arm] = x
            self.d.qvel[:] = 0.0
            self.d.qacc[:] = 0.0
            self.mujoco.mj_inverse(self.m, self.d)
            return np.array(self.d.qfrc_inverse[self.dofs])

        found = root(torques, [*q, 0.0], tol=1e-12)
        assert np.abs(torques(found.x)).max() < 1e-6
        return np.asarray(found.x)

    def seen(self, q: np.ndarray) -> np.ndarray:
        """Positions of hand and elbow (6,) there."""
        self.coordinates(q)
        self.mujoco.mj_kinematics(self.m, self.d)
        body = self.d.body("arm2")
        elbow = body.xpos + body.xmat.reshape(3, 3) @ [0.35, 0.1, 0.0]
        return np.concatenate([self.d.site("tool").xpos, elbow])


def write_poses(robot: str, file: Path) -> None:
    """Forty commanded postures, and what trackers see with 20 um of noise."""
    rng = np.random.default_rng(0)
    q = np.column_stack([rng.uniform(-1.2, 1.6, 40), rng.uniform(-2.0, 2.0, 40)])
    still = Still(robot)
    seen = np.array([still.seen(each + ZERO) for each in q]) + 2e-5 * rng.normal(size=(40, 6))
    with file.open("w", newline="") as to:
        rows = csv.writer(to)
        rows.writerow(
            [
                "q1_rad",
                "q2_rad",
                *(f"{name}_{axis}_m" for name in ("hand", "elbow") for axis in "xyz"),
            ]
        )
        rows.writerows(np.hstack([q, seen]).tolist())


def tool_error(name: str, solution: flexgen.Solution) -> float:
    """Of the true robot in MuJoCo under the torques [m]."""
    path = solution.trajectory
    q_m = path["q_m"] + RATIO * ZERO  # the encoders show ZERO less
    q_a = path["q_a"].copy()
    q_a[0] = Still(name).coordinates(q_m[0] / RATIO)
    law, kept = with_lost_motion(name, ARCMIN, q_m[0] / RATIO - q_a[0][:2])
    shifted = Trajectory(
        path.time, {**path.channels, "q_m": q_m, "q_a": q_a}, path.ports, path.labels
    )
    return tool_error_in_mujoco(name, shifted, law, kept)


@pytest.mark.usefixtures("undrawn")
def test_three_commands_from_two_files_to_torques(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    shutil.copy(flexgen.read("planar5_nmp").file, "arm.toml")
    text = Path("arm.toml").read_text(encoding="utf-8")
    Path("arm.toml").write_text(text + SENSORS, encoding="utf-8")
    for old, new in TRUTH.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    Path("truth.toml").write_text(text, encoding="utf-8")
    truth = str(tmp_path / "truth.toml")
    write_poses(truth, Path("poses.csv"))
    record = record_in_mujoco(
        truth, lambda start: with_lost_motion(truth, ARCMIN, start), 16.0, step=5e-4
    )
    record = motor_record(
        flexgen.read(truth), record.time, record["q_m"] - RATIO * ZERO, record["tau_m"]
    )
    with_noise(record, 1e-4).save("record.csv")

    words = (
        "calibrate arm.toml poses.csv --free zeros,placements,compliances --prior tracker=1e-6 "
    )
    words += "--world measurement --out calibrated.toml --report first --quiet"
    assert main(words.split()) == 0
    words = (
        "identify-gears calibrated.toml@calibrated record.csv --out identified.toml --report "
        "second --quiet"
    )
    # model error: the poses do not determine the zero of q2; the file is written
    assert main(words.split()) == 1
    assert main("solve identified.toml@identified --move line --report third --quiet".split()) == 0
    for folder in ("first", "second", "third"):
        assert "<svg" in next(Path(folder).rglob("*.html")).read_text(encoding="utf-8")
    errors = [
        tool_error(truth, flexgen.solve(name, "line"))
        for name in ("arm.toml", "identified.toml@identified")
    ]
    assert errors[0] > 5e-3 and errors[1] < 0.15 * errors[0]
