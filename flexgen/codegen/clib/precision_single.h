/*
 * model: constants of the kernel in single precision; private. Written by flexgen; see model.h.
 */
#ifndef MODEL_PRECISION_H
#define MODEL_PRECISION_H

#include <stdint.h>

typedef uint32_t bits; /* the unsigned integer of the width of a real */

#define BYTES 4
/* reals in 64 bytes: arrays are padded to it, and so many instants are evaluated together */
#define BLOCK 16
#define PRECISE(fine, coarse) coarse /* a threshold that depends on the precision */
#define SIGN_BIT UINT32_C(0x80000000)
#define DIGITS 23 /* bits of the mantissa that are stored */
#define ZERO 0.0f
#define HALF 0.5f
#define ONE 1.0f
#define LIBM(name) name##f /* a function of <math.h> */
#define TWO 2.0f
#define WHOLE_FROM 8388608.0f /* every number from here on is whole */

/*
 * Sine and cosine: the parts of pi/2 have so few bits that their product with a number of quarter
 * turns is exact.
 */
#define ANGLE_MAX 10000.0f /* rad; the sine and cosine of a larger angle are NaN */
#define SHIFT 12582912.0f  /* adding it rounds to a whole number */
#define PER_QUARTER 0.636619772f
#define HALF_PI_1 1.5703125f
#define HALF_PI_2 0.000483751297f
#define HALF_PI_3 7.54953362e-08f
#define HALF_PI_4 2.56334407e-12f
#define TO_SIGN 30 /* from bit 1 to the sign bit */

/* exp and tanh. */
#define HIGHEST 89.0f  /* exp is infinite above it */
#define LOWEST -104.0f /* exp is zero below it */
#define ONE_FROM 10.0f /* tanh is 1 from here on */
#define PER_LOG_2 1.44269504f
#define LOG_2_1 0.693145752f
#define LOG_2_2 1.42860677e-06f
#define TWICE_BIASED UINT32_C(0x4b3fff02)
#define BIASED UINT32_C(0x4b3fff81)
#define INFINITE UINT32_C(0x7f800000)

/*
 * Polynomials found by Remez' exchange, in pairs of terms, so that few operations depend on each
 * other. In z = r^2, |r| <= pi/4: (sin(r)/r - 1)/z and (cos(r) - 1 + z/2)/z^2. In r, |r| <=
 * log(2)/2: (exp(r) - 1 - r)/r^2.
 */
#define SINE(z, z2) ((-0.166666552f + 0.00833217334f * z) + z2 * -0.000195166707f)
#define COSINE(z, z2) ((0.0416666456f + -0.00138873619f * z) + z2 * 2.44377461e-05f)
#define EXPONENTIAL(r, r2, r4) \
    (((0.5f + 0.166665241f * r) + r2 * (0.0416662246f + 0.00836846605f * r)) + r4 * 0.00139495044f)

#endif
