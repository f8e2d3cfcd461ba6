// From a pose to the joints' transforms and the weights of the look: the same arithmetic as geometry/kinematics.py and
// tiers/blendshape.py, for one pose. Matrices are row-major; transforms of joints are three rows of four, 12 numbers.

// Rotation matrices, 9 numbers a joint, of axis-angle rows, 3 numbers a joint (Rodrigues; exact at and near zero).
export function matricesFromAxisAngle(pose, out = new Float64Array(pose.length * 3)) {
  for (let j = 0; j < pose.length / 3; j++) {
    const x = pose[3 * j], y = pose[3 * j + 1], z = pose[3 * j + 2];
    const angle = Math.hypot(x, y, z);
    const s = angle > 1e-8 ? Math.sin(angle) / angle : 1;
    const half = angle > 1e-8 ? Math.sin(angle / 2) / angle : 0.5;
    const c = 2 * half * half; // (1 - cos) / angle^2, without cancellation
    const at = 9 * j;
    out[at] = 1 - c * (y * y + z * z);
    out[at + 1] = c * x * y - s * z;
    out[at + 2] = c * x * z + s * y;
    out[at + 3] = c * x * y + s * z;
    out[at + 4] = 1 - c * (x * x + z * z);
    out[at + 5] = c * y * z - s * x;
    out[at + 6] = c * x * z - s * y;
    out[at + 7] = c * y * z + s * x;
    out[at + 8] = 1 - c * (x * x + y * y);
  }
  return out;
}

export function quaternionFromAxisAngle(x, y, z) {
  const angle = Math.hypot(x, y, z);
  const s = angle > 1e-8 ? Math.sin(angle / 2) / angle : 0.5;
  return [Math.cos(angle / 2), x * s, y * s, z * s];
}

// The rotation a share t of the way from one unit quaternion wxyz to another, by the shorter arc.
export function betweenQuaternions(p, end, t) {
  let q = end;
  let cosine = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3];
  if (cosine < 0) { q = q.map((v) => -v); cosine = -cosine; }
  const angle = Math.acos(Math.min(1, cosine));
  const near = angle < 1e-4;
  const u = near ? 1 - t : Math.sin((1 - t) * angle) / Math.sin(angle);
  const v = near ? t : Math.sin(t * angle) / Math.sin(angle);
  return [0, 1, 2, 3].map((i) => u * p[i] + v * q[i]);
}

// The rotation a share t of the way from one axis-angle to another, by the shorter arc, as axis-angle.
export function between(a, b, t) {
  return axisAngleFromQuaternion(betweenQuaternions(quaternionFromAxisAngle(...a), quaternionFromAxisAngle(...b), t));
}

// Axis-angle, up to half a turn, of a quaternion wxyz of about length one.
export function axisAngleFromQuaternion(q) {
  const [w, x, y, z] = q[0] < 0 ? q.map((v) => -v) : q;
  const sine = Math.hypot(x, y, z);
  const scale = sine > 1e-9 ? (2 * Math.atan2(sine, w)) / sine : 2;
  return [x * scale, y * scale, z * scale];
}

// A unit quaternion wxyz of a rotation matrix, by the largest of its four components (Shepperd).
export function quaternionFromMatrix(m) {
  const squares = [m[0] + m[4] + m[8], m[0] - m[4] - m[8], m[4] - m[0] - m[8], m[8] - m[0] - m[4]];
  const best = squares.indexOf(Math.max(...squares));
  const s = Math.sqrt(1 + squares[best]), [wx, wy, wz] = [m[7] - m[5], m[2] - m[6], m[3] - m[1]];
  const [xy, xz, yz] = [m[1] + m[3], m[2] + m[6], m[5] + m[7]];
  const q = [[s * s, wx, wy, wz], [wx, s * s, xy, xz], [wy, xy, s * s, yz], [wz, xz, yz, s * s]][best];
  return q.map((v) => v / (2 * s));
}

export function matrixFromQuaternion([w, x, y, z]) {
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}

// Of 3x3 matrices that begin at i, j and k of their arrays.
export function multiply3(a, i, b, j, out, k) {
  for (let r = 0; r < 3; r++) {
    for (let c = 0; c < 3; c++) {
      out[k + 3 * r + c] = a[i + 3 * r] * b[j + c] + a[i + 3 * r + 1] * b[j + 3 + c] + a[i + 3 * r + 2] * b[j + 6 + c];
    }
  }
}

export class Skeleton {
  // names: J. parents: J, -1 for the root, a parent before its children. rest: 3 J metres. inverse: 12 J, the inverse of
  // the transforms that take the rest pose to the canonical one.
  constructor({ names, parents, rest, inverse }) {
    this.names = names;
    this.parents = parents;
    this.rest = rest;
    this.inverse = inverse;
    this.count = parents.length;
    this.world = new Float64Array(9 * this.count); // of the last pose: rotations of the joints in the world
  }

  // Canonical-to-posed transforms, 12 J, of local rotation matrices (9 J) and a translation.
  transforms(local, trans = [0, 0, 0], out = new Float32Array(12 * this.count)) {
    const { parents, rest, world, inverse } = this;
    const place = new Float64Array(3 * this.count);
    for (let j = 0; j < this.count; j++) {
      const p = parents[j];
      if (p < 0) {
        for (let i = 0; i < 9; i++) world[9 * j + i] = local[9 * j + i];
        for (let i = 0; i < 3; i++) place[3 * j + i] = rest[3 * j + i];
      } else {
        multiply3(world, 9 * p, local, 9 * j, world, 9 * j);
        for (let i = 0; i < 3; i++) {
          let sum = place[3 * p + i];
          for (let c = 0; c < 3; c++) sum += world[9 * p + 3 * i + c] * (rest[3 * j + c] - rest[3 * p + c]);
          place[3 * j + i] = sum;
        }
      }
      for (let r = 0; r < 3; r++) {
        const R = 9 * j + 3 * r;
        let shift = place[3 * j + r] + trans[r];
        for (let c = 0; c < 3; c++) shift -= world[R + c] * rest[3 * j + c];
        for (let c = 0; c < 4; c++) {
          let sum = c === 3 ? shift : 0;
          for (let k = 0; k < 3; k++) sum += world[R + k] * inverse[12 * j + 4 * k + c];
          out[12 * j + 4 * r + c] = sum;
        }
      }
    }
    return out;
  }
}

// How much of each basis of the look a pose calls for, P K numbers: `Coefficients` of tiers/blendshape.py.
export class Coefficients {
  constructor(arrays) {
    Object.assign(this, arrays); // as blendshape.npz names them
    this.parts = this.gains.length / 8;
    this.rank = this.low.length / this.parts;
    this.layers = [];
    for (let i = 0; arrays[`weight_${i}`]; i++) this.layers.push([arrays[`weight_${i}`], arrays[`bias_${i}`]]);
    if (this.near) {
      const J = this.joints.length;
      this.share = Float32Array.from(this.near, (v, i) => {
        const row = Math.floor(i / J) * J;
        let sum = 0;
        for (let k = 0; k < J; k++) sum += this.near[row + k];
        return v / Math.max(sum, 1);
      });
    }
  }

  // local: 9 J rotation matrices; world: of the joints in the world, as `Skeleton.world` has them.
  of(local, world) {
    const D = 9 * this.joints.length;
    const given = new Float32Array(D);
    for (let j = 0; j < this.joints.length; j++) {
      for (let i = 0; i < 9; i++) given[9 * j + i] = local[9 * this.joints[j] + i] - (i % 4 === 0 ? 1 : 0);
    }
    const bounded = given.map((v, i) => Math.min(Math.max(v, this.input_low[i]), this.input_high[i]));
    let x = bounded;
    this.layers.forEach(([weight, bias], i) => {
      x = affine(x, weight, bias);
      if (i < this.layers.length - 1) x = x.map((v) => Math.max(v, 0));
    });
    if (this.turn) this.addTurned(x, bounded, world);
    const shares = this.seen ? this.shares(given) : null;
    return x.map((v, i) => {
      const clamped = Math.min(Math.max(v, this.low[i]), this.high[i]);
      return shares ? clamped * shares[Math.floor(i / this.rank)] : clamped;
    });
  }

  addTurned(x, bounded, world) {
    const direct = affine(bounded, this.direct, new Float32Array(x.length));
    const features = new Float32Array(55);
    for (let p = 0; p < this.parts; p++) {
      const R = 9 * this.owners[p];
      let at = 9;
      for (let i = 0; i < 9; i++) {
        features[i] = world[R + i];
        for (let k = i; k < 9; k++) features[at++] = world[R + i] * world[R + k];
      }
      features[54] = 1;
      for (let k = 0; k < this.rank; k++) {
        let sum = direct[p * this.rank + k];
        for (let f = 0; f < 55; f++) sum += features[f] * this.turn[(p * 55 + f) * this.rank + k];
        x[p * this.rank + k] += sum;
      }
    }
  }

  // Of each part, how much of its residual it keeps: by the distance of its joints to the nearest filmed pose.
  shares(given) {
    const J = this.joints.length, D = 9 * J, [near, far] = this.fade;
    const nearest = new Float64Array(this.parts).fill(Infinity);
    const square = new Float64Array(J);
    for (let f = 0; f < this.seen.length / D; f++) {
      for (let j = 0; j < J; j++) {
        let sum = 0;
        for (let i = 9 * j; i < 9 * j + 9; i++) sum += (this.seen[f * D + i] - given[i]) ** 2;
        square[j] = sum;
      }
      for (let p = 0; p < this.parts; p++) {
        let distance = 0;
        for (let j = 0; j < J; j++) distance += square[j] * this.share[p * J + j];
        if (distance < nearest[p]) nearest[p] = distance;
      }
    }
    return nearest.map((v) => {
      const t = Math.min(Math.max((far - Math.sqrt(v)) / (far - near), 0), 1);
      return t * t * (3 - 2 * t);
    });
  }
}

// x W + b for W of (inputs, outputs), row-major.
function affine(x, weight, bias) {
  const out = Float32Array.from(bias);
  for (let i = 0; i < x.length; i++) {
    const v = x[i];
    if (v === 0) continue;
    const row = i * out.length;
    for (let k = 0; k < out.length; k++) out[k] += v * weight[row + k];
  }
  return out;
}
