/* elbow: arm_forward_derivatives. Written by flexgen; see elbow.h. */
#include "../elbow_batch.h"

#include "elbow_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "elbow_point.h"
#include "elbow_arm_forward_derivatives_body.h"

#include "elbow_lanes.h"
#include "elbow_arm_forward_derivatives_body.h"

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE elbow_status arm_forward_derivatives_failed(const real *q_a, const real *v_a, const real *tau_a, real *da_dq, real *da_dv, real *da_dtau, int n, ptrdiff_t stride)
{
    elbow_status first = ELBOW_OK;
    for (int k = 0; k < n; ++k) {
        const int known = all_finite(q_a + k, ELBOW_NA, stride) && all_finite(v_a + k, ELBOW_NA, stride) && all_finite(tau_a + k, ELBOW_NA, stride);
        if (known && all_finite(da_dq + k, ELBOW_NA * ELBOW_NA, stride) && all_finite(da_dv + k, ELBOW_NA * ELBOW_NA, stride) && all_finite(da_dtau + k, ELBOW_NA * ELBOW_NA, stride)) {
            continue;
        }
        if (first == ELBOW_OK) {
            first = known ? ELBOW_RESULT_NOT_FINITE : ELBOW_INPUT_NOT_FINITE;
        }
        set_nan(da_dq + k, ELBOW_NA * ELBOW_NA, stride);
        set_nan(da_dv + k, ELBOW_NA * ELBOW_NA, stride);
        set_nan(da_dtau + k, ELBOW_NA * ELBOW_NA, stride);
    }
    return first;
}

elbow_status elbow_arm_forward_derivatives(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real tau_a[ELBOW_NA], elbow_real da_dq[ELBOW_NA * ELBOW_NA], elbow_real da_dv[ELBOW_NA * ELBOW_NA],
    elbow_real da_dtau[ELBOW_NA * ELBOW_NA], elbow_real *work)
{
    if (q_a == NULL || v_a == NULL || tau_a == NULL || da_dq == NULL || da_dv == NULL || da_dtau == NULL || work == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (arm_forward_derivatives_evaluate_1(q_a, v_a, tau_a, da_dq, da_dv, da_dtau, work) == 0) {
        return ELBOW_OK;
    }
    return arm_forward_derivatives_failed(q_a, v_a, tau_a, da_dq, da_dv, da_dtau, 1, 1);
}

/* Points of arrays whose entries are `stride` apart. */
static SEPARATE elbow_status arm_forward_derivatives_many(int n, int stride, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *tau_a, elbow_real *da_dq, elbow_real *da_dv, elbow_real *da_dtau, elbow_real *work)
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
    if (q_a == NULL || v_a == NULL || tau_a == NULL || da_dq == NULL || da_dv == NULL || da_dtau == NULL || work == NULL) {
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
            const real *at_tau_a = tau_a + first;
            real *at_da_dq = da_dq + first;
            real *at_da_dv = da_dv + first;
            real *at_da_dtau = da_dtau + first;
            if (copied) {
                real *at = space + 368 * LANES;
                apart = 64;
                gather_points(at_q_a, ELBOW_NA, count, stride, at, 64);
                at_q_a = at;
                at += ELBOW_NA * 64;
                gather_points(at_v_a, ELBOW_NA, count, stride, at, 64);
                at_v_a = at;
                at += ELBOW_NA * 64;
                gather_points(at_tau_a, ELBOW_NA, count, stride, at, 64);
                at_tau_a = at;
                at += ELBOW_NA * 64;
                at_da_dq = at;
                at += ELBOW_NA * ELBOW_NA * 64;
                at_da_dv = at;
                at += ELBOW_NA * ELBOW_NA * 64;
                at_da_dtau = at;
            }
            for (int k = 0; k < count; k += LANES) {
                zero += arm_forward_derivatives_evaluate_v(at_q_a + k, at_v_a + k, at_tau_a + k, at_da_dq + k, at_da_dv + k, at_da_dtau + k, (lanes *)space, apart);
            }
            if (copied) {
                scatter_points(at_da_dq, ELBOW_NA * ELBOW_NA, count, 64, da_dq + first, stride, past);
                scatter_points(at_da_dv, ELBOW_NA * ELBOW_NA, count, 64, da_dv + first, stride, past);
                scatter_points(at_da_dtau, ELBOW_NA * ELBOW_NA, count, 64, da_dtau + first, stride, past);
            }
        }
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }
    return bad == 0 ? ELBOW_OK : arm_forward_derivatives_failed(q_a, v_a, tau_a, da_dq, da_dv, da_dtau, n, stride);
}

elbow_status elbow_arm_forward_derivatives_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *tau_a, elbow_real *da_dq, elbow_real *da_dv, elbow_real *da_dtau, elbow_real *work)
{
    return arm_forward_derivatives_many(n, n, q_a, v_a, tau_a, da_dq, da_dv, da_dtau, work);
}

elbow_status elbow_arm_forward_derivatives_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *tau_a, elbow_real *da_dq, elbow_real *da_dv, elbow_real *da_dtau,
    elbow_real *work)
{
    return stride < n ? ELBOW_BAD_COUNT : arm_forward_derivatives_many(n, stride, q_a, v_a, tau_a, da_dq, da_dv, da_dtau, work);
}

#include "elbow_undefine.h"
