"""The order of ``lq`` and ``bvp``: how fast the motion at the nodes converges when the intervals
are halved.

Judged by the finest mesh of ``bvp``, whose steps are not those of ``lq`` and which weighs nothing.
"""

from __future__ import annotations

import re

import numpy as np
import pytest
from inversion_cases import last_joint, question
from toolchain import needs_compiler

from flexgen.codegen.build import model_library
from flexgen.codegen.emission import clib_files
from flexgen.inversion.methods import bvp, lq
from flexgen.model.elements import RobotModel
from flexgen.model.reader import read

pytestmark = needs_compiler

METHODS = {"lq": lq.solve, "bvp": bvp.solve}
FINEST = 1e-3  # s
# Factors of stiffness and damping of the passive joint, and the bounds of the order. Gauss points,
# s = 3: order 2 s where the zeros z are slow against the intervals, |z| h < 3; order s + 1, as of
# algebraic equations, where they are fast, |z| h > 70. The arm as it is stands between, with |z| h
# from 2 to 18. Each within a third, because the meshes are not yet in the limit.
MODELS = {
    "slow": (0.03, 0.03, 6 - 1 / 3, 6 + 1 / 3),
    "as it is": (1.0, 1.0, 4.0, 6.0),
    "fast": (1000.0, 30.0, 4 - 1 / 3, 4 + 1 / 3),
}


def order(
    model: str | RobotModel, method: str, meshes: tuple[float, ...] = (2e-2, 1e-2, 5e-3)
) -> float:
    """Mean order of q_e over meshes [s], at the nodes that all of them have."""
    asked = [question(model, mesh=h, preview=0.2) for h in meshes]
    answers = [METHODS[method](ask, h) for ask, h in zip(asked, meshes, strict=True)]
    answers.append(bvp.solve(question(model, mesh=FINEST, preview=0.2), FINEST))
    i_e = list(asked[0].equations.model.i_e)
    motions = []
    for found in answers:
        number = found.t / meshes[0]
        node = np.abs(number - np.round(number)) < 1e-6
        motions.append(
            dict(zip(np.round(number[node]).astype(int), found.q[node][:, i_e], strict=True))
        )
    common = sorted(set.intersection(*map(set, motions)))
    assert len(common) >= 20
    *coarse, exact = (np.array([motion[k] for k in common]) for motion in motions)
    errors = [float(np.abs(q - exact).max()) for q in coarse]
    return float(np.log2(errors[0] / errors[-1]) / np.log2(meshes[0] / meshes[-1]))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("speed", MODELS)
def test_each_method_has_its_stated_order(method: str, speed: str) -> None:
    stiffness, damping, least, most = MODELS[speed]
    assert least < order(last_joint(read("planar5_nmp"), stiffness, damping), method) < most


@pytest.mark.parametrize("method", METHODS)
def test_six_axes(method: str) -> None:
    """Zeros of 160 to 1000 1/s. On finer meshes what the weights of lq leave, some 1e-10 rad,
    hides the error.
    """
    assert 4 - 1 / 3 < order("manutec_r3_18", method, (4e-2, 2e-2, 1e-2)) < 6


def equidistant(text: str) -> str:
    """The Gauss points replaced by the middles of three equal every, whose order is four."""
    c = np.array([1, 3, 5]) / 6
    powers = c[:, None] ** np.arange(3)
    A = c[:, None] * powers / np.arange(1, 4) @ np.linalg.inv(powers)
    b = 1 / np.arange(1, 4) @ np.linalg.inv(powers)

    def listed(x: np.ndarray) -> str:
        return "{" + ", ".join(listed(row) if row.ndim else repr(float(row)) for row in x) + "}"

    for name, values in (("c", c), ("b", b), ("A", A)):
        text, count = re.subn(
            rf"(gauss_{name}\b[^=;]*= )\{{[^;]*;",
            lambda found, x=values: f"{found[1]}{listed(x)};",
            text,
        )
        assert count == 1
    return text


def test_points_of_a_lower_order_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """The planted bug: points that converge to the same motion, but more slowly."""
    texts = clib_files.read_clib()
    right = texts["inversion_common.h"]
    monkeypatch.setattr(
        clib_files, "read_clib", lambda: {**texts, "inversion_common.h": equidistant(right)}
    )
    monkeypatch.setenv("FLEXGEN_CACHE", "")
    model_library.library_holder.cache_clear()
    try:
        stiffness, damping, least, _ = MODELS["slow"]
        found = order(last_joint(read("planar5_nmp"), stiffness, damping), "lq")
    finally:
        model_library.library_holder.cache_clear()
    assert 4 - 1 / 3 < found < 5 < least
