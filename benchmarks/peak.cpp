// The most floating-point work one core can do: chains of fused multiply-adds that do not wait for
// each other, with nothing to load or store. Built with the kernels' flags for each instruction
// set; where that has no fused multiply-add (plain x86-64), it is a multiplication and an addition.
#include "../roigs_engine/kernels/parallel.h"
#include "../roigs_engine/kernels/simd.h"

// Runs each chain `steps` times; returns the operations done. `result` only keeps the compiler from
// leaving it all out.
ROIGS_API double roigs_fma_chains(int64_t steps, float* result) {
    using namespace roigs;
    // Up to four pipelines, four operations deep; or three where registers are 16 and not 32.
#if defined(ROIGS_AVX512) || defined(__aarch64__)
    constexpr int kChains = 16;
#else
    constexpr int kChains = 12;
#endif
    const Floats factor = splat(0.999f), term = splat(0.001f);
    Floats x[kChains];
    for (int c = 0; c < kChains; ++c) x[c] = splat(float(c));
    for (int64_t i = 0; i < steps; ++i)
        for (int c = 0; c < kChains; ++c) x[c] = x[c] * factor + term;
    *result = 0;
    for (int c = 0; c < kChains; ++c) *result += x[c][0];
    return 2.0 * kChains * kLanes * double(steps);
}
