/* cotree_lanes.h: members of an ensemble side by side, each in a lane of vectors.
 * Part of the runtime of cotree, the same for every model.
 *
 * A lane takes steps of its own, with its own error test; what it computes depends on no other. One
 * that ends takes the next member at once. A member that meets anything unusual leaves its lane, to
 * be run by itself from its start.
 */
#ifndef COTREE_LANES_H
#define COTREE_LANES_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* cotree: begin of the part that cffi reads */
struct cotree_worker;

typedef struct cotree_lanes {
    int n_lanes;
    size_t n_bytes; /* of what a worker owns for it: zeros at first, from a multiple of 64 on */
    int (*work)(struct cotree_worker *worker); /* as lanes of cotree_batch */
} cotree_lanes;
/* cotree: end of the part that cffi reads */

#ifdef __cplusplus
}
#endif

#endif
