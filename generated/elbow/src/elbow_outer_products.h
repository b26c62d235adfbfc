/*
 * elbow: sums of outer products of rows, where the elimination of lq spends its time; private.
 */
#ifndef ELBOW_OUTER_PRODUCTS_H
#define ELBOW_OUTER_PRODUCTS_H

#include "elbow_mesh.h"

#if ELBOW_NE > 0

enum {
    COLUMNS = CONTROLS + STATES + 1, /* of a row; the last one: right side */
    WIDTH = (COLUMNS + BLOCK - 1) / BLOCK * BLOCK
};

/*
 * H[i][j] += sum_p weighed[p][i] rows[p][j], p < count, for i >= first and j >= i. Tiles of eight vectors, HIGH rows of
 * H and WIDE columns, stay in registers for all p: by name, as not all compilers unroll loops over arrays.
 */
#if LANES == BLOCK
#define HIGH 8
#define TILE(DO) DO(0, 0, 0) DO(1, 1, 0) DO(2, 2, 0) DO(3, 3, 0) DO(4, 4, 0) DO(5, 5, 0) DO(6, 6, 0) DO(7, 7, 0)
#define TILE_ROWS(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
#define TILE_VECTORS(DO) DO(0)
#elif 2 * LANES == BLOCK
#define HIGH 4
#define TILE(DO) DO(0, 0, 0) DO(1, 0, 1) DO(2, 1, 0) DO(3, 1, 1) DO(4, 2, 0) DO(5, 2, 1) DO(6, 3, 0) DO(7, 3, 1)
#define TILE_ROWS(DO) DO(0) DO(1) DO(2) DO(3)
#define TILE_VECTORS(DO) DO(0) DO(1)
#elif 4 * LANES == BLOCK
#define HIGH 2
#define TILE(DO) DO(0, 0, 0) DO(1, 0, 1) DO(2, 0, 2) DO(3, 0, 3) DO(4, 1, 0) DO(5, 1, 1) DO(6, 1, 2) DO(7, 1, 3)
#define TILE_ROWS(DO) DO(0) DO(1)
#define TILE_VECTORS(DO) DO(0) DO(1) DO(2) DO(3)
#else
#define HIGH 1
#define TILE(DO) DO(0, 0, 0) DO(1, 0, 1) DO(2, 0, 2) DO(3, 0, 3) DO(4, 0, 4) DO(5, 0, 5) DO(6, 0, 6) DO(7, 0, 7)
#define TILE_ROWS(DO) DO(0)
#define TILE_VECTORS(DO) DO(0) DO(1) DO(2) DO(3) DO(4) DO(5) DO(6) DO(7)
#endif
#define WIDE (8 / HIGH * LANES)
#define TILE_SUM(k, a, b) lanes sum##k = load_v(H + (i + a) * WIDTH + j + b * LANES);
#define TILE_ROW(b) const lanes x##b = load_v(rows + p * WIDTH + j + b * LANES);
#define TILE_WEIGHT(a) const lanes w##a = splat_v(weighed[p * WIDTH + i + a]);
#define TILE_ADD(k, a, b) sum##k += w##a * x##b;
#define TILE_STORE(k, a, b) store_v(H + (i + a) * WIDTH + j + b * LANES, sum##k);

static inline void add_outer_products(
    real *RESTRICT H, const real *RESTRICT rows, const real *RESTRICT weighed, int count, int first)
{
    int i = first;
    while (i < COLUMNS - 1) {
        if (i % HIGH == 0 && i + HIGH <= COLUMNS) {
            for (int j = i / BLOCK * BLOCK; j < WIDTH; j += WIDE) {
                TILE(TILE_SUM)
                for (int p = 0; p < count; ++p) {
                    TILE_VECTORS(TILE_ROW)
                    TILE_ROWS(TILE_WEIGHT)
                    TILE(TILE_ADD)
                }
                TILE(TILE_STORE)
            }
            i += HIGH;
        } else {
            for (int j = i / BLOCK * BLOCK; j < WIDTH; j += LANES) {
                lanes sum = load_v(H + i * WIDTH + j);
                for (int p = 0; p < count; ++p) {
                    sum += splat_v(weighed[p * WIDTH + i]) * load_v(rows + p * WIDTH + j);
                }
                store_v(H + i * WIDTH + j, sum);
            }
            ++i;
        }
    }
}
#undef HIGH
#undef WIDE
#undef TILE
#undef TILE_ROWS
#undef TILE_VECTORS
#undef TILE_SUM
#undef TILE_ROW
#undef TILE_WEIGHT
#undef TILE_ADD
#undef TILE_STORE

#endif

#endif
