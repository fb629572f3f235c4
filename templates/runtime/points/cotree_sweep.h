/* cotree_sweep.h: inputs, outputs and their sensitivities at many points.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_SWEEP_H
#define COTREE_SWEEP_H

#include "cotree_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Evaluates a model at points t with states and sensitivities z, a row each. Inputs are the scene's
 * own and are written to u, or are given there. dy may be NULL. Returns the first kernel's
 * complaint, or 0. */
COTREE_EXPORT int cotree_sweep(const cotree_model *model, const double *p, const double *k,
                               int n_points, const double *t, const double *z, int n_z,
                               int has_inputs, double *u, double *y, double *dy);

#ifdef __cplusplus
}
#endif

#endif
