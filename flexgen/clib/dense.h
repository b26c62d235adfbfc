/*
 * model: small dense systems of equations by elimination; private.
 *
 * Matrices by rows, `width` numbers from row to row.
 */
#ifndef MODEL_DENSE_H
#define MODEL_DENSE_H

#include "model_inversion_common.h"

/*
 * Gauss elimination with pivots on the diagonal, n rows: of the matrix in columns 0 ... n - 1, and of the right sides
 * in the columns after it, which become the solutions. 0 where a pivot is zero: its unknown becomes zero.
 */
static inline int solve_plain(real *a, int n, int width)
{
    int regular = 1;
    for (int k = 0; k < n; ++k) {
        const real *top = a + k * width;
        const int is_pivot = fabs_1(top[k]) > 0.0;
        regular = regular && is_pivot;
        for (int i = k + 1; i < n; ++i) {
            real *row = a + i * width;
            const real f = is_pivot ? row[k] / top[k] : 0.0;
            for (int j = k + 1; j < width; ++j) {
                row[j] -= f * top[j];
            }
        }
    }
    for (int k = n - 1; k >= 0; --k) {
        real *row = a + k * width;
        for (int c = n; c < width; ++c) {
            for (int j = k + 1; j < n; ++j) {
                row[c] -= row[j] * a[j * width + c];
            }
            row[c] = fabs_1(row[k]) > 0.0 ? row[c] / row[k] : 0.0;
        }
    }
    return regular;
}

/* The row of the largest entry in column k, of the rows from k on. */
static inline int pivot_row(const real *a, int height, int width, int k)
{
    int best = k;
    for (int i = k + 1; i < height; ++i) {
        if (fabs_1(a[i * width + k]) > fabs_1(a[best * width + k])) {
            best = i;
        }
    }
    return best;
}

static inline void swap_rows(real *one, real *other, int columns)
{
    for (int j = 0; j < columns; ++j) {
        const real t = one[j];
        one[j] = other[j];
        other[j] = t;
    }
}

#endif
