/* cotree_history.c: Hermite's interpolation through several steps.
 * Part of the runtime of cotree, the same for every model.
 */
#include "cotree_history.h"

#include <float.h>
#include <math.h>

void cotree_history_init(cotree_history *h, int n, cotree_real *workspace)
{
    int i;
    h->n = n;
    h->n_points = 0;
    h->uses_rates = 1;
    for (i = 0; i < COTREE_HISTORY_POINTS; ++i) {
        h->y[i] = workspace + 2 * i * n;
        h->rate[i] = workspace + (2 * i + 1) * n;
    }
}

/* Sums of one over the distances to other points, and products of these. */
static void weigh(cotree_history *h)
{
    int i, j;
    for (i = 0; i < h->n_points; ++i) {
        cotree_real slope = COTREE_F(0.0), weight = COTREE_F(1.0);
        for (j = 0; j < i; ++j) {
            const cotree_real inverse = h->inverse[i][j];
            slope += inverse;
            weight *= inverse;
            h->slopes[j] -= inverse;
            h->weights[j] *= -inverse;
        }
        h->slopes[i] = slope;
        h->weights[i] = weight;
    }
}

/* The oldest point makes room for a new one. */
static void forget_first(cotree_history *h)
{
    cotree_real *const first_y = h->y[0], *const first_rate = h->rate[0];
    const int last = COTREE_HISTORY_POINTS - 1;
    int i, j;
    for (i = 0; i < last; ++i) {
        h->t[i] = h->t[i + 1];
        h->y[i] = h->y[i + 1];
        h->rate[i] = h->rate[i + 1];
        for (j = 0; j < i; ++j) h->inverse[i][j] = h->inverse[i + 1][j + 1];
    }
    h->y[last] = first_y;
    h->rate[last] = first_rate;
    h->n_points = last;
}

void cotree_history_add(cotree_history *h, cotree_real t, const cotree_real *y,
                        const cotree_real *rate)
{
    int i, last;
    if (h->n_points == COTREE_HISTORY_POINTS) forget_first(h);
    last = h->n_points;
    h->t[last] = t;
    for (i = 0; i < last; ++i) h->inverse[last][i] = COTREE_F(1.0) / (t - h->t[i]);
    for (i = 0; i < h->n; ++i) {
        h->y[last][i] = y[i];
        h->rate[last][i] = rate[i];
    }
    h->n_points = last + 1;
    weigh(h);
}

/* Writes each point's basis function, of degree m - 1, at a time. */
static void find_basis(const cotree_history *h, cotree_real t, cotree_real *basis)
{
    cotree_real product = COTREE_F(1.0);
    int i;
    for (i = 0; i < h->n_points; ++i) {
        basis[i] = h->weights[i] * product;
        product *= t - h->t[i];
    }
    product = COTREE_F(1.0);
    for (i = h->n_points - 1; i >= 0; --i) {
        basis[i] *= product;
        product *= t - h->t[i];
    }
}

/* What the value and the rate of one point are multiplied with. */
typedef struct portion {
    cotree_real of_y, of_rate;
} portion;

static portion portion_of(const cotree_history *h, cotree_real basis, cotree_real slope,
                          cotree_real distance)
{
    portion s;
    s.of_y =
        h->uses_rates ? basis * basis * (COTREE_F(1.0) - COTREE_F(2.0) * distance * slope) : basis;
    s.of_rate = basis * basis * distance;
    return s;
}

/* Adds what one point contributes to the difference from the last one: what stays the same, as
 * modes do, is read without rounding, however large the portions are. */
static void contribute(const cotree_history *h, int i, portion s, cotree_real *COTREE_RESTRICT y)
{
    const cotree_real *COTREE_RESTRICT const own = h->y[i],
                                             *COTREE_RESTRICT const rate = h->rate[i];
    const cotree_real *COTREE_RESTRICT const last = h->y[h->n_points - 1];
    const int n = h->n;
    int m;
    if (own == last) {
        for (m = 0; m < n && h->uses_rates; ++m) y[m] += s.of_rate * rate[m];
    } else if (!h->uses_rates) {
        for (m = 0; m < n; ++m) y[m] += s.of_y * (own[m] - last[m]);
    } else {
        for (m = 0; m < n; ++m) y[m] += s.of_y * (own[m] - last[m]) + s.of_rate * rate[m];
    }
}

void cotree_history_read(const cotree_history *h, cotree_real t, cotree_real *y)
{
    cotree_real basis[COTREE_HISTORY_POINTS];
    int i, m;
    find_basis(h, t, basis);
    for (m = 0; m < h->n; ++m) y[m] = h->y[h->n_points - 1][m];
    for (i = 0; i < h->n_points; ++i) {
        contribute(h, i, portion_of(h, basis[i], h->slopes[i], t - h->t[i]), y);
    }
}

/* Writes how far the polynomial without the point farthest from a time is from it there. */
static void find_doubt(const cotree_history *h, cotree_real t, cotree_real *difference)
{
    const int last = h->n_points - 1;
    const int left_out = COTREE_FABS(h->t[0] - t) > COTREE_FABS(h->t[last] - t) ? 0 : last;
    const cotree_real farthest = t - h->t[left_out];
    cotree_real basis[COTREE_HISTORY_POINTS];
    int i, m;
    find_basis(h, t, basis);
    for (m = 0; m < h->n; ++m) difference[m] = COTREE_F(0.0);
    for (i = 0; i < h->n_points; ++i) {
        const cotree_real gap = h->t[i] - h->t[left_out], distance = t - h->t[i];
        portion with = portion_of(h, basis[i], h->slopes[i], distance);
        if (i != left_out) {
            const portion without = portion_of(h, basis[i] * (gap / farthest),
                                               h->slopes[i] - COTREE_F(1.0) / gap, distance);
            with.of_y -= without.of_y;
            with.of_rate -= without.of_rate;
        }
        contribute(h, i, with, difference);
    }
}

cotree_real cotree_history_error(const cotree_history *h, int interval, cotree_real rtol,
                                 const cotree_real *atols, int first_left_out, int n_left_out,
                                 cotree_real *scratch)
{
    const cotree_real *const a = h->y[interval], *const b = h->y[interval + 1];
    cotree_real sum = COTREE_F(0.0);
    int i;
    find_doubt(h, COTREE_F(0.5) * (h->t[interval] + h->t[interval + 1]), scratch);
    for (i = 0; i < h->n; ++i) {
        const cotree_real size = COTREE_FMAX(COTREE_FABS(a[i]), COTREE_FABS(b[i]));
        const cotree_real share = scratch[i] / (atols[i] + rtol * size + COTREE_MIN);
        if (i < first_left_out || i >= first_left_out + n_left_out) sum += share * share;
    }
    return h->n > 0 ? COTREE_SQRT(sum / (cotree_real)h->n) : COTREE_F(0.0);
}
