// The points where a Gaussian is densest along rays form a plane (RaDe-GS, Zhang et al. 2024, sec.
// 3.2). With rays parallel to the one through the centre, and w the camera's z axis in the
// Gaussian's own axes, the plane's depth changes by
//
//     k = C^-1 U w per pixel,   C = U U^T + kPlaneBlur (U: Geometry),
//
// because it is the mean of z at a given place in the image. Steps in the plane from pixel to pixel
// are orthogonal to its normal. So the normal n is m, normalised, with m = (f_x k_x / z, f_y k_y /
// z, ..) and m . r = -1 for the ray r = (x / z, y / z, 1) of the centre. Batches of Gaussians, one
// per lane.
#pragma once

#include "geometry_gradient.h"

namespace roigs {

struct Plane {
    Floats w[3];
    Floats xx, xy, yy;  // C^-1
    Floats slope[2];    // k
    Floats m[2];
    Floats inverse_length;  // 1 / |m|
    Floats normal[3];
};

ROIGS_INLINE Plane plane_of(const Geometry& g, const Camera& camera) {
    Plane p;
    depth_axis(g, camera, p.w);
    const Floats* const x = g.U[0];
    const Floats* const y = g.U[1];
    const Floats cross[3] = {x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2],
                             x[0] * y[1] - x[1] * y[0]};
    const Floats x2 = dot3(x, x), y2 = dot3(y, y);
    const Floats inverse =
        1.0f / (dot3(cross, cross) + kPlaneBlur * (x2 + y2) + kPlaneBlur * kPlaneBlur);
    p.xx = (y2 + kPlaneBlur) * inverse;
    p.xy = -dot3(x, y) * inverse;
    p.yy = (x2 + kPlaneBlur) * inverse;
    const Floats bx = dot3(x, p.w), by = dot3(y, p.w);
    p.slope[0] = p.xx * bx + p.xy * by;
    p.slope[1] = p.xy * bx + p.yy * by;
    p.m[0] = camera.fx * g.inverse_z * p.slope[0];
    p.m[1] = camera.fy * g.inverse_z * p.slope[1];
    const Floats m[3] = {p.m[0], p.m[1], -1.0f - p.m[0] * g.slope[0] - p.m[1] * g.slope[1]};
    p.inverse_length = 1.0f / sqrt(dot3(m, m));
    for (int k = 0; k < 3; ++k) p.normal[k] = m[k] * p.inverse_length;
    return p;
}

// From the moments of a surface to the values that the plane depends on. Adds to the gradient of
// the centre, and to that of Sigma', because C depends on U as Sigma' does.
inline PlaneGradient plane_gradient(const Camera& camera, const Geometry& g,
                                    const Floats (&moments)[16], Gradient2d& d) {
    const Plane p = plane_of(g, camera);
    PlaneGradient out;
    const Floats depth = moments[kPlaneDepth];
    d.x -= depth * p.slope[0];
    d.y -= depth * p.slope[1];
    // through the normalisation, where the part along the normal has no effect
    const Floats along = dot3(&moments[kNormal], p.normal);
    Floats dm[3];
    for (int k = 0; k < 3; ++k)
        dm[k] = (moments[kNormal + k] - along * p.normal[k]) * p.inverse_length;
    const float focal[2] = {camera.fx, camera.fy};
    Floats dk[2] = {moments[kPlaneX], moments[kPlaneY]};
    out.z = depth;
    for (int a = 0; a < 2; ++a) {
        out.slope[a] = -p.m[a] * dm[2];
        const Floats da = dm[a] - g.slope[a] * dm[2];
        dk[a] += focal[a] * g.inverse_z * da;
        out.z -= p.m[a] * da * g.inverse_z;
    }
    const Floats ex = p.xx * dk[0] + p.xy * dk[1], ey = p.xy * dk[0] + p.yy * dk[1];
    d.xx -= ex * p.slope[0];
    d.xy -= 0.5f * (ex * p.slope[1] + ey * p.slope[0]);
    d.yy -= ey * p.slope[1];
    for (int k = 0; k < 3; ++k) {
        out.U[0][k] = ex * p.w[k];
        out.U[1][k] = ey * p.w[k];
        out.w[k] = g.U[0][k] * ex + g.U[1][k] * ey;
    }
    return out;
}

}  // namespace roigs
