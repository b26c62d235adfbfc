/* elbow: inverse dynamics along a whole path. Written by flexgen; see elbow_inversion.h. */
#include "../elbow_inversion.h"

#include "elbow_equilibrium.h"
#include "elbow_lq_step.h"
#include "elbow_whole_path.h"

enum { END_INTERVALS = 8, SWEEPS = 40 }; /* intervals of a mesh at equilibrium after the path; sweeps over it */

#if ELBOW_NE > 0
static const real cost_change = 1e-2; /* from sweep to sweep, where the cost of an endless equilibrium has converged */

/* Where the arrays of this solver are, after those of both. */
typedef struct {
    int64_t cost, y, a, q_g, reference, factor, lq, end;
} lq_layout;

static lq_layout lay_out_lq(const whole_layout *l)
{
    lq_layout own;
    int64_t at = l->end;
    TAKE(at, own.cost, STATES * STATES);
    TAKE(at, own.y, (END_INTERVALS + 1) * STATES);
    TAKE(at, own.a, END_INTERVALS * CONTROLS);
    TAKE(at, own.q_g, END_INTERVALS * STAGES * NG);
    TAKE(at, own.reference, END_INTERVALS * STAGES * REFERENCE);
    TAKE(at, own.factor, END_INTERVALS * CONTROLS * WIDTH);
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
    l = lay_out(n, options, CONTROLS * WIDTH);
    end = lay_out_lq(&l).end;
#else
    l = lay_out(n, options, 0);
    end = l.end + padded((int64_t)(sizeof(problem_points) / sizeof(real)));
#endif
    return is_addressable(end) ? end : -1;
}

#if ELBOW_NE > 0
/* Equilibrium at the end of the path, and the cost of a state that differs from it, for the end of the mesh. */
static int terminal_cost(
    mesh *m, const whole_layout *l, const lq_layout *own, const real *target, const real *q_start, real *work)
{
    const real *joints = m->q_g + ((ptrdiff_t)m->N * STAGES - 1) * NG;
    real q[NA], scale[NE], reference[REFERENCE] = {0.0};
    mesh hold = *m;
    int status;
    copy(q_start, NA, q);
    for (int i = 0; i < NG; ++i) {
        q[i_g[i]] = joints[i];
    }
    status = equilibrium_at(target, q, scale, work + l->space);
    if (status != ELBOW_OK) {
        return status;
    }
    copy(target, NT, reference);
    hold.N = END_INTERVALS;
    hold.y = work + own->y;
    hold.a = work + own->a;
    hold.q_g = work + own->q_g;
    hold.reference = work + own->reference;
    hold.factor = work + own->factor;
    for (int k = 0; k <= END_INTERVALS; ++k) {
        for (int i = 0; i < NE; ++i) {
            hold.y[k * STATES + i] = q[i_e[i]];
            hold.y[k * STATES + NE + i] = 0.0;
        }
    }
    for (int k = 0; k < END_INTERVALS * CONTROLS; ++k) {
        hold.a[k] = 0.0;
    }
    for (int k = 0; k < END_INTERVALS * STAGES; ++k) {
        for (int i = 0; i < NG; ++i) {
            hold.q_g[k * NG + i] = q[i_g[i]];
        }
        copy(reference, REFERENCE, hold.reference + k * REFERENCE);
    }
    status = lq_stationary_cost(&hold, m->N / END_INTERVALS > SWEEPS ? m->N / END_INTERVALS : SWEEPS, regularization,
        cost_change, (lq_space *)(void *)(work + own->lq), work + l->space, work + own->cost);
    m->end = work + own->cost;
    m->equilibrium = hold.y;
    return status;
}

/* The motion on the mesh by Gauss-Newton steps. */
static int solve_mesh(mesh *m, real tolerance, elbow_inversion_info *info, lq_space *w, real *space)
{
    newton progress = {-1.0, 0, 0};
    for (;;) {
        int state, status = lq_factor(m, w, space);
        info->iterations = progress.steps + 1;
        if (status != ELBOW_OK) {
            return status;
        }
        {
            real first[STATES] = {0.0};
            lq_step(m, first);
        }
        status = evaluate_residual(m, w, space);
        if (status != ELBOW_OK) {
            return status;
        }
        state = newton_state(&progress, m->residual, tolerance, 1e-2);
        if (state != NEWTON_CONTINUES) {
            return state == NEWTON_CONVERGED ? ELBOW_OK : ELBOW_NOT_CONVERGED;
        }
    }
}

#endif

elbow_status elbow_invert(const elbow_path *p, PARAMETERS_ARGUMENT const real q_start[ELBOW_NA],
    const elbow_inversion_options *options, elbow_motion *motion, elbow_inversion_info *info, real *work,
    int64_t work_size)
{
    const int64_t wanted = p == NULL ? -1 : elbow_invert_work(p->n, options);
    whole_layout l;
    real q[NA];
    int status = check_arguments(p, GIVEN_PARAMETERS, q_start, options, motion, info, work, work_size, wanted);
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    copy(q_start, NA, q);
#if ELBOW_NE > 0
    {
        lq_layout own;
        lq_space *w;
        mesh m;
        l = lay_out(p->n, options, CONTROLS * WIDTH);
        keep_parameters(GIVEN_PARAMETERS, work + l.space);
        own = lay_out_lq(&l);
        w = (lq_space *)(void *)(work + own.lq);
        m = mesh_in(&l, p, options, work);
        status = equilibrium_at(p->y, q, m.scale, work + l.space);
        if (status == ELBOW_OK) {
            status = guess_mesh(&m, p, q, options->n_pre, options->samples_per_interval, &w->arm, work + l.space);
        }
        if (status == ELBOW_OK) {
            status = terminal_cost(&m, &l, &own, p->y + (p->n - 1) * (ptrdiff_t)NT, q, work);
        }
        if (status == ELBOW_OK) {
            status = solve_mesh(&m, options->tolerance, info, w, work + l.space);
            info->residual = m.residual;
            info->intervals = m.N;
        }
        if (status != ELBOW_OK) {
            return (elbow_status)status;
        }
        return finish(p, options, &l, q, &m, &w->arm, motion, info, work);
    }
#else
    l = lay_out(p->n, options, 0);
    keep_parameters(GIVEN_PARAMETERS, work + l.space);
    status = equilibrium_at(p->y, q, NULL, work + l.space);
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    info->residual = 0.0;
    return finish(p, options, &l, q, (problem_points *)(void *)(work + l.end), motion, info, work);
#endif
}
