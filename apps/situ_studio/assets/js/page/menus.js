// The entries of the menus: of a stream, a panel, a line's name, a time, a recording.

import { GUTTER } from "./theme.js";
import { copy, toast } from "./toast.js";
import { drawable, savePicture, saveVector } from "./picture_file.js";
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
      { text: "Copy its address", run: () => copy(link.href, "Address copied") },
    ];
  }
  return null;
}

function panelItems(app, panel, legend, event) {
  const id = panel.dataset.panel;
  const push = (name, more = {}) => app.options.push?.(name, { id, panel: id, ...more });
  const body = panel.querySelector("[phx-hook='Panel']");
  const { vis } = JSON.parse(body.dataset.config);
  const items = [];
  const index = legend ? vis.findIndex((v) => v.stream === legend.dataset.stream) : -1;
  if (index >= 0) {
    const hidden = vis[index].props?.visible === false;
    items.push(
      { text: hidden ? "Show it" : "Hide it", run: () => push("show_vis", { index }) },
      { text: "Only this one", run: () => push("show_vis", { index, only: "true" }), disabled: vis.length < 2 },
      { text: "Take it out", run: () => push("remove_vis", { index: String(index) }) },
      ...own(app, vis[index], (name, value) => push("prop", property(index, name, value))),
      "-",
    );
  }
  const { sel } = app.time.get();
  if (panel.matches(".timeline")) {
    items.push(
      ...timeItems(app, timeAt(app, body, event)),
      {
        text: "Statistics of the selection",
        disabled: sel[0] == null || sel[1] == null,
        run: () => {
          app.counting = setTimeout(() => toast("Reading every message of the selection …"), 600);
          push("statistics", { from: app.client.abs(sel[0]), to: app.client.abs(sel[1]) });
        },
      },
      ...downloads(app, body, vis),
      ...aligning(app, body, event),
      "-",
    );
  }
  const streams = vis.map((v) => v.stream);
  items.push(
    { text: "Properties", run: () => push("select_panel") },
    { text: "Zoom to its streams", run: () => push("zoom_stream", { streams }), disabled: !vis.length },
    ...(vis.length > 1 ? [{ text: "Show all", run: () => push("show_vis", { all: "true" }) }] : []),
    ...(vis.length > 1 ? [{ text: "Hide all", run: () => push("show_vis", { all: "false" }) }] : []),
    ...holding(panel, vis, push),
    { text: panel.matches(".maxed") ? "Restore" : "Maximise", hint: "m", run: () => push("maximise") },
    { text: "Move up", run: () => push("shift_panel", { way: "up" }) },
    { text: "Move down", run: () => push("shift_panel", { way: "down" }) },
    "-",
    ...(vis.some((v) => v.draw === "image")
      ? [{ text: `Film of the ${part(app)[2]} (MP4)`, run: () => film(app, push) }]
      : []),
    { text: "Save as PNG", run: () => savePicture(app, body) },
    ...(drawable(app, body) ? [{ text: "Save as SVG", run: () => saveVector(app, body) }] : []),
    {
      text: vis.length === 1 ? "Copy the stream's name" : "Copy the streams' names",
      run: () => copy(vis.map((v) => v.name).join("\n"), "Copied"),
    },
    "-",
    { text: "Remove", run: () => push("remove_panel") },
  );
  return items;
}

function timeItems(app, t) {
  const { sel } = app.time.get();
  const go = (action) => () => app.time.dispatch(action);
  const both = sel[0] != null && sel[1] != null;
  return [
    { text: "Go to a time…", hint: "Ctrl+G", run: () => app.act("goto") },
    { text: "Cursor here", run: go({ type: "nudge", by: t - app.time.get().cursor }) },
    { text: "Selection starts here", hint: "[", run: go({ type: "selStart", t }) },
    { text: "Selection ends here", hint: "]", run: go({ type: "selEnd", t }) },
    { text: "Zoom to the selection", hint: "Ctrl+S", run: go({ type: "zoomSel" }), disabled: !both },
    {
      text: "Clear the selection",
      hint: "Alt+C",
      run: go({ type: "clearSel" }),
      disabled: sel[0] == null && sel[1] == null,
    },
    { text: "View everything", hint: "Ctrl+A", run: go({ type: "zoomAll" }) },
    { text: "Save the selection as a recording", hint: "Ctrl+E", run: () => app.act("export"), disabled: !both },
  ];
}

// A moment of each of two recordings, so that they fall together: where something begins under the mouse, that.
function aligning(app, body, event) {
  const { compare } = app;
  if (!compare) return [];
  const view = [...app.views].find((v) => v.el === body);
  const t = view?.segment?.(event)?.[0] ?? timeAt(app, body, event);
  const { title, other } = compare.el.dataset;
  return [
    "-",
    { text: `Align: a moment of ${title}`, run: () => compare.mark("first", t) },
    { text: `Align: a moment of ${other}`, run: () => compare.mark("second", t) },
  ];
}

// A property of one of a panel's streams, as its form would send it.
const property = (index, name, value) => ({
  index: String(index),
  props: { [name]: value },
  _target: ["props", name],
});

// Of one line: what it is about, and what it can be switched to.
function own(app, { stream, draw, props }, set) {
  const { snap } = app.client;
  const push = (event) => app.options.push?.(event, { stream });
  const on = (name, yes, no) => ({
    text: props?.[name] ? no : yes,
    run: () => set(name, props?.[name] ? "false" : "true"),
  });
  return [
    { text: "Zoom to it", run: () => push("zoom_stream") },
    ...(draw === "waveform" ? [on("mute", "Mute", "Hear it")] : []),
    ...(["line", "lines"].includes(draw) ? [on("markers", "Show markers", "Hide markers")] : []),
    ...(draw === "waveform"
      ? []
      : [{ text: snap === stream ? "Release the cursor" : "Snap the cursor to it", run: () => push("snap") }]),
  ];
}

// For how long the values of a panel at the cursor hold: some seconds, or until the next.
function holding(panel, vis, push) {
  if (panel.matches(".timeline") || !vis.some((v) => HELD.includes(v.draw))) return [];
  const now = vis[0].props?.past ?? "";
  return [
    ["", "until the next"],
    ["5", "5 s"],
    ["1", "1 s"],
    ["0.05", "50 ms"],
  ].map(([past, text]) => ({
    text: `${String(now) === past ? "✓ " : ""}Values hold ${text}`,
    run: () => vis.forEach((_, i) => push("prop", property(i, "past", past))),
  }));
}

// The selection, or the view where there is none, and which of the two it is.
function part(app) {
  const { sel, view, data } = app.time.get();
  if (sel[0] != null && sel[1] != null) return [...sel, "selection"];
  return [Math.max(view[0], data[0]), Math.min(view[1], data[1]), "view"];
}

function film(app, push) {
  const [from, to] = part(app);
  push("film_begin", { from: app.client.abs(from), to: app.client.abs(to) });
}

function downloads(app, body, vis) {
  const [from, to, of] = part(app);
  const get = (what, more) => () => {
    const q = new URLSearchParams(app.options.query());
    q.set("from", app.client.abs(from));
    q.set("to", app.client.abs(to));
    for (const [k, v] of Object.entries(more)) q.set(k, v);
    const a = document.createElement("a");
    Object.assign(a, { href: `${app.options.base}/data/${what}?${q}`, download: `${of}.${what}` });
    a.click();
  };
  const streams = JSON.stringify([...new Set(vis.map((v) => v.stream))]);
  const sound = vis.find((v) => v.draw === "waveform");
  return [
    { text: `Download the ${of} as CSV`, run: get("csv", { streams }) },
    { text: `Download the ${of} as Parquet`, run: get("parquet", { streams }) },
    ...(sound ? [{ text: `Download the ${of} as WAV`, run: get("wav", { stream: sound.stream }) }] : []),
  ];
}

// The time under the mouse; the cursor's where a key asked.
function timeAt(app, el, event) {
  const box = el.getBoundingClientRect();
  const { view, cursor } = app.time.get();
  const inner = box.width - GUTTER.left - GUTTER.right;
  const x = event.clientX - box.left - GUTTER.left;
  if (!event.clientX || x < 0 || x > inner) return cursor;
  return view[0] + (x / inner) * (view[1] - view[0]);
}
