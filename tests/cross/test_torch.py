"""The functions of a library in PyTorch: bits of the library, gradients, batches, transforms,
errors.
"""

from __future__ import annotations

import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from array_cases import checked_gradients, drawn, library

import flexgen
from flexgen.base.errors import ArgumentError

torch = pytest.importorskip("torch", reason="the package torch is not installed: make test-arrays")
# of torch, in its forward mode
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit:DeprecationWarning")
ROOT = Path(__file__).resolve().parents[2]
SMALL = ("elbow", ("gravity", "mass_matrix"), (), "double")
PLANAR = ("planar5_nmp", None, (), "double")
WITH_PARAMETERS = ("elbow", None, ("stiffness", "payload"), "double")
CASES = [
    pytest.param(SMALL, id="elbow"),
    pytest.param(PLANAR, id="planar5_nmp", marks=pytest.mark.slow),
    pytest.param(WITH_PARAMETERS, id="elbow-parameters", marks=pytest.mark.slow),
]


@cache
def pair(case):
    robot = library(*case)
    return robot, flexgen.torch.functions(robot)


def tensors(arrays, **options):
    return [torch.tensor(x, **options) for x in arrays]


def parts(result):
    return result if isinstance(result, tuple) else (result,)


def equal(one, other) -> bool:
    pairs = zip(parts(one), parts(other), strict=True)
    return all(
        np.array_equal(np.asarray(a), b) and np.asarray(a).dtype == b.dtype for a, b in pairs
    )


@pytest.mark.parametrize("case", CASES)
def test_results_have_the_bits_of_the_library(case) -> None:
    """One point, a batch longer than a tile, two axes, and tensors that are not contiguous."""
    robot, made = pair(case)
    for name in [each for each in dir(made) if each in robot.functions]:
        f = getattr(made, name)
        inputs = robot.functions[name].inputs
        one, many = (drawn(robot, name, n) for n in (None, 300))
        assert equal(f(*tensors(one)), robot.functions[name](*one)), name
        expected = robot.functions[name](*many)
        assert equal(f(*tensors(many)), expected), name
        assert equal(f(*tensors(np.asfortranarray(x) for x in many)), expected), name
        folded = [
            x.reshape(20, 15, *p.shape) if x.ndim > len(p.shape) else x
            for x, p in zip(many, inputs, strict=True)
        ]
        for x, y in zip(parts(f(*tensors(folded))), parts(expected), strict=True):
            assert np.array_equal(x.reshape(y.shape), y), name


@pytest.mark.parametrize("case", CASES)
def test_gradients_equal_differences_of_the_library(case) -> None:
    checked_gradients(case, jacobians)


def jacobians(case, name: str, x):
    """Of all results in all inputs, in reverse and forward, which must agree."""
    f = getattr(pair(case)[1], name)

    def flat(*x):
        return torch.cat([y.reshape(-1) for y in parts(f(*x))])

    at = tuple(range(len(x)))
    back, forward = (
        kind(flat, argnums=at)(*tensors(x)) for kind in (torch.func.jacrev, torch.func.jacfwd)
    )
    for one, other in zip(forward, back, strict=True):
        assert (one - other).abs().max() <= 1e-12 * one.abs().max(), name
    return [J.numpy() for J in back]


@pytest.mark.parametrize("case", CASES)
def test_gradcheck_of_torch(case) -> None:
    """Batches, and an array that all points share."""
    robot, made = pair(case)
    for name in ("gravity", "mass_matrix", "forward_dynamics", "tool_motion"):
        if name in dir(made):
            x = tensors(drawn(robot, name, 3))
            # (the differences have one step for all entries)
            sizes = [y.abs().clamp(min=1.0) for y in x]
            at = [(y / size).requires_grad_() for y, size in zip(x, sizes, strict=True)]

            def call(*z, name=name, sizes=sizes):
                result = parts(
                    getattr(made, name)(*(s * y for s, y in zip(sizes, z, strict=True)))
                )
                return tuple(y / 1e3 for y in result)

            assert torch.autograd.gradcheck(
                call, at, eps=1e-6, atol=1e-5, rtol=1e-5, check_forward_ad=True
            ), name


def test_a_planted_sign_is_caught(monkeypatch) -> None:
    from flexgen.backends.autodiff import torch_functions

    def planted(points, name, arrays, evaluate=torch_functions.evaluate):
        return tuple(-y if name.endswith("_vjp") else y for y in evaluate(points, name, arrays))

    monkeypatch.setattr(torch_functions, "evaluate", planted)
    with pytest.raises(AssertionError):
        checked_gradients(SMALL, jacobians)


def test_vmap_of_vmap_and_axes_in_any_place() -> None:
    robot, made = pair(SMALL)
    (q,) = drawn(robot, "mass_matrix", 12)
    found = torch.vmap(torch.vmap(made.mass_matrix), in_dims=1)(torch.tensor(q.reshape(4, 3, 2)))
    assert np.array_equal(found, robot.mass_matrix(q).reshape(4, 3, 2, 2).transpose(1, 0, 2, 3))


@pytest.mark.slow
def test_gradients_of_what_the_points_share_are_sums() -> None:
    robot, made = pair(WITH_PARAMETERS)
    *x, p = drawn(robot, "forward_dynamics", 30)
    given = torch.tensor(p, requires_grad=True)
    made.forward_dynamics(*tensors(x), given).a_a.sum().backward()
    weights = np.ones(robot.sizes["n_a"]), np.zeros(robot.sizes["n_m"])
    back = [
        robot.forward_dynamics_vjp(*(y[k] for y in x), *weights, parameters=p).parameters_cotangent
        for k in range(30)
    ]
    assert np.allclose(given.grad, np.sum(back, axis=0), rtol=1e-12)


@pytest.mark.slow
def test_single_precision() -> None:
    robot = library("elbow", ("inverse_dynamics",), (), "single")
    made = flexgen.torch.functions(robot)
    x = drawn(robot, "inverse_dynamics", 9)
    assert equal(made.inverse_dynamics(*tensors(x)), robot.inverse_dynamics(*x))
    q = torch.tensor(x[0], dtype=torch.float32, requires_grad=True)
    made.inverse_dynamics(q, *tensors(x[1:])).sum().backward()
    assert q.grad.dtype == torch.float32 and torch.isfinite(q.grad).all()


def test_numbers_of_another_precision_are_converted_and_have_gradients_of_their_own() -> None:
    _, made = pair(SMALL)
    q = torch.zeros(2, dtype=torch.float32, requires_grad=True)
    made.gravity(q).sum().backward()
    assert made.gravity(q).dtype == torch.float64 and q.grad.dtype == torch.float32


def test_points_that_fail_are_nan() -> None:
    robot, made = pair(SMALL)
    (q,) = tensors(drawn(robot, "gravity", 300))
    q[280, 1] = torch.inf
    found = made.gravity(q)
    assert torch.isnan(found[280]).all() and torch.isfinite(found[:280]).all()
    assert made.mass_matrix(torch.zeros(0, 2)).shape == (0, 2, 2)


def test_wrong_calls_are_refused_with_the_reason() -> None:
    robot, made = pair(SMALL)
    q = torch.zeros(2, dtype=torch.float64, requires_grad=True)
    (g,) = torch.autograd.grad(made.gravity(q).sum(), q, create_graph=True)
    bare = flexgen.torch.functions(library("elbow", ("gravity",), (), "double", ()))
    closed = flexgen.load(robot.directory)
    other = flexgen.torch.functions(closed)
    closed.close()
    for call, reason in (
        (
            lambda: made.gravity(torch.zeros(3)),
            r"gravity, q_a: given shape \(3,\), expected \(2,\)",
        ),
        (lambda: made.gravity(torch.zeros(2) * 1j), "real numbers"),
        (lambda: made.gravity(torch.zeros(2, device="meta")), "expected one on the CPU"),
        (lambda: g.sum().backward(), "flexgen has no second derivatives"),
        (
            lambda: bare.gravity(q).sum().backward(),
            r"without gravity_jvp.*parts=\['derivatives'\]",
        ),
        (lambda: other.gravity(q), "closed"),
    ):
        with pytest.raises(ArgumentError, match=reason):
            call()


@pytest.mark.slow
def test_python_of_the_page_runs(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "pytorch.md").read_text(encoding="utf-8")
    code = "\n".join(
        re.findall(r"^<!-- torch -->\n```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    stated = re.findall(r"^print\(.*\)\s+# (.*)$", code, re.MULTILINE)
    assert stated and all(line in done.stdout for line in stated), done.stdout
