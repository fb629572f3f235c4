/* cotree_iteration.c: damped Newton iteration. */
#include "cotree_iteration.h"

/* Take the largest fraction of a Newton step that passes the monotonicity test. *is_last: 1 if the
 * step is at rounding level. */
static int take_damped(const cotree_iteration *a, int *is_last)
{
    const cotree_newton_limits *const limits = a->limits;
    cotree_real share = COTREE_F(1.0), after = COTREE_F(0.0);
    for (;;) {
        int status = a->move(a, share);
        if (status == 0 && !*is_last) status = a->step(a, 0, &after);
        if (status != 0 || after <= (COTREE_F(1.0) - COTREE_F(0.25) * share) * a->size)
            return status;
        if (share == COTREE_F(1.0) && a->size <= limits->stalled && after <= limits->stalled)
            *is_last = 1;
        if (*is_last) return 0;
        if (share < limits->min_share) return COTREE_NO_STEP;
        share *= COTREE_F(0.5);
    }
}

int cotree_iterate(cotree_iteration *a)
{
    const cotree_newton_limits *const limits = a->limits;
    cotree_real before = COTREE_INFINITY;
    int n;
    for (n = 0; n < limits->max_steps; ++n) {
        int status = a->step(a, 1, &a->size);
        int is_last = a->size <= limits->rounding ||
                      (a->size < limits->small && a->size > COTREE_F(0.5) * before);
        if (status == 0 && a->move != NULL) status = take_damped(a, &is_last);
        if (status != 0 || is_last) return status;
        before = a->size;
    }
    return COTREE_NO_STEP;
}
