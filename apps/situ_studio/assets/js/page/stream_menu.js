// The menus of the tree's rows: of a stream, of a group.

import { ask } from "./ask.js";
import { commands } from "./commands.js";
import { copy } from "./toast.js";

// Streams that say what is the case, or how likely (`Situ.Studio.Annotating.Proposals`).
const PROPOSING = ["boolean", "state", "states", "text", "spans", "signal", "signals"];

async function propose(app, stream, shape) {
  let threshold;
  if (shape === "signal" || shape === "signals") {
    const said = await ask({
      title: `Propose annotations where ${stream} is at least`,
      value: "0.5",
      type: "number",
    });
    if (!said || !said.text.trim()) return;
    threshold = Number(said.text);
  }
  app.options.push?.("annotation_propose", { stream, threshold });
}

// Panels that take more than one stream, as `Situ.Studio.Layout` joins them.
const JOINED = ["plot", "lanes", "image", "space", "map", "xy"];

export function streamItems(app, node) {
  const { stream, shape, type, path, address } = node.dataset;
  const push = (event, more = {}) => app.options.push?.(event, { stream, ...more });
  const kinds = JSON.parse(document.getElementById("stream-names")?.dataset.kinds ?? "{}")[shape] ?? [];
  const chosen = app.root.querySelector("[data-panel].selected");
  const of = chosen?.querySelector("[phx-hook='Panel']")?.dataset.kind;
  const joining = JOINED.includes(of) ? kinds.filter(([, , panel]) => panel === of) : [];
  return [
    ...joining.map(([viz, title]) => ({
      text: `Show in the selected panel as ${title.toLowerCase()}`,
      run: () => push("add_viz", { viz, panel: chosen.dataset.panel }),
    })),
    ...(joining.length ? ["-"] : []),
    ...kinds.map(([viz, title]) => ({ text: `Show as ${title.toLowerCase()}`, run: () => push("add_viz", { viz }) })),
    "-",
    { text: "Derive from it…", hint: "e", run: () => commands.derive(app, derivation(stream)) },
    ...(["value", "signals", "states", "bars", "space", "frames", "place", "shapes", "spans"].includes(shape)
      ? [{ text: "Derive its members", run: () => push("derive_members") }]
      : []),
    "-",
    { text: "Properties", run: () => properties(app, { path: stream }) },
    { text: "Zoom to it", run: () => push("zoom_stream") },
    { text: app.client.snap === stream ? "Release the cursor" : "Snap the cursor to it", run: () => push("snap") },
    ...(app.annotation && PROPOSING.includes(shape)
      ? [{ text: "Propose annotations from it", run: () => propose(app, stream, shape) }]
      : []),
    "-",
    ...folding(app, node),
    { text: "Copy its name", run: () => copy(stream, "Name copied") },
    { text: "Copy its name in expressions", run: () => copy(derivation(stream), "Name copied") },
    ...(address ? [{ text: `Copy ${short(address)}`, run: () => copy(address, "Name copied") }] : []),
    ...(path ? [{ text: "Copy the path of its recording", run: () => copy(path, "Path copied") }] : []),
    ...(type ? [{ text: `Copy its type: ${short(type)}`, run: () => copy(type, "Type copied") }] : []),
  ];
}

// Who asks for them gets to see them, also where that side is hidden.
function properties(app, what) {
  document.documentElement.dataset.right = "open";
  app.options.push?.("select", what);
}

export function groupItems(app, node) {
  const { group: path } = node.dataset;
  return [
    { text: "Properties", run: () => properties(app, { path, only: true }) },
    "-",
    ...folding(app, node),
    { text: "Copy its name", run: () => copy(path, "Name copied") },
  ];
}

// Of a row that others stand under.
function folding(app, node) {
  const { group: path } = node.dataset;
  if (!path) return [];
  const all = (open) => () => app.options.push?.("fold_below", { path, open });
  const open = node.getAttribute("aria-expanded") === "true";
  return [
    { text: open ? "Fold it" : "Unfold it", run: () => app.options.push?.("toggle", { path }) },
    { text: "Fold all below it", run: all(false) },
    { text: "Unfold all below it", run: all(true) },
    "-",
  ];
}

const short = (text) => (text.length > 32 ? `${text.slice(0, 31)}…` : text);

// A stream's name in an expression; for a derived stream its expression, to be changed.
const derivation = (stream) => (stream.startsWith("= ") ? stream.slice(2) : `\`${stream}\``);
