"use strict";
(() => {
  const FLIGHT = 900; // milliseconds
  const C0 = 0.28209479177387814; // SH of degree 0
  const element = (id) => document.getElementById(id);
  const page = JSON.parse(element("page").textContent);

  function say(text) {
    element("message").textContent = text;
  }

  /** The unpacked bytes of the SPZ file in a script element, which is then freed. */
  async function unpacked(id) {
    const holder = element(id);
    const text = atob(holder.textContent);
    holder.remove();
    const packed = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) packed[i] = text.charCodeAt(i);
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  /** Rotation as w, x, y, z from the three smaller components and the index of the largest. */
  function rotation(bits) {
    const xyzw = [0, 0, 0, 0];
    const largest = bits >>> 30;
    let squares = 0;
    for (let i = 3; i >= 0; i--) {
      if (i === largest) continue;
      const value = ((bits & 511) / 511) * Math.SQRT1_2;
      xyzw[i] = bits & 512 ? -value : value;
      squares += value * value;
      bits >>>= 10;
    }
    xyzw[largest] = Math.sqrt(Math.max(0, 1 - squares));
    return [xyzw[3], xyzw[0], xyzw[1], xyzw[2]];
  }

  /** Gaussians of SPZ version 3 in the viewer's form. */
  function gaussians(bytes) {
    const head = new DataView(bytes.buffer, bytes.byteOffset);
    const count = head.getUint32(8, true);
    const degree = Math.min(2, bytes[12]);
    const bands = [0, 3, 8, 15][bytes[12]];
    const unit = 2 ** -bytes[13];
    const starts = [16];
    for (const width of [9, 1, 3, 3, 4]) starts.push(starts.at(-1) + width * count);
    const [means, alphas, colours, scales, turns, sh] = starts;
    const fixed = (at) =>
      ((bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16)) << 8 >> 8) * unit;
    const splats = new Array(count);
    for (let i = 0; i < count; i++) {
      const splat = [0, 1, 2].map((k) => fixed(means + 9 * i + 3 * k));
      for (let k = 0; k < 3; k++) splat.push(Math.exp(bytes[scales + 3 * i + k] / 16 - 10));
      splat.push(...rotation(head.getUint32(turns + 4 * i, true)));
      for (let k = 0; k < 3; k++) {
        const colour = ((bytes[colours + 3 * i + k] / 255 - 0.5) / 0.15) * C0 + 0.5;
        splat.push(Math.min(255, Math.max(0, Math.round(255 * colour))));
      }
      splat.push(bytes[alphas + i]);
      // The viewer has each degree on its own, and in it the coefficients of one channel together.
      for (const [first, end] of [[0, 3], [3, 8]].slice(0, degree)) {
        for (let channel = 0; channel < 3; channel++) {
          for (let k = first; k < end; k++) {
            splat.push((bytes[sh + 3 * (bands * i + k) + channel] - 128) / 128);
          }
        }
      }
      splats[i] = splat;
    }
    const components = 14 + 3 * [0, 3, 8][degree];
    return { sphericalHarmonicsDegree: degree, componentCount: components, splatCount: count, splats };
  }

  /** Places are made for a window that is as wide as high; a narrow one needs more distance. */
  function position(place) {
    const wide = Math.min(1, innerWidth / innerHeight);
    return place.position.map((value, k) => place.target[k] + (value - place.target[k]) / wide);
  }

  let flight = 0;
  function fly(viewer, place) {
    const from = [viewer.camera.position.toArray(), viewer.controls.target.toArray()];
    const to = [position(place), place.target];
    const begin = performance.now();
    const mine = ++flight;
    const step = (now) => {
      if (mine !== flight) return;
      const t = Math.min(1, Math.max(0, (now - begin) / FLIGHT));
      const part = t * t * (3 - 2 * t);
      const [at, target] = from.map((a, k) => a.map((value, i) => value + (to[k][i] - value) * part));
      viewer.camera.position.fromArray(at);
      viewer.controls.target.fromArray(target);
      if (t < 1) requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  function button(parent, text, action) {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.addEventListener("click", action);
    element(parent).append(made);
    return made;
  }

  function show(viewer, name) {
    page.models.forEach((model, k) => { viewer.getSplatScene(k).visible = model === name; });
    for (const each of element("models").children) {
      each.setAttribute("aria-pressed", String(each.textContent === name));
    }
    viewer.forceRenderNextFrame();
  }

  async function start() {
    if (!document.createElement("canvas").getContext("webgl2")) {
      throw new Error("This browser has no WebGL 2. Open the page in another browser.");
    }
    const first = page.places[Math.min(1, page.places.length - 1)]; // a box, if there is one
    const several = page.models.length > 1;
    const viewer = new Splats.Viewer({
      rootElement: element("view"),
      initialCameraPosition: position(first),
      initialCameraLookAt: first.target,
      sharedMemoryForWorkers: false, // needs a server's headers, which a file does not have
      integerBasedSort: false, // steps of a thousandth are coarse in a small scene
      sphericalHarmonicsDegree: page.degree,
      enableOptionalEffects: several,
      maxScreenSpaceSplatSize: 4096,
      renderMode: 1, // when something changed
      sceneRevealMode: 2, // at once
    });
    removeEventListener("keydown", viewer.keyDownListener); // keys for debugging
    viewer.camera.near = page.near;
    viewer.camera.far = page.far;
    viewer.camera.updateProjectionMatrix();
    const generator = Splats.SplatBufferGenerator.getStandardGenerator(1, 0);
    const buffers = [];
    for (const name of page.models) {
      buffers.push(generator.generateFromUncompressedSplatArray(gaussians(await unpacked(name))));
    }
    await viewer.addSplatBuffers(buffers, buffers.map(() => ({})), true, false, false);
    viewer.start();
    addEventListener("pointerdown", (event) => {
      if (event.target.tagName === "CANVAS") flight++; // the hand wins
    }, true);
    for (const place of page.places) button("places", place.name, () => fly(viewer, place));
    if (several) {
      for (const name of page.models) button("models", name, () => show(viewer, name));
      show(viewer, page.models.at(-1));
    }
    say("");
    return viewer;
  }

  window.ready = start();
  window.ready.catch((error) => say(error.message));
})();
