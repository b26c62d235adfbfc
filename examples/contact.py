"""Force of a tool that runs into a wall, under a stiff and under compliant laws:
docs/pictures/contact.svg.

python examples/contact.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

import flexgen
from flexgen.views.plots import canvas as cv

PICTURE = Path(__file__).resolve().parent.parent / "docs" / "pictures" / "contact.svg"
LAWS = {
    "P-PI": "ppi",
    "impedance, 20 kN/m": flexgen.Impedance(tool_stiffness=(2e4, 2e4, 2e4)),
    "impedance, 4 kN/m": flexgen.Impedance(tool_stiffness=(4e3, 4e3, 4e3)),
}
SAMPLE_S = 1e-3


def runs() -> dict[str, flexgen.ControlRun]:
    """The line of planar5_nmp, with a wall 10 mm before its end."""
    solution = flexgen.solve("planar5_nmp", "line")
    begin = solution.trajectory["y_ref"][0]
    end = solution.trajectory["y_ref"][-1]
    wall = flexgen.Wall(
        (*end, 0.0), (*(begin - end), 0.0), stiffness=1e5, damping=500.0, gap=-0.01
    )
    return {
        name: flexgen.control(
            "planar5_nmp", solution=solution, controller=law, wall=wall, sample_time=SAMPLE_S
        )
        for name, law in LAWS.items()
    }


@cv.apply_style
def draw(found: dict[str, flexgen.ControlRun]) -> cv.Figure:
    """Force over time."""
    figure = cv.new_figure(
        cv.WIDTH, 3.2, "planar5_nmp: a wall of 100 kN/m, 10 mm before the end of its line"
    )
    ax = figure.subplots()
    for (name, run), color in zip(found.items(), (cv.RED, cv.BLUE, cv.GREEN), strict=True):
        force = run.nominal.contact
        assert force is not None
        ax.plot(run.reference.time, np.linalg.norm(force, axis=1), color=color, label=name)
    ax.set(
        xlabel="time, s",
        ylabel="force of the wall, N",
        xlim=(0.3, found["P-PI"].reference.time[-1]),
    )
    ax.legend()
    return figure


def main() -> None:
    """Print the figures, and write the picture."""
    found = runs()
    for name, run in found.items():
        force = run.nominal.contact
        assert force is not None
        size = np.linalg.norm(force, axis=1)
        margin = flexgen.check_passivity(run).margin
        print(
            f"{name}: largest {size.max():.0f} N, at the end {size[-1]:.0f} N, damping at the "
            f"tool {margin:.3g} N s/m"
        )
    cv.save(draw(found), PICTURE)


if __name__ == "__main__":
    main()
