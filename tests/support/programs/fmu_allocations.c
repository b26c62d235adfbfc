/*
 * Counts of calls of malloc, calloc and realloc: in the instantiation; in 300 steps; in a saved
 * state. Linked with --wrap. With FMI3 defined for FMI 3.0, with EXCHANGE defined for Model
 * Exchange.
 */
#ifdef FMI3
#include "fmi3Functions.h"
#else
#include "fmi2Functions.h"
#endif

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

static int count;

void *__real_malloc(size_t size);
void *__real_calloc(size_t n, size_t size);
void *__real_realloc(void *old, size_t size);

void *__wrap_malloc(size_t size)
{
    ++count;
    return __real_malloc(size);
}

void *__wrap_calloc(size_t n, size_t size)
{
    ++count;
    return __real_calloc(n, size);
}

void *__wrap_realloc(void *old, size_t size)
{
    ++count;
    return __real_realloc(old, size);
}

#ifdef FMI3
typedef fmi3Instance instance;
typedef fmi3FMUState saved_state;
#define OK fmi3OK

static void logger(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
    fmi3String message)
{
    (void)environment;
    (void)status;
    (void)category;
    (void)message;
}

static instance created(void)
{
#ifdef EXCHANGE
    instance c = fmi3InstantiateModelExchange(
        "counted", GUID, "", fmi3False, fmi3False, NULL, logger);
#else
    instance c = fmi3InstantiateCoSimulation("counted", GUID, "", fmi3False, fmi3False, fmi3False,
        fmi3False, NULL, 0, NULL, logger, NULL);
#endif
    return c;
}

static int initialized(instance c)
{
    return fmi3EnterInitializationMode(c, fmi3False, 0.0, 0.0, fmi3False, 0.0) == OK &&
           fmi3ExitInitializationMode(c) == OK;
}

static int stepped_once(instance c, int k)
{
    const fmi3ValueReference input = 3000, output = 4000;
    double value, x[64], dx[64];
    size_t n = 0;
    int good = fmi3GetFloat64(c, &input, 1, &value, 1) == OK &&
               fmi3SetFloat64(c, &input, 1, &value, 1) == OK;
#ifdef EXCHANGE
    good = good && fmi3GetNumberOfContinuousStates(c, &n) == OK && n <= 64 &&
           fmi3SetTime(c, 1e-3 * k) == OK;
    good = good && fmi3GetContinuousStates(c, x, n) == OK &&
           fmi3SetContinuousStates(c, x, n) == OK;
    good = good && fmi3GetContinuousStateDerivatives(c, dx, n) == OK;
#else
    fmi3Boolean event, terminate, early;
    double last;
    (void)n;
    (void)x;
    (void)dx;
    good = good && fmi3DoStep(c, 1e-3 * k, 1e-3, fmi3True, &event, &terminate, &early, &last) <=
                       fmi3Warning;
#endif
    return good && fmi3GetFloat64(c, &output, 1, &value, 1) == OK;
}

#define get_state fmi3GetFMUState
#define free_state fmi3FreeFMUState
#define free_instance fmi3FreeInstance
#define enter_continuous(c) (fmi3EnterContinuousTimeMode(c) == OK)
#else
typedef fmi2Component instance;
typedef fmi2FMUstate saved_state;
#define OK fmi2OK

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
    fmi2String category, fmi2String message, ...)
{
    (void)environment;
    (void)name;
    (void)status;
    (void)category;
    (void)message;
}

static const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};

static instance created(void)
{
#ifdef EXCHANGE
    const fmi2Type kind = fmi2ModelExchange;
#else
    const fmi2Type kind = fmi2CoSimulation;
#endif
    return fmi2Instantiate("counted", kind, GUID, "", &callbacks, fmi2False, fmi2False);
}

static int initialized(instance c)
{
    return fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) == OK &&
           fmi2EnterInitializationMode(c) == OK && fmi2ExitInitializationMode(c) == OK;
}

static int stepped_once(instance c, int k)
{
    const fmi2ValueReference input = 3000, output = 4000;
    fmi2Real value;
    int good = fmi2GetReal(c, &input, 1, &value) == OK && fmi2SetReal(c, &input, 1, &value) == OK;
#ifdef EXCHANGE
    double x[CONTINUOUS_STATES], dx[CONTINUOUS_STATES];
    good = good && fmi2SetTime(c, 1e-3 * k) == OK &&
           fmi2GetContinuousStates(c, x, CONTINUOUS_STATES) == OK;
    good = good && fmi2SetContinuousStates(c, x, CONTINUOUS_STATES) == OK &&
           fmi2GetDerivatives(c, dx, CONTINUOUS_STATES) == OK;
#else
    good = good && fmi2DoStep(c, 1e-3 * k, 1e-3, fmi2True) <= fmi2Warning;
#endif
    return good && fmi2GetReal(c, &output, 1, &value) == OK;
}

#define get_state fmi2GetFMUstate
#define free_state fmi2FreeFMUstate
#define free_instance fmi2FreeInstance
#define enter_continuous(c) (fmi2EnterContinuousTimeMode(c) == OK)
#endif

int main(void)
{
    saved_state saved = NULL;
    int instantiated, stepped, states;
    instance c = created();
    instantiated = count;
    if (c == NULL || !initialized(c)) {
        return 1;
    }
#ifdef EXCHANGE
    if (!enter_continuous(c)) {
        return 4;
    }
#endif
    for (int k = 0; k < 300; ++k) {
        if (!stepped_once(c, k)) {
            return 2;
        }
    }
    stepped = count - instantiated;
    if (get_state(c, &saved) != OK) {
        return 3;
    }
    states = count - instantiated - stepped;
    free_state(c, &saved);
    free_instance(c);
    printf("%d %d %d\n", instantiated, stepped, states);
    return 0;
}
