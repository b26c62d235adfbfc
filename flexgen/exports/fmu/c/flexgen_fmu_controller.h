/*
 * A drive with position and speed control (P-PI cascade) as a sampled block: u = (measured angles,
 * reference angles, feedforward torques), y = torques. The mathematics is flexgen_loop_cascade;
 * this file only lays out its memory: three whole numbers, the sample time, k_p, k_v, k_i, u_max,
 * filters, then the state.
 */
#ifndef FLEXGEN_FMU_CONTROLLER_H
#define FLEXGEN_FMU_CONTROLLER_H

int flexgen_loop_cascade(void *self, int64_t k, const double *y, const double *ref, double *u);

enum { GAINS = 4, LAST_Q = GAINS + 4 * N_M + 5 * SECTIONS * N_M, LAST_REF = LAST_Q + N_M };

static const char *block_check(unsigned index, double value, int before)
{
    (void)index;
    (void)before;
    return value < 0.0 ? "gains and limits: expected a number that is not negative" : NULL;
}

static const char *block_rate(core *c, const double *x, double *rate)
{
    (void)c;
    (void)x;
    (void)rate;
    return NULL;
}

static const char *block_output(core *c)
{
    (void)c;
    return NULL;
}

static const char *block_jacobian(core *c)
{
    (void)c;
    return "a sampled block has no directional derivatives";
}

static const char *block_advance(core *c, double length)
{
    (void)c;
    (void)length;
    return NULL;
}

static const char *block_parameters(core *c)
{
    memcpy(c->s.memory + GAINS, c->s.p, 4 * N_M * sizeof(double));
    return NULL;
}

/* At rest at the angles of the inputs. */
static const char *block_start(core *c)
{
    const int64_t head[3] = {N_M, N_M, SECTIONS};
    memset(c->s.memory, 0, sizeof c->s.memory);
    memcpy(c->s.memory, head, sizeof head);
    c->s.memory[3] = SAMPLE_TIME;
    memcpy(c->s.memory + GAINS + 4 * N_M, FILTERS, 5 * SECTIONS * N_M * sizeof(double));
    memcpy(c->s.memory + LAST_Q, c->s.u, N_M * sizeof(double));
    memcpy(c->s.memory + LAST_REF, c->s.u + N_M, N_M * sizeof(double));
    return block_parameters(c);
}

static core_status block_tick(core *c)
{
    (void)flexgen_loop_cascade(c->s.memory, c->s.tick, c->s.u, c->s.u + N_M, c->s.y);
    for (int i = 0; i < N_Y; ++i) {
        if (!isfinite(c->s.y[i])) {
            return fail(c, FAILURE, "the torques are not finite");
        }
    }
    return SUCCESS;
}

#endif
