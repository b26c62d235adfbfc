/* model: inverse dynamics on a moving horizon. Written by flexgen; see model.h. */
#include "model.h"

#include "model_advance.h"
#include "model_interval.h"
#include "model_rest.h"

enum { WARMING = 10 }; /* sweeps after which the cost of an endless rest has settled */

int64_t model_stream_work(int intervals, int parts)
{
    return sizes_fit(intervals, parts) ? (int64_t)laid_out(intervals, parts).end : -1;
}

/* The whole horizon, and what is over, rests at q with the output at a place. */
static void stand_still(real *s, const layout *l, const real *place, const real *q)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    real *rest = s + l->last;
    copy(place, NT, rest);
    for (int i = NT; i < REFERENCE; ++i) {
        rest[i] = 0.0;
    }
    for (ptrdiff_t k = 0; k < N * STAGES; ++k) {
        copy(rest, REFERENCE, s + l->reference + k * REFERENCE);
    }
    for (ptrdiff_t k = 0; k <= l->past + N; ++k) {
        copy(rest, REFERENCE, s + l->nodes + k * REFERENCE);
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
    copy(s + l->y, (N + 1) * STATES, s + l->aim);
    for (int k = 0; k < LEVELS * LAST; ++k) {
        copy(s + l->y, NE, s + l->levels + k * NE);
    }
#endif
}

/* Twists of the gears at rest at q. */
static int twist_at_rest(const real *q, real *twist, real *space)
{
    static const real zero[NA] = {0.0};
    real tau[NG], slope[NG];
    int status;
#if MODEL_NE > 0
    real row[NE];
    status = inner(model_inversion_rows(q, zero, zero, tau, row, space));
#else
    status = inner(model_inversion_rows(q, zero, zero, tau, space));
#endif
    if (status != MODEL_OK) {
        return status;
    }
    return static_twists(tau, 1, zero, twist, slope, 0, space) ? MODEL_OK : MODEL_RESULT_NOT_FINITE;
}

int model_stream_start(double *stream, int64_t stream_size, int intervals, int parts, double period,
    double tolerance, const double *place, const double *q_start)
{
    layout l;
    real q[NA], *space;
    int status;
    if (stream == NULL || place == NULL || q_start == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!sizes_fit(intervals, parts) || !(period > 0.0 && period < 1e6) || !(tolerance > 0.0 && tolerance < 1.0)) {
        return MODEL_BAD_ARGUMENT;
    }
    l = laid_out(intervals, parts);
    if (stream_size < l.end) {
        return MODEL_WORK_TOO_SMALL;
    }
    stream[STATE] = IS_EMPTY;
    if (!is_finite(place, NT) || !is_finite(q_start, NA)) {
        return MODEL_INPUT_NOT_FINITE;
    }
#if MODEL_POSE
    if (!is_rotation(place + 3)) {
        return MODEL_BAD_ARGUMENT;
    }
#endif
    space = stream + l.space;
    copy(q_start, NA, q);
    stream[INTERVALS] = intervals;
    stream[PARTS] = parts;
    stream[PERIOD] = period;
    stream[TOLERANCE] = tolerance;
    stream[SIDE] = 0.0; /* of singular poses: not known before the first sample */
    stream[l.limits] = 0.0;
    for (int i = 0; i < MEASURES + NM; ++i) {
        stream[l.most + i] = 0.0;
    }
    stream[l.expected] = 0.0;
    status = rest_at(place, q, stream + l.scale, space);
    if (status != MODEL_OK) {
        return status;
    }
    stand_still(stream, &l, place, q);
#if MODEL_NE > 0
    {
        mesh still = mesh_of(&l, stream);
        status = lq_endless(&still, WARMING, (lq_space *)(void *)(stream + l.lq), space, stream + l.cost);
        if (status != MODEL_OK) {
            return status;
        }
    }
#endif
    status = twist_at_rest(q, stream + l.now, space);
    if (status == MODEL_OK) {
        stream[STATE] = IS_RUNNING;
    }
    return status;
}

int model_stream_limits(
    double *stream, const double *torques_most, const double *speeds_most, double bend_max)
{
    layout l;
    limits_layout w;
    ptrdiff_t N;
    real *bound;
    if (stream == NULL || torques_most == NULL || speeds_most == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return MODEL_NOT_STARTED;
    }
    N = (ptrdiff_t)stream[INTERVALS];
    if (!(bend_max > 0.0 && bend_max < 1e6)) {
        return MODEL_BAD_ARGUMENT;
    }
    for (int i = 0; i < NM; ++i) {
        if (!(torques_most[i] > 0.0 && speeds_most[i] > 0.0)) {
            return MODEL_BAD_ARGUMENT;
        }
    }
    l = laid_out((int)N, (int)stream[PARTS]);
    w = limits_laid_out(N);
    if (!(stream[l.limits + w.on] > 0.0) && !begin_limits(stream, &l)) {
        return MODEL_SHORT_HORIZON;
    }
    bound = stream + l.limits + w.bound;
    copy(torques_most, NM, bound);
    copy(speeds_most, NM, bound + NM);
    for (int i = 0; i < NY; ++i) {
        bound[MOTORS + i] = bend_max;
    }
    return MODEL_OK;
}

/* What an update says when it fails after its sample was taken; UNREACHABLE would mean that it was refused. */
static int over(real *stream, int status)
{
    stream[STATE] = HAS_FAILED;
    return status == MODEL_UNREACHABLE ? MODEL_NOT_CONVERGED : status;
}

int model_stream_update(double *stream, const double *place, const double *rate, const double *rate2,
    double *q_a, double *v_a, double *tau_g, double *q_m, double *v_m, double *tau_m, double *report)
{
    const interval out = {q_a, v_a, tau_g, q_m, v_m, tau_m};
    layout l;
    real own[REFERENCE], next[REFERENCE], bend[BEND], worst, step = 0.0;
    arrival arrived;
    int has_limits, limited = 0, status;
    if (stream == NULL || place == NULL || rate == NULL || rate2 == NULL || q_a == NULL || v_a == NULL ||
        tau_g == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || report == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return MODEL_NOT_STARTED;
    }
    if (!is_finite(place, NT) || !is_finite(rate, NY) || !is_finite(rate2, NY)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    l = laid_out((int)stream[INTERVALS], (int)stream[PARTS]);
#if MODEL_POSE
    if (!is_rotation(place + 3) || !are_near(stream + l.last + 3, place + 3)) {
        return MODEL_BAD_ARGUMENT;
    }
#endif
    copy(place, NT, own);
    copy(rate, NY, own + NT);
    copy(rate2, NY, own + NT + NY);
    copy(own, REFERENCE, next);
    has_limits = stream[l.limits] > 0.0;
    if (has_limits) {
        bend_next(stream, &l, own, bend, next);
    }
    status = arrive(stream, &l, next, &arrived);
    if (status != MODEL_OK) {
        return status; /* the sample is refused, and nothing has changed */
    }
    report[2] = 1.0;
    report[3] = stream[INTERVALS];
    shift_path(stream, &l, next, &arrived);
    if (has_limits) {
        shift_limits(stream, &l, own, bend);
    }
#if MODEL_NE > 0
    status = step_motion(stream, &l);
#endif
    if (status == MODEL_OK) {
        status = arm_in_window(stream, &l, &out, &worst);
    }
    if (status == MODEL_OK) {
        status = motors_in_interval(stream, &l, &out, &step);
    }
    if (status != MODEL_OK) {
        return over(stream, status);
    }
    report[0] = worst;
    report[1] = fmax_1(unevenness_now(stream, &l), torn * step);
    report[4] = 0.0;
    report[5] = 0.0;
    if (has_limits) {
        int ends;
        limited = is_limited(stream, &l, v_m, tau_m, report + 4, &ends);
        status = ends ? MODEL_LIMITS_LOST : look_ahead(stream, &l);
        if (status != MODEL_OK) {
            return over(stream, status);
        }
    }
    report[6] = limited;
    if (!(worst <= stream[TOLERANCE] && report[1] <= uneven)) {
        return MODEL_INEXACT;
    }
    return limited ? MODEL_LIMITED : MODEL_OK;
}
