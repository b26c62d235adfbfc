/*
 * elbow: inverse dynamics along a path, written by flexgen. Do not edit.
 *
 * invert takes a whole path. A stream takes one sample of the path per update and returns the
 * current torques. Both give the motor torques for exact tracking of the output, also where the
 * zero dynamics is unstable.
 */
#ifndef ELBOW_INVERSION_H
#define ELBOW_INVERSION_H

#include <stdint.h>

#include "elbow.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ELBOW_STREAM_INTERVALS_MAX 10000 /* intervals of a horizon, at most */
#define ELBOW_STREAM_SAMPLES_MAX 1000 /* samples per interval, at most */
#define ELBOW_STREAM_MORE_SAMPLES 16 /* that stream_start_moving takes beyond the intervals */
#define ELBOW_HOLD_DELAY_MAX 4 /* delay of a hold in samples, at most */
#define ELBOW_STREAM_START_SAMPLES(intervals) \
    ((intervals) + ELBOW_STREAM_MORE_SAMPLES) /* of stream_start_moving */

/*
 * What the drive does between two samples of the motor torque. With HOLD_LINEAR and HOLD_ZOH,
 * tau_m has the torques to send at the samples, not the torques there: a held sample is late by
 * half a period. All other results are those at the samples.
 */
typedef enum {
    ELBOW_HOLD_SPLINE = 0 /* follows a spline through the samples */,
    ELBOW_HOLD_LINEAR = 1 /* follows a straight line to the next sample */,
    ELBOW_HOLD_ZOH = 2 /* holds each sample until the next one (zero-order hold) */
} elbow_hold;

/*
 * Why a stream did not meet its tolerance.
 */
typedef enum {
    ELBOW_CAUSE_NONE = 0 /* it did */,
    ELBOW_CAUSE_RESIDUAL = 1 /* residual above the tolerance */,
    ELBOW_CAUSE_MISMATCH = 2 /* kinematic mismatch: samples too far apart, or a path that is not smooth */,
    ELBOW_CAUSE_TORQUE_STEP = 3 /* step of a motor torque: horizon too short */
} elbow_cause;

/* Memory of a stream in reals, as a constant expression: at least stream_work. */
#define ELBOW_STREAM_SIZE(intervals, samples_per_interval) \
    (INT64_C(2448) + INT64_C(230) * (intervals) + INT64_C(26) * (samples_per_interval))
/*
 * Operations of one stream_update, at most: additions, multiplications, divisions and comparisons
 * of reals, with every iteration at its limit. A usual update needs a small part of them.
 */
#define ELBOW_STREAM_OPERATIONS(intervals, samples_per_interval) \
    (INT64_C(3171128) + INT64_C(88541) * (intervals) + INT64_C(74776) * (samples_per_interval))

/*
 * Recommended options of a stream. The look-ahead is ln(1 / 1e-06) time constants of the slowest
 * unstable zero at the home pose, and at least 10 intervals. For limits of the motors take twice
 * as many intervals, and the time to brake.
 */
#define ELBOW_SLOWEST_UNSTABLE_ZERO 0.0 /* [1/s] real part, home pose; 0: none */
#define ELBOW_LOOK_AHEAD 0.05 /* [s] of a stream: time from a sample to the output that reaches it */
#define ELBOW_STREAM_PERIOD 0.005 /* [s] from update to update */
#define ELBOW_STREAM_INTERVALS 10 /* LOOK_AHEAD / STREAM_PERIOD */
#define ELBOW_STREAM_SAMPLES_PER_INTERVAL 5 /* samples of the results per update */
#define ELBOW_STREAM_TOLERANCE 1e-06 /* largest relative residual */

/* Samples of the output, one period apart. The output is at rest at the first and at the last sample. */
typedef struct {
    int n; /* number of samples, at least 2 */
    elbow_real period; /* [s] time between two samples */
    /* n x n_t [mixed] output; for a pose the position, then the rotation matrix by columns */
    const elbow_real *y;
    /* n x n_y [mixed] its first time derivative; for a pose linear and angular velocity, world
     * axes */
    const elbow_real *dy;
    /* n x n_y [mixed] its second time derivative; for a pose linear and angular acceleration */
    const elbow_real *ddy;
} elbow_samples;

/* Options of a whole path; inversion_defaults gives their defaults. */
typedef struct {
    int n_pre; /* samples before the path, for the motion that unstable zeros require */
    /* samples after the path, in which stable zeros and the deflections of damped gears decay */
    int n_post;
    int samples_per_interval; /* samples per interval of the mesh */
    /* largest residual of the unactuated rows, relative to the torques of a deflection of 0.01 rad
     * or 0.01 m; 1e-6 is what flexgen solve uses (single precision: 1e-3) */
    elbow_real tolerance;
    elbow_hold hold; /* what the drive does between two samples of tau_m */
    elbow_real delay; /* from a sample until the motor has its torque, in samples, 0 to 4 */
    /* above 0: the samples after the path end once the residual motion changes the output by less
     * than this [m or rad], but not before 0.05 s and 20 D / K of the slowest gear; 0: all n_post
     * samples are computed, as bvp does */
    elbow_real settled;
    /* 1: the info of invert and invert_limited has the growth too, for a library with linearize;
     * the motion needs q_a, v_a, q_m, v_m and tau_m. 0: NaN */
    int growth;
} elbow_inversion_options;

/* Arrays of the caller for the results, N samples each. A null member is not written. */
typedef struct {
    elbow_real *q_a; /* N x n_a [mixed] arm coordinates */
    elbow_real *v_a; /* N x n_a [mixed] arm velocities */
    elbow_real *a_a; /* N x n_a [mixed] arm accelerations; not written by a stream */
    elbow_real *tau_g; /* N x n_g [mixed] gear torques, arm side */
    elbow_real *q_m; /* N x n_m [rad] motor angles */
    elbow_real *v_m; /* N x n_m [rad/s] motor speeds */
    elbow_real *tau_m; /* N x n_m [N m] motor torques */
} elbow_motion;

/* Problems of invert_many, one behind the other in its arrays. */
typedef struct {
    int count; /* number of problems */
    int own_path; /* 1: each has its own y, dy and ddy; 0: all have those of one path */
    int own_parameters; /* 1: each has its own run-time parameters; 0: all have the same */
    int own_q_start; /* 1: each has its own q_start; 0: all have the same */
} elbow_problems;

/* What invert reports. */
typedef struct {
    /* residual of the unactuated rows on the mesh, relative as the tolerance */
    elbow_real residual;
    elbow_real residual_at_samples; /* the same at the samples of the results */
    /* largest difference between velocities and accelerations and the numerical derivatives of
     * positions and velocities at the samples, relative to their largest value */
    elbow_real kinematic_mismatch;
    int iterations; /* Newton iterations */
    int intervals; /* intervals of the mesh */
    /* samples after the path until the motion has settled; all after it are the equilibrium.
     * Without the option settled, or where the motion has not settled: n_post of the options */
    int n_post;
    /* largest growth of a perturbation along the motion, see the function growth: above about 100
     * the torques need feedback; NaN where the option growth is 0, or the motion grows beyond all
     * numbers */
    elbow_real growth;
    /* estimate of the largest error of a motor torque by the mesh, relative to the largest torque
     * of this motor */
    elbow_real torque_error;
} elbow_invert_info;

/* Limits of invert_limited. A null member or an infinite entry means no limit. */
typedef struct {
    const elbow_real *torque_max; /* n_m [N m] largest motor torques, positive */
    const elbow_real *speed_max; /* n_m [rad/s] largest motor speeds, positive */
    /* n_e [mixed] largest deflections of the unactuated coordinates */
    const elbow_real *deflection_max;
    int knot_samples; /* samples between two knots of the deviation; 0: a thirtieth of the path */
    /* n x n_y [mixed] result: deviation from the path; not written if null */
    elbow_real *deviation;
    const elbow_real *gear_torque_max; /* n_g [mixed] largest torques of the gears, arm side */
    /* n_m [N m/s] largest rates of motor torques, from samples */
    const elbow_real *torque_rate_max;
    const elbow_real *joint_speed_max; /* n_g [mixed] largest speeds of the actuated joints */
    /* n_g [mixed] largest accelerations of these joints */
    const elbow_real *joint_acceleration_max;
    elbow_real tool_speed_max; /* [m/s] of a path of the tool: its largest speed; 0: no limit */
    elbow_real tool_acceleration_max; /* [m/s^2] its largest acceleration; 0: no limit */
    /* n_m x torque_speed_points x 2 [rad/s, N m] points (speed, torque) of the largest motor
     * torques over the speed: a convex region, from speed 0 on, the last point repeated where a
     * motor has fewer */
    const elbow_real *torque_speed;
    int torque_speed_points; /* points of each motor, at least 2; ignored without a curve */
} elbow_inversion_limits;

/* What invert_limited reports. */
typedef struct {
    /* residual of the unactuated rows on the mesh, relative as the tolerance */
    elbow_real residual;
    elbow_real residual_at_samples; /* the same at the samples of the results */
    /* largest difference between velocities and accelerations and the numerical derivatives of
     * positions and velocities at the samples, relative to their largest value */
    elbow_real kinematic_mismatch;
    elbow_real deviation_m; /* [m] largest distance from the given path */
    elbow_real deviation_rad; /* [rad] the same of angles */
    elbow_real limit_excess; /* largest violation of a limit, relative */
    int programs; /* quadratic programs */
    int iterations; /* Newton iterations */
    int intervals; /* intervals of the mesh */
    /* samples after the path until the motion has settled; all after it are the equilibrium.
     * Without the option settled, or where the motion has not settled: n_post of the options */
    int n_post;
    /* largest growth of a perturbation along the motion, see the function growth: above about 100
     * the torques need feedback; NaN where the option growth is 0, or the motion grows beyond all
     * numbers */
    elbow_real growth;
} elbow_invert_limited_info;

/* A stream: memory of the caller that holds its whole state. Copy the memory to copy the stream. */
typedef struct {
    elbow_real *memory; /* size */
    int64_t size; /* its length, at least stream_work */
} elbow_stream;

/* Options of a stream; stream_defaults gives those that are recommended for the model. */
typedef struct {
    int intervals; /* intervals of the horizon, 1 to 10000 */
    int samples_per_interval; /* samples of the results per update, 1 to 1000 */
    elbow_real period; /* [s] time between two updates: the length of an interval */
    /* largest residual of the unactuated rows, relative to the torques of a deflection of 0.01 rad
     * or 0.01 m; 1e-6 is what flexgen solve uses (single precision: 1e-3) */
    elbow_real tolerance;
    elbow_hold hold; /* what the drive does between two samples of tau_m */
    elbow_real delay; /* from a sample until the motor has its torque, in samples, 0 to 4 */
} elbow_stream_options;

/* What stream_update reports. */
typedef struct {
    elbow_real residual; /* residual of the unactuated rows, relative as the tolerance */
    elbow_real kinematic_mismatch; /* as in invert_info, limit 0.02 (single precision: 0.25) */
    /* largest step of a motor torque from the interval before, relative to its largest value;
     * limit 2e-4 (single precision: 5e-3) */
    elbow_real torque_step;
    /* [m] distance by which the output leaves the plan before because the horizon is too short. No
     * estimate of the error where it is long enough: mesh, samples and hold are not in it, only a
     * simulation has them */
    elbow_real output_step_m;
    elbow_real output_step_rad; /* [rad] the same of angles */
    elbow_real deviation_m; /* [m] distance of the modified path from the given one */
    elbow_real deviation_rad; /* [rad] angle between both */
    elbow_cause cause; /* of TOLERANCE_NOT_MET */
    int limits_active; /* 1 where limits modify the path or are exceeded, else 0 */
} elbow_stream_info;

/*
 * The defaults of the options of a whole path.
 */
ELBOW_API
elbow_inversion_options elbow_inversion_defaults(void);

/*
 * The recommended options of a stream; the intervals and the period are 0 where the home pose has
 * none.
 */
ELBOW_API
elbow_stream_options elbow_stream_defaults(void);

/*
 * Length of the workspace of invert, in reals; -1 where an option is out of range.
 *
 *   n        [1] samples of the path
 *   options      see elbow_inversion_options
 */
ELBOW_API
int64_t elbow_invert_work(int n, const elbow_inversion_options *options);

/*
 * Inverse dynamics along a whole path: motion of arm and motors, and motor torques, for exact
 * tracking of the output.
 *
 * The output is at rest before the path and after it. The arm starts at equilibrium. Its
 * unactuated coordinates move before the path where zeros are unstable (n_pre), and after it until
 * the stable zeros have decayed (n_post). OK: the residual is within the tolerance on the mesh and
 * within 100 tolerances at the samples (single precision: within the tolerance), the kinematic
 * mismatch is below 0.02 (0.25), and the torque error is at most 0.005 (or the residual at the
 * samples within the tolerance); with Fourier sums of motor angles a residual within a hundredth
 * of the tolerance replaces it. A residual of 1e-4 at the samples moves the output by at most 1e-5
 * rad, and m for each meter of reach: what flexgen solve accepts. TOLERANCE_NOT_MET: the iteration
 * converged on the mesh, but the result between its nodes is not accurate: use a shorter period of
 * the mesh (fewer samples_per_interval, or a shorter sampling period), or a smoother path. Do not
 * use the results where the status is negative. BAD_ARGUMENT also means that the path does not
 * begin and end at rest. UNREACHABLE also means that no equilibrium was found from q_start.
 * Without unactuated coordinates nothing is solved and the residual is zero. Arrays are stored
 * sample after sample: entry i of sample k is x[k * n_a + i]. Stack: at most 11264 bytes.
 *
 *   samples                     samples of the output
 *   q_start   n_a       [mixed] initial guess of the equilibrium at the first sample
 *   options                     see elbow_inversion_options
 *   motion                      results; N = n_pre + n + n_post
 *   info                        what the solver reports
 *   work      work_size         workspace
 *   work_size           [1]     its length, at least invert_work
 */
ELBOW_API
elbow_status elbow_invert(const elbow_samples *samples, const elbow_real q_start[ELBOW_NA],
    const elbow_inversion_options *options, elbow_motion *motion, elbow_invert_info *info,
    elbow_real *work, int64_t work_size);

/*
 * The function invert for many problems: paths, run-time parameters and starts that differ or are
 * shared.
 *
 * Each problem has the bits of invert, its own status and its own info. A problem that fails
 * affects no other; its results are NaN. The status of the first problem with a negative one is
 * returned. The problems are solved one after the other in one workspace, that of invert: for
 * several cores, give each thread a part of the arrays and a workspace of its own. Stack: at most
 * 11264 bytes.
 *
 *   problems                      see elbow_problems
 *   samples                       samples of the outputs: n and period of all paths are equal
 *   q_start   count x n_a [mixed] initial guesses, as of invert
 *   options                       see elbow_inversion_options
 *   motion                        results, count times N = n_pre + n + n_post
 *   info      count               what the solver reports
 *   statuses  count               of each problem
 *   work      work_size           workspace
 *   work_size             [1]     its length, at least invert_work
 */
ELBOW_API
elbow_status elbow_invert_many(const elbow_problems *problems, const elbow_samples *samples,
    const elbow_real *q_start, const elbow_inversion_options *options, elbow_motion *motion,
    elbow_invert_info *info, elbow_status *statuses, elbow_real *work, int64_t work_size);

/*
 * Length of the workspace of growth, in reals.
 */
ELBOW_API
int64_t elbow_growth_work(void);

/*
 * Largest growth of a perturbation from the start of a motion to an instant of it, under motor
 * torques alone.
 *
 * Errors of the model and of the start grow by this factor: where it is above about 100 only
 * feedback keeps the robot on its path. It is the largest singular value of the transition matrix
 * of the positions, of motors on the arm side, with the linearization every 10 ms (at most 1000
 * times); at most 1e300 (single precision: 1e37). Samples at the end in which the arm is at rest
 * do not count; where there are any, the last torque is held for 0.5 s. The members q_a, v_a, q_m,
 * v_m and tau_m of the motion are read, such as invert has written them; with a hold the factor is
 * approximate. Stack: at most 11264 bytes.
 *
 *   motion                  N = n samples
 *   n                   [1] number of samples, at least 2
 *   period              [s] time between two samples
 *   growth    1         [1] result, at least 1
 *   work      work_size     workspace
 *   work_size           [1] its length, at least growth_work
 */
ELBOW_API
elbow_status elbow_growth(const elbow_motion *motion, int n, elbow_real period,
    elbow_real *growth, elbow_real *work, int64_t work_size);

/*
 * Length of the memory of a stream, in reals; -1 where an option is out of range.
 *
 *   options   see elbow_stream_options
 */
ELBOW_API
int64_t elbow_stream_work(const elbow_stream_options *options);

/*
 * Start a stream: inverse dynamics on a moving horizon, at rest at a given output.
 *
 * The memory holds the whole state of the stream. It may be copied and moved between calls. Each
 * stream needs its own. A stream that has failed can be started again. Stack: at most 11264 bytes.
 *
 *   stream              see elbow_stream
 *   options             see elbow_stream_options
 *   y       n_t [mixed] output; for a pose the position, then the rotation matrix by columns
 *   q_start n_a [mixed] initial guess of the equilibrium
 */
ELBOW_API
elbow_status elbow_stream_start(const elbow_stream *stream, const elbow_stream_options *options,
    const elbow_real y[ELBOW_NT], const elbow_real q_start[ELBOW_NA]);

/*
 * Take the path sample at the end of the horizon; give motion and torques of the interval that
 * starts now.
 *
 * The output reaches the sample after as many updates as the horizon has intervals. An update is
 * one iteration of the solver, with a bounded number of operations. A sample that is refused
 * (INPUT_NOT_FINITE, BAD_ARGUMENT, UNREACHABLE) changes nothing. After any other negative status
 * the stream has failed, and later updates return NOT_STARTED. OK: in this interval the residual
 * is within the tolerance, the kinematic mismatch is below 0.02 (single precision: 0.25), and the
 * motor torque continues that of the interval before within 2e-4 (5e-3) of its largest value.
 * TOLERANCE_NOT_MET: one of these three is too large; the cause in the info shows which. Motion
 * below 3e-8 m or rad (1e-5) within an interval and steps of the output below 1e-8 m or rad (1e-6)
 * are not counted. Reasons are a path that is not smooth, a horizon that is too short for the
 * unstable zeros, a sampling period that is too long or too short, or fewer than 7 samples in the
 * rest of the horizon: (intervals - 1) * samples_per_interval < 7 (with a hold 11, and the delay).
 * TOLERANCE_NOT_MET and LIMITS_ACTIVE are positive and come with results. To stop, repeat the last
 * position with zero derivatives until the results are at rest, at least for a whole horizon.
 * Stack: at most 11264 bytes.
 *
 *   stream             see elbow_stream
 *   y      n_t [mixed] output; for a pose the position, then the rotation matrix by columns
 *   dy     n_y [mixed] its first time derivative; for a pose linear and angular velocity, world
 *   axes
 *   ddy    n_y [mixed] its second time derivative; for a pose linear and angular acceleration
 *   motion             results; N = samples_per_interval
 *   info               what the solver reports
 */
ELBOW_API
elbow_status elbow_stream_update(const elbow_stream *stream, const elbow_real y[ELBOW_NT],
    const elbow_real dy[ELBOW_NY], const elbow_real ddy[ELBOW_NY], elbow_motion *motion,
    elbow_stream_info *info);

/*
 * Begin an update that is done in parts: take the path sample at the end of the horizon.
 *
 * For controllers whose sampling period is shorter than the time of an update: stream_begin, then
 * stream_advance in as many sampling periods as there are, then stream_finish. The results have
 * the bits of stream_update. A sample that is refused (INPUT_NOT_FINITE, BAD_ARGUMENT,
 * UNREACHABLE) changes nothing. BAD_ARGUMENT also means that an update has begun and was not
 * finished; between stream_begin and stream_finish stream_update, stream_limits and
 * stream_parameters return it too. Stack: at most 11264 bytes.
 *
 *   stream             see elbow_stream
 *   y      n_t [mixed] output; for a pose the position, then the rotation matrix by columns
 *   dy     n_y [mixed] its first time derivative; for a pose linear and angular velocity, world
 *   axes
 *   ddy    n_y [mixed] its second time derivative; for a pose linear and angular acceleration
 */
ELBOW_API
elbow_status elbow_stream_begin(const elbow_stream *stream, const elbow_real y[ELBOW_NT],
    const elbow_real dy[ELBOW_NY], const elbow_real ddy[ELBOW_NY]);

/*
 * Do a part of an update that has begun: 1/parts of what is left.
 *
 * An update in five sampling periods: parts = 5, 4, 3, 2, 1. The shares are equal up to the
 * smallest part that is done at once, about a seventh of an update. After a negative status other
 * than NULL_ARGUMENT, BAD_ARGUMENT and NOT_STARTED (no update has begun) the stream has failed.
 * Stack: at most 11264 bytes.
 *
 *   stream      see elbow_stream
 *   parts   [1] at least 1; 1: all that is left
 */
ELBOW_API
elbow_status elbow_stream_advance(const elbow_stream *stream, int parts);

/*
 * Do the rest of an update that has begun; give motion and torques of the interval.
 *
 * Statuses and results are those of stream_update. NOT_STARTED: no update has begun, or the stream
 * has failed. Stack: at most 11264 bytes.
 *
 *   stream   see elbow_stream
 *   motion   results; N = samples_per_interval
 *   info     what the solver reports
 */
ELBOW_API
elbow_status elbow_stream_finish(const elbow_stream *stream, elbow_motion *motion,
    elbow_stream_info *info);

/*
 * Start a stream in motion: from samples of a path that does not begin at rest.
 *
 * The path has exactly intervals + 16 samples, one update apart. The next update takes the sample
 * after the last one and gives the interval that begins at sample 16, counted from 0. The
 * unactuated coordinates move as if the path had been like this before: in stable directions of
 * the zero dynamics their motion is quasi-static, in unstable ones the path ahead determines it.
 * Where the arm moves in another way, the difference decays with the stable zeros. The call takes
 * the time of about 25 updates, so call it before the first results are needed. BAD_ARGUMENT also
 * means another number of samples or another period than that of the options. Stack: at most 11264
 * bytes.
 *
 *   stream              see elbow_stream
 *   options             see elbow_stream_options
 *   samples             of the output; the period is that of the options
 *   q_start n_a [mixed] initial guess of the equilibrium at sample 7, counted from 0
 */
ELBOW_API
elbow_status elbow_stream_start_moving(const elbow_stream *stream,
    const elbow_stream_options *options, const elbow_samples *samples,
    const elbow_real q_start[ELBOW_NA]);

/*
 * Set limits of the motors: the stream modifies the path ahead where a limit would be exceeded.
 *
 * The limits hold from the next update on, with a bounded number of operations per update: a small
 * quadratic program changes the path within the horizon as little as possible, and the inversion
 * follows the modified path. While the path is modified, or a limit is exceeded, update returns
 * LIMITS_ACTIVE and reports the deviation, which decays when no limit is active. A limit that
 * cannot be kept is exceeded: compare the torques with the limits. Where it is exceeded by a
 * factor above 2.5 while the path is modified, the stream stops with LIMITS_INFEASIBLE. The path
 * is modified only beyond the preview that the unstable zeros need; HORIZON_TOO_SHORT: fewer than
 * 4 intervals, or less than half of this preview beyond it. Limits may be changed at any time. An
 * infinite torque or speed means no limit. Stack: at most 11264 bytes.
 *
 *   stream                    see elbow_stream
 *   torque_max    n_m [N m]   largest motor torques, positive
 *   speed_max     n_m [rad/s] largest motor speeds, positive
 *   deviation_max     [mixed] largest deviation of each output, m or rad
 */
ELBOW_API
elbow_status elbow_stream_limits(const elbow_stream *stream,
    const elbow_real torque_max[ELBOW_NM], const elbow_real speed_max[ELBOW_NM],
    elbow_real deviation_max);

/*
 * Length of the workspace of invert_limited, in reals; -1 where an option is out of range.
 *
 * It depends on the number of limits: some tens of megabytes for a robot with six axes.
 *
 *   n        [1] samples of the path
 *   options      see elbow_inversion_options
 *   limits       see elbow_inversion_limits
 */
ELBOW_API
int64_t elbow_invert_limited_work(int n, const elbow_inversion_options *options,
    const elbow_inversion_limits *limits);

/*
 * Inverse dynamics along a whole path within limits of motors, gears, deflections, joints and
 * tool.
 *
 * Where the path itself keeps the limits, it is inverted as by invert (OK). Else the path is
 * modified as little as possible: quadratic programs find a smooth deviation, and the modified
 * path is inverted again until the limits are kept within 1e-3 of their values (LIMITS_ACTIVE,
 * with the largest deviation in the info). The deviation is zero at the first and the last sample.
 * A path that can only be driven more slowly needs time: repeat the first and the last sample with
 * zero derivatives. Choose n_pre and n_post so that the motion before and after the samples has
 * decayed. LIMITS_INFEASIBLE: the limits cannot be kept within this time, or not at rest at an
 * end. The limits hold for the torque itself: with a hold, tau_m is what to send, which may exceed
 * them a little. The call inverts the path some hundred times. Stack: at most 11264 bytes.
 *
 *   samples                     samples of the output
 *   q_start   n_a       [mixed] initial guess of the equilibrium at the first sample
 *   options                     see elbow_inversion_options
 *   limits                      see elbow_inversion_limits
 *   motion                      results; N = n_pre + n + n_post
 *   info                        what the solver reports
 *   work      work_size         workspace
 *   work_size           [1]     its length, at least invert_limited_work
 */
ELBOW_API
elbow_status elbow_invert_limited(const elbow_samples *samples,
    const elbow_real q_start[ELBOW_NA], const elbow_inversion_options *options,
    const elbow_inversion_limits *limits, elbow_motion *motion, elbow_invert_limited_info *info,
    elbow_real *work, int64_t work_size);

/*
 * Duration of a planned path, and the joints at its start.
 *
 * BAD_ARGUMENT: the table is not one of this model, or it is damaged. Stack: at most 11264 bytes.
 *
 *   table      table_size [mixed] of flexgen plan --out, or Path.table() in Python
 *   table_size            [1]     its length
 *   duration   1          [s]     time from rest to rest
 *   q_start    n_a        [mixed] arm coordinates at the start, without deflections
 */
ELBOW_API
elbow_status elbow_path_start(const elbow_real *table, int64_t table_size, elbow_real *duration,
    elbow_real q_start[ELBOW_NA]);

/*
 * Length of the workspace of path_sample, in reals.
 */
ELBOW_API
int64_t elbow_path_work(void);

/*
 * Sample of a planned path of lines, arcs, joint moves and blended programs at any time.
 *
 * The laws and curves are those of flexgen in Python: in double precision the samples have the
 * same bits, those of joint moves up to the rounding of the kinematics. Before time 0 and after
 * the duration the output is at rest. A call has a bounded number of operations and keeps nothing,
 * so several streams may read one table. BAD_ARGUMENT: the table is not one of this model, or it
 * is damaged. Stack: at most 11264 bytes.
 *
 *   table      table_size [mixed] of flexgen plan --out, or Path.table() in Python
 *   table_size            [1]     its length
 *   t                     [s]     time since the start of the path
 *   y          n_t        [mixed] output; for a pose the position, then the rotation matrix by
 *   columns
 *   dy         n_y        [mixed] its first time derivative; for a pose linear and angular
 *   velocity
 *   ddy        n_y        [mixed] its second time derivative
 *   work       work_size          workspace
 *   work_size             [1]     its length, at least path_work
 */
ELBOW_API
elbow_status elbow_path_sample(const elbow_real *table, int64_t table_size, elbow_real t,
    elbow_real y[ELBOW_NT], elbow_real dy[ELBOW_NY], elbow_real ddy[ELBOW_NY], elbow_real *work,
    int64_t work_size);

#ifdef __cplusplus
}
#endif

#endif
