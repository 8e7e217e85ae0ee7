// The gradient of the blending (tile_gradient.h).
#include "tile_gradient.h"

int64_t roigs_render_backward(roigs::View* view, const roigs::Outputs* outputs,
                              const roigs::OutputGradients* gradients) {
    using namespace roigs;
    if (!view->slot_gradients.reserve(view->intersections)) return kOutOfMemory;
    view->has_plane_gradient = gradients->surface;
    if (gradients->surface) {
        blend_surface_gradient(*view, *outputs, *gradients);
        return 0;
    }
    const float *image = outputs->image, *gradient = gradients->image;
    parallel_for(view->tiles,
                 [&](int64_t tile) { tile_gradient<false>(*view, tile, image, gradient); });
    return 0;
}
