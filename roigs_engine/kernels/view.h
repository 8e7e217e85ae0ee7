// The data that the stages of one rendering pass to each other. roigs.h has their order.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <type_traits>
#include <utility>
#include <vector>

#include "constants.h"
#include "roigs.h"
#include "simd.h"

namespace roigs {

constexpr int kChunk = 1024;  // Gaussians per task
constexpr int64_t kMostIntersections = std::numeric_limits<int32_t>::max();  // slots are int32

// Reused memory for plain values. It grows and is never cleared. Its content is lost when it grows,
// except in `extend`. Returns false if there is not enough memory; then it is empty.
template <class T>
class Scratch {
public:
    Scratch() = default;
    Scratch(Scratch&& other) noexcept { swap(other); }
    Scratch& operator=(Scratch&& other) noexcept {
        swap(other);
        return *this;
    }
    ~Scratch() { std::free(block_); }

    [[nodiscard]] bool reserve(int64_t count) { return extend(count, 0); }

    // Room for `count` elements; the first `used` are kept.
    [[nodiscard]] bool extend(int64_t count, int64_t used) {
        if (count <= capacity_) return true;
        if (!used) Scratch().swap(*this);  // so that old and new are not both in memory
        Scratch larger;
        const int64_t wanted = count + count / 4;  // room for the next, slightly larger frame
        larger.block_ = std::malloc(sizeof(T) * wanted + kAlignment);
        if (larger.block_) {
            const auto address = reinterpret_cast<uintptr_t>(larger.block_);
            larger.data_ = reinterpret_cast<T*>((address / kAlignment + 1) * kAlignment);
            larger.capacity_ = wanted;
            std::copy_n(data_, used, larger.data_);
        }
        swap(larger);
        return block_ != nullptr;
    }
    T& operator[](int64_t i) const { return data_[i]; }
    T* data() const { return data_; }

private:
    static constexpr uintptr_t kAlignment = 64;  // a cache line, and the widest vector

    void swap(Scratch& other) {
        std::swap(block_, other.block_);
        std::swap(data_, other.data_);
        std::swap(capacity_, other.capacity_);
    }
    void* block_ = nullptr;
    T* data_ = nullptr;
    int64_t capacity_ = 0;
};

// A projected Gaussian: one cache line.
//
// The exponent is kept in whitened form. With d the pixel's offset from the centre, Sigma' the 2D
// covariance, and Sigma'^-1 = L L^T / kExponentScale (L lower triangular),
//
//     (u, v) = L^T d = (l11 dx + l21 dy, l22 dy)
//     alpha  = opacity exp(-1/2 d^T Sigma'^-1 d) = 2^(log2_opacity - u^2 - v^2).
//
// This costs fewer operations than the quadratic form. Rounding never makes it positive, and
// gradients need no inverse (projection_backward.cpp).
struct alignas(64) Splat {
    float x, y;  // centre, px
    float l11, l21, l22;
    float log2_opacity;
    float slope_y;  // dy / dx of the line on which alpha is largest for a given dx
    float slope_x;  // dx / dy of the line on which alpha is largest for a given dy
    float red, green, blue;
    float depth;
    float reach_x, reach_y;  // half size of the box around alpha >= 1/255, px
    int32_t id;              // row of the Gaussian
    int32_t has_gradient;    // 0; roigs_render_backward sets it to 1 if a pixel gives it one
};
static_assert(sizeof(Splat) == 64, "a splat fills one cache line");

// The plane of a splat (plane.h): its depth at a pixel is depth + slope . (pixel - (x, y)).
struct alignas(32) SplatPlane {
    float x, y, depth;  // of the splat
    float slope_x, slope_y;
    float normal[3];
};

// An entry of a tile's list. `slot` numbers the (Gaussian, tile) pairs so that the pairs of one
// Gaussian are neighbours. Each tile stores its results for the Gaussian there, and they are summed
// later. So two threads never add to the same place, and sums do not depend on the number of
// threads.
struct TileEntry {
    int32_t splat;
    int32_t slot;
};

// Blocks of a tile (tile.h), a bit each: 16, 32 or 64 of them.
using BlockSet = std::conditional_t<
    kLanes == 16, uint16_t, std::conditional_t<kLanes == 8, uint32_t, uint64_t>>;

struct alignas(64) SlotGradient {
    float sum[16];  // kMoments or kSurfaceMoments are used; writing whole cache lines is faster
};

// Chunk c owns the Gaussians, and the places in View::splats and View::tiles_of, from c * kChunk
// on. It packs its visible Gaussians at the front, so only the places of visible Gaussians are
// touched.
struct Chunk {
    int32_t visible = 0;        // number of splats
    bool listed = false;        // `tiles` holds them all
    int64_t first_visible = 0;  // splats in the chunks before it
    int64_t tile_count = 0;     // number of (Gaussian, tile) pairs
    int64_t first_slot = 0;     // slot of the first pair
    Scratch<uint32_t> tiles;    // tiles touched, splat by splat
    Scratch<int32_t> runs;      // used while tiles are found, see tile_lists.h
};

struct TileSpan {
    int32_t first;  // index into Chunk::tiles
    int32_t count;
};

// Tiles have numbers, row by row within the camera's rectangle of tiles; with a mask, only the
// tiles in the mask. So a run of neighbouring tiles has neighbouring numbers, with or without a
// mask.
struct View {
    Camera camera;
    bool masked = false;
    int64_t tiles = 0;            // tiles to draw
    Scratch<int32_t> tile_rank;   // masked: per place of the rectangle, wanted tiles before it
    Scratch<int32_t> tile_sums;   // masked: (rows + 1, columns + 1) wanted tiles above and left
    Scratch<int32_t> tile_place;  // masked: per tile, its place in the rectangle
    std::vector<Chunk> chunks;
    Scratch<Splat> splats;
    Scratch<SplatPlane> planes;  // per splat, if roigs_project_planes made them
    bool has_plane_gradient = false;  // roigs_render_backward got the gradient of a surface
    Scratch<TileSpan> tiles_of;  // per splat

    int64_t visible = 0;        // splats in all chunks
    int64_t intersections = 0;  // (Gaussian, tile) pairs
    Scratch<int64_t> tile_begin;  // (tiles + 1,) where a tile's entries begin
    Scratch<TileEntry> entries;   // (intersections,), per tile, front to back
    // (intersections,) per entry, two sets of the tile's blocks: those in which roigs_render found
    // a weight above Camera::min_transmittance, and others that it may draw in, in front of a splat
    // that is seen there
    Scratch<BlockSet> seen_in, passed_in;

    Scratch<uint32_t> depth_keys[2];  // (visible,), ping and pong of the radix sort
    Scratch<int32_t> depth_order[2];
    Scratch<int32_t> histograms;

    Scratch<SlotGradient> slot_gradients;  // (intersections,)
    Scratch<float> slot_max_weights;       // (intersections,)
    Scratch<float> slot_weight_sums;       // (intersections,)
    Scratch<int64_t> tile_visits;          // (tiles,) visits of a splat to a block, for counting

    int tile_columns() const { return camera.tile_x1 - camera.tile_x0; }
    int tile_rows() const { return camera.tile_y1 - camera.tile_y0; }
    int64_t places() const { return int64_t(tile_columns()) * tile_rows(); }
    int64_t slot(int32_t splat) const {
        return chunks[splat / kChunk].first_slot + tiles_of[splat].first;
    }
};

}  // namespace roigs
