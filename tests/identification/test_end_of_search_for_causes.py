"""A search for hidden causes that the end of the time ends: its fit is not confirmed."""

from __future__ import annotations

from typing import Any

import pytest

import flexgen
from flexgen.base.calls.deadline import OutOfTime
from flexgen.identification.estimator.status import FitStatus
from flexgen.identification.responses import graybox


@pytest.fixture(scope="module")
def responses() -> Any:
    """Frequency responses of an arm: without noise, no cause is searched."""
    drives = flexgen.DriveHardware(encoder_noise_rad=1e-5, torque_noise_Nm=0.02)
    plan = flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10, hardware=drives)
    robot = flexgen.read("elbow", overrides={"element.upper.dof.q1.gear.spring.stiffness": 6e6})
    return flexgen.frf(flexgen.measure(plan, robot))


def test_a_verdict_without_all_causes_is_not_fitted(
    responses: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_cause(residuals: Any, x: Any) -> tuple[Any, ...]:
        return ()

    def out_of_time(residuals: Any, x: Any) -> tuple[Any, ...]:
        raise OutOfTime("causes")

    monkeypatch.setattr(graybox, "hidden_causes", no_cause)
    whole = flexgen.identify("elbow", responses, starts=1)
    assert whole.status is FitStatus.FITTED
    monkeypatch.setattr(graybox, "hidden_causes", out_of_time)
    ended = flexgen.identify("elbow", responses, starts=1, time_limit=100.0)
    assert ended.status is FitStatus.TIME_LIMIT
    assert ended.values == whole.values
