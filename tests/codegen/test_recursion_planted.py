"""Errors planted in the fast path: the checks against the Lagrangian see them, and so does the
test before use.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from recursion_cases import (
    FUNCTIONS,
    arguments,
    check,
    check_tilted,
    dense_chain,
    equations_of,
    some_states,
    tilted_axes,
)

from flexgen.codegen.recursion import derivatives, newton_euler
from flexgen.codegen.recursion import dh_chain as chain_room
from flexgen.codegen.recursion.functions import fast_function, recursive_function
from flexgen.codegen.recursion.regrouping import plans
from flexgen.dynamics.mechanics.equations import derive


@pytest.fixture
def planted(monkeypatch):
    """To plant an error: plans made with it are forgotten afterwards."""
    plans.cache_clear()
    yield monkeypatch
    monkeypatch.undo()
    plans.cache_clear()


@pytest.mark.parametrize("tilt", [1e-7, 1e-11, np.pi - 1e-9])
def test_frames_far_away_are_seen(planted, tilt):
    """The planted error: frames at the normal of axes however far that is."""
    planted.setattr(chain_room, "NEARLY_PARALLEL", 0.0)
    with pytest.raises(AssertionError):
        check_tilted(tilt)


def wrong_sign_in_the_regrouping(monkeypatch):
    monkeypatch.setattr(chain_room.Inertia, "scaled", lambda self, factor: self)


def regrouped_mass_is_lost(monkeypatch):
    moved = chain_room.Inertia.moved
    monkeypatch.setattr(
        chain_room.Inertia, "moved", lambda self, pose: replace(moved(self, pose), mass=0.0)
    )


def wrong_sign_of_a_frames_angle(monkeypatch):
    split = chain_room._split_rotation
    monkeypatch.setattr(
        chain_room, "_split_rotation", lambda rotation: (-split(rotation)[0], *split(rotation)[1:])
    )


def missing_coriolis_term(monkeypatch):
    entry = newton_euler.Motion.U

    def wrong(self, i, k):
        return self.dw[2] if (i, k) == (1, 0) else entry(self, i, k)

    monkeypatch.setattr(newton_euler.Motion, "U", wrong)


def missing_momentum_of_changes(monkeypatch):
    monkeypatch.setattr(derivatives, "_add_momentum", lambda beyond, w, s, S: beyond)


@pytest.mark.parametrize(
    ("bug", "name"),
    [
        (wrong_sign_in_the_regrouping, "inverse_dynamics"),
        (regrouped_mass_is_lost, "mass_matrix"),
        (wrong_sign_of_a_frames_angle, "inverse_dynamics"),
        (wrong_sign_of_a_frames_angle, "forward_kinematics"),
        (missing_coriolis_term, "bias"),
        (missing_coriolis_term, "forward_dynamics"),
        (missing_momentum_of_changes, "inverse_dynamics_derivatives"),
    ],
)
def test_planted_errors_are_seen(planted, bug, name):
    # more coordinates than what is differentiated: the recursion for derivatives is asked
    equations = equations_of("dense12")
    given = arguments(some_states(equations.model, 1)[0], np.random.default_rng(4))
    check(equations, name, given)
    plans.cache_clear()
    bug(planted)
    with pytest.raises(AssertionError):
        check(derive(equations.model), name, given)


def frames_far_away(monkeypatch):
    monkeypatch.setattr(chain_room, "NEARLY_PARALLEL", 0.0)


@pytest.mark.parametrize(
    ("bug", "model"),
    [
        (frames_far_away, tilted_axes(1e-11)),
        (wrong_sign_in_the_regrouping, dense_chain(4, 1)),
        (regrouped_mass_is_lost, dense_chain(4, 1)),
        (wrong_sign_of_a_frames_angle, dense_chain(4, 1)),
    ],
)
@pytest.mark.slow
def test_robots_that_fail_before_use_have_no_fast_path(planted, bug, model):
    equations = derive(model)
    assert all(fast_function(equations, name) is not None for name in FUNCTIONS)
    plans.cache_clear()
    bug(planted)
    equations = derive(model)
    assert recursive_function(equations, "inverse_dynamics") is not None
    assert all(fast_function(equations, name) is None for name in FUNCTIONS)
