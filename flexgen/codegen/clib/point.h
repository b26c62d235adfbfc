/* model: macros of a function body for one point; include before its mathematics. */
#define T real
#define F(name) name##_1
#define IN(x, i) ((x)[i])
#define OUT(x, i, value) ((x)[i] = (value))
#define P(x, i) ((x)[i])
#define STRIDE(n)
#define ANGLES(n) PADDED(n)
#define ROW lanes
#define ROWS(x) ((lanes *)(x))
#define ROW_COUNT(n) (((n) + LANES - 1) / LANES)
#define ROW_OF_COLUMN(i) ((i) / LANES)
#define ROW_FOURS(n) ((ROW_COUNT(n) + 3) / 4 * 4)
#define ROW_LANES LANES
#define ONE_POINT 1
#define ROW_OUT(x, row) store_v(x, row)
#define ROW_TABLE(x, row, k) load_v((x) + (row) + (k) * LANES)
#define ROW_LAST(i, k, n) ((i) == (n) - 1 && ((k) + 1) * LANES > (n))
#define ROW_ENTRY(x, i) ((x) + (i))
#define ROW_OF(x) splat_v(x)
#define ROW_SUM(x) sum_v(x)
