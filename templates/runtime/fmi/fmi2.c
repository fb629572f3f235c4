/* fmi2.c: the functions of the Functional Mock-up Interface 2.0 for an instance. */
#include "cotree_fmi2.h"

#include "cotree_fmi.h"

COTREE_FMI_EXPORT const char *FMI_FUNCTION(GetTypesPlatform)(void) { return "default"; }

/* Instances. */

/* A message is an argument, not a format: names in it may contain a percent sign. */
static void log_message(const fmu_importer *importer, int status, const char *category,
                        const char *message)
{
    const fmi2CallbackLogger log = (fmi2CallbackLogger)importer->callback;
    const char *const name = importer->name == NULL ? "" : importer->name;
    log(importer->environment, name, (fmi2Status)status, category, "%s", message);
}

COTREE_FMI_EXPORT void *FMI_FUNCTION(Instantiate)(fmi2String name, fmi2Type kind, fmi2String token,
                                                  fmi2String resources,
                                                  const fmi2CallbackFunctions *functions,
                                                  fmi2Boolean is_visible, fmi2Boolean is_logging)
{
    fmu_importer importer = {2, name, NULL, NULL, log_message, is_logging};
    if (functions != NULL) {
        importer.environment = functions->componentEnvironment;
        importer.callback = (void (*)(void))functions->logger;
    }
    if (kind != fmi2ModelExchange && kind != fmi2CoSimulation)
        return fmu_reject(&importer, "there is no such type of unit");
    return fmu_instantiate(&importer, token, kind == fmi2ModelExchange, 0);
}

FMI_CALL(SetupExperiment,
         fmu_set_up(handle, __func__, has_tolerance ? &tolerance : NULL, begin,
                    has_end ? end : HUGE_VAL),
         void *handle, fmi2Boolean has_tolerance, double tolerance, double begin,
         fmi2Boolean has_end, double end)
FMI_CALL(EnterInitializationMode, fmu_enter_initialization(handle, __func__), void *handle)

/* Variables, all of type Real. */

FMI_CALL(GetReal, fmu_get(handle, __func__, references, n, values, n), void *handle,
         const unsigned references[], size_t n, double values[])
FMI_CALL(SetReal, fmu_set(handle, __func__, references, n, values, n), void *handle,
         const unsigned references[], size_t n, const double values[])

#define FMI_UNUSED(type)                                                                           \
    FMI_NO_TYPE(Get##type, void *handle, const unsigned references[], size_t n,                    \
                fmi2##type values[])                                                               \
    FMI_NO_TYPE(Set##type, void *handle, const unsigned references[], size_t n,                    \
                const fmi2##type values[])

FMI_UNUSED(Integer)
FMI_UNUSED(Boolean)
FMI_UNUSED(String)

COTREE_FMI_EXPORT fmi2Status FMI_FUNCTION(GetDirectionalDerivative)(
    void *handle, const unsigned unknowns[], size_t n_unknowns, const unsigned knowns[],
    size_t n_knowns, const double seed[], double sensitivity[])
{
    const fmu_direction d = {unknowns, n_unknowns, knowns,      n_knowns,
                             seed,     n_knowns,   sensitivity, n_unknowns};
    return (fmi2Status)fmu_directional(handle, __func__, &d);
}

/* Model Exchange. */

COTREE_FMI_EXPORT fmi2Status FMI_FUNCTION(NewDiscreteStates)(void *handle, fmi2EventInfo *info)
{
    fmu_event_info news = {0, 0, 0, 0.0};
    const int status = FMI_EXCHANGE(fmu_update(handle, __func__, info == NULL ? NULL : &news));
    if (status != FMU_OK || info == NULL) return (fmi2Status)status;
    info->newDiscreteStatesNeeded = 0;
    info->terminateSimulation = news.terminates;
    info->nominalsOfContinuousStatesChanged = 0;
    info->valuesOfContinuousStatesChanged = news.are_states_changed;
    info->nextEventTimeDefined = news.has_next;
    info->nextEventTime = news.next;
    return fmi2OK;
}

/* Co-Simulation. */

#define NO_DERIVATIVES "inputs and outputs have no derivatives here"

FMI_CALL(SetRealInputDerivatives, fmu_refuse_call(handle, __func__, NO_DERIVATIVES), void *handle,
         const unsigned references[], size_t n, const fmi2Integer orders[], const double values[])
FMI_CALL(GetRealOutputDerivatives, fmu_refuse_call(handle, __func__, NO_DERIVATIVES), void *handle,
         const unsigned references[], size_t n, const fmi2Integer orders[], double values[])

FMI_CALL(DoStep, FMI_STEPS(fmu_step(handle, __func__, t, step, &(fmu_progress){t, 0, 0})),
         void *handle, double t, double step, fmi2Boolean keeps_no_state)
FMI_CALL(CancelStep, fmu_refuse_call(handle, __func__, "steps are never pending"), void *handle)
FMI_CALL(GetRealStatus,
         FMI_STEPS(fmu_get_progress(handle, __func__, kind == fmi2LastSuccessfulTime, value, NULL)),
         void *handle, const fmi2StatusKind kind, double *value)
FMI_CALL(GetBooleanStatus,
         FMI_STEPS(fmu_get_progress(handle, __func__, kind == fmi2Terminated, NULL, value)),
         void *handle, const fmi2StatusKind kind, fmi2Boolean *value)
FMI_CALL(GetStatus, FMI_STEPS(fmu_get_progress(handle, __func__, 0, NULL, NULL)), void *handle,
         const fmi2StatusKind kind, fmi2Status *value)
FMI_CALL(GetIntegerStatus, FMI_STEPS(fmu_get_progress(handle, __func__, 0, NULL, NULL)),
         void *handle, const fmi2StatusKind kind, fmi2Integer *value)
FMI_CALL(GetStringStatus, FMI_STEPS(fmu_get_progress(handle, __func__, 0, NULL, NULL)),
         void *handle, const fmi2StatusKind kind, fmi2String *value)
