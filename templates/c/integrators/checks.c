static int is_finite(cotree_real value) { return COTREE_FABS(value) <= COTREE_MAX; }

static int are_finite(int n, const cotree_real *v)
{
    int i;
    for (i = 0; i < n; ++i) {
        if (!is_finite(v[i])) return 0;
    }
    return 1;
}

static cotree_status status_of(int result)
{
    return result == 0 ? COTREE_OK : result < 0 ? COTREE_RATE_STOPPED : COTREE_RATE_FAILED;
}
