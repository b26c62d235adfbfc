/*
 * model: all joint configurations that bring the tool to a pose. Written by flexgen; see
 * model_inverse_kinematics.h.
 *
 * Many starts go down to solutions by damped Gauss-Newton steps, BLOCK of them side by side:
 *
 *     e = ((p - p_d)/L, 2 sin(a/2) n),    (J'J + mu I) dq = J'e,    mu = DAMPING |e|^2
 *
 * with the angle a and the axis n of the rotation R R_d'. New starts are made from the solutions
 * that were found (signs changed, joints turned by half a turn), others are spread evenly, until
 * FRUITLESS starts in a row find nothing new.
 *
 * Source of the bound of 16: H.-Y. Lee, C.-G. Liang, Mechanism and Machine Theory 23(3), 1988.
 */
#include "model_inverse_kinematics.h"

#include "model_private.h"

#include "model_kinematic_constants.h"

enum {
    SIX = 6,
    MOST = MODEL_CONFIGURATIONS_MAX,
    CHANGES = 2 * SIX + 5,
    STEPS = 14,
    POLISH = 4,
    POLISHES = 8,
    FRUITLESS = 256
};

static const real PI = 3.14159265358979323846, DAMPING = 1e-2, LEAST_DAMPING = 1e-14;
static const real LONGEST = 0.7;    /* of a rotation in a step, rad */
static const real FOUND = 1e-8;     /* |e|^2 of a start that is polished */
static const real POLISHED = 1e-12; /* |e| of a solution, but for the rounding of the position */
static const real SETTLED = 1e-28;  /* |e|^2 that is not polished any more */
static const real SAME = 1e-5;      /* rad or m: solutions that are as close are one */
/* rad or m, of q_start: rounding of the solutions is 1e-13 there */
static const real FARTHEST = 1e3;

typedef real starts_each[BLOCK];

/* The search: BLOCK starts at a time, and what was found. Matrices by columns. */
typedef struct {
    starts_each q[MODEL_NA], p[3], R[9], J[SIX * MODEL_NA], e[SIX], A[SIX * (SIX + 1) / 2], b[SIX],
        square;
    real start[MODEL_NA], solution[MOST + 1][MODEL_NA], distance[MOST + 1], p_d[3], R_d[9], length,
        tolerance;
} search;

/* What the search counts. */
typedef struct {
    /* solutions; starts made from them; starts spread evenly */
    int free[SIX], found, changed, spread;
} search_state;

/*
 * Changes of a solution that often lead to another one, beyond each sign and each half turn: bits
 * of joints.
 */
static const struct {
    unsigned sign, turn;
} pairs[CHANGES - 2 * SIX] = {{1U << 4, 1U << 3 | 1U << 5}, {1U << 1 | 1U << 2, 1U << 0},
    {1U << 2, 1U << 0}, {1U << 1, 1U << 0 | 1U << 3}, {1U << 2 | 1U << 4, 1U << 3 | 1U << 5}};

#define EACH_START(l) for (int l = 0; l < BLOCK; l += LANES)

static int64_t search_size(void)
{
    const int64_t size = (int64_t)(sizeof(search) / sizeof(real));
    return (size + BLOCK - 1) / BLOCK * BLOCK;
}

int64_t model_inverse_kinematics_work(void)
{
    return search_size() + MODEL_KINEMATIC_SPACE;
}

/* x within half a turn of zero. */
static real half_turn(const real x)
{
    return x - 2.0 * PI * floor_1((x + PI) / (2.0 * PI));
}

/*
 * Square roots of numbers from 0 to 1, to rounding: a first guess from the exponent and Newton
 * steps, as the library calls no other one.
 */
static lanes root(const lanes x)
{
    lanes y = from_bits_v(UINT64_C(0x5fe6eb50c7b537a9) - (bits_v(x) >> 1));
    for (int k = 0; k < 5; ++k) {
        y *= splat_v(1.5) - splat_v(0.5) * x * y * y;
    }
    return x * y;
}

/* The errors e of all points from their poses, and |e|^2. */
static void pose_errors(search *s)
{
    EACH_START(l)
    {
        lanes E[3][3], sum = splat_v(0.0), trace, half;
        for (int i = 0; i < 3; ++i) {
            const lanes x = (load_v(s->p[i] + l) - splat_v(s->p_d[i])) / splat_v(s->length);
            store_v(s->e[i] + l, x);
            sum += x * x;
            for (int j = 0; j < 3; ++j) {
                E[i][j] = load_v(s->R[i] + l) * splat_v(s->R_d[j]) +
                          load_v(s->R[3 + i] + l) * splat_v(s->R_d[3 + j]) +
                          load_v(s->R[6 + i] + l) * splat_v(s->R_d[6 + j]);
            }
        }
        trace = E[0][0] + E[1][1] + E[2][2];
        half = root(fmax_v(splat_v(0.25) * (trace + splat_v(1.0)), splat_v(0.0))); /* cos(a/2) */
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3, k = (i + 2) % 3;
            const lanes x = (E[k][j] - E[j][k]) / (splat_v(2.0) * half);
            const lanes any = splat_v(i == 0 ? 2.0 : 0.0); /* half a turn, about any axis */
            const lanes turn = select_v(lt_v(half, splat_v(1e-4)), any, x);
            store_v(s->e[3 + i] + l, turn);
            sum += turn * turn;
        }
        store_v(s->square + l, sum);
    }
}

/* Normal equations A (lower triangle by rows) and b of all points. */
static void normal_equations(search *s, const int *free)
{
    const lanes w = splat_v(1.0 / s->length);
    EACH_START(l)
    {
        const lanes damping = splat_v(DAMPING) * load_v(s->square + l) + splat_v(LEAST_DAMPING);
        for (int i = 0, at = 0; i < SIX; ++i) {
            starts_each *Ji = s->J + SIX * free[i];
            lanes moved = splat_v(0.0), turned = splat_v(0.0);
            for (int r = 0; r < 3; ++r) {
                moved += load_v(Ji[r] + l) * load_v(s->e[r] + l);
                turned += load_v(Ji[r + 3] + l) * load_v(s->e[r + 3] + l);
            }
            store_v(s->b[i] + l, w * moved + turned);
            for (int j = 0; j <= i; ++j, ++at) {
                starts_each *Jj = s->J + SIX * free[j];
                moved = turned = splat_v(0.0);
                for (int r = 0; r < 3; ++r) {
                    moved += load_v(Ji[r] + l) * load_v(Jj[r] + l);
                    turned += load_v(Ji[r + 3] + l) * load_v(Jj[r + 3] + l);
                }
                moved = w * w * moved + turned;
                if (i == j) {
                    moved += damping;
                }
                store_v(s->A[at] + l, moved);
            }
        }
    }
}

/* Solve A x = b of all points with A = L D L', in place. */
static void solve_normal(search *s)
{
    EACH_START(l)
    {
        lanes L[SIX][SIX], x[SIX], inverse[SIX];
        for (int i = 0, at = 0; i < SIX; ++i) {
            x[i] = load_v(s->b[i] + l);
            for (int j = 0; j <= i; ++j, ++at) {
                L[i][j] = load_v(s->A[at] + l);
            }
        }
        for (int j = 0; j < SIX; ++j) { /* below the diagonal L_ij D_j until column j is done */
            for (int i = j; i < SIX; ++i) {
                for (int m = 0; m < j; ++m) {
                    L[i][j] -= L[i][m] * (L[j][m] * inverse[m]);
                }
            }
            inverse[j] = splat_v(1.0) / fmax_v(L[j][j], splat_v(1e-300));
        }
        for (int i = 0; i < SIX; ++i) {
            for (int m = 0; m < i; ++m) {
                x[i] -= L[i][m] * (inverse[m] * x[m]);
            }
        }
        for (int i = SIX - 1; i >= 0; --i) {
            for (int m = i + 1; m < SIX; ++m) {
                x[i] -= L[m][i] * x[m];
            }
            x[i] *= inverse[i];
            store_v(s->b[i] + l, x[i]);
        }
    }
}

/* Steps of all points; their errors at the end are in s->square. */
static void descend(search *s, const int *free, int steps, real *space)
{
    for (int step = 0;; ++step) {
        (void)evaluate_forward_kinematics_batch(
            BLOCK, &s->q[0][0], &s->p[0][0], &s->R[0][0], space);
        pose_errors(s);
        if (step == steps) {
            return;
        }
        (void)evaluate_jacobian_batch(BLOCK, &s->q[0][0], &s->J[0][0], space);
        normal_equations(s, free);
        solve_normal(s);
        EACH_START(l)
        {
            lanes most = splat_v(LONGEST);
            for (int i = 0; i < SIX; ++i) {
                if (is_angle[free[i]]) { /* the pose is linear in a translation */
                    most = fmax_v(most, fabs_v(load_v(s->b[i] + l)));
                }
            }
            for (int i = 0; i < SIX; ++i) {
                real *q = s->q[free[i]] + l;
                store_v(q, load_v(q) - splat_v(LONGEST) / most * load_v(s->b[i] + l));
            }
        }
    }
}

/*
 * The length that errors of the position are divided by: half the way between poses that are
 * spread evenly.
 */
static void set_length(search *s, real *space)
{
    s->length = 1e-3;
    (void)evaluate_forward_kinematics_batch(BLOCK, &s->q[0][0], &s->p[0][0], &s->R[0][0], space);
    for (int l = 1; l < BLOCK; ++l) {
        for (int i = 0; i < 3; ++i) {
            s->length = fmax_1(s->length, 0.5 * fabs_1(s->p[i][l] - s->p[i][0]));
        }
    }
}

/*
 * The next of the starts that are spread evenly, as point l: multiples of powers of the root of
 * x^7 = x + 1.
 */
static void spread_start(search *s, search_state *state, int l)
{
    static const real share[SIX] = {0.8986537126286992, 0.8075784952213447, 0.7257334129697597,
        0.6521830259439715, 0.5860866975779693, 0.5266889867007357};
    state->spread += 1;
    for (int i = 0; i < SIX; ++i) {
        const int joint = state->free[i];
        const real x = 0.5 + (real)state->spread * share[i];
        const real from = spread_around[joint] ? s->start[joint] - 1.0 : spread_lower[joint];
        const real to = spread_around[joint] ? s->start[joint] + 1.0 : spread_upper[joint];
        s->q[joint][l] = from + (to - from) * (x - floor_1(x));
    }
}

/* The next start made from a solution, as point l; 0 where there is none. */
static int changed_start(search *s, search_state *state, int l)
{
    const int from = state->changed / CHANGES, change = state->changed % CHANGES;
    unsigned sign, turn;
    if (from >= state->found) {
        return 0;
    }
    sign = change < SIX ? 1U << change : change < 2 * SIX ? 0U : pairs[change - 2 * SIX].sign;
    turn = change < SIX     ? 0U :
           change < 2 * SIX ? 1U << (change - SIX) :
                              pairs[change - 2 * SIX].turn;
    state->changed += 1;
    for (int i = 0; i < SIX; ++i) {
        const int joint = state->free[i];
        const real x = s->solution[from][joint];
        s->q[joint][l] = (sign >> i & 1U ? -x : x) +
                         (turn >> i & 1U && is_angle[joint] ? PI : 0.0);
    }
    return 1;
}

/*
 * Keep point l as a solution, rotations within half a turn of the start, unless it is known;
 * whether it is new.
 */
static int keep_solution(search *s, search_state *state, int l)
{
    real *q = s->solution[state->found], far = 0.0;
    for (int i = 0; i < MODEL_NA; ++i) {
        q[i] = s->start[i];
    }
    for (int i = 0; i < SIX; ++i) {
        const int joint = state->free[i];
        const real d = s->q[joint][l] - s->start[joint], near = is_angle[joint] ? half_turn(d) : d;
        q[joint] = s->start[joint] + near;
        far = fmax_1(far, fabs_1(near));
    }
    for (int k = 0; k < state->found; ++k) {
        int same = 1;
        for (int i = 0; i < SIX && same; ++i) {
            const int joint = state->free[i];
            const real d = q[joint] - s->solution[k][joint];
            same = fabs_1(is_angle[joint] ? half_turn(d) : d) < SAME;
        }
        if (same) {
            return 0;
        }
    }
    s->distance[state->found] = far;
    state->found += 1;
    return 1;
}

/*
 * Continue while the error decreases where a point is near a solution: near a singularity
 * convergence is linear.
 */
static void polish(search *s, const int *free, real *space)
{
    int still = 1;
    for (int round = 0; still && round < POLISHES; ++round) {
        starts_each before;
        still = 0;
        for (int l = 0; l < BLOCK; ++l) {
            before[l] = s->square[l];
            still = still || (before[l] < FOUND && before[l] > SETTLED);
        }
        if (still) {
            descend(s, free, POLISH, space);
            still = 0;
            for (int l = 0; l < BLOCK; ++l) {
                still = still || (before[l] < FOUND && s->square[l] < 0.25 * before[l]);
            }
        }
    }
}

/* Search from at most so many starts. */
static void find_all(search *s, search_state *state, int starts, real *space)
{
    int fruitless = 0;
    for (int tried = 0; tried < starts && fruitless < FRUITLESS && state->found <= MOST;
        tried += BLOCK) {
        for (int l = 0; l < BLOCK; ++l) {
            for (int i = 0; i < MODEL_NA; ++i) {
                s->q[i][l] = s->start[i];
            }
            if (tried + l > 0 && tried + l < starts && !changed_start(s, state, l)) {
                spread_start(s, state, l);
            }
        }
        descend(s, state->free, STEPS, space);
        polish(s, state->free, space);
        fruitless += BLOCK;
        for (int l = 0; l < BLOCK && state->found <= MOST; ++l) {
            if (s->square[l] < s->tolerance * s->tolerance && keep_solution(s, state, l)) {
                fruitless = 0;
            }
        }
    }
}

/* Whether a matrix by columns is a rotation. */
static int is_a_rotation(const real *R)
{
    real worst = 0.0;
    for (int j = 0; j < 3; ++j) {
        const int k = (j + 1) % 3, m = (j + 2) % 3;
        const real *a = R + 3 * j, *b = R + 3 * k, *c = R + 3 * m;
        worst = fmax_1(worst, fabs_1(a[0] * a[0] + a[1] * a[1] + a[2] * a[2] - 1.0));
        for (int i = 0; i < 3; ++i) { /* the cross product of two columns is the third */
            const int n = (i + 1) % 3, o = (i + 2) % 3;
            worst = fmax_1(worst, fabs_1(b[n] * c[o] - b[o] * c[n] - a[i]));
        }
    }
    return worst < 1e-6;
}

/*
 * Take the indices of the free coordinates; 0 where they are not six different ones with a motor.
 */
static int take_free(const int *given, int *free)
{
    for (int i = 0; i < SIX; ++i) {
        int driven = 0;
        free[i] = given == NULL ? actuated[i] : given[i];
        for (int k = 0; k < MODEL_NG; ++k) {
            driven = driven || actuated[k] == free[i];
        }
        for (int k = 0; k < i; ++k) {
            driven = driven && free[k] != free[i];
        }
        if (!driven) {
            return 0;
        }
    }
    return 1;
}

/* Write the solutions that are nearest to the start, the nearest first. */
static void write_nearest(search *s, int found, int most, real *q)
{
    for (int k = 0; k < most && k < found; ++k) {
        int best = 0;
        for (int i = 1; i < found; ++i) {
            best = s->distance[i] < s->distance[best] ? i : best;
        }
        for (int i = 0; i < MODEL_NA; ++i) {
            q[k * MODEL_NA + i] = s->solution[best][i];
        }
        s->distance[best] = (real)INFINITY;
    }
}

model_status model_inverse_kinematics(const real *p, const real *R, const real q_start[MODEL_NA],
    const int *free, int starts, int most, real *q, int *count, real *work, int64_t work_size)
{
    search *s;
    search_state state = {{0}, 0, 0, 0};
    real *space, far = 0.0;
    if (p == NULL || R == NULL || q_start == NULL || (free == NULL && MODEL_NG != SIX) ||
        q == NULL || count == NULL || work == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    *count = 0;
    if (starts < 1 || starts > MODEL_STARTS_MAX || most < 1 || most > MOST ||
        !take_free(free, state.free)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (work_size < model_inverse_kinematics_work()) {
        return MODEL_WORK_TOO_SMALL;
    }
    s = (search *)(void *)work;
    space = work + search_size();
    if (!all_finite(p, 3, 1) || !all_finite(R, 9, 1) || !all_finite(q_start, MODEL_NA, 1)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    if (!is_a_rotation(R)) {
        return MODEL_BAD_ARGUMENT;
    }
    for (int i = 0; i < MODEL_NA; ++i) {
        if (fabs_1(q_start[i]) > FARTHEST) {
            return MODEL_BAD_ARGUMENT;
        }
    }
    for (int i = 0; i < 9; ++i) {
        s->R_d[i] = R[i];
        s->p_d[i % 3] = p[i % 3];
        far = fmax_1(far, fabs_1(p[i % 3]));
    }
    for (int i = 0; i < MODEL_NA; ++i) {
        s->start[i] = q_start[i];
        for (int l = 0; l < BLOCK; ++l) {
            s->q[i][l] = q_start[i];
        }
    }
    for (int l = 0; l < BLOCK; ++l) {
        spread_start(s, &state, l);
    }
    set_length(s, space);
    s->tolerance = POLISHED + 1e-15 * far / s->length;
    find_all(s, &state, starts, space);
    if (state.found > MOST) {
        return MODEL_NOT_CONVERGED;
    }
    write_nearest(s, state.found, most, q);
    *count = state.found;
    return state.found > 0 ? MODEL_OK : MODEL_UNREACHABLE;
}
