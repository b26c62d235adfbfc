/*
 * One instance of the FMU without the names of an FMI version: its state, its variables by value
 * reference, the step of Co-Simulation, the events of Model Exchange. flexgen_fmu_fmi2.c and
 * flexgen_fmu_fmi3.c are the interfaces around it. The names of the fixed files begin with
 * flexgen_fmu_, which no model's name does.
 *
 * flexgen_fmu_config.h has the sizes, the start values and the functions of the model; exactly one
 * of flexgen_fmu_plant.h, flexgen_fmu_feedforward.h and flexgen_fmu_controller.h has the
 * mathematics:
 *
 *   block_start      at the end of the initialization
 *   block_parameters after a change of the parameters
 *   block_rate       dx/dt of the continuous states
 *   block_output     outputs that depend on the continuous states
 *   block_jacobian   A = d rate/dx, B = d rate/du, C = d output/dx, by columns
 *   block_tick       a sample of a sampled block: inputs to outputs
 *   block_advance    the continuous states, over a communication step
 *
 * Each returns a null pointer, or what went wrong. Nothing is allocated here; two instances share
 * nothing.
 */
#ifndef FLEXGEN_FMU_CORE_H
#define FLEXGEN_FMU_CORE_H

#include "flexgen_fmu_config.h"

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define ROOM(n) ((n) > 0 ? (n) : 1) /* C has no empty arrays */

enum { MOST_SAMPLES = 100000 }; /* of a sampled block in one call */

/* Value references are 1000 times the kind, plus the index. */
enum {
    KIND_TIME = 0,
    KIND_STATE,
    KIND_RATE,
    KIND_INPUT,
    KIND_OUTPUT,
    KIND_PARAMETER,
    KIND_SETTING,
    KIND_STATUS
};

typedef enum { SUCCESS, WARNING, DISCARD, FAILURE } core_status;
typedef enum {
    INSTANTIATED,
    INITIALIZATION,
    EVENT,
    CONTINUOUS,
    STEPPING,
    TERMINATED,
    BROKEN
} core_phase;

/* All that a saved state has to hold; numbers of eight bytes only, so that it has no gaps. */
typedef struct {
    double time, start; /* [s] now, and of the first sample */
    double x[ROOM(N_X)], u[ROOM(N_U)], y[ROOM(N_Y)], p[ROOM(N_P)];
    /* whole-number parameters; status of the last sample */
    int64_t setting[ROOM(N_SETTINGS)], status;
    int64_t tick;               /* the next sample */
    int64_t parameters_changed; /* since they were last used */
    int64_t phase;
    double memory[ROOM(N_MEMORY)]; /* of the block */
} core_state;

typedef struct {
    core_state s;
    double rate[ROOM(N_X)];
    double A[ROOM(N_X * N_X)], B[ROOM(N_X * N_U)], C[ROOM(N_Y * N_X)];
    int rate_known, output_known, jacobian_known; /* for the present state */
    int co_simulation;
    const char *message; /* of the last status other than SUCCESS */
    core_state before;   /* at the start of a communication step */
    double lu[ROOM(N_X * N_X)], stage[6][ROOM(N_X)];
    int pivot[ROOM(N_X)];
    double work[ROOM(N_WORK)];
} core;

static core_status fail(core *c, core_status status, const char *message)
{
    c->message = message;
    return status;
}

#if defined(FMU_PLANT)
#include "flexgen_fmu_plant.h"
#elif defined(FMU_FEEDFORWARD)
#include "flexgen_fmu_feedforward.h"
#else
#include "flexgen_fmu_controller.h"
#endif

static void forget(core *c)
{
    c->rate_known = c->output_known = c->jacobian_known = 0;
}

/* The start values. */
static void core_reset(core *c)
{
    memset(&c->s, 0, sizeof c->s);
    for (int i = 0; i < N_X; ++i) {
        c->s.x[i] = X_START[i];
    }
    for (int i = 0; i < N_U; ++i) {
        c->s.u[i] = U_START[i];
    }
    for (int i = 0; i < N_Y; ++i) {
        c->s.y[i] = Y_START[i];
    }
    for (int i = 0; i < N_P; ++i) {
        c->s.p[i] = P_START[i];
    }
    for (int i = 0; i < N_SETTINGS; ++i) {
        c->s.setting[i] = SETTING_START[i];
    }
    c->s.phase = INSTANTIATED;
    c->message = "";
    forget(c);
}

/*
 * The number of a value reference; a null pointer where there is none. Rates and outputs: see
 * refresh.
 */
static double *place(core *c, unsigned reference)
{
    const int kind = (int)(reference / 1000u), i = (int)(reference % 1000u);
    switch (kind) {
    case KIND_TIME:
        return i == 0 ? &c->s.time : NULL;
    case KIND_STATE:
        return i < N_X ? &c->s.x[i] : NULL;
    case KIND_RATE:
        return i < N_X ? &c->rate[i] : NULL;
    case KIND_INPUT:
        return i < N_U ? &c->s.u[i] : NULL;
    case KIND_OUTPUT:
        return i < N_Y ? &c->s.y[i] : NULL;
    case KIND_PARAMETER:
        return i < N_P ? &c->s.p[i] : NULL;
    default:
        return NULL;
    }
}

static core_status refresh(core *c, int kind)
{
    const char *problem = NULL;
    if (kind == KIND_RATE && !c->rate_known) {
        problem = block_rate(c, c->s.x, c->rate);
        c->rate_known = problem == NULL;
    } else if (kind == KIND_OUTPUT && !c->output_known) {
        problem = block_output(c);
        c->output_known = problem == NULL;
    }
    return problem == NULL ? SUCCESS : fail(c, FAILURE, problem);
}

static core_status core_get(core *c, unsigned reference, double *value)
{
    const double *from = place(c, reference);
    if (from == NULL) {
        return fail(c, FAILURE, "the value reference is unknown");
    }
    if (refresh(c, (int)(reference / 1000u)) != SUCCESS) {
        return FAILURE;
    }
    *value = *from;
    return SUCCESS;
}

static core_status core_set(core *c, unsigned reference, double value)
{
    const int kind = (int)(reference / 1000u);
    const int before = c->s.phase == INSTANTIATED || c->s.phase == INITIALIZATION;
    double *to = place(c, reference);
    if (to == NULL) {
        return fail(c, FAILURE, "the value reference is unknown");
    }
    if (kind == KIND_RATE || kind == KIND_OUTPUT ||
        ((kind == KIND_STATE || kind == KIND_TIME) && !before && c->s.phase == STEPPING)) {
        return fail(c, FAILURE, "this variable cannot be set now");
    }
    if (!isfinite(value)) {
        return fail(c, FAILURE, "given NaN or infinity, expected a finite number");
    }
    if (kind == KIND_PARAMETER) {
        const char *problem = block_check(reference % 1000u, value, before);
        if (problem != NULL) {
            return fail(c, FAILURE, problem);
        }
        c->s.parameters_changed = 1;
    }
    *to = value;
    forget(c);
    return SUCCESS;
}

static core_status core_get_integer(core *c, unsigned reference, int32_t *value)
{
    const int kind = (int)(reference / 1000u), i = (int)(reference % 1000u);
    if (kind == KIND_SETTING && i < N_SETTINGS) {
        *value = (int32_t)c->s.setting[i];
        return SUCCESS;
    }
    if (kind == KIND_STATUS && i == 0 && HAS_STATUS) {
        *value = (int32_t)c->s.status;
        return SUCCESS;
    }
    return fail(c, FAILURE, "the value reference is unknown");
}

static core_status core_set_integer(core *c, unsigned reference, int32_t value)
{
    const int kind = (int)(reference / 1000u), i = (int)(reference % 1000u);
    if (kind != KIND_SETTING || i >= N_SETTINGS) {
        return fail(c, FAILURE, "the value reference is unknown, or cannot be set");
    }
    if (c->s.phase != INSTANTIATED && c->s.phase != INITIALIZATION) {
        return fail(
            c, FAILURE, "this parameter is fixed: set it before the end of the initialization");
    }
    if (value < SETTING_LEAST[i] || value > SETTING_MOST[i]) {
        return fail(c, FAILURE, "the parameter is out of its range");
    }
    c->s.setting[i] = value;
    return SUCCESS;
}

/* Derivatives of unknowns (rates, outputs) in the direction of knowns (states, inputs). */
static core_status core_derivative(core *c, const unsigned *unknown, size_t n_unknown,
    const unsigned *known, size_t n_known, const double *seed, double *out)
{
    const char *problem = c->jacobian_known ? NULL : block_jacobian(c);
    if (problem != NULL) {
        return fail(c, FAILURE, problem);
    }
    c->jacobian_known = 1;
    for (size_t i = 0; i < n_unknown; ++i) {
        const int kind = (int)(unknown[i] / 1000u), row = (int)(unknown[i] % 1000u);
        double sum = 0.0;
        if ((kind != KIND_RATE || row >= N_X) && (kind != KIND_OUTPUT || row >= N_Y)) {
            return fail(c, FAILURE,
                "directional derivatives: an unknown is neither an output nor a derivative of a "
                "state");
        }
        for (size_t j = 0; j < n_known; ++j) {
            const int from = (int)(known[j] / 1000u), column = (int)(known[j] % 1000u);
            if ((from != KIND_STATE || column >= N_X) && (from != KIND_INPUT || column >= N_U)) {
                return fail(c, FAILURE,
                    "directional derivatives: a known is neither an input nor a state");
            }
            if (kind == KIND_RATE) {
                sum += (from == KIND_STATE ? c->A : c->B)[column * N_X + row] * seed[j];
            } else if (from == KIND_STATE) {
                sum += c->C[column * N_Y + row] * seed[j];
            }
        }
        out[i] = sum;
    }
    return SUCCESS;
}

/* End of the initialization. */
static core_status core_begin(core *c)
{
    const char *problem = block_start(c);
    c->s.parameters_changed = 0;
    forget(c);
    return problem == NULL ? SUCCESS : fail(c, FAILURE, problem);
}

static core_status changed_parameters(core *c)
{
    const char *problem = c->s.parameters_changed ? block_parameters(c) : NULL;
    c->s.parameters_changed = 0;
    return problem == NULL ? SUCCESS : fail(c, FAILURE, problem);
}

/* When the next sample is due [s]; infinite for a block that is not sampled. */
static double core_next(const core *c)
{
    return SAMPLE_TIME > 0.0 ? c->s.start + (double)c->s.tick * SAMPLE_TIME : HUGE_VAL;
}

/* The samples that are due before the time: the first of them now, with the present inputs. */
static core_status core_samples(core *c, double before)
{
    core_status worst;
    if (SAMPLE_TIME > 0.0 && before - core_next(c) > MOST_SAMPLES * SAMPLE_TIME) {
        return fail(c, DISCARD,
            "more than 100,000 samples of the block until this time: take a shorter step");
    }
    worst = changed_parameters(c);
    while (worst < DISCARD && core_next(c) < before) {
        const core_status status = block_tick(c);
        if (status > worst) {
            worst = status;
        }
        if (status < DISCARD) {
            ++c->s.tick;
        }
    }
    return worst;
}

/*
 * Events at the present time: the sample that is due. A hundredth of a sample is the tolerance of
 * its time.
 */
static core_status core_event(core *c)
{
    const core_status status = core_samples(c, c->s.time + 0.01 * SAMPLE_TIME);
    forget(c);
    return status == DISCARD ? FAILURE : status;
}

/* One communication step. Where it fails the instance is as before. */
static core_status core_step(core *c, double time, double length)
{
    core_status status;
    if (!(length > 0.0) || !isfinite(time + length)) {
        return fail(c, FAILURE, "communicationStepSize: expected a positive number");
    }
    if (fabs(time - c->s.time) > 1e-9 * (1.0 + fabs(time)) + 0.01 * SAMPLE_TIME) {
        return fail(c, FAILURE, "currentCommunicationPoint: expected the end of the step before");
    }
    memcpy(&c->before, &c->s, sizeof c->s);
    status = core_samples(c, time + length - 0.01 * SAMPLE_TIME);
    if (status < DISCARD) {
        const char *problem = block_advance(c, length);
        if (problem != NULL) {
            status = fail(c, DISCARD, problem);
        }
    }
    if (status >= DISCARD) {
        memcpy(&c->s, &c->before, sizeof c->s);
    } else {
        c->s.time = time + length;
    }
    forget(c);
    return status;
}

/* A saved state as bytes: which FMU it belongs to, the checksum of its numbers, its numbers. */
typedef struct {
    char token[96];
    uint64_t sum;
    core_state s;
} core_saved;

/* FNV-1a of the numbers. Each changed byte changes it. */
static uint64_t core_sum(const core_state *s)
{
    const unsigned char *bytes = (const unsigned char *)s;
    uint64_t sum = UINT64_C(14695981039346656037);
    for (size_t i = 0; i < sizeof *s; ++i) {
        sum = (sum ^ bytes[i]) * UINT64_C(1099511628211);
    }
    return sum;
}

/* What is wrong with the bytes of a saved state; a null pointer: nothing. */
static const char *core_damage(const core_saved *from)
{
    if (memcmp(from->token, TOKEN, sizeof TOKEN) != 0) {
        return "the saved state belongs to another FMU";
    }
    return from->sum == core_sum(&from->s) ? NULL :
                                             "the saved state is damaged: its checksum differs";
}

static void core_save(const core *c, core_saved *to)
{
    memset(to->token, 0, sizeof to->token);
    strncpy(to->token, TOKEN, sizeof to->token - 1);
    memcpy(&to->s, &c->s, sizeof c->s);
    to->sum = core_sum(&to->s);
}

/* Take a saved state; one that this instance cannot have is refused, and changes nothing. */
static core_status core_restore(core *c, const core_saved *from)
{
    const core_state *s = &from->s;
    const char *damage = core_damage(from);
    if (damage != NULL) {
        return fail(c, FAILURE, damage);
    }
    switch (s->phase) {
    case INSTANTIATED:
    case INITIALIZATION:
    case TERMINATED:
    case BROKEN:
        break;
    case EVENT:
    case CONTINUOUS:
        if (c->co_simulation) {
            return fail(
                c, FAILURE, "the saved state is of Model Exchange, expected one of Co-Simulation");
        }
        break;
    case STEPPING:
        if (!c->co_simulation) {
            return fail(
                c, FAILURE, "the saved state is of Co-Simulation, expected one of Model Exchange");
        }
        break;
    default:
        return fail(c, FAILURE, "the saved state is damaged: its phase is unknown");
    }
    if (s->tick < 0) {
        return fail(c, FAILURE, "the saved state is damaged: its sample is negative");
    }
    for (int i = 0; i < N_SETTINGS; ++i) {
        if (s->setting[i] < SETTING_LEAST[i] || s->setting[i] > SETTING_MOST[i]) {
            return fail(c, FAILURE, "the saved state is damaged: a parameter is out of its range");
        }
    }
    memcpy(&c->s, &from->s, sizeof c->s);
    forget(c);
    return SUCCESS;
}

#endif
