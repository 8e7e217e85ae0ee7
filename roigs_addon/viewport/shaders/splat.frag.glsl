// Premultiplied sRGB values or light, for blending back to front.

void main()
{
  float alpha = min(0.999, paint.a * exp(-0.5 * dot(local, local)));
  if (alpha < 1.0 / 255.0) {
    discard;
  }
#ifdef SCENE_DEPTH
  // A coarse picture has larger pixels than the depth.
  ivec2 texel = min(ivec2(gl_FragCoord.xy * pixel), textureSize(scene_depth, 0) - 1);
  if (gl_FragCoord.z > texelFetch(scene_depth, texel, 0).x) {
    discard;
  }
#endif
  colour = vec4(paint.rgb * alpha, alpha);
}
