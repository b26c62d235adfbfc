/* elbow: gear_law. Written by flexgen; see elbow.h. */
#include "../elbow_batch.h"

#include "elbow_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "elbow_point.h"
#include "elbow_gear_law_body.h"

#include "elbow_lanes.h"
#include "elbow_gear_law_body.h"

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE elbow_status gear_law_failed(const real *deflection, real *tau_p, real *dtau_p, int n, ptrdiff_t stride)
{
    elbow_status first = ELBOW_OK;
    for (int k = 0; k < n; ++k) {
        const int known = all_finite(deflection + k, ELBOW_NG, stride);
        if (known && all_finite(tau_p + k, ELBOW_NG, stride) && all_finite(dtau_p + k, ELBOW_NG, stride)) {
            continue;
        }
        if (first == ELBOW_OK) {
            first = known ? ELBOW_RESULT_NOT_FINITE : ELBOW_INPUT_NOT_FINITE;
        }
        set_nan(tau_p + k, ELBOW_NG, stride);
        set_nan(dtau_p + k, ELBOW_NG, stride);
    }
    return first;
}

elbow_status elbow_gear_law(const elbow_real deflection[ELBOW_NG], elbow_real tau_p[ELBOW_NG],
    elbow_real dtau_p[ELBOW_NG])
{
    if (deflection == NULL || tau_p == NULL || dtau_p == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (gear_law_evaluate_1(deflection, tau_p, dtau_p) == 0) {
        return ELBOW_OK;
    }
    return gear_law_failed(deflection, tau_p, dtau_p, 1, 1);
}

/* Points of arrays whose entries are `stride` apart. */
static SEPARATE elbow_status gear_law_many(int n, int stride, const elbow_real *deflection, elbow_real *tau_p, elbow_real *dtau_p,
    elbow_real *work)
{
    /* Arrays are copied where columns of results share the same cache lines or do not fit the cache, and for the last
       points. */
    const int past = (size_t)n * sizeof(real) > 2097152;
    const int collide = past;
    const int groups = n < 0 ? 0 : n / 64 + (n % 64 != 0);
    int bad = 0;
    if (n < 0) {
        return ELBOW_BAD_COUNT;
    }
    if (deflection == NULL || tau_p == NULL || dtau_p == NULL || work == NULL) {
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
            const real *at_deflection = deflection + first;
            real *at_tau_p = tau_p + first;
            real *at_dtau_p = dtau_p + first;
            if (copied) {
                real *at = space + 0 * LANES;
                apart = 64;
                gather_points(at_deflection, ELBOW_NG, count, stride, at, 64);
                at_deflection = at;
                at += ELBOW_NG * 64;
                at_tau_p = at;
                at += ELBOW_NG * 64;
                at_dtau_p = at;
            }
            for (int k = 0; k < count; k += LANES) {
                zero += gear_law_evaluate_v(at_deflection + k, at_tau_p + k, at_dtau_p + k, apart);
            }
            if (copied) {
                scatter_points(at_tau_p, ELBOW_NG, count, 64, tau_p + first, stride, past);
                scatter_points(at_dtau_p, ELBOW_NG, count, 64, dtau_p + first, stride, past);
            }
        }
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }
    return bad == 0 ? ELBOW_OK : gear_law_failed(deflection, tau_p, dtau_p, n, stride);
}

elbow_status elbow_gear_law_batch(int n, const elbow_real *deflection, elbow_real *tau_p, elbow_real *dtau_p,
    elbow_real *work)
{
    return gear_law_many(n, n, deflection, tau_p, dtau_p, work);
}

elbow_status elbow_gear_law_batch_strided(int n, int stride, const elbow_real *deflection, elbow_real *tau_p,
    elbow_real *dtau_p, elbow_real *work)
{
    return stride < n ? ELBOW_BAD_COUNT : gear_law_many(n, stride, deflection, tau_p, dtau_p, work);
}

#include "elbow_undefine.h"
