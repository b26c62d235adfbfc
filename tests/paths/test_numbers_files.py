"""Numbers of the rooms runtime, spec, model, expressions, inverse_kinematics and loop: made files,
cases by hand.
"""

from __future__ import annotations

import math
import struct
import sys
from dataclasses import replace
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec import keys, number_edit, tables, toml_lines
from flexgen.codegen.statements import routine
from flexgen.codegen.statements.column_loops import _total
from flexgen.dynamics.mechanics import statics
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.output_columns import (
    columns_in,
    output_labels,
    output_units,
    unit_of,
)
from flexgen.feedback.loop.closed_loop import ClosedLoop
from flexgen.model.elements import (
    Beam,
    Bending,
    Body,
    Dof,
    Element,
    Output,
    Placement,
    coordinates_of,
)
from flexgen.model.format import format_robot
from flexgen.model.urdf import overlay, urdf
from flexgen.paths.inverse_kinematics import search
from flexgen.paths.inverse_kinematics.search import _Solver
from flexgen.runtime import files

# --- shared libraries in ELF ---------------------------------------------------------------------

wide_little = pytest.mark.skipif(
    sys.maxsize <= 2**32 or sys.byteorder != "little", reason="made for 64 bits"
)


def elf(segments: Any = ((1, 0, 64, 64),), **changes: Any) -> bytes:
    """A header of 64 bytes, then segments (kind, start, size, memory) of 56 bytes each, of the
    running processor.
    """
    given = {
        "magic": b"\x7fELF\x02\x01",
        "kind": 3,
        "machine": files._machine("<", 62),
        "table": 64,
        "size": 56,
        "count": len(segments),
    }
    given |= changes
    head = given["magic"].ljust(16, b"\0") + struct.pack(
        "<HHIQQQIHHHHHH",
        given["kind"],
        given["machine"],
        1,
        0,
        given["table"],
        0,
        0,
        64,
        given["size"],
        given["count"],
        0,
        0,
        0,
    )
    return head + b"".join(
        struct.pack("<IIQQQQQQ", kind, 5, start, 0, 0, size, memory, 8)
        for kind, start, size, memory in segments
    )


@wide_little
@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (elf(), None),
        (elf(((6, 64, 56, 0), (1, 100, 76, 76))), None),
        (elf()[:63], "no shared library (its ELF header is missing or cut)"),
        (elf(magic=b"\x7fELG\x02\x01"), "no shared library (its ELF header is missing or cut)"),
        (
            elf(magic=b"\x7fELF\x01\x01"),
            "a library of other addresses or byte order, expected 64 bits, little-endian",
        ),
        (
            elf(magic=b"\x7fELF\x02\x02"),
            "a library of other addresses or byte order, expected 64 bits, little-endian",
        ),
        (elf(kind=2), "an ELF file of kind 2, expected a shared library"),
        (elf(machine=7), "a library for another processor (ELF machine 7), expected "),
        (elf(size=55), "a cut or garbled library (its table of segments)"),
        (elf(table=65), "a cut or garbled library (its table of segments)"),
        (elf(count=0), "a cut or garbled library (its table of segments)"),
        (elf(count=0xFFFF), "a cut or garbled library (its table of segments)"),
        (elf(((1, 0, 120, 120),)), None),
        (elf(((1, 1, 120, 120),)), "a cut or garbled library (segment 0 ends at byte 121 of 120)"),
        (
            elf(((1, 0, 10, 10), (1, 0, 20, 19))),
            "a cut or garbled library (segment 1 ends at byte 20 of 176)",
        ),
        (elf(((6, 0, 64, 63),)), "a garbled library (nothing in it is to be loaded)"),
    ],
)
def test_a_library_is_mapped_only_if_its_segments_are_whole(
    content: bytes, problem: str | None
) -> None:
    found = files._elf_problem(content)
    assert found == problem or (
        problem is not None and problem.endswith("expected ") and str(found).startswith(problem)
    )


# --- texts of models -----------------------------------------------------------------------------


def table(text: str) -> tables.Table:
    return tables.Table("x.toml", toml_lines.parse(text), "")


def test_values_are_shown_as_in_a_model_file() -> None:
    shown = tables.show({"a b": [1, 2.5, True], "c": 'say "é"\n', "d": {"e": False}}, 200)
    assert shown == '{"a b" = [1, 2.5, true], c = "say \\"\\xe9\\"\\n", d = {e = false}}'
    assert (
        tables.show("x" * 78) == '"' + "x" * 78 + '"'
        and tables.show("x" * 79) == '"' + "x" * 76 + "..."
    )
    assert tables.show(10**5000) == "a huge number"
    assert tables.bare("a-b_1[0]") == "a-b_1[0]" and tables.bare("a b") == '"a b"'
    assert tables.closest("mas", ["mass", "com"]) == "mass (there are: com, mass)"
    assert (
        tables.closest("zzz", ["mass", "com"]) == "one of com, mass"
        and tables.closest("a", []) == "no key"
    )


@pytest.mark.parametrize(
    ("text", "call", "told"),
    [
        (
            "v = [1, 2]",
            lambda t: t.vector("v", 3),
            r"x.toml:1:v: given \[1, 2\], expected a list of 3 numbers",
        ),
        ("v = [1, 2]", lambda t: t.vector("v", [1, 3]), "expected a list of 1 or 3 numbers"),
        (
            "v = [1, 2]",
            lambda t: t.vector("v", range(3, 6), what="each"),
            r"expected a list of 3 to 5 numbers \(each\)",
        ),
        ("v = 5", lambda t: t.vector("v", 1), "given 5, expected a list of 1 number$"),
        (
            'v = [1,\n"a"]',
            lambda t: t.vector("v", 2),
            r"x.toml:2:v: given \[1, \"a\"\], expected a list of 2 numbers",
        ),
        ("v = [0, 0, 0]", lambda t: t.axis("v"), "expected a direction that is not zero"),
        (
            "a_rad = 1\na_deg = 2",
            lambda t: t.angle("a"),
            "x.toml:2:a_deg: given both a_rad and a_deg, expected one of",
        ),
        ("", lambda t: t.angles("a", [True]), "a_rad or a_deg"),
        (
            'c = "lin"',
            lambda t: t.choice("c", ("line", "arc")),
            r"given \"lin\", expected line \(there are: arc, line\)",
        ),
        ("c = 3", lambda t: t.choice("c", ("line", "arc")), "given 3, expected one of arc, line"),
        ('c = "a\\u0007"', lambda t: t.text("c"), "expected text without control characters"),
        ("f = 1", lambda t: t.flag("f"), "given 1, expected true or false"),
    ],
)
def test_wrong_values_of_tables_are_named_with_line_and_expectation(
    text: str, call: Any, told: str
) -> None:
    with pytest.raises(ModelError, match=told):
        call(table(text))


def test_values_of_tables_and_their_defaults() -> None:
    t = table('v = [3, 4, 0]\na_deg = 180\nb_rad = 2\nc = "line"\nq_deg = [90, 5]')
    assert (
        t.vector("v", 3) == (3.0, 4.0, 0.0)
        and t.vector("w", 3, default=(1,)) == (1,)
        and t.axis("v") == (0.6, 0.8, 0.0)
    )
    assert t.vector("v", 3, default=(1,)) == (3.0, 4.0, 0.0)
    assert t.angle("a") == math.pi and t.angle("b") == 2.0 and t.angle("none") is None
    assert t.angles("q", [True, False]) == (math.pi / 2, 5.0)
    assert (
        t.choice("c", ("line", "arc"), default="arc") == "line"
        and t.choice("d", ("line", "arc"), default="arc") == "arc"
    )
    assert (
        t.unit_key("none", required=False) is None
        and "v" in t
        and "w" not in t
        and t.path(None) == ""
    )
    where = tables.Where("f", 7, "joint[0]", (("lower_deg", 9), ("axis", 8)))
    assert [where.find(x) for x in ("lower", "axis", "upper")] == [
        ("joint[0].lower_deg", 9),
        ("joint[0].axis", 8),
        ("joint[0].upper", 7),
    ]


def test_lines_of_entries_and_the_longest_line() -> None:
    root = toml_lines.parse(
        "a = 1\n[x.y]\nb = [1,\n2]\n[[m]]\nc = 1\n[[m]]\nd = 2\n[m.n]\ne = 3\n"
    )
    y = root.value["x"].value["y"]
    m = root.value["m"].value
    assert (y.line, y.value["b"].line, y.value["b"].value[1].line) == (2, 3, 4)
    assert [entry.line for entry in m] == [5, 7] and m[1].value["n"].value["e"].line == 10
    assert toml_lines.parse("a = 1234", width=8).value["a"].value == 1234
    with pytest.raises(
        toml_lines.TextError, match="line 2: given a line of 9 characters, expected at most 8"
    ):
        toml_lines.parse("a = 1\na = 12345", width=8)
    with pytest.raises(toml_lines.TextError, match=r"line 2: given text that is not TOML \("):
        toml_lines.parse("a = 1\nb = = 2")


def test_schemas_of_lists_have_the_lengths_that_are_read() -> None:
    number = {"type": "number"}
    plain = {"type": "array", "items": number}
    assert keys.list_of(number) == plain
    assert keys.list_of(number, 3) == plain | {"minItems": 3, "maxItems": 3}
    assert keys.list_of(number, range(2, 6)) == plain | {"minItems": 2, "maxItems": 5}
    assert keys.list_of(number, 3, 6) == plain | {
        "anyOf": [{"minItems": n, "maxItems": n} for n in (3, 6)]
    }
    schema = keys.direction().schema
    assert (schema["minItems"], schema["maxItems"]) == (3, 3)
    assert keys.whole(2, 5).schema == {"type": "integer", "minimum": 2, "maximum": 5}


def test_edits_of_numbers_find_what_is_there_and_name_what_is_not() -> None:
    text = "a = [1.0, 2.0]\n[b]\nc = 3.0\n[[d]]\ne = 4.0\n"
    root = toml_lines.parse(text)
    assert number_edit._resolve(root, "a.1", "f") == (("a", 1), ()) and number_edit._resolve(
        root, "a.2", "f"
    ) == (
        ("a",),
        ("2",),
    )
    assert number_edit._resolve(root, "b.c", "f") == (("b", "c"), ()) and number_edit._resolve(
        root, "b.x.y", "f"
    ) == (
        ("b",),
        ("x", "y"),
    )
    assert number_edit._resolve(root, "x", "f") == ((), ("x",)) and number_edit._resolve(
        root, "d.0.e", "f"
    ) == (
        ("d", 0, "e"),
        (),
    )
    with pytest.raises(
        ModelError, match=r"f:3:b\.c\.x: given nothing of this name, expected a part of the model"
    ):
        number_edit._resolve(root, "b.c.x.y", "f")
    with pytest.raises(
        ModelError, match=rf"f:1:a\.{number_edit.LONGEST}: given nothing of this name"
    ):
        number_edit._resolve(root, f"a.{number_edit.LONGEST}", "f")
    assert (
        number_edit._plain({"1": 2.0}) == "[0.0, 2.0, 0.0]"
        and number_edit._plain({"4": 2.0}) == "[0.0, 0.0, 0.0, 0.0, 2.0]"
    )
    assert number_edit._plain({"a": 1.0, "b": {"c": 2.0}}) == "{ a = 1.0, b = { c = 2.0 } }"


# --- models --------------------------------------------------------------------------------------


def test_angles_in_degrees_are_exact_at_quarter_turns() -> None:
    for k, exact in enumerate(((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0))):
        assert (
            format_robot._cos_sin(90.0 * k, True) == exact
            and format_robot._cos_sin(k * math.pi / 2, False) == exact
        )
        assert format_robot._cos_sin(90.0 * k - 360.0, True) == exact
    assert format_robot._cos_sin(37.0, True) == pytest.approx(
        (math.cos(math.radians(37)), math.sin(math.radians(37))), rel=1e-15
    )
    assert [format_robot._snap(x) for x in (1 - 9e-16, -1 + 9e-16, 5e-16, 2e-15, 0.5)] == [
        1.0,
        -1.0,
        0.0,
        2e-15,
        0.5,
    ]


def test_coordinates_of_a_chain_have_names_units_and_modes() -> None:
    beam = Beam(1.0, 2.0, (Bending("y", 3.0, 2, 0.0), Bending("z", 3.0, 1, 0.0)))
    dofs = (Dof("q", "rotation", (0.0, 0.0, 1.0)), Dof("s", "translation", (0.0, 0.0, 1.0)))
    found = coordinates_of([Element("arm", dofs, Placement(), Placement(), Body(), beam=beam)])
    assert [(c.name, c.unit, c.actuated) for c in found] == [
        ("q", "rad", False),
        ("s", "m", False),
        ("arm_y1", "m", False),
        ("arm_y2", "m", False),
        ("arm_z1", "m", False),
    ]
    labels = output_labels(Made(output=Made(type="combination", size=3)))  # type: ignore[arg-type]
    assert labels == {"y_ref": ("y1", "y2", "y3")}
    pose = output_labels(Made(output=Made(type="tool_pose", size=6)))["R_ref"]
    assert pose[:4] == ("xx", "xy", "xz", "yx") and len(pose) == 9


@pytest.mark.parametrize(
    ("lower", "upper", "home"),
    [
        (-1.0, 2.0, 0.0),
        (0.0, 2.0, 0.0),
        (-2.0, 0.0, 0.0),
        (1.0, 4.0, 2.5),
        (-4.0, -1.0, -2.5),
        (1.0, None, 1.0),
        (None, -3.0, -3.0),
        (None, None, 0.0),
        (-1.0, None, 0.0),
    ],
)
def test_the_home_of_a_joint_is_zero_or_within_its_limits(
    lower: float | None, upper: float | None, home: float
) -> None:
    limit = None if lower is None and upper is None else Made(lower=lower, upper=upper)
    made: Any = Made(joints={}, _limit=lambda segment: limit)
    segment: Any = Made(joint=Made(name="j"))
    assert overlay._Overlay._home(made, segment) == home
    made._limit = lambda segment: None
    assert overlay._Overlay._home(made, segment) == 0.0


def test_principal_moments_of_a_link_are_those_of_a_body() -> None:
    told: list[tuple[str, str]] = []
    reader: Any = Made(fail=lambda line, here, given, expected: told.append((given, expected)))

    def check(moments: Any, reduced: bool = False) -> int:
        told.clear()
        urdf.Urdf._check_inertia(reader, np.diag(moments), 3, Made(name="arm"), reduced)
        return len(told)

    assert check([1.0, 2.0, 3.0]) == check([1e-7, 2e-7, 3e-7]) == check([0.0, 2.0, 2.0]) == 0
    assert check([1.0, 1.0, 2.1]) == 1 and check([1.0, 1.0, 2.1], reduced=True) == 0
    assert told == [] and check([2.1, 1.0, 1.0]) == 1
    assert told[0][0] == "principal moments 1, 1, 2.1" and told[0][1].startswith(
        "no moment larger than the sum of the other two"
    )
    assert check([-0.5, 1.0, 1.0], reduced=True) == 1 and told[0][1].startswith(
        "principal moments >= 0 (or in the overlay: [link.arm] body"
    )
    assert (
        check([-5e-10, 1.0, 1.0], reduced=True) == 0
        and check([-5e-9, 1.0, 1.0], reduced=True) == 1
    )
    assert urdf.zero_tiny([1e-300, -2.0]) == [0.0, -2.0]
    many = [f"n{k}" for k in range(9)]
    assert (
        urdf.among("zzz", many[:8]).endswith('"n7"')
        and urdf.among("zzz", many).endswith('"n7", ...')
        and urdf.among("a", []) == "no name"
    )


# --- steps of emitted functions ------------------------------------------------------------------


def test_operations_of_steps_are_those_of_elimination_and_of_scalar_products() -> None:
    """Counted by doing them: entries of a band are skipped as the profile says."""
    for n, columns, unit, profile in ((4, 3, False, (0, 0, 0, 0)), (5, 2, True, (0, 0, 1, 1, 3))):
        solve = routine.Solve("A", "R", n, columns, unit, profile, ())
        width = columns + (n if unit else 0)
        pairs = [(i, j) for i in range(n) for j in range(profile[i], i)]
        factor = sum(1 + 2 * (n - i) for i, _ in pairs)
        ahead = 2 * len(pairs)
        back = 2 * sum(range(n)) + n
        assert (
            solve.width == width
            and solve.operations == factor + sum(range(n)) + (ahead + back) * width
        )
        known = routine.Solve("A", "R", n, columns, unit, profile, (), factored=True)
        assert known.operations == (ahead + back) * width and (solve.depth, known.depth) == (
            40 * n,
            40 * n,
        )
        assert (solve.stride, solve.matrix_stride, known.matrix_stride) == (80, 80, 80)
    assert [routine._stride(k) for k in (1, 64, 65, 128, 129)] == [80, 80, 144, 144, 208]
    factor = routine.Factor("A", "b", "x", 3, (0, 0, 0))
    assert (
        factor.operations == (7 + 5 + 5) + 6 + 6
        and factor.depth == 90
        and factor.matrix_stride == 80
    )
    above = (routine.Rows("a", 0, 2), routine.Rows("b", 0, 2))
    below = (routine.Rows("c", 0, 5), routine.Rows("d", 0, 5))
    product = routine.Products(above, below, 8, "M")
    assert (product.operations, product.depth, product.symmetric) == (9 * 36 + 3 * 28, 40, False)
    assert routine.Products(above, above[::-1], 8, "M").operations == 3 * 36
    with pytest.raises(ValueError, match="products: given 7 columns, expected at least 8"):
        routine.Products(above, below, 7, "M")
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [1 + x], ["x"], ["y"])
    with pytest.raises(ValueError, match="columns: given f, which does not give zeros for zeros"):
        routine.Columns(f, 3)
    A = ca.SX.zeros(3, 3)
    A[0, 0] = A[1, 1] = A[2, 2] = A[2, 1] = A[1, 2] = x
    assert routine.profile(ca.Function("A", [x], [ca.densify(A)], ["x"], ["A"]), "A") == (0, 1, 1)


def test_sums_of_products_are_added_in_pairs() -> None:
    layout: Any = Made(at=lambda array, row: 100 + row)
    pair = (routine.Rows("a", 0, 3), routine.Rows("b", 2, 3))
    assert _total(pair, "u", layout) == "(w[102 + i] * u0 + w[103 + i] * u1) + (w[104 + i] * u2)"
    one = (routine.Rows("a", 0, 1), routine.Rows("b", 0, 1))
    assert _total(one, "u", layout) == "w[100 + i] * u0"


# --- poses at rest, parameters of loops ----------------------------------------------------------


def test_the_elastic_robot_at_rest_is_where_statics_hold_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Gear deflections and soft joints under gravity; the joints are moved until the tool is at
    the goal.
    """
    model = replace(flexgen.read("planar5_nmp"), gravity=(0.0, -9.81, 0.0))
    equations = derive(model)
    solver: Any = Made(
        model=model,
        i_g=list(model.i_g),
        free=list(model.i_g),
        length=0.7,
        _at=np.arange(model.n_g),
    )
    solver._solve_deflections = lambda q: _Solver._solve_deflections(solver, q)
    solver._error = lambda *given: _Solver._error(solver, *given)
    solver._miss = lambda goal, full: _Solver._miss(solver, goal, full)
    pose = equations.function("forward_kinematics")
    jacobian = equations.function("jacobian")
    solver.library = Made(
        forward_kinematics=lambda q: (np.array(pose(q)[0]).ravel(), np.array(pose(q)[1])),
        jacobian=lambda q: np.array(jacobian(q)),
    )
    q = np.array([0.4, -0.7])
    full = solver._solve_deflections(q)
    rest = statics.hold_joints(equations, full[list(model.i_g)])
    assert_allclose(rest.q_a, full, atol=1e-12)
    assert_allclose(rest.q_m, model.eta @ q, atol=1e-9)
    assert np.abs(full[list(model.i_g)] - q).min() > 1e-6
    p, R = solver.library.forward_kinematics(full)
    goal = np.concatenate([p, R.ravel()])
    assert_allclose(_Solver.solve_sag(solver, goal, q + np.array([0.03, -0.02])), q, atol=1e-9)
    assert solver._miss(goal, full) == 0.0
    monkeypatch.setattr(search, "SAG_STEPS", 2)
    assert _Solver.solve_sag(solver, goal + np.eye(12)[2], q) is None
    assert solver._miss(goal + 0.07 * np.eye(12)[0], full) == pytest.approx(0.1)


def test_parameters_of_a_loop_are_one_row_or_one_for_each_lane() -> None:
    def read(given: Any, per_point: bool) -> np.ndarray:
        loop: Any = Made(lanes=4)
        library: Any = Made(
            parameter_names=("a", "b"), parameters=np.array([1.0, 2.0]), per_point=per_point
        )
        return ClosedLoop._parameters(loop, library, given)

    assert read(None, False).tolist() == [1.0, 2.0] and read([3, 4], False).tolist() == [3.0, 4.0]
    assert read(None, True).tolist() == [[1.0] * 4, [2.0] * 4]
    assert read(np.arange(8).reshape(4, 2), True).tolist() == [
        [0.0, 2.0, 4.0, 6.0],
        [1.0, 3.0, 5.0, 7.0],
    ]
    for wrong, per_point in (
        ([1.0, 2.0, 3.0], True),
        (np.zeros((4, 2)), False),
        ([1.0, np.nan], False),
        (np.full((4, 2), np.inf), True),
        (np.zeros((3, 2)), True),
    ):
        with pytest.raises(
            ArgumentError, match=r"parameters: given \(.*\), expected \(2,\), finite"
        ):
            read(wrong, per_point)


def test_units_of_an_output_are_those_of_its_coordinates_where_they_differ() -> None:
    coordinates = (Made(unit="rad"), Made(unit="m"))
    output = Made(
        type="combination", size=2, unit="mixed", weights=np.array([[0.5, -3.0], [2.0, 0.0]])
    )
    gantry: Any = Made(output=output, coordinates=coordinates)
    assert output_units(gantry) == ("m", "rad") and unit_of(gantry) == "m"
    assert columns_in(gantry, "rad") == [1] and columns_in(gantry, "m") == [0]
    angles: Any = Made(output=Made(type="combination", size=3, unit="rad"), coordinates=())
    assert (
        output_units(angles) == ("rad",) * 3
        and unit_of(angles) == "rad"
        and columns_in(angles, "m") == []
    )
    for kind, axes, width in (("tool_pose", "xyz", 3), ("tool_position", "xz", 2)):
        model: Any = Made(output=Output(kind, axes))
        assert output_units(model) == ("m",) * width
    turning = Output("tool_position_angle", "xz", rotation_axis=(0.0, 1.0, 0.0))
    assert output_units(Made(output=turning)) == ("m", "m", "rad")  # type: ignore[arg-type]
