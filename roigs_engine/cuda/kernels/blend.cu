// Blending front to back (3DGS, eq. 3): C = sum_i c_i alpha_i T_i, T_i = prod_{j<i} (1 - alpha_j).
// A block for each tile, a thread for each pixel.
#include "frame.h"

namespace roigs {

// The next splats of a tile's list, read by all threads of the block. Returns their number.
__device__ int load_batch(const Frame& f, const TilePlace& place, int begin, int end,
                          LocalSplat (&batch)[kPixels]) {
    const int at = begin + int(threadIdx.x);
    if (at < end) {
        const int64_t n = f.ids[f.entries[at]];
        batch[threadIdx.x] = LocalSplat(f.splats + n * kColumns, place);
    }
    return end - begin < kPixels ? end - begin : kPixels;
}

}  // namespace roigs

using namespace roigs;

extern "C" __global__ void __launch_bounds__(kPixels) blend(const Frame f) {
    __shared__ LocalSplat batch[kPixels];
    const int tile = int(blockIdx.x), pixel = int(threadIdx.x);
    if (f.shape.tile_mask && !f.shape.tile_mask[tile]) {
        if (pixel == 0) f.reached[tile] = 0;
        return;
    }
    const TilePlace place(f.shape, tile);
    const int first = f.tile_begin[tile], end = f.tile_begin[tile + 1];
    const bool inside = place.has(pixel);
    float4* checkpoint =
        f.checkpoints
            ? f.checkpoints + int64_t(f.group_begin[tile]) * (kGroup / kBucket) * kPixels + pixel
            : nullptr;
    const float least = f.shape.min_transmittance;
    float left = inside ? 1.0f : 0.0f, red = 0.0f, green = 0.0f, blue = 0.0f, depth = 0.0f;
    int begin = first;
    for (; begin < end; begin += kPixels) {
        // waits until all threads have read the previous batch
        if (!__syncthreads_or(left > least)) break;
        const int count = load_batch(f, place, begin, end, batch);
        __syncthreads();
        for (int i = 0; i < count; ++i) {
            if (checkpoint && i % kBucket == 0) {
                *checkpoint = make_float4(left, red, green, blue);
                checkpoint += kPixels;
            }
            if (!(left > least)) continue;
            const LocalSplat& s = batch[i];
            const float weight = Sample(s, pixel).alpha * left;
            left -= weight;
            red += weight * s.red;
            green += weight * s.green;
            blue += weight * s.blue;
            depth += weight * s.depth;
        }
    }
    if (pixel == 0) f.reached[tile] = (begin < end ? begin : end) - first;
    if (!inside) return;
    const int64_t at = place.at(pixel), plane = place.plane();
    const Camera camera = f.camera();
    const float* background = camera.background;
    f.out.image[at] = red + left * background[0];
    f.out.image[at + plane] = green + left * background[1];
    f.out.image[at + 2 * plane] = blue + left * background[2];
    f.out.alpha[at] = 1.0f - left;
    if (f.out.depth) f.out.depth[at] = left < 1.0f ? depth / (1.0f - left) : 0.0f;
}

// The depth of the Gaussian at which the weights, added front to back, reach half of their sum.
extern "C" __global__ void __launch_bounds__(kPixels) median_depth(const Frame f) {
    __shared__ LocalSplat batch[kPixels];
    const int tile = int(blockIdx.x), pixel = int(threadIdx.x);
    if (f.shape.tile_mask && !f.shape.tile_mask[tile]) return;
    const TilePlace place(f.shape, tile);
    const int end = f.tile_begin[tile + 1];
    const bool inside = place.has(pixel);
    const float half = inside ? 1.0f - 0.5f * f.out.alpha[place.at(pixel)] : 1.0f;
    float left = 1.0f, depth = 0.0f;
    for (int begin = f.tile_begin[tile]; begin < end; begin += kPixels) {
        if (!__syncthreads_or(left > half)) break;
        const int count = load_batch(f, place, begin, end, batch);
        __syncthreads();
        for (int i = 0; i < count && left > half; ++i) {
            const float alpha = Sample(batch[i], pixel).alpha;
            if (alpha > 0.0f) depth = batch[i].depth;
            left -= alpha * left;
        }
    }
    if (inside) f.median[place.at(pixel)] = depth;
}
