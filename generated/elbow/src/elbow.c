/* elbow: identity and sizes of the library. Written by flexgen; see elbow.h. */
#include "../elbow_batch.h"
#include "../elbow_inversion.h"

#ifdef _OPENMP
#include <omp.h>
#endif

const char *elbow_status_text(elbow_status status)
{
    switch (status) {
    case ELBOW_OK:
        return "success";
    case ELBOW_NULL_ARGUMENT:
        return "an argument is a null pointer";
    case ELBOW_INPUT_NOT_FINITE:
        return "an input is not finite; the outputs are NaN";
    case ELBOW_RESULT_NOT_FINITE:
        return "a result is not finite: the system of equations is singular, or a number overflows";
    case ELBOW_BAD_COUNT:
        return "the number of points is negative, or above the stride";
    case ELBOW_BAD_ARGUMENT:
        return "a size, a time or a rotation matrix is out of range, or the path does not begin and end at zero velocity";
    case ELBOW_WORK_TOO_SMALL:
        return "the workspace is too small";
    case ELBOW_UNREACHABLE:
        return "the path leaves the workspace of the robot or passes a singular pose";
    case ELBOW_NOT_CONVERGED:
        return "the iteration did not converge";
    case ELBOW_NOT_STARTED:
        return "the stream was not started by this library, or has failed";
    case ELBOW_ZERO_AT_INFINITY:
        return "a zero of the zero dynamics goes through infinity on the path; use invert (method lq)";
    case ELBOW_ZEROS_CHANGE:
        return "the number of unstable zeros differs between start and end; use invert (method lq)";
    case ELBOW_ZERO_ON_AXIS:
        return "a zero is on the imaginary axis at an end of the path; use invert (method lq)";
    case ELBOW_HORIZON_TOO_SHORT:
        return "the horizon is too short to keep limits: use at least 4 intervals, and 1.5 times the preview of the zeros";
    case ELBOW_LIMITS_INFEASIBLE:
        return "the limits cannot be kept; increase them, slow down the path or give the motion more time";
    case ELBOW_TOLERANCE_NOT_MET:
        return "residual, mismatch, torque step or torque error above its tolerance (see the info): use a shorter period";
    case ELBOW_LIMITS_ACTIVE:
        return "the limits move the output away from its path, or are exceeded; the info says how far";
    default:
        return "unknown status";
    }
}

const char *elbow_digest(void)
{
    return "eefc5f5ac69e6de452e399331df1aa0d6d61349d3dfc7a865c73226a3b12eda1";
}

const char *elbow_interface(void)
{
    return "6937627cc8f09aa8559dd87bdaa266e273ded89ad325b0cddc72758d9663287d";
}

elbow_inversion_options elbow_inversion_defaults(void)
{
    elbow_inversion_options options;
    options.n_pre = 0;
    options.n_post = 0;
    options.samples_per_interval = 1;
    options.tolerance = 1e-06;
    options.hold = ELBOW_HOLD_SPLINE;
    options.delay = 0.0;
    options.settled = 0.0;
    options.growth = 0;
    return options;
}

elbow_stream_options elbow_stream_defaults(void)
{
    elbow_stream_options options;
    options.intervals = ELBOW_STREAM_INTERVALS;
    options.samples_per_interval = ELBOW_STREAM_SAMPLES_PER_INTERVAL;
    options.period = ELBOW_STREAM_PERIOD;
    options.tolerance = 1e-06;
    options.hold = ELBOW_HOLD_SPLINE;
    options.delay = 0.0;
    return options;
}

int elbow_abi_version(void)
{
    return 6;
}

int elbow_sizeof_real(void)
{
    return (int)sizeof(elbow_real);
}

int elbow_sizeof_int(void)
{
    return (int)sizeof(int);
}

int elbow_work(void)
{
    return ELBOW_WORK;
}

int elbow_n_a(void)
{
    return ELBOW_NA;
}

int elbow_n_g(void)
{
    return ELBOW_NG;
}

int elbow_n_e(void)
{
    return ELBOW_NE;
}

int elbow_n_m(void)
{
    return ELBOW_NM;
}

int elbow_n_x(void)
{
    return ELBOW_NX;
}

int elbow_n_y(void)
{
    return ELBOW_NY;
}

int elbow_n_t(void)
{
    return ELBOW_NT;
}

int elbow_batch_work(void)
{
#ifdef _OPENMP
    return ELBOW_BATCH_WORK * omp_get_max_threads();
#else
    return ELBOW_BATCH_WORK;
#endif
}
