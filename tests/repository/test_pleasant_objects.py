"""Public objects in Python are printed, drawn, saved and converted: short texts, figures, reports,
tables, interpolation.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from toolchain import needs_compiler

import flexgen
from flexgen.base import registry
from flexgen.base.errors import ArgumentError
from flexgen.base.motion.trajectory import Trajectory
from flexgen.base.numerics.evaluate import evaluate
from flexgen.base.results import Result
from flexgen.base.spec.ports import Port
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.judge.status import Status


@pytest.fixture(scope="module")
def solution():
    return flexgen.solve("elbow")


def without(monkeypatch, package):
    """Make the import of a package fail."""
    for name in [name for name in sys.modules if name.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)


# --- texts ---------------------------------------------------------------------------------------


def test_a_printed_solution_has_six_lines(solution):
    lines = str(solution).splitlines()
    assert len(lines) == 6 and max(map(len, lines)) < 120
    assert lines[0].startswith(
        f"elbow, move {solution.move.name}: solved by method {solution.method} in "
    )
    assert lines[1].startswith("  tool error open loop up to ") and lines[2].startswith(
        "  defect "
    )
    largest = f"{np.abs(solution.trajectory['tau_m']).max():.4g} N m"
    assert largest in lines[3] and f"{len(solution.trajectory.time)} samples" in lines[4]
    assert lines[5] == "  warnings: none"


def test_the_printed_error_says_what_it_is(solution):
    assert "not measured" in str(replace(solution, simulation=None)).splitlines()[1]
    limited = str(replace(solution, status=Status.LIMITS_ACTIVE)).splitlines()
    assert "from the reference at the same time because limits are active" in limited[1]
    warned = str(replace(solution, warnings=("one\nand more", "two", "three"))).splitlines()
    assert warned[5:] == ["  warning: one and more", "  warning: two", "  warning: three"]


@needs_compiler
def test_objects_have_a_repr_of_one_line(solution, tmp_path):
    library = flexgen.load(
        flexgen.generate("elbow", tmp_path / "elbow", functions=["gravity"]).directory
    )
    expected = {
        repr(solution): "Solution elbow, move",
        repr(solution.trajectory): "Trajectory elbow: ",
        repr(solution.simulation): "Simulation elbow: tool error ",
        repr(flexgen.analyze("elbow")): "Analysis elbow: lowest mode ",
        repr(flexgen.read("elbow@fjm")): "RobotModel elbow@fjm: 2 motors, ",
        repr(library): "Library elbow: 1 function, double precision",
    }
    for text, start in expected.items():
        assert (
            text.startswith(f"<{start}")
            and text.endswith(">")
            and "\n" not in text
            and len(text) < 150
        )


def test_the_table_for_notebooks_is_escaped(solution):
    text = replace(solution, warnings=("<b>",))._repr_html_()
    assert text.startswith("<table>") and "&lt;b&gt;" in text and "<b>" not in text
    assert all(
        label in text
        for label in ("status", "motor torque, largest", "tool error open loop, largest")
    )


# --- figures and reports -------------------------------------------------------------------------


def test_solutions_and_analyses_plot_themselves(solution):
    analysis = flexgen.analyze("elbow")
    for figure, axes in ((solution.plot(), 3), (analysis.plot(), 3)):
        assert isinstance(figure, Figure) and len(figure.get_axes()) == axes
        assert figure._repr_svg_().startswith("<svg")  # what a notebook shows


@pytest.mark.slow
def test_a_solution_writes_its_report(solution, tmp_path):
    path = solution.report(tmp_path / "r")
    assert path == tmp_path / "r" / "index.html" and "<svg" in path.read_text(encoding="utf-8")


# Called by other functions, such as `flexgen.solve`, `plot`, `write` and the command line, and not
# methods.
INNER = (
    *(
        "Move.fastest",
        "Result.picture",
        "Result.content_as_text",
        "Result.content_as_html",
        "Commissioning.check_file",
        "Estimated.uncertainty",
        "FastestMove.torques",
        "Solution.positions",
    ),
    *("RobotModel.numbers", "Check.implausible"),
    *("Calibration.check_file", "Estimated.check_file", "GearFit.check_file"),
    "SpringFit.check_file",
)


def test_every_method_of_an_upper_package_is_there():
    for method in registry.own_names("results"):
        assert callable(registry.find_function(method)), method
        if method in INNER:
            continue
        cls = getattr(flexgen, method.partition(".")[0], Result)  # Result and Estimated are bases
        assert callable(getattr(cls, method.partition(".")[2]))


@pytest.mark.slow
def test_the_methods_import_nothing_before_they_are_called():
    code = (
        "import sys, flexgen; s = flexgen.solve('elbow', verify=False); print(s, s.plot)\n"
        "print('matplotlib' in sys.modules, 'pandas' in sys.modules)"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert out.splitlines()[-1] == "False False"


# --- trajectories --------------------------------------------------------------------------------


def test_a_trajectory_has_keys(solution):
    trajectory = solution.trajectory
    assert list(trajectory.keys()) == list(trajectory) == list(trajectory.channels)
    assert "tau_m" in trajectory and "time" not in trajectory
    assert dict(trajectory)["tau_m"] is trajectory["tau_m"]


def test_interpolation_meets_the_samples_and_the_equations(solution):
    trajectory = solution.trajectory
    t = trajectory.time
    at = trajectory.at(t)
    assert at.keys() == trajectory.keys()
    for name in trajectory:
        assert np.allclose(
            at[name], trajectory[name], rtol=0, atol=1e-9 * np.abs(trajectory[name]).max() + 1e-12
        ), name
    one = trajectory.at(float(t[7] + t[8]) / 2)
    many = trajectory.at([(t[7] + t[8]) / 2])
    assert all(np.array_equal(one[name], many[name][0]) for name in trajectory)
    equations = derive("elbow")
    q, motors = [[one[f"{x}_{kind}"] for x in "qva"] for kind in "am"]
    rows = np.concatenate(
        [r.ravel() for r in evaluate(equations.function("residual"), *q, *motors, one["tau_m"])]
    )
    # of second derivatives over a short interval
    rounding = 1e-9 * np.abs(trajectory["tau_g"]).max()
    assert np.abs(rows).max() <= 1.01 * solution.residual_max_Nm + rounding
    step = 1e-5
    low, high = (trajectory.at(float(t[7] + t[8]) / 2 + sign * step) for sign in (-1, 1))
    assert np.allclose((high["q_a"] - low["q_a"]) / (2 * step), one["v_a"], rtol=1e-6, atol=1e-9)


def test_the_torque_between_samples_is_that_of_the_simulation(solution):
    from flexgen.base.motion.torque_curve import torque_curve

    limited = replace(solution.trajectory, meta={**solution.trajectory.meta, "torque": "limited"})
    t = np.linspace(0.01, 0.2, 7)
    for trajectory, flag in ((solution.trajectory, False), (limited, True)):
        curve = torque_curve(trajectory.time, trajectory["tau_m"], limited=flag)
        assert np.array_equal(trajectory.at(t)["tau_m"], curve(t))


@pytest.mark.parametrize("t", [-99.0, 1e9, np.nan, "x", [0.0, 1e9], np.zeros((2, 2))])
def test_instants_outside_are_refused(solution, t):
    with pytest.raises(
        ArgumentError, match=r"^t: given .*, expected one or more instants from .* s$"
    ):
        solution.trajectory.at(t)


def test_each_column_has_its_unit(tmp_path):
    t = np.linspace(0.0, 1.0, 11)
    ports = {"q_a": Port("q_a", (2,), "rad or m", "arm")}
    channels = {"q_a": np.column_stack([t, t**2])}
    mixed = Trajectory(t, channels, ports, {"q_a": ("turn", "slide")}, {}, {"q_a": ("rad", "m")})
    assert mixed.columns() == ["q_a[turn] rad", "q_a[slide] m"]
    for name in ("a.csv", "a.npz"):
        back = Trajectory.load(mixed.save(tmp_path / name))
        assert back.units == mixed.units and back.ports["q_a"].unit == "rad or m"
    with pytest.raises(ArgumentError, match="channel q_a: given 3 units, expected 2"):
        Trajectory(t, channels, ports, mixed.labels, {}, {"q_a": ("rad", "m", "rad")})


@pytest.mark.parametrize(
    "model", ["elbow", pytest.param("beam_arm", marks=pytest.mark.slow), "four_mass@high"]
)
def test_units_of_a_solution_are_those_of_the_model(model):
    robot = flexgen.read(model)
    trajectory = flexgen.solve(robot, verify=False).trajectory
    units = tuple(c.unit for c in robot.coordinates)
    assert trajectory.units["q_a"] == units
    assert trajectory.units["a_a"] == tuple(f"{unit}/s^2" for unit in units)
    assert trajectory.units["tau_g"] == tuple(
        "N m" if units[i] == "rad" else "N" for i in robot.i_g
    )
    assert all(" or " not in column and "mixed" not in column for column in trajectory.columns())


@pytest.mark.slow
def test_a_trajectory_becomes_a_data_frame(solution, tmp_path):
    pandas = pytest.importorskip("pandas")
    trajectory = solution.trajectory
    frame = solution.to_dataframe()
    assert frame.index.name == "time s" and list(frame) == trajectory.columns()
    assert np.array_equal(frame.index, trajectory.time)
    path = trajectory.save(tmp_path / "a.csv")
    read = pandas.read_csv(path, comment="#", index_col="time s")
    pandas.testing.assert_frame_equal(read, frame, rtol=1e-14, atol=0.0)


def test_without_pandas_the_error_names_it(solution, monkeypatch):
    without(monkeypatch, "pandas")
    with pytest.raises(
        ArgumentError, match="the package pandas is not installed; run: pip install pandas"
    ):
        solution.to_dataframe()


@pytest.mark.slow
def test_a_trajectory_becomes_a_dataset(solution):
    pytest.importorskip("xarray")
    trajectory = solution.trajectory
    data = trajectory.to_xarray()
    assert data.attrs == trajectory.meta and data.time.attrs == {"units": "s"}
    assert np.array_equal(data.time, trajectory.time) and set(data.data_vars) == set(trajectory)
    for name in trajectory:
        assert np.array_equal(data[name], trajectory[name])
        assert list(data[f"{name}_column"].values) == list(trajectory.labels[name])
        assert data[name].attrs["long_name"] == trajectory.ports[name].doc
    motor = trajectory.labels["tau_m"][0]
    assert np.array_equal(data.tau_m.sel(tau_m_column=motor), trajectory["tau_m"][:, 0])
    assert data.tau_m.attrs["units"] == "N m"


def test_without_xarray_the_error_names_it(solution, monkeypatch):
    without(monkeypatch, "xarray")
    with pytest.raises(
        ArgumentError, match="the package xarray is not installed; run: pip install xarray"
    ):
        solution.trajectory.to_xarray()


# --- python-control ------------------------------------------------------------------------------


def test_without_control_the_error_names_it(monkeypatch):
    without(monkeypatch, "control")
    with pytest.raises(ArgumentError, match=r"pip install 'flexgen-robotics\[control\]'"):
        flexgen.analyze("elbow").to_control()


@pytest.mark.parametrize("name", ["planar5_nmp", "manutec_r3", "four_mass"])
def test_the_control_system_has_the_poles_and_the_response(name):
    pytest.importorskip("control")
    analysis = flexgen.analyze(name)
    system = analysis.to_control()
    model = analysis.model
    assert system.nstates == 2 * model.dof and system.ninputs == model.n_m
    assert system.noutputs == model.output.size + model.n_m
    motors = [m.name for m in model.motors]
    assert system.input_labels == [f"tau_m[{m}]" for m in motors]
    assert system.output_labels[-model.n_m :] == [f"q_m[{m}]" for m in motors]
    assert system.state_labels[: model.n_a] == [f"q_a[{c.name}]" for c in model.coordinates]
    assert all(label.startswith("d_q_") for label in system.state_labels[model.dof :])
    named = analysis.to_control(units=True)
    plain = [system.input_labels, system.output_labels, system.state_labels]
    for words, bare in zip(
        [named.input_labels, named.output_labels, named.state_labels], plain, strict=True
    ):
        assert all(word.startswith(f"{name} ") for word, name in zip(words, bare, strict=True))
    assert named.input_labels[0].endswith("] N m") and named.output_labels[-1].endswith("] rad")
    assert named.state_labels[0] == f"{system.state_labels[0]} {model.coordinates[0].unit}"
    assert named.state_labels[model.dof].endswith(f" {model.coordinates[0].unit}/s")
    w = 2 * np.pi * np.array([0.5, 5.0, 50.0])
    C = np.vstack([analysis.linear.W, analysis.linear.C_m])
    expected = analysis.linear.response(w, C)
    found = np.array([system(1j * x, squeeze=False) for x in w])
    assert np.abs(found - expected).max() <= 1e-6 * np.abs(expected).max()
