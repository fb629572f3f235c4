/* Drives an FMU of FMI 3 through a sequence of calls that bytes choose, legal ones and illegal ones.
 *
 * usage: driver < bytes. Prints how many calls were refused, and how many of these were logged.
 */
#include "cotree_fmi3.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *fmi3GetVersion(void);
fmi3Instance fmi3InstantiateModelExchange(fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean,
    fmi3InstanceEnvironment, fmi3LogMessageCallback);
fmi3Instance fmi3InstantiateCoSimulation(fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean,
    fmi3Boolean, fmi3Boolean, const fmi3ValueReference[], size_t, fmi3InstanceEnvironment,
    fmi3LogMessageCallback, fmi3IntermediateUpdateCallback);
void fmi3FreeInstance(fmi3Instance);
fmi3Status fmi3EnterInitializationMode(fmi3Instance, fmi3Boolean, fmi3Float64, fmi3Float64, fmi3Boolean,
    fmi3Float64);
fmi3Status fmi3ExitInitializationMode(fmi3Instance);
fmi3Status fmi3EnterEventMode(fmi3Instance);
fmi3Status fmi3Terminate(fmi3Instance);
fmi3Status fmi3Reset(fmi3Instance);
fmi3Status fmi3GetFloat64(fmi3Instance, const fmi3ValueReference[], size_t, fmi3Float64[], size_t);
fmi3Status fmi3SetFloat64(fmi3Instance, const fmi3ValueReference[], size_t, const fmi3Float64[], size_t);
fmi3Status fmi3GetInt32(fmi3Instance, const fmi3ValueReference[], size_t, fmi3Int32[], size_t);
fmi3Status fmi3GetFMUState(fmi3Instance, fmi3FMUState *);
fmi3Status fmi3SetFMUState(fmi3Instance, fmi3FMUState);
fmi3Status fmi3FreeFMUState(fmi3Instance, fmi3FMUState *);
fmi3Status fmi3SerializedFMUStateSize(fmi3Instance, fmi3FMUState, size_t *);
fmi3Status fmi3SerializeFMUState(fmi3Instance, fmi3FMUState, fmi3Byte[], size_t);
fmi3Status fmi3DeserializeFMUState(fmi3Instance, const fmi3Byte[], size_t, fmi3FMUState *);
fmi3Status fmi3GetDirectionalDerivative(fmi3Instance, const fmi3ValueReference[], size_t,
    const fmi3ValueReference[], size_t, const fmi3Float64[], size_t, fmi3Float64[], size_t);
fmi3Status fmi3GetAdjointDerivative(fmi3Instance, const fmi3ValueReference[], size_t,
    const fmi3ValueReference[], size_t, const fmi3Float64[], size_t, fmi3Float64[], size_t);
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance, fmi3Boolean *, fmi3Boolean *, fmi3Boolean *,
    fmi3Boolean *, fmi3Boolean *, fmi3Float64 *);
fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance);
fmi3Status fmi3EnterStepMode(fmi3Instance);
fmi3Status fmi3EnterConfigurationMode(fmi3Instance);
fmi3Status fmi3CompletedIntegratorStep(fmi3Instance, fmi3Boolean, fmi3Boolean *, fmi3Boolean *);
fmi3Status fmi3SetTime(fmi3Instance, fmi3Float64);
fmi3Status fmi3SetContinuousStates(fmi3Instance, const fmi3Float64[], size_t);
fmi3Status fmi3GetContinuousStates(fmi3Instance, fmi3Float64[], size_t);
fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance, fmi3Float64[], size_t);
fmi3Status fmi3GetEventIndicators(fmi3Instance, fmi3Float64[], size_t);
fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance, fmi3Float64[], size_t);
fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance, size_t *);
fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance, size_t *);
fmi3Status fmi3DoStep(fmi3Instance, fmi3Float64, fmi3Float64, fmi3Boolean, fmi3Boolean *, fmi3Boolean *,
    fmi3Boolean *, fmi3Float64 *);

#define MOST 64

static unsigned n_logged;

static void log_message(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category,
                        fmi3String message)
{
    (void)environment;
    if (status != fmi3OK && category != NULL && message != NULL && message[0] != '\0') ++n_logged;
}

static int next(void)
{
    const int byte = getchar();
    return byte == EOF ? -1 : byte;
}

/* A number, sometimes none that is finite, or a value that no model accepts. */
static double number(int byte)
{
    static const double odd[] = {0.0, -1.0, 1e-3, 0.1, 0.5, 1.0, 2.0, 1e6, -1e6, 1e300, 0.01, 0.02};
    if (byte == 255) return strtod("nan", NULL);
    if (byte == 254) return strtod("inf", NULL);
    return odd[(unsigned)byte % (sizeof(odd) / sizeof(odd[0]))];
}

int main(void)
{
    fmi3Instance units[2] = {NULL, NULL};
    fmi3FMUState states[2] = {NULL, NULL};
    fmi3Byte *bytes = NULL;
    size_t n_bytes = 0, n_states = 0, n_refused = 0, n_calls = 0;
    double times[2] = {0.0, 0.0};
    int call;
    while ((call = next()) >= 0) {
        const int a = next(), b = next(), i = a & 1;
        fmi3Instance unit = units[i];
        fmi3Status status = fmi3OK;
        fmi3Boolean flags[5];
        fmi3Float64 values[MOST], result[MOST], t = 0.0;
        fmi3ValueReference references[MOST];
        size_t k, n = (size_t)(b & 7), m;
        unsigned before = n_logged;
        if (a < 0 || b < 0) break;
        for (k = 0; k < MOST; ++k) {
            values[k] = number((a * 7 + (int)k * b) & 255);
            references[k] = (fmi3ValueReference)((a / 2 + (int)k * (b / 8)) % 40);
        }
        ++n_calls;
        if (units[i] == NULL) {
            /* A wrong token now and then. */
            const char *const token = b == 7 ? "{wrong}" : TOKEN;
            units[i] = a & 2 ? fmi3InstantiateModelExchange("a", token, NULL, 0, 1, NULL, log_message)
                             : fmi3InstantiateCoSimulation("b", token, NULL, 0, 1, b == 9, a & 4 ? 1 : 0,
                                                           NULL, 0, NULL, log_message, NULL);
            times[i] = 0.0;
            if (units[i] == NULL && n_logged == before) return 3;
            continue;
        }
        fmi3GetNumberOfContinuousStates(unit, &n_states);
        if (n_states > MOST) return 4;
        m = b & 16 ? n_states : n;
        switch (call % 29) {
        case 0: status = fmi3EnterInitializationMode(unit, a & 4, 1e-6, 0.0, a & 8, number(b)); break;
        case 1: status = fmi3ExitInitializationMode(unit); break;
        case 2: status = fmi3EnterEventMode(unit); break;
        case 3: status = b < 20 ? fmi3Terminate(unit) : fmi3OK; break;
        case 4: status = b < 40 ? fmi3Reset(unit) : fmi3OK; if (b < 40) times[i] = 0.0; break;
        case 5: case 6: status = fmi3GetFloat64(unit, references, n, result, b == 77 ? n + 1 : n); break;
        case 7: case 8: status = fmi3SetFloat64(unit, references, n, values, n); break;
        case 9: { fmi3Int32 whole[MOST]; status = fmi3GetInt32(unit, references, n, whole, n); } break;
        case 10: status = fmi3GetFMUState(unit, &states[(b >> 3) & 1]); break;
        case 11: status = fmi3SetFMUState(unit, states[(b >> 3) & 1]); break;
        case 12: status = fmi3FreeFMUState(unit, &states[(b >> 3) & 1]); break;
        case 13:
            status = fmi3SerializedFMUStateSize(unit, states[0], &n_bytes);
            if (status != fmi3OK) break;
            free(bytes);
            bytes = (fmi3Byte *)malloc(n_bytes);
            if (bytes == NULL) return 5;
            status = fmi3SerializeFMUState(unit, states[0], bytes, b == 3 ? n_bytes - 1 : n_bytes);
            if (status != fmi3OK) { free(bytes); bytes = NULL; }
            break;
        case 14: status = fmi3DeserializeFMUState(unit, bytes, b == 3 ? n_bytes / 2 : n_bytes, &states[1]); break;
        case 15:
            status = fmi3GetDirectionalDerivative(unit, references, n, references + 8, n, values, n, result, n);
            break;
        case 16:
            status = fmi3GetAdjointDerivative(unit, references, n, references + 8, n, values, n, result, n);
            break;
        case 17: case 18:
            status = fmi3UpdateDiscreteStates(unit, flags, flags + 1, flags + 2, flags + 3, flags + 4, &t);
            break;
        case 19: case 20: status = fmi3EnterContinuousTimeMode(unit); break;
        case 21: status = fmi3CompletedIntegratorStep(unit, a & 4, flags, b == 5 ? NULL : flags + 1); break;
        case 22: status = fmi3SetTime(unit, b < 200 ? (times[i] += 0.01) : number(b)); break;
        case 23: status = fmi3SetContinuousStates(unit, values, m); break;
        case 24: status = fmi3GetContinuousStates(unit, result, m);
            if (status == fmi3OK) status = fmi3GetContinuousStateDerivatives(unit, result, m);
            break;
        case 25: fmi3GetNumberOfEventIndicators(unit, &n); status = fmi3GetEventIndicators(unit, result, n); break;
        case 26: case 27:
            status = fmi3DoStep(unit, b < 220 ? times[i] : 3.0, b < 200 ? 0.02 : number(b), 1, flags, flags + 1,
                                flags + 2, b == 6 ? NULL : &t);
            if (status == fmi3OK) times[i] = t;
            break;
        default:
            if (b < 10) {
                fmi3FreeInstance(unit);
                units[i] = NULL;
            } else {
                status = b < 60 ? fmi3EnterStepMode(unit) : fmi3EnterConfigurationMode(unit);
            }
        }
        if (status != fmi3OK) {
            ++n_refused;
            if (n_logged == before) {
                printf("call %d with %d %d is refused without a message\n", call % 29, a, b);
                return 2;
            }
        }
    }
    for (call = 0; call < 2; ++call) {
        fmi3FreeFMUState(units[0] != NULL ? units[0] : units[1], &states[call]);
        if (units[0] == NULL && units[1] == NULL) free(states[call]);
    }
    for (call = 0; call < 2; ++call) fmi3FreeInstance(units[call]);
    free(bytes);
    printf("%lu calls, %lu refused\n", (unsigned long)n_calls, (unsigned long)n_refused);
    return 0;
}
