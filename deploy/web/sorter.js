// The order in which Gaussians are drawn, far to near, found beside the page's own thread.

// Runs in the worker, where nothing else of this file is known: keep it self-contained.
export function sorterThread() {
  let count = 0;
  let depth = new Float32Array(0), keys = new Uint16Array(0);
  const starts = new Uint32Array(65537);
  // Gaussians by how many joints move them, so that no loop asks for each weight whether it is zero: numbers, canonical
  // points, and joint * 256 + weight of each of their joints.
  const groups = [];

  function grown(old, length) {
    const array = new old.constructor(length);
    array.set(old);
    return array;
  }

  function add({ start, points, joints, weights, slots }) {
    const used = new Uint8Array(points.length / 3); // the heaviest joints come first
    const sizes = new Array(slots + 1).fill(0);
    for (let i = 0; i < used.length; i++) {
      let n = 1;
      while (n < slots && weights[slots * i + n]) n++;
      used[i] = n;
      sizes[n]++;
    }
    for (let n = 1; n <= slots; n++) {
      const old = groups[n] ?? { size: 0, ids: new Uint32Array(0), points: new Float32Array(0), pairs: new Uint16Array(0) };
      const size = old.size + sizes[n];
      groups[n] = { size: old.size, ids: grown(old.ids, size), points: grown(old.points, 3 * size), pairs: grown(old.pairs, n * size) };
    }
    for (let i = 0; i < used.length; i++) {
      const n = used[i], group = groups[n], at = group.size++;
      group.ids[at] = start + i;
      for (let a = 0; a < 3; a++) group.points[3 * at + a] = points[3 * i + a];
      for (let k = 0; k < n; k++) group.pairs[n * at + k] = 256 * joints[slots * i + k] + weights[slots * i + k];
    }
    count = start + used.length;
    depth = new Float32Array(count);
    keys = new Uint16Array(count);
  }

  // rows: of each joint, the four numbers that take a canonical point to its depth before the camera.
  function measure(n, { size, ids, points, pairs }, rows, limit) {
    for (let q = 0, k = 0; q < size && ids[q] < limit; q++) {
      const x = points[3 * q], y = points[3 * q + 1], z = points[3 * q + 2];
      let d = 0;
      for (const end = k + n; k < end; k++) {
        const pair = pairs[k], r = (pair >> 8) << 2;
        d += (pair & 255) * (rows[r] * x + rows[r + 1] * y + rows[r + 2] * z + rows[r + 3]);
      }
      depth[ids[q]] = d / 255;
    }
  }

  function sort({ rows, limit, near, buffer }) {
    const n = Math.min(count, limit);
    groups.forEach((group, joints) => measure(joints, group, rows, n));
    let low = Infinity, high = -Infinity, seen = 0;
    for (let i = 0; i < n; i++) {
      const d = depth[i];
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
