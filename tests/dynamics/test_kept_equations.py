"""Equations that are kept between calls are those that would be derived: another model, law or
thread has its own.
"""

from __future__ import annotations

import dataclasses
import threading

import numpy as np

import flexgen
from flexgen.codegen.recursion.functions import fast_function
from flexgen.dynamics.mechanics.equations import BUILDERS, KEPT, Equations, kept_equations
from flexgen.dynamics.mechanics.signatures import offered_functions
from flexgen.model.friction import Friction


def test_one_model_has_one_object_and_another_its_own():
    robot = flexgen.read("elbow")
    kept = kept_equations(robot)
    assert kept_equations(flexgen.read("elbow")) is kept
    for changed in (
        dataclasses.replace(robot, gravity=(0.0, 0.0, -9.0)),
        # equal, but with another sign
        dataclasses.replace(robot, gravity=tuple(x or -0.0 for x in robot.gravity)),
    ):
        assert kept_equations(changed) is not kept
        assert kept_equations(changed).model.gravity == changed.gravity
    assert kept_equations(robot) is kept


def test_what_a_model_keeps_of_itself_makes_no_other_model():
    fresh = dataclasses.replace(flexgen.read("elbow"))
    used = dataclasses.replace(fresh)
    assert used.coordinates and used.i_g and used.parents
    assert vars(used) != vars(fresh)
    assert kept_equations(used) is kept_equations(fresh)


def test_the_last_models_are_kept():
    robots = [
        dataclasses.replace(flexgen.read("elbow"), gravity=(0.0, 0.0, -float(g)))
        for g in range(KEPT + 1)
    ]
    first = [kept_equations(robot) for robot in robots]
    assert kept_equations(robots[-1]) is first[-1] and kept_equations(robots[0]) is not first[0]


def test_another_thread_has_its_own():
    robot = flexgen.read("elbow")
    found = []
    kept = kept_equations(robot)
    for _ in range(2):
        thread = threading.Thread(target=lambda: found.append(kept_equations(robot)))
        thread.start()
        thread.join()
    assert len({id(kept), *map(id, found)}) == 3


@dataclasses.dataclass(frozen=True)
class Drag(Friction):
    """A law of another package, as one may write it again in a notebook."""

    def torque(self, w):
        return self.viscous * w


def test_laws_of_other_packages_are_derived_again():
    robot = flexgen.read("elbow")
    motors = (dataclasses.replace(robot.motors[0], friction=Drag(viscous=0.1)), *robot.motors[1:])
    changed = dataclasses.replace(robot, motors=motors)
    assert kept_equations(changed) is not kept_equations(changed)


def test_functions_do_not_depend_on_those_that_were_built_before():
    robot = flexgen.read("elbow")
    names = [function for function in BUILDERS if function in offered_functions(robot)]
    used = kept_equations(robot)
    for function in reversed(names):
        fast_function(used, function)
    for function in names[::3]:
        new = Equations(robot)
        assert used.function(function).serialize() == new.function(function).serialize()
        fast = fast_function(used, function)
        other = fast_function(new, function)
        assert (fast is None and other is None) or fast.serialize() == other.serialize()


def test_a_second_solution_has_the_bits_of_the_first():
    first, second = (
        flexgen.solve("elbow", verify=False, progress=False).trajectory for _ in range(2)
    )
    assert all(np.array_equal(first[name], second[name]) for name in first.channels)
