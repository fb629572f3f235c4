/* cotree_start_internal.h: declarations shared by the sources of cotree_start.h. */
#ifndef COTREE_START_INTERNAL_H
#define COTREE_START_INTERNAL_H

#include "cotree_start.h"

#include "cotree_event_kinds.h"

#define MODEL (start->run->model)
#define N_STATES (start->run->model->n_states)
#define N_RATES (start->run->n_rates)
#define N_SENSITIVITIES (start->run->n_blocks - 1)

#if COTREE_HAS_ALGEBRAIC
/* Defined in cotree_start_unknowns.c: */
COTREE_PRIVATE int cotree_start_complete_states(cotree_start *start, cotree_real t, cotree_real *z);
COTREE_PRIVATE int cotree_start_solve_all(cotree_start *start, cotree_real t, cotree_real *z);
COTREE_PRIVATE int cotree_start_solve_unknowns(cotree_start *start, cotree_real t, cotree_real *z);
#endif

#if COTREE_HAS_EVENTS
/* Defined in cotree_start_modes.c: */
COTREE_PRIVATE int cotree_start_count_events(const cotree_start *start, int kind);
#if COTREE_HAS_ALGEBRAIC
COTREE_PRIVATE int cotree_start_choose_friction_modes(cotree_start *start, cotree_real t,
                                                      cotree_real *z);
#endif
COTREE_PRIVATE int cotree_start_choose_jump_modes(cotree_start *start, cotree_real t,
                                                  cotree_real *z);
#if COTREE_HAS_SENSITIVITIES
COTREE_PRIVATE int cotree_start_check_jumps(cotree_start *start, cotree_real t,
                                            const cotree_real *z);
#endif
#endif

#endif
