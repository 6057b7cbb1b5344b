// The legend of a plot: an entry with the value at the cursor for each signal, or for each key of a stream of maps.

import { formatDuration } from "../time/text.js";

// A second click within this many ms is a double click.
const DOUBLE = 220;

const groupPrefix = (name) => name.slice(0, name.lastIndexOf(".") + 1);

export class Legend {
  constructor(panel) {
    this.panel = panel;
    this.entries = [];
    this.el = panel.el.appendChild(document.createElement("div"));
    this.el.className = "legend";
    this.el.addEventListener("click", (e) => this.handleClick(e));
    this.rest = panel.el.appendChild(document.createElement("div"));
    this.rest.className = "legend-more";
  }

  // Makes the next build recreate every entry.
  invalidate() {
    this.named = null;
  }

  // Creates an entry for each line, and for each stream without data.
  build() {
    const { panel } = this;
    const entries = panel.drawnLines();
    for (const layer of panel.layers) {
      if (!entries.some((e) => e.layer === layer)) entries.push({ layer, name: "", series: null });
    }
    const more = panel.layers.map((l) => l.channel.more ?? 0);
    const named = JSON.stringify([
      more,
      entries.map((e) => [e.layer.vis.name, e.name, panel.lineColor(e, 0), e.layer.vis.props?.visible]),
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
    let nth = 0;
    /** @type {{vis: any} | null} */
    let before = null;
    for (const e of this.entries) {
      const row = this.el.appendChild(document.createElement("button"));
      row.className = "legend-item";
      row.dataset.stream = e.layer.vis.stream;
      row.dataset.key = e.name;
      const swatch = row.appendChild(document.createElement("i"));
      swatch.style.background = panel.lineColor(e, nth++);
      // among neighbors of a group, only the first has its full name
      const { name, short } = e.layer.vis;
      const stream = before && groupPrefix(before.vis.name) === groupPrefix(name) ? (short ?? name) : name;
      const full = e.name === "" ? e.layer.vis.name : `${e.layer.vis.name}  ${e.name}`;
      row.title = `${full}\nClick: hide or show. Double click: only this one.`;
      e.title = full;
      row.type = "button";
      row.classList.toggle("hidden", e.layer.vis.props?.visible === false);
      row.setAttribute("aria-pressed", String(e.layer.vis.props?.visible !== false));
      // the name of a stream is shown once, followed by its keys
      row.appendChild(document.createElement("span")).textContent =
        e.name === "" ? stream : before === e.layer ? e.name : `${stream} ${e.name}`;
      before = e.layer;
      e.value = row.appendChild(document.createElement("b"));
    }
    this.showHiddenCount();
  }

  // Handles a click on a name: it shows or hides the line, a double click shows only that line.
  handleClick(e) {
    const { panel } = this;
    const stream = e.target.closest(".legend-item")?.dataset.stream;
    const index = panel.config.vis.findIndex((v) => v.stream === stream);
    const place = panel.el.closest("[data-panel]")?.dataset.panel;
    if (index < 0 || !place) return;
    clearTimeout(this.clickTimer);
    const pushVisibility = (more) => panel.app.options.push?.("show_vis", { panel: place, index, ...more });
    if (e.detail > 1) pushVisibility({ only: "true" });
    else this.clickTimer = setTimeout(pushVisibility, DOUBLE, {});
  }

  // Shows how many entries do not fit.
  showHiddenCount() {
    const rows = [...this.el.children];
    const hiddenRows = () => rows.filter((r) => r.offsetTop > rows[0].offsetTop + 4);
    const setRoom = (px) => this.panel.el.style.setProperty("--more", `${px}px`);
    setRoom(0);
    let hidden = hiddenRows();
    const more = this.panel.layers.reduce((n, l) => n + (l.channel.more ?? 0), 0);
    const parts = [hidden.length && `+${hidden.length}`, more && `${more} not drawn`].filter(Boolean);
    this.rest.textContent = parts.join(", ");
    if (parts.length) {
      setRoom(this.rest.offsetWidth + 10);
      hidden = hiddenRows();
      parts[0] = hidden.length ? `+${hidden.length}` : parts[0];
      this.rest.textContent = parts.join(", ");
    }
    this.rest.title = [...hidden.map((r) => r.title), more && `${more} more keys are not drawn`]
      .filter(Boolean)
      .join("\n");
  }

  // Shows the values at the cursor, which the server sends. Old values are dimmed until the server has replied. A
  // value that is older than the rate of its stream explains shows its age.
  updateValues() {
    const { panel } = this;
    const cursor = panel.app.time.get().cursor;
    for (const e of this.entries) {
      const { channel, value } = e.layer;
      const error = channel.error ?? value.error;
      const reading = error ? null : value.reading;
      const i = e.series ? e.series.indexAt(cursor) : -1;
      const text = reading ? e.layer.drawer.legendText(e, reading, panel.valueResolution(e, i)) : "";
      const age = text !== "" && i >= 0 ? e.series.messageAge(i, cursor, reading.at) : 0;
      const shown = error ?? (age > 0 ? `${text}, ${formatDuration(age)} ago` : text);
      if (e.text !== shown) e.value.textContent = e.text = shown;
      e.value.classList.toggle("bad", !!error);
      e.value.classList.toggle("old", age > 0);
      e.value.classList.toggle("waiting", !error && !value.holdsAt(cursor));
      const title = `${e.title}${exactValueTip(e, reading)}${columnTip(e, i)}`;
      if (e.value.title !== title) e.value.title = title;
    }
  }
}

// Returns the exact value, which the legend may round. An entry without a name has the values of all channels.
function exactValueTip({ name }, reading) {
  const exact =
    reading &&
    (name === "" && !reading.values.has(name) ? [...reading.values.values()] : [reading.values.get(name) ?? ""]).join(
      ", ",
    );
  return exact ? `\nat the cursor: ${exact}` : "";
}

// Returns the range of the column under the cursor, if it summarizes several messages.
function columnTip({ series }, i) {
  if (i < 0 || !series.min) return "";
  const sample = series.sampled ? "\nThe line is drawn from a sample of the messages: zoom in for all." : "";
  if (series.raw || !(series.n[i] > 1) || !Number.isFinite(series.min[i])) return sample;
  return `\nin this column: ${series.min[i]} to ${series.max[i]}, ${series.n[i]} messages${sample}`;
}
