"""All methods that apply find the same torque: on a minimum phase arm also those that march from
the start.

They share the equations and the path, but neither the discretisation nor the linear algebra.
"""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline
from toolchain import needs_compiler

import flexgen
from flexgen.base.errors import ArgumentError
from flexgen.dynamics.mechanics.equations import derive
from flexgen.inversion.methods.method_table import AUTO, methods

# of the largest torque of the motor; the first differences of tau_g in the C methods are good to
# some 1e-5, the torque of the full method ripples between its Gauss points
AGREE = {
    "bvp": 1e-8,
    "collocation": 3e-5,
    "discretized": 3e-5,
    "bdf": 3e-5,
    "reduced": 3e-5,
    "kunkel-mehrmann": 3e-5,
    "full": 2e-2,
}
# With 24 degrees of freedom the weights of lq, which bvp does without, leave a residual of 1e-8:
# 5e-10 rad of a deflection of 1e-3 rad. The motor torque has the second derivative of the gear
# torque in it, by differences over 1 ms, and is apart by 9e-6 at the end of the path.
SIX_AXES = 2e-5
DEFLECTION = 2e-9
CAUSAL = ("bdf", "reduced", "kunkel-mehrmann")


def difference(one: flexgen.Trajectory, other: flexgen.Trajectory, end: float) -> float:
    """Largest difference of the motor torques on the path, of the largest torque of the motor."""
    exact = make_interp_spline(one.time, one["tau_m"], k=5)
    on_path = (other.time >= max(0.0, one.time[0])) & (other.time <= end)
    scale = np.abs(one["tau_m"]).max(axis=0)
    return float((np.abs(other["tau_m"][on_path] - exact(other.time[on_path])) / scale).max())


@pytest.mark.parametrize("name", ["planar5_mp", "planar5_nmp"])
def test_methods_agree(name: str) -> None:
    equations = derive(name)
    best = flexgen.solve(equations, method="lq", verify=False)
    for method, tolerance in AGREE.items():
        if name == "planar5_nmp" and method in CAUSAL:
            with pytest.raises(
                ArgumentError, match=r"unstable, with a zero at \+891\.8 1/s.*use lq, bvp"
            ):
                flexgen.solve(equations, method=method)
            continue
        answer = flexgen.solve(equations, method=method, verify=False)
        assert difference(best.trajectory, answer.trajectory, best.move.duration) < tolerance, (
            method
        )


@pytest.mark.full
@needs_compiler
def test_lq_and_bvp_agree_on_six_axes() -> None:
    """With three unstable zeros at either end, where the methods by IPOPT are too slow to be
    tried.
    """
    equations = derive("manutec_r3_24")
    lq, bvp = (flexgen.solve(equations, method=method, verify=False) for method in ("lq", "bvp"))
    one = bvp.trajectory
    other = lq.trajectory
    end = lq.move.duration
    assert bvp.details["unstable_zeros_start"] == bvp.details["unstable_zeros_end"] == 3
    assert difference(one, other, end) < SIX_AXES
    apart = (one["q_a"] - other["q_a"])[(one.time >= 0) & (one.time <= end)]
    assert np.abs(apart[:, list(equations.model.i_e)]).max() < DEFLECTION
    # the control: late by a tenth of a sample
    assert difference(one, replace(other, time=other.time + 1e-4), end) > 10 * SIX_AXES


def test_a_torque_delayed_by_a_sample_does_not_agree() -> None:
    """The control: one sample of delay is 100 times what the methods differ by."""
    solution = flexgen.solve("planar5_nmp", method="lq", verify=False)
    t = solution.trajectory.time
    tau = solution.trajectory["tau_m"]
    late = flexgen.Trajectory(
        t,
        {"tau_m": np.vstack([tau[:1], tau[:-1]])},
        {"tau_m": solution.trajectory.ports["tau_m"]},
        {"tau_m": solution.trajectory.labels["tau_m"]},
    )
    assert (
        difference(solution.trajectory, late, solution.move.duration) > 100 * AGREE["collocation"]
    )


def test_every_method_is_in_the_command_line_and_has_its_function() -> None:
    from flexgen.cli.parser import build_parser

    for name in (AUTO, *methods()):
        assert build_parser().parse_args(["solve", "elbow", "--method", name]).method == name
    for method in methods().values():
        assert callable(getattr(import_module(method.module), method.function))


def test_weights_and_mesh_are_the_solvers_own() -> None:
    """The user asks for an accuracy; what no method knows is refused."""
    with pytest.raises(
        ArgumentError, match="options: method lq was given 'weight', expected one of"
    ):
        flexgen.solve("planar5_mp", method="lq", options={"weight": 1.0})
