/*
 * model: the entry points of an emitted function, for one point and for many; included at the end of its source,
 * without an include guard. Written by flexgen; see model.h.
 *
 * The source defines NAME(suffix), names of private functions; SINGLE, the name of the public function for one point,
 * with which the other names begin; ARRAYS(INPUT, SHARED, OUTPUT, LAST), which applies a macro to the name and the size
 * of each argument, LAST to the last output; WORK, lanes of workspace of the mathematics; TILE, points that are copied
 * together; and RESULTS, numbers of results of a point.
 */
#ifdef _OPENMP
#include <omp.h>
#endif

#define CACHE 8388608 /* bytes of results that are written past the cache */
#define WAYS 24 /* lines that a set of the first cache may hold, about: more results at once push each other out */

#define JOINED(name, suffix) name##suffix
#define PUBLIC(name, suffix) JOINED(name, suffix)
#define NOTHING(x, size)
#define INPUT_ARGUMENT(x, size) const real *x,
#define OUTPUT_ARGUMENT(x, size) real *x,
#define PASS(x, size) x,
#define IS_NULL_OR(x, size) x == NULL ||
#define IS_FINITE_AND(x, size) all_finite(x + k, size, stride) &&
#define IS_FINITE_ONCE_AND(x, size) all_finite(x, size, 1) &&
#define SET_NAN(x, size) set_nan(x + k, size, stride);
#define INPUT_AT(x, size) const real *at_##x = x + first;
#define OUTPUT_AT(x, size) real *at_##x = x + first;
#define PASS_AT(x, size) at_##x + k,
#define GATHER(x, size) \
    gather_points(at_##x, size, count, stride, at, TILE); \
    at_##x = at; \
    at += (size) * TILE;
#define PLACE(x, size) \
    at_##x = at; \
    at += (size) * TILE;
#define SCATTER(x, size) scatter_points(at_##x, size, count, TILE, x + first, stride, past);
#define TAKE(x, size) \
    const real *const at_##x = at; \
    for (int i = 0; i < (size); ++i) { \
        at[i] = x[i * stride + k]; \
    } \
    at += size;
#define RESERVE(x, size) \
    real *const at_##x = at; \
    at += size;
#define GIVE(x, size) \
    for (int i = 0; i < (size); ++i) { \
        x[i * stride + k] = at_##x[i]; \
    }
#define INPUT_OF_SIZE(x, size) const real x[size],
#define OUTPUT_OF_SIZE(x, size) real x[size],
#define PASS_COPY(x, size) at_##x,
#if WORK > 0
#define PASS_WORK (lanes *)space,
#define LAST_OF_SIZE(x, size) real x[size], real *work
#define LAST_IS_NULL(x, size) x == NULL || work == NULL
#define PASS_LAST(x, size) x, work
#define PASS_LAST_COPY(x, size) at_##x, work
#else
#define PASS_WORK
#define LAST_OF_SIZE(x, size) real x[size]
#define LAST_IS_NULL(x, size) x == NULL
#define PASS_LAST(x, size) x
#define PASS_LAST_COPY(x, size) at_##x
#endif

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE model_status NAME(failed)(
    ARRAYS(INPUT_ARGUMENT, INPUT_ARGUMENT, OUTPUT_ARGUMENT, OUTPUT_ARGUMENT) int n, ptrdiff_t stride)
{
    model_status first = MODEL_OK;
    for (int k = 0; k < n; ++k) {
        const int known = ARRAYS(IS_FINITE_AND, IS_FINITE_ONCE_AND, NOTHING, NOTHING) 1;
        if (known && ARRAYS(NOTHING, NOTHING, IS_FINITE_AND, IS_FINITE_AND) 1) {
            continue;
        }
        if (first == MODEL_OK) {
            first = known ? MODEL_RESULT_NOT_FINITE : MODEL_INPUT_NOT_FINITE;
        }
        ARRAYS(NOTHING, NOTHING, SET_NAN, SET_NAN)
    }
    return first;
}

/* Point k by the function for one point; 1 where it fails. */
static SEPARATE int NAME(point)(
    int k, ptrdiff_t stride, ARRAYS(INPUT_ARGUMENT, INPUT_ARGUMENT, OUTPUT_ARGUMENT, OUTPUT_ARGUMENT) real *work)
{
    real *at = work + WORK * LANES;
    ARRAYS(TAKE, NOTHING, RESERVE, RESERVE)
    const int bad = SINGLE(ARRAYS(PASS_COPY, PASS, PASS_COPY, PASS_LAST_COPY)) != 0;
    ARRAYS(NOTHING, NOTHING, GIVE, GIVE)
    return bad;
}

/* Points of arrays whose entries are `stride` apart. */
static SEPARATE model_status NAME(many)(
    int n, int stride, ARRAYS(INPUT_ARGUMENT, INPUT_ARGUMENT, OUTPUT_ARGUMENT, OUTPUT_ARGUMENT) real *work)
{
    /* Arrays are copied where columns of results share the same cache lines or do not fit the cache, and for the last
       points. */
    const int past = (size_t)n * sizeof(real) > CACHE / RESULTS;
    const int collide = past || (RESULTS > WAYS && n > TILE && (size_t)stride * sizeof(real) % 1024 == 0);
    const int few = WORK > 0 ? LANES * 3 / 4 : LANES / 2; /* points that are faster one by one than in lanes */
    const int rest = n % LANES <= few ? n % LANES : 0;
    const int end = n - rest;
    const int groups = n < 0 ? 0 : end / TILE + (end % TILE != 0);
    int bad = 0;
    if (n < 0) {
        return MODEL_BAD_COUNT;
    }
    if (ARRAYS(IS_NULL_OR, IS_NULL_OR, IS_NULL_OR, IS_NULL_OR) work == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
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
            const int first = group * TILE;
            const int count = end - first < TILE ? end - first : TILE;
            const int copied = collide || count % LANES != 0;
            ptrdiff_t apart = stride;
            ARRAYS(INPUT_AT, NOTHING, OUTPUT_AT, OUTPUT_AT)
            if (copied) {
                real *at = space + WORK * LANES;
                apart = TILE;
                ARRAYS(GATHER, NOTHING, PLACE, PLACE)
            }
            for (int k = 0; k < count; k += LANES) {
                zero += NAME(evaluate_v)(ARRAYS(PASS_AT, PASS, PASS_AT, PASS_AT) PASS_WORK apart);
            }
            if (copied) {
                ARRAYS(NOTHING, NOTHING, SCATTER, SCATTER)
            }
        }
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }
    for (int k = end; k < n; ++k) {
        bad += NAME(point)(k, stride, ARRAYS(PASS, PASS, PASS, PASS) work);
    }
    return bad == 0 ? MODEL_OK : NAME(failed)(ARRAYS(PASS, PASS, PASS, PASS) n, stride);
}

model_status PUBLIC(SINGLE, _batch)(
    int n, ARRAYS(INPUT_ARGUMENT, INPUT_ARGUMENT, OUTPUT_ARGUMENT, OUTPUT_ARGUMENT) real *work)
{
    return NAME(many)(n, n, ARRAYS(PASS, PASS, PASS, PASS) work);
}

model_status PUBLIC(SINGLE, _batch_strided)(
    int n, int stride, ARRAYS(INPUT_ARGUMENT, INPUT_ARGUMENT, OUTPUT_ARGUMENT, OUTPUT_ARGUMENT) real *work)
{
    return stride < n ? MODEL_BAD_COUNT : NAME(many)(n, stride, ARRAYS(PASS, PASS, PASS, PASS) work);
}

model_status SINGLE(ARRAYS(INPUT_OF_SIZE, INPUT_OF_SIZE, OUTPUT_OF_SIZE, LAST_OF_SIZE))
{
    if (ARRAYS(IS_NULL_OR, IS_NULL_OR, IS_NULL_OR, LAST_IS_NULL)) {
        return MODEL_NULL_ARGUMENT;
    }
    if (NAME(evaluate_1)(ARRAYS(PASS, PASS, PASS, PASS_LAST)) == 0) {
        return MODEL_OK;
    }
    return NAME(failed)(ARRAYS(PASS, PASS, PASS, PASS) 1, 1);
}
