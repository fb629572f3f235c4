/* fmu_times.c: time events of an instance.
 * Part of the runtime of cotree, the same for every model. */
#include "fmu.h"

#include "cotree_breakpoints.h"

#include <float.h>
#include <math.h>

/* Write the rows of time events, with positive periods, or zero for a single time. */
int fmu_find_stops(fmu *m)
{
    const int n_sensitivities = m->model->n_sensitivities, width = 2 + 2 * n_sensitivities;
    double *const rows = m->stops + m->tables->n_limits;
    int i, j;
    if (m->tables->find_stops == NULL) return 0;
    if (m->tables->find_stops(m->p, m->k, m->stops) != 0) {
        return fmu_refuse(m, "the times of corners have no values");
    }
    /* Backwards, since a row is longer than the kernel's result. */
    for (i = m->tables->n_stops - 1; i >= 0; --i) {
        const double *const found = rows + i * width;
        double *const row = rows + i * (width + 1);
        const double first = found[0], period = found[1], sign = period < 0.0 ? -1.0 : 1.0;
        const int is_once = !(fabs(period) <= DBL_MAX) || period == 0.0;
        for (j = 2 * n_sensitivities - 1; j >= 0; --j) row[3 + j] = found[2 + j];
        for (j = 0; j < n_sensitivities; ++j) row[4 + 2 * j] *= is_once ? 0.0 : sign;
        row[2] = sign * (double)m->tables->stop_starts[i];
        row[1] = is_once ? 0.0 : fabs(period);
        row[0] = first;
    }
    return 0;
}

static cotree_breakpoints stops_of(const fmu *m)
{
    cotree_breakpoints own;
    own.n = m->tables->n_stops;
    own.n_sensitivities = m->model->n_sensitivities;
    own.rows = m->stops + m->tables->n_limits;
    return own;
}

double fmu_next_stop(const fmu *m, double t, double end)
{
    const cotree_breakpoints own = stops_of(m);
    return cotree_next_breakpoint(&own, t, end);
}

int fmu_is_stop(const fmu *m, double t)
{
    const cotree_breakpoints own = stops_of(m);
    return cotree_is_breakpoint(&own, t);
}

void fmu_stop_slopes(const fmu *m, double t, int is_start, double *slopes, double *spreads)
{
    const cotree_breakpoints own = stops_of(m);
    cotree_find_breakpoint_slopes(&own, t, is_start, slopes, spreads);
}

double fmu_largest_stop(const fmu *m, double end)
{
    const cotree_breakpoints own = stops_of(m);
    return cotree_largest_breakpoint(&own, end);
}
