/*
 * A controller as a shared library, for flexgen's sampled closed loop.
 *
 * Export the four functions below (C linkage). Memory of `flexgen_controller_size` bytes, set to
 * zero, belongs to one robot; there may be several. No call may keep pointers that it is given,
 * but for those into its own memory.
 *
 *     cc -O2 -ffp-contract=off -shared -fPIC mine.c -o mine.so
 */
#ifndef FLEXGEN_CONTROLLER_H
#define FLEXGEN_CONTROLLER_H

#include <stddef.h>
#include <stdint.h>

#define FLEXGEN_CONTROLLER_ABI 1

#if defined(_WIN32)
#define FLEXGEN_CONTROLLER __declspec(dllexport)
#else
#define FLEXGEN_CONTROLLER __attribute__((visibility("default")))
#endif

typedef struct {
    int32_t n_a, n_m;   /* arm coordinates and motors */
    int32_t n_y, n_ref; /* measured channels, motor angles first; entries of ref */
    double sample_s;
    const double *q_m; /* motor angles at the start, at rest (n_m) */
} flexgen_controller_setup;

#ifdef __cplusplus
extern "C" {
#endif

/* FLEXGEN_CONTROLLER_ABI. */
FLEXGEN_CONTROLLER int flexgen_controller_abi(void);

/* Bytes of memory of one controller. */
FLEXGEN_CONTROLLER size_t flexgen_controller_size(const flexgen_controller_setup *setup);

/* Begin; anything but 0 refuses the robot. */
FLEXGEN_CONTROLLER int flexgen_controller_reset(void *self, const flexgen_controller_setup *setup);

/*
 * Torques u (n_m) [N m] from the measurements y (n_y) of sample k; anything but 0 stops the run.
 *
 * ref: y_ref (n_y), what the channels show on the reference; tau (n_m), mean of the feedforward
 * torque over the interval in which u will act; v_m (n_m), q_a (n_a), v_a (n_a) at the sample.
 */
FLEXGEN_CONTROLLER int flexgen_controller_step(
    void *self, int64_t k, const double *y, const double *ref, double *u);

#ifdef __cplusplus
}
#endif

#endif
