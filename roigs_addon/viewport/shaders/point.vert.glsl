void main()
{
  float radius = sizes.x, height = sizes.y, smallest = sizes.z;
  vec4 centre = model_view * vec4(point, 1.0);
  // A disc through the foremost point of the ball that Blender draws hides all of it.
  bool perspective = projection[3][3] == 0.0;
  float away = length(centre.xyz);
  vec3 to_eye = perspective ? -centre.xyz / max(away, 1e-12) : vec3(0.0, 0.0, 1.0);
  float nearer = perspective ? min(radius, 0.5 * away) : radius;
  gl_Position = projection * vec4(centre.xyz + nearer * to_eye, 1.0);
  gl_PointSize = max(radius * projection[1][1] * height / gl_Position.w + 1.0, smallest);
  paint = light.rgb;
}
