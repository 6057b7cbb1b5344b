// Prints times, and checks the number of fetched bytes.
import { test, equal, ok, until } from "./harness.mjs";
import { open } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const { main } = site;

test("speed: a long signal pans and zooms at the screen's frame rate", async ({ page, shot }) => {
  await open(page, main, "big.0000");
  const found = await page.evaluate(() => {
    const l = [...window.situStudio.views].find((v) => v.layers?.length).layers[0];
    return l.channel.series.valueExtent(...window.situStudio.time.get().data)[1];
  });
  equal(found, 25, "the spike survives the summary");
  await shot("long-signal");
  const run = await page.evaluate(async () => {
    const app = window.situStudio,
      panel = [...app.views].find((v) => v.layers?.length);
    const frames = [];
    let last = performance.now();
    const [a, b] = app.time.get().data;
    for (let i = 0; i < 180; i++) {
      if (i < 90) app.time.dispatch({ type: "zoomAt", t: a + (b - a) * 0.4, factor: 0.93 });
      else app.time.dispatch({ type: "pan", by: (app.time.get().view[1] - app.time.get().view[0]) * 0.02 });
      await new Promise((r) => requestAnimationFrame(r));
      const now = performance.now();
      frames.push(now - last);
      last = now;
    }
    frames.sort((x, y) => x - y);
    return {
      p50: frames[90],
      p95: frames[171],
      bytes: app.client.stats.bytes,
      requests: app.client.stats.requests,
      rows: panel.layers[0].channel.series.length,
    };
  });
  console.log(
    `${site.points} points: frame p50 ${run.p50.toFixed(1)} ms, p95 ${run.p95.toFixed(1)} ms, ` +
      `${run.requests} requests, ${(run.bytes / 1e6).toFixed(1)} MB`,
  );
  // Times are printed but not checked, since machines are shared. The fetched bytes are bounded by pixels, not by
  // points.
  // A slow machine draws fewer frames and thus sends more requests per frame, but never more than one.
  ok(run.requests < 200, `${run.requests} requests in 180 frames`);
  ok(run.bytes / run.requests < 1.3e5, `${run.bytes} bytes in ${run.requests} requests`);
  ok(run.rows < 10000, `rows held are bounded by pixels: ${run.rows}`);
});

test("speed: the first image and the cursor", async ({ page }) => {
  await open(page, main, "minute.0000");
  const started = Date.now();
  await page.goto(`${main}/s/minute.0000`);
  await until(
    page,
    () =>
      [...document.querySelectorAll(".image-cell canvas")].every((e) => e.dataset.at) &&
      document.querySelector(".image-cell canvas"),
    "the first image",
  );
  const first = Date.now() - started;
  const times = await page.evaluate(async () => {
    const app = window.situStudio,
      el = document.querySelector(".image-cell canvas");
    const out = [];
    for (let i = 0; i < 60; i++) {
      const t = ((i * 7) % 59) * 1e9 + 5e8;
      const want = String(Math.floor(t / 1e9) * 1e9);
      const t0 = performance.now();
      app.time.dispatch({ type: "cursor", t });
      while (el.dataset.at !== want && performance.now() - t0 < 30000) await new Promise((r) => setTimeout(r, 1));
      out.push(performance.now() - t0);
    }
    return out.sort((a, b) => a - b);
  });
  const p95 = times[Math.floor(times.length * 0.95)];
  console.log(`first image ${first} ms, cursor to image p50 ${times[30].toFixed(1)} ms, p95 ${p95.toFixed(1)} ms`);
  ok(times[59] < 30000, "the image of every cursor position arrives");
});

test("speed: 30 images of 640 x 480 per second, and the page's main thread", async ({ page, context }) => {
  await open(page, main, "Camera");
  const cdp = await context.newCDPSession(page);
  await cdp.send("Performance.enable");
  const metrics = async () => {
    const { metrics: all } = await cdp.send("Performance.getMetrics");
    return Object.fromEntries(all.map((m) => [m.name, m.value]));
  };
  await until(page, () => document.querySelector(".image-cell canvas")?.dataset.at, "an image");
  const before = await metrics();
  const run = await page.evaluate(async () => {
    const canvas = document.querySelector(".image-cell canvas");
    const seen = new Set();
    const end = performance.now() + 5000;
    while (performance.now() < end) {
      seen.add(canvas.dataset.at);
      await new Promise((r) => requestAnimationFrame(r));
    }
    const view = [...window.situStudio.views].find((v) => v.layers?.some((l) => l.picture));
    const { width, height } = view.layers.find((l) => l.picture).picture;
    return { pictures: seen.size, width, height };
  });
  const after = await metrics();
  const seconds = after.Timestamp - before.Timestamp;
  const busy = (after.TaskDuration - before.TaskDuration) / seconds;
  // The times are printed but not checked, since the processor draws here, and other tests may share it.
  console.log(
    `live ${run.width} x ${run.height}: ${(run.pictures / seconds).toFixed(1)} pictures/s, ` +
      `main thread busy ${(100 * busy).toFixed(0)} % (script ${(
        (100 * (after.ScriptDuration - before.ScriptDuration)) /
        seconds
      ).toFixed(0)} %)`,
  );
  equal([run.width, run.height], [640, 480], "the size of the images");
  ok(run.pictures > 10, `${run.pictures} pictures in five seconds`);
});
