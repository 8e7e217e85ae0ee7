// The tiles that splats touch: those in which the ellipse alpha >= 1/255 meets the hull of the
// tile's pixel centres. The result is exact, and takes one step per row of tiles: a row cuts a
// horizontal slab out of the ellipse. The ellipse is convex, so the splat touches the tiles between
// the slab's leftmost and rightmost point, and no others. Batches of splats, one per lane.
#pragma once

#include "constants.h"
#include "simd_rows.h"
#include "types.h"

namespace roigs {

// The rectangle of the pixel centres of the tiles to draw.
struct PixelBounds {
    float left, top, right, bottom;
    explicit PixelBounds(const Camera& c)
        : left(c.tile_x0 * kTile + 0.5f),
          top(c.tile_y0 * kTile + 0.5f),
          right(smaller(c.tile_x1 * kTile, c.width) - 0.5f),
          bottom(smaller(c.tile_y1 * kTile, c.height) - 0.5f) {}

private:
    static int smaller(int a, int b) { return a < b ? a : b; }
};

// In one direction: the tiles whose pixel centres meet [low, high], clipped to [begin, end).
struct TileRange {
    Floats first, last;
    TileRange(Floats low, Floats high, int begin, int end) {
        // clipped before rounding, because values far outside do not fit an integer
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

    // x of the leftmost (sign -1) or rightmost (+1) point with dy in [low, high]. The ellipse's
    // side is farthest out at its extreme point, and falls off from there in both directions.
    Floats side(float sign, Floats low, Floats high) const {
        const Floats dy = clamp(sign * extreme_y, low, high), v = l22 * dy;
        return x + slope_x * dy + sign * inverse_l11 * sqrt(max(headroom - v * v, Floats{}));
    }
};

// A run of neighbouring tiles for each lane: the place of the first one in the camera's rectangle
// of tiles, row by row, and their number.
struct TileRuns {
    Ints first, length;
};

// The tiles in row rows.first + r of each ellipse.
ROIGS_INLINE TileRuns runs_in_row(const Ellipses& e, int r, const PixelBounds& bounds,
                                  const Camera& camera) {
    const Floats row = e.rows.first + float(r), top = row * kTile + 0.5f, low = top - e.y;
    const Floats high = min(top + (kTile - 1), splat(bounds.bottom)) - e.y;
    const Floats left = e.side(-1, low, high), right = e.side(1, low, high);
    const TileRange columns(left, right, camera.tile_x0, camera.tile_x1);
    // the last tile may extend beyond the image, but its hull ends with the image's pixel centres
    const Mask touches = both(e.drawable, both(less(row, e.rows.last + 0.5f),
                                               less(left, splat(bounds.right))));
    const Floats length = max(columns.last - columns.first + 1.0f, Floats{});
    const Floats before = (row - float(camera.tile_y0)) * float(camera.tile_x1 - camera.tile_x0);
    return {to_ints(before + (columns.first - float(camera.tile_x0))),
            to_ints(keep(touches, length))};
}

}  // namespace roigs
