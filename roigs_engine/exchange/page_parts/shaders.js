"use strict";
// One pass projects the Gaussians that are drawn, one for each pixel of its two targets; the next
// draws a square for each. The rules are those of roigs_engine.rasterize.

/**
 * WebGL programs of a model with SH of `degree`; `rules` are the constants of our rasterizer. An
 * `antialiased` Gaussian that the blur makes larger is as much fainter.
 */
function shaders({ degree, antialiased }, rules) {
  const [blur, box, slope, sigmas, margin, magnified] =
    [rules.blur, rules.box, rules.slope, rules.sigmas, rules.margin, rules.magnified]
      .map((v) => v.toFixed(6));
  // Pixels of the view for one of the photos'.
  const ratio = rules.photo_focal
    ? `min(focal.y / ${rules.photo_focal.toFixed(6)}, ${magnified})` : "1.0";
  const head = "#version 300 es\nprecision highp float;\nprecision highp int;\n" +
    "precision highp usampler2D;\n";
  const whole = head + `void main() {
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;
  const fetch = `
ivec2 at(int i) { return ivec2(i & ${PROJECTED - 1}, i / ${PROJECTED}); }
ivec2 far(int i) { return ivec2(i & ${WIDTH - 1}, i / ${WIDTH}); }
vec4 four(uint v) { return vec4(v & 255u, v >> 8 & 255u, v >> 16 & 255u, v >> 24); }
`;
  const project = head + fetch + `
uniform usampler2D order, centres, shapes, harmonics;
uniform mat4 view;
uniform vec3 eye;
uniform vec2 focal, size; // px
uniform float near;
layout(location = 0) out uvec4 place; // centre, and the two axes as halves
layout(location = 1) out uvec2 look; // colour and opacity as halves

mat3 turned(uint bits) {
  int largest = int(bits >> 30);
  vec4 q = vec4(0.0); // x, y, z, w
  float squares = 0.0;
  for (int i = 3; i >= 0; i--) {
    if (i == largest) continue;
    float value = float(bits & 511u) / 511.0 * 0.70710678;
    q[i] = (bits & 512u) != 0u ? -value : value;
    squares += value * value;
    bits >>= 10;
  }
  q[largest] = sqrt(max(0.0, 1.0 - squares));
  float x = q.x, y = q.y, z = q.z, w = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

vec3 sh(uint v) { return four(v).rgb / 128.0 - 1.0; }

vec3 harmonic(int i, vec3 d) {
  vec3 sum = vec3(0.0);
  float x = d.x, y = d.y, z = d.z;
#if ${degree} > 0
  int first = i * ${[0, 1, 2, 4][degree]};
  uvec4 a = texelFetch(harmonics, far(first), 0);
  sum += 0.4886025119 * (-y * sh(a.x) + z * sh(a.y) - x * sh(a.z));
#endif
#if ${degree} > 1
  uvec4 b = texelFetch(harmonics, far(first + 1), 0);
  float xx = x * x, yy = y * y, zz = z * z;
  sum += 1.0925484306 * (x * y * sh(a.w) - y * z * sh(b.x) - x * z * sh(b.z)
      + 0.5 * (xx - yy) * sh(b.w)) + 0.3153915653 * (2.0 * zz - xx - yy) * sh(b.y);
#endif
#if ${degree} > 2
  uvec4 c = texelFetch(harmonics, far(first + 2), 0), e = texelFetch(harmonics, far(first + 3), 0);
  sum += -0.5900435899 * (y * (3.0 * xx - yy) * sh(c.x) + x * (xx - 3.0 * yy) * sh(e.z))
      + 2.8906114426 * x * y * z * sh(c.y)
      - 0.4570457995 * (4.0 * zz - xx - yy) * (y * sh(c.z) + x * sh(e.x))
      + 0.3731763326 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh(c.w)
      + 1.4453057213 * z * (xx - yy) * sh(e.y);
#endif
  return sum;
}

void main() {
  place = uvec4(0u);
  look = uvec2(0u);
  ivec2 here = ivec2(gl_FragCoord.xy);
  int i = int(texelFetch(order, here, 0).x);
  uvec4 stored = texelFetch(centres, far(i), 0);
  uvec2 shape = texelFetch(shapes, far(i), 0).xy;
  vec3 mean = uintBitsToFloat(stored.xyz);
  vec3 t = (view * vec4(mean, 1.0)).xyz * vec3(1.0, 1.0, -1.0); // z forwards
  vec2 centre = focal * t.xy / t.z;
  vec2 most = max(0.5 * size, ${slope} * focal);
  float opacity = float(stored.w >> 24) / 255.0, ratio = ${ratio};
  float inside = log2(255.0 * opacity);
  if (t.z <= near || any(greaterThan(abs(centre), most)) || inside <= 0.0) return;
  // The Jacobian far beside the picture would make huge Gaussians.
  vec2 limit = (1.0 + ${margin}) * 0.5 * size / focal;
  vec2 slope = clamp(t.xy / t.z, -limit, limit);
  mat3 turn = mat3(view) * turned(shape.y);
  vec3 scale = exp(four(shape.x).xyz / 16.0 - 10.0);
  vec3 u = vec3(0.0), v = vec3(0.0), along = vec3(0.0);
  for (int k = 0; k < 3; k++) {
    vec3 axis = turn[k] * scale[k];
    along[k] = axis.z;
    u[k] = focal.x / t.z * (axis.x + slope.x * axis.z); // the view's z is backwards
    v[k] = focal.y / t.z * (axis.y + slope.y * axis.z);
  }
  if (t.z <= ${sigmas} * length(along)) return; // it reaches behind the camera
  float xx = dot(u, u), yy = dot(v, v), xy = dot(u, v);
  vec3 across = cross(u, v);
  // The photos' blur is an angle, that of a pixel is its own (rasterize/view.py, pixel_size).
  float photo = ${blur} * ratio * ratio;
  float blur = photo + ${box} * (1.0 - ratio * ratio);
  float kept = ${antialiased ? "0.0" : "photo"};
  float determinant = dot(across, across) + blur * (xx + yy) + blur * blur;
  opacity *= sqrt((dot(across, across) + kept * (xx + yy) + kept * kept) / determinant);
  if (!(255.0 * opacity > 1.0)) return;
  inside = log2(255.0 * opacity);
  xx += blur;
  yy += blur;
  float larger = 0.5 * (xx + yy) + length(vec2(0.5 * (xx - yy), xy));
  float angle = 0.5 * atan(2.0 * xy, xx - yy);
  vec2 direction = vec2(cos(angle), sin(angle));
  // To where it is 1/255.
  vec2 radii = sqrt(1.3862943611 * inside * vec2(larger, determinant / larger));
  radii = min(radii, 30000.0);
  vec2 extent = abs(direction) * radii.x + abs(direction.yx) * radii.y;
  if (any(greaterThan(abs(centre) - extent, 0.5 * size))) return;
  place = uvec4(floatBitsToUint(centre), packHalf2x16(direction * radii.x),
    packHalf2x16(vec2(-direction.y, direction.x) * radii.y));
  vec3 colour = (four(stored.w).rgb / 255.0 - 0.5) / 0.15 * 0.28209479177 + 0.5;
  colour = max(colour + harmonic(i, normalize(mean - eye)), 0.0);
  look = uvec2(packHalf2x16(colour.rg), packHalf2x16(vec2(colour.b, opacity)));
}`;
  const square = head + fetch + `
uniform usampler2D places, looks;
uniform vec2 size;
uniform ivec2 range; // first and end
out vec2 offset;
flat out vec3 colour;
flat out vec2 fall; // log2 of the opacity, and how much less it is at the edge
void main() {
  int i = range.x + gl_InstanceID * ${BATCH} + (gl_VertexID >> 2);
  gl_Position = vec4(2.0, 2.0, 0.0, 1.0);
  if (i >= range.y) return;
  ivec2 here = at(i);
  uvec4 place = texelFetch(places, here, 0);
  uvec2 look = texelFetch(looks, here, 0).xy;
  vec2 rest = unpackHalf2x16(look.y);
  offset = vec2(gl_VertexID & 1, gl_VertexID >> 1 & 1) * 2.0 - 1.0;
  colour = vec3(unpackHalf2x16(look.x), rest.x);
  fall = vec2(log2(max(rest.y, 1e-6)), log2(max(255.0 * rest.y, 1.0)));
  vec2 px = uintBitsToFloat(place.xy) + offset.x * unpackHalf2x16(place.z)
    + offset.y * unpackHalf2x16(place.w);
  if (rest.y > 0.0) gl_Position = vec4(2.0 * px / size, 0.0, 1.0);
}`;
  const blend = head + `
in vec2 offset;
flat in vec3 colour;
flat in vec2 fall;
out vec4 pixel;
void main() {
  float d = dot(offset, offset);
  if (d > 1.0) discard;
  float alpha = min(0.999, exp2(fall.x - d * fall.y));
  pixel = vec4(colour * alpha, alpha);
}`;
  return { project: [whole, project], draw: [square, blend] };
}
