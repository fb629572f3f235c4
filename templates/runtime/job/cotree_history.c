/* cotree_history.c: Hermite interpolation through the end points of several steps. */
#include "cotree_history.h"

typedef cotree_history cotree_points;
#include "cotree_interpolation.h"

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

static void remove_oldest(cotree_history *h)
{
    cotree_real *const first_y = h->y[0], *const first_rate = h->rate[0];
    const int last = COTREE_HISTORY_POINTS - 1;
    int i;
    cotree_points_shift(h, 1);
    for (i = 0; i < last; ++i) {
        h->y[i] = h->y[i + 1];
        h->rate[i] = h->rate[i + 1];
    }
    h->y[last] = first_y;
    h->rate[last] = first_rate;
    h->n_points = last;
}

void cotree_history_add(cotree_history *h, cotree_real t, const cotree_real *y,
                        const cotree_real *rate)
{
    int i, last;
    if (h->n_points == COTREE_HISTORY_POINTS) remove_oldest(h);
    last = h->n_points;
    cotree_points_set(h, 1, last, t);
    for (i = 0; i < h->n; ++i) {
        h->y[last][i] = y[i];
        h->rate[last][i] = rate[i];
    }
    h->n_points = last + 1;
    for (i = 0; i < h->n_points; ++i) cotree_points_weigh(h, h->n_points, h->uses_rates, i);
}

/* Add the contributions of all points to y, as differences from the last point. Constant entries,
 * such as modes, are then interpolated exactly, even if factors are large. */
static void add_contributions(const cotree_history *h, const cotree_portions *of,
                              cotree_real *COTREE_RESTRICT y)
{
    const cotree_real *COTREE_RESTRICT const last = h->y[h->n_points - 1];
    const int n = h->n;
    int i, m;
    if (h->uses_rates && h->n_points == COTREE_HISTORY_POINTS) {
#define POINT(i) (of->of_y[i] * (h->y[i][m] - last[m]) + of->of_rate[i] * h->rate[i][m])
        for (m = 0; m < n; ++m) { /* one pass, which compilers vectorise */
            y[m] = y[m] + POINT(0) + POINT(1) + POINT(2) + POINT(3) + POINT(4) +
                   of->of_rate[5] * h->rate[5][m];
        }
#undef POINT
        return;
    }
    for (i = 0; i < h->n_points; ++i) {
        const cotree_real *COTREE_RESTRICT const own = h->y[i],
                                                 *COTREE_RESTRICT const rate = h->rate[i];
        const cotree_real of_y = of->of_y[i];
        const cotree_real of_rate = h->uses_rates ? of->of_rate[i] : COTREE_F(0.0);
        if (own == last) {
            for (m = 0; m < n && h->uses_rates; ++m) y[m] += of_rate * rate[m];
        } else if (!h->uses_rates) {
            for (m = 0; m < n; ++m) y[m] += of_y * (own[m] - last[m]);
        } else {
            for (m = 0; m < n; ++m) y[m] += of_y * (own[m] - last[m]) + of_rate * rate[m];
        }
    }
}

void cotree_history_read(const cotree_history *h, cotree_real t, cotree_real *y)
{
    cotree_portions of;
    int m;
    cotree_find_portions(h, h->n_points, h->uses_rates, t, &of);
    for (m = 0; m < h->n; ++m) y[m] = h->y[h->n_points - 1][m];
    add_contributions(h, &of, y);
}

void cotree_history_portions(const cotree_history *h, cotree_real t, cotree_real *of_y,
                             cotree_real *of_rate)
{
    cotree_portions of;
    int i;
    cotree_find_portions(h, h->n_points, h->uses_rates, t, &of);
    for (i = 0; i < h->n_points; ++i) {
        of_y[i] = of.of_y[i];
        of_rate[i] = h->uses_rates ? of.of_rate[i] : COTREE_F(0.0);
    }
}

cotree_real cotree_history_error(const cotree_history *h, int interval, cotree_real rtol,
                                 const cotree_real *atols, int first_left_out, int n_left_out,
                                 cotree_real *scratch)
{
    const cotree_real *const a = h->y[interval], *const b = h->y[interval + 1];
    const cotree_real middle = COTREE_F(0.5) * (h->t[interval] + h->t[interval + 1]);
    cotree_real sum = COTREE_F(0.0);
    cotree_portions of;
    int i;
    cotree_find_differences(h, h->n_points, h->uses_rates, middle, &of);
    for (i = 0; i < h->n; ++i) scratch[i] = COTREE_F(0.0);
    add_contributions(h, &of, scratch);
    for (i = 0; i < h->n; ++i) {
        const cotree_real size = cotree_larger(cotree_abs(a[i]), cotree_abs(b[i]));
        const cotree_real share = scratch[i] / (atols[i] + rtol * size + COTREE_MIN);
        if (i < first_left_out || i >= first_left_out + n_left_out) sum += share * share;
    }
    return h->n > 0 ? COTREE_SQRT(sum / (cotree_real)h->n) : COTREE_F(0.0);
}
