// What the page draws with where a server does: frames over a WebSocket, each asked for when the last was shown.
import { Controls, playCommand } from "./controls.js";
import { Drive } from "./drive.js";

const ENDED = "the connection to gavatar-view has ended: start it again and open the address that it prints";
const ASKED = 2; // frames under way: one travels while the next is drawn

export class RemoteEngine {
  constructor(canvas, address) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.address = address;
    this.number = 0;
    this.answers = new Map();
    this.asked = 0;
    this.frames = 0;
    this.last = 0;
    this.stages = {};
    this.gaussians = 0;
    this.onwrong = () => {}; // called with an Error of a frame, or of the connection
  }

  async open() {
    this.socket = new WebSocket(this.address);
    this.socket.binaryType = "arraybuffer";
    await new Promise((resolve, reject) => {
      this.socket.onopen = resolve;
      this.socket.onerror = () => reject(new Error("the viewer's server does not answer: is gavatar-view still running?"));
    });
    this.socket.onmessage = ({ data }) => (typeof data === "string" ? this.told(JSON.parse(data)) : this.frame(data));
    this.socket.onclose = () => this.lost();
    this.info = await this.ask({ do: "hello" });
    this.gaussians = this.info.gaussians;
    return this;
  }

  lost() {
    const error = new Error(ENDED);
    this.answers.forEach(({ reject }) => reject(error));
    this.answers.clear();
    this.asked = 0;
    this.onwrong(error);
  }

  ask(message, ...parts) {
    const id = ++this.number;
    if (this.socket.readyState !== WebSocket.OPEN) return Promise.reject(new Error(ENDED));
    const answer = new Promise((resolve, reject) => this.answers.set(id, { resolve, reject }));
    if (!parts.length) this.socket.send(JSON.stringify({ id, ...message }));
    else {
      const head = new TextEncoder().encode(JSON.stringify({ id, ...message }));
      this.socket.send(new Blob([new Uint32Array([head.length]), head, ...parts]));
    }
    return answer;
  }

  told({ id, ...result }) {
    const waiting = this.answers.get(id);
    if (!waiting) return;
    this.answers.delete(id);
    if ("error" in result) waiting.reject(new Error(result.error));
    else waiting.resolve(result);
  }

  ready() { return this.asked < ASKED && this.socket.readyState === WebSocket.OPEN; }

  motion(name) { return this.ask({ do: "motion", name }); }

  async addFile(file) {
    const { name, notes } = await this.ask({ name: file.name }, file);
    if (!this.info.motions.includes(name)) this.info.motions.push(name);
    this.notes = notes;
    return name;
  }

  draw(view) {
    this.asked++;
    const { told, ...wish } = view;
    this.ask({ do: "draw", ...wish }).catch(this.onwrong).finally(() => { this.asked = Math.max(0, this.asked - 1); });
  }

  async frame(data) {
    const length = new DataView(data).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const beside = head.live?.bytes ?? 0; // a picture of who drives the avatar comes after it
    const bytes = new Uint8Array(data, 4 + length, data.byteLength - 4 - length - beside);
    const waiting = this.answers.get(head.id);
    this.answers.delete(head.id);
    try {
      const picture = head.kind === "jpeg" ? await createImageBitmap(new Blob([bytes], { type: "image/jpeg" })) : pixels(head, bytes);
      if (head.id > this.last) { // decoding may end in another order
        this.last = head.id;
        this.show(head, picture);
        if (head.live) this.onlive?.(head.live, new Uint8Array(data, data.byteLength - beside));
      }
      waiting?.resolve(head);
    } catch (error) {
      waiting?.reject(new Error(`a frame cannot be shown: ${error.message}`));
    }
  }

  show(head, picture) {
    const { canvas, context } = this;
    if (canvas.width !== head.width || canvas.height !== head.height) {
      canvas.width = head.width;
      canvas.height = head.height;
    }
    if (picture instanceof ImageData) context.putImageData(picture, 0, 0);
    else { context.drawImage(picture, 0, 0); picture.close(); }
    this.frames++;
    this.stages = head.stages;
    this.gaussians = head.gaussians;
  }

  // The view without the losses of JPEG.
  async picture({ told, ...wish }) {
    await this.ask({ do: "draw", exact: true, ...wish });
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/png"));
  }

  stats() { return { drawn: this.frames, stages: this.stages, gaussians: this.gaussians }; }

  command(view) {
    return `${playCommand(this.info.path, view)} --tier ${view.tier}`;
  }
}

function pixels({ width, height }, bytes) {
  const image = new ImageData(width, height);
  for (let i = 0, k = 0; i < bytes.length; i += 3, k += 4) {
    image.data[k] = bytes[i];
    image.data[k + 1] = bytes[i + 1];
    image.data[k + 2] = bytes[i + 2];
    image.data[k + 3] = 255;
  }
  return image;
}

// Connects to the server that this page came from.
export async function openViewer() {
  const find = (name) => document.querySelector(`[data-part="${name}"]`);
  const token = new URLSearchParams(location.search).get("token");
  const address = `ws://${location.host}/socket?token=${encodeURIComponent(token)}`;
  const engine = new RemoteEngine(find("canvas"), address);
  const tell = (error) => {
    const line = document.createElement("p");
    line.className = "wrong";
    line.textContent = error.message;
    find("notes").replaceChildren(line);
  };
  engine.onwrong = tell;
  try {
    await engine.open();
    window.controls = new Controls(engine);
    if (engine.info.drive) window.drive = new Drive(engine, window.controls, () => new RemoteEngine(document.createElement("canvas"), address).open());
    await window.controls.play(engine.info.motions[0]);
  } catch (error) {
    tell(error);
  }
}
