/*
 * elbow: equations of motion of an elastic robot, written by flexgen. Do not edit.
 *
 * SI units. Matrices are stored by columns. Arm quantities (q_a, v_a, a_a, tau_a) are on the arm side of the gears and
 * in chain order, motor quantities (q_m, v_m, a_m, tau_m) on the motor side. Indices from 0:
 *   q_a: 0 q1 [rad], 1 q2 [rad]
 *   q_m: 0 m1 [rad], 1 m2 [rad]
 *   x: 0 q1 [rad], 1 q2 [rad], 2 m1 [rad], 3 m2 [rad], 4 d(q1)/dt [rad/s], 5 d(q2)/dt [rad/s], 6 d(m1)/dt [rad/s], 7
 *     d(m2)/dt [rad/s]
 *
 * Numbers of the model that the functions use and a controller may need: gravity (0.0, 0.0, -9.81) m/s^2 in world
 * axes; the gear ratios eta, with q_m = eta q_a of the driven coordinates where no gear is twisted; the rotor inertias
 * J_m, motor side:
 *   m1: eta 267.42857142857144 (q1); J_m 0.0118 kg m^2
 *   m2: eta 252.33333333333334 (q2); J_m 0.0118 kg m^2
 *
 * Every function takes its inputs, its outputs and a workspace of <NAME>_<FUNCTION>_WORK reals (at least 1), whose
 * contents mean nothing before and after. No pointer may be null; arrays must not overlap. It returns 0, or a negative
 * status: where a result or any entry of an input is not finite all its outputs are NaN, where a pointer is null
 * nothing is written. Where a system of equations is singular up to rounding, the result counts as not finite. Angles,
 * and their sums over joints with parallel axes, must stay within the range of the sine in elbow_kernel.h; beyond it
 * the result is not finite.
 *
 * <function>_batch evaluates n points. Memory is a structure of arrays: entry i of point k of an array x is x[i * n +
 * k]; of a matrix with r rows entry (row, column) is i = row + column * r. All points are evaluated; the outputs of a
 * point that fails are NaN, and the status of the first such point is returned. The workspace has
 * <NAME>_<FUNCTION>_BATCH_WORK reals (with OpenMP: that many per thread; ask <function>_batch_work, and do not raise
 * the number of threads after that). GCC and clang compute several points at once in vector registers, with the same
 * bits as one by one where nothing is contracted (see below).
 *
 * No function allocates, prints or keeps data: all may be called from several threads, each with its own arrays.
 * Compile with any C99 compiler:
 *   cc -std=c99 -O2 -ffp-contract=off *.c -lm
 * (-ffp-contract=off: the same bits with every compiler and processor; where GCC compiles for a fused multiply-add,
 * add -fno-tree-vectorize, as it fuses vectors all the same. -O3 -march=native -ffp-contract=fast is faster, and
 * differs by rounding. Never -ffast-math: it hides results that are not finite.) Sine, cosine, exp and tanh are the
 * library's own; no other library is called, but that compilers may make loops into calls of memset, memcpy and
 * memmove. With OpenMP (-fopenmp) the batches use all cores.
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

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef double elbow_real;

#define ELBOW_NA 2 /* arm coordinates */
#define ELBOW_NG 2 /* arm coordinates that motors drive through gears */
#define ELBOW_NE 0 /* arm coordinates without a motor: springs only */
#define ELBOW_NM 2 /* motors */
#define ELBOW_NX 8 /* states of the linearisation */
#define ELBOW_NY 2 /* outputs */
#define ELBOW_NT 2 /* numbers of a target of the output */

/* Workspace in reals: for one point; for many points, per thread. */
#define ELBOW_FORWARD_KINEMATICS_WORK 1
#define ELBOW_FORWARD_KINEMATICS_BATCH_WORK 896
#define ELBOW_JACOBIAN_WORK 1
#define ELBOW_JACOBIAN_BATCH_WORK 896
#define ELBOW_MASS_MATRIX_WORK 1
#define ELBOW_MASS_MATRIX_BATCH_WORK 384
#define ELBOW_BIAS_WORK 1
#define ELBOW_BIAS_BATCH_WORK 384
#define ELBOW_GRAVITY_WORK 1
#define ELBOW_GRAVITY_BATCH_WORK 256
#define ELBOW_INVERSE_DYNAMICS_WORK 1
#define ELBOW_INVERSE_DYNAMICS_BATCH_WORK 512
#define ELBOW_INVERSE_DYNAMICS_DERIVATIVES_WORK 1
#define ELBOW_INVERSE_DYNAMICS_DERIVATIVES_BATCH_WORK 1152
#define ELBOW_ARM_FORWARD_DYNAMICS_WORK 1
#define ELBOW_ARM_FORWARD_DYNAMICS_BATCH_WORK 512
#define ELBOW_ARM_FORWARD_DERIVATIVES_WORK 38
#define ELBOW_ARM_FORWARD_DERIVATIVES_BATCH_WORK 1456
#define ELBOW_FORWARD_DYNAMICS_WORK 1
#define ELBOW_FORWARD_DYNAMICS_BATCH_WORK 896
#define ELBOW_LINEARIZE_WORK 84
#define ELBOW_LINEARIZE_BATCH_WORK 6432
#define ELBOW_OUTPUT_CONSTRAINT_WORK 1
#define ELBOW_OUTPUT_CONSTRAINT_BATCH_WORK 896
#define ELBOW_INVERSION_ROWS_WORK 1
#define ELBOW_INVERSION_ROWS_BATCH_WORK 512
#define ELBOW_GEAR_LAW_WORK 1
#define ELBOW_GEAR_LAW_BATCH_WORK 384
#define ELBOW_MOTOR_FRICTION_WORK 1
#define ELBOW_MOTOR_FRICTION_BATCH_WORK 256
#define ELBOW_INVERT_REPORT 5 /* numbers that invert reports */
#define ELBOW_STREAM_REPORT 7 /* numbers that stream_update reports */

enum elbow_status {
    ELBOW_OK = 0 /* success */,
    ELBOW_NULL_ARGUMENT = -1 /* an argument is a null pointer */,
    ELBOW_INPUT_NOT_FINITE = -2 /* an input is not finite, and so is the result */,
    ELBOW_RESULT_NOT_FINITE = -3 /* the result is not finite: a singular or an extreme state */,
    ELBOW_BAD_COUNT = -4 /* the number of points is negative */,
    /* a size, a time or a rotation is none that is allowed, or the path does not begin and end at rest */
    ELBOW_BAD_ARGUMENT = -5,
    ELBOW_WORK_TOO_SMALL = -6 /* the workspace is too small */,
    ELBOW_UNREACHABLE = -7 /* the path leaves the workspace or passes a singular pose */,
    ELBOW_NOT_CONVERGED = -8 /* no motion was found within the bounds of the solver */,
    ELBOW_NOT_STARTED = -9 /* the stream was not started, or has failed since */,
    /* a zero of the zero dynamics is at infinity at an end of the path or on the way; use invert (method lq) */
    ELBOW_FLAT = -10,
    /* the number of unstable zeros differs between start and end; use invert (method lq) */
    ELBOW_ZEROS_CHANGE = -11,
    /* a zero is on the imaginary axis at an end of the path, neither stable nor unstable; use invert (method lq) */
    ELBOW_ZERO_ON_AXIS = -12,
    /* the horizon is too short to keep limits: take 4 intervals, and half as many again as the zeros look ahead */
    ELBOW_SHORT_HORIZON = -13,
    /* the limits of the motors cannot be kept, one is passed by more than 2.5 times; loosen them or the move */
    ELBOW_LIMITS_LOST = -14,
    /* the residual is above the tolerance, or the motion uneven; the result is the best that was found */
    ELBOW_INEXACT = 1,
    /* the bounds of the motors keep the output off its path, or are passed; the report says how far */
    ELBOW_LIMITED = 2
};

/* What a status means, in words; never a null pointer. */
ELBOW_API const char *elbow_status_text(int status);

/*
 * Position and rotation matrix of the tool in the world.
 *
 *   p_world = p + R p_tool
 *
 *   in  q_a n_a   [rad] arm coordinates in chain order
 *   out p   3     [m]   position of the tool, world axes
 *   out R   3 x 3 [1]   rotation matrix, columns: axes of the tool in the world
 * 11 operations, the longest chain about 72 cycles; stack of one point at most 1536 bytes
 */
ELBOW_API
int elbow_forward_kinematics(const elbow_real q_a[ELBOW_NA], elbow_real p[3], elbow_real R[3 * 3], elbow_real *work);
ELBOW_API
int elbow_forward_kinematics_batch(int n, const elbow_real *q_a, elbow_real *p, elbow_real *R, elbow_real *work);
ELBOW_API int elbow_forward_kinematics_work(void);
ELBOW_API int elbow_forward_kinematics_batch_work(void); /* times the threads, with OpenMP */

/*
 * Jacobian of the tool: its linear, then its angular velocity, in world axes.
 *
 *   (v_tool, omega_tool) = J(q_a) v_a
 *
 *   in  q_a n_a     [rad]   arm coordinates in chain order
 *   out J   6 x n_a [mixed] rows 0-2 in m/s, rows 3-5 in rad/s, per unit of the column's velocity
 * 12 operations, the longest chain about 76 cycles; stack of one point at most 1536 bytes
 */
ELBOW_API
int elbow_jacobian(const elbow_real q_a[ELBOW_NA], elbow_real J[6 * ELBOW_NA], elbow_real *work);
ELBOW_API
int elbow_jacobian_batch(int n, const elbow_real *q_a, elbow_real *J, elbow_real *work);
ELBOW_API int elbow_jacobian_work(void);
ELBOW_API int elbow_jacobian_batch_work(void); /* times the threads, with OpenMP */

/*
 * Mass matrix of the arm, without rotors.
 *
 *   T = v_a' M(q_a) v_a / 2
 *
 *   in  q_a n_a       [rad]    arm coordinates in chain order
 *   out M   n_a x n_a [kg m^2] mass matrix, symmetric
 * 5 operations, the longest chain about 68 cycles; stack of one point at most 1536 bytes
 */
ELBOW_API
int elbow_mass_matrix(const elbow_real q_a[ELBOW_NA], elbow_real M[ELBOW_NA * ELBOW_NA], elbow_real *work);
ELBOW_API
int elbow_mass_matrix_batch(int n, const elbow_real *q_a, elbow_real *M, elbow_real *work);
ELBOW_API int elbow_mass_matrix_work(void);
ELBOW_API int elbow_mass_matrix_batch_work(void); /* times the threads, with OpenMP */

/*
 * Coriolis, centripetal and gravity forces of the arm.
 *
 *   h = c(q_a, v_a) + g(q_a)
 *
 *   in  q_a n_a [rad]   arm coordinates in chain order
 *   in  v_a n_a [rad/s] arm velocities
 *   out h   n_a [N m]   bias forces, arm side
 * 20 operations, the longest chain about 84 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
int elbow_bias(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA], elbow_real h[ELBOW_NA],
    elbow_real *work);
ELBOW_API
int elbow_bias_batch(int n, const elbow_real *q_a, const elbow_real *v_a, elbow_real *h, elbow_real *work);
ELBOW_API int elbow_bias_work(void);
ELBOW_API int elbow_bias_batch_work(void); /* times the threads, with OpenMP */

/*
 * Gravity forces of the arm.
 *
 *   g = dU(q_a)/dq_a
 *
 *   in  q_a n_a [rad] arm coordinates in chain order
 *   out g   n_a [N m] gravity forces, arm side
 * 6 operations, the longest chain about 72 cycles; stack of one point at most 1536 bytes
 */
ELBOW_API
int elbow_gravity(const elbow_real q_a[ELBOW_NA], elbow_real g[ELBOW_NA], elbow_real *work);
ELBOW_API
int elbow_gravity_batch(int n, const elbow_real *q_a, elbow_real *g, elbow_real *work);
ELBOW_API int elbow_gravity_work(void);
ELBOW_API int elbow_gravity_batch_work(void); /* times the threads, with OpenMP */

/*
 * Forces that the arm needs for a given motion, without friction and springs.
 *
 *   tau_a = M(q_a) a_a + c(q_a, v_a) + g(q_a)
 *
 *   in  q_a   n_a [rad]     arm coordinates in chain order
 *   in  v_a   n_a [rad/s]   arm velocities
 *   in  a_a   n_a [rad/s^2] arm accelerations
 *   out tau_a n_a [N m]     forces on the arm coordinates, arm side
 * 35 operations, the longest chain about 88 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
int elbow_inverse_dynamics(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real tau_a[ELBOW_NA], elbow_real *work);
ELBOW_API
int elbow_inverse_dynamics_batch(int n, const elbow_real *q_a, const elbow_real *v_a, const elbow_real *a_a,
    elbow_real *tau_a, elbow_real *work);
ELBOW_API int elbow_inverse_dynamics_work(void);
ELBOW_API int elbow_inverse_dynamics_batch_work(void); /* times the threads, with OpenMP */

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
 * 40 operations, the longest chain about 84 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
int elbow_inverse_dynamics_derivatives(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real dtau_dq[ELBOW_NA * ELBOW_NA],
    elbow_real dtau_dv[ELBOW_NA * ELBOW_NA], elbow_real dtau_da[ELBOW_NA * ELBOW_NA], elbow_real *work);
ELBOW_API
int elbow_inverse_dynamics_derivatives_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *a_a, elbow_real *dtau_dq, elbow_real *dtau_dv, elbow_real *dtau_da, elbow_real *work);
ELBOW_API int elbow_inverse_dynamics_derivatives_work(void);
ELBOW_API int elbow_inverse_dynamics_derivatives_batch_work(void); /* times the threads, with OpenMP */

/*
 * Accelerations of the arm under given forces on its coordinates, without rotors, friction and springs: the inverse of
 * inverse_dynamics.
 *
 *   a_a = M(q_a)^-1 (tau_a - c(q_a, v_a) - g(q_a))
 *
 *   in  q_a   n_a [rad]     arm coordinates in chain order
 *   in  v_a   n_a [rad/s]   arm velocities
 *   in  tau_a n_a [N m]     forces on the arm coordinates, arm side
 *   out a_a   n_a [rad/s^2] arm accelerations
 * 37 operations, the longest chain about 132 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
int elbow_arm_forward_dynamics(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real tau_a[ELBOW_NA], elbow_real a_a[ELBOW_NA], elbow_real *work);
ELBOW_API
int elbow_arm_forward_dynamics_batch(int n, const elbow_real *q_a, const elbow_real *v_a, const elbow_real *tau_a,
    elbow_real *a_a, elbow_real *work);
ELBOW_API int elbow_arm_forward_dynamics_work(void);
ELBOW_API int elbow_arm_forward_dynamics_batch_work(void); /* times the threads, with OpenMP */

/*
 * First derivatives of the arm's forward dynamics.
 *
 *   d a_a = da_dq d q_a + da_dv d v_a + da_dtau d tau_a,  da_dtau = M^-1
 *
 *   in  q_a     n_a       [rad]   arm coordinates in chain order
 *   in  v_a     n_a       [rad/s] arm velocities
 *   in  tau_a   n_a       [N m]   forces on the arm coordinates, arm side
 *   out da_dq   n_a x n_a [mixed] unit of the row's acceleration per unit of the column's coordinate
 *   out da_dv   n_a x n_a [mixed] unit of the row's acceleration per unit of the column's velocity
 *   out da_dtau n_a x n_a [mixed] inverse of the mass matrix, symmetric
 * 116 operations, the longest chain about 296 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
int elbow_arm_forward_derivatives(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real tau_a[ELBOW_NA], elbow_real da_dq[ELBOW_NA * ELBOW_NA], elbow_real da_dv[ELBOW_NA * ELBOW_NA],
    elbow_real da_dtau[ELBOW_NA * ELBOW_NA], elbow_real *work);
ELBOW_API
int elbow_arm_forward_derivatives_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *tau_a, elbow_real *da_dq, elbow_real *da_dv, elbow_real *da_dtau, elbow_real *work);
ELBOW_API int elbow_arm_forward_derivatives_work(void);
ELBOW_API int elbow_arm_forward_derivatives_batch_work(void); /* times the threads, with OpenMP */

/*
 * Accelerations of arm and motors under the motors' torques, with springs, dampers and friction. Entries of q_m and
 * v_m behind rigid gears are ignored; those of a_m are filled in.
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
 * 57 operations, the longest chain about 132 cycles; stack of one point at most 2048 bytes
 */
ELBOW_API
int elbow_forward_dynamics(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM],
    elbow_real a_a[ELBOW_NA], elbow_real a_m[ELBOW_NM], elbow_real *work);
ELBOW_API
int elbow_forward_dynamics_batch(int n, const elbow_real *q_a, const elbow_real *v_a, const elbow_real *q_m,
    const elbow_real *v_m, const elbow_real *tau_m, elbow_real *a_a, elbow_real *a_m, elbow_real *work);
ELBOW_API int elbow_forward_dynamics_work(void);
ELBOW_API int elbow_forward_dynamics_batch_work(void); /* times the threads, with OpenMP */

/*
 * Linearisation of the forward dynamics in the state x = (q_a, q_m, v_a, v_m), of the motors only those behind elastic
 * gears.
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
 * 183 operations, the longest chain about 376 cycles; stack of one point at most 2048 bytes
 */
ELBOW_API
int elbow_linearize(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA], const elbow_real q_m[ELBOW_NM],
    const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM], elbow_real A[ELBOW_NX * ELBOW_NX],
    elbow_real B[ELBOW_NX * ELBOW_NM], elbow_real *work);
ELBOW_API
int elbow_linearize_batch(int n, const elbow_real *q_a, const elbow_real *v_a, const elbow_real *q_m,
    const elbow_real *v_m, const elbow_real *tau_m, elbow_real *A, elbow_real *B, elbow_real *work);
ELBOW_API int elbow_linearize_work(void);
ELBOW_API int elbow_linearize_batch_work(void); /* times the threads, with OpenMP */

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
 * 23 operations, the longest chain about 76 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
int elbow_output_constraint(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real target[ELBOW_NT], elbow_real y_err[ELBOW_NY], elbow_real W[ELBOW_NY * ELBOW_NA],
    elbow_real Wdot_v[ELBOW_NY], elbow_real *work);
ELBOW_API
int elbow_output_constraint_batch(int n, const elbow_real *q_a, const elbow_real *v_a, const elbow_real *target,
    elbow_real *y_err, elbow_real *W, elbow_real *Wdot_v, elbow_real *work);
ELBOW_API int elbow_output_constraint_work(void);
ELBOW_API int elbow_output_constraint_batch_work(void); /* times the threads, with OpenMP */

/*
 * Torques of the gears for a given motion, and what is left of the equations of the coordinates without motor.
 *
 *   tau_g = [M a_a + c + g - f]_g,  row = [M a_a + c + g - f]_e - tau_e, f: the arm's frictions
 *
 *   in  q_a   n_a [rad]     arm coordinates in chain order
 *   in  v_a   n_a [rad/s]   arm velocities
 *   in  a_a   n_a [rad/s^2] arm accelerations
 *   out tau_g n_g [N m]     torques of the gears on the arm, arm side
 * 35 operations, the longest chain about 88 cycles; stack of one point at most 1792 bytes
 */
ELBOW_API
int elbow_inversion_rows(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real tau_g[ELBOW_NG], elbow_real *work);
ELBOW_API
int elbow_inversion_rows_batch(int n, const elbow_real *q_a, const elbow_real *v_a, const elbow_real *a_a,
    elbow_real *tau_g, elbow_real *work);
ELBOW_API int elbow_inversion_rows_work(void);
ELBOW_API int elbow_inversion_rows_batch_work(void); /* times the threads, with OpenMP */

/*
 * Torques of the gears' springs at given twists, and their slopes; zero for rigid gears.
 *
 *   tau_p = spring(twist),  dtau_p = d tau_p/d twist
 *
 *   in  twist  n_g [rad]   motors seen from the arm side, less the coordinates
 *   out tau_p  n_g [N m]   torques of the gears' springs, arm side
 *   out dtau_p n_g [mixed] unit of the torque per unit of the coordinate
 * 2 operations, the longest chain about 4 cycles; stack of one point at most 1280 bytes
 */
ELBOW_API
int elbow_gear_law(const elbow_real twist[ELBOW_NG], elbow_real tau_p[ELBOW_NG], elbow_real dtau_p[ELBOW_NG],
    elbow_real *work);
ELBOW_API
int elbow_gear_law_batch(int n, const elbow_real *twist, elbow_real *tau_p, elbow_real *dtau_p, elbow_real *work);
ELBOW_API int elbow_gear_law_work(void);
ELBOW_API int elbow_gear_law_batch_work(void); /* times the threads, with OpenMP */

/*
 * Friction torques of the motors.
 *
 *   f_m = f(v_m)
 *
 *   in  v_m n_m [rad/s] motor speeds, motor side
 *   out f_m n_m [N m]   friction torques, motor side
 * 0 operations, the longest chain about 0 cycles; stack of one point at most 1024 bytes
 */
ELBOW_API
int elbow_motor_friction(const elbow_real v_m[ELBOW_NM], elbow_real f_m[ELBOW_NM], elbow_real *work);
ELBOW_API
int elbow_motor_friction_batch(int n, const elbow_real *v_m, elbow_real *f_m, elbow_real *work);
ELBOW_API int elbow_motor_friction_work(void);
ELBOW_API int elbow_motor_friction_batch_work(void); /* times the threads, with OpenMP */

/*
 * Numbers that the workspace of invert must hold; -1 where the sizes are not allowed.
 *
 *   in n      [1] samples of the path, at least 2
 *   in lead   [1] samples of rest before the path
 *   in tail   [1] samples of rest after it
 *   in every  [1] samples per interval of the mesh
 */
ELBOW_API
int64_t elbow_invert_work(int n, int lead, int tail, int every);

/*
 * Inverse dynamics along a whole path: motion of arm and motors, and torques, that keep the output there.
 *
 * The output is at rest at the first sample and before it, and after the last one; the arm starts at rest, and moves
 * before the output does (lead) and after it (tail) where its zero dynamics ask for it. Without coordinates that have
 * no motor nothing is solved. OK means that the residual is within the tolerance, on the mesh and at the samples, and
 * that the motion at the samples is even: by differences positions, speeds and accelerations agree to 2 % of the
 * largest. Without coordinates that have no motor the residual is zero, and OK is no more than that. INEXACT: on the
 * mesh it is, the rest is not, as where the mesh is coarse, the path rough, or samples are too far apart or too close;
 * the report tells how much. Results of a negative status mean nothing. A path that does not begin and end at rest is
 * a BAD_ARGUMENT; UNREACHABLE may also mean that rest was not found from q_start. The matrices are stored sample after
 * sample: entry i of sample k is x[k * n_a + i]. Stack: at most 11264 bytes.
 *
 *   in  n                                 [1]     samples of the path, at least 2
 *   in  period                            [s]     from sample to sample
 *   in  place     n x n_t                 [mixed] output; for a pose position and rotation matrix by columns
 *   in  rate      n x n_y                 [mixed] its rate; for a pose linear and angular velocity, world axes
 *   in  rate2     n x n_y                 [mixed] its second derivative
 *   in  q_start   n_a                     [mixed] guess of the pose of rest at the first sample
 *   in  lead                              [1]     samples of rest before the path
 *   in  tail                              [1]     samples of rest after it
 *   in  every                             [1]     samples per interval of the mesh
 *   in  tolerance                         [1]     of the equations without motor, relative to their torques at rest
 *   out q_a       (lead + n + tail) x n_a [mixed] arm coordinates
 *   out v_a       (lead + n + tail) x n_a [mixed] arm velocities
 *   out a_a       (lead + n + tail) x n_a [mixed] arm accelerations
 *   out tau_g     (lead + n + tail) x n_g [mixed] torques of the gears, arm side
 *   out q_m       (lead + n + tail) x n_m [rad]   motor angles
 *   out v_m       (lead + n + tail) x n_m [rad/s] motor speeds
 *   out tau_m     (lead + n + tail) x n_m [N m]   motor torques
 *   out report    INVERT_REPORT           [1]     residual on the mesh and at the samples; steps; intervals; unevenness
 *   of the motion
 *       work      work_size                       workspace
 *   in  work_size                         [1]     its length, at least that of invert_work
 */
ELBOW_API
int elbow_invert(int n, elbow_real period, const elbow_real *place, const elbow_real *rate, const elbow_real *rate2,
    const elbow_real *q_start, int lead, int tail, int every, elbow_real tolerance, elbow_real *q_a,
    elbow_real *v_a, elbow_real *a_a, elbow_real *tau_g, elbow_real *q_m, elbow_real *v_m, elbow_real *tau_m,
    elbow_real *report, elbow_real *work, int64_t work_size);

/*
 * Numbers that the memory of a stream must hold; -1 where the sizes are not allowed.
 *
 *   in intervals  [1] of the horizon, 1 to 10000
 *   in parts      [1] samples of the results per interval, 1 to 1000
 */
ELBOW_API
int64_t elbow_stream_work(int intervals, int parts);

/*
 * Begin a stream, inverse dynamics on a moving horizon: at rest, with the output at a place and staying there.
 *
 * The memory holds all that the stream knows; it may be copied and moved between calls; every stream has its own. One
 * that has failed is started again. Stack: at most 11264 bytes.
 *
 *      stream      stream_size         memory of the stream
 *   in stream_size             [1]     its length, at least that of stream_work
 *   in intervals               [1]     of the horizon, 1 to 10000
 *   in parts                   [1]     samples of the results per interval, 1 to 1000
 *   in period                  [s]     from update to update: an interval
 *   in tolerance               [1]     of the equations without motor, relative to their torques at rest
 *   in place       n_t         [mixed] output at rest; for a pose position and rotation by columns
 *   in q_start     n_a         [mixed] guess of the pose of rest
 */
ELBOW_API
int elbow_stream_start(elbow_real *stream, int64_t stream_size, int intervals, int parts, elbow_real period,
    elbow_real tolerance, const elbow_real *place, const elbow_real *q_start);

/*
 * Take the next sample of the path, at the end of the horizon, and give motion and torques of the interval that begins
 * now.
 *
 * The output reaches the sample so many intervals later. One step of the solver, in bounded time. A sample that is
 * refused (INPUT_NOT_FINITE, BAD_ARGUMENT, UNREACHABLE) changes nothing; after any other negative status the stream
 * has failed, and NOT_STARTED follows. OK means that in this interval the residual is within the tolerance, and motors
 * move evenly: by differences of the samples positions, speeds and accelerations agree to 2 % of the largest of them
 * within about a horizon, and the torque goes on where the interval before left it, to 2e-4 of its largest. It says
 * nothing of intervals to come. INEXACT: the results are the best that one step found, or the path is rough there, or
 * the samples are too far apart or too close, or fewer than 7 of them lie in the horizon beyond this interval:
 * (intervals - 1) * parts < 7. INEXACT and LIMITED are positive and come with results: failures are `status < 0`. To
 * stop, update with the last place and zero rates until the results rest, at least so many times as the horizon has
 * intervals. A path that comes late or is refused is no such stop: without an update there are no further torques.
 * Stack: at most 11264 bytes.
 *
 *       stream stream_work           memory of the stream
 *   in  place  n_t           [mixed] output; for a pose position and rotation matrix by columns
 *   in  rate   n_y           [mixed] its rate; for a pose linear and angular velocity, world axes
 *   in  rate2  n_y           [mixed] its second derivative
 *   out q_a    parts x n_a   [mixed] arm coordinates
 *   out v_a    parts x n_a   [mixed] arm velocities
 *   out tau_g  parts x n_g   [mixed] torques of the gears, arm side
 *   out q_m    parts x n_m   [rad]   motor angles
 *   out v_m    parts x n_m   [rad/s] motor speeds
 *   out tau_m  parts x n_m   [N m]   motor torques
 *   out report STREAM_REPORT [1]     residual; unevenness; steps; intervals; distance [m] and angle [rad] off the path,
 *   where it is bent; 1 where that or a bound that is passed is LIMITED, whatever is returned, else 0
 */
ELBOW_API
int elbow_stream_update(elbow_real *stream, const elbow_real *place, const elbow_real *rate,
    const elbow_real *rate2, elbow_real *q_a, elbow_real *v_a, elbow_real *tau_g, elbow_real *q_m, elbow_real *v_m,
    elbow_real *tau_m, elbow_real *report);

/*
 * Let a stream keep bounds of its motors: where they would be passed, the path ahead is bent.
 *
 * From the next update on, in bounded time: a small quadratic program an update changes the path within the horizon,
 * as little as can be, and the inversion follows the changed path. While it does, and where a bound is passed, LIMITED
 * is returned, or INEXACT where that holds, too; the report tells both, and the deviation, which fades when the bounds
 * no longer bind. What cannot be kept is passed: the torques are to be compared with the bounds; where the path is
 * bent and one is passed by more than 2.5 times, the stream ends with LIMITS_LOST. The path is bent only where the
 * motion that is under way need not know of it yet, so many intervals ahead as the unstable zeros look, until a
 * thousandth of a change is felt; SHORT_HORIZON: fewer than 4 intervals, or less than half as many beyond. As many are
 * better, and time to brake in; bends are as quick as the horizon is short. Bounds may be changed at any time; an
 * infinite torque or speed is none. Stack: at most 11264 bytes.
 *
 *      stream     stream_work         memory of the stream
 *   in torque_max n_m         [N m]   of the motors, positive
 *   in speed_max  n_m         [rad/s] of the motors, positive
 *   in bend_max               [mixed] of the deviation of each output, m and rad; weighed like them
 */
ELBOW_API
int elbow_stream_limits(elbow_real *stream, const elbow_real *torque_max, const elbow_real *speed_max,
    elbow_real bend_max);

/* For who loads the library at run time: check these before the first call. */
ELBOW_API int elbow_abi_version(void);
ELBOW_API const char *elbow_digest(void); /* SHA-256 of the model */
ELBOW_API const char *elbow_interface(void); /* SHA-256 of names and shapes of the functions */
ELBOW_API int elbow_sizeof_real(void);
ELBOW_API int elbow_sizeof_int(void);
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
