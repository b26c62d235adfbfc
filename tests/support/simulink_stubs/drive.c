/*
 * An S-function, called as Simulink calls it: sizes, memory, start, then outputs (twice) and
 * update in every step.
 *
 * Compiled with -DSFUNCTION="..." to include. Reads the number of parameters, each with its
 * length, and the number of steps; then the inputs of every step. Writes the sample time, and the
 * outputs of every step. Exit status 3: an error.
 */
#include <stdio.h>
#include SFUNCTION

static int read_doubles(double *x, size_t n)
{
    return fread(x, sizeof *x, n, stdin) == n;
}

static double *room(size_t n)
{
    double *const x = (double *)calloc(n + 1, sizeof *x);
    if (!x) {
        abort();
    }
    return x;
}

static int failed(const SimStruct *S)
{
    if (S->error) {
        fprintf(stderr, "%s\n", S->error);
    }
    return S->error != NULL;
}

int main(void)
{
    static SimStruct block;
    SimStruct *const S = &block;
    double count, steps;
    if (!read_doubles(&count, 1)) {
        return 2;
    }
    S->parameters_given = (int)count;
    for (int k = 0; k < S->parameters_given; ++k) {
        mxArray *const x = (mxArray *)calloc(1, sizeof *x);
        double n;
        if (!x || !read_doubles(&n, 1)) {
            return 2;
        }
        x->n = (size_t)n;
        x->data = room(x->n);
        if (!read_doubles(x->data, x->n)) {
            return 2;
        }
        S->parameters[k] = x;
    }
    if (!read_doubles(&steps, 1)) {
        return 2;
    }
    mdlInitializeSizes(S);
    if (failed(S)) {
        return 3;
    }
    if (S->parameters_expected != S->parameters_given || S->n_times != 1) {
        return 4;
    }
    mdlInitializeSampleTimes(S);
    double *in[8] = {0};
    for (int k = 0; k < S->n_in; ++k) {
        S->in[k] = in[k] = room((size_t)S->in_width[k]);
    }
    for (int k = 0; k < S->n_out; ++k) {
        S->out[k] = room((size_t)S->out_width[k]);
    }
    for (int k = 0; k < S->n_dwork; ++k) {
        S->dwork[k] = room((size_t)S->dwork_width[k]);
    }
#ifdef MDL_START
    mdlStart(S);
    if (failed(S)) {
        return 3;
    }
#endif
    fwrite(&S->sample_time, sizeof(double), 1, stdout);
    for (int step = 0; step < (int)steps; ++step) {
        for (int k = 0; k < S->n_in; ++k) {
            if (!read_doubles(in[k], (size_t)S->in_width[k])) {
                return 2;
            }
        }
        mdlOutputs(S, 0);
        mdlOutputs(S, 0); /* as in an algebraic loop */
        if (failed(S)) {
            return 3;
        }
        for (int k = 0; k < S->n_out; ++k) {
            fwrite(S->out[k], sizeof(double), (size_t)S->out_width[k], stdout);
        }
#ifdef MDL_UPDATE
        mdlUpdate(S, 0);
#endif
    }
    mdlTerminate(S);
    (void)stub_use;
    return 0;
}
