/* elbow: mass_matrix. Written by flexgen; see elbow.h. */
#ifndef T /* the file includes itself: the mathematics with T a number, and with T lanes of numbers */
#include "../elbow_batch.h"

#include "elbow_private.h"

#include "elbow_point.h"
#include "elbow_mass_matrix.c"

#include "elbow_lanes.h"
#include "elbow_mass_matrix.c"

#define NAME(suffix) mass_matrix_##suffix
#define PUBLIC(suffix) elbow_mass_matrix_##suffix
#define ARRAYS(INPUT, SHARED, OUTPUT) \
    INPUT(q_a, ELBOW_NA) OUTPUT(M, ELBOW_NA * ELBOW_NA)
#define WORK 0
#define SINGLE elbow_mass_matrix(at_q_a, at_M)
#define TILE 64
#define RESULTS 4
#define COLLIDE 0
#include "elbow_function.h"

elbow_status elbow_mass_matrix(const elbow_real q_a[ELBOW_NA], elbow_real M[ELBOW_NA * ELBOW_NA])
{
    if (q_a == NULL || M == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    return mass_matrix_evaluate_1(q_a, M) == 0 ? ELBOW_OK : mass_matrix_failed(q_a, M, 1, 1);
}

#include "elbow_undefine.h"
#else /* the mathematics */
static T F(mass_matrix_evaluate)(const real *RESTRICT q_a, real *RESTRICT M STRIDE(ptrdiff_t n))
{
    const T t0 = IN(q_a, 1);
    const T angle0[ANGLES(1)] = {t0};
    T sine0[ANGLES(1)], cosine0[ANGLES(1)];
    F(sincos)(angle0, sine0, cosine0, 1);
    const T t1 = sine0[0];
    const T t7 = 203.472375 * t1;
    const T t17 = 101.7361875 * t1;
    const T t14 = t7 - 496.00482796999995;
    OUT(M, 0, -t14);
    const T t19 = t17 - 89.77680625;
    OUT(M, 1, -t19);
    OUT(M, 2, -t19);
    OUT(M, 3, F(splat)(89.77680625));
    const T z21 = 0.0 * IN(q_a, 0) + 0.0 * t14;
    const T z22 = 0.0 * t19 + z21;
    return z22;
}
#endif
