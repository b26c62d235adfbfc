/*
 * The sampled closed loop of robots that share one model: measure, control, limit, delay, hold,
 * integrate.
 *
 * All robots (lanes) advance together, so that the model is evaluated by its batch function.
 * Arrays of the state are structures of arrays: entry i of lane k is x[i * lanes + k]; results for
 * the caller are y[(sample * lanes + lane) * channels + channel]. The same inputs give the same
 * bits on every machine that contracts no products.
 *
 * Between samples the equations of motion are integrated by the classical Runge-Kutta method of
 * order four in equal steps. Torques and disturbances change only between steps: the delay is a
 * whole number of steps.
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

enum { LOOP_DONE = 0, LOOP_NOT_FINITE = 1, LOOP_CONTROLLER_FAILED = 2, LOOP_STEP_TOO_LONG = 3 };
enum { LOOP_TOOL = 6 }; /* entries of a force and a torque on the tool */

/*
 * Functions of the model's library, for n points (with_n) or for one. The parameters come before
 * the results where the library has any.
 */
typedef int (*loop_plant)(int n, const double *q_a, const double *v_a, const double *q_m,
    const double *v_m, const double *tau_m, double *a_a, double *a_m, double *work);
typedef int (*loop_parametrized)(int n, const double *q_a, const double *v_a, const double *q_m,
    const double *v_m, const double *tau_m, const double *parameters, double *a_a, double *a_m,
    double *work);
typedef int (*loop_one)(const double *q_a, const double *v_a, const double *q_m, const double *v_m,
    const double *tau_m, double *a_a, double *a_m, double *work);
typedef int (*loop_one_plain)(const double *q_a, const double *v_a, const double *q_m,
    const double *v_m, const double *tau_m, double *a_a, double *a_m);
typedef int (*loop_pushed)(int n, const double *q_a, const double *v_a, const double *q_m,
    const double *v_m, const double *tau_m, const double *f_tool, double *a_a, double *a_m,
    double *tau_g, double *work);
typedef int (*loop_pushed_parametrized)(int n, const double *q_a, const double *v_a,
    const double *q_m, const double *v_m, const double *tau_m, const double *f_tool,
    const double *parameters, double *a_a, double *a_m, double *tau_g, double *work);
typedef int (*loop_sensors)(
    int n, const double *q_a, const double *v_a, const double *a_a, double *y_s, double *work);

/*
 * u from the measured y and the reference of sample k; anything but 0 stops the robot's control.
 */
typedef int (*loop_controller)(
    void *self, int64_t k, const double *y, const double *ref, double *u);

/*
 * The same for all robots at once: y (lanes, n_y), ref (lanes, n_ref), u (lanes, n_m); NaN stops a
 * robot's control.
 */
typedef void (*loop_controllers)(int64_t k, const double *y, const double *ref, double *u);

/*
 * A function that CasADi writes, for one robot, and numbers of each robot, which one of its inputs
 * takes. Robots whose gears have hysteresis: its inputs are the state with the gears' torques z/W
 * at the end, the motor torques, the numbers, and the force on the tool where it has one; its
 * output is the rate of the state. Signals of sensors: q_a, v_a, a_a, force on the tool, numbers.
 * Wall: q_a, v_a, numbers; its output is the force on the tool.
 */
typedef struct {
    int (*function)(const double **arg, double **res, long long *iw, double *w, int mem);
    const double **arg;
    double **res;
    long long *iw;
    double *w;
    const double *numbers; /* (lanes, n_numbers) */
    int64_t n_numbers;
    double *point; /* inputs and outputs of one robot */
} loop_function;

typedef struct {
    int32_t lanes, n_a, n_m, n_g;
    /* measured channels: motor angles, sensors, states; references of a sample */
    int32_t n_y, n_ref;
    /* channels of the exact state q_a, v_a, q_m, v_m at the end: all or none */
    int32_t states;
    int32_t steps; /* of the integrator a sample */
    /* of the torque: steps, less than a sample; memory of whole samples, 1 + the largest */
    int32_t delay_steps, slots;
    int32_t history; /* largest delay of a channel [samples] */
    /* lanes that the disturbances are given for: 0 (none), 1 (for all), lanes */
    int32_t disturbed;
    double sample_s;
    void (*plant)(void); /* loop_plant, or with parameters loop_parametrized */
    /* for a single robot: the plant for one point, loop_one, or without work loop_one_plain */
    void (*one)(void);
    void (*pushed)(void);  /* loop_pushed, or with parameters loop_pushed_parametrized; or null */
    void (*sensors)(void); /* loop_sensors; null: there are none */
    /* of the plant: for all lanes or for each, as the library takes them */
    const double *parameters;
    double *one_work;
    double *plant_work;
    loop_controller controller;
    unsigned char *memory; /* of the controllers, memory_size bytes for each lane */
    int64_t memory_size;
    const double *resolution, *noise, *bias; /* (n_y); 0: none */
    /* whole samples from a measurement to its torque, of each lane */
    const int32_t *delay;
    const int32_t *late;                     /* delays of the channels [samples] (n_y) */
    const double *gain;                      /* (lanes): factor of the feedback, 1 as a rule */
    const double *torque_noise, *torque_max; /* (n_m); 0: none */
    /* (steps, n_m + 6, disturbed): motor torques, force on the tool */
    const double *disturbances;
    const unsigned char *pushing; /* (steps): whether a force acts on a tool */
    /* q_a, v_a, q_m, v_m, z/W: 2 (n_a + n_m) + n_z rows of lanes */
    double *state;
    /* torque that acts now, noise included (n_m rows of lanes) */
    double *torque;
    /* torques of the last samples, slots times n_m rows of lanes */
    double *pending;
    /* what the channels measured, history + 1 slots of n_y rows of lanes */
    double *shown;
    /* 10 (n_a + n_m) + 5 n_z + n_m + n_g + n_y + 12 rows of lanes */
    double *scratch;
    uint64_t *random;   /* four words for each lane, not all zero */
    int32_t *status;    /* of each lane */
    int64_t *saturated; /* samples at a torque limit, of each lane */
    /* null, or for each sample the state and the torque that acts: 2 n_a + 3 n_m rows of lanes */
    double *record;
    /* the sample, for another thread that looks whether a controller returns */
    volatile int64_t now;
    /* not zero: another thread asks to end before the next sample */
    volatile int32_t stop;
    loop_controllers together;       /* null, or in place of the controller of each robot */
    const loop_function *hysteresis; /* null, or in place of the plant */
    int32_t n_z;                     /* gears with a torque z in the state: all or none */
    int32_t encoder_terms;
    /* (encoder_terms, 4): motor, k, c, s: it shows c cos(k q) + s sin(k q) too much */
    const double *encoder_error;
    const loop_function *signals; /* null, or in place of the sensors */
    /* null, or a force on the tool in addition to the disturbances */
    const loop_function *wall;
    /* (n_edges, 3): motor, torque at rest, and what its speed takes from it */
    const double *torque_edges;
    int32_t n_edges;
} loop_robots;

#define LOOP_MOST_SHARE 1.01 /* of |z/W|, which is at most 1 where the steps are short enough */

/* Rows of the state. */
static size_t loop_rows(const loop_robots *r)
{
    return 2 * ((size_t)r->n_a + (size_t)r->n_m) + (size_t)r->n_z;
}

/* Parts of the scratch memory. */
typedef struct {
    /* force on the tool: disturbance, and all together */
    double *stages, *acting, *tau_g, *signals, *given, *f_tool;
} loop_parts;

static loop_parts parts_of(const loop_robots *r)
{
    size_t lanes = (size_t)r->lanes, n_m = (size_t)r->n_m;
    loop_parts p;
    p.stages = r->scratch;
    p.acting = p.stages + 5 * loop_rows(r) * lanes;
    p.tau_g = p.acting + n_m * lanes;
    p.signals = p.tau_g + (size_t)r->n_g * lanes;
    p.given = p.signals + (size_t)r->n_y * lanes;
    p.f_tool = r->wall ? p.given + LOOP_TOOL * lanes : p.given;
    return p;
}

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

/*
 * White noise of unit variance: the sum of twelve uniform numbers, nearly Gaussian, with the same
 * bits everywhere.
 */
static double loop_noise(uint64_t *s)
{
    double sum = -6.0;
    for (int i = 0; i < 12; ++i) {
        sum += (double)(loop_bits(s) >> 11) * 0x1p-53;
    }
    return sum;
}

/* Accelerations at the state x under the torques that act. */
static void loop_accelerations(
    const loop_robots *r, const loop_parts *p, int push, const double *x, double *a_a, double *a_m)
{
    size_t arm = (size_t)r->n_a * (size_t)r->lanes, motors = (size_t)r->n_m * (size_t)r->lanes;
    const double *v_a = x + arm, *q_m = v_a + arm, *v_m = q_m + motors,
                 *tau = r->disturbed ? p->acting : r->torque;
    double *work = r->plant_work;
    int n = r->lanes;
    /*
     * the status is that of the first point that fails; whose state is not finite any more is
     * found at the sample
     */
    if (push && r->parameters) {
        (void)((loop_pushed_parametrized)r->pushed)(
            n, x, v_a, q_m, v_m, tau, p->f_tool, r->parameters, a_a, a_m, p->tau_g, work);
    } else if (push) {
        (void)((loop_pushed)r->pushed)(
            n, x, v_a, q_m, v_m, tau, p->f_tool, a_a, a_m, p->tau_g, work);
    } else if (r->one && r->one_work) {
        (void)((loop_one)r->one)(x, v_a, q_m, v_m, tau, a_a, a_m, r->one_work);
    } else if (r->one) {
        (void)((loop_one_plain)r->one)(x, v_a, q_m, v_m, tau, a_a, a_m);
    } else if (r->parameters) {
        (void)((loop_parametrized)r->plant)(
            n, x, v_a, q_m, v_m, tau, r->parameters, a_a, a_m, work);
    } else {
        (void)((loop_plant)r->plant)(n, x, v_a, q_m, v_m, tau, a_a, a_m, work);
    }
}

/* The same rate of robots whose gears have hysteresis, one after the other. */
static void loop_hysteretic(
    const loop_robots *r, const loop_parts *p, int push, const double *x, double *dx)
{
    const loop_function *h = r->hysteresis;
    size_t lanes = (size_t)r->lanes, n_m = (size_t)r->n_m, n = loop_rows(r);
    const double *tau = r->disturbed ? p->acting : r->torque;
    double *at = h->point, *torque = at + n, *force = torque + n_m, *rate = force + LOOP_TOOL;
    for (size_t lane = 0; lane < lanes; ++lane) {
        for (size_t i = 0; i < n; ++i) {
            at[i] = x[i * lanes + lane];
        }
        for (size_t j = 0; j < n_m; ++j) {
            torque[j] = tau[j * lanes + lane];
        }
        for (size_t j = 0; push && j < LOOP_TOOL; ++j) {
            force[j] = p->f_tool[j * lanes + lane];
        }
        h->arg[0] = at;
        h->arg[1] = torque;
        h->arg[2] = h->numbers + (size_t)h->n_numbers * lane;
        h->arg[3] = push ? force : NULL; /* null: zero */
        h->res[0] = rate;
        (void)h->function(h->arg, h->res, h->iw, h->w, 0);
        for (size_t i = 0; i < n; ++i) {
            dx[i * lanes + lane] = rate[i];
        }
    }
}

/* Entries of one robot from an array of all. */
static double *loop_gather(const double *x, size_t rows, size_t lanes, size_t lane, double *out)
{
    for (size_t i = 0; i < rows; ++i) {
        out[i] = x[i * lanes + lane];
    }
    return out + rows;
}

/* The force of the wall on each tool, with that of the disturbances. */
static void loop_touch(const loop_robots *r, const loop_parts *p, int push, const double *x)
{
    const loop_function *w = r->wall;
    size_t lanes = (size_t)r->lanes, n_a = (size_t)r->n_a;
    double *force = w->point + 2 * n_a;
    for (size_t lane = 0; lane < lanes; ++lane) {
        (void)loop_gather(x, 2 * n_a, lanes, lane, w->point);
        w->arg[0] = w->point;
        w->arg[1] = w->point + n_a;
        w->arg[2] = w->numbers + (size_t)w->n_numbers * lane;
        w->res[0] = force;
        (void)w->function(w->arg, w->res, w->iw, w->w, 0);
        for (size_t j = 0; j < LOOP_TOOL; ++j) {
            p->f_tool[j * lanes + lane] = force[j] + (push ? p->given[j * lanes + lane] : 0.0);
        }
    }
}

/* Rate of the state x under the torques that act. */
static void loop_rate(
    const loop_robots *r, const loop_parts *p, int push, const double *x, double *dx)
{
    size_t arm = (size_t)r->n_a * (size_t)r->lanes, motors = (size_t)r->n_m * (size_t)r->lanes;
    if (r->wall) {
        loop_touch(r, p, push, x);
        push = 1;
    }
    if (r->hysteresis) {
        loop_hysteretic(r, p, push, x, dx);
        return;
    }
    memcpy(dx, x + arm, arm * sizeof *dx);
    memcpy(dx + 2 * arm, x + 2 * arm + motors, motors * sizeof *dx);
    loop_accelerations(r, p, push, x, dx + arm, dx + 2 * arm + motors);
}

/*
 * The disturbances of a step (of the part that is given); returns whether a force acts on a tool.
 */
static int loop_disturb(const loop_robots *r, const loop_parts *p, size_t step)
{
    size_t lanes = (size_t)r->lanes, given = (size_t)r->disturbed, n_m = (size_t)r->n_m;
    const double *d = r->disturbances + step * (n_m + LOOP_TOOL) * given;
    for (size_t i = 0; i < (r->pushing[step] ? n_m + LOOP_TOOL : n_m); ++i) {
        double *to = i < n_m ? p->acting + i * lanes : p->given + (i - n_m) * lanes;
        for (size_t lane = 0; lane < lanes; ++lane) {
            double own = d[i * given + (given == 1 ? 0 : lane)];
            to[lane] = i < n_m ? r->torque[i * lanes + lane] + own : own;
        }
    }
    return r->pushing[step];
}

/* One step of the classical Runge-Kutta method. */
static void loop_step(const loop_robots *r, const loop_parts *p, int push, double h)
{
    size_t n = loop_rows(r) * (size_t)r->lanes;
    double *x = r->state, *k1 = p->stages, *k2 = k1 + n, *k3 = k2 + n, *k4 = k3 + n, *at = k4 + n;
    loop_rate(r, p, push, x, k1);
    for (size_t i = 0; i < n; ++i) {
        at[i] = x[i] + 0.5 * h * k1[i];
    }
    loop_rate(r, p, push, at, k2);
    for (size_t i = 0; i < n; ++i) {
        at[i] = x[i] + 0.5 * h * k2[i];
    }
    loop_rate(r, p, push, at, k3);
    for (size_t i = 0; i < n; ++i) {
        at[i] = x[i] + h * k3[i];
    }
    loop_rate(r, p, push, at, k4);
    for (size_t i = 0; i < n; ++i) {
        x[i] += h / 6.0 * ((k1[i] + k4[i]) + 2.0 * (k2[i] + k3[i]));
    }
}

/* The same, one robot after the other, with the force on its tool. */
static void loop_signals_of_each(
    const loop_robots *r, const loop_parts *p, int push, const double *a_a)
{
    const loop_function *f = r->signals;
    size_t lanes = (size_t)r->lanes, n_a = (size_t)r->n_a,
           n_s = (size_t)(r->n_y - r->n_m - r->states);
    for (size_t lane = 0; lane < lanes; ++lane) {
        double *motion = loop_gather(r->state, 2 * n_a, lanes, lane, f->point);
        double *force = loop_gather(a_a, n_a, lanes, lane, motion);
        double *out = force + LOOP_TOOL;
        if (push) {
            (void)loop_gather(p->f_tool, LOOP_TOOL, lanes, lane, force);
        }
        f->arg[0] = f->point;
        f->arg[1] = f->point + n_a;
        f->arg[2] = motion;
        f->arg[3] = push ? force : NULL; /* null: zero */
        f->arg[4] = f->numbers + (size_t)f->n_numbers * lane;
        f->res[0] = out;
        (void)f->function(f->arg, f->res, f->iw, f->w, 0);
        for (size_t i = 0; i < n_s; ++i) {
            p->signals[i * lanes + lane] = out[i];
        }
    }
}

/* Signals of the sensors of all robots under the torques that act just before the sample. */
static void loop_signals(const loop_robots *r, const loop_parts *p, int push)
{
    size_t arm = (size_t)r->n_a * (size_t)r->lanes;
    double *dx = p->stages;
    loop_rate(r, p, push, r->state, dx);
    if (r->signals) {
        loop_signals_of_each(r, p, push || r->wall, dx + arm);
        return;
    }
    (void)((loop_sensors)r->sensors)(
        r->lanes, r->state, r->state + arm, dx + arm, p->signals, r->plant_work);
}

/* What the channels of one robot show at sample k. */
static void loop_measure(const loop_robots *r, const loop_parts *p, int lane, int64_t k, double *y)
{
    size_t lanes = (size_t)r->lanes, own = (size_t)lane, n_y = (size_t)r->n_y,
           slots = (size_t)r->history + 1;
    size_t states = (size_t)r->states;
    const double *q_m = r->state + 2 * (size_t)r->n_a * lanes;
    for (size_t j = 0; j < n_y; ++j) {
        double value = j < (size_t)r->n_m ? q_m[j * lanes + own] :
                       j < n_y - states   ? p->signals[(j - (size_t)r->n_m) * lanes + own] :
                                            r->state[(j + states - n_y) * lanes + own];
        for (int32_t i = 0; i < r->encoder_terms; ++i) {
            const double *e = r->encoder_error + 4 * (size_t)i;
            if ((size_t)e[0] == j) {
                double angle = e[1] * q_m[j * lanes + own];
                value += e[2] * cos(angle) + e[3] * sin(angle);
            }
        }
        if (r->noise[j] > 0.0) {
            value += r->noise[j] * loop_noise(r->random + 4 * own);
        }
        value += r->bias[j];
        y[j] = r->resolution[j] > 0.0 ? floor(value / r->resolution[j] + 0.5) * r->resolution[j] :
                                        value;
        if (r->history > 0) {
            if (k == 0) {
                for (size_t slot = 0; slot < slots; ++slot) {
                    r->shown[(slot * n_y + j) * lanes + own] = y[j];
                }
            }
            r->shown[(((size_t)k % slots) * n_y + j) * lanes + own] = y[j];
            y[j] =
                r->shown[((((size_t)k + slots - (size_t)r->late[j]) % slots) * n_y + j) * lanes +
                         own];
        }
    }
}

/* LOOP_DONE, or why the state of a robot is wrong. */
static int32_t loop_state_status(const loop_robots *r, int lane)
{
    size_t rows = loop_rows(r);
    int32_t status = LOOP_DONE;
    for (size_t i = 0; i < rows; ++i) {
        double x = r->state[i * (size_t)r->lanes + (size_t)lane];
        if (!isfinite(x)) {
            return LOOP_NOT_FINITE;
        }
        if (i + (size_t)r->n_z >= rows && fabs(x) > LOOP_MOST_SHARE) {
            status = LOOP_STEP_TOO_LONG;
        }
    }
    return status;
}

/* Torques u (lanes, n_m) that the controllers ask for; zero of a robot that has stopped. */
static void loop_ask(loop_robots *r, int64_t k, const double *y, const double *ref, double *u)
{
    memset(u, 0, (size_t)r->lanes * (size_t)r->n_m * sizeof *u);
    if (r->together) {
        r->together(k, y, ref, u);
        return;
    }
    for (size_t lane = 0; lane < (size_t)r->lanes; ++lane) {
        void *self = r->memory + (size_t)r->memory_size * lane;
        if (r->status[lane] == LOOP_DONE &&
            r->controller(self, k, y + lane * (size_t)r->n_y, ref + lane * (size_t)r->n_ref,
                u + lane * (size_t)r->n_m) != 0) {
            r->status[lane] = LOOP_CONTROLLER_FAILED;
        }
    }
}

/*
 * Torque of one robot for a later interval: asked for, then limited (u), and what will act (next,
 * with noise).
 */
static void loop_limit(loop_robots *r, int lane, const double *ref, double *u, double *next)
{
    size_t lanes = (size_t)r->lanes, own = (size_t)lane,
           speeds = 2 * (size_t)r->n_a + (size_t)r->n_m;
    int limited = 0;
    for (int j = 0; j < r->n_m; ++j) {
        double most = r->torque_max[j] > 0.0 ? r->torque_max[j] : INFINITY, noise = 0.0,
               ahead = ref[r->n_y + j];
        for (const double *edge = r->torque_edges; edge < r->torque_edges + 3 * r->n_edges;
            edge += 3) {
            if ((int)edge[0] == j) {
                most = fmax(0.0,
                    fmin(most,
                        edge[1] - edge[2] * fabs(r->state[(speeds + (size_t)j) * lanes + own])));
            }
        }
        if (r->gain[lane] != 1.0) {
            u[j] = ahead + r->gain[lane] * (u[j] - ahead);
        }
        if (!isfinite(u[j]) || r->status[lane] != LOOP_DONE) {
            r->status[lane] = r->status[lane] == LOOP_DONE ? LOOP_CONTROLLER_FAILED :
                                                             r->status[lane];
            u[j] = 0.0;
        }
        if (fabs(u[j]) > most) {
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

/* Measure and control all robots at sample k; the torques go to next. */
static void loop_sample(loop_robots *r, const loop_parts *p, int push, int64_t k,
    const double *ref, double *y, double *u, double *next)
{
    size_t lanes = (size_t)r->lanes, n_m = (size_t)r->n_m;
    for (int lane = 0; lane < r->lanes; ++lane) {
        if (r->status[lane] == LOOP_DONE) {
            r->status[lane] = loop_state_status(r, lane);
        }
        if (r->status[lane] == LOOP_NOT_FINITE || r->status[lane] == LOOP_STEP_TOO_LONG) {
            /* at rest at zero, so that the batch stays finite */
            for (size_t i = 0; i < loop_rows(r); ++i) {
                r->state[i * lanes + (size_t)lane] = 0.0;
            }
        }
    }
    if (r->sensors || r->signals) {
        loop_signals(r, p, push);
    }
    for (int lane = 0; lane < r->lanes; ++lane) {
        size_t own = (size_t)lane;
        loop_measure(r, p, lane, k, y + own * (size_t)r->n_y);
    }
    loop_ask(r, k, y, ref, u);
    for (int lane = 0; lane < r->lanes; ++lane) {
        size_t own = (size_t)lane;
        loop_limit(r, lane, ref + own * (size_t)r->n_ref, u + own * n_m, next);
    }
}

/* The torques that begin to act: those of this sample, or of an earlier one. */
static void loop_act(const loop_robots *r, size_t slot)
{
    size_t lanes = (size_t)r->lanes, n_m = (size_t)r->n_m, slots = (size_t)r->slots;
    for (size_t lane = 0; lane < lanes; ++lane) {
        const double *from = r->pending +
                             (slot + slots - (size_t)r->delay[lane]) % slots * n_m * lanes;
        for (size_t j = 0; j < n_m; ++j) {
            r->torque[j * lanes + lane] = from[j * lanes + lane];
        }
    }
}

/*
 * Run samples first .. first + n - 1.
 *
 * ref: references of period samples, (period, lanes, n_ref), repeated; y, u: measured channels (n,
 * lanes, n_y) and commanded torques (n, lanes, n_m). Disturbances are those of these samples.
 * Returns the number of robots whose status is not LOOP_DONE; those keep their place in the
 * arrays.
 */
LOOP_API int flexgen_loop_run(loop_robots *r, int64_t first, int64_t n, const double *ref,
    int64_t period, double *y, double *u)
{
    size_t lanes = (size_t)r->lanes, n_m = (size_t)r->n_m, steps = (size_t)r->steps;
    size_t slots = (size_t)r->slots, torques = n_m * lanes;
    double h = r->sample_s / r->steps;
    const loop_parts p = parts_of(r);
    int failed = 0;
    for (int64_t k = 0; k < n; ++k) {
        const double *given = ref + (size_t)((first + k) % period) * lanes * (size_t)r->n_ref;
        size_t slot = (size_t)(first + k) % slots;
        r->now = first + k;
        if (r->stop) {
            break;
        }
        int push = r->disturbed && loop_disturb(r, &p, (size_t)k * steps);
        if (r->record) {
            size_t state = 2 * ((size_t)r->n_a + n_m) * lanes;
            memcpy(r->record + (size_t)k * (state + torques), r->state, state * sizeof(double));
            memcpy(r->record + (size_t)k * (state + torques) + state, r->torque,
                torques * sizeof(double));
        }
        loop_sample(r, &p, push, first + k, given, y + (size_t)k * lanes * (size_t)r->n_y,
            u + (size_t)k * torques, r->pending + slot * torques);
        for (size_t step = 0; step < steps; ++step) {
            if (step == (size_t)r->delay_steps) {
                loop_act(r, slot);
            }
            push = r->disturbed && loop_disturb(r, &p, (size_t)k * steps + step);
            loop_step(r, &p, push, h);
        }
    }
    for (int lane = 0; lane < r->lanes; ++lane) {
        failed += r->status[lane] != LOOP_DONE;
    }
    return failed;
}

/*
 * A drive with position and speed control (P-PI), feedforward torque and filters of the feedback:
 *
 *     e = q_ref - q,   w = v_ref + k_p e - v,   u = tau_ff + F(z) k_v (w + k_i int w dt)
 *
 * v: difference of two samples of q; v_ref: the same difference of q_ref, so that the filter does
 * not show. The references of motor j are ref[j] (angle) and ref[n_y + j] (torque). F: sections of
 * order two, y = b0 x + s1,  s1 = b1 x - a1 y + s2,  s2 = b2 x - a2 y. While u is above its limit
 * the integral does not grow.
 */
typedef struct {
    int64_t n_m, n_y, sections;
    double sample_s;
    /*
     * then k_p, k_v, k_i, u_max: n_m each; b0, b1, b2, a1, a2 of each section and motor:
     * (sections, n_m, 5); last q, last q_ref, integral: n_m each; s1, s2 of each section and
     * motor: (sections, n_m, 2)
     */
} loop_cascade;

LOOP_API int flexgen_loop_cascade(
    void *self, int64_t k, const double *y, const double *ref, double *u)
{
    loop_cascade *c = (loop_cascade *)self;
    size_t n = (size_t)c->n_m, sections = (size_t)c->sections;
    double *k_p = (double *)(c + 1), *k_v = k_p + n, *k_i = k_v + n, *most = k_i + n,
           *filter = most + n;
    double *q = filter + 5 * sections * n, *q_ref = q + n, *sum = q_ref + n, *state = sum + n;
    (void)k;
    for (size_t j = 0; j < n; ++j) {
        double v = (y[j] - q[j]) / c->sample_s, v_ref = (ref[j] - q_ref[j]) / c->sample_s;
        double w = v_ref + k_p[j] * (ref[j] - y[j]) - v, x;
        sum[j] += w * c->sample_s;
        x = k_v[j] * (w + k_i[j] * sum[j]);
        for (size_t i = 0; i < sections; ++i) {
            const double *f = filter + 5 * (i * n + j);
            double *s = state + 2 * (i * n + j), out = f[0] * x + s[0];
            s[0] = f[1] * x - f[3] * out + s[1];
            s[1] = f[2] * x - f[4] * out;
            x = out;
        }
        u[j] = ref[(size_t)c->n_y + j] + x;
        if (most[j] > 0.0 && fabs(u[j]) > most[j] && (u[j] > 0.0) == (w > 0.0)) {
            sum[j] -= w * c->sample_s;
        }
        q[j] = y[j];
        q_ref[j] = ref[j];
    }
    return 0;
}

/*
 * A linear controller about the reference, with matrices for each part of the motion:
 *
 *     e = y_ref - y,    u = tau_ff + C z + D e,    z <- A z + B e
 *
 * References: y_ref (n_y), then tau_ff (n_m); their first n_m entries are the motor angles. Part i
 * is used for the samples from i * samples on, the last one to the end. The matrices are stored by
 * columns, shared by all robots.
 */
typedef struct {
    int64_t n_m, n_y, n_z, parts, samples;
    const double *matrices; /* (parts): A, B, C, D */
    /* then z (n_z), its next value (n_z), e (n_y), and two sums (n_z + n_m) */
} loop_linear;

/*
 * out = A x, summed from the first column to the last; A by columns, so that all rows are summed
 * side by side.
 */
static void times(
    const double *A, const double *x, size_t rows, size_t columns, double *restrict out)
{
    for (size_t i = 0; i < rows; ++i) {
        out[i] = 0.0;
    }
    for (size_t j = 0; j < columns; ++j) {
        const double *a = A + j * rows, factor = x[j];
        for (size_t i = 0; i < rows; ++i) {
            out[i] += a[i] * factor;
        }
    }
}

LOOP_API int flexgen_loop_linear(
    void *self, int64_t k, const double *y, const double *ref, double *u)
{
    loop_linear *c = (loop_linear *)self;
    size_t n_m = (size_t)c->n_m, n_y = (size_t)c->n_y, n_z = (size_t)c->n_z;
    int64_t part = k / c->samples < c->parts ? k / c->samples : c->parts - 1;
    const double *A = c->matrices + (size_t)part * (n_z + n_m) * (n_z + n_y), *B = A + n_z * n_z;
    const double *C = B + n_z * n_y, *D = C + n_m * n_z;
    double *z = (double *)(c + 1), *next = z + n_z, *e = next + n_z, *first = e + n_y,
           *second = first + n_z + n_m;
    for (size_t i = 0; i < n_y; ++i) {
        e[i] = ref[i] - y[i];
    }
    times(C, z, n_m, n_z, first);
    times(D, e, n_m, n_y, second);
    for (size_t i = 0; i < n_m; ++i) {
        u[i] = ref[n_y + i] + (first[i] + second[i]);
    }
    times(A, z, n_z, n_z, first);
    times(B, e, n_z, n_y, second);
    for (size_t i = 0; i < n_z; ++i) {
        next[i] = first[i] + second[i];
    }
    memcpy(z, next, n_z * sizeof *z);
    return 0;
}
