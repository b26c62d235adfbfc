"""Pages of scores, analyses and results without a page of their own, read back as HTML."""

from __future__ import annotations

import html
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flexgen
from flexgen.studies.scenarios.measures import measures_of
from flexgen.studies.scenarios.scenario_file import scenario
from flexgen.views.plots import canvas
from flexgen.views.reports import text_tables

pytestmark = pytest.mark.usefixtures("undrawn")


def read(page: Path) -> str:
    return page.read_text(encoding="utf-8").replace(' class="n"', "")


def pictures_of(page: str) -> list[str]:
    return re.findall(r'<figure[^>]* id="(\w+)"', page)


# --- scores --------------------------------------------------------------------------------------
@cache
def score() -> flexgen.Score:
    """The score of a controller whose measures are drawn."""
    chosen = scenario("four_mass", version=1)
    measures = measures_of(chosen)
    rng = np.random.default_rng(3)
    return flexgen.Score(
        chosen,
        "ppi",
        chosen.seed,
        "",
        measures,
        rng.uniform(0.5, 2.0, (2, len(chosen.plants.names), len(measures))),
        np.ones((2, len(measures))),
        (),
        1.0,
        {"z": rng.normal(size=(50, len(chosen.outputs)))},
    )


def test_the_page_of_a_score_has_its_numbers_and_measures(tmp_path: Path) -> None:
    named = replace(score().scenario, title="Two <masses>", rule="2 & 3")
    made = replace(score(), scenario=named, rule="not the published score")
    page = read(made.report(tmp_path))
    assert "<h1>Two &lt;masses&gt;: " in page and pictures_of(page) == ["score"]
    assert f"<td>score V</td><td>{made.total:.4g} (about 1 expected" in page
    for name, value in made.parts.items():
        assert f"<td>V of {name}</td><td>{value:.4g}</td>" in page
    for words in (
        f"Published: {html.escape(named.published)}",
        f"Of this project: {html.escape(named.ours)}",
        "Rule: 2 &amp; 3",
        "<p>not the published score</p>",
        *(f"<th>worst of {name}</th>" for name in named.sets),
    ):
        assert words in page
    for row in made.table:
        start = f"<td>{html.escape(row['measure'])}</td><td>{row['unit']}</td>"
        assert f"{start}<td>{row['weight']:.4g}</td>" in page
    assert "refused" not in page
    bare = replace(made, scenario=replace(named, rule=""), rule="")
    page = read(bare.report(tmp_path))
    assert "Rule:" not in page and "<p></p>" not in page


def test_the_page_of_a_refused_controller_has_the_reasons_and_no_score(tmp_path: Path) -> None:
    page = read(replace(score(), refused=("the torque < 3 is too large",)).report(tmp_path))
    assert "refused, no score" in page and "<p>the torque &lt; 3 is too large</p>" in page
    assert "<h2>Measures</h2>" not in page and "score V" not in page
    assert pictures_of(page) == ["score"]


# --- analyses ------------------------------------------------------------------------------------
@cache
def analysis() -> Any:
    return flexgen.analyze("planar5_nmp", path=flexgen.plan("planar5_nmp"))


@pytest.mark.parametrize(
    ("compliance", "path", "pictures"),
    [
        ("soft", "some", ["compliance", "zeros_along"]),
        ("stiff", "some", ["zeros_along"]),
        ("", "none", []),
        ("soft", "", ["compliance"]),
    ],
)
def test_the_page_of_an_analysis_has_pictures_of_what_there_is(
    compliance: str, path: str, pictures: list[str], tmp_path: Path
) -> None:
    given = analysis()
    stiff = replace(given.compliance, J=0.0 * given.compliance.J)
    without = replace(given.zero_path, zeros=np.nan * given.zero_path.zeros)
    warnings = ("beware & look",) if path else ()
    made = replace(
        given,
        compliance={"soft": given.compliance, "stiff": stiff, "": None}[compliance],
        zero_path={"some": given.zero_path, "none": without, "": None}[path],
        solvability=replace(given.solvability, warnings=warnings),
    )
    page = read(made.report(tmp_path))
    assert pictures_of(page) == ["pole_zero_map", "frequency_response", *pictures]
    assert ("<p>note: beware &amp; look</p>" in page) == bool(warnings)
    assert f"<h1>{made.model.title}: analysis of an equilibrium</h1>" in page
    assert f"{html.escape(made.model.description)}." in page
    units = [f"<td>{c.unit}</td>" for c in made.model.coordinates] + ["</tr>"] * made.model.n_m
    names = [x.name for x in (*made.model.coordinates, *made.model.motors)]
    values = [*made.equilibrium.q_a, *made.equilibrium.tau_m]
    for name, value, unit in zip(names, values, units, strict=True):
        (shown,) = re.findall(rf"<td>{name}</td><td>([^<]*)</td>{unit}", page)
        number = float(shown.replace("\N{MINUS SIGN}", "-"))
        assert number == pytest.approx(value, rel=1e-3, abs=1e-9)


# --- results without a page of their own ---------------------------------------------------------
def rest() -> flexgen.Equilibrium:
    return flexgen.Equilibrium(
        np.array([0.5]), np.array([50.0]), np.array([3.0]), np.array([300.0])
    )


class Pictured(flexgen.Equilibrium):
    """An equilibrium with a picture."""

    def plot(self) -> Any:
        return canvas.new_figure(3.0, 2.0, "")


class Tabled(flexgen.Equilibrium):
    """An equilibrium whose text is a table with wide rows, and a warning."""

    warnings = ("a < b",)
    rows = tuple((f"q{k}.zero", f"{k} < {k + 1}" + " and wide" * 20) for k in range(40))

    def to_text(self) -> str:
        return text_tables.table(self.rows)


def test_the_page_of_another_result_is_its_table_and_its_picture(tmp_path: Path) -> None:
    page = read(rest().report(tmp_path / "a"))
    assert "<h1>Equilibrium</h1>" in page and pictures_of(page) == []
    assert rest()._repr_html_().replace(' class="n"', "") in page
    pictured = Pictured(**vars(rest()))
    assert pictures_of(read(pictured.report(tmp_path / "b"))) == ["picture"]


def test_the_page_of_a_result_with_tables_has_all_rows(tmp_path: Path) -> None:
    """The table of notebooks has four entries of a dictionary: a page of a calibration had four
    numbers of 260.
    """
    given = Tabled(**vars(rest()))
    with text_tables.fit_tables(60):  # of the terminal
        page = read(given.report(tmp_path))
    text = html.unescape(page)
    assert all(wide in text for _, wide in given.rows) and "<li>a < b</li>" in text
    assert "<pre" in page and "a < b" not in page
