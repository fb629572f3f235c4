/* fmi2.c: the functions of the Functional Mock-up Interface 2.0 for an instance. */
#include "cotree_fmi2.h"

#include "cotree_fmi.h"

COTREE_FMI_EXPORT const char *FMI_FUNCTION(GetTypesPlatform)(void) { return "default"; }

/* Instances. */

/* The message is passed as an argument, not as the format: names in it may contain a percent
 * sign. */
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
        return fmu_reject(&importer, "the interface type is unknown");
    return fmu_instantiate(&importer, token, kind == fmi2ModelExchange, 0);
}

FMI_CALL(SetupExperiment, FMU_INSTANTIATED,
         fmu_set_up(m, has_tolerance ? &tolerance : NULL, begin, has_end ? end : HUGE_VAL),
         void *handle, fmi2Boolean has_tolerance, double tolerance, double begin,
         fmi2Boolean has_end, double end)
FMI_CALL(EnterInitializationMode, FMU_INSTANTIATED, fmu_enter_initialization(m), void *handle)

/* Variables, all of type Real. */

FMI_CALL(GetReal, FMU_ANY, fmu_get(m, references, n, values, n), void *handle,
         const unsigned references[], size_t n, double values[])
FMI_CALL(SetReal, FMU_SETTABLE, fmu_set(m, references, n, values, n), void *handle,
         const unsigned references[], size_t n, const double values[])

#define FMI_UNUSED(type)                                                                           \
    FMI_NO_TYPE(Get##type, void *handle, const unsigned references[], size_t n,                    \
                fmi2##type values[])                                                               \
    FMI_NO_TYPE(Set##type, void *handle, const unsigned references[], size_t n,                    \
                const fmi2##type values[])

FMI_UNUSED(Integer)
FMI_UNUSED(Boolean)
FMI_UNUSED(String)

FMI_CALL(GetDirectionalDerivative, FMU_DIFFERENTIABLE,
         fmu_directional(m, &(fmu_direction){unknowns, n_unknowns, knowns, n_knowns, seed, n_knowns,
                                             sensitivity, n_unknowns}),
         void *handle, const unsigned unknowns[], size_t n_unknowns, const unsigned knowns[],
         size_t n_knowns, const double seed[], double sensitivity[])

/* Model Exchange. */

#if COTREE_HAS_EXCHANGE
static int update(fmu *m, fmi2EventInfo *info)
{
    fmu_event_info news = {0, 0, 0, 0.0};
    if (fmu_update(m, info == NULL ? NULL : &news) != 0 || info == NULL) return 1;
    info->newDiscreteStatesNeeded = 0;
    info->terminateSimulation = news.terminates;
    info->nominalsOfContinuousStatesChanged = 0;
    info->valuesOfContinuousStatesChanged = news.are_states_changed;
    info->nextEventTimeDefined = news.has_next;
    info->nextEventTime = news.next;
    return 0;
}
#endif

FMI_EXCHANGE(NewDiscreteStates, FMU_EVENT, update(m, info), void *handle, fmi2EventInfo *info)

/* Co-Simulation. */

#define NO_DERIVATIVES fmu_refuse_call(m, "inputs and outputs have no derivatives here")

FMI_CALL(SetRealInputDerivatives, FMU_ANY, NO_DERIVATIVES, void *handle,
         const unsigned references[], size_t n, const fmi2Integer orders[], const double values[])
FMI_CALL(GetRealOutputDerivatives, FMU_ANY, NO_DERIVATIVES, void *handle,
         const unsigned references[], size_t n, const fmi2Integer orders[], double values[])

FMI_STEPS(DoStep, FMU_STEP, fmu_step(m, t, step, &(fmu_progress){t, 0, 0}), void *handle, double t,
          double step, fmi2Boolean keeps_no_state)
FMI_CALL(CancelStep, FMU_ANY, fmu_refuse_call(m, "steps are never pending"), void *handle)

#define FMI_PROGRESS(name, result, is_known, reached, has_ended)                                   \
    FMI_STEPS(name, FMU_WITH_PROGRESS, fmu_get_progress(m, is_known, reached, has_ended),          \
              void *handle, const fmi2StatusKind kind, result)

FMI_PROGRESS(GetRealStatus, double *value, kind == fmi2LastSuccessfulTime, value, NULL)
FMI_PROGRESS(GetBooleanStatus, fmi2Boolean *value, kind == fmi2Terminated, NULL, value)
FMI_PROGRESS(GetStatus, fmi2Status *value, 0, NULL, NULL)
FMI_PROGRESS(GetIntegerStatus, fmi2Integer *value, 0, NULL, NULL)
FMI_PROGRESS(GetStringStatus, fmi2String *value, 0, NULL, NULL)
