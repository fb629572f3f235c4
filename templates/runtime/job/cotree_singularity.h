/* cotree_singularity.h: integration through singular positions, where constraints lose rank.
 *
 * Near such a position rates off the constraints grow like the inverse of the distance to it:
 * steps shrink without end, or fail. A stretch as long as an ordinary step is then integrated with
 * rates on the constraints. At tight tolerances rounding, enlarged likewise, may still shorten the
 * steps: the stretch is then integrated with looser ones. */
#ifndef COTREE_SINGULARITY_H
#define COTREE_SINGULARITY_H

#include "cotree_assembly.h"
#include "cotree_job.h"

COTREE_BEGIN_DECLS

/* Tolerances and rates within the present stretch. */
typedef enum cotree_stretch {
    COTREE_ORDINARY = 0,
    COTREE_STRICT = 1, /* rates are evaluated on the constraints */
    COTREE_LOOSE = 2   /* tolerances are loosened, too */
} cotree_stretch;

typedef struct cotree_singularity {
    cotree_assembly assembly;
    cotree_stretch stretch, next; /* the present stretch, and the one that the last step requires */
    cotree_real end;              /* of the stretch */
    /* Lengths of ordinary steps, and of the short one after which constraints were tested last. */
    cotree_real longest, longest_of_block, tested;
    int n_ordinary, n_short; /* number of short steps since the last ordinary one */
    /* Tolerances of the job, which apply outside stretches. */
    cotree_real rtol;
    const cotree_real *atols;
    int is_strict;
    cotree_real *loose; /* absolute tolerances of a stretch, n */
    /* The point at which evaluation of rates on the constraints began. */
    int has_start;
    cotree_real start, *w;
} cotree_singularity;

/* Initialise for a job with constraints; run: of its states. */
void cotree_singularity_init(cotree_singularity *s, const cotree_job *job, cotree_run *run,
                             cotree_arena *arena);

/* Do not return to points before a breakpoint or an event. Multistep methods take short steps
 * after it, so the lengths of the last steps are discarded. */
void cotree_singularity_restart(cotree_singularity *s, int is_multistep);

/* Store the length of a step. Return the stretch that follows if a singular position is near. */
cotree_stretch cotree_singularity_watch(cotree_singularity *s, const cotree_job *job,
                                        int is_multistep);

/* Return the stretch that follows after a step failed, if a singular position is near. */
cotree_stretch cotree_singularity_next(const cotree_singularity *s, const cotree_job *job);

/* Return whether constraints are nearly dependent at t and x. */
int cotree_singularity_is_near(cotree_singularity *s, cotree_real t, const cotree_real *x);

/* Change the settings of a job until s->end, or restore them. The stepper has to restart. */
void cotree_singularity_enter(cotree_singularity *s, cotree_job *job, cotree_stretch stretch,
                              cotree_real ahead);

/* Return a tolerance within a loose stretch, not below that of the job. */
cotree_real cotree_singularity_loosened(cotree_real tolerance);

/* Return the length of the present stretch from t on; 0 outside stretches. */
cotree_real cotree_singularity_length(const cotree_singularity *s, cotree_real t);

COTREE_END_DECLS

#endif
