/*
 * The controller of motion_control.c, every millisecond: motor angles in, motor torques out.
 *
 *   RUNNING   references and feedforward torques of the planner, feedback by a P-PI cascade
 *   BRAKING   a collision was found, or the planner has failed: brake along the path, on the samples that are ready
 *   HOLDING   hold the position at which the robot stopped
 *
 * Torques are finite and within their limits in every cycle. The status tells in the cycle itself: a reading of an
 * encoder that cannot be (not finite, or too far from the last one; the reference then takes its place), cycles that
 * were missed, a sample that is not in the buffer, a torque at its limit. All but the last one brake the robot, and
 * stay until the controller is started again. The brake begins at the last reference, not at the time that has passed.
 *
 * Collisions are found by the residual of the generalized momentum: A. De Luca, R. Mattone, IEEE ICRA 2005.
 */
#ifndef CONTROLLER_H
#define CONTROLLER_H

#include "planner.h"

static const double DETECTOR_HZ = 15.0; /* bandwidth of the residual */
static const double SAMPLED_GAIN = 0.3; /* speed gain times sample time and delay, over the inertia, at most */
static const double PI = 3.141592653589793;
static const double JUMP = 5.0; /* rad: of a motor angle within a cycle, at most; 5000 rad/s */

enum {
    BRAKE = 2 * (READY - PARTS - 1) /* cycles of braking */
};

typedef enum { RUNNING, BRAKING, HOLDING } controller_state;

/* Status of a cycle, in addition to those of the library and NOT_IN_BUFFER: below OK the robot stops, AT_LIMIT is a
 * warning. */
enum {
    BAD_READING = NOT_IN_BUFFER - 1,
    MISSED_CYCLES = NOT_IN_BUFFER - 2,
    BAD_TORQUE = NOT_IN_BUFFER - 3, /* feedforward that is not finite */
    AT_LIMIT = 1000
};

typedef struct {
    planner plan;
    controller_state state;
    int status, fault;                            /* of the cycle; the first fault since the start, or OK */
    int64_t next;                                 /* cycle that is expected */
    int has_antiwindup, reacts;                   /* 0: planted mistakes */
    double to_joint[NG][NM];                      /* q_g = to_joint q_m, tau_m = to_joint' tau_g */
    double k_p, k_i, k_v[NM], low_pass[5];        /* gains, and a section of order two */
    double torque_max[NM], threshold[NM];         /* N m; infinite: none */
    double q[NM], q_ref[NM], sum[NM], s[NM][2];   /* of the cascade: last angles, integral, low pass */
    double moved[NM];                             /* last step of the reference */
    double largest_sum[NM];                       /* rad: of the integral */
    int64_t saturated;                            /* cycles with a torque at its limit */
    double u[NM];                                 /* torque that acts, commanded in the cycle before */
    double M[NG][NG], p_0[NM], driven[NM], r[NM]; /* of the detector: mass matrix, momentum, integral, residual */
    double largest_r[NM];                         /* of the residual */
    int64_t begun, found, holding;                /* samples of the detector; cycles of collision and stand, or -1 */
    double time, stop[NM];                        /* s while braking [samples]; where the robot holds */
    int64_t braking;                              /* cycles since the start of braking */
} controller;

/* Gear torques of the arm without deflections: M, and h + M a with the mass matrix. */
static void rigid_arm(
    controller *c, const double *q_m, const double *v_m, const double *a_m, double M[NG][NG], double tau[NG])
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

/* Start at rest at the start of the path; torque_max: NULL for those of robot.h; threshold: NULL for none. */
static int start_controller(controller *c, const double *torque_max, const double *threshold)
{
    double M[NG][NG], g[NG], sample = 1.0 / tan(PI * FILTER_HZ * CYCLE), below;
    CALL(status) status;
    memset(c, 0, sizeof *c);
    status = start_planner(&c->plan);
    if (status < SIZE(OK)) {
        return status;
    }
    if (!invert_gears(c)) {
        return SIZE(BAD_ARGUMENT);
    }
    c->has_antiwindup = c->reacts = 1;
    c->found = c->holding = -1;
    memcpy(c->q, c->plan.q_m[0], sizeof c->q);
    memcpy(c->q_ref, c->plan.q_m[0], sizeof c->q_ref);
    memcpy(c->u, c->plan.tau_m[0], sizeof c->u);
    rigid_arm(c, c->q, NULL, NULL, M, g);
    c->k_p = 2.0 * PI * POSITION_HZ;
    c->k_i = 2.0 * PI * INTEGRAL_HZ;
    for (int j = 0; j < NM;
        ++j) { /* the inertia that a motor moves slowly; fast, only its own behind the gear's spring */
        double inertia = CALL(rotor_inertia)[j];
        const double fast = inertia;
        for (int i = 0; i < NG; ++i) {
            for (int k = 0; k < NG; ++k) {
                inertia += c->to_joint[i][j] * M[i][k] * c->to_joint[k][j];
            }
        }
        c->k_v[j] = fmin(2.0 * PI * SPEED_HZ * inertia, SAMPLED_GAIN * fast / (CYCLE * (1.0 + LATE)));
        c->torque_max[j] = torque_max != NULL ? torque_max[j] : torque_limit[j];
        c->threshold[j] = threshold != NULL ? threshold[j] : HUGE_VAL;
    }
    /* w^2 / (s^2 + 1.4 w s + w^2), by the bilinear transform: b0, b1, b2, a1, a2 */
    below = sample * sample + 1.4 * sample + 1.0;
    c->low_pass[0] = c->low_pass[2] = 1.0 / below;
    c->low_pass[1] = 2.0 / below;
    c->low_pass[3] = 2.0 * (1.0 - sample * sample) / below;
    c->low_pass[4] = (sample * sample - 1.4 * sample + 1.0) / below;
    return SIZE(OK);
}

/*
 * Residual of the momentum, r = w (p - p_0 - int (tau - f + b + r) dt) with p = to_joint' M v_g + J_m v_m and
 * b = to_joint' (M' v - h). `u` acts from now on. Returns whether it is above a threshold.
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
 * The P-PI cascade: v is the difference of two samples of q, for the reference and for the measurement alike, so that
 * it does not show in the error. While the torque is at its limit the integral does not grow. cycles: since the last
 * measurement, 1 as a rule.
 *
 *   w = v_ref + k_p (q_ref - q) - v,   u = tau + F k_v (w + k_i int w dt)
 */
static void cascade(controller *c, const double *q_m, const double *q_ref, const double *tau, double cycles, double *u)
{
    const double *f = c->low_pass;
    int limited = 0;
    for (int j = 0; j < NM; ++j) {
        const double v = (q_m[j] - c->q[j]) / (CYCLE * cycles), v_ref = (q_ref[j] - c->q_ref[j]) / CYCLE;
        const double w = v_ref + c->k_p * (q_ref[j] - q_m[j]) - v;
        double x, out;
        c->sum[j] += w * CYCLE;
        x = c->k_v[j] * (w + c->k_i * c->sum[j]);
        out = f[0] * x + c->s[j][0];
        c->s[j][0] = f[1] * x - f[3] * out + c->s[j][1];
        c->s[j][1] = f[2] * x - f[4] * out;
        u[j] = tau[j] + out;
        if (fabs(u[j]) > c->torque_max[j]) {
            limited = 1;
            if (c->has_antiwindup && (u[j] > 0.0) == (w > 0.0)) {
                c->sum[j] -= w * CYCLE;
            }
            u[j] = u[j] > 0.0 ? c->torque_max[j] : -c->torque_max[j];
        }
        c->largest_sum[j] = fmax(c->largest_sum[j], fabs(c->sum[j]));
        c->q[j] = q_m[j];
        c->q_ref[j] = q_ref[j];
    }
    c->saturated += limited;
    c->status = limited ? AT_LIMIT : SIZE(OK);
}

/* A fault in words; null: the status is one of the library. */
static const char *fault_text(int status)
{
    return status == NOT_IN_BUFFER ? "the controller needs a sample that is not in the buffer" :
           status == BAD_READING   ? "an encoder shows what cannot be" :
           status == MISSED_CYCLES ? "cycles of the controller were missed" :
           status == BAD_TORQUE    ? "the planner gave numbers that are not finite" :
                                     NULL;
}

/* The first fault stays. */
static void set_fault(controller *c, int fault)
{
    c->fault = c->fault < SIZE(OK) ? c->fault : fault;
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
 * Reference and feedforward torque of a stop along the path: the time of the path slows down to a stand within BRAKE
 * cycles, s' = (1 + cos(pi x))/2; torque of the arm without deflections, and of the rotors with their friction. The sum
 * of s' is (BRAKE + 1)/2 cycles, so that the last sample is k + BRAKE/2 + 1 = k + READY - PARTS after a collision in
 * cycle k. Without samples the robot holds the last reference.
 */
static void brake(controller *c, int64_t k, double *q_ref, double *tau)
{
    const double x = (double)c->braking / BRAKE;
    const double rate = 0.5 * (1.0 + cos(PI * x)), slower = -0.5 * PI / BRAKE * sin(PI * x);
    double dq[NM], ddq[NM], v[NM], a[NM], tau_g[NG], friction[NM];
    const int status = motors_between(&c->plan, c->time, q_ref, dq, ddq);
    if (status < SIZE(OK)) {
        set_fault(c, status);
        memcpy(c->stop, c->q_ref, sizeof c->stop);
        hold(c, q_ref, tau);
        c->state = HOLDING;
        return;
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
 * What is wrong with cycle k, and the number of cycles since the last one. A reading that cannot be is replaced: the
 * motor is taken to be where it was, moved as its reference.
 */
static double check_cycle(controller *c, int64_t k, const double *measured, double *q_m)
{
    const int64_t missed = k - c->next;
    const double cycles = missed > 0 ? 1.0 + (double)missed : 1.0;
    if (missed != 0) {
        set_fault(c, MISSED_CYCLES);
        c->begun = 0; /* the detector begins again */
        memset(c->driven, 0, sizeof c->driven);
    }
    for (int j = 0; j < NM; ++j) {
        q_m[j] = measured[j];
        if (!(fabs(measured[j] - c->q[j]) <= JUMP * fmin(cycles, 100.0))) { /* NaN too */
            set_fault(c, BAD_READING);
            q_m[j] = c->q[j] + c->moved[j];
        }
    }
    return cycles;
}

/* Reference and feedforward torque of cycle k, in the buffer while the robot runs. */
static void reference(controller *c, int64_t k, double *q_ref, double *tau)
{
    if (c->state == RUNNING) {
        memcpy(q_ref, c->plan.q_m[k % RING], sizeof c->q_ref);
        memcpy(tau, c->plan.tau_m[k % RING], sizeof c->u);
    } else if (c->state == BRAKING) {
        brake(c, k, q_ref, tau);
    } else {
        hold(c, q_ref, tau);
    }
    for (int j = 0; j < NM; ++j) {
        if (!isfinite(q_ref[j]) || !isfinite(tau[j])) {
            set_fault(c, BAD_TORQUE);
            memcpy(c->stop, c->q_ref, sizeof c->stop);
            c->state = HOLDING;
            hold(c, q_ref, tau);
            return;
        }
    }
}

/* Cycle k: measured motor angles in, motor torques for the next cycle out; see also the status. */
static void control(controller *c, int64_t k, const double *measured, double *u)
{
    double q_m[NM], v_m[NM], q_ref[NM], tau[NM];
    const double cycles = check_cycle(c, k, measured, q_m);
    int hit;
    for (int j = 0; j < NM; ++j) {
        v_m[j] = (q_m[j] - c->q[j]) / (CYCLE * cycles);
    }
    hit = detect(c, q_m, v_m, c->u);
    if (hit && c->found < 0) {
        c->found = k;
    }
    if (c->state == RUNNING) {
        if (c->fault >= SIZE(OK)) {
            advance_planner(&c->plan, k);
            if (k < 0 || k >= c->plan.ready || k < c->plan.ready - RING) {
                set_fault(c, NOT_IN_BUFFER);
            }
        }
        if ((hit && c->reacts) || c->plan.status < SIZE(OK) || c->fault < SIZE(OK)) {
            c->state = BRAKING;
            c->time = (double)c->next;
        }
    }
    reference(c, k, q_ref, tau);
    for (int j = 0; j < NM; ++j) {
        c->moved[j] = q_ref[j] - c->q_ref[j];
    }
    cascade(c, q_m, q_ref, tau, cycles, u);
    c->next = k + 1;
    c->status = c->fault < SIZE(OK) ? c->fault : c->status;
    memcpy(c->u, u, sizeof c->u);
}

#endif
