/* cotree_columns.c: evaluation of one kernel at many points. */
#include "cotree_columns.h"

int cotree_columns(const cotree_model *model, cotree_state_kernel of_states,
                   cotree_sensitivity_kernel of_sensitivities, int n_points, const double *t,
                   const double *x, const double *s, int n_s, const double *p, int n_p, double *k,
                   int has_inputs, double *u, double *result, int n_result)
{
    int i, status = 0;
    for (i = 0; i < n_points; ++i) {
        const double *const states = x + (size_t)i * (size_t)model->n_states;
        const double *const own = n_p > 0 ? p + (size_t)i * (size_t)n_p : p;
        double *const inputs = u + (size_t)i * (size_t)model->n_inputs;
        double *const row = result + (size_t)i * (size_t)n_result;
        if (n_p > 0) status = model->prepare(own, k);
        if (status == 0 && model->n_inputs > 0 && !has_inputs) {
            status = model->inputs_of_time(t[i], own, k, inputs);
        }
        if (status == 0 && of_states != NULL) {
            status = of_states(t[i], states, inputs, own, k, row);
        } else if (status == 0) {
            status =
                of_sensitivities(t[i], states, s + (size_t)i * (size_t)n_s, inputs, own, k, row);
        }
        if (status != 0) break;
    }
    return i;
}
