// L1 and SSIM of a picture against its photo, and the gradient. training/losses.py has the
// formulas, kernels/loss.cpp the version for a processor. Each block takes a tile of one channel.
// The window is separable: the kernel filters along rows, then along columns.
#include "frame.h"

namespace roigs {

constexpr int kRadius = 5, kHalo = kTile + 2 * kRadius;
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;

struct Loss {
    int64_t width, height;
    const float* image;     // (3, H, W)
    const uint8_t* target;  // (H, W, 3)
    const float* weights;   // (H, W) or null
    const double* total;    // (1,) sum of the weights; null: all are 1
    float ssim_weight;
    float* derivatives;     // (3, 3, H, W) of the weighted SSIM: by mean, square, product
    float* sums;            // (blocks, 2) weighted SSIM and |difference|
    float* gradient;        // (3, H, W)
    float* terms;           // (3,) loss, L1, SSIM
    int64_t blocks;

    // 1 / (sum of the weights over pixels and channels); 0 without any.
    ROIGS_INLINE float scale() const {
        const float sum = 3.0f * (total ? float(*total) : float(width * height));
        return sum > 0.0f ? 1.0f / sum : 0.0f;
    }
};

// exp(-k^2 / (2 * 1.5^2)) for k = 0..5, divided by the sum over the 11 taps
ROIGS_INLINE float window(int k) {
    switch (k < 0 ? -k : k) {
        case 0: return 0.266011725f;
        case 1: return 0.213005538f;
        case 2: return 0.10936069f;
        case 3: return 0.0360007721f;
        case 4: return 0.00759875814f;
        default: return 0.00102838008f;
    }
}

// A block's place in the picture.
struct LossTile {
    int channel, x, y, columns;
    explicit LossTile(const Loss& l) : columns(int((l.width + kTile - 1) / kTile)) {
        const int rows = int((l.height + kTile - 1) / kTile);
        const int block = int(blockIdx.x);
        channel = block / (rows * columns);
        x = block % columns * kTile;
        y = block / columns % rows * kTile;
    }
    // Position in the picture of a place of the tile with its halo; -1: outside the picture.
    ROIGS_INLINE int64_t at(const Loss& l, int place) const {
        const int64_t px = x + place % kHalo - kRadius, py = y + place / kHalo - kRadius;
        return px < 0 || py < 0 || px >= l.width || py >= l.height ? -1 : py * l.width + px;
    }
};

ROIGS_INLINE float photo(const Loss& l, int channel, int64_t at) {
    return float(l.target[3 * at + channel]) / 255.0f;
}

// Filters along columns, at the pixel, values that were filtered along rows.
ROIGS_INLINE float along_column(const float (&rows)[kHalo][kTile]) {
    const int x = int(threadIdx.x) % kTile, y = int(threadIdx.x) / kTile + kRadius;
    float total = 0.0f;
    for (int k = -kRadius; k <= kRadius; ++k) total += window(k) * rows[y + k][x];
    return total;
}

// Sum over the block, in thread 0.
__device__ float block_sum(float value, float (&of_warps)[kPixels / 32]) {
    for (int step = 16; step; step /= 2) value += __shfl_down_sync(0xffffffffu, value, step);
    if (threadIdx.x % 32 == 0) of_warps[threadIdx.x / 32] = value;
    __syncthreads();
    float total = 0.0f;
    if (threadIdx.x == 0)
        for (int w = 0; w < kPixels / 32; ++w) total += of_warps[w];
    __syncthreads();
    return total;
}

}  // namespace roigs

using namespace roigs;

extern "C" __global__ void __launch_bounds__(kPixels) loss(const Loss l) {
    __shared__ float image[kHalo * kHalo], target[kHalo * kHalo];
    __shared__ float rows[4][kHalo][kTile];  // means, sum of squares, product: filtered along rows
    __shared__ float of_warps[kPixels / 32];
    const LossTile tile(l);
    const int64_t plane = l.width * l.height;
    for (int p = int(threadIdx.x); p < kHalo * kHalo; p += kPixels) {
        const int64_t at = tile.at(l, p);
        image[p] = at < 0 ? 0.0f : l.image[tile.channel * plane + at];
        target[p] = at < 0 ? 0.0f : photo(l, tile.channel, at);
    }
    __syncthreads();
    for (int p = int(threadIdx.x); p < kHalo * kTile; p += kPixels) {
        const int y = p / kTile, x = p % kTile;
        float sum[4] = {};
        for (int k = -kRadius; k <= kRadius; ++k) {
            const float a = image[y * kHalo + x + kRadius + k];
            const float b = target[y * kHalo + x + kRadius + k], w = window(k);
            sum[0] += w * a;
            sum[1] += w * b;
            sum[2] += w * (a * a + b * b);
            sum[3] += w * (a * b);
        }
        for (int m = 0; m < 4; ++m) rows[m][y][x] = sum[m];
    }
    __syncthreads();

    const int centre = (int(threadIdx.x) / kTile + kRadius) * kHalo +
                       int(threadIdx.x) % kTile + kRadius;
    const int64_t at = tile.at(l, centre);
    const float weight = at < 0 ? 0.0f : l.weights ? l.weights[at] : 1.0f;
    const float mu_x = along_column(rows[0]), mu_t = along_column(rows[1]);
    const float squares = along_column(rows[2]), product = along_column(rows[3]);
    const float mu_xt = mu_x * mu_t, mu_xx_tt = mu_x * mu_x + mu_t * mu_t;
    const float a = 2.0f * mu_xt + kC1, b = 2.0f * (product - mu_xt) + kC2;
    const float c = mu_xx_tt + kC1, d = squares - mu_xx_tt + kC2;
    const float over_cd = 1.0f / (c * d), ssim = a * b * over_cd;
    if (l.derivatives && at >= 0) {
        const float d_a = b * over_cd, d_b = a * over_cd;
        const float d_c = -ssim * over_cd * d, d_d = -ssim * over_cd * c;
        float* of_pixel = l.derivatives + tile.channel * plane + at;
        of_pixel[0] = 2.0f * weight * (mu_t * (d_a - d_b) + mu_x * (d_c - d_d));
        of_pixel[3 * plane] = weight * d_d;
        of_pixel[6 * plane] = 2.0f * weight * d_b;
    }
    const float similarity = block_sum(weight * ssim, of_warps);
    const float difference = block_sum(weight * fabsf(image[centre] - target[centre]), of_warps);
    if (threadIdx.x == 0) {
        l.sums[2 * int64_t(blockIdx.x)] = similarity;
        l.sums[2 * int64_t(blockIdx.x) + 1] = difference;
    }
}

extern "C" __global__ void __launch_bounds__(kPixels) loss_gradient(const Loss l) {
    __shared__ float derivatives[3][kHalo * kHalo];
    __shared__ float rows[3][kHalo][kTile];
    const LossTile tile(l);
    const int64_t plane = l.width * l.height;
    for (int p = int(threadIdx.x); p < kHalo * kHalo; p += kPixels) {
        const int64_t at = tile.at(l, p);
        for (int m = 0; m < 3; ++m)
            derivatives[m][p] =
                at < 0 ? 0.0f : l.derivatives[(3 * m + tile.channel) * plane + at];
    }
    __syncthreads();
    for (int p = int(threadIdx.x); p < kHalo * kTile; p += kPixels) {
        const int y = p / kTile, x = p % kTile;
        for (int m = 0; m < 3; ++m) {
            float sum = 0.0f;
            for (int k = -kRadius; k <= kRadius; ++k)
                sum += window(k) * derivatives[m][y * kHalo + x + kRadius + k];
            rows[m][y][x] = sum;
        }
    }
    __syncthreads();
    const int64_t at = tile.at(l, (int(threadIdx.x) / kTile + kRadius) * kHalo +
                                      int(threadIdx.x) % kTile + kRadius);
    if (at < 0) return;
    const float image = l.image[tile.channel * plane + at], target = photo(l, tile.channel, at);
    const float d_ssim = along_column(rows[0]) + 2.0f * image * along_column(rows[1]) +
                         target * along_column(rows[2]);
    const float weight = l.weights ? l.weights[at] : 1.0f;
    const float sign = image > target ? weight : image < target ? -weight : 0.0f;
    l.gradient[tile.channel * plane + at] =
        l.scale() * ((1.0f - l.ssim_weight) * sign - l.ssim_weight * d_ssim);
}

// The loss and its parts, from the blocks' sums. One block; each of its threads takes every
// kPixels-th.
extern "C" __global__ void __launch_bounds__(kPixels) loss_terms(const Loss l) {
    __shared__ double similarities[kPixels], differences[kPixels];
    const int mine = int(threadIdx.x);
    double similarity = 0.0, difference = 0.0;
    for (int64_t block = mine; block < l.blocks; block += kPixels) {
        similarity += l.sums[2 * block];
        difference += l.sums[2 * block + 1];
    }
    similarities[mine] = similarity;
    differences[mine] = difference;
    for (int half = kPixels / 2; half; half /= 2) {
        __syncthreads();
        if (mine >= half) continue;
        similarities[mine] += similarities[mine + half];
        differences[mine] += differences[mine + half];
    }
    if (mine) return;
    const double scale = l.scale();
    const double l1 = differences[0] * scale, ssim = scale > 0.0 ? similarities[0] * scale : 1.0;
    l.terms[0] = float((1.0 - l.ssim_weight) * l1 + l.ssim_weight * (1.0 - ssim));
    l.terms[1] = float(l1);
    l.terms[2] = float(ssim);
}
