/* cotree_events.h: locates the zero crossings of a model's event functions and applies its events.
 *
 * An event occurs when its event function crosses zero in the event's direction. Each accepted
 * step is sampled at a few points, and more densely if an event function has an extremum near
 * zero, so that two crossings within one step are found.
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
 * No memory is allocated; events are written to the caller's records. */
#ifndef COTREE_EVENTS_H
#define COTREE_EVENTS_H

#include "cotree_history.h"
#include "cotree_jumps.h"

COTREE_BEGIN_DECLS

/* Statuses. A status of COTREE_EVENTS_FAILED or above ends the run; the fields event, failure_time
 * and detail then describe the failure. */
typedef enum cotree_events_status {
    COTREE_EVENTS_NONE = 0,
    COTREE_EVENTS_FOUND = 1,
    COTREE_EVENTS_FAILED = 20,          /* a kernel or an algebraic equation cannot be evaluated */
    COTREE_EVENTS_NOT_FINITE = 21,      /* an event function is not finite */
    COTREE_EVENTS_SET_NOT_FINITE = 22,  /* a new value is not finite */
    COTREE_EVENTS_CONTRADICT = 23,      /* new values violate constraint number detail, or -1 */
    COTREE_EVENTS_UNDERDETERMINED = 24, /* new values leave states undetermined: no sensitivities */
    COTREE_EVENTS_REST_AT_ZERO = 25,    /* a value at rest at zero accelerates through zero */
    COTREE_EVENTS_GRAZING = 26,         /* the function only touches zero: no sensitivities */
    COTREE_EVENTS_ACCUMULATE = 27,      /* events accumulate at the time detail (Zeno) */
    COTREE_EVENTS_CHATTER = 28,         /* COTREE_EVENT_CROWD events within `detail` seconds */
    COTREE_EVENTS_CASCADE = 29,     /* events trigger each other endlessly; has_fired marks them */
    COTREE_EVENTS_SLIDING = 40,     /* cascade of jumps: sliding along a switching surface */
    COTREE_EVENTS_LEAVES_JUMP = 41, /* a value leaves a switching surface on which it rested */
    COTREE_EVENTS_NOT_COMMUTING = 42,    /* order of simultaneous jumps matters: no sensitivities */
    COTREE_EVENTS_NO_MODES = 43,         /* no modes are consistent; has_fired marks their edges */
    COTREE_EVENTS_LOCKED_DIRECTION = 44, /* a one-way clutch turns in its locked direction */
    COTREE_EVENTS_NEGATIVE_GAP = 45,     /* the gap of a rigid stop is negative at the start */
    COTREE_EVENTS_NO_IMPULSES = 46,      /* no impulses are consistent; has_fired marks stops */
    COTREE_EVENTS_COUPLED_IMPACTS = 47,  /* simultaneous impacts interact: no sensitivities */
    COTREE_EVENTS_BELOW_TOLERANCE = 48,  /* the speeds of impacts are below the error tolerance */
    COTREE_EVENTS_ENERGY_GAIN = 49,      /* an impact would increase the energy */
    COTREE_EVENTS_NOT_UNIQUE = 50,       /* friction allows a contact both to close and to open */
    COTREE_EVENTS_INDETERMINATE = 51,    /* losses depend on friction forces that are not unique */
    COTREE_EVENTS_LOSSY_IMPACT = 52,     /* an impact acts through a gear with losses */
    COTREE_EVENTS_LEAVES_ROOT = 53 /* a root of infinite slope drives a value away from zero */
} cotree_events_status;

/* Number of events that are recorded: all except kinks. */
#define COTREE_EVENTS_OF(hybrid) ((hybrid)->n_events - (hybrid)->n_kinks)

/* Largest number of records written in one call. */
#define COTREE_EVENTS_AT_ONCE(n_events) ((n_events) + COTREE_EVENT_ROUNDS)

/* Number of values in a record: time, event index, derivatives of the time with respect to the
 * parameters, and states before and after the event. */
#define COTREE_EVENTS_RECORD(n_states, n_sensitivities) (2 + (n_sensitivities) + 2 * (n_states))

/* Largest number of pivots in the mode selection for n_edges unilateral constraints. */
#define COTREE_FRICTION_ROUNDS(n_edges) (20 + 10 * (n_edges) * (n_edges))

/* Compute the solution at a time within the last step as accurately as the steps themselves: by
 * integration from the start of the step, or from a polynomial. Return 0, or another number on
 * failure. Within one step, t increases from call to call. */
typedef int (*cotree_solution_function)(cotree_real t, cotree_real *w, void *context);

typedef struct cotree_events {
    cotree_real t, margin; /* time of the located events, and its uncertainty */
    cotree_real *w;        /* the solution at t: before the events are applied, then after */
    int n_found; /* number of located events; 0: the integration restarts at t without an event */
    int n_fired; /* number of events applied in the last call */
    int is_mode_changed;  /* 1: the last call changed modes of friction, stops or loads */
    int terminal_event;   /* index of the event that ends the run, or -1 */
    cotree_real *records; /* rows of COTREE_EVENTS_RECORD numbers; NULL: events are not recorded */
    int n_records;
    int event;                        /* index of the event that failed */
    cotree_real failure_time, detail; /* time of the failure; detail of the status */
    int *has_fired;
    long n_evaluations; /* number of evaluations of the rates */
    /* Branches of piecewise functions, which are frozen during a step: the last n_branches prepared
     * values of the run. NULL (the default): kinks are not located. */
    cotree_real *branches;

    /* The rest is private. */
    cotree_jumps jumps;
    cotree_run *run;
    const cotree_event *events;
    int n_events, n; /* number of events; number of entries of w */
    int n_kinks, n_branches;
    int has_steep;             /* 1: the model has steep kinks (roots) */
    cotree_real branch_time;   /* time at which branches were last selected */
    cotree_real history_error; /* interpolation error in the step, in tolerances */
    cotree_real *mean_rate;    /* mean |rate| of each event function in the last step */
    cotree_real rtol, atol, span;
    const cotree_real *atols;
    cotree_solution_function solution;
    void *context;
    cotree_history refined;  /* interpolation from four quarter steps, if the step was recomputed */
    const cotree_history *h; /* interpolation within the step; NULL: solution is called instead */
    cotree_real t_before, t_after, t_end;
    const cotree_real *start, *end;
    int n_given;       /* number of entries of start and end */
    int is_time_fixed; /* 1: the event time is given, not the zero of an event function */
    int is_fine;       /* 1: interpolation is as accurate as the steps */
    int is_coarse;     /* 1: interpolation is too inaccurate to update the scales */
    int leaves_branch; /* 1: the last step ended beyond a frozen branch, within its tolerance */
    int is_refined;    /* 1: the samples come from quarter steps, not from interpolation */
    int failure;       /* status of the last failure; 0: none */

    /* Data for the interval bounds of nonlinear event functions, see cotree_scan.c. */
    int n_ranges, n_quantities;
    cotree_real *ranges;             /* for each function: bounds of its value, then of its rate */
    cotree_real *box;                /* bounds of the quantities' values, then of their rates */
    cotree_real *quantity_samples;   /* values of the quantities at the samples of the step */
    cotree_real *quantity_mean_rate; /* mean rates of the quantities in the last step */
    cotree_real *stack;              /* ends of the intervals that are still to be bisected */
    cotree_real *from_side;          /* sign of the function before its crossing */
    cotree_real *bracket_start;      /* the last time at which the function had that sign */
    int *is_candidate, *is_excluded; /* may cross zero in the step; bounds exclude zero */

    /* Arrays with one entry for each event function g. */
    cotree_real *g;             /* values of the event functions at the start of the step */
    cotree_real *side;          /* sign of g: -1, 1, or 0 if unknown */
    cotree_real *value_scale;   /* largest |g| in the run so far */
    cotree_real *state_error;   /* steep kinks: error of g due to the tolerances of the states */
    cotree_real *recent_scale;  /* largest |g| since the last event */
    cotree_real *samples;       /* SAMPLES rows: values of g in the step; row 0 is also scratch */
    cotree_real *crossing_sign; /* sign of the rate of g at the event */
    cotree_real *rate_before;   /* |rate of g| before the events at this time */
    cotree_real *curvature;     /* second time derivative of g */
    cotree_real *root_time;
    cotree_real *event_times; /* ring buffer of the last COTREE_EVENT_CROWD times of each event */
    int *is_found, *is_near, *n_event_times;
    int *is_continuous; /* for a jump: 1 if the rates on both sides agreed when last compared */

    cotree_real *point, *other, *slope, *sum, *scratch, *narrowed; /* work space */
    cotree_real *both_sides; /* states and rates on both sides of a jump */
    cotree_real *shift;      /* 2 n_events: changes of the event functions across a jump */

    /* Unilateral constraints: dry friction, then loads, then rigid stops. */
    int n_rows, n_frictions, n_stops, n_discs; /* numbers of all rows, and by type */
    int has_contact_friction;                  /* 1: some friction acts at a contact */
    cotree_row *rows;
    int *stays_at_zero;      /* for each event function: 1 if its value stays at zero */
    int *is_stepped_over;    /* for each event function: 1 if crossed by an external integrator */
    int *is_impact_event;    /* for each event: 1 if it is part of the impact */
    cotree_real *zero_level; /* for a force at its limit: |g| below this level counts as zero */
    cotree_real *gap_at_release; /* |gap| at the time at which the stop opened */
    cotree_real *trial;          /* vector w of the current trial, with the trial's modes */
    cotree_real *saved_before;
    cotree_real *tried_codes; /* ring buffer: codes of the mode sets tried in this selection */
    int n_tried;
    int kernel_status;  /* status of the last kernel evaluation */
    int unresolved_gap; /* gap that separates after an impact at a speed below rounding, or -1 */
    int is_impact;      /* 1: modes are selected at impulse level */
    cotree_real impact_speed; /* largest speed before the impact */
    cotree_real largest_rate; /* largest rate of a state in the last trial */
    cotree_real force_noise;  /* rounding error of the forces in the last trial */
} cotree_events;

/* Initialise for a run over a time span, with the tolerances of the integration. atols has n_given
 * entries, one for each entry of the points at the ends of steps; atol is the smallest of them.
 * n_given is run->n, or run->n_full if these points contain algebraic unknowns and their
 * sensitivities. */
void cotree_events_init(cotree_events *e, cotree_run *run, int n_given, cotree_real span,
                        cotree_real rtol, const cotree_real *atols, cotree_real atol,
                        cotree_solution_function solution, void *context, cotree_arena *arena);

/* Apply the events whose functions cross zero at the start of a run. */
int cotree_events_begin(cotree_events *e, cotree_real t, cotree_real *w);

/* Apply the events whose functions jump through zero at a time event. slopes: derivatives of this
 * time with respect to the parameters, or NULL. */
int cotree_events_resume(cotree_events *e, cotree_real t, cotree_real *w,
                         const cotree_real *slopes);

/* Continue from the end of another integration, with unchanged states, modes and inputs. */
int cotree_events_continue(cotree_events *e, cotree_real t, cotree_real *w);

/* Apply the events whose zeros an external integrator has just passed. */
int cotree_events_apply_passed(cotree_events *e, cotree_real t, cotree_real *w);

/* Select the modes of friction, stops and loads at a point, as at the start of a run. */
int cotree_events_select_modes(cotree_events *e, cotree_real t, cotree_real *w);

/* Save and restore the event history as an array of COTREE_EVENTS_SAVED numbers. */
#define COTREE_EVENTS_SAVED(n_events) ((n_events) * (7 + COTREE_EVENT_CROWD))
void cotree_events_save(const cotree_events *e, cotree_real *to);
void cotree_events_restore(cotree_events *e, const cotree_real *from);

/* Find the first events within the last step, from start to end. Return FOUND, NONE or a failure.
 * Later steps may reach t_end. h interpolates within the step if low accuracy suffices; its last
 * point is the end of the step. h may be NULL if the solution function is inexpensive. */
int cotree_events_find(cotree_events *e, cotree_real t_before, const cotree_real *start,
                       cotree_real t_after, const cotree_real *end, cotree_real t_end,
                       const cotree_history *h);

/* Select new branches at the end of the last step; call this if leaves_branch is set. Store points
 * within the step first, because they may be integrated on the old branches. */
int cotree_events_change_branches(cotree_events *e);

/* Apply the events found by cotree_events_find. */
int cotree_events_apply(cotree_events *e);

/* Return the description of a status as the end of a sentence. */
const char *cotree_events_message(int status);

COTREE_END_DECLS

#endif
