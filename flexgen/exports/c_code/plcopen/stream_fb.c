/*
 * The function block of a stream. Written by flexgen; the variables are those of the struct in the
 * header.
 */
#include "model_fb.h"

#include <string.h>

#include "model.h"

static const model_stream_options OPTIONS = {
    .intervals = FB_INTERVALS,
    .samples_per_interval = FB_SAMPLES,
    .period = FB_PERIOD,
    .tolerance = FB_TOLERANCE,
    .hold = MODEL_HOLD_ZOH,
};

enum { STOPPED = 0, ACTIVE = 1, FAILED = -1 };

static int refused(int status)
{
    return status == MODEL_INPUT_NOT_FINITE || status == MODEL_BAD_ARGUMENT ||
           status == MODEL_UNREACHABLE;
}

static void finish(fb_MODELNAME_stream *fb, int status)
{
    fb->status = status;
    fb->error = status < 0;
    fb->valid = status >= 0;
}

void fb_MODELNAME_stream_call(fb_MODELNAME_stream *fb)
{
    const model_stream stream = {
        .memory = fb->memory, .size = (int64_t)(sizeof fb->memory / sizeof fb->memory[0])};
    if (!fb->enable) {
        fb->started = STOPPED;
        fb->valid = 0;
        fb->error = 0;
        fb->status = MODEL_OK;
        return;
    }
    if (fb->started == FAILED) {
        return; /* until enable is FALSE once */
    }
    if (fb->started == STOPPED) {
        const int status = model_stream_start(&stream, &OPTIONS, fb->start_output, fb->q_start);
        if (status < 0) {
            fb->started = FAILED;
            finish(fb, status);
            return;
        }
        fb->started = ACTIVE;
    }
    double tau_m[FB_SAMPLES * MODEL_NM], q_m[FB_SAMPLES * MODEL_NM], v_m[FB_SAMPLES * MODEL_NM];
    model_motion motion = {NULL};
    model_stream_info info;
    motion.tau_m = tau_m;
    motion.q_m = q_m;
    motion.v_m = v_m;
    const int status = model_stream_update(&stream, fb->y, fb->dy, fb->ddy, &motion, &info);
    if (status >= 0) {
        memcpy(fb->tau_m, tau_m, sizeof tau_m);
        memcpy(fb->q_m, q_m, sizeof q_m);
        memcpy(fb->v_m, v_m, sizeof v_m);
    } else if (!refused(status)) {
        fb->started = FAILED;
    }
    finish(fb, status);
}
