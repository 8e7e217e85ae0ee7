void main()
{
  vec2 from_centre = gl_PointCoord - 0.5;
  if (dot(from_centre, from_centre) > 0.25) {
    discard;
  }
  vec3 curve = 1.055 * pow(paint, vec3(1.0 / 2.4)) - 0.055;
  vec3 shown = mix(curve, 12.92 * paint, vec3(lessThan(paint, vec3(0.0031308))));
  // The viewport puts its overlay on the screen with a plain exponent, see composite.frag.glsl.
  colour = vec4(linear_target ? pow(clamp(shown, 0.0, 1.0), vec3(2.2)) : shown, 1.0);
}
