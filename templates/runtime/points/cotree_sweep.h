/* cotree_sweep.h: inputs, outputs and their sensitivities at many points. */
#ifndef COTREE_SWEEP_H
#define COTREE_SWEEP_H

#include "cotree_abi.h"

COTREE_BEGIN_DECLS

/* Evaluate a model at the times t with states and sensitivities z, one row for each time. If
 * has_inputs is 0, the inputs of the scene are written to u; otherwise u contains the inputs. dy
 * may be NULL. Return 0, or the status of the first kernel that fails. */
COTREE_EXPORT int cotree_sweep(const cotree_model *model, const double *p, const double *k,
                               int n_points, const double *t, const double *z, int n_z,
                               int has_inputs, double *u, double *y, double *dy);

COTREE_END_DECLS

#endif
