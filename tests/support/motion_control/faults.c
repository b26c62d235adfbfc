/*
 * The controller of examples/motion_control under faults, in the loop with its plant: control(NAME) plants the fault at
 * cycle AT and continues for LAST cycles. It prints NAME, cycles from the fault (of a push: from the first torque at
 * its limit) to the first status that is not OK, that status, whether all torques were finite, the largest torque over
 * its limit, the largest step of the reference [rad], and the largest speed of a motor in the last 100 cycles [rad/s].
 */
#include "motion_control/controller.h"
#include "motion_control/plant.h"

#include <stdio.h>
#include <stdlib.h>

enum { LAST = 1500 };
#ifndef AT
#define AT 700
#endif

static controller c;
static plant robot;

/* The fault in cycle k: what the encoders show, the buffer, the force. */
static void plant_fault(const char *name, int64_t k, double *q_m)
{
    const int fault = k >= AT, once = k == AT;
    if ((strcmp(name, "nan") == 0 && once) || (strcmp(name, "nan for ever") == 0 && fault)) {
        q_m[0] = NAN;
    } else if (strcmp(name, "inf") == 0 && once) {
        q_m[NM - 1] = -HUGE_VAL;
    } else if (strcmp(name, "huge") == 0 && fault) {
        q_m[0] = k % 2 ? 1e300 : -1e300;
    } else if (strcmp(name, "wrap") == 0 && once) {
        q_m[0] += 2048.0;
    } else if (strcmp(name, "late") == 0 && once) { /* the planner has not finished the sample of this cycle */
        c.plan.ready = k;
        for (int i = 0; i < RING; ++i) {
            c.plan.q_m[(k + i) % RING][0] += i < READY ? 1e3 : 0.0;
        }
    } else if (strcmp(name, "feedforward") == 0 && once) {
        c.plan.tau_m[k % RING][0] = NAN;
    } else if (strcmp(name, "push") == 0) {
        robot.f_tool[0] = fault ? 1e5 : 0.0;
    }
}

int main(int argc, char **argv)
{
    const char *name = argc > 1 ? argv[1] : "none";
    const int missed = strcmp(name, "missed") == 0 ? 50 : strcmp(name, "missed one") == 0 ? 1 : 0;
    double u[NM], acting[NM], last[NM], share = 0.0, step = 0.0, speed = 0.0;
    int64_t seen = -1, begun = strcmp(name, "push") == 0 ? LAST : AT, k = 0;
    int finite = 1, status = 0;
    if (start_controller(&c, NULL, NULL) < SIZE(OK)) {
        return 1;
    }
    memcpy(robot.x, c.plan.q_start, sizeof c.plan.q_start);
    memcpy(robot.x + 2 * NA, c.plan.q_m[0], sizeof c.plan.q_m[0]);
    memcpy(acting, c.u, sizeof acting);
    memcpy(last, c.q_ref, sizeof last);
    for (int64_t cycle = 0; cycle < LAST; ++cycle, ++k) {
        double q_m[NM];
        for (int i = 0; cycle == AT && i < missed; ++i, ++k) { /* the plant continues, the controller does not */
            (void)move_plant(&robot, acting);
        }
        k -= cycle == AT && strcmp(name, "repeated") == 0;
        measure(&robot, q_m);
        plant_fault(name, cycle, q_m);
        control(&c, k, q_m, u);
        for (int j = 0; j < NM; ++j) {
            if (fabs(u[j]) >= torque_limit[j] && cycle < begun) { /* of a push: the torque is at its limit */
                begun = cycle;
            }
            finite = finite && isfinite(u[j]);
            share = fmax(share, fabs(u[j]) / torque_limit[j]);
            step = fmax(step, fabs(c.q_ref[j] - last[j]));
            speed = cycle >= LAST - 100 ? fmax(speed, fabs(robot.x[2 * NA + NM + j])) : speed;
        }
        if (c.status != SIZE(OK) && seen < 0 && cycle >= begun) {
            seen = cycle - begun;
            status = c.status;
        }
        memcpy(last, c.q_ref, sizeof last);
        if (!finite) {
            break;
        }
        (void)move_plant(&robot, acting);
        memcpy(acting, u, sizeof acting);
    }
    printf("%ld %d %d %.6f %.6f %.6f\n", (long)seen, status, finite, share, step, speed);
    return 0;
}
