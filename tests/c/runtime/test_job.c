/* test_job.c: a job through breakpoints of an input, with wanted points, some steps at a time. */
#include "cotree_breakpoints.h"
#include "cotree_dopri5.h"
#include "cotree_job.h"

#include "check.h"

#include <float.h>
#include <stdlib.h>

/* Steps with constant rates are exact but for rounding; values within them are as good as rtol and
 * atol, since interpolation through steps of very different lengths magnifies rounding. */
#define TOLERANCE 1e-13
#define INTERPOLATED 2e-9

/* The input is 1, from 0.3 on -2, from 0.8 on 0. */
static int inputs(double t, const double *p, const double *k, double *u)
{
    (void)p, (void)k;
    u[0] = t < 0.3 ? 1.0 : t < 0.8 ? -2.0 : 0.0;
    return 0;
}

static int rhs(double t, const double *x, const double *u, const double *p, const double *k,
               double *dx)
{
    (void)t, (void)x, (void)p, (void)k;
    dx[0] = u[0];
    return 0;
}

static double solution(double t)
{
    return t < 0.3 ? t : t < 0.8 ? 0.3 - 2.0 * (t - 0.3) : -0.7;
}

static const int sensitivity_starts[1] = {0};
static const cotree_real rows[2][3] = {{0.3, 0.0, 0.0}, {0.8, 0.0, 0.0}};

static cotree_model integrator(void)
{
    cotree_model model = {0};
    model.n_states = 1;
    model.n_inputs = 1;
    model.sensitivity_starts = sensitivity_starts;
    model.inputs_of_time = inputs;
    model.rhs = rhs;
    return model;
}

/* Runs to the end, most_steps at a time, and compares all points that are kept. */
static void check_run(const double *wanted, int n_wanted, long most_steps)
{
    static double times[1000], values[1000];
    const cotree_model model = integrator();
    const cotree_breakpoints breakpoints = {2, 0, rows[0]};
    const cotree_real atol = 1e-9;
    cotree_real ends[8], u[1], z[1] = {0.0};
    cotree_job job = {0};
    size_t size;
    int i, n_calls = 0, result = COTREE_JOB_MORE;
    for (ends[0] = 0.0; ends[job.n_breakpoints++] < 1.0;) {
        ends[job.n_breakpoints] = cotree_next_breakpoint(&breakpoints, ends[job.n_breakpoints - 1], 1.0);
    }
    CHECK(job.n_breakpoints == 4);
    job.model = &model;
    job.u = u;
    job.stepper = cotree_dopri5_stepper();
    job.n = 1;
    job.rtol = 1e-9;
    job.atol = atol;
    job.atols = &atol;
    job.max_step = DBL_MAX;
    job.breakpoints = ends;
    job.scale = cotree_largest_breakpoint(&breakpoints, 1.0);
    job.n_wanted = n_wanted;
    job.wanted = wanted;
    job.times = times;
    job.values = values;
    job.z = z;
    size = cotree_job_memory(&job);
    job.memory = calloc(1, size);
    for (; result == COTREE_JOB_MORE && n_calls < 1000; ++n_calls) {
        result = cotree_job_run(&job, most_steps);
    }
    CHECK(result == COTREE_JOB_DONE);
    CHECK(n_calls >= job.n_steps / most_steps);
    CHECK(job.n_rejected == 0); /* breakpoints are ends of steps */
    CHECK(cotree_job_memory(&job) == size);
    CHECK_NEAR(job.t, 1.0, 0.0);
    CHECK_NEAR(z[0], solution(1.0), TOLERANCE);
    CHECK(n_wanted == 0 || job.n_kept == n_wanted);
    for (i = 0; i < job.n_kept; ++i) {
        if (n_wanted > 0) CHECK_NEAR(times[i], wanted[i], 0.0);
        CHECK_NEAR(values[i], solution(times[i]), n_wanted > 0 ? INTERPOLATED : TOLERANCE);
    }
    cotree_job_end(&job);
    free(job.memory);
}

int main(void)
{
    const double wanted[6] = {0.0, 0.1, 0.3, 0.55, 0.8, 1.0};
    check_run(NULL, 0, 1000);
    check_run(wanted, 6, 1000);
    check_run(wanted, 6, 1);
    return RESULT;
}
