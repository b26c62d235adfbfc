"""Faults that free numbers of a calibration hide: scales, lengths, payloads.

The poses are those of an arm in closed form: a turret and two links in its vertical plane, with
gears that deflect under the weight of links and payload. Nothing of it is flexgen's.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen

pytestmark = needs_compiler

NOISE = 2e-5  # m
GRAVITY = 9.81


@dataclass(frozen=True)
class Arm:
    """Numbers that poses at rest depend on; stiffnesses 20 and 30 % lower than in the file."""

    upper: float = 0.9
    marker: tuple[float, float, float] = (0.8, 0.05, 0.1)
    masses: tuple[float, float] = (60.0, 35.0)
    centers: tuple[float, float] = (0.4, 0.3)
    payload: float = 20.0
    place: tuple[float, float, float] = (0.75, 0.0, 0.1)
    stiffness: tuple[float, float] = (4.0e5, 2.1e5)

    def positions(self, q: np.ndarray) -> np.ndarray:
        """Of the marker (N, 1, 3) at commands (N, 3)."""
        out = []
        for turn, first, second in q:
            lift = np.zeros(2)
            for _ in range(30):
                a = first + lift[0]
                b = a + second + lift[1]
                fore = self.masses[1] * self.centers[1] * np.cos(b)
                fore += self.payload * (self.place[0] * np.cos(b) + self.place[2] * np.sin(b))
                whole = self.masses[0] * self.centers[0] * np.cos(a) + fore
                whole += (self.masses[1] + self.payload) * self.upper * np.cos(a)
                lift = GRAVITY * np.array([whole, fore]) / self.stiffness
            x, y, z = self.marker
            r = self.upper * np.cos(a) + x * np.cos(b) + z * np.sin(b)
            height = -self.upper * np.sin(a) - x * np.sin(b) + z * np.cos(b)
            c = np.cos(turn)
            s = np.sin(turn)
            out.append([[r * c - y * s, r * s + y * c, height]])
        return np.array(out)


def file_text() -> str:
    """Model file of the arm, with the stiffnesses of a catalogue."""
    lines = ['name = "arm"', "gravity = [0, 0, -9.81]", "home_deg = [0, -40, 80]"]
    bodies = ((40.0, 0.0), (60.0, 0.4), (35.0, 0.3))
    gears = (("q1", "z", 5e5), ("q2", "y", 5e5), ("q3", "y", 3e5))
    for k, ((mass, center), (name, axis, stiffness)) in enumerate(zip(bodies, gears, strict=True)):
        turn = [int(axis == other) for other in "xyz"]
        lines += ["[[element]]", f'name = "link{k + 1}"']
        lines += ["origin = { position = [0.9, 0, 0] }"] if k == 2 else []
        lines += [
            f"body = {{ mass = {mass}, com = [{center}, 0, 0], inertia = [1.0, 5.0, 5.0] }}",
            f'[[element.dof]]\nname = "{name}"\ntype = "rotation"\naxis = {turn}',
            'gear = { type = "elastic", side = "arm", damping = 100.0, spring = { type = "linear",'
            f" stiffness = {stiffness} }} }}",
            f'[[motor]]\nname = "m{k + 1}"\ndrives = "{name}"\nratio = 100.0\ninertia = 1e-3',
        ]
    lines += ["[tool]", "position = [0.8, 0.0, 0.0]"]
    lines += ["[payload]", "mass = 20.0", "com = [0.75, 0.0, 0.1]"]
    lines += ['[[sensor]]\nname = "ball"\ntype = "tracker"\nelement = "tool"\nunit = "m"']
    lines += ["position = [0.0, 0.05, 0.1]", '[output]\ntype = "tool_position"']
    return "\n".join(lines)


def calibrated(folder: Path, arm: Arm, scale: float = 1.0) -> flexgen.Calibration:
    """Calibration with poses of this arm, whose positions are too large by a factor."""
    file = folder / "arm.toml"
    file.write_text(file_text(), encoding="utf-8")
    random = np.random.default_rng(4)
    q = random.uniform([-2.0, -1.6, 0.2], [2.0, 0.3, 2.2], (60, 3))
    seen = scale * arm.positions(q) + NOISE * random.normal(size=(60, 1, 3))
    return flexgen.calibrate(file, flexgen.StaticPoses(q, seen), folds=0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arm", "scale", "name", "value", "within"),
    [
        (Arm(), 0.984, "the scale of the measured positions", (0.984,), 1e-3),
        (Arm(upper=0.93), 1.0, "link3.x", (0.03,), 1e-3),
        (Arm(place=(0.3, 0.0, 0.5)), 1.0, "payload.com", (0.3, 0.0, 0.5), 0.05),
    ],
)
def test_faults_in_free_numbers_are_named(
    tmp_path: Path, arm: Arm, scale: float, name: str, value: tuple[float, ...], within: float
) -> None:
    """With the value that is true; the fit itself hides them: its errors are those of noise."""
    found = calibrated(tmp_path, arm, scale)
    assert float(found.errors.mean()) < 2 * NOISE
    named = {cause.name: cause for cause in found.causes}
    assert name in named
    assert np.allclose(named[name].value, value, rtol=0.0, atol=within)
    assert named[name].by_tolerances and f"possible cause: {named[name]}" in found.to_text()


@pytest.mark.slow
def test_what_the_poses_hide_is_stated(tmp_path: Path) -> None:
    """A payload's mass, which compliances replace, with the limit; none is named in right poses.

    The payload is wrong by less than the limit.
    """
    right = calibrated(tmp_path, Arm())
    assert right.causes == ()
    wrong = calibrated(tmp_path, Arm(payload=32.0))
    for found in (right, wrong):
        limits = {limit.name: limit for limit in found.not_visible}
        assert limits["payload.mass"].size > 12.0
        assert "a wrong payload.mass by less than" in found.to_text()
        assert found.to_dict()["not_visible"][0]["unit"] == "kg"


@pytest.mark.slow
def test_an_offset_of_the_poses_is_named(tmp_path: Path) -> None:
    """0.1 rad in a joint whose zero is free, and in one whose zero is not."""
    file = tmp_path / "arm.toml"
    file.write_text(file_text(), encoding="utf-8")
    random = np.random.default_rng(4)
    q = random.uniform([-2.0, -1.6, 0.2], [2.0, 0.3, 2.2], (60, 3))
    seen = Arm().positions(q) + NOISE * random.normal(size=(60, 1, 3))
    off = flexgen.StaticPoses(q + np.array([0.0, 0.0, 0.1]), seen)
    for free in (None, ["compliances", "placements"]):
        more = {} if free is None else {"free": free}
        found = flexgen.calibrate(file, off, folds=0, **more)
        assert "q3.zero" in [cause.name for cause in found.causes]
