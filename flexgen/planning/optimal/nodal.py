"""Costs and constraints in the expressions of the nodes, which connect several instants."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

from flexgen.planning.optimal.phase import Nodal
from flexgen.planning.optimal.transcribe import Layout

General = Callable[[ca.MX], tuple[ca.MX, ca.MX]]


def general_part(
    layout: Layout, nodal: list[Nodal]
) -> tuple[General, tuple[np.ndarray, np.ndarray, list[str]]]:
    """Costs and constraints in the expressions of the nodes as functions of the unknowns."""
    symbols = [x for phase in layout.phases for x in phase.node_symbols]
    costs = [item.value for item in nodal if item.lower is None]
    rows = [item for item in nodal if item.lower is not None]
    out = [sum(costs, ca.MX(0)), ca.vertcat(ca.MX(0, 1), *[item.value for item in rows])]
    function = ca.Function("general", symbols, out)

    def general(x: ca.MX) -> tuple[ca.MX, ca.MX]:
        """Cost and rows at unknowns x, which are split as `Layout` has them: states, accelerations
        and torques of each phase, its duration and its start.
        """
        arguments = []
        start = ca.MX(0)
        for number, phase in enumerate(layout.phases):
            mesh = phase.mesh
            first = layout.first[number]
            T = x[int(layout.theta[number])]
            states = ca.reshape(x[first : first + mesh.n_nodes], 2 * mesh.n, mesh.N + 1)
            inner = ca.reshape(x[first + mesh.n_nodes : first + mesh.size], mesh.n_inner, mesh.N)
            cut = mesh.s * mesh.n
            width = mesh.s * mesh.n_w
            arguments += [states[: mesh.n, :], states[mesh.n :, :]]
            arguments.append(ca.reshape(inner[:cut, :], mesh.n, mesh.N * mesh.s))
            arguments.append(ca.reshape(inner[cut : cut + width, :], mesh.n_w, mesh.N * mesh.s))
            arguments += [T, start]
            start = start + T
        cost, g = function(*arguments)
        return cost, g

    low, high = (
        np.concatenate([np.zeros(0), *[getattr(item, x) for item in rows]])
        for x in ("lower", "upper")
    )
    return general, (low, high, [item.name for item in rows for _ in range(item.value.numel())])
