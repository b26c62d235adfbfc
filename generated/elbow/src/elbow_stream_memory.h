/*
 * elbow: the memory of a stream; private to it.
 *
 * An array of numbers of the caller: a head, then arrays. Between two updates it holds the planned motion over the
 * horizon. An update shifts it by one interval, takes the next sample of the path at its end and makes one Gauss-Newton
 * step.
 */
#ifndef ELBOW_STREAM_MEMORY_H
#define ELBOW_STREAM_MEMORY_H

#include "../elbow_inversion.h"

#include "elbow_hold.h"
#include "elbow_limits.h"
#include "elbow_lq_step.h"

enum {
    BACK = 2 * MARGIN,             /* samples before and after those of an update that its derivatives need */
    LEVELS = 3,                    /* levels of the quasi-static motion */
    LAST = 5,                      /* last nodes of the path, for differences */
    JOINT = 3 * NG,                /* position, speed and acceleration of the joints with motor */
    OUTPUT = 2 * NA + NG + 3 * NM, /* numbers of the results at a sample */
    /* scales of the kinematic mismatch: accelerations of joints and motors, speeds, torques of the rotors */
    MEASURES = 4
};

/* Values of STATE. */
enum {
    IS_EMPTY = 0,
    IS_RUNNING = 20231, /* a number that memory hardly holds by chance */
    HAS_FAILED = 2
};

/* The head. */
/* BASE: see mesh; STALE: 1 where the model or the motion has changed, so that no factor holds any more */
/* PART, AT, WITHIN: what an update that has begun does next, see stream_parts.h; the rest: its results so far */
enum {
    STATE,
    INTERVALS,
    SAMPLES_PER_INTERVAL,
    PERIOD,
    TOLERANCE,
    SIDE,
    HOLD,
    DELAY,
    BASE,
    STALE,
    PART,
    AT,
    WITHIN,
    RESIDUAL,
    MISMATCH,
    TORQUE_STEP,
    OUTPUT_STEP,           /* [m], then [rad] */
    OFF = OUTPUT_STEP + 2, /* deviation from the given path [m], then [rad] */
    LIMITED = OFF + 2,
    HEAD
};

/* Positions of the arrays. */
typedef struct {
    ptrdiff_t window; /* samples: before, of this update and its end, ahead */
    ptrdiff_t ahead;  /* samples after those of this update that held torques depend on */
    ptrdiff_t past;   /* past intervals that are kept */
    ptrdiff_t limits; /* limits of the motors, and the deviation */
    ptrdiff_t output; /* results of an update that the caller does not want */
    ptrdiff_t last, tau, deflection, lagged, now, joint, most, expected, q_g, reference, nodes, lq, space, end;
    ptrdiff_t torque; /* motor torques that held ones depend on: HOLD_BEFORE samples, those of this update, ahead */
    ptrdiff_t y, a, a_node, factor, point, costs, row, linear, scale, target_state, cost, levels;
} layout;

static inline layout laid_out(int intervals, int samples_per_interval, real hold, real delay)
{
    layout l;
    ptrdiff_t at = (ptrdiff_t)padded(HEAD);
    l.ahead = is_held(hold, delay) ? HOLD_AFTER - 1 + (int)delay : 0;
    l.window = BACK + (ptrdiff_t)samples_per_interval + 1 + BACK + l.ahead;
    l.past = (BACK + samples_per_interval - 1) / samples_per_interval + 1;
    l.past = l.past < LAST - 1 ? LAST - 1 : l.past;
#define PLACE(name, size) \
    l.name = at; \
    at += (ptrdiff_t)padded(size)
    PLACE(limits, limits_laid_out(intervals).end);
    PLACE(output, (ptrdiff_t)samples_per_interval * OUTPUT);
    PLACE(last, REFERENCE);
    PLACE(tau, l.window * NG);
    PLACE(deflection, l.window * NG);
    PLACE(lagged, l.window * NG);
    PLACE(now, NG);
    PLACE(joint, l.window * JOINT);
    PLACE(most, MEASURES + NM);
    /* 1 where there is a prediction; predicted motor torques and gear deflections at the end of the interval before */
    PLACE(expected, 1 + NM + NG);
    PLACE(q_g, ((ptrdiff_t)intervals * STAGES + 1) * NG); /* the last ones: joints at the start of the horizon */
    PLACE(reference, (ptrdiff_t)intervals * STAGES * REFERENCE);
    PLACE(nodes, (l.past + intervals + 1) * REFERENCE);
#if ELBOW_NE > 0
    PLACE(y, (l.past + intervals + 1) * STATES);
    PLACE(a, (l.past + intervals) * CONTROLS);
    PLACE(a_node, (l.past + intervals + 1) * NE);
    PLACE(factor, (ptrdiff_t)intervals * CONTROLS * WIDTH);
    PLACE(point, (ptrdiff_t)intervals * STAGES * POINT + BLOCK); /* data of the factors, in the same order */
    PLACE(costs, (ptrdiff_t)intervals * STATES * STATES);        /* costs to go of their first nodes */
    PLACE(row, (ptrdiff_t)intervals * STAGES * NE);              /* residuals */
    PLACE(linear, (ptrdiff_t)intervals * CONTROLS);              /* right sides of the factors */
    PLACE(scale, NE);
    PLACE(levels, LEVELS * LAST * NE);
    PLACE(cost, STATES * STATES);
    PLACE(target_state, ((ptrdiff_t)intervals + 1) * STATES);
    PLACE(lq, (ptrdiff_t)(sizeof(lq_space) / sizeof(real)));
#else
    l.point = l.costs = l.row = l.linear = 0;
    l.y = l.a = l.a_node = l.factor = l.scale = l.target_state = l.cost = l.levels = 0;
    PLACE(lq, (ptrdiff_t)(sizeof(problem_points) / sizeof(real)));
#endif
    PLACE(space, function_work());
    PLACE(torque, l.ahead > 0 ? (HOLD_BEFORE + samples_per_interval + l.ahead + 1) * NM : 0);
#undef PLACE
    l.end = at;
    return l;
}

static inline int stream_sizes_fit(const elbow_stream_options *o)
{
    return o->intervals >= 1 && o->intervals <= ELBOW_STREAM_INTERVALS_MAX && o->samples_per_interval >= 1 &&
           o->samples_per_interval <= ELBOW_STREAM_SAMPLES_MAX && hold_fits((real)o->hold, o->delay);
}

/* Whether memory holds a stream that was started and has not failed; it may hold anything. */
static inline int is_running(const real *stream)
{
    return stream[STATE] == IS_RUNNING && stream[INTERVALS] >= 1.0 && stream[INTERVALS] <= ELBOW_STREAM_INTERVALS_MAX &&
           stream[SAMPLES_PER_INTERVAL] >= 1.0 && stream[SAMPLES_PER_INTERVAL] <= ELBOW_STREAM_SAMPLES_MAX &&
           hold_fits(stream[HOLD], stream[DELAY]);
}

/* The layout of a running stream. */
static inline layout layout_of(const real *stream)
{
    return laid_out((int)stream[INTERVALS], (int)stream[SAMPLES_PER_INTERVAL], stream[HOLD], stream[DELAY]);
}

#if ELBOW_NE > 0
/* The horizon as a mesh; past nodes are stored before its first node. */
static inline mesh mesh_of(const layout *l, real *s)
{
    mesh m;
    m.N = (int)s[INTERVALS];
    m.h = s[PERIOD];
    m.y = s + l->y + l->past * STATES;
    m.a = s + l->a + l->past * CONTROLS;
    m.q_g = s + l->q_g;
    m.reference = s + l->reference;
    m.target_state = s + l->target_state;
    m.equilibrium = NULL;
    m.varying = m.factored = m.N;
    m.factor = s + l->factor;
    m.base = (int)s[BASE];
    m.scale = s + l->scale;
    /*
     * The first node of the horizon cannot be changed. Its error grows like the unstable zeros and must have a cost at
     * the end: the cost to go of the horizon before, which is close to zero for stable errors.
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
