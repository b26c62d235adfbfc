"""Pryce's structural analysis: offsets, index, degrees of freedom, blocks, and where the structure
is misleading.
"""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from planar_family import planar_arm

import flexgen
from flexgen.dynamics.dae.block_form import block_form
from flexgen.dynamics.dae.signature import ABSENT
from flexgen.dynamics.dae.strangeness_index import kunkel_mehrmann_at_rest, rule
from flexgen.dynamics.dae.structure import (
    Structure,
    check_at_rest,
    check_structure,
    smallest_ratio,
    structure,
    system_jacobian,
    to_dict,
)
from flexgen.dynamics.dae.system import InverseDae
from flexgen.dynamics.dae.taylor_array import TaylorArray, consistent
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.statics import hold_joints
from flexgen.model.reader import model_names, read
from flexgen.paths.path import Path

FLAT = ("abb_arm", "manutec_r3_efjm", "planar5_family")  # the inertia A is singular there


def at_home(name: str):
    equations = flexgen.derive(name)
    return check_at_rest(equations, hold_joints(equations, np.array(equations.model.home)))


# --- what the theory says ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("variant", "index", "dof", "c", "d"),
    [
        ("", 4, 4, (1, 1, 1, 0, 0, 3, 3), (3, 3, 3, 2, 2, 0, 0)),
        ("@undamped", 5, 2, (2, 2, 2, 0, 0, 4, 4), (4, 4, 4, 2, 2, 0, 0)),
    ],
    ids=["damped", "undamped"],
)
def test_the_table_of_the_planar_arm(
    variant: str, index: int, dof: int, c: tuple[int, ...], d: tuple[int, ...]
) -> None:
    found, check = at_home("planar5_nmp" + variant)
    assert (found.index, found.dof, found.c, found.d) == (index, dof, c, d)
    assert check.holds
    assert check.verdict == f"structure holds: index {index}, {dof} degrees of freedom"
    named = [found.name_block(block) for block in found.form.blocks]
    assert named[0] == {
        "equations": ["motion q3", "tool x", "tool y"],
        "unknowns": ["q1", "q2", "q3"],
    }
    assert named[1:] == [
        {"equations": ["motion q1"], "unknowns": ["m1"]},
        {"equations": ["motion q2"], "unknowns": ["m2"]},
        {"equations": ["motion m1"], "unknowns": ["torque m1"]},
        {"equations": ["motion m2"], "unknowns": ["torque m2"]},
    ]


@pytest.mark.parametrize("name", model_names())
def test_structure_agrees_with_the_numbers_or_is_marked_as_wrong(name: str) -> None:
    """Index and degrees of freedom against the general rule, and the verdict against Kunkel and
    Mehrmann's numbers.
    """
    equations = flexgen.derive(name)
    rest = hold_joints(equations, np.array(equations.model.home))
    found, check = check_at_rest(equations, rest)
    expected = rule(equations)
    assert expected is not None
    assert (found.index, found.dof) == (expected[0] + 1, expected[2])
    numeric = kunkel_mehrmann_at_rest(equations, rest)
    agree = (numeric.differential_index, numeric.d) == (found.index, found.dof)
    assert check.holds == agree == (name not in FLAT)
    assert ("structure misleading" in check.verdict) == (name in FLAT)


def test_the_verdict_along_a_path() -> None:
    equations = flexgen.derive("planar5_soft")
    series = TaylorArray(InverseDae(equations))
    path = Path(equations, equations.model.move())
    x, _ = consistent(series, path, np.array([0.2, 0.5, 0.8]) * path.duration, 1)
    for point in x:
        assert check_structure(series, structure(equations), point[:2]).holds


@pytest.mark.parametrize(("distance", "holds"), [(0.0, False), (1e-3, True), (-1e-3, True)])
def test_the_structural_index_is_wrong_at_the_flat_point(distance: float, holds: bool) -> None:
    equations = Equations(planar_arm(np.random.default_rng(3), distance).model)
    found, check = check_at_rest(equations, hold_joints(equations, np.array(equations.model.home)))
    assert (found.index, found.dof) == (4, 4)
    assert check.holds == holds
    if not holds:
        assert "the block of q1, q2, q3" in check.verdict
        assert "index 4 is not the true one here" in check.verdict


def test_sigma_min_falls_with_the_distance_from_the_flat_point() -> None:
    found = []
    for distance in (1e-2, 1e-4, 1e-6):
        equations = Equations(planar_arm(np.random.default_rng(3), distance).model)
        check = check_at_rest(equations, hold_joints(equations, np.array(equations.model.home)))[1]
        assert check.sigma_min is not None
        found.append(check.sigma_min)
    assert found[0] / found[1] == pytest.approx(100, rel=0.1)
    assert found[1] / found[2] == pytest.approx(100, rel=0.1)


def test_complete_coupling_has_another_structure() -> None:
    model = read("planar5_nmp")
    motors = tuple(
        replace(motor, axis=(0.0, 0.0, 1.0), carrier=carrier)
        for motor, carrier in zip(model.motors, ("base", "arm1"), strict=True)
    )
    equations = Equations(replace(model, motors=motors, motor_coupling="complete"))
    found, check = check_at_rest(equations, hold_joints(equations, np.array(model.home)))
    numeric = kunkel_mehrmann_at_rest(equations)
    assert rule(equations) is None
    assert numeric.verdict == "regular"
    assert check.holds == ((numeric.differential_index, numeric.d) == (found.index, found.dof))


def test_not_square() -> None:
    model = read("planar5_mp", overrides={"output.axes": "x"})
    equations = Equations(model)
    found, check = check_at_rest(equations, hold_joints(equations, np.array(model.home)))
    assert (found.index, found.dof, found.c, check.holds) == (None, None, (), None)
    assert check.verdict.startswith("structurally singular: too few equations")
    assert json.loads(json.dumps(to_dict(found, check)))["blocks"] == []


def test_an_output_that_no_motor_moves() -> None:
    """Two outputs on one coordinate: square, but no transversal."""
    model = read("planar5_mp")
    rows = ((1.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    output = replace(model.output, type="combination", weights=rows, axes="")
    equations = Equations(replace(model, output=output))
    found, check = check_at_rest(equations, hold_joints(equations, np.array(model.home)))
    assert found.index is None
    assert "too many equations (output 1, output 2) for q1" in check.verdict
    assert "too few equations" in check.verdict


# --- oracles -------------------------------------------------------------------------------------


def offsets_hold(found: Structure) -> bool:
    """Pryce's conditions: d_j - c_i >= sigma_ij, equality on a transversal, c >= 0 with a zero."""
    gap = np.array(found.d)[None, :] - np.array(found.c)[:, None] - found.sigma
    pattern = block_form(gap == 0)
    return bool(
        (gap >= 0).all()
        and not any(pattern.surplus + pattern.deficit)
        and min(found.c) == 0
        and len(found.c) == len(found.d)
    )


@pytest.mark.parametrize(
    "name", ["planar5_nmp@undamped", "kr300", "manutec_r3_efjm", "beam_arm", "urdf_arm"]
)
def test_offsets_satisfy_the_conditions(name: str) -> None:
    found = structure(flexgen.derive(name))
    assert offsets_hold(found)
    for k in range(len(found.c)):  # the smallest ones: none can be lowered alone
        if found.c[k] > 0:
            lower = tuple(c - (i == k) for i, c in enumerate(found.c))
            assert not offsets_hold(replace(found, c=lower))
    assert not offsets_hold(replace(found, d=(found.d[0] - 1, *found.d[1:])))  # planted bug


def test_degrees_of_freedom_by_enumeration() -> None:
    """The largest sum over all transversals of a small signature is sum d - sum c."""
    found = structure(flexgen.derive("planar5_nmp"))
    n = len(found.sigma)
    sums = [sum(int(found.sigma[i, p[i]]) for i in range(n)) for p in permutations(range(n))]
    assert max(sums) == found.dof
    assert max(sums) > ABSENT / 2


def test_the_system_jacobian_is_the_derivative_of_differentiated_equations() -> None:
    """Block of the planar arm by hand: rows W, and M of the passive row, up to the scaling of rows
    and columns.
    """
    equations = flexgen.derive("planar5_nmp")
    found = structure(equations)
    analysis = flexgen.analyze(equations)
    dae = InverseDae(equations)
    series = TaylorArray(dae)
    J = system_jacobian(
        series, found, np.stack([dae.pack(analysis.equilibrium), np.zeros(dae.n_x)])
    )
    by_hand = np.vstack([analysis.linear.M[2, :3], analysis.linear.W[:, :3]])
    scales = series.scales(dae.pack(analysis.equilibrium))
    rows = np.concatenate(
        [scales.rows[dae.dynamic[2:3]] / scales.time**2, scales.rows[dae.output]]
    )
    block = by_hand * rows[:, None] * scales.x[:3]
    assert np.allclose(J[[2, 5, 6]][:, :3], block, rtol=1e-13, atol=1e-15)
    assert J[2, 5] == 0
    assert np.linalg.matrix_rank(J) == len(J)


def test_blocks_of_a_random_triangular_pattern() -> None:
    rng = np.random.default_rng(11)
    sizes = [3, 1, 2, 4, 1]
    ends = np.cumsum(sizes)
    pattern = np.zeros((11, 11), dtype=bool)
    for end, size in zip(ends, sizes, strict=True):
        ring = np.arange(end - size, end)
        pattern[ring, ring] = True
        pattern[ring, np.roll(ring, 1)] = True  # a ring holds the block together
        pattern[ring[0], : end - size] |= rng.uniform(size=end - size) < 0.4
    rows = rng.permutation(11)
    columns = rng.permutation(11)
    form = block_form(pattern[np.ix_(rows, columns)])
    assert not any(form.surplus + form.deficit)
    assert sorted(len(block[0]) for block in form.blocks) == sorted(sizes)
    solved: set[int] = set()
    for block_rows, block_columns in form.blocks:
        needs = {int(j) for i in block_rows for j in np.flatnonzero(pattern[rows[i]][columns])}
        assert needs <= solved | set(block_columns)  # each block can be solved when its turn comes
        solved |= set(block_columns)
    assert len(solved) == 11


def test_parts_of_a_singular_pattern() -> None:
    pattern = np.zeros((5, 5), dtype=bool)
    pattern[0, 0] = pattern[1, 0] = True  # two rows for one column
    pattern[2, [1, 2]] = True  # one row for two columns
    pattern[3, [3, 0]] = pattern[4, [4, 3]] = True
    form = block_form(pattern)
    assert form.surplus == ((0, 1), (0,))
    assert form.deficit == ((2,), (1, 2))
    assert form.blocks == (((3,), (3,)), ((4,), (4,)))
    assert any(form.surplus + form.deficit)
    empty = block_form(np.zeros((2, 2), dtype=bool))
    assert (empty.surplus, empty.deficit, empty.blocks) == (((0, 1), ()), ((), (0, 1)), ())


def test_the_ratio_of_a_block_does_not_depend_on_units() -> None:
    rng = np.random.default_rng(2)
    A = rng.normal(size=(4, 4))
    units = [10.0 ** rng.uniform(-6, 6, 4) for _ in range(2)]
    assert smallest_ratio(A * units[0][:, None] * units[1]) == pytest.approx(
        smallest_ratio(A), rel=1e-2
    )  # scaling ends early
    A[3] = A[0] + A[1]
    assert smallest_ratio(A * units[0][:, None] * units[1]) < 1e-10
    assert smallest_ratio(np.zeros((1, 1))) == 0.0
