"use strict";
// Unpacks an SPZ file (version 3) for the textures of the renderer, then sorts for it.

const WIDTH = 4096; // of the textures, as in renderer.js
const REACH = 3.4; // standard deviations at which any Gaussian is below 1/255
const MARGIN = 1.3; // around the view: what a turn shows before the next order comes
const SH_NUMBERS = [0, 3, 8, 15];

let count, means, reach, weight; // of each Gaussian
let keys, weights, found, other; // room for sorting
const low = new Uint32Array(65536);
const high = new Uint32Array(65536);

async function unpacked(text) {
  const raw = atob(text);
  const packed = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) packed[i] = raw.charCodeAt(i);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function rows(texels) {
  return Math.max(1, Math.ceil(texels / WIDTH));
}

/** Textures: centre and colour; size and rotation; SH, one coefficient in each number. */
function load(bytes) {
  const head = new DataView(bytes.buffer, bytes.byteOffset);
  count = head.getUint32(8, true);
  const degree = bytes[12];
  const unit = 2 ** -bytes[13];
  const antialiased = (bytes[14] & 1) !== 0; // SPZ's flag
  const starts = [16];
  for (const width of [9, 1, 3, 3, 4]) starts.push(starts.at(-1) + width * count);
  const [places, alphas, colours, scales, turns, sh] = starts;
  means = new Float32Array(3 * count);
  reach = new Float32Array(count);
  weight = new Float32Array(count);
  const centres = new Uint32Array(4 * WIDTH * rows(count));
  const floats = new Float32Array(centres.buffer);
  const shapes = new Uint32Array(2 * WIDTH * rows(count));
  const three = (at) => bytes[at] | (bytes[at + 1] << 8) | (bytes[at + 2] << 16);
  const size = Float32Array.from({ length: 256 }, (_, k) => Math.exp(k / 16 - 10));
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < 3; k++) {
      floats[4 * i + k] = means[3 * i + k] = (three(places + 9 * i + 3 * k) << 8 >> 8) * unit;
    }
    centres[4 * i + 3] = three(colours + 3 * i) | (bytes[alphas + i] << 24);
    shapes[2 * i] = three(scales + 3 * i);
    shapes[2 * i + 1] = head.getUint32(turns + 4 * i, true);
    const [a, b, c] = [0, 1, 2].map((k) => size[bytes[scales + 3 * i + k]]);
    reach[i] = REACH * Math.max(a, b, c);
    weight[i] = bytes[alphas + i] * a * b * c / Math.min(a, b, c);
  }
  const numbers = SH_NUMBERS[degree];
  const each = [0, 1, 2, 4][degree]; // texels
  const harmonics = new Uint32Array(each ? 4 * WIDTH * rows(each * count) : 0);
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < numbers; k++) {
      harmonics[4 * each * i + k] = three(sh + 3 * (numbers * i + k));
    }
  }
  [keys, weights, found, other] = [0, 1, 2, 3].map(() => new Uint32Array(count));
  return { count, degree, antialiased, centres, shapes, harmonics };
}

/** The Gaussians in view, the farthest first; of more than `most`, those that show most. */
function sorted({ view, slopes, near, most }) {
  const depths = new Float32Array(keys.buffer);
  const shown = new Float32Array(weights.buffer);
  const [x, y, z] = [0, 1, 2].map((row) => [0, 4, 8, 12].map((column) => view[column + row]));
  const edges = slopes.map((slope) => MARGIN * slope);
  const lengths = edges.map((edge) => Math.hypot(1, edge));
  let n = 0;
  for (let i = 0; i < count; i++) {
    const [a, b, c] = [means[3 * i], means[3 * i + 1], means[3 * i + 2]];
    const depth = -(z[0] * a + z[1] * b + z[2] * c + z[3]);
    if (depth <= near) continue;
    const across = Math.abs(x[0] * a + x[1] * b + x[2] * c + x[3]);
    if (across - edges[0] * depth > lengths[0] * reach[i]) continue;
    const up = Math.abs(y[0] * a + y[1] * b + y[2] * c + y[3]);
    if (up - edges[1] * depth > lengths[1] * reach[i]) continue;
    depths[i] = depth;
    shown[i] = weight[i] / (depth * depth);
    found[n++] = i;
  }
  if (n > most) n = pruned(n, most);
  return byDepth(n);
}

/** Keeps those of the largest weight, by the upper half of the numbers' bits. */
function pruned(n, most) {
  low.fill(0);
  for (let i = 0; i < n; i++) low[weights[found[i]] >>> 16]++;
  let least = 65536;
  for (let left = most; least > 0 && left >= low[least - 1]; least--) left -= low[least - 1];
  let kept = 0;
  for (let i = 0; i < n; i++) {
    if (weights[found[i]] >>> 16 >= least) found[kept++] = found[i];
  }
  return kept;
}

/** A radix sort by the bits of the depths, which are positive. */
function byDepth(n) {
  low.fill(0);
  high.fill(0);
  for (let i = 0; i < n; i++) {
    const key = ~keys[found[i]];
    low[key & 65535]++;
    high[key >>> 16]++;
  }
  for (let i = 0, a = 0, b = 0; i < 65536; i++) {
    [low[i], a] = [a, a + low[i]];
    [high[i], b] = [b, b + high[i]];
  }
  for (let i = 0; i < n; i++) other[low[~keys[found[i]] & 65535]++] = found[i];
  const order = new Uint32Array(n);
  for (let i = 0; i < n; i++) order[high[~keys[other[i]] >>> 16]++] = other[i];
  return order;
}

onmessage = async ({ data }) => {
  if (data.text === undefined) {
    const order = sorted(data);
    postMessage({ order, most: data.most }, [order.buffer]);
    return;
  }
  try {
    const made = load(await unpacked(data.text));
    postMessage(made, [made.centres.buffer, made.shapes.buffer, made.harmonics.buffer]);
  } catch (error) {
    postMessage({ error: `The model in this page is damaged (${error.message}).` });
  }
};
