"""Do 95 % of the true values lie inside the intervals that `flexgen.identify` states?

Random arms of three to six axes, with elastic gears and elastic axes without motor. The true robot
has other springs, dampers and frictions than the model file. It is measured as a user does: plan,
simulated experiment, frequency responses, fit. The plant is the nonlinear robot in emitted C, with
sampled drives and noise; the fit has a linear model from other equations, and takes noise from the
record. Run from the repository:

    .venv/bin/python benchmarks/uncertainty/intervals.py [--write] [--draws N] [ARM ...]

It prints a row for each fit; `--write` writes the tables intervals.md to the folder of this file:
one with little motion and much noise, one with the default of the motion and little noise, where
large motions show.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.experiments.plan import default_free
from flexgen.model.elements import (
    Body,
    Dof,
    Element,
    Friction,
    Gear,
    LinearSpring,
    Motor,
    Output,
    Placement,
    RobotModel,
)

SEED = 4711
DRAWS = 3
NORMAL = 1.96
OFF = 0.2
SPEEDS = 0.02, 0.05  # rms, rad/s, of the tables; the second is the default of `excite`
LITTLE = 3e-5, 1e-3  # noise in the second, rad and N m
AXES = (3, 3, 4, 4, 5, 5, 6, 6)  # of the arms
HEAD = (
    "arm",
    "axes",
    "free",
    "encoder, rad",
    "torque, N m",
    "fitted",
    "stated",
    "inside, %",
    "rms of error / sd",
)


def between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def random_arm(rng: np.random.Generator, axes: int) -> RobotModel:
    """An arm along x whose neighboring axes are perpendicular; about 40 % of its links bend, one
    at least.
    """
    length, mass = [[between(rng, *of) for _ in range(axes)] for of in ((0.25, 0.7), (20.0, 60.0))]
    mass = [m * 0.7**k for k, m in enumerate(mass)]
    bends = rng.uniform(size=axes) < 0.4
    bends[rng.integers(axes)] |= not bends.any()
    elements = []
    motors = []
    axis = -1
    for k in range(axes):
        reach = np.cumsum(length[k:]) - np.array(length[k:]) / 2
        # kg m^2, roughly
        moved = float(np.array(mass[k:]) @ (0.1 * reach**2 + 0.1 * np.array(length[k:]) ** 2))
        axis = int(rng.choice([i for i in range(3) if i != axis]))
        x, y = (tuple(np.eye(3)[i % 3].tolist()) for i in (axis, axis + 1))
        k_g, k_e = (
            moved * (2 * np.pi * between(rng, *hz)) ** 2 for hz in ((6.0, 20.0), (12.0, 40.0))
        )
        gear = Gear(False, "arm", LinearSpring(k_g), k_g * between(rng, 3e-4, 2e-3))
        dofs = [Dof(f"q{k + 1}", "rotation", x, gear=gear)]
        if bends[k]:
            damping = k_e * between(rng, 2e-4, 1e-3)
            dofs.append(Dof(f"e{k + 1}", "rotation", y, spring=LinearSpring(k_e), damping=damping))
        moments = mass[k] * length[k] ** 2 * rng.uniform([0.02, 0.08, 0.08], [0.05, 0.12, 0.12])
        com = tuple((0.5 * length[k] * np.array([1.0, *rng.normal(0.0, 0.1, 2)])).tolist())
        body = Body(mass[k], com, tuple(map(tuple, np.diag(moments).tolist())))
        elements.append(
            Element(f"link{k + 1}", tuple(dofs), link=Placement((length[k], 0.0, 0.0)), body=body)
        )
        # heavy joints have larger motors and ratios
        ratio = between(rng, 50.0, 100.0) * moved**0.25
        inertia = moved * between(rng, 0.3, 1.0) / ratio**2
        viscous = Friction(viscous=inertia * between(rng, 0.5, 5.0))
        motors.append(Motor(f"m{k + 1}", inertia, (f"q{k + 1}",), (ratio,), friction=viscous))
    return RobotModel(
        name=f"arm{axes}",
        description="random",
        source="random numbers",
        gravity=(0.0, 0.0, -9.81),
        base=Placement(),
        elements=tuple(elements),
        motors=tuple(motors),
        tool=Placement(),
        payload=Body(),
        output=Output("tool_position"),
        home=tuple(rng.uniform(-1, 1, axes).tolist()),
        moves=(),
        motor_coupling="simplified",
    )


def another(model: RobotModel, rng: np.random.Generator) -> RobotModel:
    """The robot with other springs, dampers and frictions."""
    numbers = select(model, default_free(model))
    return with_values(
        model, {p.name: p.value * float(np.exp(rng.uniform(-OFF, OFF))) for p in numbers}
    )


def errors_in_sd(found: Any, truth: RobotModel) -> np.ndarray:
    """Errors of the logarithms over the stated standard deviations, without what is not determined
    by the data.
    """
    true = {p.name: p.value for p in select(truth, list(found.vector.names))}
    stated = {
        name: sd for name, sd in found.sd.items() if sd is not None and not found.is_weak(name)
    }
    return np.array([np.log(found.values[name] / true[name]) / sd for name, sd in stated.items()])


def measure_arm(arm: int, draws: int, speed: float) -> dict[str, Any]:
    """Errors of all fits of an arm, in standard deviations."""
    rng = np.random.default_rng([SEED, arm])
    model = random_arm(rng, AXES[arm])
    noise = between(rng, 3e-5, 1e-4), between(rng, 1e-3, 5e-3)
    noise = noise if speed == SPEEDS[0] else LITTLE
    drives = flexgen.DriveHardware(encoder_noise_rad=noise[0], torque_noise_Nm=noise[1])
    plan = flexgen.excite(model, speed_rms=speed, hardware=drives, progress=False)
    fits = []
    free = 0
    for draw in range(draws):
        truth = another(model, rng)
        began = time.perf_counter()
        responses = flexgen.frf(flexgen.measure(plan, truth, seed=draw, progress=False))
        found = flexgen.identify(model, responses, progress=False)
        fits.append(errors_in_sd(found, truth))
        free = len(found.vector)
        print(
            f"arm {arm + 1}, {AXES[arm]} axes, draw {draw + 1}: {found.status}, weights "
            f"{found.weights}, {np.sum(np.abs(fits[-1]) < NORMAL)} of {len(fits[-1])} inside, "
            f"{time.perf_counter() - began:.1f} s",
            flush=True,
        )
    return {"axes": AXES[arm], "free": free, "noise": noise, "fits": fits}


def cells(name: str, axes: str, rows: list[dict[str, Any]]) -> list[str]:
    """The cells of a line of the table, for one arm or for several together."""
    fits = [fit for row in rows for fit in row["fits"]]
    z = np.concatenate(fits)
    free = sum(row["free"] * len(row["fits"]) for row in rows)
    noise = [f"{x:.2g}" for x in rows[0]["noise"]] if len(rows) == 1 else ["", ""]
    inside = (
        [f"{100 * np.mean(np.abs(z) < NORMAL):.1f}", f"{np.sqrt(np.mean(z**2)):.2f}"]
        if len(z)
        else ["-", "-"]
    )
    fitted = f"{sum(len(fit) > 0 for fit in fits)} of {len(fits)}"
    return [
        name,
        axes,
        str(rows[0]["free"]) if len(rows) == 1 else "",
        *noise,
        fitted,
        f"{len(z)} of {free}",
        *inside,
    ]


def table(rows: list[dict[str, Any]]) -> str:
    """The lines of all arms of a table."""
    lines = [cells(str(k + 1), str(row["axes"]), [row]) for k, row in enumerate(rows)]
    lines += [
        cells("all", "3 to 6", rows),
        cells("6 axes", "6", [row for row in rows if row["axes"] == 6]),
    ]
    return "\n".join(["| " + " | ".join(x) + " |" for x in (HEAD, ["---"] * len(HEAD), *lines)])


def page(tables: list[str], draws: int) -> str:
    """The page."""
    return f"""# True values inside the 95 % intervals of an identification

`intervals.py --write` makes these tables. Random arms with elastic gears and links that bend; \
all springs, dampers and
viscous frictions are fitted (*free*). The true ones differ from the model file by up to \
{100 * OFF:.0f} %, nothing else
is wrong. Plan, experiment, responses and fit are those of `excite`, `measure`, `frf` and \
`identify`, with their
defaults; {draws} experiments for each arm, each with another robot and other noise.
*Stated*: intervals, of the parameters of all fits; a fit that is not `fitted` states none, nor \
does one of a
parameter that it calls not determined. The plant is the nonlinear robot in C.

## Speed {SPEEDS[0]} rad/s rms

{tables[0]}

## Speed {SPEEDS[1]} rad/s rms, the default, with little noise

The noise is so low that the difference of a robot in motion from a linear one is larger; \
`identify` corrects for it.

{tables[1]}
"""


def main() -> None:
    """Measure, print, and write the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("arms", type=int, nargs="*", default=list(range(1, len(AXES) + 1)))
    given = parser.parse_args()
    arms = [arm - 1 for arm in given.arms]
    text = page(
        [table([measure_arm(arm, given.draws, speed) for arm in arms]) for speed in SPEEDS],
        given.draws,
    )
    print(text)
    if given.write:
        Path(__file__).with_name("intervals.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
