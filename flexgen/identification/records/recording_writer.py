"""Recordings of a simulated experiment: written in the form in which those of real robots are
read.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from flexgen.base.files.atomic_files import atomic_file, follow_links, write_text
from flexgen.identification.experiments.excitation import Plan
from flexgen.model.elements import RobotModel


class RecordingWriter:
    """Writes the samples of a simulated experiment as recordings: a file for each, and their
    description.

    Parameters
    ----------
    folder : Path
        Made where it is missing.
    plan : Plan
    model : RobotModel
        The model of the plan; its file is named in the description.

    Call it with pose, realization, experiment, angles and torques (samples, n_m) and signals
    (samples, channels), as `measure` does; then `finish`.
    """

    def __init__(self, folder: Path, plan: Plan, model: RobotModel) -> None:
        self.folder = folder
        self.plan = plan
        self.model = model
        self.files: list[tuple[int, str]] = []
        follow_links(folder).mkdir(parents=True, exist_ok=True)

    def __call__(
        self,
        pose: int,
        realization: int,
        experiment: int,
        q_m: np.ndarray,
        tau_m: np.ndarray,
        signals: np.ndarray,
    ) -> None:
        """Write one recording."""
        name = f"pose{pose + 1}_realization{realization + 1}_experiment{experiment + 1}.npz"
        arrays = {"t": np.arange(len(q_m)) * self.plan.hardware.sample_s}
        for j in range(q_m.shape[1]):
            arrays |= {f"tau_{j + 1}": tau_m[:, j], f"q_{j + 1}": q_m[:, j]}
        arrays |= {f"s_{c + 1}": signals[:, c] for c in range(signals.shape[1])}
        reference = self.plan.poses[pose] + self.plan.reference(realization, experiment)
        times = -(-len(q_m) // len(reference))
        arrays |= {
            f"ref_{j + 1}": np.tile(x, times)[: len(q_m)] for j, x in enumerate(reference.T)
        }
        with atomic_file(self.folder / name) as stream:
            np.savez_compressed(stream, **arrays)  # type: ignore[arg-type]
        self.files.append((pose, name))

    def _model(self) -> str:
        """The file of the model, and its variant."""
        file = str(Path(self.model.file).resolve())
        return f"{file}@{self.model.variant}" if self.model.variant else file

    def finish(self) -> Path:
        """Write the description ``recordings.toml``; returns its path."""
        plan = self.plan
        rows = [
            f"model = {json.dumps(self._model())}",
            f"period_s = {plan.period_s!r}",
            'hold = "zoh"',
            f"delay_s = {plan.hardware.delay_s!r}",
            f"line_numbers = {plan.lines.tolist()}",
            '\n[time]\nname = "t"\nunit = "s"',
        ]
        for kind, unit, letter in (
            ("torque", "N m", "tau"),
            ("angle", "rad", "q"),
            ("reference", "rad", "ref"),
        ):
            for j, motor in enumerate(plan.motors):
                rows.append(
                    "\n"
                    f"[[{kind}]]\n"
                    f'motor = "{motor}"\n'
                    f'name = "{letter}_{j + 1}"\n'
                    f'unit = "{unit}"\n'
                    'side = "motor"'
                )
        units = {
            c: unit
            for s in self.model.sensors
            for c, unit in zip(s.channels, s.units, strict=True)
        }
        for c, sensor in enumerate(plan.sensors):
            rows.append(
                f'\n[[signal]]\nsensor = "{sensor}"\nname = "s_{c + 1}"\nunit = "{units[sensor]}"'
            )
        gains = {
            name: getattr(plan.controller, name)
            for name in ("position_gain", "speed_gain", "integral_gain")
        }
        rows.append(
            "\n[drive]"
            + "".join(f"\n{name} = {values.tolist()}" for name, values in gains.items())
        )
        for name in ("encoder_noise_rad", "encoder_resolution_rad", "torque_noise_Nm"):
            rows.append(f"{name} = {getattr(plan.hardware, name)!r}")
        joints = plan.poses @ np.linalg.inv(self.model.eta).T
        for pose, name in self.files:
            rows.append(f'\n[[recording]]\nfile = "{name}"\npose_rad = {joints[pose].tolist()}')
        return write_text(self.folder / "recordings.toml", "\n".join(rows) + "\n")
