/* cotree_assembly_mend.c: changes of prescribed values if the constraints cannot be satisfied
 * otherwise.
 *
 * Values of the highest ranks change first, until the remaining residuals can be cancelled. The
 * changes of these values have minimum norm; free directions change without limit. A value is a
 * state, or N_STATES plus the index of a condition, which is then dropped. */
#include "cotree_assembly_internal.h"

#if COTREE_HAS_MENDING
/* Prescribed values contradict each other if they need to change by more than FARTHEST. Changes
 * above NOTICED are reported. The units are radians, characteristic lengths, or the largest
 * speed. */
#define FARTHEST COTREE_F(0.1)
#define NOTICED COTREE_F(1e-4)

/* A value is chosen first if its direction differs by at least this from the directions of the
 * values already chosen; otherwise its change would be large. */
#define APART COTREE_F(1e-2)

#define N_CONDITIONS (a->tables->n_conditions)
#define FIRST_CONDITION (a->tables->n_values + a->tables->n_rows)

void cotree_assembly_report_to(cotree_assembly *a, cotree_start_report *report, cotree_arena *arena)
{
    const int n_all = a->tables->n_rows + N_CONDITIONS, n_most = N_SPEEDS + N_CONDITIONS;
    a->report = report;
    a->is_giving = cotree_arena_ints(arena, N_SPEEDS);
    a->is_dropped = cotree_arena_ints(arena, N_CONDITIONS);
    a->candidates = cotree_arena_ints(arena, n_most);
    a->is_chosen = cotree_arena_ints(arena, n_most);
    a->target = cotree_arena_reals(arena, n_all);
    a->extra = cotree_arena_reals(arena, N_SPEEDS);
    a->found = cotree_arena_reals(arena, MODEL->n_states);
    cotree_least_init(&a->given, n_all, N_SPEEDS, arena);
    cotree_least_init(&a->span, n_most, n_all, arena);
}

void cotree_assembly_start_report(cotree_assembly *a, int level, const cotree_real *x)
{
    const int first = level == 0 ? 0 : N_COORDINATES;
    const int n = level == 0 ? N_COORDINATES : N_SPEEDS;
    a->is_mended[level] = 0;
    if (a->is_probe) return;
    a->report->length = a->length;
    cotree_assembly_copy(n, x + first, a->report->before + first);
}

/* Insert a value into the n candidates, which are sorted by descending rank. The value `last`
 * comes last. Return the new number of candidates. */
static int add_candidate(cotree_assembly *a, int n, int value, int last)
{
    const int *const ranks = a->report->ranks;
    int i;
    for (i = 0; i < n; ++i) {
        if (a->candidates[i] == value) return n;
    }
    for (i = n; i > 0 && value != last; --i) {
        const int other = a->candidates[i - 1];
        if (other != last && ranks[other] >= ranks[value]) break;
        a->candidates[i] = other;
    }
    a->candidates[i] = value;
    return n + 1;
}

/* List the candidates; return their number. */
static int list_candidates(cotree_assembly *a, int last)
{
    int i, n = 0;
    for (i = 0; i < N_SPEEDS; ++i) {
        if (a->value_of[i] >= 0) n = add_candidate(a, n, a->value_of[i], last);
    }
    for (i = 0; i < a->n_own; ++i) {
        const int condition = a->places[i] - FIRST_CONDITION;
        if (condition >= 0) n = add_candidate(a, n, N_STATES + condition, last);
    }
    return n;
}

/* Return whether direction or condition i belongs to a prescribed value. */
static int belongs_to(const cotree_assembly *a, int i, int value)
{
    return i < N_SPEEDS ? a->value_of[i] == value : i - N_SPEEDS == value - N_STATES;
}

/* Compute the changes of the residuals by each motion direction, then by each condition, without
 * the parts that free directions can cancel, as the rows of a->span. Return the largest norm of a
 * candidate's changes. */
static cotree_real compute_moves(cotree_assembly *a, int n_candidates)
{
    cotree_real largest = COTREE_F(0.0);
    int i, k, r;
    a->span.rank = 0;
    a->span.n_rows = N_SPEEDS + N_CONDITIONS;
    a->span.n_columns = a->n_own;
    for (i = 0; i < a->span.n_rows; ++i) {
        cotree_real *const move = a->span.rows + i * a->n_own;
        for (r = 0; r < a->n_own; ++r) {
            move[r] = i < N_SPEEDS ? cotree_assembly_entry_of(a, a->places[r], i)
                                   : (cotree_real)(a->places[r] - FIRST_CONDITION == i - N_SPEEDS);
        }
        cotree_least_reject(&a->least, move, 1);
    }
    for (k = 0; k < n_candidates; ++k) {
        cotree_real sum = COTREE_F(0.0);
        for (i = 0; i < a->span.n_rows; ++i) {
            const cotree_real *const move = a->span.rows + i * a->n_own;
            if (!belongs_to(a, i, a->candidates[k])) continue;
            for (r = 0; r < a->n_own; ++r) sum += move[r] * move[r];
        }
        largest = COTREE_FMAX(largest, COTREE_SQRT(sum));
    }
    return largest;
}

/* Add the changes of a value, which are adjacent rows, to the span if they are outside it by more
 * than `least`. Return whether there are any. */
static int extend_span(cotree_assembly *a, int value, cotree_real least)
{
    const int rank = a->span.rank;
    int end, first = 0;
    while (!belongs_to(a, first, value)) ++first;
    for (end = first + 1; end < a->span.n_rows && belongs_to(a, end, value);) ++end;
    return cotree_least_extend(&a->span, first, end, least) > rank;
}

static void change_value(cotree_assembly *a, int value)
{
    int i;
    if (value >= N_STATES) a->is_dropped[value - N_STATES] = 1;
    for (i = 0; i < N_SPEEDS; ++i) a->is_giving[i] = a->is_giving[i] || a->value_of[i] == value;
}

static void fix_all_values(cotree_assembly *a)
{
    int i;
    for (i = 0; i < N_SPEEDS; ++i) a->is_giving[i] = 0;
    for (i = 0; i < N_CONDITIONS; ++i) a->is_dropped[i] = 0;
}

/* Choose the prescribed values that change; the gradients of the listed rows must be factorised.
 * Return whether a value was chosen. */
static int choose_values(cotree_assembly *a, int last)
{
    const int n = list_candidates(a, last);
    cotree_real least = COTREE_RANK * a->longest, largest;
    int i, pass, n_chosen = 0;
    if (a->least.rank == a->n_own) return 0;
    largest = compute_moves(a, n);
    for (i = 0; i < n; ++i) a->is_chosen[i] = 0;
    for (pass = 0; pass < 2; ++pass) {
        const cotree_real size = pass == 0 ? COTREE_FMAX(least, APART * largest) : least;
        for (i = 0; i < n; ++i) {
            if (a->is_chosen[i] || !extend_span(a, a->candidates[i], size)) continue;
            a->is_chosen[i] = 1;
            change_value(a, a->candidates[i]);
            ++n_chosen;
        }
    }
    return n_chosen > 0;
}

void cotree_assembly_factorise_given(cotree_assembly *a, cotree_real *largest)
{
    int i, r;
    for (i = 0; i < N_SPEEDS; ++i) {
        cotree_real *const column = a->given.rows + i;
        for (r = 0; r < a->n_own; ++r) {
            column[r * N_SPEEDS] =
                a->is_giving[i] ? cotree_assembly_entry_of(a, a->places[r], i) : COTREE_F(0.0);
            if (!(COTREE_FABS(column[r * N_SPEEDS]) <= *largest))
                *largest = COTREE_FABS(column[r * N_SPEEDS]); /* also true for nan */
        }
        if (a->is_giving[i]) cotree_least_reject(&a->least, column, N_SPEEDS);
    }
    cotree_least_factorise(&a->given, a->n_own, a->longest);
}

/* Solve for the changes of the prescribed values, which cancel the residuals that free directions
 * cannot cancel; then for the changes of the free directions. */
void cotree_assembly_solve_given(cotree_assembly *a)
{
    int i, r;
    cotree_assembly_copy(a->n_own, a->values, a->target);
    cotree_least_reject(&a->least, a->target, 1);
    cotree_least_solve(&a->given, a->target, a->extra);
    for (r = 0; r < a->n_own; ++r) {
        a->target[r] = a->values[r];
        for (i = 0; i < N_SPEEDS; ++i) {
            if (a->is_giving[i])
                a->target[r] += cotree_assembly_entry_of(a, a->places[r], i) * a->extra[i];
        }
    }
    cotree_least_solve(&a->least, a->target, a->step);
    for (i = 0; i < N_SPEEDS; ++i) a->step[i] += a->extra[i];
}

/* Reset x to the point before the changes, and report the residuals that cannot be cancelled. */
static int report_violation(cotree_assembly *a, cotree_real t, cotree_real *x, int level)
{
    cotree_real largest;
    int r, status;
    cotree_assembly_copy(N_STATES, a->found, x);
    a->culprit = -1;
    cotree_assembly_list_rows(a, level, 1);
    status = cotree_assembly_compute_residuals(a, t, x, &largest);
    if (status != 0) return status;
    a->report->level = level;
    for (r = 0; r < a->n_own; ++r) {
        a->report->left[a->places[r]] = a->values[r];
        if (!(COTREE_FABS(a->values[r]) < largest)) a->culprit = a->places[r];
    }
    return COTREE_ASSEMBLY_VIOLATED;
}

/* Report the changes of the prescribed values at x and the residuals of dropped conditions.
 * *is_far: 1 if one of them exceeds FARTHEST. */
static int report_changes(cotree_assembly *a, cotree_real t, const cotree_real *x, int level,
                          int *is_far)
{
    cotree_start_report *const report = a->report;
    const int first = level == 0 ? 0 : N_COORDINATES;
    const int n = level == 0 ? N_COORDINATES : N_SPEEDS;
    cotree_real unit = COTREE_F(0.0), farthest = COTREE_F(0.0), largest;
    int i, r, status;
    cotree_assembly_list_rows(a, level, 1);
    status = cotree_assembly_compute_residuals(a, t, x, &largest);
    for (i = first; i < first + n && level == 1; ++i)
        unit = COTREE_FMAX(unit, COTREE_FABS(cotree_assembly_scaled(a, x, i)));
    if (!(unit > COTREE_F(0.0))) unit = COTREE_F(1.0);
    for (i = first; i < first + n; ++i) {
        report->after[i] = x[i];
        if (!a->is_kept[i]) continue;
        report->changes[i] = COTREE_FABS(cotree_assembly_scaled(a, x, i) -
                                         cotree_assembly_scaled(a, report->before, i)) /
                             unit;
        farthest = COTREE_FMAX(farthest, report->changes[i]);
    }
    for (r = 0; r < a->n_own; ++r) {
        report->changes[N_STATES + a->places[r]] = a->values[r];
        farthest = COTREE_FMAX(farthest, COTREE_FABS(a->values[r]));
    }
    if (farthest > NOTICED) report->is_moved = 1;
    *is_far = farthest > FARTHEST;
    return status;
}

int cotree_assembly_mend(cotree_assembly *a, cotree_real t, cotree_real *x, int level,
                         cotree_real met)
{
    cotree_real largest, residual = COTREE_INFINITY;
    int i, way, is_far = 0, status = 0;
    cotree_assembly_copy(N_STATES, x, a->found);
    for (way = 0; way < 2 && status == 0 && !(residual <= met); ++way) {
        int has_way = 0;
        cotree_assembly_copy(N_STATES, a->found, x);
        cotree_assembly_list_rows(a, level, 1);
        if (way == 0) {
            status = cotree_assembly_compute_gradients(a, t, x);
            if (status != 0) break;
            cotree_assembly_factorise(a, &largest);
            has_way = choose_values(a, -1);
        } else { /* second attempt: any prescribed state may change; no condition is dropped */
            for (i = 0; i < N_SPEEDS; ++i) {
                a->is_giving[i] = a->value_of[i] >= 0;
                has_way = has_way || a->is_giving[i];
            }
        }
        if (!has_way) continue;
        cotree_assembly_list_rows(a, level, 1);
        a->has_way = 1;
        status = cotree_assembly_iterate(a, t, x, level, &residual);
        a->has_way = 0;
        fix_all_values(a);
    }
    if (status != 0) return status;
    if (!(residual <= met)) return report_violation(a, t, x, level);
    a->is_mended[level] = 1;
    if (a->is_probe) return 0;
    status = report_changes(a, t, x, level, &is_far);
    return status == 0 && is_far ? report_violation(a, t, x, level) : status;
}

/* Return the part of a row's change along a sensitivity that the step does not cancel. */
static cotree_real remainder_of(const cotree_assembly *a, int row, int column)
{
    return cotree_assembly_remainder_of(a, row, cotree_assembly_change_of(a, row, column));
}

/* Report which prescribed values change with a parameter. */
static void report_following(cotree_assembly *a, int column, cotree_real allowed)
{
    int *const follows = a->report->follows + column * (N_STATES + N_CONDITIONS);
    const cotree_real least = REMAINDER_SHARE * cotree_assembly_largest_of(a->step, N_SPEEDS);
    int i;
    a->report->is_moved = 1;
    for (i = 0; i < N_SPEEDS; ++i) {
        if (a->is_giving[i] && COTREE_FABS(a->step[i]) > least) follows[a->value_of[i]] = 1;
    }
    for (i = 0; i < N_CONDITIONS; ++i) {
        if (a->is_dropped[i] && COTREE_FABS(remainder_of(a, FIRST_CONDITION + i, column)) > allowed)
            follows[N_STATES + i] = 1;
    }
}

int cotree_assembly_follow_with_given(cotree_assembly *a, int level, int column, int seed,
                                      cotree_real allowed)
{
    cotree_start_report *const report = a->report;
    const int has_conditions = seed >= 0;
    cotree_real largest;
    int r, is_left = 0;
    allowed += REMAINDER_SHARE * cotree_assembly_largest_of(a->values, a->n_own);
    (void)choose_values(a, seed < 0 ? -1 - seed : -1);
    cotree_assembly_list_rows(a, level, has_conditions);
    for (r = 0; r < a->n_own; ++r)
        a->values[r] = cotree_assembly_change_of(a, a->places[r], column);
    cotree_assembly_factorise(a, &largest);
    cotree_assembly_factorise_given(a, &largest);
    cotree_assembly_solve_given(a);
    for (r = 0; r < a->n_own; ++r) {
        report->left[a->places[r]] = remainder_of(a, a->places[r], column);
        if (!(COTREE_FABS(report->left[a->places[r]]) <= allowed)) is_left = 1;
    }
    report->level = level;
    report->column = column;
    if (seed >= 0 && !is_left) report_following(a, column, allowed);
    fix_all_values(a);
    cotree_assembly_list_rows(a, level, has_conditions);
    cotree_assembly_factorise(a, &largest); /* restores the factors of the gradients */
    return is_left;
}
#endif
