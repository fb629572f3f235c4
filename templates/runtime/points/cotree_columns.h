/* cotree_columns.h: one kernel of a model at many points.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_COLUMNS_H
#define COTREE_COLUMNS_H

#include "cotree_abi.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Calls one kernel of a model, of the states or of sensitivities, at points with a row each of
 * states x, sensitivities s and results. Inputs are the scene's own and are written to u, or are
 * given there. Parameters have n_p values a row, for which k is prepared anew, or n_p is 0 and all
 * points share p and k. Returns how many points were done: the next one was refused, if there is
 * one. */
COTREE_EXPORT int cotree_columns(const cotree_model *model, cotree_state_kernel of_states,
                                 cotree_sensitivity_kernel of_sensitivities, int n_points,
                                 const double *t, const double *x, const double *s, int n_s,
                                 const double *p, int n_p, double *k, int has_inputs, double *u,
                                 double *result, int n_result);

#ifdef __cplusplus
}
#endif

#endif
