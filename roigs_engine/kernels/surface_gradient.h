// The gradient of a surface: steps of the backward pass in files of their own. So the compiler does the
// same sums in the same order for pictures without a surface.
#pragma once

#include "view.h"

namespace roigs {

// Gaussians, one per lane; beyond `count`, the last one is repeated.
struct BatchRows {
    int count;
    int32_t splat[kLanes], id[kLanes];
    int32_t row[kLanes];  // in the gradients
};

// surface_backward.cpp: roigs_render_backward where there is a surface.
void blend_surface_gradient(View& view, const Outputs& outputs, const OutputGradients& gradients);

// planes.cpp: adds the gradients through the planes to `out`, and sets `grad2d` to that of both.
void add_plane_gradient(const View& view, const Gaussians& gaussians, const Gradients& out,
                        const BatchRows& batch, float* grad2d);

}  // namespace roigs
