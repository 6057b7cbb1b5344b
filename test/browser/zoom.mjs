// Measures the time from a zoom until no request is in flight and no drawing is pending, over 10M numbers, 10M
// booleans and an hour of audio at 48 kHz: node zoom.mjs SITE. The goal is a median of 60 ms on an idle machine.
// The times are printed but not checked.
import { chromium } from "playwright-core";
import { open } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-gpu"],
});
const page = await browser.newPage({ viewport: { width: 1280, height: 720 } });
await open(page, site.main, "long.0000");

const runs = await page.evaluate(async () => {
  const { time, client, frames, views } = window.situStudio;
  const still = () =>
    !client.inflight && frames.dirty.size === 0 && ![...views].some((v) => v.layers?.some((l) => l.decoding));
  const turn = () =>
    new Promise((go) => {
      const channel = new MessageChannel();
      channel.port1.onmessage = go;
      channel.port2.postMessage(0);
    });
  const settled = async () => {
    while (!still()) await turn();
  };
  let seed = 7;
  const random = () => (seed = (seed * 16807) % 2147483647) / 2147483647;
  const found = [];
  for (let i = 0; i < 100; i++) {
    const { data, view } = time.get();
    const span = view[1] - view[0];
    // Zooms in repeatedly, down to some ten samples of audio, and then out completely.
    if (span < 1e6 || i % 20 === 19) {
      time.dispatch({ type: "zoomAt", t: data[0] + (data[1] - data[0]) / 2, factor: (data[1] - data[0]) / span });
      await new Promise((go) => setTimeout(go, 500));
      continue;
    }
    const from = Math.max(view[0], data[0]),
      to = Math.min(view[1], data[1]);
    const began = performance.now();
    time.dispatch({ type: "zoomAt", t: from + (to - from) * (0.1 + 0.8 * random()), factor: 0.2 + 0.6 * random() });
    await new Promise((go) => requestAnimationFrame(() => requestAnimationFrame(go)));
    await settled();
    // The page has settled after three frames without activity.
    let at = performance.now();
    for (const end = () => performance.now() > at + 50; !end(); await turn())
      if (!still()) {
        await settled();
        at = performance.now();
      }
    found.push({ span: span / 1e9, ms: at - began });
    await new Promise((go) => setTimeout(go, 100));
  }
  return found;
});
const times = runs.map((r) => r.ms).sort((a, b) => a - b);
const at = (share) => times[Math.floor(share * (times.length - 1))].toFixed(1);
const spans = runs.map((r) => r.span);
console.log(
  `${times.length} zooms, from ${Math.max(...spans).toFixed(0)} s to ${Math.min(...spans).toPrecision(2)} s: ` +
    `settled after p50 ${at(0.5)} ms, p90 ${at(0.9)} ms, max ${at(1)} ms`,
);
if (process.env.SHOTS) await page.screenshot({ path: `${process.env.SHOTS}/zoom.png` });
await browser.close();
