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
                Option(
                    "pose",
                    "arm coordinates [rad or m], such as 0.3 -1.1 0; default: home",
                    "Q ...",
                    "numbers",
                ),
                Option(
                    "move", "also analyze zeros and solvability along this move", "NAME", once=True
                ),
            ),
            "files": (Option("report", "write a self-contained HTML page to DIR", "DIR"),),
        },
    ),
    Verb(
        "generate",
        action="generate:generate",
        function="generate",
        rows={
            "content": (
                Option(
                    "functions",
                    "only these functions of the list below, without inversion of whole"
                    " paths; default: all",
                    "NAME,NAME,...",
                    "names",
                ),
                Option(
                    "parameters",
                    "model parameters that become arguments of the functions: payload, "
                    "stiffness, damping, friction, q2.stiffness, ...",
                    "NAME,NAME,...",
                    "names",
                ),
                Option(
                    "parts",
                    "optional parts: bvp, another method for whole paths, to check "
                    "invert; derivatives: products with derivatives of the functions, "
                    "for JAX and PyTorch; force: a force on the tool along paths; "
                    "limits: limits of gears, springs, joints and tool in streams; "
                    "position: positions to send to the servo of the model file",
                    "NAME,NAME,...",
                    "names",
                    word="--with",
                ),
                Option(
                    "precision",
                    "of the numbers in C; default: {default}",
                    "NAME",
                    choices=("double", "single"),
                    old=("--single=single",),
                ),
            ),
            "compilation": (
                Option("no_build", "write the sources, do not compile"),
                Option(
                    "native",
                    "contract products and sums: a little faster, results differ by rounding",
                ),
                Option(
                    "isa",
                    "instruction set of the compiled libraries, same results for each: "
                    "native (this processor, the default), x86-64, v2, v3 (AVX2) or v4 "
                    "(AVX-512) for other computers",
                    "ISA",
                    "isa",
                ),
                Option(
                    "target",
                    "compile with the package ziglang for another kind of computer, "
                    "with the same results: {TARGETS}",
                    "NAME",
                    choices=("TARGETS",),
                ),
                Option("openmp", "batch functions use all cores"),
            ),
            "files": (
                Option(
                    "out",
                    "folder of the library; default: generated/MODEL",
                    "DIR",
                    once=True,
                    old=("--directory",),
                ),
                Option("amalgamate", "write one header and one C file"),
                Option("force", "build even if nothing has changed"),
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
                    "a move or program of the model file; default: the first; given "
                    "several times: all of them, with FILE_NAME and DIR/NAME as outputs",
                    "NAME",
                    several=True,
                ),
                Option("moves", "read moves and programs from this TOML file", "FILE"),
                Option(
                    "fastest",
                    "with the fastest time law within the limits; 'flexgen fastest' has"
                    " further options",
                ),
                Option(
                    "fixed_joint",
                    "of an arm with more motors than outputs: the joint that keeps its "
                    "value in a move of the tool",
                    "NAME",
                ),
                Option(
                    "force",
                    "force of a process on the tool along the move [N]: a trajectory "
                    "with the channel force (.csv, .npz)",
                    "FILE",
                ),
            ),
            "method": (
                Option(
                    "method",
                    "method of inverse dynamics: {METHODS}; default: {default}",
                    "NAME",
                    choices=("METHODS",),
                ),
                Option("no_verify", "skip the verification by forward simulation"),
                Option(
                    "preview",
                    "longest time that the motion may start before the path [s]",
                    "S",
                    "not_negative",
                ),
                Option("mesh", "length of the mesh intervals [s]", "S", "positive"),
                Option(
                    "limits",
                    "keep the limits of the model file (method lq; collocation and full"
                    " those of torque, speed and deflection)",
                ),
                Option("accuracy", "largest accepted output error [m and rad]", "X", "positive"),
                Option(
                    "ignore_limits",
                    "report a solution beyond the limits of the model file as solved "
                    "(for studies); without it the exit status is 3",
                ),
                Option(
                    "time_limit",
                    "time limit of each solve [s]: then, or after Ctrl-C, it ends with "
                    "the best solution so far (exit status 1, or 130); default: "
                    "{default}; 0: no limit",
                    "SECONDS",
                    "not_negative",
                    old=("--time",),
                ),
            ),
            "controller": (
                Option(
                    "hold",
                    "what the controller does between its ticks: spline (default), "
                    "linear, or zoh (zero-order hold); the torques to send are verified"
                    " with it and written to FILE_command next to --out FILE",
                    "NAME",
                    choices=("HOLDS",),
                ),
                Option(
                    "sample_time",
                    "sample time of the controller [s]; default: 0.001",
                    "S",
                    "positive",
                ),
                Option(
                    "delay",
                    "time from a tick of the controller until the motor has the torque "
                    "[s]; default: {default}",
                    "S",
                    "not_negative",
                ),
                Option(
                    "command",
                    "position: also write command_m and command_g, to send to the servo"
                    " of the model",
                    choices=("torque", "position"),
                ),
            ),
            "files": (
                Option(
                    "out",
                    "write the trajectory to this file (.npz, .csv or .mat)",
                    "FILE",
                    "trajectory_file",
                ),
                Option("report", "write a self-contained HTML report to DIR", "DIR"),
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
            "motion": (
                Option(
                    "move",
                    "a move or program of the model file; default: the first",
                    "NAME",
                    once=True,
                ),
                Option("moves", "read moves and programs from this TOML file", "FILE"),
                Option("ignore_limits", "also plan a path beyond the range of a joint"),
            ),
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
            "motion": (Option("move", once=True),),
            "draws": (
                "robots",
                "seed",
            ),
            "time": (
                Option(
                    "time_limit",
                    more=(
                        ": then, or after Ctrl-C, it ends with what was computed until "
                        "then, which is printed and written (exit status 1, or 130)"
                    ),
                ),
            ),
            "files": (
                Option("out", "write the result to this file (.json)", "FILE"),
                Option("report", "write a self-contained HTML page to DIR", "DIR"),
            ),
        },
    ),
    Verb(
        "simulate",
        action="solve:simulate",
        function="simulate",
        rows={
            "arguments": (
                Option(
                    "trajectory", "file written by 'flexgen solve --out'", "TRAJECTORY", place=True
                ),
            ),
            "robot": (
                Option(
                    "wall",
                    "a wall that pushes the tool, X,Y,Z:NX,NY,NZ:K[:C[:GAP]]: point "
                    "[m], normal towards the tool, stiffness [N/m], damping [N s/m], "
                    "gap [m]; such as 1.2,0,0:-1,0,0:1e5:500",
                    "PLACE",
                    "wall",
                ),
            ),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s], after which it ends without a result; default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
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
            "arguments": (
                Option(
                    "motion", "file written by 'flexgen solve --out'", "TRAJECTORY", place=True
                ),
            ),
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
            "arguments": (
                Option(
                    "grid",
                    "TOML file with models, moves, methods and parameters",
                    "GRID",
                    place=True,
                ),
            ),
            "work": (
                Option(
                    "workers",
                    "worker processes; 0 or 1: run in this process; default: one per core",
                    "N",
                    "whole 0",
                ),
                Option(
                    "shard_size",
                    "cases per shard, the unit of work and of saved results; default: 1 to 16",
                    "N",
                    "whole 1",
                ),
                Option("resume", "continue the sweep in DIR"),
            ),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with what was "
                    "computed until then, which is printed and written (exit status 1, "
                    "or 130); default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
            "files": (
                Option("out", "directory for shards and tables", "DIR", required=True),
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
                Option("poses", "number of poses to choose; default: {default}", "N", "whole 1"),
                Option(
                    "criterion",
                    "of the best poses: A (least sum of variances, the default), D "
                    "(least determinant) or random",
                    "NAME",
                    choices=("A", "D", "random"),
                ),
                Option(
                    "free",
                    "parameters: stiffness, damping, q1.stiffness, m1.viscous, delay, "
                    "sensor_delay, torque_constant, ...; default: stiffness, damping "
                    "and the viscous frictions of the model",
                    "NAME,NAME,...",
                    "names",
                ),
            ),
            "excitation": (
                Option(
                    "speed_rms",
                    "of each joint [rad/s or m/s]; default: {default}",
                    "V",
                    "positive",
                ),
                Option(
                    "f_min", "lowest frequency [Hz]; default: from the modes", "HZ", "positive"
                ),
                Option(
                    "f_max", "highest frequency [Hz]; default: from the modes", "HZ", "positive"
                ),
                Option("lines", "number of frequencies; default: {default}", "N", "whole 1"),
                Option(
                    "spectrum",
                    "speeds rise with this power of the frequency, or 'optimal': half "
                    "of the power where it tells most; default: {default}",
                    "POWER",
                    "spectrum",
                ),
                Option(
                    "period_s",
                    "of the excitation [s]; default: {default}",
                    "S",
                    "positive",
                    old=("--period",),
                ),
                Option("periods", "that are measured; default: {default}", "N", "whole 1"),
                Option(
                    "transients",
                    "periods before them that are not; default: {default}",
                    "N",
                    "whole 0",
                ),
                Option(
                    "realizations",
                    "of the random phases; default: {default}; 6 with friction",
                    "N",
                    "whole 1",
                ),
                Option(
                    "seed", "of phases and candidate poses; default: {default}", "N", "whole 0"
                ),
            ),
            "drive and sensors": (
                Option(
                    "sensors",
                    "channels of [[sensor]] tables; default: all",
                    "NAME,NAME,...",
                    "names",
                ),
                Option("sample_time", "of the drives [s]; default: 0.0005", "S", "positive"),
                Option("delay", "of the torques [s]; default: 0", "S", "not_negative"),
                Option("encoder_noise", "[rad, motor side]; default: 0", "X", "not_negative"),
                Option("encoder_resolution", "[rad, motor side]; default: 0", "X", "not_negative"),
                Option("torque_noise", "[N m, motor side]; default: 0", "X", "not_negative"),
            ),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with what was "
                    "computed until then, which is printed and written (exit status 1, "
                    "or 130); default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
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
            "arguments": (Option("plan", "file written by 'flexgen excite'", "PLAN", place=True),),
            "noise": (Option("seed", "of the noise; default: {default}", "N", "whole 0"),),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with what was "
                    "computed until then, which is printed and written (exit status 1, "
                    "or 130); default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
            "files": (
                Option(
                    "raw", "also write all samples, as recordings that 'flexgen frf' reads", "DIR"
                ),
                Option(
                    "beside",
                    "an error where there are too few periods for the spectra beside "
                    "the lines, which remove transients",
                ),
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
            "arguments": (
                Option(
                    "experiment",
                    "file written by 'flexgen measure', or a .toml file that describes recordings",
                    "EXPERIMENT",
                    place=True,
                ),
            ),
            "estimate": (
                Option("average", "{AVERAGES}", "NAME", choices=("AVERAGES",)),
                Option(
                    "transients",
                    "the robot need not have come to rest; an error where no spectra "
                    "beside the lines are recorded",
                ),
            ),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with what was "
                    "computed until then, which is printed and written (exit status 1, "
                    "or 130); default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
            "files": (
                Option(
                    "out",
                    "write the responses to this .npz file",
                    "FILE",
                    "npz_file",
                    required=True,
                ),
                Option("report", "write a self-contained HTML page to DIR", "DIR"),
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
                    "file written by 'flexgen frf'; with --rigid or --segments a .toml "
                    "file that describes recordings",
                    "DATA",
                    place=True,
                ),
            ),
            "fit": (
                Option(
                    "free",
                    "parameters: stiffness, damping, q1.stiffness, m1.viscous, delay, "
                    "sensor_delay, torque_constant, ...; default: stiffness, damping "
                    "and the viscous frictions of the model",
                    "NAME,NAME,...",
                    "names",
                ),
                Option("fixed", "parameters that stay", "NAME,NAME,...", "names"),
                Option(
                    "start",
                    "where the search begins; may be repeated",
                    "NAME=VALUE",
                    "setting",
                    several=True,
                ),
                Option(
                    "residual",
                    "nls: differences (default); lls: of complex logarithms",
                    "NAME",
                    choices=("nls", "lls"),
                ),
                Option(
                    "floor",
                    "model error as a part of the responses, such as 0.02; default: as "
                    "much as the residuals need",
                    "X",
                    "not_negative",
                ),
                Option("starts", "number of searches; default: {default}", "N", "whole 1"),
                Option(
                    "levels",
                    "responses of the same experiment with other amplitudes (files of "
                    "'flexgen frf'): also tell whether the robot is nonlinear, and why;"
                    " may be repeated",
                    "FRF",
                    several=True,
                ),
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
                    "with --rigid or --segments: recordings that are not fitted",
                    "DATA",
                ),
            ),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with the best step "
                    "so far, which is printed and written (exit status 1, or 130); "
                    "default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
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
                Option("report", "write a self-contained HTML report to DIR", "DIR"),
            ),
        },
    ),
    Verb(
        "calibrate",
        action="calibration:calibrate",
        function="calibrate",
        rows={
            "arguments": (
                Option(
                    "poses",
                    "CSV file of static poses: commanded joints (q1_rad or q1_deg), "
                    "positions of the trackers (NAME_x_m or NAME_x_mm, ...), or what "
                    "they touch (NAME_point, NAME_touch, NAME_reading_mm); one line for"
                    " each pose",
                    "DATA",
                    place=True,
                ),
                Option(
                    "columns",
                    "names of the columns of a file without a header",
                    "NAME,NAME,...",
                    "names",
                ),
            ),
            "fit": (
                Option(
                    "free",
                    "groups of numbers: zeros, placements, compliances, mechanisms, "
                    "masses; default: all",
                    "NAME,NAME,...",
                    "names",
                ),
                Option(
                    "place",
                    "elements whose place at their parent is not known",
                    "NAME,NAME,...",
                    "names",
                ),
                Option(
                    "prior",
                    "standard deviation of a prior: zero [rad or m], position [m], "
                    "rotation [rad], compliance (multiple of that of the file), mass "
                    "(part of it), center [m], factor, tracker [m]",
                    "NAME=VALUE",
                    "setting",
                    several=True,
                ),
                Option(
                    "folds",
                    "parts of the poses that are left out in turn, for the error on "
                    "poses that were not fitted; default: {default}; 0: none",
                    "N",
                    "whole 0",
                ),
                Option("no_robust", "plain least squares: gross errors keep their weight"),
            ),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with the best step "
                    "so far, which is printed and written (exit status 1, or 130); "
                    "default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
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
                Option("report", "write a self-contained HTML report to DIR", "DIR"),
            ),
        },
    ),
    Verb(
        "control",
        action="control:control",
        function="control",
        rows={
            "robot": (
                Option(
                    "plants",
                    "another robot: {FACTORS}; such as soft:stiffness=0.8,payload=5; "
                    "may be repeated",
                    "NAME:KEY=X,...",
                    "plant",
                    several=True,
                    word="--plant",
                ),
                Option(
                    "disturbances",
                    "step, pulse, ramp, chirp or noise on a motor [N m] or on the tool "
                    "(tool.x [N], tool.rz [N m], world axes), times in s; chirp and "
                    "noise: ,LOW-HIGH in Hz; such as pulse:tool.x=300@0.4+0.02; may be "
                    "repeated",
                    "KIND:WHERE=SIZE@START+LENGTH",
                    "disturbance",
                    several=True,
                    word="--disturb",
                ),
                Option(
                    "no_torque_limits",
                    "do not limit the torques to those of the model file",
                    old=("--no-limits",),
                ),
                Option(
                    "wall",
                    "a wall that pushes the tool, X,Y,Z:NX,NY,NZ:K[:C[:GAP]]: point "
                    "[m], normal towards the tool, stiffness [N/m], damping [N s/m], "
                    "gap [m]; such as 1.2,0,0:-1,0,0:1e5:500",
                    "PLACE",
                    "wall",
                ),
                Option(
                    "force",
                    "force of a process on the tool along the move [N]: a trajectory "
                    "with the channel force (.csv, .npz)",
                    "FILE",
                ),
                Option(
                    "assumed_force",
                    "what the feedforward assumes of it: a factor, such as 0.8 (0: "
                    "none), or a file with another force; default: the same",
                    "FACTOR",
                    "factor_or_file",
                ),
            ),
            "feedforward": (
                Option(
                    "method",
                    "method of inverse dynamics: {METHODS}; default: {default}",
                    "NAME",
                    choices=("METHODS",),
                ),
                Option(
                    "no_compare",
                    "without the table of the errors with no, rigid and elastic feedforward",
                ),
            ),
            "closed loop": (
                Option(
                    "controller",
                    "ppi (P-PI cascade, the default), ppi_notch, none (feedforward "
                    "only), {LAWS}, {CONTROLLERS}",
                    "NAME",
                ),
                Option(
                    "sample_time", "of the controller [s]; default: {default}", "S", "positive"
                ),
                Option(
                    "delay",
                    "from a measurement to its torque [s]; default: {default}",
                    "S",
                    "not_negative",
                ),
                Option(
                    "encoder_noise",
                    "of the motor angles [rad]; default: {default}",
                    "RAD",
                    "not_negative",
                ),
                Option("seed", "of the noise; default: {default}", "N", "whole 0"),
                Option(
                    "encoder_resolution",
                    "of the motor angles [rad]; default: {default}",
                    "RAD",
                    "not_negative",
                ),
                Option(
                    "exact_state",
                    "the controller measures angles and speeds of arm and motors exactly",
                ),
                Option(
                    "passivity",
                    "also find whether the loop gives no energy to what the tool "
                    "touches, under a linear controller",
                ),
            ),
            "motion": (
                Option("move", "a move or program of the model file; default: the first", "NAME"),
            ),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with what was "
                    "computed until then, which is printed and written (exit status 1, "
                    "or 130); default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
            "files": (
                Option("report", "write a self-contained HTML page to DIR", "DIR"),
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
            "robot": (
                Option("servo", metavar="FILE"),
                "plants",
            ),
            "interface": (
                "period",
                "interpolation",
                "speed",
                "acceleration",
            ),
            "motion": ("move",),
            "files": (
                Option("report", "write a self-contained HTML page to DIR", "DIR"),
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
            "arguments": (
                "record",
                "columns",
            ),
            "servo": (
                Option("servo", metavar="FILE"),
                "interpolation",
            ),
            "time": (
                Option(
                    "time_limit",
                    more=(
                        ": then, or after Ctrl-C, it ends with the best step so far, which "
                        "is printed and written (exit status 1, or 130)"
                    ),
                ),
            ),
            "files": (
                Option("report", "write a self-contained HTML page to DIR", "DIR"),
                Option("out", "write the servo to this file (.toml)", "FILE", "toml_file"),
            ),
        },
    ),
    Verb(
        "learn",
        function="learn",
        rows={
            "robot": (
                Option(
                    "plant",
                    "the robot: {FACTORS}; such as stiffness=0.8,payload=5; default: as the model",
                    "KEY=X,...",
                    "changes",
                ),
            ),
            "learning": (
                Option("iterations", "at most; default: {default}", "N", "whole 1"),
                Option("gain", "of the correction; default: {default}", "X", "positive"),
                Option(
                    "frequency_hz",
                    "of the low pass; default: 0.7 of the lowest natural frequency with"
                    " locked motors",
                    "HZ",
                    "positive",
                    old=("--frequency",),
                ),
                Option(
                    "measured_by",
                    "the tool error: by a tracker, or estimated from accelerometers and"
                    " motor angles, which do not show errors at rest; default: "
                    "{default}",
                    choices=("tracker", "accelerometer"),
                ),
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with the best step "
                    "so far, which is printed and written (exit status 1, or 130); "
                    "default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
            "motion": (
                Option("move", "a move or program of the model file; default: the first", "NAME"),
            ),
            "closed loop": (
                Option(
                    "controller",
                    "ppi (P-PI cascade, the default), ppi_notch, none (feedforward "
                    "only), {LAWS}, {CONTROLLERS}",
                    "NAME",
                ),
                Option(
                    "sample_time", "of the controller [s]; default: {default}", "S", "positive"
                ),
                Option(
                    "delay",
                    "from a measurement to its torque [s]; default: {default}",
                    "S",
                    "not_negative",
                ),
                Option(
                    "encoder_noise",
                    "of the motor angles [rad]; default: {default}",
                    "RAD",
                    "not_negative",
                ),
                Option("seed", "of the noise; default: {default}", "N", "whole 0"),
            ),
            "files": (
                Option("report", "write a self-contained HTML page to DIR", "DIR"),
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
                Option("move", "a move or program of the model file; default: the first", "NAME"),
                Option(
                    "coefficients", "of each time law, 4 to 60; default: {default}", "N", "whole 4"
                ),
                Option(
                    "time_limit",
                    "time limit of the search [s]; default: {default}; 0: no limit",
                    "SECONDS",
                    "not_negative",
                    old=("--time",),
                ),
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
                Option(
                    "torque_rate",
                    "bound of the rates of the torques, as a multiple of the largest "
                    "one of the move as it is given",
                    "X",
                    "positive",
                ),
                Option(
                    "against",
                    "'95 %': of the robots drawn from [uncertainty] 95 % keep the "
                    "torque limits with motor feedback",
                    "TEXT",
                ),
                Option(
                    "vibration",
                    "bound of the vibration after the path [m], of robots with 10 % "
                    "less and more stiffness under control",
                    "M",
                    "positive",
                ),
                Option(
                    "force",
                    "force of a process on the tool [N] that the limits are kept with, "
                    "over the place on the path: CSV with the columns place, fx, fy, "
                    "fz; the place is 0 at the start and 1 at the end of a move",
                    "FILE",
                ),
            ),
            "files": (
                Option("out", "write the trajectory to this file", "FILE", "trajectory_file"),
                Option("report", "write a self-contained HTML report to DIR", "DIR"),
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
                Option("position", "of the tool in the world [m]", "X Y Z", "numbers"),
                Option(
                    "rotation",
                    "rotation vector of the tool in the world [rad]; default: 0 0 0",
                    "X Y Z",
                    "numbers",
                ),
                Option("sag", "the elastic robot at rest under gravity reaches the pose"),
                Option(
                    "command",
                    "instead: where the trackers (or the tool) are at rest, with the "
                    "motors at these joints [rad or m]",
                    "Q ...",
                    "numbers",
                ),
            ),
            "arm": (
                Option(
                    "fixed",
                    "a joint of a redundant arm that keeps a value [rad or m]; may be repeated",
                    "NAME=X",
                    "joint_value",
                    several=True,
                ),
            ),
        },
    ),
    Verb(
        "score",
        action="control:score",
        function="score",
        rows={
            "arguments": (
                Option(
                    "scenario",
                    "four_mass, two_link (four_mass@1: version 1), or the path of a "
                    ".toml file like theirs",
                    "SCENARIO",
                    place=True,
                ),
            ),
            "closed loop": (
                Option(
                    "controller",
                    "reference (the default), all (those that come with the benchmark),"
                    " the name of one of them, {CONTROLLERS}; may be repeated",
                    "NAME",
                    several=True,
                ),
                Option(
                    "seed",
                    "of draws and noise; default: that of the benchmark, a new one for code",
                    "N",
                    "whole 0",
                ),
            ),
            "time": (
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with what was "
                    "computed until then, which is printed and written (exit status 1, "
                    "or 130); default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
            ),
            "files": (Option("report", "write a self-contained HTML page to DIR", "DIR"),),
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
                    "NAME",
                ),
                Option(
                    "evaluations",
                    "controllers that are tried; default: 120, of a benchmark {default}"
                    " from each start",
                    "N",
                    "whole 1",
                ),
                Option("seed", "of noise and draws", "N", "whole 0"),
                Option(
                    "time_limit",
                    "time limit [s]: then, or after Ctrl-C, it ends with the best step "
                    "so far, which is printed and written (exit status 1, or 130); "
                    "default: no limit",
                    "SECONDS",
                    "not_negative",
                ),
                Option(
                    "starts",
                    "of a benchmark: number of starts; default: {default}",
                    "N",
                    "whole 1",
                ),
                Option(
                    "workers",
                    "of a benchmark: number of processes; default: {default}",
                    "N",
                    "whole 1",
                ),
            ),
            "robots of a model": (
                Option("move", "a move or program of the model file; default: the first", "NAME"),
                Option(
                    "plants",
                    "another robot, as for 'flexgen control'; default: those of "
                    "[uncertainty], or stiffness=0.8 and 1.2",
                    "NAME:KEY=X,...",
                    "plant",
                    several=True,
                    word="--plant",
                ),
                Option(
                    "disturbances",
                    "as for 'flexgen control'",
                    "KIND:WHERE=SIZE@START+LENGTH",
                    "disturbance",
                    several=True,
                    word="--disturb",
                ),
                Option("sample_time", "of the controller [s]; default: 0.0005", "S", "positive"),
                Option(
                    "delay",
                    "from a measurement to its torque [s]; default: 0",
                    "S",
                    "not_negative",
                ),
                Option(
                    "encoder_noise", "of the motor angles [rad]; default: 0", "RAD", "not_negative"
                ),
                Option(
                    "gain_margin_db",
                    "required of all robots [dB]; default: 6",
                    "DB",
                    "not_negative",
                    word="--gain-margin",
                ),
                Option(
                    "phase_margin_deg",
                    "required of all robots [deg]; default: 30",
                    "DEG",
                    "not_negative",
                    word="--phase-margin",
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
                Option("move", "a move or program of the model file; default: the first", "NAME"),
                Option(
                    "robot",
                    "the model of a trajectory, where MODEL is a file .npz or .csv; "
                    "default: the name in the trajectory",
                    "MODEL",
                ),
            ),
            "files": (
                Option("out", "write the page to this file, FILE.html", "FILE"),
                Option(
                    "video",
                    "write a video to this file, FILE.gif or FILE.mp4 (needs the program ffmpeg)",
                    "FILE",
                ),
            ),
        },
        model="required",
    ),
    Verb(
        "schema",
        action="export:schema",
        function="schema",
        rows={
            "arguments": (
                Option(
                    "kind",
                    "model (the default), or program: files of moves and programs",
                    "KIND",
                    choices=("model", "program"),
                    place=True,
                ),
            ),
            "files": (Option("out", "write the schema to this file", "FILE"),),
        },
    ),
    Verb(
        "run",
        action="run:run",
        function="solve",
        rows={
            "motion": (
                Option(
                    "move",
                    "a move or program of the model file; default: the first",
                    "NAME",
                    once=True,
                ),
            ),
            "method": (
                Option(
                    "method",
                    "method of inverse dynamics: {METHODS}; default: {default}",
                    "NAME",
                    choices=("METHODS",),
                ),
                Option(
                    "ignore_limits",
                    "report a solution beyond the limits of the model file as solved "
                    "(for studies); without it the exit status is 3",
                ),
                Option(
                    "time_limit",
                    "time limit of each solve [s]: then, or after Ctrl-C, it ends with "
                    "the best solution so far (exit status 1, or 130); default: "
                    "{default}; 0: no limit",
                    "SECONDS",
                    "not_negative",
                    old=("--time",),
                ),
            ),
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
