"""Made-up results for pictures and pages: motions by formulas, closed loops, learned paths."""

from __future__ import annotations

import functools
from types import SimpleNamespace as Made
from typing import Any

import numpy as np

from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.dynamics.mechanics.output_columns import output_labels

derived = functools.cache(derive)


def made_trajectory(
    equations: Equations, early: float = 0.02, end: float = 0.8, **meta: Any
) -> Trajectory:
    """A motion by formulas; ``early``: how much of the torque acts before the path."""
    model = equations.model
    t = np.linspace(-0.4, 1.3, 86)
    rise = np.clip(t / end, 0.0, 1.0)
    rise = rise**3 * (10 - 15 * rise + 6 * rise**2)
    k = np.arange(model.n_a) + 1.0
    m = np.arange(model.n_m) + 1.0
    q_a = (
        0.3 / k
        + rise[:, None] * (-1.0) ** k * 0.7 / k
        + 1e-3 * np.sin(9 * t[:, None] * k) * np.isin(k - 1, model.i_e)
    )
    q_m = (q_a[:, list(model.i_g)] + 2e-4 * np.cos(7 * t[:, None] * m)) @ model.eta.T
    tau = (
        3 / m
        + early * np.exp(np.minimum(t, 0.0)[:, None] / 0.03) * m
        + np.sin(np.pi * rise)[:, None] * (-1.0) ** m
    )
    channels = {"q_a": q_a, "q_m": q_m, "v_m": np.gradient(q_m, t, axis=0), "tau_m": tau}
    units = {"q_a": "rad", "q_m": "rad", "v_m": "rad/s", "tau_m": "N m"}
    reference = {}
    if output_labels(model)["y_ref"]:
        width = len(output_labels(model)["y_ref"])
        channels["y_ref"] = 0.5 + rise[:, None] * 0.2 * (np.arange(width) + 1.0)
        units["y_ref"] = "m"
        reference = {"y_ref": output_labels(model)["y_ref"]}
    labels = {
        name: tuple(f"{name}{j}" for j in range(x.shape[1])) for name, x in channels.items()
    } | reference
    ports = {
        name: Port(name, (x.shape[1],), units[name], "made up") for name, x in channels.items()
    }
    return Trajectory(t, channels, ports, labels, {"model": model.name} | meta)


def made_simulation(trajectory: Trajectory, width: int, turn: bool) -> Any:
    """A simulation whose tool is next to the planned one."""
    t = trajectory.time
    error = 1e-6 * (1 + np.arange(width)) * np.abs(np.sin(20 * t))[:, None]
    channels = (
        dict(trajectory.channels)
        | {"error": error}
        | ({"turn": 3e-3 * np.cos(t)[:, None]} if turn else {})
    )
    channels["q_a"] = channels["q_a"] + 0.01
    ports = {name: Port(name, (x.shape[1],), "m", "made up") for name, x in channels.items()}
    labels = {name: tuple(f"{name}{j}" for j in range(x.shape[1])) for name, x in channels.items()}
    return Made(trajectory=Trajectory(t, channels, ports, labels, dict(trajectory.meta)))


def made_run(name: str = "pd", failure: str = "", plants: int = 3) -> Any:
    """A closed loop of two motors."""
    model = derived("planar5_nmp").model
    time = np.linspace(-0.3, 1.1, 15)
    runs = [
        Made(
            name=f"robot {k}", failure=failure if k == 1 else "", size=2e-4 * (k + 1), contact=None
        )
        for k in range(plants)
    ]
    loop = Made(
        response=lambda _: Made(
            hz=np.geomspace(0.1, 90, 6),
            gains=np.outer(np.geomspace(9, 0.02, 6), [1, 0.3]),
            nyquist=np.array([3 - 4j, 0.5 - 1j, -0.2 + 0.1j]),
        )
    )
    run: Any = Made(
        model=model,
        solution=Made(move=Made(name="line")),
        controller=name,
        runs=runs,
        reference=Made(time=time, path_end=0.8, begin=0.1),
        unit="m",
        distance=lambda r: r.size * np.abs(np.sin(5 * time)),
        nominal=Made(tau_m=np.outer(np.cos(time), [2.0, -0.5])),
        loops=lambda: {"nominal": loop, "stiff": loop},
        force=None,
        force_figures=dict,
        force_lines=tuple,
    )
    return run


class Indexed(Made):
    """A closed loop whose robots are found by their names."""

    def __getitem__(self, name: str) -> Any:
        return next(r for r in self.runs if r.name == name)
