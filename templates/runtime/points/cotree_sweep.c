/* cotree_sweep.c: inputs, outputs and their sensitivities at many points. */
#include "cotree_sweep.h"

int cotree_sweep(const cotree_model *model, const double *p, const double *k, int n_points,
                 const double *t, const double *z, int n_z, int has_inputs, double *u, double *y,
                 double *dy)
{
    const int n_y = model->n_outputs, n_dy = model->n_outputs * model->n_sensitivities;
    int i, status = 0;
    for (i = 0; i < n_points && status == 0; ++i) {
        const double *const x = z + (size_t)i * (size_t)n_z, *const s = x + model->n_states;
        double *const own = u + (size_t)i * (size_t)model->n_inputs;
        if (model->n_inputs > 0 && !has_inputs) status = model->inputs_of_time(t[i], p, k, own);
        if (status == 0 && n_y > 0) {
            status = model->outputs_of_state(t[i], x, own, p, k, y + (size_t)i * (size_t)n_y);
        }
        if (status == 0 && n_dy > 0 && dy != NULL) {
            double *const row = dy + (size_t)i * (size_t)n_dy;
            status = model->output_sensitivity(t[i], x, s, own, p, k, row);
        }
    }
    return status;
}
