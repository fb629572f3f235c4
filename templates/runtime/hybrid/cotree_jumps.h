/* cotree_jumps.h: event functions of a model, and jumps of states and sensitivities at its events.
 *
 * Let f be the rates, g the event function and R(x) the states after the event; - and + denote
 * values before and after it. The derivatives of the event time with respect to the parameters are
 * t_p = -(g_x S- + g_p) / (g_x f- + g_t), and S+ = R_x S- + R_p + (R_x f- + R_t - f+) t_p. In
 * models with constraints, the states that the event sets are kept, and all other states are
 * projected onto the constraints with minimum norm.
 *
 * w is the vector that a run integrates. No memory is allocated. */
#ifndef COTREE_JUMPS_H
#define COTREE_JUMPS_H

#include "cotree_event_kinds.h"
#include "cotree_rows.h"
#include "cotree_run.h"
#if COTREE_HAS_CONSTRAINTS
#include "cotree_assembly.h"
#endif

COTREE_BEGIN_DECLS

/* Statuses in addition to those of kernels. */
#define COTREE_JUMPS_CONTRADICT 100      /* the new values violate the constraints */
#define COTREE_JUMPS_UNDERDETERMINED 101 /* the projection is not unique: no sensitivities */

/* Event functions and rates at one point. The mode selection and the application of an event
 * evaluate some points several times. */
typedef struct cotree_evaluation {
    int has_values, has_rates;
    cotree_real t;
    cotree_real *point; /* states, inputs and frozen branches */
    cotree_real *values, *rates, *state_rates;
} cotree_evaluation;

#define COTREE_RECENT 3 /* number of evaluations that are kept */

typedef struct cotree_jumps {
    cotree_run *run;
    const cotree_hybrid *hybrid;
    /* Results of the last evaluation: */
    cotree_real *values; /* event functions, then branches, then quantities of ranges */
    cotree_real *rates;  /* time derivatives of the event functions, then of all new values */
    cotree_real *state_rates;
    cotree_real *before, *after; /* all states and sensitivities before and after the last event */
    cotree_real *time_sensitivity; /* derivatives of the event time with respect to parameters */
    /* The rest is private. */
    cotree_real *jump_rates; /* time derivatives of R: R_x f- + R_t */
    cotree_evaluation recent[COTREE_RECENT];
    int n_recent, oldest; /* number of evaluations; index of the evaluation that is replaced next */
    cotree_real *other_values; /* values at a point whose rates were not evaluated */
    cotree_real *value_slopes, *new_values;
    /* Work space for impacts. */
    cotree_real *w_work, *packed, *response, *impulse_forces, *force_slopes;
#if COTREE_HAS_CONSTRAINTS
    cotree_assembly_tables constraints;
    cotree_assembly assembly;
#endif
} cotree_jumps;

/* Return whether an event begins or ends slip at the contact of a stop. Its targets are then the
 * mode of friction, the mode of the stop, and the impulse. */
int cotree_is_contact_slip(const cotree_event *event);

/* Initialise for a model that has events. */
void cotree_jumps_init(cotree_jumps *j, cotree_run *run, cotree_arena *arena);

/* Forget all evaluations, since parameters may have changed. */
void cotree_jumps_forget(cotree_jumps *j);

/* Compute j->values at w. */
int cotree_jumps_values(cotree_jumps *j, cotree_real t, const cotree_real *w);

/* Compute bounds of the event functions from bounds of the quantities. All other values in them are
 * those at the last evaluated point. */
int cotree_jumps_ranges(cotree_jumps *j, cotree_real t, const cotree_real *box,
                        cotree_real *ranges);

/* Compute j->rates at w. */
int cotree_jumps_rates(cotree_jumps *j, cotree_real t, const cotree_real *w);

/* Apply an event: change w, and write before, after and, unless the time is fixed,
 * time_sensitivity. */
int cotree_jumps_apply(cotree_jumps *j, int event, cotree_real t, cotree_real *w,
                       int is_time_fixed);

/* Write the modes of all rows, or those of an impact, and the directions of sliding to x. */
void cotree_rows_store(const cotree_row *rows, int n_rows, int is_impact, cotree_real *x);

/* Set the modes of all rows, and their directions of sliding, as part of the last event. */
int cotree_jumps_set_modes(cotree_jumps *j, const cotree_row *rows, int n_rows, cotree_real t,
                           cotree_real *w);

/* Apply an impulse to the rows as part of the last event. Modes are unchanged. is_residual: 1 if
 * the impulse only removes numerical errors of speeds, so that no state records it. */
int cotree_jumps_apply_impulse(cotree_jumps *j, const cotree_row *rows, int n_rows, int is_residual,
                               cotree_real t, cotree_real *w);

/* Compute the states after an impulse, without sensitivities, and write the changes of all event
 * functions, some of which are impulses, to impulse_forces. */
int cotree_jumps_try_impulse(cotree_jumps *j, const cotree_row *rows, int n_rows, cotree_real t,
                             const cotree_real *w, cotree_real *after);

/* Compute the new values of all events at w. */
int cotree_jumps_compute_new_values(cotree_jumps *j, cotree_real t, const cotree_real *w);

/* Return the first new value of an event from the last evaluation, or whether this value differs
 * from the current one. */
cotree_real cotree_jumps_new_value(const cotree_jumps *j, int event);
int cotree_jumps_changes_value(const cotree_jumps *j, int event);

/* Change the sensitivities in w along a direction in state space until an event function depends on
 * no parameter. slope: derivative of the event function along the direction. */
int cotree_jumps_move_sensitivities(cotree_jumps *j, int event, const cotree_real *direction,
                                    cotree_real slope, cotree_real t, cotree_real *w);

/* Determine whether an event function depends on a sensitivity parameter. Return the status of the
 * kernels. */
int cotree_jumps_depends_on_parameters(cotree_jumps *j, int event, cotree_real t, cotree_real *w,
                                       int *is_dependent);

/* Return whether the times of two events have the same derivatives with respect to all parameters,
 * according to the last call of cotree_jumps_depends_on_parameters. */
int cotree_jumps_share_time(const cotree_jumps *j, int a, int b);

/* Determine, from the values and rates at two points, whether the times of an event function's
 * zeros near these points have the same derivatives with respect to all parameters. Return the
 * status of the kernels. */
int cotree_jumps_compare_times(cotree_jumps *j, int event, cotree_real t, cotree_real *w,
                               cotree_real t_other, cotree_real *w_other, int *is_same);

/* Compute the rates of the states at w. */
int cotree_jumps_state_rates(cotree_jumps *j, cotree_real t, const cotree_real *w,
                             cotree_real *rates);

/* Compute the rates of the states at w in both modes of a jump. x: the states in the mode that is
 * not the current one. */
int cotree_jumps_sides(cotree_jumps *j, int event, cotree_real t, const cotree_real *w,
                       cotree_real *x, cotree_real *now, cotree_real *other);

/* Return the new value of one of an event's targets from the last evaluation. */
cotree_real cotree_jumps_target_value(const cotree_jumps *j, int event, int target);

/* Return the change of speed that an event prescribes (its last new value), or the rate of that
 * value. */
cotree_real cotree_jumps_speed_change(const cotree_jumps *j, int event);
cotree_real cotree_jumps_speed_change_rate(const cotree_jumps *j, int event);

COTREE_END_DECLS

#endif
