"""From an unknown robot to its model: plan, experiment, frequency responses, parameters, and what
they are worth.

    python examples/identify_robot.py [FOLDER]

The robot is a Manutec r3 with 18 degrees of freedom whose springs and dampers differ from those of
the model file by up to 20 %. It is simulated: position and speed control at 2 kHz, encoder and
torque noise. The fit takes seconds, the verdict on the torques of a move about a minute. Report
and new model file are written to FOLDER, default reports/identified.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.model.elements import RobotModel

DRIVES = flexgen.DriveHardware(sample_s=5e-4, encoder_noise_rad=1e-4, torque_noise_Nm=0.02)


def nominal() -> RobotModel:
    """The model file, with viscous friction only: Coulomb friction needs `flexgen.refine`."""
    model = flexgen.read("manutec_r3_18")
    motors = (
        replace(motor, friction=replace(motor.friction, coulomb=0.0)) for motor in model.motors
    )
    return replace(model, motors=tuple(motors))


def unknown_robot(model: RobotModel) -> RobotModel:
    """The robot that is measured: other springs and dampers."""
    rng = np.random.default_rng(1)
    numbers = select(model, ["stiffness", "damping"])
    return with_values(model, {p.name: p.value * rng.uniform(0.8, 1.2) for p in numbers})


def main(folder: Path) -> None:
    """Run the chain and print its figures."""
    model = nominal()
    robot = unknown_robot(model)
    plan = flexgen.excite(model, poses=8, speed_rms=0.02, hardware=DRIVES)
    print(plan)
    experiment = flexgen.measure(plan, robot)
    found = flexgen.identify(model, flexgen.frf(experiment), source="examples/identify_robot.py")
    print(
        f"{found.status}: cost {found.cost:.2f}, {found.agreed} of {found.starts} starts, "
        f"{found.wall_s:.1f} s"
    )
    print(
        f"{'parameter':16} {'found':>12} {'true':>12} {'error, %':>9} {'sd, %':>7} "
        f"{'planned, %':>10}"
    )
    for true in select(robot, found.vector.names):
        value = found.values[true.name]
        sd = 100 * found.sd[true.name]
        error = 100 * (value / true.value - 1)
        planned = 100 * plan.predicted[true.name]
        print(
            f"{true.name:16} {value:12.6g} {true.value:12.6g} {error:9.3f} {sd:7.3f} "
            f"{planned:10.3f}"
        )
    print(f"new model file: {found.write(folder / 'manutec_r3_18_identified.toml')}")
    print(f"report: {found.report(folder)}")
    verdict = found.verdict("line", truth=robot)
    for row in verdict.rows:
        print(
            f"tool error of the move line, torques of the model {row.model}: "
            f"{1e6 * (row.quantile(0.5) or 0.0):.1f} um"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "reports/identified"))
