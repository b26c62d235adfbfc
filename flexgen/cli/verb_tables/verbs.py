"""The verbs of the command line: a row for each verb and each option.

A verb: name, MODEL (``MODEL?``: optional), the function of `flexgen.cli.verbs` that prints its
result, and the public function that it calls. An option: the parameter of that function, the
placeholder of the value (none: a switch), the type of the value, and its help; names and defaults
are those of the parameters, ``no_X`` switches X off. All words are explained in
`flexgen.cli.verb_tables.verb_rows`. Without a function of `flexgen.cli.verbs`, the public function
is called and its result printed; functions in ``_COMMANDS`` of `flexgen` need no row.

Parser, help and completion of the command line are rendered from these rows; those of exports are
in `flexgen.base.registry`.
"""

from __future__ import annotations

from dataclasses import replace

import flexgen
from flexgen.base.registry import EXPORTS, Export
from flexgen.cli.verb_tables.verb_parameters import command_of
from flexgen.cli.verb_tables.verb_rows import Verb, verbs_of

# Options of several verbs, which write @NAME.
SHARED = """
@move
    move NAME: a move or program of the model file; default: the first
@moves
    moves FILE: read moves and programs from this TOML file
@method
    method NAME in=METHODS: method of inverse dynamics: {METHODS}; default: {default}
@ignore_limits
    ignore_limits: report a solution beyond the limits of the model file as solved (for studies); \
without it the exit
        status is 3
@time
    time_limit SECONDS not_negative old=--time: time limit of each solve [s]: then, or after \
Ctrl-C, it ends with the
        best solution so far (exit status 1, or 130); default: {default}; 0: no limit
@fit_time
    time_limit SECONDS not_negative: time limit [s]: then, or after Ctrl-C, it ends with the best
        step so far, which is printed and written (exit status 1, or 130); default: no limit
@parts_time
    time_limit SECONDS not_negative: time limit [s]: then, or after Ctrl-C, it ends with what was
        computed until then, which is printed and written (exit status 1, or 130); default: no
        limit
@call_time
    time_limit SECONDS not_negative: time limit [s], after which it ends without a result;
        default: no limit
@report
    report DIR: write a self-contained HTML report to DIR
@page
    report DIR: write a self-contained HTML page to DIR
@scenario
    <scenario> SCENARIO: four_mass, two_link (four_mass@1: version 1), or the path of a .toml \
file like theirs
@replace
    force: also replace files that were changed since the export
@no_stream
    no_stream: without a stream, for models that have none
@free
    free NAME,NAME,... names: parameters: stiffness, damping, q1.stiffness, m1.viscous, delay, \
sensor_delay,
        torque_constant, ...; default: stiffness, damping and the viscous frictions of the model
@force
    force FILE: force of a process on the tool along the move [N]: a trajectory with the channel \
force (.csv, .npz)
@wall
    wall PLACE wall: a wall that pushes the tool, X,Y,Z:NX,NY,NZ:K[:C[:GAP]]: point [m], normal \
towards the tool,
        stiffness [N/m], damping [N s/m], gap [m]; such as 1.2,0,0:-1,0,0:1e5:500
@loop
    controller NAME: ppi (P-PI cascade, the default), ppi_notch, none (feedforward only), {LAWS}, \
{CONTROLLERS}
    sample_time S positive: of the controller [s]; default: {default}
    delay S not_negative: from a measurement to its torque [s]; default: {default}
    encoder_noise RAD not_negative: of the motor angles [rad]; default: {default}
    seed N whole_0: of the noise; default: {default}
"""

ROWS = """
models | robot:models | models
new | new:new
    arguments
        <name> NAME: of the robot, an identifier
    content
        template NAME in=TEMPLATES group=kind: {TEMPLATES}; default: planar
        urdf FILE text group=kind: with elastic gears for a URDF file: FILE.urdf#BASE:TIP; \
default: its root and its
            farthest link
        dh FILE text group=kind: with elastic gears for a table of Denavit-Hartenberg parameters
            (.csv), units in its header; see docs/datasheet.md
        convention NAME in=standard/modified: of the table: a and alpha lead to the next axis
            (standard), or come before the axis (modified, Craig); not needed where the header has
            a_prev and alpha_prev
    files
        out FILE toml_file: write to this file (.toml); default: NAME.toml
        force: replace the file
describe MODEL | robot:describe | describe
check MODEL | | check
derive MODEL | robot:derive | derive
    files
        text group=kind: equations as plain text (default for small models)
        latex group=kind: equations as a LaTeX document
        out FILE: write the equations to this file (.tex: as LaTeX)
analyze MODEL | robot:analyze | analyze
    where
        pose Q_... numbers: arm coordinates [rad or m], such as 0.3 -1.1 0; default: home
        move NAME once: also analyze zeros and solvability along this move
    files
        @page
generate MODEL | generate:generate | generate
    content
        functions NAME,NAME,... names: only these functions of the list below, without inversion \
of whole paths;
            default: all
        parameters NAME,NAME,... names: model parameters that become arguments of the functions: \
payload, stiffness,
            damping, friction, q2.stiffness, ...
        parts NAME,NAME,... names --with: optional parts: bvp, another method for whole paths, to \
check invert;
            derivatives: products with derivatives of the functions, for JAX and PyTorch; force: \
a force on the tool
            along paths; limits: limits of gears, springs, joints and tool in streams; position: \
positions to send to
            the servo of the model file
        precision NAME in=double/single old=--single=single: of the numbers in C; default: \
{default}
    compilation
        no_build: write the sources, do not compile
        native: contract products and sums: a little faster, results differ by rounding
        isa ISA isa: instruction set of the compiled libraries, same results for each: native \
(this processor, the
            default), x86-64, v2, v3 (AVX2) or v4 (AVX-512) for other computers
        target NAME in=TARGETS: compile with the package ziglang for another kind of computer, \
with the same results:
            {TARGETS}
        openmp: batch functions use all cores
    files
        out DIR once old=--directory: folder of the library; default: generated/MODEL
        amalgamate: write one header and one C file
        force: build even if nothing has changed
solve MODEL | solve:solve | solve
    motion
        move NAME several: a move or program of the model file; default: the first; given several \
times: all of them,
            with FILE_NAME and DIR/NAME as outputs
        @moves
        fastest: with the fastest time law within the limits; 'flexgen fastest' has further options
        fixed_joint NAME: of an arm with more motors than outputs: the joint that keeps its value \
in a move of the tool
        @force
    method
        @method
        no_verify: skip the verification by forward simulation
        preview S not_negative: longest time that the motion may start before the path [s]
        mesh S positive: length of the mesh intervals [s]
        limits: keep the limits of the model file (method lq; collocation and full those of \
torque, speed and
            deflection)
        accuracy X positive: largest accepted output error [m and rad]
        @ignore_limits
        @time
    controller
        hold NAME in=HOLDS: what the controller does between its ticks: spline (default), linear, \
or zoh (zero-order
            hold); the torques to send are verified with it and written to FILE_command next to \
--out FILE
        sample_time S positive: sample time of the controller [s]; default: 0.001
        delay S not_negative: time from a tick of the controller until the motor has the torque \
[s]; default: {default}
        command in=torque/position: position: also write command_m and command_g, to send to the \
servo of the model
    files
        out FILE trajectory_file: write the trajectory to this file (.npz, .csv or .mat)
        @report
        details: print all figures of the solution, not only the main ones
        robustness: with --report: also simulate robots with stiffness errors of 5 and 20 % and \
mass errors of 5 %
            (takes minutes)
plan MODEL | path:path | plan | path
    motion
        move NAME once: a move or program of the model file; default: the first
        @moves
        ignore_limits: also plan a path beyond the range of a joint
    files
        out FILE old=--table: write the path as a C header for MODEL_path_sample to this file
predict MODEL | | predict
    motion
        move NAME once: a move or program of the model file; default: the first
    draws
        robots N whole_1: that are simulated, 16 or more; default: {default}
        seed N whole_0: of the draws; default: {default}
    time
        @parts_time
    files
        out FILE: write the result to this file (.json)
        @page
simulate MODEL | solve:simulate | simulate
    arguments
        <trajectory> TRAJECTORY: file written by 'flexgen solve --out'
    robot
        @wall
    time
        @call_time
    files
        out FILE trajectory_file: write the simulated motion to this file
sense MODEL | solve:sense | sense
    arguments
        <motion> TRAJECTORY: file written by 'flexgen solve --out'
    files
        out FILE trajectory_file: write what the sensors read to this file
sweep | sweep:sweep | sweep
    arguments
        <grid> GRID: TOML file with models, moves, methods and parameters
    work
        workers N whole_0: worker processes; 0 or 1: run in this process; default: one per core
        shard_size N whole_1: cases per shard, the unit of work and of saved results; default: 1 \
to 16
        resume: continue the sweep in DIR
    time
        @parts_time
    files
        out DIR required: directory for shards and tables
        parquet: write results.parquet too (needs pyarrow)
excite MODEL | identify:excite | excite
    poses
        poses N whole_1: number of poses to choose; default: {default}
        criterion NAME in=A/D/random: of the best poses: A (least sum of variances, the default), \
D (least determinant)
            or random
        @free
    excitation
        speed_rms V positive: of each joint [rad/s or m/s]; default: {default}
        f_min HZ positive: lowest frequency [Hz]; default: from the modes
        f_max HZ positive: highest frequency [Hz]; default: from the modes
        lines N whole_1: number of frequencies; default: {default}
        spectrum POWER spectrum: speeds rise with this power of the frequency, or 'optimal': half \
of the power where it
            tells most; default: {default}
        period_s S positive old=--period: of the excitation [s]; default: {default}
        periods N whole_1: that are measured; default: {default}
        transients N whole_0: periods before them that are not; default: {default}
        realizations N whole_1: of the random phases; default: {default}; 6 with friction
        seed N whole_0: of phases and candidate poses; default: {default}
    drive and sensors
        sensors NAME,NAME,... names: channels of [[sensor]] tables; default: all
        sample_time S positive: of the drives [s]; default: 0.0005
        delay S not_negative: of the torques [s]; default: 0
        encoder_noise X not_negative: [rad, motor side]; default: 0
        encoder_resolution X not_negative: [rad, motor side]; default: 0
        torque_noise X not_negative: [N m, motor side]; default: 0
    time
        @parts_time
    files
        out FILE npz_file required: write the plan to this .npz file
        references DIR: write the references of each experiment to DIR, as CSV
measure MODEL | identify:measure | measure
    arguments
        <plan> PLAN: file written by 'flexgen excite'
    noise
        seed N whole_0: of the noise; default: {default}
    time
        @parts_time
    files
        raw DIR: also write all samples, as recordings that 'flexgen frf' reads
        beside: an error where there are too few periods for the spectra beside the lines, which \
remove transients
        out FILE npz_file required: write the spectra to this .npz file
frf | identify:frf | frf
    arguments
        <experiment> EXPERIMENT: file written by 'flexgen measure', or a .toml file that \
describes recordings
    estimate
        average NAME in=AVERAGES: {AVERAGES}
        transients: the robot need not have come to rest; an error where no spectra \
beside the lines are recorded
    time
        @parts_time
    files
        out FILE npz_file required: write the responses to this .npz file
        @page
identify MODEL | identify:identify | identify
    arguments
        <data> DATA: file written by 'flexgen frf'; with --rigid or --segments a .toml file that \
describes recordings
    fit
        @free
        fixed NAME,NAME,... names: parameters that stay
        start NAME=VALUE setting several: where the search begins; may be repeated
        residual NAME in=nls/lls: nls: differences (default); lls: of complex logarithms
        floor X not_negative: model error as a part of the responses, such as 0.02; default: as \
much as the residuals
            need
        starts N whole_1: number of searches; default: {default}
        levels FRF several: responses of the same experiment with other amplitudes (files of \
'flexgen frf'): also tell
            whether the robot is nonlinear, and why; may be repeated
        structure: add and remove springs without motor as the data ask for, and print the changes
        refine EXPERIMENT: then fit the spectra of this experiment (a file of 'flexgen measure', \
or a .toml file that
            describes recordings, with [drive] and [[reference]]) by simulation of the nonlinear \
model, frictions too
    recorded motions
        rigid: fit bodies, rotors and friction of a rigid arm to recorded motions
        counterbalance JOINT=N setting several: with --rigid: N harmonics of the angle of a \
joint, from the second, in
            the torque of its motor; may be repeated
        segments S positive: fit the nonlinear model to recorded motions, in segments of this \
length [s]
        validate DATA: with --rigid or --segments: recordings that are not fitted
    time
        @fit_time
    check
        move NAME: also print the tool error of feedforward in this move, before and after
        truth MODEL: with --move: the true robot of a simulated experiment; default: robots drawn \
from the covariance of
            the parameters
    files
        out FILE toml_file: write the new model file (.toml)
        @report
calibrate MODEL | calibration:calibrate | calibrate
    arguments
        <poses> DATA: CSV file of static poses: commanded joints (q1_rad or q1_deg), positions of \
the trackers (NAME_x_m
            or NAME_x_mm, ...), or what they touch (NAME_point, NAME_touch, NAME_reading_mm); one
            line for each pose
        columns NAME,NAME,... names: names of the columns of a file without a header
    fit
        free NAME,NAME,... names: groups of numbers: zeros, placements, compliances, mechanisms, \
masses; default: all
        place NAME,NAME,... names: elements whose place at their parent is not known
        prior NAME=VALUE setting several: standard deviation of a prior: zero [rad or m], \
position [m], rotation [rad],
            compliance (multiple of that of the file), mass (part of it), center [m], factor, \
tracker [m]
        folds N whole_0: parts of the poses that are left out in turn, for the error on poses \
that were not fitted;
            default: {default}; 0: none
        no_robust: plain least squares: gross errors keep their weight
    time
        @fit_time
    files
        add_poses N whole_1: print N further poses whose measurement tells most
        world in=robot/measurement: world of the new model file: that of the robot (default) or \
of the measurement
        out FILE toml_file: write the model file with a variant 'calibrated' (.toml)
        @report
control MODEL | control:control | control
    robot
        plants NAME:KEY=X,... plant several --plant: another robot: {FACTORS}; such as \
soft:stiffness=0.8,payload=5; may
            be repeated
        disturbances KIND:WHERE=SIZE@START+LENGTH disturbance several --disturb: step, pulse, \
ramp, chirp or noise on a
            motor [N m] or on the tool (tool.x [N], tool.rz [N m], world axes), times in s; chirp \
and noise: ,LOW-HIGH
            in Hz; such as pulse:tool.x=300@0.4+0.02; may be repeated
        no_torque_limits old=--no-limits: do not limit the torques to those of the model file
        @wall
        @force
        assumed_force FACTOR factor_or_file: what the feedforward assumes of it: a factor, such \
as 0.8 (0: none), or a
            file with another force; default: the same
    feedforward
        @method
        no_compare: without the table of the errors with no, rigid and elastic feedforward
    closed loop
        @loop
        encoder_resolution RAD not_negative: of the motor angles [rad]; default: {default}
        exact_state: the controller measures angles and speeds of arm and motors exactly
        passivity: also find whether the loop gives no energy to what the tool touches, under a \
linear controller
    motion
        @move
    time
        @parts_time
    files
        @page
        out FILE trajectory_file: write motion, torques and errors of the model to this file
command-positions MODEL | | command_positions
    robot
        servo FILE text: of the robot: ppi (proposed gains) or a .toml file, such as that of \
'flexgen identify-servo
            --out'; default: that of the model file, and ppi where it has none
        plants NAME:KEY=X,... plant several: another robot: {FACTORS}; such as \
soft:stiffness=0.8,payload=5; may be
            repeated
    interface
        period S positive: between two positions [s], such as 0.004, 0.008 or 0.012; default: \
{default}
        interpolation in=linear/cubic/hold: of the robot between two positions; default: {default}
        speed X_... numbers: largest commanded speed of each joint [rad/s or m/s]
        acceleration X_... numbers: largest commanded acceleration of each joint [rad/s^2 or m/s^2]
    motion
        @move
    files
        @page
        out FILE positions_file: write the positions of the joints to this file: .csv (degrees, \
mm), .npz, .mat or .json
identify-servo MODEL | | identify_servo
    arguments
        <record> DATA: CSV file of commands and angles: time_s, then JOINT_command_deg and \
JOINT_deg of each joint
        columns NAME,NAME,... names: names of the columns of a file without a header
    servo
        servo FILE text: where the search begins: ppi (proposed gains) or a .toml file; default: \
that of the model
            file
        interpolation in=linear/cubic/hold: of the robot between two positions; default: {default}
    time
        @fit_time
    files
        @page
        out FILE toml_file: write the servo to this file (.toml)
learn MODEL | | learn
    robot
        plant KEY=X,... changes: the robot: {FACTORS}; such as stiffness=0.8,payload=5; default: \
as the model
    learning
        iterations N whole_1: at most; default: {default}
        gain X positive: of the correction; default: {default}
        frequency_hz HZ positive old=--frequency: of the low pass; default: 0.7 of the lowest \
natural frequency with
            locked motors
        measured_by in=tracker/accelerometer: the tool error: by a tracker, or estimated from \
accelerometers and motor
            angles, which do not show errors at rest; default: {default}
        @fit_time
    motion
        @move
    closed loop
        @loop
    files
        @page
        out FILE trajectory_file: write motion, torques and errors of the best iteration to this \
file
fastest MODEL | control:fastest | fastest
    motion
        move NAME: a move or program of the model file; default: the first
        coefficients N whole_4: of each time law, 4 to 60; default: {default}
        time_limit SECONDS not_negative old=--time: time limit of the search [s]; default: \
{default}; 0: no limit
    bounds
        torque X_... numbers: limits of the motor torques [N m], one for all or one for each; \
default: those of the
            model file, and where it has none the largest torque of the move as it is given
        speed X_... numbers: the same of the motor speeds [rad/s]
        reserve PART not_negative: part of the torques that is left for feedback, below 1, such \
as 0.1; default: none
        torque_rate X positive: bound of the rates of the torques, as a multiple of the largest \
one of the move as it is
            given
        against TEXT: '95 %': of the robots drawn from [uncertainty] 95 % keep the torque limits \
with motor feedback
        vibration M positive: bound of the vibration after the path [m], of robots with 10 % less \
and more stiffness
            under control
        force FILE: force of a process on the tool [N] that the limits are kept with, over the \
place on the path: CSV
            with the columns place, fx, fy, fz; the place is 0 at the start and 1 at the end of a \
move
    files
        out FILE trajectory_file: write the trajectory to this file
        @report
kinematics MODEL | control:kinematics | kinematics
    pose of the tool
        joints Q_... numbers: the pose is that of these joints [rad or m]
        position X_Y_Z numbers: of the tool in the world [m]
        rotation X_Y_Z numbers: rotation vector of the tool in the world [rad]; default: 0 0 0
        sag: the elastic robot at rest under gravity reaches the pose
        command Q_... numbers: instead: where the trackers (or the tool) are at rest, with the \
motors at these joints
            [rad or m]
    arm
        fixed NAME=X joint_value several: a joint of a redundant arm that keeps a value [rad or \
m]; may be repeated
score | control:score | score
    arguments
        @scenario
    closed loop
        controller NAME several: reference (the default), all (those that come with the \
benchmark), the name of one of
            them, {CONTROLLERS}; may be repeated
        seed N whole_0: of draws and noise; default: that of the benchmark, a new one for code
    time
        @parts_time
    files
        @page
tune | control:tune | tune
    arguments
        <scenario> MODEL: a model, whose cascade is tuned on it and on robots that differ; or a
            benchmark: four_mass, two_link (four_mass@1: version 1), or a .toml file like theirs
    search
        controller NAME: where to start; default: ppi, of a benchmark as for 'flexgen score'
        evaluations N whole_1: controllers that are tried; default: 120, of a benchmark {default}
            from each start
        seed N whole_0: of noise and draws
        @fit_time
        starts N whole_1: of a benchmark: number of starts; default: {default}
        workers N whole_1: of a benchmark: number of processes; default: {default}
    robots of a model
        move NAME: a move or program of the model file; default: the first
        plants NAME:KEY=X,... plant several --plant: another robot, as for 'flexgen control';
            default: those of [uncertainty], or stiffness=0.8 and 1.2
        disturbances KIND:WHERE=SIZE@START+LENGTH disturbance several --disturb: as for 'flexgen
            control'
        sample_time S positive: of the controller [s]; default: 0.0005
        delay S not_negative: from a measurement to its torque [s]; default: 0
        encoder_noise RAD not_negative: of the motor angles [rad]; default: 0
        gain_margin_db DB not_negative --gain-margin: required of all robots [dB]; default: 6
        phase_margin_deg DEG not_negative --phase-margin: required of all robots [deg]; default: 30
    files
        out FILE toml_file required: write the controller to this file, for 'flexgen control
            --controller FILE'
"""

LAST_ROWS = """
view MODEL | export:view | view
    motion
        @move
        robot MODEL: the model of a trajectory, where MODEL is a file .npz or .csv; default: the \
name in the trajectory
    files
        out FILE: write the page to this file, FILE.html
        video FILE: write a video to this file, FILE.gif or FILE.mp4 (needs the program ffmpeg)
schema | export:schema | schema
    arguments
        <kind> KIND in=model/program: model (the default), or program: files of moves and programs
    files
        out FILE: write the schema to this file
run MODEL? | run:run | solve
    motion
        move NAME once: a move or program of the model file; default: the first
    method
        @method
        @ignore_limits
        @time
    files
        out DIR once old=--directory: folder of the C library; default: generated/MODEL
        report DIR: of the report; default: reports/MODEL
completion | completion:completion
    arguments
        <shell> SHELL in=SHELLS: {SHELLS}
"""

ADDED = Export(
    "",
    "",
    "Write the robot by an exporter of another package.",
    "\n    files\n        out PATH required: write this file or folder",
)


def export_row(name: str, export: Export = ADDED) -> Verb:
    """The verb of an export; default: of an exporter of another package, see
    `flexgen.base.registry`.
    """
    function = f"| export_{name}" if export.module else ""
    rows = verbs_of(f"export {name} MODEL | export:export {function}{export.options}", SHARED)
    return replace(rows[f"export {name}"], summary=export.summary)


VERBS: dict[str, Verb] = verbs_of(ROWS, SHARED)
VERBS |= {verb.name: verb for verb in map(command_of, vars(flexgen)["_COMMANDS"])}
VERBS |= {f"export {name}": export_row(name, export) for name, export in EXPORTS.items()}
VERBS |= verbs_of(LAST_ROWS, SHARED)
