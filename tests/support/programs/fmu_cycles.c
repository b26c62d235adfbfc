/*
 * Loads an FMU's library, makes an instance, runs three steps, frees it, unloads the library: as
 * often as the second argument says. Prints by how many pages the resident memory has grown after
 * the first tenth. -DFMI3: version 3.0.
 */
#define _POSIX_C_SOURCE 200809L
#ifdef FMI3
#include "fmi3FunctionTypes.h"
#else
#include "fmi2FunctionTypes.h"
#endif

#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static long resident(void)
{
    long size = 0, pages = 0;
    FILE *file = fopen("/proc/self/statm", "r");
    if (file == NULL || fscanf(file, "%ld %ld", &size, &pages) != 2) {
        exit(9);
    }
    fclose(file);
    return pages;
}

static void *found(void *library, const char *name)
{
    void *symbol = dlsym(library, name);
    if (symbol == NULL) {
        exit(8);
    }
    return symbol;
}

/* dlsym gives a pointer to data; POSIX lets it point to a function. */
#define FIND(type, name) \
    type *name; \
    do { \
        void *symbol = found(library, #name); \
        memcpy(&name, &symbol, sizeof symbol); \
    } while (0)

#ifdef FMI3
static int run(void *library)
{
    FIND(fmi3InstantiateCoSimulationTYPE, fmi3InstantiateCoSimulation);
    FIND(fmi3EnterInitializationModeTYPE, fmi3EnterInitializationMode);
    FIND(fmi3ExitInitializationModeTYPE, fmi3ExitInitializationMode);
    FIND(fmi3DoStepTYPE, fmi3DoStep);
    FIND(fmi3FreeInstanceTYPE, fmi3FreeInstance);
    fmi3Boolean event, terminate, early;
    fmi3Float64 last;
    fmi3Instance c = fmi3InstantiateCoSimulation(
        "cycle", GUID, "", fmi3False, fmi3False, fmi3False, fmi3False, NULL, 0, NULL, NULL, NULL);
    int bad = c == NULL ||
              fmi3EnterInitializationMode(c, fmi3False, 0.0, 0.0, fmi3False, 0.0) != fmi3OK ||
              fmi3ExitInitializationMode(c) != fmi3OK;
    for (int k = 0; k < 3 && !bad; ++k) {
        bad = fmi3DoStep(c, 1e-3 * k, 1e-3, fmi3True, &event, &terminate, &early, &last) != fmi3OK;
    }
    fmi3FreeInstance(c);
    return bad;
}
#else
static int run(void *library)
{
    FIND(fmi2InstantiateTYPE, fmi2Instantiate);
    FIND(fmi2SetupExperimentTYPE, fmi2SetupExperiment);
    FIND(fmi2EnterInitializationModeTYPE, fmi2EnterInitializationMode);
    FIND(fmi2ExitInitializationModeTYPE, fmi2ExitInitializationMode);
    FIND(fmi2DoStepTYPE, fmi2DoStep);
    FIND(fmi2FreeInstanceTYPE, fmi2FreeInstance);
    const fmi2CallbackFunctions callbacks = {NULL, calloc, free, NULL, NULL};
    fmi2Component c = fmi2Instantiate(
        "cycle", fmi2CoSimulation, GUID, "", &callbacks, fmi2False, fmi2False);
    int bad = c == NULL || fmi2SetupExperiment(c, fmi2False, 0.0, 0.0, fmi2False, 0.0) != fmi2OK ||
              fmi2EnterInitializationMode(c) != fmi2OK || fmi2ExitInitializationMode(c) != fmi2OK;
    for (int k = 0; k < 3 && !bad; ++k) {
        bad = fmi2DoStep(c, 1e-3 * k, 1e-3, fmi2True) != fmi2OK;
    }
#ifndef LEAK
    fmi2FreeInstance(c);
#else
    (void)fmi2FreeInstance;
#endif
    return bad;
}
#endif

int main(int n, char **words)
{
    const int cycles = n == 3 ? atoi(words[2]) : 0;
    long before = 0;
    for (int k = 0; k < cycles; ++k) {
        void *library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL);
        if (library == NULL || run(library)) {
            return 1;
        }
        dlclose(library);
        if (k == cycles / 10) {
            before = resident();
        }
    }
    printf("%ld\n", resident() - before);
    return 0;
}
