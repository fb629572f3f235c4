/* test_events.c: zeros of a cubic that lie within one step are located, and the last one ends the
 * run. */
#include "cotree_dopri5.h"
#include "cotree_events.h"
#include "cotree_job.h"

#include "check.h"

#include <float.h>
#include <stdlib.h>

/* Zeros are located to a few roundings of the time. */
#define TOLERANCE 1e-12

#define N_EVENTS 2
#define RECORD COTREE_EVENTS_RECORD(1, 0)
#define MOST_RECORDS (COTREE_EVENTS_AT_ONCE(N_EVENTS) + 4) /* without waiting for more room */

/* x' = 1: x is the time. */
static int rhs(double t, const double *x, const double *u, const double *p, const double *k,
               double *dx)
{
    (void)t, (void)x, (void)u, (void)p, (void)k;
    dx[0] = 1.0;
    return 0;
}

/* (x + 2) (x - 1) (x - 1.01) and x - 5; then the quantity x, of which the cubic is a function. */
static int events(double t, const double *x, const double *u, const double *p, const double *k,
                  double *g)
{
    (void)t, (void)u, (void)p, (void)k;
    g[0] = (x[0] + 2.0) * (x[0] - 1.0) * (x[0] - 1.01);
    g[1] = x[0] - 5.0;
    g[2] = x[0];
    return 0;
}

/* Their time derivatives, where s holds those of the states. */
static int event_rates(double t, const double *x, const double *s, const double *u, const double *p,
                       const double *k, double *dg)
{
    const double a = x[0] + 2.0, b = x[0] - 1.0, c = x[0] - 1.01;
    (void)t, (void)u, (void)p, (void)k;
    dg[0] = (b * c + a * c + a * b) * s[0];
    dg[1] = s[0];
    return 0;
}

/* Multiplies an interval by another one, in place. */
static void multiply(double a[2], double low, double high)
{
    const double b = a[0] * low, c = a[0] * high, d = a[1] * low, e = a[1] * high;
    a[0] = fmin(fmin(b, c), fmin(d, e));
    a[1] = fmax(fmax(b, c), fmax(d, e));
}

/* Bounds of the cubic and of its rate; s: least x, largest x, least and largest rate of x. */
static int ranges(double t, const double *x, const double *s, const double *u, const double *p,
                  const double *k, double *r)
{
    const double roots[3] = {-2.0, 1.0, 1.01};
    int i, j;
    (void)t, (void)x, (void)u, (void)p, (void)k;
    r[0] = r[1] = 1.0;
    r[2] = r[3] = 0.0;
    for (i = 0; i < 3; ++i) {
        double product[2] = {1.0, 1.0};
        multiply(r, s[0] - roots[i], s[1] - roots[i]);
        for (j = 0; j < 3; ++j) {
            if (j != i) multiply(product, s[0] - roots[j], s[1] - roots[j]);
        }
        r[2] += product[0];
        r[3] += product[1];
    }
    multiply(r + 2, s[2], s[3]);
    return 0;
}

static const int sensitivity_starts[1] = {0};
static const cotree_event rows[N_EVENTS] = {
    {"cubic", 0, 0, 0, 0, 0, 0, NULL, 0, 0},
    {"end", 1, 1, 0, 0, 0, 0, NULL, 0, -1},
};

int main(void)
{
    static cotree_real records[MOST_RECORDS * RECORD];
    static cotree_real times[1000], values[1000];
    const cotree_real ends[2] = {0.0, 9.0}, atol = 1e-6;
    cotree_hybrid hybrid = {0};
    cotree_model model = {0};
    cotree_job job = {0};
    cotree_real z[1] = {0.0};
    int i, n_between = 0;
    hybrid.n_events = N_EVENTS;
    hybrid.n_ranges = hybrid.n_quantities = 1;
    hybrid.events = rows;
    model.n_states = 1;
    model.sensitivity_starts = sensitivity_starts;
    model.rhs = rhs;
    model.events = events;
    model.event_rates = event_rates;
    model.event_ranges = ranges;
    model.hybrid = &hybrid;
    job.model = &model;
    job.stepper = cotree_dopri5_stepper();
    job.n = 1;
    job.rtol = job.atol = atol;
    job.atols = &atol;
    job.max_step = DBL_MAX;
    job.breakpoints = ends;
    job.n_breakpoints = 2;
    job.times = times;
    job.values = values;
    job.z = z;
    job.records = records;
    job.most_records = MOST_RECORDS;
    job.memory = calloc(1, cotree_job_memory(&job));
    CHECK(cotree_job_run(&job, 100) == COTREE_JOB_STOPPED);
    CHECK(job.event == 1);
    CHECK(job.n_records == 3);
    CHECK_NEAR(records[0], 1.0, TOLERANCE);
    CHECK_NEAR(records[1], 0.0, 0.0);
    CHECK_NEAR(records[RECORD], 1.01, TOLERANCE);
    CHECK_NEAR(records[2 * RECORD], 5.0, TOLERANCE);
    CHECK_NEAR(records[2 * RECORD + 1], 1.0, 0.0);
    CHECK_NEAR(z[0], 5.0, TOLERANCE);
    /* The only points between the zeros are the zeros themselves. */
    for (i = 0; i < job.n_kept; ++i) n_between += times[i] > 1.0001 && times[i] < 1.0099;
    CHECK(n_between == 0);
    cotree_job_end(&job);
    free(job.memory);
    return RESULT;
}
