/* elbow: tool_motion. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_tool_motion_math.h"

#include "elbow_lanes.h"
#include "elbow_tool_motion_math.h"

#include "elbow_undefine.h"

static const function_shape tool_motion_shape = {
    3, 2, -1, 0, 64, {2, 2, 2, 6, 6}};

static lanes tool_motion_lanes(const real *const *in, real *const *out, lanes *work, int count,
    ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += tool_motion_evaluate_v(in[0] + k, in[1] + k, in[2] + k, out[0] + k, out[1] + k,
            n);
    }
    return zero;
}

elbow_status elbow_tool_motion(const elbow_real q_a[ELBOW_NA], const elbow_real v_a[ELBOW_NA],
    const elbow_real a_a[ELBOW_NA], elbow_real v_tool[6], elbow_real a_tool[6])
{
    if (q_a == NULL || v_a == NULL || a_a == NULL || v_tool == NULL || a_tool == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (tool_motion_evaluate_1(q_a, v_a, a_a, v_tool, a_tool) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a, v_a, a_a};
        real *const out[] = {v_tool, a_tool};
        return first_failed(&tool_motion_shape, in, out, 1, 1);
    }
}

static int tool_motion_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_tool_motion(in[0], in[1], in[2], out[0], out[1]) != ELBOW_OK;
}

elbow_status elbow_tool_motion_batch_strided(int n, int stride, const elbow_real *q_a,
    const elbow_real *v_a, const elbow_real *a_a, elbow_real *v_tool, elbow_real *a_tool,
    elbow_real *work)
{
    const real *const in[] = {q_a, v_a, a_a};
    real *const out[] = {v_tool, a_tool};
    return evaluate_points(&tool_motion_shape, tool_motion_one, tool_motion_lanes, in, out, n,
        stride, work);
}

elbow_status elbow_tool_motion_batch(int n, const elbow_real *q_a, const elbow_real *v_a,
    const elbow_real *a_a, elbow_real *v_tool, elbow_real *a_tool, elbow_real *work)
{
    return elbow_tool_motion_batch_strided(n, n, q_a, v_a, a_a, v_tool, a_tool, work);
}
