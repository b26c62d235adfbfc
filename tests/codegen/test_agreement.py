"""Records of exported folders, and libraries that are compared with the equations."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import flexgen
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.version import __version__
from flexgen.codegen.build.agreement import CALLS, compare_library
from flexgen.codegen.build.source_folder import RECORD, write_folder


def test_the_record_of_an_exported_folder_is_a_text_to_read(tmp_path: Path) -> None:
    """Two spaces a level, digests by file, then a new line."""
    given = {"b.c": "int b;\n", "a/a.h": "int a;\n"}
    files = write_folder(tmp_path / "arm", "kind", "arm", given)
    names = [file.relative_to(tmp_path / "arm").as_posix() for file in files]
    assert names == [*sorted(given), RECORD]
    digests = {name: hashlib.sha256(given[name].encode()).hexdigest() for name in sorted(given)}
    record = {"format": 1, "generator": f"flexgen {__version__}", "kind": "kind", "name": "arm"}
    text = files[-1].read_text()
    assert text == json.dumps(record | {"files": digests}, indent=2) + "\n"


def test_a_library_is_compared_with_the_equations() -> None:
    """The largest difference along the trajectory; calls with one state are timed."""
    equations = flexgen.derive("elbow")
    trajectory = flexgen.solve("elbow", progress=False).trajectory
    shapes = []

    def inverse_dynamics(*given: np.ndarray) -> np.ndarray:
        shapes.append(given[0].shape)
        if given[0].ndim == 1:
            return given[0]
        right = evaluate(equations.function("inverse_dynamics"), *given)[0]
        right[-1, 0] -= 0.25
        return right.reshape(given[0].shape)

    library = SimpleNamespace(inverse_dynamics=inverse_dynamics)
    found = compare_library(library, equations, trajectory)
    assert found == {
        "difference_Nm": pytest.approx(0.25, rel=1e-6),
        "call_us": pytest.approx(5e3, abs=5e3),
    }
    assert shapes[1:] == [(equations.model.n_a,)] * CALLS
