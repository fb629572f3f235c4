/* cotree_lanes.h: members of an ensemble in the lanes of vectors.
 *
 * Each lane has steps and an error control of its own, and its results depend on no other lane.
 * A lane whose member ends takes the next one at once. A member that needs anything else than
 * steps leaves its lane, and is run alone from its start. */
#ifndef COTREE_LANES_H
#define COTREE_LANES_H

#include <stddef.h>

struct cotree_worker;

typedef struct cotree_lanes {
    int n_lanes;
    size_t n_bytes; /* memory of each worker: zero at the start, aligned to 64 bytes */
    int (*work)(struct cotree_worker *worker); /* the lanes of a cotree_batch */
} cotree_lanes;

#endif
