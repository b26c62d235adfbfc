"""Small parts by hand: corners, describing functions, compliances, bodies, places of a force,
speeds and tables.
"""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import quad
from scipy.interpolate import PPoly
from scipy.optimize import brentq
from scipy.stats import norm, rayleigh

import flexgen
from flexgen.analysis.compliance import ToolCompliance
from flexgen.base.errors import ArgumentError
from flexgen.base.spec import schema
from flexgen.identification.responses.describing_functions import (
    average_coulomb,
    average_hysteresis,
    average_spring,
)
from flexgen.identification.rigid import feasible_bodies
from flexgen.inversion import hold
from flexgen.inversion.judge.status import Status
from flexgen.model.elements import Body
from flexgen.paths.accuracy.corners import Corner, corner_figures
from flexgen.paths.force import place_force, tool_force
from flexgen.planning.fastest.stated_speeds import StatedSpeeds, stated_speeds


def test_figures_of_a_corner_by_hand() -> None:
    """Two robots around a right angle: how far they pass it, and how far they get beyond the
    second line.
    """
    corner = Corner(np.array([1.0, 2.0]), np.array([1.0, 0.0]), np.array([0.0, 1.0]), 1.0, 3.0)
    time = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    reference = np.array([[9.0, 9.0], [0.0, 2.0], [1.0, 2.1], [1.0, 3.0], [9.0, 9.0]])
    first = np.array([[9.0, 9.0], [0.0, 2.0], [1.3, 2.4], [1.0, 3.0], [9.0, 9.0]])
    second = np.array([[1.0, 2.0], [0.0, 2.0], [0.5, 2.5], [0.9, 3.0], [1.0, 2.0]])
    found = corner_figures([corner], time, reference, np.array([first, second]))

    def nearest(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> float:
        parts = []
        for p, q in ((a, b), (b, c)):
            s = np.clip(-(p - corner.point) @ (q - p) / ((q - p) @ (q - p)), 0.0, 1.0)
            parts.append(float(np.linalg.norm(p + s * (q - p) - corner.point)))
        return min(parts)

    assert found["corner_round_off"] == pytest.approx(
        max(nearest(*first[1:4]), nearest(*second[1:4]))
    )
    assert found["corner_round_off_commanded"] == pytest.approx(nearest(*reference[1:4]))
    assert found["corner_overshoot"] == pytest.approx(0.3)  # not of the part along the second line
    assert corner_figures([], time, reference, first[None]) == {}
    assert corner_figures([corner], time, reference, second[None])["corner_overshoot"] == 0.0


@pytest.mark.parametrize("mean", [0.0, 0.8])
def test_springs_in_a_gaussian_motion_by_quadrature(mean: float) -> None:
    """The mean slope of ``d + d^3`` at the mean deflection that carries the torque, and what it
    leaves.
    """
    sd = 0.4
    N, left = average_spring(lambda d: d + d**3, np.array([mean]), np.array([sd]))
    at = brentq(lambda m: m + m**3 + 3 * m * sd**2 - mean, -3.0, 3.0)
    assert N[0] == pytest.approx(1 + 3 * (at**2 + sd**2), rel=1e-6)

    def rest(e: float) -> float:
        d = at + sd * e
        return float((d + d**3 - mean - N[0] * sd * e) ** 2 * norm.pdf(e))

    size = np.sqrt(quad(rest, -9.0, 9.0)[0])
    assert left[0] == pytest.approx(size / (N[0] * sd), rel=1e-4)


def test_frictions_in_a_gaussian_motion_by_quadrature() -> None:
    """Coulomb friction has the mean of ``|v|``; an element that slips the mean over Rayleigh's
    amplitudes.
    """
    assert average_coulomb(np.array([2.0]))[0] == pytest.approx(
        quad(lambda e: abs(e) * norm.pdf(e), -9, 9)[0] / 2.0
    )
    slip = 0.5
    sd = 0.8

    def element(A: float) -> complex:
        t = np.arccos(1 - 2 * slip / A) if slip < A else np.pi
        return complex((t - np.sin(2 * t) / 2 + 1j * np.sin(t) ** 2) / np.pi)

    def mean(part: str) -> float:
        total = quad(
            lambda A: A**2 * getattr(element(A), part) * rayleigh.pdf(A, scale=sd),
            0,
            7 * sd,
            points=[slip],
        )
        return float(total[0]) / (2 * sd**2)

    found = average_hysteresis(np.array([slip]), np.array([sd]))[0]
    assert_allclose([found.real, found.imag], [mean("real"), mean("imag")], rtol=2e-2, atol=2e-3)


def test_the_compliance_of_two_springs_by_hand() -> None:
    """A force moves the tool by the sum of both springs; its resonance is that of a damped
    mass.
    """
    J = np.zeros((6, 2))
    J[0] = (0.6, 0.8)
    J[2] = (0.8, -0.6)
    J[4] = (1.0, 0.0)
    made = ToolCompliance(np.diag([2.0, 2.0]), np.diag([0.4, 0.4]), np.diag([800.0, 200.0]), J)
    assert_allclose(
        made.matrix[:3:2, :3:2],
        [[0.36 / 800 + 0.64 / 200, 0.48 / 800 - 0.48 / 200]] * 1
        + [[0.48 / 800 - 0.48 / 200, 0.64 / 800 + 0.36 / 200]],
    )
    values, directions = made.principal()
    assert_allclose(values, [1 / 200, 1 / 800, 0.0], atol=1e-15)
    assert_allclose(directions[:2], [[0.8, 0.0, -0.6], [0.6, 0.0, 0.8]], atol=1e-12)
    assert_allclose(made.principal(rotation=True)[0], [1 / 800, 0.0, 0.0], atol=1e-15)
    w = 10.0
    assert abs(made.response(np.array([w / (2 * np.pi)]))[0, 4, 4]) == pytest.approx(
        1 / abs(800 - 200 + 4j)
    )
    peak = made.resonance()
    assert peak is not None
    natural = np.sqrt(200 / 2.0)
    ratio = 0.4 / (2 * np.sqrt(2 * 200.0))
    assert peak[0] == pytest.approx(natural * np.sqrt(1 - 2 * ratio**2) / (2 * np.pi), rel=1e-3)
    assert peak[1] == pytest.approx(1 / 200 / (2 * ratio * np.sqrt(1 - ratio**2)), rel=1e-3)
    ends = made.frequencies[[0, -1]] * 2 * np.pi
    assert_allclose(ends, [0.05 * 10.0, 3.0 * 20.0], rtol=1e-9)
    stiff = ToolCompliance(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((6, 0)))
    assert stiff.resonance() is None and not stiff.matrix.any()
    assert (
        stiff.to_dict()["resonance_hz"] is None and made.to_dict()["resonance_m_per_N"] == peak[1]
    )


def test_ten_numbers_of_a_body_and_back() -> None:
    """A cuboid away from its frame: Steiner's theorem, and a pseudo-inertia of the integrals of
    its points.
    """
    sides = np.array([0.2, 0.4, 0.6])
    com = np.array([0.1, -0.3, 0.2])
    mass = 6.0
    own = mass / 12 * np.diag((sides**2).sum() - sides**2)
    body = Body(mass, tuple(com.tolist()), tuple(map(tuple, own.tolist())))
    numbers = feasible_bodies.numbers_of(body)
    second = mass * (np.diag(sides**2) / 12 + np.outer(com, com))  # int r r' dm
    inertia = np.trace(second) * np.eye(3) - second
    assert_allclose(numbers[:4], [mass, *(mass * com)])
    assert_allclose(
        numbers[4:], [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))]
    )
    P = feasible_bodies.pseudo_inertia(numbers)
    assert_allclose(
        P, np.block([[second, mass * com[:, None]], [mass * com[None], np.array([[mass]])]])
    )
    again = feasible_bodies.body_of(numbers)
    assert again.mass == mass and np.allclose(again.com, com) and np.allclose(again.inertia, own)
    made = feasible_bodies.Feasible(2)
    both = np.concatenate([numbers, 2 * numbers])
    x = made.x(both)
    assert_allclose(made.pi(x), both, rtol=1e-9, atol=1e-12)
    slopes = np.stack(
        [(made.pi(x + d) - made.pi(x - d)) / 2e-6 for d in 1e-6 * np.eye(20)], axis=1
    )
    assert_allclose(made.jacobian(x), slopes, atol=1e-6)
    flat = np.array([1.0, 0, 0, 0, 1.0, 1.0, 2.5, 0, 0, 0])  # no body has these moments
    assert (
        np.linalg.eigvalsh(feasible_bodies.pseudo_inertia(made.pi(made.x(np.tile(flat, 2)))[:10]))[
            0
        ]
        > 0
    )
    length = np.sqrt(numbers[4:7].sum() / (2 * mass))
    assert_allclose(
        feasible_bodies.scales(numbers), [mass, *[mass * length] * 3, *[mass * length**2] * 6]
    )


class Law:
    """A time law: ``s = v t`` up to its duration."""

    def __init__(self, speed: float, duration: float) -> None:
        self.speed = speed
        self.duration = duration

    def __call__(self, t: np.ndarray, order: int) -> np.ndarray:
        at = np.clip(t, 0.0, self.duration)
        return np.stack(
            [self.speed * at, np.where((t > 0) & (t < self.duration), self.speed, 0.0)], axis=1
        )


def test_places_on_a_path_count_its_motions() -> None:
    """Within each the part of its path parameter; a pause between two of them is one place."""
    segments = [Made(law=Law(2.0, 0.5), start=0.0), Made(law=Law(0.5, 2.0), start=1.0)]
    path: Any = Made(segments=segments)
    assert_allclose(
        place_force.places(path, np.array([0.0, 0.25, 0.5, 0.8, 1.0, 2.0, 3.0, 9.0])),
        [
            0.0,
            0.5,
            1.0,
            1.0,
            1.0,
            1.5,
            2.0,
            2.0,
        ],
    )
    force: Any = Made(at=lambda s: np.outer(s, np.arange(6.0)))
    assert_allclose(
        place_force.force_along(force, path)(np.array([0.25, 2.0])),
        np.outer([0.5, 1.5], np.arange(6.0)),
    )
    curve = PPoly(np.ones((1, 2, 6)) * np.array([3.0, 5.0])[:, None], [0.0, 1.0, 2.0])
    second = place_force.of_motion(Made(curve=curve), 1)  # type: ignore[arg-type]
    assert second is not None and place_force.of_motion(None, 1) is None
    assert_allclose(second.at(np.array([0.5]))[0], 5.0)
    samples = np.outer(np.arange(8.0) ** 2, np.ones(6))
    held = tool_force.interpolate_force(np.arange(7.0), samples)
    assert_allclose(held([2.5])[0], 6.25)
    assert_allclose(held([6.0, 7.5, 100.0])[:, 0], 36.0)
    data = {"force": samples}
    given: Any = Made(
        **{"labels": {"force": tool_force.LABELS}, "units": {"force": tool_force.UNITS}}
    )
    others = (("labels", tuple("abcdef")), ("units", ("N",) * 6), (None, None))
    for name, value in others:
        table: Any = type("Data", (dict,), {})(data)
        table.labels = given.labels
        table.units = given.units
        if name is None:
            assert_array_equal(tool_force.read_force(table), samples)
            continue
        setattr(table, name, {"force": value})
        with pytest.raises(
            ArgumentError,
            match=r"channel force(: given columns a, .* fx, fy|, column mx: given 'N', a f)",
        ):
            tool_force.read_force(table)


def test_speeds_over_stated_ones_by_hand() -> None:
    """At points of the path, whatever the time; groups of steps end where the path stops."""
    points = StatedSpeeds(np.array([0.2, 0.5, 0.9]), np.array([2.0, 4.0, 8.0]))
    assert_allclose(points.parts(Law(3.0, 1 / 3)), [1.5, 0.75, 0.375])  # type: ignore[arg-type]
    assert points.of(Made(curve="other"), (1.0,), 0.5).s.size == 0  # type: ignore[arg-type]
    assert StatedSpeeds(np.zeros(0), np.zeros(0)).parts(Law(3.0, 1.0)).size == 0
    legs = [Made(speed=s, zone=z) for s, z in ((1.0, 0.1), (None, 0.0), (0.5, 0.0), (2.0, 0.3))]
    assert stated_speeds(Made(legs=legs)) == [(1.0, None), (0.5,)]  # type: ignore[arg-type]
    assert stated_speeds(Made(legs=[])) == [()]  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("worst", "before", "status"),
    [
        (1e-4, Status.SOLVED, Status.SOLVED),
        (1.01e-4, Status.SOLVED, Status.TOLERANCE_NOT_MET),
        (1.0, Status.BASELINE, Status.BASELINE),
    ],
)
def test_a_hold_that_makes_the_output_deviate_is_told(
    worst: float, before: Status, status: Status, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the error of the output, or that from the plan; the default hold sends the samples as
    they are.
    """
    told: list[str] = []
    problem: Any = Made(accuracy=1e-4, log=told.append)
    run = Made(tool_error_max_m=2e-3, tool_error_max_rad=None)
    monkeypatch.setattr(hold, "replace", lambda thing, **more: Made(**(vars(thing) | more)))
    monkeypatch.setattr(
        hold, "torque_command", lambda trajectory, given: Made(title=lambda: "zero-order hold")
    )
    solution: Any = Made(trajectory=None, simulation=1, status=before, warnings=("a",))
    for plan_error, size in ((None, "2 mm"), ((3e-3, None), "3 mm")):
        checked = Made(worst=worst, simulation=run, plan_error=plan_error)
        monkeypatch.setattr(hold, "verify_by_simulation", lambda *given, checked=checked: checked)
        given: Any = Made(command="torque", is_default=False)
        found: Any = hold.with_hold(problem, solution, given)
        assert found.status is status and found.held_simulation is run
        text = (
            f"the zero-order hold makes the output deviate by {size}, more than the accuracy "
            "0.0001; use a shorter "
        )
        assert found.warnings == ("a",) or (
            status is Status.TOLERANCE_NOT_MET
            and found.warnings == ("a", text + "sample time or a linear hold")
        )
        assert (len(found.warnings) == 2) == (status is Status.TOLERANCE_NOT_MET)
    assert told == ["verifying the torques of the controller: zero-order hold"] * 2
    default: Any = hold.with_hold(problem, solution, Made(command="torque", is_default=True))
    assert vars(default) == vars(solution)
    solution.simulation = None
    unchecked: Any = hold.with_hold(problem, solution, Made(command="torque", is_default=False))
    assert unchecked.torque_command.title() == "zero-order hold" and not hasattr(
        unchecked, "held_simulation"
    )


def test_objects_are_written_without_their_defaults() -> None:
    """Tables in tables, one or several; other names of the keys and values as they are written."""

    def key(field: str, default: Any, form: Any = None, many: bool = False, most: int = 0) -> Any:
        kind = Made(
            form=form,
            many=many,
            most=most,
            write=lambda x: x if isinstance(x, dict | list) else f"<{x}>",
        )
        return Made(field=field, names=(f"{field}_name", "old"), default=default, type=kind)

    inner: Any = Made(keys=[key("b", 0)], take=lambda value: {"b": value})
    outer: Any = Made(
        keys=[
            key("a", 1),
            key("c", None, inner),
            key("d", None, inner, many=True),
            key("e", None, inner, most=3),
            key("f", 2),
        ],
        take=lambda value: value,
    )
    assert schema.write(lambda: outer, {"a": 1, "f": 2}) == {}
    assert schema.write(outer, {"a": 5, "c": 7, "d": (0, 8), "e": 9, "f": None}) == {
        "a_name": "<5>",
        "c_name": {"b_name": "<7>"},
        "d_name": [{}, {"b_name": "<8>"}],
        "e_name": {"b_name": "<9>"},
    }
    assert schema.write(outer, {"e": (4, 5)}) == {"e_name": [{"b_name": "<4>"}, {"b_name": "<5>"}]}


def test_poses_of_trackers_without_sag_are_those_of_the_arm() -> None:
    """``x = l1 sin q1 + l2 cos(q1 + q2)``, ``z = l1 cos q1 - l2 sin(q1 + q2)``: the tool of the
    elbow.
    """
    q = np.array([[0.3, -0.4], [0.1, 0.7]])
    found = flexgen.tracker_positions("elbow", q, sag=False)
    total = q.sum(axis=1)
    assert_allclose(found[:, 0, 0], 1.15 * np.sin(q[:, 0]) + 1.241 * np.cos(total))
    assert_allclose(found[:, 0, 2], 1.15 * np.cos(q[:, 0]) - 1.241 * np.sin(total))
    for bad, text in (
        ([[0.1]], r"given shape \(1, 1\)"),
        ([[0.1], [0.1, 2]], "given .*rows of the same length"),
    ):
        with pytest.raises(ArgumentError, match=f"commands: {text}"):
            flexgen.tracker_positions("elbow", bad)
