// Adam (Kingma and Ba 2015) on the rows of a parameter that the last image gave a gradient.
//
// A photo sees a part of the Gaussians only; the gradient of all others is zero. Leaving them as
// they are (no decay of their moments) is what makes a step's cost follow the view and not the
// scene. What is consumed of a gradient is set to zero in the same pass, while it is in the cache,
// so that nobody has to clear it.
#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "roigs.h"

namespace roigs {

// The step on one parameter, for some rows at a time. Only the first `columns` of a row are updated;
// the others' gradients must be zero. While their moments are zero, too, that changes nothing.
class AdamRows {
public:
    static constexpr int64_t kTile = 16;  // rows updated together

    AdamRows(const Adam& adam, const AdamParameter& parameter, int64_t columns)
        : buffers_{parameter.values, parameter.exp_avg, parameter.exp_avg_sq},
          row_rates_(adam.row_rates),
          width_(parameter.width),
          columns_(columns),
          tile_rates_(kTile * parameter.width) {
        const double correction1 = 1.0 - std::pow(adam.beta1, double(adam.step));
        const double correction2 = 1.0 - std::pow(adam.beta2, double(adam.step));
        constants_ = {float(1.0 - adam.beta1), float(1.0 - adam.beta2), float(adam.epsilon),
                      float(1.0 / std::sqrt(correction2))};
        const float rate_scale = float(1.0 / correction1);
        for (int64_t i = 0; i < kTile * width_; ++i)
            tile_rates_[i] = rate_scale * parameter.rates[i % width_];
    }

    // Updates rows first + i for i in [0, count) with visible[i] != 0 by gradient[i], which is zero
    // afterwards. A row whose gradient has a NaN or an infinity is not updated; returns the number
    // of such rows.
    int64_t update(int64_t first, int64_t count, float* gradient, const uint8_t* visible) const {
        int64_t broken = 0;
        for (int64_t i = 0; i < count;) {
            const int64_t rows = alike(first + i, std::min(kTile, count - i));
            broken += tile(first + i, rows, gradient + i * width_, visible + i);
            i += rows;
        }
        return broken;
    }

private:
    // How many of `count` rows have the first one's factor. Neighbours in Z-order: nearly always all.
    int64_t alike(int64_t first, int64_t count) const {
        if (!row_rates_) return count;
        int64_t rows = 1;
        while (rows < count && row_rate(first) == row_rate(first + rows)) ++rows;
        return rows;
    }
    float row_rate(int64_t row) const { return row_rates_ ? row_rates_[row] : 1.0f; }

    static constexpr int64_t kWide = 16;  // columns from which on visible rows are updated in runs

    // First moments below this are zero: decaying on, they would become subnormal numbers, whose
    // arithmetic is a hundred times slower on some processors.
    static constexpr float kTinyMoment = 1e-30f;

    struct Buffers {
        float *parameter, *exp_avg, *exp_avg_sq;

        Buffers at(int64_t element) const {
            return {parameter + element, exp_avg + element, exp_avg_sq + element};
        }
    };

    struct Constants {
        float add1, add2;  // 1 - beta1, 1 - beta2
        float epsilon;
        float inverse_sqrt_correction2;  // 1 / sqrt(1 - beta2^t)
    };

    // The rule for the elements of rows from `row` on, which have one factor (kMasked: only where
    // `mask` is set). A rate is lr / (1 - beta1^t).
    // Both corrections of the moments' bias are outside: t counts the steps of the training, as in
    // the dense Adam, and not those of a row. Written so that there is one way only to make fused
    // multiply-adds of it: a row gets the same bits whatever rows are updated with it.
    template <bool kMasked>
    void elements(int64_t row, float* __restrict g, int64_t count,
                  const int32_t* __restrict mask) const {
        const Buffers b = buffers_.at(row * width_);
        const float factor = row_rate(row);
        float *__restrict p = b.parameter, *__restrict m = b.exp_avg, *__restrict v = b.exp_avg_sq;
        const float* __restrict rate = tile_rates_.data();
        const Constants c = constants_;
        for (int64_t i = 0; i < count; ++i) {
            const float gradient = g[i];
            float mean = m[i] + c.add1 * (gradient - m[i]);
            mean = std::fabs(mean) < kTinyMoment ? 0.0f : mean;
            const float square = v[i] + c.add2 * (gradient * gradient - v[i]);
            const float denominator = std::sqrt(square) * c.inverse_sqrt_correction2 + c.epsilon;
            const float value = p[i] - factor * rate[i] * mean / denominator;
            const bool on = !kMasked || mask[i];
            p[i] = on ? value : p[i];
            m[i] = on ? mean : m[i];
            v[i] = on ? square : v[i];
            g[i] = on ? 0.0f : gradient;
        }
    }

    int64_t tile(int64_t first, int64_t count, float* gradient, const uint8_t* visible) const {
        bool on[kTile];
        int64_t total = 0;
        for (int64_t i = 0; i < count; ++i) {
            on[i] = visible[i] != 0;
            total += on[i];
        }
        if (total == 0) return 0;
        const int64_t broken = drop_broken_rows(gradient, on, count);
        if (total - broken == count && columns_ == width_)
            elements<false>(first, gradient, count * width_, nullptr);
        else if (width_ >= kWide || columns_ < width_)
            runs(first, gradient, on, count);
        else
            masked(first, gradient, on, count);
        return broken;
    }

    // Takes visible rows with a non-finite gradient out of `on`, clears them, returns how many.
    int64_t drop_broken_rows(float* gradient, bool* on, int64_t count) const {
        // Nearly always nothing is broken; for narrow rows one look at the tile says so. Of wide
        // rows only the visible ones are worth reading.
        if (width_ < kWide && !has_non_finite(gradient, count * width_)) return 0;
        int64_t broken = 0;
        for (int64_t i = 0; i < count; ++i) {
            float* row = gradient + i * width_;
            if (!on[i] || !has_non_finite(row, columns_)) continue;
            std::fill(row, row + width_, 0.0f);
            on[i] = false;
            ++broken;
        }
        return broken;
    }

    // Whether a row has an infinity or a NaN. Looks at the bits: a loop on integers is vectorised.
    static bool has_non_finite(const float* row, int64_t width) {
        const auto* bits = reinterpret_cast<const uint32_t*>(row);
        uint32_t found = 0;
        for (int64_t i = 0; i < width; ++i) found |= (bits[i] & 0x7f800000u) == 0x7f800000u;
        return found != 0;
    }

    // Row by row would leave vectors half empty at the end of each row, hence runs of rows.
    void runs(int64_t first, float* gradient, const bool* on, int64_t count) const {
        for (int64_t begin = 0; begin < count; ++begin) {
            if (!on[begin]) continue;
            int64_t end = begin + 1;
            while (columns_ == width_ && end < count && on[end]) ++end;
            elements<false>(first + begin, gradient + begin * width_,
                            (end - begin - 1) * width_ + columns_, nullptr);
            begin = end - 1;
        }
    }

    // Narrow rows are shorter than a vector: all rows of the tile with a mask per element.
    void masked(int64_t first, float* gradient, const bool* on, int64_t count) const {
        int32_t mask[kTile * kWide];
        for (int64_t i = 0; i < count; ++i)
            for (int64_t k = 0; k < width_; ++k) mask[i * width_ + k] = on[i];
        elements<true>(first, gradient, count * width_, mask);
    }

    const Buffers buffers_;
    const float* const row_rates_;
    const int64_t width_, columns_;
    Constants constants_;
    std::vector<float> tile_rates_;
};

}  // namespace roigs
