"""The default build, with the same bits everywhere, against the native one, by compiler.

    python benchmarks/compilers/compilers.py [MODEL ...]

Builds the library of each model with each compiler that is installed, with both kinds of flags,
and calls all builds in turn in one process on one core: inverse dynamics of 4000 points, and the
inversion of the first second of a move. The table of minimum times goes to
benchmarks/compilers/compilers.md, unless models are named. Compare the ratios.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import flexgen
from flexgen.codegen.build.compiler import find_compiler
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples

HERE = Path(__file__).resolve().parent
MODELS = ("manutec_r3_18", "manutec_r3_24", "manutec_r3_30")
NAMES = ("gcc-11", "gcc-12", "gcc-13", "gcc-14", "gcc-15", "clang")
PACKAGED = "ziglang"
POINTS = 4000
ROUNDS = 25
GENERATE = (
    "import sys, flexgen; flexgen.generate(sys.argv[1], sys.argv[2], native=sys.argv[3] == "
    "'native')"
)


@dataclass(frozen=True)
class Build:
    """A library of one compiler."""

    compiler: str
    kind: str
    robot: flexgen.Library


def compilers() -> list[str]:
    """The compilers that are installed; cc where none of the names is."""
    found = [name for name in NAMES if shutil.which(name)]
    return [*(found or ["cc"]), *[PACKAGED] * (_environment(PACKAGED) is not None)]


def _environment(compiler: str) -> dict[str, str] | None:
    """The environment in which flexgen uses a compiler; None where it is not installed."""
    if compiler != PACKAGED:
        return os.environ | {"CC": compiler}
    try:
        import ziglang  # noqa: F401
    except ImportError:
        return None
    kept = {key: value for key, value in os.environ.items() if key != "CC"}
    # without a compiler on the PATH the packaged one is used
    return kept | {"PATH": "/nonexistent"}


def builds(model: str, folder: Path) -> list[Build]:
    """All builds of a model, loaded."""
    out = []
    for compiler in compilers():
        for kind in ("default", "native"):
            place = folder / f"{model}_{compiler}_{kind}"
            print(f"{model}: {compiler}, {kind}", flush=True)
            command = [sys.executable, "-c", GENERATE, model, str(place), kind]
            subprocess.run(
                command, env=_environment(compiler), check=True, stdout=subprocess.DEVNULL
            )
            out.append(Build(compiler, kind, flexgen.load(place)))
    return out


def calls(
    model: str, robot: flexgen.Library
) -> dict[str, tuple[Callable[[], object], float, str]]:
    """Timed calls by name: the call, the divisor of its time in s, and the unit."""
    rng = np.random.default_rng(0)
    data = flexgen.read(model)
    arrays = [rng.uniform(-1.0, 1.0, (POINTS, data.n_a)) for _ in range(3)]
    equations = derive(data)
    path = flexgen.plan(equations, "line")
    y, dy, ddy = samples(Reduction(equations), path, 1e-3, 1001)
    options = {
        "period": 1e-3,
        "q_start": path.q_start,
        "n_pre": 20,
        "n_post": 50,
        "samples_per_interval": 10,
    }
    return {
        "inverse dynamics": (lambda: robot.inverse_dynamics(*arrays), 1e9 / POINTS, "ns a point"),
        "inversion": (lambda: robot.invert(y, dy, ddy, **options), 1e3, "ms per s of path"),
    }


def rows(model: str, folder: Path) -> list[str]:
    """Lines of the table for a model."""
    found = builds(model, folder)
    timed = [calls(model, build.robot) for build in found]
    out = []
    for what, (_, factor, unit) in timed[0].items():
        least = np.full(len(found), np.inf)
        for _ in range(ROUNDS):
            for k, one in enumerate(timed):
                start = time.perf_counter()
                one[what][0]()
                least[k] = min(least[k], time.perf_counter() - start)
        values = {
            (build.compiler, build.kind): factor * x for build, x in zip(found, least, strict=True)
        }
        fastest = min(values.values())
        for compiler in dict.fromkeys(build.compiler for build in found):
            default = values[compiler, "default"]
            native = values[compiler, "native"]
            out.append(
                f"| {model} | {what} | {compiler} | {default:.3g} | {native:.3g} | {unit} | "
                f"{default / native:.2f} | {default / fastest:.2f} |"
            )
            print(out[-1], flush=True)
    return out


def version(compiler: str) -> str:
    """The first line of what a compiler says about itself."""
    command = [compiler] if compiler != PACKAGED else [sys.executable, "-m", "ziglang", "cc"]
    text = subprocess.run(
        [*command, "--version"], capture_output=True, text=True, check=True
    ).stdout
    return text.partition("\n")[0]


def processor() -> str:
    """Name of the processor, as Linux has it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )


def main() -> None:
    """Measure, and write the table."""
    chosen = sys.argv[1:]
    assert find_compiler() is not None, "no C compiler"
    with tempfile.TemporaryDirectory() as folder:
        lines = [line for model in chosen or MODELS for line in rows(model, Path(folder))]
    if chosen:
        return
    versions = "; ".join(f"{name}: {version(name)}" for name in compilers())
    text = f"""# The default build against the native one, by compiler

`python benchmarks/compilers/compilers.py` makes this table. Processor: {processor()}. {versions}.

Minimum of {ROUNDS} calls on one core, all builds in turn in one process. "native" contracts \
products and sums and uses
all instructions of the processor at -O3; "default" has the same bits on every processor. The \
last column is the default
build over the fastest of all builds.

| robot | what | compiler | default | native | unit | default / native | default / fastest |
| --- | --- | --- | --- | --- | --- | --- | --- |
"""
    (HERE / "compilers.md").write_text(text + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
