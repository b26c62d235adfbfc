/*
 * Inverse kinematics of panda with random, damaged and impossible arguments; prints how often each
 * status came.
 */
#include "panda_inverse_kinematics.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { CALLS = 4000, NA = PANDA_NA };

static uint64_t state = 88172645463325252U;

static double uniform(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) / 9007199254740992.0;
}

/* A number, or now and then something else. */
static double odd(double x)
{
    static const double others[] = {(double)NAN, (double)INFINITY, -1e308, 1e7, 5e-324};
    const int k = (int)(40.0 * uniform());
    return k < 5 ? others[k] : x;
}

static double *numbers(int count)
{
    /* as small as it may be, for the sanitizer */
    double *x = malloc((size_t)count * sizeof(double));
    if (x == NULL) {
        exit(9);
    }
    return x;
}

/* Whether all configurations are at the pose. */
static int right(const double *found, int count, const double *p, const double *R)
{
    for (int k = 0; k < count; ++k) {
        double at[3], turned[9];
        if (panda_forward_kinematics(found + k * NA, at, turned) != PANDA_OK) {
            return 0;
        }
        for (int i = 0; i < 9; ++i) { /* a rotation is accepted up to 1e-6 */
            if (!(fabs(at[i % 3] - p[i % 3]) < 1e-10 && fabs(turned[i] - R[i]) < 1e-5)) {
                return 0;
            }
        }
    }
    return 1;
}

static int one_call(long *seen)
{
    const int64_t size = panda_inverse_kinematics_work();
    const int most = 1 + (int)(16.0 * uniform()), kind = (int)(6.0 * uniform());
    double *work = numbers((int)size), *p = numbers(3), *R = numbers(9), *q = numbers(NA),
           *start = numbers(NA);
    double *found = numbers(most * NA);
    int joints[6] = {0, 1, 3, 4, 5, 6}, count = -1, status, good;
    for (int i = 0; i < NA; ++i) {
        q[i] = 6.28 * uniform() - 3.14;
        start[i] = odd(6.28 * uniform() - 3.14);
    }
    q[5] = kind == 3 ? 0.0 : q[5];
    good = panda_forward_kinematics(q, p, R) == PANDA_OK;
    for (int i = 0; i < 9; ++i) {
        p[i % 3] = kind == 0 ? odd(2.0 * p[i % 3]) : p[i % 3];
        R[i] = kind == 1 ? odd(R[i]) : R[i];
    }
    joints[5] = kind == 2 ? (int)(400.0 * uniform()) - 200 : joints[5];
    status = panda_inverse_kinematics(
        p, R, start, joints, kind == 4 ? 1 : 200, most, found, &count, work, size);
    seen[status + 20] += 1;
    good = good && (status == PANDA_OK ? count >= 1 && count <= 16 : count == 0);
    good = good && (status != PANDA_OK || right(found, count < most ? count : most, p, R));
    free(work);
    free(p);
    free(R);
    free(q);
    free(start);
    free(found);
    return good;
}

int main(void)
{
    long seen[40] = {0};
    for (int call = 0; call < CALLS; ++call) {
        if (!one_call(seen)) {
            printf("call %d is wrong\n", call);
            return 1;
        }
    }
    for (int i = 0; i < 40; ++i) {
        if (seen[i] > 0) {
            printf("%d %ld\n", i - 20, seen[i]);
        }
    }
    return 0;
}
