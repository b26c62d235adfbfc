"""Hostile calls of the inversion under sanitizers, and the same bits of its answers from every
compiler and level.
"""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import pytest
from emitted import run, sources
from hostile import OUTPUTS, SPOILERS, Target, call_of, invert, parts_of, target
from hostile_client import (
    SANITIZE,
    all_bound,
    begin,
    bound,
    can_sanitize,
    statuses,
    text,
    update,
    whole_path,
)
from toolchain import CC, needs_compiler, tools

from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.spec import library_name

pytestmark = needs_compiler

SEED = 4
ROUNDS = 12  # of every kind of spoiled call: more than a thousand calls over all robots
STRICT = ["-std=c99", "-ffp-contract=off", "-fno-math-errno", "-Wall", "-Wextra", "-Werror"]
LEVELS = ("-O0", "-O1")  # the library has -O2


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hostile")
    line = {"move": "line", "singular": 4}
    options = {
        "manutec_r3": line,
        "manutec_r3_18": line,
        "planar5_nmp": {"singular": 1},
        "elbow": {"singular": 1},
    }

    @cache
    def one(name: str) -> Target:
        return target(name, folder / name, **options[name])

    return one


def corpus(one: Target, rounds: int) -> tuple[list[list[float]], list[int | None]]:
    """Calls, and the statuses that the library of every day gives them; None where it was not
    asked.
    """
    rng = np.random.default_rng(SEED)
    records: list[list[float]] = []
    expected: list[int | None] = []
    for _ in range(rounds):
        for spoil in SPOILERS:
            call, _ = spoil(one, rng)
            records.append(whole_path(call))
            expected.append(invert(one, call).status)
            if one.equations.model.n_e:
                records.append(whole_path(call, 2))
                expected.append(None)
    for intervals, samples_per_interval, period, *hold in (
        (8, 3, one.period, 0, 0.0),
        (1, 1, 1e-3, 0, 0.0),
        (5, 7, 1e-9, 0, 0.0),
        (3, 2, 1e5, 0, 0.0),
        (8, 3, one.period, 2, 4.0),
        (1, 1, 1e-3, 2, 3.999),
        (5, 7, one.period, 1, 0.3),
        (3, 2, 1e-3, 0, 1.0),
    ):
        records.append(
            begin(one, intervals, samples_per_interval, period, hold=(int(hold[0]), hold[1]))
        )
        expected.append(0)
        for k in range(1, 16):
            if k in (3, 9):
                numbers = rng.choice([1e-9, 1.0, 30.0, 1e9, np.inf, np.nan, -1.0], 2)
                records.append(bound(*numbers, rng.choice([1e-300, 1e-3, 1.0, 1e7, np.nan]), one))
                expected.append(None)
            if k in (5, 12):
                value = rng.choice([1e-300, 1e-9, 1.0, 30.0, 1e9, np.inf, np.nan, -1.0])
                records.append(
                    all_bound(
                        value,
                        rng.choice([1e-300, 1e-3, 1.0, np.nan]),
                        int(rng.choice([2, 3, 21, 40])),
                    )
                )
                expected.append(None)
            given = [np.array(one.path[key][k]) for key in ("y", "dy", "ddy")]
            given[rng.integers(3)][0] *= rng.choice([1.0, 1.0, 1.0, np.nan, 1e3, 1e300])
            records.append(update(given))
            expected.append(None)
    for intervals, samples_per_interval, short in (
        (8, 3, 1),
        (0, 1, 0),
        (-1, -1, 0),
        (2**31 - 1, 2**31 - 1, 0),
    ):
        records.append(begin(one, intervals, samples_per_interval, 1e-3, short))
        expected.append(-6 if short else -5)
    for hold, delay in ((7, 0.0), (-1, 0.0), (2, np.nan), (2, -1e-300), (0, 4.1), (1, np.inf)):
        records.append(begin(one, 8, 3, 1e-3, hold=(hold, delay)))
        expected.append(-5)
    return records, expected


@pytest.mark.parametrize(
    ("name", "rounds", "files"),
    [
        ("planar5_nmp", ROUNDS, "many"),
        ("elbow", ROUNDS, "many"),
        ("elbow", 1, "one"),
        ("manutec_r3", ROUNDS, "many"),
        ("manutec_r3_18", 1, "many"),
    ],
)
def test_invalid_calls_under_sanitizers_report_nothing(made, name, rounds, files, tmp_path):
    if not can_sanitize(tmp_path):
        pytest.skip("the compiler has no sanitizers; install the Debian package gcc")
    one = made(name)
    symbol = library_name(one.equations.model)
    folder = one.directory
    client = text(symbol)
    parts = sources(one.directory)
    if files == "one":
        options = {"amalgamate": True, "build": False, "parts": parts_of(one.equations.model)}
        folder = generate(name, tmp_path / "merged", **options).directory
        client = client.replace(f"{symbol}_inversion.h", f"{symbol}.h")
        parts = [folder / f"{symbol}.c"]
    (tmp_path / "client.c").write_text(client, encoding="ascii")
    command = [str(CC), *STRICT, *SANITIZE, f"-I{folder}", "client.c", *map(str, parts)]
    run(*command, "-lm", "-o", "client", folder=tmp_path)
    records, expected = corpus(one, rounds)
    got = statuses([str(tmp_path / "client")], records, tmp_path)
    assert len(got) == len(expected)
    assert [g for g, e in zip(got, expected, strict=True) if e is not None] == [
        e for e in expected if e is not None
    ]


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_the_same_bits_from_every_compiler_and_level(made, compiler, tmp_path):
    tools(compiler)
    one = made("planar5_nmp")
    call = call_of(one, samples_per_interval=2)
    expected = invert(one, call)
    assert expected.status == 0
    scalar = f"-D{library_name(one.equations.model).upper()}_NO_VECTORS"
    for k, words in enumerate([*([level] for level in LEVELS), ["-O0", scalar]]):
        file = tmp_path / f"{k}.so"
        flags = [*STRICT, *words, "-fPIC", "-shared", "-fno-tree-vectorize", f"-I{one.directory}"]
        run(
            compiler, *flags, *map(str, sources(one.directory)), "-lm", "-o", file, folder=tmp_path
        )
        got = invert(one.with_library(file), call)
        assert got.status == 0
        for key in OUTPUTS:
            assert got.results[key].tobytes() == expected.results[key].tobytes(), (
                compiler,
                words,
                key,
            )


def test_the_stack_is_as_small_as_the_header_says(made, tmp_path):
    """The frames of a core that may stand on each other: no more than four of it, and one of a
    function it calls.
    """
    tools("gcc")  # it has -fstack-usage
    one = made("planar5_nmp")
    name = library_name(one.equations.model)
    header = (one.directory / f"{name}_inversion.h").read_text(encoding="ascii")
    said = [int(word) for word in re.findall(r"Stack: at most (\d+)\s", header.replace(" *", ""))]
    assert len(set(said)) == 1 and len(said) >= 3
    run(
        "gcc",
        *STRICT,
        "-O2",
        "-fstack-usage",
        "-c",
        f"-I{one.directory}",
        *sources(one.directory),
        folder=tmp_path,
    )
    frames: dict[str, list[int]] = {}
    for file in tmp_path.glob("*.su"):
        rows = [line.split("\t") for line in file.read_text(encoding="ascii").splitlines()]
        assert all(kind != "dynamic" for _, _, kind in rows), rows
        frames[file.stem] = sorted((int(size) for _, size, _ in rows), reverse=True)
    cores = {f"{name}_inversion"}
    below = max(sum(sizes[:3]) for key, sizes in frames.items() if key not in cores)
    assert cores <= set(frames)
    assert all(sum(frames[core][:4]) + below <= said[0] for core in cores), (frames, said)


def test_threads_do_not_disturb_each_other(made):
    one = made("planar5_nmp")
    calls = [
        call_of(one, samples_per_interval=samples_per_interval, n_post=n_post)
        for samples_per_interval, n_post in ((1, 3), (2, 9), (3, 20), (5, 1))
    ]
    expected = [invert(one, call).results for call in calls]
    with ThreadPoolExecutor(len(calls)) as pool:
        for _ in range(5):
            for got, right in zip(
                pool.map(lambda call: invert(one, call).results, calls), expected, strict=True
            ):
                assert all(np.array_equal(got[key], right[key]) for key in right)
