/* cotree_events.h: locates the zero crossings of a model's event functions and applies its events.
 *
 * An event takes place where its event function crosses zero in the event's direction. Each
 * accepted step is sampled at a few points, and more densely where an event function has an
 * extremum near zero, so that two crossings within one step are not missed.
 *
 *     cotree_events_init(&e, &run, ...);
 *     status = cotree_events_begin(&e, t, w);            (at the start; may change w)
 *     ... after each step:
 *     status = cotree_events_find(&e, t_before, start, t, end, t_stop, &h);
 *     if (status == COTREE_EVENTS_FOUND) {
 *         ... output the step's solution before e.t - e.margin
 *         status = cotree_events_apply(&e);
 *         ... restart at e.t from e.w with a new history, unless e.terminal_event >= 0
 *     }
 *
 * Nothing is allocated; events are written to the caller's records. */
#ifndef COTREE_EVENTS_H
#define COTREE_EVENTS_H

#include "cotree_history.h"
#include "cotree_jumps.h"

COTREE_BEGIN_DECLS

/* Results. Those from FAILED on end a run, with event, failure_time and detail set. */
typedef enum cotree_events_status {
    COTREE_EVENTS_NONE = 0,
    COTREE_EVENTS_FOUND = 1,
    COTREE_EVENTS_FAILED = 20,         /* a kernel or an algebraic equation cannot be evaluated */
    COTREE_EVENTS_NOT_FINITE = 21,     /* an event function is not finite */
    COTREE_EVENTS_SET_NOT_FINITE = 22, /* a new value is not finite */
    COTREE_EVENTS_CONTRADICT = 23, /* new values contradict the constraint detail; -1: unknown */
    COTREE_EVENTS_UNDERDETERMINED = 24, /* new values leave states without sensitivities */
    COTREE_EVENTS_REST_AT_ZERO = 25,    /* zero rate, but nonzero acceleration through zero */
    COTREE_EVENTS_GRAZING = 26,         /* the function only touches zero: no sensitivities */
    COTREE_EVENTS_ACCUMULATE = 27,      /* events accumulate at the time detail */
    COTREE_EVENTS_CHATTER = 28,         /* COTREE_EVENT_CROWD events in detail seconds */
    COTREE_EVENTS_CASCADE = 29,         /* events trigger each other without end; see has_fired */
    COTREE_EVENTS_SLIDING = 40,         /* the same with jumps only: the motion slides along them */
    COTREE_EVENTS_LEAVES_JUMP = 41,     /* a value leaves a jump at which it rested */
    COTREE_EVENTS_NOT_COMMUTING = 42,   /* simultaneous jumps: no sensitivities */
    COTREE_EVENTS_NO_MODES = 43,        /* no consistent modes of friction and stops: has_fired */
    COTREE_EVENTS_LOCKED_DIRECTION = 44, /* a one-way clutch turns in its locked direction */
    COTREE_EVENTS_NEGATIVE_GAP = 45,     /* a rigid stop begins beyond its limit */
    COTREE_EVENTS_NO_IMPULSES = 46,      /* no consistent impulses of stops: has_fired */
    COTREE_EVENTS_COUPLED_IMPACTS = 47,  /* simultaneous gaps interact: no sensitivities */
    COTREE_EVENTS_BELOW_TOLERANCE = 48,  /* impacts are too small for the tolerance */
    COTREE_EVENTS_ENERGY_GAIN = 49,      /* an impact would gain energy */
    COTREE_EVENTS_NOT_UNIQUE = 50,       /* friction allows a contact to close and to open */
    COTREE_EVENTS_INDETERMINATE = 51,    /* losses depend on indeterminate forces of friction */
    COTREE_EVENTS_LOSSY_IMPACT = 52,     /* an impact passes a gear with losses */
    COTREE_EVENTS_LEAVES_ROOT = 53 /* a root of infinite slope drives a value away from zero */
} cotree_events_status;

/* The number of events without kinks, which are not recorded. */
#define COTREE_EVENTS_OF(hybrid) ((hybrid)->n_events - (hybrid)->n_kinks)

/* The largest number of records that one call writes. */
#define COTREE_EVENTS_AT_ONCE(n_events) ((n_events) + COTREE_EVENT_ROUNDS)

/* Numbers in a record: time, event, derivatives of the time, states before and after. */
#define COTREE_EVENTS_RECORD(n_states, n_sensitivities) (2 + (n_sensitivities) + 2 * (n_states))

/* The largest number of pivots for n_edges unilateral constraints. */
#define COTREE_FRICTION_ROUNDS(n_edges) (20 + 10 * (n_edges) * (n_edges))

/* Compute the solution at a time within the last step to the accuracy of the steps: by integration
 * from the start of the step, or from a polynomial of that accuracy. Return 0, or another number on
 * failure. Within one step the calls have increasing t. */
typedef int (*cotree_solution_function)(cotree_real t, cotree_real *w, void *context);

typedef struct cotree_events {
    cotree_real t, margin; /* time of the events that were found, and its uncertainty */
    cotree_real *w;        /* the solution at t: before the events, then after them */
    int n_found;           /* 0: the integration restarts at t without an event */
    int n_fired;           /* events applied in the last call */
    int is_mode_changed;   /* 1: the last call changed modes of friction, stops or loads */
    int terminal_event;    /* the event that ends the run, or -1 */
    cotree_real *records;  /* records of events; NULL: none are written */
    int n_records;
    int event;                        /* that failed */
    cotree_real failure_time, detail; /* detail: see cotree_events_status */
    int *has_fired;
    long n_evaluations; /* of rates */
    /* The branches of piecewise functions that a step holds: the last n_branches of the run's
     * prepared values, in memory of their own. NULL (the default): kinks are not located. */
    cotree_real *branches;

    /* The rest is private. */
    cotree_jumps jumps;
    cotree_run *run;
    const cotree_event *rows;
    int n_events, n; /* n: entries of w */
    int n_kinks, n_branches;
    int has_steep;             /* 1: there are steep kinks */
    cotree_real branch_time;   /* time of the last selection of branches */
    cotree_real history_error; /* interpolation error within the step, in tolerances */
    cotree_real *mean_rate;    /* |change| of each event function per time in the last step */
    cotree_real rtol, atol, span;
    const cotree_real *atols;
    cotree_solution_function solution;
    void *context;
    cotree_history refined;  /* history of the step, recomputed in quarters */
    const cotree_history *h; /* interpolates within the step; NULL: solution is called */
    cotree_real t_before, t_after, t_end;
    const cotree_real *start, *end;
    int n_given;       /* number of entries in the points at the ends of steps */
    int is_time_fixed; /* 1: the time does not follow from an event function */
    int is_fine;       /* 1: interpolation is as accurate as the steps */
    int is_coarse;     /* 1: interpolation is too inaccurate to measure scales */
    int is_refined;    /* 1: the samples of this step were integrated, not interpolated */
    int failure;       /* the status of the last failure, 0 without any */

    /* Nonlinear event functions: interval bounds (cotree_scan.c). */
    int n_ranges, n_quantities;
    cotree_real *ranges;             /* N_BOUNDS each: bounds of the function, then of its rate */
    cotree_real *box;                /* bounds of the quantities, then of their rates */
    cotree_real *quantity_samples;   /* at the samples of a step */
    cotree_real *quantity_mean_rate; /* change per time in the last step */
    cotree_real *stack;              /* ends of intervals that remain to be bisected */
    cotree_real *from_side;          /* the sign of the function before its crossing */
    cotree_real *bracket_start;      /* the last time at which it had that sign */
    int *is_candidate, *is_excluded; /* may cross in this step; bounds exclude a zero */

    /* One entry for each event. */
    cotree_real *g;             /* event functions at the start of the step */
    cotree_real *side;          /* the side of zero: -1, 1, or 0 if not known */
    cotree_real *value_scale;   /* largest |g| of the run */
    cotree_real *state_error;   /* of a steep kink: its error by those of the states */
    cotree_real *recent_scale;  /* largest |g| since the last event */
    cotree_real *samples;       /* SAMPLES rows: event functions in a step; row 0 is scratch, too */
    cotree_real *crossing_sign; /* the sign of the rate at the event */
    cotree_real *rate_before;   /* |rate| before the events at this time */
    cotree_real *curvature;     /* second time derivative */
    cotree_real *root_time;
    cotree_real *event_times; /* the last COTREE_EVENT_CROWD ones, a ring */
    int *is_found, *is_near, *n_event_times;
    int *is_continuous; /* of a jump: rates agreed on both sides when last compared */

    cotree_real *point, *other, *slope, *sum, *scratch, *narrowed; /* work */
    cotree_real *both_sides; /* states and rates on both sides of a jump */
    cotree_real *shift;      /* 2 n_events: changes of event functions across a jump */

    /* Modes of unilateral constraints: dry friction, then loads, then rigid stops. */
    int n_frictions;
    int n_modes;          /* of all three */
    int *places;          /* N_PLACES each: the state of the mode, the events */
    int *is_active;       /* 1: the mode follows from the complementarity conditions */
    int *stays_at_zero;   /* of an event function */
    int *is_stepped_over; /* of an event function: another integrator crossed its zero */
    cotree_real *modes;   /* as tried */
    cotree_real *acceleration_scale;
    cotree_real *slack;       /* distances of the forces to both limits */
    cotree_real *trial;       /* w with the modes as tried */
    cotree_real *tried_codes; /* of the sets of modes tried for one choice, a ring */
    cotree_real *saved_before;
    int kernel_status;        /* of the last evaluation */
    cotree_real *zero_level;  /* of a force at its limit: |g| below this counts as zero */
    int *is_resticking;       /* 1: friction sticks at the time at which its slip began */
    cotree_real *slide_start; /* the time at which its slip began */
    cotree_real largest_rate; /* of a state in the last trial */
    cotree_real force_noise;  /* rounding of the forces in the last trial */
    int n_tried;

    /* Rigid stops, and dry friction at contacts, whose normal force is that of a stop. */
    int n_stops;
    int unresolved_gap;          /* the gap that an impact leaves at a speed below rounding; -1 */
    cotree_real *gap_at_release; /* |g| of an open gap at the time at which its stop opened */
    cotree_real *closed_side;    /* of each stop: 1 or -1, 0 while open */
    cotree_real *gaps, *opening_speed, *later_acceleration;
    cotree_real *largest_opening_speed, *largest_acceleration; /* so far */
    cotree_real *speed_terms;    /* sizes of the terms of gap rates at the start */
    cotree_real *required_speed; /* after the impact, by restitution */
    int n_contact_friction;
    int *contact_friction;   /* their places among all friction */
    int *normal_stop;        /* the stop of each friction; -1: none */
    cotree_real *slip_speed; /* before the impact: two components each */
    cotree_real *slip_sign;
    int n_discs; /* friction on planes in space */
#if COTREE_HAS_DISCS
    int *disc;               /* of each friction: its number; -1: none */
    int *direction_states;   /* 2 n_discs: the states of the directions of sliding */
    cotree_real *directions; /* 2 n_discs: as tried */
    cotree_real *saved_directions;
    cotree_real *last_turns; /* 5 n_discs: direction, slip and gain of the last iteration */
#endif
    cotree_real *saved_modes;
    int is_impact;             /* 1: modes are chosen at impulse level */
    cotree_real impact_speed;  /* the largest speed before the impact */
    cotree_real *kernel_modes; /* passed to the kernels in the impact */
    int *is_impact_event;
    int *was_holding;       /* 1: the stop was closed before */
    int *impact_role;       /* see find_impact_roles */
    int *ends_at_rest;      /* 1: the stop's rebound is below its rest threshold */
    int *restitution_event; /* whose targets contain the change of speed */
    int *impact_events, *impulse_states, *force_events; /* as in cotree_impulse */
} cotree_events;

/* Initialise for a run over a span, with the tolerances of the integration. atols, of n_given
 * entries, belongs to the points at the ends of steps, and atol is the least of them. n_given is
 * run->n, or run->n_full if these points contain algebraic unknowns and their sensitivities. */
void cotree_events_init(cotree_events *e, cotree_run *run, int n_given, cotree_real span,
                        cotree_real rtol, const cotree_real *atols, cotree_real atol,
                        cotree_solution_function solution, void *context, cotree_arena *arena);

/* Apply the events whose functions cross zero at the start of a run. */
int cotree_events_begin(cotree_events *e, cotree_real t, cotree_real *w);

/* Apply the events whose functions jumped through zero at a time event. slopes: the derivatives of
 * its time by the parameters, or NULL. */
int cotree_events_resume(cotree_events *e, cotree_real t, cotree_real *w,
                         const cotree_real *slopes);

/* Continue at the end of another integration, where nothing changed. */
int cotree_events_continue(cotree_events *e, cotree_real t, cotree_real *w);

/* Apply the events that an external integrator stepped over, just after their zeros. */
int cotree_events_apply_passed(cotree_events *e, cotree_real t, cotree_real *w);

/* Select the modes of friction, stops and loads at a point, as at the start of a run. */
int cotree_events_select_modes(cotree_events *e, cotree_real t, cotree_real *w);

/* Save and restore the history of the events, COTREE_EVENTS_SAVED numbers. */
#define COTREE_EVENTS_SAVED(n_events) ((n_events) * (7 + COTREE_EVENT_CROWD))
void cotree_events_save(const cotree_events *e, cotree_real *to);
void cotree_events_restore(cotree_events *e, const cotree_real *from);

/* Find the first events within the last step, from start to end. Return FOUND, NONE or a failure.
 * Steps may go as far as t_end. h: interpolates within the step if low accuracy suffices; its last
 * point is the end of the step. NULL: the solution function costs next to nothing. */
int cotree_events_find(cotree_events *e, cotree_real t_before, const cotree_real *start,
                       cotree_real t_after, const cotree_real *end, cotree_real t_end,
                       const cotree_history *h);

/* Apply the events that were found. */
int cotree_events_apply(cotree_events *e);

/* Return the meaning of a status, as the end of a sentence. */
const char *cotree_events_message(int status);

COTREE_END_DECLS

#endif
