/* fmi2.c: the functions of the Functional Mock-up Interface 2.0 for an instance.
 * Part of the runtime of cotree, the same for every model. */
#include "cotree_fmi2.h"
#include "fmu_states.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* An instance and the callbacks of its importer. */
typedef struct instance {
    fmu *m;
    fmi2CallbackLogger log;
    fmi2ComponentEnvironment environment;
    char *name;
    int is_logging;
    fmu_states states;
} instance;

static void log_message(void *environment, enum fmu_severity severity, const char *message)
{
    static const fmi2Status statuses[] = {fmi2OK, fmi2Discard, fmi2Error};
    const instance *const own = (const instance *)environment;
    /* Errors are logged even if logging is off, as the standard requires. */
    if (own->log == NULL || !(severity == FMU_ERROR || own->is_logging)) return;
    /* A message is an argument, not a format: names in it may contain a percent sign. */
    own->log(own->environment, own->name, statuses[severity], fmu_category_of(severity), "%s",
             message);
}

/* A discarded call may succeed with other values, after a smaller step. */
static fmi2Status status_of(const fmu *m, int result)
{
    return result == 0 ? fmi2OK : m->is_discarded ? fmi2Discard : fmi2Error;
}

/* Start a call: reject it without an instance, or in a mode that does not allow it. */
#define BEGIN(name, modes)                                                                         \
    fmu *const m = handle == NULL ? NULL : ((instance *)handle)->m;                                \
    if (m == NULL || fmu_check(m, name, modes) != 0) return fmi2Error

/* Start a call whose values may be discarded in Model Exchange, where the importer chooses the
 * step. */
#define BEGIN_EVALUATION(name, modes)                                                              \
    BEGIN(name, modes);                                                                            \
    m->may_discard = m->is_exchanged

#define STATES (&((instance *)handle)->states)
#define ANY (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_RUNNING | FMU_FAILED | FMU_TERMINATED)
#define WRITABLE (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_RUNNING)
#define KNOWN_STATES (FMU_INITIALIZATION | FMU_EVENT | FMU_CONTINUOUS | FMU_TERMINATED)
#define AFTER_STEPS (FMU_STEP | FMU_FAILED | FMU_TERMINATED)
#define WITH_DERIVATIVES (FMU_INITIALIZATION | FMU_RUNNING | FMU_FAILED | FMU_TERMINATED)

COTREE_FMI_EXPORT const char *FMI2(fmi2GetTypesPlatform)(void) { return "default"; }

COTREE_FMI_EXPORT const char *FMI2(fmi2GetVersion)(void) { return "2.0"; }

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2SetDebugLogging)(fmi2Component handle, fmi2Boolean is_logging,
                                                       size_t n_categories,
                                                       const fmi2String categories[])
{
    size_t i;
    BEGIN("fmi2SetDebugLogging", ANY);
    if (n_categories > 0 && fmu_check_pointer(m, "fmi2SetDebugLogging", categories) != 0)
        return fmi2Error;
    for (i = 0; i < n_categories; ++i) {
        if (!fmu_is_category(categories[i])) {
            return status_of(m, fmu_refuse(m, "there is no log category '%.100s'",
                                           categories[i] == NULL ? "" : categories[i]));
        }
    }
    ((instance *)handle)->is_logging = is_logging;
    return fmi2OK;
}

/* Instances. */

static void free_instance(instance *own)
{
    fmu_states_free_all(&own->states);
    fmu_free(own->m);
    free(own->name);
    free(own);
}

COTREE_FMI_EXPORT fmi2Component FMI2(fmi2Instantiate)(fmi2String name, fmi2Type kind,
                                                      fmi2String token, fmi2String resources,
                                                      const fmi2CallbackFunctions *functions,
                                                      fmi2Boolean is_visible,
                                                      fmi2Boolean is_logging)
{
    const fmu_tables *const tables = fmu_tables_of_model();
    instance *const own = (instance *)calloc(1, sizeof(instance));
    const size_t n_characters = name == NULL ? 1 : strlen(name) + 1;
    const char *why = NULL;
    (void)resources;
    (void)is_visible;
    if (own == NULL) return NULL;
    if (functions != NULL) {
        own->log = functions->logger;
        own->environment = functions->componentEnvironment;
    }
    own->is_logging = is_logging;
    own->name = (char *)malloc(n_characters);
    if (own->name != NULL) memcpy(own->name, name == NULL ? "" : name, n_characters);
    if (own->name == NULL) {
        why = "there is no memory";
    } else if (name == NULL || name[0] == '\0') {
        why = "the instance has no name";
    } else if (token == NULL || strcmp(token, tables->token) != 0) {
        why = "the GUID is not that of this unit";
    } else if (kind != fmi2ModelExchange && kind != fmi2CoSimulation) {
        why = "there is no such type of unit";
    } else if (kind == fmi2ModelExchange ? !tables->is_exchangeable : tables->stepper == NULL) {
        why = "the unit was exported without this interface type";
    } else {
        own->m = fmu_new(tables, kind == fmi2ModelExchange, 0, log_message, own);
        if (own->m == NULL) why = "there is no memory";
    }
    if (why != NULL) {
        log_message(own, FMU_ERROR, why);
        free_instance(own);
        return NULL;
    }
    return own;
}

COTREE_FMI_EXPORT void FMI2(fmi2FreeInstance)(fmi2Component handle)
{
    if (handle != NULL) free_instance((instance *)handle);
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2SetupExperiment)(fmi2Component handle,
                                                       fmi2Boolean has_tolerance,
                                                       fmi2Real tolerance, fmi2Real begin,
                                                       fmi2Boolean has_end, fmi2Real end)
{
    BEGIN("fmi2SetupExperiment", FMU_INSTANTIATED);
    return status_of(m, fmu_set_up(m, begin, has_end ? end : HUGE_VAL,
                                   has_tolerance ? tolerance : m->tables->rtol));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2EnterInitializationMode)(fmi2Component handle)
{
    BEGIN("fmi2EnterInitializationMode", FMU_INSTANTIATED);
    if (m->numbers[FMU_IS_SET_UP] == 0.0) {
        return status_of(m, fmu_refuse(m, "fmi2EnterInitializationMode needs the start time: call "
                                          "fmi2SetupExperiment first"));
    }
    return status_of(m, fmu_begin(m));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2ExitInitializationMode)(fmi2Component handle)
{
    BEGIN("fmi2ExitInitializationMode", FMU_INITIALIZATION);
    return status_of(m, fmu_leave_initialization(m));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2Terminate)(fmi2Component handle)
{
    BEGIN("fmi2Terminate", FMU_RUNNING | FMU_FAILED);
    fmu_enter(m, FMU_TERMINATED);
    return fmi2OK;
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2Reset)(fmi2Component handle)
{
    BEGIN("fmi2Reset", ANY);
    fmu_reset(m);
    return fmi2OK;
}

/* Variables, all of type Real. */

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetReal)(fmi2Component handle,
                                               const fmi2ValueReference references[], size_t n,
                                               fmi2Real values[])
{
    BEGIN_EVALUATION("fmi2GetReal", ANY);
    if (n == 0) return fmi2OK;
    if (fmu_check_pointer(m, "fmi2GetReal", references) != 0) return fmi2Error;
    if (fmu_check_pointer(m, "fmi2GetReal", values) != 0) return fmi2Error;
    return status_of(m, fmu_get(m, references, n, values));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2SetReal)(fmi2Component handle,
                                               const fmi2ValueReference references[], size_t n,
                                               const fmi2Real values[])
{
    BEGIN("fmi2SetReal", WRITABLE);
    if (n == 0) return fmi2OK;
    if (fmu_check_pointer(m, "fmi2SetReal", references) != 0) return fmi2Error;
    if (fmu_check_pointer(m, "fmi2SetReal", values) != 0) return fmi2Error;
    return status_of(m, fmu_set(m, references, n, values));
}

static fmi2Status refuse_type(fmi2Component handle, const char *function, size_t n)
{
    BEGIN(function, ANY);
    return n == 0 ? fmi2OK
                  : status_of(m, fmu_refuse(m, "%s: every variable is of the type Real", function));
}

/* Functions of types that no variable has. */
#define UNUSED_TYPE(type)                                                                          \
    COTREE_FMI_EXPORT fmi2Status FMI2(fmi2Get##type)(fmi2Component handle,                         \
                                                     const fmi2ValueReference references[],        \
                                                     size_t n, fmi2##type values[])                \
    {                                                                                              \
        (void)references;                                                                          \
        (void)values;                                                                              \
        return refuse_type(handle, "fmi2Get" #type, n);                                            \
    }                                                                                              \
                                                                                                   \
    COTREE_FMI_EXPORT fmi2Status FMI2(fmi2Set##type)(fmi2Component handle,                         \
                                                     const fmi2ValueReference references[],        \
                                                     size_t n, const fmi2##type values[])          \
    {                                                                                              \
        (void)references;                                                                          \
        (void)values;                                                                              \
        return refuse_type(handle, "fmi2Set" #type, n);                                            \
    }

UNUSED_TYPE(Integer)
UNUSED_TYPE(Boolean)
UNUSED_TYPE(String)
#undef UNUSED_TYPE

/* State. */

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetFMUstate)(fmi2Component handle, fmi2FMUstate *place)
{
    BEGIN("fmi2GetFMUstate", ANY);
    return status_of(m, fmu_states_save(m, STATES, "fmi2GetFMUstate", place));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2SetFMUstate)(fmi2Component handle, fmi2FMUstate from)
{
    BEGIN("fmi2SetFMUstate", ANY);
    return status_of(m, fmu_states_restore(m, STATES, "fmi2SetFMUstate", from));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2FreeFMUstate)(fmi2Component handle, fmi2FMUstate *place)
{
    BEGIN("fmi2FreeFMUstate", ANY);
    return status_of(m, fmu_states_free(m, STATES, "fmi2FreeFMUstate", place));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2SerializedFMUstateSize)(fmi2Component handle,
                                                              fmi2FMUstate from, size_t *n)
{
    BEGIN("fmi2SerializedFMUstateSize", ANY);
    return status_of(m, fmu_states_size(m, STATES, "fmi2SerializedFMUstateSize", from, n));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2SerializeFMUstate)(fmi2Component handle, fmi2FMUstate from,
                                                         fmi2Byte bytes[], size_t n)
{
    BEGIN("fmi2SerializeFMUstate", ANY);
    return status_of(m, fmu_states_write(m, STATES, "fmi2SerializeFMUstate", from, bytes, n));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2DeSerializeFMUstate)(fmi2Component handle,
                                                           const fmi2Byte bytes[], size_t n,
                                                           fmi2FMUstate *place)
{
    BEGIN("fmi2DeSerializeFMUstate", ANY);
    return status_of(m, fmu_states_read(m, STATES, "fmi2DeSerializeFMUstate", bytes, n, place));
}

COTREE_FMI_EXPORT fmi2Status
FMI2(fmi2GetDirectionalDerivative)(fmi2Component handle, const fmi2ValueReference unknowns[],
                                   size_t n_unknowns, const fmi2ValueReference knowns[],
                                   size_t n_knowns, const fmi2Real seed[], fmi2Real sensitivity[])
{
    BEGIN_EVALUATION("fmi2GetDirectionalDerivative", WITH_DERIVATIVES);
    if ((n_unknowns > 0 && (unknowns == NULL || sensitivity == NULL)) ||
        (n_knowns > 0 && (knowns == NULL || seed == NULL))) {
        return status_of(m, fmu_check_pointer(m, "fmi2GetDirectionalDerivative", NULL));
    }
    return status_of(m,
                     fmu_directional(m, unknowns, n_unknowns, knowns, n_knowns, seed, sensitivity));
}

/* Model Exchange. */

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2EnterEventMode)(fmi2Component handle)
{
    BEGIN("fmi2EnterEventMode", FMU_CONTINUOUS);
    fmu_enter(m, FMU_EVENT);
    return fmi2OK;
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2NewDiscreteStates)(fmi2Component handle, fmi2EventInfo *info)
{
    fmu_event_info news = {0, 0, 0, 0.0};
    BEGIN("fmi2NewDiscreteStates", FMU_EVENT);
    if (fmu_check_pointer(m, "fmi2NewDiscreteStates", info) != 0) return fmi2Error;
    if (fmu_update(m, &news) != 0) return fmi2Error;
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = news.terminates;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = news.are_states_changed;
    info->nextEventTimeDefined = news.has_next;
    info->nextEventTime = news.has_next ? news.next : 0.0;
    return fmi2OK;
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2EnterContinuousTimeMode)(fmi2Component handle)
{
    BEGIN("fmi2EnterContinuousTimeMode", FMU_EVENT);
    return status_of(m, fmu_leave_event_mode(m));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2CompletedIntegratorStep)(fmi2Component handle,
                                                               fmi2Boolean keeps_no_state,
                                                               fmi2Boolean *enters_event_mode,
                                                               fmi2Boolean *terminates)
{
    int enters = 0;
    BEGIN("fmi2CompletedIntegratorStep", FMU_CONTINUOUS);
    (void)keeps_no_state;
    if (fmu_check_pointer(m, "fmi2CompletedIntegratorStep", enters_event_mode) != 0)
        return fmi2Error;
    if (fmu_check_pointer(m, "fmi2CompletedIntegratorStep", terminates) != 0) return fmi2Error;
    if (fmu_complete_step(m, &enters) != 0) return fmi2Error;
    *enters_event_mode = enters;
    *terminates = fmi2False;
    return fmi2OK;
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2SetTime)(fmi2Component handle, fmi2Real t)
{
    BEGIN("fmi2SetTime", FMU_EVENT | FMU_CONTINUOUS);
    return status_of(m, fmu_set_time(m, t));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2SetContinuousStates)(fmi2Component handle, const fmi2Real x[],
                                                           size_t n)
{
    BEGIN_EVALUATION("fmi2SetContinuousStates", FMU_CONTINUOUS);
    if (n > 0 && fmu_check_pointer(m, "fmi2SetContinuousStates", x) != 0) return fmi2Error;
    return status_of(m, fmu_set_states(m, x, n));
}

/* Call a function of Model Exchange that writes n numbers. */
static fmi2Status get_numbers(fmi2Component handle, const char *name,
                              int (*get)(fmu *m, double *values, size_t n), fmi2Real values[],
                              size_t n)
{
    BEGIN_EVALUATION(name, KNOWN_STATES);
    if (!m->is_exchanged) return status_of(m, fmu_refuse(m, "%s belongs to Model Exchange", name));
    if (n > 0 && fmu_check_pointer(m, name, values) != 0) return fmi2Error;
    return status_of(m, get(m, values, n));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetDerivatives)(fmi2Component handle, fmi2Real values[],
                                                      size_t n)
{
    return get_numbers(handle, "fmi2GetDerivatives", fmu_get_rates, values, n);
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetEventIndicators)(fmi2Component handle, fmi2Real values[],
                                                          size_t n)
{
    return get_numbers(handle, "fmi2GetEventIndicators", fmu_get_indicators, values, n);
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetContinuousStates)(fmi2Component handle, fmi2Real values[],
                                                           size_t n)
{
    return get_numbers(handle, "fmi2GetContinuousStates", fmu_get_states, values, n);
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetNominalsOfContinuousStates)(fmi2Component handle,
                                                                     fmi2Real values[], size_t n)
{
    return get_numbers(handle, "fmi2GetNominalsOfContinuousStates", fmu_get_nominals, values, n);
}

/* Co-Simulation. */

static fmi2Status lack_derivatives(fmi2Component handle, const char *name)
{
    BEGIN(name, ANY);
    return status_of(m, fmu_refuse(m, "%s: inputs and outputs have no derivatives here", name));
}

COTREE_FMI_EXPORT fmi2Status
FMI2(fmi2SetRealInputDerivatives)(fmi2Component handle, const fmi2ValueReference references[],
                                  size_t n, const fmi2Integer orders[], const fmi2Real values[])
{
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    return lack_derivatives(handle, "fmi2SetRealInputDerivatives");
}

COTREE_FMI_EXPORT fmi2Status
FMI2(fmi2GetRealOutputDerivatives)(fmi2Component handle, const fmi2ValueReference references[],
                                   size_t n, const fmi2Integer orders[], fmi2Real values[])
{
    (void)references;
    (void)n;
    (void)orders;
    (void)values;
    return lack_derivatives(handle, "fmi2GetRealOutputDerivatives");
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2DoStep)(fmi2Component handle, fmi2Real t, fmi2Real step,
                                              fmi2Boolean keeps_no_state)
{
    double reached = t;
    int is_early = 0, result;
    BEGIN("fmi2DoStep", FMU_STEP);
    (void)keeps_no_state;
    result = fmu_step(m, t, step, &is_early, &reached);
    if (m->numbers[FMU_HAS_ENDED] != 0.0) {
        m->may_discard = 1;
        result = fmu_discard(m, "the simulation ends at t = %.10g", reached);
    }
    /* The importer queries the time reached, and continues from a saved state or terminates. */
    if (m->is_discarded) fmu_enter(m, FMU_FAILED);
    return status_of(m, result);
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2CancelStep)(fmi2Component handle)
{
    BEGIN("fmi2CancelStep", ANY);
    return status_of(m, fmu_refuse(m, "fmi2CancelStep: steps are never pending"));
}

/* Discard a query for a status that does not exist, as the standard requires. */
static fmi2Status lack_status(fmu *m, const char *function)
{
    m->may_discard = 1;
    return status_of(
        m, fmu_discard(m, "%s: there is no such status, since steps are never pending", function));
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetRealStatus)(fmi2Component handle,
                                                     const fmi2StatusKind kind, fmi2Real *value)
{
    BEGIN("fmi2GetRealStatus", AFTER_STEPS);
    if (fmu_check_pointer(m, "fmi2GetRealStatus", value) != 0) return fmi2Error;
    if (kind != fmi2LastSuccessfulTime) return lack_status(m, "fmi2GetRealStatus");
    *value = m->numbers[FMU_NOW];
    return fmi2OK;
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetBooleanStatus)(fmi2Component handle,
                                                        const fmi2StatusKind kind,
                                                        fmi2Boolean *value)
{
    BEGIN("fmi2GetBooleanStatus", AFTER_STEPS);
    if (fmu_check_pointer(m, "fmi2GetBooleanStatus", value) != 0) return fmi2Error;
    if (kind != fmi2Terminated) return lack_status(m, "fmi2GetBooleanStatus");
    *value = m->numbers[FMU_HAS_ENDED] != 0.0;
    return fmi2OK;
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetStatus)(fmi2Component handle, const fmi2StatusKind kind,
                                                 fmi2Status *value)
{
    BEGIN("fmi2GetStatus", AFTER_STEPS);
    (void)kind;
    (void)value;
    return lack_status(m, "fmi2GetStatus");
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetIntegerStatus)(fmi2Component handle,
                                                        const fmi2StatusKind kind,
                                                        fmi2Integer *value)
{
    BEGIN("fmi2GetIntegerStatus", AFTER_STEPS);
    (void)kind;
    (void)value;
    return lack_status(m, "fmi2GetIntegerStatus");
}

COTREE_FMI_EXPORT fmi2Status FMI2(fmi2GetStringStatus)(fmi2Component handle,
                                                       const fmi2StatusKind kind, fmi2String *value)
{
    BEGIN("fmi2GetStringStatus", AFTER_STEPS);
    (void)kind;
    (void)value;
    return lack_status(m, "fmi2GetStringStatus");
}
