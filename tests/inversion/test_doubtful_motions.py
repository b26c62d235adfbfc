"""Motions of the reduced problem are doubtful where its rows are nearly singular."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from flexgen.inversion.problem.reduced_problem import Reduction


@pytest.mark.parametrize(
    ("gaps", "solved", "doubtful"),
    [
        # the ratio of the singular values of ((1, 1), (1, 1 + g)) is g/4
        ((2e-9, 1.0), False, True),
        ((8e-9, 1.0), True, True),
        ((2e-5, 1.0), True, True),
        ((8e-5, 1.0), True, False),
        ((1.0, -1.0), True, True),  # singular between the two
    ],
)
def test_a_motion_is_doubtful_where_its_rows_are_nearly_singular(
    gaps: tuple[float, float], solved: bool, doubtful: bool
) -> None:
    """Rows of any size; the accelerations and their derivatives are solutions of the rows."""
    sizes = np.array([[[30.0], [2e-3]]])
    G = sizes * np.array([[[1.0, 1.0], [1.0, 1.0 + g]] for g in gaps])
    zeros = {f"{name}{k}": np.full((2, 1), 0.1 * k) for name in ("rate", "row") for k in range(5)}
    made: Any = object.__new__(Reduction)
    vars(made).update(model=Made(n_a=2), n_y=1, i_e=(1,))
    vars(made).update(_at=lambda chain: {"G": G.reshape(2, 4), "W": np.ones((2, 2)), **zeros})
    vars(made).update(
        _picking=lambda W: np.broadcast_to(np.diag([2.0, 1.0]), (2, 2, 2)),
        _motion=lambda chain: chain,
    )
    sample: Any = Made(derivative=lambda k: np.full((2, 1), float(k)))
    q = np.array([[0.1, 0.2], [0.3, 0.4]])
    v_e = np.array([[0.5], [0.6]])
    found, seen = made.motion(sample, q, v_e)
    assert (found is not None, seen) == (solved, doubtful)
    if solved:
        assert found[0] is q
        assert_allclose(found[1], [[0.5, 0.5], [0.5, 0.6]])
        for k in (2, 3, 4):
            right = np.array([k - 0.1 * k, -0.1 * (k - 2)])
            assert_allclose(
                np.einsum("kij,kj->ki", G, found[k]), np.tile(right, (2, 1)), rtol=1e-4, atol=1e-9
            )
