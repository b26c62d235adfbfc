"""Texts of reports of made-up results: drives of robots, failures of sweeps, segments of paths,
and errors of poses.
"""

from __future__ import annotations

import html
from pathlib import Path
from types import SimpleNamespace as Made
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import flexgen
from flexgen.base.errors import SolverError
from flexgen.feedback.loop.result import output_errors
from flexgen.views.reports import (
    analysis_page,
    control_page,
    pictures,
    result_page,
    text_tables,
    texts,
)
from flexgen.views.reports.row_views import text_of_rows


@pytest.mark.parametrize(
    ("coordinate", "drive", "stiffness", "damping"),
    [
        ({"unit": "rad", "gear": {"type": "rigid"}}, "rigid gear", None, None),
        (
            {
                "unit": "rad",
                "gear": {
                    "type": "elastic",
                    "spring": {"type": "linear", "stiffness": 2e4},
                    "side": "arm",
                },
            },
            "elastic gear, linear, arm side",
            "20000 N m/rad",
            "0 N m s/rad",
        ),
        (
            {
                "unit": "m",
                "gear": {
                    "type": "elastic",
                    "spring": {"type": "smooth", "low": 50.5},
                    "side": "motor",
                    "damping": 2.5,
                    "hysteresis": [{"lost_motion": 1e-3}, {"lost_motion": 2.5e-4}],
                },
            },
            "elastic gear, smooth, motor side, lost motion 0.00125 m",
            "50.5 N m/rad",
            "2.5 N m s/rad",
        ),
        (
            {
                "unit": "rad",
                "gear": {
                    "type": "elastic",
                    "spring": {"type": "linear", "stiffness": 3.0},
                    "side": "arm",
                    "hysteresis": {"lost_motion": 0.02},
                },
            },
            "elastic gear, linear, arm side, lost motion 0.02 rad",
            "3 N m/rad",
            "0 N m s/rad",
        ),
        (
            {"unit": "m", "spring": {"type": "linear", "stiffness": 10.0}, "damping": 1.5},
            "spring, linear",
            "10 N/m",
            "1.5 N s/m",
        ),
        ({"unit": "rad"}, "beam bending", None, None),
    ],
)
def test_the_drive_of_a_coordinate_in_words(
    coordinate: dict[str, Any], drive: str, stiffness: str | None, damping: str | None
) -> None:
    assert texts._drive(coordinate) == drive
    assert texts._stiffness(coordinate) == (stiffness, damping)


def test_ratios_and_outputs_in_words() -> None:
    assert (
        texts._ratio(-80.5, "rad/rad") == "-80.5"
        and texts._ratio(628.3185, "rad/m") == "628.3 rad/m"
    )
    assert (
        texts._output({"type": "tool_position", "axes": "xz", "size": 2})
        == "tool_position xz (2 scalars)"
    )
    assert (
        texts._output({"type": "combination", "axes": "", "size": 1}) == "combination (1 scalars)"
    )


def test_reasons_of_failed_cases() -> None:
    """Five reasons, of each five cases; the others are counted."""
    groups = [{"cases": [3], "reason": "alone"}, {"cases": [1, 2], "reason": "both"}]
    groups += [{"cases": list(range(10, 16)), "reason": "many"}]
    lines = texts.failure_lines(groups, "results.npz")
    assert lines == [
        "case 3 failed: alone",
        "2 cases failed (1, 2), for example case 1: both",
        "6 cases failed (10, 11, 12, 13, 14, ...), for example case 10: many",
    ]
    more = [{"cases": [k, k + 100], "reason": f"r{k}"} for k in range(7)]
    found = texts.failure_lines(more, "results.npz")
    assert (
        len(found) == 6 and found[-1] == "4 more cases failed for other reasons; see results.npz"
    )


def test_details_of_a_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Details that are empty are left out; the simulation has its own figures."""
    rows: list[Any] = []
    monkeypatch.setattr(texts, "figures", lambda given: rows.extend(given) or "figures")
    details = {"a_b": 2.5, "c": [], "d": None, "e": {}, "f": "", "g": [1, 2], "h": 0}
    run = Made(integrator="DOP853", evaluations=120, wall_s=0.5)
    for simulation, more in ((None, 0), (run, 3)):
        rows.clear()
        solution: Any = Made(details=details, simulation=simulation, status=flexgen.Status.SOLVED)
        text = texts.solution_details(solution)
        assert (
            rows[:3] == [("a b", 2.5, ""), ("g", "[1, 2]", ""), ("h", 0, "")]
            and len(rows) == 3 + more
        )
        assert text.startswith("figures\n\nsolved: ")
    assert rows[3:] == [
        ("integrator of the simulation", "DOP853", ""),
        ("evaluations of the equations of motion", 120, ""),
        ("wall time of the simulation", 0.5, "s"),
    ]
    bare: Any = Made(details={}, simulation=None, status=flexgen.Status.SOLVED)
    assert texts.solution_details(bare).startswith("solved: ")


def test_segments_of_a_path_and_files_of_a_library(monkeypatch: pytest.MonkeyPatch) -> None:
    segments = [
        Made(space="tool", start=start, law=Made(duration=duration), smoothness=5)
        for start, duration in ((0.0, 1.25), (1.25, 0.75))
    ]
    path: Any = Made(
        equations=Made(model=Made(name="r")),
        move=Made(name="line"),
        duration=2.0,
        notes=("the start is moved", "the samples are noisy"),
        warnings=("the samples are noisy",),
        segments=segments,
        smoothness=5,
        q_start=np.zeros(2),
    )
    lines = text_of_rows(flexgen.Path.content(path)).splitlines()
    assert lines[0] == "r, line: 2 s" and [line.split() for line in lines[-4:-2]] == [
        ["1", "tool", "0", "1.25", "5"],
        ["2", "tool", "1.25", "0.75", "5"],
    ]
    # A note that is also a warning is printed as a warning only.
    assert lines[-2:] == ["", "note: the start is moved"]
    reasons: list[str | None] = [None, "it has a beam"]
    monkeypatch.setattr(
        "flexgen.codegen.emission.c_functions.inversion_reason",
        lambda robot, functions: reasons.pop(0),
    )
    files = [Path("o/r.h"), Path("o/src/a.c"), Path("o/src/b.h"), Path("o/README.md")]
    robot: Any = Made(title="r@v")
    library: Any = Made(
        cached=False,
        seconds=1.26,
        written=files,
        directory=Path("o"),
        functions=["f", "g"],
        files=files,
    )
    assert texts.library_text(robot, library) == (
        "r@v: built in 1.3 s in o\n"
        "\n"
        "functions: f, g\n"
        "\n"
        "wrote o/r.h\n"
        "wrote o/README.md\n"
        "wrote o/src (2 sources)"
    )
    library.cached = True
    library.written = []
    assert texts.library_text(robot, library) == (
        "r@v: nothing has changed in o\n\nfunctions: f, g\n\n"
        "not in this library: invert and stream, because it has a beam"
    )


def test_errors_of_a_pose_are_lengths_and_an_angle() -> None:
    """Tools that are turned about z by 0.1 and 0.2 more than their references."""
    q = ca.SX.sym("q", 2)

    def turn(x: Any) -> Any:
        c = ca.cos(x)
        s = ca.sin(x)
        return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))

    functions = {
        "output": ca.Function("output", [q], [ca.vertcat(q[0], 2 * q[1])]),
        "forward_kinematics": ca.Function("f", [q], [ca.SX.zeros(3), turn(q[0])]),
    }
    equations: Any = Made(function=functions.__getitem__)
    at = np.array([[0.5, 1.0], [0.9, 2.0]])
    R = np.array([np.array(ca.DM(turn(x))) for x in (0.4, 0.7)])
    reference: Any = Made(y_ref=np.array([[0.25, 1.0], [1.0, 1.0]]), R_ref=R.reshape(2, 9))
    far, angle = output_errors(equations, reference, at)
    assert_allclose(far, [[0.25, 1.0], [-0.1, 3.0]], rtol=1e-14)
    assert angle is not None
    assert_allclose(angle, [0.1, 0.2], rtol=1e-7)
    reference.R_ref = None
    assert output_errors(equations, reference, at)[1] is None


def test_a_report_says_why_the_torque_begins_early() -> None:
    early, late = (
        Made(method="lq", trajectory=Made(time=np.array([t, 1.0]))) for t in (-0.1, 0.0)
    )
    full = Made(method="full", trajectory=early.trajectory)
    unstable, stable = (
        Made(zeros=Made(phase=phase)) for phase in ("non-minimum phase", "minimum phase")
    )
    told = {
        "because": (
            "It starts before the path because the zero dynamics is unstable: only "
            "pre-actuation keeps it"
        ),
        "none": "No zero is unstable, so no pre-actuation is needed.",
        "full": (
            "Before the path it results from the optimization, which weighs the tool error and "
            "changes of torque."
        ),
    }
    for solution, analysis, key in (
        (early, unstable, "because"),
        (late, unstable, "none"),
        (early, stable, "none"),
        (full, unstable, "full"),
    ):
        assert pictures._early_torque(solution, analysis).startswith(told[key])
    assert pictures._early_torque(early, None) == ""  # type: ignore[arg-type]


def test_a_report_says_where_errors_grow_after_the_samples() -> None:
    error = np.array([[0.0, 1e-3], [-2e-3, 0.0]])
    drawn = {"trajectory": {"error": error}}
    for m, rad, told in (
        (3.9e-3, None, False),
        (4.1e-3, None, True),
        (None, 4.1e-3, True),
        (1e-4, 4e-3, True),
    ):
        run = Made(tool_error_max_m=m, tool_error_max_rad=rad, **drawn)
        text = pictures._after_the_samples(Made(simulation=run))  # type: ignore[arg-type]
        assert (
            text.startswith(
                " The errors in the summary are larger: they also cover the time after"
            )
            == told
        )
        assert bool(text) == told
    none = Made(tool_error_max_m=None, tool_error_max_rad=None, **drawn)
    for solution in (Made(simulation=None), Made(simulation=none)):
        assert pictures._after_the_samples(solution) == ""  # type: ignore[arg-type]


def test_zeros_along_a_path_are_drawn_where_there_are_any(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(pictures, "Path", lambda equations, move: move)
    monkeypatch.setattr(
        pictures.along_path, "zeros_along", lambda model, found: drawn.append(found) or b"svg"
    )
    monkeypatch.setattr(pictures, "obstacle", lambda model, part: model.reason)
    equations: Any = Made(model=Made(n_e=1, reason=None))
    solution: Any = Made(move="line")
    some = Made(zeros=np.array([[np.nan, -3.0]]), verdict="all poses are minimum phase")
    monkeypatch.setattr(pictures, "zero_path", lambda equations, path: some)
    (picture,) = pictures._zeros_along(equations, solution)
    assert drawn == [some] and "zeros_along" in vars(picture).values()
    assert (
        "Zeros at the equilibrium poses along the path. All poses are minimum phase."
        in vars(picture).values()
    )
    none = Made(zeros=np.full((3, 2), np.nan), verdict="")
    monkeypatch.setattr(pictures, "zero_path", lambda equations, path: none)
    assert pictures._zeros_along(equations, solution) == []

    def fail(equations: Any, path: Any) -> Any:
        raise SolverError("singular")

    monkeypatch.setattr(pictures, "zero_path", fail)
    assert pictures._zeros_along(equations, solution) == []
    monkeypatch.setattr(pictures, "zero_path", lambda equations, path: some)
    for changes in ({"n_e": 0}, {"reason": "rigid"}):
        model = Made(**({"n_e": 1, "reason": None} | changes))
        assert pictures._zeros_along(Made(model=model), solution) == []  # type: ignore[arg-type]
    assert len(drawn) == 1


# --- pages ---------------------------------------------------------------------------------------
Page = tuple[Path, str, list[str]]


def pages_of(module: Any, monkeypatch: pytest.MonkeyPatch) -> list[Page]:
    """Arguments of `write_page` from a module: folder, text, and names of the pictures."""
    out: list[Page] = []

    def write(directory: Path, parts: list[str], drawn: list[Any]) -> Path:
        out.append((directory, "".join(parts), [picture.name for picture in drawn]))
        return directory / "index.html"

    monkeypatch.setattr(module, "write_page", write)
    return out


def test_the_page_of_a_score_has_its_parts_or_why_it_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    written = pages_of(control_page, monkeypatch)
    monkeypatch.setattr(control_page.plots, "plot_score", lambda score: "figure")
    scenario = Made(
        title="Two <masses>",
        title_line="two masses, 2 & 3",
        published="a plant",
        ours="a draw",
        rule="no force",
    )
    scenario.sets = {"soft": (1, 2), "late": (3,)}
    row = {
        "measure": "rise & fall",
        "unit": "s",
        "weight": 0.25,
        "reference": 0.5,
        "nominal": 0.75,
        "soft": 2.0,
        "late": 1e-5,
    }
    score: Any = Made(
        scenario=scenario,
        controller="mine",
        accepted=True,
        total=0.98765,
        parts={"nominal": 0.9, "soft": 1.23456},
        spread_words="worst draw 1.1",
        rule="not the published score",
        table=[row],
        refused=["the torque is too large"],
    )
    assert control_page.write_score(score, "page") == Path("page/index.html")
    folder, text, drawn = written[0]
    assert folder == Path("page") and drawn == ["score"]
    assert "<h1>Two &lt;masses&gt;: mine</h1>" in text and "two masses, 2 &amp; 3" in text
    assert (
        "<b>V = 0.9877</b> (nominal 0.9000, soft 1.2346; worst draw 1.1); the reference "
        "controller has about"
    ) in text
    for part in (
        "Published: a plant",
        "Of this project: a draw",
        "Rule: no force",
        "<b>not the published score</b>",
    ):
        assert part in text
    assert "<th>worst of soft</th>" in text.replace(' class="n"', "") and "refused" not in text
    cells = (
        "<td>rise &amp; fall</td><td>s</td><td>0.250</td><td>0.5</td><td>0.75</td><td>2</td><td>"
    )
    assert cells in text.replace(' class="n"', "")
    score.spread_words = score.rule = scenario.rule = ""
    control_page.write_score(score, "page")
    assert (
        "soft 1.2346); the reference controller" in written[1][1] and "Rule:" not in written[1][1]
    )
    score.accepted = False
    control_page.write_score(score, "page")
    text = written[2][1]
    assert "refused, no score" in text and "<li>the torque is too large</li>" in text
    assert "<h2>Measures</h2>" not in text and "V =" not in text and written[2][2] == ["score"]


def test_the_page_of_an_analysis_has_pictures_of_what_there_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    written = pages_of(analysis_page, monkeypatch)
    monkeypatch.setattr(
        analysis_page, "linear_pictures", lambda analysis, where: [Made(name=where)]
    )
    monkeypatch.setattr(analysis_page, "compliance_plot", lambda analysis: "figure")
    monkeypatch.setattr(analysis_page.along_path, "zeros_along", lambda model, path: path.verdict)
    monkeypatch.setattr(analysis_page, "dynamics_tables", lambda analysis: "<p>modes</p>")
    model = Made(
        title="arm@soft",
        description="one axis",
        coordinates=[Made(name="q1", unit="rad"), Made(name="s", unit="m")],
        motors=[Made(name="m1")],
    )
    rest = Made(q_a=np.array([0.5, -0.25]), tau_m=np.array([12.5]))
    some = Made(zeros=np.array([[np.nan, -3.0]]), verdict="all are stable")
    none = Made(zeros=np.full((2, 2), np.nan), verdict="none")
    soft = Made(matrix=np.eye(6))
    stiff = Made(matrix=np.zeros((6, 6)))
    base = ["at this equilibrium"]
    for compliance, path, warnings, names in (
        (soft, some, ("beware & look",), [*base, "compliance", "zeros_along"]),
        (stiff, some, (), [*base, "zeros_along"]),
        (None, none, (), base),
        (soft, None, (), [*base, "compliance"]),
    ):
        analysis: Any = Made(model=model, equilibrium=rest, compliance=compliance, zero_path=path)
        analysis.solvability = Made(warnings=warnings)
        assert analysis_page.write_analysis(analysis, "page") == Path("page/index.html")
        _, text, drawn = written[-1]
        assert drawn == names and ("beware &amp; look" in text) == bool(warnings)
        assert ('<div class="warn">' in text) == bool(warnings)
        plain = text.replace(' class="n"', "")
        assert (
            "<td>q1</td><td>0.5</td><td>rad</td>" in plain
            and "<td>m1</td><td>12.5</td><td>N m</td>" in plain
        )
        assert "<td>s</td><td>\N{MINUS SIGN}0.25</td><td>m</td>" in plain
        assert (
            "<h1>arm@soft: analysis of an equilibrium</h1>" in text
            and "one axis." in text
            and "modes" in text
        )


def test_the_page_of_another_result_is_its_table(monkeypatch: pytest.MonkeyPatch) -> None:
    written = pages_of(result_page, monkeypatch)
    rest = flexgen.Equilibrium(
        np.array([0.5]), np.array([50.0]), np.array([3.0]), np.array([300.0])
    )
    assert result_page.write_result(rest, "page") == Path("page/index.html")
    _, text, drawn = written[0]
    assert "<h1>Equilibrium</h1>" in text and rest._repr_html_() in text and drawn == []
    monkeypatch.setattr(flexgen.Equilibrium, "plot", lambda self: "figure")
    result_page.write_result(rest, "page")
    assert written[1][2] == ["picture"]


def test_the_page_of_a_result_with_tables_has_all_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """The table of notebooks has four entries of a dictionary: a page of a calibration had four
    numbers of 260.
    """
    written = pages_of(result_page, monkeypatch)
    rows = [[f"q{k}.zero", f"{k} < {k + 1}" + " and wide" * 20] for k in range(40)]
    monkeypatch.setattr(flexgen.Equilibrium, "to_text", lambda self: text_tables.table(rows))
    monkeypatch.setattr(flexgen.Equilibrium, "warnings", ("a < b",), raising=False)
    rest = flexgen.Equilibrium(
        np.array([0.5]), np.array([50.0]), np.array([3.0]), np.array([300.0])
    )
    with text_tables.fit_tables(60):  # of the terminal
        result_page.write_result(rest, "page")
    text = html.unescape(written[0][1])
    assert all(wide in text for _, wide in rows) and "<li>a < b</li>" in text
    assert (
        "<pre" in text and "a < b" not in written[0][1] and rest._repr_html_() not in written[0][1]
    )
