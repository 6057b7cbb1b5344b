// Keys and what they do; the help sheet is made from this table, and the settings give them other keys.

import { keepKeys, ownKeys, setting } from "./settings.js";

// A jump is so many steps.
const JUMP = 5;

export const KEYS = [
  ["Space", "Play or stop, from the cursor to the end", "togglePlay"],
  ["Ctrl+Space", "Play or stop the selection", "togglePlaySel"],
  ["Ctrl+g", "Go to a time", "goto"],
  ["c", "Copy the time of the cursor", "copyTime"],
  ["Ctrl+a", "View everything", "zoomAll"],
  ["Ctrl+s", "Zoom to the selection", "zoomSel"],
  ["+", "Zoom in", "zoomIn"],
  ["-", "Zoom out", "zoomOut"],
  ["ArrowLeft", "Cursor a step back, or to the snapped stream's message before", "back"],
  ["ArrowRight", "Cursor a step on, or to the snapped stream's next message", "on"],
  ["Ctrl+,", "Cursor a step back", "back"],
  ["Ctrl+.", "Cursor a step on", "on"],
  ["Ctrl+Shift+,", "Cursor five steps back", "jumpBack"],
  ["Ctrl+Shift+.", "Cursor five steps on", "jumpOn"],
  ["PageUp", "View back", "panBack"],
  ["PageDown", "View on", "panOn"],
  ["Home", "Cursor to the start of the data", "home"],
  ["End", "Cursor to the end of the data", "end"],
  ["[", "Selection starts at the cursor", "selStart"],
  ["]", "Selection ends at the cursor", "selEnd"],
  ["Alt+s", "Cursor to the selection's start", "toSelStart"],
  ["Alt+e", "Cursor to the selection's end", "toSelEnd"],
  ["Alt+ArrowLeft", "Selection back by its length", "selBack"],
  ["Alt+ArrowRight", "Selection on by its length", "selOn"],
  ["Alt+c", "Clear the selection", "clearSel"],
  ["Ctrl+e", "Save the selection as a recording", "export"],
  ["Alt+f", "Cursor follows the mouse, or stays", "follow"],
  ["r", "Repeat playback", "repeat"],
  [",", "Half speed", "slower"],
  [".", "Double speed", "faster"],
  ["a", "Annotate the recording", "annotate"],
  ["k", "Comment on the selection, or on the cursor", "marker"],
  ["f", "Find the times where an expression is true", "find"],
  ["e", "Derive a stream by an expression over others", "derive"],
  ["v", "Compare with another recording", "compare"],
  ["g", "Share your cursor with others who look at this, or no longer", "together"],
  ["l", "Live on or off", "live"],
  ["n", "Cursor to the next change, of the snapped stream or the selected panel", "nextChange"],
  ["N", "Cursor to the change before", "previousChange"],
  ["m", "Fill the window with the selected panel, or back", "maximise"],
  ["b", "Pictures beside the timelines, or above them", "beside"],
  ["Ctrl+z", "Undo the last change of the layout or of annotations", "undo"],
  ["Ctrl+Shift+z", "Redo it", "redo"],
  ["u", "Times in UTC, local, or since the start", "timing"],
  ["Escape", "Restore a panel that fills the window", "restore"],
  ["/", "Search the streams", "search"],
  ["Ctrl+k", "Commands and streams", "palette"],
  ["t", "Dark or light", "theme"],
  ["s", "Show or hide the streams", "left"],
  ["p", "Show or hide the properties", "right"],
  ["o", "Settings", "settings"],
  ["?", "This sheet", "help"],
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

let table = null;

// The rows as they are now: [key, text, action, usual key].
export function keys() {
  const own = ownKeys();
  return KEYS.map(([usual, text, action]) => [own[usual] ?? usual, text, action, usual]);
}

// Gives what `usual` does another key; `null` gives it its own again. The text of the action that has the key already,
// or null when it is done.
export function giveKey(usual, key) {
  const own = { ...ownKeys() };
  const taken = keys().find(([k, , , u]) => k === (key ?? usual) && u !== usual);
  if (taken) return taken[1];
  if (key === null || key === usual) delete own[usual];
  else own[usual] = key;
  keepKeys(own);
  table = null;
  return null;
}

// All keys as they were.
export function usualKeys() {
  keepKeys({});
  table = null;
}

export function actionFor(e) {
  table ??= new Map(keys().map(([key, , action]) => [key, action]));
  return table.get(keyName(e));
}

// Time actions by name, as what the reducer takes.
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
      return { type: "nudge", by: -setting("step") };
    case "on":
      return { type: "nudge", by: setting("step") };
    case "jumpBack":
      return { type: "nudge", by: -JUMP * setting("step") };
    case "jumpOn":
      return { type: "nudge", by: JUMP * setting("step") };
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
      return { type: "live", on: s.mode !== "live", width: setting("live") };
    default:
      return null;
  }
}
