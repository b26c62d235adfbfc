"""The robots of benchmarks/commissioning, simulated in MuJoCo, against closed forms and flexgen.

They judge the way from records to feedforward, so that a difference must be due to the robot.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from toolchain import needs_compiler

import flexgen

pytest.importorskip("mujoco")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.commissioning import chains, datasheet, plant, records, robots, score

LINEAR = robots.Traits(soft=(1.0, 1.0), friction=0.0, error=0.0)
IDEAL = plant.Hardware(resolution=0.0, encoder_noise=0.0, torque_noise=0.0)


def potential(chain: chains.Chain, angles: np.ndarray) -> float:
    """Energy of gravity [J] at all angles of the axes, by the positions of the bodies."""
    place = np.zeros(3)
    turn = np.eye(3)
    energy = 0.0
    given = iter(angles)
    for link in chain.links:
        place = place + turn @ link.origin
        for axis in link.axes:
            turn = turn @ chains.rotation(np.array(axis.axis), next(given))
        energy += plant.GRAVITY * link.body.mass * (place + turn @ link.body.com)[2]
    load = chain.payload
    return float(energy + plant.GRAVITY * load.mass * (place + turn @ load.com)[2])


@pytest.mark.parametrize("name", robots.NAMES)
def test_springs_at_rest_carry_the_slope_of_the_potential(name: str) -> None:
    """Of gravity by positions of the bodies; with gears that stiffen with load."""
    true = robots.draw(name, 3)
    arm = plant.Plant(true, 0, IDEAL)
    motors = arm.rest(arm.ratio * np.array(true.home))
    angles = np.array(arm.data.qpos[arm.n :])
    step = 1e-5
    slope = np.array(
        [
            (potential(true, angles + step * e) - potential(true, angles - step * e)) / (2 * step)
            for e in np.eye(len(angles))
        ]
    )
    carried = np.array([-axis.stiffness * x for axis, x in zip(true.axes, angles, strict=True)])
    theta = arm.data.qpos[: arm.n]
    x = theta + arm.error * np.sin(arm.cycles * theta) - arm.data.qpos[arm.joints]
    gears = [axis.gear for axis in true.axes if axis.gear]
    carried[arm.joints - arm.n] = [
        g.stiffness * (d - (1 - g.soft) * g.width * np.tanh(d / g.width))
        for g, d in zip(gears, x, strict=True)
    ]
    assert_allclose(carried, slope, atol=1e-4)
    rate = 1.0 + arm.error * arm.cycles * np.cos(arm.cycles * theta)
    assert_allclose(motors, rate * carried[arm.joints - arm.n] / arm.ratio, atol=1e-6)


@pytest.mark.parametrize("name", robots.NAMES)
def test_inverse_dynamics_are_those_of_flexgen(name: str, tmp_path: Path) -> None:
    """At drawn states, with the same numbers; a mass that is 0.1 % wrong is found."""
    import mujoco

    true = robots.draw(name, 2, LINEAR)
    random = np.random.default_rng(0)
    arm = plant.Plant(true)
    count = len(true.axes)
    q, v, a = random.uniform(-1, 1, (3, count))
    arm.data.qpos[arm.n :] = q
    arm.data.qvel[arm.n :] = v
    arm.data.qacc[arm.n :] = a
    mujoco.mj_inverse(arm.model, arm.data)
    torques = (arm.data.qfrc_inverse + arm.data.qfrc_passive)[arm.n :]
    for factor in (1.0, 1.001):
        links = (*true.links[:-1], replace(true.links[-1], body=heavier(true, factor)))
        datasheet.write_model(replace(true, links=links), tmp_path / "true.toml")
        e = flexgen.derive(str(tmp_path / "true.toml")).function("inverse_dynamics")
        error = np.abs(np.array(e(q, v, a)).ravel() - torques).max() / np.abs(torques).max()
        assert error < 1e-10 if factor == 1.0 else error > 1e-6


def heavier(chain: chains.Chain, factor: float) -> chains.Body:
    """The last body with another mass."""
    last = chain.links[-1].body
    return replace(last, mass=factor * last.mass)


def test_energy_is_kept_to_the_order_of_the_step() -> None:
    """Without drives, friction and dampers; half the step has half the error."""
    import mujoco

    def undamped(axis: chains.Axis) -> chains.Axis:
        gear = None if axis.gear is None else replace(axis.gear, damping=0.0)
        return replace(axis, gear=gear, damping=0.0)

    true = robots.draw("three_axes", 1, replace(LINEAR, soft=(0.6, 0.7)))
    links = [replace(x, axes=tuple(undamped(axis) for axis in x.axes)) for x in true.links]
    true = replace(true, links=tuple(links))
    errors = []
    for steps in (4, 8):
        arm = plant.Plant(true, 0, replace(IDEAL, steps=steps))
        arm.rest(arm.ratio * np.array(true.home))
        arm.model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        energies = []
        for _ in range(round(0.1 / arm.step_s)):
            mujoco.mj_energyPos(arm.model, arm.data)
            mujoco.mj_energyVel(arm.model, arm.data)
            x = arm.data.qpos[: arm.n] - arm.data.qpos[arm.joints]
            lost = arm.missing * arm.width**2 * np.log(np.cosh(x / arm.width))
            gears = (0.5 * arm.stiffness * x**2 - lost).sum()
            energies.append(arm.data.energy.sum() + gears)
            arm.advance(np.zeros(arm.n))
        errors.append(np.ptp(energies))
        moved = arm.data.energy[1]
    assert errors[1] < 0.02 * moved
    assert errors[1] == pytest.approx(0.5 * errors[0], rel=0.3)


@needs_compiler
@pytest.mark.slow
def test_feedforward_of_the_true_numbers_follows_the_path(tmp_path: Path) -> None:
    """Torques sent earlier by the delay of the drives: the error is of the order of the step.

    The same torques for another stiffness, 2 % off, do not.
    """
    true = robots.draw("three_axes", 1, LINEAR)
    datasheet.write_model(true, tmp_path / "true.toml")
    given = score.as_feedforward(flexgen.solve(str(tmp_path / "true.toml"), "line"))

    def largest(steps: int, chain: chains.Chain) -> float:
        lead = IDEAL.sample_s * (1.5 - 0.5 / steps)  # the torque acts a sample later and is held
        ahead = np.clip(given.time + lead, given.time[0], given.time[-1])
        torques = [np.interp(ahead, given.time, u) for u in given.torques.T]
        shifted = replace(given, torques=np.column_stack(torques))
        arm = plant.Plant(chain, 0, replace(IDEAL, steps=steps))
        return score.score(arm, shifted, "line").largest

    coarse, fine = (largest(steps, true) for steps in (2, 4))
    assert fine < 2e-6 and fine < 0.7 * coarse
    softer = robots.draw("three_axes", 1, replace(LINEAR, gear=(0.735, 0.98)))
    assert largest(4, softer) > 2e-5


@needs_compiler
@pytest.mark.slow
def test_the_verbs_read_the_records(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Rigid motions, poses and responses; the ball is where the poses say, in another frame.

    So short a motion may leave no body below the payload: then the reason is named.
    """
    from flexgen.cli.main import main

    monkeypatch.chdir(tmp_path)
    datasheet.write_datasheet(robots.stated("three_axes"), Path("arm.toml"))
    records.write_records(
        plant.Plant(robots.draw("three_axes", 1)), tmp_path, records.QUICK, 1, workers=1
    )
    assert main("frf responses_1.toml --out frf.npz --quiet".split()) == 0
    words = "calibrate arm.toml poses.csv --free compliances --out new.toml --quiet"
    assert main(words.split()) == 0
    words = "identify arm.toml@joints rigid.toml --rigid --out rigid.new.toml --quiet"
    is_written = main(words.split()) == 0 or Path("rigid.new.toml").is_file()
    assert is_written or "given a payload of 20 kg" in capsys.readouterr().err
