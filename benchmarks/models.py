"""All models: time to derive, to generate and compile, to solve, to verify, and the verified tool
error.

    python benchmarks/models.py [MODEL ...]

prints the table and, for all models, writes it to benchmarks/models.md. The times are of the
machine at hand; compare rows with each other, not with another machine's.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import flexgen
from flexgen.codegen.emission.spec import library_spec
from flexgen.model.reader import model_names

HEAD = (
    "model",
    "n_m / n_e / dof",
    "derive s",
    "generate s",
    "solve s",
    "verify s",
    "method",
    "iterations",
    "tool error um",
    "tool error urad",
    "status",
)


def row(name: str) -> list[str]:
    """The results of one model as texts."""
    began = time.perf_counter()
    equations = flexgen.derive(name)
    library_spec(equations)  # builds every function that C is written for
    derived = time.perf_counter() - began
    with tempfile.TemporaryDirectory() as folder:
        began = time.perf_counter()
        flexgen.generate(name, Path(folder) / "library")
        generated = time.perf_counter() - began
    solution = flexgen.solve(
        flexgen.derive(name), progress=lambda line: print("  " + line, file=sys.stderr)
    )
    simulation = solution.simulation
    assert simulation is not None
    errors = [simulation.tool_error_max_m, simulation.tool_error_max_rad]
    model = equations.model
    return [
        name,
        f"{model.n_m} / {model.n_e} / {model.dof}",
        f"{derived:.2f}",
        f"{generated:.1f}",
        f"{solution.wall_s - simulation.wall_s:.1f}",
        f"{simulation.wall_s:.1f}",
        solution.method,
        str(solution.iterations),
        *("-" if error is None else f"{1e6 * error:.2g}" for error in errors),
        solution.status.value,
    ]


def main() -> None:
    """Print the table; write it if it has all models."""
    names = sys.argv[1:] or model_names()
    lines = ["| " + " | ".join(HEAD) + " |", "|" + " --- |" * len(HEAD)]
    for name in names:
        lines.append("| " + " | ".join(row(name)) + " |")
        print(lines[-1], flush=True)
    if not sys.argv[1:]:
        Path(__file__).with_suffix(".md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
