"""The comparison as markdown: the full table for benchmarks/peers.md, the short one for
docs/benchmarks.md.
"""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from peers_builds import (
    AVX2,
    NATIVE,
    PINOCCHIO,
    REPRODUCIBLE,
    Builds,
    Pinocchio,
    eigen_version,
    package_version,
)

TITLES = {
    "inverse_dynamics": "inverse dynamics",
    "mass_matrix": "inertia matrix",
    "arm_forward_dynamics": "forward dynamics",
    "inverse_dynamics_derivatives": "derivatives of inverse dynamics",
    "arm_forward_derivatives": "derivatives of forward dynamics",
}
# What we want to reach, as a ratio.
PINOCCHIO_FLOORS = {
    ("ur5", "inverse_dynamics"): 12.0,
    ("ur5_elastic", "inverse_dynamics"): 12.0,
    ("chain30", "inverse_dynamics"): 5.0,
    ("ur5", "mass_matrix"): 8.0,
    ("ur5_elastic", "mass_matrix"): 5.0,
    ("ur5", "arm_forward_dynamics"): 12.0,
    ("ur5_elastic", "arm_forward_dynamics"): 9.0,
    ("ur5", "inverse_dynamics_derivatives"): 6.0,
    ("ur5_elastic", "inverse_dynamics_derivatives"): 3.0,
}
CASADI_FLOORS = {("ur5", "inverse_dynamics"): 1.8, ("ur5_elastic", "inverse_dynamics"): 2.5}
BATCH_FLOORS = {"avx512f": 5.0, "avx2": 2.5}
SHORT = (
    *((robot, "inverse_dynamics") for robot in ("ur5", "panda", "ur5_elastic", "chain30")),
    *((robot, "mass_matrix") for robot in ("ur5", "ur5_elastic")),
    *((robot, "arm_forward_dynamics") for robot in ("ur5", "ur5_elastic")),
    *((robot, "inverse_dynamics_derivatives") for robot in ("ur5", "ur5_elastic")),
)
BEGIN = "<!-- bench:begin -->"
END = "<!-- bench:end -->"


def cpu_has(flag: str) -> bool:
    """True where the processor has an instruction set, by its name in /proc/cpuinfo."""
    return flag in _cpu().get("flags", "").split()


def _cpu() -> dict[str, str]:
    path = Path("/proc/cpuinfo")
    if not path.exists():
        return {}
    pairs = (line.split(":", 1) for line in path.read_text().splitlines() if ":" in line)
    return {key.strip(): value.strip() for key, value in pairs}


def machine(builds: Builds, pinocchio: Pinocchio, clang: bool) -> list[str]:
    """The machine, the compilers, the flags and the versions: a line each."""
    cpu = _cpu()
    level = next((name for name in ("avx512f", "avx2", "avx") if cpu_has(name)), "no AVX")
    model = f"{cpu.get('model name', platform.processor() or platform.machine())}"
    if "cpu family" in cpu:
        model += f" (family {cpu['cpu family']}, model {cpu['model']})"
    lines = [
        f"machine: {model}, {os.cpu_count()} cores, {level}; one core used",
        f"compiler: {builds.version(builds.cc)}",
        f"flexgen, CasADi's C: `{' '.join(NATIVE[:-2])}` (generate's native=True)",
        f"flexgen, default build: `{' '.join(REPRODUCIBLE[:-2])}`; AVX2: `{' '.join(AVX2[1:3])}`",
        f"packages: casadi {package_version('casadi')}, pin {package_version('pin')}",
    ]
    if pinocchio.missing:
        return [*lines, f"Pinocchio left out, missing: {'; '.join(pinocchio.missing)}"]
    flags = " ".join(word for word in PINOCCHIO[1:4])
    lines[-1] += f", Eigen {eigen_version(pinocchio)}"
    if clang and shutil.which("clang"):
        lines.append(f"clang: {builds.version('clang')}, the same flags as gcc")
    return [
        *lines,
        f"Pinocchio: from its headers, {builds.version('g++')}, `{PINOCCHIO[0]} {flags}`",
    ]


def _number(x: float | None) -> str:
    if x is None:
        return "-"
    return f"{x:.1f}" if x < 99.95 else f"{x:.0f}"


def _ratio(row: Any, over: str, under: str, floor: float | None = None) -> str:
    if over not in row.ns or under not in row.ns:
        return "-"
    ratio = row.ns[over] / row.ns[under]
    text = f"{ratio:.2f}" if ratio < 9.95 else f"{ratio:.1f}"
    if floor is None:
        return text
    return f"{text} (target {floor:g})" if ratio >= floor else f"**{text}** (target {floor:g})"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)]) + "\n"


HEAD = ("robot", "function")


def full(
    rows: Sequence[Any],
    wrappers: Sequence[Any],
    machine_lines: Sequence[str],
    left_out: Sequence[str],
) -> str:
    """Everything that was measured."""
    labels = {
        "ours": "flexgen",
        "ours_default": "flexgen, default build",
        "batch_few": "batch of 200, per point",
        "batch_odd": "of 4000",
        "batch": "of 4096",
        "batch_default": "of 4096, default build",
        "batch_avx2": "of 4096, AVX2",
        "pinocchio": "Pinocchio",
        "generated": "Pinocchio, generated",
        "mujoco": "MuJoCo",
        "casadi_same": "CasADi, same expression",
        "casadi_same_default": "the same, default flags",
        "casadi_lagrangian": "CasADi, Lagrangian",
    }
    clang = any("ours_clang" in row.ns for row in rows)
    if clang:
        labels |= {"ours_clang": "flexgen, clang", "pinocchio_clang": "Pinocchio, clang"}
    notes = [
        f"- {row.robot}, {TITLES[row.quantity]}: {note}" for row in rows for note in row.notes
    ]
    notes += [f"- {name}: not in the library, left out" for name in left_out]
    furthest = max((x for row in rows for x in row.deviation.values()), default=0.0)
    return f"""\
# flexgen, Pinocchio, MuJoCo and CasADi in one run

`make bench` writes this file. Times are of one machine and one run. Ratios are more portable \
than times.

{chr(10).join(f"- {line}" for line in machine_lines)}

Each row is one process on one core. The programs are first compared at 64 random states (largest \
deviation of
all rows: {furthest:.1e} of the largest result), then timed alternately in blocks of about 1.5 \
ms, with
cycling states. The functions of flexgen are called as by a user, with their checks of pointers \
and of finite numbers;
Pinocchio and CasADi check nothing. MuJoCo is the library of its package; mj_inverse and \
mj_forward do more than a user
of these functions may need (contacts, energy, sensors, the factors of the mass matrix), and the \
mass matrix is its
mj_kinematics, mj_comPos and mj_makeM. Batches are structures of arrays: of 4096 points, a power \
of two, where all
arrays use the same cache sets; of 4000; of 200, which fit into the cache. Single calls write all
results to one place, which stays in the cache; batches/batches.md compares batches with loops that
keep the results of all points. Pinocchio fills half of a symmetric
matrix, flexgen all of it. Pinocchio uses its special joints for axes along x, y and z, and the \
faster of its
two conventions. "Pinocchio, generated" is its code generation: its algorithms on CasADi's \
symbols, written as C by
CasADi and compiled like flexgen's. The loop around the calls takes about 1.5 ns.

## Ratios

Minimum times. Bold: below the target.

{_ratios(rows, clang)}
## Minimum time, ns

{_times(rows, labels, "ns")}
## Median time, ns

{_times(rows, labels, "median")}
## From Python

`flexgen.load` and the default build: a call of one point; a call of 4096 in columns (order "F"), \
with `out`.

{_python(wrappers)}
## Notes

{chr(10).join(notes) if notes else "None."}
"""


def _times(rows: Sequence[Any], labels: Mapping[str, str], name: str) -> str:
    """Times of all programs: ``name`` is "ns" (minimum) or "median"."""
    body = [
        [
            row.robot,
            TITLES[row.quantity],
            *([str(row.operations), str(row.depth)] if row.operations else ["-", "-"]),
            *(_number(getattr(row, name).get(label)) for label in labels),
        ]
        for row in rows
    ]
    return _table((*HEAD, "operations", "chain, cycles", *labels.values()), body)


def _ratios(rows: Sequence[Any], clang: bool) -> str:
    """Ratios of minimum times, with the targets."""
    wide = BATCH_FLOORS["avx512f"] if cpu_has("avx512f") else BATCH_FLOORS["avx2"]
    head = [
        "Pinocchio / flexgen",
        "Pinocchio, generated / flexgen",
        "MuJoCo / flexgen",
        "CasADi, same expression / flexgen",
        "CasADi, Lagrangian / flexgen",
        "default build / native",
        "flexgen / batch of 200",
        "flexgen / batch of 4000",
        "flexgen / batch of 4096",
        "flexgen / batch of 4096, AVX2",
        "Pinocchio / batch of 4096",
        *["Pinocchio by clang / flexgen by gcc"] * clang,
    ]
    body = []
    for row in rows:
        key = (row.robot, row.quantity)
        cells = [
            _ratio(row, "pinocchio", "ours", PINOCCHIO_FLOORS.get(key)),
            _ratio(row, "generated", "ours"),
            _ratio(row, "mujoco", "ours"),
            _ratio(row, "casadi_same", "ours", CASADI_FLOORS.get(key)),
            _ratio(row, "casadi_lagrangian", "ours"),
            _ratio(row, "ours_default", "ours"),
            _ratio(row, "ours", "batch_few"),
            _ratio(row, "ours", "batch_odd"),
            _ratio(row, "ours", "batch", wide),
            _ratio(row, "ours", "batch_avx2", BATCH_FLOORS["avx2"]),
            _ratio(row, "pinocchio", "batch"),
            *[_ratio(row, "pinocchio_clang", "ours")] * clang,
        ]
        body.append([row.robot, TITLES[row.quantity], *cells])
    return _table((*HEAD, *head), body)


def _python(wrappers: Sequence[Any]) -> str:
    """Times of calls from Python."""
    body = [
        [
            w.robot,
            TITLES[w.quantity],
            f"{w.call_us:.2f}",
            f"{w.c_us:.3f}",
            f"{w.batch_ns:.1f}",
            f"{w.c_batch_ns:.1f}",
        ]
        for w in wrappers
    ]
    return _table((*HEAD, "call us", "in C us", "batch ns per point", "in C ns per point"), body)


def short(rows: Sequence[Any], machine_lines: Sequence[str]) -> str:
    """The table for docs/benchmarks.md."""
    found = {(row.robot, row.quantity): row for row in rows}
    body = []
    for key in SHORT:
        row = found.get(key)
        if row is None:
            continue
        values = [row.ns.get(label) for label in ("ours", "batch_few", "casadi_same", "pinocchio")]
        body.append(
            [
                TITLES[row.quantity],
                f"`{row.robot}`",
                *map(_number, values),
                _ratio(row, "pinocchio", "ours"),
                _ratio(row, "pinocchio", "batch_few"),
            ]
        )
    head = (
        "function",
        "robot",
        "flexgen ns",
        "batch of 200, ns per point",
        "CasADi's C ns",
        "Pinocchio ns",
        "Pinocchio / flexgen",
        "Pinocchio / batch",
    )
    return f"{_table(head, body)}\n{machine_lines[0].removeprefix('machine: ')}.\n"


def into_page(path: Path, rows: Sequence[Any], machine_lines: Sequence[str]) -> None:
    """Put the short table between the markers of a file; do nothing if there are no markers."""
    text = path.read_text()
    if BEGIN not in text or END not in text:
        return
    before, rest = text.split(BEGIN, 1)
    _, after = rest.split(END, 1)
    path.write_text(f"{before}{BEGIN}\n{short(rows, machine_lines)}{END}{after}")
