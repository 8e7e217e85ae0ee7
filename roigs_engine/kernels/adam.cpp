// Adam (Kingma and Ba 2015) on the rows of a parameter that the last image has seen.
//
// A photo sees a part of the Gaussians only; the gradient of all others is zero. Leaving them as
// they are (no decay of their moments) is what makes a step's cost follow the view and not the
// scene. The gradient buffer lives as long as the parameter: what is consumed here is set to zero
// in the same pass, while it is in the cache, so that nobody has to clear it.
#include <algorithm>
#include <cmath>
#include <vector>

#include "parallel.h"
#include "simd.h"

namespace roigs {
namespace {

constexpr int64_t kTile = 16;          // rows updated together
constexpr int64_t kTilesPerTask = 32;  // enough work to be worth a task, little enough to balance
constexpr int64_t kWide = 16;          // columns from which on visible rows are updated in runs

// First moments below this are zero: decaying on, they would become subnormal numbers, whose
// arithmetic is a hundred times slower on some processors.
constexpr float kTinyMoment = 1e-30f;

struct Buffers {
    float *parameter, *exp_avg, *exp_avg_sq, *gradient;

    Buffers at(int64_t element) const {
        return {parameter + element, exp_avg + element, exp_avg_sq + element, gradient + element};
    }
};

struct Constants {
    float keep1, add1;  // beta1, 1 - beta1
    float keep2, add2;  // beta2, 1 - beta2
    float epsilon;
    float inverse_sqrt_correction2;  // 1 / sqrt(1 - beta2^t)
};

// The rule for one element (kMasked: only where `mask` is set). `rate` is lr / (1 - beta1^t).
// Both corrections of the moments' bias are outside: t counts the steps of the training, as in
// the dense Adam, and not those of a row.
template <bool kMasked>
void update(const Buffers& b, int64_t count, const float* __restrict rate,
            const int32_t* __restrict mask, const Constants& constants) {
    float *__restrict p = b.parameter, *__restrict m = b.exp_avg, *__restrict v = b.exp_avg_sq,
          *__restrict g = b.gradient;
    const Constants c = constants;
    for (int64_t i = 0; i < count; ++i) {
        const float gradient = g[i];
        float mean = c.keep1 * m[i] + c.add1 * gradient;
        mean = std::fabs(mean) < kTinyMoment ? 0.0f : mean;
        const float square = c.keep2 * v[i] + c.add2 * gradient * gradient;
        const float denominator = std::sqrt(square) * c.inverse_sqrt_correction2 + c.epsilon;
        const float value = p[i] - rate[i] * mean / denominator;
        const bool on = !kMasked || mask[i];
        p[i] = on ? value : p[i];
        m[i] = on ? mean : m[i];
        v[i] = on ? square : v[i];
        g[i] = on ? 0.0f : gradient;
    }
}

// Whether a row has an infinity or a NaN. Looks at the bits: a loop on integers is vectorised.
bool has_non_finite(const float* row, int64_t width) {
    const auto* bits = reinterpret_cast<const uint32_t*>(row);
    uint32_t found = 0;
    for (int64_t i = 0; i < width; ++i) found |= (bits[i] & 0x7f800000u) == 0x7f800000u;
    return found != 0;
}

class MaskedStep {
public:
    MaskedStep(const Buffers& buffers, int64_t rows, int64_t width, const uint8_t* visible,
               const float* rates, float rate_scale, const Constants& constants)
        : buffers_(buffers),
          rows_(rows),
          width_(width),
          visible_(visible),
          constants_(constants),
          tile_rates_(kTile * width) {
        for (int64_t i = 0; i < kTile * width; ++i) tile_rates_[i] = rate_scale * rates[i % width];
    }

    // Rows [first, first + kTile) or to the end; returns how many had a non-finite gradient.
    int64_t tile(int64_t first) const {
        const int64_t count = std::min(kTile, rows_ - first);
        bool on[kTile];
        int64_t total = 0;
        for (int64_t i = 0; i < count; ++i) {
            on[i] = visible_[first + i] != 0;
            total += on[i];
        }
        if (total == 0) return 0;
        const int64_t broken = drop_broken_rows(first, on, count);
        if (total - broken == count)
            update<false>(buffers_.at(first * width_), count * width_, tile_rates_.data(), nullptr,
                          constants_);
        else if (width_ >= kWide)
            runs(first, on, count);
        else
            masked(first, on, count);
        return broken;
    }

private:
    // Takes visible rows with a non-finite gradient out of `on`, clears them, returns how many.
    int64_t drop_broken_rows(int64_t first, bool* on, int64_t count) const {
        float* gradients = buffers_.gradient + first * width_;
        // Nearly always nothing is broken; for narrow rows one look at the tile says so. Of wide
        // rows only the visible ones are worth reading.
        if (width_ < kWide && !has_non_finite(gradients, count * width_)) return 0;
        int64_t broken = 0;
        for (int64_t i = 0; i < count; ++i) {
            float* row = gradients + i * width_;
            if (!on[i] || !has_non_finite(row, width_)) continue;
            std::fill(row, row + width_, 0.0f);
            on[i] = false;
            ++broken;
        }
        return broken;
    }

    // Row by row would leave vectors half empty at the end of each row, hence runs of rows.
    void runs(int64_t first, const bool* on, int64_t count) const {
        for (int64_t begin = 0; begin < count; ++begin) {
            if (!on[begin]) continue;
            int64_t end = begin;
            while (end < count && on[end]) ++end;
            update<false>(buffers_.at((first + begin) * width_), (end - begin) * width_,
                          tile_rates_.data(), nullptr, constants_);
            begin = end;
        }
    }

    // Narrow rows are shorter than a vector: all rows of the tile with a mask per element.
    void masked(int64_t first, const bool* on, int64_t count) const {
        int32_t mask[kTile * kWide];
        for (int64_t i = 0; i < count; ++i)
            for (int64_t k = 0; k < width_; ++k) mask[i * width_ + k] = on[i];
        update<true>(buffers_.at(first * width_), count * width_, tile_rates_.data(), mask,
                     constants_);
    }

    const Buffers buffers_;
    const int64_t rows_, width_;
    const uint8_t* visible_;
    const Constants constants_;
    std::vector<float> tile_rates_;
};

}  // namespace
}  // namespace roigs

// One step on a parameter (rows, width) and its moments, all of that shape, for the rows with
// visible[row] != 0; their gradient is zero afterwards, all other rows stay untouched. `rates`
// (width,) are the columns' learning rates, `step` counts from 1. A row whose gradient has a NaN
// or an infinity is not updated; returns the number of such rows.
ROIGS_API int64_t roigs_adam(int64_t rows, int64_t width, float* parameter, float* exp_avg,
                             float* exp_avg_sq, float* gradient, const uint8_t* visible,
                             const float* rates, double beta1, double beta2, double epsilon,
                             int64_t step) {
    using namespace roigs;
    const double correction1 = 1.0 - std::pow(beta1, double(step));
    const double correction2 = 1.0 - std::pow(beta2, double(step));
    const Constants constants{float(beta1),   float(1.0 - beta1), float(beta2), float(1.0 - beta2),
                              float(epsilon), float(1.0 / std::sqrt(correction2))};
    const MaskedStep update_of({parameter, exp_avg, exp_avg_sq, gradient}, rows, width, visible, rates,
                         float(1.0 / correction1), constants);
    const int64_t tasks = chunks(rows, kTile * kTilesPerTask);
    std::vector<int64_t> broken(tasks, 0);
    parallel_for(tasks, [&](int64_t task) {
        const int64_t begin = task * kTile * kTilesPerTask;
        const int64_t end = std::min(begin + kTile * kTilesPerTask, rows);
        for (int64_t first = begin; first < end; first += kTile) broken[task] += update_of.tile(first);
    });
    int64_t total = 0;
    for (int64_t count : broken) total += count;
    return total;
}
