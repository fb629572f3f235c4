/* cotree_sine_polynomials.h: sine and cosine of reduced angles, in the lanes of a vector.
 *
 * The file is included once for each vector width. The including file defines VECTOR, BITS (the
 * vector of 64-bit integers with the same number of lanes), NAMED(f) for the name of f, and
 * SINE_QUALIFIERS, the qualifiers of the function.
 *
 * Angles are reduced by multiples of pi/2 in three parts; the polynomials are those of fdlibm (Sun
 * Microsystems, 1993). Errors are below 0.8 units in the last place for angles up to 1e6. */

/* Compute the sine and the cosine of x reduced to at most pi/4. The last two bits of *quarter are
 * the number of quarter turns subtracted, modulo 4. */
SINE_QUALIFIERS void NAMED(cotree_reduced_sine)(const VECTOR *x, BITS *quarter, VECTOR *to_sine,
                                                VECTOR *to_cosine)
{
    const double rounder =
        6755399441055744.0; /* 1.5 * 2^52: adding this number rounds to an integer */
    VECTOR turns, k, whole, part, y, tail, z, w, half, near, low, high, sine;
    turns = *x * 6.36619772367581382433e-01 + rounder;
    *quarter = (BITS)turns; /* only the last two bits of the quarter number are used */
    k = turns - rounder;
    whole = *x - k * 1.57079632673412561417e+00;
    part = k * 6.07710050630396597660e-11;
    y = whole - part; /* the reduced angle is y + tail; tail is included to first order */
    tail = ((whole - y) - part) - k * 2.02226624879595063154e-21;
    z = y * y;
    w = z * z;
    half = 0.5 * z;
    near = 1.0 - half;
    low = z * (z * 2.75573137070700676789e-06 - 1.98412698298579493134e-04) +
          8.33333333332248946124e-03;
    high = z * 1.58969099521155010221e-10 - 2.50507602534068634195e-08;
    sine = z * (z * w * high + low) - 1.66666666666666324348e-01;
    *to_sine = y + (z * y * sine + (near + w * 4.16666666666666019037e-02) * tail);
    low = z * (z * 2.48015872894767294178e-05 - 1.38888888888741095749e-03) +
          4.16666666666666019037e-02;
    high = z * (z * -1.13596475577881948265e-11 + 2.08757232129817482790e-09) -
           2.75573143513906633035e-07;
    *to_cosine = near + (((1.0 - near) - half) + (w * (z * w * high + low) -
                                                  (y - z * y * 1.66666666666666324348e-01) * tail));
}
