// Gradient of the projection: from the moments in a Gaussian's slots to its parameters, and with it
// the step of Adam. A thread for each Gaussian.
#include "frame.h"
#include "geometry_gradient.h"
#include "light.h"
#include "plane.h"
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
    for (int c = 0; c < 3; ++c) {  // colours clamped to 0 pass no gradient
        const float drawn = f.splats[n * kColumns + kColour + c];
        const float slope = f.gaussians.linear_light ? linear_slope(drawn) : 1.0f;
        row.colour[c] = drawn > 0.0f ? moments[kRed + c] * slope : 0.0f;
    }
    float direction[3];
    const float inverse_distance = view_direction(g.mean, camera, direction);
    sh_basis(direction, row.basis);
    for (int k = 0; k < kMaxCoefficients; ++k)
        if (k >= used) row.basis[k] = 0.0f;
    if (used == 1) return;
    const float* sh = f.gaussians.sh + n * 3 * f.gaussians.sh_coefficients;
    float weight[kMaxCoefficients] = {}, d[3];
    for (int k = 0; k < kMaxCoefficients; ++k)  // a fixed number: arrays stay in registers
        if (k < used) weight[k] = dot3(row.colour, sh + 3 * k);
    sh_direction_gradient(direction, weight, d);
    const float along = dot3(d, direction);
    for (int k = 0; k < 3; ++k)
        row.mean[k] += (d[k] - along * direction[k]) * inverse_distance;
}

// Adds the gradients through the plane to the row, and to `d`.
__device__ void add_plane_gradient(const Camera& camera, const Geometry& g,
                                   const float (&moments)[16], Gradient2d& d, RowGradient& row) {
    Gradient2d own = {};
    const PlaneGradient plane = plane_gradient(camera, g, moments, own);
    float dT[2][3];
    RowGradient more;
    covariance_gradient(camera, g, own, &plane, more.scale, more.quat, dT);
    centre_gradient(camera, g, own, &plane, dT, more.mean);
    for (int k = 0; k < 3; ++k) row.scale[k] += more.scale[k], row.mean[k] += more.mean[k];
    for (int k = 0; k < 4; ++k) row.quat[k] += more.quat[k];
    d.x += own.x;
    d.y += own.y;
}

// False: no pixel gives it a gradient.
__device__ bool row_gradient(const Frame& f, int64_t n, RowGradient& row) {
    float moments[16] = {};
    const int64_t first = f.first_slot[n];
    for (int i = 0; i < f.pair_counts[n]; ++i)
        for (int k = 0; k < kMoments; ++k) moments[k] += f.moments[(first + i) * kMoments + k];
    for (int i = 0; f.plane_moments && i < f.pair_counts[n]; ++i)
        for (int k = 0; k < kPlaneMoments; ++k)
            moments[kMoments + k] += f.plane_moments[(first + i) * kPlaneMoments + k];
    bool has_gradient = false;
    for (int k = 0; k < kSurfaceMoments; ++k) has_gradient |= moments[k] != 0.0f;  // NaN is not zero
    if (!has_gradient) return false;
    const int32_t id = int32_t(n);
    const Camera camera = f.camera();
    Geometry g;
    project_centres(f.gaussians, camera, &id, g);
    project_shapes(f.gaussians, camera, &id, g);
    Gradient2d d = unwhiten(camera, g, moments);
    float dT[2][3];
    covariance_gradient(camera, g, d, nullptr, row.scale, row.quat, dT);
    centre_gradient(camera, g, d, nullptr, dT, row.mean);
    if (f.plane_moments) add_plane_gradient(camera, g, moments, d, row);
    colour_gradient(f, camera, n, g, moments, row);
    row.opacity[0] =
        f.gaussians.raw ? moments[kS] * (1.0f - g.opacity) : moments[kS] / g.opacity;
    if (f.gaussians.raw)
        for (int k = 0; k < 3; ++k) row.scale[k] *= g.scale[k];
    const float x = 0.5f * camera.width * d.x, y = 0.5f * camera.height * d.y;
    f.grad2d[n] = sqrt(x * x + y * y);
    return true;
}

template <int kWidth>
__device__ void add_row(float* matrix, int64_t n, const float (&row)[kWidth]) {
    if (!matrix) return;
    for (int k = 0; k < kWidth; ++k) matrix[n * kWidth + k] += row[k];
}

// One element of a parameter, as in kernels/adam.h. Memory takes hundreds of cycles to answer, and
// nothing may be read ahead of a store: so all that a thread updates is loaded first.
struct Element {
    float value, mean, square;

    ROIGS_INLINE void load(const AdamParameter& p, int64_t at) {
        value = p.values[at];
        mean = p.exp_avg[at];
        square = p.exp_avg_sq[at];
    }
    ROIGS_INLINE void step(const Step& s, float rate, float gradient) {
        constexpr float kTinyMoment = 1e-30f;
        mean = mean + s.add1 * (gradient - mean);
        if (fabsf(mean) < kTinyMoment) mean = 0.0f;
        square = square + s.add2 * (gradient * gradient - square);
        const float denominator = sqrt(square) * s.inverse_sqrt_correction2 + s.epsilon;
        value -= s.rate_scale * rate * mean / denominator;
    }
    ROIGS_INLINE void store(const AdamParameter& p, int64_t at) const {
        p.values[at] = value;
        p.exp_avg[at] = mean;
        p.exp_avg_sq[at] = square;
    }
};

// The factor of a Gaussian's rates; like all else that is loaded, before anything is stored.
ROIGS_INLINE float row_rate(const Step& s, int64_t n) { return s.row_rates ? s.row_rates[n] : 1.0f; }

// A Gaussian's row of a narrow parameter.
template <int kWidth>
struct AdamRow {
    Element elements[kWidth];

    ROIGS_INLINE void load(const AdamParameter& p, int64_t n) {
        for (int k = 0; k < kWidth; ++k) elements[k].load(p, n * kWidth + k);
    }
    ROIGS_INLINE void update(const Step& s, const AdamParameter& p, int64_t n, float factor,
                             const float (&gradient)[kWidth]) {
        for (int k = 0; k < kWidth; ++k)
            if (!is_finite(gradient[k])) {
                atomicAdd(s.skipped, 1);
                return;
            }
        for (int k = 0; k < kWidth; ++k) {
            elements[k].step(s, factor * p.rates[k], gradient[k]);
            elements[k].store(p, n * kWidth + k);
        }
    }
};

__device__ void update_narrow_rows(const Step& s, int64_t n, const RowGradient& row) {
    const AdamParameter* p = s.parameters;
    AdamRow<3> means, scales;
    AdamRow<4> quats;
    AdamRow<1> opacities;
    const float factor = row_rate(s, n);
    means.load(p[0], n);
    quats.load(p[1], n);
    scales.load(p[2], n);
    opacities.load(p[3], n);
    means.update(s, p[0], n, factor, row.mean);
    quats.update(s, p[1], n, factor, row.quat);
    scales.update(s, p[2], n, factor, row.scale);
    opacities.update(s, p[3], n, factor, row.opacity);
}

constexpr int kWarp = 32, kWarps = 4;
constexpr int kSide = 4;  // rows of SH that a warp has under way

// What the rows of SH of a warp's Gaussians need: their gradient is basis times colour.
struct WideRows {
    float basis[kWarp][kMaxCoefficients + 1];  // one more: lanes write to different banks
    float colour[kWarp][3];

    // False: an element of the row's gradient is not finite.
    ROIGS_INLINE bool set(int lane, const RowGradient& row, int coefficients) {
        bool finite = true;
        for (int k = 0; k < kMaxCoefficients; ++k) basis[lane][k] = row.basis[k];
        for (int c = 0; c < 3; ++c) colour[lane][c] = row.colour[c];
        for (int k = 0; k < kMaxCoefficients; ++k)
            for (int c = 0; c < 3; ++c)
                finite &= k >= coefficients || is_finite(row.basis[k] * row.colour[c]);
        return finite;
    }
};

// A warp takes kSide rows at a time, a column per lane, so that its threads read neighbours in
// memory. `first`: the Gaussian of lane 0; `todo`: a bit for each lane whose row is updated.
__device__ void update_wide_rows(const Step& s, const WideRows& rows, int64_t first, int lane,
                                 unsigned todo) {
    const AdamParameter& p = s.parameters[4];
    const int width = int(p.width), used = 3 * used_coefficients(s.frame.gaussians);
    for (int column = lane; column < used; column += kWarp) {
        const float rate = p.rates[column];
        for (unsigned left = todo; left;) {
            int owner[kSide];
            float factor[kSide];
            Element element[kSide];
            for (int i = 0; i < kSide; ++i) {
                owner[i] = __ffs(int(left)) - 1;  // -1: none is left
                left &= left - 1;
                if (owner[i] < 0) continue;
                factor[i] = row_rate(s, first + owner[i]);
                element[i].load(p, (first + owner[i]) * width + column);
            }
            for (int i = 0; i < kSide; ++i) {
                if (owner[i] < 0) continue;
                const float gradient =
                    rows.basis[owner[i]][column / 3] * rows.colour[owner[i]][column % 3];
                element[i].step(s, factor[i] * rate, gradient);
                element[i].store(p, (first + owner[i]) * width + column);
            }
        }
    }
}

}  // namespace roigs

using namespace roigs;

// Adds to the rows of the Gaussians that have a gradient.
extern "C" __global__ void __launch_bounds__(128) project_backward(const Frame f) {
    const int64_t n = thread_index();
    if (n >= f.gaussians.count || !f.pair_counts[n]) return;
    RowGradient row;
    if (!row_gradient(f, n, row)) return;
    add_row(f.gradients.means, n, row.mean);
    add_row(f.gradients.quats, n, row.quat);
    add_row(f.gradients.scales, n, row.scale);
    add_row(f.gradients.opacities, n, row.opacity);
    if (!f.gradients.sh) return;
    float* sh = f.gradients.sh + n * 3 * f.gaussians.sh_coefficients;
    for (int k = 0; k < kMaxCoefficients; ++k)
        for (int c = 0; c < 3 && k < used_coefficients(f.gaussians); ++c)
            sh[3 * k + c] += row.basis[k] * row.colour[c];
}

// Takes the step instead.
extern "C" __global__ void __launch_bounds__(kWarps * kWarp) project_backward_adam(const Step s) {
    __shared__ WideRows rows[kWarps];
    const Frame& f = s.frame;
    const int64_t n = thread_index();
    const int warp = int(threadIdx.x) / kWarp, lane = int(threadIdx.x) % kWarp;
    RowGradient row;
    bool takes_wide =
        n < f.gaussians.count && f.pair_counts[n] && row_gradient(f, n, row);
    if (takes_wide) {
        update_narrow_rows(s, n, row);
        takes_wide = rows[warp].set(lane, row, f.gaussians.sh_coefficients);
        if (!takes_wide) atomicAdd(s.skipped, 1);
    }
    const unsigned todo = __ballot_sync(0xffffffffu, takes_wide);
    __syncwarp();
    update_wide_rows(s, rows[warp], n - lane, lane, todo);
}
