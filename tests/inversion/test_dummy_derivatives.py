"""Index reduction on a small robot: consistent values, choices of states, and IDAS."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from causal_cases import problem
from numpy.testing import assert_allclose, assert_array_equal

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.inversion.comparison import bdf, reduced
from flexgen.inversion.comparison.dummy_derivatives import DummyDerivatives

ELBOW = "elbow"


def test_the_reduced_system_has_consistent_values_and_a_good_choice_of_states() -> None:
    case = problem(ELBOW)
    dummies = DummyDerivatives(case.dae, *reduced.offsets(case.dae))
    assert dummies.freedom == 2 == sum(dummies.d) - sum(dummies.c) and dummies.orders == max(
        dummies.c
    )
    Y = dummies.at_rest(case.x_eq)
    x, dx = dummies.states_of(Y[None])
    assert_array_equal(x[0], case.x_eq)
    assert not dx.any() and dx.shape == (1, 10)
    t = 0.3
    U = case.dae.targets(case.path.sample(np.array([t])), dummies.orders)[0]
    choice = dummies.choose(Y, U)
    assert len(choice.states) == 2 and sorted(choice.states + choice.algebraic) == list(
        range(dummies.size)
    )
    assert_array_equal(np.array(choice.rates), np.array(choice.states) + 1)
    scale = dummies.scales(case.x_eq)
    size, torque, rate = case.dae.scales(case.x_eq)
    expected = [
        z * rate**r for z, k in zip([*size, *torque], dummies.d, strict=True) for r in range(k + 1)
    ]
    assert_allclose(scale, expected)
    found, count = dummies.consistent(choice, Y, U, scale)
    G, slope = (np.array(z) for z in dummies.system(found, U))
    assert np.abs(G[:, 0] / (np.abs(slope * scale).max(axis=1))).max() < 1e-12 and 2 <= count < 12
    assert_array_equal(found[list(choice.states)], Y[list(choice.states)])
    s = found[list(choice.states)]
    z = found[list(choice.algebraic)]
    ds, again = (np.array(v).ravel() for v in dummies.index_one(choice)(s, z, U))
    assert_array_equal(ds, found[list(choice.rates)])
    assert_array_equal(again, G[:, 0])
    quality = dummies.quality(choice, found, U)
    J = np.array(dummies.jacobian(found, U))
    J = J / np.abs(J).max(axis=0)
    J = J / np.abs(J).max(axis=1)[:, None]
    worst = 1.0
    for k in range(1, dummies.orders + 1):
        rows = np.array(dummies.c) >= k
        columns = np.array(choice.depth) >= k
        least = [np.linalg.svd(A, compute_uv=False)[-1] for A in (J[rows][:, columns], J[rows])]
        worst = min(worst, least[0] / least[1])
    assert_allclose(quality, worst, rtol=1e-10)
    with pytest.raises(
        SolverError, match="no consistent values found: the path leaves the workspace"
    ):
        dummies.consistent(choice, Y, U + 50.0, scale)
    with pytest.raises(
        ArgumentError,
        match=r"offsets: given 3 of rows and 6 of unknowns, expected 6 and 6; a struct",
    ):
        DummyDerivatives(case.dae, (1, 2, 3), dummies.d)


def test_a_few_steps_of_idas_have_the_torques_of_bdf() -> None:
    case = problem(ELBOW)
    dummies = DummyDerivatives(case.dae, *reduced.offsets(case.dae))
    t = np.linspace(0.0, 0.12, 4)
    found = reduced.integrate(dummies, case.path, t, case.x_eq)
    x, _ = dummies.states_of(found.Y)
    tau = bdf.march(case.dae, case.path, np.linspace(0.0, 0.12, 37), case.x_eq, 3).x[::12, 8:]
    assert_allclose(x[:, 8:], tau, atol=5e-3 * np.abs(tau).max())
    assert (
        (found.choices, found.freedom, found.rtol) == (1, 2, 1e-11)
        and found.steps > 10
        and found.iterations > 10
    )


def test_an_integration_that_fails_is_tried_again_and_named_by_its_last_words(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The last line of the error of IDAS, the instant, and the tolerance of the last attempt."""
    tolerances: list[float] = []

    def fail(
        name: str,
        solver: str,
        system: Any,
        begin: float,
        times: list[float],
        options: dict[str, Any],
    ) -> Any:
        tolerances.append(options["reltol"])
        raise RuntimeError(f"in {name}\nIDA_CONV_FAIL at {len(tolerances)}\n")

    monkeypatch.setattr(reduced.ca, "integrator", fail)
    case = problem(ELBOW)
    dummies = DummyDerivatives(case.dae, *reduced.offsets(case.dae))
    with pytest.raises(SolverError) as caught:
        reduced.integrate(dummies, case.path, np.linspace(0.0, 0.5, 7), case.x_eq, 1e-6)
    factors = [factor for _, factor in reduced.RETRIES]
    assert tolerances == [1e-6 * factor for factor in factors]
    assert str(caught.value) == (
        "method reduced: IDAS failed after t = 0 s with a tolerance of "
        f"{1e-6 * factors[-1]:.0e}: IDA_CONV_FAIL at {len(factors)}; try lq or bdf"
    )
