// The avatar in a page: load, setPose or setMotion, render.
import { FileSource, arraysOf } from "./data.js";
import { Coefficients, Skeleton, matricesFromAxisAngle } from "./pose.js";
import { Motion } from "./motion.js";
import { Sorter } from "./sorter.js";
import { Splats } from "./splats.js";

const VERSION = 2; // of the data, as web/web_data.py writes it
const SAMPLED = 400; // points for framing

// An avatar from the address of an `avatar.bin`, or from a source of data.js. canvas: to draw into, or gl: a WebGL2
// context of your own. progress: called with {loaded, count} as Gaussians arrive. Resolves once the first of them can
// be drawn; `avatar.complete` resolves when all can.
export async function load(source, options = {}) {
  const from = typeof source === "string" || source instanceof URL ? FileSource.from(source) : source;
  const header = await from.header;
  if (header.version !== VERSION) throw new Error(`this avatar is of version ${header.version}, and this player reads ${VERSION}: take both from one export`);
  const avatar = new Avatar(header, from, options);
  await avatar.start();
  return avatar;
}

export class Avatar {
  constructor(header, source, { canvas = null, gl = null, progress = () => {} }) {
    this.header = header;
    this.source = source;
    this.name = header.name;
    this.progress = progress;
    this.canvas = canvas;
    this.gl = gl ?? canvas.getContext("webgl2", { alpha: true, antialias: false, premultipliedAlpha: true });
    if (!this.gl) throw new Error("this browser has no WebGL2, or it is switched off");
    this.own = !gl; // whether the whole target is ours to clear
    this.skeleton = new Skeleton(header.joints);
    this.coefficients = null;
    this.motions = new Map();
    this.motion = null;
    this.loaded = 0;
    this.limit = header.points.count;
    this.onsorted = () => {};
    this.milliseconds = { pose: 0, sort: 0, draw: 0 };
    this.ticket = 0;
    this.sorted = 0;
    this.sorter = new Sorter((result) => this.arranged(result));
    this.transforms = null;
    this.setPose(header.relaxed);
    if (canvas) {
      canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
      canvas.addEventListener("webglcontextrestored", () => this.restored());
    }
  }

  get count() { return this.header.points.count; }

  async start() {
    const { header } = this;
    if (header.look) {
      header.look.arrays = arraysOf(await this.source.block(header.look.block), header.look.layout);
      this.coefficients = new Coefficients(header.look.arrays);
    }
    this.splats = new Splats(this.gl, header);
    this.chunks = [];
    const [first, ...others] = header.points.chunks;
    await this.addChunk(first);
    this.complete = this.rest(others);
    this.complete.catch((error) => { this.error = error; this.progress({ loaded: this.loaded, count: this.count, error }); });
  }

  async rest(chunks) {
    for (const chunk of chunks) await this.addChunk(chunk);
    return this;
  }

  async addChunk(entry) {
    const { at, ...arrays } = arraysOf(await this.source.block(entry.block), entry.layout);
    const chunk = { start: entry.start, padded: entry.padded };
    for (const name in arrays) chunk[name] = unpacked(arrays[name], at, entry.padded, name === "part" ? 1 : 4);
    this.chunks.push(chunk);
    this.splats.add(chunk);
    const { low, span, slots } = this.header.points;
    const points = new Float32Array(3 * entry.count);
    for (let i = 0; i < entry.count; i++) {
      for (let a = 0; a < 3; a++) points[3 * i + a] = low[a] + (span[a] * chunk.place[4 * i + a]) / 65535;
    }
    const joints = interleaved(chunk.joints, entry.count, entry.padded, slots);
    const weights = interleaved(chunk.weights, entry.count, entry.padded, slots);
    if (!this.samples) this.takeSamples(points, joints, weights, entry.count, slots);
    this.sorter.add(entry.start, points, joints, weights, slots);
    this.loaded = entry.start + entry.count;
    this.progress({ loaded: this.loaded, count: this.count });
    this.onsorted();
  }

  // A sample of the points for framing, and of each joint the mean of what it carries, for the mean depth.
  takeSamples(points, joints, weights, count, slots) {
    this.samples = [];
    const step = Math.max(1, Math.floor(count / SAMPLED));
    this.moments = new Float64Array(4 * this.skeleton.count);
    let taken = 0;
    for (let i = 0; i < count; i += step, taken++) {
      const point = points.subarray(3 * i, 3 * i + 3);
      const held = [];
      for (let k = slots * i; k < slots * (i + 1); k++) {
        if (!weights[k]) continue;
        const w = weights[k] / 255, m = 4 * joints[k];
        held.push([joints[k], w]);
        for (let a = 0; a < 3; a++) this.moments[m + a] += w * point[a];
        this.moments[m + 3] += w;
      }
      this.samples.push([point, held]);
    }
    this.moments = this.moments.map((v) => v / taken);
  }

  // World places of the sample in a pose: [[x, y, z], ...].
  sample(pose, trans) {
    const A = this.skeleton.transforms(matricesFromAxisAngle(pose), trans);
    return this.samples.map(([p, held]) => [0, 1, 2].map((r) => held.reduce((sum, [j, w]) => {
      const at = 12 * j + 4 * r;
      return sum + w * (A[at] * p[0] + A[at + 1] * p[1] + A[at + 2] * p[2] + A[at + 3]);
    }, 0)));
  }

  // pose: 3 J axis-angle numbers relative to the parent joint, radians. trans: 3, metres.
  setPose(pose, trans = [0, 0, 0]) {
    if (pose.length !== 3 * this.skeleton.count) {
      throw new Error(`a pose of this avatar has ${3 * this.skeleton.count} numbers, and ${pose.length} were given`);
    }
    const begun = performance.now();
    const local = matricesFromAxisAngle(pose);
    this.transforms = this.skeleton.transforms(local, trans);
    this.weights = this.coefficients ? this.coefficients.of(local, this.skeleton.world) : null;
    this.posed = false;
    this.milliseconds.pose = performance.now() - begun;
  }

  // motion: a name of `motionNames`, or a Motion. Resolves when it can be played.
  async setMotion(motion) {
    this.motion = motion instanceof Motion ? motion : await this.readMotion(motion);
    return this.motion;
  }

  get motionNames() { return this.header.motions.map((motion) => motion.name); }

  async readMotion(name) {
    const entry = this.header.motions.find((motion) => motion.name === name);
    if (!entry) throw new Error(`no motion '${name}': choose from ${this.motionNames.join(", ")}`);
    if (!this.motions.has(name)) {
      const arrays = arraysOf(await this.source.block(entry.block), entry.layout);
      this.motions.set(name, new Motion({ ...entry, ...arrays, joints: this.skeleton.count }));
    }
    return this.motions.get(name);
  }

  // Take the pose of the motion at a time in seconds.
  setTime(time) {
    const { pose, trans } = this.motion.at(time);
    this.setPose(pose, trans);
  }

  // Draw at most so many of the Gaussians, each grown as the gaps ask for.
  setLimit(count) {
    this.limit = Math.max(1, Math.min(Math.round(count), this.count));
  }

  // camera: {view: 16 or 12 numbers by rows, world to camera (x right, y down, z forward), fx, fy, cx, cy, width, height
  // in pixels, depth: [x, y] of clip depth x + y / z where the target has a depth buffer of others}.
  // background: [r, g, b, a] of a target that is all ours. Gaussians are sorted beside: what is drawn is in the newest
  // order that is ready, and `onsorted` is called when a newer one is.
  render(camera, { background = [1, 1, 1, 1] } = {}) {
    const begun = performance.now();
    const { gl } = this;
    if (gl.isContextLost()) return;
    if (this.own) {
      if (this.canvas.width !== camera.width || this.canvas.height !== camera.height) {
        this.canvas.width = camera.width;
        this.canvas.height = camera.height;
      }
      gl.viewport(0, 0, camera.width, camera.height);
      const [r, g, b, a] = background;
      gl.clearColor(r * a, g * a, b * a, a);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    }
    const rows = this.depthRows(camera.view);
    const shown = Math.min(this.loaded, this.limit);
    this.sorter.sort({ rows, limit: shown, near: this.header.rule.near, ticket: ++this.ticket });
    if (this.result) this.splats.arrange(this.result.order, this.result.seen);
    if (this.result) { this.sorter.reuse(this.result.order); this.result = null; }
    if (!this.posed) { this.splats.pose(this.transforms, this.weights); this.posed = true; }
    const { spread } = this.header.points;
    const grow = spread * spread * (this.count / Math.max(1, shown) - 1);
    this.splats.draw(camera, grow, this.missing(camera, rows));
    this.milliseconds.draw = performance.now() - begun;
  }

  // Of each joint, what takes a canonical point to its depth before the camera.
  depthRows(view) {
    const A = this.transforms, rows = new Float32Array(4 * this.skeleton.count);
    for (let j = 0; j < this.skeleton.count; j++) {
      for (let c = 0; c < 4; c++) {
        let sum = c === 3 ? view[11] : 0;
        for (let k = 0; k < 3; k++) sum += view[8 + k] * A[12 * j + 4 * k + c];
        rows[4 * j + c] = sum;
      }
    }
    return rows;
  }

  // The variance that Gaussians lack where pixels are finer than those of training: render/widening.py.
  missing(camera, rows) {
    const { pixel, rule } = this.header;
    if (!pixel) return 0;
    let depth = 0;
    for (let i = 0; i < rows.length; i++) depth += rows[i] * this.moments[i];
    const missing = rule.low_pass * (pixel ** 2 - ((2 * depth) / (camera.fx + camera.fy)) ** 2);
    return depth > 0 && missing > 0 ? missing : 0;
  }

  arranged({ order, seen, ticket, ms }) {
    this.result = { order, seen };
    this.sorted = ticket;
    this.milliseconds.sort = ms;
    this.onsorted();
  }

  // The same as `render`, once in the order of this very pose and camera. Resolves when it is drawn.
  async renderSorted(camera, options) {
    this.render(camera, options);
    const asked = this.ticket;
    const told = this.onsorted;
    while (this.sorted < asked) {
      await new Promise((resolve) => { this.onsorted = () => { told(); resolve(); }; });
    }
    this.onsorted = told;
    this.render(camera, options);
  }

  restored() {
    this.splats = new Splats(this.gl, this.header);
    this.chunks.forEach((chunk) => this.splats.add(chunk));
    this.posed = false;
    this.onsorted();
  }

  close() {
    this.sorter.close();
    this.splats.close();
  }
}

// Layers of `padded` rows of `width` numbers, from planes of one number of each Gaussian: its difference to the one
// before, modulo its type, as the typed array has it by itself. at: the row of each.
function unpacked(planes, at, padded, width) {
  const count = at.length, layers = planes.length / count / width;
  const out = new planes.constructor(layers * padded * width);
  for (let p = 0; p < layers * width; p++) {
    const first = padded * width * Math.floor(p / width) + (p % width);
    let value = 0;
    for (let i = 0; i < count; i++) {
      value += planes[p * count + i];
      out[first + width * at[i]] = value;
    }
  }
  return out;
}

// Planes of four slots, one after another, as rows of all slots of each Gaussian.
function interleaved(planes, count, padded, slots) {
  if (slots === 4) return planes.slice(0, 4 * count);
  const rows = new planes.constructor(slots * count);
  for (let s = 0; s < slots / 4; s++) {
    for (let i = 0; i < count; i++) {
      for (let k = 0; k < 4; k++) rows[slots * i + 4 * s + k] = planes[4 * s * padded + 4 * i + k];
    }
  }
  return rows;
}
