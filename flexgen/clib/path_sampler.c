/* model: samples of a planned path from its table. Written by flexgen; see model_inversion.h. */
#include "model_inversion.h"

#include "model_path_curves.h"
#include "model_reduced_problem.h"

enum { TABLE_LAYOUT = 1, SPACE_TOOL = 0, SPACE_JOINT = 2, SEGMENTS_MAX = 100000 };

/* What stands before the segments of a table. */
typedef struct {
    int segments;
    const real *duration, *q_start, *axes;
    reader rest;
} table_head;

/* POINTS arms without deflections, for the outputs of a joint move. */
typedef struct {
    points q[NA], v[NA], target[NT], error[NY], W[NA][NY], bias[NY];
} sampler_points;

int64_t model_path_work(void)
{
    return padded((int64_t)(sizeof(sampler_points) / sizeof(real))) + function_work();
}

/* Read the head; 0 where it is not that of a table for this model. */
static int take_head(const real *table, int64_t size, table_head *head)
{
    reader all = {table, table + size}, r;
    if (!take_block(&all, &r) || all.at != all.end || take_count(&r, TABLE_LAYOUT) != TABLE_LAYOUT ||
        take_count(&r, NT) != NT || take_count(&r, NY) != NY || take_count(&r, NA) != NA) {
        return 0;
    }
    head->segments = take_count(&r, SEGMENTS_MAX);
    head->duration = take(&r, 1);
    head->q_start = take(&r, NA);
    head->axes = take(&r, NY);
    head->rest = r;
    return head->segments > 0 && head->axes != NULL && *head->duration >= 0.0;
}

/* Whether a table can be read at all. */
static int is_table(const real *table, int64_t size)
{
    return size >= 1 && size <= (int64_t)(PTRDIFF_MAX / (ptrdiff_t)sizeof(real)) &&
           is_finite(table, size < (int64_t)INT32_MAX ? (int)size : INT32_MAX);
}

model_status model_path_start(const real *table, int64_t table_size, real *duration, real q_start[MODEL_NA])
{
    table_head head;
    if (table == NULL || duration == NULL || q_start == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (!is_table(table, table_size) || !take_head(table, table_size, &head)) {
        return MODEL_BAD_ARGUMENT;
    }
    *duration = *head.duration;
    copy(head.q_start, NA, q_start);
    return MODEL_OK;
}

/* The segment that t belongs to: the last one that has started, or the first one; 0 where the table is damaged. */
static int find_segment(table_head *head, real t, reader *segment)
{
    for (int k = 0; k < head->segments; ++k) {
        reader next;
        if (!take_block(&head->rest, &next) || next.at == next.end) {
            return 0;
        }
        if (k > 0 && *next.at > t) {
            break;
        }
        *segment = next;
    }
    return 1;
}

/* Outputs of the undeflected arm from the jets of the joints. */
static void outputs_of_joints(curve_point *p, real *y, real *dy, real *ddy, real *work)
{
    sampler_points *arm = (sampler_points *)(void *)work;
    real *space = work + padded((int64_t)(sizeof(sampler_points) / sizeof(real)));
    for (int l = 0; l < POINTS; ++l) {
        for (int i = 0; i < NA; ++i) {
            arm->q[i][l] = arm->v[i][l] = 0.0;
        }
        for (int i = 0; i < NG; ++i) {
            arm->q[i_g[i]][l] = p->x[i][0];
            arm->v[i_g[i]][l] = p->x[i][1];
        }
        for (int i = 0; i < NT; ++i) {
            arm->target[i][l] = 0.0;
        }
    }
#if MODEL_POSE
    /* The error of the orientation is linear in the target R: half the sum of the cross products of its columns with
       those of the arm. The unit vectors x and y as column k show column k of the arm's. */
    for (int k = 0; k < 3; ++k) {
        arm->target[3 + 3 * k][2 * k] = 1.0;
        arm->target[3 + 3 * k + 1][2 * k + 1] = 1.0;
    }
#endif
    (void)evaluate_output_constraint_batch(POINTS, &arm->q[0][0], &arm->v[0][0], &arm->target[0][0], &arm->error[0][0],
        &arm->W[0][0][0], &arm->bias[0][0], space);
#if MODEL_POSE
    for (int i = 0; i < 3; ++i) {
        y[i] = arm->error[i][0];
    }
    for (int k = 0; k < 3; ++k) {
        y[3 + 3 * k] = -2.0 * arm->error[5][2 * k + 1];
        y[3 + 3 * k + 1] = 2.0 * arm->error[5][2 * k];
        y[3 + 3 * k + 2] = 2.0 * arm->error[3][2 * k + 1];
    }
#else
    for (int i = 0; i < NY; ++i) {
        y[i] = arm->error[i][0];
    }
#endif
    for (int j = 0; j < NY; ++j) {
        real rate = 0.0, second = arm->bias[j][0];
        for (int i = 0; i < NG; ++i) {
            rate += arm->W[i_g[i]][j][0] * p->x[i][1];
            second += arm->W[i_g[i]][j][0] * p->x[i][2];
        }
        dy[j] = rate;
        ddy[j] = second;
    }
}

/* The point of a curve in the space of the outputs; 0 where it does not fit them. */
static int outputs_of_curve(
    const curve_point *p, int dimensions, int space, const real *axes, real *y, real *dy, real *ddy)
{
    (void)axes;
#if MODEL_POSE
    if (space != SPACE_TOOL || dimensions != 3 || !p->is_pose) {
        return 0;
    }
    for (int i = 0; i < 3; ++i) {
        y[i] = p->x[i][0];
        dy[i] = p->x[i][1];
        ddy[i] = p->x[i][2];
        for (int k = 0; k < 3; ++k) {
            y[3 + 3 * k + i] = p->R[3 * i + k];
        }
        dy[3 + i] = p->w[i][0];
        ddy[3 + i] = p->w[i][1];
    }
#else
    for (int i = 0; i < NY; ++i) {
        const int from = space != SPACE_TOOL ? i : axes[i] >= 0.0 && axes[i] < (real)dimensions ? (int)axes[i] : -1;
        if (from < 0 || from >= dimensions) {
            return 0;
        }
        y[i] = p->x[from][0];
        dy[i] = p->x[from][1];
        ddy[i] = p->x[from][2];
    }
#endif
    return 1;
}

model_status model_path_sample(const real *table, int64_t table_size, PARAMETERS_ARGUMENT real t, real y[MODEL_NT],
    real dy[MODEL_NY], real ddy[MODEL_NY], real *work, int64_t work_size)
{
    const real *values = GIVEN_PARAMETERS;
    reader segment = {NULL, NULL}, law, curve;
    real s[JET];
    const real *start; /* and duration */
    curve_point p;
    table_head head;
    int space, dimensions;
    if (table == NULL || values == NULL || y == NULL || dy == NULL || ddy == NULL || work == NULL) {
        return MODEL_NULL_ARGUMENT;
    }
    if (work_size < model_path_work()) {
        return MODEL_WORK_TOO_SMALL;
    }
    if (!is_finite(&t, 1) || !is_finite(values, PARAMETERS)) {
        return MODEL_INPUT_NOT_FINITE;
    }
    if (table_size < 1 || !take_head(table, table_size, &head) || !find_segment(&head, t, &segment)) {
        return MODEL_BAD_ARGUMENT;
    }
    start = take(&segment, 2);
    space = take_count(&segment, SPACE_JOINT);
    if (start == NULL || space < 0 || !take_block(&segment, &law) || !take_block(&segment, &curve) ||
        !law_at(&law, t >= start[0] + start[1] ? (t - start[0]) + start[1] : t - start[0], s)) {
        return MODEL_BAD_ARGUMENT;
    }
    dimensions = curve_at(&curve, s, &p);
    if (dimensions < 1 || (space == SPACE_JOINT && dimensions != NG)) {
        return MODEL_BAD_ARGUMENT;
    }
    if (space == SPACE_JOINT) {
        keep_parameters(values, work + padded((int64_t)(sizeof(sampler_points) / sizeof(real))));
        outputs_of_joints(&p, y, dy, ddy, work);
    } else if (!outputs_of_curve(&p, dimensions, space, head.axes, y, dy, ddy)) {
        return MODEL_BAD_ARGUMENT;
    }
    return is_finite(y, NT) && is_finite(dy, NY) && is_finite(ddy, NY) ? MODEL_OK : MODEL_RESULT_NOT_FINITE;
}
