/* fmu_states.h: saved states of an instance, also as bytes, and checks of arguments.
 * Part of the runtime of cotree, the same for every model.
 *
 * Both versions of the interface use these functions. They return 0, or 1 after logging an
 * error; "function" is the name of the caller in that message. */
#ifndef COTREE_FMU_STATES_H
#define COTREE_FMU_STATES_H

#include "fmu.h"

#include <stddef.h>

/* The saved states of an instance. Pointers to other memory, such as that of a freed state, are
 * rejected before they are read. */
typedef struct fmu_states {
    struct fmu_state **at;
    size_t n, n_places;
} fmu_states;

/* Copy the present state to that of *place, or to a new one if *place is NULL. Restore a state.
 * Free one, or all. */
int fmu_states_save(fmu *m, fmu_states *kept, const char *function, void **place);
int fmu_states_restore(fmu *m, const fmu_states *kept, const char *function, const void *from);
int fmu_states_free(fmu *m, fmu_states *kept, const char *function, void **place);
void fmu_states_free_all(fmu_states *kept);

/* Compute the number of bytes of a state. Write a state to bytes, or read it. */
int fmu_states_size(fmu *m, const fmu_states *kept, const char *function, const void *from,
                    size_t *n);
int fmu_states_write(fmu *m, const fmu_states *kept, const char *function, const void *from,
                     void *bytes, size_t n);
int fmu_states_read(fmu *m, fmu_states *kept, const char *function, const void *bytes, size_t n,
                    void **place);

/* Reject a null pointer. */
int fmu_check_pointer(const fmu *m, const char *function, const void *pointer);

/* Return the log category of a severity, and whether a category has a name. */
const char *fmu_category_of(enum fmu_severity severity);
int fmu_is_category(const char *name);

#endif
