/*
 * model: inverse dynamics along a path as a two-point problem. Written by flexgen; see model.h.
 *
 * At the start the motion may differ from rest by what grows, at the end by what fades; between them the equations hold
 * at the Gauss points, and Newton's method solves all together. Nothing is weighed against anything, so that it is the
 * independent check of invert; it needs a zero dynamics that splits in the same way at both ends.
 */
#include "model.h"

#include "model_blocks.h"
#include "model_guess.h"
#include "model_pencil.h"
#include "model_rest.h"
#include "model_results.h"

enum { NEWTON_STEPS = 25 };

static const real rounding = 1e-6; /* of the tolerance: Newton's method gets there in a step more */

typedef struct {
    int64_t samples, intervals;
    int64_t tau, twist, slope, late, y, a, a_node, q_g, reference, factor, scale, problem, blocks, space, end;
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
    PLACE(y, (l.intervals + 1) * STATES);
    PLACE(a, l.intervals * CONTROLS);
    PLACE(a_node, (l.intervals + 1) * NE);
    PLACE(q_g, l.intervals * STAGES * NG);
    PLACE(reference, l.intervals * STAGES * REFERENCE);
    PLACE(factor, l.intervals * INTERVAL_FACTOR);
    PLACE(scale, NE);
    PLACE(problem, (ptrdiff_t)((sizeof(two_point) + sizeof(real) - 1) / sizeof(real)));
    PLACE(blocks, (ptrdiff_t)(sizeof(blocks_space) / sizeof(real)));
    PLACE(space, space_wanted());
#undef PLACE
    l.end = at;
    return l;
}

int64_t model_bvp_work(int n, int lead, int tail, int every)
{
    const int64_t end = sizes_fit(n, lead, tail, every) ? laid_out(n, lead, tail, every).end : -1;
    return is_addressable(end) ? end : -1;
}

/* The rows at both ends, from rest at q; numbers of unstable zeros into the report. */
static int bind_ends(two_point *b, const path *p, const real *q, blocks_space *w, real *report, real *space)
{
    const real *place = p->place + (p->n - 1) * (ptrdiff_t)NT;
    const real *q_g = b->m.q_g + ((ptrdiff_t)b->m.N * STAGES - 1) * NG;
    real end[NA], scale[NE];
    pencil at;
    int unstable, status;
    status = pencil_at(p->place, q, &w->lq.arm, space, &at);
    if (status == MODEL_OK) {
        status = end_rows(&at, 1, b->first, &b->from_start, &unstable);
    }
    if (status != MODEL_OK) {
        return status;
    }
    report[4] = unstable;
    copy(q, NA, end);
    for (int i = 0; i < NG; ++i) {
        end[i_g[i]] = q_g[i];
    }
    status = rest_at(place, end, scale, space);
    if (status == MODEL_OK) {
        status = pencil_at(place, end, &w->lq.arm, space, &at);
    }
    if (status == MODEL_OK) {
        status = end_rows(&at, 0, b->last, &b->from_end, &unstable);
    }
    if (status != MODEL_OK) {
        return status;
    }
    report[5] = unstable;
    for (int i = 0; i < NE; ++i) {
        b->rest_start[i] = q[i_e[i]];
        b->rest_end[i] = end[i_e[i]];
        b->rest_start[NE + i] = b->rest_end[NE + i] = 0.0;
    }
    return b->from_start + b->from_end == STATES ? MODEL_OK : MODEL_ZEROS_CHANGE;
}

/* The mesh's motion by Newton steps. */
static int solve_two_point(two_point *b, real tolerance, real *report, blocks_space *w, real *space)
{
    const real *residual = &b->m.residual;
    real before = -1.0;
    int worse = 0;
    for (int steps = 1;; ++steps) {
        int status = factor_blocks(b, w, space);
        if (status == MODEL_OK) {
            step_back(b, w);
            status = all_residuals(b, w, space);
            report[0] = *residual;
            report[2] = steps;
        }
        if (status != MODEL_OK) {
            return b->turns && status == MODEL_NOT_CONVERGED ? (int)MODEL_FLAT : status;
        }
        if (*residual <= rounding * tolerance ||
            (*residual <= tolerance && before >= 0.0 && *residual > 0.1 * before)) {
            return b->turns ? MODEL_FLAT : MODEL_OK;
        }
        worse = before >= 0.0 && *residual > 0.5 * before ? worse + 1 : 0;
        if (steps == NEWTON_STEPS || worse == 4 || !(*residual < 1e12)) {
            if (b->turns) {
                return MODEL_FLAT;
            }
            return *residual <= tolerance ? MODEL_OK : MODEL_NOT_CONVERGED;
        }
        before = *residual;
    }
}

int model_bvp(int n, double period, const double *place, const double *rate, const double *rate2,
    const double *q_start, int lead, int tail, int every, double tolerance, double *q_a, double *v_a, double *a_a,
    double *tau_g, double *q_m, double *v_m, double *tau_m, double *report, double *work, int64_t work_size)
{
    const path p = {n, period, place, rate, rate2};
    layout l;
    two_point *b;
    blocks_space *w;
    real *space, q[NA];
    int status;
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
    for (int i = 0; i < MODEL_BVP_REPORT; ++i) {
        report[i] = (real)NAN;
    }
    status = check_path(&p, q_start);
    if (status != MODEL_OK) {
        return status;
    }
    b = (two_point *)(void *)(work + l.problem);
    w = (blocks_space *)(void *)(work + l.blocks);
    space = work + l.space;
    copy(q_start, NA, q);
    b->m.N = (int)l.intervals;
    b->m.h = every * period;
    b->m.y = work + l.y;
    b->m.a = work + l.a;
    b->m.q_g = work + l.q_g;
    b->m.reference = work + l.reference;
    b->m.aim = NULL;
    b->m.factor = work + l.factor;
    b->m.scale = work + l.scale;
    b->m.end = NULL;
    b->m.rest = NULL;
    report[3] = b->m.N;
    status = rest_at(place, q, b->m.scale, space);
    if (status == MODEL_OK) {
        status = guess_mesh(&b->m, &p, q, lead, every, &w->lq.arm, space);
    }
    if (status == MODEL_OK) {
        status = bind_ends(b, &p, q, w, report, space);
    }
    if (status == MODEL_OK) {
        status = solve_two_point(b, tolerance, report, w, space);
    }
    if (status != MODEL_OK) {
        return status;
    }
    nodal_accelerations(&b->m, work + l.a_node);
    {
        const results r = {&p, lead, every, (ptrdiff_t)l.samples, q_a, v_a, a_a, tau_g, q_m, v_m, tau_m, work + l.tau,
            work + l.twist, work + l.late, work + l.slope, &b->m, work + l.a_node};
        status = arm_at_samples(&r, q, b->m.scale, &w->lq.arm, space, &report[1]);
        if (status == MODEL_OK) {
            status = motors_at_samples(&r, space);
        }
        if (status != MODEL_OK) {
            return status;
        }
        report[6] = unevenness(&r);
    }
    return judged(report[1], report[6], tolerance);
}
