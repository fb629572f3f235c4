/* cotree_fmi3.h: the types of the Functional Mock-up Interface 3.0. */
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef enum {
    fmi3Independent,
    fmi3Constant,
    fmi3Fixed,
    fmi3Tunable,
    fmi3Discrete,
    fmi3Dependent
} fmi3DependencyKind;
typedef enum {
    fmi3IntervalNotYetKnown,
    fmi3IntervalUnchanged,
    fmi3IntervalChanged
} fmi3IntervalQualifier;

typedef float fmi3Float32;
typedef int8_t fmi3Int8;
typedef uint8_t fmi3UInt8;
typedef int16_t fmi3Int16;
typedef uint16_t fmi3UInt16;
typedef int32_t fmi3Int32;
typedef uint32_t fmi3UInt32;
typedef int64_t fmi3Int64;
typedef uint64_t fmi3UInt64;
typedef bool fmi3Boolean;
typedef const char *fmi3String;
typedef const uint8_t *fmi3Binary;
typedef bool fmi3Clock;

typedef void (*fmi3LogMessageCallback)(void *environment, fmi3Status, fmi3String category,
                                       fmi3String message);
typedef void (*fmi3ClockUpdateCallback)(void *environment);
typedef void (*fmi3IntermediateUpdateCallback)(void *environment, double time, fmi3Boolean,
                                               fmi3Boolean, fmi3Boolean, fmi3Boolean, fmi3Boolean *,
                                               double *);
typedef void (*fmi3PreemptionCallback)(void);

/* Definitions for cotree_fmi.h. */
#ifndef FMI3_FUNCTION_PREFIX
#define FMI3_FUNCTION_PREFIX
#endif
#define FMI_FUNCTION(name) FMI_PASTE(FMI3_FUNCTION_PREFIX, fmi3##name)
#define FMI_EITHER(of_2, of_3) of_3
#define FMI_STATUS fmi3Status
#define FMI_BOOLEAN fmi3Boolean
#define FMI_BYTE uint8_t
