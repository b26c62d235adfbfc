"""The verbs of the command line: a row for each.

Options that are parameters of the public function are names; type, default, allowed values and
help are those of the parameter, see `flexgen.cli.verb_tables.verb_parameters`. What the command
line alone has, such as files, is an `Option` with all that it is.

Parser, help and completion of the command line are rendered from these rows; those of exports are
in `flexgen`. A verb whose options are all parameters needs no row, only its name in ``_COMMANDS``
of `flexgen`.
"""

from __future__ import annotations

import flexgen
from flexgen.base.registry import EXPORTS, Export, Option
from flexgen.cli.verb_tables.verb_rows import Verb

# What several verbs have.
MOVE_ONCE = Option("move", once=True)
MOVES_FILE = Option("moves", "read moves and programs from this TOML file", "FILE")
IGNORE_LIMITS = Option("ignore_limits", more="; without it the exit status is 3")
CONTROLLER = Option("controller", more=", {LAWS}, {CONTROLLERS}")
SERVO_FILE = Option("servo", metavar="FILE")
TIME_OF_SOLVE = Option(
    "time_limit",
    old=("--time",),
    more=": then, or after Ctrl-C, it ends with the best solution so far (exit status 1, or 130)",
)
TIME_OF_FIT = Option(
    "time_limit",
    more=": then, or after Ctrl-C, it ends with the best step so far, which is printed and "
    "written (exit status 1, or 130)",
)
TIME_OF_PARTS = Option(
    "time_limit",
    more=": then, or after Ctrl-C, it ends with what was computed until then, which is printed "
    "and written (exit status 1, or 130)",
)
PAGE = Option("report", "write a self-contained HTML page to DIR", "DIR")
REPORT = Option("report", "write a self-contained HTML report to DIR", "DIR")


ROWS = (
    Verb("models", action="robot:models", function="models", rows={}),
    Verb(
        "new",
        action="new:new",
        rows={
            "arguments": (Option("name", "of the robot, an identifier", "NAME", place=True),),
            "content": (
                Option(
                    "template",
                    "{TEMPLATES}; default: planar",
                    "NAME",
                    choices=("TEMPLATES",),
                    group="kind",
                ),
                Option(
                    "urdf",
                    "with elastic gears for a URDF file: FILE.urdf#BASE:TIP; default: "
                    "its root and its farthest link",
                    "FILE",
                    "text",
                    group="kind",
                ),
                Option(
                    "dh",
                    "with elastic gears for a table of Denavit-Hartenberg parameters "
                    "(.csv), units in its header; see docs/datasheet.md",
                    "FILE",
                    "text",
                    group="kind",
                ),
                Option(
                    "payload",
                    "of a URDF file: an elastic beam on the tip of a robot that takes "
                    "positions, from its drawing (m, Pa, kg/m^3), such as beam:length=0.52,"
                    "width=0.08,height=0.001,modulus=190e9,density=7870,angle_deg=30",
                    "BEAM",
                    "text",
                ),
                Option(
                    "link",
                    "of the template flexible-link: its elastic link from a drawing "
                    "(m, Pa, kg/m^3), such as beam:length=0.8,width=0.05,height=0.008,"
                    "modulus=70e9,density=2700,damping=0.01",
                    "BEAM",
                    "text",
                ),
                Option(
                    "convention",
                    "of the table: a and alpha lead to the next axis (standard), or "
                    "come before the axis (modified, Craig); not needed where the "
                    "header has a_prev and alpha_prev",
                    "NAME",
                    choices=("standard", "modified"),
                ),
            ),
            "files": (
                Option(
                    "out", "write to this file (.toml); default: NAME.toml", "FILE", "toml_file"
                ),
                Option("force", "replace the file"),
            ),
        },
    ),
    Verb("describe", action="robot:describe", function="describe", rows={}),
    Verb("check", function="check", rows={}),
    Verb(
        "derive",
        action="robot:derive",
        function="derive",
        rows={
            "files": (
                Option("text", "equations as plain text (default for small models)", group="kind"),
                Option("latex", "equations as a LaTeX document", group="kind"),
                Option("out", "write the equations to this file (.tex: as LaTeX)", "FILE"),
            ),
        },
    ),
    Verb(
        "analyze",
        action="robot:analyze",
        function="analyze",
        rows={
            "where": (
                Option("pose", metavar="Q ..."),
                Option(
                    "move", "also analyze zeros and solvability along this move", "NAME", once=True
                ),
            ),
            "files": (PAGE,),
        },
    ),
    Verb(
        "generate",
        action="generate:generate",
        function="generate",
        rows={
            "content": (
                "functions",
                "parameters",
                Option("parts", word="--with"),
                Option("precision", old=("--single=single",), metavar="NAME"),
            ),
            "compilation": ("no_build", "native", "isa", "target", "openmp"),
            "files": (
                Option(
                    "out",
                    "folder of the library; default: generated/MODEL",
                    "DIR",
                    once=True,
                    old=("--directory",),
                ),
                "amalgamate",
                "force",
            ),
        },
    ),
    Verb(
        "solve",
        action="solve:solve",
        function="solve",
        rows={
            "motion": (
                Option(
                    "move",
                    several=True,
                    more=(
                        "; given several times: all of them, with FILE_NAME and DIR/NAME as"
                        " outputs"
                    ),
                ),
                MOVES_FILE,
                Option(
                    "fastest",
                    "with the fastest time law within the limits; 'flexgen fastest' has"
                    " further options",
                ),
                Option("fixed_joint", metavar="NAME"),
                "force",
            ),
            "method": (
                "method",
                "no_verify",
                "preview",
                "mesh",
                Option(
                    "limits",
                    "keep the limits of the model file (method lq; collocation and full"
                    " those of torque, speed and deflection)",
                ),
                "accuracy",
                IGNORE_LIMITS,
                TIME_OF_SOLVE,
            ),
            "controller": (
                Option(
                    "hold",
                    more=(
                        "; the torques to send are verified with it and written to "
                        "FILE_command next to --out FILE"
                    ),
                ),
                "sample_time",
                "delay",
                "command",
            ),
            "files": (
                Option(
                    "out",
                    "write the trajectory to this file (.npz, .csv or .mat)",
                    "FILE",
                    "trajectory_file",
                ),
                REPORT,
                Option("details", "print all figures of the solution, not only the main ones"),
                Option(
                    "robustness",
                    "with --report: also simulate robots with stiffness errors of 5 and"
                    " 20 % and mass errors of 5 % (takes minutes)",
                ),
            ),
        },
    ),
    Verb(
        "plan",
        action="path:path",
        function="plan",
        rows={
            "motion": (MOVE_ONCE, MOVES_FILE, "ignore_limits"),
            "files": (
                Option(
                    "out",
                    "write the path as a C header for MODEL_path_sample to this file",
                    "FILE",
                    old=("--table",),
                ),
            ),
        },
        old="path",
    ),
    Verb(
        "predict",
        function="predict",
        rows={
            "motion": (MOVE_ONCE,),
            "draws": ("robots", "seed"),
            "time": (TIME_OF_PARTS,),
            "files": (
                Option("out", "write the result to this file (.json)", "FILE"),
                PAGE,
            ),
        },
    ),
    Verb(
        "simulate",
        action="solve:simulate",
        function="simulate",
        rows={
            "arguments": ("trajectory",),
            "robot": ("wall",),
            "time": ("time_limit",),
            "files": (
                Option(
                    "out", "write the simulated motion to this file", "FILE", "trajectory_file"
                ),
            ),
        },
    ),
    Verb(
        "sense",
        action="solve:sense",
        function="sense",
        rows={
            "arguments": ("motion",),
            "files": (
                Option(
                    "out", "write what the sensors read to this file", "FILE", "trajectory_file"
                ),
            ),
        },
    ),
    Verb(
        "sweep",
        action="sweep:sweep",
        function="sweep",
        rows={
            "arguments": ("grid",),
            "work": ("workers", "shard_size", "resume"),
            "time": (TIME_OF_PARTS,),
            "files": (
                Option("out", required=True, metavar="DIR"),
                Option("parquet", "write results.parquet too (needs pyarrow)"),
            ),
        },
    ),
    Verb(
        "excite",
        action="identify:excite",
        function="excite",
        rows={
            "poses": (
                "poses",
                Option(
                    "pose",
                    "joint positions [rad or m] of a pose, in place of chosen ones; may be "
                    "repeated",
                    "Q,Q,...",
                    "pose",
                    several=True,
                ),
                "criterion",
                "free",
                "obstacles",
                "clearance",
            ),
            "excitation": (
                Option("speed_rms", metavar="V"),
                "f_min",
                "f_max",
                "lines",
                "spectrum",
                Option("period_s", old=("--period",)),
                "periods",
                "transients",
                "realizations",
                "seed",
            ),
            "drive and sensors": (
                "sensors",
                Option("sample_time", "of the drives [s]; default: 0.0005", "S", "positive"),
                Option("delay", "of the torques [s]; default: 0", "S", "not_negative"),
                Option("encoder_noise", "[rad, motor side]; default: 0", "X", "not_negative"),
                Option("encoder_resolution", "[rad, motor side]; default: 0", "X", "not_negative"),
                Option("torque_noise", "[N m, motor side]; default: 0", "X", "not_negative"),
            ),
            "time": (TIME_OF_PARTS,),
            "files": (
                Option(
                    "out", "write the plan to this .npz file", "FILE", "npz_file", required=True
                ),
                Option(
                    "references", "write the references of each experiment to DIR, as CSV", "DIR"
                ),
            ),
        },
    ),
    Verb(
        "measure",
        action="identify:measure",
        function="measure",
        rows={
            "arguments": ("plan",),
            "noise": ("seed",),
            "time": (TIME_OF_PARTS,),
            "files": (
                Option(
                    "raw", "also write all samples, as recordings that 'flexgen frf' reads", "DIR"
                ),
                "beside",
                Option(
                    "out", "write the spectra to this .npz file", "FILE", "npz_file", required=True
                ),
            ),
        },
        model="required",
    ),
    Verb(
        "frf",
        action="identify:frf",
        function="frf",
        rows={
            "arguments": ("experiment",),
            "estimate": ("average", "transients"),
            "time": (TIME_OF_PARTS,),
            "files": (
                Option(
                    "out",
                    "write the responses to this .npz file",
                    "FILE",
                    "npz_file",
                    required=True,
                ),
                PAGE,
            ),
        },
    ),
    Verb(
        "identify",
        action="identify:identify",
        function="identify",
        rows={
            "arguments": (
                Option(
                    "data",
                    more=("; with --rigid or --segments a .toml file that describes recordings"),
                ),
            ),
            "fit": (
                "free",
                "fixed",
                "start",
                "residual",
                "floor",
                "starts",
                "levels",
                Option(
                    "structure",
                    "add and remove springs without motor as the data ask for, and "
                    "print the changes",
                ),
                Option(
                    "refine",
                    "then fit the spectra of this experiment (a file of 'flexgen "
                    "measure', or a .toml file that describes recordings, with [drive] "
                    "and [[reference]]) by simulation of the nonlinear model, frictions"
                    " too",
                    "EXPERIMENT",
                ),
            ),
            "recorded motions": (
                Option(
                    "rigid", "fit bodies, rotors and friction of a rigid arm to recorded motions"
                ),
                Option(
                    "counterbalance",
                    "with --rigid: N harmonics of the angle of a joint, from the "
                    "second, in the torque of its motor; may be repeated",
                    "JOINT=N",
                    "setting",
                    several=True,
                ),
                Option(
                    "segments",
                    "fit the nonlinear model to recorded motions, in segments of this length [s]",
                    "S",
                    "positive",
                ),
                Option(
                    "validate",
                    "responses of 'flexgen frf' that are not fitted; with --rigid or --segments: "
                    "recordings",
                    "DATA",
                ),
            ),
            "time": (TIME_OF_FIT,),
            "check": (
                Option(
                    "move",
                    "also print the tool error of feedforward in this move, before and after",
                    "NAME",
                ),
                Option(
                    "truth",
                    "with --move: the true robot of a simulated experiment; default: "
                    "robots drawn from the covariance of the parameters",
                    "MODEL",
                ),
            ),
            "files": (
                Option("out", "write the new model file (.toml)", "FILE", "toml_file"),
                REPORT,
            ),
        },
    ),
    Verb(
        "calibrate",
        action="calibration:calibrate",
        function="calibrate",
        rows={
            "arguments": ("poses", "columns"),
            "fit": (
                "free",
                "place",
                Option(
                    "prior",
                    "standard deviation of a prior: zero [rad or m], position [m], "
                    "rotation [rad], compliance (multiple of that of the file), mass "
                    "(part of it), center [m], factor, tracker [m]",
                    "NAME=VALUE",
                    "setting",
                    several=True,
                ),
                "folds",
                "no_robust",
            ),
            "time": (TIME_OF_FIT,),
            "files": (
                Option(
                    "add_poses",
                    "print N further poses whose measurement tells most",
                    "N",
                    "whole 1",
                ),
                Option(
                    "world",
                    "world of the new model file: that of the robot (default) or of the"
                    " measurement",
                    choices=("robot", "measurement"),
                ),
                Option(
                    "out",
                    "write the model file with a variant 'calibrated' (.toml)",
                    "FILE",
                    "toml_file",
                ),
                REPORT,
            ),
        },
    ),
    Verb(
        "control",
        action="control:control",
        function="control",
        rows={
            "robot": (
                Option("plants", word="--plant"),
                Option("disturbances", word="--disturb"),
                Option("no_torque_limits", old=("--no-limits",)),
                "wall",
                "force",
                "assumed_force",
            ),
            "feedforward": (
                "method",
                Option(
                    "no_compare",
                    "without the table of the errors with no, rigid and elastic feedforward",
                ),
            ),
            "closed loop": (
                CONTROLLER,
                "sample_time",
                "delay",
                "encoder_noise",
                "seed",
                "encoder_resolution",
                "exact_state",
                Option(
                    "passivity",
                    "also find whether the loop gives no energy to what the tool "
                    "touches, under a linear controller",
                ),
            ),
            "motion": ("move",),
            "time": (TIME_OF_PARTS,),
            "files": (
                PAGE,
                Option(
                    "out",
                    "write motion, torques and errors of the model to this file",
                    "FILE",
                    "trajectory_file",
                ),
            ),
        },
    ),
    Verb(
        "command-positions",
        function="command_positions",
        rows={
            "robot": (SERVO_FILE, "plants"),
            "interface": ("period", "interpolation", "speed", "acceleration"),
            "motion": ("move",),
            "files": (
                PAGE,
                Option(
                    "out",
                    "write the positions of the joints to this file: .csv (degrees, "
                    "mm), .npz, .mat or .json",
                    "FILE",
                    "positions_file",
                ),
            ),
        },
    ),
    Verb(
        "identify-servo",
        function="identify_servo",
        rows={
            "arguments": ("record", "columns"),
            "servo": (SERVO_FILE, "interpolation"),
            "time": (TIME_OF_FIT,),
            "files": (
                PAGE,
                Option("out", "write the servo to this file (.toml)", "FILE", "toml_file"),
            ),
        },
    ),
    Verb(
        "compare-shapers",
        function="compare_shapers",
        rows={
            "motion": ("move", "coordinate"),
            "shapers": ("detuning", "frequency_hz", "damping"),
            "files": (
                PAGE,
                Option("out", "write the result to this file (.json)", "FILE"),
            ),
        },
    ),
    Verb(
        "compare-record",
        function="compare_record",
        rows={
            "arguments": (
                Option("record", metavar="FILE", place=True),
                "columns",
            ),
            "comparison": (
                "window",
                "about",
                Option("lag", metavar="S"),
                "smallest",
                "limit_hz",
            ),
            "files": (
                PAGE,
                Option("out", "write the result to this file (.json, .npz)", "FILE"),
            ),
        },
    ),
    Verb(
        "learn",
        action="control:learn",
        function="learn",
        rows={
            "robot": (
                Option("plant", more="; without --measured"),
                Option("measured", of="next_run.measured", metavar="FILE"),
                Option("folder", of="next_run.folder", metavar="DIR"),
                Option(
                    "clock",
                    "reading of the record's clock where the path begins [s]; default: estimated "
                    "from the record",
                    "S",
                    "number",
                ),
                Option(
                    "clock_of",
                    "what --clock is read from: record, the clock of all columns (default), or "
                    "drives, that of the motor angles; the tracker then has another one, which is "
                    "estimated",
                    choices=("record", "drives"),
                ),
                Option(
                    "frame",
                    "pose of the tracker in the base of the robot, position [m] and rotation "
                    "vector [rad], six numbers; default: estimated from the record",
                    "X ...",
                    "numbers",
                ),
                Option(
                    "poses",
                    "static poses that the tracker measured from the same place, a file as for "
                    "calibrate: they give its frame",
                    "FILE",
                ),
            ),
            "learning": (
                "iterations",
                "gain",
                Option(
                    "frequency_hz",
                    old=("--frequency",),
                    more="; with --measured: up to which robots with other springs converge, then "
                    "that of the last run",
                ),
                "measured_by",
                TIME_OF_FIT,
            ),
            "motion": ("move",),
            "closed loop": (CONTROLLER, "sample_time", "delay", "encoder_noise", "seed"),
            "files": (
                PAGE,
                Option(
                    "out",
                    "write motion, torques and errors of the best iteration to this file",
                    "FILE",
                    "trajectory_file",
                ),
            ),
        },
    ),
    Verb(
        "fastest",
        action="control:fastest",
        function="fastest",
        rows={
            "motion": (
                "move",
                "coefficients",
                Option("time_limit", old=("--time",)),
            ),
            "bounds": (
                Option(
                    "torque",
                    "limits of the motor torques [N m], one for all or one for each; "
                    "default: those of the model file, and where it has none the "
                    "largest torque of the move as it is given",
                    "X ...",
                    "numbers",
                ),
                Option("speed", "the same of the motor speeds [rad/s]", "X ...", "numbers"),
                Option(
                    "reserve",
                    "part of the torques that is left for feedback, below 1, such as "
                    "0.1; default: none",
                    "PART",
                    "not_negative",
                ),
                "torque_rate",
                "against",
                Option("vibration", metavar="M"),
                "force",
            ),
            "files": (
                Option("out", "write the trajectory to this file", "FILE", "trajectory_file"),
                REPORT,
            ),
        },
    ),
    Verb(
        "kinematics",
        action="control:kinematics",
        function="kinematics",
        rows={
            "pose of the tool": (
                Option(
                    "joints", "the pose is that of these joints [rad or m]", "Q ...", "numbers"
                ),
                Option("position", metavar="X Y Z"),
                Option(
                    "rotation",
                    "rotation vector of the tool in the world [rad]; default: 0 0 0",
                    "X Y Z",
                    "numbers",
                ),
                "sag",
                Option(
                    "command",
                    "instead: where the trackers (or the tool) are at rest, with the "
                    "motors at these joints [rad or m]",
                    "Q ...",
                    "numbers",
                ),
            ),
            "arm": ("fixed",),
        },
    ),
    Verb(
        "score",
        action="control:score",
        function="score",
        rows={
            "arguments": (Option("scenario", of="score.name", metavar="SCENARIO"),),
            "closed loop": (
                Option(
                    "controller",
                    several=True,
                    more=", all (those that come with it), {CONTROLLERS}; may be repeated",
                ),
                "seed",
            ),
            "time": (TIME_OF_PARTS,),
            "files": (PAGE,),
        },
    ),
    Verb(
        "tune",
        action="control:tune",
        function="tune",
        rows={
            "arguments": (
                Option(
                    "scenario",
                    "a model, whose cascade is tuned on it and on robots that differ; "
                    "or a benchmark: four_mass, two_link (four_mass@1: version 1), or a"
                    " .toml file like theirs",
                    "MODEL",
                    place=True,
                ),
            ),
            "search": (
                Option(
                    "controller",
                    "where to start; default: ppi, of a benchmark as for 'flexgen score'",
                    of="tune.controller",
                ),
                Option(
                    "evaluations",
                    "controllers that are tried; default: 120, of a benchmark {default}"
                    " from each start",
                    of="tune.evaluations",
                ),
                Option("seed", "of noise and draws", of="tune.seed"),
                TIME_OF_FIT,
            ),
            "search of a benchmark": ("starts", "workers"),
            "robots of a model": (
                Option("move", of="tune_cascade.move"),
                Option("plants", word="--plant", of="tune_cascade.plants"),
                Option("disturbances", word="--disturb", of="tune_cascade.disturbances"),
                Option("sample_time", of="tune_cascade.sample_time"),
                Option("delay", of="tune_cascade.delay"),
                Option("encoder_noise", of="tune_cascade.encoder_noise"),
                Option("gain_margin_db", word="--gain-margin", of="tune_cascade.gain_margin_db"),
                Option(
                    "phase_margin_deg", word="--phase-margin", of="tune_cascade.phase_margin_deg"
                ),
            ),
            "files": (
                Option(
                    "out",
                    "write the controller to this file, for 'flexgen control --controller FILE'",
                    "FILE",
                    "toml_file",
                    required=True,
                ),
            ),
        },
    ),
)
LAST_ROWS = (
    Verb(
        "view",
        action="export:view",
        function="view",
        rows={
            "motion": (
                "move",
                Option("robot", of="view.model", metavar="MODEL"),
            ),
            "files": (
                Option("out", "write the page to this file, FILE.html", "FILE"),
                "video",
            ),
        },
        model="required",
    ),
    Verb(
        "schema",
        action="export:schema",
        function="schema",
        rows={
            "arguments": (Option("kind", place=True, metavar="KIND"),),
            "files": (Option("out", "write the schema to this file", "FILE"),),
        },
    ),
    Verb(
        "run",
        action="run:run",
        function="solve",
        rows={
            "motion": (MOVE_ONCE,),
            "method": ("method", IGNORE_LIMITS, TIME_OF_SOLVE),
            "files": (
                Option(
                    "out",
                    "folder of the C library; default: generated/MODEL",
                    "DIR",
                    once=True,
                    old=("--directory",),
                ),
                Option("report", "of the report; default: reports/MODEL", "DIR"),
            ),
        },
        model="optional",
    ),
    Verb(
        "completion",
        action="completion:completion",
        rows={
            "arguments": (Option("shell", "{SHELLS}", "SHELL", choices=("SHELLS",), place=True),),
        },
    ),
)

ADDED = Export(
    "",
    "",
    "Write the robot by an exporter of another package.",
    {"files": (Option("out", "write this file or folder", "PATH", required=True),)},
)


def export_row(name: str, export: Export = ADDED) -> Verb:
    """The verb of an export; default: of an exporter of another package, see
    `flexgen.base.registry`.
    """
    return Verb(
        f"export {name}",
        "export:export",
        f"export_{name}" if export.module else "",
        export.options,
        model="required",
        summary=export.summary,
    )


def command_row(function: str) -> Verb:
    """The verb of a public function, whose options are its parameters."""
    return Verb(function.replace("_", "-"), function=function)


VERBS: dict[str, Verb] = {
    verb.name: verb
    for verb in (
        *ROWS,
        *map(command_row, vars(flexgen)["_COMMANDS"]),
        *(export_row(name, export) for name, export in EXPORTS.items()),
        *LAST_ROWS,
    )
}
