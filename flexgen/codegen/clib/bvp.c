/*
 * model: inverse dynamics along a path as a two-point boundary value problem. Written by flexgen;
 * see model_inversion.h.
 *
 * At the start the state may differ from the equilibrium by the unstable part of the zero
 * dynamics, at the end by the stable part. Between them the equations hold at the Gauss points,
 * and Newton's method solves all of them together. There are no weights, so that bvp is an
 * independent check of invert. The zero dynamics must have the same numbers of stable and unstable
 * motions at both ends.
 */
#include "model_inversion.h"

#include "model_inversion_common.h"
#include "model_lq_step.h"
#include "model_reduced_problem.h"
#include "model_whole_path.h"

/*
 * --- One Newton step of the two-point problem over a mesh, by elimination with row pivoting.
 *
 * The unknowns are, in scaled steps, the accelerations a of each interval and the states y of all
 * nodes. The equations are the residuals at the Gauss points and the motion to the next node,
 * interval after interval, and boundary rows:
 *
 *     first . y_0 = ...,    J_a a_k + J_y y_k = ...,    C_a a_k + C_y y_k - y_(k+1) = ...,    last
 *       . y_N = ...
 *
 * In an interval a is eliminated first, with pivots among all its rows, because the residuals
 * alone may be singular in a; then y_k, with pivots among the remaining rows and those of the
 * interval before, as many as boundary rows at the start. The step is stable where the rows at the
 * start fix the stable part and those at the end the unstable part.
 */

#if MODEL_NE > 0

enum {
    INTERVAL_ROWS = CONTROLS + STATES,
    /* a_k, y_k, y_(k+1), right side */
    INTERVAL_WIDTH = (CONTROLS + 2 * STATES + 1 + BLOCK - 1) / BLOCK * BLOCK,
    NODE_ROWS = 2 * STATES,
    NODE_WIDTH = (2 * STATES + 1 + BLOCK - 1) / BLOCK * BLOCK, /* y_k, y_(k+1), right side */
    INTERVAL_FACTOR = CONTROLS * INTERVAL_WIDTH + STATES * NODE_WIDTH
};

static const real least_pivot = 1e-14; /* of rows whose entries sum up to one */

/* The boundary value problem: a mesh and its boundary rows. */
typedef struct {
    mesh m;
    int from_start, from_end;                         /* rows there; STATES together */
    real first[STATES][STATES], last[STATES][STATES]; /* rows, of scaled states */
    real equilibrium_start[STATES], equilibrium_end[STATES];
    int turns; /* out: whether the determinant of A changes its sign on the mesh */
} bvp_problem;

typedef struct {
    lq_space lq;
    real interval[INTERVAL_ROWS * INTERVAL_WIDTH];
    real node[NODE_ROWS * NODE_WIDTH];
} bvp_space;

/* The sum of PANEL partial sums: the same for every width of a vector. */
static inline real sum_partial(const lanes *partial)
{
    real numbers[PANEL], sum = 0.0;
    for (int p = 0; p < PANEL; p += LANES) {
        store_v(numbers + p, partial[p / LANES]);
    }
    for (int p = 0; p < PANEL; ++p) {
        sum += numbers[p];
    }
    return sum;
}

/*
 * Scale each row so that the absolute values of its entries, without the right side, sum up to
 * one; 0 where all are zero.
 */
static inline int scale_rows(real *rows, int height, int columns, int width)
{
    for (int i = 0; i < height; ++i) {
        real *row = rows + i * width;
        const int whole = columns / PANEL * PANEL;
        lanes partial[PANEL / LANES];
        real size = 0.0;
        for (int p = 0; p < PANEL / LANES; ++p) {
            partial[p] = splat_v(0.0);
        }
        for (int j = 0; j < whole; j += PANEL) {
            for (int p = 0; p < PANEL / LANES; ++p) {
                partial[p] += fabs_v(load_v(row + j + p * LANES));
            }
        }
        for (int j = whole; j < columns; ++j) {
            size += fabs_1(row[j]);
        }
        size += sum_partial(partial);
        if (!(size > 1e-300 && size < 1e300)) {
            return 0;
        }
        size = 1.0 / size;
        for (int j = 0; j < width; j += LANES) {
            store_v(row + j, splat_v(size) * load_v(row + j));
        }
    }
    return 1;
}

/* row += the sum of factors[p] rows[p], p < count, from column `begin` on. */
static inline void add_rows(real *RESTRICT row, const real *RESTRICT rows, const real *factors,
    int count, int begin, int width)
{
    real w[PANEL], any = 0.0;
    for (int p = 0; p < PANEL; ++p) {
        w[p] = p < count ? factors[p] : 0.0;
        any = fmax_1(any, fabs_1(w[p]));
    }
    if (!(any > 0.0)) {
        return;
    }
    if (count == PANEL) {
        for (int j = begin; j < width; j += LANES) {
            lanes sum = load_v(row + j);
            for (int p = 0; p < PANEL; ++p) {
                sum += splat_v(w[p]) * load_v(rows + p * width + j);
            }
            store_v(row + j, sum);
        }
        return;
    }
    for (int j = begin; j < width; j += LANES) {
        lanes sum = load_v(row + j);
        for (int p = 0; p < count; ++p) {
            sum += splat_v(w[p]) * load_v(rows + p * width + j);
        }
        store_v(row + j, sum);
    }
}

/*
 * Eliminate the first `columns` columns of scaled rows, eight at a time; 0 where a pivot is zero
 * to rounding. Pivots are stored inverted; the entries to their left are not used any more.
 */
static inline int eliminate_rows(real *RESTRICT rows, int height, int columns, int width)
{
    for (int begin = 0; begin < columns; begin += PANEL) {
        const int end = columns - begin < PANEL ? columns : begin + PANEL;
        for (int k = begin; k < end; ++k) {
            const int best = pivot_row(rows, height, width, k);
            real *top = rows + k * width, masked[PANEL], pivot;
            if (!(fabs_1(rows[best * width + k]) > least_pivot)) {
                return 0;
            }
            for (int j = begin; j < width && best != k; j += LANES) {
                const lanes t = load_v(top + j);
                store_v(top + j, load_v(rows + best * width + j));
                store_v(rows + best * width + j, t);
            }
            pivot = 1.0 / top[k];
            top[k] = pivot;
            for (int p = 0; p < PANEL; ++p) {
                masked[p] = begin + p > k ? top[begin + p] : 0.0;
            }
            /* in these columns; the factor stays where it was */
            for (int i = k + 1; i < height; ++i) {
                real *row = rows + i * width;
                const real f = -row[k] * pivot;
                for (int p = 0; p < PANEL; p += LANES) {
                    store_v(row + begin + p,
                        load_v(row + begin + p) + splat_v(f) * load_v(masked + p));
                }
                row[k] = f;
            }
        }
        for (int i = begin + 1; i < height; ++i) { /* in all columns to the right */
            const int count = (i < end ? i : end) - begin;
            add_rows(rows + i * width, rows + begin * width, rows + i * width + begin, count,
                begin + PANEL, width);
        }
    }
    return 1;
}

/*
 * x[0 ... columns) from eliminated rows with inverted pivots, given x[columns ... all); room for
 * `width` in x.
 */
static inline void substitute(const real *rows, int columns, int all, int width, real *x)
{
    x[all] = 1.0; /* of the right side */
    for (int j = all + 1; j < width; ++j) {
        x[j] = 0.0;
    }
    for (int i = columns - 1; i >= 0; --i) {
        const real *row = rows + i * width;
        const int whole = (i + PANEL) / PANEL * PANEL;
        lanes partial[PANEL / LANES];
        real sum = 0.0;
        for (int p = 0; p < PANEL / LANES; ++p) {
            partial[p] = splat_v(0.0);
        }
        for (int j = i + 1; j < whole; ++j) {
            sum += row[j] * x[j];
        }
        for (int j = whole; j < width; j += PANEL) {
            for (int p = 0; p < PANEL / LANES; ++p) {
                partial[p] += load_v(row + j + p * LANES) * load_v(x + j + p * LANES);
            }
        }
        x[i] = -(sum + sum_partial(partial)) * row[i];
    }
}

/* Sign of the determinant of A, given by rows, n x n; A is overwritten. */
static inline int sign_of(real *A)
{
    int sign = 1;
    for (int k = 0; k < NE; ++k) {
        const int best = pivot_row(A, NE, NE, k);
        swap_rows(A + k * NE, A + best * NE, NE);
        if (best != k) {
            sign = -sign;
        }
        if (!(A[k * NE + k] < 0.0 || A[k * NE + k] > 0.0)) {
            return 0;
        }
        sign = A[k * NE + k] < 0.0 ? -sign : sign;
        for (int i = k + 1; i < NE; ++i) {
            const real f = A[i * NE + k] / A[k * NE + k];
            for (int j = k; j < NE; ++j) {
                A[i * NE + j] -= f * A[k * NE + j];
            }
        }
    }
    return sign;
}

/* Rows of one interval: residuals at its Gauss points, and the motion to the next node. */
static inline void fill_interval(const mesh *m, int k, const real *point, bvp_space *w)
{
    const real h = m->h, drift = h * scale_v / scale_q;
    const real *y = m->y + (ptrdiff_t)k * STATES;
    real next[STATES], *rows = w->interval;
    interval_rows(m, point, w->lq.J);
    set_zero(rows, INTERVAL_ROWS * INTERVAL_WIDTH);
    for (int i = 0; i < CONTROLS; ++i) {
        for (int j = 0; j < CONTROLS + STATES; ++j) {
            rows[i * INTERVAL_WIDTH + j] = w->lq.J[i * WIDTH + j];
        }
        rows[i * INTERVAL_WIDTH + CONTROLS + 2 * STATES] = w->lq.J[i * WIDTH + CONTROLS + STATES];
    }
    next_node(y, m->a + (ptrdiff_t)k * CONTROLS, h, next);
    for (int i = 0; i < NE; ++i) {
        real *row_q = rows + (CONTROLS + i) * INTERVAL_WIDTH,
             *row_v = rows + (CONTROLS + NE + i) * INTERVAL_WIDTH;
        for (int s = 0; s < STAGES; ++s) {
            row_q[s * NE + i] = h * h * gauss_b[s] * (1.0 - gauss_c[s]) * scale_a / scale_q;
            row_v[s * NE + i] = h * gauss_b[s] * scale_a / scale_v;
        }
        row_q[CONTROLS + i] = 1.0;
        row_q[CONTROLS + NE + i] = drift;
        row_v[CONTROLS + NE + i] = 1.0;
        row_q[CONTROLS + STATES + i] = -1.0;
        row_v[CONTROLS + STATES + NE + i] = -1.0;
        row_q[CONTROLS + 2 * STATES] = (next[i] - y[STATES + i]) / scale_q;
        row_v[CONTROLS + 2 * STATES] = (next[NE + i] - y[STATES + NE + i]) / scale_v;
    }
}

/* Value of a boundary row at the scaled distance from the equilibrium. */
static inline real boundary_error(const real *row, const real *y, const real *equilibrium)
{
    real sum = 0.0;
    for (int j = 0; j < STATES; ++j) {
        sum += row[j] * (y[j] - equilibrium[j]) / (j < NE ? scale_q : scale_v);
    }
    return sum;
}

/* Boundary rows: their values at the scaled distance from the equilibrium become zero. */
static inline void fill_end(
    real (*rows)[STATES], int count, const real *y, const real *equilibrium, real *to)
{
    for (int i = 0; i < count; ++i) {
        real *row = to + i * NODE_WIDTH;
        set_zero(row, NODE_WIDTH);
        for (int j = 0; j < STATES; ++j) {
            row[j] = rows[i][j];
        }
        row[2 * STATES] = boundary_error(rows[i], y, equilibrium);
    }
}

/* The largest residual of all equations, in their scales. */
static inline int bvp_residual(bvp_problem *b, bvp_space *w, real *space)
{
    mesh *m = &b->m;
    const int status = evaluate_residual(m, NULL, &w->lq, space);
    const real *end = m->y + (ptrdiff_t)m->N * STATES;
    if (status != MODEL_OK) {
        return status;
    }
    for (ptrdiff_t k = 0; k < m->N; ++k) {
        real next[STATES];
        const real *y = m->y + (k + 1) * STATES;
        next_node(m->y + k * STATES, m->a + k * CONTROLS, m->h, next);
        for (int i = 0; i < STATES; ++i) {
            m->residual = fmax_1(
                m->residual, fabs_1(next[i] - y[i]) / (i < NE ? scale_q : scale_v));
        }
    }
    for (int i = 0; i < b->from_start; ++i) {
        m->residual = fmax_1(
            m->residual, fabs_1(boundary_error(b->first[i], m->y, b->equilibrium_start)));
    }
    for (int i = 0; i < b->from_end; ++i) {
        m->residual = fmax_1(
            m->residual, fabs_1(boundary_error(b->last[i], end, b->equilibrium_end)));
    }
    return MODEL_OK;
}

/* The factors of all intervals, forwards. */
static inline int bvp_factor(bvp_problem *b, bvp_space *w, real *space)
{
    mesh *m = &b->m;
    real *node = w->node;
    int sign = 0;
    b->turns = 0;
    begin_points(&w->lq.arm);
    fill_end(b->first, b->from_start, m->y, b->equilibrium_start, node);
    for (int first = 0; first < m->N; first += GROUP) {
        const int count = m->N - first < GROUP ? m->N - first : (int)GROUP;
        const int status = evaluate_group(m, first, NULL, count, w->lq.point, &w->lq, space);
        if (status != MODEL_OK) {
            return status;
        }
        for (int k = first; k < first + count; ++k) {
            real *point = w->lq.point + (ptrdiff_t)(k - first) * STAGES * POINT;
            real *factor = m->factor + (ptrdiff_t)k * INTERVAL_FACTOR,
                 *own = node + b->from_start * NODE_WIDTH;
            fill_interval(m, k, point, w);
            for (int s = 0; s < STAGES; ++s) {
                real A[NE * NE];
                int this_one;
                for (int i = 0; i < NE; ++i) {
                    copy(point + s * POINT + i * TRIPLE + 2 * NE, NE, A + i * NE);
                }
                this_one = sign_of(A);
                b->turns |= this_one == 0 || (sign != 0 && this_one != sign);
                sign = this_one;
            }
            if (!scale_rows(w->interval, INTERVAL_ROWS, CONTROLS + 2 * STATES, INTERVAL_WIDTH) ||
                !eliminate_rows(w->interval, INTERVAL_ROWS, CONTROLS, INTERVAL_WIDTH)) {
                return MODEL_NOT_CONVERGED;
            }
            for (int i = 0; i < CONTROLS * INTERVAL_WIDTH; ++i) {
                factor[i] = w->interval[i];
            }
            for (int i = 0; i < STATES; ++i) {
                for (int j = 0; j <= 2 * STATES; ++j) {
                    own[i * NODE_WIDTH + j] =
                        w->interval[(CONTROLS + i) * INTERVAL_WIDTH + CONTROLS + j];
                }
                for (int j = 2 * STATES + 1; j < NODE_WIDTH; ++j) {
                    own[i * NODE_WIDTH + j] = 0.0;
                }
            }
            if (!scale_rows(node, b->from_start + STATES, 2 * STATES, NODE_WIDTH) ||
                !eliminate_rows(node, b->from_start + STATES, STATES, NODE_WIDTH)) {
                return MODEL_NOT_CONVERGED;
            }
            for (int i = 0; i < STATES * NODE_WIDTH; ++i) {
                factor[CONTROLS * INTERVAL_WIDTH + i] = node[i];
            }
            /* the remaining rows are conditions on the next node */
            for (int i = 0; i < b->from_start; ++i) {
                const real *row = node + (STATES + i) * NODE_WIDTH;
                real *to = node + i * NODE_WIDTH;
                for (int j = 0; j < STATES; ++j) {
                    to[j] = row[STATES + j];
                    to[STATES + j] = 0.0;
                }
                to[2 * STATES] = row[2 * STATES];
            }
        }
    }
    fill_end(b->last, b->from_end, m->y + (ptrdiff_t)m->N * STATES, b->equilibrium_end,
        node + b->from_start * NODE_WIDTH);
    return scale_rows(node, STATES, STATES, NODE_WIDTH) &&
                   eliminate_rows(node, STATES, STATES, NODE_WIDTH) ?
               (int)MODEL_OK :
               (int)MODEL_NOT_CONVERGED;
}

/* The step itself, backwards. */
static inline void back_substitute(bvp_problem *b, bvp_space *w)
{
    mesh *m = &b->m;
    real x[INTERVAL_WIDTH], y[NODE_WIDTH]; /* a_k, y_k, y_(k+1); y_k, y_(k+1) */
    for (int i = 0; i < STATES; ++i) {
        y[STATES + i] = 0.0;
    }
    substitute(w->node, STATES, 2 * STATES, NODE_WIDTH, y);
    for (int i = 0; i < STATES; ++i) {
        m->y[(ptrdiff_t)m->N * STATES + i] += y[i] * (i < NE ? scale_q : scale_v);
    }
    for (ptrdiff_t k = m->N - 1; k >= 0; --k) {
        const real *factor = m->factor + k * INTERVAL_FACTOR;
        for (int i = 0; i < STATES; ++i) {
            y[STATES + i] = y[i];
        }
        substitute(factor + CONTROLS * INTERVAL_WIDTH, STATES, 2 * STATES, NODE_WIDTH, y);
        for (int i = 0; i < 2 * STATES; ++i) {
            x[CONTROLS + i] = y[i];
        }
        substitute(factor, CONTROLS, CONTROLS + 2 * STATES, INTERVAL_WIDTH, x);
        for (int i = 0; i < STATES; ++i) {
            m->y[k * STATES + i] += y[i] * (i < NE ? scale_q : scale_v);
        }
        for (int i = 0; i < CONTROLS; ++i) {
            m->a[k * CONTROLS + i] += x[i] * scale_a;
        }
    }
}

#endif

/*
 * --- Stable and unstable motions near an equilibrium, and the boundary rows of the two-point
 * problem.
 *
 * While the output does not move, the unactuated coordinates w follow A w'' + D w' + K w = 0, and
 * the state x = (w, w') follows x' = G x. The sign S of G is the limit of Newton's method X <- (X
 * + X^-1) / 2 from X = G. It is -1 on the stable motions and +1 on the unstable ones, so that the
 * rows of 1 + S vanish on the stable motions and those of 1 - S on the unstable ones.
 */

#if MODEL_NE > 0

enum { SIGN_STEPS = 45 };

/* least pivot of the scaled A: below it the inertias cancel to rounding */
static const real least_inertia = 1e-9;
static const real sign_tolerance = 1e-6; /* largest error of an entry of S S - 1 */

typedef struct {
    real A[NE][NE], D[NE][NE], K[NE][NE]; /* rows */
    real inertia[NE];                     /* of the unactuated coordinates, with a free output */
} zero_dynamics;

typedef real square[STATES][STATES];

/*
 * X becomes its inverse by Gauss and Jordan with row pivoting, n rows; 0 where a pivot is below
 * `least`.
 */
static inline int invert_square(square X, int n, real least)
{
    int from[STATES];
    for (int k = 0; k < n; ++k) {
        const int best = pivot_row(X[0], n, STATES, k);
        real pivot;
        from[k] = best;
        if (!(fabs_1(X[best][k]) > least)) {
            return 0;
        }
        swap_rows(X[k], X[best], n);
        pivot = 1.0 / X[k][k];
        X[k][k] = 1.0;
        for (int j = 0; j < n; ++j) {
            X[k][j] *= pivot;
        }
        for (int i = 0; i < n; ++i) {
            const real f = X[i][k];
            if (i == k) {
                continue;
            }
            X[i][k] = 0.0;
            for (int j = 0; j < n; ++j) {
                X[i][j] -= f * X[k][j];
            }
        }
    }
    for (int k = n - 1; k >= 0; --k) {
        for (int i = 0; i < n && from[k] != k; ++i) {
            const real t = X[i][k];
            X[i][k] = X[i][from[k]];
            X[i][from[k]] = t;
        }
    }
    return 1;
}

/* Sum of squares. */
static inline real squared_norm(square X)
{
    real sum = 0.0;
    for (int i = 0; i < STATES; ++i) {
        for (int j = 0; j < STATES; ++j) {
            sum += X[i][j] * X[i][j];
        }
    }
    return sum;
}

/* X becomes its sign; 0 where an eigenvalue is, or may be, on the imaginary axis. */
static inline int matrix_sign(square X)
{
    square Y;
    for (int step = 0; step < SIGN_STEPS; ++step) {
        real scale, moved = 0.0, size;
        for (int i = 0; i < STATES; ++i) {
            for (int j = 0; j < STATES; ++j) {
                Y[i][j] = X[i][j];
            }
        }
        size = squared_norm(X);
        if (!invert_square(Y, STATES, 0.0) || !(size < 1e200) || !(squared_norm(Y) < 1e200)) {
            return 0;
        }
        /* X and its inverse become equally large */
        scale = square_root(square_root(squared_norm(Y) / size));
        scale = fabs_1(scale - 1.0) < 0.05 ? 1.0 : scale;
        for (int i = 0; i < STATES; ++i) {
            for (int j = 0; j < STATES; ++j) {
                const real next = 0.5 * (scale * X[i][j] + Y[i][j] / scale);
                moved += (next - X[i][j]) * (next - X[i][j]);
                X[i][j] = next;
            }
        }
        if (moved <= 1e-22 * size) {
            break;
        }
    }
    for (int i = 0; i < STATES; ++i) { /* whether X X = 1 */
        for (int j = 0; j < STATES; ++j) {
            real sum = i == j ? -1.0 : 0.0, size = 1.0;
            for (int k = 0; k < STATES; ++k) {
                sum += X[i][k] * X[k][j];
                size += fabs_1(X[i][k] * X[k][j]);
            }
            if (!(fabs_1(sum) <= sign_tolerance * size)) {
                return 0;
            }
        }
    }
    return 1;
}

/*
 * The first `rank` rows of P become a basis of all of them, by elimination with complete pivoting.
 */
static inline void row_basis(square P, int rank)
{
    for (int k = 0; k < rank; ++k) {
        int row = k, column = 0;
        real pivot;
        for (int i = k; i < STATES; ++i) {
            for (int j = 0; j < STATES; ++j) {
                if (fabs_1(P[i][j]) > fabs_1(P[row][column])) {
                    row = i;
                    column = j;
                }
            }
        }
        pivot = 1.0 / P[row][column];
        for (int j = 0; j < STATES; ++j) {
            const real t = P[row][j] * pivot;
            P[row][j] = P[k][j];
            P[k][j] = t;
        }
        for (int i = 0; i < STATES; ++i) {
            const real f = P[i][column];
            for (int j = 0; j < STATES && i != k; ++j) {
                P[i][j] -= f * P[k][j];
            }
        }
    }
}

/*
 * Rows of the scaled state that vanish on the unstable motions (grows = 1) or on the stable ones
 * (0), `count` of them, and the number of unstable zeros.
 */
static inline int boundary_rows(
    const zero_dynamics *given, int grows, square rows, int *count, int *unstable)
{
    square inverse; /* of A in its first rows */
    real unit[NE], size_A = 0.0, size_K = 0.0, rate, trace = 0.0;
    for (int i = 0; i < NE; ++i) {
        if (!(given->inertia[i] > 0.0)) {
            return MODEL_RESULT_NOT_FINITE;
        }
        unit[i] = 1.0 / square_root(given->inertia[i]);
    }
    for (int i = 0; i < NE; ++i) {
        for (int j = 0; j < NE; ++j) {
            const real K = unit[i] * given->K[i][j] * unit[j];
            inverse[i][j] = unit[i] * given->A[i][j] * unit[j];
            size_A += inverse[i][j] * inverse[i][j];
            size_K += K * K;
        }
    }
    if (!invert_square(inverse, NE, least_inertia)) {
        return MODEL_ZERO_AT_INFINITY;
    }
    rate = square_root(square_root(size_K / size_A));
    if (!(rate > 0.0 && rate < 1e100)) {
        return MODEL_ZERO_ON_AXIS;
    }
    for (int i = 0; i < NE; ++i) {
        for (int j = 0; j < NE; ++j) {
            real K = 0.0, D = 0.0;
            for (int k = 0; k < NE; ++k) {
                K -= inverse[i][k] * unit[k] * given->K[k][j] * unit[j];
                D -= inverse[i][k] * unit[k] * given->D[k][j] * unit[j];
            }
            rows[i][j] = 0.0;
            rows[i][NE + j] = i == j ? 1.0 : 0.0;
            rows[NE + i][j] = K / (rate * rate);
            rows[NE + i][NE + j] = D / rate;
        }
    }
    if (!matrix_sign(rows)) {
        return MODEL_ZERO_ON_AXIS;
    }
    for (int i = 0; i < STATES; ++i) {
        trace += rows[i][i];
    }
    *unstable = (int)(0.5 * (STATES + trace) + 0.5);
    *count = grows ? STATES - *unstable : *unstable;
    for (int i = 0; i < STATES; ++i) {
        for (int j = 0; j < STATES; ++j) {
            rows[i][j] = 0.5 * ((i == j ? 1.0 : 0.0) + (grows ? -rows[i][j] : rows[i][j]));
        }
    }
    row_basis(rows, *count);
    for (int i = 0; i < *count; ++i) {
        real most = 0.0;
        for (int j = 0; j < NE; ++j) {
            rows[i][j] *= scale_q / unit[j];
            rows[i][NE + j] *= scale_v / (unit[j] * rate);
        }
        most = largest(rows[i], STATES);
        for (int j = 0; j < STATES; ++j) {
            rows[i][j] /= most;
        }
    }
    return MODEL_OK;
}

/* The pencil of the arm at the equilibrium q with the output at its target. */
static inline int zero_dynamics_at(
    const real *target, const real *q, problem_points *arm, real *space, zero_dynamics *to)
{
    int status;
    real reference[REFERENCE];
    for (int i = 0; i < REFERENCE; ++i) {
        reference[i] = i < NT ? target[i] : 0.0;
    }
#if MODEL_FORCE
    copy(FORCE_OF(space), NY, reference + NT + 2 * NY);
#endif /* MODEL_FORCE */
    for (int l = 0; l < POINTS; ++l) {
        load_reference(arm, l, reference);
        for (int i = 0; i < NA; ++i) {
            arm->q[i][l] = q[i];
            arm->v[i][l] = 0.0;
            arm->a[i][l] = 0.0;
        }
    }
    begin_points(arm);
    status = solve_kinematics(arm, space);
    if (status == MODEL_OK) {
        status = reduced_jacobians(arm, space);
    }
    for (int i = 0; i < NE && status == MODEL_OK; ++i) {
        for (int j = 0; j < NE; ++j) {
            to->A[i][j] = arm->A[j][i][0];
            to->D[i][j] = arm->D[j][i][0];
            to->K[i][j] = arm->K[j][i][0];
        }
        to->inertia[i] = arm->row_a[i_e[i]][i][0];
    }
    return status;
}

#endif

/* --- The function bvp. */

/* of the tolerance: Newton's method gets there in one more step */
static const real newton_target = 1e-6;

/* Where the arrays of this solver are, after those of both. */
typedef struct {
    int64_t problem, blocks, end;
} bvp_layout;

static bvp_layout lay_out_bvp(const whole_layout *l)
{
    bvp_layout own;
    int64_t at = l->end;
    TAKE(at, own.problem, (int64_t)((sizeof(bvp_problem) + sizeof(real) - 1) / sizeof(real)));
    TAKE(at, own.blocks, (int64_t)(sizeof(bvp_space) / sizeof(real)));
    own.end = at;
    return own;
}

int64_t model_bvp_work(int n, const model_inversion_options *options)
{
    whole_layout l;
    int64_t end;
    if (options == NULL || !path_sizes_fit(n, options)) {
        return -1;
    }
    l = lay_out(n, options, INTERVAL_FACTOR, 0);
    end = lay_out_bvp(&l).end;
    return is_addressable(end) ? end : -1;
}

/*
 * The boundary rows at both ends, from the equilibrium q; the numbers of unstable zeros go to
 * `info`.
 */
static int set_boundary_rows(bvp_problem *b, const model_samples *p, const real *q, bvp_space *w,
    model_bvp_info *info, real *space)
{
    const real *target = p->y + (p->n - 1) * (ptrdiff_t)NT;
    const real *q_g = b->m.q_g + ((ptrdiff_t)b->m.N * STAGES - 1) * NG;
    real end[NA], scale[NE];
    zero_dynamics at;
    int unstable, status;
    status = zero_dynamics_at(p->y, q, &w->lq.arm, space, &at);
    if (status == MODEL_OK) {
        status = boundary_rows(&at, 1, b->first, &b->from_start, &unstable);
    }
    if (status != MODEL_OK) {
        return status;
    }
    info->unstable_zeros_start = unstable;
    copy(q, NA, end);
    for (int i = 0; i < NG; ++i) {
        end[i_g[i]] = q_g[i];
    }
#if MODEL_FORCE
    keep_force(p, p->n - 1, space);
#endif /* MODEL_FORCE */
    status = equilibrium_at(target, end, scale, space);
    if (status == MODEL_OK) {
        status = zero_dynamics_at(target, end, &w->lq.arm, space, &at);
    }
    if (status == MODEL_OK) {
        status = boundary_rows(&at, 0, b->last, &b->from_end, &unstable);
    }
    if (status != MODEL_OK) {
        return status;
    }
    info->unstable_zeros_end = unstable;
    for (int i = 0; i < NE; ++i) {
        b->equilibrium_start[i] = q[i_e[i]];
        b->equilibrium_end[i] = end[i_e[i]];
        b->equilibrium_start[NE + i] = b->equilibrium_end[NE + i] = 0.0;
    }
    return b->from_start + b->from_end == STATES ? MODEL_OK : MODEL_ZEROS_CHANGE;
}

/* The motion on the mesh by Newton steps. */
static int solve_bvp(
    bvp_problem *b, real tolerance, whole_report *report, bvp_space *w, real *space)
{
    newton progress = {-1.0, 0, 0};
    for (;;) {
        int state, status = bvp_factor(b, w, space);
        if (status == MODEL_OK) {
            back_substitute(b, w);
            status = bvp_residual(b, w, space);
            report->residual = b->m.residual;
            report->iterations = progress.steps + 1;
        }
        if (status != MODEL_OK) {
            return b->turns && status == MODEL_NOT_CONVERGED ? (int)MODEL_ZERO_AT_INFINITY :
                                                               status;
        }
        state = newton_state(&progress, b->m.residual, tolerance, newton_target);
        if (state != NEWTON_CONTINUES) {
            if (b->turns) {
                return MODEL_ZERO_AT_INFINITY;
            }
            return state == NEWTON_CONVERGED ? MODEL_OK : MODEL_NOT_CONVERGED;
        }
    }
}

/* As model_bvp, with a report; `info` takes the numbers of unstable zeros. */
static model_status solve_path(const model_samples *p,
    PARAMETERS_ARGUMENT const real q_start[MODEL_NA], const model_inversion_options *options,
    model_motion *motion, model_bvp_info *info, whole_report *report, real *work,
    int64_t work_size)
{
    const int64_t wanted = p == NULL ? -1 : model_bvp_work(p->n, options);
    whole_layout l;
    bvp_layout own;
    bvp_problem *b;
    bvp_space *w;
    real q[NA];
    int status = check_arguments(
        p, GIVEN_PARAMETERS, q_start, options, motion, report, work, work_size, wanted);
    if (status == MODEL_OK && options->settled > 0.0) {
        status = MODEL_BAD_ARGUMENT;
    }
    if (status != MODEL_OK) {
        return (model_status)status;
    }
    copy(q_start, NA, q);
    l = lay_out(p->n, options, INTERVAL_FACTOR, 0);
    own = lay_out_bvp(&l);
    keep_parameters(GIVEN_PARAMETERS, work + l.space);
    b = (bvp_problem *)(void *)(work + own.problem);
    w = (bvp_space *)(void *)(work + own.blocks);
    b->m = mesh_in(&l, p, options, work);
    report->intervals = b->m.N;
#if MODEL_FORCE
    keep_force(p, 0, work + l.space);
#endif /* MODEL_FORCE */
    status = equilibrium_at(p->y, q, b->m.scale, work + l.space);
    if (status == MODEL_OK) {
#if MODEL_FORCE
        status = guess_mesh(&b->m, p, q, options->n_pre, options->samples_per_interval, &w->lq.arm,
            NULL, work + l.space);
#else  /* MODEL_FORCE */
        status = guess_mesh(&b->m, p, q, options->n_pre, options->samples_per_interval, &w->lq.arm,
            work + l.space);
#endif /* MODEL_FORCE */
    }
    if (status == MODEL_OK) {
        status = set_boundary_rows(b, p, q, w, info, work + l.space);
    }
    if (status == MODEL_OK) {
        status = solve_bvp(b, options->tolerance, report, w, work + l.space);
    }
    if (status != MODEL_OK) {
        return (model_status)status;
    }
    return finish(
        p, options, &l, q, &b->m, q, (ptrdiff_t)l.samples, &w->lq.arm, motion, report, work);
}

model_status model_bvp(const model_samples *samples,
    PARAMETERS_ARGUMENT const real q_start[MODEL_NA], const model_inversion_options *options,
    model_motion *motion, model_bvp_info *info, real *work, int64_t work_size)
{
    whole_report report = {0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0};
    model_bvp_info zeros;
    model_status status = MODEL_NULL_ARGUMENT;
    zeros.unstable_zeros_start = zeros.unstable_zeros_end = 0;
    if (info != NULL) {
        status = solve_path(
            samples, PASSED_PARAMETERS q_start, options, motion, &zeros, &report, work, work_size);
    }
    if (report.is_set) {
        info->residual = report.residual;
        info->residual_at_samples = report.residual_at_samples;
        info->kinematic_mismatch = report.kinematic_mismatch;
        info->iterations = report.iterations;
        info->intervals = report.intervals;
        info->unstable_zeros_start = zeros.unstable_zeros_start;
        info->unstable_zeros_end = zeros.unstable_zeros_end;
    }
    return status;
}
