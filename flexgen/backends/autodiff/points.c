/*
 * Calls the functions of emitted libraries on arrays whose last axes are one point:
 * x[point][row][column].
 *
 * The functions for many points take structures of arrays, x[column][row][point]. So TILE points
 * at a time are reordered into a buffer that stays in the cache, evaluated, and reordered back.
 * With XLA_API the file also has the handler of XLA's foreign function interface.
 */
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define EXPORT __attribute__((visibility("default")))

enum {
    TILE = 256,
    MOST_PORTS = 24,
    MOST_FUNCTIONS = 16384,
    POINTER_NULL = -1,
    INPUT = -2,
    RESULT = -3
};

typedef struct {
    int32_t rank, rows, columns; /* 1, entries, 1 of a vector; 2, rows, columns of a matrix */
    int32_t shared;              /* 1: the function for many points takes one point of it */
} port;

/* A function of a library. Its key names it in every process; 0: no function. */
typedef struct {
    uint64_t key;
    void *single, *batch; /* for one point; for many points */
    int (*batch_work)(void);
    int64_t work;                   /* reals of the workspace for one point; 0: it takes none */
    int32_t bytes, inputs, outputs; /* of a real number; number of ports */
    port ports[MOST_PORTS];         /* inputs, then outputs */
} function;

/* CALLS */

static int32_t size_of(const port *p)
{
    return p->rows * p->columns;
}

/* Points between both orders; step 0: the same entries for all points. */
#define REORDER(T, name) \
    static void name(const port *p, T *arrays, T *points, int n, int step, int back) \
    { \
        for (int column = 0; column < p->columns; column++) { \
            for (int row = 0; row < p->rows; row++) { \
                T *a = arrays + ((size_t)column * (size_t)p->rows + (size_t)row) * (size_t)n; \
                T *x = points + (size_t)row * (size_t)p->columns + (size_t)column; \
                if (back) { \
                    for (int k = 0; k < n; k++) { \
                        x[(size_t)k * (size_t)step] = a[k]; \
                    } \
                } else { \
                    for (int k = 0; k < n; k++) { \
                        a[k] = x[(size_t)k * (size_t)step]; \
                    } \
                } \
            } \
        } \
    }
REORDER(double, reorder_double)
REORDER(float, reorder_float)

static void reorder(
    const function *f, int i, char *arrays, char *points, int n, int step, int back)
{
    if (f->bytes == 8) {
        reorder_double(
            &f->ports[i], (double *)(void *)arrays, (double *)(void *)points, n, step, back);
    } else {
        reorder_float(
            &f->ports[i], (float *)(void *)arrays, (float *)(void *)points, n, step, back);
    }
}

/*
 * Evaluate count points; many[i] 0: input i has one point, for all. Results of points that fail
 * are NaN. Returns 0, or -1 where there is no memory, or the status of a call that the library
 * refused.
 */
EXPORT int flexgen_points(const function *f, int64_t count, void **given, const int32_t *many)
{
    const int ports = f->inputs + f->outputs, alone = count == 1;
    int each = 0, tile = count < TILE ? (int)count : TILE;
    size_t reals = 0;
    for (int i = 0; i < ports; i++) {
        reals += (size_t)size_of(&f->ports[i]) * (size_t)tile;
        /* the batch takes one, given are many */
        each |= i < f->inputs && f->ports[i].shared && many[i];
    }
    tile = each ? 1 : tile;
    const int one = alone || each;
    const int64_t work = one ? f->work : f->batch_work();
    const size_t bytes = (size_t)f->bytes;
    char *memory = malloc((reals + (size_t)work + 1) * bytes);
    if (memory == NULL) {
        return POINTER_NULL;
    }
    int status = 0;
    for (int64_t first = 0; first < count && (status == 0 || status == INPUT || status == RESULT);
        first += tile) {
        const int n = count - first < tile ? (int)(count - first) : tile;
        void *passed[MOST_PORTS + 1];
        char *next = memory;
        for (int i = 0; i < ports; i++) {
            const port *p = &f->ports[i];
            const size_t size = (size_t)size_of(p);
            const int wide = !one && i < f->inputs && p->shared ? 1 : n;
            if (i < f->inputs) {
                char *x = (char *)given[i] + (many[i] ? (size_t)first * size * bytes : 0);
                reorder(f, i, next, x, wide, many[i] ? (int)size : 0, 0);
            }
            passed[i] = next;
            next += size * (size_t)wide * bytes;
        }
        passed[ports] = next;
        const int all = ports + (!one || f->work > 0);
        status = one ? call_single(f->single, all, passed) : call_batch(f->batch, all, n, passed);
        for (int i = f->inputs; i < ports; i++) {
            const size_t size = (size_t)size_of(&f->ports[i]);
            reorder(
                f, i, passed[i], (char *)given[i] + (size_t)first * size * bytes, n, (int)size, 1);
        }
    }
    free(memory);
    return status == INPUT || status == RESULT ? 0 : status;
}

#ifdef XLA_API
#include "xla/ffi/api/c_api.h"

static function table[MOST_FUNCTIONS]; /* open addressing */

static function *place_of(uint64_t key)
{
    for (size_t k = 0; k < MOST_FUNCTIONS; k++) {
        function *f = &table[(key + k) % MOST_FUNCTIONS];
        const uint64_t there = __atomic_load_n(&f->key, __ATOMIC_ACQUIRE);
        if (there == key || there == 0) {
            return f;
        }
    }
    return NULL;
}

/* Let the handler find a function; 0, or -1 where the table is full. One call at a time. */
EXPORT int flexgen_register(const function *f)
{
    function *to = place_of(f->key);
    if (to == NULL) {
        return POINTER_NULL;
    }
    if (to->key == 0) {
        memcpy((char *)to + sizeof to->key, (const char *)f + sizeof f->key,
            sizeof *f - sizeof f->key);
        __atomic_store_n(&to->key, f->key, __ATOMIC_RELEASE);
    }
    return 0;
}

static XLA_FFI_Error *failed(const XLA_FFI_CallFrame *frame, const char *message)
{
    XLA_FFI_Error_Create_Args args;
    memset(&args, 0, sizeof args);
    args.struct_size = XLA_FFI_Error_Create_Args_STRUCT_SIZE;
    args.message = message;
    args.errc = XLA_FFI_Error_Code_FAILED_PRECONDITION;
    return frame->api->XLA_FFI_Error_Create(&args);
}

/* The handler of all functions; its only attribute is the key. Buffers are in C's order. */
EXPORT XLA_FFI_Error *flexgen_points_handler(XLA_FFI_CallFrame *frame)
{
    XLA_FFI_Extension_Base *more = frame->extension_start;
    if (more != NULL && more->type == XLA_FFI_Extension_Metadata) { /* XLA asks for the version */
        XLA_FFI_Metadata *metadata = ((XLA_FFI_Metadata_Extension *)(void *)more)->metadata;
        metadata->api_version.major_version = XLA_FFI_API_MAJOR;
        metadata->api_version.minor_version = XLA_FFI_API_MINOR;
        return NULL;
    }
    uint64_t key = 0;
    if (frame->attrs.size == 1 && frame->attrs.types[0] == XLA_FFI_AttrType_SCALAR) {
        memcpy(&key, ((XLA_FFI_Scalar *)frame->attrs.attrs[0])->value, sizeof key);
    }
    const function *f = key == 0 ? NULL : place_of(key);
    if (f == NULL || f->key != key) {
        return failed(frame,
            "a compiled program calls a flexgen library that is not loaded, expected "
            "flexgen.jax.functions(flexgen.load(...)) before");
    }
    void *given[MOST_PORTS];
    int32_t many[MOST_PORTS] = {0};
    int64_t count = 1;
    if (frame->args.size != f->inputs || frame->rets.size != f->outputs) {
        return failed(frame, "another number of arrays than the function has");
    }
    for (int i = 0; i < f->inputs + f->outputs; i++) {
        const int in = i < f->inputs;
        const XLA_FFI_Buffer *x = in ? frame->args.args[i] : frame->rets.rets[i - f->inputs];
        int64_t entries = 1;
        for (int64_t d = 0; d < x->rank; d++) {
            entries *= x->dims[d];
        }
        const int64_t points = entries / size_of(&f->ports[i]);
        many[i] = x->rank > f->ports[i].rank;
        given[i] = x->data;
        if (x->dtype != (f->bytes == 8 ? XLA_FFI_DataType_F64 : XLA_FFI_DataType_F32)) {
            return failed(frame, "an array of another type than the numbers of the library");
        }
        count = many[i] ? points : count;
    }
    return flexgen_points(f, count, given, many) == 0 ?
               NULL :
               failed(frame, "the library refused the call, or there is no memory");
}
#endif
