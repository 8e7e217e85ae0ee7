// Gradient of the projection: from the moments in a Gaussian's slots to its parameters
// (kernels/geometry_gradient.h has the formulas). A thread per Gaussian.

struct Gradient2d { place: vec2<f32>, xx: f32, xy: f32, yy: f32 }

struct ShapeGradient { mean: vec3<f32>, quat: vec4<f32>, scale: vec3<f32>, opacity: f32 }

// d to_linear / d(value) at the value whose light this is.
fn linear_slope(light: f32) -> f32 {
    let power = (2.4 / 1.055) * exp2((1.4 / 2.4) * log2(light));
    return select(1.0 / 12.92, power, light > 0.0031308);
}

fn unwhiten(g: ptr<function, Geometry>, m: ptr<function, array<f32, MOMENTS>>) -> Gradient2d {
    let w = whitening(g);
    let to_first = 1.0 / EXPONENT_SCALE;
    let to_second = 0.5 * to_first * to_first;
    let a = w.l11 * (*m)[3];
    let b = w.l21 * (*m)[3] + w.l22 * (*m)[4];
    let c = w.l21 * (*m)[4] + w.l22 * (*m)[5];
    var d = Gradient2d(
        to_first * vec2(w.l11 * (*m)[1], w.l21 * (*m)[1] + w.l22 * (*m)[2]),
        to_second * (w.l11 * a), to_second * (w.l11 * b), to_second * (w.l21 * b + w.l22 * c));
    if (frame.blur != frame.stored_blur) {  // through drawn_opacity
        let less = frame.blur - frame.stored_blur;
        let stored = 0.5 * (*m)[0] / (*g).stored_determinant;
        let drawn = 0.5 * (*m)[0] / (*g).determinant;
        d.xx += stored * ((*g).yy - less) - drawn * (*g).yy;
        d.xy += (drawn - stored) * (*g).xy;
        d.yy += stored * ((*g).xx - less) - drawn * (*g).xx;
    }
    return d;
}

// dL / d(rotation), column by column, to dL / d(stored quaternion).
fn quaternion_gradient(g: ptr<function, Geometry>, c0: vec3<f32>, c1: vec3<f32>,
                       c2: vec3<f32>) -> vec4<f32> {
    let q = (*g).quat;
    let apart = vec3(c1.z - c2.y, c2.x - c0.z, c0.y - c1.x);  // yz, zx, xy
    let both = vec3(c1.z + c2.y, c2.x + c0.z, c0.y + c1.x);
    let out = 2.0 * vec4(
        dot(q.yzw, apart),
        q.x * apart.x + q.z * both.z + q.w * both.y - 2.0 * q.y * (c1.y + c2.z),
        q.x * apart.y + q.y * both.z + q.w * both.x - 2.0 * q.z * (c0.x + c2.z),
        q.x * apart.z + q.y * both.y + q.z * both.x - 2.0 * q.w * (c0.x + c1.y));
    return (out - dot(out, q) * q) * (*g).inverse_norm;
}

// Through the pinhole projection of the centre and through T = J W; to the world frame.
fn centre_gradient(g: ptr<function, Geometry>, d: Gradient2d, dT0: vec3<f32>,
                   dT1: vec3<f32>) -> vec3<f32> {
    var dt = vec3(0.0);
    let depth_row = camera_row(2u);
    for (var a = 0u; a < 2u; a++) {
        let dT = select(dT1, dT0, a == 0u);
        let f = frame.focal[a] * (*g).inverse_z;
        let slope = (*g).slope[a];
        let df = dot(dT, camera_row(a) - slope * depth_row);
        let dslope = select(0.0, -f * dot(dT, depth_row), (*g).slope_is_free[a]);
        dt[a] = f * d.place[a] + dslope * (*g).inverse_z;
        dt.z -= (*g).inverse_z * (f * (df + d.place[a] * (*g).t[a]) + dslope * slope);
    }
    return camera_row(0u) * dt.x + camera_row(1u) * dt.y + depth_row * dt.z;
}

fn shape_gradient(g: ptr<function, Geometry>, d: Gradient2d) -> ShapeGradient {
    var out: ShapeGradient;
    var dT0 = vec3(0.0);
    var dT1 = vec3(0.0);
    var columns: array<vec3<f32>, 3>;
    for (var k = 0u; k < 3u; k++) {
        let axis = (*g).rotation[k];
        let dU0 = 2.0 * (d.xx * (*g).U0[k] + d.xy * (*g).U1[k]);
        let dU1 = 2.0 * (d.xy * (*g).U0[k] + d.yy * (*g).U1[k]);
        dT0 += dU0 * (*g).scale[k] * axis;
        dT1 += dU1 * (*g).scale[k] * axis;
        let dM = (*g).T0 * dU0 + (*g).T1 * dU1;
        out.scale[k] = dot(dM, axis);
        columns[k] = dM * (*g).scale[k];
    }
    out.quat = quaternion_gradient(g, columns[0], columns[1], columns[2]);
    out.mean = centre_gradient(g, d, dT0, dT1);
    return out;
}

// Writes the gradients of the SH. Returns the centre's gradient through the direction.
fn colour_gradient(n: u32, mean: vec3<f32>, m: ptr<function, array<f32, MOMENTS>>) -> vec3<f32> {
    var colour: vec3<f32>;
    let drawn = splats[4u * n + 2u].xyz;
    for (var c = 0u; c < 3u; c++) {  // colours clamped to 0 pass no gradient
        let slope = select(1.0, linear_slope(drawn[c]), frame.linear_light != 0u);
        colour[c] = select(0.0, (*m)[6u + c] * slope, drawn[c] > 0.0);
    }
    let direction = view_direction(mean);
    var basis = sh_basis(direction.xyz);
    var weight = array<f32, 16>();
    let used = used_coefficients();
    let first = 3u * frame.sh_coefficients * n;
    for (var k = 0u; k < frame.sh_coefficients; k++) {
        let at = first + 3u * k;
        var own = vec3(0.0);
        if (k < used) {
            own = basis[k] * colour;
            weight[k] = dot(colour, vec3(sh[at], sh[at + 1u], sh[at + 2u]));
        }
        for (var c = 0u; c < 3u; c++) { sh_gradients[at + c] = own[c]; }
    }
    if (used == 1u) { return vec3(0.0); }
    let d = sh_direction_gradient(direction.xyz, &weight);
    return (d - dot(d, direction.xyz) * direction.xyz) * direction.w;
}

fn write_shape(n: u32, row: ShapeGradient) {
    let count = frame.count;
    for (var k = 0u; k < 3u; k++) {
        shape_gradients[3u * n + k] = row.mean[k];
        shape_gradients[7u * count + 3u * n + k] = row.scale[k];
    }
    for (var k = 0u; k < 4u; k++) { shape_gradients[3u * count + 4u * n + k] = row.quat[k]; }
    shape_gradients[10u * count + n] = row.opacity;
}

@compute @workgroup_size(ROWS)
fn project_backward(@builtin(workgroup_id) group: vec3<u32>,
                    @builtin(local_invocation_index) lane: u32) {
    let n = group_index(group) * ROWS + lane;
    if (n >= frame.count) { return; }
    var m = array<f32, MOMENTS>();
    var has_gradient = false;
    for (var i = 0u; i < pair_counts[n]; i++) {
        let slot = (first_slot[n] + i) * MOMENTS;
        for (var k = 0u; k < MOMENTS; k++) { m[k] += moments[slot + k]; }
    }
    for (var k = 0u; k < MOMENTS; k++) {  // by its bits: NaN is not zero
        has_gradient = has_gradient || (bitcast<u32>(m[k]) & 0x7fffffffu) != 0u;
    }
    var row = ShapeGradient();
    if (!has_gradient) {
        row_results[n] = vec2(0u);
        write_shape(n, row);
        let width = 3u * frame.sh_coefficients;
        for (var k = 0u; k < width; k++) { sh_gradients[n * width + k] = 0.0; }
        return;
    }
    var g: Geometry;
    project_centre(n, &g);
    project_shape(n, &g);
    let d = unwhiten(&g, &m);
    row = shape_gradient(&g, d);
    row.mean += colour_gradient(n, g.mean, &m);
    if (frame.raw != 0u) {
        row.opacity = m[0] * (1.0 - g.opacity);
        row.scale *= g.scale;
    } else {
        row.opacity = m[0] / g.opacity;
    }
    write_shape(n, row);
    let width = 3u * frame.sh_coefficients;
    var is_finite_sh = true;
    for (var k = 0u; k < width; k++) {
        is_finite_sh = is_finite_sh && is_finite(sh_gradients[n * width + k]);
    }
    let flags = 1u | select(0u, 2u, are_finite(vec4(row.mean, 0.0)))
        | select(0u, 4u, are_finite(row.quat)) | select(0u, 8u, are_finite(vec4(row.scale, 0.0)))
        | select(0u, 16u, is_finite(row.opacity)) | select(0u, 32u, is_finite_sh);
    let norm = length(0.5 * vec2(f32(frame.width), f32(frame.height)) * d.place);
    row_results[n] = vec2(bitcast<u32>(norm), flags);
}
