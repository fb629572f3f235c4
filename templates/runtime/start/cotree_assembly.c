/* cotree_assembly.c: projection onto the constraints by minimum-norm Gauss-Newton steps. */
#include "cotree_assembly_internal.h"

#include <string.h>

/* Residuals below RESIDUAL_TOLERANCE times the magnitude of the states satisfy the constraints;
 * those below RESIDUAL_ROUNDING are rounding errors. A step rotates by at most MAX_ROTATION, [rad],
 * so that the iteration remains on the same branch. A step below STEP_ROUNDING is the last one. */
#define MAX_STEPS 50
#define RESIDUAL_TOLERANCE COTREE_SELECT(1e-11, 1.5e-05f)
#define RESIDUAL_ROUNDING COTREE_SELECT(1e-15, 2.4e-07f)
#define STEP_ROUNDING (COTREE_F(4.0) * COTREE_EPSILON)
#define MAX_ROTATION COTREE_F(0.5)

/* Number of further starting points after a failure, and their distance from the first point,
 * where gradients may vanish. For example, a perpendicular component does not change a length to
 * first order. */
#define MAX_RESTARTS 4
#define RESTART_DISTANCE COTREE_F(0.1)

/* The change of a residual also counts as cancelled if its remainder is below this fraction of the
 * largest term of its sum. */
#define SUM_ROUNDING COTREE_SELECT(1e-13, 1.2e-05f)

void cotree_assembly_init(cotree_assembly *a, cotree_run *run, const cotree_assembly_tables *tables,
                          cotree_arena *arena)
{
    const cotree_model *const model = run->model;
    const int n = model->n_states, m = run->n_blocks - 1;
    const int n_all = tables->n_rows + tables->n_conditions;
    memset(a, 0, sizeof *a);
    a->run = run;
    a->tables = tables;
    a->holds[0] = a->holds[1] = 1;
    a->length = COTREE_F(1.0);
    a->culprit = a->column = -1;
    a->is_kept = cotree_arena_ints(arena, n);
    a->places = cotree_arena_ints(arena, n_all);
    a->value_of = cotree_arena_ints(arena, tables->n_speeds);
    a->residual = cotree_arena_reals(arena, model->n_constraints);
    a->conditions = cotree_arena_reals(arena, tables->n_start);
    a->gradient = cotree_arena_reals(arena, tables->n_rows * tables->n_speeds);
    a->start_gradient = cotree_arena_reals(arena, tables->n_conditions * tables->n_speeds);
    a->slopes = cotree_arena_reals(arena, m * model->n_constraints);
    a->start_slopes = cotree_arena_reals(arena, m * tables->n_start);
    a->values = cotree_arena_reals(arena, tables->n_values + n_all);
    a->step = cotree_arena_reals(arena, tables->n_speeds);
    a->change = cotree_arena_reals(arena, tables->n_coordinates);
    a->best = cotree_arena_reals(arena, n);
    a->trial = cotree_arena_reals(arena, n);
    a->aside = cotree_arena_reals(arena, n);
    a->parts = cotree_arena_reals(arena, 3 * POSITIONS * tables->n_groups);
    cotree_least_init(&a->least, n_all, tables->n_speeds, arena);
}

int cotree_assembly_is_quaternion(const cotree_assembly *a, int state)
{
    int i;
    for (i = 0; i < a->tables->n_quaternions; ++i) {
        if (a->tables->quaternions[i] == state) return 1;
    }
    return 0;
}

void cotree_assembly_hold(cotree_assembly *a, const int *is_set)
{
    int i, level;
    for (level = 0; level < 2; ++level) {
        const int first = level == 0 ? 0 : N_COORDINATES;
        const int end = level == 0 ? N_COORDINATES : N_COORDINATES + N_SPEEDS;
        int is_all = 1;
        for (i = first; i < end; ++i) is_all = is_all && is_set[i];
        a->holds[level] = !is_all;
    }
}

int cotree_assembly_is_angular(const cotree_assembly *a, int speed)
{
    const char *const unit = MODEL->states[N_COORDINATES + speed].unit;
    return unit[0] == 'r' && unit[1] == 'a' && unit[2] == 'd';
}

/* Return the scale of a motion direction in the unit of its speed. */
cotree_real cotree_assembly_unit_of_speed(const cotree_assembly *a, int i)
{
    return cotree_assembly_is_angular(a, i) ? COTREE_F(1.0) : a->length;
}

int cotree_assembly_is_shift(const cotree_assembly *a, int coordinate)
{
    const char *const unit = MODEL->states[coordinate].unit;
    return unit[0] == 'm' && unit[1] == '\0';
}

int cotree_assembly_is_length(const cotree_assembly *a, int row)
{
    return a->tables->rows != NULL && a->tables->rows[row].unit[0] == 'm';
}

cotree_real cotree_assembly_unit_of_row(const cotree_assembly *a, int row)
{
    return cotree_assembly_is_length(a, row) ? a->length : COTREE_F(1.0);
}

/* Return a coordinate or a speed in dimensionless form. */
cotree_real cotree_assembly_scaled(const cotree_assembly *a, const cotree_real *x, int i)
{
    if (i >= N_COORDINATES) return x[i] / cotree_assembly_unit_of_speed(a, i - N_COORDINATES);
    return cotree_assembly_is_shift(a, i) ? x[i] / a->length : x[i];
}

/* Return the magnitude of the terms in the residuals of a level, at least 1. */
static cotree_real size_of(const cotree_assembly *a, const cotree_real *x, int level)
{
    const int n = N_COORDINATES + (level == 1 ? N_SPEEDS : 0);
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < n; ++i)
        largest = COTREE_FMAX(largest, COTREE_FABS(cotree_assembly_scaled(a, x, i)));
    return COTREE_F(1.0) + largest;
}

/* List the rows of a level (0: coordinates, 1: speeds): its constraints, then its conditions. */
void cotree_assembly_list_rows(cotree_assembly *a, int level, int has_conditions)
{
    const cotree_assembly_tables *const tables = a->tables;
    const int first = level == 0 ? 0 : tables->n_values;
    const int n = level == 0 ? tables->n_values : tables->n_rows;
    int i;
    for (i = 0; i < n; ++i) a->places[i] = first + i;
    a->n_own = n;
    for (i = 0; i < tables->n_conditions && has_conditions && a->holds[level]; ++i) {
        if ((tables->is_rate[i] != 0) != level) continue;
#if COTREE_HAS_MENDING
        if (a->report != NULL && a->is_dropped[i]) continue;
#endif
        a->places[a->n_own++] = tables->n_values + tables->n_rows + i;
    }
}

/* List the prescribed state that fixes each motion direction, or -1 if it is free; for a
 * quaternion, the state with the lowest rank. Return the number of free directions. */
static int list_values(cotree_assembly *a, int level)
{
    int i, k, n_free = 0, speed = 0, state = 0;
    while (speed < N_SPEEDS) {
        const int is_turning = level == 0 && cotree_assembly_is_quaternion(a, state);
        int value = -1;
        if (level == 1) state = N_COORDINATES + speed;
        for (k = 0; k < (is_turning ? 4 : 1); ++k) {
            if (!a->is_kept[state + k]) continue;
#if COTREE_HAS_MENDING
            if (a->report != NULL && value >= 0 &&
                a->report->ranks[state + k] >= a->report->ranks[value])
                continue;
#endif
            value = state + k;
        }
        for (i = 0; i < (is_turning ? 3 : 1); ++i) {
            a->value_of[speed++] = value;
            n_free += value < 0;
        }
        state += is_turning ? 4 : 1;
    }
    return n_free;
}

/* Return the result of a row: of a constraint or of a condition at the start. */
cotree_real cotree_assembly_pick(const cotree_assembly *a, int row, const cotree_real *constraints,
                                 const cotree_real *conditions)
{
    const int n = a->tables->n_values + a->tables->n_rows;
    return row < n ? constraints[row] : conditions[row - n];
}

/* Compute the dimensionless residuals of the listed rows, and the largest one. */
int cotree_assembly_compute_residuals(cotree_assembly *a, cotree_real t, const cotree_real *x,
                                      cotree_real *size)
{
    const cotree_run *const run = a->run;
    int r, status = 0;
    if (MODEL->n_constraints > 0)
        status = MODEL->constraints(t, x, run->u, run->p, run->k, a->residual);
    if (status == 0 && a->tables->n_conditions > 0)
        status = MODEL->start(t, x, run->u, run->p, run->k, a->conditions);
    *size = COTREE_F(0.0);
    for (r = 0; r < a->n_own; ++r) {
        const int row = a->places[r];
        a->values[r] = cotree_assembly_pick(a, row, a->residual, a->conditions) /
                       cotree_assembly_unit_of_row(a, row);
        /* Also true for nan. */
        if (!(COTREE_FABS(a->values[r]) <= *size)) *size = COTREE_FABS(a->values[r]);
    }
    return status;
}

int cotree_assembly_compute_gradients(cotree_assembly *a, cotree_real t, const cotree_real *x)
{
    const cotree_run *const run = a->run;
    int status = 0;
    if (MODEL->gradient != NULL)
        status = MODEL->gradient(t, x, run->u, run->p, run->k, a->gradient);
    if (status == 0 && a->tables->n_conditions > 0)
        status = MODEL->start_gradient(t, x, run->u, run->p, run->k, a->start_gradient);
    return status;
}

/* Return the gradient of a row with respect to the speeds. A constraint on coordinates has the
 * gradient of its time derivative. */
const cotree_real *cotree_assembly_gradient_of(const cotree_assembly *a, int row)
{
    const cotree_assembly_tables *const tables = a->tables;
    if (row < tables->n_values) return a->gradient + tables->value_rows[row] * N_SPEEDS;
    row -= tables->n_values;
    if (row < tables->n_rows) return a->gradient + row * N_SPEEDS;
    return a->start_gradient + (row - tables->n_rows) * N_SPEEDS;
}

/* Factorise the dimensionless gradients of the listed rows with respect to the free directions.
 * *largest is their largest entry. Return the rank. */
int cotree_assembly_factorise(cotree_assembly *a, cotree_real *largest)
{
    int i, r;
    a->longest = *largest = COTREE_F(0.0);
    for (r = 0; r < a->n_own; ++r) {
        const cotree_real *const gradient = cotree_assembly_gradient_of(a, a->places[r]);
        const cotree_real unit = cotree_assembly_unit_of_row(a, a->places[r]);
        cotree_real *const row = a->least.rows + r * N_SPEEDS;
        cotree_real square = COTREE_F(0.0);
        for (i = 0; i < N_SPEEDS; ++i) {
            const cotree_real entry = gradient[i] * cotree_assembly_unit_of_speed(a, i) / unit;
            square += entry * entry;
            row[i] = a->value_of[i] < 0 ? entry : COTREE_F(0.0);
            /* Also true for nan. */
            if (!(COTREE_FABS(row[i]) <= *largest)) *largest = COTREE_FABS(row[i]);
        }
        a->longest = COTREE_FMAX(a->longest, COTREE_SQRT(square));
    }
    return cotree_least_factorise(&a->least, a->n_own, a->longest);
}

int cotree_assembly_normalise(const cotree_assembly *a, cotree_real *x)
{
    int i, k;
    for (i = 0; i < a->tables->n_quaternions; ++i) {
        cotree_real *const q = x + a->tables->quaternions[i];
        cotree_real size = COTREE_F(0.0);
        for (k = 0; k < 4; ++k) size += q[k] * q[k];
        if (!(size > COTREE_F(0.0))) return COTREE_ASSEMBLY_VIOLATED;
        for (k = 0; k < 4; ++k) q[k] /= COTREE_SQRT(size);
    }
    return 0;
}

/* Add to `change` the change of the coordinates at x by a dimensionless step along the motion
 * directions. A quaternion q changes by q (0, e) / 2, where e is a rotation about its body axes. */
static void add_shift(const cotree_assembly *a, const cotree_real *x, const cotree_real *step,
                      cotree_real *change)
{
    int state = 0, i = 0;
    while (state < N_COORDINATES) {
        if (cotree_assembly_is_quaternion(a, state)) {
            const cotree_real *const q = x + state, *const s = step + i;
            cotree_real *const d = change + state;
            const cotree_real d0 = -q[1] * s[0] - q[2] * s[1] - q[3] * s[2];
            const cotree_real d1 = q[0] * s[0] - q[3] * s[1] + q[2] * s[2];
            const cotree_real d2 = q[3] * s[0] + q[0] * s[1] - q[1] * s[2];
            const cotree_real d3 = -q[2] * s[0] + q[1] * s[1] + q[0] * s[2];
            d[0] += COTREE_F(0.5) * d0;
            d[1] += COTREE_F(0.5) * d1;
            d[2] += COTREE_F(0.5) * d2;
            d[3] += COTREE_F(0.5) * d3;
            state += 4;
            i += 3;
        } else {
            change[state++] += step[i] * cotree_assembly_unit_of_speed(a, i);
            ++i;
        }
    }
}

/* Move the coordinates (level 0) or speeds (level 1) of x by a step. */
static int apply_step(cotree_assembly *a, int level, const cotree_real *step, cotree_real *x)
{
    int i;
    if (level == 1) {
        for (i = 0; i < N_SPEEDS; ++i)
            x[N_COORDINATES + i] += step[i] * cotree_assembly_unit_of_speed(a, i);
        return 0;
    }
    for (i = 0; i < N_COORDINATES; ++i) a->change[i] = COTREE_F(0.0);
    add_shift(a, x, step, a->change);
    for (i = 0; i < N_COORDINATES; ++i) x[i] += a->change[i];
    return cotree_assembly_normalise(a, x);
}

cotree_real cotree_assembly_largest_of(const cotree_real *x, int n)
{
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < n; ++i) {
        if (!(COTREE_FABS(x[i]) <= largest)) largest = COTREE_FABS(x[i]); /* also true for nan */
    }
    return largest;
}

void cotree_assembly_copy(int n, const cotree_real *from, cotree_real *to)
{
    int i;
    for (i = 0; i < n; ++i) to[i] = from[i];
}

/* Take a Gauss-Newton step of the coordinates or speeds x, whose residuals are a->values with
 * maximum a->left. Store the point with the smallest residual in a->best. */
static int take_step(const cotree_iteration *iteration, int is_new, cotree_real *length)
{
    cotree_assembly *const a = (cotree_assembly *)iteration->context;
    const cotree_real t = iteration->t, size = size_of(a, iteration->x, a->level);
    cotree_real largest;
    int i, status;
    (void)is_new;
    *length = COTREE_F(0.0);
    if (a->left <= RESIDUAL_ROUNDING * size) return 0;
    if (!(a->left <= COTREE_MAX)) return COTREE_NO_STEP;
    status = cotree_assembly_compute_gradients(a, t, iteration->x);
    if (status != 0) return status;
    (void)cotree_assembly_factorise(a, &largest);
#if COTREE_HAS_MENDING
    if (a->has_way) cotree_assembly_factorise_given(a, &largest);
#endif
    /* If the gradients vanish, a step would amplify rounding errors. */
    if (!(largest >= COTREE_RANK && largest <= COTREE_MAX)) return COTREE_NO_STEP;
    cotree_least_solve(&a->least, a->values, a->step);
#if COTREE_HAS_MENDING
    if (a->has_way) cotree_assembly_solve_given(a);
#endif
    *length = cotree_assembly_largest_of(a->step, N_SPEEDS);
    if (a->level == 0 && *length > MAX_ROTATION) {
        for (i = 0; i < N_SPEEDS; ++i) a->step[i] *= MAX_ROTATION / *length;
    }
    *length /= size;
    status = apply_step(a, a->level, a->step, iteration->x);
    if (status == 0) status = cotree_assembly_compute_residuals(a, t, iteration->x, &a->left);
    if (status != 0 || !(a->left < a->smallest)) return status;
    cotree_assembly_copy(N_STATES, iteration->x, a->best);
    a->smallest = a->left;
    return 0;
}

/* Iterate until a step is at rounding level; if that fails, write the point with the smallest
 * residual to x. */
int cotree_assembly_iterate(cotree_assembly *a, cotree_real t, cotree_real *x, int level,
                            cotree_real *residual)
{
    static const cotree_newton_limits limits = {MAX_STEPS, STEP_ROUNDING, COTREE_SMALL_CORRECTION,
                                                COTREE_F(0.0), COTREE_F(0.0)};
    cotree_iteration iteration = {take_step, NULL, a, t, x, &limits, COTREE_F(0.0)};
    int status = cotree_assembly_compute_residuals(a, t, x, &a->left);
    a->level = level;
    a->smallest = a->left;
    cotree_assembly_copy(N_STATES, x, a->best);
    if (status == 0) status = cotree_iterate(&iteration);
    if (status != 0) cotree_assembly_copy(N_STATES, a->best, x);
    *residual = status == 0 ? a->left : a->smallest;
    return status == COTREE_NO_STEP ? 0 : status;
}

cotree_real cotree_pseudo_random(int n)
{
    const cotree_real golden = COTREE_F(0.6180339887498949) * (cotree_real)(n + 1);
    return COTREE_F(1.7320508075688772) *
           (COTREE_F(2.0) * COTREE_FMOD(golden, COTREE_F(1.0)) - COTREE_F(1.0));
}

/* Project the states of a level onto its constraints. */
static int project_level(cotree_assembly *a, cotree_real t, cotree_real *x, int level)
{
    const int n_free = list_values(a, level);
    const cotree_real met = RESIDUAL_TOLERANCE * size_of(a, x, level);
    cotree_real residual, other = COTREE_F(0.0);
    int i, n, status;
    cotree_assembly_list_rows(a, level, 1);
    cotree_assembly_copy(N_STATES, x, a->aside);
#if COTREE_HAS_MENDING
    if (a->report != NULL) cotree_assembly_start_report(a, level, x);
#endif
    status = cotree_assembly_iterate(a, t, x, level, &residual);
    /* Constraints on speeds are linear, so other starting points do not help. */
    for (n = 0; n < MAX_RESTARTS && status == 0 && level == 0 && n_free > 0; ++n) {
        if (residual <= met) return 0;
        cotree_assembly_copy(N_STATES, a->aside, a->trial);
        for (i = 0; i < N_SPEEDS; ++i)
            a->step[i] = a->value_of[i] < 0
                             ? RESTART_DISTANCE * cotree_pseudo_random(n * N_SPEEDS + i)
                             : COTREE_F(0.0);
        status = apply_step(a, 0, a->step, a->trial);
        if (status == 0) status = cotree_assembly_iterate(a, t, a->trial, 0, &other);
        if (status == 0 && other < (COTREE_F(1.0) - COTREE_SMALL_CORRECTION) * residual) {
            cotree_assembly_copy(N_STATES, a->trial, x);
            residual = other;
        }
    }
    if (status != 0 || residual <= met) return status;
#if COTREE_HAS_MENDING
    if (a->report != NULL) return cotree_assembly_mend(a, t, x, level, met);
#endif
    status = cotree_assembly_compute_residuals(a, t, x, &residual);
    a->culprit = -1;
    for (i = 0; i < a->n_own; ++i) {
        if (!(COTREE_FABS(a->values[i]) < residual)) a->culprit = a->places[i];
    }
    return status != 0 ? status : COTREE_ASSEMBLY_VIOLATED;
}

int cotree_assembly_move(cotree_assembly *a, cotree_real t, cotree_real *x)
{
    int status = cotree_assembly_normalise(a, x);
    if (status == 0 && a->tables->n_rows + a->tables->n_conditions > 0) {
        status = project_level(a, t, x, 0);
        if (status == 0) status = project_level(a, t, x, 1);
    }
    return status;
}

int cotree_assembly_is_chosen(cotree_assembly *a, cotree_real t, const cotree_real *from,
                              const cotree_real *to)
{
    int i, level;
    if (a->tables->n_rows + a->tables->n_conditions == 0) return 0;
    for (level = 0; level < 2; ++level) {
        const int first = level == 0 ? 0 : N_COORDINATES;
        const int n = level == 0 ? N_COORDINATES : N_SPEEDS;
        const int n_free = list_values(a, level);
        cotree_real moved = COTREE_F(0.0), largest;
        for (i = first; i < first + n; ++i)
            moved = COTREE_FMAX(moved, COTREE_FABS(cotree_assembly_scaled(a, to, i) -
                                                   cotree_assembly_scaled(a, from, i)));
        if (moved <= RESIDUAL_TOLERANCE * size_of(a, to, level)) continue;
#if COTREE_HAS_MENDING
        if (a->report != NULL && a->is_mended[level]) return 1;
#endif
        cotree_assembly_list_rows(a, level, 1);
        if (cotree_assembly_compute_gradients(a, t, to) == 0 &&
            n_free > cotree_assembly_factorise(a, &largest))
            return 1;
    }
    return 0;
}

/* Return the dimensionless derivative of a row along a motion direction. */
cotree_real cotree_assembly_entry_of(const cotree_assembly *a, int row, int speed)
{
    return cotree_assembly_gradient_of(a, row)[speed] * cotree_assembly_unit_of_speed(a, speed) /
           cotree_assembly_unit_of_row(a, row);
}

/* Return the part of a row's change that the step does not cancel. */
cotree_real cotree_assembly_remainder_of(const cotree_assembly *a, int row, cotree_real change)
{
    int i;
    for (i = 0; i < N_SPEEDS; ++i) change += cotree_assembly_entry_of(a, row, i) * a->step[i];
    return change;
}

/* Compute the step that cancels the changes of the listed rows, which are in `values`. Return
 * whether a remainder exceeds its bound; culprit is the row with the largest remainder. */
static int cancel_changes(cotree_assembly *a, cotree_real allowed)
{
    cotree_real most = COTREE_F(0.0);
    int r;
    cotree_least_solve(&a->least, a->values, a->step);
    allowed += REMAINDER_SHARE * cotree_assembly_largest_of(a->values, a->n_own);
    for (r = 0; r < a->n_own; ++r) {
        const cotree_real left = cotree_assembly_remainder_of(a, a->places[r], a->values[r]);
        if (!(COTREE_FABS(left) <= most)) {
            most = COTREE_FABS(left);
            a->culprit = a->places[r];
        }
    }
    return !(most <= allowed);
}

/* Add a step along the motion directions of a level to a direction of the states. */
static void add_step(const cotree_assembly *a, const cotree_real *x, int level,
                     cotree_real *direction)
{
    int i;
    if (level == 0) {
        add_shift(a, x, a->step, direction);
        return;
    }
    for (i = 0; i < N_SPEEDS; ++i)
        direction[N_COORDINATES + i] += a->step[i] * cotree_assembly_unit_of_speed(a, i);
}

/* Return a bound on the rounding error of a row's change along a direction of the states. */
static cotree_real rounding_of(const cotree_assembly *a, const cotree_real *s, cotree_real largest)
{
    const cotree_real size = size_of(a, s, 1) - COTREE_F(1.0);
    return SUM_ROUNDING * COTREE_FMAX(COTREE_F(1.0), largest) * size;
}

int cotree_assembly_follow(cotree_assembly *a, cotree_real t, const cotree_real *x, int level,
                           const cotree_real *rates, cotree_real *direction)
{
    cotree_real largest;
    int r, status = cotree_assembly_compute_gradients(a, t, x);
    if (status != 0) return status;
    list_values(a, level);
    cotree_assembly_list_rows(a, level, 1);
    if (a->n_own == 0) return 0;
    cotree_assembly_factorise(a, &largest);
    for (r = 0; r < a->n_own; ++r) {
        a->values[r] = rates[a->places[r]] / cotree_assembly_unit_of_row(a, a->places[r]);
    }
    if (cancel_changes(a, rounding_of(a, direction, largest))) return COTREE_ASSEMBLY_STUCK;
    add_step(a, x, level, direction);
    return 0;
}

void cotree_assembly_turn(const cotree_assembly *a, const cotree_real *x, cotree_real *direction)
{
    int i, k;
    for (i = 0; i < a->tables->n_quaternions; ++i) {
        const cotree_real *const q = x + a->tables->quaternions[i];
        cotree_real *const own = direction + a->tables->quaternions[i];
        cotree_real along = COTREE_F(0.0);
        for (k = 0; k < 4; ++k) along += q[k] * own[k];
        for (k = 0; k < 4; ++k) own[k] -= along * q[k];
    }
}

/* Return the dimensionless change of a row along a sensitivity. */
cotree_real cotree_assembly_change_of(const cotree_assembly *a, int row, int column)
{
    const cotree_real *const slopes = a->slopes + column * MODEL->n_constraints;
    const cotree_real *const start_slopes = a->start_slopes + column * a->tables->n_start;
    return cotree_assembly_pick(a, row, slopes, start_slopes) / cotree_assembly_unit_of_row(a, row);
}

/* Compute the sensitivities of the free states of one level, either to parameters or to initial
 * states. */
static int complete_sensitivities(cotree_assembly *a, const cotree_real *x, int level,
                                  const int *seeds, int is_state, cotree_real *s)
{
    cotree_real largest;
    int n, r;
    cotree_assembly_list_rows(a, level, !is_state);
    if (a->n_own == 0) return 0;
    cotree_assembly_factorise(a, &largest);
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        cotree_real *const own = s + n * N_STATES;
        cotree_real rounding = COTREE_F(0.0);
        if (seeds != NULL && (seeds[n] < 0) != is_state) continue;
        for (r = 0; r < a->n_own; ++r) a->values[r] = cotree_assembly_change_of(a, a->places[r], n);
        if (seeds != NULL) {
            /* The scale of a derivative is a characteristic length, or one radian, divided by the
             * parameter. */
            const cotree_real p = seeds[n] < 0 ? COTREE_F(1.0) : COTREE_FABS(a->run->p[seeds[n]]);
            rounding = rounding_of(a, own, largest) +
                       SUM_ROUNDING / (p > COTREE_F(0.0) ? p : COTREE_F(1.0));
        }
        if (cancel_changes(a, rounding) && seeds != NULL) {
            a->column = n;
#if COTREE_HAS_MENDING
            if (a->report == NULL ||
                cotree_assembly_follow_with_given(a, level, n, seeds[n], rounding))
                return COTREE_ASSEMBLY_STUCK;
#else
            return COTREE_ASSEMBLY_STUCK;
#endif
        }
        add_step(a, x, level, own);
    }
    return 0;
}

int cotree_assembly_move_sensitivities(cotree_assembly *a, cotree_real t, const cotree_real *x,
                                       const int *seeds, cotree_real *s)
{
    const cotree_run *const run = a->run;
    int n, level, status = 0;
    for (n = 0; n < N_SENSITIVITIES; ++n) cotree_assembly_turn(a, x, s + n * N_STATES);
    if (a->tables->n_rows + a->tables->n_conditions == 0) return 0;
    status = cotree_assembly_compute_gradients(a, t, x);
    for (level = 0; level < 2 && status == 0; ++level) {
        list_values(a, level);
        if (MODEL->n_constraints > 0)
            status = MODEL->constraint_sensitivity(t, x, s, run->u, run->p, run->k, a->slopes);
        if (status == 0 && a->tables->n_conditions > 0)
            status = MODEL->start_sensitivity(t, x, s, run->u, run->p, run->k, a->start_slopes);
        if (status == 0) status = complete_sensitivities(a, x, level, seeds, 0, s);
        if (status == 0 && seeds != NULL) status = complete_sensitivities(a, x, level, seeds, 1, s);
    }
    return status;
}
