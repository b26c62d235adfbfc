"""Functions of a loaded library: one point and many, layouts, precisions, arguments that are
refused, threads.
"""

from __future__ import annotations

import ctypes
import threading
from dataclasses import replace

import numpy as np
import pytest
from emitted import SMALL, loaded, made, random_states
from handmade import VALUES, compiled, install, twist
from toolchain import needs_compiler

from flexgen.base.errors import ArgumentError, BuildError, SolverError
from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.clib_files import read_clib
from flexgen.codegen.emission.interface import STATUSES
from flexgen.model.reader import read
from flexgen.runtime import load

pytestmark = needs_compiler

SINGLE = 4 * float(np.finfo(np.float32).eps)  # some roundings of numbers near one


@pytest.fixture
def planar():
    return loaded("planar5_nmp")


@pytest.fixture(scope="module")
def hand(tmp_path_factory):
    """A library by hand with a matrix as input, two results and parameters."""
    return load(install(tmp_path_factory.mktemp("hand"), compiled()))


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    """A library by hand in single precision."""
    return load(
        install(tmp_path_factory.mktemp("single"), compiled(real="float"), precision="single")
    )


def points(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(11)
    return rng.normal(size=(n, 2)), rng.normal(size=(n, 2, 2))


# --- one point and many --------------------------------------------------------------------------
@pytest.mark.parametrize("name", SMALL)
def test_many_points_equal_single_points(name):
    library = loaded(name)
    states = random_states(read(name), 7)
    for function in library.functions.values():
        inputs = [states[port.name] for port in function.inputs]
        many = function(*inputs)
        many = many if isinstance(many, tuple) else (many,)
        for k in range(7):
            single = function(*[x[k] for x in inputs])
            for port, a, b in zip(
                function.outputs,
                many,
                single if isinstance(single, tuple) else [single],
                strict=True,
            ):
                assert b.shape == port.shape
                assert np.array_equal(a[k], b)
        held = function(*[inputs[0], *[x[0] for x in inputs[1:]]])  # one point held for many
        full = function(*[inputs[0], *[np.tile(x[0], (7, 1)) for x in inputs[1:]]])
        for a, b in zip(
            held if isinstance(held, tuple) else [held],
            full if isinstance(full, tuple) else [full],
            strict=True,
        ):
            assert np.array_equal(a, b)


@pytest.mark.parametrize("n", [2**17, 120_007])
def test_results_that_do_not_fit_the_cache_are_the_same(planar, n):
    """From some megabytes of results on they are written past the cache, also where columns begin
    at odd addresses.
    """
    function = planar.functions["mass_matrix"]
    cache = int(read_clib()["function.h"].partition(" CACHE = ")[2].partition(",")[0])
    assert 2 * cache > n * 8 * sum(port.size for port in function.outputs) > cache
    q_a = np.random.default_rng(3).normal(size=(n, 3))
    parts = [function(q_a[k : k + 50_000]) for k in range(0, n, 50_000)]
    assert np.array_equal(function(q_a), np.concatenate(parts))


def test_no_points_give_empty_arrays(planar, hand):
    assert planar.mass_matrix(np.zeros((0, 3))).shape == (0, 3, 3)
    p, R = planar.forward_kinematics(np.zeros((0, 3)))
    assert p.shape == (0, 3) and R.shape == (0, 3, 3)
    s, S = hand.twist(np.zeros((0, 2)), np.eye(2), out=(np.zeros((0, 2)), np.zeros((0, 2, 3))))
    assert s.shape == (0, 2) and S.shape == (0, 2, 3)


def test_results_are_named_by_their_ports(planar):
    pose = planar.forward_kinematics([0.0, 0.0, 0.0])
    assert np.allclose(pose.p, [1.6, 0.0, 0.0]) and np.allclose(pose.R, np.eye(3))
    named = planar.bias(v_a=np.zeros(3), q_a=np.ones(3))
    placed = planar.bias(np.ones(3), np.zeros(3))
    assert np.array_equal(named, placed) and np.allclose(
        named, planar.gravity(np.ones(3)), rtol=1e-14
    )


def test_matrices_are_rows_by_columns(planar, hand):
    J = planar.jacobian([0.3, -1.1, 0.2])
    step = 1e-6
    dp = (
        planar.forward_kinematics([0.3, -1.1 + step, 0.2]).p
        - planar.forward_kinematics([0.3, -1.1 - step, 0.2]).p
    )
    assert np.allclose(J[:3, 1], dp / (2 * step), atol=1e-8)
    q_a, K = points(9)
    for found, expected in zip(hand.twist(q_a, K), twist(q_a, K), strict=True):
        assert np.allclose(found, expected, rtol=1e-14)
    for found, expected in zip(hand.twist(q_a[0], K[0]), twist(q_a[0], K[0]), strict=True):
        assert np.allclose(found, expected, rtol=1e-14)


class Subclass(np.ndarray):
    """Subclass of an array, as in other packages."""


# --- memory --------------------------------------------------------------------------------------
def spied(function, monkeypatch) -> list[int]:
    """Addresses that the batch in C is called with from now on."""
    seen: list[int] = []
    real = function._entries

    def batch(count, *where):
        seen[:] = [x.value for x in where]
        return real.batch(count, *where)

    monkeypatch.setattr(function, "_entries", replace(real, batch=batch))
    return seen


def test_structures_of_arrays_are_neither_copied_nor_moved(hand, monkeypatch):
    seen = spied(hand.twist, monkeypatch)
    q_a, K = (np.asfortranarray(x) for x in points(50))
    s = np.empty((50, 2), order="F")
    S = np.empty((50, 2, 3), order="F")
    results = hand.twist(q_a, K, out=(s, S))
    assert results.s is s and results.S is S
    assert [seen[i] for i in (0, 1, 3, 4)] == [x.ctypes.data for x in (q_a, K, s, S)]
    frozen = q_a.copy(order="F")
    frozen.flags.writeable = False
    fresh = hand.twist(frozen, K)
    assert [seen[0], *seen[3:5]] == [x.ctypes.data for x in (frozen, *fresh)]
    assert fresh.s.flags.f_contiguous and fresh.S.flags.f_contiguous
    hand.twist(np.ascontiguousarray(q_a), K)
    assert seen[0] != q_a.ctypes.data and seen[1] == K.ctypes.data


def test_every_layout_gives_the_same(hand):
    q_a, K = points(20)
    s, S = hand.twist(q_a, K)
    wide = np.zeros((40, 5))
    wide[::2, 1::2] = q_a
    unaligned = np.frombuffer(b"x" + np.asfortranarray(q_a).tobytes(order="F"), offset=1).reshape(
        (20, 2), order="F"
    )
    held = np.broadcast_to(q_a[3], (20, 2))
    layouts = (
        wide[::2, 1::2],
        q_a[::-1][::-1],
        np.asfortranarray(q_a),
        unaligned,
        q_a.astype(">f8"),
        q_a.tolist(),
    )
    for layout in (*layouts, q_a.view(Subclass), np.ma.array(q_a), q_a.astype(np.longdouble)):
        found = hand.twist(layout, K)
        assert np.array_equal(found.s, s) and np.array_equal(found.S, S)
    assert not unaligned.flags.aligned
    assert np.array_equal(hand.twist(q_a[::-1], K[::-1]).S, S[::-1])
    assert np.array_equal(hand.twist(held, K).S, hand.twist(q_a[3], K).S)
    assert np.array_equal(hand.twist(q_a, K.transpose(0, 2, 1).copy().transpose(0, 2, 1)).S, S)
    for layout in (wide[0, 1::2], q_a[0][::-1][::-1], q_a[0].astype(">f8"), q_a[0].tolist()):
        assert np.array_equal(hand.twist(layout, K[0].T.copy().T).S, S[0])
    assert np.array_equal(hand.twist(q_a[0], np.asfortranarray(K[0])).S, S[0])


def test_one_point_writes_to_any_memory(hand):
    q_a, K = points(1)
    expected = hand.twist(q_a[0], K[0])
    s = np.zeros(4)[::2]
    S = np.zeros((3, 2)).T
    results = hand.twist(q_a[0], K[0], out=[s, S])
    assert results.s is s and results.S is S
    assert np.array_equal(s, expected.s) and np.array_equal(S, expected.S)
    x = np.array([2.0, 3.0])
    # inputs of one point are copied first
    assert hand.square(x, out=x) is x and np.array_equal(x, [4.0, 9.0])
    assert hand.square([2.0, 3.0], out=(x,)) is x and np.array_equal(x, [4.0, 9.0])


@pytest.mark.parametrize(
    ("out", "told"),
    [
        (
            np.zeros((5, 3)),
            r"out for s: given shape \(5, 3\) of float64, expected \(5, 2\) of float64",
        ),
        (np.zeros(2), r"given shape \(2,\)"),
        (np.zeros((5, 2), np.float32), "of float32, expected"),
        (np.zeros((5, 2), ">f8"), "of >f8, expected"),
        (
            np.zeros((5, 2)),
            (
                r"given an array in another order, expected points side by side: np.empty\(\(5, "
                r"2\), order"
            ),
        ),
        ((np.zeros((5, 2)),) * 2, "out: given 2 arrays, expected 1: s"),
        ([], "out: given 0 arrays"),
        ([[0.0] * 2] * 5, "out: given 5 arrays"),
        ("s", "given str, expected a numpy array"),
        (np.broadcast_to(np.zeros((5, 1)), (5, 2)), "read-only"),
    ],
)
def test_wrong_memory_for_results_is_refused(hand, out, told):
    with pytest.raises(ArgumentError, match=told):
        hand.square(np.zeros((5, 2)), out=out)


def test_wrong_memory_for_the_result_of_one_point_is_refused(hand):
    frozen = np.zeros(2)
    frozen.flags.writeable = False
    for out in (frozen, np.zeros(3), np.zeros((1, 2)), np.zeros(2, np.float32), [0.0, 0.0]):
        with pytest.raises(ArgumentError, match="square, out"):
            hand.square(np.zeros(2), out=out)


def test_memory_that_overlaps_is_refused(hand):
    q_a = np.zeros((5, 2), order="F")
    K = np.zeros((5, 2, 2), order="F")
    both = np.zeros(1000)
    s = both[:10].reshape((5, 2), order="F")
    S = both[9:39].reshape((5, 2, 3), order="F")
    apart = np.zeros((5, 2, 3), order="F")
    for call in (
        lambda: hand.square(q_a, out=q_a),
        lambda: hand.twist(q_a, K, out=(K[:, :, 0], apart)),
        lambda: hand.twist(q_a, K, out=(s, S)),
        lambda: hand.twist(q_a[0], K[0], out=(apart[0, 0, :2], apart[0])),
    ):
        with pytest.raises(ArgumentError, match="memory"):
            call()
    hand.twist(q_a, K, out=(s, both[10:40].reshape((5, 2, 3), order="F")))  # side by side is fine
    hand.square(np.ascontiguousarray(q_a), out=q_a)


# --- precision and parameters --------------------------------------------------------------------
def test_single_precision_rounds_what_it_is_given(single):
    q_a, K = points(6)
    assert single.precision == "single" and single.parameters.dtype == np.float32
    for arguments in ((q_a, K), (q_a[0], K[0]), (q_a[0].tolist(), K[0].tolist())):
        for found, expected in zip(single.twist(*arguments), twist(*arguments), strict=True):
            assert found.dtype == np.float32 and np.allclose(
                found, expected, rtol=SINGLE, atol=SINGLE
            )
    narrow = np.asfortranarray(q_a.astype(np.float32))
    assert np.array_equal(single.square(narrow), single.square(q_a))
    assert np.array_equal(single.square(narrow[0]), single.square(q_a)[0])
    out = np.zeros((6, 2), np.float32, order="F")
    assert single.square(q_a, out=out) is out
    with pytest.raises(ArgumentError, match=r"of float64, expected .* of float32"):
        single.square(q_a, out=np.zeros((6, 2), order="F"))


def test_a_generated_library_of_single_precision(planar, tmp_path):
    library = load(
        generate(
            "planar5_nmp", tmp_path, functions=["inverse_dynamics"], precision="single"
        ).directory
    )
    states = random_states(read("planar5_nmp"), 40)
    motion = [states[name] for name in ("q_a", "v_a", "a_a")]
    expected = planar.inverse_dynamics(*motion)
    found = library.inverse_dynamics(*motion)
    assert found.dtype == np.float32
    # a hundred operations in a row
    assert np.abs(found - expected).max() < 10 * SINGLE * np.abs(expected).max()
    assert np.array_equal(library.inverse_dynamics(*[x[7] for x in motion]), found[7])


def test_numbers_too_large_for_single_precision_are_refused(single):
    for q_a, where in (([1e300, 0.0], "0"), ([[0.0, 0.0], [0.0, 1e300]], "1, 1")):
        with pytest.raises(
            ArgumentError,
            match=rf"q_a\[{where}\]: given (1e\+300|inf), expected finite .* of single",
        ):
            single.square(q_a)


def test_parameters_are_those_of_the_model_or_given(hand):
    q_a, K = points(4)
    changed = np.array([-1.0, 3.0])
    for q, k in ((q_a, K), (q_a[0], K[0])):
        expected = twist(q, k, VALUES)
        other = twist(q, k, changed)
        for found in (
            hand.twist(q, k),
            hand.twist(q, k, hand.parameters),
            hand.twist(q_a=q, K=k),
            hand.twist(q, K=k),
        ):
            assert np.allclose(found.S, expected[1], rtol=1e-14)
        for found in (hand.twist(q, k, changed), hand.twist(K=k, q_a=q, parameters=[-1, 3])):
            assert np.allclose(found.S, other[1], rtol=1e-14)
        # nothing stays of the changed ones
        assert np.allclose(hand.twist(q, k).S, expected[1], rtol=1e-14)
    for wrong in (np.zeros((4, 2)), np.zeros(3)):
        with pytest.raises(ArgumentError, match=r"expected \(2,\): one vector for all points"):
            hand.twist(q_a, K, wrong)
    for q, k in ((q_a, K), (q_a[0], K[0])):
        with pytest.raises(ArgumentError, match=r"twist, parameters\[1\]: given nan"):
            hand.twist(q, k, [1.0, np.nan])


# --- threads -------------------------------------------------------------------------------------
def test_threads_do_not_share_buffers(hand):
    """Eight threads, each with its own points, one by one and many at once."""
    q_a, K = points(8)
    rng = np.random.default_rng(3)
    many = rng.normal(size=(8, 3000, 2))
    expected = [(hand.twist(q_a[k], K[k]).S, hand.square(many[k])) for k in range(8)]
    wrong = []
    start = threading.Barrier(8)

    def work(k: int) -> None:
        start.wait()
        for _ in range(60):
            for _ in range(10):
                if not np.array_equal(hand.twist(q_a[k], K[k]).S, expected[k][0]):
                    wrong.append(k)
            if not np.array_equal(hand.square(many[k]), expected[k][1]):
                wrong.append(k)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


# --- arguments -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (
            ([0.0, 0.0],),
            r"mass_matrix, q_a: given shape \(2,\), expected \(3,\) or \(N, 3\) \[rad\]",
        ),
        ((np.zeros((2, 2)),), r"given shape \(2, 2\)"),
        ((np.zeros((3, 2)).T[:, :2],), r"given shape \(2, 2\)"),
        ((np.zeros((2, 2, 3)),), r"given shape \(2, 2, 3\)"),
        ((np.zeros((2, 3, 1)),), r"given shape \(2, 3, 1\)"),
        ((np.zeros((3, 0)),), r"given shape \(3, 0\)"),
        ((0.0,), r"given shape \(\)"),
        (([],), r"given shape \(0,\)"),
        (([0.0, np.nan, 0.0],), r"q_a\[1\]: given nan, expected finite numbers$"),
        ((np.array([0.0, 0.0, -np.inf]),), r"q_a\[2\]: given -inf"),
        ((np.array([[0.0] * 3, [0.0, 0.0, np.inf]]),), r"q_a\[1, 2\]: given inf"),
        ((np.array([[0.0] * 3, [0.0, 0.0, np.inf]], order="F"),), r"q_a\[1, 2\]: given inf"),
        ((["a", "b", "c"],), "given entries of type <U1, expected real numbers"),
        (([b"a"] * 3,), r"given entries of type \|S1"),
        (([True, False, True],), "given entries of type bool"),
        (([1j, 0, 0],), "given entries of type complex128"),
        ((np.zeros((4, 3), complex),), "given entries of type complex128"),
        (([None, 0, 0],), "given entries of type object"),
        ((None,), "given entries of type object"),
        (([10**400, 0, 0],), "given entries of type object"),
        ((np.zeros(3, object),), "given entries of type object"),
        ((np.zeros(3, "M8[s]"),), "given entries of type datetime64"),
        ((np.zeros(3, [("x", float)]),), r"given entries of type \[\('x'"),
        ((np.ma.array([0.0, 0.0, 0.0], mask=[0, 1, 0]),), "given an array with masked entries"),
        (([[1.0], [1.0, 2.0]],), "expected real numbers"),
        ((np.zeros(3), np.zeros(3)), "given 2 arguments, expected q_a"),
        ((), "given 0 arguments, expected q_a"),
        (
            (np.broadcast_to(np.zeros(3), (2**31, 3)),),
            r"given 2147483648 points, expected at most 2147483647",
        ),
    ],
)
def test_wrong_arguments_are_refused(planar, arguments, told):
    with pytest.raises(ArgumentError, match=told):
        planar.mass_matrix(*arguments)
    assert planar.mass_matrix(np.zeros(3)).shape == (3, 3)  # and do no harm


def test_directories_that_are_not_paths_are_refused():
    for wrong in (None, 5, b"folder", "a\0b"):
        with pytest.raises(ArgumentError, match="directory: given"):
            load(wrong)


def test_wrong_names_and_counts_are_refused(planar):
    with pytest.raises(ArgumentError, match="given 1 arguments and q, expected q_a, v_a"):
        planar.bias(np.zeros(3), q=np.zeros(3))
    with pytest.raises(ArgumentError, match="given 2 arguments and q_a, expected q_a, v_a"):
        planar.bias(np.zeros(3), np.zeros(3), q_a=np.zeros(3))
    with pytest.raises(ArgumentError, match="given 3 points, expected 2"):
        planar.bias(np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(ArgumentError, match="given 0 points, expected 2"):
        planar.bias(np.zeros((2, 3)), np.zeros((0, 3)))
    with pytest.raises(
        AttributeError, match="expected one of the library's functions: forward_kinematics"
    ):
        planar.mass  # noqa: B018


def test_integers_lists_and_strided_arrays_are_accepted(planar):
    expected = planar.gravity(np.array([1.0, 2.0, 3.0]))
    for q_a in (
        [1, 2, 3],
        np.arange(1, 4),
        np.arange(1, 7, dtype=np.float32)[:3],
        np.array([3.0, 2.0, 1.0])[::-1],
    ):
        assert np.array_equal(planar.gravity(q_a), expected)
    columns = np.asfortranarray(np.tile([1.0, 2.0, 3.0], (5, 1)))
    assert np.array_equal(planar.gravity(columns), np.tile(expected, (5, 1)))


# --- failures ------------------------------------------------------------------------------------
def test_entries_that_are_not_finite_are_found_wherever_they_are(hand):
    """C notices every entry; the message names the first point, and of it the first entry."""
    q_a, K = points(30)
    for order in ("C", "F"):
        for port, at in (("q_a", (0, 0)), ("q_a", (29, 1)), ("K", (17, 1, 0)), ("K", (29, 1, 1))):
            given = {"q_a": q_a.copy(order), "K": K.copy(order)}
            given[port][at] = np.nan
            with pytest.raises(
                ArgumentError,
                match=rf"twist, {port}\[{', '.join(map(str, at))}\]: given nan, expected",
            ):
                hand.twist(**given)
    late = q_a.copy()
    early = K.copy()
    late[9, 0] = np.inf
    early[4, 0, 1] = np.nan
    with pytest.raises(ArgumentError, match=r"twist, K\[4, 0, 1\]: given nan"):
        hand.twist(late, early)
    with pytest.raises(ArgumentError, match=r"twist, K\[0, 1\]: given nan"):  # held for all points
        hand.twist(q_a, early[4])


def test_a_result_that_is_not_finite_is_an_error(planar, hand):
    huge = np.array([0.0, 0.0, 0.0]), np.full(3, 1e200), np.zeros(3)
    with pytest.raises(SolverError, match="inverse_dynamics: a result is not finite"):
        planar.inverse_dynamics(*huge)
    with pytest.raises(SolverError, match="inverse_dynamics, point 1: a result is not finite"):
        planar.inverse_dynamics(
            np.zeros(3), np.array([[1.0] * 3, [1e200] * 3, [1.0] * 3]), np.zeros(3)
        )
    q_a = np.ones((7, 2))
    out = np.zeros((7, 2), order="F")
    q_a[5, 1] = 1e200
    with pytest.raises(SolverError, match="square, point 5: a result is not finite"):
        hand.square(q_a, out=out)
    assert np.isnan(out[5]).all() and (np.delete(out, 5, axis=0) == 1.0).all()
    assert np.array_equal(hand.square(np.ones(2)), np.ones(2))


def test_an_unknown_status_is_an_error(hand, monkeypatch):
    monkeypatch.setattr(hand.square, "_single", lambda *where: -77)
    with pytest.raises(BuildError, match="square: unknown status -77; generate it again"):
        hand.square(np.zeros(2))


def test_c_returns_a_status_and_sets_failed_results_to_nan(planar):
    library = ctypes.CDLL(
        str(next(path for path in made("planar5_nmp").files if path.suffix in (".so", ".dylib")))
    )
    function = library.planar5_nmp_gravity
    batch = library.planar5_nmp_gravity_batch
    function.argtypes = [ctypes.c_void_p] * 2
    batch.argtypes = [ctypes.c_int] + [ctypes.c_void_p] * 3
    # entries by points
    q_a = np.zeros((3, 3))
    g = np.full((3, 3), 5.0)
    work = np.zeros(library.planar5_nmp_batch_work())
    where = [x.ctypes.data for x in (q_a, g, work)]
    code = {status.name: status.code for status in STATUSES}
    for i in range(3):
        null = [None if k == i else where[k] for k in range(3)]
        assert batch(3, *null) == code["NULL_ARGUMENT"]
        assert i == 2 or function(*null[:2]) == code["NULL_ARGUMENT"]  # it needs no workspace
    assert batch(-1, *where) == code["BAD_COUNT"]
    assert batch(0, *where) == code["OK"]
    assert (g == 5.0).all()
    q_a[0, 1] = np.inf
    assert batch(3, *where) == code["INPUT_NOT_FINITE"]
    assert np.isnan(g[:, 1]).all() and np.isfinite(g[:, [0, 2]]).all()
    text = library.planar5_nmp_status_text
    text.restype = ctypes.c_char_p
    for status in STATUSES:
        assert text(status.code).decode() == status.text
    assert text(-99) == b"unknown status"
