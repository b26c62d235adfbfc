"""The files of scenarios: their rows, and how they are found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import hadamard

from flexgen.base.errors import ArgumentError
from flexgen.base.spec import keys
from flexgen.base.spec.arguments import is_whole
from flexgen.base.spec.keys import (
    REQUIRED,
    Context,
    Format,
    Key,
    Type,
    listed,
    required,
    sub,
    text,
    vector,
)
from flexgen.base.spec.tables import Table, file_bytes, file_table
from flexgen.dynamics.mechanics.parameters import select
from flexgen.feedback.loop.controller_files import CONTROLLER, table_controller
from flexgen.feedback.loop.plants import NOMINAL, Plants
from flexgen.model.elements import RobotModel
from flexgen.model.reader import packaged_models, read
from flexgen.simulation.environment.disturbances import DISTURBANCES, TOOL_AXES, Disturbance
from flexgen.studies.scenarios.measures import REST_S
from flexgen.studies.scenarios.scenario import (
    FROZEN,
    NAMES,
    Accept,
    Output,
    Plan,
    Scenario,
    Segment,
    Window,
)

FOLDER = Path(__file__).resolve().parent
KINDS = ("peak", "rms", "settling", "torque_peak", "torque_max", "torque_rms")
MOST_DRAWS = 1000
MOST_STEPS = 10_000
LARGEST = 10**9
# units of the tool's position, and how many of each are a meter
LENGTHS = {"m": 1.0, "mm": 1e3, "um": 1e6}
LONGEST_S = 3600.0  # run


def scenario(name: str | Path, version: int | None = None) -> Scenario:
    """A scenario by the name of a benchmark (``four_mass``, ``two_link``) or the path of a file.

    Parameters
    ----------
    name : str or Path
        Of a benchmark, also with its version as in ``four_mass@1``.
    version : int, optional
        Default: the newest.

    Raises
    ------
    ArgumentError
        There is none, the file is not a scenario, or it differs from the published one.
    ModelError
        Its model cannot be read.
    """
    text, _, after = (
        str(name).partition("@") if str(name).partition("@")[0] in NAMES else (str(name), "", "")
    )
    if text not in NAMES:
        if Path(text).suffix != ".toml":
            raise ArgumentError(
                f"scenario: given {text!r}, expected {', '.join(NAMES)} or the path of a .toml "
                "file"
            )
        if version is not None:
            raise ArgumentError(
                f"version: given {version!r} with the file {text}, expected none: the file "
                "states it"
            )
        return parse_table(Path(text), file_bytes(Path(text), "scenario"), None)
    known = [number for key, number in FROZEN if key == text]
    if after and version is None:
        version = int(after) if after.isdecimal() and len(after) < 4 else -1
    chosen = known[-1] if version is None else version
    if not is_whole(chosen) or chosen not in known or (after and after != str(chosen)):
        raise ArgumentError(
            f"version of {name}: given {version!r}, expected one of {', '.join(map(str, known))}"
        )
    path = FOLDER / f"{text}-{chosen}.toml"
    return parse_table(path, file_bytes(path, "scenario"), (text, int(chosen)))


@lru_cache(maxsize=16)
def parse_table(path: Path, data: bytes, known: tuple[str, int] | None) -> Scenario:
    """The scenario of a file; ArgumentError where a published one was changed."""
    table = file_table(data, path)
    found: Scenario = keys.read(table, FORMATS[FORMAT.read(table, Context())], Context())
    if known is not None and found.content != FROZEN[known][0]:
        raise ArgumentError(
            f"{path}: given the content {found.content[:12]}, expected {FROZEN[known][0][:12]}: "
            "the benchmark's file or its model was changed; scores with it cannot be compared. "
            "Copy it under another name to change it"
        )
    return found


def _read_delay(table: Table, key: Key, here: Context) -> float:
    """The delay [s], a whole number of sample times to 1e-6 of one."""
    value = table.number(key.name, least=0.0)
    sample = here.of_file("sample_s")
    if abs(value / sample - round(value / sample)) > 1e-6:
        raise table.fail(key.name, f"a multiple of the sample time {sample:g} s")
    return value


def _read_span(table: Table, key: Key, here: Context) -> tuple[float, ...]:
    span = table.vector(key.name, 2)
    if not 0 <= span[0] <= span[1]:
        raise table.fail(key.name, "two numbers >= 0, the larger one last")
    return span


def _check_window(table: Table, here: Context) -> None:
    span = here.values["window_s"]
    duration = here.of_file("duration_s")
    if not span[0] < span[1] <= duration:
        raise table.fail("window_s", f"two increasing times within {duration:g} s")


def _check_weights(table: Table, here: Context) -> None:
    if not here.values["weights"]:
        raise table.fail("weights", f"some of {', '.join(KINDS)}")


NUMBER = keys.number(least=0.0, most=LARGEST)
TIME = keys.number(least=1e-3, most=LONGEST_S)
DELAY = Type(_read_delay, NUMBER.schema)
SPAN = Type(_read_span, vector(2).schema)
TEXT = Type(lambda table, key, here: table.text(key.name).strip(), text().schema)
NAME = Key("name", text(), "name")
WEIGHTS = Key(
    "weights",
    keys.by_name(lambda here: KINDS, 0.0),
    "weights of the measures",
    check=_check_weights,
)


# --- disturbances and parts of a run -------------------------------------------------------------


def _check_times(table: Table, here: Context) -> None:
    """Disturbances lie within their segment or run."""
    length = here.values.get("length_s") or here.values["duration_s"]
    for inner, d in zip(
        table.tables("disturbance", False), here.values["disturbance"], strict=True
    ):
        if not 0 <= d.start_s < length or (d.kind != "step" and d.end_s > length):
            raise inner.fail(
                "start_s", f"one that ends within {length:g} s", f"{d.start_s:g} to {d.end_s:g} s"
            )


def _check_overlap(table: Table, here: Context) -> None:
    """No two disturbances that end are on one place at once."""
    _check_times(table, here)
    rows = zip(table.tables("disturbance", False), here.values["disturbance"], strict=True)
    for (first, a), (second, b) in combinations(rows, 2):
        both = a.where == b.where and "step" not in (a.kind, b.kind)
        if both and b.start_s < a.end_s and a.start_s < b.end_s:
            raise second.fail(
                "start_s",
                f"one that does not overlap {first.data.get('name', first.key)} on {a.where}",
            )


def _check_segments(table: Table, here: Context) -> None:
    """The error of a scenario whose segments share a name, or whose longest drawn run is longer
    than its duration.
    """
    segments, draw, duration = (here.values[key] for key in ("segment", "draw", "duration_s"))
    if len({segment.name for segment in segments}) != len(segments):
        raise table.fail(
            "segment", "segments of different names", str([segment.name for segment in segments])
        )
    longest = (
        draw["lead_s"][1] + sum(s.length_s + draw["wait_s"][1] for s in segments) + draw["end_s"]
    )
    if longest > duration + 1e-9:
        raise table.fail("duration_s", f"at least {longest:g} s: the longest run that is drawn")


_PLACE = keys.known(
    lambda here: (*(motor.name for motor in here.of_file("model").motors), *TOOL_AXES)
)
_OF_CLASS = keys.of_class(Disturbance, "disturbance").typed(
    kind=keys.choice(*DISTURBANCES), where=_PLACE
)
DISTURBANCE = replace(
    _OF_CLASS,
    keys=(replace(NAME, default=""), *_OF_CLASS.keys),
    make=lambda name, **values: Disturbance(**values),
)
GIVEN = Key(
    "disturbance",
    listed(DISTURBANCE, least=0),
    "disturbances; times count from the begin",
    check=_check_times,
)
SEGMENT = Format(
    "part of a run",
    (NAME, Key("length_s", TIME, "length", "s"), WEIGHTS, replace(GIVEN, default=())),
    make=Segment,
)
WINDOW = Format(
    "part of a run that measures are taken in",
    (NAME, Key("window_s", SPAN, "begin and end", "s", check=_check_window), WEIGHTS),
    make=lambda name, window_s, weights: Window(name, window_s[0], window_s[1], weights),
)


# --- outputs and robots --------------------------------------------------------------------------


def _check_scale(table: Table, here: Context) -> None:
    """The error of an output whose unit and scale do not fit; a sum of coordinates has neither
    axis nor scale.
    """
    unit = here.values["unit"]
    if "weights" in table:
        table.only("name", "unit", "weights")
    elif unit not in LENGTHS:
        raise table.fail("unit", f"{', '.join(LENGTHS)}: the tool's position is a length")
    elif abs(here.values["scale"] / LENGTHS[unit] - 1.0) > 1e-9:
        raise table.fail("scale", f"{LENGTHS[unit]:g} for the unit {unit}")


def _unless_weights(value: Any) -> Callable[[Table, Context], Any]:
    return lambda table, here: value if "weights" in table else REQUIRED


_COORDINATES = keys.by_name(lambda here: [c.name for c in here.of_file("model").coordinates])
OUTPUT = Format(
    "regulated number: a combination of the arm coordinates, or an axis of the tool's position",
    (
        NAME,
        Key("unit", text(), "unit"),
        Key("weights", _COORDINATES, "of the coordinates", default={}),
        Key(
            "tool_axis", keys.choice(*"xyz"), "axis", default=_unless_weights(""), attribute="axis"
        ),
        Key(
            "scale",
            NUMBER,
            "how many of the unit are a meter",
            default=_unless_weights(1.0),
            check=_check_scale,
        ),
    ),
    make=Output,
)


def _read_model(table: Table, key: Key, here: Context) -> RobotModel:
    """The model and its changes; of a published benchmark that which comes with flexgen, whatever
    the folder has.
    """
    found = sub(MODEL).read(table, key, here)
    name = (
        packaged_models() / f"{found['name']}.toml"
        if Path(table.file).parent == FOLDER
        else found["name"]
    )
    return read(name, found["variant"], None if found["set"] is None else found["set"].data)


_SET = Key("set", keys.any_table(), "changes by dotted path", default=None)
MODEL = Format(
    "model of the robots", (NAME, Key("variant", text(), "variant", default=None), _SET)
)
FACTOR = required("parameters that change together", names=keys.words(), change=NUMBER)
SET = required(
    "robots: a column of a Hadamard matrix for each factor",
    name=text(),
    factors=listed(FACTOR, 0, plural=False),
)


def _plants(
    model: RobotModel, rows: Sequence[dict[str, Any]]
) -> tuple[Plants, dict[str, tuple[int, ...]]]:
    """The nominal robot and those of all sets; for each set the numbers of its robots.

    A set changes its factors by plus or minus their share, in the combinations of a Hadamard
    matrix: few robots, in which each pair of factors has all four.
    """
    names = [NOMINAL]
    numbers = [dict[str, float]()]
    sets: dict[str, tuple[int, ...]] = {}
    for row in rows:
        order = 2
        while order <= len(row["factors"]):
            order *= 2
        signs = hadamard(order)[:, 1 : len(row["factors"]) + 1]
        sets[row["name"]] = tuple(range(len(names), len(names) + order))
        for k, own in enumerate(signs):
            values: dict[str, float] = {}
            for sign, factor in zip(own, row["factors"], strict=True):
                for parameter in select(model, factor["names"]):
                    values[parameter.name] = parameter.value * (1 + sign * factor["change"])
            names.append(f"{row['name']}, {k + 1}")
            numbers.append(values)
    used = sorted({key for values in numbers for key in values})
    parameters = tuple(select(model, used)) if used else ()
    table = np.array([[own.get(p.name, p.value) for p in parameters] for own in numbers])
    table.setflags(write=False)
    table = table.reshape(len(names), len(parameters))
    return Plants(tuple(names), parameters, table, ("",) * len(names)), sets


# --- the file ------------------------------------------------------------------------------------


def _scenario(
    format: int,
    model: RobotModel,
    set: Any,
    measures: Any,
    score: Any,
    segment: Any = (),
    draw: Any = None,
    **own: Any,
) -> Scenario:
    """The scenario of a file's values; ``format``: its number, which no field keeps. With a table
    ``draw`` disturbances come from its segments.
    """
    plants, sets = _plants(model, set)
    if draw is not None:
        own["plan"] = Plan(draw.pop("count"), **draw, segments=segment)
        own |= {"disturbances": (), "measures_version": measures["version"]}
    own |= {
        "nominal_weight": score["nominal"],
        "set_weights": score["sets"],
        "tolerance": measures["tolerance"],
    }
    return Scenario(**own, model=model, plants=plants, sets=sets, windows=measures["windows"])


_WEIGHTS = vector(size=lambda here: len(here.of_file("set")))
_MOTORS, _JOINTS = (
    vector(size=size)
    for size in (
        lambda here: here.of_file("model").n_m,
        lambda here: len(here.of_file("model").i_g),
    )
)
_ANY = keys.any_table()
_REFERENCE = Type(
    lambda table, key, here: table_controller(_ANY.read(table, key, here)), {}, form=CONTROLLER
)
_VERSION = keys.among(1, 2)
_WINDOWS = listed(WINDOW, 0, plural=False)
MEASURES = required("what is measured", version=_VERSION, tolerance=NUMBER, windows=_WINDOWS)
SCORE = required(
    "weights of the nominal robot, and of the worst one of each set", nominal=NUMBER, sets=_WEIGHTS
)
SPANS = required(
    "random numbers: how many draws, spans, and the rest in the end of the run",
    count=keys.whole(1, MOST_DRAWS),
    lead_s=SPAN,
    wait_s=SPAN,
    factor=SPAN,
    end_s=keys.number(least=REST_S),
)
LIMITS = required(
    "limits at rest", Accept, delay_s=DELAY, gain=NUMBER, torque_noise_Nm=NUMBER, rest=NUMBER
)
FORMAT = Key("format", keys.among(1, 2), "2: what is drawn, and the version of the measures")


def _scenario_format(number: int, own: tuple[Key, ...], measures: Format) -> Format:
    """Description of the scenario files of format ``number``: all keys, for reading and checks.

    Formats 1 and 2 share most keys. ``own``: the keys that only this format has, disturbances
    that are given (1) or drawn (2). ``measures``: the keys of the table ``measures`` in this
    format. The key ``version`` of a file is another number: the version of its scenario.
    """
    rows = (
        FORMAT,
        NAME,
        Key("version", keys.whole(0, LARGEST), "version of the scenario"),
        Key("title", text(), "title"),
        Key("published", TEXT, "what was published, and where"),
        Key("ours", TEXT, "what was not"),
        Key("model", Type(_read_model, {}, form=MODEL), MODEL.doc),
        Key("sample_s", keys.number(least=1e-6, most=LARGEST), "sample time", "s"),
        Key("delay_s", DELAY, "delay of the torque", "s"),
        Key("steps", keys.whole(1, MOST_STEPS), "steps of the integrator in a sample"),
        Key("duration_s", TIME, "duration of a run", "s"),
        Key("encoder_noise_rad", NUMBER, "noise of the motor angles", "rad"),
        Key("torque_max_Nm", _MOTORS, "largest torque", "N m", note="one for each of the motors"),
        Key("seed", keys.whole(0, LARGEST), "seed of noise and draws"),
        Key(
            "start_rad",
            _JOINTS,
            "the joints that are regulated",
            "rad",
            note="joints",
            attribute="start",
        ),
        Key("output", listed(OUTPUT, least=0), OUTPUT.doc),
        *own,
        Key("measures", sub(measures), measures.doc),
        Key("set", listed(SET, 0, plural=False), SET.doc),
        Key("score", sub(SCORE), SCORE.doc),
        Key("accept", sub(LIMITS), LIMITS.doc),
        Key("reference", _REFERENCE, "controller whose measures are the units of the score"),
    )
    return Format(f"scenario of a benchmark, format {number}", rows, make=_scenario)


DRAWN = (
    Key("rule", TEXT, "rule of the benchmark"),
    Key("draw", sub(SPANS), SPANS.doc),
    Key(
        "segment",
        listed(SEGMENT, plural=False),
        "parts of a run, in an order that is drawn",
        check=_check_segments,
    ),
)
FORMATS = {
    1: _scenario_format(1, (replace(GIVEN, check=_check_overlap),), MEASURES.without("version")),
    2: _scenario_format(2, DRAWN, MEASURES),
}
