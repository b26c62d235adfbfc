/*
 * elbow: the memory of a stream; private to it.
 *
 * It is an array of numbers of the caller: a head, then arrays. Between two updates it holds the motion that is planned
 * over the horizon; an update shifts it by one interval, takes the next sample of the path at its end and does one
 * Gauss-Newton step.
 */
#ifndef ELBOW_STREAM_MEMORY_H
#define ELBOW_STREAM_MEMORY_H

#include "../elbow_inversion.h"

#include "elbow_limits.h"
#include "elbow_lq_step.h"

enum {
    BACK = 2 * MARGIN,             /* fine samples before and after those of an update that its derivatives need */
    LEVELS = 3,                    /* of the slow motion that the end is drawn to */
    LAST = 5,                      /* nodes of the path that tell where it goes on */
    JOINT = 3 * NG,                /* position, speed and acceleration of the joints with motor */
    OUTPUT = 2 * NA + NG + 3 * NM, /* numbers of the results at a sample */
    MEASURES = 4 /* of unevenness: accelerations of joints and motors, speeds, torques of the rotors */
};

/* What STATE says. */
enum {
    IS_EMPTY = 0,
    IS_RUNNING = 20231, /* no number that memory holds by chance */
    HAS_FAILED = 2
};

/* The head. */
enum { STATE, INTERVALS, SAMPLES_PER_INTERVAL, PERIOD, TOLERANCE, SIDE, HEAD };

/* Where the arrays stand. */
typedef struct {
    ptrdiff_t window; /* fine samples: before, of this update and its end, ahead */
    ptrdiff_t past;   /* intervals that are over and remembered */
    ptrdiff_t limits; /* bounds of the motors, and what they bend */
    ptrdiff_t output; /* results of an update that the caller does not want */
    ptrdiff_t last, tau, deflection, lagged, now, joint, most, expected, q_g, reference, nodes, lq, space, end;
    ptrdiff_t y, a, a_node, factor, scale, aim, cost, levels;
} layout;

static inline layout laid_out(int intervals, int samples_per_interval)
{
    layout l;
    ptrdiff_t at = (ptrdiff_t)room(HEAD);
    l.window = BACK + (ptrdiff_t)samples_per_interval + 1 + BACK;
    l.past = (BACK + samples_per_interval - 1) / samples_per_interval + 1;
    l.past = l.past < LAST - 1 ? LAST - 1 : l.past;
#define PLACE(name, size) \
    l.name = at; \
    at += (ptrdiff_t)room(size)
    PLACE(limits, limits_laid_out(intervals).end);
    PLACE(output, (ptrdiff_t)samples_per_interval * OUTPUT);
    PLACE(last, REFERENCE);
    PLACE(tau, l.window * NG);
    PLACE(deflection, l.window * NG);
    PLACE(lagged, l.window * NG);
    PLACE(now, NG);
    PLACE(joint, l.window * JOINT);
    PLACE(most, MEASURES + NM);
    PLACE(expected, 1 + NM); /* whether anything is, and the motor torques at the end of the interval before */
    PLACE(q_g, ((ptrdiff_t)intervals * STAGES + 1) * NG); /* the last ones: joints at the start of the horizon */
    PLACE(reference, (ptrdiff_t)intervals * STAGES * REFERENCE);
    PLACE(nodes, (l.past + intervals + 1) * REFERENCE);
#if ELBOW_NE > 0
    PLACE(y, (l.past + intervals + 1) * STATES);
    PLACE(a, (l.past + intervals) * CONTROLS);
    PLACE(a_node, (l.past + intervals + 1) * NE);
    PLACE(factor, (ptrdiff_t)intervals * CONTROLS * WIDTH);
    PLACE(scale, NE);
    PLACE(levels, LEVELS * LAST * NE);
    PLACE(cost, STATES * STATES);
    PLACE(aim, ((ptrdiff_t)intervals + 1) * STATES);
    PLACE(lq, (ptrdiff_t)(sizeof(lq_space) / sizeof(real)));
#else
    l.y = l.a = l.a_node = l.factor = l.scale = l.aim = l.cost = l.levels = 0;
    PLACE(lq, (ptrdiff_t)(sizeof(problem_points) / sizeof(real)));
#endif
    PLACE(space, space_wanted());
#undef PLACE
    l.end = at;
    return l;
}

static inline int stream_sizes_fit(const elbow_stream_options *o)
{
    return o->intervals >= 1 && o->intervals <= ELBOW_STREAM_INTERVALS_MAX && o->samples_per_interval >= 1 &&
           o->samples_per_interval <= ELBOW_STREAM_SAMPLES_MAX;
}

/* Whether memory holds a stream that was started and has not failed; it may hold anything. */
static inline int is_running(const real *stream)
{
    return stream[STATE] == IS_RUNNING && stream[INTERVALS] >= 1.0 && stream[INTERVALS] <= ELBOW_STREAM_INTERVALS_MAX &&
           stream[SAMPLES_PER_INTERVAL] >= 1.0 && stream[SAMPLES_PER_INTERVAL] <= ELBOW_STREAM_SAMPLES_MAX;
}

#if ELBOW_NE > 0
/* The horizon as a mesh; what is over stands before its first node. */
static inline mesh mesh_of(const layout *l, real *s)
{
    mesh m;
    m.N = (int)s[INTERVALS];
    m.h = s[PERIOD];
    m.y = s + l->y + l->past * STATES;
    m.a = s + l->a + l->past * CONTROLS;
    m.q_g = s + l->q_g;
    m.reference = s + l->reference;
    m.aim = s + l->aim;
    m.equilibrium = NULL;
    m.factor = s + l->factor;
    m.scale = s + l->scale;
    /*
     * The node where the horizon begins cannot be changed. What has gone wrong there grows like the unstable zeros, and
     * must cost something at the end. The cost to go of the horizon before is just that: it is next to nothing where
     * errors fade, and weighs what has to be mended.
     */
    m.end = s + l->cost;
    m.residual = 0.0;
    return m;
}
#endif

/* POINTS instants of the arm, which only serve within a call. */
static inline problem_points *arm_of(const layout *l, real *s)
{
#if ELBOW_NE > 0
    return &((lq_space *)(void *)(s + l->lq))->arm;
#else
    return (problem_points *)(void *)(s + l->lq);
#endif
}

#endif
