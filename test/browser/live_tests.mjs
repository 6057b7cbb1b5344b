// Recordings that grow, pipelines that run, and sources that go away.
import { rmSync, writeFileSync } from "node:fs";
import { PATIENCE, test, equal, ok, near, until } from "./harness.mjs";
import { open, state, dispatch, panelOf } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const { main } = site;
const S = 1e9;

test("6 live: follows what grows, leaves and comes back", async ({ page, shot }) => {
  await open(page, main, "growing.0000");
  equal((await state(page)).mode, "live", "opening something that grows follows it");
  const first = await state(page);
  near(first.view[1] - first.view[0], 30 * S, 1e3, "30 s in view");
  near((first.cursor - first.view[0]) / (first.view[1] - first.view[0]), 0.8, 0.001, "cursor at 80 %");
  await until(page, (c) => window.situStudio.time.get().cursor > c + 1.5e9, "the cursor goes on", first.cursor);
  const second = await state(page);
  equal(second.cursor, second.data[1], "with the newest time");
  const image = await panelOf(page, "Live.Image");
  await until(
    page,
    (i) => {
      const at = document.querySelector(`#${i} canvas`).dataset.at;
      return at && Math.abs(window.situStudio.time.get().cursor - Number(at)) < 0.6e9;
    },
    "the newest picture is shown",
    image,
  );
  await shot("live");
  await page.keyboard.press("l");
  const left = await state(page);
  equal(left.mode, "manual", "left");
  await until(page, (end) => window.situStudio.time.get().data[1] > end, "the data grows", left.data[1]);
  equal((await state(page)).cursor, left.cursor, "the cursor stays");
  await page.keyboard.press("l");
  equal((await state(page)).mode, "live", "back");
});

// The newest of a pipeline's numbers that a page has drawn.
const newest = (page) =>
  page.evaluate(() => {
    const layers = [...window.situStudio.views].filter((v) => v.plot).flatMap((v) => v.layers);
    const s = layers.find((l) => l.vis.stream === "Clock.Count")?.channel.series;
    // The newest bins may hold nothing yet.
    let i = (s?.length ?? 0) - 1;
    while (i > 0 && !Number.isFinite(s.last[i])) i--;
    return i < 0 ? 0 : s.last[i];
  });

// Waits until a page has drawn a number as new as this; returns the newest.
async function drawn(page, number, what) {
  for (const end = Date.now() + PATIENCE; Date.now() < end; await new Promise((r) => setTimeout(r, 50))) {
    const n = await newest(page);
    if (n >= number) return n;
  }
  throw new Error(`waited in vain until ${what}: ${await newest(page)} instead of ${number}`);
}

test("6 live: a running pipeline is looked into; a page that hangs does not slow it", async ({
  page,
  browser,
  shot,
}) => {
  await open(page, main, "Lobby");
  equal((await state(page)).mode, "live", "live");
  await until(
    page,
    () => {
      const image = document.querySelector(".image-cell"),
        line = [...window.situStudio.views].find((v) => v.plot);
      return image?.querySelector("canvas").dataset.at && line?.layers.every((l) => l.channel.series.length > 10);
    },
    "picture and lines move",
  );
  const elsewhere = await browser.newContext();
  const other = await elsewhere.newPage();
  await open(other, main, "Lobby");
  const start = await drawn(other, (await drawn(page, 1, "the page draws")) + 1, "both pages draw");
  // A dialog halts the page's code for exactly as long as it stands; the other page sees two seconds of messages
  // meanwhile.
  const dialog = page.waitForEvent("dialog");
  const hung = page.evaluate(() => alert("halted"));
  const standing = await dialog;
  const later = await drawn(other, start + 60, "the pipeline goes on while a page hangs");
  await standing.dismiss();
  await hung;
  await drawn(page, later, "the page is at the newest again");
  await shot("pipeline-live");
  await elsewhere.close();
});

test("a recording that is deleted while open: said, and the rest goes on", async ({ page }) => {
  await open(page, main, "doomed.0000");
  rmSync(`${site.folder}/doomed.0000`, { recursive: true });
  await page.waitForTimeout(1100);
  await dispatch(page, { type: "cursor", t: 10 * S });
  await page.evaluate(() => window.situStudio.client.pump(true));
  await until(page, () => document.body?.dataset.connection === "gone", "the page says that it is gone");
  await until(page, () => document.getElementById("banner").textContent.includes("deleted or moved"), "in words");
  await open(page, main, "minute.0000");
});

test("a server that is started anew: said while it is away, and the page is as it was", async ({ page, shot }) => {
  await open(page, site.mortal, "minute.0000");
  await page.click(".row-box [title='Remove'] >> nth=0");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "the layout is changed");
  await dispatch(page, { type: "select", from: 12 * S, to: 18 * S });
  await dispatch(page, { type: "nudge", by: 15 * S });
  await until(page, () => new URLSearchParams(location.search).get("sel"), "the address holds the selection");
  const panels = await page.$$eval("[data-panel]", (p) => p.length);
  writeFileSync(site.away, "");
  await until(
    page,
    () => document.getElementById("banner").textContent.includes("does not answer"),
    "the page says that the server is away",
  );
  await until(page, () => document.getElementById("connection").textContent === "reconnecting", "the status line");
  await shot("server-away");
  rmSync(site.away);
  await until(
    page,
    () =>
      document.body?.dataset.connection === "open" &&
      document.getElementById("toast")?.textContent === "Connected again",
    "connected again, in words",
  );
  await until(
    page,
    () => document.body?.dataset.ready === "1" && document.querySelector("[data-phx-main].phx-connected"),
    "all of it is back",
  );
  await until(page, () => document.getElementById("banner").textContent === "", "no banner any more");
  const s = await state(page);
  equal([s.sel, s.cursor], [[12 * S, 18 * S], 15 * S], "selection and cursor are kept");
  equal(await page.$$eval("[data-panel]", (p) => p.length), panels, "and the layout");
});
