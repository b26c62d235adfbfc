"""Logs of HEBI modules: a stand-in for the package of the maker, and the package where it is."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import flexgen
from flexgen.base.files.hebi_log import read_hebi_log

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FLEXGEN_DATA", ROOT.parent / "shared" / "data"))
LOG = DATA / "hebi" / "exampleLog.hebilog"


def feedback(k: int) -> SimpleNamespace:
    """Sample k of two modules; the second one has no deflection, and loses one position."""
    return SimpleNamespace(
        size=2,
        receive_time=np.array([100.0 + 0.01 * k, 100.001 + 0.01 * k]),
        hardware_transmit_time_us=np.array([500 + 10_000 * k, 9_000 + 10_001 * k]),
        position=np.array([0.1 * k, np.nan if k == 3 else -0.1 * k]),
        effort=np.array([2.0 * k, 1.0]),
        deflection=np.array([-0.05 * k, np.nan]),
    )


@pytest.fixture
def package(monkeypatch):
    """The stand-in for hebi-py, whose log has 30 samples."""
    found = ModuleType("hebi")
    found.util = SimpleNamespace(
        load_log=lambda name: SimpleNamespace(feedback_iterate=map(feedback, range(30)))
    )
    monkeypatch.setitem(sys.modules, "hebi", found)
    return found


def test_arrays_of_a_log_have_names_modules_and_units(package, tmp_path):
    found = read_hebi_log(tmp_path / "a.hebilog")
    assert np.allclose(found["time s"], 0.01 * np.arange(30))
    assert found["module_time_2 s"] == pytest.approx(0.010001 * np.arange(30))
    assert found["position_1 rad"] == pytest.approx(0.1 * np.arange(30))
    assert np.ma.getmaskarray(found["position_2 rad"]).sum() == 1
    assert "deflection_1 rad" in found and "deflection_2 rad" not in found


def test_a_log_is_a_record_of_a_spring(package, tmp_path):
    file = tmp_path / "a.hebilog"
    file.write_bytes(b"log")
    options = {"joint": "q1", "elements": 0, "names": ("-deflection_1", "effort_1")}
    found = flexgen.identify_spring("elbow", file, progress=False, **options)
    assert found.values["q1.spring.stiffness"] == pytest.approx(40.0)


def test_without_the_package_the_error_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "hebi", None)
    with pytest.raises(flexgen.ArgumentError, match=r"needs the package hebi-py .*pip install"):
        read_hebi_log(tmp_path / "a.hebilog")


def test_torques_that_fall_are_refused(package, tmp_path):
    file = tmp_path / "a.hebilog"
    file.write_bytes(b"log")
    with pytest.raises(flexgen.ArgumentError, match=r"falls with .* names=\('-deflection'"):
        flexgen.identify_spring(
            "elbow", file, joint="q1", names=("deflection_1", "effort_1"), elements=0
        )


def test_a_damaged_log_is_refused(package, tmp_path):
    package.util.load_log = lambda name: None
    with pytest.raises(flexgen.ArgumentError, match="cannot be read as a log of HEBI modules"):
        read_hebi_log(tmp_path / "a.hebilog")


def test_a_real_log_of_a_module(tmp_path):
    """10 s at 100 Hz: speeds are derivatives of positions on the clock of the module."""
    if not LOG.exists():
        pytest.skip("no recording hebi: log of an X-series module of HEBI Robotics")
    if find_spec("hebi") is None:
        pytest.skip("the package hebi-py is not installed")
    found = read_hebi_log(LOG)
    t = found["module_time_1 s"]
    assert np.diff(t).mean() == pytest.approx(0.01, rel=1e-3)
    slope = np.gradient(found["position_1 rad"], t)[5:-5]
    error = slope - found["velocity_1 rad/s"][5:-5]
    assert np.std(error) < 0.1 * np.std(slope)
    # the maker's stiffness is 40 N m/rad
    assert np.allclose(found["effort_1 N m"], -40.0 * found["deflection_1 rad"], atol=1e-3)
