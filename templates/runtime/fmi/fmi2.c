/* fmi2.c: the functions of the Functional Mock-up Interface 2.0 for an instance.
 * Part of the runtime of cotree, the same for every model. */
#include "cotree_fmi2.h"

#include "cotree_fmu.h"

#include <math.h>

#define FMI2_CALL(name) COTREE_FMI_EXPORT fmi2Status FMI2(name)

COTREE_FMI_EXPORT const char *FMI2(fmi2GetTypesPlatform)(void) { return "default"; }

COTREE_FMI_EXPORT const char *FMI2(fmi2GetVersion)(void) { return "2.0"; }

/* Instances. */

/* A message is an argument, not a format: names in it may contain a percent sign. */
static void log_message(const fmu_importer *importer, int status, const char *category,
                        const char *message)
{
    const fmi2CallbackLogger log = (fmi2CallbackLogger)importer->callback;
    const char *const name = importer->name == NULL ? "" : importer->name;
    log(importer->environment, name, (fmi2Status)status, category, "%s", message);
}

COTREE_FMI_EXPORT fmi2Component FMI2(fmi2Instantiate)(fmi2String name, fmi2Type kind,
                                                      fmi2String token, fmi2String resources,
                                                      const fmi2CallbackFunctions *functions,
                                                      fmi2Boolean is_visible,
                                                      fmi2Boolean is_logging)
{
    fmu_importer importer = {2, name, NULL, NULL, log_message, is_logging};
    (void)resources, (void)is_visible;
    if (functions != NULL) {
        importer.environment = functions->componentEnvironment;
        importer.callback = (void (*)(void))functions->logger;
    }
    if (kind != fmi2ModelExchange && kind != fmi2CoSimulation)
        return fmu_reject(&importer, "there is no such type of unit");
    return fmu_instantiate(&importer, token, kind == fmi2ModelExchange, 0);
}

COTREE_FMI_EXPORT void FMI2(fmi2FreeInstance)(fmi2Component handle) { fmu_free(handle); }

FMI2_CALL(fmi2SetDebugLogging)
(fmi2Component handle, fmi2Boolean is_logging, size_t n_categories, const fmi2String categories[])
{
    return (fmi2Status)fmu_set_logging(handle, __func__, is_logging, n_categories, categories);
}

FMI2_CALL(fmi2SetupExperiment)
(fmi2Component handle, fmi2Boolean has_tolerance, fmi2Real tolerance, fmi2Real begin,
 fmi2Boolean has_end, fmi2Real end)
{
    if (!has_tolerance) tolerance = fmu_tables_of_model()->rtol;
    return (fmi2Status)fmu_set_up(handle, __func__, begin, has_end ? end : HUGE_VAL, tolerance);
}

FMI2_CALL(fmi2EnterInitializationMode)(fmi2Component handle)
{
    return (fmi2Status)fmu_enter_initialization(handle, __func__);
}

FMI2_CALL(fmi2ExitInitializationMode)(fmi2Component handle)
{
    return (fmi2Status)fmu_exit_initialization(handle, __func__);
}

FMI2_CALL(fmi2Terminate)(fmi2Component handle)
{
    return (fmi2Status)fmu_terminate(handle, __func__);
}

FMI2_CALL(fmi2Reset)(fmi2Component handle) { return (fmi2Status)fmu_reset(handle, __func__); }

/* Variables, all of type Real. */

FMI2_CALL(fmi2GetReal)
(fmi2Component handle, const fmi2ValueReference references[], size_t n, fmi2Real values[])
{
    return (fmi2Status)fmu_get(handle, __func__, references, n, values, n);
}

FMI2_CALL(fmi2SetReal)
(fmi2Component handle, const fmi2ValueReference references[], size_t n, const fmi2Real values[])
{
    return (fmi2Status)fmu_set(handle, __func__, references, n, values, n);
}

/* Functions of types that no variable has. */
#define UNUSED_TYPE(type)                                                                          \
    FMI2_CALL(fmi2Get##type)                                                                       \
    (fmi2Component handle, const fmi2ValueReference references[], size_t n, fmi2##type values[])   \
    {                                                                                              \
        (void)references, (void)values;                                                            \
        return (fmi2Status)fmu_refuse_type(handle, __func__, n);                                   \
    }                                                                                              \
                                                                                                   \
    FMI2_CALL(fmi2Set##type)                                                                       \
    (fmi2Component handle, const fmi2ValueReference references[], size_t n,                        \
     const fmi2##type values[])                                                                    \
    {                                                                                              \
        (void)references, (void)values;                                                            \
        return (fmi2Status)fmu_refuse_type(handle, __func__, n);                                   \
    }

UNUSED_TYPE(Integer)
UNUSED_TYPE(Boolean)
UNUSED_TYPE(String)
#undef UNUSED_TYPE

/* Saved states. */

FMI2_CALL(fmi2GetFMUstate)(fmi2Component handle, fmi2FMUstate *place)
{
    return (fmi2Status)fmu_save_state(handle, __func__, place);
}

FMI2_CALL(fmi2SetFMUstate)(fmi2Component handle, fmi2FMUstate from)
{
    return (fmi2Status)fmu_restore_state(handle, __func__, from);
}

FMI2_CALL(fmi2FreeFMUstate)(fmi2Component handle, fmi2FMUstate *place)
{
    return (fmi2Status)fmu_free_state(handle, __func__, place);
}

FMI2_CALL(fmi2SerializedFMUstateSize)(fmi2Component handle, fmi2FMUstate from, size_t *n)
{
    return (fmi2Status)fmu_measure_state(handle, __func__, from, n);
}

FMI2_CALL(fmi2SerializeFMUstate)
(fmi2Component handle, fmi2FMUstate from, fmi2Byte bytes[], size_t n)
{
    return (fmi2Status)fmu_write_state(handle, __func__, from, bytes, n);
}

FMI2_CALL(fmi2DeSerializeFMUstate)
(fmi2Component handle, const fmi2Byte bytes[], size_t n, fmi2FMUstate *place)
{
    return (fmi2Status)fmu_read_state(handle, __func__, bytes, n, place);
}

FMI2_CALL(fmi2GetDirectionalDerivative)
(fmi2Component handle, const fmi2ValueReference unknowns[], size_t n_unknowns,
 const fmi2ValueReference knowns[], size_t n_knowns, const fmi2Real seed[], fmi2Real sensitivity[])
{
    const fmu_direction d = {unknowns, n_unknowns, knowns,      n_knowns,
                             seed,     n_knowns,   sensitivity, n_unknowns};
    return (fmi2Status)fmu_directional(handle, __func__, &d);
}

/* Model Exchange. */

FMI2_CALL(fmi2EnterEventMode)(fmi2Component handle)
{
    return (fmi2Status)fmu_enter_event_mode(handle, __func__);
}

FMI2_CALL(fmi2NewDiscreteStates)(fmi2Component handle, fmi2EventInfo *info)
{
    fmu_event_info news = {0, 0, 0, 0.0};
    const int status = fmu_update(handle, __func__, info == NULL ? NULL : &news);
    if (status != FMU_OK || info == NULL) return (fmi2Status)status;
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = news.terminates;
    info->nominalsOfContinuousStatesChanged = fmi2False;
    info->valuesOfContinuousStatesChanged = news.are_states_changed;
    info->nextEventTimeDefined = news.has_next;
    info->nextEventTime = news.next;
    return fmi2OK;
}

FMI2_CALL(fmi2EnterContinuousTimeMode)(fmi2Component handle)
{
    return (fmi2Status)fmu_leave_event_mode(handle, __func__);
}

FMI2_CALL(fmi2CompletedIntegratorStep)
(fmi2Component handle, fmi2Boolean keeps_no_state, fmi2Boolean *enters_event_mode,
 fmi2Boolean *terminates)
{
    const int is_complete = enters_event_mode != NULL && terminates != NULL;
    int enters = 0;
    const int status = fmu_complete_step(handle, __func__, is_complete ? &enters : NULL);
    (void)keeps_no_state;
    if (status != FMU_OK || !is_complete) return (fmi2Status)status;
    *enters_event_mode = enters;
    *terminates = fmi2False;
    return fmi2OK;
}

FMI2_CALL(fmi2SetTime)(fmi2Component handle, fmi2Real t)
{
    return (fmi2Status)fmu_set_time(handle, __func__, FMU_EVENT | FMU_CONTINUOUS, t);
}

FMI2_CALL(fmi2SetContinuousStates)(fmi2Component handle, const fmi2Real x[], size_t n)
{
    return (fmi2Status)fmu_set_states(handle, __func__, x, n);
}

FMI2_CALL(fmi2GetDerivatives)(fmi2Component handle, fmi2Real values[], size_t n)
{
    return (fmi2Status)fmu_get_numbers(handle, __func__, FMU_RATES, values, n);
}

FMI2_CALL(fmi2GetEventIndicators)(fmi2Component handle, fmi2Real values[], size_t n)
{
    return (fmi2Status)fmu_get_numbers(handle, __func__, FMU_INDICATORS, values, n);
}

FMI2_CALL(fmi2GetContinuousStates)(fmi2Component handle, fmi2Real values[], size_t n)
{
    return (fmi2Status)fmu_get_numbers(handle, __func__, FMU_STATES, values, n);
}

FMI2_CALL(fmi2GetNominalsOfContinuousStates)(fmi2Component handle, fmi2Real values[], size_t n)
{
    return (fmi2Status)fmu_get_nominals(handle, __func__, values, n);
}

/* Co-Simulation. */

#define NO_DERIVATIVES "inputs and outputs have no derivatives here"

FMI2_CALL(fmi2SetRealInputDerivatives)
(fmi2Component handle, const fmi2ValueReference references[], size_t n, const fmi2Integer orders[],
 const fmi2Real values[])
{
    (void)references, (void)n, (void)orders, (void)values;
    return (fmi2Status)fmu_refuse_call(handle, __func__, NO_DERIVATIVES);
}

FMI2_CALL(fmi2GetRealOutputDerivatives)
(fmi2Component handle, const fmi2ValueReference references[], size_t n, const fmi2Integer orders[],
 fmi2Real values[])
{
    (void)references, (void)n, (void)orders, (void)values;
    return (fmi2Status)fmu_refuse_call(handle, __func__, NO_DERIVATIVES);
}

FMI2_CALL(fmi2DoStep)(fmi2Component handle, fmi2Real t, fmi2Real step, fmi2Boolean keeps_no_state)
{
    fmu_progress progress;
    (void)keeps_no_state;
    return (fmi2Status)fmu_step(handle, __func__, t, step, &progress);
}

FMI2_CALL(fmi2CancelStep)(fmi2Component handle)
{
    return (fmi2Status)fmu_refuse_call(handle, __func__, "steps are never pending");
}

FMI2_CALL(fmi2GetRealStatus)(fmi2Component handle, const fmi2StatusKind kind, fmi2Real *value)
{
    fmu_progress progress = {0.0, 0, 0};
    const int is_known = kind == fmi2LastSuccessfulTime;
    const int status =
        fmu_get_progress(handle, __func__, is_known, value == NULL ? NULL : &progress);
    if (status == FMU_OK && value != NULL) *value = progress.reached;
    return (fmi2Status)status;
}

FMI2_CALL(fmi2GetBooleanStatus)(fmi2Component handle, const fmi2StatusKind kind, fmi2Boolean *value)
{
    fmu_progress progress = {0.0, 0, 0};
    const int is_known = kind == fmi2Terminated;
    const int status =
        fmu_get_progress(handle, __func__, is_known, value == NULL ? NULL : &progress);
    if (status == FMU_OK && value != NULL) *value = progress.terminates;
    return (fmi2Status)status;
}

FMI2_CALL(fmi2GetStatus)(fmi2Component handle, const fmi2StatusKind kind, fmi2Status *value)
{
    (void)kind, (void)value;
    return (fmi2Status)fmu_get_progress(handle, __func__, 0, NULL);
}

FMI2_CALL(fmi2GetIntegerStatus)(fmi2Component handle, const fmi2StatusKind kind, fmi2Integer *value)
{
    (void)kind, (void)value;
    return (fmi2Status)fmu_get_progress(handle, __func__, 0, NULL);
}

FMI2_CALL(fmi2GetStringStatus)(fmi2Component handle, const fmi2StatusKind kind, fmi2String *value)
{
    (void)kind, (void)value;
    return (fmi2Status)fmu_get_progress(handle, __func__, 0, NULL);
}
