/*
 * elbow: constants of the kernel in double precision; private. Written by flexgen; see elbow.h.
 */
#ifndef ELBOW_PRECISION_H
#define ELBOW_PRECISION_H

#include <stdint.h>

typedef uint64_t bits; /* the unsigned integer of the width of a real */

#define BYTES 8
/* reals in 64 bytes: arrays are padded to it, and so many instants are evaluated together */
#define BLOCK 8
#define PRECISE(fine, coarse) fine /* a threshold that depends on the precision */
#define SIGN_BIT UINT64_C(0x8000000000000000)
#define DIGITS 52 /* bits of the mantissa that are stored */
#define ZERO 0.0
#define HALF 0.5
#define ONE 1.0
#define LIBM(name) name /* a function of <math.h> */
#define TWO 2.0
#define WHOLE_FROM 4503599627370496.0 /* every number from here on is whole */

/*
 * Sine and cosine: the parts of pi/2 have so few bits that their product with a number of quarter
 * turns is exact.
 */
#define ANGLE_MAX 1000000.0      /* rad; the sine and cosine of a larger angle are NaN */
#define SHIFT 6755399441055744.0 /* adding it rounds to a whole number */
#define PER_QUARTER 0.6366197723675814
#define HALF_PI_1 1.5707963267341256
#define HALF_PI_2 6.077094383272197e-11
#define HALF_PI_3 6.12323399538461e-17
#define HALF_PI_4 3.5215598651832e-27
#define TO_SIGN 62 /* from bit 1 to the sign bit */

/* exp and tanh. */
#define HIGHEST 710.0 /* exp is infinite above it */
#define LOWEST -746.0 /* exp is zero below it */
#define ONE_FROM 22.0 /* tanh is 1 from here on */
#define PER_LOG_2 1.4426950408889634
#define LOG_2_1 0.6931471805598903
#define LOG_2_2 5.497923018708371e-14
#define TWICE_BIASED UINT64_C(0x4337fffffffff802)
#define BIASED UINT64_C(0x4337fffffffffc01)
#define INFINITE UINT64_C(0x7ff0000000000000)

/*
 * Polynomials found by Remez' exchange, in pairs of terms, so that few operations depend on each
 * other. In z = r^2, |r| <= pi/4: (sin(r)/r - 1)/z and (cos(r) - 1 + z/2)/z^2. In r, |r| <=
 * log(2)/2: (exp(r) - 1 - r)/r^2.
 */
#define SINE(z, z2) \
    (((-0.16666666666666632 + 0.008333333333322425 * z) + \
         z2 * (-0.00019841269829816863 + 2.755731369519521e-06 * z)) + \
        (z2 * z2) * (-2.5050758648160705e-08 + 1.5896827621544008e-10 * z))
#define COSINE(z, z2) \
    (((0.0416666666666666 + -0.0013888888888874138 * z) + \
         z2 * (2.4801587289491742e-05 + -2.755731435521654e-07 * z)) + \
        (z2 * z2) * (2.087572368084499e-09 + -1.1359669674695726e-11 * z))
#define EXPONENTIAL(r, r2, r4) \
    ((((0.5000000000000007 + 0.1666666666666669 * r) + \
          r2 * (0.0416666666665598 + 0.00833333333331177 * r)) + \
         r4 * ((0.001388888893676217 + 0.000198412699089098 * r) + \
                  r2 * (2.480149951410159e-05 + 2.7557222947699084e-06 * r))) + \
        (r4 * r4) * (2.762815299425782e-07 + 2.5115979876370163e-08 * r))

#endif
