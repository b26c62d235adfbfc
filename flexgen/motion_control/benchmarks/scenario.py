"""Scenarios of the benchmarks: one TOML file each, frozen by its hash.

A scenario names the model and its changes, the sampled loop, the disturbances, the sets of robots, the measures with
their weights, what a controller is refused for, and the reference controller, whose measures are the units of score.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import hadamard

from flexgen.errors import ArgumentError
from flexgen.mechanics.parameters import select
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read
from flexgen.model.toml_lines import TextError, plain_table
from flexgen.motion_control.controller_files import table_controller
from flexgen.motion_control.disturbances import Disturbance, rows_of
from flexgen.motion_control.plants import NOMINAL, Plants

FOLDER = Path(__file__).resolve().parent
FORMAT = 1
# SHA-256 of the files: a scenario that was published never changes; another version has another name.
FROZEN = {
    "four_mass": "6c9c55b8edde74fc673e00a0f28be484eb59e2894330b6203057eca5029c4764",
    "two_link": "72d3d30b42d2b3340ac1c8328a496844ec1e60e565b1e04aca91556874eedae3",
}
KINDS = ("peak", "rms", "settling", "torque_peak", "torque_max", "torque_rms")


@dataclass(frozen=True)
class Output:
    """A regulated number: ``weights`` of the arm coordinates, or ``axis`` of the tool's position, times ``scale``."""

    name: str
    unit: str
    weights: Mapping[str, float]
    axis: str
    scale: float


@dataclass(frozen=True)
class Window:
    """A part of the run [s] and the weights of the measures that are taken in it."""

    name: str
    begin: float
    end: float
    weights: Mapping[str, float]


@dataclass(frozen=True)
class Accept:
    """What a controller is refused for: motion at rest above ``rest``, also with this delay and gain; torque noise."""

    delay_s: float
    gain: float
    torque_noise_Nm: float
    rest: float


@dataclass(frozen=True, eq=False)
class Scenario:
    """A benchmark; see the module.

    ``sets``: for each set the numbers of its robots among all; robot 0 is nominal.
    """

    name: str
    version: int
    title: str
    published: str
    ours: str
    digest: str
    frozen: bool
    model: RobotModel
    sample_s: float
    delay_s: float
    steps: int
    duration_s: float
    encoder_noise_rad: float
    torque_max_Nm: tuple[float, ...]
    seed: int
    start: tuple[float, ...]
    outputs: tuple[Output, ...]
    disturbances: tuple[Disturbance, ...]
    windows: tuple[Window, ...]
    tolerance: float
    nominal_weight: float
    set_weights: tuple[float, ...]
    plants: Plants
    sets: Mapping[str, tuple[int, ...]]
    accept: Accept
    reference: Any

    @property
    def title_line(self) -> str:
        """Name, version and the begin of the hash."""
        kind = "" if self.frozen else ", not a published version"
        return f"{self.name} version {self.version}, {self.digest[:12]}{kind}: {self.title}"


def scenario(name: str | Path) -> Scenario:
    """A scenario by the name of a benchmark (``four_mass``, ``two_link``) or the path of a file.

    Raises
    ------
    ArgumentError
        There is none, the file is not what a scenario is, or it is not the published one.
    ModelError
        Its model cannot be read.
    """
    text = str(name)
    path = FOLDER / f"{text}.toml" if text in FROZEN else Path(text)
    if text not in FROZEN and path.suffix != ".toml":
        raise ArgumentError(f"scenario: given {text!r}, expected {', '.join(FROZEN)} or the path of a .toml file")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ArgumentError(f"{path}: cannot be read: {error}") from error
    return _parsed(path, data, text if text in FROZEN else "")


@lru_cache(maxsize=16)
def _parsed(path: Path, data: bytes, known: str) -> Scenario:
    digest = hashlib.sha256(data.replace(b"\r\n", b"\n")).hexdigest()
    if known and FROZEN[known] != digest:
        raise ArgumentError(
            f"{path}: given the hash {digest[:12]}, expected {FROZEN[known][:12]}: the benchmark's file was changed; "
            "scores with it cannot be compared. Copy it under another name to change it"
        )
    try:
        table = plain_table(data.decode())
    except (UnicodeDecodeError, TextError) as error:
        raise ArgumentError(f"{path}: cannot be read as TOML: {error}") from error
    return _Reader(path, digest).scenario(table)


class _Reader:
    """Reads the table of a scenario; every error names file and key."""

    def __init__(self, path: Path, digest: str) -> None:
        self.path, self.digest = path, digest

    def fail(self, key: str, given: Any, expected: str) -> ArgumentError:
        return ArgumentError(f"{self.path}, {key}: given {given!r}, expected {expected}")

    def get(self, table: Mapping[str, Any], key: str, kind: Any, where: str = "") -> Any:
        name = f"{where}.{key}" if where else key
        if key not in table:
            raise ArgumentError(f"{self.path}: expected the key {name}")
        value = table[key]
        if isinstance(value, bool) or not isinstance(value, kind):
            raise self.fail(name, value, getattr(kind, "__name__", "a number"))
        if isinstance(value, float) and not np.isfinite(value):
            raise self.fail(name, value, "a finite number")
        return value

    def number(self, table: Mapping[str, Any], key: str, where: str = "", least: float = 0.0) -> float:
        value = float(self.get(table, key, (int, float), where))
        if value < least:
            raise self.fail(f"{where}.{key}" if where else key, value, f"at least {least:g}")
        return value

    def whole(self, table: Mapping[str, Any], key: str, sample: float, where: str = "") -> float:
        """A delay of whole samples."""
        value = self.number(table, key, where)
        if abs(value / sample - round(value / sample)) > 1e-6:
            raise self.fail(f"{where}.{key}" if where else key, value, f"a multiple of the sample time {sample:g} s")
        return value

    def scenario(self, t: Mapping[str, Any]) -> Scenario:
        if t.get("format") != FORMAT:
            raise self.fail("format", t.get("format"), str(FORMAT))
        chosen = self.get(t, "model", dict)
        base = self.get(chosen, "name", str, "model")
        model = read(base, chosen.get("variant"), chosen.get("set"))
        measures, score = self.get(t, "measures", dict), self.get(t, "score", dict)
        accept = self.get(t, "accept", dict)
        duration = self.number(t, "duration_s", least=1e-3)
        disturbances = tuple(self.disturbance(row, model) for row in self.get(t, "disturbance", list))
        self.check_overlap(t["disturbance"], disturbances, duration)
        plants, sets = self.plants(model, self.get(t, "set", list))
        weights = tuple(float(x) for x in self.get(score, "sets", list, "score"))
        if len(weights) != len(sets):
            raise self.fail("score.sets", list(weights), f"{len(sets)} weights, one for each set")
        sample = self.number(t, "sample_s", least=1e-6)
        limits_of = (self.number(accept, key, "accept") for key in ("gain", "torque_noise_Nm", "rest"))
        limits = tuple(float(x) for x in self.get(t, "torque_max_Nm", list))
        start = tuple(float(x) for x in self.get(t, "start_rad", list))
        if len(limits) != model.n_m or len(start) != len(model.i_g):
            raise self.fail(
                "torque_max_Nm, start_rad", [*limits, *start], f"{model.n_m} motors, {len(model.i_g)} joints"
            )
        return Scenario(
            name=self.get(t, "name", str),
            version=self.get(t, "version", int),
            title=self.get(t, "title", str),
            published=self.get(t, "published", str).strip(),
            ours=self.get(t, "ours", str).strip(),
            digest=self.digest,
            frozen=self.digest in FROZEN.values(),
            model=model,
            sample_s=sample,
            delay_s=self.whole(t, "delay_s", sample),
            steps=int(self.number(t, "steps", least=1)),
            duration_s=duration,
            encoder_noise_rad=self.number(t, "encoder_noise_rad"),
            torque_max_Nm=limits,
            seed=int(self.number(t, "seed")),
            start=start,
            outputs=tuple(self.output(row, model) for row in self.get(t, "output", list)),
            disturbances=disturbances,
            windows=tuple(self.window(row, duration) for row in self.get(measures, "windows", list, "measures")),
            tolerance=self.number(measures, "tolerance", "measures"),
            nominal_weight=self.number(score, "nominal", "score"),
            set_weights=weights,
            plants=plants,
            sets=sets,
            accept=Accept(self.whole(accept, "delay_s", sample, "accept"), *limits_of),
            reference=table_controller(self.get(t, "reference", dict), self.path),
        )

    def output(self, row: Mapping[str, Any], model: RobotModel) -> Output:
        name, unit = self.get(row, "name", str, "output"), self.get(row, "unit", str, "output")
        if "weights" in row:
            weights = self.get(row, "weights", dict, "output")
            known = [c.name for c in model.coordinates]
            if any(key not in known for key in weights):
                raise self.fail("output.weights", sorted(weights), f"coordinates of the model: {', '.join(known)}")
            return Output(name, unit, {k: float(v) for k, v in weights.items()}, "", 1.0)
        axis = self.get(row, "tool_axis", str, "output")
        if axis not in "xyz" or len(axis) != 1:
            raise self.fail("output.tool_axis", axis, "x, y or z")
        return Output(name, unit, {}, axis, self.number(row, "scale", "output"))

    def disturbance(self, row: Mapping[str, Any], model: RobotModel) -> Disturbance:
        fields = {k: v for k, v in row.items() if k != "name"}
        try:
            made = Disturbance(
                **fields | {"frequency_hz": tuple(row["frequency_hz"]) if "frequency_hz" in row else None}
            )
            rows_of(made.where, [m.name for m in model.motors])
        except (ArgumentError, TypeError) as error:
            raise ArgumentError(f"{self.path}, disturbance {row.get('name', '')}: {error}") from error
        return made

    def check_overlap(self, rows: list[Any], given: tuple[Disturbance, ...], duration: float) -> None:
        """Disturbances that end lie within the run, and no two of them on one place at once."""
        names = [str(row.get("name", k + 1)) for k, row in enumerate(rows)]
        for k, d in enumerate(given):
            if not 0 <= d.start_s < duration or (d.kind != "step" and d.end_s > duration):
                raise self.fail(f"disturbance {names[k]}", d.start_s, f"one within the run of {duration:g} s")
            for i in range(k):
                other = given[i]
                both = d.where == other.where and d.kind != "step" and other.kind != "step"
                if both and d.start_s < other.end_s and other.start_s < d.end_s:
                    raise ArgumentError(
                        f"{self.path}, disturbance {names[k]}: given one that overlaps {names[i]} on {d.where}, "
                        "expected one after the other"
                    )

    def window(self, row: Mapping[str, Any], duration: float) -> Window:
        name = self.get(row, "name", str, "windows")
        span = self.get(row, "window_s", list, "windows")
        if len(span) != 2 or not 0 <= span[0] < span[1] <= duration:
            raise self.fail(f"window {name}", span, f"two increasing times within {duration:g} s")
        weights = self.get(row, "weights", dict, f"window {name}")
        unknown = [key for key in weights if key not in KINDS]
        if unknown or not weights:
            raise self.fail(f"window {name}, weights", unknown, f"some of {', '.join(KINDS)}")
        return Window(name, float(span[0]), float(span[1]), {k: float(v) for k, v in weights.items()})

    def plants(self, model: RobotModel, rows: list[Any]) -> tuple[Plants, dict[str, tuple[int, ...]]]:
        """The nominal robot and those of all sets."""
        names, numbers = [NOMINAL], [dict[str, float]()]
        sets: dict[str, tuple[int, ...]] = {}
        for row in rows:
            name = self.get(row, "name", str, "set")
            factors = self.get(row, "factors", list, f"set {name}")
            order = 2
            while order <= len(factors):
                order *= 2
            signs = hadamard(order)[:, 1 : len(factors) + 1]
            sets[name] = tuple(range(len(names), len(names) + order))
            for k, own in enumerate(signs):
                values: dict[str, float] = {}
                for sign, factor in zip(own, factors, strict=True):
                    change = self.number(factor, "change", f"set {name}")
                    for parameter in select(model, self.get(factor, "names", list, f"set {name}")):
                        values[parameter.name] = parameter.value * (1 + sign * change)
                names.append(f"{name}, {k + 1}")
                numbers.append(values)
        used = sorted({key for values in numbers for key in values})
        parameters = tuple(select(model, used)) if used else ()
        table = np.array([[own.get(p.name, p.value) for p in parameters] for own in numbers])
        plants = Plants(tuple(names), parameters, table.reshape(len(names), len(parameters)), ("",) * len(names))
        return plants, sets
