/* elbow: forward_dynamics_tool_force. Written by flexgen; see elbow.h. */
#include "../elbow_batch.h"

#include "elbow_private.h"

#ifdef _OPENMP
#include <omp.h>
#endif

#include "elbow_point.h"
#include "elbow_forward_dynamics_tool_force_body.h"

#include "elbow_lanes.h"
#include "elbow_forward_dynamics_tool_force_body.h"

/* Status of the first of n points that failed; the results of all that did become NaN. */
static SEPARATE elbow_status forward_dynamics_tool_force_failed(const real *q_a, const real *v_a, const real *q_m, const real *v_m, const real *tau_m, const real *f_tool, real *a_a, real *a_m, real *tau_g, int n, ptrdiff_t stride)
{
    elbow_status first = ELBOW_OK;
    for (int k = 0; k < n; ++k) {
        const int known = all_finite(q_a + k, ELBOW_NA, stride) && all_finite(v_a + k, ELBOW_NA, stride) && all_finite(q_m + k, ELBOW_NM, stride) && all_finite(v_m + k, ELBOW_NM, stride) && all_finite(tau_m + k, ELBOW_NM, stride) && all_finite(f_tool + k, 6, stride);
        if (known && all_finite(a_a + k, ELBOW_NA, stride) && all_finite(a_m + k, ELBOW_NM, stride) && all_finite(tau_g + k, ELBOW_NG, stride)) {
            continue;
        }
        if (first == ELBOW_OK) {
            first = known ? ELBOW_RESULT_NOT_FINITE : ELBOW_INPUT_NOT_FINITE;
        }
        set_nan(a_a + k, ELBOW_NA, stride);
        set_nan(a_m + k, ELBOW_NM, stride);
        set_nan(tau_g + k, ELBOW_NG, stride);
    }
    return first;
}

elbow_status elbow_forward_dynamics_tool_force(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real q_m[ELBOW_NM], const elbow_real v_m[ELBOW_NM], const elbow_real tau_m[ELBOW_NM],
    const elbow_real f_tool[6], elbow_real a_a[ELBOW_NA], elbow_real a_m[ELBOW_NM], elbow_real tau_g[ELBOW_NG])
{
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || f_tool == NULL || a_a == NULL || a_m == NULL || tau_g == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (forward_dynamics_tool_force_evaluate_1(q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m, tau_g) == 0) {
        return ELBOW_OK;
    }
    return forward_dynamics_tool_force_failed(q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m, tau_g, 1, 1);
}

/* Points of arrays whose entries are `stride` apart. */
static SEPARATE elbow_status forward_dynamics_tool_force_many(int n, int stride, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m, const elbow_real *f_tool,
    elbow_real *a_a, elbow_real *a_m, elbow_real *tau_g, elbow_real *work)
{
    /* Arrays are copied where columns of results share the same cache lines or do not fit the cache, and for the last
       points. */
    const int past = (size_t)n * sizeof(real) > 1398101;
    const int collide = past;
    const int groups = n < 0 ? 0 : n / 64 + (n % 64 != 0);
    int bad = 0;
    if (n < 0) {
        return ELBOW_BAD_COUNT;
    }
    if (q_a == NULL || v_a == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || f_tool == NULL || a_a == NULL || a_m == NULL || tau_g == NULL || work == NULL) {
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
            const real *at_f_tool = f_tool + first;
            real *at_a_a = a_a + first;
            real *at_a_m = a_m + first;
            real *at_tau_g = tau_g + first;
            if (copied) {
                real *at = space + 0 * LANES;
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
                gather_points(at_f_tool, 6, count, stride, at, 64);
                at_f_tool = at;
                at += 6 * 64;
                at_a_a = at;
                at += ELBOW_NA * 64;
                at_a_m = at;
                at += ELBOW_NM * 64;
                at_tau_g = at;
            }
            for (int k = 0; k < count; k += LANES) {
                zero += forward_dynamics_tool_force_evaluate_v(at_q_a + k, at_v_a + k, at_q_m + k, at_v_m + k, at_tau_m + k, at_f_tool + k, at_a_a + k, at_a_m + k, at_tau_g + k, apart);
            }
            if (copied) {
                scatter_points(at_a_a, ELBOW_NA, count, 64, a_a + first, stride, past);
                scatter_points(at_a_m, ELBOW_NM, count, 64, a_m + first, stride, past);
                scatter_points(at_tau_g, ELBOW_NG, count, 64, tau_g + first, stride, past);
            }
        }
        end_scatter(past);
        bad += sum_v(zero) == 0 ? 0 : 1;
    }
    return bad == 0 ? ELBOW_OK : forward_dynamics_tool_force_failed(q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m, tau_g, n, stride);
}

elbow_status elbow_forward_dynamics_tool_force_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m, const elbow_real *f_tool,
    elbow_real *a_a, elbow_real *a_m, elbow_real *tau_g, elbow_real *work)
{
    return forward_dynamics_tool_force_many(n, n, q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m, tau_g, work);
}

elbow_status elbow_forward_dynamics_tool_force_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *q_m, const elbow_real *v_m, const elbow_real *tau_m,
    const elbow_real *f_tool, elbow_real *a_a, elbow_real *a_m, elbow_real *tau_g, elbow_real *work)
{
    return stride < n ? ELBOW_BAD_COUNT : forward_dynamics_tool_force_many(n, stride, q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m, tau_g, work);
}

#include "elbow_undefine.h"
