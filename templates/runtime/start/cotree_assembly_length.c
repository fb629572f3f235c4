/* cotree_assembly_length.c: characteristic length of the constraints, and detection of dependent
 * constraints. */
#include "cotree_assembly_internal.h"

/* The characteristic length is the median lever arm over POSITIONS positions, with joints rotated
 * by about JOINT_ROTATION, [rad]. Squares below the fraction MIN_SQUARE_SHARE, and lengths below
 * MIN_LENGTH, [m], are rounding errors. */
#define JOINT_ROTATION COTREE_F(0.5)
#define MIN_SQUARE_SHARE COTREE_SELECT(1e-12, 1e-05f)
#define MIN_LENGTH COTREE_SELECT(1e-9, 1e-06f)

/* Constraints are nearly dependent if the smallest singular value of their gradients is below
 * NEARLY times its value in other positions, or below LEAST_GAP. Rows below ROUNDED_ROW times
 * max(1, largest entry) are rounding errors. */
#define NEARLY COTREE_F(0.1)
#define LEAST_GAP COTREE_SELECT(1e-6, 1e-03f)
#define ROUNDED_ROW COTREE_SELECT(1e-12, 1e-05f)

/* Add the squares of the gradients with respect to rotations and translations to the sums of their
 * groups. Increase *lever to the longest lever arm of a translation. */
static void add_squares(const cotree_assembly *a, cotree_real *turned, cotree_real *shifted,
                        cotree_real *lever)
{
    const cotree_assembly_tables *const tables = a->tables;
    const int n = tables->n_rows + tables->n_conditions;
    int i, r;
    for (r = 0; r < n; ++r) {
        const cotree_real *const row = cotree_assembly_gradient_of(a, tables->n_values + r);
        const int is_lever = cotree_assembly_is_length(a, tables->n_values + r);
        for (i = 0; i < N_SPEEDS; ++i) {
            const int is_turn = cotree_assembly_is_angular(a, i);
            (is_turn ? turned : shifted)[tables->groups[r]] += row[i] * row[i];
            if (is_turn && is_lever) *lever = COTREE_FMAX(*lever, COTREE_FABS(row[i]));
        }
    }
}

/* Return the median ratio of the rotational to the translational part of the gradients, or 0 if
 * there is no such ratio. */
static cotree_real median_ratio(int n, const cotree_real *turned, const cotree_real *shifted,
                                cotree_real *sorted)
{
    const cotree_real least_turned =
        MIN_SQUARE_SHARE * MIN_SQUARE_SHARE * cotree_assembly_largest_of(turned, n);
    const cotree_real least_shifted =
        MIN_SQUARE_SHARE * MIN_SQUARE_SHARE * cotree_assembly_largest_of(shifted, n);
    int i, k, n_found = 0;
    for (i = 0; i < n; ++i) {
        cotree_real length;
        if (!(turned[i] > least_turned && shifted[i] > least_shifted)) continue;
        length = COTREE_SQRT(turned[i] / shifted[i]);
        for (k = n_found++; k > 0 && sorted[k - 1] > length; --k) sorted[k] = sorted[k - 1];
        sorted[k] = length;
    }
    return n_found > 0 ? sorted[n_found / 2] : COTREE_F(0.0);
}

/* Write x with all joints rotated to a->trial. Each position has its own rotations. */
static int rotate_joints(cotree_assembly *a, const cotree_real *x, int position)
{
    int i;
    cotree_assembly_copy(N_STATES, x, a->trial);
    for (i = 0; i < N_COORDINATES; ++i) {
        if (!cotree_assembly_is_shift(a, i))
            a->trial[i] += JOINT_ROTATION * cotree_pseudo_random(position * N_COORDINATES + i);
    }
    return cotree_assembly_normalise(a, a->trial);
}

/* Load the gradients of all constraints, scaled so that the longest of each group has norm one. */
static int load_gradients(cotree_assembly *a, cotree_real t, const cotree_real *x)
{
    const cotree_assembly_tables *const tables = a->tables;
    cotree_real *const longest = a->parts;
    cotree_real largest = COTREE_F(1.0);
    int i, r, status = cotree_assembly_compute_gradients(a, t, x);
    if (status != 0) return status;
    for (i = 0; i < tables->n_groups; ++i) longest[i] = COTREE_F(0.0);
    for (i = 0; i < tables->n_rows * N_SPEEDS; ++i)
        largest = COTREE_FMAX(largest, COTREE_FABS(a->gradient[i]));
    for (r = 0; r < tables->n_rows; ++r) {
        const cotree_real *const gradient = a->gradient + r * N_SPEEDS;
        cotree_real *const row = a->least.rows + r * N_SPEEDS;
        cotree_real square = COTREE_F(0.0), plain = COTREE_F(0.0);
        for (i = 0; i < N_SPEEDS; ++i) {
            row[i] = gradient[i] * cotree_assembly_unit_of_speed(a, i);
            square += row[i] * row[i];
            plain += gradient[i] * gradient[i];
        }
        if (!(COTREE_SQRT(plain) > ROUNDED_ROW * largest)) {
            for (i = 0; i < N_SPEEDS; ++i) row[i] = square = COTREE_F(0.0);
        }
        longest[tables->groups[r]] = COTREE_FMAX(longest[tables->groups[r]], COTREE_SQRT(square));
    }
    for (r = 0; r < tables->n_rows; ++r) {
        const cotree_real unit = longest[tables->groups[r]];
        for (i = 0; i < N_SPEEDS && unit > COTREE_F(0.0); ++i)
            a->least.rows[r * N_SPEEDS + i] /= unit;
    }
    return 0;
}

/* Compute the smallest singular value of the scaled gradients. */
static int find_smallest(cotree_assembly *a, cotree_real t, const cotree_real *x,
                         cotree_real *smallest)
{
    const int status = load_gradients(a, t, x);
    if (status != 0) return status;
    cotree_least_factorise(&a->least, a->tables->n_rows, COTREE_F(0.0));
    *smallest = cotree_least_smallest(&a->least, a->values);
    return 0;
}

/* Compute the singular value below which constraints count as nearly dependent. */
static int find_weakest(cotree_assembly *a, cotree_real t, const cotree_real *x,
                        cotree_real *weakest)
{
    cotree_real other = COTREE_F(0.0);
    int k, status = 0;
    *weakest = LEAST_GAP;
    for (k = 0; k < POSITIONS && status == 0; ++k) {
        status = rotate_joints(a, x, k);
        if (status == 0) status = find_smallest(a, t, a->trial, &other);
        if (status == 0) *weakest = COTREE_FMAX(*weakest, NEARLY * other);
    }
    return status;
}

int cotree_assembly_is_dependent(cotree_assembly *a, cotree_real t, const cotree_real *x)
{
    cotree_real here = COTREE_F(0.0), weakest = COTREE_F(0.0);
    int status;
    if (a->tables->n_rows == 0) return 0;
    status = cotree_assembly_measure(a, t, x);
    if (status == 0) status = find_smallest(a, t, x, &here);
    if (here > NEARLY) return 0; /* independent: `weakest` is at most NEARLY */
    if (status == 0) status = find_weakest(a, t, x, &weakest);
    return status != 0 || here <= weakest;
}

#if COTREE_HAS_MENDING
int cotree_assembly_gradients(cotree_assembly *a, cotree_real t, const cotree_real *x,
                              cotree_real *rows, cotree_real *weakest)
{
    int i, status = cotree_assembly_measure(a, t, x);
    if (status == 0) status = find_weakest(a, t, x, weakest);
    if (status == 0) status = load_gradients(a, t, x);
    for (i = 0; i < a->tables->n_rows * N_SPEEDS && status == 0; ++i) rows[i] = a->least.rows[i];
    return status;
}
#endif

int cotree_assembly_measure(cotree_assembly *a, cotree_real t, const cotree_real *x)
{
    const int n = POSITIONS * a->tables->n_groups;
    cotree_real *const turned = a->parts, *const shifted = turned + n, *const sorted = shifted + n;
    cotree_real far = COTREE_F(0.0), lever = COTREE_F(0.0), found;
    int i, k, status;
    a->length = COTREE_F(1.0);
    if (n == 0) return 0;
    for (i = 0; i < 2 * n; ++i) turned[i] = COTREE_F(0.0);
    cotree_assembly_list_rows(a, 0, 1);
    status = cotree_assembly_compute_residuals(a, t, x, &found);
    for (i = 0; i < a->n_own; ++i) {
        if (cotree_assembly_is_length(a, a->places[i]))
            far = COTREE_FMAX(far, COTREE_FABS(a->values[i]));
    }
    for (i = 0; i < N_COORDINATES; ++i) {
        if (cotree_assembly_is_shift(a, i)) far = COTREE_FMAX(far, COTREE_FABS(x[i]));
    }
    for (k = 0; k < POSITIONS && status == 0; ++k) {
        status = rotate_joints(a, x, k);
        if (status == 0) status = cotree_assembly_compute_gradients(a, t, a->trial);
        if (status != 0) break;
        add_squares(a, turned + k * a->tables->n_groups, shifted + k * a->tables->n_groups, &lever);
    }
    found = median_ratio(n, turned, shifted, sorted);
    if (!(found > MIN_SQUARE_SHARE * far)) {
        found = COTREE_FMAX(lever, far);
        if (!(found > MIN_LENGTH)) found = COTREE_F(1.0);
    }
    a->length = found;
    return status;
}
