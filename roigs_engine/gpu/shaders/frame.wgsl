// What the kernels of one view hand on to each other. rasterize/gpu.py makes the buffers and runs
// the kernels in this order (sort: count_digits, scan, scatter for each digit):
//
//     project, sort by depth, sum_counts, scan, list_tiles, sort by tile, begin_tiles, blend,
//     [weigh, fold_weights], [gradient, project_backward, [adam]]
//
// A (Gaussian, tile) pair has a slot: those of one Gaussian are neighbours. What a tile finds out
// about a Gaussian is stored there and summed later, so no two threads ever add to one place: the
// same view gives the same bits each time.
//
// The constants in front of this are those of kernels/constants.h and gpu/program.py.

// The first 37 words are kernels/types.h: struct Camera.
struct Frame {
    world_to_camera: array<f32, 12>,
    position: array<f32, 3>,
    focal: array<f32, 2>,
    centre: array<f32, 2>,
    background: array<f32, 3>,
    blur: f32,
    stored_blur: f32,
    max_slope: f32,
    min_sigmas: f32,
    min_transmittance: f32,
    width: i32,
    height: i32,
    tile_x0: i32,
    tile_y0: i32,
    tile_x1: i32,
    tile_y1: i32,
    window_x0: i32,
    window_y0: i32,
    window_x1: i32,
    window_y1: i32,
    count: u32,
    sh_coefficients: u32,
    sh_degree: u32,
    raw: u32,
    linear_light: u32,
    has_mask: u32,
    has_pixel_weights: u32,
    keeps_checkpoints: u32,
    tile_count: u32,
    pairs: u32,
}

@group(0) @binding(0) var<storage, read> frame: Frame;
// of each Gaussian: all means, then all quats, scales and opacities; SH apart from them
@group(0) @binding(1) var<storage, read> shapes: array<f32>;
@group(0) @binding(2) var<storage, read> sh: array<f32>;
@group(0) @binding(3) var<storage, read_write> splats: array<vec4<f32>>;  // 4 each, see Splat
@group(0) @binding(4) var<storage, read_write> depths: array<u32>;  // bits; the largest: not drawn
@group(0) @binding(5) var<storage, read_write> ranks: array<u32>;  // 0, 1, 2, .., to be sorted
@group(0) @binding(6) var<storage, read_write> pair_counts: array<u32>;
@group(0) @binding(7) var<storage, read_write> first_slot: array<u32>;
@group(0) @binding(8) var<storage, read> tile_mask: array<u32>;
@group(0) @binding(9) var<storage, read> order: array<u32>;  // front to back
@group(0) @binding(10) var<storage, read_write> numbers: array<u32>;  // to be scanned
// of each pair
@group(0) @binding(11) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(12) var<storage, read_write> slots: array<u32>;  // 0, 1, 2, .., to be sorted
@group(0) @binding(13) var<storage, read_write> ids: array<u32>;  // of each slot: its Gaussian
@group(0) @binding(14) var<storage, read> sorted: array<u32>;  // tiles
@group(0) @binding(15) var<storage, read> entries: array<u32>;  // slots, tile by tile
@group(0) @binding(16) var<storage, read_write> tile_begin: array<u32>;
@group(0) @binding(17) var<storage, read> tile_first: array<u32>;  // the same, to be read
@group(0) @binding(18) var<storage, read_write> reached: array<u32>;  // entries that blending saw
@group(0) @binding(19) var<storage, read_write> checkpoints: array<vec4<f32>>;
@group(0) @binding(20) var<storage, read_write> moments: array<f32>;  // of each slot
// pictures, of the window
@group(0) @binding(21) var<storage, read_write> picture: array<f32>;  // red, green, blue, alpha, depth
@group(0) @binding(22) var<storage, read> picture_gradient: array<f32>;  // of red, green, blue
@group(0) @binding(23) var<storage, read> pixel_weights: array<f32>;
@group(0) @binding(24) var<storage, read_write> slot_weights: array<vec2<f32>>;  // largest, sum
@group(0) @binding(25) var<storage, read_write> weights: array<vec2<f32>>;  // .. of each Gaussian
// of the backward pass, shaped as `shapes` and `sh`
@group(0) @binding(26) var<storage, read_write> shape_gradients: array<f32>;
@group(0) @binding(27) var<storage, read_write> sh_gradients: array<f32>;
// of each row: the length of the gradient of the projected centre, as bits; and bits that say whether
// there is a gradient (1), and whether that of means, quats, scales, opacities, SH is finite (2 to 32)
@group(0) @binding(28) var<storage, read_write> row_results: array<vec2<u32>>;

fn group_index(group: vec3<u32>) -> u32 { return group.x + group.y * GROUPS_IN_ROW; }

// By its bits: compilers may take for granted that there is no NaN.
fn is_finite(x: f32) -> bool { return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u; }
fn are_finite(v: vec4<f32>) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z) && is_finite(v.w);
}

fn camera_row(row: u32) -> vec3<f32> {
    return vec3(frame.world_to_camera[4u * row], frame.world_to_camera[4u * row + 1u],
                frame.world_to_camera[4u * row + 2u]);
}

// The tile's number in the camera's rectangle, row by row; it is in the rectangle.
fn tile_number(column: i32, row: i32) -> u32 {
    return u32((row - frame.tile_y0) * (frame.tile_x1 - frame.tile_x0) + column - frame.tile_x0);
}

// The corner of a tile, px.
fn tile_corner(tile: u32) -> vec2<i32> {
    let columns = frame.tile_x1 - frame.tile_x0;
    return TILE * vec2(frame.tile_x0 + i32(tile) % columns, frame.tile_y0 + i32(tile) / columns);
}

fn is_in_picture(at: vec2<i32>) -> bool { return at.x < frame.width && at.y < frame.height; }

// Where a pixel of the picture is in a plane of the window.
fn in_window(at: vec2<i32>) -> u32 {
    let columns = frame.window_x1 - frame.window_x0;
    return u32((at.y - frame.window_y0) * columns + at.x - frame.window_x0);
}
fn window_pixels() -> u32 {
    return u32((frame.window_x1 - frame.window_x0) * (frame.window_y1 - frame.window_y0));
}

// The place of the first checkpoint of a tile, which has one in front of each bucket of entries.
fn first_bucket(tile: u32, first_entry: u32) -> u32 { return first_entry / BUCKET + tile; }

// A Gaussian on the picture; kernels/view.h explains the columns.
struct Splat {
    x: f32, y: f32, l11: f32, l21: f32,
    l22: f32, log2_opacity: f32, slope_y: f32, slope_x: f32,
    colour: vec3<f32>, depth: f32,
    reach: vec2<f32>,
}

fn load_splat(n: u32) -> Splat {
    let a = splats[4u * n];
    let b = splats[4u * n + 1u];
    let c = splats[4u * n + 2u];
    let d = splats[4u * n + 3u];
    return Splat(a.x, a.y, a.z, a.w, b.x, b.y, b.z, b.w, c.xyz, c.w, d.xy);
}

// A splat at a pixel: the whitened offset, and alpha, 0 where it is not drawn.
struct Sample { u: f32, v: f32, alpha: f32, is_capped: bool }

// `offset`: the pixel's centre from the splat's; `shape`: l11, l21, l22, log2(opacity).
fn sample(offset: vec2<f32>, shape: vec4<f32>) -> Sample {
    let u = shape.x * offset.x + shape.y * offset.y;
    let v = shape.z * offset.y;
    let exponent = shape.w - u * u - v * v;
    let uncapped = exp2(exponent);
    let is_capped = uncapped >= ALPHA_MAX;
    let alpha = select(0.0, select(uncapped, ALPHA_MAX, is_capped), exponent > LOG2_ALPHA_MIN);
    return Sample(u, v, alpha, is_capped);
}
