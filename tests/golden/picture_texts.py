"""Pictures of made-up results have their recorded content: data, limits, units, labels, colors,
sizes.

A net, not a proof: ``make golden`` writes `pictures.txt` again; read the difference before you
commit it.

Of `flexgen.views.plots.along_path`, `flexgen.views.plots.calibration`,
`flexgen.views.plots.canvas`, `flexgen.views.plots.compliance`, `flexgen.views.plots.control`,
`flexgen.views.plots.feedback_study`, `flexgen.views.plots.gears`,
`flexgen.views.plots.identification`, `flexgen.views.plots.linear`,
`flexgen.views.plots.passivity`, `flexgen.views.plots.servo`, `flexgen.views.plots.signals`,
`flexgen.views.plots.solution`, `flexgen.views.plots.stick_figure`,
`flexgen.views.plots.uncertainty`.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from figure_text import figure_text
from made_results import Indexed, derived, made_run, made_simulation, made_trajectory

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.paths.path import Path
from flexgen.views.plots import (
    along_path,
    calibration,
    compliance,
    control,
    feedback_study,
    gears,
    identification,
    linear,
    passivity,
    servo,
    signals,
    solution,
    uncertainty,
)
from flexgen.views.plots import canvas as cv


@functools.cache
def analysis(name: str) -> Any:
    """The poles and zeros of a robot."""
    return flexgen.analyze(name)


def solutions() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Pictures of a motion: planar and spatial robots, one with a beam, one without extent."""
    for name, move, width, turn in (
        ("planar5_nmp", "line", 2, False),
        ("kr300_efjm", "line", 3, True),
        ("beam_arm", "line", 2, False),
        ("four_mass", "step", 1, False),
        ("urdf_arm", "", 3, False),
    ):
        equations = derived(name)
        trajectory = made_trajectory(
            equations, 0.02 if width != 3 else 0.0, **({"move": move} if move else {})
        )
        run = made_simulation(trajectory, width, turn)
        bounds = [5.0, 2.0, 0.9, float("inf"), 4.0, 3.0][: equations.model.n_m]
        drawn = name in ("planar5_nmp", "kr300_efjm", "four_mass")
        if drawn:
            yield (
                f"{name} speeds",
                functools.partial(solution.speeds, equations, trajectory, end=0.7),
            )
        yield (
            f"{name} torques",
            functools.partial(solution.torques, equations, trajectory, limits=bounds),
        )
        if drawn and name != "urdf_arm":
            yield f"{name} errors", functools.partial(solution.errors, equations, trajectory, run)
        yield f"{name} deflections", functools.partial(solution.deflections, equations, trajectory)
        yield (
            f"{name} robot",
            functools.partial(solution.robot, equations, trajectory, run if turn else None),
        )
        yield (
            f"{name} overview",
            functools.partial(
                solution.overview, equations, trajectory, None if turn else run, end=0.8
            ),
        )
    slow = derived("planar5_nmp")
    found = Made(zeros=Made(phase="non-minimum phase", unstable_time_constant_s=0.028))
    early = made_trajectory(slow, 0.5, kind="plan")
    yield (
        "early torques",
        functools.partial(solution.torques, slow, early, analysis=found, end=0.75),
    )
    yield "early overview", functools.partial(solution.overview, slow, early)
    yield "resting", functools.partial(solution.speeds, slow, resting(early))


def resting(trajectory: Trajectory) -> Trajectory:
    """The trajectory with its first motor at rest."""
    still = trajectory["v_m"].copy()
    still[:, 0] = 0.0
    return Trajectory(
        trajectory.time,
        {"v_m": still, "tau_m": trajectory["tau_m"]},
        {name: trajectory.ports[name] for name in ("v_m", "tau_m")},
        {name: trajectory.labels[name] for name in ("v_m", "tau_m")},
        {},
    )


def linearized() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Pictures of poles, zeros and responses."""
    yield "elbow poles", lambda: linear.pole_zero_map(analysis("elbow"))
    poles = np.array([-3 + 4j, -3 - 4j, -1e6, -1.000001e6, 2e6j])
    far = Made(
        model=Made(title="Arm"),
        poles=poles,
        zeros=Made(zeros=np.array([5.0, -2e7])),
        zeros_motor=None,
    )
    yield "poles and zeros far away", lambda: linear.pole_zero_map(far)
    for name in ("planar5_nmp", "four_mass"):
        yield (
            f"{name} analysis",
            functools.partial(lambda name: linear.plot_analysis(analysis(name)), name),
        )
    model = derived("planar5_nmp").model
    t = np.linspace(0.1, 0.9, 5)
    zeros = np.outer(1 + 0.1 * t, [12.0, -15.0, -3 + 40j, -3 - 40j]) * (1 + 0j)
    zeros[2, 0] = np.inf
    path = Made(t=t, zeros=zeros, unstable=np.array([1, 1, 0, 1, 1]))
    yield "zeros along", functools.partial(along_path.zeros_along, model, path)
    yield (
        "stable zeros along",
        functools.partial(
            along_path.zeros_along, model, Made(t=t, zeros=zeros[:, 1:], unstable=np.zeros(5, int))
        ),
    )
    equations = derived("kr300_efjm")
    trajectory = made_trajectory(equations)
    runs = [
        Made(
            method=m,
            model=equations.model,
            trajectory=trajectory,
            move=Made(name="line", duration=0.8),
            simulation=made_simulation(trajectory, 3, m != "lq"),
        )
        for m in ("rigid", "lq")
    ]
    yield (
        "errors of methods",
        functools.partial(along_path.errors_of_methods, equations.model, tuple(runs)),
    )
    rows = Rows(
        np.arange(6.0) ** 2, np.arange(36.0).reshape(6, 2, 3), np.array(3.0), "x", np.arange(5.0)
    )
    yield "arrays", functools.partial(signals.plot_arrays, rows)
    yield "trajectory", functools.partial(signals.plot_trajectory, trajectory)
    yield (
        "path",
        functools.partial(
            lambda: signals.plot_path(
                Path(derived("planar5_nmp"), derived("planar5_nmp").model.move("line"))
            )
        ),
    )


@dataclass
class Rows:
    """A result of arrays."""

    few: np.ndarray
    deep: np.ndarray
    scalar: np.ndarray
    name: str
    short: np.ndarray


def controlled() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Pictures of closed loops, of learning and of the study of feedback."""
    yield "control", functools.partial(control.plot_control, made_run())
    yield (
        "control with a failure",
        functools.partial(control.plot_control, made_run(failure="diverged", plants=2)),
    )
    push = np.outer(np.sin(9 * np.linspace(-0.3, 1.1, 15)), [30.0, 40.0, 0.0, 0.0, 0.0, 2.0])
    pushed = Made(**{**vars(made_run()), "force": push, "assumed_force": 0.8 * push})
    yield "control with a force", functools.partial(control.plot_control, pushed)
    wall = np.maximum(0.0, np.outer(np.sin(9 * np.linspace(-0.3, 1.1, 15)), [0.0, 0.0, 80.0]))
    touching = Made(
        **{
            **vars(pushed),
            "runs": [Made(**{**vars(r), "contact": r.size * 1e3 * wall}) for r in pushed.runs],
        }
    )
    yield "control with a force and a wall", functools.partial(control.plot_control, touching)
    yield "loops", functools.partial(control.plot_loops, made_run())
    first, best = (Indexed(**vars(made_run(name))) for name in ("pd", "learned"))
    learned = Made(
        runs=[first, best, best],
        best=1,
        errors=[2e-3, 3e-4, 4e-4],
        unit="m",
        plant="robot 2",
        time=np.linspace(0, 1, 9),
        corrections=[
            np.zeros((9, 2)),
            np.outer(np.linspace(0, 1e-3, 9), [1, -2]),
            np.ones((9, 2)),
        ],
    )
    yield "learned", functools.partial(control.plot_learned, learned)
    settings = [Setting(exact) for exact in (True, False, False)]
    tunings = {
        f: [
            Made(worst_m=w, torque_noise_Nm=n)
            for w, n in (
                (2e-3 * (k + 1), 0.5),
                (0.03, 1.0),
                (1e-3, 3.0),
                (1.0, 1.0),
                (1e-3, 1e3),
                (4e-3, 0.1),
                (5e-3, 0.0),
            )
        ]
        for k, f in enumerate(feedback_study.FAMILIES[:3])
    }
    study = Made(
        settings=settings,
        model=Made(title="Arm"),
        plants=[1] * 6,
        torque_noise_Nm=0.7,
        of=lambda _, family: tunings.get(family, []),
    )
    yield "feedback study", functools.partial(feedback_study.plot_feedback_study, study)
    for draws in (1, 2):
        yield f"score of {draws} draws", functools.partial(scored, draws)
    measures = np.array(
        [[[2.0, 3.0], [4.0, 1.0], [1.0, 9.0]], [[2.5, 3.0], [4.0, 2.0], [1.5, 8.0]]]
    )
    score = Made(
        values=measures,
        reference=np.array([[2.0, 4.0], [1.0, 5.0]]),
        measures=[Made(name="error"), Made(name="noise")],
    )
    yield "bars of a score", functools.partial(drawn, control._bars, score)


def scored(draws: int) -> Any:
    """The picture of a score: two outputs, two robots, a pulse, a step that stays and one that
    outlasts the run.
    """
    z = np.outer(np.linspace(-1, 1, 30) ** 3, [1.0, 2.0, 5.0])
    outputs = (Made(name="tool", unit="mm"), Made(name="angle", unit="rad"))[:draws]
    scenario = Made(
        name="scene",
        version=3,
        sample_s=0.02,
        duration_s=0.55,
        outputs=outputs,
        plan=None if draws == 1 else "some",
        plants=Made(names=["a, b", "c, d"]),
    )
    each = np.array([[0.5, 1.5], [0.9, 1.1]])[:draws]
    pulses = [
        Made(start_s=0.1, end_s=0.2),
        Made(start_s=0.3, end_s=np.inf),
        Made(start_s=0.5, end_s=9.0),
    ]
    measures = np.ones((draws, 2, 1)) * [[[2.0], [3.0]]]
    score: Any = Made(
        scenario=scenario,
        controller="pd",
        traces={"z": z},
        seed=1,
        each=each.mean(axis=0),
        accepted=draws == 2,
        totals=each.mean(axis=1),
        per_draw=each,
        values=measures,
        reference=np.full((draws, 1), 2.0),
        measures=[Made(name="error")],
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            control, "draws_of", lambda *_: [Made(disturbances=pulses), Made(disturbances=())]
        )
        return control.plot_score(score)


class Setting(Made):
    """A setting of the study: with or without exact angles."""

    def __init__(self, exact: bool) -> None:
        super().__init__(exact=exact)

    def __str__(self) -> str:
        return f"exact {self.exact}"


@cv.apply_style
def drawn(draw: Callable[..., None], *values: Any) -> Any:
    """A figure with one axis that a function draws into."""
    figure = cv.new_figure(6.0, 4.0, "")
    draw(figure.subplots(), *values)
    return figure


def identified() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Pictures of an identification."""
    w = 2 * np.pi * np.geomspace(1.0, 80.0, 12)
    G = (np.arange(1, 7).reshape(3, 2) / (1 + 0.02j * w[:, None, None]))[None].repeat(2, axis=0)
    G[1] *= 1.5
    data = Made(
        motors=("m1", "m2"),
        outputs=("a1", "a2", "s1"),
        w=w,
        model="arm",
        poses=(0, 1),
        G=G,
        variance=0.01 * np.abs(G) ** 3,
    )
    yield "responses", functools.partial(identification.response_grid, data, pose=1)
    for sensors in (True, False):
        yield f"responses of an identification {sensors}", functools.partial(fitted, data, sensors)
    names = ["mass", "stiffness", "inertia", "gear.friction.coulomb", "gear.friction.viscous"]
    values = dict(zip(names, (2.2, 0.5, 3.1, 0.9, 0.4), strict=True))
    unknowns = [
        Made(name=n, scale="log", parameter=Made(value=2.0 - 0.3 * k)) for k, n in enumerate(names)
    ]
    vector = Made(unknowns=unknowns, model=Made(title="Arm"), names=names)
    correlation = np.eye(5) + 0.1 * np.arange(25).reshape(5, 5)
    for some in (True, False):
        sd = (
            dict(zip(names, (0.1, 0.02, None, 4.0, 0.3), strict=True))
            if some
            else dict.fromkeys(names)
        )
        found = Made(
            sd=sd,
            values=values,
            vector=vector,
            status=Made(has_deviations=some),
            correlation=correlation,
            is_weak=lambda name: name in ("inertia", "gear.friction.coulomb"),
        )
        yield (
            f"parameters, deviations {some}",
            functools.partial(identification.parameter_plot, found),
        )
    yield "correlations", functools.partial(identification.correlation_plot, found)


def fitted(data: Any, sensors: bool) -> Any:
    """Two parts of the pictures of an identification: with the responses of sensors their grid,
    else the residuals.
    """
    found = Made(
        vector=Made(start=0.5, unknowns=()),
        x=1.1,
        data=data,
        deflection_sd=0.1,
        variance=0.04 * np.abs(data.G),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            identification,
            "Residuals",
            lambda *_, **__: Made(response=lambda x: Made(G=x * data.G)),
        )
        return (
            identification.response_grid(data, found)
            if sensors
            else identification.residual_plot(found)
        )


def measured() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Pictures of calibrations, compliances, gears, passive loops, servos and predictions."""
    names = [f"c{k}.compliance" for k in range(26)]
    unknowns = [Made(name=n, kind="compliance") for n in names] + [
        Made(name="length", kind="length")
    ]
    errors = np.array([4e-4, np.nan, 1e-4, 2e-4, 3e-4])
    calibrated = Made(
        unknowns=unknowns,
        determined={n: k != 3 for k, n in enumerate(names)},
        values={n: (-1.0) ** k * 1e-6 * (k + 1) for k, n in enumerate(names)},
        sd={n: 2e-7 * (k + 1) for k, n in enumerate(names)},
        nominal=Made(title="Arm"),
        poses=range(5),
        errors_before=10 * errors,
        sag=None,
        errors=errors,
        errors_held_out=2 * errors,
        errors_seen=3 * errors,
    )
    yield "calibration", functools.partial(calibration.plot_calibration, calibrated)
    short = Made(**{**vars(calibrated), "determined": dict.fromkeys(names, False)})
    yield "calibration without compliances", functools.partial(calibration.plot_calibration, short)
    C = np.diag([1e-6, 4e-10, 0.0, 1.0, 1.0, 1.0]) + 5e-7 * (np.eye(6, k=1) + np.eye(6, k=-1))
    f = np.geomspace(1.0, 90.0, 12)
    shaken = Made(
        matrix=C,
        frequencies=f,
        response=lambda f: C / (1 + 0.1j * f[:, None, None] - (f / 20)[:, None, None] ** 2),
    )
    for some in (True, False):
        held = Made(**{**vars(shaken), "frequencies": f if some else f[:0]})
        held = Made(compliance=held, model=Made(title="Arm"))
        yield (
            f"compliance, frequencies {some}",
            functools.partial(compliance.compliance_plot, held),
        )
    t = np.linspace(0.0, 1.0, 12001)
    loops = (
        np.stack([np.sin(9 * t), np.cos(9 * t), np.sin(9 * t) ** 3], axis=1)[:, None]
        * np.arange(1.0, 5.0)[:, None]
    )
    for n, count in ((1, 12000), (4, 12001)):
        coordinates = [Made(name=f"q{k}", unit="m" if k == 3 else "rad") for k in range(n)]
        fitted = Made(
            joints=[c.name for c in coordinates],
            robot=Made(title="Arm", coordinates=coordinates),
            loops=loops[:count],
            sentence=lambda: "two elements",
        )
        yield f"loops of {n} gears", functools.partial(gears.plot_loops, fitted)
    for name, least, fails in (("passive", 999.5, np.nan), ("active", -10.0, 17.1234)):
        found = Made(
            passive=least > 0,
            fails_hz=fails,
            model="arm",
            controller="pd",
            poses=["home", "far", "near", "low"],
            hz=f,
            margins=least + np.outer([0.0, 10.0, 400.0, 5000.0], f),
        )
        yield f"{name} loop", functools.partial(passivity.plot_passivity, found)
    yield "commands", functools.partial(commanded, ("rad", "rad"))
    yield "commands of lengths", functools.partial(commanded, ("m", "rad"))
    t = np.linspace(0.0, 1.0, 9)
    sent = np.outer(t, [1.0, 2.0, 3.0])
    servo_fit = Made(
        record=Made(time=t, command=sent, angle=0.87 * sent**1.7),
        model="arm",
        sentence=lambda: "the servo explains 97 %",
        motors=("m1", "m2", "m3"),
        gain_sd=np.arange(1.0, 10.0).reshape(3, 3) / 100,
    )
    yield "servo", functools.partial(servo.plot_fit, servo_fit)
    for unit in ("m", "rad"):
        yield (
            f"prediction of {unit}",
            functools.partial(uncertainty.plot_prediction, predicted(unit)),
        )


def commanded(units: tuple[str, ...]) -> Any:
    """The picture of positions that are sent to a servo."""
    trajectory = made_trajectory(derived("planar5_nmp"))
    run = made_run("servo")
    today = made_run("today")
    run.solution.trajectory = trajectory
    run.nominal = Made(size=0.0)
    today.nominal = Made(size=3e-3)
    time = np.linspace(-0.5, 1.4, 20)
    joint = np.outer(np.sin(time), [1.0, -0.4])
    found: Any = Made(
        run=run,
        today=today,
        status="solved",
        units=units,
        time=time,
        joint=joint,
        joints=["q1", "q2"],
    )
    return servo.plot_commands(found)


def predicted(unit: str) -> Any:
    """Errors of seven robots in metres, or in radians without a limit, with bands of four
    motors.
    """
    t = np.linspace(0.0, 0.8, 9)
    sizes = np.array([4.0, 1.0, 2.0, 7.0, 3.0, 5.0, 6.0])
    planned = np.outer(np.cos(t), [1.0, 2.0, 3.0, 4.0])
    width = np.outer(1 + t, [3e-3, 1e-3, 9e-3, 4e-3])
    band = Made(
        low=planned - width, high=planned + 2 * width, planned=planned, names=["a", "b", "c", "d"]
    )
    coordinates = [Made(unit="rad"), Made(unit=unit)]
    return Made(
        solution=Made(model=Made(title="Arm", coordinates=coordinates), move=Made(name="line")),
        sentence=lambda: "within 1 mm",
        errors_m=1e-4 * sizes if unit == "m" else None,
        error_m=6.5e-4,
        errors_rad=1e-5 * sizes,
        error_rad=None,
        robots=7,
        shares=[Made(name=f"source {k}", share=0.3 / (k + 1)) for k in range(12)],
        time=t,
        torque=band,
        deflection=band,
    )


GROUPS = {
    "solutions": solutions,
    "linearized": linearized,
    "controlled": controlled,
    "identified": identified,
    "measured": measured,
}


def lines(name: str) -> list[str]:
    """The text of a picture, or why it is refused."""
    try:
        return figure_text(cases()[name]())
    except ArgumentError as error:
        return [f"refused: {error}"]


@functools.cache
def cases() -> dict[str, Callable[[], Any]]:
    """All pictures by name."""
    return {name: make for group in GROUPS.values() for name, make in group()}
