/* cotree_integrator.c: descriptions of the integrator status codes. */
#include "cotree_integrator.h"

const char *cotree_status_message(cotree_status status)
{
    static const cotree_message messages[] = {
        {COTREE_OK, "success"},
        {COTREE_BAD_ARGUMENT, "a size, time, tolerance or initial value is out of range"},
        {COTREE_TOO_MANY_STEPS, "too many steps are needed"},
        {COTREE_STEP_TOO_SMALL, "the step size fell to rounding level"},
        {COTREE_RATE_FAILED, "the right-hand side fails"},
        {COTREE_RATE_NOT_FINITE, "the right-hand side is not finite"},
        {COTREE_RATE_STOPPED, "the right-hand side stopped the integration"},
        {COTREE_NOT_SOLVED, "the algebraic unknowns cannot be solved for"},
#if COTREE_HAS_CONSTRAINTS || COTREE_HAS_ALGEBRAIC
        {COTREE_PROJECTION_FAILED,
         "the projection onto the constraints fails, or moves a step by many tolerances"},
        {COTREE_NOT_PROJECTED, "the constraints cannot be satisfied"},
#endif
#if COTREE_HAS_ALGEBRAIC
        {COTREE_FOLD, "the algebraic unknowns would jump to another solution"},
#endif
#if COTREE_HAS_SUNDIALS
        {COTREE_NOT_FINITE, "the solution is no longer finite"},
        {COTREE_NO_MEMORY, "SUNDIALS could not allocate memory"},
        {COTREE_CANNOT_START, "the integrator cannot start"},
        {COTREE_TOO_TIGHT, "the tolerances are too tight for double precision"},
        {COTREE_ERROR_TEST_FAILED, "the error test failed repeatedly, or at the minimum step size"},
        {COTREE_NOT_CONVERGED, "Newton's method failed repeatedly, or at the minimum step size"},
        {COTREE_SENSITIVITIES_FAILED, "the rates of the sensitivities cannot be evaluated"},
        {COTREE_FLAGGED, "the integrator returned an unknown flag"},
#endif
        {-1, "the status is unknown"},
    };
    return cotree_find_message(messages, (int)status);
}
