"""The elbow arm: equations that a textbook prints, and what the torque of a move consists of."""

import numpy as np
from exhibit import Page, exhibit

import flexgen
from flexgen.base.numerics.evaluate import evaluate

QUESTION = "What does the torque of a two-link arm consist of, and is it that of the textbook?"
LITERATURE = """
The equations of the two-link arm by Lagrange's method, with these parts: M. Spong, S. \
Hutchinson, M. Vidyasagar,
Robot Modeling and Control, 2006, ch. 7. The table's last column is the difference of the \
formulas below, written
by hand for the angles of this arm, and of flexgen's function.
"""
# kg, m, m, kg m^2: masses, length, center of mass, inertia
M1 = 339.12
L1 = 1.150
C1 = 0.441
J1 = 88.67
M2 = 190.25
C2 = 0.465
J2 = 48.64
G = 9.81


def by_hand(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> dict[str, np.ndarray]:
    """Parts of the torque (n, 2) of motions (n, 2): q1 from the vertical, q2 the elbow, fore arm
    along x at zero.
    """
    s = -np.sin(q[:, 1])
    c = -np.cos(q[:, 1])
    m12 = J2 + M2 * (C2**2 + L1 * C2 * s)
    m11 = J1 + M1 * C1**2 + M2 * L1**2 + 2 * m12 - J2 - M2 * C2**2
    m22 = J2 + M2 * C2**2
    k = M2 * L1 * C2 * c
    fore = -M2 * G * C2 * np.cos(q.sum(axis=1))
    return {
        "inertia": np.stack(
            [m11 * a[:, 0] + m12 * a[:, 1], m12 * a[:, 0] + m22 * a[:, 1]], axis=1
        ),
        "velocity": np.stack(
            [k * (2 * v[:, 0] * v[:, 1] + v[:, 1] ** 2), -k * v[:, 0] ** 2], axis=1
        ),
        "gravity": np.stack([fore - (M1 * C1 + M2 * L1) * G * np.sin(q[:, 0]), fore], axis=1),
    }


def show(page: Page) -> None:
    """Parts of the torque along a joint move of rigid joints."""
    path = flexgen.plan("elbow@rigid", "joints")
    t = np.linspace(0.0, path.duration, 241)
    motion = flexgen.solve("elbow@rigid", "joints", verify=False).trajectory.at(t)
    q = motion["q_a"]
    v = motion["v_a"]
    a = motion["a_a"]
    parts = by_hand(q, v, a)
    total = sum(parts.values())
    function = flexgen.derive("elbow@rigid").function("inverse_dynamics")
    wrong = np.abs(evaluate(function, q, v, a)[0].reshape(-1, 2) - total)
    rows = [
        [
            f"q{j + 1}",
            *(float(np.abs(x[:, j]).max()) for x in (*parts.values(), total)),
            float(wrong[:, j].max()),
        ]
        for j in range(2)
    ]
    page.table(["axis", *(f"{name}, N m" for name in (*parts, "total")), "difference, N m"], rows)

    for j, axes in enumerate(page.figure().subplots(1, 2)):
        for name, part in (*parts.items(), ("total", total)):
            axes.plot(t, part[:, j], label=name, lw=2.2 if name == "total" else 1.2)
        axes.set_title(f"axis {j + 1}, arm side, N m")
        axes.set_xlabel("time, s")
    axes.legend()


if __name__ == "__main__":
    exhibit(__file__, QUESTION, LITERATURE, show)
