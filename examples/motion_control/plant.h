/* The robot of motion_control.c: forward dynamics of its library, integrated by the classical Runge-Kutta method. */
#ifndef PLANT_H
#define PLANT_H

#include "planner.h"

enum {
    STEPS = 4,        /* integration steps per cycle */
    N = 2 * (NA + NM) /* state: q_a, v_a, q_m, v_m */
};

typedef struct {
    double x[N], f_tool[6], work[WORK];
} plant;

/* dx/dt at the state x. */
static CALL(status) rate_of(plant *r, const double *x, const double *tau_m, double *dx)
{
    const double *v_a = x + NA, *q_m = x + 2 * NA, *v_m = q_m + NM;
    double tau_g[NG];
    memcpy(dx, v_a, NA * sizeof *dx);
    memcpy(dx + 2 * NA, v_m, NM * sizeof *dx);
    return CALL(forward_dynamics_tool_force_batch)(
        1, x, v_a, q_m, v_m, tau_m, r->f_tool, dx + NA, dx + 2 * NA + NM, tau_g, r->work);
}

/* A cycle under a torque that is held. */
static CALL(status) move_plant(plant *r, const double *tau_m)
{
    static const double where[4] = {0.0, 0.5, 0.5, 1.0}, weight[4] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    const double h = CYCLE / STEPS;
    CALL(status) status = SIZE(OK);
    for (int step = 0; step < STEPS; ++step) {
        double at[N], dx[N] = {0.0}, sum[N] = {0.0};
        for (int stage = 0; stage < 4 && status == SIZE(OK); ++stage) {
            for (int i = 0; i < N; ++i) {
                at[i] = r->x[i] + h * where[stage] * dx[i];
            }
            status = rate_of(r, at, tau_m, dx);
            for (int i = 0; i < N; ++i) {
                sum[i] += weight[stage] * dx[i];
            }
        }
        for (int i = 0; i < N; ++i) {
            r->x[i] += h * sum[i];
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
