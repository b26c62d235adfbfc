"""The loaded library: one point and many, arguments that are refused, threads, status codes."""

from __future__ import annotations

import ctypes
import threading

import numpy as np
import pytest
from emitted import (
    SMALL,
    loaded,
    made,
    needs_compiler,
    random_states,
)

from flexgen.codegen.spec import STATUSES
from flexgen.errors import ArgumentError, SolverError
from flexgen.model.reader import read
from flexgen.runtime import load

pytestmark = needs_compiler


@pytest.fixture
def planar():
    return loaded("planar5_nmp")


# --- one point and many -----------------------------------------------------------------------------------------------
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
                function.outputs, many, single if isinstance(single, tuple) else [single], strict=True
            ):
                assert b.shape == port.shape
                assert np.array_equal(a[k], b)
        held = function(*[inputs[0], *[x[0] for x in inputs[1:]]])  # one point held for many
        full = function(*[inputs[0], *[np.tile(x[0], (7, 1)) for x in inputs[1:]]])
        for a, b in zip(
            held if isinstance(held, tuple) else [held], full if isinstance(full, tuple) else [full], strict=True
        ):
            assert np.array_equal(a, b)


def test_no_points_give_empty_arrays(planar):
    assert planar.mass_matrix(np.zeros((0, 3))).shape == (0, 3, 3)
    p, R = planar.forward_kinematics(np.zeros((0, 3)))
    assert p.shape == (0, 3) and R.shape == (0, 3, 3)


def test_results_are_named_by_their_ports(planar):
    pose = planar.forward_kinematics([0.0, 0.0, 0.0])
    assert np.allclose(pose.p, [1.6, 0.0, 0.0]) and np.allclose(pose.R, np.eye(3))
    assert np.array_equal(planar.bias(v_a=np.zeros(3), q_a=np.ones(3)), planar.gravity(np.ones(3)))


def test_matrices_are_rows_by_columns(planar):
    J = planar.jacobian([0.3, -1.1, 0.2])
    step = 1e-6
    dp = planar.forward_kinematics([0.3, -1.1 + step, 0.2]).p - planar.forward_kinematics([0.3, -1.1 - step, 0.2]).p
    assert np.allclose(J[:3, 1], dp / (2 * step), atol=1e-8)


def test_threads_do_not_share_buffers(planar):
    rng = np.random.default_rng(3)
    points = rng.normal(size=(4, 3))
    expected = [planar.mass_matrix(q) for q in points]
    wrong = []

    def work(k: int) -> None:
        for _ in range(3000):
            if not np.array_equal(planar.mass_matrix(points[k]), expected[k]):
                wrong.append(k)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


# --- arguments --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (([0.0, 0.0],), r"mass_matrix, q_a: given shape \(2,\), expected \(3,\) or \(N, 3\) \[rad\]"),
        ((np.zeros((2, 2)),), r"given shape \(2, 2\)"),
        ((np.zeros((2, 2, 3)),), r"given shape \(2, 2, 3\)"),
        ((0.0,), r"given shape \(\)"),
        (([0.0, np.nan, 0.0],), r"q_a\[1\]: given nan, expected finite"),
        ((np.array([[0.0] * 3, [0.0, 0.0, np.inf]]),), r"q_a\[1, 2\]: given inf"),
        ((["a", "b", "c"],), "given entries of type <U1, expected real numbers"),
        (([1j, 0, 0],), "given entries of type complex128"),
        (([[1.0], [1.0, 2.0]],), "expected real numbers"),
        ((np.zeros(3), np.zeros(3)), "given 2 arguments, expected q_a"),
        ((), "given 0 arguments, expected q_a"),
    ],
)
def test_wrong_arguments_are_refused(planar, arguments, told):
    with pytest.raises(ArgumentError, match=told):
        planar.mass_matrix(*arguments)
    assert planar.mass_matrix(np.zeros(3)).shape == (3, 3)  # and do no harm


def test_directories_that_are_no_paths_are_refused():
    for wrong in (None, 5, b"folder", "a\0b"):
        with pytest.raises(ArgumentError, match="directory: given"):
            load(wrong)


def test_wrong_names_and_counts_are_refused(planar):
    with pytest.raises(ArgumentError, match="given 1 arguments and q, expected q_a, v_a"):
        planar.bias(np.zeros(3), q=np.zeros(3))
    with pytest.raises(ArgumentError, match="given 3 points, expected 2"):
        planar.bias(np.zeros((2, 3)), np.zeros((3, 3)))
    with pytest.raises(AttributeError, match="expected one of the library's functions: forward_kinematics"):
        planar.mass  # noqa: B018


def test_integers_lists_and_strided_arrays_are_welcome(planar):
    expected = planar.gravity(np.array([1.0, 2.0, 3.0]))
    for q_a in ([1, 2, 3], np.arange(1, 4), np.arange(1, 7, dtype=np.float32)[:3], np.array([3.0, 2.0, 1.0])[::-1]):
        assert np.array_equal(planar.gravity(q_a), expected)
    columns = np.asfortranarray(np.tile([1.0, 2.0, 3.0], (5, 1)))
    assert np.array_equal(planar.gravity(columns), np.tile(expected, (5, 1)))


def test_a_result_that_is_not_finite_is_an_error(planar):
    huge = np.array([0.0, 0.0, 0.0]), np.full(3, 1e200), np.zeros(3)
    with pytest.raises(SolverError, match="inverse_dynamics: the result is not finite"):
        planar.inverse_dynamics(*huge)
    with pytest.raises(SolverError, match="inverse_dynamics, point 1: the result"):
        planar.inverse_dynamics(np.zeros(3), np.array([[1.0] * 3, [1e200] * 3, [1.0] * 3]), np.zeros(3))


def test_c_returns_a_status_and_spoils_what_failed(planar):
    library = ctypes.CDLL(str(next(path for path in made("planar5_nmp").files if path.suffix in (".so", ".dylib"))))
    function, batch = library.planar5_nmp_gravity, library.planar5_nmp_gravity_batch
    function.argtypes, batch.argtypes = [ctypes.c_void_p] * 3, [ctypes.c_int] + [ctypes.c_void_p] * 3
    q_a, g, work = np.zeros((3, 3)), np.full((3, 3), 5.0), np.zeros(planar.functions["gravity"]._work)
    where = [x.ctypes.data for x in (q_a, g, work)]
    code = {status.name: status.code for status in STATUSES}
    for i in range(3):
        null = [None if k == i else where[k] for k in range(3)]
        assert function(*null) == code["NULL_ARGUMENT"] == batch(3, *null)
    assert batch(-1, *where) == code["BAD_COUNT"]
    assert batch(0, *where) == code["OK"]
    assert (g == 5.0).all()
    q_a[1, 0] = np.inf
    assert batch(3, *where) == code["INPUT_NOT_FINITE"]
    assert np.isnan(g[1]).all() and np.isfinite(g[[0, 2]]).all()
    text = library.planar5_nmp_status_text
    text.restype = ctypes.c_char_p
    for status in STATUSES:
        assert text(status.code).decode() == status.text
    assert text(-99) == b"unknown status"
