// Premultiplied sRGB values, for blending back to front.

void main()
{
  float alpha = min(0.999, paint.a * exp(-0.5 * dot(local, local)));
  // A depth texture of one texel holds for all pixels.
  ivec2 texel = min(ivec2(gl_FragCoord.xy), textureSize(scene_depth, 0) - 1);
  if (alpha < 1.0 / 255.0 || gl_FragCoord.z > texelFetch(scene_depth, texel, 0).x) {
    discard;
  }
  colour = vec4(paint.rgb * alpha, alpha);
}
