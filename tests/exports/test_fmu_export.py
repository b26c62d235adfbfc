"""The files of an FMU: same bytes, escaped texts, no names of the model in its C; wrong arguments;
the command.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET
import zipfile
from dataclasses import replace
from types import SimpleNamespace as Held

import fmus
import numpy as np
import pytest

import flexgen
from flexgen.base.errors import ArgumentError, BuildError, ModelError
from flexgen.cli.main import main
from flexgen.exports.fmu import binaries, feedforward
from flexgen.exports.fmu import export as export_module
from flexgen.exports.fmu.controller import controller
from flexgen.exports.fmu.description import element, variable_3
from flexgen.exports.fmu.variables import STATUS


def files_of(path):
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def sources_of(tmp_path, model="four_mass", **options):
    path = tmp_path / "sources.fmu"
    flexgen.export_fmu(model, path, binary=False, **options)
    return files_of(path)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_the_same_input_gives_the_same_bytes(version, tmp_path):
    a = flexgen.export_fmu("four_mass", tmp_path / "a.fmu", binary=False, version=version)
    b = flexgen.export_fmu("four_mass", tmp_path / "b.fmu", binary=False, version=version)
    assert a.path.read_bytes() == b.path.read_bytes() and a.details["token"] == b.details["token"]
    c = flexgen.export_fmu(
        "four_mass", tmp_path / "c.fmu", binary=False, version=version, step=1e-5
    )
    assert c.details["token"] != a.details["token"]  # another content, another token
    with zipfile.ZipFile(a.path) as archive:
        assert {info.date_time for info in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}
        # texts are not executable
        assert {info.external_attr >> 16 for info in archive.infolist()} == {0o644}


@pytest.mark.parametrize("output", ["pose", "position", "combination"])
def test_the_path_of_a_feedforward_begins_at_home_with_the_units_of_the_output(output):
    """Of a pose: the position, and the rotation matrix by columns, which has no unit; its rates
    are rotations.
    """
    if output == "combination":
        model = flexgen.read("four_mass")
        units = ["m"]
        rates = ["m"]
        start = [0.7 * np.array(model.output.weights).sum()]
        q_a = np.full(model.n_a, 0.7)
    else:
        model = flexgen.read("elbow")
        axes = ("y", "x") if output == "position" else "xyz"
        model = replace(model, output=replace(model.output, type=f"tool_{output}", axes=axes))
        q_a = np.array([0.3, 0.4])
        p, R = (np.array(x) for x in flexgen.derive(model).function("forward_kinematics")(q_a))
        units = ["m"] * 2
        rates = ["m"] * 2
        start = [p[1, 0], p[0, 0]]
        if output == "pose":
            units = ["m"] * 3 + ["1"] * 9
            rates = ["m"] * 3 + ["rad"] * 3
            start = [*p.ravel(), *R[:, 0], *R[:, 1], *R[:, 2]]
    held = Held(q_a=q_a)
    found = feedforward.path_inputs(model, flexgen.derive(model), held, Held(look_ahead=0.25))
    np.testing.assert_allclose(
        [x.start for x in found], [*start, *np.zeros(2 * len(rates))], atol=1e-12
    )
    assert [x.unit for x in found] == [
        *units,
        *(f"{x}/s" for x in rates),
        *(f"{x}/s2" for x in rates),
    ]
    kinds = [("position", len(units)), ("velocity", len(rates)), ("acceleration", len(rates))]
    assert [x.name for x in found] == [
        f"path.{kind}[{k + 1}]" for kind, count in kinds for k in range(count)
    ]
    assert [x.index for x in found] == list(range(len(found))) and all(x.sampled for x in found)
    matrix = "rotation matrix by columns of the path, 0.25 s ahead"
    assert [x.text for x in found[3 : len(units)]] == [matrix] * max(len(units) - 3, 0)
    assert found[0].text == "position of the path, 0.25 s ahead"


@pytest.mark.slow
@pytest.mark.parametrize("block", ["plant", "controller"])
def test_with_a_binary_too(block, tmp_path):
    given = {"controller": fmus.cascade(1)} if block == "controller" else {}
    paths = [
        flexgen.export_fmu("four_mass", tmp_path / f"{k}.fmu", block=block, **given).path
        for k in "ab"
    ]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    assert str(tmp_path).encode() not in b"".join(files_of(paths[0]).values())


def test_the_fmu_contains_one_c_file_headers_and_description(tmp_path):
    """One C file and the headers of the standard."""
    files = sources_of(tmp_path)
    standard = {
        f"sources/fmi2{name}.h" for name in ("Functions", "FunctionTypes", "TypesPlatform")
    }
    fixed = {"modelDescription.xml", "documentation/licenses/license.txt"}
    assert set(files) == {"sources/all.c"} | standard | fixed
    included = set(re.findall(rb'#\s*include "([^"]+)"', files["sources/all.c"]))
    assert included == {b"fmi2Functions.h"}
    assert "sources/buildDescription.xml" in sources_of(tmp_path, version="3.0")


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_texts_of_the_model_are_escaped(version, tmp_path):
    """A description with the characters of XML is read back as it was, and is nowhere in the C."""
    text = '<a href="x">\'&amp;\n*/ #include "evil.h" \u00e9'
    model = replace(flexgen.read("four_mass"), description=text)
    files = sources_of(tmp_path, model, version=version)
    root = ET.fromstring(files["modelDescription.xml"])
    assert root.get("description") == text
    assert not any(b"evil" in data for name, data in files.items() if name.endswith((".c", ".h")))


def test_control_characters_do_not_break_the_description():
    line = "\n".join(element("A", {"b": "x\x00\x1f\ud800y"}))
    assert ET.fromstring(line).get("b") == "x???y"


def test_names_of_motors_are_not_in_the_hand_written_c(tmp_path):
    model = flexgen.read("four_mass")
    (motor,) = model.motors
    model = replace(model, motors=(replace(motor, name="unusual_motor"),))
    files = sources_of(tmp_path, model)
    # comments of the header name them
    code = re.sub(rb"/\*.*?\*/", b"", files["sources/all.c"], flags=re.DOTALL)
    assert b"unusual_motor" not in code and b"fmi2DoStep" in code and b"four_mass_" in code
    assert b"motor.unusual_motor.torque" in files["modelDescription.xml"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"version": "1.0"}, "version: given '1.0', expected one of 2.0, 3.0"),
        (
            {"block": "robot"},
            "block: given 'robot', expected one of plant, feedforward, controller",
        ),
        ({"method": "euler"}, "method: given 'euler', expected one of rk4, sdirk4"),
        ({"step": 0.0}, "step: given 0.0, expected a time"),
        ({"step": float("nan")}, "step: given nan"),
        (
            {"block": "controller", "controller": fmus.cascade(1), "sample_time": "fast"},
            "sample_time: given 'fast'",
        ),
        (
            {"block": "controller", "controller": 3},
            "controller: given int, expected a flexgen.Cascade",
        ),
        (
            {"sample_time": 1e-3},
            "sample_time: given one for the block 'plant', expected it with block='controller'",
        ),
        ({"look_ahead": 0.05}, "look_ahead: given one for the block 'plant'"),
        (
            {"block": "feedforward", "method": "rk4"},
            "method: given one for the block 'feedforward'",
        ),
        (
            {"block": "feedforward", "sample_time": 1e-3},
            "sample_time: given one for the block 'feedforward'",
        ),
        (
            {"block": "controller", "controller": fmus.cascade(1), "step": 1e-4},
            "step: given one for the block",
        ),
        ({"block": "plant", "controller": fmus.cascade(1)}, "expected it with block='controller'"),
        ({"block": "controller", "controller": fmus.cascade(2)}, "one for each motor"),
    ],
)
def test_wrong_arguments(options, message, tmp_path):
    path = tmp_path / "robot.fmu"
    with pytest.raises(ArgumentError, match=message.replace("(", r"\(")):
        flexgen.export_fmu("four_mass", path, **options)
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_path_and_model(tmp_path):
    with pytest.raises(
        ArgumentError, match=r"robot\.zip.*, expected the path of a file that ends in \.fmu"
    ):
        flexgen.export_fmu("four_mass", tmp_path / "robot.zip", binary=False)
    with pytest.raises(ArgumentError, match=r"path: given '.*robot\.zip'"):
        # not PosixPath('...')
        flexgen.export_fmu("four_mass", tmp_path / "robot.zip", binary=False)
    with pytest.raises(ArgumentError, match="path: given 5"):
        flexgen.export_fmu("four_mass", 5, binary=False)
    with pytest.raises((ArgumentError, ModelError), match="no_such"):
        flexgen.export_fmu("no_such", tmp_path / "robot.fmu")


def test_a_model_without_inverse_dynamics_has_no_feedforward(tmp_path):
    model = flexgen.read("planar5_nmp@coupled", overrides={"motor.m2.carrier": "arm2"})
    with pytest.raises(ArgumentError, match=r"block 'feedforward': .*joint q2 turns a motor"):
        flexgen.export_fmu(model, tmp_path / "robot.fmu", block="feedforward")
    with pytest.raises(ArgumentError, match=r"look_ahead: given 0\.0123 s"):
        flexgen.export_fmu(
            "four_mass", tmp_path / "robot.fmu", block="feedforward", look_ahead=0.0123
        )


def test_a_robot_without_passive_coordinates_has_a_feedforward(tmp_path):
    files = sources_of(tmp_path, "elbow", block="feedforward")
    assert (
        b"elbow_stream_update(" in files["sources/all.c"]
        and b"path.position[2]" in files["modelDescription.xml"]
    )


# Names of fixed files without their prefix; names in C; a header of the standard; the prefix.
NAMES = {
    "plant": "",
    "config": "",
    "fmi2": "",
    "controller": "",
    "warnings": "",
    "core": "core_status",
    "n": "N_WORK",
    "fmi2Functions": "fmi2Functions.h",
    "Flexgen_fmu_x": "Flexgen_fmu_x.c",
}


@pytest.mark.parametrize(("name", "problem"), NAMES.items())
def test_names_of_models_do_not_collide_with_the_fixed_files(name, problem, tmp_path):
    """The sources compile, with all files there, or the name is refused."""
    model = replace(flexgen.read("four_mass"), name=name)
    if problem:
        with pytest.raises(
            BuildError, match=rf"given '{name}', which gives {problem}, a name of the fixed files"
        ):
            sources_of(tmp_path, model)
        assert list(tmp_path.iterdir()) == []
        return
    files = sources_of(tmp_path, model)
    assert f"{name}_status_text(".encode() in files["sources/all.c"]
    for file, data in files.items():
        if file.startswith("sources/"):
            (tmp_path / file.removeprefix("sources/")).write_bytes(data)
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    words = [
        compiler,
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-fsyntax-only",
        *map(str, tmp_path.glob("*.c")),
    ]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:1000]


def test_missing_declarations_stop_the_compiler(monkeypatch, tmp_path):
    """A function that is nowhere declared gives no FMU, also with a compiler that only warns of
    it.
    """
    texts = export_module.texts_of
    wrong = "void f(void);\nvoid f(void)\n{\n    nowhere_declared();\n}\n"

    def planted(block, version):
        found, token = texts(block, version)
        return {**found, "sources/all.c": wrong}, token

    monkeypatch.setattr(export_module, "texts_of", planted)
    with pytest.raises(BuildError, match="nowhere_declared"):
        flexgen.export_fmu("four_mass", tmp_path / "robot.fmu")
    assert list(tmp_path.iterdir()) == []


def test_the_payload_is_in_the_frame_that_the_tool_is_attached_to(tmp_path):
    root = ET.fromstring(sources_of(tmp_path)["modelDescription.xml"])
    texts = {v.get("name"): v.get("description") for v in root.iter("ScalarVariable")}
    assert (
        texts["payload.com[1]"]
        == "its center of mass in the frame that the tool is attached to, x"
    )


def test_without_a_compiler(monkeypatch, tmp_path):
    monkeypatch.setattr(binaries, "find_compiler", lambda **options: None)
    old = tmp_path / "robot.fmu"
    old.write_bytes(b"before")
    with pytest.raises(
        BuildError, match="binary=False in Python, --no-binary on the command line"
    ):
        flexgen.export_fmu("four_mass", old)
    assert old.read_bytes() == b"before"


def test_the_command(tmp_path, capsys):
    path = tmp_path / "robot.fmu"
    assert (
        main(
            [
                "export",
                "fmu",
                "four_mass",
                "--fmi",
                "3.0",
                "--no-binary",
                "--out",
                str(path),
                "--json",
                "-q",
            ]
        )
        == 0
    )
    data = json.loads(capsys.readouterr().out)
    assert data["version"] == "3.0" and data["binary"] is None and path.exists()
    assert {
        "name": "motor.m1.torque",
        "reference": 3000,
        "causality": "input",
        "unit": "N.m",
        "start": 0.0,
    } in [
        {key: v[key] for key in ("name", "reference", "causality", "unit", "start")}
        for v in data["variables"]
    ]
    words = [
        "export",
        "fmu",
        "four_mass",
        "--block",
        "controller",
        "--no-binary",
        "--out",
        str(path),
        "-q",
    ]
    assert main(words) == 0 and "motor.m1.position_gain" in capsys.readouterr().out
    assert main(["export", "fmu", "four_mass", "--controller", "x.toml"]) == 1
    assert (
        "controller: given one for the block 'plant', expected it with block='controller' only"
        in " ".join(capsys.readouterr().err.split())
    )
    assert (
        main(["export", "fmu", "four_mass", "--block", "feedforward", "--sample-time", "0.001"])
        == 1
    )
    assert "sample_time: given one for the block 'feedforward'" in capsys.readouterr().err
    for given in ("x.toml", "x.txt"):
        assert main([*words, "--controller", str(tmp_path / given)]) == 1
        assert f"{given}', which does not exist" in " ".join(capsys.readouterr().err.split())
    (tmp_path / "foo.txt").touch()
    assert main([*words, "--controller", str(tmp_path / "foo.txt")]) == 1
    assert "foo.txt', expected a file .toml" in " ".join(capsys.readouterr().err.split())
    assert main(["export", "fmu", "four_mass", "--block", "robot"]) == 2
    assert main(["export", "fmu", "four_mass", "--out", str(tmp_path)]) != 0


def test_the_angles_and_torques_of_a_controller_are_discrete():
    model = flexgen.read("planar5_nmp")
    found = controller(model, None, 1e-3).variables
    kinds = {
        v.name.rpartition(".")[2]: v.variability for v in found if v.name.startswith("motor.")
    }
    sampled = ("measured_angle", "reference_angle", "feedforward_torque", "torque")
    assert all(kinds[name] == "discrete" for name in sampled) and len(kinds) > len(sampled)
    assert not any(kind == "discrete" for name, kind in kinds.items() if name not in sampled)
    for v in found:
        assert f'<Float64 name="{v.name}"' in " ".join(
            variable_3(v)
        ) and f'unit="{v.unit}"' in " ".join(variable_3(v))
    (status,) = variable_3(replace(found[-1], kind=STATUS))
    assert status.startswith("<Int32") and "unit=" not in status
