/*
 * elbow: the solvers of inverse dynamics along paths, in one source, so that they share their functions. With
 * -DELBOW_WITHOUT_INVERT or -DELBOW_WITHOUT_STREAM it is compiled without this part. Written by flexgen; see
 * elbow_inversion.h.
 */

#ifndef ELBOW_WITHOUT_INVERT
/* elbow: inverse dynamics along a whole path. Written by flexgen; see elbow_inversion.h. */
#include "../elbow_inversion.h"

#include "elbow_equilibrium.h"
#include "elbow_lq_path.h"
#include "elbow_whole_path.h"

#if ELBOW_NE > 0
enum { SWEEPS = 40, SWEEP = 8 }; /* sweeps for the cost of an endless equilibrium; their intervals */

static const real cost_change = 1e-2; /* from sweep to sweep, where the cost of an endless equilibrium has converged */

/* Where the arrays of this solver are, after those of both. */
typedef struct {
    int64_t cost, y, a, q_g, reference, steady_factor, steady_point, point, row, linear, settling, lq, end;
} lq_layout;

static lq_layout lay_out_lq(const whole_layout *l)
{
    lq_layout own;
    int64_t at = l->end;
    TAKE(at, own.cost, STATES * STATES);
    TAKE(at, own.y, 2 * STATES);
    TAKE(at, own.a, CONTROLS);
    TAKE(at, own.q_g, STAGES * NG);
    TAKE(at, own.reference, STAGES * REFERENCE);
    TAKE(at, own.steady_factor, CONTROLS * WIDTH);
    TAKE(at, own.steady_point, STAGES * POINT + BLOCK);
    TAKE(at, own.point, l->varying * STAGES * POINT + BLOCK);
    TAKE(at, own.row, l->intervals * STAGES * NE);
    TAKE(at, own.linear, l->intervals * CONTROLS);
    TAKE(at, own.settling, (int64_t)((sizeof(settling) + sizeof(real) - 1) / sizeof(real)));
    TAKE(at, own.lq, (int64_t)(sizeof(lq_space) / sizeof(real)));
    own.end = at;
    return own;
}
#endif

int64_t elbow_invert_work(int n, const elbow_inversion_options *options)
{
    whole_layout l;
    int64_t end;
    if (options == NULL || !path_sizes_fit(n, options)) {
        return -1;
    }
#if ELBOW_NE > 0
    l = lay_out(n, options, CONTROLS * WIDTH, 1);
    end = lay_out_lq(&l).end;
#else
    l = lay_out(n, options, 0, 0);
    end = l.end + padded((int64_t)(sizeof(problem_points) / sizeof(real)));
#endif
    return is_addressable(end) ? end : -1;
}

#if ELBOW_NE > 0
/*
 * Equilibrium at the end of the path, to which the first guess of the motion leads; the cost of a state that differs
 * from it, for the end of the mesh; and when the motion has settled there.
 */
static int prepare_end(
    mesh *m, const whole_layout *l, const lq_layout *own, const real *target, const real *q_start, real *work)
{
    lq_space *w = (lq_space *)(void *)(work + own->lq);
    const real *joints = m->q_g + ((ptrdiff_t)m->N * STAGES - 1) * NG;
    real q[NA], scale[NE], reference[REFERENCE] = {0.0};
    settling *end = (settling *)(void *)(work + own->settling);
    mesh hold = *m;
    int status, is_exact = 0;
    copy(q_start, NA, q);
    for (int i = 0; i < NG; ++i) {
        q[i_g[i]] = joints[i];
    }
    status = equilibrium_at(target, q, scale, work + l->space);
    if (status != ELBOW_OK) {
        return status;
    }
    copy(target, NT, reference);
    hold.N = 1;
    hold.y = work + own->y;
    hold.a = work + own->a;
    hold.q_g = work + own->q_g;
    hold.reference = work + own->reference;
    hold.factor = work + own->steady_factor;
    for (int i = 0; i < STATES; ++i) {
        hold.y[i] = hold.y[STATES + i] = i < NE ? q[i_e[i % NE]] : 0.0;
    }
    for (int i = 0; i < CONTROLS; ++i) {
        hold.a[i] = 0.0;
    }
    for (int k = 0; k < STAGES; ++k) {
        for (int i = 0; i < NG; ++i) {
            hold.q_g[k * NG + i] = q[i_g[i]];
        }
        copy(reference, REFERENCE, hold.reference + k * REFERENCE);
    }
    status = lq_stationary_cost(&hold, SWEEP, m->N / SWEEP > SWEEPS ? m->N / SWEEP : SWEEPS, regularization,
        cost_change, w, work + l->space, work + own->cost, &is_exact);
    copy(w->point, STAGES * POINT, work + own->steady_point);
    m->factored = is_exact ? m->varying : m->N;
    m->end = work + own->cost;
    m->equilibrium = hold.y;
    copy(q, NA, end->q);
    end->intervals = m->N;
    move_smoothly(m, hold.y);
    for (ptrdiff_t k = (ptrdiff_t)m->varying * STAGES; k < (ptrdiff_t)m->N * STAGES; ++k) {
        copy(hold.q_g, NG, m->q_g + k * NG);
    }
    return status == ELBOW_OK && end->allowed > 0.0 ? settling_at(target, &w->arm, end, work + l->space) : status;
}

/* The motion on the mesh; cut: it ends where it has settled after the first step, else after the last one. */
static int motion_on_mesh(mesh *m, const whole_layout *l, const lq_layout *own, const elbow_path *p, const real *q,
    const elbow_inversion_options *options, int cut, elbow_inversion_info *info, real *work)
{
    lq_space *w = (lq_space *)(void *)(work + own->lq);
    settling *end = (settling *)(void *)(work + own->settling);
    lq_data c;
    int status = guess_mesh(m, p, q, options->n_pre, options->samples_per_interval, &w->arm, work + l->space);
    if (status == ELBOW_OK) {
        status = prepare_end(m, l, own, p->y + (p->n - 1) * (ptrdiff_t)NT, q, work);
    }
    if (status != ELBOW_OK) {
        return status;
    }
    c.point = work + own->point;
    c.row = work + own->row;
    c.linear = work + own->linear;
    c.steady_point = work + own->steady_point;
    c.steady_factor = work + own->steady_factor;
    status = lq_path_solve(m, work + own->point, &c, options, cut, end, info, w, work + l->space);
    info->residual = m->residual;
    info->intervals = m->N;
    if (status == ELBOW_OK && !cut && end->allowed > 0.0) {
        cut_mesh(m, options->samples_per_interval, end);
    }
    return status;
}

#endif

elbow_status elbow_invert(const elbow_path *p, PARAMETERS_ARGUMENT const real q_start[ELBOW_NA],
    const elbow_inversion_options *options, elbow_motion *motion, elbow_inversion_info *info, real *work,
    int64_t work_size)
{
    const int64_t wanted = p == NULL ? -1 : elbow_invert_work(p->n, options);
    whole_layout l;
    real q[NA];
#if ELBOW_NE == 0
    ptrdiff_t samples;
#endif
    int status = check_arguments(p, GIVEN_PARAMETERS, q_start, options, motion, info, work, work_size, wanted);
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    copy(q_start, NA, q);
#if ELBOW_NE > 0
    {
        lq_layout own;
        settling *end;
        mesh m;
        l = lay_out(p->n, options, CONTROLS * WIDTH, 1);
        keep_parameters(GIVEN_PARAMETERS, work + l.space);
        own = lay_out_lq(&l);
        end = (settling *)(void *)(work + own.settling);
        end->allowed = options->settled;
        end->shortest = shortest_motion_after(work + l.space);
        m = mesh_in(&l, p, options, work);
        status = equilibrium_at(p->y, q, m.scale, work + l.space);
        if (status == ELBOW_OK) {
            status = motion_on_mesh(&m, &l, &own, p, q, options, end->allowed > 0.0, info, work);
        }
        if (status == ELBOW_OK && is_cut_early(&m, end)) {
            m = mesh_in(&l, p, options, work);
            status = motion_on_mesh(&m, &l, &own, p, q, options, 0, info, work);
        }
        if (status != ELBOW_OK) {
            return (elbow_status)status;
        }
        return finish(p, options, &l, q, &m, end->q, end->intervals * (ptrdiff_t)options->samples_per_interval + 1,
            &((lq_space *)(void *)(work + own.lq))->arm, motion, info, work);
    }
#else
    l = lay_out(p->n, options, 0, 0);
    keep_parameters(GIVEN_PARAMETERS, work + l.space);
    status = equilibrium_at(p->y, q, NULL, work + l.space);
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    info->residual = 0.0;
    samples = (ptrdiff_t)l.samples;
    if (options->settled > 0.0) {
        const real after = shortest_motion_after(work + l.space) / p->period;
        if (after < (real)options->n_post) { /* rounded up */
            samples -= options->n_post - (ptrdiff_t)after - 1;
        }
    }
    return finish(p, options, &l, q, NULL, samples, (problem_points *)(void *)(work + l.end), motion, info, work);
#endif
}
#endif

#ifndef ELBOW_WITHOUT_STREAM
/* elbow: inverse dynamics on a moving horizon. Written by flexgen; see elbow_inversion.h. */
#include "../elbow_inversion.h"

#include "elbow_stream_moving.h"
#include "elbow_stream_parts.h"
#include "elbow_equilibrium.h"

enum { SETTLING_SWEEPS = 10 }; /* sweeps after which the cost of an endless equilibrium has converged */
#if ELBOW_NE > 0
static const real initial_weight = 1e-4; /* before the first of them */
#endif

int64_t elbow_stream_work(const elbow_stream_options *options)
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
#if ELBOW_NE > 0
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
#if ELBOW_NE > 0
    real row[NE];
    status = inner_status(evaluate_inversion_rows(q, zero, zero, tau, row, space));
#else
    status = inner_status(evaluate_inversion_rows(q, zero, zero, tau, space));
#endif
    if (status != ELBOW_OK) {
        return status;
    }
    return static_deflections(tau, 1, zero, deflection, stiffness, space) ? ELBOW_OK : ELBOW_RESULT_NOT_FINITE;
}

COLD elbow_status elbow_stream_start(real *stream, int64_t stream_size, const elbow_stream_options *options,
    const real y[ELBOW_NT], PARAMETERS_ARGUMENT const real q_start[ELBOW_NA])
{
    const real *parameters_given = GIVEN_PARAMETERS;
    layout l;
    real q[NA], *space;
    int status;
    if (stream == NULL || options == NULL || y == NULL || parameters_given == NULL || q_start == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!stream_sizes_fit(options) || !(options->period > 0.0 && options->period < 1e6) ||
        !(options->tolerance > 0.0 && options->tolerance < 1.0)) {
        return ELBOW_BAD_ARGUMENT;
    }
    l = laid_out(options->intervals, options->samples_per_interval, (real)options->hold, options->delay);
    if (stream_size < l.end) {
        return ELBOW_WORK_TOO_SMALL;
    }
    stream[STATE] = IS_EMPTY;
    if (!is_finite(y, NT) || !is_finite(parameters_given, PARAMETERS) || !is_finite(q_start, NA)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
#if ELBOW_POSE
    if (!is_rotation(y + 3)) {
        return ELBOW_BAD_ARGUMENT;
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
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    set_equilibrium(stream, &l, y, q);
#if ELBOW_NE > 0
    {
        mesh hold = mesh_of(&l, stream);
        int is_exact = 0;
        status = lq_stationary_cost(&hold, hold.N, SETTLING_SWEEPS, initial_weight, 0.0,
            (lq_space *)(void *)(stream + l.lq), space, stream + l.cost, &is_exact);
        if (status != ELBOW_OK) {
            return (elbow_status)status;
        }
        for (ptrdiff_t k = 1; k < hold.N; ++k) { /* all intervals are like the first one */
            copy(hold.factor, CONTROLS * WIDTH, hold.factor + k * CONTROLS * WIDTH);
        }
    }
#endif
    status = deflection_at_equilibrium(q, stream + l.now, space);
    if (status == ELBOW_OK) {
        stream[STATE] = IS_RUNNING;
    }
    return (elbow_status)status;
}

/* Whether an update has begun and not ended. */
static int has_begun(const real *stream)
{
    return stream[PART] > (real)NO_UPDATE;
}

#if ELBOW_PARAMETERS > 0
COLD elbow_status elbow_stream_parameters(real *stream, const real parameters[ELBOW_PARAMETERS])
{
    layout l;
    if (stream == NULL || parameters == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return ELBOW_NOT_STARTED;
    }
    if (has_begun(stream)) {
        return ELBOW_BAD_ARGUMENT;
    }
    if (!is_finite(parameters, PARAMETERS)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
    l = layout_of(stream);
    stream[STALE] = 1.0;
    keep_parameters(parameters, stream + l.space);
    return ELBOW_OK;
}
#endif

COLD elbow_status elbow_stream_limits(
    real *stream, const real torque_max[ELBOW_NM], const real speed_max[ELBOW_NM], real deviation_max)
{
    layout l;
    limits_layout w;
    ptrdiff_t N;
    real *bound;
    if (stream == NULL || torque_max == NULL || speed_max == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return ELBOW_NOT_STARTED;
    }
    N = (ptrdiff_t)stream[INTERVALS];
    if (has_begun(stream) || !(deviation_max > 0.0 && deviation_max < 1e6)) {
        return ELBOW_BAD_ARGUMENT;
    }
    for (int i = 0; i < NM; ++i) {
        if (!(torque_max[i] > 0.0 && speed_max[i] > 0.0)) {
            return ELBOW_BAD_ARGUMENT;
        }
    }
    l = layout_of(stream);
    w = limits_laid_out(N);
    if (!(stream[l.limits + w.on] > 0.0) && !start_limits(stream, &l)) {
        return ELBOW_HORIZON_TOO_SHORT;
    }
    bound = stream + l.limits + w.bound;
    copy(torque_max, NM, bound);
    copy(speed_max, NM, bound + NM);
    for (int i = 0; i < NY; ++i) {
        bound[MOTORS + i] = deviation_max;
    }
    return ELBOW_OK;
}

/* Status of an update that fails after its sample was taken; UNREACHABLE would mean that the sample was refused. */
static elbow_status failed(real *stream, int status)
{
    stream[STATE] = HAS_FAILED;
    return status == ELBOW_UNREACHABLE ? ELBOW_NOT_CONVERGED : (elbow_status)status;
}

elbow_status elbow_stream_begin(real *stream, const real y[ELBOW_NT], const real dy[ELBOW_NY], const real ddy[ELBOW_NY])
{
    layout l;
    real own[REFERENCE], next[REFERENCE], deviation[DEVIATION];
    next_interval arrived;
    int has_limits, status;
    if (stream == NULL || y == NULL || dy == NULL || ddy == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return ELBOW_NOT_STARTED;
    }
    if (has_begun(stream)) {
        return ELBOW_BAD_ARGUMENT;
    }
    if (!is_finite(y, NT) || !is_finite(dy, NY) || !is_finite(ddy, NY)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
    l = layout_of(stream);
#if ELBOW_POSE
    if (!is_rotation(y + 3) || !are_near(stream + l.last + 3, y + 3)) {
        return ELBOW_BAD_ARGUMENT;
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
    if (status != ELBOW_OK) {
        return (elbow_status)status; /* the sample is refused, and nothing has changed */
    }
    shift_path(stream, &l, next, &arrived);
    if (has_limits) {
        shift_limits(stream, &l, own, deviation);
    }
    for (int i = PART; i < HEAD; ++i) {
        stream[i] = 0.0;
    }
    stream[PART] = (real)(NO_UPDATE + 1);
    return ELBOW_OK;
}

elbow_status elbow_stream_advance(real *stream, int parts)
{
    layout l;
    int status;
    if (stream == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!is_running(stream) || !has_begun(stream)) {
        return ELBOW_NOT_STARTED;
    }
    if (parts < 1) {
        return ELBOW_BAD_ARGUMENT;
    }
    l = layout_of(stream);
    status = do_parts(stream, &l, parts);
    return status == ELBOW_OK ? ELBOW_OK : failed(stream, status);
}

/* Copy results where the caller wants them. */
static void give(const real *from, ptrdiff_t size, real *to)
{
    if (to != NULL) {
        copy(from, size, to);
    }
}

elbow_status elbow_stream_finish(real *stream, elbow_motion *motion, elbow_stream_info *info)
{
    layout l;
    interval_results out;
    ptrdiff_t n;
    int status;
    if (stream == NULL || motion == NULL || info == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!is_running(stream) || !has_begun(stream)) {
        return ELBOW_NOT_STARTED;
    }
    l = layout_of(stream);
    status = do_parts(stream, &l, 1);
    if (status != ELBOW_OK) {
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
        return ELBOW_TOLERANCE_NOT_MET;
    }
    return info->limits_active ? ELBOW_LIMITS_ACTIVE : ELBOW_OK;
}

elbow_status elbow_stream_update(real *stream, const real y[ELBOW_NT], const real dy[ELBOW_NY],
    const real ddy[ELBOW_NY], elbow_motion *motion, elbow_stream_info *info)
{
    elbow_status status;
    if (motion == NULL || info == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    status = elbow_stream_begin(stream, y, dy, ddy);
    return status == ELBOW_OK ? elbow_stream_finish(stream, motion, info) : status;
}

/* Whether all samples are finite, and all rotations are rotations and close to each other. */
static elbow_status check_samples(const elbow_path *p)
{
    for (ptrdiff_t k = 0; k < p->n; ++k) {
        if (!is_finite(p->y + k * NT, NT) || !is_finite(p->dy + k * NY, NY) || !is_finite(p->ddy + k * NY, NY)) {
            return ELBOW_INPUT_NOT_FINITE;
        }
    }
#if ELBOW_POSE
    for (ptrdiff_t k = 0; k < p->n; ++k) {
        const real *R = p->y + k * NT + 3;
        if (!is_rotation(R) || (k > 0 && !are_near(R - NT, R))) {
            return ELBOW_BAD_ARGUMENT;
        }
    }
#endif
    return ELBOW_OK;
}

COLD elbow_status elbow_stream_start_moving(real *stream, int64_t stream_size, const elbow_stream_options *options,
    const elbow_path *path, PARAMETERS_ARGUMENT const real q_start[ELBOW_NA])
{
    elbow_motion none = {NULL, NULL, NULL, NULL, NULL, NULL, NULL};
    elbow_stream_info info;
    elbow_status status;
    ptrdiff_t now;
    layout l;
    real q[NA];
    if (stream == NULL || options == NULL || path == NULL || path->y == NULL || path->dy == NULL || path->ddy == NULL ||
        q_start == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!stream_sizes_fit(options) || path->n != ELBOW_STREAM_START_SAMPLES(options->intervals) ||
        !(fabs_1(path->period - options->period) <= 1e-6 * options->period)) {
        return ELBOW_BAD_ARGUMENT;
    }
    status = check_samples(path);
    if (status != ELBOW_OK) {
        return status;
    }
    now = path->n - 1 - SILENT_UPDATES - options->intervals;
    status = elbow_stream_start(stream, stream_size, options, path->y + now * NT, PASSED_PARAMETERS q_start);
    if (status != ELBOW_OK) {
        return status;
    }
    l = layout_of(stream);
    joints_at_start(stream, &l, q);
    status = (elbow_status)set_moving(stream, &l, path, now, q);
    for (ptrdiff_t k = path->n - SILENT_UPDATES; k < path->n && status >= ELBOW_OK; ++k) {
        status = elbow_stream_update(stream, path->y + k * NT, path->dy + k * NY, path->ddy + k * NY, &none, &info);
    }
    if (status < ELBOW_OK) {
        stream[STATE] = IS_EMPTY;
        return status;
    }
    for (int i = 0; i < MEASURES + NM; ++i) { /* largest values of the first updates are not those of the motion */
        stream[l.most + i] = 0.0;
    }
    return ELBOW_OK;
}
#endif
