/*
 * model: what the inversion along a path, the stream and the two-point problem share; private to them.
 *
 * The reduced problem: the output is prescribed, y(q_a) = Z(t), so that the actuated coordinates q_g follow from the
 * others and only n_e equations are left,
 *
 *     R(q_e, v_e, a_e, t) = [M a + c + g]_e - tau_e = 0.
 *
 * POINTS instants are evaluated together; entry i of point l of an array stands at [i][l], matrices by columns.
 */
#ifndef MODEL_INVERSION_H
#define MODEL_INVERSION_H

#include "model_private.h"

#include "model_drives.h"

enum {
    NA = MODEL_NA,
    NG = MODEL_NG,
    NE = MODEL_NE,
    NM = MODEL_NM,
    NY = MODEL_NY,
    NT = MODEL_NT,
    POINTS = 8,
    STAGES = 3,
    REFERENCE = NT + 2 * NY /* numbers of the path at one instant: place, rate, its rate */
};

typedef real points[POINTS];

static const real gauss_c[STAGES] = {0.11270166537925831, 0.5, 0.8872983346207417};
static const real gauss_b[STAGES] = {5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0};
static const real gauss_A[STAGES][STAGES] = {
    {5.0 / 36.0, -0.035976667524938878, 0.0097894440152484326},
    {0.30026319498086457, 2.0 / 9.0, -0.022485417203086778},
    {0.26798833376246944, 0.48042111196938331, 5.0 / 36.0}};

/* Over all points, a vector at a time. */
#define EACH(l) for (int l = 0; l < POINTS; l += LANES)

/* The largest size; NaN where an entry is not finite, so that no comparison holds. */
static inline real largest(const real *x, int n)
{
    real most = 0.0, zero = 0.0;
    for (int i = 0; i < n; ++i) {
        most = fmax_1(most, fabs_1(x[i]));
        zero += 0.0 * x[i];
    }
    return most + zero;
}

/* Square root by Newton's method: the library needs no function of the C library for it. */
static inline real root(real x)
{
    real r = 1.0;
    if (!(x > 0.0 && x < 1e300)) {
        return x;
    }
    while (r * r > 4.0 * x) {
        r *= 0.5;
    }
    while (r * r < 0.25 * x) {
        r *= 2.0;
    }
    for (int i = 0; i < 7; ++i) {
        r = 0.5 * (r + x / r);
    }
    return r;
}

static inline int is_finite(const real *x, int n)
{
    return all_finite(x, n, 1);
}

/* What a function of the library says of states that were computed here: they are no inputs of the caller. */
static inline int inner(int status)
{
    return status == MODEL_INPUT_NOT_FINITE ? MODEL_RESULT_NOT_FINITE : status;
}

/* --- the path ----------------------------------------------------------------------------------------------------- */

/* A path: samples a period apart; constant before the first and after the last. */
typedef struct {
    int n;
    real period;
    const real *place; /* n x NT */
    const real *rate;  /* n x NY */
    const real *rate2; /* n x NY */
} path;

static inline void cross(const real *a, const real *b, real *c)
{
    c[0] = a[1] * b[2] - a[2] * b[1];
    c[1] = a[2] * b[0] - a[0] * b[2];
    c[2] = a[0] * b[1] - a[1] * b[0];
}

/* The quintic through value and two derivatives at 0 and 1; value and two derivatives at x. */
static inline void quintic(real x, const real left[3], const real right[3], real out[3])
{
    const real d = right[0] - left[0];
    const real a3 = 10.0 * d - 6.0 * left[1] - 4.0 * right[1] - 1.5 * left[2] + 0.5 * right[2];
    const real a4 = -15.0 * d + 8.0 * left[1] + 7.0 * right[1] + 1.5 * left[2] - right[2];
    const real a5 = 6.0 * d - 3.0 * left[1] - 3.0 * right[1] - 0.5 * left[2] + 0.5 * right[2];
    out[0] = left[0] + x * (left[1] + x * (0.5 * left[2] + x * (a3 + x * (a4 + x * a5))));
    out[1] = left[1] + x * (left[2] + x * (3.0 * a3 + x * (4.0 * a4 + x * 5.0 * a5)));
    out[2] = left[2] + x * (6.0 * a3 + x * (12.0 * a4 + x * 20.0 * a5));
}

#if MODEL_POSE
/* a - (f x a) / 2 + (f x (f x a)) / 12: the inverse of the left Jacobian of a small rotation vector f, to f^4 / 720. */
static inline void unturn(const real *f, const real *a, real *out)
{
    real once[3], twice[3], thrice[3], fourth[3];
    cross(f, a, once);
    cross(f, once, twice);
    cross(f, twice, thrice);
    cross(f, thrice, fourth);
    for (int i = 0; i < 3; ++i) {
        out[i] = a[i] - 0.5 * once[i] + twice[i] / 12.0 - fourth[i] / 720.0;
    }
}

/* The left Jacobian of a small rotation vector, the angular velocity of its rate, to f^4 / 120. */
static inline void turn(const real *f, const real *a, real *out)
{
    real once[3], twice[3], thrice[3], fourth[3];
    cross(f, a, once);
    cross(f, once, twice);
    cross(f, twice, thrice);
    cross(f, thrice, fourth);
    for (int i = 0; i < 3; ++i) {
        out[i] = a[i] + 0.5 * once[i] + twice[i] / 6.0 + thrice[i] / 24.0 + fourth[i] / 120.0;
    }
}

/* Time derivative of the left Jacobian, times the rate d of f. */
static inline void turn_rate(const real *f, const real *d, real *out)
{
    real fd[3], dfd[3], ffd[3], dffd[3], fdfd[3], fffd[3], dfffd[3], fdffd[3], ffdfd[3];
    cross(f, d, fd);
    cross(d, fd, dfd);
    cross(f, fd, ffd);
    cross(d, ffd, dffd);
    cross(f, dfd, fdfd);
    cross(f, ffd, fffd);
    cross(d, fffd, dfffd);
    cross(f, dffd, fdffd);
    cross(f, fdfd, ffdfd);
    for (int i = 0; i < 3; ++i) {
        out[i] = dfd[i] / 6.0 + (dffd[i] + fdfd[i]) / 24.0 + (dfffd[i] + fdffd[i] + ffdfd[i]) / 120.0;
    }
}

/* Rotation vector of R1 R0' where it is small, R by columns. */
static inline void turned(const real *R0, const real *R1, real *f)
{
    real s[3] = {0.0, 0.0, 0.0}, trace = 0.0, c;
    for (int k = 0; k < 3; ++k) { /* E = R1 R0' = sum of columns of both */
        const real *a = R1 + 3 * k, *b = R0 + 3 * k;
        s[0] += 0.5 * (a[2] * b[1] - a[1] * b[2]);
        s[1] += 0.5 * (a[0] * b[2] - a[2] * b[0]);
        s[2] += 0.5 * (a[1] * b[0] - a[0] * b[1]);
        trace += a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    }
    /* the sine of the angle times the axis; angle / sine as a series in sine^2 */
    c = s[0] * s[0] + s[1] * s[1] + s[2] * s[2];
    c = trace < 1.0 ? (real)NAN : 1.0 + c * (1.0 / 6.0 + c * (3.0 / 40.0 + c * (15.0 / 336.0 + c * 105.0 / 3456.0)));
    for (int i = 0; i < 3; ++i) {
        f[i] = c * s[i];
    }
}

/* exp(f) R0 */
static inline void turn_matrix(const real *f, const real *R0, real *R)
{
    const real u = f[0] * f[0] + f[1] * f[1] + f[2] * f[2];
    const real s = 1.0 - u / 6.0 * (1.0 - u / 20.0 * (1.0 - u / 42.0 * (1.0 - u / 72.0)));
    const real c = 0.5 * (1.0 - u / 12.0 * (1.0 - u / 30.0 * (1.0 - u / 56.0 * (1.0 - u / 90.0))));
    for (int k = 0; k < 3; ++k) {
        real once[3], twice[3];
        cross(f, R0 + 3 * k, once);
        cross(f, once, twice);
        for (int i = 0; i < 3; ++i) {
            R[3 * k + i] = R0[3 * k + i] + s * once[i] + c * twice[i];
        }
    }
}
#endif

/* Place, rate and its rate at sample k + x, 0 <= x <= 1, each with the stride of the samples. */
static inline void reference_at(const path *p, int k, real x, real *out)
{
    const real T = p->period;
    int at = k;
    if (k < 0 || k >= p->n - 1) {
        at = k < 0 ? 0 : p->n - 1;
        for (int i = 0; i < NT; ++i) {
            out[i] = p->place[at * (ptrdiff_t)NT + i];
        }
        for (int i = NT; i < REFERENCE; ++i) {
            out[i] = 0.0;
        }
        return;
    }
    {
        const real *y0 = p->place + at * (ptrdiff_t)NT, *y1 = y0 + NT;
        const real *v0 = p->rate + at * (ptrdiff_t)NY, *v1 = v0 + NY;
        const real *a0 = p->rate2 + at * (ptrdiff_t)NY, *a1 = a0 + NY;
        const int positions = MODEL_POSE ? 3 : NY;
        for (int i = 0; i < positions; ++i) {
            const real left[3] = {y0[i], T * v0[i], T * T * a0[i]};
            const real right[3] = {y1[i], T * v1[i], T * T * a1[i]};
            real q[3];
            quintic(x, left, right, q);
            out[i] = q[0];
            out[NT + i] = q[1] / T;
            out[NT + NY + i] = q[2] / (T * T);
        }
#if MODEL_POSE
        {
            real f1[3], d1[3], e1[3], extra[3], difference[3], f[3], d[3], e[3], second[3];
            turned(y0 + 3, y1 + 3, f1);
            unturn(f1, v1 + 3, d1);
            turn_rate(f1, d1, extra);
            for (int i = 0; i < 3; ++i) {
                difference[i] = a1[3 + i] - extra[i];
            }
            unturn(f1, difference, e1);
            for (int i = 0; i < 3; ++i) {
                const real left[3] = {0.0, T * v0[3 + i], T * T * a0[3 + i]};
                const real right[3] = {f1[i], T * d1[i], T * T * e1[i]};
                real q[3];
                quintic(x, left, right, q);
                f[i] = q[0];
                d[i] = q[1] / T;
                e[i] = q[2] / (T * T);
            }
            turn_matrix(f, y0 + 3, out + 3);
            turn(f, d, out + NT + 3);
            turn(f, e, second);
            turn_rate(f, d, extra);
            for (int i = 0; i < 3; ++i) {
                out[NT + NY + 3 + i] = second[i] + extra[i];
            }
        }
#endif
    }
}

/* --- the arm on the path ------------------------------------------------------------------------------------------ */

/* POINTS instants of the arm on its path. */
typedef struct {
    points q[NA], v[NA], a[NA];
    points place[NT], rate[NY], rate2[NY];
    points error[NY], W[NA][NY], bias[NY];
    points inverse[NY][NG]; /* of the columns of W that belong to q_g */
    points side;            /* sign of their determinant: on either side of singular poses, 1 or -1 */
    points tau_g[NG];
#if MODEL_NE > 0
    points row[NE], row_q[NA][NE], row_v[NA][NE], row_a[NA][NE];
    points y1_q[NA][NY], y2_q[NA][NY], y2_v[NA][NY];
    points S[NE][NG], Vq[NE][NG], Aq[NE][NG], Av[NE][NG], T[NE][NY];
    points K[NE][NE], D[NE][NE], A[NE][NE]; /* [column][row] */
#endif
} arm_points;

/* Bring the path at one instant into place l. */
static inline void load_reference(arm_points *arm, int l, const real *reference)
{
    for (int i = 0; i < NT; ++i) {
        arm->place[i][l] = reference[i];
    }
    for (int i = 0; i < NY; ++i) {
        arm->rate[i][l] = reference[NT + i];
        arm->rate2[i][l] = reference[NT + NY + i];
    }
}

enum { KINEMATIC_STEPS = 25 };

/*
 * Inverse of the actuated columns of W by Gauss and Jordan, with rows exchanged for the largest pivot in every point
 * for itself; 0 where a pivot is rounding.
 */
static inline int invert_points(arm_points *p)
{
    lanes bad = splat_v(0.0);
    EACH(l) {
        lanes a[NY][2 * NY], side = splat_v(1.0);
        for (int i = 0; i < NY; ++i) {
            for (int j = 0; j < NY; ++j) {
                a[i][j] = load_v(&p->W[i_g[j]][i][l]);
                a[i][NY + j] = splat_v(i == j ? 1.0 : 0.0);
            }
        }
        for (int k = 0; k < NY; ++k) {
            lanes pivot;
            for (int i = k + 1; i < NY; ++i) {
                const lanes larger = lt_v(fabs_v(a[k][k]), fabs_v(a[i][k]));
                side *= splat_v(1.0) - 2.0 * larger;
                for (int j = k; j < 2 * NY; ++j) {
                    const lanes x = a[k][j], y = a[i][j];
                    a[k][j] = select_v(larger, y, x);
                    a[i][j] = select_v(larger, x, y);
                }
            }
            /* metres and radians: a nanometre for a radian is a singular pose; NaN is no better */
            bad += not_v(lt_v(splat_v(1e-9), fabs_v(a[k][k])));
            side *= splat_v(1.0) - 2.0 * lt_v(a[k][k], splat_v(0.0));
            pivot = splat_v(1.0) / a[k][k];
            for (int j = k + 1; j < 2 * NY; ++j) {
                a[k][j] *= pivot;
            }
            for (int i = 0; i < NY; ++i) {
                const lanes f = a[i][k];
                if (i == k) {
                    continue;
                }
                for (int j = k + 1; j < 2 * NY; ++j) {
                    a[i][j] -= f * a[k][j];
                }
            }
        }
        for (int i = 0; i < NG; ++i) {
            for (int j = 0; j < NY; ++j) {
                store_v(&p->inverse[j][i][l], a[i][NY + j]);
            }
        }
        store_v(&p->side[l], side);
    }
    return sum_v(bad) == 0.0;
}

static inline void constrain(arm_points *p, real *space)
{
    (void)model_output_constraint_batch(
        POINTS, &p->q[0][0], &p->v[0][0], &p->place[0][0], &p->error[0][0], &p->W[0][0][0], &p->bias[0][0], space);
}

/* The actuated coordinates of `to` become inverse * y. */
static inline void actuated(const arm_points *p, points *y, points *to)
{
    for (int i = 0; i < NG; ++i) {
        EACH(l) {
            lanes sum = splat_v(0.0);
            for (int j = 0; j < NY; ++j) {
                sum += load_v(&p->inverse[j][i][l]) * load_v(&y[j][l]);
            }
            store_v(&to[i_g[i]][l], sum);
        }
    }
}

/* One Newton step of the actuated coordinates towards the place; the largest change. */
static inline real approach(arm_points *p)
{
    lanes most = splat_v(0.0), zero = splat_v(0.0);
    for (int i = 0; i < NG; ++i) {
        EACH(l) {
            lanes sum = splat_v(0.0);
            for (int j = 0; j < NY; ++j) {
                sum += load_v(&p->inverse[j][i][l]) * load_v(&p->error[j][l]);
            }
            store_v(&p->q[i_g[i]][l], load_v(&p->q[i_g[i]][l]) - sum);
            most = fmax_v(most, fabs_v(sum));
            zero += 0.0 * sum; /* a maximum overlooks NaN */
        }
    }
    most += zero;
    return largest((const real *)&most, LANES);
}

/* Whether the output is where it shall be, but for rounding. */
static inline int is_there(const arm_points *p)
{
    return largest(&p->error[0][0], NY * POINTS) <= 1e-9 * (1.0 + largest(&p->place[0][0], NT * POINTS));
}

/* The actuated coordinates that bring the output to its place, with their rates, for given other ones. */
static inline int follow(arm_points *p, real *space)
{
    points rest[NY];
    real most, bound;
    int step = 0;
    constrain(p, space);
    do { /* Newton's method: after a step below a millionth the error is rounding */
        if (!invert_points(p)) {
            return MODEL_UNREACHABLE;
        }
        bound = 2.0 + 2.0 * largest(&p->error[0][0], NY * POINTS); /* rad and m: beyond it a step leads astray */
        most = approach(p);
        if (!(most < bound) || ++step > KINEMATIC_STEPS) {
            return MODEL_UNREACHABLE;
        }
        constrain(p, space);
    } while (most > 1e-6);
    if (!invert_points(p)) {
        return MODEL_UNREACHABLE;
    }
    (void)approach(p);
    for (int j = 0; j < NY; ++j) {
        EACH(l) {
            lanes sum = load_v(&p->rate[j][l]);
            for (int i = 0; i < NE; ++i) {
                sum -= load_v(&p->W[i_e[i]][j][l]) * load_v(&p->v[i_e[i]][l]);
            }
            store_v(&rest[j][l], sum);
        }
    }
    actuated(p, rest, p->v);
    constrain(p, space);
    if (!is_there(p)) {
        return MODEL_UNREACHABLE;
    }
    for (int j = 0; j < NY; ++j) {
        EACH(l) {
            lanes sum = load_v(&p->rate2[j][l]) - load_v(&p->bias[j][l]);
            for (int i = 0; i < NE; ++i) {
                sum -= load_v(&p->W[i_e[i]][j][l]) * load_v(&p->a[i_e[i]][l]);
            }
            store_v(&rest[j][l], sum);
        }
    }
    actuated(p, rest, p->a);
    return MODEL_OK;
}

#if MODEL_NE > 0

/* to[j] = - inverse * from[j] for all columns. */
static inline void solve_columns(const arm_points *p, points (*from)[NY], points (*to)[NG])
{
    EACH(l) {
        lanes inverse[NG][NY]; /* together, as it is needed below */
        for (int i = 0; i < NG; ++i) {
            for (int k = 0; k < NY; ++k) {
                inverse[i][k] = load_v(&p->inverse[k][i][l]);
            }
        }
        for (int j = 0; j < NE; ++j) {
            for (int i = 0; i < NG; ++i) {
                lanes sum = splat_v(0.0);
                for (int k = 0; k < NY; ++k) {
                    sum -= inverse[i][k] * load_v(&from[j][k][l]);
                }
                store_v(&to[j][i][l], sum);
            }
        }
    }
}

/* T += X restricted to the actuated columns, times Y. */
static inline void add_actuated(points (*X)[NY], points (*Y)[NG], points (*T)[NY])
{
    EACH(l) {
        lanes columns[NY][NG];
        for (int i = 0; i < NY; ++i) {
            for (int k = 0; k < NG; ++k) {
                columns[i][k] = load_v(&X[i_g[k]][i][l]);
            }
        }
        for (int j = 0; j < NE; ++j) {
            for (int i = 0; i < NY; ++i) {
                lanes sum = load_v(&T[j][i][l]);
                for (int k = 0; k < NG; ++k) {
                    sum += columns[i][k] * load_v(&Y[j][k][l]);
                }
                store_v(&T[j][i][l], sum);
            }
        }
    }
}

static inline void take_elastic(points (*X)[NY], points (*T)[NY])
{
    for (int j = 0; j < NE; ++j) {
        for (int i = 0; i < NY; ++i) {
            EACH(l) {
                store_v(&T[j][i][l], load_v(&X[i_e[j]][i][l]));
            }
        }
    }
}

/* Residual of the non-actuated rows and their slopes K, D, A with respect to q_e, v_e, a_e on the path. */
static inline int reduce(arm_points *p, real *space)
{
    const int status = model_inversion_slopes_batch(
        POINTS, &p->q[0][0], &p->v[0][0], &p->a[0][0], &p->y1_q[0][0][0], &p->y2_q[0][0][0], &p->y2_v[0][0][0],
        &p->row[0][0], &p->row_q[0][0][0], &p->row_v[0][0][0], &p->row_a[0][0][0], space);
    if (status != MODEL_OK) {
        return inner(status);
    }
    take_elastic(p->W, p->T);
    solve_columns(p, p->T, p->S);
    take_elastic(p->y1_q, p->T);
    add_actuated(p->y1_q, p->S, p->T);
    solve_columns(p, p->T, p->Vq);
    take_elastic(p->y2_q, p->T);
    add_actuated(p->y2_q, p->S, p->T);
    add_actuated(p->y2_v, p->Vq, p->T);
    solve_columns(p, p->T, p->Aq);
    take_elastic(p->y2_v, p->T);
    add_actuated(p->y2_v, p->S, p->T);
    solve_columns(p, p->T, p->Av);
    EACH(l) {
        lanes q[NE][NG], v[NE][NG], a[NE][NG]; /* together, as they are needed below */
        for (int i = 0; i < NE; ++i) {
            for (int k = 0; k < NG; ++k) {
                q[i][k] = load_v(&p->row_q[i_g[k]][i][l]);
                v[i][k] = load_v(&p->row_v[i_g[k]][i][l]);
                a[i][k] = load_v(&p->row_a[i_g[k]][i][l]);
            }
        }
        for (int j = 0; j < NE; ++j) {
            for (int i = 0; i < NE; ++i) {
                lanes K = load_v(&p->row_q[i_e[j]][i][l]), D = load_v(&p->row_v[i_e[j]][i][l]);
                lanes A = load_v(&p->row_a[i_e[j]][i][l]);
                for (int k = 0; k < NG; ++k) {
                    const lanes S = load_v(&p->S[j][k][l]);
                    K += q[i][k] * S + v[i][k] * load_v(&p->Vq[j][k][l]) + a[i][k] * load_v(&p->Aq[j][k][l]);
                    D += v[i][k] * S + a[i][k] * load_v(&p->Av[j][k][l]);
                    A += a[i][k] * S;
                }
                store_v(&p->K[j][i][l], K);
                store_v(&p->D[j][i][l], D);
                store_v(&p->A[j][i][l], A);
            }
        }
    }
    return MODEL_OK;
}

#endif
#endif
