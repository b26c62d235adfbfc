/* elbow: inverse dynamics along a whole path. Written by flexgen; see elbow.h. */
#include "elbow.h"

#include "elbow_lq.h"
#include "elbow_motors.h"
#include "elbow_rest.h"

enum { ITERATIONS = 25, MOST_SAMPLES = 1000000 };

/* Room in the workspace, in numbers; whole vectors apart. */
static ptrdiff_t room(ptrdiff_t n)
{
    return (n + 7) / 8 * 8;
}

typedef struct {
    ptrdiff_t samples, intervals;
    ptrdiff_t tau, twist, slope, late, y, a, a_node, q_g, reference, factor, scale, lq, arm, space, end;
} layout;

/* Largest of the workspaces that the functions used here want. */
static ptrdiff_t space_wanted(void)
{
    ptrdiff_t most = ELBOW_OUTPUT_CONSTRAINT_BATCH_WORK;
#if ELBOW_NE > 0
    most = most < ELBOW_INVERSION_SLOPES_BATCH_WORK ? ELBOW_INVERSION_SLOPES_BATCH_WORK : most;
    most = most < ELBOW_INVERSION_SLOPES_WORK ? ELBOW_INVERSION_SLOPES_WORK : most;
#endif
    most = most < ELBOW_OUTPUT_CONSTRAINT_WORK ? ELBOW_OUTPUT_CONSTRAINT_WORK : most;
    most = most < ELBOW_INVERSION_ROWS_BATCH_WORK ? ELBOW_INVERSION_ROWS_BATCH_WORK : most;
    most = most < ELBOW_GEAR_LAW_WORK ? ELBOW_GEAR_LAW_WORK : most;
    most = most < ELBOW_MOTOR_FRICTION_WORK ? ELBOW_MOTOR_FRICTION_WORK : most;
    return most + 8;
}

static layout laid_out(int n, int lead, int tail, int every)
{
    layout l;
    ptrdiff_t at = 0;
    l.samples = (ptrdiff_t)lead + n + tail;
    l.intervals = (l.samples - 1 + every - 1) / every;
#define PLACE(name, size) \
    l.name = at; \
    at += room(size)
    PLACE(tau, (l.samples + 2 * MARGIN) * NG);
    PLACE(twist, (l.samples + 2 * MARGIN) * NG);
    PLACE(slope, l.samples * NG);
    PLACE(late, (l.samples + 2 * MARGIN) * NG);
#if ELBOW_NE > 0
    PLACE(y, (l.intervals + 1) * STATES);
    PLACE(a, l.intervals * CONTROLS);
    PLACE(a_node, (l.intervals + 1) * NE);
    PLACE(q_g, l.intervals * STAGES * NG);
    PLACE(reference, l.intervals * STAGES * REFERENCE);
    PLACE(factor, l.intervals * CONTROLS * WIDTH);
    PLACE(scale, NE);
    PLACE(lq, (ptrdiff_t)(sizeof(lq_space) / sizeof(real)));
#else
    l.y = l.a = l.a_node = l.q_g = l.reference = l.factor = l.scale = l.lq = 0;
#endif
    PLACE(arm, (ptrdiff_t)(sizeof(arm_points) / sizeof(real)));
    PLACE(space, space_wanted());
#undef PLACE
    l.end = at;
    return l;
}

static int sizes_fit(int n, int lead, int tail, int every)
{
    return n >= 2 && lead >= 0 && tail >= 0 && every >= 1 && n <= MOST_SAMPLES && lead <= MOST_SAMPLES &&
        tail <= MOST_SAMPLES && every <= MOST_SAMPLES;
}

int64_t elbow_invert_work(int n, int lead, int tail, int every)
{
    return sizes_fit(n, lead, tail, every) ? (int64_t)laid_out(n, lead, tail, every).end : -1;
}

#if ELBOW_POSE
/* Rotations that are rotations, and no further apart than a sample may turn. */
static int places_fit(const path *p)
{
    for (int k = 0; k < p->n; ++k) {
        const real *R = p->place + k * (ptrdiff_t)NT + 3;
        for (int i = 0; i < 3; ++i) {
            real c[3];
            for (int j = 0; j < 3; ++j) {
                const real *a = R + 3 * i, *b = R + 3 * j;
                const real dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
                if (!(fabs_1(dot - (i == j ? 1.0 : 0.0)) < 1e-6)) {
                    return 0;
                }
            }
            cross(R + 3 * i, R + 3 * ((i + 1) % 3), c);
            for (int j = 0; j < 3; ++j) {
                if (!(fabs_1(c[j] - R[3 * ((i + 2) % 3) + j]) < 1e-6)) {
                    return 0;
                }
            }
        }
        if (k > 0) {
            real f[3];
            turned(R - NT, R, f);
            if (!(largest(f, 3) < 0.3)) {
                return 0;
            }
        }
    }
    return 1;
}
#endif

#if ELBOW_NE > 0
/* The mesh's motion by Gauss-Newton steps; from rest. */
static int solve_mesh(mesh *m, real tolerance, int *iterations, lq_space *w, real *space)
{
    real before = -1.0;
    int worse = 0;
    for (*iterations = 1;; ++*iterations) {
        int status = lq_factor(m, w, space);
        if (status != ELBOW_OK) {
            return status;
        }
        lq_step(m, 1.0);
        for (int i = 0; i < NE; ++i) { /* the end is drawn to rest, wherever it is */
            m->aim[i] = m->y[(ptrdiff_t)m->N * STATES + i];
            m->aim[NE + i] = 0.0;
        }
        status = evaluate_residual(m, w, space);
        if (status != ELBOW_OK) {
            return status;
        }
        if (m->residual <= 1e-2 * tolerance ||
            (m->residual <= tolerance && before >= 0.0 && m->residual > 0.1 * before)) {
            return ELBOW_OK;
        }
        worse = before >= 0.0 && m->residual > 0.5 * before ? worse + 1 : 0;
        if (*iterations == ITERATIONS || worse == 4 || !(m->residual < 1e12)) {
            return m->residual <= tolerance ? ELBOW_OK : ELBOW_NOT_CONVERGED;
        }
        before = m->residual;
    }
}

/* Second derivative at x of x^3 (1 - x)^3 x^k, and the two lower ones. */
static void bump(real x, int k, real out[3])
{
    static const real c[4] = {1.0, -3.0, 3.0, -1.0};
    out[0] = out[1] = out[2] = 0.0;
    for (int i = 3; i >= 0; --i) {
        const int degree = 3 + i + k;
        real power = c[i];
        for (int j = 0; j < degree - 2; ++j) {
            power *= x;
        }
        out[0] += power * x * x;
        out[1] += degree * power * x;
        out[2] += degree * (degree - 1) * power;
    }
}

/* Coordinates in an interval: the polynomial with value and two derivatives at its nodes and a_e at its Gauss points. */
typedef struct {
    real inverse[STAGES][STAGES];
} interpolant;

static void prepare(interpolant *f)
{
    for (int c = 0; c < STAGES; ++c) {
        real a[3][4], out[3];
        for (int i = 0; i < STAGES; ++i) {
            for (int j = 0; j < STAGES; ++j) {
                bump(gauss_c[i], j, out);
                a[i][j] = out[2];
            }
            a[i][3] = i == c ? 1.0 : 0.0;
        }
        solve_three(a);
        for (int i = 0; i < STAGES; ++i) {
            f->inverse[i][c] = a[i][3];
        }
    }
}

static void between(const interpolant *f, const real left[3], const real right[3], const real *a, ptrdiff_t stride,
    real h, real x, real out[3])
{
    real miss[STAGES], own[3];
    for (int i = 0; i < STAGES; ++i) {
        quintic(gauss_c[i], left, right, own);
        miss[i] = h * h * a[i * stride] - own[2];
    }
    quintic(x, left, right, out);
    for (int i = 0; i < STAGES; ++i) {
        real weight = 0.0;
        for (int j = 0; j < STAGES; ++j) {
            weight += f->inverse[i][j] * miss[j];
        }
        bump(x, i, own);
        for (int j = 0; j < 3; ++j) {
            out[j] += weight * own[j];
        }
    }
}

/* Accelerations at the nodes: the polynomial through the Gauss points on both sides. */
static void nodal_accelerations(const mesh *m, real *a_node)
{
    real weight[2 * STAGES], end[STAGES];
    for (int i = 0; i < 2 * STAGES; ++i) {
        const real x = i < STAGES ? gauss_c[i] - 1.0 : gauss_c[i - STAGES];
        weight[i] = 1.0;
        for (int j = 0; j < 2 * STAGES; ++j) {
            const real other = j < STAGES ? gauss_c[j] - 1.0 : gauss_c[j - STAGES];
            if (j != i) {
                weight[i] *= other / (other - x);
            }
        }
    }
    for (int i = 0; i < STAGES; ++i) {
        end[i] = 1.0;
        for (int j = 0; j < STAGES; ++j) {
            if (j != i) {
                end[i] *= (1.0 - gauss_c[j]) / (gauss_c[i] - gauss_c[j]);
            }
        }
    }
    for (int k = 0; k <= m->N; ++k) {
        const real *right = m->a + (ptrdiff_t)k * CONTROLS, *left = right - CONTROLS;
        for (int i = 0; i < NE; ++i) {
            real sum = 0.0;
            for (int s = 0; s < STAGES; ++s) {
                if (k == m->N) {
                    sum += end[s] * left[s * NE + i];
                } else {
                    sum += (k > 0 ? weight[s] * left[s * NE + i] : 0.0) + weight[STAGES + s] * right[s * NE + i];
                }
            }
            a_node[(ptrdiff_t)k * NE + i] = k == 0 ? 0.0 : sum;
        }
    }
}
#endif

int elbow_invert(int n, double period, const double *place, const double *rate, const double *rate2,
    const double *q_start, int lead, int tail, int every, double tolerance, double *q_a, double *v_a, double *a_a,
    double *tau_g, double *q_m, double *v_m, double *tau_m, double *report, double *work, int64_t work_size)
{
    const path p = {n, period, place, rate, rate2};
    layout l;
    arm_points *arm;
    real *space, q[NA], last[NG];
    int status, quick[NG];
#if ELBOW_NE > 0
    interpolant f;
#endif
    if (place == NULL || rate == NULL || rate2 == NULL || q_start == NULL || q_a == NULL || v_a == NULL ||
        a_a == NULL || tau_g == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || report == NULL ||
        work == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!sizes_fit(n, lead, tail, every) || !(period > 0.0 && period < 1e6) || !(tolerance > 0.0 && tolerance < 1.0)) {
        return ELBOW_BAD_ARGUMENT;
    }
    l = laid_out(n, lead, tail, every);
    if (work_size < l.end) {
        return ELBOW_WORK_TOO_SMALL;
    }
    for (int i = 0; i < ELBOW_INVERT_REPORT; ++i) {
        report[i] = (real)NAN;
    }
    for (int k = 0; k < n; ++k) {
        if (!is_finite(place + k * (ptrdiff_t)NT, NT) || !is_finite(rate + k * (ptrdiff_t)NY, NY) ||
            !is_finite(rate2 + k * (ptrdiff_t)NY, NY)) {
            return ELBOW_INPUT_NOT_FINITE;
        }
    }
    if (!is_finite(q_start, NA)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
#if ELBOW_POSE
    if (!places_fit(&p)) {
        return ELBOW_BAD_ARGUMENT;
    }
#endif
    arm = (arm_points *)(void *)(work + l.arm);
    space = work + l.space;
    for (int i = 0; i < NA; ++i) {
        q[i] = q_start[i];
    }
#if ELBOW_NE > 0
    {
        int iterations = 0;
        mesh m;
        lq_space *w = (lq_space *)(void *)(work + l.lq);
        real aim[STATES];
        m.N = (int)l.intervals;
        m.h = every * period;
        m.y = work + l.y;
        m.a = work + l.a;
        m.q_g = work + l.q_g;
        m.reference = work + l.reference;
        m.factor = work + l.factor;
        m.scale = work + l.scale;
        m.aim = aim;
        status = rest_at(place, q, m.scale, space);
        if (status != ELBOW_OK) {
            return status;
        }
        for (ptrdiff_t k = 0; k <= m.N; ++k) {
            for (int i = 0; i < NE; ++i) {
                m.y[k * STATES + i] = q[i_e[i]];
                m.y[k * STATES + NE + i] = 0.0;
            }
        }
        for (int i = 0; i < STATES; ++i) {
            aim[i] = m.y[i];
        }
        for (ptrdiff_t k = 0; k < (ptrdiff_t)m.N * CONTROLS; ++k) {
            m.a[k] = 0.0;
        }
        for (int i = 0; i < NG; ++i) {
            last[i] = q[i_g[i]];
        }
        for (int at = 0; at < m.N * STAGES; at += POINTS) { /* where the joints are, if nothing deflects further */
            const int used = m.N * STAGES - at < POINTS ? m.N * STAGES - at : POINTS;
            for (int k = at; k < at + used; ++k) {
                const real x = (k / STAGES + gauss_c[k % STAGES]) * every - lead;
                const int whole = (int)(x < 0.0 ? x - 1.0 : x);
                reference_at(&p, whole, x - whole, m.reference + (ptrdiff_t)k * REFERENCE);
                for (int i = 0; i < NG; ++i) {
                    m.q_g[(ptrdiff_t)k * NG + i] = last[i];
                }
            }
            for (int point = 0; point < POINTS; ++point) {
                load_point(&m, at + (point < used ? point : used - 1), arm, point);
            }
            status = follow(arm, space);
            if (status != ELBOW_OK) {
                return status;
            }
            for (int k = 0; k < used; ++k) {
                for (int i = 0; i < NG; ++i) {
                    last[i] = arm->q[i_g[i]][k];
                    m.q_g[(ptrdiff_t)(at + k) * NG + i] = last[i];
                }
            }
        }
        status = solve_mesh(&m, tolerance, &iterations, w, space);
        report[0] = m.residual;
        report[2] = iterations;
        report[3] = m.N;
        if (status != ELBOW_OK) {
            return status;
        }
        nodal_accelerations(&m, work + l.a_node);
    }
#else
    {
        status = rest_at(place, q, NULL, space);
        if (status != ELBOW_OK) {
            return status;
        }
        report[0] = 0.0;
        report[2] = 0.0;
        report[3] = 0.0;
    }
#endif
    /* the motion of the arm at the samples */
#if ELBOW_NE > 0
    prepare(&f);
#endif
    report[1] = 0.0;
    for (int i = 0; i < NG; ++i) {
        last[i] = q[i_g[i]];
    }
    for (ptrdiff_t at = 0; at < l.samples; at += POINTS) {
        const int used = (int)(l.samples - at < POINTS ? l.samples - at : POINTS);
        for (int point = 0; point < POINTS; ++point) {
            const ptrdiff_t k = at + (point < used ? point : used - 1);
            real reference[REFERENCE];
            reference_at(&p, (int)(k - lead), 0.0, reference);
            for (int i = 0; i < NT; ++i) {
                arm->place[i][point] = reference[i];
            }
            for (int i = 0; i < NY; ++i) {
                arm->rate[i][point] = reference[NT + i];
                arm->rate2[i][point] = reference[NT + NY + i];
            }
            for (int i = 0; i < NG; ++i) {
                arm->q[i_g[i]][point] = last[i];
                arm->v[i_g[i]][point] = 0.0;
                arm->a[i_g[i]][point] = 0.0;
            }
#if ELBOW_NE > 0
            {
                const ptrdiff_t interval = k / every < l.intervals ? k / every : l.intervals - 1;
                const real h = every * period, x = (real)(k - interval * every) / every;
                const real *y0 = work + l.y + interval * STATES, *y1 = y0 + STATES;
                const real *a0 = work + l.a_node + interval * NE, *a1 = a0 + NE;
                for (int i = 0; i < NE; ++i) {
                    const real left[3] = {y0[i], h * y0[NE + i], h * h * a0[i]};
                    const real right[3] = {y1[i], h * y1[NE + i], h * h * a1[i]};
                    real out[3];
                    between(&f, left, right, work + l.a + interval * CONTROLS + i, NE, h, x, out);
                    arm->q[i_e[i]][point] = out[0];
                    arm->v[i_e[i]][point] = out[1] / h;
                    arm->a[i_e[i]][point] = out[2] / (h * h);
                }
            }
#endif
        }
        status = follow(arm, space);
        if (status != ELBOW_OK) {
            return status;
        }
#if ELBOW_NE > 0
        status = elbow_inversion_rows_batch(POINTS, &arm->q[0][0], &arm->v[0][0], &arm->a[0][0], &arm->tau_g[0][0],
            &arm->row[0][0], space);
#else
        status = elbow_inversion_rows_batch(POINTS, &arm->q[0][0], &arm->v[0][0], &arm->a[0][0], &arm->tau_g[0][0],
            space);
#endif
        if (status != ELBOW_OK) {
            return status;
        }
        for (int k = 0; k < used; ++k) {
            for (int i = 0; i < NA; ++i) {
                q_a[(at + k) * NA + i] = arm->q[i][k];
                v_a[(at + k) * NA + i] = arm->v[i][k];
                a_a[(at + k) * NA + i] = arm->a[i][k];
            }
            for (int i = 0; i < NG; ++i) {
                tau_g[(at + k) * NG + i] = arm->tau_g[i][k];
                work[l.tau + (at + k + MARGIN) * NG + i] = arm->tau_g[i][k];
                last[i] = arm->q[i_g[i]][k];
            }
#if ELBOW_NE > 0
            for (int i = 0; i < NE; ++i) {
                report[1] = fmax_1(report[1], fabs_1(arm->row[i][k]) / work[l.scale + i]);
            }
#endif
        }
    }
    /* the gears */
#define HOLD(array) \
    for (ptrdiff_t k = 0; k < MARGIN * NG; ++k) { \
        work[l.array + k] = work[l.array + MARGIN * NG + k % NG]; \
        work[l.array + (l.samples + MARGIN) * NG + k] = work[l.array + (l.samples + MARGIN - 1) * NG + k % NG]; \
    }
    HOLD(tau)
    for (int i = 0; i < NG; ++i) {
        quick[i] = 1;
        last[i] = 0.0;
    }
    for (ptrdiff_t k = 0; k < l.samples; ++k) {
        real slope[NG];
        if (!static_twist(work + l.tau + (k + MARGIN) * NG, last, slope, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        for (int i = 0; i < NG; ++i) {
            work[l.twist + (k + MARGIN) * NG + i] = last[i];
            work[l.slope + k * NG + i] = slope[i];
            quick[i] = quick[i] && follows_at_once(i, slope[i], period);
        }
    }
    HOLD(twist)
    {
        real now[NG], left[NG][3], right[NG][3];
        int slow = 0;
        for (int i = 0; i < NG; ++i) {
            now[i] = work[l.twist + MARGIN * NG + i];
            slow |= !quick[i];
        }
        for (ptrdiff_t k = 0; k < l.samples; ++k) {
            const real *tau = work + l.tau + (k + MARGIN) * NG, *twist = work + l.twist + (k + MARGIN) * NG;
            for (int i = 0; i < NG && slow; ++i) {
                for (int j = 0; j < 3; ++j) {
                    left[i][j] = right[i][j];
                }
                right[i][0] = tau[i];
                right[i][1] = period * slope_of(tau + i, NG, period);
                right[i][2] = period * period * curvature_of(tau + i, NG, period);
            }
            if (slow && k > 0 && !twist_step(period, left, right, now, space)) {
                return ELBOW_RESULT_NOT_FINITE;
            }
            for (int i = 0; i < NG; ++i) {
                const real lag = gear_is_rigid[i] ? 0.0 : gear_damping[i] / work[l.slope + k * NG + i];
                work[l.late + (k + MARGIN) * NG + i] =
                    quick[i] ? twist[i] - lag * slope_of(twist + i, NG, period) : now[i];
            }
        }
    }
    HOLD(late)
#undef HOLD
    for (ptrdiff_t k = 0; k < l.samples; ++k) {
        const real *tau = work + l.tau + (k + MARGIN) * NG, *twist = work + l.late + (k + MARGIN) * NG;
        real value[NG], slope[NG], theta[NG], omega[NG], alpha[NG];
        if (elbow_gear_law(twist, value, slope, space) != ELBOW_OK) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        for (int i = 0; i < NG; ++i) {
            real once, twice;
            if (quick[i]) {
                once = slope_of(twist + i, NG, period);
                twice = curvature_of(twist + i, NG, period);
            } else {
                once = (tau[i] - value[i]) / gear_damping[i];
                twice = (slope_of(tau + i, NG, period) - slope[i] * once) / gear_damping[i];
            }
            theta[i] = q_a[k * NA + i_g[i]] + twist[i];
            omega[i] = v_a[k * NA + i_g[i]] + once;
            alpha[i] = a_a[k * NA + i_g[i]] + twice;
        }
        if (!motors_of(theta, omega, alpha, tau, q_m + k * NM, v_m + k * NM, tau_m + k * NM, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
    }
    return report[0] <= tolerance ? ELBOW_OK : ELBOW_NOT_CONVERGED;
}
