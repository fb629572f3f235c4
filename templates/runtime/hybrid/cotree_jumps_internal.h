/* cotree_jumps_internal.h: declarations shared by the sources of cotree_jumps.h. */
#ifndef COTREE_JUMPS_INTERNAL_H
#define COTREE_JUMPS_INTERNAL_H

#include "cotree_jumps.h"

#define MODEL (j->run->model)
#define N_STATES (j->run->model->n_states)
#define N_EVENTS (j->hybrid->n_events)
#define N_JUMPS (j->hybrid->n_jumps)
#define N_SENSITIVITIES (j->run->n_blocks - 1)

/* Defined in cotree_jumps.c: */
COTREE_PRIVATE int cotree_find_before(cotree_jumps *j, cotree_real t, const cotree_real *w);
COTREE_PRIVATE int cotree_complete_event(cotree_jumps *j, const cotree_event *row, cotree_real t,
                                         cotree_real *w);
COTREE_PRIVATE int cotree_first_new_value(const cotree_jumps *j, int event);

/* an event that sets no states */
static const cotree_event no_event = {"", 0, 0, 0, 0, 0, 0, NULL, 0, -1};

#endif
