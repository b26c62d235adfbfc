"""Tables of Denavit-Hartenberg parameters: units, assumed numbers, moves, and errors."""

from __future__ import annotations

import json
import math
import re

import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, FileError, FlexgenError
from flexgen.cli.main import main
from flexgen.model.format.format_tasks import TOOL
from flexgen.studies.templates.dh_arm import MASS_TO_PAYLOAD, USUAL_PAYLOAD
from flexgen.studies.templates.dh_model import model_from_dh
from flexgen.studies.templates.dh_moves import ROUND, STEP, draw_poses
from flexgen.studies.templates.dh_table import likely_convention, read_dh

PUMA = """
# Puma 560: lengths of Armstrong, Khatib and Burdick 1986
joint,type,alpha_prev [deg],a_prev [mm],d [mm],theta [deg],lower [deg],upper [deg],mass [kg]
q1,R,0,0,0,0,-160,160,
q2,R,-90,0,243.5,0,-225,45,17.4
q3,R,0,431.8,-93.4,0,-45,225,4.8
q4,R,90,-20.3,433.1,0,-110,170,0.82
q5,R,-90,0,0,0,-100,100,0.34
q6,R,90,0,0,0,-266,266,0.09
tool,,0,0,100,,,,
"""
SCARA = """
joint;type;a (mm);alpha (°);d (mm);min [deg];min [mm];max [deg];max [mm];mass (kg);lead [mm]
q1;rotation;300;0;400;-130;;130;;9,0;
q2;rotation;250;180;0;-145;;145;;5,5;
z;translation;0;0;50;;0;;200;1,2;20
r;rotation;0;0;60;-360;;360;;0,8;
payload;;;;;;;;;2,0;
"""
GEARS = """
joint,a [mm],alpha [deg],d [mm],mass [kg],ratio,gear_stiffness [Nm/arcmin],gear_damping [Nms/rad],\
rotor_inertia [kg cm²],torque_max [N m],speed_max [rpm],coulomb [Nm],viscous [N m s/rad]
A1,160,-90,450,40,100,200,300,2.5,9,3000,0.2,1e-3
A2,600,0,0,25,-120,180,250,2.0,8,3000,0.2,1e-3
A3,120,-90,0,15,100,90,120,1.2,4,3000,0.1,5e-4
"""


@pytest.fixture
def table(tmp_path):
    """Write a table."""

    def call(text):
        path = tmp_path / "arm.csv"
        path.write_text(text.strip("\n"), encoding="utf-8")
        return path

    return call


@pytest.fixture
def made(table, tmp_path):
    """The model of a table, and its file."""

    def call(text, convention=None):
        model = model_from_dh("arm", table(text), convention)
        path = tmp_path / "arm.toml"
        path.write_text(model.text, encoding="utf-8")
        return model, path

    return call


def test_a_puma_stands_where_its_geometry_says(made):
    """Craig, 3.7: with all angles 0 the wrist is at a2 + a3, d3, d4."""
    model, path = made(PUMA)
    assert model.convention == "modified"
    assert model.zero == pytest.approx((0.4318 - 0.0203, 0.2435 - 0.0934, 0.4331 + 0.1), abs=1e-15)
    assert [name for name, _ in model.moves] == ["line", "circle", "joints"]
    assert flexgen.read(path).home == pytest.approx(model.home)


@pytest.mark.parametrize(
    "text, convention", [(PUMA, None), (SCARA, "standard"), (GEARS, "standard")]
)
def test_a_written_model_has_plausible_numbers_and_moves_within_limits(made, text, convention):
    model, path = made(text, convention)
    found = flexgen.check(path)
    assert not found.errors, found
    assert not [finding for finding in found.warnings if finding.key.startswith("move")]
    assert model.moves and not model.warnings
    for name, _ in model.moves:
        assert flexgen.plan(path, name).duration > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "text, convention", [(PUMA, None), (SCARA, "standard"), (GEARS, "standard")]
)
def test_all_moves_of_a_written_model_are_solved(made, text, convention):
    model, path = made(text, convention)
    for name, _ in model.moves:
        assert str(flexgen.solve(path, name).status) == "solved"


def test_units_of_the_header_are_used(made):
    _, path = made(GEARS, "standard")
    robot = flexgen.read(path)
    arcmin = math.pi / 180.0 / 60.0
    gear = robot.elements[0].dofs[0].gear
    motor = robot.motors[0]
    assert gear.spring.stiffness == pytest.approx(200.0 / arcmin, rel=1e-14)
    assert (gear.damping, motor.inertia) == (300.0, 2.5e-4)
    assert motor.speed_max == pytest.approx(100.0 * math.pi, rel=1e-14)
    assert robot.motors[1].ratio == (-120.0,)
    assert motor.friction.coulomb == 0.2
    assert motor.friction.beta * motor.speed_max == pytest.approx(100.0, rel=0.05)


def test_a_translation_has_its_own_units(made):
    _, path = made(SCARA, "standard")
    robot = flexgen.read(path)
    z = robot.coordinates[2]
    assert (z.unit, z.dof.lower, z.dof.upper) == ("m", 0.0, 0.2)
    assert robot.motors[2].ratio[0] == pytest.approx(2.0 * math.pi / 0.02)
    assert robot.payload.mass == 2.0


def test_assumed_numbers_are_marked_with_a_rule_of_the_head(made):
    model, path = made(PUMA)
    text = path.read_text()
    used = set(re.findall(r"ASSUMED: (.*)", text))
    assert len(re.findall("ASSUMED: ", text)) == len(model.assumed) > 20
    assert all(f"\n# - {rule}: " in text for rule in used)
    assert "mass of link 1: by length" in model.assumed
    assert not any(text.startswith("mass of link 2") for text in model.assumed)
    assert "upper" not in " ".join(model.missing) and "coulomb of all joints" in model.missing


def test_complete_tables_have_no_assumed_number(made):
    header = (
        "a [m],alpha [deg],d [m],mass [kg],com_x [m],com_y [m],com_z [m],ixx [kg m^2],iyy [kg "
        "m^2],"
    )
    header += "izz [kg m^2],ratio,gear_stiffness [N m/rad],gear_damping [N m s/rad],"
    header += "rotor_inertia [kg m^2]\n"
    row = "0.5,0,0,10,-0.2,0,0,0.1,0.3,0.3,100,5e4,40,1e-4\n"
    model, path = made(header + row + row, "standard")
    assert model.assumed == () and "ASSUMED" not in path.read_text()
    assert flexgen.read(path).output.type == "tool_position"


def test_a_stiffness_is_assumed_from_the_largest_inertia_over_poses(made):
    """Not from the pose with the arm upright, where the first axis carries little."""
    header = "a [m],alpha [deg],d [m],mass [kg],com_x [m],com_y [m],com_z [m],"
    header += "ixx [kg m^2],iyy [kg m^2],izz [kg m^2]\n"
    rows = "0,90,0.4,10,0,0,0,0.1,0.1,0.1\n1.0,0,0,20,-0.5,0,0,0.1,1.7,1.7\n"
    _, path = made(header + rows, "standard")
    stretched = 20.0 * 0.25 + 1.7 + 0.1
    gear = flexgen.read(path).elements[0].dofs[0].gear
    assert gear.spring.stiffness == pytest.approx(stretched * (40.0 * math.pi) ** 2, rel=0.06)


def test_the_home_of_the_table_is_kept(made):
    text = GEARS.replace("joint,", "joint,home [deg],")
    for k, angle in enumerate((10, -60, 70), start=1):
        text = text.replace(f"A{k},", f"A{k},{angle},")
    model, path = made(text, "standard")
    assert model.home == pytest.approx(np.radians([10, -60, 70]))
    assert "of the table" in path.read_text()


def test_a_tool_of_the_modified_convention_has_the_pose_of_its_row(made):
    row = "tool,,30,200,100,45,,,"
    _, path = made(PUMA.replace("tool,,0,0,100,,,,", row))
    alpha, theta = np.radians([30.0, 45.0])
    tool = flexgen.read(path).tool
    turn_x = np.array(
        [[1, 0, 0], [0, np.cos(alpha), -np.sin(alpha)], [0, np.sin(alpha), np.cos(alpha)]]
    )
    turn_z = np.array(
        [[np.cos(theta), -np.sin(theta), 0], [np.sin(theta), np.cos(theta), 0], [0, 0, 1]]
    )
    assert np.allclose(tool.rotation, turn_x @ turn_z, atol=1e-15)
    assert np.allclose(tool.position, np.array([0.2, 0, 0]) + turn_x @ [0, 0, 0.1], atol=1e-15)


def test_a_motor_that_cannot_hold_the_arm_is_reported(made):
    """The torque of the joint in the column of the motor's is too large; that in N cm too
    small.
    """
    model, _ = made(GEARS.replace("torque_max [N m]", "torque_max [N cm]"), "standard")
    assert any("motor m2: gravity needs up to" in text for text in model.warnings)


@pytest.mark.parametrize(
    "text, convention, likely",
    [(PUMA.replace("_prev", ""), "standard", "modified"), (GEARS, "modified", "")],
)
def test_a_table_that_looks_like_the_other_convention_is_reported(made, text, convention, likely):
    model, _ = made(text, convention)
    assert bool(likely) == any(f"of the convention '{likely}' do" in w for w in model.warnings)


def test_the_likely_convention_is_named_where_none_is_given(table):
    path = table(PUMA.replace("_prev", ""))
    with pytest.raises(ArgumentError, match="this table looks modified"):
        read_dh(path)
    assert likely_convention(read_dh(path, "modified").joints) == "modified"


ERRORS = {
    "a [mm]": ("a", ":3:a: given no unit, expected distance along x in one of: [mm], [m], [cm]"),
    "a [mm] ": ("a [foot]", ":3:a: given the unit 'foot'"),
    "mass [kg]": ("weight [kg]", ":3:weight: given an unknown column"),
    "160,-90": ("160 mm,-90", ":4:a: given '160 mm', expected a number"),
    "40,100": ("-40,100", ":4:mass: given -40 kg, expected a number >= 0"),
    "40,100,200": ("40,0,200", ":4:ratio: given 0, expected a number other than 0"),
    "600,0,0": ("600,0,", ":5:d: given nothing, expected a number, 0 where there is none"),
    "A2": ("A1", ":5:name: given 'A1' again, after line 4"),
    "A2 ": ("2nd", ":5:name: given '2nd', expected"),
    "3000,0.1,5e-4": ("3000,0.1,5e-4,7,8", ":6:file: given 15 cells, expected at most 13 cells"),
    "alpha [deg]": (
        "lower [deg]",
        ":3:alpha: given no column, expected a column such as alpha [deg]",
    ),
}


@pytest.mark.parametrize("old", ERRORS)
def test_an_error_names_file_line_and_column(old, table):
    new, said = ERRORS[old]
    path = table("# a comment\n\n" + GEARS.strip("\n").replace(old.strip(), new, 1))
    with pytest.raises(FileError, match=re.escape(said)) as caught:
        read_dh(path, "standard")
    assert caught.value.file == str(path)


HEAD = (
    "joint,type,a [m],alpha [deg],d [m],theta [deg],lower [deg],upper [deg],direction,mass [kg],"
)
HEAD += "com_x [m],com_y [m],com_z [m],ixx [kg m^2],iyy [kg m^2],izz [kg m^2],ixy [kg m^2],"
HEAD += "lead [mm],beta [s/rad]"
ROWS = {
    "q,R,0,0,0,q1": "theta: given 'q1', expected a number: the constant part of the angle",
    "q,X,0,0,0": "type: given 'X', expected rotation, translation or fixed",
    "q,R,0,0,0,0,30,20": "upper: given 20, expected more than lower, which is 30",
    "q,T,0,0,0,0,30,40": "lower: given 30 [deg] of a translation, expected a number in",
    "q,R,0,0,0,0,,,2": "direction: given 2, expected 1 or -1",
    "q,R,0,0,0,0,,,,1,0.1": "com_y: given nothing, expected a number: com_x, com_y, com_z belong",
    "q,R,0,0,0,0,,,,,0.1,0,0": "mass: given nothing, expected a mass",
    "q,R,0,0,0,0,,,,1,,,,0.1,0.1,0.3": "ixx, iyy, izz: given principal moments 0.1, 0.1, 0.3",
    "q,R,0,0,0,0,,,,1,,,,0.1,0.1,0.1,0.2": "ixx, iyy, izz: given principal moments -0.1",
    "q,R,0,0,0,0,,,,1,,,,,,,0.2": "ixx: given nothing, expected a number, because of ixy",
    "q,R,0,0,0,0,,,,1,,,,,,,,20": "lead: given 20, expected a ratio: it is a rotation",
    "q,R,0,0,0,0,,,,1,,,,,,,,,5": "beta: given 5, expected a number in coulomb too",
    "q,fixed,0,0,0,0,1": "lower: given 1, expected nothing: the row is fixed",
    "q,R,1e400,0,0": "a: given '1e400', expected a number",
    "q,R,1e15,0,0": "a: given 1e15 m, expected a number of magnitude 1e-18 to 1e12",
    "q,R,\u0661,0,0": "a: given '\u0661', expected a number",
    "payload,,1": "a: given 1, expected nothing: the row 'payload' has mass",
    "tool,,0,0,0": "file: given 0 joints, expected 1 to 32 lines with joints",
}


@pytest.mark.parametrize("row", ROWS)
def test_a_wrong_row_is_refused_with_its_column(row, table):
    with pytest.raises(FileError, match=re.escape(ROWS[row])):
        read_dh(table(f"{HEAD}\n{row}"), "standard")


def test_files_that_are_not_tables_are_refused(table, tmp_path):
    with pytest.raises(ArgumentError, match="cannot be read"):
        read_dh(tmp_path / "none.csv")
    with pytest.raises(ArgumentError, match="convention: given 'craig'"):
        read_dh(table(PUMA), "craig")
    with pytest.raises(FileError, match="expected a and alpha for the convention 'standard'"):
        read_dh(table(PUMA), "standard")
    for raw in (b"", b"\xff\xfe\x00", b"# only a comment\n", b"x" * 2_000_000, b"\x00,\x00\n"):
        path = tmp_path / "raw.csv"
        path.write_bytes(raw)
        with pytest.raises(FlexgenError):
            read_dh(path)


def test_mutated_tables_are_read_or_refused(table):
    """A cell replaced by words and numbers: no exception but those of flexgen."""
    rng = np.random.default_rng(4)
    words = ["", "0", "-1", "nan", "inf", "1e300", "q", '"', "a [mm]", "tool", "R", "9" * 400, ";"]
    for _ in range(150):
        lines = [line.split(",") for line in GEARS.strip().split("\n")]
        line = int(rng.integers(len(lines)))
        cell = int(rng.integers(len(lines[line])))
        lines[line][cell] = str(rng.choice(words))
        try:
            read_dh(table("\n".join(map(",".join, lines))), "standard")
        except FlexgenError as error:
            assert "expected" in str(error)


def test_the_command_line_writes_a_model(table, tmp_path, capsys):
    out = tmp_path / "puma.toml"
    words = ["new", "puma", "--dh", str(table(PUMA)), "--out", str(out)]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "convention: modified" in said and "0.4115, 0.1501, 0.5331 m" in said
    assert "marked ASSUMED" in said and "not in the table" in said
    assert main([*words, "--force", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["moves"][0][0] == "line" and len(found["home"]) == 6
    assert flexgen.read(out).name == "puma"
    assert main(["new", "x", "--convention", "standard", "--out", str(tmp_path / "x.toml")]) == 1
    assert "--convention: given without --dh" in capsys.readouterr().err


# output and number of moves of a tool that only turns about the vertical
UPRIGHT = ("tool_position_angle", 3) if "tool_position_angle" in TOOL else ("combination", 1)
SHAPES = {
    "one rotation": ("R,300,0,0,0", "tool_position", 2),
    "two rotations": ("R,300,0,0,0\nR,200,0,0,0", "tool_position", 3),
    "plane with three": ("R,300,0,0,0\nR,200,0,0,0\nR,100,0,0,0", *UPRIGHT),
    "SCARA": ("R,300,0,400,0\nR,250,180,0,0\nT,0,0,50,0\nR,0,0,60,0", *UPRIGHT),
    "five axes": (
        "R,0,-90,300,0\nR,400,0,0,-90\nR,300,0,0,0\nR,0,-90,0,-90\nR,0,0,100,0",
        "combination",
        1,
    ),
    "gantry": ("T,0,-90,0,-90\nT,0,-90,0,-90\nT,0,0,0,0", "tool_position", 3),
    "pedestal": ("fixed,0,0,500,0\nR,300,90,0,0\nR,200,0,0,0", "tool_position", 3),
    "Stanford arm": (
        "R,0,-90,400,0\nR,0,90,150,0\nT,0,0,300,-90\nR,0,-90,0,0\nR,0,90,0,0\nR,0,0,100,0",
        "tool_pose",
        3,
    ),
    "seven on a track": (
        "T,0,90,300,0\nR,0,-90,340,0\nR,0,90,0,0\nR,0,90,400,0\nR,0,-90,0,0\nR,0,-90,400,0\n"
        "R,0,90,0,0\nR,0,0,126,0",
        "tool_pose",
        3,
    ),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_arms_of_other_shapes_get_an_output_and_moves_that_they_can_do(shape, made):
    rows, output, moves = SHAPES[shape]
    model, path = made(f"type,a [mm],alpha [deg],d [mm],theta [deg]\n{rows}", "standard")
    robot = flexgen.read(path)
    assert (robot.output.type, len(model.moves)) == (output, moves) and not model.warnings
    found = flexgen.check(robot)
    assert not found.errors and all("move" not in each.key for each in found.warnings)


def test_an_arm_without_moves_is_not_to_be_solved_next(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    table = "a [mm],alpha [deg],d [mm],mass [kg],torque_max [N m],ratio\n400,90,300,20,{},10\n"
    table += "350,0,0,10,{},10\n"
    for name, torque in (("strong", "90"), ("weak", "1e-4")):
        (tmp_path / f"{name}.csv").write_text(table.format(torque, torque))
        assert main(["new", name, "--dh", f"{name}.csv", "--convention", "standard"]) == 0
        out = capsys.readouterr().out
        assert ("moves: none" in out) == (name == "weak")
        assert ("next: flexgen solve" in out) == (name == "strong")


@pytest.mark.parametrize(("span", "rounded"), [(1.0, True), (1e-3, False)])
def test_poses_are_round_numbers_within_the_ranges(span, rounded):
    """A range that has no round number keeps what was drawn."""
    first = "element.upper.dof.q1"
    limits = {f"{first}.lower_rad": 0.012, f"{first}.upper_rad": 0.012 + span, "move": []}
    home = {"home_deg": np.degrees([0.012 + span / 2, 0.0]).tolist()}
    robot = flexgen.read("elbow", overrides=limits | home)
    poses = draw_poses(robot, 40)
    assert (poses[:, 0] > 0.012).all() and (poses[:, 0] < 0.012 + span).all()
    assert (np.abs(poses[:, 1]) < np.pi).all() and len(np.unique(poses[:, 1])) > 10
    step = STEP["rad"]
    assert np.allclose(poses[:, 0] / step, np.round(poses[:, 0] / step), atol=1e-9) == rounded
    assert np.allclose(poses[:, 1] / step, np.round(poses[:, 1] / step), atol=1e-9)


def test_the_pose_at_home_says_where_it_is_from(made):
    chosen, _ = made(PUMA)
    given = PUMA.strip("\n").splitlines()
    assert "deg; chosen: far from singular poses and limits" in chosen.text
    assert "home" not in given[0] and "deg; of the table" not in chosen.text


def test_masses_that_are_not_given_sum_to_a_multiple_of_the_load(made):
    """Links of one length: their shares fall linearly towards the tool."""
    rows = "".join(f"A{k},400,0,0\n" for k in (1, 2, 3, 4))
    model, path = made(f"joint,a [mm],alpha [deg],d [mm]\n{rows}", "standard")
    masses = [element.body.mass for element in flexgen.read(path).elements]
    expected = MASS_TO_PAYLOAD * USUAL_PAYLOAD * np.array([0.4, 0.3, 0.2, 0.1])
    assert masses == pytest.approx(expected.tolist(), rel=5e-3)
    assert [name for name, _ in model.moves]


def test_the_circle_has_a_part_of_the_length_of_the_line(made):
    _, path = made(PUMA)
    robot = flexgen.read(path)
    line = np.linalg.norm(robot.move("line").displacement)
    radius = np.linalg.norm(robot.move("circle").center)
    parts = [radius / (ROUND * line * part) for part in (1.0, 0.5, 0.25)]
    assert any(part == pytest.approx(1.0, rel=0.06) for part in parts)  # two digits
