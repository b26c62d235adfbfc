"""Frictions with states against closed forms, the power that goes into them, and what an export
returns.
"""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from gear_friction import loaded
from numpy.testing import assert_allclose

import flexgen
from flexgen.dynamics.hysteresis import lugre
from flexgen.dynamics.hysteresis.lugre import MotorBristles
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.exports.exported import Exported, exported, left_out
from flexgen.simulation.integration.hysteretic_rate import memory_of


@pytest.mark.parametrize("path", [0.02, 1.0, 25.0, 400.0, 1e5])
def test_bristles_of_constant_level_follow_the_path_of_the_motor(path: float) -> None:
    """``dz/dx = 1 -+ z/limit``, from rest and after a reversal; ``path``: of the motor, in limits
    of z.
    """
    h = 0.05
    limit = 0.25
    t = h * np.arange(31)
    c = path * limit * 6
    # forward until 1 s, then back; cubics between the samples are exact
    v = c * t * (1 - t)
    a = c * (1 - 2 * t)
    law = MotorBristles(*(np.array([x]) for x in (2.0, 2.0, 1.0, 2.0 / limit, 0.0)))
    z, w = lugre.bristles_along(law, 0, h, v, a)
    fine = np.linspace(0.0, 1.5, 30 * 2000 + 1)
    x = c * (fine**2 / 2 - fine**3 / 3)
    top = limit * (1 - np.exp(-x.max() / limit))
    back = -limit + (top + limit) * np.exp(np.minimum(x - x.max(), 0.0) / limit)
    exact = np.where(fine <= 1.0, limit * (1 - np.exp(-x / limit)), back)
    assert_allclose(z, exact[::2000], rtol=1e-6, atol=2e-4 * limit)
    area = np.concatenate([[0.0], np.cumsum((exact[1:] + exact[:-1]) / 2) * (fine[1] - fine[0])])[
        ::2000
    ]
    assert_allclose(w, area, rtol=1e-4, atol=2e-4 * limit * h)


@pytest.mark.parametrize("bristles", [False, True])
def test_the_power_of_memories_is_what_their_forces_take(bristles: bool) -> None:
    """Forces times speeds of the motion, for gears whose hysteresis changes the friction of the
    motors too.
    """
    model = loaded("elbow", lost_motion=1e-3)
    if bristles:
        law = {
            "coulomb": 0.5,
            "static": 0.8,
            "stribeck_speed": 4.0,
            "stiffness": 800.0,
            "damping": 1.5,
        }
        model = flexgen.read("elbow", overrides={"motor.m2.lugre": law})
    equations = Equations(model)
    made = memory_of(equations)
    lag = equations.lagrangian
    (y, dy, _) = equations.y
    inputs = [y, dy, made.z]
    found = ca.Function(
        "power", inputs, [made.taken, ca.dot(made.forces, dy)], {"allow_free": True}
    )
    assert not found.free_sx(), lag
    rng = np.random.default_rng(2)
    for _ in range(4):
        taken, given = (float(x) for x in found(*(rng.standard_normal(x.numel()) for x in inputs)))
        assert taken == pytest.approx(-given, rel=1e-10) and abs(taken) > 1e-3


def test_what_an_export_returns(tmp_path: Path) -> None:
    """A path of its main file, the lines that are printed, and entries for JSON; equal exports
    have one hash.
    """
    model = flexgen.read("elbow")
    files = (tmp_path / "a.xml", tmp_path / "b.toml")
    made = exported(
        model,
        "kind",
        files,
        ("bodies", "rest"),
        notes=("one", "two"),
        details={"friction": "exact"},
    )
    assert (
        str(made) == str(files[0])
        and made.__fspath__() == str(files[0])
        and made.directory == tmp_path
    )
    assert (
        made.summary() == f"wrote {files[0]}: bodies\nwrote {files[1]}: rest\nnote: one\nnote: two"
    )
    data = made.to_dict()
    assert data["directory"] == str(tmp_path) and data["friction"] == "exact"
    assert (made.model, made.variant, made.kind) == ("elbow", "", "kind")
    again = exported(
        model,
        "kind",
        files,
        ("bodies", "rest"),
        notes=("one", "two"),
        details={"friction": "exact"},
    )
    assert made == again and hash(made) == hash(again)
    plain = Exported("kind", "elbow", tmp_path, files)
    assert plain.summary() == f"wrote {files[0]}\nwrote {files[1]}" and plain.directory == tmp_path
    detailed = Exported("kind", "elbow", tmp_path, files, details={"token": "t"}).to_dict()
    assert (
        detailed["token"] == "t"
        and "details" not in detailed
        and detailed["directory"] == str(tmp_path)
    )
    assert left_out(model) == ()
    tracker = {"name": "p", "type": "tracker", "unit": "m"}
    error = {"harmonics": [1], "cos": [1e-3], "sin": [0.0]}
    more = flexgen.read("elbow", overrides={"sensor": [tracker], "motor.m1.encoder_error": error})
    assert left_out(more) == ("not in the file: sensor, encoder_error",)


def test_old_names_of_exports_are_their_new_places_with_a_warning(tmp_path: Path) -> None:
    file = tmp_path / "a.xml"
    rows = (("ros2", "name", "r_v", "model"), ("ros2", "token", "t", "details['token']"))
    more = (("mujoco", "stem", "a", "path.stem"), ("mujoco", "name", file.name, "path.name"))
    for kind, name, value, place in (*rows, *more):
        made = Exported(kind, "r", file, (file,), "v", details={"token": "t"})
        with pytest.warns(DeprecationWarning) as seen:
            assert getattr(made, name) == value
        expected = f"result of export_{kind}: given .{name}, expected its new place, .{place}"
        assert str(seen[0].message).startswith(expected)
        with pytest.raises(AttributeError) as unknown:
            _ = made.other  # type: ignore[attr-defined]
        assert str(unknown.value) == "Exported has no attribute 'other'"
        with pytest.raises(TypeError) as refused:
            _ = made[0]  # type: ignore[index]
        assert (
            str(refused.value)
            == f"the result of export_{kind} is not a sequence; its files are .files"
        )
    pair = Exported("urdf", "r", tmp_path / "a.urdf", (tmp_path / "a.urdf", tmp_path / "a.toml"))
    with pytest.warns(DeprecationWarning, match="given a pair of paths, expected .files"):
        assert pair[1] == tmp_path / "a.toml"  # type: ignore[index]
