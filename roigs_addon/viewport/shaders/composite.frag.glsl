// The splats were blended among themselves in sRGB values. The viewport's framebuffer takes linear light
// and shows it as sRGB, untouched by the view transform; it blends over the scene in linear light, too.

vec3 linear_light(vec3 srgb)
{
  vec3 low = srgb / 12.92, high = pow((max(srgb, 0.0) + 0.055) / 1.055, vec3(2.4));
  return mix(high, low, lessThanEqual(srgb, vec3(0.04045)));
}

void main()
{
  vec4 value = texelFetch(picture, ivec2(gl_FragCoord.xy) - origin, 0);
  if (value.a == 0.0) {
    discard;
  }
  if (linear_target) {
    value.rgb = linear_light(min(value.rgb / value.a, vec3(1.0))) * value.a;
  }
  colour = value;
}
