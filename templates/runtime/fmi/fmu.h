/* fmu.h: an instance of a model as a functional mock-up unit, for all versions of the interface.
 * Part of the runtime of cotree, the same for every model.
 *
 * The functions of FMI 2 and FMI 3 check their arguments and call these. Functions return 0, or
 * 1 after logging an error. */
#ifndef COTREE_FMU_H
#define COTREE_FMU_H

#include "cotree_assembly.h"
#include "cotree_events.h"
#include "cotree_job.h"
#include "cotree_start_tables.h"

#include <stddef.h>

/* Modes of an instance, as bits of a mask. */
#define FMU_INSTANTIATED 1
#define FMU_INITIALIZATION 2
#define FMU_EVENT 4
#define FMU_CONTINUOUS 8
#define FMU_STEP 16
#define FMU_TERMINATED 32
#define FMU_FAILED 64 /* after a step of Co-Simulation that ended early, in FMI 2 */
#define FMU_RUNNING (FMU_EVENT | FMU_CONTINUOUS | FMU_STEP)

/* Blocks of variables; each has consecutive value references. */
enum fmu_block {
    FMU_TIME,
    FMU_STATES,
    FMU_RATES,
    FMU_PARAMETERS,
    FMU_INPUTS,  /* set by the importer */
    FMU_SIGNALS, /* inputs of the scene that are functions of time and parameters */
    FMU_OUTPUTS,
    FMU_INDICATORS,
    FMU_OUTPUT_SLOPES, /* sensitivities of outputs, by parameter */
    FMU_STATE_SLOPES,  /* sensitivities of states, by parameter */
    FMU_N_BLOCKS
};

/* A sparse matrix, compressed by columns. */
typedef struct fmu_pattern {
    int n_rows, n_columns;
    const int *starts;
    const int *rows;
} fmu_pattern;

/* The tables of a model for its unit. */
typedef struct fmu_tables {
    const char *token;
    const cotree_model *(*model)(void);
    const cotree_stepper *(*stepper)(void);
    const void *(*aid)(void); /* data of the stepper; NULL: none */
    int has_sensitivities;
    int is_exchangeable; /* offers Model Exchange */
    int is_implicit, is_strict, is_extended;
    int n_inputs;         /* set by the importer */
    const int *inputs;    /* their places among the model's */
    const double *values; /* their values until they are set */
    const int *signals;   /* the other inputs */
    const double *start;  /* states at the start, at the default parameters */
    int is_found;   /* 1: states without a prescribed initial value start from those in start */
    int is_at_rest; /* 1: the start is an operating point, found at the defaults */
    const double *sizes;     /* factors of absolute tolerances; NULL: 1 */
    double rtol, atol, span; /* defaults */
    long most_steps;         /* budgets of one step of Co-Simulation */
    long most_events;
    int n_stops;
    const int *stop_starts; /* 1: none before the first time */
    int n_limits;           /* upper bounds of steps */
    const cotree_start_tables *start_tables;
    /* Derivatives of rates and residuals, outputs, indicators and signals, by states, inputs set
     * by the importer, parameters and time. */
    fmu_pattern partials;
    cotree_state_kernel find_partials;
    fmu_pattern initial; /* of the initial states by parameters */
    cotree_parameter_kernel find_initial;
    fmu_pattern constraints; /* of constraints, then of conditions of the start, by all columns */
    cotree_state_kernel find_constraints;
    /* Upper bounds of steps; then the first time and period of each stop (a time event), and the
     * derivatives of both by each parameter of sensitivity. */
    cotree_parameter_kernel find_stops;
} fmu_tables;

/* Severity of a message: information, a value that cannot be computed, or an error. */
enum fmu_severity { FMU_NOTE, FMU_DISCARD, FMU_ERROR };

typedef void (*fmu_logger)(void *environment, enum fmu_severity severity, const char *message);

/* Numbers in the state of an instance, before its arrays. */
enum fmu_number {
    FMU_MODE,
    FMU_NOW,
    FMU_BEGIN, /* start time */
    FMU_END,   /* stop time, or infinity */
    FMU_TOLERANCE,
    FMU_LOW, /* times between which rates have no kink */
    FMU_HIGH,
    FMU_NEXT,       /* the next time event, or infinity */
    FMU_IS_STARTED, /* 1: the states are those of the start for the present parameters */
    FMU_IS_CHOSEN,  /* 1: the start is one of several projections */
    FMU_IS_BEGUN,   /* 1: events have been processed once */
    FMU_IS_CHANGED, /* 1: inputs or parameters changed since the last step */
    FMU_IS_SOLVED,  /* 1: algebraic unknowns are known at the next number and the old states */
    FMU_SOLVED_AT,
    FMU_IS_SET_UP, /* 1: the times and the tolerance of the experiment are set */
    FMU_HAS_ENDED, /* 1: an event ended the simulation */
    FMU_N_NUMBERS
};

typedef struct fmu {
    const fmu_tables *tables;
    const cotree_model *model; /* from the same file */
    int is_exchanged;          /* 1: Model Exchange, 0: Co-Simulation */
    int returns_early;
    int mode; /* a copy of FMU_MODE */
    /* 1: the present call may discard a value that cannot be computed, so that the importer
     * tries a smaller step; 1: it did. */
    int may_discard, is_discarded;
    fmu_logger logger;
    void *environment;
    int offsets[FMU_N_BLOCKS + 1]; /* the first value reference of each block */
    /* The state: numbers, then arrays, adjacent in memory. */
    size_t n_saved;
    double *saved;
    double *numbers;
    double *z; /* states, then sensitivities */
    double *p;
    double *outside;    /* inputs */
    double *own_values; /* initial values set by the importer */
    double *is_own;
    double *old;           /* states at which algebraic unknowns were found last */
    double *event_history; /* history of the events */
    /* Values computed from the state. */
    int valid;
    int is_prepared;
    double *k, *u, *dx, *y, *g, *dy, *stops, *partials, *initial, *moved;
    double *seed, *rows, *solved, *dense, *work, *atols;
    double *before;
    double *spare; /* the state before a step */
    int *pivots, *known;
    double *corners, *slopes, *spreads, *turn_tolerances;
    size_t n_corners; /* allocated */
    cotree_run run;
    cotree_assembly assembly; /* for models with constraints or conditions */
    cotree_events events;
    void *job_memory;
    size_t n_job_memory;
    double *records;
    void *memory;
} fmu;

/* Memory. */
fmu *fmu_new(const fmu_tables *tables, int is_exchanged, int returns_early, fmu_logger logger,
             void *environment);
void fmu_free(fmu *m);
void fmu_reset(fmu *m);

/* Messages. fmu_refuse logs an error; fmu_discard logs that a value is discarded, if the present
 * call may do so. Both return 1. */
void fmu_log(const fmu *m, enum fmu_severity severity, const char *format, ...);
int fmu_refuse(const fmu *m, const char *format, ...);
int fmu_discard(fmu *m, const char *format, ...);

/* Start a call: reject it in a mode that does not allow it. */
int fmu_check(fmu *m, const char *function, int modes);
const char *fmu_mode_name(const fmu *m);
void fmu_enter(fmu *m, int mode);

/* Variables. */
int fmu_get(fmu *m, const unsigned *references, size_t n, double *values);
int fmu_set(fmu *m, const unsigned *references, size_t n, const double *values);
int fmu_find(const fmu *m, unsigned reference, int *index); /* return its block, or -1 */

/* Bits of the values that are valid for the present state. */
#define FMU_POINT 1
#define FMU_HAS_RATES 2
#define FMU_HAS_OUTPUTS 4
#define FMU_HAS_INDICATORS 8
#define FMU_HAS_PARTIALS 16
#define FMU_HAS_SLOPES 32

int fmu_prepare(fmu *m);
void fmu_set_up_run(fmu *m);
int fmu_refresh(fmu *m, int what);
cotree_events *fmu_events(fmu *m); /* with the present settings, without their history */
double fmu_span(const fmu *m);     /* from start to stop time, or the default */
void fmu_invalidate(fmu *m);       /* invalidate computed values */

/* Initialization. */
int fmu_set_up(fmu *m, double t, double end, double tolerance);
int fmu_begin(fmu *m);
int fmu_start(fmu *m);
int fmu_leave_initialization(fmu *m);
int fmu_move_start(fmu *m, const int *is_known, double *seed);

/* Derivatives. */
int fmu_directional(fmu *m, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                    size_t n_knowns, const double *seed, double *sensitivity);
int fmu_adjoint(fmu *m, const unsigned *unknowns, size_t n_unknowns, const unsigned *knowns,
                size_t n_knowns, const double *seed, double *sensitivity);

/* Model Exchange. */
typedef struct fmu_event_info {
    int terminates, are_states_changed, has_next;
    double next;
} fmu_event_info;
int fmu_set_time(fmu *m, double t);
int fmu_set_states(fmu *m, const double *x, size_t n);
int fmu_get_states(fmu *m, double *x, size_t n);
int fmu_get_rates(fmu *m, double *dx, size_t n);
int fmu_get_indicators(fmu *m, double *g, size_t n);
int fmu_get_nominals(fmu *m, double *sizes, size_t n);
int fmu_complete_step(fmu *m, int *enters_event_mode);
int fmu_update(fmu *m, fmu_event_info *news);
int fmu_leave_event_mode(fmu *m);

/* Time events. */
int fmu_find_stops(fmu *m);
double fmu_next_stop(const fmu *m, double t, double end);
int fmu_is_stop(const fmu *m, double t);
void fmu_stop_slopes(const fmu *m, double t, int is_start, double *slopes, double *spreads);
double fmu_largest_stop(const fmu *m, double end);

/* Co-Simulation. fmu_enter_steps processes the events at the start. *reached is the time up to
 * which a step was computed. */
int fmu_enter_steps(fmu *m);
int fmu_step(fmu *m, double t, double step, int *is_early, double *reached);

/* State. */
size_t fmu_state_size(const fmu *m);
void fmu_save_state(const fmu *m, double *to);
int fmu_restore_state(fmu *m, const double *from, size_t n);

/* The tables of the model. */
const fmu_tables *fmu_tables_of_model(void);

#endif
