/* fmi3.c: the functions of the Functional Mock-up Interface 3.0 for an instance. */
#include "cotree_fmi3.h"

#include "cotree_fmi.h"

/* Instances. */

static void log_message(const fmu_importer *importer, int status, const char *category,
                        const char *message)
{
    const fmi3LogMessageCallback log = (fmi3LogMessageCallback)importer->callback;
    log(importer->environment, (fmi3Status)status, category, message);
}

static fmu_importer importer_of(fmi3String name, fmi3Boolean is_logging, void *environment,
                                fmi3LogMessageCallback log)
{
    const fmu_importer own = {3, name, environment, (void (*)(void))log, log_message, is_logging};
    return own;
}

COTREE_FMI_EXPORT void *
FMI_FUNCTION(InstantiateModelExchange)(fmi3String name, fmi3String token, fmi3String resources,
                                       fmi3Boolean is_visible, fmi3Boolean is_logging,
                                       void *environment, fmi3LogMessageCallback log)
{
    const fmu_importer importer = importer_of(name, is_logging, environment, log);
    return fmu_instantiate(&importer, token, 1, 0);
}

COTREE_FMI_EXPORT void *FMI_FUNCTION(InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean is_visible,
    fmi3Boolean is_logging, fmi3Boolean uses_event_mode, fmi3Boolean is_early_return_allowed,
    const unsigned intermediate[], size_t n_intermediate, void *environment,
    fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback intermediate_update)
{
    const fmu_importer importer = importer_of(name, is_logging, environment, log);
    if (uses_event_mode)
        return fmu_reject(&importer, "events are processed inside steps: there is no Event Mode in "
                                     "Co-Simulation");
    if (n_intermediate > 0) return fmu_reject(&importer, "there are no intermediate variables");
    return fmu_instantiate(&importer, token, 0, is_early_return_allowed);
}

COTREE_FMI_EXPORT void *FMI_FUNCTION(InstantiateScheduledExecution)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean is_visible,
    fmi3Boolean is_logging, void *environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback clock_update, fmi3PreemptionCallback lock,
    fmi3PreemptionCallback unlock)
{
    const fmu_importer importer = importer_of(name, is_logging, environment, log);
    return fmu_reject(&importer, "the unit has no Scheduled Execution");
}

FMI_CALL(EnterInitializationMode, FMU_INSTANTIATED,
         fmu_set_up(m, has_tolerance ? &tolerance : NULL, begin, has_end ? end : HUGE_VAL) ||
             fmu_enter_initialization(m),
         void *handle, fmi3Boolean has_tolerance, double tolerance, double begin,
         fmi3Boolean has_end, double end)

/* Variables, all of type Float64 without dimensions. The model description lists their
 * dependencies. */

FMI_CALL(GetFloat64, FMU_ANY, fmu_get(m, references, n, values, n_values), void *handle,
         const unsigned references[], size_t n, double values[], size_t n_values)
FMI_CALL(SetFloat64, FMU_SETTABLE, fmu_set(m, references, n, values, n_values), void *handle,
         const unsigned references[], size_t n, const double values[], size_t n_values)

#define FMI_UNUSED(type)                                                                           \
    FMI_NO_TYPE(Get##type, void *handle, const unsigned references[], size_t n,                    \
                fmi3##type values[], size_t n_values)                                              \
    FMI_NO_TYPE(Set##type, void *handle, const unsigned references[], size_t n,                    \
                const fmi3##type values[], size_t n_values)

FMI_UNUSED(Float32)
FMI_UNUSED(Int8)
FMI_UNUSED(UInt8)
FMI_UNUSED(Int16)
FMI_UNUSED(UInt16)
FMI_UNUSED(Int32)
FMI_UNUSED(UInt32)
FMI_UNUSED(Int64)
FMI_UNUSED(UInt64)
FMI_UNUSED(Boolean)
FMI_UNUSED(String)

FMI_NO_TYPE(GetBinary, void *handle, const unsigned references[], size_t n, size_t sizes[],
            fmi3Binary values[], size_t n_values)
FMI_NO_TYPE(SetBinary, void *handle, const unsigned references[], size_t n, const size_t sizes[],
            const fmi3Binary values[], size_t n_values)

FMI_CALL(GetNumberOfVariableDependencies, FMU_ANY, fmu_refuse_type(m, 1), void *handle,
         unsigned reference, size_t *n)
FMI_CALL(GetVariableDependencies, FMU_ANY, fmu_refuse_type(m, 1), void *handle, unsigned dependent,
         size_t of_dependent[], unsigned independents[], size_t of_independents[],
         fmi3DependencyKind kinds[], size_t n)

/* Derivatives. */

#define FMI_DERIVATIVE(name, call)                                                                 \
    FMI_CALL(name, FMU_DIFFERENTIABLE,                                                             \
             call(m, &(fmu_direction){unknowns, n_unknowns, knowns, n_knowns, seed, n_seed,        \
                                      sensitivity, n_sensitivity}),                                \
             void *handle, const unsigned unknowns[], size_t n_unknowns, const unsigned knowns[],  \
             size_t n_knowns, const double seed[], size_t n_seed, double sensitivity[],            \
             size_t n_sensitivity)

FMI_DERIVATIVE(GetDirectionalDerivative, fmu_directional)
FMI_DERIVATIVE(GetAdjointDerivative, fmu_adjoint)

/* No structural parameters and no clocks exist. */

FMI_CALL(EnterConfigurationMode, 0, 0, void *handle)
FMI_CALL(ExitConfigurationMode, 0, 0, void *handle)
FMI_NO_TYPE(GetClock, void *handle, const unsigned references[], size_t n, fmi3Clock values[])
FMI_NO_TYPE(SetClock, void *handle, const unsigned references[], size_t n, const fmi3Clock values[])
FMI_NO_TYPE(GetIntervalDecimal, void *handle, const unsigned references[], size_t n,
            double intervals[], fmi3IntervalQualifier qualifiers[])
FMI_NO_TYPE(GetIntervalFraction, void *handle, const unsigned references[], size_t n,
            fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
FMI_NO_TYPE(SetIntervalDecimal, void *handle, const unsigned references[], size_t n,
            const double values[])
FMI_NO_TYPE(SetIntervalFraction, void *handle, const unsigned references[], size_t n,
            const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
FMI_NO_TYPE(GetShiftDecimal, void *handle, const unsigned references[], size_t n, double values[])
FMI_NO_TYPE(GetShiftFraction, void *handle, const unsigned references[], size_t n,
            fmi3UInt64 counters[], fmi3UInt64 resolutions[])
FMI_NO_TYPE(SetShiftDecimal, void *handle, const unsigned references[], size_t n,
            const double values[])
FMI_NO_TYPE(SetShiftFraction, void *handle, const unsigned references[], size_t n,
            const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
FMI_CALL(EvaluateDiscreteStates, FMU_INITIALIZATION | FMU_EVENT, 0, void *handle)
FMI_CALL(ActivateModelPartition, FMU_ANY, fmu_refuse_type(m, 1), void *handle, unsigned clock,
         double t)

/* Model Exchange. */

FMI_CALL(GetNumberOfEventIndicators, FMU_ANY, fmu_count_numbers(m, FMU_INDICATORS, n), void *handle,
         size_t *n)
FMI_CALL(GetNumberOfContinuousStates, FMU_ANY, fmu_count_numbers(m, FMU_STATES, n), void *handle,
         size_t *n)

#if COTREE_HAS_EXCHANGE
static int update(fmu *m, fmi3Boolean *needs_another, fmi3Boolean *terminates,
                  fmi3Boolean *are_nominals_changed, fmi3Boolean *are_states_changed,
                  fmi3Boolean *has_next, double *next)
{
    const int is_complete = needs_another != NULL && terminates != NULL &&
                            are_nominals_changed != NULL && are_states_changed != NULL &&
                            has_next != NULL && next != NULL;
    fmu_event_info news = {0, 0, 0, 0.0};
    if (fmu_update(m, is_complete ? &news : NULL) != 0 || !is_complete) return 1;
    *needs_another = false;
    *terminates = news.terminates != 0;
    *are_nominals_changed = false;
    *are_states_changed = news.are_states_changed != 0;
    *has_next = news.has_next != 0;
    *next = news.next;
    return 0;
}
#endif

FMI_EXCHANGE(UpdateDiscreteStates, FMU_EVENT,
             update(m, needs_another, terminates, are_nominals_changed, are_states_changed,
                    has_next, next),
             void *handle, fmi3Boolean *needs_another, fmi3Boolean *terminates,
             fmi3Boolean *are_nominals_changed, fmi3Boolean *are_states_changed,
             fmi3Boolean *has_next, double *next)

/* Co-Simulation. */

FMI_CALL(EnterStepMode, 0, 0, void *handle)
FMI_CALL(GetOutputDerivatives, FMU_ANY, fmu_refuse_call(m, "outputs have no derivatives here"),
         void *handle, const unsigned references[], size_t n, const fmi3Int32 orders[],
         double values[], size_t n_values)

#if COTREE_HAS_STEPS
static int do_step(fmu *m, double t, double step, fmi3Boolean *needs_event_mode,
                   fmi3Boolean *terminates, fmi3Boolean *is_early, double *reached)
{
    const int is_complete =
        needs_event_mode != NULL && terminates != NULL && is_early != NULL && reached != NULL;
    fmu_progress progress = {t, 0, 0};
    const int result = fmu_step(m, t, step, is_complete ? &progress : NULL);
    if (!is_complete) return result;
    *needs_event_mode = false;
    *terminates = progress.terminates != 0;
    *is_early = progress.is_early != 0;
    *reached = progress.reached;
    return result;
}
#endif

FMI_STEPS(DoStep, FMU_STEP, do_step(m, t, step, needs_event_mode, terminates, is_early, reached),
          void *handle, double t, double step, fmi3Boolean keeps_no_state,
          fmi3Boolean *needs_event_mode, fmi3Boolean *terminates, fmi3Boolean *is_early,
          double *reached)
