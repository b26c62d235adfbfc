/* model: inverse dynamics along a whole path. Written by flexgen; see model_inversion.h. */
#include "model_inversion.h"

#include "model_inversion_common.h"
#include "model_lq_step.h"
#include "model_reduced_problem.h"
#include "model_whole_path.h"

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

#if MODEL_NE > 0

static const real held_time = 0.5; /* s: HELD */

typedef struct {
    real allowed;       /* what may be left [m or rad]; 0: the motion is not cut */
    real q[NA];         /* the equilibrium */
    real X[2 * NY][NE]; /* W_e and D there */
    real shortest;      /* motion after the path, at least [s] */
    int intervals;      /* with motion */
} settling;

/* The matrices at the equilibrium, M by inverse dynamics of unit accelerations. */
static inline int settling_at(const real *target, problem_points *arm, settling *s, real *space)
{
    real M[NG][NG + NE], at_rest[NG];
    for (int i = 0; i < NT; ++i) {
        for (int l = 0; l < POINTS; ++l) {
            arm->target[i][l] = target[i];
        }
    }
#if MODEL_FORCE
    for (int l = 0; l < POINTS; ++l) {
        for (int i = 0; i < NA; ++i) {
            arm->q[i][l] = s->q[i];
            arm->v[i][l] = 0.0;
        }
    }
    load_force(arm, space);
    evaluate_constraint(arm, space); /* W */
#endif                               /* MODEL_FORCE */
    for (int begin = 0; begin <= NA; begin += POINTS) {
        int status;
        for (int i = 0; i < NA; ++i) {
            for (int l = 0; l < POINTS; ++l) {
                arm->q[i][l] = s->q[i];
                arm->v[i][l] = 0.0;
                arm->a[i][l] = begin + l == i + 1 ? 1.0 : 0.0; /* the first: at rest */
            }
        }
        status = evaluate_rows(arm, space);
        if (status != MODEL_OK) {
            return status;
        }
        for (int i = 0; i < NG; ++i) {
            at_rest[i] = begin == 0 ? arm->tau_g[i][0] : at_rest[i];
            for (int j = 0; j < NG + NE; ++j) {
                const int l = (j < NG ? i_g[j] : i_e[j - NG]) + 1 - begin;
                if (l >= 0 && l < POINTS) {
                    M[i][j] = arm->tau_g[i][l] - at_rest[i];
                }
            }
        }
    }
    (void)solve_plain(&M[0][0], NG, NG + NE);
    evaluate_constraint(arm, space);
    for (int i = 0; i < NY; ++i) {
        for (int j = 0; j < NE; ++j) {
            s->X[i][j] = arm->W[i_e[j]][i][0];
            s->X[NY + i][j] = -s->X[i][j];
            for (int k = 0; k < NG; ++k) {
                s->X[NY + i][j] += arm->W[i_g[k]][i][0] * M[k][NG + j];
            }
        }
    }
    return MODEL_OK;
}

/* Whether the remaining motion at node k of the mesh moves the output by more than `allowed`. */
static inline int moves_at(const mesh *m, const settling *s, ptrdiff_t k, real allowed)
{
    const real *y = m->y + k * STATES;
    for (int part = 0; part < 2; ++part) {
        real squares[2] = {0.0, 0.0};
        for (int i = part * NY; i < (part + 1) * NY; ++i) {
            real q = 0.0, v = 0.0;
            for (int j = 0; j < NE; ++j) {
                q += s->X[i][j] * (y[j] - m->equilibrium[j]);
                v += s->X[i][j] * held_time * y[NE + j];
            }
            squares[0] += q * q;
            squares[1] += v * v;
        }
        if (!(fmax_1(squares[0], squares[1]) <= allowed * allowed)) {
            return 1;
        }
    }
    return 0;
}

/*
 * Leave out the intervals after the motion, but for those that its last derivatives need. Half of
 * what is allowed: the next steps change the motion, and a vibration can be larger between two
 * nodes.
 */
static inline void cut_mesh(mesh *m, int samples_per_interval, settling *s)
{
    const int margin = (BEYOND + samples_per_interval - 1) / samples_per_interval;
    int k = m->N;
    while ((real)(k - m->varying) * m->h > s->shortest && !moves_at(m, s, k, 0.5 * s->allowed)) {
        --k;
    }
    if (k + 1 + margin < m->N) {
        m->N = k + 1 + margin;
        s->intervals = k + 1;
    }
}

/*
 * Whether the motion that has been found moves after its end, which was chosen before its last
 * steps.
 */
static inline int is_cut_early(const mesh *m, const settling *s)
{
    for (int k = s->intervals; s->intervals < m->N && k <= m->N; ++k) {
        if (moves_at(m, s, k, s->allowed)) {
            return 1;
        }
    }
    return 0;
}

#endif

/*
 * --- Gauss-Newton steps of the inversion along a whole path.
 *
 * A step is the solution of a linear-quadratic problem (see lq_step.h). Its factors hold for later
 * steps too where the motion has changed little: then only the linear terms are computed again.
 * The intervals after the path are all close to the same equilibrium: they share its Jacobians,
 * and the factor of an endless one. Where the cost of that one is not exact, as unstable zeros of
 * very different size hide each other, each has a factor of its own.
 */

#if MODEL_NE > 0

enum { MORE_STEPS = 2 };

static const real unchanged = PRECISE(1e-7, 1e-4);

/*
 * The factors of all intervals that have their own, from the cost of an endless equilibrium after
 * them.
 */
static inline int lq_path_factor(mesh *m, real *point, const lq_data *c, lq_space *w, real *space)
{
    int status;
    copy(m->end, STATES * STATES, w->P);
    set_zero(w->p, STATES);
    status = m->factored > m->varying ? lq_factor_alike(m, m->varying, c->steady_point, w) :
                                        MODEL_OK;
    return status == MODEL_OK ? lq_factor_before(m, m->varying, point, w, space) : status;
}

/*
 * The residuals before the first step: those of the factors; the intervals after the path are at
 * equilibrium.
 */
static inline void lq_path_first_rows(mesh *m, const lq_data *c)
{
    const ptrdiff_t at = (ptrdiff_t)m->varying * STAGES, all = (ptrdiff_t)m->N * STAGES;
    for (ptrdiff_t k = 0; k < at; ++k) {
        copy(c->point + k * POINT + NE * TRIPLE, NE, c->row + k * NE);
    }
    for (ptrdiff_t i = at * NE; i < all * NE; ++i) {
        c->row[i] = 0.0;
    }
}

#if MODEL_FORCE
/*
 * Add to the first guess of the motion its linear response to the force, all intervals with the
 * Jacobians and the factor of the equilibrium after the path: the next step, with those of this
 * motion, is then several times smaller, and the factors serve several times better. c->row:
 * residuals by the force on the path.
 */
static inline int add_response(const mesh *m, lq_data *c)
{
    const ptrdiff_t at = m->varying, all = m->N;
    mesh alike = *m;
    real d[STATES] = {0.0};
    alike.varying = alike.factored = 0;
    for (ptrdiff_t i = at * RESIDUALS; i < all * RESIDUALS; ++i) {
        c->row[i] = 0.0;
    }
    if (!lq_linear(&alike, c)) {
        return 0;
    }
    c->response = lq_data_step(&alike, c, d);
    for (ptrdiff_t i = at * CONTROLS; i < all * CONTROLS; ++i) {
        c->linear[i] = 0.0;
    }
    c->own = m->varying; /* in the first step */
    return 1;
}

/*
 * Whether the step after the next one would change the motion by less than ten times the share
 * `unchanged` of the first: then the next one is the last, and what it leaves is seen at the
 * samples. last and size: sizes of the last two steps.
 */
static inline int is_nearly_last(
    const mesh *m, const lq_data *c, real tolerance, real first, real last, real size)
{
    const real gain = last > 0.0 ? size / last : 1.0;
    return c->response > 0.0 && m->residual <= tolerance &&
           size * gain * gain <= 10.0 * unchanged * first;
}

#endif /* MODEL_FORCE */
/*
 * The motion on the mesh by Gauss-Newton steps. The factors are computed again where a step with
 * those of an earlier motion gains less than a factor of ten. Where the residual is small enough,
 * up to MORE_STEPS follow until the next one would change the motion by less than the share
 * `unchanged` of the first: factors of another motion leave an error of the motion that the
 * residual hardly shows. cut: the motion ends where it has settled after the first step, which is
 * nearly the last one.
 */
static inline int lq_path_solve(mesh *m, real *point, lq_data *c, const model_inversion_options *o,
    int cut, settling *end, whole_report *report, lq_space *w, real *space)
{
    const real tolerance = o->tolerance;
    newton progress = {-1.0, 0, 0};
#if MODEL_FORCE
    real first = c->response, last = 0.0; /* sizes of steps */
#else                                     /* MODEL_FORCE */
    real first = 0.0, last = 0.0; /* sizes of steps */
#endif                                    /* MODEL_FORCE */
    int must_factor = 1, more = 0;
#if MODEL_FORCE
    int is_last = 0;
#endif /* MODEL_FORCE */
    for (;;) {
        const real before = progress.before;
        real size, next;
        int state, status = MODEL_OK;
        report->iterations = progress.steps + 1;
        if (must_factor) {
            status = lq_path_factor(m, point, c, w, space);
        }
        if (status == MODEL_OK && progress.steps == 0) {
            lq_path_first_rows(m, c);
        }
#if MODEL_FORCE
        if (status == MODEL_OK && c->own == 0 && !lq_linear(m, c)) {
#else  /* MODEL_FORCE */
        if (status == MODEL_OK && !lq_linear(m, c)) {
#endif /* MODEL_FORCE */
            status = MODEL_NOT_CONVERGED;
        }
        if (status != MODEL_OK) {
            return status;
        }
        {
            real d[STATES] = {0.0};
            size = lq_data_step(m, c, d);
        }
#if MODEL_FORCE
        c->own = 0;
        if (is_last) {
            return MODEL_OK;
        }
#endif /* MODEL_FORCE */
        if (progress.steps == 0 && cut) {
            cut_mesh(m, o->samples_per_interval, end);
        }
        status = evaluate_residual(m, c->row, w, space);
        if (status != MODEL_OK) {
            return status;
        }
        state = newton_state(&progress, m->residual, tolerance, 1e-2);
        first = fmax_1(first, size);
        next = last > 0.0        ? (must_factor ? 0.0 : size * (size / last)) :
               m->varying < m->N ? size :
                                   0.0;
        if (state == NEWTON_CONTINUES && last > 0.0 && !must_factor && m->residual <= tolerance &&
            next <= unchanged * first) {
            /* what is left is the regularization, which no step changes */
            state = NEWTON_CONVERGED;
        }
        if (state == NEWTON_FAILED ||
            (state == NEWTON_CONVERGED && (!(next > unchanged * first) || more == MORE_STEPS))) {
            return state == NEWTON_CONVERGED ? MODEL_OK : MODEL_NOT_CONVERGED;
        }
#if MODEL_FORCE
        is_last = !must_factor && is_nearly_last(m, c, tolerance, first, last, size);
#endif /* MODEL_FORCE */
        more += state == NEWTON_CONVERGED;
        must_factor = state == NEWTON_CONTINUES && before >= 0.0 && m->residual > 0.1 * before;
        progress.before = m->residual;
        last = size;
    }
}

#endif

/* --- The function invert. */

#if MODEL_NE > 0
/* sweeps for the cost of an endless equilibrium; their intervals */
enum { SWEEPS = 40, SWEEP = 8 };

/* from sweep to sweep, where the cost of an endless equilibrium has converged */
static const real cost_change = 1e-2;

/* Where the arrays of this solver are, after those of both. */
typedef struct {
    int64_t cost, y, a, q_g, reference, steady_factor, steady_point, point, row, linear, settling,
        lq, end;
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

int64_t model_invert_work(int n, const model_inversion_options *options)
{
    whole_layout l;
    int64_t end;
    if (options == NULL || !path_sizes_fit(n, options)) {
        return -1;
    }
#if MODEL_NE > 0
    l = lay_out(n, options, CONTROLS * WIDTH, 1);
    end = lay_out_lq(&l).end;
#else
    l = lay_out(n, options, 0, 0);
    end = l.end + padded((int64_t)(sizeof(problem_points) / sizeof(real)));
#endif
#if MODEL_GROWS
    end = options->growth && end < model_growth_work() ? model_growth_work() : end;
#endif
    return is_addressable(end) ? end : -1;
}

#if MODEL_NE > 0
/*
 * Equilibrium at the end of the path, to which the first guess of the motion leads; the cost of a
 * state that differs from it, for the end of the mesh; and when the motion has settled there.
 */
static int prepare_end(mesh *m, const whole_layout *l, const lq_layout *own, const real *target,
    const real *q_start, real *work)
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
    if (status != MODEL_OK) {
        return status;
    }
    copy(target, NT, reference);
#if MODEL_FORCE
    copy(FORCE_OF(work + l->space), NY, reference + NT + 2 * NY);
#endif /* MODEL_FORCE */
    hold.N = 1;
    hold.y = work + own->y;
    hold.a = work + own->a;
    hold.q_g = work + own->q_g;
    hold.reference = work + own->reference;
    hold.factor = work + own->steady_factor;
    for (int i = 0; i < STATES; ++i) {
        hold.y[i] = hold.y[STATES + i] = i < NE ? q[i_e[i % NE]] : 0.0;
    }
    set_zero(hold.a, CONTROLS);
    for (int k = 0; k < STAGES; ++k) {
        for (int i = 0; i < NG; ++i) {
            hold.q_g[k * NG + i] = q[i_g[i]];
        }
        copy(reference, REFERENCE, hold.reference + k * REFERENCE);
    }
    status = lq_stationary_cost(&hold, SWEEP, m->N / SWEEP > SWEEPS ? m->N / SWEEP : SWEEPS,
        regularization, cost_change, w, work + l->space, work + own->cost, &is_exact);
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
    return status == MODEL_OK && end->allowed > 0.0 ?
               settling_at(target, &w->arm, end, work + l->space) :
               status;
}

/*
 * The motion on the mesh; cut: it ends where it has settled after the first step, else after the
 * last one.
 */
static int motion_on_mesh(mesh *m, const whole_layout *l, const lq_layout *own,
    const model_samples *p, const real *q, const model_inversion_options *options, int cut,
    whole_report *report, real *work)
{
    lq_space *w = (lq_space *)(void *)(work + own->lq);
    settling *end = (settling *)(void *)(work + own->settling);
    lq_data c;
#if MODEL_FORCE
    real *row = p->force != NULL ? work + own->row : NULL; /* residuals by the force */
    int status = guess_mesh(
        m, p, q, options->n_pre, options->samples_per_interval, &w->arm, row, work + l->space);
#else  /* MODEL_FORCE */
    int status = guess_mesh(
        m, p, q, options->n_pre, options->samples_per_interval, &w->arm, work + l->space);
#endif /* MODEL_FORCE */
#if MODEL_FORCE
    keep_force(p, p->n - 1, work + l->space);
#endif /* MODEL_FORCE */
    if (status == MODEL_OK) {
        status = prepare_end(m, l, own, p->y + (p->n - 1) * (ptrdiff_t)NT, q, work);
    }
    if (status != MODEL_OK) {
        return status;
    }
    c.point = work + own->point;
    c.row = work + own->row;
    c.linear = work + own->linear;
    c.steady_point = work + own->steady_point;
    c.steady_factor = work + own->steady_factor;
#if MODEL_FORCE
    c.own = 0;
    c.response = 0.0;
    if (row != NULL && !add_response(m, &c)) {
        return MODEL_NOT_CONVERGED;
    }
#endif /* MODEL_FORCE */
    status = lq_path_solve(
        m, work + own->point, &c, options, cut, end, report, w, work + l->space);
    report->residual = m->residual;
    report->intervals = m->N;
    if (status == MODEL_OK && !cut && end->allowed > 0.0) {
        cut_mesh(m, options->samples_per_interval, end);
    }
    return status;
}

#endif

/* As model_invert, with a report instead of its info. */
static model_status invert_path(const model_samples *p,
    PARAMETERS_ARGUMENT const real q_start[MODEL_NA], const model_inversion_options *options,
    model_motion *motion, whole_report *report, real *work, int64_t work_size)
{
    const int64_t wanted = p == NULL ? -1 : model_invert_work(p->n, options);
    whole_layout l;
    real q[NA];
#if MODEL_NE == 0
    ptrdiff_t samples;
#endif
    int status = check_arguments(
        p, GIVEN_PARAMETERS, q_start, options, motion, report, work, work_size, wanted);
    if (status != MODEL_OK) {
        return (model_status)status;
    }
    copy(q_start, NA, q);
#if MODEL_NE > 0
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
#if MODEL_FORCE
        keep_force(p, 0, work + l.space);
#endif /* MODEL_FORCE */
        status = equilibrium_at(p->y, q, m.scale, work + l.space);
        if (status == MODEL_OK) {
            status = motion_on_mesh(&m, &l, &own, p, q, options, end->allowed > 0.0, report, work);
        }
        if (status == MODEL_OK && is_cut_early(&m, end)) {
            m = mesh_in(&l, p, options, work);
            status = motion_on_mesh(&m, &l, &own, p, q, options, 0, report, work);
        }
        if (status != MODEL_OK) {
            return (model_status)status;
        }
        return finish(p, options, &l, q, &m, end->q,
            end->intervals * (ptrdiff_t)options->samples_per_interval + 1,
            &((lq_space *)(void *)(work + own.lq))->arm, motion, report, work);
    }
#else
    l = lay_out(p->n, options, 0, 0);
    keep_parameters(GIVEN_PARAMETERS, work + l.space);
#if MODEL_FORCE
    keep_force(p, 0, work + l.space);
#endif /* MODEL_FORCE */
    status = equilibrium_at(p->y, q, NULL, work + l.space);
    if (status != MODEL_OK) {
        return (model_status)status;
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
#endif
}

model_status model_invert(const model_samples *samples,
    PARAMETERS_ARGUMENT const real q_start[MODEL_NA], const model_inversion_options *options,
    model_motion *motion, model_invert_info *info, real *work, int64_t work_size)
{
    whole_report report = {0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0};
    model_status status = MODEL_NULL_ARGUMENT;
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
#if MODEL_GROWS
    /* the workspace is free again; where it fails, the torques are right all the same */
    if (grows && status >= 0) {
        real *growth = &info->growth;
        const int n = options->n_pre + samples->n + report.n_post;
#if MODEL_FORCE
        (void)model_growth(motion, n, samples->period, samples->force, samples->n, options->n_pre,
            PASSED_PARAMETERS growth, work, work_size);
#else  /* MODEL_FORCE */
        (void)model_growth(motion, n, samples->period, PASSED_PARAMETERS growth, work, work_size);
#endif /* MODEL_FORCE */
    }
#endif
    return status;
}

/*
 * --- The function invert_many.
 *
 * Problem k reads and writes nothing of another problem, and `invert_problem` keeps no data:
 * problems may be solved in any order, and at the same time where each has its own workspace.
 */
typedef struct {
    const model_problems *problems;
    const model_samples *samples;
    const real *parameters, *q_start;
    const model_inversion_options *options;
    const model_motion *motion;
    model_invert_info *info;
    model_status *statuses;
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
    const model_problems *own = a->problems;
    const model_invert_info unknown = {
        (real)NAN, (real)NAN, (real)NAN, 0, 0, a->options->n_post, (real)NAN, (real)NAN};
    const ptrdiff_t n = a->samples->n, all = n + a->options->n_pre + a->options->n_post;
    const ptrdiff_t path = own->own_path ? k * n : 0;
    const real *q_start = a->q_start + (own->own_q_start ? k : 0) * NA;
    const real *parameters = a->parameters + (own->own_parameters ? k : 0) * PARAMETERS;
    model_samples p = *a->samples;
    model_motion m;
    (void)parameters;
    p.y += path * NT;
    p.dy += path * NY;
    p.ddy += path * NY;
#if MODEL_FORCE
    p.force = p.force == NULL ? NULL : p.force + path * FORCES;
#endif /* MODEL_FORCE */
    m.q_a = results_from(a->motion->q_a, k * all * NA);
    m.v_a = results_from(a->motion->v_a, k * all * NA);
    m.a_a = results_from(a->motion->a_a, k * all * NA);
    m.tau_g = results_from(a->motion->tau_g, k * all * NG);
    m.q_m = results_from(a->motion->q_m, k * all * NM);
    m.v_m = results_from(a->motion->v_m, k * all * NM);
    m.tau_m = results_from(a->motion->tau_m, k * all * NM);
#if MODEL_POSITION
    m.command_m = results_from(a->motion->command_m, k * all * NM);
    m.command_g = results_from(a->motion->command_g, k * all * NG);
#endif /* MODEL_POSITION */
    a->info[k] = unknown;
    a->statuses[k] = model_invert(
        &p, PASSED_PARAMETERS q_start, a->options, &m, a->info + k, work, work_size);
    if (a->statuses[k] < 0) {
        set_to_nan(m.q_a, all * NA);
        set_to_nan(m.v_a, all * NA);
        set_to_nan(m.a_a, all * NA);
        set_to_nan(m.tau_g, all * NG);
        set_to_nan(m.q_m, all * NM);
        set_to_nan(m.v_m, all * NM);
        set_to_nan(m.tau_m, all * NM);
#if MODEL_POSITION
        set_to_nan(m.command_m, all * NM);
        set_to_nan(m.command_g, all * NG);
#endif /* MODEL_POSITION */
    }
}

model_status model_invert_many(const model_problems *problems, const model_samples *samples,
#if MODEL_PARAMETERS > 0
    const real *parameters,
#endif
    const real *q_start, const model_inversion_options *options, model_motion *motion,
    model_invert_info *info, model_status *statuses, real *work, int64_t work_size)
{
    const problem_arrays a = {
        problems, samples, GIVEN_PARAMETERS, q_start, options, motion, info, statuses};
    model_status first = MODEL_OK;
    int64_t wanted;
    if (problems == NULL || samples == NULL || a.parameters == NULL || q_start == NULL ||
        options == NULL || motion == NULL || info == NULL || statuses == NULL || work == NULL ||
        samples->y == NULL || samples->dy == NULL || samples->ddy == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    wanted = model_invert_work(samples->n, options);
    if (problems->count < 0 || wanted < 0) {
        return problems->count < 0 ? MODEL_BAD_COUNT : MODEL_BAD_ARGUMENT;
    }
    if (work_size < wanted) {
        return MODEL_WORK_TOO_SMALL;
    }
    for (ptrdiff_t k = 0; k < problems->count; ++k) {
        invert_problem(&a, k, work, work_size);
        first = first == MODEL_OK && statuses[k] < 0 ? statuses[k] : first;
    }
    return first;
}
