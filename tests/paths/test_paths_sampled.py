"""Paths through the samples of files: what was sampled comes back, at rest at its ends, with exact
derivatives.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from path_derivatives import DIFFERENCE, derivatives_agree

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.model.moves import Move, MoveL
from flexgen.paths.geometry.jets import quaternion
from flexgen.paths.path import Path
from flexgen.paths.samples.sample_files import read_samples

START = (0.3, -1.1)


@pytest.fixture(scope="module")
def arm():
    return flexgen.derive("planar5_nmp")


@pytest.fixture(scope="module")
def robot():
    return flexgen.derive("manutec_r3")


def write(path: FilePath, columns: dict[str, np.ndarray]) -> str:
    rows = np.stack(list(columns.values()), axis=1)
    text = (
        ",".join(columns)
        + "\n"
        + "".join(",".join(f"{x:.17g}" for x in row) + "\n" for row in rows)
    )
    path.write_text(text)
    return str(path)


def tool_columns(path: Path, t: np.ndarray) -> dict[str, np.ndarray]:
    """Positions, and quaternions of a pose, at instants of a path."""
    sample = path.sample(t)
    p = sample.y[:, :, 0] if path.pose else np.column_stack([sample.y[:, :, 0], np.zeros(len(t))])
    out = dict(zip("xyz", p.T, strict=True))
    if sample.R is not None:
        q = np.array([quaternion(R) for R in sample.R])
        out |= dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True))
    return out


def test_a_sampled_path_with_time_comes_back(robot, tmp_path: FilePath) -> None:
    move = replace(robot.model.move("line"), rotation=(0.3, 0.1, -0.2), smoothness=5)
    original = Path(robot, move)
    t = np.linspace(0, move.duration, 101)
    file = write(tmp_path / "line.csv", {"t": t + 3.0} | tool_columns(original, t))
    path = Path(robot, Move("again", "sampled", move.start, 0.0, 0, file=file))
    assert abs(path.duration - move.duration) < 1e-12 and path.smoothness == 3
    fine = np.linspace(0, move.duration, 777)
    found = path.sample(fine)
    right = original.sample(fine)
    # a septic spline of 100 intervals: some 1e-13 of the size and a factor of 1e2 more for each
    # derivative
    for k in range(4):
        assert np.abs(found.y[:, :, k] - right.y[:, :, k]).max() < 1e-11 * 10 ** (1.5 * k) * max(
            1, np.abs(right.y[:, :, k]).max()
        )
        assert np.abs(found.w[:, :, k] - right.w[:, :, k]).max() < 1e-9 * 10 ** (1.5 * k) * max(
            1, np.abs(right.w[:, :, k]).max()
        )
    assert np.abs(found.R - right.R).max() < 1e-10
    ends = path.sample(np.array([-1.0, 1e-9, path.duration - 1e-9, 9.0]))
    assert np.abs(ends.y[:, :, 1:3]).max() < 1e-6 and not ends.y[[0, 3], :, 1:].any()


@pytest.mark.parametrize("degree", [5, 7, 9])
def test_derivatives_of_splines(robot, tmp_path: FilePath, degree: int) -> None:
    u = np.linspace(0, 1, 25)
    columns = {
        "x": 0.9 + 0.1 * np.sin(3 * u),
        "y": 1.2 - 0.1 * u,
        "z": 1.0 + 0.05 * u**2,
        "rx": 0.3 * u,
        "ry": 0.1 + 0.2 * np.sin(u),
        "rz": np.zeros(25),
    }
    move = Move("wave", "sampled", robot.model.move("line").start, 0.7, 6, degree=degree)
    start = Path(robot, robot.model.move("line"))
    p = start.reference.tool_pose(move.start)[0]
    columns = columns | {k: columns[k] - columns[k][0] + p[i] for i, k in enumerate("xyz")}
    with pytest.raises(flexgen.SolverError, match="inverse kinematics"):  # out of reach
        Path(
            robot,
            replace(move, file=write(tmp_path / "far.csv", columns | {"x": columns["x"] + 9.0})),
        )
    q = quaternion(start.reference.tool_pose(move.start)[1])
    turned = {name: np.full(25, q[i]) for i, name in enumerate(("qw", "qx", "qy", "qz"))}
    turned["qx"] = turned["qx"] + 0.1 * np.sin(u) ** 2
    norm = np.sqrt(sum(v**2 for v in turned.values()))
    turned = {name: v / norm for name, v in turned.items()}
    file = write(tmp_path / "wave.csv", {k: columns[k] for k in "xyz"} | turned)
    path = Path(robot, replace(move, file=file))
    t = (
        np.linspace(0.3, 0.302, 2001)
        if degree < 9
        else np.linspace(0.05, 0.95, 6001) * path.duration
    )
    sample = path.sample(t)
    assert derivatives_agree(t, sample.y) < DIFFERENCE
    assert derivatives_agree(t, sample.w) < DIFFERENCE
    assert path.smoothness == min(6, degree - 1)
    # arc length: the speed of the tool is that of the law
    speed = np.linalg.norm(sample.y[:, :, 1], axis=1)
    law = path.segments[0].law(t)[:, 1]
    assert np.abs(speed - law).max() < 1e-12 * np.abs(law).max()
    every = path.sample(np.linspace(0, path.duration, 4001)).y[:, :, 0]
    points = np.column_stack([columns[k] for k in "xyz"])
    gaps = np.linalg.norm(every[:, None, :] - points[None], axis=2).min(axis=0)
    assert gaps.max() < 1e-4  # as near as the nearest of the instants


def test_joints_and_bounds_from_files(arm, tmp_path: FilePath) -> None:
    u = np.linspace(0, 1, 30)
    q = np.column_stack([0.3 + 0.4 * u, -1.1 - 0.3 * np.sin(2 * u)])
    file = tmp_path / "joints.npz"
    np.savez(file, q_g=q, u=u)
    move = Move("swing", "sampled", (), 0.0, 5, file=str(file), profile=(1.0, 8.0, 200.0))
    path = Path(arm, move)
    t = np.linspace(0, path.duration, 30001)
    sample = path.sample(t)
    assert np.abs(sample.q_g[[0, -1], :, 0] - q[[0, -1]]).max() < 1e-12
    assert path.move.start == pytest.approx(tuple(q[0]), abs=1e-12)
    peaks = np.abs(sample.q_g).max(axis=(0, 1))
    assert all(peaks[k] <= bound * (1 + 1e-6) for k, bound in enumerate(move.profile, 1))
    assert max(peaks[k] / bound for k, bound in enumerate(move.profile, 1)) > 0.5
    inner = slice(100, -100)
    assert derivatives_agree(t[inner], sample.q_g[inner][..., :3]) < DIFFERENCE


def test_outputs_from_files(tmp_path: FilePath) -> None:
    masses = flexgen.derive("four_mass")
    start = masses.model.moves[0].start
    y0 = Path(masses, masses.model.moves[0]).sample(np.zeros(1)).y[0, 0, 0]
    t = np.linspace(0, 1, 60)
    file = write(tmp_path / "y.csv", {"t": t, "y1": y0 + 0.1 * t**4 * (1 - t) ** 4})
    path = Path(masses, Move("bump", "sampled", start, 0.0, 0, file=file))
    assert np.abs(path.sample(t).y[:, 0, 0] - y0 - 0.1 * t**4 * (1 - t) ** 4).max() < 1e-14


def test_a_tool_that_only_turns(robot, tmp_path: FilePath) -> None:
    start = robot.model.move("line").start
    turn = Path(
        robot, Move("turn", "tool_line", start, 1.0, 5, (0.0, 0.0, 0.0), rotation=(0.0, 0.5, 0.0))
    )
    file = write(tmp_path / "turn.csv", tool_columns(turn, np.linspace(0.2, 0.8, 30)))
    path = Path(robot, Move("again", "sampled", start, 1.0, 5, file=file))
    w = np.linalg.norm(path.sample(np.linspace(0.1, 0.9, 101)).w[:, :, 0], axis=1)
    law = path.segments[0].law(np.linspace(0.1, 0.9, 101))[:, 1] / path.move.radius
    assert np.abs(w - law).max() < 1e-9


def test_a_path_that_turns_back_stops_at_the_turn(arm, tmp_path: FilePath) -> None:
    """Out and back along a line: the speed is zero at the turn, where the tool is at its
    sample.
    """
    p = Path(arm, arm.model.move("line")).reference.tool_pose(START)[0]
    u = np.linspace(0, 2, 41)
    columns = {"x": p[0] - 0.1 * (1 - np.abs(u - 1)), "y": p[1] + 0 * u, "z": 0 * u}
    file = write(tmp_path / "back.csv", columns)
    path = Path(arm, Move("back", "sampled", START, 1.0, 5, file=file))
    assert path.duration == pytest.approx(1.0) and len(path.segments) == 2
    y = path.sample(np.linspace(0.0, 1.0, 101)).y
    assert np.abs(y[50, :, 1]).max() < 1e-12 and np.abs(y[[0, -1], :, 1]).max() < 1e-12
    assert y[50, 0, 0] == pytest.approx(p[0] - 0.1, abs=1e-12)
    assert y[:, 0, 0].min() > p[0] - 0.1 - 1e-9 and y[[0, -1], 0, 0] == pytest.approx(p[0])


def test_an_error_in_the_spline_would_be_seen(
    arm, tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    import flexgen.paths.geometry.spline as spline

    p = Path(arm, arm.model.move("line")).reference.tool_pose(START)[0]
    u = np.linspace(0, 1, 20)
    columns = {"x": p[0] - 0.1 * u, "y": p[1] + 0.05 * np.sin(2 * u), "z": 0 * u}
    path = Path(
        arm, Move("arc", "sampled", START, 1.0, 6, file=write(tmp_path / "arc.csv", columns))
    )
    t = np.linspace(0.2, 0.8, 6001)
    assert derivatives_agree(t, path.sample(t).y) < DIFFERENCE
    right = spline.inverse_function
    monkeypatch.setattr(
        spline, "inverse_function", lambda u, slope: right(u, slope * np.array([1, 1, 1, 1, 1.01]))
    )
    assert derivatives_agree(t, path.sample(t).y) > DIFFERENCE


HEAD = "t,x,y,z\n"
ROWS = "".join(f"{0.1 * k},{1.0 - 0.01 * k},0.2,0.0\n" for k in range(12))
BAD_FILES = {
    "empty": ("", r":1:file: given an empty file, expected a header row"),
    "only comments": ("# nothing\n", r":1:file: given an empty file"),
    "no rows": (HEAD, r":1:file: given 0 samples, expected at least 2"),
    "a word": (HEAD + ROWS + "1.2,abc,0,0\n", r':14:x: given "abc", expected a number'),
    "not finite": (HEAD + ROWS + "1.2,nan,0,0\n", r':14:x: given "nan", expected a number'),
    "huge": (HEAD + ROWS + "1.2,0,1e300,0\n", r":14:y: given .1e300., expected a number"),
    "too few values": (HEAD + ROWS + "1.2,0\n", r":14:row: given 2 values, expected 4"),
    "too many values": (HEAD + ROWS + "1.2,0,0,0,0\n", r":14:row: given 5 values, expected 4"),
    "time falls": (
        HEAD + ROWS + "0.5,0,0,0\n",
        r":14:t: given 0\.5 after 1\.1, expected increasing",
    ),
    "time stands": (
        HEAD + ROWS + "1.1,0,0,0\n",
        r":14:t: given 1\.1 after 1\.1, expected increasing",
    ),
    "comment and blank lines": ("# c\n\n" + HEAD + ROWS + "x,0,0,0\n", r':16:t: given "x"'),
    "twice": ("t,x,x,z\n" + ROWS, r":1:x: given an empty or repeated column name"),
    "no name": ("t,x,,z\n" + ROWS, r":1:column 3: given an empty or repeated column name"),
    "unknown": (
        "t,x,y,z,color\n" + ROWS.replace("\n", ",1\n"),
        r":1:color: given an unknown column",
    ),
    "missing z": (
        "t,x,y\n" + ROWS.replace(",0.0\n", "\n"),
        r":1:z: given a file without this column, expected the columns x, y, z",
    ),
    "both": ("t,u,x,y,z\n" + ROWS.replace(",", ",1,", 1), r":1:file|row"),
    "orientation": (
        "t,x,y,z,rx,ry,rz\n" + ROWS.replace("\n", ",0,0,0\n"),
        r":1:file: given an orientation, expected none",
    ),
    "outputs": (
        "t,y1,y2\n" + ROWS.replace(",0.0\n", "\n"),
        r":1:y1: given outputs, expected tool positions",
    ),
    "half the joints": ("t,q1\n" + "0,0\n1,1\n", r":1:q2: given a file without this column"),
}


@pytest.mark.parametrize("what", BAD_FILES)
def test_bad_files_are_reported_with_line_and_column(arm, tmp_path: FilePath, what: str) -> None:
    text, message = BAD_FILES[what]
    file = tmp_path / "bad.csv"
    file.write_text(text)
    with pytest.raises(ModelError, match=r"bad\.csv" + message):
        Path(arm, Move("bad", "sampled", START, 0.0, 0, file=str(file)))


def test_bad_orientations_are_reported(robot, tmp_path: FilePath) -> None:
    head = "x,y,z,qw,qx,qy,qz\n"
    row = "{0},0,0,1,0,0,0\n"
    rows = "".join(row.format(k) for k in range(9))
    cases = {
        head
        + rows
        + "9,0,0,2,0,0,0\n": r":11:qw: given a quaternion of length 2, expected length 1",
        head
        + rows
        + "9,0,0,0,1,0,0\n": r":11:row: given a rotation by 180 deg, expected at most 90",
        head + rows + "8,0,0,1,0,0,0\n": r":11:row: given the same values as in the row before",
        "x,y,z,qw,qx,qy\n" + "0,0,0,1,0,0\n" * 9: r":1:qz: given a file without this column",
    }
    for text, message in cases.items():
        file = tmp_path / "bad.csv"
        file.write_text(text)
        with pytest.raises(ModelError, match=message):
            read_samples(str(file), robot.model, 2)


def test_bad_arrays_are_reported(arm, tmp_path: FilePath) -> None:
    p = np.random.default_rng(0).normal(size=(9, 3))
    t = np.arange(9.0)
    cases: list[tuple[dict, str]] = [
        (
            {"p": p[:, :2], "t": t},
            r": p: given an array of shape \(9, 2\), expected shape \(n, 3\)",
        ),
        ({"p": p, "t": t[:5]}, r": file: given arrays of \[5, 9\] rows"),
        ({"p": p, "time": t}, r": time: given an unknown array, expected"),
        (
            {"p": np.where(p > 1, np.inf, p), "t": t},
            r":p: given a number that is not finite or too large",
        ),
        ({"p": p.astype(str), "t": t}, r": p: given an array of"),
        ({"t": t}, r":1:x: given a file without this column"),
    ]
    for arrays, message in cases:
        file = tmp_path / "bad.npz"
        np.savez(file, **arrays)
        with pytest.raises(ModelError, match=message):
            read_samples(str(file), arm.model, 2)
    (tmp_path / "bad.npz").write_bytes(b"no zip file")
    with pytest.raises(ModelError, match=r"bad\.npz: file"):
        read_samples(str(tmp_path / "bad.npz"), arm.model, 2)
    with pytest.raises(ArgumentError, match="which is not a file"):
        read_samples(str(tmp_path / "none.csv"), arm.model, 2)


def test_files_that_do_not_fit_the_move(arm, tmp_path: FilePath) -> None:
    timed = tmp_path / "timed.csv"
    timed.write_text(HEAD + ROWS)
    plain = tmp_path / "plain.csv"
    plain.write_text("x,y,z\n" + "".join(f"{1.0 - 0.01 * k},0.2,0.0\n" for k in range(6)))
    move = Move("m", "sampled", START, 0.0, 0, file=str(timed))
    for changes, message in (
        ({"smoothness": 5, "duration": 1.0}, "given smoothness together with times in the file"),
        ({"profile": (1.0, 1.0)}, "given profile together with times in the file"),
        ({"degree": 6}, "given degree 6, expected one of 5, 7, 9, 11"),
        ({"start": (1.0,)}, "expected 2 finite numbers"),
    ):
        with pytest.raises(ArgumentError, match=message):
            Path(arm, replace(move, **changes))
    with pytest.raises(ModelError, match="given 6 samples, expected more than 7"):
        Path(arm, replace(move, file=str(plain), smoothness=5, duration=1.0))
    with pytest.raises(
        ArgumentError, match=r"given duration 0\.0, expected a duration and smoothness"
    ):
        Path(arm, replace(move, file=str(plain)))
    assert MoveL.space == "tool"
