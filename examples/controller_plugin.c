/*
 * A controller as a plug-in for flexgen control and flexgen score: proportional control of the
 * motor angles with damping, around the feedforward torque.
 *
 *     headers=$(python -c 'import flexgen.feedback.loop as loop; print(loop.__path__[0])')
 *     cc -O2 -ffp-contract=off -shared -fPIC -I "$headers" examples/controller_plugin.c -o
 *       controller.so
 *     flexgen control planar5_nmp --controller controller.so
 */
#include "flexgen_controller.h"

enum { MOTORS = 32 };
static const double STIFFNESS = 20.0, DAMPING = 0.5; /* N m/rad, N m s/rad */

typedef struct {
    int32_t n_m, n_y;
    double sample_s;
    double q[MOTORS], q_ref[MOTORS]; /* of the sample before */
} controller;

FLEXGEN_CONTROLLER int flexgen_controller_abi(void)
{
    return FLEXGEN_CONTROLLER_ABI;
}

FLEXGEN_CONTROLLER size_t flexgen_controller_size(const flexgen_controller_setup *setup)
{
    (void)setup;
    return sizeof(controller);
}

FLEXGEN_CONTROLLER int flexgen_controller_reset(void *self, const flexgen_controller_setup *setup)
{
    controller *c = (controller *)self;
    if (setup->n_m > MOTORS) {
        return 1; /* refuses the robot */
    }
    c->n_m = setup->n_m;
    c->n_y = setup->n_y;
    c->sample_s = setup->sample_s;
    for (int32_t j = 0; j < c->n_m; ++j) {
        c->q[j] = c->q_ref[j] = setup->q_m[j];
    }
    return 0;
}

FLEXGEN_CONTROLLER int flexgen_controller_step(
    void *self, int64_t k, const double *y, const double *ref, double *u)
{
    controller *c = (controller *)self;
    (void)k;
    for (int32_t j = 0; j < c->n_m; ++j) {
        double v = (y[j] - c->q[j]) / c->sample_s, v_ref = (ref[j] - c->q_ref[j]) / c->sample_s;
        u[j] = ref[c->n_y + j] + STIFFNESS * (ref[j] - y[j]) + DAMPING * (v_ref - v);
        c->q[j] = y[j];
        c->q_ref[j] = ref[j];
    }
    return 0;
}
