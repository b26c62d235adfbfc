"""Definitions with which headers of the hand-written C compile by themselves in small programs."""

from __future__ import annotations

SHIM = """\
#define PRECISE(fine, coarse) fine
#include <math.h>
typedef double real;
static inline real fabs_1(real x) { return fabs(x); }
static inline real square_root(real x) { return sqrt(x); }
static inline real fmin_1(real a, real b) { return a < b ? a : b; }
static inline real fmax_1(real a, real b) { return a > b ? a : b; }
static inline int is_finite(const real *x, int n)
{
    for (int i = 0; i < n; ++i) {
        if (!isfinite(x[i])) {
            return 0;
        }
    }
    return 1;
}
"""
