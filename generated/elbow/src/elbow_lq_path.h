/*
 * elbow: Gauss-Newton steps of the inversion along a whole path; private.
 *
 * A step is the solution of a linear-quadratic problem (see lq_step.h). Its factors hold for later steps too where the
 * motion has changed little: then only the linear terms are computed again. The intervals after the path are all close
 * to the same equilibrium: they share its Jacobians, and the factor of an endless one. Where the cost of that one is
 * not exact, as unstable zeros of very different size hide each other, each has a factor of its own.
 */
#ifndef ELBOW_LQ_PATH_H
#define ELBOW_LQ_PATH_H

#include "elbow_lq_step.h"
#include "elbow_settling.h"

#if ELBOW_NE > 0

enum { MORE_STEPS = 2 };

static const real unchanged = PRECISE(1e-7, 1e-4);

/* The factors of all intervals that have their own, from the cost of an endless equilibrium after them. */
static inline int lq_path_factor(mesh *m, real *point, const lq_data *c, lq_space *w, real *space)
{
    int status;
    copy(m->end, STATES * STATES, w->P);
    for (int i = 0; i < STATES; ++i) {
        w->p[i] = 0.0;
    }
    status = m->factored > m->varying ? lq_factor_alike(m, m->varying, c->steady_point, w) : ELBOW_OK;
    return status == ELBOW_OK ? lq_factor_before(m, m->varying, point, w, space) : status;
}

/* The residuals before the first step: those of the factors; the intervals after the path are at equilibrium. */
static inline void lq_path_first_rows(mesh *m, const lq_data *c)
{
    const ptrdiff_t at = (ptrdiff_t)m->varying * STAGES, all = (ptrdiff_t)m->N * STAGES;
    for (ptrdiff_t k = 0; k < at; ++k) {
        copy(c->point + k * POINT + NE * TRIPLE, NE, c->row + k * NE);
    }
    for (ptrdiff_t i = at * NE; i < all * NE; ++i) {
        c->row[i] = 0.0;
    }
}

/*
 * The motion on the mesh by Gauss-Newton steps. The factors are computed again where a step with those of an earlier
 * motion gains less than a factor of ten. Where the residual is small enough, up to MORE_STEPS follow until the next
 * one would change the motion by less than the share `unchanged` of the first: factors of another motion leave an error
 * of the motion that the residual hardly shows. cut: the motion ends where it has settled after the first step, which
 * is nearly the last one.
 */
static inline int lq_path_solve(mesh *m, real *point, lq_data *c, const elbow_inversion_options *o, int cut,
    settling *end, elbow_inversion_info *info, lq_space *w, real *space)
{
    const real tolerance = o->tolerance;
    newton progress = {-1.0, 0, 0};
    real first = 0.0, last = 0.0; /* sizes of steps */
    int must_factor = 1, more = 0;
    for (;;) {
        const real before = progress.before;
        real size, next;
        int state, status = ELBOW_OK;
        info->iterations = progress.steps + 1;
        if (must_factor) {
            status = lq_path_factor(m, point, c, w, space);
        }
        if (status == ELBOW_OK && progress.steps == 0) {
            lq_path_first_rows(m, c);
        }
        if (status == ELBOW_OK && !lq_linear(m, c)) {
            status = ELBOW_NOT_CONVERGED;
        }
        if (status != ELBOW_OK) {
            return status;
        }
        {
            real d[STATES] = {0.0};
            size = lq_data_step(m, c, d);
        }
        if (progress.steps == 0 && cut) {
            cut_mesh(m, o->samples_per_interval, end);
        }
        status = evaluate_residual(m, c->row, w, space);
        if (status != ELBOW_OK) {
            return status;
        }
        state = newton_state(&progress, m->residual, tolerance, 1e-2);
        first = fmax_1(first, size);
        next = last > 0.0 ? (must_factor ? 0.0 : size * (size / last)) : m->varying < m->N ? size : 0.0;
        if (state == NEWTON_CONTINUES && last > 0.0 && !must_factor && m->residual <= tolerance &&
            next <= unchanged * first) {
            state = NEWTON_CONVERGED; /* what is left is the regularization, which no step changes */
        }
        if (state == NEWTON_FAILED ||
            (state == NEWTON_CONVERGED && (!(next > unchanged * first) || more == MORE_STEPS))) {
            return state == NEWTON_CONVERGED ? ELBOW_OK : ELBOW_NOT_CONVERGED;
        }
        more += state == NEWTON_CONVERGED;
        must_factor = state == NEWTON_CONTINUES && before >= 0.0 && m->residual > 0.1 * before;
        progress.before = m->residual;
        last = size;
    }
}

#endif

#endif
