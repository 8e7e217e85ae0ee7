// The gradient of the blending of a surface.
#include "tile_gradient.h"

void roigs::blend_surface_gradient(View& view, const Outputs& outputs,
                                   const OutputGradients& gradients) {
    parallel_for(view.tiles, [&](int64_t tile) {
        tile_gradient<true>(view, tile, outputs.image, gradients.image, &outputs,
                            gradients.surface);
    });
}
