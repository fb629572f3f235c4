/* cotree_fmi.h: functions that are common to both versions of the Functional Mock-up Interface.
 *
 * The including file defines FMI_FUNCTION(name), the exported name of a function;
 * FMI_EITHER(of_2, of_3), which selects the argument for its version; and the types FMI_STATUS,
 * FMI_BOOLEAN and FMI_BYTE. In both versions, instances and saved states are pointers to void,
 * and value references are unsigned. */
#include "cotree_fmu.h"

/* The standards prescribe parameters that units with only real variables do not use. */
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

/* Function names have prefixes if several units are linked together. */
#define FMI_PASTE_NAMES(a, b) a##b
#define FMI_PASTE(a, b) FMI_PASTE_NAMES(a, b)

/* Define a function that is allowed in some modes. It returns the status of a call for the instance
 * m. */
#define FMI_CALL(name, modes, call, ...)                                                           \
    COTREE_FMI_EXPORT FMI_STATUS FMI_FUNCTION(name)(__VA_ARGS__)                                   \
    {                                                                                              \
        fmu *const m = fmu_call(handle, __func__, modes);                                          \
        return (FMI_STATUS)(m == NULL ? FMU_ERROR : fmu_status(m, call));                          \
    }

/* Define a function for variables of a type that does not occur, or for n clocks. */
#define FMI_NO_TYPE(name, ...) FMI_CALL(name, FMU_ANY, fmu_refuse_type(m, n), __VA_ARGS__)

/* Define a function of an interface type. It is rejected if the unit was exported without this
 * type. */
#if COTREE_HAS_EXCHANGE
#define FMI_EXCHANGE FMI_CALL
#else
#define FMI_EXCHANGE(name, modes, call, ...) FMI_CALL(name, 0, 0, __VA_ARGS__)
#endif
#if COTREE_HAS_STEPS
#define FMI_STEPS FMI_CALL
#else
#define FMI_STEPS(name, modes, call, ...) FMI_CALL(name, 0, 0, __VA_ARGS__)
#endif

COTREE_FMI_EXPORT const char *FMI_FUNCTION(GetVersion)(void) { return FMI_EITHER("2.0", "3.0"); }

COTREE_FMI_EXPORT void FMI_FUNCTION(FreeInstance)(void *handle) { fmu_free(handle); }

FMI_CALL(SetDebugLogging, FMU_ANY, fmu_set_logging(m, is_logging, n, categories), void *handle,
         FMI_BOOLEAN is_logging, size_t n, const char *const categories[])

FMI_CALL(ExitInitializationMode, FMU_INITIALIZATION, fmu_exit_initialization(m), void *handle)
FMI_CALL(Terminate, FMU_RUNNING | FMU_FAILED, fmu_terminate(m), void *handle)
FMI_CALL(Reset, FMU_ANY, fmu_reset(m), void *handle)

/* Saved states. */

FMI_CALL(FMI_EITHER(GetFMUstate, GetFMUState), FMU_ANY, fmu_save_state(m, place), void *handle,
         void **place)
FMI_CALL(FMI_EITHER(SetFMUstate, SetFMUState), FMU_ANY, fmu_restore_state(m, from), void *handle,
         void *from)
FMI_CALL(FMI_EITHER(FreeFMUstate, FreeFMUState), FMU_ANY, fmu_free_state(m, place), void *handle,
         void **place)
FMI_CALL(FMI_EITHER(SerializedFMUstateSize, SerializedFMUStateSize), FMU_ANY,
         fmu_measure_state(m, from, n), void *handle, void *from, size_t *n)
FMI_CALL(FMI_EITHER(SerializeFMUstate, SerializeFMUState), FMU_ANY,
         fmu_write_state(m, from, bytes, n), void *handle, void *from, FMI_BYTE bytes[], size_t n)
FMI_CALL(FMI_EITHER(DeSerializeFMUstate, DeserializeFMUState), FMU_ANY,
         fmu_read_state(m, bytes, n, place), void *handle, const FMI_BYTE bytes[], size_t n,
         void **place)

/* Model Exchange. */

FMI_EXCHANGE(EnterEventMode, FMU_CONTINUOUS, fmu_enter_event_mode(m), void *handle)
FMI_EXCHANGE(EnterContinuousTimeMode, FMU_EVENT, fmu_leave_event_mode(m), void *handle)
FMI_EXCHANGE(SetTime, FMI_EITHER(FMU_EVENT | FMU_CONTINUOUS, FMU_CONTINUOUS), fmu_set_time(m, t),
             void *handle, double t)
FMI_EXCHANGE(SetContinuousStates, FMU_CONTINUOUS, fmu_set_states(m, x, n), void *handle,
             const double x[], size_t n)

#define FMI_NUMBERS(name, block)                                                                   \
    FMI_EXCHANGE(name, FMU_WITH_STATES, fmu_get_numbers(m, block, values, n), void *handle,        \
                 double values[], size_t n)

FMI_NUMBERS(GetContinuousStates, FMU_STATES)
FMI_NUMBERS(FMI_EITHER(GetDerivatives, GetContinuousStateDerivatives), FMU_RATES)
FMI_NUMBERS(GetEventIndicators, FMU_INDICATORS)
FMI_NUMBERS(GetNominalsOfContinuousStates, FMU_NOMINALS)

#if COTREE_HAS_EXCHANGE
static int complete_step(fmu *m, FMI_BOOLEAN *enters_event_mode, FMI_BOOLEAN *terminates)
{
    const int is_complete = enters_event_mode != NULL && terminates != NULL;
    int enters = 0;
    if (fmu_complete_step(m, is_complete ? &enters : NULL) != 0 || !is_complete) return 1;
    *enters_event_mode = enters != 0;
    *terminates = 0;
    return 0;
}
#endif

FMI_EXCHANGE(CompletedIntegratorStep, FMU_CONTINUOUS,
             complete_step(m, enters_event_mode, terminates), void *handle,
             FMI_BOOLEAN keeps_no_state, FMI_BOOLEAN *enters_event_mode, FMI_BOOLEAN *terminates)
