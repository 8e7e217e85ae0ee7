"use strict";
// Draws one model with WebGL 2. While the view moves, it draws as many Gaussians in as many pixels
// as the computer manages in FRAME milliseconds; once it is still, all of them in all pixels, in
// parts, so that the page answers meanwhile.

const WIDTH = 4096; // of the model's textures
const PROJECTED = 1024; // of those of the projected Gaussians
const BATCH = 1024; // Gaussians drawn as one instance: an instance for each would take far longer
const FRAME = 33; // milliseconds
const PART = 40;
const STILL = 150; // milliseconds after the last move
const LEAST = 1 / 128; // of the work of a whole picture
const COARSEST = 1 / 4; // of the width in pixels
const FEWEST = 6000; // Gaussians

class Renderer {
  constructor(canvas, rules) {
    const options = { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" };
    this.gl = canvas.getContext("webgl2", options);
    if (!this.gl) throw new Error("This browser has no WebGL 2. Open the page in another browser.");
    this.canvas = canvas;
    this.rules = rules;
    this.near = rules.near;
    this.share = 1 / 8; // of the work of a whole picture that is done while the view moves
    this.rested = 0; // when the worker may sort again: not all the time
    this.part = 1 << 15; // Gaussians drawn at once, once it is still
    this.moved = -Infinity; // when
    this.frames = []; // when the last pictures of a moving view were begun
    this.settling = [];
    this.programs = {}; // by kind of model
    const gl = this.gl;
    this.target = this.layer(gl.RGBA8, 1, 1);
    this.triangle = this.corners([0, 1, 2]);
    this.squares = this.corners(
      Array.from({ length: 6 * BATCH }, (_, k) => 4 * Math.floor(k / 6) + [0, 1, 2, 2, 1, 3][k % 6]));
  }

  /** A texture; its values are given or filled in later. */
  texture(format, width, height, values = null) {
    const gl = this.gl;
    const made = gl.createTexture();
    const kinds = { [gl.RGBA32UI]: gl.RGBA_INTEGER, [gl.RG32UI]: gl.RG_INTEGER, [gl.R32UI]: gl.RED_INTEGER };
    gl.bindTexture(gl.TEXTURE_2D, made);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
    if (values) {
      gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, height, kinds[format], gl.UNSIGNED_INT, values);
    }
    return made;
  }

  /** A framebuffer to draw into. */
  layer(format, width, height) {
    const gl = this.gl;
    const made = { width, height, texture: this.texture(format, width, height) };
    made.buffer = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, made.buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, made.texture, 0);
    return made;
  }

  program([vertex, fragment]) {
    const gl = this.gl;
    const made = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(made, shader);
    }
    gl.linkProgram(made);
    if (!gl.getProgramParameter(made, gl.LINK_STATUS) && !gl.isContextLost()) {
      const logs = gl.getAttachedShaders(made).map((shader) => gl.getShaderInfoLog(shader));
      throw new Error(`This browser's WebGL does not run the viewer (${logs.join(" ")}).`);
    }
    const uniforms = {};
    const count = gl.getProgramParameter(made, gl.ACTIVE_UNIFORMS);
    for (let i = 0; i < count; i++) {
      const { name } = gl.getActiveUniform(made, i);
      uniforms[name] = gl.getUniformLocation(made, name);
    }
    return { made, uniforms };
  }

  /** The packed text of a model -> the model, on the graphics card. */
  load(text, source) {
    return new Promise((resolve, reject) => {
      const worker = new Worker(URL.createObjectURL(new Blob([source])));
      worker.onerror = (event) => reject(new Error(event.message));
      worker.onmessage = ({ data }) => {
        try {
          if (data.error) throw new Error(data.error);
          resolve(this.uploaded(data, worker));
        } catch (error) {
          reject(error);
        }
      };
      worker.postMessage({ text });
    });
  }

  uploaded({ count, degree, antialiased, centres, shapes, harmonics }, worker) {
    const gl = this.gl;
    if (Math.max(WIDTH, harmonics.length / 4 / WIDTH) > gl.getParameter(gl.MAX_TEXTURE_SIZE)) {
      throw new Error("The model is too large for this browser.");
    }
    const height = (values, width) => Math.max(1, values.length / width / WIDTH);
    const rows = Math.ceil(count / PROJECTED);
    const model = {
      count, worker, kind: `${degree} ${antialiased}`, drawn: 0, asked: false, ordered: null,
      centres: this.texture(gl.RGBA32UI, WIDTH, height(centres, 4), centres),
      shapes: this.texture(gl.RG32UI, WIDTH, height(shapes, 2), shapes),
      harmonics: harmonics.length
        ? this.texture(gl.RGBA32UI, WIDTH, height(harmonics, 4), harmonics) : null,
      order: this.texture(gl.R32UI, PROJECTED, rows),
      projected: this.layer(gl.RGBA32UI, PROJECTED, rows),
      looks: this.texture(gl.RG32UI, PROJECTED, rows),
    };
    gl.bindFramebuffer(gl.FRAMEBUFFER, model.projected.buffer);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT1, gl.TEXTURE_2D, model.looks, 0);
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
    worker.onmessage = ({ data }) => this.take(model, data);
    const { project, draw } = shaders({ degree, antialiased }, this.rules);
    this.programs[model.kind] ??= { project: this.program(project), draw: this.program(draw) };
    return model;
  }

  show(model) {
    this.model = model;
    this.move();
  }

  /** The view has changed, or the window. */
  move() {
    this.moved = performance.now();
    this.whole = null;
    this.stale = true;
  }

  /** Resolves when a whole picture of a still view is shown. */
  settled() {
    return new Promise((resolve) => this.settling.push(resolve));
  }

  /** An order of the Gaussians from the worker. */
  take(model, { order, most }) {
    const gl = this.gl;
    const rows = Math.ceil(order.length / PROJECTED);
    const padded = new Uint32Array(rows * PROJECTED);
    padded.set(order);
    gl.bindTexture(gl.TEXTURE_2D, model.order);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, PROJECTED, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, padded);
    model.drawn = order.length;
    model.all = most >= model.count;
    model.ordered = model.asked;
    model.asked = null;
    const now = performance.now();
    this.rested = now + 3 * (now - model.since);
    this.stale = true;
  }

  /** Ask for an order if the one there is of another view. */
  ask(camera, most) {
    const model = this.model;
    if (model.asked) return;
    const key = [...camera.view, ...camera.slopes, Math.round(most)].join();
    if (model.ordered === key) return;
    model.asked = key;
    model.since = performance.now();
    const { view, slopes } = camera;
    model.worker.postMessage({ view, slopes, near: this.near, most });
  }

  /** Whether the card still works on what it was given; measures it. */
  busy() {
    if (!this.fence) return false;
    const gl = this.gl;
    if (gl.getSyncParameter(this.fence.sync, gl.SYNC_STATUS) === gl.UNSIGNALED) return true;
    gl.deleteSync(this.fence.sync);
    this.fence.done(performance.now() - this.fence.start);
    this.fence = null;
    return false;
  }

  guard(done) {
    const gl = this.gl;
    this.fence = { sync: gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0), start: performance.now(), done };
    gl.flush();
  }

  /** Called once for each frame of the screen. */
  tick(camera, now) {
    if (!this.model || this.gl.isContextLost() || this.busy()) return;
    if (now - this.moved < STILL) {
      const most = Math.max(FEWEST, Math.min(1, 2 * this.share) * this.model.count);
      if (now > this.rested) this.ask(camera, most);
      if (this.stale) this.quick(camera, now);
    } else if (!this.whole) {
      this.ask(camera, this.model.count);
      if (!this.model.asked && this.model.all) this.begin(camera);
    } else if (!this.whole.done) {
      this.proceed();
    }
  }

  /** A picture of a moving view. */
  quick(camera, now) {
    const scale = Math.max(COARSEST, Math.sqrt(Math.min(1, 2 * this.share)));
    const { width, height } = this.canvas;
    this.project(camera, Math.ceil(width * scale), Math.ceil(height * scale));
    this.draw(0, this.model.drawn);
    this.present();
    this.stale = false;
    this.frames = [...this.frames.slice(-99), now];
    this.guard((took) => {
      const factor = Math.min(1.15, Math.max(0.8, FRAME / took));
      this.share = Math.min(1, Math.max(LEAST, this.share * factor));
    });
  }

  begin(camera) {
    this.project(camera, this.canvas.width, this.canvas.height);
    this.whole = { next: 0, done: false };
    this.guard(() => {});
  }

  proceed() {
    const { next } = this.whole;
    this.draw(next, Math.min(this.part, this.model.drawn - next));
    this.whole.next = next + this.part;
    if (this.whole.next >= this.model.drawn) {
      this.present();
      this.whole.done = true;
      this.stale = false;
      this.settling.splice(0).forEach((resolve) => resolve());
    }
    this.guard((took) => {
      const factor = Math.min(2, Math.max(0.5, PART / took));
      this.part = Math.max(1024, Math.min(1 << 22, Math.round(this.part * factor)));
    });
  }

  project(camera, width, height) {
    const { gl, model } = this;
    if (this.target.width < width || this.target.height < height) {
      gl.deleteFramebuffer(this.target.buffer);
      gl.deleteTexture(this.target.texture);
      this.target = this.layer(gl.RGBA8, this.canvas.width, this.canvas.height);
    }
    this.size = [width, height];
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.buffer);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!model.drawn) return;
    const { made, uniforms } = this.programs[model.kind].project;
    gl.useProgram(made);
    gl.bindFramebuffer(gl.FRAMEBUFFER, model.projected.buffer);
    gl.viewport(0, 0, PROJECTED, Math.ceil(model.drawn / PROJECTED));
    gl.disable(gl.BLEND);
    gl.bindVertexArray(this.triangle);
    this.bind(uniforms, { order: model.order, centres: model.centres, shapes: model.shapes,
      harmonics: model.harmonics });
    gl.uniformMatrix4fv(uniforms.view, false, camera.view);
    gl.uniform3fv(uniforms.eye, camera.eye);
    gl.uniform2fv(uniforms.focal, camera.slopes.map((slope, k) => this.size[k] / 2 / slope));
    gl.uniform2fv(uniforms.size, this.size);
    gl.uniform1f(uniforms.near, this.near);
    gl.drawElements(gl.TRIANGLES, 3, gl.UNSIGNED_SHORT, 0);
  }

  /** One triangle over everything, or the corners of a batch of squares. */
  corners(indices) {
    const gl = this.gl;
    const made = gl.createVertexArray();
    gl.bindVertexArray(made);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(indices), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    return made;
  }

  bind(uniforms, textures) {
    const gl = this.gl;
    Object.entries(textures).forEach(([name, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
      if (uniforms[name]) gl.uniform1i(uniforms[name], unit);
    });
    gl.activeTexture(gl.TEXTURE8);
  }

  draw(first, count) {
    const { gl, model } = this;
    if (count <= 0) return;
    const { made, uniforms } = this.programs[model.kind].draw;
    gl.useProgram(made);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.buffer);
    gl.viewport(0, 0, ...this.size);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.bind(uniforms, { places: model.projected.texture, looks: model.looks });
    gl.uniform2fv(uniforms.size, this.size);
    gl.uniform2i(uniforms.range, first, first + count);
    gl.bindVertexArray(this.squares);
    gl.drawElementsInstanced(gl.TRIANGLES, 6 * BATCH, gl.UNSIGNED_SHORT, 0, Math.ceil(count / BATCH));
  }

  /** What was drawn, on the page. */
  present() {
    const gl = this.gl;
    const { width, height } = this.canvas;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, this.target.buffer);
    gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
    const filter = this.size[0] === width ? gl.NEAREST : gl.LINEAR;
    gl.blitFramebuffer(0, 0, ...this.size, 0, 0, width, height, gl.COLOR_BUFFER_BIT, filter);
  }
}
