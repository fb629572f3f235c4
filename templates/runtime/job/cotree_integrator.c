/* cotree_integrator.c: messages of the status codes shared by all integrators.
 * Part of the runtime of cotree, the same for every model. */
#include "cotree_integrator.h"

const char *cotree_status_message(cotree_status status)
{
    static const char *const messages[] = {
        [COTREE_OK] = "all is well",
        [COTREE_BAD_ARGUMENT] = "a size, time, tolerance or initial value is out of range",
        [COTREE_TOO_MANY_STEPS] = "too many steps are needed",
        [COTREE_STEP_TOO_SMALL] = "the step size fell to rounding level",
        [COTREE_RATE_FAILED] = "the right-hand side fails",
        [COTREE_RATE_NOT_FINITE] = "the right-hand side is not finite",
        [COTREE_RATE_STOPPED] = "the right-hand side stopped the integration",
        [COTREE_PROJECTION_FAILED] =
            "the projection onto the constraints fails, or moves a step by many tolerances",
        [COTREE_NOT_FINITE] = "the solution is no longer finite",
        [COTREE_NOT_SOLVED] = "the algebraic unknowns cannot be solved for",
        [COTREE_NOT_PROJECTED] = "the constraints cannot be met",
#if COTREE_HAS_SUNDIALS
        [COTREE_NO_MEMORY] = "SUNDIALS got no memory",
        [COTREE_CANNOT_START] = "it cannot start",
        [COTREE_TOO_TIGHT] = "the tolerances are too tight for double precision",
        [COTREE_ERROR_TEST_FAILED] =
            "the error test fails again and again, or the step size fell to its least",
        [COTREE_NOT_CONVERGED] =
            "Newton's method fails again and again, or the step size fell to its least",
        [COTREE_SENSITIVITIES_FAILED] = "the rates of sensitivities fail",
        [COTREE_FLAGGED] = "the integrator gives a flag of its own",
#endif
    };
    const size_t i = (size_t)status;
    if (i < sizeof messages / sizeof messages[0] && messages[i] != NULL) return messages[i];
    return "the status is unknown";
}
