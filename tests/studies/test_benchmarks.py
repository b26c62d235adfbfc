"""The benchmarks of controllers: plants, scores, frozen files, refusals, tuning."""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from measured_numbers import check_numbers
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.feedback.loop.controllers import Cascade
from flexgen.model.position_servo.filters import LowPass
from flexgen.studies.scenarios import scenario_file as scenarios
from flexgen.studies.scenarios.leaderboard import find_shipped_controllers
from flexgen.studies.scenarios.measures import compute_measures, measures_of
from flexgen.studies.scenarios.scenario import FROZEN, NAMES
from flexgen.studies.scenarios.scenario_file import FOLDER, scenario
from flexgen.studies.scenarios.tune import numbers_of

pytestmark = needs_compiler


def test_the_plant_is_the_published_equations():
    """The four masses on the motor side, written by hand from the published values; 1e-12 of the
    largest term.
    """
    J_m = 5e-3
    J1 = 2e-3
    J2 = 0.02
    J3 = 0.02
    f_m = 6e-3
    f_a = 1e-3
    d1 = 0.08
    d2 = 0.06
    d3 = 0.08
    k2 = 110.0
    k3 = 80.0
    low = 16.7
    high = 100.0
    at = 0.064
    n = 220.0
    s = scenario("four_mass")
    forward = derive(s.model).function("forward_dynamics")
    rng = np.random.default_rng(0)
    for size in (1e-2, 1.0):
        q = size * rng.normal(size=4)
        v = size * rng.normal(size=4)
        tau = rng.normal()
        twist = q[0] - q[1]
        gear = (
            low * twist
            if abs(twist) < at
            else low * at * np.sign(twist) + high * (twist - at * np.sign(twist))
        )
        t1 = gear + d1 * (v[0] - v[1])
        t2 = k2 * (q[1] - q[2]) + d2 * (v[1] - v[2])
        t3 = k3 * (q[2] - q[3]) + d3 * (v[2] - v[3])
        expected = np.array(
            [
                (tau - f_m * v[0] - t1) / J_m,
                (t1 - t2 - f_a * v[1]) / J1,
                (t2 - t3 - f_a * v[2]) / J2,
                (t3 - f_a * v[3]) / J3,
            ]
        )
        # absolute on the motor side -> relative, arm side
        to_arm = np.array([[1, 0, 0], [-1, 1, 0], [0, -1, 1]]) / n
        a_a, a_m = forward(to_arm @ q[1:], to_arm @ v[1:], q[:1], v[:1], tau)
        found = np.concatenate([a_m.full().ravel(), np.linalg.solve(to_arm, a_a.full().ravel())])
        assert np.allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


PUBLISHED = {  # scores of version 1 as they were published, all digits
    ("four_mass", "reference"): 1.0228356869348882,
    ("four_mass", "ppi"): 0.7995028329297609,
    ("four_mass", "ppi_notch"): 0.7955469263730424,
    ("four_mass", "ppi_two_notches"): 0.7284630215901492,
    ("four_mass", "h_infinity"): 2.7046529349902158,
    ("two_link", "reference"): 1.0307376377507733,
    ("two_link", "ppi"): 0.3414117253601562,
    ("two_link", "ppi_notch"): 0.33261054345278696,
    ("two_link", "ppi_two_notches"): 0.3306943880750516,
    ("two_link", "lqg"): 0.37712830027067346,
    ("two_link", "h_infinity"): 1.7212692058012808,
}


def test_version_1_has_its_published_score_and_hash():
    """1e-12; 1e-6 under halved steps."""
    found = flexgen.score("four_mass", version=1, progress=False)
    assert found.total == pytest.approx(PUBLISHED["four_mass", "reference"], abs=1e-12)
    assert (
        found.scenario.digest.startswith("6c9c55b8edde")
        and found.scenario.frozen
        and np.isnan(found.spread)
    )
    assert 0 < found.wall_s < 600
    check_numbers("score", found=found.to_dict())
    finer = flexgen.score("four_mass@1", steps=2, progress=False)
    assert abs(
        finer.total - found.total
    ) < 1e-6 and "not the published score: 2 integration steps" in str(finer)


@pytest.mark.slow
def test_all_published_scores_of_version_1():
    # without AVX-512 numpy rounds otherwise: up to 4e-12
    for (name, controller), total in PUBLISHED.items():
        assert flexgen.score(name, controller, version=1, progress=False).total == pytest.approx(
            total, abs=1e-11
        )
    assert not flexgen.score("four_mass", "lqg", version=1, progress=False).accepted


@pytest.mark.slow
@pytest.mark.parametrize(("name", "best"), [("four_mass", 0.73), ("two_link", 0.31)])
def test_the_best_controllers_that_come_with_it(name, best):
    """No margin against a larger gain: LQG of four_mass always, H-infinity in some draws."""
    found = {}
    for controller in find_shipped_controllers(name):
        found[controller] = flexgen.score(name, controller, progress=False)
    assert len(found) == 5 and min(s.total for s in found.values() if s.accepted) <= best
    refused = [key for key, s in found.items() if not s.accepted]
    assert refused == (["h_infinity", "lqg"] if name == "four_mass" else [])


def test_measures_of_a_known_signal():
    s = scenario("four_mass", 1)
    n = round(s.duration_s / s.sample_s)
    t = s.sample_s * np.arange(n)
    # 1 mm, then 0.1 mm after 0.5 ln 10 s
    z = np.where((t >= 1) & (t < 5), np.exp(-(t - 1) / 0.5), 0.0)[:, None]
    z[(t >= 9) & (t < 17), 0] = 2 * np.sin(2 * np.pi * t[(t >= 9) & (t < 17)])
    u = 3 * np.ones((n, 1))
    u[t >= 34, 0] += np.sin(40 * t[t >= 34])
    values = dict(
        zip([m.name for m in measures_of(s)], compute_measures(s, s.windows, z, u), strict=True)
    )
    assert values["motor step, peak to peak"] == pytest.approx(1.0, abs=1e-3)
    # it settles to 3e-4 mm
    assert values["motor step, settling time"] == pytest.approx(0.5 * np.log(10), abs=5e-3)
    assert values["motor chirp, RMS"] == pytest.approx(np.sqrt(2), rel=1e-3)
    assert values["noise, torque, peak to peak"] == pytest.approx(2.0, rel=1e-3)
    assert values["whole run, largest torque"] == pytest.approx(4.0, rel=1e-3)
    assert sum(m.weight for m in measures_of(s)) == pytest.approx(1.0)


def test_a_changed_file_is_refused(tmp_path, monkeypatch):
    text = (FOLDER / "four_mass-2.toml").read_text().replace("size = 4.0", "size = 3.0")
    (tmp_path / "four_mass-2.toml").write_text(text)
    other = scenario(tmp_path / "four_mass-2.toml")
    assert not other.frozen and "not a published version" in other.title_line
    monkeypatch.setattr(scenarios, "FOLDER", tmp_path)
    with pytest.raises(
        ArgumentError, match="the benchmark's file or its model was changed; scores with it"
    ):
        scenario("four_mass")
    assert set(FROZEN) == {(name, version) for name in NAMES for version in (1, 2)}


def test_a_refused_controller_has_no_score():
    """Too much gain: stable nominally, not with 2.5 times as much; no number of the score is shown
    anywhere.
    """
    hot = Cascade(np.array([12.0]), np.array([4.0]), np.array([6.0]), (LowPass(150.0, 1.0),))
    found = flexgen.score("four_mass", hot, version=1, progress=False)
    assert not found.accepted and np.isnan(found.total) and found.parts == {}
    assert "score" not in found.to_dict() and "measures" not in found.to_dict()
    assert "refused, no score" in str(found) and "V =" not in str(found)
    json.dumps(found.to_dict())


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ("format = 1", "format = 3", ":2:format: given 3, expected one of 1, 2"),
        (
            'where = "m1"\nsize = 4.0',
            'where = "m7"\nsize = 4.0',
            'where: given "m7", expected one of m1',
        ),
        (
            "length_s = 0.02",
            "length_s = 90.0",
            "start_s: given .* expected one that ends within 36 s",
        ),
        (
            "start_s = 9.0",
            "start_s = 5.01",
            "expected one that does not overlap motor pulse on m1",
        ),
        ("window_s = [34.0, 36.0]", "window_s = [34.0, 37.0]", "two increasing times within 36 s"),
        (
            "weights = { peak = 1.0",
            "weights = { peek = 1.0",
            "given an unknown key, expected peak",
        ),
        ("sets = [0.3, 0.2]", "sets = [0.5]", "a list of 2 numbers"),
        ("delay_s = 5e-4", "delay_s = 7e-4", "a multiple of the sample time"),
        ('names = ["mass2.inertia_zz"]', 'names = ["mass9.inertia_zz"]', "mass9.inertia_zz"),
        ("torque_max_Nm = [20.0]", "torque_max_Nm = [20.0, 3.0]", "one for each of the motors"),
        (
            'type = "cascade"',
            'type = "fuzzy"',
            'reference.type: given "fuzzy", expected one of cascade, computed_torque, ',
        ),
        ("[score]", "[score", "text that is not TOML"),
    ],
)
def test_wrong_scenarios_are_refused(tmp_path, before, after, words):
    text = (FOLDER / "four_mass-1.toml").read_text()
    assert before in text
    (tmp_path / "mine.toml").write_text(text.replace(before, after, 1))
    with pytest.raises(ArgumentError, match=words):
        scenario(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            'type = "cascade"\nposition_gain = [1]\nspeed_gain = [1, 2]\nintegral_gain = [1]',
            "3:speed_gain: given .*, expected a list of 1 number .one for each motor",
        ),
        ('type = "ppi"\nspeed_hz = "fast"', '2:speed_hz: given "fast"'),
        ('type = "ppi"\nspeed = 3', "2:speed: given an unknown key, expected speed_hz"),
        (
            'type = "ppi"\n[[notch]]\nzero_damping = 1',
            "frequency_hz: given nothing, expected a number > 0",
        ),
        (
            'type = "linear"\nA = [[1]]\nB = [[1]]\nC = [[1]]',
            "D: given nothing, expected a matrix",
        ),
        (
            'type = "linear"\nA = [[1, 2]]\nB = [[1]]\nC = [[1]]\nD = [[1]]',
            r"2:A: given shape \(1, 2\), expected \(1, 1\)",
        ),
    ],
)
def test_wrong_controller_files_are_refused(tmp_path, text, words):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ArgumentError, match=words):
        flexgen.score("four_mass", str(path), version=1, progress=False)


@pytest.mark.slow
def test_tuning_improves_and_writes_what_it_found(tmp_path):
    found = flexgen.tune("four_mass", version=1, evaluations=12, progress=False)
    assert found.score.accepted and found.score.total < found.start.total - 0.02
    assert list(found.history) == sorted(found.history, reverse=True)
    again = flexgen.score("four_mass@1", str(found.save(tmp_path / "mine.toml")), progress=False)
    assert again.total == found.score.total
    with pytest.raises(ArgumentError, match="evaluations: given 0"):
        flexgen.tune("four_mass", evaluations=0)
    with pytest.raises(
        ArgumentError, match="executor: given 'me', expected an object with submit"
    ):
        flexgen.tune("four_mass", executor="me")
    with pytest.raises(ArgumentError, match="given Linear, expected a P-PI cascade"):
        flexgen.tune("two_link", "lqg")


@pytest.mark.slow
def test_a_page_of_a_score(tmp_path):
    page = flexgen.score("four_mass", "ppi", progress=False).report(tmp_path / "page").read_text()
    assert (
        "<td>score V</td><td>0.7" in page
        and "Published:" in page
        and "Rule: A score is the mean over the draws." in page
    )
    assert (
        "<td>worst draw</td><td>0." in page
        and "standard deviation of the draws" in page
        and (tmp_path / "page" / "score.png").exists()
    )


@pytest.mark.slow
def test_starts_are_tuned_by_any_executor():
    """Starts tuned in threads have the result of starts tuned in sequence; the second start is
    another one.
    """
    alone = flexgen.tune("four_mass", version=1, evaluations=6, starts=2, progress=False)
    with ThreadPoolExecutor(2) as executor:
        shared = flexgen.tune(
            "four_mass", version=1, evaluations=6, starts=2, executor=executor, progress=False
        )
    assert shared.score.total == alone.score.total and shared.evaluations == alone.evaluations
    assert np.array_equal(numbers_of(shared.controller), numbers_of(alone.controller))
