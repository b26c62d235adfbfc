"""Kinds of ``flexgen export`` for controllers and languages: selftest, ros2, mex, simulink, plcopen."""

from __future__ import annotations

from argparse import Namespace
from typing import Any

import flexgen
from flexgen.cli.result import Progress, VerbResult, check_writable, keywords, read_model


def _export(args: Namespace, log: Progress, what: str, **more: Any) -> VerbResult:
    """Call the public function of the verb; what it wrote."""
    check_writable(args.out, folder=True)
    robot = read_model(args)
    log(f"writing {what} of {robot.title}")
    made = getattr(flexgen, args.row.function)(robot, args.out, **keywords(args), **more)
    data = {
        "model": robot.name,
        "variant": robot.variant,
        "kind": made.kind,
        "directory": str(made.directory),
        "files": [str(path) for path in made.files],
    }
    lines = [f"{robot.title}: {made.kind} in {made.directory}", "", *(f"wrote {path}" for path in made.files)]
    return VerbResult(data, "\n".join(lines))


def selftest(args: Namespace, log: Progress) -> VerbResult:
    """Write a C program that tests the library on its target, with results of Lagrange's equations: PASS or FAIL."""
    return _export(args, log, "the self-test")


def ros2(args: Namespace, log: Progress) -> VerbResult:
    """Write a ROS 2 package: a plugin of inverse dynamics, and a controller with a stream and P-PI control."""
    return _export(args, log, "the ROS 2 package", **({} if args.gains else {"gains": None}))


def mex(args: Namespace, log: Progress) -> VerbResult:
    """Write functions for MATLAB and GNU Octave: functions of a point, inversion of a path, and a stream."""
    return _export(args, log, "the functions")


def simulink(args: Namespace, log: Progress) -> VerbResult:
    """Write blocks for Simulink: functions for C Caller, and S-functions of a stream and of inverse dynamics."""
    return _export(args, log, "the blocks")


def plcopen(args: Namespace, log: Progress) -> VerbResult:
    """Write function blocks of IEC 61131-3 (ST and PLCopen XML) with their bodies in C."""
    return _export(args, log, "the function blocks")
