/* elbow: linearize. Written by flexgen; see elbow.h. */
#include "../elbow_batch.h"

#include "elbow_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "elbow_point.h"
#include "elbow_linearize_body.h"

#include "elbow_lanes.h"
#include "elbow_linearize_body.h"

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE elbow_status linearize_failed(const real *q_a, const real *v_a, const real *q_m, const real *v_m, const real *tau_m, real *A, real *B, int n, ptrdiff_t stride)
{
    elbow_status first = ELBOW_OK;
    for (int k = 0; k < n; ++k) {
        const int known = all_finite(q_a + k, ELBOW_NA, stride) && all_finite(v_a + k, ELBOW_NA, stride) && all_finite(q_m + k, ELBOW_NM, stride) && all_finite(v_m + k, ELBOW_NM, stride) && all_finite(tau_m + k, ELBOW_NM, stride);
        if (known && all_finite(A + k, ELBOW_NX * ELBOW_NX, stride) && all_finite(B + k, ELBOW_NX * ELBOW_NM, stride)) {
            continue;
        }
        if (first == ELBOW_OK) {
            first = known ? ELBOW_RESULT_NOT_FINITE : ELBOW_INPUT_NOT_FINITE;
        }
        set_nan(A + k, ELBOW_NX * ELBOW_NX, stride);
        set_nan(B + k, ELBOW_NX * ELBOW_NM, stride);
    }
    return first;
}

elbow_status elbow_linearize(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM],
    elbow_real A[ELBOW_NX * ELBOW_NX], elbow_real B[ELBOW_NX * ELBOW_NM], elbow_real *work)
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || A == NULL || B == NULL || work == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (linearize_evaluate_1(q_a, v_a, q_m, v_m, tau_m, A, B, work) == 0) {
        return ELBOW_OK;
    }
    return linearize_failed(q_a, v_a, q_m, v_m, tau_m, A, B, 1, 1);
}

/* Points of arrays whose entries are `stride` apart. */
static SEPARATE elbow_status linearize_many(int n, int stride, const elbow_real *q_a, const elbow_real *v_a, const elbow_real *q_m,
    const elbow_real *v_m, const elbow_real *tau_m, elbow_real *A, elbow_real *B, elbow_real *work)
{
    /* Arrays are copied where columns of results share the same cache lines or do not fit the cache, and for the last
       points. */
    const int past = (size_t)n * sizeof(real) > 104857;
    const int collide = past || (n > 64 && (size_t)stride * sizeof(real) % 1024 == 0);
    const int groups = n < 0 ? 0 : n / 64 + (n % 64 != 0);
    int bad = 0;
    if (n < 0) {
        return ELBOW_BAD_COUNT;
    }
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || A == NULL || B == NULL || work == NULL) {
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
            const real *at_q_m = q_m + first;
            const real *at_v_m = v_m + first;
            const real *at_tau_m = tau_m + first;
            real *at_A = A + first;
            real *at_B = B + first;
            if (copied) {
                real *at = space + 704 * LANES;
                apart = 64;
                gather_points(at_q_a, ELBOW_NA, count, stride, at, 64);
                at_q_a = at;
                at += ELBOW_NA * 64;
                gather_points(at_v_a, ELBOW_NA, count, stride, at, 64);
                at_v_a = at;
                at += ELBOW_NA * 64;
                gather_points(at_q_m, ELBOW_NM, count, stride, at, 64);
                at_q_m = at;
                at += ELBOW_NM * 64;
                gather_points(at_v_m, ELBOW_NM, count, stride, at, 64);
                at_v_m = at;
                at += ELBOW_NM * 64;
                gather_points(at_tau_m, ELBOW_NM, count, stride, at, 64);
                at_tau_m = at;
                at += ELBOW_NM * 64;
                at_A = at;
                at += ELBOW_NX * ELBOW_NX * 64;
                at_B = at;
            }
            for (int k = 0; k < count; k += LANES) {
                zero += linearize_evaluate_v(at_q_a + k, at_v_a + k, at_q_m + k, at_v_m + k, at_tau_m + k, at_A + k, at_B + k, (lanes *)space, apart);
            }
            if (copied) {
                scatter_points(at_A, ELBOW_NX * ELBOW_NX, count, 64, A + first, stride, past);
                scatter_points(at_B, ELBOW_NX * ELBOW_NM, count, 64, B + first, stride, past);
            }
        }
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }
    return bad == 0 ? ELBOW_OK : linearize_failed(q_a, v_a, q_m, v_m, tau_m, A, B, n, stride);
}

elbow_status elbow_linearize_batch(int n, const elbow_real *q_a, const elbow_real *v_a, const elbow_real *q_m,
    const elbow_real *v_m, const elbow_real *tau_m, elbow_real *A, elbow_real *B, elbow_real *work)
{
    return linearize_many(n, n, q_a, v_a, q_m, v_m, tau_m, A, B, work);
}

elbow_status elbow_linearize_batch_strided(int n, int stride, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m, elbow_real *A, elbow_real *B,
    elbow_real *work)
{
    return stride < n ? ELBOW_BAD_COUNT : linearize_many(n, stride, q_a, v_a, q_m, v_m, tau_m, A, B, work);
}

#include "elbow_undefine.h"
