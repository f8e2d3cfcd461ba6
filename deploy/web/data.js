// The web avatar's data: a header and gzipped blocks, which arrive one after another. web/web_data.py writes them.

export const MAGIC = "GAVATWEB";

const KINDS = { f4: Float32Array, u1: Uint8Array, i1: Int8Array, u2: Uint16Array, i4: Int32Array };

export async function unzip(bytes) {
  if (typeof DecompressionStream === "undefined") {
    throw new Error("this browser is too old to unpack the avatar: use one of 2023 or later");
  }
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).arrayBuffer();
}

// Typed arrays of a buffer, as `layout` lists them: [{name, kind, shape, offset}].
export function arraysOf(buffer, layout) {
  const arrays = {};
  for (const { name, kind, shape, offset } of layout) {
    arrays[name] = new KINDS[kind](buffer, offset, shape.reduce((a, b) => a * b, 1));
  }
  return arrays;
}

// A source of blocks in a file of one piece, read as it comes: `header` and `block(k)` are promises.
export class FileSource {
  constructor(response, where) {
    this.where = where;
    this.waiting = [];
    this.bytes = new Uint8Array(0);
    this.header = new Promise((resolve, reject) => { this.found = resolve; this.failed = reject; });
    this.read(response).catch((error) => this.fail(error));
  }

  static from(url) {
    const source = new FileSource(fetch(url), String(url));
    return source;
  }

  fail(error) {
    this.error = error;
    this.failed(error);
    this.waiting.forEach((w) => w && w.reject(error));
  }

  async read(response) {
    const answer = await response;
    if (!answer.ok) throw new Error(`${this.where}: the server answers ${answer.status}`);
    const reader = answer.body.getReader();
    const parts = [];
    let total = 0, known = null, next = 0;
    for (;;) {
      const { done, value } = await reader.read();
      if (value) { parts.push(value); total += value.length; }
      if (known && !done && total < known.ends[next]) continue;
      const all = joined(parts, total);
      parts.length = 0;
      parts.push(all);
      if (!known && total >= 12) {
        if (new TextDecoder().decode(all.subarray(0, 8)) !== MAGIC) throw new Error(`${this.where} is no avatar of gavatar's web player`);
        const length = new DataView(all.buffer).getUint32(8, true);
        if (total >= 12 + length) {
          const header = JSON.parse(new TextDecoder().decode(all.subarray(12, 12 + length)));
          let at = 12 + length;
          known = { header, starts: [], ends: [] };
          for (const { size } of header.blocks) { known.starts.push(at); at += size; known.ends.push(at); }
          this.sizes = known;
          this.found(header);
        }
      }
      while (known && next < known.ends.length && total >= known.ends[next]) {
        this.give(next, all.subarray(known.starts[next], known.ends[next]));
        next++;
      }
      if (done) break;
    }
    if (!known || next < known.ends.length) throw new Error(`${this.where} ends too early: load it again`);
  }

  slot(k) {
    if (!this.waiting[k]) {
      const slot = {};
      slot.promise = new Promise((resolve, reject) => Object.assign(slot, { resolve, reject }));
      slot.promise.catch(() => {}); // told to whoever asks
      this.waiting[k] = slot;
      if (this.error) slot.reject(this.error);
    }
    return this.waiting[k];
  }

  give(k, bytes) { this.slot(k).resolve(bytes); }

  block(k) { return this.slot(k).promise.then(unzip); }
}

function joined(parts, total) {
  if (parts.length === 1) return parts[0];
  const all = new Uint8Array(total);
  let at = 0;
  for (const part of parts) { all.set(part, at); at += part.length; }
  return all;
}

// A source of blocks that stand in the page itself, base64 in elements, which the page announces as they are parsed.
export class PageSource {
  constructor(header) {
    this.header = Promise.resolve(header);
    this.slots = header.blocks.map(() => {
      const slot = {};
      slot.promise = new Promise((resolve) => { slot.resolve = resolve; });
      return slot;
    });
  }

  arrived(k, element) {
    this.slots[k].resolve(fromBase64(element.textContent));
    element.remove();
  }

  block(k) { return this.slots[k].promise.then(unzip); }
}

export function fromBase64(text) {
  const raw = atob(text.trim());
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return bytes;
}
