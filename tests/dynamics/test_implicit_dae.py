"""`Equations.dae` against forward dynamics, its index, its names; and the page of all
functions.
"""

from __future__ import annotations

import re
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import flexgen
from flexgen.dynamics.mechanics.equations import BUILDERS
from flexgen.dynamics.mechanics.signatures import PORTS, PYTHON_PORTS, PYTHON_TABLE, TABLE
from flexgen.inversion.comparison.bdf import stable_order

PAGE = Path(__file__).parents[2] / "docs" / "equations.md"


@pytest.mark.parametrize("name", ["elbow", "planar5_nmp", "beam_arm", "manutec_r3", "four_mass"])
def test_the_dae_holds_on_the_forward_dynamics(name):
    """Accelerations of `forward_dynamics` (L D L' of the mass matrix), gear torques and output
    satisfy all rows.
    """
    equations = flexgen.derive(name)
    model = equations.model
    dae = equations.dae()
    rng = np.random.default_rng(2)
    n = model.dof
    n_a = model.n_a
    i_m = list(model.i_m)
    assert dae.function.name_in() == ["xdot", "x", "z", "u"] and dae.function.size1_in(
        1
    ) == 2 * n == len(dae.x)
    sizes = (len(dae.x), len(dae.z), len(dae.u), len(dae.rows))
    assert sizes == tuple(map(len, (dae.x_units, dae.z_units, dae.u_units, dae.row_units)))
    for _ in range(3):
        x = 0.3 * rng.normal(size=2 * n)
        side = np.abs(model.eta).max(axis=1)[i_m]
        x[n_a:n] = (model.eta @ x[:n_a][list(model.i_g)])[i_m] + 1e-3 * side * rng.normal(
            size=len(i_m)
        )
        u = rng.normal(size=model.n_m)
        q_m = np.zeros(model.n_m)
        v_m = np.zeros(model.n_m)
        q_m[i_m] = x[n_a:n]
        v_m[i_m] = x[n + n_a :]
        state = (x[:n_a], x[n : n + n_a], q_m, v_m)
        a_a, a_m = (
            np.array(part).ravel() for part in equations.function("forward_dynamics")(*state, u)
        )
        xdot = np.r_[x[n:], a_a, a_m[i_m]]
        z = np.array(
            ca.vertcat(
                equations.function("gear_torque")(*state), equations.function("output")(x[:n_a])
            )
        )
        rows = np.array(dae.function(xdot, x, z, u)).ravel()
        size = np.abs(np.array(dae.function(0 * xdot, x, 0 * z, u))).max()
        assert np.abs(rows).max() <= 1e-10 * max(size, 1.0)
        wrong = np.array(dae.function(xdot, x, z, u + 1.0)).ravel()  # planted: another torque
        assert np.abs(wrong).max() > 1e-3


def test_the_dae_has_index_one():
    dae = flexgen.derive("planar5_nmp").dae()
    symbols = [
        ca.SX.sym(name, dae.function.size1_in(k)) for k, name in enumerate(dae.function.name_in())
    ]
    F = dae.function(*symbols)
    jacobian = ca.Function("J", symbols, [ca.jacobian(F, ca.vertcat(symbols[0], symbols[2]))])
    J = np.array(jacobian(*[0.1 * np.ones(s.numel()) for s in symbols]))
    assert J.shape[0] == J.shape[1] and np.linalg.matrix_rank(J) == len(J)
    assert (
        dae.x[0] == "q_a[q1]"
        and dae.x_units[5] == "rad/s"
        and dae.z == ("tau_g[q1]", "tau_g[q2]", "y[x]", "y[y]")
    )


def test_the_page_has_every_function_with_its_arrays():
    text = PAGE.read_text(encoding="utf-8")
    listed = dict(
        re.findall(
            r"^\| `(\w+)` \| ([\w, ]+) \| ", text.partition("## Inputs and outputs")[0], re.M
        )
    )
    rows = {row.name: row for row in (*TABLE, *PYTHON_TABLE) if row.name in BUILDERS}
    assert set(rows) <= set(listed)
    arrays = set()
    for name, row in rows.items():
        assert listed[name].split(", ") == row.inputs.split(), name
        line = next(line for line in text.splitlines() if line.startswith(f"| `{name}` |"))
        for output in row.outputs.split():
            extents = (PORTS | PYTHON_PORTS)[output][0]
            assert (
                output + (f" ({', '.join(extents).replace(' * ', ' ')})" if extents else "")
                in line
            ), (name, output)
        arrays |= {*row.inputs.split(), *row.outputs.split()}
    assert {name for name in arrays if f"| `{name}` |" not in text} == set()


@pytest.mark.parametrize(
    "zero", [600j, 200j, -1000.0, -142 + 513j, -2000 + 500j, -300 + 1700j, -500 + 3000j]
)
def test_bdf_has_order_three_where_its_formula_does_not_grow(zero):
    """5000 steps of 1 ms from a decaying solution, with the textbook's coefficients."""
    last = np.exp(zero * 1e-3 * np.arange(3))[::-1]
    for _ in range(5000):
        last = np.array(
            [(3 * last[0] - 1.5 * last[1] + last[2] / 3) / (11 / 6 - 1e-3 * zero), *last[:2]]
        )
    assert stable_order(np.array([zero, np.conj(zero)]), 1e-3) == (
        3 if np.abs(last).max() <= 1.0 + 1e-6 else 2
    )
