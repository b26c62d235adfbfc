/*
 * The library as a function of MATLAB and GNU Octave: model_mex(what, ...). Written by flexgen.
 *
 * The functions of the package call it; their help says what they do. It checks all that it is
 * given.
 */
#include "model.h"

#include "mex.h"

#include <string.h>

/* Bad arguments that a user may see: what, where, given, expected. */
static void refuse(const char *where, const char *given, const char *expected)
{
    mexErrMsgIdAndTxt("flexgen:argument", "%s: given %s, expected %s", where, given, expected);
}

/* A function of one point: its name, its arrays, and the call. */
typedef struct {
    const char *name;
    int n_in, n_out;
    const char *const *in;
    const int *in_size;
    const int *rows, *columns;
    model_status (*call)(const double *const *in, double *const *out, double *work);
} point_function;

typedef struct {
    int code;
    const char *name;
} status_name;

#include "model_mex_table.h" /* POINT_FUNCTIONS, STATUS_NAMES */

enum { MOST = 16 }; /* arrays of a function */

static const char *name_of(int status)
{
    for (size_t k = 0; k < sizeof STATUS_NAMES / sizeof STATUS_NAMES[0]; ++k) {
        if (STATUS_NAMES[k].code == status) {
            return STATUS_NAMES[k].name;
        }
    }
    return "UNKNOWN";
}

static void check_status(const char *what, int status)
{
    if (status < 0) {
        char id[64] = "flexgen:";
        strncat(id, name_of(status), sizeof id - strlen(id) - 1);
        mexErrMsgIdAndTxt(id, "%s: %s", what, model_status_text(status));
    }
}

/*
 * The numbers of an array of doubles with so many rows; columns < 0: any number of them, else
 * exactly so many.
 */
static const double *numbers(
    const char *what, const char *name, const mxArray *x, int rows, int columns, int *found)
{
    if (!mxIsDouble(x) || mxIsComplex(x) || mxIsSparse(x) || mxGetNumberOfDimensions(x) != 2) {
        mexErrMsgIdAndTxt("flexgen:argument",
            "%s, %s: given %s, expected a real matrix of doubles", what, name,
            mxIsDouble(x) ? "a complex, sparse or higher-dimensional array" : mxGetClassName(x));
    }
    size_t m = mxGetM(x), n = mxGetN(x);
    if (m == 1 && n == (size_t)rows && (columns < 0 || columns == 1)) { /* a row for a column */
        m = n;
        n = 1;
    }
    if (m != (size_t)rows || (columns >= 0 && n != (size_t)columns) ||
        n > 2147483647u / (size_t)(rows > 0 ? rows : 1)) {
        if (columns < 0) {
            mexErrMsgIdAndTxt("flexgen:argument", "%s, %s: given %d x %d, expected %d rows", what,
                name, (int)mxGetM(x), (int)mxGetN(x), rows);
        }
        mexErrMsgIdAndTxt("flexgen:argument", "%s, %s: given %d x %d, expected %d x %d", what,
            name, (int)mxGetM(x), (int)mxGetN(x), rows, columns);
    }
    if (found) {
        *found = (int)n;
    }
    return mxGetPr(x);
}

static void count_arguments(const char *what, int given, int expected)
{
    if (given != expected) {
        mexErrMsgIdAndTxt(
            "flexgen:argument", "%s: given %d arguments, expected %d", what, given, expected);
    }
}

/* A function at the columns of its arguments. */
static void point(const point_function *f, int n_out, mxArray **out, int n_in, const mxArray **in)
{
    const double *x[MOST], *at[MOST];
    double *y[MOST], *to[MOST];
    int n = 1, n_k;
    count_arguments(f->name, n_in, f->n_in);
    for (int i = 0; i < f->n_in; ++i) {
        x[i] = numbers(f->name, f->in[i], in[i], f->in_size[i], -1, &n_k);
        if (i > 0 && n_k != n) {
            mexErrMsgIdAndTxt("flexgen:argument",
                "%s, %s: given %d columns, expected %d as before: one for each point", f->name,
                f->in[i], n_k, n);
        }
        n = n_k;
    }
    for (int i = 0; i < f->n_out; ++i) {
        const mwSize flat[2] = {(mwSize)f->rows[i], (mwSize)n};
        const mwSize deep[3] = {(mwSize)f->rows[i], (mwSize)f->columns[i], (mwSize)n};
        mxArray *const made = mxCreateNumericArray(
            f->columns[i] == 0 ? 2 : 3, f->columns[i] == 0 ? flat : deep, mxDOUBLE_CLASS, mxREAL);
        y[i] = mxGetPr(made);
        if (i < (n_out > 0 ? n_out : 1)) {
            out[i] = made;
        }
    }
    double *const work = (double *)mxMalloc(MODEL_WORK * sizeof(double));
    for (int k = 0; k < n; ++k) {
        for (int i = 0; i < f->n_in; ++i) {
            at[i] = x[i] + (size_t)k * (size_t)f->in_size[i];
        }
        for (int i = 0; i < f->n_out; ++i) {
            to[i] = y[i] + (size_t)k * (size_t)f->rows[i] *
                               (size_t)(f->columns[i] == 0 ? 1 : f->columns[i]);
        }
        check_status(f->name, f->call(at, to, work));
    }
    mxFree(work);
}

/* A whole number of an option. */
static int whole(const char *what, const char *name, double x)
{
    if (!(x >= -2147483647.0 && x <= 2147483647.0) || x != (double)(int)x) {
        mexErrMsgIdAndTxt(
            "flexgen:argument", "%s, %s: given %g, expected a whole number", what, name, x);
    }
    return (int)x;
}

static void set(mxArray *info, const char *name, double value)
{
    mxSetField(info, 0, name, mxCreateDoubleScalar(value));
}

#ifdef MODEL_STREAM_INTERVALS_MAX

static const int MOTION[7] = {
    MODEL_NA, MODEL_NA, MODEL_NA, MODEL_NG, MODEL_NM, MODEL_NM, MODEL_NM};

/* The arrays of a motion, one column a sample. */
static model_motion motion_of(mxArray **made, int n)
{
    double *x[7];
    for (int i = 0; i < 7; ++i) {
        made[i] = mxCreateDoubleMatrix((mwSize)MOTION[i], (mwSize)n, mxREAL);
        x[i] = mxGetPr(made[i]);
    }
    const model_motion motion = {.q_a = x[0],
        .v_a = x[1],
        .a_a = x[2],
        .tau_g = x[3],
        .q_m = x[4],
        .v_m = x[5],
        .tau_m = x[6]};
    return motion;
}

/*
 * ('invert', y, dy, ddy, period, q_start, [n_pre n_post samples_per_interval tolerance hold
 * delay]) -> q_a v_a a_a tau_g q_m v_m tau_m info
 */
static void invert(int n_out, mxArray **out, int n_in, const mxArray **in)
{
    int n, n_k;
    count_arguments("invert", n_in, 6);
    count_arguments("invert, results", n_out, 8);
    model_samples path;
    path.y = numbers("invert", "y", in[0], MODEL_NT, -1, &n);
    path.dy = numbers("invert", "dy", in[1], MODEL_NY, n, &n_k);
    path.ddy = numbers("invert", "ddy", in[2], MODEL_NY, n, &n_k);
    path.n = n;
    path.period = *numbers("invert", "period", in[3], 1, 1, NULL);
    const double *const q_start = numbers("invert", "q_start", in[4], MODEL_NA, 1, NULL);
    const double *const o = numbers("invert", "options", in[5], 6, 1, NULL);
    model_inversion_options options = model_inversion_defaults();
    options.n_pre = whole("invert", "n_pre", o[0]);
    options.n_post = whole("invert", "n_post", o[1]);
    options.samples_per_interval = whole("invert", "samples_per_interval", o[2]);
    options.tolerance = o[3];
    options.hold = (model_hold)whole("invert", "hold", o[4]);
    options.delay = o[5];
    const int64_t size = model_invert_work(n, &options);
    if (size < 0) {
        refuse("invert", "a size or an option out of range",
            "at least 2 samples, n_pre and n_post >= 0, samples_per_interval >= 1");
    }
    model_motion motion = motion_of(out, options.n_pre + n + options.n_post);
    double *const work = (double *)mxMalloc((size_t)size * sizeof(double));
    model_invert_info found;
    const model_status status = model_invert(
        &path, q_start, &options, &motion, &found, work, size);
    mxFree(work);
    check_status("invert", status);
    static const char *fields[] = {"status", "converged", "residual", "residual_at_samples",
        "kinematic_mismatch", "torque_error", "iterations", "intervals"};
    out[7] = mxCreateStructMatrix(1, 1, 8, fields);
    mxSetField(out[7], 0, "status", mxCreateString(name_of(status)));
    mxSetField(out[7], 0, "converged", mxCreateLogicalScalar(status == MODEL_OK));
    set(out[7], "residual", found.residual);
    set(out[7], "residual_at_samples", found.residual_at_samples);
    set(out[7], "kinematic_mismatch", found.kinematic_mismatch);
    set(out[7], "torque_error", found.torque_error);
    set(out[7], "iterations", found.iterations);
    set(out[7], "intervals", found.intervals);
}

/* [intervals samples_per_interval period tolerance hold delay] */
static model_stream_options options_of(const mxArray *x)
{
    const double *const o = numbers("stream", "options", x, 6, 1, NULL);
    const model_stream_options options = {
        .intervals = whole("stream", "intervals", o[0]),
        .samples_per_interval = whole("stream", "samples_per_interval", o[1]),
        .period = o[2],
        .tolerance = o[3],
        .hold = (model_hold)whole("stream", "hold", o[4]),
        .delay = o[5],
    };
    if (model_stream_work(&options) < 0) {
        refuse("stream", "an option out of range",
            "1 to 10000 intervals, 1 to 1000 samples_per_interval, a delay of 0 to 4");
    }
    return options;
}

/* The stream in the memory of an array. */
static model_stream stream_in(const mxArray *memory)
{
    const model_stream stream = {
        .memory = mxGetPr(memory), .size = (int64_t)mxGetNumberOfElements(memory)};
    return stream;
}

/* A copy of the memory of a stream. */
static mxArray *memory_of(const mxArray *x, int64_t size)
{
    if (!mxIsDouble(x) || mxIsComplex(x) || mxIsSparse(x) ||
        (int64_t)mxGetNumberOfElements(x) != size) {
        refuse("stream", "another memory", "that of a stream with these options");
    }
    return mxDuplicateArray(x);
}

/* ('stream_start', options, y, q_start) -> memory */
static void stream_start(int n_in, const mxArray **in, mxArray **out)
{
    count_arguments("Stream", n_in, 3);
    const model_stream_options options = options_of(in[0]);
    const int64_t size = model_stream_work(&options);
    const double *const y = numbers("Stream", "y", in[1], MODEL_NT, 1, NULL);
    const double *const q_start = numbers("Stream", "q_start", in[2], MODEL_NA, 1, NULL);
    out[0] = mxCreateDoubleMatrix((mwSize)size, 1, mxREAL);
    const model_stream stream = stream_in(out[0]);
    check_status("Stream", model_stream_start(&stream, &options, y, q_start));
}

/*
 * ('stream_update', options, memory, y, dy, ddy) -> memory q_a v_a a_a tau_g q_m v_m tau_m info;
 * a_a is zero
 */
static void stream_update(int n_out, mxArray **out, int n_in, const mxArray **in)
{
    count_arguments("update", n_in, 5);
    count_arguments("update, results", n_out, 9);
    const model_stream_options options = options_of(in[0]);
    const double *const y = numbers("update", "y", in[2], MODEL_NT, 1, NULL);
    const double *const dy = numbers("update", "dy", in[3], MODEL_NY, 1, NULL);
    const double *const ddy = numbers("update", "ddy", in[4], MODEL_NY, 1, NULL);
    out[0] = memory_of(in[1], model_stream_work(&options));
    model_motion motion = motion_of(out + 1, options.samples_per_interval);
    motion.a_a = NULL;
    model_stream_info found;
    const model_stream stream = stream_in(out[0]);
    const model_status status = model_stream_update(&stream, y, dy, ddy, &motion, &found);
    check_status("update", status);
    static const char *fields[] = {"status", "converged", "residual", "kinematic_mismatch",
        "torque_step", "output_step_m", "output_step_rad", "deviation_m", "deviation_rad",
        "limits_active"};
    out[8] = mxCreateStructMatrix(1, 1, 10, fields);
    mxSetField(out[8], 0, "status", mxCreateString(name_of(status)));
    mxSetField(out[8], 0, "converged", mxCreateLogicalScalar(status != MODEL_TOLERANCE_NOT_MET));
    set(out[8], "residual", found.residual);
    set(out[8], "kinematic_mismatch", found.kinematic_mismatch);
    set(out[8], "torque_step", found.torque_step);
    set(out[8], "output_step_m", found.output_step_m);
    set(out[8], "output_step_rad", found.output_step_rad);
    set(out[8], "deviation_m", found.deviation_m);
    set(out[8], "deviation_rad", found.deviation_rad);
    mxSetField(out[8], 0, "limits_active", mxCreateLogicalScalar(found.limits_active != 0));
}

/* ('stream_limits', options, memory, torque_max, speed_max, deviation_max) -> memory */
static void stream_limits(int n_in, const mxArray **in, mxArray **out)
{
    count_arguments("limits", n_in, 5);
    const model_stream_options options = options_of(in[0]);
    out[0] = memory_of(in[1], model_stream_work(&options));
    const double *const torque = numbers("limits", "torque_max", in[2], MODEL_NM, 1, NULL);
    const double *const speed = numbers("limits", "speed_max", in[3], MODEL_NM, 1, NULL);
    const double deviation = *numbers("limits", "deviation_max", in[4], 1, 1, NULL);
    const model_stream stream = stream_in(out[0]);
    check_status("limits", model_stream_limits(&stream, torque, speed, deviation));
}

/* Positive numbers, as `numbers`; NULL for an empty array. */
static const double *limit(const char *name, const mxArray *x, int rows)
{
    if (mxGetNumberOfElements(x) == 0) {
        return NULL;
    }
    const double *const found = numbers("all_limits", name, x, rows, 1, NULL);
    for (int i = 0; i < rows; ++i) {
        if (!(found[i] > 0.0)) {
            mexErrMsgIdAndTxt("flexgen:argument",
                "all_limits, %s: given %g, expected positive numbers", name, found[i]);
        }
    }
    return found;
}

/*
 * ('stream_all_limits', options, memory, members of the limits, [] for none, deviation_max) ->
 * memory
 */
static void stream_all_limits(int n_in, const mxArray **in, mxArray **out)
{
    count_arguments("all_limits", n_in, 13);
    const model_stream_options options = options_of(in[0]);
    out[0] = memory_of(in[1], model_stream_work(&options));
    const double *const speed = limit("tool_speed_max", in[9], 1);
    const double *const acceleration = limit("tool_acceleration_max", in[10], 1);
    const int points = (int)mxGetM(in[11]) / 2;
    const model_inversion_limits limits = {
        .torque_max = limit("torque_max", in[2], MODEL_NM),
        .speed_max = limit("speed_max", in[3], MODEL_NM),
        .deflection_max = limit("deflection_max", in[4], MODEL_NE),
        .gear_torque_max = limit("gear_torque_max", in[5], MODEL_NG),
        .torque_rate_max = limit("torque_rate_max", in[6], MODEL_NM),
        .joint_speed_max = limit("joint_speed_max", in[7], MODEL_NG),
        .joint_acceleration_max = limit("joint_acceleration_max", in[8], MODEL_NG),
        .tool_speed_max = speed ? *speed : 0.0,
        .tool_acceleration_max = acceleration ? *acceleration : 0.0,
        .torque_speed = points > 0 ? numbers("all_limits", "torque_speed", in[11], 2 * points,
                                         MODEL_NM, NULL) :
                                     NULL,
        .torque_speed_points = points,
    };
    const double deviation = *numbers("all_limits", "deviation_max", in[12], 1, 1, NULL);
    const model_stream stream = stream_in(out[0]);
    check_status("all_limits", model_stream_all_limits(&stream, &limits, deviation));
}

#endif

void mexFunction(int n_out, mxArray *out[], int n_in, const mxArray *in[])
{
    char what[64];
    if (n_in < 1 || !mxIsChar(in[0]) || mxGetString(in[0], what, sizeof what) != 0) {
        refuse("library", "no name of a function", "the name of one");
    }
    for (size_t k = 0; k < sizeof POINT_FUNCTIONS / sizeof POINT_FUNCTIONS[0]; ++k) {
        if (strcmp(what, POINT_FUNCTIONS[k].name) == 0) {
            if (n_out > POINT_FUNCTIONS[k].n_out) {
                count_arguments(what, n_out, POINT_FUNCTIONS[k].n_out);
            }
            point(&POINT_FUNCTIONS[k], n_out, out, n_in - 1, in + 1);
            return;
        }
    }
#ifdef MODEL_STREAM_INTERVALS_MAX
    if (strcmp(what, "invert") == 0) {
        invert(n_out, out, n_in - 1, in + 1);
        return;
    }
    if (strcmp(what, "stream_start") == 0) {
        stream_start(n_in - 1, in + 1, out);
        return;
    }
    if (strcmp(what, "stream_update") == 0) {
        stream_update(n_out, out, n_in - 1, in + 1);
        return;
    }
    if (strcmp(what, "stream_limits") == 0) {
        stream_limits(n_in - 1, in + 1, out);
        return;
    }
    if (strcmp(what, "stream_all_limits") == 0) {
        stream_all_limits(n_in - 1, in + 1, out);
        return;
    }
#endif
    refuse("library", what, "a function of the library");
}
