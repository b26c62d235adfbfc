/* elbow: jacobian. Written by flexgen; see elbow.h. */
#include "../elbow_batch.h"

#include "elbow_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "elbow_point.h"
#include "elbow_jacobian_body.h"

#include "elbow_lanes.h"
#include "elbow_jacobian_body.h"

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE elbow_status jacobian_failed(const real *q_a, real *J, int n, ptrdiff_t stride)
{
    elbow_status first = ELBOW_OK;
    for (int k = 0; k < n; ++k) {
        const int known = all_finite(q_a + k, ELBOW_NA, stride);
        if (known && all_finite(J + k, 6 * ELBOW_NA, stride)) {
            continue;
        }
        if (first == ELBOW_OK) {
            first = known ? ELBOW_RESULT_NOT_FINITE : ELBOW_INPUT_NOT_FINITE;
        }
        set_nan(J + k, 6 * ELBOW_NA, stride);
    }
    return first;
}

elbow_status elbow_jacobian(const elbow_real q_a[ELBOW_NA], elbow_real J[6 * ELBOW_NA])
{
    if (q_a == NULL || J == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (jacobian_evaluate_1(q_a, J) == 0) {
        return ELBOW_OK;
    }
    return jacobian_failed(q_a, J, 1, 1);
}

/* Points of arrays whose entries are `stride` apart. */
static SEPARATE elbow_status jacobian_many(int n, int stride, const elbow_real *q_a, elbow_real *J, elbow_real *work)
{
    /* Arrays are copied where columns of results share the same cache lines or do not fit the cache, and for the last
       points. */
    const int past = (size_t)n * sizeof(real) > 699050;
    const int collide = past;
    const int groups = n < 0 ? 0 : n / 64 + (n % 64 != 0);
    int bad = 0;
    if (n < 0) {
        return ELBOW_BAD_COUNT;
    }
    if (q_a == NULL || J == NULL || work == NULL) {
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
            real *at_J = J + first;
            if (copied) {
                real *at = space + 0 * LANES;
                apart = 64;
                gather_points(at_q_a, ELBOW_NA, count, stride, at, 64);
                at_q_a = at;
                at += ELBOW_NA * 64;
                at_J = at;
            }
            for (int k = 0; k < count; k += LANES) {
                zero += jacobian_evaluate_v(at_q_a + k, at_J + k, apart);
            }
            if (copied) {
                scatter_points(at_J, 6 * ELBOW_NA, count, 64, J + first, stride, past);
            }
        }
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }
    return bad == 0 ? ELBOW_OK : jacobian_failed(q_a, J, n, stride);
}

elbow_status elbow_jacobian_batch(int n, const elbow_real *q_a, elbow_real *J, elbow_real *work)
{
    return jacobian_many(n, n, q_a, J, work);
}

elbow_status elbow_jacobian_batch_strided(int n, int stride, const elbow_real *q_a, elbow_real *J, elbow_real *work)
{
    return stride < n ? ELBOW_BAD_COUNT : jacobian_many(n, stride, q_a, J, work);
}

#include "elbow_undefine.h"
