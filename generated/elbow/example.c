/*
 * elbow: every function once, at rest in the home pose. Written by flexgen; see elbow.h.
 *
 *   cc -std=c99 -O2 -ffp-contract=off *.c -lm -o example && ./example
 */
#include "elbow.h"

#include <stdio.h>

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

int main(void)
{
    int status, failed = 0;
    {
        const elbow_real q_a[ELBOW_NA] = {0.5235987755982988, (-0.3490658503988659)};
        elbow_real p[3];
        elbow_real R[3 * 3];
        elbow_real work[ELBOW_FORWARD_KINEMATICS_WORK];
        status = elbow_forward_kinematics(q_a, p, R, work);
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
        elbow_real work[ELBOW_JACOBIAN_WORK];
        status = elbow_jacobian(q_a, J, work);
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
        elbow_real work[ELBOW_MASS_MATRIX_WORK];
        status = elbow_mass_matrix(q_a, M, work);
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
        elbow_real work[ELBOW_BIAS_WORK];
        status = elbow_bias(q_a, v_a, h, work);
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
        elbow_real work[ELBOW_GRAVITY_WORK];
        status = elbow_gravity(q_a, g, work);
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
        elbow_real work[ELBOW_INVERSE_DYNAMICS_WORK];
        status = elbow_inverse_dynamics(q_a, v_a, a_a, tau_a, work);
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
        elbow_real work[ELBOW_INVERSE_DYNAMICS_DERIVATIVES_WORK];
        status = elbow_inverse_dynamics_derivatives(q_a, v_a, a_a, dtau_dq, dtau_dv, dtau_da, work);
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
        elbow_real work[ELBOW_ARM_FORWARD_DYNAMICS_WORK];
        status = elbow_arm_forward_dynamics(q_a, v_a, tau_a, a_a, work);
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
        elbow_real work[ELBOW_ARM_FORWARD_DERIVATIVES_WORK];
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
        elbow_real work[ELBOW_FORWARD_DYNAMICS_WORK];
        status = elbow_forward_dynamics(q_a, v_a, q_m, v_m, tau_m, a_a, a_m, work);
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
        elbow_real A[ELBOW_NX * ELBOW_NX];
        elbow_real B[ELBOW_NX * ELBOW_NM];
        elbow_real work[ELBOW_LINEARIZE_WORK];
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
        const elbow_real target[ELBOW_NT] = {0.0, 0.0};
        elbow_real y_err[ELBOW_NY];
        elbow_real W[ELBOW_NY * ELBOW_NA];
        elbow_real Wdot_v[ELBOW_NY];
        elbow_real work[ELBOW_OUTPUT_CONSTRAINT_WORK];
        status = elbow_output_constraint(q_a, v_a, target, y_err, W, Wdot_v, work);
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
        elbow_real work[ELBOW_INVERSION_ROWS_WORK];
        status = elbow_inversion_rows(q_a, v_a, a_a, tau_g, work);
        printf("inversion_rows: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("tau_g", "N m", tau_g, ELBOW_NG, 1);
        } else {
            failed = 1;
        }
    }
    {
        const elbow_real twist[ELBOW_NG] = {0.0, 0.0};
        elbow_real tau_p[ELBOW_NG];
        elbow_real dtau_p[ELBOW_NG];
        elbow_real work[ELBOW_GEAR_LAW_WORK];
        status = elbow_gear_law(twist, tau_p, dtau_p, work);
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
        elbow_real work[ELBOW_MOTOR_FRICTION_WORK];
        status = elbow_motor_friction(v_m, f_m, work);
        printf("motor_friction: %s\n", elbow_status_text(status));
        if (status == ELBOW_OK) {
            show("f_m", "N m", f_m, ELBOW_NM, 1);
        } else {
            failed = 1;
        }
    }
    return failed;
}
