/* cotree_fmi2.h: the types of the Functional Mock-up Interface 2.0.
 * Part of the runtime of cotree, after the standard; the same for every model.
 */
#ifndef COTREE_FMI2_H
#define COTREE_FMI2_H

#include <stddef.h>

#if defined(_WIN32)
#define COTREE_FMI_EXPORT __declspec(dllexport)
#elif defined(__GNUC__) || defined(__clang__)
#define COTREE_FMI_EXPORT __attribute__((visibility("default")))
#else
#define COTREE_FMI_EXPORT
#endif

/* Functions have prefixes if several units are linked together. */
#ifdef FMI2_FUNCTION_PREFIX
#define COTREE_FMI_PASTE(a, b) a##b
#define COTREE_FMI_PASTE_VALUES(a, b) COTREE_FMI_PASTE(a, b)
#define FMI2(name) COTREE_FMI_PASTE_VALUES(FMI2_FUNCTION_PREFIX, name)
#else
#define FMI2(name) name
#endif

typedef void *fmi2Component;
typedef void *fmi2ComponentEnvironment;
typedef void *fmi2FMUstate;
typedef unsigned int fmi2ValueReference;
typedef double fmi2Real;
typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef char fmi2Char;
typedef const fmi2Char *fmi2String;
typedef char fmi2Byte;

#define fmi2True 1
#define fmi2False 0

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
    fmi2DoStepStatus,
    fmi2PendingStatus,
    fmi2LastSuccessfulTime,
    fmi2Terminated
} fmi2StatusKind;

typedef void (*fmi2CallbackLogger)(fmi2ComponentEnvironment, fmi2String name, fmi2Status,
                                   fmi2String category, fmi2String message, ...);
typedef void *(*fmi2CallbackAllocateMemory)(size_t, size_t);
typedef void (*fmi2CallbackFreeMemory)(void *);
typedef void (*fmi2StepFinished)(fmi2ComponentEnvironment, fmi2Status);

typedef struct {
    fmi2CallbackLogger logger;
    fmi2CallbackAllocateMemory allocateMemory;
    fmi2CallbackFreeMemory freeMemory;
    fmi2StepFinished stepFinished;
    fmi2ComponentEnvironment componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
    fmi2Boolean newDiscreteStatesNeeded;
    fmi2Boolean terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    fmi2Real nextEventTime;
} fmi2EventInfo;

#endif
