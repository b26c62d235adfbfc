"""Torques of a rigid fit: those of the file that it writes, by equations that share no code with
the fit; and the errors of this file.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigid_records import DAMPING, STIFFNESS, H, derivative, described, recorded, soft, swung

import flexgen
from flexgen.base.numerics.low_pass import LowPass
from flexgen.base.numerics.polynomial_filter import smooth_forces
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.records.gear_deflection import GearDeflection
from flexgen.identification.rigid import rigid_body
from flexgen.identification.rigid.rests_of_motors import MOVING
from flexgen.identification.rigid.rigid_body import RigidFit, identify_rigid
from flexgen.identification.rigid.rigid_file import RigidIdentification, identify_bodies
from flexgen.identification.rigid.rigid_regressor import Motion
from flexgen.model.elements import Dof, Element, RobotModel


def written(found: RigidFit, folder: Path) -> RobotModel:
    """The model of the file that the fit writes, in the variant that has its numbers."""
    file = RigidIdentification(found, {}, {}, "").write(folder / "new.toml")
    return flexgen.read(f"{file}@identified" if found.file.overrides else file)


def arm_torques(model: RobotModel, state: tuple[np.ndarray, ...]) -> np.ndarray:
    """Torques of the gears (n, n_g) for links with these angles, speeds and accelerations."""
    rigid = flexgen.derive(model).function("inverse_dynamics").map(len(state[0]))
    arm = np.array(rigid(*(x.T for x in state))).T
    for i, coordinate in enumerate(model.coordinates):
        dof = coordinate.dof
        assert dof is not None
        for k, (sine, cosine) in enumerate(dof.counterbalance, 1):
            angle = k * state[0][:, i]
            arm[:, i] -= sine * np.sin(angle) + cosine * np.cos(angle)
        arm[:, i] += smooth_forces(dof.friction.viscous * state[1][:, i])
    return arm


def motor_torques(model: RobotModel, arm: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
    """Torques of the motors (n, n_m): loads, rotors, and friction through the filter of the
    accelerations.
    """
    speed = v @ model.eta.T
    total = arm @ np.linalg.inv(model.eta)
    for j, motor in enumerate(model.motors):
        law = motor.friction
        level = law.coulomb + law.stribeck / np.cosh(np.minimum(law.alpha * speed[:, j], 300.0))
        total[:, j] += motor.inertia * (a @ model.eta.T)[:, j] + law.viscous * speed[:, j]
        total[:, j] += smooth_forces(level * np.tanh(law.beta * speed[:, j])) + law.offset
    return total


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_torques_are_those_of_the_written_file(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drawn payload and friction of a joint, a counterbalance, and a viscous friction below zero
    in the record, which no file has. Planted: the torques have it.
    """
    random = np.random.default_rng(seed)
    text = Path(flexgen.read("elbow@rigid").file).read_text(encoding="utf-8")
    mass = random.uniform(5, 60)
    com = random.uniform(-0.1, 0.1, 3).tolist()
    load = f"\n[payload]\nmass = {mass}\ncom = {com}\n"
    (tmp_path / "arm.toml").write_text(text + load, encoding="utf-8")
    joint = {"element.fore.dof.q2.friction": {"viscous": random.uniform(50, 200)}}
    model = flexgen.read(f"{tmp_path / 'arm.toml'}@rigid", overrides=joint)
    motion = swung(model)
    speed = motion.derivatives[1] @ model.eta.T
    more = random.uniform(-0.06, -0.04) * speed * [1, 0] + random.normal(size=speed.shape)
    found = identify_rigid(
        model, [replace(motion, tau_m=motion.tau_m + more)], counterbalance={"q1": 1}, parts=0
    )
    assert found.friction[0, 0] < 0 and (found.lags != 0).all()
    again = written(found, tmp_path)
    assert again.motors[0].friction.viscous == 0.0 and again.payload == model.payload
    other = swung(model, 400)
    q, v, a = other.derivatives
    expected = motor_torques(again, arm_torques(again, (q, v, a)), v, a)
    size = np.std(expected, axis=0)
    assert (np.abs(found.torques(other) - expected) < 1e-9 * size).all()
    monkeypatch.setattr(rigid_body, "in_a_file", lambda model, friction, fades: friction)
    assert np.abs(found.torques(other) - expected).max() > 0.01 * size[0]


def slow(x: np.ndarray) -> np.ndarray:
    """The first 100 lines of the Fourier series of a period (n, ...): below 10 Hz."""
    lines = np.fft.rfft(x, axis=0)
    lines[100:] = 0.0
    return np.fft.irfft(lines, len(x), axis=0)


@pytest.mark.slow
def test_gears_bend_as_in_the_written_file(tmp_path: Path) -> None:
    """Stiffnesses in the file that are not those of the record, along a periodic motion of the
    motors; deflections by rounds with Fourier derivatives. Planted: deflections of the record.
    """
    given = 1.5 * STIFFNESS
    found = identify_rigid(soft(given), [recorded(6e-3, 0.05, k) for k in range(2)], parts=0)
    again = written(found, tmp_path)
    motion = recorded(0.0, 0.0, 7)
    rigid = replace(flexgen.read("elbow@rigid"), elements=rigid_elements(again))
    rigid = replace(rigid, payload=again.payload)
    damping = 0.01 * DAMPING  # as the model of the fit
    v = derivative(motion.q, 1)
    a = derivative(motion.q, 2)

    def torques(stiffness: np.ndarray) -> np.ndarray:
        arm = np.zeros_like(motion.q)
        for _ in range(8):
            bend = slow((arm - damping / stiffness * derivative(arm, 1)) / stiffness)
            links = motion.q - bend
            arm = arm_torques(rigid, (links, derivative(links, 1), derivative(links, 2)))
        return motor_torques(again, arm, v, a)

    expected = torques(given)
    inner = slice(100, -100)
    size = np.std(expected, axis=0)

    def away(other: np.ndarray) -> np.ndarray:
        error = np.sqrt(((found.torques(motion) - other)[inner] ** 2).mean(axis=0))
        return np.asarray(error / size)

    assert (away(expected) < 4e-4).all()
    assert (away(torques(STIFFNESS)) > 3e-3).any()


def rigid_elements(model: RobotModel) -> tuple[Element, ...]:
    """The elements of a model whose gears do not bend."""

    def stiff(dof: Dof) -> Dof:
        return dof if dof.gear is None else replace(dof, gear=replace(dof.gear, spring=None))

    return tuple(replace(e, dofs=tuple(map(stiff, e.dofs))) for e in model.elements)


def resting(model: RobotModel) -> Motion:
    """Moves with rests, with a drawn friction at rest."""
    moves = swung(model, 3000)
    phase = np.clip(np.mod(moves.t, 2.0) / 1.2, 0.0, 1.0)
    go = phase**4 * (35 - 84 * phase + 70 * phase**2 - 20 * phase**3)
    turn = np.where(np.mod(moves.t // 2.0, 2) == 0, go, 1 - go)
    q = np.stack([0.8 * turn - 0.2, 0.5 - 1.1 * turn], axis=1)
    state = (q, np.gradient(q, H, axis=0), np.gradient(np.gradient(q, H, axis=0), H, axis=0))
    arm = arm_torques(model, state)
    inertia = np.array([m.inertia for m in model.motors])
    tau = arm @ np.linalg.inv(model.eta) + inertia * (state[2] @ model.eta.T)
    still = np.abs(state[1]) < 1e-9
    held = np.random.default_rng(0).uniform(-1, 1, (len(q) // 500 + 1, 2))
    rest = held[np.minimum(np.arange(len(q)) // 500, len(held) - 1)]
    friction = np.array([4.0, 3.0]) * np.where(still, rest, np.sign(state[1]))
    return Motion(moves.t, q, tau + friction)


def test_errors_of_the_file_have_friction_at_rest() -> None:
    """Friction at rest is any torque: the bodies do not see it, feedforward with the file does.
    The error of the file is that of its torques behind a filter of the same limit.
    """
    model = flexgen.read("elbow@rigid")
    motion = resting(model)
    found = identify_rigid(model, [motion], parts=0)
    bodies = found.relative_errors(motion)
    file = found.model_errors(motion)
    assert (bodies < 0.01).all() and (file > 2 * bodies).any()
    low = LowPass(H, found.limit_hz)
    error = low(motion.torques - found.torques(motion))
    torque = low(motion.torques)
    joint = np.abs(motion.derivatives[1])
    moving = low.kept(joint > MOVING * joint.max())
    for j in range(2):
        at = moving[:, j]
        expected = np.sqrt((error[at, j] ** 2).mean()) / torque[at, j].std()
        assert file[j] == pytest.approx(expected, rel=0.05)


def test_a_poorly_validated_fit_marks_its_file_and_gives_no_interval(tmp_path: Path) -> None:
    model = flexgen.read("elbow@rigid")
    found = identify_bodies(model, described(tmp_path, "one", swung(model), model))
    assert list(found.model_errors) == ["fitted"]
    text = found.to_text()
    assert "error of the bodies" in text and "error of the file" in text
    assert found.to_dict()["model_errors"] == found.model_errors
    fit = replace(found.fit, status=FitStatus.POORLY_VALIDATED)
    marked = RigidIdentification(fit, {}, {}, "").write(tmp_path / "bad.toml")
    assert "# Status: poorly validated." in marked.read_text(encoding="utf-8")
    good = found.write(tmp_path / "good.toml").read_text(encoding="utf-8")
    assert "Status" not in good
    gear = GearDeflection(5e6, (4e6, 6e6), 0.0, 0.9).without_interval("poorly validated")
    assert gear.interval is None
    assert gear.sentence == "5e+06, no interval: the fit of the torques is 'poorly validated'"
