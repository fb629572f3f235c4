/* fmi3.c: the functions of the Functional Mock-up Interface 3.0 for an instance.
 * Part of the runtime of cotree, the same for every model. */
#include "cotree_fmi3.h"
#include "fmu_states.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* An instance and the callbacks of its importer. */
typedef struct instance {
    fmu *m;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    int is_logging;
    fmu_states states;
} instance;

static void log_message(void *environment, enum fmu_severity severity, const char *message)
{
    static const fmi3Status statuses[] = {fmi3OK, fmi3Discard, fmi3Error};
    const instance *const own = (const instance *)environment;
    /* Errors are logged even if logging is off, as the standard requires. */
    if (own->log == NULL || !(severity == FMU_ERROR || own->is_logging)) return;
    own->log(own->environment, statuses[severity], fmu_category_of(severity), message);
}

/* A discarded call may succeed with other values, after a smaller step. */
static fmi3Status status_of(const fmu *m, int result)
{
    return result == 0 ? fmi3OK : m->is_discarded ? fmi3Discard : fmi3Error;
}

/* Start a call: reject it without an instance, or in a mode that does not allow it. */
#define BEGIN(name, modes)                                                                         \
    fmu *const m = handle == NULL ? NULL : ((instance *)handle)->m;                                \
    if (m == NULL || fmu_check(m, name, modes) != 0) return fmi3Error

/* Start a call whose values may be discarded in Model Exchange, where the importer chooses the
 * step. */
#define BEGIN_EVALUATION(name, modes)                                                              \
    BEGIN(name, modes);                                                                            \
    m->may_discard = m->is_exchanged

#define STATES (&((instance *)handle)->states)
#define ANY (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_RUNNING | FMU_TERMINATED)
#define WRITABLE (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_RUNNING)
#define KNOWN_STATES (FMU_INITIALIZATION | FMU_EVENT | FMU_CONTINUOUS | FMU_TERMINATED)
#define WITH_DERIVATIVES (FMU_INITIALIZATION | FMU_RUNNING | FMU_TERMINATED)

COTREE_FMI_EXPORT const char *FMI3(fmi3GetVersion)(void) { return "3.0"; }

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetDebugLogging)(fmi3Instance handle, fmi3Boolean is_logging,
                                                       size_t n_categories,
                                                       const fmi3String categories[])
{
    size_t i;
    BEGIN("fmi3SetDebugLogging", ANY);
    if (n_categories > 0 && fmu_check_pointer(m, "fmi3SetDebugLogging", categories) != 0)
        return fmi3Error;
    for (i = 0; i < n_categories; ++i) {
        if (!fmu_is_category(categories[i])) {
            return status_of(m, fmu_refuse(m, "there is no log category '%.100s'",
                                           categories[i] == NULL ? "" : categories[i]));
        }
    }
    ((instance *)handle)->is_logging = is_logging;
    return fmi3OK;
}

/* Instances. */

static fmi3Instance instantiate(fmi3String name, fmi3String token, int is_exchanged,
                                int returns_early, fmi3Boolean is_logging,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    const fmu_tables *const tables = fmu_tables_of_model();
    instance *const own = (instance *)calloc(1, sizeof(instance));
    const char *why = NULL;
    if (own == NULL) return NULL;
    own->log = log;
    own->environment = environment;
    own->is_logging = is_logging;
    if (name == NULL || name[0] == '\0') {
        why = "the instance has no name";
    } else if (token == NULL || strcmp(token, tables->token) != 0) {
        why = "the instantiation token is not that of this unit";
    } else if (is_exchanged ? !tables->is_exchangeable : tables->stepper == NULL) {
        why = "the unit was exported without this interface type";
    } else {
        own->m = fmu_new(tables, is_exchanged, returns_early, log_message, own);
        if (own->m == NULL) why = "there is no memory";
    }
    if (why == NULL) return own;
    log_message(own, FMU_ERROR, why);
    free(own);
    return NULL;
}

COTREE_FMI_EXPORT fmi3Instance FMI3(fmi3InstantiateModelExchange)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean is_visible,
    fmi3Boolean is_logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    (void)resources;
    (void)is_visible;
    return instantiate(name, token, 1, 0, is_logging, environment, log);
}

COTREE_FMI_EXPORT fmi3Instance FMI3(fmi3InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean is_visible,
    fmi3Boolean is_logging, fmi3Boolean uses_event_mode, fmi3Boolean is_early_return_allowed,
    const fmi3ValueReference intermediate[], size_t n_intermediate,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback intermediate_update)
{
    (void)resources;
    (void)is_visible;
    (void)intermediate;
    (void)intermediate_update;
    if (uses_event_mode || n_intermediate > 0) {
        if (log != NULL) {
            log(environment, fmi3Error, "logStatusError",
                uses_event_mode
                    ? "events happen inside steps: there is no Event Mode in Co-Simulation"
                    : "there are no intermediate variables");
        }
        return NULL;
    }
    return instantiate(name, token, 0, is_early_return_allowed, is_logging, environment, log);
}

COTREE_FMI_EXPORT fmi3Instance FMI3(fmi3InstantiateScheduledExecution)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean is_visible,
    fmi3Boolean is_logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback clock_update, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock)
{
    (void)name;
    (void)token;
    (void)resources;
    (void)is_visible;
    (void)is_logging;
    (void)clock_update;
    (void)lock;
    (void)unlock;
    if (log != NULL) {
        log(environment, fmi3Error, "logStatusError", "the unit has no Scheduled Execution");
    }
    return NULL;
}

COTREE_FMI_EXPORT void FMI3(fmi3FreeInstance)(fmi3Instance handle)
{
    if (handle == NULL) return;
    fmu_states_free_all(STATES);
    fmu_free(((instance *)handle)->m);
    free(handle);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3EnterInitializationMode)(fmi3Instance handle,
                                                               fmi3Boolean has_tolerance,
                                                               fmi3Float64 tolerance,
                                                               fmi3Float64 begin,
                                                               fmi3Boolean has_end, fmi3Float64 end)
{
    BEGIN("fmi3EnterInitializationMode", FMU_INSTANTIATED);
    if (fmu_set_up(m, begin, has_end ? end : HUGE_VAL,
                   has_tolerance ? tolerance : m->tables->rtol) != 0)
        return fmi3Error;
    return status_of(m, fmu_begin(m));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3ExitInitializationMode)(fmi3Instance handle)
{
    BEGIN("fmi3ExitInitializationMode", FMU_INITIALIZATION);
    return status_of(m, fmu_leave_initialization(m));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3EnterEventMode)(fmi3Instance handle)
{
    BEGIN("fmi3EnterEventMode", FMU_CONTINUOUS);
    fmu_enter(m, FMU_EVENT);
    return fmi3OK;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3Terminate)(fmi3Instance handle)
{
    BEGIN("fmi3Terminate", FMU_RUNNING);
    fmu_enter(m, FMU_TERMINATED);
    return fmi3OK;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3Reset)(fmi3Instance handle)
{
    BEGIN("fmi3Reset", ANY);
    fmu_reset(m);
    return fmi3OK;
}

/* Variables, all of type Float64. */

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetFloat64)(fmi3Instance handle,
                                                  const fmi3ValueReference references[], size_t n,
                                                  fmi3Float64 values[], size_t n_values)
{
    BEGIN_EVALUATION("fmi3GetFloat64", ANY);
    if (n != n_values)
        return status_of(m, fmu_refuse(m, "fmi3GetFloat64: every variable has one value"));
    if (n == 0) return fmi3OK;
    if (fmu_check_pointer(m, "fmi3GetFloat64", references) != 0) return fmi3Error;
    if (fmu_check_pointer(m, "fmi3GetFloat64", values) != 0) return fmi3Error;
    return status_of(m, fmu_get(m, references, n, values));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetFloat64)(fmi3Instance handle,
                                                  const fmi3ValueReference references[], size_t n,
                                                  const fmi3Float64 values[], size_t n_values)
{
    BEGIN("fmi3SetFloat64", WRITABLE);
    if (n != n_values)
        return status_of(m, fmu_refuse(m, "fmi3SetFloat64: every variable has one value"));
    if (n == 0) return fmi3OK;
    if (fmu_check_pointer(m, "fmi3SetFloat64", references) != 0) return fmi3Error;
    if (fmu_check_pointer(m, "fmi3SetFloat64", values) != 0) return fmi3Error;
    return status_of(m, fmu_set(m, references, n, values));
}

static fmi3Status refuse_type(fmi3Instance handle, const char *function, size_t n)
{
    BEGIN(function, ANY);
    return n == 0
               ? fmi3OK
               : status_of(m, fmu_refuse(m, "%s: every variable is of the type Float64", function));
}

/* Functions of types that no variable has. */
#define UNUSED_TYPE(type)                                                                          \
    COTREE_FMI_EXPORT fmi3Status FMI3(fmi3Get##type)(                                              \
        fmi3Instance handle, const fmi3ValueReference references[], size_t n, fmi3##type values[], \
        size_t n_values)                                                                           \
    {                                                                                              \
        (void)references;                                                                          \
        (void)values;                                                                              \
        (void)n_values;                                                                            \
        return refuse_type(handle, "fmi3Get" #type, n);                                            \
    }                                                                                              \
                                                                                                   \
    COTREE_FMI_EXPORT fmi3Status FMI3(fmi3Set##type)(                                              \
        fmi3Instance handle, const fmi3ValueReference references[], size_t n,                      \
        const fmi3##type values[], size_t n_values)                                                \
    {                                                                                              \
        (void)references;                                                                          \
        (void)values;                                                                              \
        (void)n_values;                                                                            \
        return refuse_type(handle, "fmi3Set" #type, n);                                            \
    }

UNUSED_TYPE(Float32)
UNUSED_TYPE(Int8)
UNUSED_TYPE(UInt8)
UNUSED_TYPE(Int16)
UNUSED_TYPE(UInt16)
UNUSED_TYPE(Int32)
UNUSED_TYPE(UInt32)
UNUSED_TYPE(Int64)
UNUSED_TYPE(UInt64)
UNUSED_TYPE(Boolean)
UNUSED_TYPE(String)
#undef UNUSED_TYPE

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetBinary)(fmi3Instance handle,
                                                 const fmi3ValueReference references[], size_t n,
                                                 size_t sizes[], fmi3Binary values[],
                                                 size_t n_values)
{
    (void)references;
    (void)sizes;
    (void)values;
    (void)n_values;
    return refuse_type(handle, "fmi3GetBinary", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetBinary)(fmi3Instance handle,
                                                 const fmi3ValueReference references[], size_t n,
                                                 const size_t sizes[], const fmi3Binary values[],
                                                 size_t n_values)
{
    (void)references;
    (void)sizes;
    (void)values;
    (void)n_values;
    return refuse_type(handle, "fmi3SetBinary", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetClock)(fmi3Instance handle,
                                                const fmi3ValueReference references[], size_t n,
                                                fmi3Clock values[])
{
    (void)references;
    (void)values;
    return refuse_type(handle, "fmi3GetClock", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetClock)(fmi3Instance handle,
                                                const fmi3ValueReference references[], size_t n,
                                                const fmi3Clock values[])
{
    (void)references;
    (void)values;
    return refuse_type(handle, "fmi3SetClock", n);
}

/* The model description lists dependencies; no variable is an array. */

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetNumberOfVariableDependencies)(fmi3Instance handle,
                                                                       fmi3ValueReference reference,
                                                                       size_t *n)
{
    (void)reference;
    (void)n;
    return refuse_type(handle, "fmi3GetNumberOfVariableDependencies", 1);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetVariableDependencies)(fmi3Instance handle,
                                                               fmi3ValueReference dependent,
                                                               size_t of_dependent[],
                                                               fmi3ValueReference independents[],
                                                               size_t of_independents[],
                                                               fmi3DependencyKind kinds[], size_t n)
{
    (void)dependent;
    (void)of_dependent;
    (void)independents;
    (void)of_independents;
    (void)kinds;
    (void)n;
    return refuse_type(handle, "fmi3GetVariableDependencies", 1);
}

/* State. */

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetFMUState)(fmi3Instance handle, fmi3FMUState *place)
{
    BEGIN("fmi3GetFMUState", ANY);
    return status_of(m, fmu_states_save(m, STATES, "fmi3GetFMUState", place));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetFMUState)(fmi3Instance handle, fmi3FMUState from)
{
    BEGIN("fmi3SetFMUState", ANY);
    return status_of(m, fmu_states_restore(m, STATES, "fmi3SetFMUState", from));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3FreeFMUState)(fmi3Instance handle, fmi3FMUState *place)
{
    BEGIN("fmi3FreeFMUState", ANY);
    return status_of(m, fmu_states_free(m, STATES, "fmi3FreeFMUState", place));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SerializedFMUStateSize)(fmi3Instance handle,
                                                              fmi3FMUState from, size_t *n)
{
    BEGIN("fmi3SerializedFMUStateSize", ANY);
    return status_of(m, fmu_states_size(m, STATES, "fmi3SerializedFMUStateSize", from, n));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SerializeFMUState)(fmi3Instance handle, fmi3FMUState from,
                                                         fmi3Byte bytes[], size_t n)
{
    BEGIN("fmi3SerializeFMUState", ANY);
    return status_of(m, fmu_states_write(m, STATES, "fmi3SerializeFMUState", from, bytes, n));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3DeserializeFMUState)(fmi3Instance handle,
                                                           const fmi3Byte bytes[], size_t n,
                                                           fmi3FMUState *place)
{
    BEGIN("fmi3DeserializeFMUState", ANY);
    return status_of(m, fmu_states_read(m, STATES, "fmi3DeserializeFMUState", bytes, n, place));
}

/* Derivatives. */

/* The arguments of a directional or adjoint derivative. */
typedef struct direction {
    const fmi3ValueReference *unknowns, *knowns;
    const fmi3Float64 *seed;
    fmi3Float64 *sensitivity;
    size_t n_unknowns, n_knowns, n_seed, n_sensitivity;
} direction;

/* Reject missing arrays, and lengths of seed and sensitivity other than n_seed and
 * n_sensitivity. */
static int check_direction(const fmu *m, const char *name, const direction *own, size_t n_seed,
                           size_t n_sensitivity)
{
    if (own->n_seed != n_seed || own->n_sensitivity != n_sensitivity) {
        return fmu_refuse(m, "%s: every variable has one value", name);
    }
    if ((own->n_unknowns > 0 && own->unknowns == NULL) ||
        (own->n_knowns > 0 && own->knowns == NULL) || (n_seed > 0 && own->seed == NULL) ||
        (n_sensitivity > 0 && own->sensitivity == NULL)) {
        return fmu_check_pointer(m, name, NULL);
    }
    return 0;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetDirectionalDerivative)(
    fmi3Instance handle, const fmi3ValueReference unknowns[], size_t n_unknowns,
    const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
    fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    const direction own = {unknowns,   knowns,   seed,   sensitivity,
                           n_unknowns, n_knowns, n_seed, n_sensitivity};
    BEGIN_EVALUATION("fmi3GetDirectionalDerivative", WITH_DERIVATIVES);
    if (check_direction(m, "fmi3GetDirectionalDerivative", &own, n_knowns, n_unknowns) != 0)
        return status_of(m, 1);
    return status_of(m,
                     fmu_directional(m, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetAdjointDerivative)(
    fmi3Instance handle, const fmi3ValueReference unknowns[], size_t n_unknowns,
    const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
    fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    const direction own = {unknowns,   knowns,   seed,   sensitivity,
                           n_unknowns, n_knowns, n_seed, n_sensitivity};
    BEGIN_EVALUATION("fmi3GetAdjointDerivative", WITH_DERIVATIVES);
    if (check_direction(m, "fmi3GetAdjointDerivative", &own, n_unknowns, n_knowns) != 0)
        return status_of(m, 1);
    return status_of(m, fmu_adjoint(m, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity));
}

/* Nothing can be configured, and there are no clocks. */

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3EnterConfigurationMode)(fmi3Instance handle)
{
    BEGIN("fmi3EnterConfigurationMode", 0);
    return fmi3Error;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3ExitConfigurationMode)(fmi3Instance handle)
{
    BEGIN("fmi3ExitConfigurationMode", 0);
    return fmi3Error;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetIntervalDecimal)(fmi3Instance handle,
                                                          const fmi3ValueReference references[],
                                                          size_t n, fmi3Float64 intervals[],
                                                          fmi3IntervalQualifier qualifiers[])
{
    (void)references;
    (void)intervals;
    (void)qualifiers;
    return refuse_type(handle, "fmi3GetIntervalDecimal", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetIntervalFraction)(fmi3Instance handle,
                                                           const fmi3ValueReference references[],
                                                           size_t n, fmi3UInt64 counters[],
                                                           fmi3UInt64 resolutions[],
                                                           fmi3IntervalQualifier qualifiers[])
{
    (void)references;
    (void)counters;
    (void)resolutions;
    (void)qualifiers;
    return refuse_type(handle, "fmi3GetIntervalFraction", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetIntervalDecimal)(fmi3Instance handle,
                                                          const fmi3ValueReference references[],
                                                          size_t n, const fmi3Float64 values[])
{
    (void)references;
    (void)values;
    return refuse_type(handle, "fmi3SetIntervalDecimal", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetIntervalFraction)(fmi3Instance handle,
                                                           const fmi3ValueReference references[],
                                                           size_t n, const fmi3UInt64 counters[],
                                                           const fmi3UInt64 resolutions[])
{
    (void)references;
    (void)counters;
    (void)resolutions;
    return refuse_type(handle, "fmi3SetIntervalFraction", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetShiftDecimal)(fmi3Instance handle,
                                                       const fmi3ValueReference references[],
                                                       size_t n, fmi3Float64 values[])
{
    (void)references;
    (void)values;
    return refuse_type(handle, "fmi3GetShiftDecimal", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetShiftFraction)(fmi3Instance handle,
                                                        const fmi3ValueReference references[],
                                                        size_t n, fmi3UInt64 counters[],
                                                        fmi3UInt64 resolutions[])
{
    (void)references;
    (void)counters;
    (void)resolutions;
    return refuse_type(handle, "fmi3GetShiftFraction", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetShiftDecimal)(fmi3Instance handle,
                                                       const fmi3ValueReference references[],
                                                       size_t n, const fmi3Float64 values[])
{
    (void)references;
    (void)values;
    return refuse_type(handle, "fmi3SetShiftDecimal", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetShiftFraction)(fmi3Instance handle,
                                                        const fmi3ValueReference references[],
                                                        size_t n, const fmi3UInt64 counters[],
                                                        const fmi3UInt64 resolutions[])
{
    (void)references;
    (void)counters;
    (void)resolutions;
    return refuse_type(handle, "fmi3SetShiftFraction", n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3EvaluateDiscreteStates)(fmi3Instance handle)
{
    BEGIN("fmi3EvaluateDiscreteStates", FMU_INITIALIZATION | FMU_EVENT);
    return fmi3OK;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3ActivateModelPartition)(fmi3Instance handle,
                                                              fmi3ValueReference clock,
                                                              fmi3Float64 t)
{
    (void)clock;
    (void)t;
    return refuse_type(handle, "fmi3ActivateModelPartition", 1);
}

/* Model Exchange. */

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3UpdateDiscreteStates)(
    fmi3Instance handle, fmi3Boolean *needs_another, fmi3Boolean *terminates,
    fmi3Boolean *are_nominals_changed, fmi3Boolean *are_states_changed, fmi3Boolean *has_next,
    fmi3Float64 *next)
{
    fmu_event_info news = {0, 0, 0, 0.0};
    BEGIN("fmi3UpdateDiscreteStates", FMU_EVENT);
    if (needs_another == NULL || terminates == NULL || are_nominals_changed == NULL ||
        are_states_changed == NULL || has_next == NULL || next == NULL) {
        return status_of(m, fmu_check_pointer(m, "fmi3UpdateDiscreteStates", NULL));
    }
    if (fmu_update(m, &news) != 0) return fmi3Error;
    *needs_another = false;
    *terminates = news.terminates != 0;
    *are_nominals_changed = false;
    *are_states_changed = news.are_states_changed != 0;
    *has_next = news.has_next != 0;
    *next = news.has_next ? news.next : 0.0;
    return fmi3OK;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3EnterContinuousTimeMode)(fmi3Instance handle)
{
    BEGIN("fmi3EnterContinuousTimeMode", FMU_EVENT);
    if (fmu_leave_event_mode(m) != 0) return fmi3Error;
    return fmi3OK;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3CompletedIntegratorStep)(fmi3Instance handle,
                                                               fmi3Boolean keeps_no_state,
                                                               fmi3Boolean *enters_event_mode,
                                                               fmi3Boolean *terminates)
{
    int enters = 0;
    BEGIN("fmi3CompletedIntegratorStep", FMU_CONTINUOUS);
    (void)keeps_no_state;
    if (fmu_check_pointer(m, "fmi3CompletedIntegratorStep", enters_event_mode) != 0)
        return fmi3Error;
    if (fmu_check_pointer(m, "fmi3CompletedIntegratorStep", terminates) != 0) return fmi3Error;
    if (fmu_complete_step(m, &enters) != 0) return fmi3Error;
    *enters_event_mode = enters != 0;
    *terminates = false;
    return fmi3OK;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetTime)(fmi3Instance handle, fmi3Float64 t)
{
    BEGIN("fmi3SetTime", FMU_CONTINUOUS);
    return status_of(m, fmu_set_time(m, t));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3SetContinuousStates)(fmi3Instance handle,
                                                           const fmi3Float64 x[], size_t n)
{
    BEGIN_EVALUATION("fmi3SetContinuousStates", FMU_CONTINUOUS);
    if (n > 0 && fmu_check_pointer(m, "fmi3SetContinuousStates", x) != 0) return fmi3Error;
    return status_of(m, fmu_set_states(m, x, n));
}

/* Call a function of Model Exchange that writes n numbers. */
static fmi3Status get_numbers(fmi3Instance handle, const char *name,
                              int (*get)(fmu *m, double *values, size_t n), fmi3Float64 values[],
                              size_t n)
{
    BEGIN_EVALUATION(name, KNOWN_STATES);
    if (!m->is_exchanged) return status_of(m, fmu_refuse(m, "%s belongs to Model Exchange", name));
    if (n > 0 && fmu_check_pointer(m, name, values) != 0) return fmi3Error;
    return status_of(m, get(m, values, n));
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetContinuousStateDerivatives)(fmi3Instance handle,
                                                                     fmi3Float64 values[], size_t n)
{
    return get_numbers(handle, "fmi3GetContinuousStateDerivatives", fmu_get_rates, values, n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetEventIndicators)(fmi3Instance handle, fmi3Float64 values[],
                                                          size_t n)
{
    return get_numbers(handle, "fmi3GetEventIndicators", fmu_get_indicators, values, n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetContinuousStates)(fmi3Instance handle,
                                                           fmi3Float64 values[], size_t n)
{
    return get_numbers(handle, "fmi3GetContinuousStates", fmu_get_states, values, n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetNominalsOfContinuousStates)(fmi3Instance handle,
                                                                     fmi3Float64 values[], size_t n)
{
    return get_numbers(handle, "fmi3GetNominalsOfContinuousStates", fmu_get_nominals, values, n);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetNumberOfEventIndicators)(fmi3Instance handle, size_t *n)
{
    BEGIN("fmi3GetNumberOfEventIndicators", ANY);
    if (fmu_check_pointer(m, "fmi3GetNumberOfEventIndicators", n) != 0) return fmi3Error;
    *n = (size_t)(m->offsets[FMU_INDICATORS + 1] - m->offsets[FMU_INDICATORS]);
    return fmi3OK;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetNumberOfContinuousStates)(fmi3Instance handle, size_t *n)
{
    BEGIN("fmi3GetNumberOfContinuousStates", ANY);
    if (fmu_check_pointer(m, "fmi3GetNumberOfContinuousStates", n) != 0) return fmi3Error;
    *n = (size_t)(m->offsets[FMU_RATES + 1] - m->offsets[FMU_RATES]);
    return fmi3OK;
}

/* Co-Simulation. */

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3EnterStepMode)(fmi3Instance handle)
{
    BEGIN("fmi3EnterStepMode", 0);
    return fmi3Error;
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3GetOutputDerivatives)(fmi3Instance handle,
                                                            const fmi3ValueReference references[],
                                                            size_t n, const fmi3Int32 orders[],
                                                            fmi3Float64 values[], size_t n_values)
{
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    (void)n_values;
    return refuse_type(handle, "fmi3GetOutputDerivatives", 1);
}

COTREE_FMI_EXPORT fmi3Status FMI3(fmi3DoStep)(fmi3Instance handle, fmi3Float64 t, fmi3Float64 step,
                                              fmi3Boolean keeps_no_state,
                                              fmi3Boolean *needs_event_mode,
                                              fmi3Boolean *terminates, fmi3Boolean *is_early,
                                              fmi3Float64 *reached)
{
    int is_short = 0, result;
    BEGIN("fmi3DoStep", FMU_STEP);
    (void)keeps_no_state;
    if (needs_event_mode == NULL || terminates == NULL || is_early == NULL || reached == NULL) {
        return status_of(m, fmu_check_pointer(m, "fmi3DoStep", NULL));
    }
    fmu_save_state(m, m->spare);
    result = fmu_step(m, t, step, &is_short, reached);
    *needs_event_mode = false;
    *terminates = m->numbers[FMU_HAS_ENDED] != 0.0;
    *is_early = is_short != 0;
    /* A discarded step leaves the state unchanged, so that a shorter one may follow. */
    if (m->is_discarded) fmu_restore_state(m, m->spare, m->n_saved);
    return status_of(m, result);
}
