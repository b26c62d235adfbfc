/*
 * model: deflections of gears with hysteresis that carry given torques; private.
 *
 *     tau_g = spring(p) + D p' + sum z,    z' = K_h (p' - |p'| z / W) of each of ELEMENTS elements
 *
 * As long as a deflection p moves in one direction s, each z is a function of it,
 *
 *     z = s W + (z_r - s W) exp(-s K_h (p - p_r) / W),
 *
 * from the point (p_r, z_r) at which it reversed last. So between two reversals a damped gear is
 * one scalar differential equation, integrated by Radau IIA with three stages; an undamped one is
 * an equation for p. Reversals are located between the samples, where the torque is a quintic. All
 * gears advance side by side, as lanes.
 */
#ifndef MODEL_HYSTERESIS_H
#define MODEL_HYSTERESIS_H

#include "model_motors.h"

enum {
    GEARS = PADDED(NG),
    POWERS = 6,     /* coefficients of a quintic */
    REVERSALS = 8,  /* between two samples, at most */
    LOCATIONS = 60, /* steps to an instant of reversal, at most */
    PASSES = 500    /* of Newton's method between two samples, at most */
};

#if MODEL_CURVED
/* of a piece of a curve; steps to the path at a point of it, at most */
enum { COEFFICIENTS = 8, SEARCHES = 60 };

#endif /* MODEL_CURVED */
/*
 * of the last step of Newton's method, relative to 1e-3 rad or m and the deflection: what remains
 * is its square
 */
static const real branch_rounding = PRECISE(1e-13, 3e-7);
/*
 * motion back from which on a gear reverses, and what remains of an instant of reversal, in
 * samples
 */
static const real least_return = PRECISE(1e-12, 1e-6), least_part = PRECISE(1e-8, 1e-4);
/*
 * [samples] of Newton's step to such an instant: what remains is its square, and less than
 * rounding
 */
static const real last_part = PRECISE(1e-5, 1e-3);
#if MODEL_CURVED
static const real path_rounding = PRECISE(1e-15, 1e-7); /* of the part of a piece */
static const real lane_numbers[16] = {
    0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0};
#endif /* MODEL_CURVED */

typedef real gear_lanes[GEARS];

/*
 * The gears on their branches. A rigid gear, and a lane without gear, has no motion: kept = 1,
 * flow = 0.
 */
typedef struct {
    /* deflection; the last reversal, and the direction since then */
    gear_lanes p, p_r, z_r[ELEMENTS], s;
    /* 1 and period / D of a damped gear; 0 and 0 of an undamped one */
    gear_lanes kept, flow;
    gear_lanes stiffness, bend; /* spring at zero; how it changes, relative */
    /* K_h / W, W; the first element is there where any is */
    gear_lanes steep[ELEMENTS], slip[ELEMENTS];
    /* deflections of the last step: its stages, and where it began */
    gear_lanes x[STAGES], before;
    real ahead[STAGES][STAGES + 1]; /* weights of before and x in the next guess */
    /* whether all springs are; passes left in this interval */
    int linear, passes;
#if MODEL_CURVED
    /*
     * of elements by another law than Dahl's, which are those with curved = 1: paths on their
     * curves at which they reversed last; the piece that is kept of each, where it begins and one
     * over its length; how far from its middle it serves, in parts of it; whether an element of
     * some gear is by Dahl's law
     */
    gear_lanes curved[ELEMENTS], start[ELEMENTS], from[ELEMENTS], per[ELEMENTS], reach[ELEMENTS];
    gear_lanes piece[ELEMENTS][COEFFICIENTS];
    int dahl[ELEMENTS];
#endif /* MODEL_CURVED */
} branches;

/* The torques of all gears between two samples, as coefficients of the part of the interval. */
typedef struct {
    gear_lanes c[POWERS];
} quintics;

/* Coefficients from the torque of gear i at both ends, with derivatives times the period. */
static inline void set_quintic(quintics *q, int i, const real left[3], const real right[3])
{
    const real d = right[0] - left[0];
    q->c[0][i] = left[0];
    q->c[1][i] = left[1];
    q->c[2][i] = 0.5 * left[2];
    q->c[3][i] = 10.0 * d - 6.0 * left[1] - 4.0 * right[1] - 1.5 * left[2] + 0.5 * right[2];
    q->c[4][i] = -15.0 * d + 8.0 * left[1] + 7.0 * right[1] + 1.5 * left[2] - right[2];
    q->c[5][i] = 6.0 * d - 3.0 * left[1] - 3.0 * right[1] - 0.5 * left[2] + 0.5 * right[2];
}

/*
 * Weights of the cubic through the start and the stages of a step, at the stages of the next one.
 */
static inline void weights_ahead(real (*ahead)[STAGES + 1])
{
    for (int k = 0; k < STAGES; ++k) {
        for (int i = 0; i <= STAGES; ++i) {
            const real at = i > 0 ? radau_c[i - 1] : 0.0;
            ahead[k][i] = 1.0;
            for (int j = 0; j <= STAGES; ++j) {
                const real other = j > 0 ? radau_c[j - 1] : 0.0;
                ahead[k][i] *= j == i ? 1.0 : (1.0 + radau_c[k] - other) / (at - other);
            }
        }
    }
}

#if MODEL_CURVED
/*
 * The piece of curve c with the path u: pieces before the dense ones, and behind them, have one
 * length each.
 */
static inline int piece_with(int c, real u)
{
    const int begin = curve_part[c][0], end = curve_part[c + 1][0];
    int low = curve_part[c][1], high = curve_part[c][2];
    if (u >= curve_piece[high][0]) {
        const real along = (u - curve_piece[high][0]) * curve_piece[high][1];
        return along < (real)(end - high) ? high + (int)along : end - 1;
    }
    if (u < curve_piece[low][0]) {
        const real along = (curve_piece[low][0] - u) * curve_piece[low - 1][1];
        return along < (real)(low - begin) ? low - 1 - (int)along : begin;
    }
    while (high - low > 1) {
        const int middle = (low + high) / 2;
        if (u < curve_piece[middle][0]) {
            high = middle;
        } else {
            low = middle;
        }
    }
    return low;
}

/* The part of the slip torque at t, the part of a piece, and how it rises with t. */
MODEL_INLINE real on_piece(const real *piece, real t, real *rise)
{
    const real *c = piece + 2, tt = t * t, tttt = tt * tt;
    *rise = (c[1] + 2.0 * c[2] * t) + tt * (3.0 * c[3] + 4.0 * c[4] * t) +
            tttt * ((5.0 * c[5] + 6.0 * c[6] * t) + tt * (7.0 * c[7]));
    return ((c[0] + c[1] * t) + tt * (c[2] + c[3] * t)) +
           tttt * ((c[4] + c[5] * t) + tt * (c[6] + c[7] * t));
}

/* The part of the slip torque after the path u on curve c, and how it rises with it. */
MODEL_INLINE real on_curve(int c, real u, real *rise)
{
    const int at = piece_with(c, u);
    const real t = fmax_1((u - curve_piece[at][0]) * curve_piece[at][1], 0.0);
    real y;
    if (at + 1 == curve_part[c + 1][0] && t >= 1.0) {
        *rise = 0.0;
        return 1.0;
    }
    y = on_piece(curve_piece[at], t, rise);
    *rise *= curve_piece[at][1];
    return y;
}

/* The path on curve c at the part y of the slip torque. */
static inline real path_at(int c, real y)
{
    int at = curve_part[c][0], end = curve_part[c + 1][0];
    real from = 0.0, to = 1.0, t = 0.5, moved = 1.0;
    while (end - at > 1) {
        const int middle = (at + end) / 2;
        if (curve_piece[middle][2] <= y) {
            at = middle;
        } else {
            end = middle;
        }
    }
    for (int step = 0; step < SEARCHES && moved > path_rounding; ++step) {
        real rise, next;
        const real off = on_piece(curve_piece[at], t, &rise) - y;
        if (off < 0.0) {
            from = t;
        } else {
            to = t;
        }
        next = t - off / rise;
        if (!(next > from && next < to)) {
            next = 0.5 * (from + to);
        }
        moved = fabs_1(next - t);
        t = next;
    }
    return curve_piece[at][0] + t / curve_piece[at][1];
}

/*
 * Keep the piece of element e of gear i with the path u: outside of it by half of its length it is
 * as exact.
 */
static inline void keep_piece(branches *b, int e, int i, real u)
{
    const int c = hysteresis_curve[e][i], at = piece_with(c, u);
    const real *p = curve_piece[at];
    const int is_end = at + 1 == curve_part[c + 1][0] && (u - p[0]) * p[1] >= 1.0;
    const int is_dense = at >= curve_part[c][1] && at < curve_part[c][2];
    b->from[e][i] = is_end ? p[0] + 1.0 / p[1] : p[0];
    b->per[e][i] = is_end ? 1.0 : p[1];
    b->reach[e][i] = is_dense ? 0.5 : 1.0;
    for (int power = 0; power < COEFFICIENTS; ++power) {
        b->piece[e][power][i] = !is_end ? p[2 + power] : power == 0 ? 1.0 : 0.0;
    }
}

/* Keep the pieces with the guesses x. */
static inline void keep_pieces(branches *b, const real *x)
{
    for (int e = 0; e < ELEMENTS; ++e) {
        for (int i = 0; i < NG; ++i) {
            if (b->curved[e][i] > 0.0) {
                const real passed = b->s[i] * b->steep[e][i] * (x[i] - b->p_r[i]);
                const real u = b->start[e][i] + fmax_1(passed, 0.0);
                if (!(fabs_1((u - b->from[e][i]) * b->per[e][i] - 0.5) <= 0.5)) {
                    keep_piece(b, e, i, u);
                }
            }
        }
    }
}

/* Where gear i is on its curves, from its last reversal. */
static inline void restart_curves(branches *b, int i)
{
    for (int e = 0; e < ELEMENTS && i < NG; ++e) {
        b->start[e][i] = 0.0;
        if (b->curved[e][i] > 0.0 && b->z_r[e][i] != 0.0) {
            const real y = b->s[i] * b->z_r[e][i] / b->slip[e][i];
            b->start[e][i] = path_at(hysteresis_curve[e][i], fmin_1(fmax_1(y, -1.0), 1.0));
        }
    }
}

#endif /* MODEL_CURVED */
/*
 * Gears at rest with the deflections p and without torques of hysteresis; 0 where a number is not
 * finite.
 */
static inline int begin_branches(branches *b, real period, const real *p, real *space)
{
    real at_zero[NG], least[NG];
    if (!least_stiffness(at_zero, least, space)) {
        return 0;
    }
    b->linear = 1;
    weights_ahead(b->ahead);
    for (int i = 0; i < GEARS; ++i) {
        const int elastic = i < NG && !gear_is_rigid[i < NG ? i : 0], k = elastic ? i : 0;
        const real D = elastic ? damping_of(k, space) : 1.0;
        b->p[i] = b->p_r[i] = b->before[i] = elastic ? p[k] : 0.0;
        for (int stage = 0; stage < STAGES; ++stage) {
            b->x[stage][i] = b->p[i];
        }
        b->s[i] = 1.0;
        b->kept[i] = D > 0.0 ? 1.0 : 0.0;
        b->flow[i] = elastic && D > 0.0 ? period / D : 0.0;
        b->stiffness[i] = elastic ? at_zero[k] : 0.0;
        b->bend[i] = 0.0;
        for (int e = 0; e < ELEMENTS; ++e) {
            b->z_r[e][i] = 0.0;
            b->slip[e][i] = elastic ? hysteresis_slip[e][k] : 0.0;
            b->steep[e][i] = b->slip[e][i] > 0.0 ? hysteresis_stiffness[e][k] / b->slip[e][i] :
                                                   0.0;
#if MODEL_CURVED
            b->curved[e][i] = b->slip[e][i] > 0.0 && hysteresis_curve[e][k] >= 0 ? 1.0 : 0.0;
            b->dahl[e] = (i > 0 && b->dahl[e]) ||
                         (b->slip[e][i] > 0.0 && !(b->curved[e][i] > 0.0));
            b->start[e][i] = b->reach[e][i] = 0.0;
            b->from[e][i] = -1e6; /* none is kept */
            b->per[e][i] = 1.0;
            for (int power = 0; power < COEFFICIENTS; ++power) {
                b->piece[e][power][i] = 0.0;
            }
            b->bend[i] = fmax_1(b->bend[i], hysteresis_bend[e][k] * b->steep[e][i]);
#else  /* MODEL_CURVED */
            b->bend[i] = b->steep[e][i] > b->bend[i] ? b->steep[e][i] : b->bend[i];
#endif /* MODEL_CURVED */
        }
        b->bend[i] += elastic && !gear_is_linear[k] ? 1e6 : 0.0;
        b->linear = b->linear && (!elastic || gear_is_linear[k]);
    }
    return 1;
}

#if MODEL_CURVED
/* The same by Dahl's law. */
MODEL_INLINE lanes dahl_torque(const branches *b, int e, int i, const lanes x, lanes *rise)
#else  /* MODEL_CURVED */
/* Torques z of element e at the deflections x, lanes from i on, and how they rise. */
MODEL_INLINE lanes element_torque(const branches *b, int e, int i, const lanes x, lanes *rise)
#endif /* MODEL_CURVED */
{
    const lanes s = load_v(b->s + i), slip = load_v(b->slip[e] + i), z_r = load_v(b->z_r[e] + i);
    const lanes end = s * slip, steep = load_v(b->steep[e] + i);
    /* Newton's method may try a deflection behind the reversal: there the branch is its tangent */
    const lanes passed = s * steep * (x - load_v(b->p_r + i)), zero = splat_v(0.0);
    const lanes fade = exp_v(-fmax_v(passed, zero));
    *rise = steep * (slip - s * z_r) * fade;
    return end + (z_r - end) * fade * (1.0 - fmin_v(passed, zero));
}

#if MODEL_CURVED
/*
 * The part of the slip torque at t of the pieces that are kept, lanes from i on, and how it rises
 * with t.
 */
MODEL_INLINE lanes on_kept_pieces(const branches *b, int e, int i, const lanes t, lanes *rise)
{
    const lanes tt = t * t, tttt = tt * tt;
    lanes c[COEFFICIENTS];
    for (int k = 0; k < COEFFICIENTS; ++k) {
        c[k] = load_v(b->piece[e][k] + i);
    }
    *rise = (c[1] + 2.0 * c[2] * t) + tt * (3.0 * c[3] + 4.0 * c[4] * t) +
            tttt * ((5.0 * c[5] + 6.0 * c[6] * t) + tt * (7.0 * c[7]));
    return ((c[0] + c[1] * t) + tt * (c[2] + c[3] * t)) +
           tttt * ((c[4] + c[5] * t) + tt * (c[6] + c[7] * t));
}

/* Torques z of element e at the deflections x, lanes from i on, and how they rise. */
MODEL_INLINE lanes element_torque(const branches *b, int e, int i, const lanes x, lanes *rise)
{
    const lanes s = load_v(b->s + i), slip = load_v(b->slip[e] + i),
                steep = load_v(b->steep[e] + i);
    const lanes passed = s * steep * (x - load_v(b->p_r + i)), zero = splat_v(0.0);
    const lanes u = load_v(b->start[e] + i) + fmax_v(passed, zero),
                curved = load_v(b->curved[e] + i);
    const lanes per = load_v(b->per[e] + i), t = (u - load_v(b->from[e] + i)) * per;
    const lanes off = curved * not_v(le_v(fabs_v(t - 0.5), load_v(b->reach[e] + i)));
    lanes z, slope, y = on_kept_pieces(b, e, i, t, &slope);
    slope *= per;
    if (sum_v(off) > 0.0) {
        real path[LANES], outside[LANES];
        store_v(outside, off);
        store_v(path, u);
        for (int l = 0; l < LANES && i + l < NG; ++l) {
            if (outside[l] > 0.0) {
                const lanes here = eq_v(load_v(lane_numbers), splat_v((real)l));
                real rises;
                y = select_v(
                    here, splat_v(on_curve(hysteresis_curve[e][i + l], path[l], &rises)), y);
                slope = select_v(here, splat_v(rises), slope);
            }
        }
    }
    /* Newton's method may try a deflection behind the reversal: there the branch is its tangent */
    z = s * slip * (y + slope * fmin_v(passed, zero));
    *rise = steep * slip * slope;
    if (b->dahl[e]) {
        lanes other_rise;
        const lanes other = dahl_torque(b, e, i, x, &other_rise);
        z = select_v(curved, z, other);
        *rise = select_v(curved, *rise, other_rise);
    }
    return z;
}

#endif /* MODEL_CURVED */
/* The same of all elements. */
MODEL_INLINE lanes branch_torque(const branches *b, int i, const lanes x, lanes *rise)
{
    lanes z = element_torque(b, 0, i, x, rise);
    for (int e = 1; e < ELEMENTS; ++e) {
        lanes more;
        z += element_torque(b, e, i, x, &more);
        *rise += more;
    }
    return z;
}

/* What a part of a step gives. */
typedef struct {
    gear_lanes x[STAGES]; /* deflections at the stages; in: guesses */
    /* at its end: torque that spring and hysteresis do not carry, and how theirs rises */
    gear_lanes left, slope;
    /* of the sign of the motion at its end, in the direction of the branch */
    gear_lanes forward;
} branch_motion;

/* x = a^-1 y, by the adjugate: one division. */
MODEL_INLINE void solve_stages(lanes (*a)[STAGES], const lanes y[STAGES], lanes x[STAGES])
{
    lanes c[STAGES][STAGES], inverse; /* cofactors */
    for (int i = 0; i < STAGES; ++i) {
        for (int j = 0; j < STAGES; ++j) {
            const int i1 = (i + 1) % STAGES, i2 = (i + 2) % STAGES, j1 = (j + 1) % STAGES,
                      j2 = (j + 2) % STAGES;
            c[i][j] = a[i1][j1] * a[i2][j2] - a[i1][j2] * a[i2][j1];
        }
    }
    inverse = 1.0 / (a[0][0] * c[0][0] + a[0][1] * c[0][1] + a[0][2] * c[0][2]);
    for (int j = 0; j < STAGES; ++j) {
        x[j] = inverse * (c[0][j] * y[0] + c[1][j] * y[1] + c[2][j] * y[2]);
    }
}

/*
 * Deflections from b->p at `begin` to `finish`, parts of the interval between two samples; 0 where
 * there are none.
 */
static inline int along_branches(branches *b, const quintics *q, const real *begin,
    const real *finish, branch_motion *m, real *space)
{
    gear_lanes torque[STAGES], value[STAGES], slope[STAGES], off;
    int missed = 1;
#if MODEL_CURVED
    keep_pieces(b, m->x[1]);
#endif /* MODEL_CURVED */
    for (int i = 0; i < NG; i += LANES) {
        const lanes from = load_v(begin + i), size = load_v(finish + i) - from;
        for (int k = 0; k < STAGES; ++k) {
            const lanes at = from + radau_c[k] * size;
            lanes sum = load_v(q->c[POWERS - 1] + i);
            for (int power = POWERS - 2; power >= 0; --power) {
                sum = load_v(q->c[power] + i) + at * sum;
            }
            store_v(torque[k] + i, sum);
        }
    }
    while (missed && b->passes-- > 0) {
        for (int k = 0; k < STAGES && !b->linear; ++k) {
            if (evaluate_gear_law(m->x[k], value[k], slope[k], space) != MODEL_OK) {
                return 0;
            }
        }
        for (int i = 0; i < NG; i += LANES) {
            const lanes kept = load_v(b->kept + i), p = load_v(b->p + i),
                        K = load_v(b->stiffness + i);
            const lanes flow = load_v(b->flow + i) * (load_v(finish + i) - load_v(begin + i));
            lanes left[STAGES], defect[STAGES], dx[STAGES], a[STAGES][STAGES], more = splat_v(0.0),
                                                                               rest;
            for (int k = 0; k < STAGES; ++k) {
                const lanes x = load_v(m->x[k] + i);
                lanes rise, z = branch_torque(b, i, x, &rise);
                if (b->linear) {
                    store_v(value[k] + i, K * x + z);
                    store_v(slope[k] + i, K + rise);
                } else {
                    store_v(value[k] + i, load_v(value[k] + i) + z);
                    store_v(slope[k] + i, load_v(slope[k] + i) + rise);
                }
                left[k] = load_v(torque[k] + i) - load_v(value[k] + i);
            }
            for (int k = 0; k < STAGES; ++k) {
                defect[k] = kept * (p - load_v(m->x[k] + i)) + (1.0 - kept) * left[k];
                for (int j = 0; j < STAGES; ++j) {
                    const lanes weight = radau_A[k][j] * flow;
                    defect[k] += weight * left[j];
                    a[k][j] = weight * load_v(slope[j] + i);
                }
                a[k][k] += kept + (1.0 - kept) * load_v(slope[k] + i);
            }
            rest = left[STAGES - 1];
            solve_stages(a, defect, dx);
            for (int k = 0; k < STAGES; ++k) {
                const lanes next = load_v(m->x[k] + i) + dx[k], change = fabs_v(dx[k]);
                const lanes remains = change * fmin_v(load_v(b->bend + i) * change, splat_v(1.0));
                more += not_v(le_v(remains, branch_rounding * (1e-3 + fabs_v(next))));
                store_v(m->x[k] + i, next);
            }
            store_v(off + i, more);
            store_v(m->left + i, rest - load_v(slope[STAGES - 1] + i) * dx[STAGES - 1]);
        }
        missed = 0;
        for (int i = 0; i < NG; ++i) {
            missed |= off[i] != 0.0;
        }
    }
    for (int i = 0; i < NG; i += LANES) {
        const lanes kept = load_v(b->kept + i);
        lanes rate = splat_v(0.0);
        for (int power = POWERS - 1; power > 0; --power) {
            rate = (real)power * load_v(q->c[power] + i) + load_v(finish + i) * rate;
        }
        store_v(
            m->forward + i, load_v(b->s + i) * (kept * load_v(m->left + i) + (1.0 - kept) * rate));
        store_v(m->slope + i, load_v(slope[STAGES - 1] + i));
    }
    return !missed;
}

/*
 * Whether gear i moves back along its branch at the end of a step: more than by rounding within a
 * period.
 */
static inline int returns(const branches *b, const branch_motion *m, real share, int i)
{
    const real flow = b->flow[i], least = share * (1e-3 + fabs_1(m->x[STAGES - 1][i]));
    if (!(m->forward[i] < 0.0 && b->slip[0][i] > 0.0)) {
        return 0;
    }
    return b->kept[i] > 0.0 ? flow * m->forward[i] < -least * (1.0 + flow * m->slope[i]) :
                              m->forward[i] < -least * m->slope[i];
}

/*
 * Newton's step from the part `at` of the interval to the instant at which gear i comes to rest.
 */
static inline real part_to_rest(
    const branches *b, const quintics *q, const branch_motion *m, real at, int i)
{
    real once = 0.0, twice = 0.0; /* derivatives of the torque */
    for (int power = POWERS - 1; power > 0; --power) {
        twice = once + at * twice;
        once = (real)power * q->c[power][i] + at * once;
    }
    return b->kept[i] > 0.0 ? -m->left[i] / (once - m->slope[i] * b->flow[i] * m->left[i]) :
                              -once / twice;
}

/*
 * The parts `at` of the interval at which the gears of `turned` come to rest, after `begin`, and
 * the motion until then: by Newton's method inside a bracket. m: the whole step in.
 */
static inline int locate_reversals(branches *b, const quintics *q, const real *begin,
    const real *turned, real *at, branch_motion *m, real *space)
{
    gear_lanes low, high, moved;
    int found = 0;
    for (int i = 0; i < GEARS; ++i) {
        moved[i] = 2.0;
        low[i] = at[i] = begin[i];
        high[i] = turned[i] > 0.0 ? 1.0 : begin[i];
        if (turned[i] > 0.0) {
            at[i] = 1.0;
        }
    }
    for (int step = 0; step < LOCATIONS && !found; ++step) {
        found = 1;
        for (int i = 0; i < GEARS; ++i) {
            real next;
            if (!(turned[i] > 0.0 && moved[i] > least_part)) {
                continue;
            }
            if (m->forward[i] > 0.0) {
                low[i] = at[i];
            } else {
                high[i] = at[i];
            }
            next = at[i] + part_to_rest(b, q, m, at[i], i);
            if (next < low[i] && low[i] == begin[i] && !(m->forward[i] > 0.0)) {
                next = low[i]; /* it may move back from the beginning on */
                moved[i] = at[i] - next;
            } else if (next >= low[i] && next <= high[i] &&
                       fabs_1(next - at[i]) <= 0.5 * moved[i]) {
                moved[i] = fabs_1(next - at[i]);
                moved[i] = moved[i] > last_part ? moved[i] : 0.0;
            } else { /* it may cycle */
                next = 0.5 * (low[i] + high[i]);
                moved[i] = fabs_1(next - at[i]);
            }
            found = found && moved[i] <= least_part;
            at[i] = next;
        }
        for (int i = 0; i < GEARS; ++i) {
            for (int k = 0; k < STAGES; ++k) {
                m->x[k][i] = turned[i] > 0.0 ? m->x[k][i] : b->p[i];
            }
        }
        if (!along_branches(b, q, begin, at, m, space)) {
            return 0;
        }
    }
    return found;
}

/* Advance over an interval; 0 where no deflections carry the torques. */
static inline int advance_branches(branches *b, const quintics *q, real *space)
{
    gear_lanes begin, finish;
    branch_motion m;
    int whole = 1; /* whether the last step is that of a whole interval */
    real least = least_return;
    b->passes = PASSES;
    for (int i = 0; i < NG; i += LANES) {
        store_v(begin + i, splat_v(0.0));
        store_v(finish + i, splat_v(1.0));
        for (int k = 0; k < STAGES; ++k) {
            lanes guess = b->ahead[k][0] * load_v(b->before + i);
            for (int j = 0; j < STAGES; ++j) {
                guess += b->ahead[k][1 + j] * load_v(b->x[j] + i);
            }
            store_v(m.x[k] + i, guess);
        }
    }
    for (int turns = 0; turns <= REVERSALS; ++turns) {
        gear_lanes turned, at;
        int any = 0;
        if (!along_branches(b, q, begin, finish, &m, space)) {
            return 0;
        }
        for (int i = 0; i < GEARS; ++i) {
            turned[i] = i < NG && returns(b, &m, least, i) ? 1.0 : 0.0;
            any |= turned[i] > 0.0;
        }
        if (!any) {
            for (int i = 0; i < NG; i += LANES) {
                const lanes end = load_v(m.x[STAGES - 1] + i);
                store_v(b->before + i, whole ? load_v(b->p + i) : end);
                for (int k = 0; k < STAGES; ++k) {
                    store_v(b->x[k] + i, whole ? load_v(m.x[k] + i) : end);
                }
                store_v(b->p + i, end);
            }
            return 1;
        }
        whole = 0;
        least *= 4.0; /* torques that are noise reverse again and again */
        if (!locate_reversals(b, q, begin, turned, at, &m, space)) {
            return 0;
        }
        for (int i = 0; i < NG; i += LANES) {
            const lanes end = load_v(m.x[STAGES - 1] + i), is = load_v(turned + i),
                        s = load_v(b->s + i);
            for (int e = 0; e < ELEMENTS; ++e) {
                lanes rise, z = element_torque(b, e, i, end, &rise);
                store_v(b->z_r[e] + i, select_v(is, z, load_v(b->z_r[e] + i)));
            }
            store_v(b->p_r + i, select_v(is, end, load_v(b->p_r + i)));
            store_v(b->s + i, select_v(is, -s, s));
            store_v(b->p + i, select_v(is, end, load_v(b->p + i)));
            store_v(begin + i, select_v(is, load_v(at + i), load_v(begin + i)));
        }
#if MODEL_CURVED
        for (int i = 0; i < NG; ++i) {
            if (turned[i] > 0.0) {
                restart_curves(b, i);
            }
        }
#endif /* MODEL_CURVED */
    }
    return 0;
}

/*
 * The torques become those of `q` at its start: undamped gears follow on their branches, damped
 * ones stay.
 */
static inline int correct_branches(branches *b, const quintics *q, real *space)
{
    gear_lanes start, flow;
    branch_motion m;
    copy(b->flow, GEARS, flow);
    for (int i = 0; i < GEARS; ++i) {
        start[i] = b->flow[i] = 0.0;
        for (int k = 0; k < STAGES; ++k) {
            m.x[k][i] = b->p[i];
        }
    }
    b->passes = PASSES;
    if (!along_branches(b, q, start, start, &m, space)) {
        return 0;
    }
    copy(flow, GEARS, b->flow);
    copy(m.x[0], GEARS, b->p);
    copy(m.x[0], GEARS, b->before);
    for (int k = 0; k < STAGES; ++k) {
        copy(m.x[0], GEARS, b->x[k]);
    }
    return 1;
}

/* Numbers of a gear from which its motion continues: deflection, direction, last reversal. */
enum { BRANCH = 3 + ELEMENTS };

/* Keep them in x, gear after gear for each number. */
static inline void keep_branches(const branches *b, real *x)
{
    copy(b->p, NG, x);
    copy(b->p_r, NG, x + NG);
    copy(b->s, NG, x + 2 * NG);
    for (int e = 0; e < ELEMENTS; ++e) {
        copy(b->z_r[e], NG, x + (3 + e) * NG);
    }
}

/* The gears as they were kept. */
static inline void take_branches(branches *b, const real *x)
{
    copy(x, NG, b->p);
    copy(x + NG, NG, b->p_r);
    copy(x + 2 * NG, NG, b->s);
    for (int e = 0; e < ELEMENTS; ++e) {
        copy(x + (3 + e) * NG, NG, b->z_r[e]);
    }
#if MODEL_CURVED
    for (int i = 0; i < NG; ++i) {
        restart_curves(b, i);
    }
#endif /* MODEL_CURVED */
}

/*
 * Gears whose rates are differences of the deflections: their sum is the change of speed, also
 * where a gear reverses.
 */
static inline void set_differences(gears *g, real period)
{
    g->period = period;
    g->slow = 0;
    for (int i = 0; i < NG; ++i) {
        g->quick[i] = 1;
    }
}

#endif
