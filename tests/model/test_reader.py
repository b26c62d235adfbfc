"""The reader: the shipped models, variants, overrides, units, frames, and the closed form of the
elbow arm.
"""

import dataclasses
import json
import math
import os
import re
from pathlib import Path

import numpy as np
import pytest
from bad_models import GOOD

from flexgen.base.errors import ArgumentError, ModelError
from flexgen.base.spec.toml_lines import Scanner, leaves, parse, unwrap, wrap
from flexgen.model import elements as nouns
from flexgen.model import reader
from flexgen.model.format.format_robot import rotation_matrix
from flexgen.model.moves import Move, MoveC, MoveL
from flexgen.model.reader import model_names, read

MODELS = Path(__file__).parents[2] / "models"

# name: motors, actuated, non-actuated, degrees of freedom, variants
COUNTS = {
    "planar5_mp": (2, 2, 1, 5, ("undamped",)),
    "planar5_nmp": (2, 2, 1, 5, ("undamped", "soft", "coupled")),
    "planar5_soft": (2, 2, 1, 5, ("undamped", "light")),
    "elbow": (2, 2, 0, 4, ("fjm", "rigid", "payload")),
    "four_mass": (1, 1, 2, 4, ("high", "low", "piecewise")),
    "abb_arm": (1, 1, 1, 3, ("viscous",)),
    "manutec_r3": (6, 6, 0, 9, ("coupled",)),
    "manutec_r3_efjm": (6, 6, 12, 21, ()),
    "manutec_r3_18": (6, 6, 6, 18, ("coupled",)),
    "manutec_r3_24": (6, 6, 12, 24, ()),
    "manutec_r3_30": (6, 6, 18, 30, ()),
    "kr300": (6, 6, 0, 9, ("backlash", "encoders")),
    "kr300_balancer": (6, 6, 2, 11, ()),
    "kr300_efjm": (6, 6, 8, 20, ()),
    "planar5_family": (
        2,
        2,
        1,
        5,
        ("l_300", "l_490", "l_510", "l_700", "xi_100", "xi_150", "j_1000", "j_1400"),
    ),
    "beam_arm": (2, 2, 2, 6, ()),
    "urdf_arm": (3, 3, 1, 5, ()),
    "palletizer": (4, 4, 4, 12, ()),
    "delta": (3, 3, 3, 9, ()),
    "linkage_arm": (6, 6, 3, 15, ()),
    "two_arm": (5, 5, 1, 11, ()),
    "carried_arm": (5, 5, 3, 13, ()),
    "seven_axis": (7, 7, 10, 24, ()),
    "track_arm": (7, 7, 5, 19, ()),
    "scara_cell": (6, 6, 1, 12, ()),
}


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "good.toml"
    path.write_text(GOOD)
    return path


@pytest.mark.parametrize("name", COUNTS)
def test_shipped_model(name):
    model = read(name)
    assert (model.n_m, model.n_g, model.n_e, model.dof, model.variants) == COUNTS[name]
    assert (model.name, model.file) == (name, f"models/{name}.toml")
    assert model.source.strip() and model.description and model.moves
    assert model.output.size == model.n_m
    for variant in model.variants:
        other = read(f"{name}@{variant}")
        assert other.variant == variant and other.file == model.file
        # elbow@fjm names what elbow is by itself; every other variant changes something
        assert (other.text == model.text) == (variant == "fjm")
    hash(model)  # all parts are immutable
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.name = "other"


def test_no_model_is_forgotten():
    assert set(COUNTS) <= set(model_names())
    assert {path.stem for path in MODELS.glob("*.toml")} <= set(model_names())


def test_values_of_planar5():
    model = read("planar5_nmp")
    first, second, third = model.elements
    assert first.dofs[0].gear == nouns.Gear(False, "arm", nouns.LinearSpring(4e5), 400.0)
    assert second.origin == nouns.Placement((0.8, 0.0, 0.0)) and second.body.mass == 40.0
    assert third.dofs[0].spring == nouns.LinearSpring(1.5e5) and not third.dofs[0].actuated
    assert third.body.com == (0.225, 0.0, 0.0) and third.body.inertia[2] == (0.0, 0.0, 0.45)
    assert np.allclose(
        model.eta.T @ np.diag([m.inertia for m in model.motors]) @ model.eta, np.diag([40, 25])
    )
    assert model.output == nouns.Output("tool_position", "xy") and model.gravity == (
        0.0,
        -9.81,
        0.0,
    )
    assert math.isclose(math.dist(model.move().displacement, (0, 0, 0)), 0.29)
    undamped = read("planar5_nmp", "undamped")
    assert [undamped.elements[i].dofs[0].gear.damping for i in (0, 1)] == [0.0, 0.0]
    assert undamped.elements[2] == third


def test_moves_of_the_manutec_respect_its_speeds():
    model = read("manutec_r3")
    limits = [dof.speed_max for element in model.elements for dof in element.dofs]
    move = model.move("joints")
    peak = 693 / 256  # of the time law with five continuous derivatives, per duration
    assert move.smoothness == 5
    for start, end, limit in zip(move.start, move.end, limits, strict=True):
        assert abs(end - start) * peak / move.duration <= limit


def chain(model, q):
    """Frames of the bodies (rotation, position) and the joints' axes, for a chain of rotations;
    own equations.
    """
    turn = np.array(model.base.rotation, dtype=complex)
    place = np.array(model.base.position, dtype=complex)
    bodies = []
    axes = []
    for element in model.elements:
        for constant in (element.origin, None, element.link):
            if constant is None:
                for dof in element.dofs:
                    x, y, z = dof.axis
                    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
                    axes.append((turn @ dof.axis, place))
                    angle = q[len(axes) - 1]
                    turn = turn @ (
                        np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
                    )
            else:
                place = place + turn @ constant.position
                turn = turn @ np.array(constant.rotation)
        bodies.append((element.body, turn, place, len(axes)))
    return bodies, axes, place + turn @ model.tool.position, turn @ np.array(model.tool.rotation)


def energy(model, q):
    """Mass matrix and potential energy, for complex q too."""
    bodies, axes, _, _ = chain(model, q)
    mass = np.zeros((model.n_a, model.n_a), dtype=complex)
    potential = 0.0
    for body, turn, place, count in bodies:
        centre = place + turn @ body.com
        speed, spin = np.zeros((2, 3, model.n_a), dtype=complex)
        for i, (axis, point) in enumerate(axes[:count]):
            speed[:, i] = np.cross(axis, centre - point)
            spin[:, i] = axis
        mass = (
            mass
            + body.mass * speed.T @ speed
            + spin.T @ turn @ np.array(body.inertia) @ turn.T @ spin
        )
        potential = potential - body.mass * np.array(model.gravity) @ centre
    return mass, potential


def derivatives(model, q):
    """Derivatives of mass matrix and potential by complex steps."""
    out = [energy(model, q + 1e-30j * unit) for unit in np.eye(model.n_a)]
    return np.array([mass.imag for mass, _ in out]) / 1e-30, np.array(
        [potential.imag for _, potential in out]
    ) / 1e-30


@pytest.mark.parametrize("variant", [None, "payload"])
def test_elbow_has_the_closed_form(variant):
    model = read("elbow", variant)
    l1 = 1.150
    l2 = 1.241
    m1 = 339.12
    x1 = 0.441
    j1 = 88.67
    g = 9.81
    m2, x2, j2 = (190.25, 0.465, 48.64) if variant is None else (340.25, 0.851, 112.7)
    rng = np.random.default_rng(1)
    for _ in range(5):
        (q1, q2), (v1, v2) = q, v = rng.uniform(-2, 2, (2, 2))
        sin = np.sin
        cos = np.cos
        both = q1 + q2
        m12 = j2 + m2 * (x2**2 - l1 * x2 * sin(q2))
        m11 = j1 + m1 * x1**2 + j2 + m2 * (l1**2 + x2**2 - 2 * l1 * x2 * sin(q2))
        h = m2 * l1 * x2 * cos(q2)
        slope, gravity = derivatives(model, q)
        coriolis = np.einsum("kij,k,j->i", slope, v, v) - 0.5 * np.einsum(
            "ijk,j,k->i", slope, v, v
        )
        assert np.allclose(
            energy(model, q)[0], [[m11, m12], [m12, j2 + m2 * x2**2]], rtol=1e-13, atol=1e-10
        )
        assert np.allclose(
            coriolis, [-h * (2 * v1 * v2 + v2**2), h * v1**2], rtol=1e-12, atol=1e-10
        )
        g2 = -g * m2 * x2 * cos(both)
        assert np.allclose(
            gravity, [-g * (m1 * x1 + m2 * l1) * sin(q1) + g2, g2], rtol=1e-12, atol=1e-10
        )
        tool = chain(model, q)[2]
        assert np.allclose(
            tool, [l1 * sin(q1) + l2 * cos(both), 0, l1 * cos(q1) - l2 * sin(both)], atol=1e-14
        )
    assert np.allclose(
        model.eta.T @ np.diag([m.inertia for m in model.motors]) @ model.eta,
        np.diag([843.9, 751.3]),
        1e-4,
    )


def test_kr300_follows_its_table():
    """Standard Denavit-Hartenberg products give the tool of the model."""
    table = [
        (0.350, -0.675, math.pi / 2, 0),
        (1.15, -0.189, 0, 0),
        (0.041, 0.189, -math.pi / 2, math.pi / 2),
        (0, -1, math.pi / 2, 0),
        (0, 0, -math.pi / 2, 0),
        (0, -0.24, math.pi, 0),
    ]
    model = read("kr300")
    q = np.array([0.3, -1.2, 1.4, 0.5, -0.6, 0.7])
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    for angle, (a, d, alpha, offset) in zip(q, table, strict=True):
        ct = math.cos(angle + offset)
        st = math.sin(angle + offset)
        ca = math.cos(alpha)
        sa = math.sin(alpha)
        pose = pose @ [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    pose = pose @ [[0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
    _, _, place, turn = chain(model, q)
    assert np.allclose(place, pose[:3, 3], atol=1e-14) and np.allclose(
        turn, pose[:3, :3], atol=1e-14
    )
    assert model.elements[0].dofs[0].lower == math.radians(-147)


def test_four_mass_output_and_inertias():
    model = read("four_mass")
    weights = np.array(model.output.weights[0])
    absolute = np.tril(np.ones((3, 3)))  # absolute angles from the relative ones
    assert np.allclose(weights, np.array([0.020, 0.600, 1.530]) @ absolute)
    assert np.allclose([e.body.inertia[2][2] / 220**2 for e in model.elements], [2e-3, 0.02, 0.02])
    assert np.allclose(
        [e.dofs[0].spring.stiffness / 220**2 for e in model.elements[1:]], [110, 80]
    )
    assert model.elements[0].dofs[0].gear.spring == nouns.SmoothSpring(16.7, 100.0, 0.064)
    kinked = read("four_mass@piecewise")
    assert kinked.elements[0].dofs[0].gear.spring == nouns.PiecewiseSpring(16.7, 100.0, 0.064)


def test_rotations_are_exact_at_right_angles():
    assert rotation_matrix((90.0, 0.0, 0.0), True) == ((1, 0, 0), (0, 0, -1), (0, 1, 0))
    assert rotation_matrix((math.pi / 2, 0.0, 0.0), False) == ((1, 0, 0), (0, 0, -1), (0, 1, 0))
    assert rotation_matrix((180.0, -90.0, 270.0), True) == rotation_matrix(
        (math.pi, -math.pi / 2, -math.pi / 2), False
    )
    for rpy in ((10.0, 20.0, 30.0), (-100.0, 95.0, 300.0)):
        a, b, c = np.radians(rpy)
        x = [[1, 0, 0], [0, math.cos(a), -math.sin(a)], [0, math.sin(a), math.cos(a)]]
        y = [[math.cos(b), 0, math.sin(b)], [0, 1, 0], [-math.sin(b), 0, math.cos(b)]]
        z = [[math.cos(c), -math.sin(c), 0], [math.sin(c), math.cos(c), 0], [0, 0, 1]]
        assert np.allclose(rotation_matrix(rpy, True), np.array(z) @ y @ x, atol=1e-15)


def test_units_and_forms(good):
    model = read(good)
    assert model.home == tuple(map(math.radians, (10.0, 20.0, -30.0)))
    assert model.base == nouns.Placement(
        (0.0, 0.0, 0.5), ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    )
    assert model.elements[0].dofs[0].axis == (0.0, 0.0, 1.0)
    assert model.elements[1].body.inertia == ((0.5, 0.01, 0.0), (0.01, 0.5, 0.0), (0.0, 0.0, 0.5))
    assert (model.move("turn").start, model.move("turn").end) == ((0.0, 0.0, 0.0), (0.1, 0.2, 0.3))
    assert isinstance(model.move("turn").duration, float)
    turned = read(
        good, overrides={"output": {"type": "tool_pose"}, "move.line.rotation_deg": [0, 0, 180]}
    )
    assert turned.move("line").rotation == (0.0, 0.0, math.pi)
    changes = {"output": {"type": "joint", "joints": ["q2", "e1"]}, "move": []}
    joint = read(good, overrides=changes).output
    assert joint == nouns.Output(
        "combination", "", ((0, 0, 1, 0, 0, 0), (0, 1, 0, 0, 0, 0)), "mixed"
    )
    assert not read(good, overrides=changes).moves
    changes["output"] = {"type": "joint", "joints": "q3"}
    assert (
        read(good, overrides=changes).output.size,
        read(good, overrides=changes).output.unit,
    ) == (1, "rad")


def test_translations_in_a_posture_are_in_m(good):
    slide = {"element.second.dof.q2.type": "translation", "element.second.dof.q2.upper": 25.0}
    assert read(good, overrides=slide).home == (math.radians(10.0), 20.0, math.radians(-30.0))


def test_a_principal_moment_too_large_passes_where_regrouped(good):
    changes = {"element.first.body.inertia": [0, 1, 0]}
    with pytest.raises(ModelError, match="sum of the other two"):
        read(good, overrides=changes)
    changes["element.first.body.inertia_reduced"] = True
    assert read(good, overrides=changes).elements[0].body.inertia[1] == (0.0, 1.0, 0.0)


def test_variants_set_and_remove(good):
    plain = read(good)
    stiff = read(f"{good}@stiff")
    assert plain.motors[0].friction == nouns.Friction(coulomb=0.3, beta=10.0)
    assert stiff.motors[0].friction == nouns.NO_FRICTION
    assert stiff.elements[0].dofs[0].gear == nouns.Gear(rigid=True)
    assert (plain.variant, stiff.variant, stiff.variants) == ("", "stiff", ("stiff",))
    assert read(good, "stiff") == stiff
    assert (
        read(good, "stiff", {"motor.m1.friction": {"viscous": 2}}).motors[0].friction.viscous
        == 2.0
    )


def test_text_depends_on_the_data_only(good, tmp_path):
    plain = read(good)
    same = tmp_path / "same.toml"
    same.write_text(
        "# a comment\n"
        + GOOD.replace("for tests", "other words").replace("duration = 1\n", "duration = 1.0\n")
    )
    assert read(same).text == plain.text
    same.write_text("source = 'a page'\n" + GOOD)
    assert read(same).text == plain.text
    assert read(good, "stiff").text != plain.text
    assert read(good, overrides={"payload.mass": 2}).text != plain.text
    data = json.loads(plain.text)
    assert json.dumps(data, sort_keys=True) == plain.text and type(data["gravity"][0]) is float
    assert data["motor"][0]["ratio"] == -100.0 and not {"description", "variant"} & set(data)


def test_overrides(good):
    assert read(good, overrides={"motor.m2.ratio": np.array([10.0, 1.0])}).motors[1].ratio == (
        10.0,
        1.0,
    )
    assert read(good, overrides={"payload.mass": np.float64(3)}).payload.mass == 3.0
    with pytest.raises(
        ModelError,
        match=r"good\.toml, changed by --set or overrides: payload\.weight: given an unknown key, "
        r"expected ",
    ):
        read(good, overrides={"payload.weight": 1})
    with pytest.raises(
        ModelError,
        match=r"overrides: motor\.m9\.inertia: given a path that does not exist, expected one of "
        r"m1, m2, m3 instead",
    ):
        read(good, overrides={"motor.m9.inertia": 1})
    loop = []
    loop.append(loop)
    for wrong in ({3: 1}, {"payload.mass": loop}):
        with pytest.raises(ArgumentError):
            read(good, overrides=wrong)
    for wrong in (
        {"payload.mass": None},
        {"payload.mass": object()},
        {"payload": {1: 2}},
        {"": 1},
        {"name.x": 1},
    ):
        with pytest.raises(ModelError):
            read(good, overrides=wrong)


def test_legs_of_a_move_are_lines_and_arcs():
    """Zones where the tool does not stop, none in the last leg; speeds in a move with a profile
    only.
    """
    first = {
        "displacement": [0.1, 0, -0.2],
        "zone": 0.05,
        "rotation_deg": [0, 90, 0],
        "speed": 0.5,
    }
    last = {"displacement": [0.3, 0, 0], "via": [0.15, 0, 0.1]}
    row = {
        "name": "corner",
        "type": "tool_polyline",
        "start_deg": [30.0, -20.0],
        "radius": 0.2,
        "smoothness": 6,
    }

    def move(*legs: dict, **more: object) -> Move:
        moved = {"move": [{**row, **more, "legs": list(legs)}], "output": {"type": "tool_pose"}}
        return read("elbow", overrides=moved).moves[0]

    found = move(first, last, profile=[1.0, 4.0, 50.0])
    turn = (0.0, math.pi / 2, 0.0)
    line = MoveL((0.1, 0.0, -0.2), zone=0.05, rotation=turn, speed=0.5)
    assert found.legs == (line, MoveC((0.3, 0.0, 0.0), via=(0.15, 0.0, 0.1)))
    assert (found.profile, found.radius, found.type) == ((1.0, 4.0, 50.0), 0.2, "tool_polyline")
    slow = {key: x for key, x in first.items() if key != "speed"}
    assert move(slow, last, duration=1.5).legs[0] == MoveL(
        (0.1, 0.0, -0.2), zone=0.05, rotation=turn
    )
    for legs, where in (
        ((first, last), "legs[0].speed"),
        ((slow, last | {"zone": 0.1}), "legs[1].zone"),
        (({key: x for key, x in slow.items() if key != "zone"}, last), "legs[0].zone"),
        ((), "legs"),
    ):
        with pytest.raises(ModelError) as caught:
            move(*legs, duration=1.5)
        assert caught.value.key == f"move.corner.{where}"


def test_lookup(good, monkeypatch):
    with pytest.raises(ArgumentError, match=r"planar5_nmp \(there are: abb_arm, beam_arm"):
        read("planar5_nnp")
    with pytest.raises(ArgumentError, match="given 'limp', expected one of stiff"):
        read(good, "limp")
    with pytest.raises(ArgumentError, match="one variant name"):
        read(f"{good}@stiff", "limp")
    with pytest.raises(ArgumentError, match="one variant name"):
        read("elbow@")
    monkeypatch.setenv("FLEXGEN_MODELS", str(good.parent))
    assert "good" in model_names() and "elbow" in model_names()
    assert read("good@stiff").file == str(good)
    monkeypatch.setenv("FLEXGEN_MODELS", str(good))
    for call in (model_names, lambda: read("elbow")):
        with pytest.raises(
            ArgumentError, match=r"FLEXGEN_MODELS: given '.*good.toml', which is not a folder"
        ):
            call()
    assert read(good).name == "robot"  # a path needs no folder
    monkeypatch.delenv("FLEXGEN_MODELS")
    monkeypatch.chdir(good.parent)
    assert read("good.toml").file == "good.toml"
    folder = good.parent / "models"
    folder.mkdir()
    good.rename(folder / "mine.toml")
    assert read("mine").file == "models/mine.toml"
    assert read("elbow").file == str(MODELS / "elbow.toml")


def test_the_users_own_models_go_first(good, monkeypatch):
    """A name means the file that its error messages and its description show, seen from the
    current directory.
    """
    own = good.parent / "models" / "elbow.toml"
    named = good.parent / "named" / "elbow.toml"
    for path, text in ((own, "own"), (named, "named")):
        path.parent.mkdir()
        path.write_text(GOOD.replace("for tests", text))
    monkeypatch.chdir(good.parent)
    assert (read("elbow").description, read("elbow").file) == ("own", "models/elbow.toml")
    monkeypatch.setenv("FLEXGEN_MODELS", "named")
    assert (read("elbow").description, read("elbow").file) == ("named", "named/elbow.toml")
    monkeypatch.chdir(own.parent)
    monkeypatch.setenv("FLEXGEN_MODELS", str(named.parent))
    assert read("elbow").file == str(named)
    named.write_text("name = 3\n")
    with pytest.raises(ModelError, match=f"^{re.escape(str(named))}:1:element: "):
        read("elbow")


def test_the_models_of_an_installed_package_are_inside_it(good, tmp_path, monkeypatch):
    """Not in a folder next to the package, which may be of another one."""
    package = tmp_path / "site" / "flexgen"
    for folder, name in (
        (package / "model" / "shipped", "inside"),
        (package.parent / "models", "beside"),
    ):
        folder.mkdir(parents=True)
        (folder / f"{name}.toml").write_bytes(good.read_bytes())
    monkeypatch.setattr(reader, "__file__", str(package / "model" / "reader.py"))
    monkeypatch.delenv("FLEXGEN_MODELS", raising=False)
    monkeypatch.chdir(package.parent.parent)
    assert model_names() == ["inside"]
    assert read("inside").name == read(good).name
    with pytest.raises(
        ArgumentError, match=r"given 'beside', expected .* or inside \(there are: inside\)"
    ):
        read("beside")


def test_only_regular_files_are_models(good, monkeypatch):
    folder = good.parent
    (folder / "folder.toml").mkdir()
    (folder / "dangling.toml").symlink_to(folder / "nothing")
    (folder / "linked.toml").symlink_to(good)
    (folder / ".hidden.toml").write_text(GOOD)
    (folder / "evil\x1b[2J.toml").write_text(GOOD)
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "fifo.toml")
    before = set(model_names())
    monkeypatch.setenv("FLEXGEN_MODELS", str(folder))
    assert set(model_names()) - before == {"good", "linked"}


def test_byte_order_mark_and_size(good):
    good.write_bytes(b"\xef\xbb\xbf" + GOOD.encode())
    assert read(good).name == "robot"
    good.write_bytes(b'\xef\xbb\xbfname = "a"\nsource = "\xff"\n')
    with pytest.raises(ModelError, match=r"good\.toml:2:file: given the byte 0xff"):
        read(good)
    spring = 'type = "rotation"\naxis = [0, 0, 1]\nspring = { type = "linear", stiffness = 1.0 }\n'
    many = "".join(f'[[element.dof]]\nname = "x{k}"\n{spring}' for k in range(1500))
    good.write_text(
        GOOD.replace('[[element]]\nname = "second"', f'{many}[[element]]\nname = "second"')
    )
    with pytest.raises(ModelError, match="given 1506 coordinates, expected at most 64"):
        read(good)


@pytest.mark.parametrize("x", [4.3e-5, 5e-6, 1e7, 257.0, 1e-12, 1e12])
def test_plausible_numbers_are_accepted(good, x):
    assert read(good, overrides={"motor.m1.inertia": x}).motors[0].inertia == x
    assert read(good, overrides={"payload.com": [x, 0, -x]}).payload.com == (x, 0.0, -x)


def test_rounding_errors_in_a_vector_are_accepted(good):
    gravity = (6e-17, 0.0, -9.81)
    assert read(good, overrides={"gravity": gravity}).gravity == gravity


def test_every_key_of_a_shipped_file_is_located():
    """The line of each value contains the last key of its path (or the value itself in a list)."""
    for path in MODELS.glob("*.toml"):
        text = path.read_text()
        lines = text.split("\n")

        def look(entry, key, lines=lines):
            if isinstance(entry.value, dict):
                for name, child in entry.value.items():
                    assert re.search(rf"\b{re.escape(name)}\b", lines[child.line - 1]), (
                        name,
                        child.line,
                    )
                    look(child, name)
            elif isinstance(entry.value, list):
                for child in entry.value:
                    look(child, key)

        root = parse(text)
        look(root, "")
        assert unwrap(root)["name"] == path.stem


def test_tables_and_keys_have_the_line_where_they_are_first_named():
    text = "first = 1\n\n[a.b]\nc = 2\n[a]\nd = {\n}\n[[many]]\n[[many]]\ne = [\n1]\n".replace(
        "{\n}", "{ x = 1 }"
    )
    lines = Scanner(text).lines
    expected = {
        ("first",): 1,
        ("a",): 3,
        ("a", "b"): 3,
        ("a", "b", "c"): 4,
        ("a", "d"): 6,
        ("many",): 7,
        ("many", 0): 7,
        ("many", 1): 8,
        ("many", 1, "e"): 9,
    }
    assert {path: lines[path] for path in expected} == expected


def test_values_without_a_file_have_line_zero():
    entry = wrap({"a": [1, {"b": 2}]})
    assert {(x.line, x.file) for x in (entry, *leaves(entry))} == {(0, "")}
