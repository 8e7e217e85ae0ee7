// The functions of kernels/simd.h and kernels/simd_rows.h on a card. Vectors have one lane, because
// each thread has one Gaussian. The headers for geometry, colours and ellipses compile with either.
#pragma once

#include <cstdint>

#define ROIGS_INLINE __device__ __forceinline__

namespace roigs {

constexpr int kLanes = 1;
typedef float Floats;
typedef int32_t Ints;
typedef bool Mask;

ROIGS_INLINE Floats splat(float x) { return x; }
ROIGS_INLINE Ints to_ints(Floats x) { return int32_t(x); }
ROIGS_INLINE Mask greater(Floats a, Floats b) { return a > b; }
ROIGS_INLINE Mask less(Floats a, Floats b) { return a < b; }
ROIGS_INLINE Mask both(Mask a, Mask b) { return a && b; }
ROIGS_INLINE Floats keep(Mask m, Floats a) { return m ? a : 0.0f; }
ROIGS_INLINE Floats select(Mask m, Floats a, Floats b) { return m ? a : b; }
ROIGS_INLINE Floats min(Floats a, Floats b) { return a < b ? a : b; }
ROIGS_INLINE Floats max(Floats a, Floats b) { return a > b ? a : b; }
// NaN stays NaN: if one operand is NaN, min and max return the second operand.
ROIGS_INLINE Floats clamp(Floats x, Floats low, Floats high) { return min(high, max(low, x)); }
ROIGS_INLINE Floats sqrt(Floats x) { return sqrtf(x); }
ROIGS_INLINE Floats floor(Floats x) { return floorf(x); }
ROIGS_INLINE Floats ceil(Floats x) { return ceilf(x); }
ROIGS_INLINE Floats exp2(Floats x) { return exp2f(x); }
ROIGS_INLINE Floats log2(Floats x) { return log2f(x); }
ROIGS_INLINE Mask is_finite(Floats x) { return (__float_as_int(x) & 0x7fffffff) < 0x7f800000; }

ROIGS_INLINE Floats gather(const float* values, const int32_t* rows) { return values[rows[0]]; }

template <int kColumns>
ROIGS_INLINE void load_few_columns(const float* matrix, int stride, const int32_t* rows,
                                   Floats (&columns)[4]) {
    for (int k = 0; k < kColumns; ++k) columns[k] = matrix[int64_t(rows[0]) * stride + k];
}

}  // namespace roigs
