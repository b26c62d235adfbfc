/*
 * Inverts a line within limits, all arrays in heap blocks of the exact size; prints the status of
 * each call.
 */
#include "planar5_nmp_inversion.h"

#include "line.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { N = 901, BEFORE = 250, PRE = 40, POST = 60, TOTAL = PRE + N + POST };

static double *block(size_t numbers)
{
    double *x = malloc(numbers * sizeof *x);
    if (x == NULL) {
        abort();
    }
    return x;
}

int main(void)
{
    static const double torque[][2] = {
        {22.0, 22.0}, {30.0, 30.0}, {5.0, 30.0}, {20.0, INFINITY}, {-1.0, 1.0}, {NAN, 1.0}};
    static const int knots[] = {16, 0, 100, 112, 900, -1};
    double *y = block(2 * N), *dy = block(2 * N), *ddy = block(2 * N), *q_start = block(3),
           *bound = block(2);
    double *tau_m = block(2 * TOTAL), *deviation = block(2 * N),
           *small = block((size_t)planar5_nmp_path_work());
    double *q_a = block(PLANAR5_NMP_NA * TOTAL), *v_a = block(PLANAR5_NMP_NA * TOTAL);
    double *q_m = block(2 * TOTAL), *v_m = block(2 * TOTAL);
    static const double many[] = {1e9, 1e9};
    static const double curve[2][3][2] = {/* the last one repeated */
        {{0.0, 1e6}, {1e4, 1e6}, {2e4, 1e3}}, {{0.0, 1e6}, {1e4, 0.0}, {1e4, 0.0}}};
    double duration;
    const planar5_nmp_samples path = {N, 1e-3, y, dy, ddy};
    planar5_nmp_motion motion = {q_a, v_a, NULL, NULL, q_m, v_m, tau_m};
    if (planar5_nmp_path_start(
            planar5_nmp_path_line, PLANAR5_NMP_PATH_LINE_SIZE, &duration, q_start) != 0) {
        return 9;
    }
    for (int k = 0; k < N; ++k) {
        if (planar5_nmp_path_sample(planar5_nmp_path_line, PLANAR5_NMP_PATH_LINE_SIZE,
                1e-3 * (k - BEFORE), y + 2 * k, dy + 2 * k, ddy + 2 * k, small,
                planar5_nmp_path_work()) != 0) {
            return 9;
        }
    }
    for (size_t i = 0; i < sizeof torque / sizeof *torque; ++i) {
        for (size_t j = 0; j < sizeof knots / sizeof *knots; ++j) {
            planar5_nmp_inversion_options options = {
                PRE, POST, 5, 1e-6, PLANAR5_NMP_HOLD_ZOH, 1.0, 0.0, j == 1};
            planar5_nmp_inversion_limits limits = {
                bound, NULL, NULL, knots[j], j % 2 ? deviation : NULL};
            planar5_nmp_invert_limited_info info;
            int64_t size;
            double *work;
            planar5_nmp_status status;
            memcpy(bound, torque[i], sizeof torque[i]);
            if (j % 3 == 0) { /* more limits, which are kept */
                limits.gear_torque_max = limits.torque_rate_max = many;
                limits.joint_speed_max = limits.joint_acceleration_max = many;
                limits.tool_speed_max = limits.tool_acceleration_max = 1e9;
                limits.torque_speed = &curve[0][0][0];
                limits.torque_speed_points = 3;
            }
            size = planar5_nmp_invert_limited_work(N, &options, &limits);
            work = block(size > 0 ? (size_t)size : 1);
            status = planar5_nmp_invert_limited(
                &path, q_start, &options, &limits, &motion, &info, work, size);
            printf("%d\n", (int)status);
            if (status >= 0 && (j == 1 ? !(info.growth > 1.0 && info.growth < 10.0) :
                                         info.growth == info.growth)) {
                return 9; /* the growth, where it is asked for */
            }
            free(work);
        }
    }
    free(y), free(dy), free(ddy), free(q_start), free(bound), free(tau_m), free(deviation),
        free(small);
    free(q_a), free(v_a), free(q_m), free(v_m);
    return 0;
}
