// From Gaussians in the world to splats on the picture, and the tiles they touch
// (kernels/ellipses.h has the rule). A thread per Gaussian.

fn to_linear(value: f32) -> f32 {
    let power = exp2(2.4 * log2((value + 0.055) / 1.055));
    return select(value / 12.92, power, value > 0.04045);
}

// The pixel centres of the rectangle of tiles: left, top, right, bottom.
fn pixel_bounds() -> vec4<f32> {
    return vec4(f32(frame.tile_x0 * TILE) + 0.5, f32(frame.tile_y0 * TILE) + 0.5,
                f32(min(frame.tile_x1 * TILE, frame.width)) - 0.5,
                f32(min(frame.tile_y1 * TILE, frame.height)) - 0.5);
}

// In one direction: the first and last tile whose pixel centres meet [low, high].
fn tile_range(low: f32, high: f32, begin: i32, end: i32) -> vec2<f32> {
    let side = f32(TILE);
    let a = (low - (side - 0.5)) / side;
    let b = (high - 0.5) / side;
    return vec2(ceil(clamp(a, f32(begin), f32(end))),
                floor(clamp(b, f32(begin - 1), f32(end - 1))));
}

// x of an ellipse's leftmost (sign -1) or rightmost (+1) point with dy in [low, high].
fn ellipse_side(s: Splat, sign: f32, low: f32, high: f32) -> f32 {
    let headroom = s.log2_opacity - (LOG2_ALPHA_MIN - CULL_SLACK);
    let dy = clamp(sign * s.slope_y * s.reach.x, low, high);
    let v = s.l22 * dy;
    return s.x + s.slope_x * dy + sign / s.l11 * sqrt(max(headroom - v * v, 0.0));
}

// The rows of tiles that a splat reaches: first and last.
fn tile_rows(s: Splat) -> vec2<f32> {
    return tile_range(s.y - s.reach.y, s.y + s.reach.y, frame.tile_y0, frame.tile_y1);
}

// The tiles of one such row: the number of the first, and their count.
fn tiles_in_row(s: Splat, row: f32, bounds: vec4<f32>) -> vec2<i32> {
    let side = f32(TILE);
    let top = row * side + 0.5;
    let low = top - s.y;
    let high = min(top + (side - 1.0), bounds.w) - s.y;
    let left = ellipse_side(s, -1.0, low, high);
    let columns = tile_range(left, ellipse_side(s, 1.0, low, high), frame.tile_x0, frame.tile_x1);
    let length = select(0.0, max(columns.y - columns.x + 1.0, 0.0), left < bounds.z);
    return vec2(i32(tile_number(i32(columns.x), i32(row))), i32(length));
}

// False: it cannot touch a pixel. Does not set the colour.
fn make_splat(g: ptr<function, Geometry>, bounds: vec4<f32>, s: ptr<function, Splat>) -> bool {
    let log2_opacity = log2(drawn_opacity(g));
    if (!(log2_opacity > LOG2_ALPHA_MIN)) { return false; }
    let reach2 = max(log2_opacity - (LOG2_ALPHA_MIN - CULL_SLACK), 0.0) / EXPONENT_SCALE;
    let w = whitening(g);
    let reach = vec2(sqrt(reach2 * (*g).xx), sqrt(reach2 * (*g).yy));
    *s = Splat((*g).place.x, (*g).place.y, w.l11, w.l21, w.l22, log2_opacity,
               (*g).xy / (*g).xx, (*g).xy / (*g).yy, vec3(0.0), (*g).t.z, reach);
    return are_finite(vec4(w.l11, w.l21, w.l22, log2_opacity))
        && are_finite(vec4((*s).slope_y, (*s).slope_x, reach))
        && are_finite(vec4((*g).determinant, (*g).opacity, (*g).place))
        && (*s).x + reach.x > bounds.x && (*s).x - reach.x < bounds.z
        && (*s).y + reach.y > bounds.y && (*s).y - reach.y < bounds.w;
}

// max(SH(direction) + 1/2, 0), or its light; false: a colour is not finite.
fn colour_splat(n: u32, mean: vec3<f32>, s: ptr<function, Splat>) -> bool {
    var basis = sh_basis(view_direction(mean).xyz);
    var colour = vec3(0.5);
    let used = used_coefficients();
    let first = 3u * frame.sh_coefficients * n;
    for (var k = 0u; k < used; k++) {
        let at = first + 3u * k;
        colour += basis[k] * vec3(sh[at], sh[at + 1u], sh[at + 2u]);
    }
    if (!are_finite(vec4(colour, 0.0))) { return false; }
    colour = max(colour, vec3(0.0));
    if (frame.linear_light != 0u) {
        colour = vec3(to_linear(colour.x), to_linear(colour.y), to_linear(colour.z));
    }
    (*s).colour = colour;
    return true;
}

@compute @workgroup_size(ROWS)
fn project(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let n = group_index(group) * ROWS + lane;
    if (n >= frame.count) { return; }
    var g: Geometry;
    var s: Splat;
    var count = 0u;
    let bounds = pixel_bounds();
    if (project_centre(n, &g) && project_shape(n, &g) && in_front(&g) && make_splat(&g, bounds, &s)
        && colour_splat(n, g.mean, &s)) {
        let rows = tile_rows(s);
        for (var row = rows.x; row <= rows.y; row += 1.0) {
            let run = tiles_in_row(s, row, bounds);
            if (frame.has_mask == 0u) {
                count += u32(run.y);
                continue;
            }
            for (var i = 0; i < run.y; i++) { count += tile_mask[run.x + i]; }
        }
    }
    pair_counts[n] = count;
    ranks[n] = n;
    depths[n] = select(0xffffffffu, bitcast<u32>(s.depth), count > 0u);
    if (count > 0u) {
        splats[4u * n] = vec4(s.x, s.y, s.l11, s.l21);
        splats[4u * n + 1u] = vec4(s.l22, s.log2_opacity, s.slope_y, s.slope_x);
        splats[4u * n + 2u] = vec4(s.colour, s.depth);
        splats[4u * n + 3u] = vec4(s.reach, 0.0, 0.0);
    }
}

var<workgroup> sums: array<u32, ROWS>;

// A saturating sum. Like an ordinary sum, it does not depend on the order.
fn saturated(a: u32, b: u32) -> u32 { return select(a + b, 0xffffffffu, a + b < a); }

// The sum of the numbers up to each thread's own, inclusive.
fn running_sum(lane: u32, value: u32) -> u32 {
    sums[lane] = value;
    for (var step = 1u; step < ROWS; step *= 2u) {
        workgroupBarrier();
        var earlier = 0u;
        if (lane >= step) { earlier = sums[lane - step]; }
        workgroupBarrier();
        sums[lane] = saturated(sums[lane], earlier);
    }
    workgroupBarrier();
    return sums[lane];
}

// The pairs of each block of Gaussians, from front to back.
@compute @workgroup_size(ROWS)
fn sum_counts(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let block = group_index(group);
    let rank = block * ROWS + lane;
    var count = 0u;
    if (rank < frame.count) { count = pair_counts[order[rank]]; }
    let sum = running_sum(lane, count);
    if (lane == ROWS - 1u && block * ROWS < frame.count) { numbers[block] = sum; }
}

// Fills the slots, Gaussian by Gaussian from front to back. Only a stable sort by tile remains to
// be done.
@compute @workgroup_size(ROWS)
fn list_tiles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let block = group_index(group);
    let rank = block * ROWS + lane;
    var count = 0u;
    var n = 0u;
    if (rank < frame.count) {
        n = order[rank];
        count = pair_counts[n];
    }
    let end = running_sum(lane, count);
    if (count == 0u) { return; }
    var slot = numbers[block] + end - count;
    first_slot[n] = slot;
    let s = load_splat(n);
    let bounds = pixel_bounds();
    let rows = tile_rows(s);
    for (var row = rows.x; row <= rows.y; row += 1.0) {
        let run = tiles_in_row(s, row, bounds);
        for (var i = 0; i < run.y; i++) {
            if (frame.has_mask != 0u && tile_mask[run.x + i] == 0u) { continue; }
            tiles[slot] = u32(run.x + i);
            slots[slot] = slot;
            ids[slot] = n;
            slot++;
        }
    }
}

// Where each tile's entries begin. A thread for each entry, and one more.
@compute @workgroup_size(ROWS)
fn begin_tiles(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let i = group_index(group) * ROWS + lane;
    if (i > frame.pairs) { return; }
    var next = 0u;
    if (i > 0u) { next = sorted[i - 1u] + 1u; }
    var now = frame.tile_count;
    if (i < frame.pairs) { now = sorted[i]; }
    for (var tile = next; tile <= now; tile++) { tile_begin[tile] = i; }
}
