/*
 * model: the path that the output follows: samples, interpolation between them, and small
 * rotations; private.
 */
#ifndef MODEL_PATH_H
#define MODEL_PATH_H

#include "model_inversion_common.h"

static inline void cross(const real *a, const real *b, real *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* The quintic through value and two derivatives at 0 and 1; value and two derivatives at x. */
static inline void quintic(real x, const real left[3], const real right[3], real out[3])
{
    const real d = right[0] - left[0];
    const real a3 = 10.0 * d - 6.0 * left[1] - 4.0 * right[1] - 1.5 * left[2] + 0.5 * right[2];
    const real a4 = -15.0 * d + 8.0 * left[1] + 7.0 * right[1] + 1.5 * left[2] - right[2];
    const real a5 = 6.0 * d - 3.0 * left[1] - 3.0 * right[1] - 0.5 * left[2] + 0.5 * right[2];
    out[0] = left[0] + x * (left[1] + x * (0.5 * left[2] + x * (a3 + x * (a4 + x * a5))));
    out[1] = left[1] + x * (left[2] + x * (3.0 * a3 + x * (4.0 * a4 + x * 5.0 * a5)));
    out[2] = left[2] + x * (6.0 * a3 + x * (12.0 * a4 + x * 20.0 * a5));
}

/*
 * A coordinate between two samples of value, rate times T and second derivative times T^2; both
 * change. For a short period T the rates give the difference of values, which have too few digits
 * for accelerations.
 */
static inline void between_positions(real x, real T, real left[3], real right[3], real out[3])
{
#if BYTES == 8
    const real first = left[0], d = right[0] - first;
    left[0] = 0.0;
    right[0] = T < 4e-4 ? 0.5 * (left[1] + right[1]) + (left[2] - right[2]) / 12.0 : d;
    quintic(x, left, right, out);
    out[0] = first + (out[0] + x * (d - right[0]));
#else
    /*
     * the quartic with these rates: even their difference has too few digits for the coefficients
     * of a quintic
     */
    const real d = right[1] - left[1];
    const real a3 = d - (2.0 * left[2] + right[2]) / 3.0,
               a4 = 0.25 * (left[2] + right[2]) - 0.5 * d;
    const real missing = (right[0] - left[0]) - (left[1] + 0.5 * left[2] + a3 + a4);
    (void)T;
    out[0] = left[0] + x * (left[1] + missing + x * (0.5 * left[2] + x * (a3 + x * a4)));
    out[1] = left[1] + x * (left[2] + x * (3.0 * a3 + x * 4.0 * a4));
    out[2] = left[2] + x * (6.0 * a3 + x * 12.0 * a4);
#endif
}

#if MODEL_POSE
/*
 * a - (f x a) / 2 + (f x (f x a)) / 12: the inverse of the left Jacobian of a small rotation
 * vector f, to f^4 / 720.
 */
static inline void inverse_left_jacobian(const real *f, const real *a, real *out)
{
    real once[3], twice[3], thrice[3], fourth[3];
    cross(f, a, once);
    cross(f, once, twice);
    cross(f, twice, thrice);
    cross(f, thrice, fourth);
    for (int i = 0; i < 3; ++i) {
        out[i] = a[i] - 0.5 * once[i] + twice[i] / 12.0 - fourth[i] / 720.0;
    }
}

/* The left Jacobian of a small rotation vector, the angular velocity of its rate, to f^4 / 120. */
static inline void left_jacobian(const real *f, const real *a, real *out)
{
    real once[3], twice[3], thrice[3], fourth[3];
    cross(f, a, once);
    cross(f, once, twice);
    cross(f, twice, thrice);
    cross(f, thrice, fourth);
    for (int i = 0; i < 3; ++i) {
        out[i] = a[i] + 0.5 * once[i] + twice[i] / 6.0 + thrice[i] / 24.0 + fourth[i] / 120.0;
    }
}

/* Time derivative of the left Jacobian, times the rate d of f. */
static inline void left_jacobian_rate(const real *f, const real *d, real *out)
{
    real fd[3], dfd[3], ffd[3], dffd[3], fdfd[3], fffd[3], dfffd[3], fdffd[3], ffdfd[3];
    cross(f, d, fd);
    cross(d, fd, dfd);
    cross(f, fd, ffd);
    cross(d, ffd, dffd);
    cross(f, dfd, fdfd);
    cross(f, ffd, fffd);
    cross(d, fffd, dfffd);
    cross(f, dffd, fdffd);
    cross(f, fdfd, ffdfd);
    for (int i = 0; i < 3; ++i) {
        out[i] = dfd[i] / 6.0 + (dffd[i] + fdfd[i]) / 24.0 +
                 (dfffd[i] + fdffd[i] + ffdfd[i]) / 120.0;
    }
}

/* Rotation vector of R1 R0' where it is small, R by columns. */
static inline void rotation_vector(const real *R0, const real *R1, real *f)
{
    real s[3] = {0.0, 0.0, 0.0}, trace = 0.0, c;
    for (int k = 0; k < 3; ++k) { /* E = R1 R0' = sum of columns of both */
        const real *a = R1 + 3 * k, *b = R0 + 3 * k;
        s[0] += 0.5 * (a[2] * b[1] - a[1] * b[2]);
        s[1] += 0.5 * (a[0] * b[2] - a[2] * b[0]);
        s[2] += 0.5 * (a[1] * b[0] - a[0] * b[1]);
        trace += a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    }
    /* the sine of the angle times the axis; angle / sine as a series in sine^2 */
    c = s[0] * s[0] + s[1] * s[1] + s[2] * s[2];
    c = trace < 1.0 ?
            (real)NAN :
            1.0 + c * (1.0 / 6.0 + c * (3.0 / 40.0 + c * (15.0 / 336.0 + c * 105.0 / 3456.0)));
    for (int i = 0; i < 3; ++i) {
        f[i] = c * s[i];
    }
}

/* exp(f) R0 */
static inline void rotate(const real *f, const real *R0, real *R)
{
    const real u = f[0] * f[0] + f[1] * f[1] + f[2] * f[2];
    const real s = 1.0 - u / 6.0 * (1.0 - u / 20.0 * (1.0 - u / 42.0 * (1.0 - u / 72.0)));
    const real c = 0.5 * (1.0 - u / 12.0 * (1.0 - u / 30.0 * (1.0 - u / 56.0 * (1.0 - u / 90.0))));
    for (int k = 0; k < 3; ++k) {
        real once[3], twice[3];
        cross(f, R0 + 3 * k, once);
        cross(f, once, twice);
        for (int i = 0; i < 3; ++i) {
            R[3 * k + i] = R0[3 * k + i] + s * once[i] + c * twice[i];
        }
    }
}
#endif

/* y, dy and ddy at sample k; the path is constant before the first and after the last sample. */
static inline void reference_sample(const model_samples *p, ptrdiff_t k, real *out)
{
    const ptrdiff_t at = k < 0 ? 0 : k >= p->n - 1 ? p->n - 1 : k;
    copy(p->y + at * NT, NT, out);
    if (k < 0 || k >= p->n - 1) {
        for (int i = NT; i < REFERENCE; ++i) {
            out[i] = 0.0;
        }
    } else {
        copy(p->dy + at * NY, NY, out + NT);
        copy(p->ddy + at * NY, NY, out + NT + NY);
    }
#if MODEL_FORCE
    /* it stays as it is before the first and after the last sample */
    for (int i = 0; i < FORCES; ++i) {
        const int held = p->force == NULL || (i >= NY && at != k);
        out[NT + 2 * NY + i] = held ? 0.0 : p->force[at * FORCES + i];
    }
#endif /* MODEL_FORCE */
}

/* The same at sample k + x, 0 <= x <= 1. */
static inline void reference_at(const model_samples *p, int k, real x, real *out)
{
    const real T = p->period;
    const ptrdiff_t at = k;
    if (k < 0 || k >= p->n - 1) {
        reference_sample(p, k, out);
    } else {
        const real *y0 = p->y + at * NT, *y1 = y0 + NT;
        const real *v0 = p->dy + at * NY, *v1 = v0 + NY;
        const real *a0 = p->ddy + at * NY, *a1 = a0 + NY;
        for (int i = 0; i < PLACES; ++i) {
            real left[3] = {y0[i], T * v0[i], T * T * a0[i]};
            real right[3] = {y1[i], T * v1[i], T * T * a1[i]};
            real q[3];
            between_positions(x, T, left, right, q);
            out[i] = q[0];
            out[NT + i] = q[1] / T;
            out[NT + NY + i] = q[2] / (T * T);
        }
#if MODEL_FORCE
        for (int i = 0; i < NY; ++i) {
            real q[3] = {0.0, 0.0, 0.0};
            if (p->force != NULL) {
                const real *f0 = p->force + at * FORCES + i, *f1 = f0 + FORCES;
                const real left[3] = {f0[0], T * f0[NY], T * T * f0[2 * NY]};
                const real right[3] = {f1[0], T * f1[NY], T * T * f1[2 * NY]};
                quintic(x, left, right, q);
            }
            out[NT + 2 * NY + i] = q[0];
            out[NT + 3 * NY + i] = out[NT + 4 * NY + i] = 0.0; /* needed at samples only */
        }
#endif /* MODEL_FORCE */
#if MODEL_POSE
        {
            real f1[3], d1[3], e1[3], extra[3], difference[3], f[3], d[3], e[3], second[3];
            rotation_vector(y0 + PLACES, y1 + PLACES, f1);
            inverse_left_jacobian(f1, v1 + PLACES, d1);
            left_jacobian_rate(f1, d1, extra);
            for (int i = 0; i < 3; ++i) {
                difference[i] = a1[PLACES + i] - extra[i];
            }
            inverse_left_jacobian(f1, difference, e1);
            for (int i = 0; i < 3; ++i) {
                real left[3] = {0.0, T * v0[PLACES + i], T * T * a0[PLACES + i]};
                real right[3] = {f1[i], T * d1[i], T * T * e1[i]};
                real q[3];
                between_positions(x, T, left, right, q);
                f[i] = q[0];
                d[i] = q[1] / T;
                e[i] = q[2] / (T * T);
            }
            rotate(f, y0 + PLACES, out + PLACES);
            left_jacobian(f, d, out + NT + PLACES);
            left_jacobian(f, e, second);
            left_jacobian_rate(f, d, extra);
            for (int i = 0; i < 3; ++i) {
                out[NT + NY + PLACES + i] = second[i] + extra[i];
            }
        }
#endif
    }
}

/* The path at x, 0 <= x <= 1, between two consecutive samples of REFERENCE numbers each. */
static inline void between_samples(const real *samples, real period, real x, real *out)
{
    real y[2 * NT], dy[2 * NY], ddy[2 * NY];
#if MODEL_FORCE
    real force[2 * FORCES];
    const model_samples two = {2, period, y, dy, ddy, force};
#else  /* MODEL_FORCE */
    const model_samples two = {2, period, y, dy, ddy};
#endif /* MODEL_FORCE */
    for (int j = 0; j < 2; ++j) {
        copy(samples + j * REFERENCE, NT, y + j * NT);
        copy(samples + j * REFERENCE + NT, NY, dy + j * NY);
        copy(samples + j * REFERENCE + NT + NY, NY, ddy + j * NY);
#if MODEL_FORCE
        copy(samples + j * REFERENCE + NT + 2 * NY, FORCES, force + j * FORCES);
#endif /* MODEL_FORCE */
    }
    reference_at(&two, 0, x, out);
}

#if MODEL_POSE
/* Whether R, by columns, is a rotation. */
static inline int is_rotation(const real *R)
{
    for (int i = 0; i < 3; ++i) {
        real c[3];
        for (int j = 0; j < 3; ++j) {
            const real *a = R + 3 * i, *b = R + 3 * j;
            const real dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            if (!(fabs_1(dot - (i == j ? 1.0 : 0.0)) < PRECISE(1e-6, 1e-5))) {
                return 0;
            }
        }
        cross(R + 3 * i, R + 3 * ((i + 1) % 3), c);
        for (int j = 0; j < 3; ++j) {
            if (!(fabs_1(c[j] - R[3 * ((i + 2) % 3) + j]) < PRECISE(1e-6, 1e-5))) {
                return 0;
            }
        }
    }
    return 1;
}

/* Whether two orientations are close enough for a quintic between them. */
static inline int are_near(const real *R0, const real *R1)
{
    real f[3];
    rotation_vector(R0, R1, f);
    return largest(f, 3) < 0.3;
}
#endif

/*
 * --- A deviation from the path, and its decay.
 *
 * The deviation d of each output is the end of a chain of five integrators, so that four
 * derivatives are continuous.
 */

enum {
    CHAIN = 5, /* derivatives 0 to 4, the fifth is the input */
    DEVIATION = CHAIN * NY,
    DECAYS = 4 /* time constants of the deviation in a horizon */
};

/* One step of the chain, for one output: value and derivatives times T^i, a step of h = tau T. */
static inline void chain_step(
    const real *x, ptrdiff_t stride, real u, real tau, real *out, ptrdiff_t to)
{
    for (int i = 0; i < CHAIN; ++i) {
        real term = 1.0, sum = 0.0;
        for (int j = i; j < CHAIN; ++j) {
            sum += term * x[j * stride];
            term *= tau / (real)(j - i + 1);
        }
        out[i * to] = sum + term * u;
    }
}

/* The free decay of a deviation in the next interval: all five poles at -1/T. */
static inline void decay_step(const real *x, real tau, real *out)
{
    static const real binomial[CHAIN] = {1.0, 5.0, 10.0, 10.0, 5.0};
    for (int j = 0; j < NY; ++j) {
        real u = 0.0;
        for (int i = 0; i < CHAIN; ++i) {
            u -= binomial[i] * x[i * NY + j];
        }
        chain_step(x + j, NY, u, tau, out + j, NY);
    }
}

/* A path with a deviation, at one instant. */
static inline void add_deviation(const real *plan, const real *x, real T, real *out)
{
    for (int i = 0; i < REFERENCE; ++i) {
        out[i] = plan[i];
    }
    for (int i = 0; i < PLACES; ++i) {
        out[i] += x[i];
        out[NT + i] += x[NY + i] / T;
        out[NT + NY + i] += x[2 * NY + i] / (T * T);
    }
#if MODEL_POSE
    {
        real f[3], d[3], e[3], once[3], second[3], extra[3], E[9], spun[3], spun2[3], both[3];
        static const real I[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
        for (int i = 0; i < 3; ++i) {
            f[i] = x[PLACES + i];
            d[i] = x[NY + PLACES + i] / T;
            e[i] = x[2 * NY + PLACES + i] / (T * T);
        }
        rotate(f, plan + PLACES, out + PLACES);
        rotate(f, I, E);
        left_jacobian(f, d, once);
        left_jacobian(f, e, second);
        left_jacobian_rate(f, d, extra);
        for (int i = 0; i < 3; ++i) {
            spun[i] = spun2[i] = 0.0;
            for (int k = 0; k < 3; ++k) {
                spun[i] += E[3 * k + i] * plan[NT + PLACES + k];
                spun2[i] += E[3 * k + i] * plan[NT + NY + PLACES + k];
            }
        }
        cross(once, spun, both);
        for (int i = 0; i < 3; ++i) {
            out[NT + PLACES + i] = once[i] + spun[i];
            out[NT + NY + PLACES + i] = second[i] + extra[i] + both[i] + spun2[i];
        }
    }
#endif
}

#if MODEL_FURTHER
/* Length of the outputs that are the position of the tool. */
static inline real size_of_tool(const real *x)
{
    real sum = 0.0;
    for (int i = 0; i < TOOL_POSITIONS; ++i) {
        sum += x[i] * x[i];
    }
    return square_root(sum);
}

#endif /* MODEL_FURTHER */
/* Length and angle of a deviation. */
static inline void size_of_deviation(const real *x, real out[2])
{
#if MODEL_FURTHER
    out[0] = out[1] = 0.0;
    for (int i = 0; i < NY; ++i) {
        out[output_is_angle[i]] += x[i] * x[i];
    }
#else  /* MODEL_FURTHER */
    out[0] = out[1] = 0.0;
    for (int i = 0; i < NY; ++i) {
        out[i < PLACES ? 0 : 1] += x[i] * x[i];
    }
#endif /* MODEL_FURTHER */
    out[0] = square_root(out[0]);
    out[1] = square_root(out[1]);
}

#endif
