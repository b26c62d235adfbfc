/* elbow: removes the macros of point.h and lanes.h. No include guard. Written by flexgen. */
#undef T
#undef F
#undef IN
#undef OUT
#undef P
#undef STRIDE
#undef ANGLES
#undef ROW
#undef ROWS
#undef ROW_COUNT
#undef ROW_OF
#undef ROW_SUM
