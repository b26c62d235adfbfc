/*
 * elbow: one Gauss-Newton step of the inversion over a mesh, a linear-quadratic problem; private.
 *
 * The unknowns are the accelerations a_e at the Gauss points of each interval, the control of the
 * double integrator y = (q_e, v_e). The step d minimizes
 *
 *     sum |(R + R_q dq + R_v dv + R_a da) / s_r|^2 + w (|y + dy - y_ref|^2 / s_y^2 + |da|^2 /
 *       s_a^2),   dy_0 = 0,
 *
 * by a Riccati recursion with blocks of fixed size, w: the small `regularization`. y_ref is the
 * present y or, on a moving horizon, the quasi-static motion. The step is regular where R_a is
 * singular; of all motions with R = 0 it selects the bounded one.
 */
#ifndef ELBOW_LQ_STEP_H
#define ELBOW_LQ_STEP_H

#include "elbow_mesh.h"

/*
 * --- Sums of outer products of rows, where the elimination of lq spends its time.
 */

/* --- A Gauss-Newton step by a Riccati recursion. */

#endif
