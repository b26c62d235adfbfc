/* model: inverse dynamics along a whole path. Written by flexgen; see model.h. */
#include "model.h"

#include "model_guess.h"
#include "model_lq.h"
#include "model_rest.h"
#include "model_results.h"

enum { ITERATIONS = 25, STILL = 8, SWEEPS = 3 };

typedef struct {
    int64_t samples, intervals;
    int64_t tau, twist, slope, late, y, a, a_node, q_g, reference, factor, scale, cost, lq, arm, space, end;
    int64_t still_y, still_a, still_q, still_reference, still_factor;
} layout;

static layout laid_out(int n, int lead, int tail, int every)
{
    layout l;
    int64_t at = 0;
    l.samples = (int64_t)lead + n + tail;
    l.intervals = (l.samples - 1 + every - 1) / every;
#define PLACE(name, size) \
    l.name = at; \
    at += room(size)
    PLACE(tau, (l.samples + 2 * MARGIN) * NG);
    PLACE(twist, (l.samples + 2 * MARGIN) * NG);
    PLACE(slope, l.samples * NG);
    PLACE(late, (l.samples + 2 * MARGIN) * NG);
#if MODEL_NE > 0
    PLACE(y, (l.intervals + 1) * STATES);
    PLACE(a, l.intervals * CONTROLS);
    PLACE(a_node, (l.intervals + 1) * NE);
    PLACE(q_g, l.intervals * STAGES * NG);
    PLACE(reference, l.intervals * STAGES * REFERENCE);
    PLACE(factor, l.intervals * CONTROLS * WIDTH);
    PLACE(scale, NE);
    PLACE(cost, STATES * STATES);
    PLACE(still_y, (STILL + 1) * STATES);
    PLACE(still_a, STILL * CONTROLS);
    PLACE(still_q, STILL * STAGES * NG);
    PLACE(still_reference, STILL * STAGES * REFERENCE);
    PLACE(still_factor, STILL * CONTROLS * WIDTH);
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

int64_t model_invert_work(int n, int lead, int tail, int every)
{
    const int64_t end = sizes_fit(n, lead, tail, every) ? laid_out(n, lead, tail, every).end : -1;
    return is_addressable(end) ? end : -1;
}

#if MODEL_NE > 0
/* Rest at the last place, and what it costs not to be there, for the end of a mesh. */
static int rest_cost(mesh *m, const layout *l, const real *place, const real *q_start, const real *joints, lq_space *w,
    real *work)
{
    real q[NA], scale[NE], reference[REFERENCE] = {0.0};
    mesh still = *m;
    int status;
    copy(q_start, NA, q);
    for (int i = 0; i < NG; ++i) {
        q[i_g[i]] = joints[i];
    }
    status = rest_at(place, q, scale, work + l->space);
    if (status != MODEL_OK) {
        return status;
    }
    copy(place, NT, reference);
    still.N = STILL;
    still.y = work + l->still_y;
    still.a = work + l->still_a;
    still.q_g = work + l->still_q;
    still.reference = work + l->still_reference;
    still.factor = work + l->still_factor;
    for (int k = 0; k <= STILL; ++k) {
        for (int i = 0; i < NE; ++i) {
            still.y[k * STATES + i] = q[i_e[i]];
            still.y[k * STATES + NE + i] = 0.0;
        }
    }
    for (int k = 0; k < STILL * CONTROLS; ++k) {
        still.a[k] = 0.0;
    }
    for (int k = 0; k < STILL * STAGES; ++k) {
        for (int i = 0; i < NG; ++i) {
            still.q_g[k * NG + i] = q[i_g[i]];
        }
        copy(reference, REFERENCE, still.reference + k * REFERENCE);
    }
    status = lq_endless(&still, SWEEPS, w, work + l->space, work + l->cost);
    m->end = work + l->cost;
    m->rest = still.y;
    return status;
}

/* The mesh's motion by Gauss-Newton steps; from rest. */
static int solve_mesh(mesh *m, real tolerance, int *iterations, lq_space *w, real *space)
{
    real before = -1.0;
    int worse = 0;
    for (*iterations = 1;; ++*iterations) {
        int status = lq_factor(m, w, space);
        if (status != MODEL_OK) {
            return status;
        }
        lq_step(m);
        status = evaluate_residual(m, w, space);
        if (status != MODEL_OK) {
            return status;
        }
        if (m->residual <= 1e-2 * tolerance ||
            (m->residual <= tolerance && before >= 0.0 && m->residual > 0.1 * before)) {
            return MODEL_OK;
        }
        worse = before >= 0.0 && m->residual > 0.5 * before ? worse + 1 : 0;
        if (*iterations == ITERATIONS || worse == 4 || !(m->residual < 1e12)) {
            return m->residual <= tolerance ? MODEL_OK : MODEL_NOT_CONVERGED;
        }
        before = m->residual;
    }
}

#endif

int model_invert(int n, double period, const double *place, const double *rate, const double *rate2,
    const double *q_start, int lead, int tail, int every, double tolerance, double *q_a, double *v_a, double *a_a,
    double *tau_g, double *q_m, double *v_m, double *tau_m, double *report, double *work, int64_t work_size)
{
    const path p = {n, period, place, rate, rate2};
    layout l;
    arm_points *arm;
    real *space, q[NA];
    int status;
#if MODEL_NE > 0
    mesh m;
#endif
    if (place == NULL || rate == NULL || rate2 == NULL || q_start == NULL || q_a == NULL || v_a == NULL ||
        a_a == NULL || tau_g == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || report == NULL ||
        work == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!sizes_fit(n, lead, tail, every) || !(period > 0.0 && period < 1e6) || !(tolerance > 0.0 && tolerance < 1.0)) {
        return MODEL_BAD_ARGUMENT;
    }
    l = laid_out(n, lead, tail, every);
    if (!is_addressable(l.end)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (work_size < l.end) {
        return MODEL_WORK_TOO_SMALL;
    }
    for (int i = 0; i < MODEL_INVERT_REPORT; ++i) {
        report[i] = (real)NAN;
    }
    status = check_path(&p, q_start);
    if (status != MODEL_OK) {
        return status;
    }
    arm = (arm_points *)(void *)(work + l.arm);
    space = work + l.space;
    copy(q_start, NA, q);
#if MODEL_NE > 0
    {
        int iterations = 0;
        lq_space *w = (lq_space *)(void *)(work + l.lq);
        m.N = (int)l.intervals;
        m.h = every * period;
        m.y = work + l.y;
        m.a = work + l.a;
        m.q_g = work + l.q_g;
        m.reference = work + l.reference;
        m.factor = work + l.factor;
        m.scale = work + l.scale;
        m.aim = NULL;
        m.end = NULL;
        m.rest = NULL;
        status = rest_at(place, q, m.scale, space);
        if (status != MODEL_OK) {
            return status;
        }
        status = guess_mesh(&m, &p, q, lead, every, arm, space);
        if (status != MODEL_OK) {
            return status;
        }
        status = rest_cost(&m, &l, place + (n - 1) * (ptrdiff_t)NT, q,
            m.q_g + ((ptrdiff_t)m.N * STAGES - 1) * NG, w, work);
        if (status != MODEL_OK) {
            return status;
        }
        status = solve_mesh(&m, tolerance, &iterations, w, space);
        report[0] = m.residual;
        report[2] = iterations;
        report[3] = m.N;
        if (status != MODEL_OK) {
            return status;
        }
        nodal_accelerations(&m, work + l.a_node);
    }
#else
    {
        status = rest_at(place, q, NULL, space);
        if (status != MODEL_OK) {
            return status;
        }
        report[0] = 0.0;
        report[2] = 0.0;
        report[3] = 0.0;
    }
#endif
    /* the motion of the arm at the samples, then the gears */
    {
        const results r = {&p, lead, every, (ptrdiff_t)l.samples, q_a, v_a, a_a, tau_g, q_m, v_m, tau_m, work + l.tau,
            work + l.twist, work + l.late, work + l.slope,
#if MODEL_NE > 0
            &m, work + l.a_node
#endif
        };
        status = arm_at_samples(&r, q, work + l.scale, arm, space, &report[1]);
        if (status == MODEL_OK) {
            status = motors_at_samples(&r, space);
        }
        if (status != MODEL_OK) {
            return status;
        }
        report[4] = unevenness(&r);
    }
    return judged(report[1], report[4], tolerance);
}
