// Connects the LiveView page with the drawing code: one hook for each kind of element.

import { Socket } from "phoenix";
import { LiveSocket } from "phoenix_live_view";
import { SituFlow, connectParams, domCallbacks } from "situ_live";
import { Studio } from "./studio.js";
import { Navigator } from "./time/navigator.js";
import { openPanel, isTimeline } from "./panels/index.js";
import { AnnotationPanel } from "./annotation/panel.js";
import { chooseLayer, showAgreement } from "./annotation/agreement.js";
import { copyBoundaries } from "./annotation/menu.js";
import { rememberAnnotator } from "./annotation/annotator.js";
import { Compare } from "./page/compare.js";
import { Palette } from "./page/palette.js";
import { pushEvent } from "./page/channel.js";
import { hooks as dragHooks, dragStream } from "./page/drag.js";
import { hooks as extraHooks } from "./hooks.js";
import { seriesColor } from "./page/theme.js";
import { showStatistics } from "./page/statistics.js";
import { copyViewerLink } from "./page/viewer_link.js";
import { showToast } from "./page/toast.js";
import { SharedCursors } from "./page/shared_cursors.js";
import { rememberPage } from "./page/recent.js";
import { showHintsOnce } from "./page/hints.js";
import { showTimes } from "./page/times.js";
import { focusedElement, getElement } from "./page/dom.js";

/** @type {Studio | null} */
let studio = null;

function ensureStudio() {
  if (studio) return studio;
  const root = getElement("studio");
  const d = root.dataset;
  // the path prefix, if the studio is behind a proxy
  const base = new URL(document.baseURI).pathname.replace(/\/$/, "");
  const ws = location.protocol === "https:" ? "wss:" : "ws:";
  // the source, and the compared source with its current offset
  const buildQuery = () => {
    const { dataset } = document.getElementById("compare") ?? {};
    const query = new URLSearchParams({ source: d.source ?? "" });
    if (dataset) {
      query.set("with", dataset.with ?? "");
      query.set("offset", String(studio?.compare?.offset ?? dataset.offset));
    }
    return query.toString();
  };
  const created = new Studio(root, {
    query: buildQuery,
    dataUrl: () => `${ws}//${location.host}${base}/data/socket?${buildQuery()}`,
    pcmUrl: () => `${base}/data/pcm?${buildQuery()}`,
    videoUrl: (what) => `${base}/data/${what}?${buildQuery()}`,
    stepUrl: () => `${base}/data/step?${buildQuery()}`,
    source: d.source,
    base,
    layout: d.layout,
    edit: d.edit,
    start: d.start,
    annotate: d.annotate,
    // Updates the address that a reconnecting or restarted server receives.
    moved: (href) => window.liveSocket?.main?.setHref(href),
  });
  created.palette = new Palette(created);
  created.together = new SharedCursors(created);
  studio = window.situStudio = created;
  return created;
}

const hooks = {
  Studio: {
    mounted() {
      const app = ensureStudio();
      app.options.push = pushEvent;
      rememberPage();
      showHintsOnce();
      // asks before leaving a named layout with unsaved changes, if the settings say so
      this.leaving = (e) => this.el.dataset.keep === "ask" && this.el.dataset.edit && e.preventDefault();
      addEventListener("beforeunload", this.leaving);
      this.handleEvent("snap", ({ stream }) => app.snapTo(stream));
      this.handleEvent("toast", ({ text }) => showToast(text));
      this.handleEvent("statistics", ({ rows }) => {
        clearTimeout(app.counting);
        const { sel } = app.time.get();
        showStatistics(rows, (sel[1] ?? 0) - (sel[0] ?? 0));
      });
      this.handleEvent("select_times", (times) => {
        const [from, to] = [times.from, times.to].map((t) => app.client.toRelative(BigInt(t)));
        app.time.dispatch({ type: "select", from, to });
        app.time.dispatch({ type: "nudge", by: from - app.time.get().cursor });
        if (to > from) app.time.dispatch({ type: "zoomSel" });
      });
      this.handleEvent("layers_changed", () => app.client.forgetStreams("Annotations."));
      this.handleEvent("viewer_link", ({ token }) => copyViewerLink(app, token));
      this.handleEvent("compare_go", ({ with: other, offset }) => {
        location.assign(`${location.pathname}?${new URLSearchParams({ with: other, offset })}`);
      });
      this.handleEvent("compare_shift", ({ offset }) => app.compare?.setOffset(BigInt(offset)));
      this.handleEvent("together", (message) => app.together?.receivePeer(message));
      this.handleEvent("zoom_to", ({ from, to }) => {
        app.time.dispatch({
          type: "view",
          from: app.client.toRelative(BigInt(from)),
          to: app.client.toRelative(BigInt(to)),
        });
      });
      this.updated();
    },
    updated() {
      const { layout, edit, annotate } = this.el.dataset;
      ensureStudio().setLayout(layout, edit, annotate);
      showTimes(this.el);
    },
    destroyed() {
      removeEventListener("beforeunload", this.leaving);
      studio?.together?.destroy();
      studio?.destroy();
      studio = null;
    },
  },

  Navigator: {
    mounted() {
      const app = ensureStudio();
      this.view = new Navigator(this.el, app);
      this.view.navigator = true;
      app.addView(this.view, { timeline: true, gestures: false });
    },
    destroyed() {
      ensureStudio().removeView(this.view);
    },
  },

  Panel: {
    mounted() {
      const app = ensureStudio();
      const { kind, config } = this.el.dataset;
      this.view = openPanel(kind, this.el, app, JSON.parse(config));
      if (!this.view) return;
      app.addView(this.view, { timeline: isTimeline(kind) });
      this.config = this.el.dataset.config;
      // scrolls to a panel that was just added, which is selected
      this.el.closest(".selected")?.scrollIntoView({ block: "nearest" });
    },
    updated() {
      if (!this.view || this.config === this.el.dataset.config) return;
      this.config = this.el.dataset.config;
      this.view.configure(JSON.parse(this.config));
    },
    destroyed() {
      if (this.view) ensureStudio().removeView(this.view);
    },
  },

  Compare: {
    mounted() {
      const app = ensureStudio();
      app.compare = new Compare(this.el, app);
      app.client.setOffset(this.el.dataset.offset);
    },
    destroyed() {
      studio?.compare?.destroy();
      if (studio) studio.compare = null;
    },
  },

  Annotations: {
    mounted() {
      const app = ensureStudio();
      this.view = new AnnotationPanel(this.el, app);
      app.annotation = this.view;
      app.addView(this.view, { timeline: true });
      this.handleEvent("annotations", (state) => this.view.applyUpdate(state));
      this.handleEvent("agreement", showAgreement);
      this.handleEvent("annotation_merged", (data) => this.view?.merged.show(data));
      this.handleEvent("annotation_tracks", ({ tracks }) => copyBoundaries(this.view, tracks));
      this.handleEvent("annotation_streams", ({ streams }) =>
        chooseLayer(streams, (other) => this.pushEvent("annotation_compare", { with: other })),
      );
      this.pushEvent("annotation_ready", {});
      this.el.focus({ preventScroll: true });
      this.el.scrollIntoView({ block: "nearest" });
    },
    destroyed() {
      ensureStudio().annotation = null;
      ensureStudio().removeView(this.view);
    },
  },

  // A dialog that the server opened: it takes and keeps the focus, and Escape closes it.
  Modal: {
    mounted() {
      this.el.showModal();
      rememberAnnotator(this.el);
      (this.el.querySelector("[autofocus]") ?? this.el.querySelector("input, button"))?.focus();
      if (document.activeElement instanceof HTMLInputElement) document.activeElement.select();
      // actions that cannot be undone need a second click
      this.el.addEventListener(
        "click",
        (e) => {
          const sure = e.target.closest("[data-sure]");
          if (!sure || sure.dataset.asked) return;
          e.preventDefault();
          e.stopPropagation();
          sure.dataset.asked = "1";
          sure.textContent = sure.dataset.sure;
        },
        true,
      );
      this.el.addEventListener("cancel", (e) => {
        e.preventDefault();
        this.pushEvent("dialog_close", {});
      });
    },
    // the server does not know that the dialog is open, and its patch removes the `open` attribute
    updated() {
      if (this.el.open) return;
      const back = focusedElement();
      this.el.showModal();
      if (this.el.contains(back)) back?.focus();
    },
  },

  // Shows the default color of a stream in the field that sets another one.
  Swatch: {
    mounted() {
      this.updated();
    },
    updated() {
      if (!this.el.dataset.auto) return;
      this.el.value = seriesColor(null, Number(this.el.dataset.auto));
      // a patch empties the field even if its attributes did not change; the attribute makes the patch restore the
      // value
      this.el.setAttribute("value", this.el.value);
    },
  },

  // The stream tree: arrow keys move through it, Enter adds a stream, rows can be dragged onto panels.
  Tree: {
    mounted() {
      this.el.addEventListener("keydown", (e) => {
        const rows = [...this.el.querySelectorAll(".node")];
        const i = rows.indexOf(document.activeElement);
        const focusRow = (k) => rows[Math.min(Math.max(k, 0), rows.length - 1)]?.focus();
        if (e.key === "ArrowDown") focusRow(i + 1);
        else if (e.key === "ArrowUp") focusRow(i - 1);
        else if (e.key === "Enter" && i >= 0) rows[i].querySelector(".add")?.click();
        else if ((e.key === "ArrowRight" || e.key === "ArrowLeft" || e.key === " ") && i >= 0) {
          const wanted = e.key === "ArrowRight" ? "false" : e.key === "ArrowLeft" ? "true" : null;
          const fold = rows[i].querySelector(".fold");
          if (fold && (!wanted || rows[i].getAttribute("aria-expanded") === wanted)) fold.click();
          else if (e.key === " ") rows[i].querySelector(".name")?.click();
        } else return;
        e.preventDefault();
        e.stopPropagation();
      });
      // ArrowDown moves from the search box to the first match, Escape clears the search
      this.el.parentElement.querySelector("#search")?.addEventListener("keydown", (e) => {
        if (e.key === "ArrowDown") this.el.querySelector(".node")?.focus();
        else if (e.key === "Escape" && e.target.value) {
          e.target.value = "";
          e.target.dispatchEvent(new Event("input", { bubbles: true }));
        } else return;
        e.preventDefault();
      });
      this.el.addEventListener("dragstart", dragStream);
      this.el.addEventListener("dblclick", (e) => e.target.closest(".node")?.querySelector(".add")?.click());
    },
  },

  ...dragHooks,
  ...extraHooks,
};

const liveSocket = new LiveSocket(new URL("live", document.baseURI).pathname, Socket, {
  params: connectParams,
  dom: domCallbacks,
  hooks: { SituFlow, ...hooks },
});
liveSocket.disableDebug();
liveSocket.connect();
window.liveSocket = liveSocket;
