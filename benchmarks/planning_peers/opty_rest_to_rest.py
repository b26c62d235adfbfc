"""Solve the problem of a file with opty: ``python opty_rest_to_rest.py JOB``; the last line
printed is the result.

Least integral of squared torques from rest to rest. Run by a Python that has opty (which needs
cyipopt and IPOPT): it needs nothing of flexgen.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np


def answer(job: dict) -> dict:
    """States, torques, and the times of opty."""
    import sympy as sp
    from opty import Problem
    from sympy.physics.mechanics import dynamicsymbols

    t = dynamicsymbols._t
    names = [*job["states"], *job["inputs"]]
    signals = {name: sp.Function(name)(t) for name in names}
    symbols = {name: sp.Symbol(name) for name in names}
    rates = {sp.Symbol(f"{name}_rate"): signals[name].diff(t) for name in job["states"]}
    put = rates | {symbols[name]: signal for name, signal in signals.items()}
    local = symbols | {str(rate): rate for rate in rates}
    rows = [sp.sympify(row, locals=local).xreplace(put) for row in job["rows"]]
    n = job["nodes"]
    n_x = len(job["states"])
    h = job["step"]
    ends = [
        sp.Function(name)(at) - x
        for at, rest in zip((0.0, h * (n - 1)), job["rest"], strict=True)
        for name, x in zip(job["states"], rest, strict=True)
    ]

    def cost(free: np.ndarray) -> float:
        return h * float((free[n_x * n :] ** 2).sum()) / 1e4

    def gradient(free: np.ndarray) -> np.ndarray:
        out = np.zeros_like(free)
        out[n_x * n :] = 2e-4 * h * free[n_x * n :]
        return out

    began = time.process_time()
    problem = Problem(
        cost,
        gradient,
        sp.Matrix(rows),
        [signals[name] for name in job["states"]],
        n,
        h,
        time_symbol=t,
        integration_method="midpoint",
        instance_constraints=tuple(ends),
    )
    for key, value in {"print_level": 0, "max_iter": 1000, "tol": 1e-8}.items():
        problem.add_option(key, value)
    built = time.process_time()
    free, info = problem.solve(np.concatenate([np.array(column) for column in job["guess"]]))
    parts = free.reshape(-1, n)
    return {
        "build_s": built - began,
        "solve_s": time.process_time() - built,
        "status": info["status"],
        "cost": cost(free),
        "states": parts[:n_x].tolist(),
        "inputs": parts[n_x:].tolist(),
    }


def main() -> None:
    """Read, solve, print."""
    job = json.loads(Path(sys.argv[1]).read_text())
    try:
        found = answer(job)
    except ImportError as error:
        found = {
            "missing": (
                f"{type(error).__name__}: {error}; pip install opty (needs IPOPT and cyipopt)"
            )
        }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
