// The gradient of the projection: from the raster pass's gradients of a splat to those of the
// Gaussian's parameters. Batches of Gaussians, one per lane.
#pragma once

#include "geometry.h"

namespace roigs {

struct Gradient2d {
    Floats x, y;        // dL / d(projected centre)
    Floats xx, xy, yy;  // dL / d(Sigma'), a symmetric matrix
};

// .. and of the other values that a plane depends on (plane.h).
struct PlaneGradient {
    Floats U[2][3], w[3];
    Floats z;         // depth of the centre
    Floats slope[2];  // Geometry::slope
};

// Through drawn_opacity. With `weight` = dL / d(log opacity) and P the covariance with the blur of
// the stored opacity, adds weight (P^-1 - Sigma'^-1) / 2 to dL / d(Sigma'). P may have no blur and
// be nearly singular. Such a Gaussian is too faint to be drawn, and has no weight.
inline void add_opacity_gradient(const Camera& camera, const Geometry& g, Floats weight,
                                 Gradient2d& d) {
    if (camera.blur == camera.stored_blur) return;
    const float less = camera.blur - camera.stored_blur;
    const Floats stored = 0.5f * weight / g.stored_determinant;
    const Floats drawn = 0.5f * weight / g.determinant;
    d.xx += stored * (g.yy - less) - drawn * g.yy;
    d.xy += (drawn - stored) * g.xy;
    d.yy += stored * (g.xx - less) - drawn * g.xx;
}

// With Sigma'^-1 = L L^T / h (h = kExponentScale) and (u, v) = L^T d,
//     dL / d(centre) = sum s Sigma'^-1 d = L (sum s (u, v)) / h
//     dL / d(Sigma') = 1/2 sum s (Sigma'^-1 d)(Sigma'^-1 d)^T
//                    = L M L^T / (2 h^2) with M = sum s (u, v)(u, v)^T.
inline Gradient2d unwhiten(const Camera& camera, const Geometry& g, const Floats (&m)[16]) {
    const Whitening w = whitening(g);
    constexpr float kFirst = 1 / kExponentScale, kSecond = 0.5f * kFirst * kFirst;
    Gradient2d out;
    out.x = kFirst * (w.l11 * m[kSU]);
    out.y = kFirst * (w.l21 * m[kSU] + w.l22 * m[kSV]);
    // M L^T = (a b; . c)
    const Floats a = w.l11 * m[kSUU];
    const Floats b = w.l21 * m[kSUU] + w.l22 * m[kSUV];
    const Floats c = w.l21 * m[kSUV] + w.l22 * m[kSVV];
    out.xx = kSecond * (w.l11 * a);
    out.xy = kSecond * (w.l11 * b);
    out.yy = kSecond * (w.l21 * b + w.l22 * c);
    add_opacity_gradient(camera, g, m[kS], out);
    return out;
}

// dL / dR to dL / d(stored quaternion).
inline void quaternion_gradient(const Geometry& g, const Floats (&dR)[3][3], Floats (&out)[4]) {
    const Floats w = g.quat[0], x = g.quat[1], y = g.quat[2], z = g.quat[3];
    const Floats yz = dR[2][1] - dR[1][2], zx = dR[0][2] - dR[2][0], xy = dR[1][0] - dR[0][1];
    const Floats sum_yz = dR[2][1] + dR[1][2], sum_zx = dR[0][2] + dR[2][0],
                 sum_xy = dR[1][0] + dR[0][1];
    out[0] = 2.0f * (x * yz + y * zx + z * xy);
    out[1] = 2.0f * (w * yz + y * sum_xy + z * sum_zx - 2.0f * x * (dR[1][1] + dR[2][2]));
    out[2] = 2.0f * (w * zx + x * sum_xy + z * sum_yz - 2.0f * y * (dR[0][0] + dR[2][2]));
    out[3] = 2.0f * (w * xy + x * sum_zx + y * sum_yz - 2.0f * z * (dR[0][0] + dR[1][1]));
    // through the normalisation, where the part along the quaternion has no effect
    const Floats along = dot3(out, g.quat) + out[3] * g.quat[3];
    for (int k = 0; k < 4; ++k) out[k] = (out[k] - along * g.quat[k]) * g.inverse_norm;
}

// Through Sigma' = U U^T + blur and U = T R S: gradients of scale and rotation, and dL / dT. If
// `plane` is not null, through it, too.
inline void covariance_gradient(const Camera& camera, const Geometry& g, const Gradient2d& d,
                                const PlaneGradient* plane, Floats (&scale)[3], Floats (&quat)[4],
                                Floats (&dT)[2][3]) {
    Floats dR[3][3];
    for (int r = 0; r < 3; ++r) dT[0][r] = dT[1][r] = Floats{};
    for (int k = 0; k < 3; ++k) {
        Floats dU0 = 2.0f * (d.xx * g.U[0][k] + d.xy * g.U[1][k]);
        Floats dU1 = 2.0f * (d.xy * g.U[0][k] + d.yy * g.U[1][k]);
        if (plane) {
            dU0 += plane->U[0][k];
            dU1 += plane->U[1][k];
        }
        scale[k] = Floats{};
        for (int r = 0; r < 3; ++r) {
            const Floats M = g.R[r][k] * g.scale[k];
            dT[0][r] += dU0 * M;
            dT[1][r] += dU1 * M;
            Floats dM = g.T[0][r] * dU0 + g.T[1][r] * dU1;
            if (plane) dM += camera.world_to_camera[2][r] * plane->w[k];
            scale[k] += dM * g.R[r][k];
            dR[r][k] = dM * g.scale[k];
        }
    }
    quaternion_gradient(g, dR, quat);
}

// Through the pinhole projection of the centre and through T = J W (see linearise); both depend on
// the camera-frame centre t. Then to the world frame. If `plane` is not null, through it, too.
inline void centre_gradient(const Camera& camera, const Geometry& g, const Gradient2d& d,
                            const PlaneGradient* plane, const Floats (&dT)[2][3],
                            Floats (&mean)[3]) {
    const float focal[2] = {camera.fx, camera.fy};
    const Floats centre[2] = {d.x, d.y};
    const auto& W = camera.world_to_camera;
    Floats dt[3] = {};
    for (int a = 0; a < 2; ++a) {
        const Floats f = focal[a] * g.inverse_z;
        Floats df = {}, dslope = {};
        for (int k = 0; k < 3; ++k) {
            df += dT[a][k] * (W[a][k] - g.slope[a] * W[2][k]);
            dslope -= dT[a][k] * W[2][k];
        }
        dslope *= f;
        if (plane) dslope += plane->slope[a];
        dslope = keep(g.slope_is_free[a], dslope);
        dt[a] = f * centre[a] + dslope * g.inverse_z;
        dt[2] -= g.inverse_z * (f * (df + centre[a] * g.t[a]) + dslope * g.slope[a]);
    }
    if (plane) dt[2] += plane->z;
    for (int k = 0; k < 3; ++k) mean[k] = W[0][k] * dt[0] + W[1][k] * dt[1] + W[2][k] * dt[2];
}

}  // namespace roigs
