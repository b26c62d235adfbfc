/*
 * The elastic robot as a block: x = (q_a, q_m, v_a, v_m) with the motors behind elastic gears, u =
 * (tau_m, f_tool).
 *
 * Steps: the classical Runge-Kutta method of order four, or the implicit method SDIRK of order
 * four with five stages (gamma = 1/4, L-stable, the last stage is the result), with the emitted
 * Jacobian. The inputs are held in a step.
 *
 * Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, 1996, table IV.6.5.
 */
#ifndef FLEXGEN_FMU_PLANT_H
#define FLEXGEN_FMU_PLANT_H

enum { METHOD_RK4 = 1, METHOD_SDIRK4 = 2 }; /* setting 0 */
#if MODEL_MEMORY
enum { MOST_PARTS = 1000 };             /* of a step */
static const double MOST_FADING = 0.25; /* time constants of hysteresis and bristles in a part */
#endif                                  /* MODEL_MEMORY */
enum { STAGES = 5, ITERATIONS = 12, REFRESHES = 4, MOST_STEPS = 10000000 };
/* of a correction, relative to the size of each state */
static const double NEWTON_TOLERANCE = 1e-11;

static const char *block_check(unsigned index, double value, int before)
{
    if (index == P_STEP && !before) {
        return "integration.step is fixed: set it before the end of the initialization";
    }
    if (index == P_STEP && !(value > 0.0)) {
        return "integration.step: expected a positive time";
    }
    if (index == P_MASS && value < 0.0) {
        return "payload.mass: expected a number that is not negative";
    }
    return NULL;
}

static const char *block_rate(core *c, const double *x, double *rate)
{
    return MODEL_RATE(x, c->s.u, c->s.p, rate, c->work) == 0 ?
               NULL :
               "the accelerations are not finite: a state or an input is too large, or the mass "
               "matrix is singular";
}

static const char *block_output(core *c)
{
    return MODEL_OUTPUT(c->s.x, c->s.u, c->s.p, c->s.y, c->work) == 0 ?
               NULL :
               "the outputs are not finite";
}

static const char *linearized(core *c, const double *x)
{
    return MODEL_LINEARIZATION(x, c->s.u, c->s.p, c->A, c->B, c->work) == 0 ?
               NULL :
               "the Jacobian is not finite";
}

static const char *block_jacobian(core *c)
{
    const char *problem = linearized(c, c->s.x);
    if (problem == NULL && MODEL_OUTPUT_JACOBIAN(c->s.x, c->s.u, c->s.p, c->C, c->work) != 0) {
        problem = "the Jacobian of the outputs is not finite";
    }
    return problem;
}

static const char *block_start(core *c)
{
    return block_rate(c, c->s.x, c->rate);
}

static const char *block_parameters(core *c)
{
    return block_rate(c, c->s.x, c->rate);
}

static core_status block_tick(core *c)
{
    (void)c;
    return SUCCESS;
}

static const char *rk4_step(core *c, double h)
{
    static const double at[4] = {0.0, 0.5, 0.5, 1.0};
    double (*k)[ROOM(N_X)] = c->stage, *trial = c->stage[4];
    for (int stage = 0; stage < 4; ++stage) {
        const char *problem;
        for (int i = 0; i < N_X; ++i) {
            trial[i] = stage == 0 ? c->s.x[i] : c->s.x[i] + h * at[stage] * k[stage - 1][i];
        }
        problem = block_rate(c, trial, k[stage]);
        if (problem != NULL) {
            return problem;
        }
    }
    for (int i = 0; i < N_X; ++i) {
        c->s.x[i] += h / 6.0 * ((k[0][i] + k[3][i]) + 2.0 * (k[1][i] + k[2][i]));
    }
    return NULL;
}

/* The matrix I - hg A at x, as lu with row exchanges. */
static const char *factorized(core *c, const double *x, double hg)
{
    double *lu = c->lu;
    const char *problem = linearized(c, x);
    c->jacobian_known = 0;
    if (problem != NULL) {
        return problem;
    }
    for (int j = 0; j < N_X; ++j) {
        for (int i = 0; i < N_X; ++i) {
            lu[i * N_X + j] = (i == j ? 1.0 : 0.0) - hg * c->A[j * N_X + i];
        }
    }
    for (int k = 0; k < N_X; ++k) {
        int best = k;
        for (int i = k + 1; i < N_X; ++i) {
            if (fabs(lu[i * N_X + k]) > fabs(lu[best * N_X + k])) {
                best = i;
            }
        }
        c->pivot[k] = best;
        if (!(fabs(lu[best * N_X + k]) > 0.0)) {
            return "the matrix of the implicit step is singular: decrease integration.step";
        }
        for (int j = 0; j < N_X && best != k; ++j) {
            const double other = lu[k * N_X + j];
            lu[k * N_X + j] = lu[best * N_X + j];
            lu[best * N_X + j] = other;
        }
        for (int i = k + 1; i < N_X; ++i) {
            const double factor = lu[i * N_X + k] / lu[k * N_X + k];
            lu[i * N_X + k] = factor;
            for (int j = k + 1; j < N_X && factor != 0.0; ++j) {
                lu[i * N_X + j] -= factor * lu[k * N_X + j];
            }
        }
    }
    return NULL;
}

static void substituted(const core *c, double *b)
{
    /* whole rows were exchanged, so that all exchanges come first */
    for (int k = 0; k < N_X; ++k) {
        const double other = b[k];
        b[k] = b[c->pivot[k]];
        b[c->pivot[k]] = other;
    }
    for (int i = 0; i < N_X; ++i) {
        for (int j = 0; j < i; ++j) {
            b[i] -= c->lu[i * N_X + j] * b[j];
        }
    }
    for (int i = N_X - 1; i >= 0; --i) {
        for (int j = i + 1; j < N_X; ++j) {
            b[i] -= c->lu[i * N_X + j] * b[j];
        }
        b[i] /= c->lu[i * N_X + i];
    }
}

/*
 * Solve Y = known + hg rate(Y) from a guess in Y by Newton's method with the matrix that is there;
 * renew it if needed. With the last correction d of the remainder r, (I - hg A) d = r, the rate at
 * Y is that before it plus A d = (d - r) / hg: small numbers only. (Y - known) / hg would divide
 * the rounding of Y by the step.
 */
static const char *stage_solved(core *c, const double *known, double hg, double *Y, double *rate)
{
    double remainder[ROOM(N_X)], correction[ROOM(N_X)];
    for (int refresh = 0; refresh <= REFRESHES; ++refresh) {
        double last = HUGE_VAL;
        const char *problem = refresh == 0 ? NULL : factorized(c, Y, hg);
        for (int iteration = 0; problem == NULL && iteration < ITERATIONS; ++iteration) {
            double size = 0.0;
            problem = block_rate(c, Y, c->rate);
            for (int i = 0; i < N_X; ++i) {
                correction[i] = remainder[i] = known[i] + hg * c->rate[i] - Y[i];
            }
            substituted(c, correction);
            for (int i = 0; i < N_X; ++i) {
                const double own = fabs(correction[i]) / (X_NOMINAL[i] + fabs(Y[i]));
                size = own > size || own != own ? own : size;
                Y[i] += correction[i];
                rate[i] = c->rate[i] + (correction[i] - remainder[i]) / hg;
            }
            if (problem == NULL && size <= NEWTON_TOLERANCE &&
                (last <= NEWTON_TOLERANCE || size == 0.0)) {
                return NULL; /* the second small correction: what is left is rounding */
            }
            if (!(size < 2.0 * last)) { /* it diverges: a new matrix */
                break;
            }
            last = size;
        }
        if (problem != NULL) {
            return problem;
        }
    }
    return "Newton's method of the implicit step does not converge: decrease integration.step";
}

static const char *sdirk4_step(core *c, double h)
{
    static const double a[STAGES][STAGES] = {
        {1.0 / 4},
        {1.0 / 2, 1.0 / 4},
        {17.0 / 50, -1.0 / 25, 1.0 / 4},
        {371.0 / 1360, -137.0 / 2720, 15.0 / 544, 1.0 / 4},
        {25.0 / 24, -49.0 / 48, 125.0 / 16, -85.0 / 12, 1.0 / 4},
    };
    const double hg = h * a[0][0];
    double known[ROOM(N_X)], *Y = c->stage[5];
    const char *problem = factorized(c, c->s.x, hg);
    if (problem == NULL) {
        problem = block_rate(c, c->s.x, c->stage[0]);
    }
    for (int stage = 0; problem == NULL && stage < STAGES; ++stage) {
        const double *guess = c->stage[stage == 0 ? 0 : stage - 1];
        for (int i = 0; i < N_X; ++i) {
            double sum = 0.0;
            for (int j = 0; j < stage; ++j) {
                sum += a[stage][j] * c->stage[j][i];
            }
            known[i] = c->s.x[i] + h * sum;
            Y[i] = known[i] + hg * guess[i];
        }
        problem = stage_solved(c, known, hg, Y, c->stage[stage]);
    }
    if (problem == NULL) {
        memcpy(c->s.x, Y, N_X * sizeof *Y);
    }
    return problem;
}
#if MODEL_MEMORY

/*
 * Steps over `length`, each divided such that torques of hysteresis and bristles fade by
 * MOST_FADING in a part, at most: Runge-Kutta is stable until 2.8, and the error of both methods
 * is that of a smooth function.
 */
static const char *divided_step(core *c, double length)
{
    double done = 0.0;
    const char *problem = NULL;
    for (int part = 0; problem == NULL && done < length; ++part) {
        double fastest = 0.0, h = length - done;
        if (MODEL_FASTEST(c->s.x, c->s.u, c->s.p, &fastest, c->work) != 0) {
            return "the rates of hysteresis and bristles are not finite";
        }
        if (part >= MOST_PARTS) {
            return "the torques of hysteresis or bristles change too fast: decrease "
                   "integration.step";
        }
        if (h * fastest > MOST_FADING) {
            h = h / ceil(h * fastest / MOST_FADING);
        }
        problem = c->s.setting[0] == METHOD_SDIRK4 ? sdirk4_step(c, h) : rk4_step(c, h);
        done = h < length - done ? done + h : length;
    }
    return problem;
}
#endif /* MODEL_MEMORY */

static const char *block_advance(core *c, double length)
{
    const double wanted = ceil(length / c->s.p[P_STEP] - 1e-9);
    const char *problem = NULL;
    long steps;
    if (!(wanted < MOST_STEPS)) {
        return "integration.step is too small for this communication step";
    }
    steps = wanted < 1.0 ? 1 : (long)wanted;
    for (long k = 0; problem == NULL && k < steps; ++k) {
        const double h = length / (double)steps;
#if MODEL_MEMORY
        problem = divided_step(c, h);
#else  /* MODEL_MEMORY */
        problem = c->s.setting[0] == METHOD_SDIRK4 ? sdirk4_step(c, h) : rk4_step(c, h);
#endif /* MODEL_MEMORY */
    }
    for (int i = 0; problem == NULL && i < N_X; ++i) {
        if (!isfinite(c->s.x[i])) {
            problem =
                "the state is not finite: decrease integration.step, or use the implicit method";
        }
    }
    return problem;
}

#endif
