"""The status of a fit of recorded motions: by the whiteness of its residuals and by recordings
that were not fitted.

The recordings are simulated here, by an integrator of two masses that shares no code with flexgen.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from flexgen.cli.main import main
from flexgen.identification.motions.motion_fit import MotionFit, fit_motion
from flexgen.identification.responses.result import FitStatus

BENCH = Path(__file__).resolve().parents[2] / "examples" / "motor_bench" / "bench.toml"
T = 4e-4
STEPS = 2
SAMPLES = 1500
# as in the file
J_M = 3e-3
J_L = 4e-3
VISCOUS = 1e-2
FREE = ["stiffness", "damping"]
DESCRIPTION = """\
model = "bench.toml"
hold = "zoh"
[time]
name = "t"
unit = "s"
[[torque]]
motor = "m1"
name = "tau"
unit = "N m"
side = "motor"
[[angle]]
motor = "m1"
name = "q"
unit = "rad"
side = "motor"
[[recording]]
file = "run.npz"
"""


def recorded(
    folder: Path,
    k: float,
    seed: int,
    *,
    coulomb: float = 0.0,
    clamp: float = 0.0,
    noise: float = 2e-4,
    size: float = 1.0,
) -> Path:
    """A motion of two masses: spring k, Coulomb friction of the load, a spring that clamps the
    motor, encoder noise.
    """
    rng = np.random.default_rng(seed)
    t = T * np.arange(SAMPLES)
    hz = np.arange(3.0, 120.0, 6.0)
    tau = size * np.sin(2 * np.pi * hz * t[:, None] + rng.uniform(0, 6.3, len(hz))).sum(axis=1)

    def rate(x: np.ndarray, torque: float) -> np.ndarray:
        q, p, v, w = x
        spring = k * (q - p) + 0.05 * (v - w)
        return np.array(
            [
                v,
                w,
                (torque - spring - clamp * q - VISCOUS * v) / J_M,
                (spring - coulomb * np.tanh(w / 0.1)) / J_L,
            ]
        )

    x = np.zeros(4)
    angle = np.empty(SAMPLES)
    h = T / STEPS
    for n, torque in enumerate(tau):
        angle[n] = x[0]
        for _ in range(STEPS):
            a = rate(x, torque)
            b = rate(x + h / 2 * a, torque)
            c = rate(x + h / 2 * b, torque)
            x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c, torque))
    folder.mkdir()
    (folder / "bench.toml").write_text(BENCH.read_text())
    (folder / "run.toml").write_text(DESCRIPTION)
    np.savez(folder / "run.npz", t=t, tau=tau, q=angle + noise * rng.standard_normal(SAMPLES))
    return folder / "run.toml"


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, MotionFit]:
    """Fits of a robot that is as the model, of one with friction that the model lacks, and others
    held out.
    """
    folder = tmp_path_factory.mktemp("runs")
    first = recorded(folder / "first", 330.0, 0)
    same = recorded(folder / "same", 330.0, 1, size=0.5)
    rough = recorded(folder / "rough", 330.0, 0, coulomb=1.0)
    softer = recorded(folder / "softer", 250.0, 1)

    def fit(path: Path, validate: Path | None = None) -> MotionFit:
        return fit_motion(None, path, free=FREE, segment_s=0.05, validate=validate, progress=False)

    return {"right": fit(first, same), "friction": fit(rough), "other robot": fit(first, softer)}


def test_white_residuals_and_equal_errors_elsewhere_are_fitted(fits: dict[str, MotionFit]) -> None:
    found = fits["right"]
    assert found.status == FitStatus.FITTED and min(found.white) >= 0.85
    deviation = found.sd["q1.stiffness"]
    assert (
        deviation is not None and abs(np.log(found.values["q1.stiffness"] / 330.0)) < 4 * deviation
    )


def test_residuals_that_are_not_white_are_a_model_error(
    fits: dict[str, MotionFit], tmp_path: Path
) -> None:
    """Friction that the model lacks: the fit explains most of the motion, but the residual is not
    noise.
    """
    found = fits["friction"]
    assert min(found.fit_percent) > 60 and max(found.white) < 0.5
    assert found.status == FitStatus.MODEL_ERROR and set(found.sd.values()) == {None}
    assert "model error, no standard deviations" in found.write(tmp_path / "new.toml").read_text()


def test_recordings_that_the_model_does_not_predict_are_a_poor_validation(
    fits: dict[str, MotionFit],
) -> None:
    """A stiffness 24 % smaller in the other recording; the fitted one is explained within its
    noise.
    """
    found = fits["other robot"]
    assert (
        min(found.white) >= 0.85
        and found.held_out_percent[0] < fits["right"].held_out_percent[0] - 1
    )
    assert found.status == FitStatus.POORLY_VALIDATED and found.covariance is None


def test_a_held_out_fit_of_minus_thousands_of_percent_forbids_the_new_file(
    fits: dict[str, MotionFit], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A brake that clamps the motor in the other recording, which the model lacks: it predicts far
    larger motions.
    """
    run = recorded(tmp_path / "run", 330.0, 0)
    clamped = recorded(tmp_path / "clamped", 330.0, 1, clamp=3e4, noise=1e-6)
    words = [
        "identify",
        str(run.parent / "bench.toml"),
        str(run),
        "--segments",
        "0.05",
        "--free",
        "stiffness,damping",
    ]
    words += ["--validate", str(clamped)]
    main([*words, "-q"])
    said = capsys.readouterr().out
    assert (
        "poorly validated" in said
        and "Do not use the new model file" in said
        and "Use the new" not in said
    )
    assert main([*words, "--json", "-q"]) in (0, 1)
    found = json.loads(capsys.readouterr().out)
    assert min(found["held_out_percent"]) < -1000 and min(found["fit_percent"]) > 98
    assert found["status"] == "poorly validated" and {
        row["sd"] for row in found["parameters"]
    } == {None}
    # the same recording, validated by one of the same robot
    assert fits["right"].status == FitStatus.FITTED
