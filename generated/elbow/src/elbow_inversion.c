/*
 * elbow: the solvers of inverse dynamics along paths, in one source, so that they share their
 * functions. With -DELBOW_WITHOUT_GROWTH or -DELBOW_WITHOUT_INVERT or -DELBOW_WITHOUT_STREAM it is
 * compiled without this part. Written by flexgen; see elbow_inversion.h.
 */

#ifndef ELBOW_WITHOUT_GROWTH
/* elbow: growth of perturbations along a motion. Written by flexgen; see elbow_inversion.h. */
#include "../elbow_inversion.h"

#include "elbow_inversion_common.h"

/*
 * Under given motor torques a perturbation of the positions p and speeds v, of motors on the arm
 * side, follows
 *
 *     dp/dt = v,    dv/dt = K p + D v,
 *
 * the linearized forward dynamics, constant between two instants of a grid. A step h of the
 * implicit midpoint rule, with the mean speed u, is
 *
 *     (1 - h/2 D - h^2/4 K) u = v + h/2 K p,    p += h u,    v = 2 u - v.
 *
 * It neither excites vibrations nor damps them. Columns of the matrices p and v: perturbations of
 * one position each at the start. Samples at rest at the end are left out, so that the result does
 * not depend on their number; where there are any, the last torque is held for HELD_STEPS of the
 * grid.
 */
enum {
    DOF = ELBOW_NX / 2,
    GROWTH_STEPS = 2,
    GRID_FEWEST = 50,
    GRID_MOST = 1000,
    POWER_STEPS = 12,
    HELD_STEPS = 50
};

static const real grid_step = 1e-2;                 /* s */
static const real slow_share = 1e-4;                /* of the largest speed */
static const real slow_speed = PRECISE(1e-9, 1e-6); /* rad/s or m/s: rounding */
static const real growth_max = PRECISE(1e300, 1e37);

typedef struct {
    real A[ELBOW_NX * ELBOW_NX], B[ELBOW_NX * ELBOW_NM]; /* by columns */
    /* K, then D, by rows, at two instants of the grid */
    real before[2 * DOF * DOF], now[2 * DOF * DOF];
    /* S = (1 - h/2 D - h^2/4 K)^-1 and h/2 S K, behind it */
    real system[3 * DOF * DOF];
    real p[DOF * DOF], v[DOF * DOF]; /* by rows */
} growth_space;

/* K and D at sample k. */
static int growth_matrices(const elbow_motion *motion, ptrdiff_t k, const real *parameters,
    real *to, growth_space *s, real *space)
{
    const int status = evaluate_linearize(motion->q_a + k * NA, motion->v_a + k * NA,
        motion->q_m + k * NM, motion->v_m + k * NM, motion->tau_m + k * NM, s->A, s->B, parameters,
        space);
    for (int part = 0; part < 2; ++part) {
        for (int i = 0; i < DOF; ++i) {
            for (int j = 0; j < DOF; ++j) {
                to[(part * DOF + i) * DOF + j] = s->A[(part * DOF + j) * ELBOW_NX + DOF + i] /
                                                 arm_side[i] * arm_side[j];
            }
        }
    }
    return status;
}

/* The last sample at which the arm moves; the last one of all where it never does. */
static ptrdiff_t last_moving(const real *v_a, ptrdiff_t n)
{
    const real slow = fmax_1(slow_speed, slow_share * largest(v_a, (int)n * NA));
    ptrdiff_t last = n - 1;
    while (last > 0 && largest(v_a + last * NA, NA) <= slow) {
        --last;
    }
    return last > 0 ? last : n - 1;
}

/* Prepare steps of h with the means of K and D of two instants; 0 where they are singular. */
static int growth_system(growth_space *s, real h)
{
    for (int i = 0; i < DOF; ++i) {
        real *row = s->system + i * 3 * DOF;
        for (int j = 0; j < DOF; ++j) {
            const int K = i * DOF + j, D = (DOF + i) * DOF + j;
            const real unit = i == j ? 1.0 : 0.0;
            const real force = 0.25 * h * (s->before[K] + s->now[K]);
            row[j] = unit - 0.5 * h * force - 0.25 * h * (s->before[D] + s->now[D]);
            row[DOF + j] = unit;
            row[2 * DOF + j] = force;
        }
    }
    return solve_plain(s->system, DOF, 3 * DOF);
}

/* A step of h of all perturbations. */
static void growth_step(growth_space *s, real h)
{
    for (int j = 0; j < DOF; ++j) {
        real u[DOF];
        for (int i = 0; i < DOF; ++i) {
            const real *row = s->system + i * 3 * DOF + DOF;
            real sum = 0.0;
            for (int k = 0; k < DOF; ++k) {
                sum += row[k] * s->v[k * DOF + j] + row[DOF + k] * s->p[k * DOF + j];
            }
            u[i] = sum;
        }
        for (int i = 0; i < DOF; ++i) {
            s->p[i * DOF + j] += h * u[i];
            s->v[i * DOF + j] = 2.0 * u[i] - s->v[i * DOF + j];
        }
    }
}

/* The largest singular value of p, by the power method from its largest row. */
static real growth_norm(const real *p)
{
    real x[DOF], y[DOF], norm = 0.0;
    int at = 0;
    real most = -1.0;
    for (int i = 0; i < DOF; ++i) {
        real sum = 0.0;
        for (int j = 0; j < DOF; ++j) {
            sum += p[i * DOF + j] * p[i * DOF + j];
        }
        at = sum > most ? i : at;
        most = fmax_1(most, sum);
    }
    copy(p + at * DOF, DOF, x);
    for (int step = 0; step < POWER_STEPS; ++step) {
        real before = 0.0, after = 0.0;
        for (int i = 0; i < DOF; ++i) {
            y[i] = 0.0;
            for (int j = 0; j < DOF; ++j) {
                y[i] += p[i * DOF + j] * x[j];
            }
            before += x[i] * x[i];
            after += y[i] * y[i];
        }
        norm = before > 0.0 ? square_root(after / before) : 0.0;
        for (int j = 0; j < DOF; ++j) {
            x[j] = 0.0;
            for (int i = 0; i < DOF; ++i) {
                x[j] += p[i * DOF + j] * (norm > 0.0 ? y[i] / norm : 0.0);
            }
        }
        most = largest(x, DOF);
        for (int j = 0; j < DOF; ++j) {
            x[j] = most > 0.0 ? x[j] / most : 0.0;
        }
    }
    return norm;
}

int64_t elbow_growth_work(void)
{
    return padded((int64_t)(sizeof(growth_space) / sizeof(real))) + ELBOW_LINEARIZE_SPACE + BLOCK;
}

elbow_status elbow_growth(const elbow_motion *motion, int n, real period,
    PARAMETERS_ARGUMENT real *growth, real *work, int64_t work_size)
{
    growth_space *s = (growth_space *)(void *)work;
    const real *values = GIVEN_PARAMETERS;
    real *space, size = 1.0, found = 1.0;
    ptrdiff_t at = 0, last;
    int count, steps, status;
    if (growth == NULL || work == NULL || values == NULL || !has_state_and_torques(motion)) {
        return ELBOW_NULL_ARGUMENT;
    }
    growth[0] = (real)NAN;
    if (work_size < elbow_growth_work()) {
        return ELBOW_WORK_TOO_SMALL;
    }
    if (n < 2 || !(period > 0.0 && (real)n * period < 1e9)) {
        return ELBOW_BAD_ARGUMENT;
    }
    space = work + padded((int64_t)(sizeof(growth_space) / sizeof(real)));
    last = last_moving(motion->v_a, n);
    count = (real)last * period < grid_step * GRID_MOST ? (int)((real)last * period / grid_step) :
                                                          GRID_MOST;
    count = count < GRID_FEWEST ? GRID_FEWEST : count;
    steps = count + (last < n - 1 ? HELD_STEPS : 0);
    for (int i = 0; i < DOF * DOF; ++i) {
        s->p[i] = i % (DOF + 1) == 0 ? 1.0 : 0.0;
        s->v[i] = 0.0;
    }
    status = growth_matrices(motion, 0, values, s->before, s, space);
    for (int k = 1; k <= steps && status == ELBOW_OK; ++k) {
        const ptrdiff_t next = k > count ? last :
                                           (ptrdiff_t)(((int64_t)k * last + count - 1) / count);
        const real h = (k > count ? grid_step : (real)(next - at) * period) / (real)GROWTH_STEPS;
        real most;
        if (next == at && k <= count) {
            continue;
        }
        at = next;
        status = growth_matrices(motion, at, values, s->now, s, space);
        if (status == ELBOW_OK && !growth_system(s, h)) {
            status = ELBOW_RESULT_NOT_FINITE;
        }
        for (int step = 0; step < GROWTH_STEPS && status == ELBOW_OK; ++step) {
            growth_step(s, h);
        }
        most = fmax_1(largest(s->p, DOF * DOF), grid_step * largest(s->v, DOF * DOF));
        if (!(most > 0.0 && most < growth_max)) {
            return status == ELBOW_OK ? ELBOW_RESULT_NOT_FINITE : (elbow_status)status;
        }
        for (int i = 0; i < DOF * DOF; ++i) {
            s->p[i] /= most;
            s->v[i] /= most;
        }
        size = size < growth_max / most ? size * most : growth_max;
        {
            const real norm = growth_norm(s->p);
            found = fmax_1(
                found, norm > 1.0 && size > growth_max / norm ? growth_max : size * norm);
        }
        copy(s->now, 2 * DOF * DOF, s->before);
    }
    if (status == ELBOW_OK) {
        growth[0] = found;
    }
    return (elbow_status)status;
}
#endif

#ifndef ELBOW_WITHOUT_INVERT
/* elbow: inverse dynamics along a whole path. Written by flexgen; see elbow_inversion.h. */
#include "../elbow_inversion.h"

#include "elbow_inversion_common.h"
#include "elbow_lq_step.h"
#include "elbow_reduced_problem.h"
#include "elbow_whole_path.h"

/*
 * --- The end of a motion along a path, where the remaining motion no longer affects the output.
 *
 * After the path the motion of the unactuated coordinates decays to the equilibrium. The remaining
 * motion moves the output by about
 *
 *     max over X in {W_e, D} of max(|X (q_e - q_e,end)|, HELD |X v_e|),    dy/dt = W v_a,
 *
 * while the joints stand still or, D = W_g M_gg^-1 M_ge - W_e, while the torque is held and they
 * keep their momentum. It does not end before the deflections of damped gears have decayed, see
 * `shortest_motion_after`.
 */

/*
 * --- Gauss-Newton steps of the inversion along a whole path.
 *
 * A step is the solution of a linear-quadratic problem (see lq_step.h). Its factors hold for later
 * steps too where the motion has changed little: then only the linear terms are computed again.
 * The intervals after the path are all close to the same equilibrium: they share its Jacobians,
 * and the factor of an endless one. Where the cost of that one is not exact, as unstable zeros of
 * very different size hide each other, each has a factor of its own.
 */

/* --- The function invert. */

int64_t elbow_invert_work(int n, const elbow_inversion_options *options)
{
    whole_layout l;
    int64_t end;
    if (options == NULL || !path_sizes_fit(n, options)) {
        return -1;
    }
    l = lay_out(n, options, 0, 0);
    end = l.end + padded((int64_t)(sizeof(problem_points) / sizeof(real)));
    end = options->growth && end < elbow_growth_work() ? elbow_growth_work() : end;
    return is_addressable(end) ? end : -1;
}

/* As elbow_invert, with a report instead of its info. */
static elbow_status invert_path(const elbow_samples *p,
    PARAMETERS_ARGUMENT const real q_start[ELBOW_NA], const elbow_inversion_options *options,
    elbow_motion *motion, whole_report *report, real *work, int64_t work_size)
{
    const int64_t wanted = p == NULL ? -1 : elbow_invert_work(p->n, options);
    whole_layout l;
    real q[NA];
    ptrdiff_t samples;
    int status = check_arguments(
        p, GIVEN_PARAMETERS, q_start, options, motion, report, work, work_size, wanted);
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    copy(q_start, NA, q);
    l = lay_out(p->n, options, 0, 0);
    keep_parameters(GIVEN_PARAMETERS, work + l.space);
    status = equilibrium_at(p->y, q, NULL, work + l.space);
    if (status != ELBOW_OK) {
        return (elbow_status)status;
    }
    report->residual = 0.0;
    samples = (ptrdiff_t)l.samples;
    if (options->settled > 0.0) {
        const real after = shortest_motion_after(work + l.space) / p->period;
        if (after < (real)options->n_post) { /* rounded up */
            samples -= options->n_post - (ptrdiff_t)after - 1;
        }
    }
    return finish(p, options, &l, q, NULL, samples, (problem_points *)(void *)(work + l.end),
        motion, report, work);
}

elbow_status elbow_invert(const elbow_samples *samples,
    PARAMETERS_ARGUMENT const real q_start[ELBOW_NA], const elbow_inversion_options *options,
    elbow_motion *motion, elbow_invert_info *info, real *work, int64_t work_size)
{
    whole_report report = {0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0};
    elbow_status status = ELBOW_NULL_ARGUMENT;
    const int grows = options != NULL && options->growth;
    if (info != NULL && (!grows || has_state_and_torques(motion))) {
        status = invert_path(
            samples, PASSED_PARAMETERS q_start, options, motion, &report, work, work_size);
    }
    if (report.is_set) {
        info->residual = report.residual;
        info->residual_at_samples = report.residual_at_samples;
        info->kinematic_mismatch = report.kinematic_mismatch;
        info->iterations = report.iterations;
        info->intervals = report.intervals;
        info->n_post = report.n_post;
        info->growth = (real)NAN;
        info->torque_error = report.torque_error;
    }
    /* the workspace is free again; where it fails, the torques are right all the same */
    if (grows && status >= 0) {
        real *growth = &info->growth;
        const int n = options->n_pre + samples->n + report.n_post;
        (void)elbow_growth(motion, n, samples->period, PASSED_PARAMETERS growth, work, work_size);
    }
    return status;
}

/*
 * --- The function invert_many.
 *
 * Problem k reads and writes nothing of another problem, and `invert_problem` keeps no data:
 * problems may be solved in any order, and at the same time where each has its own workspace.
 */
typedef struct {
    const elbow_problems *problems;
    const elbow_samples *samples;
    const real *parameters, *q_start;
    const elbow_inversion_options *options;
    const elbow_motion *motion;
    elbow_invert_info *info;
    elbow_status *statuses;
} problem_arrays;

/*
 * Numbers of an array of results from `at` on; a result that is not wanted stays a null pointer.
 */
static real *results_from(real *x, ptrdiff_t at)
{
    return x == NULL ? NULL : x + at;
}

static void set_to_nan(real *x, ptrdiff_t count)
{
    for (ptrdiff_t i = 0; i < count && x != NULL; ++i) {
        x[i] = (real)NAN;
    }
}

/* Solve problem k of the arrays. */
static void invert_problem(const problem_arrays *a, ptrdiff_t k, real *work, int64_t work_size)
{
    const elbow_problems *own = a->problems;
    const elbow_invert_info unknown = {
        (real)NAN, (real)NAN, (real)NAN, 0, 0, a->options->n_post, (real)NAN, (real)NAN};
    const ptrdiff_t n = a->samples->n, all = n + a->options->n_pre + a->options->n_post;
    const ptrdiff_t path = own->own_path ? k * n : 0;
    const real *q_start = a->q_start + (own->own_q_start ? k : 0) * NA;
    const real *parameters = a->parameters + (own->own_parameters ? k : 0) * PARAMETERS;
    elbow_samples p = *a->samples;
    elbow_motion m;
    (void)parameters;
    p.y += path * NT;
    p.dy += path * NY;
    p.ddy += path * NY;
    m.q_a = results_from(a->motion->q_a, k * all * NA);
    m.v_a = results_from(a->motion->v_a, k * all * NA);
    m.a_a = results_from(a->motion->a_a, k * all * NA);
    m.tau_g = results_from(a->motion->tau_g, k * all * NG);
    m.q_m = results_from(a->motion->q_m, k * all * NM);
    m.v_m = results_from(a->motion->v_m, k * all * NM);
    m.tau_m = results_from(a->motion->tau_m, k * all * NM);
    a->info[k] = unknown;
    a->statuses[k] = elbow_invert(
        &p, PASSED_PARAMETERS q_start, a->options, &m, a->info + k, work, work_size);
    if (a->statuses[k] < 0) {
        set_to_nan(m.q_a, all * NA);
        set_to_nan(m.v_a, all * NA);
        set_to_nan(m.a_a, all * NA);
        set_to_nan(m.tau_g, all * NG);
        set_to_nan(m.q_m, all * NM);
        set_to_nan(m.v_m, all * NM);
        set_to_nan(m.tau_m, all * NM);
    }
}

elbow_status elbow_invert_many(const elbow_problems *problems, const elbow_samples *samples,
    const real *q_start, const elbow_inversion_options *options, elbow_motion *motion,
    elbow_invert_info *info, elbow_status *statuses, real *work, int64_t work_size)
{
    const problem_arrays a = {
        problems, samples, GIVEN_PARAMETERS, q_start, options, motion, info, statuses};
    elbow_status first = ELBOW_OK;
    int64_t wanted;
    if (problems == NULL || samples == NULL || a.parameters == NULL || q_start == NULL ||
        options == NULL || motion == NULL || info == NULL || statuses == NULL || work == NULL ||
        samples->y == NULL || samples->dy == NULL || samples->ddy == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    wanted = elbow_invert_work(samples->n, options);
    if (problems->count < 0 || wanted < 0) {
        return problems->count < 0 ? ELBOW_BAD_COUNT : ELBOW_BAD_ARGUMENT;
    }
    if (work_size < wanted) {
        return ELBOW_WORK_TOO_SMALL;
    }
    for (ptrdiff_t k = 0; k < problems->count; ++k) {
        invert_problem(&a, k, work, work_size);
        first = first == ELBOW_OK && statuses[k] < 0 ? statuses[k] : first;
    }
    return first;
}
#endif

#ifndef ELBOW_WITHOUT_STREAM
/* elbow: inverse dynamics on a moving horizon. Written by flexgen; see elbow_inversion.h. */
#include "../elbow_inversion.h"

#include "elbow_reduced_problem.h"
#include "elbow_stream_update.h"

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
enum { PAST_NODES = 7, SILENT_UPDATES = ELBOW_STREAM_START_SAMPLES(0) - 1 - PAST_NODES };

/* Copy sample k of a path. */
static inline void sample_of(const elbow_samples *p, ptrdiff_t k, real *out)
{
    copy(p->y + k * NT, NT, out);
    copy(p->dy + k * NY, NY, out + NT);
    copy(p->ddy + k * NY, NY, out + NT + NY);
}

/* The path of the horizon and before it: node 0 of the horizon is sample `now`. */
static inline void set_path(real *s, const layout *l, const elbow_samples *p, ptrdiff_t now)
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
        }
        status = solve_kinematics(arm, s + l->space);
        if (status != ELBOW_OK) {
            return status;
        }
        if (!(arm->side[0] * (k > 0 ? (real)head_in(s)->side : arm->side[0]) > 0.0)) {
            return ELBOW_UNREACHABLE; /* it passed a singular pose */
        }
        head_of(s)->side = arm->side[0] > 0.0 ? 1 : -1;
        for (int i = 0; i < NG; ++i) {
            q_g[k * NG + i] = last[i] = arm->q[i_g[i]][0];
        }
    }
    return ELBOW_OK;
}

/* The arm's coordinates at the equilibrium at which a stream was started. */
static inline void joints_at_start(const real *s, const layout *l, real q[NA])
{
    for (int i = 0; i < NG; ++i) {
        q[i_g[i]] = s[l->q_g + i];
    }
}

/* The stream, at equilibrium now, is on the path instead. */
static inline int set_moving(
    real *s, const layout *l, const elbow_samples *p, ptrdiff_t now, const real *q)
{
    int status;
    set_path(s, l, p, now);
    status = set_joints(s, l, q);
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

/*
 * Approximate cost of a part: microseconds with 6 motors and 12 coordinates without motor on a
 * processor with vectors of 8 numbers. Only the distribution of the work depends on it.
 */
static inline int cost_of_part(const real *s, update_part p)
{
    static const int cost[PARTS_END] = {0,
        20, 5, 60};
    return p.part == PART_LIMITS && !head_in(s)->has_limits ? 0 : cost[p.part];
}

/* The part after p. */
static inline update_part part_after(const real *s, update_part p)
{
    (void)s;
    p.part += 1;
    if (p.part != PARTS_END
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
    return out;
}

/* Limits of the motors: what they do now, and the change of the path ahead. */
static inline int limits_part(real *s, const layout *l, const interval_results *out)
{
    real off[2] = {0.0, 0.0};
    int ends;
    if (!head_in(s)->has_limits) {
        return ELBOW_OK;
    }
    head_of(s)->limited = is_limited(s, l, out->v_m, out->tau_m, off, &ends);
    copy(off, 2, head_of(s)->off);
    return ends ? ELBOW_LIMITS_INFEASIBLE : apply_limits(s, l);
}

/* Motors in the interval. */
static inline int motors_part(real *s, const layout *l, const interval_results *out)
{
    real step = 0.0, output_step[2] = {0.0, 0.0};
    const int status = motors_in_interval(s, l, out, &step, output_step);
    if (status == ELBOW_OK) {
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
    int done = 0, status = ELBOW_OK;
    while (status == ELBOW_OK && p.part != PARTS_END &&
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
static real *memory_of(const elbow_stream *stream)
{
    return stream == NULL ? NULL : stream->memory;
}

/*
 * Layout of a stream that was started and has not failed; a status where its memory holds none, or
 * not all of it.
 */
static elbow_status find_layout(const elbow_stream *given, layout *l)
{
    if (given->size < HEAD) {
        return ELBOW_WORK_TOO_SMALL;
    }
    if (!is_running(given->memory)) {
        return ELBOW_NOT_STARTED;
    }
    *l = layout_of(given->memory);
    return given->size < l->end ? ELBOW_WORK_TOO_SMALL : ELBOW_OK;
}

/* sweeps after which the cost of an endless equilibrium has converged */
enum { SETTLING_SWEEPS = 10 };

int64_t elbow_stream_work(const elbow_stream_options *options)
{
    return options != NULL && stream_sizes_fit(options) ?
               (int64_t)laid_out(options->intervals, options->samples_per_interval,
                   (int)options->hold, options->delay)
                   .end :
               -1;
}

/* Deflections of the gears at the equilibrium q. */
static int deflection_at_equilibrium(const real *q, real *deflection, real *space)
{
    static const real zero[NA] = {0.0};
    real tau[NG], stiffness[NG];
    int status;
    status = inner_status(evaluate_inversion_rows(q, zero, zero, tau, space));
    if (status != ELBOW_OK) {
        return status;
    }
    return static_deflections(tau, 1, zero, deflection, stiffness, space) ?
               ELBOW_OK :
               ELBOW_RESULT_NOT_FINITE;
}

/*
 * The whole horizon and the past are at the equilibrium with the output at its target; q: a guess,
 * and it.
 */
static int set_equilibrium(real *s, const layout *l, const real *target, real *q)
{
    const ptrdiff_t N = head_in(s)->intervals;
    real *equilibrium = s + l->last;
    int status = equilibrium_at(target, q, NULL, s + l->space);
    if (status != ELBOW_OK) {
        return status;
    }
    head_of(s)->base = 0;
    head_of(s)->stale = 1;
    head_of(s)->is_predicted = 0;
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
    if (status != ELBOW_OK) {
        return status;
    }
    status = deflection_at_equilibrium(q, s + l->now, s + l->space);
    return status;
}

COLD elbow_status elbow_stream_start(const elbow_stream *given,
    const elbow_stream_options *options, const real y[ELBOW_NT],
    PARAMETERS_ARGUMENT const real q_start[ELBOW_NA])
{
    real *stream = given == NULL ? NULL : given->memory;
    const real *parameters_given = GIVEN_PARAMETERS;
    layout l;
    real q[NA], *space;
    stream_head *head;
    int status;
    if (stream == NULL || options == NULL || y == NULL || parameters_given == NULL ||
        q_start == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!stream_sizes_fit(options) || !(options->period > 0.0 && options->period < 1e6) ||
        !(options->tolerance > 0.0 && options->tolerance < 1.0)) {
        return ELBOW_BAD_ARGUMENT;
    }
    l = laid_out(
        options->intervals, options->samples_per_interval, (int)options->hold, options->delay);
    if (given->size < l.end) {
        return ELBOW_WORK_TOO_SMALL;
    }
    head = head_of(stream);
    head->state = IS_EMPTY;
    if (!is_finite(y, NT) || !is_finite(parameters_given, PARAMETERS) || !is_finite(q_start, NA)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
    space = stream + l.space;
    keep_parameters(parameters_given, space);
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
    for (int i = 0; i < MEASURES + NM; ++i) {
        stream[l.most + i] = 0.0;
    }
    status = set_equilibrium(stream, &l, y, q);
    if (status == ELBOW_OK) {
        head->state = IS_RUNNING;
    }
    return (elbow_status)status;
}

/* Whether an update has begun and not ended. */
static int has_begun(const real *stream)
{
    return head_in(stream)->part > NO_UPDATE;
}

COLD elbow_status elbow_stream_limits(const elbow_stream *given, const real torque_max[ELBOW_NM],
    const real speed_max[ELBOW_NM], real deviation_max)
{
    real *stream = memory_of(given);
    layout l;
    limits_layout w;
    real *bound;
    elbow_status status;
    if (stream == NULL || torque_max == NULL || speed_max == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != ELBOW_OK) {
        return status;
    }
    if (has_begun(stream) || !(deviation_max > 0.0 && deviation_max < 1e6)) {
        return ELBOW_BAD_ARGUMENT;
    }
    for (int i = 0; i < NM; ++i) {
        if (!(torque_max[i] > 0.0 && speed_max[i] > 0.0)) {
            return ELBOW_BAD_ARGUMENT;
        }
    }
    w = limits_laid_out(head_in(stream)->intervals);
    if (!head_in(stream)->has_limits && !start_limits(stream, &l)) {
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

/*
 * Status of an update that fails after its sample was taken; UNREACHABLE would mean that the
 * sample was refused.
 */
static elbow_status failed(real *stream, int status)
{
    head_of(stream)->state = HAS_FAILED;
    return status == ELBOW_UNREACHABLE ? ELBOW_NOT_CONVERGED : (elbow_status)status;
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

elbow_status elbow_stream_begin(const elbow_stream *given, const real y[ELBOW_NT],
    const real dy[ELBOW_NY], const real ddy[ELBOW_NY])
{
    real *stream = memory_of(given);
    layout l;
    real own[REFERENCE], next[REFERENCE], deviation[DEVIATION];
    next_interval arrived;
    int has_limits;
    elbow_status status;
    if (stream == NULL || y == NULL || dy == NULL || ddy == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != ELBOW_OK) {
        return status;
    }
    if (has_begun(stream)) {
        return ELBOW_BAD_ARGUMENT;
    }
    if (!is_finite(y, NT) || !is_finite(dy, NY) || !is_finite(ddy, NY)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
    copy(y, NT, own);
    copy(dy, NY, own + NT);
    copy(ddy, NY, own + NT + NY);
    copy(own, REFERENCE, next);
    has_limits = head_in(stream)->has_limits;
    if (has_limits) {
        next_deviation(stream, &l, own, deviation, next);
    }
    status = (elbow_status)reach_next_sample(stream, &l, next, &arrived);
    if (status != ELBOW_OK) {
        return status; /* the sample is refused, and nothing has changed */
    }
    shift_path(stream, &l, next, &arrived);
    if (has_limits) {
        shift_limits(stream, &l, own, deviation);
    }
    begin_results(head_of(stream));
    return ELBOW_OK;
}

elbow_status elbow_stream_advance(const elbow_stream *given, int parts)
{
    real *stream = memory_of(given);
    layout l;
    elbow_status status;
    if (stream == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != ELBOW_OK) {
        return status;
    }
    if (!has_begun(stream)) {
        return ELBOW_NOT_STARTED;
    }
    if (parts < 1) {
        return ELBOW_BAD_ARGUMENT;
    }
    status = (elbow_status)do_parts(stream, &l, parts);
    return status == ELBOW_OK ? ELBOW_OK : failed(stream, status);
}

/* Copy results where the caller wants them. */
static void give(const real *from, ptrdiff_t size, real *to)
{
    if (to != NULL) {
        copy(from, size, to);
    }
}

elbow_status elbow_stream_finish(
    const elbow_stream *given, elbow_motion *motion, elbow_stream_info *info)
{
    real *stream = memory_of(given);
    layout l;
    interval_results out;
    stream_head *head;
    ptrdiff_t n;
    elbow_status status;
    if (stream == NULL || motion == NULL || info == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    status = find_layout(given, &l);
    if (status != ELBOW_OK) {
        return status;
    }
    if (!has_begun(stream)) {
        return ELBOW_NOT_STARTED;
    }
    status = (elbow_status)do_parts(stream, &l, 1);
    if (status != ELBOW_OK) {
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
    info->cause = ELBOW_CAUSE_NONE;
    if (!(info->torque_step <= torque_step_max)) {
        info->cause = ELBOW_CAUSE_TORQUE_STEP;
    } else if (!(info->residual <= head->tolerance)) {
        info->cause = ELBOW_CAUSE_RESIDUAL;
    } else if (!(info->kinematic_mismatch <= mismatch_max)) {
        info->cause = ELBOW_CAUSE_MISMATCH;
    }
    if (info->cause != ELBOW_CAUSE_NONE) {
        return ELBOW_TOLERANCE_NOT_MET;
    }
    if (!is_finite(&head->residual, 1) || !is_finite(&head->mismatch, 1) ||
        !is_finite(&head->torque_step, 1) || !is_finite(head->output_step, 2) ||
        !is_finite(head->off, 2)) {
        return failed(stream, ELBOW_RESULT_NOT_FINITE);
    }
    return info->limits_active ? ELBOW_LIMITS_ACTIVE : ELBOW_OK;
}

elbow_status elbow_stream_update(const elbow_stream *stream, const real y[ELBOW_NT],
    const real dy[ELBOW_NY], const real ddy[ELBOW_NY], elbow_motion *motion,
    elbow_stream_info *info)
{
    elbow_status status;
    if (motion == NULL || info == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    status = elbow_stream_begin(stream, y, dy, ddy);
    return status == ELBOW_OK ? elbow_stream_finish(stream, motion, info) : status;
}

/* Whether all samples are finite, and all rotations are rotations and close to each other. */
static elbow_status check_samples(const elbow_samples *p)
{
    for (ptrdiff_t k = 0; k < p->n; ++k) {
        if (!is_finite(p->y + k * NT, NT) || !is_finite(p->dy + k * NY, NY) ||
            !is_finite(p->ddy + k * NY, NY)) {
            return ELBOW_INPUT_NOT_FINITE;
        }
    }
    return ELBOW_OK;
}

COLD elbow_status elbow_stream_start_moving(const elbow_stream *given,
    const elbow_stream_options *options, const elbow_samples *path,
    PARAMETERS_ARGUMENT const real q_start[ELBOW_NA])
{
    elbow_motion none = {NULL, NULL, NULL, NULL, NULL, NULL, NULL};
    elbow_stream_info info;
    elbow_status status;
    ptrdiff_t now;
    layout l;
    real q[NA], *stream = given == NULL ? NULL : given->memory;
    if (stream == NULL || options == NULL || path == NULL || path->y == NULL || path->dy == NULL ||
        path->ddy == NULL || q_start == NULL) {
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
    status = elbow_stream_start(given, options, path->y + now * NT, PASSED_PARAMETERS q_start);
    if (status != ELBOW_OK) {
        return status;
    }
    l = layout_of(stream);
    joints_at_start(stream, &l, q);
    status = (elbow_status)set_moving(stream, &l, path, now, q);
    for (ptrdiff_t k = path->n - SILENT_UPDATES; k < path->n && status >= ELBOW_OK; ++k) {
        status = elbow_stream_update(
            given, path->y + k * NT, path->dy + k * NY, path->ddy + k * NY, &none, &info);
    }
    if (status < ELBOW_OK) {
        head_of(stream)->state = IS_EMPTY;
        return status;
    }
    /* largest values of the first updates are not those of the motion */
    for (int i = 0; i < MEASURES + NM; ++i) {
        stream[l.most + i] = 0.0;
    }
    return ELBOW_OK;
}
#endif
