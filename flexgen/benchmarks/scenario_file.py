"""Reader of the files of scenarios; every error names file and key."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import hadamard

from flexgen.benchmarks.measures import REST_S
from flexgen.benchmarks.scenario import FROZEN, NAMES, Accept, Output, Plan, Scenario, Segment, Window
from flexgen.errors import ArgumentError
from flexgen.loop.controller_files import table_controller
from flexgen.loop.disturbances import Disturbance, rows_of
from flexgen.loop.plants import NOMINAL, Plants
from flexgen.mechanics.parameters import select
from flexgen.model.elements import RobotModel
from flexgen.model.reader import packaged_models, read
from flexgen.spec.arguments import is_number, is_whole
from flexgen.spec.toml_lines import TextError, plain_table

FOLDER = Path(__file__).resolve().parent
FORMATS = (1, 2)  # 2: what is drawn, and the version of the measures
MEASURES = (1, 2)
KINDS = ("peak", "rms", "settling", "torque_peak", "torque_max", "torque_rms")
MOST_DRAWS, MOST_STEPS = 1000, 10_000
LARGEST = 1e9
LENGTHS = {"m": 1.0, "mm": 1e3, "um": 1e6}  # units of the tool's position, and how many of each are a meter
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
        There is none, the file is not what a scenario is, or it is not the published one.
    ModelError
        Its model cannot be read.
    """
    text, _, after = str(name).partition("@") if str(name).partition("@")[0] in NAMES else (str(name), "", "")
    if text not in NAMES:
        if Path(text).suffix != ".toml":
            raise ArgumentError(f"scenario: given {text!r}, expected {', '.join(NAMES)} or the path of a .toml file")
        if version is not None:
            raise ArgumentError(f"version: given {version!r} with the file {text}, expected none: the file states it")
        return _parse_table(Path(text), _bytes_of(Path(text)), None)
    known = [number for key, number in FROZEN if key == text]
    if after and version is None:
        version = int(after) if after.isdecimal() and len(after) < 4 else -1
    chosen = known[-1] if version is None else version
    if not is_whole(chosen) or chosen not in known or (after and after != str(chosen)):
        raise ArgumentError(f"version of {name}: given {version!r}, expected one of {', '.join(map(str, known))}")
    path = FOLDER / f"{text}-{chosen}.toml"
    return _parse_table(path, _bytes_of(path), (text, int(chosen)))


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ArgumentError(f"{path}: cannot be read: {error}") from error


@lru_cache(maxsize=16)
def _parse_table(path: Path, data: bytes, known: tuple[str, int] | None) -> Scenario:
    found = parse_scenario(path, data, packaged=known is not None)
    if known is not None and found.content != FROZEN[known][0]:
        raise ArgumentError(
            f"{path}: given the content {found.content[:12]}, expected {FROZEN[known][0][:12]}: the benchmark's file "
            "or its model was changed; scores with it cannot be compared. Copy it under another name to change it"
        )
    return found


def parse_scenario(path: Path, data: bytes, *, packaged: bool) -> Scenario:
    """The scenario of a file; ``packaged``: its model is that which comes with flexgen, whatever the folder has."""
    try:
        table = plain_table(data.decode())
    except (UnicodeDecodeError, TextError) as error:
        raise ArgumentError(f"{path}: cannot be read as TOML: {error}") from error
    return _Reader(path, packaged).scenario(table)


class _Reader:
    """Reads the table of a scenario."""

    def __init__(self, path: Path, packaged: bool) -> None:
        self.path, self.packaged = path, packaged

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

    def number(
        self, table: Mapping[str, Any], key: str, where: str = "", least: float = 0.0, most: float = LARGEST
    ) -> float:
        given = self.get(table, key, (int, float), where)
        if not least <= given <= most:
            raise self.fail(f"{where}.{key}" if where else key, given, f"{least:g} to {most:g}")
        return float(given)

    def numbers(self, table: Mapping[str, Any], key: str, where: str = "") -> tuple[float, ...]:
        """Finite numbers."""
        given = self.get(table, key, list, where)
        if not all(is_number(x) for x in given):
            raise self.fail(f"{where}.{key}" if where else key, given, "finite numbers")
        return tuple(float(x) for x in given)

    def whole(self, table: Mapping[str, Any], key: str, sample: float, where: str = "") -> float:
        """A delay of whole samples."""
        value = self.number(table, key, where)
        if abs(value / sample - round(value / sample)) > 1e-6:
            raise self.fail(f"{where}.{key}" if where else key, value, f"a multiple of the sample time {sample:g} s")
        return value

    def scenario(self, t: Mapping[str, Any]) -> Scenario:
        if t.get("format") not in FORMATS:
            raise self.fail("format", t.get("format"), " or ".join(map(str, FORMATS)))
        drawn = t["format"] > 1
        model = self.model(self.get(t, "model", dict))
        measures, score = self.get(t, "measures", dict), self.get(t, "score", dict)
        accept = self.get(t, "accept", dict)
        duration = self.number(t, "duration_s", least=1e-3, most=LONGEST_S)
        disturbances: tuple[Disturbance, ...] = ()
        if not drawn:
            disturbances = tuple(self.disturbance(row, model) for row in self.get(t, "disturbance", list))
            self.check_overlap(t["disturbance"], disturbances, duration)
        kind = self.get(measures, "version", int, "measures") if drawn else 1
        if kind not in MEASURES:
            raise self.fail("measures.version", kind, " or ".join(map(str, MEASURES)))
        plants, sets = self.plants(model, self.get(t, "set", list))
        weights = self.numbers(score, "sets", "score")
        if len(weights) != len(sets):
            raise self.fail("score.sets", list(weights), f"{len(sets)} weights, one for each set")
        sample = self.number(t, "sample_s", least=1e-6)
        limits_of = (self.number(accept, key, "accept") for key in ("gain", "torque_noise_Nm", "rest"))
        limits, start = self.numbers(t, "torque_max_Nm"), self.numbers(t, "start_rad")
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
            model=model,
            sample_s=sample,
            delay_s=self.whole(t, "delay_s", sample),
            steps=int(self.number(t, "steps", least=1, most=MOST_STEPS)),
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
            rule=self.get(t, "rule", str).strip() if drawn else "",
            measures_version=kind,
            plan=self.plan(t, model, duration) if drawn else None,
        )

    def model(self, chosen: Mapping[str, Any]) -> RobotModel:
        """The model and its changes; of a published benchmark that which comes with flexgen."""
        base = self.get(chosen, "name", str, "model")
        return read(
            packaged_models() / f"{base}.toml" if self.packaged else base, chosen.get("variant"), chosen.get("set")
        )

    def plan(self, t: Mapping[str, Any], model: RobotModel, duration: float) -> Plan:
        """The random numbers."""
        draw = self.get(t, "draw", dict)
        lead, wait, factor = (self.span(draw, key) for key in ("lead_s", "wait_s", "factor"))
        segments = tuple(self.segment(row, model) for row in self.get(t, "segment", list))
        end = self.number(draw, "end_s", "draw", least=REST_S)
        longest = lead[1] + sum(s.length_s + wait[1] for s in segments) + end
        if not segments or len({s.name for s in segments}) != len(segments):
            raise self.fail("segment", [s.name for s in segments], "segments of different names")
        if longest > duration + 1e-9:
            raise self.fail("duration_s", duration, f"at least {longest:g} s: the longest run that is drawn")
        count = int(self.number(draw, "count", "draw", least=1, most=MOST_DRAWS))
        return Plan(count, lead, wait, factor, end, segments)

    def span(self, draw: Mapping[str, Any], key: str) -> tuple[float, float]:
        """Two numbers that another one is drawn between."""
        span = self.numbers(draw, key, "draw")
        if len(span) != 2 or not 0 <= span[0] <= span[1]:
            raise self.fail(f"draw.{key}", list(span), "two numbers >= 0, the larger one last")
        return span[0], span[1]

    def segment(self, row: Mapping[str, Any], model: RobotModel) -> Segment:
        name = self.get(row, "name", str, "segment")
        length = self.number(row, "length_s", f"segment {name}", least=1e-3, most=LONGEST_S)
        given = tuple(self.disturbance({"name": name, **d}, model) for d in row.get("disturbance", []))
        for d in given:
            if not 0 <= d.start_s < length or (d.kind != "step" and d.end_s > length):
                raise self.fail(f"segment {name}, disturbance", d.start_s, f"one within its {length:g} s")
        return Segment(name, length, self.weights(row, f"segment {name}"), given)

    def weights(self, row: Mapping[str, Any], where: str) -> dict[str, float]:
        """Weights of the measures."""
        weights = self.get(row, "weights", dict, where)
        unknown = [key for key in weights if key not in KINDS]
        if unknown or not weights:
            raise self.fail(f"{where}, weights", unknown, f"some of {', '.join(KINDS)}")
        return {key: self.number(weights, key, f"{where}, weights") for key in weights}

    def output(self, row: Mapping[str, Any], model: RobotModel) -> Output:
        name, unit = self.get(row, "name", str, "output"), self.get(row, "unit", str, "output")
        if "weights" in row:
            weights = self.get(row, "weights", dict, "output")
            known = [c.name for c in model.coordinates]
            if any(key not in known for key in weights):
                raise self.fail("output.weights", sorted(weights), f"coordinates of the model: {', '.join(known)}")
            numbers = {key: self.number(weights, key, "output.weights", least=-LARGEST) for key in weights}
            return Output(name, unit, numbers, "", 1.0)
        axis = self.get(row, "tool_axis", str, "output")
        if axis not in "xyz" or len(axis) != 1:
            raise self.fail("output.tool_axis", axis, "x, y or z")
        if unit not in LENGTHS:
            raise self.fail("output.unit", unit, f"{', '.join(LENGTHS)}: the tool's position is a length")
        scale = self.number(row, "scale", "output")
        if abs(scale / LENGTHS[unit] - 1.0) > 1e-9:
            raise self.fail("output.scale", scale, f"{LENGTHS[unit]:g} for the unit {unit}")
        return Output(name, unit, {}, axis, scale)

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
        return Window(name, float(span[0]), float(span[1]), self.weights(row, f"window {name}"))

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
        table.setflags(write=False)
        table = table.reshape(len(names), len(parameters))
        return Plants(tuple(names), parameters, table, ("",) * len(names)), sets
