/* The part of MATLAB's interface that the gateway uses, for the tests. */
#ifndef MEX_H
#define MEX_H

#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef size_t mwSize;
typedef enum { mxREAL } mxComplexity;
typedef enum { mxDOUBLE_CLASS } mxClassID;
typedef struct mxArray {
    size_t rows, columns;
    double *numbers;  /* NULL: a text */
    const char *text; /* not copied */
} mxArray;

void mexFunction(int n_out, mxArray *out[], int n_in, const mxArray *in[]);

static inline void mexErrMsgIdAndTxt(const char *id, const char *format, ...)
{
    va_list given;
    va_start(given, format);
    fprintf(stderr, "%s: ", id);
    vfprintf(stderr, format, given);
    va_end(given);
    exit(3);
}

static inline void *mxMalloc(size_t size)
{
    void *const made = malloc(size);
    if (!made) {
        abort();
    }
    return made;
}

static inline void mxFree(void *x)
{
    free(x);
}

static inline mxArray *mxCreateDoubleMatrix(mwSize rows, mwSize columns, mxComplexity kind)
{
    mxArray *const made = (mxArray *)mxMalloc(sizeof *made);
    (void)kind;
    *made = (mxArray){rows, columns, (double *)calloc(rows * columns + 1, sizeof(double)), NULL};
    return made;
}

static inline mxArray *mxCreateNumericArray(
    mwSize n, const mwSize *size, mxClassID type, mxComplexity kind)
{
    (void)type;
    return mxCreateDoubleMatrix(size[0], n > 2 ? size[1] * size[2] : size[1], kind);
}

static inline mxArray *mxCreateDoubleScalar(double x)
{
    mxArray *const made = mxCreateDoubleMatrix(1, 1, mxREAL);
    made->numbers[0] = x;
    return made;
}

static inline mxArray *mxCreateString(const char *text)
{
    mxArray *const made = (mxArray *)mxMalloc(sizeof *made);
    *made = (mxArray){1, strlen(text), NULL, text};
    return made;
}

static inline mxArray *mxCreateLogicalScalar(bool x)
{
    return mxCreateDoubleScalar(x ? 1.0 : 0.0);
}

static inline mxArray *mxCreateStructMatrix(
    mwSize rows, mwSize columns, int n, const char **fields)
{
    (void)fields;
    return mxCreateDoubleMatrix(rows * columns, (mwSize)n, mxREAL);
}

static inline void mxSetField(mxArray *x, mwSize at, const char *field, mxArray *value)
{
    (void)x;
    (void)at;
    (void)field;
    (void)value;
}

static inline mxArray *mxDuplicateArray(const mxArray *x)
{
    mxArray *const made = mxCreateDoubleMatrix(x->rows, x->columns, mxREAL);
    memcpy(made->numbers, x->numbers, x->rows * x->columns * sizeof(double));
    return made;
}

static inline int mxGetString(const mxArray *x, char *text, mwSize size)
{
    strncpy(text, x->text, size);
    return text[size - 1] != 0;
}

static inline bool mxIsDouble(const mxArray *x)
{
    return x->numbers != NULL;
}

static inline bool mxIsChar(const mxArray *x)
{
    return x->text != NULL;
}

static inline bool mxIsComplex(const mxArray *x)
{
    (void)x;
    return false;
}

static inline bool mxIsSparse(const mxArray *x)
{
    (void)x;
    return false;
}

static inline size_t mxGetM(const mxArray *x)
{
    return x->rows;
}

static inline size_t mxGetN(const mxArray *x)
{
    return x->columns;
}

static inline size_t mxGetNumberOfElements(const mxArray *x)
{
    return x->rows * x->columns;
}

static inline mwSize mxGetNumberOfDimensions(const mxArray *x)
{
    (void)x;
    return 2;
}

static inline const char *mxGetClassName(const mxArray *x)
{
    return mxIsDouble(x) ? "double" : "char";
}

static inline double *mxGetPr(const mxArray *x)
{
    return x->numbers;
}

#endif
