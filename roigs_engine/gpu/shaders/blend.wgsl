// Blending front to back (3DGS, eq. 3): C = sum_i c_i alpha_i T_i, T_i = prod_{j<i} (1 - alpha_j).
// A group for each tile of the window, a thread for each pixel.

var<workgroup> batch_shape: array<vec4<f32>, PIXELS>;   // l11, l21, l22, log2(opacity)
var<workgroup> batch_colour: array<vec4<f32>, PIXELS>;  // .. and depth
var<workgroup> batch_place: array<vec2<f32>, PIXELS>;   // from the tile's corner
var<workgroup> seeing: atomic<u32>;  // 1 if a pixel of the tile still lets light through
var<workgroup> goes_on: u32;

fn write_pixel(at: vec2<i32>, light: vec4<f32>, depth: f32) {
    let place = in_window(at);
    let plane = window_pixels();
    for (var k = 0u; k < 3u; k++) {
        picture[place + k * plane] = light[k] + light.w * frame.background[k];
    }
    picture[place + 3u * plane] = 1.0 - light.w;
    picture[place + 4u * plane] = select(0.0, depth / (1.0 - light.w), light.w < 1.0);
}

@compute @workgroup_size(PIXELS)
fn blend(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) pixel: u32) {
    let column = frame.window_x0 / TILE + i32(group.x);
    let row = frame.window_y0 / TILE + i32(group.y);
    let corner = TILE * vec2(column, row);
    let inside = vec2(i32(pixel) % TILE, i32(pixel) / TILE);
    let at = corner + inside;
    let is_there = is_in_picture(at);
    let is_active = column >= frame.tile_x0 && column < frame.tile_x1 && row >= frame.tile_y0
        && row < frame.tile_y1 && frame.pairs > 0u;
    var first = 0u;
    var end = 0u;
    var tile = 0u;
    if (is_active) {
        tile = tile_number(column, row);
        first = tile_first[tile];
        end = tile_first[tile + 1u];
    }
    var checkpoint = first_bucket(tile, first) * PIXELS + pixel;
    let least = frame.min_transmittance;
    let centre = vec2<f32>(inside) + 0.5;
    var light = vec4(0.0, 0.0, 0.0, select(0.0, 1.0, is_there));  // colour, and transmittance
    var depth = 0.0;
    var begin = first;
    for (; begin < end; begin += PIXELS) {
        if (pixel == 0u) { atomicStore(&seeing, 0u); }
        workgroupBarrier();
        if (light.w > least) { atomicStore(&seeing, 1u); }
        workgroupBarrier();
        if (pixel == 0u) { goes_on = atomicLoad(&seeing); }
        if (workgroupUniformLoad(&goes_on) == 0u) { break; }
        if (begin + pixel < end) {
            let s = load_splat(ids[entries[begin + pixel]]);
            batch_shape[pixel] = vec4(s.l11, s.l21, s.l22, s.log2_opacity);
            batch_colour[pixel] = vec4(s.colour, s.depth);
            batch_place[pixel] = vec2(s.x, s.y) - vec2<f32>(corner);
        }
        workgroupBarrier();
        let count = min(end - begin, PIXELS);
        for (var i = 0u; i < count; i++) {
            if (i % BUCKET == 0u && frame.keeps_checkpoints != 0u) {
                checkpoints[checkpoint] = light;
                checkpoint += PIXELS;
            }
            if (!(light.w > least)) { continue; }
            let weight = sample(centre - batch_place[i], batch_shape[i]).alpha * light.w;
            light += weight * vec4(batch_colour[i].xyz, -1.0);
            depth += weight * batch_colour[i].w;
        }
    }
    if (pixel == 0u && is_active) { reached[tile] = min(begin, end) - first; }
    if (is_there) { write_pixel(at, light, depth); }
}
