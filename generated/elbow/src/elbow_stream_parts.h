/*
 * elbow: the parts of an update, one after the other; private to the stream.
 *
 * An update that has begun may be interrupted after each part: all that the next part needs is in the memory of the
 * stream. The results do not depend on where it was interrupted.
 */
#ifndef ELBOW_STREAM_PARTS_H
#define ELBOW_STREAM_PARTS_H

#include "elbow_limit_lookahead.h"
#include "elbow_stream_output.h"
#include "elbow_stream_step.h"

/*
 * Kinds of parts, in their order. PART_RESIDUAL: for each POINTS Gauss points; PART_POINTS: for each GROUP intervals
 * whose factors are computed again, then PART_FACTOR for each of them.
 */
enum {
    NO_UPDATE,
#if ELBOW_NE > 0
    PART_SHIFT,
    PART_RESIDUAL,
    PART_POINTS,
    PART_FACTOR,
    PART_LINEAR,
    PART_STEP,
#endif
    PART_ARM,
    PART_MOTORS,
    PART_LIMITS,
    PARTS_END
};

/* The part that is next. at: Gauss point, or intervals before those of the group; within: interval in the group. */
typedef struct {
    int part, at, within;
} update_part;

static inline update_part next_part_of(const real *s)
{
    const update_part p = {(int)s[PART], (int)s[AT], (int)s[WITHIN]};
    return p;
}

#if ELBOW_NE > 0
/* Intervals of the group from `next` on; `*next` becomes that after it. */
static inline int group_from(const real *s, int *next, int *list)
{
    return refreshed((int)s[INTERVALS], s[STALE] > 0.0, next, list);
}
#endif

/*
 * Approximate cost of a part: microseconds with 6 motors and 12 coordinates without motor on a processor with vectors
 * of 8 numbers. Only the distribution of the work depends on it.
 */
static inline int cost_of_part(const real *s, const layout *l, update_part p)
{
    static const int cost[PARTS_END] = {0,
#if ELBOW_NE > 0
        47, 4, 5, 7, 15, 15,
#endif
        20, 5, 60};
#if ELBOW_NE > 0
    if (p.part == PART_POINTS) { /* for each interval */
        int list[GROUP], next = p.at;
        return cost[p.part] * group_from(s, &next, list);
    }
#endif
    return p.part == PART_LIMITS && !(s[l->limits] > 0.0) ? 0 : cost[p.part];
}

/* The part after p. */
static inline update_part part_after(const real *s, update_part p)
{
#if ELBOW_NE > 0
    if (p.part == PART_RESIDUAL && p.at + POINTS < (int)s[INTERVALS] * STAGES) {
        p.at += POINTS;
        return p;
    }
    if (p.part == PART_FACTOR) {
        int list[GROUP], next = p.at;
        const int count = group_from(s, &next, list);
        if (p.within + 1 < count) {
            p.within += 1;
            return p;
        }
        if (count == GROUP && next < (int)s[INTERVALS]) {
            p.part = PART_POINTS;
            p.at = next;
            p.within = 0;
            return p;
        }
    }
#else
    (void)s;
#endif
    p.part += 1;
    if (p.part != PARTS_END
#if ELBOW_NE > 0
        && p.part != PART_FACTOR
#endif
    ) {
        p.at = p.within = 0;
    }
    return p;
}

/* Cost of all parts from p to the end of the update. */
static inline int cost_from(const real *s, const layout *l, update_part p)
{
    int cost = 0;
    for (; p.part != PARTS_END; p = part_after(s, p)) {
        cost += cost_of_part(s, l, p);
    }
    return cost;
}

/* Arrays of the results in the memory of the stream. */
static inline interval_results results_in(real *s, const layout *l)
{
    const ptrdiff_t n = (ptrdiff_t)s[SAMPLES_PER_INTERVAL];
    interval_results out;
    out.q_a = s + l->output;
    out.v_a = out.q_a + n * NA;
    out.tau_g = out.v_a + n * NA;
    out.q_m = out.tau_g + n * NG;
    out.v_m = out.q_m + n * NM;
    out.tau_m = out.v_m + n * NM;
    return out;
}

/* Limits of the motors: what they do now, and the change of the path ahead. */
static inline int limits_part(real *s, const layout *l, const interval_results *out)
{
    real off[2] = {0.0, 0.0};
    int ends;
    if (!(s[l->limits] > 0.0)) {
        return ELBOW_OK;
    }
    s[LIMITED] = (real)is_limited(s, l, out->v_m, out->tau_m, off, &ends);
    copy(off, 2, s + OFF);
    return ends ? ELBOW_LIMITS_INFEASIBLE : apply_limits(s, l);
}

/* Motors in the interval. */
static inline int motors_part(real *s, const layout *l, const interval_results *out)
{
    real step = 0.0, output_step[2] = {0.0, 0.0};
    const int status = motors_in_interval(s, l, out, &step, output_step);
    if (status == ELBOW_OK) {
        s[TORQUE_STEP] = step;
        copy(output_step, 2, s + OUTPUT_STEP);
        s[MISMATCH] = kinematic_mismatch_now(s, l);
    }
    return status;
}

/* Do the part p. */
static inline int do_part(real *s, const layout *l, update_part p)
{
    const interval_results out = results_in(s, l);
    switch (p.part) {
#if ELBOW_NE > 0
    case PART_SHIFT:
        return shift_motion(s, l);
    case PART_RESIDUAL:
        return residual_part(s, l, p.at);
    case PART_POINTS:
    case PART_FACTOR: {
        int list[GROUP], next = p.at;
        const int count = group_from(s, &next, list);
        if (p.part == PART_FACTOR) {
            return refresh_factor(s, l, list[p.within]);
        }
        if (p.at == 0) {
            begin_points(arm_of(l, s));
        }
        return refresh_points(s, l, list, count);
    }
    case PART_LINEAR:
        return linear_part(s, l);
    case PART_STEP:
        step_part(s, l);
        return ELBOW_OK;
#endif
    case PART_ARM:
        return arm_in_window(s, l, &out, s + RESIDUAL);
    case PART_MOTORS:
        return motors_part(s, l, &out);
    default:
        return limits_part(s, l, &out);
    }
}

/* Do about 1/parts of what is left of the update; all of it where parts is 1. */
static inline int do_parts(real *s, const layout *l, int parts)
{
    update_part p = next_part_of(s);
    const int share = parts > 1 ? cost_from(s, l, p) / parts : 0;
    int done = 0, status = ELBOW_OK;
    while (status == ELBOW_OK && p.part != PARTS_END &&
           (parts == 1 || done == 0 || 2 * done + cost_of_part(s, l, p) <= 2 * share)) {
        status = do_part(s, l, p);
        done += cost_of_part(s, l, p);
        p = part_after(s, p);
        s[PART] = (real)p.part;
        s[AT] = (real)p.at;
        s[WITHIN] = (real)p.within;
    }
    return status;
}

#endif
