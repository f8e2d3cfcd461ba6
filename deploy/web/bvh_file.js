// BVH files: a skeleton of offsets, and Euler angles a frame. As formats/bvh_file.py reads them.
import { matricesFromAxisAngle, multiply3 } from "./pose.js";

const CHANNEL = /^([xyz])(position|rotation|scale)$/i;
const ENDS = ["END", "ENDSITE", "END_SITE", "ENDEFFECTOR"];

// A parsed file, in its own units and axes. names, parents (-1 for the root; a parent stands before its children),
// offsets: J of three numbers. tips: by joint, the offset of its End Site. channels: J lists of {axis, turns, column}.
// values: `width` numbers a frame. moves: by joint below the root that has position channels, 3 numbers a frame.
export class Bvh {
  constructor(parts) { Object.assign(this, parts); }

  // The joints from the root down to one.
  line(joint) {
    const line = [];
    for (let j = joint; j >= 0; j = this.parents[j]) line.unshift(j);
    return line;
  }

  // Orientations of a frame's joints in the world relative to their own at rest, 9 numbers a joint.
  world(frame, out) {
    const local = new Float64Array(9), held = new Float64Array(9), axis = new Float64Array(3);
    const at = frame * this.width;
    this.channels.forEach((channels, j) => {
      local.set([1, 0, 0, 0, 1, 0, 0, 0, 1]);
      for (const { axis: a, turns, column } of channels) { // in the order of the channels, about the turned axes
        if (!turns) continue;
        axis.fill(0);
        axis[a] = (this.values[at + column] * Math.PI) / 180;
        held.set(local);
        multiply3(held, 0, matricesFromAxisAngle(axis), 0, local, 0);
      }
      if (this.parents[j] < 0) out.set(local, 9 * j);
      else multiply3(out, 9 * this.parents[j], local, 0, out, 9 * j);
    });
    return out;
  }

  // Places of the joints, J of three numbers, the root at the origin. world: of `world`, none for the pose at rest.
  places(world) {
    const out = [];
    this.parents.forEach((p, j) => {
      if (p < 0) out.push([0, 0, 0]);
      else out.push(out[p].map((v, r) => v + (world ? row(world, 9 * p + 3 * r, this.offsets[j]) : this.offsets[j][r])));
    });
    return out;
  }

  // Where a joint is in the world, by the positions of all joints above it.
  track(line, frame, world) {
    const place = [...this.root(frame)];
    for (let i = 1; i < line.length; i++) {
      const j = line[i], move = this.moves.get(j)?.subarray(3 * frame, 3 * frame + 3) ?? this.offsets[j];
      for (let r = 0; r < 3; r++) place[r] += row(world, 9 * line[i - 1] + 3 * r, move);
    }
    return place;
  }

  root(frame) { return placed(this.channels[0], this.values, frame * this.width, this.offsets[0]); }
}

function row(matrix, at, v) { return matrix[at] * v[0] + matrix[at + 1] * v[1] + matrix[at + 2] * v[2]; }

function placed(channels, values, at, offset) {
  const place = [...offset];
  for (const { axis, turns, column } of channels) if (turns === false) place[axis] = values[at + column];
  return place;
}

// bytes: of the file. Throws an Error that names the file and the line or field.
export function readBvh(bytes, file) {
  const lines = textOf(bytes).split(/\r\n|\r|\n/);
  const words = new Words(lines, file);
  if ((words.next(true) ?? [""])[0].toUpperCase().replace(/:+$/, "") !== "HIERARCHY") throw new Error(`${file} is not a BVH file: it does not begin with HIERARCHY`);
  const rig = hierarchyOf(words);
  let frames, step;
  while (frames === undefined || step === undefined) {
    const found = /^(frames|frame\s*time)\s*[:=]?\s*(\S+)/i.exec(words.next().join(" "));
    if (!found) throw words.wrong(`expected '${frames === undefined ? "Frames" : "Frame Time"}: NUMBER'`);
    const number = numberOf(found[2]);
    if (found[1].toLowerCase() === "frames") frames = number;
    else step = number;
    if (Number.isNaN(number)) throw words.wrong(`'${found[2]}' is not a number`);
    if (frames !== undefined && !(Number.isInteger(frames) && frames >= 1)) throw words.wrong("Frames: must be a whole number, at least 1");
  }
  return motionOf(rig, frames, step, lines.slice(words.line).join(" "), file);
}

function textOf(bytes) {
  const utf16 = (bytes[0] === 0xff && bytes[1] === 0xfe) || (bytes[0] === 0xfe && bytes[1] === 0xff) || bytes.subarray(0, 64).includes(0);
  if (utf16) return new TextDecoder(bytes[0] === 0xfe || bytes[0] === 0 ? "utf-16be" : "utf-16le").decode(bytes);
  try {
    return new TextDecoder("utf-8", { fatal: true }).decode(bytes);
  } catch {
    return new TextDecoder("latin1").decode(bytes);
  }
}

function numberOf(word) { return word === "" ? NaN : Number(word.replace(",", ".")); } // the comma of some countries

// The words of a file's lines: a brace is a line of its own, comments and blank lines are passed over.
class Words {
  constructor(lines, file) { Object.assign(this, { lines, file, line: 0, pieces: [] }); }

  next(mayEnd = false) {
    while (!this.pieces.length) {
      if (this.line >= this.lines.length) {
        if (mayEnd) return null;
        throw this.wrong("the file ends early");
      }
      const text = this.lines[this.line++].replace(/(^|\s)(#|\/\/|;).*$/, "");
      this.pieces = text.split(/([{}])/).filter((piece) => piece.trim()).map((piece) => piece.trim().split(/\s+/));
    }
    return this.pieces.shift();
  }

  wrong(what) { return new Error(`${this.file}, line ${this.line}: ${what}`); }
}

function hierarchyOf(words) {
  const rig = { names: [], parents: [], offsets: [], channels: [], tips: new Map(), width: 0 };
  const stack = []; // joints that are open; -1 stands for an End Site
  let pending = null;
  for (;;) {
    const piece = words.next(), key = piece[0].toUpperCase().replace(/:+$/, "");
    if (key === "MOTION") break;
    if (key === "ROOT" || key === "JOINT") pending = addJoint(rig, key, piece, stack, words);
    else if (ENDS.includes(key)) pending = -1;
    else if (key === "{") {
      if (pending === null) throw words.wrong("'{' without a joint");
      stack.push(pending);
      pending = null;
    } else if (key === "}") {
      if (!stack.length) throw words.wrong("'}' without '{'");
      stack.pop();
    } else if (key === "OFFSET") {
      addOffset(rig, piece, pending === -1 ? [...stack, -1] : stack, words);
      if (pending === -1) pending = null;
    } else if (key === "CHANNELS") addChannels(rig, piece, stack, words);
    else throw words.wrong(`'${piece[0]}' is not a word of the hierarchy`);
  }
  if (stack.length || !rig.names.length) throw words.wrong("the hierarchy is empty or not closed before MOTION");
  const missing = rig.offsets.findIndex((offset) => !offset);
  if (missing >= 0) throw new Error(`${words.file}: joint '${rig.names[missing]}' has no OFFSET`);
  return rig;
}

function addJoint(rig, key, piece, stack, words) {
  const parent = stack.length ? stack[stack.length - 1] : -1;
  if (key === "ROOT" && rig.names.length) throw words.wrong("a second ROOT: one person a file is read");
  if (key === "JOINT" && parent < 0) throw words.wrong("a JOINT outside of a skeleton");
  rig.names.push(piece.slice(1).join(" ") || `joint${rig.names.length}`);
  rig.parents.push(parent);
  rig.offsets.push(null);
  rig.channels.push([]);
  return rig.names.length - 1;
}

function addOffset(rig, piece, stack, words) {
  const values = piece.slice(1).map((word) => numberOf(word.replace(/,+$/, "")));
  if (values.length !== 3 || !values.every(Number.isFinite) || !stack.length) throw words.wrong("OFFSET needs three numbers inside a joint");
  const joint = stack[stack.length - 1];
  if (joint >= 0) rig.offsets[joint] = values;
  else if (stack.length > 1) rig.tips.set(stack[stack.length - 2], values);
}

function addChannels(rig, piece, stack, words) {
  const joint = stack.length ? stack[stack.length - 1] : -1;
  const found = piece.slice(2).map((word) => CHANNEL.exec(word));
  if (joint < 0 || found.includes(null) || piece[1] !== String(found.length)) throw words.wrong("CHANNELS needs a count and as many of Xposition to Zrotation");
  const kinds = { position: false, rotation: true }; // bones keep their length: scales are passed over
  rig.channels[joint] = found.map(([, axis, kind]) => ({ axis: "xyz".indexOf(axis.toLowerCase()), turns: kinds[kind.toLowerCase()], column: rig.width++ }));
}

function motionOf(rig, frames, step, text, file) {
  const { values, notes } = tableOf(text, frames, rig.width, file);
  const bvh = new Bvh({ ...rig, frames, values, notes, moves: new Map(), fps: Number.isFinite(step) && step > 1e-9 ? 1 / step : 0 });
  const columns = rig.channels.flat();
  bvh.placed = columns.some(({ turns }) => turns === false);
  bvh.largest = 0;
  for (const { turns, column } of columns) {
    if (turns) for (let at = column; at < values.length; at += rig.width) bvh.largest = Math.max(bvh.largest, Math.abs(values[at]));
  }
  rig.channels.forEach((channels, j) => {
    if (j && channels.some(({ turns }) => turns === false)) addMoves(bvh, j);
  });
  return bvh;
}

// Places relative to the parent, by joint. Most exporters write the place, some what is to be added to the OFFSET: told
// by the axes that move little for their OFFSET, which then all lie nearer to zero.
function addMoves(bvh, j) {
  const places = new Float64Array(3 * bvh.frames), offset = bvh.offsets[j];
  for (let k = 0; k < bvh.frames; k++) places.set(placed(bvh.channels[j], bvh.values, k * bvh.width, offset), 3 * k);
  const axes = [0, 1, 2].map((a) => places.filter((_, i) => i % 3 === a).sort());
  const middle = axes.map((sorted) => (sorted[(sorted.length - 1) >> 1] + sorted[sorted.length >> 1]) / 2);
  const steady = [0, 1, 2].filter((a) => Math.abs(offset[a]) > 2 * (axes[a][axes[a].length - 1] - axes[a][0]) + 1e-9);
  const adds = steady.length > 0 && steady.every((a) => Math.abs(middle[a]) < Math.abs(middle[a] - offset[a]));
  if (adds) for (let i = 0; i < places.length; i++) places[i] += offset[i % 3];
  bvh.moves.set(j, places);
  bvh.offsets[j] = middle.map((v, a) => (adds ? v + offset[a] : v));
}

function tableOf(text, frames, width, file) {
  let given = text;
  if (given.includes(";") || (given.includes(",") && (given.includes(".") || given.includes(", ")))) {
    given = given.replaceAll(",", given.includes(";") && !given.includes(".") ? "." : " ").replaceAll(";", " ");
  }
  const numbers = given.split(/\s+/).filter(Boolean), wanted = frames * width;
  if (numbers.length < wanted || !width) throw new Error(`${file}: ${frames} frames of ${width} channels are ${wanted} numbers, the file holds ${numbers.length}: it is cut short`);
  const notes = [], rest = numbers.length - wanted;
  if (rest) notes.push(`the file holds ${rest % width ? `${rest} numbers` : `${rest / width} frames`} more than 'Frames: ${frames}' says: they are left out`);
  const values = Float64Array.from({ length: wanted }, (_, i) => numberOf(numbers[i]));
  const wrong = values.findIndex((v) => !Number.isFinite(v));
  if (wrong >= 0) throw new Error(`${file}: MOTION holds '${numbers[wrong]}' in frame ${Math.floor(wrong / width)}, which is no number to play`);
  return { values, notes };
}
