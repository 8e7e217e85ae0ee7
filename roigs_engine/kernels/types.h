// Inputs and outputs of the kernels: plain values, the same for a processor and for a card.
#pragma once

#include <cstdint>

namespace roigs {

struct Gaussians {
    const float* means;        // (N, 3)
    const float* quats;        // (N, 4) wxyz, any length
    const float* scales;       // (N, 3)
    const float* opacities;    // (N,)
    const float* sh;           // (N, sh_coefficients, 3)
    int64_t count;             // N, at most 2^30
    int32_t sh_coefficients;   // stored per colour: 1, 4, 9 or 16
    int32_t sh_degree;         // evaluated: 0 to 3
    int32_t raw;               // scales are logarithms, opacities are logits
    int32_t linear_light;      // colours, which are sRGB values, are blended as linear light
};

// Buffers that gradients are added to, shaped as the parameters. A null one is skipped.
struct Gradients {
    float* means;
    float* quats;
    float* scales;
    float* opacities;
    float* sh;
};

// A parameter (rows, width) and its moments, all of that shape.
struct AdamParameter {
    float *values, *exp_avg, *exp_avg_sq;
    float* gradient;     // the same shape; roigs_project_backward_adam does without
    const float* rates;  // (width,) the columns' learning rates
    int64_t width;
};

// A step of the optimiser.
struct Adam {
    const AdamParameter* parameters;
    int64_t count;  // of parameters
    double beta1, beta2, epsilon;
    int64_t step;  // counts from 1
    const float* row_rates;  // (rows,) factors of the rates; null: 1
};

struct Camera {
    float world_to_camera[3][4];
    float position[3];  // world frame
    float fx, fy, cx, cy;
    float background[3];
    float blur;         // added to the 2D covariance's diagonal, px^2
    float stored_blur;  // .. with which a Gaussian has its stored opacity
    float max_slope;   // leaves out Gaussians with a centre beside the image and a larger |x / z|,
                       // or above or below it and a larger |y / z|
    float min_sigmas;  // .. and those whose z is at most this many standard deviations along z
    float min_transmittance;  // blending ends when all pixels of a block have less than this left;
                              // a splat gets no gradient from a block in which no weight is larger
    int32_t width, height;
    int32_t tile_x0, tile_y0, tile_x1, tile_y1;  // tiles to work on, end exclusive
    int32_t window_x0, window_y0, window_x1, window_y1;  // px: whole tiles around these, see Outputs
    const uint8_t* tile_mask;  // of these, the ones to work on, row by row; null: all
};

// Outputs of roigs_render. H x W are the pixels of the camera's window, on a card those of its
// image. Each of the last five is skipped if it is null.
struct Outputs {
    float* image;       // (3, H, W)
    float* alpha;       // (H, W)
    float* depth;       // (H, W), the mean
    float* max_weight;  // (N,), raised if this view has a larger weight
    float* weight_sum;  // (N,), this view's weights are added, each times its pixel's weight:
    const float* pixel_weights;  // (H, W), read; null: 1 everywhere
    float* surface;  // (5, H, W): sum of weight x depth of the planes, their median depth, and sum of
                     // weight x normal, camera frame (plane.h)
};

// dL / d(outputs).
struct OutputGradients {
    const float* image;    // (3, H, W)
    const float* surface;  // (6, H, W): of Outputs::alpha, then of its surface; null: zero
};

// The gradient sums of a (Gaussian, tile) pair (tile_gradient.h). The last six are for a surface.
enum Moment {
    kS, kSU, kSV, kSUU, kSUV, kSVV, kRed, kGreen, kBlue, kMoments,
    kPlaneDepth = kMoments, kPlaneX, kPlaneY, kNormal, kSurfaceMoments = kNormal + 3
};

// A depth map (height, width), as roigs_fuse_depth samples it.
struct DepthPhoto {
    const float* depth;   // along the camera's z axis; 0: unknown
    const float* weight;  // 0: ignored
    const float* slope;   // distance to the surface / difference in depth
    float pose[12];       // from the frame of the points to the camera's
    float lens[4];        // fx, fy, cx, cy
    float jump;           // relative; depths of neighbours on one surface differ by less
    float truncation;     // of distances, at least
    float footprints;     // .. and relative to the depth
    int32_t size[2];      // width, height
};

}  // namespace roigs
