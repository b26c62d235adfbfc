"""Tables of inverse dynamics as markdown: all for benchmarks/inversion.md, the short table for
docs/benchmarks.md.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from inversion_generate import WANTED_S, GenerateRow
from inversion_paths import EXACT, MESHES, PathRow
from inversion_peers import PeerRow
from inversion_solve import SolveRow
from inversion_stream import INTERVALS, PARTS, PERIOD, WANTED_M, WANTED_US, StreamRow
from peers_builds import NATIVE, REPRODUCIBLE, Builds, package_version
from peers_table import _cpu, _table

BEGIN = "<!-- inversion:begin -->"
END = "<!-- inversion:end -->"


def machine(builds: Builds) -> list[str]:
    """The machine, how busy it was, the compiler, the flags and the versions: a line each."""
    cpu = _cpu()
    load = ", ".join(f"{x:.1f}" for x in os.getloadavg())
    return [
        (
            f"machine: {cpu.get('model name', 'processor unknown')}, {os.cpu_count()} cores; "
            f"one used; load {load}"
        ),
        f"compiler: {builds.version(builds.cc)}",
        f"native build: `{' '.join(NATIVE[:-2])}`; default build: `{' '.join(REPRODUCIBLE[:-2])}`",
        f"packages: casadi {package_version('casadi')}, scipy {package_version('scipy')}",
    ]


def _ms(x: float, wanted: float | None = None) -> str:
    text = f"{x:.2f}" if x < 9.95 else f"{x:.1f}" if x < 99.95 else f"{x:.0f}"
    return f"**{text}**" if wanted is not None and x > wanted else text


def _error(error_m: float, error_rad: float | None) -> str:
    text = f"{1e6 * error_m:.2g} um"
    return text if error_rad is None else f"{text}, {1e6 * error_rad:.2g} urad"


def paths(rows: Sequence[PathRow]) -> str:
    """Whole paths."""
    head = [
        "robot",
        "move",
        "method",
        "native, ms per s of path",
        "default build",
        "target",
        "motion, s per s of path",
        "native, ms per s of motion",
        "times real time",
        "mesh ms",
        "intervals",
        "iterations",
        "tool error",
        "status of the C",
        "difference of native build",
    ]
    body = []
    for row in rows:
        if row.refused:
            body.append(
                [
                    f"`{row.robot}`",
                    row.move,
                    row.method,
                    *["-"] * 9,
                    row.refused.replace("|", "/"),
                    "-",
                    "-",
                ]
            )
            continue
        body.append(
            [
                f"`{row.robot}`",
                row.move,
                row.method,
                _ms(row.native_ms, row.wanted_ms if row.method == "lq" else None),
                _ms(row.default_ms),
                f"{row.wanted_ms:g}" if row.method == "lq" else "-",
                f"{row.motion_s / row.duration:.2f}",
                _ms(row.native_ms * row.duration / row.motion_s),
                f"{1e3 / row.native_ms:.0f}",
                f"{row.mesh_ms:g}",
                str(row.intervals),
                str(row.iterations),
                _error(row.error_m, row.error_rad),
                "`OK`" if row.is_ok else "`TOLERANCE_NOT_MET`",
                f"{row.native_differs:.0e}",
            ]
        )
    return _table(head, body)


def streams(rows: Sequence[StreamRow]) -> str:
    """Streaming."""
    head = [
        "robot",
        "build",
        "updates",
        "median us",
        "99 %",
        "99.9 %",
        "largest",
        "tool error",
        "tolerance not met",
        "residual",
    ]
    body = [
        [
            f"`{row.robot}`",
            row.build,
            str(row.updates),
            f"{row.median_us:.0f}",
            f"{row.p99_us:.0f}",
            f"{row.p999_us:.0f}"
            if row.p999_us <= WANTED_US[row.build]
            else f"**{row.p999_us:.0f}**",
            f"{row.largest_us:.0f}",
            _error(row.error_m, row.error_rad),
            str(row.inexact),
            f"{row.residual:.0e}",
        ]
        for row in rows
    ]
    return _table(head, body)


def peers(rows: Sequence[PeerRow]) -> str:
    """Other ways."""
    head = [
        "what",
        "robot",
        "setting",
        "timed",
        "ms per s of path",
        "tool error",
        "lq in C, ms",
        "ratio",
    ]
    body = []
    for row in rows:
        if np.isnan(row.ms):
            body.append(
                [
                    row.what,
                    f"`{row.robot}`",
                    row.setting,
                    row.contains,
                    row.missing,
                    "-",
                    _ms(row.ours_ms),
                    "-",
                ]
            )
            continue
        error = _error(row.error_m, row.error_rad)
        body.append(
            [
                row.what,
                f"`{row.robot}`",
                row.setting,
                row.contains,
                _ms(row.ms),
                error if row.error_m <= EXACT else f"**{error}**",
                _ms(row.ours_ms),
                f"{row.ms / row.ours_ms:.0f}",
            ]
        )
    return _table(head, body)


def generated(rows: Sequence[GenerateRow]) -> str:
    """Generation."""
    head = ["robot", "build", "wall s", "processor s"]
    return _table(
        head, [[f"`{r.robot}`", r.build, f"{r.wall_s:.1f}", f"{r.processor_s:.1f}"] for r in rows]
    )


def solved(rows: Sequence[SolveRow]) -> str:
    """Solving with verification."""
    head = [
        "robot",
        "solve and verify, s",
        "of it simulation, s",
        "right-hand sides",
        "tool error",
    ]
    return _table(
        head,
        [
            [
                f"`{r.robot}`",
                f"{r.wall_s:.2f}",
                f"{r.simulation_s:.2f}",
                str(r.evaluations),
                f"{1e6 * r.error_m:.2g} um",
            ]
            for r in rows
        ],
    )


def full(
    path_rows: Sequence[PathRow],
    stream_rows: Sequence[StreamRow],
    peer_rows: Sequence[PeerRow],
    generate_rows: Sequence[GenerateRow],
    solve_rows: Sequence[SolveRow],
    machine_lines: Sequence[str],
) -> str:
    """Everything that was measured."""
    meshes = ", ".join(f"{1e3 * mesh:g}" for mesh in MESHES)
    return f"""\
# Inverse dynamics along paths

`make bench` writes this file. Times are of one machine and one run. Bold: above the target time, \
or less accurate
than the target. Ratios are more portable than times.

{chr(10).join(f"- {line}" for line in machine_lines)}

## Whole paths

Processor time of one thread for one call of the library from Python, divided by the duration of \
the path; the minimum
of several calls. It contains the equilibrium at the start, inverse kinematics, inversion with \
the motion before and
after the path, gears and motors. Samples of the path are given. The mesh is the coarsest of \
{meshes} ms whose
torques, of the default build, move the tool of the full model within 1 um and 1 urad of its \
path. The status is that
of the C at its default tolerance. The last column is the largest difference of the torques of \
the native build from
them, relative to the largest torque. The motion begins before the path where zeros are unstable. \
That of lq ends as in
`solve`, once the remaining motion moves the tool by less than 10 nm; that of bvp after fifteen \
time constants of the
slowest stable zero: slow vibrations of six axes take
seconds, which are inverted too. The targets were set for motions of about 1.5 s per s of path.

{paths(path_rows)}
## Streaming

The line in both directions, repeated, with pauses: {INTERVALS} intervals of {1e3 * PERIOD:g} ms \
ahead, {PARTS} samples
each; processor time of the thread for each update, in C, the minimum of three runs of the same \
updates. Target: at most
{WANTED_US["native"]:g} us (default build: {WANTED_US["default"]:g} us) for 99.9 % of the updates,
tool error at most {1e6 * WANTED_M:g} um.
The tool error is that of the first round in simulation of the full model.

{streams(stream_rows)}
## Other programs for the same torques

Each program with the coarsest setting that is accurate to 1 um, or with the best accuracy that \
was reached.
`collocation` is part of flexgen and solves the same reduced problem. `solve_bvp` solves the \
reduced problem too: with
right-hand side and Jacobian for all points at once from the generated C, boundary conditions \
from the stable and
unstable subspaces, and the fastest accurate one of many settings; its initial guess and the \
motors are not in its
time. opty (midpoint rule) solves the original equations, with the output as algebraic \
constraints (index 4) or as a
tracking term of the cost, with the weight that gave the best result; only IPOPT is timed. lq is \
the native build with
everything.

{peers(peer_rows)}
## Generating

`flexgen.generate` with all functions, inversion and streaming, with an empty cache, in a \
separate process; target: at
most {WANTED_S:g} s on two cores. Processor time is that of all processes.

{generated(generate_rows)}
## Solving and verifying

`flexgen.solve` of the first move with a warm cache: derivation excluded, inversion by lq and \
verification by
simulation of the full model (the Lagrange equations in C, Runge-Kutta of order 8, relative \
tolerance 1e-11) included.
Wall time, the shortest of several calls.

{solved(solve_rows)}"""


def short(
    path_rows: Sequence[PathRow], stream_rows: Sequence[StreamRow], machine_lines: Sequence[str]
) -> str:
    """The table for docs/benchmarks.md: the slowest move of each robot by lq, and the stream."""
    head = [
        "robot",
        "degrees of freedom",
        "ms for 1 s of path",
        "default build",
        "motion, s",
        "times real time",
        "largest tool error",
    ]
    body = []
    for robot in dict.fromkeys(row.robot for row in path_rows):
        rows = [
            row
            for row in path_rows
            if row.robot == robot and row.method == "lq" and not row.refused
        ]
        if not rows:
            continue
        slowest = max(rows, key=lambda row: row.native_ms)
        worst = max(row.error_m for row in rows), max(row.error_rad or 0.0 for row in rows)
        body.append(
            [
                f"`{robot}`",
                str(slowest.dof),
                _ms(slowest.native_ms),
                _ms(max(row.default_ms for row in rows)),
                f"{slowest.motion_s / slowest.duration:.1f}",
                f"{1e3 / slowest.native_ms:.0f}",
                _error(worst[0], worst[1] or None),
            ]
        )
    lines = [_table(head, body)]
    for row in stream_rows:
        if row.build == "native":
            lines.append(
                f"Moving horizon, `{row.robot}`, {INTERVALS * PERIOD * 1e3:g} ms ahead, every "
                f"{1e3 * PERIOD:g} ms: {row.median_us:.0f} us an update, 99.9 % below "
                f"{row.p999_us:.0f} us, tool error {_error(row.error_m, row.error_rad)}.\n"
            )
    return "\n".join(lines) + (
        f"\n{machine_lines[0].removeprefix('machine: ').split(';')[0]}; one core, native build.\n"
    )


def into_page(path: Path, text: str) -> None:
    """Put a text between the markers of a file; do nothing if there are no markers."""
    whole = path.read_text()
    if BEGIN not in whole or END not in whole:
        return
    before, rest = whole.split(BEGIN, 1)
    _, after = rest.split(END, 1)
    path.write_text(f"{before}{BEGIN}\n{text}{END}{after}")
