// The planes of the splats (plane.h), for depth and normals, and their gradient.
#include "plane.h"
#include "surface_gradient.h"

namespace roigs {
namespace {

void add_rows(float* matrix, const BatchRows& batch, const Floats* columns, int width) {
    for (int i = 0; matrix && i < batch.count; ++i)
        for (int k = 0; k < width; ++k)
            matrix[int64_t(batch.row[i]) * width + k] += columns[k][i];
}

}  // namespace

void add_plane_gradient(const View& view, const Gaussians& gaussians, const Gradients& out,
                        const BatchRows& batch, float* grad2d) {
    Floats moments[16] = {};
    for (int i = 0; i < kLanes; ++i) {
        const SlotGradient* slot = &view.slot_gradients[view.slot(batch.splat[i])];
        for (int t = 0; t < view.tiles_of[batch.splat[i]].count; ++t)
            for (int k = 0; k < kSurfaceMoments; ++k) moments[k][i] += slot[t].sum[k];
    }
    Geometry g;
    project_centres(gaussians, view.camera, batch.id, g);
    project_shapes(gaussians, view.camera, batch.id, g);
    Gradient2d d = {};
    const PlaneGradient plane = plane_gradient(view.camera, g, moments, d);
    Floats scale[3], quat[4], dT[2][3], mean[3];
    covariance_gradient(view.camera, g, d, &plane, scale, quat, dT);
    centre_gradient(view.camera, g, d, &plane, dT, mean);
    if (gaussians.raw)
        for (int k = 0; k < 3; ++k) scale[k] *= g.scale[k];
    add_rows(out.means, batch, mean, 3);
    add_rows(out.quats, batch, quat, 4);
    add_rows(out.scales, batch, scale, 3);

    const Gradient2d colour = unwhiten(view.camera, g, moments);
    const Floats x = 0.5f * view.camera.width * (d.x + colour.x);
    const Floats y = 0.5f * view.camera.height * (d.y + colour.y);
    const Floats norm = sqrt(x * x + y * y);
    for (int i = 0; i < batch.count; ++i) grad2d[batch.id[i]] = norm[i];
}

}  // namespace roigs

int64_t roigs_project_planes(roigs::View* view, const roigs::Gaussians* gaussians) {
    using namespace roigs;
    const int64_t chunk_count = int64_t(view->chunks.size());
    if (!view->planes.reserve(chunk_count * kChunk)) return kOutOfMemory;
    parallel_for(chunk_count, [&](int64_t c) {
        const int64_t begin = c * kChunk, end = begin + view->chunks[c].visible;
        for (int64_t first = begin; first < end; first += kLanes) {
            int32_t ids[kLanes];
            for (int i = 0; i < kLanes; ++i)
                ids[i] = view->splats[std::min(first + i, end - 1)].id;
            Geometry g;
            project_centres(*gaussians, view->camera, ids, g);
            project_shapes(*gaussians, view->camera, ids, g);
            const Plane p = plane_of(g, view->camera);
            for (int i = 0; i < std::min<int64_t>(kLanes, end - first); ++i)
                view->planes[first + i] = {
                    g.x[i],        g.y[i],         g.t[2][i],
                    p.slope[0][i], p.slope[1][i], {p.normal[0][i], p.normal[1][i], p.normal[2][i]}};
        }
    });
    return 0;
}
