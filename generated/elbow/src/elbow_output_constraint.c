/* elbow: output_constraint. Written by flexgen; see elbow.h. */
#include "../elbow_batch.h"

#include "elbow_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "elbow_point.h"
#include "elbow_output_constraint_body.h"

#include "elbow_lanes.h"
#include "elbow_output_constraint_body.h"

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE elbow_status output_constraint_failed(const real *q_a, const real *v_a, const real *target, real *y_err, real *W, real *Wdot_v, int n, ptrdiff_t stride)
{
    elbow_status first = ELBOW_OK;
    for (int k = 0; k < n; ++k) {
        const int known = all_finite(q_a + k, ELBOW_NA, stride) && all_finite(v_a + k, ELBOW_NA, stride) && all_finite(target + k, ELBOW_NT, stride);
        if (known && all_finite(y_err + k, ELBOW_NY, stride) && all_finite(W + k, ELBOW_NY * ELBOW_NA, stride) && all_finite(Wdot_v + k, ELBOW_NY, stride)) {
            continue;
        }
        if (first == ELBOW_OK) {
            first = known ? ELBOW_RESULT_NOT_FINITE : ELBOW_INPUT_NOT_FINITE;
        }
        set_nan(y_err + k, ELBOW_NY, stride);
        set_nan(W + k, ELBOW_NY * ELBOW_NA, stride);
        set_nan(Wdot_v + k, ELBOW_NY, stride);
    }
    return first;
}

elbow_status elbow_output_constraint(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real target[ELBOW_NT], elbow_real y_err[ELBOW_NY], elbow_real W[ELBOW_NY * ELBOW_NA],
    elbow_real Wdot_v[ELBOW_NY])
{
    if (q_a == NULL || v_a == NULL || target == NULL || y_err == NULL || W == NULL || Wdot_v == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (output_constraint_evaluate_1(q_a, v_a, target, y_err, W, Wdot_v) == 0) {
        return ELBOW_OK;
    }
    return output_constraint_failed(q_a, v_a, target, y_err, W, Wdot_v, 1, 1);
}

/* Points of arrays whose entries are `stride` apart. */
static SEPARATE elbow_status output_constraint_many(int n, int stride, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *target, elbow_real *y_err, elbow_real *W, elbow_real *Wdot_v, elbow_real *work)
{
    /* Arrays are copied where columns of results share the same cache lines or do not fit the cache, and for the last
       points. */
    const int past = (size_t)n * sizeof(real) > 1048576;
    const int collide = past;
    const int groups = n < 0 ? 0 : n / 64 + (n % 64 != 0);
    int bad = 0;
    if (n < 0) {
        return ELBOW_BAD_COUNT;
    }
    if (q_a == NULL || v_a == NULL || target == NULL || y_err == NULL || W == NULL || Wdot_v == NULL || work == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
#ifdef _OPENMP
#pragma omp parallel reduction(+ : bad) if (groups > 8 && omp_get_level() == 0)
#endif
    {
#ifdef _OPENMP
        real *const space = work + omp_get_thread_num() * (ptrdiff_t)ELBOW_BATCH_WORK;
#else
        real *const space = work;
#endif
        lanes zero = splat_v(0);
        int group;
#ifdef _OPENMP
#pragma omp for schedule(static)
#endif
        for (group = 0; group < groups; ++group) {
            const int first = group * 64;
            const int count = n - first < 64 ? n - first : 64;
            const int copied = collide || count % LANES != 0;
            ptrdiff_t apart = stride;
            const real *at_q_a = q_a + first;
            const real *at_v_a = v_a + first;
            const real *at_target = target + first;
            real *at_y_err = y_err + first;
            real *at_W = W + first;
            real *at_Wdot_v = Wdot_v + first;
            if (copied) {
                real *at = space + 0 * LANES;
                apart = 64;
                gather_points(at_q_a, ELBOW_NA, count, stride, at, 64);
                at_q_a = at;
                at += ELBOW_NA * 64;
                gather_points(at_v_a, ELBOW_NA, count, stride, at, 64);
                at_v_a = at;
                at += ELBOW_NA * 64;
                gather_points(at_target, ELBOW_NT, count, stride, at, 64);
                at_target = at;
                at += ELBOW_NT * 64;
                at_y_err = at;
                at += ELBOW_NY * 64;
                at_W = at;
                at += ELBOW_NY * ELBOW_NA * 64;
                at_Wdot_v = at;
            }
            for (int k = 0; k < count; k += LANES) {
                zero += output_constraint_evaluate_v(at_q_a + k, at_v_a + k, at_target + k, at_y_err + k, at_W + k, at_Wdot_v + k, apart);
            }
            if (copied) {
                scatter_points(at_y_err, ELBOW_NY, count, 64, y_err + first, stride, past);
                scatter_points(at_W, ELBOW_NY * ELBOW_NA, count, 64, W + first, stride, past);
                scatter_points(at_Wdot_v, ELBOW_NY, count, 64, Wdot_v + first, stride, past);
            }
        }
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }
    return bad == 0 ? ELBOW_OK : output_constraint_failed(q_a, v_a, target, y_err, W, Wdot_v, n, stride);
}

elbow_status elbow_output_constraint_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *target, elbow_real *y_err, elbow_real *W, elbow_real *Wdot_v, elbow_real *work)
{
    return output_constraint_many(n, n, q_a, v_a, target, y_err, W, Wdot_v, work);
}

elbow_status elbow_output_constraint_batch_strided(int n, int stride, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *target, elbow_real *y_err, elbow_real *W, elbow_real *Wdot_v, elbow_real *work)
{
    return stride < n ? ELBOW_BAD_COUNT : output_constraint_many(n, stride, q_a, v_a, target, y_err, W, Wdot_v, work);
}

#include "elbow_undefine.h"
