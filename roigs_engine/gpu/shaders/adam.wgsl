// A step of Adam (kernels/adam.h has the rule) on the rows that have a gradient. A thread for each
// number: once for the shapes, once for the SH.

struct Step {
    add1: f32,  // 1 - beta1
    add2: f32,
    epsilon: f32,
    inverse_sqrt_correction2: f32,  // 1 / sqrt(1 - beta2^t)
    rate_scale: f32,                // 1 / (1 - beta1^t)
    has_row_rates: u32,
}

const TINY_MOMENT = 1e-30;

@group(0) @binding(29) var<storage, read> step: Step;
@group(0) @binding(30) var<storage, read> rates: array<f32>;  // of the columns: shapes, then SH
@group(0) @binding(31) var<storage, read> row_rates: array<f32>;  // factors of each Gaussian
@group(0) @binding(32) var<storage, read> results: array<vec2<u32>>;  // row_results
@group(0) @binding(33) var<storage, read> gradients: array<f32>;
@group(0) @binding(34) var<storage, read_write> values: array<f32>;
@group(0) @binding(35) var<storage, read_write> exp_avg: array<f32>;
@group(0) @binding(36) var<storage, read_write> exp_avg_sq: array<f32>;

// `part`: 0 to 4, of means, quats, scales, opacities and SH.
fn update(at: u32, row: u32, part: u32, column: u32) {
    let wanted = 1u | (2u << part);
    if ((results[row].y & wanted) != wanted) { return; }
    let gradient = gradients[at];
    var mean = exp_avg[at] + step.add1 * (gradient - exp_avg[at]);
    mean = select(mean, 0.0, abs(mean) < TINY_MOMENT);
    let square = exp_avg_sq[at] + step.add2 * (gradient * gradient - exp_avg_sq[at]);
    var rate = step.rate_scale * rates[column];
    if (step.has_row_rates != 0u) { rate *= row_rates[row]; }
    values[at] -= rate * mean / (sqrt(square) * step.inverse_sqrt_correction2 + step.epsilon);
    exp_avg[at] = mean;
    exp_avg_sq[at] = square;
}

@compute @workgroup_size(ROWS)
fn adam_shapes(@builtin(workgroup_id) group: vec3<u32>,
               @builtin(local_invocation_index) lane: u32) {
    let at = group_index(group) * ROWS + lane;
    let count = frame.count;
    if (at < 3u * count) {
        update(at, at / 3u, 0u, at % 3u);
    } else if (at < 7u * count) {
        let own = at - 3u * count;
        update(at, own / 4u, 1u, 3u + own % 4u);
    } else if (at < 10u * count) {
        let own = at - 7u * count;
        update(at, own / 3u, 2u, 7u + own % 3u);
    } else if (at < 11u * count) {
        update(at, at - 10u * count, 3u, 10u);
    }
}

// Higher degrees than are drawn are left as they are.
@compute @workgroup_size(ROWS)
fn adam_sh(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let at = group_index(group) * ROWS + lane;
    let width = 3u * frame.sh_coefficients;
    let used = 3u * (frame.sh_degree + 1u) * (frame.sh_degree + 1u);
    if (at < width * frame.count && at % width < used) {
        update(at, at / width, 4u, 11u + at % width);
    }
}
