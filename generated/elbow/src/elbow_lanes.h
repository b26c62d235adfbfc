/*
 * elbow: macros of a function body for lanes of points, whose entries are n apart; include before
 * its mathematics.
 */
#include "elbow_undefine.h"
#define T lanes
#define F(name) name##_v
#define IN(x, i) load_v((x) + (i) * n)
#define OUT(x, i, value) store_v((x) + (i) * n, value)
#define P(x, i) splat_v((x)[i])
#define STRIDE(n) , n
#define ANGLES(n) (n)
#define ROW lanes
#define ROWS(x) (x)
#define ROW_COUNT(n) (n)
#define ROW_OF_COLUMN(i) (i)
#define ROW_FOURS(n) (((n) + 3) / 4 * 4)
#define ROW_LANES 1
#define ONE_POINT 0
#define ROW_OUT(x, row) store_v(x, row)
#define ROW_TABLE(x, row, k) splat_v((x)[(row) + (k)])
#define ROW_LAST(i, k, n) 0
#define ROW_ENTRY(x, i) ((x) + (i) * n)
#define ROW_OF(x) splat_v(x)
#define ROW_SUM(x) (x)
