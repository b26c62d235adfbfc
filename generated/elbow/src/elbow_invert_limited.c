/*
 * elbow: inverse dynamics along a whole path within limits. Written by flexgen; see
 * elbow_inversion.h.
 */
#include "../elbow_inversion.h"

#include "elbow_limits.h"
#include "elbow_path.h"
#include "elbow_whole_path.h"

/*
 * --- Deviations from a path as splines of degree seven in time.
 *
 * d = sum c_i B_i with knots `spacing` samples apart, the first one at the first sample. Spline i
 * is not zero in the knot intervals i to i + 7, so that a deviation and six derivatives are zero
 * at both ends of the path.
 *
 * Source: C. de Boor, A Practical Guide to Splines, 2001, ch. IX.
 */

enum { DEGREE = 7, SPLINES = DEGREE + 1 };

/* The splines of a degree that are not zero in a knot interval, at its part u. */
static inline void splines_of_degree(int degree, real u, real out[SPLINES])
{
    for (int j = 0; j < SPLINES; ++j) {
        out[j] = j == 0 ? 1.0 : 0.0;
    }
    for (int p = 1; p <= degree; ++p) {
        for (int j = p; j >= 0; --j) {
            const real left = j > 0 ? out[j - 1] : 0.0, right = j < p ? out[j] : 0.0;
            out[j] = ((u + (real)(p - j)) * left + ((real)(j + 1) - u) * right) / (real)p;
        }
    }
}

/*
 * Derivative of an order of all splines that are not zero there, per knot interval; the last is
 * the newest.
 */
static inline void spline_derivatives(int order, real u, real out[SPLINES])
{
    splines_of_degree(DEGREE - order, u, out);
    for (int k = 0; k < order; ++k) { /* B' = B_i - B_(i+1) of the degree below */
        for (int j = DEGREE - order + k + 1; j >= 0; --j) {
            const real left = j > 0 ? out[j - 1] : 0.0,
                       right = j <= DEGREE - order + k ? out[j] : 0.0;
            out[j] = left - right;
        }
    }
}

/* Number of splines of a path of n samples. */
static inline int spline_count(int n, int spacing)
{
    return (n - 1) / spacing - DEGREE;
}

/* Deviation at a sample: value, first and second derivative [1/s^k], NY each. */
static inline void deviation_at(
    const real *c, int count, int spacing, real period, int sample, real out[3 * NY])
{
    const int interval = sample / spacing;
    const real u = (real)(sample - interval * spacing) / (real)spacing, h = (real)spacing * period;
    real scale = 1.0;
    for (int order = 0; order < 3; ++order) {
        real b[SPLINES];
        spline_derivatives(order, u, b);
        for (int i = 0; i < NY; ++i) {
            real sum = 0.0;
            for (int j = 0; j < SPLINES; ++j) {
                const int spline = interval - DEGREE + j;
                if (spline >= 0 && spline < count) {
                    sum += c[spline * NY + i] * b[j];
                }
            }
            out[order * NY + i] = sum / scale;
        }
        scale *= h;
    }
}

/*
 * --- A quadratic program with limits that may be exceeded at a price, by an interior point
 * method.
 *
 *     min  z' H z / 2 + g' z + price * s    s.t.  x_r + A_r z <= 1 + s,    s >= 0
 *
 * There is always a solution, and s is zero where all limits can be kept and the price exceeds the
 * multipliers.
 *
 * Source: S. Mehrotra, SIAM Journal on Optimization 2(4), 1992; J. Nocedal, S. Wright, Numerical
 * Optimization, 2006, ch. 16.6.
 */

enum { IP_STEPS = 80 };

static const real ip_accuracy = 1e-9;   /* of the limits */
static const real ip_gap = 1e-17;       /* of the price: complementarity at the solution */
static const real ip_gap_enough = 1e-9; /* the same, where the steps have no effect any more */
static const real ip_boundary = 0.9995; /* part of the step to the boundary */

/*
 * The program and its memory; all arrays belong to the caller. `stride`: n + 1, rounded up to
 * whole vectors. A row has the numbers of A, then -1 for s, then zeros; the last row is that of s
 * >= 0. Only its columns from `first` are not zero, of the columns before n.
 */
typedef struct {
    int n, rows, stride; /* rows without that of s */
    const real *H;       /* n x n, positive definite */
    const real *g;       /* n */
    const real *A;       /* (rows + 1) x stride */
    const real *x;       /* rows */
    /* 2 for each row: first column that is not zero, and the column after the last one */
    const int *range;
    real price;
    real *z;                                                 /* stride: the solution, then s */
    real *K;                                                 /* stride x stride */
    real *step;                                              /* stride */
    real *dual, *slack, *d_dual, *d_slack, *primal, *scaled; /* rows + 1 each */
} interior_point;

/* A_r z - s of row r; -s of the last one. */
static inline real ip_row(const interior_point *p, int r, const real *z)
{
    const real *a = p->A + (ptrdiff_t)r * p->stride;
    real sum = -z[p->n];
    for (int i = p->range[2 * r]; i < p->range[2 * r + 1]; ++i) {
        sum += a[i] * z[i];
    }
    return sum;
}

/*
 * Sum of products from a column to another one; BLOCK partial sums, so that the bits are those of
 * any vector width.
 */
static inline real ip_dot(const real *a, const real *b, int from, int to)
{
    lanes sums[BLOCK / LANES];
    real parts[BLOCK], sum = 0.0;
    int j = from;
    for (int k = 0; k < BLOCK / LANES; ++k) {
        sums[k] = splat_v(0.0);
    }
    for (; j + BLOCK <= to; j += BLOCK) {
        for (int k = 0; k < BLOCK / LANES; ++k) {
            sums[k] += load_v(a + j + k * LANES) * load_v(b + j + k * LANES);
        }
    }
    for (int k = 0; k < BLOCK / LANES; ++k) {
        store_v(parts + k * LANES, sums[k]);
    }
    for (; j < to; ++j) {
        sum += a[j] * b[j];
    }
    for (int k = 0; k < BLOCK; ++k) {
        sum += parts[k];
    }
    return sum;
}

/*
 * K = L L' in the lower triangle, as factor_qp; entries before the first one of a row that is not
 * zero stay zero. 0 where a pivot is not positive.
 */
static inline int ip_cholesky(real *K, int n, int stride)
{
    for (int i = 0; i < n; ++i) {
        real *row = K + (ptrdiff_t)i * stride;
        int first = 0;
        while (first < i && !(fabs_1(row[first]) > 0.0)) {
            ++first;
        }
        for (int k = first; k < i; ++k) {
            const real *top = K + (ptrdiff_t)k * stride;
            row[k] = (row[k] - ip_dot(row, top, first, k)) * top[k];
        }
        row[i] -= ip_dot(row, row, first, i);
        if (!(row[i] > 0.0)) {
            return 0;
        }
        row[i] = 1.0 / square_root(row[i]);
    }
    return 1;
}

/*
 * K = H + G' diag(dual / slack) G, factored; 0 where a pivot is not positive. The lower triangle
 * is filled.
 */
static inline int ip_factor(interior_point *p)
{
    const int n = p->n, stride = p->stride;
    for (int i = 0; i <= n; ++i) {
        for (int j = 0; j < stride; ++j) {
            p->K[(ptrdiff_t)i * stride + j] = i < n && j < n ? p->H[(ptrdiff_t)i * n + j] : 0.0;
        }
    }
    for (int r = 0; r <= p->rows; ++r) {
        const real weight = p->dual[r] / p->slack[r];
        const real *a = p->A + (ptrdiff_t)r * stride;
        const int from = p->range[2 * r] / LANES * LANES, to = p->range[2 * r + 1];
        real *last = p->K + (ptrdiff_t)n * stride;
        for (int i = from; i < to; ++i) {
            const lanes scaled = splat_v(weight * a[i]);
            real *row = p->K + (ptrdiff_t)i * stride;
            /* a spline acts on a part of the motion only */
            for (int j = from; j <= i; j += LANES) {
                store_v(row + j, load_v(row + j) + scaled * load_v(a + j));
            }
            last[i] -= weight * a[i];
        }
        last[n] += weight;
    }
    return ip_cholesky(p->K, n + 1, stride);
}

/*
 * The Newton step to complementarity `scaled`: K dz = -(H z + g + G' dual) - G' ((dual primal -
 * scaled) / slack).
 */
static inline void ip_step(interior_point *p)
{
    const int n = p->n;
    for (int i = 0; i < n; ++i) {
        real sum = -p->g[i];
        for (int j = 0; j < n; ++j) {
            sum -= p->H[(ptrdiff_t)i * n + j] * p->z[j];
        }
        p->step[i] = sum;
    }
    p->step[n] = -p->price;
    for (int r = 0; r <= p->rows; ++r) {
        const real pull = p->dual[r] + (p->dual[r] * p->primal[r] - p->scaled[r]) / p->slack[r];
        const real *a = p->A + (ptrdiff_t)r * p->stride;
        for (int i = p->range[2 * r]; i < p->range[2 * r + 1]; ++i) {
            p->step[i] -= pull * a[i];
        }
        p->step[n] += pull;
    }
    solve_qp(p->K, n + 1, p->stride, p->step);
    for (int r = 0; r <= p->rows; ++r) {
        p->d_slack[r] = -p->primal[r] - ip_row(p, r, p->step);
        p->d_dual[r] = (-p->scaled[r] - p->dual[r] * p->d_slack[r]) / p->slack[r];
    }
}

/* The longest step, at most one, that keeps slacks and multipliers positive. */
static inline real ip_longest(const interior_point *p)
{
    real most = 1.0;
    for (int r = 0; r <= p->rows; ++r) {
        if (p->slack[r] + most * p->d_slack[r] < 0.0) {
            most = -p->slack[r] / p->d_slack[r];
        }
        if (p->dual[r] + most * p->d_dual[r] < 0.0) {
            most = -p->dual[r] / p->d_dual[r];
        }
    }
    return most;
}

/* Solve; 0 where it does not converge. */
static inline int solve_interior_point(interior_point *p)
{
    const int n = p->n, rows = p->rows + 1;
    int good = 0;
    for (int i = 0; i <= n; ++i) {
        p->z[i] = 0.0;
    }
    for (int r = 0; r < p->rows; ++r) {
        p->z[n] = fmax_1(p->z[n], p->x[r] - 1.0);
    }
    p->z[n] += 1.0;
    for (int r = 0; r < rows; ++r) {
        p->slack[r] = 1.0;
        p->dual[r] = p->price / (real)rows;
    }
    for (int step = 0; step < IP_STEPS; ++step) {
        real gap = 0.0, least, affine = 0.0, off = 0.0, length;
        for (int r = 0; r < rows; ++r) {
            const real room = r < p->rows ? 1.0 - p->x[r] : 0.0;
            p->primal[r] = ip_row(p, r, p->z) + p->slack[r] - room;
            gap += p->dual[r] * p->slack[r];
            off = fmax_1(off, fabs_1(p->primal[r]));
        }
        gap /= (real)rows;
        good = gap * (real)rows <= ip_gap_enough * p->price && off <= ip_accuracy &&
               is_finite(p->z, n + 1);
        if (good && gap * (real)rows <= ip_gap * p->price) {
            return 1;
        }
        if (!ip_factor(p)) {
            return good;
        }
        for (int r = 0; r < rows; ++r) {
            p->scaled[r] = p->dual[r] * p->slack[r];
        }
        ip_step(p); /* the affine step shows how far the gap can be closed */
        length = ip_longest(p);
        for (int r = 0; r < rows; ++r) {
            affine += (p->dual[r] + length * p->d_dual[r]) *
                      (p->slack[r] + length * p->d_slack[r]);
        }
        affine /= (real)rows;
        least = affine / gap;
        least = least * least * least * gap;
        for (int r = 0; r < rows; ++r) {
            p->scaled[r] = p->dual[r] * p->slack[r] + p->d_dual[r] * p->d_slack[r] - least;
        }
        ip_step(p);
        length = ip_boundary * ip_longest(p);
        length = length > 1.0 ? 1.0 : length;
        for (int i = 0; i <= n; ++i) {
            p->z[i] += length * p->step[i];
        }
        for (int r = 0; r < rows; ++r) {
            p->slack[r] += length * p->d_slack[r];
            p->dual[r] += length * p->d_dual[r];
        }
    }
    return good;
}

/* --- The function invert_limited. */

enum {
    /*
     * The limited quantities: motor torques and speeds, deflections; torques of gears, rates of
     * motor torques, speeds and accelerations of joints, speed and acceleration of the tool; then
     * both signs of each edge of the torque-speed curves, of each motor in turn.
     */
    OF_DEFLECTION = 2 * NM,
    OF_GEAR = OF_DEFLECTION + NE,
    OF_RATE = OF_GEAR + NG,
    OF_JOINT = OF_RATE + NM,
    OF_TOOL = OF_JOINT + 2 * NG,
    OF_CURVE = OF_TOOL + 2,
    POINTS_MAX = 100, /* of a torque-speed curve */
    /* intervals between knots over the path, where the caller does not choose */
    PATH_KNOTS = 30,
    NODES_PER_KNOT = 8,  /* instants at which the program sees the motion */
    LIMITED_ROUNDS = 20, /* programs, each followed by an inversion */
    FRICTION_ROUNDS = 6, /* programs until the friction agrees with the speeds after the step */
    /* of the samples before and after the path, in which a response matters */
    RESPONSE_PART = 3,
    ROW_ROUNDS = 5, /* programs until no other row is exceeded */
    MORE_ROWS = 6   /* rows of a program, for each unknown */
};

static const real limit_slack = 1e-3;  /* of a limit: largest violation of a result */
static const real least_margin = 2e-4; /* of a limit: distance that the programs keep from it */
/* more distance after a program whose linearization was not exact, at most */
static const real margin_max = 4e-3;
/* tolerance of the inversions inside, relative: responses need few digits */
static const real rough_tolerance = 100.0;
/* m, rad: of the coefficients; a deviation of it costs about one */
static const real coefficient_unit = 1e-3;
/* cost of the curvature of the shortest wave that the knots resolve */
static const real curvature_weight = 100.0;
static const real program_price = 1e9; /* of exceeding all limits by 100 % */
/* of a limit: rows below it are not in the program at first */
static const real near_limit = 0.7;
/* of a violation: where more is left, the responses are computed again */
static const real poor_progress = 0.7;
/* of a violation: where more is left with new responses, it ends */
static const real hopeless_progress = 0.9;
/* rad/s: of a speed, over which the friction is linearized */
static const real least_change = 1e-3;
static const real least_share = 0.2; /* of a step */
/* of the deviation: a program that changes it by less has converged */
static const real settled_share = 1e-2;
/* m/s^2, rad/s^2: acceleration of a deviation whose response is computed */
static const real push_size = 1.0;

/* Sizes and arrays of a call; the arrays are in the workspace. */
typedef struct {
    int n, samples, spacing, count, unknowns, stride, nodes, kinds, rows_max, width;
    int all, edges; /* quantities, and edges of a torque-speed curve */
    int has_motion; /* whether the motion of gears and joints is needed */
    real period;    /* s */
    real room;      /* of a limit: distance that the program keeps from it */
    real *kind;     /* the numbers of the limited quantities */
    real *limit;    /* of all quantities */
    /* NM x edges: torque that a speed takes from the edge of a curve [N m s/rad] */
    real *load;
    real *values; /* of all quantities at one sample */
    real *y, *dy, *ddy;
    real *q_a, *v_m, *tau_m; /* of an inversion, at all samples */
    real *v_a, *a_a, *tau_g;
    /* nodes x all: the quantities, motor torques without friction */
    real *at_node, *trial;
    /* nodes x all: relative to the limits, the largest of the samples around a node */
    real *extreme;
    real *shown;                   /* nodes x all: the same, as the linear program sees it */
    real *response;                /* nodes x kinds x unknowns */
    real *secants;                 /* nodes x NM: of the friction, in the memory of `trial` */
    real *c, *step, *best, *tried; /* unknowns */
    real *cost, *H, *g;
    real *A, *x, *K, *z, *range, *of_rows; /* of the interior point method */
    real *used;                            /* nodes x kinds x 2: rows of the program */
    real *inner;                           /* workspace of invert */
    int64_t inner_size, end;
} limited_call;

/* The motor whose torque is in a quantity; -1: none. */
static inline int motor_of_torque(const limited_call *m, int kind)
{
    return kind < NM ? kind : kind >= OF_CURVE ? (kind - OF_CURVE) / (2 * m->edges) : -1;
}

/* The limit of a quantity; infinite where there is none. */
static inline real limit_of(const elbow_inversion_limits *limits, int kind, int edges)
{
    const real none = (real)INFINITY;
    if (kind < NM) {
        return limits->torque_max == NULL ? none : limits->torque_max[kind];
    }
    if (kind < OF_DEFLECTION) {
        const int i = kind - NM, count = limits->torque_speed_points;
        const real most = limits->speed_max == NULL ? none : limits->speed_max[i];
        return limits->torque_speed == NULL ?
                   most :
                   fmin_1(most, limits->torque_speed[((ptrdiff_t)i * count + count - 1) *
                                                     2]); /* the end of the curve */
    }
    if (kind < OF_GEAR) {
        return limits->deflection_max == NULL ? none :
                                                limits->deflection_max[kind - OF_DEFLECTION];
    }
    if (kind < OF_RATE) {
        return limits->gear_torque_max == NULL ? none : limits->gear_torque_max[kind - OF_GEAR];
    }
    if (kind < OF_JOINT) {
        return limits->torque_rate_max == NULL ? none : limits->torque_rate_max[kind - OF_RATE];
    }
    if (kind < OF_TOOL) {
        const int i = kind - OF_JOINT;
        const real *of = i < NG ? limits->joint_speed_max : limits->joint_acceleration_max;
        return of == NULL ? none : of[i % NG];
    }
    if (kind < OF_CURVE) {
        const real most = kind == OF_TOOL ? limits->tool_speed_max : limits->tool_acceleration_max;
        return most > 0.0 ? most : none;
    }
    {
        const int i = (kind - OF_CURVE) / 2;
        real load;
        return edge_of_curve(limits, i / edges, i % edges, &load);
    }
}

/*
 * The quantities whose responses are needed: those with a limit, and the speeds of motors with a
 * limit of the torque, for the friction. Their number is m->kinds; they are not written where
 * there is no memory yet.
 */
static void choose_kinds(const elbow_inversion_limits *limits, limited_call *m)
{
    m->kinds = m->has_motion = 0;
    for (int i = 0; i < m->all; ++i) {
        int is_needed = limit_of(limits, i, m->edges) < (real)INFINITY;
        m->has_motion |= is_needed && i >= OF_GEAR && i < OF_TOOL;
        for (int k = 0; i >= NM && i < OF_DEFLECTION && k < m->all; ++k) {
            is_needed |= motor_of_torque(m, k) == i - NM &&
                         limit_of(limits, k, m->edges) < (real)INFINITY;
        }
        if (m->kind != NULL) {
            m->limit[i] = limit_of(limits, i, m->edges);
        }
        if (m->kind != NULL && is_needed) {
            m->kind[m->kinds] = (real)i;
        }
        m->kinds += is_needed;
    }
    for (int i = 0; i < NM * m->edges && m->kind != NULL; ++i) {
        (void)edge_of_curve(limits, i / m->edges, i % m->edges, m->load + i);
    }
}

/* Number k of the limited quantities. */
static inline int kind_at(const limited_call *m, int k)
{
    return (int)m->kind[k];
}

/*
 * The sizes of a call and the positions of its arrays in `work`, if it is not null; 0 where a size
 * is out of range.
 */
static int lay_out_limited(int n, const elbow_inversion_options *o,
    const elbow_inversion_limits *limits, real *work, limited_call *m)
{
    const int64_t inner = elbow_invert_work(n, o);
    int64_t at = 0, unknowns;
    const int on_curve = limits->torque_speed == NULL ? 2 : limits->torque_speed_points;
    if (inner < 0 || limits->knot_samples < 0 || on_curve < 2 || on_curve > POINTS_MAX) {
        return 0;
    }
    m->n = n;
    m->samples = o->n_pre + n + o->n_post;
    m->spacing = limits->knot_samples;
    if (m->spacing == 0) {
        const int least = 2 * o->samples_per_interval;
        m->spacing = (n - 1) / PATH_KNOTS > least ? (n - 1) / PATH_KNOTS : least;
    }
    m->count = spline_count(n, m->spacing);
    if (m->count < 1) {
        return 0;
    }
    m->unknowns = m->count * NY;
    unknowns = m->unknowns;
    m->stride = m->spacing / NODES_PER_KNOT > 1 ? m->spacing / NODES_PER_KNOT : 1;
    m->nodes = (m->samples - 1) / m->stride + 1;
    m->edges = limits->torque_speed == NULL ? 0 : limits->torque_speed_points - 1;
    m->all = OF_CURVE + 2 * NM * m->edges;
    m->kind = NULL;
    choose_kinds(limits, m);
    m->rows_max = MORE_ROWS * m->unknowns + 64;
    m->width = (int)padded(unknowns + 1);
#define PLACE(name, size) \
    m->name = work == NULL ? NULL : work + at; \
    at += padded(size)
    PLACE(kind, m->all);
    PLACE(limit, m->all);
    PLACE(values, m->all);
    PLACE(load, (int64_t)NM * m->edges);
    PLACE(y, (int64_t)n * NT);
    PLACE(dy, (int64_t)n * NY);
    PLACE(ddy, (int64_t)n * NY);
    PLACE(q_a, (int64_t)m->samples * NA);
    PLACE(v_m, (int64_t)m->samples * NM);
    PLACE(tau_m, (int64_t)m->samples * NM);
    PLACE(v_a, m->has_motion ? (int64_t)m->samples * NA : 0);
    PLACE(a_a, m->has_motion ? (int64_t)m->samples * NA : 0);
    PLACE(tau_g, m->has_motion ? (int64_t)m->samples * NG : 0);
    PLACE(at_node, (int64_t)m->nodes * m->all);
    PLACE(trial, (int64_t)m->nodes * m->all);
    PLACE(extreme, (int64_t)m->nodes * m->all);
    PLACE(shown, (int64_t)m->nodes * m->all);
    PLACE(response, m->nodes * m->kinds * unknowns);
    PLACE(c, unknowns);
    PLACE(step, unknowns);
    PLACE(best, unknowns);
    PLACE(tried, unknowns);
    PLACE(cost, (int64_t)m->count * m->count);
    PLACE(H, unknowns * unknowns);
    PLACE(g, unknowns);
    PLACE(A, ((int64_t)m->rows_max + 1) * m->width);
    PLACE(x, (int64_t)m->rows_max);
    PLACE(K, (int64_t)m->width * m->width);
    PLACE(z, 2 * (int64_t)m->width);
    PLACE(range, 2 * ((int64_t)m->rows_max + 1)); /* of integers */
    PLACE(of_rows, 6 * ((int64_t)m->rows_max + 1));
    PLACE(used, (int64_t)m->nodes * m->all * 2);
#undef PLACE
    if (work != NULL) {
        choose_kinds(limits, m);
    }
    m->secants = m->trial;
    m->inner = work == NULL ? NULL : work + at;
    m->inner_size = inner;
    m->end = at + inner;
    return unknowns <= 4000 && is_addressable(m->end);
}

int64_t elbow_invert_limited_work(
    int n, const elbow_inversion_options *options, const elbow_inversion_limits *limits)
{
    limited_call m;
    return options != NULL && limits != NULL && n >= 2 &&
                   lay_out_limited(n, options, limits, NULL, &m) ?
               m.end :
               -1;
}

/* The path with the deviation of the coefficients. */
static void deviate(const limited_call *m, const elbow_samples *p, const real *c)
{
    for (int k = 0; k < m->n; ++k) {
        real plan[REFERENCE], d[3 * NY], out[REFERENCE];
        copy(p->y + k * (ptrdiff_t)NT, NT, plan);
        copy(p->dy + k * (ptrdiff_t)NY, NY, plan + NT);
        copy(p->ddy + k * (ptrdiff_t)NY, NY, plan + NT + NY);
        deviation_at(c, m->count, m->spacing, p->period, k, d);
        add_deviation(plan, d, 1.0, out);
        copy(out, NT, m->y + k * (ptrdiff_t)NT);
        copy(out + NT, NY, m->dy + k * (ptrdiff_t)NY);
        copy(out + NT + NY, NY, m->ddy + k * (ptrdiff_t)NY);
    }
}

/*
 * The quantities at one sample: motor torques with or without friction, but for their rates, which
 * always have it.
 */
static int quantities(
    const limited_call *m, int sample, int n_pre, int with_friction, real *out, real *space)
{
    const ptrdiff_t later = sample + 1 < m->samples ? sample + 1 : sample;
    const real *v = m->v_m + sample * (ptrdiff_t)NM;
    const int on_path = sample - n_pre;
    real friction[NM];
    if (evaluate_motor_friction(v, friction, space) != ELBOW_OK) {
        return 0;
    }
    for (int i = 0; i < NM; ++i) {
        const real torque = m->tau_m[sample * (ptrdiff_t)NM + i];
        out[i] = torque - (with_friction ? 0.0 : friction[i]);
        out[NM + i] = v[i];
        out[OF_RATE + i] = (m->tau_m[later * NM + i] - torque) / m->period;
        for (int edge = 0; edge < m->edges; ++edge) {
            real *both = out + OF_CURVE + 2 * (i * m->edges + edge);
            const real load = m->load[i * m->edges + edge] * v[i];
            both[0] = out[i] + load;
            both[1] = out[i] - load;
        }
    }
    for (int i = 0; i < NE; ++i) {
        out[OF_DEFLECTION + i] = m->q_a[sample * (ptrdiff_t)NA + i_e[i]];
    }
    for (int i = 0; i < NG; ++i) {
        out[OF_GEAR + i] = m->has_motion ? m->tau_g[sample * (ptrdiff_t)NG + i] : 0.0;
        out[OF_JOINT + i] = m->has_motion ? m->v_a[sample * (ptrdiff_t)NA + i_g[i]] : 0.0;
        out[OF_JOINT + NG + i] = m->has_motion ? m->a_a[sample * (ptrdiff_t)NA + i_g[i]] : 0.0;
    }
    out[OF_TOOL] = out[OF_TOOL + 1] = 0.0;
    if (on_path >= 0 && on_path < m->n) {
        real speed[2], acceleration[2];
        size_of_deviation(m->dy + on_path * (ptrdiff_t)NY, speed);
        size_of_deviation(m->ddy + on_path * (ptrdiff_t)NY, acceleration);
        out[OF_TOOL] = speed[0];
        out[OF_TOOL + 1] = acceleration[0];
    }
    return 1;
}

/* What the inversions inside need of the caller's arguments. */
typedef struct {
    const elbow_samples *p;
    const real *parameters, *q_start;
    elbow_inversion_options options;
    elbow_invert_info *info;
} inner_call;

static elbow_status invert_deviated(const limited_call *m, const inner_call *call,
    const elbow_inversion_options *o, elbow_motion *motion)
{
    const elbow_samples deviated = {m->n, call->p->period, m->y, m->dy, m->ddy};
    return elbow_invert(&deviated, call->q_start, o, motion, call->info, m->inner, m->inner_size);
}

/*
 * Invert the path with the deviation c: quantities at the nodes, their largest values around the
 * nodes, and the largest of all. A result that is only not accurate between the nodes of the mesh
 * will do.
 */
static elbow_status follow_deviated(limited_call *m, const inner_call *call, const real *c,
    real *at_node, real *extreme, real *worst)
{
    elbow_motion motion = {m->q_a, NULL, NULL, NULL, NULL, m->v_m, m->tau_m};
    const int n_pre = call->options.n_pre;
    elbow_status status;
    if (m->has_motion) {
        motion.v_a = m->v_a;
        motion.a_a = m->a_a;
        motion.tau_g = m->tau_g;
    }
    deviate(m, call->p, c);
    status = invert_deviated(m, call, &call->options, &motion);
    if (status < 0) {
        return status;
    }
    *worst = 0.0;
    keep_parameters(call->parameters, m->inner);
    for (int node = 0; node < m->nodes; ++node) {
        const int first = node * m->stride - m->stride / 2;
        const int last = node == m->nodes - 1 ? m->samples - 1 : first + m->stride;
        if (!quantities(
                m, node * m->stride, n_pre, 0, at_node + (ptrdiff_t)node * m->all, m->inner)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        for (int sample = first < 0 ? 0 : first;
            extreme != NULL && sample <= last && sample < m->samples; ++sample) {
            const real *x = m->values;
            if (!quantities(m, sample, n_pre, 1, m->values, m->inner)) {
                return ELBOW_RESULT_NOT_FINITE;
            }
            for (int k = 0; k < m->kinds; ++k) {
                real *most = extreme + (ptrdiff_t)node * m->all + kind_at(m, k);
                const real value = x[kind_at(m, k)] / m->limit[kind_at(m, k)];
                if (sample <= 0 || sample == first || fabs_1(value) > fabs_1(*most)) {
                    *most = value;
                }
                *worst = fmax_1(*worst, fabs_1(value) - 1.0);
            }
        }
    }
    return ELBOW_OK;
}

/*
 * Responses of the quantities at the nodes to every coefficient, by differences of inversions.
 * Splines far from each other share an inversion: the response to one of them is taken to last for
 * a third of the samples before the path, which the caller chose for a motion that decays by many
 * digits, and a third of those after it.
 */
static elbow_status find_responses(limited_call *m, const inner_call *call, real period)
{
    const int ahead = call->options.n_pre / RESPONSE_PART,
              behind = call->options.n_post / RESPONSE_PART;
    const int wide = SPLINES * m->spacing + ahead + behind,
              apart = (wide + m->spacing - 1) / m->spacing;
    const real push = push_size * ((real)m->spacing * period) * ((real)m->spacing * period);
    for (int64_t i = 0; i < (int64_t)m->nodes * m->kinds * m->unknowns; ++i) {
        m->response[i] = 0.0;
    }
    for (int j = 0; j < NY; ++j) {
        for (int color = 0; color < apart && color < m->count; ++color) {
            real unused;
            elbow_status status;
            copy(m->c, m->unknowns, m->tried);
            for (int i = color; i < m->count; i += apart) {
                m->tried[i * NY + j] += push;
            }
            status = follow_deviated(m, call, m->tried, m->trial, NULL, &unused);
            if (status < 0) {
                return status;
            }
            for (int i = color; i < m->count; i += apart) {
                const int first = call->options.n_pre + i * m->spacing - ahead;
                const int last = call->options.n_pre + (i + SPLINES) * m->spacing + behind;
                for (int node = first / m->stride; node < m->nodes && node * m->stride <= last;
                    ++node) {
                    for (int k = 0; k < m->kinds; ++k) {
                        const ptrdiff_t at = (ptrdiff_t)node * m->all + kind_at(m, k);
                        real *response = m->response +
                                         ((ptrdiff_t)node * m->kinds + k) * m->unknowns + i * NY +
                                         j;
                        *response = (m->trial[at] - m->at_node[at]) / push;
                    }
                }
            }
        }
    }
    return ELBOW_OK;
}

/*
 * Cost of the deviation: mean square and mean square of the fourth derivative, scaled so that
 * `coefficient_unit` costs about one.
 */
static void set_cost(const limited_call *m)
{
    const real wave = 1.0 / (9.869604401089358 * 9.869604401089358); /* 1/pi^4 */
    for (int64_t i = 0; i < (int64_t)m->count * m->count; ++i) {
        m->cost[i] = 0.0;
    }
    for (int sample = 0; sample < m->n; ++sample) {
        const int interval = sample / m->spacing;
        const real u = (real)(sample - interval * m->spacing) / (real)m->spacing;
        real value[SPLINES], fourth[SPLINES];
        spline_derivatives(0, u, value);
        spline_derivatives(4, u, fourth);
        for (int i = 0; i < SPLINES; ++i) {
            for (int j = 0; j < SPLINES; ++j) {
                const int a = interval - DEGREE + i, b = interval - DEGREE + j;
                if (a >= 0 && a < m->count && b >= 0 && b < m->count) {
                    m->cost[(ptrdiff_t)a * m->count + b] += (value[i] * value[j] +
                                                                curvature_weight * wave * wave *
                                                                    fourth[i] * fourth[j]) *
                                                            (real)m->count / (real)m->n;
                }
            }
        }
    }
}

/*
 * Response of row (node, k) with friction: the torque's changes by the speed's times the secant of
 * the friction. /
 */
static void fill_response(
    const limited_call *m, int node, int k, const real *secants, real factor, real *out)
{
    const int motor = motor_of_torque(m, kind_at(m, k));
    const real *row = m->response + ((ptrdiff_t)node * m->kinds + k) * m->unknowns;
    for (int i = 0; i < m->unknowns; ++i) {
        out[i] = factor * row[i];
    }
    if (motor >= 0 && secants[(ptrdiff_t)node * NM + motor] != 0.0) {
        for (int l = 0; l < m->kinds; ++l) {
            if (kind_at(m, l) == NM + motor) {
                const real *speed = m->response + ((ptrdiff_t)node * m->kinds + l) * m->unknowns;
                for (int i = 0; i < m->unknowns; ++i) {
                    out[i] += factor * secants[(ptrdiff_t)node * NM + motor] * speed[i];
                }
            }
        }
    }
}

/* One row of the program: limit `side` (1 or -1) of row (node, k), at its present value. */
static void add_row(
    const limited_call *m, interior_point *p, int node, int k, real side, const real *secants)
{
    real *a = m->A + (ptrdiff_t)p->rows * m->width;
    int *range = (int *)(void *)m->range + 2 * (ptrdiff_t)p->rows;
    fill_response(m, node, k, secants, side / m->limit[kind_at(m, k)] * coefficient_unit, a);
    range[0] = range[1] = 0;
    for (int i = 0; i < m->unknowns; ++i) {
        if (fabs_1(a[i]) > 0.0) {
            range[0] = range[1] > 0 ? range[0] : i;
            range[1] = i + 1;
        }
    }
    for (int i = m->unknowns; i < m->width; ++i) {
        a[i] = 0.0;
    }
    m->x[p->rows] = side * m->extreme[(ptrdiff_t)node * m->all + kind_at(m, k)] + m->room;
    ++p->rows;
}

/* The row of s >= 0, behind the others. */
static void close_rows(const limited_call *m, const interior_point *p)
{
    real *a = m->A + (ptrdiff_t)p->rows * m->width;
    int *range = (int *)(void *)m->range + 2 * (ptrdiff_t)p->rows;
    set_zero(a, m->width);
    range[0] = range[1] = 0;
}

/* Values of the rows after a step z, in units of their limits, as the linear program sees them. */
static void show_rows(const limited_call *m, const real *z, const real *secants)
{
    for (int node = 0; node < m->nodes; ++node) {
        for (int k = 0; k < m->kinds; ++k) {
            const ptrdiff_t at = (ptrdiff_t)node * m->all + kind_at(m, k);
            const real *row = m->response + ((ptrdiff_t)node * m->kinds + k) * m->unknowns,
                       *speed = NULL;
            const int motor = motor_of_torque(m, kind_at(m, k));
            real sum = 0.0;
            for (int l = 0; l < m->kinds && motor >= 0; ++l) {
                speed = kind_at(m, l) == NM + motor ?
                            m->response + ((ptrdiff_t)node * m->kinds + l) * m->unknowns :
                            speed;
            }
            for (int i = 0; i < m->unknowns; ++i) {
                sum += (row[i] + (speed != NULL ?
                                         secants[(ptrdiff_t)node * NM + motor] * speed[i] :
                                         0.0)) *
                       z[i];
            }
            m->shown[at] = m->extreme[at] + sum * coefficient_unit / m->limit[kind_at(m, k)];
        }
    }
}

/* Cost and gradient of the program at the present deviation. */
static void set_program(const limited_call *m)
{
    for (int i = 0; i < m->unknowns; ++i) {
        real sum = 0.0;
        for (int j = 0; j < m->unknowns; ++j) {
            const real h = i % NY == j % NY ? m->cost[(ptrdiff_t)(i / NY) * m->count + j / NY] :
                                              0.0;
            m->H[(ptrdiff_t)i * m->unknowns + j] = h;
            sum += h * m->c[j] / coefficient_unit;
        }
        m->g[i] = sum;
    }
}

/*
 * Whether a row is a local maximum in time; rows next to it follow it. Some rows in between count
 * as maxima.
 */
static int is_peak(const limited_call *m, int node, ptrdiff_t at)
{
    const real size = fabs_1(m->shown[at]);
    return node % (NODES_PER_KNOT / 2) == 0 ||
           ((node == 0 || size >= fabs_1(m->shown[at - m->all])) &&
               (node == m->nodes - 1 || size >= fabs_1(m->shown[at + m->all])));
}

/* Which sides of the limits are in the program: those above `least` too. The number of all. */
static int choose_rows(const limited_call *m, real least)
{
    const ptrdiff_t sides = (ptrdiff_t)m->nodes * m->kinds * 2;
    int count = 0;
    for (ptrdiff_t i = 0; i < sides; ++i) {
        count += m->used[i] > 0.0;
    }
    /* too many: the largest ones */
    for (int above = 0, most = m->rows_max - count; above < 50; ++above) {
        int added = 0;
        for (int mark = 0; mark < 2; ++mark) {
            for (ptrdiff_t i = 0; i < sides; ++i) {
                const ptrdiff_t at = i / 2 / m->kinds * m->all +
                                     kind_at(m, (int)(i / 2 % m->kinds));
                const int chosen = !(m->used[i] > 0.0) &&
                                   (i % 2 == 0 ? 1.0 : -1.0) * m->shown[at] > least &&
                                   is_peak(m, (int)(i / 2 / m->kinds), at);
                added += mark == 0 && chosen;
                if (mark == 1 && chosen) {
                    m->used[i] = 1.0;
                }
            }
            if (added > most) {
                break;
            }
        }
        if (added <= most) {
            return added;
        }
        least += 0.02 + 0.05 * least;
    }
    return 0;
}

/*
 * The program with these secants of the friction: the step z [coefficient_unit]; 0 where it fails.
 */
static int solve_program(const limited_call *m, const real *secants, real *z)
{
    const ptrdiff_t sides = (ptrdiff_t)m->nodes * m->kinds * 2, step = (ptrdiff_t)m->rows_max + 1;
    real *r = m->of_rows;
    interior_point p = {m->unknowns, 0, m->width, m->H, m->g, m->A, m->x,
        (const int *)(const void *)m->range, program_price, m->z, m->K, m->z + m->width, r,
        r + step, r + 2 * step, r + 3 * step, r + 4 * step, r + 5 * step};
    set_zero(z, m->unknowns);
    for (int round = 0; round < ROW_ROUNDS; ++round) {
        show_rows(m, z, secants);
        if (choose_rows(m, round == 0 ? near_limit : 1.0) == 0 && round > 0) {
            break;
        }
        p.rows = 0;
        for (ptrdiff_t i = 0; i < sides; ++i) {
            if (m->used[i] > 0.0) {
                add_row(m, &p, (int)(i / 2 / m->kinds), (int)(i / 2 % m->kinds),
                    i % 2 == 0 ? 1.0 : -1.0, secants);
            }
        }
        close_rows(m, &p);
        if (!solve_interior_point(&p)) {
            return 0;
        }
        copy(m->z, m->unknowns, z);
    }
    return 1;
}

/*
 * Secants of the friction at the nodes, between the speeds now and those after a step (null:
 * none); 0 where a number is not finite.
 */
static int find_secants(const limited_call *m, const real *step, real *secants, real *space)
{
    for (int node = 0; node < m->nodes; ++node) {
        real v[NM], after[NM], f[NM], f_after[NM];
        copy(m->at_node + (ptrdiff_t)node * m->all + NM, NM, v);
        copy(v, NM, after);
        for (int k = 0; k < m->kinds; ++k) {
            const int motor = kind_at(m, k) - NM;
            if (motor >= 0 && motor < NM) {
                const real *row = m->response + ((ptrdiff_t)node * m->kinds + k) * m->unknowns;
                real sum = 0.0;
                for (int i = 0; i < m->unknowns && step != NULL; ++i) {
                    sum += row[i] * step[i];
                }
                after[motor] += fabs_1(sum) < least_change ? least_change : sum;
            }
        }
        if (evaluate_motor_friction(v, f, space) != ELBOW_OK ||
            evaluate_motor_friction(after, f_after, space) != ELBOW_OK) {
            return 0;
        }
        for (int i = 0; i < NM; ++i) {
            const real d = after[i] - v[i];
            real secant = 0.0;
            if (fabs_1(d) > 0.0) {
                secant = (f_after[i] - f[i]) / d;
            }
            secants[(ptrdiff_t)node * NM + i] = secant;
        }
    }
    return 1;
}

/*
 * The step that keeps the limits of the linearized motion, with the friction at the speeds after
 * the step; 0 where a program fails.
 */
static int find_step(const limited_call *m, real *space)
{
    /* the responses are known: its memory is free */
    real *secants = m->secants, least = (real)INFINITY;
    set_zero(secants, (ptrdiff_t)m->nodes * NM);
    set_zero(m->best, m->unknowns);
    set_zero(m->used, (ptrdiff_t)m->nodes * m->kinds * 2);
    set_program(m);
    for (int round = 0; round <= FRICTION_ROUNDS; ++round) {
        real over = 0.0;
        if (!find_secants(m, round == 0 ? NULL : m->step, secants, space)) {
            return 0;
        }
        if (round > 0) { /* how good the last step is with the friction at its speeds */
            for (int i = 0; i < m->unknowns; ++i) {
                m->tried[i] = m->step[i] / coefficient_unit;
            }
            show_rows(m, m->tried, secants);
            for (int node = 0; node < m->nodes; ++node) {
                for (int k = 0; k < m->kinds; ++k) {
                    over = fmax_1(
                        over, fabs_1(m->shown[(ptrdiff_t)node * m->all + kind_at(m, k)]) - 1.0);
                }
            }
            if (over < least) {
                least = over;
                copy(m->step, m->unknowns, m->best);
            }
            if (over <= 0.5 * limit_slack || round == FRICTION_ROUNDS) {
                break;
            }
        }
        if (!solve_program(m, secants, m->step)) {
            return 0;
        }
        for (int i = 0; i < m->unknowns; ++i) {
            m->step[i] *= coefficient_unit;
        }
    }
    copy(m->best, m->unknowns, m->step);
    return 1;
}

/*
 * The smallest deviation that keeps the limits, in c, with the number of programs; its motion is
 * the last followed.
 */
static elbow_status modify_path_within(
    limited_call *m, const inner_call *call, real *worst, int *programs)
{
    elbow_status status = find_responses(m, call, call->p->period);
    int fresh = 1;
    m->room = least_margin;
    for (*programs = 1; status == ELBOW_OK && *programs <= LIMITED_ROUNDS; ++*programs) {
        real share = 1.0, over, most = 0.0, change = 0.0;
        if (!find_step(m, m->inner)) {
            return ELBOW_NOT_CONVERGED;
        }
        for (;;) {
            for (int i = 0; i < m->unknowns; ++i) {
                m->tried[i] = m->c[i] + share * m->step[i];
            }
            status = follow_deviated(m, call, m->tried, m->trial, m->shown, &over);
            if ((status == ELBOW_OK && over <= fmax_1(*worst, limit_slack)) ||
                share < least_share) {
                break;
            }
            share *= 0.5;
        }
        if (status != ELBOW_OK) {
            return status;
        }
        copy(m->tried, m->unknowns, m->c);
        copy(m->trial, (ptrdiff_t)m->nodes * m->all, m->at_node);
        copy(m->shown, (ptrdiff_t)m->nodes * m->all, m->extreme);
        for (int i = 0; i < m->unknowns; ++i) {
            most = fmax_1(most, fabs_1(m->c[i]));
            change = fmax_1(change, fabs_1(m->step[i]));
        }
        if (over <= limit_slack &&
            (change <= settled_share * most + 1e-6 || *worst <= limit_slack)) {
            *worst = over;
            return ELBOW_LIMITS_ACTIVE;
        }
        if (over > poor_progress * *worst && over > limit_slack) {
            if (fresh && over > hopeless_progress * *worst) {
                *worst = over;
                return ELBOW_LIMITS_INFEASIBLE;
            }
            status = find_responses(m, call, call->p->period);
            fresh = 1;
        } else {
            fresh = 0;
        }
        *worst = over;
        m->room = least_margin + 0.5 * fmin_1(fmax_1(over, 0.0), margin_max);
    }
    --*programs;
    return status != ELBOW_OK    ? status :
           *worst <= limit_slack ? ELBOW_LIMITS_ACTIVE :
                                   ELBOW_LIMITS_INFEASIBLE;
}

/* Largest distance and angle of the deviation, and the deviation for the caller. */
static void report_deviation(const limited_call *m, const elbow_inversion_limits *limits,
    real period, elbow_invert_limited_info *info)
{
    info->deviation_m = info->deviation_rad = 0.0;
    for (int k = 0; k < m->n; ++k) {
        real d[3 * NY], size[2];
        deviation_at(m->c, m->count, m->spacing, period, k, d);
        size_of_deviation(d, size);
        info->deviation_m = fmax_1(info->deviation_m, size[0]);
        info->deviation_rad = fmax_1(info->deviation_rad, size[1]);
        if (limits->deviation != NULL) {
            copy(d, NY, limits->deviation + k * (ptrdiff_t)NY);
        }
    }
}

/*
 * As elbow_invert_limited; `inner` takes what the last inversion reports, `report` whether the
 * sizes are right.
 */
static elbow_status invert_within(const elbow_samples *path,
    PARAMETERS_ARGUMENT const real q_start[ELBOW_NA], const elbow_inversion_options *options,
    const elbow_inversion_limits *limits, elbow_motion *motion, elbow_invert_limited_info *info,
    elbow_invert_info *inner, whole_report *report, real *work, int64_t work_size)
{
    const real *values = GIVEN_PARAMETERS;
    limited_call m;
    inner_call call;
    elbow_status status, found;
    real worst;
    int programs = 0;
    if (path == NULL || options == NULL || limits == NULL || motion == NULL || work == NULL ||
        values == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (path->n < 2 || !are_in_range(limits) ||
        !lay_out_limited(path->n, options, limits, NULL, &m)) {
        return ELBOW_BAD_ARGUMENT;
    }
    if (work_size < m.end) {
        return ELBOW_WORK_TOO_SMALL;
    }
    (void)lay_out_limited(path->n, options, limits, work, &m);
    m.period = path->period;
    call.p = path;
    call.parameters = values;
    call.q_start = q_start;
    call.options = *options;
    call.options.hold = ELBOW_HOLD_SPLINE;
    call.options.delay = 0.0;
    call.options.settled = 0.0;
    call.options.growth = 0;
    call.options.tolerance = fmin_1(rough_tolerance * options->tolerance, PRECISE(1e-3, 1e-2));
    call.info = inner;
    {
        elbow_motion first = {NULL, NULL, NULL, NULL, NULL, NULL, NULL};
        status = check_arguments(
            path, values, q_start, options, &first, report, work, m.inner_size, m.inner_size);
        if (status != ELBOW_OK) {
            return status;
        }
    }
    set_zero(m.c, m.unknowns);
    status = follow_deviated(&m, &call, m.c, m.at_node, m.extreme, &worst);
    if (status != ELBOW_OK) {
        return status;
    }
    found = ELBOW_OK;
    if (worst > limit_slack) {
        real at_rest = 0.0;
        for (int k = 0; k < m.all; ++k) {
            at_rest = fmax_1(at_rest, m.limit[k] < (real)INFINITY ? fabs_1(m.extreme[k]) : 0.0);
            at_rest = fmax_1(at_rest, m.limit[k] < (real)INFINITY ?
                                          fabs_1(m.extreme[(ptrdiff_t)(m.nodes - 1) * m.all + k]) :
                                          0.0);
        }
        info->limit_excess = at_rest - 1.0;
        if (at_rest > 1.0 + limit_slack) {
            return ELBOW_LIMITS_INFEASIBLE;
        }
        set_cost(&m);
        found = modify_path_within(&m, &call, &worst, &programs);
        info->limit_excess = worst;
        info->programs = programs;
        if (found < 0) {
            return found;
        }
    }
    deviate(&m, path, m.c);
    status = invert_deviated(&m, &call, options, motion);
    if (status == ELBOW_TOLERANCE_NOT_MET && found == ELBOW_LIMITS_ACTIVE &&
        inner->residual_at_samples <= call.options.tolerance &&
        inner->kinematic_mismatch <= mismatch_max) {
        /* a deviation is rougher than its path: the tolerance of the programs */
        status = ELBOW_OK;
    }
    report_deviation(&m, limits, path->period, info);
    info->limit_excess = worst > 0.0 ? worst : 0.0;
    info->programs = programs;
    return status == ELBOW_OK ? found : status;
}

elbow_status elbow_invert_limited(const elbow_samples *samples,
    PARAMETERS_ARGUMENT const real q_start[ELBOW_NA], const elbow_inversion_options *options,
    const elbow_inversion_limits *limits, elbow_motion *motion, elbow_invert_limited_info *info,
    real *work, int64_t work_size)
{
    whole_report report = {0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0};
    elbow_invert_limited_info found;
    elbow_invert_info inner;
    elbow_status status = ELBOW_NULL_ARGUMENT;
    inner.residual = inner.residual_at_samples = inner.kinematic_mismatch = inner.growth = (real)
        NAN;
    inner.iterations = inner.intervals = inner.n_post = 0;
    found.deviation_m = found.deviation_rad = found.limit_excess = 0.0;
    found.programs = 0;
    if (info != NULL) {
        status = invert_within(samples, PASSED_PARAMETERS q_start, options, limits, motion, &found,
            &inner, &report, work, work_size);
    }
    if (report.is_set) {
        *info = found;
        info->residual = inner.residual;
        info->residual_at_samples = inner.residual_at_samples;
        info->kinematic_mismatch = inner.kinematic_mismatch;
        info->iterations = inner.iterations;
        info->intervals = inner.intervals;
        info->n_post = inner.n_post;
        info->growth = inner.growth;
    }
    return status;
}
