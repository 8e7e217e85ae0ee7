// Gradient of the blending, front to back like the blending itself.
//
// With v = dL / dC at a pixel, and R_i = sum_{j>i} w_j (c_j . v) + T_end (background . v) what the
// pixel gets from behind splat i,
//
//     dL / d(alpha_i) = T_i (c_i . v) - R_i / (1 - alpha_i).
//
// R starts as (pixel colour . v), which the forward pass has computed, and loses w_i (c_i . v) with
// each splat: one number per pixel instead of a list of what was drawn there, and no division by
// the tiny transmittances at the back.
//
// Through the exponent E (alpha = opacity e^E) every other gradient is a sum of
// s = alpha dL / d(alpha) times a polynomial in the whitened offset (u, v): the six moments of
// view.h, from which projection_backward.cpp makes gradients of centre, covariance and opacity.
#include "simd_rows.h"
#include "tile.h"

namespace roigs {
namespace {

constexpr int kTogether = 2;  // splats evaluated side by side; for more, registers are too few

struct PixelBlock {
    Floats transmittance;
    Floats behind;            // R
    Floats red, green, blue;  // v
};

void load_tile(const TilePlace& place, const float* image, const float* gradient,
               PixelBlock* blocks) {
    const int64_t plane = int64_t(place.width) * place.height;
    for (int b = 0; b < kBlocks; ++b) {
        if (place.block_is_outside(b)) continue;
        PixelBlock& p = blocks[b];
        p.transmittance = place.start_transmittance(b);
        p.red = place.load_block(gradient, b);
        p.green = place.load_block(gradient + plane, b);
        p.blue = place.load_block(gradient + 2 * plane, b);
        p.behind = place.load_block(image, b) * p.red +
                   place.load_block(image + plane, b) * p.green +
                   place.load_block(image + 2 * plane, b) * p.blue;
    }
}

// What the batch's splats have gathered over the blocks worked on so far: lane i of a sum is the
// part of the blocks' pixels i.
struct BatchSums {
    Floats of[kBatch + 1][kMoments];  // as Batch::splats

    void clear(int count) {
        for (int i = 0; i < count; ++i) std::fill_n(of[i], kMoments, Floats{});
        std::fill_n(of[kBatch], kMoments, Floats{});
    }
    void store_to_slots(const View& view, const Batch& batch) const {
        for (int i = 0; i < batch.count; ++i)
            fold_lanes(of[i], view.slot_gradients[batch.splats[i].slot].sum, Sum{});
    }
};

// Takes the splats of a batch whose bits are set in `todo` off block b's pixels, front to back,
// and adds what they find to their sums: the loop that training spends most of its time in.
// Returns false when the block has ended.
ROIGS_INLINE bool block_gradient(const Batch& batch, uint64_t todo, int b, PixelBlock& p,
                                 BatchSums& sums) {
    const Floats x = load(kLayout.x[b]), y = load(kLayout.y[b]);
    const Floats red = p.red, green = p.green, blue = p.blue;
    Floats transmittance = p.transmittance, behind = p.behind;
    bool alive = true;
    do {
        const Together<kTogether> next(batch, todo, x, y);
        for (int k = 0; k < kTogether; ++k) {
            const LocalSplat& s = batch.splats[next.index[k]];
            const Floats alpha = next.alpha[k], u = next.u[k], v = next.v[k];
            const Floats weight = alpha * transmittance;
            const Floats colour = red * s.red + green * s.green + blue * s.blue;
            behind -= weight * colour;
            const Floats alpha_gradient =
                transmittance * colour - behind * reciprocal(1.0f - alpha);
            transmittance -= weight;
            const Floats gradient = keep(next.moves[k], alpha * alpha_gradient);

            Floats(&sum)[kMoments] = sums.of[next.index[k]];
            const Floats gu = gradient * u, gv = gradient * v;
            sum[kS] += gradient;
            sum[kSU] += gu;
            sum[kSV] += gv;
            sum[kSUU] += gu * u;
            sum[kSUV] += gu * v;
            sum[kSVV] += gv * v;
            sum[kRed] += weight * red;
            sum[kGreen] += weight * green;
            sum[kBlue] += weight * blue;
        }
        alive = any(greater(transmittance, splat(kTransmittanceEnd)));
    } while (todo && __builtin_expect(alive, 1));
    p.transmittance = transmittance;
    p.behind = behind;
    return alive;
}

void tile_gradient(View& view, int64_t tile, const float* image, const float* gradient) {
    if (view.tile_begin[tile] == view.tile_begin[tile + 1]) return;
    const TilePlace place(view, tile);
    PixelBlock blocks[kBlocks];
    const int64_t plane = int64_t(place.width) * place.height;
    for (int c = 0; c < 3; ++c) {
        place.prefetch<false>(image + c * plane);
        place.prefetch<false>(gradient + c * plane);
    }
    uint64_t live = kAllBlocks;
    for (int b = 0; b < kBlocks; ++b)
        if (place.block_is_outside(b)) live &= ~(uint64_t(1) << b);

    // every slot is written: what is not zero there is from an earlier frame
    const auto clear = [&](int32_t slot) { view.slot_gradients[slot] = SlotGradient{}; };
    const int64_t end = view.tile_begin[tile + 1];
    int64_t k = view.tile_begin[tile];
    Batch batch;
    BatchSums sums;
    bool loaded = false;  // after the first batch is taken: until then the pixels are on their way
    while (k < end && live) {
        k += take_batch(view, &view.entries[k], end - k, place, live, batch, clear);
        if (!loaded) load_tile(place, image, gradient, blocks);
        loaded = true;
        sums.clear(batch.count);
        for (uint64_t todo = live; todo; todo &= todo - 1) {
            const int b = __builtin_ctzll(todo);
            const uint64_t splats = batch.splats_of[b];
            if (splats && !block_gradient(batch, splats, b, blocks[b], sums))
                live &= ~(uint64_t(1) << b);
        }
        sums.store_to_slots(view, batch);
    }
    for (; k < end; ++k) clear(view.entries[k].slot);
}

}  // namespace
}  // namespace roigs

int64_t roigs_render_backward(roigs::View* view, const float* image,
                              const float* image_gradient) {
    using namespace roigs;
    if (!view->slot_gradients.reserve(view->intersections)) return kOutOfMemory;
    parallel_for(view->tiles,
                 [&](int64_t tile) { tile_gradient(*view, tile, image, image_gradient); });
    return 0;
}
