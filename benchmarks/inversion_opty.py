"""Solve the problem of a file with opty: ``python inversion_opty.py JOB``; the last line printed
is the result as JSON.

Run by an interpreter that has opty (which needs cyipopt, and that IPOPT); it needs nothing of
flexgen.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

STATUS = {
    0: "solved",
    1: "solved to an acceptable level",
    2: "infeasible",
    3: "search direction too small",
    -1: "most iterations reached",
    -2: "restoration failed",
}


def tracking_cost(
    job: dict, output: Callable, jacobian: Callable, reference: np.ndarray
) -> tuple[Callable, Callable]:
    """Cost and gradient that draw the tool to its path and smooth the torques."""
    n = job["nodes"]
    n_x = len(job["states"])
    weight = job["step"] * job["tracking"]
    smooth = job["smooth"] / job["step"]

    def cost(free: np.ndarray) -> float:
        parts = free.reshape(-1, n)
        error = np.array(output(*parts[:n_x])) - reference
        return 0.5 * float(
            weight * (error**2).sum() + smooth * (np.diff(parts[n_x:], axis=1) ** 2).sum()
        )

    def gradient(free: np.ndarray) -> np.ndarray:
        parts = free.reshape(-1, n)
        out = np.zeros_like(parts)
        error = weight * (np.array(output(*parts[:n_x])) - reference)
        for e, row in zip(error, jacobian(*parts[:n_x]), strict=True):
            for k, value in enumerate(row):
                out[k] += e * value
        change = smooth * np.diff(parts[n_x:], axis=1)
        out[n_x:, 1:] += change
        out[n_x:, :-1] -= change
        return out.ravel()

    return cost, gradient


def end_cost(n: int, n_x: int, rest: np.ndarray) -> tuple[Callable, Callable]:
    """Cost and gradient that draw both ends to rest, as the collocation of flexgen does."""
    ends = np.array([n * k for k in range(n_x)]), np.array([n * (k + 1) - 1 for k in range(n_x)])

    def cost(free: np.ndarray) -> float:
        return 0.5 * float(
            sum(((free[at] - x) ** 2).sum() for at, x in zip(ends, rest, strict=True))
        )

    def gradient(free: np.ndarray) -> np.ndarray:
        out = np.zeros_like(free)
        for at, x in zip(ends, rest, strict=True):
            out[at] = free[at] - x
        return out

    return cost, gradient


def answer(job: dict) -> dict:
    """The result of opty: processor time of IPOPT, its status, states and torques."""
    import sympy as sp
    from opty import Problem
    from sympy.physics.mechanics import dynamicsymbols

    t = dynamicsymbols._t
    names = [*job["states"], *job["inputs"], *job["reference"]]
    signals = {name: sp.Function(name)(t) for name in names}
    rates = {f"{name}_rate": signals[name].diff(t) for name in job["states"]}
    symbols = {name: sp.Symbol(name) for name in (*names, *rates)}
    put = {symbols[name]: value for name, value in (*rates.items(), *signals.items())}
    rows = [sp.sympify(row, locals=symbols) for row in job["rows"]]
    tool = [sp.sympify(row, locals=symbols) for row in job["output"]]
    n = job["nodes"]
    n_x = len(job["states"])
    h = job["step"]
    states = [symbols[name] for name in job["states"]]
    reference = np.array(list(job["reference"].values()))
    rest = np.array(job["rest"])
    more: dict = {}
    if job["tracking"]:
        output = (
            sp.lambdify(states, tool),
            sp.lambdify(states, sp.Matrix(tool).jacobian(states).tolist()),
        )
        cost, gradient = tracking_cost(job, *output, reference)
        more["instance_constraints"] = [
            sp.Function(name)(0.0) - x for name, x in zip(job["states"], rest[0], strict=True)
        ]
    else:  # the path leaves only the zero dynamics free
        rows += [row - symbols[name] for row, name in zip(tool, job["reference"], strict=True)]
        more["known_trajectory_map"] = dict(
            zip([signals[name] for name in job["reference"]], reference, strict=True)
        )
        cost, gradient = end_cost(n, n_x, rest)

    problem = Problem(
        cost,
        gradient,
        sp.Matrix([row.xreplace(put) for row in rows]),
        [signals[name] for name in job["states"]],
        n,
        h,
        integration_method="midpoint",
        time_symbol=t,
        **more,
    )
    for key, value in {"print_level": 0, "max_iter": job["iterations"], "tol": 1e-8}.items():
        problem.add_option(key, value)
    guess = np.concatenate([np.array(column) for column in job["guess"]])
    began = time.process_time()
    free, info = problem.solve(guess)
    seconds = time.process_time() - began
    parts = free.reshape(-1, n)
    return {
        "seconds": seconds,
        "status": STATUS.get(info["status"], f"status {info['status']}"),
        "iterations": len(getattr(problem, "obj_value", [])),
        "states": parts[:n_x].tolist(),
        "inputs": parts[n_x:].tolist(),
        "begin": job["begin"],
        "step": h,
    }


def main() -> None:
    """Read, solve, print."""
    job = json.loads(Path(sys.argv[1]).read_text())
    try:
        told = answer(job)
    except ImportError as error:
        told = {
            "missing": (
                f"{type(error).__name__}: {error}; pip install opty (needs IPOPT and cyipopt)"
            )
        }
    print(json.dumps(told))


if __name__ == "__main__":
    main()
