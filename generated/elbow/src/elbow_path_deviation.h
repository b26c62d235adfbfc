/*
 * elbow: a deviation from the path, and its decay; private to the stream.
 *
 * The deviation d of each output is the end of a chain of five integrators, so that four derivatives are continuous.
 */
#ifndef ELBOW_PATH_DEVIATION_H
#define ELBOW_PATH_DEVIATION_H

#include "elbow_path.h"

enum {
    CHAIN = 5, /* derivatives 0 to 4, the fifth is the input */
    DEVIATION = CHAIN * NY,
    DECAYS = 4 /* time constants of the deviation in a horizon */
};

/* One step of the chain, for one output: value and derivatives times T^i, a step of h = tau T. */
static inline void chain_step(const real *x, ptrdiff_t stride, real u, real tau, real *out, ptrdiff_t to)
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
    const int positions = ELBOW_POSE ? 3 : NY;
    for (int i = 0; i < REFERENCE; ++i) {
        out[i] = plan[i];
    }
    for (int i = 0; i < positions; ++i) {
        out[i] += x[i];
        out[NT + i] += x[NY + i] / T;
        out[NT + NY + i] += x[2 * NY + i] / (T * T);
    }
#if ELBOW_POSE
    {
        real f[3], d[3], e[3], once[3], second[3], extra[3], E[9], spun[3], spun2[3], both[3];
        static const real I[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
        for (int i = 0; i < 3; ++i) {
            f[i] = x[3 + i];
            d[i] = x[NY + 3 + i] / T;
            e[i] = x[2 * NY + 3 + i] / (T * T);
        }
        rotate(f, plan + 3, out + 3);
        rotate(f, I, E);
        left_jacobian(f, d, once);
        left_jacobian(f, e, second);
        left_jacobian_rate(f, d, extra);
        for (int i = 0; i < 3; ++i) {
            spun[i] = spun2[i] = 0.0;
            for (int k = 0; k < 3; ++k) {
                spun[i] += E[3 * k + i] * plan[NT + 3 + k];
                spun2[i] += E[3 * k + i] * plan[NT + NY + 3 + k];
            }
        }
        cross(once, spun, both);
        for (int i = 0; i < 3; ++i) {
            out[NT + 3 + i] = once[i] + spun[i];
            out[NT + NY + 3 + i] = second[i] + extra[i] + both[i] + spun2[i];
        }
    }
#endif
}

/* Length and angle of a deviation. */
static inline void size_of_deviation(const real *x, real out[2])
{
    const int positions = ELBOW_POSE ? 3 : NY;
    out[0] = out[1] = 0.0;
    for (int i = 0; i < NY; ++i) {
        out[i < positions ? 0 : 1] += x[i] * x[i];
    }
    out[0] = square_root(out[0]);
    out[1] = square_root(out[1]);
}

#endif
