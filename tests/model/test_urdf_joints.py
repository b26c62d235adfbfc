"""Joints, links and their ends in a URDF file, by the rules of the format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from flexgen.base.errors import ArgumentError, ModelError
from flexgen.model.reader import read
from flexgen.model.urdf import urdf_source
from flexgen.model.urdf.urdf import Inertial, Urdf
from flexgen.model.urdf.urdf_chain import lump_bodies


def urdf_of(folder: Path, inside: str, kind: str = "continuous") -> Urdf:
    """A robot with one joint, ``j``."""
    links = '<link name="a"/><link name="b"/>'
    joint = f'<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>{inside}</joint>'
    (folder / "r.urdf").write_text(f'<robot name="r">\n{links}\n{joint}\n</robot>\n')
    return Urdf(folder / "r.urdf", "r.urdf")


ZERO = (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("inside", "axis", "xyz", "rpy", "mimic", "losses"),
    [
        ("", (1, 0, 0), ZERO, ZERO, None, (0.0, 0.0)),
        (
            '<origin xyz="1 2 3"/><mimic joint="k"/><dynamics friction="0.4"/>'
            '<axis xyz="0 0.6 0.8"/>',
            (0, 0.6, 0.8),
            (1, 2, 3),
            ZERO,
            ("k", 1.0, 0.0),
            (0.0, 0.4),
        ),
        (
            '<origin rpy="0.1 0.2 0.3"/><mimic joint="k" multiplier="-2" offset="0.5"/>'
            '<dynamics damping="0.3"/><axis xyz="0 0 1.1"/>',
            (0, 0, 1),
            ZERO,
            (0.1, 0.2, 0.3),
            ("k", -2.0, 0.5),
            (0.3, 0.0),
        ),
    ],
)
def test_what_a_joint_leaves_out_has_the_default_of_the_format(
    inside: str, axis: Any, xyz: Any, rpy: Any, mimic: Any, losses: Any, tmp_path: Path
) -> None:
    """A limit has no default; axes are normalized."""
    found = urdf_of(tmp_path, inside)
    joint = found.joints["j"]
    assert_allclose(found.axis(joint), axis, atol=1e-15)
    origin = found.origin(joint)
    assert_allclose(origin.position, xyz)
    assert_allclose(origin.rotation, Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-15)
    given = found.mimic(joint)
    assert mimic == (given and (given.leader, given.factor, given.offset))
    assert found.dynamics(joint) == (joint.node.line, *losses) and found.limit(joint) is None


@pytest.mark.parametrize("text", ["0 0.57735 0.816497", "0 0 1.1", "1e-9 0 1e-9", "0 0 0"])
def test_the_axis_of_a_joint_is_a_direction(text: str, tmp_path: Path) -> None:
    found = urdf_of(tmp_path, f'<axis xyz="{text}"/>')
    if text != "0 0 0":
        assert np.linalg.norm(found.axis(found.joints["j"])) == pytest.approx(1.0, abs=1e-15)
        return
    with pytest.raises(ModelError, match="expected a direction that is not zero"):
        found.axis(found.joints["j"])


BOTH = 'effort="2" velocity="3" lower="-1" upper="1.5"'


@pytest.mark.parametrize(
    ("kind", "limit", "expected"),
    [
        ("revolute", BOTH, (2.0, 3.0, -1.0, 1.5)),
        ("continuous", BOTH, (2.0, 3.0, None, None)),
        ("continuous", 'effort="0" velocity="1"', 'effort: given "0", expected a number > 0'),
        ("continuous", 'effort="1" velocity="-1"', 'velocity: given "-1", expected a number > 0'),
        (
            "revolute",
            'effort="1" velocity="1" lower="1" upper="1"',
            "given lower 1, upper 1, expected a lower limit",
        ),
        (
            "revolute",
            'effort="1" velocity="1" lower="1"',
            "upper: given nothing, expected a number",
        ),
    ],
)
def test_limits_of_a_joint(kind: str, limit: str, expected: Any, tmp_path: Path) -> None:
    found = urdf_of(tmp_path, f"<limit {limit}/>", kind)
    joint = found.joints["j"]
    if isinstance(expected, tuple):
        made = found.limit(joint)
        assert made is not None
        assert (made.effort, made.velocity, made.lower, made.upper) == expected
        return
    with pytest.raises(ModelError, match=expected):
        found.limit(joint)


def body(m: np.ndarray, r: np.ndarray, reduced: bool = False) -> Inertial:
    """Point masses at r (n, 3)."""
    com = (m[:, None] * r).sum(axis=0) / m.sum()
    tensor = sum(x * (d @ d * np.eye(3) - np.outer(d, d)) for x, d in zip(m, r - com, strict=True))
    return Inertial(float(m.sum()), com, np.asarray(tensor), reduced)


def test_bodies_that_are_fixed_to_each_other_are_one() -> None:
    """Mass, center and inertia are those of all points."""
    rng = np.random.default_rng(2)
    m = rng.uniform(0.5, 2.0, (3, 6))
    r = rng.normal(size=(3, 6, 3))
    found = lump_bodies([body(m[k], r[k], k == 1) for k in range(3)])
    whole = body(m.ravel(), r.reshape(-1, 3))
    assert found is not None and found.mass == pytest.approx(whole.mass) and found.reduced
    assert_allclose(found.com, whole.com)
    assert_allclose(found.inertia, whole.inertia, atol=1e-12)
    assert lump_bodies([]) is None and lump_bodies([found]) is found
    pair = lump_bodies([whole, whole])
    assert pair is not None and not pair.reduced


@pytest.mark.parametrize(
    ("moments", "reduced", "given", "expected"),
    [
        ((1.0, 2.0, 3.0), False, "", ""),
        ((1e-7, 2e-7, 3e-7), False, "", ""),
        ((0.0, 2.0, 2.0), False, "", ""),
        ((1.0, 1.0, 2.1), True, "", ""),
        ((1.0, 1.0, 2.1), False, "principal moments 1, 1, 2.1", "no moment larger than the sum"),
        ((2.1, 1.0, 1.0), False, "principal moments 1, 1, 2.1", "no moment larger than the sum"),
        ((-0.5, 1.0, 1.0), True, "principal moments -0.5, 1, 1", r"principal moments >= 0 \(or"),
        ((-5e-10, 1.0, 1.0), True, "", ""),
        ((-5e-9, 1.0, 1.0), True, "principal moments -5e-09, 1, 1", "principal moments >= 0"),
    ],
)
def test_principal_moments_of_a_link_are_those_of_a_body(
    moments: Any, reduced: bool, given: str, expected: str, tmp_path: Path
) -> None:
    """Three principal moments of a body with mass fulfill the inequality of a triangle; an
    inertia that was reduced by those of rotors need not.
    """
    names = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    entries = " ".join(f'{n}="{x}"' for n, x in zip(names, (*moments, 0, 0, 0), strict=True))
    link = f'<inertial><mass value="1"/><inertia {entries}/></inertial>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r">\n<link name="arm">{link}</link></robot>')
    found = Urdf(tmp_path / "r.urdf", "r.urdf")
    if not expected:
        found.inertial(found.links["arm"], reduced)
        return
    with pytest.raises(ModelError, match=f"given {given}, expected {expected}"):
        found.inertial(found.links["arm"], reduced)


@pytest.fixture
def workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Packages in the folders that three variables of ROS name."""
    for name, place in PLACES.items():
        (tmp_path / place / "urdf").mkdir(parents=True)
        (tmp_path / place / "urdf" / f"{name}.urdf").write_text(f'<robot name="{name}"/>')
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'ros1'}:{tmp_path / 'itself' / 'arm'}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path / 'none'}:{tmp_path / 'ament'}")
    return tmp_path


PLACES = {"a": "ros1/arm", "b": "itself/arm", "c": "ament/share/arm"}


def test_packages_are_searched_in_the_folders_of_their_variables(workspace: Path) -> None:
    for name, place in PLACES.items():
        found = urdf_source.locate(f"package://arm/urdf/{name}.urdf", Path("/"))
        assert found == workspace / place / "urdf" / f"{name}.urdf"
    file = workspace / "ros1/arm/urdf/a.urdf"
    assert urdf_source.locate("ros1/arm/urdf/a.urdf", workspace) == file


@pytest.mark.parametrize(
    "name",
    [
        "package://arm/urdf/d.urdf",
        "package://arm",
        "package:///urdf/a.urdf",
        "package://arm/../arm/urdf/a.urdf",
        "ros1/arm",
        "a\0b",
    ],
)
def test_files_that_are_not_found(name: str, workspace: Path) -> None:
    assert urdf_source.locate(name, workspace) is None


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    joint = '<joint name="j" type="fixed"><parent link="base"/><child link="tip"/></joint>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="r"><link name="base"/><link name="tip"/>{joint}</robot>'
    )
    (tmp_path / "own.toml").write_text("name = 'x'")
    (tmp_path / "over.toml").write_text('[urdf]\nfile = "arm.urdf"')
    (tmp_path / "bad.toml").write_text("[urdf\n")
    return tmp_path


@pytest.mark.parametrize(
    ("given", "names"),
    [
        ("", []),
        ("none.toml", []),
        ("own.toml", ["own.toml"]),
        ("over.toml", ["over.toml", "arm.urdf"]),
        ("bad.toml", ["bad.toml"]),
        ("arm.urdf#base:tip", ["arm.urdf"]),
        ("arm.urdf", ["arm.urdf"]),
    ],
)
def test_files_that_a_robot_is_read_from(given: str, names: list[str], files: Path) -> None:
    assert [path.name for path in urdf_source.source_files(given)] == names
    assert urdf_source.from_here(files / "own.toml") == "own.toml"
    assert urdf_source.from_here(Path("/usr")) == "/usr"


BOTH_ENDS = r"the two ends .*expected arm\.urdf#BASE:TIP .*, such as .base. and one of .tip."


@pytest.mark.parametrize(
    ("ends", "text"),
    [
        (("arm.urdf#base:tip", None, None), ""),
        (("arm.urdf", "base", "tip"), ""),
        (("elbow", "base", None), "^base and tip: given with the model 'elbow', expected a .urdf"),
        (
            ("arm.urdf#base:tip", None, "tip"),
            "^base and tip: given in addition to 'arm.urdf#base:tip', expected each",
        ),
        (("arm.urdf", 3, "tip"), "^base: given 3, expected the name of a link$"),
        (("none.urdf", "base", "tip"), "^model: given 'none.urdf', which is not a file, expected"),
        (("package://x/y.urdf", "base", "tip"), "given 'package://x/y.urdf', which is not a file"),
        (("arm.urdf", "base", None), BOTH_ENDS),
    ],
)
def test_ends_of_a_plain_file_are_given_once(ends: Any, text: str, files: Path) -> None:
    if not text:
        found = urdf_source.plain_urdf(*ends)
        assert found is not None and found[1:] == ("arm.urdf", "arm.urdf#base:tip")
        assert urdf_source.plain_urdf(3, None, None) is None
        assert urdf_source.plain_urdf("elbow", None, None) is None
        return
    with pytest.raises(ArgumentError, match=text):
        urdf_source.plain_urdf(*ends)


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
    ],
)
@pytest.mark.parametrize("where", ["urdf", "overlay"])
def test_the_home_of_a_joint_is_zero_or_within_its_limits(
    where: str, lower: float | None, upper: float | None, home: float, tmp_path: Path
) -> None:
    """Midway between two limits; limits of the overlay replace those of the file."""
    ends = {"lower": lower, "upper": upper}
    limit = 'effort="1" velocity="1"'
    text = "".join(f' {name}="{x}"' for name, x in ends.items() if x is not None)
    if where == "urdf" and None in ends.values():
        pytest.skip("a revolute joint of a URDF file has both limits")
    kind = "revolute" if where == "urdf" else "continuous"
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
    links = f'<link name="a"/><link name="b">{inertial}iyz="0"/></inertial></link>'
    inside = f"<limit {limit}{text if where == 'urdf' else ''}/>"
    joint = f'<joint name="j" type="{kind}"><parent link="a"/><child link="b"/>{inside}</joint>'
    (tmp_path / "r.urdf").write_text(f'<robot name="r">\n{links}\n{joint}\n</robot>\n')
    rows = ['[urdf]\nfile = "r.urdf"\nbase = "a"\ntip = "b"', "[joint.j]"]
    rows += [
        f"{name}_rad = {x}" for name, x in ends.items() if where == "overlay" and x is not None
    ]
    (tmp_path / "r.toml").write_text("\n".join(rows) + "\n")
    assert read(tmp_path / "r.toml").home == (home,)
