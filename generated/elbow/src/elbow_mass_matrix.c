/* elbow: mass_matrix. Written by flexgen; see elbow.h. */
#include "elbow_function.h"

#include "elbow_point.h"
#include "elbow_mass_matrix_math.h"

#include "elbow_lanes.h"
#include "elbow_mass_matrix_math.h"

#include "elbow_undefine.h"

static const function_shape mass_matrix_shape = {
    1, 1, -1, 0, 64, {2, 2 * 2}};

static lanes mass_matrix_lanes(const real *const *in, real *const *out, lanes *work, int count,
    ptrdiff_t n)
{
    lanes zero = splat_v(0);
    (void)work;
    for (int k = 0; k < count; k += LANES) {
        zero += mass_matrix_evaluate_v(in[0] + k, out[0] + k, n);
    }
    return zero;
}

elbow_status elbow_mass_matrix(const elbow_real q_a[ELBOW_NA], elbow_real M[ELBOW_NA * ELBOW_NA])
{
    if (q_a == NULL || M == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (mass_matrix_evaluate_1(q_a, M) == 0) {
        return ELBOW_OK;
    }
    {
        const real *const in[] = {q_a};
        real *const out[] = {M};
        return first_failed(&mass_matrix_shape, in, out, 1, 1);
    }
}

static int mass_matrix_one(const real *const *in, real *const *out, real *work)
{
    (void)work;
    return elbow_mass_matrix(in[0], out[0]) != ELBOW_OK;
}

elbow_status elbow_mass_matrix_batch_strided(int n, int stride, const elbow_real *q_a,
    elbow_real *M, elbow_real *work)
{
    const real *const in[] = {q_a};
    real *const out[] = {M};
    return evaluate_points(&mass_matrix_shape, mass_matrix_one, mass_matrix_lanes, in, out, n,
        stride, work);
}

elbow_status elbow_mass_matrix_batch(int n, const elbow_real *q_a, elbow_real *M,
    elbow_real *work)
{
    return elbow_mass_matrix_batch_strided(n, n, q_a, M, work);
}
