/*
 * The interface of FMI 2.0, Model Exchange and Co-Simulation. Memory is taken in fmi2Instantiate
 * and for saved states only; instances share nothing, so that each may run in a separate thread.
 */
#include "flexgen_fmu_config.h"
#include "fmi2Functions.h"

#include <stdlib.h>

#include "flexgen_fmu_core.h"

typedef struct {
    core c; /* first: a component is a core */
    fmi2CallbackLogger logger;
    fmi2CallbackFreeMemory release;
    fmi2ComponentEnvironment environment;
    int logging;
    char name[256];
} component;

typedef char
    value_references_are_unsigned[sizeof(fmi2ValueReference) == sizeof(unsigned) ? 1 : -1];

static fmi2Status told(component *m, core_status status)
{
    static const fmi2Status as[] = {fmi2OK, fmi2Warning, fmi2Discard, fmi2Error};
    if (status != SUCCESS && m->logger != NULL && (m->logging || status == FAILURE)) {
        m->logger(m->environment, m->name, as[status],
            status == WARNING ? "logStatusWarning" : "logStatusError", "%s", m->c.message);
    }
    return as[status];
}

static fmi2Status refused(component *m, const char *why)
{
    return told(m, fail(&m->c, FAILURE, why));
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
        return fmi2Error; \
    } \
    if (!in_phase(m, (phases))) { \
        return refused(m, "this function may not be called in this state"); \
    }

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(
    fmi2Component instance, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    component *m = (component *)instance;
    (void)n;
    (void)categories;
    if (m == NULL) {
        return fmi2Error;
    }
    m->logging = on != fmi2False;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid,
    fmi2String resources, const fmi2CallbackFunctions *functions, fmi2Boolean visible,
    fmi2Boolean logging)
{
    component *m;
    int own;
    (void)resources;
    (void)visible;
    if (functions == NULL || guid == NULL || strcmp(guid, TOKEN) != 0) {
        if (functions != NULL && functions->logger != NULL) {
            functions->logger(functions->componentEnvironment, name == NULL ? "" : name, fmi2Error,
                "logStatusError", "%s", "the GUID is not that of modelDescription.xml");
        }
        return NULL;
    }
    own = functions->allocateMemory == NULL || functions->freeMemory == NULL;
    m = (component *)(own ? calloc(1, sizeof *m) : functions->allocateMemory(1, sizeof *m));
    if (m == NULL) {
        return NULL;
    }
    memset(m, 0, sizeof *m);
    m->logger = functions->logger;
    m->release = own ? free : functions->freeMemory;
    m->environment = functions->componentEnvironment;
    m->logging = logging != fmi2False;
    if (name != NULL) {
        strncpy(m->name, name, sizeof m->name - 1);
    }
    core_reset(&m->c);
    m->c.co_simulation = type == fmi2CoSimulation;
    return m;
}

void fmi2FreeInstance(fmi2Component instance)
{
    component *m = (component *)instance;
    if (m != NULL) {
        m->release(m);
    }
}

fmi2Status fmi2SetupExperiment(fmi2Component instance, fmi2Boolean tolerance_defined,
    fmi2Real tolerance, fmi2Real start, fmi2Boolean stop_defined, fmi2Real stop)
{
    NEED(PHASE(INSTANTIATED))(void) tolerance_defined;
    (void)tolerance;
    (void)stop_defined;
    (void)stop;
    if (!isfinite(start)) {
        return refused(m, "startTime: expected a finite number");
    }
    m->c.s.time = m->c.s.start = start;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component instance)
{
    NEED(PHASE(INSTANTIATED))
    m->c.s.phase = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component instance)
{
    NEED(PHASE(INITIALIZATION))
    core_status status = core_begin(&m->c);
    m->c.s.phase = status == FAILURE ? BROKEN : m->c.co_simulation ? STEPPING : EVENT;
    return told(m, status);
}

fmi2Status fmi2Terminate(fmi2Component instance)
{
    NEED(RUNNING)
    m->c.s.phase = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component instance)
{
    component *m = (component *)instance;
    if (m == NULL) {
        return fmi2Error;
    }
    core_reset(&m->c);
    return fmi2OK;
}

fmi2Status fmi2GetReal(
    fmi2Component instance, const fmi2ValueReference vr[], size_t n, fmi2Real value[])
{
    NEED(~PHASE(BROKEN))
    for (size_t i = 0; i < n; ++i) {
        if (core_get(&m->c, vr[i], &value[i]) != SUCCESS) {
            return told(m, FAILURE);
        }
    }
    return fmi2OK;
}

fmi2Status fmi2SetReal(
    fmi2Component instance, const fmi2ValueReference vr[], size_t n, const fmi2Real value[])
{
    NEED(PHASE(INSTANTIATED) | PHASE(INITIALIZATION) | RUNNING)
    for (size_t i = 0; i < n; ++i) {
        if (core_set(&m->c, vr[i], value[i]) != SUCCESS) {
            return told(m, FAILURE);
        }
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(
    fmi2Component instance, const fmi2ValueReference vr[], size_t n, fmi2Integer value[])
{
    NEED(~PHASE(BROKEN))
    for (size_t i = 0; i < n; ++i) {
        int32_t own = 0;
        if (core_get_integer(&m->c, vr[i], &own) != SUCCESS) {
            return told(m, FAILURE);
        }
        value[i] = own;
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(
    fmi2Component instance, const fmi2ValueReference vr[], size_t n, const fmi2Integer value[])
{
    NEED(PHASE(INSTANTIATED) | PHASE(INITIALIZATION) | RUNNING)
    for (size_t i = 0; i < n; ++i) {
        if (core_set_integer(&m->c, vr[i], value[i]) != SUCCESS) {
            return told(m, FAILURE);
        }
    }
    return fmi2OK;
}

#define NO_SUCH_TYPE(name, pointer) \
    fmi2Status name(fmi2Component instance, const fmi2ValueReference vr[], size_t n, pointer v[]) \
    { \
        component *m = (component *)instance; \
        (void)vr; \
        (void)v; \
        if (m == NULL) { \
            return fmi2Error; \
        } \
        return n == 0 ? fmi2OK : refused(m, "this FMU has no variables of this type"); \
    }

NO_SUCH_TYPE(fmi2GetBoolean, fmi2Boolean)
NO_SUCH_TYPE(fmi2SetBoolean, const fmi2Boolean)
NO_SUCH_TYPE(fmi2GetString, fmi2String)
NO_SUCH_TYPE(fmi2SetString, const fmi2String)

/* --- saved states ---------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component instance, fmi2FMUstate *state)
{
    component *m = (component *)instance;
    if (m == NULL || state == NULL) {
        return fmi2Error;
    }
    if (*state == NULL) {
        *state = calloc(1, sizeof(core_saved));
        if (*state == NULL) {
            return refused(m, "no memory for the saved state");
        }
    }
    core_save(&m->c, (core_saved *)*state);
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component instance, fmi2FMUstate state)
{
    component *m = (component *)instance;
    if (m == NULL || state == NULL) {
        return fmi2Error;
    }
    return told(m, core_restore(&m->c, (const core_saved *)state));
}

fmi2Status fmi2FreeFMUstate(fmi2Component instance, fmi2FMUstate *state)
{
    if (instance == NULL || state == NULL) {
        return fmi2Error;
    }
    free(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component instance, fmi2FMUstate state, size_t *size)
{
    if (instance == NULL || state == NULL || size == NULL) {
        return fmi2Error;
    }
    *size = sizeof(core_saved);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(
    fmi2Component instance, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    component *m = (component *)instance;
    if (m == NULL || state == NULL || bytes == NULL) {
        return fmi2Error;
    }
    if (size < sizeof(core_saved)) {
        return refused(m, "the array for the serialized state is too small");
    }
    memcpy(bytes, state, sizeof(core_saved));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(
    fmi2Component instance, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    component *m = (component *)instance;
    core_saved *taken;
    const char *damage;
    if (m == NULL || state == NULL || bytes == NULL) {
        return fmi2Error;
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
    return fmi2OK;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component instance, const fmi2ValueReference unknown[],
    size_t n_unknown, const fmi2ValueReference known[], size_t n_known, const fmi2Real seed[],
    fmi2Real out[])
{
    NEED(PHASE(INITIALIZATION) | RUNNING)
    return told(m, core_derivative(&m->c, unknown, n_unknown, known, n_known, seed, out));
}

/* --- Model Exchange -------------------------------------------------------------------------- */

fmi2Status fmi2EnterEventMode(fmi2Component instance)
{
    NEED(PHASE(CONTINUOUS) | PHASE(EVENT))
    m->c.s.phase = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component instance, fmi2EventInfo *info)
{
    NEED(PHASE(EVENT))
    core_status status = core_event(&m->c);
    memset(info, 0, sizeof *info);
    info->nextEventTimeDefined = SAMPLE_TIME > 0.0;
    info->nextEventTime = SAMPLE_TIME > 0.0 ? core_next(&m->c) : 0.0;
    return told(m, status);
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component instance)
{
    NEED(PHASE(EVENT))
    m->c.s.phase = CONTINUOUS;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(
    fmi2Component instance, fmi2Boolean keep, fmi2Boolean *event, fmi2Boolean *terminate)
{
    NEED(PHASE(CONTINUOUS))(void) keep;
    *event = *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component instance, fmi2Real time)
{
    NEED(PHASE(EVENT) | PHASE(CONTINUOUS))
    if (!isfinite(time)) {
        return refused(m, "time: expected a finite number");
    }
    m->c.s.time = time;
    return fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component instance, const fmi2Real x[], size_t n)
{
    NEED(PHASE(EVENT) | PHASE(CONTINUOUS))
    if (n != N_X) {
        return refused(m, "the number of continuous states is another one");
    }
    for (size_t i = 0; i < n; ++i) {
        m->c.s.x[i] = x[i];
    }
    forget(&m->c);
    return fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component instance, fmi2Real x[], size_t n)
{
    NEED(~PHASE(BROKEN))
    if (n != N_X) {
        return refused(m, "the number of continuous states is another one");
    }
    memcpy(x, m->c.s.x, n * sizeof *x);
    return fmi2OK;
}

fmi2Status fmi2GetDerivatives(fmi2Component instance, fmi2Real rate[], size_t n)
{
    NEED(PHASE(INITIALIZATION) | RUNNING)
    if (n != N_X) {
        return refused(m, "the number of continuous states is another one");
    }
    if (refresh(&m->c, KIND_RATE) != SUCCESS) {
        return told(m, FAILURE);
    }
    memcpy(rate, m->c.rate, n * sizeof *rate);
    return fmi2OK;
}

fmi2Status fmi2GetEventIndicators(fmi2Component instance, fmi2Real indicators[], size_t n)
{
    NEED(~PHASE(BROKEN))(void) indicators;
    return n == 0 ? fmi2OK : refused(m, "this FMU has no event indicators");
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component instance, fmi2Real nominal[], size_t n)
{
    NEED(~PHASE(BROKEN))
    if (n != N_X) {
        return refused(m, "the number of continuous states is another one");
    }
    memcpy(nominal, X_NOMINAL, n * sizeof *nominal);
    return fmi2OK;
}

/* --- Co-Simulation --------------------------------------------------------------------------- */

fmi2Status fmi2DoStep(fmi2Component instance, fmi2Real time, fmi2Real length, fmi2Boolean keep)
{
    NEED(PHASE(STEPPING))(void) keep;
    return told(m, core_step(&m->c, time, length));
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component instance, const fmi2ValueReference vr[],
    size_t n, const fmi2Integer order[], const fmi2Real value[])
{
    NEED(~PHASE(BROKEN))(void) vr;
    (void)order;
    (void)value;
    return n == 0 ? fmi2OK :
                    refused(m, "inputs are held in a step: canInterpolateInputs is false");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component instance, const fmi2ValueReference vr[],
    size_t n, const fmi2Integer order[], fmi2Real value[])
{
    NEED(~PHASE(BROKEN))(void) vr;
    (void)order;
    (void)value;
    return n == 0 ? fmi2OK : refused(m, "maxOutputDerivativeOrder is 0");
}

fmi2Status fmi2CancelStep(fmi2Component instance)
{
    NEED(~PHASE(BROKEN))
    return refused(m, "steps are synchronous: there is none to cancel");
}

fmi2Status fmi2GetStatus(fmi2Component instance, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)instance;
    (void)kind;
    (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component instance, const fmi2StatusKind kind, fmi2Real *value)
{
    const component *m = (const component *)instance;
    if (m == NULL || kind != fmi2LastSuccessfulTime) {
        return fmi2Discard;
    }
    *value = m->c.s.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(
    fmi2Component instance, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)instance;
    (void)kind;
    (void)value;
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(
    fmi2Component instance, const fmi2StatusKind kind, fmi2Boolean *value)
{
    (void)instance;
    if (kind != fmi2Terminated) {
        return fmi2Discard;
    }
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(
    fmi2Component instance, const fmi2StatusKind kind, fmi2String *value)
{
    (void)instance;
    (void)kind;
    (void)value;
    return fmi2Discard;
}
