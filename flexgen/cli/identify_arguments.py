"""Arguments of the verbs of identification."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flexgen.cli.argument_parser import Parser
from flexgen.cli.argument_types import file_path, names, not_negative, positive, setting, spectrum, whole
from flexgen.cli.identify import excite, frf, identify, measure

FREE = (
    "parameters: stiffness, damping, q1.stiffness, m1.viscous, delay, sensor_delay, torque_constant, ...; default: "
    "stiffness, damping and the viscous frictions of the model"
)


def add_verbs(group: Any, add_verb: Callable[..., Any]) -> None:
    """Add the verbs that plan, simulate and evaluate an experiment."""
    _add_excite_arguments(add_verb(group, "excite", excite))
    _add_measure_arguments(add_verb(group, "measure", measure))
    _add_frf_arguments(add_verb(group, "frf", frf, model=False))
    _add_identify_arguments(add_verb(group, "identify", identify))


def _add_measure_arguments(parser: Parser) -> None:
    noise, files = parser.section("noise"), parser.section("files")
    parser.add_argument("plan", metavar="PLAN", type=file_path, help="file written by 'flexgen excite'")
    noise.add_argument("--seed", metavar="N", type=whole(0), default=0, help="of the noise; default: 0")
    files.add_argument(
        "--raw", metavar="DIR", type=file_path, help="also write all samples, as recordings that 'flexgen frf' reads"
    )
    files.add_argument(
        "--beside", action="store_true", help="also keep the spectra beside the lines, for 'flexgen frf --transients'"
    )
    files.add_argument(
        "--out", metavar="FILE", type=file_path, required=True, help="write the spectra to this .npz file"
    )


def _add_frf_arguments(parser: Parser) -> None:
    estimate, files = parser.section("estimate"), parser.section("files")
    parser.add_argument(
        "experiment",
        metavar="EXPERIMENT",
        type=file_path,
        help="file written by 'flexgen measure', or a .toml file that describes recordings",
    )
    averages = ("arithmetic", "harmonic", "logarithmic", "h1")
    estimate.add_argument("--average", choices=averages, metavar="NAME", default="arithmetic", help=", ".join(averages))
    estimate.add_argument(
        "--transients", action="store_true", help="remove transients by local polynomials beside the lines"
    )
    files.add_argument(
        "--out", metavar="FILE", type=file_path, required=True, help="write the responses to this .npz file"
    )
    files.add_argument("--report", metavar="DIR", type=file_path, help="write a self-contained HTML page to DIR")


def _add_excite_arguments(parser: Parser) -> None:
    poses, signal, drive, files = (
        parser.section("poses"),
        parser.section("excitation"),
        parser.section("drive and sensors"),
        parser.section("files"),
    )
    poses.add_argument("--poses", metavar="N", type=whole(1), default=8, help="number of poses to choose; default: 8")
    poses.add_argument(
        "--criterion",
        choices=("A", "D", "random"),
        metavar="NAME",
        default="A",
        help="of the best poses: A (least sum of variances, the default), D (least determinant) or random",
    )
    poses.add_argument("--free", metavar="NAME,NAME,...", type=names, help=FREE)
    signal.add_argument(
        "--speed-rms", metavar="V", type=positive, default=0.05, help="of each joint [rad/s or m/s]; default: 0.05"
    )
    signal.add_argument("--f-min", metavar="HZ", type=positive, help="lowest frequency [Hz]; default: from the modes")
    signal.add_argument("--f-max", metavar="HZ", type=positive, help="highest frequency [Hz]; default: from the modes")
    signal.add_argument("--lines", metavar="N", type=whole(1), default=63, help="number of frequencies; default: 63")
    signal.add_argument(
        "--spectrum",
        metavar="POWER",
        type=spectrum,
        default=0.5,
        help="speeds rise with this power of the frequency, or 'optimal': half of the power where it tells most; "
        "default: 0.5",
    )
    signal.add_argument("--period", metavar="S", type=positive, default=4.0, help="of the excitation [s]; default: 4")
    signal.add_argument("--periods", metavar="N", type=whole(1), default=4, help="that are measured; default: 4")
    signal.add_argument(
        "--transients", metavar="N", type=whole(0), default=1, help="periods before them that are not; default: 1"
    )
    drive.add_argument(
        "--sensors", metavar="NAME,NAME,...", type=names, help="channels of [[sensor]] tables; default: all"
    )
    signal.add_argument(
        "--realizations",
        metavar="N",
        type=whole(1),
        default=1,
        help="of the random phases; default: 1; 6 with friction",
    )
    drive.add_argument("--sample-time", metavar="S", type=positive, help="of the drives [s]; default: 0.0005")
    drive.add_argument("--delay", metavar="S", type=not_negative, default=0.0, help="of the torques [s]; default: 0")
    for name, unit in (("encoder-noise", "rad"), ("encoder-resolution", "rad"), ("torque-noise", "N m")):
        drive.add_argument(
            f"--{name}", metavar="X", type=not_negative, default=0.0, help=f"[{unit}, motor side]; default: 0"
        )
    signal.add_argument(
        "--seed", metavar="N", type=whole(0), default=0, help="of phases and candidate poses; default: 0"
    )
    files.add_argument("--out", metavar="FILE", type=file_path, required=True, help="write the plan to this .npz file")
    files.add_argument(
        "--references", metavar="DIR", type=file_path, help="write the references of each experiment to DIR, as CSV"
    )


def _add_identify_arguments(parser: Parser) -> None:
    fit, motions, check, files = (
        parser.section("fit"),
        parser.section("recorded motions"),
        parser.section("check"),
        parser.section("files"),
    )
    parser.add_argument(
        "frf",
        metavar="DATA",
        type=file_path,
        help="file written by 'flexgen frf'; with --rigid or --segments a .toml file that describes recordings",
    )
    motions.add_argument(
        "--rigid", action="store_true", help="fit bodies, rotors and friction of a rigid arm to recorded motions"
    )
    motions.add_argument(
        "--counterbalance",
        metavar="JOINT=N",
        type=setting,
        action="append",
        help="with --rigid: N harmonics of the angle of a joint, from the second, in the torque of its motor; "
        "may be repeated",
    )
    motions.add_argument(
        "--segments",
        metavar="S",
        type=positive,
        help="fit the nonlinear model to recorded motions, in segments of this length [s]",
    )
    motions.add_argument(
        "--validate", metavar="DATA", type=file_path, help="with --rigid or --segments: recordings that are not fitted"
    )
    fit.add_argument("--free", metavar="NAME,NAME,...", type=names, help=FREE)
    fit.add_argument("--fixed", metavar="NAME,NAME,...", type=names, default=(), help="parameters that stay")
    fit.add_argument(
        "--start", metavar="NAME=VALUE", type=setting, action="append", help="where the search begins; may be repeated"
    )
    fit.add_argument(
        "--residual",
        choices=("nls", "lls"),
        metavar="NAME",
        default="nls",
        help="nls: differences (default); lls: of complex logarithms",
    )
    fit.add_argument(
        "--floor",
        metavar="X",
        type=not_negative,
        help="model error as a part of the responses, such as 0.02; default: as much as the residuals need",
    )
    fit.add_argument("--starts", metavar="N", type=whole(1), default=3, help="number of searches; default: 3")
    fit.add_argument(
        "--structure",
        action="store_true",
        help="add and remove springs without motor as the data ask for, and print the changes",
    )
    fit.add_argument(
        "--refine",
        metavar="EXPERIMENT",
        type=file_path,
        help="then fit the spectra of this experiment (a file of 'flexgen measure', or a .toml file that describes "
        "recordings, with [drive] and [[reference]]) by simulation of the nonlinear model, frictions too",
    )
    check.add_argument(
        "--move", metavar="NAME", help="also print the tool error of feedforward in this move, before and after"
    )
    check.add_argument(
        "--truth",
        metavar="MODEL",
        help="with --move: the true robot of a simulated experiment; default: robots drawn "
        "from the covariance of the parameters",
    )
    files.add_argument("--out", metavar="FILE", type=file_path, help="write the new model file (.toml)")
    files.add_argument("--report", metavar="DIR", type=file_path, help="write a self-contained HTML report to DIR")
