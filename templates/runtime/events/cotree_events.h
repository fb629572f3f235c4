/* cotree_events.h: finds the events of a model within steps, and lets them happen.
 * Part of the runtime of cotree, the same for every model.
 *
 * An event looks at a value. It happens where the value passes through zero in its direction, after
 * which the same crossing does not count again. A step is looked at in a few points, and closer
 * where a value turns round near zero, so that two crossings within a step are not lost.
 *
 *     cotree_events_init(&e, &run, ...);
 *     status = cotree_events_begin(&e, t, w);            (at the start; w may change)
 *     ... after each step:
 *     status = cotree_events_find(&e, t_before, start, t, end, t_stop, &h);
 *     if (status == COTREE_EVENTS_FOUND) {
 *         ... outputs before e.t - e.margin are those of the step
 *         status = cotree_events_happen(&e);
 *         ... begin a new step, and a new history, at e.t from e.w, unless e.stopped >= 0
 *     }
 *
 * Nothing is allocated; what happened is written to the caller's records.
 */
#ifndef COTREE_EVENTS_H
#define COTREE_EVENTS_H

#include "cotree_history.h"
#include "cotree_jumps.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Results; those from FAILED on end a run. event, at and detail then say more. */
typedef enum cotree_events_status {
    COTREE_EVENTS_NONE = 0,
    COTREE_EVENTS_FOUND = 1,
    COTREE_EVENTS_FAILED =
        20, /* its equations cannot be evaluated: a kernel or an algebraic equation */
    COTREE_EVENTS_NOT_FINITE = 21,     /* what it looks at is not finite */
    COTREE_EVENTS_SET_NOT_FINITE = 22, /* what it sets is not finite */
    COTREE_EVENTS_CONTRADICT = 23,     /* what it sets contradicts the constraints */
    COTREE_EVENTS_CHOOSE = 24, /* what it sets leaves a choice, which has no sensitivities */
    COTREE_EVENTS_REST =
        25, /* it leaves no speed away from zero, and the motion goes on through it */
    COTREE_EVENTS_GRAZE = 26,      /* it only just touches zero, where nothing has sensitivities */
    COTREE_EVENTS_ACCUMULATE = 27, /* it happens ever faster, and accumulates: at the time detail */
    COTREE_EVENTS_CHATTER =
        28, /* it happens too often: it chatters: CROWD times within detail seconds */
    COTREE_EVENTS_ENDLESS =
        29, /* it and others make each other happen without end: has_fired tells which */
    COTREE_EVENTS_SLIDE = 40,  /* what jumps is driven back to the jump from either side: the same,
                                  of jumps inside expressions */
    COTREE_EVENTS_LEAVE = 41,  /* what rested at the jump leaves it, to either side */
    COTREE_EVENTS_PART = 42,   /* jumps at once have no derivative, since either may come first */
    COTREE_EVENTS_MODES = 43,  /* no modes of dry friction and rigid stops agree with each other:
                                  has_fired tells whose */
    COTREE_EVENTS_SHARED = 51, /* how friction that sticks shares forces is open, though losses
                                  depend on it: has_fired tells whose */
    COTREE_EVENTS_BACKWARD = 44, /* a one-way clutch turns the way that it locks */
    COTREE_EVENTS_BEYOND = 45,   /* a rigid stop begins beyond its limit */
    COTREE_EVENTS_IMPACT =
        46, /* no impulses of rigid stops agree with each other: has_fired tells whose */
    COTREE_EVENTS_TOGETHER = 47, /* gaps that close at once act on each other, so that either order
                                    has other sensitivities */
    COTREE_EVENTS_GAINS = 49,    /* the impact would leave more energy than there was */
    COTREE_EVENTS_SEVERAL = 50,  /* a contact may hold or let go: friction allows both */
    COTREE_EVENTS_LOSSY = 52, /* an impact passes a gear with losses, which has no law of impact */
    COTREE_EVENTS_FAINT = 48  /* its impacts are too small for the tolerance */
} cotree_events_status;

/* How many events a model has besides corners, of which nothing is recorded. */
#define COTREE_EVENTS_OF(hybrid) ((hybrid)->n_events - (hybrid)->n_corners)

/* How many records one call may write. */
#define COTREE_EVENTS_AT_ONCE(n_events) ((n_events) + COTREE_EVENT_ROUNDS)

/* Doubles of a record: time, event, derivatives of the time, states before and after. */
#define COTREE_EVENTS_RECORD(n_states, n_sensitivities) (2 + (n_sensitivities) + 2 * (n_states))

/* How often dry friction of so many edges at once changes one mode until none contradicts. */
#define COTREE_FRICTION_ROUNDS(n_edges) (20 + 10 * (n_edges) * (n_edges))

/* Writes the solution at a time within the last step, as accurate as steps are: by integration from
 * where the step began, or from a polynomial that is as accurate. Returns 0, or another number if
 * it cannot. Where it integrates, calls for one step come with increasing t. */
typedef int (*cotree_visit_function)(cotree_real t, cotree_real *w, void *context);

typedef struct cotree_events {
    cotree_real t, margin; /* when what was found happens, and how far that is uncertain */
    cotree_real *w;        /* the solution there: just before, or after it happened */
    int n_found;           /* zero where the step goes on anew from there without an event */
    int n_fired;           /* how many events happened in the last call */
    int is_shifted;        /* whether it changed modes of dry friction */
    int stopped;           /* the event that ends the run, or -1 */
    cotree_real *records;  /* NULL: of no interest */
    int n_records;
    int event; /* where it failed */
    cotree_real at, detail;
    int *has_fired;
    long n_evaluations; /* of rates */
    /* The pieces that steps hold, n_pieces of the run's prepared values, which are to be no
     * others'; NULL unless you say so: corners are not looked for. */
    cotree_real *pieces;
    /* The rest belongs to the events. */
    cotree_jumps jumps;
    cotree_run *run;
    const cotree_event *rows;
    int n_events, n;
    int n_corners, n_pieces;
    cotree_real faced; /* when pieces were chosen last */
    cotree_real error; /* of what is read within a step, in tolerances */
    cotree_real *pace; /* how fast values changed in the step before, each */
    cotree_real rtol, atol, span;
    const cotree_real *atols;
    cotree_visit_function visit;
    void *context;
    cotree_history local;
    const cotree_history *h; /* what a step is read from; NULL: visited */
    cotree_real t_before, t_after, t_end;
    const cotree_real *start, *end;
    int n_given;    /* of the points that steps end in */
    int is_timed;   /* whether something besides events decides the time */
    int is_close;   /* whether that is as accurate as steps are */
    int is_rough;   /* whether it may be so far off that it tells nothing about sizes */
    int is_visited; /* whether the step itself was taken to the points that are looked at */
    int trouble;
    int n_ranges, n_quantities; /* of what is not linear */
    cotree_real *ranges, *box, *sampled, *quantity_pace, *marks, *from, *since;
    int *is_open, *is_clear; /* whether ranges tell of a value, and that it does not reach zero */
    cotree_real *g, *side, *largest, *flight, *looked, *way, *speed, *bend, *at_root, *happened;
    cotree_real *point, *other, *slope, *sum, *scratch, *narrowed;
    int *is_found, *is_near, *n_happened;
    int *is_kink;          /* whether rates were the same on both sides of a jump, the last time */
    cotree_real *compared; /* states and rates on both sides of a jump */
    cotree_real *shift;    /* 2 n_events: changes of values across a jump, here and aside */
    int n_frictions;       /* edges with dry friction */
    int n_modes;           /* their modes, and the signs of their loads */
    int *friction, *is_idle, *resting;
    int *is_passed; /* whether a speed was stepped over zero from outside */
    cotree_real *modes, *scale, *slack, *tried, *tries, *was;
    int complaint;      /* of the kernels, the last time */
    cotree_real *level; /* by what forces may move at their limits */
    int *is_back;
    cotree_real *left_at; /* when edges began to slide */
    cotree_real fastest,
        noise;   /* of the last trial: the largest rate of a state, rounding of forces */
    int n_tries; /* sets of modes that were tried for one choice */
    int n_stops; /* rigid stops, whose modes come last: each side that is closed, its opening speed,
                  * the largest speed so far, and that which an impact has to leave */
    int faint;   /* the gap that an impact leaves by less than rounding; -1: none */
    cotree_real *held; /* how far from zero gaps were as they were let go */
    cotree_real *closed, *gaps, *speeds, *later, *swift, *brisk, *wanted;
    int n_pressed; /* edges with friction that stops press together, among those with friction */
    int *pressed, *presser;      /* which, and by which of all */
    cotree_real *slips, *way_of; /* how fast they slip, and which way */
    cotree_real *chosen;         /* modes, while others are tried */
    int is_striking; /* whether the modes of an impact are chosen, in place of those of a motion */
    cotree_real quickest,
        *told; /* the largest speed before it, and what its kernels are told of modes */
    int *is_noted, *has_held, *is_struck, *is_slow, *rebounds, *of_impact, *impulses, *pulls;
} cotree_events;

/* Watches a run over a span, integrated with these tolerances: atols belongs to the points that
 * steps end in, atol is the least of them. These have n_given entries: run->n, or run->n_full where
 * algebraic unknowns and their sensitivities are among them. */
void cotree_events_init(cotree_events *e, cotree_run *run, int n_given, cotree_real span,
                        cotree_real rtol, const cotree_real *atols, cotree_real atol,
                        cotree_visit_function visit, void *context, cotree_room *room);

/* Lets happen what passes through zero at the start of a run. */
int cotree_events_begin(cotree_events *e, cotree_real t, cotree_real *w);

/* Lets happen what jumps through zero at a breakpoint, whose time has slopes by the parameters;
 * NULL: none. */
int cotree_events_resume(cotree_events *e, cotree_real t, cotree_real *w,
                         const cotree_real *slopes);

/* Goes on where another integration ended and nothing changed. */
int cotree_events_go_on(cotree_events *e, cotree_real t, cotree_real *w);

/* Lets happen what an integration from outside has stepped over, a little beyond where it is at
 * zero. */
int cotree_events_arrive(cotree_events *e, cotree_real t, cotree_real *w);

/* Chooses the modes of dry friction at a point, as a run that starts there does. */
int cotree_events_choose(cotree_events *e, cotree_real t, cotree_real *w);

/* What events have to know of what was before, COTREE_EVENTS_KEPT doubles. */
#define COTREE_EVENTS_KEPT(n_events) ((n_events) * (7 + COTREE_EVENT_CROWD))
void cotree_events_keep(const cotree_events *e, cotree_real *to);
void cotree_events_recall(cotree_events *e, const cotree_real *from);

/* Finds what happens first within the last step, which went from one point to another: FOUND, or
 * NONE. Steps may go on to t_end. h: what values within the step are read from as long as they need
 * not be accurate, with the step's end as its last point; NULL where visits cost next to nothing.
 */
int cotree_events_find(cotree_events *e, cotree_real t_before, const cotree_real *start,
                       cotree_real t_after, const cotree_real *end, cotree_real t_end,
                       const cotree_history *h);

/* Lets it happen. */
int cotree_events_happen(cotree_events *e);

/* Says what a status means, as the end of a sentence. */
const char *cotree_events_message(int status);

#ifdef __cplusplus
}
#endif

#endif
