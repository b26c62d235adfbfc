/*
 * elbow: the functions of elbow.h for many points, written by flexgen. Do not edit.
 *
 * <function>_batch evaluates n points. Arrays are structures of arrays: entry i of point k of an
 * array x is x[i * n + k]; entry (row, column) of a matrix with r rows is i = row + column * r.
 * All points are evaluated. The outputs of a point that fails are NaN, and the status of the first
 * such point is returned.
 *
 * <function>_batch_strided takes n of the points of larger arrays: entry i of point k is x[i *
 * stride + k]. Where the columns of large arrays are multiples of 1024 bytes apart, they meet in
 * the same places of the cache; a stride that is 8 larger avoids it. BAD_COUNT: the stride is
 * below n.
 *
 * The workspace has ELBOW_BATCH_WORK reals. With OpenMP each thread needs that many: allocate
 * elbow_batch_work() reals, and do not raise the number of threads after that. GCC and clang
 * compute several points at once in vector registers, with the same bits as one by one where
 * nothing is contracted.
 */
#ifndef ELBOW_BATCH_H
#define ELBOW_BATCH_H

#include "elbow.h"

#ifdef __cplusplus
extern "C" {
#endif

#define ELBOW_BATCH_WORK 11392 /* workspace in reals, per thread */

/* Workspace for the largest number of threads of the moment. */
ELBOW_API int elbow_batch_work(void);

/*
 * Position and rotation matrix of the tool in the world.
 */
ELBOW_API
elbow_status elbow_forward_kinematics_batch(int n, const elbow_real *q_a, elbow_real *p,
    elbow_real *R, elbow_real *work);
ELBOW_API
elbow_status elbow_forward_kinematics_batch_strided(int n, int stride, const elbow_real *q_a,
    elbow_real *p, elbow_real *R, elbow_real *work);

/*
 * Jacobian of the tool: its linear, then its angular velocity, in world axes.
 */
ELBOW_API
elbow_status elbow_jacobian_batch(int n, const elbow_real *q_a, elbow_real *J, elbow_real *work);
ELBOW_API
elbow_status elbow_jacobian_batch_strided(int n, int stride, const elbow_real *q_a,
    elbow_real *J, elbow_real *work);

/*
 * Mass matrix of the arm, without rotors.
 */
ELBOW_API
elbow_status elbow_mass_matrix_batch(int n, const elbow_real *q_a, elbow_real *M,
    elbow_real *work);
ELBOW_API
elbow_status elbow_mass_matrix_batch_strided(int n, int stride, const elbow_real *q_a,
    elbow_real *M, elbow_real *work);

/*
 * Coriolis, centripetal and gravity forces of the arm.
 */
ELBOW_API
elbow_status elbow_bias_batch(int n, const elbow_real *q_a, const elbow_real *v_a, elbow_real *h,
    elbow_real *work);
ELBOW_API
elbow_status elbow_bias_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, elbow_real *h, elbow_real *work);

/*
 * Gravity forces of the arm.
 */
ELBOW_API
elbow_status elbow_gravity_batch(int n, const elbow_real *q_a, elbow_real *g, elbow_real *work);
ELBOW_API
elbow_status elbow_gravity_batch_strided(int n, int stride, const elbow_real *q_a, elbow_real *g,
    elbow_real *work);

/*
 * Forces that the arm needs for a given motion, without friction and springs.
 */
ELBOW_API
elbow_status elbow_inverse_dynamics_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *a_a, elbow_real *tau_a, elbow_real *work);
ELBOW_API
elbow_status elbow_inverse_dynamics_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, elbow_real *tau_a, elbow_real *work);

/*
 * First derivatives of the inverse dynamics.
 */
ELBOW_API
elbow_status elbow_inverse_dynamics_derivatives_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, elbow_real *dtau_dq, elbow_real *dtau_dv,
    elbow_real *dtau_da, elbow_real *work);
ELBOW_API
elbow_status elbow_inverse_dynamics_derivatives_batch_strided(int n, int stride,
    const elbow_real *q_a, const elbow_real *v_a, const elbow_real *a_a, elbow_real *dtau_dq,
    elbow_real *dtau_dv, elbow_real *dtau_da, elbow_real *work);

/*
 * Accelerations of the arm under given forces on its coordinates, without rotors, friction and
 * springs: the inverse of inverse_dynamics.
 */
ELBOW_API
elbow_status elbow_arm_forward_dynamics_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *tau_a, elbow_real *a_a, elbow_real *work);
ELBOW_API
elbow_status elbow_arm_forward_dynamics_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *tau_a, elbow_real *a_a, elbow_real *work);

/*
 * First derivatives of the arm's forward dynamics.
 */
ELBOW_API
elbow_status elbow_arm_forward_derivatives_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *tau_a, elbow_real *da_dq, elbow_real *da_dv,
    elbow_real *da_dtau, elbow_real *work);
ELBOW_API
elbow_status elbow_arm_forward_derivatives_batch_strided(int n, int stride,
    const elbow_real *q_a, const elbow_real *v_a, const elbow_real *tau_a, elbow_real *da_dq,
    elbow_real *da_dv, elbow_real *da_dtau, elbow_real *work);

/*
 * Accelerations of arm and motors under the motors' torques, with springs, dampers and friction.
 * Entries of q_m and v_m behind rigid gears are ignored; those of a_m are filled in.
 */
ELBOW_API
elbow_status elbow_forward_dynamics_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m, elbow_real *a_a,
    elbow_real *a_m, elbow_real *work);
ELBOW_API
elbow_status elbow_forward_dynamics_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m,
    elbow_real *a_a, elbow_real *a_m, elbow_real *work);

/*
 * The same with a force and a torque on the tool, and the torques of the elastic gears; zero for
 * rigid gears.
 */
ELBOW_API
elbow_status elbow_forward_dynamics_tool_force_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m,
    const elbow_real *f_tool, elbow_real *a_a, elbow_real *a_m, elbow_real *tau_g,
    elbow_real *work);
ELBOW_API
elbow_status elbow_forward_dynamics_tool_force_batch_strided(int n, int stride,
    const elbow_real *q_a, const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m,
    const elbow_real *tau_m, const elbow_real *f_tool, elbow_real *a_a, elbow_real *a_m,
    elbow_real *tau_g, elbow_real *work);

/*
 * Velocity and acceleration of the tool, linear and angular, in world axes.
 */
ELBOW_API
elbow_status elbow_tool_motion_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *a_a, elbow_real *v_tool, elbow_real *a_tool, elbow_real *work);
ELBOW_API
elbow_status elbow_tool_motion_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, elbow_real *v_tool, elbow_real *a_tool,
    elbow_real *work);

/*
 * Linearization of the forward dynamics in the state x = (q_a, q_m, v_a, v_m), of the motors only
 * those behind elastic gears.
 */
ELBOW_API
elbow_status elbow_linearize_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m, elbow_real *A,
    elbow_real *B, elbow_real *work);
ELBOW_API
elbow_status elbow_linearize_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m,
    elbow_real *A, elbow_real *B, elbow_real *work);

/*
 * Acceleration and jerk of an arm with elastic joints from its state, without damping of the
 * gears.
 */
ELBOW_API
elbow_status elbow_flexible_joint_motion_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, elbow_real *a_a,
    elbow_real *j_a, elbow_real *work);
ELBOW_API
elbow_status elbow_flexible_joint_motion_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, elbow_real *a_a,
    elbow_real *j_a, elbow_real *work);

/*
 * Torques of the motors that give an arm with elastic joints a fourth derivative of its
 * coordinates, without damping of the gears.
 */
ELBOW_API
elbow_status elbow_flexible_joint_torque_batch(int n, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, const elbow_real *j_a, const elbow_real *s_a,
    const elbow_real *q_m, const elbow_real *v_m, elbow_real *tau_m, elbow_real *work);
ELBOW_API
elbow_status elbow_flexible_joint_torque_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, const elbow_real *j_a, const elbow_real *s_a,
    const elbow_real *q_m, const elbow_real *v_m, elbow_real *tau_m, elbow_real *work);

/*
 * How far the output is from a target, and the map W from speeds to rates of the output.
 */
ELBOW_API
elbow_status elbow_output_constraint_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *target, elbow_real *y_err, elbow_real *W, elbow_real *Wdot_v,
    elbow_real *work);
ELBOW_API
elbow_status elbow_output_constraint_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *target, elbow_real *y_err, elbow_real *W,
    elbow_real *Wdot_v, elbow_real *work);

/*
 * Torques of the gears for a given motion, and the remainder of the equations of the coordinates
 * without motor.
 */
ELBOW_API
elbow_status elbow_inversion_rows_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *a_a, elbow_real *tau_g, elbow_real *work);
ELBOW_API
elbow_status elbow_inversion_rows_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, elbow_real *tau_g, elbow_real *work);

/*
 * Torques of the gears' springs at given deflections, and their derivatives; zero for rigid gears.
 */
ELBOW_API
elbow_status elbow_gear_law_batch(int n, const elbow_real *deflection, elbow_real *tau_p,
    elbow_real *dtau_p, elbow_real *work);
ELBOW_API
elbow_status elbow_gear_law_batch_strided(int n, int stride, const elbow_real *deflection,
    elbow_real *tau_p, elbow_real *dtau_p, elbow_real *work);

/*
 * Friction torques of the motors.
 */
ELBOW_API
elbow_status elbow_motor_friction_batch(int n, const elbow_real *v_m, elbow_real *f_m,
    elbow_real *work);
ELBOW_API
elbow_status elbow_motor_friction_batch_strided(int n, int stride, const elbow_real *v_m,
    elbow_real *f_m, elbow_real *work);

#ifdef __cplusplus
}
#endif

#endif
