"""The emitted functions compared with Pinocchio, MuJoCo and the C of CasADi: nanoseconds per call,
and ratios.

    python benchmarks/peers.py [--quick] [--clang] [--docs] [--robots NAME ...]

All candidates of a row run in one process on one core, block by block in turn, after they were
found to agree. The table goes to benchmarks/peers.md (not with --quick or --robots). Compare
ratios of one run; times are of one machine.
"""

from __future__ import annotations

import argparse
import ctypes
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import casadi as ca
import numpy as np
import peers_table
from peers_builds import (
    AVX2,
    HERE,
    NATIVE,
    REPRODUCIBLE,
    Builds,
    Mujoco,
    Pinocchio,
    find_mujoco,
    find_pinocchio,
)
from peers_robots import ROBOTS, pinocchio_text, write_mujoco

import flexgen
from flexgen.codegen.emission.interface import ABI_VERSION
from flexgen.codegen.emission.spec import FUNCTIONS, FunctionSpec, library_spec
from flexgen.codegen.statements.routine import Expressions
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.model.elements import RobotModel

# What is compared, by its name in the library, and what Pinocchio's side calls it: the faster of
# several counts.
QUANTITIES = {
    "inverse_dynamics": ("inverse_dynamics",),
    "mass_matrix": ("mass_matrix:local", "mass_matrix:world"),
    "arm_forward_dynamics": ("arm_forward_dynamics:local", "arm_forward_dynamics:world"),
    "inverse_dynamics_derivatives": ("inverse_dynamics_derivatives",),
    "arm_forward_derivatives": ("arm_forward_dynamics_derivatives",),
}
STATES = 64  # so many that no branch predictor learns them by heart
# a power of two is a batch's worst case: all its arrays meet in the same places of the cache
POINTS = 4096
ODD_POINTS = 4000
FEW_POINTS = 200  # so few that results stay in the cache, those of large matrices too
# of the largest result; elimination and the articulated-body algorithm round differently
AGREEMENT = 1e-9
# instructions of an expression that CasADi's C is compiled for; longer ones take minutes
LONGEST = 25_000
CLOSER = ("ur5", "ur5_elastic")  # with more candidates, and what --quick looks at
DERIVED = ("ur5", "panda", "ur5_elastic", "chain12")  # with derivatives


@dataclass
class Row:
    """One function of one robot: its operations and longest chain [cycles], and by candidate
    ``ns`` per evaluation.
    """

    robot: str
    quantity: str
    operations: int = 0
    depth: int = 0
    ns: dict[str, float] = field(default_factory=dict)
    median: dict[str, float] = field(default_factory=dict)
    deviation: dict[str, float] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


@dataclass
class Prepared:
    """A row that is being compiled: its function and its candidates (label, kind, file, symbol,
    extra).
    """

    row: Row
    model: RobotModel
    spec: FunctionSpec
    candidates: list[tuple[str, str, Path, str, str]] = field(default_factory=list)


def say(line: str) -> None:
    """A line of progress."""
    print(line, file=sys.stderr, flush=True)


def same_expression(spec: FunctionSpec) -> ca.Function | None:
    """The SX function that our C is written from, where it is a single one."""
    steps = spec.program.steps
    return steps[0].function if len(steps) == 1 and isinstance(steps[0], Expressions) else None


def prepare(  # noqa: C901
    robot: str,
    builds: Builds,
    pinocchio: Pinocchio,
    codegen: Path | None,
    mujoco: Mujoco,
    args: argparse.Namespace,
) -> list[Prepared]:
    """Derive and write everything of a robot, and start its compilations."""
    model = ROBOTS[robot]()
    folder = builds.folder / robot
    equations = flexgen.derive(model)
    names = [
        name
        for name in QUANTITIES
        if name in FUNCTIONS and (robot in DERIVED or "derivatives" not in name)
    ]
    spec = library_spec(equations, names)
    say(f"{robot}: {model.n_a} coordinates; writing and compiling")
    libraries = {}
    for native in (False, True):
        target = builds.folder / f"{robot}_native" if native else folder
        made = flexgen.generate(model, target, functions=names, native=native)
        libraries[native] = next(file for file in made.files if file.suffix in (".so", ".dylib"))
    default = libraries[False]
    native = libraries[True]
    layout = "soa" if ABI_VERSION >= 2 else "aos"
    many, odd, few = (f"{layout}/{count}" for count in (POINTS, ODD_POINTS, FEW_POINTS))
    header = (folder / f"{spec.name}.h").read_text()
    sizes = re.findall(r"(\d+) operations, the longest chain about (\d+) cycles", header)
    text = builds.text(f"{robot}.txt", pinocchio_text(model))
    if mujoco.folder is not None:
        write_mujoco(model, builds.folder / f"{robot}.mjb")
    prepared = []
    for f in spec.functions:
        row = Prepared(Row(robot, f.name), model, f)
        if len(sizes) == len(spec.functions):
            row.row.operations, row.row.depth = map(int, sizes[len(prepared)])
        prepared.append(row)
        symbol = f"{spec.name}_{f.name}"
        sources = [folder / "src" / file for file in (f"{symbol}.c", f"{spec.name}.c")]
        row.candidates += [
            ("ours", "point", native, symbol, "-"),
            ("ours_default", "point", default, symbol, "-"),
            ("batch", "batch", native, f"{symbol}_batch", many),
            ("batch_odd", "batch", native, f"{symbol}_batch", odd),
            ("batch_few", "batch", native, f"{symbol}_batch", few),
            ("batch_default", "batch", default, f"{symbol}_batch", many),
        ]
        if peers_table.cpu_has("avx512f") and robot in CLOSER and not args.quick:
            avx2 = builds.submit(f"{symbol}_avx2", builds.cc, AVX2, sources, "-lm")
            row.candidates.append(("batch_avx2", "batch", avx2, f"{symbol}_batch", many))
        add_casadi(row, equations, builds, args.quick)
        # it has only those by differences
        if mujoco.folder is not None and not f.name.endswith("derivatives"):
            row.candidates.append(
                ("mujoco", "peer", mujoco.submit(builds), f.name, f"./{robot}.mjb")
            )
        if pinocchio.missing:
            continue
        if codegen is not None:
            add_generated(row, builds, codegen, text)
        for compiler, suffix in (
            (("g++", ""), ("clang++", "_clang")) if args.clang else (("g++", ""),)
        ):
            if shutil.which(compiler) is None:
                continue
            if suffix:
                clang = builds.submit(f"{symbol}_clang", "clang", NATIVE, sources, "-lm")
                row.candidates.append(("ours_clang", "point", clang, symbol, "-"))
            file = pinocchio_side(builds, pinocchio, compiler, f.name)
            for name in QUANTITIES[f.name]:
                label = (
                    ("pinocchio" + name.removeprefix(f.name).replace(":", "_"))
                    if ":" in name
                    else "pinocchio"
                )
                row.candidates.append((label + suffix, "peer", file, name, f"./{text.name}"))
    return prepared


def pinocchio_side(builds: Builds, pinocchio: Pinocchio, compiler: str, quantity: str) -> Path:
    """Pinocchio's side for a quantity, compiled by one compiler."""
    derivatives = quantity.endswith("derivatives")
    flags = pinocchio.flags(("-DDERIVATIVES",) if derivatives else ())
    name = f"pinocchio_{'derivatives' if derivatives else 'values'}_{compiler.rstrip('+')}"
    return builds.submit(name, compiler, flags, [HERE / "peers_pinocchio.cpp"])


def add_casadi(row: Prepared, equations: Equations, builds: Builds, quick: bool) -> None:
    """CasADi's own C: of the Lagrangian's expression, and of the expression that our C is written
    from.
    """
    name = row.spec.name
    same = same_expression(row.spec)
    try:
        lagrangian = equations.function(name)
    except flexgen.ArgumentError:
        lagrangian = None
        row.row.notes.append("no single expression for CasADi: a linear solve is a loop in our C")
    wanted = [("casadi_same", same, NATIVE), ("casadi_lagrangian", lagrangian, NATIVE)]
    if row.row.robot in CLOSER and not quick:
        wanted.insert(1, ("casadi_same_default", same, REPRODUCIBLE))
    for label, function, flags in wanted:
        if function is not None:
            add_expression(row, builds, label, function, flags)


def add_expression(
    row: Prepared, builds: Builds, label: str, function: ca.Function, flags: tuple[str, ...]
) -> None:
    """CasADi's C of an expression as a candidate, unless it is too long."""
    if function.n_instructions() > LONGEST:
        told = "Pinocchio's code generation" if label == "generated" else label
        row.row.notes.append(f"{told} left out: {function.n_instructions()} instructions")
        return
    symbol = f"{label}_{row.spec.name}"
    generator = ca.CodeGenerator(f"{row.row.robot}_{symbol}.c")
    generator.add(_renamed(function, symbol))
    source = builds.text(f"{row.row.robot}_{symbol}.c", generator.dump())
    file = builds.submit(f"{row.row.robot}_{symbol}", builds.cc, flags, [source], "-lm")
    row.candidates.append((label, "casadi", file, symbol, "-"))


def codegen_side(builds: Builds, pinocchio: Pinocchio) -> Path:
    """Pinocchio's code generation, compiled."""
    casadi = Path(ca.__file__).parent
    flags = pinocchio.flags(("-O1", "-isystem", str(casadi / "include")))
    return builds.submit(
        "pinocchio_codegen", "g++", flags, [HERE / "peers_codegen.cpp"], f"-L{casadi} -lcasadi"
    )


def add_generated(row: Prepared, builds: Builds, codegen: Path, text: Path) -> None:
    """Pinocchio's algorithm on CasADi's symbols, as CasADi's C: the shorter one of its
    conventions.
    """
    found: list[ca.Function] = []
    try:
        library = ctypes.CDLL(str(codegen))
    except OSError as error:  # such as a CasADi that another compiler's C++ does not fit
        row.row.notes.append(f"Pinocchio's code generation left out: {error}")
        return
    for quantity in QUANTITIES[row.spec.name]:
        out = builds.folder / f"{row.row.robot}_{quantity.replace(':', '_')}.casadi"
        if library.peer_generate(quantity.encode(), str(text).encode(), str(out).encode()) == 0:
            found.append(ca.Function.load(str(out)))
    if not found:
        row.row.notes.append("Pinocchio's code generation left out: it failed")
        return
    function = min(found, key=lambda f: f.n_instructions())
    add_expression(row, builds, "generated", function, NATIVE)


def _renamed(function: ca.Function, name: str) -> ca.Function:
    inputs = function.sx_in()
    return ca.Function(name, inputs, function.call(inputs))


def drop_failed(rows: list[Prepared], failed: dict[Path, str]) -> None:
    """Take out the candidates that could not be compiled, if they are of a peer; RuntimeError for
    any other file.
    """
    for path, told in failed.items():
        if not path.name.startswith(("pinocchio", "mujoco")):
            raise RuntimeError(told)
        say(f"A column stays empty, {path.name} could not be compiled:\n{told}")
    for row in rows:
        kept = [candidate for candidate in row.candidates if candidate[2] not in failed]
        if len(kept) < len(row.candidates):
            row.row.notes.append("Pinocchio or MuJoCo left out: it could not be compiled")
        row.candidates = kept


def states_of(spec: FunctionSpec, model: RobotModel, seed: int = 7) -> np.ndarray:
    """Random states, one per row: the inputs one after the other; what only a spring holds stays
    near its rest.
    """
    rng = np.random.default_rng(seed)
    reach = np.full(model.n_a, np.pi)
    reach[list(model.i_e)] = 0.05
    width = {"q_a": reach, "v_a": 2.0, "a_a": 5.0, "tau_a": 20.0}
    return np.hstack(
        [rng.uniform(-1.0, 1.0, (STATES, p.size)) * width[p.name] for p in spec.inputs]
    )


def measure(row: Prepared, builds: Builds, timer: Path, args: argparse.Namespace) -> None:
    """Run the timer on one row."""
    name = f"{row.row.robot}_{row.spec.name}"
    states = builds.folder / f"{name}.states"
    states.write_bytes(np.ascontiguousarray(states_of(row.spec, row.model)).tobytes())
    lines = [
        f"states ./{states.name} {STATES}",
        " ".join(["inputs", *(str(p.size) for p in row.spec.inputs), "0"]),
        " ".join(["outputs", *(str(p.size) for p in row.spec.outputs), "0"]),
        f"blocks {15 if args.quick else 40} milliseconds 1.5 tolerance {AGREEMENT!r}",
    ]
    for label, kind, file, symbol, extra in row.candidates:
        lines.append(
            f"candidate {label} {kind} ./{file.relative_to(builds.folder)} {symbol} {extra}"
        )
    job = builds.text(f"{name}.job", "\n".join(lines) + "\n")
    command = [f"./{timer.name}", f"./{job.name}"]
    answer = subprocess.run(
        command, cwd=builds.folder, capture_output=True, text=True, check=False
    )
    if answer.returncode not in (0, 2):
        raise RuntimeError(f"{job}: {answer.stderr.strip() or answer.returncode}")
    for line in answer.stdout.splitlines():
        label, *numbers = line.split()
        row.row.deviation[label], row.row.ns[label], row.row.median[label] = map(float, numbers)
    for label, deviation in row.row.deviation.items():
        if not deviation <= AGREEMENT:
            row.row.notes.append(f"DISAGREES: {label} by {deviation:.1e} of the largest result")
    best: dict[str, str] = {}
    for label in row.row.ns:  # the faster one of Pinocchio's two ways
        if label.startswith("pinocchio"):
            side = "pinocchio_clang" if label.endswith("_clang") else "pinocchio"
            best[side] = min(best.get(side, label), label, key=row.row.ns.__getitem__)
    for side, label in best.items():
        row.row.ns[side] = row.row.ns[label]
        row.row.median[side] = row.row.median[label]
    shown = "  ".join(f"{label} {ns:.4g}" for label, ns in row.row.ns.items())
    say(f"  {row.spec.name}: {shown}")


@dataclass(frozen=True)
class Wrapper:
    """Python's cost: microseconds of a scalar call and of the same in C, ns per point of a batch
    call and in C.
    """

    robot: str
    quantity: str
    call_us: float
    c_us: float
    batch_ns: float
    c_batch_ns: float


def python_cost(row: Prepared, folder: Path) -> Wrapper:
    """Time `flexgen.load`'s function: one call, and one batch."""
    function = flexgen.load(folder).functions[row.spec.name]
    states = states_of(row.spec, row.model)
    starts = np.cumsum([0, *(p.size for p in row.spec.inputs)])
    one = [[np.ascontiguousarray(s[a:b]) for a, b in pairwise(starts)] for s in states]
    many = [
        np.asfortranarray(np.tile(states[:, a:b], (POINTS // STATES, 1)))
        for a, b in pairwise(starts)
    ]
    out = np.empty((POINTS, *row.spec.outputs[0].shape), order="F")

    def least(run: object, count: int, times: int) -> float:
        best = np.inf
        for _ in range(times):
            began = time.perf_counter()
            run()  # type: ignore[operator]
            best = min(best, time.perf_counter() - began)
        return best / count

    def calls() -> None:
        for inputs in one:
            for _ in range(10):
                function(*inputs)

    call = least(calls, 10 * STATES, 15)
    batch = least(lambda: function(*many, out=out), POINTS, 15)
    ns = row.row.ns
    return Wrapper(
        row.row.robot,
        row.spec.name,
        1e6 * call,
        1e-3 * ns["ours_default"],
        1e9 * batch,
        ns["batch_default"],
    )


def main() -> None:  # noqa: C901
    """Build, check, time, print; write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="two robots, fewer blocks and candidates; nothing written",
    )
    parser.add_argument(
        "--clang", action="store_true", help="Pinocchio and our C by clang too, where it is there"
    )
    parser.add_argument(
        "--docs",
        action="store_true",
        help="also put the short table between the markers in docs/benchmarks.md",
    )
    parser.add_argument(
        "--robots", nargs="+", choices=list(ROBOTS), help="these only; nothing written"
    )
    args = parser.parse_args()
    began = time.perf_counter()
    builds = Builds(HERE.parent / "build" / "bench")
    pinocchio = find_pinocchio()
    for missing in pinocchio.missing:
        say(f"Pinocchio's column stays empty; missing: {missing}")
    mujoco = find_mujoco()
    if mujoco.folder is None:
        say("MuJoCo's column stays empty; missing: pip install mujoco")
    left_out = [name for name in QUANTITIES if name not in FUNCTIONS]
    if left_out:
        say(f"not in the library, left out: {', '.join(left_out)}")
    timer = builds.submit(
        "timer", builds.cc, ("-std=c11", "-O2", "-Wall"), [HERE / "peers_timer.c"], "-ldl -lm"
    )
    if not pinocchio.missing:  # the longest compilations first
        for quantity in ("inverse_dynamics", "inverse_dynamics_derivatives"):
            for compiler in (
                ("g++", "clang++") if args.clang and shutil.which("clang++") else ("g++",)
            ):
                pinocchio_side(builds, pinocchio, compiler, quantity)
    codegen = None
    if not (pinocchio.missing or args.quick):
        say("compiling Pinocchio on CasADi's symbols: about a minute, once")
        codegen = codegen_side(builds, pinocchio)
        if codegen in builds.jobs and (error := builds.jobs.pop(codegen).exception()) is not None:
            say(f"The column of Pinocchio's code generation stays empty:\n{error}")
            codegen = None
    rows: list[Prepared] = []
    for robot in args.robots or (CLOSER if args.quick else ROBOTS):
        rows += prepare(robot, builds, pinocchio, codegen, mujoco, args)
    say("compiling what is left")
    drop_failed(rows, builds.wait())
    say(f"built after {time.perf_counter() - began:.0f} s; timing")
    for k, row in enumerate(rows):
        if k == 0 or rows[k - 1].row.robot != row.row.robot:
            say(row.row.robot)
        measure(row, builds, timer, args)
    wrappers = [
        python_cost(row, builds.folder / row.row.robot)
        for row in rows
        if row.spec.name in ("inverse_dynamics",)
    ]
    machine = peers_table.machine(builds, pinocchio, args.clang)
    table = peers_table.full([row.row for row in rows], wrappers, machine, left_out)
    print(table)
    if not (args.quick or args.robots):
        (HERE / "peers.md").write_text(table)
        if args.docs:
            peers_table.into_page(
                HERE.parent / "docs" / "benchmarks.md", [row.row for row in rows], machine
            )
    say(f"{time.perf_counter() - began:.0f} s in all")
    if any("DISAGREES" in note for row in rows for note in row.row.notes):
        sys.exit("the candidates do not agree: see the notes")


if __name__ == "__main__":
    main()
