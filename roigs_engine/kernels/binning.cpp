// Binning: every tile's list of splats, front to back.
//
// A radix sort puts the splats in order of depth. A counting sort by tile then distributes them to
// the tiles' lists in that order. Both sorts are stable, and both run in parts that keep the order
// of the result. So equal depths stay in the order of the Gaussians, at any number of threads.
#include <cstring>

#include "view.h"

namespace roigs {
namespace {

constexpr int kDigitBits = 11, kDigits = 1 << kDigitBits;  // three digits cover 32 bits
constexpr int64_t kSmallestPart = 8192;                    // fewer splats are not worth a thread

struct Part {
    int64_t begin, end;
};

int part_count(int64_t items) {
    return int(std::max<int64_t>(1, std::min<int64_t>(threads(), items / kSmallestPart)));
}

Part part(int64_t items, int parts, int64_t p) {
    return {items * p / parts, items * (p + 1) / parts};
}

// Turns counts per part and bucket into places: where each part's next item of a bucket goes.
// Buckets are in order, and within a bucket the parts are in order.
void places_from_counts(int32_t* counts, int parts, int64_t buckets) {
    int32_t total = 0;
    for (int64_t b = 0; b < buckets; ++b)
        for (int p = 0; p < parts; ++p) {
            int32_t& place = counts[p * buckets + b];
            const int32_t count = place;
            place = total;
            total += count;
        }
}

// Depths are positive, so their bit patterns have the same order.
void collect_depths(View& view) {
    uint32_t* keys = view.depth_keys[0].data();
    int32_t* order = view.depth_order[0].data();
    parallel_for(int64_t(view.chunks.size()), [&](int64_t c) {
        const Chunk& chunk = view.chunks[c];
        for (int i = 0; i < chunk.visible; ++i) {
            const int32_t splat = int32_t(c * kChunk + i);
            std::memcpy(&keys[chunk.first_visible + i], &view.splats[splat].depth,
                        sizeof(uint32_t));
            order[chunk.first_visible + i] = splat;
        }
    });
}

// One pass of the radix sort, by the digit at `shift`: from buffers `from` to the other ones.
void sort_pass(View& view, int from, int shift, int parts) {
    const uint32_t *keys = view.depth_keys[from].data();
    const int32_t* order = view.depth_order[from].data();
    uint32_t* sorted_keys = view.depth_keys[1 - from].data();
    int32_t* sorted_order = view.depth_order[1 - from].data();
    int32_t* counts = view.histograms.data();
    const auto digit = [&](int64_t i) { return (keys[i] >> shift) & (kDigits - 1); };
    parallel_for(parts, [&](int64_t p) {
        int32_t* mine = counts + p * kDigits;
        std::fill(mine, mine + kDigits, 0);
        const Part r = part(view.visible, parts, p);
        for (int64_t i = r.begin; i < r.end; ++i) ++mine[digit(i)];
    });
    places_from_counts(counts, parts, kDigits);
    parallel_for(parts, [&](int64_t p) {
        int32_t* place = counts + p * kDigits;
        const Part r = part(view.visible, parts, p);
        for (int64_t i = r.begin; i < r.end; ++i) {
            const int32_t to = place[digit(i)]++;
            sorted_keys[to] = keys[i];
            sorted_order[to] = order[i];
        }
    });
}

// Calls visit(splat, tile, slot) for the splats of one part of the depth order. In this order,
// splats are scattered in memory, so their memory is fetched some splats ahead, in two steps.
template <class Visit>
void for_each_tile(const View& view, const int32_t* order, Part r, const Visit& visit) {
    constexpr int64_t kSpanAhead = 32, kTilesAhead = 16;
    for (int64_t i = r.begin; i < r.end; ++i) {
        if (i + kSpanAhead < r.end) __builtin_prefetch(&view.tiles_of[order[i + kSpanAhead]]);
        if (i + kTilesAhead < r.end) {
            const int32_t ahead = order[i + kTilesAhead];
            const Chunk& chunk = view.chunks[ahead / kChunk];
            __builtin_prefetch(&chunk.tiles[view.tiles_of[ahead].first]);
        }
        const int32_t splat = order[i];
        const Chunk& chunk = view.chunks[splat / kChunk];
        const TileSpan span = view.tiles_of[splat];
        for (int32_t t = span.first; t < span.first + span.count; ++t)
            visit(splat, chunk.tiles[t], int32_t(chunk.first_slot + t));
    }
}

void deal_to_tiles(View& view, const int32_t* order, int parts) {
    const int64_t tiles = view.tiles;
    int32_t* counts = view.histograms.data();
    TileEntry* entries = view.entries.data();
    int64_t* begin = view.tile_begin.data();
    parallel_for(parts, [&](int64_t p) {
        int32_t* mine = counts + p * tiles;
        std::fill(mine, mine + tiles, 0);
        for_each_tile(view, order, part(view.visible, parts, p),
                      [&](int32_t, uint32_t tile, int32_t) { ++mine[tile]; });
    });
    places_from_counts(counts, parts, tiles);
    for (int64_t t = 0; t < tiles; ++t) begin[t] = counts[t];
    begin[tiles] = view.intersections;
    parallel_for(parts, [&](int64_t p) {
        int32_t* place = counts + p * tiles;
        for_each_tile(view, order, part(view.visible, parts, p),
                      [&](int32_t splat, uint32_t tile, int32_t slot) {
                          entries[place[tile]++] = {splat, slot};
                      });
    });
}

}  // namespace
}  // namespace roigs

int64_t roigs_bin(roigs::View* view) {
    using namespace roigs;
    const int parts = part_count(view->visible);
    bool enough = view->histograms.reserve(parts * std::max<int64_t>(view->tiles, kDigits)) &&
                  view->tile_begin.reserve(view->tiles + 1) &&
                  view->entries.reserve(view->intersections);
    for (int i = 0; i < 2; ++i)
        enough = enough && view->depth_keys[i].reserve(view->visible) &&
                 view->depth_order[i].reserve(view->visible);
    if (!enough) return kOutOfMemory;
    collect_depths(*view);
    sort_pass(*view, 0, 0, parts);
    sort_pass(*view, 1, kDigitBits, parts);
    sort_pass(*view, 0, 2 * kDigitBits, parts);
    deal_to_tiles(*view, view->depth_order[1].data(), parts);
    return view->intersections;
}
