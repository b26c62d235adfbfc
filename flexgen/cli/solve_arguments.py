"""Arguments of the verbs that solve, simulate, plan a path, and run all steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flexgen.cli.argument_parser import Once, Parser
from flexgen.cli.argument_types import file_path, not_negative, positive, trajectory_file
from flexgen.cli.path import path
from flexgen.cli.solve import simulate, solve
from flexgen.inversion.method_table import method_names
from flexgen.simulation.hold_names import HOLDS

METHOD = f"method of inverse dynamics: {', '.join(method_names())}; default: auto"


def add_verbs(group: Any, add_verb: Callable[..., Any]) -> None:
    """Add the verbs that solve a move, plan its path, and simulate torques."""
    _add_solve_arguments(add_verb(group, "solve", solve))
    _add_path_arguments(add_verb(group, "path", path))
    sub = add_verb(group, "simulate", simulate)
    sub.add_argument("trajectory", metavar="TRAJECTORY", type=file_path, help="file written by 'flexgen solve --out'")
    files = sub.section("files")
    files.add_argument("--out", metavar="FILE", type=trajectory_file, help="write the simulated motion to this file")


def _add_solve_arguments(parser: Parser) -> None:
    motion, method, controller, files = (
        parser.section("motion"),
        parser.section("method"),
        parser.section("controller"),
        parser.section("files"),
    )
    motion.add_argument(
        "--move",
        metavar="NAME",
        action="append",
        help="a move or program of the model file; default: the first; given several times: all of them, with "
        "FILE_NAME and DIR/NAME as outputs",
    )
    motion.add_argument("--moves", metavar="FILE", type=file_path, help="read moves and programs from this TOML file")
    method.add_argument("--method", choices=method_names(), metavar="NAME", default="auto", help=METHOD)
    files.add_argument(
        "--out", metavar="FILE", type=trajectory_file, help="write the trajectory to this file (.npz, .csv or .mat)"
    )
    files.add_argument("--report", metavar="DIR", type=file_path, help="write a self-contained HTML report to DIR")
    files.add_argument(
        "--robustness",
        action="store_true",
        help="with --report: also simulate robots with stiffness errors of 5 and 20 %% and mass errors of 5 %% (takes "
        "minutes)",
    )
    method.add_argument("--no-verify", action="store_true", help="skip the verification by forward simulation")
    method.add_argument(
        "--preview", metavar="S", type=not_negative, help="longest time that the motion may start before the path [s]"
    )
    method.add_argument("--mesh", metavar="S", type=positive, help="length of the mesh intervals [s]")
    method.add_argument(
        "--limits",
        action="store_true",
        help="enforce the torque and speed limits of the model (methods lq, collocation, full)",
    )
    motion.add_argument(
        "--fastest",
        action="store_true",
        help="with the fastest time law within the limits; 'flexgen fastest' has further options",
    )
    method.add_argument("--accuracy", metavar="X", type=positive, help="largest accepted output error [m and rad]")
    motion.add_argument(
        "--fixed-joint",
        metavar="NAME",
        help="of an arm with more motors than outputs: the joint that keeps its value in a move of the tool",
    )
    _add_bounds_arguments(method)
    controller.add_argument(
        "--hold",
        choices=HOLDS,
        metavar="NAME",
        default="spline",
        help="what the controller does between its ticks: spline (default), linear, or zoh (zero-order hold); the "
        "torques to send are verified with it and written to FILE_command beside --out FILE",
    )
    controller.add_argument(
        "--sample-time", metavar="S", type=positive, help="sample time of the controller [s]; default: 0.001"
    )
    controller.add_argument(
        "--delay",
        metavar="S",
        type=not_negative,
        default=0.0,
        help="time from a tick of the controller until the motor has the torque [s]; default: 0",
    )


def _add_bounds_arguments(section: Any) -> None:
    section.add_argument(
        "--ignore-limits",
        action="store_true",
        help="report a solution beyond the limits of the model file as solved (for studies); without it the exit "
        "status is 3",
    )
    section.add_argument(
        "--time",
        metavar="SECONDS",
        type=not_negative,
        default=120.0,
        help="time limit of each solve [s]: then, or after Ctrl-C, it ends with the best solution so far (exit status "
        "1, or 130); default: 120; 0: no limit",
    )


def _add_path_arguments(parser: Parser) -> None:
    motion, files = parser.section("motion"), parser.section("files")
    motion.add_argument(
        "--move", metavar="NAME", action=Once, help="a move or program of the model file; default: the first"
    )
    motion.add_argument("--moves", metavar="FILE", type=file_path, help="read moves and programs from this TOML file")
    files.add_argument(
        "--out",
        "--table",
        metavar="FILE",
        type=file_path,
        help="write the path as a C header for MODEL_path_sample to this file",
    )
    motion.add_argument("--ignore-limits", action="store_true", help="also plan a path beyond the range of a joint")


def add_run_arguments(parser: Parser) -> None:
    """Add the arguments of the verb ``run``."""
    motion, method, files = parser.section("motion"), parser.section("method"), parser.section("files")
    motion.add_argument(
        "--move", metavar="NAME", action=Once, help="a move or program of the model file; default: the first"
    )
    method.add_argument("--method", choices=method_names(), metavar="NAME", default="auto", help=METHOD)
    _add_bounds_arguments(method)
    parser.add_folder("folder of the C library; default: generated/MODEL")
    files.add_argument("--report", metavar="DIR", type=file_path, help="of the report; default: reports/MODEL")
