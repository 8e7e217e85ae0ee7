// Passes over a tile's pixels with one Gaussian per thread.
//
// A group takes a bucket of neighbours of a tile's list. Each thread keeps its Gaussian, and walks
// over the pixels: in step s, thread i is at pixel s - i. There it finds the pixel's state in front
// of its Gaussian, which thread i - 1 has left one step before. So sums over a Gaussian's pixels
// stay in registers. The first thread takes the states from the checkpoints of the blending.

var<workgroup> pixels: array<vec4<f32>, PIXELS>;  // gradient: see there; weigh: x, a factor
var<workgroup> let_through: array<f32, PIXELS>;
var<workgroup> states: array<f32, PIXELS>;

// The work of a group.
struct Bucket {
    tile: u32,
    corner: vec2<i32>,
    place: u32,  // of its checkpoint
    entry: u32,  // this thread's
    is_there: bool,  // the list has it
    is_blended: bool,
}

fn bucket_of(place: u32, lane: u32) -> Bucket {
    var low = 0u;
    var high = frame.tile_count;  // the last tile that begins at `place` or before
    while (high - low > 1u) {
        let middle = (low + high) / 2u;
        if (first_bucket(middle, tile_first[middle]) <= place) {
            low = middle;
        } else {
            high = middle;
        }
    }
    let in_tile = (place - first_bucket(low, tile_first[low])) * BUCKET;
    let entry = tile_first[low] + in_tile + lane;
    return Bucket(low, tile_corner(low), place, entry, entry < tile_first[low + 1u],
                  in_tile < reached[low]);
}

// This thread's Gaussian.
struct Walker { place: vec2<f32>, shape: vec4<f32>, colour: vec3<f32> }

fn walker_of(n: u32, corner: vec2<i32>) -> Walker {
    let s = load_splat(n);
    return Walker(vec2(s.x, s.y) - vec2<f32>(corner),
                  vec4(s.l11, s.l21, s.l22, s.log2_opacity), s.colour);
}

// Its sample at a pixel of the tile.
fn sample_at(w: Walker, pixel: u32) -> Sample {
    let centre = vec2(f32(i32(pixel) % TILE), f32(i32(pixel) / TILE)) + 0.5;
    return sample(centre - w.place, w.shape);
}

// Gradient of the blending; kernels/tile_gradient.h has the formulas. Every slot is written.
@compute @workgroup_size(BUCKET)
fn gradient(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let bucket = bucket_of(group_index(group), lane);
    let plane = window_pixels();
    for (var p = lane; p < PIXELS; p += BUCKET) {
        let at = bucket.corner + vec2(i32(p) % TILE, i32(p) / TILE);
        var own = vec4(0.0);  // dL / d(colour), and its product with the colour
        if (is_in_picture(at)) {
            for (var k = 0u; k < 3u; k++) {
                let place = in_window(at) + k * plane;
                own[k] = picture_gradient[place];
                own.w += own[k] * picture[place];
            }
        }
        let before = checkpoints[bucket.place * PIXELS + p];
        pixels[p] = own;
        let_through[p] = before.w;
        states[p] = own.w - dot(before.xyz, own.xyz);
    }
    workgroupBarrier();
    var slot = 0u;
    var w: Walker;
    if (bucket.is_there) {
        slot = entries[bucket.entry];
        w = walker_of(ids[slot], bucket.corner);
    }
    let least = frame.min_transmittance;
    let walks = bucket.is_there && bucket.is_blended;
    var first = vec3(0.0);  // sums of g (1, u, v), ..
    var second = vec3(0.0);  // .. of g (u u, u v, v v), ..
    var colour = vec3(0.0);  // .. and of weight dL / d(colour)
    for (var step = 0u; step < PIXELS + BUCKET - 1u; step++) {
        let p = step - lane;  // below 0: very large
        if (walks && p < PIXELS) {
            let left = let_through[p];
            let s = sample_at(w, p);
            if (left > least && s.alpha > 0.0) {
                let pixel = pixels[p];
                let weight = s.alpha * left;
                let brightness = dot(pixel.xyz, w.colour);
                let state = states[p] - weight * brightness;
                states[p] = state;
                let_through[p] = left - weight;
                if (weight > least) {
                    let of_alpha = left * brightness - state / (1.0 - s.alpha);
                    let g = select(s.alpha * of_alpha, 0.0, s.is_capped);
                    first += g * vec3(1.0, s.u, s.v);
                    second += g * vec3(s.u * s.u, s.u * s.v, s.v * s.v);
                    colour += weight * pixel.xyz;
                }
            }
        }
        workgroupBarrier();
    }
    if (!bucket.is_there) { return; }
    for (var k = 0u; k < 3u; k++) {
        moments[slot * MOMENTS + k] = first[k];
        moments[slot * MOMENTS + 3u + k] = second[k];
        moments[slot * MOMENTS + 6u + k] = colour[k];
    }
}

// The largest weight and the sum of the weights of each slot.
@compute @workgroup_size(BUCKET)
fn weigh(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let bucket = bucket_of(group_index(group), lane);
    for (var p = lane; p < PIXELS; p += BUCKET) {
        let at = bucket.corner + vec2(i32(p) % TILE, i32(p) / TILE);
        var factor = 1.0;
        if (frame.has_pixel_weights != 0u && is_in_picture(at)) {
            factor = pixel_weights[in_window(at)];
        }
        pixels[p].x = factor;
        let_through[p] = checkpoints[bucket.place * PIXELS + p].w;
    }
    workgroupBarrier();
    var slot = 0u;
    var w: Walker;
    if (bucket.is_there) {
        slot = entries[bucket.entry];
        w = walker_of(ids[slot], bucket.corner);
    }
    let walks = bucket.is_there && bucket.is_blended;
    var found = vec2(0.0);
    for (var step = 0u; step < PIXELS + BUCKET - 1u; step++) {
        let p = step - lane;
        if (walks && p < PIXELS) {
            let left = let_through[p];
            if (left > frame.min_transmittance) {
                let weight = sample_at(w, p).alpha * left;
                let_through[p] = left - weight;
                found = vec2(max(found.x, weight), found.y + weight * pixels[p].x);
            }
        }
        workgroupBarrier();
    }
    if (bucket.is_there) { slot_weights[slot] = found; }
}

// .. and those of each Gaussian.
@compute @workgroup_size(ROWS)
fn fold_weights(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let n = group_index(group) * ROWS + lane;
    if (n >= frame.count) { return; }
    var found = vec2(0.0);
    for (var i = 0u; i < pair_counts[n]; i++) {
        let own = slot_weights[first_slot[n] + i];
        found = vec2(max(found.x, own.x), found.y + own.y);
    }
    weights[n] = found;
}
