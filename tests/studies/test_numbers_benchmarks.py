"""Numbers of flexgen/studies/scenarios by hand: measures, draws, scores, reasons, tuning of a
function that is known.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws.lq import LQG
from flexgen.feedback.loop.controllers import Cascade, Linear
from flexgen.feedback.loop.gains import PPI
from flexgen.feedback.loop.model_law import LinearDesign
from flexgen.model.position_servo.filters import LowPass, Notch
from flexgen.simulation.environment.disturbances import Disturbance
from flexgen.studies.scenarios import scenario_file, tune
from flexgen.studies.scenarios.bench import Bench, _disturbances, _outputs
from flexgen.studies.scenarios.content import content_hash
from flexgen.studies.scenarios.draws import FIRST_K, Draw, _draw_runs, _uniform
from flexgen.studies.scenarios.foreign import ForeignController
from flexgen.studies.scenarios.leaderboard import find_shipped_controllers, is_foreign
from flexgen.studies.scenarios.measures import Measure, at_rest, compute_measures, measures_of
from flexgen.studies.scenarios.scenario import Accept, Output, Plan, Segment, Window
from flexgen.studies.scenarios.scenario_file import _plants, scenario
from flexgen.studies.scenarios.score import Score, _find_broken_rule, draw_totals, robot_scores

KINDS = ("peak", "rms", "settling", "torque_peak", "torque_max", "torque_rms")


def small(version: int = 1, **more: object) -> SimpleNamespace:
    """Fields of a scenario that measures read: two outputs, samples of 10 ms."""
    outputs = (Output("tool", "mm", {}, "x", 1e3), Output("q", "rad", {"q1": 1.0}, "", 1.0))
    windows = (Window("first", 0.05, 0.3, {kind: 1.0 + k for k, kind in enumerate(KINDS)}),)
    fields = {
        "outputs": outputs,
        "windows": windows,
        "measured": windows,
        "sample_s": 0.01,
        "tolerance": 0.3,
        "measures_version": version,
        "plan": None,
        "duration_s": 0.4,
    }
    return SimpleNamespace(**(fields | more))


def test_measures_of_a_window_by_hand() -> None:
    s = small()
    chance = np.random.default_rng(1)
    z = chance.normal(size=(40, 2))
    u = chance.normal(size=(40, 3))
    inside = slice(5, 30)
    own = z[inside]
    torque = u[inside]
    found = compute_measures(s, s.windows, z, u)
    rest = own[-10:].mean(axis=0)
    settled = [0.01 * np.flatnonzero(np.abs(own[:, k] - rest[k]) > 0.3)[-1] for k in range(2)]
    expected = [
        *np.ptp(own, axis=0),
        *own.std(axis=0),
        *settled,
        np.ptp(torque, axis=0).max(),
        np.abs(torque).max(),
        np.sqrt((torque**2).sum(axis=1).mean()),
    ]
    assert_allclose(found, expected)
    soft = compute_measures(small(2), s.windows, z, u)
    for k in range(2):
        envelope = [np.abs(own[i:, k] - rest[k]).max() for i in range(25)]
        assert soft[4 + k] == pytest.approx(
            0.01 * sum(min(max(e / 0.3 - 0.5, 0), 1) for e in envelope)
        )
    assert compute_measures(s, s.windows, 0 * z, u)[4] == 0.0
    names = [(m.name, m.unit) for m in measures_of(s)]
    assert names[:2] == [
        ("first, peak to peak of tool", "mm"),
        ("first, peak to peak of q", "rad"),
    ]
    assert names[4] == ("first, settling time of tool", "s") and names[-1] == (
        "first, RMS torque",
        "N m",
    )
    weights = np.array([1, 1, 2, 2, 3, 3, 4, 5, 6.0])
    assert_allclose([m.weight for m in measures_of(s)], weights / weights.sum())
    assert measures_of(small(outputs=s.outputs[:1]))[0].name == "first, peak to peak"


def test_where_a_run_should_rest() -> None:
    z = np.arange(80.0).reshape(40, 2)
    assert_array_equal(at_rest(small(), small().windows, z), np.ptp(z[5:30], axis=0))
    quiet = (Window("x", 0.0, 0.1, {"peak": 1.0}),)
    assert_array_equal(at_rest(small(), quiet, z), np.ptp(z[38:40], axis=0))
    drawn = small(plan=1, duration_s=1.2)
    long = np.arange(240.0).reshape(120, 2)
    assert_array_equal(at_rest(drawn, quiet, long), np.ptp(long[20:], axis=0))


def test_a_draw_follows_from_the_hash_of_its_words() -> None:
    def number(words: str) -> float:
        return (
            int.from_bytes(hashlib.sha256(f"key: {words}".encode()).digest()[:8], "big") >> 11
        ) / 2**53

    assert _uniform("key", "x") == number("x")
    push = Disturbance("step", "m1", 2.0, 0.1)
    hold = Disturbance("pulse", "tool.x", 3.0, 0.0, 0.2)
    segments = (
        Segment("a", 1.0, {"peak": 1.0}, (push, hold)),
        Segment("b", 2.0, {"rms": 2.0}, ()),
    )
    plan = Plan(3, (0.5, 1.5), (0.2, 0.4), (0.8, 1.2), 1.0, segments)
    last = Window("whole", 0.0, 9.0, {"peak": 1.0})
    found = _draw_runs(SimpleNamespace(plan=plan, sample_s=0.01, windows=(last,)), "key")
    now = 0.5 + number("begin")
    windows = {}
    expected = []
    for segment in sorted(segments, key=lambda s: number(f"order of {s.name}")):
        now = 0.01 * round((now + 0.2 + 0.2 * number(f"wait before {segment.name}")) / 0.01)
        for k, d in enumerate(segment.disturbances):
            sign = 1 if number(f"sign of {segment.name} {k}") < 0.5 else -1
            expected.append(
                replace(
                    d,
                    size=sign * d.size * (0.8 + 0.4 * number(f"size of {segment.name} {k}")),
                    start_s=now + d.start_s,
                )
            )
        windows[segment.name] = Window(segment.name, now, now + segment.length_s, segment.weights)
        now += segment.length_s
    assert [(d.kind, d.where) for d in found.disturbances] == [(d.kind, d.where) for d in expected]
    assert_allclose(
        [(d.size, d.start_s) for d in found.disturbances], [(d.size, d.start_s) for d in expected]
    )
    assert found.windows == (windows["a"], windows["b"], last)
    assert found.first == FIRST_K + int(FIRST_K * number("first sample")) and found.seed == int(
        2**62 * number("noise")
    )
    places = sorted(range(5), key=lambda k: number(f"place of robot {k}"))
    assert found.order(5) == places and Draw(0, (), ()).order(3) == [0, 1, 2]


MEASURES = (Measure("x", "mm", 0.25), Measure("y", "N m", 0.75))


def scored(values: np.ndarray, **more: object) -> Score:
    chosen = SimpleNamespace(
        nominal_weight=0.5,
        set_weights=(0.3, 0.2),
        sets={"soft": (1, 2), "heavy": (3,)},
        name="s",
        version=7,
        digest="d",
        frozen=False,
        title_line="s version 7",
        plants=SimpleNamespace(names=("nominal", "a", "b", "c")),
    )
    made = object.__new__(Score)
    fields = {
        "scenario": chosen,
        "controller": "mine",
        "seed": 3,
        "rule": "",
        "measures": MEASURES,
        "values": values,
        "reference": np.array([[2.0, 4.0], [1.0, 8.0]]),
        "refused": (),
        "wall_s": 1.0,
        "traces": {},
    }
    for name, value in (fields | more).items():
        object.__setattr__(made, name, value)
    return made


def test_a_score_by_hand() -> None:
    values = np.random.default_rng(2).uniform(1, 9, (2, 4, 2))
    made = scored(values)
    each = (
        values[:, :, 0] / np.array([[2], [1]]) * 0.25
        + values[:, :, 1] / np.array([[4], [8]]) * 0.75
    )
    totals = 0.5 * each[:, 0] + 0.3 * each[:, 1:3].max(axis=1) + 0.2 * each[:, 3]
    assert_allclose(robot_scores(MEASURES, values, made.reference), each)
    assert_allclose(draw_totals(made.scenario, each), totals)
    assert_allclose(made.totals, totals)
    assert made.total == pytest.approx(totals.mean()) and made.worst == pytest.approx(totals.max())
    assert made.spread == pytest.approx(abs(totals[0] - totals[1]) / np.sqrt(2))
    assert_allclose(made.each, each.mean(axis=0))
    assert made.parts == pytest.approx(
        {
            "nominal": each[:, 0].mean(),
            "soft": each[:, 1:3].max(axis=1).mean(),
            "heavy": each[:, 3].mean(),
        }
    )
    row = made.table[1]
    assert (
        row["measure"] == "y"
        and row["unit"] == "N m"
        and row["weight"] == 0.75
        and row["reference"] == 6.0
    )
    assert row["nominal"] == pytest.approx(values[:, 0, 1].mean())
    assert row["soft"] == pytest.approx(values[:, 1:3, 1].max(axis=1).mean())
    assert (
        made.spread_words
        == f"worst draw {totals.max():.4f}, spread {made.spread:.4f} over 2 draws"
    )
    data = made.to_dict()
    assert (
        data["score"] == made.total
        and data["draws"] == pytest.approx(totals.tolist())
        and data["accepted"]
    )
    assert data["robots"] == pytest.approx(
        dict(zip(("nominal", "a", "b", "c"), each.mean(axis=0), strict=True))
    )
    text = str(made)
    assert (
        text.startswith(f"s version 7\ncontroller mine: V = {made.total:.4f} (nominal ")
        and made.spread_words in text
    )
    assert repr(made) == f"<Score s, mine: V = {made.total:.4f}>"
    one = scored(values[:1], reference=made.reference[:1])
    assert np.isnan(one.spread) and one.spread_words == "" and "draws" not in one.to_dict()
    refused = scored(values, refused=("too loud",), rule="no rule")
    assert (
        not refused.accepted
        and np.isnan(refused.total)
        and np.isnan(refused.worst)
        and refused.parts == {}
    )
    assert refused.totals.shape == (0,) and "score" not in refused.to_dict()
    assert str(refused) == "s version 7\ncontroller mine: refused, no score\n  too loud\n  no rule"
    assert not scored(values * np.nan).accepted


def test_broken_rules_of_a_score() -> None:
    chosen = SimpleNamespace(plan=1, version=2, seed=5, steps=4)
    ours = Linear(*np.zeros((4, 1, 1)))
    assert (
        _find_broken_rule(chosen, ours, None, None) == _find_broken_rule(chosen, ours, 5, 4) == ""
    )
    assert (
        _find_broken_rule(chosen, ours, 6, None)
        == "not the published score: other draws and noise, of the seed 6"
    )
    assert (
        _find_broken_rule(chosen, ours, 5, 8)
        == "not the published score: 8 integration steps in a sample"
    )
    other = object.__new__(ForeignController)
    other.is_object = False
    assert _find_broken_rule(chosen, other, None, None) == ""
    assert _find_broken_rule(chosen, other, 5, None).startswith(
        "no fair score: the seed 5 was given"
    )
    assert (
        _find_broken_rule(chosen, other, None, 8)
        == "not the published score: 8 integration steps in a sample"
    )
    stated = SimpleNamespace(plan=None, version=1, seed=5, steps=4)
    assert _find_broken_rule(stated, other, None, None).startswith(
        "no fair score: the times of version 1 are known"
    )
    other.is_object = True
    assert _find_broken_rule(chosen, other, None, None).startswith(
        "no published score: the object is part of the"
    )


def test_reasons_to_refuse_a_controller() -> None:
    accept = Accept(0.01, 2.0, 0.5, 0.2)
    s = small(accept=accept, windows=small().windows)
    bench = object.__new__(Bench)
    bench.scenario = s
    draw = Draw(0, (), s.windows)
    z = np.zeros((40, 3, 2))
    z[10, 1, 1] = 0.21
    z[35, 0, 0] = 5.0
    values = np.ones((2, 9))
    values[0, 6] = 0.51
    found = bench._reasons(draw, ["nominal", "soft", "late"], z, values, ("", "", "not finite"))
    assert found == [
        "soft: q not at rest in the end: 0.21 rad peak to peak, expected 0.2 rad",
        "late: not finite",
        "nominal: torque noise of 0.51 N m peak to peak, expected at most 0.5 N m",
    ]
    values[0, 6] = 0.5
    z[10, 1, 1] = 0.2
    assert bench._reasons(draw, ["nominal", "soft", "late"], z, values, ("", "", "")) == []
    values[1, 3] = np.inf
    found = bench._reasons(draw, ["nominal", "soft", "late"], z, values, ("", "", ""))
    assert found == ["soft: first, RMS of q is not a finite number"]


def test_outputs_and_disturbances_of_a_scenario() -> None:
    coordinates = [SimpleNamespace(name=name) for name in ("q1", "q2")]
    outputs = (
        Output("sum", "rad", {"q1": 2.0, "q2": -1.0}, "", 1.0),
        Output("height", "mm", {}, "z", 1e3),
    )
    s = SimpleNamespace(model=SimpleNamespace(coordinates=coordinates), outputs=outputs)
    library = SimpleNamespace(
        forward_kinematics=lambda q: SimpleNamespace(p=np.c_[q[:, 0], 0 * q[:, 0], q[:, 1] ** 2])
    )
    q = np.random.default_rng(3).normal(size=(4, 2, 3))
    found = _outputs(s, library)(q)
    assert_allclose(found[:, :, 0], 2 * q[:, 0] - q[:, 1])
    assert_allclose(found[:, :, 1], 1e3 * q[:, 1] ** 2)

    class Chosen(SimpleNamespace):
        __hash__ = object.__hash__

    chosen = Chosen(sample_s=0.01, model=SimpleNamespace(motors=[SimpleNamespace(name="m1")]))
    step = Disturbance("step", "m1", 1.0, 0.05)
    table = _disturbances(chosen, Draw(0, (step,), ()), 4, 3, 5)
    assert_array_equal(table[:, 0, 0], 0.03 + 0.0025 * (np.arange(20) + 0.5) >= 0.05)


def test_hashes_of_content() -> None:
    window = Window("a", 0.1, 2.0, {"peak": 1.0})
    first = content_hash(window, "x")
    assert first == content_hash(Window("a", 0.1 + 1e-15, 2.0, {"peak": 1.0}), "x")
    assert (
        len(
            {
                first,
                content_hash(replace(window, end=2.0 + 1e-10), "x"),
                content_hash(replace(window, name="b"), "x"),
            }
        )
        == 3
    )
    text = '["Window",{"begin":"0.1","end":"2","name":"a","weights":{"peak":"1"}}]'
    assert first == hashlib.sha256(text.encode()).hexdigest()
    plain = content_hash([1, -0.0, True, None, "u", np.float64(1 / 3), np.array([1.0, 2.0])], "x")
    expected = '[1,"0",true,null,"u","0.333333333333",[[2],"1","2"]]'
    assert plain == hashlib.sha256(expected.encode()).hexdigest()
    assert (
        content_hash(Disturbance("step", "m1", 1.0), "x")
        == hashlib.sha256(b'["Disturbance",{"kind":"step","size":"1","where":"m1"}]').hexdigest()
    )
    with pytest.raises(ArgumentError, match="Window, end: given inf, expected a finite number"):
        content_hash(replace(window, end=np.inf), "x")
    with pytest.raises(ArgumentError, match=r"x\[1\]: given .*, expected data"):
        content_hash([1, object()], "x")


def test_sets_of_robots_are_columns_of_hadamard_matrices() -> None:
    model = scenario("two_link").model
    rows = [
        {
            "name": "A",
            "factors": [
                {"names": [f"{model.motors[0].name}.inertia"], "change": 0.1},
                {"names": [f"{model.motors[1].name}.inertia"], "change": 0.2},
            ],
        },
        {"name": "B", "factors": []},
    ]
    plants, sets = _plants(model, rows)
    assert plants.names == ("nominal", "A, 1", "A, 2", "A, 3", "A, 4", "B, 1", "B, 2")
    assert sets == {"A": (1, 2, 3, 4), "B": (5, 6)}
    nominal = np.array([m.inertia for m in model.motors[:2]])
    signs = np.array([[1, 1], [-1, 1], [1, -1], [-1, -1]])
    expected = np.vstack([nominal, nominal * (1 + signs * [0.1, 0.2]), nominal, nominal])
    order = [
        [p.name for p in plants.parameters].index(f"{m.name}.inertia") for m in model.motors[:2]
    ]
    assert_allclose(plants.values[:, order], expected)
    assert not plants.values.flags.writeable and plants.loads == ("",) * 7


def test_versions_and_controllers_of_benchmarks() -> None:
    assert (
        scenario("four_mass").version,
        scenario("four_mass@1").version,
        scenario("four_mass", 1).version,
    ) == (
        2,
        1,
        1,
    )
    for given, text in (
        (("four_mass", 3), "given 3, expected one of 1, 2"),
        (("four_mass@1", 2), "given 2, expected one of 1, 2"),
        (("four_mass@x",), "expected one of 1, 2"),
        (("four_mass@0001",), "expected one of 1, 2"),
        (("nothing",), "scenario: given 'nothing', expected four_mass, two_link or the path"),
        (("x.toml", 1), "version: given 1 with the file x.toml, expected none"),
    ):
        with pytest.raises(ArgumentError, match=text):
            scenario(*given)
    first = find_shipped_controllers("two_link", 1)
    second = find_shipped_controllers("two_link", 2)
    assert set(first) <= set(second) and all("-2-" not in path.name for path in first.values())
    newer = [name for name, path in second.items() if "-2-" in path.name]
    assert newer and all(second[name] != first.get(name) for name in newer)
    assert [is_foreign(x) for x in ("a.py", "b.py:C", "c.so", "d.toml", PPI(), object())] == [
        1,
        1,
        1,
        0,
        0,
        1,
    ]

    class Own(LinearDesign):
        def linear(self, *_: object) -> object: ...  # type: ignore[override]

    assert [is_foreign(x) for x in (LQG(), Own())] == [0, 1]  # designs of flexgen, and of others
    assert (
        scenario("two_link@1").frozen and not replace(scenario("two_link@1"), tolerance=9.0).frozen
    )


GIVEN = Cascade(
    np.array([3.0, 0.0]),
    np.array([2.0, 5.0]),
    np.zeros(2),
    (LowPass(30.0, 0.7), Notch(9.0, 0.1, 0.5)),
)


def test_numbers_of_a_cascade_are_logarithms_of_what_is_not_zero() -> None:
    x = tune.numbers_of(GIVEN)
    assert_allclose(x, np.log([3, 2, 5, 30, 0.7, 9, 0.1, 0.5]))
    other = tune.with_numbers(GIVEN, x + np.log(2))
    assert_allclose(
        [*other.position_gain, *other.speed_gain, *other.integral_gain], [6, 0, 4, 10, 0, 0]
    )
    low, notch = other.filters
    assert_allclose([low.frequency_hz, low.damping], [60.0, 1.4])
    assert_allclose([notch.frequency_hz, notch.zero_damping, notch.pole_damping], [18.0, 0.2, 1.0])
    assert tune.with_numbers(GIVEN, x * 0 + 99).speed_gain[0] == pytest.approx(np.exp(50))
    table = tune.cascade_table(GIVEN, 'a "b" \\')
    assert table == (
        'description = "a \\"b\\" \\\\"\n'
        'type = "cascade"\n'
        "position_gain = [3.0, 0.0]\n"
        "speed_gain = [2.0, 5.0]\n"
        "integral_gain = [0.0, 0.0]\n"
        "\n"
        "[[low_pass]]\n"
        "frequency_hz = 30.0\n"
        "damping = 0.7\n"
        "\n"
        "[[notch]]\n"
        "frequency_hz = 9.0\nzero_damping = 0.1\npole_damping = 0.5\n"
    )
    linear = Linear(np.eye(2), np.ones((2, 1)), np.zeros((1, 2)), np.full((1, 1), 2.5))
    assert tune.cascade_table(linear, "x") == (
        'description = "x"\n'
        'type = "linear"\n'
        "A = [[1.0, 0.0], [0.0, 1.0]]\n"
        "B = [[1.0], [1.0]]\n"
        "C = [[0.0, 0.0]]\n"
        "D = [[2.5]]\n"
    )


def test_the_simplex_finds_the_least_of_a_known_score(monkeypatch: pytest.MonkeyPatch) -> None:
    """Score 1 + (log gain - 1)^2 in each of two gains; a refused controller counts 10 and 1 for
    each reason.
    """
    made = Cascade(np.array([1.0]), np.array([1.0]), np.array([0.0]))
    seen = []

    class Bench:
        draws = (1, 2)

        def run(self, law: Cascade) -> SimpleNamespace:
            x = np.log([law.position_gain[0], law.speed_gain[0]])
            seen.append(x)
            refused = ("a", "b") if x[0] < -0.2 else ()
            return SimpleNamespace(
                values=np.full((2, 1, 1), 1 + ((x - 1) ** 2).sum()), refused=refused
            )

    monkeypatch.setattr(tune, "Bench", lambda chosen: Bench())
    monkeypatch.setattr(tune, "reference_measures", lambda chosen, seed: np.ones((2, 1)))
    monkeypatch.setattr(tune, "measures_of", lambda chosen: (Measure("m", "m", 1.0),))
    chosen = SimpleNamespace(seed=0, nominal_weight=1.0, set_weights=(), sets={})
    lines: list[str] = []
    best, least, history, count = tune._search(chosen, made, np.zeros(2), 70, lines.append)
    assert_allclose(best, 1.0, atol=0.05)
    assert least == pytest.approx(1.0, abs=3e-3) and count == len(history) == len(seen) <= 70
    assert np.all(np.diff(history) <= 0) and history[0] == 3.0 and lines[0].endswith("best 3.0000")
    assert_allclose(seen[:3], [[0, 0], [0.25, 0], [0, 0.25]])
    best, least, history, count = tune._search(chosen, made, np.array([-0.5, 1.0]), 1, None)
    assert history[0] == pytest.approx(1 + 1.5**2 + 10 + 1)  # two reasons in two draws


@pytest.mark.parametrize(
    ("given", "route"),
    [
        ({}, "here"),
        ({"workers": 4}, "here"),
        ({"starts": 3, "workers": 1}, "here"),
        ({"starts": 3, "workers": 2}, "2 of 3"),
        ({"starts": 2, "workers": 4}, "2 of 2"),
        ({"executor": SimpleNamespace(submit=None)}, "1 of 1"),
    ],
)
def test_starts_run_here_unless_there_are_several_workers_or_an_executor(
    given: dict, route: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found(how: str, jobs: list) -> list:
        routes.append(how)
        return [(job.begin, float(job.number), [1.0], 5) for job in jobs]

    def in_parallel(jobs: list, workers: int, executor: object, tell: object) -> list:
        assert executor is given.get("executor")
        return found(f"{workers} of {len(jobs)}", jobs)

    routes: list[str] = []
    result = SimpleNamespace(total=1.0)
    monkeypatch.setattr(tune._Job, "search", lambda job, tell: found("here", [job])[0])
    monkeypatch.setattr(tune, "_in_parallel", in_parallel)
    monkeypatch.setattr(tune, "score", lambda *_, **__: result)
    monkeypatch.setattr(tune, "replace", lambda made, **changes: made)
    monkeypatch.setattr(tune, "TuningResult", lambda *parts: parts)
    assert tune.tune("four_mass", **given)[4] == 5 * given.get("starts", 1)
    assert set(routes) == {route}


def test_versions_are_those_of_the_scenario_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    known = {key: value for key, value in scenario_file.FROZEN.items() if key[0] == "four_mass"}
    monkeypatch.setattr(scenario_file, "FROZEN", known | {("other", 7): ("", "")})
    versions = ", ".join(str(number) for _, number in known)
    for given in ({"version": 7}, {"version": 0}):
        with pytest.raises(
            ArgumentError, match=f"version of four_mass: given .*, expected one of {versions}$"
        ):
            scenario("four_mass", **given)
    assert scenario("four_mass").version == max(number for _, number in known)


@pytest.mark.parametrize(
    ("size", "read"), [(0, True), (2**20 - 1, True), (2**20, False), (-1, False)]
)
def test_messages_of_a_process_have_less_than_a_mebibyte(size: int, read: bool) -> None:
    """The words with which it begins, and reports on robots that failed (which are not empty)."""
    asked: list[int] = []

    def exchange(sent: bytes, count: int) -> bytes:
        asked.append(count)
        return (
            struct.pack("=q", size)
            if count == 8
            else b""
            if not sent
            else struct.pack("=qd", size, 7.5)
        )

    made = object.__new__(ForeignController)
    vars(made).update(
        _failure="", _process=SimpleNamespace(poll=lambda: None), _load={}, name="mine"
    )
    vars(made).update(
        _exchange=exchange, _describe_end=lambda: "ended", step_s=1.0, total_s=9.0, used_s=0.0
    )
    setup = SimpleNamespace(n_a=2, n_y=2, n_ref=2, sample_s=1e-3, q_m=np.zeros((1, 2)))
    if read:
        made._begin(setup)
    else:
        with pytest.raises(ArgumentError, match="controller mine: ended before it began"):
            made._begin(setup)
    assert asked == [8, size] if read else [8]
    asked.clear()
    errors: dict[int, str] = {}
    made._store_errors = lambda found, errors, size: found is not None
    answer = made._ask(b"now", 8, errors)
    assert asked == [16, size][: 1 + (read and size > 0)]
    assert answer == (struct.pack("=d", 7.5) if read else None)


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"evaluations": 0}, "evaluations: given 0, expected 1 to 20000"),
        ({"evaluations": 20_001}, "evaluations: given 20001"),
        ({"starts": 1001}, "starts: given 1001, expected 1 to 1000"),
        ({"workers": 513}, "workers: given 513, expected 1 to 512"),
        ({"executor": 5}, "executor: given 5, expected an object with submit"),
    ],
)
def test_wrong_arguments_of_tuning(given: dict, text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        tune.tune("four_mass", **given)
