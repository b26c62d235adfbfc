"""A beam at the flange of a robot that takes positions: what swings after a move, and shapers.

    python examples/elastic_payload.py [FILE.urdf#BASE:TIP]

Default: the robot of the model urdf_arm. The numbers of the beam are those of a drawing; the table
compares a move with and without input shapers.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import flexgen
from flexgen.studies.templates.new_model import new_model

BEAM = "beam:length=0.5,width=0.06,height=0.002,modulus=2e11,density=7850,damping=0.01"


def main(urdf: str) -> None:
    """Write the model of the robot with the beam, and print what vibrates after its first move."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "carrier.toml"
        file.write_text(new_model("carrier", urdf=urdf, payload=BEAM, folder=folder))
        robot = flexgen.read(file)
    mode = flexgen.compare_shapers(robot)
    print(mode.to_text())
    plain = mode.runs[0].vibration
    for run in mode.runs[1:]:
        share = run.vibration / plain
        print(f"{run.shaper} at {run.detuning:g} of the frequency: {share:.1%} of the vibration")


if __name__ == "__main__":
    own = Path(flexgen.read("urdf_arm").file).with_name("urdf_arm.urdf")
    main(sys.argv[1] if len(sys.argv) > 1 else str(own))
