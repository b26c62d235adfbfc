"""Parameters of a motor bench from a recording, by frequency responses (two kinds of residuals)
and in time.

    python examples/motor_bench/identify_bench.py FOLDER

FOLDER has MultisineTypeA.mat, a public recording of the two-mass drive of the Hori-Fujimoto
laboratory; bench.toml and recordings.toml are copied to it. The picture responses.svg is written
there.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import flexgen
from flexgen.identification.motions.motion_fit import fit_motion
from flexgen.identification.records.experiment_file import read_experiment
from flexgen.views.plots.identification import response_grid

FREE = ["stiffness", "damping", "m1.viscous", "m1.inertia", "load.inertia_zz", "delay"]
SEGMENT = 0.05  # s


def main(folder: Path) -> None:
    """Fit, print and draw."""
    for name in ("bench.toml", "recordings.toml"):
        if not (folder / name).exists():
            shutil.copy(Path(__file__).with_name(name), folder / name)
    description = folder / "recordings.toml"
    data = flexgen.frf(read_experiment(description))
    routes = {
        residual: flexgen.identify(
            folder / "bench.toml", data, free=FREE, residual=residual, progress=False
        )
        for residual in ("nls", "lls")
    }
    in_time = fit_motion(None, description, free=FREE, segment_s=SEGMENT, progress=False)
    print(f"{'parameter':18} {'unit':>16} {'nls':>10} {'lls':>10} {'time':>10}")
    for unknown in in_time.vector.unknowns:
        name = unknown.name
        values = [found.values[name] for found in (*routes.values(), in_time)]
        print(
            f"{name:18} {unknown.parameter.unit:>16} "
            + " ".join(f"{value:10.4g}" for value in values)
        )
    print(
        f"fit of the motor angle in the time domain: {in_time.fit_percent[0]:.1f} %, "
        f"{in_time.segments} segments"
    )
    picture = folder / "responses.svg"
    response_grid(data, routes["nls"]).savefig(picture)
    print(f"wrote {picture}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
