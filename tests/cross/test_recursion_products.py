"""Products with derivatives (jvp, vjp) against matrices of derivatives, differences and their own
transposes.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from recursion_cases import MADE, ROBOTS, equations_of, values
from referee import ALL_MODELS

import flexgen
from flexgen.codegen.emission.spec import choose_functions
from flexgen.codegen.recursion import products
from flexgen.codegen.recursion.functions import recursive_function
from flexgen.codegen.recursion.tape import Tape
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.signatures import DIFFERENTIATED, offered_functions, split_product
from flexgen.model.reader import read

NEAR = 0.02  # rad or m: where loops close
EXACT = 1e-13  # of the largest term of a product
QUICK = ("elbow", "planar5_nmp", "manutec_r3", "urdf_arm")
MODELS = [
    pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
    for name in [*ALL_MODELS, *ROBOTS, *MADE]
]


def drawn(equations: Equations, names, rng: np.random.Generator) -> dict[str, np.ndarray]:
    model = equations.model
    sizes = {"m": model.n_m, "a": model.n_a}
    found = {name: rng.uniform(-1.0, 1.0, sizes[name.split("_")[1]]) for name in names}
    if model.loops:  # they close around home only
        found["q_a"] *= NEAR
        found["q_a"][list(model.i_g)] += model.home
    return found


def check_inverse_dynamics(equations: Equations, seed: int) -> None:
    """Against the recursion of the derivatives' matrices, or the Lagrangian's."""
    rng = np.random.default_rng(seed)
    names = ("q_a", "v_a", "a_a")
    x = drawn(equations, names, rng)
    dx = drawn(equations, names, rng)
    w = rng.uniform(-1.0, 1.0, equations.model.n_a)
    matrices = values(equations.function("inverse_dynamics_derivatives"), x)
    given = x | {f"{name}_tangent": dx[name] for name in names}
    found = values(recursive_function(equations, "inverse_dynamics_jvp"), given)[0].ravel()
    terms = [J @ dx[name] for J, name in zip(matrices, names, strict=True)]
    size = sum(np.abs(J) @ np.abs(dx[name]) for J, name in zip(matrices, names, strict=True)).max()
    assert np.abs(found - sum(terms)).max() <= EXACT * size
    back = values(
        recursive_function(equations, "inverse_dynamics_vjp"), x | {"tau_a_cotangent": w}
    )
    size = max((np.abs(J).T @ np.abs(w)).max() for J in matrices)
    for J, gradient in zip(matrices, back, strict=True):
        assert np.abs(gradient.ravel() - J.T @ w).max() <= EXACT * size


def check_accelerations(equations: Equations, seed: int) -> None:
    """``M a_change`` against changes of torques: the condition of the mass matrix does not
    count.
    """
    rng = np.random.default_rng(seed)
    n_a = equations.model.n_a
    x, dx = (drawn(equations, ("q_a", "v_a", "tau_a"), rng) for _ in range(2))
    a = values(recursive_function(equations, "arm_forward_dynamics"), x)[0].ravel()
    by_q, by_v, M = values(
        equations.function("inverse_dynamics_derivatives"),
        {"q_a": x["q_a"], "v_a": x["v_a"], "a_a": a},
    )
    given = x | {f"{name}_tangent": dx[name] for name in dx}
    da = values(recursive_function(equations, "arm_forward_dynamics_jvp"), given)[0].ravel()
    size = (
        np.abs(M) @ np.abs(da)
        + np.abs(by_q) @ np.abs(dx["q_a"])
        + np.abs(by_v) @ np.abs(dx["v_a"])
    ).max()
    assert (
        np.abs(M @ da + by_q @ dx["q_a"] + by_v @ dx["v_a"] - dx["tau_a"]).max()
        <= 10 * EXACT * size
    )
    w = M @ rng.uniform(-1.0, 1.0, n_a)
    back = values(
        recursive_function(equations, "arm_forward_dynamics_vjp"), x | {"a_a_cotangent": w}
    )
    g_q, g_v, mu = (part.ravel() for part in back)
    assert np.abs(M @ mu - w).max() <= 10 * EXACT * (np.abs(M) @ np.abs(mu)).max()
    for found, J in ((g_q, by_q), (g_v, by_v)):
        assert np.abs(found + J.T @ mu).max() <= 10 * EXACT * max(
            (np.abs(J).T @ np.abs(mu)).max(), np.abs(w).max()
        )


@pytest.mark.parametrize("name", MODELS)
def test_products_of_arm_functions_equal_matrices_times_vectors(name) -> None:
    equations = equations_of(name)
    if recursive_function(equations, "inverse_dynamics") is None:
        pytest.skip("no recursion: the products are the Lagrangian's")
    for seed in range(3):
        check_inverse_dynamics(equations, seed)
        if recursive_function(equations, "arm_forward_dynamics") is not None:
            check_accelerations(equations, seed)


def all_operations(function: ca.Function) -> int:
    """Arithmetic operations, sines and cosines (one each, though they take longer), and other
    functions.
    """
    kinds = [function.instruction_id(k) for k in range(function.n_instructions())]
    return sum(
        kind not in (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ASSIGN) for kind in kinds
    )


@pytest.mark.parametrize("name", MODELS)
def test_products_take_at_most_2_5_times_the_operations_of_their_function(name) -> None:
    equations = equations_of(name)
    for function in ("inverse_dynamics", "arm_forward_dynamics", "forward_dynamics"):
        fast = recursive_function(equations, function)
        if fast is not None and "parameters" not in fast.name_in():
            for kind in ("jvp", "vjp"):
                product = recursive_function(equations, f"{function}_{kind}")
                assert all_operations(product) <= 2.5 * all_operations(fast)


def test_a_planted_sign_in_the_derivative_of_rotations_is_caught(monkeypatch) -> None:
    rotations = Tape.find_rotations

    def planted(self, results):
        return {
            node: (angle, -slope, terms)
            for node, (angle, slope, terms) in rotations(self, results).items()
        }

    monkeypatch.setattr(Tape, "find_rotations", planted)
    with pytest.raises(AssertionError):
        check_inverse_dynamics(derive("planar5_nmp"), 0)


LINEARIZED = [
    "planar5_nmp",
    "four_mass",
    "urdf_arm",
    pytest.param("manutec_r3_efjm", marks=pytest.mark.slow),
]


@pytest.mark.parametrize("name", LINEARIZED)
def test_products_of_forward_dynamics_equal_the_linearization(name) -> None:
    equations = equations_of(name)
    rng = np.random.default_rng(3)
    model = equations.model
    n_a = model.n_a
    i_m = list(model.i_m)
    names = ("q_a", "v_a", "q_m", "v_m", "tau_m")
    x = drawn(equations, names, rng)
    dx = drawn(equations, names, rng)
    A, B = values(equations.function("linearize"), x)
    n = model.dof
    state = np.concatenate([dx["q_a"], dx["q_m"][i_m], dx["v_a"], dx["v_m"][i_m]])
    expected = (A @ state + B @ dx["tau_m"])[n:]
    given = x | {f"{name}_tangent": dx[name] for name in names}
    da_a, da_m = (
        y.ravel() for y in values(recursive_function(equations, "forward_dynamics_jvp"), given)
    )
    size = (np.abs(A) @ np.abs(state) + np.abs(B) @ np.abs(dx["tau_m"]))[n:].max()
    assert np.abs(np.concatenate([da_a, da_m[i_m]]) - expected).max() <= 1e-10 * size
    rigid = [j for j in range(model.n_m) if j not in i_m]
    assert np.allclose(da_m[rigid], (model.eta @ da_a[list(model.i_g)])[rigid], rtol=1e-12, atol=0)
    w_a = rng.uniform(-1.0, 1.0, n_a)
    w_m = rng.uniform(-1.0, 1.0, model.n_m)
    back = values(
        recursive_function(equations, "forward_dynamics_vjp"),
        x | {"a_a_cotangent": w_a, "a_m_cotangent": w_m},
    )
    forward = w_a @ da_a + w_m @ da_m
    assert (
        abs(sum(g.ravel() @ dx[name] for g, name in zip(back, names, strict=True)) - forward)
        <= 1e-10 * size
    )


@pytest.mark.parametrize(
    "model", ["planar5_nmp", pytest.param("manutec_r3", marks=pytest.mark.slow)]
)
def test_products_of_all_functions_are_derivatives_and_transposes(model) -> None:
    """With run-time parameters: against central differences of the Lagrangian's function."""
    equations = derive(model, ("payload", "stiffness"))
    rng = np.random.default_rng(4)
    p = np.array([parameter.value for parameter in equations.parameters])
    offered = set(offered_functions(equations.model))
    for name in [each for each in DIFFERENTIATED if each in offered]:
        slow = equations.function(name)
        x = {
            key: p if key == "parameters" else rng.uniform(-1, 1, slow.size_in(key)[0])
            for key in slow.name_in()
        }
        dx = {
            key: rng.uniform(-1, 1, len(v)) * np.maximum(np.abs(v), 1e-3) for key, v in x.items()
        }
        h = 1e-6
        ends = [
            np.concatenate(
                [y.ravel("F") for y in values(slow, {k: x[k] + s * h * dx[k] for k in x})]
            )
            for s in (1, -1)
        ]
        expected = (ends[0] - ends[1]) / (2 * h)
        for made in (recursive_function, lambda equations, name: equations.function(name)):
            jvp = made(equations, f"{name}_jvp")
            vjp = made(equations, f"{name}_vjp")
            if jvp is None:
                continue
            given = {"parameters": p} | x | {f"{key}_tangent": value for key, value in dx.items()}
            found = [
                y.full().ravel("F") for y in jvp.call([ca.DM(given[key]) for key in jvp.name_in()])
            ]
            flat = np.concatenate(found)
            assert np.abs(flat - expected).max() <= 1e-6 * (
                1.0 + np.abs(ends[0]).max() + np.abs(expected).max()
            ), name
            w = {
                f"{key}_cotangent": rng.uniform(-1, 1, y.shape)
                for key, y in zip(slow.name_out(), found, strict=True)
            }
            shaped = [
                ca.reshape(ca.DM(w[key]), vjp.size_in(key)) if key in w else ca.DM(given[key])
                for key in vjp.name_in()
            ]
            back = dict(zip(vjp.name_out(), vjp.call(shaped), strict=True))
            total = sum(back[f"{key}_cotangent"].full().ravel() @ dx[key] for key in x)
            assert total == pytest.approx(
                np.concatenate(list(w.values())) @ flat, rel=1e-9, abs=1e-9 * np.abs(flat).max()
            )


def test_products_that_a_model_lacks_are_refused_with_the_reason_of_their_function() -> None:
    for name, reason in (
        ("sensors_vjp", "has no sensors"),
        ("flexible_joint_motion_jvp", "expected a motor and a spring for each arm coordinate"),
        (
            "linearize_jvp",
            "expected some of forward_kinematics, .*, mass_matrix_packed, .*NAME_jvp, NAME_vjp",
        ),
    ):
        with pytest.raises(flexgen.ArgumentError, match=reason):
            choose_functions([name], derive("planar5_nmp").model)


def test_names_of_products_are_told_from_others() -> None:
    assert split_product("inverse_dynamics_jvp") == ("inverse_dynamics", "jvp")
    assert split_product("bias") == ("bias", "")
    with pytest.raises(flexgen.ArgumentError, match="function: given 'nosuch_jvp'"):
        derive("elbow").function("nosuch_jvp")


@pytest.mark.slow
@pytest.mark.parametrize("parameters", [(), ("payload", "stiffness")])
def test_emitted_products_equal_emitted_derivatives(tmp_path, parameters) -> None:
    names = "inverse_dynamics_jvp inverse_dynamics_vjp inverse_dynamics_derivatives".split()
    library = flexgen.load(
        flexgen.generate(
            "planar5_nmp", tmp_path / "l", functions=names, parameters=parameters, progress=False
        ).directory
    )
    rng = np.random.default_rng(0)
    count = 40
    x = {name: rng.uniform(-1, 1, (count, 3)) for name in ("q_a", "v_a", "a_a")}
    dx = {f"{name}_tangent": rng.uniform(-1, 1, (count, 3)) for name in x}
    more = {"parameters_tangent": np.zeros((count, 7))} if parameters else {}
    matrices = library.inverse_dynamics_derivatives(**x)
    w = rng.uniform(-1, 1, (count, 3))
    expected = sum(
        np.einsum("kij,kj->ki", J, d) for J, d in zip(matrices, dx.values(), strict=True)
    )
    found = library.inverse_dynamics_jvp(**x, **dx, **more)
    assert np.abs(found - expected).max() <= EXACT * np.abs(expected).max()
    back = library.inverse_dynamics_vjp(**x, tau_a_cotangent=w)
    for J, gradient in zip(matrices, back[:3], strict=True):
        assert (
            np.abs(gradient - np.einsum("kij,ki->kj", J, w)).max() <= EXACT * np.abs(J).max() * 3
        )
    one = library.inverse_dynamics_jvp(**{k: v[7] for k, v in (x | dx | more).items()})
    assert np.array_equal(one, found[7])


def test_products_have_recursions_of_their_own_where_no_parameter_changes_the_function(
    monkeypatch,
) -> None:
    """Else they are the derivatives of the function, and none where it has no recursion."""
    general: list[str] = []
    monkeypatch.setattr(
        products, "of_function", lambda arm, function, product: general.append(function.name())
    )
    plain = Equations(read("elbow"))
    varied = Equations(read("elbow"), ("payload",))
    for name in products.BUILDERS:
        recursive_function(plain, f"{name}_jvp")
    assert general == []
    known = [name for name in products.BUILDERS if recursive_function(varied, name) is not None]
    changed = [
        name for name in known if "parameters" in recursive_function(varied, name).name_in()
    ]
    for name in products.BUILDERS:
        recursive_function(varied, f"{name}_vjp")
    assert changed and len(general) == len(changed)
    general.clear()
    assert (
        recursive_function(Equations(read("beam_arm")), "mass_matrix_jvp") is None
        and general == []
    )
