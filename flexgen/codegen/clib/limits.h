/*
 * model: changes of the path ahead that keep motors within their limits; private to the stream.
 *
 * The input of the chain of integrators is constant in blocks of intervals. Near the planned
 * motion the motors respond to a change of the deviation d with
 *
 *     tau_m + B2 d'' + B4 d'''',   v_m + C1 d' + C3 d''',
 *
 * by the inertia of arm and rotors and, in the higher derivatives, the deflections. A quadratic
 * program finds the change that keeps the limits over the horizon with the least deviation. The
 * inversion tracks the modified path exactly: the next update inverts it, and corrects the error
 * of this linearization.
 */
#ifndef MODEL_LIMITS_H
#define MODEL_LIMITS_H

#include "model_inversion_common.h"
#if MODEL_LUGRE
#include "model_lugre.h"
#endif /* MODEL_LUGRE */
#include "model_motors.h"
#include "model_path.h"
#include "model_reduced_problem.h"
#include "model_stream_layout.h"

/*
 * --- A small quadratic program with soft limits, by a fixed number of splitting steps.
 *
 *     min  z' H z / 2 + g' z + price * sum_i dist(x_i + (A z)_i, [-1, 1])
 *
 * Where the price exceeds the multipliers, the limits are kept where that is possible, and
 * exceeded as little as possible elsewhere: there is always a solution. Alternating directions:
 * one factorization, then two triangular solves and a projection per step.
 *
 * Source: B. Stellato et al., Mathematical Programming Computation 12, 2020 (OSQP); N. Parikh, S.
 * Boyd, Proximal Algorithms, 2014, sec. 6.
 */

static const real equilibrium_of_springs = 1.6; /* over-relaxation */
/* weight of the change per step, relative to the mean diagonal of H */
static const real proximal_weight = PRECISE(1e-9, 1e-6);

/* A quadratic program and its memory; all arrays belong to the caller. */
typedef struct {
    int n, rows;
    real *H;        /* n x n, symmetric; overwritten */
    real *g;        /* n; overwritten */
    real *A;        /* rows x n; overwritten */
    const real *x;  /* rows */
    real *y;        /* rows: multipliers in units of the cost, kept from call to call */
    real *z;        /* n: the solution */
    real *K;        /* n x n */
    real *w, *v;    /* rows */
    real *b;        /* n */
    real violation; /* out: largest violation of the limits */
} qp;

/*
 * K = L L' in the lower triangle, rows `stride` apart, diagonal inverted; 0 where a pivot is not
 * positive.
 */
static inline int factor_qp(real *K, int n, int stride)
{
    for (int k = 0; k < n; ++k) {
        for (int i = k; i < n; ++i) {
            real sum = K[i * stride + k];
            for (int j = 0; j < k; ++j) {
                sum -= K[i * stride + j] * K[k * stride + j];
            }
            if (i > k) {
                K[i * stride + k] = sum * K[k * stride + k];
            } else if (sum > 0.0) {
                K[k * stride + k] = 1.0 / square_root(sum);
            } else {
                return 0;
            }
        }
    }
    return 1;
}

static inline void solve_qp(const real *K, int n, int stride, real *b)
{
    for (int i = 0; i < n; ++i) {
        real sum = b[i];
        for (int j = 0; j < i; ++j) {
            sum -= K[i * stride + j] * b[j];
        }
        b[i] = sum * K[i * stride + i];
    }
    for (int i = n - 1; i >= 0; --i) {
        b[i] *= K[i * stride + i];
        for (int j = 0; j < i; ++j) {
            b[j] -= K[i * stride + j] * b[i];
        }
    }
}

/* The solution after the given number of steps; 0 where a number is not finite. */
static inline int run_qp(qp *p, real price, int steps)
{
    const int n = p->n, rows = p->rows;
    real size = 0.0, cost = 0.0, unit;
    for (int i = 0; i < rows * n; ++i) {
        size += p->A[i] * p->A[i];
    }
    /* scale of z: the mean length of the columns of A becomes one */
    unit = size > 0.0 ? 1.0 / square_root(size / (real)n) : 1.0;
    for (int i = 0; i < n; ++i) {
        cost += p->H[i * n + i] * unit * unit;
    }
    cost = cost > 0.0 ? (real)n / cost : 1.0; /* and the diagonal of H too */
    for (int i = 0; i < n; ++i) {
        p->g[i] *= unit * cost;
        p->z[i] = 0.0;
        for (int j = 0; j <= i; ++j) {
            p->H[i * n + j] *= unit * unit * cost;
            p->K[i * n + j] = p->H[i * n + j] + (i == j ? proximal_weight : 0.0);
        }
    }
    for (int r = 0; r < rows; ++r) {
        real *a = p->A + r * n;
        for (int i = 0; i < n; ++i) {
            a[i] *= unit;
        }
        for (int i = 0; i < n; ++i) {
            for (int j = 0; j <= i; ++j) {
                p->K[i * n + j] += a[i] * a[j];
            }
        }
        p->y[r] *= cost;
        p->w[r] = fmin_1(fmax_1(0.0, -1.0 - p->x[r]), 1.0 - p->x[r]);
    }
    if (!factor_qp(p->K, n, n)) {
        return 0;
    }
    price *= cost;
    for (int step = 0; step < steps; ++step) {
        for (int i = 0; i < n; ++i) {
            p->b[i] = proximal_weight * p->z[i] - p->g[i];
        }
        for (int r = 0; r < rows; ++r) {
            const real pull = p->w[r] - p->y[r];
            for (int i = 0; i < n; ++i) {
                p->b[i] += pull * p->A[r * n + i];
            }
        }
        solve_qp(p->K, n, n, p->b);
        for (int i = 0; i < n; ++i) {
            p->z[i] = p->b[i];
        }
        for (int r = 0; r < rows; ++r) {
            real sum = 0.0, to, near;
            for (int i = 0; i < n; ++i) {
                sum += p->A[r * n + i] * p->z[i];
            }
            p->v[r] = sum;
            sum = equilibrium_of_springs * sum + (1.0 - equilibrium_of_springs) * p->w[r];
            to = sum + p->y[r];
            near = fmin_1(fmax_1(to, -1.0 - p->x[r]), 1.0 - p->x[r]);
            if (to - near > price) {
                near = to - price;
            } else if (to - near < -price) {
                near = to + price;
            }
            p->w[r] = near;
            p->y[r] = to - near;
        }
    }
    p->violation = 0.0;
    for (int r = 0; r < rows; ++r) {
        p->violation = fmax_1(p->violation, fabs_1(p->x[r] + p->v[r]) - 1.0);
        p->y[r] /= cost;
    }
    for (int i = 0; i < n; ++i) {
        p->z[i] *= unit;
    }
    return is_finite(p->z, n) && is_finite(p->y, rows);
}

/* --- Change of the path within the horizon of a stream. */

#if MODEL_LIMITED
/*
 * The largest torque of a motor at rest by an edge of its torque-speed curve, and what the speed
 * takes from it; the first is infinite where there is no edge.
 */
static inline real edge_of_curve(
    const model_inversion_limits *limits, int motor, int edge, real *load)
{
    const real *from = limits->torque_speed +
                       ((ptrdiff_t)motor * limits->torque_speed_points + edge) * 2;
    const real run = from[2] - from[0];
    *load = 0.0;
    if (!(run > 0.0)) {
        return (real)INFINITY;
    }
    *load = (from[1] - from[3]) / run;
    return from[3] + *load * from[2];
}

/* Whether all limits are positive; no NaN. */
static inline int are_limits(const real *limits, int size)
{
    for (int i = 0; i < size && limits != NULL; ++i) {
        if (!(limits[i] > 0.0)) {
            return 0;
        }
    }
    return 1;
}

/*
 * Whether each edge of the torque-speed curves has torque at rest, and takes from it with the
 * speed; no NaN.
 */
static inline int are_curves(const model_inversion_limits *limits)
{
    for (int i = 0; i < NM && limits->torque_speed != NULL; ++i) {
        for (int edge = 0; edge < limits->torque_speed_points - 1; ++edge) {
            real load;
            const real most = edge_of_curve(limits, i, edge, &load);
            if (!(most > 0.0 && load >= 0.0 && load < (real)INFINITY)) {
                return 0;
            }
        }
        if (!(limits->torque_speed[((ptrdiff_t)i + 1) * limits->torque_speed_points * 2 - 2] >
                0.0)) {
            return 0;
        }
    }
    return 1;
}

/* Whether all given limits are in their range. */
static inline int are_in_range(const model_inversion_limits *l)
{
    return are_limits(l->torque_max, NM) && are_limits(l->speed_max, NM) &&
           are_limits(l->deflection_max, NE) && are_limits(l->gear_torque_max, NG) &&
           are_limits(l->torque_rate_max, NM) && are_limits(l->joint_speed_max, NG) &&
           are_limits(l->joint_acceleration_max, NG) && l->tool_speed_max >= 0.0 &&
           l->tool_acceleration_max >= 0.0 &&
           (l->torque_speed == NULL || (l->torque_speed_points >= 2 && are_curves(l)));
}

#endif /* MODEL_LIMITED */
enum { QP_STEPS = 80 };

/* margin of a limit for errors of the Jacobians, relative */
static const real limit_margin = 1e-3;
/* nodes below this part of a limit are not in the quadratic program */
static const real considered_from = 0.5;
/* a change is refused beyond this factor times the largest deviation */
static const real overshoot_factor = 1.5;
/* part of a change that one update makes, so that errors of the Jacobians are corrected */
static const real step_share = 0.2;
/* m, rad: a smaller deviation is not reported */
static const real deviation_zero = PRECISE(1e-7, 1e-6);
/* m, rad: a smaller deviation only decays */
static const real deviation_decayed = PRECISE(1e-11, 1e-8);
/* m, rad: a smaller deviation becomes zero */
static const real deviation_removed = 1e-20;
/* weight of the input, and of the derivatives at the end, relative to the deviation */
static const real smoothness_weight = 1e-1;
/* weight of a change of the input, against jumps from update to update */
static const real change_weight = 1e0;
/* weight of an exceeded limit, relative to a deviation of one */
static const real limit_weight = 1e2;

#if MODEL_BOUNDS
/*
 * Derivative of an order of output j at node k, with its deviation; T: time constant of the decay.
 */
static inline real output_rate(
    const real *s, const limits_layout *l, ptrdiff_t k, int order, int j, real T)
{
    const real *plan = s + l->plan + k * REFERENCE, *x = s + l->deviation + k * DEVIATION;
    return plan[NT + (order - 1) * NY + j] + x[order * NY + j] / (order == 1 ? T : T * T);
}

/* The positions of an output; a pose has rotations too. */
#if MODEL_FURTHER
enum { POSITIONS = TOOL_POSITIONS };
#else  /* MODEL_FURTHER */
enum { POSITIONS = PLACES };
#endif /* MODEL_FURTHER */

/* Speed or acceleration of the tool at node k. */
static inline real tool_rate(const real *s, const limits_layout *l, ptrdiff_t k, int order, real T)
{
    real sum = 0.0;
    for (int j = 0; j < POSITIONS; ++j) {
        const real rate = output_rate(s, l, k, order, j, T);
        sum += rate * rate;
    }
    return square_root(sum);
}

/*
 * All limited quantities at node k but deviations and motor speeds, relative to their limits; a:
 * accelerations of the gears, motor side. Rates are those without the friction, which changes at
 * once where a motor reverses, whatever the path, and without Fourier sums of the angle.
 */
static inline void all_values(real *s, const limits_layout *l, ptrdiff_t k, real h, real T,
    const real *a, const real *v_m, const real *tau_m)
{
    const real *bound = s + l->bound, *tau = s + l->tau + k * NG;
    real *value = s + l->value + k * BOUNDED, *torque = s + l->torque + k * NM,
         *edge = s + l->edge + k * 2 * NM;
#if MODEL_HARMONICS
    real by_speed;
#endif /* MODEL_HARMONICS */
    for (int i = 0; i < NM; ++i) {
        /* differences at node 0 are those of node 1: kept from before */
        if (k > 0 || !is_finite(torque + i, 1)) {
            torque[i] = 0.0;
            for (int g = 0; g < NG; ++g) {
                torque[i] += rotor_inertia[i] * eta[i][g] * a[g] + eta_inverse[g][i] * tau[g];
            }
        }
        edge[2 * i] = 1.0 / bound[i];
        edge[2 * i + 1] = 0.0;
#if MODEL_HARMONICS
        { /* the part of transmission errors rises with the square of the speed */
            const real *most = s + l->swing + i * SWINGS,
                       rise = 2.0 * rotor_inertia[i] * most[1] * most[4];
            by_speed = copysign_1(rise * v_m[i] / most[0], tau_m[i] * v_m[i]);
            edge[2 * i + 1] = by_speed / bound[i];
        }
#endif                                    /* MODEL_HARMONICS */
        for (int e = 0; e < EDGES; ++e) { /* |tau| + load |v| <= most */
            const real *curve = s + l->curve + 2 * (i * EDGES + e);
            const real used = (fabs_1(tau_m[i]) + curve[1] * fabs_1(v_m[i])) / curve[0];
            if (used > fabs_1(value[i])) {
                value[i] = tau_m[i] < 0.0 ? -used : used;
                edge[2 * i] = 1.0 / curve[0];
#if MODEL_HARMONICS
                edge[2 * i + 1] = (by_speed + (tau_m[i] * v_m[i] < 0.0 ? -curve[1] : curve[1])) /
                                  curve[0];
#else  /* MODEL_HARMONICS */
                edge[2 * i + 1] = (tau_m[i] * v_m[i] < 0.0 ? -curve[1] : curve[1]) / curve[0];
#endif /* MODEL_HARMONICS */
            }
        }
        value[RATE_ROWS + i] = k > 0 ? (torque[i] - torque[i - NM]) / (h * bound[RATE_ROWS + i]) :
                                       0.0;
    }
    for (int i = 0; i < NG; ++i) {
        value[GEAR_ROWS + i] = s[l->tau + k * NG + i] / bound[GEAR_ROWS + i];
        value[JOINT_ROWS + i] = s[l->v + k * NG + i] / bound[JOINT_ROWS + i];
        value[JOINT_ROWS + NG + i] = s[l->a + k * NG + i] / bound[JOINT_ROWS + NG + i];
    }
    for (int i = 0; i < NE; ++i) {
        value[ELASTIC_ROWS + i] = s[l->elastic + k * NE + i] / bound[ELASTIC_ROWS + i];
    }
    for (int order = 1; order <= 2; ++order) {
        value[TOOL_ROWS + order - 1] = tool_rate(s, l, k, order, T) / bound[TOOL_ROWS + order - 1];
    }
}

#endif /* MODEL_BOUNDS */
#if MODEL_HARMONICS
/*
 * The largest numbers of the Fourier sums of each motor over a turn: speed of the motor over that
 * without transmission error, acceleration over the square of that speed, change of the share of
 * the load, cogging, and one over the gain.
 */
static inline int find_swings(real *swing, real *space)
{
    real still[NM] = {0.0}, one[NM], w[NM], q_m[NM], v_m[NM], a_m[NM], share[NM], cogging[NM],
         gain[NM];
    for (int j = 0; j < NM; ++j) {
        one[j] = 1.0;
        set_zero(swing + j * SWINGS, SWINGS);
    }
    for (int k = 0; k < HARMONIC_ANGLES; ++k) {
        for (int j = 0; j < NM; ++j) {
            w[j] = PRECISE(6.283185307179586, 6.2831855) * (real)k / (real)HARMONIC_ANGLES;
        }
        if (evaluate_motor_harmonics(w, one, still, q_m, v_m, a_m, share, cogging, gain, space) !=
            MODEL_OK) {
            return 0;
        }
        for (int j = 0; j < NM; ++j) {
            const real now[SWINGS] = {
                v_m[j], fabs_1(a_m[j]), fabs_1(share[j] - 1.0), fabs_1(cogging[j]), 1.0 / gain[j]};
            for (int i = 0; i < SWINGS; ++i) {
                swing[j * SWINGS + i] = fmax_1(swing[j * SWINGS + i], now[i]);
            }
        }
    }
    return is_finite(swing, NM * SWINGS);
}

/*
 * Speeds and torques of the motors, as `motors_of`, at the angles at which the Fourier sums make
 * them the largest.
 */
static inline int largest_motors(const real *swing, const real *v, const real *a,
    const real *tau_g, real *v_m, real *tau_m, real *space)
{
    real friction[NM], load[NM], speed[NM], acceleration[NM];
    for (int j = 0; j < NM; ++j) {
        speed[j] = acceleration[j] = load[j] = 0.0;
        for (int i = 0; i < NG; ++i) {
            speed[j] += eta[j][i] * v[i];
            acceleration[j] += eta[j][i] * a[i];
            load[j] += eta_inverse[i][j] * tau_g[i];
        }
    }
#if MODEL_LOAD
    if (evaluate_loaded_friction(speed, load, friction, space) != MODEL_OK) {
        return 0;
    }
#else  /* MODEL_LOAD */
    if (evaluate_motor_friction(speed, friction, space) != MODEL_OK) {
        return 0;
    }
#endif /* MODEL_LOAD */
    for (int j = 0; j < NM; ++j) {
        const real *most = swing + j * SWINGS, J = rotor_inertia[j];
        const real mean = friction[j] + J * acceleration[j] + load[j];
        const real turning = (most[0] - 1.0) * fabs_1(acceleration[j]) +
                             most[1] * speed[j] * speed[j];
        const real more = J * turning + most[2] * fabs_1(load[j]) + most[3];
        v_m[j] = most[0] * speed[j];
        tau_m[j] = copysign_1((fabs_1(mean) + more) * most[4], mean);
    }
    return is_finite(v_m, NM) && is_finite(tau_m, NM);
}

#endif /* MODEL_HARMONICS */
/* Deflections of the gears at the nodes from their torques there. */
static inline int deflections_at_nodes(
    real *s, const limits_layout *l, ptrdiff_t N, real h, real *space)
{
    const real equilibrium[NG] = {0.0};
    real stiffness[NG];
    if (!static_deflections(s + l->tau, N + 1, equilibrium, s + l->deflection, stiffness, space)) {
        return 0;
    }
    /* the first and the last node use the differences of their neighbors */
    for (ptrdiff_t k = 0; k <= N; ++k) {
        const ptrdiff_t at = (k < 1 ? 1 : k > N - 1 ? N - 1 : k) * NG;
        const real *x = s + l->deflection + at;
        for (int i = 0; i < NG; ++i) {
            const real lag = lag_time(i, stiffness[i], space);
            s[l->lagged + k * NG + i] = s[l->deflection + k * NG + i] -
                                        lag * (x[NG + i] - x[i - NG]) / (2.0 * h);
        }
    }
    return 1;
}

/* Motion of the joints at node k with their deflections. */
static inline void deflected_at_node(const real *s, const limits_layout *l, ptrdiff_t N,
    ptrdiff_t k, real h, real *q, real *v, real *a)
{
    const ptrdiff_t at = (k < 1 ? 1 : k > N - 1 ? N - 1 : k) * NG;
    const real *x = s + l->lagged + at;
    for (int i = 0; i < NG; ++i) {
        q[i] = s[l->q + k * NG + i] + s[l->lagged + k * NG + i];
        v[i] = s[l->v + k * NG + i] + (x[NG + i] - x[i - NG]) / (2.0 * h);
        a[i] = s[l->a + k * NG + i] + (x[NG + i] - 2.0 * x[i] + x[i - NG]) / (h * h);
    }
}

#if MODEL_COUPLED
/*
 * What the moving rotors do at node k: forces on the joints, and torques that their carriers take
 * from them. Coordinates without motor are small, and taken as zero.
 */
static inline int rotors_at_node(const real *s, const limits_layout *l, ptrdiff_t N, ptrdiff_t k,
    real h, real *on_joints, real *taken, real *space)
{
    real arm[3 * NA] = {0.0}, q[NG], v[NG], a[NG];
    for (int i = 0; i < NG; ++i) {
        arm[i_g[i]] = s[l->q + k * NG + i];
        arm[NA + i_g[i]] = s[l->v + k * NG + i];
        arm[2 * NA + i_g[i]] = s[l->a + k * NG + i];
    }
    deflected_at_node(s, l, N, k, h, q, v, a);
    return rotors_of(arm, v, a, on_joints, taken, space);
}

/* Add the forces of the moving rotors to the torques of the gears, a pass for each stage. */
static inline int couple_rotors_at_nodes(
    real *s, const limits_layout *l, ptrdiff_t N, real h, real *space)
{
    copy(s + l->tau, (N + 1) * NG, s + l->still);
    for (int stage = 0; stage < COUPLING_STAGES; ++stage) {
        if (!deflections_at_nodes(s, l, N, h, space)) {
            return 0;
        }
        for (ptrdiff_t k = 0; k <= N; ++k) {
            real on_joints[NG], taken[NM];
            if (!rotors_at_node(s, l, N, k, h, on_joints, taken, space)) {
                return 0;
            }
            for (int i = 0; i < NG; ++i) {
                s[l->tau + k * NG + i] = s[l->still + k * NG + i] + on_joints[i];
            }
        }
    }
    return 1;
}

#endif /* MODEL_COUPLED */
/*
 * Motor torques and speeds at the nodes, relative to their limits, from motion and torques of the
 * arm there.
 */
static inline int motors_at_nodes(
    real *s, const limits_layout *l, ptrdiff_t N, real h, real *space)
{
#if MODEL_COUPLED
    if (!couple_rotors_at_nodes(s, l, N, h, space)) {
        return 0;
    }
#endif /* MODEL_COUPLED */
    if (!deflections_at_nodes(s, l, N, h, space)) {
        return 0;
    }
    for (ptrdiff_t k = 0; k <= N; ++k) {
        const real *tau = s + l->tau + k * NG;
        real q[NG], v[NG], a[NG], q_m[NM], v_m[NM], tau_m[NM];
        real *value = s + l->value + k * BOUNDED;
        deflected_at_node(s, l, N, k, h, q, v, a);
#if MODEL_HARMONICS
        (void)q;
        (void)q_m;
        if (!largest_motors(s + l->swing, v, a, tau, v_m, tau_m, space)) {
            return 0;
        }
#else  /* MODEL_HARMONICS */
        if (!motors_of(q, v, a, tau, q_m, v_m, tau_m, space)) {
            return 0;
        }
#endif /* MODEL_HARMONICS */
#if MODEL_COUPLED
        {
            real on_joints[NG], taken[NM];
            if (!rotors_at_node(s, l, N, k, h, on_joints, taken, space)) {
                return 0;
            }
            for (int i = 0; i < NM; ++i) {
                tau_m[i] += taken[i];
            }
        }
#endif /* MODEL_COUPLED */
        for (int i = 0; i < NM; ++i) {
#if MODEL_LUGRE
            tau_m[i] += sliding_torque(i, v_m[i]);
#endif /* MODEL_LUGRE */
            value[i] = tau_m[i] / s[l->bound + i];
            value[NM + i] = v_m[i] / s[l->bound + NM + i];
        }
#if MODEL_BOUNDS
        all_values(s, l, k, h, h * (real)N / DECAYS, a, v_m, tau_m);
#endif /* MODEL_BOUNDS */
        for (int i = 0; i < NY; ++i) {
            value[MOTORS + i] = s[l->deviation + k * DEVIATION + i] / s[l->bound + MOTORS + i];
        }
    }
    return 1;
}

/*
 * B2, B4, C1, C3 [row][output] at the instant that all points of `arm` hold, with the inverse of W
 * there.
 */
typedef struct {
    real B2[NM][NY], B4[NM][NY], C1[NM][NY], C3[NM][NY];
#if MODEL_BOUNDS
    /* not relative to the limits; F, G: of gear torques, W: of deflections, J, U: of joints */
    real F[NG][NY], G[NG][NY], W[NE + 1][NY], J[NG][NY], U[NG][NY];
#endif /* MODEL_BOUNDS */
} jacobian_ahead;

#if MODEL_NE > 0
/*
 * W: deflections in balance with the accelerations d'' of the output, K w + (M_eg J_g^-1) d'' = 0.
 */
static inline int deflections_at(problem_points *arm, real W[NE][NY], real *space)
{
    real K[NE][NE + NY]; /* and right sides */
    if (reduced_jacobians(arm, space) != MODEL_OK) {
        return 0;
    }
    for (int i = 0; i < NE; ++i) {
        for (int j = 0; j < NE; ++j) {
            K[i][j] = arm->K[j][i][0];
        }
        for (int j = 0; j < NY; ++j) {
            K[i][NE + j] = 0.0;
            for (int k = 0; k < NG; ++k) {
                K[i][NE + j] -= arm->row_a[i_g[k]][i][0] * arm->inverse[j][k][0];
            }
        }
    }
    if (!solve_plain(&K[0][0], NE, NE + NY)) { /* stiffness dominates: no pivoting */
        return 0;
    }
    for (int i = 0; i < NE; ++i) {
        copy(K[i] + NE, NY, W[i]);
    }
    return 1;
}
#endif

/* The Jacobians at an instant, relative to the limits; 0 where a number is not finite. */
static inline int jacobian_at(
    problem_points *arm, const real *torque, const real *bound, jacobian_ahead *f, real *space)
{
    real M[NG][NG], F[NG][NY], G[NG][NY], U[NG][NY], p[NG], stiffness[NG], base[NG];
#if MODEL_NE > 0
    real W[NE][NY];
#endif
    for (int i = 0; i < NG; ++i) {
        p[i] = 0.0;
        base[i] = torque[i];
    }
    if (!static_deflection(base, p, stiffness, space)) {
        return 0;
    }
    for (int first = 0; first < NG; first += POINTS) { /* tau_g is linear in the accelerations */
        for (int l = 0; l < POINTS && first + l < NG; ++l) {
            arm->a[i_g[first + l]][l] += 1.0;
        }
        if (evaluate_rows(arm, space) != MODEL_OK) {
            return 0;
        }
        for (int l = 0; l < POINTS && first + l < NG; ++l) {
            for (int i = 0; i < NG; ++i) {
                M[i][first + l] = arm->tau_g[i][l] - base[i];
            }
            arm->a[i_g[first + l]][l] -= 1.0;
        }
    }
    for (int i = 0; i < NG; ++i) {
        for (int j = 0; j < NY; ++j) {
            F[i][j] = G[i][j] = U[i][j] = 0.0;
            for (int k = 0; k < NG; ++k) {
                F[i][j] += M[i][k] * arm->inverse[j][k][0];
            }
        }
    }
#if MODEL_NE > 0
    if (!deflections_at(arm, W, space)) {
        return 0;
    }
    for (int i = 0; i < NG; ++i) {
        for (int j = 0; j < NY; ++j) {
            for (int e = 0; e < NE; ++e) {
                U[i][j] += arm->S[e][i][0] * W[e][j];
                G[i][j] += arm->row_a[i_g[i]][e][0] * W[e][j];
            }
        }
    }
    for (int i = 0; i < NG; ++i) {
        for (int j = 0; j < NY; ++j) {
            for (int k = 0; k < NG; ++k) {
                G[i][j] += M[i][k] * U[k][j];
            }
        }
    }
#endif
    for (int m = 0; m < NM; ++m) {
#if MODEL_BOUNDS
        const real per_torque = 1.0, per_speed = 1.0;
#else  /* MODEL_BOUNDS */
        const real per_torque = 1.0 / bound[m], per_speed = 1.0 / bound[NM + m];
#endif /* MODEL_BOUNDS */
        for (int j = 0; j < NY; ++j) {
            real B2 = 0.0, B4 = 0.0, C1 = 0.0, C3 = 0.0;
            for (int i = 0; i < NG; ++i) {
                const real deflected = U[i][j] + (gear_is_rigid[i] ? 0.0 : F[i][j] / stiffness[i]);
                B2 += rotor_inertia[m] * eta[m][i] * arm->inverse[j][i][0] +
                      eta_inverse[i][m] * F[i][j];
                B4 += rotor_inertia[m] * eta[m][i] * deflected + eta_inverse[i][m] * G[i][j];
                C1 += eta[m][i] * arm->inverse[j][i][0];
                C3 += eta[m][i] * deflected;
            }
            f->B2[m][j] = per_torque * B2;
            f->B4[m][j] = per_torque * B4;
            f->C1[m][j] = per_speed * C1;
            f->C3[m][j] = per_speed * C3;
        }
    }
#if MODEL_BOUNDS
    (void)bound;
    for (int j = 0; j < NY; ++j) {
        for (int i = 0; i < NG; ++i) {
            f->F[i][j] = F[i][j];
            f->G[i][j] = G[i][j];
            f->J[i][j] = arm->inverse[j][i][0];
            f->U[i][j] = U[i][j];
        }
#if MODEL_NE > 0
        for (int e = 0; e < NE; ++e) {
            f->W[e][j] = W[e][j];
        }
#endif
    }
#endif /* MODEL_BOUNDS */
    return 1;
}

#if MODEL_BOUNDS
/*
 * Effect of input b on a quantity with the part x of the derivative `order` of the output, and z
 * of that two above.
 */
static inline real effect_of(real x, real z, int order, const real *r, int b, real T)
{
    return (x * r[order * BLOCKS + b] + z * r[(order + 2) * BLOCKS + b] / (T * T)) /
           (order == 1 ? T : T * T);
}

/*
 * Effect of input b of output j on limited quantity m of node k, where r is the response of the
 * chain there.
 */
static inline real effect_on(const real *s, const limits_layout *l, const jacobian_ahead *f,
    ptrdiff_t k, int m, const real *r, int b, int j, real T, real h)
{
    const real *bound = s + l->bound, *edge = s + l->edge + k * 2 * NM;
    if (m < NM) {
        return edge[2 * m] * effect_of(f->B2[m][j], f->B4[m][j], 2, r, b, T) +
               edge[2 * m + 1] * effect_of(f->C1[m][j], f->C3[m][j], 1, r, b, T);
    }
    if (m < RATE_ROWS) {
        return effect_of(f->C1[m - NM][j], f->C3[m - NM][j], 1, r, b, T) / bound[m];
    }
    if (m < GEAR_ROWS) {
        const int i = m - RATE_ROWS;
        return (effect_of(f->B2[i][j], f->B4[i][j], 2, r, b, T) -
                   effect_of(f->B2[i][j], f->B4[i][j], 2, r - CHAIN * BLOCKS, b, T)) /
               (h * bound[m]);
    }
    if (m < ELASTIC_ROWS) {
        return effect_of(f->F[m - GEAR_ROWS][j], f->G[m - GEAR_ROWS][j], 2, r, b, T) / bound[m];
    }
    if (m < JOINT_ROWS) {
        return effect_of(f->W[m - ELASTIC_ROWS][j], 0.0, 2, r, b, T) / bound[m];
    }
    if (m < TOOL_ROWS) {
        const int i = (m - JOINT_ROWS) % NG;
        return effect_of(f->J[i][j], f->U[i][j], 1 + (m - JOINT_ROWS) / NG, r, b, T) / bound[m];
    }
    if (m < MOTORS) { /* along the motion of the tool */
        const int order = 1 + m - TOOL_ROWS;
        const real rate = tool_rate(s, l, k, order, T);
        return j < POSITIONS && rate > 0.0 ?
                   effect_of(output_rate(s, l, k, order, j, T) / rate, 0.0, order, r, b, T) /
                       bound[m] :
                   0.0;
    }
    return m - MOTORS == j ? r[b] / bound[m] : 0.0;
}

#else /* MODEL_BOUNDS */
/* Effect of the inputs on limited quantity m of a node, where r is the response of the chain. */
static inline void fill_row(const real *s, const limits_layout *l, const jacobian_ahead *f, int m,
    const real *r, int blocks, real T, real *A)
{
    for (int b = 0; b < blocks; ++b) {
        for (int j = 0; j < NY; ++j) {
            real *to = A + b * NY + j;
            if (m < NM) {
                *to = (f->B2[m][j] * r[2 * BLOCKS + b] +
                          f->B4[m][j] * r[4 * BLOCKS + b] / (T * T)) /
                      (T * T);
            } else if (m < MOTORS) {
                *to = (f->C1[m - NM][j] * r[BLOCKS + b] +
                          f->C3[m - NM][j] * r[3 * BLOCKS + b] / (T * T)) /
                      T;
            } else {
                *to = m - MOTORS == j ? r[b] / s[l->bound + m] : 0.0;
            }
        }
    }
}

#endif /* MODEL_BOUNDS */
/* Change the deviations ahead; 0 where a number is not finite, and nothing has changed. */
static inline int change_deviation(
    real *s, const limits_layout *l, ptrdiff_t N, ptrdiff_t fixed, real T, const jacobian_ahead *f)
{
    const ptrdiff_t left = N - fixed;
    const int blocks = left < BLOCKS ? (int)left : (int)BLOCKS, n = blocks * NY;
    const real tau = (real)DECAYS / (real)N;
    real *deviation = s + l->deviation, *response = s + l->response, *H = s + l->H, *g = s + l->g;
    qp p = {n, 0, H, g, s + l->A, s + l->x, s + l->y, s + l->z, s + l->K, s + l->w, s + l->vv,
        s + l->b, 0.0};
    /* response of the chain at the nodes to a unit input in a block */
    for (int b = 0; b < blocks; ++b) {
        for (ptrdiff_t k = 0; k <= N; ++k) {
            real *to = response + (k * CHAIN) * BLOCKS + b;
            const int in = k > fixed && (k - 1 - fixed) * blocks / left == b;
            if (k <= fixed) {
                for (int i = 0; i < CHAIN; ++i) {
                    to[i * BLOCKS] = 0.0;
                }
            } else {
                chain_step(to - CHAIN * BLOCKS, BLOCKS, in ? 1.0 : 0.0, tau, to, BLOCKS);
            }
        }
    }
    set_zero(H, n * n);
    set_zero(g, n);
    for (ptrdiff_t k = fixed + 1; k <= N; ++k) {
        const real *r = response + k * CHAIN * BLOCKS, *x = deviation + k * DEVIATION;
        for (int c = 0; c < CHAIN; ++c) {
            const real weight = c == 0 ? 1.0 / (real)N :
                                k == N ? 1.0 :
                                         smoothness_weight / (real)N;
            for (int b = 0; b < blocks; ++b) {
                for (int j = 0; j < NY; ++j) {
                    g[b * NY + j] += weight * r[c * BLOCKS + b] * x[c * NY + j];
                    for (int d = 0; d < blocks; ++d) {
                        H[(b * NY + j) * n + d * NY + j] += weight * r[c * BLOCKS + b] *
                                                            r[c * BLOCKS + d];
                    }
                }
            }
        }
    }
    for (int i = 0; i < n; ++i) {
        H[i * n + i] += change_weight;
    }
    for (ptrdiff_t k = fixed + 1; k <= N; ++k) {
        const real *r = response + k * CHAIN * BLOCKS;
        for (int m = 0; m < BOUNDED; ++m) {
            const ptrdiff_t row = k * BOUNDED + m;
            real *A;
            if (!(fabs_1(s[l->value + row]) > considered_from)) {
                s[l->dual + row] = 0.0;
                continue;
            }
            A = p.A + p.rows * n;
            s[l->x + p.rows] = s[l->value + row] * (1.0 + limit_margin);
            s[l->y + p.rows] = s[l->dual + row];
#if MODEL_BOUNDS
            for (int b = 0; b < blocks; ++b) {
                for (int j = 0; j < NY; ++j) {
                    A[b * NY + j] = effect_on(s, l, f, k, m, r, b, j, T, T * tau);
                }
            }
#else  /* MODEL_BOUNDS */
            fill_row(s, l, f, m, r, blocks, T, A);
#endif /* MODEL_BOUNDS */
            ++p.rows;
        }
    }
    if (!run_qp(&p, limit_weight, QP_STEPS)) {
        for (ptrdiff_t i = 0; i < (N + 1) * BOUNDED; ++i) {
            s[l->dual + i] = 0.0;
        }
        return 0;
    }
    for (int i = 0; i < n; ++i) {
        p.z[i] *= step_share;
    }
    p.rows = 0;
    /* as they were taken above */
    for (ptrdiff_t row = (fixed + 1) * BOUNDED; row < (N + 1) * BOUNDED; ++row) {
        if (fabs_1(s[l->value + row]) > considered_from) {
            s[l->dual + row] = p.y[p.rows++];
        }
    }
    /* a soft limit may be exceeded, but a deviation not by much */
    for (ptrdiff_t k = fixed + 1; k <= N; ++k) {
        for (int j = 0; j < NY; ++j) {
            real to = deviation[k * DEVIATION + j];
            for (int b = 0; b < blocks; ++b) {
                to += response[k * CHAIN * BLOCKS + b] * p.z[b * NY + j];
            }
            if (fabs_1(to) > overshoot_factor * s[l->bound + MOTORS + j] &&
                fabs_1(to) > fabs_1(deviation[k * DEVIATION + j])) {
                return 0;
            }
        }
    }
    for (ptrdiff_t k = fixed + 1; k <= N; ++k) {
        for (int c = 0; c < CHAIN; ++c) {
            for (int j = 0; j < NY; ++j) {
                for (int b = 0; b < blocks; ++b) {
                    deviation[k * DEVIATION + c * NY + j] +=
                        response[(k * CHAIN + c) * BLOCKS + b] * p.z[b * NY + j];
                }
            }
        }
    }
    return 1;
}

#endif
