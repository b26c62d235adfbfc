/* model: samples of a planned path from its table. Written by flexgen; see model_inversion.h. */
#include "model_inversion.h"

#include "model_inversion_common.h"
#include "model_reduced_problem.h"

/*
 * --- The table of a planned path, and its laws: distance along a curve over time.
 *
 * The layout of the table is in flexgen/paths/path_table.py. Every operation is that of
 * flexgen/paths/, in the same order, so that samples have the bits of Python's.
 */

enum { JET = 3 }; /* a value and two derivatives */

/* What is not yet read of a block of the table. */
typedef struct {
    const real *at, *end;
} reader;

/* The next n numbers; null where the block has fewer. */
static inline const real *take(reader *r, ptrdiff_t n)
{
    const real *x = r->at;
    if (n < 0 || n > r->end - r->at) {
        return NULL;
    }
    r->at += n;
    return x;
}

/* The next number as a count from 0 to `most`; -1 where it is none. */
static inline int take_count(reader *r, int most)
{
    const real *x = take(r, 1);
    return x != NULL && *x >= 0.0 && *x <= (real)most && *x == (real)(int)*x ? (int)*x : -1;
}

/* The next block inside a block, which is skipped; 0 where there is none. */
static inline int take_block(reader *r, reader *block)
{
    const real *length = take(r, 1);
    if (length == NULL || !(*length >= 1.0 && *length - 1.0 <= (real)(r->end - r->at))) {
        return 0;
    }
    block->at = r->at;
    block->end = r->at + ((ptrdiff_t)*length - 1);
    r->at = block->end;
    return 1;
}

/* The last of `count` rising numbers that is not above x, counted from 0; 0 where all are. */
static inline int last_below(const real *x, int count, real value)
{
    int at = 0;
    for (int i = 1; i < count; ++i) {
        if (x[i] <= value) {
            at = i;
        }
    }
    return at;
}

static inline real clipped(real x, real low, real high)
{
    return x < low ? low : x > high ? high : x;
}

/* A polynomial step: coefficients of its integral, value and two derivatives in t / duration. */
typedef struct {
    real duration, scale;
    const real *power; /* powers 1 and 2 of the duration */
    const real *rows;  /* 4 x n */
    int n;
} polynomial;

enum { COEFFICIENTS_MAX = 64, PHASES_MAX = 100000 };

static inline int take_polynomial(reader *r, polynomial *p)
{
    const real *head = take(r, 4);
    if (head == NULL) {
        return 0;
    }
    p->duration = head[0];
    p->power = head + 1;
    p->scale = head[3];
    p->n = take_count(r, COEFFICIENTS_MAX);
    p->rows = p->n < 1 ? NULL : take(r, 4 * (ptrdiff_t)p->n);
    return p->rows != NULL;
}

static inline real horner(const polynomial *p, int row, real x)
{
    const real *c = p->rows + (ptrdiff_t)row * p->n;
    real sum = c[p->n - 1];
    for (int i = p->n - 2; i >= 0; --i) {
        sum = c[i] + sum * x;
    }
    return sum;
}

/*
 * Value and two derivatives; at rest before 0 and after the duration. The second half mirrors the
 * first.
 */
static inline void polynomial_at(const polynomial *p, real t, real out[JET])
{
    const real u = clipped(t / p->duration, 0.0, 1.0), x = u > 0.5 ? 1.0 - u : u;
    const int late = u > 0.5, inside = t > 0.0 && t < p->duration;
    const real value = horner(p, 1, x);
    out[0] = late ? 1.0 - value : value;
    out[1] = inside ? horner(p, 2, x) / p->power[0] : 0.0;
    out[2] = inside ? (late ? -1.0 : 1.0) * horner(p, 3, x) / p->power[1] : 0.0;
    for (int k = 0; k < JET; ++k) {
        out[k] = p->scale * out[k];
    }
}

/* Integral, value and first derivative. */
static inline void polynomial_integral(const polynomial *p, real t, real out[JET])
{
    const real held = clipped(t, 0.0, p->duration), u = held / p->duration;
    const int late = u > 0.5;
    const real value = horner(p, 0, late ? 1.0 - u : u);
    real law[JET];
    polynomial_at(p, held, law);
    out[0] = p->scale * (p->duration * (late ? (u - 0.5) + value : value));
    out[1] = law[0];
    out[2] = law[1];
}

/* The same of a step whose highest derivative is piecewise constant. */
static inline int trapezoid_integral(reader *r, real t, real out[JET])
{
    const real *duration = take(r, 1), *knots, *values, *left;
    const int count = take_count(r, COEFFICIENTS_MAX), size = take_count(r, COEFFICIENTS_MAX);
    real held, x, dt;
    int late;
    knots = count < 1 ? NULL : take(r, count);
    values = knots == NULL || size < 1 ? NULL : take(r, (ptrdiff_t)count * size);
    if (duration == NULL || values == NULL) {
        return 0;
    }
    held = clipped(t, 0.0, *duration);
    late = held > *duration / 2.0;
    x = late ? *duration - held : held;
    left = values + (ptrdiff_t)last_below(knots, count, x) * size;
    dt = x - knots[last_below(knots, count, x)];
    for (int j = 0; j < JET; ++j) {
        real sum = 0.0;
        for (int i = size - 1; i >= j; --i) {
            sum = left[i] + sum * dt / (real)(i - j + 1);
        }
        out[j] = late && j == 1 ? -sum : sum;
    }
    if (late) {
        out[0] += held - *duration / 2.0;
        out[1] += 1.0;
    }
    return 1;
}

/* Integral, value and first derivative of a step; 0 where the table is damaged. */
static inline int step_at(reader *r, real t, real out[JET])
{
    const int kind = take_count(r, 1);
    polynomial p;
    if (kind == 1) {
        return trapezoid_integral(r, t, out);
    }
    if (kind != 0 || !take_polynomial(r, &p)) {
        return 0;
    }
    polynomial_integral(&p, t, out);
    return 1;
}

/* Distance by phases of constant and of changing speed. */
static inline int phases_at(reader *r, real t, real s[JET])
{
    const real *scale = take(r, 3), *starts, *distances, *first, *last;
    const int m = take_count(r, PHASES_MAX);
    reader step = {NULL, NULL};
    real x, tau, part[JET];
    int at;
    starts = m < 1 ? NULL : take(r, (ptrdiff_t)m + 1);
    distances = starts == NULL ? NULL : take(r, (ptrdiff_t)m + 1);
    first = distances == NULL ? NULL : take(r, m);
    last = first == NULL ? NULL : take(r, m);
    if (scale == NULL || last == NULL) {
        return 0;
    }
    x = t / scale[0];
    s[0] = x > 0.0 ? distances[m] : 0.0;
    s[1] = s[2] = 0.0;
    if (!(x > 0.0 && x < starts[m])) {
        return 1;
    }
    at = last_below(starts, m, x);
    for (int k = 0; k <= at; ++k) {
        if (!take_block(r, &step)) {
            return 0;
        }
    }
    tau = x - starts[at];
    s[0] = distances[at] + first[at] * tau;
    s[1] = first[at];
    if (step.at < step.end) {
        if (!step_at(&step, tau, part)) {
            return 0;
        }
        for (int k = 0; k < JET; ++k) {
            s[k] = s[k] + (last[at] - first[at]) * part[k];
        }
    }
    s[1] = s[1] / scale[1];
    s[2] = s[2] / scale[2];
    return 1;
}

/* Distance along the curve and two time derivatives; 0 where the table is damaged. */
static inline int law_at(reader *r, real t, real s[JET])
{
    const int kind = take_count(r, 2);
    polynomial p;
    if (kind == 2) {
        return phases_at(r, t, s);
    }
    if (kind != 0 || !take_polynomial(r, &p)) {
        return 0;
    }
    polynomial_at(&p, t, s);
    return 1;
}

/*
 * --- The curves of a planned path: lines, arcs and blended corners, with the rotation of the tool
 * along them; private to the path sampler. See above for the order of operations.
 *
 * A jet is a value and two derivatives.
 */

enum {
    WIDER = NG > NY ? NG : NY,
#if MODEL_FURTHER
    /* coordinates of a curve of the tool that are lengths; an angle may follow */
    LENGTHS = 3,
    DIMENSIONS = WIDER > 4 ? WIDER : 4, /* of a curve, at most */
    ARC_SHAPE = 7,                      /* numbers of an arc */
#else                                   /* MODEL_FURTHER */
    DIMENSIONS = WIDER > 3 ? WIDER : 3, /* of a curve, at most */
#endif                                  /* MODEL_FURTHER */
    NODES = 12,                         /* of Gauss' quadrature */
    ARC_STEPS = 12,                     /* of Newton's method, at most */
    KNOTS_MAX = 1000,
    SECTIONS_MAX = 100000
};

static const real legendre_x[NODES] = {-0.9815606342467192, -0.9041172563704748,
    -0.7699026741943047, -0.5873179542866175, -0.3678314989981802, -0.1252334085114689,
    0.1252334085114689, 0.3678314989981802, 0.5873179542866175, 0.7699026741943047,
    0.9041172563704748, 0.9815606342467192};
static const real legendre_w[NODES] = {0.04717533638651141, 0.10693932599531907,
    0.16007832854334642, 0.20316742672306573, 0.2334925365383546, 0.2491470458134027,
    0.2491470458134027, 0.2334925365383546, 0.20316742672306573, 0.16007832854334642,
    0.10693932599531907, 0.04717533638651141};

/*
 * A point of a curve; for a pose the orientation by rows, and the angular velocity with its
 * derivative.
 */
typedef struct {
    real x[DIMENSIONS][JET];
    real R[9], w[3][JET - 1];
    int is_pose;
} curve_point;

/* Jet of f(s) from the derivatives of f in s, and the jet of s. */
static inline void composed(const real f[JET], const real s[JET], real out[JET])
{
    const real f1 = f[1], f2 = f[2];
    out[0] = f[0];
    out[1] = f1 * s[1];
    out[2] = f1 * s[2] + f2 * (s[1] * s[1]);
}

/* A line or an arc, with the rotation of the tool. */
typedef struct {
    int is_arc;
    /* hat2: square of the cross-product matrix of the axis */
    const real *length, *rate, *rotation, *axis, *hat2;
    /* displacement, or both radius vectors and the rate */
    const real *shape;
} geometry;

static inline int take_geometry(reader *r, int dimensions, geometry *g)
{
    reader block;
    if (!take_block(r, &block)) {
        return 0;
    }
    g->is_arc = take_count(&block, 1);
    g->length = take(&block, 1);
    g->rate = take(&block, 1);
    g->rotation = take(&block, 3);
    g->axis = take(&block, 3);
    g->hat2 = take(&block, 9);
#if MODEL_FURTHER
    g->shape = take(&block, g->is_arc == 1 ? ARC_SHAPE + dimensions - LENGTHS : dimensions);
    return g->is_arc >= 0 && (!g->is_arc || dimensions == LENGTHS || dimensions == LENGTHS + 1) &&
           g->shape != NULL && g->hat2 != NULL;
#else  /* MODEL_FURTHER */
    g->shape = take(&block, g->is_arc == 1 ? 7 : dimensions);
    return g->is_arc >= 0 && (!g->is_arc || dimensions == 3) && g->shape != NULL &&
           g->hat2 != NULL;
#endif /* MODEL_FURTHER */
}

/* Jet of the displacement from the start, from the jet of the parameter. */
static inline void displacement(
    const geometry *g, int dimensions, const real s[JET], real out[][JET])
{
    if (!g->is_arc) {
        for (int i = 0; i < dimensions; ++i) {
            for (int k = 0; k < JET; ++k) {
                out[i][k] = g->shape[i] * (s[k] / *g->length);
            }
        }
        return;
    }
    {
        const real *a = g->shape, *b = g->shape + 3, rate = g->shape[6];
        const real phi[JET] = {s[0] * rate, s[1] * rate, s[2] * rate};
        real sine, cosine, half, unused;
        sine_cosine_1(phi[0], &sine, &cosine);
        sine_cosine_1(phi[0] / 2.0, &half, &unused);
        for (int i = 0; i < 3; ++i) {
            const real f[JET] = {0.0, cosine * b[i] - sine * a[i], -cosine * a[i] - sine * b[i]};
            composed(f, phi, out[i]);
            /* 1 - cos without cancellation */
            out[i][0] = sine * b[i] - 2.0 * (half * half) * a[i];
        }
#if MODEL_FURTHER
        for (int i = LENGTHS; i < dimensions; ++i) { /* an angle, in proportion to the parameter */
            for (int k = 0; k < JET; ++k) {
                out[i][k] = g->shape[ARC_SHAPE + i - LENGTHS] * (s[k] / *g->length);
            }
        }
#endif /* MODEL_FURTHER */
    }
}

/*
 * Jet of the product of two scalars, of the first `size` derivatives, added to `out` times `sign`.
 */
static inline void add_product(const real *a, const real *b, int size, real sign, real *out)
{
    for (int k = 0; k < size; ++k) {
        real sum = a[0] * b[k];
        for (int i = 1; i <= k; ++i) {
            sum += (k == 2 && i == 1 ? 2.0 : 1.0) * a[i] * b[k - i];
        }
        out[k] = out[k] + sign * sum;
    }
}

/* Jet of the product of two quaternions. */
static inline void quaternion_product(real a[4][JET], real b[4][JET], int size, real out[4][JET])
{
    static const int other[4][4] = {{0, 1, 2, 3}, {1, 0, 3, 2}, {2, 3, 0, 1}, {3, 2, 1, 0}};
    static const real sign[4][4] = {{1.0, -1.0, -1.0, -1.0}, {1.0, 1.0, 1.0, -1.0},
        {1.0, -1.0, 1.0, 1.0}, {1.0, 1.0, -1.0, 1.0}};
    for (int i = 0; i < 4; ++i) {
        for (int k = 0; k < size; ++k) {
            out[i][k] = 0.0;
        }
        for (int j = 0; j < 4; ++j) {
            add_product(a[j], b[other[i][j]], size, sign[i][j], out[i]);
        }
    }
}

/* Jet of the rotation since the start as a quaternion. */
static inline void rotation_along(const geometry *g, const real s[JET], real q[4][JET])
{
    real half[JET], sine, cosine, w[JET], v[JET];
    for (int k = 0; k < JET; ++k) {
        half[k] = s[k] * *g->rate / 2.0;
    }
    sine_cosine_1(half[0], &sine, &cosine);
    {
        const real of_w[JET] = {cosine, -sine, -cosine}, of_v[JET] = {sine, cosine, -sine};
        composed(of_w, half, w);
        composed(of_v, half, v);
    }
    for (int k = 0; k < JET; ++k) {
        q[0][k] = w[k];
        for (int i = 0; i < 3; ++i) {
            q[1 + i][k] = v[k] * g->axis[i];
        }
    }
}

/* Orientation and angular velocity of the jet of a unit quaternion. */
static inline void attitude_of(real q[4][JET], curve_point *p)
{
    const real w = q[0][0], x = q[1][0], y = q[2][0], z = q[3][0];
    real rate[4][JET], back[4][JET], spin[4][JET];
    p->R[0] = 1.0 - 2.0 * (y * y + z * z);
    p->R[1] = 2.0 * (x * y - w * z);
    p->R[2] = 2.0 * (x * z + w * y);
    p->R[3] = 2.0 * (x * y + w * z);
    p->R[4] = 1.0 - 2.0 * (x * x + z * z);
    p->R[5] = 2.0 * (y * z - w * x);
    p->R[6] = 2.0 * (x * z - w * y);
    p->R[7] = 2.0 * (y * z + w * x);
    p->R[8] = 1.0 - 2.0 * (x * x + y * y);
    for (int i = 0; i < 4; ++i) {
        for (int k = 0; k + 1 < JET; ++k) {
            rate[i][k] = q[i][k + 1];
            back[i][k] = i == 0 ? q[i][k] : -q[i][k];
        }
    }
    quaternion_product(rate, back, JET - 1, spin);
    for (int i = 0; i < 3; ++i) {
        for (int k = 0; k + 1 < JET; ++k) {
            p->w[i][k] = 2.0 * spin[1 + i][k];
        }
    }
}

/* A section with one line or arc; 0 where the table is damaged. */
static inline int straight_at(reader *r, int dimensions, const real s[JET], curve_point *p)
{
    const real *start = take(r, 2), *position = take(r, dimensions), *R = take(r, 9);
    real inner[JET];
    geometry g;
    if (start == NULL || position == NULL || R == NULL || !take_geometry(r, dimensions, &g)) {
        return 0;
    }
    inner[0] = (s[0] - start[0]) + start[1];
    inner[1] = s[1];
    inner[2] = s[2];
    displacement(&g, dimensions, inner, p->x);
    for (int i = 0; i < dimensions; ++i) {
        p->x[i][0] += position[i];
    }
    if (p->is_pose) {
        const real angle = inner[0] * *g.rate, a = g.axis[0], b = g.axis[1], c = g.axis[2];
        const real hat[9] = {0.0, -c, b, c, 0.0, -a, -b, a, 0.0};
        real sine, half, unused, E[9];
        sine_cosine_1(angle, &sine, &unused);
        sine_cosine_1(angle / 2.0, &half, &unused);
        for (int i = 0; i < 9; ++i) {
            E[i] = ((i % 4 == 0 ? 1.0 : 0.0) + sine * hat[i]) + 2.0 * (half * half) * g.hat2[i];
        }
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                p->R[3 * i + j] = (E[3 * i] * R[j] + E[3 * i + 1] * R[3 + j]) +
                                  E[3 * i + 2] * R[6 + j];
            }
            p->w[i][0] = g.rotation[i] * (inner[1] / *g.length);
            p->w[i][1] = g.rotation[i] * (inner[2] / *g.length);
        }
    }
    return 1;
}

/* The corner between two lines or arcs: the first still moves while the second has started. */
typedef struct {
    const real *first, *last; /* parameter */
    const real *length;       /* of the first */
    const real *resolution;   /* a step of Newton's method that is rounding */
    const real *position, *quaternion;
    const real *knots, *lengths; /* of the table of arc lengths, `count` each */
    int count;
    polynomial step;
    geometry before, after;
} corner;

static inline int take_corner(reader *r, int dimensions, corner *c)
{
    reader block;
    c->first = take(r, 1);
    c->last = take(r, 1);
    c->length = take(r, 1);
    c->resolution = take(r, 1);
    c->position = take(r, dimensions);
    c->quaternion = take(r, 4);
    c->count = take_count(r, KNOTS_MAX);
    if (c->quaternion == NULL || c->count < 0 || c->count == 1) {
        return 0;
    }
    c->knots = take(r, c->count);
    c->lengths = take(r, c->count);
    return c->lengths != NULL && take_block(r, &block) && take_count(&block, 0) == 0 &&
           take_polynomial(&block, &c->step) && take_geometry(r, dimensions, &c->before) &&
           take_geometry(r, dimensions, &c->after);
}

/* Jets of the lengths covered of both, from the jet of the parameter. */
static inline void both_lengths(
    const corner *c, const real u[JET], real first[JET], real second[JET])
{
    real rise[JET], fall[JET], remaining[JET];
    polynomial_integral(&c->step, u[0] - *c->first, rise);
    polynomial_integral(&c->step, *c->last - u[0], fall);
    fall[1] = -fall[1];
    composed(rise, u, second);
    composed(fall, u, remaining);
    for (int k = 0; k < JET; ++k) {
        first[k] = -remaining[k];
    }
    first[0] += *c->length;
}

/* Position in the corner, from the jet of the parameter. */
static inline void corner_position(
    const corner *c, int dimensions, const real u[JET], real x[][JET])
{
    real first[JET], second[JET], more[DIMENSIONS][JET];
    both_lengths(c, u, first, second);
    displacement(&c->before, dimensions, first, x);
    displacement(&c->after, dimensions, second, more);
    for (int i = 0; i < dimensions; ++i) {
        for (int k = 0; k < JET; ++k) {
            x[i][k] += more[i][k];
        }
        x[i][0] += c->position[i];
    }
}

/* |dp/du|. */
static inline real corner_speed(const corner *c, int dimensions, real at)
{
    const real u[JET] = {at, 1.0, 0.0};
    real x[DIMENSIONS][JET], sum = 0.0;
    corner_position(c, dimensions, u, x);
#if MODEL_FURTHER
    for (int i = 0; i < dimensions && i < LENGTHS; ++i) {
#else  /* MODEL_FURTHER */
    for (int i = 0; i < dimensions; ++i) {
#endif /* MODEL_FURTHER */
        sum += x[i][1] * x[i][1];
    }
    return square_root(sum);
}

/* Arc length between two parameters. */
static inline real corner_length(const corner *c, int dimensions, real a, real b)
{
    const real half = (b - a) / 2.0;
    real total = 0.0;
    for (int j = 0; j < NODES; ++j) {
        total += corner_speed(c, dimensions, (a + half) + half * legendre_x[j]) * legendre_w[j];
    }
    return half * total;
}

/* Jet of the parameter from the jet of the arc length since the start of the corner. */
static inline void corner_parameter(
    const corner *c, int dimensions, const real s[JET], real u[JET])
{
    const int panel = last_below(c->lengths, c->count - 1, s[0]);
    const real low = c->knots[panel], high = c->knots[panel + 1], rest = s[0] - c->lengths[panel];
    real at = low + rest / (c->lengths[panel + 1] - c->lengths[panel]) * (high - low);
    real x[DIMENSIONS][JET], squared = 0.0, changing = 0.0, f[JET], slope, slope_rate;
    for (int k = 0; k < ARC_STEPS; ++k) {
        const real step = (corner_length(c, dimensions, low, at) - rest) /
                          corner_speed(c, dimensions, at);
        at = clipped(at - step, low, high);
        if (!(fabs_1(step) > *c->resolution)) {
            break;
        }
    }
    f[0] = at;
    f[1] = 1.0;
    f[2] = 0.0;
    corner_position(c, dimensions, f, x);
#if MODEL_FURTHER
    for (int i = 0; i < dimensions && i < LENGTHS; ++i) {
#else  /* MODEL_FURTHER */
    for (int i = 0; i < dimensions; ++i) {
#endif /* MODEL_FURTHER */
        squared = squared + x[i][1] * x[i][1];
        changing = changing + (x[i][1] * x[i][2] + x[i][2] * x[i][1]);
    }
    slope = square_root(squared);
    slope_rate = changing / (2.0 * slope);
    f[1] = 1.0 / slope;
    f[2] = f[1] * (-f[1] * (slope_rate * f[1]));
    composed(f, s, u);
}

static inline int corner_at(reader *r, int dimensions, const real s[JET], curve_point *p)
{
    const real *start = take(r, 1);
    real inner[JET], u[JET];
    corner c;
    if (start == NULL || !take_corner(r, dimensions, &c)) {
        return 0;
    }
    inner[0] = s[0] - *start;
    inner[1] = s[1];
    inner[2] = s[2];
    if (c.count > 0) {
        corner_parameter(&c, dimensions, inner, u);
    } else {
        u[0] = inner[0] + *c.first;
        u[1] = inner[1];
        u[2] = inner[2];
    }
    corner_position(&c, dimensions, u, p->x);
    if (p->is_pose) {
        real first[JET], second[JET], initial[4][JET], one[4][JET], turned[4][JET], all[4][JET];
        both_lengths(&c, u, first, second);
        for (int i = 0; i < 4; ++i) {
            initial[i][0] = c.quaternion[i];
            initial[i][1] = initial[i][2] = 0.0;
        }
        rotation_along(&c.before, first, one);
        quaternion_product(one, initial, JET, turned);
        rotation_along(&c.after, second, one);
        quaternion_product(one, turned, JET, all);
        attitude_of(all, p);
    }
    return 1;
}

/*
 * The point of a curve with the jet s of the arc length; its dimension, or 0 where the table is
 * damaged.
 */
static inline int curve_at(reader *r, const real s[JET], curve_point *p)
{
    const int dimensions = take_count(r, DIMENSIONS);
    const int is_pose = take_count(r, 1), sections = take_count(r, SECTIONS_MAX);
    reader chosen = {NULL, NULL};
    if (dimensions < 1 || is_pose < 0 || sections < 1) {
        return 0;
    }
    p->is_pose = is_pose;
    for (int k = 0; k < sections; ++k) {
        reader section;
        if (!take_block(r, &section) || section.end - section.at < 2) {
            return 0;
        }
        if (k > 0 && section.at[1] > s[0]) {
            break;
        }
        chosen = section;
    }
    switch (take_count(&chosen, 1)) {
    case 0:
        return straight_at(&chosen, dimensions, s, p) ? dimensions : 0;
    case 1:
        return corner_at(&chosen, dimensions, s, p) ? dimensions : 0;
    default:
        return 0;
    }
}

/* --- Samples of a planned path. */

enum { TABLE_LAYOUT = 1, SPACE_TOOL = 0, SPACE_JOINT = 2, SEGMENTS_MAX = 100000 };

/* What stands before the segments of a table. */
typedef struct {
    int segments;
    const real *duration, *q_start, *axes;
    reader rest;
} table_head;

/* POINTS arms without deflections, for the outputs of a joint move. */
typedef struct {
    points q[NA], v[NA], target[NT], error[NY], W[NA][NY], bias[NY];
} sampler_points;

int64_t model_path_work(void)
{
    return padded((int64_t)(sizeof(sampler_points) / sizeof(real))) + function_work();
}

/* Read the head; 0 where it is not that of a table for this model. */
static int take_head(const real *table, int64_t size, table_head *head)
{
    reader all = {table, table + size}, r;
    if (!take_block(&all, &r) || all.at != all.end ||
        take_count(&r, TABLE_LAYOUT) != TABLE_LAYOUT || take_count(&r, NT) != NT ||
        take_count(&r, NY) != NY || take_count(&r, NA) != NA) {
        return 0;
    }
    head->segments = take_count(&r, SEGMENTS_MAX);
    head->duration = take(&r, 1);
    head->q_start = take(&r, NA);
    head->axes = take(&r, NY);
    head->rest = r;
    return head->segments > 0 && head->axes != NULL && *head->duration >= 0.0;
}

/* Whether a table can be read at all. */
static int is_table(const real *table, int64_t size)
{
    return size >= 1 && size <= (int64_t)(PTRDIFF_MAX / (ptrdiff_t)sizeof(real)) &&
           is_finite(table, size < (int64_t)INT32_MAX ? (int)size : INT32_MAX);
}

model_status model_path_start(
    const real *table, int64_t table_size, real *duration, real q_start[MODEL_NA])
{
    table_head head;
    if (table == NULL || duration == NULL || q_start == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_table(table, table_size) || !take_head(table, table_size, &head)) {
        return MODEL_BAD_ARGUMENT;
    }
    *duration = *head.duration;
    copy(head.q_start, NA, q_start);
    return MODEL_OK;
}

/*
 * The segment that t belongs to: the last one that has started, or the first one; 0 where the
 * table is damaged.
 */
static int find_segment(table_head *head, real t, reader *segment)
{
    for (int k = 0; k < head->segments; ++k) {
        reader next;
        if (!take_block(&head->rest, &next) || next.at == next.end) {
            return 0;
        }
        if (k > 0 && *next.at > t) {
            break;
        }
        *segment = next;
    }
    return 1;
}

/* Outputs of the undeflected arm from the jets of the joints. */
static void outputs_of_joints(curve_point *p, real *y, real *dy, real *ddy, real *work)
{
    sampler_points *arm = (sampler_points *)(void *)work;
    real *space = work + padded((int64_t)(sizeof(sampler_points) / sizeof(real)));
    for (int l = 0; l < POINTS; ++l) {
        for (int i = 0; i < NA; ++i) {
            arm->q[i][l] = arm->v[i][l] = 0.0;
        }
        for (int i = 0; i < NG; ++i) {
            arm->q[i_g[i]][l] = p->x[i][0];
            arm->v[i_g[i]][l] = p->x[i][1];
        }
        for (int i = 0; i < NT; ++i) {
            arm->target[i][l] = 0.0;
        }
    }
#if MODEL_POSE
    /*
     * The error of the orientation is linear in the target R: half the sum of the cross products
     * of its columns with those of the arm. The unit vectors x and y as column k show column k of
     * the arm's.
     */
    for (int k = 0; k < 3; ++k) {
        arm->target[PLACES + 3 * k][2 * k] = 1.0;
        arm->target[PLACES + 3 * k + 1][2 * k + 1] = 1.0;
    }
#endif
    (void)evaluate_output_constraint_batch(POINTS, &arm->q[0][0], &arm->v[0][0],
        &arm->target[0][0], &arm->error[0][0], &arm->W[0][0][0], &arm->bias[0][0], space);
#if MODEL_POSE
    for (int i = 0; i < PLACES; ++i) {
        y[i] = arm->error[i][0];
    }
    for (int k = 0; k < 3; ++k) {
        real *column = y + PLACES + 3 * k;
        column[0] = -2.0 * arm->error[PLACES + 2][2 * k + 1];
        column[1] = 2.0 * arm->error[PLACES + 2][2 * k];
        column[2] = 2.0 * arm->error[PLACES][2 * k + 1];
    }
#else
    for (int i = 0; i < NY; ++i) {
        y[i] = arm->error[i][0];
    }
#endif
    for (int j = 0; j < NY; ++j) {
        real rate = 0.0, second = arm->bias[j][0];
        for (int i = 0; i < NG; ++i) {
            rate += arm->W[i_g[i]][j][0] * p->x[i][1];
            second += arm->W[i_g[i]][j][0] * p->x[i][2];
        }
        dy[j] = rate;
        ddy[j] = second;
    }
}

/* The point of a curve in the space of the outputs; 0 where it does not fit them. */
static int outputs_of_curve(const curve_point *p, int dimensions, int space, const real *axes,
    real *y, real *dy, real *ddy)
{
    (void)axes;
#if MODEL_POSE
    if (space != SPACE_TOOL || dimensions != 3 || !p->is_pose || PLACES > 3) {
        return 0;
    }
    for (int i = 0; i < 3; ++i) {
        y[i] = p->x[i][0];
        dy[i] = p->x[i][1];
        ddy[i] = p->x[i][2];
        for (int k = 0; k < 3; ++k) {
            y[3 + 3 * k + i] = p->R[3 * i + k];
        }
        dy[3 + i] = p->w[i][0];
        ddy[3 + i] = p->w[i][1];
    }
#else
    for (int i = 0; i < NY; ++i) {
        const int from = space != SPACE_TOOL                          ? i :
                         axes[i] >= 0.0 && axes[i] < (real)dimensions ? (int)axes[i] :
                                                                        -1;
        if (from < 0 || from >= dimensions) {
            return 0;
        }
        y[i] = p->x[from][0];
        dy[i] = p->x[from][1];
        ddy[i] = p->x[from][2];
    }
#endif
    return 1;
}

model_status model_path_sample(const real *table, int64_t table_size, PARAMETERS_ARGUMENT real t,
    real y[MODEL_NT], real dy[MODEL_NY], real ddy[MODEL_NY], real *work, int64_t work_size)
{
    const real *values = GIVEN_PARAMETERS;
    reader segment = {NULL, NULL}, law, curve;
    real s[JET];
    const real *start; /* and duration */
    curve_point p;
    table_head head;
    int space, dimensions;
    if (table == NULL || values == NULL || y == NULL || dy == NULL || ddy == NULL ||
        work == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (work_size < model_path_work()) {
        return MODEL_WORK_TOO_SMALL;
    }
    if (!is_finite(&t, 1) || !is_finite(values, PARAMETERS)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    if (table_size < 1 || !take_head(table, table_size, &head) ||
        !find_segment(&head, t, &segment)) {
        return MODEL_BAD_ARGUMENT;
    }
    start = take(&segment, 2);
    space = take_count(&segment, SPACE_JOINT);
    if (start == NULL || space < 0 || !take_block(&segment, &law) ||
        !take_block(&segment, &curve) ||
        !law_at(&law, t >= start[0] + start[1] ? (t - start[0]) + start[1] : t - start[0], s)) {
        return MODEL_BAD_ARGUMENT;
    }
    dimensions = curve_at(&curve, s, &p);
    if (dimensions < 1 || (space == SPACE_JOINT && dimensions != NG)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (space == SPACE_JOINT) {
        keep_parameters(values, work + padded((int64_t)(sizeof(sampler_points) / sizeof(real))));
        outputs_of_joints(&p, y, dy, ddy, work);
    } else if (!outputs_of_curve(&p, dimensions, space, head.axes, y, dy, ddy)) {
        return MODEL_BAD_ARGUMENT;
    }
    return is_finite(y, NT) && is_finite(dy, NY) && is_finite(ddy, NY) ? MODEL_OK :
                                                                         MODEL_RESULT_NOT_FINITE;
}
