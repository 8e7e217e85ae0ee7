// Copies rows of a matrix in another order, for edits of the model. Writing fresh memory takes most
// of the time, so all threads share it.
#include <algorithm>
#include <cstring>

#include "roigs.h"

void roigs_copy_rows(const float* matrix, int64_t rows, int64_t width, const int64_t* chosen,
                     int64_t count, float* out) {
    using namespace roigs;
    constexpr int64_t kRowsPerTask = 1024;
    parallel_for(chunks(count, kRowsPerTask), [&](int64_t task) {
        const int64_t begin = task * kRowsPerTask, end = std::min(begin + kRowsPerTask, count);
        for (int64_t i = begin; i < end; ++i) {
            if (chosen[i] >= 0 && chosen[i] < rows)
                std::memcpy(out + i * width, matrix + chosen[i] * width, sizeof(float) * width);
            else
                std::fill_n(out + i * width, width, 0.0f);
        }
    });
}
