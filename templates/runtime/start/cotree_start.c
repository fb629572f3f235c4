/* cotree_start.c: initial values, constraints and checks at the start. */
#include "cotree_start_internal.h"

#include <string.h>

/* A redundant value agrees with the value that the states determine if their difference is at most
 * AGREED times the largest of these states, or is a rounding error. */
#define AGREED COTREE_SELECT(1e-8, 3.5e-04f)
#define ROUNDED COTREE_SELECT(1e-12, 1e-05f)

/* Step of finite differences, as a fraction of the parameter's magnitude or of LEAST_SIZE, if that
 * is larger. The truncation error, of fourth order, is then as small as rounding errors. */
#define SHARE COTREE_SELECT(1e-3, 5e-02f)
#define LEAST_SIZE COTREE_F(1e-3)

void cotree_start_init(cotree_start *start, cotree_run *run, const cotree_start_tables *tables,
                       cotree_arena *arena)
{
    const cotree_model *const model = run->model;
    const int m = run->n_blocks - 1;
    memset(start, 0, sizeof *start);
    start->run = run;
    start->tables = tables;
    start->culprit = start->column = -1;
    start->is_set = cotree_arena_ints(arena, model->n_states);
    start->given = cotree_arena_reals(arena, model->n_states);
    start->w = cotree_arena_reals(arena, run->n_full);
    if (tables->n_contents > 0) {
        start->is_found = cotree_arena_ints(arena, tables->n_contents);
        start->rates = cotree_arena_reals(arena, run->n_full);
        start->given_slopes = cotree_arena_reals(arena, run->n_full);
    }
#if COTREE_HAS_ALGEBRAIC
    start->pivots = cotree_arena_ints(arena, 2 * model->n_algebraic);
#endif
    if (tables->assembly != NULL) {
        cotree_assembly_init(&start->assembly, run, tables->assembly, arena);
    }
    if (tables->assembly != NULL && m > 0) {
        start->moved = cotree_arena_reals(arena, 2 * model->n_states);
        start->moved_p = cotree_arena_reals(arena, model->n_parameters);
        start->moved_k = cotree_arena_reals(arena, model->n_prepared);
    }
#if COTREE_HAS_EVENTS
    if (model->hybrid != NULL) {
        const cotree_hybrid *const h = model->hybrid;
        start->event_values =
            cotree_arena_reals(arena, h->n_events + h->n_branches + h->n_quantities);
        start->new_values = cotree_arena_reals(arena, h->n_jumps);
        start->sides = cotree_arena_reals(arena, 3 * model->n_states);
        start->event_slopes = cotree_arena_reals(arena, m * (h->n_events + h->n_jumps));
    }
#endif
}

/* Initial values. */

/* Write the prescribed initial values, and guesses for all other states. */
static int write_states(const cotree_start *start, cotree_real *z)
{
    const cotree_run *const run = start->run;
    int i, status = 0;
    if (start->initial == NULL) status = MODEL->initial(run->p, run->k, z);
    for (i = 0; i < N_STATES && start->initial != NULL; ++i) z[i] = start->initial[i];
    if (start->guess != NULL) {
        for (i = N_RATES; i < N_STATES; ++i) z[i] = start->guess[i];
#if COTREE_HAS_EVENTS
        for (i = 0; MODEL->hybrid != NULL && i < MODEL->hybrid->n_events; ++i) {
            const cotree_event *const row = MODEL->hybrid->events + i;
            if (row->kind > COTREE_JUMP && row->n_targets > 0)
                z[row->targets[0]] = start->guess[row->targets[0]];
        }
#endif
    }
    for (i = 0; i < start->n_set && status == 0; ++i) z[start->set[i]] = start->values[i];
    return status;
}

#if COTREE_HAS_SENSITIVITIES
/* Write the sensitivities of the initial values. A value that is set for the run depends only on
 * itself. */
static int write_sensitivities(const cotree_start *start, cotree_real *s)
{
    const cotree_run *const run = start->run;
    int i, j, status = 0;
    if (start->initial != NULL) {
        for (i = N_STATES; i < run->n_full; ++i) s[i - N_STATES] = start->initial[i];
        return 0;
    }
    if (N_STATES > 0) status = MODEL->initial_sensitivity(run->p, run->k, s);
    for (i = 0; i < start->n_set && status == 0; ++i) {
        const int state = start->set[i];
        for (j = 0; j < N_SENSITIVITIES; ++j) {
            const int is_own = start->tables->seeds[j] == -1 - state;
            s[j * N_STATES + state] = is_own ? COTREE_F(1.0) : COTREE_F(0.0);
        }
    }
    return status;
}
#endif

/* The constraints. */

/* Mark the prescribed states: those whose initial value the model or the run prescribes, and those
 * to which sensitivities are taken. */
static void mark_kept(cotree_start *start)
{
    int i;
    for (i = 0; i < N_STATES; ++i) start->is_set[i] = 0;
    for (i = 0; i < start->n_set; ++i) start->is_set[start->set[i]] = 1;
    if (start->tables->assembly == NULL) return;
    for (i = 0; i < N_STATES; ++i)
        start->assembly.is_kept[i] = start->tables->given[i] || start->is_set[i];
    for (i = 0; i < N_SENSITIVITIES; ++i) {
        const int seed = start->tables->seeds[i];
        if (seed < 0) start->assembly.is_kept[-1 - seed] = 1;
    }
    cotree_assembly_hold(&start->assembly, start->is_set);
}

/* Project the states onto the constraints, which depend on inputs of the model or of an input
 * function, but not on inputs replaced by tables. */
static int project_states(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_assembly *const a = &start->assembly;
    const cotree_run *const run = start->run;
    int status = 0;
    a->culprit = a->column = -1;
    if (MODEL->n_inputs > 0) status = MODEL->inputs_of_time(t, run->p, run->k, run->u);
#if COTREE_HAS_INPUTS
    if (status == 0 && run->input_function != NULL)
        status = run->input_function(t, run->u, run->input_context);
#endif
    if (status == 0) status = cotree_assembly_normalise(a, z);
    if (status == 0) status = cotree_assembly_measure(a, t, z);
    return status == 0 ? cotree_assembly_move(a, t, z) : status;
}

#if COTREE_HAS_SENSITIVITIES
/* Compute the projected states with the parameter or initial value of a sensitivity increased by a
 * step. */
static int project_perturbed(cotree_start *start, cotree_real t, int column, cotree_real value,
                             cotree_real step, cotree_real *x)
{
    cotree_run *const run = start->run;
    const cotree_real *const p = run->p, *const k = run->k;
    const int seed = start->tables->seeds[column];
    int i, status = 0;
    if (seed >= 0) {
        for (i = 0; i < MODEL->n_parameters; ++i) start->moved_p[i] = p[i];
        start->moved_p[seed] = value + step;
        status = MODEL->prepare(start->moved_p, start->moved_k);
        run->p = start->moved_p;
        run->k = start->moved_k;
    }
    if (status == 0) status = write_states(start, x);
    for (i = 0; i < N_STATES && start->initial != NULL; ++i)
        x[i] += step * start->initial[(1 + column) * N_STATES + i];
    if (seed < 0) x[-1 - seed] = value + step;
#if COTREE_HAS_MENDING
    start->assembly.is_probe = 1;
#endif
    if (status == 0) status = project_states(start, t, x);
#if COTREE_HAS_MENDING
    start->assembly.is_probe = 0;
#endif
    run->p = p;
    run->k = k;
    return status;
}

/* Differentiate an ambiguous projection by five-point differences: it depends on the parameters
 * through gradients, whose derivatives no kernel computes. */
static int take_differences(cotree_start *start, cotree_real t, cotree_real *z)
{
    static const cotree_real weights[] = {COTREE_F(1.0), -COTREE_F(8.0), COTREE_F(8.0),
                                          -COTREE_F(1.0)};
    static const int places[] = {-2, -1, 1, 2};
    const int *const starts = MODEL->sensitivity_starts, *const rows = MODEL->sensitivity_rows;
    cotree_real *const x = start->moved, *const total = x + N_STATES;
    int i, j, k, status = 0;
    for (j = 0; j < N_SENSITIVITIES && status == 0; ++j) {
        const int seed = start->tables->seeds[j];
        const cotree_real value = seed < 0 ? z[-1 - seed] : start->run->p[seed];
        const cotree_real least = seed < 0 ? COTREE_F(1.0) : LEAST_SIZE;
        const cotree_real step = SHARE * COTREE_FMAX(COTREE_FABS(value), least);
        cotree_real *const s = z + (1 + j) * N_STATES;
        for (i = 0; i < N_STATES; ++i) total[i] = s[i] = COTREE_F(0.0);
        for (k = 0; k < 4 && status == 0; ++k) {
            status = project_perturbed(start, t, j, value, (cotree_real)places[k] * step, x);
            for (i = 0; i < N_STATES; ++i) total[i] += weights[k] * x[i];
        }
        for (i = starts[j]; i < starts[j + 1]; ++i)
            s[rows[i]] = total[rows[i]] / (COTREE_F(12.0) * step);
    }
    return status;
}
#endif

static int satisfy_constraints(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_assembly *const a = &start->assembly;
    int i, status;
    for (i = 0; i < N_STATES; ++i) start->given[i] = z[i];
    status = project_states(start, t, z);
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && N_SENSITIVITIES > 0)
        status = cotree_assembly_move_sensitivities(a, t, z, start->tables->seeds, z + N_STATES);
#endif
    if (status == 0) status = cotree_assembly_normalise(a, start->given);
    if (status == 0) start->is_chosen = cotree_assembly_is_chosen(a, t, start->given, z);
    start->culprit = a->culprit;
    start->column = a->column;
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && start->is_chosen && N_SENSITIVITIES > 0)
        status = take_differences(start, t, z);
#endif
    return status;
}

/* Checks. */

/* Return whether a redundant value, or its derivative with respect to a parameter of this
 * magnitude, agrees with the value determined by the states x. */
static int is_agreed(const cotree_start *start, int row, const cotree_real *values,
                     const cotree_real *x, cotree_real parameter)
{
    const cotree_start_tables *const tables = start->tables;
    const cotree_real follows = parameter * values[row];
    const cotree_real given = parameter * values[tables->n_redundant + row];
    cotree_real size = COTREE_FMAX(COTREE_FABS(follows), COTREE_FABS(given));
    int i;
    for (i = tables->redundant_starts[row]; i < tables->redundant_starts[row + 1]; ++i) {
        const int state = tables->redundant_states[i];
        if (start->is_set[state]) return 1; /* values set for the run are not compared */
        size = COTREE_FMAX(size, COTREE_FABS(parameter * x[state]));
    }
    return COTREE_FABS(follows - given) <= AGREED * size + ROUNDED;
}

static int check_redundant(cotree_start *start, cotree_real t, const cotree_real *z)
{
    const cotree_start_tables *const tables = start->tables;
    const cotree_run *const run = start->run;
    const int n = tables->n_redundant;
    const cotree_real *values = start->assembly.conditions;
    int first, i, j, status, found = 0;
    if (n == 0 || values == NULL) return 0;
    first = tables->assembly->n_start - 2 * n;
    status = MODEL->start(t, z, run->u, run->p, run->k, start->assembly.conditions);
    if (status == 0 && N_SENSITIVITIES > 0)
        status = MODEL->start_sensitivity(t, z, z + N_STATES, run->u, run->p, run->k,
                                          start->assembly.start_slopes);
    for (j = 0; j <= N_SENSITIVITIES && status == 0; ++j) {
        const int seed = j > 0 ? tables->seeds[j - 1] : -1;
        /* Magnitude of the parameter; zero for initial values, because redundant values follow. */
        const cotree_real size = j == 0     ? COTREE_F(1.0)
                                 : seed < 0 ? COTREE_F(0.0)
                                            : COTREE_FMAX(COTREE_FABS(run->p[seed]), LEAST_SIZE);
        if (j > 0) values = start->assembly.start_slopes + (j - 1) * tables->assembly->n_start;
        for (i = 0; i < n && status == 0; ++i) {
            if (is_agreed(start, i, values + first, z + j * N_STATES, size)) continue;
            if (found == 0) start->culprit = i;
            found = COTREE_START_CONTRADICTED;
#if COTREE_HAS_MENDING
            if (start->contradictions != NULL) start->contradictions[j * n + i] = 1;
#endif
        }
    }
    return status == 0 ? found : status;
}

static int check_finite(cotree_start *start, const cotree_real *z)
{
    int i;
    for (i = 0; i < start->run->n_full; ++i) {
        if (COTREE_FABS(z[i]) <= COTREE_MAX) continue;
        start->culprit = i % N_STATES;
        return COTREE_START_UNDEFINED;
    }
    return 0;
}

int cotree_start_find(cotree_start *start, cotree_real t, cotree_real *z)
{
    cotree_run *const run = start->run;
    int status;
    start->culprit = start->column = -1;
    start->is_chosen = 0;
    mark_kept(start);
    status = write_states(start, z);
#if COTREE_HAS_SENSITIVITIES
    if (status == 0 && N_SENSITIVITIES > 0) status = write_sensitivities(start, z + N_STATES);
#endif
    if (status == 0 && start->tables->assembly != NULL) status = satisfy_constraints(start, t, z);
    if (status == 0) status = cotree_run_inputs(run, t);
#if COTREE_HAS_ALGEBRAIC
    if (status == 0 && MODEL->n_algebraic > 0) status = cotree_start_solve_unknowns(start, t, z);
#endif
#if COTREE_HAS_EVENTS
    if (status == 0) status = cotree_start_choose_jump_modes(start, t, z);
#endif
#if COTREE_HAS_EVENTS && COTREE_HAS_SENSITIVITIES
    if (status == 0) status = cotree_start_check_jumps(start, t, z);
#endif
    if (status == 0) status = check_redundant(start, t, z);
    return status == 0 ? check_finite(start, z) : status;
}

/* Initialise a run and a start for a call. */
static void set_up(const cotree_start_call *call, cotree_run *run, cotree_start *start,
                   cotree_arena *arena)
{
    cotree_real *const u = cotree_arena_reals(arena, call->model->n_inputs + 1);
    cotree_run_init(run, call->model, call->p, call->k, u, call->has_sensitivities, arena);
    cotree_start_init(start, run, call->tables, arena);
#if COTREE_HAS_HELPER && COTREE_HAS_ALGEBRAIC
    run->helper = call->helper;
    if (call->elimination != NULL) run->elimination = *call->elimination;
    start->is_trusted = call->elimination != NULL;
#endif
#if COTREE_HAS_INPUTS
    run->n_replaced = call->n_replaced;
    run->replaced = call->replaced;
#endif
#if COTREE_HAS_MENDING
    if (call->report != NULL && call->tables->assembly != NULL)
        cotree_assembly_report_to(&start->assembly, call->report, arena);
    start->contradictions = call->contradictions;
#endif
    start->guess = call->guess;
    start->initial = call->initial;
    start->n_set = call->n_set;
    start->set = call->set;
    start->values = call->values;
}

/* Return whether all initial values are explicit. */
static int is_plain(const cotree_start *start)
{
#if COTREE_HAS_EVENTS
    if (MODEL->hybrid != NULL) return 0;
#endif
    return start->tables->assembly == NULL && MODEL->n_algebraic == 0;
}

/* Allocate memory for a call, and initialise a run and a start in it. Return the memory, or NULL
 * on failure. */
static void *allocate(const cotree_start_call *call, cotree_run *run, cotree_start *start)
{
    cotree_arena arena = {NULL, 0};
    set_up(call, run, start, &arena);
    arena.base = (char *)calloc(1, arena.used);
    if (arena.base == NULL) return NULL;
    arena.used = 0;
    set_up(call, run, start, &arena);
    return arena.base;
}

int cotree_start_once(cotree_start_call *call)
{
    cotree_run run;
    cotree_start start;
    cotree_arena none = {NULL, 0};
    void *memory;
    int status;
    set_up(call, &run, &start, &none);
    if (is_plain(&start)) {
        status = write_states(&start, call->z);
#if COTREE_HAS_SENSITIVITIES
        if (status == 0 && call->has_sensitivities)
            status = write_sensitivities(&start, call->z + call->model->n_states);
#endif
        return status == 0 ? check_finite(&start, call->z) : status;
    }
    memory = allocate(call, &run, &start);
    if (memory == NULL) return COTREE_START_NO_MEMORY;
    status = cotree_start_find(&start, call->t, call->z);
    call->culprit = cotree_start_culprit(&start, status);
    call->column = start.column;
    call->is_chosen = start.is_chosen;
    call->is_dependent = status == 0 && call->tables->assembly != NULL &&
                         cotree_assembly_is_dependent(&start.assembly, call->t, call->z);
    free(memory);
    return status;
}

#if COTREE_HAS_MENDING
int cotree_start_gradients(cotree_start_call *call, cotree_real *rows, cotree_real *weakest)
{
    cotree_run run;
    cotree_start start;
    void *memory;
    int status;
    memory = allocate(call, &run, &start);
    if (memory == NULL) return COTREE_START_NO_MEMORY;
    status = cotree_run_inputs(&run, call->t);
    if (status == 0)
        status = cotree_assembly_gradients(&start.assembly, call->t, call->z, rows, weakest);
    free(memory);
    return status;
}
#endif

const char *cotree_start_message(int status)
{
    switch (status) {
    case COTREE_START_VIOLATED:
        return "the initial values violate the constraints, and given ones cannot be adjusted";
    case COTREE_START_STUCK:
        return "a sensitivity is undefined: no change of the states satisfies the constraints";
    case COTREE_START_CONTRADICTED:
        return "initial values contradict each other";
    case COTREE_START_UNSOLVED:
        return "the algebraic equations have no solution near the guess";
    case COTREE_START_UNDETERMINED:
        return "the algebraic equations do not determine all unknowns";
    case COTREE_START_REVERSED:
        return "a jump reverses its own condition";
    case COTREE_START_NO_MEMORY:
        return "out of memory";
    case COTREE_START_ON_JUMP:
        return "the start is at a jump that depends on a parameter: there are no sensitivities";
    case COTREE_START_UNDEFINED:
        return "an initial value is not finite";
    default:
        return "a linear system is singular at the initial values";
    }
}

const char *cotree_start_culprit(const cotree_start *start, int status)
{
    const int i = start->culprit;
    if (i < 0) return "";
    switch (status) {
    case COTREE_START_VIOLATED:
    case COTREE_START_STUCK:
        return start->tables->assembly->rows == NULL ? "" : start->tables->assembly->rows[i].name;
    case COTREE_START_CONTRADICTED:
        return start->tables->redundant[i].name;
#if COTREE_HAS_EVENTS
    case COTREE_START_REVERSED:
    case COTREE_START_ON_JUMP:
        return MODEL->hybrid->events[i].name;
#endif
    case COTREE_START_UNDEFINED:
        return MODEL->states[i].name;
    default:
        return "";
    }
}
