// A 16x16 tile as the raster kernels see it: blocks of kLanes pixels, one vector each.
//
// Splats are taken from the tile's list in batches of 64. For each splat of a batch, the kernel
// first finds the blocks that its ellipse touches, for many blocks at once. Only these are visited.
#pragma once

#include "simd.h"
#include "view.h"

namespace roigs {

constexpr int kBlockColumns = kTile / kBlockWidth, kBlockRows = kTile / kBlockHeight;
constexpr int kBlocks = kBlockColumns * kBlockRows;
constexpr int kBatch = 64;  // splats at once: a bit each in a 64-bit word
constexpr int kAhead = 12;  // splats fetched early, because they are scattered in memory
static_assert(kBlocks <= 64 && kBlocks % kLanes == 0, "a bit per block; whole vectors of blocks");

constexpr uint64_t kAllBlocks = ~uint64_t(0) >> (64 - kBlocks);

// Pixel centres relative to the tile's corner.
struct TileLayout {
    alignas(64) float x[kBlocks][kLanes] = {}, y[kBlocks][kLanes] = {};  // of block b, lane i
    alignas(64) float block_x[kBlocks] = {}, block_y[kBlocks] = {};      // of block b's first pixel

    constexpr TileLayout() {
        for (int b = 0; b < kBlocks; ++b) {
            block_x[b] = (b % kBlockColumns) * kBlockWidth + 0.5f;
            block_y[b] = (b / kBlockColumns) * kBlockHeight + 0.5f;
            for (int i = 0; i < kLanes; ++i) {
                x[b][i] = block_x[b] + i % kBlockWidth;
                y[b][i] = block_y[b] + i / kBlockWidth;
            }
        }
    }
};
inline constexpr TileLayout kLayout{};

// The place of a tile in the image, and in planes of the camera's window.
struct TilePlace {
    int x, y, width, height;  // its corner; the image's size
    int64_t stride, plane;    // pixels of a row, and of a plane

    TilePlace(const View& view, int64_t tile)
        : TilePlace(view.camera, view.masked ? view.tile_place[tile] : int32_t(tile),
                    view.tile_columns()) {}
    TilePlace(const Camera& camera, int32_t place, int columns)
        : x((camera.tile_x0 + place % columns) * kTile),
          y((camera.tile_y0 + place / columns) * kTile),
          width(camera.width),
          height(camera.height),
          stride(camera.window_x1 - camera.window_x0),
          plane(stride * (camera.window_y1 - camera.window_y0)),
          before_(camera.window_y0 * stride + camera.window_x0) {}

    int block_x(int b) const { return x + (b % kBlockColumns) * kBlockWidth; }
    int block_y(int b) const { return y + (b / kBlockColumns) * kBlockHeight; }
    bool block_is_whole(int b) const {
        return block_x(b) + kBlockWidth <= width && block_y(b) + kBlockHeight <= height;
    }
    bool block_is_outside(int b) const { return block_x(b) >= width || block_y(b) >= height; }

    // The block's part of a plane; lanes outside the image hold 0.
    Floats load_block(const float* plane, int b) const {
        alignas(64) float lanes[kLanes] = {};
        for_rows(b, [&](int64_t pixel, int lane, size_t bytes) {
            std::memcpy(lanes + lane, plane + pixel, bytes);
        });
        return load(lanes);
    }
    void store_block(float* plane, int b, Floats value) const {
        alignas(64) float lanes[kLanes];
        store(lanes, value);
        for_rows(b, [&](int64_t pixel, int lane, size_t bytes) {
            std::memcpy(plane + pixel, lanes + lane, bytes);
        });
    }
    // Starts fetching the tile's part of a plane, to be read or written later.
    template <bool kWrite>
    void prefetch(const float* plane) const {
        const int rows = std::min(height - y, kTile);
        for (int r = 0; r < rows; ++r)
            __builtin_prefetch(plane + at(x, y + r), kWrite);
    }
    // 1 if the lane is a pixel of the image, else 0. As an initial transmittance, 0 ensures that
    // lanes outside the image have no weight anywhere and do not delay a block's end.
    Floats start_transmittance(int b) const {
        if (block_is_whole(b)) return splat(1.0f);
        const Floats right = float(width - x) - load(kLayout.x[b]);
        const Floats below = float(height - y) - load(kLayout.y[b]);
        return keep(both(greater(right, Floats{}), greater(below, Floats{})), splat(1.0f));
    }

private:
    int64_t at(int column, int row) const { return row * stride + column - before_; }

    template <class F>
    void for_rows(int b, const F& copy) const {
        const int64_t first = at(block_x(b), block_y(b));
        if (block_is_whole(b)) {  // the sizes are constants here, so each copy is a single move
            for (int r = 0; r < kBlockHeight; ++r)
                copy(first + r * stride, r * kBlockWidth, sizeof(float) * kBlockWidth);
            return;
        }
        const int columns = std::min(width - block_x(b), kBlockWidth);
        const int rows = std::min(height - block_y(b), kBlockHeight);
        for (int r = 0; r < rows && columns > 0; ++r)
            copy(first + r * stride, r * kBlockWidth, sizeof(float) * columns);
    }

    int64_t before_;  // the window's first pixel, if the image's were number 0
};

// The values of a splat that blending needs. For the pixel at (x, y) from the tile's corner, the
// whitened offset is (l11 x + l21 y + u0, l22 y + v0).
struct LocalSplat {
    float l11, l21, u0, l22, v0, log2_opacity;
    float red, green, blue, depth;
    int32_t slot;

    LocalSplat() = default;
    LocalSplat(const Splat& s, int32_t slot_, float centre_x, float centre_y)
        : l11(s.l11),
          l21(s.l21),
          u0(-(s.l11 * centre_x + s.l21 * centre_y)),
          l22(s.l22),
          v0(-s.l22 * centre_y),
          log2_opacity(s.log2_opacity),
          red(s.red),
          green(s.green),
          blue(s.blue),
          depth(s.depth),
          slot(slot_) {}
};

// The blocks in which alpha can reach 1/255, a bit each. Exact for the hull of a block's pixel
// centres: the exponent is concave, so over a rectangle it is largest on an edge that faces the
// centre. On that edge, the largest value is at the unconstrained maximum along it (slope_x,
// slope_y), clamped.
ROIGS_INLINE uint64_t touched_blocks(const Splat& s, float centre_x, float centre_y) {
    const Floats least = splat(kLog2AlphaMin - kCullSlack - s.log2_opacity), zero = {};
    const auto exponent = [&](Floats x, Floats y) {
        const Floats u = s.l11 * x + s.l21 * y, v = s.l22 * y;
        return -(u * u) - v * v;
    };
    uint64_t touched = 0;
    for (int first = 0; first < kBlocks; first += kLanes) {
        const Floats left = load(&kLayout.block_x[first]) - centre_x;
        const Floats top = load(&kLayout.block_y[first]) - centre_y;
        const Floats right = left + float(kBlockWidth - 1), bottom = top + float(kBlockHeight - 1);
        const Floats near_x = clamp(zero, left, right), near_y = clamp(zero, top, bottom);
        const Floats on_x = exponent(near_x, clamp(near_x * s.slope_y, top, bottom));
        const Floats on_y = exponent(clamp(near_y * s.slope_x, left, right), near_y);
        touched |= uint64_t(bits(greater(max(on_x, on_y), least))) << first;
    }
    return touched;
}

// Swaps bit i of words[b] with bit b of words[i], within squares of kBlocks by kBlocks bits, by
// swapping smaller and smaller squares.
inline void transpose_squares(uint64_t (&words)[64]) {
    for (int half = std::min(kBlocks / 2, 32); half; half /= 2) {
        const uint64_t low = ~uint64_t(0) / ((uint64_t(1) << half) + 1);
        for (int base = 0; base < kBlocks; base += 2 * half)
            for (int i = base; i < base + half; ++i) {
                const uint64_t swap = ((words[i] >> half) ^ words[i + half]) & low;
                words[i] ^= swap << half;
                words[i + half] ^= swap;
            }
    }
}

// From "blocks per splat" to "splats per block": bit i of words[b] gets the value of bit b of
// words[i]. Words have kBlocks bits at first, so the result consists of squares side by side.
inline void transpose_to_blocks(uint64_t (&words)[64]) {
    for (int half = 32; half >= kBlocks; half /= 2)
        for (int i = 0; i < half; ++i) words[i] |= words[i + half] << half;
    transpose_squares(words);
}

// The inverse; reads kBlocks words. Bits after the first kBlocks of a result word are undefined.
inline void transpose_to_splats(uint64_t (&words)[64]) {
    transpose_squares(words);
    for (int i = kBlocks; i < 64; ++i) words[i] = words[i % kBlocks] >> (i - i % kBlocks);
}

struct Batch {
    LocalSplat splats[kBatch + 1];  // the last one draws nothing
    uint64_t splats_of[kBatch];     // per block, a bit for each splat that touches it
    int16_t entry_of[kBatch];       // the number of a splat's entry, of those taken
    int count = 0;

    Batch() {
        splats[kBatch] = {};
        splats[kBatch].log2_opacity = 2 * kLog2AlphaMin;
    }
};

// Takes up to kBatch entries and keeps those that touch a live block. Calls note(i, blocks) with
// the live blocks that entry i touches; there may be none. Returns the number of entries taken.
template <class Note>
ROIGS_INLINE int take_batch(const View& view, const TileEntry* entries, int64_t left,
                            const TilePlace& place, uint64_t live, Batch& batch,
                            const Note& note) {
    const int taken = int(std::min<int64_t>(left, kBatch));
    batch.count = 0;
    std::fill_n(batch.splats_of, kBatch, 0);
    for (int i = 0; i < taken; ++i) {
        __builtin_prefetch(&view.splats[entries[std::min<int64_t>(i + kAhead, left - 1)].splat]);
        const Splat& s = view.splats[entries[i].splat];
        const float x = s.x - float(place.x), y = s.y - float(place.y);
        const uint64_t blocks = touched_blocks(s, x, y) & live;
        note(i, blocks);
        if (!blocks) continue;
        batch.entry_of[batch.count] = int16_t(i);
        batch.splats[batch.count] = LocalSplat(s, entries[i].slot, x, y);
        batch.splats_of[batch.count++] = blocks;  // still blocks per splat
    }
    transpose_to_blocks(batch.splats_of);
    return taken;
}

// log2(alpha) of a splat at pixels, before alpha is cut off or capped, and the pixels' whitened
// offset.
ROIGS_INLINE Floats exponent_at(const LocalSplat& s, Floats x, Floats y, Floats& u, Floats& v) {
    u = s.l11 * x + (s.l21 * y + s.u0);
    v = s.l22 * y + s.v0;
    return (s.log2_opacity - u * u) - v * v;
}

// Alpha, and the lanes in which it depends on the parameters: drawn and not capped.
ROIGS_INLINE Floats alpha_of(Floats exponent, Mask& moves) {
    const Mask drawn = greater(exponent, splat(kLog2AlphaMin));
    const Floats uncapped = exp2(exponent);
    moves = both(drawn, less(uncapped, splat(kAlphaMax)));
    return keep(drawn, min(uncapped, splat(kAlphaMax)));
}

// A splat's plane, with its centre relative to the tile's corner.
struct LocalPlane : SplatPlane {
    LocalPlane() = default;
    LocalPlane(const SplatPlane& plane, const TilePlace& place) : SplatPlane(plane) {
        x -= float(place.x);
        y -= float(place.y);
    }
};

// Its depth at pixels.
ROIGS_INLINE Floats plane_depth(const LocalPlane& p, Floats x, Floats y) {
    return p.depth + (p.slope_x * (x - p.x) + p.slope_y * (y - p.y));
}

// True if a splat of this weight lowers the remaining light of a pixel to below a half.
ROIGS_INLINE Mask is_median(Floats transmittance, Floats weight) {
    const Floats half = splat(0.5f), below = splat(0.49999997f);  // the next smaller float
    return both(greater(transmittance, below), less(transmittance - weight, half));
}

// The next splats of a block, evaluated side by side. One evaluation is a chain of some twenty
// operations that wait for each other. A processor looks about a hundred operations ahead. If there
// are several chains among these, it works on one while another waits.
template <int kTogether>
struct Together {
    int index[kTogether];     // in the batch
    uint64_t bit[kTogether];  // its bit in `todo`; 0: it draws nothing
    Floats alpha[kTogether];

    // Takes splats out of `todo`, front to back. If there are too few, some draw nothing.
    ROIGS_INLINE Together(const Batch& batch, uint64_t& todo, Floats x, Floats y) {
        for (int k = 0; k < kTogether; ++k) {
            index[k] = todo ? __builtin_ctzll(todo) : kBatch;
            bit[k] = todo & -todo;
            todo &= todo - 1;
        }
        Floats exponent[kTogether], u, v;
        Mask moves;
        for (int k = 0; k < kTogether; ++k)
            exponent[k] = exponent_at(batch.splats[index[k]], x, y, u, v);
        for (int k = 0; k < kTogether; ++k) alpha[k] = alpha_of(exponent[k], moves);
    }
};

}  // namespace roigs
