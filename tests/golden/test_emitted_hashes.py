"""Every emitted file of six models, and each manifest, are those that ``tests/golden/emitted.txt``
records,
to nine digits of their numbers.
Of `flexgen.codegen.recursion.arm`, `flexgen.codegen.recursion.articulated_body`,
`flexgen.codegen.recursion.column_functions`, `flexgen.codegen.recursion.columns`,
`flexgen.codegen.recursion.composite_body`, `flexgen.codegen.recursion.derivatives`,
`flexgen.codegen.recursion.dh_chain`, `flexgen.codegen.recursion.functions`,
`flexgen.codegen.recursion.inversion_functions`, `flexgen.codegen.recursion.kinematics`,
`flexgen.codegen.recursion.newton_euler`, `flexgen.codegen.recursion.regrouping`,
`flexgen.codegen.recursion.tape`, `flexgen.codegen.statements.column_loops`,
`flexgen.codegen.statements.evaluation`, `flexgen.codegen.statements.function_text`,
`flexgen.codegen.statements.graph`, `flexgen.codegen.statements.layout`,
`flexgen.codegen.statements.literals`, `flexgen.codegen.statements.pivot_guards`,
`flexgen.codegen.statements.routine`, `flexgen.codegen.statements.schedule`,
`flexgen.codegen.statements.simplify`, `flexgen.codegen.statements.solve_loops`,
`flexgen.codegen.statements.step_text`, `flexgen.codegen.emission.amalgamation`,
`flexgen.codegen.emission.c_functions`, `flexgen.codegen.emission.c_text`,
`flexgen.codegen.emission.clib_files`, `flexgen.codegen.emission.clib_types`,
`flexgen.codegen.emission.digest`, `flexgen.codegen.emission.emit`,
`flexgen.codegen.emission.example`, `flexgen.codegen.emission.function_files`,
`flexgen.codegen.emission.header`, `flexgen.codegen.emission.interface`,
`flexgen.codegen.emission.kinematic_functions`, `flexgen.codegen.emission.kinematics_header`,
`flexgen.codegen.emission.limited_functions`, `flexgen.codegen.emission.motor_constants`,
`flexgen.codegen.emission.path_header`, `flexgen.codegen.emission.routines`,
`flexgen.codegen.emission.sampler_functions`, `flexgen.codegen.emission.spec`,
`flexgen.codegen.emission.stream_bounds`, `flexgen.dynamics.mechanics.signatures`,
`flexgen.dynamics.mechanics.dynamics`, `flexgen.codegen.build.generate`,
`flexgen.codegen.build.directory`.
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
