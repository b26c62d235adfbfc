/*
 * model: one Gauss-Newton step of the motion over the horizon, in parts; private to the stream.
 *
 * Between two updates most intervals of the horizon only become one interval older: their Jacobians, factors and costs
 * to go are kept, and only those of some intervals are computed again, of more at the end of the horizon, where the
 * motion still changes. The residuals are computed everywhere.
 */
#ifndef MODEL_STREAM_STEP_H
#define MODEL_STREAM_STEP_H

#include "model_quasistatic_end.h"

#if MODEL_NE > 0

enum { END = 6 }; /* intervals at the end of the horizon that are computed again in any case, at least */

static const real stale_share = 0.1; /* of the tolerance: a larger residual in the near half asks for all factors */

/* The largest residual of the intervals before `end`. */
static inline real residual_before(const real *row, ptrdiff_t end)
{
    real most = 0.0;
    for (ptrdiff_t k = 0; k < end; ++k) {
        most = fmax_1(most, largest(row + k * STAGES * NE, STAGES * NE));
    }
    return most;
}

/*
 * The intervals whose factors are computed again, the last one first: those at the end of the horizon, whose costs to
 * go follow from each other without a gap, then at distances from the end that grow by a factor of three. All where
 * `all`. They are returned in groups of GROUP from `*next` on; the number of them.
 */
static inline int refreshed(int N, int all, int *next, int *list)
{
    int count = 0;
    while (*next < N && count < GROUP) {
        list[count++] = N - 1 - *next;
        *next = all || *next < (N > 3 * END ? N / 3 : END) ? *next + 1 : 3 * *next;
    }
    return count;
}

/* Residuals and Jacobians of the intervals in `list`. */
static inline int refresh_points(real *s, const layout *l, const int *list, int count)
{
    mesh m = mesh_of(l, s);
    return evaluate_group(&m, 0, list, count, s + l->point, (lq_space *)(void *)(s + l->lq), s + l->space);
}

/* The factor and the cost to go of interval k whose Jacobians are known. */
static inline int refresh_factor(real *s, const layout *l, int k)
{
    lq_space *w = (lq_space *)(void *)(s + l->lq);
    const mesh m = mesh_of(l, s);
    const ptrdiff_t slot = slot_of(&m, k);
    copy(k == m.N - 1 ? m.end : s + l->costs + slot_of(&m, k + 1) * STATES * STATES, STATES * STATES, w->P);
    for (int j = 0; j < STATES; ++j) {
        w->p[j] = 0.0;
    }
    sum_of_rows(&m, s + l->point + slot * STAGES * POINT, w->J, w->H);
    if (!factor_interval(&m, k, w, m.factor + slot * CONTROLS * WIDTH) || !is_finite(w->p, STATES)) {
        return MODEL_NOT_CONVERGED;
    }
    copy(w->P, STATES * STATES, s + l->costs + slot * STATES * STATES);
    return MODEL_OK;
}

/* Shift the motion by one interval, with the quasi-static motion at its new end. */
static inline int shift_motion(real *s, const layout *l)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    lq_space *w = (lq_space *)(void *)(s + l->lq);
    mesh m;
    s[BASE] = s[BASE] + 1.0 < s[INTERVALS] ? s[BASE] + 1.0 : 0.0;
    m = mesh_of(l, s);
    copy(s + l->y + STATES, (l->past + N) * STATES, s + l->y);
    copy(s + l->target_state + STATES, N * STATES, s + l->target_state);
    copy(s + l->a + CONTROLS, (l->past + N - 1) * CONTROLS, s + l->a);
    for (int i = 0; i < CONTROLS; ++i) {
        m.a[(N - 1) * CONTROLS + i] = 0.0;
    }
    next_node(m.y + (N - 1) * STATES, m.a + (N - 1) * CONTROLS, m.h, m.y + N * STATES);
    return quasistatic_motion(&m, w, s + l->levels, s + l->nodes + (l->past + N) * REFERENCE, s + l->space);
}

/* Residuals of POINTS Gauss points of the horizon; after the last ones, whether all factors are computed again. */
static inline int residual_part(real *s, const layout *l, int at)
{
    lq_space *w = (lq_space *)(void *)(s + l->lq);
    mesh m = mesh_of(l, s);
    int status;
    if (at == 0) {
        begin_points(&w->arm);
    }
    status = evaluate_residual_at(&m, at, s + l->row, w, s + l->space);
    if (status == MODEL_OK && at + POINTS >= m.N * STAGES &&
        !(residual_before(s + l->row, m.N / 2) <= stale_share * s[TOLERANCE])) {
        s[STALE] = 1.0;
    }
    return status;
}

/* The linear terms of the step, backwards, with the factors as they are now. */
static inline int linear_part(real *s, const layout *l)
{
    const lq_data data = {s + l->point, NULL, NULL, s + l->row, s + l->linear};
    const mesh m = mesh_of(l, s);
    s[STALE] = 0.0;
    return lq_linear(&m, &data) ? MODEL_OK : MODEL_NOT_CONVERGED;
}

/* The step, forwards. */
static inline void step_part(real *s, const layout *l)
{
    const lq_data data = {s + l->point, NULL, NULL, s + l->row, s + l->linear};
    real first[STATES] = {0.0};
    mesh m = mesh_of(l, s);
    (void)lq_data_step(&m, &data, first);
    copy(s + l->costs + slot_of(&m, 0) * STATES * STATES, STATES * STATES, s + l->cost);
}

#endif

#endif
