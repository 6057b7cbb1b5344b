// Keeps a live page open: node soak.mjs SITE MINUTES PID. Prints a row per minute with the page's heap after a
// collection, its nodes, its fetched bytes, and the studio's memory and CPU time (including the recording's
// writer). Fails if the memory of the last minute exceeds that of the second minute by more than a fifth.
import { readFileSync } from "node:fs";
import { chromium } from "playwright-core";
import { open } from "./studio_page.mjs";

const [site, minutes, pid] = [JSON.parse(process.argv[2]), Number(process.argv[3]), process.argv[4]];
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-gpu"],
});
const page = await browser.newPage({ viewport: { width: 1280, height: 720 } });
const probe = await page.context().newCDPSession(page);
await probe.send("HeapProfiler.enable");
await open(page, site.main, "growing.0000");

const MB = 1e6,
  TICKS = 100;
const resident = () => Number(/VmRSS:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, "utf8"))[1]) / 1024;
const own = () => Number(/RssAnon:\s+(\d+)/.exec(readFileSync(`/proc/${pid}/status`, "utf8"))[1]) / 1024;
const busy = () =>
  readFileSync(`/proc/${pid}/stat`, "utf8")
    .split(") ")[1]
    .split(" ")
    .slice(11, 13)
    .reduce((a, b) => a + Number(b), 0) / TICKS;

const rows = [];
let spent = busy(),
  asked = 0;
console.log("minute  heap MB  nodes  listeners  updates/s  fetched MB  server MB  of it its own  server CPU %");
for (let minute = 1; minute <= minutes; minute++) {
  await page.waitForTimeout(60_000);
  await probe.send("HeapProfiler.collectGarbage");
  const { jsHeapUsedSize: heap } = await page.evaluate(() => ({ jsHeapUsedSize: performance.memory.usedJSHeapSize }));
  const { nodes, jsEventListeners } = await probe.send("Memory.getDOMCounters");
  const seen = await page.evaluate(() => ({
    requests: window.situStudio.client.stats.requests,
    bytes: window.situStudio.client.stats.bytes,
    mode: window.situStudio.time.get().mode,
  }));
  if (seen.mode !== "live") throw new Error(`the page has left live mode: ${seen.mode}`);
  const now = busy();
  const row = { heap: heap / MB, nodes, own: own() };
  rows.push(row);
  console.log(
    [
      minute,
      row.heap.toFixed(1),
      nodes,
      jsEventListeners,
      ((seen.requests - asked) / 60).toFixed(1),
      (seen.bytes / MB).toFixed(1),
      resident().toFixed(0),
      row.own.toFixed(0),
      (((now - spent) / 60) * 100).toFixed(1),
    ].join("\t"),
  );
  [spent, asked] = [now, seen.requests];
}
await browser.close();

const [early, late] = [rows[Math.min(1, rows.length - 1)], rows.at(-1)];
const grown = ["heap", "nodes", "own"].filter((k) => late[k] > early[k] * 1.2);
console.log(grown.length ? `grown: ${grown.join(", ")}` : "nothing has grown");
process.exit(grown.length ? 1 : 0);
