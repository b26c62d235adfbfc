/*
 * model: torques of frictions of motors with a state, the LuGre law, along a known motion;
 * private.
 *
 *     tau = s0 z + s1 z',    z' = v - s0 |v| z / g(v),    g(v) = F_c + (F_s - F_c) exp(-(v /
 *       v_s)^2)
 *
 * The speed v is a cubic between two samples. The equation of z is linear; it is solved by Radau
 * IIA with three stages in parts between the reversals of v, which are as short as z and g ask
 * for. Where v has left the range of static friction, and z has come to its limit F_c / s0, it is
 * this limit. The torque of a sample is the difference of order six of the impulse s0 int z dt +
 * s1 z.
 */
#ifndef MODEL_LUGRE_H
#define MODEL_LUGRE_H

#include "model_motors.h"

enum {
    PIECES = 4,     /* of an interval between reversals, at most */
    PARTS = 64,     /* of a piece, at most */
    NARROWINGS = 60 /* of an instant of reversal */
};

/*
 * parts for each time constant of z and for each v_s; speeds over v_s without static friction;
 * time constants after which z is its limit
 */
static const real parts_of_time = 1.0, parts_of_speed = 2.0, sliding_speed = 5.5,
                  settling_times = 30.0;

/*
 * time constants in an interval below which a reversal in it has no effect: rests are full of
 * them, by rounding
 */
static const real least_turn = PRECISE(1e-8, 1e-5);

/*
 * Bristles of all motors: deflections [rad], and the time constants that passed since the last
 * reversal, with the sign of the speed since then.
 */
typedef struct {
    real z[NM], since[NM];
} bristles;

/*
 * Numbers of a bristles, and of the impulses of the intervals before a sample, that streams keep.
 */
enum { BRISTLES = 2 * NM, PAST_IMPULSES = MARGIN * NM };

static inline real cubic_at(const real c[4], real x)
{
    return c[0] + x * (c[1] + x * (c[2] + x * c[3]));
}

/* The integral of a cubic from 0 to x. */
static inline real cubic_until(const real c[4], real x)
{
    return x * (c[0] + x * (0.5 * c[1] + x * (c[2] / 3.0 + x * (0.25 * c[3]))));
}

/*
 * Add the instant at which the cubic changes its sign between low and high, where it has no
 * extremum.
 */
static inline int add_reversal(const real c[4], real low, real high, real *at, int count)
{
    const int rising = cubic_at(c, low) < 0.0;
    if (!(high > low) || !(cubic_at(c, low) * cubic_at(c, high) < 0.0)) {
        return count;
    }
    for (int step = 0; step < NARROWINGS; ++step) {
        const real middle = 0.5 * (low + high);
        if ((cubic_at(c, middle) < 0.0) == rising) {
            low = middle;
        } else {
            high = middle;
        }
    }
    at[count] = 0.5 * (low + high);
    return count + 1;
}

/* Where the pieces of an interval begin, and 1; returns their number. */
static inline int find_reversals(const real c[4], real at[PIECES + 1])
{
    const real a = 3.0 * c[3], b = c[2], square = b * b - a * c[1];
    real turns[2] = {0.0, 0.0};
    int count = 1;
    if (square > 0.0) { /* extrema of the cubic */
        const real q = -(b + (b < 0.0 ? -sqrt_1(square) : sqrt_1(square)));
        const real one = a != 0.0 ? q / a : 0.0, two = q != 0.0 ? c[1] / q : 0.0;
        turns[0] = fmin_1(fmax_1(fmin_1(one, two), 0.0), 1.0);
        turns[1] = fmin_1(fmax_1(fmax_1(one, two), 0.0), 1.0);
    }
    at[0] = 0.0;
    count = add_reversal(c, 0.0, turns[0], at, count);
    count = add_reversal(c, turns[0], turns[1], at, count);
    count = add_reversal(c, turns[1], 1.0, at, count);
    at[count] = 1.0;
    return count;
}

/*
 * One part of an interval from `begin` on, of the length `size` [s]: z at its end; returns the
 * integral of z. The stages solve (1 + size A c) z = z_0 + size A v; by the adjugate: one
 * division.
 */
static inline real bristle_step(int j, const real c[4], real begin, real width, real size, real *z)
{
    const real more = lugre_static[j] - lugre_coulomb[j], per_speed = 1.0 / lugre_speed[j];
    real a[STAGES][STAGES], y[STAGES], x[STAGES], adjugate[STAGES][STAGES], inverse;
    real v[PADDED(STAGES)] = {0.0}, decay[PADDED(STAGES)]; /* stages as lanes */
    for (int s = 0; s < STAGES; ++s) {
        v[s] = cubic_at(c, begin + radau_c[s] * width);
    }
    for (int s = 0; s < STAGES; s += LANES) {
        const lanes now = load_v(v + s), share = now * per_speed;
        const lanes level = lugre_coulomb[j] + more * exp_v(-(share * share));
        store_v(decay + s, size * lugre_stiffness[j] * fabs_v(now) / level);
    }
    for (int s = 0; s < STAGES; ++s) {
        y[s] = 0.0;
        for (int t = 0; t < STAGES; ++t) {
            a[s][t] = radau_A[s][t] * decay[t] + (s == t ? 1.0 : 0.0);
            y[s] += radau_A[s][t] * v[t];
        }
        y[s] = *z + size * y[s];
    }
    for (int s = 0; s < STAGES; ++s) {
        for (int t = 0; t < STAGES; ++t) {
            const int s1 = (s + 1) % STAGES, s2 = (s + 2) % STAGES, t1 = (t + 1) % STAGES,
                      t2 = (t + 2) % STAGES;
            adjugate[t][s] = a[s1][t1] * a[s2][t2] - a[s1][t2] * a[s2][t1];
        }
    }
    inverse = 1.0 /
              (a[0][0] * adjugate[0][0] + a[0][1] * adjugate[1][0] + a[0][2] * adjugate[2][0]);
    for (int s = 0; s < STAGES; ++s) {
        x[s] = inverse * (adjugate[s][0] * y[0] + adjugate[s][1] * y[1] + adjugate[s][2] * y[2]);
    }
    *z = x[2];
    return size * (radau_A[2][0] * x[0] + radau_A[2][1] * x[1] + radau_A[2][2] * x[2]);
}

/* Torque of the bristles of motor j in a motion at constant speed. */
static inline real sliding_torque(int j, real v)
{
    const real share = v / lugre_speed[j];
    const real level = lugre_coulomb[j] +
                       (lugre_static[j] - lugre_coulomb[j]) * exp_1(-share * share);
    return v != 0.0 && lugre_coulomb[j] > 0.0 ? copysign_1(level, v) : 0.0;
}

/* The time constants since the last reversal, after `passed` more on the way in one direction. */
static inline real since_then(real since, real passed, real way)
{
    const real sum = fmin_1(fabs_1(since) + passed, 2.0 * settling_times);
    return passed > least_turn ? copysign_1(sum, way) : since;
}

/*
 * Impulse of the bristles of motor j over an interval [N m s], and their deflection at its end.
 * Speeds v [rad/s] and accelerations a at both ends.
 */
static inline real bristle_impulse(
    int j, real period, const real v[2], const real a[2], real *z, real *since)
{
    const real per_turn = lugre_stiffness[j] / lugre_coulomb[j],
               wide = sliding_speed * lugre_speed[j];
    const real control[4] = {v[0], v[0] + period * a[0] / 3.0, v[1] - period * a[1] / 3.0, v[1]};
    const int falls = lugre_static[j] > lugre_coulomb[j];
    const real first = *z;
    real at[PIECES + 1] = {0.0, 1.0}, c[4], low = control[0], high = control[0], integral = 0.0,
                     slow, way, passed = 0.0;
    int pieces = 1;
    for (int i = 1; i < 4; ++i) {
        low = fmin_1(low, control[i]);
        high = fmax_1(high, control[i]);
    }
    if (!(lugre_coulomb[j] > 0.0)) {
        return 0.0;
    }
    if (low == 0.0 && high == 0.0) {
        return lugre_stiffness[j] * period * *z;
    }
    way = per_turn * period * (0.5 * (v[0] + v[1]) + period * (a[0] - a[1]) / 12.0);
    if (fabs_1(way) > least_turn && way * *since < 0.0) {
        *since = 0.0;
    }
    slow = low > 0.0 ? low : high < 0.0 ? -high : 0.0;
    if ((slow > wide || (!falls && slow > 0.0)) && fabs_1(*since) > settling_times &&
        fabs_1(way) > least_turn) {
        *z = v[0] > 0.0 ? 1.0 / per_turn : -1.0 / per_turn;
        return lugre_stiffness[j] * period * *z + lugre_damping[j] * (*z - first);
    }
    c[0] = v[0];
    c[1] = period * a[0];
    c[2] = 3.0 * (v[1] - v[0]) - period * (2.0 * a[0] + a[1]);
    c[3] = period * (a[0] + a[1]) - 2.0 * (v[1] - v[0]);
    if (low < 0.0 && high > 0.0 && per_turn * period * (high - low) > least_turn) {
        pieces = find_reversals(c, at);
    }
    for (int piece = 0; piece < pieces; ++piece) {
        const real size = at[piece + 1] - at[piece];
        const real turned = fabs_1(cubic_until(c, at[piece + 1]) - cubic_until(c, at[piece])) *
                            period * per_turn;
        const real change = falls && slow < wide ? (high - low) / lugre_speed[j] * size : 0.0;
        const real settles = piece > 0 || fabs_1(*since) <= settling_times ?
                                 parts_of_time * turned :
                                 0.0;
        const real wanted = fmax_1(settles, parts_of_speed * change);
        const int parts = wanted > (real)(PARTS - 1) ? PARTS : (int)wanted + 1;
        for (int part = 0; part < parts; ++part) {
            const real width = size / (real)parts;
            integral += bristle_step(
                j, c, at[piece] + (real)part * width, width, period * width, z);
        }
        passed += turned;
    }
    *since = pieces > 1 ? 0.0 : since_then(*since, passed, way);
    return lugre_stiffness[j] * integral + lugre_damping[j] * (*z - first);
}

/*
 * The same for LANES intervals that follow each other, where each of them is one part without a
 * reversal; 0: one is not. The end of a part is a linear function of its start, so that all are
 * solved at once.
 */
static inline int bristle_impulses(
    int j, real period, const real *v, const real *a, real *impulse, real *z, real *since)
{
    const real per_turn = lugre_stiffness[j] / lugre_coulomb[j],
               wide = sliding_speed * lugre_speed[j];
    const real more = lugre_static[j] - lugre_coulomb[j], per_speed = 1.0 / lugre_speed[j];
    const lanes v0 = load_v(v), v1 = load_v(v + 1), a0 = period * load_v(a),
                a1 = period * load_v(a + 1);
    const lanes inner0 = v0 + a0 / 3.0, inner1 = v1 - a1 / 3.0;
    const lanes low = fmin_v(fmin_v(v0, v1), fmin_v(inner0, inner1));
    const lanes high = fmax_v(fmax_v(v0, v1), fmax_v(inner0, inner1)), zero = splat_v(0.0);
    const lanes slow = fmax_v(fmax_v(low, -high), zero);
    const lanes way = per_turn * period * (0.5 * (v0 + v1) + (a0 - a1) / 12.0),
                turned = fabs_v(way);
    const real first = *since != 0.0 ? *since : v[0] + v[1];
    const lanes near = more > 0.0 ? le_v(slow, splat_v(wide)) : zero;
    const lanes change = select_v(near, parts_of_speed * per_speed * (high - low), zero);
    const lanes wanted = fabs_1(*since) > settling_times ? change :
                                                           fmax_v(change, parts_of_time * turned);
    const lanes c2 = 3.0 * (v1 - v0) - 2.0 * a0 - a1, c3 = a0 + a1 - 2.0 * (v1 - v0);
    lanes matrix[STAGES][STAGES], speed[STAGES], decay[STAGES], ends[2], integrals[2],
        adjugate[STAGES][STAGES], inverse;
    real end[4][LANES], passed[LANES];
    if (sum_v(not_v(lt_v(wanted, splat_v(1.0))) +
              lt_v(first * way, zero) * lt_v(splat_v(least_turn), turned) +
              lt_v(low, zero) * lt_v(zero, high) *
                  lt_v(splat_v(least_turn), per_turn * period * (high - low))) > 0.0) {
        return 0;
    }
    for (int s = 0; s < STAGES; ++s) {
        const real x = radau_c[s];
        lanes share, level = splat_v(lugre_coulomb[j]);
        speed[s] = v0 + x * (a0 + x * (c2 + x * c3));
        share = speed[s] * per_speed;
        level += more * exp_v(-(share * share));
        decay[s] = period * lugre_stiffness[j] * fabs_v(speed[s]) / level;
    }
    for (int s = 0; s < STAGES; ++s) {
        for (int t = 0; t < STAGES; ++t) {
            matrix[s][t] = radau_A[s][t] * decay[t] + (s == t ? 1.0 : 0.0);
        }
    }
    for (int s = 0; s < STAGES; ++s) {
        for (int t = 0; t < STAGES; ++t) {
            const int s1 = (s + 1) % STAGES, s2 = (s + 2) % STAGES, t1 = (t + 1) % STAGES,
                      t2 = (t + 2) % STAGES;
            adjugate[t][s] = matrix[s1][t1] * matrix[s2][t2] - matrix[s1][t2] * matrix[s2][t1];
        }
    }
    inverse = 1.0 / (matrix[0][0] * adjugate[0][0] + matrix[0][1] * adjugate[1][0] +
                        matrix[0][2] * adjugate[2][0]);
    for (int side = 0; side < 2; ++side) { /* of z at the start, and of the speed */
        integrals[side] = zero;
        for (int s = 0; s < STAGES; ++s) {
            lanes sum = zero;
            for (int t = 0; t < STAGES; ++t) {
                lanes right = splat_v(1.0);
                if (side > 0) {
                    right = period * (radau_A[t][0] * speed[0] + radau_A[t][1] * speed[1] +
                                         radau_A[t][2] * speed[2]);
                }
                sum += adjugate[s][t] * right;
            }
            sum *= inverse;
            integrals[side] += period * radau_A[2][s] * sum;
            ends[side] = sum;
        }
    }
    for (int side = 0; side < 2; ++side) {
        store_v(end[side], ends[side]);
        store_v(end[2 + side], integrals[side]);
    }
    store_v(passed, way);
    for (int l = 0; l < LANES; ++l) {
        const real next = end[0][l] * *z + end[1][l];
        impulse[l] = lugre_stiffness[j] * (end[2][l] * *z + end[3][l]) +
                     lugre_damping[j] * (next - *z);
        *z = next;
        *since = since_then(*since, fabs_1(passed[l]), passed[l]);
    }
    return 1;
}

/*
 * Torque at a sample from the impulses of the intervals around it, of which those after it begin
 * at `after`.
 */
static inline real bristle_torque(const real *after, ptrdiff_t stride, real period)
{
    return (37.0 * (after[0] + after[-stride]) - 8.0 * (after[stride] + after[-2 * stride]) +
               (after[2 * stride] + after[-3 * stride])) /
           (60.0 * period);
}

#endif
