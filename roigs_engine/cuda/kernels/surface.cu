// Depth and normals of the Gaussians' planes (kernels/plane.h), and the gradient of their blending.
// It is added to the gradient of the colours (gradient.cu). These are separate passes, so pictures
// without a surface pay nothing for them.
#include "plane.h"
#include "walk.h"

namespace roigs {

// A splat's plane, with its centre relative to the tile's corner.
struct LocalPlane {
    float x, y, depth, slope_x, slope_y, normal[3];

    LocalPlane() = default;
    LocalPlane(const float* columns, const TilePlace& place)
        : x(columns[0] - float(place.x)),
          y(columns[1] - float(place.y)),
          depth(columns[2]),
          slope_x(columns[3]),
          slope_y(columns[4]),
          normal{columns[5], columns[6], columns[7]} {}

    ROIGS_INLINE float at(int pixel) const {
        const float dx = float(pixel % kTile) + 0.5f - x, dy = float(pixel / kTile) + 0.5f - y;
        return depth + (slope_x * dx + slope_y * dy);
    }
};

// True if a splat of this weight lowers the remaining light of a pixel to below a half.
ROIGS_INLINE bool is_median(float left, float weight) {
    return left >= 0.5f && left - weight < 0.5f;
}

// dL / d(alpha, depth, median depth, normal) of a pixel, and the sum of all splats' parts of the
// loss.
struct SurfacePixel {
    float alpha, depth, median, normal[3], total;

    ROIGS_INLINE float value(const LocalPlane& plane, float z) const {
        return alpha + depth * z + normal[0] * plane.normal[0] + normal[1] * plane.normal[1] +
               normal[2] * plane.normal[2];
    }
};

__device__ SurfacePixel surface_pixel(const Frame& f, const TilePlace& place, int pixel) {
    SurfacePixel p = {};
    if (!place.has(pixel)) return p;
    const int64_t plane = place.plane(), at = place.at(pixel);
    const float* gradient = f.surface_gradient + at;
    const float* drawn = f.out.surface + at;
    p.alpha = gradient[0];
    p.depth = gradient[plane];
    p.median = gradient[2 * plane];
    p.total = p.alpha * f.out.alpha[at] + p.depth * drawn[0];
    for (int k = 0; k < 3; ++k) {
        p.normal[k] = gradient[(3 + k) * plane];
        p.total += p.normal[k] * drawn[(2 + k) * plane];
    }
    return p;
}

}  // namespace roigs

using namespace roigs;

extern "C" __global__ void __launch_bounds__(128) project_planes(const Frame f) {
    const int64_t n = thread_index();
    if (n >= f.gaussians.count || !f.pair_counts[n]) return;
    const Camera camera = f.camera();
    const int32_t id = int32_t(n);
    Geometry g;
    project_centres(f.gaussians, camera, &id, g);
    project_shapes(f.gaussians, camera, &id, g);
    const Plane p = plane_of(g, camera);
    float* out = f.planes + n * kPlaneColumns;
    out[0] = g.x;
    out[1] = g.y;
    out[2] = g.t[2];
    out[3] = p.slope[0];
    out[4] = p.slope[1];
    for (int k = 0; k < 3; ++k) out[5 + k] = p.normal[k];
}

extern "C" __global__ void __launch_bounds__(kPixels) blend_surface(const Frame f) {
    __shared__ LocalSplat splats[kPixels];
    __shared__ LocalPlane planes[kPixels];
    const int tile = int(blockIdx.x), pixel = int(threadIdx.x);
    if (f.shape.tile_mask && !f.shape.tile_mask[tile]) return;
    const TilePlace place(f.shape, tile);
    const int end = f.tile_begin[tile + 1];
    const bool inside = place.has(pixel);
    float4* checkpoint = f.surface_checkpoints
                             ? f.surface_checkpoints +
                                   int64_t(f.group_begin[tile]) * (kGroup / kBucket) * kPixels + pixel
                             : nullptr;
    const float least = f.shape.min_transmittance;
    float left = inside ? 1.0f : 0.0f, depth = 0.0f, median = 0.0f, x = 0.0f, y = 0.0f, z = 0.0f;
    for (int begin = f.tile_begin[tile]; begin < end; begin += kPixels) {
        if (!__syncthreads_or(left > least)) break;
        if (begin + pixel < end) {
            const int64_t n = f.ids[f.entries[begin + pixel]];
            splats[pixel] = LocalSplat(f.splats + n * kColumns, place);
            planes[pixel] = LocalPlane(f.planes + n * kPlaneColumns, place);
        }
        __syncthreads();
        for (int i = 0; i < kPixels && begin + i < end; ++i) {
            if (checkpoint && i % kBucket == 0) {
                *checkpoint = make_float4(depth, x, y, z);
                checkpoint += kPixels;
            }
            if (!(left > least)) continue;
            const LocalPlane& plane = planes[i];
            const float weight = Sample(splats[i], pixel).alpha * left, at = plane.at(pixel);
            if (is_median(left, weight)) median = at;
            left -= weight;
            depth += weight * at;
            x += weight * plane.normal[0];
            y += weight * plane.normal[1];
            z += weight * plane.normal[2];
        }
    }
    if (!inside) return;
    float* out = f.out.surface + place.at(pixel);
    const float values[5] = {depth, median, x, y, z};
    for (int k = 0; k < 5; ++k) out[k * place.plane()] = values[k];
}

// Adds to the moments that `gradient` has written, and writes those of the planes.
extern "C" __global__ void __launch_bounds__(kGroup) surface_gradient(const Frame f) {
    __shared__ SurfacePixel pixels[kPixels];
    if (int(blockIdx.x) >= f.group_begin[f.tile_count]) return;
    const Group group(f, int(blockIdx.x));
    const TilePlace place(f.shape, group.tile);
    for (int p = int(threadIdx.x); p < kPixels; p += kGroup) pixels[p] = surface_pixel(f, place, p);
    __syncthreads();

    LocalSplat s = {};
    LocalPlane plane = {};
    int64_t slot = 0;
    if (group.is_there) {
        slot = f.entries[group.entry];
        s = LocalSplat(f.splats + int64_t(f.ids[slot]) * kColumns, place);
        plane = LocalPlane(f.planes + int64_t(f.ids[slot]) * kPlaneColumns, place);
    }
    float sum[kSurfaceMoments] = {};
    const int bucket = int(blockIdx.x) * (kGroup / kBucket) + int(threadIdx.x) / kBucket;
    const float4* drawn = f.surface_checkpoints + int64_t(bucket) * kPixels;
    const auto behind = [&](int pixel, const float4& c) {
        const SurfacePixel& p = pixels[pixel];
        const float4 d = drawn[pixel];
        return p.total - (p.alpha * (1.0f - c.x) + p.depth * d.x + p.normal[0] * d.y +
                          p.normal[1] * d.z + p.normal[2] * d.w);
    };
    const auto visit = [&](const Sample& at, int pixel, float left, float& state) {
        const SurfacePixel& p = pixels[pixel];
        const float weight = at.alpha * left, value = p.value(plane, plane.at(pixel));
        state -= weight * value;
        if (!(weight > f.shape.min_transmittance)) return;
        const float alpha_gradient = left * value - __fdividef(state, 1.0f - at.alpha);
        const float g = at.is_capped ? 0.0f : at.alpha * alpha_gradient;
        sum[kS] += g;
        sum[kSU] += g * at.u;
        sum[kSV] += g * at.v;
        sum[kSUU] += g * at.u * at.u;
        sum[kSUV] += g * at.u * at.v;
        sum[kSVV] += g * at.v * at.v;
        const float depth = weight * p.depth + (is_median(left, weight) ? p.median : 0.0f);
        sum[kPlaneDepth] += depth;
        sum[kPlaneX] += depth * (float(pixel % kTile) + 0.5f - plane.x);
        sum[kPlaneY] += depth * (float(pixel / kTile) + 0.5f - plane.y);
        for (int k = 0; k < 3; ++k) sum[kNormal + k] += weight * p.normal[k];
    };
    if (group.is_blended) walk(f, group, bucket, s, behind, visit);
    if (!group.is_there) return;
    for (int k = 0; k < kRed; ++k) f.moments[slot * kMoments + k] += sum[k];
    for (int k = kMoments; k < kSurfaceMoments; ++k)
        f.plane_moments[slot * kPlaneMoments + k - kMoments] = sum[k];
}
