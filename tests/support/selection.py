"""Which tests are slow: `make test` runs the others, `make test-slow` these.

A test is slow where

- its folder or file stands in ``SLOW``,
- it runs on a model that is not in ``QUICK_MODELS``, by the words of its id; files in ``ANY_MODEL`` are excepted,
- its case stands in ``SLOW_CASES`` or ``FULL_CASES``,
- it has ``@pytest.mark.slow``: for what the folder and the model do not say.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
QUICK_MODELS = {"elbow", "planar5_nmp", "beam_arm", "manutec_r3"}
# Folders (with a slash at the end) and files: convergence orders, cross compilers, sanitizers, the wheel, libraries
# that only one file needs.
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
    "fuzz/test_fuzz.py",
    "laws/test_single_precision.py",
    "unit/test_inversion_parameters.py",
)
# Files that read or analyze each model in some milliseconds.
ANY_MODEL = (
    "golden/test_emitted_hashes.py",
    "published/test_analysis.py",
    "unit/test_reader.py",
    "unit/test_solvability.py",
    "unit/test_structure.py",
    "unit/test_zero_path.py",
)
# Files that compile much C and run it for a short time: without optimization its bits are the same, and these tests
# take half the time. The others compile as users do.
UNOPTIMIZED = (
    "client/test_batch_strided.py",
    "client/test_hostile_inversion.py",
    "client/test_inverse_kinematics.py",
    "client/test_path_sampler.py",
    "cross/test_bvp.py",
    "cross/test_force_sensors.py",
    "cross/test_gear_friction_in_c.py",
    "cross/test_hysteresis_in_c.py",
    "cross/test_inversion_accuracy.py",
    "cross/test_inversion_functions.py",
    "cross/test_lugre_in_c.py",
    "cross/test_position_commands_in_c.py",
    "cross/test_process_force.py",
    "cross/test_settled.py",
    "cross/test_transmission_error.py",
    "laws/test_end_of_the_move.py",
    "laws/test_fmu_sampled.py",
    "laws/test_generated_robots.py",
    "laws/test_impedance.py",
    "laws/test_model_laws.py",
    "laws/test_stream.py",
    "unit/test_codegen.py",
    "unit/test_held_torques.py",
    "unit/test_inversion_parameters.py",
    "unit/test_many_inversion.py",
    "unit/test_parameters.py",
)
# Cases whose robot or method takes long, by a word of the id or the whole id.
SLOW_CASES = {
    "client/test_docs.py": {
        "docs/calibration.md",
        "README.md",
        "docs/python.md",
        "docs/limits_and_streams.md",
        "docs/paths.md",
        "docs/identification.md",
        "docs/five_minutes.md",
        "docs/cluster.md",
        "docs/concepts.md",
        "docs/control.md",
        "docs/equations.md",
        "docs/matlab.md",
        "docs/plc.md",
        "docs/ros2.md",
        "docs/theory.md",
        "docs/exchange.md",
        "docs/fmu.md",
        "docs/planning.md",
        "docs/arrays.md",
        "docs/contact.md",
        "docs/hysteresis.md",
        "docs/positions.md",
        "docs/friction_with_state.md",
        "docs/load_and_temperature.md",
        "docs/transmission_error.md",
        "docs/own_robot.md",
        "docs/process_force.md",
        "docs/jax.md",
        "docs/verification.md",
        "flexgen/gears/README.md",
        "flexgen/servo/README.md",
        "generated/README.md",
    },
    "client/test_batch_strided.py": {
        "17-17-planar5_nmp-inversion_jacobians",
        "17-17-planar5_nmp-inverse_dynamics_derivatives",
    },
    "client/test_instruction_sets.py": {"beam_arm", "elbow", "planar5_nmp", "v2", "v3", "v4"},
    "client/test_inverse_kinematics.py": {"v2", "v3", "v4"},
    "client/test_invert_limited.py": {
        "torque_rate_max-0.9",
        "tool_acceleration_max-0.9",
        "joint_acceleration_max-0.9",
        "elbow",
    },
    "client/test_notebooks.py": {"first_robot"},
    "client/test_packaged_compiler.py": {"elbow"},
    "client/test_product.py": {"planar5_nmp-gcc--O0", "planar5_nmp-gcc--O2", "elbow-gcc--O2"},
    "cross/test_recursion.py": {
        "dense7",
        "dense12",
        "sliding8",
        "ur5_elastic",
        "panda",
        "synthetic_complete",
        "synthetic_elastic",
        "synthetic_mixed",
        "synthetic_rigid",
        "synthetic_spinning",
    },
    "cross/test_cuda_kernels.py": {"elbow"},
    "cross/test_loop_hysteresis.py": {"deflection_rates--1.0", "deflection_rates-0.9"},
    "cross/test_loop_lugre.py": {"motor_force--1.0"},
    "cross/test_process_force.py": {"planar5_nmp", "elbow"},
    "cross/test_bvp.py": {"undamped", "zeros change", "flat", "clang", "wrong interval length", "rows swapped"},
    "cross/test_comparison.py": {"joints of both units"},
    "cross/test_export_ros2.py": {"div", "signal"},
    "cross/test_cross.py": {
        *("synthetic_beam", "synthetic_complete", "synthetic_mixed", "synthetic_spinning"),
        *("synthetic_elastic-newton_euler", "synthetic_rigid-newton_euler", "undamped", "soft"),
    },
    "cross/test_end_of_path.py": {"lq"},
    "cross/test_hysteresis_in_c.py": {"several", "planar5_nmp"},
    "cross/test_inversion_functions.py": {"ur5_elastic"},
    "cross/test_lugre_in_c.py": {"planar5_nmp"},
    "cross/test_lugre_in_mujoco.py": {"elbow"},
    "cross/test_position_commands_in_c.py": {"delay", "order"},
    "cross/test_referees.py": {
        "any-simplified",
        "any-complete",
        "linear-complete",
        "linear-simplified",
        "ur5_elastic",
        "panda",
    },
    "cross/test_states_in_commands.py": {"hysteresis", "lugre"},
    "cross/test_symbolic.py": {"planar5_nmp", "skew", "arm-complete", "arm-complete-rigid", "arm-simplified"},
    "laws/test_amplitude.py": {"nothing", "Coulomb friction"},
    "laws/test_hysteresis_elements.py": {"3.7--0.4", "1.5-0.0", "elements0-9000.0", "one element"},
    "laws/test_causes.py": {
        "sample time 1 % longer than stated",
        "all masses 5 % larger",
        "angle of m2 5 % too large in the record",
        "exchanged angles of m1 and m2",
        "angles in degrees, read as radians,",
        "exchanged torques of m1 and m2",
        "torques that act 0.3 ms later than stated",
    },
    "laws/test_end_of_the_move.py": {"beam_arm"},
    "laws/test_fmu_sampled.py": {"6.0"},
    "laws/test_hold.py": {"hold1-False", "hold2", "hold3-True", "hold4", "hold5", "hold6"},
    "laws/test_identify.py": {"transposed"},
    "laws/test_laws.py": {"synthetic_beam", "synthetic_complete", "synthetic_mixed", "synthetic_spinning"},
    "laws/test_observers.py": {
        "1.0",
        "case0-first order",
        "outputs2",
        "outputs3",
        "case1",
        "case2",
        "0.0005",
        "0.001",
        "0.002",
        "1.3",
    },
    "laws/test_paths_smoothness.py": {"lq-3", "bvp-2"},
    "laws/test_program_time.py": {"gears", "reserve"},
    "laws/test_recursion_planted.py": {"bias", "forward_dynamics", "inverse_dynamics_derivatives", "mass_matrix"},
    "laws/test_singular_wrists.py": {"1e-09", "1e-06", "q1", "q3"},
    "laws/test_solve.py": {"manutec_r3-line", "manutec_r3-joints", "beam_arm"},
    "published/test_analysis.py": {"manutec_r3_24", "manutec_r3_30", "manutec_r3_efjm", "kr300_efjm"},
    "unit/test_clib.py": {"elbow-servo", "elbow-lugre", "planar5_nmp"},
    "unit/test_cli_comfort.py": {"100-words0", "words0-expected0", "words3-expected3", "words5-expected5", "words2"},
    "unit/test_cli_identify.py": {"words2"},
    "unit/test_column_functions.py": {"hollow"},
    "unit/test_column_loops.py": {"flags0", "flags2"},
    "unit/test_emission.py": {
        "flags1-19",
        "flags2-19",
        "flags1-9",
        "flags0-8",
        "flags2-8",
        "flags0-1000",
        "flags0-9-20-True-False",
        "flags2-9-20-True-False",
    },
    "unit/test_motion_page.py": {"beam_arm", "manutec_r3"},
    "unit/test_recursion_steps.py": {
        "12-False",
        "8-True",
        "2-False",
        "1e-11",
        "1e-09",
        "dense7",
        "dense12",
        "sliding8",
        "synthetic_mixed",
        "synthetic_complete",
    }
    | {f"{digits}-{against}" for digits in range(3, 16) for against in (False, True) if digits not in (8, 12)},
    "unit/test_report.py": {"beam_arm-line", "manutec_r3-line"},
    "unit/test_solve_stages.py": {"1.0", "0.01", "1e-06"},
    "unit/test_structure.py": {"manutec_r3_18", "manutec_r3_24", "manutec_r3_30", "manutec_r3_efjm", "kr300_efjm"},
    "unit/test_time_limit.py": {"bdf", "closed-form", "kunkel-mehrmann", "reduced"},
    "unit/test_timing.py": {f"bounds{k}-{m}-many" for k in range(4) for m in (3, 6)} - {"bounds3-6-many"},
    "cross/test_methods_agree.py": {"planar5_nmp"},
    "laws/test_hysteresis.py": {"forgotten", "9000.0"},
    "laws/test_redundant_arms.py": {"rigid"},
    "cross/test_position_commands.py": {"elbow"},
    "cross/test_reduced.py": {"elbow"},
    "unit/test_held_torques.py": {
        "linear-2.7-1",
        "zoh-4.0-1",
        "zoh-1.0-1",
        "zoh-0.4-1",
        "zoh-4.0-2",
        "zoh-1.0-2",
        "linear-2.7-2",
    },
    "unit/test_plausibility.py": {"manutec_r3"},
    "laws/test_impedance.py": {"1000.0-20.0-0.0", "45000.0-20.0-0.002", "30000.0-30.0-0.001", "0.0004-0.0"},
    "unit/test_solve_attempts.py": {"discretized", "kunkel-mehrmann", "bdf", "full", "bvp"},
    "laws/test_stream_parts.py": {"planar5_nmp-spline"},
    "laws/test_lugre.py": {"static", "damping"},
    "unit/test_fmu_export.py": {"config-", "warnings-", "plant-", "controller-"},
    "unit/test_generate.py": {"empty", "swapped"},
    "laws/test_damped_gears.py": {"four_bounds-auto", "fast-auto"},
}
# Slow cases of a minute each, of which a shorter one stays: `make test-full` runs them.
FULL_CASES = {
    "client/test_cross_compile.py": {
        "elbow-single",
        "abb_arm",
        "manutec_r3",
        "abb_arm-double",
        "four_mass-single",
        "planar5_nmp-double",
    },
    "client/test_fmu_import.py": {"manutec_r3_24"},
    "client/test_hostile_sanitizers.py": {"elbow-12-many", "planar5_nmp-12-many", "manutec_r3", "manutec_r3_18"},
    "client/test_gallery.py": {"dae_solvers", "feedback_linearization", "minimum_phase", "models_compared"},
    "client/test_motion_control.py": {"gcc with sanitizers"},
    "client/test_notebooks.py": {"benchmark_f", "feedback_study", "identify", "learning"},
    "client/test_instruction_sets.py": {"planar5_nmp-native", "planar5_nmp-x86-64-v3", "beam_arm", "elbow"},
    "client/test_product.py": {
        "elbow-single",
        "ON",
        "gcc-single",
        "planar5_nmp-double",
        "four_mass-single",
        "elbow-clang--O2",
        "planar5_nmp-clang--O2",
    },
    "client/test_packaged_compiler.py": {"planar5_nmp"},
    "cross/test_cuda_kernels.py": {"elbow-single", "planar5_nmp-double", "planar5_nmp-single", "single"},
    "cross/test_gear_hysteresis.py": {"elements2", "elbow"},
    "cross/test_hysteresis_in_c.py": {"manutec_r3_18", "manutec_r3_18-3"},
    "cross/test_loop_hysteresis.py": {"manutec_r3_18"},
    "cross/test_lugre_in_mujoco.py": {"elbow", "manutec_r3_18"},
    "cross/test_symbolic.py": {"skew"},
    "laws/test_amplitude.py": {
        "planar5_nmp-Coulomb friction-1",
        "planar5_nmp-backlash-1",
        "planar5_nmp-hysteresis-1",
        "planar5_nmp-missing spring-1",
        "planar5_nmp-masses-1",
        "elbow",
    },
    "cross/test_inversion_accuracy.py": {"manutec_r3_30", "kr300_efjm"},
    "cross/test_mujoco_export.py": {"simplified", "complete"},
    "cross/test_urdf_export.py": {"simplified", "complete"},
    "fuzz/test_random_calls.py": {"2"},
    "laws/test_claims_of_unstable_moves.py": {"16.0"},
    "laws/test_fmu_plant.py": {"manutec_r3_24"},
    "laws/test_fmu_sampled.py": {"elbow", "four_mass"},
    "laws/test_learning.py": {"manutec_r3_24"},
    "laws/test_load_and_collision.py": {"1.0", "1.2"},
    "laws/test_minimum_time.py": {"manutec_r3_24"},
    "laws/test_observers.py": {"outputs5"},
    "laws/test_claimed_errors.py": {"four_mass", "abb_arm", "planar5_family", "manutec_r3_24"},
    "laws/test_sensors.py": {"manutec_r3_24", "manutec_r3_efjm", "kr300_efjm", "manutec_r3_30"},
    "unit/test_codegen.py": {"carried_arm", "kr300", "manutec_r3_18", "manutec_r3_24", "planar5_mp", "planar5_soft"},
    "unit/test_time_limit.py": {"kunkel-mehrmann", "reduced", "bdf"},
    "client/test_kernel_compilers.py": {"gcc-single"},
    "laws/test_single_precision.py": {"line"},
    "laws/test_generated_robots.py": {"10", "4", "4-m1"},
    "laws/test_hysteresis_elements.py": {"exponent", "elements2-2000.0"},
    "laws/test_benchmarks.py": {"two_link-0.31"},
    "laws/test_stream.py": {"manutec_r3_24"},
    "cross/test_recursion_products.py": {"manutec_r3_30", "manutec_r3_efjm", "kr300_efjm", "dense12"},
    "cross/test_cross.py": {"manutec_r3_30", "manutec_r3_efjm"},
    "cross/test_recursion.py": {"manutec_r3_30", "manutec_r3_efjm", "kr300_efjm"},
    "unit/test_parameters.py": {"planar5_nmp-names0-overrides0-changes0"},
    "client/test_stream_constants.py": {"planar5_nmp-single", "beam_arm-double"},
    "order/test_kunkel_mehrmann.py": {"four_mass@high", "elbow@rigid", "planar5_mp@undamped"},
    "cross/test_jax.py": {"planar5_nmp"},
    "unit/test_plausibility.py": {"manutec_r3_18"},
    "laws/test_solve.py": {"carried_arm-joints"},
    "cross/test_referees.py": {"any-simplified", "linear-complete"},
    "laws/test_model_laws.py": {"feedback linearization, discrete, predicted, 16 Hz-False"},
}
OTHER_MODELS = {path.stem for path in (ROOT / "models").glob("*.toml")} - QUICK_MODELS


def full(path: str, words: str) -> bool:
    """Whether a case runs with the full tests only; parameters as of `slow`."""
    return not {words, *re.split(r"[-@]", words)}.isdisjoint(FULL_CASES.get(path, ()))


def slow(path: str, words: str) -> bool:
    """Whether folder or model make a test slow.

    Parameters
    ----------
    path : str
        The file, relative to ``tests``.
    words : str
        The id of the case, such as ``planar5_nmp@undamped-lq``; empty without parameters.
    """
    if any(path == entry or (entry.endswith("/") and path.startswith(entry)) for entry in SLOW):
        return True
    names = {words, *re.split(r"[-@]", words)}
    if not names.isdisjoint(SLOW_CASES.get(path, ())):
        return True
    return path not in ANY_MODEL and not names.isdisjoint(OTHER_MODELS)
