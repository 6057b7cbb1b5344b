// The page shows only existing data: texts under the mouse are compared with the messages.
import { readFileSync, rmSync, renameSync, readdirSync, cpSync, writeFileSync } from "node:fs";
import { test, equal, ok, until } from "./harness.mjs";
import { open, settled, state, dispatch, legendOf, panelOf, pointAt } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const { main } = site;
const MS = 1e6,
  S = 1e9;

// A pseudorandom number generator that returns the same numbers each time.
function random(seed) {
  return () => (seed = (seed * 48271) % 2147483647) / 2147483647;
}

// Returns the last row at or before a time in ms, and its successor.
function around(rows, t) {
  let lo = 0,
    hi = rows.length;
  while (lo < hi) {
    const mid = (lo + hi) >> 1;
    if (rows[mid][0] <= t) lo = mid + 1;
    else hi = mid;
  }
  return [rows[lo - 1], rows[lo]];
}

const within = (rows, a, b) => rows.filter(([t]) => t >= a && t <= b);

test("7 truth: a table shows exact values at the cursor, before and after", async ({ page, shot }) => {
  const zoo = JSON.parse(readFileSync(site.zoo, "utf8"));
  await open(page, main, "zoo.0000");
  const push = (event, payload) => page.evaluate(([e, p]) => window.situStudio.options.push(e, p), [event, payload]);
  await push("add_viz", { stream: "Zoo.Regular", viz: "table" });
  await page.waitForSelector(".table-cell tbody tr");
  const panel = await page.evaluate(
    () => document.querySelector(".table-cell").closest("[data-panel]").dataset.panel,
  );
  await push("add_viz", { stream: "Zoo.State", viz: "table", panel });
  await until(page, () => document.querySelectorAll(".table-cell tbody tr").length === 2, "two rows");
  const next = random(99);
  for (let round = 0; round < 40; round++) {
    const t = Math.round(next() * 58_000 * MS) / MS;
    await dispatch(page, { type: "cursor", t: t * MS });
    await settled(page);
    const rows = await page.evaluate(() =>
      [...document.querySelectorAll(".table-cell tbody tr")].map((r) => [...r.cells].map((c) => c.textContent)),
    );
    for (const [name, previous, now, , later] of rows) {
      const at = zoo[name].findLastIndex(([ms]) => ms <= t);
      const value = (i) => (zoo[name][i] === undefined ? "" : zoo[name][i][1]);
      const same = (text, expected) => (typeof expected === "number" ? Number(text) === expected : text === expected);
      if (at < 0) equal(now, "no message at the cursor", `${name} at ${t} ms`);
      else
        for (const [text, i] of [
          [previous, at - 1],
          [now, at],
          [later, at + 1],
        ])
          ok(same(text, value(i)), `${name} at ${t} ms: "${text}" is ${value(i)}`);
    }
  }
  await shot("table");
});

test("7 truth: lines and lanes show the messages' values at any zoom", async ({ page, shot }) => {
  const zoo = JSON.parse(readFileSync(site.zoo, "utf8"));
  await page.setViewportSize({ width: 1280, height: 1100 });
  await open(page, main, "zoo.0000");
  await shot("zoo");
  const next = random(20260731);
  let compared = 0,
    old = 0,
    many = 0;
  for (let round = 0; round < 30; round++) {
    const width = 60 * S * 0.0005 ** next(),
      from = next() * (60 * S - width);
    await dispatch(page, { type: "view", from, to: from + width });
    await settled(page);
    const px = (await state(page)).view;
    const ms = (px[1] - px[0]) / 1100 / MS;
    for (let k = 0; k < 3; k++) {
      const t = (px[0] + (0.02 + 0.96 * next()) * (px[1] - px[0])) / MS;
      if (t < 0 || t > 60_000) continue;
      await dispatch(page, { type: "cursor", t: t * MS });
      for (const stream of ["Zoo.Regular", "Zoo.Irregular"])
        compared += await line(stream, zoo[stream], t, 2 * ms + 0.01);
      for (const stream of ["Zoo.Runs", "Zoo.Flicker", "Zoo.State"])
        compared += await lane(stream, "", zoo[stream], t, 3 * ms + 0.01);
      for (const key of ["a", "b"]) {
        compared += await lane(
          "Zoo.Map",
          key,
          zoo["Zoo.Map"].map(([i, m]) => [i, m[key]]),
          t,
          3 * ms + 0.01,
        );
      }
    }
  }
  ok(compared > 250, `${compared} values were compared`);
  ok(old >= 1 && many > 10, `${old} were old, ${many} were many`);

  // The legend shows the exact value of the last message at the cursor, and marks one that is older than its
  // stream's period.
  async function line(stream, rows, t, slack) {
    const { text, exact } = await legendOf(page, stream);
    const [row] = around(rows, Math.round(t * MS) / MS);
    if (!row) return equal(text, "", `${stream} before its first message`) ?? 1;
    equal(Number(exact), row[1], `${stream} at ${t} ms`);
    const value = Number(text.split(",")[0]);
    ok(Math.abs(value - row[1]) < 1e-5, `${stream} at ${t} ms is ${row[1]} and says ${text}`);
    const age = t - row[0];
    if (age > 1000 + slack) {
      ok(text.endsWith(" ago"), `${stream} at ${t} ms is ${age} ms old and says ${text}`);
      old++;
    }
    if (age < 90 && stream === "Zoo.Regular" && slack < 5)
      ok(!text.includes("ago"), `${stream} at ${t} is not old: ${text}`);
    return 1;
  }

  // The tooltip of a lane's segment shows a single state only if no message in the segment has another one.
  async function lane(stream, key, rows, t, slack) {
    const found = await page.evaluate(
      ([s, name, time]) => {
        for (const v of window.situStudio.views) {
          const row = v.rows?.find((r) => r.l.vis.stream === s && r.lane === name);
          if (!row) continue;
          const segments = row.l.channel.segments.get(name) ?? [];
          return segments.find(([a, b]) => a <= time && time < b) ?? null;
        }
        return "no lane";
      },
      [stream, key, t * MS],
    );
    ok(found !== "no lane", `${stream} ${key} has a lane`);
    const [row, later] = around(rows, t);
    // An empty part of a lane has no messages for a while.
    if (!found) {
      const pause = (later?.[0] ?? 60_000) - (row?.[0] ?? 0);
      ok(!row || pause > 40, `${stream} ${key} at ${t} ms shows nothing between ${row} and ${later}`);
      return 1;
    }
    const [a, b, label, cls] = found;
    const inside = within(rows, a / MS + slack, Math.min(b / MS, 60_000) - slack);
    if (cls === "many") {
      many++;
      const all = within(rows, a / MS - 2 * slack, b / MS + 2 * slack);
      ok(
        new Set(all.map(([, v]) => v)).size > 1,
        `${stream} ${key} says ${label} where the messages say one thing only`,
      );
      return 1;
    }
    const other = inside.find(([, v]) => String(v) !== label);
    ok(
      !other,
      `${stream} ${key} says ${label} from ${a / MS} to ${b / MS}, the message at ${other?.[0]} says ${other?.[1]}`,
    );
    if (row && t - row[0] > slack && later && later[0] - t > slack)
      equal(label, String(row[1]), `${stream} ${key} at ${t} ms`);
    return 1;
  }
});

test("7 truth: a column of pixels covers the minimum and the maximum of its messages at any zoom", async ({
  page,
  shot,
}) => {
  await page.setViewportSize({ width: 1280, height: 1000 });
  await open(page, main, "dense.0000");
  const rows = JSON.parse(readFileSync(site.dense, "utf8"));
  const length = rows.length * MS;
  const next = random(20261125);
  let compared = 0;
  for (let round = 0; round < 8; round++) {
    // There are more messages than pixels, so each column represents several.
    const width = round ? length * (0.05 + 0.95 * next()) : length - MS;
    const from = next() * (length - MS - width);
    await dispatch(page, { type: "view", from, to: from + width });
    await settled(page);
    if (!round) await shot("columns");
    compared += await compareColumns(page, rows, round);
  }
  ok(compared > 3000, `${compared} columns were compared`);
});

// Compares the top and the bottom pixel of the line in each column with the messages there. The line must cover the
// messages of the column, and must not extend beyond those of the neighboring columns.
async function compareColumns(page, rows, round) {
  const { view, y, box, columns } = await page.evaluate(lineColumns, "Signal");
  const height = (v) => box.top + box.height - ((v - y[0]) / (y[1] - y[0])) * box.height;
  const time = (c) => (view[0] + ((c - box.left) / box.width) * (view[1] - view[0])) / MS;
  const extremes = (a, b) => {
    const found = rows.slice(Math.max(Math.ceil(a), 0), Math.max(Math.ceil(b), 0));
    return [Math.max(...found), Math.min(...found)];
  };
  let compared = 0;
  for (const [c, top, bottom] of columns) {
    if (c < box.left + 2 || c > box.left + box.width - 3) continue;
    const [most, least] = extremes(time(c), time(c + 1));
    if (most === -Infinity) continue;
    const at = `round ${round}, column ${c}: pixels ${top} to ${bottom}`;
    ok(
      top <= height(most) + 1 && bottom >= height(least) - 1,
      `${at}, its messages ${height(most)}, ${height(least)}`,
    );
    const [over, under] = extremes(time(c - 1), time(c + 2));
    ok(
      top >= height(over) - 1.5 && bottom <= height(under) + 1.5,
      `${at}, around it ${height(over)}, ${height(under)}`,
    );
    compared++;
  }
  return compared;
}

// Runs in the page. Returns the plot of a stream, and the first and the last opaque pixel of the stream's color in
// each column of its canvas.
function lineColumns(stream) {
  const view = [...window.situStudio.views].find((v) => v.plot && v.layers.some((l) => l.vis.stream === stream));
  const { canvas } = view.plot.ctx;
  const color = view.lineColor({ layer: view.layers[0], name: "" }, 0);
  const wanted = [1, 3, 5].map((i) => parseInt(color.slice(i, i + 2), 16));
  const { data, width, height } = view.plot.ctx.getImageData(0, 0, canvas.width, canvas.height);
  const columns = [];
  for (let x = 0; x < width; x++) {
    let top = -1,
      bottom = -1;
    for (let y = 0; y < height; y++) {
      const at = (y * width + x) * 4;
      if (data[at + 3] < 200 || wanted.some((w, i) => Math.abs(data[at + i] - w) > 12)) continue;
      if (top < 0) top = y;
      bottom = y;
    }
    columns.push([x, top, bottom]);
  }
  const { left, top, width: w, height: h } = view.plot.bbox;
  return {
    view: window.situStudio.time.get().view,
    y: view.y,
    box: { left, top, width: w, height: h },
    columns,
  };
}

test("7 truth: a recording that is replaced under its name is shown in its new version", async ({ page }) => {
  await open(page, main, "changing.0000");
  ok((await page.$$("#tree .node[data-stream]")).length > 5, "the streams of the first");
  rmSync(`${site.folder}/changing.0000`, { recursive: true });
  cpSync(`${site.folder}/uneven.0000`, `${site.folder}/changing.tmp`, { recursive: true });
  renameSync(`${site.folder}/changing.tmp`, `${site.folder}/changing.0000`);
  await until(
    page,
    () => document.querySelector("#tree .node[data-stream='Whole']") && document.body.dataset.ready === "1",
    "the streams of the second",
  );
  equal(await page.$$eval("#tree .node[data-stream]", (n) => n.length), 3, "no other streams are listed");
});

test("7 truth: damage is reported with the command that saves the rest", async ({ page, shot }) => {
  const folder = `${site.folder}/broken.0000`;
  for (const file of readdirSync(folder)) if (file.startsWith("data-")) rmSync(`${folder}/${file}`);
  await page.goto(`${main}/s/broken.0000`);
  await until(page, () => document.querySelector(".damage"), "the page says that it is damaged");
  const text = await page.textContent(".damage");
  ok(text.includes("is missing") && text.includes("situ store repair"), text);
  ok(!(await page.textContent("main")).includes("Nothing was recorded"), "it does not say that there is nothing");
  await shot("damaged");
});

test("7 truth: dragging leaves the newest time of a live source, and a click returns to it", async ({
  page,
  shot,
}) => {
  await open(page, main, "Lobby");
  equal((await state(page)).mode, "live", "live");
  ok(!(await page.isVisible(".pill")), "no way back is needed");
  const id = await panelOf(page, "Level");
  const head = (await state(page)).data[1];
  const at = await pointAt(page, id, head - 5 * S);
  await page.mouse.down();
  await page.mouse.move(at.x + 120, at.y, { steps: 5 });
  await page.mouse.up();
  const view = (await state(page)).view;
  equal((await state(page)).mode, "manual", "dragging has left it");
  await page.waitForTimeout(600);
  equal((await state(page)).view, view, "and the view stays");
  await shot("back-to-live");
  await page.click(".pill");
  equal((await state(page)).mode, "live", "live mode is on again");
  // The rates are those of the window: 30 on an idle machine. Counted over the entire past, they would be in the
  // hundreds, or very low.
  await until(
    page,
    () => {
      const rate = parseFloat(document.querySelector("#tree .node[data-stream='Level'] .info").textContent);
      return rate > 12 && rate < 36;
    },
    "the message rate is shown",
  );
});

test("7 truth: a pipeline that has ended is reported, its past remains, and it continues", async ({ page, shot }) => {
  rmSync(site.stop, { force: true });
  await open(page, main, "Brief");
  const id = await panelOf(page, "Brief.Level");
  await until(
    page,
    (i) => [...window.situStudio.views].find((v) => v.el.id === i)?.layers[0].channel.series.length > 20,
    "a line",
    id,
  );
  writeFileSync(site.stop, "1");
  await until(
    page,
    () => document.getElementById("connection").textContent.startsWith("ended "),
    "said in the status line",
  );
  const over = await state(page);
  equal(over.mode, "manual", "live mode is off");
  await shot("ended");
  rmSync(site.stop);
  await until(page, () => document.getElementById("connection").textContent === "connected", "it continues");
  await until(page, (end) => window.situStudio.time.get().data[1] > end + 1e9, "with new messages", over.data[1]);
  equal((await state(page)).mode, "live", "which the page follows again");
  await shot("goes-on");
  await page.goto(`${main}/s/Brief`);
  await until(
    page,
    () => [...(window.situStudio?.views ?? [])].some((v) => v.plot && v.layers[0].channel.series.length > 20),
    "its past after a reload",
  );
});

test("7 truth: the address includes whether the cursor follows the mouse; a click during playback seeks", async ({
  page,
}) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Vad.Speaking");
  await pointAt(page, id, 20 * S);
  // The address contains integer nanoseconds.
  const at = (BigInt(site.t0) + BigInt(Math.round((await state(page)).cursor))).toString().slice(0, -3);
  await until(
    page,
    (t) => new URLSearchParams(location.search).get("at")?.startsWith(t),
    "the address includes the cursor",
    at,
  );
  await page.reload();
  await until(page, () => document.body?.dataset.ready === "1", "loaded");
  // The names next to the lanes take space, so positions of times are known only after they are drawn.
  await settled(page);
  ok((await state(page)).follow, "the cursor still follows");
  await page.keyboard.press("Space");
  await until(page, () => window.situStudio.time.get().mode === "play", "plays");
  const place = await pointAt(page, id, 40 * S);
  const clicked = Date.now();
  await page.mouse.click(place.x, place.y);
  const s = await state(page);
  equal(s.mode, "play", "plays on");
  const played = (Date.now() - clicked) * 1e6;
  ok(s.cursor > 39.8 * S && s.cursor < 40.2 * S + played, `from there: ${s.cursor} after ${played} ns`);
});
