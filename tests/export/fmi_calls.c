/* fmi_calls.c: random sequences of legal and illegal calls to an exported unit.
 *
 * Usage: fmi_calls FIRST N [LENGTH]: N sequences with the seeds FIRST, FIRST + 1, and so on. Each
 * drives up to three instances of both interface types at once. The table of allowed calls is that of
 * the standard, written a second time. A violation, or a report of a sanitizer, prints the seed and the calls
 * before it.
 *
 * A call is expected to be done, to be refused, or either, where the standard leaves it open or
 * values are out of any range in which the model can be evaluated. Whatever is refused has to be logged as an
 * error, and must leave parameters and inputs as they were. Values that cannot be computed may be discarded,
 * which is logged where logging is on.
 */
#include "fmi_calls.h"

#include "unit_facts.h"

#include <math.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

extern void __sanitizer_set_death_callback(void (*)(void));
extern int __lsan_do_recoverable_leak_check(void);

/* FAILED: a step of Co-Simulation was discarded, in FMI 2. */
enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEP = 16, TERMINATED = 32, FAILED = 64 };
#define RUNNING (EVENT | CONTINUOUS | STEP)
#define KNOWN_STATES (INITIALIZATION | EVENT | CONTINUOUS | TERMINATED)

enum expected { DONE, REFUSED, EITHER };

/* An instance, and what the standard says of it. */
typedef struct unit {
    void *handle;
    int is_exchanged, has_logger, is_logging, mode;
    int is_odd;      /* values are wild: what is allowed may fail */
    int may_discard; /* the present call */
    int is_updated; /* discrete states, since Event Mode was entered */
    int is_set_up; /* FMI 2 */
    double t, next, end;
    int n_errors, n_discards;
    char message[1100];
} unit;

/* A kept state, and what was known of its instance. */
typedef struct kept {
    memory at;
    unit owner;
    int slot;
    real *values; /* of parameters and inputs */
} kept;

#define N_UNITS 3
#define N_KEPT 5

static unit units[N_UNITS];
static kept memories[N_KEPT];

/* Random numbers (xorshift64*). */

static uint64_t state_of_random;

static uint64_t random_bits(void)
{
    state_of_random ^= state_of_random >> 12;
    state_of_random ^= state_of_random << 25;
    state_of_random ^= state_of_random >> 27;
    return state_of_random * 2685821657736338717ULL;
}

static int below(int n)
{
    return (int)((random_bits() >> 33) % (uint64_t)n);
}

static int chance(int percent)
{
    return below(100) < percent;
}

static double uniform(double low, double high)
{
    return low + (high - low) * (double)(random_bits() >> 11) / 9007199254740992.0;
}

static double wild(void)
{
    static const double values[] = {0.0, -1.0, 1e-300, 1e300, -1e300, 1e9, -1e9, 1e-9, 1e20, 5e-324};
    return values[below((int)(sizeof(values) / sizeof(values[0])))];
}

static double no_number(void)
{
    static const double values[] = {NAN, INFINITY, -INFINITY};
    return values[below(3)];
}

/* Room of exactly the size that a call may use; never of zero bytes. */
static void *room(size_t n, size_t size)
{
    void *const found = malloc(n * size + (n == 0));
    if (found == NULL) exit(3);
    return found;
}

/* The calls of the present sequence. */

static uint64_t seed;
static char trace[200000];
static size_t n_trace;

static void note(const char *format, ...)
{
    va_list arguments;
    if (n_trace + 400 > sizeof(trace)) n_trace = 0;
    va_start(arguments, format);
    n_trace += (size_t)vsnprintf(trace + n_trace, 400, format, arguments);
    va_end(arguments);
}

static void tell(void)
{
    fprintf(stderr, "seed %llu\n%.*s\n", (unsigned long long)seed, (int)n_trace, trace);
}

static void fail(const char *why)
{
    fprintf(stderr, "FAILED: %s\n", why);
    tell();
    _Exit(1);
}

static void take_message(unit *u, int status, const char *category, const char *message)
{
    const char *const wanted = status == ERROR ? "logStatusError" : status == DISCARD ? "logStatusDiscard" : "logEvents";
    if (u < units || u >= units + N_UNITS) fail("the environment of the logger is another one");
    if (message == NULL || message[0] == '\0') fail("an empty message is logged");
    if (category == NULL || strcmp(category, wanted) != 0) fail("the category is not that of the status");
    if (status != ERROR && !u->is_logging) fail("a message is logged, but logging is off");
    if (status == ERROR) ++u->n_errors;
    if (status == DISCARD) ++u->n_discards;
    snprintf(u->message, sizeof(u->message), "%s", message);
}

#if FMI == 3
static void logger(void *environment, fmi3Status status, fmi3String category, fmi3String message)
{
    take_message((unit *)environment, (int)status, category, message);
}
#else
static void logger(void *environment, fmi2String name, fmi2Status status, fmi2String category,
                   fmi2String format, ...)
{
    char message[1100];
    va_list arguments;
    if (name == NULL || strcmp(name, "unit") != 0) fail("a message has another name than its instance");
    va_start(arguments, format);
    vsnprintf(message, sizeof(message), format, arguments);
    va_end(arguments);
    take_message((unit *)environment, (int)status, category, message);
}
#endif

static void begin(unit *u, const char *what)
{
    note("%d%s mode %d%s t %.17g: %s", (int)(u - units), u->is_exchanged ? "x" : "s", u->mode,
         u->is_odd ? " odd" : "", u->t, what);
    u->n_errors = u->n_discards = u->may_discard = 0;
    u->message[0] = '\0';
}

/* Begins a call that computes values: importers choose the steps of Model Exchange, and may choose others. */
static void begin_evaluation(unit *u, const char *what)
{
    begin(u, what);
    u->may_discard = u->is_exchanged && u->is_odd;
}

/* Compares what a call said with what it should have said; gives whether it was done. */
static int finish(unit *u, int status, enum expected expected)
{
    note(" -> %d %s\n", status, u->message);
    if (status != OK && status != ERROR && !(status == DISCARD && u->may_discard)) {
        fail("the status is none of those expected");
    }
    if (status == DISCARD && u->n_errors > 0) fail("discarded, but an error is logged");
    if (status == DISCARD && u->has_logger && u->is_logging && u->n_discards == 0) fail("discarded without a message");
    if (status != DISCARD && u->n_discards > 0) fail("a message says that a call is discarded, which is not");
    if (status == ERROR && u->has_logger && u->n_errors == 0) fail("refused without a message");
    if (status == OK && u->n_errors > 0) fail("an error is logged, but the call is said to be done");
    if (expected == DONE && status != OK) fail("refused, but allowed");
    if (expected == REFUSED && status == OK) fail("done, but not allowed");
    return status == OK;
}

static enum expected expect(const unit *u, int is_allowed)
{
    return !is_allowed ? REFUSED : u->is_odd ? EITHER : DONE;
}

static int is_in(const unit *u, int modes)
{
    return (u->mode & modes) != 0;
}

/* Variables. */

static void read_given(unit *u, real *values)
{
    const size_t n = N_PARAMETERS + N_INPUTS;
    reference *const refs = (reference *)room(n, sizeof(reference));
    int i;
    for (i = 0; i < N_PARAMETERS; ++i) refs[i] = parameters[i];
    for (i = 0; i < N_INPUTS; ++i) refs[N_PARAMETERS + i] = inputs[i];
    begin(u, "read parameters and inputs");
    finish(u, fmi_get(u->handle, refs, n, values, n), DONE);
    free(refs);
}

static void read_time(unit *u)
{
    const reference time = 0;
    begin(u, "read the time");
    finish(u, fmi_get(u->handle, &time, 1, &u->t, 1), DONE);
}

static void action_get(unit *u)
{
    const size_t n = (size_t)below(6), n_values = FMI == 3 && chance(5) ? n + 1 : n;
    reference *const refs = (reference *)room(n, sizeof(reference));
    real *const values = (real *)room(n_values, sizeof(real));
    const int is_wrong = chance(10), lacks = chance(6);
    int is_early = 0, i, k, is_bad = n != n_values, status;
    enum expected expected;
    for (i = 0; i < (int)n; ++i) {
        refs[i] = (reference)below(N_REFERENCES);
        is_early |= !may_read_early[refs[i]];
    }
    if (is_wrong && n > 0) {
        refs[below((int)n)] = chance(50) ? (reference)N_REFERENCES : (reference)random_bits() | 0x80000000u;
        is_bad = 1;
    }
    is_bad |= lacks && n > 0;
    expected = expect(u, !is_bad);
    if (expected == DONE && is_in(u, INSTANTIATED) && is_early) expected = EITHER;
    begin_evaluation(u, "get");
    for (i = 0; i < (int)n; ++i) note(" %u", refs[i]);
    if (lacks) note(" null");
    k = lacks ? below(3) : -1;
    status = fmi_get(u->handle, k == 0 || k == 2 ? NULL : refs, n, k == 1 || k == 2 ? NULL : values, n_values);
    if (finish(u, status, expected) && !u->is_odd) {
        for (i = 0; i < (int)n; ++i) {
            if (!isfinite(values[i])) fail("a value is no finite number");
        }
    }
    free(refs);
    free(values);
}

/* Chooses what is set to what; gives whether that is allowed. */
static enum expected choose_set(const unit *u, reference *ref, real *value, int *is_odd)
{
    const int kind = below(10);
    *is_odd = 0;
    if (kind < 5 && N_PARAMETERS > 0) {
        const int i = below(N_PARAMETERS);
        *ref = parameters[i];
        *value = parameter_values[i];
        if (chance(50)) *value *= uniform(0.99, 1.01);
        *is_odd = IS_SENSITIVE && *value != parameter_values[i];
        if (chance(4)) *value = wild(), *is_odd = 1;
        if (is_in(u, TERMINATED | FAILED)) return REFUSED;
        /* The standard refuses it; CasADi needs it. */
        if (is_in(u, CONTINUOUS)) return *is_odd = 1, EITHER;
    } else if (kind < 8 && N_INPUTS > 0) {
        *ref = inputs[below(N_INPUTS)];
        *value = uniform(-1.0, 1.0);
        if (chance(4)) *value = wild(), *is_odd = 1;
        if (is_in(u, TERMINATED | FAILED)) return REFUSED;
    } else if (kind < 9 && N_STATES > 0) {
        const int i = below(N_STATES);
        *ref = states[i];
        *value = state_values[i];
        if (chance(30)) *value += uniform(-0.1, 0.1), *is_odd = 1;
        if (!is_in(u, INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS)) return REFUSED;
        /* No motion leads there; the standard leaves it open who sets a state one by one. */
        if (is_in(u, EVENT | CONTINUOUS)) return *is_odd = 1, EITHER;
        if (is_in(u, INITIALIZATION) && !is_exact[i]) return EITHER;
    } else {
        *ref = chance(70) ? (reference)below(N_REFERENCES) : (reference)N_REFERENCES + (reference)below(3);
        *value = 0.5;
        *is_odd = 1;
        return *ref < N_REFERENCES && may_set[*ref] ? EITHER : REFUSED;
    }
    if (chance(3)) {
        *value = no_number();
        return REFUSED;
    }
    return DONE;
}

static void action_set(unit *u)
{
    const size_t n = (size_t)below(4), n_values = FMI == 3 && chance(5) ? n + 1 : n;
    const int lacks = chance(5) ? 1 + below(3) : 0;
    const size_t n_given = N_PARAMETERS + N_INPUTS;
    reference *const refs = (reference *)room(n, sizeof(reference));
    real *const values = (real *)room(n_values, sizeof(real));
    real *const before = (real *)room(n_given, sizeof(real));
    real *const after = (real *)room(n_given, sizeof(real));
    enum expected expected = is_in(u, TERMINATED | FAILED) ? REFUSED : DONE;
    int is_odd = 0, status, is_done;
    size_t i;
    if (n_values > n) values[n] = 0.0;
    for (i = 0; i < n; ++i) {
        int own = 0;
        const enum expected of_one = choose_set(u, refs + i, values + i, &own);
        if (of_one == REFUSED || (of_one == EITHER && expected == DONE)) expected = of_one;
        is_odd |= own;
    }
    if (n != n_values || (lacks != 0 && n > 0)) expected = REFUSED;
    read_given(u, before);
    begin(u, "set");
    for (i = 0; i < n; ++i) note(" %u=%g", refs[i], values[i]);
    if (lacks != 0) note(" null %d", lacks);
    status = fmi_set(u->handle, (lacks & 1) ? NULL : refs, n, (lacks & 2) ? NULL : values, n_values);
    is_done = finish(u, status, expected);
    if (is_done) u->is_odd |= is_odd;
    read_given(u, after);
    if (!is_done && n_given > 0 && memcmp(before, after, n_given * sizeof(real)) != 0) {
        fail("what was refused changed something");
    }
    free(refs);
    free(values);
    free(before);
    free(after);
}

static void action_derivatives(unit *u)
{
    const size_t n_f = (size_t)below(4), n_v = (size_t)below(4);
    const int is_adjoint = FMI == 3 && chance(50);
    const size_t n_seed = (is_adjoint ? n_f : n_v) + (size_t)(FMI == 3 && chance(4));
    const size_t n_found = is_adjoint ? n_v : n_f;
    reference *const f = (reference *)room(n_f, sizeof(reference));
    reference *const v = (reference *)room(n_v, sizeof(reference));
    real *const given = (real *)room(n_seed, sizeof(real));
    real *const found = (real *)room(n_found, sizeof(real));
    int is_allowed = is_in(u, INITIALIZATION | RUNNING | FAILED | TERMINATED), is_number = 1, status;
    const int lacks = chance(4) && n_f > 0 && n_v > 0;
    enum expected expected;
    size_t i;
    for (i = 0; i < n_f; ++i) {
        f[i] = chance(8) ? (reference)below(N_REFERENCES + 2) : unknowns[below(N_UNKNOWNS)];
        is_allowed &= f[i] < N_REFERENCES && may_be_unknown[f[i]];
    }
    for (i = 0; i < n_v; ++i) {
        v[i] = chance(8) ? (reference)below(N_REFERENCES + 2) : knowns[below(N_KNOWNS)];
        is_allowed &= v[i] < N_REFERENCES && may_be_known[v[i]];
    }
    for (i = 0; i < n_seed; ++i) {
        given[i] = chance(3) ? no_number() : uniform(-1.0, 1.0);
        is_number &= isfinite(given[i]) != 0;
    }
    is_allowed &= n_seed == (is_adjoint ? n_f : n_v) && !lacks;
    expected = expect(u, is_allowed);
    /* While the start is found, states are unknowns, and a start has not always derivatives. */
    if (is_in(u, INITIALIZATION) && expected == DONE && IS_TIED) expected = EITHER;
    if (is_in(u, INITIALIZATION) && expected == REFUSED && !lacks) expected = EITHER;
    if (!is_number && expected == DONE) expected = EITHER;
    begin_evaluation(u, is_adjoint ? "adjoint" : "directional");
    for (i = 0; i < n_f; ++i) note(" %u", f[i]);
    note(" by");
    for (i = 0; i < n_v; ++i) note(" %u", v[i]);
#if FMI == 3
    if (is_adjoint) {
        status = (int)fmi3GetAdjointDerivative(u->handle, lacks ? NULL : f, n_f, v, n_v, given, n_seed, found, n_found);
    } else
#endif
        status = fmi_directional(u->handle, lacks ? NULL : f, n_f, v, n_v, given, n_seed, found, n_found);
    if (finish(u, status, expected) && is_number && !u->is_odd) {
        for (i = 0; i < n_found; ++i) {
            if (!isfinite(found[i])) fail("a derivative is no finite number");
        }
    }
    free(f);
    free(v);
    free(given);
    free(found);
}

/* Life of an instance. */

static void instantiate(unit *u)
{
    const int fault = chance(25) ? 1 + below(5) : 0;
    const char *name = "unit", *token = TOKEN;
    const int is_logging = chance(50);
    memset(u, 0, sizeof(*u));
    u->is_exchanged = chance(50);
    u->has_logger = chance(90);
    u->is_logging = is_logging;
    u->mode = INSTANTIATED;
    if (fault == 1) token = NULL;
    if (fault == 2) token = "{00000000-0000-0000-0000-000000000000}";
    if (fault == 3) name = NULL;
    if (fault == 4) name = "";
    begin(u, "instantiate");
    note(" fault %d", fault);
#if FMI == 3
    if (u->is_exchanged && fault != 5) {
        u->handle = fmi3InstantiateModelExchange(name, token, chance(50) ? NULL : "resources", false,
                                                 is_logging, u, u->has_logger ? logger : NULL);
    } else if (fault != 5 || chance(60)) {
        /* There is no Event Mode in Co-Simulation, and no variable of intermediate updates. */
        const fmi3ValueReference intermediate[] = {0};
        u->is_exchanged = 0;
        u->handle = fmi3InstantiateCoSimulation(name, token, NULL, false, is_logging, fault == 5, chance(50),
                                                fault == 5 ? intermediate : NULL, fault == 5, u,
                                                u->has_logger ? logger : NULL, NULL);
    } else {
        u->handle = fmi3InstantiateScheduledExecution(name, token, NULL, false, is_logging, u,
                                                      u->has_logger ? logger : NULL, NULL, NULL, NULL);
    }
#else
    {
        const fmi2CallbackFunctions functions = {u->has_logger ? logger : NULL, calloc, free, NULL, u};
        const fmi2Type kind = u->is_exchanged ? fmi2ModelExchange : fmi2CoSimulation;
        /* The name of a message is that of its instance. */
        u->has_logger = u->has_logger && fault != 3 && fault != 4;
        const fmi2CallbackFunctions silent = {NULL, NULL, NULL, NULL, NULL};
        u->handle = fmi2Instantiate(name, fault == 5 ? (fmi2Type)7 : kind, token, chance(50) ? NULL : "file:///",
                                    u->has_logger ? &functions : &silent, 0, is_logging);
    }
#endif
    finish(u, u->handle == NULL ? ERROR : OK, fault == 0 ? DONE : REFUSED);
}

static void free_memory(kept *own)
{
    unit *const u = units + own->slot;
    memory stale = own->at;
    byte bytes[1];
    size_t n;
    if (own->at == NULL) return;
    begin(u, "free a state");
    finish(u, (int)fmi_free_memory(u->handle, &own->at), DONE);
    if (own->at != NULL) fail("a freed state is not set to null");
    begin(u, "free a state that was freed");
    finish(u, (int)fmi_free_memory(u->handle, &own->at), DONE);
    /* A copy of the pointer points to nothing now. */
    begin(u, "free a copy of a state that was freed");
    finish(u, (int)fmi_free_memory(u->handle, &stale), REFUSED);
    begin(u, "recall a state that was freed");
    finish(u, (int)fmi_set_memory(u->handle, stale), REFUSED);
    begin(u, "write to a state that was freed");
    finish(u, (int)fmi_get_memory(u->handle, &stale), REFUSED);
    begin(u, "size of a state that was freed");
    finish(u, (int)fmi_memory_size(u->handle, stale, &n), REFUSED);
    begin(u, "serialise a state that was freed");
    finish(u, (int)fmi_write_memory(u->handle, stale, bytes, 1), REFUSED);
    free(own->values);
    own->values = NULL;
}

static void free_unit(unit *u)
{
    int i;
    if (u->handle == NULL) return;
    for (i = 0; i < N_KEPT; ++i) {
        if (memories[i].slot == (int)(u - units)) free_memory(memories + i);
    }
    note("%d free\n", (int)(u - units));
    fmi_free(u->handle);
    u->handle = NULL;
}

static void action_reset(unit *u)
{
    begin(u, "reset");
    finish(u, (int)fmi_reset(u->handle), DONE);
    u->mode = INSTANTIATED;
    u->is_odd = u->is_updated = u->is_set_up = 0;
    u->t = 0.0;
}

/* Times of an experiment; gives whether they are good. */
static int choose_times(double *begins, int *has_end, double *end, int *has_tolerance, double *tolerance)
{
    const int fault = chance(15) ? 1 + below(6) : 0;
    *begins = chance(80) ? 0.0 : uniform(0.0, 0.2 * T_END);
    *has_end = chance(70);
    *end = *begins + T_END;
    *has_tolerance = chance(50);
    *tolerance = pow(10.0, uniform(-9.0, -7.0)); /* rodas5 loses diodes at 1e-5 */
    if (fault == 1) *begins = no_number();
    if (fault == 2) *has_end = 1, *end = *begins - 1.0;
    if (fault == 3) *has_end = 1, *end = NAN;
    if (fault == 4) *has_tolerance = 1, *tolerance = no_number();
    if (fault == 5) *has_tolerance = 1, *tolerance = -1e-6;
    if (fault == 6) *has_tolerance = 1, *tolerance = 0.0;
    return fault == 0;
}

static void action_begin(unit *u)
{
    double begins, end, tolerance;
    int has_end, has_tolerance, status;
    int is_good = choose_times(&begins, &has_end, &end, &has_tolerance, &tolerance);
    enum expected expected;
#if FMI == 3
    begin(u, "enter initialization");
    note(" %g %d %g %d %g", begins, has_end, end, has_tolerance, tolerance);
    expected = expect(u, is_good && is_in(u, INSTANTIATED));
    if (expected == EITHER) expected = DONE; /* nothing is evaluated yet */
    status = (int)fmi3EnterInitializationMode(u->handle, has_tolerance, tolerance, begins, has_end, end);
#else
    begin(u, "set up");
    note(" %g %d %g %d %g", begins, has_end, end, has_tolerance, tolerance);
    expected = is_good && is_in(u, INSTANTIATED) ? DONE : REFUSED;
    status = (int)fmi2SetupExperiment(u->handle, has_tolerance, tolerance, begins, has_end, end);
    if (finish(u, status, expected)) {
        u->is_set_up = 1;
        u->t = begins;
        u->end = has_end ? end : HUGE_VAL;
    }
    if (chance(10)) return;
    begins = u->t;
    end = u->end;
    has_end = 1;
    begin(u, "enter initialization");
    expected = is_in(u, INSTANTIATED) && u->is_set_up ? DONE : REFUSED;
    status = (int)fmi2EnterInitializationMode(u->handle);
#endif
    if (!finish(u, status, expected)) return;
    u->mode = INITIALIZATION;
    u->t = begins;
    u->end = has_end ? end : HUGE_VAL;
}

static void action_exit(unit *u)
{
    begin(u, "exit initialization");
    if (!finish(u, (int)fmi_exit_initialization(u->handle), expect(u, is_in(u, INITIALIZATION)))) return;
    u->mode = u->is_exchanged ? EVENT : STEP;
    u->is_updated = 0;
    u->next = HUGE_VAL;
}

static void action_terminate(unit *u)
{
    begin(u, "terminate");
    if (finish(u, (int)fmi_terminate(u->handle), is_in(u, RUNNING | FAILED) ? DONE : REFUSED)) u->mode = TERMINATED;
}

/* Model Exchange. */

static void action_enter_event(unit *u)
{
    begin(u, "enter event mode");
    if (!finish(u, (int)fmi_enter_event(u->handle), is_in(u, CONTINUOUS) ? DONE : REFUSED)) return;
    u->mode = EVENT;
    u->is_updated = 0;
}

static void action_update(unit *u)
{
    int terminates = 0, has_next = 0;
    double next = NAN;
    begin(u, "update discrete states");
    if (!finish(u, fmi_update(u->handle, &terminates, &has_next, &next), expect(u, is_in(u, EVENT)))) return;
    u->is_updated = 1;
    u->next = has_next ? next : HUGE_VAL;
    if (has_next && !(next > u->t) && !u->is_odd) fail("the next event is not ahead");
    if (terminates) u->is_odd = 1;
}

static void action_enter_continuous(unit *u)
{
    enum expected expected = expect(u, is_in(u, EVENT));
    if (expected == DONE && !u->is_updated) expected = EITHER;
    begin(u, "enter continuous-time mode");
    if (finish(u, (int)fmi_enter_continuous(u->handle), expected)) u->mode = CONTINUOUS;
}

static void action_set_time(unit *u)
{
    const int modes = FMI == 3 ? CONTINUOUS : EVENT | CONTINUOUS;
    const double last = fmin(fmin(u->next, u->end), u->t + 0.01 * T_END);
    double t = uniform(u->t, last);
    int is_odd = !is_in(u, CONTINUOUS), is_good = 1;
    if (chance(6)) t = u->t + uniform(-1.0, 1.0) * T_END, is_odd = 1;
    if (chance(6)) t = no_number(), is_good = 0;
    begin(u, "set time");
    note(" %.17g", t);
    if (!finish(u, (int)fmi_set_time(u->handle, t), is_good && is_in(u, modes) ? DONE : REFUSED)) return;
    u->t = t;
    u->is_odd |= is_odd;
}

static void action_set_states(unit *u)
{
    const size_t n = N_RATES + (size_t)(chance(8) ? 1 + below(2) : 0) - (size_t)(N_RATES > 0 && chance(8));
    real *const x = (real *)room(n, sizeof(real));
    int is_good = n == N_RATES, is_number = 1;
    const int lacks = n > 0 && chance(5);
    size_t i;
    for (i = 0; i < n; ++i) x[i] = i < N_RATES ? state_values[i] + uniform(-0.1, 0.1) : 0.0;
    if (chance(5) && n > 0) x[below((int)n)] = wild();
    if (chance(5) && n > 0) x[below((int)n)] = no_number(), is_number = 0;
    begin(u, lacks ? "set states null" : "set states");
    is_good = is_good && !lacks && is_in(u, CONTINUOUS);
    u->may_discard = is_good && !is_number;
    if (finish(u, (int)fmi_set_states(u->handle, lacks ? NULL : x, n), is_good && is_number ? DONE : REFUSED)) {
        u->is_odd = 1; /* no motion leads there */
    }
    free(x);
}

static void action_vectors(unit *u)
{
    const int which = below(4), right = which == 2 ? N_INDICATORS : N_RATES;
    const size_t n = (size_t)(right + (chance(8) ? 1 : 0) - (right > 0 && chance(8)));
    real *const x = (real *)room(n, sizeof(real));
    const int lacks = n > 0 && chance(5);
    enum expected expected = expect(u, u->is_exchanged && is_in(u, KNOWN_STATES) && (int)n == right && !lacks);
    static const char *const names[] = {"states", "rates", "indicators", "nominals"};
    int status;
    size_t i;
    if (which == 3 && is_in(u, INSTANTIATED)) expected = EITHER;
    begin_evaluation(u, "read all");
    note(" %s %lu%s", names[which], (unsigned long)n, lacks ? " null" : "");
    switch (which) {
    case 0: status = (int)fmi_get_states(u->handle, lacks ? NULL : x, n); break;
    case 1: status = (int)fmi_get_rates(u->handle, lacks ? NULL : x, n); break;
    case 2: status = (int)fmi_get_indicators(u->handle, lacks ? NULL : x, n); break;
    default: status = (int)fmi_get_nominals(u->handle, lacks ? NULL : x, n); break;
    }
    if (finish(u, status, expected) && !u->is_odd) {
        for (i = 0; i < n; ++i) {
            if (!isfinite(x[i]) || (which == 3 && !(x[i] > 0.0))) fail("a value is no finite number");
        }
    }
    free(x);
}

static void action_completed(unit *u)
{
    int enters = 0, status;
    enum expected expected = expect(u, is_in(u, CONTINUOUS));
    begin(u, "completed step");
    if (chance(6)) {
        note(" null");
        expected = REFUSED;
        status = (int)FN(fmi2CompletedIntegratorStep, fmi3CompletedIntegratorStep)(u->handle, 1, NULL, NULL);
    } else {
        status = fmi_completed(u->handle, &enters);
    }
    if (finish(u, status, expected) && enters) action_enter_event(u);
}

/* Puts time and states along a straight line and reads the indicators there. */
static int look(unit *u, double t, const real *x, const real *dx, double h, real *g)
{
    real *const y = (real *)room(N_RATES, sizeof(real));
    int i, is_done = 1;
    for (i = 0; i < N_RATES; ++i) y[i] = x[i] + h * dx[i];
    begin(u, "set time in a step");
    finish(u, (int)fmi_set_time(u->handle, t + h), DONE);
    begin_evaluation(u, "set states in a step");
    is_done = finish(u, (int)fmi_set_states(u->handle, y, N_RATES), u->is_odd ? EITHER : DONE);
    begin_evaluation(u, "read indicators in a step");
    is_done = is_done && finish(u, (int)fmi_get_indicators(u->handle, g, N_INDICATORS), u->is_odd ? EITHER : DONE);
    free(y);
    u->t = t + h;
    return is_done;
}

static int is_crossed(const real *before, const real *after)
{
    int i;
    for (i = 0; i < N_INDICATORS; ++i) {
        if ((before[i] > 0.0) != (after[i] > 0.0)) return 1;
    }
    return 0;
}

/* One explicit Euler step of an importer, shortened to the first crossing of an indicator. */
static void euler(unit *u)
{
    const double t = u->t, wanted = uniform(1e-4, 1e-3) * LARGEST_STEP;
    double h = fmin(fmin(u->next, u->end) - t, wanted), low = 0.0;
    const int is_event = h < wanted;
    real *const x = (real *)room(N_RATES, sizeof(real));
    real *const dx = (real *)room(N_RATES, sizeof(real));
    real *const g = (real *)room(N_INDICATORS, sizeof(real));
    real *const after = (real *)room(N_INDICATORS, sizeof(real));
    const enum expected expected = expect(u, 1);
    int is_done, enters = 0, k;
    begin_evaluation(u, "read states");
    is_done = finish(u, (int)fmi_get_states(u->handle, x, N_RATES), expected);
    begin_evaluation(u, "read rates");
    is_done = is_done && finish(u, (int)fmi_get_rates(u->handle, dx, N_RATES), expected);
    is_done = is_done && h > 0.0 && look(u, t, x, dx, 0.0, g) && look(u, t, x, dx, h, after);
    if (is_done && is_crossed(g, after)) {
        enters = 1;
        for (k = 0; k < 45 && is_done; ++k) {
            const double middle = 0.5 * (low + h);
            is_done = look(u, t, x, dx, middle, after);
            if (is_crossed(g, after)) {
                h = middle;
            } else {
                low = middle;
            }
        }
        is_done = is_done && look(u, t, x, dx, h, after);
    }
    free(x);
    free(dx);
    free(g);
    free(after);
    if (!is_done) return;
    begin(u, "completed step of Euler");
    k = 0;
    if (!finish(u, fmi_completed(u->handle, &k), expected)) return;
    if (enters || k || is_event) action_enter_event(u);
    if (t + h >= u->end) action_terminate(u);
}

/* Co-Simulation. */

static void action_step(unit *u)
{
    const double longest = u->is_odd ? 1e-4 : pow(10.0, uniform(-4.0, -1.5));
    double h = longest * T_END, t = u->t, reached = NAN, from;
    const int fault = chance(15) ? 1 + below(6) : 0;
    int terminates = 0, is_early = 0, status, is_allowed = is_in(u, STEP);
    if (t + h > u->end) h = u->end - t;
    if (!(h > 1e-9 * T_END)) is_allowed = 0;
    if (fault == 1) h = 0.0;
    if (fault == 2) h = -h;
    if (fault == 3) h = no_number();
    if (fault == 4) t = no_number();
    if (fault == 5) t += 0.1 * T_END;
    if (fault == 6) h = u->end <= 1e300 ? 2.0 * T_END : no_number();
    begin(u, "step");
    note(" %.17g + %.17g", t, h);
    status = fmi_step(u->handle, t, h, &terminates, &is_early, &reached);
    if (!is_in(u, STEP) || fault > 0) {
        finish(u, status, REFUSED);
        return;
    }
    /* FMI 2 discards the step at whose end an event ends the simulation, too. */
    u->may_discard = u->is_odd || (FMI == 2 && terminates);
    if (!finish(u, status, !is_allowed || u->may_discard ? EITHER : DONE)) {
        if (status == DISCARD && !(reached > t && reached <= t + h)) fail("a discarded step reaches another time");
        from = u->t;
        u->is_odd = 1;
        read_time(u);
        /* In FMI 3 a discarded step leaves the state as it was. */
        if (FMI == 3 && status == DISCARD && u->t != from) fail("a discarded step moves the time");
        if (FMI == 2 && status == DISCARD && u->t != reached) fail("a discarded step is at another time");
        if (FMI == 2 && status == DISCARD) u->mode = FAILED;
        return;
    }
    if (!terminates && !is_early && !(fabs(reached - (t + h)) <= 1e-12 * T_END)) fail("the step ends elsewhere");
    u->t = reached;
    if (terminates) {
        u->is_odd = 1;
        read_time(u);
    }
}

/* Kept states. */

static void action_keep(unit *u)
{
    kept *const own = memories + below(N_KEPT);
    if (own->at != NULL && own->slot != (int)(u - units)) {
        free_memory(own);
    }
    begin(u, "keep a state");
    if (chance(5)) {
        finish(u, (int)fmi_get_memory(u->handle, NULL), REFUSED);
        return;
    }
    finish(u, (int)fmi_get_memory(u->handle, &own->at), DONE);
    if (own->at == NULL) fail("there is no kept state");
    own->slot = (int)(u - units);
    own->owner = *u;
    free(own->values);
    own->values = (real *)room(N_PARAMETERS + N_INPUTS, sizeof(real));
    read_given(u, own->values);
}

/* Takes a state over, and what is known of it. */
static void take_over(unit *u, const kept *own)
{
    real *values;
    u->mode = own->owner.mode;
    u->is_odd = own->owner.is_odd;
    u->is_updated = own->owner.is_updated;
    u->t = own->owner.t;
    u->next = own->owner.next;
    u->end = own->owner.end;
    u->is_set_up = own->owner.is_set_up;
    values = (real *)room(N_PARAMETERS + N_INPUTS, sizeof(real));
    read_given(u, values);
    if (memcmp(values, own->values, (N_PARAMETERS + N_INPUTS) * sizeof(real)) != 0) {
        fail("a recalled state has other parameters or inputs");
    }
    free(values);
}

static void action_recall(unit *u)
{
    const kept *const own = memories + below(N_KEPT);
    const int is_own = own->at != NULL && own->slot == (int)(u - units);
    begin(u, "recall a state");
    if (finish(u, (int)fmi_set_memory(u->handle, own->at), is_own ? DONE : REFUSED)) take_over(u, own);
}

/* Moves the state of another instance here, as bytes. */
static void action_move(unit *u)
{
    const kept *const own = memories + below(N_KEPT);
    unit *const from = units + own->slot;
    memory copy = NULL;
    size_t n = 0;
    byte *bytes;
    int is_same;
    if (own->at == NULL) return;
    is_same = own->owner.is_exchanged == u->is_exchanged;
    begin(from, "size of a state to be moved");
    finish(from, (int)fmi_memory_size(from->handle, own->at, &n), DONE);
    bytes = (byte *)room(n, 1);
    begin(from, "serialise a state to be moved");
    finish(from, (int)fmi_write_memory(from->handle, own->at, bytes, n), DONE);
    begin(u, "deserialise a moved state");
    finish(u, (int)fmi_read_memory(u->handle, bytes, n, &copy), DONE);
    begin(u, "recall a moved state");
    if (finish(u, (int)fmi_set_memory(u->handle, copy),
               is_same || !is_in(&own->owner, RUNNING | FAILED) ? DONE : REFUSED)) {
        take_over(u, own);
    }
    if (chance(80)) { /* others are freed with the instance */
        begin(u, "free a moved state");
        finish(u, (int)fmi_free_memory(u->handle, &copy), DONE);
    }
    free(bytes);
}

static void action_bytes(unit *u)
{
    kept *const own = memories + below(N_KEPT);
    const int fault = chance(40) ? 1 + below(6) : 0;
    size_t n = 0;
    byte *bytes;
    memory again = NULL;
    if (own->at == NULL || own->slot != (int)(u - units)) {
        begin(u, "serialise nothing");
        finish(u, (int)fmi_memory_size(u->handle, NULL, &n), REFUSED);
        return;
    }
    begin(u, "size of a state");
    finish(u, (int)fmi_memory_size(u->handle, own->at, &n), DONE);
    bytes = (byte *)room(n, 1);
    memset(bytes, 0, n);
    begin(u, "serialise");
    note(" fault %d", fault);
    if (fault == 1) {
        finish(u, (int)fmi_write_memory(u->handle, own->at, bytes, n - 1), REFUSED);
    } else if (fault == 2) {
        finish(u, (int)fmi_write_memory(u->handle, own->at, NULL, n), REFUSED);
    } else if (fault == 3) {
        finish(u, (int)fmi_write_memory(u->handle, NULL, bytes, n), REFUSED);
    }
    begin(u, "serialise");
    finish(u, (int)fmi_write_memory(u->handle, own->at, bytes, n), DONE);
    begin(u, "deserialise");
    if (fault == 4) {
        finish(u, (int)fmi_read_memory(u->handle, bytes, n - 1, &again), REFUSED);
    } else if (fault == 5) {
        finish(u, (int)fmi_read_memory(u->handle, bytes, n, NULL), REFUSED);
    } else if (fault == 6) {
        /* Bytes that a file or a connection has spoiled are no state. */
        const size_t from = (size_t)(random_bits() % n), length = 1 + (size_t)below(8);
        size_t i;
        for (i = from; i < n && i < from + length; ++i) bytes[i] = (byte)(bytes[i] ^ (byte)(1 + below(255)));
        note(" spoiled from %lu on", (unsigned long)from);
        finish(u, (int)fmi_read_memory(u->handle, bytes, n, &again), REFUSED);
        if (again != NULL) fail("spoiled bytes leave a state");
    } else {
        finish(u, (int)fmi_read_memory(u->handle, bytes, n, &again), DONE);
        begin(u, "recall deserialised bytes");
        if (finish(u, (int)fmi_set_memory(u->handle, again), DONE)) {
            take_over(u, own);
        }
        fmi_free_memory(u->handle, &again);
    }
    free(bytes);
}

/* What the unit has not, and null instances. */

static void action_foreign(unit *u)
{
    const char *const good[] = {"logEvents"}, *const bad[] = {"logEverything"}, *const missing[] = {NULL};
    const reference ref = 0;
    double value = 0.0;
    const int which = below(16), n = below(2);
    enum expected of_none = n == 0 ? DONE : REFUSED;
    begin(u, "foreign");
    note(" %d %d", which, n);
    switch (which) {
    case 0:
        finish(u, (int)fmi_log(u->handle, 1, 1, good), DONE);
        u->is_logging = 1;
        return;
    case 1: finish(u, (int)fmi_log(u->handle, 1, 1, bad), REFUSED); return;
    case 2: finish(u, (int)fmi_log(u->handle, chance(50), 1, missing), REFUSED); return;
    case 3: {
        const int is_logging = chance(50);
        if (finish(u, (int)fmi_log(u->handle, is_logging, (size_t)n, NULL), of_none)) u->is_logging = is_logging;
        return;
    }
    case 4:
        if (fmi_set_time(NULL, 0.0) != ERROR || fmi_get(NULL, &ref, 1, &value, 1) != ERROR ||
            fmi_reset(NULL) != ERROR || fmi_terminate(NULL) != ERROR ||
            fmi_set_memory(NULL, NULL) != ERROR) {
            fail("a null instance is taken");
        }
        fmi_free(NULL);
        note(" null\n");
        return;
#if FMI == 3
    case 5: {
        fmi3Boolean flag = false;
        finish(u, (int)fmi3GetBoolean(u->handle, n == 0 ? NULL : &ref, (size_t)n, n == 0 ? NULL : &flag, (size_t)n), of_none);
        return;
    }
    case 6: {
        const fmi3Int32 number = 1;
        finish(u, (int)fmi3SetInt32(u->handle, &ref, (size_t)n, &number, (size_t)n), of_none);
        return;
    }
    case 7: {
        fmi3String text = NULL;
        finish(u, (int)fmi3GetString(u->handle, &ref, (size_t)n, &text, (size_t)n), of_none);
        return;
    }
    case 8: {
        fmi3Clock clock = false;
        finish(u, (int)fmi3GetClock(u->handle, &ref, (size_t)n, &clock), of_none);
        return;
    }
    case 9: finish(u, (int)fmi3EnterConfigurationMode(u->handle), REFUSED); return;
    case 10: finish(u, (int)fmi3EnterStepMode(u->handle), REFUSED); return;
    case 11:
        finish(u, (int)fmi3EvaluateDiscreteStates(u->handle), is_in(u, INITIALIZATION | EVENT) ? DONE : REFUSED);
        return;
    case 12: finish(u, (int)fmi3ActivateModelPartition(u->handle, 0, u->t), REFUSED); return;
    case 13: {
        const fmi3Int32 order = 1;
        finish(u, (int)fmi3GetOutputDerivatives(u->handle, &ref, 1, &order, &value, 1), REFUSED);
        return;
    }
    case 14: {
        size_t many = 0;
        finish(u, (int)fmi3GetNumberOfContinuousStates(u->handle, n == 0 ? &many : NULL), of_none);
        if (n == 0 && many != N_RATES) fail("the number of states is another one");
        return;
    }
    default: {
        bool flag = false;
        finish(u, (int)fmi3DoStep(u->handle, u->t, 1e-6, true, n == 0 ? NULL : &flag, &flag, NULL, &value), REFUSED);
        return;
    }
#else
    case 5: {
        fmi2Boolean flag = 0;
        finish(u, (int)fmi2GetBoolean(u->handle, n == 0 ? NULL : &ref, (size_t)n, n == 0 ? NULL : &flag), of_none);
        return;
    }
    case 6: {
        const fmi2Integer number = 1;
        finish(u, (int)fmi2SetInteger(u->handle, &ref, (size_t)n, &number), of_none);
        return;
    }
    case 7: {
        fmi2String text = NULL;
        finish(u, (int)fmi2GetString(u->handle, &ref, (size_t)n, &text), of_none);
        return;
    }
    case 8: finish(u, (int)fmi2CancelStep(u->handle), REFUSED); return;
    case 9: {
        const fmi2Integer order = 1;
        finish(u, (int)fmi2SetRealInputDerivatives(u->handle, &ref, 1, &order, &value), REFUSED);
        return;
    }
    case 10: {
        fmi2Status status = fmi2OK;
        u->may_discard = is_in(u, STEP | FAILED | TERMINATED);
        finish(u, (int)fmi2GetStatus(u->handle, fmi2DoStepStatus, &status), REFUSED);
        return;
    }
    case 11:
        finish(u, (int)fmi2GetRealStatus(u->handle, fmi2LastSuccessfulTime, n == 0 ? &value : NULL),
               n == 1 || !is_in(u, STEP | FAILED | TERMINATED) ? REFUSED : u->is_exchanged ? EITHER : DONE);
        return;
    case 12:
        u->may_discard = is_in(u, STEP | FAILED | TERMINATED);
        finish(u, (int)fmi2GetRealStatus(u->handle, (fmi2StatusKind)9, &value), REFUSED);
        return;
    case 13: finish(u, (int)fmi2NewDiscreteStates(u->handle, NULL), REFUSED); return;
    default: {
        fmi2String text = NULL;
        u->may_discard = is_in(u, STEP | FAILED | TERMINATED);
        finish(u, (int)fmi2GetStringStatus(u->handle, fmi2PendingStatus, &text), REFUSED);
        return;
    }
#endif
    }
}

/* What an importer would do next. */
static void go_on(unit *u)
{
    switch (u->mode) {
    case INSTANTIATED: action_begin(u); break;
    case INITIALIZATION: action_exit(u); break;
    case EVENT:
        if (u->is_updated) {
            action_enter_continuous(u);
        } else {
            action_update(u);
        }
        break;
    case CONTINUOUS: euler(u); break;
    case STEP: action_step(u); break;
    default: action_reset(u); break;
    }
}

static void (*const actions[])(unit *) = {
    action_get, action_get, action_set, action_set, action_derivatives, action_begin, action_exit, action_terminate,
    action_enter_event, action_update, action_enter_continuous, action_set_time, action_set_states,
    action_vectors, action_vectors, action_completed, action_step, action_keep, action_keep, action_recall,
    action_move, action_bytes, action_foreign, action_foreign,
};

static void run_sequence(int length)
{
    int i;
    for (i = 0; i < length; ++i) {
        unit *const u = units + below(N_UNITS);
        if (u->handle == NULL) {
            instantiate(u);
        } else if (chance(1)) {
            free_unit(u);
        } else if (chance(2)) {
            action_reset(u);
        } else if (chance(45)) {
            go_on(u);
        } else {
            actions[below((int)(sizeof(actions) / sizeof(actions[0])))](u);
        }
    }
    for (i = 0; i < N_UNITS; ++i) free_unit(units + i);
}

int main(int argc, char **argv)
{
    const unsigned long long first = argc > 1 ? strtoull(argv[1], NULL, 10) : 1;
    const unsigned long long n = argc > 2 ? strtoull(argv[2], NULL, 10) : 10;
    const int length = argc > 3 ? atoi(argv[3]) : 120;
    unsigned long long k;
    __sanitizer_set_death_callback(tell);
    for (k = first; k < first + n; ++k) {
        seed = k;
        n_trace = 0;
        state_of_random = (k + 1) * 0x9E3779B97F4A7C15ULL;
        run_sequence(length);
        if (__lsan_do_recoverable_leak_check() != 0) fail("memory is left");
    }
    printf("%llu sequences\n", n);
    return 0;
}
