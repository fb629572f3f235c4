/* cotree_fmu.h: instances of a model as a functional mock-up unit, for all interface versions.
 *
 * A function of FMI 2 or FMI 3 first calls fmu_call with its name, for messages. It then calls one
 * of these functions and returns the status of the result. Results are 0, or 1 after an error was
 * logged, unless noted otherwise. */
#ifndef COTREE_FMU_H
#define COTREE_FMU_H

#include "cotree_start_tables.h"

/* Statuses, with the numbers that both standards assign. */
#define FMU_OK 0
#define FMU_DISCARD 2 /* values cannot be computed; a smaller step or other values may succeed */
#define FMU_ERROR 3

/* Modes of an instance, one bit each. */
#define FMU_INSTANTIATED 1
#define FMU_INITIALIZATION 2
#define FMU_EVENT 4
#define FMU_CONTINUOUS 8
#define FMU_STEP 16
#define FMU_TERMINATED 32
#define FMU_FAILED 64 /* FMI 2: mode after a discarded step of Co-Simulation */
#define FMU_RUNNING (FMU_EVENT | FMU_CONTINUOUS | FMU_STEP)
#define FMU_ANY (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_RUNNING | FMU_TERMINATED | FMU_FAILED)
#define FMU_SETTABLE (FMU_INSTANTIATED | FMU_INITIALIZATION | FMU_RUNNING)
#define FMU_DIFFERENTIABLE (FMU_INITIALIZATION | FMU_RUNNING | FMU_FAILED | FMU_TERMINATED)
#define FMU_WITH_STATES (FMU_INITIALIZATION | FMU_EVENT | FMU_CONTINUOUS | FMU_TERMINATED)
#define FMU_WITH_PROGRESS (FMU_STEP | FMU_FAILED | FMU_TERMINATED)

/* Blocks of variables. The value references of a block are consecutive. */
enum fmu_block {
    FMU_TIME,
    FMU_STATES,
    FMU_RATES,
    FMU_PARAMETERS,
    FMU_INPUTS,  /* inputs that the importer sets */
    FMU_SIGNALS, /* inputs that the scene defines as functions of time and parameters */
    FMU_OUTPUTS,
    FMU_INDICATORS,
    FMU_OUTPUT_SLOPES, /* sensitivities of outputs, by parameter */
    FMU_STATE_SLOPES,  /* sensitivities of states, by parameter */
    FMU_N_BLOCKS,
    FMU_NOMINALS = FMU_N_BLOCKS /* nominal continuous states, which have no value references */
};

/* Sparsity pattern of a matrix in compressed columns. */
typedef struct fmu_pattern {
    int n_rows, n_columns;
    const int *starts;
    const int *rows;
} fmu_pattern;

/* Tables of a model for its functional mock-up unit. */
typedef struct fmu_tables {
    const char *token;
    const cotree_model *(*model)(void);
    const struct cotree_stepper *(*stepper)(void);
    const void *(*aid)(void); /* data of the stepper, see cotree_job; NULL: none */
    int has_sensitivities;
    int is_exchangeable; /* 1: the unit offers Model Exchange */
    int is_implicit, is_strict, is_extended;
    int n_inputs;         /* number of inputs that the importer sets */
    const int *inputs;    /* indices of these inputs in the model */
    const double *values; /* their values until the importer sets them */
    const int *signals;   /* indices of the other inputs */
    const double *start;  /* states at the start with the default parameters */
    int is_found;         /* 1: states without a prescribed initial value start from `start` */
    int is_at_rest; /* 1: the start is an operating point, computed for the default parameters */
    const double *sizes;     /* factors of the absolute tolerances; NULL: 1 */
    double rtol, atol, span; /* default tolerances and time span */
    long most_steps;         /* limits for one step of Co-Simulation: steps and events */
    long most_events;
    int n_time_events;            /* number of series of time events */
    const int *time_event_starts; /* n_time_events: 1 if the series has no time event before its
                                     first time */
    int n_limits;                 /* number of upper bounds of the step size */
    const cotree_start_tables *start_tables;
    /* Derivatives of the rates and residuals, outputs, indicators and signals (rows) by states,
     * inputs of the importer, parameters and time (columns). */
    fmu_pattern partials;
    cotree_state_kernel find_partials;
    fmu_pattern initial; /* derivatives of the initial states with respect to the parameters */
    cotree_parameter_kernel find_initial;
    fmu_pattern constraints; /* derivatives of the constraints, then of the conditions of the start,
                                by all columns */
    cotree_state_kernel find_constraints;
    /* Computes the upper bounds of the step size; then the first time and the period of each
     * series of time events, and the derivatives of both with respect to the parameters. */
    cotree_parameter_kernel find_time_events;
} fmu_tables;

/* Return the tables of the model. */
const fmu_tables *fmu_tables_of_model(void);

/* The importer of an instance. */
typedef struct fmu_importer {
    int version; /* version of the interface, 2 or 3 */
    const char *name;
    void *environment;
    void (*callback)(void); /* function of the importer that receives messages; NULL: none */
    void (*log)(const struct fmu_importer *importer, int status, const char *category,
                const char *message);
    int is_logging; /* 0: only errors are logged */
} fmu_importer;

typedef struct fmu fmu;

/* Create an instance, or log an error and return NULL. fmu_reject logs the reason and returns
 * NULL. */
fmu *fmu_instantiate(const fmu_importer *importer, const char *token, int is_exchanged,
                     int returns_early);
fmu *fmu_reject(const fmu_importer *importer, const char *why);
void fmu_free(void *instance);

/* Start a call. Return NULL if there is no instance, or if its mode does not allow the call.
 * fmu_status returns the status of a call from its result. */
fmu *fmu_call(void *instance, const char *function, int modes);
int fmu_status(const fmu *m, int result);

/* Reject a call. fmu_refuse_type: for n variables of a type that does not occur. */
int fmu_refuse_call(fmu *m, const char *why);
int fmu_refuse_type(fmu *m, size_t n);

int fmu_set_logging(fmu *m, int is_logging, size_t n, const char *const categories[]);

/* Changes of mode. */
int fmu_set_up(fmu *m, const double *tolerance, double t, double end);
int fmu_enter_initialization(fmu *m);
int fmu_exit_initialization(fmu *m);
int fmu_terminate(fmu *m);
int fmu_reset(fmu *m);

/* Values of variables, given by n references. */
int fmu_get(fmu *m, const unsigned *references, size_t n, double *values, size_t n_values);
int fmu_set(fmu *m, const unsigned *references, size_t n, const double *values, size_t n_values);
int fmu_count_numbers(fmu *m, enum fmu_block block, size_t *n);

/* Saved states. Save the current state to *place, or to a new one if *place is NULL; restore a
 * state; free it; return its size in bytes; write it to bytes; read it from bytes. */
int fmu_save_state(fmu *m, void **place);
int fmu_restore_state(fmu *m, const void *from);
int fmu_free_state(fmu *m, void **place);
int fmu_measure_state(fmu *m, const void *from, size_t *n);
int fmu_write_state(fmu *m, const void *from, void *bytes, size_t n);
int fmu_read_state(fmu *m, const void *bytes, size_t n, void **place);

/* Directional derivatives: the seed has an entry for each known, and the result for each unknown.
 * Adjoint derivatives: vice versa. */
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

/* Results of an update in Event Mode, and of a step of Co-Simulation. */
typedef struct fmu_event_info {
    int terminates, are_states_changed, has_next;
    double next;
} fmu_event_info;
typedef struct fmu_progress {
    double reached;
    int is_early, terminates;
} fmu_progress;

/* Model Exchange. Blocks of numbers: states, rates, indicators and nominal values. */
int fmu_set_time(fmu *m, double t);
int fmu_set_states(fmu *m, const double *x, size_t n);
int fmu_get_numbers(fmu *m, enum fmu_block block, double *values, size_t n);
int fmu_complete_step(fmu *m, int *enters_event_mode);
int fmu_enter_event_mode(fmu *m);
int fmu_update(fmu *m, fmu_event_info *news);
int fmu_leave_event_mode(fmu *m);

/* Co-Simulation. A step ends at the requested time or, earlier, at an event or at the end of the
 * simulation. */
int fmu_step(fmu *m, double t, double step, fmu_progress *progress);

/* FMI 2: write the time that the last step reached, and whether the simulation has ended. If
 * is_known is 0, discard the call: steps are never pending, so that no other status exists. */
int fmu_get_progress(fmu *m, int is_known, double *reached, int *has_ended);

#endif
