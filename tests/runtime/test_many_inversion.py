"""`invert_many`: the bits of `invert` for each of many problems, on any number of threads;
statuses, refusals.
"""

from __future__ import annotations

import _thread
import ctypes
import pickle
import subprocess
import threading
import time
from functools import cache
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from emitted import loaded, made, run, sources
from hostile_client import SANITIZE, can_sanitize
from inversion_cases import MODEL, PERIOD, given, samples
from toolchain import CC, needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.inversion.problem.reduced_problem import Reduction
from flexgen.inversion.problem.sampling import samples as path_samples
from flexgen.runtime.inversion.many_inversion import Inversions
from flexgen.runtime.inversion.path_inversion import RESULTS, Inverter

pytestmark = needs_compiler

SOLVER = {"n_pre": 100, "n_post": 100, "samples_per_interval": 5}
INFOS = (
    "residual",
    "residual_at_samples",
    "kinematic_mismatch",
    "growth",
    "iterations",
    "intervals",
    "n_post",
)
SUPPORT = FilePath(__file__).resolve().parents[1] / "support"


@pytest.fixture(scope="module")
def flexible(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A library with run-time parameters, the one of test_inversion_parameters.py: it is compiled
    once.
    """
    folder = tmp_path_factory.mktemp("many")
    kinds = ["payload", "stiffness", "damping"]
    return flexgen.load(
        flexgen.generate(MODEL, folder / "flexible", parameters=kinds, parts=["bvp"]).directory
    )


@cache
def path() -> dict[str, Any]:
    return {key: x for key, x in given().items() if key not in SOLVER}


def drawn(library: Any, count: int, seed: int = 0) -> np.ndarray:
    """Parameters of robots, 10 % about those of the model."""
    rng = np.random.default_rng(seed)
    return library.parameters * rng.uniform(0.9, 1.1, (count, library.parameters.size))


def options(**changes: Any) -> Any:
    return flexgen.InversionOptions(**SOLVER, **changes)


def check_against_loop(
    library: Any,
    found: Inversions,
    problems: list[dict[str, Any]],
    outputs: tuple[str, ...],
    **solver: Any,
) -> None:
    """Every bit of the problems whose status is not negative is that of `invert`, called one by
    one.
    """
    assert len(found) == len(problems)
    for k, problem in enumerate(problems):
        if found.status[k] < 0:
            with pytest.raises(flexgen.FlexgenError, match=found.sentence(k).partition(";")[0]):
                library.invert(**problem, **(solver or SOLVER))
            assert all(np.isnan(getattr(found, key)[k]).all() for key in outputs)
            continue
        alone = library.invert(**problem, **(solver or SOLVER))
        assert alone.converged == found.converged[k]
        for key in outputs:
            rows = getattr(alone, key)
            assert np.array_equal(getattr(found, key)[k][: len(rows)], rows)
        for key in INFOS:
            assert np.array_equal(getattr(found, key)[k], getattr(alone, key), equal_nan=True), key


@pytest.mark.parametrize("workers", [1, 2])
def test_bits_are_those_of_invert_for_parameters_of_each_problem(
    flexible: Any, workers: int
) -> None:
    values = drawn(flexible, 12)
    values[3, 1] = np.nan
    values[8, 0] = np.inf
    found = flexible.invert_many(
        **path(), parameters=values, outputs=RESULTS, options=options(workers=workers)
    )
    assert found.status.tolist() == [-2 if k in (3, 8) else 0 for k in range(12)]
    assert found.counts() == {"success": 10, "an input is not finite; the outputs are NaN": 2}
    check_against_loop(flexible, found, [{**path(), "parameters": p} for p in values], RESULTS)


def test_bits_are_those_of_invert_for_paths_of_each_problem(flexible: Any) -> None:
    one = samples()
    scales = np.array([1.0, 0.99, 30.0, 1.01, 1.0])
    y, dy, ddy = (one[key] * scales[:, None, None] for key in ("y", "dy", "ddy"))
    y[4, 7, 1] = np.nan
    starts = np.tile(one["q_start"], (5, 1)) + 1e-3 * np.arange(5)[:, None]
    found = flexible.invert_many(
        y, dy, ddy, period=PERIOD, q_start=starts, options=options(growth=True, settled=1e-6)
    )
    assert found.status.tolist() == [0, 0, -7, 0, -2] and found.q_a is None
    problems = [
        {"y": y[k], "dy": dy[k], "ddy": ddy[k], "period": PERIOD, "q_start": starts[k]}
        for k in range(len(scales))
    ]
    check_against_loop(flexible, found, problems, ("tau_m",), **SOLVER, growth=True, settled=1e-6)


def test_a_model_without_unactuated_coordinates() -> None:
    library = loaded("elbow")
    line = samples("elbow")
    starts = line["q_start"] + 1e-3 * np.arange(5)[:, None]
    problem = {key: line[key] for key in ("y", "dy", "ddy")} | {"period": PERIOD}
    found = library.invert_many(
        **problem, q_start=starts, options=flexgen.InversionOptions(n_post=20)
    )
    assert (found.status == 0).all()
    check_against_loop(
        library, found, [{**problem, "q_start": q} for q in starts], ("tau_m",), n_post=20
    )


@pytest.mark.slow
def test_single_precision(tmp_path: Any) -> None:
    names = [name for name in INVERSION if name != "inversion_jacobians"]
    made = flexgen.generate(
        "elbow", tmp_path / "single", precision="single", parameters=["stiffness"], functions=names
    )
    library = flexgen.load(made.directory)
    line = samples("elbow")
    values = drawn(library, 5)
    problem = {**line, "period": PERIOD}
    found = library.invert_many(
        **problem, parameters=values, options=flexgen.InversionOptions(n_post=20)
    )
    assert found.tau_m is not None and found.tau_m.dtype == np.float32
    check_against_loop(
        library, found, [{**problem, "parameters": p} for p in values], ("tau_m",), n_post=20
    )


@pytest.mark.slow
@pytest.mark.parametrize("precision", ["double", "single"])
def test_six_axes_with_18_degrees_of_freedom(tmp_path: Any, precision: Any) -> None:
    kinds = ["stiffness", "payload"]
    made = flexgen.generate(
        "manutec_r3_18",
        tmp_path / "r3",
        precision=precision,
        parameters=kinds,
        functions=list(INVERSION),
    )
    library = flexgen.load(made.directory)
    planned = flexgen.plan("manutec_r3_18", "line")
    step = 1e-2 if precision == "single" else 5e-3
    reduction = Reduction(flexgen.derive("manutec_r3_18"))
    y, dy, ddy = path_samples(reduction, planned, step, round(planned.duration / step) + 1)
    problem = {"y": y, "dy": dy, "ddy": ddy, "period": step, "q_start": planned.q_start}
    values = drawn(library, 6)
    values[2] = np.nan
    found = library.invert_many(
        **problem, parameters=values, options=flexgen.InversionOptions(n_pre=20, n_post=40)
    )
    assert found.status[2] == -2 and (np.delete(found.status, 2) >= 0).all()
    check_against_loop(
        library,
        found,
        [{**problem, "parameters": p} for p in values],
        ("tau_m",),
        n_pre=20,
        n_post=40,
    )


def test_chunks_are_reduced_as_they_come(flexible: Any) -> None:
    values = drawn(flexible, 40)
    whole = flexible.invert_many(**path(), parameters=values, options=options())
    seen: list[tuple[int, int]] = []

    def largest(chunk: Inversions) -> np.ndarray:
        seen.append((chunk.first, len(chunk)))
        assert chunk.tau_m is not None and chunk.q_a is None
        return np.abs(chunk.tau_m).max(axis=1)

    found = flexible.invert_many(**path(), parameters=values, options=options(reduce=largest))
    assert found.tau_m is None and sum(count for _, count in seen) == 40
    assert np.array_equal(found.reduced, np.abs(whole.tau_m).max(axis=1))
    assert np.array_equal(found.residual, whole.residual)
    for wrong in (lambda chunk: 1.0, lambda chunk: chunk.tau_m[:0], lambda chunk: [[1], [1, 2]]):
        with pytest.raises(
            ArgumentError, match=r"reduce: given a function that returned .* one row"
        ):
            flexible.invert_many(**path(), parameters=values, options=options(reduce=wrong))
    with pytest.raises(ZeroDivisionError):
        flexible.invert_many(
            **path(), parameters=values, options=options(reduce=lambda chunk: 1 / 0)
        )


@pytest.mark.slow
def test_a_planted_workspace_that_threads_share_changes_bits(
    flexible: Any, monkeypatch: Any
) -> None:
    library = flexgen.load(flexible.directory)
    values = drawn(flexible, 400)
    expected = flexible.invert_many(**path(), parameters=values, options=options(workers=1))
    shared = np.empty(10**6)
    monkeypatch.setattr(Inverter, "_workspace", lambda self, size: shared[:size])

    def differs(library: Any) -> bool:
        found = library.invert_many(**path(), parameters=values, options=options(workers=4))
        return not np.array_equal(found.tau_m, expected.tau_m)

    assert any(differs(library) for _ in range(20))
    monkeypatch.undo()
    assert not differs(flexible)


def test_planted_c_that_stops_at_the_first_failure_is_seen(
    flexible: Any, monkeypatch: Any
) -> None:
    """Problems that C leaves unsolved raise an error: they are not reported as solved."""
    many = flexible.invert_many
    values = drawn(flexible, 4)
    entry = many._inverter.entry_many
    first = []

    def stops(problems: Any, *others: Any) -> int:
        if first:
            return 0
        first.append(problems)
        return int(entry(problems, *others))

    monkeypatch.setattr(many._inverter, "entry_many", stops)
    with pytest.raises(flexgen.FlexgenError, match="invert_many"):
        many(**path(), parameters=values, options=options(workers=1))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"y": np.zeros(4)}, r"y: given shape \(4,\)"),
        ({"y": np.zeros((2, 5, 3))}, r"y: given shape \(2, 5, 3\), expected \(2, 5, 2\)"),
        ({"dy": np.zeros((2, 5, 2))}, "dy: given shape"),
        (
            {"q_start": np.zeros((2, 2))},
            r"q_start: given shape \(2, 2\), expected \(3,\) or \(problems, 3\)",
        ),
        ({"parameters": np.zeros((3, 1))}, "parameters: given shape"),
        (
            {"q_start": np.zeros((2, 3))},
            "given 3 of parameters, 2 of q_start, expected the same number",
        ),
        ({"parameters": None}, "for one problem call invert"),
        ({"outputs": "tau_m"}, "outputs: given 'tau_m', expected some of"),
        ({"outputs": ("tau",)}, "outputs: given"),
        ({"period": 0.0}, "period: given 0"),
        ({"options": options(tolerance=2.0)}, "tolerance: given 2"),
        ({"options": options(workers=0)}, "workers: given 0"),
        ({"options": options(hold="x")}, "hold: given 'x'"),
        ({"options": flexgen.InversionOptions(n_pre=-1)}, "n_pre and n_post at least 0"),
    ],
)
def test_invalid_arguments_are_refused(flexible: Any, changes: dict[str, Any], words: str) -> None:
    call = {**path(), "parameters": drawn(flexible, 3), "options": options(), **changes}
    with pytest.raises(ArgumentError, match=words):
        flexible.invert_many(**call)


def test_no_problems_have_empty_results(flexible: Any) -> None:
    found = flexible.invert_many(**path(), parameters=drawn(flexible, 0), options=options())
    assert (
        len(found) == 0
        and found.tau_m is not None
        and found.tau_m.shape[0] == 0
        and found.counts() == {}
    )


def test_a_library_without_parameters_or_inversion_says_so(tmp_path: Any) -> None:
    library = loaded(MODEL)
    one = path()
    with pytest.raises(ArgumentError, match="without run-time parameters"):
        library.invert_many(**one, parameters=np.zeros((2, 3)))
    starts = np.tile(one["q_start"], (2, 1))
    assert (library.invert_many(**{**one, "q_start": starts}, options=options()).status == 0).all()
    small = flexgen.load(
        flexgen.generate("elbow", tmp_path / "small", functions=["gravity"]).directory
    )
    with pytest.raises(ArgumentError, match="without invert"):
        _ = small.invert_many


def test_it_is_pickled_and_refused_once_closed(flexible: Any) -> None:
    values = drawn(flexible, 2)
    expected = flexible.invert_many(**path(), parameters=values, options=options())
    again = pickle.loads(pickle.dumps(flexible.invert_many))
    assert np.array_equal(
        again(**path(), parameters=values, options=options()).tau_m, expected.tau_m
    )
    assert repr(again).startswith("invert_many(y, dy, ddy")
    library = flexgen.load(flexible.directory)
    many = library.invert_many
    closing = threading.Timer(0.05, library.close)
    closing.start()
    # a call under way ends as usual
    found = many(**path(), parameters=drawn(flexible, 600), options=options())
    closing.join()
    assert (found.status == 0).all()
    with pytest.raises(ArgumentError, match="closed"):
        many(**path(), parameters=values, options=options())


def test_ctrl_c_stops_soon_and_progress_is_reported(flexible: Any) -> None:
    lines: list[str] = []
    values = np.tile(flexible.parameters, (100_000, 1))  # half a minute
    threading.Timer(0.5, _thread.interrupt_main).start()
    began = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        flexible.invert_many(
            **path(),
            parameters=values,
            options=options(progress=lines.append, reduce=lambda chunk: chunk.residual),
        )
    assert time.perf_counter() - began < 5.0
    assert lines and lines[-1].endswith(" of 100000 problems")
    assert threading.active_count() < 10 and not any(
        t.name.startswith("invert_many") for t in threading.enumerate()
    )


@pytest.mark.slow
def test_sanitized_c_has_the_bits_of_single_calls(tmp_path: Any) -> None:
    if not can_sanitize(tmp_path):
        pytest.skip("the compiler has no sanitizers; install the Debian package gcc")
    planned = flexgen.plan(MODEL)
    step = 5e-3
    sample = planned.sample(np.linspace(0.0, planned.duration, 61))
    ratio = planned.duration / (60 * step)  # the path in another time
    y = sample.y[:, :, 0]
    dy = sample.derivative(1) * ratio
    ddy = sample.derivative(2) * ratio**2
    scales = np.array([1.0, 0.995, 20.0, 1.003])[:, None, None]
    arrays = [y * scales, dy * scales, ddy * scales, np.tile(planned.q_start, (4, 1))]
    folder = made(MODEL).directory
    used = {f"{MODEL}_{name}" for name in ("inversion", "linearize", *INVERSION)} | {MODEL}
    files = [
        SUPPORT / "programs" / "many_paths.c",
        *(file for file in sources(folder) if file.stem in used),
    ]
    run(
        CC,
        *SANITIZE,
        "-std=c99",
        "-ffp-contract=off",
        "-I",
        folder,
        *files,
        "-lm",
        "-o",
        "many",
        folder=tmp_path,
    )
    data = b"".join(np.ascontiguousarray(x).tobytes() for x in arrays)
    answer = subprocess.run([tmp_path / "many"], input=data, capture_output=True, check=False)
    assert answer.returncode == 0, answer.stderr.decode()[:2000]
    assert answer.stdout.decode().split() == "0 -4 -1 -6 -1 -5".split()


def test_statuses_of_c_fit_into_the_array_of_python() -> None:
    assert np.dtype(np.intc).itemsize == ctypes.sizeof(ctypes.c_int) == 4
