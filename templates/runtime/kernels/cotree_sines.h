/* cotree_sines.h: sines and cosines of arrays of angles.
 *
 * The file is included once for each vector width. The including file defines LANES, VECTOR,
 * EACH(f), NAMED(f), TARGET and LEAVE as in a model's _vectors.h. */
#if LANES > 1
typedef unsigned long long NAMED(bits) __attribute__((vector_size(8 * LANES)));
#define BITS NAMED(bits)
#define SINE_QUALIFIERS TARGET static inline __attribute__((always_inline))
#include "cotree_sine_polynomials.h"
#undef SINE_QUALIFIERS
#endif

/* Compute sines and cosines of n angles. All three arrays are padded to whole vectors. If an angle
 * is beyond 1e6 or not finite, the C library computes all of them. */
TARGET static void NAMED(cotree_sines)(int n, const cotree_real *angles, cotree_real *sines,
                                       cotree_real *cosines)
{
    int i;
#if LANES > 1
#define ANGLE(lane) angles[first + (lane)]
    int first;
    for (i = 0; i < n && COTREE_FABS(angles[i]) <= 1e6; ++i) {
    }
    if (i == n) {
        for (first = 0; first < n; first += LANES) {
            VECTOR sine, cosine;
            BITS quarter, is_odd, a, b;
            /* Assemble the vector from scalars, which were just written one by one: a vector load
             * would stall. */
            const VECTOR x = {EACH(ANGLE)};
            NAMED(cotree_reduced_sine)(&x, &quarter, &sine, &cosine);
            is_odd = -(quarter & 1);
            a = (is_odd & (BITS)cosine) | (~is_odd & (BITS)sine);
            b = (is_odd & (BITS)sine) | (~is_odd & (BITS)cosine);
            a ^= (quarter & 2) << 62;
            b ^= ((quarter + 1) & 2) << 62;
            memcpy(sines + first, &a, sizeof a);
            memcpy(cosines + first, &b, sizeof b);
        }
        LEAVE;
        return;
    }
#undef ANGLE
#undef BITS
#endif
    LEAVE;
    for (i = 0; i < n; ++i) {
        sines[i] = COTREE_SIN(angles[i]);
        cosines[i] = COTREE_COS(angles[i]);
    }
}
