// The splats were blended among themselves in sRGB values, or in linear light if most are made for
// that, which gets its sRGB values here. The viewport's overlay takes linear light: Blender lays it over
// the scene after the view transform, with a plain exponent of 2.2 on both sides (not sRGB's curve), so
// that this exponent brings the values to the screen as they are.

vec3 overlay(vec3 shown)
{
  return pow(clamp(shown, 0.0, 1.0), vec3(2.2));
}

vec3 values_of(vec3 light)
{
  vec3 curve = 1.055 * pow(max(light, 0.0031308), vec3(1.0 / 2.4)) - 0.055;
  return mix(12.92 * light, curve, vec3(greaterThan(light, vec3(0.0031308))));
}

// The picture at a pixel of the region; one with fewer pixels is interpolated.
vec4 picture_at(ivec2 pixel)
{
  ivec2 size = textureSize(picture, 0), last = size - 1;
  if (size == ivec2(view_size)) {
    return texelFetch(picture, pixel, 0);
  }
  vec2 place = (vec2(pixel) + 0.5) * vec2(size) / view_size - 0.5;
  ivec2 low = ivec2(floor(place));
  vec2 part = place - vec2(low);
  ivec2 a = clamp(low, ivec2(0), last), b = clamp(low + 1, ivec2(0), last);
  vec4 below = mix(texelFetch(picture, a, 0), texelFetch(picture, ivec2(b.x, a.y), 0), part.x);
  vec4 above = mix(texelFetch(picture, ivec2(a.x, b.y), 0), texelFetch(picture, b, 0), part.x);
  return mix(below, above, part.y);
}

void main()
{
  ivec2 pixel = ivec2(gl_FragCoord.xy) - origin;
  vec4 value = picture_at(pixel);
  if (value.a == 0.0) {
    discard;
  }
  vec3 alone = value.rgb / value.a, before_black = value.rgb;
  if (linear_light) {
    alone = values_of(alone);
    before_black = values_of(before_black);
    value.rgb = clamp(alone, 0.0, 1.0) * value.a;
  }
  if (linear_target) {
    // Splats are trained before black, and show dark things by letting it through. Where they cover
    // most of a pixel and nothing lies behind them, black is what they get; fringes and what stands
    // before a surface are laid over what is there.
    float behind = texelFetch(scene_depth, min(pixel, textureSize(scene_depth, 0) - 1), 0).x;
    float black = behind < 1.0 ? 0.0 : smoothstep(0.1, 0.5, value.a);
    vec3 over = overlay(alone) * value.a;
    vec3 on_black = overlay(before_black);
    value = vec4(mix(over, on_black, black), mix(value.a, 1.0, black));
  }
  colour = value * strength;
}
