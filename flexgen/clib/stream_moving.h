/*
 * model: the start of a stream in motion, from samples of the path before now and ahead; private to it.
 *
 * The first state of the horizon is not known. In stable directions it is the quasi-static motion of the past: what the
 * zero dynamics remembers of older motion has decayed. In unstable directions it follows from the path ahead, where the
 * cost to go P, p of the first node is least,
 *
 *     min over d   d' P d / 2 + p' d + w |y_0 + d - y_quasi-static|^2 / 2
 *
 * with a weight w far above the cost of stable directions and far below that of unstable ones.
 */
#ifndef MODEL_STREAM_MOVING_H
#define MODEL_STREAM_MOVING_H

#include "model_quasistatic_end.h"
#include "model_stream_shift.h"

/* Path nodes before now, as far back as the differences of any stream; updates whose results are not given. */
enum { PAST_NODES = 7, SILENT_UPDATES = MODEL_STREAM_START_SAMPLES(0) - 1 - PAST_NODES };

/* Copy sample k of a path. */
static inline void sample_of(const model_path *p, ptrdiff_t k, real *out)
{
    copy(p->y + k * NT, NT, out);
    copy(p->dy + k * NY, NY, out + NT);
    copy(p->ddy + k * NY, NY, out + NT + NY);
}

/* The path of the horizon and before it: node 0 of the horizon is sample `now`. */
static inline void set_path(real *s, const layout *l, const model_path *p, ptrdiff_t now)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    real *nodes = s + l->nodes;
    for (ptrdiff_t j = 0; j <= l->past + N; ++j) {
        sample_of(p, now - l->past + j, nodes + j * REFERENCE);
    }
    for (ptrdiff_t k = 0; k < N * STAGES; ++k) {
        const real *left = nodes + (l->past + k / STAGES) * REFERENCE;
        between_samples(left, s[PERIOD], gauss_c[k % STAGES], s + l->reference + k * REFERENCE);
    }
    copy(nodes + (l->past + N) * REFERENCE, REFERENCE, s + l->last);
}

/* Joints that follow the path of the horizon from those at its start, with the deflections of the equilibrium q. */
static inline int set_joints(real *s, const layout *l, const real *q)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
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
    for (ptrdiff_t k = 0; k < N * STAGES; ++k) { /* one after the other: each is the guess of the next */
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
        if (!(arm->side[0] * (k > 0 ? s[SIDE] : arm->side[0]) > 0.0)) {
            return MODEL_UNREACHABLE; /* it passed a singular pose */
        }
        s[SIDE] = arm->side[0];
        for (int i = 0; i < NG; ++i) {
            q_g[k * NG + i] = last[i] = arm->q[i_g[i]][0];
        }
    }
    return MODEL_OK;
}

#if MODEL_NE > 0

enum { MOVING_STEPS = 6 }; /* Gauss-Newton steps; the problem is almost linear in the deflections */

static const real first_state_weight = PRECISE(1e-6, 1e-3);

/* The quasi-static motion at all nodes as target states, and a motion close to it in the mesh. */
static inline int set_quasistatic(real *s, const layout *l)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS], guess_at = (N * STAGES - 1) * NG;
    mesh m = mesh_of(l, s);
    real last[NG], *y = s + l->y, *a = s + l->a, *newest = m.target_state + N * STATES;
    copy(s + l->q_g + guess_at, NG, last);
    for (ptrdiff_t j = LAST - 1; j <= l->past + N; ++j) { /* the first one twice: Newton's method converges */
        for (int again = j == LAST - 1 ? 2 : 1; again > 0; --again) {
            const ptrdiff_t k = j < l->past ? 0 : j - l->past < N ? j - l->past : N - 1;
            int status;
            copy(s + l->q_g + k * STAGES * NG, NG, s + l->q_g + guess_at);
            status = quasistatic_motion(
                &m, (lq_space *)(void *)(s + l->lq), s + l->levels, s + l->nodes + j * REFERENCE, s + l->space);
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
    s[STALE] = 1.0; /* only the factors are known */
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
static inline int set_moving(real *s, const layout *l, const model_path *p, ptrdiff_t now, const real *q)
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

#endif
