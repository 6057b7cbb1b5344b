// Panels on the time axis: lines, lanes, waveforms and intervals.
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, settled, dispatch, pixel, count, colorOf, panelOf, pointAt, panelIn } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

test("3 timelines: a line is drawn at its values, and the value at the cursor is correct", async ({ page }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Imu.Acc.X");
  await dispatch(page, { type: "cursor", t: 20 * S });
  await settled(page);
  const shown = Number(await page.$eval(`#${id} .legend-item[data-stream="Imu.Acc.X"] b`, (e) => e.textContent));
  near(shown, 9.8 * Math.sin(20 / 3), 0.15, "value at 20 s");
  const drawn = await page.evaluate(
    ([i, [R, G, B]]) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const c = view.plot.ctx.canvas,
        { bbox } = view.plot;
      const out = [];
      for (const s of [5, 15, 25, 45]) {
        const x = Math.round(bbox.left + (s / 60) * bbox.width);
        const d = view.plot.ctx.getImageData(x, 0, 1, c.height).data;
        const v = 9.8 * Math.sin(s / 3);
        const y = bbox.top + bbox.height - ((v - view.y[0]) / (view.y[1] - view.y[0])) * bbox.height;
        let best = 1e9;
        for (let k = 0; k < c.height; k++) {
          const [r, g, b, a] = d.slice(4 * k, 4 * k + 4);
          if (a > 60 && Math.abs(r - R) < 60 && Math.abs(g - G) < 60 && Math.abs(b - B) < 60)
            best = Math.min(best, Math.abs(k - y));
        }
        out.push(best);
      }
      return out;
    },
    [id, await colorOf(page, "Imu.Acc.X")],
  );
  ok(
    drawn.every((d) => d < 4),
    `the line is up to ${Math.max(...drawn)} pixels from its values`,
  );
});

test("3 timelines: waveform, lanes, labels, latency and marks are drawn", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  const wave = await panelOf(page, "Mic.Audio");
  const loud = await page.evaluate((i) => {
    const v = [...window.situStudio.views].find((w) => w.el.id === i);
    const s = v.layers[0].channel.series;
    const at = (t) => s.max[s.indexAt(t)] - s.min[s.indexAt(t)];
    return [at(0.5e9), at(1.5e9), at(2.5e9)];
  }, wave);
  ok(loud[0] > 0.3 && loud[2] > 0.3 && loud[1] < 0.01, `loud, silent, loud: ${loud}`);
  ok((await count(page, `#${wave} canvas`, await colorOf(page, "Mic.Audio"))) > 3000, "the waveform has a body");
  const lanes = await panelOf(page, "Vad.Speaking");
  const y = 13 / (await page.$eval(`#${lanes}`, (e) => e.clientHeight));
  const x = (s) =>
    page.evaluate(
      ([i, t]) => {
        const wide = document.getElementById(i).clientWidth,
          { left } = window.situStudio.gutter;
        return (left + (t / 60) * (wide - left - 14)) / wide;
      },
      [lanes, s],
    );
  const on = await pixel(page, `#${lanes} canvas`, await x(7.5), y);
  ok(on[1] > 120 && on[3] > 100, `true is green: ${on}`);
  const off = await pixel(page, `#${lanes} canvas`, await x(2.5), y - 0.05);
  ok(off[1] < 100 || off[3] < 100, `false is not: ${off}`);
  await page.click("#tree .node[data-stream='Imu.Acc.Y'] .name");
  await page.click("button[phx-value-viz='latency']");
  await until(
    page,
    () =>
      [...window.situStudio.views].some((v) =>
        v.layers?.some((l) => l.vis.draw === "latency" && l.channel.series.length),
      ),
    "the latency panel has data",
  );
  await settled(page);
  const lat = await page.evaluate(
    () => [...window.situStudio.views].find((v) => v.layers?.[0]?.vis.draw === "latency").el.id,
  );
  await page.$eval(`#${lat}`, (e) => e.scrollIntoView());
  await settled(page);
  ok(
    (await count(page, `#${lat} canvas`, [0xf0, 0x98, 0x3e])) > 20,
    "latencies above the limit are in the warning colour",
  );
  await page.click("#tree .node[data-stream='Speech.Text'] .name");
  await page.click("button[phx-value-viz='messages']");
  await until(
    page,
    () =>
      [...window.situStudio.views].some((v) =>
        v.layers?.some((l) => l.vis.viz === "messages" && l.channel.marks?.t.length === 60),
      ),
    "60 marks are held",
  );
  await settled(page);
  await shot("timelines");
});

test("3 timelines: maps are lanes and named lines, and intervals cover their span", async ({ page }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Speech.Who");
  await page.$eval(`#${id}`, (e) => e.scrollIntoView());
  await settled(page);
  const lanes = await page.evaluate((i) => {
    const v = [...window.situStudio.views].find((w) => w.el.id === i);
    const c = v.canvas.getContext("2d"),
      left = window.situStudio.gutter.left,
      k = (v.el.clientWidth - left - 14) / 60,
      r = devicePixelRatio;
    // Returns the painted part of a lane at a second, at the lane's middle and at the height of a body.
    const at = (name, s) => {
      const row = v.rows.findIndex((q) => v.names.children[v.rows.indexOf(q)].textContent === name);
      const y = 4 + row * v.row,
        x = (left + s * k) * r;
      const solid = (py) => c.getImageData(x, py * r, 1, 1).data[3] > 40;
      return solid(y + 3) ? "body" : solid(y + v.row / 2 - 4) ? "line" : "nothing";
    };
    return {
      names: [...v.names.children].map((e) => e.textContent),
      ada: [at("Who Ada", 6), at("Who Ada", 16), at("Who Ada", 26)],
      bob: [at("Who Bob", 16), at("Who Bob", 31), at("Who Bob", 46)],
      spans: v.rows
        .find((q) => q.l.vis.draw === "spans")
        .l.channel.segments.get("")
        .slice(0, 2),
      room: v.row,
    };
  }, id);
  for (const name of ["Who Ada", "Who Bob", "Parts"])
    ok(lanes.names.includes(name), `${name} is among ${lanes.names}`);
  equal(lanes.ada, ["body", "line", "body"], "Ada speaks, is silent, speaks");
  equal(lanes.bob, ["nothing", "line", "nothing"], "Bob comes and goes");
  equal(
    lanes.spans.map(([a, b]) => [a, b]),
    [
      [0, 0.6 * S],
      [S, 1.6 * S],
    ],
    "stretches begin and end where they say",
  );
  ok(lanes.room >= 26, `the panel has room for all lanes: ${lanes.room}`);
  const plot = await panelOf(page, "Speech.Scores");
  await page.$eval(`#${plot}`, (e) => e.scrollIntoView());
  await dispatch(page, { type: "cursor", t: 30 * S });
  await settled(page);
  const legend = await page.$$eval(`#${plot} .legend-item`, (e) =>
    e.map((i) => [i.dataset.key, Number(i.querySelector("b").textContent)]),
  );
  equal(
    legend,
    [
      ["go", 0.5],
      ["stop", 0.5],
    ],
    "a line for each key with its value at the cursor",
  );
  ok(
    (await count(page, `#${plot} canvas`, await colorOf(page, "Speech.Scores"))) > 300 &&
      (await count(page, `#${plot} canvas`, await colorOf(page, "Speech.Scores", 1))) > 300,
    "both lines are drawn",
  );
});

test("3 timelines: zoomed out, the envelope keeps values between the pixels", async ({ page }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Mic.Level");
  const read = () =>
    page.evaluate((i) => {
      const v = [...window.situStudio.views].find((w) => w.el.id === i);
      const l = v.layers.find((k) => k.vis.stream === "Mic.Level").channel.series;
      return { n: l.length, raw: l.raw, extent: l.valueExtent(0, 60e9) };
    }, id);
  const wide = await read();
  ok(!wide.raw && wide.n < 4000, `summaries, bounded by pixels: ${JSON.stringify(wide)}`);
  near(wide.extent[1], 1, 1e-3, "the highest value is kept");
  await dispatch(page, { type: "view", from: 10 * S, to: 11 * S });
  await until(
    page,
    (i) => [...window.situStudio.views].find((w) => w.el.id === i).layers[0].channel.series.raw,
    "single messages are drawn when zoomed in",
    id,
  );
});

test("3 timelines: a threshold covers values below it", async ({ page }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Imu.Acc.X");
  const own = await colorOf(page, "Imu.Acc.X");
  await page.$eval(`#${id}`, (e) => e.scrollIntoView());
  await settled(page);
  const before = await count(page, `#${id} canvas`, own);
  await page.click(`[data-panel="${panelIn(id)}"] button[title='Properties']`);
  await page.selectOption("#threshold-side", "below");
  await page.fill("#threshold-value", "0");
  await until(
    page,
    (i) => JSON.parse(document.getElementById(i).dataset.config).threshold?.value === 0,
    "the threshold is set",
    id,
  );
  await settled(page);
  const after = await count(page, `#${id} canvas`, own);
  ok(after < 0.7 * before && after > 0.3 * before, `about half of the line is covered: ${before} -> ${after}`);
});

test("3 timelines: the tooltip shows a truncated label in full", async ({ page }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Robot.State");
  await page.$eval(`#${id}`, (e) => e.scrollIntoView());
  await settled(page);
  const at = await pointAt(page, id, 6 * S);
  const row = await page.evaluate((i) => {
    const v = [...window.situStudio.views].find((w) => w.el.id === i);
    const n = [...v.names.children].findIndex((e) => e.textContent === "State");
    return v.el.getBoundingClientRect().top + 4 + (n + 0.5) * v.row;
  }, id);
  await page.mouse.move(at.x, row);
  await until(
    page,
    () => document.getElementById("tip")?.textContent === "moving\n0:04.000 to 0:08.000, 4.00 s",
    "the tooltip shows the state",
  );
  await page.mouse.move(5, 5);
  await until(page, () => document.getElementById("tip").hidden, "the tooltip disappears with the mouse");
});

test("3 timelines: a bracket marks where a stream begins late or ends early", async ({ page, shot }) => {
  await open(page, main, "uneven.0000");
  const told = await page.evaluate(() =>
    [...window.situStudio.views]
      .flatMap((v) => v.layers ?? [])
      .map((l) => [l.vis.stream, window.situStudio.client.relativeEnds(l.vis.ends)])
      .sort(),
  );
  equal(
    told,
    [
      ["Late", { first: 20 * S, last: null }],
      ["Short", { first: null, last: 30 * S }],
      ["Whole", null],
    ],
    "ends",
  );
  await settled(page);
  // The foot of the bracket has the color of the line, and is at the top of the plot, away from the line.
  const feet = await page.evaluate(() => {
    const v = [...window.situStudio.views].find((w) => w.plot && w.layers.some((l) => l.vis.stream === "Late"));
    const { ctx, bbox } = v.plot;
    const ink = (s) => {
      const x = Math.round(bbox.left + (s / 60) * bbox.width);
      const d = ctx.getImageData(x - 2, bbox.top, 8, bbox.height).data;
      let n = 0;
      for (let i = 3; i < d.length; i += 4) if (d[i] > 100) n++;
      return n;
    };
    return [ink(20), ink(23)];
  });
  ok(feet[0] > feet[1] + 10, `a line where it begins: ${feet}`);
  await until(
    page,
    () => document.getElementById("t-length-of").textContent === "data ends",
    "the header shows the end of the data",
  );
  await until(page, () => document.getElementById("t-length").textContent.startsWith("1:00.0"), "at that time");
  await shot("uneven");
});

test("3 timelines: the properties set the color and the joins of a line", async ({ page }) => {
  await open(page, main, "many.0000");
  const id = await page.$eval("[phx-hook='Panel']", (e) => e.id),
    panel = panelIn(id);
  const own = await colorOf(page, await page.$eval(`#${id}`, (e) => JSON.parse(e.dataset.config).vis[0].stream));
  const blue = () => count(page, `#${id} canvas`, own, 30),
    magenta = () => count(page, `#${id} canvas`, [255, 0, 255], 60);
  const joined = await blue();
  // The panel may be in tabs, whose strip has its buttons.
  await page.click(`[phx-click='select_panel'][phx-value-id='${panel}'][title='Properties']`);
  await page.selectOption(`#f-${panel}-0-interpolation`, "none");
  await until(
    page,
    (i) => JSON.parse(document.getElementById(i).dataset.config).vis[0].props.interpolation === "none",
    "points only",
    id,
  );
  await settled(page);
  const points = await blue();
  ok(points > 50 && points < joined / 2, `the joins are gone: ${joined} -> ${points}`);
  const swatch = await page.$eval(`#f-${panel}-0-color`, (e) =>
    [1, 3, 5].map((i) => parseInt(e.value.slice(i, i + 2), 16)),
  );
  equal(swatch, own, "the field shows the colour of the line, also after another property was changed");
  await page.$eval(`#f-${panel}-0-color`, (e) => {
    e.value = "#ff00ff";
    e.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await until(
    page,
    (i) => JSON.parse(document.getElementById(i).dataset.config).vis[0].props.color === "#ff00ff",
    "the colour is set",
    id,
  );
  await settled(page);
  ok((await blue()) < 20 && (await magenta()) > 50, "and drawn");
});

test("3 timelines: each line of a plot can have its own axis", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Imu.Acc.X");
  // Returns the tops of the lines X (10 high) and Y (4 high), in pixels of the panel.
  const tops = () =>
    page.evaluate((i) => {
      const view = [...window.situStudio.views].find((v) => v.el.id === i);
      const { height } = view.plot.bbox;
      return view.drawnLines().map((e) => {
        const [lo, hi] = view.y;
        const y = view.heightScale(
          e,
          window.situStudio.time.get().view,
          (v) => height - ((v - lo) / (hi - lo)) * height,
        );
        return Math.round(y(e.layer.drawer.valueExtent(e, window.situStudio.time.get().view)[1]) / devicePixelRatio);
      });
    }, id);
  await settled(page);
  const shared = await tops();
  ok(shared[1] - shared[0] > 5, `on one axis the smaller lies lower: ${shared}`);
  await page.click(`[data-panel="${panelIn(id)}"] button[title=Properties]`, { force: true });
  await until(page, () => document.querySelector("#axis-own"), "its properties");
  await page.check("#axis-own");
  await until(
    page,
    (i) => [...window.situStudio.views].find((v) => v.el.id === i).hasOwnAxes,
    "each has its own",
    id,
  );
  await settled(page);
  const own = await tops();
  ok(Math.abs(own[0] - own[1]) <= 1, `both reach the same height: ${own}`);
  await until(page, () => new URLSearchParams(location.search).get("edit"), "the address includes it");
  await shot("own-axis");
  await page.reload();
  await until(
    page,
    (i) => [...(window.situStudio?.views ?? [])].find((v) => v.el.id === i)?.hasOwnAxes,
    "a reload shows the same",
    id,
  );
  await page.click(`[data-panel="${panelIn(id)}"] button[title=Properties]`, { force: true });
  await until(page, () => document.querySelector("#axis-own")?.checked, "its properties say so");
  await page.uncheck("#axis-own");
  await until(
    page,
    (i) => ![...window.situStudio.views].find((v) => v.el.id === i).hasOwnAxes,
    "on one axis again",
    id,
  );
});
