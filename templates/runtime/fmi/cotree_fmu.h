/* cotree_fmu.h: an instance of a model as a functional mock-up unit, for all versions of the
 * interface.
 *
 * A function of FMI 2 or FMI 3 starts a call with its own name for messages, calls one of these and
 * returns the status of its result: 0, or 1 after an error is logged, unless noted. */
#ifndef COTREE_FMU_H
#define COTREE_FMU_H

#include "cotree_start_tables.h"

#include <stddef.h>

/* Statuses, with the numbers of both standards. */
#define FMU_OK 0
#define FMU_DISCARD 2 /* values cannot be computed; others, or a smaller step, may succeed */
#define FMU_ERROR 3

/* Modes of an instance, as bits of a mask. */
#define FMU_INSTANTIATED 1
#define FMU_INITIALIZATION 2
#define FMU_EVENT 4
#define FMU_CONTINUOUS 8
#define FMU_STEP 16
#define FMU_TERMINATED 32
#define FMU_FAILED 64 /* after a step of Co-Simulation that was discarded, in FMI 2 */
#define FMU_RUNNING (FMU_EVENT | FMU_CONTINUOUS | FMU_STEP)
#define FMU_ANY (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_RUNNING | FMU_TERMINATED | FMU_FAILED)
#define FMU_SETTABLE (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_RUNNING)
#define FMU_DIFFERENTIABLE (FMU_INITIALIZATION | FMU_RUNNING | FMU_FAILED | FMU_TERMINATED)
#define FMU_WITH_STATES (FMU_INITIALIZATION | FMU_EVENT | FMU_CONTINUOUS | FMU_TERMINATED)
#define FMU_WITH_PROGRESS (FMU_STEP | FMU_FAILED | FMU_TERMINATED)

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
    FMU_N_BLOCKS,
    FMU_NOMINALS = FMU_N_BLOCKS /* of continuous states, which are no variables */
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
    const struct cotree_stepper *(*stepper)(void);
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
    int n_stops;            /* time events and their periods */
    const int *stop_starts; /* n_stops: 1 if there is none before the first time */
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

/* The tables of the model. */
const fmu_tables *fmu_tables_of_model(void);

/* The importer of an instance. */
typedef struct fmu_importer {
    int version; /* of the interface: 2 or 3 */
    const char *name;
    void *environment;
    void (*callback)(void); /* its function for messages, which log calls; NULL: none */
    void (*log)(const struct fmu_importer *importer, int status, const char *category,
                const char *message);
    int is_logging; /* 0: only errors are logged */
} fmu_importer;

typedef struct fmu fmu;

/* Make an instance; log an error and return NULL on failure. fmu_reject logs why and returns NULL.
 */
fmu *fmu_instantiate(const fmu_importer *importer, const char *token, int is_exchanged,
                     int returns_early);
fmu *fmu_reject(const fmu_importer *importer, const char *why);
void fmu_free(void *instance);

/* Start a call: return NULL without an instance, or after rejecting the call in a mode that does
 * not allow it. Return the status of a call from its result. */
fmu *fmu_call(void *instance, const char *function, int modes);
int fmu_status(const fmu *m, int result);

/* Reject a call, or one for n variables of a type that none has. */
int fmu_refuse_call(fmu *m, const char *why);
int fmu_refuse_type(fmu *m, size_t n);

int fmu_set_logging(fmu *m, int is_logging, size_t n, const char *const categories[]);

/* Modes. */
int fmu_set_up(fmu *m, const double *tolerance, double t, double end);
int fmu_enter_initialization(fmu *m);
int fmu_exit_initialization(fmu *m);
int fmu_terminate(fmu *m);
int fmu_reset(fmu *m);

/* Variables: n references, and as many values. */
int fmu_get(fmu *m, const unsigned *references, size_t n, double *values, size_t n_values);
int fmu_set(fmu *m, const unsigned *references, size_t n, const double *values, size_t n_values);
int fmu_count_numbers(fmu *m, enum fmu_block block, size_t *n);

/* Saved states: copy the present one to that of *place, or to a new one if *place is NULL;
 * restore one; free one; compute its number of bytes; write it to bytes, or read it. */
int fmu_save_state(fmu *m, void **place);
int fmu_restore_state(fmu *m, const void *from);
int fmu_free_state(fmu *m, void **place);
int fmu_measure_state(fmu *m, const void *from, size_t *n);
int fmu_write_state(fmu *m, const void *from, void *bytes, size_t n);
int fmu_read_state(fmu *m, const void *bytes, size_t n, void **place);

/* Derivatives. Directional: the seed belongs to the knowns, and the result to the unknowns;
 * adjoint: the other way round. */
typedef struct fmu_direction {
    const unsigned *unknowns;
    size_t n_unknowns;
    const unsigned *knowns;
    size_t n_knowns;
    const double *seed;
    size_t n_seed;
    double *result;
    size_t n_result;
} fmu_direction;
int fmu_directional(fmu *m, const fmu_direction *d);
int fmu_adjoint(fmu *m, const fmu_direction *d);

/* Report of an update of Event Mode and of a step of Co-Simulation. */
typedef struct fmu_event_info {
    int terminates, are_states_changed, has_next;
    double next;
} fmu_event_info;
typedef struct fmu_progress {
    double reached;
    int is_early, terminates;
} fmu_progress;

/* Model Exchange. The blocks of numbers are states, rates, indicators and nominals. */
int fmu_set_time(fmu *m, double t);
int fmu_set_states(fmu *m, const double *x, size_t n);
int fmu_get_numbers(fmu *m, enum fmu_block block, double *values, size_t n);
int fmu_complete_step(fmu *m, int *enters_event_mode);
int fmu_enter_event_mode(fmu *m);
int fmu_update(fmu *m, fmu_event_info *news);
int fmu_leave_event_mode(fmu *m);

/* Co-Simulation. A step reaches a time, and may end early, at an event, or the simulation. */
int fmu_step(fmu *m, double t, double step, fmu_progress *progress);

/* Write the time that the last step has reached, or whether the simulation has ended, in FMI 2.
 * Discard if is_known is 0: there is no other status, since steps are never pending. */
int fmu_get_progress(fmu *m, int is_known, double *reached, int *has_ended);

#endif
