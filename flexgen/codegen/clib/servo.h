/*
 * model: the reference with which the position servo of the motors sends given torques along given
 * angles; private.
 *
 *     c <- (c + w - w_before) / (1 + k_i h),                     w = (u - u_start) / k_v
 *     r_f <- (c + k_p q + D q + f r_f / h) / (k_p + f / h),      D q = (q - q_before) / h
 *     r = (r_f - (1 - a) r_f,before) / a,                        a = 1 - exp(-h / T)
 *
 * with angles and references from those at the start, where the motors rest and the integral part
 * holds the torque u_start: the inverse of
 *
 *     r_f <- r_f + a (r - r_f),    s = f D r_f + k_p (r_f - q) - D q,    u = u_start + k_v (s +
 *       k_i h sum s)
 *
 * With filters of the torque u is what goes into them, from what comes out: notch filters are
 * inverted by recursion, low-pass filters, whose zeros are at z = -1, with samples after the
 * present one, 1 / (1 + D2 / 4) by a series in the second difference D2.
 */
#ifndef MODEL_SERVO_H
#define MODEL_SERVO_H

#include "model_inversion_common.h"

/*
 * The numbers of a servo in an array of the caller: its sample time, 0 where there is none; gains;
 * state.
 */
enum {
    SERVO_SAMPLE,
    SERVO_FEEDFORWARD, /* f / h */
    SERVO_PART,        /* a */
    SERVO_GAINS,       /* k_p, k_v, k_i */
    /* torque and angle at the start, and the offset that holds the torque */
    SERVO_START = SERVO_GAINS + 3 * NM,
    SERVO_STATE = SERVO_START + 3 * NM, /* w, c, q and r_f of the sample before */
#if MODEL_FILTERS
    SERVO_FILTERS = SERVO_STATE +
        4 * NM, /* of each notch filter and motor: two samples of what comes out, and goes in */
    SERVO_NUMBERS = SERVO_FILTERS + 4 * NM * NOTCHES
#else  /* MODEL_FILTERS */
    SERVO_NUMBERS = SERVO_STATE + 4 * NM
#endif /* MODEL_FILTERS */
};

static const real servo_same = 1e-6; /* relative difference of sample times that are equal */

/*
 * Whether a number is above the least (or equal to it, where that is 0 and `zero`) and not above
 * the largest one.
 */
static inline int is_within(real x, real least, real most, int zero)
{
    return (x > least || (zero && x == least)) && x <= most;
}

/* Whether all gains are given. */
static inline int has_gains(const model_servo *o)
{
    return o->position_gain != NULL && o->speed_gain != NULL && o->integral_gain != NULL;
}

/*
 * Whether the inverse of the servo is stable, and the samples are its own: one sample time apart,
 * with a torque that is held and acts after its delay.
 */
static inline int servo_fits(const model_servo *o, real period, int hold, real delay)
{
    const real h = o->sample_time;
    if (!is_within(h, 0.0, 1.0, 0) || !is_within(o->speed_feedforward, 0.0, 2.0, 1) ||
        !is_within(o->reference_filter, 0.0, 1.0, 1) || hold != MODEL_HOLD_ZOH ||
        !(fabs_1(period - h) <= servo_same * h) ||
        !(fabs_1(delay * h - o->delay) <= servo_same * h)) {
        return 0;
    }
#if MODEL_FILTERS
    /* the filters are those of this sample time */
    if (!(fabs_1(h - filter_sample) <= servo_same * h)) {
        return 0;
    }
#endif /* MODEL_FILTERS */
    for (int j = 0; j < NM; ++j) {
        if (!is_within(o->position_gain[j], 0.0, 1e12, 0) ||
            !is_within(o->speed_gain[j], 0.0, 1e12, 0) ||
            !is_within(o->integral_gain[j], 0.0, 1e12, 1)) {
            return 0;
        }
    }
    return 1;
}

/* Keep the gains of a servo that fits. */
static inline void keep_servo(const model_servo *o, real *c)
{
    const real h = o->sample_time, T = o->reference_filter;
    c[SERVO_SAMPLE] = h;
    c[SERVO_FEEDFORWARD] = o->speed_feedforward / h;
    c[SERVO_PART] = T > 0.0 ? 1.0 - exp_1(-h / T) : 1.0;
    copy(o->position_gain, NM, c + SERVO_GAINS);
    copy(o->speed_gain, NM, c + SERVO_GAINS + NM);
    copy(o->integral_gain, NM, c + SERVO_GAINS + 2 * NM);
}

/* The servo at rest, with the torque and the angles that it holds. */
static inline void begin_servo(const real *tau_m, const real *q_m, real *c)
{
    const real *k_p = c + SERVO_GAINS, *k_v = k_p + NM, *k_i = k_v + NM;
    copy(tau_m, NM, c + SERVO_START);
    copy(q_m, NM, c + SERVO_START + NM);
    for (int j = 0; j < NM; ++j) {
        c[SERVO_START + 2 * NM + j] = k_i[j] > 0.0 ? 0.0 : tau_m[j] / (k_p[j] * k_v[j]);
    }
    for (int j = SERVO_STATE; j < SERVO_NUMBERS; ++j) {
        c[j] = 0.0;
    }
}

/* The reference at the next sample, motor side, from the torque to send and the angles there. */
static inline void next_reference(const real *tau_m, const real *q_m, real *c, real *reference)
{
    const real h = c[SERVO_SAMPLE], f = c[SERVO_FEEDFORWARD], a = c[SERVO_PART];
    const real *k_p = c + SERVO_GAINS, *k_v = k_p + NM, *k_i = k_v + NM;
    const real *u_start = c + SERVO_START, *q_start = u_start + NM, *offset = q_start + NM;
    real *w_before = c + SERVO_STATE, *sum = w_before + NM, *q_before = sum + NM,
         *filtered = q_before + NM;
    for (int j = 0; j < NM; ++j) {
        const real w = (tau_m[j] - u_start[j]) / k_v[j], q = q_m[j] - q_start[j];
        const real speed = (q - q_before[j]) / h, before = filtered[j];
        sum[j] = (sum[j] + (w - w_before[j])) / (1.0 + k_i[j] * h);
        filtered[j] = (sum[j] + k_p[j] * q + speed + f * before) / (k_p[j] + f);
        w_before[j] = w;
        q_before[j] = q;
        reference[j] = (filtered[j] - (1.0 - a) * before) / a + q_start[j] + offset[j];
    }
}

#if MODEL_FILTERS
/*
 * What goes into the filters at sample k, from what comes out of them at the samples from `first`
 * to `last`.
 */
static inline void unfilter(
    const real *tau_m, ptrdiff_t first, ptrdiff_t last, ptrdiff_t k, real *c, real *out)
{
    const real *u_start = c + SERVO_START;
    for (int j = 0; j < NM; ++j) {
        real x = 0.0;
        for (int i = 0; i < FILTER_TAPS; ++i) {
            const ptrdiff_t at = k + i - FILTER_BEFORE;
            if (at >= first) {
                x += filter_tap[i] * (tau_m[(at < last ? at : last) * NM + j] - u_start[j]);
            }
        }
        for (int i = 0; i < NOTCHES; ++i) {
            const real *f = notch_filter[i]; /* b0, b1, b2, a1, a2 */
            real *z = c + SERVO_FILTERS + 4 * (i * NM + j);
            const real in = (x + f[3] * z[0] + f[4] * z[1] - f[1] * z[2] - f[2] * z[3]) / f[0];
            z[1] = z[0];
            z[0] = x;
            z[3] = z[2];
            z[2] = x = in;
        }
        out[j] = u_start[j] + x;
    }
}

/*
 * The commands of n samples, where they are wanted; torques are known from sample `first` to
 * `last`.
 */
static inline void give_commands(const real *tau_m, ptrdiff_t first, ptrdiff_t last,
    const real *q_m, ptrdiff_t n, real *c, real *command_m, real *command_g)
#else  /* MODEL_FILTERS */
/* The commands of n samples, where they are wanted. */
static inline void give_commands(
    const real *tau_m, const real *q_m, ptrdiff_t n, real *c, real *command_m, real *command_g)
#endif /* MODEL_FILTERS */
{
    for (ptrdiff_t k = 0; k < n; ++k) {
        real reference[NM];
#if MODEL_FILTERS
        real sent[NM];
        unfilter(tau_m, first, last, k, c, sent);
        next_reference(sent, q_m + k * NM, c, reference);
#else  /* MODEL_FILTERS */
        next_reference(tau_m + k * NM, q_m + k * NM, c, reference);
#endif /* MODEL_FILTERS */
        if (command_m != NULL) {
            copy(reference, NM, command_m + k * NM);
        }
        for (int i = 0; i < NG && command_g != NULL; ++i) {
            real joint = 0.0;
            for (int j = 0; j < NM; ++j) {
                joint += eta_inverse[i][j] * reference[j];
            }
            command_g[k * NG + i] = joint;
        }
    }
}

/* Commands of n samples without a servo. */
static inline void no_commands(ptrdiff_t n, real *command_m, real *command_g)
{
    for (ptrdiff_t i = 0; i < n * NM && command_m != NULL; ++i) {
        command_m[i] = (real)NAN;
    }
    for (ptrdiff_t i = 0; i < n * NG && command_g != NULL; ++i) {
        command_g[i] = (real)NAN;
    }
}

#endif
