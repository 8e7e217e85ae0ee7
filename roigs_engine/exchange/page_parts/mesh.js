"use strict";
// Textured meshes, on a canvas of their own above that of the Gaussians. Light is in their texture.

const MESH_SHADERS = [`#version 300 es
in vec3 place;
in vec2 uv;
uniform mat4 view;
uniform vec2 slopes;
uniform float near;
out vec2 at;
void main() {
  vec3 seen = (view * vec4(place, 1.0)).xyz;
  at = uv;
  gl_Position = vec4(seen.xy / slopes, -seen.z - 2.0 * near, -seen.z);
}`, `#version 300 es
precision highp float;
in vec2 at;
uniform sampler2D picture;
out vec4 colour;
void main() {
  colour = vec4(texture(picture, at).rgb, 1.0);
}`];

class MeshView {
  constructor(canvas, renderer) {
    this.canvas = canvas;
    this.near = renderer.near;
    this.gl = canvas.getContext("webgl2", { alpha: false, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error("The browser has no room for a second 3D view.");
    this.program = Renderer.prototype.program.call(this, MESH_SHADERS);
    this.gl.enable(this.gl.DEPTH_TEST);
  }

  /** The text of the meshes -> the meshes, on the graphics card. */
  async load(text) {
    this.meshes = await Promise.all(JSON.parse(text).map((mesh) => this.uploaded(mesh)));
  }

  async uploaded({ places, uvs, faces, picture }) {
    const gl = this.gl;
    const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const image = await createImageBitmap(new Blob([bytes(picture)]));
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    for (const [name, width, text] of [["place", 3, places], ["uv", 2, uvs]]) {
      const index = gl.getAttribLocation(this.program.made, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, bytes(text), gl.STATIC_DRAW);
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, width, gl.FLOAT, false, 0, 0);
    }
    const corners = bytes(faces);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, image);
    gl.generateMipmap(gl.TEXTURE_2D);
    return { array, texture, count: corners.length / 4 };
  }

  /** Called once for each frame of the screen. */
  draw(camera) {
    const { gl, canvas, program: { made, uniforms } } = this;
    const key = [...camera.view, ...camera.slopes, canvas.width, canvas.height].join();
    if (key === this.drawn) return;
    this.drawn = key;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(made);
    gl.uniformMatrix4fv(uniforms.view, false, camera.view);
    gl.uniform2fv(uniforms.slopes, camera.slopes);
    gl.uniform1f(uniforms.near, this.near);
    for (const { array, texture, count } of this.meshes) {
      gl.bindVertexArray(array);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_INT, 0);
    }
  }
}
