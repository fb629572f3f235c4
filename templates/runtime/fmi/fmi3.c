/* fmi3.c: the functions of the Functional Mock-up Interface 3.0 for an instance.
 * Part of the runtime of cotree, the same for every model. */
#include "cotree_fmi3.h"

#include "cotree_fmu.h"

#include <math.h>

#define FMI3_CALL(name) COTREE_FMI_EXPORT fmi3Status FMI3(name)

COTREE_FMI_EXPORT const char *FMI3(fmi3GetVersion)(void) { return "3.0"; }

/* Instances. */

static void log_message(const fmu_importer *importer, int status, const char *category,
                        const char *message)
{
    const fmi3LogMessageCallback log = (fmi3LogMessageCallback)importer->callback;
    log(importer->environment, (fmi3Status)status, category, message);
}

static fmu_importer importer_of(fmi3String name, fmi3Boolean is_logging,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    const fmu_importer own = {3, name, environment, (void (*)(void))log, log_message, is_logging};
    return own;
}

COTREE_FMI_EXPORT fmi3Instance FMI3(fmi3InstantiateModelExchange)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean is_visible,
    fmi3Boolean is_logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    const fmu_importer importer = importer_of(name, is_logging, environment, log);
    (void)resources, (void)is_visible;
    return fmu_instantiate(&importer, token, 1, 0);
}

COTREE_FMI_EXPORT fmi3Instance FMI3(fmi3InstantiateCoSimulation)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean is_visible,
    fmi3Boolean is_logging, fmi3Boolean uses_event_mode, fmi3Boolean is_early_return_allowed,
    const fmi3ValueReference intermediate[], size_t n_intermediate,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3IntermediateUpdateCallback intermediate_update)
{
    const fmu_importer importer = importer_of(name, is_logging, environment, log);
    (void)resources, (void)is_visible, (void)intermediate, (void)intermediate_update;
    if (uses_event_mode)
        return fmu_reject(&importer, "events are processed inside steps: there is no Event Mode in "
                                     "Co-Simulation");
    if (n_intermediate > 0) return fmu_reject(&importer, "there are no intermediate variables");
    return fmu_instantiate(&importer, token, 0, is_early_return_allowed);
}

COTREE_FMI_EXPORT fmi3Instance FMI3(fmi3InstantiateScheduledExecution)(
    fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean is_visible,
    fmi3Boolean is_logging, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
    fmi3ClockUpdateCallback clock_update, fmi3LockPreemptionCallback lock,
    fmi3UnlockPreemptionCallback unlock)
{
    const fmu_importer importer = importer_of(name, is_logging, environment, log);
    (void)token, (void)resources, (void)is_visible, (void)clock_update, (void)lock, (void)unlock;
    return fmu_reject(&importer, "the unit has no Scheduled Execution");
}

COTREE_FMI_EXPORT void FMI3(fmi3FreeInstance)(fmi3Instance handle) { fmu_free(handle); }

FMI3_CALL(fmi3SetDebugLogging)
(fmi3Instance handle, fmi3Boolean is_logging, size_t n_categories, const fmi3String categories[])
{
    return (fmi3Status)fmu_set_logging(handle, __func__, is_logging, n_categories, categories);
}

FMI3_CALL(fmi3EnterInitializationMode)
(fmi3Instance handle, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 begin,
 fmi3Boolean has_end, fmi3Float64 end)
{
    int status;
    if (!has_tolerance) tolerance = fmu_tables_of_model()->rtol;
    status = fmu_set_up(handle, __func__, begin, has_end ? end : HUGE_VAL, tolerance);
    return (fmi3Status)(status == FMU_OK ? fmu_enter_initialization(handle, __func__) : status);
}

FMI3_CALL(fmi3ExitInitializationMode)(fmi3Instance handle)
{
    return (fmi3Status)fmu_exit_initialization(handle, __func__);
}

FMI3_CALL(fmi3Terminate)(fmi3Instance handle)
{
    return (fmi3Status)fmu_terminate(handle, __func__);
}

FMI3_CALL(fmi3Reset)(fmi3Instance handle) { return (fmi3Status)fmu_reset(handle, __func__); }

/* Variables, all of type Float64. */

FMI3_CALL(fmi3GetFloat64)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, fmi3Float64 values[],
 size_t n_values)
{
    return (fmi3Status)fmu_get(handle, __func__, references, n, values, n_values);
}

FMI3_CALL(fmi3SetFloat64)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, const fmi3Float64 values[],
 size_t n_values)
{
    return (fmi3Status)fmu_set(handle, __func__, references, n, values, n_values);
}

/* Functions of types that no variable has. */
#define UNUSED_TYPE(type)                                                                          \
    FMI3_CALL(fmi3Get##type)                                                                       \
    (fmi3Instance handle, const fmi3ValueReference references[], size_t n, fmi3##type values[],    \
     size_t n_values)                                                                              \
    {                                                                                              \
        (void)references, (void)values, (void)n_values;                                            \
        return (fmi3Status)fmu_refuse_type(handle, __func__, n);                                   \
    }                                                                                              \
                                                                                                   \
    FMI3_CALL(fmi3Set##type)                                                                       \
    (fmi3Instance handle, const fmi3ValueReference references[], size_t n,                         \
     const fmi3##type values[], size_t n_values)                                                   \
    {                                                                                              \
        (void)references, (void)values, (void)n_values;                                            \
        return (fmi3Status)fmu_refuse_type(handle, __func__, n);                                   \
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

FMI3_CALL(fmi3GetBinary)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, size_t sizes[],
 fmi3Binary values[], size_t n_values)
{
    (void)references, (void)sizes, (void)values, (void)n_values;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3SetBinary)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, const size_t sizes[],
 const fmi3Binary values[], size_t n_values)
{
    (void)references, (void)sizes, (void)values, (void)n_values;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

/* The model description lists dependencies; no variable is an array. */

FMI3_CALL(fmi3GetNumberOfVariableDependencies)
(fmi3Instance handle, fmi3ValueReference reference, size_t *n)
{
    (void)reference, (void)n;
    return (fmi3Status)fmu_refuse_type(handle, __func__, 1);
}

FMI3_CALL(fmi3GetVariableDependencies)
(fmi3Instance handle, fmi3ValueReference dependent, size_t of_dependent[],
 fmi3ValueReference independents[], size_t of_independents[], fmi3DependencyKind kinds[], size_t n)
{
    (void)dependent, (void)of_dependent, (void)independents, (void)of_independents;
    (void)kinds, (void)n;
    return (fmi3Status)fmu_refuse_type(handle, __func__, 1);
}

/* Saved states. */

FMI3_CALL(fmi3GetFMUState)(fmi3Instance handle, fmi3FMUState *place)
{
    return (fmi3Status)fmu_save_state(handle, __func__, place);
}

FMI3_CALL(fmi3SetFMUState)(fmi3Instance handle, fmi3FMUState from)
{
    return (fmi3Status)fmu_restore_state(handle, __func__, from);
}

FMI3_CALL(fmi3FreeFMUState)(fmi3Instance handle, fmi3FMUState *place)
{
    return (fmi3Status)fmu_free_state(handle, __func__, place);
}

FMI3_CALL(fmi3SerializedFMUStateSize)(fmi3Instance handle, fmi3FMUState from, size_t *n)
{
    return (fmi3Status)fmu_measure_state(handle, __func__, from, n);
}

FMI3_CALL(fmi3SerializeFMUState)(fmi3Instance handle, fmi3FMUState from, fmi3Byte bytes[], size_t n)
{
    return (fmi3Status)fmu_write_state(handle, __func__, from, bytes, n);
}

FMI3_CALL(fmi3DeserializeFMUState)
(fmi3Instance handle, const fmi3Byte bytes[], size_t n, fmi3FMUState *place)
{
    return (fmi3Status)fmu_read_state(handle, __func__, bytes, n, place);
}

/* Derivatives. */

FMI3_CALL(fmi3GetDirectionalDerivative)
(fmi3Instance handle, const fmi3ValueReference unknowns[], size_t n_unknowns,
 const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
 fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    const fmu_direction d = {unknowns, n_unknowns, knowns,      n_knowns,
                             seed,     n_seed,     sensitivity, n_sensitivity};
    return (fmi3Status)fmu_directional(handle, __func__, &d);
}

FMI3_CALL(fmi3GetAdjointDerivative)
(fmi3Instance handle, const fmi3ValueReference unknowns[], size_t n_unknowns,
 const fmi3ValueReference knowns[], size_t n_knowns, const fmi3Float64 seed[], size_t n_seed,
 fmi3Float64 sensitivity[], size_t n_sensitivity)
{
    const fmu_direction d = {unknowns, n_unknowns, knowns,      n_knowns,
                             seed,     n_seed,     sensitivity, n_sensitivity};
    return (fmi3Status)fmu_adjoint(handle, __func__, &d);
}

/* Nothing can be configured, and there are no clocks. */

FMI3_CALL(fmi3EnterConfigurationMode)(fmi3Instance handle)
{
    return (fmi3Status)fmu_allow(handle, __func__, 0);
}

FMI3_CALL(fmi3ExitConfigurationMode)(fmi3Instance handle)
{
    return (fmi3Status)fmu_allow(handle, __func__, 0);
}

FMI3_CALL(fmi3GetClock)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, fmi3Clock values[])
{
    (void)references, (void)values;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3SetClock)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, const fmi3Clock values[])
{
    (void)references, (void)values;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3GetIntervalDecimal)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, fmi3Float64 intervals[],
 fmi3IntervalQualifier qualifiers[])
{
    (void)references, (void)intervals, (void)qualifiers;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3GetIntervalFraction)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, fmi3UInt64 counters[],
 fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)references, (void)counters, (void)resolutions, (void)qualifiers;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3SetIntervalDecimal)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, const fmi3Float64 values[])
{
    (void)references, (void)values;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3SetIntervalFraction)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, const fmi3UInt64 counters[],
 const fmi3UInt64 resolutions[])
{
    (void)references, (void)counters, (void)resolutions;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3GetShiftDecimal)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, fmi3Float64 values[])
{
    (void)references, (void)values;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3GetShiftFraction)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, fmi3UInt64 counters[],
 fmi3UInt64 resolutions[])
{
    (void)references, (void)counters, (void)resolutions;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3SetShiftDecimal)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, const fmi3Float64 values[])
{
    (void)references, (void)values;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3SetShiftFraction)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, const fmi3UInt64 counters[],
 const fmi3UInt64 resolutions[])
{
    (void)references, (void)counters, (void)resolutions;
    return (fmi3Status)fmu_refuse_type(handle, __func__, n);
}

FMI3_CALL(fmi3EvaluateDiscreteStates)(fmi3Instance handle)
{
    return (fmi3Status)fmu_allow(handle, __func__, FMU_INITIALIZATION | FMU_EVENT);
}

FMI3_CALL(fmi3ActivateModelPartition)(fmi3Instance handle, fmi3ValueReference clock, fmi3Float64 t)
{
    (void)clock, (void)t;
    return (fmi3Status)fmu_refuse_type(handle, __func__, 1);
}

FMI3_CALL(fmi3GetNumberOfEventIndicators)(fmi3Instance handle, size_t *n)
{
    return (fmi3Status)fmu_count_numbers(handle, __func__, FMU_INDICATORS, n);
}

FMI3_CALL(fmi3GetNumberOfContinuousStates)(fmi3Instance handle, size_t *n)
{
    return (fmi3Status)fmu_count_numbers(handle, __func__, FMU_STATES, n);
}

/* Model Exchange. */

FMI3_CALL(fmi3EnterEventMode)(fmi3Instance handle)
{
    return (fmi3Status)fmu_enter_event_mode(handle, __func__);
}

FMI3_CALL(fmi3UpdateDiscreteStates)
(fmi3Instance handle, fmi3Boolean *needs_another, fmi3Boolean *terminates,
 fmi3Boolean *are_nominals_changed, fmi3Boolean *are_states_changed, fmi3Boolean *has_next,
 fmi3Float64 *next)
{
    const int is_complete = needs_another != NULL && terminates != NULL &&
                            are_nominals_changed != NULL && are_states_changed != NULL &&
                            has_next != NULL && next != NULL;
    fmu_event_info news = {0, 0, 0, 0.0};
    const int status = fmu_update(handle, __func__, is_complete ? &news : NULL);
    if (status != FMU_OK || !is_complete) return (fmi3Status)status;
    *needs_another = false;
    *terminates = news.terminates != 0;
    *are_nominals_changed = false;
    *are_states_changed = news.are_states_changed != 0;
    *has_next = news.has_next != 0;
    *next = news.next;
    return fmi3OK;
}

FMI3_CALL(fmi3EnterContinuousTimeMode)(fmi3Instance handle)
{
    return (fmi3Status)fmu_leave_event_mode(handle, __func__);
}

FMI3_CALL(fmi3CompletedIntegratorStep)
(fmi3Instance handle, fmi3Boolean keeps_no_state, fmi3Boolean *enters_event_mode,
 fmi3Boolean *terminates)
{
    const int is_complete = enters_event_mode != NULL && terminates != NULL;
    int enters = 0;
    const int status = fmu_complete_step(handle, __func__, is_complete ? &enters : NULL);
    (void)keeps_no_state;
    if (status != FMU_OK || !is_complete) return (fmi3Status)status;
    *enters_event_mode = enters != 0;
    *terminates = false;
    return fmi3OK;
}

FMI3_CALL(fmi3SetTime)(fmi3Instance handle, fmi3Float64 t)
{
    return (fmi3Status)fmu_set_time(handle, __func__, FMU_CONTINUOUS, t);
}

FMI3_CALL(fmi3SetContinuousStates)(fmi3Instance handle, const fmi3Float64 x[], size_t n)
{
    return (fmi3Status)fmu_set_states(handle, __func__, x, n);
}

FMI3_CALL(fmi3GetContinuousStateDerivatives)(fmi3Instance handle, fmi3Float64 values[], size_t n)
{
    return (fmi3Status)fmu_get_numbers(handle, __func__, FMU_RATES, values, n);
}

FMI3_CALL(fmi3GetEventIndicators)(fmi3Instance handle, fmi3Float64 values[], size_t n)
{
    return (fmi3Status)fmu_get_numbers(handle, __func__, FMU_INDICATORS, values, n);
}

FMI3_CALL(fmi3GetContinuousStates)(fmi3Instance handle, fmi3Float64 values[], size_t n)
{
    return (fmi3Status)fmu_get_numbers(handle, __func__, FMU_STATES, values, n);
}

FMI3_CALL(fmi3GetNominalsOfContinuousStates)(fmi3Instance handle, fmi3Float64 values[], size_t n)
{
    return (fmi3Status)fmu_get_nominals(handle, __func__, values, n);
}

/* Co-Simulation. */

FMI3_CALL(fmi3EnterStepMode)(fmi3Instance handle)
{
    return (fmi3Status)fmu_allow(handle, __func__, 0);
}

FMI3_CALL(fmi3GetOutputDerivatives)
(fmi3Instance handle, const fmi3ValueReference references[], size_t n, const fmi3Int32 orders[],
 fmi3Float64 values[], size_t n_values)
{
    (void)references, (void)n, (void)orders, (void)values, (void)n_values;
    return (fmi3Status)fmu_refuse_call(handle, __func__, "outputs have no derivatives here");
}

FMI3_CALL(fmi3DoStep)
(fmi3Instance handle, fmi3Float64 t, fmi3Float64 step, fmi3Boolean keeps_no_state,
 fmi3Boolean *needs_event_mode, fmi3Boolean *terminates, fmi3Boolean *is_early,
 fmi3Float64 *reached)
{
    const int is_complete =
        needs_event_mode != NULL && terminates != NULL && is_early != NULL && reached != NULL;
    fmu_progress progress = {t, 0, 0};
    const int status = fmu_step(handle, __func__, t, step, is_complete ? &progress : NULL);
    (void)keeps_no_state;
    if (!is_complete) return (fmi3Status)status;
    *needs_event_mode = false;
    *terminates = progress.terminates != 0;
    *is_early = progress.is_early != 0;
    *reached = progress.reached;
    return (fmi3Status)status;
}
