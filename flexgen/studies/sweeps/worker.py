"""Worker: solves the cases of a shard; a case that fails becomes a row with the reason."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict

import numpy as np
from scipy.integrate import trapezoid

from flexgen.base.calls.deadline import check_time
from flexgen.base.calls.progress import reporting
from flexgen.base.errors import FlexgenError
from flexgen.dynamics.mechanics.equations import Equations, derive
from flexgen.inversion.solution import Solution
from flexgen.inversion.solve import solve
from flexgen.model.elements import RobotModel
from flexgen.studies.sweeps.batches import Batches
from flexgen.studies.sweeps.jobs import Job, Row, Rows, Shard, failed_row
from flexgen.studies.sweeps.version import code_version, wants_native

KEPT = 2  # models whose equations a worker keeps

_ALONE = threading.Lock()  # CasADi's graphs must not be built by two threads at once
_EQUATIONS: OrderedDict[str, Equations] = OrderedDict()


class WrongCode(FlexgenError):
    """The code of a worker differs from that of the sweep."""


def run_shard(shard: Shard) -> Rows:
    """Solve all cases of a shard, one after the other; only different code or an interruption
    stops it.
    """
    own = code_version(wants_native(shard.options))
    if shard.code != own:
        raise WrongCode(
            f"sweep: given a worker with flexgen {own}, expected {shard.code}; all computers "
            "need the same flexgen, casadi, numpy, scipy and C compiler (or none)"
        )
    with _ALONE, reporting(False, "sweep"):  # a worker shows nothing
        done = Batches(shard, _equations).rows() if shard.options.get("batch") else {}
        results = []
        times = []
        for job in shard.jobs:
            row, took = done[job.number] if job.number in done else _one(job, shard)
            results.append(job.heading | row)
            times.append({"case": job.number} | took)
    return Rows(results, times)


def _one(job: Job, shard: Shard) -> tuple[Row, Row]:
    """One case by `flexgen.solve`: its row of results and its row of times."""
    wall = time.perf_counter()
    cpu = time.process_time()
    robot = shard.robots[job.key]
    options = {name: value for name, value in shard.options.items() if name != "batch"}
    options = {"time_limit": None} | options  # results must not depend on the load of the computer
    try:
        if isinstance(robot, str):
            row = failed_row(robot)
        else:
            solution = solve(_equations(job.key, robot), job.move_of(robot), job.method, **options)
            check_time(f"case {job.number}")
            if solution.interrupted:
                raise KeyboardInterrupt
            row = _row(solution)
    except FlexgenError as error:
        # the time limit of the sweep ended the case: it has no row
        check_time(f"case {job.number}")
        row = failed_row(str(error))
    except Exception as error:  # an error in one case must not lose the others
        row = failed_row(f"{type(error).__name__}: {error}")
    return row, {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}


def _row(solution: Solution) -> Row:
    """The figures of a solution: torques [N m] and speeds [rad/s] of the largest motor, energy [J]
    of all, and its errors.
    """
    simulation = solution.simulation
    trajectory = solution.trajectory
    t = trajectory.time
    tau = trajectory["tau_m"]
    speed = trajectory["v_m"]
    return {
        "move": solution.move.name,
        "method_used": solution.method,
        "status": solution.status.value,
        "verdict": solution.verdict,
        "tool_error_max": solution.tool_error_max_m,
        "turn_error_max": solution.tool_error_max_rad,
        "plan_error_max": solution.plan_error_max_m,
        "plan_turn_error_max": solution.plan_error_max_rad,
        "torque_max": float(np.abs(tau).max()),
        "torque_rms": float(np.sqrt(trapezoid(tau**2, t, axis=0).max() / (t[-1] - t[0]))),
        "speed_max": float(np.abs(speed).max()),
        "energy": float(trapezoid((tau * speed).sum(axis=1), t)),
        "residual_max": solution.residual_max_Nm,
        "residual_relative": solution.residual_relative,
        "energy_error": None if simulation is None else simulation.energy_error,
        "iterations": solution.iterations,
        "samples": len(t),
        "preactuation": solution.preactuation_s,
        "warnings": "\n".join(solution.warnings),
    }


def _equations(key: str, robot: RobotModel) -> Equations:
    """The equations of a model; the last used ones are kept."""
    if key not in _EQUATIONS:
        while len(_EQUATIONS) >= KEPT:
            _EQUATIONS.popitem(last=False)
        _EQUATIONS[key] = derive(robot)
    _EQUATIONS.move_to_end(key)
    return _EQUATIONS[key]
