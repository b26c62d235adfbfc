"""Reports and pictures: well-formed, self-contained, safe against what a model file says, the same
every time.
"""

from __future__ import annotations

import dataclasses
import functools
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
from made_results import made_trajectory
from unchecked import unchecked

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.limits import Limits
from flexgen.inversion.judge.status import Status
from flexgen.views.plots import canvas
from flexgen.views.plots import solution as figures_of
from flexgen.views.reports import pictures
from flexgen.views.reports.html import write_report

ROOT = Path(__file__).resolve().parents[2]
CASES = [
    ("planar5_nmp", "line"),
    ("manutec_r3", "line"),
    ("four_mass@high", "step"),
    ("beam_arm", "line"),
]
ALWAYS = ["robot", "torques", "speeds", "deflections", "pole_zero_map", "frequency_response"]
VOID = {"meta", "br", "hr", "img", "link", "input", "col", "area", "base", "source", "wbr"}


@functools.cache
def solved(name, move=None, verify=True):
    equations = flexgen.derive(name)
    return equations, flexgen.solve(equations, move, verify=verify)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A function that gives the page of a case, written once."""
    folder = tmp_path_factory.mktemp("reports")

    @functools.cache
    def page(name, move):
        return write_report(*solved(name, move), folder / "new" / name)

    return page


class Page(HTMLParser):
    """Checks nesting; keeps tags, attributes and the text outside of style."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open = []
        self.tags = []
        self.attributes = []
        self.text = []
        self.feed(text)
        self.close()
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.handle_startendtag(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, key, value) for key, value in attrs]

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> within {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data):
        if not self.open or self.open[-1] != "style":
            self.text.append(data)


def read_page(path):
    text = path.read_text(encoding="utf-8")
    page = Page(text)
    for _, key, value in page.attributes:
        if key in ("href", "src", "xlink:href"):
            assert value.startswith("#") or value == "motion.html", value
        assert not key.startswith("on"), key
    assert not re.search(r"url\((?!#)|@import|<script|NaN|\bnan\b", text)
    assert "script" not in page.tags
    ids = [value for _, key, value in page.attributes if key == "id"]
    assert len(ids) == len(set(ids))
    targets = {value[1:] for _, key, value in page.attributes if key == "xlink:href"}
    assert targets <= set(ids)
    return page, " ".join(page.text)


@pytest.mark.parametrize("name, move", CASES)
def test_report_is_complete_and_needs_nothing_else(name, move, written):
    equations, _ = solved(name, move)
    path = written(name, move)
    page, text = read_page(path)
    assert path.name == "index.html"
    names = [value for tag, key, value in page.attributes if tag == "figure" and key == "id"]
    along = {"zeros_along"} if equations.model.n_e else set()
    assert set(names) == {*ALWAYS, "errors", *along}
    assert page.tags.count("figure") == page.tags.count("figcaption") == len(names)
    for picture in names:
        root = ET.parse(path.parent / f"{picture}.svg").getroot()
        assert root.tag.endswith("svg")
    for word in (
        name,
        "status",
        "solved",
        "energy error",
        "motor torque, largest",
        "relative residual",
        "pre-actuation",
        "wall time",
    ):
        assert word in text
    for motor in equations.model.motors:
        assert motor.name in text
    assert equations.model.description in text


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_caption_of_the_torque_follows_the_zeros(tmp_path):
    texts = {}
    for name, move in (("planar5_nmp", "line"), ("four_mass@high", "step")):
        texts[name] = read_page(write_report(*solved(name, move), tmp_path))[1]
    assert "zero dynamics is unstable" in texts["planar5_nmp"]
    assert "zero dynamics is unstable" not in texts["four_mass@high"]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_report_without_verification(tmp_path):
    equations, solution = solved("planar5_nmp", "line", verify=False)
    page, text = read_page(write_report(equations, solution, tmp_path))
    assert "not done" in text
    assert "errors" not in [
        value for tag, key, value in page.attributes if tag == "figure" and key == "id"
    ]
    assert not (tmp_path / "errors.svg").exists()
    with pytest.raises(ArgumentError, match="not verified"):
        figures_of.errors(equations, solution.trajectory, None)
    assert figures_of.overview(equations, solution.trajectory) is not None


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_report_of_a_limited_solution_with_warnings_and_library(tmp_path):
    equations, solution = solved("planar5_nmp", "line")
    measured = dataclasses.replace(solution, status=Status.LIMITS_ACTIVE, plan_error_max_m=1.7e-6)
    text = " ".join(read_page(write_report(equations, measured, tmp_path / "measured"))[1].split())
    assert (
        "simulated error from the modified path, largest 1.7 µm" in text and "off the path" in text
    )
    limited = dataclasses.replace(
        solution, status=Status.LIMITS_ACTIVE, warnings=("motor m1: <b>torque</b> & more",)
    )
    library = SimpleNamespace(
        functions=("mass_matrix",), files=("a/planar5_nmp.c",), digest="0123456789abcdef0123"
    )
    page, text = read_page(
        write_report(
            equations, limited, tmp_path, generated=library, limits=Limits(torque=(26.0, np.inf))
        )
    )
    assert (
        "limits active" in text
        and "The limits are active: the robot deviates from the path" in text
    )
    assert (
        "distance of the tool from the reference at the same time (limits active)" in text
        and "tool error open loop" not in text
    )
    assert "modified path" not in text  # which was not measured
    assert "motor m1: <b>torque</b> & more" in text and "b" not in page.tags
    assert re.search(r"24\.48 / 26 ", text) and re.search(r"6\.\d+ / \N{EN DASH}", text)
    assert "mass_matrix" in text and "planar5_nmp.c" in text and "a/planar5_nmp.c" not in text


@pytest.mark.slow
def test_text_of_a_model_cannot_become_markup(tmp_path):
    equations, solution = solved("planar5_nmp", "line", verify=False)
    evil = "<script>alert('x')</script><img src=x onerror=y>\" onload=\"z $\\frac$ </svg>"
    model = dataclasses.replace(equations.model, description=evil, source=evil)
    move = unchecked(solution.move, name=evil)
    trajectory = dataclasses.replace(
        solution.trajectory, meta={**solution.trajectory.meta, "move": evil}
    )
    hostile = dataclasses.replace(
        solution, model=model, move=move, trajectory=trajectory, verdict=evil, method=evil
    )
    page, text = read_page(write_report(flexgen.derive(model), hostile, tmp_path))
    assert text.count("<script>alert('x')</script>") >= 4  # shown, not run
    assert not {"script", "img"} & set(page.tags)
    for file in tmp_path.glob("*.svg"):
        assert all(not element.tag.endswith("script") for element in ET.parse(file).iter())


@pytest.mark.slow
def test_pictures_are_the_same_every_time_and_leave_no_trace(tmp_path):
    equations, solution = solved("planar5_nmp", "line")
    before = dict(matplotlib.rcParams)
    style = {"font.size": 31.0, "axes.grid": False, "svg.hashsalt": "theirs"}
    texts = []
    for k in range(2):
        with matplotlib.rc_context(style if k else {}):
            figure = figures_of.torques(equations, solution.trajectory, solution.simulation)
            texts.append(figures_of.save(figure, tmp_path / f"{k}.svg").read_bytes())
    assert texts[0] == texts[1]
    assert dict(matplotlib.rcParams) == before
    assert b"<metadata" not in texts[0] and b"dc:date" not in texts[0]
    code = "import sys, flexgen.views.reports.html; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
    code = "import sys, flexgen; assert 'matplotlib' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_overview_is_small(tmp_path):
    equations, solution = solved("planar5_nmp", "line")
    figure = figures_of.overview(equations, solution.trajectory, solution.simulation)
    assert figures_of.save(figure, tmp_path / "a.svg").stat().st_size < 200_000
    assert figures_of.save(figure, tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    with pytest.raises(ArgumentError, match=r"\.svg or \.png"):
        figures_of.save(figure, tmp_path / "a.pdf")


def test_limits_are_drawn_where_they_are_near():
    equations, solution = solved("planar5_nmp", "line")
    motors = tuple(
        dataclasses.replace(m, torque_max=limit)
        for m, limit in zip(equations.model.motors, (26, 900), strict=True)
    )
    near = flexgen.derive(dataclasses.replace(equations.model, motors=motors))
    figure = figures_of.torques(near, solution.trajectory)
    first, second = (axes for axes in figure.get_axes() if axes.get_ylabel() == "torque, N m")
    assert first.get_ylim()[1] > 26 and first.get_title(loc="right") == "limit ±26 N m"
    assert second.get_ylim()[1] < 50 and second.get_title(loc="right") == "limit ±900 N m"


@pytest.mark.slow
def test_early_torque_has_a_panel_only_with_unstable_zeros():
    def titles(name, move):
        equations, solution = solved(name, move)
        analysis = flexgen.analyze(equations, solution.move.start)
        return [
            axes.get_title(loc="left")
            for axes in figures_of.torques(
                equations, solution.trajectory, analysis=analysis
            ).get_axes()
        ]

    assert any("before the path" in title for title in titles("beam_arm", "line"))
    assert not any("before the path" in title for title in titles("four_mass@high", "step"))


@pytest.mark.slow
def test_end_of_the_path_is_read_from_the_reference():
    for name, move in CASES:
        equations, solution = solved(name, move)
        assert canvas.path_end(equations, solution.trajectory) == pytest.approx(
            solution.move.duration
        )


def test_rigid_machine_has_no_deflections():
    equations, solution = solved("elbow@rigid", "line", verify=False)
    with pytest.raises(ArgumentError, match="rigid gears"):
        figures_of.deflections(equations, solution.trajectory)


def test_the_robot_is_drawn_to_scale_until_the_end_of_its_path():
    equations, solution = solved("planar5_nmp", "line")
    for end, shown in ((None, solution.move.duration), (0.2, 0.2)):
        figure = figures_of.robot(equations, solution.trajectory, end=end)
        (axes,) = figure.get_axes()
        assert axes.get_aspect() == 1.0 and figure.get_suptitle().endswith(f"0 to {shown:g} s")


@pytest.mark.parametrize(("simulated", "label"), [(False, "output"), (True, "output, simulated")])
def test_a_row_of_masses_shows_the_output_of_the_motion_that_is_given(simulated, label):
    equations = flexgen.derive("four_mass@high")
    planned = made_trajectory(equations)
    other = dataclasses.replace(planned, channels=planned.channels | {"q_a": 2 * planned["q_a"]})
    simulation = SimpleNamespace(trajectory=other) if simulated else None
    (axes,) = figures_of.robot(equations, planned, simulation).get_axes()
    names = [line.get_text() for line in axes.get_legend().get_texts()]
    assert names == [label, "reference"]
    y = planned["q_a"] @ equations.model.output.weights[0]
    assert axes.get_lines()[0].get_ydata() == pytest.approx((1 + simulated) * y)


@pytest.mark.slow
def test_machines_without_extent_show_their_output():
    equations, solution = solved("four_mass@high", "step")
    figure = figures_of.robot(equations, solution.trajectory, solution.simulation)
    (axes,) = figure.get_axes()
    assert axes.get_ylabel() == "output, m"


@pytest.mark.slow
def test_analysis_is_written(tmp_path):
    analysis = flexgen.analyze("planar5_nmp", path=flexgen.plan("planar5_nmp"))
    path = analysis.report(tmp_path / "a")
    names = ["pole_zero_map", "frequency_response", "compliance", "zeros_along"]
    files = {f"{name}.{end}" for name in names for end in ("svg", "png")}
    assert {f.name for f in path.parent.iterdir()} == {
        "index.html",
        *files,
    } and path.name == "index.html"
    assert all(f.stat().st_size > 5000 for f in path.parent.iterdir())
    page, text = read_page(path)
    assert [
        value for tag, key, value in page.attributes if tag == "figure" and key == "id"
    ] == names
    for word in (
        "planar5_nmp",
        "Equilibrium",
        "Modes",
        "non-minimum phase",
        *(m.name for m in analysis.model.motors),
    ):
        assert word in text


@pytest.mark.parametrize(
    "name", ["planar5_mp", "elbow@rigid", "abb_arm", "kr300", "manutec_r3_efjm"]
)
def test_every_machine_has_its_pictures_of_dynamics(name):
    analysis = flexgen.analyze(name)
    for draw in (figures_of.pole_zero_map, figures_of.frequency_response):
        for axes in draw(analysis).get_axes():
            assert np.isfinite([*axes.get_xlim(), *axes.get_ylim()]).all()
            assert axes.lines


@pytest.mark.parametrize(
    "x, text", [(1e-4, "10⁻⁴"), (1.0, "1"), (10.0, "10"), (-1e3, "\N{MINUS SIGN}10³"), (0.0, "0")]
)
def test_tick_labels(x, text):
    assert canvas.power(x) == text


@pytest.mark.parametrize(
    "value, unit, text",
    [
        (0.0, "m", "0 nm"),
        (2e-13, "m", "< 0.001 nm"),
        (6.22e-11, "m", "0.0622 nm"),
        (9.99e-8, "m", "99.9 nm"),
        (9.9996e-8, "m", "0.1 µm"),
        (4.2e-5, "rad", "42 µrad"),
        (9.994e-4, "m", "999 µm"),
        (9.999e-4, "m", "1 mm"),
        (3.125e-3, "rad", "3.12 mrad"),
        (1.5, "m", "1.5 m"),
        (2346.0, "m", "2350 m"),
        (1000.0, "m", "1000 m"),
        (999.6, "m", "1000 m"),
        (1e-12, "m", "0.001 nm"),
        (2e-6, "rad or m", "2 µrad or µm"),
        (2e-6, "N m", "< 0.001 N m"),
    ],
)
def test_sizes_are_printed_with_units(value, unit, text):
    assert " ".join(canvas.measure(value, unit)) == text


@pytest.mark.parametrize("size, unit", [(3e-10, "nm"), (3e-6, "µm"), (3e-3, "mm")])
def test_errors_are_drawn_in_a_unit_that_reads_well(size, unit):
    equations, solution = solved("planar5_nmp", "line")
    simulation = solution.simulation
    done = simulation.trajectory
    error = done["error"] * size / np.linalg.norm(done["error"], axis=1).max()
    other = dataclasses.replace(done, channels={**done.channels, "error": error})
    simulation = dataclasses.replace(simulation, trajectory=other)
    (axes,) = figures_of.errors(equations, solution.trajectory, simulation).get_axes()
    assert axes.get_ylabel().endswith(f", {unit}") and unit in axes.get_title(loc="right")
    assert axes.get_title(loc="right").split()[1] in ("3", "0.3")


@pytest.mark.slow
def test_logarithmic_axes_say_so_and_falling_is_explained(tmp_path):
    analysis = flexgen.analyze("planar5_nmp")
    axes = figures_of.pole_zero_map(analysis).get_axes()[0]
    for part, label in (("real", axes.get_xlabel()), ("imaginary", axes.get_ylabel())):
        assert re.fullmatch(rf"{part} part, 1/s \(logarithmic outside ±\S+\)", label)
    assert figures_of.falls_under_gravity(analysis)
    assert not figures_of.falls_under_gravity(flexgen.analyze("abb_arm"))
    text = read_page(write_report(*solved("planar5_nmp", "line"), tmp_path))[1]
    assert "falling under gravity with free motors, not a fault of the controller" in text
    assert "dotted" not in text


def test_a_motor_without_torque_has_an_axis_of_the_size_of_the_others():
    equations, solution = solved("planar5_nmp", "line", verify=False)
    tau = solution.trajectory["tau_m"].copy()
    tau[:, 1] = 1e-9 * np.sin(np.arange(len(tau)))
    trajectory = dataclasses.replace(
        solution.trajectory, channels={**solution.trajectory.channels, "tau_m": tau}
    )
    first, second = (axes for axes in figures_of.torques(equations, trajectory).get_axes())
    assert (
        second.get_ylim()[1] == pytest.approx(0.1 * np.abs(tau).max() * 1.18)
        and first.get_ylim()[1] > 20
    )


def test_a_gear_without_deflection_has_an_axis_of_one_milliradian():
    equations, solution = solved("planar5_nmp", "line", verify=False)
    q_a = solution.trajectory["q_a"]
    model = equations.model
    q_m = q_a[:, list(model.i_g)] @ model.eta.T
    channels = {**solution.trajectory.channels, "q_m": q_m}
    figure = figures_of.deflections(
        equations, dataclasses.replace(solution.trajectory, channels=channels)
    )
    axes = figure.get_axes()[-1]
    assert axes.get_ylim() == (-1.0, 1.0) and axes.get_ylabel() == "angle, mrad"


@pytest.mark.parametrize("low, high", [(880.0, 900.0), (200.0, 1100.0), (2e-3, 30.0)])
def test_logarithmic_axes_have_labeled_ticks(low, high):
    axes = canvas.new_figure(8.0, 3.0, "").add_subplot()
    axes.set(yscale="log", ylim=(low, high))
    canvas.log_axis(axes.yaxis)
    ticks = [tick for tick in axes.yaxis.get_major_locator()() if low <= tick <= high]
    labels = [axes.yaxis.get_major_formatter()(tick) for tick in ticks]
    assert len(labels) >= 2 and all(labels) and len(set(labels)) == len(labels)


@pytest.mark.parametrize(
    "name",
    [
        "elbow",
        "planar5_nmp",
        *(
            pytest.param(x, marks=pytest.mark.slow)
            for x in ("beam_arm", "manutec_r3", "kr300", "four_mass@high")
        ),
    ],
)
def test_the_legend_of_the_robot_is_inside_and_covers_nothing(name):
    equations, solution = solved(name, None, verify=False)
    figure = figures_of.robot(equations, solution.trajectory, end=solution.move.duration)
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    for legend in figure.legends:
        box = legend.get_window_extent(renderer)
        assert (
            box.x0 >= 0
            and box.y0 >= 0
            and box.x1 <= figure.bbox.width
            and box.y1 <= figure.bbox.height
        )
        assert not any(axes.get_tightbbox(renderer).overlaps(box) for axes in figure.get_axes())
    title = figure._suptitle.get_window_extent(renderer)
    assert title.x1 <= figure.bbox.width


def test_figures_of_the_page_do_not_repeat_its_title(monkeypatch, tmp_path):
    _equations, solution = solved("elbow", None, verify=False)
    drawn = {}
    monkeypatch.setattr(
        canvas,
        "svg",
        lambda figure, prefix="": drawn.setdefault(prefix, figure) and "<svg ></svg>",
    )
    monkeypatch.setattr(figures_of, "svg", canvas.svg)
    solution.report(tmp_path)
    titles = [figure.get_suptitle() for prefix, figure in drawn.items() if prefix]
    assert "Motor torques, motor side" in titles and "Poles and zeros" in titles
    assert not any("elbow" in title for title in titles)


@pytest.mark.slow
def test_tables_of_tool_errors_name_what_they_measure(tmp_path):
    equations, solution = solved("elbow", None)
    row = {
        "plant": "nominal",
        "control": "feedforward",
        "method": "rigid",
        "error_max_m": 4.2e-3,
        "error_max_rad": None,
    }
    other = dataclasses.replace(solution, method="rigid")
    _page, text = read_page(
        write_report(equations, solution, tmp_path, compared=(other, solution), robustness=[row])
    )
    assert (
        "Tool error by method, start on the path" in text
        and "Robustness: tool error including static sag" in text
    )
    assert (
        "is not part of this error" in text
        and "is part of this error" in text
        and "rigid, mm" in text
        and "4.2" in text.split("rigid, mm")[1]
    )


def test_early_torque_has_a_panel_where_it_is_visible():
    equations, solution = solved("planar5_nmp", "line")  # 3e-6 of the range of the torque
    overview = figures_of.overview(equations, solution.trajectory, solution.simulation, end=0.5)
    assert "torques before the path starts" not in canvas.svg(overview)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "largest", "told"),
    [("manutec_r3", None, False), ("manutec_r3", 5e-7, True), ("planar5_nmp", None, False)],
)
def test_an_error_after_the_samples_is_explained(name, largest, told):
    """A robot that drifts under the held torque: an error that the plot does not show."""
    equations, solution = solved(name, "line")
    if largest is not None:
        run = dataclasses.replace(solution.simulation, tool_error_max_m=largest)
        solution = dataclasses.replace(solution, simulation=run)
    drawn = pictures.pictures(equations, solution, None, Limits())
    (caption,) = [picture.caption for picture in drawn if picture.name == "errors"]
    assert ("they also cover the time after the samples" in caption) == told


@pytest.mark.slow
def test_the_picture_of_the_readme_is_the_overview_of_today():
    """After a change: ``canvas.save(flexgen.solve("planar5_nmp@soft", "line").plot(), path)``
    writes it again.
    """

    def words(text):
        found = re.findall(r"<!-- (.*?) -->", text)
        return [
            word
            for word in found
            if re.search("[a-z]{2}", word) and not word.startswith("largest ")
        ]

    equations, solution = solved("planar5_nmp@soft", "line")
    now = canvas.svg(
        figures_of.overview(equations, solution.trajectory, solution.simulation, end=0.5)
    )
    assert "torques before the path starts" in now
    stored = (ROOT / "models" / "pictures" / "planar5_nmp_soft.svg").read_text(encoding="utf-8")
    assert (
        words(now) == [word for word in words(stored) if word != "flexgen"] and len(words(now)) > 8
    )


def test_the_axis_of_a_motion_that_decays_for_long_ends_soon_after_the_path() -> None:
    """Planted: a motion that ends with the axis."""
    for until, noted in ((100.0, True), (2.0, False)):
        ax = canvas.new_figure(4.0, 3.0, "").subplots()
        ax.plot([-0.1, until], [0.0, 1.0])
        canvas.time_axis(ax, -0.1, 0.5, min(until, canvas.longest(0.5)))
        assert ax.get_xlim() == (-0.1, 2.0)
        assert ("the motion ends at 100 s" in ax.get_xlabel()) == noted
