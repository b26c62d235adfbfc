"""The notebooks: stored without outputs, executed from the first cell to the last, and what they
print.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = ROOT / "examples" / "notebooks"
NAMES = sorted(path.stem for path in NOTEBOOKS.glob("*.ipynb"))
QUICK = "first_robot"  # nothing is compiled; a kernel needs 2 s to start
TIME_S = 300.0  # of a cell, on a busy computer
PLOTS = {"c_library": 0, "identify": 0, "close_the_loop": 2}  # others have one at least

nbformat = pytest.importorskip("nbformat")


def printed(notebook: object) -> str:
    """All text that the cells print, without progress."""
    outputs = [out for cell in notebook.cells if cell.cell_type == "code" for out in cell.outputs]
    return "".join(
        out.text for out in outputs if out.output_type == "stream" and out.name == "stdout"
    )


def pictures(notebook: object) -> int:
    outputs = [out for cell in notebook.cells if cell.cell_type == "code" for out in cell.outputs]
    return sum(
        not {"image/svg+xml", "image/png"}.isdisjoint(out.get("data", {})) for out in outputs
    )


def number(pattern: str, text: str) -> float:
    found = re.search(pattern, text)
    assert found is not None, f"{pattern!r} is not in\n{text}"
    return float(found[1])


def claims(name: str, text: str) -> None:
    """Assertions on the numbers that a notebook printed, for the statements of its text."""
    if name == "first_robot":
        assert "minimum phase - index 4" in text
        assert number(r"instead of ([\d.]+) nm", text) < 100
    elif name == "non_minimum_phase":
        zero = number(r"- zero ([\d.]+)", text)
        rates = [float(x) for x in re.search(r"rates, 1/s: \[([^\]]*)\]", text)[1].split()]
        assert len(rates) == 2 and max(abs(rate / zero - 1) for rate in rates) < 0.01
        assert "method reduced: the zero dynamics" in text
    elif name == "identify":
        assert "fitted - " in text
        pairs = re.findall(r"error +(-?[\d.]+) % +sd ([\d.]+) %", text)
        assert len(pairs) == 4 and all(abs(float(error)) < 4 * float(sd) for error, sd in pairs)
        assert number(r"identified: ([\d.]+) um", text) < 0.05 * number(
            r"model file: ([\d.]+) um", text
        )
    elif name == "close_the_loop":
        assert number(r"nominal: error up to ([\d.]+) um", text) < 1.0
        assert "lqg" in text
    elif name == "c_library":
        assert "the same bits: True" in text
        assert number(r"largest difference ([\d.e-]+) N m", text) < 1e-3
    elif name == "benchmark_f":
        start = number(r"([\d.]+) -> ", text)
        end = number(r" -> ([\d.]+) in \d+ evaluations", text)
        assert 0.7 < end < start and "refused, no score" in text
    elif name == "feedback_study":
        assert number(r"nominal: error up to ([\d.]+) mm", text) < number(
            r"soft: error up to ([\d.]+) mm", text
        )
        assert "is unstable" in text and "expected at most" in text
        # 2.7 with the tunings of docs/control.md
        assert number(r"about the feedforward = ([\d.]+)", text) > 1.5
    elif name == "gradient_stiffness":
        start = number(r"loss ([\d.]+) ->", text)
        end = number(r"loss [\d.]+ -> ([\d.]+)", text)
        assert start > 100 and 0.8 < end < 1.2
        found = [float(x) for x in re.findall(r"error (-?[\d.]+) %", text)]
        assert len(found) == 2 and abs(found[0]) < 1 and abs(found[1]) < 10
    elif name == "gradient_policy":
        pairs = re.findall(r"error ([\d.]+) -> ([\d.]+) mrad", text)
        assert len(pairs) == 4 and all(float(new) < 0.5 * float(old) for old, new in pairs)
    else:
        first = number(r"0 repetitions: +([\d.]+)", text)
        last = number(r"4 repetitions: +([\d.]+)", text)
        assert name == "learning" and last < 0.01 * first


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[] if n == QUICK else pytest.mark.slow) for n in NAMES]
)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_notebook_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient = pytest.importorskip("nbclient")
    pytest.importorskip("ipykernel")
    if name.startswith("gradient_"):
        pytest.importorskip("jax", reason="the package jax is not installed")
    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    )
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
    work = tmp_path / "work"
    work.mkdir()
    nbclient.NotebookClient(
        notebook, timeout=TIME_S, resources={"metadata": {"path": str(work)}}
    ).execute()
    claims(name, printed(notebook))
    assert pictures(notebook) >= PLOTS.get(name, 1)


def test_notebooks_are_stored_without_outputs() -> None:
    assert len(NAMES) >= 8
    for name in NAMES:
        notebook = nbformat.read(NOTEBOOKS / f"{name}.ipynb", as_version=4)
        nbformat.validate(notebook)
        code = [cell for cell in notebook.cells if cell.cell_type == "code"]
        assert len(code) >= 3 and all(
            cell.outputs == [] and cell.execution_count is None for cell in code
        )
        assert len({cell.id for cell in notebook.cells}) == len(notebook.cells)
        assert set(notebook.metadata) == {"kernelspec", "language_info"}


def test_every_notebook_is_on_the_page() -> None:
    page = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert sorted(re.findall(r"notebooks/(\w+)\.ipynb\)", page)) == NAMES


def test_planted_numbers_are_found() -> None:
    with pytest.raises(AssertionError):
        claims("c_library", "the same bits: False\nlargest difference 1e-9 N m")
    with pytest.raises(AssertionError):
        claims(
            "non_minimum_phase",
            "rates, 1/s: [60.0 67.6] - zero 67.6\nmethod reduced: the zero dynamics",
        )
