// The instruction set that this processor and operating system can run. library.py asks the generic
// library before it loads a faster one.
#include "parallel.h"

#if defined(__x86_64__) || defined(_M_X64)
#include <cpuid.h>

namespace {

// XCR0: which registers the operating system saves when it switches threads.
uint32_t enabled_register_state() {
    uint32_t low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}

constexpr bool has_all(uint32_t word, uint32_t bits) { return (word & bits) == bits; }

// Level of the x86-64 psABI: 3 has AVX2 and FMA, 4 has AVX-512 F, BW, CD, DQ and VL.
int x86_64_level() {
    uint32_t eax, ebx, ecx, edx;
    if (!__get_cpuid(1, &eax, &ebx, &ecx, &edx)) return 1;
    constexpr uint32_t kV3Leaf1 = bit_FMA | bit_MOVBE | bit_OSXSAVE | bit_AVX | bit_F16C |
                                  bit_SSE4_2 | bit_POPCNT | bit_SSSE3;
    if (!has_all(ecx, kV3Leaf1)) return 1;
    const uint32_t state = enabled_register_state();
    if (!has_all(state, 0x06)) return 1;  // SSE and AVX registers

    uint32_t extended_ecx;
    if (!__get_cpuid(0x80000001, &eax, &ebx, &extended_ecx, &edx)) return 1;
    if (!has_all(extended_ecx, 1u << 5)) return 1;  // LZCNT
    if (!__get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx)) return 1;
    if (!has_all(ebx, bit_AVX2 | bit_BMI | bit_BMI2)) return 1;

    constexpr uint32_t kV4Leaf7 =
        bit_AVX512F | bit_AVX512BW | bit_AVX512CD | bit_AVX512DQ | bit_AVX512VL;
    const bool v4 = has_all(ebx, kV4Leaf7) && has_all(state, 0xe6);  // and opmask, ZMM registers
    return v4 ? 4 : 3;
}

}  // namespace

// Name of the best instruction set that can run here: "avx512", "avx2" or "generic".
ROIGS_API const char* roigs_best_isa() {
    const int level = x86_64_level();
    return level >= 4 ? "avx512" : level >= 3 ? "avx2" : "generic";
}

#else

// arm64 always has NEON, and there is one library for it.
ROIGS_API const char* roigs_best_isa() { return "neon"; }

#endif
