// A pass over a tile's pixels with one Gaussian per lane.
//
// A warp takes a bucket of kBucket neighbours of a tile's list. Each lane keeps its Gaussian, while
// the pixels move from lane to lane: in step s, lane i is at pixel s - i. It gets the pixel's state
// in front of its Gaussian from lane i - 1. So sums over a Gaussian's pixels stay in registers. The
// first lane takes the states from the checkpoints of the blending.
#pragma once

#include "frame.h"

namespace roigs {

constexpr unsigned kAllLanes = 0xffffffffu;

// The part of the lists that a block of kGroup threads walks over.
struct Group {
    int tile;
    int entry;      // this thread's, in `entries`
    bool is_there;  // the list has it
    bool is_blended;  // this warp's bucket has a checkpoint

    // `group` is below f.group_begin[tile_count].
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

// Walks; all lanes of a warp together. `behind(pixel, checkpoint)` makes the state that is passed
// on with the transmittance. visit(sample, pixel, transmittance, state) is called if the Gaussian
// is drawn at the pixel, and changes the state. This function changes the transmittance.
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
