// Compares every pixel column, legend, tip and table of random recordings at random zooms with the messages.
// SITU_WINDOWS=5000 compares more windows; SEED=N compares others.
import { readFileSync } from "node:fs";
import { test, ok } from "./harness.mjs";
import { open, panelOf } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const MS = 1e6;
const LINES = ["tiny", "huge", "offset", "integer", "missing", "odd"];
const LANES = ["boolean", "state", "flags", "interval"];
// The most differences that are printed.
const MOST = 20;

// A pseudorandom number generator with a seed.
function random(seed) {
  let s = (seed * 7919 + 17) % 2147483647;
  return () => (s = (s * 48271) % 2147483647) / 2147483647;
}

// Returns the number of rows at or before a time.
function upTo(rows, t) {
  let lo = 0,
    hi = rows.length;
  while (lo < hi) {
    const mid = (lo + hi) >> 1;
    if (rows[mid][0] <= t) lo = mid + 1;
    else hi = mid;
  }
  return lo;
}

// Runs in the page. Shows a window and the cursor, waits until everything is drawn, and returns the lines and lanes
// pixel by pixel, legends, tips and the table.
async function readPage({ lines, lanes, places, from, to, moment }) {
  const { client, frames } = window.situStudio;
  window.situStudio.time.dispatch({ type: "view", from, to });
  window.situStudio.time.dispatch({ type: "cursor", t: moment });
  const done = performance.now() + 60_000;
  for (let still = 0; still < 4;) {
    await new Promise(requestAnimationFrame);
    const waiting = document.querySelector(".legend-item b.waiting");
    still = !client.inflight && frames.dirty.size === 0 && !waiting ? still + 1 : 0;
    if (performance.now() > done) throw new Error("the page is not still");
  }
  const { views, time } = window.situStudio;
  const { view, cursor } = time.get();
  const rgb = (color) => [1, 3, 5].map((i) => parseInt(color.slice(i, i + 2), 16));
  const grid = rgb(getComputedStyle(document.documentElement).getPropertyValue("--grid").trim());
  const findView = (stream) =>
    [...views].find((v) => v.layers?.some((l) => l.vis.stream === stream) && v.el.isConnected);
  const readLine = (stream) => {
    const v = findView(stream);
    const { canvas } = v.plot.ctx;
    const wanted = rgb(v.lineColor(v.drawnLines()[0] ?? { layer: v.layers[0], name: "" }, 0));
    const { data, width, height } = v.plot.ctx.getImageData(0, 0, canvas.width, canvas.height);
    const away = wanted.map((w, i) => w - grid[i]);
    const size = away.reduce((sum, d) => sum + d * d, 0);
    const columns = [];
    for (let x = 0; x < width; x++) {
      // the first and the last pixel with some of the line's color, and with most of it
      const found = [-1, -1, -1, -1];
      for (let y = 0; y < height; y++) {
        const at = (y * width + x) * 4;
        const alpha = data[at + 3];
        if (alpha < 12) continue;
        let share = 0;
        for (let i = 0; i < 3; i++) share += ((data[at + i] - grid[i]) * away[i]) / size;
        if (share < 0.2) continue;
        if (found[0] < 0) found[0] = y;
        found[1] = y;
        if (alpha < 120 || share < 0.8) continue;
        if (found[2] < 0) found[2] = y;
        found[3] = y;
      }
      columns.push(found);
    }
    const { left, top, width: w, height: h } = v.plot.bbox;
    return { y: v.y, box: { left, top, width: w, height: h }, columns, raw: v.drawnLines()[0]?.series.raw };
  };
  // Of each lane, the color a third below its upper edge, in each column.
  const readLanes = (stream) => {
    const v = findView(stream);
    const ctx = v.canvas.getContext("2d");
    const box = v.el.getBoundingClientRect();
    const inner = box.width - window.situStudio.gutter.left - 14;
    const rows = v.rows.flatMap((r, i) => (r.l.vis.stream === stream ? [[r.lane, i]] : []));
    return rows.map(([lane, i]) => {
      const h = Math.max(v.row - Math.min(8, v.row * 0.3), 2);
      const y = Math.round(4 + i * v.row + h * 0.2);
      const { data } = ctx.getImageData(0, y, v.canvas.width, 1);
      const colors = [...data];
      const tips = places.map((part) => {
        const mouse = { clientX: box.left + window.situStudio.gutter.left + part * inner };
        return v.describeUnder({ ...mouse, clientY: box.top + 4 + (i + 0.5) * v.row });
      });
      return { lane, left: window.situStudio.gutter.left, width: inner, colors, tips };
    });
  };
  const legends = [...document.querySelectorAll(".legend-item")].map((row) => {
    const b = row.querySelector("b");
    const exact = /^at the cursor: (.*)$/m.exec(b.title)?.[1] ?? "";
    return { stream: row.dataset.stream, key: row.dataset.key, text: b.textContent, exact };
  });
  const table = [...document.querySelectorAll(".table-cell tbody tr")].map((r) =>
    [...r.cells].map((c) => c.textContent),
  );
  // as text, since the driver takes long for nested lists
  return JSON.stringify({
    view,
    cursor,
    lines: Object.fromEntries(lines.map((s) => [s, readLine(s)])),
    lanes: Object.fromEntries(lanes.map((s) => [s, readLanes(s)])),
    legends,
    table,
  });
}

// Adds the times and the numbers of a stream's rows, which are read for every column.
function prepare(stream) {
  stream.times = Float64Array.from(stream.rows, ([t]) => t);
  stream.numbers = Float64Array.from(stream.rows, ([, v]) => (v === null || v === "nan" ? NaN : Number(v)));
}

// Returns the number of times at or before a time.
function countTo(times, t) {
  let lo = 0,
    hi = times.length;
  while (lo < hi) {
    const mid = (lo + hi) >> 1;
    if (times[mid] <= t) lo = mid + 1;
    else hi = mid;
  }
  return lo;
}

// Returns the least and the greatest number of the rows a to b, and how many are missing.
function extremes(numbers, a, b) {
  let [least, most, missing] = [Infinity, -Infinity, 0];
  for (let i = Math.max(a, 0); i < Math.min(b, numbers.length); i++) {
    const v = numbers[i];
    if (Number.isNaN(v)) missing++;
    if (v < least) least = v;
    if (v > most) most = v;
  }
  return [least, most, missing];
}

// Compares the columns of a line with its messages: it covers the messages of each column, does not leave the range of
// the messages around it, and is interrupted only at gaps and missing values.
function compareLine({ name, times, numbers, period }, { y: [lo, hi], box, columns }, view, differ) {
  if (!times.length) return 0;
  const fraction = (v) => (v / 4 - lo / 4) / (hi / 4 - lo / 4);
  const height = (v) => box.top + box.height - fraction(v) * box.height;
  const px = (view[1] - view[0]) / box.width;
  const time = (c) => view[0] + (c - box.left) * px;
  let n = 0;
  for (let c = Math.ceil(box.left) + 2; c < box.left + box.width - 3; c++) {
    // Brackets at the ends of a stream have its color, too.
    if (Math.abs(times[0] - time(c)) < 10 * px || Math.abs(times.at(-1) - time(c)) < 10 * px) continue;
    const [top, bottom, solidTop, solidBottom] = columns[c];
    const say = (text) => differ(`${name}, column ${c} at ${time(c)}: pixels ${top} to ${bottom}, ${text}`);
    n++;
    // A message at the edge of a pixel may be mostly in the next one, and the line of a message before a missing value
    // ends there, so that it covers only a part of the pixel.
    const [least, most] = extremes(numbers, countTo(times, time(c + 0.25)), countTo(times, time(c + 0.75)));
    if (least <= most && (top < 0 || top > height(most) + 1.6 || bottom < height(least) - 1.6))
      say(`its messages are at ${height(most)} to ${height(least)}`);
    const [i, j] = [countTo(times, time(c - 2)) - 1, countTo(times, time(c + 3)) + 1];
    const [under, over, missing] = extremes(numbers, i, j);
    if (solidTop >= 0 && !(under <= over)) say("there are no messages");
    else if (solidTop >= 0 && (solidTop < height(over) - 3 || solidBottom > height(under) + 3))
      say(`around it ${height(over)} to ${height(under)}`);
    // In a pause of more than thirty periods nothing is drawn, and between consecutive messages a line is.
    const next = countTo(times, time(c - 3));
    const pause = next > 0 && times[next] > time(c + 4) ? times[next] - times[next - 1] : 0;
    if (period && pause > 30 * period + 8 * px && solidTop >= 0) say(`in a gap of ${pause / MS} ms`);
    if (period && top < 0 && pause && pause < 1.5 * period && !missing)
      say(`between messages ${pause / MS} ms apart`);
  }
  return n;
}

const sameColor = (a, b) => a.every((v, i) => Math.abs(v - b[i]) <= 6);

// Returns the longest pause between the messages i - 1 to j.
function longestPause(rows, i, j) {
  let most = 0;
  for (let k = i; k <= j; k++) most = Math.max(most, rows[k][0] - rows[k - 1][0]);
  return most;
}

// Compares the colors of a lane with its messages, where these say one thing in a column and its neighbors.
function compareLane(stream, key, lane, view, differ) {
  const { name, kind, rows, period } = stream;
  const time = (x) => view[0] + ((x - lane.left) / lane.width) * (view[1] - view[0]);
  const value = (v) => (kind === "flags" ? v[key] : v);
  const last = rows.at(-1)?.[0] ?? 0;
  const looks = new Map();
  let n = 0;
  for (let x = Math.ceil(lane.left) + 4; x < lane.left + lane.width - 5; x++) {
    const [a, b] = [time(x - 3), time(x + 4)];
    if (a < 0 || b > last) continue;
    const at = `${name} ${key}, column ${x} at ${time(x)}`;
    const color = lane.colors.slice(4 * x, 4 * x + 4);
    // Lines of the grid are opaque.
    if (color[3] === 255) continue;
    if (kind === "interval") {
      const near = rows.filter(([, [from, to]]) => from <= b && to >= a);
      const inside = near.some(([, [from, to]]) => from <= a && to >= b);
      if (inside && color[3] < 20) differ(`${at}: no color within an interval`);
      if (!near.length && color[3] >= 20) differ(`${at}: color ${color} without an interval`);
      n++;
      continue;
    }
    const [i, j] = [upTo(rows, a), upTo(rows, b)];
    const seen = new Set(rows.slice(Math.max(i - 1, 0), j).map(([, v]) => value(v)));
    // A pause may be a gap, in which nothing is drawn.
    if (seen.size !== 1 || i === 0 || j === rows.length || longestPause(rows, i, j) > 3 * period) continue;
    const [said] = seen;
    n++;
    if (said === false) {
      if (color[3] >= 128) differ(`${at}: color ${color} where the messages are false`);
      continue;
    }
    const look = looks.get(said);
    if (color[3] < 60) differ(`${at}: no color where the messages are ${said}`);
    else if (!look) looks.set(said, color);
    else if (kind !== "state" && !sameColor(look, color))
      differ(`${at}: color ${color} instead of ${look} for ${said}`);
  }
  return n;
}

function compareTips(stream, key, lane, { view, places }, differ) {
  const { name, kind, rows } = stream;
  let n = 0;
  lane.tips.forEach((tip, k) => {
    const t = view[0] + places[k] * (view[1] - view[0]);
    const slack = (5 * (view[1] - view[0])) / lane.width + 1;
    const [label] = tip;
    if (!tip.length || /\d/.test(label ?? "")) return;
    n++;
    if (kind === "interval") return;
    const near = rows.slice(Math.max(upTo(rows, t - slack) - 1, 0), upTo(rows, t + slack));
    const said = near.map(([, v]) => String(kind === "flags" ? v[key] : v));
    if (!said.includes(label))
      differ(`${name} ${key}: the tip at ${t} says ${label}, the messages ${said.slice(0, 5)}`);
  });
  return n;
}

// A value is shown exactly in the tip of the legend. Numbers are compared as numbers, large integers as texts.
const sameValue = (text, value) =>
  value === null || value === undefined
    ? text === ""
    : typeof value === "string"
      ? text === value ||
        (value !== "nan" && BigInt(Math.trunc(Number(text))) === BigInt(value) && text.includes("e"))
      : Number(text) === value;

function compareLegends(streams, { legends, cursor }, differ) {
  let n = 0;
  for (const { stream: name, key, text, exact } of legends) {
    const stream = streams.find((s) => s.name === name);
    if (!stream) continue;
    const row = stream.rows[upTo(stream.rows, Math.round(cursor)) - 1];
    const value = stream.kind === "map" ? (row?.[1][key] ?? null) : (row?.[1] ?? null);
    const at = `the legend of ${name} ${key} at ${cursor}`;
    n++;
    // A map without a message in view has no lines, and one legend for all of its values.
    if (stream.kind === "map" && key === "") {
      const all = Object.keys(row?.[1] ?? {}).sort();
      const same = all.map((k) => String(row[1][k])).join() === exact.split(", ").map(Number).join();
      if (all.length > 0 && !same) differ(`${at}: ${exact} instead of ${JSON.stringify(row[1])}`);
      continue;
    }
    if (!sameValue(exact, value)) differ(`${at}: ${exact} instead of ${JSON.stringify(value)}`);
    if (value === null || value === "nan") continue;
    const shown = Number(text.split(",")[0]);
    const rounding = Math.abs(shown - Number(value)) / Math.max(Math.abs(Number(value)), Number.MIN_VALUE);
    if (!(rounding <= 1e-5)) differ(`${at}: "${text}" instead of ${value}`);
  }
  return n;
}

function compareTable(streams, { table, cursor }, differ) {
  let n = 0;
  for (const [name, previous, now, , later] of table) {
    const stream = streams.find((s) => s.name === name);
    if (!stream) continue;
    const i = upTo(stream.rows, Math.round(cursor)) - 1;
    const at = `the table's row ${name} at ${cursor}`;
    n++;
    if (i < 0) {
      if (now !== "no message at the cursor") differ(`${at}: ${now} before the first message`);
      continue;
    }
    for (const [text, k] of [
      [previous, i - 1],
      [now, i],
      [later, i + 1],
    ]) {
      const value = stream.rows[k]?.[1];
      const said =
        typeof value === "boolean" || typeof value === "string" ? text === String(value) : sameValue(text, value);
      if (!said && !(value === null && text === "nil"))
        differ(`${at}: ${JSON.stringify(text)} instead of ${JSON.stringify(value)}`);
    }
  }
  return n;
}

// Puts panels in tabs one below the other, so that all of them are on the page.
async function spreadTabs(page) {
  const hidden = await page.$$eval(".part-tabs .tab[aria-selected='false']", (tabs) =>
    tabs.map((tab) => [
      tab.dataset.drag,
      tab.closest(".part-tabs").querySelector("[aria-selected='true']").dataset.drag,
    ]),
  );
  for (const [id, target] of hidden)
    await page.evaluate((p) => window.situStudio.options.push("place_panel", p), { id, side: "below", target });
  await page.waitForFunction(() => !document.querySelector(".part-tabs"));
}

// Shows a table of a number, an integer and a state.
async function addTable(page) {
  const push = (payload) => page.evaluate((p) => window.situStudio.options.push("add_viz", p), payload);
  await push({ stream: "C.Offset", viz: "table" });
  await page.waitForSelector(".table-cell tbody tr");
  const panel = await page.evaluate(
    () => document.querySelector(".table-cell").closest("[data-panel]").dataset.panel,
  );
  for (const stream of ["D.Integer", "I.State", "H.Boolean"]) await push({ stream, viz: "table", panel });
  await page.waitForFunction(() => document.querySelectorAll(".table-cell tbody tr").length === 4);
}

test("7 windows: every pixel column, legend, tip and table agrees with the messages", async ({ page, shot }) => {
  const { seed, windows, recordings } = JSON.parse(readFileSync(site.windows, "utf8"));
  await page.setViewportSize({ width: 1280, height: 1700 });
  const differences = [];
  const counts = { windows: 0, columns: 0, legends: 0, tips: 0, rows: 0 };
  for (const [i, { name, length, streams }] of recordings.entries()) {
    const next = random(seed + i);
    await open(page, site.main, name);
    await spreadTabs(page);
    await addTable(page);
    streams.forEach(prepare);
    const of = (kinds) => streams.filter((s) => kinds.includes(s.kind));
    for (const s of streams) await panelOf(page, s.name);
    const wanted = { lines: of(LINES).map((s) => s.name), lanes: of(LANES).map((s) => s.name) };
    for (let k = 0; k < Math.ceil(windows / recordings.length); k++) {
      const width = k ? length * 2e-4 ** next() : length;
      const from = next() * (length - width);
      const cursor = Math.round(from + next() * width);
      const places = [next(), next()];
      const shown = JSON.parse(
        await page.evaluate(readPage, { ...wanted, places, from, to: from + width, moment: cursor }),
      );
      const at = `${name}, ${from} to ${from + width}`;
      const differ = (text) => {
        differences.push(`${at}: ${text}`);
        if (differences.length <= MOST) console.log(`    ${differences.at(-1)}`);
      };
      for (const s of of(LINES)) counts.columns += compareLine(s, shown.lines[s.name], shown.view, differ);
      for (const s of of(LANES))
        for (const lane of shown.lanes[s.name]) {
          counts.columns += compareLane(s, lane.lane, lane, shown.view, differ);
          counts.tips += compareTips(s, lane.lane, lane, { ...shown, places }, differ);
        }
      counts.legends += compareLegends(streams, shown, differ);
      counts.rows += compareTable(streams, shown, differ);
      counts.windows++;
      if (counts.windows % 250 === 0) console.log(`${counts.windows} windows, ${differences.length} differences`);
    }
    if (!i) await shot("windows");
  }
  console.log(`windows: ${JSON.stringify(counts)}, ${differences.length} differences, SEED=${seed}`);
  ok(differences.length === 0, `SEED=${seed}: ${differences.length} differences, such as ${differences[0]}`);
  ok(counts.windows >= windows && counts.columns > windows * 1000 && counts.tips > 0, JSON.stringify(counts));
});
