/*
 * The robot of motion_control.c: manutec_r3_24, which runs the program `cycle` of program.toml in
 * this folder.
 */
#ifndef ROBOT_H
#define ROBOT_H

#include "manutec_r3_24_batch.h"
#include "manutec_r3_24_inversion.h"
#include "cycle.h"

#define MODEL "manutec_r3_24"
#define CALL(name) manutec_r3_24_##name
#define SIZE(name) MANUTEC_R3_24_##name

static const double *const path_table = manutec_r3_24_path_cycle;
static const int64_t path_size = MANUTEC_R3_24_PATH_CYCLE_SIZE;

static const int actuated[] = {0, 5, 9, 12, 15, 17}; /* arm coordinates with a motor */
enum {
    INTERVALS = 29 /* of the horizon, 5 ms each */
};
static const double TOLERANCE = 1e-5; /* of the stream: relative residual */

/* Feedback of all motors [Hz]: position control, speed control, integral part, low pass. */
static const double POSITION_HZ = 3.0, SPEED_HZ = 15.0, INTEGRAL_HZ = 1.0, FILTER_HZ = 150.0;
static const double ENCODER = 6.283185307179586 / 1048576; /* rad: resolution */

/*
 * Torque limits of the motors [N m], which the controller keeps unless it is given others:
 * torque_max of the model file, which states none here; about 1.5 times the largest torques of the
 * program.
 */
static const double torque_limit[] = {4.5, 6.5, 8.5, 1.1, 0.9, 0.4};

/* Speed limits of the motors [rad/s]: 1.1 times the largest speeds of the program. */
static const double speed_limit[] = {60.0, 197.0, 112.0, 95.0, 74.0, 60.0};

/*
 * Torques of the motors that the model does not explain [N m], beyond which the controller finds a
 * collision: 1.5 times the largest residuals of the program with 5 % less torque, friction, a load
 * of 3 kg and a push of 100 N.
 */
static const double residual_limit[] = {2.8, 1.2, 1.6, 0.63, 0.26, 0.17};

/*
 * Torque limits of the run that saturates, as a share of the largest torques of the nominal run;
 * motor 1 has the vertical axis.
 */
static const double saturation[] = {0.6, 2.0, 2.0, 2.0, 2.0, 2.0};

/* The contact: a force against the motion of the tool, from this time of the path on. */
#ifndef CONTACT_TIME
#define CONTACT_TIME 1.2 /* s */
#endif
static const double CONTACT_FORCE = 100.0; /* N */

/* Columns of the trajectory. */
static const char *const arm_columns[] = {"q1] rad", "t1x] rad", "t1z] rad", "b1y] m", "b1z] m",
    "q2] rad", "t2y] rad", "t2z] rad", "b2x] m", "q3] rad", "t3y] rad", "t3z] rad", "q4] rad",
    "t4x] rad", "t4z] rad", "q5] rad", "t5y] rad", "q6] rad"};
static const char *const motor_columns[] = {"m1] ", "m2] ", "m3] ", "m4] ", "m5] ", "m6] "};
static const char *const output_columns[] = {"y_ref[x] m", "y_ref[y] m", "y_ref[z] m",
    "R_ref[xx] -", "R_ref[xy] -", "R_ref[xz] -", "R_ref[yx] -", "R_ref[yy] -", "R_ref[yz] -",
    "R_ref[zx] -", "R_ref[zy] -", "R_ref[zz] -"};

#endif
