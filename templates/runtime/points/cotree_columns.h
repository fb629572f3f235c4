/* cotree_columns.h: evaluation of one kernel of a model at many points. */
#ifndef COTREE_COLUMNS_H
#define COTREE_COLUMNS_H

#include "cotree_abi.h"

COTREE_BEGIN_DECLS

/* Evaluate a kernel of the states, or one of sensitivities, at n_points points. The states x, the
 * sensitivities s and the results have one row for each point. If has_inputs is 0, the inputs of
 * the scene are written to u; otherwise u contains the inputs. p has one row of n_p values for each
 * point, for which k is prepared; if n_p is 0, all points share p and k. Return the number of
 * points evaluated before the first failure. */
COTREE_EXPORT int cotree_columns(const cotree_model *model, cotree_state_kernel of_states,
                                 cotree_sensitivity_kernel of_sensitivities, int n_points,
                                 const double *t, const double *x, const double *s, int n_s,
                                 const double *p, int n_p, double *k, int has_inputs, double *u,
                                 double *result, int n_result);

COTREE_END_DECLS

#endif
