"""The verbs of control: control, fastest, score, tune, kinematics."""

from __future__ import annotations

import re
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

from flexgen.base.calls.deadline import (
    INTERRUPTED,
    OutOfTime,
    is_over,
    keep_best,
    limit_fit,
    part_known,
    reason_of_end,
)
from flexgen.base.calls.progress import throttle
from flexgen.base.errors import ArgumentError
from flexgen.base.rows import Inner, Part, data_of
from flexgen.cli.result import (
    Progress,
    VerbResult,
    Writer,
    alone,
    is_interrupted,
    keywords,
    read_model,
    wall_of,
    with_files,
    written,
)
from flexgen.views.reports.text_tables import number, table

if TYPE_CHECKING:
    from flexgen.model.elements import RobotModel

ROBOTS = 8
"""Robots that are drawn from the tolerances of a model for its tuning."""

OF_MODELS = (
    "move",
    "plants",
    "disturbances",
    "sample_time",
    "delay",
    "encoder_noise",
    "gain_margin_db",
    "phase_margin_deg",
)
"""Options of `tune` that are for models only."""

OF_NEXT_RUN = ("folder", "clock", "clock_of", "frame", "poses")
"""Options of `learn` with --measured."""

OF_SIMULATED_LEARNING = (
    "plant",
    "iterations",
    "measured_by",
    "time_limit",
    "encoder_noise",
    "seed",
)
"""Options of `learn` without --measured."""

OF_BOTH = ("frequency_hz", "gain", "controller", "sample_time", "delay")
"""Options of `learn` with and without --measured, fields of LearningOptions."""


def control(args: Namespace, log: Progress) -> VerbResult:
    """Simulate a move in the closed loop with feedforward, for the model and robots that differ
    from it.
    """
    from flexgen.feedback.loop.control import control as simulate
    from flexgen.simulation.environment.disturbances import Disturbance
    from flexgen.views.reports.row_views import text_of_rows

    model = read_model(args)
    acting = {
        "disturbances": [Disturbance(**given) for given in args.disturbances or ()],
        "wall": wall_of(args),
        **keywords(args, "disturbances", "wall"),
    }
    tell = throttle(log)
    with limit_fit("control", args.time_limit, tell, first="robot"):
        run = simulate(model, **acting, progress=tell)
        part_known("simulations", run.wall_s, 2)
        parts: dict[str, tuple[Part, ...]] = {}
        left = []
        for name, further in _further(args, model, run, acting, log):
            with keep_best():
                if not is_over():
                    parts[name] = further()
            if name not in parts:
                left.append(name)
        fewer = "ended" in data_of(parts.get("drawn", ()))
        ended = reason_of_end() if run.ended or left or fewer else ""
    inner = (Inner(name, content) for name, content in parts.items())
    content = (*run.content(), *inner)
    data = data_of(content)
    text = text_of_rows(content)
    problem = "" if run.status == "done" else run.status
    if left:
        missing = f"{ended}: not computed: {', '.join(left)}"
        data["status"] = missing if run.status == "done" else run.status
        problem = "; ".join(filter(None, [problem, missing]))
    elif ended and not problem:
        problem = f"{ended}: fewer drawn robots than asked for"
        data["status"] = problem
    interrupted = ended == INTERRUPTED
    return with_files(text, data, written(args, run), problem, interrupted=interrupted)


Further = Callable[[], tuple[Part, ...]]


def _further(
    args: Namespace, model: RobotModel, run: Any, acting: dict[str, Any], log: Progress
) -> list[tuple[str, Further]]:
    """Further results of `control`, computed after the run: their contents by the keys of JSON;
    each can be left out.
    """
    is_done = run.status == "done" or bool(run.ended)

    def feedforward() -> tuple[Part, ...]:
        from flexgen.feedback.loop.feedforward import compare_feedforward

        log("control: the same without feedforward, and with that of the rigid robot")
        options = {key: value for key, value in acting.items() if key != "time_limit"}
        compared = compare_feedforward(run, options, progress=throttle(log))
        if is_over():
            raise OutOfTime("feedforward")
        return compared.content()

    def passivity() -> tuple[Part, ...]:
        from flexgen.feedback.laws.passivity import check_passivity

        return check_passivity(run).content()

    def draw_robots() -> tuple[Part, ...]:
        from flexgen.studies.tolerances.in_loop import content_of_drawn, error_in_loop

        options = keywords(args, "move", "plants", "disturbances", "wall", "assumed_force")
        found = error_in_loop(run, progress=throttle(log), wall=wall_of(args), **options)
        return content_of_drawn(found)

    asked = {
        "feedforward": (feedforward, args.compare is not False and is_done),
        "passivity": (passivity, bool(args.passivity)),
        "drawn": (draw_robots, model.uncertainty is not None and is_done),
    }
    return [(name, compute) for name, (compute, wanted) in asked.items() if wanted]


def score(args: Namespace, log: Progress) -> VerbResult:
    """Score controllers in a benchmark: one axis with four masses, or an arm with two links."""
    from flexgen.studies.scenarios.leaderboard import controller_names
    from flexgen.studies.scenarios.scenario_file import scenario
    from flexgen.studies.scenarios.score import score as compute
    from flexgen.views.reports.score_text import scores_text

    chosen = scenario(args.scenario)
    given = controller_names(chosen, args.controller or ["reference"])
    if args.report is not None and len(given) > 1:
        raise ArgumentError(f"--report: given {len(given)} controllers, expected one")
    tell = throttle(log)
    found: list[Any] = []
    with limit_fit("score", args.time_limit, tell, first="draw"):
        for name in given:
            log(f"score: {name}")
            with keep_best():
                found.append(compute(chosen, name, seed=args.seed, progress=tell))
            if len(found) == len(given) or is_over():
                break
            part_known("controllers", found[-1].wall_s, len(given) - len(found))
        early = reason_of_end() if len(found) < len(given) or found[-1].ended else ""
    text = scores_text(chosen, found)
    data: dict[str, Any] = {
        "scenario": chosen.name,
        "version": chosen.version,
        "hash": chosen.digest,
        "scores": [s.to_dict() for s in found],
    }
    missing = given[len(found) :]
    if early:
        data |= {"status": early, "not_scored": list(missing)}
    refused = [s.controller for s in found if not s.accepted]
    problems = [f"refused: {', '.join(refused)}"] if len(found) == len(refused) else []
    problems += [f"{s.controller}: {s.status}" for s in found if s.ended]
    problems += [f"{early}: not scored: {', '.join(missing)}"] if missing else []
    files = {"report": partial(found[0].report, args.report)} if args.report is not None else {}
    interrupted = early == INTERRUPTED
    return with_files(text, data, files, "; ".join(problems), interrupted=interrupted)


def tune(args: Namespace, log: Progress) -> VerbResult:
    """Tune the P-PI cascade of a robot on its model set, or on the score of a benchmark."""
    if not _is_benchmark(args.scenario):
        return _tune_model(args, log)
    from flexgen.studies.scenarios.tune import tune as improve

    alone(args, "a benchmark", *OF_MODELS)
    log(f"tune: {args.starts * args.evaluations} evaluations, about two seconds each")
    began = time.perf_counter()
    tuned = improve(args.scenario, **keywords(args), progress=throttle(log))
    text = f"{tuned}\n  {number(time.perf_counter() - began)} s"
    refused = "" if tuned.score.accepted else "the tuned controller is refused"
    early = f"{tuned.ended}: the controller is the best so far" if tuned.ended else ""
    problem = "; ".join(filter(None, [refused, early]))
    files: dict[str, Writer] = {"controller": partial(tuned.save, args.out)}
    interrupted = is_interrupted(tuned)
    return with_files(text, tuned.to_dict(), files, problem, interrupted=interrupted)


def _is_benchmark(name: str) -> bool:
    """Whether a name is that of a benchmark, or of a .toml file that is not a model."""
    from flexgen.studies.scenarios.scenario_file import NAMES

    if str(name).partition("@")[0] in NAMES:
        return True
    path = FilePath(name)
    if path.suffix != ".toml" or not path.is_file():
        return False
    text = path.read_text(encoding="utf-8", errors="replace")
    return not re.search(r"^\s*\[{1,2}\s*(element|urdf)\b", text, re.MULTILINE)


def _tune_model(args: Namespace, log: Progress) -> VerbResult:
    """The cascade of a model, on the robots of its tolerances or those that are given."""
    from flexgen.model.reader import read
    from flexgen.simulation.environment.disturbances import Disturbance
    from flexgen.studies.scenarios.tune_cascade import TUNED, tune_cascade

    alone(args, "a model", "starts", "workers")
    model = read(args.scenario)
    names = (*OF_MODELS, "time_limit", "controller", "evaluations", "seed")
    given = {name: getattr(args, name) for name in names if name in args.given}
    if "plants" in given:
        given["plants"] = dict(given["plants"])
    elif model.uncertainty is not None:
        from flexgen.studies.tolerances.in_loop import draw_plants

        given["plants"] = draw_plants(model, ROBOTS)
    if "disturbances" in given:
        given["disturbances"] = [Disturbance(**each) for each in given["disturbances"]]
    tuned = tune_cascade(model, **given, progress=throttle(log))
    data = tuned.to_dict() | {"controller": str(args.out)}
    if not tuned.robust:
        return VerbResult(data, tuned.to_text(), "no controller with the margins was found")
    text = f"{tuned.to_text()}\n\nwrote {tuned.save(args.out)}"
    text += f"\nnext: flexgen control {args.scenario} --controller {args.out}"
    problem = "" if tuned.status == TUNED else f"{tuned.status}: the best controller so far"
    return VerbResult(data, text, problem, interrupted=tuned.status == "interrupted")


def learn(args: Namespace, log: Progress) -> VerbResult:
    """Learn a path of a simulated robot, or with --measured of the real one, and write the torques
    and references of its next run.
    """
    from flexgen.cli.verbs.plain import plain
    from flexgen.planning.learning.next_run import next_run
    from flexgen.planning.learning.options import LearningOptions

    if args.measured is None:
        alone(args, "learn without --measured", *OF_NEXT_RUN)
        return plain(args, log)
    alone(args, "--measured", *OF_SIMULATED_LEARNING)
    if args.folder is None:
        raise ArgumentError(
            "--measured: given without --folder, expected also the folder of the move, with the "
            "torques of its last run in trajectory.csv: --folder DIR"
        )
    names = ("clock", "clock_of", "frame", "poses", *OF_BOTH)
    options = {name: getattr(args, name) for name in names if name in args.given}
    found = next_run(
        read_model(args),
        args.folder,
        args.measured,
        args.move,
        options=LearningOptions(**options),
        progress=throttle(log),
    )
    return with_files(found.to_text(), found.to_dict(), written(args, found), found.problem)


def fastest(args: Namespace, log: Progress) -> VerbResult:
    """Find the fastest time law of a move within the limits, by exact inverse dynamics; solve and
    verify it.
    """
    from flexgen.dynamics.mechanics.limits import Limits
    from flexgen.planning.fastest.minimum_time import fastest as search

    model = read_model(args)
    own = {"torque": args.torque, "speed": args.speed}
    numbers: dict[str, Any] = {
        key: list(x) if len(x) > 1 else x[0] for key, x in own.items() if x is not None
    }
    limits = Limits.from_model(model, **numbers) if numbers else Limits()
    limits = replace(limits, reserve=args.reserve or 0.0)
    found = search(model, limits=limits, **keywords(args), progress=throttle(log))
    solved = found.solution.status.value in ("solved", "limits exceeded")
    problem = "" if solved else f"the fastest move is {found.solution.status}"
    return with_files(str(found), found.to_dict(), written(args, found.solution), problem)


def _command(model: RobotModel, command: list[float]) -> VerbResult:
    """Positions of the trackers at rest, with and without deflections."""
    from flexgen.paths.inverse_kinematics.forward import tracker_positions

    named = [sensor.name for sensor in model.sensors if sensor.type == "tracker"] or ["tool"]
    at_rest = tracker_positions(model, [command])[0]
    sag = at_rest - tracker_positions(model, [command], sag=False)[0]
    rows = [
        [name, *p.tolist(), *(1e3 * d).tolist()]
        for name, p, d in zip(named, at_rest, sag, strict=True)
    ]
    data = {
        "model": model.name,
        "command": command,
        "names": named,
        "position_m": at_rest.tolist(),
        "sag_m": sag.tolist(),
    }
    head = ("", "x, m", "y, m", "z, m", "sag x, mm", "y, mm", "z, mm")
    return VerbResult(
        data, f"{model.title}: at rest under gravity, motors at {command}\n\n{table(rows, head)}"
    )


def kinematics(args: Namespace, log: Progress) -> VerbResult:
    """Find all joint configurations of a six-axis arm that bring the tool to a pose."""
    from flexgen.paths.inverse_kinematics.search import kinematics as search
    from flexgen.paths.inverse_kinematics.tool_pose import ToolPose
    from flexgen.views.reports.texts import configurations_text

    model = read_model(args)
    if args.command is not None:
        alone(args, "--command", "joints", "position", "rotation", "sag", "fixed")
        return _command(model, args.command)
    if (args.joints is None) == (args.position is None):
        raise ArgumentError("kinematics: expected either --joints or --position (and --rotation)")
    if args.joints is not None:
        alone(args, "--joints", "rotation")
        pose = ToolPose.of_joints(model, args.joints, log)
    else:
        pose = ToolPose.of_vectors(args.position, args.rotation or [0.0, 0.0, 0.0])
    found = search(model, pose.position, pose.rotation, fixed=dict(args.fixed or ()), sag=args.sag)
    data = {"model": model.name, **pose.to_dict(), "configurations": [c.to_dict() for c in found]}
    if not found:
        return VerbResult(data, "", f"the pose cannot be reached: {pose}")
    return VerbResult(
        data,
        f"{model.name}: {len(found)} configurations at {pose}\n"
        "\n"
        f"{configurations_text(model, found)}",
    )
