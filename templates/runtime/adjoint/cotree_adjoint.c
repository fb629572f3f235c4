/* cotree_adjoint.c: transposed explicit Runge-Kutta steps and transposed interpolation. */
#include "cotree_adjoint.h"
#include "cotree_history.h"

#define N (a->model->n_states)
#define N_ADJOINT (a->model->n_states + a->kernels->n_sources)

/* A value within or at the end of a step. */
typedef struct reading {
    int row;      /* index of the last row of the tape that the value depends on */
    int segment;  /* segment of the run that contains the value */
    int n_points; /* number of interpolated rows; 0: the value is the result of one step from the
                     row to the time of the reading, of length zero at the end of a step */
    cotree_real of_y[COTREE_HISTORY_POINTS], of_rate[COTREE_HISTORY_POINTS];
} reading;

/* Work space of a sweep. */
typedef struct sweep {
    reading *readings; /* written by cotree_adjoint_read */
    int *order;        /* indices of the readings by segment and row */
    cotree_run run;
    cotree_history history;
    cotree_real *of_history;
    int n_read; /* row of the tape after the last one in the history */
    /* Stages of a step: points, rates, inputs, and adjoints of points and sources. */
    cotree_real *points, *rates, *inputs, *adjoints;
    cotree_real *weight;  /* adjoint of a rate */
    cotree_real *sources; /* sum of the adjoints of the sources */
    cotree_real *own;     /* adjoints of the states at the current row */
    /* Adjoints of states and rates at the last rows that interpolation has reached. */
    cotree_real *of_y[COTREE_HISTORY_POINTS], *of_rate[COTREE_HISTORY_POINTS];
    int has_rate[COTREE_HISTORY_POINTS];
} sweep;

static sweep *lay_out(const cotree_adjoint *a, cotree_arena *arena)
{
    const int n = N, n_stages = a->method->n_stages;
    sweep spare, *const s = (sweep *)cotree_arena_alloc(arena, sizeof(spare), &spare);
    int i;
    s->readings =
        (reading *)cotree_arena_alloc(arena, (size_t)a->n_readings * sizeof *s->readings, NULL);
    s->order = cotree_arena_ints(arena, a->n_readings);
    cotree_run_init(&s->run, a->model, a->p, a->k, a->u, 0, arena);
    s->of_history = cotree_arena_reals(arena, COTREE_HISTORY_WORKSPACE(n));
    s->points = cotree_arena_reals(arena, n_stages * n);
    s->rates = cotree_arena_reals(arena, n_stages * n);
    s->inputs = cotree_arena_reals(arena, n_stages * a->model->n_inputs);
    s->adjoints = cotree_arena_reals(arena, n_stages * N_ADJOINT);
    s->weight = cotree_arena_reals(arena, n);
    s->sources = cotree_arena_reals(arena, a->kernels->n_sources);
    s->own = cotree_arena_reals(arena, n);
    for (i = 0; i < COTREE_HISTORY_POINTS; ++i) {
        s->of_y[i] = cotree_arena_reals(arena, n);
        s->of_rate[i] = cotree_arena_reals(arena, n);
    }
    /* The structure may be a local variable if bytes are only counted. */
    return arena->base == NULL ? NULL : s;
}

size_t cotree_adjoint_memory(const cotree_adjoint *a)
{
    cotree_arena arena = {NULL, 0};
    (void)lay_out(a, &arena);
    return arena.used;
}

/* Lay out the memory, and clear the adjoints. */
static sweep *begin(const cotree_adjoint *a)
{
    cotree_arena arena = {NULL, 0};
    sweep *s;
    int i, k;
    arena.base = (char *)a->memory;
    s = lay_out(a, &arena);
#if COTREE_HAS_INPUTS
    s->run.n_replaced = a->n_replaced;
    s->run.replaced = a->replaced;
#endif
    s->history.n_points = 0;
    for (i = 0; i < a->kernels->n_sources; ++i) s->sources[i] = COTREE_F(0.0);
    for (k = 0; k < COTREE_HISTORY_POINTS; ++k) {
        for (i = 0; i < N; ++i) s->of_y[k][i] = s->of_rate[k][i] = COTREE_F(0.0);
        s->has_rate[k] = 0;
    }
    return s;
}

static const cotree_real *row_of(const cotree_adjoint *a, int row)
{
    return a->y + (size_t)row * (size_t)N;
}

static void enter_segment(const cotree_adjoint *a, sweep *s, int segment)
{
    const int is_open = segment == 0 && !a->is_start_sharp;
    const int is_last = segment == a->n_segments - 1 && !a->is_end_sharp;
    cotree_run_restrict(&s->run, a->breakpoints[segment], a->breakpoints[segment + 1], a->scale,
                        is_open, is_last);
}

/* Compute the stages of a step. */
static int compute_stages(const cotree_adjoint *a, sweep *s, cotree_real t, const cotree_real *y,
                          cotree_real h)
{
    const int n = N, n_inputs = a->model->n_inputs, n_stages = a->method->n_stages;
    int i, j, m, status = 0;
    for (j = 0; j < n_stages && status == 0; ++j) {
        const cotree_real *const row = a->method->stages + j * n_stages;
        cotree_real *COTREE_RESTRICT const point = s->points + j * n;
        for (i = 0; i < n; ++i) point[i] = COTREE_F(0.0);
        for (m = 0; m < j; ++m) {
            const cotree_real *COTREE_RESTRICT const rate = s->rates + m * n;
            const cotree_real weight = row[m];
            if (weight == COTREE_F(0.0)) continue;
            for (i = 0; i < n; ++i) point[i] += weight * rate[i];
        }
        for (i = 0; i < n; ++i) point[i] = y[i] + h * point[i];
        status = cotree_run_rate(t + a->method->nodes[j] * h, point, s->rates + j * n, &s->run);
        for (i = 0; i < n_inputs; ++i) s->inputs[j * n_inputs + i] = s->run.u[i];
    }
    return status;
}

/* Call a kernel in reverse mode, and add the adjoints of the sources. */
static int pull_back(const cotree_adjoint *a, sweep *s, cotree_sensitivity_kernel kernel,
                     cotree_real t, const cotree_real *x, const cotree_real *weights,
                     const cotree_real *u, cotree_real *result)
{
    const int n_sources = a->kernels->n_sources;
    const int status = kernel(t, x, weights, u, a->p, a->k, result);
    const cotree_real *COTREE_RESTRICT const of_sources = result + N;
    int i;
    for (i = 0; i < n_sources; ++i) s->sources[i] += of_sources[i];
    return status;
}

/* Transpose a step whose stages are known. On entry, to holds the adjoint of the states at its end;
 * the result is added to it. first: adjoint of the rate at the start of the step, or NULL. */
static int transpose_step(const cotree_adjoint *a, sweep *s, cotree_real t, cotree_real h,
                          const cotree_real *first, cotree_real *of_y)
{
    const cotree_explicit_method *const method = a->method;
    const int n = N, n_adjoint = N_ADJOINT, n_stages = method->n_stages;
    cotree_real *COTREE_RESTRICT const weight = s->weight;
    int i, j, m, status = 0;
    for (j = n_stages - 1; j >= 0 && status == 0; --j) {
        const cotree_real of_stage = method->solution[j];
        const cotree_real at = cotree_run_inside(&s->run, t + method->nodes[j] * h);
        for (i = 0; i < n; ++i) weight[i] = of_stage * of_y[i];
        for (m = j + 1; m < n_stages; ++m) {
            const cotree_real *COTREE_RESTRICT const later = s->adjoints + m * n_adjoint;
            const cotree_real share = method->stages[m * n_stages + j];
            if (share == COTREE_F(0.0)) continue;
            for (i = 0; i < n; ++i) weight[i] += share * later[i];
        }
        for (i = 0; i < n; ++i) weight[i] *= h;
        for (i = 0; i < n && j == 0 && first != NULL; ++i) weight[i] += first[i];
        status = pull_back(a, s, a->kernels->rates, at, s->points + j * n, weight,
                           s->inputs + j * a->model->n_inputs, s->adjoints + j * n_adjoint);
    }
    for (j = 0; j < n_stages; ++j) {
        const cotree_real *COTREE_RESTRICT const own = s->adjoints + j * n_adjoint;
        for (i = 0; i < n; ++i) of_y[i] += own[i];
    }
    return status;
}

/* Add rows of the tape to the history, so that its last rows are first ... first + n_points - 1. */
static int fill_history(const cotree_adjoint *a, sweep *s, int first, int n_points)
{
    int status = 0;
    if (s->history.n_points == 0 || first >= s->n_read) {
        cotree_history_init(&s->history, N, s->of_history);
        s->n_read = first;
    }
    for (; s->n_read < first + n_points && status == 0; ++s->n_read) {
        const cotree_real *const y = row_of(a, s->n_read);
        status = cotree_run_rate(a->t[s->n_read], y, s->rates, &s->run);
        cotree_history_add(&s->history, a->t[s->n_read], y, s->rates);
    }
    return status;
}

/* Read the states at a time between a row and the next one: interpolate as the run does, or take a
 * step from the row if the interpolation error may exceed the tolerance. */
static int read_between(const cotree_adjoint *a, sweep *s, int row, cotree_real t, reading *r,
                        cotree_real *value)
{
    const int low = a->rows[r->segment], high = a->rows[r->segment + 1];
    const int middle = COTREE_HISTORY_POINTS / 2, n = N, n_stages = a->method->n_stages;
    const cotree_real h = t - a->t[row];
    int first = row + 1 - middle, i, j, status;
    if (first + COTREE_HISTORY_POINTS > high + 1) first = high + 1 - COTREE_HISTORY_POINTS;
    if (first < low) first = low;
    r->n_points =
        COTREE_HISTORY_POINTS < high + 1 - first ? COTREE_HISTORY_POINTS : high + 1 - first;
    r->row = first + r->n_points - 1;
    status = fill_history(a, s, first, r->n_points);
    if (status != 0) return status;
    if (cotree_history_error(&s->history, row - first, a->rtol, a->atols, n, 0, value) <=
        COTREE_DOUBT(1)) {
        cotree_history_portions(&s->history, t, r->of_y, r->of_rate);
        cotree_history_read(&s->history, t, value);
        return 0;
    }
    r->row = row;
    r->n_points = 0;
    status = compute_stages(a, s, a->t[row], row_of(a, row), h);
    for (i = 0; i < n; ++i) value[i] = row_of(a, row)[i];
    for (j = 0; j < n_stages; ++j) {
        const cotree_real weight = h * a->method->solution[j];
        for (i = 0; i < n; ++i) value[i] += weight * s->rates[j * n + i];
    }
    return status;
}

/* Sort the readings by segment and last row. Insertion, because they are almost sorted. */
static void sort_readings(const cotree_adjoint *a, sweep *s)
{
    const reading *const r = s->readings;
    int j;
    for (j = 0; j < a->n_readings; ++j) {
        int i = j;
        for (; i > 0; --i) {
            const reading *const before = r + s->order[i - 1];
            if (before->segment != r[j].segment || before->row <= r[j].row) break;
            s->order[i] = s->order[i - 1];
        }
        s->order[i] = j;
    }
}

int cotree_adjoint_read(cotree_adjoint *a)
{
    sweep *const s = begin(a);
    const cotree_real ahead =
        a->breakpoints[a->n_segments] > a->breakpoints[0] ? COTREE_F(1.0) : -COTREE_F(1.0);
    int i, j, row = 0, segment = 0, status = 0;
    enter_segment(a, s, 0);
    for (j = 0; j < a->n_readings && status == 0; ++j) {
        const cotree_real t = a->times[j];
        cotree_real *const value = a->values + (size_t)j * (size_t)N;
        reading *const r = s->readings + j;
        /* A value at a breakpoint belongs to the segment before it. */
        while (segment < a->n_segments - 1 && ahead * (t - a->breakpoints[segment + 1]) > 0) {
            enter_segment(a, s, ++segment);
            s->history.n_points = 0;
        }
        while (row < a->rows[segment + 1] && ahead * (t - a->t[row + 1]) >= 0) ++row;
        r->row = row;
        r->segment = segment;
        r->n_points = 0;
        if (t == a->t[row]) {
            for (i = 0; i < N; ++i) value[i] = row_of(a, row)[i];
        } else {
            status = read_between(a, s, row, t, r, value);
        }
    }
    if (status == 0) sort_readings(a, s);
    return status;
}

/* Add the adjoint of a reading to those of the rows that its value depends on. */
static int transpose_reading(const cotree_adjoint *a, sweep *s, int j)
{
    const reading *const r = s->readings + j;
    const cotree_real *const x = a->values + (size_t)j * (size_t)N;
    const cotree_real *const weights = a->weights + (size_t)j * (size_t)a->model->n_outputs;
    const cotree_real t = a->times[j];
    const int n = N;
    cotree_real *COTREE_RESTRICT const found = s->adjoints;
    cotree_real rest = COTREE_F(1.0);
    int i, k, status = cotree_run_inputs(&s->run, cotree_run_inside(&s->run, t));
    if (status == 0) status = pull_back(a, s, a->kernels->outputs, t, x, weights, s->run.u, found);
    if (status != 0) return status;
    if (r->n_points == 0) {
        cotree_real *const own = s->of_y[r->row % COTREE_HISTORY_POINTS];
        const cotree_real h = t - a->t[r->row];
        if (h == COTREE_F(0.0)) {
            for (i = 0; i < n; ++i) own[i] += found[i];
            return 0;
        }
        for (i = 0; i < n; ++i) s->own[i] = found[i];
        status = compute_stages(a, s, a->t[r->row], row_of(a, r->row), h);
        if (status == 0) status = transpose_step(a, s, a->t[r->row], h, NULL, s->own);
        for (i = 0; i < n; ++i) own[i] += s->own[i];
        return status;
    }
    for (k = 0; k < r->n_points; ++k) {
        const int place = (r->row - r->n_points + 1 + k) % COTREE_HISTORY_POINTS;
        const int is_last = k == r->n_points - 1;
        /* The polynomial adds differences from the last point. */
        const cotree_real of_y = is_last ? rest : r->of_y[k], of_rate = r->of_rate[k];
        cotree_real *COTREE_RESTRICT const y = s->of_y[place];
        cotree_real *COTREE_RESTRICT const rate = s->of_rate[place];
        for (i = 0; i < n; ++i) {
            y[i] += of_y * found[i];
            rate[i] += of_rate * found[i];
        }
        s->has_rate[place] = 1;
        rest -= of_y;
    }
    return 0;
}

/* Add the adjoint of the states at a row, and clear its place for an earlier row. */
static void collect_row(const cotree_adjoint *a, sweep *s, int place)
{
    int i;
    for (i = 0; i < N; ++i) {
        a->states[i] += s->of_y[place][i];
        s->of_y[place][i] = s->of_rate[place][i] = COTREE_F(0.0);
    }
    s->has_rate[place] = 0;
}

static int sweep_segment(cotree_adjoint *a, sweep *s, int segment, int *n_left)
{
    const int low = a->rows[segment], high = a->rows[segment + 1];
    int row, i, status = 0;
    enter_segment(a, s, segment);
    for (row = high; row >= low && status == 0; --row) {
        const int place = row % COTREE_HISTORY_POINTS;
        while (*n_left > 0 && status == 0) {
            const reading *const r = s->readings + s->order[*n_left - 1];
            if (r->segment != segment || r->row != row) break;
            status = transpose_reading(a, s, s->order[--*n_left]);
        }
        if (status == 0 && row < high) {
            const cotree_real h = a->t[row + 1] - a->t[row];
            const cotree_real *const first = s->has_rate[place] ? s->of_rate[place] : NULL;
            status = compute_stages(a, s, a->t[row], row_of(a, row), h);
            if (status == 0) status = transpose_step(a, s, a->t[row], h, first, a->states);
        } else if (status == 0 && s->has_rate[place]) {
            /* No step begins at the last row, so the adjoint of the rate there is separate. */
            const cotree_real at = cotree_run_inside(&s->run, a->t[row]);
            status = cotree_run_inputs(&s->run, at);
            if (status == 0) {
                status = pull_back(a, s, a->kernels->rates, at, row_of(a, row), s->of_rate[place],
                                   s->run.u, s->adjoints);
            }
            for (i = 0; i < N; ++i) a->states[i] += s->adjoints[i];
        }
        collect_row(a, s, place);
    }
    return status;
}

/* Convert the adjoints of the initial states and of the sources to those of the parameters. */
static int finish(const cotree_adjoint *a, sweep *s)
{
    const cotree_real t = a->breakpoints[0];
    int i, status = cotree_run_inputs(&s->run, cotree_run_inside(&s->run, t));
    for (i = 0; i < N; ++i) s->weight[i] = a->is_free[i] ? a->states[i] : COTREE_F(0.0);
    if (status == 0) {
        status =
            pull_back(a, s, a->kernels->initial, t, row_of(a, 0), s->weight, s->run.u, s->adjoints);
    }
    if (status != 0 || a->kernels->n_parameters == 0) return status;
    return a->kernels->sources(t, row_of(a, 0), s->sources, s->run.u, a->p, a->k, a->parameters);
}

int cotree_adjoint_sweep(cotree_adjoint *a)
{
    sweep *const s = begin(a);
    int i, segment, n_left = a->n_readings, status = 0;
    for (i = 0; i < N; ++i) a->states[i] = COTREE_F(0.0);
    for (segment = a->n_segments - 1; segment >= 0 && status == 0; --segment) {
        status = sweep_segment(a, s, segment, &n_left);
    }
    return status == 0 ? finish(a, s) : status;
}
