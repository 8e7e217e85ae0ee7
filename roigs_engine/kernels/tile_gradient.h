// Gradient of the blending, front to back like the blending itself, splat by splat. A splat's sums
// stay in registers while the blocks that it touches are visited. No block waits for another.
//
// With v = dL / dC at a pixel, and R_i = sum_{j>i} w_j (c_j . v) + T_end (background . v) the light
// that the pixel gets from behind splat i,
//
//     dL / d(alpha_i) = T_i (c_i . v) - R_i / (1 - alpha_i).
//
// R starts as (pixel colour . v), which the forward pass has computed, and loses w_i (c_i . v) with
// each splat. So one number per pixel replaces a list of the splats drawn there, and nothing is
// divided by the tiny transmittances at the back.
//
// Through the exponent E (alpha = opacity e^E), each other gradient is a sum of s = alpha dL /
// d(alpha) times a polynomial in the whitened offset (u, v). These are the six moments of view.h;
// projection_backward.cpp converts them to gradients of centre, covariance and opacity.
//
// A surface is blended like colours: splat i adds w_i (a + d z_i(x) + h . n_i) to the loss, with
// the pixel's dL / d(alpha), dL / d(depth) and dL / d(normal), and z_i affine in the pixel.
#pragma once

#include "simd_rows.h"
#include "surface_gradient.h"
#include "tile.h"

namespace roigs {

namespace {  // a copy for each file, inlined there

struct PixelBlock {
    Floats transmittance;
    Floats behind;            // R
    Floats red, green, blue;  // v
};

// dL / d(alpha, depth, median depth, normal) at a block's pixels.
struct SurfaceBlock {
    Floats alpha, depth, median, normal[3];

    void load(const TilePlace& place, const Outputs& out, const float* gradient, int b,
              PixelBlock& p) {
        const auto plane = [&](const float* from, int k) {
            return place.load_block(from + k * place.plane, b);
        };
        alpha = plane(gradient, 0);
        depth = plane(gradient, 1);
        median = plane(gradient, 2);
        p.behind += alpha * plane(out.alpha, 0) + depth * plane(out.surface, 0);
        for (int k = 0; k < 3; ++k) {
            normal[k] = plane(gradient, 3 + k);
            p.behind += normal[k] * plane(out.surface, 2 + k);
        }
    }
};

void load_tile(const TilePlace& place, const float* image, const float* gradient,
               PixelBlock* blocks) {
    const int64_t plane = place.plane;
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

// The plane's part of the loss at block b's pixels, for a weight of 1.
ROIGS_INLINE Floats plane_value(const LocalPlane& plane, const SurfaceBlock& q, Floats depth) {
    return q.alpha + q.depth * depth + q.normal[0] * plane.normal[0] +
           q.normal[1] * plane.normal[1] + q.normal[2] * plane.normal[2];
}

// Adds the moments of a plane.
ROIGS_INLINE void visit_plane(const LocalPlane& plane, const SurfaceBlock& q, Floats x, Floats y,
                              Floats weight, Floats transmittance, Floats* sum) {
    const Floats median = keep(is_median(transmittance, weight), q.median);
    const Floats depth = weight * q.depth + median;
    sum[kPlaneDepth] += depth;
    sum[kPlaneX] += depth * (x - plane.x);
    sum[kPlaneY] += depth * (y - plane.y);
    for (int k = 0; k < 3; ++k) sum[kNormal + k] += weight * q.normal[k];
}

// Removes splat `s` from block b's pixels and adds its moments to `sum`. Training spends most of
// its time in this function.
template <bool kSurface, int kSums>
ROIGS_INLINE void visit(const LocalSplat& s, const LocalPlane& plane, int b, PixelBlock& p,
                        const SurfaceBlock* surface, Floats (&sum)[kSums]) {
    Floats u, v;
    Mask moves;
    const Floats x = load(kLayout.x[b]), y = load(kLayout.y[b]);
    const Floats exponent = exponent_at(s, x, y, u, v);
    const Floats alpha = alpha_of(exponent, moves);

    const Floats weight = alpha * p.transmittance;
    Floats colour = p.red * s.red + p.green * s.green + p.blue * s.blue;
    if constexpr (kSurface) {
        colour += plane_value(plane, surface[b], plane_depth(plane, x, y));
        visit_plane(plane, surface[b], x, y, weight, p.transmittance, sum);
    }
    const Floats behind = p.behind - weight * colour;
    const Floats alpha_gradient = p.transmittance * colour - behind * reciprocal(1.0f - alpha);
    const Floats gradient = keep(moves, alpha * alpha_gradient);
    p.behind = behind;
    p.transmittance -= weight;

    const Floats gu = gradient * u, gv = gradient * v;
    sum[kS] += gradient;
    sum[kSU] += gu;
    sum[kSV] += gv;
    sum[kSUU] += gu * u;
    sum[kSUV] += gu * v;
    sum[kSVV] += gv * v;
    sum[kRed] += weight * p.red;
    sum[kGreen] += weight * p.green;
    sum[kBlue] += weight * p.blue;
}

// The same for a splat with hardly any weight. It gets no gradient, but splats behind it get
// theirs.
template <bool kSurface>
ROIGS_INLINE void pass(const LocalSplat& s, const LocalPlane& plane, int b, PixelBlock& p,
                       const SurfaceBlock* surface) {
    Floats u, v;
    Mask moves;
    const Floats x = load(kLayout.x[b]), y = load(kLayout.y[b]);
    const Floats exponent = exponent_at(s, x, y, u, v);
    const Floats weight = alpha_of(exponent, moves) * p.transmittance;
    Floats colour = p.red * s.red + p.green * s.green + p.blue * s.blue;
    if (kSurface) colour += plane_value(plane, surface[b], plane_depth(plane, x, y));
    p.behind -= weight * colour;
    p.transmittance -= weight;
}

// Marks a splat that gets a gradient. Pixels whose gradient is zero (those that a mask ignores)
// give it none. Other tiles may write the same value at the same time.
ROIGS_INLINE void note_gradient(const SlotGradient& slot, Splat& s) {
    bool found = false;
    for (int k = 0; k < 16; k += kLanes) found |= any(not_zero(load(slot.sum + k)));
    if (found && !__atomic_load_n(&s.has_gradient, __ATOMIC_RELAXED))
        __atomic_store_n(&s.has_gradient, 1, __ATOMIC_RELAXED);
}

// `image` comes from roigs_render; `gradient` is dL / d(image). `out` and `surface_gradient` are
// read only with kSurface.
template <bool kSurface>
void tile_gradient(View& view, int64_t tile, const float* image, const float* gradient,
                   const Outputs* out = nullptr, const float* surface_gradient = nullptr) {
    const int64_t begin = view.tile_begin[tile], end = view.tile_begin[tile + 1];
    if (begin == end) return;
    const TilePlace place(view, tile);
    PixelBlock blocks[kBlocks];
    for (int c = 0; c < 3; ++c) {
        place.prefetch<false>(image + c * place.plane);
        place.prefetch<false>(gradient + c * place.plane);
    }
    load_tile(place, image, gradient, blocks);
    SurfaceBlock surface[kSurface ? kBlocks : 1];
    for (int b = 0; kSurface && b < kBlocks; ++b)
        if (!place.block_is_outside(b)) surface[b].load(place, *out, surface_gradient, b, blocks[b]);

    for (int64_t k = begin; k < end; ++k) {
        const TileEntry entry = view.entries[k], ahead = view.entries[std::min(k + kAhead, end - 1)];
        __builtin_prefetch(&view.splats[ahead.splat]);
        __builtin_prefetch(&view.slot_gradients[ahead.slot], 1);
        // every slot is written, because slots hold values of an earlier frame
        SlotGradient& slot = view.slot_gradients[entry.slot];
        uint64_t seen = view.seen_in[k], passed = view.passed_in[k];
        if (!seen) slot = SlotGradient{};
        if (!(seen | passed)) continue;
        Splat& s = view.splats[entry.splat];
        const LocalSplat local(s, entry.slot, s.x - float(place.x), s.y - float(place.y));
        LocalPlane plane;
        if (kSurface) plane = LocalPlane(view.planes[entry.splat], place);
        for (; passed; passed &= passed - 1) {
            const int b = __builtin_ctzll(passed);
            pass<kSurface>(local, plane, b, blocks[b], surface);
        }
        if (!seen) continue;
        Floats sum[kSurface ? kSurfaceMoments : kMoments] = {};
        do {
            const int b = __builtin_ctzll(seen);
            visit<kSurface>(local, plane, b, blocks[b], surface, sum);
            seen &= seen - 1;
        } while (seen);
        fold_lanes(sum, slot.sum, Sum{});
        note_gradient(slot, s);
    }
}

}  // namespace
}  // namespace roigs
