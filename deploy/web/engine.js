// What the page draws with where the browser itself does: an avatar of avatar.js behind the controls' interface.
import { playCommand } from "./controls.js";
import { extent } from "./motion.js";
import { readMotionFile } from "./motion_files.js";

export class LocalEngine {
  constructor(avatar) {
    this.avatar = avatar;
    this.canvas = avatar.canvas;
    this.extents = new Map();
    this.added = new Map();
    this.frames = 0;
    this.settled = true;
    this.onchange = () => {};
    avatar.onsorted = () => { if (this.asked !== avatar.sorted || avatar.loaded < avatar.count) this.onchange(); this.asked = avatar.sorted; };
    const { header } = avatar;
    this.info = {
      name: header.name, tiers: [header.tier], tier: header.tier, gaussians: header.points.count, notes: header.notes,
      motions: [...avatar.motionNames],
    };
  }

  ready() { return true; }

  async motion(name) {
    const motion = this.added.get(name) ?? (await this.avatar.readMotion(name));
    if (!this.extents.has(name)) this.extents.set(name, extent(this.avatar, motion));
    return { name, fps: motion.fps, count: motion.count, extent: this.extents.get(name), motion };
  }

  async addFile(file) {
    const motion = await readMotionFile(file, this.avatar.header.joints, this.avatar.header.relaxed);
    const name = motion.name;
    this.added.set(name, motion);
    if (!this.info.motions.includes(name)) this.info.motions.push(name);
    this.extents.delete(name);
    this.notes = motion.notes;
    return name;
  }

  prepare(view) {
    this.avatar.motion = this.added.get(view.motion) ?? this.avatar.motions.get(view.motion);
    this.avatar.setTime(view.time);
    this.avatar.setLimit(view.gaussians);
  }

  draw(view) {
    this.prepare(view);
    this.avatar.render(view.camera, { background: [...view.background, 1] });
    this.frames++;
  }

  async picture(view) {
    this.prepare(view);
    await this.avatar.renderSorted(view.camera, { background: [...view.background, 1] });
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/png")); // before the browser clears it
  }

  stats() {
    const { avatar } = this;
    return { drawn: this.frames, stages: avatar.milliseconds, gaussians: Math.min(avatar.loaded, avatar.limit) };
  }

  command(view) {
    return playCommand(`${this.info.name}.gavatar`, view);
  }
}
