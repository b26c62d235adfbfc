"""Which tests are slow: `make test` runs the others, `make test-slow` these.

A test is slow where

- its folder or file stands in ``SLOW``,
- `tests/durations.json` has it: `durations` records there what takes more than 0.6 s,
- it has ``@pytest.mark.slow``: for what needs no measurement.

A test that the file does not know is quick.
"""

from __future__ import annotations

from pathlib import Path

from durations import Recorded, read

ROOT = Path(__file__).resolve().parents[2]
# Folders (with a slash at the end) and files: convergence orders, cross compilers, sanitizers, the
# wheel, libraries that only one file needs.
SLOW = (
    "order/",
    "client/test_amalgamation.py",
    "client/test_cross_compile.py",
    "client/test_extensions.py",
    "client/test_hostile_inversion.py",
    "client/test_hostile_sanitizers.py",
    "client/test_kernel_compilers.py",
    "client/test_stream_constants.py",
    "client/test_wheel.py",
    "cross/test_states_in_commands.py",
    "fuzz/test_fuzz.py",
    "codegen/test_single_precision.py",
    "inversion/test_inversion_parameters.py",
)
# Slow tests, by file or function, that compile much C and run it for a short time: without
# optimization its bits are the same, and these tests take half the time, as do the quick ones. The
# others compile as users do.
UNOPTIMIZED = (
    "client/test_amalgamation.py",
    "client/test_docs.py",
    "client/test_extensions.py",
    "client/test_fmu_import.py",
    "client/test_hostile_inversion.py",
    "client/test_inverse_kinematics.py",
    "client/test_invert_limited.py",
    "client/test_lab_evening.py",
    "client/test_path_sampler.py",
    "client/test_product.py",
    "client/test_stream_constants.py",
    "cross/test_bvp.py",
    "cross/test_cuda_kernels.py",
    "cross/test_export_mex.py",
    "cross/test_export_plcopen.py",
    "cross/test_export_ros2.py",
    "cross/test_export_simulink.py",
    "cross/test_force_in_control.py",
    "cross/test_force_sensors.py",
    "cross/test_gear_friction_in_c.py",
    "cross/test_growth.py",
    "cross/test_hysteresis_in_c.py",
    "cross/test_inversion_accuracy.py",
    "cross/test_inversion_functions.py",
    "cross/test_jax.py",
    "cross/test_limits_on_real_drives.py",
    "cross/test_lugre_in_c.py",
    "cross/test_position_commands_in_c.py",
    "cross/test_process_force.py",
    "cross/test_settled.py",
    "cross/test_transmission_error.py",
    "cross/test_trees.py::test_the_joints_of_all_branches_follow_in_mujoco",
    "inversion/test_end_of_the_move.py",
    "exports/test_fmu_memory.py",
    "exports/test_fmu_plant.py",
    "exports/test_fmu_sampled.py",
    "inversion/test_generated_robots.py",
    "feedback/test_impedance.py",
    "planning/test_learning.py",
    "identification/test_load_and_collision.py::test_a_load_is_found_in_spite_of_wrong_springs",
    "feedback/test_loop_shaping.py",
    "feedback/test_model_laws.py",
    "feedback/test_observers.py",
    "codegen/test_single_precision.py",
    "inversion/test_solve.py",
    "runtime/test_stream.py",
    "runtime/test_stream_moving.py",
    "runtime/test_stream_parts.py",
    "order/test_inversion_order.py::test_points_of_a_lower_order_are_seen",
    "cli/test_cli.py::test_a_missed_tolerance_is_a_failure_with_its_figures",
    "cli/test_cli.py::test_generate_with_options",
    "codegen/test_codegen.py",
    "backends/test_cuda.py",
    "repository/test_docstring_examples.py",
    "codegen/test_generate.py",
    "simulation/test_held_torques.py",
    "inversion/test_inversion_parameters.py",
    "runtime/test_limits_stream.py",
    "runtime/test_many_inversion.py",
    "dynamics/test_parameters.py",
    "inversion/test_solve_stages.py",
    "runtime/test_stream_memory.py",
)
# Quick tests of optimized code, and tests and cases that run C for a long time: simulated
# experiments above all.
OPTIMIZED = (
    "client/test_instruction_sets.py",
    "cross/test_loop_lugre.py",
    "studies/test_benchmark_draws.py",
    "studies/test_benchmarks.py",
    "identification/test_causes.py",
    "identification/test_frequency_responses.py",
    "identification/test_identify.py",
    "identification/test_identify_with_torques.py",
    "identification/test_structure_search.py",
    "identification/test_transients_and_averages.py",
    "identification/test_time_domain.py",
    "cli/test_cli_identify.py",
)
OPTIMIZED_CASES = {
    "client/test_docs.py": {"docs/control.md", "flexgen/studies/scenarios/README.md"},
    "repository/test_docstring_examples.py": {
        "tune",
        "TuningResult",
        "score",
        "Score",
        "identify_servo",
    },
}
RECORDED: Recorded = read()
# Slow tests of less [s] compile as quick ones do: optimization would be most of their time.
SHORT_S = 5.0


def full(path: str, name: str, words: str) -> bool:
    """Whether a case runs with the full tests only; parameters as of `slow`."""
    return words in RECORDED.full.get(Path(path).name, {}).get(name, ())


def unoptimized(path: str, name: str, words: str, quick: bool) -> bool:
    """Whether a test compiles without optimization; ``name``: of its function."""
    duration = RECORDED.slow.get(Path(path).name, {}).get(name, {}).get(words)
    short = quick or (duration is not None and duration < SHORT_S)
    listed = short or path in UNOPTIMIZED or f"{path}::{name}" in UNOPTIMIZED
    return listed and path not in OPTIMIZED and words not in OPTIMIZED_CASES.get(path, ())


def slow(path: str, name: str, words: str) -> bool:
    """Whether folder or duration make a test slow.

    Parameters
    ----------
    path : str
        The file, relative to ``tests``.
    name : str
        The function.
    words : str
        The id of the case, such as ``planar5_nmp@undamped-lq``; empty without parameters.
    """
    if any(path == entry or (entry.endswith("/") and path.startswith(entry)) for entry in SLOW):
        return True
    return words in RECORDED.slow.get(Path(path).name, {}).get(name, ())
