/*
 * model: Gauss-Newton steps of the inversion along a whole path; private.
 *
 * A step is the solution of a linear-quadratic problem (see lq_step.h). Its factors hold for later steps too where the
 * motion has changed little: then only the linear terms are computed again. The intervals after the path are all close
 * to the same equilibrium, and share the factor of an endless one.
 */
#ifndef MODEL_LQ_PATH_H
#define MODEL_LQ_PATH_H

#include "model_lq_step.h"
#include "model_whole_path.h"

#if MODEL_NE > 0

enum { MORE_STEPS = 2 };

static const real unchanged = PRECISE(1e-8, 1e-4);

/* Beside the mesh, whose factors are those of its varying intervals; all arrays belong to the caller. */
typedef struct {
    real *point;               /* varying x STAGES x POINT: K, D, A, R of the factors, and BLOCK more */
    real *row;                 /* N x STAGES x NE: residuals */
    real *linear;              /* N x CONTROLS: right sides of the factors */
    const real *steady_point;  /* STAGES x POINT, and BLOCK more: of the intervals after the path */
    const real *steady_factor; /* CONTROLS x WIDTH */
    real once[STAGES][STAGES]; /* by `stage_weights` */
    real twice[STAGES][STAGES];
} lq_path;

/* The factors of the varying intervals, from the cost of an endless equilibrium after them. */
static inline int lq_path_factor(mesh *m, lq_path *c, lq_space *w, real *space)
{
    copy(m->end, STATES * STATES, w->P);
    for (int i = 0; i < STATES; ++i) {
        w->p[i] = 0.0;
    }
    return lq_factor_before(m, m->varying, c->point, w, space);
}

/* The residuals before the first step: those of the factors, and one for all intervals after the path. */
static inline int lq_path_first_rows(mesh *m, lq_path *c, lq_space *w, real *space)
{
    const ptrdiff_t at = (ptrdiff_t)m->varying * STAGES, all = (ptrdiff_t)m->N * STAGES;
    for (ptrdiff_t k = 0; k < at; ++k) {
        copy(c->point + k * POINT + NE * TRIPLE, NE, c->row + k * NE);
    }
    if (at < all) {
        int status;
        begin_points(&w->arm);
        for (int l = 0; l < POINTS; ++l) {
            load_point(m, (int)at, &w->arm, l);
        }
        status = evaluate_torques(&w->arm, space);
        if (status != MODEL_OK) {
            return status;
        }
        for (ptrdiff_t k = at; k < all; ++k) {
            for (int i = 0; i < NE; ++i) {
                c->row[k * NE + i] = w->arm.row[i][0] / m->scale[i];
            }
        }
    }
    return MODEL_OK;
}

/* J' R of an interval in its scaled unknowns. */
static inline void lq_gradient(const lq_path *c, const real *point, const real *row, real h, real *g)
{
    for (int i = 0; i < WIDTH; ++i) {
        g[i] = 0.0;
    }
    for (int s = 0; s < STAGES; ++s) {
        const real *at = point + s * POINT, *R = row + s * NE;
        real sums[TRIPLE + BLOCK]; /* K' R, D' R, A' R */
        for (int j = 0; j < TRIPLE; j += LANES) {
            lanes sum = splat_v(0.0);
            for (int i = 0; i < NE; ++i) {
                sum += splat_v(R[i]) * load_v(at + i * TRIPLE + j);
            }
            store_v(sums + j, sum);
        }
        for (int i = 0; i < NE; ++i) {
            const real K = sums[i], D = sums[NE + i], A = sums[2 * NE + i];
            for (int t = 0; t < STAGES; ++t) {
                g[t * NE + i] += c->twice[s][t] * K + c->once[s][t] * D;
            }
            g[s * NE + i] += scale_a * A;
            g[CONTROLS + i] += scale_q * K;
            g[CONTROLS + NE + i] += scale_v * (h * gauss_c[s] * K + D);
        }
    }
}

/* The linear terms of a step, backwards; 0 where one is not finite. */
static inline int lq_path_linear(const mesh *m, const lq_path *c)
{
    const real h = m->h, drift = h * scale_v / scale_q, *end = m->y + (ptrdiff_t)m->N * STATES;
    real p[STATES], to_q[STAGES], to_v[STAGES];
    for (int j = 0; j < STAGES; ++j) {
        to_q[j] = h * h * gauss_b[j] * (1.0 - gauss_c[j]) * scale_a / scale_q;
        to_v[j] = h * gauss_b[j] * scale_a / scale_v;
    }
    for (int i = 0; i < STATES; ++i) {
        p[i] = 0.0;
        for (int j = 0; j < STATES; ++j) {
            p[i] += m->end[i * STATES + j] * (end[j] - m->equilibrium[j]) / (j < NE ? scale_q : scale_v);
        }
    }
    for (ptrdiff_t k = m->N - 1; k >= 0; --k) {
        const int varies = k < m->varying;
        const real *factor = varies ? m->factor + k * CONTROLS * WIDTH : c->steady_factor;
        real g[WIDTH];
        lq_gradient(c, varies ? c->point + k * STAGES * POINT : c->steady_point, c->row + k * STAGES * NE, h, g);
        for (int i = 0; i < NE; ++i) {
            for (int s = 0; s < STAGES; ++s) {
                g[s * NE + i] += to_q[s] * p[i] + to_v[s] * p[NE + i];
            }
            g[CONTROLS + i] += p[i];
            g[CONTROLS + NE + i] += drift * p[i] + p[NE + i];
        }
        for (int i = 0; i < CONTROLS; ++i) { /* as `eliminate` does it with the last column */
            const real *row = factor + i * WIDTH;
            const real weighed = g[i] * row[i];
            c->linear[k * CONTROLS + i] = g[i];
            for (int j = i / BLOCK * BLOCK; j < WIDTH; j += LANES) {
                store_v(g + j, load_v(g + j) + splat_v(weighed) * load_v(row + j));
            }
        }
        copy(g + CONTROLS, STATES, p);
    }
    return is_finite(p, STATES);
}

/* The step itself, forwards; its largest scaled control. */
static inline real lq_path_step(mesh *m, const lq_path *c)
{
    real d[STATES] = {0.0}, most = 0.0;
    for (ptrdiff_t k = 0; k < m->N; ++k) {
        const real *factor = k < m->varying ? m->factor + k * CONTROLS * WIDTH : c->steady_factor;
        most = fmax_1(most, step_interval(m, k, factor, c->linear + k * CONTROLS, d));
    }
    step_last_node(m, d);
    return most;
}

/*
 * The motion on the mesh by Gauss-Newton steps. The factors are computed again where a step with those of an earlier
 * motion gains less than a factor of ten. Where the residual is small enough, up to MORE_STEPS follow until the next
 * one would change the motion by less than the share `unchanged` of the first: factors of another motion leave an error
 * of the motion that the residual hardly shows.
 */
static inline int lq_path_solve(
    mesh *m, lq_path *c, real tolerance, model_inversion_info *info, lq_space *w, real *space)
{
    newton progress = {-1.0, 0, 0};
    real first = 0.0, last = 0.0; /* sizes of steps */
    int must_factor = 1, more = 0;
    for (int s = 0; s < STAGES; ++s) {
        for (int t = 0; t < STAGES; ++t) {
            stage_weights(m->h, s, t, &c->once[s][t], &c->twice[s][t]);
        }
    }
    for (;;) {
        const real before = progress.before;
        real size, next;
        int state, status = MODEL_OK;
        info->iterations = progress.steps + 1;
        if (must_factor) {
            status = lq_path_factor(m, c, w, space);
        }
        if (status == MODEL_OK && progress.steps == 0) {
            status = lq_path_first_rows(m, c, w, space);
        }
        if (status == MODEL_OK && !lq_path_linear(m, c)) {
            status = MODEL_NOT_CONVERGED;
        }
        if (status != MODEL_OK) {
            return status;
        }
        size = lq_path_step(m, c);
        status = evaluate_residual(m, c->row, w, space);
        if (status != MODEL_OK) {
            return status;
        }
        state = newton_state(&progress, m->residual, tolerance, 1e-2);
        first = fmax_1(first, size);
        next = last > 0.0 ? (must_factor ? 0.0 : size * (size / last)) : m->varying < m->N ? size : 0.0;
        if (state == NEWTON_FAILED ||
            (state == NEWTON_CONVERGED && (!(next > unchanged * first) || more == MORE_STEPS))) {
            return state == NEWTON_CONVERGED ? MODEL_OK : MODEL_NOT_CONVERGED;
        }
        more += state == NEWTON_CONVERGED;
        must_factor = state == NEWTON_CONTINUES && before >= 0.0 && m->residual > 0.1 * before;
        progress.before = m->residual;
        last = size;
    }
}

#endif

#endif
