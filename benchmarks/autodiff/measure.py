"""Times of a library in JAX and PyTorch next to its functions on numpy arrays:
benchmarks/autodiff.md.

    python benchmarks/autodiff/measure.py [--quick]

All rows of a robot are timed in turn, in many rounds of one process; a time is the median of the
rounds. One core.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import torch

import flexgen
import flexgen.jax
import flexgen.torch

PAGE = Path(__file__).resolve().parents[1] / "autodiff.md"
ROBOTS = ("planar5_nmp", "manutec_r3_24")
BATCH = 10_000
STEPS = 1000
NAMES = ["inverse_dynamics", "mass_matrix"]


def calls_of(robot: flexgen.Library) -> dict[str, tuple[Callable[[], object], int]]:
    """Timed functions by name, each with the number of evaluations in one call."""
    made = flexgen.jax.functions(robot)
    torched = flexgen.torch.functions(robot)
    rng = np.random.default_rng(0)
    n = robot.sizes["n_a"]
    one = [rng.uniform(-1.0, 1.0, n) for _ in range(3)]
    many = [rng.uniform(-1.0, 1.0, (BATCH, n)) for _ in range(3)]
    columns = [np.asfortranarray(x) for x in many]
    out = np.empty((BATCH, n), order="F")
    x, X = ([jnp.asarray(a) for a in arrays] for arrays in (one, many))
    y, Y = ([torch.tensor(a) for a in arrays] for arrays in (one, many))
    leaves = [a.clone().requires_grad_() for a in Y]
    point = [a.clone().requires_grad_() for a in y]
    jitted = jax.jit(made.inverse_dynamics)
    gradient = jax.jit(jax.grad(lambda *x: made.inverse_dynamics(*x).sum(), argnums=(0, 1, 2)))

    def loop(q: jax.Array, v: jax.Array, a: jax.Array) -> jax.Array:
        return jax.lax.scan(
            lambda q, _: (q + 1e-9 * made.inverse_dynamics(q, v, a), None), q, length=STEPS
        )[0]

    scan = jax.jit(loop)
    return {
        "one point: numpy": (lambda: robot.inverse_dynamics(*one), 1),
        "one point: JAX, jitted": (lambda: jitted(*x).block_until_ready(), 1),
        "one point: JAX, in a compiled loop": (lambda: scan(*x).block_until_ready(), STEPS),
        "one point: JAX, gradient, jitted": (lambda: jax.block_until_ready(gradient(*x)), 1),
        "one point: PyTorch": (lambda: torched.inverse_dynamics(*y), 1),
        "one point: PyTorch, forward and backward": (
            lambda: torched.inverse_dynamics(*point).sum().backward(),
            1,
        ),
        "batch: numpy, order of C": (lambda: robot.inverse_dynamics(*many), BATCH),
        "batch: numpy, structure of arrays, out=": (
            lambda: robot.inverse_dynamics(*columns, out=out),
            BATCH,
        ),
        "batch: JAX, jitted": (lambda: jitted(*X).block_until_ready(), BATCH),
        "batch: JAX, gradient, jitted": (lambda: jax.block_until_ready(gradient(*X)), BATCH),
        "batch: PyTorch": (lambda: torched.inverse_dynamics(*Y), BATCH),
        "batch: PyTorch, forward and backward": (
            lambda: torched.inverse_dynamics(*leaves).sum().backward(),
            BATCH,
        ),
    }


def measured(calls: dict[str, tuple[Callable[[], object], int]], rounds: int) -> dict[str, float]:
    """Median time of a call of the function [us], the rows in turn."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(rounds):
        for name, (call, inside) in calls.items():
            repeat = 200 if inside == 1 else 1
            call()
            start = time.perf_counter()
            for _ in range(repeat):
                call()
            times[name].append((time.perf_counter() - start) / repeat / inside)
    return {name: 1e6 * float(np.median(values)) for name, values in times.items()}


def main() -> None:
    """Measure, print, and write the page."""
    jax.config.update("jax_enable_x64", True)
    torch.set_num_threads(1)
    rounds = 5 if "--quick" in sys.argv else 50
    columns = {}
    with tempfile.TemporaryDirectory() as folder:
        for name in ROBOTS:
            made = flexgen.generate(
                name, Path(folder, name), functions=NAMES, parts=["derivatives"]
            )
            columns[name] = measured(calls_of(flexgen.load(made.directory)), rounds)
    rows = [
        f"| {row} | {' | '.join(f'{columns[name][row]:.3g}' for name in ROBOTS)} |"
        for row in columns[ROBOTS[0]]
    ]
    table = "\n".join(
        [f"| us a point | {' | '.join(ROBOTS)} |", "|---|" + "---|" * len(ROBOTS), *rows]
    )
    text = (
        "# A library in JAX and PyTorch\n"
        "\n"
        "Time of `inverse_dynamics` [us a point], written by `benchmarks/autodiff/measure.py`: "
        f"medians of {rounds} rounds,\n"
        "the rows in turn, one process on a shared machine. The gradient is that in all "
        "inputs,\n"
        f"by `inverse_dynamics_vjp`. A batch has {BATCH} points, the loop {STEPS} steps.\n"
        f"JAX {jax.__version__}, PyTorch {torch.__version__}, numpy {np.__version__}.\n"
        "\n"
        f"{table}\n"
    )
    print(text)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
