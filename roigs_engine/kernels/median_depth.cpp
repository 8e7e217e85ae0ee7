// The median depth of each pixel: the depth of the Gaussian at which the weights, added front to
// back, reach half of their sum. The sum is known only after blending. So the Gaussians in front of
// the median are then blended once more, without colours. This costs the blending itself nothing.
#include "tile.h"

namespace roigs {
namespace {

constexpr int kTogether = 4;  // splats evaluated side by side

struct Medians {
    Floats transmittance[kBlocks], depth[kBlocks];
    Floats half[kBlocks];  // the transmittance behind half of a pixel's weights
};

// Blends the splats of a batch whose bits are set in `todo` into block b. A pixel's depth is that
// of its last splat so far, until half is reached. Returns false when all pixels have reached half.
ROIGS_INLINE bool pass_block(const Batch& batch, uint64_t todo, int b, Medians& medians) {
    const Floats x = load(kLayout.x[b]), y = load(kLayout.y[b]), half = medians.half[b];
    Floats transmittance = medians.transmittance[b], depth = medians.depth[b];
    bool before_half = true;
    do {
        const Together<kTogether> next(batch, todo, x, y);
        for (int k = 0; k < kTogether; ++k) {
            const Mask counts =
                both(greater(transmittance, half), greater(next.alpha[k], Floats{}));
            depth = select(counts, splat(batch.splats[next.index[k]].depth), depth);
            transmittance -= next.alpha[k] * transmittance;
        }
        before_half = any(greater(transmittance, half));
    } while (todo && before_half);
    medians.transmittance[b] = transmittance;
    medians.depth[b] = depth;
    return before_half;
}

void find_medians(const View& view, int64_t tile, const float* alpha, float* depth) {
    const TilePlace place(view, tile);
    Medians medians;
    uint64_t live = 0;
    for (int b = 0; b < kBlocks; ++b) {
        medians.transmittance[b] = splat(1.0f);
        medians.depth[b] = Floats{};
        if (place.block_is_outside(b)) continue;
        medians.half[b] = 1.0f - 0.5f * place.load_block(alpha, b);
        const bool drawn = any(greater(medians.transmittance[b], medians.half[b]));
        live |= uint64_t(drawn) << b;
    }
    const int64_t end = view.tile_begin[tile + 1];
    Batch batch;
    for (int64_t k = view.tile_begin[tile]; k < end && live;) {
        k += take_batch(view, &view.entries[k], end - k, place, live, batch,
                        [](int, uint64_t) {});
        for (uint64_t todo = live; todo; todo &= todo - 1) {
            const int b = __builtin_ctzll(todo);
            if (batch.splats_of[b] && !pass_block(batch, batch.splats_of[b], b, medians))
                live &= ~(uint64_t(1) << b);
        }
    }
    for (int b = 0; b < kBlocks; ++b)
        if (!place.block_is_outside(b)) place.store_block(depth, b, medians.depth[b]);
}

}  // namespace
}  // namespace roigs

void roigs_median_depth(roigs::View* view, const float* alpha, float* depth) {
    roigs::parallel_for(view->tiles, [&](int64_t tile) {
        roigs::find_medians(*view, tile, alpha, depth);
    });
}
