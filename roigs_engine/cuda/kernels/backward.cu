// Gradient of the projection: from the moments in a Gaussian's slots to its parameters, and with it
// the step of Adam. A thread for each Gaussian.
#include "frame.h"
#include "geometry_gradient.h"
#include "sh.h"

namespace roigs {

// dL / d(parameter) of one Gaussian; that of the SH is basis times colour.
struct RowGradient {
    float mean[3], quat[4], scale[3], opacity[1];
    float basis[kMaxCoefficients], colour[3];
};

__device__ void colour_gradient(const Frame& f, const Camera& camera, int64_t n,
                                const Geometry& g, const float (&moments)[16],
                                RowGradient& row) {
    const int used = used_coefficients(f.gaussians);
    for (int c = 0; c < 3; ++c)  // colours clamped to 0 pass no gradient
        row.colour[c] =
            f.splats[n * kColumns + kColour + c] > 0.0f ? moments[kRed + c] : 0.0f;
    float direction[3];
    const float inverse_distance = view_direction(g.mean, camera, direction);
    sh_basis(direction, row.basis);
    for (int k = used; k < kMaxCoefficients; ++k) row.basis[k] = 0.0f;
    if (used == 1) return;
    const float* sh = f.gaussians.sh + n * 3 * f.gaussians.sh_coefficients;
    float weight[kMaxCoefficients] = {}, d[3];
    for (int k = 0; k < used; ++k) weight[k] = dot3(row.colour, sh + 3 * k);
    sh_direction_gradient(direction, weight, d);
    const float along = dot3(d, direction);
    for (int k = 0; k < 3; ++k)
        row.mean[k] += (d[k] - along * direction[k]) * inverse_distance;
}

__device__ void row_gradient(const Frame& f, int64_t n, RowGradient& row) {
    float moments[16] = {};
    const int64_t first = f.first_slot[n];
    for (int i = 0; i < f.pair_counts[n]; ++i)
        for (int k = 0; k < kMoments; ++k) moments[k] += f.moments[(first + i) * kMoments + k];
    const int32_t id = int32_t(n);
    const Camera camera = f.camera();
    Geometry g;
    project_centres(f.gaussians, camera, &id, g);
    project_shapes(f.gaussians, camera, &id, g);
    const Gradient2d d = unwhiten(camera, g, moments);
    float dT[2][3];
    covariance_gradient(g, d, row.scale, row.quat, dT);
    centre_gradient(camera, g, d, dT, row.mean);
    colour_gradient(f, camera, n, g, moments, row);
    row.opacity[0] =
        f.gaussians.raw ? moments[kS] * (1.0f - g.opacity) : moments[kS] / g.opacity;
    if (f.gaussians.raw)
        for (int k = 0; k < 3; ++k) row.scale[k] *= g.scale[k];
    const float x = 0.5f * camera.width * d.x, y = 0.5f * camera.height * d.y;
    f.grad2d[n] = sqrt(x * x + y * y);
}

template <int kWidth>
__device__ void add_row(float* matrix, int64_t n, const float (&row)[kWidth]) {
    if (!matrix) return;
    for (int k = 0; k < kWidth; ++k) matrix[n * kWidth + k] += row[k];
}

// One element, as in kernels/adam.h.
__device__ void adam_element(const Step& s, const AdamParameter& p, int64_t n, int column,
                             float gradient) {
    constexpr float kTinyMoment = 1e-30f;
    const int64_t at = n * p.width + column;
    float mean = p.exp_avg[at] + s.add1 * (gradient - p.exp_avg[at]);
    if (fabsf(mean) < kTinyMoment) mean = 0.0f;
    const float square = p.exp_avg_sq[at] + s.add2 * (gradient * gradient - p.exp_avg_sq[at]);
    const float denominator = sqrt(square) * s.inverse_sqrt_correction2 + s.epsilon;
    p.values[at] -= s.rate_scale * p.rates[column] * mean / denominator;
    p.exp_avg[at] = mean;
    p.exp_avg_sq[at] = square;
}

template <int kWidth>
__device__ void adam_row(const Step& s, int parameter, int64_t n, const float (&row)[kWidth]) {
    for (int k = 0; k < kWidth; ++k)
        if (!is_finite(row[k])) {
            atomicAdd(s.skipped, 1);
            return;
        }
    for (int k = 0; k < kWidth; ++k) adam_element(s, s.parameters[parameter], n, k, row[k]);
}

}  // namespace roigs

using namespace roigs;

// Adds to the rows of the visible Gaussians.
extern "C" __global__ void __launch_bounds__(128) project_backward(const Frame f) {
    const int64_t n = thread_index();
    if (n >= f.gaussians.count || !f.pair_counts[n]) return;
    RowGradient row;
    row_gradient(f, n, row);
    add_row(f.gradients.means, n, row.mean);
    add_row(f.gradients.quats, n, row.quat);
    add_row(f.gradients.scales, n, row.scale);
    add_row(f.gradients.opacities, n, row.opacity);
    if (!f.gradients.sh) return;
    float* sh = f.gradients.sh + n * 3 * f.gaussians.sh_coefficients;
    for (int k = 0; k < used_coefficients(f.gaussians); ++k)
        for (int c = 0; c < 3; ++c) sh[3 * k + c] += row.basis[k] * row.colour[c];
}

// Takes the step instead. The rows of the SH are wide: a warp takes them one after the other, a
// column per lane, so that its threads read neighbours in memory.
extern "C" __global__ void __launch_bounds__(128) project_backward_adam(const Step s) {
    constexpr int kWarp = 32, kWarps = 4;
    __shared__ float bases[kWarps][kMaxCoefficients], colours[kWarps][3];
    const Frame& f = s.frame;
    const int64_t n = thread_index();
    const int warp = int(threadIdx.x) / kWarp, lane = int(threadIdx.x) % kWarp;
    const bool is_visible = n < f.gaussians.count && f.pair_counts[n];
    RowGradient row;
    if (is_visible) {
        row_gradient(f, n, row);
        adam_row(s, 0, n, row.mean);
        adam_row(s, 1, n, row.quat);
        adam_row(s, 2, n, row.scale);
        adam_row(s, 3, n, row.opacity);
    }
    const int width = 3 * f.gaussians.sh_coefficients;
    const unsigned visible = __ballot_sync(0xffffffffu, is_visible);
    for (int owner = 0; owner < kWarp; ++owner) {
        if (!(visible >> owner & 1)) continue;
        if (lane == owner) {
            for (int k = 0; k < kMaxCoefficients; ++k) bases[warp][k] = row.basis[k];
            for (int c = 0; c < 3; ++c) colours[warp][c] = row.colour[c];
        }
        __syncwarp();
        float of_column[2];
        for (int half = 0; half < 2; ++half) {
            const int column = lane + half * kWarp;
            of_column[half] =
                column < width ? bases[warp][column / 3] * colours[warp][column % 3] : 0.0f;
        }
        const unsigned broken = __ballot_sync(
            0xffffffffu, !is_finite(of_column[0]) || !is_finite(of_column[1]));
        for (int half = 0; half < 2 && !broken; ++half)
            if (lane + half * kWarp < width)
                adam_element(s, s.parameters[4], n - lane + owner, lane + half * kWarp,
                             of_column[half]);
        if (broken && lane == 0) atomicAdd(s.skipped, 1);
        __syncwarp();  // the next owner writes where this one was read
    }
}
