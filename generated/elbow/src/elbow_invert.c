/* elbow: inverse dynamics along a whole path. Written by flexgen; see elbow_inversion.h. */
#include "../elbow_inversion.h"

#include "elbow_equilibrium.h"
#include "elbow_lq_path.h"
#include "elbow_whole_path.h"

#if ELBOW_NE > 0
enum { SWEEPS = 40, SWEEP = 8 }; /* sweeps for the cost of an endless equilibrium; their intervals */

static const real cost_change = 1e-2; /* from sweep to sweep, where the cost of an endless equilibrium has converged */

/* Where the arrays of this solver are, after those of both. */
typedef struct {
    int64_t cost, y, a, q_g, reference, steady_factor, steady_point, point, row, linear, settling, lq, end;
} lq_layout;

static lq_layout lay_out_lq(const whole_layout *l)
{
    lq_layout own;
    int64_t at = l->end;
    TAKE(at, own.cost, STATES * STATES);
    TAKE(at, own.y, 2 * STATES);
    TAKE(at, own.a, CONTROLS);
    TAKE(at, own.q_g, STAGES * NG);
    TAKE(at, own.reference, STAGES * REFERENCE);
    TAKE(at, own.steady_factor, CONTROLS * WIDTH);
    TAKE(at, own.steady_point, STAGES * POINT + BLOCK);
    TAKE(at, own.point, l->varying * STAGES * POINT + BLOCK);
    TAKE(at, own.row, l->intervals * STAGES * NE);
    TAKE(at, own.linear, l->intervals * CONTROLS);
    TAKE(at, own.settling, (int64_t)((sizeof(settling) + sizeof(real) - 1) / sizeof(real)));
    TAKE(at, own.lq, (int64_t)(sizeof(lq_space) / sizeof(real)));
    own.end = at;
    return own;
}
#endif

int64_t elbow_invert_work(int n, const elbow_inversion_options *options)
{
    whole_layout l;
    int64_t end;
    if (options == NULL || !path_sizes_fit(n, options)) {
        return -1;
    }
#if ELBOW_NE > 0
    l = lay_out(n, options, CONTROLS * WIDTH, 1);
    end = lay_out_lq(&l).end;
#else
    l = lay_out(n, options, 0, 0);
    end = l.end + padded((int64_t)(sizeof(problem_points) / sizeof(real)));
#endif
    return is_addressable(end) ? end : -1;
}

#if ELBOW_NE > 0
/*
 * Equilibrium at the end of the path, to which the first guess of the motion leads; the cost of a state that differs
 * from it, for the end of the mesh; and when the motion has settled there.
 */
static int prepare_end(
    mesh *m, const whole_layout *l, const lq_layout *own, const real *target, const real *q_start, real *work)
{
    lq_space *w = (lq_space *)(void *)(work + own->lq);
    const real *joints = m->q_g + ((ptrdiff_t)m->N * STAGES - 1) * NG;
    real q[NA], scale[NE], reference[REFERENCE] = {0.0};
    settling *end = (settling *)(void *)(work + own->settling);
    mesh hold = *m;
    int status, is_exact = 0;
    copy(q_start, NA, q);
    for (int i = 0; i < NG; ++i) {
        q[i_g[i]] = joints[i];
    }
    status = equilibrium_at(target, q, scale, work + l->space);
    if (status != ELBOW_OK) {
        return status;
    }
    copy(target, NT, reference);
    hold.N = 1;
    hold.y = work + own->y;
    hold.a = work + own->a;
    hold.q_g = work + own->q_g;
    hold.reference = work + own->reference;
    hold.factor = work + own->steady_factor;
    for (int i = 0; i < STATES; ++i) {
        hold.y[i] = hold.y[STATES + i] = i < NE ? q[i_e[i % NE]] : 0.0;
    }
    for (int i = 0; i < CONTROLS; ++i) {
        hold.a[i] = 0.0;
    }
    for (int k = 0; k < STAGES; ++k) {
        for (int i = 0; i < NG; ++i) {
            hold.q_g[k * NG + i] = q[i_g[i]];
        }
        copy(reference, REFERENCE, hold.reference + k * REFERENCE);
    }
    status = lq_stationary_cost(&hold, SWEEP, m->N / SWEEP > SWEEPS ? m->N / SWEEP : SWEEPS, regularization,
        cost_change, w, work + l->space, work + own->cost, &is_exact);
    copy(w->point, STAGES * POINT, work + own->steady_point);
    m->factored = is_exact ? m->varying : m->N;
    m->end = work + own->cost;
    m->equilibrium = hold.y;
    copy(q, NA, end->q);
    end->intervals = m->N;
    move_smoothly(m, hold.y);
    for (ptrdiff_t k = (ptrdiff_t)m->varying * STAGES; k < (ptrdiff_t)m->N * STAGES; ++k) {
        copy(hold.q_g, NG, m->q_g + k * NG);
    }
    return status == ELBOW_OK && end->allowed > 0.0 ? settling_at(target, &w->arm, end, work + l->space) : status;
}

/* The motion on the mesh; cut: it ends where it has settled after the first step, else after the last one. */
static int motion_on_mesh(mesh *m, const whole_layout *l, const lq_layout *own, const elbow_path *p, const real *q,
    const elbow_inversion_options *options, int cut, elbow_inversion_info *info, real *work)
{
    lq_space *w = (lq_space *)(void *)(work + own->lq);
    settling *end = (settling *)(void *)(work + own->settling);
    lq_data c;
    int status = guess_mesh(m, p, q, options->n_pre, options->samples_per_interval, &w->arm, work + l->space);
    if (status == ELBOW_OK) {
        status = prepare_end(m, l, own, p->y + (p->n - 1) * (ptrdiff_t)NT, q, work);
    }
    if (status != ELBOW_OK) {
        return status;
    }
    c.point = work + own->point;
    c.row = work + own->row;
    c.linear = work + own->linear;
    c.steady_point = work + own->steady_point;
    c.steady_factor = work + own->steady_factor;
    status = lq_path_solve(m, work + own->point, &c, options, cut, end, info, w, work + l->space);
    info->residual = m->residual;
    info->intervals = m->N;
    if (status == ELBOW_OK && !cut && end->allowed > 0.0) {
        cut_mesh(m, options->samples_per_interval, end);
    }
    return status;
}

#endif

elbow_status elbow_invert(const elbow_path *p, PARAMETERS_ARGUMENT const real q_start[ELBOW_NA],
    const elbow_inversion_options *options, elbow_motion *motion, elbow_inversion_info *info, real *work,
    int64_t work_size)
{
    const int64_t wanted = p == NULL ? -1 : elbow_invert_work(p->n, options);
    whole_layout l;
    real q[NA];
#if ELBOW_NE == 0
    ptrdiff_t samples;
#endif
    int status = check_arguments(p, GIVEN_PARAMETERS, q_start, options, motion, info, work, work_size, wanted);
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    copy(q_start, NA, q);
#if ELBOW_NE > 0
    {
        lq_layout own;
        settling *end;
        mesh m;
        l = lay_out(p->n, options, CONTROLS * WIDTH, 1);
        keep_parameters(GIVEN_PARAMETERS, work + l.space);
        own = lay_out_lq(&l);
        end = (settling *)(void *)(work + own.settling);
        end->allowed = options->settled;
        end->shortest = shortest_motion_after(work + l.space);
        m = mesh_in(&l, p, options, work);
        status = equilibrium_at(p->y, q, m.scale, work + l.space);
        if (status == ELBOW_OK) {
            status = motion_on_mesh(&m, &l, &own, p, q, options, end->allowed > 0.0, info, work);
        }
        if (status == ELBOW_OK && is_cut_early(&m, end)) {
            m = mesh_in(&l, p, options, work);
            status = motion_on_mesh(&m, &l, &own, p, q, options, 0, info, work);
        }
        if (status != ELBOW_OK) {
            return (elbow_status)status;
        }
        return finish(p, options, &l, q, &m, end->q, end->intervals * (ptrdiff_t)options->samples_per_interval + 1,
            &((lq_space *)(void *)(work + own.lq))->arm, motion, info, work);
    }
#else
    l = lay_out(p->n, options, 0, 0);
    keep_parameters(GIVEN_PARAMETERS, work + l.space);
    status = equilibrium_at(p->y, q, NULL, work + l.space);
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    info->residual = 0.0;
    samples = (ptrdiff_t)l.samples;
    if (options->settled > 0.0) {
        const real after = shortest_motion_after(work + l.space) / p->period;
        if (after < (real)options->n_post) { /* rounded up */
            samples -= options->n_post - (ptrdiff_t)after - 1;
        }
    }
    return finish(p, options, &l, q, NULL, samples, (problem_points *)(void *)(work + l.end), motion, info, work);
#endif
}
