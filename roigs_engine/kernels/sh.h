// Real spherical harmonics up to degree 3, with the signs and order of 3DGS (Kerbl et al. 2023).
#pragma once

#include "simd.h"

namespace roigs {

constexpr int kMaxCoefficients = 16;

// Normalisation constants, named by degree and |order|; 2C is degree 2, order 2, and so on.
constexpr float kSh0 = 0.28209479177387814f;
constexpr float kSh1 = 0.4886025119029199f;
constexpr float kSh2A = 1.0925484305920792f, kSh2B = 0.31539156525252005f,
                kSh2C = 0.5462742152960396f;
constexpr float kSh3A = 0.5900435899266435f, kSh3B = 2.890611442640554f,
                kSh3C = 0.4570457994644658f, kSh3D = 0.3731763325901154f,
                kSh3E = 1.445305721320277f;

// The basis functions at unit vectors `d`.
ROIGS_INLINE void sh_basis(const Floats (&d)[3], Floats (&b)[kMaxCoefficients]) {
    const Floats x = d[0], y = d[1], z = d[2], xx = x * x, yy = y * y, zz = z * z;
    b[0] = splat(kSh0);
    b[1] = -kSh1 * y;
    b[2] = kSh1 * z;
    b[3] = -kSh1 * x;
    b[4] = kSh2A * x * y;
    b[5] = -kSh2A * y * z;
    b[6] = kSh2B * (2.0f * zz - xx - yy);
    b[7] = -kSh2A * x * z;
    b[8] = kSh2C * (xx - yy);
    b[9] = -kSh3A * y * (3.0f * xx - yy);
    b[10] = kSh3B * x * y * z;
    b[11] = -kSh3C * y * (4.0f * zz - xx - yy);
    b[12] = kSh3D * z * (2.0f * zz - 3.0f * (xx + yy));
    b[13] = -kSh3C * x * (4.0f * zz - xx - yy);
    b[14] = kSh3E * z * (xx - yy);
    b[15] = -kSh3A * x * (xx - 3.0f * yy);
}

// gradient = d / dd of sum_k w_k b_k(d), with d as three free variables. `w` beyond the bands in
// use holds zeros.
ROIGS_INLINE void sh_direction_gradient(const Floats (&d)[3], const Floats (&w)[kMaxCoefficients],
                                        Floats (&gradient)[3]) {
    const Floats x = d[0], y = d[1], z = d[2], xx = x * x, yy = y * y, zz = z * z;
    gradient[0] = -kSh1 * w[3] + kSh2A * (y * w[4] - z * w[7]) +
                  2.0f * x * (kSh2C * w[8] - kSh2B * w[6]) - 6.0f * kSh3A * x * y * w[9] +
                  kSh3B * y * z * w[10] + 2.0f * kSh3C * x * y * w[11] -
                  6.0f * kSh3D * x * z * w[12] - kSh3C * (4.0f * zz - 3.0f * xx - yy) * w[13] +
                  2.0f * kSh3E * x * z * w[14] - 3.0f * kSh3A * (xx - yy) * w[15];
    gradient[1] = -kSh1 * w[1] + kSh2A * (x * w[4] - z * w[5]) -
                  2.0f * y * (kSh2C * w[8] + kSh2B * w[6]) - 3.0f * kSh3A * (xx - yy) * w[9] +
                  kSh3B * x * z * w[10] - kSh3C * (4.0f * zz - xx - 3.0f * yy) * w[11] -
                  6.0f * kSh3D * y * z * w[12] + 2.0f * kSh3C * x * y * w[13] -
                  2.0f * kSh3E * y * z * w[14] + 6.0f * kSh3A * x * y * w[15];
    gradient[2] = kSh1 * w[2] - kSh2A * (y * w[5] + x * w[7]) + 4.0f * kSh2B * z * w[6] +
                  kSh3B * x * y * w[10] - 8.0f * kSh3C * z * (y * w[11] + x * w[13]) +
                  kSh3D * (6.0f * zz - 3.0f * (xx + yy)) * w[12] + kSh3E * (xx - yy) * w[14];
}

}  // namespace roigs
