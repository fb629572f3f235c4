/* cotree_assembly_internal.h: declarations shared by the sources of cotree_assembly.h. */
#ifndef COTREE_ASSEMBLY_INTERNAL_H
#define COTREE_ASSEMBLY_INTERNAL_H

#include "cotree_assembly.h"

#define MODEL (a->run->model)
#define N_STATES (a->run->model->n_states)
#define N_SENSITIVITIES (a->run->n_blocks - 1)
#define N_COORDINATES (a->tables->n_coordinates)
#define N_SPEEDS (a->tables->n_speeds)

/* Number of positions whose gradients determine the characteristic length. */
#define POSITIONS 3

/* The change of a residual counts as cancelled if its remainder is below this fraction of the
 * largest change. */
#define REMAINDER_SHARE COTREE_SELECT(1e-8, 3.5e-04f)

/* Defined in cotree_assembly.c: */
COTREE_PRIVATE int cotree_assembly_is_quaternion(const cotree_assembly *a, int state);
COTREE_PRIVATE int cotree_assembly_is_angular(const cotree_assembly *a, int speed);
COTREE_PRIVATE cotree_real cotree_assembly_unit_of_speed(const cotree_assembly *a, int i);
COTREE_PRIVATE int cotree_assembly_is_shift(const cotree_assembly *a, int coordinate);
COTREE_PRIVATE int cotree_assembly_is_length(const cotree_assembly *a, int row);
COTREE_PRIVATE cotree_real cotree_assembly_unit_of_row(const cotree_assembly *a, int row);
COTREE_PRIVATE cotree_real cotree_assembly_scaled(const cotree_assembly *a, const cotree_real *x,
                                                  int i);
COTREE_PRIVATE void cotree_assembly_list_rows(cotree_assembly *a, int level, int has_conditions);
COTREE_PRIVATE cotree_real cotree_assembly_pick(const cotree_assembly *a, int row,
                                                const cotree_real *constraints,
                                                const cotree_real *conditions);
COTREE_PRIVATE int cotree_assembly_compute_residuals(cotree_assembly *a, cotree_real t,
                                                     const cotree_real *x, cotree_real *size);
COTREE_PRIVATE int cotree_assembly_compute_gradients(cotree_assembly *a, cotree_real t,
                                                     const cotree_real *x);
COTREE_PRIVATE const cotree_real *cotree_assembly_gradient_of(const cotree_assembly *a, int row);
COTREE_PRIVATE int cotree_assembly_factorise(cotree_assembly *a, cotree_real *largest);
COTREE_PRIVATE cotree_real cotree_assembly_largest_of(const cotree_real *x, int n);
COTREE_PRIVATE void cotree_assembly_copy(int n, const cotree_real *from, cotree_real *to);
COTREE_PRIVATE int cotree_assembly_iterate(cotree_assembly *a, cotree_real t, cotree_real *x,
                                           int level, cotree_real *residual);
COTREE_PRIVATE cotree_real cotree_assembly_entry_of(const cotree_assembly *a, int row, int speed);
COTREE_PRIVATE cotree_real cotree_assembly_remainder_of(const cotree_assembly *a, int row,
                                                        cotree_real change);
COTREE_PRIVATE cotree_real cotree_assembly_change_of(const cotree_assembly *a, int row, int column);

/* Defined in cotree_assembly_mend.c: */
COTREE_PRIVATE void cotree_assembly_factorise_given(cotree_assembly *a, cotree_real *largest);
COTREE_PRIVATE void cotree_assembly_solve_given(cotree_assembly *a);
COTREE_PRIVATE void cotree_assembly_start_report(cotree_assembly *a, int level,
                                                 const cotree_real *x);
COTREE_PRIVATE int cotree_assembly_mend(cotree_assembly *a, cotree_real t, cotree_real *x,
                                        int level, cotree_real met);
COTREE_PRIVATE int cotree_assembly_follow_with_given(cotree_assembly *a, int level, int column,
                                                     int seed, cotree_real allowed);

#endif
