"""Controllability: can the motors move every coordinate of an elastic arm, also those without a
motor?
"""

import numpy as np
from exhibit import Page, exhibit

import flexgen

QUESTION = "Do the motors reach every vibration of the arm, in every pose?"
LITERATURE = """
M. Hautus, Indag. Math. 31, 1969: a linear system is controllable where [s - A, B] has full rank \
at every eigenvalue
s. The table has the smallest singular value of this matrix, scaled, and the rank of Kalman's \
matrix,
another route: it is the number of states where the robot is controllable. Regular: the inverse \
dynamics exists at the
pose. The picture shows that the two differ: where the arm is stretched or folded it is \
controllable, but no torque
gives the tool every acceleration.
"""
MODELS = ("elbow", "four_mass", "planar5_mp", "planar5_nmp", "beam_arm", "manutec_r3")


def kalman(linear: object) -> int:
    """Rank of [B, A B, ...] in balanced units of time, by orthogonal steps."""
    A, B = linear.state_space()
    n = len(A)
    scale = np.concatenate([np.ones(n // 2), np.full(n // 2, linear.rate)])
    A = (A * scale) / scale[:, None] / linear.rate
    X = B / scale[:, None]
    basis = np.zeros((n, 0))
    for _ in range(n):
        X = X / np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        X = X - basis @ (basis.T @ X)
        X = X - basis @ (basis.T @ X)
        U, values, _ = np.linalg.svd(X, full_matrices=False)
        X = U[:, values > 1e-9]
        if not X.shape[1]:
            break
        basis = np.hstack([basis, X])
        X = A @ X
    return basis.shape[1]


def show(page: Page) -> None:
    """Hautus' number and Kalman's rank of models; over the angle of the second joint of the planar
    arm.
    """
    rows = []
    for name in MODELS:
        analysis = flexgen.analyze(name)
        rows.append(
            [
                name,
                2 * len(analysis.linear.M),
                kalman(analysis.linear),
                analysis.solvability.controllability,
            ]
        )
        rows[-1].append("yes" if analysis.solvability.regular else "no")
    page.table(["model", "states", "rank", "Hautus", "regular"], rows)

    equations = flexgen.derive("planar5_nmp")
    angle = np.radians(np.linspace(-180, 180, 49))
    found = [flexgen.analyze(equations, (0.3, q2)).solvability for q2 in angle]
    axes = page.figure(3.0).subplots()
    axes.plot(
        np.degrees(angle), [s.controllability for s in found], label="controllability (Hautus)"
    )
    axes.plot(
        np.degrees(angle),
        [s.singular_values[-1] for s in found],
        label="regularity of the inverse dynamics",
    )
    axes.set_ylim(0, 0.4)
    axes.set_xlabel("second joint of planar5_nmp, deg (0: stretched)")
    axes.legend(loc="upper left")


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
