// The keys and their commands. The help is generated from this table, and the settings can reassign keys.

import { storeKeys, readKeys, readSetting } from "./settings.js";

// The number of steps of a jump.
const JUMP = 5;

/** @type {[key: string, text: string, action: string][]} */
export const KEYS = [
  ["Space", "Play from the cursor to the end, or stop", "togglePlay"],
  ["Ctrl+Space", "Play the selection, or stop", "togglePlaySel"],
  ["Ctrl+g", "Go to a time", "goto"],
  ["c", "Copy cursor time", "copyTime"],
  ["Ctrl+a", "View everything", "zoomAll"],
  ["Ctrl+s", "Zoom to the selection", "zoomSel"],
  ["+", "Zoom in", "zoomIn"],
  ["-", "Zoom out", "zoomOut"],
  ["ArrowLeft", "Step back, or to the previous message of the snapped stream", "back"],
  ["ArrowRight", "Step forward, or to the next message of the snapped stream", "on"],
  ["Ctrl+,", "Step back", "back"],
  ["Ctrl+.", "Step forward", "on"],
  ["Ctrl+Shift+,", "Five steps back", "jumpBack"],
  ["Ctrl+Shift+.", "Five steps forward", "jumpOn"],
  ["PageUp", "Move the view back", "panBack"],
  ["PageDown", "Move the view forward", "panOn"],
  ["Home", "Go to the start of the data", "home"],
  ["End", "Go to the end of the data", "end"],
  ["[", "Start the selection at the cursor", "selStart"],
  ["]", "End the selection at the cursor", "selEnd"],
  ["Alt+s", "Go to the start of the selection", "toSelStart"],
  ["Alt+e", "Go to the end of the selection", "toSelEnd"],
  ["Alt+ArrowLeft", "Move the selection back by its length", "selBack"],
  ["Alt+ArrowRight", "Move the selection forward by its length", "selOn"],
  ["Alt+c", "Clear the selection", "clearSel"],
  ["Ctrl+e", "Save the selection as a recording", "export"],
  ["Ctrl+Shift+e", "Save the selection as an HTML page", "savePage"],
  ["Alt+f", "Toggle whether the cursor follows the mouse", "follow"],
  ["r", "Repeat playback", "repeat"],
  [",", "Half speed", "slower"],
  [".", "Double speed", "faster"],
  ["a", "Annotate the recording or session", "annotate"],
  ["q", "Review proposed annotations one by one", "review"],
  ["Alt+PageDown", "Next session of the dataset", "nextSession"],
  ["Alt+PageUp", "Previous session of the dataset", "previousSession"],
  ["k", "Comment on the selection or the cursor's time", "marker"],
  ["i", "Measure the selection: values, slope and statistics", "measure"],
  ["B", "Bookmark the selection or the cursor's time", "bookmark"],
  ["M", "Show or hide the bookmarks", "bookmarks"],
  ["j", "Go to the next bookmark", "nextBookmark"],
  ["J", "Go to the previous bookmark", "previousBookmark"],
  ["f", "Find times when an expression is true", "find"],
  ["e", "Derive a stream with an expression", "derive"],
  ["v", "Compare with another recording", "compare"],
  ["g", "Share your cursor with other viewers, or stop sharing", "together"],
  ["l", "Toggle live mode", "live"],
  ["n", "Go to the next change of the snapped stream or the selected panel", "nextChange"],
  ["N", "Go to the previous change", "previousChange"],
  ["m", "Maximize the selected panel, or restore it", "maximise"],
  ["Ctrl+Shift+ArrowLeft", "Move the selected panel left", "panelLeft"],
  ["Ctrl+Shift+ArrowRight", "Move the selected panel right", "panelRight"],
  ["Ctrl+Shift+ArrowUp", "Move the selected panel up", "panelUp"],
  ["Ctrl+Shift+ArrowDown", "Move the selected panel down", "panelDown"],
  ["}", "Next tab of the selected panel", "nextTab"],
  ["{", "Previous tab of the selected panel", "previousTab"],
  ["Delete", "Close the selected panel", "closePanel"],
  ["b", "Images next to the timelines, or above them", "beside"],
  ["Ctrl+z", "Undo the last change of the layout or of annotations", "undo"],
  ["Ctrl+Shift+z", "Redo the change", "redo"],
  ["u", "Show times in UTC, local time, or since the start", "timing"],
  ["Escape", "Restore a maximized panel", "restore"],
  ["/", "Search the streams", "search"],
  ["Ctrl+k", "Commands and streams", "palette"],
  ["t", "Switch between dark and light", "theme"],
  ["s", "Show or hide the streams", "left"],
  ["p", "Show or hide the properties", "right"],
  ["o", "Settings", "settings"],
  ["?", "Show this help", "help"],
];

const SHIFTED = { "<": ",", ">": "." };

export function keyName(e) {
  let key = e.key === " " ? "Space" : e.key;
  const mods = [];
  if (e.ctrlKey || e.metaKey) mods.push("Ctrl");
  if (e.altKey) mods.push("Alt");
  if (e.shiftKey && (mods.length || key.length > 1)) {
    mods.push("Shift");
    key = SHIFTED[key] ?? key;
  }
  if (key.length === 1 && mods.length) key = key.toLowerCase();
  if (key === "=") key = "+";
  return [...mods, key].join("+");
}

/** @type {Map<string, string> | null} */
let table = null;

// Lists the current rows: [key, text, action, default key].
/** @returns {[key: string, text: string, action: string, usual: string][]} */
export function listKeys() {
  const own = readKeys();
  return KEYS.map(([usual, text, action]) => [own[usual] ?? usual, text, action, usual]);
}

// Assigns another key to the action of the default key `usual`; null restores the default. Returns null, or the text
// of the action that already has the key.
export function assignKey(usual, key) {
  const own = { ...readKeys() };
  const taken = listKeys().find(([k, , , u]) => k === (key ?? usual) && u !== usual);
  if (taken) return taken[1];
  if (key === null || key === usual) delete own[usual];
  else own[usual] = key;
  storeKeys(own);
  table = null;
  return null;
}

// Restores the default keys.
export function resetKeys() {
  storeKeys({});
  table = null;
}

export function findAction(e) {
  table ??= new Map(listKeys().map(([key, , action]) => [key, action]));
  return table.get(keyName(e));
}

// Returns the reducer action of a time command, or null.
export function timeAction(name, s) {
  const w = s.view[1] - s.view[0];
  switch (name) {
    case "togglePlay":
      return { type: s.mode === "play" ? "stop" : "playView" };
    case "togglePlaySel":
      return { type: s.mode === "play" ? "stop" : "playSel" };
    case "zoomAll":
    case "zoomSel":
    case "clearSel":
    case "follow":
    case "repeat":
    case "toSelStart":
    case "toSelEnd":
      return { type: name };
    case "zoomIn":
      return { type: "zoomAt", t: s.cursor, factor: 1 / 1.5 };
    case "zoomOut":
      return { type: "zoomAt", t: s.cursor, factor: 1.5 };
    case "back":
      return { type: "nudge", by: -readSetting("step") };
    case "on":
      return { type: "nudge", by: readSetting("step") };
    case "jumpBack":
      return { type: "nudge", by: -JUMP * readSetting("step") };
    case "jumpOn":
      return { type: "nudge", by: JUMP * readSetting("step") };
    case "panBack":
      return { type: "pan", by: -w / 2 };
    case "panOn":
      return { type: "pan", by: w / 2 };
    case "home":
      return { type: "nudge", by: s.data[0] - s.cursor };
    case "end":
      return { type: "nudge", by: s.data[1] - s.cursor };
    case "selStart":
      return { type: "selStart", t: s.cursor };
    case "selEnd":
      return { type: "selEnd", t: s.cursor };
    case "selBack":
      return { type: "shiftSel", dir: -1 };
    case "selOn":
      return { type: "shiftSel", dir: 1 };
    case "normalSpeed":
      return { type: "speed", value: 1 };
    case "slower":
      return { type: "speed", value: s.speed / 2 };
    case "faster":
      return { type: "speed", value: s.speed * 2 };
    case "live":
      return { type: "live", on: s.mode !== "live", width: readSetting("live") };
    default:
      return null;
  }
}
