// A pass over a tile's pixels with one Gaussian per lane.
//
// A warp takes a bucket of kBucket neighbours of a tile's list. Each lane keeps its Gaussian, and
// the pixels walk past: in step s, lane i is at pixel s - i, and gets from lane i - 1 what the
// pixel's state is in front of its Gaussian. So sums over a Gaussian's pixels stay in registers.
// The first lane takes the states from the checkpoints that blending has left.
#pragma once

#include "frame.h"

namespace roigs {

constexpr unsigned kAllLanes = 0xffffffffu;

// What a block of kGroup threads walks over.
struct Group {
    int tile;
    int entry;      // this thread's, in `entries`
    bool is_there;  // the list has it
    bool is_blended;  // this warp's bucket has a checkpoint

    // `group` is one of f.group_begin[tile_count] many.
    Group(const Frame& f, int group) {
        int low = 0, high = f.tile_count;  // the last tile that begins at `group` or before
        while (high - low > 1) {
            const int middle = (low + high) / 2;
            if (f.group_begin[middle] <= group)
                low = middle;
            else
                high = middle;
        }
        tile = low;
        const int in_tile = (group - f.group_begin[tile]) * kGroup + int(threadIdx.x);
        entry = f.tile_begin[tile] + in_tile;
        is_there = entry < f.tile_begin[tile + 1];
        is_blended = in_tile / kBucket * kBucket < f.reached[tile];
    }
};

// Walks; all lanes of a warp together. `behind(pixel, checkpoint)` makes the state that is passed on
// beside the transmittance. visit(sample, pixel, transmittance, state) is called where the Gaussian is
// drawn, and changes the state; the transmittance is changed here.
template <class Behind, class Visit>
__device__ void walk(const Frame& f, const Group& group, int bucket, const LocalSplat& s,
                     const Behind& behind, const Visit& visit) {
    const int lane = int(threadIdx.x) % kBucket;
    const float4* checkpoint = f.checkpoints + int64_t(bucket) * kPixels;
    const float least = f.shape.min_transmittance;
    float left = 0.0f, state = 0.0f, next_left = 0.0f, next_state = 0.0f;
    for (int step = 0; step < kPixels + kBucket - 1; ++step) {
        if (step % kBucket == 0) {  // the pixels that enter in the next steps
            const int pixel = step + lane;
            next_left = next_state = 0.0f;
            if (pixel < kPixels) {
                const float4 c = checkpoint[pixel];
                next_left = c.x;
                next_state = behind(pixel, c);
            }
        }
        const float first_left = __shfl_sync(kAllLanes, next_left, step % kBucket);
        const float first_state = __shfl_sync(kAllLanes, next_state, step % kBucket);
        left = __shfl_up_sync(kAllLanes, left, 1);
        state = __shfl_up_sync(kAllLanes, state, 1);
        if (lane == 0) {
            left = first_left;
            state = first_state;
        }
        const int pixel = step - lane;
        if (!group.is_there || pixel < 0 || pixel >= kPixels || !(left > least))
            continue;
        const Sample sample(s, pixel);
        if (sample.alpha == 0.0f) continue;
        visit(sample, pixel, left, state);
        left -= sample.alpha * left;
    }
}

}  // namespace roigs
