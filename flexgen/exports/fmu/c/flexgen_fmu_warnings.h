/*
 * At the top of the source, which is many files in one. Small functions of the kernel and
 * constants that this robot does not use, and arrays that are declared as pointers elsewhere, are
 * not mistakes there.
 */
#ifndef FLEXGEN_FMU_WARNINGS_H
#define FLEXGEN_FMU_WARNINGS_H

#if defined(__clang__)
#pragma clang diagnostic ignored "-Wunused-function"
#pragma clang diagnostic ignored "-Wunused-const-variable"
#elif defined(__GNUC__) && __GNUC__ >= 11
#pragma GCC diagnostic ignored "-Warray-parameter"
#endif

#endif
