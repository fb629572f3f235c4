/* cotree_columns.c: evaluation of one kernel at many points. */
#include "cotree_columns.h"

int cotree_columns(const cotree_model *model, cotree_state_kernel of_states,
                   cotree_sensitivity_kernel of_sensitivities, int n_points, const double *t,
                   const double *x, int n_x, const double *s, int n_s, const double *p,
                   const double *k, double *own_k, int has_inputs, double *u, double *result,
                   int n_result)
{
    const size_t n_p = own_k == NULL ? 0 : (size_t)model->n_parameters;
    int n, status = 0;
    if (own_k != NULL) k = own_k;
    for (n = 0; n < n_points; ++n) {
        const size_t i = (size_t)n;
        const double *const states = x + i * (size_t)n_x, *const own = p + i * n_p;
        double *const inputs = u + i * (size_t)model->n_inputs;
        double *const row = result + i * (size_t)n_result;
        if (own_k != NULL) status = model->prepare(own, own_k);
        if (status == 0 && model->n_inputs > 0 && !has_inputs) {
            status = model->inputs_of_time(t[n], own, k, inputs);
        }
        if (status == 0 && of_states != NULL) {
            status = of_states(t[n], states, inputs, own, k, row);
        } else if (status == 0 && of_sensitivities != NULL) {
            status = of_sensitivities(t[n], states, s + i * (size_t)n_s, inputs, own, k, row);
        }
        if (status != 0) break;
    }
    return n;
}
