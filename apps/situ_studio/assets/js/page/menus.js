// Builds the entries of the context menus: of a stream, a panel, a legend entry, a time, a recording.

import { GUTTER } from "./theme.js";
import { copyText } from "./toast.js";
import { canDrawVector, saveImage, saveVector } from "./image_file.js";
import { measureSelection } from "./panel_commands.js";
import { selectedPart } from "./selection.js";
import { groupItems, streamItems } from "./stream_menu.js";
import { annotationItems } from "../annotation/menu.js";

// Drawers that show the message at the cursor.
const HELD = ["image", "depth", "shapes", "masks", "text", "value", "bars"];

export function menuItems(app, target, event) {
  const node = target.closest(".node[data-stream]");
  if (node) return streamItems(app, node);
  const group = target.closest(".node[data-group]");
  if (group) return groupItems(app, group);
  if (target.closest("#annotation")) return annotationItems(app, event);
  const legend = target.closest(".legend-item");
  const panel = target.closest("[data-panel]");
  if (panel) return panelItems(app, panel, legend, event);
  if (target.closest("#navigator")) return timeItems(app, timeAt(app, target.closest("#navigator"), event));
  const link = target.closest("a.store, a.item");
  if (link) {
    return [
      { text: "Open", run: () => link.click() },
      { text: "Open in a new tab", run: () => window.open(link.href) },
      { text: "Copy address", run: () => copyText(link.href, "Address copied") },
    ];
  }
  return null;
}

function panelItems(app, panel, legend, event) {
  const id = panel.dataset.panel;
  const pushEvent = (name, more = {}) => app.options.push?.(name, { id, panel: id, ...more });
  const body = panel.querySelector("[phx-hook='Panel']");
  const { vis } = JSON.parse(body.dataset.config);
  const items = [];
  const index = legend ? vis.findIndex((v) => v.stream === legend.dataset.stream) : -1;
  if (index >= 0) {
    const hidden = vis[index].props?.visible === false;
    items.push(
      { text: hidden ? "Show" : "Hide", run: () => pushEvent("show_vis", { index }) },
      { text: "Show only this", run: () => pushEvent("show_vis", { index, only: "true" }), disabled: vis.length < 2 },
      { text: "Remove from panel", run: () => pushEvent("remove_vis", { index: String(index) }) },
      ...lineItems(app, vis[index], (name, value) => pushEvent("prop", propertyChange(index, name, value))),
      "-",
    );
  }
  const { sel } = app.time.get();
  if (panel.matches(".timeline")) {
    items.push(
      ...timeItems(app, timeAt(app, body, event)),
      {
        text: "Statistics of selection",
        disabled: sel[0] == null || sel[1] == null,
        hint: "i",
        run: () => measureSelection(app, panel),
      },
      ...downloadItems(app, body, vis),
      { text: `Save the ${selectedPart(app)[2]} as an HTML page`, run: () => app.runAction("savePage") },
      ...alignItems(app, body, event),
      "-",
    );
  }
  const streams = vis.map((v) => v.stream);
  items.push(
    { text: "Properties", run: () => pushEvent("select_panel") },
    { text: "Zoom to the streams", run: () => pushEvent("zoom_stream", { streams }), disabled: !vis.length },
    ...(vis.length > 1 ? [{ text: "Show all", run: () => pushEvent("show_vis", { all: "true" }) }] : []),
    ...(vis.length > 1 ? [{ text: "Hide all", run: () => pushEvent("show_vis", { all: "false" }) }] : []),
    ...holdItems(panel, vis, pushEvent),
    { text: panel.matches(".maxed") ? "Restore" : "Maximise", hint: "m", run: () => pushEvent("maximise") },
    ...["up", "down", "left", "right"].map((way) => ({
      text: `Move ${way}`,
      run: () => pushEvent("shift_panel", { way }),
    })),
    "-",
    ...(panel.matches(".timeline")
      ? []
      : [{ text: `Save the ${selectedPart(app)[2]} as an HTML page`, run: () => app.runAction("savePage") }]),
    ...(vis.some((v) => v.draw === "image")
      ? [{ text: `Video of the ${selectedPart(app)[2]} (MP4)`, run: () => startVideo(app, pushEvent) }]
      : []),
    { text: "Save as PNG", run: () => saveImage(app, body) },
    ...(canDrawVector(app, body) ? [{ text: "Save as SVG", run: () => saveVector(app, body) }] : []),
    {
      text: vis.length === 1 ? "Copy the stream's name" : "Copy the streams' names",
      run: () => copyText(vis.map((v) => v.name).join("\n"), "Copied"),
    },
    "-",
    { text: "Remove", run: () => pushEvent("remove_panel") },
  );
  return items;
}

export function timeItems(app, t) {
  const { sel } = app.time.get();
  const dispatchAction = (action) => () => app.time.dispatch(action);
  const both = sel[0] != null && sel[1] != null;
  return [
    { text: "Go to a time…", hint: "Ctrl+G", run: () => app.runAction("goto") },
    { text: "Move the cursor here", run: dispatchAction({ type: "nudge", by: t - app.time.get().cursor }) },
    { text: "Start the selection here", hint: "[", run: dispatchAction({ type: "selStart", t }) },
    { text: "End the selection here", hint: "]", run: dispatchAction({ type: "selEnd", t }) },
    { text: "Zoom to the selection", hint: "Ctrl+S", run: dispatchAction({ type: "zoomSel" }), disabled: !both },
    {
      text: "Clear the selection",
      hint: "Alt+C",
      run: dispatchAction({ type: "clearSel" }),
      disabled: sel[0] == null && sel[1] == null,
    },
    { text: "View everything", hint: "Ctrl+A", run: dispatchAction({ type: "zoomAll" }) },
    ...(app.allows("export")
      ? [
          {
            text: "Save the selection as a recording",
            hint: "Ctrl+E",
            run: () => app.runAction("export"),
            disabled: !both,
          },
        ]
      : []),
  ];
}

// Entries that align a moment of each of two recordings: the start of the segment under the mouse, or else the time
// there.
function alignItems(app, body, event) {
  const { compare } = app;
  if (!compare) return [];
  const view = [...app.views].find((v) => v.el === body);
  const t = view?.segmentUnder?.(event)?.[0] ?? timeAt(app, body, event);
  const { title, other } = compare.el.dataset;
  return [
    "-",
    { text: `Align: mark a moment of ${title}`, run: () => compare.markMoment("first", t) },
    { text: `Align: mark a moment of ${other}`, run: () => compare.markMoment("second", t) },
  ];
}

// Returns a property change in the format that the panel's form would submit.
const propertyChange = (index, name, value) => ({
  index: String(index),
  props: { [name]: value },
  _target: ["props", name],
});

// Entries of one line: zoom, and its switchable properties.
function lineItems(app, { stream, draw, props }, set) {
  const { snap } = app.client;
  const pushEvent = (event) => app.options.push?.(event, { stream });
  const toggleItem = (name, yes, no) => ({
    text: props?.[name] ? no : yes,
    run: () => set(name, props?.[name] ? "false" : "true"),
  });
  return [
    { text: "Zoom to stream", run: () => pushEvent("zoom_stream") },
    ...(draw === "waveform" ? [toggleItem("mute", "Mute", "Unmute")] : []),
    ...(["line", "lines"].includes(draw) ? [toggleItem("markers", "Show markers", "Hide markers")] : []),
    ...(draw === "waveform"
      ? []
      : [
          {
            text: snap === stream ? "Release the cursor" : "Snap the cursor to this stream",
            run: () => pushEvent("snap"),
          },
        ]),
  ];
}

// Entries that set how long values are shown after their message: some seconds, or until the next message.
function holdItems(panel, vis, push) {
  if (panel.matches(".timeline") || !vis.some((v) => HELD.includes(v.draw))) return [];
  const now = vis[0].props?.past ?? "";
  return [
    ["", "until the next message"],
    ["5", "for 5 s"],
    ["1", "for 1 s"],
    ["0.05", "for 50 ms"],
  ].map(([past, text]) => ({
    text: `${String(now) === past ? "✓ " : ""}Show values ${text}`,
    run: () => vis.forEach((_, i) => push("prop", propertyChange(i, "past", past))),
  }));
}

function startVideo(app, push) {
  const [from, to] = selectedPart(app);
  push("film_begin", { from: app.client.toAbsolute(from), to: app.client.toAbsolute(to) });
}

function downloadItems(app, body, vis) {
  const [from, to, of] = selectedPart(app);
  const downloadAs = (what, more) => () => {
    const q = new URLSearchParams(app.options.query());
    q.set("from", app.client.toAbsolute(from));
    q.set("to", app.client.toAbsolute(to));
    for (const [k, v] of Object.entries(more)) q.set(k, v);
    const a = document.createElement("a");
    Object.assign(a, { href: `${app.options.base}/data/${what}?${q}`, download: `${of}.${what}` });
    a.click();
  };
  const streams = JSON.stringify([...new Set(vis.map((v) => v.stream))]);
  const sound = vis.find((v) => v.draw === "waveform");
  return [
    { text: `Download the ${of} as CSV`, run: downloadAs("csv", { streams }) },
    { text: `Download the ${of} as Parquet`, run: downloadAs("parquet", { streams }) },
    ...(sound ? [{ text: `Download the ${of} as WAV`, run: downloadAs("wav", { stream: sound.stream }) }] : []),
  ];
}

// Returns the time under the mouse, or the cursor's if the menu was opened by a key.
export function timeAt(app, el, event) {
  const box = el.getBoundingClientRect();
  const { view, cursor } = app.time.get();
  const inner = box.width - GUTTER.left - GUTTER.right;
  const x = event.clientX - box.left - GUTTER.left;
  if (!event.clientX || x < 0 || x > inner) return cursor;
  return view[0] + (x / inner) * (view[1] - view[0]);
}
