"""Kinematics and singularities of a six-axis arm."""

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.paths.inverse_kinematics.search import arm_parts

QUESTION = "In how many ways does a six-axis arm reach a pose, and where is it singular?"
LITERATURE = """
An arm with a spherical wrist has at most eight configurations at a pose: two of the shoulder, \
two of the elbow, two
of the wrist (D. Pieper, Stanford 1968). Its Jacobian's determinant is the product of three \
factors, one for each (B.
Siciliano et al., Robotics, 2009, sec. 3.3): it is singular with the wrist's axes 4 and 6 \
aligned, with the arm
stretched, and with the wrist over axis 1.
"""
POSE = (0.4, -0.5, 0.9, 0.5, 0.8, -0.3)  # rad
AXES = {"q3": 2, "q5": 4}


def show(page: Page) -> None:
    """All configurations of a pose; Jacobian and its parts while one axis turns."""
    equations = flexgen.derive("manutec_r3")
    pose = equations.function("forward_kinematics")
    jacobian = equations.function("jacobian")
    p, R = (values[0] for values in evaluate(pose, np.array(POSE)))
    rows = []
    for c in flexgen.kinematics(equations.model, p.ravel(), R):
        back, turned = (values[0] for values in evaluate(pose, c.q))
        wrong = max(float(np.abs(back.ravel() - p.ravel()).max()), float(np.abs(turned - R).max()))
        rows.append(
            [
                *(f"{x:.1f}" for x in np.degrees(c.q)),
                str(c.flags),
                c.nearest_singularity,
                c.distance,
                wrong,
            ]
        )
    page.table(
        [*(f"q{k}, deg" for k in range(1, 7)), "flags", "nearest", "distance", "error"], rows
    )

    angle = np.radians(np.linspace(-160, 160, 641))
    reach = 1.5  # m, about the reach of the arm: lengths of the Jacobian are divided by it
    figure = page.figure(3.8)
    for axes, (name, index) in zip(figure.subplots(1, 2, sharey=True), AXES.items(), strict=True):
        q = np.tile(POSE, (len(angle), 1))
        q[:, index] = angle
        J = evaluate(jacobian, q)[0].copy()
        J[:, :3] /= reach
        values = np.linalg.svd(J, compute_uv=False)
        ratio = values[:, -1] / values[:, 0]
        axes.plot(
            np.degrees(angle), ratio, color="k", lw=2.2, label="smallest / largest singular value"
        )
        for part in ("shoulder", "elbow", "wrist"):
            axes.plot(
                np.degrees(angle), np.abs([arm_parts(j)[part] for j in J]), lw=1.0, label=part
            )
        axes.set_yscale("log")
        axes.set_ylim(1e-3, 2)
        axes.set_xlabel(f"{name}, deg (the others as in the table's first row)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4)


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
