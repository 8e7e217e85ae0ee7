// What the kernels of one view hand on to each other: cuda/bindings.py has the same structures, and
// rasterize/cuda.py makes the arrays and launches the kernels in this order:
//
//     place_camera, project, list_tiles, begin_tiles, begin_groups, blend, [median_depth],
//     [weigh, fold_weights], [gradient, project_backward or project_backward_adam]
//
// with a surface project_planes and blend_surface behind blend, and surface_gradient behind gradient.
//
// A (Gaussian, tile) pair has a slot: those of one Gaussian are neighbours. What a tile finds out
// about a Gaussian is stored there and summed later, so no two threads ever add to one place: the
// same view gives the same bits each time.
#pragma once

#include "constants.h"
#include "scalar.h"
#include "types.h"

namespace roigs {

constexpr int kPixels = kTile * kTile;  // of a tile; threads of a block that blends
constexpr int kBucket = 32;             // Gaussians of a warp that walks over a tile's pixels
constexpr int kGroup = 128;             // .. and of a block, whose warps share the pixels
constexpr int kColumns = 16;            // of a splat, in the order of Splat in kernels/view.h
constexpr int kParameters = 5;          // means, quats, scales, opacities, sh

constexpr int kPlaneColumns = 8;        // of a splat's plane, in the order of SplatPlane there
constexpr int kPlaneMoments = kSurfaceMoments - kMoments;

enum Column { kX, kY, kL11, kL21, kL22, kLog2Opacity, kSlopeY, kSlopeX, kColour, kDepth = 11,
              kReachX, kReachY };

struct Frame {
    Gaussians gaussians;
    Camera shape;                // sizes, limits, tiles; what is in front of these is in
    const double* pose;          // (4, 4) world_to_camera
    const float* intrinsics;     // (3, 3)
    const float* background;     // (3,)
    float* camera_values;        // (22,) pose, eye, intrinsics, background: no copy to wait for
    // of each Gaussian
    float* splats;           // (N, kColumns)
    float* planes;           // (N, kPlaneColumns)
    float* depths;           // (N,) infinity: not drawn
    int32_t* pair_counts;    // (N,) slots
    int32_t* first_slot;     // (N,)
    uint8_t* visible;        // (N,)
    const int64_t* order;    // (N,) front to back
    const int64_t* ends;     // (N,) in that order: the slot behind the Gaussian's last one
    const uint8_t* void_;    // (1,) null, or whether there are not enough slots: draw nothing
    // of each slot
    int16_t* short_tiles;    // (pairs,) its tile; this one, or ..
    int32_t* tiles;          // .. where there are too many tiles for it, this one
    int32_t* ids;            // (pairs,) its Gaussian
    float* moments;          // (pairs, kMoments)
    float* plane_moments;    // (pairs, kPlaneMoments) null: no gradient of a surface
    float* slot_largest;     // (pairs,) largest weight
    float* slot_sums;        // (pairs,) sum of weights
    // of each tile's list
    int64_t pairs;               // entries: those of the tiles, then unused ones
    const int16_t* short_sorted; // (pairs,) their tiles, `tile_count` for unused ones; ..
    const int32_t* sorted;       // .. as short_tiles and tiles
    const int64_t* entries;      // (pairs,) slots, tile by tile, front to back
    int32_t* tile_begin;         // (tiles + 1,)
    int32_t* group_begin;        // (tiles + 1,) groups of kGroup entries
    int32_t* reached;            // (tiles,) entries looked at until every pixel was opaque
    float4* checkpoints;         // (groups, kGroup / kBucket, kPixels) transmittance and colour in
                                 // front of each bucket; null: nobody will walk
    float4* surface_checkpoints; // the same of depth and normal
    // images
    Outputs out;                 // pixel_weights, max_weight and weight_sum are for `weigh`
    float* median;               // (H, W)
    const float* image_gradient; // (3, H, W)
    const float* surface_gradient;  // (6, H, W), OutputGradients
    // of the backward pass
    Gradients gradients;
    float* grad2d;               // (N,)
    int32_t tile_count;

    ROIGS_INLINE Camera camera() const {
        Camera whole = shape;
        memcpy(&whole, camera_values, 22 * sizeof(float));
        return whole;
    }
};

// A step of Adam on the rows that have a gradient, kernels/adam.h.
struct Step {
    Frame frame;
    AdamParameter parameters[kParameters];  // in the order of Gaussians
    float add1, add2;                       // 1 - beta1, 1 - beta2
    float epsilon;
    float inverse_sqrt_correction2;         // 1 / sqrt(1 - beta2^t)
    float rate_scale;                       // 1 / (1 - beta1^t)
    int32_t* skipped;                       // rows left out for a gradient that is not finite
    const float* row_rates;                 // (N,) factors of the rates; null: 1
};

ROIGS_INLINE int64_t thread_index() { return int64_t(blockIdx.x) * blockDim.x + threadIdx.x; }

// Where a tile lies in the image; tiles are numbered row by row in the camera's rectangle.
struct TilePlace {
    int x, y, width, height;
    TilePlace(const Camera& camera, int tile)
        : x((camera.tile_x0 + tile % (camera.tile_x1 - camera.tile_x0)) * kTile),
          y((camera.tile_y0 + tile / (camera.tile_x1 - camera.tile_x0)) * kTile),
          width(camera.width),
          height(camera.height) {}
    bool has(int pixel) const {
        return x + pixel % kTile < width && y + pixel / kTile < height;
    }
    int64_t at(int pixel) const {
        return int64_t(y + pixel / kTile) * width + x + pixel % kTile;
    }
    int64_t plane() const { return int64_t(width) * height; }
};

// What blending needs of a splat, with its centre relative to the tile's corner.
struct LocalSplat {
    float x, y, l11, l21, l22, log2_opacity, red, green, blue, depth;

    LocalSplat() = default;
    LocalSplat(const float* columns, const TilePlace& place)
        : x(columns[kX] - float(place.x)),
          y(columns[kY] - float(place.y)),
          l11(columns[kL11]),
          l21(columns[kL21]),
          l22(columns[kL22]),
          log2_opacity(columns[kLog2Opacity]),
          red(columns[kColour]),
          green(columns[kColour + 1]),
          blue(columns[kColour + 2]),
          depth(columns[kDepth]) {}
};

// A splat at a pixel of its tile, see Splat in kernels/view.h.
struct Sample {
    float u, v;      // whitened offset
    float alpha;     // 0: not drawn
    bool is_capped;  // alpha does not depend on the parameters

    Sample(const LocalSplat& s, int pixel) {
        const float dx = float(pixel % kTile) + 0.5f - s.x;
        const float dy = float(pixel / kTile) + 0.5f - s.y;
        u = s.l11 * dx + s.l21 * dy;
        v = s.l22 * dy;
        const float exponent = s.log2_opacity - u * u - v * v;
        const float uncapped = exp2(exponent);
        is_capped = uncapped >= kAlphaMax;
        alpha = exponent > kLog2AlphaMin ? (is_capped ? kAlphaMax : uncapped) : 0.0f;
    }
};

}  // namespace roigs
