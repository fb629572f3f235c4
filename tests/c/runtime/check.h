/* check.h: conditions that unit tests of the runtime check; the program returns 1 if one fails. */
#ifndef CHECK_H
#define CHECK_H

#include <math.h>
#include <stdio.h>

static int n_failed = 0;

#define CHECK(condition)                                                    \
    do {                                                                    \
        if (!(condition)) {                                                 \
            fprintf(stderr, "%s:%d: %s\n", __FILE__, __LINE__, #condition); \
            ++n_failed;                                                     \
        }                                                                   \
    } while (0)

/* The absolute difference of two numbers is at most the tolerance. */
#define CHECK_NEAR(value, expected, tolerance)                                                \
    do {                                                                                      \
        const double own_value = (value), own_expected = (expected);                          \
        if (!(fabs(own_value - own_expected) <= (tolerance))) {                               \
            fprintf(stderr, "%s:%d: %s is %.17g, not %.17g\n", __FILE__, __LINE__, #value,    \
                    own_value, own_expected);                                                 \
            ++n_failed;                                                                       \
        }                                                                                     \
    } while (0)

#define RESULT (n_failed == 0 ? 0 : 1)

#endif
