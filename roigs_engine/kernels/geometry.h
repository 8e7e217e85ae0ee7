// The projection of a batch of Gaussians, one per lane (EWA splatting, Zwicker et al. 2001; 3DGS,
// section 4). Forward and backward passes both start from it. Computing it again is cheaper than
// keeping it in memory.
#pragma once

#include "constants.h"
#include "simd_rows.h"
#include "types.h"

namespace roigs {

struct Geometry {
    Floats mean[3];          // centre in the world frame
    Floats t[3];             // .. and in the camera frame
    Floats inverse_z;        // 1 / t[2]
    Floats x, y;             // projected centre, px
    Floats slope[2];         // x / z and y / z where the projection is linearised
    Mask slope_is_free[2];   // true if that is the centre itself, not clamped to the view
    Floats quat[4];          // unit quaternion wxyz
    Floats inverse_norm;     // 1 / |stored quaternion|
    Floats R[3][3];          // rotation of the Gaussian's axes
    Floats scale[3];         // standard deviations along them
    Floats T[2][3];          // J W: Jacobian of the projection times world-to-camera rotation
    Floats U[2][3];          // J W R S; the 2D covariance is U U^T + blur (3DGS, eq. 5 and 6)
    Floats xx, xy, yy;       // that covariance, px^2
    Floats determinant;      // xx yy - xy^2
    Floats stored_determinant;  // .. with the blur at which the opacity is the stored one
    Floats opacity;
};

ROIGS_INLINE Floats dot3(const Floats* a, const Floats* b) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Clamped to the range of float. NaN stays NaN, so that the Gaussian is left out.
ROIGS_INLINE Floats exp(Floats x) {
    return exp2(clamp(1.44269504f * x, splat(-126.0f), splat(127.0f)));
}

// Quaternion to rotation matrix.
ROIGS_INLINE void rotate(const float* quats, const int32_t* ids, Geometry& g) {
    Floats stored[4];
    load_few_columns<4>(quats, 4, ids, stored);
    for (int k = 0; k < 4; ++k) g.quat[k] = stored[k];
    const Floats norm2 = dot3(g.quat, g.quat) + g.quat[3] * g.quat[3];
    g.inverse_norm = 1.0f / sqrt(norm2);
    for (int k = 0; k < 4; ++k) g.quat[k] *= g.inverse_norm;
    const Floats w = g.quat[0], x = g.quat[1], y = g.quat[2], z = g.quat[3];
    g.R[0][0] = 1.0f - 2.0f * (y * y + z * z);
    g.R[0][1] = 2.0f * (x * y - w * z);
    g.R[0][2] = 2.0f * (x * z + w * y);
    g.R[1][0] = 2.0f * (x * y + w * z);
    g.R[1][1] = 1.0f - 2.0f * (x * x + z * z);
    g.R[1][2] = 2.0f * (y * z - w * x);
    g.R[2][0] = 2.0f * (x * z - w * y);
    g.R[2][1] = 2.0f * (y * z + w * x);
    g.R[2][2] = 1.0f - 2.0f * (x * x + y * y);
}

// T = J W. Far outside the view, the linearisation diverges. As in 3DGS, it is taken at the nearest
// point of the view, widened by kFrustumMargin of its half angle. The view's two sides are not
// symmetric if the principal point is off the image's centre.
ROIGS_INLINE void linearise(const Camera& camera, Geometry& g) {
    const float size[2] = {float(camera.width), float(camera.height)};
    const float focal[2] = {camera.fx, camera.fy}, centre[2] = {camera.cx, camera.cy};
    for (int axis = 0; axis < 2; ++axis) {
        const float margin = kFrustumMargin * 0.5f * size[axis] / focal[axis];
        const Floats low = splat(-centre[axis] / focal[axis] - margin);
        const Floats high = splat((size[axis] - centre[axis]) / focal[axis] + margin);
        const Floats slope = g.t[axis] * g.inverse_z;
        g.slope[axis] = clamp(slope, low, high);
        g.slope_is_free[axis] = both(greater(slope, low), less(slope, high));
        // J's row: focal / z on its axis, -focal slope / z on z
        const Floats f = focal[axis] * g.inverse_z;
        for (int k = 0; k < 3; ++k)
            g.T[axis][k] = f * (camera.world_to_camera[axis][k] -
                                g.slope[axis] * camera.world_to_camera[2][k]);
    }
}

// Projects the centres of the Gaussians in rows `ids`. Returns the lanes that are beyond the near
// plane and not far beside the image. The other lanes hold meaningless values, finite or not.
ROIGS_INLINE Mask project_centres(const Gaussians& gaussians, const Camera& camera,
                                  const int32_t* ids, Geometry& g) {
    Floats mean[4];
    load_few_columns<3>(gaussians.means, 3, ids, mean);
    for (int k = 0; k < 3; ++k) g.mean[k] = mean[k];
    for (int r = 0; r < 3; ++r) {
        const float* row = camera.world_to_camera[r];
        g.t[r] = row[0] * mean[0] + row[1] * mean[1] + row[2] * mean[2] + row[3];
    }
    g.inverse_z = 1.0f / g.t[2];
    g.x = camera.fx * g.t[0] * g.inverse_z + camera.cx;
    g.y = camera.fy * g.t[1] * g.inverse_z + camera.cy;
    const float far_x = camera.max_slope * camera.fx, far_y = camera.max_slope * camera.fy;
    const Mask columns = both(greater(g.x, min(Floats{}, splat(camera.cx - far_x))),
                              less(g.x, max(splat(float(camera.width)), splat(camera.cx + far_x))));
    const Mask rows = both(greater(g.y, min(Floats{}, splat(camera.cy - far_y))),
                           less(g.y, max(splat(float(camera.height)), splat(camera.cy + far_y))));
    return both(greater(g.t[2], splat(kNear)), both(columns, rows));
}

// Projects their shapes, after their centres.
ROIGS_INLINE void project_shapes(const Gaussians& gaussians, const Camera& camera,
                                 const int32_t* ids, Geometry& g) {
    Floats scale[4];
    rotate(gaussians.quats, ids, g);
    load_few_columns<3>(gaussians.scales, 3, ids, scale);
    for (int k = 0; k < 3; ++k) g.scale[k] = gaussians.raw ? exp(scale[k]) : scale[k];
    g.opacity = gather(gaussians.opacities, ids);
    if (gaussians.raw) g.opacity = 1.0f / (1.0f + exp(-g.opacity));

    linearise(camera, g);
    for (int axis = 0; axis < 2; ++axis)
        for (int k = 0; k < 3; ++k) {
            const Floats column[3] = {g.R[0][k], g.R[1][k], g.R[2][k]};
            g.U[axis][k] = dot3(g.T[axis], column) * g.scale[k];
        }

    // det(U U^T + blur I) = |U0 x U1|^2 + blur (|U0|^2 + |U1|^2) + blur^2 (Cauchy-Binet). For
    // needles, xx yy - xy^2 would cancel to zero or to a negative number.
    const Floats x2 = dot3(g.U[0], g.U[0]), y2 = dot3(g.U[1], g.U[1]);
    const Floats cross[3] = {g.U[0][1] * g.U[1][2] - g.U[0][2] * g.U[1][1],
                             g.U[0][2] * g.U[1][0] - g.U[0][0] * g.U[1][2],
                             g.U[0][0] * g.U[1][1] - g.U[0][1] * g.U[1][0]};
    const float blur = camera.blur, stored_blur = camera.stored_blur;
    const Floats sharp = dot3(cross, cross);
    g.determinant = sharp + blur * (x2 + y2) + blur * blur;
    g.stored_determinant = sharp + stored_blur * (x2 + y2) + stored_blur * stored_blur;
    g.xx = x2 + blur;
    g.xy = dot3(g.U[0], g.U[1]);
    g.yy = y2 + blur;
}

// The camera's z axis, in units of the Gaussian's own axes.
ROIGS_INLINE void depth_axis(const Geometry& g, const Camera& camera, Floats (&along)[3]) {
    for (int k = 0; k < 3; ++k) {
        const float* axis = camera.world_to_camera[2];
        along[k] = (axis[0] * g.R[0][k] + axis[1] * g.R[1][k] + axis[2] * g.R[2][k]) * g.scale[k];
    }
}

// The lanes whose Gaussians do not reach behind the camera.
ROIGS_INLINE Mask in_front(const Geometry& g, const Camera& camera) {
    Floats along[3];
    depth_axis(g, camera, along);
    return greater(g.t[2], camera.min_sigmas * sqrt(dot3(along, along)));
}

// A Gaussian that is drawn wider than it is stored is drawn fainter, so that its integral stays the
// same. This happens with anti-aliasing, and if pixels are averages of several pixels of the whole
// photo. Otherwise, this is the opacity itself.
ROIGS_INLINE Floats drawn_opacity(const Geometry& g) {
    return g.opacity * sqrt(g.stored_determinant / g.determinant);
}

// L of Splat: Sigma'^-1 = L L^T / kExponentScale.
struct Whitening {
    Floats l11, l21, l22;
};

ROIGS_INLINE Whitening whitening(const Geometry& g) {
    const Floats l11 = sqrt(kExponentScale * g.yy / g.determinant);
    return {l11, -l11 * g.xy / g.yy, sqrt(kExponentScale / g.yy)};
}

// Unit vectors from the camera to the Gaussians' centres; colours depend on them. Returns
// 1 / distance.
ROIGS_INLINE Floats view_direction(const Floats* mean, const Camera& camera,
                                   Floats (&direction)[3]) {
    for (int k = 0; k < 3; ++k) direction[k] = mean[k] - camera.position[k];
    const Floats inverse = 1.0f / sqrt(dot3(direction, direction));
    for (int k = 0; k < 3; ++k) direction[k] *= inverse;
    return inverse;
}

inline int used_coefficients(const Gaussians& gaussians) {
    return (gaussians.sh_degree + 1) * (gaussians.sh_degree + 1);
}

}  // namespace roigs
