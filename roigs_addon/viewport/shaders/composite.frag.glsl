// The splats were blended among themselves in sRGB values. The viewport's overlay takes linear light.
// Blender lays it over the scene after the view transform, with a plain exponent of 2.2 on both sides
// (not sRGB's curve), so that this exponent brings the values to the screen as they are.

vec3 linear_light(vec3 shown)
{
  return pow(clamp(shown, 0.0, 1.0), vec3(2.2));
}

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy) - origin;
  vec4 value = texelFetch(picture, pixel, 0);
  if (value.a == 0.0) {
    discard;
  }
  if (linear_target) {
    // Splats are trained before black, and show dark things by letting it through. Where they cover
    // most of a pixel and nothing lies behind them, black is what they get; fringes and what stands
    // before a surface are laid over what is there.
    float behind = texelFetch(scene_depth, min(pixel, textureSize(scene_depth, 0) - 1), 0).x;
    float black = behind < 1.0 ? 0.0 : smoothstep(0.1, 0.5, value.a);
    vec3 over = linear_light(value.rgb / value.a) * value.a;
    vec3 on_black = linear_light(value.rgb);
    value = vec4(mix(over, on_black, black), mix(value.a, 1.0, black));
  }
  colour = value;
}
