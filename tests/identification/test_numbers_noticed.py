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
        "flexgen.studies.scenarios.foreign": {"STEP_S": 5.0, "BEGIN_S": 60.0, "TOTAL_S": 1800.0},
        "flexgen.studies.scenarios.scenario_file": {
            "MOST_DRAWS": 1000,
            "MOST_STEPS": 10000,
            "LARGEST": 10**9,
        },
        "flexgen.identification.poses.calibrate": {"FEWEST": 5},
        "flexgen.identification.poses.frames": {"ENOUGH": 60, "TRIED": 8},
        "flexgen.codegen.emission.interface": {"INTERVALS_MAX": 10000, "SAMPLES_MAX": 1000},
        "flexgen.base.errors": {"GIVEN": 600, "MESSAGE": 4000},
        "flexgen.analysis.printing.equations": {"MAX_COORDINATES": 4},
        "flexgen.base.numerics.executors": {"IN_FLIGHT": 32},
        "flexgen.identification.gears.identify": {"MOST": 64},
        "flexgen.identification.gears.signals": {"PER_PERIOD": 5, "EVEN": 0.02, "LEAST_HZ": 5.0},
        "flexgen.identification.experiments.excitation": {
            "MOST_SAMPLES": 10_000_000,
            "MOST_PERIODS": 100000,
        },
        "flexgen.identification.experiments.experiment": {"LANES": 48},
        "flexgen.identification.motions.motion_correction": {
            "MANY": 300_000,
            "MOST_NUMBERS": 30_000_000,
        },
        "flexgen.identification.motions.motion_fit": {"LEAST_SEGMENTS": 4},
        "flexgen.identification.responses.structure": {"MOST_ROUNDS": 20},
        "flexgen.feedback.laws.linearising": {"HIGHEST_HZ": 100000.0},
        "flexgen.codegen.build.directory": {"MANIFEST_MAX": 20_000_000},
        "flexgen.feedback.loop.closed_loop": {
            "MOST_STEPS": 1000,
            "MOST_DELAY": 64,
            "LONGEST_STEP_S": 5.0,
            "DELAY_ERROR": 0.001,
        },
        "flexgen.feedback.loop.interface": {"MOST_MEMORY": 2**28},
        "flexgen.feedback.loop.margins": {
            "LARGEST_GAIN": 100.0,
            "GAINS": 60,
            "LARGEST_DELAY": 32.0,
            "DELAYS": 128,
            "MOST_LATE": 256,
            "FREQUENCIES": 600,
            "LEAST_HZ": 1e-06,
        },
        "flexgen.feedback.loop.plants": {"LARGEST_FACTOR": 100.0, "LARGEST_LOAD": 100000.0},
        "flexgen.feedback.loop.reference": {"MOST_SAMPLES": 2_000_000},
        "flexgen.model.format.format_tasks": {"PROFILE_MAX": 8, "MOST_TURNS": 100},
        "flexgen.model.moves": {"LONGEST_NAME": 100},
        "flexgen.feedback.observers.extended_kalman": {"LARGEST_RATE": 2.0**10},
        "flexgen.paths.force.force_files": {"LINE_MAX": 1000, "ROWS_MAX": 200000},
        "flexgen.paths.samples.sample_files": {
            "LINE_MAX": 20000,
            "UNIT": 0.001,
            "ROTATION_MAX": math.pi / 2,
        },
        "flexgen.identification.load.payload": {
            "FARTHEST": 3.0,
            "UNEXPLAINED": 0.5,
            "FEWEST_BLOCKS": 6,
        },
        "flexgen.planning.optimal.arguments": {"MOST": 5000},
        "flexgen.planning.optimal.phase": {"DURATIONS": (0.001, 1000.0)},
        "flexgen.model.position_servo.keys": {"MOST_FEEDFORWARD": 2.0, "MOST_HZ": 100000.0},
        "flexgen.runtime.inversion.many_inversion": {"WORKERS": 1024},
        "flexgen.feedback.positions.command": {"LONGEST_S": 0.1, "LONGEST_AFTER_S": 30.0},
        "flexgen.identification.servo.record": {
            "MOST": 1000000,
            "FEWEST": 100,
            "LONGEST_S": 1.0,
            "EVEN": 0.02,
        },
        "flexgen.base.spec.fourier": {"STEEPEST": 0.5},
        "flexgen.base.spec.xml_lines": {"DEPTH": 64},
        "flexgen.base.files.trajectory_files": {
            "LARGEST": 2**30,
            "LINE": 100000,
            "CHANNELS": 1000,
            "NAME": 200,
        },
    },
    "named, warned of or accepted from": {
        "flexgen.paths.accuracy.corners": {
            "INSTANTS": 20001,
            "STRAIGHT": math.cos(math.radians(1.0)),
        },
        "flexgen.paths.accuracy.figures": {"BAND": 0.0001},
        "flexgen.identification.responses.amplitude": {"LEAST_SHARE": 0.5, "PART": 0.2},
        "flexgen.identification.responses.gear_changes": {"SMOOTHED": 9},
        "flexgen.identification.responses.large_motions": {"OVERSAMPLING": 4},
        "flexgen.identification.poses.calibrate": {"PULL": -2.0, "MANY": 1.5, "GROSS": 6.0},
        "flexgen.identification.poses.mistakes": {"DOUBTFUL": 0.1, "UNEXPLAINED": 0.5},
        "flexgen.identification.poses.result": {"DETERMINED": 0.3},
        "flexgen.dynamics.dae.strangeness_index": {"CLEAR": 1e-11},
        "flexgen.dynamics.dae.structure": {"NEARLY": 1e-06},
        "flexgen.identification.gears.fit": {"LEAST_SIGNAL": 0.1, "UNLIKELY": 0.01},
        "flexgen.identification.gears.further_elements": {"SEEN": (4.0, 8.0), "MOVES": 1.5},
        "flexgen.identification.gears.identify": {
            "WEAK": 0.5,
            "EXCESS": 3.0,
            "NARROWER": (0.6, 0.36),
        },
        "flexgen.identification.gears.signals": {"ROUGH": 0.001, "ABOVE_NOISE": 10.0},
        "flexgen.identification.causes.explain": {
            "LEAST_SHARE": 0.7,
            "EXPLAINED": 0.95,
            "ALSO": 0.05,
            "REFITS": 3,
        },
        "flexgen.identification.causes.levels": {"LEAST_FACTOR": 1.3},
        "flexgen.identification.responses.frequency_response": {
            "REPEATS": 6.0,
            "UNLIKE": 0.3,
            "LARGEST_DIFFERENCE": 0.1,
            "LEAST_TOTAL": 3,
        },
        "flexgen.identification.responses.graybox": {
            "COST_LEAST": 0.5,
            "COST_MOST": 2.0,
            "SPREAD": 1.5,
        },
        "flexgen.identification.motions.motion_correction": {"UNSURE": (0.1, 1.0)},
        "flexgen.identification.records.description": {
            "JITTER": 0.05,
            "WRAP": 1.0,
            "REPEATED": 0.005,
            "CLIPPED": 3,
        },
        "flexgen.identification.responses.structure": {"LEAST_GAIN": 10.0},
        "flexgen.inversion.problem.limits": {"NOTICED": 1e-06},
        "flexgen.inversion.methods.full_model": {"NOTICED": 0.01},
        "flexgen.inversion.problem.problem": {"ROUGH": 3},
        "flexgen.inversion.judge.settling": {"NOTED": 0.01},
        "flexgen.dynamics.mechanics.limits": {"KEPT_TO": 0.0011},
        "flexgen.model.urdf.urdf": {"INERTIA_TOLERANCE": 1e-06},
        "flexgen.feedback.observers.design": {"NOT_SEEN": 1e-09, "DECAYS": 0.001},
        "flexgen.paths.timing.joint_limits": {"JUMP": 1.0},
        "flexgen.paths.geometry.smoothness": {"JUMP": 0.0001, "DRIFT_MIN": 1e-07},
        "flexgen.paths.geometry.spline": {"MANY": 20, "FAST": 0.3},
        "flexgen.planning.learning.learn": {"GROWS": 1.05},
        "flexgen.planning.optimal.problem": {"OPTIMALITY": 1e-07},
        "flexgen.studies.check.numbers": {"STEEL": 7850.0},
        "flexgen.views.reports.identification_page": {"CORRELATED": 0.5, "MOST_POSES": 12},
        "flexgen.identification.servo.fit_result": {"ENOUGH": 0.9, "LEFT": 1.5, "REPEATED": 0.4},
        "flexgen.feedback.positions.result": {"LITTLE": 0.5, "GROWN": 1000.0},
        "flexgen.simulation.verification.defect": {"TENFOLD": 2.3},
        "flexgen.simulation.simulate": {"FALLEN": 0.1},
    },
    "times, filters and gains that are chosen": {
        "flexgen.identification.experiments.plan": {
            "BANDWIDTH": 8.0,
            "POSITION_GAIN": 8.0,
            "SAMPLED_GAIN": 0.3,
        },
        "flexgen.identification.responses.parameters": {"PRIOR_SD": 2.0},
        "flexgen.feedback.loop.case": {"HOLD_S": 2.0, "AFTER_S": 0.5, "WALL_STEPS": 4.0},
        "flexgen.feedback.loop.channels": {
            "ENCODER_NOISE": 0.0001,
            "NOISES": {"tool_accelerometer": 0.05, "tool_gyro": 0.001, "link_encoders": 1e-05},
        },
        "flexgen.analysis.servo_gains": {
            "SAMPLED_GAIN": 0.3,
            "MULTIPLES": {"position_hz": 0.5, "speed_hz": 3.0, "integral_hz": 0.1},
            "RIGID_HZ": 10.0,
        },
        "flexgen.inversion.problem.problem": {
            "GRADING": 1.5,
            "SETTLING": 15.0,
            "PHASE": 0.4,
            "FINEST": 20,
            "PHASE_WITH_LIMITS": 0.1,
            "REVERSALS": 8.0,
        },
        "flexgen.inversion.problem.limits": {"KNOTS": 30, "PER_KNOT": 2},
        "flexgen.inversion.judge.settling": {"REDUCED": 0.1},
        "flexgen.feedback.laws.loop_shaping": {"LOWER": 0.8, "LOWERINGS": 30},
        "flexgen.feedback.laws.lq": {"SENSOR_NOISE": 10.0},
        "flexgen.feedback.laws.study": {"REST_S": 1.0},
        "flexgen.base.numerics.low_pass": {"POWER": 0.99},
        "flexgen.feedback.observers.collision": {"BANDWIDTH_HZ": 15.0},
        "flexgen.feedback.observers.extended_kalman": {
            "START": {"position": 0.001, "speed": 0.01, "torque": 0.1}
        },
        "flexgen.planning.learning.commanded": {"EARLY_S": 0.15, "BLEND_S": 0.1},
        "flexgen.identification.load.payload": {
            "LOW_PASS_HZ": 8.0,
            "OF_LOWEST": 1.5,
            "OF_MOTION": 3.0,
            "HIGHEST": 0.4,
            "FRICTION_SD": 0.3,
            "BLOCK_S": 0.5,
        },
        "flexgen.planning.fastest.residual_vibration": {
            "WINDOW_S": 0.4,
            "SAMPLES": 50.0,
            "PERIODS": (1.0, 8.0),
        },
        "flexgen.planning.learning.smoother": {
            "MODEL_ERROR": 0.2,
            "LOAD_ERROR": 0.02,
            "MODEL_TIME": 0.3,
            "REST_S": 0.5,
            "PARTS": 40,
            "TORQUE_NOISE": 0.001,
            "DISTURBANCE_RATE": 0.1,
        },
        "flexgen.feedback.positions.command": {
            "PERIOD_S": 0.004,
            "SETTLED": 1e-06,
            "AT_REST": 1e-09,
        },
        "flexgen.simulation.simulate": {"HELD_MAX": 60.0, "HELD_STEP": 0.002},
        "flexgen.studies.sweeps.cases": {"SPAN": {"rad": math.pi, "m": 0.5}},
        "flexgen.studies.sweeps.folder": {"SHARD_SIZE": 16, "BATCH_SIZE": 512, "SHARDS": 64},
        "flexgen.studies.tolerances.in_loop": {"DRAWN": 64},
        "flexgen.studies.tolerances.prediction": {
            "LEVEL": 0.95,
            "DRAWN": 4000,
            "IN_BANDS": 400,
            "INSTANTS": 200,
        },
        "flexgen.exports.ros2.export": {"STEP_TOLERANCE": 0.001, "START_TOLERANCE": 0.01},
        "flexgen.exports.c_code.selftest.cases": {
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
        "flexgen.base.calls.progress": {"EVERY": 2.0},
        "flexgen.base.display": {"SHOWN": 12},
        "flexgen.feedback.loop.result": {"SHOWN": 20},
        "flexgen.views.reports.motion": {"SHOWN": 0.08},
        "flexgen.views.reports.text_tables": {"NARROW": 16},
        "flexgen.views.reports.texts": {"SHOWN": 5},
        "flexgen.studies.tolerances.result": {"SHOWN": 8},
        "flexgen.views.plots.calibration": {"QUANTILE": 1.96},
        "flexgen.views.plots.feedback_study": {"LARGEST_M": 0.03, "LOUDEST_NM": 1000.0},
        "flexgen.views.plots.identification": {"QUANTILE": 1.96},
        "flexgen.views.plots.uncertainty": {"BARS": 10, "LINES": 3},
        "flexgen.views.plots.signals": {"INSTANTS": 401},
        "flexgen.views.plots.stick_figure": {"INSTANTS": 6},
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
        quantile = importlib.import_module(f"flexgen.views.plots.{name}").QUANTILE
        assert abs(quantile - NormalDist().inv_cdf(0.975)) < 1e-4
