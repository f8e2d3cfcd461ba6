// Motion files dropped on the page: .npz of AMASS and the SMPL family, and .bvh of rigs that stand as their OFFSETs draw
// them; others are turned into an .npz by gavatar-motion.
import { readBvh } from "./bvh_file.js";
import { Motion } from "./motion.js";
import { axisAngleFromQuaternion, matricesFromAxisAngle, quaternionFromAxisAngle } from "./pose.js";
import { retargeted } from "./retarget.js";

const OTHERS = "turn it into an .npz with: gavatar-motion convert FILE -o motion.npz";
const SMPL_JOINTS = [
  "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2", "left_ankle", "right_ankle", "spine3",
  "left_foot", "right_foot", "neck", "left_collar", "right_collar", "head", "left_shoulder", "right_shoulder",
  "left_elbow", "right_elbow", "left_wrist", "right_wrist",
];

// body: {names, parents, rest} of the avatar. relaxed: its pose at ease, which fingers take where the file has none.
export async function readMotionFile(file, body, relaxed) {
  const suffix = file.name.toLowerCase().replace(/^.*\./, ".");
  const name = file.name.replace(/\.[^.]*$/, "");
  if (suffix === ".npz") return fromArrays(name, file.name, await readNpz(file), body, relaxed);
  if (suffix === ".bvh") {
    if (SMPL_JOINTS.some((joint) => !body.names.includes(joint))) throw new Error(`${file.name}: this avatar has no joints of the SMPL family; give its motions as .npz`);
    const bvh = readBvh(new Uint8Array(await file.arrayBuffer()), file.name);
    return retargeted(bvh, { name, file: file.name, body, relaxed, others: OTHERS.replace("FILE", file.name) });
  }
  throw new Error(`${file.name}: this page reads motions of .npz and .bvh; ${OTHERS}`);
}

function fromArrays(name, file, arrays, body, relaxed) {
  const poses = arrays.poses;
  if (!poses) throw new Error(`${file} has no array 'poses' (it has ${Object.keys(arrays).join(", ")}); ${OTHERS}`);
  const [frames, ...rest] = poses.shape;
  const numbers = rest.reduce((a, b) => a * b, 1);
  const J = numbers / 3;
  const table = jointsOf(J, body);
  if (!table || !frames) throw new Error(`${file}: poses have shape (${poses.shape.join(", ")}), which is no axis-angle of an SMPL body; ${OTHERS}`);
  let largest = 0;
  for (const v of poses.data) {
    if (!Number.isFinite(v)) throw new Error(`${file}: a pose is not finite`);
    largest = Math.max(largest, Math.abs(v));
  }
  if (largest > 20) throw new Error(`${file}: poses reach ${largest.toFixed(0)}, which are no radians; ${OTHERS}`);
  const trans = arrays.trans ?? arrays.transl;
  if (trans && (trans.shape[0] !== frames || trans.data.length !== 3 * frames)) throw new Error(`${file}: trans has shape (${trans.shape.join(", ")}) for ${frames} frames`);
  const fps = Number((arrays.mocap_framerate ?? arrays.mocap_frame_rate ?? arrays.fps ?? { data: [30] }).data[0]);
  if (!(fps >= 1 && fps <= 500)) throw new Error(`${file}: a rate of ${fps} frames a second cannot be meant`);
  const out = new Float32Array(frames * relaxed.length);
  for (let f = 0; f < frames; f++) {
    out.set(relaxed, f * relaxed.length);
    table.forEach((joint, j) => {
      if (joint >= 0) for (let a = 0; a < 3; a++) out[f * relaxed.length + 3 * joint + a] = poses.data[(f * J + j) * 3 + a];
    });
  }
  const moved = Float32Array.from({ length: 3 * frames }, (_, i) => (trans ? trans.data[i] : 0));
  return upright(new Motion({ name, fps, poses: out, trans: moved, joints: body.names.length }));
}

// For each joint of a file of J, the avatar's, -1 for none; null for a number of joints that no body of the family has.
function jointsOf(J, body) {
  const at = (name) => body.names.indexOf(name);
  const whole = body.names.length;
  if (J === whole) return body.names.map((_, j) => j);
  if (J === 22 || J === 24) return Array.from({ length: J }, (_, j) => (j < 22 ? at(SMPL_JOINTS[j]) : -1));
  const fingers = (side) => ["index", "middle", "pinky", "ring", "thumb"].flatMap((f) => [1, 2, 3].map((k) => at(`${side}_${f}${k}`)));
  if (J === 52 || J === 55) {
    const face = J === 55 ? ["jaw", "left_eye_smplhf", "right_eye_smplhf"].map(at) : [];
    return [...SMPL_JOINTS.map(at), ...face, ...fingers("left"), ...fingers("right")];
  }
  return null;
}

// AMASS has z up: where bodies lie on the whole and their up is +z, the motion is turned.
function upright(motion) {
  const ups = [0, 0, 0];
  for (let k = 0; k < motion.count; k++) {
    const R = matricesFromAxisAngle(motion.frame(k).pose.subarray(0, 3));
    for (let a = 0; a < 3; a++) ups[a] += R[3 * a + 1] / motion.count;
  }
  if (!(ups[2] > 0.7 && ups[2] > ups[1])) return motion;
  for (let k = 0; k < motion.count; k++) {
    const { pose, trans } = motion.frame(k);
    pose.set(turned(pose.subarray(0, 3)));
    const [x, y, z] = trans;
    trans.set([x, z, -y]);
  }
  return motion;
}

// A rotation after a quarter turn about x, which takes z up to y up, as axis-angle.
function turned(axis) {
  const [w, x, y, z] = quaternionFromAxisAngle(...axis);
  const c = Math.SQRT1_2, d = -Math.SQRT1_2; // cos, and the x of the sine of -45 degrees
  return axisAngleFromQuaternion([c * w - d * x, c * x + d * w, c * y - d * z, c * z + d * y]);
}

// The arrays of an .npz: {name: {shape, data}}; those of other kinds than numbers are passed over.
export async function readNpz(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const arrays = {};
  for (const { name, method, data } of entriesOf(bytes, file.name)) {
    if (!name.endsWith(".npy")) continue;
    const raw = method === 0 ? data : new Uint8Array(await new Response(new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate-raw"))).arrayBuffer());
    const array = readNpy(raw);
    if (array) arrays[name.slice(0, -4)] = array;
  }
  return arrays;
}

function entriesOf(bytes, file) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const broken = () => new Error(`${file} is no whole .npz`);
  let end = bytes.length - 22;
  while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end--;
  if (end < 0) throw broken();
  const entries = [];
  let at = view.getUint32(end + 16, true);
  for (let k = view.getUint16(end + 10, true); k > 0; k--) {
    if (at + 46 > bytes.length || view.getUint32(at, true) !== 0x02014b50) throw broken();
    const [method, size] = [view.getUint16(at + 10, true), view.getUint32(at + 20, true)];
    const [n, extra, comment] = [28, 30, 32].map((o) => view.getUint16(at + o, true));
    const local = view.getUint32(at + 42, true);
    const name = new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + n));
    if (local + 30 > bytes.length) throw broken();
    const begin = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    if (begin + size > bytes.length || (method !== 0 && method !== 8)) throw broken();
    entries.push({ name, method, data: bytes.subarray(begin, begin + size) });
    at += 46 + n + extra + comment;
  }
  return entries;
}

function readNpy(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes[0] !== 0x93) return null;
  const long = bytes[6] > 1;
  const length = long ? view.getUint32(8, true) : view.getUint16(8, true);
  const begin = (long ? 12 : 10) + length;
  const head = new TextDecoder("latin1").decode(bytes.subarray(long ? 12 : 10, begin));
  const kind = /'descr':\s*'([<|=])([fiu])(\d)'/.exec(head), shape = /'shape':\s*\(([^)]*)\)/.exec(head);
  if (!kind || !shape || /'fortran_order':\s*True/.test(head)) return null;
  const dims = shape[1].split(",").map((s) => s.trim()).filter(Boolean).map(Number);
  const count = dims.reduce((a, b) => a * b, 1), size = Number(kind[3]);
  if (begin + count * size > bytes.length) return null;
  const read = { f4: "getFloat32", f8: "getFloat64", i4: "getInt32", i8: "getBigInt64", u1: "getUint8", i1: "getInt8", i2: "getInt16", u2: "getUint16", u4: "getUint32", u8: "getBigUint64" }[kind[2] + size];
  if (!read) return null;
  return { shape: dims, data: Float64Array.from({ length: count }, (_, i) => Number(view[read](begin + i * size, true))) };
}
