/*
 * The motion control system of a robot: a program of joint moves, lines and arcs, run at 1 kHz on
 * the robot's own equations of motion. It has all parts of a robot controller:
 *
 *   interpolator   the path of the program from its table (flexgen plan), sampled a horizon ahead
 *   stream         inverse dynamics of the elastic robot, one update every 5 ms, done in five
 *                  parts (planner.h)
 *   feedforward    torques for a drive that holds them for 1 ms and has them 1 ms late
 *   feedback       position and speed control of every motor, limited torques, no windup
 *                  (controller.h)
 *   supervision    readings, cycles, references, following errors, speeds, torques: torque off,
 *                  brakes (controller.h)
 *   collision      residual of the momentum, brake along the path, hold, brakes (controller.h)
 *   robot          forward dynamics of the library (plant.h), angles by encoders
 *
 * Five runs of the program:
 *
 *   nominal        the robot is as its model; its motion is written to motion.csv
 *   saturated      the motors have less torque than the path needs at times
 *   windup         the same, and the integral parts of the feedback continue: a planted mistake
 *   contact        a force of 100 N on the tool, against its motion; thresholds from the nominal
 *                  run
 *   ignored        the same without a reaction: a planted mistake
 *
 * The runs with a planted mistake, and the one that saturates for a long time, are without
 * supervision of following errors. The brakes act 50 ms after the flag of the controller.
 *
 * Then the nominal run again, until 100 000 cycles were timed. The robot of a build is that of the
 * header `robot.h`:
 *
 *   flexgen generate planar5_nmp
 *   flexgen plan planar5_nmp --moves examples/program.toml --move seam --out
 *     generated/planar5_nmp/seam.h
 *   cd generated/planar5_nmp
 *   cc -std=c99 -O2 -ffp-contract=off -I. -I../../examples/motion_control/planar5_nmp
 *     ../../examples/motion_control.c \
 *      $(find src -name '*.c') -lm -o motion_control && ./motion_control motion.csv
 *   flexgen simulate planar5_nmp motion.csv
 */
#define _POSIX_C_SOURCE 199309L

#include "motion_control/controller.h"
#include "motion_control/plant.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { TIMED = 100000, LONGEST = 60000 }; /* cycles: timed in all; of a run at most */

/* s after the path: end of a run, begin of the figures at rest */
static const double AFTER = 0.5, SETTLED = 0.25;

typedef enum { NOMINAL, SATURATED, WINDUP, CONTACT, IGNORED, TIMING } run_kind;

/* What a run is like. */
typedef struct {
    /* m: largest distance of the tool from the path, and of that at the end */
    double error, error_at_rest;
    double torque[NM], residual[NM]; /* largest ones */
    double share;                    /* of a cycle with a torque at its limit */
    /* largest integral part of the feedback, relative to the torque limit */
    double integral;
    /* m: largest distance of the tool from the position of the contact */
    double moved;
    /* largest torque from the contact on, relative to that of the nominal run */
    double effort;
    /* cycles: of the contact, of its detection, of the end of braking; or -1 */
    int64_t contact, found, holding;
    /* cycle from which on no motor is faster than 5 % of its largest speed */
    int64_t standing;
    int64_t cycles, warnings;
} figures;

static controller control_system;
static plant robot;
static double path_work[WORK], cycle_us[TIMED], processor_us[TIMED], least_us[LONGEST];

/*
 * Time of a clock: CLOCK_MONOTONIC, or the processor time of this thread, which stands where
 * others run.
 */
static double seconds(clockid_t clock)
{
    struct timespec t;
    (void)clock_gettime(clock, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Columns of the trajectory in a csv file of flexgen. */
static void write_head(FILE *file)
{
    fprintf(file, "# {\"model\": \"" MODEL
                  "\", \"variant\": \"\", \"kind\": \"motion control\", \"hold\": \"zoh\", ");
    fprintf(file, "\"sample_time\": %.17g, \"delay\": 0.0}\ntime s", CYCLE);
    for (int i = 0; i < NA; ++i) {
        fprintf(file, ",q_a[%s", arm_columns[i]);
    }
    for (int i = 0; i < NM; ++i) {
        fprintf(file, ",q_m[%srad", motor_columns[i]);
    }
    for (int i = 0; i < NM; ++i) {
        fprintf(file, ",tau_m[%sN m", motor_columns[i]);
    }
    for (int i = 0; i < NT; ++i) {
        fprintf(file, ",%s", output_columns[i]);
    }
    fprintf(file, "\n");
}

/* A row: the motion, the torque from now on, the path; a rotation matrix by rows. */
static void write_row(FILE *file, int64_t k, const double *x, const double *u, const double *y)
{
    fprintf(file, "%.17g", CYCLE * (double)k);
    for (int i = 0; i < NA; ++i) {
        fprintf(file, ",%.17g", x[i]);
    }
    for (int i = 0; i < NM; ++i) {
        fprintf(file, ",%.17g", x[2 * NA + i]);
    }
    for (int i = 0; i < NM; ++i) {
        fprintf(file, ",%.17g", u[i]);
    }
    for (int i = 0; i < NT; ++i) {
        fprintf(file, ",%.17g", NT == NY || i < 3 ? y[i] : y[3 + (i - 3) / 3 + 3 * ((i - 3) % 3)]);
    }
    fprintf(file, "\n");
}

static double distance(const double *a, const double *b, int n)
{
    double sum = 0.0;
    for (int i = 0; i < n; ++i) {
        sum += (a[i] - b[i]) * (a[i] - b[i]);
    }
    return sqrt(sum);
}

/* The force of a contact, against the motion of the tool from one position to the next. */
static void push(const double *before, const double *now, double f_tool[6])
{
    const double way = distance(before, now, 3);
    for (int i = 0; i < 3 && way > 0.0; ++i) {
        f_tool[i] = -CONTACT_FORCE * (now[i] - before[i]) / way;
    }
}

/* Start controller and robot at rest at the start of the path. */
static int start(run_kind kind, const figures *nominal)
{
    const int saturates = kind == SATURATED || kind == WINDUP,
              touches = kind == CONTACT || kind == IGNORED;
    double torque[NM], residual[NM];
    motor_limits limits = {NULL, NULL, NULL, NULL, NULL, NULL};
    const double *q_m = control_system.plan.q_m[0];
    int status;
    for (int j = 0; nominal != NULL && j < NM; ++j) {
        torque[j] = saturation[j] * nominal->torque[j];
        residual[j] = saturates ? HUGE_VAL : 2.0 * nominal->residual[j];
    }
    limits.torque = saturates ? torque : NULL;
    limits.residual = saturates || touches ? residual : NULL;
    status = start_controller(&control_system, &limits);
    control_system.has_antiwindup = kind != WINDUP;
    control_system.reacts = kind != IGNORED;
    control_system.monitors = !saturates && kind != IGNORED;
    memset(&robot, 0, sizeof robot);
    memcpy(robot.x, control_system.plan.q_start, sizeof control_system.plan.q_start);
    memcpy(robot.x + 2 * NA, q_m, sizeof control_system.plan.q_m[0]);
    return status;
}

/*
 * One run of the program. file: for its motion, or null; timed: number of cycles that were timed
 * so far, or null.
 */
static int run(run_kind kind, const figures *nominal, FILE *file, int *timed, figures *out)
{
    int64_t flag = -1; /* cycle in which the brakes were flagged */
    double duration, q_start[NA], fastest[NM] = {0.0}, before[3] = {0.0}, touched[3] = {0.0},
                                  u[NM], acting[NM];
    int status = CALL(path_start)(path_table, path_size, &duration, q_start);
    memset(out, 0, sizeof *out);
    out->contact = -1;
    if (status == SIZE(OK)) {
        status = start(kind, nominal);
    }
    memcpy(acting, control_system.u, sizeof acting);
    for (int64_t k = 0; status >= SIZE(OK) && path_time(k) < duration + AFTER; ++k) {
        double p[3], R[9], y[NT], dy[NY], ddy[NY], q_m[NM], away, begin, end, used;
        int stands = 1;
        (void)CALL(forward_kinematics_batch)(1, robot.x, p, R, path_work);
        status = CALL(path_sample)(
            path_table, path_size, path_time(k), y, dy, ddy, path_work, WORK);
        away = distance(p, y, NY < 3 ? NY : 3);
        out->error = fmax(out->error, away);
        if (path_time(k) > duration + SETTLED) {
            out->error_at_rest = fmax(out->error_at_rest, away);
        }
        if (nominal != NULL && (kind == CONTACT || kind == IGNORED) && out->contact < 0 &&
            path_time(k) >= CONTACT_TIME) {
            push(before, p, robot.f_tool);
            memcpy(touched, p, sizeof touched);
            out->contact = k;
        }
        if (out->contact >= 0) {
            out->moved = fmax(out->moved, distance(p, touched, 3));
        }
        memcpy(before, p, sizeof before);
        measure(&robot, q_m);
        used = seconds(CLOCK_THREAD_CPUTIME_ID);
        begin = seconds(CLOCK_MONOTONIC);
        control(&control_system, k, q_m, u);
        end = seconds(CLOCK_MONOTONIC);
        used = seconds(CLOCK_THREAD_CPUTIME_ID) - used;
        if (timed != NULL && *timed < TIMED && k < LONGEST) {
            processor_us[*timed] = 1e6 * used;
            cycle_us[(*timed)++] = 1e6 * (end - begin);
            least_us[k] = least_us[k] > 0.0 ? fmin(least_us[k], 1e6 * (end - begin)) :
                                              1e6 * (end - begin);
        }
        for (int j = 0; j < NM; ++j) {
            out->torque[j] = fmax(out->torque[j], fabs(u[j]));
            if (out->contact >= 0) {
                out->effort = fmax(out->effort, fabs(u[j]) / nominal->torque[j]);
            }
        }
        if (file != NULL) {
            write_row(file, k, robot.x, acting, y);
        }
        flag = control_system.brakes && flag < 0 ? k : flag;
        robot.engaged = flag >= 0 && CYCLE * (double)(k - flag) >= BRAKES_DELAY;
        if (status >= SIZE(OK)) {
            status = move_plant(&robot, acting);
        }
        memcpy(acting, u, sizeof acting);
        for (int j = 0; j < NM; ++j) {
            const double speed = fabs(robot.x[2 * NA + NM + j]);
            fastest[j] = out->contact < 0 ? fmax(fastest[j], speed) : fastest[j];
            stands = stands && speed <= 0.05 * fastest[j];
        }
        if (!stands) {
            out->standing = k + 1;
        }
        out->cycles = k + 1;
    }
    for (int j = 0; j < NM; ++j) {
        out->residual[j] = control_system.largest_r[j];
        out->integral = fmax(out->integral, control_system.k_v[j] * control_system.k_i *
                                                control_system.largest_sum[j] /
                                                control_system.torque_max[j]);
    }
    out->share = out->cycles > 0 ? (double)control_system.saturated / (double)out->cycles : 0.0;
    out->found = control_system.found;
    out->holding = control_system.holding;
    out->warnings = control_system.plan.warnings;
    return status < SIZE(OK)                                         ? status :
           control_system.lost > 0                                   ? NOT_IN_BUFFER :
           kind == CONTACT && control_system.fault == (int)COLLISION ? SIZE(OK) :
                                                                       control_system.fault;
}

static int by_size(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* Median, 99.99 % and the largest of some times. */
static void print_distribution(const char *name, double *us, int n)
{
    qsort(us, (size_t)n, sizeof us[0], by_size);
    printf("%s: median %.1f us, 99.99 %% below %.1f us, worst %.1f us\n", name, us[n / 2],
        us[n - 1 - n / 10000], us[n - 1]);
}

/*
 * Times of the cycles. The largest one of the least times of each cycle is free of interruptions
 * by the system.
 */
static void print_times(int timed)
{
    double worst = 0.0;
    for (int k = 0; k < LONGEST; ++k) {
        worst = fmax(worst, least_us[k]);
    }
    printf("%d cycles\n", timed);
    print_distribution("  elapsed time", cycle_us, timed);
    print_distribution("  processor time", processor_us, timed);
    printf("  worst of the least elapsed times of each cycle %.1f us\n", worst);
}

/* Milliseconds from the contact to a cycle, or a dash. */
static void print_after(const figures *f, int64_t cycle)
{
    if (cycle < 0) {
        printf(" %12s", "-");
    } else {
        printf(" %12.0f", 1e3 * CYCLE * (double)(cycle - f->contact));
    }
}

/* Print the figures of a run. */
static void print_figures(const char *name, run_kind kind, const figures *f)
{
    if (kind == NOMINAL) {
        printf("%-10s %12s %12s %12s %12s\n", "run", "error um", "at rest um", "limited %",
            "integral");
    } else if (kind == CONTACT) {
        printf("\n%-10s %12s %12s %12s %12s %12s\n", "run", "found ms", "braked ms", "stands ms",
            "moved mm", "torque %");
    }
    printf("%-10s", name);
    if (kind == CONTACT || kind == IGNORED) {
        print_after(f, f->found);
        print_after(f, f->holding);
        print_after(f, f->standing);
        printf(" %12.2f %12.1f\n", 1e3 * f->moved, 100.0 * f->effort);
    } else {
        printf(" %12.3f %12.3f %12.2f %12.4f\n", 1e6 * f->error, 1e6 * f->error_at_rest,
            100.0 * f->share, f->integral);
    }
}

/* The run `kind`, its motion to a file unless the name is null; 0 where it has no result. */
static int run_and_print(const char *name, run_kind kind, const char *path, figures *nominal)
{
    FILE *file = path != NULL ? fopen(path, "w") : NULL;
    figures f;
    int status;
    if (path != NULL && file == NULL) {
        fprintf(stderr, "%s cannot be written\n", path);
        return 0;
    }
    if (file != NULL) {
        write_head(file);
    }
    status = run(kind, kind == NOMINAL ? NULL : nominal, file, NULL, &f);
    if (file != NULL) {
        fprintf(file, "# rows: %ld\n", (long)f.cycles);
        if (fclose(file) != 0) {
            fprintf(stderr, "%s cannot be written\n", path);
            return 0;
        }
    }
    if (status < SIZE(OK)) {
        fprintf(stderr, "%s: %s\n", name,
            fault_text(status) != NULL ? fault_text(status) :
                                         CALL(status_text)((CALL(status))status));
        return 0;
    }
    if (kind == NOMINAL) {
        *nominal = f;
    }
    print_figures(name, kind, &f);
    return 1;
}

int main(int argc, char **argv)
{
    static const char *const names[] = {"nominal", "saturated", "windup", "contact", "ignored"};
    /* cycles to time: fewer for a quick look */
    const int asked = argc > 2 ? atoi(argv[2]) : TIMED;
    figures nominal, f;
    int timed = 0;
    for (int kind = NOMINAL; kind < TIMING; ++kind) {
        if (!run_and_print(names[kind], (run_kind)kind,
                kind == NOMINAL && argc > 1 ? argv[1] : NULL, &nominal)) {
            return 1;
        }
    }
    printf("\nupdates above the tolerance of the stream: %ld\n", (long)nominal.warnings);
    while (timed < asked && timed < TIMED) {
        if (run(NOMINAL, NULL, NULL, &timed, &f) < SIZE(OK)) {
            return 1;
        }
    }
    if (timed > 0) {
        print_times(timed);
    }
    return 0;
}
