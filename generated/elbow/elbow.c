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
    default:
        return "unknown status";
    }
}

const char *elbow_digest(void)
{
    return "c5d75907b77a2a214e8736d479f326cdd7cf9fd02d1552cff596467532f3198b";
}

const char *elbow_interface(void)
{
    return "db9b3a5766c06b54db936884fcf54442dd4aaecfd4f768281f121bd8dc9ba633";
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
