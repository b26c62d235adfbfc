"""Random trees: the random robots with the elements hung on each other, and the tool on one of
them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st
from mujoco_referee import MujocoReferee
from random_robots import POSED, POSES, Case, body, is_linear, robots, state

from flexgen.model.elements import RobotModel, Tool


@st.composite
def trees(draw: st.DrawFn) -> Case:
    """A robot with branches, and three states in which no coordinate moves without inertia."""
    model = draw(robots())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    model = hang(model, rng)
    assume(model.branched)
    states = tuple(state(model, rng, pose) for pose in POSES)
    judge = MujocoReferee(model, rotors=False)
    for q_a in (np.zeros(model.n_a), *(s.q_a for s in states)):
        M = judge.mass_matrix(q_a)
        size = np.sqrt(np.abs(np.diag(M)))
        assume(size.all() and np.linalg.eigvalsh(M / np.outer(size, size))[0] >= POSED)
    return Case(model, states, is_linear(model))


def hang(model: RobotModel, rng: np.random.Generator) -> RobotModel:
    """The robot with each element on any of those before it, with bodies at the ends, and the tool
    on a moving one.
    """
    names = ["base", *(element.name for element in model.elements)]
    parents = [names[rng.integers(max(0, k - 2), k + 1)] for k in range(len(model.elements))]
    moved = {"base": False}
    elements = []
    for element, parent in zip(model.elements, parents, strict=True):
        moved[element.name] = bool(element.dofs) or moved[parent]
        own = body(rng, "full") if element.name not in parents else element.body
        given = parent if rng.integers(2) or parent != names[len(elements)] else None
        elements.append(replace(element, parent=given, body=own))
    carrier = str(rng.choice([name for name, moves in moved.items() if moves]))
    tool = Tool(model.tool.position, model.tool.rotation, carrier)
    return replace(model, elements=tuple(elements), tool=tool)
