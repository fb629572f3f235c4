/* cotree_columns.h: evaluation of one kernel of a model at many points. */
#ifndef COTREE_COLUMNS_H
#define COTREE_COLUMNS_H

#include "cotree_abi.h"

COTREE_BEGIN_DECLS

/* Evaluate a kernel of the states, one of sensitivities, or neither, at n_points points. The states
 * x, the sensitivities s and the results have one row for each point, of n_x, n_s and n_result
 * numbers. If has_inputs is 0, the inputs of the scene are written to u; otherwise u contains the
 * inputs. If own_k is NULL, all points share p and k; otherwise p has one row for each point, for
 * which own_k is prepared. Return the number of points evaluated before the first failure. */
COTREE_EXPORT int cotree_columns(const cotree_model *model, cotree_state_kernel of_states,
                                 cotree_sensitivity_kernel of_sensitivities, int n_points,
                                 const double *t, const double *x, int n_x, const double *s,
                                 int n_s, const double *p, const double *k, double *own_k,
                                 int has_inputs, double *u, double *result, int n_result);

COTREE_END_DECLS

#endif
