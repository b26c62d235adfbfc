/*
 * Inverse dynamics of the arm as a block of Simulink: a level-2 S-function in C.
 * Written by flexgen.
 *
 * Inputs: q_a, v_a, a_a (MODEL_NA each), output: tau_a (MODEL_NA); continuous or at the sample
 * time of the inputs.
 */
#define S_FUNCTION_NAME model_inverse_dynamics_sfun
#define S_FUNCTION_LEVEL 2

#include "simstruc.h"

#include "model_ccaller.h"
#include "model.h"

static void mdlInitializeSizes(SimStruct *S)
{
    ssSetNumSFcnParams(S, 0);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S)) {
        return;
    }
    if (!ssSetNumInputPorts(S, 3) || !ssSetNumOutputPorts(S, 1)) {
        return;
    }
    for (int k = 0; k < 3; ++k) {
        ssSetInputPortWidth(S, k, MODEL_NA);
        ssSetInputPortDirectFeedThrough(S, k, 1);
        ssSetInputPortRequiredContiguous(S, k, 1);
    }
    ssSetOutputPortWidth(S, 0, MODEL_NA);
    ssSetNumSampleTimes(S, 1);
    ssSetOptions(S, SS_OPTION_EXCEPTION_FREE_CODE);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, INHERITED_SAMPLE_TIME);
    ssSetOffsetTime(S, 0, 0.0);
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
    (void)tid;
    const int status = model_ccaller_inverse_dynamics(ssGetInputPortRealSignal(S, 0),
        ssGetInputPortRealSignal(S, 1), ssGetInputPortRealSignal(S, 2),
        ssGetOutputPortRealSignal(S, 0));
    if (status < 0) {
        ssSetErrorStatus(S, model_status_text(status));
    }
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
