/*
 * The robot of motion_control.c: forward dynamics of its library, integrated by the classical
 * Runge-Kutta method. The brakes act on the motors by friction, until they stand; then they hold
 * them.
 */
#ifndef PLANT_H
#define PLANT_H

#include "planner.h"

enum {
    STEPS = 4,        /* integration steps per cycle */
    N = 2 * (NA + NM) /* state: q_a, v_a, q_m, v_m */
};

/* s: from the flag of the controller until the brakes act */
static const double BRAKES_DELAY = 0.05;
static const double BRAKE_TORQUE = 2.0; /* of the brakes, relative to the torque limits */
static const double STANDS = 0.5;       /* rad/s: speed of a motor that its brake stops at once */

typedef struct {
    double x[N], f_tool[6], work[WORK];
    int engaged, locked[NM]; /* the brakes act; a motor that is held */
} plant;

/* dx/dt at the state x. */
static CALL(status) rate_of(plant *r, const double *x, const double *tau_m, double *dx)
{
    const double *v_a = x + NA, *q_m = x + 2 * NA, *v_m = q_m + NM;
    double tau_g[NG];
    CALL(status) status;
    memcpy(dx, v_a, NA * sizeof *dx);
    memcpy(dx + 2 * NA, v_m, NM * sizeof *dx);
    status = CALL(forward_dynamics_tool_force_batch)(
        1, x, v_a, q_m, v_m, tau_m, r->f_tool, dx + NA, dx + 2 * NA + NM, tau_g, r->work);
    for (int j = 0; j < NM; ++j) {
        dx[2 * NA + NM + j] = r->locked[j] ? 0.0 : dx[2 * NA + NM + j];
    }
    return status;
}

/* The torque of a step, with that of the brakes; motors that stand are held. */
static void apply_brakes(plant *r, const double *tau_m, double *tau)
{
    for (int j = 0; j < NM; ++j) {
        const double v = r->x[2 * NA + NM + j];
        r->locked[j] = r->locked[j] || (r->engaged && fabs(v) < STANDS);
        tau[j] = tau_m[j] -
                 (r->engaged ? (v > 0.0 ? 1.0 : -1.0) * BRAKE_TORQUE * torque_limit[j] : 0.0);
        r->x[2 * NA + NM + j] = r->locked[j] ? 0.0 : v;
    }
}

/* A cycle under a torque that is held. */
static CALL(status) move_plant(plant *r, const double *tau_m)
{
    static const double where[4] = {0.0, 0.5, 0.5, 1.0},
                        weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    const double h = CYCLE / STEPS;
    CALL(status) status = SIZE(OK);
    for (int step = 0; step < STEPS; ++step) {
        double at[N], dx[N] = {0.0}, sum[N] = {0.0}, tau[NM], before[NM];
        apply_brakes(r, tau_m, tau);
        memcpy(before, r->x + 2 * NA + NM, sizeof before);
        for (int stage = 0; stage < 4 && status == SIZE(OK); ++stage) {
            for (int i = 0; i < N; ++i) {
                at[i] = r->x[i] + h * where[stage] * dx[i];
            }
            status = rate_of(r, at, tau, dx);
            for (int i = 0; i < N; ++i) {
                sum[i] += weight[stage] * dx[i];
            }
        }
        for (int i = 0; i < N; ++i) {
            r->x[i] += h * sum[i];
        }
        for (int j = 0; j < NM; ++j) { /* a brake does not turn a motor round */
            if (r->engaged && before[j] * r->x[2 * NA + NM + j] < 0.0) {
                r->x[2 * NA + NM + j] = 0.0;
            }
        }
    }
    return status;
}

/* Motor angles as the encoders show them. */
static void measure(const plant *r, double q_m[NM])
{
    for (int j = 0; j < NM; ++j) {
        q_m[j] = floor(r->x[2 * NA + j] / ENCODER + 0.5) * ENCODER;
    }
}

#endif
