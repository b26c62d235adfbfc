"""The command line: parse, run one verb, print one answer, set the exit status.

Exit status: 0 done, 1 the job failed (the reason is on standard error), 2 usage, 130 interrupted. With ``--json`` there
is exactly one JSON object on standard output, ``{"error": ...}`` where there is nothing else to say.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import re
import signal
import sys
import tomllib
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from flexgen import __version__
from flexgen.cli import run
from flexgen.cli import verbs as verb_module
from flexgen.cli.printing import as_json
from flexgen.cli.sweep import add_arguments as add_sweep_arguments
from flexgen.errors import FlexgenError
from flexgen.inversion.method_table import NAMES as METHOD_NAMES

PACKAGES = ("casadi", "numpy", "scipy", "sympy", "matplotlib")

DONE, FAILED, USAGE, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 130, 141

EXAMPLES = """\
examples:
  flexgen models                                    what there is
  flexgen analyze planar5_nmp --pose 0.3,-1.1,0     modes, zeros, phase
  flexgen generate planar5_nmp                      C library in generated/planar5_nmp
  flexgen generate arm.toml --native --single       the same for this processor, in single precision
  flexgen solve planar5_nmp --report reports/arm    torques along the first move, with pictures
  flexgen sweep examples/sweep.toml --out out/sweep many solves, on all cores
  flexgen run                                       all of it once

MODEL is a name in models/ or the path of a .toml file, either with @variant, or FILE.urdf#BASE:TIP.
Exit status: 0 done, 1 failed, 2 usage."""


class _UsageError(Exception):
    """The command line is not understood."""


class _Parser(argparse.ArgumentParser):
    """An argument parser that leaves it to `main` to print and to exit."""

    def error(self, message: str) -> NoReturn:
        raise _UsageError(f"{message}\n{self.format_usage().strip()}")


def _numbers(text: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = [math.nan]
    if not all(math.isfinite(value) for value in values):
        raise argparse.ArgumentTypeError(f"given {text!r}, expected numbers with commas between, such as 0.3,-1.1,0")
    return values


def _names(text: str) -> tuple[str, ...]:
    return tuple(word.strip() for word in text.split(","))


def _positive(text: str) -> float:
    value = _numbers(text)[0] if "," not in text else math.nan
    if not value > 0:
        raise argparse.ArgumentTypeError(f"given {text!r}, expected a positive number")
    return value


def _not_negative(text: str) -> float:
    return 0.0 if re.fullmatch(r"\+?0*\.?0*", text) and "0" in text else _positive(text)


def _trajectory_file(text: str) -> Path:
    path = Path(text)
    if path.suffix not in (".npz", ".csv"):
        raise argparse.ArgumentTypeError(f"given {text!r}, expected a name that ends in .npz or .csv")
    return path


def _path(text: str) -> Path:
    if not text or "\0" in text:
        raise argparse.ArgumentTypeError(f"given {text!r}, expected a path")
    return Path(text)


def _setting(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    try:
        parsed = tomllib.loads(f"value = {value}")
    except (tomllib.TOMLDecodeError, RecursionError):
        parsed = {}
    if not key.strip() or not equals or list(parsed) != ["value"]:
        hint = "such as motor.m1.inertia=0.004 or 'output.axes=\"xy\"' (texts in quotes)"
        raise argparse.ArgumentTypeError(f"given {text!r}, expected KEY=VALUE with a TOML value, {hint}")
    return key.strip(), parsed["value"]


def build_parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    parser = _Parser(
        prog="flexgen",
        description="Inverse dynamics of elastic robots, from a model file to C that runs in a controller.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"flexgen {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)

    def verb(name: str, model: bool = True) -> argparse.ArgumentParser:
        action = run.run if name == "run" else getattr(verb_module, name)
        summary = (action.__doc__ or "").strip().partition("\n")[0]
        sub = verbs.add_parser(name, help=summary, description=summary, allow_abbrev=False)
        sub.set_defaults(action=action)
        sub.add_argument("--json", action="store_true", help="one JSON object on standard output, nothing else there")
        sub.add_argument("-q", "--quiet", action="store_true", help="no progress on standard error")
        if model:
            text = "name in models/ or path of a .toml file, either with @variant, or FILE.urdf#BASE:TIP"
            if name == "run":
                sub.add_argument("model", metavar="MODEL", nargs="?", default="planar5_nmp", help=text)
            else:
                sub.add_argument("model", metavar="MODEL", help=text)
            sub.add_argument(
                "--set",
                metavar="KEY=VALUE",
                type=_setting,
                action="append",
                help="change the model: dotted path of a key, TOML value; may be repeated",
            )
        return sub

    verb("models", model=False)
    verb("describe")

    sub = verb("derive")
    kind = sub.add_mutually_exclusive_group()
    kind.add_argument("--text", action="store_true", help="equations as plain text (the default where they are small)")
    kind.add_argument("--latex", action="store_true", help="equations as a LaTeX document")
    sub.add_argument("--out", metavar="FILE", type=_path, help="write the equations there (.tex: as LaTeX)")

    sub = verb("analyze")
    sub.add_argument("--pose", metavar="Q,Q,...", type=_numbers, help="arm coordinates in rad or m; default: home pose")
    sub.add_argument("--move", metavar="NAME", help="look at zeros and solvability along this move, too")
    sub.add_argument("--report", metavar="DIR", type=_path, help="write pole-zero map and frequency response there")

    sub = verb("generate")
    sub.add_argument("--directory", metavar="DIR", type=_path, help="where to write; default: generated/MODEL")
    sub.add_argument("--no-build", action="store_true", help="write the sources only, compile nothing")
    sub.add_argument(
        "--parameters",
        metavar="NAME,NAME,...",
        type=_names,
        default=(),
        help="numbers that stay arguments of the functions: payload, stiffness, damping, friction, q2.stiffness ...",
    )
    sub.add_argument("--single", action="store_true", help="numbers of single precision (float)")
    sub.add_argument("--native", action="store_true", help="compile for this processor: faster, other last bits")
    sub.add_argument("--openmp", action="store_true", help="batches on all cores")
    sub.add_argument("--amalgamate", action="store_true", help="write one header and one C file")
    sub.add_argument("--force", action="store_true", help="build even where nothing has changed")

    sub = verb("solve")
    sub.add_argument("--move", metavar="NAME", help="a move or program of the model file; default: its first")
    sub.add_argument("--moves", metavar="FILE", type=_path, help="take moves and programs from this TOML file instead")
    sub.add_argument(
        "--method",
        choices=METHOD_NAMES,
        metavar="NAME",
        default="auto",
        help=f"one of {', '.join(METHOD_NAMES)}; default: auto",
    )
    sub.add_argument("--out", metavar="FILE", type=_trajectory_file, help="write the trajectory there (.npz or .csv)")
    sub.add_argument("--report", metavar="DIR", type=_path, help="write a self-contained HTML report there")
    sub.add_argument(
        "--robustness",
        action="store_true",
        help="with --report: also on machines with 5 and 20 %% other stiffness and 5 %% other mass (minutes)",
    )
    sub.add_argument("--no-verify", action="store_true", help="skip the forward simulation")
    sub.add_argument("--preview", metavar="S", type=_not_negative, help="how long before the path the motion may begin")
    sub.add_argument("--mesh", metavar="S", type=_positive, help="length of the intervals of the mesh")
    sub.add_argument(
        "--limits",
        action="store_true",
        help="respect the model's torque and speed limits (methods lq, collocation, full)",
    )
    sub.add_argument("--accuracy", metavar="X", type=_positive, help="largest error to accept, m and rad")

    sub = verb("simulate")
    sub.add_argument("trajectory", metavar="TRAJECTORY", type=_path, help="what 'flexgen solve --out' wrote")
    sub.add_argument("--out", metavar="FILE", type=_trajectory_file, help="write the simulated motion there")

    add_sweep_arguments(verb("sweep", model=False))

    sub = verb("run")
    sub.add_argument("--move", metavar="NAME", help="a move of the model file; default: its first")
    sub.add_argument(
        "--method",
        choices=METHOD_NAMES,
        metavar="NAME",
        default="auto",
        help=f"one of {', '.join(METHOD_NAMES)}; default: auto",
    )
    sub.add_argument("--directory", metavar="DIR", type=_path, help="of the C library; default: generated/MODEL")
    sub.add_argument("--report", metavar="DIR", type=_path, help="of the report; default: reports/MODEL")
    return parser


def _joined(argv: Sequence[str]) -> list[str]:
    """``--pose -0.3,1`` as ``--pose=-0.3,1``: argparse would take the value for an option."""
    out: list[str] = []
    for word in argv:
        if out and out[-1] in ("--pose", "--preview", "--mesh", "--accuracy") and re.match(r"-[\d.]", word):
            out[-1] += f"={word}"
        else:
            out.append(word)
    return out


def _print(text: str) -> None:
    """Print and flush, so that a full disk or a closed pipe is noticed here."""
    print(text)
    if sys.stdout is not None:
        sys.stdout.flush()


def _tell(text: str) -> None:
    if sys.stderr is not None:
        with contextlib.suppress(OSError):
            print(text, file=sys.stderr, flush=True)


def _silence() -> None:
    """Nobody reads any more: keep the interpreter from saying so when it closes standard output."""
    with contextlib.suppress(OSError, AttributeError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextlib.contextmanager
def _standard_output_kept() -> Iterator[None]:
    """Whatever libraries print meanwhile, those in C included, goes to standard error."""
    try:
        sys.stdout.flush()
        kept = os.dup(1)
        os.dup2(2, 1)
    except (OSError, AttributeError, ValueError):  # one of the two is closed
        with contextlib.redirect_stdout(sys.stderr):
            yield
        return
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


@contextlib.contextmanager
def _warnings_kept() -> Iterator[None]:
    """What libraries warn of is for developers: whoever runs a verb is told by its answer."""
    with warnings.catch_warnings():
        if not os.environ.get("FLEXGEN_DEBUG"):
            warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def _interrupts_noted() -> Iterator[list[int]]:
    """Ctrl-C is noted as well as raised: a solver in C++ may catch the exception and call it a failure of its own."""
    noted: list[int] = []

    def note(number: int, frame: Any) -> NoReturn:
        noted.append(number)
        raise KeyboardInterrupt

    try:
        if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
            raise ValueError
        signal.signal(signal.SIGINT, note)
    except ValueError:  # ignored, someone else's, or not in the main thread
        yield noted
        return
    try:
        yield noted
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; the exit status."""
    words = _joined(sys.argv[1:] if argv is None else argv)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    try:
        return _main(words)
    except BrokenPipeError:
        _silence()
        return PIPE_CLOSED
    except OSError as error:
        _tell(f"flexgen: standard output cannot be written ({error.strerror or error})")
        _silence()
        return FAILED


def _main(words: list[str]) -> int:
    try:
        args = build_parser().parse_args(words)
    except _UsageError as error:
        message, _, usage = str(error).partition("\n")
        if "--json" in words:
            _print(as_json({"error": message}))
        _tell(f"{usage}\nflexgen: {message}")
        return USAGE
    except SystemExit:  # help and version have been printed
        if sys.stdout is not None:
            sys.stdout.flush()
        return DONE
    answer, problem, status = None, "", DONE
    noted: list[int] = []
    try:
        with _standard_output_kept(), _warnings_kept(), _interrupts_noted() as noted:
            answer = args.action(args, (lambda line: None) if args.quiet else _tell)
        problem = answer.problem
        status = FAILED if problem else DONE
    except BaseException as error:
        noted += [signal.SIGINT] * isinstance(error, KeyboardInterrupt)
        if os.environ.get("FLEXGEN_DEBUG"):
            raise
        problem, status = _reason(error, args), FAILED
    if noted:
        answer, problem, status = None, "interrupted", INTERRUPTED
    for warning in answer.warnings if answer is not None else ():
        _tell(f"flexgen: warning: {warning}")
    if args.json:
        data = {} if answer is None else answer.data
        _print(as_json(data | ({"error": problem} if problem else {})))
    elif answer is not None:
        _print(answer.text)
    if problem:
        _tell(f"flexgen: {problem}")
    return status


def _numerical(error: BaseException) -> bool:
    """Whether a computation broke down: overflow, division by zero, a singular matrix, numbers that are not finite."""
    if isinstance(error, ArithmeticError) or any(kind.__name__ == "LinAlgError" for kind in type(error).__mro__):
        return True
    return isinstance(error, ValueError) and "infs or NaNs" in str(
        error
    )  # what numpy and scipy check before they start


def _reason(error: BaseException, args: argparse.Namespace) -> str:
    """Why the job failed, for the user."""
    if isinstance(error, FlexgenError):
        return str(error)
    if isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in PACKAGES:
        return (
            f"the Python package {error.name} is missing for {sys.executable or 'this Python'}: run 'make setup' and "
            "use .venv/bin/flexgen, or install flexgen with pip"
        )
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}"
    if isinstance(error, MemoryError):
        return "not enough memory"
    if _numerical(error):
        what = f" {args.model}" if getattr(args, "model", None) else ""
        return (
            f"{args.verb}{what}: the computation broke down ({str(error) or type(error).__name__}); likely because of "
            "the numbers of the model: masses, inertias, lengths, stiffnesses or dampings that do not go together"
        )
    return f"internal error, please report it with the output of FLEXGEN_DEBUG=1: {type(error).__name__}: {error}"


if __name__ == "__main__":
    sys.exit(main())
