"""The sampler of planned paths in the emitted C: the bits of Python's samples, on every law and
curve.
"""

from __future__ import annotations

import json
import pickle
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest
from emitted import paths_library, run
from hostile_client import SANITIZE, can_sanitize
from toolchain import CC, needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError, FlexgenError
from flexgen.codegen.emission.path_header import path_header
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.model.moves import Move, MoveC, MoveJ, MoveL, Program
from flexgen.paths.geometry import blended_curve
from flexgen.paths.geometry.trigonometry import root, sine_cosine
from flexgen.paths.path import Path, plan
from flexgen.paths.timing import time_laws
from flexgen.runtime.library import Library
from flexgen.runtime.streams.path_sampler import PathSampler

pytestmark = needs_compiler
SUPPORT = FilePath(__file__).resolve().parents[1] / "support"
FIVE = (0.5, 5.0, 100.0, 4000.0, 2e5)  # bounds on speed, acceleration, ...
# Rounding of the kinematics, relative to the largest entry: some hundred operations.
ROUNDING = 2e-13

CLIENT = r"""
#include "line.h"
#include "planar5_nmp_inversion.h"
#include <stdio.h>

int main(void)
{
    static double work[10000];
    double y[PLANAR5_NMP_NT], dy[PLANAR5_NMP_NY], ddy[PLANAR5_NMP_NY];
    if (planar5_nmp_path_work() > 10000 ||
        planar5_nmp_path_sample(planar5_nmp_path_line, PLANAR5_NMP_PATH_LINE_SIZE, 0.2,
                                y, dy, ddy, work, 10000) != 0) {
        return 1;
    }
    printf("%a %a %a %a %a %a\n", y[0], y[1], dy[0], dy[1], ddy[0], ddy[1]);
    return 0;
}
"""
LINE = MoveL((0.08, 0.08, -0.08), rotation=(0.2, 0.1, 0.0), zone=0.03)
LEGS = (
    LINE,
    MoveC((-0.06, 0.09, 0.0), via=(0.0, 0.06, 0.01), zone=0.02),
    MoveL((-0.05, 0.0, -0.1)),
)


def robot_moves(start: tuple[float, ...]) -> dict[str, Move]:
    """Moves of a six-axis robot whose output is a pose."""
    end = tuple(np.add(start, [0.4, -0.2, 0.3, 0.1, 0.5, -0.6]))
    arc = {
        "center": (0.05, 0.12, -0.03),
        "axis": (0.3, -0.2, 1.0),
        "angle": 1.9,
        "rotation": (0.2, 0.4, -0.3),
    }
    steps = (MoveJ(end, zone=0.1), MoveJ(start), *LEGS, MoveJ(end, pause=0.1), MoveJ(start))
    bounds = {"profile": FIVE, "joint_profile": (1.0, 10.0, 200.0, 9000.0)}
    return {
        "line": Move(
            "line",
            "tool_line",
            start,
            0.8,
            5,
            displacement=(0.1, 0.1, -0.1),
            rotation=(0.2, 0.0, 0.3),
        ),
        "trapezoids": Move(
            "line", "tool_line", start, 0.0, 0, displacement=(0.1, 0.1, -0.1), profile=FIVE
        ),
        "polynomials": Move(
            "line", "tool_line", start, 0.0, 4, displacement=(0.1, 0.1, -0.1), profile=FIVE[:3]
        ),
        "arc": Move("arc", "tool_circle", start, 0.8, 5, **arc),
        "turn": Move(
            "turn",
            "tool_line",
            start,
            0.8,
            5,
            displacement=(0.0, 0.0, 0.0),
            rotation=(0.2, 0.4, -0.3),
        ),
        "corner": Move("corner", "tool_polyline", start, 0.9, 6, legs=LEGS, radius=0.01),
        "turning corner": Move(
            "corner", "tool_polyline", start, 0.9, 6, legs=(LINE, LEGS[2]), radius=2.0
        ),
        "bounded corner": Move(
            "corner", "tool_polyline", start, 0.0, 0, legs=LEGS, profile=FIVE, radius=0.01
        ),
        "joints": Move("joints", "joint", start, 0.7, 4, end=end),
        "program": Program("program", start=start, steps=steps, **bounds),
    }


@cache
def library(name: str) -> Library:
    return paths_library(flexgen.derive(name), "path_sampler")


def case(name: str, move: str) -> Path:
    """A path of a model: one of its own moves, or one of `robot_moves`."""
    own = {m.name: m for m in flexgen.read(name).moves}
    chosen = (
        own[move] if move in own and name != "manutec_r3" else robot_moves(own["line"].start)[move]
    )
    return Path(flexgen.derive(name), chosen)


def instants(path: Path) -> np.ndarray:
    """Equidistant ones, those of laws and corners and near them, and some outside."""
    breaks = path.breaks
    return np.sort(
        np.r_[np.linspace(-0.1, path.duration + 0.1, 301), breaks, breaks - 1e-9, breaks + 1e-9]
    )


def right(path: Path, t: np.ndarray) -> list[np.ndarray]:
    """y, dy and ddy of Python."""
    sample = path.sample(t)
    return [Reduction(path.equations).targets(sample), sample.derivative(1), sample.derivative(2)]


def sampled(path: Path, t: np.ndarray, sampler: PathSampler | None = None) -> list[np.ndarray]:
    """y, dy and ddy of C."""
    sampler = sampler or library(path.equations.model.name).path_sampler(path.table())
    return [np.array(x) for x in zip(*(sampler(at) for at in t), strict=True)]


CASES = [
    *(("manutec_r3", move) for move in robot_moves((0.0,) * 6)),
    ("planar5_nmp", "line"),
    ("planar5_nmp", "joints"),
    ("elbow", "line"),
    ("abb_arm", "turn"),
    ("urdf_arm", "line"),
    ("manutec_r3_18", "joints"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "move"), CASES, ids=lambda words: words.replace(" ", "_"))
def test_samples_have_the_bits_of_python(name: str, move: str) -> None:
    path = case(name, move)
    t = instants(path)
    joints = np.array([segment.space == "joint" for segment in path.segments])
    starts = [segment.start for segment in path.segments]
    rounded = joints[np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(starts) - 1)]
    for found, expected in zip(sampled(path, t), right(path, t), strict=True):
        assert np.array_equal(found[~rounded], expected[~rounded])
        assert np.abs(found - expected).max() <= ROUNDING * max(1.0, np.abs(expected).max())


def test_duration_and_start_are_those_of_the_path() -> None:
    path = case("manutec_r3", "program")
    sampler = library("manutec_r3").path_sampler(path.table())
    assert sampler.duration == path.duration
    assert np.array_equal(sampler.q_start, path.q_start)
    again = pickle.loads(pickle.dumps(sampler))
    assert all(np.array_equal(a, b) for a, b in zip(again(0.3), sampler(0.3), strict=True))


@pytest.mark.parametrize("bug", ["law", "corner", "sine"])
def test_a_planted_change_of_an_operation_changes_the_bits(
    bug: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Planted: the last bit of the law's coefficients, the smoothness of the corners, the sine of
    the C library.
    """
    path = case("manutec_r3", "arc" if bug == "sine" else "corner")
    t = np.linspace(0.0, path.duration, 301)
    found = sampled(path, t)
    if bug == "law":
        monkeypatch.setattr(
            time_laws, "comb", lambda n, k: __import__("math").comb(n, k) * (1.0 + 2.3e-16)
        )
    elif bug == "corner":
        monkeypatch.setattr(blended_curve, "BUMP", 3)
    else:
        monkeypatch.setattr(
            "flexgen.paths.geometry.segments.sine_cosine", lambda x: (np.sin(x), np.cos(x))
        )
    changed = right(Path(path.equations, path.move), t)
    assert not all(np.array_equal(a, b) for a, b in zip(found, changed, strict=True))


def test_sine_and_cosine_agree_with_the_c_library() -> None:
    """Against those of the C library, which err by less than one unit in the last place."""
    rng = np.random.default_rng(7)
    x = np.r_[
        rng.uniform(-10, 10, 20_000),
        rng.uniform(-1e6, 1e6, 20_000),
        np.arange(-40, 41) * np.pi / 4,
        0.0,
    ]
    for found, expected in zip(sine_cosine(x), (np.sin(x), np.cos(x)), strict=True):
        assert np.abs(found - expected).max() <= 2.3e-16
    assert np.isnan(sine_cosine(np.array([2e6, np.nan, np.inf]))).all()


def test_square_roots_are_exact_to_two_units_in_the_last_place() -> None:
    x = np.random.default_rng(8).lognormal(0.0, 20.0, 20_000)
    assert np.abs(root(x) / np.sqrt(x) - 1.0).max() <= 4.5e-16  # two units in the last place
    assert root(np.array([0.0, 1.0, 4.0])).tolist() == [0.0, 1.0, 2.0]


def test_a_stream_follows_the_samples_of_c() -> None:
    """A controller's loop: samples from the table into a stream, without Python's path."""
    path = case("planar5_nmp", "line")
    emitted = library("planar5_nmp")
    sampler = emitted.path_sampler(path.table())
    period = 5e-3
    intervals = 60
    options = {"period": period, "intervals": intervals, "samples_per_interval": 5}
    stream = emitted.stream(sampler(0.0)[0], sampler.q_start, **options)
    expected = emitted.stream(right(path, np.zeros(1))[0][0], path.q_start, **options)
    for k in range(1, 80):
        t = k * period
        found = stream.update(*sampler(t))
        y, dy, ddy = (x[0] for x in right(path, np.array([t])))
        assert np.array_equal(found.tau_m, expected.update(y, dy, ddy).tau_m)


def test_tables_of_other_models_or_formats_are_refused() -> None:
    path = case("planar5_nmp", "line")
    emitted = library("planar5_nmp")
    table = path.table()
    for wrong in (
        table[:-1],
        np.r_[table, 0.0],
        np.zeros(5),
        np.full(50, np.nan),
        np.r_[table[0], 2, table[2:]],
    ):
        with pytest.raises(ArgumentError, match="path_sampler"):
            emitted.path_sampler(wrong)
    with pytest.raises(ArgumentError, match="path_sampler"):
        library("manutec_r3").path_sampler(table)
    with pytest.raises(ArgumentError, match="expected a number"):
        emitted.path_sampler(table)("soon")
    with pytest.raises(ArgumentError, match="path_sampler"):
        emitted.path_sampler(table)(np.inf)


@pytest.mark.slow
def test_a_c_program_reads_the_header(tmp_path) -> None:
    """The header that the command line writes, included by a controller: bits of the samples."""
    header = tmp_path / "line.h"
    answer = run(
        *(
            sys.executable,
            "-m",
            "flexgen",
            "plan",
            "planar5_nmp",
            "--move",
            "line",
            "--out",
            header,
            "--json",
        ),
        folder=tmp_path,
    )
    path = case("planar5_nmp", "line")
    assert json.loads(answer)["duration_s"] == path.duration
    made = flexgen.generate("planar5_nmp", tmp_path / "library")
    (tmp_path / "client.c").write_text(CLIENT, encoding="ascii")
    libraries = [str(file) for file in made.directory.iterdir() if file.suffix == ".a"]
    run(
        CC,
        "-std=c99",
        "client.c",
        f"-I{made.directory}",
        *libraries,
        "-lm",
        "-o",
        "client",
        folder=tmp_path,
    )
    printed = [float.fromhex(word) for word in run(tmp_path / "client", folder=tmp_path).split()]
    expected = [x[0] for x in right(path, np.array([0.2]))]
    assert np.array_equal(printed, np.concatenate(expected))


def test_splines_through_samples_have_no_table(tmp_path) -> None:
    file = tmp_path / "path.csv"
    file.write_text(
        "x,y,z\n" + "".join(f"{0.9 - 0.01 * k},{0.6 + 0.02 * k},0\n" for k in range(12))
    )
    start = flexgen.read("planar5_nmp").move("line").start
    move = Move("samples", "sampled", start, 1.0, 5, file=str(file), degree=5)
    with pytest.raises(ArgumentError, match="spline through samples"):
        plan("planar5_nmp", move).table()


def damaged(table: np.ndarray, count: int) -> list[np.ndarray]:
    """The table with another number at a random entry, or cut there."""
    rng = np.random.default_rng(3)
    out = []
    for at in rng.integers(0, len(table), count):
        changed = table.copy()
        changed[at] = rng.choice(
            [-1.0, 0.0, 0.5, 2.0, 7.0, 1e3, 1e18, -1e300, float(len(table)), np.nan]
        )
        out.append(
            changed
            if rng.random() < 0.9
            else np.r_[float(at), table[1:at]]
            if at > 0
            else table[:1]
        )
    return out


def test_a_table_with_a_negative_duration_is_refused() -> None:
    path = case("manutec_r3", "line")
    emitted = library("manutec_r3")
    table = path.table()
    (place,) = np.flatnonzero(table[:10] == path.duration)
    for wrong in (-path.duration, -1e-300):
        table[place] = wrong
        with pytest.raises(ArgumentError):
            emitted.path_sampler(table)


@pytest.mark.parametrize("move", ["corner", "program"])
def test_damaged_tables_are_refused_without_a_crash(move: str) -> None:
    """An error or finite results."""
    path = case("manutec_r3", move)
    emitted = library("manutec_r3")
    refused = 0
    for table in damaged(path.table(), 300):
        try:
            results = sampled(
                path, np.linspace(0.0, path.duration, 3), emitted.path_sampler(table)
            )
        except FlexgenError:
            refused += 1
        else:
            assert all(np.isfinite(x).all() for x in results)
    assert refused > 30  # what cannot be read; another length of a line is not an error


@pytest.mark.slow
@pytest.mark.parametrize("bug", [None, "one number too many"])
def test_sanitizers_find_nothing_in_damaged_tables(tmp_path, bug: str | None) -> None:
    """The tables end where the memory ends. Planted: a reader that takes one number more than
    there is.
    """
    if not can_sanitize(tmp_path):
        pytest.skip("the C compiler has no sanitizers; install the Debian package gcc or clang")
    made = flexgen.generate("manutec_r3", tmp_path / "library", build=False)
    client = (SUPPORT / "programs" / "sample_tables.c").read_text(encoding="ascii")
    client = client.replace("@_N", "MANUTEC_R3_N").replace("@", "manutec_r3")
    (tmp_path / "client.c").write_text(client, encoding="ascii")
    if bug is not None:
        header = made.directory / "src" / "manutec_r3_path_sampler.c"
        text = header.read_text(encoding="ascii")
        assert text.count("n > r->end - r->at") == 1
        header.write_text(
            text.replace("n > r->end - r->at", "n > r->end - r->at + 1"), encoding="ascii"
        )
    used = [
        made.directory / "src" / f"manutec_r3_{name}.c"
        for name in ("path_sampler", "output_constraint")
    ]
    include = [f"-I{made.directory}", f"-I{made.directory / 'src'}"]
    run(
        CC,
        "-std=c99",
        *SANITIZE,
        "client.c",
        *used,
        *include,
        "-lm",
        "-o",
        "client",
        folder=tmp_path,
    )
    with (tmp_path / "tables").open("wb") as file:
        for move in ("corner", "program", "joints"):
            for table in damaged(case("manutec_r3", move).table(), 400):
                file.write(np.r_[float(len(table)), table].tobytes())
    answer = subprocess.run(
        [tmp_path / "client", tmp_path / "tables"], capture_output=True, text=True, check=False
    )
    assert (answer.returncode == 0) == (bug is None), answer.stderr[:3000]
    if bug is None:
        assert answer.stdout.split() == ["1200", "tables"]


@pytest.mark.slow
def test_single_precision_keeps_seven_digits(tmp_path) -> None:
    path = case("planar5_nmp", "line")
    made = flexgen.generate("planar5_nmp", tmp_path / "single", precision="single")
    sampler = flexgen.load(made.directory).path_sampler(path.table())
    t = np.linspace(0.0, path.duration, 101).astype(np.float32).astype(float)
    for found, expected in zip(sampled(path, t, sampler), right(path, t), strict=True):
        assert np.abs(found - expected).max() <= 2e-5 * max(1.0, np.abs(expected).max())


@pytest.mark.slow
def test_run_time_parameters_are_an_argument(tmp_path) -> None:
    """The payload does not move the tool: samples of a joint move are as without parameters, with
    any payload.
    """
    path = case("elbow", "joints")
    made = flexgen.generate("elbow", tmp_path / "payload", parameters=["payload"])
    emitted = flexgen.load(made.directory)
    t = np.linspace(0.0, path.duration, 31)
    heavy = np.where(
        np.array([name.endswith("mass") for name in emitted.parameter_names]),
        7.0,
        emitted.parameters,
    )
    expected = sampled(path, t)
    for parameters in (None, heavy):
        found = sampled(path, t, emitted.path_sampler(path.table(), parameters=parameters))
        for a, b in zip(found, expected, strict=True):
            assert np.abs(a - b).max() <= ROUNDING * max(1.0, np.abs(b).max())
    with pytest.raises(ArgumentError, match="parameters"):
        emitted.path_sampler(path.table(), parameters=[1.0])


def test_the_table_of_a_planned_path_is_that_of_its_move() -> None:
    path = case("planar5_nmp", "line")
    again = plan("planar5_nmp", replace(path.move))
    assert np.array_equal(again.table(), path.table())


@pytest.mark.parametrize("name", ["work", "start", "sample"])
def test_a_path_with_the_name_of_a_function_has_another_name_in_c(name: str) -> None:
    text = path_header(flexgen.read("planar5_nmp"), name, np.array([1.0]), 1.0)
    assert f" planar5_nmp_path_{name}_[PLANAR5_NMP_PATH_{name.upper()}__SIZE]" in text
    assert " planar5_nmp_path_worked[" in path_header(
        flexgen.read("planar5_nmp"), "worked", np.array([1.0]), 1.0
    )
