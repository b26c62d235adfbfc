"""Identification, measured: times, accuracy of fits, of refinements, and of the torques that
follow from them.

    python benchmarks/identification.py [--quick]

prints tables and writes them to benchmarks/identification.md.

Robots are simulated, with encoder noise of 1e-4 rad and torque noise of 0.02 N m on the motor
side; their springs and dampers differ from the model's by random factors. The experiments are
planned, simulated and fitted by the verbs of flexgen. Times are of one core of this machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import identification_choices as choices
import numpy as np

import flexgen
from flexgen.dynamics.mechanics.parameters import select, with_values
from flexgen.identification.experiments import operating_points
from flexgen.identification.experiments.plan import default_free
from flexgen.identification.responses.local_model import LocalModel
from flexgen.identification.responses.parameters import ParameterVector
from flexgen.identification.responses.response_inputs import Drive
from flexgen.model.elements import RobotModel

ROOT = Path(__file__).resolve().parent.parent
NOISE = flexgen.DriveHardware(encoder_noise_rad=1e-4, torque_noise_Nm=0.02)
ROBOT = "manutec_r3_18"
POSES = 8
BAND = {"f_min": 1.25, "f_max": 110.0}


def without_coulomb(name: str) -> RobotModel:
    """The model with viscous friction only."""
    model = flexgen.read(name)
    motors = (
        replace(m, friction=replace(m.friction, coulomb=0.0, stribeck=0.0)) for m in model.motors
    )
    return replace(model, motors=tuple(motors))


def another(
    model: RobotModel, seed: int, spread: float, names: Iterable[str] = ("stiffness", "damping")
) -> RobotModel:
    """The robot with other numbers: random factors up to ``1 + spread``."""
    rng = np.random.default_rng(seed)
    limit = np.log1p(spread)
    return with_values(
        model,
        {p.name: p.value * np.exp(rng.uniform(-limit, limit)) for p in select(model, list(names))},
    )


def fastest(call: Callable[[], Any], times: int = 7) -> float:
    """Shortest of several times of a call [s]."""
    out = []
    for _ in range(times):
        began = time.perf_counter()
        call()
        out.append(time.perf_counter() - began)
    return min(out)


def table(head: list[str], rows: list[list[Any]]) -> str:
    """A Markdown table; numbers with three digits."""
    cells = [[f"{x:.3g}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    lines = [head, ["---"] * len(head), *cells]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def errors(found: Any, truth: RobotModel, kind: str) -> np.ndarray:
    """Errors of the logarithms of parameters of a kind, in percent."""
    names = [name for name in found.vector.names if name.endswith(kind)]
    values = {p.name: p.value for p in select(truth, names)} if names else {}
    return 100 * np.array([np.log(found.values[name] / value) for name, value in values.items()])


def rms(x: np.ndarray) -> float:
    """Root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(x**2))) if len(x) else float("nan")


# --- tables --------------------------------------------------------------------------------------
def times(quick: bool) -> str:
    """Linear models and their derivatives."""
    rows = []
    w = 2 * np.pi * np.geomspace(1.25, 110.0, 63)
    for name in ["planar5_nmp", ROBOT, *([] if quick else ["kr300_efjm", "manutec_r3_30"])]:
        model = flexgen.read(name)
        local = LocalModel(model, default_free(model))
        home = np.array(model.home)
        poses = (
            home + np.random.default_rng(0).uniform(-0.3, 0.3, (POSES, len(home)))
        ) @ model.eta.T
        rest = local.rest(local.values, poses)
        arguments = (local.values, poses, w, Drive(5e-4))
        plain = fastest(partial(local.response, *arguments, derivatives=False, rest=rest))
        both = fastest(partial(local.response, *arguments, rest=rest))
        equilibrium = fastest(partial(local.rest, local.values, poses))
        rows.append(
            [f"`{name}`", model.dof, len(local.names), 1e3 * plain, 1e3 * both, 1e3 * equilibrium]
        )
    head = [
        "robot",
        "degrees of freedom",
        "parameters",
        "model, ms",
        "model and derivatives, ms",
        "poses of rest, ms",
    ]
    return f"## Linear models: {POSES} poses, 63 frequencies\n\n" + table(head, rows)


def agreement() -> str:
    """Frequency responses of experiments without noise against the linear model."""
    rows = []
    for name in ("planar5_nmp", ROBOT):
        model = without_coulomb(name)
        plan = flexgen.excite(
            model, poses=POSES, periods=2, transients=2, speed_rms=0.005, progress=False
        )
        began = time.perf_counter()
        data = flexgen.frf(flexgen.measure(plan, model, progress=False))
        wall = time.perf_counter() - began
        local = LocalModel(model, ())
        for hold, drive in (("yes", Drive(5e-4)), ("no", Drive(0.0))):
            G = local.response(local.values, plan.poses, data.w, drive, derivatives=False).G
            away = np.abs(np.einsum("klaa->kla", data.G / G) - 1)
            rows.append(
                [
                    f"`{name}`",
                    hold,
                    float(np.median(away)),
                    float(away.max()),
                    plan.duration_s / wall,
                ]
            )
    head = ["robot", "hold in the model", "median difference", "largest", "s of robot per s"]
    return "## Experiments without noise against the linear model, diagonal elements\n\n" + table(
        head, rows
    )


def poses(quick: bool) -> str:
    """Predicted accuracy of chosen and of random poses."""
    model = without_coulomb(ROBOT)
    vector = ParameterVector(model, default_free(model))
    began = time.perf_counter()
    plan = flexgen.excite(model, poses=POSES, hardware=NOISE, progress=False, **BAND)
    wall = time.perf_counter() - began
    offered = operating_points.candidates(model, 300, 0)
    F, _ = operating_points.information(vector, plan, offered, every=3)
    target = [
        k for k, name in enumerate(vector.names) if not name.endswith(operating_points.FRICTIONS)
    ]

    def accuracy(chosen: list[int]) -> np.ndarray:
        return 100 * np.sqrt(
            np.diag(operating_points.covariance(F[chosen].sum(axis=0), vector.prior_sd))[target]
        )

    rng = np.random.default_rng(1)
    rows = []
    for count in (1, 4, 8):
        random = [
            rms(accuracy(rng.choice(len(F), count, replace=False).tolist())) for _ in range(100)
        ]
        row: list[Any] = [count, float(np.median(random)), min(random)]
        for criterion in "DA":
            sd = accuracy(operating_points.choose(F, count, vector, criterion))
            row.append(f"{rms(sd):.3g} / {sd.max():.3g}")
        rows.append(row)
    head = [
        "poses",
        "random, median of 100",
        "random, best of 100",
        "D, rms / largest",
        "A, rms / largest",
    ]
    title = f"## Expected standard deviations of 24 springs and dampers, %: `{ROBOT}`"
    return f"{title}\n\n{table(head, rows)}\n\nPlanning with 300 candidates: {wall:.1f} s."


def fits(quick: bool) -> str:
    """Fits without Coulomb friction: errors, claimed deviations, starts."""
    model = without_coulomb(ROBOT)
    rows = []
    truth = another(model, 3, 0.3)
    plan = flexgen.excite(
        model, poses=POSES, speed_rms=0.02, hardware=NOISE, progress=False, **BAND
    )
    chains = 3 if quick else 12
    data = [
        flexgen.frf(flexgen.measure(plan, truth, seed=k, progress=False)) for k in range(chains)
    ]
    for label, options in (
        ("elements", {"structured": False}),
        ("logarithms", {"residual": "lls"}),
        ("structured", {}),
    ):
        found = [flexgen.identify(model, d, starts=1, progress=False, **options) for d in data]
        k, d = (
            np.array([errors(f, truth, kind) for f in found]) for kind in ("stiffness", "damping")
        )
        names = [n for n in found[0].vector.names if n.endswith(("stiffness", "damping"))]
        sd = np.array([[100 * f.sd[n] for n in names] for f in found])
        away = np.array([[100 * np.log(f.values[n]) for n in names] for f in found])
        true = {p.name: p.value for p in select(truth, names)}
        ratio = np.abs(away - 100 * np.log([true[n] for n in names])) / sd
        rows.append(
            [
                label,
                rms(k.ravel()),
                rms(d.ravel()),
                float(np.median(ratio)) / 0.674,
                float(np.mean([f.cost for f in found])),
                float(np.median([f.wall_s for f in found])),
            ]
        )
    head = [
        "weights",
        "stiffness, % rms",
        "damping, % rms",
        "error / claimed (1 expected)",
        "cost",
        "fit, s",
    ]
    text = f"## Fits of `{ROBOT}`, {chains} repeated experiments\n\n" + table(head, rows)
    starts = 10 if quick else 40
    many = flexgen.identify(
        model, data[0], starts=starts, spread=3.0, structured=False, progress=False
    )
    return text + (
        "\n"
        "\n"
        f"Starts off by up to a factor of 3 that reach the best cost: {many.agreed} of "
        f"{starts}."
    )


def friction(quick: bool) -> str:
    """Coulomb friction: frequency responses, then the time domain."""
    rows = []
    for label, sharper in (("as in the file", 1.0), ("eight times sharper", 8.0)):
        if quick and sharper > 1:
            continue
        model = flexgen.read(ROBOT)
        motors = (
            replace(m, friction=replace(m.friction, beta=sharper * m.friction.beta))
            for m in model.motors
        )
        model = replace(model, motors=tuple(motors))
        truth = another(model, 5, 0.2)
        truth = another(truth, 6, 0.4, [f"{m.name}.coulomb" for m in model.motors])
        plan = flexgen.excite(
            model, poses=POSES, speed_rms=0.1, hardware=NOISE, progress=False, seed=1
        )
        experiment = flexgen.measure(plan, truth, seed=3, progress=False)
        coarse = flexgen.identify(model, flexgen.frf(experiment), starts=1, progress=False)
        fine = flexgen.refine(coarse, experiment, progress=False)
        for what, found in (("frequency responses", coarse), ("time domain", fine)):
            kinds = [
                rms(errors(found, truth, kind)) for kind in ("stiffness", "damping", "coulomb")
            ]
            rows.append([label, what, *["" if np.isnan(x) else x for x in kinds], found.wall_s])
    head = ["Coulomb step", "fit", "stiffness, % rms", "damping, % rms", "Coulomb, % rms", "s"]
    return f"## Coulomb friction, 0.1 rad/s rms: `{ROBOT}`\n\n" + table(head, rows)


def worth(quick: bool) -> str:
    """Tool errors of feedforward on the true robot with controlled motors."""
    rows = []
    for name in ["planar5_nmp", *([] if quick else [ROBOT, "manutec_r3_24", "manutec_r3_30"])]:
        model = without_coulomb(name)
        truth = with_values(model, {p.name: 0.8 * p.value for p in select(model, ["stiffness"])})
        band = {} if name == "planar5_nmp" else BAND
        plan = flexgen.excite(
            model, poses=POSES, speed_rms=0.02, hardware=NOISE, progress=False, **band
        )
        data = flexgen.frf(flexgen.measure(plan, truth, progress=False))
        found = flexgen.identify(model, data, starts=1, progress=False)
        verdict = found.verdict("line", truth=truth, progress=False)
        rows.append(
            [
                f"`{name}`",
                *(
                    1e6 * (verdict[m].quantile(0.5) or 0.0)
                    for m in ("file", "identified", "rigid", "fjm")
                ),
            ]
        )
    head = [
        "robot, move `line`",
        "model file, um",
        "identified, um",
        "rigid, um",
        "flexible joint model, um",
    ]
    return (
        "## Largest tool error of feedforward on the true robot, all springs 20 % softer\n\n"
        + table(head, rows)
    )


def worth_with_friction(quick: bool) -> str:
    """Tool errors where Coulomb friction is identified too."""
    if quick:
        return ""
    model = flexgen.read(ROBOT)
    truth = with_values(model, {p.name: 0.8 * p.value for p in select(model, ["stiffness"])})
    truth = another(truth, 6, 0.4, [f"{m.name}.coulomb" for m in model.motors])
    rows = []
    for speed in (0.1, 0.2):
        plan = flexgen.excite(
            model, poses=POSES, speed_rms=speed, hardware=NOISE, progress=False, seed=1
        )
        experiment = flexgen.measure(plan, truth, seed=3, progress=False)
        coarse = flexgen.identify(model, flexgen.frf(experiment), starts=1, progress=False)
        fine = flexgen.refine(coarse, experiment, progress=False)
        for label, found in (("frequency responses", coarse), ("time domain", fine)):
            verdict = found.verdict("line", truth=truth, progress=False)
            rows.append(
                [
                    speed,
                    label,
                    *(1e6 * (verdict[m].quantile(0.5) or 0.0) for m in ("file", "identified")),
                ]
            )
    head = ["excitation, rad/s rms", "fit", "model file, um", "identified, um"]
    title = (
        f"## The same on `{ROBOT}` with other Coulomb friction than in the file (up to 40 %), "
        "friction identified too"
    )
    return f"{title}\n\n{table(head, rows)}"


def spectra(quick: bool) -> str:
    """Spectra of the excitation."""
    model = without_coulomb("planar5_nmp" if quick else ROBOT)
    options = {"poses": 2 if quick else POSES, "hardware": NOISE, "progress": False, **BAND}
    head = ["amplitude of the speeds", "stiffness, % rms", "damping, % rms"]
    return f"## Expected standard deviations by spectrum: `{model.name}`\n\n" + table(
        head, choices.spectra(model, options)
    )


def sensors(quick: bool) -> str:
    """Sensors in addition to the motor encoders."""
    model = without_coulomb(ROBOT)
    options = {"poses": 2 if quick else POSES, "hardware": NOISE, "progress": False, **BAND}
    several = f"{options['poses']} poses"
    head = [
        "sensors",
        *(f"{n}: {k}, % rms" for n in ("1 pose", several) for k in ("stiffness", "damping")),
    ]
    text = table(head, choices.sensors(model, ROBOT, options))
    return f"## Expected standard deviations by sensors: `{ROBOT}`\n\n{text}"


def smooth_gears(quick: bool) -> str:
    """Gears with low and high stiffness."""
    head = ["method", "low stiffness, %", "high stiffness, %", "break, %"]
    rows = choices.smooth_gears(replace(NOISE, torque_noise_Nm=0.05))
    return "## Gears with low and high stiffness, two axes: largest errors\n\n" + table(head, rows)


def traps(quick: bool) -> str:
    """Mistakes about the robot and the drives."""
    model = without_coulomb(ROBOT)
    plan = flexgen.excite(
        model, poses=POSES, speed_rms=0.02, hardware=NOISE, progress=False, **BAND
    )
    data = flexgen.frf(flexgen.measure(plan, model, progress=False))
    rows = choices.traps(
        model,
        data,
        partial(flexgen.identify, starts=1, floor=0.0, structured=False, progress=False),
    )
    head = ["mistake", "stiffness, % rms (largest)", "damping, % rms", "cost", "status"]
    note = "Wrong masses are invisible in the cost: a fit hides them in the springs."
    return (
        f"## Mistakes: exact responses of `{ROBOT}`, weights of an experiment\n"
        "\n"
        f"{table(head, rows)}\n"
        "\n"
        f"{note}"
    )


def main(words: list[str]) -> None:
    """Measure, print and write the tables."""
    quick = "--quick" in words
    parts = ["# Identification, measured", (__doc__ or "").split("\n\n")[-1].strip()]
    tables = [
        times,
        lambda q: agreement(),
        poses,
        spectra,
        sensors,
        fits,
        friction,
        smooth_gears,
        traps,
        worth,
        worth_with_friction,
    ]
    for make in tables:
        began = time.perf_counter()
        text = make(quick)
        if not text:
            continue
        print(f"{text}\n\n[{time.perf_counter() - began:.0f} s]\n", flush=True)
        parts.append(text)
    if not quick:
        (ROOT / "benchmarks" / "identification.md").write_text(
            "\n\n".join(parts) + "\n", encoding="utf-8"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
