"""A C program that makes hostile calls of the inversion, read from its input, in heap blocks of
the exact size.

Every number of the input is a double. The program writes a line for each call: its status. Run
under sanitizers it ends with another exit status where anything is read or written that must not
be.
"""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

import numpy as np
from hostile import ARRAYS, OUTPUTS, STRUCTURES, Call, Target
from toolchain import CC

SANITIZE = [
    "-g",
    "-O0",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
    "-fno-omit-frame-pointer",
]

NULLS = (*ARRAYS, *OUTPUTS, "work", *STRUCTURES)

_TEXT = r"""
#include "@_inversion.h"
#include <stdio.h>
#include <stdlib.h>

enum { NA = @_NA, NG = @_NG, NM = @_NM, NY = @_NY, NT = @_NT };

/* Room for n numbers in a block that ends behind them; it is aligned to a number, not to two. */
static double *room(long long n)
{
    double *block = malloc(((size_t)n + 1) * sizeof(double));
    if (block == NULL) {
        abort();
    }
    return block + 1;
}

static void clear(double *x)
{
    free(x - 1);
}

static double next(void)
{
    double x;
    if (fread(&x, sizeof x, 1, stdin) != 1) {
        exit(9);
    }
    return x;
}

static double *numbers(long long n)
{
    double *x = room(n);
    for (long long i = 0; i < n; ++i) {
        x[i] = next();
    }
    return x;
}

typedef @_status solver(
    const @_samples *, const double *, const @_inversion_options *, @_motion *, int, double *,
    int64_t);

/* Solvers with the same arguments; reported: whether they are given an info. */
static @_status invert(const @_samples *samples, const double *q_start,
    const @_inversion_options *options, @_motion *motion, int reported, double *work, int64_t size)
{
    @_invert_info info;
    return @_invert(samples, q_start, options, motion, reported ? &info : NULL, work, size);
}

#if @_NE > 0
static @_status bvp(const @_samples *samples, const double *q_start,
    const @_inversion_options *options, @_motion *motion, int reported, double *work, int64_t size)
{
    @_bvp_info info;
    return @_bvp(samples, q_start, options, motion, reported ? &info : NULL, work, size);
}
#endif

static int whole_path(solver *function, int64_t (*wanted)(int, const @_inversion_options *))
{
    const int rows = (int)next(), n = (int)next();
    const int n_pre = (int)next(), n_post = (int)next(), samples_per_interval = (int)next();
    const double period = next(), tolerance = next();
    const @_hold hold = (@_hold)(int)next();
    const double delay = next();
    const int null = (int)next();
    const long long lacking = (long long)next();
    const @_inversion_options options = {
        n_pre, n_post, samples_per_interval, tolerance, hold, delay, 0.0, 0};
    const int64_t most = wanted(n, &options);
    const long long size = most > 0 ? (most > lacking ? most - lacking : 0) : 8;
    const long long total = most > 0 ? (long long)n + n_pre + n_post : 1;
    const int widths[7] = {NA, NA, NA, NG, NM, NM, NM};
    double *x[12], *given[12];
    int status;
    x[0] = numbers((long long)rows * NT);
    x[1] = numbers((long long)rows * NY);
    x[2] = numbers((long long)rows * NY);
    x[3] = numbers(NA);
    for (int i = 0; i < 7; ++i) {
        x[4 + i] = room(total * widths[i]);
    }
    x[11] = room(size);
    for (int i = 0; i < 12; ++i) {
        given[i] = i == null ? NULL : x[i];
    }
    {
        const @_samples path = {n, period, given[0], given[1], given[2]};
        @_motion motion = {given[4], given[5], given[6], given[7], given[8], given[9], given[10]};
        status = (int)function(null == 12 ? NULL : &path, given[3], null == 13 ? NULL : &options,
            null == 14 ? NULL : &motion, null != 15, given[11], size);
    }
    for (int i = 0; i < 12; ++i) {
        clear(x[i]);
    }
    return status;
}

static double *memory, *results[6];
static @_stream stream; /* in this memory */

static int step(const double *y, const double *dy, const double *ddy)
{
    @_motion motion = {
        results[0], results[1], NULL, results[2], results[3], results[4], results[5]};
    @_stream_info info;
    return (int)@_stream_update(&stream, y, dy, ddy, &motion, &info);
}

static int begin(void)
{
    const int intervals = (int)next(), samples_per_interval = (int)next();
    const long long lacking = (long long)next();
    const double period = next(), tolerance = next();
    const @_hold hold = (@_hold)(int)next();
    const double delay = next();
    const @_stream_options options = {
        intervals, samples_per_interval, period, tolerance, hold, delay};
    const int64_t most = @_stream_work(&options);
    const long long size = most > lacking ? most - lacking : 8;
    const int widths[6] = {NA, NA, NG, NM, NM, NM};
    double *y = numbers(NT), *q = numbers(NA);
    int status;
    for (int i = 0; i < 6; ++i) {
        if (memory != NULL) {
            clear(results[i]);
        }
        results[i] = room(most > 0 ? samples_per_interval * (long long)widths[i] : 1);
    }
    if (memory != NULL) {
        clear(memory);
    }
    memory = room(size);
    stream.memory = memory;
    stream.size = size;
    for (long long i = 0; i < size && i < 8; ++i) {
        memory[i] = 1.0; /* an update before the start */
    }
    status = step(y, y, y);
    if (status != @_NOT_STARTED && status != @_WORK_TOO_SMALL) {
        exit(8);
    }
    status = (int)@_stream_start(&stream, &options, y, q);
    clear(y);
    clear(q);
    return status;
}

static int update(void)
{
    double *y = numbers(NT), *dy = numbers(NY), *ddy = numbers(NY);
    const int status = step(y, dy, ddy);
    clear(y);
    clear(dy);
    clear(ddy);
    return status;
}

static int bound(void)
{
    double *torque = numbers(NM), *speed = numbers(NM);
    const int status = (int)@_stream_limits(&stream, torque, speed, next());
    clear(torque);
    clear(speed);
    return status;
}

/* All limits of the same value, and torque-speed curves of `points` points. */
static int all_bound(void)
{
    const double value = next(), deviation = next();
    const int points = (int)next();
    const int there = points < 22 ? points : 22; /* more are refused before they are read */
    double *each[6], *curve = room(2LL * NM * there);
    const long long sizes[6] = {NM, NM, NM, NG, NG, NG};
    double *deflection = room(@_NE);
    @_inversion_limits limits = {0};
    int status;
    for (int k = 0; k < 6; ++k) {
        each[k] = room(sizes[k]);
        for (long long i = 0; i < sizes[k]; ++i) {
            each[k][i] = value;
        }
    }
    for (int i = 0; i < @_NE; ++i) {
        deflection[i] = value;
    }
    for (int i = 0; i < NM * there; ++i) {
        curve[2 * i] = 10.0 * (i % there);
        curve[2 * i + 1] = value * (2.0 - i % there);
    }
    limits.torque_max = each[0];
    limits.speed_max = each[1];
    limits.torque_rate_max = each[2];
    limits.gear_torque_max = each[3];
    limits.joint_speed_max = each[4];
    limits.joint_acceleration_max = each[5];
    limits.deflection_max = deflection;
    limits.tool_speed_max = limits.tool_acceleration_max = value;
    limits.torque_speed = curve;
    limits.torque_speed_points = points;
    status = (int)@_stream_all_limits(&stream, &limits, deviation);
    for (int k = 0; k < 6; ++k) {
        clear(each[k]);
    }
    clear(deflection);
    clear(curve);
    return status;
}

int main(void)
{
    for (;;) {
        switch ((int)next()) {
        case 1: printf("%d\n", whole_path(invert, @_invert_work)); break;
#if @_NE > 0
        case 2: printf("%d\n", whole_path(bvp, @_bvp_work)); break;
#endif
        case 3: printf("%d\n", begin()); break;
        case 4: printf("%d\n", update()); break;
        case 5: printf("%d\n", bound()); break;
        case 6: printf("%d\n", all_bound()); break;
        default:
            for (int i = 0; i < 6 && memory != NULL; ++i) {
                clear(results[i]);
            }
            if (memory != NULL) {
                clear(memory);
            }
            return 0;
        }
    }
}
"""


def text(name: str) -> str:
    """The program for a library."""
    out = _TEXT
    for size in ("NA", "NG", "NM", "NY", "NT", "NE", "NOT_STARTED", "WORK_TOO_SMALL"):
        out = out.replace(f"@_{size}", f"{name.upper()}_{size}")
    return out.replace("@", name)


def whole_path(call: Call, kind: int = 1) -> list[float]:
    """Input of the program for a call of invert (1) or bvp (2)."""
    n = len(call.y)
    null = NULLS.index(call.null) if call.null else -1
    counts = [n if call.n is None else call.n, call.n_pre, call.n_post, call.samples_per_interval]
    head = [kind, n, *counts, call.period, call.tolerance, call.hold, call.delay]
    return [*head, null, call.short, *(x for key in ARRAYS for x in np.ravel(getattr(call, key)))]


def begin(
    one: Target,
    intervals: int,
    samples_per_interval: int,
    period: float,
    short: int = 0,
    hold: tuple[int, float] = (0, 0.0),
) -> list[float]:
    """Input of the program for the start of a stream; ``hold`` with its delay."""
    head = [3, intervals, samples_per_interval, short, period, 1e-6, *hold]
    return [*head, *one.path["y"][0], *one.path["q_start"]]


def update(given: list[np.ndarray]) -> list[float]:
    return [4, *(x for part in given for x in part)]


def bound(torque: float, speed: float, deviation: float, one: Target) -> list[float]:
    """Input of the program for equal bounds of all motors."""
    return [5, *([torque] * one.sizes["n_m"]), *([speed] * one.sizes["n_m"]), deviation]


def all_bound(value: float, deviation: float, points: int) -> list[float]:
    """Input of the program for limits of all kinds with one value; curves have ``points``."""
    return [6, value, deviation, points]


def statuses(command: list[str], records: list[list[float]], folder: Path) -> list[int]:
    """The status of every call; fails with what the sanitizers said."""
    given = np.array([x for record in [*records, [0]] for x in record]).tobytes()
    done = subprocess.run(command, input=given, cwd=folder, capture_output=True, check=False)
    said = done.stderr.decode(errors="replace")
    assert done.returncode == 0, (
        done.returncode,
        len(done.stdout.split()),
        len(records),
        said[:3000],
    )
    return [int(word) for word in done.stdout.split()]


@cache
def can_sanitize(folder: Path) -> bool:
    """Whether the compiler has both sanitizers, and programs with them start."""
    (folder / "try.c").write_text("int main(void) { return 0; }\n", encoding="ascii")
    built = subprocess.run(
        [str(CC), *SANITIZE, "try.c", "-o", "try"], cwd=folder, capture_output=True, check=False
    )
    return (
        built.returncode == 0
        and subprocess.run([folder / "try"], capture_output=True, check=False).returncode == 0
    )
