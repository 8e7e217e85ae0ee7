// TOGETHER Gaussians per instance, the third number of `place` says which; projected as roigs_engine/rasterize/reference.py does it (EWA splatting,
// Zwicker et al. 2001; 3DGS, Kerbl et al. 2023). Camera axes are OpenGL's: x right, y up, z backward;
// pixels count from the lower left corner.

#define ALPHA_MIN (1.0 / 255.0)
#define LEAST 0.2            // see roigs_engine/model/operations.py
#define BLUR 0.3             // px^2, added to the diagonal of the 2D covariance
#define BOX (1.0 / 12.0)     // the same, of what is made for Cycles
#define MAGNIFIED 16.0       // a photo's pixel is at most so many wide
#define FRUSTUM_MARGIN 0.3   // of the half angle, around the frame
// Beyond these limits EWA splatting fails (roigs_engine/rasterize/limits.py):
#define MAX_SLOPE 3.0        // of centres outside the frame
#define MIN_SIGMAS 2.0       // of depth, in standard deviations along the camera's axis

#define TEXEL(map, i) texelFetch(map, ivec2(int((i) % ROW), int((i) / ROW)), 0)
#define OBJECT(i, k) texelFetch(objects, ivec2(k, i), 0)

mat3 rotation(vec4 q)  // wxyz, columns are the turned axes
{
  float w = q.x, x = q.y, y = q.z, z = q.w;
  return mat3(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
              2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
              2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y));
}

// Real spherical harmonics seen along `v`, against coefficients of which each colour has `sh_texels`
// texels. Signs as in 3DGS.
vec3 sh_sum(uint first, vec3 v)
{
  float x = v.x, y = v.y, z = v.z, xx = x * x, yy = y * y, zz = z * z;
  vec4 basis[4];
  basis[0] = vec4(0.28209479177387814,
                  -0.4886025119029199 * y,
                  0.4886025119029199 * z,
                  -0.4886025119029199 * x);
  basis[1] = vec4(1.0925484305920792 * x * y,
                  -1.0925484305920792 * y * z,
                  0.31539156525252005 * (2.0 * zz - xx - yy),
                  -1.0925484305920792 * x * z);
  basis[2] = vec4(0.5462742152960396 * (xx - yy),
                  -0.5900435899266435 * y * (3.0 * xx - yy),
                  2.890611442640554 * x * y * z,
                  -0.4570457994644658 * y * (4.0 * zz - xx - yy));
  basis[3] = vec4(0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
                  -0.4570457994644658 * x * (4.0 * zz - xx - yy),
                  1.445305721320277 * z * (xx - yy),
                  -0.5900435899266435 * x * (xx - 3.0 * yy));
  vec3 sum = vec3(0.0);
  for (int k = 0; k < sh_texels; k++) {
    uint red = first + uint(k), green = red + uint(sh_texels), blue = green + uint(sh_texels);
    sum += vec3(dot(basis[k], TEXEL(colours, red)),
                dot(basis[k], TEXEL(colours, green)),
                dot(basis[k], TEXEL(colours, blue)));
  }
  return sum;
}

// The light of sRGB values, as roigs_engine/rasterize/light.py has it.
vec3 light_of(vec3 shown)
{
  vec3 power = pow((max(shown, 0.04045) + 0.055) / 1.055, vec3(2.4));
  return mix(shown / 12.92, power, vec3(greaterThan(shown, vec3(0.04045))));
}

void main()
{
  // All corners outside: nothing is drawn.
  gl_Position = vec4(0.0, 0.0, 2.0, 1.0);
  local = vec2(0.0);
  paint = vec4(0.0);

  int row = gl_InstanceID * TOGETHER + int(place.z);
  if (row >= count) {
    return;
  }
  uint index = floatBitsToUint(TEXEL(order, uint(row)).x) & INDEX_BITS;
  vec4 body = TEXEL(geometry, 3u * index);
  vec4 quat = TEXEL(geometry, 3u * index + 1u);
  vec4 size = TEXEL(geometry, 3u * index + 2u);
  int number = int(size.w);
  bool antialiased = fract(size.w) >= 0.5;
  float photo = fract(2.0 * size.w) > 0.0 ? BOX : BLUR;  // the blur in the photos
  vec3 mean = body.xyz;
  float opacity = body.w, density = OBJECT(number, 4).w;
  if (density < 1.0) {
    float through = 1.0 - opacity, upper = max(through, LEAST);
    opacity = 1.0 - pow(upper, density) * (1.0 - density * (1.0 - through / upper));
  }
  if (opacity <= ALPHA_MIN) {
    return;
  }

  // Object to camera: three rows of a matrix. Then the eye in the object's frame, or in an
  // orthographic view the direction of sight, and the least depth. Then the gains of the colours,
  // and the density. Then the focal length of the photos, or 0.
  vec4 row_x = OBJECT(number, 0), row_y = OBJECT(number, 1), row_z = OBJECT(number, 2);
  vec4 eye = OBJECT(number, 3);
  mat3 turn = transpose(mat3(row_x.xyz, row_y.xyz, row_z.xyz));
  vec3 t = turn * mean + vec3(row_x.w, row_y.w, row_z.w);
  float depth = -t.z;
  if (!(depth > eye.w)) {
    return;
  }

  bool perspective = projection[3][3] == 0.0;
  vec2 focal = vec2(projection[0][0], projection[1][1]) * 0.5 * view_size;
  vec2 principal, centre;
  mat3 shape = turn * rotation(quat) * mat3(size.x, 0.0, 0.0, 0.0, size.y, 0.0, 0.0, 0.0, size.z);
  mat3 rows = transpose(shape);  // its columns: how x, y, z depend on the Gaussian's own axes
  vec3 u, v;                     // the same for the pixel's x and y
  if (perspective) {
    if (!(depth > MIN_SIGMAS * length(rows[2]))) {
      return;
    }
    principal = (1.0 - vec2(projection[2][0], projection[2][1])) * 0.5 * view_size;
    centre = focal * t.xy / depth + principal;
    vec2 low = min(frame.xy, principal - MAX_SLOPE * focal);
    vec2 high = max(frame.zw, principal + MAX_SLOPE * focal);
    if (!(all(greaterThan(centre, low)) && all(lessThan(centre, high)))) {
      return;
    }
    vec2 margin = FRUSTUM_MARGIN * 0.5 * (frame.zw - frame.xy) / focal;
    vec2 slope = clamp(t.xy / depth,
                       (frame.xy - principal) / focal - margin,
                       (frame.zw - principal) / focal + margin);
    u = focal.x / depth * (rows[0] + slope.x * rows[2]);
    v = focal.y / depth * (rows[1] + slope.y * rows[2]);
  }
  else {
    principal = (1.0 + vec2(projection[3][0], projection[3][1])) * 0.5 * view_size;
    centre = focal * t.xy + principal;
    u = focal.x * rows[0];
    v = focal.y * rows[1];
  }
  float xx = dot(u, u), xy = dot(u, v), yy = dot(v, v);
  // The photos' blur is an angle, that of a pixel is its own (roigs_engine/rasterize/view.py).
  float photo_focal = OBJECT(number, 5).x;
  float ratio = perspective && photo_focal > 0.0 ? min(focal.y / photo_focal, MAGNIFIED) : 1.0;
  photo *= ratio * ratio;
  float blur = ratio == 1.0 ? photo : photo + BOX * (1.0 - ratio * ratio);
  float stored = antialiased ? 0.0 : photo;
  if (stored != blur) {
    // Blurred, a Gaussian is larger, and as much fainter: by the root of the determinants' ratio.
    // |u x v|^2 is that without any blur; xx * yy - xy * xy would cancel for needles.
    vec3 area = cross(u, v);
    float sharp = dot(area, area);
    opacity *= sqrt((sharp + stored * (xx + yy) + stored * stored) /
                    (sharp + blur * (xx + yy) + blur * blur));
    if (!(opacity > ALPHA_MIN)) {
      return;
    }
  }
  xx += blur;
  yy += blur;

  // Beyond this many standard deviations the Gaussian is fainter than ALPHA_MIN.
  float reach = sqrt(2.0 * log(opacity / ALPHA_MIN));
  vec2 extent = reach * sqrt(vec2(xx, yy));
  if (any(lessThan(centre + extent, vec2(0.0))) || any(greaterThan(centre - extent, view_size))) {
    return;
  }

  // The quad lies along the axes of the ellipse.
  float half_difference = 0.5 * (xx - yy);
  float radius = length(vec2(half_difference, xy));
  float major = 0.5 * (xx + yy) + radius;
  float minor = max((xx * yy - xy * xy) / major, blur);
  vec2 axis = half_difference >= 0.0 ? vec2(half_difference + radius, xy) :
                                       vec2(xy, radius - half_difference);
  axis = radius > 0.0 ? normalize(axis) : vec2(1.0, 0.0);
  local = place.xy * reach;
  vec2 pixel = centre + axis * (sqrt(major) * local.x) +
               vec2(-axis.y, axis.x) * (sqrt(minor) * local.y);

  vec3 sight = perspective ? normalize(mean - eye.xyz) : eye.xyz;
  vec3 rgb = max(0.5 + sh_sum(uint(3 * sh_texels) * index, sight), 0.0) * OBJECT(number, 4).xyz;
  paint = vec4(linear_light ? light_of(rgb) : rgb, opacity);
  vec4 clip = projection * vec4(t, 1.0);
  gl_Position = vec4(2.0 * pixel / view_size - 1.0, clip.z / clip.w, 1.0);
}
