/* fmu_states.h: states of an instance that an importer keeps, also as bytes; and checks of
 * arguments. Part of the runtime of cotree, the same for every model.
 *
 * Both versions of the interface call these. Functions return 0 on success, and 1 after they have
 * logged what is wrong; "function" is the name of the caller in that message.
 */
#ifndef COTREE_FMU_STATES_H
#define COTREE_FMU_STATES_H

#include "fmu.h"

#include <stddef.h>

/* The states that an importer keeps of an instance. A pointer to other memory, such as that of a
 * freed state, is refused before it is read. */
typedef struct fmu_states {
    struct fmu_state **at;
    size_t n, n_places;
} fmu_states;

/* Copies the present state to that of *place; if *place is NULL, to a new one. */
int fmu_states_keep(fmu *m, fmu_states *kept, const char *function, void **place);
int fmu_states_recall(fmu *m, const fmu_states *kept, const char *function, const void *from);
int fmu_states_free(fmu *m, fmu_states *kept, const char *function, void **place);
void fmu_states_free_all(fmu_states *kept);

/* The number of bytes of a state; a state to bytes, and the other way. */
int fmu_states_size(fmu *m, const fmu_states *kept, const char *function, const void *from,
                    size_t *n);
int fmu_states_write(fmu *m, const fmu_states *kept, const char *function, const void *from,
                     void *bytes, size_t n);
int fmu_states_read(fmu *m, fmu_states *kept, const char *function, const void *bytes, size_t n,
                    void **place);

/* Refuses a null pointer. */
int fmu_check_pointer(const fmu *m, const char *function, const void *pointer);

/* The log category of messages of a severity, and whether there is one of a name. */
const char *fmu_category_of(enum fmu_severity severity);
int fmu_is_category(const char *name);

#endif
