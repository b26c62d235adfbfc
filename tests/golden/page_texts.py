"""The texts of pages and printed tables of made-up results are what they were: rows, units,
digits, captions.

A net, not a proof: ``make golden`` writes `pages.txt` again; read the difference before you commit
it.

Of `flexgen.views.reports.analysis_page`, `flexgen.views.reports.control_page`,
`flexgen.views.reports.folder`, `flexgen.views.reports.html`,
`flexgen.views.reports.identification_page`, `flexgen.views.reports.motion`,
`flexgen.views.reports.pictures`, `flexgen.views.reports.result_page`,
`flexgen.views.reports.sentence`, `flexgen.views.reports.video`, `flexgen.views.reports.view`,
`flexgen.views.reports.texts`, `flexgen.inversion.solution`,
`flexgen.inversion.comparison.comparison`, `flexgen.views.plots.stick_figure`,
`flexgen.studies.check.numbers`, `flexgen.studies.check.moves`, `flexgen.studies.check.check`.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from figure_text import figure_text
from made_results import Indexed, derived, made_run, made_simulation, made_trajectory
from matplotlib.figure import Figure

import flexgen
from flexgen.base import display
from flexgen.base.rows import Part, Row, Table
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.feedback.loop.comparison import Comparison
from flexgen.feedback.loop.content import SHOWN_ERRORS, content_of_run
from flexgen.feedback.loop.margins import Margins
from flexgen.identification.estimator.fit_result import FittedNumber
from flexgen.identification.responses.content import content_of_responses
from flexgen.identification.responses.result import FitStatus
from flexgen.inversion.judge.status import Status
from flexgen.inversion.solution import Solution
from flexgen.paths.accuracy.figures import PathAccuracy
from flexgen.simulation.result import Simulation
from flexgen.views.plots.canvas import apply_style
from flexgen.views.reports import (
    control_page,
    html,
    html_tables,
    identification_page,
    motion,
    pictures,
    sentence,
    text_tables,
    texts,
    video,
)
from flexgen.views.reports.row_views import html_of_rows, text_of_rows

analyzed = functools.cache(flexgen.analyze)


def verified(name: str, method: str, status: Status = Status.SOLVED, **values: Any) -> Solution:
    """A solution with made-up figures, of a move with a simulation."""
    equations = derived(name)
    model = equations.model
    trajectory = made_trajectory(equations, move="line")
    width = len(trajectory.labels["y_ref"])
    pose = model.output.type == "tool_pose"
    run = Simulation(
        made_simulation(trajectory, width, pose).trajectory,
        2.34e-6,
        5.6e-4 if pose else None,
        3e-9,
        12.5,
        321.0,
        4567,
        0.25,
        warnings=("drifts",),
        growth=12.3,
        held_s=0.5,
        later_error_max_m=7.7e-4,
    )
    fixed: dict[str, Any] = {
        "verdict": "found",
        "residual_max_Nm": 1.25e-4,
        "residual_relative": 3.5e-7,
        "iterations": 7,
        "wall_s": 1.5,
        "cpu_s": 2.5,
        "preactuation_s": 0.125,
        "simulation": run,
        "intervals": 50,
        "warnings": ("first. ", "second"),
    }
    return Solution(
        model, model.moves[0], method, status, trajectory=trajectory, **{**fixed, **values}
    )


def solved() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Parts of the page of a solution, and what is printed of it."""
    for name in ("planar5_nmp", "kr300_efjm", "four_mass"):
        one = functools.partial(verified, name, "lq")
        limited = functools.partial(
            verified,
            name,
            "full",
            Status.LIMITS_ACTIVE,
            plan_error_max_m=1e-6,
            path_distance_max_m=0.00123,
        )
        rigid = functools.partial(verified, name, "rigid", Status.BASELINE, simulation=None)
        for label, make in (("solved", one), ("limited", limited), ("not verified", rigid)):
            yield (
                f"{name} {label}, summary",
                lambda make=make: html._summary(make(), html.scales_of_page(make().figures())),
            )
            yield (
                f"{name} {label}, words",
                lambda make=make: [sentence.in_words(make()), str(make())],
            )
            yield (
                f"{name} {label}, figures",
                lambda make=make: text_tables.figures(texts.figure_rows(make())),
            )
        yield (
            f"{name} motors",
            lambda one=one, name=name: html._motors(derived(name).model, one(), Limits()),
        )
        yield (
            f"{name} captions",
            lambda one=one, name=name: captions(derived(name), one(), analyzed("elbow")),
        )
        yield (
            f"{name} limited captions",
            lambda limited=limited, name=name: captions(derived(name), limited(), None),
        )
        yield (
            f"{name} comparison",
            lambda one=one, limited=limited: html_of_rows(
                Comparison(one(), (one(), limited())).content(), is_page=True
            ),
        )
    bounds = Limits(torque=(5.0, 1234.5), speed=(2.0, 1e6))
    yield (
        "given limits",
        lambda: html._motors(derived("planar5_nmp").model, verified("planar5_nmp", "lq"), bounds),
    )
    rows = [
        {
            "plant": p,
            "method": m,
            "control": c,
            "error_max_m": k * 1e-4,
            "error_max_rad": None if k > 5 else k,
        }
        for k, (p, m, c) in enumerate(
            (p, m, c)
            for c in ("feedback", "feedforward")
            for p in ("nominal", "soft & long")
            for m in ("lq", "fjm")
        )
    ]
    yield (
        "robustness",
        lambda: html_of_rows(
            Comparison(verified("planar5_nmp", "lq"), (), rows).content(), is_page=True
        ),
    )
    generated = Made(
        functions=("a", "b<c"), files=("src/model.c", "model.h"), digest="0123456789abcdef0123"
    )
    yield "library", lambda: html._library_table(generated) + html._library_table(None)
    yield (
        "numbers",
        lambda: (
            [
                html_tables.number(x)
                for x in (None, np.inf, 0.0, -1.5e-7, 123456.0, 0.1234567, 2.0, -3.25)
            ]
            + [
                text_tables.number(x, 3)
                for x in (
                    None,
                    True,
                    False,
                    999.94,
                    1000.0,
                    9.9999e6,
                    1e7,
                    -1234.5,
                    np.nan,
                    7,
                    "x",
                    0.0123456,
                )
            ]
            + [display.duration(x) for x in (0.2, 99.4, 100.0, 150.1)]
            + display.roots(
                [(1.0, 2.0), (1.0, -2.0), (1.0, 2.0), (3.0, 0.0), (None, 1.0), (4.0, None)]
            )
        ),
    )


def captions(equations: Any, solution: Any, analysis: Any) -> list[str]:
    """Names and captions of the pictures of a motion, and of the linearized robot."""
    with pytest.MonkeyPatch.context() as patch:
        for name in (
            "robot",
            "torques",
            "speeds",
            "deflections",
            "errors",
            "pole_zero_map",
            "frequency_response",
        ):
            patch.setattr(pictures.plots, name, lambda *_, **__: None)
        drawn = pictures._motion(equations, solution, analysis, Limits())
        if analysis is not None:
            drawn += pictures.linear_pictures(analysis, "here")
    return [f"{picture.name}: {picture.caption}" for picture in drawn]


def printed() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Texts of models and analyses on the command line, on wide and on narrow terminals."""
    for name in ("planar5_nmp", "kr300_efjm", "urdf_arm", "beam_arm", "four_mass"):
        data = {**flexgen.describe(name), "file": "FILE"}
        yield f"{name} described", lambda data=data: texts.description_text(data)
        yield f"{name} described, 60 characters", lambda data=data: narrow(data, 60)
    yield (
        "elbow described, 20 characters",
        lambda: narrow({**flexgen.describe("elbow"), "file": "FILE"}, 20),
    )
    for name in ("planar5_nmp", "elbow", "four_mass"):
        yield f"{name} analyzed", lambda name=name: printed_analysis(name)
    for name in ("planar5_nmp@soft", "kr300_efjm", "urdf_arm", "beam_arm"):
        yield (
            f"{name} checked",
            lambda name=name: (f"{x.mark} {x}" for x in flexgen.check(name).findings),
        )


def narrow(data: Any, width: int) -> str:
    """A description on a terminal of this width."""
    with text_tables.fit_tables(width):
        return texts.description_text(data)


def rounded(value: Any) -> Any:
    """JSON types with numbers of five digits."""
    if isinstance(value, dict):
        return {key: rounded(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(x) for x in value]
    if not isinstance(value, float):
        return value
    return float(f"{value:.3g}") + 0.0 if abs(value) > 1e-9 else 0.0


def printed_analysis(name: str) -> str:
    """An analysis as text, its numbers rounded: those near zero are rounding errors."""

    def shown(part: Part) -> Part:
        if isinstance(part, Row) and isinstance(part.value, float):
            return replace(part, value=0.5 if part.unit == "relative" else rounded(part.value))
        if isinstance(part, Table):
            return replace(part, cells=tuple(map(tuple, rounded(part.cells))))
        return part

    return text_of_rows(map(shown, analyzed(name).content()))


def pages() -> Iterator[tuple[str, Callable[[], Any]]]:
    """Whole pages without their pictures."""
    learned = [
        Indexed(**{**vars(made_run(name)), **extra()})
        for name in ("pd", "learned")
        for extra in (loop_figures,)
    ]
    for run in learned:
        run.content = functools.partial(content_of_run, run)
    yield "page of a loop", lambda: page(control_page, control_page.write_control, learned[0])
    nonlinear = Indexed(**{**vars(learned[0]), "margins": dict, "loops": dict})
    nonlinear.content = functools.partial(content_of_run, nonlinear)
    yield (
        "page of a nonlinear loop",
        lambda: page(
            control_page,
            control_page.write_control,
            nonlinear,
        ),
    )
    result = Made(
        runs=[learned[0], learned[1]],
        best=1,
        unit="m",
        plant="robot 2",
        frequency_hz=12.5,
        gain=0.7,
        stopped="Enough.",
        errors=[1e-3, 1e-4],
        time=np.linspace(0, 1, 4),
        corrections=[np.zeros((4, 2)), np.full((4, 2), -3e-4)],
    )
    yield "page of learning", lambda: page(control_page, control_page.write_learned, result)
    data = Made(
        model="arm",
        poses=(0, 1),
        w=2 * np.pi * np.array([1.5, 3.0, 77.0]),
        periods=4,
        experiments=2,
        relative_sd=lambda: 0.01234,
        motors=("m1", "m2"),
        outputs=("m1", "m2", "p"),
        _data=lambda: (),
    )
    data.content = functools.partial(flexgen.Frf.content, data)
    yield (
        "page of responses",
        lambda: page(identification_page, identification_page.write_responses, data),
    )
    robot = flexgen.read("planar5_nmp")
    names = ("mass", "stiffness", "damping")
    numbers = (
        FittedNumber("mass", 1.1, "kg", 0.01, is_relative=True),
        FittedNumber("stiffness", 0.5, "kg", None, is_relative=True),
        FittedNumber("damping", 2.0, "kg", 0.5, is_determined=False),
    )
    unknowns = [
        Made(start=start, parameter=Made(value=3.0, doc="a < b")) for start in (1.0, 0.0, 4.0)
    ]
    for status in FitStatus:
        if status is FitStatus.NOT_CHECKED:
            continue  # of rigid arms only
        found = Made(
            vector=Made(model=robot, names=names, unknowns=unknowns),
            fitted=numbers,
            at_bound=("stiffness",),
            iterations=9,
            data=data,
            status=status,
            cost=1.25,
            weights="nls",
            causes=(),
            amplitude=None,
            grade=None,
            model_error=0.0321,
            agreed=3,
            starts=5,
            wall_s=12.5,
            weak=("mass and damping",),
            model=robot.with_values({}) if 0 else robot,
            held_out=(),
            load_note=("", ""),
            correlation=np.array([[1, 0.4, -0.95], [0.4, 1, 0.51], [-0.95, 0.51, 1]]),
        )
        found.content = functools.partial(content_of_responses, found)
        yield (
            f"page of an identification, {status}",
            lambda found=found: page(
                identification_page, identification_page.write_identification, found
            ),
        )


def loop_figures() -> dict[str, Any]:
    """Figures of a closed loop that its page reads in addition to its picture."""
    margins = {
        "start": Margins(True, 0.98765, 2.5, 1.5e-3, 40.0, 55.0, 12.0),
        "end": Margins(False, 1.01, np.inf, np.inf),
    }
    runs = [
        Made(
            name=f"robot {k}",
            failure="fell" if k == 1 else "",
            size=2e-4 * (k + 1),
            saturated=3 * k,
            load="2 kg" if k == 2 else "",
            contact=None,
        )
        for k in range(3)
    ]
    keys = (*SHOWN_ERRORS, "static_error_end")
    figures = (2e-4, 3e-4, 1.5e-4, None, 0.01, 0.002, 0.03)
    each = (1e-4, None), (0.25, None), (0.0, 4e-4), (0.125, None), (1e-6, 2e-6)
    angles = (1e-4, 2e-4, 3e-4), (1e-5, 2e-5, 3e-5), (-3e-4, 1e-4, 0.0), None
    accuracy = PathAccuracy(
        ("robot 0", "robot 2"), "m", 5e-5, *figures, *each, *angles, 1e-3, 9e-4, 2e-4
    )
    return {
        "unstable": {},
        "accuracy": lambda: accuracy,
        "status": "done",
        "hardware": Made(sample_s=1e-3, encoder_noise_rad=2e-5),
        "delay_s": 5e-4,
        "steps": 4,
        "wall_s": 0.75,
        "runs": runs,
        "margins": lambda: margins,
        "figures": lambda r: (
            {f"{k}_{u}": r.size * (n + 1) for n, k in enumerate(keys) for u in ("m", "rad")}
            | {
                "torque_max_Nm": 9.5,
                "plant": r.name,
                "saturated_samples": r.saturated,
                "failure": r.failure,
                "load": r.load,
            }
        ),
    }


def page(module: Any, write: Callable[..., Any], result: Any) -> str:
    """A page with the captions of its pictures, which are not drawn."""

    def text(_: Any, parts: list[str], drawn: list[Any]) -> str:
        body = "".join(parts)
        return body[body.index("<h1>") :] + "\n".join(
            f"{picture.name}: {picture.caption}" for picture in drawn
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "write_page", text)
        for name in dir(module.plots):
            if name.endswith(("_grid", "_plot")) or name.startswith("plot_"):
                patch.setattr(module.plots, name, lambda *given: given[-1])
        return str(write(result, "unused"))


def moving() -> Iterator[tuple[str, Callable[[], Any]]]:
    """The data of the moving robot, and two frames of its video."""
    for name in ("planar5_nmp", "kr300_efjm", "beam_arm", "elbow"):
        yield f"{name} moving", lambda name=name: summed(moved(name))
        yield f"{name} video", lambda name=name: frame(moved(name))
    yield (
        "frames",
        lambda: [
            f"{speed:g} {len(t)} {t[0]:.6g} {t[1]:.6g} {t[-1]:.6g}"
            for speed, t in (
                video.frames(-0.5, length - 0.5)
                for length in (1e-3, 0.04, 0.5, 1.9999, 2.0, 3.99, 4.0, 29.95, 30.0, 59.9, 1e4)
            )
        ],
    )


@functools.cache
def moved(name: str) -> Any:
    equations = derived(name)
    trajectory = made_trajectory(equations, move="line")
    run = made_simulation(trajectory, 2, False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "FRAMES", 24)
        return motion.motion_data(equations, trajectory, run if name == "beam_arm" else None, 0.8)


def summed(data: dict[str, Any]) -> list[str]:
    """The data with sums instead of long rows."""
    out = []
    for key, value in data.items():
        for k, part in enumerate(value if key == "poses" else [value]):
            x = (
                np.array(part, dtype=float)
                if key in ("poses", "tool", "time", "reference") and part is not None
                else None
            )
            out.append(
                f"{key} {k}: {json.dumps(part)}"
                if x is None
                else f"{key} {k}: {x.shape} {x.ravel()[:3]} {x.sum():.4f}"
            )
    return out


def frame(data: Any) -> list[str]:
    """Two instants of the video."""
    figure = Figure(figsize=(7.2, 5.4), dpi=100)
    move = apply_style(video._begin)(figure, data, "title")
    out = []
    for t in (data["time"][3] + 0.01, 99.0):
        move(t)
        out += figure_text(figure)
    return out


GROUPS = {"solved": solved, "printed": printed, "pages": pages, "moving": moving}


@functools.cache
def cases() -> dict[str, Callable[[], Any]]:
    """All texts by name."""
    return {name: make for group in GROUPS.values() for name, make in group()}


def lines(name: str) -> list[str]:
    """The lines of a text."""
    found = cases()[name]()
    text = found if isinstance(found, str) else "\n".join(found)
    return [line.rstrip() for line in text.splitlines()]
