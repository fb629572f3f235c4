/* cotree_fmu_internal.h: declarations shared by the sources of cotree_fmu.h.
 *
 * Functions return 0, or 1 after an error was logged, unless noted otherwise. */
#ifndef COTREE_FMU_INTERNAL_H
#define COTREE_FMU_INTERNAL_H

#include "cotree_fmu.h"
#include "cotree_run.h"
#if COTREE_HAS_START
#include "cotree_start.h"
#endif
#if COTREE_HAS_EVENTS
#include "cotree_events.h"
#endif
#if COTREE_HAS_BREAKPOINTS
#include "cotree_breakpoints.h"
#else
#define cotree_next_breakpoint(breakpoints, t, end) (end)
#define cotree_is_breakpoint(breakpoints, t) 0
#define cotree_largest_breakpoint(breakpoints, end) fabs(end)
#endif
#if COTREE_HAS_STEPS
#include "cotree_integrator.h"
#include "cotree_job.h"
#endif
#if COTREE_HAS_ALGEBRAIC
#include "cotree_lu.h"
#endif

#include <string.h>

#define N_STATES (m->model->n_states)
#define N_RATES (m->model->n_states - m->model->n_algebraic)
#define N_ALGEBRAIC (m->model->n_algebraic)
#if COTREE_HAS_SENSITIVITIES
#define N_SENSITIVITIES (m->tables->has_sensitivities ? m->model->n_sensitivities : 0)
#else
#define N_SENSITIVITIES 0
#endif

#if COTREE_HAS_EVENTS
#define N_EVENTS (m->model->hybrid->n_events)
#else
#define N_EVENTS 0
#endif

/* Scalars of the saved state of an instance, stored before its arrays. */
enum fmu_number {
    FMU_MODE,
    FMU_NOW,
    FMU_BEGIN, /* start time */
    FMU_END,   /* stop time, or infinity */
    FMU_TOLERANCE,
    FMU_LOW, /* ends of the interval in which the rates have no kink */
    FMU_HIGH,
    FMU_NEXT,       /* next time event, or infinity */
    FMU_IS_STARTED, /* 1: the states are the start states for the current parameters */
    FMU_IS_CHOSEN,  /* 1: the projection at the start is ambiguous */
    FMU_IS_BEGUN,   /* 1: events were processed at least once */
    FMU_IS_CHANGED, /* 1: inputs or parameters changed since the last step */
    FMU_IS_SOLVED,  /* 1: algebraic unknowns are solved for `old` at FMU_SOLVED_AT */
    FMU_SOLVED_AT,
    FMU_IS_SET_UP, /* 1: the start and stop time and the tolerance are set */
    FMU_HAS_ENDED, /* 1: an event ended the simulation */
    FMU_N_NUMBERS
};

/* Bits that mark which values are valid at the current state. */
#define FMU_POINT 1
#define FMU_HAS_RATES 2
#define FMU_HAS_OUTPUTS 4
#define FMU_HAS_INDICATORS 8
#define FMU_HAS_PARTIALS 16
#define FMU_HAS_SLOPES 32

struct fmu {
    const fmu_tables *tables;
    const cotree_model *model;
    fmu_importer importer;
    int is_exchanged; /* interface type: 1 Model Exchange, 0 Co-Simulation */
    int returns_early;
    int mode;             /* copy of numbers[FMU_MODE] */
    const char *function; /* name of the function called, for messages */
    /* may_discard: 1 if the current call may discard a value that cannot be computed, so that the
     * importer tries a smaller step. is_discarded: 1 if it did. */
    int may_discard, is_discarded;
    int offsets[FMU_N_BLOCKS + 1]; /* first value reference of each block */
    /* Saved states that are not yet freed. */
    struct fmu_state **kept;
    size_t n_kept, n_places;
    /* The saved state: numbers, then arrays, contiguous in memory. */
    size_t n_saved;
    double *saved;
    double *numbers;
    double *z; /* values of the states, then of the sensitivities */
    double *p;
    double *outside;    /* values of all inputs */
    double *own_values; /* initial values set by the importer */
    double *is_own;
#if COTREE_HAS_ALGEBRAIC
    double *old; /* states for which algebraic unknowns were last solved */
#endif
#if COTREE_HAS_EVENTS
    double *event_history;
#endif
    /* Values that are computed from the state; bits of `valid` mark the valid ones. */
    int valid;
    int is_prepared;
    double *k, *u, *dx, *y, *g, *dy, *partials, *initial;
    double *seed, *rows, *work;
    int *known;
    cotree_run run;
#if COTREE_HAS_ALGEBRAIC
    double *solved, *dense;
    int *pivots;
#endif
#if COTREE_HAS_START
    double *moved, *residual;
    int *set; /* 1: the initial value of the state is set */
    double *set_values;
    cotree_start start;
#endif
#if COTREE_HAS_EVENTS
    cotree_events events;
    double *records;
#endif
#if COTREE_HAS_BREAKPOINTS
    double *limits; /* upper bounds of the step size, then the rows of time events */
    cotree_breakpoints time_events;
#endif
#if COTREE_HAS_EXCHANGE
    double *before; /* copy of the states before an update */
#endif
#if COTREE_HAS_STEPS
    double *spare; /* copy of the state before a step */
    double *atols;
#if COTREE_HAS_BREAKPOINTS
    double *breakpoints, *turn_tolerances;
    size_t n_breakpoints; /* allocated length of the array breakpoints */
#else
    double breakpoints[2];
#endif
    void *job_memory;
    size_t n_job_memory;
#endif
    void *memory;
    char name[];
};

/* Modes. fmu_evaluate allows the current call to discard values in Model Exchange, where the
 * importer chooses the step size. */
COTREE_PRIVATE void fmu_evaluate(fmu *m);
COTREE_PRIVATE const char *fmu_mode_name(const fmu *m);
COTREE_PRIVATE void fmu_enter(fmu *m, int mode);

/* Messages. fmu_refuse logs an error. fmu_discard logs that a value is discarded, if the current
 * call may do so. Both return 1. fmu_check_pointer rejects a null pointer. */
COTREE_PRIVATE int fmu_refuse(const fmu *m, const char *format, ...);
COTREE_PRIVATE int fmu_discard(fmu *m, const char *format, ...);
COTREE_PRIVATE int fmu_check_pointer(const fmu *m, const void *pointer);

/* State. */
COTREE_PRIVATE int fmu_restore(fmu *m, const double *from);

/* Variables. fmu_find returns the block of a variable, or -1. */
COTREE_PRIVATE int fmu_find(const fmu *m, unsigned reference, int *index);
COTREE_PRIVATE int fmu_size_of(const fmu *m, enum fmu_block block);
COTREE_PRIVATE int fmu_get_value(fmu *m, int block, int index, double *value);

/* Values. */
COTREE_PRIVATE int fmu_prepare(fmu *m);
COTREE_PRIVATE void fmu_set_up_run(fmu *m);
COTREE_PRIVATE int fmu_refresh(fmu *m, int what);
COTREE_PRIVATE void fmu_invalidate(fmu *m);
/* Input function that writes the inputs set by the importer. */
COTREE_PRIVATE int fmu_write_inputs(double t, double *u, void *context);

/* Initialization. fmu_move_start computes the entries of a direction for other states, given those
 * for prescribed states, inputs and parameters. */
COTREE_PRIVATE int fmu_start(fmu *m);
COTREE_PRIVATE int fmu_move_start(fmu *m, const int *is_known, double *seed);

COTREE_PRIVATE void fmu_log(const fmu *m, int status, const char *format, ...);

/* Events. fmu_events returns the events with the current settings and an empty history.
 * fmu_set_projection sets whether constraints are satisfied by projection, as they are while events
 * are processed. */
COTREE_PRIVATE cotree_events *fmu_events(fmu *m);
COTREE_PRIVATE void fmu_set_projection(fmu *m, int is_held);
COTREE_PRIVATE double fmu_span(const fmu *m); /* from start to stop, or the default span */
COTREE_PRIVATE int fmu_enter_steps(fmu *m);   /* process the events at the start of Co-Simulation */

#endif
