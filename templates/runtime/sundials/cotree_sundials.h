/* cotree_sundials.h: functions of SUNDIALS that a job calls, loaded at run time.
 *
 * Vectors, solvers and integrators are opaque pointers. Numbers are doubles, and indices have 64
 * bits. */
#ifndef COTREE_SUNDIALS_H
#define COTREE_SUNDIALS_H

#include "cotree_job.h"

#include <stdint.h>

/* The library: COTREE_IDA is 1 for IDA, 0 for CVODE. COTREE_SENSITIVITIES is 1 for IDAS and CVODES,
 * with one vector for each sensitivity. COTREE_SIMULTANEOUS is 1 if sensitivities may be solved for
 * simultaneously with the states, as in CVODES. */
#ifndef COTREE_IDA
#define COTREE_IDA 0
#endif
#ifndef COTREE_SENSITIVITIES
#define COTREE_SENSITIVITIES 0
#endif
#ifndef COTREE_SIMULTANEOUS
#define COTREE_SIMULTANEOUS (COTREE_SENSITIVITIES && !COTREE_IDA)
#endif

/* Right-hand side of CVODE; residual of IDA. */
typedef int (*cotree_sundials_rate)(double t, void *y, void *dy, void *data);
typedef int (*cotree_sundials_residual)(double t, void *y, void *dy, void *left, void *data);
#if COTREE_SENSITIVITIES
/* The corresponding functions for all sensitivities, with one vector each. */
typedef int (*cotree_sundials_sensitivity_rate)(int n, double t, void *y, void *dy, void **s,
                                                void **ds, void *data, void *work, void *more);
typedef int (*cotree_sundials_sensitivity_residual)(int n, double t, void *y, void *dy, void *left,
                                                    void **s, void **ds, void **lefts, void *data,
                                                    void *work, void *more, void *most);
#endif

/* Functions of the library, by name. */
typedef struct cotree_sundials {
    int (*SUNContext_Create)(int communicator, void **context);
    int (*SUNContext_ClearErrHandlers)(void *context);
    int (*SUNContext_Free)(void **context);
    void *(*N_VMake_Serial)(int64_t n, double *values, void *context);
    double *(*N_VGetArrayPointer)(void *vector);
    void (*N_VDestroy)(void *vector);
    void *(*SUNNonlinSolNewEmpty)(void *context);
    void (*SUNNonlinSolFreeEmpty)(void *solver);
#if COTREE_IDA
    void *(*IDACreate)(void *context);
    int (*IDAInit)(void *ida, cotree_sundials_residual residual, double t, void *y, void *dy);
    int (*IDAReInit)(void *ida, double t, void *y, void *dy);
    void (*IDAFree)(void **ida);
    int (*IDASVtolerances)(void *ida, double rtol, void *atols);
    int (*IDASetUserData)(void *ida, void *data);
    int (*IDASetNonlinearSolver)(void *ida, void *solver);
    int (*IDASetId)(void *ida, void *kinds);
    int (*IDASetSuppressAlg)(void *ida, int is_on);
    int (*IDASetInitStep)(void *ida, double step);
    int (*IDASetMaxStep)(void *ida, double longest);
    int (*IDASetStopTime)(void *ida, double t);
    int (*IDASolve)(void *ida, double t_out, double *t, void *y, void *dy, int task);
    int (*IDAGetDky)(void *ida, double t, int order, void *values);
    int (*IDAGetNonlinearSystemData)(void *ida, double *t, void **predicted, void **slopes,
                                     void **y, void **dy, void **residual, double *cj, void **data);
#else
    void *(*CVodeCreate)(int family, void *context);
    int (*CVodeInit)(void *cvode, cotree_sundials_rate rate, double t, void *y);
    int (*CVodeReInit)(void *cvode, double t, void *y);
    void (*CVodeFree)(void **cvode);
    int (*CVodeSVtolerances)(void *cvode, double rtol, void *atols);
    int (*CVodeSetUserData)(void *cvode, void *data);
    int (*CVodeSetNonlinearSolver)(void *cvode, void *solver);
    int (*CVodeSetMaxHnilWarns)(void *cvode, int most);
    int (*CVodeSetMaxStep)(void *cvode, double longest);
    int (*CVodeSetStopTime)(void *cvode, double t);
    int (*CVode)(void *cvode, double t_out, void *y, double *t, int task);
    int (*CVodeGetDky)(void *cvode, double t, int order, void *values);
    int (*CVodeGetNonlinearSystemData)(void *cvode, double *t, void **predicted, void **y,
                                       void **rates, double *gamma, double *rl1, void **scaled,
                                       void **data);
#endif
#if COTREE_SENSITIVITIES
    int (*N_VEnableFusedOps_Serial)(void *vector, int is_on);
#if COTREE_IDA
    int (*IDASensInit)(void *ida, int n, int corrector,
                       cotree_sundials_sensitivity_residual residual, void **s, void **ds);
    int (*IDASensReInit)(void *ida, int corrector, void **s, void **ds);
    int (*IDASensSVtolerances)(void *ida, double rtol, void **atols);
    int (*IDASetSensErrCon)(void *ida, int is_on);
    int (*IDASetNonlinearSolverSensStg)(void *ida, void *solver);
    int (*IDAGetSens)(void *ida, double *t, void **s);
    int (*IDAGetSensDky)(void *ida, double t, int order, void **values);
    int (*IDAGetNonlinearSystemDataSens)(void *ida, double *t, void ***predicted, void ***slopes,
                                         void ***s, void ***ds, double *cj, void **data);
#else
    int (*CVodeSensInit)(void *cvode, int n, int corrector, cotree_sundials_sensitivity_rate rate,
                         void **s);
    int (*CVodeSensReInit)(void *cvode, int corrector, void **s);
    int (*CVodeSensSVtolerances)(void *cvode, double rtol, void **atols);
    int (*CVodeSetSensErrCon)(void *cvode, int is_on);
    int (*CVodeSetNonlinearSolverSensSim)(void *cvode, void *solver);
    int (*CVodeSetNonlinearSolverSensStg)(void *cvode, void *solver);
    int (*CVodeGetSens)(void *cvode, double *t, void **s);
    int (*CVodeGetSensDky)(void *cvode, double t, int order, void **values);
    int (*CVodeGetNonlinearSystemDataSens)(void *cvode, double *t, void ***predicted, void ***s,
                                           double *gamma, double *rl1, void ***scaled, void **data);
#endif
#endif
} cotree_sundials;

/* Data of a job that SUNDIALS integrates. */
typedef struct cotree_sundials_aid {
    const cotree_sundials *sundials;
    int lower, upper;  /* bandwidths of the Jacobian, with the unknowns in the order of `places` */
    const int *places; /* position of each unknown in a banded order; NULL: unchanged order */
    int are_followed;  /* 1: sensitivities are outside the error test */
    int corrector;     /* for separate sensitivity vectors: 1 simultaneous, 2 staggered */
} cotree_sundials_aid;

/* Return the stepper of a job. Each function is defined in the library that is compiled for it. */
COTREE_EXPORT const cotree_stepper *cotree_cvode_stepper(void);
COTREE_EXPORT const cotree_stepper *cotree_cvodes_stepper(void);
COTREE_EXPORT const cotree_stepper *cotree_ida_stepper(void);
COTREE_EXPORT const cotree_stepper *cotree_idas_stepper(void);

#endif
