/*
 * The stream of a loaded library, timed: for benchmarks/inversion_stream.py.
 *
 *   inversion_stream LIBRARY NAME intervals parts period tolerance updates n_t n_y n_a n_g n_m
 *     <samples >results
 *
 * Reads place (n_t) and q_start (n_a), then place, rate, rate2 of every update; writes for each
 * update its processor time [ns], status, residual, then motor angles and torques (parts, n_m) and
 * coordinates (parts, n_a).
 */
#define _POSIX_C_SOURCE 200809L
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

/* The structs of every library, see <model>_inversion.h. */
typedef struct {
    int intervals, samples_per_interval;
    double period, tolerance;
    int hold;
    double delay;
} stream_options;
typedef struct {
    double *memory;
    int64_t size;
} stream_memory;
typedef struct {
    double *q_a, *v_a, *a_a, *tau_g, *q_m, *v_m, *tau_m;
} motion;
typedef struct {
    double residual, kinematic_mismatch, torque_step, output_step_m, output_step_rad, deviation_m,
        deviation_rad;
    int cause, limits_active;
} stream_info;

typedef int64_t work_size(const stream_options *);
typedef int start_stream(
    const stream_memory *, const stream_options *, const double *, const double *);
typedef int update_stream(const stream_memory *, const double *, const double *, const double *,
    motion *, stream_info *);

static void *found(void *library, const char *name, const char *what)
{
    char symbol[200];
    void *at;
    snprintf(symbol, sizeof symbol, "%s_%s", name, what);
    at = dlsym(library, symbol);
    if (at == NULL) {
        fprintf(stderr, "%s is not in the library\n", symbol);
        exit(2);
    }
    return at;
}

static double *room(int64_t n)
{
    double *x = aligned_alloc(64, ((size_t)n * sizeof(double) + 63) / 64 * 64);
    if (x == NULL) {
        exit(3);
    }
    for (int64_t i = 0; i < n; ++i) {
        x[i] = 0.0;
    }
    return x;
}

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return 1e9 * (double)t.tv_sec + (double)t.tv_nsec;
}

int main(int argc, char **argv)
{
    int n[8];
    if (argc != 13) {
        return 2;
    }
    void *library = dlopen(argv[1], RTLD_NOW);
    if (library == NULL) {
        fprintf(stderr, "%s\n", dlerror());
        return 2;
    }
    const int intervals = atoi(argv[3]), parts = atoi(argv[4]);
    for (int i = 0; i < 6; ++i) {
        n[i] = atoi(argv[7 + i]);
    }
    const int updates = n[0], n_t = n[1], n_y = n[2], n_a = n[3], n_g = n[4], n_m = n[5];
    work_size *work = (work_size *)found(library, argv[2], "stream_work");
    start_stream *start = (start_stream *)found(library, argv[2], "stream_start");
    update_stream *update = (update_stream *)found(library, argv[2], "stream_update");
    const stream_options options = {intervals, parts, atof(argv[5]), atof(argv[6]), 0, 0.0};
    const int64_t size = work(&options), each = n_t + 2 * n_y,
                  out = 3 + (int64_t)parts * (2 * n_m + n_a);
    double *memory = room(size), *place = room(n_t), *q_start = room(n_a),
           *given = room(each * updates);
    double *q_a = room(parts * n_a), *v_a = room(parts * n_a), *tau_g = room(parts * n_g);
    double *q_m = room(parts * n_m), *v_m = room(parts * n_m), *tau_m = room(parts * n_m);
    motion found_motion = {q_a, v_a, NULL, tau_g, q_m, v_m, tau_m};
    const stream_memory stream = {memory, size};
    stream_info info;
    double *results = room(out * updates);
    size_t read = fread(place, sizeof *place, (size_t)n_t, stdin);
    read += fread(q_start, sizeof *q_start, (size_t)n_a, stdin);
    read += fread(given, sizeof *given, (size_t)(each * updates), stdin);
    if (read != (size_t)(n_t + n_a + each * updates)) {
        return 4;
    }
    if (start(&stream, &options, place, q_start) != 0) {
        fprintf(stderr, "the stream does not start\n");
        return 5;
    }
    for (int k = 0; k < updates; ++k) {
        const double *x = given + each * k;
        double *y = results + out * k;
        const double began = now();
        const int status = update(&stream, x, x + n_t, x + n_t + n_y, &found_motion, &info);
        *y++ = now() - began;
        *y++ = status;
        *y++ = info.residual;
        for (int i = 0; i < parts * n_m; ++i) {
            *y++ = q_m[i];
        }
        for (int i = 0; i < parts * n_m; ++i) {
            *y++ = tau_m[i];
        }
        for (int i = 0; i < parts * n_a; ++i) {
            *y++ = q_a[i];
        }
    }
    return fwrite(results, sizeof *results, (size_t)(out * updates), stdout) ==
                   (size_t)(out * updates) ?
               0 :
               6;
}
