/* cotree_singularity.h: integration through singular positions, at which constraints lose rank.
 *
 * Near a singular position the rates at points off the constraints grow like the inverse of the
 * distance to it, so that steps shrink indefinitely or fail. A stretch as long as an ordinary step
 * is then integrated with projected rates, which are evaluated on the constraints. At tight
 * tolerances, rounding errors are amplified in the same way and may still shorten the steps; the
 * stretch is then integrated with looser tolerances. */
#ifndef COTREE_SINGULARITY_H
#define COTREE_SINGULARITY_H

#include "cotree_assembly.h"
#include "cotree_job.h"

COTREE_BEGIN_DECLS

/* Kind of the current stretch of the integration. */
typedef enum cotree_stretch {
    COTREE_ORDINARY = 0,
    COTREE_STRICT = 1, /* rates are evaluated at projected points */
    COTREE_LOOSE = 2   /* as COTREE_STRICT, with loosened tolerances */
} cotree_stretch;

typedef struct cotree_singularity {
    cotree_assembly assembly;
    cotree_stretch stretch, next; /* current stretch; stretch that the last step requires */
    cotree_real end;              /* end time of the stretch */
    /* Lengths of the longest ordinary steps, and of the last short step at which constraints were
     * tested. */
    cotree_real longest, longest_of_block, tested;
    int n_ordinary, n_short; /* ordinary steps so far; short steps since the last of them */
    /* Tolerances of the job outside stretches. */
    cotree_real rtol;
    const cotree_real *atols;
    int is_strict;
    cotree_real *loose; /* n absolute tolerances within a loose stretch */
    /* Start of the stretch with projected rates. */
    int has_start;
    cotree_real start, *w;
} cotree_singularity;

/* Initialise for a job with constraints; run is the run of its states. */
void cotree_singularity_init(cotree_singularity *s, const cotree_job *job, cotree_run *run,
                             cotree_arena *arena);

/* At a breakpoint or an event, discard the lengths and starts of previous steps. Multistep methods
 * take short steps after a restart. */
void cotree_singularity_restart(cotree_singularity *s, int is_multistep);

/* Store the length of a step. Return the kind of stretch that must follow near a singular
 * position. */
cotree_stretch cotree_singularity_watch(cotree_singularity *s, const cotree_job *job,
                                        int is_multistep);

/* Return the kind of stretch that must follow a failed step near a singular position. */
cotree_stretch cotree_singularity_next(const cotree_singularity *s, const cotree_job *job);

/* Return whether constraints are nearly dependent at t and x. */
int cotree_singularity_is_near(cotree_singularity *s, cotree_real t, const cotree_real *x);

/* Change the settings of a job until s->end, or restore them. The stepper must restart. */
void cotree_singularity_enter(cotree_singularity *s, cotree_job *job, cotree_stretch stretch,
                              cotree_real ahead);

/* Return the tolerance within a loose stretch. It is at least the tolerance of the job. */
cotree_real cotree_singularity_loosened(cotree_real tolerance);

/* Return the remaining length of the current stretch at time t; 0 outside stretches. */
cotree_real cotree_singularity_length(const cotree_singularity *s, cotree_real t);

COTREE_END_DECLS

#endif
