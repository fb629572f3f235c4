/* cotree_real.h: floating-point type with its literals, functions and limits; compiled features;
 * compiler-specific qualifiers.
 *
 * Files whose names begin with cotree_ are the runtime of cotree, the same for every model. */
#ifndef COTREE_REAL_H
#define COTREE_REAL_H

#include <float.h>
#include <math.h>
#include <stdlib.h>

/* COTREE_F(x): literal of the floating-point type, or name of its version of a C library function.
 * COTREE_SELECT(a, b): a in double precision, b in single precision. */
typedef double cotree_real;
#define COTREE_F(x) x
#define COTREE_SELECT(in_double, in_single) in_double
#define COTREE_LIMIT(name) DBL_##name
#define COTREE_INFINITY HUGE_VAL
#define COTREE_STRTOD strtod
#define COTREE_EPSILON COTREE_LIMIT(EPSILON)
#define COTREE_MIN COTREE_LIMIT(MIN)
#define COTREE_MAX COTREE_LIMIT(MAX)
#define COTREE_MANT_DIG COTREE_LIMIT(MANT_DIG)
#define COTREE_EXP COTREE_F(exp)
#define COTREE_FABS COTREE_F(fabs)
#define COTREE_FLOOR COTREE_F(floor)
#define COTREE_FMAX COTREE_F(fmax)
#define COTREE_FMIN COTREE_F(fmin)
#define COTREE_FMOD COTREE_F(fmod)
#define COTREE_LOG COTREE_F(log)
#define COTREE_SIN COTREE_F(sin)
#define COTREE_COS COTREE_F(cos)
#define COTREE_SQRT COTREE_F(sqrt)
#define COTREE_NEXTAFTER COTREE_F(nextafter)

/* Declarations between these macros have C linkage in C++. */
#ifdef __cplusplus
#define COTREE_BEGIN_DECLS extern "C" {
#define COTREE_END_DECLS }
#else
#define COTREE_BEGIN_DECLS
#define COTREE_END_DECLS
#endif

#if defined(__STDC_VERSION__) && __STDC_VERSION__ >= 199901L
#define COTREE_RESTRICT restrict
#else
#define COTREE_RESTRICT
#endif

/* Long kernels are divided into blocks that are not inlined: a single function would take too long
 * to compile. */
#if defined(__GNUC__) || defined(__clang__)
#define COTREE_APART __attribute__((noinline))
#elif defined(_MSC_VER)
#define COTREE_APART __declspec(noinline)
#else
#define COTREE_APART
#endif

/* Alignment of arrays that are loaded into vectors. */
#if defined(__GNUC__) || defined(__clang__)
#define COTREE_ALIGNED __attribute__((aligned(64)))
#else
#define COTREE_ALIGNED
#endif

#if defined(_WIN32)
#define COTREE_EXPORT __declspec(dllexport)
#else
#define COTREE_EXPORT
#endif

/* Functions that only the runtime calls: static if the whole runtime is compiled as one file. */
#ifndef COTREE_PRIVATE
#define COTREE_PRIVATE
#endif

#endif
