"""Arguments of the verbs of control."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from typing import Any

from flexgen.cli.argument_parser import Parser
from flexgen.cli.argument_types import file_path, not_negative, numbers, positive, trajectory_file, whole
from flexgen.cli.control import control, fastest, kinematics, learn, score, tune

CONTROLLER = "a file .toml, .py (or file.py:Class) or a shared library"
_DISTURBANCE = re.compile(
    r"(?P<kind>\w+):(?P<where>[\w.]+)=(?P<size>[-+.\deE]+)@(?P<start>[-+]?[.\d]+(?:[eE][-+]?\d+)?)"
    r"(?:\+(?P<length>[.\d]+(?:[eE][-+]?\d+)?))?(?:,(?P<low>[.\deE]+)-(?P<high>[.\deE]+))?\Z"
)


def plant(text: str) -> tuple[str, dict[str, float]]:
    """``NAME:stiffness=0.8,payload=5``; without a name the text itself is the name."""
    name, colon, rest = text.partition(":")
    changes: dict[str, float] = {}
    for item in (rest if colon else text).split(","):
        key, equals, value = item.partition("=")
        try:
            changes[key.strip()] = float(value)
        except ValueError:
            equals = ""
        if not equals or not key.strip():
            raise argparse.ArgumentTypeError(f"given {text!r}, expected such as soft:stiffness=0.8,payload=5")
    return (name if colon else text), changes


def disturbance(text: str) -> dict[str, Any]:
    """``KIND:WHERE=SIZE@START+LENGTH,LOW-HIGH``; length and frequencies where the kind has them."""
    found = _DISTURBANCE.match(text)
    try:
        if found is None:
            raise ValueError
        band = (float(found["low"]), float(found["high"])) if found["low"] else None
        return {
            "kind": found["kind"],
            "where": found["where"],
            "size": float(found["size"]),
            "start_s": float(found["start"]),
            "length_s": float(found["length"]) if found["length"] else None,
            "frequency_hz": band,
        }
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"given {text!r}, expected such as step:m1=2@0.5, pulse:tool.x=300@0.4+0.02 or chirp:m1=1@0+2,0.5-30"
        ) from None


def add_verbs(group: Any, add_verb: Callable[..., Any]) -> None:
    """Add the verbs that simulate, score and tune controllers."""
    _add_control_arguments(add_verb(group, "control", control))
    _add_learn_arguments(add_verb(group, "learn", learn))
    _add_fastest_arguments(add_verb(group, "fastest", fastest))
    _add_kinematics_arguments(add_verb(group, "kinematics", kinematics))
    _add_score_arguments(add_verb(group, "score", score, model=False))
    _add_tune_arguments(add_verb(group, "tune", tune, model=False))


def _add_score_arguments(parser: Parser) -> None:
    loop, files = parser.section("closed loop"), parser.section("files")
    _add_scenario(parser)
    loop.add_argument(
        "--controller",
        metavar="NAME",
        action="append",
        help="reference (the default), all (those that come with the benchmark), the name of one of them, "
        f"{CONTROLLER}; may be repeated",
    )
    loop.add_argument(
        "--seed",
        metavar="N",
        type=whole(0),
        help="of draws and noise; default: that of the benchmark, a new one for code",
    )
    files.add_argument("--report", metavar="DIR", type=file_path, help="write a self-contained HTML page to DIR")


def _add_tune_arguments(parser: Parser) -> None:
    search, files = parser.section("search"), parser.section("files")
    _add_scenario(parser)
    search.add_argument(
        "--controller",
        metavar="NAME",
        default="reference",
        help=f"where to start: as for 'flexgen score', {CONTROLLER}",
    )
    search.add_argument(
        "--evaluations", metavar="N", type=whole(1), default=200, help="of the score from a start; default: 200"
    )
    search.add_argument("--starts", metavar="N", type=whole(1), default=1, help="number of starts; default: 1")
    search.add_argument("--workers", metavar="N", type=whole(1), default=1, help="number of processes; default: 1")
    search.add_argument("--seed", metavar="N", type=whole(0), default=0, help="of the other starts; default: 0")
    files.add_argument("--out", metavar="FILE", type=file_path, required=True, help="write the controller to this file")


def _add_scenario(parser: Parser) -> None:
    parser.add_argument(
        "scenario",
        metavar="SCENARIO",
        help="four_mass, two_link (four_mass@1: version 1), or the path of a .toml file like theirs",
    )


def _add_loop_arguments(parser: Parser) -> None:
    """Move, controller, sample time and delay, noise."""
    motion, loop, files = parser.section("motion"), parser.section("closed loop"), parser.section("files")
    motion.add_argument("--move", metavar="NAME", help="a move or program of the model file; default: the first")
    loop.add_argument(
        "--controller",
        metavar="NAME",
        default="ppi",
        help=f"ppi (P-PI cascade, the default), ppi_notch, lqg, none (feedforward only), {CONTROLLER}",
    )
    loop.add_argument(
        "--sample-time", metavar="S", type=positive, default=5e-4, help="of the controller [s]; default: 0.0005"
    )
    loop.add_argument(
        "--delay", metavar="S", type=not_negative, default=0.0, help="from a measurement to its torque [s]; default: 0"
    )
    loop.add_argument(
        "--encoder-noise", metavar="RAD", type=not_negative, default=0.0, help="of the motor angles [rad]; default: 0"
    )
    loop.add_argument("--seed", metavar="N", type=whole(0), default=0, help="of the noise; default: 0")
    files.add_argument("--report", metavar="DIR", type=file_path, help="write a self-contained HTML page to DIR")


def joint_value(text: str) -> tuple[str, float]:
    """``NAME=X``."""
    name, equals, value = text.partition("=")
    try:
        if not (name and equals):
            raise ValueError
        return name, float(value)
    except ValueError:
        raise argparse.ArgumentTypeError(f"given {text!r}, expected such as q3=0.5") from None


def _add_kinematics_arguments(parser: Parser) -> None:
    pose, arm = parser.section("pose of the tool"), parser.section("arm")
    pose.add_argument("--joints", metavar="Q ...", type=numbers, help="the pose is that of these joints [rad or m]")
    pose.add_argument("--position", metavar="X Y Z", type=numbers, help="of the tool in the world [m]")
    help_rotation = "rotation vector of the tool in the world [rad]; default: 0 0 0"
    pose.add_argument("--rotation", metavar="X Y Z", type=numbers, help=help_rotation)
    help_fixed = "a joint of a redundant arm that keeps a value [rad or m]; may be repeated"
    arm.add_argument("--fixed", metavar="NAME=X", type=joint_value, action="append", help=help_fixed)
    help_sag = "the elastic robot at rest under gravity reaches the pose"
    pose.add_argument("--sag", action="store_true", help=help_sag)


def _add_fastest_arguments(parser: Parser) -> None:
    motion, bounds, files = parser.section("motion"), parser.section("bounds"), parser.section("files")
    motion.add_argument("--move", metavar="NAME", help="a move of the model file, not a program; default: the first")
    bounds.add_argument(
        "--torque",
        metavar="X ...",
        type=numbers,
        help="limits of the motor torques [N m], one for all or one for each; default: those of the model file, and "
        "where it has none the largest torque of the move as it is given",
    )
    bounds.add_argument("--speed", metavar="X ...", type=numbers, help="the same of the motor speeds [rad/s]")
    bounds.add_argument(
        "--torque-rate",
        metavar="X",
        type=positive,
        help="bound of the rates of the torques, as a multiple of the largest one of the move as it is given",
    )
    bounds.add_argument(
        "--vibration",
        metavar="M",
        type=positive,
        help="bound of the vibration after the path [m], of robots with 10 %% less and more stiffness under control",
    )
    motion.add_argument(
        "--coefficients", metavar="N", type=whole(4), default=16, help="of the time law, 4 to 60; default: 16"
    )
    motion.add_argument(
        "--time",
        metavar="SECONDS",
        type=not_negative,
        default=600.0,
        help="time limit of the search [s]; default: 600; 0: no limit",
    )
    files.add_argument("--out", metavar="FILE", type=trajectory_file, help="write the trajectory to this file")
    files.add_argument("--report", metavar="DIR", type=file_path, help="write a self-contained HTML report to DIR")


def _add_learn_arguments(parser: Parser) -> None:
    robot, learning, files = parser.section("robot"), parser.section("learning"), parser.section("files")
    _add_loop_arguments(parser)
    robot.add_argument(
        "--plant",
        metavar="KEY=X,...",
        type=plant,
        help="the robot: factors of stiffness, damping, friction or a single number, payload in kg more; such as "
        "stiffness=0.8,payload=5; default: as the model",
    )
    learning.add_argument("--iterations", metavar="N", type=whole(1), default=6, help="at most; default: 6")
    learning.add_argument("--gain", metavar="X", type=positive, default=1.0, help="of the correction; default: 1")
    learning.add_argument(
        "--frequency",
        metavar="HZ",
        type=positive,
        help="of the low pass; default: 0.7 of the lowest natural frequency with locked motors",
    )
    learning.add_argument(
        "--measured-by",
        choices=("tracker", "accelerometer"),
        default="tracker",
        help="the tool error: by a tracker, or estimated from accelerometers and motor angles, which do not show "
        "errors at rest; default: tracker",
    )
    help_out = "write motion, torques and errors of the best iteration to this file"
    files.add_argument("--out", metavar="FILE", type=trajectory_file, help=help_out)


def _add_control_arguments(parser: Parser) -> None:
    robot, loop, files = parser.section("robot"), parser.section("closed loop"), parser.section("files")
    _add_loop_arguments(parser)
    robot.add_argument(
        "--plant",
        metavar="NAME:KEY=X,...",
        type=plant,
        action="append",
        help="another robot: factors of stiffness, damping, friction or a single number, payload in kg more; such as "
        "soft:stiffness=0.8,payload=5; may be repeated",
    )
    robot.add_argument(
        "--disturb",
        metavar="KIND:WHERE=SIZE@START+LENGTH",
        type=disturbance,
        action="append",
        help="step, pulse, ramp, chirp or noise on a motor [N m] or on the tool (tool.x [N], tool.rz [N m], world "
        "axes), times in s; chirp and noise: ,LOW-HIGH in Hz; such as pulse:tool.x=300@0.4+0.02; may be repeated",
    )
    loop.add_argument(
        "--encoder-resolution",
        metavar="RAD",
        type=not_negative,
        default=0.0,
        help="of the motor angles [rad]; default: 0",
    )
    robot.add_argument("--no-limits", action="store_true", help="do not limit the torques to those of the model file")
    loop.add_argument(
        "--exact-state", action="store_true", help="the controller measures angles and speeds of arm and motors exactly"
    )
    files.add_argument(
        "--out", metavar="FILE", type=trajectory_file, help="write motion, torques and errors of the model to this file"
    )
