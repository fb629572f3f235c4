/* cotree_lanes.h: several members of an ensemble at once, one in each lane of a vector.
 *
 * Each SIMD lane has its own steps and error control; its results do not depend on the other
 * lanes. When a member ends, the next one starts in its lane. Scalar code runs a member again from
 * its start if it needs more than plain steps. */
#ifndef COTREE_LANES_H
#define COTREE_LANES_H

#include <stddef.h>

struct cotree_worker;

typedef struct cotree_lanes {
    int n_lanes;
    size_t n_bytes; /* memory of each worker, zero at the start and aligned to 64 bytes */
    int (*work)(struct cotree_worker *worker); /* runs members in lanes, see cotree_batch */
} cotree_lanes;

#endif
