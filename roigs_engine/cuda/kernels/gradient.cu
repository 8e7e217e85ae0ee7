// Gradient of the blending; kernels/tile_gradient.h has the formulas. Front to back, a Gaussian per
// lane (walk.h). Every slot is written.
#include "walk.h"

using namespace roigs;

extern "C" __global__ void __launch_bounds__(kGroup) gradient(const Frame f) {
    __shared__ float4 pixels[kPixels];  // dL / d(colour), and its product with the colour
    if (int(blockIdx.x) >= f.group_begin[f.tile_count]) return;
    const Group group(f, int(blockIdx.x));
    const TilePlace place(f.shape, group.tile);
    const int64_t plane = place.plane();
    for (int p = int(threadIdx.x); p < kPixels; p += kGroup) {
        float4 pixel = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
        if (place.has(p)) {
            const float* gradient = f.image_gradient + place.at(p);
            const float* image = f.out.image + place.at(p);
            pixel.x = gradient[0];
            pixel.y = gradient[plane];
            pixel.z = gradient[2 * plane];
            pixel.w = image[0] * pixel.x + image[plane] * pixel.y + image[2 * plane] * pixel.z;
        }
        pixels[p] = pixel;
    }
    __syncthreads();

    LocalSplat s = {};
    int64_t slot = 0;
    if (group.is_there) {
        slot = f.entries[group.entry];
        s = LocalSplat(f.splats + int64_t(f.ids[slot]) * kColumns, place);
    }
    float sum[kMoments] = {};
    const int bucket = int(blockIdx.x) * (kGroup / kBucket) + int(threadIdx.x) / kBucket;
    const auto behind = [&](int p, const float4& c) {
        const float4& pixel = pixels[p];
        return pixel.w - (c.y * pixel.x + c.z * pixel.y + c.w * pixel.z);
    };
    const auto visit = [&](const Sample& at, int p, float left, float& state) {
        const float4& pixel = pixels[p];
        const float weight = at.alpha * left;
        const float colour = pixel.x * s.red + pixel.y * s.green + pixel.z * s.blue;
        state -= weight * colour;
        if (!(weight > f.shape.min_transmittance)) return;
        const float alpha_gradient = left * colour - __fdividef(state, 1.0f - at.alpha);
        const float g = at.is_capped ? 0.0f : at.alpha * alpha_gradient;
        const float gu = g * at.u, gv = g * at.v;
        sum[kS] += g;
        sum[kSU] += gu;
        sum[kSV] += gv;
        sum[kSUU] += gu * at.u;
        sum[kSUV] += gu * at.v;
        sum[kSVV] += gv * at.v;
        sum[kRed] += weight * pixel.x;
        sum[kGreen] += weight * pixel.y;
        sum[kBlue] += weight * pixel.z;
    };
    if (group.is_blended) walk(f, group, bucket, s, behind, visit);
    if (group.is_there)
        for (int k = 0; k < kMoments; ++k) f.moments[slot * kMoments + k] = sum[k];
}
