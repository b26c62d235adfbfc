/*
 * The sampled closed loop of robots that share one model: measure, control, limit, hold, integrate.
 *
 * All robots (lanes) advance together, so that the model is evaluated by its batch function. Arrays of the state are
 * structures of arrays: entry i of lane k is x[i * lanes + k]; results for the caller are y[(sample * lanes + lane) *
 * channels + channel]. The same inputs give the same bits on every machine that contracts no products.
 *
 * Between samples the equations of motion are integrated by the classical Runge-Kutta method of order four in equal
 * steps. Torques change only between steps: the delay is a whole number of steps.
 */
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__GNUC__)
#define LOOP_API __attribute__((visibility("default")))
#else
#define LOOP_API
#endif

enum { LOOP_DONE = 0, LOOP_NOT_FINITE = 1, LOOP_CONTROLLER_FAILED = 2 };

typedef int (*loop_plant)(int n, const double *q_a, const double *v_a, const double *q_m, const double *v_m,
    const double *tau_m, double *a_a, double *a_m, double *work);

/* The same of a library with run-time parameters. */
typedef int (*loop_parametrized)(int n, const double *q_a, const double *v_a, const double *q_m, const double *v_m,
    const double *tau_m, const double *parameters, double *a_a, double *a_m, double *work);

/* u from the measured y and the reference of sample k; anything but 0 stops the robot's control. */
typedef int (*loop_controller)(void *self, int64_t k, const double *y, const double *ref, double *u);

typedef struct {
    int32_t lanes, n_a, n_m, n_ref; /* n_ref: references of one robot and sample */
    int32_t steps, delay_steps;     /* of the integrator a sample; delay of the torque, less than one sample */
    double sample_s;
    void (*plant)(void);      /* loop_plant, or with parameters loop_parametrized */
    const double *parameters; /* of the plant, the same for all lanes; null: it has none */
    double *plant_work;
    loop_controller controller;
    unsigned char *memory; /* of the controllers, memory_size bytes for each lane */
    int64_t memory_size;
    const double *resolution, *angle_noise, *torque_noise, *torque_max; /* (n_m); 0: none */
    double *state;      /* q_a, v_a, q_m, v_m: 2 (n_a + n_m) rows of lanes */
    double *torque;     /* torque that acts now, noise included (n_m rows of lanes) */
    double *scratch;    /* 10 (n_a + n_m) + n_m rows of lanes */
    uint64_t *random;   /* four words for each lane, not all zero */
    int32_t *status;    /* of each lane */
    int64_t *saturated; /* samples at a torque limit, of each lane */
    double *record;     /* null, or for each sample the state and the torque that acts: 2 n_a + 3 n_m rows of lanes */
} loop_robots;

/* The next 64 random bits: xoshiro256++ (D. Blackman and S. Vigna, 2019). */
static uint64_t loop_bits(uint64_t *s)
{
    uint64_t sum = s[0] + s[3], result = ((sum << 23) | (sum >> 41)) + s[0], t = s[1] << 17;
    s[2] ^= s[0];
    s[3] ^= s[1];
    s[1] ^= s[2];
    s[0] ^= s[3];
    s[2] ^= t;
    s[3] = (s[3] << 45) | (s[3] >> 19);
    return result;
}

/* White noise of unit variance: the sum of twelve uniform numbers, nearly Gaussian, with the same bits everywhere. */
static double loop_noise(uint64_t *s)
{
    double sum = -6.0;
    for (int i = 0; i < 12; ++i) {
        sum += (double)(loop_bits(s) >> 11) * 0x1p-53;
    }
    return sum;
}

/* Rate of the state x under the torques that act. */
static void loop_rate(const loop_robots *r, const double *x, double *dx)
{
    size_t arm = (size_t)r->n_a * (size_t)r->lanes, motors = (size_t)r->n_m * (size_t)r->lanes;
    const double *v_a = x + arm, *q_m = v_a + arm, *v_m = q_m + motors;
    memcpy(dx, v_a, arm * sizeof *dx);
    memcpy(dx + 2 * arm, v_m, motors * sizeof *dx);
    /* the status is that of the first point that fails; whose state is not finite any more is found at the sample */
    if (r->parameters) {
        (void)((loop_parametrized)r->plant)(
            r->lanes, x, v_a, q_m, v_m, r->torque, r->parameters, dx + arm, dx + 2 * arm + motors, r->plant_work);
    } else {
        (void)((loop_plant)r->plant)(
            r->lanes, x, v_a, q_m, v_m, r->torque, dx + arm, dx + 2 * arm + motors, r->plant_work);
    }
}

/* One step of the classical Runge-Kutta method. */
static void loop_step(const loop_robots *r, double h)
{
    size_t n = 2 * ((size_t)r->n_a + (size_t)r->n_m) * (size_t)r->lanes;
    double *x = r->state, *k1 = r->scratch, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *at = k4 + n;
    loop_rate(r, x, k1);
    for (size_t i = 0; i < n; ++i) {
        at[i] = x[i] + 0.5 * h * k1[i];
    }
    loop_rate(r, at, k2);
    for (size_t i = 0; i < n; ++i) {
        at[i] = x[i] + 0.5 * h * k2[i];
    }
    loop_rate(r, at, k3);
    for (size_t i = 0; i < n; ++i) {
        at[i] = x[i] + h * k3[i];
    }
    loop_rate(r, at, k4);
    for (size_t i = 0; i < n; ++i) {
        x[i] += h / 6.0 * ((k1[i] + k4[i]) + 2.0 * (k2[i] + k3[i]));
    }
}

/* What the encoders of one robot show. */
static void loop_measure(const loop_robots *r, int lane, double *y)
{
    const double *q_m = r->state + 2 * (size_t)r->n_a * (size_t)r->lanes;
    for (int j = 0; j < r->n_m; ++j) {
        double angle = q_m[(size_t)j * (size_t)r->lanes + (size_t)lane];
        if (r->angle_noise[j] > 0.0) {
            angle += r->angle_noise[j] * loop_noise(r->random + 4 * (size_t)lane);
        }
        y[j] = r->resolution[j] > 0.0 ? floor(angle / r->resolution[j] + 0.5) * r->resolution[j] : angle;
    }
}

static int loop_finite(const loop_robots *r, int lane)
{
    int rows = 2 * (r->n_a + r->n_m);
    for (int i = 0; i < rows; ++i) {
        if (!isfinite(r->state[(size_t)i * (size_t)r->lanes + (size_t)lane])) {
            return 0;
        }
    }
    return 1;
}

/* Torque of one robot for the next interval: commanded and limited (u), and what acts (next, with noise). */
static void loop_control(
    loop_robots *r, int lane, int64_t k, const double *y, const double *ref, double *u, double *next)
{
    size_t lanes = (size_t)r->lanes, own = (size_t)lane;
    int limited = 0;
    for (int j = 0; j < r->n_m; ++j) {
        u[j] = 0.0;
    }
    if (r->status[lane] == LOOP_DONE && r->controller(r->memory + (size_t)r->memory_size * own, k, y, ref, u) != 0) {
        r->status[lane] = LOOP_CONTROLLER_FAILED;
    }
    for (int j = 0; j < r->n_m; ++j) {
        double most = r->torque_max[j], noise = 0.0;
        if (!isfinite(u[j]) || r->status[lane] != LOOP_DONE) {
            r->status[lane] = r->status[lane] == LOOP_DONE ? LOOP_CONTROLLER_FAILED : r->status[lane];
            u[j] = 0.0;
        }
        if (most > 0.0 && fabs(u[j]) > most) {
            u[j] = u[j] > 0.0 ? most : -most;
            limited = 1;
        }
        if (r->torque_noise[j] > 0.0) {
            noise = r->torque_noise[j] * loop_noise(r->random + 4 * own);
        }
        next[(size_t)j * lanes + own] = u[j] + noise;
    }
    r->saturated[lane] += limited;
}

/*
 * Run samples first .. first + n - 1.
 *
 * ref: references of period samples, (period, lanes, n_ref), repeated; y, u: measured angles and commanded torques
 * (n, lanes, n_m). Returns the number of robots whose status is not LOOP_DONE; those keep their place in the arrays.
 */
LOOP_API int flexgen_loop_run(
    loop_robots *r, int64_t first, int64_t n, const double *ref, int64_t period, double *y, double *u)
{
    size_t lanes = (size_t)r->lanes, n_m = (size_t)r->n_m, n_ref = (size_t)r->n_ref;
    double h = r->sample_s / r->steps;
    double *next = r->scratch + 10 * ((size_t)r->n_a + n_m) * lanes;
    int failed = 0;
    for (int64_t k = 0; k < n; ++k) {
        const double *given = ref + (size_t)((first + k) % period) * lanes * n_ref;
        if (r->record) {
            size_t state = 2 * ((size_t)r->n_a + n_m) * lanes, torque = n_m * lanes;
            memcpy(r->record + (size_t)k * (state + torque), r->state, state * sizeof(double));
            memcpy(r->record + (size_t)k * (state + torque) + state, r->torque, torque * sizeof(double));
        }
        for (int lane = 0; lane < r->lanes; ++lane) {
            double *shown = y + ((size_t)k * lanes + (size_t)lane) * n_m;
            double *commanded = u + ((size_t)k * lanes + (size_t)lane) * n_m;
            if (r->status[lane] == LOOP_DONE && !loop_finite(r, lane)) {
                r->status[lane] = LOOP_NOT_FINITE;
            }
            if (r->status[lane] == LOOP_NOT_FINITE) { /* at rest at zero, so that the batch stays finite */
                for (size_t i = 0; i < 2 * ((size_t)r->n_a + n_m); ++i) {
                    r->state[i * lanes + (size_t)lane] = 0.0;
                }
            }
            loop_measure(r, lane, shown);
            loop_control(r, lane, first + k, shown, given + (size_t)lane * n_ref, commanded, next);
        }
        for (int step = 0; step < r->steps; ++step) {
            if (step == r->delay_steps) {
                memcpy(r->torque, next, n_m * lanes * sizeof *next);
            }
            loop_step(r, h);
        }
    }
    for (int lane = 0; lane < r->lanes; ++lane) {
        failed += r->status[lane] != LOOP_DONE;
    }
    return failed;
}

/*
 * A drive with position and speed control (P-PI) and feedforward torque:
 *
 *     e = q_ref - q,   w = v_ref + k_p e - v,   u = tau_ff + k_v (w + k_i int w dt)
 *
 * v: difference of two samples of q; v_ref: the same difference of q_ref, so that the filter does not show. The
 * references of motor j are ref[j] (angle) and ref[n_m + j] (torque).
 */
typedef struct {
    int64_t n_m;
    double sample_s;
    /* then k_p, k_v, k_i, last q, last q_ref, integral: n_m each */
} loop_cascade;

LOOP_API int flexgen_loop_cascade(void *self, int64_t k, const double *y, const double *ref, double *u)
{
    loop_cascade *c = (loop_cascade *)self;
    size_t n = (size_t)c->n_m;
    double *k_p = (double *)(c + 1), *k_v = k_p + n, *k_i = k_v + n, *q = k_i + n, *q_ref = q + n, *sum = q_ref + n;
    (void)k;
    for (size_t j = 0; j < n; ++j) {
        double v = (y[j] - q[j]) / c->sample_s, v_ref = (ref[j] - q_ref[j]) / c->sample_s;
        double w = v_ref + k_p[j] * (ref[j] - y[j]) - v;
        sum[j] += w * c->sample_s;
        u[j] = ref[n + j] + k_v[j] * (w + k_i[j] * sum[j]);
        q[j] = y[j];
        q_ref[j] = ref[j];
    }
    return 0;
}
