// The names of a plot above its signals, each with the value at the cursor: an entry for each signal, or for each key
// of a stream of maps.

import { duration } from "../time/text.js";

// A second click within so many ms is a double click.
const DOUBLE = 220;

const group = (name) => name.slice(0, name.lastIndexOf(".") + 1);

export class Legend {
  constructor(panel) {
    this.panel = panel;
    this.entries = [];
    this.el = panel.el.appendChild(document.createElement("div"));
    this.el.className = "legend";
    this.el.addEventListener("click", (e) => this.clicked(e));
    this.rest = panel.el.appendChild(document.createElement("div"));
    this.rest.className = "legend-more";
  }

  // The next build draws every entry again.
  forget() {
    this.named = null;
  }

  // The legend has an entry for each, and for a stream of which nothing came.
  build() {
    const { panel } = this;
    const entries = panel.lines();
    for (const layer of panel.layers) {
      if (!entries.some((e) => e.layer === layer)) entries.push({ layer, name: "", series: null });
    }
    const more = panel.layers.map((l) => l.channel.more ?? 0);
    const named = JSON.stringify([
      more,
      entries.map((e) => [e.layer.vis.name, e.name, panel.color(e, 0), e.layer.vis.props?.visible]),
    ]);
    const same = named === this.named;
    this.named = named;
    const rows = this.entries;
    this.entries = entries.map((e, i) => ({
      ...e,
      value: same ? rows[i].value : null,
      text: same ? rows[i].text : null,
      title: same ? rows[i].title : null,
    }));
    if (same) return;
    this.el.textContent = "";
    let nth = 0,
      before = null;
    for (const e of this.entries) {
      const row = this.el.appendChild(document.createElement("button"));
      row.className = "legend-item";
      row.dataset.stream = e.layer.vis.stream;
      row.dataset.key = e.name;
      const swatch = row.appendChild(document.createElement("i"));
      swatch.style.background = panel.color(e, nth++);
      // of neighbours in one group the first is named in full
      const { name, short } = e.layer.vis;
      const stream = before && group(before.vis.name) === group(name) ? (short ?? name) : name;
      const full = e.name === "" ? e.layer.vis.name : `${e.layer.vis.name}  ${e.name}`;
      row.title = `${full}\nClick: hide or show. Double click: only this one.`;
      e.title = full;
      row.type = "button";
      row.classList.toggle("hidden", e.layer.vis.props?.visible === false);
      row.setAttribute("aria-pressed", String(e.layer.vis.props?.visible !== false));
      // a stream is named once, then its keys
      row.appendChild(document.createElement("span")).textContent =
        e.name === "" ? stream : before === e.layer ? e.name : `${stream} ${e.name}`;
      before = e.layer;
      e.value = row.appendChild(document.createElement("b"));
    }
    this.more();
  }

  // A name is a switch: a click hides or shows, a double click leaves it alone.
  clicked(e) {
    const { panel } = this;
    const stream = e.target.closest(".legend-item")?.dataset.stream;
    const index = panel.config.vis.findIndex((v) => v.stream === stream);
    const place = panel.el.closest("[data-panel]")?.dataset.panel;
    if (index < 0 || !place) return;
    clearTimeout(this.clickTimer);
    const push = (more) => panel.app.options.push?.("show_vis", { panel: place, index, ...more });
    if (e.detail > 1) push({ only: "true" });
    else this.clickTimer = setTimeout(push, DOUBLE, {});
  }

  // Entries for which there is no room are counted.
  more() {
    const rows = [...this.el.children];
    const cut = () => rows.filter((r) => r.offsetTop > rows[0].offsetTop + 4);
    const room = (px) => this.panel.el.style.setProperty("--more", `${px}px`);
    room(0);
    let hidden = cut();
    const more = this.panel.layers.reduce((n, l) => n + (l.channel.more ?? 0), 0);
    const parts = [hidden.length && `+${hidden.length}`, more && `${more} not drawn`].filter(Boolean);
    this.rest.textContent = parts.join(", ");
    if (parts.length) {
      room(this.rest.offsetWidth + 10);
      hidden = cut();
      parts[0] = hidden.length ? `+${hidden.length}` : parts[0];
      this.rest.textContent = parts.join(", ");
    }
    this.rest.title = [...hidden.map((r) => r.title), more && `${more} more keys are not drawn`]
      .filter(Boolean)
      .join("\n");
  }

  // Shows the values of the messages at the cursor, which the server sends. The old values are dimmed until it has
  // answered. A value that is older than the pace of its stream explains has its age.
  values() {
    const { panel } = this;
    const cursor = panel.app.time.get().cursor;
    for (const e of this.entries) {
      const { channel, value } = e.layer;
      const error = channel.error ?? value.error;
      const told = error ? null : value.told;
      const i = e.series ? e.series.at(cursor) : -1;
      const text = told ? e.layer.drawer.text(e, told, panel.resolution(e, i)) : "";
      const age = text !== "" && i >= 0 ? e.series.age(i, cursor, told.at) : 0;
      const shown = error ?? (age > 0 ? `${text}, ${duration(age)} ago` : text);
      if (e.text !== shown) e.value.textContent = e.text = shown;
      e.value.classList.toggle("bad", !!error);
      e.value.classList.toggle("old", age > 0);
      e.value.classList.toggle("waiting", !error && !value.holdsAt(cursor));
      const title = `${e.title}${exactValueTip(e, told)}${columnTip(e, i)}`;
      if (e.value.title !== title) e.value.title = title;
    }
  }
}

// The whole value, which the text next to the name may round.
function exactValueTip({ name }, told) {
  const exact = told && (told.values.has(name) ? [told.values.get(name)] : [...told.values.values()]).join(", ");
  return exact ? `\nat the cursor: ${exact}` : "";
}

// Where more messages than pixels are drawn, the column under the cursor stands for several of them.
function columnTip({ series }, i) {
  if (i < 0 || !series.min) return "";
  const sample = series.sampled ? "\nThe line is drawn from a sample of the messages: zoom in for all." : "";
  if (series.raw || !(series.n[i] > 1) || !Number.isFinite(series.min[i])) return sample;
  return `\nin this column: ${series.min[i]} to ${series.max[i]}, ${series.n[i]} messages${sample}`;
}
