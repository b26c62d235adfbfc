"""flexgen: inverse dynamics of elastic robots, from a model file to C that runs in a controller.

The public verbs, the nouns they take and the errors they raise are resolved on first use:
``import flexgen`` is quick.
"""

from __future__ import annotations

import importlib
from typing import Any

from flexgen.base import registry
from flexgen.base.version import __version__ as __version__

_VERBS = {
    "models": "flexgen.model.catalogue.catalogue",
    "describe": "flexgen.model.catalogue.catalogue",
    "read": "flexgen.model.reader",
    "read_moves": "flexgen.paths.move_files",
    "derive": "flexgen.dynamics.mechanics.equations",
    "analyze": "flexgen.analysis.analyze",
    "check": "flexgen.studies.check.check",
    "plan": "flexgen.paths.path",
    "plan_problem": "flexgen.planning.optimal.problem",
    "predict": "flexgen.studies.tolerances.prediction",
    "solve": "flexgen.inversion.solve",
    "sweep": "flexgen.studies.sweeps.sweep",
    "compare": "flexgen.feedback.loop.comparison",
    "compare_feedforward": "flexgen.feedback.loop.feedforward",
    "compare_shapers": "flexgen.feedback.positions.shaper_comparison",
    "simulate": "flexgen.simulation.simulate",
    "generate": "flexgen.codegen.build.generate",
    "load": "flexgen.runtime.library",
    "excite": "flexgen.identification.experiments.plan",
    "measure": "flexgen.identification.experiments.experiment",
    "frf": "flexgen.identification.responses.frequency_response",
    "identify": "flexgen.identification.responses.graybox",
    "refine": "flexgen.identification.motions.time_domain",
    "fit_motion": "flexgen.identification.motions.motion_fit",
    "calibrate": "flexgen.identification.poses.calibrate",
    "compare_record": "flexgen.identification.motions.record_comparison",
    "commission": "flexgen.identification.commissioning.commission",
    "sense": "flexgen.simulation.environment.sense",
    "tracker_positions": "flexgen.paths.inverse_kinematics.forward",
    "control": "flexgen.feedback.loop.control",
    "check_passivity": "flexgen.feedback.laws.passivity",
    "command_positions": "flexgen.feedback.positions.command",
    "identify_servo": "flexgen.identification.servo.identify",
    "identify_gears": "flexgen.identification.gears.identify",
    "identify_spring": "flexgen.identification.gears.identify_spring",
    "feedback_study": "flexgen.feedback.laws.study",
    "tune": "flexgen.studies.scenarios.tune",
    "tune_cascade": "flexgen.studies.scenarios.tune_cascade",
    "fastest": "flexgen.planning.fastest.minimum_time",
    "identify_load": "flexgen.identification.load.payload",
    "kinematics": "flexgen.paths.inverse_kinematics.search",
    "learn": "flexgen.planning.learning.learn",
    "next_run": "flexgen.planning.learning.next_run",
    "export": "flexgen.exports.c_code.added",
    "score": "flexgen.studies.scenarios.score",
    "schema": "flexgen.model.catalogue.json_schema",
    "view": "flexgen.views.reports.view",
}
# Functions whose command needs no row in verbs.py: their parameters and docstrings give its
# options.
_COMMANDS = ("identify_load", "identify_gears", "identify_spring", "commission")
# Exports, by the name of the command; each is the function ``export_NAME`` of its module.
registry.EXPORTS |= {
    "fmu": registry.Export(
        "flexgen.exports.fmu.export",
        "[FMU](fmu.md)",
        "Write a Functional Mock-up Unit (FMI 2.0 or 3.0) for simulation programs.",
        {
            "content": (
                "block",
                registry.Option("version", word="--fmi", metavar="VERSION"),
            ),
            "options of a block": (
                "method",
                "step",
                registry.Option("controller", metavar="FILE"),
                "sample_time",
                "look_ahead",
            ),
            "files": (
                registry.Option(
                    "out", "write to this file (.fmu); default: generated/MODEL.fmu", "FILE"
                ),
                "platforms",
                registry.Option("no_binary", old=("--sources-only",)),
            ),
        },
    ),
    "mujoco": registry.Export(
        "flexgen.exports.mujoco.mujoco",
        "[exchange](exchange.md)",
        "Write the elastic robot as an MJCF file for MuJoCo, with the same accelerations.",
        {
            "content": ("friction",),
            "files": (
                registry.Option("out", "write the MJCF file, FILE.xml", "FILE", required=True),
            ),
        },
    ),
    "urdf": registry.Export(
        "flexgen.exports.urdf.urdf",
        "[exchange](exchange.md)",
        "Write the rigid robot as a URDF file, and an overlay of flexgen with all that URDF "
        "cannot contain.",
        {
            "files": (
                registry.Option(
                    "out",
                    "write the URDF file, FILE.urdf, and next to it the overlay, FILE.toml",
                    "FILE",
                    required=True,
                ),
            ),
        },
    ),
    "selftest": registry.Export(
        "flexgen.exports.c_code.selftest.export",
        "[PLC](plc.md)",
        "Write a C program that tests the library on its target, with results of Lagrange's "
        "equations: PASS or FAIL.",
        {
            "content": (
                registry.Option("precision", old=("--single=single",), metavar="NAME"),
                "move",
                "no_motion",
            ),
            "files": (
                registry.Option(
                    "out",
                    "where to write; default: exports/<model>_selftest",
                    "DIR",
                    once=True,
                    old=("--directory",),
                ),
                "force",
            ),
        },
    ),
    "ros2": registry.Export(
        "flexgen.exports.ros2.export",
        "[ROS 2](ros2.md)",
        "Write a ROS 2 package: a plugin of inverse dynamics, and a controller with a stream "
        "and P-PI control.",
        {
            "content": (
                registry.Option("package", metavar="NAME"),
                "no_controller",
                registry.Option("no_gains", "leave the gains of the controller open"),
                "parts",
            ),
            "package.xml": (
                "maintainer",
                "email",
                registry.Option("license_name", old=("--license",)),
            ),
            "files": (
                registry.Option(
                    "out",
                    "where to write; default: exports/<package>",
                    "DIR",
                    once=True,
                    old=("--directory",),
                ),
                "force",
            ),
        },
    ),
    "mex": registry.Export(
        "flexgen.exports.c_code.mex.export",
        "[MATLAB](matlab.md)",
        "Write functions for MATLAB and GNU Octave: functions of a point, inversion of a path, "
        "and a stream.",
        {
            "files": (
                registry.Option(
                    "out",
                    "where to write; default: exports/<model>_mex",
                    "DIR",
                    once=True,
                    old=("--directory",),
                ),
                "force",
            ),
        },
    ),
    "simulink": registry.Export(
        "flexgen.exports.c_code.simulink.export",
        "[MATLAB](matlab.md)",
        "Write blocks for Simulink: functions for C Caller, and S-functions of a stream and of "
        "inverse dynamics.",
        {
            "content": ("no_stream",),
            "files": (
                registry.Option(
                    "out",
                    "where to write; default: exports/<model>_simulink",
                    "DIR",
                    once=True,
                    old=("--directory",),
                ),
                "force",
            ),
        },
    ),
    "plcopen": registry.Export(
        "flexgen.exports.c_code.plcopen.export",
        "[PLC](plc.md)",
        "Write function blocks of IEC 61131-3 (ST and PLCopen XML) with their bodies in C.",
        {
            "content": ("no_stream",),
            "files": (
                registry.Option(
                    "out",
                    "where to write; default: exports/<model>_plcopen",
                    "DIR",
                    once=True,
                    old=("--directory",),
                ),
                "force",
            ),
        },
    ),
}
_NOUNS = {
    "Analysis": "flexgen.analysis.analyze",
    "Calibration": "flexgen.identification.poses.result",
    "Box": "flexgen.identification.experiments.obstacles",
    "Carrier": "flexgen.model.moves",
    "Cascade": "flexgen.feedback.loop.controllers",
    "Check": "flexgen.studies.check.finding",
    "CollisionDetector": "flexgen.feedback.observers.collision",
    "CascadeTuning": "flexgen.studies.scenarios.tune_cascade",
    "Commissioning": "flexgen.identification.commissioning.result",
    "Comparison": "flexgen.feedback.loop.comparison",
    "FeedforwardComparison": "flexgen.feedback.loop.feedforward",
    "ComputedTorque": "flexgen.feedback.laws.linearising",
    "Configuration": "flexgen.paths.inverse_kinematics.search",
    "ConstantGainObserver": "flexgen.feedback.observers.constant_gain",
    "Controller": "flexgen.feedback.loop.interface",
    "ControlRun": "flexgen.feedback.loop.result",
    "DatasheetTolerances": "flexgen.identification.commissioning.unknowns",
    "Detection": "flexgen.feedback.observers.collision",
    "Disturbance": "flexgen.simulation.environment.disturbances",
    "DriveHardware": "flexgen.feedback.loop.hardware",
    "Equations": "flexgen.dynamics.mechanics.equations",
    "Equilibrium": "flexgen.dynamics.mechanics.statics",
    "Estimate": "flexgen.feedback.observers.extended_kalman",
    "Experiment": "flexgen.identification.experiments.experiment",
    "Exported": "flexgen.exports.exported",
    "ExtendedKalmanFilter": "flexgen.feedback.observers.extended_kalman",
    "Finding": "flexgen.studies.check.finding",
    "FastestMove": "flexgen.planning.fastest.minimum_time",
    "FeedbackLinearisation": "flexgen.feedback.laws.linearising",
    "FeedbackStudy": "flexgen.feedback.laws.study",
    "Frf": "flexgen.identification.responses.frequency_response",
    "Function": "flexgen.runtime.calls",
    "GeneratedLibrary": "flexgen.codegen.build.generate",
    "Grid": "flexgen.studies.sweeps.cases",
    "HalfSpace": "flexgen.planning.optimal.obstacles",
    "IdentificationResult": "flexgen.identification.responses.result",
    "Impedance": "flexgen.feedback.laws.impedance",
    "InverseKinematics": "flexgen.runtime.inversion.inverse_kinematics",
    "InversionOptions": "flexgen.runtime.inversion.many_inversion",
    "Inverter": "flexgen.runtime.inversion.path_inversion",
    "JointRecord": "flexgen.identification.records.joint_record",
    "JointTorqueFeedback": "flexgen.feedback.laws.motor_laws",
    "LearningOptions": "flexgen.planning.learning.options",
    "LearningResult": "flexgen.planning.learning.learn",
    "LearningRun": "flexgen.planning.learning.history",
    "Library": "flexgen.runtime.library",
    "LimitedInverter": "flexgen.runtime.inversion.limited_inversion",
    "Limits": "flexgen.dynamics.mechanics.limits",
    "Linear": "flexgen.feedback.loop.controllers",
    "Load": "flexgen.identification.load.payload",
    "LoopAtPose": "flexgen.feedback.loop.margins",
    "LoopShaping": "flexgen.feedback.laws.loop_shaping",
    "LowPass": "flexgen.model.position_servo.filters",
    "LQ": "flexgen.feedback.laws.state_lq",
    "LQG": "flexgen.feedback.laws.lq",
    "Margins": "flexgen.feedback.loop.margins",
    "ManyInverter": "flexgen.runtime.inversion.many_inversion",
    "Measurement": "flexgen.feedback.loop.interface",
    "MotionFit": "flexgen.identification.motions.motion_fit",
    "Move": "flexgen.model.moves",
    "MoveC": "flexgen.model.moves",
    "Posture": "flexgen.model.moves",
    "MoveJ": "flexgen.model.moves",
    "MoveL": "flexgen.model.moves",
    "NextRun": "flexgen.planning.learning.next_run",
    "Notch": "flexgen.model.position_servo.filters",
    "Passivity": "flexgen.feedback.laws.passivity",
    "Path": "flexgen.paths.path",
    "PathAccuracy": "flexgen.paths.accuracy.figures",
    "PathSample": "flexgen.paths.reference",
    "PathSampler": "flexgen.runtime.streams.path_sampler",
    "Phase": "flexgen.planning.optimal.phase",
    "PID": "flexgen.feedback.loop.gains",
    "Plan": "flexgen.identification.experiments.excitation",
    "PlanProblem": "flexgen.planning.optimal.problem",
    "Priors": "flexgen.identification.poses.parameters",
    "PlantRun": "flexgen.feedback.loop.result",
    "Port": "flexgen.base.spec.ports",
    "PositionCommands": "flexgen.feedback.positions.result",
    "PoseTarget": "flexgen.model.moves",
    "PPI": "flexgen.feedback.loop.gains",
    "Prediction": "flexgen.studies.tolerances.result",
    "Program": "flexgen.model.moves",
    "RandomMove": "flexgen.studies.sweeps.cases",
    "RecordComparison": "flexgen.identification.motions.record_result",
    "Reference": "flexgen.feedback.loop.interface",
    "RobotModel": "flexgen.model.elements",
    "Scenario": "flexgen.studies.scenarios.scenario",
    "Score": "flexgen.studies.scenarios.score",
    "Servo": "flexgen.feedback.positions.servo",
    "ServoFit": "flexgen.identification.servo.fit_result",
    "GearFit": "flexgen.identification.gears.result",
    "SpringFit": "flexgen.identification.gears.spring_result",
    "ServoRecord": "flexgen.identification.servo.record",
    "Setting": "flexgen.feedback.laws.study",
    "Shaper": "flexgen.feedback.positions.shapers",
    "ShaperComparison": "flexgen.feedback.positions.shaper_comparison",
    "Simulation": "flexgen.simulation.result",
    "Solution": "flexgen.inversion.solution",
    "Segment": "flexgen.studies.scenarios.scenario",
    "Sphere": "flexgen.planning.optimal.obstacles",
    "StaticPoses": "flexgen.identification.poses.poses",
    "Status": "flexgen.inversion.judge.status",
    "Stream": "flexgen.runtime.streams.stream",
    "SweepResult": "flexgen.studies.sweeps.sweep",
    "TomeiPD": "flexgen.feedback.laws.motor_laws",
    "TorqueCommand": "flexgen.simulation.integration.hold",
    "Trajectory": "flexgen.base.motion.trajectory",
    "Trial": "flexgen.feedback.laws.study",
    "TuningResult": "flexgen.studies.scenarios.tune",
    "Wall": "flexgen.simulation.environment.wall",
    "Window": "flexgen.studies.scenarios.scenario",
    "WorkFrame": "flexgen.model.moves",
    "combinations": "flexgen.studies.sweeps.cases",
    "random_moves": "flexgen.studies.sweeps.cases",
}
_ERRORS = dict.fromkeys(
    ["FlexgenError", "ModelError", "ArgumentError", "SolverError", "BuildError"],
    "flexgen.base.errors",
)
_EXPORTS = {f"export_{name}": export.module for name, export in registry.EXPORTS.items()}
_PUBLIC = _VERBS | _EXPORTS | _NOUNS | _ERRORS
_FORMER = {  # names of version 0.2
    "ExportedFmu": "Exported",
    "Fastest": "FastestMove",
    "Generated": "GeneratedLibrary",
    "Identified": "IdentificationResult",
    "Learned": "LearningResult",
    "Tuned": "TuningResult",
}
# Functions of upper rooms that objects of lower ones call: pictures, reports, searches; imported
# when they are called. Rendered from the decorators `flexgen.base.registry.provides`, with
# "python tests/golden/update.py front".
_RESULTS = {
    "Analysis.plot": "flexgen.views.plots.linear:plot_analysis",
    "Analysis.report": "flexgen.views.reports.analysis_page:write_analysis",
    "Analysis.to_control": "flexgen.analysis.control_system:control_system",
    "Calibration.check_file": "flexgen.identification.poses.result:check_file",
    "Calibration.plot": "flexgen.views.plots.calibration:plot_calibration",
    "Check.all_findings": "flexgen.views.reports.texts:findings_of_check",
    "Check.implausible": "flexgen.studies.check.check:implausible_number",
    "Check.to_text": "flexgen.views.reports.texts:text_of_check",
    "Commissioning.check_file": "flexgen.identification.commissioning.result:check_file",
    "Comparison.plot": "flexgen.views.plots.along_path:plot_comparison",
    "Comparison.report": "flexgen.views.reports.html:report_comparison",
    "ControlRun.plot": "flexgen.views.plots.control:plot_control",
    "ControlRun.report": "flexgen.views.reports.control_page:write_control",
    "Detection.plot": "flexgen.views.plots.signals:plot_arrays",
    "Estimate.plot": "flexgen.views.plots.signals:plot_arrays",
    "Estimated.check_file": "flexgen.identification.responses.result:check_file",
    "Estimated.plot": "flexgen.views.plots.identification:parameter_plot",
    "Estimated.uncertainty": "flexgen.studies.tolerances.model_file:with_uncertainty",
    "FastestMove.plot": "flexgen.views.plots.signals:plot_fastest",
    "FastestMove.torques": "flexgen.studies.tolerances.prediction:torque_band",
    "FeedbackStudy.plot": "flexgen.views.plots.feedback_study:plot_feedback_study",
    "Frf.plot": "flexgen.views.plots.identification:response_grid",
    "Frf.report": "flexgen.views.reports.identification_page:write_responses",
    "GearFit.check_file": "flexgen.identification.gears.result:check_file",
    "GearFit.plot": "flexgen.views.plots.gears:plot_loops",
    "IdentificationResult.report": (
        "flexgen.views.reports.identification_page:write_identification"
    ),
    "IdentificationResult.verdict": "flexgen.identification.responses.verdict:verdict",
    "LearningResult.plot": "flexgen.views.plots.control:plot_learned",
    "LearningResult.report": "flexgen.views.reports.control_page:write_learned",
    "Move.fastest": "flexgen.planning.fastest.minimum_time:fastest_move",
    "Passivity.plot": "flexgen.views.plots.passivity:plot_passivity",
    "Path.plot": "flexgen.views.plots.signals:plot_path",
    "PathSample.plot": "flexgen.views.plots.signals:plot_arrays",
    "PlantRun.plot": "flexgen.views.plots.signals:plot_arrays",
    "PositionCommands.plot": "flexgen.views.plots.servo:plot_commands",
    "Prediction.plot": "flexgen.views.plots.uncertainty:plot_prediction",
    "RecordComparison.plot": "flexgen.views.plots.record_comparison:plot_record_comparison",
    "Result.content_as_html": "flexgen.views.reports.row_views:html_of_result",
    "Result.content_as_text": "flexgen.views.reports.row_views:text_of_result",
    "Result.picture": "flexgen.views.plots.canvas:save",
    "Result.report": "flexgen.views.reports.result_page:write_result",
    "RobotModel.numbers": "flexgen.dynamics.mechanics.parameters:names_of_numbers",
    "Score.plot": "flexgen.views.plots.control:plot_score",
    "Score.report": "flexgen.views.reports.control_page:write_score",
    "ServoFit.plot": "flexgen.views.plots.servo:plot_fit",
    "ShaperComparison.plot": "flexgen.views.plots.shapers:plot_shapers",
    "Simulation.plot": "flexgen.views.plots.signals:plot_simulation",
    "Solution.plot": "flexgen.views.plots.solution:plot_solution",
    "Solution.positions": "flexgen.feedback.positions.reference:with_positions",
    "Solution.report": "flexgen.views.reports.html:report_solution",
    "SpringFit.check_file": "flexgen.identification.gears.spring_result:check_file",
    "SpringFit.plot": "flexgen.views.plots.gears:plot_spring",
    "Trajectory.plot": "flexgen.views.plots.signals:plot_trajectory",
    "TuningResult.plot": "flexgen.views.plots.control:plot_tuning",
}
for _group, _targets in {
    "results": _RESULTS,
    "exports": {
        name: f"{export.module}:export_{name}" for name, export in registry.EXPORTS.items()
    },
    "devices": {"cuda": "flexgen.backends.cuda.library:CudaLibrary"},
    "methods": {
        "discretized": "flexgen.inversion.comparison.methods:DISCRETIZED",
        "bdf": "flexgen.inversion.comparison.methods:BDF",
        "reduced": "flexgen.inversion.comparison.methods:REDUCED",
        "kunkel-mehrmann": "flexgen.inversion.comparison.methods:KUNKEL_MEHRMANN",
    },
    "laws": {
        "lqg": "flexgen.feedback.laws.lq:LQG",
        "loop_shaping": "flexgen.feedback.laws.loop_shaping:LoopShaping",
        "feedback_linearisation": "flexgen.feedback.laws.linearising:FeedbackLinearisation",
        "computed_torque": "flexgen.feedback.laws.linearising:ComputedTorque",
        "tomei_pd": "flexgen.feedback.laws.motor_laws:TomeiPD",
        "joint_torque_feedback": "flexgen.feedback.laws.motor_laws:JointTorqueFeedback",
        "lq": "flexgen.feedback.laws.state_lq:LQ",
        "impedance": "flexgen.feedback.laws.impedance:Impedance",
    },
}.items():
    registry.register(_group, _targets)

__all__ = [*_PUBLIC, "__version__"]


_MODULES = ("jax", "torch")  # of other packages, imported where they are used


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return importlib.import_module(f"flexgen.{name}")
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    if name in _FORMER:
        from flexgen.base.calls.deprecation import warn_of_old

        new = _FORMER[name]
        warn_of_old(f"flexgen.{name}: given a former name, expected flexgen.{new}")
        return __getattr__(new)
    raise AttributeError(f"module 'flexgen' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
