"""Modules below the rooms, at the edges of their ranges: texts of values, time limits, curves,
arrays, lost workers.

Of `flexgen.base.display`, `flexgen.base.checks.counts`, `flexgen.base.calls.deadline`,
`flexgen.base.calls.progress`, `flexgen.base.numerics.executors`,
`flexgen.base.motion.interpolation`, `flexgen.base.motion.torque_curve`,
`flexgen.base.files.array_files`, `flexgen.base.files.atomic_files` and
`flexgen.base.checks.types_of_values`.
"""

from __future__ import annotations

import errno
import json
import math
import os
import time
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent import futures
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from threadpoolctl import threadpool_info, threadpool_limits

from flexgen.base import display
from flexgen.base.calls import deadline, progress
from flexgen.base.checks import counts
from flexgen.base.checks.types_of_values import Names, check_of, items_of
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.base.files import array_files, atomic_files
from flexgen.base.motion import torque_curve
from flexgen.base.motion.interpolation import interpolate
from flexgen.base.numerics import executors
from flexgen.base.rows import Row


@dataclass
class Named:
    """A class of data with defaults."""

    size: float = 1.0
    names: tuple[str, ...] = ()
    table: Any = None
    hidden: int = field(default=3, repr=False)


def test_short_texts_show_four_entries_and_a_hundred_characters() -> None:
    assert (
        display.short_text((1, 2.5, "a", None, 5)) == "1, 2.5, a, , ..."
        and display.short_text([1, 2, 3, 4]) == "1, 2, 3, 4"
    )
    assert (
        display.short_text({"a": 1, "b": (2, 3)}) == "a: 1, b: 2, 3"
        and display.short_text(Path("x/y")) == "x/y"
    )
    assert display.short_text(None) == "" and display.short_text(np.arange(12.0)).startswith(
        "array([ 0., 1.,"
    )
    assert display.short_text(np.zeros((13, 1))) == "<array 13 x 1>"
    # of 100 and 101 characters
    exact = Made(a="x" * 85)
    long = Made(a="x" * 86)
    assert len(repr(exact)) == 100 and display.short_text(exact) == repr(exact)
    assert display.short_text(long) == repr(long)[:97] + "..."
    assert (
        display.short_repr(Named(2.0, ("a",) * 5, hidden=4))
        == "Named(size=2.0, names=('a', 'a', 'a', 'a', ...))"
    )
    assert display.short_repr(Named()) == "Named()" and "<" not in display.short_repr(
        Named(table=object())
    )


def test_times_are_whole_seconds_below_a_hundred_then_minutes() -> None:
    times = {0.2: "1 s", 1.4: "1 s", 99.4: "99 s", 100.0: "2 min", 150.1: "3 min"}
    assert {seconds: display.duration(seconds) for seconds in times} == times


def test_sizes_have_a_prefix_of_their_unit() -> None:
    shown = {
        x: display.format_size(x, "m")
        for x in (2.0, 0.9995, 0.9994, 0.9996e-3, 0.9994e-3, 9.18e-11, 0.0)
    }
    assert list(shown.values()) == ["2 m", "1 m", "999 mm", "1 mm", "999 um", "< 0.1 um", "0 um"]
    assert display.format_size(None, "m") == display.format_size(math.inf, "rad") == "-"
    assert (
        display.both_measured(2e-3, None) == "2 mm"
        and display.both_measured(2e-3, 4e-6) == "2 mm and 4 urad"
    )
    rows = display.figure_rows(
        [
            Row("a", 0.5, "m", "a"),
            Row("b", "", "", "b"),
            Row("c", 3, "", "c"),
            Row("d", 123456.0, "N m", "d"),
        ]
    )
    assert rows == [("a", "500 mm"), ("c", "3"), ("d", "1.235e+05 N m")]


def test_plain_values_are_json_types() -> None:
    given = {
        1: np.float64(np.nan),
        "z": 1 - 2j,
        "p": Path("a"),
        "n": Named(),
        "a": np.arange(3),
        "t": (True, None),
        "r": Made(title="T"),
        "d": Made(to_dict=lambda: {"x": np.inf}),
        "o": {3},
    }
    expected = {
        "1": None,
        "z": [1.0, -2.0],
        "p": "a",
        "a": [0, 1, 2],
        "t": [True, None],
        "r": "T",
        "n": {"size": 1.0, "names": [], "table": None, "hidden": 3},
        "d": {"x": None},
        "o": "{3}",
    }
    assert display.plain(given) == expected == json.loads(display.as_json(given))
    assert display.table_html("<t>", [("a&", "<b>")]) == (
        "<table><caption>&lt;t&gt;</caption><tr><td>a&amp;</td><td>&lt;b&gt;</td></tr></table>"
    )


def test_counts_and_times_at_their_bounds() -> None:
    assert (
        counts.count_of("n", 1, 5) == 1
        and counts.count_of("n", 5, 5) == 5
        and counts.count_of("n", 0, 5, 0) == 0
    )
    for value in (0, 6, 1.5, True):
        with pytest.raises(
            ArgumentError, match=f"^n: given {value!r}, expected a whole number from 1 to 5$"
        ):
            counts.count_of("n", value, 5)
    assert counts.seconds_of("t", 86400) == 86400.0 and counts.seconds_of("t", 2.0, 2.0) == 2.0
    for seconds in (0.0, 2.1, -1.0, math.nan):
        with pytest.raises(ArgumentError, match="expected a number above 0, at most 2 s"):
            counts.seconds_of("t", seconds, 2.0)
    assert counts.show_value("x" * 78) == repr("x" * 78) and counts.show_value("x" * 79).endswith(
        "x ... (81 characters)"
    )
    assert counts.show_value(1 << 20000) == "an integer of 20001 bits"


def test_time_limits_end_at_their_time(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(deadline.time, "perf_counter", lambda: now[0])
    assert deadline.time_left() == 1e10
    with deadline.running(5.0) as outer:
        now[0] = 103.0
        assert outer.left == 2.0 == deadline.time_left()
        with deadline.running(9.0) as inner:
            assert inner.left == 2.0
        with deadline.running(None) as inner:
            assert inner.left == 2.0
        with deadline.running(1.5) as inner:
            assert inner.left == 1.5
        with deadline.pause():
            now[0] = 104.0
        assert outer.left == 2.0
        now[0] = 106.0
        deadline.check_time("at the end")
        now[0] = 106.5
        assert deadline.time_left() == 1e-3
        with pytest.raises(deadline.OutOfTime, match="late"):
            deadline.check_time("late")
        outer.interrupted = True
        with pytest.raises(KeyboardInterrupt):
            deadline.check_time("late")
    with deadline.running(None):
        assert deadline.time_left() == 1e10


def test_one_line_of_progress_is_replaced_and_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    stream = StringIO()
    monkeypatch.setattr(progress.time, "perf_counter", lambda: now[0])
    monkeypatch.setattr(progress.sys, "stderr", stream)
    monkeypatch.setattr(progress.shutil, "get_terminal_size", lambda: Made(columns=30))
    with progress.reporting(True, "solve") as show:
        assert show is not None
        now[0] = 0.29
        show("too early")
        now[0] = 0.3
        show("a  long\nline of text that is cut")
        now[0] = 61.6
        show("short")
    first = "solve: a long line of text th"
    second = "solve: short (62 s)"
    assert len(first) == 29 and stream.getvalue() == f"\r{first}\r{second:29}\r{'':19}\r"
    with progress.reporting(None, "solve") as show, progress.reporting(False, "other") as none:
        assert show is None and none is None
    with pytest.raises(
        ArgumentError,
        match="progress: given 3, expected a function of one line, True, False or None",
    ):
        progress.reporting(3, "solve").__enter__()


def test_long_calls_compute_on_one_thread_of_blas() -> None:
    """Until the last of them has ended, also with an error; then as many threads as before."""

    def threads() -> set[int]:
        return {
            library["num_threads"]
            for library in threadpool_info()
            if library["user_api"] == "blas"
        }

    first = progress.one_blas_thread()
    second = progress.one_blas_thread()
    with threadpool_limits(limits=2, user_api="blas"):
        with progress.reporting(False, "solve"), progress.reporting(False, "simulate"):
            assert threads() == {1}
        assert threads() == {2}
        first.__enter__()
        second.__enter__()
        first.__exit__(None, None, None)
        assert threads() == {1}
        second.__exit__(None, None, None)
        with pytest.raises(ValueError, match="failed"), progress.one_blas_thread():
            raise ValueError("failed")
        assert threads() == {2}


def test_shards_are_submitted_again_once_and_at_most_two_for_a_worker() -> None:
    running: list[int] = []

    class Pool(Made):
        def submit(self, work: Callable[[Any], Any], shard: Any) -> futures.Future[Any]:
            future: futures.Future[Any] = futures.Future()
            running.append(shard.number)
            try:
                future.set_result(work(shard))
            except Exception as error:
                future.set_exception(error)
            return future

    tries: dict[int, int] = {}

    def work(shard: Any) -> int:
        tries[shard.number] = tries.get(shard.number, 0) + 1
        if shard.number >= 3 and tries[shard.number] <= shard.number - 2:
            raise ValueError("lost")
        return 10 * int(shard.number)

    shards = [Made(number=k) for k in range(4)]
    found = {
        shard.number: rows
        for shard, rows in executors.with_executor(shards, Pool(_max_workers=3), None, work)
    }
    assert found == {0: 0, 1: 10, 2: 20, 3: 30} and tries[3] == 2
    with pytest.raises(SolverError, match=r"sweep: shard 4 was lost 2 times \(ValueError: lost\)"):
        list(executors.with_executor([Made(number=4)], Pool(), 1, work))
    for pool, given, most in ((Pool(_max_workers=3), None, 6), (Pool(), None, 32), (Pool(), 5, 5)):
        running.clear()
        next(executors.with_executor([Made(number=0) for _ in range(40)], pool, given, work))
        assert len(running) == most


def test_a_motion_between_its_samples_is_the_polynomial_that_was_sampled() -> None:
    t = np.array([0.0, 0.1, 0.3, 0.35, 0.6])
    p = Polynomial([1.0, -2.0, 3.0, 4.0, -5.0, 6.0])
    samples = {
        name: p.deriv(k)(t)[:, None] if k else p(t)[:, None]
        for k, name in enumerate(("q_a", "v_a", "a_a"))
    }
    at = np.array([0.0, 0.05, 0.31, 0.6])
    found = interpolate(t, samples, {}, at)
    for k, name in enumerate(samples):
        np.testing.assert_allclose(found[name][:, 0], p.deriv(k)(at) if k else p(at), rtol=1e-12)
    cubic = Polynomial([1.0, -2.0, 3.0, 4.0])
    two = {"q_a": cubic(t)[:, None], "v_a": cubic.deriv()(t)[:, None], "other": (t**4)[:, None]}
    found = interpolate(t, two, {}, 0.2)
    assert found["q_a"] == pytest.approx(cubic(0.2)) and found["v_a"] == pytest.approx(
        cubic.deriv()(0.2)
    )
    assert found["other"] == pytest.approx(0.2**4) and list(found) == ["q_a", "v_a", "other"]
    assert interpolate(t, {"q_a": (3 * t)[:, None]}, {}, 0.2)["q_a"] == pytest.approx(0.6)
    # without the angle: splines
    alone = interpolate(t, {"v_a": (t**4)[:, None], "a_a": t[:, None]}, {}, 0.2)
    assert alone["v_a"] == pytest.approx(0.2**4) and alone["a_a"] == pytest.approx(0.2)
    for given, words in (
        ([[0.1]], r"shape \(1, 1\)"),
        ([0.1, 0.7], "an instant that is outside"),
        (0.61, "0.61"),
        ("x", "'x'"),
    ):
        with pytest.raises(
            ArgumentError,
            match=f"^t: given {words}, expected one or more instants from 0 to 0.6 s",
        ):
            interpolate(t, two, {}, given)


def test_torques_that_jump_between_ten_samples_are_read_back() -> None:
    parts = (Polynomial([1.0, 2.0, -3.0]), Polynomial([-4.0, 1.0, 0.5]))
    t = np.r_[np.linspace(0, 0.5, 11)[:-1], np.linspace(0.5, 0.8, 11)]
    tau = np.where(t < 0.5, parts[0](t), parts[1](t))[:, None] * [1.0, -2.0]
    curve = torque_curve.torque_curve(t, tau, limited=True, degree=2)
    at = np.array([0.0, 0.26, 0.499999, 0.5, 0.71])
    expected = np.where(at < 0.5, parts[0](at), parts[1](at))[:, None] * [1.0, -2.0]
    np.testing.assert_allclose(curve(at), expected, rtol=1e-10)
    held = torque_curve.then_constant(curve, np.array([7.0, 8.0]))
    np.testing.assert_allclose(
        held([0.26, 0.8, 1.5, 1.8]), [*curve([0.26]), [7, 8], [7, 8], [7, 8]], rtol=1e-12
    )
    both = torque_curve.side_by_side(
        [curve, torque_curve.constant(np.array([3.0]), 0.0, 0.8)], 0.1, 0.7
    )
    np.testing.assert_allclose(both([0.1, 0.3, 0.6])[:, :2], curve([0.1, 0.3, 0.6]), rtol=1e-10)
    assert (both([0.1, 0.3, 0.6])[:, 2] == 3.0).all() and both.x.tolist() == [0.1, 0.5, 0.7]
    with pytest.raises(
        ArgumentError,
        match="given 20 instants, expected intervals of 10 equal steps for polynomials of "
        "degree 2",
    ):
        torque_curve.interval_polynomials(t[:-1], tau[:-1], 2)
    tau[3, 0] += 1e-3
    with pytest.raises(ArgumentError, match=r"up to 0\.000\d+ from the polynomials of degree 2"):
        torque_curve.interval_polynomials(t, tau, 2)
    assert (
        torque_curve.read_degree({"torque_degree": 0}) == 0
        and torque_curve.read_degree({"torque_degree": 5}) == 5
    )
    for degree in (-1, 6, True, 2.0):
        with pytest.raises(
            ArgumentError, match=f"given torque_degree = {degree}, expected an integer from 0 to 5"
        ):
            torque_curve.read_degree({"torque_degree": degree})
    few = torque_curve.spline(np.array([0.0, 0.2, 1.0]), np.array([[1.0], [2.0], [7.0]]))
    assert few(np.array([0.2, 0.5])).ravel() == pytest.approx(
        [2.0, np.interp(0.5, *[[0.2, 1.0], [2.0, 7.0]])], rel=0.2
    )


def test_files_of_arrays_keep_complex_numbers_and_name_what_is_wrong(tmp_path: Path) -> None:
    file = array_files.save(
        tmp_path / "a.npz", "thing", {"z": np.array([1 + 2j, -3j]), "x": np.arange(3)}, {"n": "ü"}
    )
    arrays, meta = array_files.load(file, "thing", ["z", "x"])
    assert (
        arrays["z"].tolist() == [1 + 2j, -3j]
        and arrays["x"].tolist() == [0, 1, 2]
        and meta["n"] == "ü"
    )
    assert (
        meta["complex"] == ["z"]
        and meta["format"] == 1
        and b"\\u00fc" in np.load(file)["meta"].tobytes().replace(b"\0", b"")
    )

    def refused(**members: Any) -> str:
        np.savez(tmp_path / "b.npz", **members)
        with pytest.raises(ArgumentError) as caught:
            array_files.load(tmp_path / "b.npz", "thing", ["x"])
        return str(caught.value).partition("b.npz: ")[2]

    def text(**values: Any) -> np.ndarray:
        return np.array(display.json.dumps({"kind": "thing", "format": 1, **values}))

    x = np.arange(2.0)
    assert refused(x=x) == "given a file with no text 'meta', expected the kind 'thing'"
    assert (
        refused(x=x, meta=text(kind="other"))
        == "given a file with 'other', expected the kind 'thing'"
    )
    assert (
        refused(x=x, meta=np.array("3"))
        == "given a file with no text 'meta', expected the kind 'thing'"
    )
    assert refused(x=x, meta=text(format=2)) == "given the format 2, expected 1"
    assert refused(y=x, meta=text()) == "given no array 'x', expected x"
    for wrong in (np.array([1.0, np.nan]), np.array(["a"])):
        assert refused(x=wrong, meta=text()) == "array 'x' has a value that is not a finite number"
    for pairs in (x[:1], np.float64(1.0), np.arange(2)):
        assert (
            refused(x=x, y=pairs, meta=text(complex=["y"]))
            == "array 'y': expected pairs of real and imaginary part"
        )
    with pytest.raises(ValueError, match="not JSON compliant"):
        array_files.save(tmp_path / "c.npz", "thing", {}, {"n": math.nan})


def test_abandoned_files_are_removed_after_their_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def made(name: str, age: float) -> Path:
        path = tmp_path / name
        path.write_text("x")
        os.utime(path, (time.time() - age,) * 2)
        return path

    ages = {".flexgen-a": 59.0, ".flexgen-b": 61.0, "other": 9e9, ".staging-c": 9e4}
    files = {name: made(name, age) for name, age in ages.items()}
    atomic_files.remove_leftovers(tmp_path)
    assert [name for name, path in files.items() if path.exists()] == [".flexgen-a", "other"]
    monkeypatch.setattr(atomic_files, "fcntl", None)
    assert not atomic_files.lock_file(0)
    files = {
        name: made(name, age)
        for name, age in {".flexgen-d": 86390.0, ".flexgen-e": 86410.0}.items()
    }
    atomic_files.remove_leftovers(tmp_path)
    assert [name for name, path in files.items() if path.exists()] == [".flexgen-d"]
    texts = [
        str(atomic_files.unwritable("p", OSError(*given)))
        for given in ((errno.ENOSPC, "full"), (1234, "odd"), ())
    ]
    assert texts[0].endswith(
        "(full); free space on this disk or choose a path on another one; a file that was there "
        "is unchanged"
    )
    assert "(odd); choose another path;" in texts[1] and "); choose another path;" in texts[2]


def passing(annotation: Any, values: Sequence[Any], **given: bool) -> list[bool]:
    """Which values pass the check of an annotation."""
    check = check_of(annotation, **given)
    assert check is not None
    return [check.passes(value) for value in values]


def test_annotations_pass_their_values_and_no_others() -> None:
    assert (
        passing(float, [1, 1.5, np.float32(2), math.inf, math.nan, True, "1"])
        == [True] * 3 + [False] * 4
    )
    assert passing(float, [math.inf, -math.inf, math.nan], infinite=True) == [True, True, False]
    assert passing(float, [math.inf, math.nan, True], result=True) == [True, True, False]
    assert passing(int, [2**63 - 1, 2**63, -(2**63) + 1, 1.0, True]) == [
        True,
        False,
        True,
        False,
        False,
    ]
    assert passing(bool, [True, np.True_, 1]) == [True, True, False]
    assert passing(str, ["ü", "a\0", "\ud800", 1]) == [True, False, False, False]
    assert passing(str, ["a\0"], result=True) == [True] and passing(None, [None, 0]) == [
        True,
        False,
    ]
    assert passing(float | None, [None, 1.0, math.inf, "x"]) == [True, True, False, False]
    assert passing(typing.Literal["a", 2, False], ["a", 2, False, 3, "b"]) == [
        True,
        True,
        True,
        False,
        False,
    ]
    assert (
        passing(tuple[int, str], [(1, "a"), [1, "a"], (1,), (1, "a", 2), ("a", 1), "ab"])
        == [True, True] + [False] * 4
    )
    assert passing(tuple[int, ...], [(), (1, 2), (1, "a"), 5]) == [True, True, False, False]
    assert passing(Sequence[float], [np.arange(2), {"a": 1}.keys(), {1, 2}, np.float64(1)]) == [
        True,
        False,
        False,
        False,
    ]
    assert passing(Sequence[float], [(math.inf, 1.0), (math.nan,)]) == [True, False]
    assert passing(Mapping[str, int], [{"a": 1}, {1: 1}, {"a": "b"}, [("a", 1)]]) == [
        True,
        False,
        False,
        False,
    ]
    assert passing(Iterable[int], [iter([1]), [1], ["a"], "a", 5]) == [
        True,
        True,
        False,
        False,
        False,
    ]
    assert passing(Callable[[int], int], [len, 3]) == [True, False]
    assert passing(os.PathLike[str], [Path("a"), "a"]) == [True, False] and passing(
        Path, [Path("a\0")]
    ) == [False]
    assert (
        passing(
            np.ndarray, [np.arange(2), [1, 2], np.array([np.nan]), "12", np.array(["a"]), {1: 2}]
        )
        == [True, True] + [False] * 4
    )
    assert passing(np.ndarray, [np.array(["a"]), [object()], 3], result=True) == [
        True,
        True,
        False,
    ]
    assert passing(Named, [Named(), Made()]) == [True, False]
    late = Names()["Late"]
    assert (
        isinstance(type("Late", (), {})(), late)
        and not isinstance(3, late)
        and Names()["int"] is int
    )
    words = {
        int | None: "a whole number below 2^63 or None",
        tuple[int, Any]: "a sequence of 2: a whole number below 2^63, anything",
    }
    for annotation, text in words.items():
        assert check_of(annotation).words == text  # type: ignore[union-attr]
    assert check_of(Any) is None and check_of(object) is None and check_of(int | Any) is None


def test_entries_of_values_that_are_sequences() -> None:
    assert (
        items_of((1, 2)) == (1, 2)
        and items_of({"a": 1}.keys()) == ["a"]
        and items_of(np.arange(2)) == [0, 1]
    )
    assert [
        items_of(x) for x in ("ab", b"ab", {"a": 1}, {1}, 3, list, np.array(1.0), iter([1]))
    ] == [None] * 8
