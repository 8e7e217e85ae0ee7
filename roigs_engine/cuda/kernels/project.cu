// From Gaussians in the world to splats on the image, and the tiles they touch. A thread per
// Gaussian.
#include "ellipses.h"
#include "frame.h"
#include "geometry.h"
#include "light.h"
#include "sh.h"

namespace roigs {

// The splat's columns, without colours. False: it cannot touch a pixel.
__device__ bool make_splat(const Geometry& g, const PixelBounds& bounds, float (&c)[kColumns]) {
    const float log2_opacity = log2(drawn_opacity(g));
    const float headroom = log2_opacity - (kLog2AlphaMin - kCullSlack);
    if (!(log2_opacity > kLog2AlphaMin)) return false;
    const float reach2 = max(headroom, 0.0f) / kExponentScale;
    const Whitening w = whitening(g);
    c[kX] = g.x;
    c[kY] = g.y;
    c[kL11] = w.l11;
    c[kL21] = w.l21;
    c[kL22] = w.l22;
    c[kLog2Opacity] = log2_opacity;
    c[kSlopeY] = g.xy / g.xx;
    c[kSlopeX] = g.xy / g.yy;
    c[kColour] = c[kColour + 1] = c[kColour + 2] = 0.0f;
    c[kDepth] = g.t[2];
    c[kReachX] = sqrt(reach2 * g.xx);
    c[kReachY] = sqrt(reach2 * g.yy);
    c[14] = c[15] = 0.0f;
    for (int k = 0; k < kColumns; ++k)
        if (!is_finite(c[k])) return false;
    return is_finite(g.determinant) && is_finite(g.opacity) &&
           g.x + c[kReachX] > bounds.left && g.x - c[kReachX] < bounds.right &&
           g.y + c[kReachY] > bounds.top && g.y - c[kReachY] < bounds.bottom;
}

// max(SH(direction) + 1/2, 0), or its light; false: a colour is not finite.
__device__ bool colour_splat(const Gaussians& gaussians, const Camera& camera, int64_t n,
                             const Geometry& g, float (&c)[kColumns]) {
    const int used = used_coefficients(gaussians);
    const float* sh = gaussians.sh + n * 3 * gaussians.sh_coefficients;
    float direction[3], basis[kMaxCoefficients];
    view_direction(g.mean, camera, direction);
    sh_basis(direction, basis);
    for (int k = 0; k < 3; ++k) {
        float colour = 0.5f;
        for (int i = 0; i < kMaxCoefficients; ++i)  // a fixed number: `basis` stays in registers
            if (i < used) colour += basis[i] * sh[3 * i + k];
        if (!is_finite(colour)) return false;
        colour = max(colour, 0.0f);
        c[kColour + k] = gaussians.linear_light ? to_linear(colour) : colour;
    }
    return true;
}

// Calls visit(tile) for the tiles that a splat touches, if they are in the camera's mask.
template <class Visit>
__device__ void for_each_tile(const Camera& camera, const float (&c)[kColumns],
                              const Visit& visit) {
    const PixelBounds bounds(camera);
    const Ellipses ellipse(c, camera);
    const int rows = to_ints(ellipse.rows.last - ellipse.rows.first) + 1;
    for (int r = 0; r < rows; ++r) {
        const TileRuns run = runs_in_row(ellipse, r, bounds, camera);
        for (int i = 0; i < run.length; ++i)
            if (!camera.tile_mask || camera.tile_mask[run.first + i]) visit(run.first + i);
    }
}

}  // namespace roigs

using namespace roigs;

// The camera's values, from matrices that only the card has. In double precision, because the eye
// is a difference of numbers that may be large.
extern "C" __global__ void __launch_bounds__(32) place_camera(const Frame f) {
    const int row = int(threadIdx.x);
    if (row >= 3) return;
    double eye = 0.0;
    for (int k = 0; k < 3; ++k) eye -= f.pose[4 * k + row] * f.pose[4 * k + 3];
    for (int k = 0; k < 4; ++k) f.camera_values[4 * row + k] = float(f.pose[4 * row + k]);
    f.camera_values[12 + row] = float(eye);
    if (row < 2) {
        f.camera_values[15 + row] = f.intrinsics[4 * row];      // focal lengths
        f.camera_values[17 + row] = f.intrinsics[3 * row + 2];  // principal point
    }
    f.camera_values[19 + row] = f.background[row];
}

extern "C" __global__ void __launch_bounds__(128) project(const Frame f) {
    const int64_t n = thread_index();
    if (n >= f.gaussians.count) return;
    int count = 0;
    float c[kColumns];
    Geometry g;
    const int32_t id = int32_t(n);
    const Camera camera = f.camera();
    if (project_centres(f.gaussians, camera, &id, g)) {
        project_shapes(f.gaussians, camera, &id, g);
        if (in_front(g, camera) && make_splat(g, PixelBounds(f.shape), c) &&
            colour_splat(f.gaussians, camera, n, g, c))
            for_each_tile(f.shape, c, [&](int) { ++count; });
    }
    f.pair_counts[n] = count;
    f.visible[n] = count > 0;
    f.depths[n] = count ? c[kDepth] : __int_as_float(0x7f800000);
    if (count)
        for (int k = 0; k < kColumns; ++k) f.splats[n * kColumns + k] = c[k];
}

// Fills the slots, Gaussian by Gaussian from front to back. Only a stable sort by tile remains to
// be done. If there are not enough slots, the view is void.
extern "C" __global__ void __launch_bounds__(128) list_tiles(const Frame f) {
    const int64_t rank = thread_index();
    if (rank >= f.gaussians.count) return;
    const int64_t n = f.order[rank];
    const int count = f.pair_counts[n];
    if (!count) return;
    if (f.void_ && *f.void_) {  // as if nothing were visible: the following kernels find no entries
        f.pair_counts[n] = 0;
        f.visible[n] = 0;
        return;
    }
    int64_t slot = f.ends[rank] - count;
    f.first_slot[n] = int32_t(slot);
    float c[kColumns];
    for (int k = 0; k < kColumns; ++k) c[k] = f.splats[n * kColumns + k];
    for_each_tile(f.shape, c, [&](int tile) {
        if (f.short_tiles)
            f.short_tiles[slot] = int16_t(tile);
        else
            f.tiles[slot] = tile;
        f.ids[slot++] = int32_t(n);
    });
}

// Where each tile's entries begin, from the sorted tiles. A thread for each entry, and one more.
extern "C" __global__ void __launch_bounds__(128) begin_tiles(const Frame f) {
    const int64_t i = thread_index();
    if (i > f.pairs) return;
    const auto tile_of = [&](int64_t entry) {
        return f.short_sorted ? int(f.short_sorted[entry]) : int(f.sorted[entry]);
    };
    const int before = i ? tile_of(i - 1) : -1, now = i < f.pairs ? tile_of(i) : f.tile_count;
    for (int tile = before + 1; tile <= now; ++tile) f.tile_begin[tile] = int32_t(i);
}

// Where each tile's groups begin: one block sums their numbers, kPixels tiles at a time.
extern "C" __global__ void __launch_bounds__(kPixels) begin_groups(const Frame f) {
    __shared__ int sums[kPixels];
    const int mine = int(threadIdx.x);
    int total = 0;
    if (mine == 0) f.group_begin[0] = 0;
    for (int first = 0; first < f.tile_count; first += kPixels) {
        const int tile = first + mine;
        const bool is_there = tile < f.tile_count;
        const int entries = is_there ? f.tile_begin[tile + 1] - f.tile_begin[tile] : 0;
        sums[mine] = (entries + kGroup - 1) / kGroup;
        for (int step = 1; step < kPixels; step *= 2) {
            __syncthreads();
            const int earlier = mine >= step ? sums[mine - step] : 0;
            __syncthreads();
            sums[mine] += earlier;
        }
        __syncthreads();
        if (is_there) f.group_begin[tile + 1] = total + sums[mine];
        total += sums[kPixels - 1];
        __syncthreads();  // the next tiles' numbers overwrite these
    }
}
