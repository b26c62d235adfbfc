"""The command line from recorded motions to parameters: rigid bodies, segments, sensors,
transients.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.spec.number_edit import with_numbers
from flexgen.cli.main import main
from flexgen.dynamics.mechanics.parameters import select

T = 4e-3
SENSOR = """
[[sensor]]
name = "acc"
type = "accelerometer"
element = "tool"
axes = ["x"]
unit = "m/s^2"
noise = 0.01
"""


def rigid_recordings(folder: Path, phases: tuple[float, ...] = (0.0, 1.0)) -> list[Path]:
    """Recordings of the rigid elbow with other bodies, friction and encoders on the links; one
    file each.
    """
    path = flexgen.read("elbow@rigid").file
    text = Path(path).read_text()
    for joint in ("q1", "q2"):
        text += (
            "\n"
            "[[sensor]]\n"
            f'name = "on_{joint}"\n'
            'type = "link_encoder"\n'
            f'coordinate = "{joint}"\n'
            'unit = "rad"\n'
        )
    (folder / "robot.toml").write_text(text)
    model = flexgen.read(folder / "robot.toml", "rigid")
    equations = flexgen.derive(model)
    t = T * np.arange(1500)
    out = []
    for k, phase in enumerate(phases):
        w = np.array([1.3, 2.1]) + 0.2 * k
        q = 0.8 * np.sin(w * t[:, None] + phase) + 0.3 * np.sin(2.7 * w * t[:, None])
        v = 0.8 * w * np.cos(w * t[:, None] + phase) + 0.3 * 2.7 * w * np.cos(2.7 * w * t[:, None])
        a = -0.8 * w**2 * np.sin(w * t[:, None] + phase) - 0.3 * (2.7 * w) ** 2 * np.sin(
            2.7 * w * t[:, None]
        )
        arm = evaluate(equations.function("inverse_dynamics"), q, v, a)[0]
        inertia = np.array([motor.inertia for motor in model.motors])
        friction = 0.5 * np.tanh(v / 5e-4) + 0.01 * (v @ model.eta.T)
        tau = inertia * (a @ model.eta.T) + 1.1 * arm @ np.linalg.inv(model.eta) + friction
        q_m = q @ model.eta.T
        link = q - 1e-6 * (1.1 * arm)
        np.savez(folder / f"run{k}.npz", t=t, tau=tau.T, q=q_m.T, link=link.T)
        rows = ['model = "robot.toml"', 'hold = "none"', '[time]\nname = "t"\nunit = "s"']
        for kind, unit, name in (("torque", "N m", "tau"), ("angle", "rad", "q")):
            for j, motor in enumerate(model.motors):
                rows.append(
                    f"[[{kind}]]\n"
                    f'motor = "{motor.name}"\n'
                    f'name = "{name}"\n'
                    f"index = {j}\n"
                    f'unit = "{unit}"\n'
                    'side = "motor"'
                )
        for j, joint in enumerate(("q1", "q2")):
            rows.append(
                f'[[signal]]\nsensor = "on_{joint}"\nname = "link"\nindex = {j}\nunit = "rad"'
            )
        rows.append(f'[[recording]]\nfile = "run{k}.npz"')
        out.append(folder / f"run{k}.toml")
        out[-1].write_text("\n".join(rows))
    return out


def test_rigid_bodies_from_the_command_line(tmp_path, capsys):
    first, second = rigid_recordings(tmp_path)
    new = tmp_path / "new.toml"
    robot = f"{tmp_path / 'robot.toml'}@rigid"
    words = [
        "identify",
        robot,
        str(first),
        "--rigid",
        "--validate",
        str(second),
        "--out",
        str(new),
        "--json",
    ]
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert (
        max(found["relative_errors"]["fitted"][0]) < 0.02
        and max(found["relative_errors"]["validated"][0]) < 0.03
    )
    assert found["status"] == "fitted"
    coulomb = next(row for row in found["parameters"] if row["name"] == "m1.coulomb")
    assert abs(coulomb["value"] - 0.5) < 5 * coulomb["sd"] < 0.1
    assert found["gear_stiffness"]["q1"]["stiffness"] == pytest.approx(1e6, rel=0.05)
    fitted = flexgen.read(new, "rigid")
    old = flexgen.read(robot)
    q = np.array([[0.3, -0.4]])
    gravity = [evaluate(flexgen.derive(m).function("gravity"), q)[0] for m in (fitted, old)]
    assert gravity[0] == pytest.approx(1.1 * gravity[1], rel=0.02)
    assert fitted.motors[0].friction.coulomb == pytest.approx(0.5, rel=0.05)
    text = new.read_text()
    assert "only combinations of these numbers are determined" in text and text.count(": sd ") > 20


@pytest.mark.slow
def test_segments_from_the_command_line(tmp_path, capsys):
    model = flexgen.read("planar5_nmp")
    text = Path(model.file).read_text()
    (tmp_path / "robot.toml").write_text(text)
    plan, data, raw = (str(tmp_path / name) for name in ("plan.npz", "data.npz", "raw"))
    robot = str(tmp_path / "robot.toml")
    assert (
        main(
            [
                "excite",
                robot,
                "--poses",
                "1",
                "--period-s",
                "1",
                "--f-max",
                "60",
                "--out",
                plan,
                "-q",
            ]
        )
        == 0
    )
    truth = str(tmp_path / "truth.toml")
    exact = {p.name: 0.9 * p.value for p in select(model, ["stiffness"])}
    flexgen_text = text
    for p in select(model, ["stiffness"]):
        flexgen_text = with_numbers(flexgen_text, {p.key: exact[p.name]})
    Path(truth).write_text(flexgen_text)
    assert main(["measure", truth, plan, "--out", data, "--raw", raw, "-q"]) == 0
    capsys.readouterr()
    description = Path(raw) / "recordings.toml"
    new = tmp_path / "new.toml"
    words = [
        "identify",
        robot,
        str(description),
        "--segments",
        "0.05",
        "--free",
        "stiffness,damping",
    ]
    assert main([*words, "--out", str(new), "--validate", str(description), "--json", "-q"]) == 0
    found = json.loads(capsys.readouterr().out)
    values = {row["name"]: row["value"] for row in found["parameters"]}
    assert all(values[name] == pytest.approx(value, rel=2e-3) for name, value in exact.items())
    assert min(found["held_out_percent"]) > 99
    assert select(flexgen.read(new), ["q1.stiffness"])[0].value == pytest.approx(
        exact["q1.stiffness"], rel=2e-3
    )


def test_numbers_that_a_variant_sets_are_not_written(tmp_path, capsys):
    """The new file would not have the identified values in this variant; nothing is written."""
    first = rigid_recordings(tmp_path, (0.0,))[0]
    text = (tmp_path / "robot.toml").read_text()
    set_mass = (
        "\n"
        "[variant.heavy.set]\n"
        '"element.upper.body.mass" = 70.0\n'
        '"element.upper.dof.q1.gear" = { type = "rigid" }\n'
    )
    set_mass += '"element.fore.dof.q2.gear" = { type = "rigid" }\n'
    (tmp_path / "robot.toml").write_text(text + "\n[variant.heavy]\n" + set_mass)
    new = tmp_path / "new.toml"
    robot = f"{tmp_path / 'robot.toml'}@heavy"
    assert main(["identify", robot, str(first), "--rigid", "--out", str(new), "-q"]) == 1
    assert (
        "a number that the variant 'heavy' sets to another one" in capsys.readouterr().err
        and not new.exists()
    )


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_sensors_and_transients_from_the_command_line(tmp_path, capsys):
    (tmp_path / "robot.toml").write_text(
        Path(flexgen.read("planar5_nmp").file).read_text() + SENSOR
    )
    robot, plan, data, frf = (
        str(tmp_path / name) for name in ("robot.toml", "plan.npz", "data.npz", "frf.npz")
    )
    common = [
        "--poses",
        "2",
        "--f-max",
        "80",
        "--spectrum",
        "optimal",
        "--transients",
        "0",
        "--encoder-noise",
        "1e-5",
    ]
    assert main(["excite", robot, *common, "--out", plan, "-q"]) == 0
    assert main(["measure", robot, plan, "--beside", "--out", data, "-q"]) == 0
    capsys.readouterr()
    report = ["--report", str(tmp_path / "page")]
    assert main(["frf", data, "--transients", "--out", frf, *report, "--json", "-q"]) == 0
    assert json.loads(capsys.readouterr().out)["outputs"] == ["m1", "m2", "acc.x"]
    assert (tmp_path / "page" / "index.html").exists()
    assert (
        main(["identify", robot, frf, "--starts", "1", "--report", str(tmp_path / "fit"), "-q"])
        == 0
    )
    assert main(["frf", data, "--average", "h1", "--out", frf, "-q"]) == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rigid", "--free", "stiffness"], "--rigid: given with --free, expected without"),
        (["--segments", "0.05"], "--segments: given no --free"),
        (["--validate", "x.toml"], "run0.toml: given what is no .npz file"),
        (["--rigid", "--counterbalance", "q9=1"], "counterbalance: given 'q9'"),
    ],
)
def test_mistakes_are_named(words, message, tmp_path, capsys):
    first = rigid_recordings(tmp_path, (0.0,))[0]
    assert main(["identify", f"{tmp_path / 'robot.toml'}@rigid", str(first), *words, "-q"]) == 1
    assert message in capsys.readouterr().err
