// Adds a photo's depth map to points: how far they are in front of or behind the surface. After
// Curless and Levoy (1996); surface/fusion.py explains the use of the sums.
#include <algorithm>
#include <cmath>

#include "roigs.h"

namespace roigs {
namespace {

constexpr int64_t kPointsPerTask = 4096;

struct Sample {
    float depth, weight, slope;
};

// Between pixels: bilinear on one surface, elsewhere the value of the nearest pixel.
Sample sample(const DepthPhoto& photo, float x, float y) {
    const int32_t left = int32_t(x), top = int32_t(y);
    const float across = x - left, down = y - top;
    const float* at = photo.depth + int64_t(top) * photo.size[0] + left;
    const float a = at[0], b = at[1], c = at[photo.size[0]], d = at[photo.size[0] + 1];
    const int64_t nearest =
        int64_t(top + (down > 0.5f)) * photo.size[0] + left + (across > 0.5f);
    const float middle = photo.depth[nearest];
    const float low = std::min(std::min(a, b), std::min(c, d));
    const float high = std::max(std::max(a, b), std::max(c, d));
    const float slope = photo.slope[nearest];
    const bool smooth = low > 0 && high - low < photo.jump * middle / std::max(slope, 0.1f);
    const float depth = smooth ? (a + (b - a) * across) * (1 - down) + (c + (d - c) * across) * down
                               : middle;
    return {depth, photo.weight[nearest], slope};
}

}  // namespace
}  // namespace roigs

void roigs_fuse_depth(const float* points, int64_t count, const roigs::DepthPhoto* photo,
                      float* sums) {
    using namespace roigs;
    const float* m = photo->pose;
    const float limit_x = photo->size[0] - 1.0f, limit_y = photo->size[1] - 1.0f;
    parallel_for(chunks(count, kPointsPerTask), [&](int64_t task) {
        const int64_t end = std::min((task + 1) * kPointsPerTask, count);
        for (int64_t i = task * kPointsPerTask; i < end; ++i) {
            const float *p = points + 3 * i;
            const float z = m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11];
            if (!(z > 0)) continue;
            const float u = (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]) / z;
            const float v = (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]) / z;
            const float x = u * photo->lens[0] + photo->lens[2] - 0.5f;
            const float y = v * photo->lens[1] + photo->lens[3] - 0.5f;
            if (!(x >= 0 && y >= 0 && x < limit_x && y < limit_y)) continue;
            const Sample found = sample(*photo, x, y);
            if (!(found.weight > 0)) continue;
            const float truncation =
                std::max(photo->truncation, photo->footprints * found.depth);
            const float distance = (found.depth - z) * found.slope / truncation;
            // Behind the surface, a photo has the weight of its pixels at the point's distance.
            // Otherwise, photos of a near object would outvote all others far behind it.
            const float nearer = std::min(found.depth / z, 1.0f);
            const float weight = found.weight * nearer * nearer;
            float* sum = sums + 5 * i;
            if (distance <= -1) {
                sum[3] += weight;
                continue;
            }
            sum[0] += weight * std::min(distance, 1.0f);
            sum[1] += weight;
            if (distance < 1) sum[2] += weight, sum[4] += 1;
        }
    });
}
