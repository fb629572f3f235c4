/* cotree_fmu.c: instances, their modes, messages and saved states. */
#include "cotree_fmu_internal.h"

#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

/* Allocate the arrays of the state, in the order in which they are saved. */
static void lay_out_state(fmu *m, cotree_arena *arena)
{
    const size_t begin = arena->used;
    m->saved = m->numbers = cotree_arena_reals(arena, FMU_N_NUMBERS);
    m->z = cotree_arena_reals(arena, N_STATES * (1 + N_SENSITIVITIES));
    m->p = cotree_arena_reals(arena, m->model->n_parameters);
    m->outside = cotree_arena_reals(arena, m->tables->n_inputs);
    m->own_values = cotree_arena_reals(arena, N_STATES);
    m->is_own = cotree_arena_reals(arena, N_STATES);
#if COTREE_HAS_ALGEBRAIC
    m->old = cotree_arena_reals(arena, N_RATES);
#endif
#if COTREE_HAS_EVENTS
    m->event_history = cotree_arena_reals(arena, COTREE_EVENTS_SAVED(N_EVENTS));
#endif
    m->n_saved = (arena->used - begin) / sizeof(double);
}

static void lay_out_events(fmu *m, cotree_arena *arena)
{
    m->g = cotree_arena_reals(arena, N_EVENTS + m->model->hybrid->n_quantities);
    m->records = cotree_arena_reals(arena, COTREE_EVENTS_AT_ONCE(N_EVENTS) *
                                               COTREE_EVENTS_RECORD(N_STATES, N_SENSITIVITIES));
    /* The importer takes the steps, which are not searched for events: tolerances are not
     * needed. */
    cotree_events_init(&m->events, &m->run, m->run.n, m->tables->span, m->tables->rtol, NULL,
                       m->tables->atol, NULL, NULL, arena);
}

static double *reals_of(cotree_arena *arena, const fmu_pattern *pattern)
{
    return cotree_arena_reals(arena, pattern->starts[pattern->n_columns]);
}

static void lay_out(fmu *m, cotree_arena *arena)
{
    const cotree_model *const model = m->model;
    const fmu_tables *const tables = m->tables;
    const int n_full = N_STATES * (1 + N_SENSITIVITIES);
    lay_out_state(m, arena);
    m->k = cotree_arena_reals(arena, model->n_prepared);
    m->u = cotree_arena_reals(arena, model->n_inputs);
    m->dx = cotree_arena_reals(arena, N_STATES);
    m->y = cotree_arena_reals(arena, model->n_outputs);
    m->dy = cotree_arena_reals(arena, model->n_outputs * N_SENSITIVITIES);
    m->partials = reals_of(arena, &tables->partials);
    m->initial = reals_of(arena, &tables->initial);
    m->seed = cotree_arena_reals(arena, tables->partials.n_columns);
    m->rows = cotree_arena_reals(arena, tables->partials.n_rows);
    m->work = cotree_arena_reals(arena, n_full);
    m->known = cotree_arena_ints(arena, N_STATES);
    cotree_run_init(&m->run, model, m->p, m->k, m->u, 0, arena);
#if COTREE_HAS_ALGEBRAIC
    m->solved = cotree_arena_reals(arena, N_ALGEBRAIC);
    m->dense = cotree_arena_reals(arena, N_ALGEBRAIC * N_ALGEBRAIC);
    m->pivots = cotree_arena_ints(arena, N_ALGEBRAIC);
#endif
#if COTREE_HAS_START
    if (tables->start_tables->assembly != NULL) {
        m->moved = reals_of(arena, &tables->constraints);
        m->residual = cotree_arena_reals(arena, tables->constraints.n_rows);
    }
    m->set = cotree_arena_ints(arena, N_STATES);
    m->set_values = cotree_arena_reals(arena, N_STATES);
    cotree_start_init(&m->start, &m->run, tables->start_tables, arena);
#endif
#if COTREE_HAS_EVENTS
    lay_out_events(m, arena);
#endif
#if COTREE_HAS_BREAKPOINTS
    m->time_events.n = tables->n_time_events;
    m->time_events.n_sensitivities = model->n_sensitivities;
    m->limits = cotree_arena_reals(arena, tables->n_limits);
    m->time_events.rows =
        cotree_arena_reals(arena, tables->n_time_events * (3 + 2 * model->n_sensitivities));
#endif
#if COTREE_HAS_EXCHANGE
    m->before = cotree_arena_reals(arena, N_STATES);
#endif
#if COTREE_HAS_STEPS
    m->atols = cotree_arena_reals(arena, n_full);
    m->spare = cotree_arena_reals(arena, (int)m->n_saved);
#if COTREE_HAS_BREAKPOINTS
    m->turn_tolerances = cotree_arena_reals(arena, N_SENSITIVITIES);
#endif
#endif
}

static void find_offsets(fmu *m)
{
    const cotree_model *const model = m->model;
    const int counts[FMU_N_BLOCKS] = {
        1,
        N_STATES,
        N_RATES,
        model->n_parameters,
        m->tables->n_inputs,
        model->n_inputs - m->tables->n_inputs,
        model->n_outputs,
        N_EVENTS,
        model->n_outputs * N_SENSITIVITIES,
        N_STATES * N_SENSITIVITIES,
    };
    int i;
    m->offsets[0] = 0;
    for (i = 0; i < FMU_N_BLOCKS; ++i) m->offsets[i + 1] = m->offsets[i] + counts[i];
}

/* Reset the instance to its state after instantiation. */
static void reset(fmu *m)
{
    size_t i;
    int j;
    for (i = 0; i < m->n_saved; ++i) m->saved[i] = 0.0;
    for (j = 0; j < m->model->n_parameters; ++j) m->p[j] = m->model->parameter_values[j];
    for (j = 0; j < m->tables->n_inputs; ++j) m->outside[j] = m->tables->values[j];
    for (j = 0; j < N_STATES; ++j) m->z[j] = m->tables->start[j];
    m->numbers[FMU_END] = HUGE_VAL;
    m->numbers[FMU_TOLERANCE] = m->tables->rtol;
    m->numbers[FMU_LOW] = -HUGE_VAL;
    m->numbers[FMU_HIGH] = HUGE_VAL;
    m->numbers[FMU_NEXT] = HUGE_VAL;
    m->is_prepared = 0;
    fmu_invalidate(m);
    fmu_enter(m, FMU_INSTANTIATED);
}

/* Return a new instance, or NULL if memory is exhausted. */
static fmu *new_instance(const fmu_importer *importer, const fmu_tables *tables)
{
    cotree_arena arena = {NULL, 0};
    const size_t n_characters = strlen(importer->name) + 1;
    fmu *const m = (fmu *)calloc(1, sizeof(fmu) + n_characters);
    if (m == NULL) return NULL;
    m->tables = tables;
    m->model = tables->model();
    m->importer = *importer;
    memcpy(m->name, importer->name, n_characters);
    m->importer.name = m->name;
    lay_out(m, &arena);
    m->memory = calloc(1, arena.used);
    if (m->memory == NULL) {
        free(m);
        return NULL;
    }
    arena.base = (char *)m->memory;
    arena.used = 0;
    lay_out(m, &arena);
    find_offsets(m);
    reset(m);
    return m;
}

fmu *fmu_instantiate(const fmu_importer *importer, const char *token, int is_exchanged,
                     int returns_early)
{
    const fmu_tables *const tables = fmu_tables_of_model();
    fmu *m;
    if (importer->name == NULL || importer->name[0] == '\0')
        return fmu_reject(importer, "the instance has no name");
    if (token == NULL || strcmp(token, tables->token) != 0)
        return fmu_reject(importer, "the instantiation token (GUID) is not that of this unit");
    if (is_exchanged ? !tables->is_exchangeable : tables->stepper == NULL)
        return fmu_reject(importer, "the unit was exported without this interface type");
    m = new_instance(importer, tables);
    if (m == NULL) return fmu_reject(importer, "out of memory");
    m->is_exchanged = is_exchanged;
    m->returns_early = returns_early;
    return m;
}

void fmu_free(void *instance)
{
    fmu *const m = (fmu *)instance;
    size_t i;
    if (m == NULL) return;
    for (i = 0; i < m->n_kept; ++i) free(m->kept[i]);
    free(m->kept);
#if COTREE_HAS_STEPS
    free(m->job_memory);
#if COTREE_HAS_BREAKPOINTS
    free(m->breakpoints);
#endif
#endif
    free(m->memory);
    free(m);
}

/* Messages. */

/* Log categories of the model description, one for each status. */
static const char *const categories[] = {"logEvents", NULL, "logStatusDiscard", "logStatusError"};

/* Log a message. Errors are logged even if logging is off, as the standards require. */
static void log_message(const fmu_importer *importer, int status, const char *message)
{
    if (importer->callback == NULL || !(status == FMU_ERROR || importer->is_logging)) return;
    importer->log(importer, status, categories[status], message);
}

static void log_format(const fmu *m, int status, const char *format, va_list arguments)
{
    char message[1024];
    if (vsnprintf(message, sizeof(message), format, arguments) < 0) return;
    log_message(&m->importer, status, message);
}

void fmu_log(const fmu *m, int status, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_format(m, status, format, arguments);
    va_end(arguments);
}

int fmu_refuse(const fmu *m, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_format(m, FMU_ERROR, format, arguments);
    va_end(arguments);
    return 1;
}

int fmu_discard(fmu *m, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    log_format(m, m->may_discard ? FMU_DISCARD : FMU_ERROR, format, arguments);
    va_end(arguments);
    m->is_discarded = m->may_discard;
    return 1;
}

fmu *fmu_reject(const fmu_importer *importer, const char *why)
{
    log_message(importer, FMU_ERROR, why);
    return NULL;
}

int fmu_check_pointer(const fmu *m, const void *pointer)
{
    if (pointer != NULL) return 0;
    fmu_refuse(m, "%s is called with a null pointer", m->function);
    return 1;
}

static int is_category(const char *name)
{
    size_t i;
    for (i = 0; i < sizeof(categories) / sizeof(categories[0]); ++i) {
        if (name != NULL && categories[i] != NULL && strcmp(name, categories[i]) == 0) return 1;
    }
    return 0;
}

int fmu_set_logging(fmu *m, int is_logging, size_t n, const char *const names[])
{
    size_t i;
    if (n > 0 && fmu_check_pointer(m, names) != 0) return 1;
    for (i = 0; i < n; ++i) {
        if (is_category(names[i])) continue;
        return fmu_refuse(m, "there is no log category '%.100s'", names[i] == NULL ? "" : names[i]);
    }
    m->importer.is_logging = is_logging;
    return 0;
}

/* Calls and modes. */

const char *fmu_mode_name(const fmu *m)
{
    switch (m->mode) {
    case FMU_INSTANTIATED:
        return "the state Instantiated";
    case FMU_INITIALIZATION:
        return "Initialization Mode";
    case FMU_EVENT:
        return "Event Mode";
    case FMU_CONTINUOUS:
        return "Continuous-Time Mode";
    case FMU_STEP:
        return "Step Mode";
    case FMU_FAILED:
        return "the state Step Failed";
    default:
        return "the state Terminated";
    }
}

fmu *fmu_call(void *instance, const char *function, int modes)
{
    fmu *const m = (fmu *)instance;
    if (m == NULL) return NULL;
    m->function = function;
    m->may_discard = m->is_discarded = 0;
    if ((m->mode & modes) != 0) return m;
    fmu_refuse(m, "%s is not allowed in %s", function, fmu_mode_name(m));
    return NULL;
}

void fmu_evaluate(fmu *m) { m->may_discard = m->is_exchanged; }

int fmu_status(const fmu *m, int result)
{
    return result == 0 ? FMU_OK : m->is_discarded ? FMU_DISCARD : FMU_ERROR;
}

void fmu_enter(fmu *m, int mode)
{
    m->mode = mode;
    m->numbers[FMU_MODE] = (double)mode;
}

int fmu_refuse_call(fmu *m, const char *why) { return fmu_refuse(m, "%s: %s", m->function, why); }

int fmu_refuse_type(fmu *m, size_t n)
{
    return n > 0 && fmu_refuse_call(m, "every variable is a floating-point number");
}

int fmu_terminate(fmu *m)
{
    fmu_enter(m, FMU_TERMINATED);
    return 0;
}

int fmu_reset(fmu *m)
{
    reset(m);
    return 0;
}

/* Saved states. */

/* Marks the header of a serialized state. */
#define MAGIC 0x46746f63

typedef struct fmu_state_head {
    unsigned magic, n;
    unsigned long long checksum; /* of the following bytes, set when serialized */
    char token[64];
} fmu_state_head;

/* A saved state: its header, then n doubles. */
typedef struct fmu_state {
    fmu_state_head head;
    double values[];
} fmu_state;

static size_t size_of_state(const fmu *m)
{
    return sizeof(fmu_state) + m->n_saved * sizeof(double);
}

/* Return the FNV-1a checksum (Fowler, Noll, Vo), which detects damaged bytes. */
static unsigned long long checksum_of(const void *state_bytes, size_t n)
{
    const unsigned char *const own = (const unsigned char *)state_bytes;
    unsigned long long sum = 14695981039346656037ULL;
    size_t i;
    for (i = offsetof(fmu_state_head, token); i < n; ++i) sum = (sum ^ own[i]) * 1099511628211ULL;
    return sum;
}

static int is_state(const fmu *m, const fmu_state_head *head)
{
    return head->magic == MAGIC && head->n == m->n_saved &&
           strncmp(head->token, m->tables->token, sizeof(head->token) - 1) == 0;
}

/* Return the index of a saved state, or n_kept if there is none. The pointer is compared but not
 * dereferenced, since the state may have been freed. The search starts with recent states, which
 * are used most often. */
static size_t find_state(const fmu *m, const void *own)
{
    size_t i;
    for (i = m->n_kept; i > 0; --i) {
        if (m->kept[i - 1] == own) return i - 1;
    }
    return m->n_kept;
}

static int check_state(const fmu *m, const void *own)
{
    if (fmu_check_pointer(m, own) != 0) return 1;
    if (find_state(m, own) < m->n_kept) return 0;
    return fmu_refuse(m, "%s: the pointer is not a state of this instance, or the state was freed",
                      m->function);
}

/* Append a new state to the list of saved states. Return NULL if memory is exhausted. */
static fmu_state *add_state(fmu *m)
{
    fmu_state *const own = (fmu_state *)malloc(size_of_state(m));
    if (own != NULL && m->n_kept == m->n_places) {
        const size_t n = 2 * m->n_kept + 4;
        fmu_state **const more = (fmu_state **)realloc(m->kept, n * sizeof(fmu_state *));
        if (more == NULL) {
            free(own);
            return NULL;
        }
        m->kept = more;
        m->n_places = n;
    }
    if (own != NULL) m->kept[m->n_kept++] = own;
    return own;
}

/* If *place is NULL, set it to a new state; otherwise check the saved state that it points to. */
static int take_state(fmu *m, void **place)
{
    if (fmu_check_pointer(m, place) != 0) return 1;
    if (*place != NULL) return check_state(m, *place);
    *place = add_state(m);
    return *place == NULL ? fmu_refuse(m, "%s: out of memory", m->function) : 0;
}

int fmu_save_state(fmu *m, void **place)
{
    fmu_state *own;
    if (take_state(m, place) != 0) return 1;
    own = (fmu_state *)*place;
    memset(&own->head, 0, sizeof(own->head));
    own->head.magic = MAGIC;
    own->head.n = (unsigned)m->n_saved;
    strncpy(own->head.token, m->tables->token, sizeof(own->head.token) - 1);
    memcpy(own->values, m->saved, m->n_saved * sizeof(double));
    return 0;
}

/* Return whether a number is a mode that instances of this interface type may have. */
static int is_mode(const fmu *m, double mode)
{
    int bit;
    for (bit = FMU_INSTANTIATED; bit <= FMU_FAILED; bit *= 2) {
        const int is_own = bit == FMU_STEP || bit == FMU_FAILED        ? !m->is_exchanged
                           : bit == FMU_EVENT || bit == FMU_CONTINUOUS ? m->is_exchanged
                                                                       : 1;
        if (is_own && mode == (double)bit) return 1;
    }
    return 0;
}

int fmu_restore(fmu *m, const double *from)
{
    if (!is_mode(m, from[FMU_MODE]))
        return fmu_refuse(m, "this is not a state of such an instance");
    memcpy(m->saved, from, m->n_saved * sizeof(double));
    m->mode = (int)m->numbers[FMU_MODE];
    m->is_prepared = 0;
    fmu_invalidate(m);
    return 0;
}

int fmu_restore_state(fmu *m, const void *from)
{
    return check_state(m, from) != 0 ? 1 : fmu_restore(m, ((const fmu_state *)from)->values);
}

int fmu_free_state(fmu *m, void **place)
{
    if (place == NULL || *place == NULL) return 0;
    if (check_state(m, *place) != 0) return 1;
    m->kept[find_state(m, *place)] = m->kept[m->n_kept - 1];
    --m->n_kept;
    free(*place);
    *place = NULL;
    return 0;
}

int fmu_measure_state(fmu *m, const void *from, size_t *n)
{
    if (check_state(m, from) != 0 || fmu_check_pointer(m, n) != 0) return 1;
    *n = size_of_state(m);
    return 0;
}

int fmu_write_state(fmu *m, const void *from, void *bytes, size_t n)
{
    fmu_state_head head;
    if (check_state(m, from) != 0 || fmu_check_pointer(m, bytes) != 0) return 1;
    if (n < size_of_state(m)) {
        return fmu_refuse(m, "%s: a state has %lu bytes, but there is room for %lu", m->function,
                          (unsigned long)size_of_state(m), (unsigned long)n);
    }
    head = ((const fmu_state *)from)->head;
    head.checksum = checksum_of(from, size_of_state(m));
    memcpy(bytes, from, size_of_state(m));
    memcpy(bytes, &head, sizeof(head));
    return 0;
}

int fmu_read_state(fmu *m, const void *bytes, size_t n, void **place)
{
    fmu_state_head head;
    if (fmu_check_pointer(m, bytes) != 0) return 1;
    memset(&head, 0, sizeof(head));
    if (n >= sizeof(head)) memcpy(&head, bytes, sizeof(head));
    if (n != size_of_state(m) || !is_state(m, &head) || head.checksum != checksum_of(bytes, n)) {
        return fmu_refuse(m, "%s: the bytes are not a state of this model", m->function);
    }
    if (take_state(m, place) != 0) return 1;
    memcpy(*place, bytes, n);
    return 0;
}
