/* cotree_jumps.h: what the events of a model look at, and what they do to states and sensitivities.
 * Part of the runtime of cotree, the same for every model.
 *
 * With f the rates, g what an event looks at, R what it makes of the states, and - and + before and
 * after it, its time depends on the parameters as t_p = -(g_x S- + g_p) / (g_x f- + g_t), and
 * S+ = R_x S- + R_p + (R_x f- + R_t - f+) t_p. Where constraints are held, what was set stays, and
 * the rest follows by the least move.
 *
 * w is what a run integrates. Nothing is allocated.
 */
#ifndef COTREE_JUMPS_H
#define COTREE_JUMPS_H

#include "cotree_run.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Results besides those of kernels. */
#define COTREE_JUMPS_CONTRADICT 100 /* what is set contradicts the constraints */
#define COTREE_JUMPS_CHOOSE 101     /* what is set leaves a choice, which has no sensitivities */

/* Events of dry friction have these in the place of is_jump: their value is the relative speed with
 * the sign of the mode, what is left to the limits of the force, positive while engaged, or a load
 * with the sign that its mode stands for. */
#define COTREE_FRICTION_SLIP 2
#define COTREE_FRICTION_FORWARD 3
#define COTREE_FRICTION_BACKWARD 4
#define COTREE_FRICTION_ENGAGED 5
#define COTREE_FRICTION_LOAD 6

/* Events of rigid stops: what is left to their limits, in contact their force with the sign of the
 * side, and in an impact the speed after it less that at which they rest. Their second target is
 * the impulse, which all but LIFTS set to what an impact changes the speed by. */
#define COTREE_STOP_UPPER 7
#define COTREE_STOP_LOWER 8
#define COTREE_STOP_FORCE 9
#define COTREE_STOP_REBOUND 10

/* Corners of the rates, at which nothing jumps: only the piece changes that steps hold. */
#define COTREE_KINK 11

typedef struct cotree_jumps {
    cotree_run *run;
    const cotree_hybrid *hybrid;
    cotree_real
        *values; /* what each event looks at; the number of each piece; quantities of ranges */
    cotree_real *rates;            /* time derivatives of that, then of what each sets */
    cotree_real *before, *after;   /* all states and sensitivities, of the last event */
    cotree_real *time_sensitivity; /* of its time */
    /* The rest belongs to the jumps. */
    cotree_real *moving, *slopes, *set;
    cotree_real *narrow, *packed, *response, *pulls, *pull_slopes; /* of impacts at rigid stops */
    cotree_real *residual, *gradient, *basis, *triangle, *weights, *step, *best, *trial, *given;
    int *is_kept, *is_free, *order;
} cotree_jumps;

/* An impact at several edges. */
typedef struct cotree_strike {
    int n_modes, stride;
    const int *places;        /* of the modes, each stride-th */
    const cotree_real *modes; /* in the impact */
    int n_edges, n_stops;     /* stops, then what friction they press together */
    const int *impulses;      /* states */
    const int *rebounds;      /* events that say what speeds are to change by; -1: not struck */
    int n_pulls;
    const int *pulls; /* events that look at forces of stops, then at what is left of friction to
                       * both limits */
} cotree_strike;

/* The model must have events. */
void cotree_jumps_init(cotree_jumps *j, cotree_run *run, cotree_room *room);

/* Writes values. */
int cotree_jumps_values(cotree_jumps *j, cotree_real t, const cotree_real *w);

/* Writes the ranges of what events look at, from those of quantities; what is constant is that of
 * where values were written last. */
int cotree_jumps_ranges(cotree_jumps *j, cotree_real t, const cotree_real *box,
                        cotree_real *ranges);

/* Writes rates. */
int cotree_jumps_rates(cotree_jumps *j, cotree_real t, const cotree_real *w);

/* Brings states onto the constraints, which is all that a model needs for it: those marked in
 * is_kept stay, and the others move as little as they can. Run->u holds the inputs. */
int cotree_jumps_settle(cotree_jumps *j, cotree_real t, cotree_real *x);

/* Tells whether that was the least of several moves. */
int cotree_jumps_is_chosen(cotree_jumps *j, cotree_real t, const cotree_real *from,
                           const cotree_real *to);

/* Lets an event happen: changes w, and writes before, after and, unless something else decides its
 * time, time_sensitivity. */
int cotree_jumps_apply(cotree_jumps *j, int event, cotree_real t, cotree_real *w,
                       int is_time_fixed);

/* Sets modes of dry friction, at every stride-th place, as the last event happens. */
int cotree_jumps_shift(cotree_jumps *j, cotree_real t, cotree_real *w, int n_modes,
                       const int *places, int stride, const cotree_real *modes);

/* Lets an impact happen as the last event does: changes w but for the modes. */
int cotree_jumps_strike(cotree_jumps *j, const cotree_strike *s, cotree_real t, cotree_real *w);

/* The same of states alone, which it writes to after; pulls are the impulses. */
int cotree_jumps_try_strike(cotree_jumps *j, const cotree_strike *s, cotree_real t,
                            const cotree_real *w, cotree_real *after);

/* Writes what all events would set at w. */
int cotree_jumps_news(cotree_jumps *j, cotree_real t, const cotree_real *w);

/* Where that was written last: what an event would set its first target to, and whether that is
 * another value than it has. */
cotree_real cotree_jumps_new_value(const cotree_jumps *j, int event);
int cotree_jumps_is_due(const cotree_jumps *j, int event);

/* Writes whether a parameter moves what an event looks at. w is that of the motion, with
 * sensitivities; returns a kernel's complaint. */
int cotree_jumps_is_moved(cotree_jumps *j, int event, cotree_real t, cotree_real *w, int *is_moved);

/* Writes the rates of the states at w. */
int cotree_jumps_differentiate(cotree_jumps *j, cotree_real t, const cotree_real *w,
                               cotree_real *rates);

/* Writes the rates of the states at w, and those under the other mode that the events of a jump
 * set; x takes the states for that. */
int cotree_jumps_sides(cotree_jumps *j, int event, cotree_real t, const cotree_real *w,
                       cotree_real *x, cotree_real *now, cotree_real *other);

/* The same of events of stops: what rebound gives, with its rate by rates. */
cotree_real cotree_jumps_rebound(const cotree_jumps *j, int event);
cotree_real cotree_jumps_rebound_rate(const cotree_jumps *j, int event);

#ifdef __cplusplus
}
#endif

#endif
