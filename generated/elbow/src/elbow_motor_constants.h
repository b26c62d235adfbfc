/*
 * elbow: gears, motors and the kind of output, for the inversion; private. Written by flexgen; see elbow.h.
 */
#ifndef ELBOW_MOTOR_CONSTANTS_H
#define ELBOW_MOTOR_CONSTANTS_H

#include "elbow_private.h"

#define ELBOW_POSE 0 /* the output is a pose: position, then rotation */
#define ELBOW_PARAMETERS 0 /* run-time parameters, stored behind the workspace */
#define ELBOW_INVERSION_SPACE 896 /* reals of workspace for the functions below */
#define PARAMETERS_OF(space) ((space) + ELBOW_INVERSION_SPACE + BLOCK)

/* Indices of the coordinates with and without motor; q_m = eta q_g where no gear is deflected. */
static const int i_g[ELBOW_NG] = {0, 1};
static const int i_e[1] = {0};
static const int gear_is_rigid[ELBOW_NG] = {0, 0};
static const int gear_is_linear[ELBOW_NG] = {1, 1};
static const real gear_damping[ELBOW_NG] = {1400.0, 600.0}; /* arm side */
static inline real damping_of(int gear, const real *space)
{
    (void)space;
    return gear_damping[gear];
}
static const real eta[ELBOW_NM][ELBOW_NG] = {
    {267.42857142857144, 0.0},
    {0.0, 252.33333333333334}};
static const real eta_inverse[ELBOW_NG][ELBOW_NM] = {
    {0.003739316239316239, 0.0},
    {0.0, 0.003963011889035667}};
static const real rotor_inertia[ELBOW_NM] = {0.0118, 0.0118};
enum { STREAM_KEY = 942533 }; /* in the memory of its streams */
#define ELBOW_GROWS 1 /* the library has the function growth */
static const real arm_side[ELBOW_NX / 2] = {1.0, 1.0, 267.42857142857144, 252.33333333333334}; /* factors of the positions in a state */
#define ELBOW_LINEARIZE_SPACE 11392
#define evaluate_linearize(q_a, v_a, q_m, v_m, tau_m, A, B, parameters, work) ((void)(parameters), (void)(work), elbow_linearize(q_a, v_a, q_m, v_m, tau_m, A, B, work))

/* The functions that the inversion uses, with a workspace that some of them do not need. */
static const real no_parameters[1] = {0};
#define PARAMETERS_ARGUMENT
#define GIVEN_PARAMETERS no_parameters
#define PASSED_PARAMETERS
#define evaluate_output_constraint(q_a, v_a, target, y_err, W, Wdot_v, work) ((void)(work), elbow_output_constraint(q_a, v_a, target, y_err, W, Wdot_v))
#define evaluate_output_constraint_batch elbow_output_constraint_batch
#define evaluate_inversion_rows(q_a, v_a, a_a, tau_g, work) ((void)(work), elbow_inversion_rows(q_a, v_a, a_a, tau_g))
#define evaluate_inversion_rows_batch elbow_inversion_rows_batch
#define evaluate_gear_law(deflection, tau_p, dtau_p, work) ((void)(work), elbow_gear_law(deflection, tau_p, dtau_p))
#define evaluate_gear_law_batch elbow_gear_law_batch
#define evaluate_motor_friction(v_m, f_m, work) ((void)(work), elbow_motor_friction(v_m, f_m))
#define evaluate_motor_friction_batch elbow_motor_friction_batch

#endif
