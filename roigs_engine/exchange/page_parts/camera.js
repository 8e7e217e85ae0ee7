"use strict";
// A camera that turns around a point, and the hands that move it.

const ELEVATION = 1.55; // radians that it goes up and down

const add = (a, b, factor = 1) => a.map((value, k) => value + factor * b[k]);
const dot = (a, b) => a.reduce((sum, value, k) => sum + value * b[k], 0);

class Orbit {
  constructor(field) {
    this.field = field; // degrees, of the window's height
    this.size = [1, 1];
    this.limits = [0, Infinity];
  }

  /** Zooming ends within the nearest of places by a factor, and outside the farthest. */
  limit(places, factor) {
    const away = places.map(({ position, target }) => Math.hypot(...add(position, target, -1)));
    this.limits = [Math.min(...away) / factor, Math.max(...away) * factor];
  }

  /** Look at `target` from `position`; y is up. */
  look(position, target) {
    const away = add(position, target, -1);
    this.target = target;
    this.distance = Math.hypot(...away);
    this.around = Math.atan2(away[0], away[2]);
    this.above = Math.asin(Math.max(-1, Math.min(1, away[1] / this.distance)));
  }

  turn(around, above) {
    this.around += around;
    this.above = Math.max(-ELEVATION, Math.min(ELEVATION, this.above + above));
  }

  zoom(factor) {
    const [least, most] = this.limits;
    this.distance = Math.max(least, Math.min(most, this.distance * factor));
  }

  /** Moves what is looked at with the hand, by pixels of the window. */
  pan(x, y) {
    const unit = 2 * this.distance * Math.tan(this.field * Math.PI / 360) / this.size[1];
    const [right, up] = this.axes();
    this.target = add(add(this.target, right, -x * unit), up, y * unit);
  }

  /** Right, up and backwards. */
  axes() {
    const [sa, ca] = [Math.sin(this.around), Math.cos(this.around)];
    const [se, ce] = [Math.sin(this.above), Math.cos(this.above)];
    return [[ca, 0, -sa], [-sa * se, ce, -ca * se], [sa * ce, se, ca * ce]];
  }

  get position() {
    return add(this.target, this.axes()[2], this.distance);
  }

  /** What the renderer needs: the view matrix by columns, the eye, half the field in x and y. */
  get camera() {
    const axes = this.axes();
    const eye = this.position;
    const view = [0, 1, 2].flatMap((k) => [...axes.map((axis) => axis[k]), 0]);
    const half = Math.tan(this.field * Math.PI / 360);
    return {
      view: [...view, ...axes.map((axis) => -dot(axis, eye)), 1],
      eye,
      slopes: [half * this.size[0] / this.size[1], half],
    };
  }
}

/** Mouse, fingers and keys move the camera; `moved` is called after each move. */
function handle(element, orbit, moved) {
  const fingers = new Map();
  const spread = () => {
    const [a, b] = [...fingers.values()];
    return { at: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2], wide: Math.hypot(a[0] - b[0], a[1] - b[1]) };
  };
  element.addEventListener("pointerdown", (event) => {
    element.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    moved();
  });
  element.addEventListener("pointermove", (event) => {
    const before = fingers.get(event.pointerId);
    if (!before || fingers.size > 2) return;
    const now = [event.clientX, event.clientY];
    const [x, y] = add(now, before, -1);
    if (fingers.size === 2) {
      const first = spread();
      fingers.set(event.pointerId, now);
      const then = spread();
      orbit.zoom(Math.max(1, first.wide) / Math.max(1, then.wide));
      orbit.pan(...add(then.at, first.at, -1));
    } else if (event.buttons & 6 || event.shiftKey || event.ctrlKey) {
      orbit.pan(x, y);
    } else {
      orbit.turn(-x * Math.PI / orbit.size[1], y * Math.PI / orbit.size[1]);
    }
    fingers.set(event.pointerId, now);
    moved();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    element.addEventListener(name, (event) => fingers.delete(event.pointerId));
  }
  element.addEventListener("contextmenu", (event) => event.preventDefault());
  element.addEventListener("wheel", (event) => {
    event.preventDefault();
    const lines = [1, 33, 800][event.deltaMode];
    orbit.zoom(Math.exp(Math.max(-300, Math.min(300, event.deltaY * lines)) / 600));
    moved();
  }, { passive: false });
  const keys = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    if (event.key in keys) {
      const [x, y] = keys[event.key];
      if (event.shiftKey) orbit.pan(-40 * x, 40 * y);
      else orbit.turn(x * 0.1, y * 0.1);
    } else if (event.key === "+" || event.key === "=") {
      orbit.zoom(0.9);
    } else if (event.key === "-") {
      orbit.zoom(1 / 0.9);
    } else {
      return;
    }
    event.preventDefault();
    moved();
  });
}
