"""Kinds of ``flexgen export`` for controllers and languages: selftest, ros2, mex, simulink, plcopen."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable
from typing import Any

from flexgen.cli.argument_parser import Parser
from flexgen.cli.verbs import Progress, VerbResult, check_writable, read_model

LATE = 2e-3  # s: sample time and delay of the gains that are proposed, one update of 1 ms each


def selftest(args: Namespace, log: Progress) -> VerbResult:
    """Write a C program that tests the library on its target, with results of Lagrange's equations: PASS or FAIL."""
    from flexgen.exports.selftest.export import export_selftest

    check_writable(args.out, folder=True)
    robot = read_model(args)
    log(f"writing the self-test of {robot.title}")
    precision = "single" if args.single else "double"
    options: dict[str, Any] = {"precision": precision, "move": args.move, "motion": not args.no_motion}
    return _result(robot, export_selftest(robot, args.out, force=args.force, **options))


def ros2(args: Namespace, log: Progress) -> VerbResult:
    """Write a ROS 2 package: a plugin of inverse dynamics, and a controller with a stream and P-PI control."""
    from flexgen.exports.ros2.export import export_ros2

    check_writable(args.out, folder=True)
    robot = read_model(args)
    log(f"writing the ROS 2 package of {robot.title}")
    gains = None if args.no_controller or args.no_gains else _gains(robot)
    names = {"maintainer": args.maintainer, "email": args.email, "license_name": args.license}
    options: dict[str, Any] = {"package": args.package, "controller": not args.no_controller, "gains": gains, **names}
    return _result(robot, export_ros2(robot, args.out, force=args.force, **options))


def mex(args: Namespace, log: Progress) -> VerbResult:
    """Write functions for MATLAB and GNU Octave: functions of a point, inversion of a path, and a stream."""
    from flexgen.exports.mex.export import export_mex

    check_writable(args.out, folder=True)
    robot = read_model(args)
    log(f"writing the functions of {robot.title}")
    return _result(robot, export_mex(robot, args.out, force=args.force))


def simulink(args: Namespace, log: Progress) -> VerbResult:
    """Write blocks for Simulink: functions for C Caller, and S-functions of a stream and of inverse dynamics."""
    from flexgen.exports.simulink.export import export_simulink

    check_writable(args.out, folder=True)
    robot = read_model(args)
    log(f"writing the blocks of {robot.title}")
    return _result(robot, export_simulink(robot, args.out, stream=not args.no_stream, force=args.force))


def plcopen(args: Namespace, log: Progress) -> VerbResult:
    """Write function blocks of IEC 61131-3 (ST and PLCopen XML) with their bodies in C."""
    from flexgen.exports.plcopen.export import export_plcopen

    check_writable(args.out, folder=True)
    robot = read_model(args)
    log(f"writing the function blocks of {robot.title}")
    return _result(robot, export_plcopen(robot, args.out, stream=not args.no_stream, force=args.force))


def _gains(robot: Any) -> Any:
    """Gains of a P-PI cascade at home, by the rule of ``flexgen control``; None where the pose has none."""
    import numpy as np

    from flexgen.errors import SolverError
    from flexgen.loop.gains import PPI
    from flexgen.mechanics.equations import derive
    from flexgen.mechanics.statics import hold_joints

    try:
        rest = hold_joints(derive(robot), np.asarray(robot.home, dtype=float))
    except SolverError:
        return None
    zero_a, zero_m = np.zeros((1, robot.n_a)), np.zeros((1, robot.n_m))
    motion = (rest.q_a[None], zero_a, zero_a, rest.q_m[None], zero_m, zero_m, rest.tau_m[None])
    return PPI().cascade(robot, LATE, motion)


def _result(robot: Any, made: Any) -> VerbResult:
    """What was written."""
    data = {
        "model": robot.name,
        "variant": robot.variant,
        "kind": made.kind,
        "directory": str(made.directory),
        "files": [str(path) for path in made.files],
    }
    lines = [f"{robot.title}: {made.kind} in {made.directory}", "", *(f"wrote {path}" for path in made.files)]
    return VerbResult(data, "\n".join(lines))


def _folder(parser: Parser, default: str) -> None:
    """The options of every kind."""
    parser.add_folder(f"where to write; default: exports/{default}")
    parser.section("files").add_argument(
        "--force", action="store_true", help="also replace files that were changed since the export"
    )


def add_selftest(kinds: Any, add_verb: Callable[..., Any]) -> None:
    """Add the kind selftest."""
    parser = add_verb(kinds, "selftest", selftest)
    _folder(parser, "<model>_selftest")
    parser.section("content").add_argument("--single", action="store_true", help="of a library in single precision")
    parser.section("content").add_argument(
        "--move", metavar="NAME", help="the move that the stream follows; default: the first"
    )
    parser.section("content").add_argument("--no-motion", action="store_true", help="without a stream along a move")


def add_ros2(kinds: Any, add_verb: Callable[..., Any]) -> None:
    """Add the kind ros2."""
    parser = add_verb(kinds, "ros2", ros2)
    _folder(parser, "<package>")
    parser.section("content").add_argument("--package", metavar="NAME", help="of the package; default: flexgen_<model>")
    parser.section("content").add_argument(
        "--no-controller", action="store_true", help="the plugin of inverse dynamics only"
    )
    parser.section("content").add_argument(
        "--no-gains", action="store_true", help="leave the gains of the controller open"
    )
    for name, default, what in (
        ("maintainer", "maintainer", "name for package.xml"),
        ("email", "maintainer@example.com", "address for package.xml"),
        ("license", "MIT", "license for package.xml"),
    ):
        parser.section("package.xml").add_argument(
            f"--{name}", metavar="TEXT", default=default, help=f"{what}; default: {default}"
        )


def add_mex(kinds: Any, add_verb: Callable[..., Any]) -> None:
    """Add the kind mex."""
    _folder(add_verb(kinds, "mex", mex), "<model>_mex")


def add_simulink(kinds: Any, add_verb: Callable[..., Any]) -> None:
    """Add the kind simulink."""
    parser = add_verb(kinds, "simulink", simulink)
    _folder(parser, "<model>_simulink")
    parser.section("content").add_argument(
        "--no-stream", action="store_true", help="without a stream, for models that have none"
    )


def add_plcopen(kinds: Any, add_verb: Callable[..., Any]) -> None:
    """Add the kind plcopen."""
    parser = add_verb(kinds, "plcopen", plcopen)
    _folder(parser, "<model>_plcopen")
    parser.section("content").add_argument(
        "--no-stream", action="store_true", help="without a stream, for models that have none"
    )


KINDS = (add_selftest, add_ros2, add_mex, add_simulink, add_plcopen)
