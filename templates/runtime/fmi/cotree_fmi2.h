/* cotree_fmi2.h: the types of the Functional Mock-up Interface 2.0. */
#include <stddef.h>

typedef enum { fmi2OK, fmi2Warning, fmi2Discard, fmi2Error, fmi2Fatal, fmi2Pending } fmi2Status;
typedef enum { fmi2ModelExchange, fmi2CoSimulation } fmi2Type;
typedef enum {
    fmi2DoStepStatus,
    fmi2PendingStatus,
    fmi2LastSuccessfulTime,
    fmi2Terminated
} fmi2StatusKind;

typedef int fmi2Integer;
typedef int fmi2Boolean;
typedef const char *fmi2String;

typedef void (*fmi2CallbackLogger)(void *environment, fmi2String name, fmi2Status,
                                   fmi2String category, fmi2String message, ...);

typedef struct {
    fmi2CallbackLogger logger;
    void *(*allocateMemory)(size_t, size_t);
    void (*freeMemory)(void *);
    void (*stepFinished)(void *environment, fmi2Status);
    void *componentEnvironment;
} fmi2CallbackFunctions;

typedef struct {
    fmi2Boolean newDiscreteStatesNeeded;
    fmi2Boolean terminateSimulation;
    fmi2Boolean nominalsOfContinuousStatesChanged;
    fmi2Boolean valuesOfContinuousStatesChanged;
    fmi2Boolean nextEventTimeDefined;
    double nextEventTime;
} fmi2EventInfo;

/* Definitions for cotree_fmi.h. */
#ifndef FMI2_FUNCTION_PREFIX
#define FMI2_FUNCTION_PREFIX
#endif
#define FMI_FUNCTION(name) FMI_PASTE(FMI2_FUNCTION_PREFIX, fmi2##name)
#define FMI_EITHER(of_2, of_3) of_2
#define FMI_STATUS fmi2Status
#define FMI_BOOLEAN fmi2Boolean
#define FMI_BYTE char
