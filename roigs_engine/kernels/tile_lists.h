// Which tiles the splats of a chunk touch: those in which the ellipse alpha >= 1/255 meets the hull
// of the tile's pixel centres. Exact, and one step per row of tiles: a row cuts a horizontal slab
// out of the ellipse, which is convex, so that the tiles between the slab's leftmost and rightmost
// point are touched, and no others. Batches of splats, one per lane.
#pragma once

#include <atomic>

#include "simd_rows.h"
#include "view.h"

namespace roigs {

// The pixel centres of the tiles being worked on lie in this rectangle.
struct PixelBounds {
    float left, top, right, bottom;
    explicit PixelBounds(const Camera& c)
        : left(c.tile_x0 * kTile + 0.5f),
          top(c.tile_y0 * kTile + 0.5f),
          right(std::min(c.tile_x1 * kTile, c.width) - 0.5f),
          bottom(std::min(c.tile_y1 * kTile, c.height) - 0.5f) {}
};

// In one direction: the tiles whose pixel centres meet [low, high], clipped to [begin, end).
struct TileRange {
    Floats first, last;
    TileRange(Floats low, Floats high, int begin, int end) {
        // clipped before rounding: what is far outside does not fit an integer
        const Floats a = (low - (kTile - 0.5f)) * (1.0f / kTile);
        const Floats b = (high - 0.5f) * (1.0f / kTile);
        first = ceil(clamp(a, splat(float(begin)), splat(float(end))));
        last = floor(clamp(b, splat(float(begin - 1)), splat(float(end - 1))));
    }
};

// The splats' ellipses, and the rows of tiles they reach.
struct Ellipses {
    Floats x, y, l22, slope_x, inverse_l11;
    Floats headroom;   // u^2 + v^2 on the ellipse
    Floats extreme_y;  // the ellipse's rightmost point is this far below its centre
    Mask drawable;     // colours are finite
    TileRange rows;

    Ellipses(const Floats (&splat_columns)[16], const Camera& camera)
        : x(splat_columns[0]),
          y(splat_columns[1]),
          l22(splat_columns[4]),
          slope_x(splat_columns[7]),
          inverse_l11(1.0f / splat_columns[2]),
          headroom(splat_columns[5] - (kLog2AlphaMin - kCullSlack)),
          extreme_y(splat_columns[6] * splat_columns[12]),
          drawable(both(is_finite(splat_columns[8]),
                        both(is_finite(splat_columns[9]), is_finite(splat_columns[10])))),
          rows(y - splat_columns[13], y + splat_columns[13], camera.tile_y0, camera.tile_y1) {}

    // x of the leftmost (sign -1) or rightmost (+1) point with dy in [low, high]: the ellipse's
    // side is furthest out at its extreme point, and falls off from there on both sides.
    Floats side(float sign, Floats low, Floats high) const {
        const Floats dy = clamp(sign * extreme_y, low, high), v = l22 * dy;
        return x + slope_x * dy + sign * inverse_l11 * sqrt(max(headroom - v * v, Floats{}));
    }
};

// A run of neighbouring tiles for each lane: the first one's number, and how many.
struct TileRuns {
    Ints first, length;
};

ROIGS_INLINE Ints to_ints(Floats x) { return __builtin_convertvector(x, Ints); }

// From places in the camera's rectangle to numbers of tiles, see View.
ROIGS_INLINE TileRuns wanted_tiles(const View& view, TileRuns places) {
    for (int i = 0; i < kLanes; ++i) {
        if (!places.length[i]) continue;
        const int32_t* rank = &view.tile_rank[places.first[i]];
        places.length[i] = rank[places.length[i]] - rank[0];
        places.first[i] = rank[0];
    }
    return places;
}

// The tiles in row rows.first + r of each ellipse.
ROIGS_INLINE TileRuns runs_in_row(const Ellipses& e, int r, const PixelBounds& bounds,
                                  const View& view) {
    const Camera& camera = view.camera;
    const Floats row = e.rows.first + float(r), top = row * kTile + 0.5f, low = top - e.y;
    const Floats high = min(top + (kTile - 1), splat(bounds.bottom)) - e.y;
    const Floats left = e.side(-1, low, high), right = e.side(1, low, high);
    const TileRange columns(left, right, camera.tile_x0, camera.tile_x1);
    // the last tile may stick out of the image: its hull ends with the image's pixel centres
    const Mask touches = both(e.drawable, both(less(row, e.rows.last + 0.5f),
                                               less(left, splat(bounds.right))));
    const Floats length = max(columns.last - columns.first + 1.0f, Floats{});
    const Floats before = (row - float(camera.tile_y0)) * float(camera.tile_x1 - camera.tile_x0);
    const TileRuns places{to_ints(before + (columns.first - float(camera.tile_x0))),
                          to_ints(keep(touches, length))};
    return view.masked ? wanted_tiles(view, places) : places;
}

// Writes first, first + 1, .., and up to a vector's width more than `length` of them.
ROIGS_INLINE void write_run(uint32_t* out, int32_t first, int32_t length) {
    Ints tiles;
    for (int i = 0; i < kLanes; ++i) tiles[i] = first + i;
    for (int32_t done = 0; done < length; done += kLanes) {
        std::memcpy(out + done, &tiles, sizeof tiles);
        tiles += kLanes;
    }
}

// How many tiles may be listed before their number is known. Without a limit, lists that turn out
// to be too many would have filled the memory before.
class ListBudget {
public:
    explicit ListBudget(int64_t tiles) : left_(tiles) {}
    bool take(int64_t tiles) {
        return left_.fetch_sub(tiles, std::memory_order_relaxed) >= tiles;
    }

private:
    std::atomic<int64_t> left_;
};

// Lists the tiles of a chunk's splats and drops the splats that touch none or have no finite
// colour. Where the budget ends before, it leaves the splats as they are, counts their tiles, and
// sets chunk.listed to false. Returns false when there is not enough memory.
inline bool list_tiles(const View& view, Splat* splats, TileSpan* tiles_of, int count,
                       ListBudget& budget, Chunk& chunk) {
    constexpr int64_t kTaken = 1 << 12;  // at once: the budget is shared between threads
    const Camera& camera = view.camera;
    const PixelBounds bounds(camera);
    int32_t kept = 0, used = 0;
    int64_t counted = 0, taken = 0;
    chunk.listed = true;
    for (int first = 0; first < count; first += kLanes) {
        const int lanes = std::min(kLanes, count - first);
        int32_t index[kLanes];
        for (int i = 0; i < kLanes; ++i) index[i] = first + std::min(i, lanes - 1);
        Floats columns[16];
        load_columns(&splats[0].x, 16, 16, index, columns);
        const Ellipses ellipses(columns, camera);
        const Ints row_count = to_ints(ellipses.rows.last - ellipses.rows.first) + 1;
        int most_rows = 0;
        for (int i = 0; i < lanes; ++i) most_rows = std::max(most_rows, row_count[i]);

        if (!chunk.runs.reserve(most_rows * int64_t(sizeof(TileRuns) / sizeof(int32_t))))
            return false;
        auto* runs = reinterpret_cast<TileRuns*>(chunk.runs.data());
        Ints lengths = {};
        for (int r = 0; r < most_rows; ++r) {
            runs[r] = runs_in_row(ellipses, r, bounds, view);
            lengths += runs[r].length;
        }
        for (int i = 0; i < lanes; ++i) counted += lengths[i];
        while (chunk.listed && taken < counted) {
            chunk.listed = budget.take(kTaken);
            taken += kTaken;
        }
        if (!chunk.listed) continue;
        // write_run may write past the end
        if (!chunk.tiles.extend(counted + kLanes, used)) return false;

        for (int i = 0; i < lanes; ++i) {
            const int32_t begin = used;
            for (int r = 0; r < row_count[i]; ++r) {
                write_run(&chunk.tiles[used], runs[r].first[i], runs[r].length[i]);
                used += runs[r].length[i];
            }
            if (used == begin) continue;
            tiles_of[kept] = {begin, used - begin};
            splats[kept++] = splats[first + i];
        }
    }
    chunk.visible = chunk.listed ? kept : count;
    chunk.tile_count = counted;
    return true;
}

}  // namespace roigs
