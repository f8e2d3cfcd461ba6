// Which joint of somebody's rig is which joint of the SMPL family, told by their names. As rigs/rig_names.py tells it.

const LIMBS = { // of what a name is without side and prefix, lower case, letters and digits; the first that there is
  hip: ["upleg", "upperleg", "upperlegs", "thigh", "femur", "hip"],
  knee: ["lowleg", "lowerleg", "lowerlegs", "shin", "calf", "knee", "tibia", "leg"],
  ankle: ["ankle", "foot"],
  foot: ["toebase", "toe", "toe0", "toes", "ball", "foot"],
  collar: ["collar", "clavicle", "scapula", "thorax", "shoulder"],
  shoulder: ["upperarm", "uparm", "uarm", "arm", "humerus", "shldr", "shoulder"],
  elbow: ["forearm", "lowerarm", "lowarm", "farm", "elbow", "radius"],
  wrist: ["wrist", "hand"],
};
const CENTRE = {
  neck: ["neck", "neck1", "neck01", "lowerneck", "necklower", "necktwist01"],
  head: ["head", "head1", "head01"],
};
const FINGER_WORDS = { index: "index", middle: "middle|mid", ring: "ring", pinky: "pinky|pinkie|little", thumb: "thumb" };
const SHINS = ["lowleg", "lowerleg", "lowerlegs", "shin", "calf", "knee", "tibia"];
const ORDER = ["shoulder", "hip", "collar", "knee", "ankle", "foot", "elbow", "wrist"];
const S = "[_\\s.\\-]";
const PREFIX = new RegExp(`^(mixamorig\\d*|character\\d*|bip\\d*|valvebiped|armature|def|org|c|j|jnt|joint|bone|bn|b|cc_base|m_avg)${S}+`, "i");
const MIDDLE = new RegExp(`^(c|m|x|mid|center|centre)${S}+|${S}+(c|m|x|mid|center|centre)$`, "gi");
const OF_LIMBS = /(stretch|bend|fk|bone|0*1)$/; // the first of several bones of a limb, or of a control rig's
const WORDS = [...new Set(Object.values(LIMBS).flat())].sort((a, b) => b.length - a.length);
const SHARED = 0.7; // of the names of a rig have what is taken for its prefix
const SIDE_FORMS = ["left", "right"].map((side) => {
  const word = [...side].map((c) => `[${c}${c.toUpperCase()}]`).join(""), c = side[0], C = c.toUpperCase();
  const forms = [
    `${word}${S}*(.*)`, `(.*?)${S}*${word}`, `[${c}${C}]${S}+(.*)`, `(.*?)${S}+[${c}${C}](?:[_.\\-]\\d+)?`, `[${c}${C}]([A-Z].*)`,
    `${c}(${WORDS.join("|")})`, `(.*[a-z])${C}`,
  ];
  return [side, forms.map((form) => new RegExp(`^(?:${form})$`))];
});

// A rig's joint name: [its side, left, right or "", and what it is].
export function splitName(name) {
  let bare = name.trim().replace(/^.*[:|]/, "");
  for (let shorter = bare.replace(PREFIX, ""); shorter && shorter !== bare; shorter = bare.replace(PREFIX, "")) bare = shorter;
  bare = bare.replace(/^mixamorig/, "");
  const plain = (what) => what.toLowerCase().replace(/[^a-z0-9]/g, "");
  for (const [side, forms] of SIDE_FORMS) {
    const found = forms.map((form) => form.exec(bare)).find(Boolean);
    if (found?.[1]) return [side, plain(found[1])];
  }
  return ["", plain(bare.replace(MIDDLE, ""))];
}

// The names without a beginning or an end that most of them share, and without numbers that nearly every one ends with.
function bareNames(given) {
  let names = given;
  const short = names.map((name) => name.replace(/_\d{1,4}$/, ""));
  const numbered = names.filter((name, j) => name !== short[j]);
  const told = new Set(numbered).size === numbered.length && new Set(short).size === names.length;
  if (numbered.length >= SHARED * names.length && told) names = short;
  const backwards = (text) => [...text].reverse().join("");
  const start = sharedStart(names), end = backwards(sharedStart(names.map(backwards)));
  names = names.map((name) => (start && name.startsWith(start) && name.slice(start.length)) || name);
  return names.map((name) => (end && name.endsWith(end) && name.slice(0, -end.length)) || name);
}

function sharedStart(names) {
  let start = "", longest = "";
  for (;;) {
    const counts = new Map();
    for (const name of names) {
      if (name.startsWith(start) && name.length > start.length) counts.set(name[start.length], (counts.get(name[start.length]) ?? 0) + 1);
    }
    const [letter, count] = [...counts].reduce((best, one) => (one[1] > best[1] ? one : best), ["", 0]);
    if (!letter || count < SHARED * names.length) break;
    start += letter;
    if (/^[:|_\s.\-]$/.test(letter)) longest = start;
  }
  if (!longest && names.length > 3 && names.every((name) => name.startsWith(start))) longest = start;
  const sides = longest.toLowerCase().split(/[:|_\s.\-]/);
  return ["l", "r", "left", "right", "tfel", "thgir"].some((side) => sides.includes(side)) ? "" : longest;
}

// By SMPL-H name the joint of the rig, as a Map; always with the pelvis: the joint that both legs hang from.
export function matchRig(names, parents) {
  const split = bareNames(names).map(splitName);
  const found = new Map([["pelvis", 0]]);
  for (const side of ["left", "right"]) {
    const mine = new Map();
    for (let j = split.length - 1; j >= 0; j--) if (split[j][0] === side) mine.set(split[j][1], j);
    const otherwise = (what, j) => { if (!mine.has(what)) mine.set(what, j); };
    for (const [what, j] of [...mine]) otherwise(what.replace(OF_LIMBS, ""), j);
    if (mine.has("leg") && SHINS.some((shin) => mine.has(shin))) otherwise("upleg", mine.get("leg"));
    const taken = new Set();
    for (const part of ORDER) {
      const single = part === "collar" && found.get(`${side}_shoulder`) === mine.get("shoulder");
      const words = single ? LIMBS[part].slice(0, -1) : LIMBS[part];
      const word = words.find((w) => mine.has(w) && !taken.has(mine.get(w)));
      if (word === undefined) continue;
      found.set(`${side}_${part}`, mine.get(word));
      taken.add(mine.get(word));
    }
    for (const [name, j] of fingersOf(mine)) found.set(`${side}_${name}`, j);
  }
  for (const [part, words] of Object.entries(CENTRE)) {
    const word = words.find((w) => split.some(([side, what]) => !side && what === w));
    if (word !== undefined) found.set(part, split.findIndex(([side, what]) => !side && what === word));
  }
  for (const [name, j] of neckAndHead(found, split, parents)) found.set(name, j);
  return found.set("pelvis", pelvisOf(found, parents));
}

function fingersOf(mine) {
  const out = new Map();
  for (const [finger, words] of Object.entries(FINGER_WORDS)) {
    const form = new RegExp(`^(?:hand|finger|f)?(?:${words})(?:finger)?(?:proximal|meta)?0?(\\d?)$`);
    for (const [what, j] of mine) {
      const match = form.exec(what), name = `${finger}${match?.[1] || 1}`;
      if (match && "123".includes(match[1] || "1") && !out.has(name)) out.set(name, j);
    }
  }
  return out;
}

// Neck and head that have no such name: the first and the last of the longest row of joints in the middle that leaves
// the shoulders' last common joint.
function neckAndHead(found, split, parents) {
  if ((found.has("neck") && found.has("head")) || !found.has("left_shoulder") || !found.has("right_shoulder")) return [];
  const above = (j) => { const line = []; for (let k = j; k >= 0; k = parents[k]) line.push(k); return line; };
  const lines = ["left", "right"].map((side) => above(found.get(`${side}_shoulder`)));
  const chest = lines[0].find((joint) => lines[1].includes(joint)) ?? -1;
  const arms = new Set(lines.flat());
  const rows = parents.map((_, j) => above(j)).filter((line) => line.indexOf(chest) > 0)
    .map((line) => line.reverse()).map((line) => line.slice(line.indexOf(chest) + 1))
    .filter((line) => line.every((j) => !split[j][0] && !arms.has(j)));
  let longest = rows.reduce((best, line) => (line.length > best.length ? line : best), []);
  if (found.has("head") || !longest.length) {
    const line = found.has("head") ? above(found.get("head")).reverse() : [];
    const neck = line.includes(chest) ? line.slice(line.indexOf(chest) + 1) : [];
    return neck.length > 1 && !found.has("neck") ? [["neck", neck[0]]] : [];
  }
  if (found.has("neck")) {
    longest = longest.includes(found.get("neck")) ? longest.slice(longest.indexOf(found.get("neck")) + 1) : [];
    return longest.length ? [["head", longest[longest.length - 1]]] : [];
  }
  const head = ["head", longest[longest.length - 1]];
  return longest.length > 1 ? [head, ["neck", longest[0]]] : [head];
}

// The lowest joint above both hips, 0 where they are not known.
function pelvisOf(found, parents) {
  if (!found.has("left_hip") || !found.has("right_hip")) return 0;
  const lines = ["left_hip", "right_hip"].map((hip) => {
    const line = [];
    for (let j = parents[found.get(hip)]; j >= 0; j = parents[j]) line.push(j);
    return line;
  });
  return lines[0].find((joint) => lines[1].includes(joint)) ?? 0;
}
