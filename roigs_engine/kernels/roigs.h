// The rasterizer's C interface, called from rasterize/cpu.py through ctypes.
//
// Order of calls for one camera, on one View:
//
//     roigs_project, roigs_bin, [roigs_project_planes], roigs_render,
//     [roigs_render_backward, roigs_project_backward]
//
// Training calls roigs_project_backward_adam instead of the last one. roigs_median_depth may follow
// roigs_render. Outputs::surface needs roigs_project_planes.
//
// A View keeps the data that stages pass to each other. It keeps its memory from one frame to the
// next, because fresh memory costs a page fault for every 4 KiB, which takes longer than some
// stages. Calls on one View must not overlap; different Views are independent.
//
// Arrays are C-contiguous float32. N Gaussians; images are planar, (3, height, width).
#pragma once

#include <cstdint>

#include "parallel.h"
#include "types.h"

namespace roigs {

// Results below zero are failures.
enum Failure : int64_t { kOutOfMemory = -1, kTooManyIntersections = -2 };

struct View;

}  // namespace roigs

ROIGS_API roigs::View* roigs_view_create();
ROIGS_API void roigs_view_destroy(roigs::View* view);

// Projects all Gaussians, evaluates their colours, and lists the tiles they touch. `visible` (N,)
// holds zeros, and is set to 1 for Gaussians that touch a tile. Returns their number.
ROIGS_API int64_t roigs_project(roigs::View* view, const roigs::Gaussians* gaussians,
                                const roigs::Camera* camera, uint8_t* visible);

// Sorts by depth and makes the tiles' lists. Returns the number of (Gaussian, tile) pairs.
ROIGS_API int64_t roigs_bin(roigs::View* view);

// Finds the planes of the splats (plane.h).
ROIGS_API int64_t roigs_project_planes(roigs::View* view, const roigs::Gaussians* gaussians);

// Blends.
ROIGS_API int64_t roigs_render(roigs::View* view, const roigs::Outputs* outputs);

// Writes each pixel's median depth to `depth` (H, W), which holds zeros. `alpha` comes from
// roigs_render.
ROIGS_API void roigs_median_depth(roigs::View* view, const float* alpha, float* depth);

// The number of (Gaussian, pixel) pairs that the last roigs_render of this view has evaluated: the
// lanes of all block visits. For measurements.
ROIGS_API int64_t roigs_pair_evaluations(const roigs::View* view);

// Gradient of the blending, for the splats that Camera::min_transmittance allows. `outputs` come
// from roigs_render.
ROIGS_API int64_t roigs_render_backward(roigs::View* view, const roigs::Outputs* outputs,
                                        const roigs::OutputGradients* gradients);

// Gradient of the projection. Adds dL / d(parameter) to the rows of the Gaussians that have one.
// Writes their |dL / d(mean2d)|, in units of half the image size, to `grad2d` (N,), which holds
// zeros.
ROIGS_API void roigs_project_backward(roigs::View* view, const roigs::Gaussians* gaussians,
                                      const roigs::Gradients* gradients, float* grad2d);

// The same, and immediately a step of Adam on these rows. So gradients are used while they are in
// the cache, and need no memory. `adam` has the members of `gaussians`, in that order. The result
// is bit-identical to roigs_project_backward on zeros, followed by roigs_adam on its rows.
ROIGS_API int64_t roigs_project_backward_adam(roigs::View* view, const roigs::Gaussians* gaussians,
                                              const roigs::Adam* adam, float* grad2d);

// A step of Adam on the rows of all parameters with visible[row] != 0. Their gradient is zero
// afterwards; other rows stay untouched. A row whose gradient has a NaN or an infinity is not
// updated. Returns the number of such rows, over all parameters.
ROIGS_API int64_t roigs_adam(int64_t rows, const roigs::Adam* adam, const uint8_t* visible);

// out (count, width): the rows of `matrix` (rows, width) with the numbers in `chosen` (count,);
// zeros for a number that is no row.
ROIGS_API void roigs_copy_rows(const float* matrix, int64_t rows, int64_t width,
                               const int64_t* chosen, int64_t count, float* out);

// Lowers `depth` (height, width) to the depth of the triangles (count, 3, 3) at each pixel's
// centre, if they are nearer. Triangles are in the camera's frame; only parts beyond `near` count.
// `lens`: fx, fy, cx, cy, px.
ROIGS_API void roigs_surface_depth(const float* triangles, int64_t count, const double* lens,
                                   double near, int64_t width, int64_t height, float* depth);

// Adds the values of a depth map at each point (count, 3), in the frame of `pose`, to `sums`
// (count, 5): 0: weight x distance to the surface in truncations, at most 1 (free); 1: that weight;
// 2: the part of it for which the surface is less than a truncation away; 3: the weight if the
// surface is farther in front; 4: 1 if the surface is less than a truncation away.
ROIGS_API void roigs_fuse_depth(const float* points, int64_t count,
                                const roigs::DepthPhoto* photo, float* sums);

// Patches (count, side, side) of a photo `grey` (height, width), side = 2 half + 1, with zero mean
// and unit variance by `weights` (side, side), the same for all; `deviations` (count,): before.
// Sample (row, column) is at the patch's centre (count, 2), px from the centre of the first pixel,
// plus its shape (count, 2, 2) times (column - half, row - half). `inside` (count,): 1 if all
// samples are in the photo, which has at least 2 pixels each way.
ROIGS_API void roigs_patches(const float* grey, int64_t width, int64_t height, const float* centres,
                             const float* shapes, int64_t count, int64_t half, const float* weights,
                             float* patches, float* deviations, uint8_t* inside);
