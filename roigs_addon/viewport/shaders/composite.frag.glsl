// The splats were blended in sRGB values. A framebuffer that encodes what it is given is given linear
// light, so that the values arrive in it as they are.

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
  value.rgb = min(value.rgb, vec3(1.0));
  colour = linear_target ? vec4(linear_light(value.rgb), value.a) : value;
}
