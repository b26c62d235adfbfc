/*
 * model: one Gauss-Newton step of the inversion over a mesh, a linear-quadratic problem; private.
 *
 * The unknowns are the accelerations a_e at the Gauss points of each interval, the control of the
 * double integrator y = (q_e, v_e). The step d minimizes
 *
 *     sum |(R + R_q dq + R_v dv + R_a da) / s_r|^2 + w (|y + dy - y_ref|^2 / s_y^2 + |da|^2 /
 *       s_a^2),   dy_0 = 0,
 *
 * by a Riccati recursion with blocks of fixed size, w: the small `regularization`. y_ref is the
 * present y or, on a moving horizon, the quasi-static motion. The step is regular where R_a is
 * singular; of all motions with R = 0 it selects the bounded one.
 */
#ifndef MODEL_LQ_STEP_H
#define MODEL_LQ_STEP_H

#include "model_mesh.h"

/*
 * --- Sums of outer products of rows, where the elimination of lq spends its time.
 */

#if MODEL_NE > 0

enum {
    COLUMNS = CONTROLS + STATES + 1, /* of a row; the last one: right side */
    WIDTH = (COLUMNS + BLOCK - 1) / BLOCK * BLOCK
};

/*
 * H[i][j] += sum_p weighed[p][i] rows[p][j], p < count, for i >= first and j >= i. Tiles of eight
 * vectors, HIGH rows of H and WIDE columns, stay in registers for all p: by name, as not all
 * compilers unroll loops over arrays.
 */
#if LANES == BLOCK
#define HIGH 8
#define TILE(DO) \
    DO(0, 0, 0) DO(1, 1, 0) DO(2, 2, 0) DO(3, 3, 0) DO(4, 4, 0) DO(5, 5, 0) DO(6, 6, 0) DO(7, 7, 0)
#define TILE_ROWS(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
#define TILE_VECTORS(DO) DO(0)
#elif 2 * LANES == BLOCK
#define HIGH 4
#define TILE(DO) \
    DO(0, 0, 0) DO(1, 0, 1) DO(2, 1, 0) DO(3, 1, 1) DO(4, 2, 0) DO(5, 2, 1) DO(6, 3, 0) DO(7, 3, 1)
#define TILE_ROWS(DO) DO(0) DO(1) DO(2) DO(3)
#define TILE_VECTORS(DO) DO(0) DO(1)
#elif 4 * LANES == BLOCK
#define HIGH 2
#define TILE(DO) \
    DO(0, 0, 0) DO(1, 0, 1) DO(2, 0, 2) DO(3, 0, 3) DO(4, 1, 0) DO(5, 1, 1) DO(6, 1, 2) DO(7, 1, 3)
#define TILE_ROWS(DO) DO(0) DO(1)
#define TILE_VECTORS(DO) DO(0) DO(1) DO(2) DO(3)
#else
#define HIGH 1
#define TILE(DO) \
    DO(0, 0, 0) DO(1, 0, 1) DO(2, 0, 2) DO(3, 0, 3) DO(4, 0, 4) DO(5, 0, 5) DO(6, 0, 6) DO(7, 0, 7)
#define TILE_ROWS(DO) DO(0)
#define TILE_VECTORS(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
#endif
#define WIDE (8 / HIGH * LANES)
#define TILE_SUM(k, a, b) lanes sum##k = load_v(H + (i + a) * WIDTH + j + b * LANES);
#define TILE_ROW(b) const lanes x##b = load_v(rows + p * WIDTH + j + b * LANES);
#define TILE_WEIGHT(a) const lanes w##a = splat_v(weighed[p * WIDTH + i + a]);
#define TILE_ADD(k, a, b) sum##k += w##a * x##b;
#define TILE_STORE(k, a, b) store_v(H + (i + a) * WIDTH + j + b * LANES, sum##k);

static inline void add_outer_products(real *RESTRICT H, const real *RESTRICT rows,
    const real *RESTRICT weighed, int count, int first)
{
    int i = first;
    while (i < COLUMNS - 1) {
        if (i % HIGH == 0 && i + HIGH <= COLUMNS) {
            for (int j = i / BLOCK * BLOCK; j < WIDTH; j += WIDE) {
                TILE(TILE_SUM)
                for (int p = 0; p < count; ++p) {
                    TILE_VECTORS(TILE_ROW)
                    TILE_ROWS(TILE_WEIGHT)
                    TILE(TILE_ADD)
                }
                TILE(TILE_STORE)
            }
            i += HIGH;
        } else {
            for (int j = i / BLOCK * BLOCK; j < WIDTH; j += LANES) {
                lanes sum = load_v(H + i * WIDTH + j);
                for (int p = 0; p < count; ++p) {
                    sum += splat_v(weighed[p * WIDTH + i]) * load_v(rows + p * WIDTH + j);
                }
                store_v(H + i * WIDTH + j, sum);
            }
            ++i;
        }
    }
}
#undef HIGH
#undef WIDE
#undef TILE
#undef TILE_ROWS
#undef TILE_VECTORS
#undef TILE_SUM
#undef TILE_ROW
#undef TILE_WEIGHT
#undef TILE_ADD
#undef TILE_STORE

#endif

/* --- A Gauss-Newton step by a Riccati recursion. */

#if MODEL_NE > 0

enum {
    PANEL = 8,
    RESIDUALS = STAGES * NE,
    GROUP = 8,        /* intervals that are evaluated together */
    MORE_SWEEPS = 20, /* for an exact cost, beyond those for one that serves */
    GROUP_POINTS = GROUP * STAGES,
    TRIPLE = 3 * NE,           /* rows of K, D and A, one after the other */
    POINT = NE * (TRIPLE + 1), /* NE triples, then R */
    GROUP_SIZE = GROUP_POINTS * POINT,
    /* of an equilibrium: points of an interval, sum over its rows */
    REST_SIZE = STAGES * POINT + COLUMNS * WIDTH,
    POINTS_SIZE = GROUP_SIZE > REST_SIZE ? GROUP_SIZE : REST_SIZE
};

static const real scale_q = 1e-2; /* rad or m */
static const real scale_v = 1.0;  /* rad/s or m/s */
static const real scale_a = 1e3;  /* rad/s^2 or m/s^2 */
static const real regularization = PRECISE(1e-12, 1e-5);
/* smallest cost to go that counts: a thousand times that of the regularization */
static const real negligible_cost = PRECISE(1e-9, 1e-4);
/*
 * costs above the first are those of unstable motions; their largest relative change in a sweep
 * where all intervals after a path can have their factor
 */
static const real counted_cost = PRECISE(1e-7, 1e-3), converged_cost = PRECISE(1e-7, 1e-3);

/* Memory of a step. */
typedef struct {
    problem_points arm;
    real point[POINTS_SIZE];
    real J[RESIDUALS * WIDTH + BLOCK]; /* and room for the end of a vector */
    real H[(COLUMNS + 1) * WIDTH];
    real P[STATES * STATES], p[STATES];
} lq_space;

/* Residuals and Jacobians of point l of `arm`, which is Gauss point k; the joints are updated. */
static inline void keep_point(mesh *m, const problem_points *arm, int l, ptrdiff_t k, real *to)
{
    for (int i = 0; i < NE; ++i) {
        const real unit = 1.0 / m->scale[i];
        for (int j = 0; j < NE; ++j) {
            to[i * TRIPLE + j] = unit * arm->K[j][i][l];
            to[i * TRIPLE + NE + j] = unit * arm->D[j][i][l];
            to[i * TRIPLE + 2 * NE + j] = unit * arm->A[j][i][l];
        }
        to[NE * TRIPLE + i] = unit * arm->row[i][l];
    }
    for (int i = 0; i < NG; ++i) {
        m->q_g[k * NG + i] = arm->q[i_g[i]][l];
    }
}

/*
 * Residuals and Jacobians at the Gauss points of `count` intervals, POINT numbers for each: of
 * first and the following ones, or of those in `list`, whose numbers go to their slots.
 */
static inline int evaluate_group(
    mesh *m, int first, const int *list, int count, real *points_out, lq_space *w, real *space)
{
    for (int at = 0; at < count * STAGES; at += POINTS) {
        const int used = count * STAGES - at < POINTS ? count * STAGES - at : POINTS;
        int which[POINTS], status;
        for (int l = 0; l < POINTS; ++l) {
            const int k = at + (l < used ? l : used - 1);
            which[l] = list != NULL ? list[k / STAGES] * STAGES + k % STAGES : first * STAGES + k;
            load_point(m, which[l], &w->arm, l);
        }
        status = solve_kinematics(&w->arm, space);
        if (status == MODEL_OK) {
            status = reduced_jacobians(&w->arm, space);
        }
        if (status != MODEL_OK) {
            return status;
        }
        for (int l = 0; l < used; ++l) {
            const ptrdiff_t to = list != NULL ?
                                     slot_of(m, which[l] / STAGES) * STAGES + which[l] % STAGES :
                                     (ptrdiff_t)at + l;
            keep_point(m, &w->arm, l, which[l], points_out + to * POINT);
        }
    }
    return MODEL_OK;
}

/*
 * The same for the residuals of POINTS Gauss points from `at` on, without Jacobians; see
 * `evaluate_residual`.
 */
static inline int evaluate_residual_at(mesh *m, int at, real *rows, lq_space *w, real *space)
{
    problem_points *arm = &w->arm;
    const int used = m->N * STAGES - at < POINTS ? m->N * STAGES - at : POINTS;
    int status;
    for (int l = 0; l < POINTS; ++l) {
        load_point(m, at + (l < used ? l : used - 1), arm, l);
    }
    status = solve_kinematics(arm, space);
    if (status == MODEL_OK) {
        status = evaluate_rows(arm, space);
    }
    if (status != MODEL_OK) {
        return status;
    }
    for (int l = 0; l < used; ++l) {
        for (int i = 0; i < NE; ++i) {
            const real row = arm->row[i][l] / m->scale[i];
            m->residual = fmax_1(m->residual, fabs_1(row));
            if (rows != NULL) {
                rows[(ptrdiff_t)(at + l) * NE + i] = row;
            }
        }
        for (int i = 0; i < NG; ++i) {
            m->q_g[(ptrdiff_t)(at + l) * NG + i] = arm->q[i_g[i]][l];
        }
    }
    return MODEL_OK;
}

/*
 * The largest residual at all Gauss points, without Jacobians; the joints are updated. rows: NE
 * residuals of each point; not written if null.
 */
static inline int evaluate_residual(mesh *m, real *rows, lq_space *w, real *space)
{
    m->residual = 0.0;
    begin_points(&w->arm);
    for (int at = 0; at < m->N * STAGES; at += POINTS) {
        const int status = evaluate_residual_at(m, at, rows, w, space);
        if (status != MODEL_OK) {
            return status;
        }
    }
    return MODEL_OK;
}

/*
 * A row of J: `weights` times the rows of K, D and A; a vector may write beyond them, where the
 * next block follows.
 */
static inline void add_up_triple(const real *triple, const real *weights, real *row)
{
    const lanes of_K = splat_v(weights[0]), of_D = splat_v(weights[1]), of_A = splat_v(weights[2]);
    for (int j = 0; j < NE; j += LANES) {
        store_v(row + j, of_K * load_v(triple + j) + of_D * load_v(triple + NE + j) +
                             of_A * load_v(triple + 2 * NE + j));
    }
}

/* Share of the accelerations of point t in speeds and positions of point s, times h and h^2. */
static inline void stage_weights(real h, int s, int t, real *once, real *twice)
{
#if MODEL_DIRECT
    *twice = gauss_AA[s][t];
#else  /* MODEL_DIRECT */
    *twice = 0.0;
    for (int k = 0; k < STAGES; ++k) {
        *twice += gauss_A[s][k] * gauss_A[k][t];
    }
#endif /* MODEL_DIRECT */
    *once = h * gauss_A[s][t] * scale_a;
    *twice *= h * h * scale_a;
}

/*
 * Rows of the linearized residuals of one interval, in scaled unknowns (a, q, v) and right side.
 */
static inline void interval_rows(const mesh *m, const real *point, real *J)
{
    const real h = m->h;
    for (int s = 0; s < STAGES; ++s) {
        const real *at = point + s * POINT;
        real weights[STAGES + 2][3] = {{0.0}};
        for (int t = 0; t < STAGES; ++t) {
            stage_weights(h, s, t, weights[t] + 1, weights[t]);
        }
        weights[s][2] = scale_a;
        weights[STAGES][0] = scale_q;
        weights[STAGES + 1][0] = scale_v * (h * gauss_c[s]);
        weights[STAGES + 1][1] = scale_v;
        for (int i = 0; i < NE; ++i) {
            real *row = J + (s * NE + i) * WIDTH;
            for (int block = 0; block < STAGES + 2; ++block) {
                add_up_triple(at + i * TRIPLE, weights[block], row + block * NE);
            }
            row[CONTROLS + STATES] = at[NE * TRIPLE + i];
            for (int j = COLUMNS; j < WIDTH; ++j) {
                row[j] = 0.0;
            }
        }
    }
}

/* J' J of an interval. */
static inline void sum_of_rows(const mesh *m, const real *point, real *J, real *H)
{
    interval_rows(m, point, J);
    set_zero(H, COLUMNS * WIDTH);
    add_outer_products(H, J, J, RESIDUALS, 0);
}

/* Scaled distance of state i of node k from its target. */
static inline real target_distance(const mesh *m, ptrdiff_t k, int i)
{
    return (m->y[k * STATES + i] - m->target_state[k * STATES + i]) / (i < NE ? scale_q : scale_v);
}

/* Add the cost to go of the node after interval k, and the regularization. */
static inline void add_cost_to_go(const mesh *m, int k, const lq_space *w, real *H)
{
    const real h = m->h, drift = h * scale_v / scale_q;
    const real *P = w->P, *p = w->p;
    real to_q[STAGES], to_v[STAGES];
    for (int j = 0; j < STAGES; ++j) {
        to_q[j] = h * h * gauss_b[j] * (1.0 - gauss_c[j]) * scale_a / scale_q;
        to_v[j] = h * gauss_b[j] * scale_a / scale_v;
    }
    for (int i = 0; i < NE; ++i) {
        const real *Pq = P + i * STATES, *Pv = P + (NE + i) * STATES;
        for (int s = 0; s < STAGES; ++s) {
            real *row = H + (s * NE + i) * WIDTH;
            for (int t = s; t < STAGES; ++t) {
                for (int j = 0; j < NE; ++j) {
                    row[t * NE + j] += to_q[s] * (to_q[t] * Pq[j] + to_v[t] * Pq[NE + j]) +
                                       to_v[s] * (to_q[t] * Pv[j] + to_v[t] * Pv[NE + j]);
                }
            }
            for (int j = 0; j < NE; ++j) {
                const real q = to_q[s] * Pq[j] + to_v[s] * Pv[j];
                row[CONTROLS + j] += q;
                row[CONTROLS + NE + j] += drift * q + to_q[s] * Pq[NE + j] + to_v[s] * Pv[NE + j];
            }
            row[s * NE + i] += regularization;
            row[CONTROLS + STATES] += to_q[s] * p[i] + to_v[s] * p[NE + i];
        }
        {
            real *row = H + (CONTROLS + i) * WIDTH + CONTROLS;
            for (int j = 0; j < NE; ++j) {
                row[j] += Pq[j];
                row[NE + j] += drift * Pq[j] + Pq[NE + j];
            }
            row[i] += regularization;
            row[STATES] += p[i];
            row = H + (CONTROLS + NE + i) * WIDTH + CONTROLS;
            for (int j = 0; j < NE; ++j) {
                row[NE + j] += drift * (drift * Pq[j] + Pq[NE + j] + Pv[j]) + Pv[NE + j];
            }
            row[NE + i] += regularization;
            row[STATES] += drift * p[i] + p[NE + i];
        }
    }
    for (int i = 0; i < STATES && m->target_state != NULL; ++i) {
        H[(CONTROLS + i) * WIDTH + CONTROLS + STATES] += regularization * target_distance(m, k, i);
    }
}

/*
 * Eliminate the controls: H is left with the cost to go of the node; 0 where it is not positive
 * definite.
 */
static inline int eliminate(real *RESTRICT H, real *RESTRICT factor)
{
    real weighed[PANEL * WIDTH];
    for (int begin = 0; begin < CONTROLS; begin += PANEL) {
        const int count = CONTROLS - begin < PANEL ? CONTROLS - begin : PANEL;
        real *rows = factor + begin * WIDTH;
        for (int p = 0; p < count; ++p) {
            real *row = rows + p * WIDTH;
            const int k = begin + p;
            real weight;
            for (int j = k / BLOCK * BLOCK; j < WIDTH; j += LANES) {
                lanes sum = load_v(H + k * WIDTH + j);
                for (int r = 0; r < p; ++r) {
                    sum += splat_v(weighed[r * WIDTH + k]) * load_v(rows + r * WIDTH + j);
                }
                store_v(row + j, sum);
            }
            if (!(row[k] > 0.0)) {
                return 0;
            }
            weight = -1.0 / row[k];
            for (int j = k / BLOCK * BLOCK; j < WIDTH; j += LANES) {
                store_v(weighed + p * WIDTH + j, splat_v(weight) * load_v(row + j));
            }
            row[k] = weight;
        }
        add_outer_products(H, rows, weighed, count, begin + count);
    }
    return 1;
}

/*
 * The factor of interval k, whose rows are in J, and the cost to go of its first node instead of
 * that of its last.
 */
static inline int factor_interval(const mesh *m, int k, lq_space *w, real *factor)
{
    add_cost_to_go(m, k, w, w->H);
    if (!eliminate(w->H, factor)) {
        return 0;
    }
    for (int i = 0; i < STATES; ++i) {
        const real *row = w->H + (CONTROLS + i) * WIDTH + CONTROLS;
        for (int j = i; j < STATES; ++j) {
            w->P[i * STATES + j] = row[j];
            w->P[j * STATES + i] = row[j];
        }
        w->p[i] = row[STATES];
    }
    return 1;
}

/*
 * The factors of the intervals before `last`, backwards, from the cost to go of its first node.
 * kept: what `evaluate_group` gives for all of them; NULL: it is not kept.
 */
static inline int lq_factor_before(mesh *m, int last, real *kept, lq_space *w, real *space)
{
    begin_points(&w->arm);
    while (last > 0) {
        const int first = last > GROUP ? last - GROUP : 0;
        real *points_out = kept != NULL ? kept + (ptrdiff_t)first * STAGES * POINT : w->point;
        const int status = evaluate_group(m, first, NULL, last - first, points_out, w, space);
        if (status != MODEL_OK) {
            return status;
        }
        for (int k = last - 1; k >= first; --k) {
            sum_of_rows(m, points_out + (ptrdiff_t)(k - first) * STAGES * POINT, w->J, w->H);
            if (!factor_interval(m, k, w, m->factor + slot_of(m, k) * CONTROLS * WIDTH)) {
                return MODEL_NOT_CONVERGED;
            }
        }
        last = first;
    }
    return is_finite(w->p, STATES) ? MODEL_OK : MODEL_NOT_CONVERGED;
}

/*
 * The factors of the intervals from `first` to the last one, which all have the same data `point`.
 */
static inline int lq_factor_alike(mesh *m, int first, const real *point, lq_space *w)
{
    real *H = w->point + STAGES * POINT; /* sum over the rows of J */
    sum_of_rows(m, point, w->J, H);
    for (int k = m->N - 1; k >= first; --k) {
        copy(H, COLUMNS * WIDTH, w->H);
        if (!factor_interval(m, k, w, m->factor + slot_of(m, k) * CONTROLS * WIDTH)) {
            return MODEL_NOT_CONVERGED;
        }
    }
    return is_finite(w->p, STATES) ? MODEL_OK : MODEL_NOT_CONVERGED;
}

/* One Gauss-Newton step: the factors of all intervals, backwards. */
static inline int lq_factor(mesh *m, lq_space *w, real *space)
{
    for (int i = 0; i < STATES; ++i) {
        w->p[i] = 0.0;
        for (int j = 0; j < STATES; ++j) {
            w->P[i * STATES + j] = m->end[i * STATES + j];
        }
        for (int j = 0; j < STATES && m->target_state != NULL; ++j) {
            w->p[i] += w->P[i * STATES + j] * target_distance(m, m->N, j);
        }
    }
    return lq_factor_before(m, m->N, NULL, w, space);
}

/*
 * Pivots of the elimination of the cost P: a small cost that large ones hide on the diagonal of P
 * is seen in them.
 */
static inline void cost_pivots(const real *P, real *pivots)
{
    real L[STATES][STATES];
    for (int i = 0; i < STATES; ++i) {
        for (int j = 0; j <= i; ++j) {
            real sum = P[i * STATES + j];
            for (int k = 0; k < j; ++k) {
                sum -= L[i][k] * L[j][k] * pivots[k];
            }
            if (i == j) {
                pivots[i] = fmax_1(sum, regularization);
            } else {
                L[i][j] = sum / pivots[j];
            }
        }
    }
}

/* Costs that still change from sweep to sweep. */
typedef struct {
    real pivots[STATES], added[STATES];
} cost_growth;

/*
 * Whether the cost has converged: no diagonal entry of P changes by more than the share `change`,
 * and no pivot by more than that and by more than in the sweep before. The cost of a stable motion
 * grows less and less; that of an unstable one grows exponentially until it is large, for long
 * where the intervals are short. exact_too: no pivot that counts changes by more than
 * `converged_cost`, or by rounding, of a cost that larger ones hide: more intervals cannot cost
 * less, so that a pivot shrinks by rounding only.
 */
static inline int is_stationary(
    const real *P, const real *before, real change, cost_growth *g, int *exact_too)
{
    int settled = 1;
    real pivots[STATES];
    cost_pivots(P, pivots);
    *exact_too = 1;
    for (int i = 0; i < STATES; ++i) {
        const real added = pivots[i] - g->pivots[i];
        settled = settled && fabs_1(P[i * (STATES + 1)] - before[i * (STATES + 1)]) <=
                                 change * P[i * (STATES + 1)];
        settled = settled && !(added > change * pivots[i] && added > g->added[i]);
        *exact_too = *exact_too && (pivots[i] <= counted_cost ||
                                       (added <= converged_cost * pivots[i] &&
                                           added >= -fmax_1(change, converged_cost) * pivots[i]));
        g->pivots[i] = pivots[i];
        g->added[i] = added;
    }
    return settled;
}

/*
 * The cost to go of an endless equilibrium: close to zero for stable motions, large for unstable
 * ones; by sweeps over `intervals` intervals like the first one of the mesh `hold`, from a
 * multiple `initial` of the unit matrix. It is the only condition at the end of a horizon. The
 * sweeps end where it has converged to the share `change` and, where they get there in
 * MORE_SWEEPS, exactly, or after `sweeps`. Left are the data of the interval in w->point and its
 * factor in hold->factor. is_exact: whether all intervals of an endless equilibrium can have this
 * factor.
 */
static inline int lq_stationary_cost(mesh *hold, int intervals, int sweeps, real initial,
    real change, lq_space *w, real *space, real *cost, int *is_exact)
{
    cost_growth growth = {{0.0}, {0.0}};
    int settled_since = 0;
    /* sum over the rows of J; the space of other points is free */
    real *H = w->point + STAGES * POINT;
    int status;
    begin_points(&w->arm);
    status = evaluate_group(hold, 0, NULL, 1, w->point, w, space);
    if (status != MODEL_OK) {
        return status;
    }
    sum_of_rows(hold, w->point, w->J, H);
    for (int i = 0; i < STATES * STATES; ++i) {
        cost[i] = w->P[i] = i % (STATES + 1) == 0 ? initial : 0.0;
    }
    set_zero(w->p, STATES);
    *is_exact = 0;
    for (int sweep = 0; sweep < sweeps; ++sweep) {
        int settled;
        for (int k = 0; k < intervals; ++k) {
            copy(H, COLUMNS * WIDTH, w->H);
            if (!factor_interval(hold, 0, w, hold->factor)) {
                return MODEL_NOT_CONVERGED;
            }
        }
        if (!is_finite(w->p, STATES)) {
            return MODEL_NOT_CONVERGED;
        }
        settled = is_stationary(w->P, cost, change, &growth, is_exact);
        copy(w->P, STATES * STATES, cost);
        settled_since = settled ? settled_since + 1 : 0;
        if (settled && (*is_exact || settled_since > MORE_SWEEPS)) {
            break;
        }
    }
    return MODEL_OK;
}

/*
 * The sum of n products, in BLOCK parts that do not depend on the width of a vector; n: a multiple
 * of BLOCK.
 */
static inline real inner_product(const real *a, const real *b, int n)
{
    real sums[BLOCK];
    lanes parts[BLOCK / LANES];
    for (int l = 0; l < BLOCK / LANES; ++l) {
        parts[l] = splat_v(0.0);
    }
    for (int i = 0; i < n; i += BLOCK) {
        for (int l = 0; l < BLOCK / LANES; ++l) {
            parts[l] += load_v(a + i + l * LANES) * load_v(b + i + l * LANES);
        }
    }
    for (int l = 0; l < BLOCK / LANES; ++l) {
        store_v(sums + l * LANES, parts[l]);
    }
    for (int half = BLOCK / 2; half > 0; half /= 2) {
        for (int l = 0; l < half; ++l) {
            sums[l] += sums[l + half];
        }
    }
    return sums[0];
}

/*
 * The controls of an interval at a state, both scaled: x holds 0 (CONTROLS), the state (STATES),
 * 1, and zeros up to WIDTH; without the 1 it is the response to the state alone. The controls take
 * the place of the first zeros. Right sides: the last column of the factor or, where given,
 * `linear`.
 */
static inline void lq_controls(const real *factor, const real *linear, real *x)
{
    for (int end = (CONTROLS + BLOCK - 1) / BLOCK * BLOCK; end > 0; end -= BLOCK) {
        const int last = end < CONTROLS ? end : CONTROLS;
        /* of what is known, for a block of rows that do not wait for each other */
        real sums[BLOCK];
        for (int i = end - BLOCK; i < last; ++i) {
            sums[i - end + BLOCK] = inner_product(factor + i * WIDTH + end, x + end, WIDTH - end);
        }
        for (int i = last - 1; i >= end - BLOCK; --i) {
            const real *row = factor + i * WIDTH;
            real sum = sums[i - end + BLOCK] + (linear != NULL ? linear[i] : 0.0);
            /* what has just been found comes last: less waits for it */
            for (int j = end - 1; j > i; --j) {
                sum += row[j] * x[j];
            }
            x[i] = sum * row[i];
        }
    }
}

/*
 * Data of the linear terms of a step, in addition to the factors; `slot_of` gives the number of an
 * interval.
 */
typedef struct {
    /* varying x STAGES x POINT: K, D, A of the factors, and BLOCK more */
    const real *point;
    /* STAGES x POINT, and BLOCK more: of the intervals that do not vary, if any */
    const real *steady_point;
    const real *steady_factor; /* CONTROLS x WIDTH: of the intervals without one of their own */
    real *row;                 /* N x STAGES x NE: residuals */
    real *linear;              /* N x CONTROLS: right sides of the factors */
#if MODEL_FORCE
    int own; /* so many of the first factors have right sides of their own */
    /* size of the response to a force that the first guess of the motion has; 0: there is none */
    real response;
#endif /* MODEL_FORCE */
} lq_data;

/* The factor of interval k. */
static inline const real *factor_of(const mesh *m, const lq_data *c, ptrdiff_t k)
{
    return k < m->factored ? m->factor + slot_of(m, k) * CONTROLS * WIDTH : c->steady_factor;
}

/* Weights by `stage_weights` of all pairs of points. */
typedef struct {
    real once[STAGES][STAGES], twice[STAGES][STAGES];
} pair_weights;

/* J' R of an interval in its scaled unknowns. */
static inline void lq_gradient(
    const pair_weights *weights, const real *point, const real *row, real h, real *g)
{
    set_zero(g, WIDTH);
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
                g[t * NE + i] += weights->twice[s][t] * K + weights->once[s][t] * D;
            }
            g[s * NE + i] += scale_a * A;
            g[CONTROLS + i] += scale_q * K;
            g[CONTROLS + NE + i] += scale_v * (h * gauss_c[s] * K + D);
        }
    }
}

/*
 * What `eliminate` does with the last column, to g; by blocks of rows, as each waits for those
 * before it.
 */
static inline void eliminate_column(const real *factor, real *g)
{
    for (int begin = 0; begin < CONTROLS; begin += BLOCK) {
        const int end = begin + BLOCK, last = end < CONTROLS ? end : CONTROLS;
        real weighed[BLOCK];
        for (int i = begin; i < last; ++i) {
            const real *row = factor + i * WIDTH;
            weighed[i - begin] = g[i] * row[i];
            for (int j = i + 1; j < end; ++j) {
                g[j] += weighed[i - begin] * row[j];
            }
        }
        for (int j = end; j < WIDTH; j += LANES) {
            lanes sum = load_v(g + j);
            for (int i = begin; i < last; ++i) {
                sum += splat_v(weighed[i - begin]) * load_v(factor + i * WIDTH + j);
            }
            store_v(g + j, sum);
        }
    }
}

/* The linear terms of a step with known factors, backwards; 0 where one is not finite. */
static inline int lq_linear(const mesh *m, const lq_data *c)
{
    const real h = m->h, drift = h * scale_v / scale_q, *end = m->y + (ptrdiff_t)m->N * STATES;
    real p[STATES], to_q[STAGES], to_v[STAGES];
    pair_weights weights;
    int still;
    for (int j = 0; j < STAGES; ++j) {
        to_q[j] = h * h * gauss_b[j] * (1.0 - gauss_c[j]) * scale_a / scale_q;
        to_v[j] = h * gauss_b[j] * scale_a / scale_v;
        for (int t = 0; t < STAGES; ++t) {
            stage_weights(h, j, t, &weights.once[j][t], &weights.twice[j][t]);
        }
    }
    for (int i = 0; i < STATES; ++i) {
        p[i] = 0.0;
        for (int j = 0; j < STATES; ++j) {
            const real off = m->target_state != NULL ?
                                 target_distance(m, m->N, j) :
                                 (end[j] - m->equilibrium[j]) / (j < NE ? scale_q : scale_v);
            p[i] += m->end[i * STATES + j] * off;
        }
    }
    /* there is nothing to correct so far */
    still = m->target_state == NULL && largest(p, STATES) == 0.0;
    for (ptrdiff_t k = m->N - 1; k >= 0; --k) {
        const real *factor = factor_of(m, c, k);
        real g[WIDTH];
        still = still && largest(c->row + k * RESIDUALS, RESIDUALS) == 0.0;
        if (still) {
            for (int i = 0; i < CONTROLS; ++i) {
                c->linear[k * CONTROLS + i] = 0.0;
            }
            continue;
        }
        lq_gradient(&weights,
            k < m->varying ? c->point + slot_of(m, k) * STAGES * POINT : c->steady_point,
            c->row + k * STAGES * NE, h, g);
        for (int i = 0; i < NE; ++i) {
            for (int s = 0; s < STAGES; ++s) {
                g[s * NE + i] += to_q[s] * p[i] + to_v[s] * p[NE + i];
            }
            g[CONTROLS + i] += p[i];
            g[CONTROLS + NE + i] += drift * p[i] + p[NE + i];
        }
        for (int i = 0; i < STATES && m->target_state != NULL; ++i) {
            g[CONTROLS + i] += regularization * target_distance(m, k, i);
        }
        eliminate_column(factor, g);
        copy(g, CONTROLS, c->linear + k * CONTROLS);
        copy(g + CONTROLS, STATES, p);
    }
    return is_finite(p, STATES);
}

/* The x of `lq_controls` for a state. */
static inline void lq_state(const real *d, real forced, real *x)
{
    set_zero(x, WIDTH);
    copy(d, STATES, x + CONTROLS);
    x[CONTROLS + STATES] = forced;
}

/*
 * Preview: number of intervals after which a change of the path changes the present motion by less
 * than `share` of itself. The cost to go P of a state d measures its unstable part: sqrt(d' P d)
 * after k intervals, relative to its initial value. N + 1 where the mesh is too short. most:
 * memory of N + 1 numbers.
 */
static inline int lq_preview(const mesh *m, const real *P, real felt, real *most)
{
    for (int k = 0; k <= m->N; ++k) {
        most[k] = 0.0;
    }
    for (int i = 0; i < STATES; ++i) {
        real d[STATES] = {0.0}, x[WIDTH];
        d[i] = 1.0;
        for (int k = 0; k <= m->N; ++k) {
            real cost = 0.0, dy[STATES], da[CONTROLS], next[STATES];
            for (int a = 0; a < STATES; ++a) {
                for (int b = 0; b < STATES; ++b) {
                    cost += d[a] * P[a * STATES + b] * d[b];
                }
                dy[a] = d[a] * (a < NE ? scale_q : scale_v);
            }
            most[k] = fmax_1(most[k], cost);
            if (k == m->N) {
                break;
            }
            lq_state(d, 0.0, x);
            lq_controls(m->factor + slot_of(m, k) * CONTROLS * WIDTH, NULL, x);
            for (int a = 0; a < CONTROLS; ++a) {
                da[a] = x[a] * scale_a;
            }
            next_node(dy, da, m->h, next);
            for (int a = 0; a < STATES; ++a) {
                d[a] = next[a] / (a < NE ? scale_q : scale_v);
            }
        }
    }
    for (int k = 0; k <= m->N; ++k) {
        if (most[k] <= fmax_1(felt * felt * most[0], negligible_cost)) {
            return k;
        }
    }
    return m->N + 1;
}

/*
 * The step in interval k, from the change d of its first node, scaled; d becomes that of its last
 * node. Returned: its largest scaled control.
 */
static inline real step_interval(
    mesh *m, ptrdiff_t k, const real *factor, const real *linear, real d[STATES])
{
    real *a = m->a + k * CONTROLS, *y = m->y + k * STATES;
    real x[WIDTH], dy[STATES], da[CONTROLS], next[STATES];
    lq_state(d, linear == NULL ? 1.0 : 0.0, x);
    lq_controls(factor, linear, x);
    for (int i = 0; i < NE; ++i) {
        dy[i] = d[i] * scale_q;
        dy[NE + i] = d[NE + i] * scale_v;
    }
    for (int i = 0; i < CONTROLS; ++i) {
        da[i] = x[i] * scale_a;
    }
    next_node(dy, da, m->h, next);
    for (int i = 0; i < STATES; ++i) {
        y[i] += dy[i];
    }
    for (int i = 0; i < CONTROLS; ++i) {
        a[i] += da[i];
    }
    for (int i = 0; i < NE; ++i) {
        d[i] = next[i] / scale_q;
        d[NE + i] = next[NE + i] / scale_v;
    }
    return largest(x, CONTROLS);
}

/* The last part of a step: the change d of the last node, scaled. */
static inline void step_last_node(mesh *m, const real d[STATES])
{
    real *y = m->y + (ptrdiff_t)m->N * STATES;
    for (int i = 0; i < NE; ++i) {
        y[i] += d[i] * scale_q;
        y[NE + i] += d[NE + i] * scale_v;
    }
}

/* The step itself, forwards. d: the change of the first node, scaled; it is overwritten. */
static inline void lq_step(mesh *m, real d[STATES])
{
    for (int k = 0; k < m->N; ++k) {
        (void)step_interval(m, k, m->factor + slot_of(m, k) * CONTROLS * WIDTH, NULL, d);
    }
    step_last_node(m, d);
}

/*
 * The step itself, forwards, by factors and right sides; its largest scaled control. d: as in
 * `lq_step`.
 */
static inline real lq_data_step(mesh *m, const lq_data *c, real d[STATES])
{
    real most = 0.0;
    for (ptrdiff_t k = 0; k < m->N; ++k) {
#if MODEL_FORCE
        const real *linear = k < c->own ? NULL : c->linear + k * CONTROLS;
        most = fmax_1(most, step_interval(m, k, factor_of(m, c, k), linear, d));
#else  /* MODEL_FORCE */
        most = fmax_1(most, step_interval(m, k, factor_of(m, c, k), c->linear + k * CONTROLS, d));
#endif /* MODEL_FORCE */
    }
    step_last_node(m, d);
    return most;
}

#endif

#endif
