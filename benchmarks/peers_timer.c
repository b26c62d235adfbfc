/*
 * Times candidates for one quantity of one robot, interleaved block by block, after checking that
 * they agree.
 *
 *   peers_timer JOB
 *
 * JOB is a text of words, written by peers.py:
 *   states FILE COUNT    doubles, state after state: the inputs one after the other
 *   inputs SIZE...       outputs SIZE...        (entries of each array; 0 ends a list)
 *   blocks COUNT         milliseconds M         tolerance E
 *   candidate LABEL KIND LIBRARY SYMBOL EXTRA
 *     KIND point: the emitted function; batch: the emitted batch function, EXTRA soa/N or aos/N
 *       for N points; casadi: a
 *     function that CasADi emitted; peer: peers_pinocchio.cpp or peers_mujoco.c, SYMBOL the
 *       quantity, EXTRA the model's
 * file Answers, a line for each candidate: LABEL, deviation from the first candidate, minimum and
 * median of ns per evaluation.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define MAX_PORTS 10
#define WORKSPACE (1L << 20) /* reals; more than <MODEL>_BATCH_WORK of the libraries here */
#define MAX_CANDIDATES 24

typedef void function(void);

struct candidate {
    char label[64], kind[16];
    function *entry;
    void (*peer_run)(void *, long);
    void (*peer_result)(void *, int, double *);
    void *peer;
    double *work, *out[MAX_PORTS], *in[MAX_PORTS]; /* in: of all points, for a batch */
    double **table;                                /* arguments of the calls, state after state */
    int states;                                    /* different calls: one for a batch */
    const double **arg;
    int n_arg;
    double **res;
    long long *iw;
    long calls; /* of the entry in a block */
    int points; /* in a call */
    double *ns, deviation;
    int soa;
};

static int n_states, n_in, n_out, in_size[MAX_PORTS], out_size[MAX_PORTS], total_in, total_out;
static double *states;
static volatile double sink;

static void fail(const char *what, const char *which)
{
    fprintf(stderr, "peers_timer: %s: %s\n", what, which);
    exit(1);
}

static void *memory(size_t bytes)
{
    void *p = aligned_alloc(64, (bytes + 127) / 64 * 64);
    if (p == NULL) {
        fail("memory", "none left");
    }
    memset(p, 0, (bytes + 127) / 64 * 64);
    return p;
}

static double seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static function *symbol(void *library, const char *name, int needed)
{
    void *found = dlsym(library, name);
    function *f;
    if (found == NULL && needed) {
        fail("no such function", name);
    }
    memcpy(&f, &found, sizeof f);
    return f;
}

/*
 * The emitted functions differ in the number of their arrays only. A loop for each number, so that
 * little time goes to anything but the calls: the arrays of all states were put into a table
 * before.
 */
#define P double *
#define CALLS(TYPE, ...) \
    do { \
        int(*const f) TYPE = (int(*) TYPE)c->entry; \
        for (long i = 0; i < calls; ++i, x += n, x = x == end ? c->table : x) { \
            status |= f(__VA_ARGS__); \
        } \
    } while (0)

static void run(struct candidate *c, long first, long calls)
{
    const int n = n_in + n_out + 1, k = c->points;
    double **const end = c->table + (long)n * c->states, **x = c->table + (long)n * first;
    int status = 0;
    switch (c->kind[0] == 'b' ? -n : n) {
    case 3:
        CALLS((P, P, P), x[0], x[1], x[2]);
        break;
    case 4:
        CALLS((P, P, P, P), x[0], x[1], x[2], x[3]);
        break;
    case 5:
        CALLS((P, P, P, P, P), x[0], x[1], x[2], x[3], x[4]);
        break;
    case 6:
        CALLS((P, P, P, P, P, P), x[0], x[1], x[2], x[3], x[4], x[5]);
        break;
    case 7:
        CALLS((P, P, P, P, P, P, P), x[0], x[1], x[2], x[3], x[4], x[5], x[6]);
        break;
    case -3:
        CALLS((int, P, P, P), k, x[0], x[1], x[2]);
        break;
    case -4:
        CALLS((int, P, P, P, P), k, x[0], x[1], x[2], x[3]);
        break;
    case -5:
        CALLS((int, P, P, P, P, P), k, x[0], x[1], x[2], x[3], x[4]);
        break;
    case -6:
        CALLS((int, P, P, P, P, P, P), k, x[0], x[1], x[2], x[3], x[4], x[5]);
        break;
    case -7:
        CALLS((int, P, P, P, P, P, P, P), k, x[0], x[1], x[2], x[3], x[4], x[5], x[6]);
        break;
    default:
        fail("arrays of a function", "given a number that this program has no call for");
    }
    if (status != 0) {
        fail("a status other than 0", c->label);
    }
}

static void run_casadi(struct candidate *c, long first, long calls)
{
    int (*const f)(const double **, double **, long long *, double *,
        int) = (int (*)(const double **, double **, long long *, double *, int))c->entry;
    const double **const end = c->arg + (long)c->n_arg * c->states,
                         **arg = c->arg + (long)c->n_arg * first;
    for (long i = 0; i < calls; ++i, arg += c->n_arg, arg = arg == end ? c->arg : arg) {
        f(arg, c->res, c->iw, c->work, 0);
    }
}

/* Seconds of one block. */
static double block(struct candidate *c, long calls)
{
    const double start = seconds();
    if (c->peer != NULL) {
        c->peer_run(c->peer, calls);
    } else if (c->kind[0] == 'c') {
        run_casadi(c, 0, calls);
        sink += c->out[0][0];
    } else {
        run(c, 0, calls);
        sink += c->out[0][0];
    }
    return seconds() - start;
}

/* Results of a state, as the single-point function lays them out. */
static void result(struct candidate *c, int state, double *to)
{
    if (c->peer != NULL) {
        c->peer_result(c->peer, state, to);
        return;
    }
    if (c->kind[0] == 'b') {
        if (state == 0) {
            run(c, 0, 1);
        }
        for (int i = 0; i < n_out; ++i) {
            for (int e = 0; e < out_size[i]; ++e) {
                *to++ = c->soa ? c->out[i][(long)e * c->points + state] :
                                 c->out[i][(long)state * out_size[i] + e];
            }
        }
        return;
    }
    if (c->kind[0] == 'c') {
        run_casadi(c, state, 1);
    } else {
        run(c, state, 1);
    }
    for (int i = 0; i < n_out; ++i) {
        memcpy(to, c->out[i], sizeof(double) * (size_t)out_size[i]);
        to += out_size[i];
    }
}

static int number(function *f)
{
    return ((int (*)(void))f)();
}

static void prepare(struct candidate *c, const char *library, const char *name, const char *extra)
{
    c->points = 1;
    c->states = c->kind[0] == 'b' ? 1 : n_states;
    if (c->kind[0] == 'b') {
        c->soa = strncmp(extra, "soa/", 4) == 0;
        c->points = atoi(extra + 4);
        if (c->points < n_states) {
            fail("points of a batch, fewer than states", extra);
        }
    }
    void *opened = dlopen(library, RTLD_NOW | RTLD_LOCAL);
    char other[300];
    if (opened == NULL) {
        fail("cannot load", dlerror());
    }
    if (strcmp(c->kind, "peer") == 0) {
        function *open = symbol(opened, "peer_open", 1);
        c->peer = ((void *(*)(const char *, const char *, const double *, int, int))open)(
            name, extra, states, n_states, total_in);
        if (c->peer == NULL) {
            fail("this peer does not have", name);
        }
        c->peer_run = (void (*)(void *, long))symbol(opened, "peer_run", 1);
        c->peer_result = (void (*)(void *, int, double *))symbol(opened, "peer_result", 1);
        return;
    }
    const long many = c->points;
    c->entry = symbol(opened, name, 1);
    for (int i = 0; i < n_out; ++i) {
        c->out[i] = memory(sizeof(double) * (size_t)(many * out_size[i]));
    }
    snprintf(other, sizeof other, "%s_work", name);
    if (strcmp(c->kind, "casadi") == 0) {
        long long sizes[4] = {0, 0, 0, 0};
        ((int (*)(long long *, long long *, long long *, long long *))symbol(opened, other, 1))(
            sizes, sizes + 1, sizes + 2, sizes + 3);
        c->n_arg = (int)sizes[0] + n_in;
        c->arg = memory(sizeof(double *) * (size_t)(c->n_arg * n_states));
        for (int k = 0; k < n_states; ++k) {
            for (int i = 0, before = 0; i < n_in; before += in_size[i], ++i) {
                c->arg[k * c->n_arg + i] = states + k * total_in + before;
            }
        }
        c->res = memory(sizeof(double *) * (size_t)(sizes[1] + n_out));
        c->iw = memory(sizeof(long long) * (size_t)(sizes[2] + 1));
        c->work = memory(sizeof(double) * (size_t)(sizes[3] + 1));
        memcpy(c->res, c->out, sizeof(double *) * (size_t)n_out);
        return;
    }
    function *work = symbol(opened, other, 0);
    c->work = memory(sizeof(double) * (size_t)(work == NULL ? WORKSPACE : number(work)));
    if (many > 1) {
        for (int i = 0, before = 0; i < n_in; before += in_size[i], ++i) {
            c->in[i] = memory(sizeof(double) * (size_t)(many * in_size[i]));
            for (long k = 0; k < many; ++k) {
                for (int e = 0; e < in_size[i]; ++e) {
                    c->in[i][c->soa ? e * many + k : k * in_size[i] + e] =
                        states[k % n_states * total_in + before + e];
                }
            }
        }
    }
    c->table = memory(sizeof(double *) * (size_t)((n_in + n_out + 1) * c->states));
    for (int k = 0, n = 0; k < c->states; ++k) {
        for (int i = 0, before = 0; i < n_in; before += in_size[i], ++i) {
            c->table[n++] = many > 1 ? c->in[i] : states + k * total_in + before;
        }
        for (int i = 0; i < n_out; ++i) {
            c->table[n++] = c->out[i];
        }
        c->table[n++] = c->work;
    }
}

static int read_sizes(FILE *job, int *sizes, int *total)
{
    int n = 0, size;
    while (fscanf(job, "%d", &size) == 1 && size > 0 && n < MAX_PORTS) {
        sizes[n++] = size;
        *total += size;
    }
    return n;
}

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

int main(int argc, char **argv)
{
    static struct candidate candidates[MAX_CANDIDATES];
    int count = 0, blocks = 40;
    double milliseconds = 1.5, tolerance = 1e-9;
    char word[64], library[1024], name[256], extra[1024], file[1024];
    FILE *job = argc == 2 ? fopen(argv[1], "r") : NULL;
    if (job == NULL) {
        fail("job", "given none that can be read");
    }
    cpu_set_t core;
    CPU_ZERO(&core);
    CPU_SET(sched_getcpu(), &core);
    sched_setaffinity(0, sizeof core, &core);
    while (fscanf(job, "%63s", word) == 1) {
        int ok = 1;
        if (strcmp(word, "states") == 0) {
            ok = fscanf(job, "%1023s %d", file, &n_states) == 2;
        } else if (strcmp(word, "inputs") == 0) {
            n_in = read_sizes(job, in_size, &total_in);
        } else if (strcmp(word, "outputs") == 0) {
            n_out = read_sizes(job, out_size, &total_out);
            const size_t n = (size_t)(n_states * total_in);
            FILE *data = fopen(file, "rb");
            states = memory(sizeof(double) * n);
            ok = data != NULL && fread(states, sizeof(double), n, data) == n;
            fclose(data);
        } else if (strcmp(word, "blocks") == 0) {
            ok = fscanf(job, "%d", &blocks) == 1;
        } else if (strcmp(word, "milliseconds") == 0) {
            ok = fscanf(job, "%lf", &milliseconds) == 1;
        } else if (strcmp(word, "tolerance") == 0) {
            ok = fscanf(job, "%lf", &tolerance) == 1;
        } else if (strcmp(word, "candidate") == 0 && count < MAX_CANDIDATES) {
            struct candidate *c = &candidates[count++];
            ok = fscanf(job, "%63s %15s %1023s %255s %1023s", c->label, c->kind, library, name,
                     extra) == 5;
            prepare(c, library, name, extra);
        } else {
            ok = 0;
        }
        if (!ok) {
            fail("job, at the word", word);
        }
    }

    double *expected = memory(sizeof(double) * (size_t)total_out),
           *given = memory(sizeof(double) * (size_t)total_out);
    for (int j = 1; j < count; ++j) {
        for (int k = 0; k < n_states; ++k) {
            double scale = 1.0;
            result(&candidates[0], k, expected);
            result(&candidates[j], k, given);
            for (int e = 0; e < total_out; ++e) {
                scale = fmax(scale, fabs(expected[e]));
            }
            for (int e = 0; e < total_out; ++e) {
                const double off = fabs(given[e] - expected[e]) / scale;
                if (!(off <= candidates[j].deviation)) { /* so that a NaN counts */
                    candidates[j].deviation = isnan(off) ? INFINITY : off;
                }
            }
        }
    }

    for (int j = 0; j < count; ++j) {
        struct candidate *c = &candidates[j];
        const long step = c->kind[0] == 'b' ? 1 : n_states;
        long calls = step;
        double taken = block(c, calls);
        while ((taken = block(c, calls)) < 1e-4 * milliseconds) {
            calls *= 2;
        }
        c->calls = (long)(1e-3 * milliseconds / taken * (double)calls) / step * step;
        if (c->calls < step) {
            c->calls = step;
        }
        c->ns = memory(sizeof(double) * (size_t)blocks);
    }
    for (int b = -2; b < blocks; ++b) { /* two rounds to warm up */
        for (int j = 0; j < count; ++j) {
            struct candidate *c = &candidates[j];
            const double taken = block(c, c->calls);
            if (b >= 0) {
                c->ns[b] = 1e9 * taken / ((double)c->calls * c->points);
            }
        }
    }
    int agree = 1;
    for (int j = 0; j < count; ++j) {
        struct candidate *c = &candidates[j];
        qsort(c->ns, (size_t)blocks, sizeof(double), ascending);
        printf("%s %.3g %.5g %.5g\n", c->label, c->deviation, c->ns[0], c->ns[blocks / 2]);
        agree = agree && c->deviation <= tolerance;
    }
    return agree ? 0 : 2;
}
