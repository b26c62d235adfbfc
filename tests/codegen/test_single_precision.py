"""Single precision in the controller: invert and streams, judged by the full model in double
precision.
"""

from __future__ import annotations

import re
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest
from emitted import ROOT
from inversion_cases import given, samples
from stream_machine import Machine, error
from toolchain import needs_compiler

from flexgen.base.errors import ArgumentError, SolverError
from flexgen.codegen.build.generate import generate
from flexgen.codegen.emission.c_functions import PARTS, offered_c_functions
from flexgen.dynamics.mechanics.equations import derive
from flexgen.dynamics.mechanics.signatures import INVERSION, offered_functions
from flexgen.inversion.problem.model_library import inversion_library
from flexgen.model.reader import read
from flexgen.runtime.library import Library, load

pytestmark = needs_compiler

MICROMETER = 1e-6
PLANAR = 5 * MICROMETER  # m: of the planar arm
ALLOWED = 20 * MICROMETER
UR5 = str(ROOT / "tests/support/robots/ur5_elastic.toml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> FilePath:
    return tmp_path_factory.mktemp("single")


_LIBRARIES: dict[str, Library] = {}


def single(name: str, folder: FilePath) -> Library:
    """The library of a model in single precision."""
    if name not in _LIBRARIES:
        used = [function for function in INVERSION if function in offered_functions(read(name))]
        where = generate(
            name, folder / FilePath(name).stem, functions=used, precision="single"
        ).directory
        _LIBRARIES[name] = load(where)
    return _LIBRARIES[name]


def arguments_of(name: str, **changes: Any) -> dict[str, Any]:
    """A whole path: the model's first move."""
    return {**given(**samples(name)), **changes}


@pytest.mark.parametrize(
    ("name", "move", "allowed"),
    [
        ("planar5_nmp", None, PLANAR),  # 0.4 um measured
        pytest.param("elbow", None, ALLOWED, marks=pytest.mark.slow),  # 6.5 um
        pytest.param(UR5, "line", ALLOWED, marks=pytest.mark.full, id="ur5-line"),  # 1.5 um
        pytest.param(UR5, "joints", ALLOWED, marks=pytest.mark.full, id="ur5-joints"),  # 4 um
    ],
)
def test_the_tool_follows_a_stream_in_single_precision(name, move, allowed, folder):
    machine = Machine(name, move, single(name, folder))
    t, results = machine.followed()
    assert results["tau_m"].dtype == np.float32
    assert (
        error(machine.simulation(t, {key: x.astype(float) for key, x in results.items()}))
        < allowed
    )


def test_torques_with_three_digits_are_seen(folder):
    machine = Machine("planar5_nmp", None, single("planar5_nmp", folder))
    t, results = machine.followed()
    results["tau_m"] = results["tau_m"].astype(np.float16)
    assert (
        error(machine.simulation(t, {key: x.astype(float) for key, x in results.items()}))
        > 5 * PLANAR
    )


@pytest.mark.parametrize("name", ["planar5_nmp", pytest.param("elbow", marks=pytest.mark.slow)])
def test_a_whole_path_in_single_precision(name, folder):
    """Torques within 0.2 % of the largest of those in double precision, and a status that says
    so.
    """
    arguments = arguments_of(name)
    found = single(name, folder).invert(**arguments)
    expected = inversion_library(derive(name), "lq").invert(**arguments)
    assert found.converged and expected.converged and found.tau_m.dtype == np.float32
    assert np.abs(found.tau_m - expected.tau_m).max() < 2e-3 * np.abs(expected.tau_m).max()
    assert np.abs(found.q_a - expected.q_a).max() < 1e-5


def test_held_torques_in_single_precision(folder):
    arguments = arguments_of("planar5_nmp", hold="zoh", delay=1.5)
    found, expected = (x.invert(**arguments) for x in (single("planar5_nmp", folder), _double()))
    assert np.abs(found.tau_m - expected.tau_m).max() < 2e-3 * np.abs(expected.tau_m).max()
    assert (
        np.abs(_double().invert(**arguments_of("planar5_nmp")).tau_m - expected.tau_m).max()
        > 1e-2 * np.abs(expected.tau_m).max()
    )


def test_limits_in_single_precision(folder):
    """A torque limit of nine tenths of the largest torque: kept, as in double precision."""
    free = Machine("planar5_nmp", None, single("planar5_nmp", folder))
    _, without = free.followed()
    most = 0.9 * np.abs(without["tau_m"]).max(axis=0)
    stream = free.begun(40)
    stream.limit(torque=most)
    n = 40 + int(free.path.duration / stream.period) + 60
    samples = zip(*free.samples(stream.period * np.arange(1, n + 1)), strict=True)
    intervals = [stream.update(*sample) for sample in samples]
    torque = np.vstack([interval.tau_m for interval in intervals])
    assert any(interval.limits_active for interval in intervals)
    assert np.all(np.abs(torque) < 1.01 * most)


def test_bvp_in_single_precision_is_refused(folder):
    with pytest.raises(
        ArgumentError, match="parts: given 'bvp', but it is in double precision only; leave it out"
    ):
        generate("planar5_nmp", folder / "with", precision="single", parts=["bvp"], build=False)


@pytest.mark.parametrize("parameters", [(), ("payload",)])
def test_what_the_page_names_and_nothing_else_is_missing_in_single_precision(parameters):
    """docs/c_library.md: but no `bvp` and `invert_limited`; each has a function for the size of
    its workspace.
    """
    robot = read("planar5_nmp")
    more, less = (
        {
            f.name
            for f in offered_c_functions(
                robot, offered_functions(robot), parameters, precision, PARTS
            )
        }
        for precision in ("double", "single")
    )
    text = (ROOT / "docs/c_library.md").read_text(encoding="utf-8")
    (said,) = re.findall(r"Libraries in single precision have .* but no (.*)\.", text)
    named = re.findall("`(.*?)`", said)
    assert len(named) == 2 and more - less == {
        name + end for name in named for end in ("", "_work")
    }
    assert less < more


def test_numbers_too_large_for_single_precision(folder):
    arguments = arguments_of("planar5_nmp")
    arguments["y"] = arguments["y"].copy()
    arguments["y"][3, 0] = 1e300
    with pytest.raises(ArgumentError, match="finite"):
        single("planar5_nmp", folder).invert(**arguments)


def test_a_tolerance_below_rounding_is_not_met(folder):
    with pytest.raises(SolverError, match="did not converge"):
        single("planar5_nmp", folder).invert(**arguments_of("planar5_nmp", tolerance=1e-12))


def _double() -> Library:
    return inversion_library(derive("planar5_nmp"), "lq")
