/* model: inverse dynamics on a moving horizon. Written by flexgen; see model_inversion.h. */
#include "model_inversion.h"

#include "model_reduced_problem.h"
#include "model_stream_update.h"

/*
 * --- The start of a stream in motion, from samples of the path before now and ahead.
 *
 * The first state of the horizon is not known. In stable directions it is the quasi-static motion
 * of the past: what the zero dynamics remembers of older motion has decayed. In unstable
 * directions it follows from the path ahead, where the cost to go P, p of the first node is least,
 *
 *     min over d   d' P d / 2 + p' d + w |y_0 + d - y_quasi-static|^2 / 2
 *
 * with a weight w far above the cost of stable directions and far below that of unstable ones.
 */

/*
 * Path nodes before now, as far back as the differences of any stream; updates whose results are
 * not given.
 */
enum { PAST_NODES = 7, SILENT_UPDATES = MODEL_STREAM_START_SAMPLES(0) - 1 - PAST_NODES };

/* Copy sample k of a path. */
static inline void sample_of(const model_samples *p, ptrdiff_t k, real *out)
{
    copy(p->y + k * NT, NT, out);
    copy(p->dy + k * NY, NY, out + NT);
    copy(p->ddy + k * NY, NY, out + NT + NY);
#if MODEL_FORCE
    for (int i = 0; i < FORCES; ++i) {
        out[NT + 2 * NY + i] = p->force == NULL ? 0.0 : p->force[k * FORCES + i];
    }
#endif /* MODEL_FORCE */
}

/* The path of the horizon and before it: node 0 of the horizon is sample `now`. */
static inline void set_path(real *s, const layout *l, const model_samples *p, ptrdiff_t now)
{
    const ptrdiff_t N = head_in(s)->intervals;
    real *nodes = s + l->nodes;
    for (ptrdiff_t j = 0; j <= l->past + N; ++j) {
        sample_of(p, now - l->past + j, nodes + j * REFERENCE);
    }
    for (ptrdiff_t k = 0; k < N * STAGES; ++k) {
        const real *left = nodes + (l->past + k / STAGES) * REFERENCE;
        between_samples(
            left, head_in(s)->period, gauss_c[k % STAGES], s + l->reference + k * REFERENCE);
    }
    copy(nodes + (l->past + N) * REFERENCE, REFERENCE, s + l->last);
}

/*
 * Joints that follow the path of the horizon from those at its start, with the deflections of the
 * equilibrium q.
 */
static inline int set_joints(real *s, const layout *l, const real *q)
{
    const ptrdiff_t N = head_in(s)->intervals;
    real *q_g = s + l->q_g, last[NG];
    problem_points *arm = arm_of(l, s);
#if MODEL_NE > 0
    static const real zero[NE] = {0.0};
    real q_e[NE];
    for (int i = 0; i < NE; ++i) {
        q_e[i] = q[i_e[i]];
    }
#endif
    for (int i = 0; i < NG; ++i) {
        q_g[N * STAGES * NG + i] = last[i] = q[i_g[i]];
    }
    begin_points(arm);
    /* one after the other: each is the guess of the next */
    for (ptrdiff_t k = 0; k < N * STAGES; ++k) {
        int status;
        for (int point = 0; point < POINTS; ++point) {
            load_reference(arm, point, s + l->reference + k * REFERENCE);
            load_joints(arm, point, last);
#if MODEL_NE > 0
            load_elastic(arm, point, q_e, zero, zero);
#endif
        }
        status = solve_kinematics(arm, s + l->space);
        if (status != MODEL_OK) {
            return status;
        }
        if (!(arm->side[0] * (k > 0 ? (real)head_in(s)->side : arm->side[0]) > 0.0)) {
            return MODEL_UNREACHABLE; /* it passed a singular pose */
        }
        head_of(s)->side = arm->side[0] > 0.0 ? 1 : -1;
        for (int i = 0; i < NG; ++i) {
            q_g[k * NG + i] = last[i] = arm->q[i_g[i]][0];
        }
    }
    return MODEL_OK;
}

#if MODEL_NE > 0

/* Gauss-Newton steps; the problem is almost linear in the deflections */
enum { MOVING_STEPS = 6 };

static const real first_state_weight = PRECISE(1e-6, 1e-3);

/* The quasi-static motion at all nodes as target states, and a motion close to it in the mesh. */
static inline int set_quasistatic(real *s, const layout *l)
{
    const ptrdiff_t N = head_in(s)->intervals, guess_at = (N * STAGES - 1) * NG;
    mesh m = mesh_of(l, s);
    real last[NG], *y = s + l->y, *a = s + l->a, *newest = m.target_state + N * STATES;
    copy(s + l->q_g + guess_at, NG, last);
    /* the first one twice: Newton's method converges */
    for (ptrdiff_t j = LAST - 1; j <= l->past + N; ++j) {
        for (int again = j == LAST - 1 ? 2 : 1; again > 0; --again) {
            const ptrdiff_t k = j < l->past ? 0 : j - l->past < N ? j - l->past : N - 1;
            int status;
            copy(s + l->q_g + k * STAGES * NG, NG, s + l->q_g + guess_at);
            status = quasistatic_motion(&m, (lq_space *)(void *)(s + l->lq), s + l->levels,
                s + l->nodes + j * REFERENCE, s + l->space);
            if (status != MODEL_OK) {
                return status;
            }
        }
        copy(newest, STATES, y + j * STATES);
        if (j >= l->past) {
            copy(newest, STATES, m.target_state + (j - l->past) * STATES);
        }
    }
    copy(last, NG, s + l->q_g + guess_at);
    for (ptrdiff_t j = 0; j < LAST - 1; ++j) {
        copy(y + (LAST - 1) * STATES, STATES, y + j * STATES);
    }
    for (ptrdiff_t j = 0; j < l->past + N; ++j) {
        for (int i = 0; i < CONTROLS; ++i) {
            const real *speed = y + j * STATES + NE + i % NE;
            a[j * CONTROLS + i] = (speed[STATES] - speed[0]) / m.h;
        }
    }
    for (ptrdiff_t k = 0; k < N; ++k) {
        next_node(m.y + k * STATES, m.a + k * CONTROLS, m.h, m.y + (k + 1) * STATES);
    }
    return MODEL_OK;
}

/* The best change of the first state, scaled, from its cost to go. */
static inline int first_state(const mesh *m, const lq_space *w, real d[STATES])
{
    real M[STATES][STATES + 1]; /* and the right side */
    for (int i = 0; i < STATES; ++i) {
        for (int j = 0; j < STATES; ++j) {
            M[i][j] = w->P[i * STATES + j];
        }
        M[i][i] += first_state_weight;
        M[i][STATES] = -w->p[i] - first_state_weight * target_distance(m, 0, i);
    }
    if (!solve_plain(&M[0][0], STATES, STATES + 1)) { /* positive definite */
        return MODEL_NOT_CONVERGED;
    }
    for (int i = 0; i < STATES; ++i) {
        d[i] = M[i][STATES];
    }
    return is_finite(d, STATES) ? MODEL_OK : MODEL_NOT_CONVERGED;
}

/* The motion of the horizon from its quasi-static motion. */
static inline int solve_horizon(real *s, const layout *l)
{
    mesh m = mesh_of(l, s);
    lq_space *w = (lq_space *)(void *)(s + l->lq);
    int status = MODEL_OK;
    for (int step = 0; step < MOVING_STEPS && status == MODEL_OK; ++step) {
        real d[STATES];
        status = lq_factor(&m, w, s + l->space);
        if (status == MODEL_OK) {
            status = first_state(&m, w, d);
        }
        if (status == MODEL_OK) {
            lq_step(&m, d);
        }
    }
    copy(w->P, STATES * STATES, s + l->cost);
    head_of(s)->stale = 1; /* only the factors are known */
    return status;
}

#endif

/* The arm's coordinates at the equilibrium at which a stream was started. */
static inline void joints_at_start(const real *s, const layout *l, real q[NA])
{
    for (int i = 0; i < NG; ++i) {
        q[i_g[i]] = s[l->q_g + i];
    }
#if MODEL_NE > 0
    for (int i = 0; i < NE; ++i) {
        q[i_e[i]] = s[l->y + i];
    }
#endif
}

/* The stream, at equilibrium now, is on the path instead. */
static inline int set_moving(
    real *s, const layout *l, const model_samples *p, ptrdiff_t now, const real *q)
{
    int status;
    set_path(s, l, p, now);
    status = set_joints(s, l, q);
#if MODEL_NE > 0
    if (status == MODEL_OK) {
        status = set_quasistatic(s, l);
    }
    if (status == MODEL_OK) {
        status = solve_horizon(s, l);
    }
#endif
    return status;
}

/*
 * --- The parts of an update, one after the other.
 *
 * An update that has begun may be interrupted after each part: all that the next part needs is in
 * the memory of the stream. The results do not depend on where it was interrupted.
 */

/*
 * Kinds of parts, in their order. PART_RESIDUAL: for each POINTS Gauss points; PART_POINTS: for
 * each GROUP intervals whose factors are computed again, then PART_FACTOR for each of them.
 */
enum {
    NO_UPDATE,
#if MODEL_NE > 0
    PART_SHIFT,
    PART_RESIDUAL,
    PART_POINTS,
    PART_FACTOR,
    PART_LINEAR,
    PART_STEP,
#endif
    PART_ARM,
    PART_MOTORS,
    PART_LIMITS,
    PARTS_END
};

/*
 * The part that is next. at: Gauss point, or intervals before those of the group; within: interval
 * in the group.
 */
typedef struct {
    int part, at, within;
} update_part;

static inline update_part next_part_of(const real *s)
{
    const stream_head *h = head_in(s);
    const update_part p = {h->part, h->at, h->within};
    return p;
}

#if MODEL_NE > 0
/* Intervals of the group from `next` on; `*next` becomes that after it. */
static inline int group_from(const real *s, int *next, int *list)
{
    return refreshed(head_in(s)->intervals, head_in(s)->stale, next, list);
}
#endif

/*
 * Approximate cost of a part: microseconds with 6 motors and 12 coordinates without motor on a
 * processor with vectors of 8 numbers. Only the distribution of the work depends on it.
 */
static inline int cost_of_part(const real *s, update_part p)
{
    static const int cost[PARTS_END] = {0,
#if MODEL_NE > 0
        47, 4, 5, 7, 15, 15,
#endif
        20, 5, 60};
#if MODEL_NE > 0
    if (p.part == PART_POINTS) { /* for each interval */
        int list[GROUP], next = p.at;
        return cost[p.part] * group_from(s, &next, list);
    }
#endif
    return p.part == PART_LIMITS && !head_in(s)->has_limits ? 0 : cost[p.part];
}

/* The part after p. */
static inline update_part part_after(const real *s, update_part p)
{
#if MODEL_NE > 0
    if (p.part == PART_RESIDUAL && p.at + POINTS < head_in(s)->intervals * STAGES) {
        p.at += POINTS;
        return p;
    }
    if (p.part == PART_FACTOR) {
        int list[GROUP], next = p.at;
        const int count = group_from(s, &next, list);
        if (p.within + 1 < count) {
            p.within += 1;
            return p;
        }
        if (count == GROUP && next < head_in(s)->intervals) {
            p.part = PART_POINTS;
            p.at = next;
            p.within = 0;
            return p;
        }
    }
#else
    (void)s;
#endif
    p.part += 1;
    if (p.part != PARTS_END
#if MODEL_NE > 0
        && p.part != PART_FACTOR
#endif
    ) {
        p.at = p.within = 0;
    }
    return p;
}

/* Cost of all parts from p to the end of the update. */
static inline int cost_from(const real *s, update_part p)
{
    int cost = 0;
    for (; p.part != PARTS_END; p = part_after(s, p)) {
        cost += cost_of_part(s, p);
    }
    return cost;
}

/* Arrays of the results in the memory of the stream. */
static inline interval_results results_in(real *s, const layout *l)
{
    const ptrdiff_t n = head_in(s)->samples_per_interval;
    interval_results out;
    out.q_a = s + l->output;
    out.v_a = out.q_a + n * NA;
    out.tau_g = out.v_a + n * NA;
    out.q_m = out.tau_g + n * NG;
    out.v_m = out.q_m + n * NM;
    out.tau_m = out.v_m + n * NM;
#if MODEL_POSITION
    out.command_m = s + l->command;
    out.command_g = out.command_m + n * NM;
#endif /* MODEL_POSITION */
    return out;
}

/* Limits of the motors: what they do now, and the change of the path ahead. */
static inline int limits_part(real *s, const layout *l, const interval_results *out)
{
    real off[2] = {0.0, 0.0};
    int ends;
    if (!head_in(s)->has_limits) {
        return MODEL_OK;
    }
    head_of(s)->limited = is_limited(s, l, out->v_m, out->tau_m, off, &ends);
    copy(off, 2, head_of(s)->off);
    return ends ? MODEL_LIMITS_INFEASIBLE : apply_limits(s, l);
}

/* Motors in the interval. */
static inline int motors_part(real *s, const layout *l, const interval_results *out)
{
    real step = 0.0, output_step[2] = {0.0, 0.0};
    const int status = motors_in_interval(s, l, out, &step, output_step);
    if (status == MODEL_OK) {
        head_of(s)->torque_step = step;
        copy(output_step, 2, head_of(s)->output_step);
        head_of(s)->mismatch = kinematic_mismatch_now(s, l);
    }
    return status;
}

/* Do the part p. */
static inline int do_part(real *s, const layout *l, update_part p)
{
    const interval_results out = results_in(s, l);
    switch (p.part) {
#if MODEL_NE > 0
    case PART_SHIFT:
        return shift_motion(s, l);
    case PART_RESIDUAL:
        return residual_part(s, l, p.at);
    case PART_POINTS:
    case PART_FACTOR: {
        int list[GROUP], next = p.at;
        const int count = group_from(s, &next, list);
        if (p.part == PART_FACTOR) {
            return refresh_factor(s, l, list[p.within]);
        }
        if (p.at == 0) {
            begin_points(arm_of(l, s));
        }
        return refresh_points(s, l, list, count);
    }
    case PART_LINEAR:
        return linear_part(s, l);
    case PART_STEP:
        step_part(s, l);
        return MODEL_OK;
#endif
    case PART_ARM:
        return arm_in_window(s, l, &out, &head_of(s)->residual);
    case PART_MOTORS:
        return motors_part(s, l, &out);
    default:
        return limits_part(s, l, &out);
    }
}

/* Do about 1/parts of the remaining update; all of it where parts is 1. */
static inline int do_parts(real *s, const layout *l, int parts)
{
    update_part p = next_part_of(s);
    const int share = parts > 1 ? cost_from(s, p) / parts : 0;
    int done = 0, status = MODEL_OK;
    while (status == MODEL_OK && p.part != PARTS_END &&
           (parts == 1 || done == 0 || 2 * done + cost_of_part(s, p) <= 2 * share)) {
        status = do_part(s, l, p);
        done += cost_of_part(s, p);
        p = part_after(s, p);
        head_of(s)->part = p.part;
        head_of(s)->at = p.at;
        head_of(s)->within = p.within;
    }
    return status;
}

/* --- The functions of a stream. */

/* The memory of a stream of the caller; a null pointer where there is none. */
static real *memory_of(const model_stream *stream)
{
    return stream == NULL ? NULL : stream->memory;
}

/*
 * Layout of a stream that was started and has not failed; a status where its memory holds none, or
 * not all of it.
 */
static model_status find_layout(const model_stream *given, layout *l)
{
    if (given->size < HEAD) {
        return MODEL_WORK_TOO_SMALL;
    }
    if (!is_running(given->memory)) {
        return MODEL_NOT_STARTED;
    }
    *l = layout_of(given->memory);
    return given->size < l->end ? MODEL_WORK_TOO_SMALL : MODEL_OK;
}

/* sweeps after which the cost of an endless equilibrium has converged */
enum { SETTLING_SWEEPS = 10 };
#if MODEL_NE > 0
static const real initial_weight = 1e-4; /* before the first of them */
#endif

int64_t model_stream_work(const model_stream_options *options)
{
    return options != NULL && stream_sizes_fit(options) ?
               (int64_t)laid_out(options->intervals, options->samples_per_interval,
                   (int)options->hold, options->delay)
                   .end :
               -1;
}

/* Deflections of the gears at the equilibrium q. */
#if MODEL_FORCE
static int deflection_at_equilibrium(
    const real *target, const real *q, real *deflection, real *space)
#else  /* MODEL_FORCE */
static int deflection_at_equilibrium(const real *q, real *deflection, real *space)
#endif /* MODEL_FORCE */
{
    static const real zero[NA] = {0.0};
    real tau[NG], stiffness[NG];
#if MODEL_FORCE
    real error[NY], W[NA * NY], bias[NY];
#endif /* MODEL_FORCE */
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
#if MODEL_FORCE
    status = inner_status(evaluate_output_constraint(q, zero, target, error, W, bias, space));
    if (status != MODEL_OK) {
        return status;
    }
    for (int i = 0; i < NG; ++i) {
        for (int j = 0; j < NY; ++j) {
            tau[i] -= W[i_g[i] * NY + j] * FORCE_OF(space)[j];
        }
    }
#endif /* MODEL_FORCE */
    return static_deflections(tau, 1, zero, deflection, stiffness, space) ?
               MODEL_OK :
               MODEL_RESULT_NOT_FINITE;
}

/*
 * The whole horizon and the past are at the equilibrium with the output at its target; q: a guess,
 * and it.
 */
static int set_equilibrium(real *s, const layout *l, const real *target, real *q)
{
    const ptrdiff_t N = head_in(s)->intervals;
    real *equilibrium = s + l->last;
#if MODEL_NE > 0
    int status = equilibrium_at(target, q, s + l->scale, s + l->space);
#else
    int status = equilibrium_at(target, q, NULL, s + l->space);
#endif
    if (status != MODEL_OK) {
        return status;
    }
    head_of(s)->base = 0;
    head_of(s)->stale = 1;
    head_of(s)->is_predicted = 0;
    copy(target, NT, equilibrium);
    for (int i = NT; i < REFERENCE; ++i) {
        equilibrium[i] = 0.0;
    }
#if MODEL_FORCE
    copy(FORCE_OF(s + l->space), FORCES, equilibrium + NT + 2 * NY);
#endif /* MODEL_FORCE */
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
    {
        mesh hold = mesh_of(l, s);
        int is_exact = 0;
        status = lq_stationary_cost(&hold, hold.N, SETTLING_SWEEPS, initial_weight, 0.0,
            (lq_space *)(void *)(s + l->lq), s + l->space, s + l->cost, &is_exact);
        for (ptrdiff_t k = 1; k < hold.N; ++k) { /* all intervals are like the first one */
            copy(hold.factor, CONTROLS * WIDTH, hold.factor + k * CONTROLS * WIDTH);
        }
    }
#endif
    if (status != MODEL_OK) {
        return status;
    }
#if MODEL_FORCE
    status = deflection_at_equilibrium(target, q, s + l->now, s + l->space);
#else  /* MODEL_FORCE */
    status = deflection_at_equilibrium(q, s + l->now, s + l->space);
#endif /* MODEL_FORCE */
#if MODEL_HYSTERESIS
    if (status == MODEL_OK) {
        branches b;
        status = begin_branches(&b, head_in(s)->period, s + l->now, s + l->space) ?
                     MODEL_OK :
                     MODEL_RESULT_NOT_FINITE;
        keep_branches(&b, s + l->now);
    }
#endif /* MODEL_HYSTERESIS */
    return status;
}

COLD model_status model_stream_start(const model_stream *given,
    const model_stream_options *options, const real y[MODEL_NT],
    PARAMETERS_ARGUMENT const real q_start[MODEL_NA])
{
    real *stream = given == NULL ? NULL : given->memory;
    const real *parameters_given = GIVEN_PARAMETERS;
    layout l;
    real q[NA], *space;
    stream_head *head;
    int status;
    if (stream == NULL || options == NULL || y == NULL || parameters_given == NULL ||
        q_start == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!stream_sizes_fit(options) || !(options->period > 0.0 && options->period < 1e6) ||
        !(options->tolerance > 0.0 && options->tolerance < 1.0)) {
        return MODEL_BAD_ARGUMENT;
    }
#if MODEL_POSITION
    if (options->servo != NULL && !has_gains(options->servo)) {
        return MODEL_NULL_ARGUMENT;
    }
    if (options->servo != NULL &&
        !servo_fits(options->servo, options->period / (real)options->samples_per_interval,
            (int)options->hold, options->delay)) {
        return MODEL_BAD_ARGUMENT;
    }
#endif /* MODEL_POSITION */
    l = laid_out(
        options->intervals, options->samples_per_interval, (int)options->hold, options->delay);
    if (given->size < l.end) {
        return MODEL_WORK_TOO_SMALL;
    }
    head = head_of(stream);
    head->state = IS_EMPTY;
    if (!is_finite(y, NT) || !is_finite(parameters_given, PARAMETERS) || !is_finite(q_start, NA)) {
        return MODEL_INPUT_NOT_FINITE;
    }
#if MODEL_FORCE
    if (options->force != NULL && !is_finite(options->force, NY)) {
        return MODEL_INPUT_NOT_FINITE;
    }
#endif /* MODEL_FORCE */
#if MODEL_POSE
    if (!is_rotation(y + PLACES)) {
        return MODEL_BAD_ARGUMENT;
    }
#endif
    space = stream + l.space;
    keep_parameters(parameters_given, space);
#if MODEL_FORCE
    set_zero(FORCE_OF(space), FORCES);
    if (options->force != NULL) {
        copy(options->force, NY, FORCE_OF(space));
    }
#endif /* MODEL_FORCE */
    copy(q_start, NA, q);
    head->key = STREAM_KEY;
    head->intervals = options->intervals;
    head->samples_per_interval = options->samples_per_interval;
    head->period = options->period;
    head->tolerance = options->tolerance;
    head->hold = (int32_t)options->hold;
    head->delay = options->delay;
    head->part = NO_UPDATE;
    head->side = 0;
    head->has_limits = 0;
#if MODEL_POSITION
    head->has_servo = options->servo != NULL;
    if (options->servo != NULL) {
        keep_servo(options->servo, stream + l.servo);
    }
#endif /* MODEL_POSITION */
    for (int i = 0; i < MEASURES + NM; ++i) {
        stream[l.most + i] = 0.0;
    }
#if MODEL_COUPLED
    set_zero(stream + l.coupled, l.window * NG);
#endif /* MODEL_COUPLED */
    status = set_equilibrium(stream, &l, y, q);
#if MODEL_LUGRE
    for (int i = 0; i < BRISTLES + PAST_IMPULSES; ++i) {
        stream[l.bristles + i] = 0.0;
    }
#endif /* MODEL_LUGRE */
    if (status == MODEL_OK) {
        head->state = IS_RUNNING;
    }
    return (model_status)status;
}

/* Whether an update has begun and not ended. */
static int has_begun(const real *stream)
{
    return head_in(stream)->part > NO_UPDATE;
}

#if MODEL_PARAMETERS > 0
/* Whether path, force and arm rest in the past and in the whole horizon. */
static int rests(const real *s, const layout *l)
{
    const ptrdiff_t last = l->past + (ptrdiff_t)head_in(s)->intervals;
    for (ptrdiff_t k = 0; k <= last; ++k) {
        const real *node = s + l->nodes + k * REFERENCE, *end = s + l->nodes + last * REFERENCE;
        for (int i = 0; i < REFERENCE; ++i) {
            const int rate = (i >= NT && i < NT + 2 * NY) || i >= NT + 3 * NY;
            if (!(fabs_1(node[i] - (rate ? 0.0 : end[i])) <=
                    (rate ? negligible_motion / head_in(s)->period : negligible_motion))) {
                return 0;
            }
        }
#if MODEL_NE > 0
        for (int i = 0; i < NE; ++i) {
            const real *y = s + l->y + k * STATES, *still = s + l->y + last * STATES;
            if (!(fabs_1(y[i] - still[i]) <= negligible_motion &&
                    fabs_1(y[NE + i]) * head_in(s)->period <= negligible_motion)) {
                return 0;
            }
        }
#endif
    }
    return 1;
}

/* The stream, which rests, in the equilibrium with its parameters. */
static int rest_again(real *s, const layout *l)
{
    real target[NT], q[NA];
    int status;
#if MODEL_FORCE
    real next[FORCES], *space = s + l->space;
    copy(FORCE_OF(space), FORCES, next);
    copy(s + l->last + NT + 2 * NY, FORCES, FORCE_OF(space));
#endif /* MODEL_FORCE */
    copy(s + l->last, NT, target);
    joints_at_start(s, l, q);
    status = set_equilibrium(s, l, target, q);
#if MODEL_FORCE
    copy(next, FORCES, FORCE_OF(space));
#endif /* MODEL_FORCE */
    return status;
}

COLD model_status model_stream_parameters(
    const model_stream *given, const real parameters[MODEL_PARAMETERS])
{
    real *stream = memory_of(given);
    layout l;
    model_status status;
    if (stream == NULL || parameters == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != MODEL_OK) {
        return status;
    }
    if (has_begun(stream)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (!is_finite(parameters, PARAMETERS)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    head_of(stream)->stale = 1;
    keep_parameters(parameters, stream + l.space);
    if (rests(stream, &l)) {
        status = (model_status)rest_again(stream, &l);
        if (status != MODEL_OK) {
            head_of(stream)->state = HAS_FAILED;
            return status == MODEL_UNREACHABLE ? MODEL_NOT_CONVERGED : status;
        }
    }
#if MODEL_HARMONICS
    if (head_in(stream)->has_limits) {
        const limits_layout w = limits_laid_out(head_in(stream)->intervals);
        return find_swings(stream + l.limits + w.swing, stream + l.space) ?
                   MODEL_OK :
                   MODEL_RESULT_NOT_FINITE;
    }
#endif /* MODEL_HARMONICS */
    return MODEL_OK;
}
#endif

#if MODEL_FORCE
model_status model_stream_force(const model_stream *given, const real *force)
{
    real *stream = memory_of(given);
    layout l;
    model_status status;
    if (stream == NULL || force == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != MODEL_OK) {
        return status;
    }
    if (!is_finite(force, FORCES)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    copy(force, FORCES, FORCE_OF(stream + l.space));
    return MODEL_OK;
}

#endif /* MODEL_FORCE */
COLD model_status model_stream_limits(const model_stream *given, const real torque_max[MODEL_NM],
    const real speed_max[MODEL_NM], real deviation_max)
{
    real *stream = memory_of(given);
    layout l;
    limits_layout w;
    real *bound;
    model_status status;
    if (stream == NULL || torque_max == NULL || speed_max == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != MODEL_OK) {
        return status;
    }
    if (has_begun(stream) || !(deviation_max > 0.0 && deviation_max < 1e6)) {
        return MODEL_BAD_ARGUMENT;
    }
    for (int i = 0; i < NM; ++i) {
        if (!(torque_max[i] > 0.0 && speed_max[i] > 0.0)) {
            return MODEL_BAD_ARGUMENT;
        }
    }
    w = limits_laid_out(head_in(stream)->intervals);
    if (!head_in(stream)->has_limits && !start_limits(stream, &l)) {
        return MODEL_HORIZON_TOO_SHORT;
    }
#if MODEL_HARMONICS
    if (!find_swings(stream + l.limits + w.swing, stream + l.space)) {
        return MODEL_RESULT_NOT_FINITE;
    }
#endif /* MODEL_HARMONICS */
    bound = stream + l.limits + w.bound;
    copy(torque_max, NM, bound);
    copy(speed_max, NM, bound + NM);
#if MODEL_BOUNDS
    for (int i = 2 * NM; i < MOTORS; ++i) {
        bound[i] = (real)INFINITY;
    }
    for (int i = 0; i < NM * EDGES; ++i) {
        stream[l.limits + w.curve + 2 * i] = (real)INFINITY;
        stream[l.limits + w.curve + 2 * i + 1] = 0.0;
    }
#endif /* MODEL_BOUNDS */
    for (int i = 0; i < NY; ++i) {
        bound[MOTORS + i] = deviation_max;
    }
    return MODEL_OK;
}
#if MODEL_BOUNDS

/* Limits that are given, or none. */
static void set_bounds(const real *given, int size, real *bound)
{
    for (int i = 0; i < size; ++i) {
        bound[i] = given == NULL ? (real)INFINITY : given[i];
    }
}

COLD model_status model_stream_all_limits(
    const model_stream *given, const model_inversion_limits *limits, real deviation_max)
{
    real torque[NM], speed[NM], *b;
    model_status status;
    limits_layout w;
    if (given == NULL || limits == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if ((limits->torque_speed != NULL && limits->torque_speed_points - 1 > EDGES) ||
        !are_in_range(limits)) {
        return MODEL_BAD_ARGUMENT;
    }
    set_bounds(limits->torque_max, NM, torque);
    set_bounds(limits->speed_max, NM, speed);
    for (int i = 0; i < NM && limits->torque_speed != NULL; ++i) {
        const ptrdiff_t count = limits->torque_speed_points;
        /* the end of the curve */
        speed[i] = fmin_1(speed[i], limits->torque_speed[((i + 1) * count - 1) * 2]);
    }
    status = model_stream_limits(given, torque, speed, deviation_max);
    if (status != MODEL_OK) {
        return status;
    }
    w = limits_laid_out(head_in(given->memory)->intervals);
    {
        const layout l = layout_of(given->memory);
        b = given->memory + l.limits;
    }
    set_bounds(limits->torque_rate_max, NM, b + w.bound + RATE_ROWS);
    set_bounds(limits->gear_torque_max, NG, b + w.bound + GEAR_ROWS);
    set_bounds(limits->deflection_max, NE, b + w.bound + ELASTIC_ROWS);
    set_bounds(limits->joint_speed_max, NG, b + w.bound + JOINT_ROWS);
    set_bounds(limits->joint_acceleration_max, NG, b + w.bound + JOINT_ROWS + NG);
    b[w.bound + TOOL_ROWS] = limits->tool_speed_max > 0.0 ? limits->tool_speed_max :
                                                            (real)INFINITY;
    b[w.bound + TOOL_ROWS + 1] = limits->tool_acceleration_max > 0.0 ?
                                     limits->tool_acceleration_max :
                                     (real)INFINITY;
    for (int i = 0; i < NM && limits->torque_speed != NULL; ++i) {
        for (int e = 0; e < limits->torque_speed_points - 1; ++e) {
            real *curve = b + w.curve + 2 * (i * EDGES + e);
            curve[0] = edge_of_curve(limits, i, e, curve + 1);
        }
    }
    return MODEL_OK;
}
#endif /* MODEL_BOUNDS */

/*
 * Status of an update that fails after its sample was taken; UNREACHABLE would mean that the
 * sample was refused.
 */
static model_status failed(real *stream, int status)
{
    head_of(stream)->state = HAS_FAILED;
    return status == MODEL_UNREACHABLE ? MODEL_NOT_CONVERGED : (model_status)status;
}

/* The first part of an update comes next; it has no results. */
static void begin_results(stream_head *head)
{
    head->residual = head->mismatch = head->torque_step = 0.0;
    set_zero(head->output_step, 2);
    set_zero(head->off, 2);
    head->limited = 0;
    head->part = NO_UPDATE + 1;
    head->at = head->within = 0;
}

model_status model_stream_begin(const model_stream *given, const real y[MODEL_NT],
    const real dy[MODEL_NY], const real ddy[MODEL_NY])
{
    real *stream = memory_of(given);
    layout l;
    real own[REFERENCE], next[REFERENCE], deviation[DEVIATION];
    next_interval arrived;
    int has_limits;
    model_status status;
    if (stream == NULL || y == NULL || dy == NULL || ddy == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != MODEL_OK) {
        return status;
    }
    if (has_begun(stream)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (!is_finite(y, NT) || !is_finite(dy, NY) || !is_finite(ddy, NY)) {
        return MODEL_INPUT_NOT_FINITE;
    }
#if MODEL_POSE
    if (!is_rotation(y + PLACES) || !are_near(stream + l.last + PLACES, y + PLACES)) {
        return MODEL_BAD_ARGUMENT;
    }
#endif
    copy(y, NT, own);
    copy(dy, NY, own + NT);
    copy(ddy, NY, own + NT + NY);
#if MODEL_FORCE
    copy(FORCE_OF(stream + l.space), FORCES, own + NT + 2 * NY);
#endif /* MODEL_FORCE */
    copy(own, REFERENCE, next);
    has_limits = head_in(stream)->has_limits;
    if (has_limits) {
        next_deviation(stream, &l, own, deviation, next);
    }
    status = (model_status)reach_next_sample(stream, &l, next, &arrived);
    if (status != MODEL_OK) {
        return status; /* the sample is refused, and nothing has changed */
    }
    shift_path(stream, &l, next, &arrived);
    if (has_limits) {
        shift_limits(stream, &l, own, deviation);
    }
    begin_results(head_of(stream));
    return MODEL_OK;
}

model_status model_stream_advance(const model_stream *given, int parts)
{
    real *stream = memory_of(given);
    layout l;
    model_status status;
    if (stream == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != MODEL_OK) {
        return status;
    }
    if (!has_begun(stream)) {
        return MODEL_NOT_STARTED;
    }
    if (parts < 1) {
        return MODEL_BAD_ARGUMENT;
    }
    status = (model_status)do_parts(stream, &l, parts);
    return status == MODEL_OK ? MODEL_OK : failed(stream, status);
}

/* Copy results where the caller wants them. */
static void give(const real *from, ptrdiff_t size, real *to)
{
    if (to != NULL) {
        copy(from, size, to);
    }
}

model_status model_stream_finish(
    const model_stream *given, model_motion *motion, model_stream_info *info)
{
    real *stream = memory_of(given);
    layout l;
    interval_results out;
    stream_head *head;
    ptrdiff_t n;
    model_status status;
    if (stream == NULL || motion == NULL || info == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != MODEL_OK) {
        return status;
    }
    if (!has_begun(stream)) {
        return MODEL_NOT_STARTED;
    }
    status = (model_status)do_parts(stream, &l, 1);
    if (status != MODEL_OK) {
        return failed(stream, status);
    }
    n = head_in(stream)->samples_per_interval;
    out = results_in(stream, &l);
    give(out.q_a, n * NA, motion->q_a);
    give(out.v_a, n * NA, motion->v_a);
    give(out.tau_g, n * NG, motion->tau_g);
    give(out.q_m, n * NM, motion->q_m);
    give(out.v_m, n * NM, motion->v_m);
    give(out.tau_m, n * NM, motion->tau_m);
#if MODEL_POSITION
    give(out.command_m, n * NM, motion->command_m);
    give(out.command_g, n * NG, motion->command_g);
#endif /* MODEL_POSITION */
    head = head_of(stream);
    head->part = NO_UPDATE;
    info->residual = head->residual;
    info->kinematic_mismatch = head->mismatch;
    info->torque_step = head->torque_step;
    info->output_step_m = head->output_step[0];
    info->output_step_rad = head->output_step[1];
    info->deviation_m = head->off[0];
    info->deviation_rad = head->off[1];
    info->limits_active = head->limited;
    /* one cause: a short horizon makes the residual large too */
    info->cause = MODEL_CAUSE_NONE;
    if (!(info->torque_step <= torque_step_max)) {
        info->cause = MODEL_CAUSE_TORQUE_STEP;
    } else if (!(info->residual <= head->tolerance)) {
        info->cause = MODEL_CAUSE_RESIDUAL;
    } else if (!(info->kinematic_mismatch <= mismatch_max)) {
        info->cause = MODEL_CAUSE_MISMATCH;
    }
    if (info->cause != MODEL_CAUSE_NONE) {
        return MODEL_TOLERANCE_NOT_MET;
    }
    if (!is_finite(&head->residual, 1) || !is_finite(&head->mismatch, 1) ||
        !is_finite(&head->torque_step, 1) || !is_finite(head->output_step, 2) ||
        !is_finite(head->off, 2)) {
        return failed(stream, MODEL_RESULT_NOT_FINITE);
    }
    return info->limits_active ? MODEL_LIMITS_ACTIVE : MODEL_OK;
}

model_status model_stream_update(const model_stream *stream, const real y[MODEL_NT],
    const real dy[MODEL_NY], const real ddy[MODEL_NY], model_motion *motion,
    model_stream_info *info)
{
    model_status status;
    if (motion == NULL || info == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    status = model_stream_begin(stream, y, dy, ddy);
    return status == MODEL_OK ? model_stream_finish(stream, motion, info) : status;
}

/* Whether all samples are finite, and all rotations are rotations and close to each other. */
static model_status check_samples(const model_samples *p)
{
    for (ptrdiff_t k = 0; k < p->n; ++k) {
        if (!is_finite(p->y + k * NT, NT) || !is_finite(p->dy + k * NY, NY) ||
            !is_finite(p->ddy + k * NY, NY)) {
            return MODEL_INPUT_NOT_FINITE;
        }
#if MODEL_FORCE
        if (p->force != NULL && !is_finite(p->force + k * FORCES, FORCES)) {
            return MODEL_INPUT_NOT_FINITE;
        }
#endif /* MODEL_FORCE */
    }
#if MODEL_POSE
    for (ptrdiff_t k = 0; k < p->n; ++k) {
        const real *R = p->y + k * NT + PLACES;
        if (!is_rotation(R) || (k > 0 && !are_near(R - NT, R))) {
            return MODEL_BAD_ARGUMENT;
        }
    }
#endif
    return MODEL_OK;
}

COLD model_status model_stream_start_moving(const model_stream *given,
    const model_stream_options *options, const model_samples *path,
    PARAMETERS_ARGUMENT const real q_start[MODEL_NA])
{
#if MODEL_POSITION
    model_motion none = {NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL, NULL};
#else  /* MODEL_POSITION */
    model_motion none = {NULL, NULL, NULL, NULL, NULL, NULL, NULL};
#endif /* MODEL_POSITION */
    model_stream_info info;
    model_status status;
#if MODEL_FORCE
    model_stream_options at_force;
#endif /* MODEL_FORCE */
    ptrdiff_t now;
    layout l;
    real q[NA], *stream = given == NULL ? NULL : given->memory;
    if (stream == NULL || options == NULL || path == NULL || path->y == NULL || path->dy == NULL ||
        path->ddy == NULL || q_start == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!stream_sizes_fit(options) || path->n != MODEL_STREAM_START_SAMPLES(options->intervals) ||
        !(fabs_1(path->period - options->period) <= 1e-6 * options->period)) {
        return MODEL_BAD_ARGUMENT;
    }
#if MODEL_POSITION
    if (options->servo != NULL) { /* its state is not known */
        return MODEL_BAD_ARGUMENT;
    }
#endif /* MODEL_POSITION */
    status = check_samples(path);
    if (status != MODEL_OK) {
        return status;
    }
    now = path->n - 1 - SILENT_UPDATES - options->intervals;
#if MODEL_FORCE
    at_force = *options;
    at_force.force = path->force == NULL ? NULL : path->force + now * FORCES;
    options = &at_force;
#endif /* MODEL_FORCE */
    status = model_stream_start(given, options, path->y + now * NT, PASSED_PARAMETERS q_start);
    if (status != MODEL_OK) {
        return status;
    }
    l = layout_of(stream);
    joints_at_start(stream, &l, q);
    status = (model_status)set_moving(stream, &l, path, now, q);
    for (ptrdiff_t k = path->n - SILENT_UPDATES; k < path->n && status >= MODEL_OK; ++k) {
#if MODEL_FORCE
        if (path->force != NULL) {
            copy(path->force + k * FORCES, FORCES, FORCE_OF(stream + l.space));
        }
#endif /* MODEL_FORCE */
        status = model_stream_update(
            given, path->y + k * NT, path->dy + k * NY, path->ddy + k * NY, &none, &info);
    }
    if (status < MODEL_OK) {
        head_of(stream)->state = IS_EMPTY;
        return status;
    }
    /* largest values of the first updates are not those of the motion */
    for (int i = 0; i < MEASURES + NM; ++i) {
        stream[l.most + i] = 0.0;
    }
    return MODEL_OK;
}
