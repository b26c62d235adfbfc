/* Counts of calls of malloc, calloc and realloc: in fmi2Instantiate; in 300 steps; in a saved state. Linked with
 * --wrap. */
#include "fmi2Functions.h"

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

static void logger(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
    fmi2String message, ...)
{
    (void)environment;
    (void)name;
    (void)status;
    (void)category;
    (void)message;
}

int main(void)
{
    const fmi2CallbackFunctions callbacks = {logger, calloc, free, NULL, NULL};
    const fmi2ValueReference input = 3000, output = 4000;
    fmi2FMUstate saved = NULL;
    fmi2Real value;
    int instantiated, stepped;
    fmi2Component c = fmi2Instantiate("counted", fmi2CoSimulation, GUID, "", &callbacks, fmi2False, fmi2False);
    instantiated = count;
    if (c == NULL || fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) != fmi2OK ||
        fmi2EnterInitializationMode(c) != fmi2OK || fmi2ExitInitializationMode(c) != fmi2OK) {
        return 1;
    }
    for (int k = 0; k < 300; ++k) {
        if (fmi2GetReal(c, &input, 1, &value) != fmi2OK || fmi2SetReal(c, &input, 1, &value) != fmi2OK ||
            fmi2DoStep(c, 1e-3 * k, 1e-3, fmi2True) > fmi2Warning || fmi2GetReal(c, &output, 1, &value) != fmi2OK) {
            return 2;
        }
    }
    stepped = count - instantiated;
    if (fmi2GetFMUstate(c, &saved) != fmi2OK) {
        return 3;
    }
    {
        const int states = count - instantiated - stepped;
        fmi2FreeFMUstate(c, &saved);
        fmi2FreeInstance(c);
        printf("%d %d %d\n", instantiated, stepped, states);
    }
    return 0;
}
