// The splats were blended among themselves in sRGB values. The viewport's overlay takes linear light.
// Blender lays it over the scene after the view transform, with a plain exponent of 2.2 on both sides
// (not sRGB's curve), so that this exponent brings the values to the screen as they are.

vec3 linear_light(vec3 shown)
{
  return pow(clamp(shown, 0.0, 1.0), vec3(2.2));
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
  colour = value * strength;
}
