/*
 * The controller of examples/motion_control under faults, in the loop with its plant, whose brakes
 * act 50 ms after the flag of the controller.
 *
 *   faults                  each fault at PHASES phases of the path, a row for each: name, phase,
 *                           status, cycles from
 *                           the first one that shows the fault to the status (-1000: no status), 1
 *                             if all torques were
 *                           finite, largest torque over its limit, largest speed of a motor over
 *                             the largest one of
 *                           this motor in the run without a fault, largest torque and speed at the
 *                             end, brakes
 *   faults NAME [PHASE]     only this one
 *   faults "no fault"       robots that are not as the model: name, status, and relative to their
 *     limits the largest
 *                           following errors of angle and speed, sudden torque, residual and speed
 *
 * A fault of an encoder, a drive or the arm shows where a measured angle differs from that of the
 * run without a fault by more than the following error, its speed by more than that of the speed,
 * or where the angle moves faster or with more acceleration than a motor can; all others show at
 * once.
 */
#include "motion_control/controller.h"
#include "motion_control/plant.h"

#include <stdio.h>
#include <stdlib.h>

#ifndef PUSH
#define PUSH 1000.0 /* N */
#endif

enum { PHASES = 20, LONGEST = 20000, AFTER = 200, HISTORY = 64 };

typedef struct {
    int64_t k, cycle, flag; /* of the controller; of the plant; of the brakes, or -1 */
    double acting[NM];      /* torque that acts */
    double history[HISTORY][NM];
} loop;

static controller c, saved_controller[PHASES];
static plant robot, saved_plant[PHASES];
static loop now, saved_loop[PHASES];
static double nominal[LONGEST][NM], fastest[NM], largest[NM];
static int64_t cycles, phase_at[PHASES];
static unsigned long long seed = 1;

static double uniform(void)
{
    seed = seed * 6364136223846793005ULL + 1442695040888963407ULL;
    return (double)(seed >> 11) / 9007199254740992.0;
}

/* What is different from the model in the runs without a fault. */
typedef struct {
    const char *name;
    double torque, coulomb, noise, mass, push; /* factor; N m over the limit; rad; kg; N */
} variation;

static const variation no_variation = {"none", 1.0, 0.0, 0.0, 0.0, 0.0};

/* A cycle of the plant: torques of the drives to motion. */
static void move(const variation *v, const double *tau)
{
    double u[NM];
    for (int j = 0; j < NM; ++j) {
        u[j] = v->torque * tau[j] - v->coulomb * torque_limit[j] * tanh(robot.x[2 * NA + NM + j]);
    }
    robot.engaged = now.flag >= 0 && CYCLE * (double)(now.cycle - now.flag) >= BRAKES_DELAY;
    (void)move_plant(&robot, u);
    now.cycle += 1;
}

static int start(const motor_limits *limits)
{
    const int status = start_controller(&c, limits);
    memset(&robot, 0, sizeof robot);
    memset(&now, 0, sizeof now);
    now.flag = -1;
    memcpy(robot.x, c.plan.q_start, sizeof c.plan.q_start);
    memcpy(robot.x + 2 * NA, c.plan.q_m[0], sizeof c.plan.q_m[0]);
    memcpy(now.acting, c.u, sizeof now.acting);
    return status;
}

/* The whole path without a fault; saves the loop at the phases. */
static int run_path(const variation *v, int saves)
{
    double duration, q_start[NA], last[3] = {0.0}, R[9], speed[3] = {0.0}, load[3] = {0.0},
                                  work[WORK];
    int64_t begin = (INTERVALS - 1) * PARTS;
    (void)CALL(path_start)(path_table, path_size, &duration, q_start);
    cycles = begin + (int64_t)(duration / CYCLE) + AFTER;
    for (int i = 0; saves && i < PHASES; ++i) {
        phase_at[i] = begin + (int64_t)(duration / CYCLE * ((double)i + 0.5) / PHASES) + i % PARTS;
    }
    for (int64_t k = 0; k < cycles && k < LONGEST; ++k) {
        double q_m[NM], u[NM], p[3];
        for (int i = 0; saves && i < PHASES; ++i) {
            if (k == phase_at[i]) {
                saved_controller[i] = c;
                saved_plant[i] = robot;
                saved_loop[i] = now;
            }
        }
        measure(&robot, q_m);
        (void)CALL(forward_kinematics_batch)(1, robot.x, p, R, work);
        /* a load at the tool: its weight and its inertia, of the last cycles */
        for (int i = 0; i < 3; ++i) {
            const double next = k > 0 ? (p[i] - last[i]) / CYCLE : 0.0;
            const double gravity = i == 1 ? 9.81 : 0.0,
                         acceleration = k > 1 ? (next - speed[i]) / CYCLE : 0.0;
            load[i] += 0.1 * (-v->mass * (acceleration + gravity) - load[i]);
            robot.f_tool[i] = load[i] + (i == 0 && k >= cycles / 2 ? v->push : 0.0);
            last[i] = p[i];
            speed[i] = next;
        }
        for (int j = 0; j < NM; ++j) {
            q_m[j] += v->noise * (2.0 * uniform() - 1.0);
            nominal[k][j] = saves ? q_m[j] : nominal[k][j];
        }
        memcpy(now.history[k % HISTORY], q_m, sizeof q_m);
        control(&c, k, q_m, u);
        if (c.fault < SIZE(OK)) {
            return c.fault;
        }
        move(v, now.acting);
        memcpy(now.acting, u, sizeof u);
        for (int j = 0; saves && j < NM; ++j) {
            fastest[j] = fmax(fastest[j], fabs(robot.x[2 * NA + NM + j]));
            largest[j] = fmax(largest[j], fabs(u[j]));
        }
        now.k = k + 1;
    }
    return c.status;
}

static int is(const char *name, const char *other)
{
    return strcmp(name, other) == 0;
}

/* What the encoders show in cycle k; `at`: cycle of the fault. */
static void spoil_reading(const char *f, int64_t k, int64_t at, double *q)
{
    static double kept[NM];
    const int64_t delay = is(f, "late 2") ? 2 : is(f, "late 5") ? 5 : is(f, "late 20") ? 20 : 0;
    const int once = k == at;
    if (once) {
        memcpy(kept, q, sizeof kept);
    }
    if (is(f, "nan") ? once : is(f, "nan ever")) {
        q[0] = NAN;
    } else if (is(f, "inf")) {
        q[NM - 1] = once ? -HUGE_VAL : q[NM - 1];
    } else if (is(f, "huge")) {
        q[0] = k % 2 ? 1e300 : -1e300;
    } else if (is(f, "stuck")) {
        q[0] = kept[0];
    } else if (is(f, "turn") ? once : is(f, "turn ever")) {
        q[0] += 2.0 * PI;
    } else if (is(f, "4 rad") ? once : is(f, "4 rad ever")) {
        q[0] += 4.0;
    } else if (is(f, "drift")) {
        q[0] += 4.0 * (double)(k - at + 1);
    } else if (is(f, "1 mrad")) {
        q[0] += once ? 1e-3 : 0.0;
    } else if (is(f, "0.01 rad")) {
        q[1] += 0.01;
    } else if (is(f, "sign flip")) {
        q[0] = -q[0];
    } else if (is(f, "sign from start")) {
        q[0] = 2.0 * nominal[0][0] - q[0];
    } else if (is(f, "double")) {
        q[0] = kept[0] + 2.0 * (q[0] - kept[0]);
    } else if (is(f, "bits")) {
        q[0] += ENCODER * (double)(1L << (int)(24.0 * uniform()));
    } else if (is(f, "swapped")) {
        const double first = q[0];
        q[0] = q[1];
        q[1] = first;
    } else if (delay > 0) {
        memcpy(q, now.history[(now.cycle - delay) % HISTORY], sizeof kept);
    }
    for (int j = 0; j < NM; ++j) {
        q[j] = is(f, "all nan") ? (double)NAN : is(f, "all stuck") ? kept[j] : q[j];
    }
}

/* What the drives make of the torques. */
static void spoil_torque(const char *f, double *u)
{
    if (is(f, "drive off")) {
        u[0] = 0.0;
    } else if (is(f, "polarity")) {
        u[0] = -u[0];
    } else if (is(f, "wires swapped")) {
        const double first = u[0];
        u[0] = u[1];
        u[1] = first;
    }
    for (int j = 0; j < NM; ++j) {
        u[j] = is(f, "drives off") ? 0.0 : u[j];
    }
}

/* Faults of time, of the planner and of the plant, in the cycle of the fault. */
static void spoil_cycle(const char *f, int phase)
{
    const int missed = is(f, "missed 1") ? 1 : is(f, "missed 5") ? 5 : is(f, "missed 50") ? 50 : 0;
    /* the plant continues, the controller does not */
    for (int i = 0; i < missed + is(f, "late cycle"); ++i) {
        move(&no_variation, now.acting);
        now.k += i < missed;
    }
    if (is(f, "push")) {
        robot.f_tool[0] = PUSH * cos(2.4 * phase);
        robot.f_tool[1] = PUSH * sin(2.4 * phase);
    } else if (is(f, "blocked")) {
        robot.locked[0] = 1;
    } else if (is(f, "planner refuses")) {
        c.plan.status = SIZE(BAD_ARGUMENT);
    } else if (is(f, "clock +0.5")) {
        c.plan.updates += 100;
    } else if (is(f, "clock -0.5")) {
        c.plan.updates -= 100;
    } else if (is(f, "planner feedforward")) {
        c.plan.tau_m[now.k % RING][0] = NAN;
    } else if (is(f, "planner not ready")) {
        c.plan.ready = now.k;
        for (int i = 0; i < RING; ++i) {
            c.plan.q_m[(now.k + i) % RING][0] += i < READY ? 1e3 : 0.0;
        }
    } else if (is(f, "planner reference")) {
        c.plan.q_m[now.k % RING][0] += 1.0;
    }
    now.k += is(f, "k +1000") ? 1000 : is(f, "k -1000") ? -1000 : 0;
}

/* Whether the angles of a cycle show the fault. */
static int shows(double last[3][NM], int64_t cycle)
{
    int shown = 0;
    cycle = cycle < cycles ? cycle : cycles - 1;
    if (cycle < 2) {
        return 0;
    }
    for (int j = 0; j < NM; ++j) {
        const double *a = nominal[cycle], *b = nominal[cycle - 1];
        const double away = last[0][j] - a[j], before = last[1][j] - b[j];
        shown = shown || !(fabs(away) <= c.away_max[j]) ||
                !(fabs(away - before) <= c.slip_max[j] * CYCLE) ||
                !(fabs(last[0][j] - 2.0 * last[1][j] + last[2][j]) <= c.bend_max[j]) ||
                !(fabs(last[0][j] - last[1][j]) <= c.speed_max[j] * CYCLE);
    }
    return shown;
}

/* Torque limits that a start refuses; the controller is called nevertheless. */
static void run_refused(const char *f)
{
    double torque[NM], q_m[NM], u[NM], share = 0.0;
    const motor_limits limits = {torque, NULL, NULL, NULL, NULL, NULL};
    int status, finite = 1;
    for (int j = 0; j < NM; ++j) {
        torque[j] = is(f, "limits nan")      ? (double)NAN :
                    is(f, "limits negative") ? -largest[j] :
                                               0.0;
    }
    status = start(&limits);
    memset(q_m, 0, sizeof q_m);
    for (int i = 0; i < AFTER; ++i) {
        control(&c, i, q_m, u);
        for (int j = 0; j < NM; ++j) {
            finite = finite && isfinite(u[j]);
            share = fmax(share, fabs(u[j]));
        }
    }
    printf("%s,0,%d,0,%d,%.4g,0,%.4g,0,%d\n", f, status, finite, share, share, c.brakes);
}

/* The loop at a phase; for limits of 0.6 of the nominal torques, at the start. */
static void restore(int phase, int limited)
{
    double torque[NM];
    const motor_limits limits = {torque, NULL, NULL, NULL, NULL, NULL};
    if (limited) {
        for (int j = 0; j < NM; ++j) {
            torque[j] = 0.6 * largest[j];
        }
        (void)start(&limits);
    } else {
        c = saved_controller[phase];
        robot = saved_plant[phase];
        now = saved_loop[phase];
    }
}

/* The number of a cycle that is wrong once. */
static int64_t wrong_number(const char *f, int64_t k)
{
    return is(f, "k max") ? INT64_MAX : is(f, "k min") ? INT64_MIN : is(f, "k -1") ? -1 : k;
}

/* One fault from a phase on. */
static void run_fault(const char *f, int phase)
{
    const int limited = is(f, "limits 0.6");
    const int at_once = is(f, "twice") || strncmp(f, "k ", 2) == 0 ||
                        strncmp(f, "missed", 6) == 0 || strncmp(f, "planner", 7) == 0 ||
                        strncmp(f, "clock", 5) == 0;
    double share = 0.0, speed = 0.0, end_u = 0.0, end_v = 0.0, last[3][NM];
    int64_t first = at_once ? 0 : -1, seen = -1, at;
    int finite = 1, status = 0;
    restore(phase, limited);
    at = now.cycle;
    memcpy(last[1], now.history[(at + HISTORY - 1) % HISTORY], sizeof last[1]);
    memcpy(last[2], now.history[(at + HISTORY - 2) % HISTORY], sizeof last[2]);
    for (int64_t i = 0; now.cycle < cycles + 2 * AFTER; ++i) {
        double q_m[NM], u[NM], tau[NM];
        if (i == 0) {
            spoil_cycle(f, phase);
        }
        measure(&robot, q_m);
        memcpy(now.history[now.cycle % HISTORY], q_m, sizeof q_m);
        spoil_reading(f, i + at, at, q_m);
        memcpy(last[0], q_m, sizeof q_m);
        first = first < 0 && !limited && shows(last, at + i) ? i : first;
        memcpy(last[2], last[1], sizeof q_m);
        memcpy(last[1], last[0], sizeof q_m);
        control(&c, i == 0 ? wrong_number(f, now.k) : now.k, q_m, u);
        if (i == 0 && is(f, "twice")) {
            control(&c, now.k, q_m, u);
        }
        if (c.fault < SIZE(OK) && seen < 0) {
            seen = i;
            status = c.fault;
            now.flag = now.cycle;
        }
        memcpy(tau, now.acting, sizeof tau);
        spoil_torque(f, tau);
        move(&no_variation, tau);
        memcpy(now.acting, u, sizeof u);
        now.k += 1;
        end_u = end_v = 0.0;
        for (int j = 0; j < NM; ++j) {
            const double v = fabs(robot.x[2 * NA + NM + j]);
            finite = finite && isfinite(u[j]);
            share = fmax(share, fabs(u[j]) / c.torque_max[j]);
            end_u = fmax(end_u, fabs(u[j]));
            speed = fmax(speed, v / fastest[j]);
            end_v = fmax(end_v, v);
        }
        if (now.flag >= 0 && now.cycle > now.flag + 2 * AFTER) {
            break;
        }
    }
    printf("%s,%d,%d,%ld,%d,%.4f,%.4f,%.4g,%.4g,%d\n", f, phase, status,
        seen < 0 ? -1000L : (long)(first < 0 ? 0 : seen - first), finite, share, speed, end_u,
        end_v, c.brakes);
}

int main(int argc, char **argv)
{
    static const char *const names[] = {"nan", "nan ever", "all nan", "stuck", "all stuck", "turn",
        "turn ever", "4 rad", "4 rad ever", "drift", "1 mrad", "0.01 rad", "sign flip",
        "sign from start", "double", "bits", "swapped", "missed 1", "missed 5", "missed 50",
        "late cycle", "twice", "k +1000", "k -1000", "k max", "k -1", "late 2", "late 5",
        "late 20", "drive off", "wires swapped", "blocked", "push", "limits 0.6", "limits 0",
        "limits nan", "limits negative", "planner refuses", "clock +0.5", "clock -0.5", "polarity",
        "drives off", "inf", "huge", "planner feedforward", "planner not ready",
        "planner reference", "k min"};
    static const variation variations[] = {{"as the model", 1.0, 0.0, 0.0, 0.0, 0.0},
        {"torque 0.95", 0.95, 0.0, 0.0, 0.0, 0.0}, {"torque 1.05", 1.05, 0.0, 0.0, 0.0, 0.0},
        {"friction", 1.0, 0.03, 0.0, 0.0, 0.0}, {"noise", 1.0, 0.0, 5e-5, 0.0, 0.0},
        {"3 kg", 1.0, 0.0, 0.0, 3.0, 0.0}, {"push 100 N", 1.0, 0.0, 0.0, 0.0, 100.0},
        {"all", 0.95, 0.03, 5e-5, 3.0, 100.0}};
    if (start(NULL) < SIZE(OK) || run_path(&no_variation, 1) < SIZE(OK)) {
        fprintf(stderr, "the run without a fault has the status %d at motor %d, cycle %ld\n",
            c.status, c.faulty_motor + 1, (long)now.k);
        return 1;
    }
    if (argc > 1 && is(argv[1], "no fault")) {
        for (size_t i = 0; i < sizeof variations / sizeof variations[0]; ++i) {
            double away = 0.0, slip = 0.0, jolted = 0.0, residual = 0.0, speed = 0.0;
            const int started = start(NULL),
                      status = started < SIZE(OK) ? started : run_path(&variations[i], 0);
            for (int j = 0; j < NM; ++j) {
                away = fmax(away, c.largest_away[j] / c.away_max[j]);
                slip = fmax(slip, c.largest_slip[j] / c.slip_max[j]);
                jolted = fmax(jolted, c.largest_jolt[j] / c.jolt_max[j]);
                residual = fmax(residual, c.largest_r[j] / c.threshold[j]);
                speed = fmax(speed, c.largest_speed[j] / c.speed_max[j]);
            }
            printf("%s,%d,%.4f,%.4f,%.4f,%.4f,%.4f\n", variations[i].name, status, away, slip,
                jolted, residual, speed);
        }
        return 0;
    }
    for (size_t i = 0; i < sizeof names / sizeof names[0]; ++i) {
        if (argc > 1 && !is(argv[1], names[i])) {
            continue;
        }
        for (int phase = 0; phase < PHASES; ++phase) {
            const int refused = strncmp(names[i], "limits", 6) == 0 && !is(names[i], "limits 0.6");
            if (argc > 2 && atoi(argv[2]) != phase) {
                continue;
            }
            if (refused) {
                run_refused(names[i]);
                break;
            }
            run_fault(names[i], phase);
            if (is(names[i], "limits 0.6")) {
                break;
            }
        }
    }
    return 0;
}
