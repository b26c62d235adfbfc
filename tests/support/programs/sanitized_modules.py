"""A program for libasan: modules of loop, controllers, observers and integrator with sanitizers,
and hostile numbers.

Arguments: a folder for a library of manutec_r3_18; ``planted``, to end with the first controller,
which has a bug.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import flexgen
import flexgen.codegen.build.c_module as c_module
import flexgen.codegen.build.generate as generate_module
from flexgen.base.errors import FlexgenError
from flexgen.codegen.build.compiler import Compiler, find_compiler
from flexgen.identification.responses.local_model import LocalModel
from flexgen.simulation.integration.segments import Segments

SANITIZE = (
    "-g",
    "-O1",
    "-fsanitize=address,undefined",
    "-fno-sanitize-recover=all",
    "-fno-omit-frame-pointer",
)
# writes behind the memory of the cascade
PLANTED = ("sum[j] += w * c->sample_s", "sum[j + 2] += w * c->sample_s")
BAD = [np.nan, np.inf, -1e300, 1e18, 0.0, 1e-300]


def sanitized(**options: Any) -> Compiler | None:
    found = find_compiler(**options)
    return found and replace(
        found, flags=(*found.flags, *SANITIZE), identity=f"{found.identity} sanitized"
    )


def tried(call: Any, *arguments: Any) -> None:
    """Call; errors of flexgen are answers."""
    with suppress(FlexgenError):
        call(*arguments)


def controllers() -> Any:
    """Runs of a robot with coordinates without motor, and of one without, under every controller
    in C.
    """
    plants = {"heavy": {"payload": 3.0, "stiffness": 0.8}}
    push = [flexgen.Disturbance("pulse", "tool.x", 300.0, 0.1, 0.02)]
    laws = {
        "planar5_nmp": (flexgen.PPI(), flexgen.LQG(), flexgen.LQ()),
        "elbow": (
            flexgen.FeedbackLinearisation(),
            flexgen.ComputedTorque(),
            flexgen.TomeiPD(),
            flexgen.JointTorqueFeedback(),
        ),
    }
    run = None
    for name, own in laws.items():
        solution = flexgen.solve(name, progress=False)
        for law in own:
            exact = not isinstance(law, flexgen.PPI | flexgen.LQG)
            run = flexgen.control(
                name,
                controller=law,
                plants=plants,
                disturbances=push,
                delay=0.0 if exact else 2.5e-4,
                sample_time=1e-3,
                encoder_noise=1e-4,
                solution=solution,
                exact_state=exact,
                progress=False,
            )
            assert len(run.runs) == 2
    return run


def observers(run: Any) -> None:
    """Records with numbers that are not finite or huge, for observers and the detector of
    collisions.
    """
    rng = np.random.default_rng(2)
    detector = flexgen.CollisionDetector(flexgen.read("elbow"), 1e-3)
    q = run.runs[0].measured
    tau = run.runs[0].tau_m
    detector.calibrate([(q, tau)])
    ekf = flexgen.ExtendedKalmanFilter("manutec_r3_18", sample_time=1e-3)
    observer = flexgen.ConstantGainObserver(flexgen.solve("planar5_nmp", progress=False), parts=3)
    for bad in BAD:
        wrong = tau.copy()
        wrong[rng.integers(len(tau)), 0] = bad
        tried(detector.detect, q, wrong)
        for one in (ekf, observer):
            y = np.zeros((4, len(one.channels.noise)))
            y[rng.integers(4), 0] = bad
            one.reset()
            tried(one.run, y, np.zeros((4, one.model.n_m)))


def motions() -> None:
    """Short motions of more robots than are computed at once, and of one, with inputs of their
    own.
    """
    local = LocalModel(flexgen.read("planar5_nmp"), ["q1.stiffness"])
    rng = np.random.default_rng(4)
    n = 2 * local.model.dof
    n_m = local.model.n_m
    simulate = Segments(local.rate, np.eye(n)[:3], 1e-3, 4)
    for robots in (1, 2, 19):
        for bad in (1.0, *BAD):
            inputs = bad * rng.normal(size=(2, 20, 3, n_m))
            given = (
                rng.normal(size=(robots, n)),
                inputs,
                rng.integers(0, 2, robots),
                rng.normal(size=(robots, n_m)),
            )
            for states in (False, True):
                tried(partial(simulate, states=states), *given, np.full((robots, 1), 600.0 * bad))


def poses(folder: Path) -> None:
    """Inverse kinematics and functions of an arm with 18 joints, compiled with sanitizers."""
    rng = np.random.default_rng(3)
    generate_module.find_compiler = sanitized  # (for this library, not those of the cache)
    names = ["forward_kinematics", "jacobian", "gravity", "mass_matrix"]
    library = flexgen.load(
        flexgen.generate("manutec_r3_18", folder, functions=names, progress=False).directory
    )
    n_a = library.sizes["n_a"]
    for _ in range(5):
        p, R = library.forward_kinematics(rng.uniform(-3, 3, n_a))
        tried(library.inverse_kinematics, p, R)
        for bad in BAD:
            tried(library.inverse_kinematics, p * bad, R)
            tried(library.mass_matrix, np.full(n_a, bad))


def main(folder: Path, planted: bool) -> None:
    """Everything; with the planted bug the first run under control."""
    # for the sanitizers of this process; a compiler would take twice its time
    os.environ.pop("LD_PRELOAD", None)
    c_module.find_compiler = sanitized  # type: ignore[assignment]
    if planted:
        real = c_module.compile_module
        c_module.compile_module = lambda name, text, **more: real(
            name, text.replace(*PLANTED), **more
        )  # type: ignore
    motions()
    observers(controllers())
    poses(folder)
    print("no error was found")


main(Path(sys.argv[1]), "planted" in sys.argv)
