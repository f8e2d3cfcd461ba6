// A motion of any rig that stands as its OFFSETs draw it, on the joints of the avatar. As rigs/retarget.py does it: at
// every frame a limb of the body points where the rig's limb points, and everything else turns from an upright stance as
// far as the rig's does from its own.
import { Motion } from "./motion.js";
import { axisAngleFromQuaternion, betweenQuaternions, matrixFromQuaternion, matricesFromAxisAngle, multiply3, quaternionFromMatrix } from "./pose.js";
import { matchRig } from "./rig_names.js";

const SIDES = [["left", 1], ["right", -1]];
const NEEDED = SIDES.flatMap(([side]) => ["hip", "knee", "ankle", "shoulder", "elbow"].map((part) => `${side}_${part}`));
const RESTING_LIMBS = { // unit directions from a joint of the resting body to the next, left side
  hip: ["knee", [0.14, -0.99, -0.03]],
  knee: ["ankle", [-0.11, -0.99, -0.08]],
  shoulder: ["elbow", [0.95, -0.27, -0.16]],
  elbow: ["wrist", [1.0, 0.09, -0.01]],
};
const BODY_PARENTS = {
  spine1: "pelvis", spine2: "spine1", spine3: "spine2", neck: "spine3", head: "neck",
  ...Object.fromEntries(SIDES.flatMap(([s]) => [
    [`${s}_hip`, "pelvis"], [`${s}_knee`, `${s}_hip`], [`${s}_ankle`, `${s}_knee`], [`${s}_foot`, `${s}_ankle`], [`${s}_collar`, "spine3"],
    [`${s}_shoulder`, `${s}_collar`], [`${s}_elbow`, `${s}_shoulder`], [`${s}_wrist`, `${s}_elbow`],
    ...["index", "middle", "pinky", "ring", "thumb"].flatMap((f) => [1, 2, 3].map((k) => [`${s}_${f}${k}`, k === 1 ? `${s}_wrist` : `${s}_${f}${k - 1}`])),
  ])),
};
const FAR = 100, FAST = 20, FULL_TURN = 2 * Math.PI; // metres, metres a second: as motions/plausible.py has them

// bvh: of bvh_file.js. body: {names, rest} of the avatar, relaxed: its pose at ease, which joints beyond the body's and
// the fingers keep. others: how a file is turned into one that can be read. Throws an Error that names the file.
export function retargeted(bvh, { name, file, body, relaxed, others }) {
  const mapping = matchRig(bvh.names, bvh.parents);
  const missing = NEEDED.filter((joint) => !mapping.has(joint));
  if (missing.length) throw new Error(`${file}: no joint of the rig is known as ${missing.join(", ")} (it has ${bvh.names.slice(0, 40).join(", ")}); ${others} --set mapping=FILE`);
  const notes = [...bvh.notes, ...doubts(bvh, mapping, file, others)];
  const rest = bvh.places();
  const fault = faultOfStance(rest, mapping);
  if (fault) throw new Error(`${file}: its OFFSETs draw nobody who stands (${fault}), which this page does not read; ${others}`);
  const leg = legOf((part) => rest[mapping.get(part)]);
  if (!(leg > 0)) throw new Error(`${file}: the rig's legs have no length: its OFFSETs are zero`);
  const factor = legOf((part) => body.rest.slice(3 * body.names.indexOf(part), 3 * body.names.indexOf(part) + 3)) / leg;
  const B = stanceOf(rest, mapping);
  const world = new Float64Array(9 * bvh.names.length);
  const W = uprightOf(bvh, mapping, B, world);
  const constant = limbsOf(bvh, mapping, rest, B);
  const chain = spineChain(bvh, mapping), way = bvh.line(mapping.get("pelvis"));
  const poses = new Float32Array(bvh.frames * relaxed.length), trans = new Float32Array(3 * bvh.frames);
  for (let k = 0; k < bvh.frames; k++) {
    bvh.world(k, world);
    trans.set(apply(W, bvh.track(way, k, world)).map((v) => factor * v), 3 * k);
    const turned = new Map([...mapping].map(([joint, j]) => [joint, product(product(W, world.subarray(9 * j, 9 * j + 9)), constant.get(joint) ?? B)]));
    addSpine(turned, chain.map((j) => product(product(W, world.subarray(9 * j, 9 * j + 9)), B)));
    poses.set(relaxed, k * relaxed.length);
    poses.set(axisAngleFromQuaternion(quaternionFromMatrix(turned.get("pelvis"))), k * relaxed.length + 3 * body.names.indexOf("pelvis"));
    setLocal(turned, body, poses.subarray(k * relaxed.length));
  }
  notes.push(...wayDoubts(trans, bvh.fps));
  return new Motion({ name, fps: bvh.frames === 1 && !(bvh.fps > 0) ? 30 : bvh.fps, poses, trans, joints: body.names.length, notes });
}

// Notes on what a motion of a person hardly has; an Error where nothing says how the limbs move.
function doubts(bvh, mapping, file, others) {
  const turning = (joint) => bvh.channels[mapping.get(joint)].some(({ turns }) => turns);
  if (!NEEDED.some(turning)) throw new Error(`${file}: the limbs have no rotation channels: nothing in it says how they move`);
  if (bvh.largest > 1e5) throw new Error(`${file}: MOTION turns a joint by ${bvh.largest.toPrecision(3)} degrees: these are no angles`);
  if (bvh.frames > 1 && !(bvh.fps >= 1 && bvh.fps <= 500)) throw new Error(`${file}: Frame Time makes ${bvh.fps.toPrecision(3)} frames a second, which no recording has; ${others} --set fps=30`);
  const notes = [];
  if (bvh.largest > 0.5 && bvh.largest < FULL_TURN + 1e-3 && bvh.frames > 1) notes.push(`no angle is larger than ${bvh.largest.toFixed(2)}: if these are radians, ${others} --set angles=radians`);
  if (!bvh.placed) notes.push("no joint has position channels: the person stays in place");
  return notes;
}

function wayDoubts(trans, fps) {
  const steps = [];
  let span = 0;
  for (let i = 3; i < trans.length; i += 3) steps.push(Math.hypot(...[0, 1, 2].map((a) => trans[i + a] - trans[i + a - 3])));
  for (let i = 0; i < trans.length; i++) span = Math.max(span, Math.abs(trans[i] - trans[i % 3]));
  const speed = (steps.sort((a, b) => a - b)[steps.length >> 1] ?? 0) * fps;
  return span > FAR || speed > FAST ? [`trans goes ${span.toFixed(0)} m far, at ${speed.toFixed(0)} m a second: the positions may be in another unit than the OFFSETs`] : [];
}

// What is wrong with a rest pose as that of somebody who stands, "" for nothing: rigs/rest_pose.py.
function faultOfStance(places, mapping) {
  const at = (name) => (mapping.has(name) ? places[mapping.get(name)] : null);
  const up = minus(middleOf(at("left_shoulder"), at("right_shoulder")), middleOf(at("left_hip"), at("right_hip")));
  const across = plus(unit(minus(at("left_hip"), at("right_hip"))), unit(minus(at("left_shoulder"), at("right_shoulder"))));
  const left = asideOf(across, up);
  if (Math.hypot(...up) < 1e-6 || Math.hypot(...left) < 1e-6) return "hips and shoulders coincide";
  const bone = (side, start, end) => minus(at(`${side}_${end}`), at(`${side}_${start}`));
  const down = up.map((v) => -v);
  for (const [side] of SIDES) {
    const leg = bone(side, "hip", "ankle");
    if (degreesBetween(leg, down) > 70) return `the ${side} leg points ${degreesBetween(leg, up) < 60 ? "up" : "aside"}`;
    if (degreesBetween(bone(side, "hip", "knee"), bone(side, "knee", "ankle")) > 70) return `the ${side} knee is folded`;
  }
  const mirrored = (v) => minus(v, unit(left).map((x) => 2 * x * dot(v, unit(left))));
  for (const [limb, start, end] of [["arm", "shoulder", "elbow"], ["leg", "hip", "ankle"]]) {
    if (degreesBetween(mirrored(bone("left", start, end)), bone("right", start, end)) > 45) return `the ${limb}s are not alike`;
  }
  const top = at("head") ?? at("neck");
  if (top && degreesBetween(minus(top, middleOf(at("left_shoulder"), at("right_shoulder"))), up) > 100) return "the head hangs";
  if (at("left_foot") && at("right_foot")) {
    const bent = SIDES.map(([s]) => degreesBetween(bone(s, "ankle", "foot"), bone(s, "knee", "ankle")));
    const long = Math.hypot(...bone("left", "ankle", "foot")) > 0.1 * Math.hypot(...bone("left", "hip", "ankle"));
    if (Math.max(...bent) < 15 && long) return "the feet point along the shins";
  }
  return "";
}

function legOf(place) {
  const lengths = SIDES.map(([s]) => {
    const [hip, knee, ankle] = ["hip", "knee", "ankle"].map((part) => place(`${s}_${part}`));
    return Math.hypot(...minus(hip, knee)) + Math.hypot(...minus(knee, ankle));
  });
  return (lengths[0] + lengths[1]) / 2;
}

// From the body's frame (left x, up y, front z) to the rig's at rest.
function stanceOf(rest, mapping) {
  const at = (part) => ["left", "right"].map((s) => rest[mapping.get(`${s}_${part}`)]);
  const up = unit(minus(middleOf(...at("shoulder")), middleOf(...at("hip"))));
  const hips = minus(...at("hip"));
  const left = unit(asideOf(Math.hypot(...hips) > 1e-6 ? hips : minus(...at("shoulder")), up));
  const front = [left[1] * up[2] - left[2] * up[1], left[2] * up[0] - left[0] * up[2], left[0] * up[1] - left[1] * up[0]];
  return [0, 1, 2].flatMap((r) => [left[r], up[r], front[r]]);
}

// The rotation nearest to a matrix whose entries are -1, 0 and 1.
function snapped(matrix) {
  const out = new Array(9).fill(0), rows = new Set([0, 1, 2]), columns = new Set([0, 1, 2]);
  for (let n = 0; n < 2; n++) {
    let best = [-1, 0, 0];
    for (const r of rows) for (const c of columns) if (Math.abs(matrix[3 * r + c]) > best[0]) best = [Math.abs(matrix[3 * r + c]), r, c];
    const [, r, c] = best;
    out[3 * r + c] = Math.sign(matrix[3 * r + c]);
    rows.delete(r);
    columns.delete(c);
  }
  const last = 3 * [...rows][0] + [...columns][0];
  out[last] = 1;
  const [a, b, c, d, e, f, g, h, i] = out;
  if (a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0) out[last] = -1;
  return out;
}

// From the rig's world to the y-up one: the axis that its trunk points along on average becomes y.
function uprightOf(bvh, mapping, B, world) {
  const mean = [0, 0, 0];
  for (let k = 0; k < bvh.frames; k++) {
    const places = bvh.places(bvh.world(k, world));
    const at = (part) => middleOf(...["left", "right"].map((s) => places[mapping.get(`${s}_${part}`)]));
    minus(at("shoulder"), at("hip")).forEach((v, a) => { mean[a] += v; });
  }
  const largest = mean.reduce((best, v, a) => (Math.abs(v) > Math.abs(mean[best]) ? a : best), 0);
  const axis = [0, 0, 0];
  axis[largest] = Math.sign(mean[largest]) || 1;
  const W = transposed(snapped(B)), up = apply(W, axis);
  return up[1] > 0.5 ? W : product(snapped(rotationBetween(up, [0, 1, 0])), W);
}

// The constant part of each joint of arms, legs, hands and fingers, by name.
function limbsOf(bvh, mapping, rest, B) {
  const out = new Map();
  for (const [side, sign] of SIDES) {
    for (const [part, [following, [x, y, z]]] of Object.entries(RESTING_LIMBS)) {
      const joint = mapping.get(`${side}_${part}`), child = mapping.get(`${side}_${following}`);
      if (joint === undefined) continue;
      const bone = child === undefined ? bvh.tips.get(joint) : minus(rest[child], rest[joint]);
      if (bone && Math.hypot(...bone) > 1e-6) out.set(`${side}_${part}`, product(rotationBetween(apply(B, [sign * x, y, z]), bone), B));
    }
    const forearm = out.get(`${side}_elbow`); // a hand lies straight on it in every rest pose
    if (!forearm) continue;
    out.set(`${side}_wrist`, forearm);
    for (const joint of mapping.keys()) if (joint.startsWith(side) && /\d$/.test(joint)) out.set(joint, forearm);
  }
  return out;
}

// Joints between the pelvis and both shoulders that have no name yet, from the bottom up.
function spineChain(bvh, mapping) {
  const [left, right] = SIDES.map(([s]) => bvh.line(mapping.get(`${s}_shoulder`)).slice(0, -1));
  const below = bvh.line(mapping.get("pelvis")), named = new Set(mapping.values());
  return left.filter((j, i) => j === right[i] && !below.includes(j) && !named.has(j));
}

function addSpine(turned, chain) {
  if (chain.length) turned.set("spine3", chain[chain.length - 1]);
  if (chain.length > 1) turned.set("spine1", chain[0]);
  if (chain.length > 2) turned.set("spine2", chain[chain.length >> 1]);
  if (!chain.length) return;
  if (!turned.has("spine1")) turned.set("spine1", partWay(turned.get("pelvis"), turned.get("spine3"), 1 / 3));
  if (!turned.has("spine2")) turned.set("spine2", partWay(turned.get("spine1"), turned.get("spine3"), 1 / 2));
}

function partWay(a, b, t) { return matrixFromQuaternion(betweenQuaternions(quaternionFromMatrix(a), quaternionFromMatrix(b), t)); }

// Rotations relative to the parent from orientations by name; joints without one follow their parent.
function setLocal(turned, body, pose) {
  const orientation = (joint) => {
    if (!turned.has(joint)) turned.set(joint, orientation(BODY_PARENTS[joint]));
    return turned.get(joint);
  };
  body.names.forEach((joint, j) => {
    if (!(joint in BODY_PARENTS)) return;
    const local = product(transposed(orientation(BODY_PARENTS[joint])), orientation(joint));
    pose.set(axisAngleFromQuaternion(quaternionFromMatrix(local)), 3 * j);
  });
}

// The least rotation from one direction to another; of opposite ones, half a turn about what is at right angles.
function rotationBetween(start, end) {
  const a = unit(start), b = unit(end);
  let axis = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const sine = Math.hypot(...axis), cosine = dot(a, b);
  if (sine < 1e-9 && cosine < 0) axis = asideOf(Math.abs(a[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0], a);
  return matricesFromAxisAngle(unit(axis).map((v) => v * Math.atan2(sine, cosine)));
}

function product(a, b) {
  const out = new Float64Array(9);
  multiply3(a, 0, b, 0, out, 0);
  return out;
}
function transposed(m) { return [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]]; }
function apply(m, v) { return [0, 1, 2].map((r) => m[3 * r] * v[0] + m[3 * r + 1] * v[1] + m[3 * r + 2] * v[2]); }
function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
function plus(a, b) { return a.map((v, i) => v + b[i]); }
function minus(a, b) { return a.map((v, i) => v - b[i]); }
function middleOf(a, b) { return plus(a, b).map((v) => v / 2); }
function unit(v) { const length = Math.max(Math.hypot(...v), 1e-12); return v.map((x) => x / length); }
function asideOf(v, axis) { const t = dot(v, axis) / Math.max(dot(axis, axis), 1e-12); return minus(v, axis.map((x) => t * x)); }
function degreesBetween(a, b) {
  const lengths = Math.hypot(...a) * Math.hypot(...b);
  return lengths < 1e-12 ? 0 : (Math.acos(Math.min(1, Math.max(-1, dot(a, b) / lengths))) * 180) / Math.PI;
}
