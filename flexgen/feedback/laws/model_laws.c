/*
 * Feedback laws that evaluate a robot's model at every sample: steps of flexgen's sampled closed
 * loop.
 *
 * What all robots share is in law_shared; the memory of one robot is law_own with its arrays.
 * Functions of the model are the batch functions of its emitted library, called for one point. The
 * same operations are done in the same order by model_laws.py.
 */
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__GNUC__)
#define LAW_API __attribute__((visibility("default")))
#else
#define LAW_API
#endif

/* Functions of the model's library for n points. */
typedef int (*law_dynamics)(int n, const double *q_a, const double *v_a, const double *q_m,
    const double *v_m, const double *tau_m, double *a_a, double *a_m, double *work);
typedef int (*law_motion)(int n, const double *q_a, const double *v_a, const double *q_m,
    const double *v_m, double *a_a, double *j_a, double *work);
typedef int (*law_torque)(int n, const double *q_a, const double *v_a, const double *a_a,
    const double *j_a, const double *s_a, const double *q_m, const double *v_m, double *tau_m,
    double *work);
typedef int (*law_rows)(
    int n, const double *q_a, const double *v_a, const double *a_a, double *tau_g, double *work);
typedef int (*law_friction)(int n, const double *v_m, double *f_m, double *work);
typedef int (*law_gear)(
    int n, const double *deflection, double *tau_p, double *dtau_p, double *work);

typedef struct {
    /* joints, which are as many as motors; measured channels, motor angles first */
    int64_t n, n_y;
    /* first channel of the exact state q_a, v_a, q_m, v_m; -1: speeds are differences */
    int64_t state;
    int64_t samples, columns; /* of the table */
    int64_t delayed;          /* torques of the past that the prediction needs */
    /* of the prediction over the delay, each with its torque, duration and steps */
    int64_t segments;
    /* of the prediction over half a sample; 0: the state is not predicted */
    int64_t half_steps;
    double sample_s;
    const int64_t *channels; /* (n): of the arm angles, where the state is not measured */
    /* (samples, columns): reference of each sample, the last one to the end */
    const double *table;
    const double *gains; /* (4, n) */
    /* gear ratios, eta^-1 and eta^-T by columns (n, n); rotors (n) */
    const double *eta, *inverse, *back, *inertia;
    /* (segments): how many samples old its torque is; steps */
    const int64_t *past, *steps;
    const double *durations; /* (segments) [s] */
    void (*motion)(void);
    void (*torque)(void);
    void (*dynamics)(void);
    void (*rows)(void);
    void (*friction)(void);
    void (*gear)(void);
    double *work;
    double *scratch; /* 32 n */
} law_shared;

typedef struct {
    const law_shared *shared;
    /*
     * then the last q_a and q_m (n each), torques of the last samples, the newest first (delayed,
     * n)
     */
} law_own;

/* out = A x, summed from the first column to the last. */
static void times(const double *A, const double *x, size_t n, double *out)
{
    for (size_t i = 0; i < n; ++i) {
        out[i] = 0.0;
    }
    for (size_t j = 0; j < n; ++j) {
        for (size_t i = 0; i < n; ++i) {
            out[i] += A[j * n + i] * x[j];
        }
    }
}

static const double *reference_of(const law_shared *s, int64_t k)
{
    return s->table + (size_t)(k < s->samples ? k : s->samples - 1) * (size_t)s->columns;
}

/* The measured state x = (q_a, v_a, q_m, v_m). */
static void measured_state(law_own *own, int64_t k, const double *y, double *x)
{
    const law_shared *s = own->shared;
    size_t n = (size_t)s->n;
    double *q_a = (double *)(own + 1), *q_m = q_a + n;
    if (s->state >= 0) {
        memcpy(x, y + s->state, 4 * n * sizeof *x);
        return;
    }
    for (size_t i = 0; i < n; ++i) {
        double arm = s->channels ? y[s->channels[i]] : 0.0;
        x[i] = arm;
        x[n + i] = k == 0 ? 0.0 : (arm - q_a[i]) / s->sample_s;
        x[2 * n + i] = y[i];
        x[3 * n + i] = k == 0 ? 0.0 : (y[i] - q_m[i]) / s->sample_s;
        q_a[i] = arm;
        q_m[i] = y[i];
    }
}

/* Rate dx of the state x = (q_a, v_a, q_m, v_m) under the torques tau. */
static int state_rate(const law_shared *s, const double *x, const double *tau, double *dx)
{
    size_t n = (size_t)s->n;
    memcpy(dx, x + n, n * sizeof *dx);
    memcpy(dx + 2 * n, x + 3 * n, n * sizeof *dx);
    return ((law_dynamics)s->dynamics)(
        1, x, x + n, x + 2 * n, x + 3 * n, tau, dx + n, dx + 3 * n, s->work);
}

/* Integrate the state x over h * steps under the torques tau: Runge-Kutta method of order four. */
static int integrate(const law_shared *s, double *x, const double *tau, double h, int64_t steps)
{
    size_t n = (size_t)s->n, m = 4 * n;
    double *k1 = s->scratch + 8 * n, *k2 = k1 + m, *k3 = k2 + m, *k4 = k3 + m, *at = k4 + m;
    for (int64_t step = 0; step < steps; ++step) {
        int status = state_rate(s, x, tau, k1);
        for (size_t i = 0; i < m; ++i) {
            at[i] = x[i] + 0.5 * h * k1[i];
        }
        status |= state_rate(s, at, tau, k2);
        for (size_t i = 0; i < m; ++i) {
            at[i] = x[i] + 0.5 * h * k2[i];
        }
        status |= state_rate(s, at, tau, k3);
        for (size_t i = 0; i < m; ++i) {
            at[i] = x[i] + h * k3[i];
        }
        status |= state_rate(s, at, tau, k4);
        for (size_t i = 0; i < m; ++i) {
            x[i] += h / 6.0 * ((k1[i] + k4[i]) + 2.0 * (k2[i] + k3[i]));
        }
        if (status != 0) {
            return status;
        }
    }
    return 0;
}

/* The state when the new torque begins to act, with the torques under way. */
static int predict(const law_own *own, double *x)
{
    const law_shared *s = own->shared;
    const double *torques = (const double *)(own + 1) + 2 * (size_t)s->n;
    int status = 0;
    for (size_t part = 0; part < (size_t)s->segments && status == 0; ++part) {
        const double *tau = torques + (size_t)(s->past[part] - 1) * (size_t)s->n;
        status = integrate(s, x, tau, s->durations[part] / (double)s->steps[part], s->steps[part]);
    }
    return status;
}

/* Keep the new torque for the predictions of the next samples. */
static void remember(law_own *own, const double *u)
{
    const law_shared *s = own->shared;
    size_t n = (size_t)s->n;
    double *torques = (double *)(own + 1) + 2 * n;
    if (s->delayed > 0) {
        memmove(torques + n, torques, (size_t)(s->delayed - 1) * n * sizeof *torques);
        memcpy(torques, u, n * sizeof *torques);
    }
}

/* Torques u at the state x for the reference d. */
static int linearised(const law_shared *s, const double *x, const double *d, double *u)
{
    size_t n = (size_t)s->n;
    double *a = s->scratch + 4 * n, *j = a + n, *fourth = j + n;
    const double *g = s->gains;
    if (((law_motion)s->motion)(1, x, x + n, x + 2 * n, x + 3 * n, a, j, s->work) != 0) {
        return 1;
    }
    for (size_t i = 0; i < n; ++i) {
        fourth[i] = d[4 * n + i] + g[3 * n + i] * (d[3 * n + i] - j[i]) +
                    g[2 * n + i] * (d[2 * n + i] - a[i]) + g[n + i] * (d[n + i] - x[n + i]) +
                    g[i] * (d[i] - x[i]);
    }
    return ((law_torque)s->torque)(1, x, x + n, a, j, fourth, x + 2 * n, x + 3 * n, u, s->work);
}

/*
 * Feedback linearization of an arm with elastic joints:
 *
 *     s = s_d + g_3 (j_d - j) + g_2 (a_d - a) + g_1 (v_d - v) + g_0 (q_d - q),    u = torque(q, v,
 *       a, j, s, q_m, v_m)
 *
 * a, j from the state. Predicted: the state continues over the delay with the torques under way,
 * and from there over half a sample with the torque of the law there. Columns of the table: q_d,
 * v_d, a_d, j_d, s_d where the law is evaluated; predicted: before them the same where the torque
 * begins to act.
 */
LAW_API int flexgen_law_linearisation(
    void *self, int64_t k, const double *y, const double *ref, double *u)
{
    law_own *own = (law_own *)self;
    const law_shared *s = own->shared;
    double *x = s->scratch;
    const double *d = reference_of(s, k);
    (void)ref;
    measured_state(own, k, y, x);
    if (predict(own, x) != 0) {
        return 1;
    }
    if (s->half_steps > 0) {
        if (linearised(s, x, d, u) != 0 ||
            integrate(s, x, u, 0.5 * s->sample_s / (double)s->half_steps, s->half_steps) != 0) {
            return 1;
        }
        d += 5 * (size_t)s->n;
    }
    if (linearised(s, x, d, u) != 0) {
        return 1;
    }
    remember(own, u);
    return 0;
}

/*
 * Computed torque of the rigid robot, from the motor angles alone: q = eta^-1 q_m,
 *
 *     a = a_d + g_1 (v_d - v) + g_0 (q_d - q),    u = J_m eta a + f(v_m) + eta^-T (M a + c + g -
 *       f_a)
 *
 * Columns of the table: q_d, v_d, a_d.
 */
LAW_API int flexgen_law_computed_torque(
    void *self, int64_t k, const double *y, const double *ref, double *u)
{
    law_own *own = (law_own *)self;
    const law_shared *s = own->shared;
    size_t n = (size_t)s->n;
    double *x = s->scratch, *q = x + 4 * n, *v = q + n, *a = v + n, *turning = a + n,
           *T = turning + n, *f = T + n;
    double *carried = f + n;
    const double *d = reference_of(s, k), *g = s->gains;
    (void)ref;
    measured_state(own, k, y, x);
    times(s->inverse, x + 2 * n, n, q);
    times(s->inverse, x + 3 * n, n, v);
    for (size_t i = 0; i < n; ++i) {
        a[i] = d[2 * n + i] + g[n + i] * (d[n + i] - v[i]) + g[i] * (d[i] - q[i]);
    }
    if (((law_rows)s->rows)(1, q, v, a, T, s->work) != 0 ||
        ((law_friction)s->friction)(1, x + 3 * n, f, s->work) != 0) {
        return 1;
    }
    times(s->eta, a, n, turning);
    times(s->back, T, n, carried);
    for (size_t i = 0; i < n; ++i) {
        u[i] = s->inertia[i] * turning[i] + f[i] + carried[i];
    }
    return 0;
}

/*
 * Feedback of motor angle, motor speed, joint torque and its rate, motor side; T = eta^-T
 * spring(eta^-1 q_m - q):
 *
 *     u = u_d + g_0 (q_m,d - q_m) + g_1 (v_m,d - v_m) + g_2 (T_d - T) + g_3 (T_d' - T')
 *
 * Columns of the table: u_d, q_m,d, v_m,d, T_d, T_d'. Without the function of the gears the terms
 * of T are left out.
 */
LAW_API int flexgen_law_joint_torque(
    void *self, int64_t k, const double *y, const double *ref, double *u)
{
    law_own *own = (law_own *)self;
    const law_shared *s = own->shared;
    size_t n = (size_t)s->n;
    double *x = s->scratch, *d = x + 4 * n, *rate = d + n, *p = rate + n, *dp = p + n, *T = dp + n,
           *dT = T + n;
    const double *r = reference_of(s, k), *g = s->gains;
    (void)ref;
    measured_state(own, k, y, x);
    for (size_t i = 0; i < n; ++i) {
        u[i] = r[i] + g[i] * (r[n + i] - x[2 * n + i]) + g[n + i] * (r[2 * n + i] - x[3 * n + i]);
    }
    if (!s->gear) {
        return 0;
    }
    times(s->inverse, x + 2 * n, n, d);
    times(s->inverse, x + 3 * n, n, rate);
    for (size_t i = 0; i < n; ++i) {
        d[i] -= x[i];
        rate[i] -= x[n + i];
    }
    if (((law_gear)s->gear)(1, d, p, dp, s->work) != 0) {
        return 1;
    }
    for (size_t i = 0; i < n; ++i) {
        rate[i] *= dp[i];
    }
    times(s->back, p, n, T);
    times(s->back, rate, n, dT);
    for (size_t i = 0; i < n; ++i) {
        u[i] = u[i] + g[2 * n + i] * (r[3 * n + i] - T[i]) + g[3 * n + i] * (r[4 * n + i] - dT[i]);
    }
    return 0;
}
