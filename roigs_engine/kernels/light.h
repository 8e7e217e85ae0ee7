// sRGB values and linear light (IEC 61966-2-1), both curves continued above 1.
#pragma once

namespace roigs {

// The light of sRGB values of 0 or more.
ROIGS_INLINE Floats to_linear(Floats value) {
    const Floats power = exp2(2.4f * log2((value + 0.055f) / 1.055f));
    return select(greater(value, splat(0.04045f)), power, value / 12.92f);
}

// d to_linear / d(value) at the value whose light this is.
ROIGS_INLINE Floats linear_slope(Floats light) {
    const Floats power = (2.4f / 1.055f) * exp2((1.4f / 2.4f) * log2(light));
    return select(greater(light, splat(0.0031308f)), power, splat(1.0f / 12.92f));
}

}  // namespace roigs
