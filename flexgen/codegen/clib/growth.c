/* model: growth of perturbations along a motion. Written by flexgen; see model_inversion.h. */
#include "model_inversion.h"

#include "model_inversion_common.h"

/*
 * Under given motor torques a perturbation of the positions p and speeds v, of motors on the arm
 * side, follows
 *
 *     dp/dt = v,    dv/dt = K p + D v,
 *
 * the linearized forward dynamics, constant between two instants of a grid. A step h of the
 * implicit midpoint rule, with the mean speed u, is
 *
 *     (1 - h/2 D - h^2/4 K) u = v + h/2 K p,    p += h u,    v = 2 u - v.
 *
 * It neither excites vibrations nor damps them. Columns of the matrices p and v: perturbations of
 * one position each at the start. Samples at rest at the end are left out, so that the result does
 * not depend on their number; where there are any, the last torque is held for HELD_STEPS of the
 * grid.
 */
enum {
    DOF = MODEL_NX / 2,
    GROWTH_STEPS = 2,
    GRID_FEWEST = 50,
    GRID_MOST = 1000,
    POWER_STEPS = 12,
    HELD_STEPS = 50
};

static const real grid_step = 1e-2;                 /* s */
static const real slow_share = 1e-4;                /* of the largest speed */
static const real slow_speed = PRECISE(1e-9, 1e-6); /* rad/s or m/s: rounding */
static const real growth_max = PRECISE(1e300, 1e37);

typedef struct {
    real A[MODEL_NX * MODEL_NX], B[MODEL_NX * MODEL_NM]; /* by columns */
    /* K, then D, by rows, at two instants of the grid */
    real before[2 * DOF * DOF], now[2 * DOF * DOF];
    /* S = (1 - h/2 D - h^2/4 K)^-1 and h/2 S K, behind it */
    real system[3 * DOF * DOF];
    real p[DOF * DOF], v[DOF * DOF]; /* by rows */
#if MODEL_FORCE
    /* derivatives of the inverse dynamics of the arm, by columns */
    real of_q[2][NA * NA], of_v[NA * NA], M[NA * NA];
    real W[NA * NY], other[NA * NY]; /* by columns */
    real force_q[NA * NA];           /* d(W' f)/dq, by rows */
    real to_solve[NA * 2 * NA];      /* by rows */
#endif                               /* MODEL_FORCE */
} growth_space;

#if MODEL_FORCE
/*
 * A force f of constant direction on the output adds d(M^-1 W' f)/dq to K.
 *
 * The force at the samples of a path: n of them, the first one at sample `before` of the motion;
 * null: none.
 */
typedef struct {
    const real *of_path;
    ptrdiff_t n, before;
} growth_force;

/* That at sample k of the motion: before the path and after it as it is at its ends. */
static const real *force_at(const growth_force *force, ptrdiff_t k)
{
    const ptrdiff_t at = k < force->before ? 0 : k - force->before;
    return force->of_path + (at < force->n ? at : force->n - 1) * FORCES;
}

/*
 * f' W' v with the map W to rates of the output, and its time derivative W': a quadratic form of
 * the speeds v.
 */
static int force_power_rate(const real *q, const real *v, const real *f, const real *parameters,
    real *W, real *to, real *space)
{
    real target[NT], error[NY], bias[NY];
    int status;
    for (int i = 0; i < NT; ++i) { /* any that is a number; of a pose without a rotation */
        target[i] = MODEL_POSE && i >= PLACES && (i - PLACES) % 4 == 0 ? 1.0 : 0.0;
    }
    status = evaluate_growth_constraint(q, v, target, error, W, bias, parameters, space);
    *to = 0.0;
    for (int i = 0; i < NY; ++i) {
        *to += f[i] * bias[i];
    }
    return status;
}

/*
 * d(W' f)/dq, to force_q, and W. Row i, column j is f' dw_i/dq_j, w_i a column of W. With f' W' v
 * = Q(v) its symmetric part is (Q(e_i + e_j) - Q(e_i) - Q(e_j)) / 2. Columns of a gradient have no
 * other; but angular velocities of a pose are not derivatives of coordinates: dw_i/dq_j -
 * dw_j/dq_i = w_j x w_i.
 */
static int force_derivatives(
    const real *q, const real *f, const real *parameters, growth_space *s, real *space)
{
    real v[NA], own[NA];
    int status = MODEL_OK;
    for (int i = 0; i < NA; ++i) {
        v[i] = 0.0;
    }
    for (int i = 0; i < NA && status == MODEL_OK; ++i) {
        v[i] = 1.0;
        status = force_power_rate(q, v, f, parameters, s->W, own + i, space);
        s->force_q[i * NA + i] = own[i];
        for (int j = 0; j < i && status == MODEL_OK; ++j) {
            real both, turned = 0.0;
            v[j] = 1.0;
            status = force_power_rate(q, v, f, parameters, s->other, &both, space);
            v[j] = 0.0;
#if MODEL_POSE
            for (int k = 0; k < 3; ++k) {
                const int m = PLACES + (k + 1) % 3, n = PLACES + (k + 2) % 3;
                const real *a = s->W + j * NY, *b = s->W + i * NY;
                turned += f[PLACES + k] * (a[m] * b[n] - a[n] * b[m]);
            }
#endif
            s->force_q[i * NA + j] = 0.5 * (both - own[i] - own[j] + turned);
            s->force_q[j * NA + i] = 0.5 * (both - own[i] - own[j] - turned);
        }
        v[i] = 0.0;
    }
    return status;
}

/* Columns of the arm's coordinates at the head of each row: those behind them are solutions. */
static int solve_with_inertia(growth_space *s, int columns)
{
    for (int i = 0; i < NA; ++i) {
        for (int j = 0; j < NA; ++j) {
            s->to_solve[i * (NA + columns) + j] = s->M[j * NA + i];
        }
    }
    for (int k = 0; k < NG; ++k) { /* and rotors behind rigid gears */
        for (int l = 0; l < NG; ++l) {
            for (int m = 0; m < NM && gear_is_rigid[k] && gear_is_rigid[l]; ++m) {
                s->to_solve[i_g[k] * (NA + columns) + i_g[l]] += eta[m][k] * rotor_inertia[m] *
                                                                 eta[m][l];
            }
        }
    }
    return solve_plain(s->to_solve, NA, NA + columns);
}

/*
 * Add d(M^-1 W' f)/dq to K. With the accelerations a = M^-1 W' f it is M^-1 (d(W' f)/dq - (dM/dq)
 * a), and (dM/dq) a is the difference of two derivatives of the inverse dynamics at rest, with the
 * accelerations a and without.
 */
static int add_force(
    const real *q, const real *f, const real *parameters, real *K, growth_space *s, real *space)
{
    real still[NA], a[NA];
    int status = force_derivatives(q, f, parameters, s, space);
    for (int i = 0; i < NA; ++i) {
        still[i] = 0.0;
    }
    if (status == MODEL_OK) {
        status = evaluate_growth_inertia(
            q, still, still, s->of_q[0], s->of_v, s->M, parameters, space);
    }
    for (int i = 0; i < NA; ++i) {
        real sum = 0.0;
        for (int k = 0; k < NY; ++k) {
            sum += s->W[i * NY + k] * f[k];
        }
        s->to_solve[i * (NA + 1) + NA] = sum;
    }
    if (status == MODEL_OK && !solve_with_inertia(s, 1)) {
        status = MODEL_RESULT_NOT_FINITE;
    }
    for (int i = 0; i < NA; ++i) {
        a[i] = s->to_solve[i * (NA + 1) + NA];
    }
    if (status == MODEL_OK) {
        status = evaluate_growth_inertia(
            q, still, a, s->of_q[1], s->of_v, s->M, parameters, space);
    }
    for (int i = 0; i < NA; ++i) {
        for (int j = 0; j < NA; ++j) {
            s->to_solve[i * 2 * NA + NA + j] = s->force_q[i * NA + j] - s->of_q[1][j * NA + i] +
                                               s->of_q[0][j * NA + i];
        }
    }
    if (status == MODEL_OK && !solve_with_inertia(s, NA)) {
        status = MODEL_RESULT_NOT_FINITE;
    }
    for (int i = 0; i < NA && status == MODEL_OK; ++i) {
        for (int j = 0; j < NA; ++j) {
            K[i * DOF + j] += s->to_solve[i * 2 * NA + NA + j];
        }
    }
    return status;
}
#endif /* MODEL_FORCE */

/* K and D at sample k. */
#if MODEL_FORCE
static int growth_matrices(const model_motion *motion, const growth_force *force, ptrdiff_t k,
    const real *parameters, real *to, growth_space *s, real *space)
#else  /* MODEL_FORCE */
static int growth_matrices(const model_motion *motion, ptrdiff_t k, const real *parameters,
    real *to, growth_space *s, real *space)
#endif /* MODEL_FORCE */
{
    const int status = evaluate_linearize(motion->q_a + k * NA, motion->v_a + k * NA,
        motion->q_m + k * NM, motion->v_m + k * NM, motion->tau_m + k * NM, s->A, s->B, parameters,
        space);
    for (int part = 0; part < 2; ++part) {
        for (int i = 0; i < DOF; ++i) {
            for (int j = 0; j < DOF; ++j) {
                to[(part * DOF + i) * DOF + j] = s->A[(part * DOF + j) * MODEL_NX + DOF + i] /
                                                 arm_side[i] * arm_side[j];
            }
        }
    }
#if MODEL_FORCE
    if (status == MODEL_OK && force->of_path != NULL) {
        return add_force(motion->q_a + k * NA, force_at(force, k), parameters, to, s, space);
    }
#endif /* MODEL_FORCE */
    return status;
}

/* The last sample at which the arm moves; the last one of all where it never does. */
static ptrdiff_t last_moving(const real *v_a, ptrdiff_t n)
{
    const real slow = fmax_1(slow_speed, slow_share * largest(v_a, (int)n * NA));
    ptrdiff_t last = n - 1;
    while (last > 0 && largest(v_a + last * NA, NA) <= slow) {
        --last;
    }
    return last > 0 ? last : n - 1;
}

/* Prepare steps of h with the means of K and D of two instants; 0 where they are singular. */
static int growth_system(growth_space *s, real h)
{
    for (int i = 0; i < DOF; ++i) {
        real *row = s->system + i * 3 * DOF;
        for (int j = 0; j < DOF; ++j) {
            const int K = i * DOF + j, D = (DOF + i) * DOF + j;
            const real unit = i == j ? 1.0 : 0.0;
            const real force = 0.25 * h * (s->before[K] + s->now[K]);
            row[j] = unit - 0.5 * h * force - 0.25 * h * (s->before[D] + s->now[D]);
            row[DOF + j] = unit;
            row[2 * DOF + j] = force;
        }
    }
    return solve_plain(s->system, DOF, 3 * DOF);
}

/* A step of h of all perturbations. */
static void growth_step(growth_space *s, real h)
{
    for (int j = 0; j < DOF; ++j) {
        real u[DOF];
        for (int i = 0; i < DOF; ++i) {
            const real *row = s->system + i * 3 * DOF + DOF;
            real sum = 0.0;
            for (int k = 0; k < DOF; ++k) {
                sum += row[k] * s->v[k * DOF + j] + row[DOF + k] * s->p[k * DOF + j];
            }
            u[i] = sum;
        }
        for (int i = 0; i < DOF; ++i) {
            s->p[i * DOF + j] += h * u[i];
            s->v[i * DOF + j] = 2.0 * u[i] - s->v[i * DOF + j];
        }
    }
}

/* The largest singular value of p, by the power method from its largest row. */
static real growth_norm(const real *p)
{
    real x[DOF], y[DOF], norm = 0.0;
    int at = 0;
    real most = -1.0;
    for (int i = 0; i < DOF; ++i) {
        real sum = 0.0;
        for (int j = 0; j < DOF; ++j) {
            sum += p[i * DOF + j] * p[i * DOF + j];
        }
        at = sum > most ? i : at;
        most = fmax_1(most, sum);
    }
    copy(p + at * DOF, DOF, x);
    for (int step = 0; step < POWER_STEPS; ++step) {
        real before = 0.0, after = 0.0;
        for (int i = 0; i < DOF; ++i) {
            y[i] = 0.0;
            for (int j = 0; j < DOF; ++j) {
                y[i] += p[i * DOF + j] * x[j];
            }
            before += x[i] * x[i];
            after += y[i] * y[i];
        }
        norm = before > 0.0 ? square_root(after / before) : 0.0;
        for (int j = 0; j < DOF; ++j) {
            x[j] = 0.0;
            for (int i = 0; i < DOF; ++i) {
                x[j] += p[i * DOF + j] * (norm > 0.0 ? y[i] / norm : 0.0);
            }
        }
        most = largest(x, DOF);
        for (int j = 0; j < DOF; ++j) {
            x[j] = most > 0.0 ? x[j] / most : 0.0;
        }
    }
    return norm;
}

int64_t model_growth_work(void)
{
    return padded((int64_t)(sizeof(growth_space) / sizeof(real))) + MODEL_LINEARIZE_SPACE + BLOCK;
}

#if MODEL_FORCE
model_status model_growth(const model_motion *motion, int n, real period, const real *force,
    int n_force, int n_pre, PARAMETERS_ARGUMENT real *growth, real *work, int64_t work_size)
#else  /* MODEL_FORCE */
model_status model_growth(const model_motion *motion, int n, real period,
    PARAMETERS_ARGUMENT real *growth, real *work, int64_t work_size)
#endif /* MODEL_FORCE */
{
#if MODEL_FORCE
    const growth_force pushed = {force, n_force, n_pre};
#endif /* MODEL_FORCE */
    growth_space *s = (growth_space *)(void *)work;
    const real *values = GIVEN_PARAMETERS;
    real *space, size = 1.0, found = 1.0;
    ptrdiff_t at = 0, last;
    int count, steps, status;
    if (growth == NULL || work == NULL || values == NULL || !has_state_and_torques(motion)) {
        return MODEL_NULL_ARGUMENT;
    }
    growth[0] = (real)NAN;
    if (work_size < model_growth_work()) {
        return MODEL_WORK_TOO_SMALL;
    }
    if (n < 2 || !(period > 0.0 && (real)n * period < 1e9)) {
        return MODEL_BAD_ARGUMENT;
    }
#if MODEL_FORCE
    if (force != NULL && (n_force < 1 || n_pre < 0)) {
        return MODEL_BAD_ARGUMENT;
    }
    for (ptrdiff_t k = 0; k < n_force && force != NULL; ++k) {
        if (!is_finite(force + k * FORCES, NY)) {
            return MODEL_INPUT_NOT_FINITE;
        }
    }
#endif /* MODEL_FORCE */
    space = work + padded((int64_t)(sizeof(growth_space) / sizeof(real)));
    last = last_moving(motion->v_a, n);
    count = (real)last * period < grid_step * GRID_MOST ? (int)((real)last * period / grid_step) :
                                                          GRID_MOST;
    count = count < GRID_FEWEST ? GRID_FEWEST : count;
    steps = count + (last < n - 1 ? HELD_STEPS : 0);
    for (int i = 0; i < DOF * DOF; ++i) {
        s->p[i] = i % (DOF + 1) == 0 ? 1.0 : 0.0;
        s->v[i] = 0.0;
    }
#if MODEL_FORCE
    status = growth_matrices(motion, &pushed, 0, values, s->before, s, space);
#else  /* MODEL_FORCE */
    status = growth_matrices(motion, 0, values, s->before, s, space);
#endif /* MODEL_FORCE */
    for (int k = 1; k <= steps && status == MODEL_OK; ++k) {
        const ptrdiff_t next = k > count ? last :
                                           (ptrdiff_t)(((int64_t)k * last + count - 1) / count);
        const real h = (k > count ? grid_step : (real)(next - at) * period) / (real)GROWTH_STEPS;
        real most;
        if (next == at && k <= count) {
            continue;
        }
        at = next;
#if MODEL_FORCE
        status = growth_matrices(motion, &pushed, at, values, s->now, s, space);
#else  /* MODEL_FORCE */
        status = growth_matrices(motion, at, values, s->now, s, space);
#endif /* MODEL_FORCE */
        if (status == MODEL_OK && !growth_system(s, h)) {
            status = MODEL_RESULT_NOT_FINITE;
        }
        for (int step = 0; step < GROWTH_STEPS && status == MODEL_OK; ++step) {
            growth_step(s, h);
        }
        most = fmax_1(largest(s->p, DOF * DOF), grid_step * largest(s->v, DOF * DOF));
        if (!(most > 0.0 && most < growth_max)) {
            return status == MODEL_OK ? MODEL_RESULT_NOT_FINITE : (model_status)status;
        }
        for (int i = 0; i < DOF * DOF; ++i) {
            s->p[i] /= most;
            s->v[i] /= most;
        }
        size = size < growth_max / most ? size * most : growth_max;
        {
            const real norm = growth_norm(s->p);
            found = fmax_1(
                found, norm > 1.0 && size > growth_max / norm ? growth_max : size * norm);
        }
        copy(s->now, 2 * DOF * DOF, s->before);
    }
    if (status == MODEL_OK) {
        growth[0] = found;
    }
    return (model_status)status;
}
