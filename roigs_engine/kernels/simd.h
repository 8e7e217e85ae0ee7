// One vector type for all instruction sets, so that kernels need only one source.
//
// A vector holds one float for each pixel of a small block of a tile (raster kernels), or one for
// each Gaussian of a batch (projection kernels):
//
//     AVX-512     16 lanes, 4x4 pixels
//     AVX2         8 lanes, 4x2 pixels
//     otherwise    4 lanes, 2x2 pixels (SSE2, NEON, or whatever the compiler makes of it)
//
// `Floats` and `Ints` are GCC/clang vector types: + - * / work on them, also with scalars. This
// file adds the other operations. Functions take and return lanes; nothing traps.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>

#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

#define ROIGS_INLINE inline __attribute__((always_inline))

namespace roigs {

#if defined(__AVX512F__) && defined(__AVX512DQ__)
#define ROIGS_AVX512
constexpr int kBlockWidth = 4, kBlockHeight = 4;
#elif defined(__AVX2__)
constexpr int kBlockWidth = 4, kBlockHeight = 2;
#else
constexpr int kBlockWidth = 2, kBlockHeight = 2;
#endif
constexpr int kLanes = kBlockWidth * kBlockHeight;

typedef float Floats __attribute__((vector_size(4 * kLanes)));
typedef int32_t Ints __attribute__((vector_size(4 * kLanes)));

#if defined(ROIGS_AVX512)
typedef __mmask16 Mask;  // a bit per lane
#else
typedef Ints Mask;  // all bits of a lane, or none
#endif

ROIGS_INLINE Floats splat(float x) { return x - Floats{}; }
ROIGS_INLINE Ints bits_of(Floats x) { return (Ints)x; }
ROIGS_INLINE Floats floats_of(Ints x) { return (Floats)x; }
ROIGS_INLINE Floats to_floats(Ints x) { return __builtin_convertvector(x, Floats); }
ROIGS_INLINE Ints to_ints(Floats x) { return __builtin_convertvector(x, Ints); }

ROIGS_INLINE Floats load(const float* p) {
    Floats x;
    std::memcpy(&x, p, sizeof x);
    return x;
}
ROIGS_INLINE void store(float* p, Floats x) { std::memcpy(p, &x, sizeof x); }

#if defined(ROIGS_AVX512)

ROIGS_INLINE Mask greater(Floats a, Floats b) { return _mm512_cmp_ps_mask(a, b, _CMP_GT_OQ); }
ROIGS_INLINE Mask less(Floats a, Floats b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
ROIGS_INLINE Mask not_zero(Floats a) {  // true for NaN, too
    return _mm512_cmp_ps_mask(a, Floats{}, _CMP_NEQ_UQ);
}
ROIGS_INLINE Mask both(Mask a, Mask b) { return _kand_mask16(a, b); }
ROIGS_INLINE Mask less(Ints a, Ints b) {
    return _mm512_cmplt_epi32_mask((__m512i)a, (__m512i)b);
}
ROIGS_INLINE uint32_t bits(Mask m) { return m; }  // lane i -> bit i
ROIGS_INLINE bool any(Mask m) { return m != 0; }
ROIGS_INLINE Mask first_lanes(int count) { return (Mask)((1u << count) - 1); }
ROIGS_INLINE Floats keep(Mask m, Floats a) { return _mm512_maskz_mov_ps(m, a); }  // m ? a : 0
ROIGS_INLINE Floats select(Mask m, Floats a, Floats b) { return _mm512_mask_mov_ps(b, m, a); }
ROIGS_INLINE Floats min(Floats a, Floats b) { return _mm512_min_ps(a, b); }
ROIGS_INLINE Floats max(Floats a, Floats b) { return _mm512_max_ps(a, b); }
ROIGS_INLINE Floats sqrt(Floats x) { return _mm512_sqrt_ps(x); }

// 1 / x to about 1e-7: the 14-bit estimate and one Newton step, at a third of a division's cost.
ROIGS_INLINE Floats reciprocal(Floats x) {
    const Floats y = _mm512_rcp14_ps(x);
    return y * (2.0f - x * y);
}

#else

ROIGS_INLINE Mask greater(Floats a, Floats b) { return a > b; }
ROIGS_INLINE Mask less(Floats a, Floats b) { return a < b; }
ROIGS_INLINE Mask not_zero(Floats a) { return a != Floats{}; }
ROIGS_INLINE Mask less(Ints a, Ints b) { return a < b; }
ROIGS_INLINE Mask both(Mask a, Mask b) { return a & b; }
ROIGS_INLINE Mask first_lanes(int count) {
    Mask m;
    for (int i = 0; i < kLanes; ++i) m[i] = -(i < count);
    return m;
}
ROIGS_INLINE Floats keep(Mask m, Floats a) { return floats_of(m & bits_of(a)); }
ROIGS_INLINE Floats select(Mask m, Floats a, Floats b) {
    return floats_of((m & bits_of(a)) | (~m & bits_of(b)));
}
ROIGS_INLINE Floats min(Floats a, Floats b) { return a < b ? a : b; }
ROIGS_INLINE Floats max(Floats a, Floats b) { return a > b ? a : b; }

#if defined(__AVX2__)

ROIGS_INLINE uint32_t bits(Mask m) { return (uint32_t)_mm256_movemask_ps((__m256)m); }
ROIGS_INLINE Floats sqrt(Floats x) { return _mm256_sqrt_ps(x); }
ROIGS_INLINE Ints round_to_ints(Floats x) { return (Ints)_mm256_cvtps_epi32(x); }
ROIGS_INLINE Floats reciprocal(Floats x) {
    const Floats y = _mm256_rcp_ps(x);
    return y * (2.0f - x * y);
}

#else

ROIGS_INLINE uint32_t bits(Mask m) {
#if defined(__SSE2__)
    return (uint32_t)_mm_movemask_ps((__m128)m);
#else
    uint32_t r = 0;
    for (int i = 0; i < kLanes; ++i) r |= (uint32_t)(m[i] & 1) << i;
    return r;
#endif
}
ROIGS_INLINE Floats sqrt(Floats x) {
#if defined(__SSE2__)
    return _mm_sqrt_ps(x);
#elif defined(__aarch64__)
    return (Floats)vsqrtq_f32((float32x4_t)x);
#else
    for (int i = 0; i < kLanes; ++i) x[i] = std::sqrt(x[i]);
    return x;
#endif
}
ROIGS_INLINE Ints round_to_ints(Floats x) {
#if defined(__SSE2__)
    return (Ints)_mm_cvtps_epi32(x);
#elif defined(__aarch64__)
    return (Ints)vcvtnq_s32_f32((float32x4_t)x);
#else
    return __builtin_convertvector(x + select(x < 0.0f, splat(-0.5f), splat(0.5f)), Ints);
#endif
}
ROIGS_INLINE Floats reciprocal(Floats x) { return 1.0f / x; }

#endif

ROIGS_INLINE bool any(Mask m) {
#if defined(__aarch64__)
    return vmaxvq_u32((uint32x4_t)m) != 0;
#else
    return bits(m) != 0;
#endif
}

#endif

// NaN stays NaN: if one operand is NaN, min and max return the second operand.
ROIGS_INLINE Floats clamp(Floats x, Floats low, Floats high) { return min(high, max(low, x)); }

// For |x| below 2^31.
ROIGS_INLINE Floats floor(Floats x) {
    const Floats towards_zero = to_floats(__builtin_convertvector(x, Ints));
    return towards_zero - keep(greater(towards_zero, x), splat(1.0f));
}
ROIGS_INLINE Floats ceil(Floats x) { return -floor(-x); }

// Tests the bits, so that it works under compiler flags that assume there are no NaNs.
ROIGS_INLINE Mask is_finite(Floats x) {
    return less(bits_of(x) & 0x7fffffff, Ints{} + 0x7f800000);
}

// 2^x for x in [-126, 127], relative error below 3e-7: x = n + f with |f| <= 1/2, a polynomial for
// 2^f (minimax, 2^0 = 1 exactly), n added to the exponent. NaN stays NaN. For an x outside, the
// result is undefined: the raster loops drop such lanes, so they need no clamp.
ROIGS_INLINE Floats exp2(Floats x) {
#if defined(ROIGS_AVX512)
    const Floats n = _mm512_roundscale_ps(x, 0x08), f = x - n;
#else
    const Ints n = round_to_ints(x);
    const Floats f = x - to_floats(n);
#endif
    Floats p = splat(1.3276472e-3f);
    p = p * f + 9.6755655e-3f;
    p = p * f + 5.5507132e-2f;
    p = p * f + 0.24022461f;
    p = p * f + 0.69314693f;
    p = p * f + 1.0f;
#if defined(ROIGS_AVX512)
    return _mm512_scalef_ps(p, n);
#else
    return floats_of(bits_of(p) + (n << 23));
#endif
}

// log2(x) of positive normal x to float precision: x = 2^n m with m in [sqrt(1/2), sqrt(2)), and
// ln m = 2 artanh(s), s = (m - 1) / (m + 1), |s| < 0.172, as a series.
ROIGS_INLINE Floats log2(Floats x) {
    const Ints n = (bits_of(x) - 0x3f3504f3) >> 23;  // 0x3f3504f3: sqrt(1/2)
    const Floats m = floats_of(bits_of(x) - (n << 23));
    const Floats s = (m - 1.0f) / (m + 1.0f), ss = s * s;
    const Floats series =
        1.0f + ss * (1.0f / 3 + ss * (1.0f / 5 + ss * (1.0f / 7 + ss * (1.0f / 9))));
    return to_floats(n) + 2.88539008f * s * series;  // 2 / ln 2
}

}  // namespace roigs
