// The settings of this browser. The settings page is generated from this table.

const KEY = "situ:settings";

const SECOND = 1e9;

// Either choices [[value, text]] or a boolean; `usual` is the default. Values outside of the choices are ignored.
/**
 * @typedef {object} Setting
 * @property {string} id
 * @property {string} title
 * @property {any} usual
 * @property {[value: string | number, text: string][]} [choices]
 */

/** @type {Setting[]} */
export const SETTINGS = [
  {
    id: "theme",
    title: "Light or dark",
    usual: "system",
    choices: [
      ["system", "system"],
      ["dark", "dark"],
      ["light", "light"],
    ],
  },
  {
    id: "palette",
    title: "Stream colors",
    usual: "usual",
    choices: [
      ["usual", "usual"],
      ["safe", "color-blind safe"],
      ["strong", "high contrast"],
    ],
  },
  {
    id: "clock",
    title: "Times",
    usual: "start",
    choices: [
      ["start", "since the start"],
      ["utc", "UTC"],
      ["local", "local"],
      ["selection", "since the selection's start"],
    ],
  },
  {
    id: "first",
    title: "Start page",
    usual: "list",
    choices: [
      ["list", "the list of recordings"],
      ["last", "most recently viewed"],
    ],
  },
  { id: "follow", title: "The cursor follows the mouse", usual: true },
  {
    id: "wheel",
    title: "The mouse wheel",
    usual: "zoom",
    choices: [
      ["zoom", "zooms; with Ctrl it scrolls"],
      ["scroll", "scrolls; with Ctrl it zooms"],
    ],
  },
  {
    id: "step",
    title: "The arrow keys move the cursor by",
    usual: SECOND / 30,
    choices: [
      [SECOND / 100, "10 ms"],
      [SECOND / 60, "1/60 s"],
      [SECOND / 30, "1/30 s"],
      [SECOND / 25, "1/25 s"],
      [SECOND / 10, "100 ms"],
      [SECOND, "1 s"],
    ],
  },
  {
    id: "live",
    title: "Time span of a live view",
    usual: 30 * SECOND,
    choices: [
      [10 * SECOND, "10 s"],
      [30 * SECOND, "30 s"],
      [60 * SECOND, "1 min"],
      [300 * SECOND, "5 min"],
    ],
  },
];

const known = new Map(SETTINGS.map((s) => [s.id, s]));
const listeners = new Set();

// Stored separately by older pages; the script that runs before the first paint reads them there.
const APART = { theme: "situ:theme", clock: "situ:clock" };

function readStored() {
  try {
    const found = JSON.parse(localStorage.getItem(KEY) ?? "{}");
    return found && typeof found === "object" ? found : {};
  } catch {
    return {};
  }
}

function storeItem(name, value) {
  try {
    if (value === null) localStorage.removeItem(name);
    else localStorage.setItem(name, value);
  } catch {
    // private windows may have no storage; the page then uses the defaults
  }
}

/** @param {Setting} setting @param {any} value */
const isValid = ({ choices, usual }, value) =>
  choices ? choices.some(([v]) => v === value) : typeof value === typeof usual;

/** @param {string} id */
function findSetting(id) {
  const setting = known.get(id);
  if (!setting) throw new Error(`there is no setting ${id}`);
  return setting;
}

export function readSetting(id) {
  const one = findSetting(id);
  let value = readStored()[id];
  if (APART[id]) {
    try {
      value = localStorage.getItem(APART[id]);
    } catch {
      value = null;
    }
  }
  return isValid(one, value) ? value : one.usual;
}

export function changeSetting(id, value) {
  if (APART[id]) storeItem(APART[id], value === findSetting(id).usual ? null : value);
  else {
    const all = readStored();
    if (value === findSetting(id).usual) delete all[id];
    else all[id] = value;
    storeItem(KEY, JSON.stringify(all));
  }
  for (const l of listeners) l(id, value);
}

export function onSetting(listener) {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

// Returns the reassigned keys: {default key: key}.
export function readKeys() {
  const { keys } = readStored();
  return keys && typeof keys === "object" ? keys : {};
}

export function storeKeys(keys) {
  storeItem(KEY, JSON.stringify({ ...readStored(), keys }));
}
