"""flexgen: inverse dynamics of elastic robots, from a model file to C that runs in a controller.

The public verbs, the nouns they take and the errors they raise are resolved on first use: ``import flexgen`` is quick.
"""

from __future__ import annotations

import importlib
from typing import Any

from flexgen import registry
from flexgen.version import __version__ as __version__

_VERBS = {
    "models": "flexgen.model.catalogue",
    "describe": "flexgen.model.catalogue",
    "read": "flexgen.model.reader",
    "read_moves": "flexgen.model.task_files",
    "derive": "flexgen.mechanics.equations",
    "analyze": "flexgen.analysis.analyze",
    "check": "flexgen.plausibility.check",
    "plan": "flexgen.paths.path",
    "plan_problem": "flexgen.planning.problem",
    "solve": "flexgen.inversion.solve",
    "sweep": "flexgen.sweeps.sweep",
    "simulate": "flexgen.simulation.simulate",
    "generate": "flexgen.library.generate",
    "load": "flexgen.runtime.library",
    "excite": "flexgen.identification.experiments.plan",
    "measure": "flexgen.identification.experiments.experiment",
    "frf": "flexgen.identification.frequency_response",
    "identify": "flexgen.identification.graybox",
    "refine": "flexgen.identification.time_domain",
    "fit_motion": "flexgen.identification.motion_fit",
    "control": "flexgen.loop.control",
    "feedback_study": "flexgen.laws.study",
    "tune": "flexgen.benchmarks.tune",
    "fastest": "flexgen.performance.minimum_time",
    "identify_load": "flexgen.performance.payload",
    "kinematics": "flexgen.inverse_kinematics.search",
    "learn": "flexgen.performance.learn",
    "export": "flexgen.exports.added",
    "export_fmu": "flexgen.exports.fmu.export",
    "score": "flexgen.benchmarks.score",
    "export_mex": "flexgen.exports.mex.export",
    "export_plcopen": "flexgen.exports.plcopen.export",
    "export_ros2": "flexgen.exports.ros2.export",
    "export_selftest": "flexgen.exports.selftest.export",
    "export_simulink": "flexgen.exports.simulink.export",
    "export_mujoco": "flexgen.exports.mujoco",
    "export_urdf": "flexgen.exports.urdf",
    "schema": "flexgen.file_schema",
    "view": "flexgen.reports.view",
}
_NOUNS = {
    "Analysis": "flexgen.analysis.analyze",
    "Cascade": "flexgen.loop.controllers",
    "Check": "flexgen.plausibility.finding",
    "CollisionDetector": "flexgen.observers.collision",
    "ComputedTorque": "flexgen.laws.linearising",
    "Configuration": "flexgen.inverse_kinematics.search",
    "ConstantGainObserver": "flexgen.observers.constant_gain",
    "Controller": "flexgen.loop.interface",
    "ControlRun": "flexgen.loop.result",
    "Detection": "flexgen.observers.collision",
    "Disturbance": "flexgen.loop.disturbances",
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
    "InverseKinematics": "flexgen.runtime.inverse_kinematics",
    "Inverter": "flexgen.runtime.path_inversion",
    "JointTorqueFeedback": "flexgen.laws.motor_laws",
    "LearningResult": "flexgen.performance.learn",
    "Library": "flexgen.runtime.library",
    "LimitedInverter": "flexgen.runtime.limited_inversion",
    "Limits": "flexgen.inversion.bounds",
    "Linear": "flexgen.loop.controllers",
    "Load": "flexgen.performance.payload",
    "LoopAtPose": "flexgen.loop.margins",
    "LoopShaping": "flexgen.laws.loop_shaping",
    "LowPass": "flexgen.loop.controllers",
    "LQ": "flexgen.laws.state_lq",
    "LQG": "flexgen.laws.lq",
    "Margins": "flexgen.loop.margins",
    "Measurement": "flexgen.loop.interface",
    "MotionFit": "flexgen.identification.motion_fit",
    "Move": "flexgen.model.moves",
    "MoveC": "flexgen.model.moves",
    "MoveJ": "flexgen.model.moves",
    "MoveL": "flexgen.model.moves",
    "Notch": "flexgen.loop.controllers",
    "Path": "flexgen.paths.path",
    "PathSample": "flexgen.paths.reference",
    "PathSampler": "flexgen.runtime.path_sampler",
    "Phase": "flexgen.planning.phase",
    "PID": "flexgen.loop.gains",
    "Plan": "flexgen.identification.experiments.excitation",
    "PlanProblem": "flexgen.planning.problem",
    "PlantRun": "flexgen.loop.result",
    "Port": "flexgen.spec.ports",
    "PoseTarget": "flexgen.model.moves",
    "PPI": "flexgen.loop.gains",
    "Program": "flexgen.model.moves",
    "RandomMove": "flexgen.sweeps.cases",
    "Reference": "flexgen.loop.interface",
    "RobotModel": "flexgen.model.elements",
    "Scenario": "flexgen.benchmarks.scenario",
    "Score": "flexgen.benchmarks.score",
    "Setting": "flexgen.laws.study",
    "Simulation": "flexgen.simulation.result",
    "Solution": "flexgen.inversion.solution",
    "Segment": "flexgen.benchmarks.scenario",
    "Sphere": "flexgen.planning.obstacles",
    "Status": "flexgen.inversion.status",
    "Stream": "flexgen.runtime.stream",
    "SweepResult": "flexgen.sweeps.sweep",
    "TomeiPD": "flexgen.laws.motor_laws",
    "TorqueCommand": "flexgen.simulation.hold",
    "Trajectory": "flexgen.trajectory",
    "Trial": "flexgen.laws.study",
    "TuningResult": "flexgen.benchmarks.tune",
    "Window": "flexgen.benchmarks.scenario",
    "combinations": "flexgen.sweeps.cases",
    "random_moves": "flexgen.sweeps.cases",
}
_ERRORS = dict.fromkeys(["FlexgenError", "ModelError", "ArgumentError", "SolverError", "BuildError"], "flexgen.errors")
_PUBLIC = _VERBS | _NOUNS | _ERRORS
_FORMER = {  # names of version 0.2
    "ExportedFmu": "Exported",
    "Fastest": "FastestMove",
    "Generated": "GeneratedLibrary",
    "Identified": "IdentificationResult",
    "Learned": "LearningResult",
    "Tuned": "TuningResult",
}
# What objects of lower rooms call in upper ones: pictures, reports, searches; imported when they are called.
_RESULTS = {
    "Result.picture": "flexgen.plots.canvas:save",
    "Result.report": "flexgen.reports.result_page:write_result",
    "Detection.plot": "flexgen.plots.signals:plot_arrays",
    "Estimate.plot": "flexgen.plots.signals:plot_arrays",
    "Estimated.plot": "flexgen.plots.identification:parameter_plot",
    "FastestMove.plot": "flexgen.plots.signals:plot_fastest",
    "Frf.plot": "flexgen.plots.identification:response_grid",
    "Frf.report": "flexgen.reports.identification_page:write_responses",
    "Path.plot": "flexgen.plots.signals:plot_path",
    "PathSample.plot": "flexgen.plots.signals:plot_arrays",
    "PlantRun.plot": "flexgen.plots.signals:plot_arrays",
    "Simulation.plot": "flexgen.plots.signals:plot_simulation",
    "Trajectory.plot": "flexgen.plots.signals:plot_trajectory",
    "TuningResult.plot": "flexgen.plots.control:plot_tuning",
    "Analysis._repr_html_": "flexgen.reports.analysis_page:tables",
    "Analysis.plot": "flexgen.plots.linear:plot_analysis",
    "Analysis.report": "flexgen.reports.analysis_page:write_analysis",
    "Analysis.to_control": "flexgen.analysis.control_system:control_system",
    "ControlRun.plot": "flexgen.plots.control:plot_control",
    "ControlRun.report": "flexgen.reports.control_page:write_control",
    "FeedbackStudy.plot": "flexgen.plots.feedback_study:plot_feedback_study",
    "IdentificationResult.verdict": "flexgen.identification.verdict:verdict",
    "IdentificationResult.report": "flexgen.reports.identification_page:write_identification",
    "LearningResult.plot": "flexgen.plots.control:plot_learned",
    "LearningResult.report": "flexgen.reports.control_page:write_learned",
    "Move.fastest": "flexgen.performance.minimum_time:fastest_move",
    "Score.plot": "flexgen.plots.control:plot_score",
    "Score.report": "flexgen.reports.control_page:write_score",
    "Solution.plot": "flexgen.plots.solution:plot_solution",
    "Solution.report": "flexgen.reports.html:report_solution",
}
for _group, _targets in {
    "results": _RESULTS,
    "exports": {verb[7:]: f"{module}:{verb}" for verb, module in _VERBS.items() if verb.startswith("export_")},
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
    },
}.items():
    registry.register(_group, _targets)

__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
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
