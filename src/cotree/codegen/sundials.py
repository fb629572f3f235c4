"""What C takes from SUNDIALS, whose headers are not there: functions, and the version they are of.

Vectors, matrices, solvers and CVODE itself are opaque; numbers are doubles, indices of 64 bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

#: Major and minor version whose structures ``cvode_job.c`` fills.
SUNDIALS_VERSION = (7, 9)

#: Result and arguments by name.
SUNDIALS_FUNCTIONS: Mapping[str, tuple[str, str]] = {
    "SUNContext_Create": ("int", "int communicator, void **context"),
    "SUNContext_ClearErrHandlers": ("int", "void *context"),
    "SUNContext_Free": ("int", "void **context"),
    "N_VMake_Serial": ("void *", "int64_t n, double *values, void *context"),
    "N_VGetArrayPointer": ("double *", "void *vector"),
    "N_VDestroy": ("void", "void *vector"),
    "SUNLinSolNewEmpty": ("void *", "void *context"),
    "SUNLinSolFreeEmpty": ("void", "void *solver"),
    "SUNMatNewEmpty": ("void *", "void *context"),
    "SUNMatFreeEmpty": ("void", "void *matrix"),
    "CVodeCreate": ("void *", "int family, void *context"),
    "CVodeInit": ("int", "void *cvode, cotree_cvode_rate rate, double t, void *y"),
    "CVodeReInit": ("int", "void *cvode, double t, void *y"),
    "CVodeFree": ("void", "void **cvode"),
    "CVodeSVtolerances": ("int", "void *cvode, double rtol, void *atols"),
    "CVodeSetUserData": ("int", "void *cvode, void *data"),
    "CVodeSetLinearSolver": ("int", "void *cvode, void *solver, void *matrix"),
    "CVodeSetLinSysFn": ("int", "void *cvode, cotree_cvode_system system"),
    "CVodeSetLinearSolutionScaling": ("int", "void *cvode, int is_on"),
    "CVodeSetMaxHnilWarns": ("int", "void *cvode, int most"),
    "CVodeSetNonlinConvCoef": ("int", "void *cvode, double share"),
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

#: Tells the version, before anything else is called.
VERSION_FUNCTION: Mapping[str, tuple[str, str]] = {
    "SUNDIALSGetVersionNumber": (
        "int",
        "int *major, int *minor, int *patch, char *label, int length",
    ),
}
