/*
 * A controller that tracks a path of the tool by inverse dynamics on a moving horizon, on the
 * generated library of the planar arm `planar5_nmp`. Its elastic joint has no motor and makes the
 * tool non-minimum phase.
 *
 * Every 5 ms the controller gives the stream the sample of the path for 100 ms later. The stream
 * returns torques and motor angles for the next 5 ms. Every millisecond a PD law on the motors
 * adds the torque that keeps them on these angles. The plant is the forward dynamics of the
 * library, integrated by the classical Runge-Kutta method. The program prints the largest path
 * error of the tool in four runs. (The remaining error comes from the torque that is held for a
 * millisecond; a quarter of this cycle leaves a sixteenth of the error.)
 *
 *   stream      correct operation
 *   late        the torque comes one update late, a planted error
 *   refused     once the path has a sample out of reach: it is refused, and replaced
 *   jump        the path jumps by a centimeter, which no torque can track: the controller stops
 *               the motors
 *
 *   flexgen generate planar5_nmp
 *   cd generated/planar5_nmp
 *   cc -std=c99 -O2 -ffp-contract=off -I. ../../examples/stream.c $(find src -name '*.c') -lm -o
 *     stream && ./stream
 */
#include "planar5_nmp_inversion.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define NA PLANAR5_NMP_NA
#define NG PLANAR5_NMP_NG
#define NM PLANAR5_NMP_NM
#define NY PLANAR5_NMP_NY
#define N (2 * NA + 2 * NM) /* state of the plant: q_a, v_a, q_m, v_m */

enum {
    INTERVALS = 20,     /* intervals of the horizon: 100 ms */
    CYCLES = 5,         /* cycles of the motor control per update */
    PARTS = 2 * CYCLES, /* samples per update: at the beginning of a cycle, and in its middle */
    STEPS = 10,         /* integration steps of the plant per cycle */
    MEMORY = (int)PLANAR5_NMP_STREAM_SIZE(INTERVALS, PARTS) /* numbers */
};

static const double UPDATE = 5e-3, CYCLE = 1e-3; /* s */
/* relative residual; above it: TOLERANCE_NOT_MET */
static const double TOLERANCE = 1e-3;
static const double STOP = 20e-3;          /* s: time constant of a stop of the motors */
static const double KP[NM] = {30.0, 20.0}; /* N m/rad, motor side */
static const double KD[NM] = {0.7, 0.5};   /* N m s/rad, motor side */
/* rad: near the pose at the start of the path */
static const double GUESS[NA] = {0.3, -1.1, 0.0};
static const double WAY[2] = {-0.20, 0.21};        /* m: of the tool */
static const double DURATION = 0.5, SETTLE = 0.15; /* s */
/* s: time of the error in the path of two runs */
static const double MISHAP = 0.25;

typedef enum { RUNNING, STOPPING } controller_state;
typedef enum { NOTHING, LATE_TORQUE, UNREACHABLE_SAMPLE, JUMP } planted_mistake;

typedef struct {
    planar5_nmp_stream stream;
    double memory[MEMORY]; /* of the stream */
    double start[NY];      /* m: where the path begins */
    controller_state state;
    double q_a[PARTS * NA], v_a[PARTS * NA], tau_g[PARTS * NG], q_m[PARTS * NM], v_m[PARTS * NM],
        tau_m[PARTS * NM];
    double before[PARTS * NM]; /* N m: torques of the update before */
    planar5_nmp_stream_info info;
} controller;

/*
 * The path at time t: a line, by a polynomial from rest to rest with five continuous derivatives.
 */
static void line(double t, const double start[NY], double y[NY], double dy[NY], double ddy[NY])
{
    const double s = t <= 0.0 ? 0.0 : t < DURATION ? t / DURATION : 1.0, r = 1.0 - s;
    const double p = pow(s, 6) *
                     (462.0 +
                         s * (-1980.0 + s * (3465.0 + s * (-3080.0 + s * (1386.0 - 252.0 * s)))));
    const double dp = 2772.0 * pow(s * r, 5) / DURATION;
    const double ddp = 13860.0 * pow(s * r, 4) * (r - s) / (DURATION * DURATION);
    for (int i = 0; i < NY; ++i) {
        y[i] = start[i] + WAY[i] * p;
        dy[i] = WAY[i] * dp;
        ddy[i] = WAY[i] * ddp;
    }
}

static int refuses(int status)
{
    return status == PLANAR5_NMP_INPUT_NOT_FINITE || status == PLANAR5_NMP_BAD_ARGUMENT ||
           status == PLANAR5_NMP_UNREACHABLE;
}

/* Start at rest, with the tool at the start of the path. */
static int start(controller *c)
{
    double p[3], R[9];
    const planar5_nmp_stream_options options = {
        .intervals = INTERVALS,
        .samples_per_interval = PARTS,
        .period = UPDATE,
        .tolerance = TOLERANCE,
        .hold = PLANAR5_NMP_HOLD_SPLINE,
    };
    int status = planar5_nmp_forward_kinematics(GUESS, p, R);
    memset(c, 0, sizeof *c);
    if (status != PLANAR5_NMP_OK) {
        return status;
    }
    if (planar5_nmp_stream_work(&options) > MEMORY) {
        return PLANAR5_NMP_WORK_TOO_SMALL;
    }
    for (int i = 0; i < NY; ++i) {
        c->start[i] = p[i];
    }
    c->state = RUNNING;
    c->stream.memory = c->memory;
    c->stream.size = MEMORY;
    return planar5_nmp_stream_start(&c->stream, &options, c->start, GUESS);
}

/* References of a stop: the motors slow down. */
static void stop(controller *c)
{
    const double h = UPDATE / PARTS;
    double q[NM], v[NM], tau[NM];
    memcpy(q, c->q_m + (PARTS - 1) * NM, sizeof q);
    memcpy(v, c->v_m + (PARTS - 1) * NM, sizeof v);
    memcpy(tau, c->tau_m + (PARTS - 1) * NM, sizeof tau);
    for (int k = 0; k < PARTS; ++k) {
        for (int j = 0; j < NM; ++j) {
            q[j] += h * v[j];
            v[j] -= h / STOP * v[j];
            c->q_m[k * NM + j] = q[j];
            c->v_m[k * NM + j] = v[j];
            c->tau_m[k * NM + j] = tau[j];
        }
    }
}

/* Every 5 ms: the sample of the path at t in, torques and references of the next 5 ms out. */
static void update(controller *c, double t, planted_mistake mistake)
{
    double y[NY], dy[NY], ddy[NY], tau_m[PARTS * NM], q_m[PARTS * NM], v_m[PARTS * NM];
    planar5_nmp_motion motion = {
        .q_a = c->q_a, .v_a = c->v_a, .tau_g = c->tau_g, .q_m = q_m, .v_m = v_m, .tau_m = tau_m};
    int status = PLANAR5_NMP_OK;
    memcpy(c->before, c->tau_m, sizeof c->before);
    if (c->state == STOPPING) {
        stop(c);
        return;
    }
    line(t, c->start, y, dy, ddy);
    if (mistake == JUMP && t > MISHAP) {
        y[0] -= 0.01;
    }
    if (mistake == UNREACHABLE_SAMPLE && fabs(t - MISHAP) < 0.5 * UPDATE) {
        y[0] += 100.0;
    }
    for (int attempt = 0; attempt < 2; ++attempt) {
        status = planar5_nmp_stream_update(&c->stream, y, dy, ddy, &motion, &c->info);
        if (!refuses(status)) {
            break;
        }
        printf("  sample at t = %.3f s refused: %s\n", t, planar5_nmp_status_text(status));
        line(t, c->start, y, dy, ddy); /* the stream has not changed: give another sample */
    }
    if (status != PLANAR5_NMP_OK) { /* do not use these torques */
        printf("  sample at t = %.3f s: %s; stopping\n", t, planar5_nmp_status_text(status));
        c->state = STOPPING;
        stop(c);
        return;
    }
    memcpy(c->q_m, q_m, sizeof q_m);
    memcpy(c->v_m, v_m, sizeof v_m);
    memcpy(c->tau_m, tau_m, sizeof tau_m);
}

/*
 * Every millisecond: the torque of the middle of the cycle, and a correction from the measured
 * motors.
 */
static void control(const controller *c, int cycle, planted_mistake mistake, const double q_m[NM],
    const double v_m[NM], double tau_m[NM])
{
    const double *fed = (mistake == LATE_TORQUE ? c->before : c->tau_m) + (2 * cycle + 1) * NM;
    const double *q_ref = c->q_m + 2 * cycle * NM, *v_ref = c->v_m + 2 * cycle * NM;
    for (int j = 0; j < NM; ++j) {
        tau_m[j] = fed[j] + KP[j] * (q_ref[j] - q_m[j]) + KD[j] * (v_ref[j] - v_m[j]);
    }
}

/* dx/dt of the plant. */
static int plant(const double x[N], const double tau_m[NM], double dx[N])
{
    const double *q_a = x, *v_a = x + NA, *q_m = x + 2 * NA, *v_m = x + 2 * NA + NM;
    memcpy(dx, v_a, NA * sizeof *dx);
    memcpy(dx + 2 * NA, v_m, NM * sizeof *dx);
    return planar5_nmp_forward_dynamics(q_a, v_a, q_m, v_m, tau_m, dx + NA, dx + 2 * NA + NM);
}

/* One Runge-Kutta step of the plant. */
static int step(double h, const double tau_m[NM], double x[N])
{
    static const double WHERE[4] = {0.0, 0.5, 0.5, 1.0},
                        WEIGHT[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    double at[N], dx[N] = {0.0}, sum[N] = {0.0};
    for (int stage = 0; stage < 4; ++stage) {
        int status;
        for (int i = 0; i < N; ++i) {
            at[i] = x[i] + h * WHERE[stage] * dx[i];
        }
        status = plant(at, tau_m, dx);
        if (status != PLANAR5_NMP_OK) {
            return status;
        }
        for (int i = 0; i < N; ++i) {
            sum[i] += WEIGHT[stage] * dx[i];
        }
    }
    for (int i = 0; i < N; ++i) {
        x[i] += h * sum[i];
    }
    return PLANAR5_NMP_OK;
}

/* Distance of the tool of the plant from the path at time t [m]. */
static int distance(const double x[N], const double from[NY], double t, double *away)
{
    double p[3], R[9], y[NY], dy[NY], ddy[NY];
    const int status = planar5_nmp_forward_kinematics(x, p, R);
    line(t, from, y, dy, ddy);
    *away = sqrt(pow(p[0] - y[0], 2.0) + pow(p[1] - y[1], 2.0));
    return status;
}

/*
 * Run the move: the largest distance of the tool from its path [m], and the speed of the joints at
 * the end [rad/s].
 */
static int run(planted_mistake mistake, double *stray, double *speed)
{
    static controller c;
    double x[N] = {0.0}, tau_m[NM], away;
    int status = start(&c);
    *stray = 0.0;
    /*
     * At the first update the path starts 95 ms later. After its end the sample is repeated, and
     * the arm stays there. /
     */
    for (int k = 0;
        status == PLANAR5_NMP_OK && k * UPDATE < INTERVALS * UPDATE + DURATION + SETTLE; ++k) {
        const double now = (k + 1 - INTERVALS) * UPDATE;
        update(&c, now + INTERVALS * UPDATE, mistake);
        if (k == 0) {
            memcpy(c.before, c.tau_m, sizeof c.before);
            /* the plant is in equilibrium, its elastic joint deflected by gravity */
            memcpy(x, c.q_a, NA * sizeof *x);
            memcpy(x + 2 * NA, c.q_m, NM * sizeof *x);
        }
        for (int cycle = 0; cycle < CYCLES && status == PLANAR5_NMP_OK; ++cycle) {
            control(&c, cycle, mistake, x + 2 * NA, x + 2 * NA + NM, tau_m);
            for (int i = 0; i < STEPS && status == PLANAR5_NMP_OK; ++i) {
                status = step(CYCLE / STEPS, tau_m, x);
            }
            if (status == PLANAR5_NMP_OK) {
                status = distance(x, c.start, now + (cycle + 1) * CYCLE, &away);
            }
            if (status == PLANAR5_NMP_OK && c.state == RUNNING && away > *stray) {
                *stray = away;
            }
        }
    }
    *speed = sqrt(pow(x[NA], 2.0) + pow(x[NA + 1], 2.0));
    return status;
}

int main(void)
{
    static const char *const names[] = {"stream", "late", "refused", "jump"};
    static const planted_mistake mistakes[] = {NOTHING, LATE_TORQUE, UNREACHABLE_SAMPLE, JUMP};
    for (size_t i = 0; i < sizeof mistakes / sizeof *mistakes; ++i) {
        double stray, speed;
        int status;
        printf("%s\n", names[i]);
        status = run(mistakes[i], &stray, &speed);
        if (status != PLANAR5_NMP_OK) {
            fprintf(stderr, "planar5_nmp: %s\n", planar5_nmp_status_text(status));
            return 1;
        }
        printf("  tool strays by at most %10.3f um, joints end with %.1e rad/s\n", 1e6 * stray,
            speed);
    }
    return 0;
}
