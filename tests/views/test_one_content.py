"""Text, table of notebooks, page and JSON of a result have the same numbers with the same units.

The views are read as a user reads them: lines of the text, rows of HTML tables, numbers of JSON;
what `content` returns is not looked at.
"""

from __future__ import annotations

import doctest
import html
import re
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from slide import shaken, slide_robot
from small_fits import small_fit

import flexgen
from flexgen.base.results import Result
from flexgen.base.rows import Row

NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\w)")
# Units that are printed with a prefix, or as a part, and their factors to those of JSON.
FACTORS = {"mm": 1e3, "um": 1e6, "mrad": 1e3, "urad": 1e6, "%": 100.0, "ms": 1e3}
# Results without a content of their own: this set may only shrink.
WITHOUT = {
    "Detection",
    "Equilibrium",
    "Estimate",
    "GeneratedLibrary",
    "LearningResult",
    "Margins",
    "PathSample",
    "Plan",
    "PlantRun",
    "Trajectory",
}


def public_results() -> dict[str, type[Result]]:
    found = {name: getattr(flexgen, name) for name in flexgen.__all__}
    return {
        name: one
        for name, one in found.items()
        if isinstance(one, type) and issubclass(one, Result)
    }


def numbers_in(text: str) -> list[tuple[float, float]]:
    """Printed numbers, each with half a unit of its last digit."""
    found = []
    for each in NUMBER.findall(text):
        mantissa, _, exponent = each.partition("e")
        digits = len(mantissa.partition(".")[2])
        found.append((float(each), 0.51 * 10.0 ** (int(exponent or 0) - digits)))
    return found


def cells_of(page: str) -> Iterator[list[str]]:
    """The cells of each row of the tables of a page, as plain text."""
    for row in re.findall(r"<tr>(.*?)</tr>", page, flags=re.DOTALL):
        cells = re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row, flags=re.DOTALL)
        plain = [cell.replace("\N{MINUS SIGN}", "-") for cell in cells]
        plain = [cell.replace("\N{MICRO SIGN}", "u") for cell in plain]
        plain = [re.sub(r"·10<sup>(-?\d+)</sup>", r"e\1", cell) for cell in plain]
        yield [html.unescape(re.sub(r"<[^>]+>", "", cell)) for cell in plain]


def rows_of_text(text: str) -> list[list[str]]:
    """The cells of each line of the tables of a text, without the rules below heads."""
    lines = [re.split(r" {2,}", line.strip()) for line in text.splitlines()]
    return [
        line for line in lines if len(line) > 1 and not all(set(cell) <= {"-"} for cell in line)
    ]


def is_in(number: tuple[float, float], others: list[tuple[float, float]]) -> bool:
    """Whether a printed number is among others, but for rounding."""
    value, half = number
    return any(abs(value - x) <= max(half, other) for x, other in others)


def numbers_of_json(data: Any) -> list[float]:
    """All numbers, those in texts too, and the lengths of lists, which are printed as counts."""
    if isinstance(data, dict):
        return [x for each in data.values() for x in numbers_of_json(each)]
    if isinstance(data, list):
        return [float(len(data)), *(x for each in data for x in numbers_of_json(each))]
    if isinstance(data, str):
        return [x for x, _ in numbers_in(data)]
    return [float(data)] if isinstance(data, int | float) and not isinstance(data, bool) else []


def label_and_rest(cells: list[str]) -> tuple[str, str]:
    return cells[0], " ".join(cells[1:])


def differences(result: Result) -> list[str]:
    """Where the views of a result differ."""
    text = result.to_text()
    notebook = result._repr_html_()
    data = numbers_of_json(result.to_dict())
    in_text = [label_and_rest(cells) for cells in rows_of_text(text)]
    in_page = [label_and_rest(cells) for cells in cells_of(notebook) if cells]
    found = []
    for label, rest in in_page:
        if not NUMBER.search(rest):
            continue
        lines = [other for name, other in in_text if name == label]
        if not any(_same(rest, line) for line in lines):
            found.append(f"not in the text: {label}: {rest}")
    for label, rest in in_text:
        if not NUMBER.search(rest):
            continue
        rows = [other for name, other in in_page if name == label]
        if not any(_same(rest, row) for row in rows):
            found.append(f"not in the notebook: {label}: {rest}")
        units = [FACTORS[unit] for unit in FACTORS if unit in rest.split()] or [1.0]
        units += list(FACTORS.values()) * (not set(rest.split()) & set(FACTORS))
        for number in numbers_in(re.sub(r"< [-\d.e]+", "", rest)):  # without bounds of noise
            if not any(is_in(number, [(f * x, 0.0) for x in data]) for f in (*units, 1.0)):
                found.append(f"not in JSON: {label}: {number[0]:g}")
    words = html.unescape(re.sub(r"<[^>]+>", " ", notebook))
    lines = [line for line in text.splitlines() if len(re.split(r" {2,}", line.strip())) == 1]
    return found + [f"not in the notebook: {line}" for line in lines if line not in words]


def _same(one: str, other: str) -> bool:
    """Whether two rows have the same numbers and the same words, but those of long columns."""
    a = numbers_in(one)
    b = numbers_in(other)
    units = [{word for word in x.split() if word in UNITS} for x in (one, other)]
    return all(is_in(x, b) for x in a) and all(is_in(x, a) for x in b) and units[0] == units[1]


UNITS = {*FACTORS, "m", "rad", "s", "Hz", "N", "kg", "N m", "1/s", "rad/s", "N m s/rad"}


@cache
def solution() -> flexgen.Solution:
    return flexgen.solve("elbow")


@cache
def plan() -> flexgen.Plan:
    return flexgen.excite("elbow", poses=[[0.5, -0.3]], period_s=1.0, lines=10)


@cache
def loop() -> flexgen.ControlRun:
    return flexgen.control("elbow", plants={"soft": {"stiffness": 0.8}})


def study() -> flexgen.FeedbackStudy:
    ideal = flexgen.Setting(sample_s=0.5e-3, delay_s=0.0, exact=True)
    return flexgen.feedback_study("elbow", settings=[ideal], families=["motor PD"], tunings=2)


# Characters of the value and unit of a row.
WIDEST = 84
MADE: dict[str, Callable[[], Result]] = {
    "Analysis": lambda: flexgen.analyze("planar5_nmp"),
    "Comparison": lambda: flexgen.compare(solution()),
    "Configuration": lambda: flexgen.kinematics(
        "manutec_r3", np.array([0.5, 0.6, 1.2]), np.eye(3)
    )[0],
    "ControlRun": loop,
    "Exported": lambda: flexgen.export_mujoco("elbow", Path(tempfile.mkdtemp()) / "elbow.xml"),
    "FastestMove": lambda: flexgen.fastest("elbow", "line", coefficients=4),
    "FeedbackStudy": study,
    "FeedforwardComparison": lambda: flexgen.compare_feedforward(flexgen.control("elbow")),
    "Passivity": lambda: flexgen.check_passivity(loop()),
    "Score": lambda: flexgen.score("four_mass", version=1),
    "TuningResult": lambda: flexgen.tune("four_mass", version=1, evaluations=3),
    "Solution": solution,
    "Simulation": lambda: solution().simulation,
    "PathAccuracy": lambda: flexgen.control(
        "elbow", plants={"soft": {"stiffness": 0.8}}
    ).accuracy(),
    "PositionCommands": lambda: flexgen.command_positions("elbow"),
    "ServoFit": lambda: small_fit("servo"),
    "GearFit": lambda: small_fit("gears"),
    "SpringFit": lambda: small_fit("spring"),
    "Path": lambda: flexgen.plan("elbow"),
    "SweepResult": lambda: flexgen.sweep(
        flexgen.Grid(["elbow"], moves=flexgen.random_moves(2, seed=1)), workers=1
    ),
    "CascadeTuning": lambda: flexgen.tune_cascade("elbow", evaluations=6),
    "Experiment": lambda: flexgen.measure(plan()),
    "Frf": lambda: flexgen.frf(flexgen.measure(plan())),
    "Load": lambda: small_fit("load"),
    "Calibration": lambda: small_fit("poses"),
    "Commissioning": lambda: small_fit("commissioning"),
    "IdentificationResult": lambda: small_fit("responses"),
    "RecordComparison": lambda: flexgen.compare_record(slide_robot(), shaken(noise=0.02)),
    "ShaperComparison": lambda: flexgen.compare_shapers(slide_robot()),
    "MotionFit": lambda: small_fit("motions"),
    "Prediction": lambda: flexgen.predict(
        flexgen.read("elbow", overrides={"uncertainty": {"stiffness": 0.1}})
    ),
}
# Its text has only the numbers that are unusual; the others are the details of its command.
SHORTER_TEXT = {"Check"}


def made_by_example(name: str) -> Callable[[], Result]:
    """A result of a class as the example of its docstring makes it: the first of its objects."""

    def make() -> Result:
        names: dict[str, object] = {"flexgen": flexgen}
        what = getattr(flexgen, name)
        (test,) = doctest.DocTestFinder(recurse=False).find(what, name, globs=names)
        doctest.DocTestRunner(verbose=False).run(test, clear_globs=False)
        made = [one for one in test.globs.values() if isinstance(one, what)]
        assert made, f"the example of {name} keeps none: begin with `>>> found = ...`, or see MADE"
        return made[0]

    return make


for _name, _class in public_results().items():
    if _class.has_content() and _name not in {*MADE, *SHORTER_TEXT}:
        MADE[_name] = made_by_example(_name)


def test_every_public_result_has_a_content_or_is_listed():
    without = {name for name, one in public_results().items() if not one.has_content()}
    assert without == WITHOUT, "add the method content to the class"


def test_a_result_without_an_entry_is_that_of_its_example():
    assert isinstance(made_by_example("Frf")(), flexgen.Frf)


@pytest.mark.parametrize("name", MADE)
def test_views_of_a_result_have_the_same_numbers(name):
    result = MADE[name]()
    assert type(result).__name__ == name
    assert differences(result) == []


@pytest.mark.parametrize("name", MADE)
def test_the_value_of_a_row_is_shorter_than_a_line(name):
    """Sentences are prose: in a row they make the table as wide as themselves."""
    rows = [part for part in MADE[name]().content() if isinstance(part, Row)]
    assert [x.label for x in rows if len(f"{x.text or x.value} {x.unit}") > WIDEST] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", MADE)
def test_the_page_of_a_result_has_the_rows_of_its_notebook(name, tmp_path):
    result = MADE[name]()
    page = Path(result.report(tmp_path)).read_text(encoding="utf-8")
    rows = [label_and_rest(cells) for cells in cells_of(page) if cells]
    for label, rest in (label_and_rest(cells) for cells in cells_of(result._repr_html_())):
        assert any(name == label and _same(rest, other) for name, other in rows), label


def test_gears_without_loops_have_a_page_and_no_picture(tmp_path):
    found = small_fit("gears")
    with pytest.raises(flexgen.ArgumentError, match="given gears without hysteresis, expected"):
        found.plot()
    assert "m1.cogging.sin_6" in found.report(tmp_path).read_text(encoding="utf-8")


def planted(without: str) -> Result:
    """A result of which one view lacks a row, or has another unit."""
    of = solution().simulation

    class Planted(type(of)):
        def to_text(self) -> str:
            text = of.to_text()
            if without == "unit":
                return text.replace("N m", "mm")
            lines = text.splitlines()
            return "\n".join(x for x in lines if without != "text" or "torque" not in x)

        def _repr_html_(self) -> str:
            page = of._repr_html_()
            row = re.search(r"<tr><td>motor torque.*?</tr>", page)[0]
            return page.replace(row, "") if without == "notebook" else page

        def to_dict(self) -> dict[str, Any]:
            data = of.to_dict()
            if without == "JSON":
                del data["torque_max_Nm"]
            return data

    return object.__new__(Planted)


@pytest.mark.parametrize(
    ("without", "start"),
    [
        ("text", "not in the text: motor torque, largest"),
        ("notebook", "not in the notebook: motor torque, largest"),
        ("JSON", "not in JSON: motor torque, largest"),
        ("unit", "not in the text: motor torque, largest"),
    ],
)
def test_a_row_that_a_view_lacks_is_found(without, start):
    found = differences(planted(without))
    assert found and found[0].startswith(start)
    assert differences(solution().simulation) == []
