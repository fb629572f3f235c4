/* cotree_integrator.c: descriptions of the integrator status codes. */
#include "cotree_integrator.h"

const char *cotree_status_message(cotree_status status)
{
    switch (status) {
    case COTREE_OK:
        return "success";
    case COTREE_BAD_ARGUMENT:
        return "a size, time, tolerance or initial value is out of range";
    case COTREE_TOO_MANY_STEPS:
        return "too many steps are needed";
    case COTREE_STEP_TOO_SMALL:
        return "the step size fell to rounding level";
    case COTREE_RATE_FAILED:
        return "the right-hand side fails";
    case COTREE_RATE_NOT_FINITE:
        return "the right-hand side is not finite";
    case COTREE_RATE_STOPPED:
        return "the right-hand side stopped the integration";
    case COTREE_PROJECTION_FAILED:
        return "the projection onto the constraints fails, or moves a step by many tolerances";
    case COTREE_NOT_FINITE:
        return "the solution is no longer finite";
    case COTREE_NOT_SOLVED:
        return "the algebraic unknowns cannot be solved for";
#if COTREE_HAS_ALGEBRAIC
    case COTREE_FOLD:
        return "the algebraic unknowns would jump to another solution";
#endif
    case COTREE_NOT_PROJECTED:
        return "the constraints cannot be satisfied";
#if COTREE_HAS_SUNDIALS
    case COTREE_NO_MEMORY:
        return "SUNDIALS could not allocate memory";
    case COTREE_CANNOT_START:
        return "the integrator cannot start";
    case COTREE_TOO_TIGHT:
        return "the tolerances are too tight for double precision";
    case COTREE_ERROR_TEST_FAILED:
        return "the error test failed repeatedly, or at the minimum step size";
    case COTREE_NOT_CONVERGED:
        return "Newton's method failed repeatedly, or at the minimum step size";
    case COTREE_SENSITIVITIES_FAILED:
        return "the rates of the sensitivities cannot be evaluated";
    case COTREE_FLAGGED:
        return "the integrator returned an unknown flag";
#endif
    }
    return "the status is unknown";
}
