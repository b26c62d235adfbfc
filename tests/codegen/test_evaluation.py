"""Routines in NumPy: solutions of linear systems go to the blocks of their ports."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from flexgen.codegen.statements.evaluation import evaluate_routine
from flexgen.codegen.statements.routine import Block, Routine, Solve, Zeros


def test_solutions_of_a_routine_go_to_the_blocks_of_their_ports() -> None:
    A = np.array([[4.0, 1.0], [1.0, 3.0]])
    R = np.arange(6.0).reshape(2, 3)
    blocks = (Block("a", 0, 0, 2), Block("a", 2, 2, 1), Block("b", 1, 3, 2))
    solve = Solve("A", "R", 2, 3, True, (0, 0), blocks, ones=(("b", 0, 1), ("a", 5, 0)))
    found = evaluate_routine(Routine((Zeros("z", 2, 3), solve)), {"A": np.triu(A), "R": R})
    X = -np.linalg.solve(A, np.hstack([R, -np.eye(2)]))
    expected = np.zeros((6, 3))
    expected[:2, :2] = X[:, :2]
    expected[2:4, 2:] = X[:, 2:3]
    expected[5, 0] = 1.0
    assert_allclose(found["a"], expected)
    assert_allclose(found["b"], [[0.0, 1.0], *X[:, 3:]])
    assert found["z"].shape == (2, 3) and not found["z"].any()
    assert solve.ports == ("a", "b") and solve.width == 5
