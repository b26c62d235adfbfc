"""flexgen: inverse dynamics of elastic robots, from a model file to C that runs in a controller.

The public verbs, the nouns they take and the errors they raise are resolved on first use:
``import flexgen`` is quick.
"""

from __future__ import annotations

import importlib
from typing import Any

from flexgen import registry
from flexgen.version import __version__ as __version__

_VERBS = {
    "models": "flexgen.model_files.catalogue",
    "describe": "flexgen.model_files.catalogue",
    "read": "flexgen.model.reader",
    "read_moves": "flexgen.paths.move_files",
    "derive": "flexgen.mechanics.equations",
    "analyze": "flexgen.analysis.analyze",
    "check": "flexgen.plausibility.check",
    "plan": "flexgen.paths.path",
    "plan_problem": "flexgen.planning.problem",
    "predict": "flexgen.uncertainty.prediction",
    "solve": "flexgen.inversion.solve",
    "sweep": "flexgen.sweeps.sweep",
    "compare": "flexgen.loop.comparison",
    "compare_feedforward": "flexgen.loop.feedforward",
    "simulate": "flexgen.simulation.simulate",
    "generate": "flexgen.library.generate",
    "load": "flexgen.runtime.library",
    "excite": "flexgen.identification.experiments.plan",
    "measure": "flexgen.identification.experiments.experiment",
    "frf": "flexgen.identification.frequency_response",
    "identify": "flexgen.identification.graybox",
    "refine": "flexgen.identification.time_domain",
    "fit_motion": "flexgen.identification.motion_fit",
    "calibrate": "flexgen.calibration.calibrate",
    "sense": "flexgen.environment.sense",
    "tracker_positions": "flexgen.inverse_kinematics.forward",
    "control": "flexgen.loop.control",
    "check_passivity": "flexgen.laws.passivity",
    "command_positions": "flexgen.servo.command",
    "identify_servo": "flexgen.servo.identify",
    "identify_gears": "flexgen.gears.identify",
    "feedback_study": "flexgen.laws.study",
    "tune": "flexgen.benchmarks.tune",
    "tune_cascade": "flexgen.benchmarks.tune_cascade",
    "fastest": "flexgen.performance.minimum_time",
    "identify_load": "flexgen.performance.payload",
    "kinematics": "flexgen.inverse_kinematics.search",
    "learn": "flexgen.performance.learn",
    "export": "flexgen.exports.added",
    "score": "flexgen.benchmarks.score",
    "schema": "flexgen.model_files.json_schema",
    "view": "flexgen.reports.view",
}
# Functions whose command needs no row in verbs.py: their parameters and docstrings give its
# options.
_COMMANDS = ("identify_load", "identify_gears")
# Exports, by the name of the command; each is the function ``export_NAME`` of its module.
registry.EXPORTS |= {
    "fmu": registry.Export(
        "flexgen.exports.fmu.export",
        "[FMU](fmu.md)",
        "Write a Functional Mock-up Unit (FMI 2.0 or 3.0) for simulation programs.",
        """
    content
        block NAME in=plant/feedforward/controller: plant (default): the elastic robot; \
feedforward: inverse dynamics on
            a moving horizon; controller: a P-PI cascade
        version VERSION in=2.0/3.0 --fmi: version of FMI: 2.0 (default) or 3.0
    options of a block
        method NAME in=rk4/sdirk4: plant in Co-Simulation: rk4 (default), explicit, or sdirk4, \
implicit and L-stable,
            for stiff springs
        step S positive: its largest step [s]; default: from the fastest pole at home
        controller FILE text: of type ppi or cascade (.toml); default: PPI for the model
        sample_time S positive: sample time of the controller [s]; default: 0.001
        look_ahead S positive: horizon of the feedforward [s]; default: from the unstable zeros
    files
        out FILE: write to this file (.fmu); default: generated/MODEL.fmu
        platforms NAME,NAME,... names: compile binaries for these platforms with the package \
ziglang: all, or names of
            FMI such as win64, linux64, darwin64, aarch64-linux; default: this platform
        no_binary old=--sources-only: without a binary
""",
    ),
    "mujoco": registry.Export(
        "flexgen.exports.mujoco",
        "[exchange](exchange.md)",
        "Write the elastic robot as an MJCF file for MuJoCo, with the same accelerations.",
        """
    content
        friction NAME in=exact/viscous/dry: exact (the default): a model with Coulomb or Stribeck \
friction is refused;
            viscous: these are left out; dry: Coulomb friction as MuJoCo has it, with other \
accelerations
    files
        out FILE required: write the MJCF file, FILE.xml
""",
    ),
    "urdf": registry.Export(
        "flexgen.exports.urdf",
        "[exchange](exchange.md)",
        "Write the rigid robot as a URDF file, and an overlay of flexgen with all that URDF "
        "cannot contain.",
        """
    files
        out FILE required: write the URDF file, FILE.urdf, and next to it the overlay, FILE.toml
""",
    ),
    "selftest": registry.Export(
        "flexgen.exports.selftest.export",
        "[PLC](plc.md)",
        "Write a C program that tests the library on its target, with results of Lagrange's "
        "equations: PASS or FAIL.",
        """
    content
        precision NAME in=double/single old=--single=single: of the library; default: {default}
        move NAME: the move that the stream follows; default: the first
        no_motion: without a stream along a move
    files
        out DIR once old=--directory: where to write; default: exports/<model>_selftest
        @replace
""",
    ),
    "ros2": registry.Export(
        "flexgen.exports.ros2.export",
        "[ROS 2](ros2.md)",
        "Write a ROS 2 package: a plugin of inverse dynamics, and a controller with a stream "
        "and P-PI control.",
        """
    content
        package NAME: of the package; default: flexgen_<model>
        no_controller: the plugin of inverse dynamics only
        no_gains: leave the gains of the controller open
        parts NAME,NAME,... names: force: the controller takes a known force on the tool, with \
the samples and from a
            topic; limits: its stream keeps limits; position: it sends positions to servos, table \
[servo]
    package.xml
        maintainer TEXT: name for package.xml; default: {default}
        email TEXT: address for package.xml; default: {default}
        license_name TEXT old=--license: license for package.xml; default: {default}
    files
        out DIR once old=--directory: where to write; default: exports/<package>
        @replace
""",
    ),
    "mex": registry.Export(
        "flexgen.exports.mex.export",
        "[MATLAB](matlab.md)",
        "Write functions for MATLAB and GNU Octave: functions of a point, inversion of a path, "
        "and a stream.",
        """
    files
        out DIR once old=--directory: where to write; default: exports/<model>_mex
        @replace
""",
    ),
    "simulink": registry.Export(
        "flexgen.exports.simulink.export",
        "[MATLAB](matlab.md)",
        "Write blocks for Simulink: functions for C Caller, and S-functions of a stream and of "
        "inverse dynamics.",
        """
    content
        @no_stream
    files
        out DIR once old=--directory: where to write; default: exports/<model>_simulink
        @replace
""",
    ),
    "plcopen": registry.Export(
        "flexgen.exports.plcopen.export",
        "[PLC](plc.md)",
        "Write function blocks of IEC 61131-3 (ST and PLCopen XML) with their bodies in C.",
        """
    content
        @no_stream
    files
        out DIR once old=--directory: where to write; default: exports/<model>_plcopen
        @replace
""",
    ),
}
_NOUNS = {
    "Analysis": "flexgen.analysis.analyze",
    "Calibration": "flexgen.calibration.result",
    "Cascade": "flexgen.loop.controllers",
    "Check": "flexgen.plausibility.finding",
    "CollisionDetector": "flexgen.observers.collision",
    "CascadeTuning": "flexgen.benchmarks.tune_cascade",
    "Comparison": "flexgen.loop.comparison",
    "FeedforwardComparison": "flexgen.loop.feedforward",
    "ComputedTorque": "flexgen.laws.linearising",
    "Configuration": "flexgen.inverse_kinematics.search",
    "ConstantGainObserver": "flexgen.observers.constant_gain",
    "Controller": "flexgen.loop.interface",
    "ControlRun": "flexgen.loop.result",
    "Detection": "flexgen.observers.collision",
    "Disturbance": "flexgen.environment.disturbances",
    "DriveHardware": "flexgen.loop.hardware",
    "Equations": "flexgen.mechanics.equations",
    "Equilibrium": "flexgen.mechanics.statics",
    "Estimate": "flexgen.observers.extended_kalman",
    "Experiment": "flexgen.identification.experiments.experiment",
    "Exported": "flexgen.exports.exported",
    "ExtendedKalmanFilter": "flexgen.observers.extended_kalman",
    "Finding": "flexgen.plausibility.finding",
    "FastestMove": "flexgen.performance.minimum_time",
    "FeedbackLinearisation": "flexgen.laws.linearising",
    "FeedbackStudy": "flexgen.laws.study",
    "Frf": "flexgen.identification.frequency_response",
    "Function": "flexgen.runtime.calls",
    "GeneratedLibrary": "flexgen.library.generate",
    "Grid": "flexgen.sweeps.cases",
    "HalfSpace": "flexgen.planning.obstacles",
    "IdentificationResult": "flexgen.identification.result",
    "Impedance": "flexgen.laws.impedance",
    "InverseKinematics": "flexgen.runtime.inverse_kinematics",
    "InversionOptions": "flexgen.runtime.many_inversion",
    "Inverter": "flexgen.runtime.path_inversion",
    "JointTorqueFeedback": "flexgen.laws.motor_laws",
    "LearningResult": "flexgen.performance.learn",
    "Library": "flexgen.runtime.library",
    "LimitedInverter": "flexgen.runtime.limited_inversion",
    "Limits": "flexgen.mechanics.limits",
    "Linear": "flexgen.loop.controllers",
    "Load": "flexgen.performance.payload",
    "LoopAtPose": "flexgen.loop.margins",
    "LoopShaping": "flexgen.laws.loop_shaping",
    "LowPass": "flexgen.position_servo.filters",
    "LQ": "flexgen.laws.state_lq",
    "LQG": "flexgen.laws.lq",
    "Margins": "flexgen.loop.margins",
    "ManyInverter": "flexgen.runtime.many_inversion",
    "Measurement": "flexgen.loop.interface",
    "MotionFit": "flexgen.identification.motion_fit",
    "Move": "flexgen.model.moves",
    "MoveC": "flexgen.model.moves",
    "MoveJ": "flexgen.model.moves",
    "MoveL": "flexgen.model.moves",
    "Notch": "flexgen.position_servo.filters",
    "Passivity": "flexgen.laws.passivity",
    "Path": "flexgen.paths.path",
    "PathAccuracy": "flexgen.accuracy.figures",
    "PathSample": "flexgen.paths.reference",
    "PathSampler": "flexgen.runtime.path_sampler",
    "Phase": "flexgen.planning.phase",
    "PID": "flexgen.loop.gains",
    "Plan": "flexgen.identification.experiments.excitation",
    "PlanProblem": "flexgen.planning.problem",
    "Priors": "flexgen.calibration.parameters",
    "PlantRun": "flexgen.loop.result",
    "Port": "flexgen.spec.ports",
    "PositionCommands": "flexgen.servo.result",
    "PoseTarget": "flexgen.model.moves",
    "PPI": "flexgen.loop.gains",
    "Prediction": "flexgen.uncertainty.result",
    "Program": "flexgen.model.moves",
    "RandomMove": "flexgen.sweeps.cases",
    "Reference": "flexgen.loop.interface",
    "RobotModel": "flexgen.model.elements",
    "Scenario": "flexgen.benchmarks.scenario",
    "Score": "flexgen.benchmarks.score",
    "Servo": "flexgen.servo.servo",
    "ServoFit": "flexgen.servo.fit_result",
    "GearFit": "flexgen.gears.result",
    "ServoRecord": "flexgen.servo.record",
    "Setting": "flexgen.laws.study",
    "Simulation": "flexgen.simulation.result",
    "Solution": "flexgen.inversion.solution",
    "Segment": "flexgen.benchmarks.scenario",
    "Sphere": "flexgen.planning.obstacles",
    "StaticPoses": "flexgen.calibration.poses",
    "Status": "flexgen.inversion.status",
    "Stream": "flexgen.runtime.stream",
    "SweepResult": "flexgen.sweeps.sweep",
    "TomeiPD": "flexgen.laws.motor_laws",
    "TorqueCommand": "flexgen.simulation.hold",
    "Trajectory": "flexgen.trajectory",
    "Trial": "flexgen.laws.study",
    "TuningResult": "flexgen.benchmarks.tune",
    "Wall": "flexgen.environment.wall",
    "Window": "flexgen.benchmarks.scenario",
    "combinations": "flexgen.sweeps.cases",
    "random_moves": "flexgen.sweeps.cases",
}
_ERRORS = dict.fromkeys(
    ["FlexgenError", "ModelError", "ArgumentError", "SolverError", "BuildError"], "flexgen.errors"
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
# What objects of lower rooms call in upper ones: pictures, reports, searches; imported when they
# are called.
_RESULTS = {
    "Result.picture": "flexgen.plots.canvas:save",
    "Result.report": "flexgen.reports.result_page:write_result",
    "Calibration.check_file": "flexgen.calibration.result:check_file",
    "Calibration.plot": "flexgen.plots.calibration:plot_calibration",
    "Calibration.to_text": "flexgen.reports.calibration_texts:text_of_calibration",
    "Detection.plot": "flexgen.plots.signals:plot_arrays",
    "Estimate.plot": "flexgen.plots.signals:plot_arrays",
    "Estimated.check_file": "flexgen.identification.result:check_file",
    "Estimated.uncertainty": "flexgen.uncertainty.model_file:with_uncertainty",
    "Estimated.plot": "flexgen.plots.identification:parameter_plot",
    "FastestMove.torques": "flexgen.uncertainty.prediction:torque_band",
    "FastestMove.plot": "flexgen.plots.signals:plot_fastest",
    "Frf.plot": "flexgen.plots.identification:response_grid",
    "Frf.report": "flexgen.reports.identification_page:write_responses",
    "RobotModel.numbers": "flexgen.mechanics.parameters:names_of_numbers",
    "Path.plot": "flexgen.plots.signals:plot_path",
    "PositionCommands.plot": "flexgen.plots.servo:plot_commands",
    "ServoFit.plot": "flexgen.plots.servo:plot_fit",
    "GearFit.check_file": "flexgen.gears.result:check_file",
    "GearFit.plot": "flexgen.plots.gears:plot_loops",
    "PathSample.plot": "flexgen.plots.signals:plot_arrays",
    "PlantRun.plot": "flexgen.plots.signals:plot_arrays",
    "Solution.positions": "flexgen.servo.reference:with_positions",
    "Simulation.plot": "flexgen.plots.signals:plot_simulation",
    "Trajectory.plot": "flexgen.plots.signals:plot_trajectory",
    "TuningResult.plot": "flexgen.plots.control:plot_tuning",
    "Analysis._repr_html_": "flexgen.reports.analysis_page:tables",
    "Analysis.plot": "flexgen.plots.linear:plot_analysis",
    "Analysis.report": "flexgen.reports.analysis_page:write_analysis",
    "Analysis.to_text": "flexgen.reports.texts:text_of_analysis",
    "Check.implausible": "flexgen.plausibility.check:implausible_number",
    "Check.to_text": "flexgen.reports.texts:text_of_check",
    "Check.all_findings": "flexgen.reports.texts:findings_of_check",
    "ControlRun.to_text": "flexgen.reports.control_texts:text_of_control",
    "Experiment.to_text": "flexgen.reports.identification_texts:text_of_experiment",
    "Frf.to_text": "flexgen.reports.identification_texts:text_of_responses",
    "IdentificationResult.to_text": "flexgen.reports.identification_texts:text_of_identification",
    "MotionFit.to_text": "flexgen.reports.identification_texts:text_of_motion_fit",
    "Path.to_text": "flexgen.reports.texts:text_of_path",
    "RigidIdentification.to_text": "flexgen.reports.identification_texts:text_of_rigid",
    "Simulation.to_text": "flexgen.reports.texts:text_of_simulation",
    "Solution.to_text": "flexgen.reports.texts:text_of_solution",
    "SweepResult.to_text": "flexgen.reports.texts:text_of_sweep",
    "Analysis.to_control": "flexgen.analysis.control_system:control_system",
    "Comparison.plot": "flexgen.plots.along_path:plot_comparison",
    "Comparison.report": "flexgen.reports.html:report_comparison",
    "ControlRun.plot": "flexgen.plots.control:plot_control",
    "ControlRun.report": "flexgen.reports.control_page:write_control",
    "FeedbackStudy.plot": "flexgen.plots.feedback_study:plot_feedback_study",
    "IdentificationResult.verdict": "flexgen.identification.verdict:verdict",
    "IdentificationResult.report": "flexgen.reports.identification_page:write_identification",
    "LearningResult.plot": "flexgen.plots.control:plot_learned",
    "LearningResult.report": "flexgen.reports.control_page:write_learned",
    "Move.fastest": "flexgen.performance.minimum_time:fastest_move",
    "Passivity.plot": "flexgen.plots.passivity:plot_passivity",
    "Prediction.plot": "flexgen.plots.uncertainty:plot_prediction",
    "Score.plot": "flexgen.plots.control:plot_score",
    "Score.report": "flexgen.reports.control_page:write_score",
    "Solution.plot": "flexgen.plots.solution:plot_solution",
    "Solution.report": "flexgen.reports.html:report_solution",
}
for _group, _targets in {
    "results": _RESULTS,
    "exports": {
        name: f"{export.module}:export_{name}" for name, export in registry.EXPORTS.items()
    },
    "devices": {"cuda": "flexgen.cuda.library:CudaLibrary"},
    "methods": {
        "discretized": "flexgen.lab.methods:DISCRETIZED",
        "bdf": "flexgen.lab.methods:BDF",
        "reduced": "flexgen.lab.methods:REDUCED",
        "kunkel-mehrmann": "flexgen.lab.methods:KUNKEL_MEHRMANN",
    },
    "laws": {
        "lqg": "flexgen.laws.lq:LQG",
        "loop_shaping": "flexgen.laws.loop_shaping:LoopShaping",
        "feedback_linearisation": "flexgen.laws.linearising:FeedbackLinearisation",
        "computed_torque": "flexgen.laws.linearising:ComputedTorque",
        "tomei_pd": "flexgen.laws.motor_laws:TomeiPD",
        "joint_torque_feedback": "flexgen.laws.motor_laws:JointTorqueFeedback",
        "lq": "flexgen.laws.state_lq:LQ",
        "impedance": "flexgen.laws.impedance:Impedance",
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
        from flexgen.deprecation import warn_of_old

        new = _FORMER[name]
        warn_of_old(f"flexgen.{name}: given a former name, expected flexgen.{new}")
        return __getattr__(new)
    raise AttributeError(f"module 'flexgen' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
