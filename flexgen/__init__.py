"""flexgen: inverse dynamics of elastic robots, from a model file to C that runs in a controller.

The public verbs, the nouns they take and the errors they raise are resolved on first use: ``import flexgen`` is quick.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.2.0"

_VERBS = {
    "models": "flexgen.model.catalogue",
    "describe": "flexgen.model.catalogue",
    "read": "flexgen.model.reader",
    "read_moves": "flexgen.model.task_files",
    "derive": "flexgen.mechanics.equations",
    "analyze": "flexgen.analysis.analyze",
    "plan": "flexgen.paths.path",
    "plan_problem": "flexgen.planning.problem",
    "solve": "flexgen.inversion.solve",
    "sweep": "flexgen.sweeps.sweep",
    "simulate": "flexgen.simulation.simulate",
    "generate": "flexgen.build.generate",
    "load": "flexgen.runtime",
    "excite": "flexgen.identification.experiments.plan",
    "measure": "flexgen.identification.experiments.experiment",
    "frf": "flexgen.identification.frequency_response",
    "identify": "flexgen.identification.graybox",
    "refine": "flexgen.identification.time_domain",
    "fit_motion": "flexgen.identification.motion_fit",
    "control": "flexgen.motion_control.control",
    "feedback_study": "flexgen.motion_control.laws.study",
    "tune": "flexgen.motion_control.benchmarks.tune",
    "fastest": "flexgen.motion_control.minimum_time",
    "identify_load": "flexgen.motion_control.payload",
    "kinematics": "flexgen.inverse_kinematics.search",
    "learn": "flexgen.motion_control.learn",
    "export_fmu": "flexgen.export.fmu.export",
    "score": "flexgen.motion_control.benchmarks.score",
    "export_mex": "flexgen.export.mex.export",
    "export_plcopen": "flexgen.export.plcopen.export",
    "export_ros2": "flexgen.export.ros2.export",
    "export_selftest": "flexgen.export.selftest.export",
    "export_simulink": "flexgen.export.simulink.export",
    "export_mujoco": "flexgen.export.mujoco",
    "export_urdf": "flexgen.export.urdf",
    "schema": "flexgen.export.schema",
    "view": "flexgen.reports.view",
}
_NOUNS = {
    "Cascade": "flexgen.loop.controllers",
    "CollisionDetector": "flexgen.motion_control.collision",
    "ComputedTorque": "flexgen.motion_control.laws.linearising",
    "Configuration": "flexgen.inverse_kinematics.search",
    "ConstantGainObserver": "flexgen.motion_control.observers.constant_gain",
    "ControlRun": "flexgen.motion_control.result",
    "Disturbance": "flexgen.motion_control.disturbances",
    "DriveHardware": "flexgen.loop.hardware",
    "Experiment": "flexgen.identification.experiments.experiment",
    "ExtendedKalmanFilter": "flexgen.motion_control.observers.extended_kalman",
    "Fastest": "flexgen.motion_control.minimum_time",
    "FeedbackLinearisation": "flexgen.motion_control.laws.linearising",
    "FeedbackStudy": "flexgen.motion_control.laws.study",
    "Frf": "flexgen.identification.frequency_response",
    "Grid": "flexgen.sweeps.cases",
    "HalfSpace": "flexgen.planning.obstacles",
    "Identified": "flexgen.identification.result",
    "JointTorqueFeedback": "flexgen.motion_control.laws.motor_laws",
    "LQ": "flexgen.motion_control.laws.state_lq",
    "LQG": "flexgen.motion_control.lq",
    "Learned": "flexgen.motion_control.learn",
    "Limits": "flexgen.inversion.bounds",
    "Load": "flexgen.motion_control.payload",
    "Linear": "flexgen.loop.controllers",
    "LoopShaping": "flexgen.motion_control.laws.loop_shaping",
    "LowPass": "flexgen.loop.controllers",
    "Move": "flexgen.model.moves",
    "MoveC": "flexgen.model.moves",
    "MoveJ": "flexgen.model.moves",
    "PoseTarget": "flexgen.model.moves",
    "MoveL": "flexgen.model.moves",
    "Notch": "flexgen.loop.controllers",
    "PID": "flexgen.motion_control.gains",
    "PPI": "flexgen.motion_control.gains",
    "Path": "flexgen.paths.path",
    "Plan": "flexgen.identification.experiments.excitation",
    "PlanProblem": "flexgen.planning.problem",
    "Program": "flexgen.model.moves",
    "Score": "flexgen.motion_control.benchmarks.score",
    "Solution": "flexgen.inversion.solution",
    "Sphere": "flexgen.planning.obstacles",
    "Status": "flexgen.inversion.status",
    "TomeiPD": "flexgen.motion_control.laws.motor_laws",
    "Trajectory": "flexgen.trajectory",
    "Tuned": "flexgen.motion_control.benchmarks.tune",
    "combinations": "flexgen.sweeps.cases",
    "random_moves": "flexgen.sweeps.cases",
}
_ERRORS = dict.fromkeys(["FlexgenError", "ModelError", "ArgumentError", "SolverError", "BuildError"], "flexgen.errors")
_PUBLIC = _VERBS | _NOUNS | _ERRORS
# Methods of classes in lower packages that upper packages implement: imported when they are called.
_METHODS = {
    "Analysis.plot": ("flexgen.plots.linear", "plot_analysis"),
    "Analysis.report": ("flexgen.reports.analysis_page", "write_analysis"),
    "Analysis.to_control": ("flexgen.analysis.control_system", "control_system"),
    "ControlRun.plot": ("flexgen.plots.control", "plot_control"),
    "ControlRun.report": ("flexgen.reports.control_page", "write_control"),
    "FeedbackStudy.plot": ("flexgen.plots.feedback_study", "plot_feedback_study"),
    "Identified.verdict": ("flexgen.identification.verdict", "verdict"),
    "Identified.report": ("flexgen.reports.identification_page", "write_identification"),
    "Learned.plot": ("flexgen.plots.control", "plot_learned"),
    "Learned.report": ("flexgen.reports.control_page", "write_learned"),
    "Move.fastest": ("flexgen.motion_control.minimum_time", "fastest_move"),
    "Score.plot": ("flexgen.plots.control", "plot_score"),
    "Score.report": ("flexgen.reports.control_page", "write_score"),
    "Solution.plot": ("flexgen.plots.solution", "plot_solution"),
    "Solution.report": ("flexgen.reports.html", "report_solution"),
    "Trajectory.at": ("flexgen.simulation.interpolation", "interpolate"),
}

__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
    if name in _PUBLIC:
        return getattr(importlib.import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module 'flexgen' has no attribute {name!r}")


def implementation(method: str) -> Any:
    """The function that implements a method of a class in a lower package, such as ``Solution.plot``."""
    module, name = _METHODS[method]
    return getattr(importlib.import_module(module), name)


def __dir__() -> list[str]:
    return sorted(__all__)
