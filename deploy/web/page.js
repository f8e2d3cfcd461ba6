// The page of the web player.
import { PageSource } from "./data.js";
import { load } from "./avatar.js";
import { Controls } from "./controls.js";
import { LocalEngine } from "./engine.js";

// source: of data.js, or the address of an avatar.bin. Returns the controls, once the first Gaussians are there.
export async function openPage(source) {
  const find = (name) => document.querySelector(`[data-part="${name}"]`);
  try {
    const avatar = await load(source, { canvas: find("canvas"), progress: ({ error }) => { if (error) tell(error); } });
    const controls = new Controls(new LocalEngine(avatar));
    await controls.play(avatar.motionNames[0]);
    return controls;
  } catch (error) {
    tell(error);
    throw error;
  }
}

function tell(error) {
  const line = document.createElement("p");
  line.className = "wrong";
  line.textContent = error.message;
  document.querySelector('[data-part="notes"]').replaceChildren(line);
}

export function pageSource(header) { return new PageSource(header); }
