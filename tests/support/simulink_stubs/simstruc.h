/*
 * What an S-function calls: a SimStruct with fixed sizes, and functions instead of Simulink's
 * macros.
 */
#ifndef STUB_SIMSTRUC_H
#define STUB_SIMSTRUC_H

#include <stddef.h>
#include <stdlib.h>

typedef int int_T;
typedef double real_T;

typedef struct {
    double *data;
    size_t n;
    int complex;
} mxArray;

typedef struct {
    int parameters_expected, parameters_given, n_in, n_out, n_dwork, n_times;
    const mxArray *parameters[16];
    int tunable[16], in_width[8], out_width[8], feedthrough[8], contiguous[8], dwork_width[8];
    const real_T *in[8];
    real_T *out[8];
    void *dwork[8];
    real_T sample_time, offset;
    const char *error;
    unsigned options;
} SimStruct;

#define SS_DOUBLE 0
#define SS_OPTION_EXCEPTION_FREE_CODE 1u
#define INHERITED_SAMPLE_TIME (-1.0)

static inline int mxIsDouble(const mxArray *x)
{
    return x->data != NULL;
}
static inline int mxIsComplex(const mxArray *x)
{
    return x->complex;
}
static inline size_t mxGetNumberOfElements(const mxArray *x)
{
    return x->n;
}
static inline double *mxGetPr(const mxArray *x)
{
    return x->data;
}
static inline void ssSetNumSFcnParams(SimStruct *S, int n)
{
    S->parameters_expected = n;
}
static inline int ssGetNumSFcnParams(const SimStruct *S)
{
    return S->parameters_expected;
}
static inline int ssGetSFcnParamsCount(const SimStruct *S)
{
    return S->parameters_given;
}
static inline const mxArray *ssGetSFcnParam(const SimStruct *S, int k)
{
    return S->parameters[k];
}
static inline void ssSetSFcnParamTunable(SimStruct *S, int k, int tunable)
{
    S->tunable[k] = tunable;
}
static inline void ssSetErrorStatus(SimStruct *S, const char *text)
{
    S->error = text;
}
static inline const char *ssGetErrorStatus(const SimStruct *S)
{
    return S->error;
}
static inline int ssSetNumInputPorts(SimStruct *S, int n)
{
    S->n_in = n;
    return 1;
}
static inline int ssSetNumOutputPorts(SimStruct *S, int n)
{
    S->n_out = n;
    return 1;
}
static inline void ssSetInputPortWidth(SimStruct *S, int k, int width)
{
    S->in_width[k] = width;
}
static inline void ssSetOutputPortWidth(SimStruct *S, int k, int width)
{
    S->out_width[k] = width;
}
static inline void ssSetInputPortDirectFeedThrough(SimStruct *S, int k, int given)
{
    S->feedthrough[k] = given;
}
static inline void ssSetInputPortRequiredContiguous(SimStruct *S, int k, int given)
{
    S->contiguous[k] = given;
}
static inline void ssSetNumSampleTimes(SimStruct *S, int n)
{
    S->n_times = n;
}
static inline void ssSetSampleTime(SimStruct *S, int k, real_T time)
{
    S->sample_time = k == 0 ? time : 0.0;
}
static inline void ssSetOffsetTime(SimStruct *S, int k, real_T time)
{
    S->offset = k == 0 ? time : 0.0;
}
static inline void ssSetNumDWork(SimStruct *S, int n)
{
    S->n_dwork = n;
}
static inline void ssSetDWorkWidth(SimStruct *S, int k, int width)
{
    S->dwork_width[k] = width;
}
static inline void ssSetDWorkDataType(SimStruct *S, int k, int type)
{
    (void)S, (void)k, (void)type;
}
static inline void *ssGetDWork(const SimStruct *S, int k)
{
    return S->dwork[k];
}
static inline const real_T *ssGetInputPortRealSignal(const SimStruct *S, int k)
{
    return S->in[k];
}
static inline real_T *ssGetOutputPortRealSignal(const SimStruct *S, int k)
{
    return S->out[k];
}
static inline void ssSetOptions(SimStruct *S, unsigned options)
{
    S->options = options;
}

#endif
