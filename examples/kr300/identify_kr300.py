"""Bodies, friction and gear stiffness of a KUKA KR300 from two recorded motions.

    python examples/kr300/identify_kr300.py FOLDER

FOLDER has kr300_run_A.npz and kr300_run_B.npz, public recordings (J. Weigand et al., TU
Kaiserslautern); the descriptions run_a.toml and run_b.toml are copied to it. Both runs are fitted,
since a counterbalance that is fitted to one run alone fails on the other. The errors on both are 3
to 11 % below 2.5 Hz, 5 to 10 % on quarters that were left out of the fit. The gears found, 9.3e6
and 5.5e6 N m/rad, exclude those of the model file, 7.5e6 and 4.1e6, with their 90 % intervals. The
picture torques.svg is written there.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from flexgen.identification.records.description import read_description
from flexgen.identification.records.gear_deflection import gear_deflection
from flexgen.identification.rigid.rigid_body import RigidFit, identify_rigid
from flexgen.identification.rigid.rigid_file import motions_of
from flexgen.identification.rigid.rigid_regressor import Motion

COUNTERBALANCE = {"q2": 2}  # harmonics of the angle in the torque of the second motor


def draw(found: RigidFit, motion: Motion, picture: Path) -> None:
    """Measured and fitted torques of one run."""
    motors = [motor.name for motor in found.model.motors]
    figure = Figure(figsize=(9.0, 1.4 * len(motors)), layout="constrained")
    FigureCanvasAgg(figure)
    fitted = found.torques(motion)
    for j, ax in enumerate(figure.subplots(len(motors), 1, sharex=True)):
        ax.plot(motion.t, motion.torques[:, j], lw=1.2, label="measured, filtered")
        ax.plot(motion.t, fitted[:, j], lw=0.9, label="model")
        ax.set_ylabel(f"{motors[j]}, N m")
    ax.set_xlabel("time, s")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper right", ncols=2)
    figure.savefig(picture)


def main(folder: Path) -> None:
    """Fit, print and draw."""
    for name in ("run_a.toml", "run_b.toml"):
        if not (folder / name).exists():
            shutil.copy(Path(__file__).with_name(name), folder / name)
    data = [read_description(folder / name) for name in ("run_a.toml", "run_b.toml")]
    motions = [motion for one in data for motion in motions_of(one)]
    model = data[0].model
    found = identify_rigid(model, motions, counterbalance=COUNTERBALANCE)
    print(f"{found.base_parameters} base parameters of {len(found.pi)} numbers")
    print("error over the standard deviation of the torque, %, of samples that move")
    for run, motion in zip("AB", motions, strict=True):
        print(
            f"  run {run}: " + " ".join(f"{100 * x:5.1f}" for x in found.relative_errors(motion))
        )
    torques = np.vstack([found.gear_torques(motion) for motion in motions])
    q = np.vstack([motion.q for motion in motions])
    links = np.vstack([run.signals for one in data for _, run in one.recordings])
    t = data[0].recordings[0][1].sample_s * np.arange(len(q))
    print("stiffness of the gears, N m/rad, arm side, 90 % interval")
    for j in range(links.shape[1]):
        print(
            f"  {model.coordinates[j].name}: "
            f"{gear_deflection(t, q[:, j], links[:, j], torques[:, j]).sentence}"
        )
    draw(found, motions[1], folder / "torques.svg")
    print(f"wrote {folder / 'torques.svg'}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
