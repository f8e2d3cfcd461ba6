// The avatar beside the person who drives it: the picture with its landmarks, and this page's own camera.

const SIDE = 480; // pixels of the longer side of a picture that is sent
const SURE = 0.3; // least visibility of a landmark that is drawn

export class Drive {
  // engine: a RemoteEngine. controls: of the page. connect: opens another connection to the same server.
  constructor(engine, controls, connect) {
    Object.assign(this, { engine, controls, connect, told: engine.info.drive, camera: null, sent: new Map() });
    this.figure = document.createElement("figure");
    this.figure.dataset.part = "live";
    this.figure.hidden = true;
    this.inset = document.createElement("canvas");
    this.caption = document.createElement("figcaption");
    this.figure.append(this.inset, this.caption);
    document.body.insertBefore(this.figure, document.querySelector("footer"));
    if (this.told.camera) this.offer();
    engine.onlive = (live, picture) => this.show(live, picture);
    this.keepOn();
  }

  get on() { return this.controls.state.motion?.name === this.told.motion; }

  offer() {
    this.button = document.createElement("button");
    this.button.dataset.part = "camera";
    this.button.textContent = "Use my camera";
    this.button.title = "The avatar does as you do";
    this.button.addEventListener("click", () => (this.camera ? this.stop() : this.start()));
    document.querySelector(".buttons").append(this.button);
  }

  // A live avatar moves without a clock: each frame asks for what is newest.
  keepOn() {
    if (this.on && this.controls.state.playing) this.controls.dirty = true;
    if (this.figure.hidden === this.on) this.figure.hidden = !this.on;
    requestAnimationFrame(() => this.keepOn());
  }

  async show(live, bytes) {
    let picture = this.sent.get(live.tag);
    if (bytes.length) picture = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    this.live = live;
    if (picture) {
      const { inset } = this, context = inset.getContext("2d");
      if (inset.width !== picture.width || inset.height !== picture.height) [inset.width, inset.height] = [picture.width, picture.height];
      context.drawImage(picture, 0, 0);
      this.mark(context, live);
      if (bytes.length) picture.close();
    }
    const late = Date.now() / 1000 - live.taken;
    const delay = late > 0 && late < 10 ? `  ${(late * 1000).toFixed(0)} ms` : ""; // another machine's clock may differ
    const again = live.round > 1 ? `  (round ${live.round})` : "";
    this.delay = late;
    this.caption.textContent = `${live.source || "camera"}: ${live.state}${delay}${again}`;
  }

  mark(context, { points, lines }) {
    const { width, height } = context.canvas;
    const seen = (k) => points[k] && points[k][2] > SURE;
    context.lineWidth = Math.max(1, width / 160);
    context.strokeStyle = "#0c6";
    context.fillStyle = "#fff";
    context.beginPath();
    for (const [a, b] of lines) {
      if (!seen(a) || !seen(b)) continue;
      context.moveTo(points[a][0] * width, points[a][1] * height);
      context.lineTo(points[b][0] * width, points[b][1] * height);
    }
    context.stroke();
    points.forEach(([x, y], k) => { if (seen(k)) context.fillRect(x * width - 1, y * height - 1, 3, 3); });
  }

  async start() {
    try {
      if (!navigator.mediaDevices) throw new Error("a browser gives its camera only to pages of this machine or by https: forward the port by ssh");
      this.camera = await navigator.mediaDevices.getUserMedia({ video: { width: { ideal: 640 }, height: { ideal: 480 }, frameRate: { ideal: 30 } } });
      this.button.textContent = "Stop my camera";
      this.button.classList.add("on");
      const video = Object.assign(document.createElement("video"), { srcObject: this.camera, muted: true, playsInline: true });
      await video.play();
      const line = await this.connect();
      const { motions } = this.engine.info;
      if (!motions.includes(this.told.motion)) motions.unshift(this.told.motion);
      this.controls.listMotions();
      this.send(video, line);
      await this.controls.play(this.told.motion);
      this.controls.reset();
    } catch (error) {
      this.stop();
      this.controls.say([error.name === "NotAllowedError" ? "the browser was not allowed to use the camera" : error.message], true);
    }
  }

  // One picture after the other, each when the last was looked at.
  async send(video, line) {
    const camera = this.camera;
    const factor = Math.min(1, SIDE / Math.max(video.videoWidth, video.videoHeight));
    const size = [video.videoWidth, video.videoHeight].map((side) => Math.max(1, Math.round(side * factor)));
    try {
      while (this.camera === camera) {
        await new Promise((resolve) => (video.requestVideoFrameCallback ? video.requestVideoFrameCallback(resolve) : requestAnimationFrame(resolve)));
        const picture = document.createElement("canvas");
        [picture.width, picture.height] = size;
        picture.getContext("2d").drawImage(video, 0, 0, ...size);
        const blob = await new Promise((resolve) => picture.toBlob(resolve, "image/jpeg", 0.8));
        this.sent.set(line.number + 1, picture); // by the number that its message will have
        for (const number of this.sent.keys()) if (number < line.number - 8) this.sent.delete(number);
        await line.ask({ do: "camera" }, blob);
      }
    } catch (error) {
      if (this.camera === camera) { this.stop(); this.controls.say([error.message], true); }
    }
    line.socket.close();
  }

  stop() {
    this.camera?.getTracks().forEach((track) => track.stop());
    this.camera = null;
    this.button.textContent = "Use my camera";
    this.button.classList.remove("on");
  }
}
