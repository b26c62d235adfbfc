/*
 * Residual of the generalized momentum of a robot's motors, one update for each sample of the
 * controller:
 *
 *     r <- w (p - p_0 - s),    s <- s + T (tau - f + b + r),    p = (M v)_g + J_m v_m on the motor
 *       side
 *
 * b = M' v - h, all on the motor side: M' v by the change of M over the last sample. No memory is
 * allocated.
 */
#include <math.h>
#include <stdint.h>

#if defined(__GNUC__)
#define COLLISION_API __attribute__((visibility("default")))
#else
#define COLLISION_API
#endif

typedef struct {
    int32_t n_m, begun;
    double sample_s, bandwidth; /* w [1/s] */
    /* then p_0, s and r: n_m each */
} collision_state;

/*
 * p, driven (tau - f + b) of this sample, and thresholds (n_m; 0: none); returns the first motor
 * above it, 1 .., or 0. /
 */
COLLISION_API int flexgen_collision_update(
    void *self, const double *p, const double *driven, const double *threshold, double *residual)
{
    collision_state *c = (collision_state *)self;
    int32_t n = c->n_m, found = 0;
    double *first = (double *)(c + 1), *sum = first + n, *r = sum + n;
    for (int32_t j = 0; j < n; ++j) {
        if (!c->begun) {
            first[j] = p[j];
            sum[j] = 0.0;
            r[j] = 0.0;
        }
        r[j] = c->bandwidth * (p[j] - first[j] - sum[j]);
        sum[j] += c->sample_s * (driven[j] + r[j]);
        residual[j] = r[j];
        if (threshold[j] > 0.0 && fabs(r[j]) > threshold[j] && found == 0) {
            found = j + 1;
        }
    }
    c->begun = 1;
    return found;
}

/* The same over n samples (n, n_m); hit: the first sample above a threshold, or -1. */
COLLISION_API int64_t flexgen_collision_run(void *self, int64_t n, const double *p,
    const double *driven, const double *threshold, double *residual)
{
    int32_t n_m = ((collision_state *)self)->n_m;
    int64_t hit = -1;
    for (int64_t k = 0; k < n; ++k) {
        int64_t at = k * n_m;
        if (flexgen_collision_update(self, p + at, driven + at, threshold, residual + at) != 0 &&
            hit < 0) {
            hit = k;
        }
    }
    return hit;
}
