// The lists of the tiles that the splats of a chunk touch. Batches of splats, one per lane.
#pragma once

#include <atomic>

#include "ellipses.h"
#include "view.h"

namespace roigs {

// From places in the camera's rectangle to numbers of tiles (see View). Runs of length 0 may begin
// anywhere.
ROIGS_INLINE TileRuns wanted_tiles(const View& view, const TileRuns& places) {
    alignas(64) int32_t first[kLanes], length[kLanes];
    std::memcpy(first, &places.first, sizeof first);
    std::memcpy(length, &places.length, sizeof length);
    const int32_t* rank = view.tile_rank.data();
    for (int i = 0; i < kLanes; ++i) {
        const int32_t begin = length[i] ? first[i] : 0;
        first[i] = rank[begin];
        length[i] = rank[begin + length[i]] - first[i];
    }
    TileRuns wanted;
    std::memcpy(&wanted.first, first, sizeof first);
    std::memcpy(&wanted.length, length, sizeof length);
    return wanted;
}

// Writes first, first + 1, .. It may write up to a vector's width more than `length` numbers.
ROIGS_INLINE void write_run(uint32_t* out, int32_t first, int32_t length) {
    Ints tiles;
    for (int i = 0; i < kLanes; ++i) tiles[i] = first + i;
    for (int32_t done = 0; done < length; done += kLanes) {
        std::memcpy(out + done, &tiles, sizeof tiles);
        tiles += kLanes;
    }
}

// The number of tiles that may be listed before the total is known. Without a limit, too many lists
// would fill the memory before this is noticed.
class ListBudget {
public:
    explicit ListBudget(int64_t tiles) : left_(tiles) {}
    bool take(int64_t tiles) {
        return left_.fetch_sub(tiles, std::memory_order_relaxed) >= tiles;
    }

private:
    std::atomic<int64_t> left_;
};

// Lists the tiles of a chunk's splats, and drops splats that touch none or have no finite colour.
// If the budget is too small, it leaves the splats unchanged, counts their tiles, and sets
// chunk.listed to false. Returns false if there is not enough memory.
inline bool list_tiles(const View& view, Splat* splats, TileSpan* tiles_of, int count,
                       ListBudget& budget, Chunk& chunk) {
    constexpr int64_t kTaken = 1 << 12;  // at once, because threads share the budget
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
            runs[r] = runs_in_row(ellipses, r, bounds, camera);
            if (view.masked) runs[r] = wanted_tiles(view, runs[r]);
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
