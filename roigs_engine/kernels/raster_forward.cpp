// Blending front to back (3DGS, eq. 3): C = sum_i c_i alpha_i T_i, T_i = prod_{j<i} (1 - alpha_j).
#include <cstring>

#include "tile.h"

namespace roigs {
namespace {

struct Images {
    float *image, *alpha, *depth;  // depth may be null
};

// What a tile's pixels have gathered so far.
struct Gathered {
    Floats transmittance[kBlocks], red[kBlocks], green[kBlocks], blue[kBlocks], depth[kBlocks];
};

// Turns "blocks per splat" into "splats per block": bit i of words[b] becomes what bit b of
// words[i] was. Transposes the bit matrix by swapping ever smaller squares; while a square is
// wider than the matrix has columns, there is only one half to move.
void transpose_bits(uint64_t (&words)[64]) {
    for (int half = 32; half >= kBlocks; half /= 2)
        for (int i = 0; i < half; ++i) words[i] |= words[i + half] << half;
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

// Blends the splats of a batch whose bits are set in `todo` into block b. With the block's state
// in registers, this is the loop that rendering spends its time in. Returns false when the block
// has ended: nothing shines through any more. What is left in `todo` was not visited then.
template <bool kDepth, bool kMaxWeight>
ROIGS_INLINE bool blend_block(const Batch& batch, uint64_t& todo, int b, Gathered& gathered,
                              Floats* largest) {
    const Floats x = load(kLayout.x[b]), y = load(kLayout.y[b]);
    Floats transmittance = gathered.transmittance[b];
    Floats red = gathered.red[b], green = gathered.green[b], blue = gathered.blue[b];
    Floats depth = kDepth ? gathered.depth[b] : Floats{};
    bool alive = true;
    do {
        const int i = __builtin_ctzll(todo);
        todo &= todo - 1;
        const LocalSplat& s = batch.splats[i];
        Floats u, v;
        const Floats exponent = exponent_at(s, x, y, u, v);
        const Mask drawn = greater(exponent, splat(kLog2AlphaMin));
        const Floats alpha = keep(drawn, min(exp2(exponent), splat(kAlphaMax)));
        const Floats weight = alpha * transmittance;
        transmittance -= weight;
        red += weight * s.red;
        green += weight * s.green;
        blue += weight * s.blue;
        if (kDepth) depth += weight * s.depth;
        if (kMaxWeight) largest[i] = max(largest[i], weight);
        alive = any(greater(transmittance, splat(kTransmittanceEnd)));
    } while (todo && __builtin_expect(alive, 1));
    gathered.transmittance[b] = transmittance;
    gathered.red[b] = red;
    gathered.green[b] = green;
    gathered.blue[b] = blue;
    if (kDepth) gathered.depth[b] = depth;
    return alive;
}

void store_tile(const View& view, const TilePlace& place, const Gathered& g, const Images& out) {
    const int64_t plane = int64_t(place.width) * place.height;
    const float* background = view.camera.background;
    for (int b = 0; b < kBlocks; ++b) {
        if (place.block_is_outside(b)) continue;
        const Floats left = g.transmittance[b];
        place.store_block(out.image, b, g.red[b] + left * background[0]);
        place.store_block(out.image + plane, b, g.green[b] + left * background[1]);
        place.store_block(out.image + 2 * plane, b, g.blue[b] + left * background[2]);
        place.store_block(out.alpha, b, 1.0f - left);
        if (out.depth) {
            const Mask drawn = less(left, splat(1.0f));
            const Floats total = select(drawn, 1.0f - left, splat(1.0f));
            place.store_block(out.depth, b, keep(drawn, g.depth[b] / total));
        }
    }
}

float largest_lane(Floats x) {
    float m = x[0];
    for (int i = 1; i < kLanes; ++i) m = std::max(m, x[i]);
    return m;
}

template <bool kDepth, bool kMaxWeight>
void render_tile(const View& view, int64_t tile, const Images& out) {
    const TilePlace place(view, tile);
    Gathered gathered;
    uint64_t live = kAllBlocks;
    for (int b = 0; b < kBlocks; ++b) {
        gathered.transmittance[b] = place.start_transmittance(b);
        gathered.red[b] = gathered.green[b] = gathered.blue[b] = gathered.depth[b] = Floats{};
        if (place.block_is_outside(b)) live &= ~(uint64_t(1) << b);
    }
    const int64_t end = view.tile_begin[tile + 1];
    Batch batch;
    Floats largest[kMaxWeight ? kBatch : 1];
    int64_t visits = 0;
    for (int64_t k = view.tile_begin[tile]; k < end && live;) {
        k += take_batch(view, &view.entries[k], end - k, place, live, batch, [](int32_t) {});
        std::fill(batch.blocks + batch.count, batch.blocks + kBatch, 0);
        transpose_bits(batch.blocks);
        if (kMaxWeight) std::fill(largest, largest + batch.count, Floats{});
        for (uint64_t todo = live; todo; todo &= todo - 1) {
            const int b = __builtin_ctzll(todo);
            uint64_t splats = batch.blocks[b];
            if (!splats) continue;
            visits += __builtin_popcountll(splats);
            if (!blend_block<kDepth, kMaxWeight>(batch, splats, b, gathered, largest))
                live &= ~(uint64_t(1) << b);
            visits -= __builtin_popcountll(splats);
        }
        for (int i = 0; kMaxWeight && i < batch.count; ++i)
            view.slot_weights[batch.splats[i].slot] = largest_lane(largest[i]);
    }
    store_tile(view, place, gathered, out);
    view.tile_visits[tile] = visits;
}

// Outside the tiles worked on: nothing but background.
void fill_background(const View& view, const Images& out) {
    const int64_t plane = int64_t(view.camera.width) * view.camera.height;
    for (int c = 0; c < 3; ++c)
        std::fill_n(out.image + c * plane, plane, view.camera.background[c]);
    std::fill_n(out.alpha, plane, 0.0f);
    if (out.depth) std::fill_n(out.depth, plane, 0.0f);
}

void raise_max_weights(const View& view, float* max_weight) {
    parallel_for(int64_t(view.chunks.size()), [&](int64_t c) {
        for (int i = 0; i < view.chunks[c].visible; ++i) {
            const int32_t splat = int32_t(c * kChunk + i);
            const float* weights = &view.slot_weights[view.slot(splat)];
            float& largest = max_weight[view.splats[splat].id];
            for (int t = 0; t < view.tiles_of[splat].count; ++t)
                largest = std::max(largest, weights[t]);
        }
    });
}

bool covers_image(const View& view) {
    const Camera& c = view.camera;
    return c.tile_x0 == 0 && c.tile_y0 == 0 && c.tile_x1 * kTile >= c.width &&
           c.tile_y1 * kTile >= c.height;
}

}  // namespace
}  // namespace roigs

int64_t roigs_render(roigs::View* view, float* image, float* alpha, float* depth,
                     float* max_weight) {
    using namespace roigs;
    const Images out{image, alpha, depth};
    if (!view->tile_visits.reserve(view->tiles())) return kOutOfMemory;
    if (max_weight) {
        if (!view->slot_weights.reserve(view->intersections)) return kOutOfMemory;
        std::fill_n(view->slot_weights.data(), view->intersections, 0.0f);
    }
    if (!covers_image(*view)) fill_background(*view, out);
    auto* render = max_weight ? (depth ? render_tile<true, true> : render_tile<false, true>)
                              : (depth ? render_tile<true, false> : render_tile<false, false>);
    parallel_for(view->tiles(), [&](int64_t tile) { render(*view, tile, out); });
    if (max_weight) raise_max_weights(*view, max_weight);
    return 0;
}

int64_t roigs_pair_evaluations(const roigs::View* view) {
    int64_t visits = 0;
    for (int64_t tile = 0; tile < view->tiles(); ++tile) visits += view->tile_visits[tile];
    return visits * roigs::kLanes;
}
