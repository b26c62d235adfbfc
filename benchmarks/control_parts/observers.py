"""Observers for benchmarks/control.py: times in C, and what they see of robots that differ from
the model.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable
from typing import Any

import numpy as np

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.codegen.build.c_module import compile_module
from flexgen.codegen.build.model_library import library_with
from flexgen.dynamics.mechanics.equations import derive
from flexgen.planning.learning.smoother import acting

ACCELEROMETER = {
    "name": "acc",
    "type": "accelerometer",
    "element": "tool",
    "unit": "m/s^2",
    "noise": 0.05,
}
OUTPUTS = ("motors", ("motors", "tool_accelerometer"))
ROUNDS = 400
CALLS = 20
TIMER = """
#define _POSIX_C_SOURCE 199309L
#include <stdint.h>
#include <time.h>
typedef int (*kalman)(void *, const double *, const double *);
typedef int (*gain)(void *, int64_t, const double *, const double *, double *);
typedef int (*plant)(const double *, const double *, const double *, const double *, const double \
*, double *, double *,
    double *);
static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}
__attribute__((visibility("default"))) void times(int rounds, int calls, void (*f)(void), int \
kind, void *self,
    void (*model)(void), double **x, double *best)
{
    best[0] = best[1] = 1e30;
    for (int r = 0; r < rounds; ++r) {
        double begin = now(), middle, end;
        for (int i = 0; i < calls; ++i) {
            (void)(kind ? ((gain)f)(self, 0, x[0], x[1], x[2]) : ((kalman)f)(self, x[0], x[1]));
        }
        middle = now();
        for (int i = 0; i < calls; ++i) {
            (void)((plant)model)(x[3], x[4], x[5], x[6], x[1], x[7], x[8], x[9]);
        }
        end = now();
        best[0] = (middle - begin) / calls < best[0] ? (middle - begin) / calls : best[0];
        best[1] = (end - middle) / calls < best[1] ? (end - middle) / calls : best[1];
    }
}
"""


def _times(
    function: Any, kind: int, memory: np.ndarray, y: np.ndarray, u: np.ndarray, model: Any
) -> list[float]:
    """Least microseconds of a step of an observer, and of one call of the forward dynamics, in
    turns.
    """
    library = library_with(model, ["forward_dynamics", "linearize"], native=True)
    address, work = library.forward_dynamics.single_address()
    n_a = model.n_a
    n_m = model.n_m
    rest = np.zeros(n_a), np.zeros(n_a), model.eta @ np.array(model.home), np.zeros(n_m)
    arrays = [
        y,
        u,
        np.zeros(4 * (n_a + n_m)),
        *rest,
        np.zeros(n_a),
        np.zeros(n_m),
        np.zeros(work.size + 1),
    ]
    pointers = (ctypes.c_void_p * len(arrays))(*(x.ctypes.data for x in arrays))
    best = np.zeros(2)
    timer = ctypes.CDLL(str(compile_module("observer_times", TIMER)))
    timer.times(
        ROUNDS,
        CALLS,
        ctypes.cast(function, ctypes.c_void_p),
        kind,
        ctypes.c_void_p(memory.ctypes.data),
        ctypes.c_void_p(address),
        pointers,
        ctypes.c_void_p(best.ctypes.data),
    )
    return best.tolist()


def observer_times(names: Iterable[str]) -> list[tuple[object, ...]]:
    """Rows: model, states, outputs, observer, microseconds, and these over one call of the forward
    dynamics.
    """
    rows: list[tuple[object, ...]] = []
    for name in names:
        solution = flexgen.solve(name, progress=False)
        for outputs in OUTPUTS:
            told = "motors" if outputs == "motors" else "motors, 3 accelerations"
            for disturbances in (False, True):
                ekf = flexgen.ExtendedKalmanFilter(
                    name, outputs, disturbances=disturbances, native=True
                )
                motion = ekf._at_rest(ekf.model.eta @ np.array(ekf.model.home))
                y = np.zeros(len(ekf.outputs))
                y[: ekf.model.n_m] = motion[3][0]
                if ekf.model.sensors:
                    y[ekf.model.n_m :] = ekf._library.sensors(
                        motion[0][0], motion[1][0], motion[2][0]
                    )
                u = np.ascontiguousarray(motion[6][0])
                step = ekf._module.flexgen_kalman_step
                best = _times(step, 0, ekf._memory, y, u, ekf.model)
                assert ekf.status == "done"
                title = "extended, with disturbances" if disturbances else "extended"
                rows.append(
                    (
                        name,
                        len(ekf.states),
                        told,
                        title,
                        f"{best[0]:.1f}",
                        f"{best[0] / best[1]:.0f}",
                    )
                )
            observer = flexgen.ConstantGainObserver(solution, outputs, native=True, parts=2)
            y = observer._tables["y_ref"][0].copy()
            u = observer._tables["u_ref"][0].copy()
            step = observer._module.flexgen_constant_gain_step
            best = _times(step, 1, observer._memory, y, u, observer.model)
            title = "constant gain, with disturbances"
            rows.append(
                (
                    name,
                    len(observer.states),
                    told,
                    title,
                    f"{best[0]:.2f}",
                    f"{best[0] / best[1]:.1f}",
                )
            )
    return rows


def observer_errors(names: Iterable[str]) -> list[tuple[object, ...]]:
    """Rows: largest error of the tool's place [mm]: of the reference, and as estimated."""
    rows: list[tuple[object, ...]] = []
    for name in names:
        model = flexgen.read(name, overrides={"sensor": [ACCELEROMETER]})
        solution = flexgen.solve(model, progress=False)
        run = flexgen.control(
            model,
            controller=flexgen.PPI(10, 40, 0.5),
            sample_time=1e-3,
            encoder_noise=1e-4,
            solution=solution,
            plants={"K -20 %": {"stiffness": 0.8}, "tool pulse": {}},
            progress=False,
            disturbances={
                "tool pulse": [flexgen.Disturbance("pulse", "tool.x", 300.0, 0.4, 0.02)]
            },
        )
        place = derive(model).function("forward_kinematics")
        moving = run.reference.time >= run.reference.begin

        def largest(
            q: np.ndarray, true: np.ndarray, place: Any = place, moving: np.ndarray = moving
        ) -> str:
            found = evaluate(place, np.ascontiguousarray(q))[0] - evaluate(place, true)[0]
            return f"{1e3 * np.linalg.norm(found, axis=1)[moving].max():.3f}"

        for robot in run.runs:
            u = acting(robot.tau_m, 0, 0.0)
            row = [largest(run.reference.motion["q_a"], robot.q_a)]
            for outputs in ("motors", ("motors", "acc")):
                y = (
                    robot.measured
                    if outputs == "motors"
                    else np.hstack([robot.measured, robot.sensors])
                )
                ekf = flexgen.ExtendedKalmanFilter(model, outputs)
                ekf.reset(robot.measured[0])
                row.append(largest(ekf.run(y, u).q_a, robot.q_a))
                constant = flexgen.ConstantGainObserver(solution, outputs)
                row.append(largest(constant.run(y, u)[:, : model.n_a], robot.q_a))
            rows.append((name, robot.name, *row))
    return rows


def learned_errors(names: Iterable[str]) -> list[tuple[object, ...]]:
    """Rows: errors of learning at stiffness -20 % by tracker and by accelerometers [mm], without
    and after learning.
    """
    rows: list[tuple[object, ...]] = []
    for name in names:
        solution = flexgen.solve(name, progress=False)
        for measured_by in ("tracker", "accelerometer"):
            found = flexgen.learn(
                name,
                plant={"stiffness": 0.8},
                solution=solution,
                iterations=6,
                sample_time=1e-3,
                encoder_noise=1e-4,
                measured_by=measured_by,
                progress=False,
            )
            texts = [
                ", ".join(f"{1e3 * e:.3f}" for e in errors)
                for errors in (found.errors_m, found.dynamic_errors_m, found.measured_m)
            ]
            rows.append((name, measured_by, *texts, found.best))
    return rows
