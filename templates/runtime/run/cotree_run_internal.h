/* cotree_run_internal.h: declarations shared by the sources of cotree_run.h. */
#ifndef COTREE_RUN_INTERNAL_H
#define COTREE_RUN_INTERNAL_H

#include "cotree_run.h"

#if COTREE_HAS_ALGEBRAIC || COTREE_HAS_CONSTRAINTS
#include "cotree_iteration.h"
#endif

#define ROUNDING (COTREE_F(4.0) * COTREE_EPSILON)
#define N_STATES (run->model->n_states)
#define N_ALGEBRAIC (run->model->n_algebraic)
#define N_RATES (run->n_rates)

/* Defined in cotree_run.c: */
COTREE_PRIVATE void cotree_pack(const cotree_run *run, int n, const cotree_real *s,
                                cotree_real *packed);
COTREE_PRIVATE int cotree_prepare_point(cotree_run *run, cotree_real t, const cotree_real *w);

/* Defined in cotree_projection.c: */
COTREE_PRIVATE int cotree_are_rates_projected(const cotree_run *run);
COTREE_PRIVATE void cotree_count_failure(cotree_run *run);

/* Defined in cotree_algebraic.c: */
COTREE_PRIVATE int cotree_guess_place(const cotree_run *run, cotree_real t, int rank);
COTREE_PRIVATE int cotree_solve_linearised(const cotree_run *run, const cotree_real *g,
                                           cotree_real *step);
COTREE_PRIVATE int cotree_linearise(cotree_run *run, cotree_real t, const cotree_real *x);
COTREE_PRIVATE void cotree_store_guess(cotree_run *run, cotree_real t, const cotree_real *x);
COTREE_PRIVATE int cotree_solve_unknowns(cotree_run *run, cotree_real t, int is_near,
                                         cotree_real goal, cotree_real near_zero, int *is_wide);
COTREE_PRIVATE int cotree_solve_unknown_sensitivities(cotree_run *run, cotree_real t,
                                                      const cotree_real *s);
COTREE_PRIVATE int cotree_reduced_rate(cotree_run *run, cotree_real t, const cotree_real *w,
                                       cotree_real *dw);
/* Replace the stored guesses by the last accepted unknowns if the latest guess is far from them. */
COTREE_PRIVATE void cotree_forget_far_guesses(cotree_run *run);
COTREE_PRIVATE int cotree_project_unknowns(cotree_run *run, cotree_real t, cotree_real *w);

#endif
