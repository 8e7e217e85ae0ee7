// The projection of a Gaussian (EWA splatting, Zwicker et al. 2001; 3DGS, section 4) and its
// gradient. kernels/geometry.h and geometry_gradient.h have the same functions, and explain them.

struct Geometry {
    mean: vec3<f32>,
    t: vec3<f32>,  // in the camera's frame
    inverse_z: f32,
    place: vec2<f32>,  // projected centre, px
    slope: vec2<f32>,  // where the projection is linearised
    slope_is_free: vec2<bool>,
    quat: vec4<f32>,  // unit, wxyz
    inverse_norm: f32,
    rotation: mat3x3<f32>,  // its columns are the Gaussian's axes
    scale: vec3<f32>,
    T0: vec3<f32>,
    T1: vec3<f32>,  // J W
    U0: vec3<f32>,
    U1: vec3<f32>,  // J W R S
    xx: f32, xy: f32, yy: f32,
    determinant: f32,
    stored_determinant: f32,
    opacity: f32,
}

struct Whitening { l11: f32, l21: f32, l22: f32 }

fn natural_exp(x: f32) -> f32 { return exp2(clamp(1.44269504 * x, -126.0, 127.0)); }

fn shape_values(first: u32) -> vec3<f32> {
    return vec3(shapes[first], shapes[first + 1u], shapes[first + 2u]);
}

// False: not drawn, whatever its shape; or a parameter is not finite.
fn project_centre(n: u32, g: ptr<function, Geometry>) -> bool {
    let mean = shape_values(3u * n);
    (*g).mean = mean;
    for (var r = 0u; r < 3u; r++) {
        (*g).t[r] = dot(camera_row(r), mean) + frame.world_to_camera[4u * r + 3u];
    }
    let t = (*g).t;
    let inverse_z = 1.0 / t.z;
    let x = frame.focal[0] * t.x * inverse_z + frame.centre[0];
    let y = frame.focal[1] * t.y * inverse_z + frame.centre[1];
    (*g).inverse_z = inverse_z;
    (*g).place = vec2(x, y);
    if (!are_finite(vec4(mean, inverse_z)) || !are_finite(vec4(x, y, t.z, 0.0))) { return false; }
    let far_x = frame.max_slope * frame.focal[0];
    let far_y = frame.max_slope * frame.focal[1];
    return t.z > NEAR
        && x > min(0.0, frame.centre[0] - far_x) && x < max(f32(frame.width), frame.centre[0] + far_x)
        && y > min(0.0, frame.centre[1] - far_y) && y < max(f32(frame.height), frame.centre[1] + far_y);
}

fn rotate(stored: vec4<f32>, g: ptr<function, Geometry>) {
    let inverse_norm = 1.0 / sqrt(dot(stored, stored));
    let q = stored * inverse_norm;
    (*g).inverse_norm = inverse_norm;
    (*g).quat = q;
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    (*g).rotation = mat3x3<f32>(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
        2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
        2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// One row of T = J W, at the nearest point of the widened view.
fn linearise(axis: u32, g: ptr<function, Geometry>) -> vec3<f32> {
    let focal = frame.focal[axis];
    let size = f32(select(frame.height, frame.width, axis == 0u));
    let margin = FRUSTUM_MARGIN * 0.5 * size / focal;
    let low = -frame.centre[axis] / focal - margin;
    let high = (size - frame.centre[axis]) / focal + margin;
    let slope = (*g).t[axis] * (*g).inverse_z;
    let clamped = clamp(slope, low, high);
    (*g).slope[axis] = clamped;
    (*g).slope_is_free[axis] = slope > low && slope < high;
    return focal * (*g).inverse_z * (camera_row(axis) - clamped * camera_row(2u));
}

// The shape, after the centre. False: a parameter is not finite.
fn project_shape(n: u32, g: ptr<function, Geometry>) -> bool {
    let count = frame.count;
    let first = 3u * count + 4u * n;
    let quat = vec4(shapes[first], shape_values(first + 1u));
    let scale = shape_values(7u * count + 3u * n);
    let opacity = shapes[10u * count + n];
    if (!are_finite(quat) || !are_finite(vec4(scale, opacity))) { return false; }
    rotate(quat, g);
    (*g).scale = scale;
    (*g).opacity = opacity;
    if (frame.raw != 0u) {
        (*g).scale = vec3(natural_exp(scale.x), natural_exp(scale.y), natural_exp(scale.z));
        (*g).opacity = 1.0 / (1.0 + natural_exp(-opacity));
    }
    (*g).T0 = linearise(0u, g);
    (*g).T1 = linearise(1u, g);
    let U0 = ((*g).T0 * (*g).rotation) * (*g).scale;  // row times columns
    let U1 = ((*g).T1 * (*g).rotation) * (*g).scale;
    (*g).U0 = U0;
    (*g).U1 = U1;
    // Cauchy-Binet: xx yy - xy^2 would cancel for needles
    let x2 = dot(U0, U0);
    let y2 = dot(U1, U1);
    let area = cross(U0, U1);
    let sharp = dot(area, area);
    let blur = frame.blur;
    let stored = frame.stored_blur;
    (*g).determinant = sharp + blur * (x2 + y2) + blur * blur;
    (*g).stored_determinant = sharp + stored * (x2 + y2) + stored * stored;
    (*g).xx = x2 + blur;
    (*g).xy = dot(U0, U1);
    (*g).yy = y2 + blur;
    return true;
}

// True if it does not reach behind the camera.
fn in_front(g: ptr<function, Geometry>) -> bool {
    let along = (camera_row(2u) * (*g).rotation) * (*g).scale;
    return (*g).t.z > frame.min_sigmas * sqrt(dot(along, along));
}

fn drawn_opacity(g: ptr<function, Geometry>) -> f32 {
    return (*g).opacity * sqrt((*g).stored_determinant / (*g).determinant);
}

fn whitening(g: ptr<function, Geometry>) -> Whitening {
    let l11 = sqrt(EXPONENT_SCALE * (*g).yy / (*g).determinant);
    return Whitening(l11, -l11 * (*g).xy / (*g).yy, sqrt(EXPONENT_SCALE / (*g).yy));
}

// The unit vector from the camera to a centre, and 1 / distance.
fn view_direction(mean: vec3<f32>) -> vec4<f32> {
    let d = mean - vec3(frame.position[0], frame.position[1], frame.position[2]);
    let inverse = 1.0 / sqrt(dot(d, d));
    return vec4(d * inverse, inverse);
}

fn used_coefficients() -> u32 { return (frame.sh_degree + 1u) * (frame.sh_degree + 1u); }

const SH_0 = 0.28209479177387814;
const SH_1 = 0.4886025119029199;
const SH_2A = 1.0925484305920792;
const SH_2B = 0.31539156525252005;
const SH_2C = 0.5462742152960396;
const SH_3A = 0.5900435899266435;
const SH_3B = 2.890611442640554;
const SH_3C = 0.4570457994644658;
const SH_3D = 0.3731763325901154;
const SH_3E = 1.445305721320277;

fn sh_basis(d: vec3<f32>) -> array<f32, 16> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return array<f32, 16>(
        SH_0, -SH_1 * y, SH_1 * z, -SH_1 * x,
        SH_2A * x * y, -SH_2A * y * z, SH_2B * (2.0 * zz - xx - yy), -SH_2A * x * z,
        SH_2C * (xx - yy),
        -SH_3A * y * (3.0 * xx - yy), SH_3B * x * y * z, -SH_3C * y * (4.0 * zz - xx - yy),
        SH_3D * z * (2.0 * zz - 3.0 * (xx + yy)), -SH_3C * x * (4.0 * zz - xx - yy),
        SH_3E * z * (xx - yy), -SH_3A * x * (xx - 3.0 * yy));
}

// d / dd of sum_k w_k b_k(d), with d as three free variables.
fn sh_direction_gradient(d: vec3<f32>, w: ptr<function, array<f32, 16>>) -> vec3<f32> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    return vec3(
        -SH_1 * (*w)[3] + SH_2A * (y * (*w)[4] - z * (*w)[7])
            + 2.0 * x * (SH_2C * (*w)[8] - SH_2B * (*w)[6]) - 6.0 * SH_3A * x * y * (*w)[9]
            + SH_3B * y * z * (*w)[10] + 2.0 * SH_3C * x * y * (*w)[11]
            - 6.0 * SH_3D * x * z * (*w)[12] - SH_3C * (4.0 * zz - 3.0 * xx - yy) * (*w)[13]
            + 2.0 * SH_3E * x * z * (*w)[14] - 3.0 * SH_3A * (xx - yy) * (*w)[15],
        -SH_1 * (*w)[1] + SH_2A * (x * (*w)[4] - z * (*w)[5])
            - 2.0 * y * (SH_2C * (*w)[8] + SH_2B * (*w)[6]) - 3.0 * SH_3A * (xx - yy) * (*w)[9]
            + SH_3B * x * z * (*w)[10] - SH_3C * (4.0 * zz - xx - 3.0 * yy) * (*w)[11]
            - 6.0 * SH_3D * y * z * (*w)[12] + 2.0 * SH_3C * x * y * (*w)[13]
            - 2.0 * SH_3E * y * z * (*w)[14] + 6.0 * SH_3A * x * y * (*w)[15],
        SH_1 * (*w)[2] - SH_2A * (y * (*w)[5] + x * (*w)[7]) + 4.0 * SH_2B * z * (*w)[6]
            + SH_3B * x * y * (*w)[10] - 8.0 * SH_3C * z * (y * (*w)[11] + x * (*w)[13])
            + SH_3D * (6.0 * zz - 3.0 * (xx + yy)) * (*w)[12] + SH_3E * (xx - yy) * (*w)[14]);
}
