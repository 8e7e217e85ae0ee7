"use strict";
// The page: loads the models, and connects buttons, hands and window with the renderer.
(() => {
  const FLIGHT = 900; // milliseconds
  const ZOOM = 6; // times nearer than the nearest place, and farther than the farthest
  const MOST_DENSITY = 2; // canvas pixels for a pixel of the page, at most
  const element = (id) => document.getElementById(id);
  const page = JSON.parse(element("page").textContent);
  const canvas = element("view");
  const orbit = new Orbit(page.field);
  const models = {}; // name -> promise
  const MESH = "Mesh"; // of the choice, and of the element with the meshes
  const meshCanvas = element("mesh-view");
  let renderer, meshes = null, flight = null, wanted = null;

  function say(text) {
    element("message").textContent = text;
  }

  /** Places are made for a window that is as wide as high; a narrow one needs more distance. */
  function position(place) {
    const wide = Math.min(1, innerWidth / innerHeight);
    return place.position.map((value, k) => place.target[k] + (value - place.target[k]) / wide);
  }

  function fly(place) {
    const from = [orbit.position, orbit.target];
    const to = [position(place), place.target];
    flight = { from, to, begin: performance.now() };
  }

  function step(now) {
    const { from, to, begin } = flight;
    const t = Math.min(1, Math.max(0, (now - begin) / FLIGHT));
    const part = t * t * (3 - 2 * t);
    orbit.look(...from.map((a, k) => add(a, add(to[k], a, -1), part)));
    if (t === 1) flight = null;
    renderer.move();
  }

  function button(parent, text, action) {
    const made = document.createElement("button");
    made.type = "button";
    made.textContent = text;
    made.addEventListener("click", action);
    element(parent).append(made);
  }

  /** A model is unpacked when it is shown for the first time. */
  async function show(name) {
    wanted = name;
    for (const each of element("models").children) {
      each.setAttribute("aria-pressed", String(each.textContent === name));
    }
    if (name === MESH) {
      models[name] ??= loadMeshes();
      await models[name];
    }
    meshCanvas.hidden = wanted !== MESH;
    if (name === MESH) return;
    if (!models[name]) {
      say(`Loading ${page.counts[name].toLocaleString("en")} Gaussians …`);
      const holder = element(name);
      models[name] = renderer.load(holder.textContent, element("worker").textContent);
      holder.remove();
    }
    const model = await models[name];
    if (wanted !== name) return;
    renderer.show(model);
    say("");
  }

  async function loadMeshes() {
    meshes = new MeshView(meshCanvas, renderer);
    const holder = element(MESH);
    await meshes.load(holder.textContent);
    holder.remove();
  }

  function resize() {
    const density = Math.min(MOST_DENSITY, devicePixelRatio);
    orbit.size = [innerWidth, innerHeight];
    canvas.width = Math.max(1, Math.round(innerWidth * density));
    canvas.height = Math.max(1, Math.round(innerHeight * density));
    [meshCanvas.width, meshCanvas.height] = [canvas.width, canvas.height];
    renderer.move();
  }

  async function start() {
    renderer = new Renderer(canvas, page.rules);
    const first = page.places[Math.min(1, page.places.length - 1)]; // a box, if there is one
    orbit.look(position(first), first.target);
    orbit.limit(page.places, ZOOM);
    resize();
    addEventListener("resize", resize);
    canvas.addEventListener("webglcontextlost", () => {
      say("The browser stopped the 3D view. Load the page again.");
    });
    handle(canvas, orbit, () => {
      flight = null; // the hand wins
      renderer.move();
    });
    for (const place of page.places) button("places", place.name, () => fly(place));
    const choose = (name) => show(name).catch((error) => say(error.message));
    const choices = page.meshes ? [...page.models, MESH] : page.models;
    if (choices.length > 1) {
      for (const name of choices) button("models", name, () => choose(name));
    }
    await show(page.models.at(-1));
    const frame = (now) => {
      if (flight) step(now);
      if (meshCanvas.hidden) renderer.tick(orbit.camera, now);
      else meshes.draw(orbit.camera);
      requestAnimationFrame(frame);
    };
    requestAnimationFrame(frame);
    return { orbit, renderer };
  }

  window.ready = start();
  window.ready.catch((error) => say(error.message));
})();
