/*
 * Many starts of inverse kinematics at once: damped Gauss-Newton steps, all starts side by side.
 *
 *     e = ((p - p_d)/L, log(R R_d')),    (J'J + mu I) dq = J'e,    mu = MU |e|^2
 *
 * Arrays are structures of arrays: entry i of start k is x[i * n + k]. Six joints; the others keep their values. The
 * model's functions evaluate all starts in one call.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

#if defined(__GNUC__)
#define IK_API __attribute__((visibility("default")))
#else
#define IK_API
#endif

enum { SIX = 6 };
static const double MU = 1e-2, LEAST_MU = 1e-14, LONGEST = 0.7; /* rad or length in a step */

typedef int (*pose_function)(int n, const double *q_a, double *p, double *R, double *work);
typedef int (*jacobian_function)(int n, const double *q_a, double *J, double *work);

typedef struct {
    int32_t n, n_a, joints[SIX];
    void (*pose)(void);
    void (*jacobian)(void);
    double *work;
    double length;      /* L [m] */
    const double *goal; /* p_d (3), R_d by rows (9) */
    double *q;          /* (n_a, n) */
    double *error;      /* (n): |e| */
    double *scratch;    /* (3 + 9 + 6 n_a + 6 + 21 + 6) n */
} ik_problem;

/* e of all starts from their poses. */
static void errors(const ik_problem *s, const double *p, const double *R, double *e)
{
    int n = s->n;
    const double *g = s->goal;
    for (int k = 0; k < n; ++k) {
        double E[3][3];
        for (int i = 0; i < 3; ++i) {
            e[i * n + k] = (p[i * n + k] - g[i]) / s->length;
            for (int j = 0; j < 3; ++j) { /* R by columns: R(i, m) = R[(m * 3 + i) * n + k] */
                E[i][j] = R[i * n + k] * g[3 + 3 * j] + R[(3 + i) * n + k] * g[3 + 3 * j + 1] +
                          R[(6 + i) * n + k] * g[3 + 3 * j + 2];
            }
        }
        double x = E[2][1] - E[1][2], y = E[0][2] - E[2][0], z = E[1][0] - E[0][1];
        double sine = 0.5 * sqrt(x * x + y * y + z * z), cosine = 0.5 * (E[0][0] + E[1][1] + E[2][2] - 1.0);
        double scale = sine > 1e-8 ? 0.5 * atan2(sine, cosine) / sine : 0.5;
        if (sine <= 1e-8 && cosine < 0.0) { /* half a turn, about any axis */
            scale = 1.0;
            x = 3.141592653589793;
        }
        e[3 * n + k] = scale * x;
        e[4 * n + k] = scale * y;
        e[5 * n + k] = scale * z;
        double sum = 0.0;
        for (int i = 0; i < SIX; ++i) {
            sum += e[i * n + k] * e[i * n + k];
        }
        s->error[k] = sqrt(sum);
    }
}

/* Normal equations A (lower triangle, 21), b (6) of all starts, damped. */
static void normal(const ik_problem *s, const double *J, const double *e, double *A, double *b)
{
    int n = s->n;
    for (int i = 0, at = 0; i < SIX; ++i) {
        const double *Ji = J + (size_t)s->joints[i] * SIX * (size_t)n;
        for (int k = 0; k < n; ++k) {
            double sum = 0.0;
            for (int r = 0; r < SIX; ++r) {
                sum += Ji[r * n + k] * (r < 3 ? 1.0 / s->length : 1.0) * e[r * n + k];
            }
            b[i * n + k] = sum;
        }
        for (int j = 0; j <= i; ++j, ++at) {
            const double *Jj = J + (size_t)s->joints[j] * SIX * (size_t)n;
            double w = 1.0 / (s->length * s->length);
            for (int k = 0; k < n; ++k) {
                double linear = 0.0, turning = 0.0;
                for (int r = 0; r < 3; ++r) {
                    linear += Ji[r * n + k] * Jj[r * n + k];
                    turning += Ji[(r + 3) * n + k] * Jj[(r + 3) * n + k];
                }
                double mu = i == j ? MU * s->error[k] * s->error[k] + LEAST_MU : 0.0;
                A[at * n + k] = w * linear + turning + mu;
            }
        }
    }
}

/* Solve A x = b of all starts by Cholesky's method, in place. */
static void solve(int n, double *A, double *b)
{
    for (int j = 0; j < SIX; ++j) {
        double *d = A + (size_t)(j * (j + 1) / 2 + j) * (size_t)n;
        for (int m = 0; m < j; ++m) {
            const double *l = A + (size_t)(j * (j + 1) / 2 + m) * (size_t)n;
            for (int k = 0; k < n; ++k) {
                d[k] -= l[k] * l[k];
            }
        }
        for (int k = 0; k < n; ++k) {
            d[k] = 1.0 / sqrt(d[k] > 1e-300 ? d[k] : 1e-300);
        }
        for (int i = j + 1; i < SIX; ++i) {
            double *x = A + (size_t)(i * (i + 1) / 2 + j) * (size_t)n;
            for (int m = 0; m < j; ++m) {
                const double *l = A + (size_t)(i * (i + 1) / 2 + m) * (size_t)n;
                const double *r = A + (size_t)(j * (j + 1) / 2 + m) * (size_t)n;
                for (int k = 0; k < n; ++k) {
                    x[k] -= l[k] * r[k];
                }
            }
            for (int k = 0; k < n; ++k) {
                x[k] *= d[k];
            }
        }
    }
    for (int i = 0; i < SIX; ++i) {
        for (int m = 0; m < i; ++m) {
            const double *l = A + (size_t)(i * (i + 1) / 2 + m) * (size_t)n;
            for (int k = 0; k < n; ++k) {
                b[i * n + k] -= l[k] * b[m * n + k];
            }
        }
        const double *d = A + (size_t)(i * (i + 1) / 2 + i) * (size_t)n;
        for (int k = 0; k < n; ++k) {
            b[i * n + k] *= d[k];
        }
    }
    for (int i = SIX - 1; i >= 0; --i) {
        for (int m = i + 1; m < SIX; ++m) {
            const double *l = A + (size_t)(m * (m + 1) / 2 + i) * (size_t)n;
            for (int k = 0; k < n; ++k) {
                b[i * n + k] -= l[k] * b[m * n + k];
            }
        }
        const double *d = A + (size_t)(i * (i + 1) / 2 + i) * (size_t)n;
        for (int k = 0; k < n; ++k) {
            b[i * n + k] *= d[k];
        }
    }
}

/* Steps of all starts; the errors at the end are in s->error. */
IK_API void flexgen_ik_iterate(ik_problem *s, int32_t steps)
{
    size_t n = (size_t)s->n;
    double *p = s->scratch, *R = p + 3 * n, *J = R + 9 * n, *e = J + SIX * (size_t)s->n_a * n, *A = e + SIX * n,
           *b = A + 21 * n;
    for (int32_t step = 0;; ++step) {
        (void)((pose_function)s->pose)(s->n, s->q, p, R, s->work);
        errors(s, p, R, e);
        if (step == steps) {
            return;
        }
        (void)((jacobian_function)s->jacobian)(s->n, s->q, J, s->work);
        normal(s, J, e, A, b);
        solve(s->n, A, b);
        for (size_t k = 0; k < n; ++k) {
            double largest = 0.0;
            for (size_t i = 0; i < SIX; ++i) {
                largest = fabs(b[i * n + k]) > largest ? fabs(b[i * n + k]) : largest;
            }
            double share = largest > LONGEST ? LONGEST / largest : 1.0;
            for (size_t i = 0; i < SIX; ++i) {
                s->q[(size_t)s->joints[i] * n + k] -= share * b[i * n + k];
            }
        }
    }
}
