"""Scores of the benchmarks against their definitions: measures, draws, sums over robots, reasons
to refuse a controller, tuning of a score that is known.
"""

from __future__ import annotations

import hashlib
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from toolchain import needs_compiler

import flexgen
from flexgen.base.calls.deadline import OutOfTime
from flexgen.base.errors import ArgumentError
from flexgen.codegen.build.model_library import library_with
from flexgen.feedback.laws.lq import LQG
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.gains import PPI
from flexgen.feedback.loop.model_law import LinearDesign
from flexgen.model.position_servo.filters import LowPass, Notch
from flexgen.simulation.environment.disturbances import Disturbance
from flexgen.studies.scenarios.bench import Bench, Trial, disturbances_of, outputs_of
from flexgen.studies.scenarios.content import content_hash
from flexgen.studies.scenarios.draws import FIRST_K, Draw, draws_of
from flexgen.studies.scenarios.foreign import ForeignController
from flexgen.studies.scenarios.leaderboard import (
    find_shipped_controllers,
    is_foreign,
    scenario_controller,
)
from flexgen.studies.scenarios.measures import at_rest, compute_measures, measures_of
from flexgen.studies.scenarios.scenario import Output, Plan, Scenario, Segment, Window
from flexgen.studies.scenarios.scenario_file import FOLDER, scenario
from flexgen.studies.scenarios.score import Score, find_broken_rule, reference_measures
from flexgen.studies.scenarios.tune import cascade_table, numbers_of, with_numbers

KINDS = ("peak", "rms", "settling", "torque_peak", "torque_max", "torque_rms")
PART = (Window("first", 0.05, 0.3, {kind: 1.0 + k for k, kind in enumerate(KINDS)}),)


def small(**more: Any) -> Scenario:
    """Two outputs in two units, samples of 10 ms, one window of 25 samples with every measure."""
    given = scenario("two_link", 1)
    angle = Output("q", "rad", {"q1": 1.0}, "", 1.0)
    fields = {
        "outputs": (replace(given.outputs[0], name="tool"), angle),
        "windows": PART,
        "sample_s": 0.01,
        "duration_s": 0.4,
        "tolerance": 0.3,
    }
    return replace(given, **(fields | more))


# --- measures


def of_definition(z: np.ndarray, u: np.ndarray, s: Scenario) -> list[float]:
    """The measures of the samples of a window, by loops over the samples."""
    h = s.sample_s
    n, outputs = z.shape
    rest = [sum(z[-10:, k]) / 10 for k in range(outputs)]
    settling = []
    for k in range(outputs):
        far = [abs(x - rest[k]) for x in z[:, k]]
        if s.measures_version == 1:
            settling.append(max((h * i for i in range(n) if far[i] > s.tolerance), default=0.0))
            continue
        envelope = [max(far[i:]) for i in range(n)]
        settling.append(h * sum(min(max(e / s.tolerance - 0.5, 0), 1) for e in envelope))
    mean = [sum(z[:, k]) / n for k in range(outputs)]
    return [
        *(max(z[:, k]) - min(z[:, k]) for k in range(outputs)),
        *(np.sqrt(sum((z[:, k] - mean[k]) ** 2) / n) for k in range(outputs)),
        *settling,
        max(max(x) - min(x) for x in u.T),
        max(abs(x) for x in u.ravel()),
        np.sqrt(sum(sum(x**2) for x in u) / n),
    ]


@pytest.mark.parametrize("version", [1, 2])
def test_measures_are_those_of_their_definitions(version: int) -> None:
    s = small(measures_version=version)
    rng = np.random.default_rng(version)
    z = rng.normal(size=(40, 2))
    u = rng.normal(size=(40, 3))
    found = compute_measures(s, s.windows, z, u)
    assert_allclose(found, of_definition(z[5:30], u[5:30], s), rtol=1e-12)
    assert compute_measures(s, s.windows, 0 * z, u)[4] == 0.0  # nothing to settle


def test_measures_have_names_units_and_weights_that_sum_to_one() -> None:
    s = small()
    found = measures_of(s)
    weights = np.array([1, 1, 2, 2, 3, 3, 4, 5, 6.0])
    assert_allclose([m.weight for m in found], weights / weights.sum())
    assert [(m.name, m.unit) for m in found[:2] + found[4:5] + found[-1:]] == [
        ("first, peak to peak of tool", "mm"),
        ("first, peak to peak of q", "rad"),
        ("first, settling time of tool", "s"),
        ("first, RMS torque", "N m"),
    ]
    alone = measures_of(replace(s, outputs=s.outputs[:1]))
    assert alone[0].name == "first, peak to peak"


PLAN = scenario("two_link").plan
REST = {
    "the last window of torque noise": (small(), slice(5, 30)),
    "the last twentieth without one": (
        small(windows=(Window("x", 0.0, 0.1, {"peak": 1.0}),)),
        slice(38, 40),
    ),
    "the last second of a draw": (small(plan=PLAN, duration_s=1.2), slice(20, 120)),
}


@pytest.mark.parametrize("name", REST)
def test_where_a_run_should_rest(name: str) -> None:
    s, part = REST[name]
    z = np.random.default_rng(4).normal(size=(round(s.duration_s / s.sample_s), 2))
    assert_array_equal(at_rest(s, s.windows, z), z[part].max(axis=0) - z[part].min(axis=0))


# --- draws


def test_a_draw_follows_from_the_hash_of_its_words() -> None:
    """Every number of the second draw, from SHA-256 by the words of the rule."""

    def number(words: str) -> float:
        text = f"flexgen two_link 2 seed 3 draw 1: {words}"
        return (int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 11) / 2**53

    push = Disturbance("step", "m1", 2.0, 0.1)
    hold = Disturbance("pulse", "tool.x", 3.0, 0.0, 0.2)
    segments = (
        Segment("a", 1.0, {"peak": 1.0}, (push, hold)),
        Segment("b", 2.0, {"rms": 2.0}, ()),
    )
    plan = Plan(3, (0.5, 1.5), (0.2, 0.4), (0.8, 1.2), 1.0, segments)
    s = replace(scenario("two_link"), plan=plan)
    found = draws_of(s, 3)[1]
    now = 0.5 + number("begin")
    windows = {}
    expected = []
    for segment in sorted(segments, key=lambda x: number(f"order of {x.name}")):
        now += 0.2 + 0.2 * number(f"wait before {segment.name}")
        now = s.sample_s * round(now / s.sample_s)
        for k, d in enumerate(segment.disturbances):
            sign = 1 if number(f"sign of {segment.name} {k}") < 0.5 else -1
            size = sign * d.size * (0.8 + 0.4 * number(f"size of {segment.name} {k}"))
            expected.append((d.kind, d.where, size, now + d.start_s))
        windows[segment.name] = (now, now + segment.length_s)
        now += segment.length_s
    for d, (kind, where, size, start) in zip(found.disturbances, expected, strict=True):
        assert (d.kind, d.where) == (kind, where)
        assert (d.size, d.start_s) == (pytest.approx(size), pytest.approx(start))
    assert [w.name for w in found.windows] == ["a", "b", "whole run"]
    assert_allclose([(w.begin, w.end) for w in found.windows[:2]], [windows[k] for k in "ab"])
    assert found.first == FIRST_K + int(FIRST_K * number("first sample"))
    assert found.seed == int(2**62 * number("noise"))
    assert found.order(5) == sorted(range(5), key=lambda k: number(f"place of robot {k}"))
    assert draws_of(scenario("two_link", 1), 7)[0].order(3) == [0, 1, 2]  # stated times


def test_hashes_of_content() -> None:
    """Of JSON with sorted keys, twelve digits, and no default values."""
    window = Window("a", 0.1, 2.0, {"peak": 1.0})
    texts = {
        '["Window",{"begin":"0.1","end":"2","name":"a","weights":{"peak":"1"}}]': window,
        '[1,"0",true,null,"u","0.333333333333",[[2],"1","2"]]': [
            1,
            -0.0,
            True,
            None,
            "u",
            np.float64(1 / 3),
            np.array([1.0, 2.0]),
        ],
        '["Disturbance",{"kind":"step","size":"1","where":"m1"}]': Disturbance("step", "m1", 1.0),
    }
    for text, value in texts.items():
        assert content_hash(value, "x") == hashlib.sha256(text.encode()).hexdigest()
    same, other = (content_hash(replace(window, begin=0.1 + x), "x") for x in (1e-15, 1e-10))
    assert same == content_hash(window, "x") != other
    for bad, text in (
        ({"end": np.inf}, "x, end: given inf, expected a finite number"),
        ([1, object()], r"x\[1\]: given .*, expected data"),
    ):
        with pytest.raises(ArgumentError, match=text):
            content_hash(bad, "x")


@pytest.mark.parametrize("name", ["four_mass", "two_link"])
def test_sets_of_robots_are_columns_of_hadamard_matrices(name: str) -> None:
    """Factors change by plus and minus their share, in columns that are orthogonal to each other
    and to that of ones.
    """
    s = scenario(name)
    table = tomllib.loads((FOLDER / f"{name}-2.toml").read_text())
    nominal = s.plants.values[0]
    place = {p.name: k for k, p in enumerate(s.plants.parameters)}
    assert_allclose(nominal, [p.value for p in s.plants.parameters])
    assert not s.plants.values.flags.writeable
    for row in table["set"]:
        robots = list(s.sets[row["name"]])
        assert [s.plants.names[k] for k in robots] == [
            f"{row['name']}, {k + 1}" for k in range(len(robots))
        ]
        assert len(robots) // 2 <= len(row["factors"]) < len(robots)
        columns = [np.ones(len(robots))]
        for factor in row["factors"]:
            own = [k for key, k in place.items() if any(in_group(key, n) for n in factor["names"])]
            ratios = s.plants.values[np.ix_(robots, own)] / nominal[own]
            signs = (ratios - 1) / factor["change"]
            assert_allclose(signs, signs[:, :1] * np.ones(len(own)), atol=1e-9)
            columns.append(signs[:, 0])
        H = np.array(columns)
        assert_allclose(H @ H.T, len(robots) * np.eye(len(H)), atol=1e-9)


def in_group(parameter: str, name: str) -> bool:
    """Whether a parameter is meant by a name: alone, or as one of a law such as a spring's."""
    return parameter == name or parameter.startswith(f"{name}_")


# --- the score of known measures


def scored(values: np.ndarray, units: np.ndarray, **more: Any) -> Score:
    s = scenario("four_mass")
    plain = ("mine", 3, "", measures_of(s), values, units, (), 1.0, {})
    return replace(Score(s, *plain), **more)


def known(draws: int) -> tuple[np.ndarray, np.ndarray]:
    """Measures of all robots of four_mass and of the reference."""
    rng = np.random.default_rng(2)
    k = len(measures_of(scenario("four_mass")))
    return rng.uniform(1, 9, (draws, 17, k)), rng.uniform(1, 3, (draws, k))


def test_a_score_is_the_weighted_sum_of_its_definition() -> None:
    """Of nominal robot and worst robots of the sets, with their weights of four_mass."""
    values, units = known(3)
    found = scored(values, units)
    weights = [m.weight for m in found.measures]
    each = np.array(
        [
            [
                sum(w * x / r for w, x, r in zip(weights, robot, unit, strict=True))
                for robot in draw
            ]
            for draw, unit in zip(values, units, strict=True)
        ]
    )
    sets = {"nominal": (0,), "set 1": range(1, 9), "set 2": range(9, 17)}
    worst = {
        k: np.array([max(row[i] for i in lanes) for row in each]) for k, lanes in sets.items()
    }
    totals = 0.5 * worst["nominal"] + 0.3 * worst["set 1"] + 0.2 * worst["set 2"]
    assert_allclose(found.totals, totals)
    assert_allclose(found.each, each.mean(axis=0))
    assert (found.total, found.worst) == (pytest.approx(totals.mean()), max(totals))
    assert found.spread == pytest.approx(np.sqrt(((totals - totals.mean()) ** 2).sum() / 2))
    assert found.parts == pytest.approx({k: x.mean() for k, x in worst.items()})
    for k, row in enumerate(found.table):
        m = found.measures[k]
        assert (row["measure"], row["unit"], row["weight"]) == (m.name, m.unit, m.weight)
        assert row["reference"] == pytest.approx(units[:, k].mean())
        for name, lanes in sets.items():
            assert row[name] == pytest.approx(values[:, list(lanes), k].max(axis=1).mean())
    data = found.to_dict()
    assert data["accepted"] and data["score"] == found.total
    assert data["draws"] == pytest.approx(totals.tolist())
    assert data["robots"]["set 1, 2"] == pytest.approx(each[:, 2].mean())


def test_texts_of_a_score() -> None:
    values, units = known(2)
    found = scored(values, units)
    spread = f"worst draw {found.worst:.4f}, spread {found.spread:.4f} over 2 draws"
    head = f"{found.scenario.title_line}\ncontroller mine: "
    assert found.spread_words == spread and f"; {spread})" in str(found)
    assert str(found).startswith(f"{head}V = {found.total:.4f} (nominal ")
    assert repr(found) == f"<Score four_mass, mine: V = {found.total:.4f}>"
    one = scored(values[:1], units[:1])
    assert np.isnan(one.spread) and one.spread_words == "" and "draws" not in one.to_dict()
    early = scored(values, units, ended="time limit")
    assert early.status == "time limit: the score of 2 of 8 draws"
    assert found.status == "done" and early.status in repr(early) and early.status in str(early)


def test_a_refused_controller_has_no_number_of_a_score() -> None:
    values, units = known(2)
    refused = scored(values, units, refused=("too loud",), rule="no rule")
    assert not refused.accepted and refused.parts == {} and refused.totals.shape == (0,)
    assert np.isnan([refused.total, refused.worst, refused.spread]).all()
    assert "score" not in refused.to_dict()
    text = (
        f"{refused.scenario.title_line}\ncontroller mine: refused, no score\n  too loud\n  no rule"
    )
    assert str(refused) == text
    assert not scored(values * np.nan, units).accepted


class Own:
    """A controller of one's own."""

    def reset(self) -> None: ...

    def step(self, k: int, y: object, ref: object) -> list[float]:
        return [0.0]


OURS = Linear(*np.zeros((4, 1, 1)))
RULES: dict[str, tuple[int, Any, int | None, int | None, str]] = {
    "nothing given": (2, OURS, None, None, ""),
    "the published numbers given": (2, OURS, 1, 1, ""),
    "another seed": (
        2,
        OURS,
        6,
        None,
        "not the published score: other draws and noise, of the se",
    ),
    "other steps": (2, OURS, None, 8, "not the published score: 8 integration steps in a sample"),
    "a file": (2, "mine.py", None, None, ""),
    "a file and other steps": (
        2,
        "mine.py",
        None,
        8,
        "not the published score: 8 integration ste",
    ),
    "a file and a seed": (2, "mine.py", 1, None, "no fair score: the seed 1 was given"),
    "a file and stated times": (1, "mine.py", None, None, "no fair score: the times of version 1"),
    "an object": (2, Own(), None, None, "no published score: the object is part of the program"),
}


@pytest.mark.parametrize("name", RULES)
def test_rules_that_a_score_breaks(name: str) -> None:
    version, given, seed, steps, text = RULES[name]
    made = given if given is OURS else ForeignController(given)
    found = find_broken_rule(scenario("four_mass", version), made, seed, steps)
    assert found == "" if not text else found.startswith(text)


# --- reasons to refuse a controller


def run_of(change: Any, monkeypatch: pytest.MonkeyPatch) -> tuple[str, ...]:
    """Reasons for traces of one draw: all robots at rest, one sine of 0.5 mm; ``change`` them."""
    s = scenario("two_link")
    s = replace(s, plan=replace(s.plan, draws=1))
    n = round(s.duration_s / s.sample_s)
    z = np.zeros((n, 11, 2))
    z[:, :, 0] = 0.25 * np.sin(0.1 * np.arange(n))[:, None]
    u = np.zeros((n, 11, 2))
    failures = [""] * 11
    change(z, u, failures)
    monkeypatch.setattr(Bench, "simulate", lambda *given: (z, u, tuple(failures)))
    return Bench(s).run(OURS).refused


def swing(z: np.ndarray, u: np.ndarray, failures: list[str]) -> None:
    z[-50:, 1, 1] += np.resize([0.6, -0.6], 50)


def early(z: np.ndarray, u: np.ndarray, failures: list[str]) -> None:
    z[:-2500, 1, 1] += 9.0


def late(z: np.ndarray, u: np.ndarray, failures: list[str]) -> None:
    z[-9:, 9, 1] = 9.0
    z[-9:, 10, 0] = np.nan


def failed(z: np.ndarray, u: np.ndarray, failures: list[str]) -> None:
    swing(z, u, failures)
    failures[1] = "not finite"
    z[:, 1] = np.nan


def quiet(z: np.ndarray, u: np.ndarray, failures: list[str]) -> None:
    u[:, 0] = np.resize([2.5, -2.5], len(u))[:, None]
    u[:, 3] = 9 * u[:, 0]


def loud(z: np.ndarray, u: np.ndarray, failures: list[str]) -> None:
    u[:, 0, 1] = np.resize([2.6, -2.6], len(u))


def not_finite(z: np.ndarray, u: np.ndarray, failures: list[str]) -> None:
    u[7, 4, 1] = np.inf


REASONS = {
    early: (),
    swing: ("set 1, 1: z not at rest in the end: 1.2 mm peak to peak, expected 1 mm",),
    late: (
        "nominal, gain 2 times as large: z not at rest in the end: 9 mm peak to peak, expected 1 "
        "mm",
        "nominal, delay 2 ms: x not at rest in the end: nan mm peak to peak, expected 1 mm",
    ),
    failed: ("set 1, 1: not finite",),
    quiet: (),
    loud: ("nominal: torque noise of 5.2 N m peak to peak, expected at most 5 N m",),
    not_finite: (
        "set 1, 4: whole run, largest torque is not a finite number",
        "set 1, 4: whole run, RMS torque is not a finite number",
    ),
}


@needs_compiler
@pytest.mark.parametrize("change", REASONS, ids=lambda change: change.__name__)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_reasons_to_refuse_a_controller(change: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Just below and above each limit; other robots than the nominal one may be loud."""
    assert run_of(change, monkeypatch) == REASONS[change]


@needs_compiler
def test_outputs_are_combinations_of_coordinates_or_axes_of_the_tool() -> None:
    """The elbow's tool in closed form."""
    s = scenario("two_link")
    both = (Output("sum", "rad", {"q1": 2.0, "q2": -1.0}, "", 1.0), s.outputs[1])
    library = library_with(s.model, ["forward_kinematics"])
    q = np.random.default_rng(3).normal(size=(4, 2, 3))
    found = outputs_of(replace(s, outputs=both), library)(q)
    assert_allclose(found[:, :, 0], 2 * q[:, 0] - q[:, 1])
    height = 1.150 * np.cos(q[:, 0]) - 1.241 * np.sin(q[:, 0] + q[:, 1])
    assert_allclose(found[:, :, 1], 1e3 * height, rtol=1e-9)


@needs_compiler
def test_outputs_and_torques_are_those_in_addition_to_rest() -> None:
    """Of an arm that gravity loads: before a disturbance there is noise of the encoders only."""
    s = replace(scenario("two_link", 1), duration_s=0.05)
    bench = Bench(s)
    one = np.ones(1)
    law, _ = scenario_controller("reference", s, bench.motion)
    z, u, failures = bench.simulate(law, [0], one, s.delay_s * one, bench.draws[0])
    held = bench.motion[-1]
    assert failures == ("",) and np.abs(held).max() > 2.0
    assert np.abs(u).max() < 0.5 * np.abs(held).min() and np.abs(z).max() < 0.1


def test_disturbances_act_in_the_middle_of_the_steps_of_the_integrator() -> None:
    s = scenario("two_link")
    step = Disturbance("step", "m2", 3.0, 5.2 * s.sample_s)
    table = disturbances_of(s, Draw(0, (step,), ()), 4, 3, 5)
    assert table is not None
    middle = s.sample_s * (3 + (np.arange(20) + 0.5) / 4)
    assert_array_equal(table[:, 1, 0], 3.0 * (middle >= step.start_s))
    assert not table[:, 0].any()


# --- versions and controllers

UNKNOWN = {
    ("four_mass", 3): "given 3, expected one of 1, 2$",
    ("four_mass", 0): "given 0, expected one of 1, 2$",
    ("four_mass@1", 2): "given 2, expected one of 1, 2$",
    ("four_mass@x", None): "expected one of 1, 2$",
    ("four_mass@0001", None): "expected one of 1, 2$",
    ("four_mass@01", None): "expected one of 1, 2$",
    ("four_mass@99", None): "given 99, expected one of 1, 2$",
    ("four_mass", True): "given True, expected one of 1, 2$",
    ("nothing", None): "scenario: given 'nothing', expected four_mass, two_link or the path",
    ("x.toml", 1): "version: given 1 with the file x.toml, expected none",
}


@pytest.mark.parametrize("given", UNKNOWN)
def test_unknown_versions(given: tuple[str, int | None]) -> None:
    with pytest.raises(ArgumentError, match=UNKNOWN[given]):
        scenario(*given)


def test_versions_are_named_or_the_newest() -> None:
    given = [("four_mass",), ("four_mass@1",), ("four_mass", 1), ("four_mass@1", 1)]
    versions = [scenario(*name) for name in given]
    assert [s.version for s in versions] == [2, 1, 1, 1]
    assert versions[1].frozen and not replace(versions[1], tolerance=9.0).frozen


def test_controllers_of_a_benchmark_replace_those_of_its_first_version() -> None:
    first, second = (find_shipped_controllers("two_link", version) for version in (1, 2))
    newer = [name for name, path in second.items() if "-2-" in path.name]
    assert set(first) <= set(second) and newer
    assert not any("-2-" in path.name for path in first.values())
    assert all(second[name] != first.get(name) for name in newer)


class Design(LinearDesign):
    """A design of one's own."""

    def linear(self, *_: object) -> object: ...  # type: ignore[override]


FOREIGN = {
    "a.py": 1,
    "b.py:C": 1,
    "c.so": 1,
    "d.toml": 0,
    PPI(): 0,
    Own(): 1,
    LQG(): 0,
    Design(): 1,
}


@pytest.mark.parametrize(("given", "foreign"), FOREIGN.items(), ids=map(repr, range(len(FOREIGN))))
def test_which_controllers_are_code_of_others(given: Any, foreign: int) -> None:
    assert is_foreign(given) == foreign


# --- tuning

GIVEN = Cascade(
    np.array([3.0, 0.0]),
    np.array([2.0, 5.0]),
    np.zeros(2),
    (LowPass(30.0, 0.7), Notch(9.0, 0.1, 0.5)),
)


def test_numbers_of_a_cascade_are_logarithms_of_what_is_not_zero() -> None:
    x = numbers_of(GIVEN)
    assert_allclose(x, np.log([3, 2, 5, 30, 0.7, 9, 0.1, 0.5]))
    other = with_numbers(GIVEN, x + np.log(2))
    assert_allclose(other.position_gain, [6, 0])
    assert_allclose(other.speed_gain, [4, 10])
    assert_allclose(other.integral_gain, [0, 0])
    assert_allclose([other.filters[0].frequency_hz, other.filters[1].pole_damping], [60, 1])
    assert np.isfinite(with_numbers(GIVEN, x + 1e4).speed_gain).all()


def test_tables_of_controllers_have_their_numbers() -> None:
    found = tomllib.loads(cascade_table(GIVEN, 'a "b" \\'))
    assert found == {
        "description": 'a "b" \\',
        "type": "cascade",
        "position_gain": [3.0, 0.0],
        "speed_gain": [2.0, 5.0],
        "integral_gain": [0.0, 0.0],
        "low_pass": [{"frequency_hz": 30.0, "damping": 0.7}],
        "notch": [{"frequency_hz": 9.0, "zero_damping": 0.1, "pole_damping": 0.5}],
    }
    matrices = np.eye(2), np.array([[1.0], [2.0]]), np.array([[3.0, 4.0]]), np.array([[2.5]])
    linear = tomllib.loads(cascade_table(Linear(*matrices), "x"))
    assert linear["type"] == "linear"
    for name, x in zip("ABCD", matrices, strict=True):
        assert_array_equal(linear[name], x)


def bowl(monkeypatch: pytest.MonkeyPatch, refused: tuple[str, ...] = ()) -> Scenario:
    """A benchmark of one draw with the score 1 + |log gains - 1|^2 for two gains."""
    s = scenario("four_mass", 1)
    units = np.arange(1.0, 1.0 + len(measures_of(s)))[None]

    def run(bench: Bench, law: Cascade, *more: Any, parts: bool = True) -> Trial:
        x = np.log([law.position_gain[0], law.speed_gain[0]])
        values = (1 + ((x - 1) ** 2).sum()) * np.tile(units[:, None], (1, 17, 1))
        return Trial(values, refused if x[0] < -0.2 else (), {})

    monkeypatch.setattr(Bench, "run", run)
    for module in ("score", "tune"):
        monkeypatch.setattr(
            f"flexgen.studies.scenarios.{module}.reference_measures", lambda *given: units
        )
    return s


def cascade(position: float, speed: float) -> Cascade:
    return Cascade(np.array([position]), np.array([speed]), np.zeros(1))


@needs_compiler
def test_tuning_finds_the_least_of_a_known_score(monkeypatch: pytest.MonkeyPatch) -> None:
    s = bowl(monkeypatch)
    told: list[str] = []
    found = flexgen.tune(s, cascade(1.0, 1.0), evaluations=70, progress=told.append)
    assert_allclose(numbers_of(found.controller), 1.0, atol=0.05)
    assert found.start.total == pytest.approx(3.0) == found.history[0]
    assert found.score.total == pytest.approx(1.0, abs=3e-3)
    assert found.history[1] == pytest.approx(1 + 0.75**2 + 1)  # the first step is a quarter
    assert np.all(np.diff(found.history) <= 0) and len(found.history) <= 70
    assert any(line.startswith("1 of 70 evaluations, best 3.0000") for line in told)
    assert str(found).endswith(f"from 3.0000 in {found.evaluations} evaluations")


@needs_compiler
def test_a_refused_controller_is_worse_by_the_number_of_its_reasons(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    s = bowl(monkeypatch, ("a", "b"))
    found = flexgen.tune(s, cascade(np.exp(-0.5), np.e), evaluations=1, progress=False)
    assert found.history[0] == pytest.approx(1 + 1.5**2 + 10 + 2)
    assert "from refused in 1 evaluations" in str(found)


@needs_compiler
def test_starts_have_one_result_wherever_they_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """In turn or by an executor; the best of several starts is never worse than the first."""
    s = bowl(monkeypatch)
    told: list[str] = []
    given = {"evaluations": 9, "starts": 3}
    first = flexgen.tune(s, cascade(1.0, 1.0), evaluations=9, progress=False)
    alone = flexgen.tune(s, cascade(1.0, 1.0), **given, progress=False)
    with ThreadPoolExecutor(1) as executor:
        shared = flexgen.tune(
            s, cascade(1.0, 1.0), **given, executor=executor, progress=told.append
        )
    assert_array_equal(numbers_of(alone.controller), numbers_of(shared.controller))
    assert alone.evaluations == shared.evaluations == 27 and alone.history == shared.history
    assert alone.score.total <= first.score.total and min(alone.history) < min(first.history)
    starts = [line for line in told if "starts" in line]
    assert starts[-1].startswith(f"3 of 3 starts, best {alone.history[-1]:.4f}")


WRONG_TUNING: dict[str, tuple[dict[str, Any], str]] = {
    "no evaluation": ({"evaluations": 0}, "evaluations: given 0, expected 1 to 20000"),
    "evaluations": ({"evaluations": 20_001}, "evaluations: given 20001"),
    "starts": ({"starts": 1001}, "starts: given 1001, expected 1 to 1000"),
    "workers": ({"workers": 513}, "workers: given 513, expected 1 to 512"),
    "executor": ({"executor": 5}, "executor: given 5, expected an object with submit"),
    "no gain": ({"controller": cascade(0.0, 0.0)}, "gains are all zero and that has no filter"),
}


@pytest.mark.parametrize("name", WRONG_TUNING)
def test_wrong_arguments_of_tuning(name: str) -> None:
    given, text = WRONG_TUNING[name]
    with pytest.raises(ArgumentError, match=text):
        flexgen.tune("four_mass", **given)


@needs_compiler
def test_measures_of_the_reference_are_units_that_cannot_be_changed() -> None:
    units = reference_measures(scenario("four_mass", 1), 1)
    assert units.shape[0] == 1 and (units > 0).all() and not units.flags.writeable


@needs_compiler
@pytest.mark.slow
def test_an_evaluation_that_the_time_ends_is_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The time is over in the second draw of the third evaluation; planted: its first draw alone
    would be a better value than all others.
    """
    chosen = scenario("four_mass", 2)
    draws = len(Bench(chosen).draws)
    simulate = Bench.simulate
    searched: list[int] = []

    def counted(self: Bench, controller: Any, lanes: Any, *rest: Any) -> Any:
        if len(lanes) > 1 and len(searched) <= 2 * draws + 1:
            searched.append(1)
            if len(searched) == 2 * draws + 2:
                raise OutOfTime("tune: the time is over")
        return simulate(self, controller, lanes, *rest)

    monkeypatch.setattr(Bench, "simulate", counted)
    found = flexgen.tune(chosen, time_limit=600.0, progress=False)
    assert found.evaluations == 2 and len(found.history) == 2
    assert len(found.score.values) == len(found.start.values) == draws
    assert found.history[0] == pytest.approx(found.start.total, rel=1e-9)
    assert found.score.total == pytest.approx(min(found.history), rel=1e-9)
