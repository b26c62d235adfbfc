/* elbow: inverse dynamics on a moving horizon. Written by flexgen; see elbow.h. */
#include "elbow.h"

#include "elbow_limits.h"
#include "elbow_rest.h"
#include "elbow_samples.h"

/*
 * The memory of a stream is an array of numbers of the caller: a head, then arrays. Between two updates it holds the
 * motion that is planned over the horizon; an update shifts it by one interval, takes the next sample of the path at
 * its end and does one Gauss-Newton step.
 */
enum {
    IS_EMPTY = 0,
    IS_RUNNING = 20231, /* no number that memory holds by chance */
    HAS_FAILED = 2,
    BACK = 2 * MARGIN, /* fine samples before and after those of an update that its derivatives need */
    MOST_INTERVALS = 10000,
    MOST_PARTS = 1000,
    WARMING = 10,
    LEVELS = 3,
    LAST = 5, /* nodes of the path that tell where it goes on */
    LEAST_AHEAD = 4, /* intervals of a horizon that can be bent */
    JOINT = 3 * NG,  /* position, speed and acceleration of the joints with motor */
    FORGETS = 4,     /* times in a horizon */
    MEASURES = 4     /* of unevenness: accelerations of joints and motors, speeds, torques of the rotors */
};

enum { STATE, INTERVALS, PARTS, PERIOD, TOLERANCE, SIDE, HEAD };

typedef struct {
    ptrdiff_t window; /* fine samples: before, of this update, ahead */
    ptrdiff_t past;   /* intervals that are over and remembered */
    ptrdiff_t limits; /* bounds of the motors, and what they bend */
    ptrdiff_t last, tau, twist, late, now, joint, most, q_g, reference, nodes, lq, space, end;
    ptrdiff_t y, a, a_node, factor, scale, aim, cost, levels;
} layout;

static layout laid_out(int intervals, int parts)
{
    layout l;
    ptrdiff_t at = (ptrdiff_t)room(HEAD);
    l.window = BACK + (ptrdiff_t)parts + BACK;
    l.past = (BACK + parts - 1) / parts + 1;
    l.past = l.past < LAST - 1 ? LAST - 1 : l.past;
#define PLACE(name, size) \
    l.name = at; \
    at += (ptrdiff_t)room(size)
    PLACE(limits, limits_laid_out(intervals).end);
    PLACE(last, REFERENCE);
    PLACE(tau, l.window * NG);
    PLACE(twist, l.window * NG);
    PLACE(late, l.window * NG);
    PLACE(now, NG);
    PLACE(joint, l.window * JOINT);
    PLACE(most, MEASURES);
    PLACE(q_g, ((ptrdiff_t)intervals * STAGES + 1) * NG); /* the last ones: joints at the start of the horizon */
    PLACE(reference, (ptrdiff_t)intervals * STAGES * REFERENCE);
    PLACE(nodes, (l.past + intervals + 1) * REFERENCE);
#if ELBOW_NE > 0
    PLACE(y, (l.past + intervals + 1) * STATES);
    PLACE(a, (l.past + intervals) * CONTROLS);
    PLACE(a_node, (l.past + intervals + 1) * NE);
    PLACE(factor, (ptrdiff_t)intervals * CONTROLS * WIDTH);
    PLACE(scale, NE);
    PLACE(levels, LEVELS * LAST * NE);
    PLACE(cost, STATES * STATES);
    PLACE(aim, ((ptrdiff_t)intervals + 1) * STATES);
    PLACE(lq, (ptrdiff_t)(sizeof(lq_space) / sizeof(real)));
#else
    l.y = l.a = l.a_node = l.factor = l.scale = l.aim = l.cost = l.levels = 0;
    PLACE(lq, (ptrdiff_t)(sizeof(arm_points) / sizeof(real)));
#endif
    PLACE(space, space_wanted());
#undef PLACE
    l.end = at;
    return l;
}

static int sizes_fit(int intervals, int parts)
{
    return intervals >= 1 && intervals <= MOST_INTERVALS && parts >= 1 && parts <= MOST_PARTS;
}

/* Whether memory holds a stream that was started and has not failed; it may hold anything. */
static int is_running(const real *stream)
{
    return stream[STATE] == IS_RUNNING && stream[INTERVALS] >= 1.0 && stream[INTERVALS] <= MOST_INTERVALS &&
        stream[PARTS] >= 1.0 && stream[PARTS] <= MOST_PARTS;
}

int64_t elbow_stream_work(int intervals, int parts)
{
    return sizes_fit(intervals, parts) ? (int64_t)laid_out(intervals, parts).end : -1;
}

#if ELBOW_NE > 0
static mesh mesh_of(const layout *l, real *s)
{
    mesh m;
    m.N = (int)s[INTERVALS];
    m.h = s[PERIOD];
    m.y = s + l->y + l->past * STATES;
    m.a = s + l->a + l->past * CONTROLS;
    m.q_g = s + l->q_g;
    m.reference = s + l->reference;
    m.aim = s + l->aim;
    m.rest = NULL;
    m.factor = s + l->factor;
    m.scale = s + l->scale;
    /*
     * The node where the horizon begins cannot be changed. What has gone wrong there grows like the unstable zeros, and
     * must cost something at the end. The cost to go of the horizon before is just that: it is next to nothing where
     * errors fade, and weighs what has to be mended.
     */
    m.end = s + l->cost;
    m.residual = 0.0;
    return m;
}
#endif

static void copy(const real *from, ptrdiff_t n, real *to)
{
    for (ptrdiff_t i = 0; i < n; ++i) {
        to[i] = from[i];
    }
}

int elbow_stream_start(double *stream, int64_t stream_size, int intervals, int parts, double period, double tolerance,
    const double *place, const double *q_start)
{
    layout l;
    real q[NA], *space;
    int status;
    if (stream == NULL || place == NULL || q_start == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!sizes_fit(intervals, parts) || !(period > 0.0 && period < 1e6) || !(tolerance > 0.0 && tolerance < 1.0)) {
        return ELBOW_BAD_ARGUMENT;
    }
    l = laid_out(intervals, parts);
    if (stream_size < l.end) {
        return ELBOW_WORK_TOO_SMALL;
    }
    stream[STATE] = IS_EMPTY;
    if (!is_finite(place, NT) || !is_finite(q_start, NA)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
#if ELBOW_POSE
    if (!is_rotation(place + 3)) {
        return ELBOW_BAD_ARGUMENT;
    }
#endif
    space = stream + l.space;
    copy(q_start, NA, q);
    stream[INTERVALS] = intervals;
    stream[PARTS] = parts;
    stream[PERIOD] = period;
    stream[TOLERANCE] = tolerance;
    stream[l.limits] = 0.0;
    for (int i = 0; i < MEASURES; ++i) {
        stream[l.most + i] = 0.0;
    }
    stream[SIDE] = 0.0; /* of singular poses: not known before the first sample */
    status = rest_at(place, q, stream + l.scale, space);
    if (status != ELBOW_OK) {
        return status;
    }
    copy(place, NT, stream + l.last);
    for (int i = NT; i < REFERENCE; ++i) {
        stream[l.last + i] = 0.0;
    }
    for (ptrdiff_t k = 0; k < (ptrdiff_t)intervals * STAGES; ++k) {
        copy(stream + l.last, REFERENCE, stream + l.reference + k * REFERENCE);
    }
    for (ptrdiff_t k = 0; k <= l.past + intervals; ++k) {
        copy(stream + l.last, REFERENCE, stream + l.nodes + k * REFERENCE);
    }
    for (ptrdiff_t k = 0; k <= (ptrdiff_t)intervals * STAGES; ++k) {
        for (int i = 0; i < NG; ++i) {
            stream[l.q_g + k * NG + i] = q[i_g[i]];
        }
    }
#if ELBOW_NE > 0
    for (ptrdiff_t k = 0; k <= l.past + intervals; ++k) {
        for (int i = 0; i < NE; ++i) {
            stream[l.y + k * STATES + i] = q[i_e[i]];
            stream[l.y + k * STATES + NE + i] = 0.0;
        }
    }
    for (ptrdiff_t k = 0; k < (l.past + intervals) * CONTROLS; ++k) {
        stream[l.a + k] = 0.0;
    }
    copy(stream + l.y, ((ptrdiff_t)intervals + 1) * STATES, stream + l.aim);
    for (int k = 0; k < LEVELS * LAST; ++k) {
        copy(stream + l.y, NE, stream + l.levels + k * NE);
    }
#endif
#if ELBOW_NE > 0
    {
        mesh still = mesh_of(&l, stream);
        status = lq_endless(&still, WARMING, (lq_space *)(void *)(stream + l.lq), space, stream + l.cost);
        if (status != ELBOW_OK) {
            return status;
        }
    }
#endif
    { /* gears at rest */
        static const real zero[NA] = {0.0};
        real tau[NG], twist[NG], slope[NG];
#if ELBOW_NE > 0
        real row[NE];
        status = inner(elbow_inversion_rows(q, zero, zero, tau, row, space));
#else
        status = inner(elbow_inversion_rows(q, zero, zero, tau, space));
#endif
        if (status != ELBOW_OK) {
            return status;
        }
        for (int i = 0; i < NG; ++i) {
            twist[i] = 0.0;
        }
        if (!static_twist(tau, twist, slope, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        copy(twist, NG, stream + l.now);
    }
    stream[STATE] = IS_RUNNING;
    return ELBOW_OK;
}

#if ELBOW_NE > 0
/* One Newton step of R(q, v, a) = 0 in q at the last nodes of the path, newest first; changes q. */
static int balance(const mesh *m, lq_space *w, const real *newest, real v[LAST][NE], real a[LAST][NE], real *q,
    real *space)
{
    int status;
    for (int l = 0; l < POINTS; ++l) {
        const int node = l < LAST ? l : LAST - 1;
        load_reference(&w->arm, l, newest - node * (ptrdiff_t)REFERENCE);
        for (int i = 0; i < NE; ++i) {
            w->arm.q[i_e[i]][l] = q[node * NE + i];
            w->arm.v[i_e[i]][l] = v[node][i];
            w->arm.a[i_e[i]][l] = a[node][i];
        }
        for (int i = 0; i < NG; ++i) {
            w->arm.q[i_g[i]][l] = m->q_g[((ptrdiff_t)m->N * STAGES - 1) * NG + i];
            w->arm.v[i_g[i]][l] = 0.0;
            w->arm.a[i_g[i]][l] = 0.0;
        }
    }
    status = follow(&w->arm, space);
    if (status == ELBOW_OK) {
        status = reduce(&w->arm, space);
    }
    if (status != ELBOW_OK) {
        return status;
    }
    for (int node = 0; node < LAST; ++node) {
        real K[NE][NE], b[NE];
        for (int i = 0; i < NE; ++i) {
            for (int j = 0; j < NE; ++j) {
                K[i][j] = w->arm.K[j][i][node];
            }
            b[i] = w->arm.row[i][node];
        }
        for (int k = 0; k < NE; ++k) { /* stiffness dominates: a pivot that is none leaves the deflection as it was */
            for (int i = k + 1; i < NE; ++i) {
                const real f = fabs_1(K[k][k]) > 0.0 ? K[i][k] / K[k][k] : 0.0;
                for (int j = k; j < NE; ++j) {
                    K[i][j] -= f * K[k][j];
                }
                b[i] -= f * b[k];
            }
        }
        for (int k = NE - 1; k >= 0; --k) {
            for (int j = k + 1; j < NE; ++j) {
                b[k] -= K[k][j] * b[j];
            }
            b[k] = fabs_1(K[k][k]) > 0.0 ? b[k] / K[k][k] : 0.0;
        }
        for (int i = 0; i < NE; ++i) {
            q[node * NE + i] -= fabs_1(b[i]) < 1.0 ? b[i] : 0.0;
        }
    }
    return ELBOW_OK;
}

/*
 * What the end of the horizon is drawn to: the slow motion, deflections in balance with gravity and the path. First as
 * if they did not move; then with the speeds and accelerations that this motion has, by differences of its last
 * values; and so on. Each level gains the ratio of the time constants of zeros and path. All nodes are balanced anew
 * with the path of today: where limits bend it from update to update, differences to what was there before are wrong.
 */
static int slow_motion(mesh *m, lq_space *w, real *levels, const real *newest, real *space)
{
    static const real once[LAST][LAST] = {{25.0, -48.0, 36.0, -16.0, 3.0}, {3.0, 10.0, -18.0, 6.0, -1.0},
        {-1.0, 8.0, 0.0, -8.0, 1.0}, {1.0, -6.0, 18.0, -10.0, -3.0}, {-3.0, 16.0, -36.0, 48.0, -25.0}};
    static const real twice[LAST][LAST] = {{35.0, -104.0, 114.0, -56.0, 11.0}, {11.0, -20.0, 6.0, 4.0, -1.0},
        {-1.0, 16.0, -30.0, 16.0, -1.0}, {-1.0, 4.0, 6.0, -20.0, 11.0}, {11.0, -56.0, 114.0, -104.0, 35.0}};
    real v[LAST][NE] = {{0.0}}, a[LAST][NE] = {{0.0}};
    real *x = levels;
    for (int level = 0; level < LEVELS; ++level) {
        int status;
        x = levels + (ptrdiff_t)level * LAST * NE;
        for (int k = LAST - 1; k > 0; --k) {
            copy(x + (k - 1) * NE, NE, x + k * NE);
        }
        status = balance(m, w, newest, v, a, x, space);
        if (status != ELBOW_OK) {
            return status;
        }
        for (int k = 0; k < LAST; ++k) {
            for (int i = 0; i < NE; ++i) {
                v[k][i] = a[k][i] = 0.0;
                for (int j = 0; j < LAST; ++j) {
                    v[k][i] += once[k][j] * x[j * NE + i] / (12.0 * m->h);
                    a[k][i] += twice[k][j] * x[j * NE + i] / (12.0 * m->h * m->h);
                }
            }
        }
    }
    {
        real *aim = m->aim + m->N * (ptrdiff_t)STATES;
        copy(x, NE, aim);
        copy(v[0], NE, aim + NE);
    }
    return ELBOW_OK;
}
#endif

/* The path at x, 0 <= x <= 1, between two of its samples that stand one after the other. */
static void between_samples(const real *samples, real period, real x, real *out)
{
    real place[2 * NT], rate[2 * NY], rate2[2 * NY];
    const path two = {2, period, place, rate, rate2};
    for (int j = 0; j < 2; ++j) {
        copy(samples + j * REFERENCE, NT, place + j * NT);
        copy(samples + j * REFERENCE + NT, NY, rate + j * NY);
        copy(samples + j * REFERENCE + NT + NY, NY, rate2 + j * NY);
    }
    reference_at(&two, 0, x, out);
}

/* What an update says when it fails after its sample was taken; UNREACHABLE would mean that it was refused. */
static int over(real *stream, int status)
{
    stream[STATE] = HAS_FAILED;
    return status == ELBOW_UNREACHABLE ? ELBOW_NOT_CONVERGED : status;
}

/* Motion, torques, and motors of the interval that begins now. */
static int put_out(real *s, const layout *l, real *q_a, real *v_a, real *tau_g, real *q_m, real *v_m, real *tau_m,
    real *worst)
{
    const int parts = (int)s[PARTS], intervals = (int)s[INTERVALS];
    const real fine = s[PERIOD] / parts;
    real *space = s + l->space;
    real left[NG][3] = {{0.0}}, right[NG][3] = {{0.0}};
    arm_points *arm;
    int quick[NG];
    real last[NG], linear[NG][4];
#if ELBOW_NE > 0
    mesh m = mesh_of(l, s);
    interpolant f;
    arm = &((lq_space *)(void *)(s + l->lq))->arm;
    m.y = s + l->y; /* with what is over */
    m.a = s + l->a;
    m.N += (int)l->past;
    prepare(&f);
    nodal_accelerations(&m, s + l->a_node);
#else
    arm = (arm_points *)(void *)(s + l->lq);
#endif
    *worst = 0.0;
    /* All from the plan of today, what is over too: the derivatives must not see where plans differ. */
    copy(s + l->q_g + (ptrdiff_t)intervals * STAGES * NG, NG, last);
    for (int at = 0; at < l->window; at += POINTS) {
        const int used = (int)(l->window - at < POINTS ? l->window - at : (ptrdiff_t)POINTS);
        int status;
        for (int point = 0; point < POINTS; ++point) {
            const int k = at + (point < used ? point : used - 1) - BACK + (int)l->past * parts;
            const int end = (int)l->past + intervals;
            const int interval = k / parts < end ? k / parts : end - 1;
            const real x = k / parts < end ? (real)(k - interval * parts) / parts : 1.0;
            real reference[REFERENCE];
            between_samples(s + l->nodes + interval * (ptrdiff_t)REFERENCE, s[PERIOD], x, reference);
            load_reference(arm, point, reference);
            for (int i = 0; i < NG; ++i) {
                arm->q[i_g[i]][point] = last[i];
                arm->v[i_g[i]][point] = 0.0;
                arm->a[i_g[i]][point] = 0.0;
            }
#if ELBOW_NE > 0
            load_elastic(&m, s + l->a_node, &f, interval, x, arm, point);
#endif
        }
        status = torques(arm, space);
        if (status != ELBOW_OK) {
            return status;
        }
        for (int point = 0; point < used; ++point) {
            const int k = at + point - BACK;
            real *joint = s + l->joint + (k + BACK) * (ptrdiff_t)JOINT;
            if (!(arm->side[point] * s[SIDE] > 0.0)) {
                return ELBOW_UNREACHABLE; /* deflections brought it to the other side of a singular pose */
            }
            for (int i = 0; i < NG; ++i) {
                s[l->tau + (k + BACK) * (ptrdiff_t)NG + i] = arm->tau_g[i][point];
                last[i] = arm->q[i_g[i]][point];
                joint[i] = arm->q[i_g[i]][point];
                joint[NG + i] = arm->v[i_g[i]][point];
                joint[2 * NG + i] = arm->a[i_g[i]][point];
            }
            if (k < 0 || k >= parts) {
                continue;
            }
            for (int i = 0; i < NA; ++i) {
                q_a[k * NA + i] = arm->q[i][point];
                v_a[k * NA + i] = arm->v[i][point];
            }
            copy(s + l->tau + (k + BACK) * (ptrdiff_t)NG, NG, tau_g + k * NG);
            if (k == parts - 1) {
                copy(last, NG, s + l->q_g + (ptrdiff_t)intervals * STAGES * NG);
            }
#if ELBOW_NE > 0
            for (int i = 0; i < NE; ++i) {
                *worst = fmax_1(*worst, fabs_1(arm->row[i][point]) / m.scale[i]);
            }
#endif
        }
    }
    if (!which_follow_at_once(fine, quick, space)) {
        return ELBOW_RESULT_NOT_FINITE;
    }
    copy(s + l->now, NG, last);
    for (ptrdiff_t k = 0; k < l->window; ++k) {
        real slope[NG];
        if (!static_twist(s + l->tau + k * NG, last, slope, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        copy(last, NG, s + l->twist + k * NG);
        if (k == 0) {
            linear_steps(fine, slope, linear);
        }
    }
    {
        int slow = 0;
        real now[NG];
        for (int i = 0; i < NG; ++i) {
            slow |= !quick[i];
        }
        copy(s + l->now, NG, now);
        for (ptrdiff_t k = MARGIN; k + MARGIN < l->window; ++k) {
            const real *tau = s + l->tau + k * NG, *twist = s + l->twist + k * NG;
            real value[NG], slope[NG];
            if (slow && k >= BACK && k <= BACK + parts) {
                for (int i = 0; i < NG; ++i) {
                    copy(right[i], 3, left[i]);
                    right[i][0] = tau[i];
                    right[i][1] = fine * slope_of(tau + i, NG, fine);
                    right[i][2] = fine * fine * curvature_of(tau + i, NG, fine);
                }
                if (k > BACK && !twist_step(fine, linear, left, right, now, space)) {
                    return ELBOW_RESULT_NOT_FINITE;
                }
                if (k == BACK + parts) {
                    copy(now, NG, s + l->now);
                }
            }
            if (elbow_gear_law(twist, value, slope, space) != ELBOW_OK) {
                return ELBOW_RESULT_NOT_FINITE;
            }
            for (int i = 0; i < NG; ++i) {
                const real lag = gear_is_rigid[i] ? 0.0 : gear_damping[i] / slope[i];
                s[l->late + k * NG + i] = quick[i] ? twist[i] - lag * slope_of(twist + i, NG, fine) : now[i];
            }
        }
    }
    for (ptrdiff_t k = 0; k < parts; ++k) {
        const real *tau = s + l->tau + (k + BACK) * NG, *twist = s + l->late + (k + BACK) * NG;
        const real *joint = s + l->joint + (k + BACK) * JOINT;
        real value[NG], slope[NG], theta[NG], omega[NG], alpha[NG];
        if (elbow_gear_law(twist, value, slope, space) != ELBOW_OK) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        for (int i = 0; i < NG; ++i) {
            real once, twice;
            if (quick[i]) {
                once = slope_of(twist + i, NG, fine);
                twice = curvature_of(twist + i, NG, fine);
            } else {
                once = (tau[i] - value[i]) / gear_damping[i];
                twice = (slope_of(tau + i, NG, fine) - slope[i] * once) / gear_damping[i];
            }
            theta[i] = joint[i] + twist[i];
            omega[i] = joint[NG + i] + once;
            alpha[i] = joint[2 * NG + i] + twice;
        }
        if (!motors_of(theta, omega, alpha, tau, q_m + k * NM, v_m + k * NM, tau_m + k * NM, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
    }
    return ELBOW_OK;
}

/*
 * How far positions and speeds of joints and motors in this interval are from being integrals of speeds and
 * accelerations, by differences, like `unevenness` of a whole path. Relative to the largest of these within about a
 * horizon: what was, which is forgotten by and by, what is, and what the joints will do. Twists as if nothing damped
 * them: damping makes them smoother. Differences that need more than the horizon holds are wrong, and seen here.
 */
static real unevenness_now(real *s, const layout *l)
{
    const ptrdiff_t parts = (ptrdiff_t)s[PARTS], N = (ptrdiff_t)s[INTERVALS];
    const real h = s[PERIOD], fine = h / (real)parts, sixty = 60.0 * fine;
    real most[MEASURES] = {1e-4, 1e-2, 1e-7, 1e-4}; /* least that is measured: rest is rest but for rounding */
    real off[MEASURES] = {0.0}, worst = 0.0;
    for (ptrdiff_t k = 0; k < parts; ++k) {
        real a_of[NG], miss[NG];
        for (int i = 0; i < NG; ++i) {
            const real *q = s + l->joint + (k + BACK) * JOINT + i, *v = q + NG, a = q[2 * NG];
            const real *twist = s + l->twist + (k + BACK) * NG + i;
            real speed[2 * MARGIN + 1];
            for (ptrdiff_t j = -MARGIN; j <= MARGIN; ++j) {
                speed[j + MARGIN] = v[j * JOINT] + slope_of(twist + j * NG, NG, fine);
            }
            a_of[i] = a + curvature_of(twist, NG, fine);
            miss[i] = sixty_differences(speed + MARGIN, 1) - sixty * a_of[i];
            most[0] = fmax_1(most[0], fabs_1(a));
            most[2] = fmax_1(most[2], fabs_1(v[0]));
            off[0] = fmax_1(off[0], fabs_1(sixty_differences(v, JOINT) - sixty * a));
            off[2] = fmax_1(off[2], fabs_1(sixty_differences(q, JOINT) - sixty * v[0]));
        }
        for (int j = 0; j < NM; ++j) {
            real a = 0.0, b = 0.0;
            for (int i = 0; i < NG; ++i) {
                a += eta[j][i] * a_of[i];
                b += eta[j][i] * miss[i];
            }
            most[1] = fmax_1(most[1], fabs_1(a));
            most[3] = fmax_1(most[3], rotor_inertia[j] * fabs_1(a));
            off[1] = fmax_1(off[1], fabs_1(b));
            off[3] = fmax_1(off[3], rotor_inertia[j] * fabs_1(b));
        }
    }
    for (ptrdiff_t k = 1; k + 1 < N; ++k) {
        const real *q = s + l->q_g + k * STAGES * NG;
        real a[NG];
        for (int i = 0; i < NG; ++i) {
            const real before = q[i - STAGES * NG], after = q[i + STAGES * NG];
            a[i] = (after - 2.0 * q[i] + before) / (h * h);
            most[0] = fmax_1(most[0], fabs_1(a[i]));
            most[2] = fmax_1(most[2], fabs_1(after - before) / (2.0 * h));
        }
        for (int j = 0; j < NM; ++j) {
            real sum = 0.0;
            for (int i = 0; i < NG; ++i) {
                sum += eta[j][i] * a[i];
            }
            most[1] = fmax_1(most[1], fabs_1(sum));
            most[3] = fmax_1(most[3], rotor_inertia[j] * fabs_1(sum));
        }
    }
    for (int i = 0; i < MEASURES; ++i) {
        most[i] = fmax_1(most[i], s[l->most + i] * (real)N / (real)(N + FORGETS));
        s[l->most + i] = most[i];
        worst = fmax_1(worst, off[i] / (sixty * most[i]));
    }
    return worst;
}

static const real broken = 2.5; /* of a bound: limits passed by more are not kept at all, and the stream ends */

int elbow_stream_limits(double *stream, const double *torques_most, const double *speeds_most, double bend_max)
{
    layout l;
    limits_layout w;
    ptrdiff_t N;
    real *b;
    if (stream == NULL || torques_most == NULL || speeds_most == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return ELBOW_NOT_STARTED;
    }
    N = (ptrdiff_t)stream[INTERVALS];
    if (!(bend_max > 0.0 && bend_max < 1e6)) {
        return ELBOW_BAD_ARGUMENT;
    }
    for (int i = 0; i < NM; ++i) {
        if (N < LEAST_AHEAD || !(torques_most[i] > 0.0 && speeds_most[i] > 0.0)) {
            return ELBOW_BAD_ARGUMENT;
        }
    }
    l = laid_out((int)N, (int)stream[PARTS]);
    w = limits_laid_out(N);
    b = stream + l.limits;
    for (int i = 0; i < NM; ++i) {
        b[w.bound + i] = torques_most[i];
        b[w.bound + NM + i] = speeds_most[i];
    }
    for (int i = 0; i < NY; ++i) {
        b[w.bound + MOTORS + i] = bend_max;
    }
    if (!(b[w.on] > 0.0)) {
        copy(stream + l.nodes + l.past * REFERENCE, (N + 1) * REFERENCE, b + w.plan);
        for (ptrdiff_t i = 0; i < (N + 1) * BEND; ++i) {
            b[w.bend + i] = 0.0;
        }
        for (ptrdiff_t i = 0; i < (N + 1) * BOUNDED; ++i) {
            b[w.dual + i] = 0.0;
        }
        b[w.on] = 1.0;
    }
    return ELBOW_OK;
}

/* Node k of the horizon, 0 ... N, into a place of `arm`, with guesses of the joints. */
static void load_node(real *s, const layout *l, ptrdiff_t k, const real *joints, arm_points *arm, int place)
{
    load_reference(arm, place, s + l->nodes + (l->past + k) * REFERENCE);
    for (int i = 0; i < NG; ++i) {
        arm->q[i_g[i]][place] = joints[i];
        arm->v[i_g[i]][place] = 0.0;
        arm->a[i_g[i]][place] = 0.0;
    }
#if ELBOW_NE > 0
    for (int i = 0; i < NE; ++i) {
        const real *y = s + l->y + (l->past + k) * STATES;
        arm->q[i_e[i]][place] = y[i];
        arm->v[i_e[i]][place] = y[NE + i];
        arm->a[i_e[i]][place] = s[l->a_node + (l->past + k) * NE + i];
    }
#endif
}

/* Look whether motors will pass their bounds, and bend the path ahead, from the second node on. */
static int look_ahead(real *s, const layout *l)
{
    const ptrdiff_t N = (ptrdiff_t)s[INTERVALS];
    const real h = s[PERIOD], T = h * (real)N / FADES;
    real *b = s + l->limits, *space = s + l->space, worst = 0.0, joints[NG];
    const limits_layout w = limits_laid_out(N);
    ptrdiff_t where = FIXED + 1;
    slopes_ahead slopes;
    int status;
#if ELBOW_NE > 0
    arm_points *arm = &((lq_space *)(void *)(s + l->lq))->arm;
#else
    arm_points *arm = (arm_points *)(void *)(s + l->lq);
#endif
    copy(s + l->q_g + N * STAGES * NG, NG, joints);
    for (ptrdiff_t at = 0; at <= N; at += POINTS) {
        const ptrdiff_t used = N + 1 - at < POINTS ? N + 1 - at : (ptrdiff_t)POINTS;
        for (int place = 0; place < POINTS; ++place) {
            load_node(s, l, at + (place < used ? place : used - 1), joints, arm, place);
        }
        status = torques(arm, space);
        if (status != ELBOW_OK) {
            return status;
        }
        for (int place = 0; place < used; ++place) {
            for (int i = 0; i < NG; ++i) {
                const ptrdiff_t to = (at + place) * NG + i;
                b[w.q + to] = joints[i] = arm->q[i_g[i]][place];
                b[w.v + to] = arm->v[i_g[i]][place];
                b[w.a + to] = arm->a[i_g[i]][place];
                b[w.tau + to] = arm->tau_g[i][place];
            }
        }
    }
    if (!motors_ahead(b, &w, N, h, space)) {
        return ELBOW_RESULT_NOT_FINITE;
    }
    for (ptrdiff_t k = FIXED + 1; k <= N; ++k) {
        const real here = largest(b + w.value + k * BOUNDED, MOTORS);
        if (here > worst) {
            worst = here;
            where = k;
        }
    }
    if (worst * (1.0 + kept_free) <= 1.0 && largest(b + w.bend, (int)((N + 1) * BEND)) < faded) {
        for (ptrdiff_t i = (FIXED + 1) * BEND; i < (N + 1) * BEND; ++i) {
            b[w.bend + i] = 0.0;
        }
    } else {
        for (int place = 0; place < POINTS; ++place) {
            load_node(s, l, where, b + w.q + where * NG, arm, place);
        }
        status = torques(arm, space);
        if (status != ELBOW_OK) {
            return status;
        }
        if (!slopes_at(arm, b + w.tau + where * NG, b + w.bound, &slopes, space)) {
            return ELBOW_RESULT_NOT_FINITE;
        }
        if (!change_bends(b, &w, N, T, &slopes)) {
            return ELBOW_OK; /* the bends that are there stay */
        }
    }
    for (ptrdiff_t k = 1; k <= N; ++k) {
        bend_reference(b + w.plan + k * REFERENCE, b + w.bend + k * BEND, T, s + l->nodes + (l->past + k) * REFERENCE);
    }
    for (ptrdiff_t k = 1; k < N; ++k) {
        for (int g = 0; g < STAGES; ++g) {
            between_samples(s + l->nodes + (l->past + k) * REFERENCE, h, gauss_c[g],
                s + l->reference + (k * STAGES + g) * REFERENCE);
        }
    }
    copy(s + l->nodes + (l->past + N) * REFERENCE, REFERENCE, s + l->last);
    return ELBOW_OK;
}

int elbow_stream_update(double *stream, const double *place, const double *rate, const double *rate2, double *q_a,
    double *v_a, double *tau_g, double *q_m, double *v_m, double *tau_m, double *report)
{
    layout l;
    limits_layout w;
    real next[REFERENCE], own[REFERENCE], bend[BEND], *limits, *space;
    real worst;
    ptrdiff_t N;
    int bent = 0;
    int status;
    if (stream == NULL || place == NULL || rate == NULL || rate2 == NULL || q_a == NULL || v_a == NULL ||
        tau_g == NULL || q_m == NULL || v_m == NULL || tau_m == NULL || report == NULL) {
        return ELBOW_NULL_ARGUMENT;
    }
    if (!is_running(stream)) {
        return ELBOW_NOT_STARTED;
    }
    if (!is_finite(place, NT) || !is_finite(rate, NY) || !is_finite(rate2, NY)) {
        return ELBOW_INPUT_NOT_FINITE;
    }
    l = laid_out((int)stream[INTERVALS], (int)stream[PARTS]);
    N = (ptrdiff_t)stream[INTERVALS];
    space = stream + l.space;
#if ELBOW_POSE
    if (!is_rotation(place + 3) || !are_near(stream + l.last + 3, place + 3)) {
        return ELBOW_BAD_ARGUMENT;
    }
#endif
    copy(place, NT, next);
    copy(rate, NY, next + NT);
    copy(rate2, NY, next + NT + NY);
    w = limits_laid_out(N);
    limits = stream + l.limits;
    if (limits[w.on] > 0.0) { /* what bends the path there, if nothing further happens */
        copy(next, REFERENCE, own);
        fade(limits + w.bend + N * BEND, (real)FADES / (real)N, bend);
        bend_reference(own, bend, stream[PERIOD] * (real)N / FADES, next);
    }
    { /* the new interval: can the arm get there? If not, the sample is refused and nothing has changed. */
        real both[2][REFERENCE], at[STAGES][REFERENCE];
#if ELBOW_NE > 0
        arm_points *arm = &((lq_space *)(void *)(stream + l.lq))->arm;
#else
        arm_points *arm = (arm_points *)(void *)(stream + l.lq);
#endif
        real joints[STAGES][NG];
        copy(stream + l.last, REFERENCE, both[0]);
        copy(next, REFERENCE, both[1]);
        for (int point = 0; point < POINTS; ++point) {
            const int s = point < STAGES ? point : STAGES - 1;
            if (point < STAGES) {
                between_samples(both[0], stream[PERIOD], gauss_c[s], at[s]);
            }
            load_reference(arm, point, at[s]);
            for (int i = 0; i < NG; ++i) { /* straight on: through a singular pose rather than back from it */
                const real *joint = stream + l.q_g + (N * STAGES - 1) * NG + i;
                const real onward = (1.0 + gauss_c[s] - gauss_c[2]) / (gauss_c[2] - gauss_c[1]);
                arm->q[i_g[i]][point] = joint[0] + onward * (joint[0] - joint[-NG]);
                arm->v[i_g[i]][point] = 0.0;
                arm->a[i_g[i]][point] = 0.0;
            }
#if ELBOW_NE > 0
            for (int i = 0; i < NE; ++i) {
                const real *y = stream + l.y + N * STATES;
                arm->q[i_e[i]][point] = y[i] + gauss_c[s] * stream[PERIOD] * y[NE + i];
                arm->v[i_e[i]][point] = y[NE + i];
                arm->a[i_e[i]][point] = 0.0;
            }
#endif
        }
        status = follow(arm, space);
        if (status != ELBOW_OK) {
            return status;
        }
        for (int s = 0; s < STAGES; ++s) {
            if (!(arm->side[s] * (fabs_1(stream[SIDE]) > 0.0 ? stream[SIDE] : arm->side[0]) > 0.0)) {
                return ELBOW_UNREACHABLE; /* on the other side of a singular pose */
            }
            for (int i = 0; i < NG; ++i) {
                joints[s][i] = arm->q[i_g[i]][s];
            }
        }
        stream[SIDE] = arm->side[0];
        /* shift by one interval; the joints at the start of the horizon stay behind the Gauss points */
        copy(stream + l.q_g + STAGES * NG, (N - 1) * STAGES * NG, stream + l.q_g);
        copy(joints[0], STAGES * NG, stream + l.q_g + (N - 1) * STAGES * NG);
        copy(stream + l.reference + STAGES * REFERENCE, (N - 1) * STAGES * REFERENCE, stream + l.reference);
        copy(at[0], STAGES * REFERENCE, stream + l.reference + (N - 1) * STAGES * REFERENCE);
        copy(stream + l.nodes + REFERENCE, (l.past + N) * REFERENCE, stream + l.nodes);
        copy(next, REFERENCE, stream + l.nodes + (l.past + N) * REFERENCE);
        copy(next, REFERENCE, stream + l.last);
        if (limits[w.on] > 0.0) {
            copy(limits + w.plan + REFERENCE, N * REFERENCE, limits + w.plan);
            copy(own, REFERENCE, limits + w.plan + N * REFERENCE);
            copy(limits + w.bend + BEND, N * BEND, limits + w.bend);
            copy(bend, BEND, limits + w.bend + N * BEND);
            copy(limits + w.dual + BOUNDED, N * BOUNDED, limits + w.dual);
        }
    }
    report[2] = 1.0;
    report[3] = (real)N;
#if ELBOW_NE > 0
    {
        mesh m = mesh_of(&l, stream);
        lq_space *lq = (lq_space *)(void *)(stream + l.lq);
        copy(stream + l.y + STATES, (l.past + N) * STATES, stream + l.y);
        copy(stream + l.aim + STATES, N * STATES, stream + l.aim);
        copy(stream + l.a + CONTROLS, (l.past + N - 1) * CONTROLS, stream + l.a);
        for (int i = 0; i < CONTROLS; ++i) {
            m.a[(N - 1) * CONTROLS + i] = 0.0;
        }
        next_node(m.y + (N - 1) * STATES, m.a + (N - 1) * CONTROLS, m.h, m.y + N * STATES);
        status = slow_motion(&m, lq, stream + l.levels, stream + l.nodes + (l.past + N) * REFERENCE, space);
        if (status == ELBOW_OK) {
            status = lq_factor(&m, lq, space);
        }
        if (status != ELBOW_OK) {
            return over(stream, status);
        }
        copy(lq->P, STATES * STATES, stream + l.cost);
        lq_step(&m);
    }
#endif
    status = put_out(stream, &l, q_a, v_a, tau_g, q_m, v_m, tau_m, &worst);
    if (status != ELBOW_OK) {
        return over(stream, status);
    }
    report[0] = worst;
    report[1] = unevenness_now(stream, &l);
    report[4] = 0.0;
    report[5] = 0.0;
    if (limits[w.on] > 0.0) {
        for (int k = 0; k < 2; ++k) {
            real size[2];
            size_of_bend(limits + w.bend + k * BEND, size);
            report[4] = fmax_1(report[4], size[0]);
            report[5] = fmax_1(report[5], size[1]);
        }
        bent = report[4] > no_bend || report[5] > no_bend;
        for (ptrdiff_t i = 0; i < (ptrdiff_t)stream[PARTS] * NM; ++i) { /* what could not be kept is no success */
            bent = bent || fabs_1(tau_m[i]) > limits[w.bound + i % NM] ||
                fabs_1(v_m[i]) > limits[w.bound + NM + i % NM];
            if (fabs_1(tau_m[i]) > broken * limits[w.bound + i % NM] ||
                fabs_1(v_m[i]) > broken * limits[w.bound + NM + i % NM]) { /* bends that chase each other grow */
                return over(stream, ELBOW_NOT_CONVERGED);
            }
        }
        status = look_ahead(stream, &l);
        if (status != ELBOW_OK) {
            return over(stream, status);
        }
    }
    report[6] = bent;
    return worst <= stream[TOLERANCE] && report[1] <= uneven ? (bent ? ELBOW_LIMITED : ELBOW_OK) : ELBOW_INEXACT;
}
