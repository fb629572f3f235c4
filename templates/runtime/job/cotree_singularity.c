/* cotree_singularity.c: detection of singular positions, and tolerances near them. */
#include "cotree_singularity.h"

#if COTREE_HAS_CONSTRAINTS
/* A step is short if it is below this fraction of the longest of the last BLOCK to 2 BLOCK
 * ordinary steps; step sizes of multistep methods vary more. MANY short steps in a row are not
 * caused by step size control alone. Projected rates cost little: they are considered at the first
 * short step, and again after a step below AGAIN times the step considered last. */
#define SHORT COTREE_F(0.3)
#define SHORT_MULTISTEP COTREE_F(0.03)
#define AGAIN COTREE_F(0.5)
#define BLOCK 20
#define MANY 15

/* Factor of the tolerances within a stretch, and the largest loosened tolerance. Rounding errors,
 * amplified by the inverse of the distance from the singular position, then have no effect. */
#define LOOSENED COTREE_F(1e3)
#define LOOSEST COTREE_SELECT(1e-9, 1e-4f)

void cotree_singularity_init(cotree_singularity *s, const cotree_job *job, cotree_run *run,
                             cotree_arena *arena)
{
    cotree_assembly_init(&s->assembly, run, job->constraints, arena);
    s->loose = cotree_arena_reals(arena, job->n);
    s->stretch = s->next = COTREE_ORDINARY;
    s->w = cotree_arena_reals(arena, job->n);
    cotree_singularity_restart(s, 1);
}

void cotree_singularity_restart(cotree_singularity *s, int is_multistep)
{
    s->has_start = 0;
    if (!is_multistep) return;
    s->longest = s->longest_of_block = COTREE_F(0.0);
    s->n_ordinary = s->n_short = 0;
}

/* Store the length of an ordinary step. */
static void add_ordinary(cotree_singularity *s, cotree_real length)
{
    s->n_short = 0;
    if (s->n_ordinary++ % BLOCK == 0) {
        s->longest = s->longest_of_block;
        s->longest_of_block = COTREE_F(0.0);
    }
    if (length > s->longest_of_block) s->longest_of_block = length;
    if (length > s->longest) s->longest = length;
}

cotree_stretch cotree_singularity_next(const cotree_singularity *s, const cotree_job *job)
{
    if (s->stretch == COTREE_ORDINARY && !job->is_strict) return COTREE_STRICT;
    return s->stretch != COTREE_LOOSE && job->rtol < LOOSEST ? COTREE_LOOSE : s->stretch;
}

cotree_stretch cotree_singularity_watch(cotree_singularity *s, const cotree_job *job,
                                        int is_multistep)
{
    const cotree_real share = is_multistep ? SHORT_MULTISTEP : SHORT;
    cotree_stretch next;
    if (!(job->last_step < share * s->longest)) {
        add_ordinary(s, job->last_step);
        return s->stretch;
    }
    ++s->n_short;
    next = cotree_singularity_next(s, job);
    if (next != COTREE_STRICT) return s->n_short % MANY == 0 ? next : s->stretch;
    if (s->n_short > 1 && !(job->last_step < AGAIN * s->tested)) return s->stretch;
    s->tested = job->last_step;
    return next;
}

int cotree_singularity_is_near(cotree_singularity *s, cotree_real t, const cotree_real *x)
{
    if (!(s->longest > COTREE_F(0.0))) return 0;
    if (cotree_run_inputs(s->assembly.run, t) != 0) return 0;
    return cotree_assembly_is_dependent(&s->assembly, t, x);
}

cotree_real cotree_singularity_loosened(cotree_real tolerance)
{
    return COTREE_FMAX(tolerance, COTREE_FMIN(LOOSENED * tolerance, LOOSEST));
}

void cotree_singularity_enter(cotree_singularity *s, cotree_job *job, cotree_stretch stretch,
                              cotree_real ahead)
{
    int i;
    if (s->stretch == COTREE_ORDINARY) {
        s->rtol = job->rtol;
        s->atols = job->atols;
        s->is_strict = job->is_strict;
        for (i = 0; i < job->n; ++i) s->loose[i] = cotree_singularity_loosened(job->atols[i]);
    }
    s->stretch = s->next = stretch;
    if (stretch == COTREE_ORDINARY) s->has_start = 0;
    s->n_short = 0;
    s->end = job->t + ahead * s->longest;
    job->rtol = stretch == COTREE_LOOSE ? cotree_singularity_loosened(s->rtol) : s->rtol;
    job->atols = stretch == COTREE_LOOSE ? s->loose : s->atols;
    job->is_strict = s->is_strict || stretch != COTREE_ORDINARY;
}

cotree_real cotree_singularity_length(const cotree_singularity *s, cotree_real t)
{
    return s->stretch == COTREE_ORDINARY ? COTREE_F(0.0) : COTREE_FABS(s->end - t);
}
#endif
