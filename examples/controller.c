/*
 * A motor controller with feedforward, on the generated library of the planar arm `planar5_nmp`.
 *
 * Every millisecond the controller computes the inverse dynamics of the arm from the reference of
 * the two actuated joints, with the elastic joint straight. The results are the feedforward
 * torques and the deflections of the gears. A PD law on the motors corrects the rest. The plant is
 * the forward dynamics of the library, integrated by the classical Runge-Kutta method. The program
 * prints the largest path error of the tool, with and without feedforward.
 *
 *   flexgen generate planar5_nmp
 *   cd generated/planar5_nmp
 *   cc -std=c99 -O2 -ffp-contract=off -I. ../../examples/controller.c $(find src -name '*.c') -lm
 *     -o controller
 *   ./controller
 */
#include "planar5_nmp.h"

#include <math.h>
#include <stdio.h>

#define NA PLANAR5_NMP_NA
#define NM PLANAR5_NMP_NM
#define N (2 * NA + 2 * NM) /* state of the plant: q_a, v_a, q_m, v_m */

static const double KP[NM] = {30.0, 20.0}; /* N m/rad, motor side */
static const double KD[NM] = {0.7, 0.5};   /* N m s/rad, motor side */

static const double START[NM] = {0.3, -1.1}, END[NM] = {0.9, -1.6}; /* rad */
static const double DURATION = 0.6, SETTLE = 0.2;                   /* s */
static const double CYCLE = 1e-3;                                   /* s */
static const int STEPS = 10;                                        /* of the plant per cycle */

/* Reference at time t: a polynomial from rest to rest with continuous accelerations. */
static void reference(double t, double q[NA], double v[NA], double a[NA])
{
    const double s = t < DURATION ? t / DURATION : 1.0;
    const double p = s * s * s * (10.0 + s * (-15.0 + 6.0 * s));
    const double dp = 30.0 * s * s * (1.0 - s) * (1.0 - s) / DURATION;
    const double ddp = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / (DURATION * DURATION);
    for (int i = 0; i < NA; ++i) {
        const double way = i < NM ? END[i] - START[i] : 0.0;
        q[i] = (i < NM ? START[i] : 0.0) + way * p;
        v[i] = way * dp;
        a[i] = way * ddp;
    }
}

/* Torques of one control cycle from the measured motors; returns a status of the library. */
static int control(
    double t, int feedforward, const double q_m[NM], const double v_m[NM], double tau_m[NM])
{
    double q[NA], v[NA], a[NA], tau_a[NA];
    int status;
    reference(t, q, v, a);
    status = planar5_nmp_inverse_dynamics(q, v, a, tau_a);
    if (status != PLANAR5_NMP_OK) {
        return status;
    }
    for (int j = 0; j < NM; ++j) {
        const double ratio = planar5_nmp_gear_ratio[j][j], inertia = planar5_nmp_rotor_inertia[j];
        const double deflection = feedforward ? tau_a[j] / planar5_nmp_gear_stiffness[j] : 0.0;
        const double fed = feedforward ? tau_a[j] / ratio + inertia * ratio * a[j] : 0.0;
        tau_m[j] = fed + KP[j] * (ratio * (q[j] + deflection) - q_m[j]) +
                   KD[j] * (ratio * v[j] - v_m[j]);
    }
    return PLANAR5_NMP_OK;
}

/* dx/dt of the plant. */
static int plant(const double x[N], const double tau_m[NM], double dx[N])
{
    const double *q_a = x, *v_a = x + NA, *q_m = x + 2 * NA, *v_m = x + 2 * NA + NM;
    for (int i = 0; i < NA; ++i) {
        dx[i] = v_a[i];
    }
    for (int j = 0; j < NM; ++j) {
        dx[2 * NA + j] = v_m[j];
    }
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

/* Run the move; *stray becomes the largest distance of the tool from its reference [m]. */
static int run(int feedforward, double *stray)
{
    double x[N] = {0.0};
    int status = PLANAR5_NMP_OK;
    *stray = 0.0;
    for (int j = 0; j < NM; ++j) {
        x[j] = START[j];
        x[2 * NA + j] = planar5_nmp_gear_ratio[j][j] * START[j];
    }
    for (int k = 0; k * CYCLE < SETTLE + DURATION + SETTLE; ++k) {
        const double t = k * CYCLE - SETTLE < 0.0 ?
                             0.0 :
                             k * CYCLE - SETTLE; /* wait until it is in equilibrium with gravity */
        double tau_m[NM], q[NA], v[NA], a[NA], p_ref[3], p[3], R[9], distance;
        status = control(t, feedforward, x + 2 * NA, x + 2 * NA + NM, tau_m);
        for (int i = 0; i < STEPS && status == PLANAR5_NMP_OK; ++i) {
            status = step(CYCLE / STEPS, tau_m, x);
        }
        if (status != PLANAR5_NMP_OK) {
            return status;
        }
        reference(t + (k * CYCLE < SETTLE ? 0.0 : CYCLE), q, v, a);
        status = planar5_nmp_forward_kinematics(q, p_ref, R);
        if (status == PLANAR5_NMP_OK) {
            status = planar5_nmp_forward_kinematics(x, p, R);
        }
        if (status != PLANAR5_NMP_OK) {
            return status;
        }
        distance = sqrt(pow(p[0] - p_ref[0], 2.0) + pow(p[1] - p_ref[1], 2.0));
        if (t > 0.0 && distance > *stray) {
            *stray = distance;
        }
    }
    return PLANAR5_NMP_OK;
}

int main(void)
{
    for (int feedforward = 0; feedforward < 2; ++feedforward) {
        double stray;
        const int status = run(feedforward, &stray);
        if (status != PLANAR5_NMP_OK) {
            fprintf(stderr, "planar5_nmp: %s\n", planar5_nmp_status_text(status));
            return 1;
        }
        printf("%-24s tool strays by at most %8.3f mm\n",
            feedforward ? "PD with feedforward" : "PD alone", 1e3 * stray);
    }
    return 0;
}
