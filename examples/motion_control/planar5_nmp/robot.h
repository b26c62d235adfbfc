/*
 * The robot of motion_control.c: planar5_nmp, which runs the program `seam` of
 * examples/program.toml.
 */
#ifndef ROBOT_H
#define ROBOT_H

#include "planar5_nmp_batch.h"
#include "planar5_nmp_inversion.h"
#include "seam.h"

#define MODEL "planar5_nmp"
#define CALL(name) planar5_nmp_##name
#define SIZE(name) PLANAR5_NMP_##name

static const double *const path_table = planar5_nmp_path_seam;
static const int64_t path_size = PLANAR5_NMP_PATH_SEAM_SIZE;

static const int actuated[] = {0, 1}; /* arm coordinates with a motor */
enum {
    INTERVALS = 20 /* of the horizon, 5 ms each */
};
static const double TOLERANCE = 1e-6; /* of the stream: relative residual */

/* Feedback of all motors [Hz]: position control, speed control, integral part, low pass. */
static const double POSITION_HZ = 6.0, SPEED_HZ = 24.0, INTEGRAL_HZ = 1.5, FILTER_HZ = 150.0;
static const double ENCODER = 6.283185307179586 / 1048576; /* rad: resolution */

/*
 * Torque limits of the motors [N m], which the controller keeps unless it is given others:
 * torque_max of the model file, which states none here; about 1.5 times the largest torques of the
 * program.
 */
static const double torque_limit[] = {30.0, 6.0};

/* Speed limits of the motors [rad/s]: 1.1 times the largest speeds of the program. */
static const double speed_limit[] = {170.0, 133.0};

/*
 * Torques of the motors that the model does not explain [N m], beyond which the controller finds a
 * collision: 1.5 times the largest residuals of the program with 5 % less torque, friction, a load
 * of 3 kg and a push of 100 N.
 */
static const double residual_limit[] = {5.5, 1.1};

/*
 * Torque limits of the run that saturates, as a share of the largest torques of the nominal run.
 */
static const double saturation[] = {0.85, 0.85};

/* The contact: a force against the motion of the tool, from this time of the path on. */
#ifndef CONTACT_TIME
#define CONTACT_TIME 1.0 /* s */
#endif
static const double CONTACT_FORCE = 100.0; /* N */

/* Columns of the trajectory. */
static const char *const arm_columns[] = {"q1] rad", "q2] rad", "q3] rad"};
static const char *const motor_columns[] = {"m1] ", "m2] "};
static const char *const output_columns[] = {"y_ref[x] m", "y_ref[y] m"};

#endif
