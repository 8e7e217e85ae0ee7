// Samples square patches of a grey photo, and gives each zero mean and unit variance.
// colmap/patch_alignment.py explains the use.
#include <algorithm>
#include <cmath>

#include "roigs.h"

namespace roigs {
namespace {

constexpr float kLeastDeviation = 1e-3f;  // of a patch without contrast

// Bilinear between the centres of pixels; NaN counts as 0.
float interpolated(const float* grey, int64_t width, int64_t height, float x, float y) {
    x = x > 0 ? std::min(x, width - 1.0f) : 0;
    y = y > 0 ? std::min(y, height - 1.0f) : 0;
    const int64_t left = std::min(int64_t(x), width - 2), top = std::min(int64_t(y), height - 2);
    const float across = x - left, down = y - top;
    const float* at = grey + top * width + left;
    const float above = at[0] + (at[1] - at[0]) * across;
    const float below = at[width] + (at[width + 1] - at[width]) * across;
    return above + (below - above) * down;
}

}  // namespace
}  // namespace roigs

void roigs_patches(const float* grey, int64_t width, int64_t height, const float* centres,
                   const float* shapes, int64_t count, int64_t half, const float* weights,
                   float* patches, float* deviations, uint8_t* inside) {
    using namespace roigs;
    const int64_t side = 2 * half + 1, samples = side * side;
    const float end_x = width - 1.0f, end_y = height - 1.0f;
    for (int64_t i = 0; i < count; ++i) {
        const float *centre = centres + 2 * i, *shape = shapes + 4 * i;
        float* patch = patches + samples * i;
        float mean = 0;
        bool whole = true;
        for (int64_t row = 0, k = 0; row < side; ++row) {
            const float v = float(row - half);
            for (int64_t column = 0; column < side; ++column, ++k) {
                const float u = float(column - half);
                const float x = centre[0] + shape[0] * u + shape[1] * v;
                const float y = centre[1] + shape[2] * u + shape[3] * v;
                whole &= x >= 0 && y >= 0 && x <= end_x && y <= end_y;
                patch[k] = interpolated(grey, width, height, x, y);
                mean += weights[k] * patch[k];
            }
        }
        float variance = 0;
        for (int64_t k = 0; k < samples; ++k) {
            patch[k] -= mean;
            variance += weights[k] * patch[k] * patch[k];
        }
        deviations[i] = std::sqrt(variance);
        inside[i] = whole;
        const float scale = 1 / std::max(deviations[i], kLeastDeviation);
        for (int64_t k = 0; k < samples; ++k) patch[k] *= scale;
    }
}
