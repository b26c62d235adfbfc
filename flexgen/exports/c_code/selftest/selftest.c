/*
 * Self-test of the library on the computer that it runs on. Written by flexgen.
 *
 *   cc -std=c99 -O2 -ffp-contract=off model_selftest.c model.c@LIBM@ -o model_selftest &&
 *     ./model_selftest
 *
 * It calls every function of one point and, where the library has it, a stream along a path, and
 * compares the results with numbers that Lagrange's equations gave on another computer. It prints
 * PASS or FAIL and the largest error, and returns 0 or 1. It opens no file and allocates nothing.
 *
 * With MODEL_SELFTEST_NO_MAIN defined, model_selftest() is a function for a program of your own;
 * with MODEL_SELFTEST_NO_PRINT it prints nothing, and needs no stdio.h.
 */
#include "model.h"

#ifndef MODEL_SELFTEST_NO_PRINT
#include <stdio.h>
#endif

/* The largest error, what had it, and the number of wrong arrays. */
typedef struct {
    double largest; /* error, as a part of its tolerance */
    double error;
    double tolerance;
    const char *where;
    int arrays;
    int wrong;
} selftest_result;

static double magnitude(double x)
{
    return x < 0 ? -x : x;
}

static void account(selftest_result *result, const char *where, double error, double tolerance)
{
    const int bad = !(error <= tolerance);
    result->arrays += 1;
    result->wrong += bad;
    /* What is not a number is the largest, and stays it. */
    if (result->largest == result->largest && !(error / tolerance <= result->largest)) {
        result->largest = error / tolerance;
        result->error = error;
        result->tolerance = tolerance;
        result->where = where;
    }
#ifndef MODEL_SELFTEST_NO_PRINT
    if (bad) {
        printf("FAIL %s: error %.3g, tolerance %.3g\n", where, error, tolerance);
    }
#endif
}

/* The error of an entry is relative to it plus a part of the largest entry of its array. */
static void compare(selftest_result *result, const char *where, const model_real *x,
    const double *expected, int n, double tolerance, double part)
{
    double most = 0, error = 0;
    for (int i = 0; i < n; ++i) {
        most = magnitude(expected[i]) > most ? magnitude(expected[i]) : most;
    }
    for (int i = 0; i < n; ++i) {
        const double scale = magnitude(expected[i]) + part * most;
        const double difference = magnitude((double)x[i] - expected[i]);
        const double here = scale > 0 ? difference / scale : difference;
        if (error == error && !(here <= error)) { /* what is not a number stays */
            error = here;
        }
    }
    account(result, where, error, tolerance);
}

/* The same for rows of n entries, each relative to the largest entry of its column. */
static void compare_rows(selftest_result *result, const char *where, const model_real *x,
    const double *expected, int rows, int n, double tolerance)
{
    double error = 0;
    for (int j = 0; j < n; ++j) {
        double most = 0;
        for (int k = 0; k < rows; ++k) {
            most = magnitude(expected[k * n + j]) > most ? magnitude(expected[k * n + j]) : most;
        }
        for (int k = 0; k < rows; ++k) {
            const double difference = magnitude((double)x[k * n + j] - expected[k * n + j]);
            const double here = most > 0 ? difference / most : difference;
            if (error == error && !(here <= error)) {
                error = here;
            }
        }
    }
    account(result, where, error, tolerance);
}

static void check_status(selftest_result *result, const char *where, int status)
{
    if (status != MODEL_OK) {
        result->wrong += 1;
        result->where = where;
#ifndef MODEL_SELFTEST_NO_PRINT
        printf("FAIL %s: %s\n", where, model_status_text(status));
#endif
    }
}

#include "model_selftest_cases.h" /* the states, the expected results and the calls */

/*
 * The number of arrays and calls that are wrong; 0: the library works here. largest: of all
 * errors, as a part of the tolerance.
 */
int model_selftest(double *largest);

int model_selftest(double *largest)
{
    selftest_result result = {0.0, 0.0, 0.0, "none", 0, 0};
    selftest_points(&result);
    selftest_at_rest(&result);
    selftest_in_motion(&result);
    if (largest) {
        *largest = result.largest;
    }
#ifndef MODEL_SELFTEST_NO_PRINT
    printf("%s: %d arrays, %d wrong; largest error %.3g with tolerance %.3g (%s)\n",
        result.wrong ? "FAIL" : "PASS", result.arrays, result.wrong, result.error,
        result.tolerance, result.where);
#endif
    return result.wrong;
}

#ifndef MODEL_SELFTEST_NO_MAIN
int main(void)
{
    return model_selftest(0) != 0;
}
#endif
