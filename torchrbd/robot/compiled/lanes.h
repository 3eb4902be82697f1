/* Lanes: one sample a lane, as many lanes as the machine's registers hold. GNU vector extensions, as of gcc and clang. */
#ifndef LANES_H
#define LANES_H

#include <math.h>
#include <stdint.h>

#if defined(__AVX512F__)
#define LANES 8
#elif defined(__AVX__)
#define LANES 4
#else
#define LANES 2
#endif

#define INLINE static inline __attribute__((always_inline))

typedef double V __attribute__((vector_size(8 * LANES)));
typedef double Loose __attribute__((vector_size(8 * LANES), aligned(8), may_alias));
typedef int64_t Bits __attribute__((vector_size(8 * LANES)));
typedef struct { V x, y, z; } V3;

INLINE V splat(double x) { return x - (V){0}; }
INLINE V3 splat3(double x, double y, double z) { return (V3){splat(x), splat(y), splat(z)}; }
INLINE V3 zero3(void) { return splat3(0, 0, 0); }
INLINE V3 add(V3 a, V3 b) { return (V3){a.x + b.x, a.y + b.y, a.z + b.z}; }
INLINE V3 sub(V3 a, V3 b) { return (V3){a.x - b.x, a.y - b.y, a.z - b.z}; }
INLINE V3 scale(V s, V3 a) { return (V3){s * a.x, s * a.y, s * a.z}; }
INLINE V dot(V3 a, V3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE V3 cross(V3 a, V3 b) {
    return (V3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* R v and R' v; R by columns. */
INLINE V3 turned(const V3 *R, V3 v) { return add(add(scale(v.x, R[0]), scale(v.y, R[1])), scale(v.z, R[2])); }
INLINE V3 turned_back(const V3 *R, V3 v) { return (V3){dot(R[0], v), dot(R[1], v), dot(R[2], v)}; }

/* Samples x[0], x[stride], ..., of which `count` exist; lanes beyond repeat the first. */
INLINE V load(const double *x, int64_t stride, int count) {
    if (stride == 1 && count == LANES) return (V)*(const Loose *)x;
    V v;
    for (int k = 0; k < LANES; k++) v[k] = x[k < count ? k * stride : 0];
    return v;
}

INLINE void store(double *x, int64_t stride, int count, V v) {
    if (stride == 1 && count == LANES) *(Loose *)x = (Loose)v;
    else for (int k = 0; k < count; k++) x[k * stride] = v[k];
}

/* The value where a sample is, zero beyond. */
INLINE V masked(V v, int count) {
    for (int k = count; k < LANES; k++) v[k] = 0;
    return v;
}

INLINE double total(V v) {
    double sum = 0;
    for (int k = 0; k < LANES; k++) sum += v[k];
    return sum;
}

INLINE V where(Bits mask, V a, V b) { return (V)((mask & (Bits)a) | (~mask & (Bits)b)); }

/* sin x and cos x within 1e-16 or so: x = k pi/2 + r, |r| <= pi/4, and Taylor's series of r, whose next terms are
   r^19/19! < 1e-19 and r^18/18! < 1e-17. pi/2 is the sum of three numbers, the first two of 33 bits, so that their
   products with k are exact; the C library's functions where k is too large for that. */
INLINE void sine_cosine(V x, V *sine, V *cosine) {
    const double two_over_pi = 0x1.45f306dc9c883p-1, shift = 0x1.8p52;
    const double first = 0x1.921fb544p+0, second = 0x1.0b4611a6p-34, third = 0x1.3198a2e037073p-69;
    Bits large = ~((x < 1e5) & (x > -1e5));
    int64_t any = 0;
    for (int k = 0; k < LANES; k++) any |= large[k];
    if (any) {
        for (int k = 0; k < LANES; k++) (*sine)[k] = sin(x[k]), (*cosine)[k] = cos(x[k]);
        return;
    }
    /* Adding the shift rounds to an integer, which then stands in the lowest bits. */
    V shifted = x * two_over_pi + shift, k = shifted - shift;
    V r = ((x - k * first) - k * second) - k * third, u = r * r;
    V s = u * (1 / 355687428096000.) - 1 / 1307674368000.;
    s = s * u + 1 / 6227020800.;
    s = s * u - 1 / 39916800.;
    s = s * u + 1 / 362880.;
    s = s * u - 1 / 5040.;
    s = s * u + 1 / 120.;
    s = s * u - 1 / 6.;
    s = r + r * (s * u);
    V c = u * (1 / 20922789888000.) - 1 / 87178291200.;
    c = c * u + 1 / 479001600.;
    c = c * u - 1 / 3628800.;
    c = c * u + 1 / 40320.;
    c = c * u - 1 / 720.;
    c = c * u + 1 / 24.;
    c = c * u - 1 / 2.;
    c = c * u + 1;
    Bits quadrant = (Bits)shifted, odd = (quadrant & 1) != 0;
    *sine = (V)((Bits)where(odd, c, s) ^ ((quadrant & 2) << 62));
    *cosine = (V)((Bits)where(odd, s, c) ^ (((quadrant + 1) & 2) << 62));
}

#endif
