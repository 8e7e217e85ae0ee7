// The weights that Gaussians have in the picture: their largest, and their sum.
#include "walk.h"

using namespace roigs;

extern "C" __global__ void __launch_bounds__(kGroup) weigh(const Frame f) {
    __shared__ float4 pixels[kPixels];  // x: the pixel's weight in the sums
    if (int(blockIdx.x) >= f.group_begin[f.tile_count]) return;
    const Group group(f, int(blockIdx.x));
    const TilePlace place(f.shape, group.tile);
    for (int p = int(threadIdx.x); p < kPixels; p += kGroup) {
        const bool is_given = f.out.pixel_weights && place.has(p);
        pixels[p] = make_float4(is_given ? f.out.pixel_weights[place.at(p)] : 1.0f, 0, 0, 0);
    }
    __syncthreads();

    LocalSplat s = {};
    int64_t slot = 0;
    if (group.is_there) {
        slot = f.entries[group.entry];
        s = LocalSplat(f.splats + int64_t(f.ids[slot]) * kColumns, place);
    }
    float largest = 0.0f, sum = 0.0f;
    const int bucket = int(blockIdx.x) * (kGroup / kBucket) + int(threadIdx.x) / kBucket;
    const auto behind = [](int, const float4&) { return 0.0f; };
    const auto visit = [&](const Sample& at, int pixel, float left, float&) {
        const float weight = at.alpha * left;
        largest = fmaxf(largest, weight);
        sum += weight * pixels[pixel].x;
    };
    if (group.is_blended) walk(f, group, bucket, s, behind, visit);
    if (!group.is_there) return;
    f.slot_largest[slot] = largest;
    f.slot_sums[slot] = sum;
}

extern "C" __global__ void __launch_bounds__(128) fold_weights(const Frame f) {
    const int64_t n = thread_index();
    if (n >= f.gaussians.count || !f.pair_counts[n]) return;
    const int64_t first = f.first_slot[n];
    float largest = 0.0f, sum = 0.0f;
    for (int i = 0; i < f.pair_counts[n]; ++i) {
        largest = fmaxf(largest, f.slot_largest[first + i]);
        sum += f.slot_sums[first + i];
    }
    if (f.out.max_weight) f.out.max_weight[n] = fmaxf(f.out.max_weight[n], largest);
    if (f.out.weight_sum) f.out.weight_sum[n] += sum;
}
