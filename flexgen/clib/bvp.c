/*
 * model: inverse dynamics along a path as a two-point boundary value problem. Written by flexgen; see
 * model_inversion.h.
 *
 * At the start the state may differ from the equilibrium by the unstable part of the zero dynamics, at the end by the
 * stable part. Between them the equations hold at the Gauss points, and Newton's method solves all of them together.
 * There are no weights, so that bvp is an independent check of invert. The zero dynamics must have the same numbers of
 * stable and unstable motions at both ends.
 */
#include "model_inversion.h"

#include "model_bvp_elimination.h"
#include "model_dichotomy.h"
#include "model_equilibrium.h"
#include "model_whole_path.h"

static const real newton_target = 1e-6; /* of the tolerance: Newton's method gets there in one more step */

/* Where the arrays of this solver are, after those of both. */
typedef struct {
    int64_t problem, blocks, end;
} bvp_layout;

static bvp_layout lay_out_bvp(const whole_layout *l)
{
    bvp_layout own;
    int64_t at = l->end;
    TAKE(at, own.problem, (int64_t)((sizeof(bvp_problem) + sizeof(real) - 1) / sizeof(real)));
    TAKE(at, own.blocks, (int64_t)(sizeof(bvp_space) / sizeof(real)));
    own.end = at;
    return own;
}

int64_t model_bvp_work(int n, const model_inversion_options *options)
{
    whole_layout l;
    int64_t end;
    if (options == NULL || !path_sizes_fit(n, options)) {
        return -1;
    }
    l = lay_out(n, options, INTERVAL_FACTOR, 0);
    end = lay_out_bvp(&l).end;
    return is_addressable(end) ? end : -1;
}

/* The boundary rows at both ends, from the equilibrium q; the numbers of unstable zeros go to `info`. */
static int set_boundary_rows(
    bvp_problem *b, const model_path *p, const real *q, bvp_space *w, model_inversion_info *info, real *space)
{
    const real *target = p->y + (p->n - 1) * (ptrdiff_t)NT;
    const real *q_g = b->m.q_g + ((ptrdiff_t)b->m.N * STAGES - 1) * NG;
    real end[NA], scale[NE];
    zero_dynamics at;
    int unstable, status;
    status = zero_dynamics_at(p->y, q, &w->lq.arm, space, &at);
    if (status == MODEL_OK) {
        status = boundary_rows(&at, 1, b->first, &b->from_start, &unstable);
    }
    if (status != MODEL_OK) {
        return status;
    }
    info->unstable_zeros_start = unstable;
    copy(q, NA, end);
    for (int i = 0; i < NG; ++i) {
        end[i_g[i]] = q_g[i];
    }
    status = equilibrium_at(target, end, scale, space);
    if (status == MODEL_OK) {
        status = zero_dynamics_at(target, end, &w->lq.arm, space, &at);
    }
    if (status == MODEL_OK) {
        status = boundary_rows(&at, 0, b->last, &b->from_end, &unstable);
    }
    if (status != MODEL_OK) {
        return status;
    }
    info->unstable_zeros_end = unstable;
    for (int i = 0; i < NE; ++i) {
        b->equilibrium_start[i] = q[i_e[i]];
        b->equilibrium_end[i] = end[i_e[i]];
        b->equilibrium_start[NE + i] = b->equilibrium_end[NE + i] = 0.0;
    }
    return b->from_start + b->from_end == STATES ? MODEL_OK : MODEL_ZEROS_CHANGE;
}

/* The motion on the mesh by Newton steps. */
static int solve_bvp(bvp_problem *b, real tolerance, model_inversion_info *info, bvp_space *w, real *space)
{
    newton progress = {-1.0, 0, 0};
    for (;;) {
        int state, status = bvp_factor(b, w, space);
        if (status == MODEL_OK) {
            back_substitute(b, w);
            status = bvp_residual(b, w, space);
            info->residual = b->m.residual;
            info->iterations = progress.steps + 1;
        }
        if (status != MODEL_OK) {
            return b->turns && status == MODEL_NOT_CONVERGED ? (int)MODEL_ZERO_AT_INFINITY : status;
        }
        state = newton_state(&progress, b->m.residual, tolerance, newton_target);
        if (state != NEWTON_CONTINUES) {
            if (b->turns) {
                return MODEL_ZERO_AT_INFINITY;
            }
            return state == NEWTON_CONVERGED ? MODEL_OK : MODEL_NOT_CONVERGED;
        }
    }
}

model_status model_bvp(const model_path *p, PARAMETERS_ARGUMENT const real q_start[MODEL_NA],
    const model_inversion_options *options, model_motion *motion, model_inversion_info *info, real *work,
    int64_t work_size)
{
    const int64_t wanted = p == NULL ? -1 : model_bvp_work(p->n, options);
    whole_layout l;
    bvp_layout own;
    bvp_problem *b;
    bvp_space *w;
    real q[NA];
    int status = check_arguments(p, GIVEN_PARAMETERS, q_start, options, motion, info, work, work_size, wanted);
    if (status == MODEL_OK && options->settled > 0.0) {
        status = MODEL_BAD_ARGUMENT;
    }
    if (status != MODEL_OK) {
        return (model_status)status;
    }
    copy(q_start, NA, q);
    l = lay_out(p->n, options, INTERVAL_FACTOR, 0);
    own = lay_out_bvp(&l);
    keep_parameters(GIVEN_PARAMETERS, work + l.space);
    b = (bvp_problem *)(void *)(work + own.problem);
    w = (bvp_space *)(void *)(work + own.blocks);
    b->m = mesh_in(&l, p, options, work);
    info->intervals = b->m.N;
    status = equilibrium_at(p->y, q, b->m.scale, work + l.space);
    if (status == MODEL_OK) {
        status = guess_mesh(&b->m, p, q, options->n_pre, options->samples_per_interval, &w->lq.arm, work + l.space);
    }
    if (status == MODEL_OK) {
        status = set_boundary_rows(b, p, q, w, info, work + l.space);
    }
    if (status == MODEL_OK) {
        status = solve_bvp(b, options->tolerance, info, w, work + l.space);
    }
    if (status != MODEL_OK) {
        return (model_status)status;
    }
    return finish(p, options, &l, q, &b->m, q, (ptrdiff_t)l.samples, &w->lq.arm, motion, info, work);
}
