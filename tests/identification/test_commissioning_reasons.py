"""Single reasons for many changes: scales, lengths and payloads, from linear records.

The records are random linear functions of the numbers, whose fit is in closed form.
"""

from functools import cache

import numpy as np
import pytest
from toolchain import needs_compiler

import flexgen
from flexgen.identification.commissioning.reasons import find_reasons
from flexgen.identification.commissioning.unknowns import (
    DatasheetTolerances,
    Unknowns,
    make_unknowns,
)

pytestmark = needs_compiler


@cache
def unknowns() -> Unknowns:
    """Of an elbow with a tracker and a payload."""
    hand = {"name": "hand", "type": "tracker", "unit": "m", "position": [0.2, 0.0, 0.1]}
    load = {"mass": 80.0, "com": [1.1, 0.0, 0.2], "inertia": [2.0, 3.0, 3.0]}
    robot = flexgen.read("elbow", overrides={"sensor": [hand], "payload": load})
    return make_unknowns(
        robot,
        DatasheetTolerances(),
        bodies=True,
        positions=True,
        lengths=True,
        motions=1,
        levels=0,
    )


def fit(truth: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Information and changes of a fit in units of the priors; some numbers have no effect."""
    random = np.random.default_rng(seed)
    n = len(truth)
    J = random.normal(size=(300, n)) * np.where(random.random(n) < 0.2, 0.0, 1.0)
    true = truth + 0.5 * random.normal(size=n)  # within the tolerances, too
    A = J.T @ J
    y = J @ true + random.normal(size=300)
    return A, np.linalg.solve(A + np.eye(n), J.T @ y)


def planted(what: str) -> np.ndarray:
    """Changes over tolerances."""
    own = unknowns()
    out = np.zeros(own.parts.size)
    change = {
        "positions": {"fore.z": -0.016 * 1.15, "hand.x": -0.016 * 1.441, "hand.z": -0.016 * 0.1},
        "payload": {"payload.com_x": -0.7, "payload.com_y": 0.4, "payload.com_z": 0.5},
        "length": {"fore.z": 0.02},
        "mass": {"payload.mass": np.log(1.6)},
        "nothing": {},
    }[what]
    for name, step in change.items():
        k = own.names.index(name)
        out[k] = step / own.sd[k]
    return out


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("what", "name", "value", "within"),
    [
        ("positions", "the scale of the measured positions", (0.984,), 5e-3),
        ("payload", "payload.com", (0.4, 0.4, 0.7), 0.16),
        ("length", "fore.z", (0.02,), 4e-3),
        ("mass", "payload.mass", (128.0,), 18.0),
    ],
)
def test_planted_reasons_are_named(
    what: str, name: str, value: tuple[float, ...], within: float, seed: int
) -> None:
    """Within two tolerances of the datasheet: the true numbers are half of one off, too."""
    truth = planted(what)
    A, z = fit(truth, seed)
    seen = np.diag(A)[np.abs(truth) > 0.0] > 0.0
    found = find_reasons(unknowns(), A, z).found
    if not seen.all():
        return  # drawn without an effect
    assert found and found[0].name == name and found[0].share > 0.5
    assert np.abs(np.array(found[0].value) - value).max() < within


@pytest.mark.parametrize("seed", range(8))
def test_numbers_within_tolerances_have_no_reason(seed: int) -> None:
    """A payload without any effect is said not to be visible."""
    A, z = fit(planted("nothing"), seed)
    own = unknowns()
    k = own.names.index("payload.mass")
    A[k] = A[:, k] = 0.0
    z[k] = 0.0
    found = find_reasons(own, A, z)
    assert found.found == ()
    assert [limit.name for limit in found.limits] == ["payload.mass"]
