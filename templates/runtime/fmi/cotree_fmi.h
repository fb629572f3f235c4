/* cotree_fmi.h: functions that both versions of the Functional Mock-up Interface have.
 *
 * The file that includes it defines before: FMI_FUNCTION(name), the exported name of a function;
 * FMI_EITHER(of_2, of_3), one of two by version; FMI_STATUS, FMI_BOOLEAN and FMI_BYTE, types of the
 * version. Instances and saved states are pointers to void, and value references unsigned, in both
 * versions. */
#include "cotree_fmu.h"

#include <math.h>

/* The standards prescribe parameters that a unit of real variables does not read. */
#if defined(__GNUC__) || defined(__clang__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#if defined(_WIN32)
#define COTREE_FMI_EXPORT __declspec(dllexport)
#elif defined(__GNUC__) || defined(__clang__)
#define COTREE_FMI_EXPORT __attribute__((visibility("default")))
#else
#define COTREE_FMI_EXPORT
#endif

/* Functions have prefixes if several units are linked together. */
#define FMI_PASTE_NAMES(a, b) a##b
#define FMI_PASTE(a, b) FMI_PASTE_NAMES(a, b)

/* Define a function of parameters that returns the status of a call. */
#define FMI_CALL(name, call, ...)                                                                  \
    COTREE_FMI_EXPORT FMI_STATUS FMI_FUNCTION(name)(__VA_ARGS__) { return (FMI_STATUS)(call); }

/* Define a function of variables of a type that no variable has, or of n clocks. */
#define FMI_NO_TYPE(name, ...) FMI_CALL(name, fmu_refuse_type(handle, __func__, n), __VA_ARGS__)

/* Calls of an interface type, which are rejected if the unit is exported without it. */
#if COTREE_HAS_EXCHANGE
#define FMI_EXCHANGE(call) call
#else
#define FMI_EXCHANGE(call) fmu_allow(handle, __func__, 0)
#endif
#if COTREE_HAS_STEPS
#define FMI_STEPS(call) call
#else
#define FMI_STEPS(call) fmu_allow(handle, __func__, 0)
#endif

COTREE_FMI_EXPORT const char *FMI_FUNCTION(GetVersion)(void) { return FMI_EITHER("2.0", "3.0"); }

COTREE_FMI_EXPORT void FMI_FUNCTION(FreeInstance)(void *handle) { fmu_free(handle); }

FMI_CALL(SetDebugLogging, fmu_set_logging(handle, __func__, is_logging, n, categories),
         void *handle, FMI_BOOLEAN is_logging, size_t n, const char *const categories[])

FMI_CALL(ExitInitializationMode, fmu_exit_initialization(handle, __func__), void *handle)
FMI_CALL(Terminate, fmu_terminate(handle, __func__), void *handle)
FMI_CALL(Reset, fmu_reset(handle, __func__), void *handle)

/* Saved states. */

FMI_CALL(FMI_EITHER(GetFMUstate, GetFMUState), fmu_save_state(handle, __func__, place),
         void *handle, void **place)
FMI_CALL(FMI_EITHER(SetFMUstate, SetFMUState), fmu_restore_state(handle, __func__, from),
         void *handle, void *from)
FMI_CALL(FMI_EITHER(FreeFMUstate, FreeFMUState), fmu_free_state(handle, __func__, place),
         void *handle, void **place)
FMI_CALL(FMI_EITHER(SerializedFMUstateSize, SerializedFMUStateSize),
         fmu_measure_state(handle, __func__, from, n), void *handle, void *from, size_t *n)
FMI_CALL(FMI_EITHER(SerializeFMUstate, SerializeFMUState),
         fmu_write_state(handle, __func__, from, bytes, n), void *handle, void *from,
         FMI_BYTE bytes[], size_t n)
FMI_CALL(FMI_EITHER(DeSerializeFMUstate, DeserializeFMUState),
         fmu_read_state(handle, __func__, bytes, n, place), void *handle, const FMI_BYTE bytes[],
         size_t n, void **place)

/* Model Exchange. */

FMI_CALL(EnterEventMode, FMI_EXCHANGE(fmu_enter_event_mode(handle, __func__)), void *handle)
FMI_CALL(EnterContinuousTimeMode, FMI_EXCHANGE(fmu_leave_event_mode(handle, __func__)),
         void *handle)
FMI_CALL(SetTime,
         FMI_EXCHANGE(fmu_set_time(handle, __func__,
                                   FMI_EITHER(FMU_EVENT | FMU_CONTINUOUS, FMU_CONTINUOUS), t)),
         void *handle, double t)
FMI_CALL(SetContinuousStates, FMI_EXCHANGE(fmu_set_states(handle, __func__, x, n)), void *handle,
         const double x[], size_t n)
FMI_CALL(GetContinuousStates,
         FMI_EXCHANGE(fmu_get_numbers(handle, __func__, FMU_STATES, values, n)), void *handle,
         double values[], size_t n)
FMI_CALL(FMI_EITHER(GetDerivatives, GetContinuousStateDerivatives),
         FMI_EXCHANGE(fmu_get_numbers(handle, __func__, FMU_RATES, values, n)), void *handle,
         double values[], size_t n)
FMI_CALL(GetEventIndicators,
         FMI_EXCHANGE(fmu_get_numbers(handle, __func__, FMU_INDICATORS, values, n)), void *handle,
         double values[], size_t n)
FMI_CALL(GetNominalsOfContinuousStates,
         FMI_EXCHANGE(fmu_get_numbers(handle, __func__, FMU_NOMINALS, values, n)), void *handle,
         double values[], size_t n)

COTREE_FMI_EXPORT FMI_STATUS FMI_FUNCTION(CompletedIntegratorStep)(void *handle,
                                                                   FMI_BOOLEAN keeps_no_state,
                                                                   FMI_BOOLEAN *enters_event_mode,
                                                                   FMI_BOOLEAN *terminates)
{
    const int is_complete = enters_event_mode != NULL && terminates != NULL;
    int enters = 0;
    const int status =
        FMI_EXCHANGE(fmu_complete_step(handle, __func__, is_complete ? &enters : NULL));
    if (status != FMU_OK || !is_complete) return (FMI_STATUS)status;
    *enters_event_mode = enters != 0;
    *terminates = 0;
    return (FMI_STATUS)status;
}
