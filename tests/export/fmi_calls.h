/* fmi_calls.h: the functions of FMI 2 and FMI 3 under common names, for fmi_calls.c.
 *
 * The declarations are those of the standard, as an importer ships them, and not those of the
 * exported sources: a function with another signature does not compile or is found by a sanitizer.
 */
#ifndef FMI_CALLS_H
#define FMI_CALLS_H

#include <stddef.h>

#if FMI == 3
#include "fmi3Functions.h"
typedef fmi3Float64 real;
typedef fmi3ValueReference reference;
typedef fmi3Byte byte;
typedef fmi3FMUState memory;
#define FN(name2, name3) name3
#else
#include "fmi2Functions.h"
typedef fmi2Real real;
typedef fmi2ValueReference reference;
typedef fmi2Byte byte;
typedef fmi2FMUstate memory;
#define FN(name2, name3) name2
#endif

#define OK 0
#define DISCARD 2
#define ERROR 3

#define fmi_free FN(fmi2FreeInstance, fmi3FreeInstance)
#define fmi_exit_initialization FN(fmi2ExitInitializationMode, fmi3ExitInitializationMode)
#define fmi_enter_event FN(fmi2EnterEventMode, fmi3EnterEventMode)
#define fmi_enter_continuous FN(fmi2EnterContinuousTimeMode, fmi3EnterContinuousTimeMode)
#define fmi_terminate FN(fmi2Terminate, fmi3Terminate)
#define fmi_reset FN(fmi2Reset, fmi3Reset)
#define fmi_set_time FN(fmi2SetTime, fmi3SetTime)
#define fmi_set_states FN(fmi2SetContinuousStates, fmi3SetContinuousStates)
#define fmi_get_states FN(fmi2GetContinuousStates, fmi3GetContinuousStates)
#define fmi_get_rates FN(fmi2GetDerivatives, fmi3GetContinuousStateDerivatives)
#define fmi_get_indicators FN(fmi2GetEventIndicators, fmi3GetEventIndicators)
#define fmi_get_nominals FN(fmi2GetNominalsOfContinuousStates, fmi3GetNominalsOfContinuousStates)
#define fmi_get_memory FN(fmi2GetFMUstate, fmi3GetFMUState)
#define fmi_set_memory FN(fmi2SetFMUstate, fmi3SetFMUState)
#define fmi_free_memory FN(fmi2FreeFMUstate, fmi3FreeFMUState)
#define fmi_memory_size FN(fmi2SerializedFMUstateSize, fmi3SerializedFMUStateSize)
#define fmi_write_memory FN(fmi2SerializeFMUstate, fmi3SerializeFMUState)
#define fmi_read_memory FN(fmi2DeSerializeFMUstate, fmi3DeserializeFMUState)
#define fmi_log FN(fmi2SetDebugLogging, fmi3SetDebugLogging)

/* n_values is used by FMI 3 alone. */
static int fmi_get(void *u, const reference r[], size_t n, real v[], size_t n_values)
{
#if FMI == 3
    return (int)fmi3GetFloat64(u, r, n, v, n_values);
#else
    (void)n_values;
    return (int)fmi2GetReal(u, r, n, v);
#endif
}

static int fmi_set(void *u, const reference r[], size_t n, const real v[], size_t n_values)
{
#if FMI == 3
    return (int)fmi3SetFloat64(u, r, n, v, n_values);
#else
    (void)n_values;
    return (int)fmi2SetReal(u, r, n, v);
#endif
}

static int fmi_directional(void *u, const reference f[], size_t n_f, const reference v[], size_t n_v,
                           const real seed[], size_t n_seed, real found[], size_t n_found)
{
#if FMI == 3
    return (int)fmi3GetDirectionalDerivative(u, f, n_f, v, n_v, seed, n_seed, found, n_found);
#else
    (void)n_seed;
    (void)n_found;
    return (int)fmi2GetDirectionalDerivative(u, f, n_f, v, n_v, seed, found);
#endif
}

static int fmi_update(void *u, int *terminates, int *has_next, double *next)
{
#if FMI == 3
    bool needs = true, ends = false, nominals = false, states = false, has = false;
    const int status = (int)fmi3UpdateDiscreteStates(u, &needs, &ends, &nominals, &states, &has, next);
    *has_next = has;
    *terminates = ends;
#else
    fmi2EventInfo info = {0, 0, 0, 0, 0, 0.0};
    const int status = (int)fmi2NewDiscreteStates(u, &info);
    *has_next = info.nextEventTimeDefined;
    *next = info.nextEventTime;
    *terminates = info.terminateSimulation;
#endif
    return status;
}

static int fmi_completed(void *u, int *enters)
{
#if FMI == 3
    bool enters_event = false, terminates = false;
    const int status = (int)fmi3CompletedIntegratorStep(u, true, &enters_event, &terminates);
    *enters = enters_event;
#else
    fmi2Boolean enters_event = 0, terminates = 0;
    const int status = (int)fmi2CompletedIntegratorStep(u, 1, &enters_event, &terminates);
    *enters = enters_event;
#endif
    return status;
}

static int fmi_step(void *u, double t, double h, int *terminates, int *is_early, double *reached)
{
#if FMI == 3
    bool needs = false, ends = false, early = false;
    const int status = (int)fmi3DoStep(u, t, h, true, &needs, &ends, &early, reached);
    *terminates = ends;
    *is_early = early;
#else
    const int status = (int)fmi2DoStep(u, t, h, 1);
    fmi2Boolean ends = 0;
    *is_early = 0;
    *reached = t + h;
    if (status == DISCARD && (fmi2GetBooleanStatus(u, fmi2Terminated, &ends) != fmi2OK ||
                              fmi2GetRealStatus(u, fmi2LastSuccessfulTime, reached) != fmi2OK)) {
        return ERROR;
    }
    *terminates = ends;
#endif
    return status;
}

#endif
