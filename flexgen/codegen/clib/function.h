/*
 * model: shared by the entry points of the emitted functions: checks, and loops over many points;
 * private. Written by flexgen; see model.h.
 */
#ifndef MODEL_FUNCTION_H
#define MODEL_FUNCTION_H

#include "model_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

enum {
    CACHE = 8388608, /* bytes of results that are written past the cache */
    /*
     * lines that a set of the first cache may hold, about: more results at once push each other
     * out
     */
    WAYS = 24,
    ARRAYS = 16 /* inputs of a function, and outputs, at most */
};

/* Arrays and workspace of an emitted function. */
typedef struct {
    int inputs, outputs;
    int shared;            /* the input that is one array for all points; -1: none */
    int work;              /* lanes of workspace of its mathematics */
    int tile;              /* points that are copied together */
    int sizes[2 * ARRAYS]; /* numbers of a point in each input, then in each output */
} function_shape;

/* A function at one point, with copies of its arrays; 0 where all results are finite. */
typedef int (*function_one)(const real *const *in, real *const *out, real *work);

/*
 * A function at `count` points of arrays whose entries are n apart; zeros where all results are
 * finite, else NaN.
 */
typedef lanes (*function_lanes)(
    const real *const *in, real *const *out, lanes *work, int count, ptrdiff_t n);

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE model_status first_failed(
    const function_shape *f, const real *const *in, real *const *out, int n, ptrdiff_t stride)
{
    const int *of_outputs = f->sizes + f->inputs;
    model_status first = MODEL_OK;
    for (int k = 0; k < n; ++k) {
        int known = 1, finite = 1;
        for (int i = 0; i < f->inputs && known; ++i) {
            known = i == f->shared ? all_finite(in[i], f->sizes[i], 1) :
                                     all_finite(in[i] + k, f->sizes[i], stride);
        }
        for (int i = 0; i < f->outputs && finite; ++i) {
            finite = all_finite(out[i] + k, of_outputs[i], stride);
        }
        if (known && finite) {
            continue;
        }
        if (first == MODEL_OK) {
            first = known ? MODEL_RESULT_NOT_FINITE : MODEL_INPUT_NOT_FINITE;
        }
        for (int i = 0; i < f->outputs; ++i) {
            set_nan(out[i] + k, of_outputs[i], stride);
        }
    }
    return first;
}

/* Point k by the function for one point; 0 where all results are finite. */
static SEPARATE int evaluate_point(const function_shape *f, function_one one,
    const real *const *in, real *const *out, int k, ptrdiff_t stride, real *work)
{
    const int *of_outputs = f->sizes + f->inputs;
    const real *from[ARRAYS];
    real *to[ARRAYS], *at = work + f->work * LANES;
    int bad;
    for (int i = 0; i < f->inputs; ++i) {
        from[i] = i == f->shared ? in[i] : at;
        for (int j = 0; j < f->sizes[i] && i != f->shared; ++j) {
            *at++ = in[i][j * stride + k];
        }
    }
    for (int i = 0; i < f->outputs; ++i) {
        to[i] = at;
        at += of_outputs[i];
    }
    bad = one(from, to, work);
    for (int i = 0; i < f->outputs; ++i) {
        for (int j = 0; j < of_outputs[i]; ++j) {
            out[i][j * stride + k] = to[i][j];
        }
    }
    return bad;
}

/*
 * `count` points from `first` on, in lanes; zeros where all results are finite. copied: by copies
 * of the arrays in the workspace; past: results are written past the cache.
 */
static inline lanes evaluate_tile(const function_shape *f, function_lanes evaluate,
    const real *const *in, real *const *out, int first, int count, ptrdiff_t stride, int copied,
    int past, real *work)
{
    const int *of_outputs = f->sizes + f->inputs;
    const real *from[ARRAYS];
    real *to[ARRAYS], *at = work + f->work * LANES;
    lanes zero;
    for (int i = 0; i < f->inputs; ++i) {
        from[i] = i == f->shared ? in[i] : in[i] + first;
        if (copied && i != f->shared) {
            gather_points(from[i], f->sizes[i], count, stride, at, f->tile);
            from[i] = at;
            at += f->sizes[i] * f->tile;
        }
    }
    for (int i = 0; i < f->outputs; ++i) {
        to[i] = copied ? at : out[i] + first;
        at += of_outputs[i] * f->tile;
    }
    zero = evaluate(from, to, (lanes *)work, count, copied ? f->tile : stride);
    for (int i = 0; i < f->outputs && copied; ++i) {
        scatter_points(to[i], of_outputs[i], count, f->tile, out[i] + first, stride, past);
    }
    return zero;
}

/* n points of arrays whose entries are `stride` apart. */
static SEPARATE model_status evaluate_points(const function_shape *f, function_one one,
    function_lanes evaluate, const real *const *in, real *const *out, int n, int stride,
    real *work)
{
    int written = 0, missing = work == NULL, bad = 0;
    for (int i = 0; i < f->inputs; ++i) {
        missing |= in[i] == NULL;
    }
    for (int i = 0; i < f->outputs; ++i) {
        missing |= out[i] == NULL;
        written += f->sizes[f->inputs + i];
    }
    if (n < 0 || stride < n) {
        return MODEL_BAD_COUNT;
    }
    if (missing) {
        return MODEL_NULL_ARGUMENT;
    }
    {
        /*
         * Arrays are copied where columns of results share the same cache lines or do not fit the
         * cache, and for the last points.
         */
        const int past = (size_t)n * sizeof(real) > (size_t)(CACHE / written);
        const int aligned = (size_t)stride * sizeof(real) % 1024 == 0;
        const int collide = past || (written > WAYS && n > f->tile && aligned);
        /* points that are faster one by one than in lanes */
        const int few = f->work > 0 ? LANES * 3 / 4 : LANES / 2;
        const int rest = n % LANES <= few ? n % LANES : 0;
        const int end = n - rest;
        const int groups = end / f->tile + (end % f->tile != 0);
#ifdef _OPENMP
#pragma omp parallel reduction(+ : bad) if (groups > 8 && omp_get_level() == 0)
#endif
        {
#ifdef _OPENMP
            real *const space = work + omp_get_thread_num() * (ptrdiff_t)MODEL_BATCH_WORK;
#else
            real *const space = work;
#endif
            lanes zero = splat_v(0);
            int group;
#ifdef _OPENMP
#pragma omp for schedule(static)
#endif
            for (group = 0; group < groups; ++group) {
                const int first = group * f->tile;
                const int count = end - first < f->tile ? end - first : f->tile;
                const int copied = collide || count % LANES != 0;
                zero += evaluate_tile(
                    f, evaluate, in, out, first, count, stride, copied, past, space);
            }
            end_scatter(past);
            bad += sum_v(zero) == 0 ? 0 : 1;
        }
        for (int k = end; k < n; ++k) {
            bad += evaluate_point(f, one, in, out, k, stride, work) != 0;
        }
    }
    return bad == 0 ? MODEL_OK : first_failed(f, in, out, n, stride);
}

#endif
