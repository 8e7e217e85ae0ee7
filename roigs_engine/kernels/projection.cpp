// Forward projection: from Gaussians in the world to splats on the image and the tiles they touch.
#include <atomic>

#include "geometry.h"
#include "light.h"
#include "sh.h"
#include "tile_lists.h"

namespace roigs {
namespace {

// Tiles listed before all are counted. This limits the memory of a refused view to 512 MiB.
constexpr int64_t kListedUncounted = 1 << 27;

// Writes the splats of the lanes that can touch a pixel to `out`, without colours. Returns their
// number.
int pack_splats(const Geometry& g, Mask usable, const PixelBounds& bounds, const int32_t* ids,
                Splat* out) {
    const Floats log2_opacity = log2(drawn_opacity(g));
    const Floats headroom = log2_opacity - (kLog2AlphaMin - kCullSlack);  // u^2 + v^2 stays below
    usable = both(usable, greater(log2_opacity, splat(kLog2AlphaMin)));
    // u^2 + v^2 = kExponentScale d^T Sigma'^-1 d, and d_x^2 <= Sigma'_xx d^T Sigma'^-1 d
    const Floats reach2 = max(headroom, Floats{}) / kExponentScale;
    const Floats reach_x = sqrt(reach2 * g.xx), reach_y = sqrt(reach2 * g.yy);
    usable = both(usable, both(greater(g.x + reach_x, splat(bounds.left)),
                               less(g.x - reach_x, splat(bounds.right))));
    usable = both(usable, both(greater(g.y + reach_y, splat(bounds.top)),
                               less(g.y - reach_y, splat(bounds.bottom))));

    const Whitening w = whitening(g);
    Floats columns[16] = {g.x,  // in the order of Splat's members
                          g.y,
                          w.l11,
                          w.l21,
                          w.l22,
                          log2_opacity,
                          g.xy / g.xx,
                          g.xy / g.yy,
                          {},
                          {},
                          {},
                          g.t[2],
                          reach_x,
                          reach_y,
                          {},
                          {}};
    for (const Floats& column : columns) usable = both(usable, is_finite(column));
    usable = both(usable, both(is_finite(g.determinant), is_finite(g.opacity)));
    uint32_t lanes = bits(usable);
    if (!lanes) return 0;

    alignas(64) float rows[kLanes][16];
    for (int first = 0; first < 16; first += kLanes) {
        Floats tile[kLanes];
        for (int i = 0; i < kLanes; ++i) tile[i] = columns[first + i];
        transpose(tile);
        for (int i = 0; i < kLanes; ++i) store(&rows[i][first], tile[i]);
    }
    int count = 0;
    for (; lanes; lanes &= lanes - 1) {
        const int lane = __builtin_ctz(lanes);
        std::memcpy(&out[count], rows[lane], sizeof(Splat));
        out[count++].id = ids[lane];
    }
    return count;
}

// Fills `ids` with kLanes consecutive rows. After the last row, that row is repeated.
Mask consecutive(int64_t first, int64_t end, int32_t* ids) {
    for (int i = 0; i < kLanes; ++i) ids[i] = int32_t(std::min(first + i, end - 1));
    return first_lanes(int(std::min<int64_t>(end - first, kLanes)));
}

// Colours max(SH(direction) + 1/2, 0), or their light. A colour that is not finite stays unchanged.
void colour_splats(const Gaussians& gaussians, const Camera& camera, Splat* splats, int count) {
    const int used = used_coefficients(gaussians), stride = 3 * gaussians.sh_coefficients;
    for (int first = 0; first < count; first += kLanes) {
        const int lanes = std::min(kLanes, count - first);
        for (int i = first + kLanes; i < std::min(first + 2 * kLanes, count); ++i)
            prefetch_row<false>(gaussians.sh + int64_t(splats[i].id) * stride, 3 * used);
        int32_t ids[kLanes];
        for (int i = 0; i < kLanes; ++i) ids[i] = splats[first + std::min(i, lanes - 1)].id;
        Floats mean[4], direction[3], basis[kMaxCoefficients], sh[3 * kMaxCoefficients];
        load_few_columns<3>(gaussians.means, 3, ids, mean);
        view_direction(mean, camera, direction);
        sh_basis(direction, basis);
        load_columns(gaussians.sh, stride, 3 * used, ids, sh);
        Floats colour[3] = {splat(0.5f), splat(0.5f), splat(0.5f)};
        for (int k = 0; k < used; ++k)
            for (int c = 0; c < 3; ++c) colour[c] += basis[k] * sh[3 * k + c];
        for (int c = 0; c < 3; ++c)
            colour[c] = select(is_finite(colour[c]), max(colour[c], Floats{}), colour[c]);
        if (gaussians.linear_light)
            for (int c = 0; c < 3; ++c)
                colour[c] = select(is_finite(colour[c]), to_linear(colour[c]), colour[c]);
        for_each_quad(colour, [&](int i, Quad rgb) {
            if (i < lanes) std::memcpy(&splats[first + i].red, &rgb, sizeof colour / kLanes);
        });
    }
}

// The number of tiles in the camera's mask above and left of each corner of a tile.
bool sum_tiles(View& view) {
    const int rows = view.tile_rows(), columns = view.tile_columns();
    if (!view.tile_sums.reserve(int64_t(rows + 1) * (columns + 1))) return false;
    std::fill_n(view.tile_sums.data(), columns + 1, 0);
    for (int row = 0; row < rows; ++row) {
        const int32_t* rank = &view.tile_rank[int64_t(row) * columns];
        const int32_t* above = &view.tile_sums[int64_t(row) * (columns + 1)];
        int32_t* below = &view.tile_sums[int64_t(row + 1) * (columns + 1)];
        for (int column = 0; column <= columns; ++column)
            below[column] = above[column] + rank[column] - rank[0];
    }
    return true;
}

// Counts and numbers the tiles in the camera's mask.
bool number_tiles(View& view) {
    view.masked = view.camera.tile_mask != nullptr;
    view.tiles = view.places();
    if (!view.masked) return true;
    if (!view.tile_rank.reserve(view.places() + 1) || !view.tile_place.reserve(view.places()))
        return false;
    int32_t wanted = 0;
    for (int32_t place = 0; place < view.places(); ++place) {
        view.tile_rank[place] = wanted;
        if (view.camera.tile_mask[place]) view.tile_place[wanted++] = place;
    }
    view.tile_rank[view.places()] = wanted;
    view.tiles = wanted;
    return sum_tiles(view);
}

// Keeps the splats whose boxes meet a tile in the mask, because colours cost more than this test.
// Returns their number.
int keep_wanted(const View& view, Splat* splats, int count) {
    const Camera& camera = view.camera;
    const auto tile = [](float pixel, int begin, int end) {
        return int(std::min(std::max(pixel / kTile, float(begin)), float(end - 1))) - begin;
    };
    const int stride = view.tile_columns() + 1;
    int kept = 0;
    for (int i = 0; i < count; ++i) {
        const Splat& s = splats[i];
        const int left = tile(s.x - s.reach_x, camera.tile_x0, camera.tile_x1);
        const int right = tile(s.x + s.reach_x, camera.tile_x0, camera.tile_x1) + 1;
        const int top = tile(s.y - s.reach_y, camera.tile_y0, camera.tile_y1);
        const int bottom = tile(s.y + s.reach_y, camera.tile_y0, camera.tile_y1) + 1;
        const int32_t* above = &view.tile_sums[int64_t(top) * stride];
        const int32_t* below = &view.tile_sums[int64_t(bottom) * stride];
        // no branch, because the processor cannot predict which splats are kept
        splats[kept] = s;
        kept += below[right] - below[left] != above[right] - above[left];
    }
    return kept;
}

// Lists the tiles of a chunk's first `count` splats, and marks visible Gaussians.
bool list_chunk(View& view, int64_t c, int count, ListBudget& budget, uint8_t* visible) {
    Chunk& chunk = view.chunks[c];
    Splat* splats = &view.splats[c * kChunk];
    if (!list_tiles(view, splats, &view.tiles_of[c * kChunk], count, budget, chunk)) return false;
    for (int i = 0; chunk.listed && i < chunk.visible; ++i) visible[splats[i].id] = 1;
    return true;
}

bool project_chunk(View& view, const Gaussians& gaussians, int64_t c, ListBudget& budget,
                   uint8_t* visible) {
    const int64_t begin = c * kChunk, end = std::min(begin + kChunk, gaussians.count);
    const PixelBounds bounds(view.camera);
    Splat* splats = &view.splats[begin];
    int count = 0;
    for (int64_t i = begin; i < end; i += kLanes) {
        int32_t ids[kLanes];
        const Mask exists = consecutive(i, end, ids);
        Geometry g;
        const Mask drawable = project_centres(gaussians, view.camera, ids, g);
        if (!any(drawable)) continue;
        project_shapes(gaussians, view.camera, ids, g);
        const Mask usable = both(exists, both(drawable, in_front(g, view.camera)));
        count += pack_splats(g, usable, bounds, ids, splats + count);
    }
    if (view.masked) count = keep_wanted(view, splats, count);
    colour_splats(gaussians, view.camera, splats, count);
    return list_chunk(view, c, count, budget, visible);
}

// Lists the tiles of the chunks for which the first budget was too small.
bool list_remaining(View& view, uint8_t* visible) {
    std::atomic<bool> failed{false};
    parallel_for(int64_t(view.chunks.size()), [&](int64_t c) {
        if (view.chunks[c].listed) return;
        ListBudget unlimited(std::numeric_limits<int64_t>::max());
        if (!list_chunk(view, c, view.chunks[c].visible, unlimited, visible)) failed = true;
    });
    return !failed;
}

}  // namespace
}  // namespace roigs

roigs::View* roigs_view_create() { return new roigs::View; }

void roigs_view_destroy(roigs::View* view) { delete view; }

int64_t roigs_project(roigs::View* view, const roigs::Gaussians* gaussians,
                      const roigs::Camera* camera, uint8_t* visible) {
    using namespace roigs;
    view->camera = *camera;
    view->visible = view->intersections = 0;
    view->has_plane_gradient = false;
    if (!number_tiles(*view)) return kOutOfMemory;
    const int64_t n = view->tiles ? gaussians->count : 0, chunk_count = chunks(n, kChunk);
    view->chunks.resize(chunk_count);
    if (!view->splats.reserve(n) || !view->tiles_of.reserve(n)) return kOutOfMemory;
    std::atomic<bool> failed{false};
    ListBudget budget(kListedUncounted);
    parallel_for(chunk_count, [&](int64_t c) {
        if (!project_chunk(*view, *gaussians, c, budget, visible)) failed = true;
    });
    if (failed) return kOutOfMemory;
    for (Chunk& chunk : view->chunks) {
        chunk.first_slot = view->intersections;
        view->intersections += chunk.tile_count;
    }
    if (view->intersections > kMostIntersections) return kTooManyIntersections;
    if (!list_remaining(*view, visible)) return kOutOfMemory;
    for (Chunk& chunk : view->chunks) {
        chunk.first_visible = view->visible;
        view->visible += chunk.visible;
    }
    return view->visible;
}
