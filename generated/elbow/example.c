/*
 * elbow: every function once, at rest in the home pose; then a path on which the output stays where it is, inverted as a whole and by a stream.
 * Written by flexgen; see elbow.h.
 *
 *   cc -std=c99 -O2 -ffp-contract=off example.c $(find src -name '*.c') -lm -o example && ./example
 */
#include "elbow_inversion.h"

#include <stdio.h>
#include <stdlib.h>

static void show(const char *name, const char *unit, const elbow_real *x, int rows, int columns)
{
    printf("  %s [%s]\n", name, unit);
    for (int i = 0; i < rows; ++i) {
        for (int j = 0; j < columns; ++j) {
            printf(" %13.6g", (double)x[i + j * rows]);
        }
        printf("\n");
    }
}

enum { SAMPLES = 21, UPDATES = 10 };

/* The output at the home pose: how far it is from zero. */
static elbow_status home_output(elbow_real y[ELBOW_NT])
{
    const elbow_real zero_velocity[ELBOW_NA] = {0}, zero[ELBOW_NT] = {0};
    elbow_real W[ELBOW_NY * ELBOW_NA], Wdot_v[ELBOW_NY];
    return elbow_output_constraint(elbow_home_q_a, zero_velocity, zero, y, W, Wdot_v);
}

/* The motor torques for a whole path: here the output stays where it is. */
static int invert_path(void)
{
    elbow_real y[SAMPLES * ELBOW_NT], zero[SAMPLES * ELBOW_NY] = {0}, tau_m[SAMPLES * ELBOW_NM];
    static elbow_samples path; /* static: members that are not set are zero */
    static elbow_motion motion; /* no other results are wanted */
    elbow_inversion_options options = elbow_inversion_defaults();
    elbow_invert_info info;
    elbow_status status = home_output(y);
    const int64_t size = elbow_invert_work(SAMPLES, &options);
    elbow_real *work = (elbow_real *)malloc((size_t)size * sizeof(elbow_real));
    if (work == NULL || status != ELBOW_OK) {
        free(work);
        return 1;
    }
    for (int i = ELBOW_NT; i < SAMPLES * ELBOW_NT; ++i) {
        y[i] = y[i - ELBOW_NT];
    }
    path.n = SAMPLES;
    path.period = 0.001;
    path.y = y;
    path.dy = zero;
    path.ddy = zero;
    motion.tau_m = tau_m;
    status = elbow_invert(&path, elbow_home_q_a, &options, &motion, &info, work, size);
    printf("invert: %s\n", elbow_status_text(status));
    if (status == ELBOW_OK) {
        show("tau_m", "N m", tau_m, ELBOW_NM, 1);
    }
    free(work);
    return status < 0;
}

/* The same torques from a stream: memory is allocated once, an update allocates nothing. */
static int run_stream(void)
{
    elbow_real y[ELBOW_NT], zero[ELBOW_NY] = {0}, tau_m[ELBOW_NM];
    static elbow_motion motion; /* no other results are wanted */
    elbow_stream_options options = elbow_stream_defaults();
    elbow_stream stream;
    elbow_stream_info info;
    elbow_status status = home_output(y);
    options.intervals = 10;
    options.samples_per_interval = 1;
    options.period = 0.005;
    stream.size = elbow_stream_work(&options);
    stream.memory = (elbow_real *)malloc((size_t)stream.size * sizeof(elbow_real));
    if (stream.memory == NULL || status != ELBOW_OK) {
        free(stream.memory);
        return 1;
    }
    motion.tau_m = tau_m;
    status = elbow_stream_start(&stream, &options, y, elbow_home_q_a);
    for (int k = 0; k < UPDATES && status >= 0; ++k) {
        status = elbow_stream_update(&stream, y, zero, zero, &motion, &info);
    }
    printf("stream: %s\n", elbow_status_text(status));
    if (status >= 0) {
        show("tau_m", "N m", tau_m, ELBOW_NM, 1);
    }
    free(stream.memory);
    return status < 0;
}

int main(void)
{
    elbow_status status;
    int failed = 0;
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        elbow_real p[3];
        elbow_real R[3 * 3];
        status = elbow_forward_kinematics(q_a, p, R);
        printf("forward_kinematics: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("p", "m", p, 3, 1);
            show("R", "1", R, 3, 3);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        elbow_real J[6 * ELBOW_NA];
        status = elbow_jacobian(q_a, J);
        printf("jacobian: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("J", "mixed", J, 6, ELBOW_NA);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        elbow_real M[ELBOW_NA * ELBOW_NA];
        status = elbow_mass_matrix(q_a, M);
        printf("mass_matrix: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("M", "kg m^2", M, ELBOW_NA, ELBOW_NA);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        elbow_real h[ELBOW_NA];
        status = elbow_bias(q_a, v_a, h);
        printf("bias: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("h", "N m", h, ELBOW_NA, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        elbow_real g[ELBOW_NA];
        status = elbow_gravity(q_a, g);
        printf("gravity: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("g", "N m", g, ELBOW_NA, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real a_a[ELBOW_NA] = {0.0, 0.0};
        elbow_real tau_a[ELBOW_NA];
        status = elbow_inverse_dynamics(q_a, v_a, a_a, tau_a);
        printf("inverse_dynamics: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("tau_a", "N m", tau_a, ELBOW_NA, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real a_a[ELBOW_NA] = {0.0, 0.0};
        elbow_real dtau_dq[ELBOW_NA * ELBOW_NA];
        elbow_real dtau_dv[ELBOW_NA * ELBOW_NA];
        elbow_real dtau_da[ELBOW_NA * ELBOW_NA];
        status = elbow_inverse_dynamics_derivatives(q_a, v_a, a_a, dtau_dq, dtau_dv, dtau_da);
        printf("inverse_dynamics_derivatives: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("dtau_dq", "mixed", dtau_dq, ELBOW_NA, ELBOW_NA);
            show("dtau_dv", "mixed", dtau_dv, ELBOW_NA, ELBOW_NA);
            show("dtau_da", "kg m^2", dtau_da, ELBOW_NA, ELBOW_NA);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real tau_a[ELBOW_NA] = {0.0, 0.0};
        elbow_real a_a[ELBOW_NA];
        status = elbow_arm_forward_dynamics(q_a, v_a, tau_a, a_a);
        printf("arm_forward_dynamics: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("a_a", "rad/s^2", a_a, ELBOW_NA, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real tau_a[ELBOW_NA] = {0.0, 0.0};
        elbow_real da_dq[ELBOW_NA * ELBOW_NA];
        elbow_real da_dv[ELBOW_NA * ELBOW_NA];
        elbow_real da_dtau[ELBOW_NA * ELBOW_NA];
        elbow_real work[ELBOW_WORK];
        status = elbow_arm_forward_derivatives(q_a, v_a, tau_a, da_dq, da_dv, da_dtau, work);
        printf("arm_forward_derivatives: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("da_dq", "mixed", da_dq, ELBOW_NA, ELBOW_NA);
            show("da_dv", "mixed", da_dv, ELBOW_NA, ELBOW_NA);
            show("da_dtau", "mixed", da_dtau, ELBOW_NA, ELBOW_NA);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real q_m[ELBOW_NM] = {140.0252725600022, (-88.0809495839805)};
        const elbow_real v_m[ELBOW_NM] = {0.0, 0.0};
        const elbow_real tau_m[ELBOW_NM] = {0.0, 0.0};
        elbow_real a_a[ELBOW_NA];
        elbow_real a_m[ELBOW_NM];
        status = elbow_forward_dynamics(q_a, v_a, q_m, v_m, tau_m, a_a, a_m);
        printf("forward_dynamics: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("a_a", "rad/s^2", a_a, ELBOW_NA, 1);
            show("a_m", "rad/s^2", a_m, ELBOW_NM, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real q_m[ELBOW_NM] = {140.0252725600022, (-88.0809495839805)};
        const elbow_real v_m[ELBOW_NM] = {0.0, 0.0};
        const elbow_real tau_m[ELBOW_NM] = {0.0, 0.0};
        const elbow_real f_tool[6] = {0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
        elbow_real a_a[ELBOW_NA];
        elbow_real a_m[ELBOW_NM];
        elbow_real tau_g[ELBOW_NG];
        status = elbow_forward_dynamics_tool_force(q_a, v_a, q_m, v_m, tau_m, f_tool, a_a, a_m, tau_g);
        printf("forward_dynamics_tool_force: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("a_a", "rad/s^2", a_a, ELBOW_NA, 1);
            show("a_m", "rad/s^2", a_m, ELBOW_NM, 1);
            show("tau_g", "N m", tau_g, ELBOW_NG, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real a_a[ELBOW_NA] = {0.0, 0.0};
        elbow_real v_tool[6];
        elbow_real a_tool[6];
        status = elbow_tool_motion(q_a, v_a, a_a, v_tool, a_tool);
        printf("tool_motion: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("v_tool", "mixed", v_tool, 6, 1);
            show("a_tool", "mixed", a_tool, 6, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real q_m[ELBOW_NM] = {140.0252725600022, (-88.0809495839805)};
        const elbow_real v_m[ELBOW_NM] = {0.0, 0.0};
        const elbow_real tau_m[ELBOW_NM] = {0.0, 0.0};
        elbow_real A[ELBOW_NX * ELBOW_NX];
        elbow_real B[ELBOW_NX * ELBOW_NM];
        elbow_real work[ELBOW_WORK];
        status = elbow_linearize(q_a, v_a, q_m, v_m, tau_m, A, B, work);
        printf("linearize: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("A", "mixed", A, ELBOW_NX, ELBOW_NX);
            show("B", "mixed", B, ELBOW_NX, ELBOW_NM);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real q_m[ELBOW_NM] = {140.0252725600022, (-88.0809495839805)};
        const elbow_real v_m[ELBOW_NM] = {0.0, 0.0};
        elbow_real a_a[ELBOW_NA];
        elbow_real j_a[ELBOW_NA];
        status = elbow_flexible_joint_motion(q_a, v_a, q_m, v_m, a_a, j_a);
        printf("flexible_joint_motion: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("a_a", "rad/s^2", a_a, ELBOW_NA, 1);
            show("j_a", "rad/s^3", j_a, ELBOW_NA, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real a_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real j_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real s_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real q_m[ELBOW_NM] = {140.0252725600022, (-88.0809495839805)};
        const elbow_real v_m[ELBOW_NM] = {0.0, 0.0};
        elbow_real tau_m[ELBOW_NM];
        status = elbow_flexible_joint_torque(q_a, v_a, a_a, j_a, s_a, q_m, v_m, tau_m);
        printf("flexible_joint_torque: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("tau_m", "N m", tau_m, ELBOW_NM, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real target[ELBOW_NT] = {0.0, 0.0};
        elbow_real y_err[ELBOW_NY];
        elbow_real W[ELBOW_NY * ELBOW_NA];
        elbow_real Wdot_v[ELBOW_NY];
        status = elbow_output_constraint(q_a, v_a, target, y_err, W, Wdot_v);
        printf("output_constraint: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("y_err", "m", y_err, ELBOW_NY, 1);
            show("W", "mixed", W, ELBOW_NY, ELBOW_NA);
            show("Wdot_v", "m/s^2", Wdot_v, ELBOW_NY, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        const elbow_real v_a[ELBOW_NA] = {0.0, 0.0};
        const elbow_real a_a[ELBOW_NA] = {0.0, 0.0};
        elbow_real tau_g[ELBOW_NG];
        status = elbow_inversion_rows(q_a, v_a, a_a, tau_g);
        printf("inversion_rows: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("tau_g", "N m", tau_g, ELBOW_NG, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real deflection[ELBOW_NG] = {0.0, 0.0};
        elbow_real tau_p[ELBOW_NG];
        elbow_real dtau_p[ELBOW_NG];
        status = elbow_gear_law(deflection, tau_p, dtau_p);
        printf("gear_law: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("tau_p", "N m", tau_p, ELBOW_NG, 1);
            show("dtau_p", "mixed", dtau_p, ELBOW_NG, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real v_m[ELBOW_NM] = {0.0, 0.0};
        elbow_real f_m[ELBOW_NM];
        status = elbow_motor_friction(v_m, f_m);
        printf("motor_friction: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("f_m", "N m", f_m, ELBOW_NM, 1);
        } else {
            failed = 1;
        }
    }
    failed |= invert_path();
    failed |= run_stream();
    return failed;
}
