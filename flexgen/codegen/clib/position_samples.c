/* model: samples of an interface of positions. Written by flexgen; see model_inversion.h. */
#include "model_inversion.h"

#include "model_inversion_common.h"

/*
 * The robot interpolates the positions c_j, one every E samples of its servo:
 *
 *     hold:    r = c_j
 *     linear:  r = (1 - x) c_j + x c_(j+1)
 *     cubic:   Hermite's polynomials with the derivatives (c_(j+1) - c_(j-1)) / 2
 *
 * with x = 0, 1/E, ..., 1 - 1/E; beyond the ends the positions stay. Those whose interpolation is
 * closest to the reference in the sense of least squares follow from equations with three
 * diagonals on either side, by Cholesky's method.
 */
/* positions in a sample; limits of arguments */
enum { SPREAD = 4, EACH_MAX = 100000, REFERENCES_MAX = 1000000000 };

int64_t model_position_samples_work(int n, const model_robot_interface *robot)
{
    if (robot == NULL || n < 2 || n > REFERENCES_MAX || robot->samples_per_position < 1 ||
        robot->samples_per_position > EACH_MAX) {
        return -1;
    }
    return SPREAD * ((int64_t)(n - 1) / robot->samples_per_position + 1);
}

/* Weights of the positions j - 1 to j + 2 at the part x of the way from position j to the next. */
static void interface_weights(int interpolation, real x, real weight[SPREAD])
{
    set_zero(weight, SPREAD);
    if (interpolation == MODEL_INTERPOLATION_HOLD) {
        weight[1] = 1.0;
    } else if (interpolation == MODEL_INTERPOLATION_LINEAR) {
        weight[1] = 1.0 - x;
        weight[2] = x;
    } else {
        weight[0] = ((-0.5 * x + 1.0) * x - 0.5) * x;
        weight[1] = (1.5 * x - 2.5) * x * x + 1.0;
        weight[2] = ((-1.5 * x + 2.0) * x + 0.5) * x;
        weight[3] = (0.5 * x - 0.5) * x * x;
    }
}

/*
 * Add the equations of the samples: the band A (entry d of row i: column i - d) and the right
 * sides, which are zero.
 */
static void add_samples(const real *reference, ptrdiff_t n, const model_robot_interface *o,
    ptrdiff_t m, real *A, real *right)
{
    const ptrdiff_t each = o->samples_per_position;
    for (ptrdiff_t k = 0; k < n; ++k) {
        const ptrdiff_t first = k / each - 1;
        real weight[SPREAD];
        interface_weights((int)o->interpolation, (real)(k % each) / (real)each, weight);
        for (int a = 0; a < SPREAD; ++a) {
            const ptrdiff_t i = first + a < 0 ? 0 : first + a < m ? first + a : m - 1;
            for (int b = 0; b < SPREAD; ++b) {
                const ptrdiff_t j = first + b < 0 ? 0 : first + b < m ? first + b : m - 1;
                if (j <= i) {
                    A[i * SPREAD + i - j] += weight[a] * weight[b];
                }
            }
            for (int g = 0; g < NG; ++g) {
                right[i * NG + g] += weight[a] * (reference[k * NG + g] - reference[g]);
            }
        }
    }
}

/* A becomes its factor L, A = L L'; 0 where a pivot is not positive. */
static int factor_band(real *A, ptrdiff_t m)
{
    for (ptrdiff_t i = 0; i < m; ++i) {
        real *row = A + i * SPREAD;
        for (int d = i < SPREAD ? (int)i : SPREAD - 1; d >= 0; --d) { /* column i - d */
            const real *above = A + (i - d) * SPREAD;
            real sum = row[d];
            for (int e = 1; e + d < SPREAD && e <= i - d; ++e) {
                sum -= row[d + e] * above[e];
            }
            if (d == 0 && !(sum > 0.0)) {
                return 0;
            }
            row[d] = d == 0 ? square_root(sum) : sum / above[0];
        }
    }
    return 1;
}

/* The solutions in place of the right sides. */
static void solve_band(const real *L, ptrdiff_t m, real *right)
{
    for (ptrdiff_t i = 0; i < m; ++i) {
        for (int g = 0; g < NG; ++g) {
            real sum = right[i * NG + g];
            for (int d = 1; d < SPREAD && d <= i; ++d) {
                sum -= L[i * SPREAD + d] * right[(i - d) * NG + g];
            }
            right[i * NG + g] = sum / L[i * SPREAD];
        }
    }
    for (ptrdiff_t i = m - 1; i >= 0; --i) {
        for (int g = 0; g < NG; ++g) {
            real sum = right[i * NG + g];
            for (int d = 1; d < SPREAD && i + d < m; ++d) {
                sum -= L[(i + d) * SPREAD + d] * right[(i + d) * NG + g];
            }
            right[i * NG + g] = sum / L[i * SPREAD];
        }
    }
}

model_status model_position_samples(const real *command_g, int n,
    const model_robot_interface *robot, real *positions, real *work, int64_t work_size)
{
    const int64_t wanted = model_position_samples_work(n, robot);
    ptrdiff_t m;
    if (command_g == NULL || robot == NULL || positions == NULL || work == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (wanted < 0 || (robot->interpolation != MODEL_INTERPOLATION_HOLD &&
                          robot->interpolation != MODEL_INTERPOLATION_LINEAR &&
                          robot->interpolation != MODEL_INTERPOLATION_CUBIC)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (work_size < wanted) {
        return MODEL_WORK_TOO_SMALL;
    }
    m = (ptrdiff_t)(wanted / SPREAD);
    for (ptrdiff_t k = 0; k < n; ++k) {
        if (!is_finite(command_g + k * NG, NG)) {
            return MODEL_INPUT_NOT_FINITE;
        }
    }
    set_zero(work, m * SPREAD);
    set_zero(positions, m * NG);
    add_samples(command_g, n, robot, m, work, positions);
    if (!factor_band(work, m)) {
        return MODEL_RESULT_NOT_FINITE;
    }
    solve_band(work, m, positions);
    for (ptrdiff_t j = 0; j < m; ++j) {
        for (int g = 0; g < NG; ++g) {
            positions[j * NG + g] += command_g[g];
        }
        if (!is_finite(positions + j * NG, NG)) {
            return MODEL_RESULT_NOT_FINITE;
        }
    }
    return MODEL_OK;
}
