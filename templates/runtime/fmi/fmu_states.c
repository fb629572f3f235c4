/* fmu_states.c: saved states of an instance, also as bytes, and checks of arguments.
 * Part of the runtime of cotree, the same for every model. */
#include "fmu_states.h"

#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* Head of a state that another instance may read. */
#define MAGIC 0x46746f63

typedef struct fmu_state_head {
    unsigned magic, n;
    unsigned long long checksum; /* of the bytes after it; set when the state is serialized */
    char token[64];
} fmu_state_head;

/* A state: its head, then n doubles. */
typedef struct fmu_state {
    fmu_state_head head;
    double values[];
} fmu_state;

static size_t size_of_state(const fmu *m)
{
    return sizeof(fmu_state) + fmu_state_size(m) * sizeof(double);
}

static void write_state(const fmu *m, fmu_state *to)
{
    memset(&to->head, 0, sizeof(to->head));
    to->head.magic = MAGIC;
    to->head.n = (unsigned)fmu_state_size(m);
    strncpy(to->head.token, m->tables->token, sizeof(to->head.token) - 1);
    fmu_save_state(m, to->values);
}

/* Return the FNV-1a checksum (Fowler, Noll, Vo), which detects damaged bytes. */
static unsigned long long checksum_of(const void *state_bytes, size_t n)
{
    const unsigned char *const own = (const unsigned char *)state_bytes;
    unsigned long long sum = 14695981039346656037ULL;
    size_t i;
    for (i = offsetof(fmu_state_head, token); i < n; ++i) sum = (sum ^ own[i]) * 1099511628211ULL;
    return sum;
}

static int is_state(const fmu *m, const fmu_state_head *head)
{
    return head->magic == MAGIC && head->n == fmu_state_size(m) &&
           strncmp(head->token, m->tables->token, sizeof(head->token) - 1) == 0;
}

/* The log categories of the model description, by severity. */
static const char *const categories[] = {"logEvents", "logStatusDiscard", "logStatusError"};

const char *fmu_category_of(enum fmu_severity severity) { return categories[severity]; }

int fmu_is_category(const char *name)
{
    size_t i;
    for (i = 0; i < sizeof(categories) / sizeof(categories[0]); ++i) {
        if (name != NULL && strcmp(name, categories[i]) == 0) return 1;
    }
    return 0;
}

/* Reject a null pointer. */
int fmu_check_pointer(const fmu *m, const char *function, const void *pointer)
{
    return pointer != NULL ? 0 : fmu_refuse(m, "%s is called with a null pointer", function);
}

/* Return the place of a saved state, or kept->n if there is none. Recent ones are used most
 * often. */
static size_t find_state(const fmu_states *kept, const void *own)
{
    size_t i;
    for (i = kept->n; i > 0; --i) {
        if (kept->at[i - 1] == own) return i - 1;
    }
    return kept->n;
}

/* Reject a pointer that is null or does not point to a saved state. */
static int check_state(const fmu *m, const fmu_states *kept, const char *function, const void *own)
{
    if (fmu_check_pointer(m, function, own) != 0) return 1;
    if (find_state(kept, own) < kept->n) return 0;
    return fmu_refuse(m, "%s: the pointer is not a state of this instance, or the state was freed",
                      function);
}

/* Return memory for a new state, or that of the saved state that *place points to. */
static fmu_state *take_state(fmu *m, fmu_states *kept, const char *function, void **place)
{
    fmu_state *own;
    if (fmu_check_pointer(m, function, place) != 0) return NULL;
    if (*place != NULL)
        return check_state(m, kept, function, *place) == 0 ? (fmu_state *)*place : NULL;
    if (kept->n == kept->n_places) {
        const size_t n = 2 * kept->n + 4;
        fmu_state **const more = (fmu_state **)realloc(kept->at, n * sizeof(fmu_state *));
        if (more == NULL) {
            fmu_refuse(m, "%s: out of memory", function);
            return NULL;
        }
        kept->at = more;
        kept->n_places = n;
    }
    own = (fmu_state *)malloc(size_of_state(m));
    if (own == NULL) {
        fmu_refuse(m, "%s: out of memory", function);
        return NULL;
    }
    kept->at[kept->n++] = own;
    *place = own;
    return own;
}

int fmu_states_save(fmu *m, fmu_states *kept, const char *function, void **place)
{
    fmu_state *const own = take_state(m, kept, function, place);
    if (own == NULL) return 1;
    write_state(m, own);
    return 0;
}

int fmu_states_restore(fmu *m, const fmu_states *kept, const char *function, const void *from)
{
    if (check_state(m, kept, function, from) != 0) return 1;
    return fmu_restore_state(m, ((const fmu_state *)from)->values, fmu_state_size(m));
}

int fmu_states_free(fmu *m, fmu_states *kept, const char *function, void **place)
{
    if (place == NULL || *place == NULL) return 0;
    if (check_state(m, kept, function, *place) != 0) return 1;
    kept->at[find_state(kept, *place)] = kept->at[kept->n - 1];
    --kept->n;
    free(*place);
    *place = NULL;
    return 0;
}

void fmu_states_free_all(fmu_states *kept)
{
    size_t i;
    for (i = 0; i < kept->n; ++i) free(kept->at[i]);
    free(kept->at);
}

int fmu_states_size(fmu *m, const fmu_states *kept, const char *function, const void *from,
                    size_t *n)
{
    if (check_state(m, kept, function, from) != 0 || fmu_check_pointer(m, function, n) != 0)
        return 1;
    *n = size_of_state(m);
    return 0;
}

int fmu_states_write(fmu *m, const fmu_states *kept, const char *function, const void *from,
                     void *bytes, size_t n)
{
    fmu_state_head head;
    if (check_state(m, kept, function, from) != 0 || fmu_check_pointer(m, function, bytes) != 0)
        return 1;
    if (n < size_of_state(m)) {
        return fmu_refuse(m, "%s: a state has %lu bytes, but there is room for %lu", function,
                          (unsigned long)size_of_state(m), (unsigned long)n);
    }
    head = ((const fmu_state *)from)->head;
    head.checksum = checksum_of(from, size_of_state(m));
    memcpy(bytes, from, size_of_state(m));
    memcpy(bytes, &head, sizeof(head));
    return 0;
}

int fmu_states_read(fmu *m, fmu_states *kept, const char *function, const void *bytes, size_t n,
                    void **place)
{
    fmu_state_head head;
    fmu_state *own;
    if (fmu_check_pointer(m, function, bytes) != 0) return 1;
    memset(&head, 0, sizeof(head));
    if (n >= sizeof(head)) memcpy(&head, bytes, sizeof(head));
    if (n != size_of_state(m) || !is_state(m, &head) || head.checksum != checksum_of(bytes, n)) {
        return fmu_refuse(m, "%s: the bytes are not a state of this model", function);
    }
    own = take_state(m, kept, function, place);
    if (own == NULL) return 1;
    memcpy(own, bytes, n);
    return 0;
}
