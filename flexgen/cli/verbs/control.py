"""The verbs of control: control, learn, fastest, score, tune, kinematics."""

from __future__ import annotations

import time
from argparse import Namespace
from typing import Any

from flexgen.cli.printing import number, paragraph, table
from flexgen.cli.result import Progress, VerbResult, alone, keywords, read_model, written
from flexgen.cli.verbs.identify import throttle
from flexgen.errors import ArgumentError


def control(args: Namespace, log: Progress) -> VerbResult:
    """Simulate a move in the closed loop with feedforward, for the model and robots that differ from it."""
    from flexgen.loop.control import control as simulate
    from flexgen.loop.disturbances import Disturbance
    from flexgen.loop.result import UNITS, columns_in

    model = read_model(args)
    names = [name for name, _ in args.plants or ()]
    if len(set(names)) != len(names):
        raise ArgumentError(f"--plant: given {', '.join(names)}, expected different names")
    run = simulate(
        model,
        plants=dict(args.plants or ()),
        disturbances=[Disturbance(**given) for given in args.disturbances or ()],
        **keywords(args, "plants", "disturbances"),
        progress=throttle(log),
    )
    rows = []
    units = [u for u in UNITS if columns_in(model, u)]
    for r in run.runs:
        f = run.figures(r)
        lengths = [1e3 * f[f"{key}_{u}"] for u in units for key in ("error_max", "dynamic_error_max", "error_end")]
        rows.append([r.name, *lengths, f["torque_max_Nm"], r.saturated, r.failure])
    margins = run.margins()
    text = [
        f"{model.name}, move {run.solution.move.name}: {run.status}, controller {run.controller}, sample time "
        f"{number(1e3 * args.sample_time)} ms, delay {number(1e3 * args.delay)} ms",
        "",
        table(
            rows,
            (
                "robot",
                *(f"{what}, m{u}" for u in units for what in ("error", "dynamic", "at the end")),
                "torque, N m",
                "samples at the limit",
                "failure",
            ),
        ),
    ]
    text += [f"{r.name}: load {r.load}" for r in run.runs if r.load]
    if margins:
        head = ("pose", "stable", "gain margin", "delay margin, ms")
        text += ["", table([[k, str(m.stable), m.gain, 1e3 * m.delay_s] for k, m in margins.items()], head)]
    files, lines = written(args, run)
    text += [part for line in lines for part in ("", line)]
    data = run.to_dict() | {"margins": {k: m.to_dict() for k, m in margins.items()}} | files
    return VerbResult(data, "\n".join(text), problem="" if run.status == "done" else run.status)


def learn(args: Namespace, log: Progress) -> VerbResult:
    """Learn the path of a robot that differs from its model, in simulation, from its measured tool error."""
    from flexgen.performance.learn import learn as iterate

    model = read_model(args)
    learned = iterate(
        model,
        plant=args.plant[1] if args.plant else None,
        **keywords(args, "plant"),
        progress=log,
    )
    files, lines = written(args, learned)
    text = "\n\n".join([str(learned), *lines])
    failed = learned.errors[0] == float("inf")
    return VerbResult(learned.to_dict() | files, text, problem="the robot fails without correction" if failed else "")


def score(args: Namespace, log: Progress) -> VerbResult:
    """Score controllers in a benchmark: one axis with four masses, or an arm with two links."""
    from flexgen.benchmarks.leaderboard import find_shipped_controllers
    from flexgen.benchmarks.scenario_file import scenario
    from flexgen.benchmarks.score import score as compute

    chosen = scenario(args.scenario)
    given: list[str] = []
    for name in args.controller or ["reference"]:
        given += ["reference", *find_shipped_controllers(chosen.name, chosen.version)] if name == "all" else [name]
    if args.report is not None and len(given) > 1:
        raise ArgumentError(f"--report: given {len(given)} controllers, expected one")
    tell, found = throttle(log), []
    for name in given:
        log(f"score: {name}")
        found.append(compute(chosen, name, seed=args.seed, progress=tell))
    drawn = ("worst draw", "spread") if chosen.plan is not None and chosen.plan.draws > 1 else ()
    rows = [
        [
            s.controller,
            *([s.total, *([s.worst, s.spread] if drawn else []), *s.parts.values()] if s.accepted else ["refused"]),
            *([] if s.accepted else [""] * (1 + len(chosen.sets) + len(drawn))),
        ]
        for s in sorted(found, key=lambda s: s.total if s.accepted else float("inf"))
    ]
    text = [paragraph(chosen.title_line), "", table(rows, ("controller", "V", *drawn, "nominal", *chosen.sets))]
    if drawn:
        text += [
            "",
            paragraph(f"V: mean of {chosen.plan.draws if chosen.plan else 1} draws, spread: standard deviation."),
        ]
    for s in found:
        text += ["", paragraph(f"{s.controller}: {s.rule}")] if s.rule else []
    for s in found:
        text += ["", *(f"{s.controller} is refused: {reason}" for reason in s.refused)] if s.refused else []
    if len(found) == 1 and found[0].accepted:
        sets = list(chosen.sets)
        lines = [
            [row["measure"], row["unit"], row["weight"], *(row[key] for key in ("reference", "nominal", *sets))]
            for row in found[0].table
        ]
        text += ["", table(lines, ("measure", "unit", "weight", "reference", "nominal", *sets))]
    if args.report is not None:
        text += ["", f"wrote {found[0].report(args.report)}"]
    data: dict[str, Any] = {
        "scenario": chosen.name,
        "version": chosen.version,
        "hash": chosen.digest,
        "scores": [s.to_dict() for s in found],
    }
    refused = [s.controller for s in found if not s.accepted]
    problem = f"refused: {', '.join(refused)}" if refused and len(found) == len(refused) else ""
    return VerbResult(data, "\n".join(text), problem=problem)


def tune(args: Namespace, log: Progress) -> VerbResult:
    """Tune a P-PI cascade with filters on the score of a benchmark; write it to a file."""
    from flexgen.benchmarks.tune import tune as improve

    log(f"tune: {args.starts * args.evaluations} evaluations, about two seconds each")
    began = time.perf_counter()
    tuned = improve(
        args.scenario,
        **keywords(args),
        progress=throttle(log),
    )
    tuned.save(args.out)
    text = f"{tuned}\n  {number(time.perf_counter() - began)} s\nwrote {args.out}"
    data = tuned.to_dict() | {"controller": str(args.out)}
    return VerbResult(data, text, problem="" if tuned.score.accepted else "the tuned controller is refused")


def fastest(args: Namespace, log: Progress) -> VerbResult:
    """Find the fastest time law of a move within the limits, by exact inverse dynamics; solve and verify it."""
    from flexgen.inversion.bounds import Limits
    from flexgen.performance.minimum_time import fastest as search

    model = read_model(args)
    own = {"torque": args.torque, "speed": args.speed}
    numbers = {key: list(x) if len(x) > 1 else x[0] for key, x in own.items() if x is not None}
    found = search(
        model,
        limits=Limits.from_model(model, **numbers) if numbers else None,
        **keywords(args),
        progress=throttle(log),
    )
    files, lines = written(args, found.solution)
    solved = found.solution.status.value in ("solved", "limits exceeded")
    problem = "" if solved else f"the fastest move is {found.solution.status}"
    return VerbResult(found.to_dict() | files, "\n\n".join([str(found), *lines]), problem)


def kinematics(args: Namespace, log: Progress) -> VerbResult:
    """Find all joint configurations of a six-axis arm that bring the tool to a pose."""
    import numpy as np
    from scipy.spatial.transform import Rotation

    from flexgen.inverse_kinematics.search import kinematics as search

    model = read_model(args)
    joints = [model.coordinates[i] for i in model.i_g]
    if (args.joints is None) == (args.position is None):
        raise ArgumentError("kinematics: expected either --joints or --position (and --rotation)")
    if args.joints is not None:
        alone(args, "--joints", "rotation")
        if len(args.joints) != len(joints):
            raise ArgumentError(f"--joints: given {len(args.joints)} numbers, expected {len(joints)}")
        from flexgen.library.model_library import library_with

        library = library_with(model, ("forward_kinematics", "jacobian"), progress=log)
        full = np.zeros(model.n_a)
        full[list(model.i_g)] = args.joints
        position, rotation = (np.asarray(x) for x in library.forward_kinematics(full))
    else:
        turn = args.rotation or [0.0, 0.0, 0.0]
        if len(args.position) != 3 or len(turn) != 3:
            raise ArgumentError("--position, --rotation: expected three numbers each")
        position, rotation = np.array(args.position), Rotation.from_rotvec(turn).as_matrix()
    fixed = dict(args.fixed or ())
    found = search(model, position, rotation, fixed=fixed, sag=args.sag)
    head = (*(f"{c.name}, {c.unit}" for c in joints), "in limits", "shoulder elbow wrist", "singularity distance")
    rows = []
    for c in found:
        flags = " ".join(f"{sign:+d}" for sign in c.flags)
        inside, near = (
            "yes" if c.within_limits else "no",
            f"{c.distance:.3g} {c.nearest_singularity}{', singular' if c.singular else ''}",
        )
        rows.append([*map(float, c.q), inside, flags, near])
    vector = Rotation.from_matrix(rotation).as_rotvec()
    where = f"position {np.round(position, 6).tolist()} m, rotation vector {np.round(vector, 6).tolist()} rad"
    text = f"{model.name}: {len(found)} configurations at {where}\n\n{table(rows, head)}" if found else ""
    data = {
        "model": model.name,
        "position_m": position.tolist(),
        "rotation": rotation.tolist(),
        "configurations": [c.to_dict() for c in found],
    }
    return VerbResult(data, text, problem="" if found else f"the pose cannot be reached: {where}")
