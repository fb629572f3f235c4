/* cotree_breakpoints.c: time events, at which functions of time have a kink or a jump. */
#include "cotree_breakpoints.h"

/* Relative tolerance of times: a few rounding errors. */
#define SLACK (COTREE_F(16.0) * COTREE_EPSILON)

/* Return the table row of a breakpoint series. */
static const cotree_real *row_of(const cotree_breakpoints *breakpoints, int i)
{
    return breakpoints->rows + i * (3 + 2 * breakpoints->n_sensitivities);
}

cotree_real cotree_next_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t,
                                   cotree_real t_end)
{
    const cotree_real ahead = t_end > t ? COTREE_F(1.0) : -COTREE_F(1.0);
    /* Breakpoints at t itself and at the end are excluded. */
    const cotree_real slack = SLACK * COTREE_FABS(t), last = COTREE_FABS(t_end) <= COTREE_MAX
                                                                 ? SLACK * COTREE_FABS(t_end)
                                                                 : COTREE_F(0.0);
    cotree_real next = t_end;
    int i;
    for (i = 0; i < breakpoints->n; ++i) {
        const cotree_real *const row = row_of(breakpoints, i);
        const cotree_real period = row[1];
        cotree_real at = row[0];
        if (!(COTREE_FABS(at) <= COTREE_MAX)) continue;
        if (period > COTREE_F(0.0)) {
            cotree_real k =
                ahead * (COTREE_FLOOR((ahead * (t - at) + slack) / period) + COTREE_F(1.0));
            if (row[2] * k < COTREE_F(0.0)) {
                if (ahead * row[2] < COTREE_F(0.0)) continue;
                k = COTREE_F(0.0);
            }
            at += k * period;
        }
        if (ahead * (at - t) > slack && ahead * (next - at) > COTREE_FMAX(slack, last)) next = at;
    }
    return next;
}

cotree_real cotree_largest_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t_end)
{
    cotree_real largest = COTREE_FABS(t_end);
    int i;
    for (i = 0; i < breakpoints->n; ++i) {
        const cotree_real *const row = row_of(breakpoints, i);
        if (row[1] > COTREE_F(0.0)) largest = COTREE_FMAX(largest, COTREE_FABS(row[0]));
    }
    return largest;
}

/* Return whether a series has a breakpoint at t. *k is the number of periods since its first
 * one. */
static int is_at(const cotree_real *row, cotree_real t, cotree_real *k)
{
    *k = COTREE_F(0.0);
    if (!(COTREE_FABS(row[0]) <= COTREE_MAX)) return 0;
    if (row[1] > COTREE_F(0.0)) *k = COTREE_FLOOR((t - row[0]) / row[1] + COTREE_F(0.5));
    if (row[2] * *k < COTREE_F(0.0)) *k = COTREE_F(0.0);
    return COTREE_FABS(row[0] + *k * row[1] - t) <= SLACK * COTREE_FABS(t);
}

int cotree_is_breakpoint(const cotree_breakpoints *breakpoints, cotree_real t)
{
    cotree_real k;
    int i, found = 0;
    for (i = 0; i < breakpoints->n; ++i) found = found || is_at(row_of(breakpoints, i), t, &k);
    return found;
}

void cotree_find_breakpoint_slopes(const cotree_breakpoints *breakpoints, cotree_real t,
                                   int is_start, cotree_real *slopes, cotree_real *spreads)
{
    int i, j, is_first = !is_start;
    for (j = 0; j < breakpoints->n_sensitivities; ++j) slopes[j] = spreads[j] = COTREE_F(0.0);
    for (i = 0; i < breakpoints->n; ++i) {
        const cotree_real *const row = row_of(breakpoints, i);
        cotree_real k;
        if (!is_at(row, t, &k)) continue;
        for (j = 0; j < breakpoints->n_sensitivities; ++j) {
            const cotree_real own = row[3 + 2 * j] + k * row[4 + 2 * j];
            const cotree_real difference = COTREE_FABS(own - slopes[j]);
            if (is_first) {
                slopes[j] = own;
            } else if (difference > SLACK * COTREE_FABS(own)) {
                spreads[j] = COTREE_FMAX(spreads[j], difference);
            }
        }
        is_first = 0;
    }
}

#if COTREE_HAS_STEPS
cotree_real cotree_shortest_period(const cotree_breakpoints *breakpoints)
{
    cotree_real shortest = COTREE_F(0.0);
    int i;
    for (i = 0; i < breakpoints->n; ++i) {
        const cotree_real period = row_of(breakpoints, i)[1];
        if (period > COTREE_F(0.0) && (shortest == COTREE_F(0.0) || period < shortest))
            shortest = period;
    }
    return shortest;
}

/* Return the number of breakpoints of a series from t to t_end. It may exceed the range of int. */
static cotree_real count_of(const cotree_real *row, cotree_real t, cotree_real t_end)
{
    cotree_real low = COTREE_FMIN(t, t_end), high = COTREE_FMAX(t, t_end);
    if (!(COTREE_FABS(row[0]) <= COTREE_MAX)) return COTREE_F(0.0);
    if (!(row[1] > COTREE_F(0.0))) return COTREE_F(1.0);
    if (row[2] > COTREE_F(0.0)) low = COTREE_FMAX(low, row[0]);
    if (row[2] < COTREE_F(0.0)) high = COTREE_FMIN(high, row[0]);
    return high < low ? COTREE_F(0.0) : COTREE_FLOOR((high - low) / row[1]) + COTREE_F(1.0);
}

int cotree_most_breakpoints(const cotree_breakpoints *breakpoints, cotree_real t, cotree_real t_end)
{
    const cotree_real width = (cotree_real)(1 + 2 * breakpoints->n_sensitivities);
    cotree_real total = COTREE_F(0.0);
    int i;
    for (i = 0; i < breakpoints->n; ++i) {
        const cotree_real n = count_of(row_of(breakpoints, i), t, t_end);
        /* Allow one more, because the count may include a breakpoint at an end. */
        if (!(n <= (cotree_real)COTREE_MOST_OF_SERIES + COTREE_F(1.0))) return -1;
        total += n;
    }
    if (total > (cotree_real)COTREE_MOST_BREAKPOINTS ||
        total * width > (cotree_real)COTREE_MOST_BREAKPOINT_NUMBERS)
        return -1;
    return 2 + breakpoints->n + (int)total;
}

int cotree_list_breakpoints(const cotree_breakpoints *breakpoints, cotree_real t, cotree_real t_end,
                            cotree_real *times)
{
    int n = 0;
    times[n++] = t;
    while (t != t_end) {
        t = cotree_next_breakpoint(breakpoints, t, t_end);
        times[n++] = t;
    }
    return n;
}

void cotree_job_set_breakpoints(cotree_job *job, const cotree_breakpoints *breakpoints,
                                cotree_real t, cotree_real t_end, cotree_real begin,
                                const cotree_real *sizes, const int *seeds, cotree_real *memory,
                                cotree_real *tolerances)
{
    const int n = cotree_list_breakpoints(breakpoints, t, t_end, memory);
#if COTREE_HAS_MOVING_BREAKPOINTS
    const int m = breakpoints->n_sensitivities;
    cotree_real *const slopes = memory + n, *const spreads = slopes + n * m, least = COTREE_F(1.0);
    int i;
    for (i = 0; i < n; ++i)
        cotree_find_breakpoint_slopes(breakpoints, memory[i], memory[i] == begin, slopes + i * m,
                                      spreads + i * m);
    for (i = 0; sizes != NULL && i < job->model->n_states; ++i)
        least = COTREE_FMIN(least, sizes[i]);
    for (i = 0; i < m; ++i) tolerances[i] = least * cotree_job_sensitivity_atol(job, seeds[i]);
    job->slopes = slopes;
    job->spreads = spreads;
    job->turn_tolerances = tolerances;
#else
    (void)begin, (void)sizes, (void)seeds, (void)tolerances;
#endif
    job->breakpoints = memory;
    job->n_breakpoints = n;
    job->scale = cotree_largest_breakpoint(breakpoints, t_end);
    job->is_start_sharp = cotree_is_breakpoint(breakpoints, t);
    job->is_end_sharp = cotree_is_breakpoint(breakpoints, t_end);
}
#endif
