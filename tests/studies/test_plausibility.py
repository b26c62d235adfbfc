"""`flexgen.check`: all models pass, and wrong units and powers of ten that are planted are found
by their key.
"""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from shipped_models import all_variants

import flexgen
from flexgen.base.checks import type_checks
from flexgen.base.checks.type_checks import checked_types
from flexgen.base.errors import ArgumentError, ModelError, SolverError
from flexgen.cli.main import main
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.studies.check.finding import MARKS

MODELS = [
    "planar5_nmp",
    "planar5_mp",
    "elbow",
    "kr300",
    "manutec_r3",
    "manutec_r3_18",
    "beam_arm",
    "urdf_arm",
]


@pytest.mark.parametrize("model", all_variants())
def test_the_models_that_come_with_flexgen_pass(model):
    found = flexgen.check(model)
    assert not found.errors and len(found.findings) >= 10, found
    assert all(
        finding.mark in MARKS and finding.key and finding.usual for finding in found.findings
    )
    assert all(finding.advice for finding in found.warnings) and len(repr(found).splitlines()) < 25


@pytest.mark.parametrize("verb", [flexgen.check, flexgen.solve])
def test_a_coordinate_that_moves_no_inertia_is_named(verb):
    massless = read("elbow", overrides={"element.fore.body": {"mass": 0.0}})
    with pytest.raises(ModelError, match="singular: q2 moves no inertia"):
        verb(massless)


COLD = {"type": "gear", "viscous": 0.1, "viscous_share": 0.5, "viscous_decay": 1e-15}


@pytest.mark.parametrize(
    ("verb", "changes", "words"),
    [
        (
            flexgen.solve,
            {"gravity": [0.0, 0.0, -1e11]},
            "implausible: gravity: gravity 1e+11 m/s^2, usual at most 30",
        ),
        (
            flexgen.analyze,
            {"motor.m1.friction": COLD, "temperature": -30.0},
            "analyze: the computation failed (Array",
        ),
        (
            flexgen.check,
            {"motor.m1.friction": COLD, "temperature": -30.0},
            "dampings, frictions and gravity",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_numerical_errors_of_functions_name_their_cause(verb, changes, words):
    with pytest.raises(SolverError) as caught:
        verb(read("elbow", overrides=changes))
    assert words in str(caught.value) and isinstance(
        caught.value.__cause__, ArithmeticError | ValueError
    )


def test_a_cause_that_cannot_be_found_leaves_the_error(monkeypatch):
    """Deriving the model again, for its implausible numbers, fails as it did before."""

    def overflow(self, *_):
        raise OverflowError("int too large to convert to float")

    monkeypatch.setattr("flexgen.dynamics.mechanics.equations.Equations.__init__", overflow)
    with pytest.raises(SolverError, match=r"derive: the computation failed .*int too large"):
        flexgen.derive(str(read("elbow").file))


def test_an_error_of_the_search_for_a_cause_has_no_cause_itself(monkeypatch):
    """The search for implausible numbers calls functions of models, too: their errors are as they
    are.
    """
    asked = []

    @checked_types
    def inner(model: str) -> None:
        raise np.linalg.LinAlgError("singular")

    @checked_types
    def outer(model: str, power: float) -> None:
        raise OverflowError("too large")

    def search(model):
        asked.append(model)
        with pytest.raises(np.linalg.LinAlgError, match="singular"):
            inner(model)
        return "; gravity is large"

    monkeypatch.setattr(
        type_checks, "find_function", lambda name: {"Check.implausible": search}[name]
    )
    for call in (lambda: outer("arm", 2.0), lambda: outer(power=2.0, model="arm")):
        with pytest.raises(SolverError) as caught:
            call()
        text = str(caught.value)
        assert text.startswith(
            "outer: the computation failed (too large); check the numbers of the model with "
            "flexgen."
        )
        assert text.endswith("; gravity is large") and isinstance(
            caught.value.__cause__, OverflowError
        )
    assert asked == ["arm", "arm"]

    @checked_types
    def other(model: str) -> None:
        raise ValueError("not of numbers")

    with pytest.raises(ValueError, match="not of numbers"):
        other("arm")
    assert len(asked) == 2


def test_commands_in_rows_of_different_lengths_are_refused():
    with pytest.raises(
        ArgumentError,
        match=r"commands: given \[\[1\], \[2, 3\]\], expected rows of the same length",
    ):
        flexgen.tracker_positions("elbow", [[1], [2, 3]])


def test_lengths_in_millimeters_are_found():
    found = flexgen.check(
        read("elbow", overrides={"element.fore.origin.position": [1e6, 0.0, 0.0]}), motions=False
    )
    assert found.worst is not None and "element" in [finding.key for finding in found.errors]


def planted(robot: RobotModel, kind: str) -> list[tuple[str, float]]:
    """Keys of the model file with the numbers of a wrong unit, one for each motor, gear or
    body.
    """
    gears = [
        (f"element.{c.element}.dof.{c.name}.gear", c.dof.gear)
        for c in robot.coordinates
        if c.dof is not None and c.dof.gear is not None and c.dof.gear.spring is not None
    ]
    single = [motor for motor in robot.motors if len(motor.drives) == 1]
    bodies = [(f"element.{e.name}.body", e.body) for e in robot.elements]
    solid = [
        (key, body)
        for key, body in bodies
        if body.inertia[0][0] and body.inertia[1][1] and body.inertia[2][2]
    ]
    return {
        "ratio times 1000": [(f"motor.{m.name}.ratio", 1000.0 * m.ratio[0]) for m in single],
        "ratio inverted": [(f"motor.{m.name}.ratio", 1.0 / m.ratio[0]) for m in single],
        "rotor in g cm^2": [(f"motor.{m.name}.inertia", 1e7 * m.inertia) for m in robot.motors],
        "motor speed in rpm": [(f"motor.{m.name}.speed_max", 3000.0) for m in robot.motors],
        "N m/deg": [
            (f"{key}.spring.stiffness", g.spring.stiffness * math.pi / 180.0) for key, g in gears
        ],
        "damping times 100": [(f"{key}.damping", 100.0 * gear.damping) for key, gear in gears],
        "mass in g": [(f"{key}.mass", 1000.0 * body.mass) for key, body in solid],
        "body in g cm^2": [
            (f"{key}.inertia", [1e7 * body.inertia[k][k] for k in range(3)]) for key, body in solid
        ],
    }[kind]


# no robot has such numbers
ERRORS = {"ratio times 1000", "rotor in g cm^2", "mass in g", "body in g cm^2"}
KINDS = sorted({*ERRORS, "ratio inverted", "motor speed in rpm", "N m/deg", "damping times 100"})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("model", MODELS)
def test_a_number_in_a_wrong_unit_is_found_by_its_key(model, kind):
    robot = read(model)
    assert planted(robot, kind)
    for key, value in planted(robot, kind):
        found = flexgen.check(read(model, overrides={key: value}), motions=False)
        worst = [finding.key for finding in (*found.errors, *found.warnings)]
        assert key in worst[: 1 if kind != "ratio inverted" else 2], (key, value, found)
        assert kind not in ERRORS or found.errors
        assert found.to_dict()["errors"] == len(found.errors)


@pytest.mark.parametrize(
    ("model", "change", "key"),
    [
        ("planar5_nmp", {"move.line.displacement": [-200.0, 210.0, 0.0]}, "move.line"),  # mm
        (
            "planar5_nmp",
            {"element.arm2.dof.q2.lower_deg": -80.0, "move.joints.end_rad": [0.9, -1.3]},
            "move.line",
        ),
        ("elbow", {"move.line.duration": 1e-3}, "move.line"),  # s given in ks
    ],
)
def test_a_move_beyond_the_reach_the_ranges_or_the_speeds_is_an_error(model, change, key):
    found = flexgen.check(read(model, overrides=change))
    assert [finding.key for finding in found.errors] == [key], found
    assert not flexgen.check(model).errors


@pytest.mark.parametrize(
    "change", [{"motor.m1.ratio": 1e12}, {"element.arm3.dof.q3.spring.stiffness": 1e-12}]
)
def test_extreme_numbers_are_findings_not_exceptions(change):
    found = flexgen.check(read("planar5_nmp", overrides=change))
    assert next(iter(change)) in [finding.key for finding in found.errors]


@pytest.fixture
def ask(capsys):
    """Run a command line in this process; (status, standard output, standard error)."""

    def call(*words):
        status = main(list(words))
        captured = capsys.readouterr()
        return status, captured.out, captured.err

    return call


def test_the_verb_prints_a_mark_for_each_number_and_fails_with_an_error(ask):
    status, out, err = ask("check", "planar5_nmp")
    assert status == 0 and err == "" and out.count("\n") == 1 and "0 errors, 0 unusual" in out
    status, out, err = ask("check", "planar5_nmp", "-v")
    rows = [line for line in out.splitlines() if line.startswith(MARKS)]
    assert status == 0 and err == "" and len(rows) == len(flexgen.check("planar5_nmp").findings)
    status, out, _ = ask("check", "planar5_nmp@soft", "--json")
    assert status == 0 and json.loads(out)["unusual"] == 1
    status, out, err = ask("check", "planar5_nmp", "--set", "motor.m1.ratio=1e5")
    assert status == 1 and "error: motor.m1.ratio" in out and "the worst: motor.m1.ratio: " in err


def test_a_failure_with_a_wrong_ratio_names_the_ratio(ask, monkeypatch):
    def fail(*arguments, **options):
        raise flexgen.SolverError("simulation: failed at t = 0 s (Unexpected istate in LSODA.)")

    monkeypatch.setattr("flexgen.inversion.solve.solve", fail)
    status, _, err = ask("solve", "urdf_arm", "--set", "motor.m3.ratio=0.0025")
    assert (
        status == 1
        and "; numbers of the model are implausible: motor.m3.ratio: ratio of a translation" in err
    )
    assert "0.0025 rad/m, usual 5 to 2e+04 rad/m" in err and "'flexgen check urdf_arm'" in err
    assert "implausible" not in ask("solve", "urdf_arm")[2]


def test_ratios_of_translations_have_their_unit(ask):
    assert flexgen.describe("urdf_arm")["motors"][2]["ratio_unit"] == ["rad/m"]
    assert "400 rad/m" in ask("describe", "urdf_arm")[1]


def test_one_error_has_no_plural(ask):
    steep = "motor.m1.friction.beta=245321638"
    out = ask("check", "planar5_nmp", "--set", "motor.m1.friction.coulomb=0.572", "--set", steep)[
        1
    ]
    assert " 1 error, " in out
