/*
 * The controller of motion_control.c, every millisecond: motor angles in, motor torques and a flag
 * for the brakes out.
 *
 *   RUNNING   references and feedforward torques of the planner, feedback by a P-PI cascade
 *   BRAKING   after a fault of the planner, of the cycles or of an encoder, and after a collision:
 *             stop within BRAKE
 *             cycles, along the path while its samples are ready
 *   HOLDING   hold the position at which the robot stopped, until the brakes act
 *   OFF       the torque is zero
 *
 * Torques are finite and within their limits in every cycle. The status tells in the cycle itself:
 * below OK it is a fault, AT_LIMIT is a warning. The first fault stays until the controller is
 * started again. It sets `brakes` in its cycle: engage the brakes of the robot, which have to act
 * within BRAKES_ACT. Torque off without brakes lets an arm fall.
 *
 * Faults after which neither encoders nor motors can be trusted (FOLLOWING_ERROR, OVERSPEED,
 * DRIVE_FAULT) switch the torque off at once, in every state: feedback on a wrong angle, or
 * through a motor of the wrong sign, accelerates the motor. An encoder with an impossible reading
 * is refused from then on; its motor has the feedforward torque alone.
 *
 * Collisions are found by the residual of the generalized momentum: A. De Luca, R. Mattone, IEEE
 * ICRA 2005.
 */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include "planner.h"

static const double DETECTOR_HZ = 15.0; /* bandwidth of the residual */
/* speed gain times sample time and delay, over the inertia, at most */
static const double SAMPLED_GAIN = 0.3;
static const double PI = 3.141592653589793;

/*
 * Following errors of the angle and of the speed, by default: those for which the feedback takes
 * this share of the torque limit, e = FOLLOWING tau_max/(k_p k_v) and FOLLOWING tau_max/k_v.
 * Errors of 5 % in the model, friction, a load of 3 kg that the model does not have and a push of
 * 100 N on the tool take up to two thirds of it.
 */
static const double FOLLOWING = 0.35;
/*
 * Torque on a rotor that appears within two cycles and that the model does not explain, by
 * default: a share of the torque limit, and the torque of READING_NOISE [rad], 4 J noise/T^2. Half
 * of it is the most with that noise and that push.
 */
static const double SUDDEN = 0.05, READING_NOISE = 5e-5;
/*
 * Acceleration that a motor can have, relative to its torque limit over its own inertia: its
 * spring can act with the torque, and a push can wind it up further. A reading or a reference
 * beyond it is wrong.
 */
static const double ACCELERATION = 4.0;

enum {
    BRAKE = 2 * (READY - PARTS - 1), /* cycles of braking */
    /* cycles from the flag until the brakes hold the robot; the torque ends after them */
    BRAKES_ACT = 80,
    FADE = 20,          /* cycles in which the torque then goes to zero */
    LIMITED_CYCLES = 50 /* cycles with a torque at its limit, one after the other, at most */
};

typedef enum { RUNNING, BRAKING, HOLDING, OFF } controller_state;

/* Status of a cycle, in addition to those of the library and NOT_IN_BUFFER. */
enum {
    BAD_READING = NOT_IN_BUFFER - 1,
    MISSED_CYCLES = NOT_IN_BUFFER - 2,
    BAD_TORQUE = NOT_IN_BUFFER - 3, /* feedforward that is not finite */
    /* a motor is too far from its reference, or its speed is */
    FOLLOWING_ERROR = NOT_IN_BUFFER - 4,
    OVERSPEED = NOT_IN_BUFFER - 5,
    LIMITED = NOT_IN_BUFFER - 7, /* AT_LIMIT for LIMITED_CYCLES */
    COLLISION = NOT_IN_BUFFER - 8,
    DRIVE_FAULT = NOT_IN_BUFFER - 9, /* a motor does not move as its torque says */
    AT_LIMIT = 1000
};

/* Limits of the motors, NM numbers each > 0; NULL: the default. */
typedef struct {
    const double *torque;          /* N m; default: torque_limit of robot.h */
    const double *speed;           /* rad/s; default: speed_limit of robot.h */
    const double *following;       /* rad; default: by FOLLOWING */
    const double *following_speed; /* rad/s; default: by FOLLOWING */
    const double *sudden;          /* N m; default: by SUDDEN and READING_NOISE */
    const double *residual;        /* N m; default: residual_limit of robot.h */
} motor_limits;

typedef struct {
    planner plan;
    controller_state state;
    /* of the cycle; the first fault since the start, or OK */
    int status, fault;
    int brakes;                            /* 1: engage the brakes */
    int faulty_motor;                      /* of the first fault, or -1 */
    int64_t next;                          /* cycle that is expected */
    int has_antiwindup, reacts, monitors;  /* 0: planted mistakes */
    double to_joint[NG][NM];               /* q_g = to_joint q_m, tau_m = to_joint' tau_g */
    double k_p, k_i, k_v[NM], low_pass[5]; /* gains, and a section of order two */
    double torque_max[NM], threshold[NM];  /* N m; infinite: none */
    double speed_max[NM], away_max[NM];    /* rad/s, rad: speed and following error */
    /* rad/s, rad: error of the speed; second difference of an angle */
    double slip_max[NM], bend_max[NM];
    double jolt_max[NM]; /* N m: sudden torque on a rotor */
    int refused[NM];     /* encoders that are not trusted any more */
    /* of the cascade: last angles, speeds, reference, integral */
    double q[NM], v[NM], q_ref[NM], sum[NM];
    double s[NM][2];  /* low pass */
    double moved[NM]; /* last step of the reference */
    /* of the last cycles: errors of the speed; torques of the feedback */
    double slip[4][NM], feedback[6][NM];
    double largest_sum[NM]; /* rad: of the integral */
    int64_t saturated;      /* cycles with a torque at its limit */
    int limited;            /* of them, one after the other until now */
    /* torque that acts, commanded in the cycle before */
    double u[NM];
    /* of the detector: mass matrix, momentum, integral, residual */
    double M[NG][NG], p_0[NM], driven[NM], r[NM];
    double largest_r[NM];                       /* of the residual */
    double largest_away[NM], largest_slip[NM];  /* of the following errors */
    double largest_jolt[NM], largest_speed[NM]; /* of sudden torques, and of the speeds */
    /* samples of the detector; cycles of collision and stand, or -1 */
    int64_t begun, found, holding;
    /* s while braking [samples]; step there; where the robot holds */
    double time, start[NM], stop[NM];
    int on_path; /* whether it brakes along the path */
    /* samples that braking along the path needed and did not have */
    int64_t lost;
    /* cycles since the start of braking, and since the first fault */
    int64_t braking, since;
} controller;

/* Gear torques of the arm without deflections: M, and h + M a with the mass matrix. */
static void rigid_arm(controller *c, const double *q_m, const double *v_m, const double *a_m,
    double M[NG][NG], double tau[NG])
{
    double q_a[NA] = {0.0}, v_a[NA] = {0.0}, a_a[NA] = {0.0}, full[NA * NA], tau_a[NA];
    const double *motors[3] = {q_m, v_m, a_m};
    double *const joints[3] = {q_a, v_a, a_a};
    for (int k = 0; k < 3; ++k) {
        for (int i = 0; motors[k] != NULL && i < NG; ++i) {
            for (int j = 0; j < NM; ++j) {
                joints[k][actuated[i]] += c->to_joint[i][j] * motors[k][j];
            }
        }
    }
    (void)CALL(inverse_dynamics_batch)(1, q_a, v_a, a_a, tau_a, c->plan.work);
    if (M != NULL) {
        (void)CALL(mass_matrix_batch)(1, q_a, full, c->plan.work);
    }
    for (int i = 0; i < NG; ++i) {
        tau[i] = tau_a[actuated[i]];
        for (int j = 0; M != NULL && j < NG; ++j) {
            M[i][j] = full[actuated[i] + NA * actuated[j]];
        }
    }
}

/* to_joint' x: torques of the joints on the motor side. */
static void on_motors(const controller *c, const double x[NG], double out[NM])
{
    for (int j = 0; j < NM; ++j) {
        out[j] = 0.0;
        for (int i = 0; i < NG; ++i) {
            out[j] += c->to_joint[i][j] * x[i];
        }
    }
}

/* to_joint: the inverse of the gear ratios, by Gauss-Jordan elimination; 0 where there is none. */
static int invert_gears(controller *c)
{
    double A[NM][2 * NM] = {{0.0}};
    for (int i = 0; i < NM; ++i) {
        for (int j = 0; j < NG; ++j) {
            A[i][j] = CALL(gear_ratio)[i][j];
        }
        A[i][NM + i] = 1.0;
    }
    for (int k = 0; k < NM; ++k) {
        int pivot = k;
        for (int i = k + 1; i < NM; ++i) {
            pivot = fabs(A[i][k]) > fabs(A[pivot][k]) ? i : pivot;
        }
        if (!(fabs(A[pivot][k]) > 0.0)) {
            return 0;
        }
        for (int j = 0; j < 2 * NM; ++j) {
            const double swapped = A[k][j];
            A[k][j] = A[pivot][j];
            A[pivot][j] = swapped;
        }
        for (int i = 0; i < NM; ++i) {
            const double factor = i == k ? 0.0 : A[i][k] / A[k][k];
            for (int j = 0; j < 2 * NM; ++j) {
                A[i][j] -= factor * A[k][j];
            }
        }
    }
    for (int i = 0; i < NG; ++i) {
        for (int j = 0; j < NM; ++j) {
            c->to_joint[i][j] = A[i][NM + j] / A[i][i];
        }
    }
    return 1;
}

/*
 * Residual of the momentum, r = w (p - p_0 - int (tau - f + b + r) dt) with p = to_joint' M v_g +
 * J_m v_m and b = to_joint' (M' v - h). `u` acts from now on. Returns whether it is above a
 * threshold.
 */
static int detect(controller *c, const double *q_m, const double *v_m, const double *u)
{
    double M[NG][NG], h[NG], v_g[NG], momentum[NG], driving[NG], p[NM], b[NM], friction[NM];
    int above = 0;
    rigid_arm(c, q_m, v_m, NULL, M, h);
    (void)CALL(motor_friction_batch)(1, v_m, friction, c->plan.work);
    for (int i = 0; i < NG; ++i) {
        v_g[i] = 0.0;
        for (int j = 0; j < NM; ++j) {
            v_g[i] += c->to_joint[i][j] * v_m[j];
        }
    }
    for (int i = 0; i < NG; ++i) {
        momentum[i] = 0.0;
        driving[i] = -h[i];
        for (int k = 0; k < NG; ++k) {
            momentum[i] += M[i][k] * v_g[k];
            driving[i] += c->begun > 0 ? (M[i][k] - c->M[i][k]) / CYCLE * v_g[k] : 0.0;
        }
    }
    memcpy(c->M, M, sizeof M);
    on_motors(c, momentum, p);
    on_motors(c, driving, b);
    for (int j = 0; j < NM; ++j) {
        p[j] += CALL(rotor_inertia)[j] * v_m[j];
        if (c->begun == 0) {
            c->p_0[j] = p[j];
        }
        c->r[j] = 2.0 * PI * DETECTOR_HZ * (p[j] - c->p_0[j] - c->driven[j]);
        c->driven[j] += CYCLE * (u[j] - friction[j] + b[j] + c->r[j]);
        c->largest_r[j] = fmax(c->largest_r[j], fabs(c->r[j]));
        above = above || fabs(c->r[j]) > c->threshold[j];
    }
    c->begun += 1;
    return above;
}

/*
 * The P-PI cascade: v is the difference of two samples of q, for the reference and for the
 * measurement alike, so that it does not show in the error. While the torque is at its limit the
 * integral does not grow. A motor whose encoder is refused has its feedforward torque alone.
 *
 *   w = v_ref + k_p (q_ref - q) - v,   u = tau + F k_v (w + k_i int w dt)
 */
static int cascade(controller *c, const double *q_m, const double *v_m, const double *q_ref,
    const double *tau, double *u)
{
    const double *f = c->low_pass;
    int limited = 0;
    for (int j = 0; j < NM; ++j) {
        const double v_ref = (q_ref[j] - c->q_ref[j]) / CYCLE;
        const double w = c->refused[j] ? 0.0 : v_ref + c->k_p * (q_ref[j] - q_m[j]) - v_m[j];
        double x, out;
        c->sum[j] += w * CYCLE;
        x = c->refused[j] ? 0.0 : c->k_v[j] * (w + c->k_i * c->sum[j]);
        out = f[0] * x + c->s[j][0];
        c->s[j][0] = f[1] * x - f[3] * out + c->s[j][1];
        c->s[j][1] = f[2] * x - f[4] * out;
        u[j] = tau[j] + (c->refused[j] ? 0.0 : out);
        for (int i = 5; i > 0; --i) {
            c->feedback[i][j] = c->feedback[i - 1][j];
        }
        if (fabs(u[j]) > c->torque_max[j]) {
            limited = 1;
            if (c->has_antiwindup && (u[j] > 0.0) == (w > 0.0)) {
                c->sum[j] -= w * CYCLE;
            }
            u[j] = u[j] > 0.0 ? c->torque_max[j] : -c->torque_max[j];
        }
        c->feedback[0][j] = u[j] - tau[j];
        c->largest_sum[j] = fmax(c->largest_sum[j], fabs(c->sum[j]));
    }
    c->saturated += limited;
    return limited;
}

/* A fault in words; null: the status is one of the library. */
static const char *fault_text(int status)
{
    return status == NOT_IN_BUFFER   ? "the controller needs a sample that is not in the buffer" :
           status == BAD_READING     ? "an encoder shows what cannot be" :
           status == MISSED_CYCLES   ? "cycles of the controller were missed" :
           status == BAD_TORQUE      ? "the planner gave numbers that are not finite" :
           status == FOLLOWING_ERROR ? "a motor is too far from its reference" :
           status == OVERSPEED       ? "a motor is too fast" :
           status == BAD_REFERENCE   ? "the reference of a motor jumps, or is too fast" :
           status == LIMITED         ? "a torque was at its limit for too long" :
           status == COLLISION       ? "the robot collided" :
           status == DRIVE_FAULT     ? "a motor does not move as its torque says" :
                                       NULL;
}

/* The first fault stays. */
static void set_fault(controller *c, int fault, int motor)
{
    if (c->fault >= SIZE(OK)) {
        c->fault = fault;
        c->faulty_motor = motor;
    }
    c->brakes = 1;
}

/* Reference and feedforward torque where the robot holds. */
static void hold(controller *c, double *q_ref, double *tau)
{
    double tau_g[NG];
    memcpy(q_ref, c->stop, sizeof c->stop);
    rigid_arm(c, q_ref, NULL, NULL, NULL, tau_g);
    on_motors(c, tau_g, tau);
}

/*
 * Begin to brake, along the path or, where that or the time is not known, from the motion of the
 * motors at present.
 */
static void begin_braking(controller *c, int on_path)
{
    c->state = BRAKING;
    c->on_path = on_path;
    c->braking = 0;
    c->time = (double)c->next;
    memcpy(c->start, c->moved, sizeof c->start);
}

/*
 * Reference and feedforward torque of a stop: the time of the path slows down to a stand within
 * BRAKE cycles, s' = (1 + cos(pi x))/2; torque of the arm without deflections, and of the rotors
 * with their friction. The sum of s' is (BRAKE + 1)/2 cycles, so that the last sample is k +
 * BRAKE/2 + 1 = k + READY - PARTS after a collision in cycle k. Without the path each motor slows
 * down from its speed in the same way.
 */
static void brake(controller *c, int64_t k, double *q_ref, double *tau)
{
    const double x = (double)c->braking / BRAKE;
    const double rate = 0.5 * (1.0 + cos(PI * x)), slower = -0.5 * PI / BRAKE * sin(PI * x);
    double dq[NM], ddq[NM] = {0.0}, v[NM], a[NM], tau_g[NG], friction[NM];
    if (c->on_path) {
        const int status = motors_between(&c->plan, c->time, q_ref, dq, ddq);
        if (status < SIZE(OK)) {
            set_fault(c, status, -1);
            c->lost += 1;
            begin_braking(c, 0);
        }
    }
    if (!c->on_path) {
        memcpy(dq, c->start, sizeof dq);
        for (int j = 0; j < NM; ++j) {
            q_ref[j] = c->q_ref[j] + dq[j] * rate;
        }
    }
    for (int j = 0; j < NM; ++j) {
        v[j] = dq[j] * rate / CYCLE;
        a[j] = (ddq[j] * rate * rate + dq[j] * slower) / (CYCLE * CYCLE);
    }
    rigid_arm(c, q_ref, v, a, NULL, tau_g);
    on_motors(c, tau_g, tau);
    (void)CALL(motor_friction_batch)(1, v, friction, c->plan.work);
    for (int j = 0; j < NM; ++j) {
        tau[j] += CALL(rotor_inertia)[j] * a[j] + friction[j];
    }
    c->braking += 1;
    c->time += rate;
    if (c->braking > BRAKE) {
        memcpy(c->stop, q_ref, sizeof c->stop);
        c->state = HOLDING;
        c->holding = k;
    }
}

/*
 * Whether cycle k follows the last one, and the angles and speeds of the motors. A reading that
 * cannot be, of a motor with the acceleration ACCELERATION, is refused from now on: the motor is
 * taken to move as its reference.
 */
static void check_cycle(controller *c, int64_t k, const double *measured, double *q_m, double *v_m)
{
    const int follows = k == c->next && k >= 0 && k < INT64_MAX - RING;
    /* cycles since the last one; unknown after a jump of k: not more than those of braking */
    const double cycles = follows                            ? 1.0 :
                          k > c->next && k - c->next < BRAKE ? (double)(k - c->next) + 1.0 :
                                                               BRAKE;
    if (!follows) {
        set_fault(c, MISSED_CYCLES, -1);
        c->begun = 0; /* the detector begins again */
        memset(c->driven, 0, sizeof c->driven);
    }
    for (int j = 0; j < NM; ++j) {
        const double expected = c->q[j] + (follows ? c->v[j] * CYCLE : 0.0);
        const double margin = follows ? c->bend_max[j] :
                                        c->speed_max[j] * CYCLE * cycles + c->bend_max[j];
        if (!c->refused[j] && !(fabs(measured[j] - expected) <= margin)) { /* NaN too */
            set_fault(c, BAD_READING, j);
            c->refused[j] = 1;
        }
        q_m[j] = c->refused[j] ? c->q[j] + c->moved[j] : measured[j];
        v_m[j] = c->refused[j] ? c->moved[j] / CYCLE :
                 follows       ? (q_m[j] - c->q[j]) / CYCLE :
                                 c->v[j];
    }
    if (!follows && c->state <= BRAKING) { /* stop from where the motors are */
        memcpy(c->q_ref, q_m, sizeof c->q_ref);
        for (int j = 0; j < NM; ++j) {
            c->moved[j] = v_m[j] * CYCLE;
        }
        begin_braking(c, 0);
    }
}

/*
 * Whether each step of new samples of the planner is one that a motor can follow; otherwise they
 * are not used.
 */
static void check_samples(controller *c, int64_t before)
{
    for (int64_t k = before; k < c->plan.ready; ++k) {
        for (int j = 0; j < NM; ++j) {
            const double q = c->plan.q_m[k % RING][j], last = c->plan.q_m[(k - 1) % RING][j];
            const double earlier = c->plan.q_m[(k - 2) % RING][j];
            const int finite = isfinite(q) && isfinite(c->plan.tau_m[k % RING][j]);
            if (!finite || !(fabs(q - last) <= c->speed_max[j] * CYCLE) ||
                !(fabs(q - 2.0 * last + earlier) <= c->bend_max[j])) {
                set_fault(c, finite ? BAD_REFERENCE : BAD_TORQUE, j);
                c->plan.ready = k;
                return;
            }
        }
    }
}

/* Reference and feedforward torque of cycle k. */
static void reference(controller *c, int64_t k, double *q_ref, double *tau)
{
    if (c->state == RUNNING) {
        memcpy(q_ref, c->plan.q_m[k % RING], sizeof c->q_ref);
        memcpy(tau, c->plan.tau_m[k % RING], sizeof c->u);
        for (int j = 0; j < NM; ++j) {
            const double step = q_ref[j] - c->q_ref[j];
            const int finite = isfinite(q_ref[j]) && isfinite(tau[j]);
            if (!finite || !(fabs(step) <= c->speed_max[j] * CYCLE) ||
                (k > 0 && !(fabs(step - c->moved[j]) <= c->bend_max[j]))) {
                set_fault(c, finite ? BAD_REFERENCE : BAD_TORQUE, j);
                begin_braking(c, 0);
                break;
            }
        }
    }
    if (c->state == BRAKING) {
        brake(c, k, q_ref, tau);
    } else if (c->state == HOLDING) {
        hold(c, q_ref, tau);
    }
}

/*
 * Torque on a rotor that neither plan nor feedback explains, J dv/dt - u, of the last two cycles
 * minus that of the two before. Loads come through the spring of the gear and take longer; a drive
 * that is off, or has the wrong sign, shows at once. `slip`: error of the speed; a torque of the
 * feedback acts a cycle after its command.
 */
static double jolt(const controller *c, int j, double slip)
{
    const double rate = (slip - 2.0 * c->slip[1][j] + c->slip[3][j]) / (2.0 * CYCLE);
    double caused = 0.0;
    for (int i = 1; i < 4; ++i) {
        caused += (i == 2 ? 0.5 : 0.25) * (c->feedback[i][j] - c->feedback[i + 2][j]);
    }
    return CALL(rotor_inertia)[j] * rate - caused;
}

/*
 * Speeds and following errors of the motors whose encoders are trusted; afterwards the torque is
 * off.
 */
static void monitor(controller *c, const double *q_m, const double *v_m, const double *q_ref)
{
    for (int j = 0; j < NM; ++j) {
        const double away = fabs(q_ref[j] - q_m[j]),
                     slip = v_m[j] - (q_ref[j] - c->q_ref[j]) / CYCLE;
        const double sudden = c->state == RUNNING && c->next > 6 ? fabs(jolt(c, j, slip)) : 0.0;
        const int fault = fabs(v_m[j]) > c->speed_max[j]                       ? OVERSPEED :
                          away > c->away_max[j] || fabs(slip) > c->slip_max[j] ? FOLLOWING_ERROR :
                          sudden > c->jolt_max[j]                              ? DRIVE_FAULT :
                                                                                 SIZE(OK);
        for (int i = 3; i > 0; --i) {
            c->slip[i][j] = c->slip[i - 1][j];
        }
        c->slip[0][j] = slip;
        if (c->refused[j]) {
            continue;
        }
        c->largest_away[j] = fmax(c->largest_away[j], away);
        c->largest_slip[j] = fmax(c->largest_slip[j], fabs(slip));
        c->largest_jolt[j] = fmax(c->largest_jolt[j], sudden);
        c->largest_speed[j] = fmax(c->largest_speed[j], fabs(v_m[j]));
        if (fault < SIZE(OK)) {
            set_fault(c, fault, j);
            c->state = OFF;
        }
    }
}

/* Faults of the planner and of the buffer in cycle k, and the new samples. */
static void advance(controller *c, int64_t k)
{
    const int64_t before = c->plan.ready;
    advance_planner(&c->plan, k);
    if (c->plan.status < SIZE(OK)) {
        set_fault(c, c->plan.status, -1);
    }
    check_samples(c, before);
    if (k >= c->plan.ready || k < c->plan.ready - RING) {
        set_fault(c, NOT_IN_BUFFER, -1);
        begin_braking(c, 0);
    }
}

/* Numbers > 0 of all motors, of a default where none are given; 0 where one is not. */
static int set_limit(double *limit, const double *given, const double *standard, double factor)
{
    for (int j = 0; j < NM; ++j) {
        limit[j] = given != NULL ? given[j] : factor * standard[j];
        if (!(limit[j] > 0.0)) { /* NaN too */
            return 0;
        }
    }
    return 1;
}

/* Limits of the motors; 0 where one is not a number > 0. Those by the gains are still torques. */
static int set_limits(controller *c, const motor_limits *given)
{
    return set_limit(c->torque_max, given->torque, torque_limit, 1.0) &&
           set_limit(c->speed_max, given->speed, speed_limit, 1.0) &&
           set_limit(c->away_max, given->following, torque_limit, FOLLOWING) &&
           set_limit(c->slip_max, given->following_speed, torque_limit, FOLLOWING) &&
           set_limit(c->jolt_max, given->sudden, torque_limit, SUDDEN) &&
           set_limit(c->threshold, given->residual, residual_limit, 1.0);
}

/* Gains of the cascade at the pose q, and the limits that follow from them. */
static void set_gains(controller *c, const motor_limits *given)
{
    double M[NG][NG], g[NG];
    const double sample = 1.0 / tan(PI * FILTER_HZ * CYCLE),
                 below = sample * sample + 1.4 * sample + 1.0;
    rigid_arm(c, c->q, NULL, NULL, M, g);
    c->k_p = 2.0 * PI * POSITION_HZ;
    c->k_i = 2.0 * PI * INTEGRAL_HZ;
    for (int j = 0; j < NM; ++j) {
        /* the inertia that a motor moves slowly; fast, only its own behind the gear's spring */
        double inertia = CALL(rotor_inertia)[j];
        const double fast = inertia;
        for (int i = 0; i < NG; ++i) {
            for (int k = 0; k < NG; ++k) {
                inertia += c->to_joint[i][j] * M[i][k] * c->to_joint[k][j];
            }
        }
        c->k_v[j] = fmin(
            2.0 * PI * SPEED_HZ * inertia, SAMPLED_GAIN * fast / (CYCLE * (1.0 + LATE)));
        c->away_max[j] /= given->following != NULL ? 1.0 : c->k_p * c->k_v[j];
        c->slip_max[j] /= given->following_speed != NULL ? 1.0 : c->k_v[j];
        c->jolt_max[j] += given->sudden != NULL ? 0.0 :
                                                  4.0 * fast * READING_NOISE / (CYCLE * CYCLE);
        c->bend_max[j] = ACCELERATION * torque_limit[j] / fast * CYCLE * CYCLE;
    }
    /* w^2 / (s^2 + 1.4 w s + w^2), by the bilinear transform: b0, b1, b2, a1, a2 */
    c->low_pass[0] = c->low_pass[2] = 1.0 / below;
    c->low_pass[1] = 2.0 / below;
    c->low_pass[3] = 2.0 * (1.0 - sample * sample) / below;
    c->low_pass[4] = (sample * sample - 1.4 * sample + 1.0) / below;
}

/*
 * Start at rest at the start of the path; limits: NULL for the defaults. It ends all faults. Below
 * OK the torques are zero and the brakes are flagged, until it is called again.
 */
static int start_controller(controller *c, const motor_limits *limits)
{
    const motor_limits none = {NULL, NULL, NULL, NULL, NULL, NULL},
                       *given = limits != NULL ? limits : &none;
    int status = SIZE(BAD_ARGUMENT);
    memset(c, 0, sizeof *c);
    c->faulty_motor = -1;
    c->found = c->holding = -1;
    if (set_limits(c, given)) {
        status = start_planner(&c->plan);
    }
    if (status >= SIZE(OK) && !invert_gears(c)) {
        status = SIZE(BAD_ARGUMENT);
    }
    if (status >= SIZE(OK)) {
        memcpy(c->q, c->plan.q_m[0], sizeof c->q);
        memcpy(c->q_ref, c->plan.q_m[0], sizeof c->q_ref);
        memcpy(c->u, c->plan.tau_m[0], sizeof c->u);
        set_gains(c, given);
        check_samples(c, 2);
        status = c->fault;
    }
    if (status < SIZE(OK)) {
        set_fault(c, status, -1);
        c->state = OFF;
        c->status = status;
        return status;
    }
    c->has_antiwindup = c->reacts = c->monitors = 1;
    return SIZE(OK);
}

/*
 * Cycle k: measured motor angles in, motor torques for the next cycle out; see also `status` and
 * `brakes`.
 */
static void control(controller *c, int64_t k, const double *measured, double *u)
{
    double q_m[NM], v_m[NM], q_ref[NM], tau[NM] = {0.0};
    int hit, limited = 0;
    check_cycle(c, k, measured, q_m, v_m);
    hit = detect(c, q_m, v_m, c->u);
    if (hit && c->found < 0) {
        c->found = k;
    }
    if (c->state == RUNNING && c->fault >= SIZE(OK)) {
        advance(c, k);
    }
    if (hit && c->reacts) {
        set_fault(c, COLLISION, -1);
    }
    if (c->state == RUNNING && c->fault < SIZE(OK)) {
        begin_braking(c, 1);
    }
    memcpy(q_ref, c->q_ref, sizeof q_ref);
    reference(c, k, q_ref, tau);
    if (c->monitors && c->state != OFF) {
        monitor(c, q_m, v_m, q_ref);
    }
    memset(u, 0, NM * sizeof *u);
    if (c->state != OFF) {
        limited = cascade(c, q_m, v_m, q_ref, tau, u);
        c->limited = limited ? c->limited + 1 : 0;
        if (c->monitors && c->limited >= LIMITED_CYCLES) {
            set_fault(c, LIMITED, -1);
        }
    }
    c->since += c->fault < SIZE(OK);
    if (c->since > BRAKES_ACT) { /* the brakes hold the robot */
        const double share = fmax(0.0, 1.0 - (double)(c->since - BRAKES_ACT) / FADE);
        for (int j = 0; j < NM; ++j) {
            u[j] *= share;
        }
        c->state = share > 0.0 ? c->state : OFF;
    }
    for (int j = 0; j < NM; ++j) {
        c->moved[j] = q_ref[j] - c->q_ref[j];
    }
    memcpy(c->q, q_m, sizeof c->q);
    memcpy(c->v, v_m, sizeof c->v);
    memcpy(c->q_ref, q_ref, sizeof c->q_ref);
    c->next = k >= 0 && k < INT64_MAX - RING ? k + 1 : 0;
    c->status = c->fault < SIZE(OK) ? c->fault : limited ? AT_LIMIT : SIZE(OK);
    memcpy(c->u, u, sizeof c->u);
}

#endif
