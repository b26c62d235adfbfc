/* model: inverse dynamics on a moving horizon. Written by flexgen; see model_inversion.h. */
#include "model_inversion.h"

#include "model_stream_moving.h"
#include "model_stream_parts.h"
#include "model_equilibrium.h"

enum { SETTLING_SWEEPS = 10 }; /* sweeps after which the cost of an endless equilibrium has converged */
#if MODEL_NE > 0
static const real initial_weight = 1e-4; /* before the first of them */
#endif

int64_t model_stream_work(const model_stream_options *options)
{
    return options != NULL && stream_sizes_fit(options) ?
               (int64_t)laid_out(options->intervals, options->samples_per_interval, (real)options->hold, options->delay)
                   .end :
               -1;
}

/* The whole horizon and the past are at the equilibrium q with the output at its target. */
static void set_equilibrium(real *s, const layout *l, const real *target, const real *q)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    real *equilibrium = s + l->last;
    copy(target, NT, equilibrium);
    for (int i = NT; i < REFERENCE; ++i) {
        equilibrium[i] = 0.0;
    }
    for (ptrdiff_t k = 0; k < N * STAGES; ++k) {
        copy(equilibrium, REFERENCE, s + l->reference + k * REFERENCE);
    }
    for (ptrdiff_t k = 0; k <= l->past + N; ++k) {
        copy(equilibrium, REFERENCE, s + l->nodes + k * REFERENCE);
    }
    for (ptrdiff_t k = 0; k <= N * STAGES; ++k) {
        for (int i = 0; i < NG; ++i) {
            s[l->q_g + k * NG + i] = q[i_g[i]];
        }
    }
#if MODEL_NE > 0
    for (ptrdiff_t k = 0; k <= l->past + N; ++k) {
        for (int i = 0; i < NE; ++i) {
            s[l->y + k * STATES + i] = q[i_e[i]];
            s[l->y + k * STATES + NE + i] = 0.0;
        }
    }
    for (ptrdiff_t k = 0; k < (l->past + N) * CONTROLS; ++k) {
        s[l->a + k] = 0.0;
    }
    copy(s + l->y, (N + 1) * STATES, s + l->target_state);
    for (int k = 0; k < LEVELS * LAST; ++k) {
        copy(s + l->y, NE, s + l->levels + k * NE);
    }
#endif
}

/* Deflections of the gears at the equilibrium q. */
static int deflection_at_equilibrium(const real *q, real *deflection, real *space)
{
    static const real zero[NA] = {0.0};
    real tau[NG], stiffness[NG];
    int status;
#if MODEL_NE > 0
    real row[NE];
    status = inner_status(evaluate_inversion_rows(q, zero, zero, tau, row, space));
#else
    status = inner_status(evaluate_inversion_rows(q, zero, zero, tau, space));
#endif
    if (status != MODEL_OK) {
        return status;
    }
    return static_deflections(tau, 1, zero, deflection, stiffness, space) ? MODEL_OK : MODEL_RESULT_NOT_FINITE;
}

COLD model_status model_stream_start(real *stream, int64_t stream_size, const model_stream_options *options,
    const real y[MODEL_NT], PARAMETERS_ARGUMENT const real q_start[MODEL_NA])
{
    const real *parameters_given = GIVEN_PARAMETERS;
    layout l;
    real q[NA], *space;
    int status;
    if (stream == NULL || options == NULL || y == NULL || parameters_given == NULL || q_start == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!stream_sizes_fit(options) || !(options->period > 0.0 && options->period < 1e6) ||
        !(options->tolerance > 0.0 && options->tolerance < 1.0)) {
        return MODEL_BAD_ARGUMENT;
    }
    l = laid_out(options->intervals, options->samples_per_interval, (real)options->hold, options->delay);
    if (stream_size < l.end) {
        return MODEL_WORK_TOO_SMALL;
    }
    stream[STATE] = IS_EMPTY;
    if (!is_finite(y, NT) || !is_finite(parameters_given, PARAMETERS) || !is_finite(q_start, NA)) {
        return MODEL_INPUT_NOT_FINITE;
    }
#if MODEL_POSE
    if (!is_rotation(y + 3)) {
        return MODEL_BAD_ARGUMENT;
    }
#endif
    space = stream + l.space;
    keep_parameters(parameters_given, space);
    copy(q_start, NA, q);
    stream[INTERVALS] = (real)options->intervals;
    stream[SAMPLES_PER_INTERVAL] = (real)options->samples_per_interval;
    stream[PERIOD] = options->period;
    stream[TOLERANCE] = options->tolerance;
    stream[HOLD] = (real)options->hold;
    stream[DELAY] = options->delay;
    stream[BASE] = 0.0;
    stream[STALE] = 1.0;
    stream[PART] = (real)NO_UPDATE;
    stream[SIDE] = 0.0; /* side of singular poses: not known before the first sample */
    stream[l.limits] = 0.0;
    for (int i = 0; i < MEASURES + NM; ++i) {
        stream[l.most + i] = 0.0;
    }
    stream[l.expected] = 0.0;
    status = equilibrium_at(y, q, stream + l.scale, space);
    if (status != MODEL_OK) {
        return (model_status)status;
    }
    set_equilibrium(stream, &l, y, q);
#if MODEL_NE > 0
    {
        mesh hold = mesh_of(&l, stream);
        int is_exact = 0;
        status = lq_stationary_cost(&hold, hold.N, SETTLING_SWEEPS, initial_weight, 0.0,
            (lq_space *)(void *)(stream + l.lq), space, stream + l.cost, &is_exact);
        if (status != MODEL_OK) {
            return (model_status)status;
        }
        for (ptrdiff_t k = 1; k < hold.N; ++k) { /* all intervals are like the first one */
            copy(hold.factor, CONTROLS * WIDTH, hold.factor + k * CONTROLS * WIDTH);
        }
    }
#endif
    status = deflection_at_equilibrium(q, stream + l.now, space);
    if (status == MODEL_OK) {
        stream[STATE] = IS_RUNNING;
    }
    return (model_status)status;
}

/* Whether an update has begun and not ended. */
static int has_begun(const real *stream)
{
    return stream[PART] > (real)NO_UPDATE;
}

#if MODEL_PARAMETERS > 0
COLD model_status model_stream_parameters(real *stream, const real parameters[MODEL_PARAMETERS])
{
    layout l;
    if (stream == NULL || parameters == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return MODEL_NOT_STARTED;
    }
    if (has_begun(stream)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (!is_finite(parameters, PARAMETERS)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    l = layout_of(stream);
    stream[STALE] = 1.0;
    keep_parameters(parameters, stream + l.space);
    return MODEL_OK;
}
#endif

COLD model_status model_stream_limits(
    real *stream, const real torque_max[MODEL_NM], const real speed_max[MODEL_NM], real deviation_max)
{
    layout l;
    limits_layout w;
    ptrdiff_t N;
    real *bound;
    if (stream == NULL || torque_max == NULL || speed_max == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return MODEL_NOT_STARTED;
    }
    N = (ptrdiff_t)stream[INTERVALS];
    if (has_begun(stream) || !(deviation_max > 0.0 && deviation_max < 1e6)) {
        return MODEL_BAD_ARGUMENT;
    }
    for (int i = 0; i < NM; ++i) {
        if (!(torque_max[i] > 0.0 && speed_max[i] > 0.0)) {
            return MODEL_BAD_ARGUMENT;
        }
    }
    l = layout_of(stream);
    w = limits_laid_out(N);
    if (!(stream[l.limits + w.on] > 0.0) && !start_limits(stream, &l)) {
        return MODEL_HORIZON_TOO_SHORT;
    }
    bound = stream + l.limits + w.bound;
    copy(torque_max, NM, bound);
    copy(speed_max, NM, bound + NM);
    for (int i = 0; i < NY; ++i) {
        bound[MOTORS + i] = deviation_max;
    }
    return MODEL_OK;
}

/* Status of an update that fails after its sample was taken; UNREACHABLE would mean that the sample was refused. */
static model_status failed(real *stream, int status)
{
    stream[STATE] = HAS_FAILED;
    return status == MODEL_UNREACHABLE ? MODEL_NOT_CONVERGED : (model_status)status;
}

model_status model_stream_begin(real *stream, const real y[MODEL_NT], const real dy[MODEL_NY], const real ddy[MODEL_NY])
{
    layout l;
    real own[REFERENCE], next[REFERENCE], deviation[DEVIATION];
    next_interval arrived;
    int has_limits, status;
    if (stream == NULL || y == NULL || dy == NULL || ddy == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return MODEL_NOT_STARTED;
    }
    if (has_begun(stream)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (!is_finite(y, NT) || !is_finite(dy, NY) || !is_finite(ddy, NY)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    l = layout_of(stream);
#if MODEL_POSE
    if (!is_rotation(y + 3) || !are_near(stream + l.last + 3, y + 3)) {
        return MODEL_BAD_ARGUMENT;
    }
#endif
    copy(y, NT, own);
    copy(dy, NY, own + NT);
    copy(ddy, NY, own + NT + NY);
    copy(own, REFERENCE, next);
    has_limits = stream[l.limits] > 0.0;
    if (has_limits) {
        next_deviation(stream, &l, own, deviation, next);
    }
    status = reach_next_sample(stream, &l, next, &arrived);
    if (status != MODEL_OK) {
        return (model_status)status; /* the sample is refused, and nothing has changed */
    }
    shift_path(stream, &l, next, &arrived);
    if (has_limits) {
        shift_limits(stream, &l, own, deviation);
    }
    for (int i = PART; i < HEAD; ++i) {
        stream[i] = 0.0;
    }
    stream[PART] = (real)(NO_UPDATE + 1);
    return MODEL_OK;
}

model_status model_stream_advance(real *stream, int parts)
{
    layout l;
    int status;
    if (stream == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_running(stream) || !has_begun(stream)) {
        return MODEL_NOT_STARTED;
    }
    if (parts < 1) {
        return MODEL_BAD_ARGUMENT;
    }
    l = layout_of(stream);
    status = do_parts(stream, &l, parts);
    return status == MODEL_OK ? MODEL_OK : failed(stream, status);
}

/* Copy results where the caller wants them. */
static void give(const real *from, ptrdiff_t size, real *to)
{
    if (to != NULL) {
        copy(from, size, to);
    }
}

model_status model_stream_finish(real *stream, model_motion *motion, model_stream_info *info)
{
    layout l;
    interval_results out;
    ptrdiff_t n;
    int status;
    if (stream == NULL || motion == NULL || info == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_running(stream) || !has_begun(stream)) {
        return MODEL_NOT_STARTED;
    }
    l = layout_of(stream);
    status = do_parts(stream, &l, 1);
    if (status != MODEL_OK) {
        return failed(stream, status);
    }
    n = (ptrdiff_t)stream[SAMPLES_PER_INTERVAL];
    out = results_in(stream, &l);
    give(out.q_a, n * NA, motion->q_a);
    give(out.v_a, n * NA, motion->v_a);
    give(out.tau_g, n * NG, motion->tau_g);
    give(out.q_m, n * NM, motion->q_m);
    give(out.v_m, n * NM, motion->v_m);
    give(out.tau_m, n * NM, motion->tau_m);
    stream[PART] = (real)NO_UPDATE;
    info->iterations = 1;
    info->intervals = (int)stream[INTERVALS];
    info->residual = stream[RESIDUAL];
    info->kinematic_mismatch = stream[MISMATCH];
    info->torque_step = stream[TORQUE_STEP];
    info->output_step_m = stream[OUTPUT_STEP];
    info->output_step_rad = stream[OUTPUT_STEP + 1];
    info->deviation_m = stream[OFF];
    info->deviation_rad = stream[OFF + 1];
    info->limits_active = stream[LIMITED] > 0.0;
    /* one cause: a short horizon makes the residual large too */
    info->cause = !(info->torque_step <= torque_step_max) ? 3 : !(info->residual <= stream[TOLERANCE]) ? 1 : 0;
    if (info->cause == 0 && !(info->kinematic_mismatch <= mismatch_max)) {
        info->cause = 2;
    }
    if (info->cause != 0) {
        return MODEL_TOLERANCE_NOT_MET;
    }
    return info->limits_active ? MODEL_LIMITS_ACTIVE : MODEL_OK;
}

model_status model_stream_update(real *stream, const real y[MODEL_NT], const real dy[MODEL_NY],
    const real ddy[MODEL_NY], model_motion *motion, model_stream_info *info)
{
    model_status status;
    if (motion == NULL || info == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    status = model_stream_begin(stream, y, dy, ddy);
    return status == MODEL_OK ? model_stream_finish(stream, motion, info) : status;
}

/* Whether all samples are finite, and all rotations are rotations and close to each other. */
static model_status check_samples(const model_path *p)
{
    for (ptrdiff_t k = 0; k < p->n; ++k) {
        if (!is_finite(p->y + k * NT, NT) || !is_finite(p->dy + k * NY, NY) || !is_finite(p->ddy + k * NY, NY)) {
            return MODEL_INPUT_NOT_FINITE;
        }
    }
#if MODEL_POSE
    for (ptrdiff_t k = 0; k < p->n; ++k) {
        const real *R = p->y + k * NT + 3;
        if (!is_rotation(R) || (k > 0 && !are_near(R - NT, R))) {
            return MODEL_BAD_ARGUMENT;
        }
    }
#endif
    return MODEL_OK;
}

COLD model_status model_stream_start_moving(real *stream, int64_t stream_size, const model_stream_options *options,
    const model_path *path, PARAMETERS_ARGUMENT const real q_start[MODEL_NA])
{
    model_motion none = {NULL, NULL, NULL, NULL, NULL, NULL, NULL};
    model_stream_info info;
    model_status status;
    ptrdiff_t now;
    layout l;
    real q[NA];
    if (stream == NULL || options == NULL || path == NULL || path->y == NULL || path->dy == NULL || path->ddy == NULL ||
        q_start == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!stream_sizes_fit(options) || path->n != MODEL_STREAM_START_SAMPLES(options->intervals) ||
        !(fabs_1(path->period - options->period) <= 1e-6 * options->period)) {
        return MODEL_BAD_ARGUMENT;
    }
    status = check_samples(path);
    if (status != MODEL_OK) {
        return status;
    }
    now = path->n - 1 - SILENT_UPDATES - options->intervals;
    status = model_stream_start(stream, stream_size, options, path->y + now * NT, PASSED_PARAMETERS q_start);
    if (status != MODEL_OK) {
        return status;
    }
    l = layout_of(stream);
    joints_at_start(stream, &l, q);
    status = (model_status)set_moving(stream, &l, path, now, q);
    for (ptrdiff_t k = path->n - SILENT_UPDATES; k < path->n && status >= MODEL_OK; ++k) {
        status = model_stream_update(stream, path->y + k * NT, path->dy + k * NY, path->ddy + k * NY, &none, &info);
    }
    if (status < MODEL_OK) {
        stream[STATE] = IS_EMPTY;
        return status;
    }
    for (int i = 0; i < MEASURES + NM; ++i) { /* largest values of the first updates are not those of the motion */
        stream[l.most + i] = 0.0;
    }
    return MODEL_OK;
}
