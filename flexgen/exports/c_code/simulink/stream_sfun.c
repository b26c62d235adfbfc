/*
 * A stream as a block of Simulink: a level-2 S-function in C. Written by flexgen.
 *
 * Inputs, one sample a period: y (MODEL_NT), dy (MODEL_NY), ddy (MODEL_NY): the output and its
 * derivatives at the end of the horizon. Outputs: tau_m, q_m, v_m (MODEL_NM times
 * samples_per_interval each, sample after sample) of the interval that begins now, and the status
 * (0, or positive with a warning). A negative status stops the simulation.
 *
 * Parameters: period [s], intervals, samples_per_interval, tolerance, hold (0 spline, 1 linear, 2
 * held), delay [samples], start_output (MODEL_NT), q_start (MODEL_NA).
 *
 * mdlOutputs works on a copy of the memory, which mdlUpdate keeps: it may be called several times
 * in a step.
 */
#define S_FUNCTION_NAME model_stream_sfun
#define S_FUNCTION_LEVEL 2

#include "simstruc.h"

#include "model.h"

#include <string.h>

enum { PERIOD, INTERVALS, SAMPLES, TOLERANCE, HOLD, DELAY, START_OUTPUT, Q_START, PARAMETERS };
enum { KEPT, SCRATCH, MEMORIES };
enum { TAU_M, Q_M, V_M, STATUS, OUTPUTS };

static const int LENGTHS[PARAMETERS] = {1, 1, 1, 1, 1, 1, MODEL_NT, MODEL_NA};

static double parameter(SimStruct *S, int which)
{
    return mxGetPr(ssGetSFcnParam(S, which))[0];
}

static model_stream_options options_of(SimStruct *S)
{
    const model_stream_options options = {
        .intervals = (int)parameter(S, INTERVALS),
        .samples_per_interval = (int)parameter(S, SAMPLES),
        .period = parameter(S, PERIOD),
        .tolerance = parameter(S, TOLERANCE),
        .hold = (model_hold)(int)parameter(S, HOLD),
        .delay = parameter(S, DELAY),
    };
    return options;
}

/* The stream in a memory of the block. */
static model_stream stream_in(SimStruct *S, int memory)
{
    const model_stream_options options = options_of(S);
    const model_stream stream = {
        .memory = (double *)ssGetDWork(S, memory), .size = model_stream_work(&options)};
    return stream;
}

/* The reason why the parameters cannot be used, or null. */
static const char *problem(SimStruct *S)
{
    for (int k = 0; k < PARAMETERS; ++k) {
        const mxArray *const x = ssGetSFcnParam(S, k);
        if (!mxIsDouble(x) || mxIsComplex(x) || mxGetNumberOfElements(x) != (size_t)LENGTHS[k]) {
            return "parameters: expected period, intervals, samples_per_interval, tolerance, "
                   "hold, delay, "
                   "start_output and q_start, real numbers of the right count";
        }
    }
    for (int k = INTERVALS; k <= HOLD; ++k) {
        const double x = parameter(S, k);
        if (k != TOLERANCE && (!(x >= 0.0 && x <= 1e6) || x != (double)(int)x)) {
            return "parameters: intervals, samples_per_interval and hold must be whole numbers";
        }
    }
    const model_stream_options options = options_of(S);
    if (!(options.period > 0.0) || model_stream_work(&options) < 0) {
        return "parameters: expected 1 to 10000 intervals, 1 to 1000 samples_per_interval, hold 0 "
               "to 2, a delay of 0 "
               "to 4 and a period above 0";
    }
    return NULL;
}

#define MDL_CHECK_PARAMETERS
static void mdlCheckParameters(SimStruct *S)
{
    const char *const reason = problem(S);
    if (reason) {
        ssSetErrorStatus(S, reason);
    }
}

static void mdlInitializeSizes(SimStruct *S)
{
    const int inputs[] = {MODEL_NT, MODEL_NY, MODEL_NY};
    ssSetNumSFcnParams(S, PARAMETERS);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S)) {
        return; /* Simulink reports it */
    }
    mdlCheckParameters(S);
    if (ssGetErrorStatus(S)) {
        return;
    }
    for (int k = 0; k < PARAMETERS; ++k) {
        ssSetSFcnParamTunable(S, k, 0);
    }
    const model_stream_options options = options_of(S);
    if (!ssSetNumInputPorts(S, 3) || !ssSetNumOutputPorts(S, OUTPUTS)) {
        return;
    }
    for (int k = 0; k < 3; ++k) {
        ssSetInputPortWidth(S, k, inputs[k]);
        ssSetInputPortDirectFeedThrough(S, k, 1);
        ssSetInputPortRequiredContiguous(S, k, 1);
    }
    for (int k = 0; k < OUTPUTS; ++k) {
        ssSetOutputPortWidth(S, k, k == STATUS ? 1 : MODEL_NM * options.samples_per_interval);
    }
    ssSetNumSampleTimes(S, 1);
    ssSetNumDWork(S, MEMORIES);
    for (int k = 0; k < MEMORIES; ++k) {
        ssSetDWorkWidth(S, k, (int)model_stream_work(&options));
        ssSetDWorkDataType(S, k, SS_DOUBLE);
    }
    ssSetOptions(S, SS_OPTION_EXCEPTION_FREE_CODE);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, parameter(S, PERIOD));
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_START
static void mdlStart(SimStruct *S)
{
    const model_stream_options options = options_of(S);
    const model_stream stream = stream_in(S, KEPT);
    const model_status status = model_stream_start(&stream, &options,
        mxGetPr(ssGetSFcnParam(S, START_OUTPUT)), mxGetPr(ssGetSFcnParam(S, Q_START)));
    if (status < 0) {
        ssSetErrorStatus(S, model_status_text(status));
    }
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
    (void)tid;
    const model_stream stream = stream_in(S, SCRATCH);
    memcpy(stream.memory, ssGetDWork(S, KEPT), (size_t)stream.size * sizeof *stream.memory);
    model_motion motion = {NULL};
    motion.tau_m = ssGetOutputPortRealSignal(S, TAU_M);
    motion.q_m = ssGetOutputPortRealSignal(S, Q_M);
    motion.v_m = ssGetOutputPortRealSignal(S, V_M);
    model_stream_info info;
    const model_status status = model_stream_update(&stream, ssGetInputPortRealSignal(S, 0),
        ssGetInputPortRealSignal(S, 1), ssGetInputPortRealSignal(S, 2), &motion, &info);
    ssGetOutputPortRealSignal(S, STATUS)[0] = (double)status;
    if (status < 0) {
        ssSetErrorStatus(S, model_status_text(status));
    }
}

#define MDL_UPDATE
static void mdlUpdate(SimStruct *S, int_T tid)
{
    (void)tid;
    const model_stream_options options = options_of(S);
    memcpy(ssGetDWork(S, KEPT), ssGetDWork(S, SCRATCH),
        (size_t)model_stream_work(&options) * sizeof(double));
}

static void mdlTerminate(SimStruct *S)
{
    (void)S;
}

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
