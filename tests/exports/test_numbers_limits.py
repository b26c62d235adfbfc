"""Largest orders, reasons of functions that cannot be expanded, and least moments for MuJoCo."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.base.errors import BuildError
from flexgen.codegen.emission import routines
from flexgen.dynamics.dae import strangeness_index
from flexgen.exports.mujoco.mujoco_inertia import _find_least, principal


def test_the_strangeness_index_is_searched_up_to_eight(monkeypatch: pytest.MonkeyPatch) -> None:
    """At rest: a point whose derivatives of all orders are zero."""
    seen: list[np.ndarray] = []

    def jacobians(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen.append(x)
        return x[:, :1], x[:, 1:2]

    series = Made(jacobians=jacobians, scales=lambda x: "scales")
    monkeypatch.setattr(
        strangeness_index,
        "InverseDae",
        lambda equations: Made(n_x=3, pack=lambda rest: [1.0, 2.0, 3.0]),
    )
    monkeypatch.setattr(strangeness_index, "TaylorArray", lambda dae: series)
    monkeypatch.setattr(
        strangeness_index, "characterize", lambda F_x, F_dx, scales: (F_x.tolist(), scales)
    )
    search: Any = strangeness_index.kunkel_mehrmann_at_rest
    assert search(None, rest="rest") == ([[1.0, 2.0, 3.0]], "scales")
    search(None, rest="rest", highest=2)
    assert [x.shape for x in seen] == [(1, 10, 3), (1, 4, 3)] and not seen[0][0, 1:].any()


def test_a_function_that_cannot_be_expanded_says_why() -> None:
    """The last line of what CasADi says."""

    class Function:
        def is_a(self, kind: str) -> bool:
            return kind == "MXFunction"

        def expand(self) -> Any:
            raise RuntimeError("Error in MXFunction\n  at somewhere:\nno SX for this node\n\n")

    function: Any = Function()
    with pytest.raises(BuildError) as refused:
        routines.expand("f", function)
    given, expected = str(refused.value).split(", ")
    assert given == "function f: given one that cannot be written as scalar operations"
    assert expected == "expected an SX function: no SX for this node"
    scalar: Any = Made(is_a=lambda kind: kind == "SXFunction")
    assert routines.expand("f", scalar) is scalar


@pytest.mark.parametrize(
    "sizes", [(1.0, 2.0, 4.0), (0.1, 0.1, 0.5), (1.0, 1.0, 2.0), (3.0, 3.0, 3.0)]
)
def test_the_least_share_makes_a_tensor_that_a_body_can_have(
    sizes: tuple[float, float, float],
) -> None:
    """No moment is larger than the sum of the others: of moments about two axes it is half of what
    is missing.
    """
    turned = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    inertia = turned @ np.diag(sizes) @ turned.T
    free = turned @ np.diag([1.0, 1.0, 0.0]) @ turned.T
    expected = max(sizes[2] - sizes[0] - sizes[1], 0.0) / 2
    found = _find_least(inertia, free)
    assert (
        found is not None
        and expected <= found + 1e-15
        and found == pytest.approx(expected, abs=1e-8)
    )
    assert _find_least(np.diag([1.0, 2.0, 4.0]), np.zeros((3, 3))) is None
    moments, axes = principal(inertia)
    assert_allclose(axes @ np.diag(moments) @ axes.T, inertia, atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1.0)
