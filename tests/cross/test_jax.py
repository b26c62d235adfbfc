"""The functions of a library in JAX: bits of the library, gradients against differences, batches,
errors.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from array_cases import checked_gradients, drawn, library

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.codegen.emission.spec import choose_functions

jax = pytest.importorskip("jax", reason="the package jax is not installed")
jnp = jax.numpy
CASES = [
    pytest.param(("elbow", ("gravity", "mass_matrix", "bias"), (), "double"), id="elbow"),
    pytest.param(("planar5_nmp", None, (), "double"), id="planar5_nmp", marks=pytest.mark.slow),
    pytest.param(
        ("elbow", None, ("stiffness", "payload"), "double"),
        id="elbow-parameters",
        marks=pytest.mark.slow,
    ),
]


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


@cache
def pair(case):
    robot = library(*case)
    return robot, flexgen.jax.functions(robot)


def flat(result) -> list[np.ndarray]:
    return [np.asarray(x) for x in (result if isinstance(result, tuple) else (result,))]


def equal(one, other) -> bool:
    return all(
        np.array_equal(a, b) and a.dtype == b.dtype
        for a, b in zip(flat(one), flat(other), strict=True)
    )


@pytest.mark.parametrize("case", CASES)
def test_results_have_the_bits_of_the_library(case) -> None:
    """One point, a batch longer than a tile, two axes, vmap, and vmap of vmap with an array that
    both share.
    """
    robot, made = pair(case)
    for name in dir(made):
        if name not in robot.functions:
            continue
        f = getattr(made, name)
        inputs = robot.functions[name].inputs
        one, many = (drawn(robot, name, n) for n in (None, 300))
        assert equal(f(*one), robot.functions[name](*one)), name
        expected = robot.functions[name](*many)
        assert equal(f(*many), expected), name
        shared = [0 if x.ndim > len(p.shape) else None for x, p in zip(many, inputs, strict=True)]
        assert equal(jax.vmap(f, shared)(*many), expected), name
        folded = [
            x.reshape(20, 15, *p.shape) if a == 0 else x
            for x, a, p in zip(many, shared, inputs, strict=True)
        ]
        nested = flat(jax.jit(jax.vmap(jax.vmap(f, shared), shared))(*folded))
        for x, y in zip(nested, flat(expected), strict=True):
            assert np.array_equal(x.reshape(y.shape), y), name


@pytest.mark.slow
def test_axes_of_a_batch_in_any_place_and_of_some_arrays() -> None:
    robot, made = pair(CASES[1].values[0])
    q, v, a = (x[:6] for x in drawn(robot, "inverse_dynamics", 300))
    found = jax.vmap(jax.vmap(made.inverse_dynamics, (0, None, 1)), (None, 0, None))(q, v, a.T)
    for i in range(6):
        for k in range(6):
            assert np.array_equal(found[i, k], robot.inverse_dynamics(q[k], v[i], a[k]))


def test_a_batch_inside_of_another_and_derivatives_in_one_argument() -> None:
    """Positions have one axis, speeds two; the product with a direction is linear in it."""
    robot, made = pair(CASES[0].values[0])
    q, v = (x[:6] for x in drawn(robot, "bias", 6))
    speeds = np.stack([v, 2 * v, -v], axis=2)
    found = jax.vmap(lambda v: made.bias(q, v), 2)(speeds)
    expected = [robot.bias(q, speeds[:, :, k]) for k in range(3)]
    assert np.array_equal(found, expected)
    weights = jnp.array([0.3, -0.7])

    def loss(v):
        return weights @ made.bias(q[0], v)

    back = robot.bias_vjp(q[0], v[0], np.asarray(weights))
    assert np.array_equal(jax.grad(loss)(v[0]), back.v_a_cotangent)

    def along(d):
        return jax.jvp(lambda v: made.bias(q[0], v), (v[0],), (d,))[1]

    assert np.allclose(jax.jacfwd(along)(v[1]), jax.jacfwd(lambda v: made.bias(q[0], v))(v[0]))
    assert np.allclose(along(v[1]), jax.jacrev(along)(v[0]) @ v[1])


@pytest.mark.parametrize("case", CASES)
def test_gradients_equal_differences_of_the_library(case) -> None:
    checked_gradients(case, jacobians)


def jacobians(case, name: str, x: list[np.ndarray]):
    """Of all results in all inputs, forward and in reverse, which must agree."""
    f = getattr(pair(case)[1], name)
    at = tuple(range(len(x)))
    forward, back = (
        jax.jit(kind(lambda *x: flat_results(f(*x)), argnums=at))(*x)
        for kind in (jax.jacfwd, jax.jacrev)
    )
    for one, other in zip(forward, back, strict=True):
        size = np.abs(one).max() if one.size else 0.0
        assert np.abs(one - other).max() <= 1e-12 * size, name
    return [np.asarray(J) for J in back]


def flat_results(result):
    return jnp.concatenate(
        [x.ravel() for x in (result if isinstance(result, tuple) else (result,))]
    )


@pytest.mark.slow
def test_a_planted_sign_of_the_transpose_is_caught(monkeypatch) -> None:
    rules = jax.interpreters.ad.primitive_transposes
    (linear,) = (primitive for primitive in rules if primitive.name == "flexgen_linear")
    rule = rules[linear]

    def planted(cotangents, *operands, **given):
        return [None if g is None else -g for g in rule(cotangents, *operands, **given)]

    jax.clear_caches()
    monkeypatch.setitem(rules, linear, planted)
    with pytest.raises(AssertionError):
        checked_gradients(CASES[1].values[0], jacobians, names=["bias"])
    jax.clear_caches()


@pytest.mark.slow
def test_gradients_in_batches_are_sums_over_what_the_points_share() -> None:
    """A shared vector of parameters, weights of all points; then one vector for each point."""
    case = CASES[2].values[0]
    robot, made = pair(case)
    *x, p = drawn(robot, "forward_dynamics", 40)
    w = np.random.default_rng(5).normal(size=(40, robot.sizes["n_a"]))

    def loss(p, q, v):
        return jnp.sum(w * made.forward_dynamics(q, v, *x[2:], p).a_a)

    by_p, by_q = jax.jit(jax.grad(loss, argnums=(0, 1)))(p, *x[:2])
    sums = np.zeros_like(p)
    rows = []
    for k in range(40):
        back = robot.forward_dynamics_vjp(
            *(y[k] for y in x), w[k], np.zeros(robot.sizes["n_m"]), parameters=p
        )
        sums += back.parameters_cotangent
        rows.append(back.q_a_cotangent)
    assert np.abs(by_p - sums).max() <= 1e-13 * np.abs(sums).max() and np.array_equal(by_q, rows)
    each = jnp.tile(p, (40, 1)) * jnp.linspace(0.9, 1.1, 40)[:, None]
    found = jax.jit(made.forward_dynamics)(*x, each)
    for k in range(40):
        assert np.array_equal(
            found.a_a[k], robot.forward_dynamics(*(y[k] for y in x), np.asarray(each[k])).a_a
        )


@pytest.mark.slow
def test_a_compiled_loop_and_its_gradient() -> None:
    """Euler steps by scan have the bits of the same steps in Python; the gradient passes through
    the loop.
    """
    robot, made = pair(CASES[1].values[0])
    q, v, tau = drawn(robot, "arm_forward_dynamics", None)

    def end(q):
        def step(state, _):
            q, v = state
            return (q + 1e-3 * v, v + 1e-3 * made.arm_forward_dynamics(q, v, tau)), None

        return jax.lax.scan(step, (q, v), length=30)[0][0]

    x = q
    y = v
    for _ in range(30):
        x, y = x + 1e-3 * y, y + 1e-3 * robot.arm_forward_dynamics(x, y, tau)
    assert np.abs(jax.jit(end)(q) - x).max() <= 1e-14
    d = np.array([0.3, -0.5, 0.2])
    h = 1e-5
    difference = (end(q + h * d) - end(q - h * d)) / (2 * h)
    assert np.abs(jax.jacrev(end)(q) @ d - difference).max() <= 1e-8
    assert np.allclose(jax.jacfwd(end)(q), jax.jacrev(end)(q), rtol=1e-12, atol=1e-14)


def test_points_that_fail_are_nan_inside_of_compiled_programs() -> None:
    robot, made = pair(CASES[0].values[0])
    (q,) = drawn(robot, "gravity", 300)
    q = q.copy()
    q[280, 1] = np.inf
    found = np.asarray(jax.jit(made.gravity)(q))
    assert np.isnan(found[280]).all() and np.isfinite(np.delete(found, 280, axis=0)).all()
    assert np.isnan(jax.grad(lambda q: made.gravity(q).sum())(q[280])).all()


def test_a_batch_of_zero_points() -> None:
    _, made = pair(CASES[0].values[0])
    assert made.mass_matrix(np.zeros((0, 2))).shape == (0, 2, 2)


@pytest.mark.slow
def test_single_precision() -> None:
    robot = library("elbow", ("inverse_dynamics",), (), "single")
    with jax.enable_x64(False):
        made = flexgen.jax.functions(robot)
        x = drawn(robot, "inverse_dynamics", 9)
        assert equal(jax.jit(made.inverse_dynamics)(*x), robot.inverse_dynamics(*x))
        J = jax.jacrev(made.inverse_dynamics)(*(y[0] for y in x))
        assert J.dtype == np.float32 and np.isfinite(J).all()


def test_double_precision_needs_the_switch_of_jax() -> None:
    robot, made = pair(CASES[0].values[0])
    with jax.enable_x64(False):
        for call in (lambda: flexgen.jax.functions(robot), lambda: made.gravity([0.0, 0.0])):
            with pytest.raises(
                ArgumentError, match=r"jax.config.update\('jax_enable_x64', True\)"
            ):
                call()


def test_wrong_calls_are_refused_with_the_reason() -> None:
    _, made = pair(CASES[0].values[0])
    for call, reason in (
        (lambda: made.gravity(np.zeros(3)), r"gravity, q_a: given shape \(3,\), expected \(2,\)"),
        (lambda: made.gravity(), "gravity: given 0 arguments, expected q_a"),
        (
            lambda: made.gravity(object()),
            "gravity, q_a: given object, expected an array of numbers",
        ),
        (lambda: made.gravity(np.zeros(2) * 1j), "real numbers"),
        (
            lambda: jax.hessian(lambda q: made.gravity(q).sum())(np.zeros(2)),
            "flexgen has no second derivatives",
        ),
        (
            lambda: jax.jacfwd(jax.jacfwd(made.gravity))(np.zeros(2)),
            "flexgen has no second derivatives",
        ),
    ):
        with pytest.raises(ArgumentError, match=reason):
            call()
    with pytest.raises(
        AttributeError,
        match="given 'linearize', expected one of the library's functions: mass_matrix",
    ):
        made.linearize  # noqa: B018


def test_a_library_without_derivatives_says_what_to_generate() -> None:
    robot = library("elbow", ("gravity", "inverse_dynamics_derivatives"), (), "double", ())
    made = flexgen.jax.functions(robot)
    with pytest.raises(
        ArgumentError,
        match=r"without gravity_jvp.*parts=\['derivatives'\].*'gravity_jvp', 'gravity_vjp'",
    ):
        jax.grad(lambda q: made.gravity(q).sum())(np.zeros(2))
    with pytest.raises(ArgumentError, match="a function that is a derivative itself"):
        jax.grad(lambda q: made.inverse_dynamics_derivatives(q, q, q).dtau_dq.sum())(np.zeros(2))


def test_a_closed_library_refuses_new_programs_and_compiled_ones_still_run() -> None:
    robot = flexgen.load(library(*CASES[0].values[0]).directory)
    made = flexgen.jax.functions(robot)
    compiled = jax.jit(made.gravity)
    before = compiled(np.zeros(2))
    robot.close()
    assert np.array_equal(compiled(np.zeros(2)), before)
    for call in (lambda: made.gravity(np.zeros(2)), lambda: flexgen.jax.functions(robot)):
        with pytest.raises(ArgumentError, match="closed"):
            call()


def test_a_program_finds_no_function_of_a_library_that_is_not_loaded() -> None:
    from flexgen.backends.autodiff import jax_functions

    pair(CASES[0].values[0])
    lowering = jax.ffi.ffi_call(jax_functions.TARGET, jax.ShapeDtypeStruct((2,), np.float64))
    with pytest.raises(Exception, match="a flexgen library that is not loaded"):
        lowering(np.zeros(2), key=np.int64(12345)).block_until_ready()


def test_the_optional_part_adds_products_of_the_chosen_functions_only() -> None:
    model = flexgen.read("elbow")
    assert choose_functions(["gravity", "linearize"], model, ["derivatives"]) == (
        *("gravity", "linearize", "gravity_jvp", "gravity_vjp"),
    )
    assert choose_functions(["gravity"], model, ["bvp"]) == ("gravity",)
    with pytest.raises(
        ArgumentError, match="with the functions linearize, expected one that is not a derivative"
    ):
        choose_functions(["linearize"], model, ["derivatives"])
