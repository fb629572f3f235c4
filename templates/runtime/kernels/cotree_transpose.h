/* cotree_transpose.h: transposition of square blocks of LANES vectors.
 *
 * TRANSPOSE(LOAD, STORE) gathers lane i of the vectors LOAD(0) to LOAD(LANES - 1) in one vector
 * and calls STORE(i, vector). The last lane is stored first, so that the first one prevails if
 * several lanes have the same target. TRANSPOSE is undefined if the compiler has no shuffles.
 *
 * The file is included once for each vector width. The including file defines LANES and VECTOR. */
#ifdef __has_builtin
#if __has_builtin(__builtin_shufflevector)
#if LANES == 8
#define TRANSPOSE(LOAD, STORE)                                                                     \
    do {                                                                                           \
        const VECTOR a0_0 = LOAD(0), a0_1 = LOAD(1), a0_2 = LOAD(2), a0_3 = LOAD(3),               \
                     a0_4 = LOAD(4), a0_5 = LOAD(5), a0_6 = LOAD(6), a0_7 = LOAD(7);               \
        const VECTOR a1_0 = __builtin_shufflevector(a0_0, a0_1, 0, 8, 2, 10, 4, 12, 6, 14);        \
        const VECTOR a1_1 = __builtin_shufflevector(a0_0, a0_1, 1, 9, 3, 11, 5, 13, 7, 15);        \
        const VECTOR a1_2 = __builtin_shufflevector(a0_2, a0_3, 0, 8, 2, 10, 4, 12, 6, 14);        \
        const VECTOR a1_3 = __builtin_shufflevector(a0_2, a0_3, 1, 9, 3, 11, 5, 13, 7, 15);        \
        const VECTOR a1_4 = __builtin_shufflevector(a0_4, a0_5, 0, 8, 2, 10, 4, 12, 6, 14);        \
        const VECTOR a1_5 = __builtin_shufflevector(a0_4, a0_5, 1, 9, 3, 11, 5, 13, 7, 15);        \
        const VECTOR a1_6 = __builtin_shufflevector(a0_6, a0_7, 0, 8, 2, 10, 4, 12, 6, 14);        \
        const VECTOR a1_7 = __builtin_shufflevector(a0_6, a0_7, 1, 9, 3, 11, 5, 13, 7, 15);        \
        const VECTOR a2_0 = __builtin_shufflevector(a1_0, a1_2, 0, 1, 8, 9, 4, 5, 12, 13);         \
        const VECTOR a2_1 = __builtin_shufflevector(a1_1, a1_3, 0, 1, 8, 9, 4, 5, 12, 13);         \
        const VECTOR a2_2 = __builtin_shufflevector(a1_0, a1_2, 2, 3, 10, 11, 6, 7, 14, 15);       \
        const VECTOR a2_3 = __builtin_shufflevector(a1_1, a1_3, 2, 3, 10, 11, 6, 7, 14, 15);       \
        const VECTOR a2_4 = __builtin_shufflevector(a1_4, a1_6, 0, 1, 8, 9, 4, 5, 12, 13);         \
        const VECTOR a2_5 = __builtin_shufflevector(a1_5, a1_7, 0, 1, 8, 9, 4, 5, 12, 13);         \
        const VECTOR a2_6 = __builtin_shufflevector(a1_4, a1_6, 2, 3, 10, 11, 6, 7, 14, 15);       \
        const VECTOR a2_7 = __builtin_shufflevector(a1_5, a1_7, 2, 3, 10, 11, 6, 7, 14, 15);       \
        const VECTOR a3_0 = __builtin_shufflevector(a2_0, a2_4, 0, 1, 2, 3, 8, 9, 10, 11);         \
        const VECTOR a3_1 = __builtin_shufflevector(a2_1, a2_5, 0, 1, 2, 3, 8, 9, 10, 11);         \
        const VECTOR a3_2 = __builtin_shufflevector(a2_2, a2_6, 0, 1, 2, 3, 8, 9, 10, 11);         \
        const VECTOR a3_3 = __builtin_shufflevector(a2_3, a2_7, 0, 1, 2, 3, 8, 9, 10, 11);         \
        const VECTOR a3_4 = __builtin_shufflevector(a2_0, a2_4, 4, 5, 6, 7, 12, 13, 14, 15);       \
        const VECTOR a3_5 = __builtin_shufflevector(a2_1, a2_5, 4, 5, 6, 7, 12, 13, 14, 15);       \
        const VECTOR a3_6 = __builtin_shufflevector(a2_2, a2_6, 4, 5, 6, 7, 12, 13, 14, 15);       \
        const VECTOR a3_7 = __builtin_shufflevector(a2_3, a2_7, 4, 5, 6, 7, 12, 13, 14, 15);       \
        STORE(7, a3_7);                                                                            \
        STORE(6, a3_6);                                                                            \
        STORE(5, a3_5);                                                                            \
        STORE(4, a3_4);                                                                            \
        STORE(3, a3_3);                                                                            \
        STORE(2, a3_2);                                                                            \
        STORE(1, a3_1);                                                                            \
        STORE(0, a3_0);                                                                            \
    } while (0)
#elif LANES == 4
#define TRANSPOSE(LOAD, STORE)                                                                     \
    do {                                                                                           \
        const VECTOR a0_0 = LOAD(0), a0_1 = LOAD(1), a0_2 = LOAD(2), a0_3 = LOAD(3);               \
        const VECTOR a1_0 = __builtin_shufflevector(a0_0, a0_1, 0, 4, 2, 6);                       \
        const VECTOR a1_1 = __builtin_shufflevector(a0_0, a0_1, 1, 5, 3, 7);                       \
        const VECTOR a1_2 = __builtin_shufflevector(a0_2, a0_3, 0, 4, 2, 6);                       \
        const VECTOR a1_3 = __builtin_shufflevector(a0_2, a0_3, 1, 5, 3, 7);                       \
        const VECTOR a2_0 = __builtin_shufflevector(a1_0, a1_2, 0, 1, 4, 5);                       \
        const VECTOR a2_1 = __builtin_shufflevector(a1_1, a1_3, 0, 1, 4, 5);                       \
        const VECTOR a2_2 = __builtin_shufflevector(a1_0, a1_2, 2, 3, 6, 7);                       \
        const VECTOR a2_3 = __builtin_shufflevector(a1_1, a1_3, 2, 3, 6, 7);                       \
        STORE(3, a2_3);                                                                            \
        STORE(2, a2_2);                                                                            \
        STORE(1, a2_1);                                                                            \
        STORE(0, a2_0);                                                                            \
    } while (0)
#elif LANES == 2
#define TRANSPOSE(LOAD, STORE)                                                                     \
    do {                                                                                           \
        const VECTOR a0_0 = LOAD(0), a0_1 = LOAD(1);                                               \
        const VECTOR a1_0 = __builtin_shufflevector(a0_0, a0_1, 0, 2);                             \
        const VECTOR a1_1 = __builtin_shufflevector(a0_0, a0_1, 1, 3);                             \
        STORE(1, a1_1);                                                                            \
        STORE(0, a1_0);                                                                            \
    } while (0)
#endif
#endif
#endif
