// The script of an exported page: the panels of the studio, with the page's own data instead of a server.

import { Studio } from "../studio.js";
import { Navigator } from "../time/navigator.js";
import { openPanel, isTimeline } from "../panels/index.js";
import { timeAction } from "../page/keys.js";
import { menuItems } from "./menu.js";
import { PageData, PageSocket, unpack } from "./page_data.js";
import { getElement } from "../page/dom.js";

// The commands that an exported page has besides those of time.
const COMMANDS = [
  "goto",
  "help",
  "theme",
  "timing",
  "copyTime",
  "copyNs",
  "maximise",
  "nextChange",
  "previousChange",
];

/** @type {Promise<any> | null} */
let space = null;

// The drawing code of 3D panels is in the page, too.
function loadSpace() {
  space ??= unpack(getElement("situ-space").textContent ?? "").then(
    (code) => import(URL.createObjectURL(new Blob([code], { type: "text/javascript" }))),
  );
  return space;
}

/** @param {PageData} data */
function openStudio(data) {
  const root = getElement("studio");
  return new Studio(root, {
    offline: true,
    query: () => "",
    connect: () => new PageSocket(data),
    decode: (reply) => reply,
    fetchPcm: async (sound, from, to) => data.samples(sound, from, to),
    loadSpace,
    menuItems,
    allows: (name) => COMMANDS.includes(name) || timeAction(name, studio.time.get()) !== null,
    push: (event, params) => handleEvent(root, event, params),
  });
}

// Handles the events that the studio would send to its server.
function handleEvent(root, event, params) {
  if (event === "maximise") return toggleMaximised(root, params.id);
  if (event === "show_vis") return showStreams(params);
}

function toggleMaximised(root, id) {
  const stack = root.querySelector(".stack");
  const panel = root.querySelector(`[data-panel="${CSS.escape(id)}"]`);
  const restore = panel.matches(".maxed");
  for (const part of root.querySelectorAll(".maxed")) part.classList.remove("maxed");
  stack.classList.toggle("max", !restore);
  if (restore) return;
  for (let part = panel; part && part !== stack; part = part.parentElement)
    if (part.matches("[data-part]")) part.classList.add("maxed");
}

// Shows or hides the streams of a panel: one, one alone, or all.
function showStreams({ panel, index, only, all }) {
  const view = [...studio.views].find((v) => v.el.closest("[data-panel]")?.dataset.panel === panel);
  if (!view) return;
  const vis = view.config.vis.map((v, i) => {
    const shown = v.props?.visible !== false;
    const visible = all ? all === "true" : only ? i === index : i === index ? !shown : shown;
    return { ...v, props: { ...v.props, visible } };
  });
  view.configure({ ...view.config, vis });
}

function openPanels() {
  const navigator = getElement("navigator");
  const view = Object.assign(new Navigator(navigator, studio), { navigator: true });
  studio.addView(view, { timeline: true, gestures: false });
  for (const el of document.querySelectorAll("[phx-hook='Panel']")) {
    if (!(el instanceof HTMLElement)) continue;
    const { kind = "", config = "{}" } = el.dataset;
    const panel = openPanel(kind, el, studio, JSON.parse(config));
    if (panel) studio.addView(panel, { timeline: isTimeline(kind) });
  }
}

/** @type {Studio} */
let studio;

unpack(getElement("situ-data").textContent ?? "").then((buffer) => {
  studio = openStudio(new PageData(buffer));
  window.situStudio = studio;
  openPanels();
  document.addEventListener("click", (e) => {
    const button = e.target instanceof Element ? e.target.closest("[phx-click='maximise']") : null;
    if (button) studio.options.push("maximise", { id: button.getAttribute("phx-value-id") });
  });
});
