"""The two-point boundary value problem of the zero dynamics: its agreement with others, what it
refuses.
"""

from __future__ import annotations

import ctypes
import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from emitted import loaded, made, run
from inversion_cases import given, last_joint, question
from scipy.interpolate import make_interp_spline
from toolchain import CC, STRICT, STRICT_CPP, needs_compiler, tool

import flexgen
from flexgen.analysis.linear import linearize
from flexgen.analysis.zero_dynamics.zeros import inner_zeros
from flexgen.base.errors import ArgumentError, SolverError
from flexgen.dynamics.mechanics.equations import Equations
from flexgen.dynamics.mechanics.signatures import INVERSION
from flexgen.dynamics.mechanics.statics import equilibrium_at
from flexgen.inversion.judge.status import Status
from flexgen.inversion.methods import bvp, collocation, lq
from flexgen.inversion.problem.problem import InversionProblem
from flexgen.inversion.unverified_solution import make_solution
from flexgen.model.elements import Placement, RobotModel
from flexgen.model.reader import read
from flexgen.runtime import load
from flexgen.runtime.structs import struct_of, structs_of
from flexgen.simulation.simulate import simulate

pytestmark = needs_compiler

PLANAR = ["planar5_mp", "planar5_nmp", "planar5_soft"]
ROBOTS = FilePath(__file__).parents[1] / "support" / "robots"
# On the mesh the equations hold to rounding: about 1e-16 of their scale, times the condition of
# the rows.
ROUNDING = 1e-12
# lq finds the same motion on the same mesh, but for what its weights of 1e-12 and its tolerance of
# 1e-6 move: in six axes they leave slow fading motions after the path.
SAME_MESH = 1e-8
SAME_MESH_SIX_AXES = 1e-6
# Long enough before the path for both: lq starts at exact rest, this with what grows.
EARLY = 0.1
# The same with a tolerance of 1e-9.
SAME_START = 1e-10
# The torque of collocation, of its own mesh and interpolation: the difference is fourth order,
# some 1e-6 at 5 ms.
OTHER_MESH = 2e-5
OTHER_MOTION = 2e-9  # rad, of deflections of some 1e-3
MICRON = 1e-6


def usual(problem: InversionProblem) -> float:
    """The mesh [s] that solve begins with."""
    return min(problem.path.duration / 100, 5e-3)


def flat_arm() -> RobotModel:
    """The planar arm with its tool where I_eff = j + m xi^2 - m xi l is zero."""
    model = read("planar5_nmp")
    body = model.elements[2].body
    assert body is not None
    xi = body.com[0]
    return replace(
        model,
        tool=Placement(((body.inertia[2][2] + body.mass * xi**2) / (body.mass * xi), 0.0, 0.0)),
    )


def unstable_zeros(equations: Equations, q_a: np.ndarray) -> int:
    rest = equilibrium_at(equations, q_a)
    return int(np.sum(inner_zeros(equations, linearize(equations, rest), rest).real > 0))


# --- agreement -----------------------------------------------------------------------------------
@pytest.mark.parametrize("name", [*PLANAR, "manutec_r3_18"])
@pytest.mark.slow
def test_it_agrees_with_the_other_methods(name: str) -> None:
    problem = question(name, preview=EARLY)
    answer = bvp.solve(problem, usual(problem))
    assert answer.details["residual"] < ROUNDING
    i_e = list(problem.equations.model.i_e)
    same = lq.solve(problem, usual(problem))
    size = np.abs(answer.motors.tau_m).max(axis=0)
    assert np.array_equal(same.t, answer.t)
    most = SAME_MESH if name in PLANAR else SAME_MESH_SIX_AXES
    assert np.abs((same.motors.tau_m - answer.motors.tau_m) / size).max() < most
    if name not in PLANAR:  # there collocation takes minutes; the simulation judges
        solution = make_solution(problem, "bvp", answer)
        assert (
            simulate(
                problem.equations, solution.trajectory, start=problem.equilibrium
            ).tool_error_max_m
            or 0.0
        ) < MICRON / 10
        return
    other = collocation.solve(problem, usual(problem))
    inside = (other.t >= answer.t[0]) & (other.t <= answer.t[-1])
    tau, q = (
        make_interp_spline(answer.t, x, k=7)(other.t[inside])
        for x in (answer.motors.tau_m, answer.q)
    )
    assert np.abs((tau - other.motors.tau_m[inside]) / size).max() < OTHER_MESH
    assert np.abs((q - other.q[inside])[:, i_e]).max() < OTHER_MOTION


@pytest.mark.parametrize("name", PLANAR)
@pytest.mark.slow
def test_the_tool_stays_on_the_path(name: str) -> None:
    """On a mesh of 10 ms within 0.15 um, of 5 ms within 0.009 um."""
    for mesh, most in ((1e-2, 0.15 * MICRON), (5e-3, 0.009 * MICRON)):
        problem = question(name, mesh=mesh)
        solution = make_solution(problem, "bvp", bvp.solve(problem, mesh))
        assert (
            simulate(
                problem.equations, solution.trajectory, start=problem.equilibrium
            ).tool_error_max_m
            or 0.0
        ) < most


def test_it_is_a_method_of_solve() -> None:
    solution = flexgen.solve("planar5_nmp", method="bvp")
    assert solution.method == "bvp" and solution.status == Status.SOLVED
    assert solution.tool_error_max_m is not None and solution.tool_error_max_m < MICRON / 10
    assert solution.details["unstable_zeros_start"] == 1


@pytest.mark.parametrize("name", PLANAR)
def test_boundary_conditions_select_stable_and_unstable_subspaces(name: str) -> None:
    """As many unstable zeros as another algorithm finds; at the ends the motion is the one that
    belongs to them.
    """
    problem = question(name)
    answer = bvp.solve(problem, usual(problem))
    equations = problem.equations
    (e,) = problem.equations.model.i_e
    poses = (answer.q[0], answer.q[-1])
    found = [answer.details[f"unstable_zeros_{end}"] for end in ("start", "end")]
    assert found == [unstable_zeros(equations, q) for q in poses]
    if name == "planar5_mp":  # all fades: the start is exact rest
        assert (
            np.abs(answer.v[0]).max() < 1e-12
            and np.abs(answer.q[0] - problem.equilibrium.q_a).max() < 1e-12
        )
        return
    # one real zero of either sign: v_e = z (q_e - rest). With a short window the distance from
    # rest is well above rounding; what is left is of the second order in it.
    short = question(name, mesh=1e-3, preview=3e-3)
    early = bvp.solve(short, 1e-3)
    rest = equilibrium_at(equations, problem.equilibrium.q_a)
    zeros = inner_zeros(equations, linearize(equations, rest), rest).real
    assert early.v[0, e] / (early.q[0, e] - problem.equilibrium.q_a[e]) == pytest.approx(
        zeros.max(), rel=1e-3
    )


# --- what it refuses -----------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("model", "words"),
    [
        (flat_arm, "goes through infinity on the path; use invert .method lq"),
        (
            lambda: last_joint(read("planar5_mp"), 1.0, 0.0),
            "on the imaginary axis.*; use invert .method lq",
        ),
        (
            lambda: ROBOTS / "spatial.toml",
            "number of unstable zeros differs.*; use invert .method lq",
        ),
    ],
    ids=["flat", "undamped", "zeros change"],
)
def test_moves_that_bvp_refuses_are_solved_by_lq(model, words: str) -> None:
    problem = question(model())
    with pytest.raises(SolverError, match=words):
        bvp.solve(problem, usual(problem))
    assert lq.solve(problem, usual(problem)).details["residual"] < lq.TOLERANCE


@pytest.mark.slow
def test_bvp_solves_near_the_flat_point() -> None:
    """With zeros at some +-10^5 1/s, a tool a few micrometres further out."""
    model = flat_arm()
    problem = question(
        replace(model, tool=Placement(((1 + 1e-5) * model.tool.position[0], 0.0, 0.0)))
    )
    answer = bvp.solve(problem, usual(problem))
    assert answer.details["unstable_zeros_start"] == answer.details["unstable_zeros_end"] == 1


def test_it_needs_coordinates_without_motor() -> None:
    with pytest.raises(ArgumentError, match=r"no coordinates without motor.*use closed-form"):
        bvp.solve(question("elbow"), 5e-3)
    with pytest.raises(
        ArgumentError,
        match=r"parts: given 'bvp', but model elbow has no coordinates without motor",
    ):
        made("elbow", "bvp")


def test_a_library_has_it_only_where_it_was_asked_for() -> None:
    texts = "".join(
        path.read_text() for path in made("planar5_nmp").files if path.suffix in (".c", ".h")
    )
    assert "planar5_nmp_bvp" not in texts
    with pytest.raises(
        ArgumentError, match=r"without bvp, expected one .* with parts=\['bvp'\] \(--with bvp\)"
    ):
        _ = loaded("planar5_nmp").bvp
    with pytest.raises(ArgumentError, match="parts: given 'lq', expected some of bvp"):
        made("planar5_nmp", "lq")


def test_options_that_it_does_not_know_are_refused() -> None:
    with pytest.raises(ArgumentError, match="method bvp was given 'weight'"):
        bvp.solve(replace(question("planar5_mp"), options={"weight": 1}), 5e-3)


@pytest.mark.slow
def test_the_library_offers_it() -> None:
    library = loaded("planar5_nmp", "bvp")
    answer = library.bvp(**given())
    assert (
        (answer.unstable_zeros_start, answer.unstable_zeros_end) == (1, 1)
        and answer.iterations >= 1
        and answer.residual < ROUNDING
    )
    same = library.invert(**given())
    assert np.abs(answer.tau_m - same.tau_m).max() < SAME_START * np.abs(same.tau_m).max()
    again = pickle.loads(pickle.dumps(library.bvp))
    assert np.array_equal(again(**given()).tau_m, answer.tau_m)
    assert repr(again).startswith("bvp(y, dy, ddy")
    with pytest.raises(SolverError, match="bvp: the path leaves the workspace"):
        library.bvp(**given(y=10.0 * given()["y"]))
    with pytest.raises(ArgumentError, match="bvp, dy: given shape"):
        library.bvp(**given(dy=np.zeros((3, 2))))
    with pytest.raises(ArgumentError, match="an input is not finite"):
        library.bvp(**given(q_start=np.full(3, np.nan)))
    closed = load(made("planar5_nmp", "bvp").directory)
    kept = closed.bvp
    closed.close()
    with pytest.raises(ArgumentError, match="closed"):
        kept(**given())


# --- planted bugs --------------------------------------------------------------------------------
PLANTED = {
    "rows swapped": [
        ("&at, 1, b->first", "&at, 0, b->first"),
        ("&at, 0, b->last", "&at, 1, b->last"),
    ],
    "equilibrium forgotten": [
        (
            "b->equilibrium_start[NE + i] = b->equilibrium_end[NE + i] = 0.0;",
            (
                "b->equilibrium_start[NE + i] = b->equilibrium_end[NE + i] = 0.0; "
                "b->equilibrium_end[i] = 0.0;"
            ),
        )
    ],
    "wrong interval length": [
        (
            "b->m = mesh_in(&l, p, options, work);",
            "b->m = mesh_in(&l, p, options, work); b->m.h *= 0.999;",
        )
    ],
}


def call(folder: FilePath) -> tuple[int, np.ndarray]:
    """Status and motor torques of ``planar5_nmp_bvp`` in a folder's sources."""
    files = [f"src/planar5_nmp_{name}.c" for name in (*INVERSION, "inversion", "linearize")]
    run(
        CC, "-std=c99", "-O1", "-fPIC", "-shared", *files, "-lm", "-o", "planted.so", folder=folder
    )
    library = ctypes.CDLL(str(folder / "planted.so"))
    structs = structs_of(json.loads((folder / "manifest.json").read_text()))
    asked = given()
    n = len(asked["y"])
    total = n + asked["n_pre"] + asked["n_post"]
    counts = {key: asked[key] for key in ("n_pre", "n_post", "samples_per_interval")}
    options = struct_of(structs["inversion_options"], **counts, tolerance=1e-6)
    library.planar5_nmp_bvp_work.restype = ctypes.c_int64
    work = np.zeros(library.planar5_nmp_bvp_work(ctypes.c_int(n), ctypes.byref(options)))
    arrays = {key: np.ascontiguousarray(asked[key]) for key in ("y", "dy", "ddy")}
    q = np.ascontiguousarray(asked["q_start"])
    tau = np.zeros((total, 2))
    path = struct_of(structs["samples"], n=n, period=asked["period"], **arrays)
    motion = struct_of(structs["motion"], tau_m=tau)
    info = structs["bvp_info"]()
    status = library.planar5_nmp_bvp(
        *(ctypes.byref(path), ctypes.c_void_p(q.ctypes.data), ctypes.byref(options)),
        *(ctypes.byref(motion), ctypes.byref(info)),
        *(ctypes.c_void_p(work.ctypes.data), ctypes.c_int64(work.size)),
    )
    return status, tau


@pytest.mark.parametrize("bug", PLANTED)
@pytest.mark.slow
def test_planted_bugs_are_caught(bug: str, tmp_path: FilePath) -> None:
    folder = FilePath(shutil.copytree(made("planar5_nmp", "bvp").directory, tmp_path / "planted"))
    right = loaded("planar5_nmp").invert(**given())
    size = np.abs(right.tau_m).max()
    file = folder / "src" / "planar5_nmp_inversion.c"
    text = file.read_text()
    for old, new in PLANTED[bug]:
        assert text.count(old) == 1
        text = text.replace(old, new)
    file.write_text(text)
    status, tau = call(folder)
    assert status < 0 or not np.abs(tau - right.tau_m).max() < SAME_START * size


# --- compilers -----------------------------------------------------------------------------------
@pytest.mark.parametrize("compiler", ["gcc", "clang", "g++", "clang++"])
@pytest.mark.slow
def test_strict_compilers_report_no_warning(compiler: str, tmp_path: FilePath) -> None:
    flags = STRICT_CPP if compiler.endswith("++") else [*STRICT, "-O2"]
    file = made("planar5_nmp", "bvp").directory / "src" / "planar5_nmp_inversion.c"
    run(tool(compiler), *flags, "-c", file, "-o", "inversion.o", folder=tmp_path)
