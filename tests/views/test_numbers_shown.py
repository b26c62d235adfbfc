"""Lines of figures of runs, and poses at which a loop is said to be unstable."""

from __future__ import annotations

from types import SimpleNamespace as Made
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from flexgen.base.errors import ArgumentError
from flexgen.feedback.laws import stability
from flexgen.views.plots import along_path, control

TIME = np.linspace(-1.0, 3.0, 41)


def run_of(**more: Any) -> Any:
    """Two robots that run, and one that fails."""
    wave = np.sin(TIME)
    contact = np.outer(wave, [3.0, 0.0, -4.0])
    runs = [
        Made(
            name="a",
            failure="",
            contact=contact,
            size=1e-3 * np.abs(wave),
            tau_m=np.outer(wave, [1.0, 2.0]),
        ),
        Made(name="b", failure="unstable at 1 s", contact=contact, size=None),
        Made(name="c", failure="", contact=None, size=2e-3 * np.abs(wave)),
    ]
    force = np.zeros((41, 6))
    force[:, 1] = wave
    fields: dict[str, Any] = {
        "runs": runs,
        "nominal": runs[0],
        "distance": lambda one: one.size,
        "unit": "m",
    }
    fields |= {
        "model": Made(title="arm", motors=[Made(name="m1"), Made(name="m2")]),
        "controller": "pd",
    }
    fields |= {
        "reference": Made(time=TIME, begin=0.0, path_end=2.0),
        "solution": Made(move=Made(name="line")),
    }
    fields |= {"force": force, "assumed_force": 0.5 * force}
    return Made(**(fields | more))


def shown(axes: Any) -> dict[str, np.ndarray]:
    return {str(line.get_label()): np.asarray(line.get_ydata()) for line in axes.lines}


def test_a_run_is_shown_with_its_errors_torques_and_forces() -> None:
    """Robots that fail are named without a line; forces of a wall have their size."""
    figure = control.plot_control(run_of())
    top, bottom, force, wall = figure.axes
    wave = np.sin(TIME)
    lines = shown(top)
    assert (
        list(lines) == ["a", "b: unstable at 1 s", "c"] and len(lines["b: unstable at 1 s"]) == 0
    )
    assert_allclose(lines["a"], np.abs(wave))
    assert_allclose(lines["c"], 2 * np.abs(wave))
    assert top.get_ylabel() == "output error, mm" and len(top.collections) == 1
    assert_allclose(shown(bottom)["m2"], 2 * wave)
    assert list(shown(force)) == ["$f_y$", "$f_y$, assumed"] or len(force.lines) == 2
    assert_allclose([line.get_ydata()[5] for line in force.lines], [wave[5], 0.5 * wave[5]])
    assert force.get_ylabel() == "force, N" and list(shown(wall)) == ["a"]
    assert_allclose(shown(wall)["a"], 5.0 * np.abs(wave))
    assert (
        top.get_xlim() == pytest.approx((-0.2, 3.0))
        and wall.get_xlabel() == "time, s (grey: path)"
    )
    assert figure.get_size_inches()[1] == pytest.approx(5.4 + 2 * 1.8)
    given = run_of()
    given.force[:, 4] = 1.0
    assert control.plot_control(given).axes[2].get_ylabel() == "force, N; moment, N m"


def test_a_run_without_forces_has_two_axes() -> None:
    """Of one robot that runs there is no range."""
    given = run_of(force=None)
    given.runs = given.runs[:1]
    given.runs[0].contact = None
    figure = control.plot_control(given)
    assert len(figure.axes) == 2 and figure.get_size_inches()[1] == pytest.approx(5.4)
    assert len(figure.axes[0].collections) == 0


def test_errors_of_methods_begin_shortly_before_the_path(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six hundredths of its time; zeros are shown at half of the floor, a thousandth of the least
    error.
    """
    t = np.linspace(-0.5, 2.2, 28)
    sizes = {
        "lq": {"m": 1e-6 * np.linspace(0.0, 1.0, 28)},
        "bvp": {"m": np.full(28, 4e-6), "rad": np.full(28, 1e-5)},
    }
    solutions: Any = [
        Made(method=name, trajectory=Made(time=t), move=Made(name="line", duration=2.0))
        for name in sizes
    ]
    monkeypatch.setattr(along_path, "error_sizes", lambda solution: sizes[solution.method])
    model: Any = Made(title="arm")
    figure: Figure = along_path.errors_of_methods(model, solutions)
    first, second = figure.axes
    lines = shown(first)
    assert (
        list(lines)[:2] == ["lq: 1 µm", "bvp: 4 µm"]
        and next(iter(shown(second))) == "bvp: 10 µrad"
    )
    assert_allclose(lines["bvp: 4 µm"], 4.0)
    assert_allclose(lines["lq: 1 µm"], np.maximum(np.linspace(0.0, 1.0, 28), 0.5e-3))
    assert first.get_xlim() == pytest.approx((-0.12, 2.2)) and first.get_yscale() == "log"
    monkeypatch.setattr(along_path, "error_sizes", lambda solution: {})
    with pytest.raises(
        ArgumentError,
        match="given only solutions without verification, expected at least one with it",
    ):
        along_path.errors_of_methods(model, solutions)


@pytest.mark.parametrize(
    ("sizes", "instant"),
    [
        ([0.5, 0.999999, 0.2, 0.3, 0.4, 0.5, 0.6], None),
        ([0.5, 0.9, 1.0000001, 0.3, 0.4, 0.5, 0.6], "1 s"),
        ([2.0, 0.9, 0.3, 0.3, 0.4, 0.5, 1.5], "0 s"),
        ([0.5, 0.9, 0.3, 0.3, 0.4, np.nan, 1.5], "2.5 s"),
    ],
)
def test_the_worst_of_seven_poses_is_named(
    sizes: list[float], instant: str | None, monkeypatch: Any
) -> None:
    """Equally spaced from the start of the motion to its end; gains are those of the model's
    coordinates.
    """
    model = Made(n_a=1, dof=2)
    reference = Made(
        begin=4.0, end=7.0, time=np.arange(0.0, 10.0, 0.5), points=lambda k: (np.array([k]),)
    )
    motion: Any = Made(
        reference=reference, model=model, sample_s=2e-3, delay_s=1e-3, exact_state=False
    )
    asked = list[Any]()
    left = list(sizes)
    monkeypatch.setattr(stability, "motor_rows", lambda model: np.array([[0.0, 1.0]]))
    monkeypatch.setattr(stability, "PoseModels", lambda model: Made(at=lambda points: points))

    def eigenvalue(at: Any, *given: Any) -> float:
        asked.append(
            (int(at[0][0, 0]), *(x.tolist() if isinstance(x, np.ndarray) else x for x in given))
        )
        return left.pop(0)

    monkeypatch.setattr(stability, "pose_eigenvalue", eigenvalue)

    def check() -> None:
        stability.check_pose_loop(
            motion, lambda q: (np.array([[3.0, 5.0]]), np.array([[7.0, 9.0]])), "kp: given 1"
        )

    if instant is None:
        check()
    else:
        with pytest.raises(
            ArgumentError,
            match=f"unstable at the pose {instant} after the begin of the motion, at 2 ms",
        ):
            check()
    assert asked == [(k, [[3.0, 5.0]], [[7.0, 9.0]], 2e-3, 1e-3, True) for k in range(8, 15)]
