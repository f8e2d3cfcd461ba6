// The order in which Gaussians are drawn, far to near, found beside the page's own thread.

// Runs in the worker, where nothing else of this file is known: keep it self-contained.
export function sorterThread() {
  let count = 0, slots = 4;
  let points = new Float32Array(0), joints = new Uint8Array(0), weights = new Uint8Array(0);
  let depth = new Float32Array(0), keys = new Uint16Array(0);
  const starts = new Uint32Array(65537);

  function grown(old, length) {
    const array = new old.constructor(length);
    array.set(old);
    return array;
  }

  function add(message) {
    slots = message.slots;
    const total = message.start + message.points.length / 3;
    points = grown(points, 3 * total);
    joints = grown(joints, slots * total);
    weights = grown(weights, slots * total);
    points.set(message.points, 3 * message.start);
    joints.set(message.joints, slots * message.start);
    weights.set(message.weights, slots * message.start);
    depth = new Float32Array(total);
    keys = new Uint16Array(total);
    count = total;
  }

  // rows: of each joint, the four numbers that take a canonical point to its depth before the camera.
  function sort({ rows, limit, near, buffer }) {
    const n = Math.min(count, limit);
    let low = Infinity, high = -Infinity, seen = 0;
    for (let i = 0; i < n; i++) {
      const x = points[3 * i], y = points[3 * i + 1], z = points[3 * i + 2];
      let d = 0;
      for (let k = slots * i; k < slots * i + slots; k++) {
        const w = weights[k];
        if (w === 0) continue;
        const r = 4 * joints[k];
        d += w * (rows[r] * x + rows[r + 1] * y + rows[r + 2] * z + rows[r + 3]);
      }
      d /= 255;
      depth[i] = d;
      if (d > near) {
        seen++;
        if (d < low) low = d;
        if (d > high) high = d;
      }
    }
    const order = buffer && buffer.byteLength === 4 * n ? new Uint32Array(buffer) : new Uint32Array(n);
    const scale = high > low ? 65535 / (high - low) : 0;
    starts.fill(0);
    for (let i = 0; i < n; i++) {
      if (!(depth[i] > near)) continue;
      const key = ((high - depth[i]) * scale) | 0; // 0 is the farthest
      keys[i] = key;
      starts[key + 1]++;
    }
    for (let k = 0; k < 65536; k++) starts[k + 1] += starts[k];
    for (let i = n - 1; i >= 0; i--) { // of equal depth the first is nearest, as the rule has it
      if (depth[i] > near) order[starts[keys[i]]++] = i;
    }
    return { order, seen };
  }

  self.onmessage = ({ data }) => {
    if (data.points) { add(data); return; }
    const begun = performance.now();
    const { order, seen } = sort(data);
    self.postMessage({ order, seen, ticket: data.ticket, ms: performance.now() - begun }, [order.buffer]);
  };
}

export class Sorter {
  // done: called with {order, seen, ticket, ms} of each finished sort.
  constructor(done) {
    const source = `(${sorterThread.toString()})()`;
    this.worker = new Worker(URL.createObjectURL(new Blob([source], { type: "text/javascript" })));
    this.busy = false;
    this.waiting = null;
    this.spare = null;
    this.worker.onmessage = ({ data }) => {
      this.busy = false;
      done(data);
      if (this.waiting) { const next = this.waiting; this.waiting = null; this.sort(next); }
    };
  }

  add(start, points, joints, weights, slots) {
    this.worker.postMessage({ start, points, joints, weights, slots });
  }

  // Only the newest of the requests that come while one is under way is kept.
  sort(request) {
    if (this.busy) { this.waiting = request; return; }
    this.busy = true;
    const buffer = this.spare;
    this.spare = null;
    this.worker.postMessage({ ...request, buffer }, buffer ? [buffer] : []);
  }

  // Give back an order that is no longer needed.
  reuse(order) { this.spare = order.buffer; }

  close() { this.worker.terminate(); }
}
