/*
 * model: the arm with its output on the path: kinematics, and the reduced problem; private.
 *
 * The output is prescribed, y(q_a) = Z(t), so that the actuated coordinates q_g follow from the
 * others and only n_e equations remain,
 *
 *     R(q_e, v_e, a_e, t) = [M a + c + g]_e - tau_e = 0.
 *
 * POINTS instants are evaluated together; entry i of point l of an array is [i][l], matrices are
 * stored by columns.
 */
#ifndef MODEL_REDUCED_PROBLEM_H
#define MODEL_REDUCED_PROBLEM_H

#include "model_inversion_common.h"

enum { KINEMATIC_STEPS = 25, INVERSE_STEPS = 3 };

/* relative error of an inverse before a step that squares it */
static const real accurate_inverse = PRECISE(1e-6, 1e-3);
/*
 * steps of the joints [rad or m]: after one below the first the inverse of the output Jacobian is
 * nearly right, after one below the second the position is known to rounding
 */
static const real step_near = PRECISE(1e-5, 1e-3), step_exact = PRECISE(1e-6, 1e-5);
/* [rad or m] a guess further from the position before is none */
static const real guess_max = 0.2;
/* errors of velocities [rad/s or m/s] and accelerations [rad/s^2 or m/s^2] that are rounding */
static const real exact = PRECISE(1e-11, 1e-6), exact_acceleration = PRECISE(1e-10, 1e-5);

typedef real points[POINTS];

/* Over all points, a vector at a time. */
#define EACH(l) for (int l = 0; l < POINTS; l += LANES)

/* POINTS instants of the arm on its path. */
typedef struct {
    points q[NA], v[NA], a[NA];
    points target[NT], dy[NY], ddy[NY];
    points error[NY], W[NA][NY], bias[NY];
    points inverse[NY][NG]; /* of the columns of W that belong to q_g */
    /* sign of their determinant: on either side of singular poses, 1 or -1 */
    points side;
    points tau_g[NG];
#if MODEL_FORCE
    points force[NY]; /* on the output, dual to dy */
#endif                /* MODEL_FORCE */
#if MODEL_NE > 0
    points row[NE], row_q[NA][NE], row_v[NA][NE], row_a[NA][NE];
    points y1_q[NA][NY], y2_q[NA][NY], y2_v[NA][NY];
    points S[NE][NG], Vq[NE][NG], Aq[NE][NG], Av[NE][NG], T[NE][NY];
    points K[NE][NE], D[NE][NE], A[NE][NE]; /* [column][row] */
#endif
    points known; /* the first: whether `inverse` is that of positions which may be near */
} problem_points;

/* Copy the path at one instant into point l. */
static inline void load_reference(problem_points *arm, int l, const real *reference)
{
    for (int i = 0; i < NT; ++i) {
        arm->target[i][l] = reference[i];
    }
    for (int i = 0; i < NY; ++i) {
        arm->dy[i][l] = reference[NT + i];
        arm->ddy[i][l] = reference[NT + NY + i];
#if MODEL_FORCE
        arm->force[i][l] = reference[NT + 2 * NY + i];
#endif /* MODEL_FORCE */
    }
}

/* Before the first use of the points in a call: no inverse is known. */
static inline void begin_points(problem_points *p)
{
    p->known[0] = 0.0;
}

/*
 * A quintic through the motion of the joints at two instants, from which later positions are
 * guessed.
 */
typedef struct {
    real c[6][NG];  /* coefficients of the powers of x = (time - at) / apart */
    real at, apart; /* [s] the later instant, and the time between both */
} joint_motion;

/* At rest, since ever. */
static inline void joints_at_rest(const real *q, joint_motion *joints)
{
    joints->at = 0.0;
    joints->apart = 1.0;
    for (int i = 0; i < NG; ++i) {
        joints->c[0][i] = q[i];
        for (int k = 1; k < 6; ++k) {
            joints->c[k][i] = 0.0;
        }
    }
}

/*
 * Through the motion of points 0 and `last`, which are `apart` seconds apart; at: the time of the
 * second.
 */
static inline void keep_joints(
    const problem_points *arm, int last, real at, real apart, joint_motion *joints)
{
    joints->at = at;
    joints->apart = apart;
    for (int i = 0; i < NG; ++i) {
        const real *q = arm->q[i_g[i]], *v = arm->v[i_g[i]], *a = arm->a[i_g[i]];
        const real once = apart * v[last], twice = 0.5 * apart * apart * a[last];
        /* of the lower terms at the first point */
        const real miss_q = q[last] - q[0] - once + twice;
        const real miss_v = once - apart * v[0] - 2.0 * twice,
                   miss_a = twice - 0.5 * apart * apart * a[0];
        joints->c[0][i] = q[last];
        joints->c[1][i] = once;
        joints->c[2][i] = twice;
        joints->c[3][i] = 10.0 * miss_q + 4.0 * miss_v - miss_a;
        joints->c[4][i] = 15.0 * miss_q + 7.0 * miss_v - 2.0 * miss_a;
        joints->c[5][i] = 6.0 * miss_q + 3.0 * miss_v - miss_a;
    }
}

/* A guess of the joints into point l; `solve_kinematics` finds them and their derivatives. */
static inline void load_joints(problem_points *arm, int l, const real *joints)
{
    for (int i = 0; i < NG; ++i) {
        arm->q[i_g[i]][l] = joints[i];
        arm->v[i_g[i]][l] = 0.0;
        arm->a[i_g[i]][l] = 0.0;
    }
}

/* The same into all points from the quintic through earlier ones; not far beyond it. */
static inline void load_later_joints(
    problem_points *arm, const joint_motion *joints, const real *time)
{
    EACH (l) {
        const lanes x = fmin_v((load_v(time + l) - joints->at) / joints->apart, splat_v(2.0));
        for (int i = 0; i < NG; ++i) {
            lanes q = splat_v(joints->c[5][i]);
            for (int k = 4; k >= 0; --k) {
                q = q * x + joints->c[k][i];
            }
            q = select_v(lt_v(fabs_v(q - joints->c[0][i]), splat_v(guess_max)), q,
                splat_v(joints->c[0][i]));
            store_v(&arm->q[i_g[i]][l], q);
            store_v(&arm->v[i_g[i]][l], splat_v(0.0));
            store_v(&arm->a[i_g[i]][l], splat_v(0.0));
        }
    }
}

#if MODEL_NE > 0
/* Unactuated coordinates, velocities and accelerations into point l. */
static inline void load_elastic(
    problem_points *arm, int l, const real *q, const real *v, const real *a)
{
    for (int i = 0; i < NE; ++i) {
        arm->q[i_e[i]][l] = q[i];
        arm->v[i_e[i]][l] = v[i];
        arm->a[i_e[i]][l] = a[i];
    }
}
#endif

/*
 * Inverse of the actuated columns of W by Gauss and Jordan, with row pivoting in each point; 0
 * where a pivot is zero to rounding.
 */
static inline int invert_points(problem_points *p)
{
    lanes bad = splat_v(0.0);
    EACH (l) {
        lanes a[NY][2 * NY], side = splat_v(1.0);
        for (int i = 0; i < NY; ++i) {
            for (int j = 0; j < NY; ++j) {
                a[i][j] = load_v(&p->W[i_g[j]][i][l]);
                a[i][NY + j] = splat_v(i == j ? 1.0 : 0.0);
            }
        }
        for (int k = 0; k < NY; ++k) {
            lanes pivot;
            for (int i = k + 1; i < NY; ++i) {
                const lanes larger = lt_v(fabs_v(a[k][k]), fabs_v(a[i][k]));
                side *= splat_v(1.0) - 2.0 * larger;
                for (int j = k; j < 2 * NY; ++j) {
                    const lanes x = a[k][j], y = a[i][j];
                    a[k][j] = select_v(larger, y, x);
                    a[i][j] = select_v(larger, x, y);
                }
            }
            /*
             * m and rad: a pose where a radian moves the output by less than a nanometer (in
             * single precision a micrometer) is singular; so is NaN
             */
            bad += not_v(lt_v(splat_v(PRECISE(1e-9, 1e-6)), fabs_v(a[k][k])));
            side *= splat_v(1.0) - 2.0 * lt_v(a[k][k], splat_v(0.0));
            pivot = splat_v(1.0) / a[k][k];
            for (int j = k + 1; j < 2 * NY; ++j) {
                a[k][j] *= pivot;
            }
            for (int i = 0; i < NY; ++i) {
                const lanes f = a[i][k];
                if (i == k) {
                    continue;
                }
                for (int j = k + 1; j < 2 * NY; ++j) {
                    a[i][j] -= f * a[k][j];
                }
            }
        }
        for (int i = 0; i < NG; ++i) {
            for (int j = 0; j < NY; ++j) {
                store_v(&p->inverse[j][i][l], a[i][NY + j]);
            }
        }
        store_v(&p->side[l], side);
    }
    return sum_v(bad) == 0.0;
}

/* Error of the output, with W and the part of its acceleration that depends on velocities. */
static inline void evaluate_constraint(problem_points *p, real *space)
{
    (void)evaluate_output_constraint_batch(POINTS, &p->q[0][0], &p->v[0][0], &p->target[0][0],
        &p->error[0][0], &p->W[0][0][0], &p->bias[0][0], space);
}

/* One Newton step of the actuated coordinates towards the target; the largest change. */
static inline real newton_step(problem_points *p)
{
    lanes most = splat_v(0.0), zero = splat_v(0.0);
    for (int i = 0; i < NG; ++i) {
        EACH (l) {
            lanes sum = splat_v(0.0);
            for (int j = 0; j < NY; ++j) {
                sum += load_v(&p->inverse[j][i][l]) * load_v(&p->error[j][l]);
            }
            store_v(&p->q[i_g[i]][l], load_v(&p->q[i_g[i]][l]) - sum);
            most = fmax_v(most, fabs_v(sum));
            zero += 0.0 * sum; /* a maximum overlooks NaN */
        }
    }
    return largest_lane(most) + sum_lanes(zero);
}

/* Whether the output is at its target, up to rounding. */
static inline int is_on_target(const problem_points *p)
{
    const real error = largest(&p->error[0][0], NY * POINTS), rounding = PRECISE(1e-9, 3e-6);
    return error <= rounding || error <= rounding * (1.0 + largest(&p->target[0][0], NT * POINTS));
}

/*
 * One step of Newton and Schulz, X (2 - W X), for the inverse X of the actuated columns of W:
 * where X belongs to a position near the present one, its relative error 1 - W X is squared.
 * Returned: the norm of this error before the step. Where it is below 1, the determinants have the
 * same sign at both positions.
 */
static inline real refine_inverse(problem_points *p)
{
    lanes most = splat_v(0.0);
    EACH (l) {
        lanes W[NY][NG], X[NG][NY], sums[NY];
        for (int i = 0; i < NY; ++i) {
            sums[i] = splat_v(0.0);
            for (int j = 0; j < NG; ++j) {
                W[i][j] = load_v(&p->W[i_g[j]][i][l]);
                X[j][i] = load_v(&p->inverse[i][j][l]);
            }
        }
        for (int j = 0; j < NY; ++j) { /* column by column */
            lanes miss[NY];
            for (int i = 0; i < NY; ++i) {
                miss[i] = splat_v(i == j ? 1.0 : 0.0);
                for (int k = 0; k < NG; ++k) {
                    miss[i] -= W[i][k] * X[k][j];
                }
                sums[i] += fabs_v(miss[i]);
            }
            for (int i = 0; i < NG; ++i) {
                lanes sum = X[i][j];
                for (int k = 0; k < NY; ++k) {
                    sum += X[i][k] * miss[k];
                }
                store_v(&p->inverse[j][i][l], sum);
            }
        }
        for (int i = 0; i < NY; ++i) { /* NaN is as bad as a large error */
            most = select_v(lt_v(sums[i], splat_v(1e3)), fmax_v(most, sums[i]), splat_v(1e3));
        }
    }
    return largest_lane(most);
}

/*
 * The inverse of the actuated columns of W, from that of the positions before where these are
 * near; 0 as above.
 */
static inline int update_inverse(problem_points *p)
{
    if (p->known[0] > 0.0) {
        for (int step = 0; step < INVERSE_STEPS; ++step) {
            const real miss = refine_inverse(p);
            if (miss < accurate_inverse) {
                return 1;
            }
            if (!(miss < 0.1)) {
                break;
            }
        }
    }
    p->known[0] = invert_points(p) ? 1.0 : 0.0;
    return p->known[0] > 0.0;
}

/*
 * Add what velocities (or, with the bias, accelerations) of all coordinates lack to those of the
 * path, times the inverse; the largest change.
 */
static inline real correct_motion(problem_points *p, points *wanted, points *bias, points *motion)
{
    points rest[NY];
    lanes most = splat_v(0.0), zero = splat_v(0.0);
    for (int j = 0; j < NY; ++j) {
        EACH (l) {
            lanes sum = load_v(&wanted[j][l]);
            if (bias != NULL) {
                sum -= load_v(&bias[j][l]);
            }
            for (int i = 0; i < NA; ++i) {
                sum -= load_v(&p->W[i][j][l]) * load_v(&motion[i][l]);
            }
            store_v(&rest[j][l], sum);
        }
    }
    for (int i = 0; i < NG; ++i) {
        EACH (l) {
            lanes sum = splat_v(0.0);
            for (int j = 0; j < NY; ++j) {
                sum += load_v(&p->inverse[j][i][l]) * load_v(&rest[j][l]);
            }
            store_v(&motion[i_g[i]][l], load_v(&motion[i_g[i]][l]) + sum);
            most = fmax_v(most, fabs_v(sum));
            zero += 0.0 * sum;
        }
    }
    return largest_lane(most) + sum_lanes(zero);
}

/* The largest velocity of an unactuated coordinate. */
static inline real fastest_elastic(const problem_points *p)
{
    lanes most = splat_v(0.0);
#if MODEL_NE > 0
    for (int i = 0; i < NE; ++i) {
        EACH (l) {
            most = fmax_v(most, fabs_v(load_v(&p->v[i_e[i]][l])));
        }
    }
#else
    (void)p;
#endif
    return largest_lane(most);
}

/* The largest velocity and acceleration of a coordinate; they are finite. */
static inline void largest_motion(const problem_points *p, real *velocity, real *acceleration)
{
    lanes v = splat_v(0.0), a = splat_v(0.0);
    for (int i = 0; i < NA; ++i) {
        EACH (l) {
            v = fmax_v(v, fabs_v(load_v(&p->v[i][l])));
            a = fmax_v(a, fabs_v(load_v(&p->a[i][l])));
        }
    }
    *velocity = largest_lane(v);
    *acceleration = largest_lane(a);
}

/* Velocities and accelerations at a known position, which the last step has changed by `most`. */
static inline int solve_motion(problem_points *p, real most, real *space)
{
    real faster;
    (void)correct_motion(p, p->dy, NULL, p->v);
    evaluate_constraint(p, space);
    if (!is_on_target(p)) {
        return MODEL_UNREACHABLE;
    }
    if (most > exact) {
        (void)refine_inverse(p);
    }
    faster = correct_motion(p, p->dy, NULL, p->v);
    if (faster * (faster + largest(&p->v[0][0], NA * POINTS)) > exact_acceleration) {
        evaluate_constraint(p, space); /* the bias */
    }
    (void)correct_motion(p, p->ddy, p->bias, p->a);
    return MODEL_OK;
}

/*
 * The actuated coordinates that bring the output to its target, with their derivatives, for given
 * unactuated ones. Newton's method; close to the target the inverse of W is refined instead of
 * computed again.
 */
static inline int solve_kinematics(problem_points *p, real *space)
{
    real most, speed;
    int step = 0, near;
    speed = fmax_1(largest(&p->dy[0][0], NY * POINTS), fastest_elastic(p));
    evaluate_constraint(p, space);
    do {
        /* rad and m: beyond it a step leads astray */
        const real bound = 2.0 + 2.0 * largest(&p->error[0][0], NY * POINTS);
        if (!update_inverse(p)) {
            return MODEL_UNREACHABLE;
        }
        most = newton_step(p);
        if (!(most < bound) || ++step > KINEMATIC_STEPS) {
            return MODEL_UNREACHABLE;
        }
        near = most <= step_near;
        if (!near || most > step_exact || most * speed > exact) {
            evaluate_constraint(p, space);
        }
    } while (!near);
    if (most > step_exact ||
        most * speed >
            exact) { /* the inverse is off by about `most`, the position by its square */
        if (!update_inverse(p)) {
            return MODEL_UNREACHABLE;
        }
        most = newton_step(p);
        if (most * speed > exact) {
            evaluate_constraint(p, space);
        }
    }
    return solve_motion(p, most, space);
}

/*
 * The same from a guess of the joints with velocities and accelerations. Where it is so close that
 * the errors of the output which are left are rounding, one evaluation is enough: they are
 * products of the changes with each other or with the error of the inverse.
 */
MODEL_INLINE int improve_kinematics(problem_points *p, real *space)
{
    real miss = 1.0, most, faster, harder, speed = 0.0, acceleration = 0.0;
    if (p->known[0] > 0.0) {
        evaluate_constraint(p, space);
        miss = refine_inverse(p);
        miss *= miss; /* of the refined one */
        if (miss > accurate_inverse && miss < 0.01) {
            miss = refine_inverse(p);
            miss *= miss;
        }
    }
    if (!(miss <= accurate_inverse)) {
        begin_points(p);
        return solve_kinematics(p, space);
    }
    most = newton_step(p);
    if (!(most <= step_exact)) {
        return solve_kinematics(p, space);
    }
    faster = correct_motion(p, p->dy, NULL, p->v);
    harder = correct_motion(p, p->ddy, p->bias, p->a);
    largest_motion(p, &speed, &acceleration);
    if (most * speed <= exact && miss * faster <= exact &&
        faster * (faster + speed) <= exact_acceleration &&
        most * acceleration <= exact_acceleration && miss * harder <= exact_acceleration) {
        return MODEL_OK;
    }
    return solve_motion(p, most, space);
}

/*
 * The same from a guess of the joints by their earlier motion; where Newton's method fails from
 * it, from the positions before.
 */
static inline int follow_kinematics(
    problem_points *p, const joint_motion *joints, const real *time, real *space)
{
    int status;
    load_later_joints(p, joints, time);
    status = solve_kinematics(p, space);
    if (status != MODEL_OK) {
        for (int l = 0; l < POINTS; ++l) {
            load_joints(p, l, joints->c[0]);
        }
        begin_points(p);
        status = solve_kinematics(p, space);
    }
    return status;
}

#if MODEL_FORCE
#if MODEL_NE > 0
/*
 * Take d(W' F)/dq off the derivatives of the rows without motor. Of a pose, with the columns (v,
 * w) of W in the order of a chain, dv_i/dq_j = w_a x v_b, a = min(i, j), b = max(i, j), and
 * dw_i/dq_j = w_j x w_i for j < i, else 0. Of other outputs it is left out: Newton's method needs
 * no exact derivatives, and a force is small against the stiffness.
 */
static inline void take_force_stiffness(problem_points *p)
{
#if MODEL_POSE
    EACH (l) {
        lanes F[6], turned[NA][3], twisted[NA][3];
        for (int k = 0; k < 6; ++k) {
            F[k] = load_v(&p->force[k < 3 ? k : PLACES - 3 + k][l]);
        }
        for (int i = 0; i < NA; ++i) {
            for (int k = 0; k < 3; ++k) { /* F x w and M x w */
                const int m = (k + 1) % 3, n = (k + 2) % 3;
                const lanes w_m = load_v(&p->W[i][PLACES + m][l]),
                            w_n = load_v(&p->W[i][PLACES + n][l]);
                turned[i][k] = F[m] * w_n - F[n] * w_m;
                twisted[i][k] = F[3 + m] * w_n - F[3 + n] * w_m;
            }
        }
        for (int i = 0; i < NE; ++i) {
            for (int j = 0; j < NA; ++j) {
                const int a = j < i_e[i] ? j : i_e[i], b = j < i_e[i] ? i_e[i] : j;
                lanes sum = load_v(&p->row_q[j][i][l]);
                for (int k = 0; k < 3; ++k) {
                    sum -= turned[a][k] * load_v(&p->W[b][k][l]);
                    if (j < i_e[i]) {
                        sum -= twisted[j][k] * load_v(&p->W[b][PLACES + k][l]);
                    }
                }
                store_v(&p->row_q[j][i][l], sum);
            }
        }
    }
#else
    (void)p;
#endif
}

#endif
/* Take W' F off the rows `of` the coordinates with these indices, n of them. */
static inline void take_force(const problem_points *p, points *rows, const int *of, int n)
{
    for (int i = 0; i < n; ++i) {
        EACH (l) {
            lanes sum = load_v(&rows[i][l]);
            for (int j = 0; j < NY; ++j) {
                sum -= load_v(&p->W[of[i]][j][l]) * load_v(&p->force[j][l]);
            }
            store_v(&rows[i][l], sum);
        }
    }
}

/* The force at rest on all points. */
static inline void load_force(problem_points *arm, const real *space)
{
    for (int i = 0; i < NY; ++i) {
        EACH (l) {
            store_v(&arm->force[i][l], splat_v(FORCE_OF(space)[i]));
        }
    }
}

#endif /* MODEL_FORCE */
/* Gear torques and residuals of POINTS instants whose motion is known. */
static inline int evaluate_rows(problem_points *arm, real *space)
{
#if MODEL_FORCE
#if MODEL_NE > 0
    const int status = evaluate_inversion_rows_batch(POINTS, &arm->q[0][0], &arm->v[0][0],
        &arm->a[0][0], &arm->tau_g[0][0], &arm->row[0][0], space);
    take_force(arm, arm->row, i_e, NE);
#else
    const int status = evaluate_inversion_rows_batch(
        POINTS, &arm->q[0][0], &arm->v[0][0], &arm->a[0][0], &arm->tau_g[0][0], space);
#endif
    take_force(arm, arm->tau_g, i_g, NG);
    return inner_status(status);
#else /* MODEL_FORCE */
#if MODEL_NE > 0
    return inner_status(evaluate_inversion_rows_batch(POINTS, &arm->q[0][0], &arm->v[0][0],
        &arm->a[0][0], &arm->tau_g[0][0], &arm->row[0][0], space));
#else
    return inner_status(evaluate_inversion_rows_batch(
        POINTS, &arm->q[0][0], &arm->v[0][0], &arm->a[0][0], &arm->tau_g[0][0], space));
#endif
#endif /* MODEL_FORCE */
}

/* The same for a known motion of the unactuated coordinates. */
static inline int evaluate_torques(problem_points *arm, real *space)
{
    const int status = solve_kinematics(arm, space);
    return status == MODEL_OK ? evaluate_rows(arm, space) : status;
}

#if MODEL_NE > 0

/* to[j] = - inverse * from[j] for all columns. */
static inline void solve_columns(const problem_points *p, points (*from)[NY], points (*to)[NG])
{
    EACH (l) {
        lanes inverse[NG][NY]; /* together, as it is needed below */
        for (int i = 0; i < NG; ++i) {
            for (int k = 0; k < NY; ++k) {
                inverse[i][k] = load_v(&p->inverse[k][i][l]);
            }
        }
        for (int j = 0; j < NE; ++j) {
            for (int i = 0; i < NG; ++i) {
                lanes sum = splat_v(0.0);
                for (int k = 0; k < NY; ++k) {
                    sum -= inverse[i][k] * load_v(&from[j][k][l]);
                }
                store_v(&to[j][i][l], sum);
            }
        }
    }
}

/* T += X restricted to the actuated columns, times Y. */
static inline void add_actuated(points (*X)[NY], points (*Y)[NG], points (*T)[NY])
{
    EACH (l) {
        lanes columns[NY][NG];
        for (int i = 0; i < NY; ++i) {
            for (int k = 0; k < NG; ++k) {
                columns[i][k] = load_v(&X[i_g[k]][i][l]);
            }
        }
        for (int j = 0; j < NE; ++j) {
            for (int i = 0; i < NY; ++i) {
                lanes sum = load_v(&T[j][i][l]);
                for (int k = 0; k < NG; ++k) {
                    sum += columns[i][k] * load_v(&Y[j][k][l]);
                }
                store_v(&T[j][i][l], sum);
            }
        }
    }
}

/* The columns of X that belong to q_e. */
static inline void elastic_columns(points (*X)[NY], points (*T)[NY])
{
    for (int j = 0; j < NE; ++j) {
        for (int i = 0; i < NY; ++i) {
            EACH (l) {
                store_v(&T[j][i][l], load_v(&X[i_e[j]][i][l]));
            }
        }
    }
}

/*
 * Residual of the unactuated rows and their Jacobians K, D, A with respect to q_e, v_e, a_e on the
 * path.
 */
static inline int reduced_jacobians(problem_points *p, real *space)
{
    const int status = evaluate_inversion_jacobians_batch(POINTS, &p->q[0][0], &p->v[0][0],
        &p->a[0][0], &p->y1_q[0][0][0], &p->y2_q[0][0][0], &p->y2_v[0][0][0], &p->row[0][0],
        &p->row_q[0][0][0], &p->row_v[0][0][0], &p->row_a[0][0][0], space);
    if (status != MODEL_OK) {
        return inner_status(status);
    }
#if MODEL_FORCE
    take_force(p, p->row, i_e, NE);
    take_force_stiffness(p);
#endif /* MODEL_FORCE */
    elastic_columns(p->W, p->T);
    solve_columns(p, p->T, p->S);
    elastic_columns(p->y1_q, p->T);
    add_actuated(p->y1_q, p->S, p->T);
    solve_columns(p, p->T, p->Vq);
    elastic_columns(p->y2_q, p->T);
    add_actuated(p->y2_q, p->S, p->T);
    add_actuated(p->y2_v, p->Vq, p->T);
    solve_columns(p, p->T, p->Aq);
    elastic_columns(p->y2_v, p->T);
    add_actuated(p->y2_v, p->S, p->T);
    solve_columns(p, p->T, p->Av);
    EACH (l) {
        lanes q[NE][NG], v[NE][NG], a[NE][NG]; /* together, as they are needed below */
        for (int i = 0; i < NE; ++i) {
            for (int k = 0; k < NG; ++k) {
                q[i][k] = load_v(&p->row_q[i_g[k]][i][l]);
                v[i][k] = load_v(&p->row_v[i_g[k]][i][l]);
                a[i][k] = load_v(&p->row_a[i_g[k]][i][l]);
            }
        }
        for (int j = 0; j < NE; ++j) {
            for (int i = 0; i < NE; ++i) {
                lanes K = load_v(&p->row_q[i_e[j]][i][l]), D = load_v(&p->row_v[i_e[j]][i][l]);
                lanes A = load_v(&p->row_a[i_e[j]][i][l]);
                for (int k = 0; k < NG; ++k) {
                    const lanes S = load_v(&p->S[j][k][l]);
                    K += q[i][k] * S + v[i][k] * load_v(&p->Vq[j][k][l]) +
                         a[i][k] * load_v(&p->Aq[j][k][l]);
                    D += v[i][k] * S + a[i][k] * load_v(&p->Av[j][k][l]);
                    A += a[i][k] * S;
                }
                store_v(&p->K[j][i][l], K);
                store_v(&p->D[j][i][l], D);
                store_v(&p->A[j][i][l], A);
            }
        }
    }
    return MODEL_OK;
}

#endif

/* --- Equilibrium with the output at a target: springs and gravity in balance. */

enum { EQUILIBRIUM_STEPS = 60 };

/*
 * x = M^-1 b by elimination with row pivoting, rows of M scaled to one; 0 where a pivot is
 * rounding.
 */
static inline int solve_square(real (*M)[NA], real *b, real *x)
{
    for (int i = 0; i < NA; ++i) {
        const real size = largest(M[i], NA);
        if (!(size > 0.0)) {
            return 0;
        }
        for (int j = 0; j < NA; ++j) {
            M[i][j] /= size;
        }
        b[i] /= size;
    }
    for (int k = 0; k < NA; ++k) {
        const int best = pivot_row(&M[0][0], NA, NA, k);
        if (!(fabs_1(M[best][k]) > PRECISE(1e-12, 1e-6))) {
            return 0;
        }
        swap_rows(M[k], M[best], NA);
        swap_rows(b + k, b + best, 1);
        for (int i = k + 1; i < NA; ++i) {
            const real f = M[i][k] / M[k][k];
            for (int j = k + 1; j < NA; ++j) {
                M[i][j] -= f * M[k][j];
            }
            b[i] -= f * b[k];
        }
    }
    for (int k = NA - 1; k >= 0; --k) {
        for (int j = k + 1; j < NA; ++j) {
            b[k] -= M[k][j] * x[j];
        }
        x[k] = b[k] / M[k][k];
    }
    return is_finite(x, NA);
}

/*
 * Whether the actuated columns of W can be inverted: if so it is the springs that do not carry the
 * arm.
 */
static inline int can_move(const real *W, real (*M)[NA], real *b, real *x)
{
    for (int i = 0; i < NA; ++i) {
        b[i] = 0.0;
        for (int j = 0; j < NA; ++j) {
            M[i][j] = i < NY && j < NG ? W[i_g[j] * NY + i] : i == j ? 1.0 : 0.0;
        }
    }
    return solve_square(M, b, x);
}

/*
 * Newton's method for the equilibrium at a target, from a guess q. scale: the torque of each
 * unactuated row for a deflection of 0.01 rad or 0.01 m.
 */
static inline int equilibrium_at(const real *target, real *q, real *scale, real *space)
{
    static const real zero[NA] = {0.0};
    /* matrices of the library by columns */
    real error[NY], W[NA * NY], bias[NY], M[NA][NA], b[NA], x[NA];
#if MODEL_NE > 0
    real y1_q[NA * NY], y2_q[NA * NY], y2_v[NA * NY], row[NE], row_q[NA * NE], row_v[NA * NE],
        row_a[NA * NE];
#endif
    real before = -1.0;
    for (int step = 0; step < EQUILIBRIUM_STEPS; ++step) {
        real most;
        int status = evaluate_output_constraint(q, zero, target, error, W, bias, space);
        if (status != MODEL_OK) {
            return inner_status(status);
        }
        for (int i = 0; i < NY; ++i) {
            for (int j = 0; j < NA; ++j) {
                M[i][j] = W[j * NY + i];
            }
            b[i] = error[i];
        }
#if MODEL_NE > 0
        status = evaluate_inversion_jacobians(
            q, zero, zero, y1_q, y2_q, y2_v, row, row_q, row_v, row_a, space);
        if (status != MODEL_OK) {
            return inner_status(status);
        }
        for (int i = 0; i < NE; ++i) {
            for (int j = 0; j < NA; ++j) {
                M[NY + i][j] = row_q[j * NE + i];
            }
            b[NY + i] = row[i];
#if MODEL_FORCE
            for (int j = 0; j < NY; ++j) {
                b[NY + i] -= W[i_e[i] * NY + j] * FORCE_OF(space)[j];
            }
#endif /* MODEL_FORCE */
            scale[i] = fmax_1(1e-2 * fabs_1(row_q[i_e[i] * NE + i]), 1e-9);
        }
#else
        (void)scale;
#endif
        if (!solve_square(M, b, x)) {
            return can_move(W, M, b, x) ? MODEL_NOT_CONVERGED : MODEL_UNREACHABLE;
        }
        most = largest(x, NA);
        for (int i = 0; i < NA; ++i) {
            q[i] -= most > 0.5 ? 0.5 / most * x[i] : x[i];
        }
        if (most < PRECISE(1e-13, 1e-6) * (1.0 + largest(q, NA)) ||
            (most < PRECISE(1e-10, 1e-4) && before >= 0.0 && most >= before)) {
            return MODEL_OK;
        }
        before = most;
    }
    return before < PRECISE(1e-9, 1e-3) ? MODEL_OK : MODEL_UNREACHABLE;
}

#endif
