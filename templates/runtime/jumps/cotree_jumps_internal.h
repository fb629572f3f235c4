/* cotree_jumps_internal.h: declarations shared by the sources of cotree_jumps.h.
 * Part of the runtime of cotree, the same for every model.
 */
#ifndef COTREE_JUMPS_INTERNAL_H
#define COTREE_JUMPS_INTERNAL_H

#include "cotree_jumps.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* The way back to the constraints: residuals below MET times the largest state are met, those
 * below ROUNDING are rounding. One step turns no angle by more than LONGEST. Rows that others
 * reach but for a share of RANK are redundant. */
#define MOST_STEPS 50

#define MET COTREE_SELECT(1e-11, 1.5e-05f)

#define ROUNDING COTREE_SELECT(1e-15, 2.4e-07f)

#define LONGEST COTREE_F(0.5)

#define RANK COTREE_SELECT(1e-10, 4.3e-05f)

#define MODEL (j->run->model)

#define N_STATES (j->run->model->n_states)

#define N_EVENTS (j->hybrid->n_events)

#define N_JUMPS (j->hybrid->n_jumps)

#define N_COORDINATES (j->hybrid->n_coordinates)

#define N_SPEEDS (j->hybrid->n_speeds)

#define N_SENSITIVITIES (j->run->n_blocks - 1)

/* cotree_jumps.c */
COTREE_PRIVATE int cotree_compute_rates_at(cotree_jumps *j, cotree_real t, const cotree_real *x);
COTREE_PRIVATE int cotree_complete_event(cotree_jumps *j, const cotree_event *row, cotree_real t,
                                         cotree_real *w);
COTREE_PRIVATE int cotree_first_new_value(const cotree_jumps *j, int event);

/* cotree_settle.c */
COTREE_PRIVATE int cotree_normalise(const cotree_jumps *j, cotree_real *x);
COTREE_PRIVATE int cotree_settle(cotree_jumps *j, cotree_real t, cotree_real *x, int level);
COTREE_PRIVATE int cotree_is_chosen(cotree_jumps *j, cotree_real t, const cotree_real *from,
                                    const cotree_real *to);
COTREE_PRIVATE int cotree_settle_sensitivities(cotree_jumps *j, cotree_real t, const cotree_real *x,
                                               cotree_real *s);

/* an event without targets */
static const cotree_event no_event = {"", 0, 0, 0, 0, 0, 0, NULL, 0, -1};

#endif
