// Motions: frames of axis-angle poses and translations, and where a camera stands that holds them.
import { between, matricesFromAxisAngle } from "./pose.js";

export class Motion {
  // name: for people. fps: frames per second. poses: 3 J numbers a frame, radians. trans: 3 a frame, metres. notes: what is
  // odd about it.
  constructor({ name, fps, poses, trans, joints, loop = true, notes = [] }) {
    Object.assign(this, { name, fps, poses, trans, joints, loop, notes });
    this.count = poses.length / (3 * joints);
    if (!(fps > 0)) throw new Error(`${name}: ${fps} frames per second cannot be played`);
    if (!this.count || !Number.isInteger(this.count)) throw new Error(`${name} has no frames of ${joints} joints`);
  }

  // Seconds from the first frame to the last.
  get seconds() { return (this.count - 1) / this.fps; }

  frame(k) {
    const J = 3 * this.joints;
    return { pose: this.poses.subarray(k * J, (k + 1) * J), trans: this.trans.subarray(3 * k, 3 * k + 3) };
  }

  // The pose `time` seconds after the first frame, between frames by slerp; the first and the last beyond them.
  at(time) {
    const place = Math.min(Math.max(time * this.fps, 0), this.count - 1);
    const k = Math.min(Math.floor(place + 1e-6), this.count - 1), t = Math.max(0, place - k);
    if (t < 1e-6 || k + 1 >= this.count) return this.frame(k);
    const a = this.frame(k), b = this.frame(k + 1);
    const pose = new Float32Array(a.pose.length);
    for (let j = 0; j < this.joints; j++) {
      const one = a.pose.subarray(3 * j, 3 * j + 3), two = b.pose.subarray(3 * j, 3 * j + 3);
      pose.set(one.every((v, i) => v === two[i]) ? one : between(one, two, t), 3 * j);
    }
    return { pose, trans: a.trans.map((v, i) => v + t * (b.trans[i] - v)) };
  }
}

const FOCAL = 50 / 36, MARGIN = 0.06, SAMPLED_FRAMES = 60; // as play/framing.py has them

// Where an avatar is through a motion: {low, high, center} of a sample of its points, and `facing`, radians from +z.
export function extent(avatar, motion) {
  const points = [];
  const frames = new Set();
  const last = motion.count - 1;
  for (let i = 0; i < Math.min(SAMPLED_FRAMES, motion.count); i++) {
    frames.add(Math.round(last ? (i * last) / Math.max(1, Math.min(SAMPLED_FRAMES, motion.count) - 1) : 0));
  }
  for (const k of frames) {
    const { pose, trans } = motion.frame(k);
    points.push(...avatar.sample(pose, trans));
  }
  const low = [0, 1, 2].map((a) => points.reduce((m, p) => Math.min(m, p[a]), Infinity));
  const high = [0, 1, 2].map((a) => points.reduce((m, p) => Math.max(m, p[a]), -Infinity));
  const R = matricesFromAxisAngle(motion.frame(0).pose.subarray(0, 3));
  const facing = Math.hypot(R[2], R[8]) > 0.2 ? Math.atan2(R[2], R[8]) : 0;
  return { low, high, center: low.map((v, a) => (v + high[a]) / 2), facing, points };
}

// Metres from the center of an extent at which a level camera holds it whole. angle: radians from +z.
export function distanceFor(where, width, height, angle) {
  const focal = FOCAL * Math.max(width, height);
  const half = [(0.5 - MARGIN) * width, (0.5 - MARGIN) * height];
  let distance = 0, nearest = 0;
  for (const p of where.points) {
    const [x, y, z] = p.map((v, a) => v - where.center[a]);
    const right = Math.cos(angle) * x - Math.sin(angle) * z;
    const toward = Math.sin(angle) * x + Math.cos(angle) * z;
    distance = Math.max(distance, toward + focal * Math.max(Math.abs(right) / half[0], Math.abs(y) / half[1]));
    nearest = Math.max(nearest, toward);
  }
  return Math.max(distance, nearest + 0.5);
}

// A camera about `target`: radians from +z to the left of the person, radians up, metres.
export function orbitCamera({ target, azimuth, elevation, distance, width, height, zoom = 1 }) {
  const focal = FOCAL * Math.max(width, height) * zoom;
  const sa = Math.sin(azimuth), ca = Math.cos(azimuth), se = Math.sin(elevation), ce = Math.cos(elevation);
  const eye = [target[0] + distance * sa * ce, target[1] + distance * se, target[2] + distance * ca * ce];
  const forward = [-sa * ce, -se, -ca * ce];
  const right = [ca, 0, -sa];
  const down = [ // forward x right
    forward[1] * right[2] - forward[2] * right[1],
    forward[2] * right[0] - forward[0] * right[2],
    forward[0] * right[1] - forward[1] * right[0],
  ];
  const view = [];
  for (const row of [right, down, forward]) view.push(...row, -(row[0] * eye[0] + row[1] * eye[1] + row[2] * eye[2]));
  return { view, fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height };
}
