"""Every emitted file of six models, and each manifest, are those that ``tests/golden/emitted.txt``
records,
to nine digits of their numbers.
Of `flexgen.recursion.arm`, `flexgen.recursion.articulated_body`,
`flexgen.recursion.column_functions`, `flexgen.recursion.columns`,
`flexgen.recursion.composite_body`, `flexgen.recursion.derivatives`, `flexgen.recursion.dh_chain`,
`flexgen.recursion.functions`, `flexgen.recursion.inversion_functions`,
`flexgen.recursion.kinematics`, `flexgen.recursion.newton_euler`, `flexgen.recursion.regrouping`,
`flexgen.recursion.tape`, `flexgen.expressions.column_loops`, `flexgen.expressions.evaluation`,
`flexgen.expressions.function_text`, `flexgen.expressions.graph`, `flexgen.expressions.layout`,
`flexgen.expressions.literals`, `flexgen.expressions.pivot_guards`, `flexgen.expressions.routine`,
`flexgen.expressions.schedule`, `flexgen.expressions.simplify`, `flexgen.expressions.solve_loops`,
`flexgen.expressions.step_text`, `flexgen.codegen.amalgamation`, `flexgen.codegen.c_functions`,
`flexgen.codegen.c_text`, `flexgen.codegen.clib_files`, `flexgen.codegen.clib_types`,
`flexgen.codegen.digest`, `flexgen.codegen.emit`, `flexgen.codegen.example`,
`flexgen.codegen.function_files`, `flexgen.codegen.header`, `flexgen.codegen.interface`,
`flexgen.codegen.kinematic_functions`, `flexgen.codegen.kinematics_header`,
`flexgen.codegen.limited_functions`, `flexgen.codegen.motor_constants`,
`flexgen.codegen.path_header`, `flexgen.codegen.routines`, `flexgen.codegen.sampler_functions`,
`flexgen.codegen.spec`, `flexgen.codegen.stream_bounds`, `flexgen.mechanics.signatures`,
`flexgen.mechanics.dynamics`, `flexgen.library.generate`, `flexgen.library.directory`.
"""

from __future__ import annotations

from importlib.metadata import version

import pytest
from emitted_hashes import CHOICES, GOLDEN_CASADI, hashes, read


def changes(golden: dict[str, str], today: dict[str, str]) -> list[str]:
    """Files that are in one of the two only, or differ."""
    return sorted(
        file for file in golden.keys() | today.keys() if golden.get(file) != today.get(file)
    )


def recorded(*models: str) -> list[str]:
    """Files of these models that differ from the record."""
    if not version("casadi").startswith(f"{GOLDEN_CASADI}."):
        pytest.skip(
            f"recorded with CasADi {GOLDEN_CASADI}; run: pip install 'casadi~={GOLDEN_CASADI}.0'"
        )
    return [
        f"{model} {file}" for model in models for file in changes(read()[model], hashes(model))
    ]


SMALL = ("elbow", "planar5_nmp", "four_mass", "beam_arm", "abb_arm")


def test_emitted_files_of_small_robots_have_the_recorded_hashes():
    """``make golden`` records them anew; the commit says which lines of which files change, and
    why.
    """
    assert recorded(*SMALL) == [], "run: make golden"


def test_emitted_files_of_a_robot_with_six_joints_have_the_recorded_hashes():
    assert recorded(*sorted(set(CHOICES) - set(SMALL))) == [], "run: make golden"


def test_a_changed_a_new_and_a_missing_file_are_found():
    assert changes({"a.c": "1", "b.c": "2", "c.c": "3"}, {"a.c": "1", "b.c": "5", "d.c": "3"}) == [
        "b.c",
        "c.c",
        "d.c",
    ]
