// Moves data between rows in memory (one row per lane) and vectors (one vector per column).
#pragma once

#include "simd.h"

namespace roigs {

// Four neighbouring floats of a row. A vector consists of kLanes / 4 of them.
typedef float Quad __attribute__((vector_size(16)));
constexpr int kQuads = kLanes / 4;

#if defined(ROIGS_AVX512)

// Lane j of vector i becomes lane i of vector j. Interleaves 1, then 2, 4 and 8 floats at a time.
ROIGS_INLINE void transpose(Floats (&v)[16]) {
    Floats a[16], b[16];
    for (int i = 0; i < 16; i += 2) {
        a[i] = _mm512_unpacklo_ps(v[i], v[i + 1]);
        a[i + 1] = _mm512_unpackhi_ps(v[i], v[i + 1]);
    }
    for (int i = 0; i < 16; i += 4)
        for (int k = 0; k < 2; ++k) {
            const __m512d low = _mm512_castps_pd(a[i + k]), high = _mm512_castps_pd(a[i + k + 2]);
            b[i + 2 * k] = _mm512_castpd_ps(_mm512_unpacklo_pd(low, high));
            b[i + 2 * k + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(low, high));
        }
    for (int j = 0; j < 4; ++j) {  // b[j], b[4+j], ..: 128-bit lane q holds column 4q + j
        const Floats even01 = _mm512_shuffle_f32x4(b[j], b[4 + j], 0x88);
        const Floats odd01 = _mm512_shuffle_f32x4(b[j], b[4 + j], 0xdd);
        const Floats even23 = _mm512_shuffle_f32x4(b[8 + j], b[12 + j], 0x88);
        const Floats odd23 = _mm512_shuffle_f32x4(b[8 + j], b[12 + j], 0xdd);
        v[j] = _mm512_shuffle_f32x4(even01, even23, 0x88);
        v[4 + j] = _mm512_shuffle_f32x4(odd01, odd23, 0x88);
        v[8 + j] = _mm512_shuffle_f32x4(even01, even23, 0xdd);
        v[12 + j] = _mm512_shuffle_f32x4(odd01, odd23, 0xdd);
    }
}

// Combines the lanes of v[0] by `fold` (a sum, a maximum) and writes the result to out[0], that of
// v[1] to out[1], .. Halves the vectors' width four times, each time combining two vectors into
// one. Writes 16 floats.
template <int kCount, class Fold>
ROIGS_INLINE void fold_lanes(const Floats (&v)[kCount], float* out, const Fold& fold) {
    static_assert(kCount <= 16, "one output lane for each vector");
    const auto at = [&](int i) { return i < kCount ? v[i] : Floats{}; };
    Floats a[8], b[4], c[2];
    for (int i = 0; i < 8; ++i)
        a[i] = fold((Floats)_mm512_shuffle_f32x4(at(i), at(i + 8), 0x44),
                    (Floats)_mm512_shuffle_f32x4(at(i), at(i + 8), 0xee));
    for (int i = 0; i < 4; ++i)
        b[i] = fold((Floats)_mm512_shuffle_f32x4(a[i], a[i + 4], 0x88),
                    (Floats)_mm512_shuffle_f32x4(a[i], a[i + 4], 0xdd));
    for (int i = 0; i < 2; ++i)
        c[i] = fold((Floats)_mm512_unpacklo_ps(b[i], b[i + 2]),
                    (Floats)_mm512_unpackhi_ps(b[i], b[i + 2]));
    const Floats folded = fold((Floats)_mm512_unpacklo_ps(c[0], c[1]),
                               (Floats)_mm512_unpackhi_ps(c[0], c[1]));
    // 128-bit lanes now hold results 0-3, 8-11, 4-7, 12-15
    _mm512_storeu_ps(out, _mm512_shuffle_f32x4(folded, folded, 0xd8));
}

ROIGS_INLINE Floats load_some(const float* p, int count) {
    return _mm512_maskz_loadu_ps(first_lanes(count), p);
}
ROIGS_INLINE void store_some(float* p, Floats x, int count) {
    _mm512_mask_storeu_ps(p, first_lanes(count), x);
}

ROIGS_INLINE Floats join(const Quad (&q)[4]) {
    const __m256 low = _mm256_set_m128(q[1], q[0]), high = _mm256_set_m128(q[3], q[2]);
    return _mm512_insertf32x8(_mm512_castps256_ps512(low), high, 1);
}
ROIGS_INLINE void split(Floats x, Quad (&q)[4]) {
    const __m256 low = _mm512_castps512_ps256(x), high = _mm512_extractf32x8_ps(x, 1);
    q[0] = _mm256_castps256_ps128(low), q[1] = _mm256_extractf128_ps(low, 1);
    q[2] = _mm256_castps256_ps128(high), q[3] = _mm256_extractf128_ps(high, 1);
}
ROIGS_INLINE void transpose_quads(Floats (&v)[4]) {
    const __m512d a = (__m512d)_mm512_unpacklo_ps(v[0], v[1]);
    const __m512d b = (__m512d)_mm512_unpackhi_ps(v[0], v[1]);
    const __m512d c = (__m512d)_mm512_unpacklo_ps(v[2], v[3]);
    const __m512d d = (__m512d)_mm512_unpackhi_ps(v[2], v[3]);
    v[0] = (Floats)_mm512_unpacklo_pd(a, c), v[1] = (Floats)_mm512_unpackhi_pd(a, c);
    v[2] = (Floats)_mm512_unpacklo_pd(b, d), v[3] = (Floats)_mm512_unpackhi_pd(b, d);
}

#else

#if defined(__AVX2__)

ROIGS_INLINE void transpose(Floats (&v)[8]) {
    Floats a[8], b[8];
    for (int i = 0; i < 8; i += 2) {
        a[i] = _mm256_unpacklo_ps(v[i], v[i + 1]);
        a[i + 1] = _mm256_unpackhi_ps(v[i], v[i + 1]);
    }
    for (int i = 0; i < 8; i += 4)
        for (int k = 0; k < 2; ++k) {
            b[i + 2 * k] = _mm256_shuffle_ps(a[i + k], a[i + k + 2], 0x44);
            b[i + 2 * k + 1] = _mm256_shuffle_ps(a[i + k], a[i + k + 2], 0xee);
        }
    for (int j = 0; j < 4; ++j) {
        v[j] = _mm256_permute2f128_ps(b[j], b[4 + j], 0x20);
        v[4 + j] = _mm256_permute2f128_ps(b[j], b[4 + j], 0x31);
    }
}

#elif defined(__aarch64__)

ROIGS_INLINE void transpose(Floats (&v)[4]) {
    const Floats a = vzip1q_f32(v[0], v[2]), b = vzip1q_f32(v[1], v[3]);
    const Floats c = vzip2q_f32(v[0], v[2]), d = vzip2q_f32(v[1], v[3]);
    v[0] = vzip1q_f32(a, b), v[1] = vzip2q_f32(a, b);
    v[2] = vzip1q_f32(c, d), v[3] = vzip2q_f32(c, d);
}

#else

ROIGS_INLINE void transpose(Floats (&v)[4]) {
    const Floats a = {v[0][0], v[1][0], v[2][0], v[3][0]};
    const Floats b = {v[0][1], v[1][1], v[2][1], v[3][1]};
    const Floats c = {v[0][2], v[1][2], v[2][2], v[3][2]};
    const Floats d = {v[0][3], v[1][3], v[2][3], v[3][3]};
    v[0] = a, v[1] = b, v[2] = c, v[3] = d;
}

#endif

// The lanes of four vectors, combined by `fold`.
#if defined(__AVX2__)

template <class Fold>
ROIGS_INLINE void fold_four_lanes(Floats a, Floats b, Floats c, Floats d, float* out,
                                  const Fold& fold) {
    const Floats ab = fold(Floats(_mm256_unpacklo_ps(a, b)), Floats(_mm256_unpackhi_ps(a, b)));
    const Floats cd = fold(Floats(_mm256_unpacklo_ps(c, d)), Floats(_mm256_unpackhi_ps(c, d)));
    const Floats abcd = fold(Floats(_mm256_shuffle_ps(ab, cd, 0x44)),
                             Floats(_mm256_shuffle_ps(ab, cd, 0xee)));
    const Floats folded = fold(abcd, Floats(_mm256_permute2f128_ps(abcd, abcd, 0x01)));
    _mm_storeu_ps(out, _mm256_castps256_ps128(folded));
}

#elif defined(__aarch64__)

template <class Fold>
ROIGS_INLINE void fold_four_lanes(Floats a, Floats b, Floats c, Floats d, float* out,
                                  const Fold& fold) {
    const Floats ab = fold(Floats(vuzp1q_f32(a, b)), Floats(vuzp2q_f32(a, b)));
    const Floats cd = fold(Floats(vuzp1q_f32(c, d)), Floats(vuzp2q_f32(c, d)));
    const Floats abcd = fold(Floats(vuzp1q_f32(ab, cd)), Floats(vuzp2q_f32(ab, cd)));
    vst1q_f32(out, abcd);
}

#else

template <class Fold>
ROIGS_INLINE void fold_four_lanes(Floats a, Floats b, Floats c, Floats d, float* out,
                                  const Fold& fold) {
    Floats v[4] = {a, b, c, d};
    transpose(v);
    store(out, fold(fold(v[0], v[1]), fold(v[2], v[3])));
}

#endif

// Combines the lanes of v[0] by `fold` (a sum, a maximum) and writes the result to out[0], that of
// v[1] to out[1], .. Writes 16 floats.
template <int kCount, class Fold>
ROIGS_INLINE void fold_lanes(const Floats (&v)[kCount], float* out, const Fold& fold) {
    static_assert(kCount <= 16, "out has 16 places");
    const auto at = [&](int i) { return i < kCount ? v[i] : Floats{}; };
    for (int i = 0; i < 16; i += 4)
        fold_four_lanes(at(i), at(i + 1), at(i + 2), at(i + 3), out + i, fold);
}

ROIGS_INLINE Floats load_some(const float* p, int count) {
    Floats x = {};
    std::memcpy(&x, p, sizeof(float) * count);
    return x;
}
ROIGS_INLINE void store_some(float* p, Floats x, int count) {
    std::memcpy(p, &x, sizeof(float) * count);
}

#endif

// join and split convert between a vector and its quads. transpose_quads: lane j of quad q of v[i]
// becomes lane i of quad q of v[j].
#if defined(ROIGS_AVX512)
// .. above, with the other AVX-512 code
#elif defined(__AVX2__)

ROIGS_INLINE Floats join(const Quad (&q)[2]) { return _mm256_set_m128(q[1], q[0]); }
ROIGS_INLINE void split(Floats x, Quad (&q)[2]) {
    q[0] = _mm256_castps256_ps128(x), q[1] = _mm256_extractf128_ps(x, 1);
}
ROIGS_INLINE void transpose_quads(Floats (&v)[4]) {
    const Floats a = _mm256_unpacklo_ps(v[0], v[1]), b = _mm256_unpackhi_ps(v[0], v[1]);
    const Floats c = _mm256_unpacklo_ps(v[2], v[3]), d = _mm256_unpackhi_ps(v[2], v[3]);
    v[0] = _mm256_shuffle_ps(a, c, 0x44), v[1] = _mm256_shuffle_ps(a, c, 0xee);
    v[2] = _mm256_shuffle_ps(b, d, 0x44), v[3] = _mm256_shuffle_ps(b, d, 0xee);
}

#else

ROIGS_INLINE Floats join(const Quad (&q)[1]) { return q[0]; }
ROIGS_INLINE void split(Floats x, Quad (&q)[1]) { q[0] = x; }
ROIGS_INLINE void transpose_quads(Floats (&v)[4]) { transpose(v); }

#endif

struct Sum {
    ROIGS_INLINE Floats operator()(Floats a, Floats b) const { return a + b; }
};
struct Larger {
    ROIGS_INLINE Floats operator()(Floats a, Floats b) const { return max(a, b); }
};

// Starts fetching the first columns of a row that will soon be read or written. Rows of visible
// Gaussians follow no pattern by which the processor could fetch them ahead.
template <bool kWrite>
ROIGS_INLINE void prefetch_row(const float* row, int columns) {
    constexpr int kLine = 16;  // floats
    for (int i = 0; i < columns; i += kLine) __builtin_prefetch(row + i, kWrite);
}

// values[rows[i]] in lane i.
ROIGS_INLINE Floats gather(const float* values, const int32_t* rows) {
    Floats x;
    for (int i = 0; i < kLanes; ++i) x[i] = values[rows[i]];
    return x;
}

// The first `columns` columns of a row-major matrix with `stride` floats a row, each as a vector,
// one row per lane. Reads nothing beyond a row's `columns` floats. `out` has room for `columns`,
// rounded up to a multiple of kLanes.
ROIGS_INLINE void load_columns(const float* matrix, int stride, int columns, const int32_t* rows,
                               Floats* out) {
    for (int first = 0; first < columns; first += kLanes) {
        Floats tile[kLanes];
        const int used = columns - first;
        for (int i = 0; i < kLanes; ++i) {
            const float* p = matrix + (int64_t)rows[i] * stride + first;
            tile[i] = used < kLanes ? load_some(p, used) : load(p);
        }
        transpose(tile);
        for (int i = 0; i < kLanes; ++i) out[first + i] = tile[i];
    }
}

// The same for few columns, with a quarter of the shuffles or fewer.
template <int kColumns>
ROIGS_INLINE void load_few_columns(const float* matrix, int stride, const int32_t* rows,
                                   Floats (&out)[4]) {
    static_assert(kColumns <= 4, "a quad holds them");
    for (int j = 0; j < 4; ++j) {
        Quad quads[kQuads] = {};
        for (int q = 0; q < kQuads; ++q)
            std::memcpy(&quads[q], matrix + (int64_t)rows[4 * q + j] * stride,
                        sizeof(float) * kColumns);
        out[j] = join(quads);
    }
    transpose_quads(out);
}

// Calls visit(i, quad) for each lane i, with that lane's values from vectors of few columns.
template <int kColumns, class Visit>
ROIGS_INLINE void for_each_quad(const Floats (&columns)[kColumns], const Visit& visit) {
    static_assert(kColumns <= 4, "a quad holds them");
    Floats tile[4] = {};
    for (int k = 0; k < kColumns; ++k) tile[k] = columns[k];
    transpose_quads(tile);
    for (int j = 0; j < 4; ++j) {
        Quad quads[kQuads];
        split(tile[j], quads);
        for (int q = 0; q < kQuads; ++q) visit(4 * q + j, quads[q]);
    }
}

// Adds vectors to the first `columns` columns of `count` rows, one row per lane; rows must differ.
ROIGS_INLINE void add_columns(float* matrix, int stride, int columns, const int32_t* rows,
                              int count, const Floats* in) {
    for (int first = 0; first < columns; first += kLanes) {
        Floats tile[kLanes];
        const int used = columns - first;
        const auto place = [&](int i) { return matrix + (int64_t)rows[i] * stride + first; };
        for (int i = 0; i < kLanes; ++i) tile[i] = i < used ? in[first + i] : Floats{};
        transpose(tile);
        // All loads come before all stores: rows are neighbours in memory, and loading a vector
        // that overlaps one being stored is slow.
        if (used < kLanes) {
            for (int i = 0; i < count; ++i) tile[i] += load_some(place(i), used);
            for (int i = 0; i < count; ++i) store_some(place(i), tile[i], used);
        } else {
            for (int i = 0; i < count; ++i) store(place(i), load(place(i)) + tile[i]);
        }
    }
}

}  // namespace roigs
