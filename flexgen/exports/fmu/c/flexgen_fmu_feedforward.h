/*
 * Inverse dynamics on a moving horizon as a sampled block. Every period the stream takes the path
 * sample in u (position, velocity, acceleration of the output), which the robot reaches a
 * look-ahead later, and gives the motion and the torques of the period that begins now: in y, one
 * sample of them after the other.
 *
 * The memory has the stream, then its results of one period.
 */
#ifndef FLEXGEN_FMU_FEEDFORWARD_H
#define FLEXGEN_FMU_FEEDFORWARD_H

enum {
    RESULTS = N_STREAM,
    Q_A = RESULTS,
    V_A = Q_A + SAMPLES * N_A,
    Q_M = V_A + SAMPLES * N_A,
    V_M = Q_M + SAMPLES * N_M,
    TAU_M = V_M + SAMPLES * N_M,
#if MODEL_POSITION
    COMMAND = TAU_M + SAMPLES * N_M,
    FIGURES = COMMAND + SAMPLES * N_C
#else  /* MODEL_POSITION */
    FIGURES = TAU_M + SAMPLES * N_M
#endif /* MODEL_POSITION */
};

static const char *block_check(unsigned index, double value, int before)
{
    (void)before;
    return index == P_MASS && value < 0.0 ?
               "payload.mass: expected a number that is not negative" :
               NULL;
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

static const char *block_start(core *c)
{
    const MODEL(stream) stream = {.memory = c->s.memory, .size = N_STREAM};
#if MODEL_POSITION
    const MODEL(servo) servo = MODEL(servo_defaults)();
    const MODEL(stream_options) options = {.intervals = INTERVALS,
        .samples_per_interval = SAMPLES,
        .period = PERIOD,
        .tolerance = TOLERANCE,
        .hold = HELD,
        .delay = servo.delay / servo.sample_time,
        .servo = &servo};
#else  /* MODEL_POSITION */
    const MODEL(stream_options) options = {.intervals = INTERVALS,
        .samples_per_interval = SAMPLES,
        .period = PERIOD,
        .tolerance = TOLERANCE};
#endif /* MODEL_POSITION */
    const MODEL(status) status = MODEL(stream_start)(&stream, &options, c->s.u, c->s.p, Q_START);
    c->s.status = status;
    return status < 0 ? MODEL(status_text)(status) : NULL;
}

static const char *block_parameters(core *c)
{
    const MODEL(stream) stream = {.memory = c->s.memory, .size = N_STREAM};
    const MODEL(status) status = MODEL(stream_parameters)(&stream, c->s.p);
    return status < 0 ? MODEL(status_text)(status) : NULL;
}

/*
 * Statuses with which the stream refuses a sample and continues; after other errors it has to be
 * started again.
 */
static int is_refused(MODEL(status) status)
{
    return status == REFUSED_NOT_FINITE || status == REFUSED_ARGUMENT ||
           status == REFUSED_UNREACHABLE;
}

static core_status block_tick(core *c)
{
    const int sample = (int)(c->s.tick % SAMPLES);
    double *memory = c->s.memory, *y = c->s.y;
    if (sample == 0) {
        const MODEL(stream) stream = {.memory = memory, .size = N_STREAM};
        MODEL(motion)
        motion = {
            .q_a = memory + Q_A,
            .v_a = memory + V_A,
            .q_m = memory + Q_M,
            .v_m = memory + V_M,
            .tau_m = memory + TAU_M,
#if MODEL_POSITION
            .command_g = memory + COMMAND,
#endif /* MODEL_POSITION */
        };
        MODEL(stream_info) info;
        const double *u = c->s.u;
        const MODEL(status)
            status = MODEL(stream_update)(&stream, u, u + N_T, u + N_T + N_OUT, &motion, &info);
        if (status < 0) {
            return fail(c, is_refused(status) ? DISCARD : FAILURE, MODEL(status_text)(status));
        }
        c->s.status = status;
        memory[FIGURES] = info.residual;
        memory[FIGURES + 1] = info.output_step_m;
        memory[FIGURES + 2] = info.output_step_rad;
    }
    memcpy(y, memory + TAU_M + sample * N_M, N_M * sizeof *y);
    memcpy(y + N_M, memory + Q_M + sample * N_M, N_M * sizeof *y);
    memcpy(y + 2 * N_M, memory + V_M + sample * N_M, N_M * sizeof *y);
    memcpy(y + 3 * N_M, memory + Q_A + sample * N_A, N_A * sizeof *y);
    memcpy(y + 3 * N_M + N_A, memory + V_A + sample * N_A, N_A * sizeof *y);
    memcpy(y + 3 * N_M + 2 * N_A, memory + FIGURES, 3 * sizeof *y);
#if MODEL_POSITION
    memcpy(y + 3 * N_M + 2 * N_A + 3, memory + COMMAND + sample * N_C, N_C * sizeof *y);
#endif /* MODEL_POSITION */
    return c->s.status > 0 && sample == 0 ?
               fail(c, WARNING, MODEL(status_text)((MODEL(status))c->s.status)) :
               SUCCESS;
}

#endif
