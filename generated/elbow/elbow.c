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
        return "a size, a time or a rotation is none that is allowed";
    case ELBOW_WORK_TOO_SMALL:
        return "the workspace is too small";
    case ELBOW_UNREACHABLE:
        return "the path leaves the workspace or passes a singular pose";
    case ELBOW_NOT_CONVERGED:
        return "no motion was found within the bounds of the solver";
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
    return "a6193bd0bf906ad54c80050588e4372de22edfc37d31ba9503c56e2027fe467f";
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
