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

struct Pixels {
    Floats transmittance[kBlocks];
    Floats behind[kBlocks];                          // R
    Floats red[kBlocks], green[kBlocks], blue[kBlocks];  // v
};

void load_tile(const TilePlace& place, const float* image, const float* gradient, Pixels& p) {
    const int64_t plane = int64_t(place.width) * place.height;
    for (int b = 0; b < kBlocks; ++b) {
        if (place.block_is_outside(b)) continue;
        p.transmittance[b] = place.start_transmittance(b);
        p.red[b] = place.load_block(gradient, b);
        p.green[b] = place.load_block(gradient + plane, b);
        p.blue[b] = place.load_block(gradient + 2 * plane, b);
        p.behind[b] = place.load_block(image, b) * p.red[b] +
                      place.load_block(image + plane, b) * p.green[b] +
                      place.load_block(image + 2 * plane, b) * p.blue[b];
    }
}

// One splat over all the blocks it touches: with its sums in registers, this is the loop that
// training spends most of its time in. Clears the bits of blocks that end in `live`.
ROIGS_INLINE void splat_gradient(const LocalSplat& s, uint64_t blocks, Pixels& p, uint64_t& live,
                                 SlotGradient& out) {
    Floats sum[kMoments] = {};
    do {
        const int b = __builtin_ctzll(blocks);
        blocks &= blocks - 1;
        Floats u, v;
        const Floats exponent = exponent_at(s, load(kLayout.x[b]), load(kLayout.y[b]), u, v);
        const Mask drawn = greater(exponent, splat(kLog2AlphaMin));
        const Floats uncapped = exp2(exponent);
        const Floats alpha = keep(drawn, min(uncapped, splat(kAlphaMax)));
        const Floats before = p.transmittance[b], weight = alpha * before;
        const Floats after = before - weight;
        p.transmittance[b] = after;

        const Floats vr = p.red[b], vg = p.green[b], vb = p.blue[b];
        const Floats colour = vr * s.red + vg * s.green + vb * s.blue;
        const Floats behind = p.behind[b] - weight * colour;
        p.behind[b] = behind;
        const Floats alpha_gradient = before * colour - behind * reciprocal(1.0f - alpha);
        // a capped alpha does not depend on anything
        const Mask moves = both(drawn, less(uncapped, splat(kAlphaMax)));
        const Floats gradient = keep(moves, alpha * alpha_gradient);

        const Floats gu = gradient * u, gv = gradient * v;
        sum[kS] += gradient;
        sum[kSU] += gu;
        sum[kSV] += gv;
        sum[kSUU] += gu * u;
        sum[kSUV] += gu * v;
        sum[kSVV] += gv * v;
        sum[kRed] += weight * vr;
        sum[kGreen] += weight * vg;
        sum[kBlue] += weight * vb;
        if (__builtin_expect(!any(greater(after, splat(kTransmittanceEnd))), 0))
            live &= ~(uint64_t(1) << b);
    } while (blocks);
    sum_lanes(sum, out.sum);
}

void tile_gradient(View& view, int64_t tile, const float* image, const float* gradient) {
    const TilePlace place(view, tile);
    Pixels pixels;
    load_tile(place, image, gradient, pixels);
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
            if (const uint64_t blocks = batch.blocks[i] & live)
                splat_gradient(s, blocks, pixels, live, view.slot_gradients[s.slot]);
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
    parallel_for(view->tiles(),
                 [&](int64_t tile) { tile_gradient(*view, tile, image, image_gradient); });
    return 0;
}
