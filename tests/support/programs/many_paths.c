/*
 * Inverts paths with invert_many and one by one, all arrays in heap blocks of the exact size;
 * compares bits.
 */
#include "planar5_nmp_inversion.h"

#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { N = 61, PRE = 40, POST = 30, TOTAL = PRE + N + POST, COUNT = 4 };

static double *block(size_t numbers)
{
    double *x = malloc(numbers * sizeof *x);
    if (x == NULL) {
        abort();
    }
    return x;
}

static int same(const void *a, const void *b, size_t bytes)
{
    return memcmp(a, b, bytes) == 0;
}

/*
 * Standard input: y, dy and ddy of COUNT paths and their q_start; the path of problem 2 is out of
 * reach.
 */
int main(void)
{
    double *y = block(COUNT * N * 2), *dy = block(COUNT * N * 2), *ddy = block(COUNT * N * 2);
    double *q_start = block(COUNT * PLANAR5_NMP_NA), *many = block(COUNT * TOTAL * 2),
           *one = block(TOTAL * 2);
    double *q_a = block(COUNT * TOTAL * PLANAR5_NMP_NA);
    planar5_nmp_invert_info *info = malloc(COUNT * sizeof *info), single;
    planar5_nmp_status *statuses = malloc(COUNT * sizeof *statuses);
    planar5_nmp_inversion_options options = planar5_nmp_inversion_defaults();
    planar5_nmp_samples samples = {N, 5e-3, y, dy, ddy};
    planar5_nmp_motion all = {NULL, NULL, NULL, NULL, NULL, NULL, NULL}, part = all;
    int64_t size;
    double *work;
    options.n_pre = PRE;
    options.n_post = POST;
    size = planar5_nmp_invert_work(N, &options);
    work = block((size_t)size);
    if (info == NULL || statuses == NULL ||
        fread(y, sizeof *y, COUNT * N * 2, stdin) != COUNT * N * 2 ||
        fread(dy, sizeof *dy, COUNT * N * 2, stdin) != COUNT * N * 2 ||
        fread(ddy, sizeof *ddy, COUNT * N * 2, stdin) != COUNT * N * 2 ||
        fread(q_start, sizeof *q_start, COUNT * PLANAR5_NMP_NA, stdin) != COUNT * PLANAR5_NMP_NA) {
        return 9;
    }
    all.tau_m = many;
    all.q_a = q_a;
    part.tau_m = one;
    for (int own = 0; own < 4; ++own) {
        const planar5_nmp_problems problems = {COUNT, own & 1, 0, own >> 1};
        const planar5_nmp_status first = planar5_nmp_invert_many(
            &problems, &samples, q_start, &options, &all, info, statuses, work, size);
        if (first != (own & 1 ? PLANAR5_NMP_UNREACHABLE : PLANAR5_NMP_OK)) {
            return 1;
        }
        for (int k = 0; k < COUNT; ++k) {
            const ptrdiff_t at = own & 1 ? k * N * 2 : 0;
            const planar5_nmp_samples path = {N, 5e-3, y + at, dy + at, ddy + at};
            const double *start = q_start + (own >> 1 ? k * PLANAR5_NMP_NA : 0);
            if (planar5_nmp_invert(&path, start, &options, &part, &single, work, size) !=
                statuses[k]) {
                return 2;
            }
            if (statuses[k] >= 0 && (!same(one, many + k * TOTAL * 2, TOTAL * 2 * sizeof *one) ||
                                        single.residual != info[k].residual)) {
                return 3;
            }
            for (int i = 0; i < TOTAL * 2; ++i) {
                if (isnan(many[k * TOTAL * 2 + i]) != (statuses[k] < 0)) {
                    return 4;
                }
            }
        }
    }
    {
        const planar5_nmp_problems none = {0, 1, 1, 1}, wrong = {-1, 0, 0, 0};
        const planar5_nmp_samples missing = {N, 5e-3, y, NULL, ddy};
#define CALL(problems, samples, size) \
    (int)planar5_nmp_invert_many( \
        problems, samples, q_start, &options, &all, info, statuses, work, size)
        printf("%d %d %d %d", CALL(&none, &samples, size), CALL(&wrong, &samples, size),
            CALL(NULL, &samples, size), CALL(&none, &samples, size - 1));
        printf(" %d", CALL(&none, &missing, size));
        samples.n = 1;
        printf(" %d\n", CALL(&none, &samples, size));
    }
    free(y);
    free(dy);
    free(ddy);
    free(q_start);
    free(many);
    free(one);
    free(q_a);
    free(info);
    free(statuses);
    free(work);
    return 0;
}
