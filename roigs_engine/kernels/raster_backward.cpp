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

// What one block adds to a splat's sums.
struct Term {
    Floats gradient;  // s
    Floats weight, u, v;
};

ROIGS_INLINE void accumulate(const Term& t, const PixelBlock& p, Floats (&sum)[kMoments]) {
    const Floats gu = t.gradient * t.u, gv = t.gradient * t.v;
    sum[kS] += t.gradient;
    sum[kSU] += gu;
    sum[kSV] += gv;
    sum[kSUU] += gu * t.u;
    sum[kSUV] += gu * t.v;
    sum[kSVV] += gv * t.v;
    sum[kRed] += t.weight * p.red;
    sum[kGreen] += t.weight * p.green;
    sum[kBlue] += t.weight * p.blue;
}

// Takes the splat in front off the block's pixels.
ROIGS_INLINE Term differentiate(const LocalSplat& s, int b, PixelBlock& p) {
    Term t;
    const Floats exponent = exponent_at(s, load(kLayout.x[b]), load(kLayout.y[b]), t.u, t.v);
    const Mask drawn = greater(exponent, splat(kLog2AlphaMin));
    const Floats uncapped = exp2(exponent);
    const Floats alpha = keep(drawn, min(uncapped, splat(kAlphaMax)));
    const Floats before = p.transmittance;
    t.weight = alpha * before;
    p.transmittance = before - t.weight;

    const Floats colour = p.red * s.red + p.green * s.green + p.blue * s.blue;
    p.behind -= t.weight * colour;
    const Floats alpha_gradient = before * colour - p.behind * reciprocal(1.0f - alpha);
    // a capped alpha does not depend on anything
    const Mask moves = both(drawn, less(uncapped, splat(kAlphaMax)));
    t.gradient = keep(moves, alpha * alpha_gradient);
    return t;
}

// One splat over all the blocks it touches: the loop that training spends most of its time in.
// Clears the bits of blocks that end in `live`.
ROIGS_INLINE void splat_gradient(const LocalSplat& s, uint64_t touched, PixelBlock* blocks,
                                 uint64_t& live, SlotGradient& out) {
    Floats sum[kMoments] = {};
    // Sums and all the rest do not fit 16 registers together, and moving them to and from memory
    // for each block takes longer than a second loop: a quarter of this function's time.
    constexpr bool kTwoLoops = kVectorRegisters < 32;
    Term terms[kTwoLoops ? kBlocks : 1];
    int count = 0;
    for (uint64_t todo = touched; todo; todo &= todo - 1) {
        const int b = __builtin_ctzll(todo);
        const Term t = differentiate(s, b, blocks[b]);
        if (kTwoLoops)
            terms[count++] = t;
        else
            accumulate(t, blocks[b], sum);
        const Mask shines_through = greater(blocks[b].transmittance, splat(kTransmittanceEnd));
        if (__builtin_expect(!any(shines_through), 0)) live &= ~(uint64_t(1) << b);
    }
    if (kTwoLoops) {
        count = 0;
        for (uint64_t todo = touched; todo; todo &= todo - 1)
            accumulate(terms[count++], blocks[__builtin_ctzll(todo)], sum);
    }
    fold_lanes(sum, out.sum, Sum{});
}

void tile_gradient(View& view, int64_t tile, const float* image, const float* gradient) {
    if (view.tile_begin[tile] == view.tile_begin[tile + 1]) return;
    const TilePlace place(view, tile);
    PixelBlock blocks[kBlocks];
    load_tile(place, image, gradient, blocks);
    uint64_t live = kAllBlocks;
    for (int b = 0; b < kBlocks; ++b)
        if (place.block_is_outside(b)) live &= ~(uint64_t(1) << b);

    // every slot is written: what is not zero there is from an earlier frame
    const auto clear = [&](int32_t slot) { view.slot_gradients[slot] = SlotGradient{}; };
    const int64_t end = view.tile_begin[tile + 1];
    int64_t k = view.tile_begin[tile];
    Batch batch;
    while (k < end && live) {
        k += take_batch(view, &view.entries[k], end - k, place, live, batch, clear);
        for (int i = 0; i < batch.count; ++i) {
            const LocalSplat& s = batch.splats[i];
            if (const uint64_t touched = batch.blocks[i] & live)
                splat_gradient(s, touched, blocks, live, view.slot_gradients[s.slot]);
            else
                clear(s.slot);
        }
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
