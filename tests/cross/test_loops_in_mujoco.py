"""Accelerations of robots with kinematic loops against MuJoCo's equality constraints.

MuJoCo's constraints are soft and lack the term ``J' v``, so robots are compared at rest, with the
loops closed and a stiff constraint.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.model.elements import Body
from flexgen.model.format.closure import closed_values
from flexgen.studies.templates.new_model import new_model
from tests.support.linkages import FOUR_BAR, drawn_text, home_of, read_text

mujoco = pytest.importorskip("mujoco")

# Mass [kg] and inertia [kg m^2] of bodies without mass, which MuJoCo refuses.
LEAST = 1e-7


def numbers(x: Any) -> str:
    """Numbers of an attribute."""
    return " ".join(repr(float(y)) for y in np.ravel(x))


def turned(rotation: Any) -> str:
    """A rotation as the attribute xyaxes."""
    R = np.array(rotation)
    return numbers([*R[:, 0], *R[:, 1]])


def mjcf(model: flexgen.RobotModel) -> str:
    """The tree of a robot with joints, bodies, payload and loops, without springs and lines."""

    def inertial(body: Any) -> str:
        inertia = np.array(body.inertia) + LEAST * np.eye(3)
        full = [*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        return (
            f'<inertial pos="{numbers(body.com)}" mass="{body.mass + LEAST!r}" '
            f'fullinertia="{numbers(full)}"/>'
        )

    def body_of(element: Any) -> str:
        joints = "".join(
            f'<joint name="{dof.name}" axis="{numbers(dof.axis)}" '
            f'type="{"hinge" if dof.type == "rotation" else "slide"}"/>'
            for dof in element.dofs
        )
        place = element.origin
        link = element.link
        loads = inertial(element.body)
        children = "".join(
            body_of(e) for e in model.elements if model.parents[e.name] == element.name
        )
        if element.name == model.tip:
            children += f'<body name="payload">{inertial(model.payload)}</body>'
        return (
            f'<body name="{element.name}_joint" pos="{numbers(place.position)}" '
            f'xyaxes="{turned(place.rotation)}">{joints}{inertial(Body())}'
            f'<body name="{element.name}" pos="{numbers(link.position)}" '
            f'xyaxes="{turned(link.rotation)}">{loads}{children}</body></body>'
        )

    tree = "".join(body_of(e) for e in model.elements if model.parents[e.name] == "base")
    loops = "".join(
        f'<connect body1="{loop.start.element}" body2="{loop.end.element}" '
        f'anchor="{numbers(loop.start.position)}" solimp="0.9999 0.9999 0.001"/>'
        for loop in model.loops
    )
    return (
        f'<mujoco><compiler angle="radian"/><option gravity="{numbers(model.gravity)}" '
        f'tolerance="1e-14" iterations="200"/><worldbody>{tree}</worldbody>'
        f"<equality>{loops}</equality></mujoco>"
    )


def worst_difference(model: flexgen.RobotModel, count: int, loops: bool = True) -> float:
    """Largest relative difference of the accelerations at drawn states at rest."""
    model = replace(model, lines=())
    bare = model if loops else replace(model, loops=model.loops[1:])
    peer = mujoco.MjModel.from_xml_string(mjcf(bare))
    data = mujoco.MjData(peer)
    accelerations = flexgen.derive(model).function("arm_forward_dynamics")
    rng = np.random.default_rng(3)
    names = [c.name for c in model.coordinates]
    units = np.array([1.0 if c.unit == "rad" else 0.01 for c in model.coordinates])
    worst = 0.0
    for _ in range(count):
        q = home_of(model) + 0.2 * units * rng.uniform(-1.0, 1.0, model.n_a)
        tau = rng.uniform(-300.0, 300.0, model.n_a)
        mujoco.mj_resetData(peer, data)
        for name, value in closed_values(model, q).items():
            data.joint(name).qpos[0] = value
        for name, torque in zip(names, tau, strict=True):
            data.joint(name).qfrc_applied[0] = torque
        # the anchor on the second body is that of the closed robot
        mujoco.mj_kinematics(peer, data)
        for k, loop in enumerate(bare.loops):
            end = data.body(loop.end.element)
            point = end.xpos + end.xmat.reshape(3, 3) @ np.array(loop.end.position)
            first = data.body(loop.start.element)
            assert (
                np.abs(
                    first.xpos + first.xmat.reshape(3, 3) @ np.array(loop.start.position) - point
                ).max()
                < 1e-9
            )
            peer.eq_data[k, 3:6] = loop.end.position
        mujoco.mj_forward(peer, data)
        found = np.array([data.joint(name).qacc[0] for name in names])
        expected = np.array(accelerations(q, 0 * q, tau)).ravel()
        worst = max(worst, float((np.abs(found - expected) / np.abs(expected).max()).max()))
    return worst


def test_four_bar_accelerations_are_those_of_mujoco(tmp_path: Path) -> None:
    """Asked 1e-4; without its loop the arm moves otherwise."""
    model = read_text(tmp_path, FOUR_BAR)
    assert worst_difference(model, 10) < 1e-4
    assert worst_difference(model, 1, loops=False) > 5e-3


@pytest.mark.parametrize("spatial", [False, True])
def test_drawn_accelerations_are_those_of_mujoco(tmp_path: Path, spatial: bool) -> None:
    """A planar and a spatial loop, asked 1e-4."""
    model = read_text(tmp_path, drawn_text(np.random.default_rng(6), spatial))
    assert worst_difference(model, 5) < 1e-4


def test_accelerations_of_an_arm_with_a_linkage_are_those_of_mujoco() -> None:
    """Six axes of which a four-bar drives one, asked 1e-4."""
    model = flexgen.read("linkage_arm")
    rod = Body(mass=28.0, com=(0.0, 0.0, -0.575))
    elements = [replace(e, body=rod) if e.name == "rod" else e for e in model.elements]
    assert worst_difference(replace(model, elements=tuple(elements)), 5) < 1e-4


@pytest.mark.slow
def test_delta_accelerations_are_those_of_mujoco(tmp_path: Path) -> None:
    """Three spatial loops, asked 1e-4."""
    model = read_text(tmp_path, new_model("delta", "delta"))
    body = Body(mass=0.2, com=(0.0, 0.0, 0.3), inertia=((0.01, 0, 0), (0, 0.01, 0), (0, 0, 0.01)))
    elements = [e if e.body.mass else replace(e, body=body) for e in model.elements]
    # a soft constraint takes its softness from the bodies: those without mass would give way
    assert worst_difference(replace(model, elements=tuple(elements)), 5) < 1e-4
