"""Numbers that pages state in their sentences and tables, and units, are those of the program.

A constant that a page states cannot change alone: the sentence has the number where the program
has it.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from flexgen.analysis.zero_dynamics import zeros
from flexgen.base.spec import sensors, toml_lines, units
from flexgen.cli import main as cli
from flexgen.cli.verbs.solve import EXCEEDED
from flexgen.codegen.emission.interface import DELAY_MAX, STATUSES
from flexgen.exports.mujoco import mujoco
from flexgen.feedback.laws import lq, state_lq, study
from flexgen.feedback.loop import closed_loop, control, interface
from flexgen.feedback.observers import collision, constant_gain
from flexgen.identification.estimator import validation
from flexgen.identification.experiments import plan
from flexgen.identification.motions import motion_fit
from flexgen.identification.responses import graybox, result
from flexgen.identification.rigid import rigid_accuracy
from flexgen.inversion import choice, solve
from flexgen.inversion.judge import settling
from flexgen.inversion.problem import limits, problem
from flexgen.model.format import format_robot
from flexgen.planning.optimal import problem as planning
from flexgen.planning.optimal import result as planned
from flexgen.runtime.identity import TOLERANCES
from flexgen.simulation import after_end, open_loop
from flexgen.studies.check import numbers
from flexgen.studies.scenarios import foreign, scenario_file
from flexgen.views.reports import sentence, video

ROOT = Path(__file__).resolve().parents[2]
WORDS = {2.0: "twice", 0.5: "half", 0.1: "a tenth"}
SENTENCES = {
    "docs/methods.md": (
        ("`full` up to {:d} coordinates", choice.FULL_LARGEST),
        ("The default accuracy is {:.0e}", problem.ACCURACY),
        ("default {:g} s) with the best solution so far", solve.TIME_LIMIT),
    ),
    "docs/verification.md": (
        ("slowest damped gear ({:g} D/K)", problem.LAGS),
        ("at most {:g} s. Where", problem.LONGEST_SETTLING),
        ("their decay, up to {:g} s", settling.LONGEST_DECAY),
        ("until {:g} s after the end with the last torque held", problem.HELD),
        ("states the error {:g} s after the end", after_end.AFTER),
        ("grow by more than {:g} until", open_loop.UNSTABLE),
        ("unless rounding errors of {:.0e} grow", open_loop.ROUNDING),
        ("grow to {} of it", WORDS.get(1 / open_loop.RESOLVED)),
    ),
    "docs/limits_and_streams.md": (
        (
            "{:.0f} time constants of the slowest unstable zero are sufficient",
            math.log(1 / zeros.PREVIEW_SHARE),
        ),
        ("The delay is in samples there, 0 to {:d}.", DELAY_MAX),
    ),
    "docs/c_library.md": (
        ("less than this [m or rad], {:.0e} in `solve`", settling.SETTLED * problem.ACCURACY),
        ("tolerance {:.0e} the output", TOLERANCES["double"]),
        ("for about {} the duration", WORDS.get(limits.LATE)),
    ),
    "docs/benchmarks.md": (
        ("moves the tool by less than {:.0f} nm", 1e9 * settling.SETTLED * problem.ACCURACY),
    ),
    "docs/not_for.md": (
        ("Errors below {:g} um are those of the computation", 1e6 * sentence.NUMERICAL),
    ),
    "docs/command_line.md": (
        ("Exit status: {:d} success", cli.SUCCESS),
        ("{:d} failure (with the reason", cli.FAILURE),
        ("{:d} wrong usage", cli.USAGE),
        ("{:d} limits of the model file exceeded", EXCEEDED),
        ("exceeded, {:d} interrupted", cli.INTERRUPTED),
    ),
    "docs/control.md": (
        ("does not return for {:g} s ends the whole run", closed_loop.LONGEST_STEP_S),
        ("ended after {:g} s without an answer", foreign.STEP_S),
        ("or {:g} minutes in all", foreign.TOTAL_S / 60),
        ("Kalman filter at {:d} poses", control.PARTS),
        ("stationary Kalman gains of {:d} poses", constant_gain.PARTS),
        ("what the filter expects ({:g} N)", lq.TOOL_FORCE),
        ("noise {:.0e} rad at the motors", study.MOTOR_NOISE),
        ("the limit of the table, {:g} N m of torque", study.TORQUE_NOISE),
    ),
    "flexgen/feedback/laws/README.md": (("gains at {:d} poses of the motion", state_lq.PARTS),),
    "flexgen/feedback/observers/README.md": (
        ("to {:g} times the largest residual", collision.MARGIN),
    ),
    "docs/identification.md": (
        ("chooses poses from {:d} candidates", plan.CANDIDATES),
        ("a parameter with more than {:g} % keeps", 100 * result.WEAK),
        ("fewer than {:g} % of the correlations", 100 * motion_fit.WHITE),
        ("residuals are below {:g} % of the motion", 100 * graybox.SMALL_ERROR),
        ("explained badly, or {} as well as those that were", WORDS.get(1 / validation.WORSE)),
        ("is more than {} that of the fit and above 10 %", WORDS.get(validation.WORSE)),
        ("that of the fit and above {:g} % of the torque", 100 * rigid_accuracy.SMALL),
    ),
    "docs/planning.md": (
        ("is the default up to {:d} degrees of freedom", planning.EXACT_UP_TO),
        ("The slack of an obstacle is {:g} mm", 1e3 * planning.TOUCH),
        ("of a ball at most {:g} % of its radius", 100 * planning.EXCESS),
        ("That of a bound is {:g} % of it", 100 * planned.EXCESS),
        ("or {:g} % of the range of what is bounded", 100 * planned.RANGE),
    ),
    "docs/exchange.md": (
        ("step {} of the shortest time constant at home", WORDS.get(mujoco.STEP)),
        ("Motions of less than {:g} s are shown in slow motion", video.LENGTH),
    ),
    "models/README.md": (
        ("a line has at most {:d} characters", toml_lines.WIDTH),
        ("An arm has at most {:d} coordinates", format_robot.COORDINATES_MAX),
    ),
}
FACTORS = {"": 1.0, "k": 1e3, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
UNITS = {
    "rad": 1.0,
    "m": 1.0,
    "s": 1.0,
    "g": 9.80665,
    "deg": math.pi / 180.0,
    "N m": 1.0,
    "A": 1.0,
    "N": 1.0,
    "1": 1.0,
    "N cm": 1e-2,
    "N mm": 1e-3,
    "min": 60.0,
    "arcmin": math.pi / 180.0 / 60.0,
    "rev": 2.0 * math.pi,
    "rpm": 2.0 * math.pi / 60.0,
}
RANGES = {  # rows of docs/own_robot.md: the ranges in the order of the row
    "lowest mode of each spring": (numbers.FREQUENCY,),
    "damping ratio": (numbers.DAMPING,),
    "rotor inertia times": (numbers.ROTOR_TO_ARM,),
    "ratio of a rotation": (numbers.RATIO, numbers.RATIO_TRANSLATION),
    "rotor inertia |": (numbers.ROTOR,),
    "largest speed": (numbers.MOTOR_SPEED, numbers.JOINT_SPEED, numbers.JOINT_SPEED_TRANSLATION),
}


@pytest.mark.parametrize("page", SENTENCES)
def test_numbers_in_sentences_of_a_page_are_those_of_the_program(page: str) -> None:
    text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
    wrong = [words.format(value) for words, value in SENTENCES[page]]
    assert [
        words for words in wrong if words.replace("e-0", "e-").replace("e+0", "e") not in text
    ] == []


def test_the_usual_ranges_on_the_page_are_those_of_the_check() -> None:
    page = (ROOT / "docs" / "own_robot.md").read_text(encoding="utf-8")
    number = re.compile(r"(?<![\w^.])\d[\d.]*(?:e-?\d+)?(?![\w^])")
    for beginning, ranges in RANGES.items():
        (row,) = (line for line in page.splitlines() if line.startswith(f"| {beginning}"))
        usual, wrong = ([float(x) for x in number.findall(cell)] for cell in row.split("|")[2:4])
        assert usual == [x for one in ranges for x in (one.low, one.high)]
        assert wrong in ([x for one in ranges for x in (one.least, one.most)], [ranges[0].most])
    below = {"to that of a steel ball": (numbers.DENSITY.low, numbers.DENSITY.least)}
    below |= {"length of the arm squared": (numbers.SIZE.high, numbers.SIZE.most)}
    below |= {"to that of all others": (numbers.SHARE.high, numbers.SHARE.most)}
    for words, (usual, wrong) in below.items():
        (row,) = (line for line in page.splitlines() if words in line)
        assert [float(cell.split()[-1]) for cell in row.split("|")[2:4]] == [usual, wrong]


def test_statuses_on_the_page_are_those_of_the_library() -> None:
    page = (ROOT / "docs" / "c_library.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `([A-Z_]+)` \| (-?\d+) \|", page, re.MULTILINE)
    assert {name: int(value) for name, value in rows} == {
        status.name: status.code for status in STATUSES
    }


def si(unit: str) -> float:
    """Factor from a unit such as ``mrad`` or ``deg/s`` to SI units."""
    above, _, below = unit.partition("/")
    if below:
        return si(above) / (si(below[:-2]) ** 2 if below.endswith("^2") else si(below))
    (found,) = {
        FACTORS[unit[: -len(base)]] * UNITS[base]
        for base in UNITS
        if unit.endswith(base) and whole(unit, base)
    }
    return found


def whole(unit: str, base: str) -> bool:
    """Whether a unit is this base with a known prefix, and no other base."""
    return unit == base or (unit[: -len(base)] in {"k", "c", "m", "u", "n"} and unit not in UNITS)


@pytest.mark.parametrize(
    "table",
    [
        *sensors.UNITS.values(),
        *units.FACTORS.values(),
        units.CURRENTS,
    ],
)
def test_factors_of_units_follow_from_their_names(table: dict[str, float]) -> None:
    assert table == pytest.approx({unit: si(unit) for unit in table}, rel=1e-15)


def test_lengths_of_a_benchmark_are_inverse_to_their_units() -> None:
    assert (
        pytest.approx({unit: 1 / si(unit) for unit in ("m", "mm", "um")}, rel=1e-15)
        == scenario_file.LENGTHS
    )
    assert interface.SLOWEST == 1.0  # "takes longer than a second", docs/control.md
