// The page's controls: they are the same for the avatar that the browser draws and for the one that a server does.
import { distanceFor, orbitCamera } from "./motion.js";

const BACKGROUNDS = { white: [1, 1, 1], grey: [0.5, 0.5, 0.5], black: [0, 0, 0], green: [0, 1, 0] };
const STEEPEST = (89 * Math.PI) / 180;
const SPEEDS = [0.1, 0.25, 0.5, 1, 1.5, 2, 4];

// engine: what draws, of engine.js or remote.js: {info, canvas, motion(name), addFile(file), draw(state), onchange,
// stats(), command(state)}. root: the element that holds the page.
export class Controls {
  constructor(engine, root = document) {
    this.engine = engine;
    this.find = (name) => root.querySelector(`[data-part="${name}"]`);
    this.state = {
      motion: null, time: 0, playing: true, speed: 1, loop: true, background: "white", tier: engine.info.tier,
      gaussians: engine.info.first ?? engine.info.gaussians, camera: { azimuth: 0, elevation: 0, distance: 3, target: [0, 0, 0] },
    };
    this.dirty = true;
    this.shown = [];
    this.fill();
    this.listen();
    engine.onchange = () => { this.dirty = true; };
    this.last = performance.now();
    requestAnimationFrame((now) => this.tick(now));
  }

  fill() {
    const { info } = this.engine;
    this.find("name").textContent = info.name;
    document.title = `${info.name} - gavatar`;
    this.listMotions();
    const tiers = this.find("tier");
    tiers.replaceChildren(...info.tiers.map((tier) => new Option(tier, tier)));
    tiers.value = info.tier;
    tiers.closest("label").hidden = info.tiers.length < 2;
    const count = this.find("gaussians");
    [count.min, count.max, count.value] = [Math.min(1000, info.gaussians), info.gaussians, this.state.gaussians];
    this.find("speed").replaceChildren(...SPEEDS.map((s) => new Option(`${s}x`, s, s === 1, s === 1)));
    this.find("background").replaceChildren(...Object.keys(BACKGROUNDS).map((name) => new Option(name, name)));
    this.find("panel").open = !window.matchMedia("(max-width: 600px)").matches; // there it would hide the avatar
    this.say(info.notes ?? []);
  }

  listMotions() {
    const list = this.find("motion");
    list.replaceChildren(...this.engine.info.motions.map((name) => new Option(name, name)));
    if (this.state.motion) list.value = this.state.motion.name;
  }

  say(sentences, wrong = false) {
    const place = this.find("notes");
    place.replaceChildren(...sentences.map((text) => {
      const line = document.createElement("p");
      line.textContent = text;
      line.className = wrong ? "wrong" : "";
      return line;
    }));
  }

  // Start a motion. A view that nobody has turned frames it; another keeps its direction and distance, and goes along to
  // where the person is now.
  async play(name) {
    try {
      this.wanted = name;
      const motion = await this.engine.motion(name);
      if (this.wanted !== name) return; // another was chosen meanwhile
      const before = this.state.motion?.extent.center, { camera } = this.state;
      const untouched = this.framed && JSON.stringify(camera) === this.framed;
      this.state.motion = motion;
      this.state.time = 0;
      this.find("motion").value = motion.name;
      this.find("scrub").max = Math.max(motion.count - 1, 0);
      if (!before || untouched) this.reset();
      else camera.target = camera.target.map((v, a) => v + motion.extent.center[a] - before[a]);
      this.dirty = true;
    } catch (error) {
      this.say([error.message], true);
      if (this.state.motion) this.find("motion").value = this.state.motion.name;
    }
  }

  reset() {
    const { motion, camera } = this.state;
    if (!motion) return;
    const { width, height } = this.size();
    Object.assign(camera, { azimuth: motion.extent.facing, elevation: 0, target: [...motion.extent.center] });
    camera.distance = distanceFor(motion.extent, width, height, camera.azimuth);
    this.framed = JSON.stringify(camera);
    this.dirty = true;
  }

  size() {
    const box = this.engine.canvas.getBoundingClientRect();
    const fine = Math.min(window.devicePixelRatio || 1, 2);
    const most = this.engine.info.most ?? 4096;
    const factor = Math.min(fine, most / Math.max(box.width, box.height, 1));
    return { width: Math.max(1, Math.round(box.width * factor)), height: Math.max(1, Math.round(box.height * factor)) };
  }

  // What an engine draws: all of it plain values.
  view() {
    const { motion, time, background, tier, gaussians, camera, playing } = this.state;
    const { width, height } = this.size();
    const told = { color: background, azimuth: camera.azimuth - motion.extent.facing, frame: playing ? null : this.frame() };
    return { motion: motion.name, time, background: BACKGROUNDS[background], tier, gaussians, told, width, height,
      camera: orbitCamera({ ...camera, width, height }) };
  }

  tick(now) {
    const passed = Math.min((now - this.last) / 1000, 0.25);
    this.last = now;
    const { state } = this;
    const { width, height } = this.size();
    if (width !== this.wide || height !== this.high) { [this.wide, this.high] = [width, height]; this.dirty = true; }
    if (state.motion && state.playing && state.motion.count > 1) {
      state.time = this.moved(state.time + passed * state.speed);
      this.dirty = true;
    }
    if (state.motion && this.dirty && this.engine.ready()) {
      this.dirty = false;
      this.engine.draw(this.view());
    }
    this.tell(now);
    requestAnimationFrame((next) => this.tick(next));
  }

  // A time after the last frame begins again, where it loops: its frame after the last is the first.
  moved(time) {
    const { motion, loop } = this.state;
    const whole = loop ? motion.count / motion.fps : (motion.count - 1) / motion.fps;
    if (time < whole) return time;
    if (loop) return time % whole;
    this.pause(true);
    return whole;
  }

  // The frame that is shown, from 0.
  frame() {
    const { motion, time } = this.state;
    return Math.min(Math.floor(time * motion.fps + 1e-6), motion.count - 1);
  }

  pause(paused) {
    const { motion, time, loop } = this.state;
    if (!paused && motion && !loop && time >= (motion.count - 1) / motion.fps) this.state.time = 0;
    this.state.playing = !paused;
    this.find("play").textContent = paused ? "\u25B6" : "\u275A\u275A";
    this.find("play").title = paused ? "Play (space)" : "Pause (space)";
  }

  step(frames) {
    const { motion } = this.state;
    this.pause(true);
    const exact = this.state.time * motion.fps;
    const k = (frames > 0 ? Math.floor(exact + 1e-6) : Math.ceil(exact - 1e-6)) + frames;
    this.state.time = (((k % motion.count) + motion.count) % motion.count) / motion.fps;
    this.dirty = true;
  }

  tell(now) {
    const { motion, time } = this.state;
    if (motion) {
      const k = this.frame();
      this.find("scrub").value = k;
      this.find("time").textContent = `${time.toFixed(2)} s  ${k + 1}/${motion.count}`;
    }
    if (now - (this.told ?? 0) < 400) return;
    this.told = now;
    const { drawn, stages, gaussians } = this.engine.stats();
    this.shown.push([now, drawn]);
    while (this.shown.length > 2 && now - this.shown[0][0] > 2000) this.shown.shift();
    const [[t0, d0]] = this.shown;
    const fps = now > t0 ? ((drawn - d0) / (now - t0)) * 1000 : 0;
    const parts = Object.entries(stages).map(([name, ms]) => `${name} ${ms.toFixed(1)}`);
    this.find("stats").textContent = `${fps.toFixed(0)} fps  ${gaussians.toLocaleString("en")} Gaussians  ms: ${parts.join("  ")}`;
  }

  listen() {
    const on = (name, event, act) => this.find(name).addEventListener(event, act);
    on("play", "click", () => this.pause(this.state.playing));
    on("back", "click", () => this.step(-1));
    on("next", "click", () => this.step(1));
    on("scrub", "input", (e) => { this.pause(true); this.state.time = Number(e.target.value) / this.state.motion.fps; this.dirty = true; });
    on("speed", "change", (e) => { this.state.speed = Number(e.target.value); });
    on("loop", "change", (e) => { this.state.loop = e.target.checked; });
    on("motion", "change", (e) => this.play(e.target.value));
    on("tier", "change", (e) => { this.state.tier = e.target.value; this.dirty = true; });
    on("gaussians", "input", (e) => { this.state.gaussians = Number(e.target.value); this.dirty = true; });
    on("background", "change", (e) => { this.state.background = e.target.value; document.body.dataset.background = e.target.value; this.dirty = true; });
    on("reset", "click", () => this.reset());
    on("screenshot", "click", () => this.screenshot());
    on("record", "click", () => this.record());
    on("command", "click", () => this.copyCommand());
    on("file", "change", async (e) => { await this.take([...e.target.files]); e.target.value = ""; }); // so that it may be given again
    document.addEventListener("keydown", (e) => this.key(e));
    this.drag(this.engine.canvas);
    this.drop();
    this.pause(false);
  }

  key(event) {
    const { tagName } = event.target;
    if (/^(INPUT|SELECT|TEXTAREA)$/.test(tagName) && event.target !== this.find("scrub")) return;
    if (event.key === " " && /^(BUTTON|SUMMARY)$/.test(tagName)) return; // there it presses
    const acts = {
      " ": () => this.pause(this.state.playing), ArrowLeft: () => this.step(-1), ArrowRight: () => this.step(1),
      r: () => this.reset(), s: () => this.screenshot(), h: () => document.body.classList.toggle("bare"),
    };
    if (!acts[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    acts[event.key]();
  }

  // Orbit with one finger or the left button, pan with two fingers, the right button or shift, zoom by wheel or pinch.
  drag(canvas) {
    const held = new Map();
    let spread = 0;
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      held.set(e.pointerId, e);
      spread = 0;
    });
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (e) => { held.delete(e.pointerId); spread = 0; });
    canvas.addEventListener("pointermove", (e) => {
      const before = held.get(e.pointerId);
      if (!before) return;
      const dx = e.clientX - before.clientX, dy = e.clientY - before.clientY;
      held.set(e.pointerId, e);
      if (held.size === 1 && !(e.buttons & 2) && !e.shiftKey) this.orbit(dx, dy);
      else this.pan(dx / held.size, dy / held.size);
      if (held.size === 2) {
        const [a, b] = [...held.values()];
        const apart = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
        if (spread) this.zoom(spread / apart);
        spread = apart;
      }
    });
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoom(Math.exp(Math.max(-0.5, Math.min(0.5, e.deltaY * (e.deltaMode ? 0.03 : 0.0012)))));
    }, { passive: false });
    canvas.addEventListener("dblclick", () => this.reset());
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
  }

  orbit(dx, dy) {
    const { camera } = this.state;
    camera.azimuth -= dx * 0.008;
    camera.elevation = Math.max(-STEEPEST, Math.min(STEEPEST, camera.elevation + dy * 0.008));
    this.dirty = true;
  }

  pan(dx, dy) {
    const { camera } = this.state;
    const box = this.engine.canvas.getBoundingClientRect();
    const { view } = orbitCamera({ ...camera, width: 1, height: 1 });
    const metres = camera.distance / ((50 / 36) * Math.max(box.width, box.height));
    for (let a = 0; a < 3; a++) camera.target[a] -= metres * (view[a] * dx + view[4 + a] * dy);
    this.dirty = true;
  }

  zoom(factor) {
    const { camera } = this.state;
    camera.distance = Math.max(0.1, Math.min(100, camera.distance * factor));
    this.dirty = true;
  }

  async take(files) {
    for (const file of files) {
      try {
        const name = await this.engine.addFile(file);
        this.listMotions();
        await this.play(name);
        this.say([`${file.name} plays as '${name}'`, ...(this.engine.notes ?? [])]);
      } catch (error) {
        this.say([error.message], true);
      }
    }
  }

  drop() {
    const over = (on) => (e) => { e.preventDefault(); document.body.classList.toggle("over", on); };
    document.addEventListener("dragover", over(true));
    document.addEventListener("dragleave", over(false));
    document.addEventListener("drop", (e) => { over(false)(e); this.take([...e.dataTransfer.files]); });
  }

  save(blob, suffix) {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${this.engine.info.name}_${this.state.motion.name}${suffix}`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  async screenshot() {
    this.save(await this.engine.picture(this.view()), ".png");
  }

  // Start or end a recording of the canvas, in whatever video the browser can write.
  record() {
    if (this.recorder) { this.recorder.stop(); return; }
    const kind = ["video/mp4", "video/webm;codecs=vp9", "video/webm"].find((k) => window.MediaRecorder?.isTypeSupported(k));
    if (!kind) { this.say(["this browser cannot record a canvas"], true); return; }
    const parts = [];
    this.recorder = new MediaRecorder(this.engine.canvas.captureStream(), { mimeType: kind, videoBitsPerSecond: 8e6 });
    this.recorder.ondataavailable = (e) => parts.push(e.data);
    this.recorder.onstop = () => {
      this.recorder = null;
      this.find("record").classList.remove("on");
      this.save(new Blob(parts, { type: kind }), kind.includes("mp4") ? ".mp4" : ".webm");
    };
    this.recorder.start();
    this.find("record").classList.add("on");
  }

  async copyCommand() {
    const command = this.engine.command(this.view());
    try {
      await navigator.clipboard.writeText(command);
      this.say([`copied: ${command}`]);
    } catch {
      this.say([command]); // where a page may not write to the clipboard it can be marked and copied
    }
  }
}

// The command line that plays what a view shows, into a video or, where it is paused, into a picture. Cameras of its own
// stand level, so that how high and how far this one stands is left out.
export function playCommand(path, { motion, width, height, told }) {
  const word = (text) => (/^[\w./-]+$/.test(text) ? text : `'${text.replaceAll("'", `'\\''`)}'`);
  const degrees = ((told.azimuth * 180) / Math.PI).toFixed(0);
  const still = told.frame === null ? "" : ` --frames ${told.frame} --out ${word(`${motion}_${told.frame}.png`)}`;
  return `gavatar-play ${word(path)} --motion ${word(motion)} --camera ${degrees} --background ${told.color} --width ${width} --height ${height}${still}`;
}
