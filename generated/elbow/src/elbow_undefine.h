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
#undef ROW_BLOCK
#undef ROW_OF_COLUMN
#undef ROW_END
#undef ROW_FOURS
#undef ROW_SUM
