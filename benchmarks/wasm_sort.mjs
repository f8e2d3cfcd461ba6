// The page's sort and skinning of 200,000 points: plain JavaScript against WebAssembly with SIMD, one thread, in node.
//   python -m ziglang c++ -target wasm32-wasi -msimd128 -mbulk-memory -mnontrapping-fptoint -O3 -std=c++17 \
//     -fno-exceptions -Wl,--no-entry -Ideploy/native benchmarks/wasm_sort.cpp -o wasm_sort.wasm
//   node benchmarks/wasm_sort.mjs wasm_sort.wasm
import { readFileSync } from "node:fs";
import { sorterThread } from "../deploy/web/sorter.js";

const N = 200000, J = 52, ROUNDS = 60, NEAR = 0.05;
let seed = 1;
const random = () => (seed = (seed * 1664525 + 1013904223) >>> 0) / 4294967296;
const median = (times) => times.toSorted((a, b) => a - b)[times.length >> 1].toFixed(1);

// as many weights of each point as gavatar's body has: one for 47 % of its vertices, two for 38 %
const points = new Float32Array(3 * N).map(() => random() * 2 - 1);
const joints = new Uint8Array(4 * N), weights = new Uint8Array(4 * N);
for (let i = 0; i < N; i++) {
  const draw = random(), used = draw < 0.47 ? 1 : draw < 0.85 ? 2 : draw < 0.97 ? 3 : 4;
  const parts = Array.from({ length: used }, () => random() + 0.01), sum = parts.reduce((x, y) => x + y);
  const shares = parts.map((part) => Math.max(1, Math.floor((255 * part) / sum))).sort((x, y) => y - x); // heaviest first
  shares[0] += 255 - shares.reduce((x, y) => x + y);
  for (let k = 0; k < used; k++) {
    weights[4 * i + k] = shares[k];
    joints[4 * i + k] = Math.floor(random() * J);
  }
}
const A = new Float32Array(12 * J).map((_, i) => random() * 0.2 - 0.1 + (i % 12 % 5 === 0 ? 1 : 0));
const rows = new Float32Array(4 * J).map((_, i) => A[12 * (i >> 2) + 8 + (i & 3)] + ((i & 3) === 3 ? 3 : 0));

function timed(work) {
  const times = [];
  for (let r = 0; r < ROUNDS; r++) {
    const begun = performance.now();
    work();
    times.push(performance.now() - begun);
  }
  return median(times);
}

let answer, buffer = null;
globalThis.self = { postMessage: (data) => { answer = data; } };
sorterThread(); // the page's very own
self.onmessage({ data: { start: 0, points, joints, weights, slots: 4 } });
const sortScript = timed(() => {
  self.onmessage({ data: { rows, limit: N, near: NEAR, buffer } });
  buffer = answer.order.buffer;
});

const skinned = new Float32Array(3 * N);
function skin() {
  for (let i = 0; i < N; i++) {
    const x = points[3 * i], y = points[3 * i + 1], z = points[3 * i + 2];
    let a = 0, b = 0, c = 0;
    for (let k = 4 * i; k < 4 * i + 4; k++) {
      const w = weights[k], r = 12 * joints[k];
      if (w === 0) continue;
      a += w * (A[r] * x + A[r + 1] * y + A[r + 2] * z + A[r + 3]);
      b += w * (A[r + 4] * x + A[r + 5] * y + A[r + 6] * z + A[r + 7]);
      c += w * (A[r + 8] * x + A[r + 9] * y + A[r + 10] * z + A[r + 11]);
    }
    skinned[3 * i] = a / 255; skinned[3 * i + 1] = b / 255; skinned[3 * i + 2] = c / 255;
  }
}
const skinScript = timed(skin);

const module = await WebAssembly.compile(readFileSync(process.argv[2]));
const imports = {};
for (const one of WebAssembly.Module.imports(module)) (imports[one.module] ??= {})[one.name] = () => 0;
const { exports: wasm } = await WebAssembly.instantiate(module, imports);
function put(array) {
  const at = wasm.take(array.byteLength);
  new array.constructor(wasm.memory.buffer, at, array.length).set(array);
  return at;
}
const columns = new Float32Array(16 * J); // of each joint's three rows of four, filled up to four floats
for (let i = 0; i < 12 * J; i++) columns[16 * Math.floor(i / 12) + 4 * (i % 4) + (Math.floor(i / 4) % 3)] = A[i];
const given = [points, joints, weights, rows].map(put);
const skinGiven = [points, Int32Array.from(joints), Float32Array.from(weights, (w) => w / 255), columns].map(put);
const room = [4 * N, 2 * N, 4 * 65537, 4 * N].map((bytes) => wasm.take(bytes)), out = wasm.take(12 * N + 16);
let order;
const sortWasm = timed(() => {
  new Float32Array(wasm.memory.buffer, given[3], rows.length).set(rows);
  wasm.sort(N, ...given, NEAR, ...room);
  order = new Uint32Array(wasm.memory.buffer, room[3], N).slice(); // what the worker sends
});
const skinWasm = timed(() => wasm.skin(N, J, ...skinGiven, out));

const differs = new Float32Array(wasm.memory.buffer, out, 3 * N).reduce((m, v, i) => Math.max(m, Math.abs(v - skinned[i])), 0);
const elsewhere = order.reduce((sum, v, i) => sum + (v !== answer.order[i]), 0);
console.log(`sort: JavaScript ${sortScript} ms, WebAssembly ${sortWasm} ms; ${elsewhere} of ${N} places differ`);
console.log(`skinning: JavaScript ${skinScript} ms, WebAssembly ${skinWasm} ms; ${differs} m apart at most`);
