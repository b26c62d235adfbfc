"""Robots with branches: time of the emitted C over the sum of the times of their branches alone.

    python benchmarks/trees/trees.py [--write]

All joints of a tree move at the same time; a branch is the chain from the base to its tip, with
the same samples of its joints. ``--write`` writes ``trees.md``.
"""

from __future__ import annotations

import argparse
import copy
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
from flexgen.base.spec.toml_text import toml

ROUNDS = 60
UPDATES = 100
PERIOD = 2e-3
MOVED = 0.2
PRE = 50
POST = 100
MODELS = Path(__file__).parents[2] / "models"
FILE = Path(__file__).with_name("trees.md")
HEAD = f"""# Robots with branches

Written by `python benchmarks/trees/trees.py --write`: all joints move by {MOVED} rad in 0.6 s, \
samples each 2 ms, mesh
of 4 ms, horizon of 40 intervals. Time of `invert`, and of an update of a stream, of the tree \
over the sum of those of
its branches alone, by calls from Python; in turns, least of {ROUNDS}. A branch is the chain from \
the base to its tip:
what branches share counts in each. n_g, n_e: joints with a motor, and without.

| tree | n_g | n_e | of the branches | invert, ms | sum of the branches | ratio | update, us | \
sum | ratio |
|---|---|---|---|---|---|---|---|---|---|
"""
BASE: dict[str, Any] = {
    "name": "base_body",
    "body": {"mass": 200.0, "com": [0, 0.2, 0], "inertia": [6.0, 6.0, 6.0]},
    "dof": [
        {
            "name": "t0",
            "type": "rotation",
            "axis": [0, 0, 1],
            "spring": {"type": "linear", "stiffness": 4e6},
            "damping": 1500.0,
        }
    ],
}


def arm(data: dict[str, Any], prefix: str, parent: str) -> dict[str, Any]:
    """The elements and motors of a chain with other names, its first element on a parent."""
    found = copy.deepcopy({key: data[key] for key in ("element", "motor")})
    for k, element in enumerate(found["element"]):
        element["parent"] = parent if k == 0 else found["element"][k - 1]["name"]
        element["name"] = prefix + element["name"]
        for dof in element.get("dof", []):
            dof["name"] = prefix + dof["name"]
    for motor in found["motor"]:
        motor["name"] = prefix + motor["name"]
        motor["drives"] = prefix + motor["drives"]
    return found


def together(
    name: str, data: dict[str, Any], count: int, base: bool
) -> tuple[dict[str, Any], list[str]]:
    """So many arms of a model on one base, which is elastic or fixed, and the tips of the
    branches.
    """
    arms = [arm(data, "abc"[k], BASE["name"] if base else "base") for k in range(count)]
    elements = [BASE] * base + [element for each in arms for element in each["element"]]
    motors = [motor for each in arms for motor in each["motor"]]
    home = list(data["home_rad"]) * count
    made = {
        "name": name,
        "description": name,
        "source": "benchmark",
        "gravity": data["gravity"],
        "home_rad": home,
    }
    return made | {"element": elements, "motor": motors}, [
        each["element"][-1]["name"] for each in arms
    ]


def cut(data: dict[str, Any], tips: Iterable[str], name: str) -> dict[str, Any]:
    """The model of the chains to these tips, whose output is all its joints with a motor."""
    parents = {}
    before = "base"
    for element in data["element"]:
        parents[element["name"]] = element.get("parent", before)
        before = element["name"]
    kept = set()
    for tip in tips:
        while tip != "base":
            kept.add(tip)
            tip = parents[tip]
    elements = [
        {**element, "parent": parents[element["name"]]}
        for element in data["element"]
        if element["name"] in kept
    ]
    dofs = {dof["name"] for element in elements for dof in element.get("dof", [])}
    joints = [motor["drives"] for motor in data["motor"]]
    which = [k for k, joint in enumerate(joints) if joint in dofs]
    return {key: data[key] for key in ("description", "source", "gravity")} | {
        "name": name,
        "home_rad": [data["home_rad"][k] for k in which],
        "element": elements,
        "motor": [data["motor"][k] for k in which],
        "tool": {"position": [0.3, 0, 0], "element": elements[-1]["name"]},
        "output": {"type": "joint", "joints": [joints[k] for k in which]},
    }


def timers_of(
    data: dict[str, Any], folder: Path
) -> tuple[flexgen.RobotModel, list[Callable[[], float]]]:
    """A model, and functions that give the time [s] of an inversion of the path and of an update
    of a stream.
    """
    file = folder / f"{data['name']}.toml"
    text = "".join(
        f"{key} = {toml(value)}\n"
        for key, value in data.items()
        if key not in ("element", "motor")
    )
    for key in ("element", "motor"):  # a table on each line: longer lines are refused
        text += f"{key} = [\n" + "".join(f"{toml(each)},\n" for each in data[key]) + "]\n"
    file.write_text(text, encoding="utf-8")
    model = flexgen.read(file)
    library = flexgen.load(
        flexgen.generate(model, folder / data["name"], progress=False).directory
    )
    t = np.linspace(0.0, 1.0, 301)
    T = 300 * PERIOD
    shape = np.polynomial.Polynomial([0, 0, 0, 0, 35, -84, 70, -20])
    y, dy, ddy = (np.outer(shape.deriv(k)(t) / T**k, np.full(model.n_g, MOVED)) for k in range(3))
    y = y + np.array(data["home_rad"])
    q_start = np.zeros(model.n_a)
    q_start[list(model.i_g)] = y[0]

    def invert() -> float:
        began = time.perf_counter()
        library.invert(
            y,
            dy,
            ddy,
            period=PERIOD,
            q_start=q_start,
            n_pre=PRE,
            n_post=POST,
            samples_per_interval=2,
        )
        return time.perf_counter() - began

    def update() -> float:
        stream = library.stream(
            y[0], q_start, period=2 * PERIOD, intervals=40, samples_per_interval=1
        )
        began = time.perf_counter()
        for k in range(UPDATES):
            stream.update(y[2 * k], dy[2 * k], ddy[2 * k])
        return (time.perf_counter() - began) / UPDATES

    return model, [invert, update]


def row_of(data: dict[str, Any], tips: list[str], folder: Path) -> str:
    """A row of the table."""
    tree = timers_of(cut(data, tips, data["name"]), folder)
    alone = [
        timers_of(cut(data, [tip], f"{data['name']}_{k}"), folder) for k, tip in enumerate(tips)
    ]
    made = [tree, *alone]
    least = np.full((len(made), 2), np.inf)
    for _ in range(ROUNDS):
        for k, (_, timers) in enumerate(made):
            least[k] = np.minimum(least[k], [timer() for timer in timers])
    sums = least[1:].sum(axis=0)
    parts = " + ".join(str(model.n_e) for model, _ in alone)
    cells = [data["name"], str(tree[0].n_g), str(tree[0].n_e), parts]
    for whole, total, unit in zip(least[0], sums, (1e3, 1e6), strict=True):
        cells += [f"{unit * whole:.3g}", f"{unit * total:.3g}", f"{whole / total:.2f}"]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table, and write it where it is wanted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--quick", action="store_true", help="one robot; nothing written")
    given = parser.parse_args()
    write = given.write and not given.quick
    rows = []
    two, carried, planar = (
        tomllib.loads((MODELS / f"{name}.toml").read_text(encoding="utf-8"))
        for name in ("two_arm", "carried_arm", "planar5_nmp")
    )
    cases = [
        (two, ["right2", "left2"]),
        (carried, ["forearm", "carried2"]),
        together("three_planar_arms", planar, 3, base=False),
        together("two_arms_on_elastic_base", planar, 2, base=True),
    ]
    with tempfile.TemporaryDirectory() as folder:
        for data, tips in cases[: 1 if given.quick else None]:
            rows.append(row_of(data, tips, Path(folder)))
            print(rows[-1], flush=True)
    if write:
        FILE.write_text(HEAD + "\n".join(rows) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
