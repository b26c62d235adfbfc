/*
 * MuJoCo's side of the comparison: one model, one quantity, a set of states to cycle through; see
 * peers_pinocchio.cpp.
 *
 * The model is a binary file that peers.py writes. What a user of MuJoCo calls is timed:
 * mj_inverse and mj_forward contain kinematics, mass matrix and its factors, velocities, and the
 * search for contacts, of which there are none.
 */
#include <mujoco/mujoco.h>

#include <stdlib.h>
#include <string.h>

typedef struct {
    mjModel *m;
    mjData *d;
    double *states; /* count x (q, v, x); x: accelerations or torques */
    int count, state, quantity;
} peer;

enum { INVERSE_DYNAMICS, MASS_MATRIX, FORWARD_DYNAMICS, QUANTITIES };

static const char *const names[QUANTITIES] = {
    "inverse_dynamics", "mass_matrix", "arm_forward_dynamics"};

static void evaluate(const peer *p, int state)
{
    const int n = p->m->nv;
    const size_t size = (size_t)n * sizeof(double);
    const double *given = p->states + (size_t)state * 3 * (size_t)n;
    memcpy(p->d->qpos, given, size);
    if (p->quantity == MASS_MATRIX) {
        mj_kinematics(p->m, p->d);
        mj_comPos(p->m, p->d);
        mj_makeM(p->m, p->d);
        return;
    }
    memcpy(p->d->qvel, given + n, size);
    memcpy(p->quantity == INVERSE_DYNAMICS ? p->d->qacc : p->d->qfrc_applied, given + 2 * n, size);
    if (p->quantity == INVERSE_DYNAMICS) {
        mj_inverse(p->m, p->d);
    } else {
        mj_forward(p->m, p->d);
    }
}

void *peer_open(const char *quantity, const char *path, const double *states, int count, int size)
{
    peer *p = calloc(1, sizeof *p);
    int n;
    if (p == NULL) {
        return NULL;
    }
    for (p->quantity = 0; p->quantity < QUANTITIES && strcmp(quantity, names[p->quantity]) != 0;
        ++p->quantity) {
    }
    p->m = p->quantity < QUANTITIES ? mj_loadModel(path, NULL) : NULL;
    p->d = p->m != NULL ? mj_makeData(p->m) : NULL;
    n = p->d != NULL ? p->m->nv : 0;
    p->states = calloc((size_t)count * 3 * (size_t)n + 1, sizeof(double));
    if (p->d == NULL || p->states == NULL || size > 3 * n) {
        return NULL;
    }
    for (int k = 0; k < count; ++k) {
        memcpy(p->states + (size_t)k * 3 * (size_t)n, states + (size_t)k * (size_t)size,
            (size_t)size * sizeof(double));
    }
    p->count = count;
    return p;
}

void peer_run(void *given, long calls)
{
    peer *p = given;
    for (long i = 0; i < calls; ++i) {
        evaluate(p, p->state);
        p->state = p->state + 1 == p->count ? 0 : p->state + 1;
    }
}

void peer_result(void *given, int state, double *out)
{
    const peer *p = given;
    const size_t size = (size_t)p->m->nv * sizeof(double);
    evaluate(p, state);
    if (p->quantity == MASS_MATRIX) {
        mj_fullM(p->m, p->d, out);
    } else {
        memcpy(out, p->quantity == INVERSE_DYNAMICS ? p->d->qfrc_inverse : p->d->qacc, size);
    }
}
