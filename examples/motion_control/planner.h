/*
 * The path planner of motion_control.c: interpolator and stream.
 *
 * The interpolator samples the path of the program every 5 ms, a horizon ahead. The stream turns
 * the samples into motor angles, speeds and torques at 1 kHz. One update of the stream takes
 * longer than a cycle should: it is done in five parts, one in each cycle. The results go into a
 * ring buffer, from which the controller takes one sample per cycle; `READY` samples stay in it,
 * so that the controller can brake along the path. In the last cycle of an update it has taken
 * `PARTS - 1` of them, and if this update fails, none follow: it may use the samples up to k +
 * READY - PARTS.
 */
#ifndef PLANNER_H
#define PLANNER_H

#include "robot.h"

#include <math.h>
#include <string.h>

enum {
    NA = SIZE(NA),
    NG = SIZE(NG),
    NM = SIZE(NM),
    NY = SIZE(NY),
    NT = SIZE(NT),
    PARTS = 5,                /* cycles per update */
    READY = 6 * PARTS,        /* samples that are ready ahead of the controller */
    RING = READY + 2 * PARTS, /* samples of the buffer */
    MEMORY = (int)SIZE(STREAM_SIZE)(INTERVALS, PARTS),
    /* enough for the interpolator and for all functions of one point */
    WORK = 2 * SIZE(BATCH_WORK),
    NOT_IN_BUFFER = -1000, /* statuses of this program, not of the library */
    /* a path or a reference that jumps, or is too fast for a motor */
    BAD_REFERENCE = NOT_IN_BUFFER - 6
};

static const double CYCLE = 1e-3; /* s */
static const double LATE = 1.0;   /* cycles from a measurement to the torque */
/* m, rad: of the path, beyond what its derivatives say; 1e-9 is usual */
static const double PATH_STEP = 1e-5;

typedef struct {
    CALL(stream) stream; /* in `memory` */
    double memory[MEMORY], work[WORK];
    double q_m[RING][NM], v_m[RING][NM], tau_m[RING][NM];
    double q_start[NA];     /* arm coordinates at the start, with their deflections */
    int64_t updates, ready; /* updates that have begun; samples that were written */
    int64_t warnings;       /* updates with TOLERANCE_NOT_MET */
    double y[3][NT];        /* last sample of the path, and its derivatives */
    int status;             /* negative: path or stream have failed, no sample follows */
} planner;

/* Time of the path at sample k of the stream [s]: the path begins after a horizon. */
static double path_time(int64_t k)
{
    return CYCLE * (double)(k - (INTERVALS - 1) * PARTS);
}

/*
 * Whether a sample of the path follows the last one, by Euler and Maclaurin: the change of y is T
 * (dy_0 + dy_1)/2 + T^2 (ddy_0 - ddy_1)/12. Only positions where the output has a rotation matrix.
 */
static int path_follows(planner *p, const double *y, const double *dy, const double *ddy)
{
    const double T = PARTS * CYCLE;
    const int n = NT == NY ? NY : 3;
    int follows = 1;
    for (int i = 0; i < n; ++i) {
        const double change = T * (0.5 * (dy[i] + p->y[1][i]) + T / 12.0 * (p->y[2][i] - ddy[i]));
        follows = follows && fabs(y[i] - p->y[0][i] - change) <= PATH_STEP; /* not for NaN */
        p->y[0][i] = y[i];
        p->y[1][i] = dy[i];
        p->y[2][i] = ddy[i];
    }
    return follows;
}

/* The path sample at the end of the horizon goes to the stream. */
static void begin_update(planner *p)
{
    double y[NT], dy[NY], ddy[NY];
    p->updates += 1;
    p->status = CALL(path_sample)(
        path_table, path_size, CYCLE * PARTS * (double)p->updates, y, dy, ddy, p->work, WORK);
    if (p->status >= SIZE(OK) && !path_follows(p, y, dy, ddy)) {
        p->status = BAD_REFERENCE;
    }
    if (p->status >= SIZE(OK)) {
        p->status = CALL(stream_begin)(&p->stream, y, dy, ddy);
    }
}

/* The samples of an update that is complete go to the ring buffer. */
static void finish_update(planner *p)
{
    double q_a[PARTS * NA], q_m[PARTS * NM], v_m[PARTS * NM], tau_m[PARTS * NM];
    CALL(motion) motion = {.q_a = q_a, .q_m = q_m, .v_m = v_m, .tau_m = tau_m};
    CALL(stream_info) info;
    p->status = CALL(stream_finish)(&p->stream, &motion, &info);
    if (p->status < SIZE(OK)) {
        return;
    }
    if (p->ready == 0) {
        memcpy(p->q_start, q_a, sizeof p->q_start);
    }
    p->warnings += p->status == SIZE(TOLERANCE_NOT_MET);
    for (int i = 0; i < PARTS; ++i, ++p->ready) {
        memcpy(p->q_m[p->ready % RING], q_m + i * NM, sizeof p->q_m[0]);
        memcpy(p->v_m[p->ready % RING], v_m + i * NM, sizeof p->v_m[0]);
        memcpy(p->tau_m[p->ready % RING], tau_m + i * NM, sizeof p->tau_m[0]);
    }
}

/* Start at rest where the path begins, with READY samples in the buffer. */
static int start_planner(planner *p)
{
    const CALL(stream_options) options = {
        .intervals = INTERVALS,
        .samples_per_interval = PARTS,
        .period = PARTS * CYCLE,
        .tolerance = TOLERANCE,
        .hold = SIZE(HOLD_ZOH),
        .delay = LATE,
    };
    double y[NT], dy[NY], ddy[NY], q_start[NA], duration;
    memset(p, 0, sizeof *p);
    p->stream.memory = p->memory;
    p->stream.size = MEMORY;
    if (CALL(path_work)() > WORK || CALL(stream_work)(&options) > MEMORY) {
        return SIZE(WORK_TOO_SMALL);
    }
    p->status = CALL(path_start)(path_table, path_size, &duration, q_start);
    if (p->status == SIZE(OK)) {
        p->status = CALL(path_sample)(path_table, path_size, 0.0, y, dy, ddy, p->work, WORK);
    }
    if (p->status == SIZE(OK)) {
        (void)path_follows(p, y, dy, ddy);
        p->status = CALL(stream_start)(&p->stream, &options, y, q_start);
    }
    while (p->status >= SIZE(OK) && p->ready < READY) {
        begin_update(p);
        if (p->status >= SIZE(OK)) {
            finish_update(p);
        }
    }
    return p->status;
}

/* In cycle k: one part of the update whose samples are complete at the end of its fifth cycle. */
static void advance_planner(planner *p, int64_t k)
{
    const int part = (int)(k % PARTS);
    if (p->status < SIZE(OK)) {
        return;
    }
    if (part == 0) {
        begin_update(p);
    }
    if (p->status >= SIZE(OK)) {
        p->status = CALL(stream_advance)(&p->stream, PARTS - part);
    }
    if (p->status >= SIZE(OK) && part == PARTS - 1) {
        finish_update(p);
    }
}

/*
 * Motor angles at the time s [samples], between samples of the buffer, and their first and second
 * derivative with respect to s: a cubic through angles and speeds. NOT_IN_BUFFER, and no result,
 * where the buffer does not have both.
 */
static int motors_between(const planner *p, double s, double *q, double *dq, double *ddq)
{
    const int64_t k = (int64_t)floor(s);
    const double x = s - (double)k;
    if (k < 0 || k < p->ready - RING || k + 1 >= p->ready) {
        return NOT_IN_BUFFER;
    }
    for (int j = 0; j < NM; ++j) {
        const double a = p->q_m[k % RING][j], b = p->q_m[(k + 1) % RING][j];
        const double u = CYCLE * p->v_m[k % RING][j], w = CYCLE * p->v_m[(k + 1) % RING][j];
        const double c = 3.0 * (b - a) - 2.0 * u - w, d = u + w - 2.0 * (b - a);
        q[j] = a + x * (u + x * (c + x * d));
        dq[j] = u + x * (2.0 * c + 3.0 * x * d);
        ddq[j] = 2.0 * c + 6.0 * x * d;
    }
    return SIZE(OK);
}

#endif
