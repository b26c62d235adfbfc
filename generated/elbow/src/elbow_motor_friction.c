/* elbow: motor_friction. Written by flexgen; see elbow.h. */
#include "../elbow_batch.h"

#include "elbow_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "elbow_point.h"
#include "elbow_motor_friction_body.h"

#include "elbow_lanes.h"
#include "elbow_motor_friction_body.h"

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE elbow_status motor_friction_failed(const real *v_m, real *f_m, int n, ptrdiff_t stride)
{
    elbow_status first = ELBOW_OK;
    for (int k = 0; k < n; ++k) {
        const int known = all_finite(v_m + k, ELBOW_NM, stride);
        if (known && all_finite(f_m + k, ELBOW_NM, stride)) {
            continue;
        }
        if (first == ELBOW_OK) {
            first = known ? ELBOW_RESULT_NOT_FINITE : ELBOW_INPUT_NOT_FINITE;
        }
        set_nan(f_m + k, ELBOW_NM, stride);
    }
    return first;
}

elbow_status elbow_motor_friction(const elbow_real v_m[ELBOW_NM], elbow_real f_m[ELBOW_NM])
{
    if (v_m == NULL || f_m == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (motor_friction_evaluate_1(v_m, f_m) == 0) {
        return ELBOW_OK;
    }
    return motor_friction_failed(v_m, f_m, 1, 1);
}

/* Points of arrays whose entries are `stride` apart. */
static SEPARATE elbow_status motor_friction_many(int n, int stride, const elbow_real *v_m, elbow_real *f_m, elbow_real *work)
{
    /* Arrays are copied where columns of results share the same cache lines or do not fit the cache, and for the last
       points. */
    const int past = (size_t)n * sizeof(real) > 4194304;
    const int collide = past;
    const int groups = n < 0 ? 0 : n / 64 + (n % 64 != 0);
    int bad = 0;
    if (n < 0) {
        return ELBOW_BAD_COUNT;
    }
    if (v_m == NULL || f_m == NULL || work == NULL) {
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
            const real *at_v_m = v_m + first;
            real *at_f_m = f_m + first;
            if (copied) {
                real *at = space + 0 * LANES;
                apart = 64;
                gather_points(at_v_m, ELBOW_NM, count, stride, at, 64);
                at_v_m = at;
                at += ELBOW_NM * 64;
                at_f_m = at;
            }
            for (int k = 0; k < count; k += LANES) {
                zero += motor_friction_evaluate_v(at_v_m + k, at_f_m + k, apart);
            }
            if (copied) {
                scatter_points(at_f_m, ELBOW_NM, count, 64, f_m + first, stride, past);
            }
        }
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }
    return bad == 0 ? ELBOW_OK : motor_friction_failed(v_m, f_m, n, stride);
}

elbow_status elbow_motor_friction_batch(int n, const elbow_real *v_m, elbow_real *f_m, elbow_real *work)
{
    return motor_friction_many(n, n, v_m, f_m, work);
}

elbow_status elbow_motor_friction_batch_strided(int n, int stride, const elbow_real *v_m, elbow_real *f_m,
    elbow_real *work)
{
    return stride < n ? ELBOW_BAD_COUNT : motor_friction_many(n, stride, v_m, f_m, work);
}

#include "elbow_undefine.h"
