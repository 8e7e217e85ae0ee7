// The photometric loss of 3D Gaussian Splatting and its gradient, in one pass over the image:
//
//     L = (1 - lambda) L1 + lambda (1 - SSIM)                      (Kerbl et al. 2023, eq. 7)
//
// SSIM (Wang et al. 2004) with an 11x11 Gaussian window of sigma 1.5 and zeros around the image.
// With G* the filter, x the image, t the target, all per channel:
//
//     mu_x = G*x    mu_t = G*t    S = G*(x^2 + t^2)    P = G*(x t)
//     A = 2 mu_x mu_t + C1                B = 2 (P - mu_x mu_t) + C2
//     C = mu_x^2 + mu_t^2 + C1            D = S - mu_x^2 - mu_t^2 + C2       SSIM = A B / (C D)
//
// SSIM needs only the sum of the two variances, so four filtered maps are enough. G is symmetric,
// so it is its own adjoint:
//
//     dSSIM/dx = G*(dSSIM/dmu_x) + 2 x G*(dSSIM/dS) + t G*(dSSIM/dP)
//
// Each task takes one channel of a band of rows through three stages, a group of rows at a time,
// with a delay between the stages. So only a few rows per map are in use at a time, and they stay
// in the cache. Whole maps would go through main memory about twenty times.
//
//     moments     x, x^2 + t^2, x t, t  filtered along rows           group g
//     similarity  the same along columns, SSIM, and its derivatives
//                 filtered along rows                                 group g - 2
//     gradient    the derivatives along columns, L1, dL/dx            group g - 4
#include <algorithm>
#include <cstring>
#include <new>
#include <vector>

#include "parallel.h"
#include "simd.h"

namespace roigs {
namespace {

constexpr int kRadius = 5;
constexpr int kGroup = 4;       // rows filtered together along columns share most of their loads
constexpr int kDelay = 2;       // groups that the window reaches past a group: kRadius <= 2 kGroup
constexpr int kRingGroups = 5;  // a stage reads kDelay groups on either side of its own
constexpr int kPad = 16;        // zeros left and right of a row, a whole number of vectors
constexpr float kC1 = 0.01f * 0.01f, kC2 = 0.03f * 0.03f;

// exp(-k^2 / (2 * 1.5^2)) for k = 0..5, divided by the sum over the 11 taps
constexpr float kWindow[kRadius + 1] = {0.266011725f,  0.213005538f,   0.10936069f,
                                        0.0360007721f, 0.00759875814f, 0.00102838008f};

struct ByteToFloat {
    float value[256];
    ByteToFloat() {
        for (int i = 0; i < 256; ++i) value[i] = float(i) / 255.0f;
    }
};
const ByteToFloat kByteToFloat;

ROIGS_INLINE float sum(Floats x) {
    float total = 0.0f;
    for (int i = 0; i < kLanes; ++i) total += x[i];
    return total;
}

ROIGS_INLINE Floats absolute(Floats x) { return floats_of(bits_of(x) & 0x7fffffff); }

// The rows of a map that are in use: `kRingGroups` groups, each row with zeros on both sides.
class Ring {
public:
    Ring(float* memory, int64_t stride) : memory_(memory), stride_(stride) {}
    static int64_t size(int64_t stride) { return kRingGroups * kGroup * stride; }

    // First element of an image row. Rows above the image have a place, too, up to one window.
    float* row(int64_t y) const {
        const int64_t place = (y + kRingGroups * kGroup) % (kRingGroups * kGroup);
        return memory_ + place * stride_ + kPad;
    }
    void clear(int64_t y) const { std::memset(row(y) - kPad, 0, sizeof(float) * stride_); }

private:
    float* memory_;
    int64_t stride_;
};

// out = the filtered row. The row has zeros on both sides.
void filter_row(const float* row, float* out, int64_t width) {
    for (int64_t x = 0; x < width; x += kLanes) {
        Floats total = kWindow[0] * load(row + x);
        for (int k = 1; k <= kRadius; ++k)
            total += kWindow[k] * (load(row + x - k) + load(row + x + k));
        store(out + x, total);
    }
}

// Pointers to the rows that the window over a group touches.
struct Columns {
    const float* row[kGroup + 2 * kRadius];
    Columns(const Ring& ring, int64_t y0) {
        for (int k = 0; k < kGroup + 2 * kRadius; ++k) row[k] = ring.row(y0 + k - kRadius);
    }
    // The lanes at x of the group's rows, filtered along columns.
    ROIGS_INLINE void filter(int64_t x, Floats out[kGroup]) const {
        Floats v[kGroup + 2 * kRadius];
        for (int k = 0; k < kGroup + 2 * kRadius; ++k) v[k] = load(row[k] + x);
        for (int j = 0; j < kGroup; ++j) {
            const Floats* centre = v + j + kRadius;
            out[j] = kWindow[0] * centre[0];
            for (int k = 1; k <= kRadius; ++k) out[j] += kWindow[k] * (centre[-k] + centre[k]);
        }
    }
};

// The request, the same for all tasks.
struct Problem {
    int64_t width, height;
    const float* image;     // (3, height, width)
    const uint8_t* target;  // (height, width, 3)
    const float* weights;   // (height, width) or null
    float* gradient;        // (3, height, width) or null
    float ssim_scale;       // dL / d(weighted SSIM of a pixel)
    float l1_scale;         // dL / d(weighted |x - t| of a pixel)
    double* ssim_sums;      // (3, height), weighted
    double* l1_sums;        // (3, height), weighted

    int64_t padded_width() const { return chunks(width, kPad) * kPad; }
};

class Band {
public:
    Band(const Problem& problem, int channel, float* memory)
        : p_(problem),
          channel_(channel),
          padded_(problem.padded_width()),
          stride_(padded_ + 2 * kPad),
          image_(take_ring(memory)),
          target_(take_ring(memory)),
          mean_image_(take_ring(memory)),
          mean_target_(take_ring(memory)),
          squares_(take_ring(memory)),
          products_(take_ring(memory)),
          d_mean_(take_ring(memory)),
          d_squares_(take_ring(memory)),
          d_products_(take_ring(memory)) {
        for (float*& row : row_) row = take(memory, stride_) + kPad;
        for (auto& group : group_rows_)
            for (float*& row : group) row = take(memory, stride_) + kPad;
        weight_rows_ = take(memory, kGroup * stride_) + kPad;
    }

    static int64_t scratch_size(const Problem& p) {
        const int64_t stride = p.padded_width() + 2 * kPad;
        return 9 * Ring::size(stride) + (2 + 3 * kGroup + kGroup) * stride;
    }

    // Rows [begin, end); begin is a multiple of kGroup.
    void run(int64_t begin, int64_t end) {
        const int64_t first = begin / kGroup, last = chunks(end, kGroup);
        for (int64_t g = first - 2 * kDelay; g < last + 2 * kDelay; ++g) {
            for (int j = 0; j < kGroup; ++j) moments(g * kGroup + j);
            if (g >= first) similarity((g - kDelay) * kGroup, begin, end);
            if (g - 2 * kDelay >= first) gradient((g - 2 * kDelay) * kGroup, end);
        }
    }

private:
    static float* take(float*& memory, int64_t size) {
        float* taken = memory;
        memory += size;
        return taken;
    }
    Ring take_ring(float*& memory) { return Ring(take(memory, Ring::size(stride_)), stride_); }

    bool inside(int64_t y) const { return y >= 0 && y < p_.height; }

    void moments(int64_t y) {
        if (!inside(y)) {
            for (const Ring* ring : {&mean_image_, &mean_target_, &squares_, &products_})
                ring->clear(y);
            return;
        }
        float *image = image_.row(y), *target = target_.row(y);
        const float* source = p_.image + (channel_ * p_.height + y) * p_.width;
        std::memcpy(image, source, sizeof(float) * p_.width);
        const uint8_t* photo = p_.target + 3 * y * p_.width + channel_;
        for (int64_t x = 0; x < p_.width; ++x) target[x] = kByteToFloat.value[photo[3 * x]];

        float *square = row_[0], *product = row_[1];
        for (int64_t x = 0; x < padded_; x += kLanes) {
            const Floats a = load(image + x), b = load(target + x);
            store(square + x, a * a + b * b);
            store(product + x, a * b);
        }
        filter_row(image, mean_image_.row(y), padded_);
        filter_row(target, mean_target_.row(y), padded_);
        filter_row(square, squares_.row(y), padded_);
        filter_row(product, products_.row(y), padded_);
    }

    // Rows outside [begin, end) are needed only for their derivatives. Another band counts them.
    void similarity(int64_t y0, int64_t begin, int64_t end) {
        fill_weights(y0);
        const Columns means_x(mean_image_, y0), means_t(mean_target_, y0), squares(squares_, y0),
            products(products_, y0);
        Floats total[kGroup] = {};
        for (int64_t x = 0; x < padded_; x += kLanes) {
            Floats mu_x[kGroup], mu_t[kGroup], s[kGroup], p[kGroup];
            means_x.filter(x, mu_x);
            means_t.filter(x, mu_t);
            squares.filter(x, s);
            products.filter(x, p);
            for (int j = 0; j < kGroup; ++j) {
                const Floats mu_xt = mu_x[j] * mu_t[j];
                const Floats mu_xx_tt = mu_x[j] * mu_x[j] + mu_t[j] * mu_t[j];
                const Floats a = 2.0f * mu_xt + kC1, b = 2.0f * (p[j] - mu_xt) + kC2;
                const Floats c = mu_xx_tt + kC1, d = s[j] - mu_xx_tt + kC2;
                const Floats over_cd = 1.0f / (c * d);
                const Floats weight = load(weight_rows_ + j * stride_ + x);
                const Floats ssim = a * b * over_cd;
                total[j] += weight * ssim;

                const Floats d_a = b * over_cd, d_b = a * over_cd;
                const Floats d_c = -ssim * over_cd * d, d_d = -ssim * over_cd * c;
                store(group_rows_[0][j] + x,
                      2.0f * weight * (mu_t[j] * (d_a - d_b) + mu_x[j] * (d_c - d_d)));
                store(group_rows_[1][j] + x, weight * d_d);
                store(group_rows_[2][j] + x, 2.0f * weight * d_b);
            }
        }
        for (int j = 0; j < kGroup; ++j) {
            const int64_t y = y0 + j;
            if (y >= begin && y < end) p_.ssim_sums[channel_ * p_.height + y] = sum(total[j]);
            if (!p_.gradient) continue;
            // Weights are zero outside the image, and so are the derivatives.
            filter_row(group_rows_[0][j], d_mean_.row(y), padded_);
            filter_row(group_rows_[1][j], d_squares_.row(y), padded_);
            filter_row(group_rows_[2][j], d_products_.row(y), padded_);
        }
    }

    void gradient(int64_t y0, int64_t end) {
        fill_weights(y0);
        const Columns means(d_mean_, y0), squares(d_squares_, y0), products(d_products_, y0);
        const float *images[kGroup], *targets[kGroup];
        for (int j = 0; j < kGroup; ++j) {
            images[j] = image_.row(y0 + j);
            targets[j] = target_.row(y0 + j);
        }
        Floats total[kGroup] = {};
        for (int64_t x = 0; x < padded_; x += kLanes) {
            Floats d_mean[kGroup] = {}, d_square[kGroup] = {}, d_product[kGroup] = {};
            if (p_.gradient) {
                means.filter(x, d_mean);
                squares.filter(x, d_square);
                products.filter(x, d_product);
            }
            for (int j = 0; j < kGroup; ++j) {
                const Floats image = load(images[j] + x), target = load(targets[j] + x);
                const Floats weight = load(weight_rows_ + j * stride_ + x);
                const Floats difference = image - target, zero = {};
                total[j] += weight * absolute(difference);
                const Floats sign = select(greater(difference, zero), weight,
                                           select(less(difference, zero), -weight, zero));
                const Floats d_ssim =
                    d_mean[j] + 2.0f * image * d_square[j] + target * d_product[j];
                store(group_rows_[0][j] + x, p_.ssim_scale * d_ssim + p_.l1_scale * sign);
            }
        }
        for (int j = 0; j < kGroup && y0 + j < end; ++j) {
            const int64_t row = channel_ * p_.height + y0 + j;
            p_.l1_sums[row] = sum(total[j]);
            if (p_.gradient)
                std::memcpy(p_.gradient + row * p_.width, group_rows_[0][j],
                            sizeof(float) * p_.width);
        }
    }

    // Weights of a group's rows: 1 if the caller gave none, 0 outside the image.
    void fill_weights(int64_t y0) {
        for (int j = 0; j < kGroup; ++j) {
            float* row = weight_rows_ + j * stride_;
            const int64_t inside_width = inside(y0 + j) ? p_.width : 0;
            if (p_.weights && inside_width)
                std::memcpy(row, p_.weights + (y0 + j) * p_.width, sizeof(float) * p_.width);
            else
                std::fill(row, row + inside_width, 1.0f);
            std::fill(row + inside_width, row + padded_, 0.0f);
        }
    }

    const Problem& p_;
    const int64_t channel_, padded_, stride_;
    Ring image_, target_;
    Ring mean_image_, mean_target_, squares_, products_;  // filtered along rows
    Ring d_mean_, d_squares_, d_products_;                // filtered along rows
    float* row_[2];
    float* group_rows_[3][kGroup];
    float* weight_rows_;
};

// Memory of the calling thread. It is kept from call to call and never freed, because fresh memory
// costs a page fault for every 4 KiB. It is zeroed if it is new or its layout changes, for the
// rows' padding.
float* zeroed_scratch(int64_t size, int64_t layout) {
    thread_local float* memory = nullptr;
    thread_local int64_t capacity = 0, last_layout = 0;
    if (capacity < size) {
        ::operator delete(memory, std::align_val_t(64));
        memory = static_cast<float*>(::operator new(sizeof(float) * size, std::align_val_t(64)));
        capacity = size;
        last_layout = 0;
    }
    if (last_layout != layout) {
        std::memset(memory, 0, sizeof(float) * size);
        last_layout = layout;
    }
    return memory;
}

double sum_of(const float* values, int64_t count) {
    double total = 0.0;
    constexpr int64_t kRun = 64 * kLanes;
    for (int64_t begin = 0; begin < count; begin += kRun) {
        const int64_t end = std::min(begin + kRun, count);
        Floats lanes = {};
        int64_t i = begin;
        for (; i + kLanes <= end; i += kLanes) lanes += load(values + i);
        total += sum(lanes);
        for (; i < end; ++i) total += values[i];
    }
    return total;
}

}  // namespace
}  // namespace roigs

// Loss of `image` (3, height, width) against the photo `target` (height, width, 3), and its
// gradient (3, height, width) unless that is null. `weights` (height, width) weigh the pixels in
// both terms; they are divided by their sum. Null means equal weights. Writes the loss, its L1 part
// and the mean SSIM to `result`. Each row's sum is computed in the same way for any bands, and rows
// are added in order. So the result does not depend on the number of threads.
ROIGS_API void roigs_photo_loss(int64_t width, int64_t height, const float* image,
                                const uint8_t* target, const float* weights, float ssim_weight,
                                float* gradient, double* result) {
    using namespace roigs;
    const double total_weight = 3.0 * (weights ? sum_of(weights, width * height)
                                               : double(width) * double(height));
    const double scale = total_weight > 0.0 ? 1.0 / total_weight : 0.0;
    std::vector<double> sums(6 * height);
    const Problem problem{width,
                          height,
                          image,
                          target,
                          weights,
                          gradient,
                          float(-ssim_weight * scale),
                          float((1.0 - ssim_weight) * scale),
                          sums.data(),
                          sums.data() + 3 * height};

    // Neighbouring bands both compute the rows around their border. So there are no more bands than
    // threads, and no band has just a few rows.
    constexpr int64_t kSmallestBand = 32;
    const int64_t bands = std::max<int64_t>(1, std::min<int64_t>(threads(), height / kSmallestBand));
    const int64_t rows = chunks(chunks(height, bands), kGroup) * kGroup;
    parallel_for(3 * bands, [&](int64_t task) {
        const int64_t begin = task / 3 * rows, end = std::min(begin + rows, height);
        if (begin >= end) return;
        float* memory = zeroed_scratch(Band::scratch_size(problem), width);
        Band(problem, int(task % 3), memory).run(begin, end);
    });

    double l1 = 0.0, ssim = 0.0;
    for (int64_t row = 0; row < 3 * height; ++row) {
        ssim += problem.ssim_sums[row];
        l1 += problem.l1_sums[row];
    }
    l1 *= scale;
    ssim = total_weight > 0.0 ? ssim * scale : 1.0;
    result[0] = (1.0 - ssim_weight) * l1 + ssim_weight * (1.0 - ssim);
    result[1] = l1;
    result[2] = ssim;
}
