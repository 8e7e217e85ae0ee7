// Gradient of the projection: from the moments that the raster pass left in the slots to the
// Gaussians' parameters. Batches of Gaussians that have one, one per lane.
#include "adam.h"
#include "geometry_gradient.h"
#include "light.h"
#include "surface_gradient.h"
#include "sh.h"
#include "view.h"

namespace roigs {
namespace {

// The splats of a chunk that have a gradient.
struct ChunkSplats {
    int count = 0;
    int32_t splat[kChunk];

    ChunkSplats(const View& view, int64_t chunk) {
        const int32_t begin = int32_t(chunk * kChunk);
        for (int32_t i = begin; i < begin + view.chunks[chunk].visible; ++i) {
            splat[count] = i;  // no branch: which have one cannot be guessed
            count += view.splats[i].has_gradient;
        }
    }
};

// kLanes of them, from the one at `first` on; beyond `count`, the last one is repeated.
struct SplatBatch : BatchRows {
    SplatBatch(const View& view, const ChunkSplats& chunk, int first, int end, int32_t first_id) {
        count = std::min(kLanes, end - first);
        for (int i = 0; i < kLanes; ++i) {
            splat[i] = chunk.splat[first + std::min(i, count - 1)];
            id[i] = view.splats[splat[i]].id;
            row[i] = id[i] - first_id;
        }
    }
};

// Sums each splat's slots, in the order of its tiles.
void sum_slots(const View& view, const SplatBatch& batch, Floats (&moments)[16]) {
    alignas(64) float rows[kLanes][16];
    for (int i = 0; i < kLanes; ++i) {
        Floats sum[16 / kLanes] = {};
        const SlotGradient* slot = &view.slot_gradients[view.slot(batch.splat[i])];
        for (int t = 0; t < view.tiles_of[batch.splat[i]].count; ++t)
            for (int k = 0; k * kLanes < kMoments; ++k) sum[k] += load(slot[t].sum + k * kLanes);
        for (int k = 0; k * kLanes < 16; ++k) store(&rows[i][k * kLanes], sum[k]);
    }
    int32_t in_order[kLanes];
    for (int i = 0; i < kLanes; ++i) in_order[i] = i;
    load_columns(&rows[0][0], 16, 16, in_order, moments);
}

// Gradient of the colours: adds to the SH rows, and to `mean` through the viewing direction.
void colour_gradient(const View& view, const Gaussians& gaussians, const SplatBatch& batch,
                     const Geometry& g, const Floats (&moments)[16], float* sh_gradient,
                     Floats (&mean)[3]) {
    const int used = used_coefficients(gaussians), stride = 3 * gaussians.sh_coefficients;
    Floats colour[3], drawn[4];
    load_few_columns<3>(&view.splats[0].red, sizeof(Splat) / sizeof(float), batch.splat, drawn);
    for (int c = 0; c < 3; ++c)  // colours clamped to 0 pass no gradient
        colour[c] = keep(greater(drawn[c], Floats{}), moments[kRed + c]);
    if (gaussians.linear_light)
        for (int c = 0; c < 3; ++c)
            colour[c] = keep(greater(drawn[c], Floats{}), colour[c] * linear_slope(drawn[c]));

    Floats direction[3], basis[kMaxCoefficients], sh[3 * kMaxCoefficients];
    const Floats inverse_distance = view_direction(g.mean, view.camera, direction);
    if (used > 1) {
        load_columns(gaussians.sh, stride, 3 * used, batch.id, sh);
        Floats weight[kMaxCoefficients] = {};
        for (int k = 0; k < used; ++k) weight[k] = dot3(colour, sh + 3 * k);
        Floats d[3];
        sh_direction_gradient(direction, weight, d);
        const Floats along = dot3(d, direction);  // changes nothing: directions are unit vectors
        for (int k = 0; k < 3; ++k) mean[k] += (d[k] - along * direction[k]) * inverse_distance;
    }
    if (!sh_gradient) return;
    sh_basis(direction, basis);
    for (int k = 0; k < used; ++k)
        for (int c = 0; c < 3; ++c) sh[3 * k + c] = basis[k] * colour[c];
    add_columns(sh_gradient, stride, 3 * used, batch.row, batch.count, sh);
}

template <int kColumns>
void add_rows(float* matrix, const SplatBatch& batch, const Floats (&columns)[kColumns]) {
    if (!matrix) return;
    for_each_quad(columns, [&](int i, Quad row) {
        if (i >= batch.count) return;
        float* place = matrix + int64_t(batch.row[i]) * kColumns;
        for (int k = 0; k < kColumns; ++k) place[k] += row[k];
    });
}

void batch_gradient(const View& view, const Gaussians& gaussians, const Gradients& out,
                    const SplatBatch& batch, float* grad2d) {
    Floats moments[16];
    sum_slots(view, batch, moments);
    Geometry g;
    project_centres(gaussians, view.camera, batch.id, g);
    project_shapes(gaussians, view.camera, batch.id, g);
    const Gradient2d d = unwhiten(view.camera, g, moments);
    Floats scale[3], quat[4], dT[2][3], mean[3];
    covariance_gradient(view.camera, g, d, nullptr, scale, quat, dT);
    centre_gradient(view.camera, g, d, nullptr, dT, mean);
    colour_gradient(view, gaussians, batch, g, moments, out.sh, mean);

    // kS = opacity dL / d(opacity), the drawn one's as well as the stored one's
    Floats opacity[1] = {gaussians.raw ? moments[kS] * (1.0f - g.opacity)
                                       : moments[kS] / g.opacity};
    if (gaussians.raw)
        for (int k = 0; k < 3; ++k) scale[k] *= g.scale[k];
    add_rows(out.means, batch, mean);
    add_rows(out.quats, batch, quat);
    add_rows(out.scales, batch, scale);
    add_rows(out.opacities, batch, opacity);

    const Floats x = 0.5f * view.camera.width * d.x, y = 0.5f * view.camera.height * d.y;
    const Floats norm = sqrt(x * x + y * y);
    for (int i = 0; i < batch.count; ++i) grad2d[batch.id[i]] = norm[i];
}

// Starts fetching what the batch at `first` will read, and the rows of `matrices` (widths: those
// of the parameters) that it will write.
template <int kMatrices>
void prefetch_batch(const View& view, const Gaussians& gaussians, const ChunkSplats& chunk,
                    int first, const float* const (&matrices)[kMatrices],
                    const int (&widths)[kMatrices]) {
    const int colours = 3 * used_coefficients(gaussians);  // other rows are shorter than a line
    for (int i = first; i < std::min(first + kLanes, chunk.count); ++i) {
        const int32_t splat = chunk.splat[i];
        const int64_t row = view.splats[splat].id;
        for (int t = 0; t < view.tiles_of[splat].count; ++t)
            __builtin_prefetch(&view.slot_gradients[view.slot(splat) + t]);
        prefetch_row<false>(gaussians.sh + row * 3 * gaussians.sh_coefficients, colours);
        for (int k = 0; k < kMatrices; ++k)
            if (matrices[k])
                prefetch_row<true>(matrices[k] + row * widths[k], std::min(widths[k], colours));
    }
}

constexpr int kParameters = 5;  // means, quats, scales, opacities, sh
constexpr int kColours = 4;     // sh; those of higher degrees than are drawn stay as they are

// Takes Adam's step on the Gaussians of a chunk that have a gradient, a group at a time: the group's
// gradients stay in the first cache until they are used.
class ChunkStep {
public:
    ChunkStep(const View& view, const Gaussians& gaussians, const Adam& adam,
              const std::vector<AdamRows>& steps, int64_t chunk, float* grad2d)
        : view_(view),
          gaussians_(gaussians),
          adam_(adam),
          steps_(steps),
          splats_(view, chunk),
          grad2d_(grad2d) {}

    // Returns the number of rows left out, see roigs_adam.
    int64_t take() {
        int64_t broken = 0;
        for (int first = 0; first < splats_.count;) {
            const int32_t first_id = id(first);
            int next = first;
            while (next < splats_.count && next - first < kSplats && id(next) - first_id < kRows)
                moves_[id(next++) - first_id] = 1;
            group_gradient(first, next);
            const int32_t rows = id(next - 1) - first_id + 1;
            float* const gradients[] = {means_, quats_, scales_, opacities_, sh_};
            for (int k = 0; k < kParameters; ++k)
                broken += steps_[k].update(first_id, rows, gradients[k], moves_);
            std::fill_n(moves_, rows, 0);
            first = next;
        }
        return broken;
    }

private:
    static constexpr int kSplats = 64;  // of a group: whole batches
    static constexpr int kRows = 256;   // that a group may span, its own and others

    int32_t id(int i) const { return view_.splats[splats_.splat[i]].id; }

    void group_gradient(int first, int next) {
        const Gradients gradients{means_, quats_, scales_, opacities_, sh_};
        const float* moments[2 * kParameters];
        int widths[2 * kParameters];
        for (int k = 0; k < kParameters; ++k) {
            moments[k] = adam_.parameters[k].exp_avg;
            moments[k + kParameters] = adam_.parameters[k].exp_avg_sq;
            widths[k] = widths[k + kParameters] = int(adam_.parameters[k].width);
        }
        for (int i = first; i < next; i += kLanes) {
            prefetch_batch(view_, gaussians_, splats_, i + kLanes, moments, widths);
            const SplatBatch batch(view_, splats_, i, next, id(first));
            batch_gradient(view_, gaussians_, gradients, batch, grad2d_);
            if (view_.has_plane_gradient)
                add_plane_gradient(view_, gaussians_, gradients, batch, grad2d_);
        }
    }

    const View& view_;
    const Gaussians& gaussians_;
    const Adam& adam_;
    const std::vector<AdamRows>& steps_;
    const ChunkSplats splats_;
    float* grad2d_;
    // zero between groups
    uint8_t moves_[kRows] = {};
    alignas(64) float means_[3 * kRows] = {}, quats_[4 * kRows] = {}, scales_[3 * kRows] = {},
        opacities_[kRows] = {}, sh_[3 * kMaxCoefficients * kRows] = {};
};

}  // namespace
}  // namespace roigs

void roigs_project_backward(roigs::View* view, const roigs::Gaussians* gaussians,
                            const roigs::Gradients* gradients, float* grad2d) {
    using namespace roigs;
    const Gradients& out = *gradients;
    const float* const matrices[] = {out.means, out.quats, out.scales, out.opacities, out.sh};
    const int widths[] = {3, 4, 3, 1, 3 * gaussians->sh_coefficients};
    parallel_for(int64_t(view->chunks.size()), [&](int64_t c) {
        const ChunkSplats chunk(*view, c);
        for (int first = 0; first < chunk.count; first += kLanes) {
            prefetch_batch(*view, *gaussians, chunk, first + kLanes, matrices, widths);
            const SplatBatch batch(*view, chunk, first, chunk.count, 0);
            batch_gradient(*view, *gaussians, out, batch, grad2d);
            if (view->has_plane_gradient)
                add_plane_gradient(*view, *gaussians, out, batch, grad2d);
        }
    });
}

int64_t roigs_project_backward_adam(roigs::View* view, const roigs::Gaussians* gaussians,
                                    const roigs::Adam* adam, float* grad2d) {
    using namespace roigs;
    std::vector<AdamRows> steps;
    for (int k = 0; k < kParameters; ++k) {
        const AdamParameter& parameter = adam->parameters[k];
        steps.emplace_back(*adam, parameter,
                           k == kColours ? 3 * used_coefficients(*gaussians) : parameter.width);
    }
    const int64_t tasks = int64_t(view->chunks.size());
    std::vector<int64_t> broken(tasks, 0);
    parallel_for(tasks, [&](int64_t c) {
        broken[c] = ChunkStep(*view, *gaussians, *adam, steps, c, grad2d).take();
    });
    int64_t total = 0;
    for (int64_t count : broken) total += count;
    return total;
}
