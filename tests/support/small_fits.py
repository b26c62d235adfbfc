"""Fits of simulated records of small robots, one of each class of results; seconds of processor
time together.
"""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np

import flexgen
from flexgen.identification.commissioning.folder import Records
from flexgen.identification.estimator.fit_result import FitResult
from flexgen.identification.records.recording_writer import RecordingWriter
from flexgen.identification.rigid.rigid_file import identify_bodies

TRACKER = {"name": "p", "type": "tracker", "unit": "m"}
COGGING = {"motor.m1.cogging": {"harmonics": [6], "sin": [0.03]}}  # N m


def gears() -> FitResult:
    """Cogging of one motor, with further numbers that the record does not determine."""
    run = flexgen.control(flexgen.read("elbow", overrides=COGGING), sample_time=1e-3)
    return flexgen.identify_gears(
        "elbow", run.trajectory(), hysteresis=False, cogging=[6], free=[]
    )


def servo() -> FitResult:
    """The servo of a robot that is sent the planned motor angles."""
    run = flexgen.command_positions("elbow").today
    joints = np.linalg.inv(run.model.eta).T
    sent = run.reference.motion["q_m"] @ joints
    measured = run.nominal.measured @ joints
    return flexgen.identify_servo("elbow", flexgen.ServoRecord(run.reference.time, sent, measured))


def load() -> FitResult:
    """A load of 5 kg in addition to the payload of the model file."""
    robot = flexgen.read("manutec_r3", overrides={"payload.mass": 20.0})
    return flexgen.identify_load("manutec_r3", flexgen.solve(robot, verify=False).trajectory)


def poses() -> FitResult:
    """Zeros of two joints by a tracker with a noise of 20 um."""
    robot = flexgen.read("elbow", overrides={"sensor": [TRACKER]})
    rng = np.random.default_rng(0)
    q = rng.uniform(-1.5, 1.5, (30, 2))
    points = flexgen.tracker_positions(robot, q)
    points = points + 2e-5 * rng.normal(size=points.shape)
    return flexgen.calibrate(robot, flexgen.StaticPoses(q, points), free=["zeros"])


def commissioning() -> FitResult:
    """A gear, zeros and lengths by 20 static poses."""
    robot = flexgen.read("elbow", overrides={"sensor": [TRACKER]})
    soft = {"sensor": [TRACKER], "element.upper.dof.q1.gear.spring.stiffness": 6e6}
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 2))
    poses = flexgen.StaticPoses(
        q, flexgen.tracker_positions(flexgen.read("elbow", overrides=soft), q)
    )
    return flexgen.commission(robot, Records(poses=(("poses.csv", poses),)), curves=False)


def responses() -> FitResult:
    """Springs and dampers of gears by frequency responses with noise."""
    drives = flexgen.DriveHardware(encoder_noise_rad=1e-5, torque_noise_Nm=0.02)
    plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10, hardware=drives)
    return flexgen.identify("elbow", flexgen.frf(flexgen.measure(plan)), starts=1)


@cache
def _recording() -> Path:
    """A recording of elbow under multisines, described by a file."""
    plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)
    folder = Path(tempfile.mkdtemp(prefix="flexgen-fits-"))
    writer = RecordingWriter(folder / "recorded", plan, flexgen.read("elbow"))
    flexgen.measure(plan, raw=writer)
    return writer.finish()


def motions() -> FitResult:
    """Stiffnesses of gears by segments of a motion."""
    return flexgen.fit_motion("elbow", _recording(), free=["stiffness"])


def rigid() -> FitResult:
    """Bodies and frictions of the same robot, taken for rigid."""
    return identify_bodies(flexgen.read("elbow"), _recording(), progress=False)


def spring() -> FitResult:
    """Spring and hysteresis of a gear from a loop that is a straight line and two arcs."""
    t = np.linspace(0.0, 1.0, 200)
    d = 1e-3 * np.sin(4.0 * np.pi * t)
    data = {"time": t, "deflection": d, "torque": 4e4 * d + 2.0 * np.cos(4.0 * np.pi * t)}
    return flexgen.identify_spring("elbow", data, joint="q1")


FITS = (gears, spring, servo, load, poses, commissioning, responses, motions, rigid)


@cache
def small_fit(name: str) -> FitResult:
    """The fit of this name in `FITS`."""
    return next(make for make in FITS if make.__name__ == name)()
