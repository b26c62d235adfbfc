/*
 * The interface of FMI 3.0, Model Exchange and Co-Simulation. Memory is taken where an instance is
 * made and for saved states only; instances share nothing, so that each may run in a separate
 * thread.
 */
#include "flexgen_fmu_config.h"
#include "fmi3Functions.h"

#include <stdlib.h>

#include "flexgen_fmu_core.h"

typedef struct {
    core c; /* first: an instance is a core */
    fmi3LogMessageCallback logger;
    fmi3InstanceEnvironment environment;
    int logging;
} component;

typedef char
    value_references_are_unsigned[sizeof(fmi3ValueReference) == sizeof(unsigned) ? 1 : -1];

static fmi3Status told(component *m, core_status status)
{
    static const fmi3Status as[] = {fmi3OK, fmi3Warning, fmi3Discard, fmi3Error};
    if (status != SUCCESS && m->logger != NULL && (m->logging || status == FAILURE)) {
        m->logger(m->environment, as[status],
            status == WARNING ? "logStatusWarning" : "logStatusError", m->c.message);
    }
    return as[status];
}

static fmi3Status refused(component *m, const char *why)
{
    return m == NULL ? fmi3Error : told(m, fail(&m->c, FAILURE, why));
}

static int in_phase(const component *m, unsigned allowed)
{
    return (allowed >> m->c.s.phase) & 1u;
}

#define PHASE(p) (1u << (p))
#define RUNNING (PHASE(EVENT) | PHASE(CONTINUOUS) | PHASE(STEPPING))
#define NEED(phases) \
    component *m = (component *)instance; \
    if (m == NULL) { \
        return fmi3Error; \
    } \
    if (!in_phase(m, (phases))) { \
        return refused(m, "this function may not be called in this state"); \
    }

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(
    fmi3Instance instance, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    component *m = (component *)instance;
    (void)n;
    (void)categories;
    if (m == NULL) {
        return fmi3Error;
    }
    m->logging = on;
    return fmi3OK;
}

/* --- instances ------------------------------------------------------------------------------- */

static fmi3Instance made(fmi3String token, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger, int co_simulation)
{
    component *m;
    if (token == NULL || strcmp(token, TOKEN) != 0) {
        if (logger != NULL) {
            logger(environment, fmi3Error, "logStatusError",
                "the instantiation token is not that of modelDescription.xml");
        }
        return NULL;
    }
    m = (component *)calloc(1, sizeof *m);
    if (m == NULL) {
        return NULL;
    }
    m->logger = logger;
    m->environment = environment;
    m->logging = logging;
    core_reset(&m->c);
    m->c.co_simulation = co_simulation;
    return m;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback logger)
{
    (void)name;
    (void)resources;
    (void)visible;
    return made(token, logging, environment, logger, 0);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
    fmi3Boolean visible, fmi3Boolean logging, fmi3Boolean event_mode, fmi3Boolean early_return,
    const fmi3ValueReference intermediate[], size_t n_intermediate,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
    fmi3IntermediateUpdateCallback update)
{
    (void)name;
    (void)resources;
    (void)visible;
    (void)early_return;
    (void)intermediate;
    (void)update;
    if (event_mode || n_intermediate > 0) {
        if (logger != NULL) {
            logger(environment, fmi3Error, "logStatusError",
                "given eventModeUsed or intermediate variables, which this FMU does not have");
        }
        return NULL;
    }
    return made(token, logging, environment, logger, 1);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String name, fmi3String token,
    fmi3String resources, fmi3Boolean visible, fmi3Boolean logging,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback logger,
    fmi3ClockUpdateCallback clock, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)visible;
    (void)logging;
    (void)clock;
    (void)lock;
    (void)unlock;
    if (logger != NULL) {
        logger(environment, fmi3Error, "logStatusError", "this FMU has no Scheduled Execution");
    }
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean tolerance_defined,
    fmi3Float64 tolerance, fmi3Float64 start, fmi3Boolean stop_defined, fmi3Float64 stop)
{
    NEED(PHASE(INSTANTIATED))(void) tolerance_defined;
    (void)tolerance;
    (void)stop_defined;
    (void)stop;
    if (!isfinite(start)) {
        return refused(m, "startTime: expected a finite number");
    }
    m->c.s.time = m->c.s.start = start;
    m->c.s.phase = INITIALIZATION;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    NEED(PHASE(INITIALIZATION))
    core_status status = core_begin(&m->c);
    m->c.s.phase = status == FAILURE ? BROKEN : m->c.co_simulation ? STEPPING : EVENT;
    return told(m, status);
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    NEED(PHASE(CONTINUOUS) | PHASE(EVENT))
    m->c.s.phase = EVENT;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    NEED(RUNNING)
    m->c.s.phase = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    component *m = (component *)instance;
    if (m == NULL) {
        return fmi3Error;
    }
    core_reset(&m->c);
    return fmi3OK;
}

/* --- variables ------------------------------------------------------------------------------- */

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    fmi3Float64 value[], size_t n_value)
{
    NEED(~PHASE(BROKEN))
    if (n_value != n) {
        return refused(m, "expected as many values as value references");
    }
    for (size_t i = 0; i < n; ++i) {
        if (core_get(&m->c, vr[i], &value[i]) != SUCCESS) {
            return told(m, FAILURE);
        }
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    const fmi3Float64 value[], size_t n_value)
{
    NEED(PHASE(INSTANTIATED) | PHASE(INITIALIZATION) | RUNNING)
    if (n_value != n) {
        return refused(m, "expected as many values as value references");
    }
    for (size_t i = 0; i < n; ++i) {
        if (core_set(&m->c, vr[i], value[i]) != SUCCESS) {
            return told(m, FAILURE);
        }
    }
    return fmi3OK;
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    fmi3Int32 value[], size_t n_value)
{
    NEED(~PHASE(BROKEN))
    if (n_value != n) {
        return refused(m, "expected as many values as value references");
    }
    for (size_t i = 0; i < n; ++i) {
        if (core_get_integer(&m->c, vr[i], &value[i]) != SUCCESS) {
            return told(m, FAILURE);
        }
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    const fmi3Int32 value[], size_t n_value)
{
    NEED(PHASE(INSTANTIATED) | PHASE(INITIALIZATION) | RUNNING)
    if (n_value != n) {
        return refused(m, "expected as many values as value references");
    }
    for (size_t i = 0; i < n; ++i) {
        if (core_set_integer(&m->c, vr[i], value[i]) != SUCCESS) {
            return told(m, FAILURE);
        }
    }
    return fmi3OK;
}

#define NO_SUCH_TYPE(name, pointer) \
    fmi3Status name(fmi3Instance instance, const fmi3ValueReference vr[], size_t n, pointer v[], \
        size_t n_value) \
    { \
        (void)vr; \
        (void)v; \
        (void)n_value; \
        return n == 0 && instance != NULL ? \
                   fmi3OK : \
                   refused((component *)instance, "no variables of this type"); \
    }

NO_SUCH_TYPE(fmi3GetFloat32, fmi3Float32)
NO_SUCH_TYPE(fmi3SetFloat32, const fmi3Float32)
NO_SUCH_TYPE(fmi3GetInt8, fmi3Int8)
NO_SUCH_TYPE(fmi3SetInt8, const fmi3Int8)
NO_SUCH_TYPE(fmi3GetUInt8, fmi3UInt8)
NO_SUCH_TYPE(fmi3SetUInt8, const fmi3UInt8)
NO_SUCH_TYPE(fmi3GetInt16, fmi3Int16)
NO_SUCH_TYPE(fmi3SetInt16, const fmi3Int16)
NO_SUCH_TYPE(fmi3GetUInt16, fmi3UInt16)
NO_SUCH_TYPE(fmi3SetUInt16, const fmi3UInt16)
NO_SUCH_TYPE(fmi3GetUInt32, fmi3UInt32)
NO_SUCH_TYPE(fmi3SetUInt32, const fmi3UInt32)
NO_SUCH_TYPE(fmi3GetInt64, fmi3Int64)
NO_SUCH_TYPE(fmi3SetInt64, const fmi3Int64)
NO_SUCH_TYPE(fmi3GetUInt64, fmi3UInt64)
NO_SUCH_TYPE(fmi3SetUInt64, const fmi3UInt64)
NO_SUCH_TYPE(fmi3GetBoolean, fmi3Boolean)
NO_SUCH_TYPE(fmi3SetBoolean, const fmi3Boolean)
NO_SUCH_TYPE(fmi3GetString, fmi3String)
NO_SUCH_TYPE(fmi3SetString, const fmi3String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    size_t sizes[], fmi3Binary values[], size_t n_values)
{
    (void)vr;
    (void)sizes;
    (void)values;
    (void)n_values;
    return n == 0 && instance != NULL ?
               fmi3OK :
               refused((component *)instance, "no variables of this type");
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    const size_t sizes[], const fmi3Binary values[], size_t n_values)
{
    (void)vr;
    (void)sizes;
    (void)values;
    (void)n_values;
    return n == 0 && instance != NULL ?
               fmi3OK :
               refused((component *)instance, "no variables of this type");
}

fmi3Status fmi3GetClock(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Clock values[])
{
    (void)vr;
    (void)values;
    return n == 0 && instance != NULL ? fmi3OK :
                                        refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3SetClock(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const fmi3Clock values[])
{
    (void)vr;
    (void)values;
    return n == 0 && instance != NULL ? fmi3OK :
                                        refused((component *)instance, "this FMU has no clocks");
}

/* --- saved states ---------------------------------------------------------------------------- */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    component *m = (component *)instance;
    if (m == NULL || state == NULL) {
        return fmi3Error;
    }
    if (*state == NULL) {
        *state = calloc(1, sizeof(core_saved));
        if (*state == NULL) {
            return refused(m, "no memory for the saved state");
        }
    }
    core_save(&m->c, (core_saved *)*state);
    return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    component *m = (component *)instance;
    if (m == NULL || state == NULL) {
        return fmi3Error;
    }
    return told(m, core_restore(&m->c, (const core_saved *)state));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    if (instance == NULL || state == NULL) {
        return fmi3Error;
    }
    free(*state);
    *state = NULL;
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    if (instance == NULL || state == NULL || size == NULL) {
        return fmi3Error;
    }
    *size = sizeof(core_saved);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(
    fmi3Instance instance, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    component *m = (component *)instance;
    if (m == NULL || state == NULL || bytes == NULL) {
        return fmi3Error;
    }
    if (size < sizeof(core_saved)) {
        return refused(m, "the array for the serialized state is too small");
    }
    memcpy(bytes, state, sizeof(core_saved));
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(
    fmi3Instance instance, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    component *m = (component *)instance;
    core_saved *taken;
    const char *damage;
    if (m == NULL || state == NULL || bytes == NULL) {
        return fmi3Error;
    }
    if (size != sizeof(core_saved)) {
        return refused(m, "the serialized state belongs to another FMU");
    }
    taken = malloc(sizeof *taken);
    if (taken == NULL) {
        return refused(m, "no memory for the saved state");
    }
    memcpy(taken, bytes, sizeof *taken);
    damage = core_damage(taken);
    if (damage != NULL) {
        free(taken);
        return refused(m, damage);
    }
    if (*state == NULL) {
        *state = taken;
    } else {
        memcpy(*state, taken, sizeof *taken);
        free(taken);
    }
    return fmi3OK;
}

/* --- derivatives, dependencies --------------------------------------------------------------- */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknown[],
    size_t n_unknown, const fmi3ValueReference known[], size_t n_known, const fmi3Float64 seed[],
    size_t n_seed, fmi3Float64 out[], size_t n_out)
{
    NEED(PHASE(INITIALIZATION) | RUNNING)
    if (n_seed != n_known || n_out != n_unknown) {
        return refused(m, "expected one seed for each known and one result for each unknown");
    }
    return told(m, core_derivative(&m->c, unknown, n_unknown, known, n_known, seed, out));
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknown[],
    size_t n_unknown, const fmi3ValueReference known[], size_t n_known, const fmi3Float64 seed[],
    size_t n_seed, fmi3Float64 out[], size_t n_out)
{
    (void)unknown;
    (void)n_unknown;
    (void)known;
    (void)n_known;
    (void)seed;
    (void)n_seed;
    (void)out;
    (void)n_out;
    return refused((component *)instance, "providesAdjointDerivatives is false");
}

fmi3Status fmi3GetNumberOfVariableDependencies(
    fmi3Instance instance, fmi3ValueReference reference, size_t *n)
{
    (void)reference;
    (void)n;
    return refused((component *)instance, "providesPerElementDependencies is false");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
    size_t of_dependent[], fmi3ValueReference independents[], size_t of_independents[],
    fmi3DependencyKind kinds[], size_t n)
{
    (void)dependent;
    (void)of_dependent;
    (void)independents;
    (void)of_independents;
    (void)kinds;
    (void)n;
    return refused((component *)instance, "providesPerElementDependencies is false");
}

/* --- configuration and clocks, which this FMU does not have ---------------------------------- */

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return refused((component *)instance, "this FMU has no structural parameters");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return refused((component *)instance, "this FMU has no structural parameters");
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)vr;
    (void)n;
    (void)intervals;
    (void)qualifiers;
    return refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)vr;
    (void)n;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3GetShiftDecimal(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t n, fmi3Float64 shifts[])
{
    (void)vr;
    (void)n;
    (void)shifts;
    return refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)vr;
    (void)n;
    (void)counters;
    (void)resolutions;
    return refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3SetIntervalDecimal(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const fmi3Float64 intervals[])
{
    (void)vr;
    (void)n;
    (void)intervals;
    return refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)vr;
    (void)n;
    (void)counters;
    (void)resolutions;
    return refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3SetShiftDecimal(
    fmi3Instance instance, const fmi3ValueReference vr[], size_t n, const fmi3Float64 shifts[])
{
    (void)vr;
    (void)n;
    (void)shifts;
    return refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)vr;
    (void)n;
    (void)counters;
    (void)resolutions;
    return refused((component *)instance, "this FMU has no clocks");
}

fmi3Status fmi3ActivateModelPartition(
    fmi3Instance instance, fmi3ValueReference clock, fmi3Float64 time)
{
    (void)clock;
    (void)time;
    return refused((component *)instance, "this FMU has no Scheduled Execution");
}

/* --- Model Exchange -------------------------------------------------------------------------- */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    NEED(PHASE(INITIALIZATION) | PHASE(EVENT))
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again,
    fmi3Boolean *terminate, fmi3Boolean *nominals_changed, fmi3Boolean *values_changed,
    fmi3Boolean *next_defined, fmi3Float64 *next)
{
    NEED(PHASE(EVENT))
    core_status status = core_event(&m->c);
    *again = *terminate = *nominals_changed = *values_changed = fmi3False;
    *next_defined = SAMPLE_TIME > 0.0;
    *next = SAMPLE_TIME > 0.0 ? core_next(&m->c) : 0.0;
    return told(m, status);
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    NEED(PHASE(EVENT))
    m->c.s.phase = CONTINUOUS;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(
    fmi3Instance instance, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *terminate)
{
    NEED(PHASE(CONTINUOUS))(void) keep;
    *event = *terminate = fmi3False;
    return fmi3OK;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    NEED(PHASE(EVENT) | PHASE(CONTINUOUS))
    if (!isfinite(time)) {
        return refused(m, "time: expected a finite number");
    }
    m->c.s.time = time;
    return fmi3OK;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 x[], size_t n)
{
    NEED(PHASE(EVENT) | PHASE(CONTINUOUS))
    if (n != N_X) {
        return refused(m, "the number of continuous states is another one");
    }
    for (size_t i = 0; i < n; ++i) {
        m->c.s.x[i] = x[i];
    }
    forget(&m->c);
    return fmi3OK;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 x[], size_t n)
{
    NEED(~PHASE(BROKEN))
    if (n != N_X) {
        return refused(m, "the number of continuous states is another one");
    }
    memcpy(x, m->c.s.x, n * sizeof *x);
    return fmi3OK;
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 rate[], size_t n)
{
    NEED(PHASE(INITIALIZATION) | RUNNING)
    if (n != N_X) {
        return refused(m, "the number of continuous states is another one");
    }
    if (refresh(&m->c, KIND_RATE) != SUCCESS) {
        return told(m, FAILURE);
    }
    memcpy(rate, m->c.rate, n * sizeof *rate);
    return fmi3OK;
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 indicators[], size_t n)
{
    NEED(~PHASE(BROKEN))(void) indicators;
    return n == 0 ? fmi3OK : refused(m, "this FMU has no event indicators");
}

fmi3Status fmi3GetNominalsOfContinuousStates(
    fmi3Instance instance, fmi3Float64 nominal[], size_t n)
{
    NEED(~PHASE(BROKEN))
    if (n != N_X) {
        return refused(m, "the number of continuous states is another one");
    }
    memcpy(nominal, X_NOMINAL, n * sizeof *nominal);
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *n)
{
    NEED(~PHASE(BROKEN))
    *n = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *n)
{
    NEED(~PHASE(BROKEN))
    *n = N_X;
    return fmi3OK;
}

/* --- Co-Simulation --------------------------------------------------------------------------- */

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    return refused((component *)instance, "hasEventMode is false");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference vr[], size_t n,
    const fmi3Int32 orders[], fmi3Float64 values[], size_t n_values)
{
    (void)vr;
    (void)orders;
    (void)values;
    (void)n_values;
    return n == 0 && instance != NULL ?
               fmi3OK :
               refused((component *)instance, "maxOutputDerivativeOrder is 0");
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 length,
    fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *terminate, fmi3Boolean *early,
    fmi3Float64 *last)
{
    NEED(PHASE(STEPPING))
    core_status status = core_step(&m->c, time, length);
    (void)keep;
    *event = *terminate = *early = fmi3False;
    *last = m->c.s.time;
    return told(m, status);
}
