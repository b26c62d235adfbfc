/*
 * elbow: equations of motion of an elastic robot, written by flexgen. Do not edit.
 *
 * SI units. Matrices are stored by columns. Arm quantities (q_a, v_a, a_a, tau_a) are on the arm
 * side of the gears and in chain order, motor quantities (q_m, v_m, a_m, tau_m) on the motor side.
 * Indices from 0:
 *   q_a: 0 q1 [rad], 1 q2 [rad]
 *   q_m: 0 m1 [rad], 1 m2 [rad]
 *   x: 0 q1 [rad], 1 q2 [rad], 2 m1 [rad], 3 m2 [rad], 4 d(q1)/dt [rad/s], 5 d(q2)/dt [rad/s], 6
 *     d(m1)/dt [rad/s], 7 d(m2)/dt [rad/s]
 *
 * Gravity is (0.0, 0.0, -9.81) m/s^2 in world axes. Gear ratios eta and rotor inertias J_m, motor
 * side:
 *   m1: eta 267.42857142857144 (q1); J_m 0.0118 kg m^2
 *   m2: eta 252.33333333333334 (q2); J_m 0.0118 kg m^2
 *
 * Every function takes its inputs, its outputs and, where it needs one, a workspace of ELBOW_WORK
 * reals, whose contents have no meaning before and after. No pointer may be null, and arrays must
 * not overlap. It returns a status: 0, or a negative number. Where an input or a result is not
 * finite, or a system of equations is singular to rounding, all outputs are NaN. Where a pointer
 * is null, nothing is written. Angles, and sums of angles of parallel joints, must stay within the
 * range of the sine: 1e6 rad.
 *
 * elbow_batch.h has the same functions for many points, elbow_inversion.h inverse dynamics along
 * whole paths and streams.
 *
 * No function allocates, prints or keeps data: all may be called from several threads, each with
 * its own arrays. Compile with any C99 compiler:
 *   cc -std=c99 -O2 -ffp-contract=off -c $(find src -name '*.c')
 * (-ffp-contract=off: the same bits with every compiler and processor. Where GCC compiles for a
 * fused multiply-add, add -fno-tree-vectorize, because it fuses in vectors nevertheless. -O3
 * -march=native -ffp-contract=fast is faster and differs by rounding. -funroll-loops makes streams
 * and whole paths a tenth faster, and their code twice as long. Never use -ffast-math: it hides
 * results that are not finite.) Sine, cosine, exp and tanh are part of the library; no other
 * library is called; compilers may replace loops by calls of memset, memcpy and memmove. With
 * OpenMP (-fopenmp) the batches use all cores.
 */
#ifndef ELBOW_H
#define ELBOW_H

#if defined(_WIN32) && defined(ELBOW_SHARED)
#define ELBOW_API __declspec(dllexport)
#elif defined(__GNUC__)
#define ELBOW_API __attribute__((visibility("default")))
#else
#define ELBOW_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

typedef double elbow_real;

#define ELBOW_NA 2 /* arm coordinates */
#define ELBOW_NG 2 /* actuated arm coordinates, driven through gears */
#define ELBOW_NE 0 /* unactuated arm coordinates, with springs only */
#define ELBOW_NM 2 /* motors */
#define ELBOW_NX 8 /* states of the linearization */
#define ELBOW_NY 2 /* outputs */
#define ELBOW_NT 2 /* numbers of an output sample */
#define ELBOW_WORK 704 /* reals of workspace, where a function needs one */

/* Status of a call: 0 success, negative an error, positive a result with a warning. */
typedef enum {
    ELBOW_OK = 0 /* success */,
    ELBOW_NULL_ARGUMENT = -1 /* an argument is a null pointer */,
    ELBOW_INPUT_NOT_FINITE = -2 /* an input is not finite; the outputs are NaN */,
    /* a result is not finite: the system of equations is singular, or a number overflows */
    ELBOW_RESULT_NOT_FINITE = -3,
    ELBOW_BAD_COUNT = -4 /* the number of points is negative, or above the stride */,
    /* a size, a time or a rotation matrix is out of range, or the path does not begin and end at zero velocity */
    ELBOW_BAD_ARGUMENT = -5,
    ELBOW_WORK_TOO_SMALL = -6 /* the workspace is too small */,
    /* the path leaves the workspace of the robot or passes a singular pose */
    ELBOW_UNREACHABLE = -7,
    ELBOW_NOT_CONVERGED = -8 /* the iteration did not converge */,
    ELBOW_NOT_STARTED = -9 /* the stream was not started by this library, or has failed */,
    /* a zero of the zero dynamics goes through infinity on the path; use invert (method lq) */
    ELBOW_ZERO_AT_INFINITY = -10,
    /* the number of unstable zeros differs between start and end; use invert (method lq) */
    ELBOW_ZEROS_CHANGE = -11,
    /* a zero is on the imaginary axis at an end of the path; use invert (method lq) */
    ELBOW_ZERO_ON_AXIS = -12,
    /* the horizon is too short to keep limits: use at least 4 intervals, and 1.5 times the preview of the zeros */
    ELBOW_HORIZON_TOO_SHORT = -13,
    /* the limits cannot be kept; increase them, slow down the path or give the motion more time */
    ELBOW_LIMITS_INFEASIBLE = -14,
    /* residual, mismatch, torque step or torque error above its tolerance (see the info): use a shorter period */
    ELBOW_TOLERANCE_NOT_MET = 1,
    /* the limits move the output away from its path, or are exceeded; the info says how far */
    ELBOW_LIMITS_ACTIVE = 2
} elbow_status;

/* What a status means, in words; never a null pointer. */
ELBOW_API const char *elbow_status_text(elbow_status status);

/* Constants of the model. */
/* gear ratios: q_m = gear_ratio q_g without deflection */
static const elbow_real elbow_gear_ratio[ELBOW_NM][ELBOW_NG] =
    {{267.42857142857144, 0.0}, {0.0, 252.33333333333334}};
/* [kg m^2] motor side */
static const elbow_real elbow_rotor_inertia[ELBOW_NM] = {0.0118, 0.0118};
/* [N m/rad, N/m] arm side, at zero deflection; 0: rigid gear */
static const elbow_real elbow_gear_stiffness[ELBOW_NG] = {7518900.0, 4099900.0};
/* home pose of the arm */
static const elbow_real elbow_home_q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
/* home pose of the motors */
static const elbow_real elbow_home_q_m[ELBOW_NM] = {140.0252725600022, (-88.0809495839805)};

/*
 * Position and rotation matrix of the tool in the world.
 *
 *   p_world = p + R p_tool
 *
 *   in  q_a n_a   [rad] arm coordinates in chain order
 *   out p   3     [m]   position of the tool, world axes
 *   out R   3 x 3 [1]   rotation matrix, columns: axes of the tool in the world
 * 11 operations, critical path about 72 cycles; stack of one point at most 1536 bytes
 */
ELBOW_API
elbow_status elbow_forward_kinematics(const elbow_real q_a[ELBOW_NA], elbow_real p[3],
    elbow_real R[3 * 3]);

/*
 * Jacobian of the tool: its linear, then its angular velocity, in world axes.
 *
 *   (v_tool, omega_tool) = J(q_a) v_a
 *
 *   in  q_a n_a     [rad]   arm coordinates in chain order
 *   out J   6 x n_a [mixed] rows 0-2 in m/s, rows 3-5 in rad/s, per unit of the column's velocity
 * 12 operations, critical path about 76 cycles; stack of one point at most 1536 bytes
 */
ELBOW_API
elbow_status elbow_jacobian(const elbow_real q_a[ELBOW_NA], elbow_real J[6 * ELBOW_NA]);

/*
 * Mass matrix of the arm, without rotors.
 *
 *   T = v_a' M(q_a) v_a / 2
 *
 *   in  q_a n_a       [rad]    arm coordinates in chain order
 *   out M   n_a x n_a [kg m^2] mass matrix, symmetric
 * 5 operations, critical path about 68 cycles; stack of one point at most 1536 bytes
 */
ELBOW_API
elbow_status elbow_mass_matrix(const elbow_real q_a[ELBOW_NA], elbow_real M[ELBOW_NA * ELBOW_NA]);

/*
 * Coriolis, centripetal and gravity forces of the arm.
 *
 *   h = c(q_a, v_a) + g(q_a)
 *
 *   in  q_a n_a [rad]   arm coordinates in chain order
 *   in  v_a n_a [rad/s] arm velocities
 *   out h   n_a [N m]   bias forces, arm side
 * 20 operations, critical path about 84 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
elbow_status elbow_bias(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    elbow_real h[ELBOW_NA]);

/*
 * Gravity forces of the arm.
 *
 *   g = dU(q_a)/dq_a
 *
 *   in  q_a n_a [rad] arm coordinates in chain order
 *   out g   n_a [N m] gravity forces, arm side
 * 6 operations, critical path about 72 cycles; stack of one point at most 1536 bytes
 */
ELBOW_API
elbow_status elbow_gravity(const elbow_real q_a[ELBOW_NA], elbow_real g[ELBOW_NA]);

/*
 * Forces that the arm needs for a given motion, without friction and springs.
 *
 *   tau_a = M(q_a) a_a + c(q_a, v_a) + g(q_a)
 *
 *   in  q_a   n_a [rad]     arm coordinates in chain order
 *   in  v_a   n_a [rad/s]   arm velocities
 *   in  a_a   n_a [rad/s^2] arm accelerations
 *   out tau_a n_a [N m]     forces on the arm coordinates, arm side
 * 35 operations, critical path about 88 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
elbow_status elbow_inverse_dynamics(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real a_a[ELBOW_NA], elbow_real tau_a[ELBOW_NA]);

/*
 * First derivatives of the inverse dynamics.
 *
 *   d tau_a = dtau_dq d q_a + dtau_dv d v_a + dtau_da d a_a
 *
 *   in  q_a     n_a       [rad]     arm coordinates in chain order
 *   in  v_a     n_a       [rad/s]   arm velocities
 *   in  a_a     n_a       [rad/s^2] arm accelerations
 *   out dtau_dq n_a x n_a [mixed]   unit of the row's force per unit of the column's coordinate
 *   out dtau_dv n_a x n_a [mixed]   unit of the row's force per unit of the column's velocity
 *   out dtau_da n_a x n_a [kg m^2]  mass matrix, symmetric
 * 40 operations, critical path about 84 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
elbow_status elbow_inverse_dynamics_derivatives(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real a_a[ELBOW_NA],
    elbow_real dtau_dq[ELBOW_NA * ELBOW_NA], elbow_real dtau_dv[ELBOW_NA * ELBOW_NA],
    elbow_real dtau_da[ELBOW_NA * ELBOW_NA]);

/*
 * Accelerations of the arm under given forces on its coordinates, without rotors, friction and
 * springs: the inverse of inverse_dynamics.
 *
 *   a_a = M(q_a)^-1 (tau_a - c(q_a, v_a) - g(q_a))
 *
 *   in  q_a   n_a [rad]     arm coordinates in chain order
 *   in  v_a   n_a [rad/s]   arm velocities
 *   in  tau_a n_a [N m]     forces on the arm coordinates, arm side
 *   out a_a   n_a [rad/s^2] arm accelerations
 * 37 operations, critical path about 132 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
elbow_status elbow_arm_forward_dynamics(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real tau_a[ELBOW_NA], elbow_real a_a[ELBOW_NA]);

/*
 * First derivatives of the arm's forward dynamics.
 *
 *   d a_a = da_dq d q_a + da_dv d v_a + da_dtau d tau_a,  da_dtau = M^-1
 *
 *   in  q_a     n_a       [rad]   arm coordinates in chain order
 *   in  v_a     n_a       [rad/s] arm velocities
 *   in  tau_a   n_a       [N m]   forces on the arm coordinates, arm side
 *   out da_dq   n_a x n_a [mixed] unit of the row's acceleration per unit of the column's
 *   coordinate
 *   out da_dv   n_a x n_a [mixed] unit of the row's acceleration per unit of the column's velocity
 *   out da_dtau n_a x n_a [mixed] inverse of the mass matrix, symmetric
 * 117 operations, critical path about 296 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
elbow_status elbow_arm_forward_derivatives(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real tau_a[ELBOW_NA],
    elbow_real da_dq[ELBOW_NA * ELBOW_NA], elbow_real da_dv[ELBOW_NA * ELBOW_NA],
    elbow_real da_dtau[ELBOW_NA * ELBOW_NA], elbow_real *work);

/*
 * Accelerations of arm and motors under the motors' torques, with springs, dampers and friction.
 * Entries of q_m and v_m behind rigid gears are ignored; those of a_m are filled in.
 *
 *   M a_a + c + g = tau_a,  J_m a_m + f(v_m) + eta^-T tau_g = tau_m
 *
 *   in  q_a   n_a [rad]     arm coordinates in chain order
 *   in  v_a   n_a [rad/s]   arm velocities
 *   in  q_m   n_m [rad]     motor angles, motor side
 *   in  v_m   n_m [rad/s]   motor speeds, motor side
 *   in  tau_m n_m [N m]     motor torques, motor side
 *   out a_a   n_a [rad/s^2] arm accelerations
 *   out a_m   n_m [rad/s^2] motor accelerations, motor side
 * 57 operations, critical path about 132 cycles; stack of one point at most 2048 bytes
 */
ELBOW_API
elbow_status elbow_forward_dynamics(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real q_m[ELBOW_NM],
    const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM], elbow_real a_a[ELBOW_NA],
    elbow_real a_m[ELBOW_NM]);

/*
 * The same with a force and a torque on the tool, and the torques of the elastic gears; zero for
 * rigid gears.
 *
 *   M a_a + c + g = tau_a + J' f_tool,  J_m a_m + f(v_m) + eta^-T tau_g = tau_m
 *
 *   in  q_a    n_a [rad]     arm coordinates in chain order
 *   in  v_a    n_a [rad/s]   arm velocities
 *   in  q_m    n_m [rad]     motor angles, motor side
 *   in  v_m    n_m [rad/s]   motor speeds, motor side
 *   in  tau_m  n_m [N m]     motor torques, motor side
 *   in  f_tool 6   [mixed]   on the tool at its origin, world axes: force [N], then torque [N m]
 *   out a_a    n_a [rad/s^2] arm accelerations
 *   out a_m    n_m [rad/s^2] motor accelerations, motor side
 *   out tau_g  n_g [N m]     torques of the gears on the arm, arm side
 * 80 operations, critical path about 140 cycles; stack of one point at most 2304 bytes
 */
ELBOW_API
elbow_status elbow_forward_dynamics_tool_force(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real q_m[ELBOW_NM],
    const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM], const elbow_real f_tool[6],
    elbow_real a_a[ELBOW_NA], elbow_real a_m[ELBOW_NM], elbow_real tau_g[ELBOW_NG]);

/*
 * Velocity and acceleration of the tool, linear and angular, in world axes.
 *
 *   v_tool = J v_a,  a_tool = J a_a + J' v_a
 *
 *   in  q_a    n_a [rad]     arm coordinates in chain order
 *   in  v_a    n_a [rad/s]   arm velocities
 *   in  a_a    n_a [rad/s^2] arm accelerations
 *   out v_tool 6   [mixed]   of the tool's origin [m/s], then angular velocity [rad/s], world axes
 *   out a_tool 6   [mixed]   of the tool's origin [m/s^2], then angular acceleration [rad/s^2],
 *   world axes
 * 35 operations, critical path about 80 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
elbow_status elbow_tool_motion(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real v_tool[6], elbow_real a_tool[6]);

/*
 * Linearization of the forward dynamics in the state x = (q_a, q_m, v_a, v_m), of the motors only
 * those behind elastic gears.
 *
 *   d(dx/dt) = A dx + B d(tau_m)
 *
 *   in  q_a   n_a       [rad]   arm coordinates in chain order
 *   in  v_a   n_a       [rad/s] arm velocities
 *   in  q_m   n_m       [rad]   motor angles, motor side
 *   in  v_m   n_m       [rad/s] motor speeds, motor side
 *   in  tau_m n_m       [N m]   motor torques, motor side
 *   out A     n_x x n_x [mixed] unit of the row's x/s per unit of the column's x
 *   out B     n_x x n_m [mixed] unit of the row's x/s per N m
 * 293 operations, critical path about 376 cycles; stack of one point at most 2048 bytes
 */
ELBOW_API
elbow_status elbow_linearize(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM],
    const elbow_real tau_m[ELBOW_NM], elbow_real A[ELBOW_NX * ELBOW_NX],
    elbow_real B[ELBOW_NX * ELBOW_NM], elbow_real *work);

/*
 * Acceleration and jerk of an arm with elastic joints from its state, without damping of the
 * gears.
 *
 *   M a_a + c + g - f = T,  T = spring(eta^-1 q_m - q_a);  j_a = d a_a/dt
 *
 *   in  q_a n_a [rad]     arm coordinates in chain order
 *   in  v_a n_a [rad/s]   arm velocities
 *   in  q_m n_m [rad]     motor angles, motor side
 *   in  v_m n_m [rad/s]   motor speeds, motor side
 *   out a_a n_a [rad/s^2] arm accelerations
 *   out j_a n_a [rad/s^3] arm jerks
 * 161 operations, critical path about 200 cycles; stack of one point at most 2816 bytes
 */
ELBOW_API
elbow_status elbow_flexible_joint_motion(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real q_m[ELBOW_NM],
    const elbow_real v_m[ELBOW_NM], elbow_real a_a[ELBOW_NA], elbow_real j_a[ELBOW_NA]);

/*
 * Torques of the motors that give an arm with elastic joints a fourth derivative of its
 * coordinates, without damping of the gears.
 *
 *   tau_m = J_m eta (a_a + d'') + f(v_m) + eta^-T T,  spring(d)'' = (M a_a + c + g - f)''
 *
 *   in  q_a   n_a [rad]     arm coordinates in chain order
 *   in  v_a   n_a [rad/s]   arm velocities
 *   in  a_a   n_a [rad/s^2] arm accelerations
 *   in  j_a   n_a [rad/s^3] arm jerks
 *   in  s_a   n_a [rad/s^4] fourth time derivatives of the arm coordinates
 *   in  q_m   n_m [rad]     motor angles, motor side
 *   in  v_m   n_m [rad/s]   motor speeds, motor side
 *   out tau_m n_m [N m]     motor torques, motor side
 * 208 operations, critical path about 132 cycles; stack of one point at most 3328 bytes
 */
ELBOW_API
elbow_status elbow_flexible_joint_torque(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real a_a[ELBOW_NA],
    const elbow_real j_a[ELBOW_NA], const elbow_real s_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], elbow_real tau_m[ELBOW_NM]);

/*
 * How far the output is from a target, and the map W from speeds to rates of the output.
 *
 *   y_err = y(q_a) - target,  dy/dt = W(q_a) v_a,  d2y/dt2 = W a_a + Wdot_v
 *
 *   in  q_a    n_a       [rad]   arm coordinates in chain order
 *   in  v_a    n_a       [rad/s] arm velocities
 *   in  target n_t       [m]     where the output shall be
 *   out y_err  n_y       [m]     output less target
 *   out W      n_y x n_a [mixed] unit of the row's rate per unit of the column's velocity
 *   out Wdot_v n_y       [m/s^2] second time derivative of the output without accelerations
 * 23 operations, critical path about 76 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
elbow_status elbow_output_constraint(const elbow_real q_a[ELBOW_NA],
    const elbow_real v_a[ELBOW_NA], const elbow_real target[ELBOW_NT],
    elbow_real y_err[ELBOW_NY], elbow_real W[ELBOW_NY * ELBOW_NA], elbow_real Wdot_v[ELBOW_NY]);

/*
 * Torques of the gears for a given motion, and the remainder of the equations of the coordinates
 * without motor.
 *
 *   tau_g = [M a_a + c + g - f]_g,  row = [M a_a + c + g - f]_e - tau_e, f: the arm's frictions
 *
 *   in  q_a   n_a [rad]     arm coordinates in chain order
 *   in  v_a   n_a [rad/s]   arm velocities
 *   in  a_a   n_a [rad/s^2] arm accelerations
 *   out tau_g n_g [N m]     torques of the gears on the arm, arm side
 * 35 operations, critical path about 88 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
elbow_status elbow_inversion_rows(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real tau_g[ELBOW_NG]);

/*
 * Torques of the gears' springs at given deflections, and their derivatives; zero for rigid gears.
 *
 *   tau_p = spring(deflection),  dtau_p = d tau_p/d deflection
 *
 *   in  deflection n_g [rad]   of the gears, arm side: eta^-1 q_m - q_g
 *   out tau_p      n_g [N m]   torques of the gears' springs, arm side
 *   out dtau_p     n_g [mixed] unit of the torque per unit of the coordinate
 * 2 operations, critical path about 4 cycles; stack of one point at most 1280 bytes
 */
ELBOW_API
elbow_status elbow_gear_law(const elbow_real deflection[ELBOW_NG], elbow_real tau_p[ELBOW_NG],
    elbow_real dtau_p[ELBOW_NG]);

/*
 * Friction torques of the motors.
 *
 *   f_m = f(v_m)
 *
 *   in  v_m n_m [rad/s] motor speeds, motor side
 *   out f_m n_m [N m]   friction torques, motor side
 * 0 operations, critical path about 0 cycles; stack of one point at most 1024 bytes
 */
ELBOW_API
elbow_status elbow_motor_friction(const elbow_real v_m[ELBOW_NM], elbow_real f_m[ELBOW_NM]);

/* For programs that load the library at run time: check these before the first call. */
ELBOW_API int elbow_abi_version(void);
ELBOW_API const char *elbow_digest(void); /* SHA-256 of the model */
ELBOW_API const char *elbow_interface(void); /* SHA-256 of names and shapes of the functions */
ELBOW_API int elbow_sizeof_real(void);
ELBOW_API int elbow_sizeof_int(void);
ELBOW_API int elbow_work(void); /* ELBOW_WORK */
ELBOW_API int elbow_n_a(void);
ELBOW_API int elbow_n_g(void);
ELBOW_API int elbow_n_e(void);
ELBOW_API int elbow_n_m(void);
ELBOW_API int elbow_n_x(void);
ELBOW_API int elbow_n_y(void);
ELBOW_API int elbow_n_t(void);

#ifdef __cplusplus
}
#endif

#endif
