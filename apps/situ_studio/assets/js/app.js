// Joins the LiveView page with the drawing code: one hook per kind of element.

import { Socket } from "phoenix";
import { LiveSocket } from "phoenix_live_view";
import { SituFlow, connectParams } from "situ_live";
import { Studio } from "./studio.js";
import { Navigator } from "./time/navigator.js";
import { openPanel, timeline } from "./panels/index.js";
import { AnnotationPanel } from "./annotation/panel.js";
import { chooseLayer, showAgreement } from "./annotation/agreement.js";
import { copyBoundaries } from "./annotation/menu.js";
import { rememberAnnotator } from "./annotation/annotator.js";
import { Compare } from "./page/compare.js";
import { Palette } from "./page/palette.js";
import { hooks as dragHooks, dragStream } from "./page/drag.js";
import { hooks as extraHooks } from "./hooks.js";
import { seriesColor } from "./page/theme.js";
import { showStatistics } from "./page/statistics.js";
import { copyViewerLink } from "./page/viewer_link.js";
import { toast } from "./page/toast.js";
import { Together } from "./page/together.js";
import { remember } from "./page/recent.js";
import { tellTimes } from "./page/times.js";

let studio = null;

function page() {
  if (studio) return studio;
  const root = document.getElementById("studio");
  const d = root.dataset;
  // what stands before the studio's own paths, where a proxy stands before the studio
  const base = new URL(document.baseURI).pathname.replace(/\/$/, "");
  const ws = location.protocol === "https:" ? "wss:" : "ws:";
  // what is looked at, and with what it is compared as it is shifted now
  const q = () => {
    const { dataset } = document.getElementById("compare") ?? {};
    const query = { source: d.source };
    if (dataset) Object.assign(query, { with: dataset.with, offset: studio?.compare?.offset ?? dataset.offset });
    return new URLSearchParams(query).toString();
  };
  studio = new Studio(root, {
    query: q,
    dataUrl: () => `${ws}//${location.host}${base}/data/socket?${q()}`,
    pcmUrl: () => `${base}/data/pcm?${q()}`,
    stepUrl: () => `${base}/data/step?${q()}`,
    source: d.source,
    base,
    layout: d.layout,
    edit: d.edit,
    annotate: d.annotate,
    // Where a server that was away, or started again, is told what the page shows.
    moved: (href) => window.liveSocket?.main?.setHref(href),
  });
  studio.palette = new Palette(studio);
  studio.together = new Together(studio);
  window.situStudio = studio;
  return studio;
}

const hooks = {
  Studio: {
    mounted() {
      const app = page();
      // what is done while the server is away is not kept, and says so
      app.options.push = (event, payload) =>
        this.pushEvent(event, payload)?.catch?.(() => toast("The server does not answer: nothing was changed"));
      remember();
      // a named layout that was changed and not saved, where the settings want to be asked
      this.leaving = (e) => this.el.dataset.keep === "ask" && this.el.dataset.edit && e.preventDefault();
      addEventListener("beforeunload", this.leaving);
      this.handleEvent("snap", ({ stream }) => app.snapTo(stream));
      this.handleEvent("toast", ({ text }) => toast(text));
      this.handleEvent("statistics", ({ rows }) => {
        clearTimeout(app.counting);
        const { sel } = app.time.get();
        showStatistics(rows, (sel[1] ?? 0) - (sel[0] ?? 0));
      });
      this.handleEvent("select_times", (times) => {
        const [from, to] = [times.from, times.to].map((t) => app.client.rel(BigInt(t)));
        app.time.dispatch({ type: "select", from, to });
        app.time.dispatch({ type: "nudge", by: from - app.time.get().cursor });
        if (to > from) app.time.dispatch({ type: "zoomSel" });
      });
      this.handleEvent("viewer_link", ({ token }) => copyViewerLink(app, token));
      this.handleEvent("compare_go", ({ with: other, offset }) => {
        location.assign(`${location.pathname}?${new URLSearchParams({ with: other, offset })}`);
      });
      this.handleEvent("compare_shift", ({ offset }) => app.compare?.set(BigInt(offset)));
      this.handleEvent("together", (told) => app.together.heard(told));
      this.handleEvent("zoom_to", ({ from, to }) => {
        app.time.dispatch({ type: "view", from: app.client.rel(BigInt(from)), to: app.client.rel(BigInt(to)) });
      });
      this.updated();
    },
    updated() {
      const { layout, edit, annotate } = this.el.dataset;
      page().setLayout(layout, edit, annotate);
      tellTimes(this.el);
    },
    destroyed() {
      removeEventListener("beforeunload", this.leaving);
      studio?.together.destroy();
      studio?.destroy();
      studio = null;
    },
  },

  Navigator: {
    mounted() {
      const app = page();
      this.view = new Navigator(this.el, app);
      this.view.navigator = true;
      app.add(this.view, { timeline: true, gestures: false });
    },
    destroyed() {
      page().remove(this.view);
    },
  },

  Panel: {
    mounted() {
      const app = page();
      const { kind, config } = this.el.dataset;
      this.view = openPanel(kind, this.el, app, JSON.parse(config));
      if (!this.view) return;
      app.add(this.view, { timeline: timeline(kind) });
      this.config = this.el.dataset.config;
      // one that was just added is selected: it is shown even where it lies below the edge
      this.el.closest(".selected")?.scrollIntoView({ block: "nearest" });
    },
    updated() {
      if (!this.view || this.config === this.el.dataset.config) return;
      this.config = this.el.dataset.config;
      this.view.configure(JSON.parse(this.config));
    },
    destroyed() {
      if (this.view) page().remove(this.view);
    },
  },

  Compare: {
    mounted() {
      const app = page();
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
      const app = page();
      this.view = new AnnotationPanel(this.el, app);
      app.annotation = this.view;
      app.add(this.view, { timeline: true });
      this.handleEvent("annotations", (told) => this.view.tell(told));
      this.handleEvent("agreement", showAgreement);
      this.handleEvent("annotation_tracks", ({ tracks }) => copyBoundaries(this.view, tracks));
      this.handleEvent("annotation_streams", ({ streams }) =>
        chooseLayer(streams, (other) => this.pushEvent("annotation_compare", { with: other })),
      );
      this.pushEvent("annotation_ready", {});
      this.el.focus({ preventScroll: true });
      this.el.scrollIntoView({ block: "nearest" });
    },
    destroyed() {
      page().annotation = null;
      page().remove(this.view);
    },
  },

  // A dialog that the server opened: it takes the focus, keeps it, and goes with Escape.
  Modal: {
    mounted() {
      this.el.showModal();
      rememberAnnotator(this.el);
      (this.el.querySelector("[autofocus]") ?? this.el.querySelector("input, button"))?.focus();
      document.activeElement.select?.();
      // what cannot be undone is asked twice
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
    // the server does not know that it is open, and takes the mark of it away
    updated() {
      if (this.el.open) return;
      const back = document.activeElement;
      this.el.showModal();
      if (this.el.contains(back)) back.focus();
    },
  },

  // The colour that a stream has by itself, in the field where another can be given.
  Swatch: {
    mounted() {
      this.updated();
    },
    updated() {
      if (!this.el.dataset.auto) return;
      this.el.value = seriesColor(null, Number(this.el.dataset.auto));
      // a patch that leaves the field alone empties it, too: an attribute makes the patch set it again
      this.el.setAttribute("value", this.el.value);
    },
  },

  // The tree: arrow keys walk it, Enter adds, rows can be dragged onto panels.
  Tree: {
    mounted() {
      this.el.addEventListener("keydown", (e) => {
        const rows = [...this.el.querySelectorAll(".node")];
        const i = rows.indexOf(document.activeElement);
        const go = (k) => rows[Math.min(Math.max(k, 0), rows.length - 1)]?.focus();
        if (e.key === "ArrowDown") go(i + 1);
        else if (e.key === "ArrowUp") go(i - 1);
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
      // from the search box down into what it found, and back to all
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
  hooks: { SituFlow, ...hooks },
});
liveSocket.disableDebug();
liveSocket.connect();
window.liveSocket = liveSocket;
