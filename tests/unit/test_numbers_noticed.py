"""Limits, thresholds and times that a user meets: whose change is a change of what is refused,
warned of or shown.

They are the numbers behind sentences of messages and pages that do not print them. Numerical
tolerances stand here only where a status or a warning depends on them.
"""

from __future__ import annotations

import importlib
import math
from statistics import NormalDist
from typing import Any

import pytest

NOTICED: dict[str, dict[str, dict[str, Any]]] = {
    "refused or cut beyond": {
        "flexgen.benchmarks.foreign": {"STEP_S": 5.0, "BEGIN_S": 60.0, "TOTAL_S": 1800.0},
        "flexgen.benchmarks.scenario_file": {
            "MOST_DRAWS": 1000,
            "MOST_STEPS": 10000,
            "LARGEST": 10**9,
        },
        "flexgen.calibration.calibrate": {"FEWEST": 5},
        "flexgen.calibration.frames": {"ENOUGH": 60, "TRIED": 8},
        "flexgen.codegen.interface": {"INTERVALS_MAX": 10000, "SAMPLES_MAX": 1000},
        "flexgen.errors": {"GIVEN": 600, "MESSAGE": 4000},
        "flexgen.equations_text.equations": {"MAX_COORDINATES": 4},
        "flexgen.numerics.executors": {"IN_FLIGHT": 32},
        "flexgen.gears.identify": {"MOST": 64},
        "flexgen.gears.signals": {"PER_PERIOD": 5, "EVEN": 0.02, "LEAST_HZ": 5.0},
        "flexgen.identification.experiments.excitation": {
            "MOST_SAMPLES": 10_000_000,
            "MOST_PERIODS": 100000,
        },
        "flexgen.identification.experiments.experiment": {"LANES": 48},
        "flexgen.identification.motion_correction": {"MANY": 300_000, "MOST_NUMBERS": 30_000_000},
        "flexgen.identification.motion_fit": {"LEAST_SEGMENTS": 4},
        "flexgen.identification.structure": {"MOST_ROUNDS": 20},
        "flexgen.laws.linearising": {"HIGHEST_HZ": 100000.0},
        "flexgen.library.directory": {"MANIFEST_MAX": 20_000_000},
        "flexgen.loop.closed_loop": {
            "MOST_STEPS": 1000,
            "MOST_DELAY": 64,
            "LONGEST_STEP_S": 5.0,
            "DELAY_ERROR": 0.001,
        },
        "flexgen.loop.interface": {"MOST_MEMORY": 2**28},
        "flexgen.loop.margins": {
            "LARGEST_GAIN": 100.0,
            "GAINS": 60,
            "LARGEST_DELAY": 32.0,
            "DELAYS": 128,
            "MOST_LATE": 256,
            "FREQUENCIES": 600,
            "LEAST_HZ": 1e-06,
        },
        "flexgen.loop.plants": {"LARGEST_FACTOR": 100.0, "LARGEST_LOAD": 100000.0},
        "flexgen.loop.reference": {"MOST_SAMPLES": 2_000_000},
        "flexgen.model.format_tasks": {"PROFILE_MAX": 8, "MOST_TURNS": 100},
        "flexgen.model.moves": {"LONGEST_NAME": 100},
        "flexgen.observers.extended_kalman": {"LARGEST_RATE": 2.0**10},
        "flexgen.paths.force_files": {"LINE_MAX": 1000, "ROWS_MAX": 200000},
        "flexgen.paths.sample_files": {
            "LINE_MAX": 20000,
            "UNIT": 0.001,
            "ROTATION_MAX": math.pi / 2,
        },
        "flexgen.performance.payload": {"FARTHEST": 3.0, "UNEXPLAINED": 0.5, "FEWEST_BLOCKS": 6},
        "flexgen.planning.arguments": {"MOST": 5000},
        "flexgen.planning.phase": {"DURATIONS": (0.001, 1000.0)},
        "flexgen.position_servo.keys": {"MOST_FEEDFORWARD": 2.0, "MOST_HZ": 100000.0},
        "flexgen.runtime.many_inversion": {"WORKERS": 1024},
        "flexgen.servo.command": {"LONGEST_S": 0.1, "LONGEST_AFTER_S": 30.0},
        "flexgen.servo.record": {"MOST": 1000000, "FEWEST": 100, "LONGEST_S": 1.0, "EVEN": 0.02},
        "flexgen.spec.fourier": {"STEEPEST": 0.5},
        "flexgen.spec.xml_lines": {"DEPTH": 64},
        "flexgen.trajectory_files": {
            "LARGEST": 2**30,
            "LINE": 100000,
            "CHANNELS": 1000,
            "NAME": 200,
        },
    },
    "named, warned of or accepted from": {
        "flexgen.accuracy.corners": {"INSTANTS": 20001, "STRAIGHT": math.cos(math.radians(1.0))},
        "flexgen.accuracy.figures": {"BAND": 0.0001},
        "flexgen.analysis.amplitude": {"LEAST_SHARE": 0.5, "PART": 0.2},
        "flexgen.analysis.gear_changes": {"SMOOTHED": 9},
        "flexgen.analysis.large_motions": {"OVERSAMPLING": 4},
        "flexgen.calibration.calibrate": {"PULL": -2.0, "MANY": 1.5, "GROSS": 6.0},
        "flexgen.calibration.mistakes": {"DOUBTFUL": 0.1, "UNEXPLAINED": 0.5},
        "flexgen.calibration.result": {"DETERMINED": 0.3},
        "flexgen.dae.strangeness_index": {"CLEAR": 1e-11},
        "flexgen.dae.structure": {"NEARLY": 1e-06},
        "flexgen.gears.fit": {"LEAST_SIGNAL": 0.1, "UNLIKELY": 0.01},
        "flexgen.gears.further_elements": {"SEEN": (4.0, 8.0), "MOVES": 1.5},
        "flexgen.gears.identify": {"WEAK": 0.5, "EXCESS": 3.0, "NARROWER": (0.6, 0.36)},
        "flexgen.gears.signals": {"ROUGH": 0.001, "ABOVE_NOISE": 10.0},
        "flexgen.identification.causes.explain": {
            "LEAST_SHARE": 0.7,
            "EXPLAINED": 0.95,
            "ALSO": 0.05,
            "REFITS": 3,
        },
        "flexgen.identification.causes.levels": {"LEAST_FACTOR": 1.3},
        "flexgen.identification.frequency_response": {
            "REPEATS": 6.0,
            "UNLIKE": 0.3,
            "LARGEST_DIFFERENCE": 0.1,
            "LEAST_TOTAL": 3,
        },
        "flexgen.identification.graybox": {"COST_LEAST": 0.5, "COST_MOST": 2.0, "SPREAD": 1.5},
        "flexgen.identification.motion_correction": {"UNSURE": (0.1, 1.0)},
        "flexgen.records.description": {
            "JITTER": 0.05,
            "WRAP": 1.0,
            "REPEATED": 0.005,
            "CLIPPED": 3,
        },
        "flexgen.identification.structure": {"LEAST_GAIN": 10.0},
        "flexgen.inversion.limits": {"NOTICED": 1e-06},
        "flexgen.inversion.methods.full_model": {"NOTICED": 0.01},
        "flexgen.inversion.problem": {"ROUGH": 3},
        "flexgen.inversion.settling": {"NOTED": 0.01},
        "flexgen.mechanics.limits": {"KEPT_TO": 0.0011},
        "flexgen.model.urdf": {"INERTIA_TOLERANCE": 1e-06},
        "flexgen.observers.design": {"NOT_SEEN": 1e-09, "DECAYS": 0.001},
        "flexgen.paths.joint_limits": {"JUMP": 1.0},
        "flexgen.paths.smoothness": {"JUMP": 0.0001, "DRIFT_MIN": 1e-07},
        "flexgen.paths.spline": {"MANY": 20, "FAST": 0.3},
        "flexgen.performance.learn": {"GROWS": 1.05},
        "flexgen.performance.payload": {"NOT_CLOSE": 0.0001},
        "flexgen.planning.problem": {"OPTIMALITY": 1e-07},
        "flexgen.plausibility.numbers": {"STEEL": 7850.0},
        "flexgen.reports.identification_page": {"CORRELATED": 0.5, "MOST_POSES": 12},
        "flexgen.servo.fit_result": {"ENOUGH": 0.9, "LEFT": 1.5, "REPEATED": 0.4},
        "flexgen.servo.result": {"LITTLE": 0.5, "GROWN": 1000.0},
        "flexgen.simulation.defect": {"TENFOLD": 2.3},
        "flexgen.simulation.simulate": {"FALLEN": 0.1},
    },
    "times, filters and gains that are chosen": {
        "flexgen.identification.experiments.plan": {
            "BANDWIDTH": 8.0,
            "POSITION_GAIN": 8.0,
            "SAMPLED_GAIN": 0.3,
        },
        "flexgen.identification.parameters": {"PRIOR_SD": 2.0},
        "flexgen.loop.case": {"HOLD_S": 2.0, "AFTER_S": 0.5, "WALL_STEPS": 4.0},
        "flexgen.loop.channels": {
            "ENCODER_NOISE": 0.0001,
            "NOISES": {"tool_accelerometer": 0.05, "tool_gyro": 0.001, "link_encoders": 1e-05},
        },
        "flexgen.analysis.servo_gains": {
            "SAMPLED_GAIN": 0.3,
            "MULTIPLES": {"position_hz": 0.5, "speed_hz": 3.0, "integral_hz": 0.1},
            "RIGID_HZ": 10.0,
        },
        "flexgen.inversion.problem": {
            "GRADING": 1.5,
            "SETTLING": 15.0,
            "PHASE": 0.4,
            "FINEST": 20,
            "PHASE_WITH_LIMITS": 0.1,
            "REVERSALS": 8.0,
        },
        "flexgen.inversion.limits": {"KNOTS": 30, "PER_KNOT": 2},
        "flexgen.inversion.settling": {"REDUCED": 0.1},
        "flexgen.laws.loop_shaping": {"LOWER": 0.8, "LOWERINGS": 30},
        "flexgen.laws.lq": {"SENSOR_NOISE": 10.0},
        "flexgen.laws.study": {"REST_S": 1.0},
        "flexgen.numerics.low_pass": {"POWER": 0.99},
        "flexgen.observers.collision": {"BANDWIDTH_HZ": 15.0},
        "flexgen.observers.extended_kalman": {
            "START": {"position": 0.001, "speed": 0.01, "torque": 0.1}
        },
        "flexgen.performance.commanded": {"EARLY_S": 0.15, "BLEND_S": 0.1},
        "flexgen.performance.payload": {
            "LOW_PASS_HZ": 8.0,
            "OF_LOWEST": 1.5,
            "OF_MOTION": 3.0,
            "HIGHEST": 0.4,
            "FRICTION_SD": 0.3,
            "BLOCK_S": 0.5,
        },
        "flexgen.performance.residual_vibration": {
            "WINDOW_S": 0.4,
            "SAMPLES": 50.0,
            "PERIODS": (1.0, 8.0),
        },
        "flexgen.performance.smoother": {
            "MODEL_ERROR": 0.2,
            "LOAD_ERROR": 0.02,
            "MODEL_TIME": 0.3,
            "REST_S": 0.5,
            "PARTS": 40,
            "TORQUE_NOISE": 0.001,
            "DISTURBANCE_RATE": 0.1,
        },
        "flexgen.servo.command": {"PERIOD_S": 0.004, "SETTLED": 1e-06, "AT_REST": 1e-09},
        "flexgen.simulation.simulate": {"HELD_MAX": 60.0, "HELD_STEP": 0.002},
        "flexgen.sweeps.cases": {"SPAN": {"rad": math.pi, "m": 0.5}},
        "flexgen.sweeps.folder": {"SHARD_SIZE": 16, "BATCH_SIZE": 512, "SHARDS": 64},
        "flexgen.uncertainty.in_loop": {"DRAWN": 64},
        "flexgen.uncertainty.prediction": {
            "LEVEL": 0.95,
            "DRAWN": 4000,
            "IN_BANDS": 400,
            "INSTANTS": 200,
        },
        "flexgen.exports.ros2.export": {"STEP_TOLERANCE": 0.001, "START_TOLERANCE": 0.01},
        "flexgen.exports.selftest.cases": {
            "LIMITS": {"double": (1e-09, 0.001), "single": (0.02, 0.1)},
            "STREAM_LIMITS": {"double": 0.0001, "single": 0.05},
            "REST_LIMITS": {"double": 1e-06, "single": 0.01},
        },
        "flexgen.exports.fmu.plant": {"STEPS_PER_TIME_CONSTANT": 20},
    },
    "what is shown": {
        "flexgen.cli.main": {
            "SUCCESS": 0,
            "FAILURE": 1,
            "USAGE": 2,
            "INTERRUPTED": 130,
            "PIPE_CLOSED": 141,
        },
        "flexgen.progress": {"EVERY": 2.0},
        "flexgen.display": {"SHOWN": 12},
        "flexgen.loop.result": {"SHOWN": 20},
        "flexgen.reports.motion": {"SHOWN": 0.08},
        "flexgen.reports.text_tables": {"NARROW": 16},
        "flexgen.reports.texts": {"SHOWN": 5},
        "flexgen.uncertainty.result": {"SHOWN": 8},
        "flexgen.plots.calibration": {"QUANTILE": 1.96},
        "flexgen.plots.feedback_study": {"LARGEST_M": 0.03, "LOUDEST_NM": 1000.0},
        "flexgen.plots.identification": {"QUANTILE": 1.96},
        "flexgen.plots.uncertainty": {"BARS": 10, "LINES": 3},
        "flexgen.plots.signals": {"INSTANTS": 401},
        "flexgen.plots.stick_figure": {"INSTANTS": 6},
    },
}


@pytest.mark.parametrize("kind", NOTICED)
def test_limits_and_thresholds_are_what_they_were(kind: str) -> None:
    modules = {name: importlib.import_module(name) for name in NOTICED[kind]}
    found = {
        name: {key: getattr(modules[name], key) for key in rows}
        for name, rows in NOTICED[kind].items()
    }
    assert found == NOTICED[kind]


def test_bands_of_figures_have_95_percent_of_a_normal_distribution() -> None:
    for name in ("calibration", "identification"):
        quantile = importlib.import_module(f"flexgen.plots.{name}").QUANTILE
        assert abs(quantile - NormalDist().inv_cdf(0.975)) < 1e-4
