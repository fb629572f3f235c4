/* cotree_settle.c: moves onto the constraints that keep prescribed states.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_jumps_internal.h"

#include <float.h>
#include <math.h>
#include <stddef.h>

/* The least moves onto the constraints that keep what was set. */

static int is_quaternion(const cotree_jumps *j, int state)
{
    int i;
    for (i = 0; i < j->hybrid->n_quaternions; ++i) {
        if (j->hybrid->quaternions[i] == state) return 1;
    }
    return 0;
}

/* Says which directions of motion nothing that was set fixes; returns how many. */
static int find_free(cotree_jumps *j, int level)
{
    int i, k, n_free = 0, speed = 0, state = 0;
    while (speed < N_SPEEDS) {
        const int is_turning = level == 0 && is_quaternion(j, state);
        int is_free = 1;
        if (level == 1) state = N_COORDINATES + speed;
        for (k = 0; k < (is_turning ? 4 : 1); ++k) is_free = is_free && !j->is_kept[state + k];
        for (i = 0; i < (is_turning ? 3 : 1); ++i) {
            j->is_free[speed++] = is_free;
            n_free += is_free;
        }
        state += is_turning ? 4 : 1;
    }
    return n_free;
}

/* Gives quaternions the norm one. Returns 0, or another number where one is zero. */
int cotree_normalise(const cotree_jumps *j, cotree_real *x)
{
    int i, k;
    for (i = 0; i < j->hybrid->n_quaternions; ++i) {
        cotree_real *const q = x + j->hybrid->quaternions[i];
        cotree_real size = COTREE_F(0.0);
        for (k = 0; k < 4; ++k) size += q[k] * q[k];
        if (!(size > COTREE_F(0.0))) return COTREE_JUMPS_CONTRADICT;
        for (k = 0; k < 4; ++k) q[k] /= COTREE_SQRT(size);
    }
    return 0;
}

/* Adds what a step along the directions of motion at x changes the coordinates by. */
static void shift(const cotree_jumps *j, const cotree_real *x, const cotree_real *step,
                  cotree_real *change)
{
    int state = 0, i = 0;
    while (state < N_COORDINATES) {
        if (is_quaternion(j, state)) {
            const cotree_real *const q = x + state, *const s = step + i;
            cotree_real *const d = change + state;
            const cotree_real d0 = -q[1] * s[0] - q[2] * s[1] - q[3] * s[2];
            const cotree_real d1 = q[0] * s[0] - q[3] * s[1] + q[2] * s[2];
            const cotree_real d2 = q[3] * s[0] + q[0] * s[1] - q[1] * s[2];
            const cotree_real d3 = -q[2] * s[0] + q[1] * s[1] + q[0] * s[2];
            d[0] += COTREE_F(0.5) * d0;
            d[1] += COTREE_F(0.5) * d1;
            d[2] += COTREE_F(0.5) * d2;
            d[3] += COTREE_F(0.5) * d3;
            state += 4;
            i += 3;
        } else {
            change[state++] += step[i++];
        }
    }
}

static int count_rows(const cotree_jumps *j, int level)
{
    return level == 0 ? j->hybrid->n_values : j->hybrid->n_rows;
}

/* Writes the constraints at x; the largest of a level goes to size. */
static int evaluate(cotree_jumps *j, cotree_real t, const cotree_real *x, int level,
                    cotree_real *size)
{
    const cotree_run *const run = j->run;
    const cotree_real *const own = j->residual + (level == 0 ? 0 : j->hybrid->n_values);
    const int status = MODEL->constraints(t, x, run->u, run->p, run->k, j->residual);
    int i;
    *size = COTREE_F(0.0);
    for (i = 0; i < count_rows(j, level); ++i) {
        if (!(COTREE_FABS(own[i]) <= *size)) *size = COTREE_FABS(own[i]); /* nan, too */
    }
    return status;
}

/* Writes an orthonormal basis of the gradients of a level by what is free, and how the gradients
 * are made of it, the longest remaining one first. Returns the rank, or minus a kernel's
 * complaint. */
static int orthogonalise(cotree_jumps *j, cotree_real t, const cotree_real *x, int level)
{
    const cotree_run *const run = j->run;
    const int n = N_SPEEDS, n_rows = count_rows(j, level), width = j->hybrid->n_rows;
    const int status = MODEL->gradient(t, x, run->u, run->p, run->k, j->gradient);
    cotree_real largest = COTREE_F(0.0);
    int i, k, r, rank;
    if (status != 0) return status > 0 ? -status : status;
    for (r = 0; r < n_rows; ++r) {
        const cotree_real *const row =
            j->gradient + (level == 0 ? j->hybrid->value_rows[r] : r) * n;
        for (i = 0; i < n; ++i) j->basis[r * n + i] = j->is_free[i] ? row[i] : COTREE_F(0.0);
        j->order[r] = r;
    }
    for (rank = 0; rank < n_rows; ++rank) {
        cotree_real longest = -COTREE_F(1.0), length;
        cotree_real *pivot;
        int place = rank;
        for (r = rank; r < n_rows; ++r) {
            length = COTREE_F(0.0);
            for (i = 0; i < n; ++i) length += j->basis[r * n + i] * j->basis[r * n + i];
            if (length > longest) {
                longest = length;
                place = r;
            }
        }
        length = COTREE_SQRT(longest);
        if (rank == 0) largest = length;
        if (!(length > COTREE_F(0.0) && length > RANK * largest)) break;
        pivot = j->basis + rank * n;
        for (i = 0; i < n; ++i) {
            const cotree_real entry = j->basis[place * n + i];
            j->basis[place * n + i] = pivot[i];
            pivot[i] = entry / length;
        }
        for (k = 0; k < rank; ++k) {
            const cotree_real entry = j->triangle[place * width + k];
            j->triangle[place * width + k] = j->triangle[rank * width + k];
            j->triangle[rank * width + k] = entry;
        }
        r = j->order[place];
        j->order[place] = j->order[rank];
        j->order[rank] = r;
        j->triangle[rank * width + rank] = length;
        for (r = rank + 1; r < n_rows; ++r) {
            cotree_real along = COTREE_F(0.0);
            for (i = 0; i < n; ++i) along += j->basis[r * n + i] * pivot[i];
            for (i = 0; i < n; ++i) j->basis[r * n + i] -= along * pivot[i];
            j->triangle[r * width + rank] = along;
        }
    }
    return rank;
}

/* Writes the least step that changes the constraints of a level by minus what is given. */
static void find_step(cotree_jumps *j, int rank, const cotree_real *residual)
{
    const int n = N_SPEEDS, width = j->hybrid->n_rows;
    int i, k, r;
    for (i = 0; i < n; ++i) j->step[i] = COTREE_F(0.0);
    for (r = 0; r < rank; ++r) {
        cotree_real weight = -residual[j->order[r]];
        for (k = 0; k < r; ++k) weight -= j->triangle[r * width + k] * j->weights[k];
        j->weights[r] = weight / j->triangle[r * width + r];
        for (i = 0; i < n; ++i) j->step[i] += j->weights[r] * j->basis[r * n + i];
    }
}

/* Moves coordinates (level 0) or speeds (1) at x along a step. */
static int move(cotree_jumps *j, int level, cotree_real *x)
{
    int i;
    if (level == 1) {
        for (i = 0; i < N_SPEEDS; ++i) x[N_COORDINATES + i] += j->step[i];
        return 0;
    }
    for (i = 0; i < N_COORDINATES; ++i) j->trial[i] = COTREE_F(0.0);
    shift(j, x, j->step, j->trial);
    for (i = 0; i < N_COORDINATES; ++i) x[i] += j->trial[i];
    return cotree_normalise(j, x);
}

static cotree_real largest_of(const cotree_real *x, int n)
{
    cotree_real largest = COTREE_F(0.0);
    int i;
    for (i = 0; i < n; ++i) largest = COTREE_FMAX(largest, COTREE_FABS(x[i]));
    return largest;
}

/* Brings the states onto the constraints of a level by Newton steps of least length. */
int cotree_settle(cotree_jumps *j, cotree_real t, cotree_real *x, int level)
{
    const int n_free = find_free(j, level);
    const cotree_real scale = COTREE_F(1.0) + largest_of(x, N_STATES);
    const cotree_real *const own = j->residual + (level == 0 ? 0 : j->hybrid->n_values);
    cotree_real smallest, size;
    int i, n, status = evaluate(j, t, x, level, &smallest);
    for (i = 0; i < N_STATES; ++i) j->best[i] = x[i];
    for (n = 0; n < MOST_STEPS && status == 0; ++n) {
        int rank;
        if (n_free == 0 || !(smallest > ROUNDING * scale)) break;
        rank = orthogonalise(j, t, x, level);
        if (rank < 0) return -rank;
        if (rank == 0) break;
        status = evaluate(j, t, x, level, &size);
        if (status != 0) break;
        find_step(j, rank, own);
        if (level == 0) {
            const cotree_real length = largest_of(j->step, N_SPEEDS);
            for (i = 0; i < N_SPEEDS && length > LONGEST; ++i) j->step[i] *= LONGEST / length;
        }
        status = move(j, level, x);
        if (status == 0) status = evaluate(j, t, x, level, &size);
        if (status != 0) break;
        if (size < smallest) {
            for (i = 0; i < N_STATES; ++i) j->best[i] = x[i];
            smallest = size;
        } else if (!(smallest >= COTREE_SELECT(1e-9, 1.2e-04f))) {
            break;
        }
    }
    if (status != 0) return status;
    for (i = 0; i < N_STATES; ++i) x[i] = j->best[i];
    return smallest <= MET * scale ? 0 : COTREE_JUMPS_CONTRADICT;
}

/* Tells whether the least of several moves was taken from one point to another. */
int cotree_is_chosen(cotree_jumps *j, cotree_real t, const cotree_real *from, const cotree_real *to)
{
    int i, level;
    for (level = 0; level < 2 && MODEL->gradient != NULL; ++level) {
        const int first = level == 0 ? 0 : N_COORDINATES;
        const int n = level == 0 ? N_COORDINATES : N_SPEEDS;
        const int n_free = find_free(j, level);
        cotree_real moved = COTREE_F(0.0);
        for (i = first; i < first + n; ++i)
            moved = COTREE_FMAX(moved, COTREE_FABS(to[i] - from[i]));
        if (moved > MET && n_free > orthogonalise(j, t, to, level)) return 1;
    }
    return 0;
}

/* Lets the sensitivities of what was not set follow from the constraints. */
int cotree_settle_sensitivities(cotree_jumps *j, cotree_real t, const cotree_real *x,
                                cotree_real *s)
{
    const cotree_run *const run = j->run;
    int i, k, level, n;
    for (n = 0; n < N_SENSITIVITIES; ++n) {
        for (i = 0; i < j->hybrid->n_quaternions; ++i) {
            const cotree_real *const q = x + j->hybrid->quaternions[i];
            cotree_real *const own = s + n * N_STATES + j->hybrid->quaternions[i];
            cotree_real along = COTREE_F(0.0);
            for (k = 0; k < 4; ++k) along += q[k] * own[k];
            for (k = 0; k < 4; ++k) own[k] -= along * q[k];
        }
    }
    for (level = 0; level < 2 && MODEL->gradient != NULL; ++level) {
        const int first = level == 0 ? 0 : j->hybrid->n_values;
        int rank, status;
        find_free(j, level);
        rank = orthogonalise(j, t, x, level);
        if (rank < 0) return -rank;
        status = MODEL->constraint_sensitivity(t, x, s, run->u, run->p, run->k, j->residual);
        if (status != 0) return status;
        for (n = 0; n < N_SENSITIVITIES; ++n) {
            cotree_real *const own = s + n * N_STATES;
            find_step(j, rank, j->residual + n * MODEL->n_constraints + first);
            if (level == 0) {
                shift(j, x, j->step, own);
            } else {
                for (i = 0; i < N_SPEEDS; ++i) own[N_COORDINATES + i] += j->step[i];
            }
        }
    }
    return 0;
}
