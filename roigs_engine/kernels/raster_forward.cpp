// Blending front to back (3DGS, eq. 3): C = sum_i c_i alpha_i T_i, T_i = prod_{j<i} (1 - alpha_j).
#include <cstring>

#include "simd_rows.h"
#include "tile.h"

namespace roigs {
namespace {

constexpr int kTogether = 4;  // splats evaluated side by side

// The sums of a tile's pixels so far.
struct Gathered {
    Floats transmittance[kBlocks], red[kBlocks], green[kBlocks], blue[kBlocks], depth[kBlocks];
};

// The requested values of the weights of a batch's splats, over the blocks blended so far.
template <bool kMax, bool kSum>
struct TileWeights {
    Floats largest[kMax ? kBatch + 1 : 1], sum[kSum ? kBatch + 1 : 1];  // as Batch::splats
    Floats pixel[kSum ? kBlocks : 1];  // the weight of each block's pixels in the sums

    TileWeights(const TilePlace& place, const float* pixel_weights) {
        if (!kSum) return;
        for (int b = 0; b < kBlocks; ++b) {
            if (place.block_is_outside(b)) continue;
            pixel[b] = pixel_weights ? place.load_block(pixel_weights, b) : splat(1.0f);
        }
    }
    // Clears everything, and starts fetching the slots, which are scattered in memory.
    void begin(const View& view, const Batch& batch) {
        if (kMax) largest[kBatch] = Floats{};
        if (kSum) sum[kBatch] = Floats{};
        for (int i = 0; i < batch.count; ++i) {
            const int32_t slot = batch.splats[i].slot;
            if (kMax) largest[i] = Floats{}, __builtin_prefetch(&view.slot_max_weights[slot], 1);
            if (kSum) sum[i] = Floats{}, __builtin_prefetch(&view.slot_weight_sums[slot], 1);
        }
    }
    // Also combines the pixels of a block, and writes the results to the splats' slots. Vectors
    // beyond those of the batch hold anything; their results are ignored.
    void store_to_slots(const View& view, const Batch& batch) const {
        for (int first = 0; first < batch.count; first += kFolded) {
            alignas(64) float largest_of[kFolded], sum_of[kFolded];
            if (kMax) fold_lanes(sixteen(&largest[first]), largest_of, Larger{});
            if (kSum) fold_lanes(sixteen(&sum[first]), sum_of, Sum{});
            for (int i = 0; i < std::min(kFolded, batch.count - first); ++i) {
                const int32_t slot = batch.splats[first + i].slot;
                if (kMax) view.slot_max_weights[slot] = largest_of[i];
                if (kSum) view.slot_weight_sums[slot] = sum_of[i];
            }
        }
    }

private:
    static constexpr int kFolded = 16;  // vectors at once
    using Sixteen = const Floats (&)[kFolded];
    static Sixteen sixteen(const Floats* first) { return *(const Floats(*)[kFolded])first; }
};

// The sums of a surface in a tile's pixels, and the planes of a batch.
template <bool kSurface>
struct TileSurface {
    static constexpr int kPlanes = 5;  // Outputs::surface
    Floats gathered[kSurface ? kBlocks : 1][kPlanes] = {};
    LocalPlane planes[kSurface ? kBatch + 1 : 1] = {};  // as Batch::splats

    void begin(const View& view, const TileEntry* entries, const TilePlace& place,
               const Batch& batch) {
        for (int i = 0; i < batch.count; ++i)
            planes[i] = LocalPlane(view.planes[entries[batch.entry_of[i]].splat], place);
    }
    void store(const TilePlace& place, float* out) const {
        for (int b = 0; b < kBlocks; ++b)
            for (int k = 0; k < kPlanes && !place.block_is_outside(b); ++k)
                place.store_block(out + k * place.plane, b, gathered[b][k]);
    }
};

// Adds a splat's weights to a surface, before they are taken from the transmittance.
ROIGS_INLINE void add_plane(const LocalPlane& p, Floats x, Floats y, Floats weight,
                            Floats transmittance, Floats (&gathered)[5]) {
    const Floats depth = plane_depth(p, x, y);
    gathered[0] += weight * depth;
    gathered[1] = select(is_median(transmittance, weight), depth, gathered[1]);
    for (int k = 0; k < 3; ++k) gathered[2 + k] += weight * p.normal[k];
}

// Blends the splats of a batch whose bits are set in `todo` into block b. This loop takes most of
// the rendering's time; the block's state is in registers. Returns false when the block has ended:
// no pixel's transmittance is above `least`. Then the splats left in `todo` were not visited. Sets
// the bits in `seen` of the splats with a weight above `least`.
template <bool kDepth, bool kSurface, bool kMax, bool kSum>
ROIGS_INLINE bool blend_block(const Batch& batch, uint64_t& todo, uint64_t& seen, int b,
                              Floats least, Gathered& gathered, TileSurface<kSurface>& surface,
                              TileWeights<kMax, kSum>& weights) {
    const Floats x = load(kLayout.x[b]), y = load(kLayout.y[b]);
    Floats transmittance = gathered.transmittance[b];
    Floats red = gathered.red[b], green = gathered.green[b], blue = gathered.blue[b];
    Floats depth = kDepth ? gathered.depth[b] : Floats{};
    const Floats pixel_weight = kSum ? weights.pixel[b] : Floats{};
    bool alive = true;
    do {
        const Together<kTogether> next(batch, todo, x, y);
        for (int k = 0; k < kTogether; ++k) {
            const int i = next.index[k];
            const LocalSplat& s = batch.splats[i];
            const Floats weight = next.alpha[k] * transmittance;
            seen |= any(greater(weight, least)) ? next.bit[k] : 0;
            if (kSurface)
                add_plane(surface.planes[i], x, y, weight, transmittance, surface.gathered[b]);
            transmittance -= weight;
            red += weight * s.red;
            green += weight * s.green;
            blue += weight * s.blue;
            if (kDepth) depth += weight * s.depth;
            if (kMax) weights.largest[i] = max(weights.largest[i], weight);
            if (kSum) weights.sum[i] += weight * pixel_weight;
        }
        alive = any(greater(transmittance, least));
    } while (todo && __builtin_expect(alive, 1));
    gathered.transmittance[b] = transmittance;
    gathered.red[b] = red;
    gathered.green[b] = green;
    gathered.blue[b] = blue;
    if (kDepth) gathered.depth[b] = depth;
    return alive;
}

void store_tile(const View& view, const TilePlace& place, const Gathered& g, const Outputs& out) {
    const int64_t plane = place.plane;
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

// Removes two kinds of blocks from passed_in: those in which the splat is seen, and those in which
// no seen splat is behind it, because there the passed splat changes no gradient. Entries from
// `taken` on were not tested.
void note_passed(const View& view, int64_t begin, int64_t taken, int64_t end) {
    uint64_t later = 0;
    for (int64_t k = taken - 1; k >= begin; --k) {
        view.passed_in[k] &= BlockSet(later & ~view.seen_in[k]);
        later |= view.seen_in[k];
    }
    std::fill_n(&view.seen_in[taken], end - taken, BlockSet{0});
    std::fill_n(&view.passed_in[taken], end - taken, BlockSet{0});
}

template <bool kDepth, bool kSurface, bool kMax, bool kSum>
void render_tile(const View& view, int64_t tile, const Outputs& out) {
    const TilePlace place(view, tile);
    Gathered gathered;
    uint64_t live = kAllBlocks;
    for (int b = 0; b < kBlocks; ++b) {
        gathered.transmittance[b] = place.start_transmittance(b);
        gathered.red[b] = gathered.green[b] = gathered.blue[b] = gathered.depth[b] = Floats{};
        if (place.block_is_outside(b)) live &= ~(uint64_t(1) << b);
    }
    const int64_t end = view.tile_begin[tile + 1];
    // store_tile will write there
    for (int c = 0; c < 3; ++c) place.prefetch<true>(out.image + c * place.plane);
    place.prefetch<true>(out.alpha);
    const Floats least = splat(view.camera.min_transmittance);
    Batch batch;
    TileWeights<kMax, kSum> weights(place, out.pixel_weights);
    TileSurface<kSurface> surface;
    int64_t visits = 0;
    int64_t k = view.tile_begin[tile];
    while (k < end && live) {
        BlockSet *seen_in = &view.seen_in[k], *passed_in = &view.passed_in[k];
        const int taken = take_batch(view, &view.entries[k], end - k, place, live, batch,
                                     [&](int i, uint64_t blocks) { passed_in[i] = BlockSet(blocks); });
        if (kSurface) surface.begin(view, &view.entries[k], place, batch);
        k += taken;
        if (kMax || kSum) weights.begin(view, batch);
        for (uint64_t todo = live; todo; todo &= todo - 1) {
            const int b = __builtin_ctzll(todo);
            uint64_t splats = batch.splats_of[b], seen = 0;
            if (!splats) continue;
            visits += __builtin_popcountll(splats);
            if (!blend_block<kDepth>(batch, splats, seen, b, least, gathered, surface, weights))
                live &= ~(uint64_t(1) << b);
            visits -= __builtin_popcountll(splats);
            batch.splats_of[b] = seen;
        }
        transpose_to_splats(batch.splats_of);
        std::fill_n(seen_in, taken, BlockSet{0});
        for (int i = 0; i < batch.count; ++i)
            seen_in[batch.entry_of[i]] = BlockSet(batch.splats_of[i]);
        if (kMax || kSum) weights.store_to_slots(view, batch);
    }
    note_passed(view, view.tile_begin[tile], k, end);
    store_tile(view, place, gathered, out);
    if (kSurface) surface.store(place, out.surface);
    view.tile_visits[tile] = visits;
}

// Outside the drawn tiles, there is only background.
void fill_background(const View& view, const Outputs& out) {
    const Camera& camera = view.camera;
    const int64_t plane = int64_t(camera.window_x1 - camera.window_x0) *
                          (camera.window_y1 - camera.window_y0);
    for (int c = 0; c < 3; ++c)
        std::fill_n(out.image + c * plane, plane, camera.background[c]);
    std::fill_n(out.alpha, plane, 0.0f);
    if (out.depth) std::fill_n(out.depth, plane, 0.0f);
    if (out.surface) std::fill_n(out.surface, 5 * plane, 0.0f);
}

// Room for a number per (Gaussian, tile) pair, and for a vector that begins at the last one. The
// number stays 0 if no block blends the pair.
bool clear_slots(Scratch<float>& slots, int64_t count) {
    if (!slots.reserve(count + kLanes)) return false;
    std::fill_n(slots.data(), count, 0.0f);
    return true;
}

// Combines each splat's slots by `fold`, for which 0 is neutral, and calls visit(row of the
// Gaussian, result). Most splats have few slots, so one vector holds them all. This avoids a loop
// whose end the processor would have to predict.
template <class Fold, class Visit>
void fold_slots(const View& view, const Scratch<float>& slots, const Fold& fold,
                const Visit& visit) {
    constexpr int kFolded = 16;
    parallel_for(int64_t(view.chunks.size()), [&](int64_t c) {
        const Splat* splats = &view.splats[c * kChunk];
        const TileSpan* spans = &view.tiles_of[c * kChunk];
        const Chunk& chunk = view.chunks[c];
        for (int first = 0; first < chunk.visible; first += kFolded) {
            const int count = std::min(kFolded, chunk.visible - first);
            Floats rows[kFolded];
            for (int i = 0; i < count; ++i) {
                const TileSpan span = spans[first + i];
                const float* values = &slots[chunk.first_slot + span.first];
                rows[i] = keep(first_lanes(std::min(span.count, kLanes)), load(values));
                for (int t = kLanes; t < span.count; t += kLanes)
                    rows[i] = fold(rows[i], keep(first_lanes(std::min(span.count - t, kLanes)),
                                                 load(values + t)));
            }
            alignas(64) float folded[kFolded];
            fold_lanes(rows, folded, fold);
            for (int i = 0; i < count; ++i) visit(splats[first + i].id, folded[i]);
        }
    });
}

void raise_max_weights(const View& view, float* max_weight) {
    fold_slots(view, view.slot_max_weights, Larger{}, [&](int32_t id, float value) {
        max_weight[id] = std::max(max_weight[id], value);
    });
}

void add_weight_sums(const View& view, float* weight_sum) {
    fold_slots(view, view.slot_weight_sums, Sum{},
               [&](int32_t id, float value) { weight_sum[id] += value; });
}

template <bool kDepth, bool kSurface>
auto* tile_renderer(bool max_weight, bool weight_sum) {
    return max_weight ? (weight_sum ? render_tile<kDepth, kSurface, true, true>
                                    : render_tile<kDepth, kSurface, true, false>)
                      : (weight_sum ? render_tile<kDepth, kSurface, false, true>
                                    : render_tile<kDepth, kSurface, false, false>);
}

bool covers_window(const View& view) {
    const Camera& c = view.camera;
    return !view.masked && c.tile_x0 * kTile <= c.window_x0 && c.tile_y0 * kTile <= c.window_y0 &&
           c.tile_x1 * kTile >= c.window_x1 && c.tile_y1 * kTile >= c.window_y1;
}

}  // namespace
}  // namespace roigs

int64_t roigs_render(roigs::View* view, const roigs::Outputs* outputs) {
    using namespace roigs;
    const Outputs& out = *outputs;
    if (!view->tile_visits.reserve(view->tiles)) return kOutOfMemory;
    if (!view->seen_in.reserve(view->intersections) ||
        !view->passed_in.reserve(view->intersections))
        return kOutOfMemory;
    if (out.max_weight && !clear_slots(view->slot_max_weights, view->intersections))
        return kOutOfMemory;
    if (out.weight_sum && !clear_slots(view->slot_weight_sums, view->intersections))
        return kOutOfMemory;
    if (!covers_window(*view)) fill_background(*view, out);
    auto* render = out.surface ? tile_renderer<true, true>(out.max_weight, out.weight_sum)
                   : out.depth ? tile_renderer<true, false>(out.max_weight, out.weight_sum)
                               : tile_renderer<false, false>(out.max_weight, out.weight_sum);
    parallel_for(view->tiles, [&](int64_t tile) { render(*view, tile, out); });
    if (out.max_weight) raise_max_weights(*view, out.max_weight);
    if (out.weight_sum) add_weight_sums(*view, out.weight_sum);
    return 0;
}

int64_t roigs_pair_evaluations(const roigs::View* view) {
    int64_t visits = 0;
    for (int64_t tile = 0; tile < view->tiles; ++tile) visits += view->tile_visits[tile];
    return visits * roigs::kLanes;
}
