// Builds the context menus of the stream tree: of a stream, and of a group.

import { askText } from "./questions.js";
import { commands } from "./commands.js";
import { copyText } from "./toast.js";

// Stream shapes from which annotations can be proposed: states and probabilities
// (`Situ.Studio.Annotations.Proposals`).
const PROPOSING = ["boolean", "state", "states", "text", "spans", "signal", "signals"];

async function proposeAnnotations(app, stream, shape) {
  let threshold;
  if (shape === "signal" || shape === "signals") {
    const said = await askText({
      title: `Propose annotations where ${stream} is at least`,
      value: "0.5",
      type: "number",
    });
    if (!said || !said.text.trim()) return;
    threshold = Number(said.text);
  }
  app.options.push?.("annotation_propose", { stream, threshold });
}

// Panels that accept several streams, as joined by `Situ.Studio.Layout`.
const JOINED = ["plot", "lanes", "image", "space", "map", "xy", "table"];

export function streamItems(app, node) {
  const { stream, shape, type, path, address } = node.dataset;
  const pushEvent = (event, more = {}) => app.options.push?.(event, { stream, ...more });
  const kinds = JSON.parse(document.getElementById("stream-names")?.dataset.kinds ?? "{}")[shape] ?? [];
  const chosen = app.root.querySelector("[data-panel].selected");
  const of = chosen?.querySelector("[phx-hook='Panel']")?.dataset.kind;
  const joining = JOINED.includes(of) ? kinds.filter(([, , panel]) => panel === of) : [];
  return [
    ...joining.map(([viz, title]) => ({
      text: `Show in the selected panel as ${title.toLowerCase()}`,
      run: () => pushEvent("add_viz", { viz, panel: chosen.dataset.panel }),
    })),
    ...(joining.length ? ["-"] : []),
    ...kinds.map(([viz, title]) => ({
      text: `Show as ${title.toLowerCase()}`,
      run: () => pushEvent("add_viz", { viz }),
    })),
    "-",
    { text: "Derive from this stream…", hint: "e", run: () => commands.derive(app, expressionName(stream)) },
    ...(["value", "signals", "states", "bars", "space", "frames", "place", "shapes", "spans"].includes(shape)
      ? [{ text: "Derive all members", run: () => pushEvent("derive_members") }]
      : []),
    "-",
    { text: "Properties", run: () => showProperties(app, { path: stream }) },
    { text: "Zoom to stream", run: () => pushEvent("zoom_stream") },
    {
      text: app.client.snap === stream ? "Release the cursor" : "Snap the cursor to this stream",
      run: () => pushEvent("snap"),
    },
    ...(app.annotation && PROPOSING.includes(shape)
      ? [{ text: "Propose annotations from this stream", run: () => proposeAnnotations(app, stream, shape) }]
      : []),
    "-",
    ...foldItems(app, node),
    { text: "Copy name", run: () => copyText(stream, "Name copied") },
    { text: "Copy name for expressions", run: () => copyText(expressionName(stream), "Name copied") },
    ...(address ? [{ text: `Copy ${shortenText(address)}`, run: () => copyText(address, "Name copied") }] : []),
    ...(path ? [{ text: "Copy recording path", run: () => copyText(path, "Path copied") }] : []),
    ...(type ? [{ text: `Copy type: ${shortenText(type)}`, run: () => copyText(type, "Type copied") }] : []),
  ];
}

// Shows the properties, and opens their sidebar if it is hidden.
function showProperties(app, what) {
  document.documentElement.dataset.right = "open";
  app.options.push?.("select", what);
}

export function groupItems(app, node) {
  const { group: path } = node.dataset;
  return [
    { text: "Properties", run: () => showProperties(app, { path, only: true }) },
    "-",
    ...foldItems(app, node),
    { text: "Copy name", run: () => copyText(path, "Name copied") },
  ];
}

// Entries of a row that has children.
function foldItems(app, node) {
  const { group: path } = node.dataset;
  if (!path) return [];
  const foldAll = (open) => () => app.options.push?.("fold_below", { path, open });
  const open = node.getAttribute("aria-expanded") === "true";
  return [
    { text: open ? "Fold" : "Unfold", run: () => app.options.push?.("toggle", { path }) },
    { text: "Fold all below", run: foldAll(false) },
    { text: "Unfold all below", run: foldAll(true) },
    "-",
  ];
}

const shortenText = (text) => (text.length > 32 ? `${text.slice(0, 31)}…` : text);

// Returns a stream's name in expressions; for a derived stream, its expression.
const expressionName = (stream) => (stream.startsWith("= ") ? stream.slice(2) : `\`${stream}\``);
