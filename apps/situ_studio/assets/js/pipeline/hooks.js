// The hooks of the pipeline's page.
import { setTheme } from "../page/theme.js";
import { scriptAddress } from "../page/dom.js";
import { showToast } from "../page/toast.js";
import { HistoryPlot } from "./plot.js";

const HERE = scriptAddress() ?? location.href;
/** @returns {Promise<typeof import("./graph.js")>} */
const loadGraph = () => import(new URL("graph.js", HERE).href);

// Plots are added and removed with the selection; their data belong to the page.
/** @type {{key: string | null, stats: string[], rows: (number | null)[][]}} */
const past = { key: null, stats: [], rows: [] };
const plots = new Set();
const statColumn = (stat) => {
  const i = past.stats.indexOf(stat);
  return i < 0 ? [] : past.rows.map((row) => [row[0], row[i + 1]]);
};

export const hooks = {
  PipelineGraph: {
    mounted() {
      loadGraph().then(
        ({ PipelineGraph: Graph }) => this.left || this.openGraph(Graph),
        (error) => showToast(`The graph could not be loaded: ${error.message}`),
      );
    },
    openGraph(Graph) {
      this.graph = new Graph(this.el, {
        onPick: (key) => this.pickNode(key),
        onFold: (path) => this.pushEvent("fold", { path }),
      });
      this.handleEvent("pipeline:graph", (graph) => {
        // an unchanged graph is not redrawn, since the user may be clicking on it
        const shape = JSON.stringify(graph);
        if (shape === this.shape) return;
        this.shape = shape;
        this.graph.setGraph(graph);
        // not on the hook's own element, since a diff would remove it there
        const { dataset } = this.graph.svg;
        dataset.drawn = String(Number(dataset.drawn ?? 0) + 1);
      });
      this.handleEvent("pipeline:stats", (stats) => {
        this.graph.setStats(stats);
        // requests the history of the newly selected element
        if (this.selected !== undefined && this.selected !== stats.selected) this.pushEvent("ready", {});
        this.selected = stats.selected;
      });
      this.handleEvent("pipeline:series", (series) => {
        Object.assign(past, series);
        for (const plot of plots) plot.setRows(statColumn(plot.el.dataset.stat));
      });
      this.handleEvent("pipeline:point", ({ key, at, values }) => {
        if (key !== past.key) return;
        past.rows.push([at, ...past.stats.map((stat) => values[stat])]);
        for (const plot of plots)
          if (past.stats.includes(plot.el.dataset.stat)) plot.addRow([at, values[plot.el.dataset.stat]]);
      });
      this.onClick = (e) => e.target.closest("[data-graph=fit]") && this.graph.fitView();
      document.addEventListener("click", this.onClick);
      this.onKey = (e) => {
        if (e.target.closest?.("input, select, dialog") || e.ctrlKey || e.metaKey || e.altKey) return;
        if (e.key === "f") this.graph.fitView();
        else if (e.key === "t") setTheme(document.documentElement.dataset.theme === "light" ? "dark" : "light");
        else if (e.key === "Escape") this.pickNode(null);
      };
      document.addEventListener("keydown", this.onKey);
      window.situPipeline = this.graph;
      this.pushEvent("ready", {});
    },
    pickNode(key) {
      if (key || this.selected) this.pushEvent("pick", { key: key ?? this.selected });
    },
    reconnected() {
      if (this.graph) this.pushEvent("ready", {});
    },
    destroyed() {
      this.left = true;
      if (!this.graph) return;
      document.removeEventListener("click", this.onClick);
      document.removeEventListener("keydown", this.onKey);
      this.graph.destroy();
    },
  },

  PipelinePlot: {
    mounted() {
      this.plot = new HistoryPlot(this.el);
      plots.add(this.plot);
      // the history of this statistic has not arrived yet
      if (past.stats.includes(this.el.dataset.stat)) this.plot.setRows(statColumn(this.el.dataset.stat));
      else this.pushEvent("ready", {});
    },
    destroyed() {
      plots.delete(this.plot);
      this.plot.destroy();
    },
  },
};
