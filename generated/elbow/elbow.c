/* elbow: what the library says of itself. Written by flexgen; see elbow.h. */
#include "elbow.h"

const char *elbow_status_text(int status)
{
    switch (status) {
    case ELBOW_OK:
        return "success";
    case ELBOW_NULL_ARGUMENT:
        return "an argument is a null pointer";
    case ELBOW_INPUT_NOT_FINITE:
        return "an input is not finite, and so is the result";
    case ELBOW_RESULT_NOT_FINITE:
        return "the result is not finite: a singular or an extreme state";
    case ELBOW_BAD_COUNT:
        return "the number of points is negative";
    case ELBOW_BAD_ARGUMENT:
        return "a size, a time or a rotation is none that is allowed, or the path does not begin and end at rest";
    case ELBOW_WORK_TOO_SMALL:
        return "the workspace is too small";
    case ELBOW_UNREACHABLE:
        return "the path leaves the workspace or passes a singular pose";
    case ELBOW_NOT_CONVERGED:
        return "no motion was found within the bounds of the solver";
    case ELBOW_NOT_STARTED:
        return "the stream was not started, or has failed since";
    case ELBOW_FLAT:
        return "a zero of the zero dynamics is at infinity at an end of the path or on the way; use invert (method lq)";
    case ELBOW_ZEROS_CHANGE:
        return "the number of unstable zeros differs between start and end; use invert (method lq)";
    case ELBOW_ZERO_ON_AXIS:
        return "a zero is on the imaginary axis at an end of the path, neither stable nor unstable; use invert (method lq)";
    case ELBOW_SHORT_HORIZON:
        return "the horizon is too short to keep limits: take 4 intervals, and half as many again as the zeros look ahead";
    case ELBOW_LIMITS_LOST:
        return "the limits of the motors cannot be kept, one is passed by more than 2.5 times; loosen them or the move";
    case ELBOW_INEXACT:
        return "the residual is above the tolerance, or the motion uneven; the result is the best that was found";
    case ELBOW_LIMITED:
        return "the bounds of the motors keep the output off its path, or are passed; the report says how far";
    default:
        return "unknown status";
    }
}

const char *elbow_digest(void)
{
    return "815207d91c95f0d26a4b07854b0319327b3c510541005ef49683accd5144bcb3";
}

const char *elbow_interface(void)
{
    return "12befca4b6a28ed348c89330ecf3f5c4b0d190faa697b27c4d45123d887b5f67";
}

int elbow_abi_version(void)
{
    return 2;
}

int elbow_sizeof_real(void)
{
    return (int)sizeof(elbow_real);
}

int elbow_sizeof_int(void)
{
    return (int)sizeof(int);
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
