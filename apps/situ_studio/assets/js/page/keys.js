// Keys and what they do; the help sheet is made from this table.

const FRAME = 1e9 / 30;
const JUMP = 1e9 / 6;

export const KEYS = [
  ["Space", "Play or stop, from the cursor to the end", "togglePlay"],
  ["Ctrl+Space", "Play or stop the selection", "togglePlaySel"],
  ["Ctrl+g", "Go to a time", "goto"],
  ["c", "Copy the time of the cursor", "copyTime"],
  ["Ctrl+a", "View everything", "zoomAll"],
  ["Ctrl+s", "Zoom to the selection", "zoomSel"],
  ["+", "Zoom in", "zoomIn"],
  ["-", "Zoom out", "zoomOut"],
  ["ArrowLeft", "Cursor back 1/30 s, or to the snapped stream's message before", "back"],
  ["ArrowRight", "Cursor on 1/30 s, or to the snapped stream's next message", "on"],
  ["Ctrl+,", "Cursor back 1/30 s", "back"],
  ["Ctrl+.", "Cursor on 1/30 s", "on"],
  ["Ctrl+Shift+,", "Cursor back 1/6 s", "jumpBack"],
  ["Ctrl+Shift+.", "Cursor on 1/6 s", "jumpOn"],
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
  ["l", "Live on or off", "live"],
  ["n", "Cursor to the next change, of the snapped stream or the selected panel", "nextChange"],
  ["N", "Cursor to the change before", "previousChange"],
  ["m", "Fill the window with the selected panel, or back", "maximise"],
  ["b", "Pictures beside the timelines, or above them", "beside"],
  ["Ctrl+z", "Undo a change of the layout", "undo"],
  ["Ctrl+Shift+z", "Redo it", "redo"],
  ["u", "Times in UTC, local, or since the start", "timing"],
  ["Escape", "Restore a panel that fills the window", "restore"],
  ["/", "Search the streams", "search"],
  ["Ctrl+k", "Commands and streams", "palette"],
  ["t", "Dark or light", "theme"],
  ["s", "Show or hide the streams", "left"],
  ["p", "Show or hide the properties", "right"],
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

const table = new Map(KEYS.map(([name, , action]) => [name, action]));

export function actionFor(e) {
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
      return { type: "nudge", by: -FRAME };
    case "on":
      return { type: "nudge", by: FRAME };
    case "jumpBack":
      return { type: "nudge", by: -JUMP };
    case "jumpOn":
      return { type: "nudge", by: JUMP };
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
      return { type: "live", on: s.mode !== "live" };
    default:
      return null;
  }
}
