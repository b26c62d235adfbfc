/*
 * A chain of bodies, gears and rotors under given torques, alone or with P-PI feedback of its
 * motors: a referee.
 *
 * Equations of motion by composite inertias and wrenches about the origin of the world;
 * integration by the formulas of Dormand and Prince of order 8, whose coefficients are given.
 * Nothing is taken from flexgen. See whole_move.py.
 */
#include <math.h>
#include <string.h>

enum { MOST = 40, STEPS = 200, ROW = 16, STAGES = 12, POWERS = 6 };
enum { FIXED, ROTATION, TRANSLATION, MASS, ROTOR };

typedef struct {
    int n_steps, n_a, n_m, dof, n_laws, feedback, free; /* free: P is the identity */
    const double *steps;                                /* (n_steps, ROW): kind, index, numbers */
    /* (n_laws, n_a + n_m + 11): row, kind and three numbers of a spring, damping, friction */
    const double *laws;
    const double *spread; /* P (n_a + n_m, dof): all coordinates from the independent ones */
    const double *rotors; /* inertias of the rotors that no body carries, (n_m,) */
    const double *gravity, *gains; /* gains: (3, n_m) */
} robot;

static void cross(const double *a, const double *b, double *c)
{
    const double x = a[1] * b[2] - a[2] * b[1], y = a[2] * b[0] - a[0] * b[2],
                 z = a[0] * b[1] - a[1] * b[0];
    c[0] = x, c[1] = y, c[2] = z;
}

static double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void turn(const double *R, const double *a, double *b)
{
    const double x = dot(R, a), y = dot(R + 3, a), z = dot(R + 6, a);
    b[0] = x, b[1] = y, b[2] = z;
}

static void multiply(const double *A, const double *B, double *C) /* 3 x 3 */
{
    double out[9];
    for (int i = 0; i < 9; ++i) {
        out[i] = A[i / 3 * 3] * B[i % 3] + A[i / 3 * 3 + 1] * B[3 + i % 3] +
                 A[i / 3 * 3 + 2] * B[6 + i % 3];
    }
    memcpy(C, out, sizeof out);
}

/* du += dw x r + w x (w x r) */
static void shift(double *du, const double *dw, const double *w, const double *r)
{
    double a[3], b[3];
    cross(dw, r, a);
    cross(w, r, b);
    cross(w, b, b);
    for (int i = 0; i < 3; ++i) {
        du[i] += a[i] + b[i];
    }
}

static double spring(const double *s, double d)
{
    const double size = fabs(d), inside = fmin(size, s[3]), sign = d < 0.0 ? -1.0 : 1.0;
    switch ((int)s[0]) {
    case 1:
        return s[1] * d;
    case 2:
        return s[1] * d + s[2] * d * d * d;
    case 3:
        return sign * (s[1] * inside + (s[2] - s[1]) / (3 * s[3] * s[3]) * pow(inside, 3) +
                          s[2] * (size - inside));
    case 4:
        return sign * (s[1] * inside + s[2] * (size - inside));
    case 5:
        return s[1] * (d - 0.5 * (hypot(d + s[2], s[3]) - hypot(d - s[2], s[3])));
    default:
        return 0.0;
    }
}

/*
 * Mass matrix M (N, N) and bias (N) of all coordinates, N = n_a + n_m, and the place of the tool
 * (position, R).
 */
static void sweep(
    const robot *r, const double *q, const double *v, double *M, double *bias, double *tool)
{
    const int N = r->n_a + r->n_m;
    static _Thread_local double at[STEPS][12], wrench[STEPS][6];
    double R[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, p[3] = {0}, w[3] = {0}, dw[3] = {0}, du[3];
    double F[3] = {0}, T[3] = {0}, m = 0.0, h[3] = {0}, I[9] = {0};
    int seen[MOST], n_seen = 0;
    for (int i = 0; i < 3; ++i) {
        du[i] = -r->gravity[i];
    }
    for (int k = 0; k < r->n_steps; ++k) {
        const double *s = r->steps + k * ROW, *a = s + 2;
        const int index = (int)s[1];
        double *to = at[k], *force = wrench[k], *moment = wrench[k] + 3, e[3], c[3];
        memset(wrench[k], 0, sizeof wrench[k]);
        switch ((int)s[0]) {
        case FIXED:
            turn(R, a, c);
            shift(du, dw, w, c);
            for (int i = 0; i < 3; ++i) {
                p[i] += c[i];
            }
            multiply(R, a + 3, R);
            break;
        case ROTATION: {
            const double x = q[index], cx = cos(x), sx = sin(x);
            double Q[9];
            for (int i = 0; i < 3; ++i) {
                for (int j = 0; j < 3; ++j) {
                    Q[3 * i + j] = (i == j ? cx : 0.0) + (1.0 - cx) * a[i] * a[j];
                }
            }
            Q[1] -= sx * a[2], Q[2] += sx * a[1], Q[3] += sx * a[2];
            Q[5] -= sx * a[0], Q[6] -= sx * a[1], Q[7] += sx * a[0];
            turn(R, a, e);
            multiply(R, Q, R);
            cross(w, e, c);
            for (int i = 0; i < 3; ++i) {
                dw[i] += c[i] * v[index];
                w[i] += e[i] * v[index];
                to[i] = e[i];
            }
            cross(p, e, to + 3);
            break;
        }
        case TRANSLATION:
            turn(R, a, e);
            cross(w, e, c);
            for (int i = 0; i < 3; ++i) {
                to[i] = 0.0;
                to[3 + i] = e[i];
                du[i] += 2 * c[i] * v[index];
                c[i] = e[i] * q[index];
            }
            shift(du, dw, w, c);
            for (int i = 0; i < 3; ++i) {
                p[i] += c[i];
            }
            break;
        case MASS: {
            double J[9], Rt[9], acc[3], spin[3], more[3];
            for (int i = 0; i < 9; ++i) {
                Rt[i] = R[i % 3 * 3 + i / 3];
            }
            multiply(R, a + 4, J);
            multiply(J, Rt, J);
            turn(R, a + 1, c);
            memcpy(acc, du, sizeof acc);
            shift(acc, dw, w, c);
            turn(J, w, spin);
            cross(w, spin, spin);
            turn(J, dw, more);
            for (int i = 0; i < 3; ++i) {
                c[i] += p[i];
                force[i] = a[0] * acc[i];
            }
            cross(c, force, moment);
            for (int i = 0; i < 3; ++i) {
                moment[i] += spin[i] + more[i] + a[13] * w[i];
                to[i] = c[i];
            }
            for (int i = 0; i < 9; ++i) {
                to[3 + i] = J[i] + a[0] * ((i % 4 == 0 ? dot(c, c) : 0.0) - c[i / 3] * c[i % 3]);
            }
            break;
        }
        default: /* ROTOR */
            turn(R, a + 1, e);
            cross(w, e, c);
            for (int i = 0; i < 3; ++i) {
                to[i] = e[i];
                moment[i] = a[0] * (dot(e, dw) * e[i] + (v[r->n_a + index] + dot(e, w)) * c[i]);
            }
        }
    }
    memcpy(tool, p, sizeof p);
    memcpy(tool + 3, R, sizeof R);
    memset(M, 0, sizeof(double) * N * N);
    memset(bias, 0, sizeof(double) * N);
    for (int j = 0; j < r->n_m; ++j) {
        M[(r->n_a + j) * (N + 1)] = r->rotors[j];
    }
    for (int k = r->n_steps - 1; k >= 0; --k) {
        const double *s = r->steps + k * ROW, *a = s + 2, *to = at[k];
        const int kind = (int)s[0], index = (int)s[1];
        for (int i = 0; i < 3; ++i) {
            F[i] += wrench[k][i];
            T[i] += wrench[k][3 + i];
        }
        if (kind == MASS) {
            m += a[0];
            for (int i = 0; i < 9; ++i) {
                I[i] += to[3 + i];
                h[i / 3] += i % 3 ? 0.0 : a[0] * to[i / 3];
            }
        } else if (kind == ROTOR) {
            const int row = r->n_a + index;
            M[row * (N + 1)] += a[0];
            for (int i = 0; i < 9; ++i) {
                I[i] += a[0] * to[i / 3] * to[i % 3];
            }
            seen[n_seen++] = k;
            /* J e.dw: the gyroscopic part is across the axis */
            bias[row] += dot(wrench[k] + 3, to);
        } else if (kind == ROTATION || kind == TRANSLATION) {
            double f[3], n[3], c[3];
            bias[index] = dot(to, T) + dot(to + 3, F);
            cross(to, h, f);
            cross(h, to + 3, c);
            turn(I, to, n);
            for (int i = 0; i < 3; ++i) {
                f[i] += m * to[3 + i];
                n[i] += c[i];
            }
            for (int l = k; l >= 0; --l) {
                const double *o = r->steps + l * ROW;
                if (o[0] == ROTATION || o[0] == TRANSLATION) {
                    const int i = (int)o[1];
                    M[i * N + index] = M[index * N + i] = dot(at[l], n) + dot(at[l] + 3, f);
                }
            }
            for (int l = 0; l < n_seen; ++l) {
                const double *o = r->steps + seen[l] * ROW;
                const int row = r->n_a + (int)o[1];
                M[row * N + index] = M[index * N + row] = o[2] * dot(at[seen[l]], to);
            }
        }
    }
}

/*
 * Rates of x = (y, dy, integrals of the feedback); u: torques, then reference angles and speeds of
 * the motors.
 */
void rate(const robot *r, const double *x, const double *u, double *out, double *tool)
{
    const int n_a = r->n_a, n_m = r->n_m, N = n_a + n_m, n = r->dof, width = N + 11;
    double q[MOST], v[MOST], M[MOST * MOST], bias[MOST], f[MOST], A[MOST * MOST], b[MOST];
    for (int i = 0; i < N; ++i) {
        q[i] = v[i] = f[i] = 0.0;
        for (int j = 0; j < n; ++j) {
            q[i] += r->spread[i * n + j] * x[j];
            v[i] += r->spread[i * n + j] * x[n + j];
        }
    }
    for (int j = 0; j < n_m; ++j) {
        f[n_a + j] = u[j];
        if (r->feedback) {
            const double error = u[n_m + j] - q[n_a + j];
            out[2 * n + j] = u[2 * n_m + j] + r->gains[j] * error - v[n_a + j];
            f[n_a + j] += r->gains[n_m + j] *
                          (out[2 * n + j] + r->gains[2 * n_m + j] * x[2 * n + j]);
        }
    }
    for (int k = 0; k < r->n_laws; ++k) {
        const double *row = r->laws + k * width, *s = row + N, *c = s + 5;
        double d = 0.0, dd = 0.0, force;
        for (int i = 0; i < N; ++i) {
            d += row[i] * q[i];
            dd += row[i] * v[i];
        }
        force = spring(s, d) + s[4] * dd + c[0] * dd +
                (c[1] + c[2] / cosh(c[3] * dd)) * tanh(c[4] * dd) + c[5];
        for (int i = 0; i < N; ++i) {
            f[i] -= row[i] * force;
        }
    }
    sweep(r, q, v, M, bias, tool);
    for (int i = 0; i < n; ++i) {
        double half[MOST];
        out[i] = x[n + i];
        b[i] = 0.0;
        if (r->free) {
            b[i] = f[i] - bias[i];
            memcpy(A + i * n, M + i * n, sizeof(double) * n);
            continue;
        }
        for (int k = 0; k < N; ++k) {
            b[i] += r->spread[k * n + i] * (f[k] - bias[k]);
            half[k] = 0.0;
            for (int l = 0; l < N; ++l) {
                half[k] += r->spread[l * n + i] * M[l * N + k];
            }
        }
        for (int j = 0; j < n; ++j) {
            A[i * n + j] = 0.0;
            for (int k = 0; k < N; ++k) {
                A[i * n + j] += half[k] * r->spread[k * n + j];
            }
        }
    }
    for (int j = 0; j < n; ++j) { /* Cholesky */
        for (int i = j; i < n; ++i) {
            double sum = A[i * n + j];
            for (int k = 0; k < j; ++k) {
                sum -= A[i * n + k] * A[j * n + k];
            }
            A[i * n + j] = i == j ? sqrt(sum) : sum / A[j * n + j];
        }
    }
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < i; ++k) {
            b[i] -= A[i * n + k] * b[k];
        }
        b[i] /= A[i * n + i];
    }
    for (int i = n - 1; i >= 0; --i) {
        for (int k = i + 1; k < n; ++k) {
            b[i] -= A[k * n + i] * b[k];
        }
        out[n + i] = b[i] /= A[i * n + i];
    }
}

static void inputs(const double *c, int width, double s, double *u)
{
    for (int j = 0; j < width; ++j) {
        u[j] = 0.0;
        for (int k = POWERS - 1; k >= 0; --k) {
            u[j] = u[j] * s + c[k * width + j];
        }
    }
}

/*
 * States at the instants t (n,), out (n, nx), and places of the tool, tools (n, 12). pieces: (n -
 * 1, POWERS, width), the inputs as polynomials of the time since t[k]. tableau: c (12), A (12,
 * 12), b (12), E3 (13), E5 (13). Returns the number of instants reached; fewer than n where more
 * than `most` evaluations are needed.
 */
int integrate(const robot *r, int n, const double *t, int nx, const double *pieces, int width,
    const double *tableau, double rtol, double atol, double most, double *out, double *tools)
{
    const double *c = tableau, *A = c + STAGES, *b = A + STAGES * STAGES, *E3 = b + STAGES,
                 *E5 = E3 + STAGES + 1;
    double K[STAGES + 1][3 * MOST], x[3 * MOST], next[3 * MOST], u[3 * MOST], unused[12],
        h = 1e-5, spent = 0.0;
    memcpy(x, out, sizeof(double) * nx);
    inputs(pieces, width, 0.0, u);
    rate(r, x, u, K[0], tools);
    for (int k = 0; k + 1 < n; ++k) {
        const double *piece = pieces + k * POWERS * width, length = t[k + 1] - t[k];
        double s = 0.0;
        inputs(piece, width, 0.0, u);
        rate(r, x, u, K[0], tools + 12 * k);
        while (s < length) {
            const double left = length - s, step = h < left ? h : left;
            double n3 = 0.0, n5 = 0.0, error;
            for (int i = 1; i <= STAGES; ++i) {
                for (int l = 0; l < nx; ++l) {
                    double sum = 0.0;
                    for (int j = 0; j < i; ++j) {
                        sum += (i < STAGES ? A[i * STAGES + j] : b[j]) * K[j][l];
                    }
                    next[l] = x[l] + step * sum;
                }
                inputs(piece, width, s + (i < STAGES ? c[i] : 1.0) * step, u);
                rate(r, next, u, K[i], unused);
            }
            spent += STAGES;
            for (int l = 0; l < nx; ++l) {
                const double scale = atol + rtol * fmax(fabs(x[l]), fabs(next[l]));
                double e3 = 0.0, e5 = 0.0;
                for (int j = 0; j <= STAGES; ++j) {
                    e3 += E3[j] * K[j][l];
                    e5 += E5[j] * K[j][l];
                }
                n3 += e3 * e3 / scale / scale;
                n5 += e5 * e5 / scale / scale;
            }
            error = n5 + n3 > 0.0 ? step * n5 / sqrt((n5 + 0.01 * n3) * nx) : 0.0;
            if (!(error < 1e300) || spent > most) {
                return k + 1;
            }
            if (error <= 1.0) {
                s = step < left ? s + step : length;
                memcpy(x, next, sizeof(double) * nx);
                memcpy(K[0], K[STAGES], sizeof K[0]);
            }
            if (error > 1.0 || step == h || error > 0.1) {
                h = step * fmin(5.0, fmax(0.2, 0.9 * pow(error + 1e-30, -0.125)));
            }
        }
        memcpy(out + (k + 1) * nx, x, sizeof(double) * nx);
        rate(r, x, u, K[0], tools + 12 * (k + 1));
    }
    return n;
}
