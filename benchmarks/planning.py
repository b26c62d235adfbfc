"""Planned motions compared with other programs: writes benchmarks/planning.md (ten minutes).

``python benchmarks/planning.py [INTERPRETER]``: an interpreter with opty for the rows of opty.
Processor times of one thread, the least of several runs in this process.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from inversion_opty_job import job
from planning_peers import opti
from planning_peers.opti import by_hand, check_by_hand, with_flexgen

import flexgen
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.planning.optimal.start import scales
from flexgen.planning.optimal.transcribe import Layout
from flexgen.simulation.simulate import simulate

TARGET = Path(__file__).with_suffix(".md")
CASES = (("planar5_nmp", "line", 50, "tau_m", 5), ("manutec_r3_18", "joints", 40, "a_m", 1))
OPTY = Path(__file__).with_name("planning_peers") / "opty_rest_to_rest.py"
OPTY_NODES = (51, 101, 161, 251)
OPTY_LIMIT = 400.0  # s of wall time


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A table in Markdown."""
    head = list(head)
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def lines_of(path: Path, *names: str) -> int:
    """Lines of code of functions of a file, without blank lines and docstrings."""
    text = path.read_text(encoding="utf-8")
    count = 0
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef) and node.name in names:
            body = node.body[1:] if isinstance(node.body[0], ast.Expr) else node.body
            part = text.splitlines()[body[0].lineno - 1 : node.end_lineno]
            count += sum(1 for line in part if line.strip() and not line.strip().startswith("#"))
    return count


def timed(call: Callable[[], Any], repeat: int) -> tuple[Any, float]:
    """The result and the least processor time of several calls [s]."""
    best = np.inf
    found = None
    for _ in range(repeat):
        began = time.process_time()
        found = call()
        best = min(best, time.process_time() - began)
    return found, best


def comparison(python: str | None, most: int | None) -> str:
    """flexgen, Opti and opty on the same problems."""
    rows: list[tuple[object, ...]] = []
    file = Path(opti.__file__)
    hand = lines_of(file, "by_hand", "rest"), lines_of(file, "check_by_hand")
    for model, move, mesh, cost, repeat in CASES[:most]:
        what = f"{model}, {move}, {cost}"
        plan, seconds = timed(lambda a=(model, move, mesh, cost): with_flexgen(*a), repeat)
        own = lines_of(file, "with_flexgen")
        error = f"{1e6 * plan.plan_error_max_m:.2g}"
        value = f"{plan.details['cost']:.6e}"
        rows.append(
            (what, "flexgen", own, f"{mesh}", f"{seconds:.2f}", plan.iterations, value, error)
        )
        print(rows[-1], flush=True)
        try:
            made, seconds = timed(lambda a=(model, move, mesh, cost): by_hand(*a), min(repeat, 2))
        except RuntimeError as problem:
            rows.append(
                (
                    what,
                    "CasADi Opti",
                    f"{hand[0]} + {hand[1]}",
                    f"{mesh}",
                    "-",
                    "-",
                    str(problem)[-60:],
                    "-",
                )
            )
            print(rows[-1], flush=True)
            continue
        off = check_by_hand(*made)
        count = made[1].stats()["iter_count"]
        value = f"{float(made[1].value(made[1].f)):.6e}"
        lines = f"{hand[0]} + {hand[1]}"
        rows.append(
            (
                what,
                "CasADi Opti",
                lines,
                f"{mesh}",
                f"{seconds:.2f}",
                count,
                value,
                f"{1e6 * off:.2g}",
            )
        )
        print(rows[-1], flush=True)
    if python is not None:
        rows += [opty_row(python, "planar5_nmp, line, tau_m", nodes) for nodes in OPTY_NODES]
    head = (
        "problem",
        "program",
        "lines",
        "intervals",
        "processor time, s",
        "iterations",
        "cost",
        "simulated error, um",
    )
    return table(head, rows)


def opty_row(python: str, what: str, nodes: int) -> tuple[object, ...]:
    """opty on the planar arm, in its own interpreter."""
    equations = flexgen.derive("planar5_nmp")
    path = flexgen.plan(equations, "line")
    stated = job(InversionProblem(equations, path), nodes, False)
    problem = flexgen.plan_problem(equations, "line", mesh=10)
    still = np.zeros(equations.model.dof)
    h = path.duration / (nodes - 1)
    found = problem._start(Layout((problem,), ()), "rest")
    y, dy, _, tau = problem.mesh.unpack(found[: problem.mesh.size])
    t = path.duration * problem.mesh.nodes
    t_tau = path.duration * problem.mesh.times
    grid = h * np.arange(nodes)
    guess = [np.interp(grid, t, column) for column in np.hstack([y, dy / path.duration]).T]
    guess += [np.interp(grid, t_tau, column) for column in tau.reshape(-1, equations.model.n_m).T]
    stated |= {"step": h, "nodes": nodes, "guess": [list(column) for column in guess]}
    stated["rest"] = [list(np.r_[rest, still]) for rest in (problem.y_start, problem.y_end)]
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "job.json"
        file.write_text(json.dumps(stated))
        command = [python, str(OPTY), str(file)]
        lines = lines_of(OPTY, "answer")
        try:
            out = subprocess.run(
                command, capture_output=True, text=True, timeout=OPTY_LIMIT, check=False
            )
        except subprocess.TimeoutExpired:
            return (
                what,
                "opty",
                lines,
                nodes - 1,
                "-",
                "-",
                f"not finished in {OPTY_LIMIT:g} s",
                "-",
            )
    try:
        answer = json.loads(out.stdout.splitlines()[-1])
    except (IndexError, json.JSONDecodeError):
        return what, "opty", lines, nodes - 1, "-", "-", f"failed: {out.stderr[-80:]!r}", "-"
    if "missing" in answer:
        return what, "opty", lines, nodes - 1, "-", "-", answer["missing"], "-"
    off = opty_error(equations, answer, grid)
    value = f"{answer['cost']:.6e}"
    seconds = f"{answer['build_s']:.1f} + {answer['solve_s']:.2f}"
    row = (
        what,
        "opty",
        f"{lines}, equations given",
        nodes - 1,
        seconds,
        "-",
        value,
        f"{1e6 * off:.2g}",
    )
    print(row, answer["status"], flush=True)
    return row


def opty_error(equations: Any, answer: dict, t: np.ndarray) -> float:
    """Simulated distance of the output from the plan of opty; its torques interpolated by a spline
    [m].
    """
    model = equations.model
    states = np.array(answer["states"]).T
    tau = np.array(answer["inputs"]).T
    q_a = states[:, : model.n_a]
    q_m = states[:, model.n_a : model.n_a + model.n_m]
    plan = (
        flexgen.plan_problem(equations, "line", mesh=10)
        .solve(accuracy=1.0, progress=False)
        .trajectory
    )
    channels = {"tau_m": tau, "q_a": q_a, "q_m": q_m}
    ports, labels = (
        {name: getattr(plan, x)[name] for name in channels} for x in ("ports", "labels")
    )
    run = simulate(equations, Trajectory(t, channels, ports, labels, {"model": model.name}))
    both = [
        evaluate(equations.function("output"), q)[0].reshape(len(t), -1)
        for q in (q_a, run.trajectory["q_a"])
    ]
    return float(np.linalg.norm(both[0] - both[1], axis=1).max())


def evaluation(most: int | None) -> str:
    """Constraints, Jacobian and Hessian by CasADi's virtual machine and by compiled C."""
    rows = []
    for name, mesh, exact in (
        ("planar5_nmp", 50, True),
        ("manutec_r3_18", 50, False),
        ("manutec_r3_18", 50, True),
    )[:most]:
        problem = flexgen.plan_problem(name, mesh=mesh)
        problem.add_squares(problem["a_m"] / 100)
        layout = Layout((problem,), ())
        start = problem._start(layout, None)
        size = scales(layout, [], start)
        times = []
        builds = []
        for compiled in (False, True):
            began = time.perf_counter()
            made = problem._program(layout, size, start, exact, compiled)
            builds.append(time.perf_counter() - began)
            lam = ca.MX.sym("lam", made.g.numel())
            sigma = ca.MX.sym("sigma")
            point = [start / size, np.ones(made.g.numel()), 1.0]
            one = []
            for value in (made.g, made.jacobian, made.hessian(sigma, lam)):
                function = ca.Function("value", [made.x, lam, sigma], [value])
                one.append(timed(lambda f=function, p=point: f(*p), 9)[1])
            times.append(one)
        cells = [
            f"{1e3 * a:.2f} / {1e3 * b:.2f} = {a / b:.1f}" for a, b in zip(*times, strict=True)
        ]
        rows.append((name, "exact" if exact else "Gauss-Newton", *cells, f"{builds[1]:.1f}"))
        print(rows[-1], flush=True)
    head = (
        "model, 50 intervals",
        "Hessian",
        "constraints, ms",
        "Jacobian, ms",
        "Hessian, ms",
        "build with C, s",
    )
    return table(head, rows)


def least_time(most: int | None) -> str:
    """The free time law against `flexgen.fastest`."""
    rows = []
    limits = None
    for count in (16, 40, 60)[:most]:
        found = flexgen.fastest("planar5_nmp", "line", coefficients=count, progress=False)
        limits = found.limits
        error = f"{1e6 * found.solution.tool_error_max_m:.2g}"
        rows.append(
            (
                f"flexgen.fastest, {count} coefficients",
                f"{found.duration_s:.4f}",
                error,
                f"{found.cpu_s:.1f}",
            )
        )
    for tolerance in (1e-5, 1e-6)[:most]:
        problem = flexgen.plan_problem(
            "planar5_nmp", "line", mesh=100, timing="free", limits=limits
        )
        problem.free_time(0.2, 1.0)
        problem.add_cost(problem.duration, at="end")
        problem.add_cost(1e-6 * ca.sumsqr(ca.diff(problem.nodes("tau_m").T)))
        problem.follow(tolerance=tolerance)
        plan = problem.solve(progress=False)
        what = f"plan_problem, within {1e6 * tolerance:g} um in x and y"
        rows.append(
            (
                what,
                f"{plan.move.duration:.4f}",
                f"{1e6 * plan.path_distance_max_m:.2g}",
                f"{plan.cpu_s:.1f}",
            )
        )
    rows.append(("rigid robot, lower bound", f"{found.rigid_s:.4f}", "-", "-"))
    return table(
        (
            "planar5_nmp, line",
            "duration, s",
            "simulated distance from the path, um",
            "processor time, s",
        ),
        rows,
    )


def main() -> None:
    """Measure and write; ``--quick``: the first case of each table, nothing written."""
    quick = "--quick" in sys.argv
    words = [word for word in sys.argv[1:] if word != "--quick"]
    python = words[0] if words else None
    most = 1 if quick else None
    measured = evaluation(most), least_time(most), comparison(python, most)
    if quick:
        print(*measured, sep="\n")
        return
    parts = [
        "# Planned motions\n",
        "Written by `python benchmarks/planning.py INTERPRETER` (an interpreter with opty). "
        "Processor times of one thread of a shared machine, the least of several runs; they "
        "include building the problem and, for flexgen, the verification by simulation. Lines: "
        "code of the functions in `planning_peers` without blank lines and docstrings; for Opti "
        "those of the problem and those of the check by simulation.\n",
        "## The same problem by three programs\n",
        "Rest to rest with the least integral of squared torques (planar arm) or motor "
        "accelerations (six axes, 18 degrees of freedom), on the full elastic robot. flexgen "
        "and Opti use Gauss collocation with three points, opty the midpoint rule; opty gets "
        "the equations as text, and its time is that of building and solving. Its cost and its "
        "error are those of the midpoint rule on these intervals; the six axes were not tried "
        "with it. The error of flexgen is the largest of the whole motion, that of Opti the "
        "largest at the nodes.\n",
        measured[2],
        "\n## Compiled C inside IPOPT\n",
        "One evaluation by CasADi's virtual machine / by compiled C = ratio. The C is compiled "
        "once for a model and its constraints and kept in the user's cache; the last column is "
        "the time to build the program, with the compiler where the cache is empty. `solve` "
        "compiles functions of more than 1e6 operations times instants.\n",
        measured[0],
        "\n## The shortest time along a line\n",
        "Same path, same torque limits (the largest torques of the move as given).\n",
        measured[1],
    ]
    TARGET.write_text("\n".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main()
