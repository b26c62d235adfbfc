/* model: growth of perturbations along a motion. Written by flexgen; see model_inversion.h. */
#include "model_inversion.h"

#include "model_inversion_common.h"

/*
 * Under given motor torques a perturbation of the positions p and speeds v, of motors on the arm side, follows
 *
 *     dp/dt = v,    dv/dt = K p + D v,
 *
 * the linearized forward dynamics, constant between two instants of a grid. A step h of the implicit midpoint rule,
 * with the mean speed u, is
 *
 *     (1 - h/2 D - h^2/4 K) u = v + h/2 K p,    p += h u,    v = 2 u - v.
 *
 * It neither excites vibrations nor damps them. Columns of the matrices p and v: perturbations of one position each at
 * the start. Samples at rest at the end are left out, so that the result does not depend on their number; where there
 * are any, the last torque is held for HELD_STEPS of the grid.
 */
enum { DOF = MODEL_NX / 2, GROWTH_STEPS = 2, GRID_FEWEST = 50, GRID_MOST = 1000, POWER_STEPS = 12, HELD_STEPS = 50 };

static const real grid_step = 1e-2;                 /* s */
static const real slow_share = 1e-4;                /* of the largest speed */
static const real slow_speed = PRECISE(1e-9, 1e-6); /* rad/s or m/s: rounding */
static const real growth_max = PRECISE(1e300, 1e37);

typedef struct {
    real A[MODEL_NX * MODEL_NX], B[MODEL_NX * MODEL_NM]; /* by columns */
    real before[2 * DOF * DOF], now[2 * DOF * DOF];      /* K, then D, by rows, at two instants of the grid */
    real system[3 * DOF * DOF];                          /* S = (1 - h/2 D - h^2/4 K)^-1 and h/2 S K, behind it */
    real p[DOF * DOF], v[DOF * DOF];                     /* by rows */
} growth_space;

/* K and D at sample k. */
static int growth_matrices(
    const model_motion *motion, ptrdiff_t k, const real *parameters, real *to, growth_space *s, real *space)
{
    const int status = evaluate_linearize(motion->q_a + k * NA, motion->v_a + k * NA, motion->q_m + k * NM,
        motion->v_m + k * NM, motion->tau_m + k * NM, s->A, s->B, parameters, space);
    for (int part = 0; part < 2; ++part) {
        for (int i = 0; i < DOF; ++i) {
            for (int j = 0; j < DOF; ++j) {
                to[(part * DOF + i) * DOF + j] = s->A[(part * DOF + j) * MODEL_NX + DOF + i] / arm_side[i] *
                                                 arm_side[j];
            }
        }
    }
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

model_status model_growth(
    const model_motion *motion, int n, real period, PARAMETERS_ARGUMENT real *growth, real *work, int64_t work_size)
{
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
    space = work + padded((int64_t)(sizeof(growth_space) / sizeof(real)));
    last = last_moving(motion->v_a, n);
    count = (real)last * period < grid_step * GRID_MOST ? (int)((real)last * period / grid_step) : GRID_MOST;
    count = count < GRID_FEWEST ? GRID_FEWEST : count;
    steps = count + (last < n - 1 ? HELD_STEPS : 0);
    for (int i = 0; i < DOF * DOF; ++i) {
        s->p[i] = i % (DOF + 1) == 0 ? 1.0 : 0.0;
        s->v[i] = 0.0;
    }
    status = growth_matrices(motion, 0, values, s->before, s, space);
    for (int k = 1; k <= steps && status == MODEL_OK; ++k) {
        const ptrdiff_t next = k > count ? last : (ptrdiff_t)(((int64_t)k * last + count - 1) / count);
        const real h = (k > count ? grid_step : (real)(next - at) * period) / (real)GROWTH_STEPS;
        real most;
        if (next == at && k <= count) {
            continue;
        }
        at = next;
        status = growth_matrices(motion, at, values, s->now, s, space);
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
            found = fmax_1(found, norm > 1.0 && size > growth_max / norm ? growth_max : size * norm);
        }
        copy(s->now, 2 * DOF * DOF, s->before);
    }
    if (status == MODEL_OK) {
        growth[0] = found;
    }
    return (model_status)status;
}
