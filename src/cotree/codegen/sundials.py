"""Declarations of SUNDIALS for C without its headers: the functions, and their version.

Vectors, solvers and integrators are opaque; numbers are doubles, indices of 64 bits. CVODES and
IDAS are CVODE and IDA with sensitivities, which have vectors of their own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

#: Major and minor version whose structures ``sundials_stepper.c`` fills.
SUNDIALS_VERSION = (7, 9)

_COMMON = {
    "SUNContext_Create": ("int", "int communicator, void **context"),
    "SUNContext_ClearErrHandlers": ("int", "void *context"),
    "SUNContext_Free": ("int", "void **context"),
    "N_VMake_Serial": ("void *", "int64_t n, double *values, void *context"),
    "N_VGetArrayPointer": ("double *", "void *vector"),
    "N_VDestroy": ("void", "void *vector"),
    "SUNNonlinSolNewEmpty": ("void *", "void *context"),
    "SUNNonlinSolFreeEmpty": ("void", "void *solver"),
}

_CVODE = {
    "CVodeCreate": ("void *", "int family, void *context"),
    "CVodeInit": ("int", "void *cvode, cotree_sundials_rate rate, double t, void *y"),
    "CVodeReInit": ("int", "void *cvode, double t, void *y"),
    "CVodeFree": ("void", "void **cvode"),
    "CVodeSVtolerances": ("int", "void *cvode, double rtol, void *atols"),
    "CVodeSetUserData": ("int", "void *cvode, void *data"),
    "CVodeSetNonlinearSolver": ("int", "void *cvode, void *solver"),
    "CVodeSetMaxHnilWarns": ("int", "void *cvode, int most"),
    "CVodeSetMaxStep": ("int", "void *cvode, double longest"),
    "CVodeSetStopTime": ("int", "void *cvode, double t"),
    "CVode": ("int", "void *cvode, double t_out, void *y, double *t, int task"),
    "CVodeGetDky": ("int", "void *cvode, double t, int order, void *values"),
    "CVodeGetNonlinearSystemData": (
        "int",
        "void *cvode, double *t, void **predicted, void **y, void **rates, double *gamma, "
        "double *rl1, void **scaled, void **data",
    ),
}

_IDA = {
    "IDACreate": ("void *", "void *context"),
    "IDAInit": ("int", "void *ida, cotree_sundials_residual residual, double t, void *y, void *dy"),
    "IDAReInit": ("int", "void *ida, double t, void *y, void *dy"),
    "IDAFree": ("void", "void **ida"),
    "IDASVtolerances": ("int", "void *ida, double rtol, void *atols"),
    "IDASetUserData": ("int", "void *ida, void *data"),
    "IDASetNonlinearSolver": ("int", "void *ida, void *solver"),
    "IDASetId": ("int", "void *ida, void *kinds"),
    "IDASetSuppressAlg": ("int", "void *ida, int is_on"),
    "IDASetInitStep": ("int", "void *ida, double step"),
    "IDASetMaxStep": ("int", "void *ida, double longest"),
    "IDASetStopTime": ("int", "void *ida, double t"),
    "IDASolve": ("int", "void *ida, double t_out, double *t, void *y, void *dy, int task"),
    "IDAGetDky": ("int", "void *ida, double t, int order, void *values"),
    "IDAGetNonlinearSystemData": (
        "int",
        "void *ida, double *t, void **predicted, void **slopes, void **y, void **dy, "
        "void **residual, double *cj, void **data",
    ),
}

_BOTH_WITH_SENSITIVITIES = {
    "N_VEnableFusedOps_Serial": ("int", "void *vector, int is_on"),
}

_CVODES = {
    "CVodeSensInit": (
        "int",
        "void *cvode, int n, int corrector, cotree_sundials_sensitivity_rate rate, void **s",
    ),
    "CVodeSensReInit": ("int", "void *cvode, int corrector, void **s"),
    "CVodeSensSVtolerances": ("int", "void *cvode, double rtol, void **atols"),
    "CVodeSetSensErrCon": ("int", "void *cvode, int is_on"),
    "CVodeSetNonlinearSolverSensSim": ("int", "void *cvode, void *solver"),
    "CVodeSetNonlinearSolverSensStg": ("int", "void *cvode, void *solver"),
    "CVodeGetSens": ("int", "void *cvode, double *t, void **s"),
    "CVodeGetSensDky": ("int", "void *cvode, double t, int order, void **values"),
    "CVodeGetNonlinearSystemDataSens": (
        "int",
        "void *cvode, double *t, void ***predicted, void ***s, double *gamma, double *rl1, "
        "void ***scaled, void **data",
    ),
}

_IDAS = {
    "IDASensInit": (
        "int",
        "void *ida, int n, int corrector, cotree_sundials_sensitivity_residual residual, "
        "void **s, void **ds",
    ),
    "IDASensReInit": ("int", "void *ida, int corrector, void **s, void **ds"),
    "IDASensSVtolerances": ("int", "void *ida, double rtol, void **atols"),
    "IDASetSensErrCon": ("int", "void *ida, int is_on"),
    "IDASetNonlinearSolverSensStg": ("int", "void *ida, void *solver"),
    "IDAGetSens": ("int", "void *ida, double *t, void **s"),
    "IDAGetSensDky": ("int", "void *ida, double t, int order, void **values"),
    "IDAGetNonlinearSystemDataSens": (
        "int",
        "void *ida, double *t, void ***predicted, void ***slopes, void ***s, void ***ds, "
        "double *cj, void **data",
    ),
}

#: Result and arguments by name, for each library.
SUNDIALS_FUNCTIONS: dict[str, Mapping[str, tuple[str, str]]] = {
    "cvode": {**_COMMON, **_CVODE},
    "ida": {**_COMMON, **_IDA},
    "cvodes": {**_COMMON, **_BOTH_WITH_SENSITIVITIES, **_CVODE, **_CVODES},
    "idas": {**_COMMON, **_BOTH_WITH_SENSITIVITIES, **_IDA, **_IDAS},
}

#: Libraries with sensitivities, and their counterparts without.
WITH_SENSITIVITIES: Mapping[str, str] = {"cvodes": "cvode", "idas": "ida"}

#: Meaning of negative results, without sensitivities and with them: names of
#: :data:`cotree.codegen.statuses.STATUSES`.
SUNDIALS_FLAGS: Mapping[str, Mapping[int, str]] = {
    "cvode": {
        -2: "TOO_TIGHT",
        -3: "ERROR_TEST_FAILED",
        -4: "NOT_CONVERGED",
        -8: "RATE_STOPPED",
        -9: "CANNOT_START",
        -10: "RATE_FAILED",
        -11: "RATE_FAILED",
        -41: "SENSITIVITIES_FAILED",
        -42: "SENSITIVITIES_FAILED",
        -43: "SENSITIVITIES_FAILED",
        -44: "SENSITIVITIES_FAILED",
    },
    "ida": {
        -2: "TOO_TIGHT",
        -3: "ERROR_TEST_FAILED",
        -4: "NOT_CONVERGED",
        -8: "RATE_STOPPED",
        -9: "RATE_FAILED",
        -12: "CANNOT_START",
        -42: "SENSITIVITIES_FAILED",
    },
}

#: Tells the version, before anything else is called.
VERSION_FUNCTION: Mapping[str, tuple[str, str]] = {
    "SUNDIALSGetVersionNumber": (
        "int",
        "int *major, int *minor, int *patch, char *label, int length",
    ),
}
