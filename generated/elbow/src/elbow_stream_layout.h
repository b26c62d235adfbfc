/*
 * elbow: the memory of a stream; private. Written by flexgen from one table; see elbow.h.
 */
#ifndef ELBOW_STREAM_LAYOUT_H
#define ELBOW_STREAM_LAYOUT_H

#include "elbow_inversion_common.h"
#include "elbow_lq_step.h"
#include "elbow_motors.h"
#include "elbow_path.h"

enum {
    BACK = 2 * MARGIN, /* samples around those of an update that its derivatives need */
    LEVELS = 3, /* levels of the quasi-static motion */
    LAST = 5, /* last nodes of the path, for differences */
    JOINT = 3 * NG, /* position, speed and acceleration of the joints with motor */
    OUTPUT = 2 * NA + NG + 3 * NM, /* numbers of the results at a sample */
    MEASURES = 4, /* scales of the kinematic mismatch, see kinematic_mismatch_now */
    BLOCKS = 8, /* of constant input over the horizon, at most */
    INPUTS = BLOCKS * NY,
    MOTORS = 2 * NM, /* torques and speeds of motors at a node */
    BOUNDED = MOTORS + NY, /* and deviations */
};

/* The head of the memory of a stream: it may hold anything before the start. */
typedef struct {
    real period; /* [s] of an update */
    real tolerance; /* largest relative residual of an update */
    real delay; /* of a held torque, in samples */
    real residual; /* results of the update so far, as in the info */
    real mismatch; /* kinematic */
    real torque_step;
    real output_step[2]; /* [m], then [rad] */
    real off[2]; /* deviation from the given path [m], then [rad] */
    int32_t state; /* whether it runs, see stream_update.h */
    int32_t key; /* of the library that started it, so that no other one takes it */
    int32_t intervals; /* of the horizon */
    int32_t samples_per_interval;
    int32_t side; /* of singular poses, 1 or -1; 0: not known before the first sample */
    int32_t hold; /* of the torques between samples */
    int32_t base; /* where the factors begin, see mesh */
    int32_t stale; /* 1 where the model or the motion changed: no factor holds any more */
    int32_t part; /* of an update that has begun, what comes next; see stream.c */
    int32_t at;
    int32_t within;
    int32_t limited; /* whether limits are active in the interval */
    int32_t has_limits; /* whether it keeps limits */
    int32_t fixed; /* the last node whose deviation must not change */
    int32_t is_predicted; /* whether the update before predicted this one */
} MAY_ALIAS stream_head;

enum {
    STEP_SPACE = 224, /* reals of the space of a step */
    FUNCTION_SPACE = 904, /* reals of the space of the functions */
    HEAD = 24 /* reals before the arrays */
};

static inline stream_head *head_of(real *memory)
{
    return (stream_head *)(void *)memory;
}

static inline const stream_head *head_in(const real *memory)
{
    return (const stream_head *)(const void *)memory;
}

/* Place an array of so many reals behind those before it. */
static inline ptrdiff_t next_place(ptrdiff_t *at, ptrdiff_t size)
{
    const ptrdiff_t here = *at;
    *at += (ptrdiff_t)padded(size);
    return here;
}

/* Positions of the arrays for the limits, from the first one on. */
typedef struct {
    ptrdiff_t bound; /* the limits */
    ptrdiff_t plan; /* the given path */
    ptrdiff_t deviation; /* from it, with derivatives */
    ptrdiff_t value; /* limited quantities relative to their limits */
    ptrdiff_t q; /* planned motion and torques of the arm at the nodes */
    ptrdiff_t v;
    ptrdiff_t a;
    ptrdiff_t tau;
    ptrdiff_t deflection; /* of the gears, without damping */
    ptrdiff_t lagged; /* with it */
    ptrdiff_t response; /* of the deviation to unit inputs */
    ptrdiff_t H; /* the quadratic program, see qp */
    ptrdiff_t g;
    ptrdiff_t A;
    ptrdiff_t x;
    ptrdiff_t y;
    ptrdiff_t z;
    ptrdiff_t K;
    ptrdiff_t w;
    ptrdiff_t vv;
    ptrdiff_t b;
    ptrdiff_t dual; /* multipliers, kept from update to update */
    ptrdiff_t end;
} limits_layout;

static inline limits_layout limits_laid_out(ptrdiff_t intervals)
{
    limits_layout l;
    ptrdiff_t at = 0;
    l.bound = next_place(&at, BOUNDED);
    l.plan = next_place(&at, (intervals + 1) * REFERENCE);
    l.deviation = next_place(&at, (intervals + 1) * DEVIATION);
    l.value = next_place(&at, (intervals + 1) * BOUNDED);
    l.q = next_place(&at, (intervals + 1) * NG);
    l.v = next_place(&at, (intervals + 1) * NG);
    l.a = next_place(&at, (intervals + 1) * NG);
    l.tau = next_place(&at, (intervals + 1) * NG);
    l.deflection = next_place(&at, (intervals + 1) * NG);
    l.lagged = next_place(&at, (intervals + 1) * NG);
    l.response = next_place(&at, (intervals + 1) * CHAIN * BLOCKS);
    l.H = next_place(&at, INPUTS * INPUTS);
    l.g = next_place(&at, INPUTS);
    l.A = next_place(&at, (intervals + 1) * BOUNDED * INPUTS);
    l.x = next_place(&at, (intervals + 1) * BOUNDED);
    l.y = next_place(&at, (intervals + 1) * BOUNDED);
    l.z = next_place(&at, INPUTS);
    l.K = next_place(&at, INPUTS * INPUTS);
    l.w = next_place(&at, (intervals + 1) * BOUNDED);
    l.vv = next_place(&at, (intervals + 1) * BOUNDED);
    l.b = next_place(&at, INPUTS);
    l.dual = next_place(&at, (intervals + 1) * BOUNDED);
    l.end = at;
    return l;
}

/* Positions of the arrays of a stream. */
typedef struct {
    ptrdiff_t window; /* samples: before, of an update and its end, ahead */
    ptrdiff_t ahead;  /* samples after those of an update that held torques depend on */
    ptrdiff_t past;   /* past intervals that are kept */
    ptrdiff_t limits; /* limits, and the deviation */
    ptrdiff_t output; /* results of an update */
    ptrdiff_t last; /* sample of the path at the end of the horizon */
    ptrdiff_t tau; /* torques of the gears in the window */
    ptrdiff_t deflection; /* of the gears, without damping */
    ptrdiff_t lagged; /* with damping */
    ptrdiff_t now; /* deflections of the gears now */
    ptrdiff_t joint; /* motion of the joints in the window */
    ptrdiff_t most; /* largest values lately, of measures and torques */
    ptrdiff_t expected; /* motor torques and gear deflections that the last plan predicted */
    ptrdiff_t q_g; /* joints; the last ones: at the start of the horizon */
    ptrdiff_t reference; /* the path at the Gauss points */
    ptrdiff_t nodes; /* the path at the nodes */
    ptrdiff_t lq; /* of a step, only within a call: lq_space or problem_points */
    ptrdiff_t space; /* workspace of functions, parameters, force */
    ptrdiff_t torque; /* motor torques that held ones depend on */
    ptrdiff_t end;
} layout;

static inline layout laid_out(
    ptrdiff_t intervals, ptrdiff_t samples_per_interval, int hold, real delay)
{
    layout l;
    const ptrdiff_t ahead = is_held(hold, delay) ? HOLD_AFTER - 1 + (int)delay : 0;
    const ptrdiff_t held = ahead > 0;
    const ptrdiff_t window = 2 * BACK + samples_per_interval + 1 + ahead;
    const ptrdiff_t least = LAST - 1;
    const ptrdiff_t needed = (BACK + samples_per_interval - 1) / samples_per_interval + 1;
    const ptrdiff_t past = needed < least ? least : needed;
    ptrdiff_t at = HEAD;
    l.ahead = ahead;
    l.window = window;
    l.past = past;
    l.limits = next_place(&at, limits_laid_out(intervals).end);
    l.output = next_place(&at, samples_per_interval * OUTPUT);
    l.last = next_place(&at, REFERENCE);
    l.tau = next_place(&at, window * NG);
    l.deflection = next_place(&at, window * NG);
    l.lagged = next_place(&at, window * NG);
    l.now = next_place(&at, NG);
    l.joint = next_place(&at, window * JOINT);
    l.most = next_place(&at, MEASURES + NM);
    l.expected = next_place(&at, NM + NG);
    l.q_g = next_place(&at, (intervals * STAGES + 1) * NG);
    l.reference = next_place(&at, intervals * STAGES * REFERENCE);
    l.nodes = next_place(&at, (past + intervals + 1) * REFERENCE);
    l.lq = next_place(&at, STEP_SPACE);
    l.space = next_place(&at, FUNCTION_SPACE);
    l.torque = next_place(&at, held * (HOLD_BEFORE + samples_per_interval + ahead + 1) * NM);
    l.end = at;
    return l;
}

/* The constants are those with which flexgen computed the memory that the public header states. */
enum {
    constants_are_those_of_flexgen =
    (int)NA == 2 && (int)NG == 2 && (int)NE == 0 && (int)NM == 2 && (int)NY == 2 && (int)STAGES == 3 &&
    (int)MARGIN == 3 && (int)BLOCK == 8 && (int)CHAIN == 5 && (int)DEVIATION == 10 &&
    (int)HOLD_BEFORE == 4 && (int)HOLD_AFTER == 5 && (int)REFERENCE == 6,
    spaces_are_those_of_flexgen =
    sizeof(problem_points) == STEP_SPACE * sizeof(real) &&
    sizeof(stream_head) <= HEAD * sizeof(real)
};
typedef char memory_is_that_of_flexgen[constants_are_those_of_flexgen ? 1 : -1];
typedef char spaces_hold_what_they_must[spaces_are_those_of_flexgen ? 1 : -1];

#endif
