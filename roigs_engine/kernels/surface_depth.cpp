// The depth of opaque triangles: a z-buffer, for objects that hide Gaussians behind them.
#include <algorithm>
#include <cmath>
#include <vector>

#include "roigs.h"

namespace roigs {
namespace {

constexpr int64_t kRowsPerTask = 16;
constexpr double kOverlap = 1e-4;  // px, so that rounding leaves no gap between neighbours

struct Corner {
    double x, y, w;  // pixels; 1 / depth, which is linear in the image
};

struct Flat {  // a triangle in the image
    Corner corners[3];
    double top, bottom;
    double w_x, w_y, w_0;  // 1 / depth at (x, y) is w_x x + w_y y + w_0
    double farthest, nearest;
};

struct Point {
    double x, y, z;
};

Point between(const Point& a, const Point& b, double z) {
    const double t = (z - a.z) / (b.z - a.z);
    return {a.x + t * (b.x - a.x), a.y + t * (b.y - a.y), z};
}

// The part of a triangle beyond `near`: a polygon of up to four corners. Returns their number.
int clipped(const float* triangle, double near, Point* polygon) {
    int count = 0;
    for (int k = 0; k < 3; ++k) {
        const float *p = triangle + 3 * k, *q = triangle + 3 * ((k + 1) % 3);
        const Point a{p[0], p[1], p[2]}, b{q[0], q[1], q[2]};
        if (a.z >= near) polygon[count++] = a;
        if ((a.z >= near) != (b.z >= near)) polygon[count++] = between(a, b, near);
    }
    return count;
}

bool flattened(const Corner& a, const Corner& b, const Corner& c, Flat& flat) {
    const double area = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y);
    if (!(std::abs(area) > 0)) return false;  // also false for NaN
    flat.w_x = ((b.w - a.w) * (c.y - a.y) - (c.w - a.w) * (b.y - a.y)) / area;
    flat.w_y = ((b.x - a.x) * (c.w - a.w) - (c.x - a.x) * (b.w - a.w)) / area;
    flat.w_0 = a.w - flat.w_x * a.x - flat.w_y * a.y;
    flat.corners[0] = a, flat.corners[1] = b, flat.corners[2] = c;
    flat.top = std::min({a.y, b.y, c.y}), flat.bottom = std::max({a.y, b.y, c.y});
    flat.farthest = std::min({a.w, b.w, c.w}), flat.nearest = std::max({a.w, b.w, c.w});
    return true;
}

// The ends of the triangle in row centre `y`.
void span(const Flat& flat, double y, double& left, double& right) {
    left = INFINITY, right = -INFINITY;
    for (int k = 0; k < 3; ++k) {
        const Corner &a = flat.corners[k], &b = flat.corners[(k + 1) % 3];
        if ((y < a.y && y < b.y) || (y > a.y && y > b.y)) continue;
        const double t = a.y == b.y ? 0.0 : (y - a.y) / (b.y - a.y);
        const double x = a.x + t * (b.x - a.x), other = a.y == b.y ? b.x : x;
        left = std::min({left, x, other}), right = std::max({right, x, other});
    }
}

void fill(const Flat& flat, int64_t width, int64_t first, int64_t end, float* depth) {
    const int64_t begin = std::max(double(first), std::ceil(flat.top - 0.5));
    const int64_t last = std::min(double(end - 1), std::floor(flat.bottom - 0.5));
    for (int64_t row = begin; row <= last; ++row) {
        double left, right;
        span(flat, row + 0.5, left, right);
        const int64_t from = std::max(0.0, std::ceil(left - 0.5 - kOverlap));
        const int64_t to = std::min(double(width - 1), std::floor(right - 0.5 + kOverlap));
        for (int64_t column = from; column <= to; ++column) {
            const double w = flat.w_x * (column + 0.5) + flat.w_y * (row + 0.5) + flat.w_0;
            const double z = 1 / std::clamp(w, flat.farthest, flat.nearest);
            float& nearest = depth[row * width + column];
            nearest = std::min(nearest, float(z));
        }
    }
}

}  // namespace
}  // namespace roigs

void roigs_surface_depth(const float* triangles, int64_t count, const double* lens, double near,
                         int64_t width, int64_t height, float* depth) {
    using namespace roigs;
    std::vector<Flat> flats;
    flats.reserve(count);
    for (int64_t k = 0; k < count; ++k) {
        Point polygon[4];
        Corner corners[4];
        const int sides = clipped(triangles + 9 * k, near, polygon);
        for (int i = 0; i < sides; ++i) {
            const double w = 1 / polygon[i].z;
            const double x = lens[0] * polygon[i].x * w, y = lens[1] * polygon[i].y * w;
            corners[i] = {x + lens[2], y + lens[3], w};
        }
        for (int i = 2; i < sides; ++i) {
            Flat flat;
            if (flattened(corners[0], corners[i - 1], corners[i], flat) && flat.bottom > 0 &&
                flat.top < height)
                flats.push_back(flat);
        }
    }
    parallel_for(chunks(height, kRowsPerTask), [&](int64_t task) {
        const int64_t first = task * kRowsPerTask, end = std::min(first + kRowsPerTask, height);
        for (const Flat& flat : flats)
            if (flat.top < end && flat.bottom > first) fill(flat, width, first, end, depth);
    });
}
