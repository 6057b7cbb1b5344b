// Growing recordings, running pipelines, and sources that go away.
import { rmSync, writeFileSync } from "node:fs";
import { PATIENCE, test, equal, near, until } from "./harness.mjs";
import { open, state, dispatch, panelOf } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const { main } = site;
const S = 1e9;

test("6 live: the view follows new messages, leaves live mode and returns", async ({ page, shot }) => {
  await open(page, main, "growing.0000");
  equal((await state(page)).mode, "live", "a growing recording opens in live mode");
  const first = await state(page);
  near(first.view[1] - first.view[0], 30 * S, 1e3, "30 s in view");
  near((first.cursor - first.view[0]) / (first.view[1] - first.view[0]), 0.8, 0.001, "cursor at 80 %");
  await until(page, (c) => window.situStudio.time.get().cursor > c + 1.5e9, "the cursor moves on", first.cursor);
  const second = await state(page);
  equal(second.cursor, second.data[1], "the cursor is at the newest time");
  const image = await panelOf(page, "Live.Image");
  await until(
    page,
    (i) => {
      const at = document.querySelector(`#${i} canvas`).dataset.at;
      return at && Math.abs(window.situStudio.time.get().cursor - Number(at)) < 0.6e9;
    },
    "the newest image is shown",
    image,
  );
  await shot("live");
  await page.keyboard.press("l");
  const left = await state(page);
  equal(left.mode, "manual", "live mode is off");
  await until(page, (end) => window.situStudio.time.get().data[1] > end, "the data grows", left.data[1]);
  equal((await state(page)).cursor, left.cursor, "the cursor stays");
  await page.keyboard.press("l");
  equal((await state(page)).mode, "live", "live mode is on again");
});

// Returns the newest number of a pipeline that a page has drawn.
const newest = (page) =>
  page.evaluate(() => {
    const layers = [...window.situStudio.views].filter((v) => v.plot).flatMap((v) => v.layers);
    const s = layers.find((l) => l.vis.stream === "Clock.Count")?.channel.series;
    // The newest bins may be empty.
    let i = (s?.length ?? 0) - 1;
    while (i > 0 && !Number.isFinite(s.last[i])) i--;
    return i < 0 ? 0 : s.last[i];
  });

// Waits until a page has drawn a number at least this new, and returns the newest.
async function drawn(page, number, what) {
  for (const end = Date.now() + PATIENCE; Date.now() < end; await new Promise((r) => setTimeout(r, 50))) {
    const n = await newest(page);
    if (n >= number) return n;
  }
  throw new Error(`timed out waiting until ${what}: ${await newest(page)} instead of ${number}`);
}

test("6 live: a running pipeline is shown, and a page that hangs does not slow it", async ({
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
    "the image and the lines change",
  );
  const elsewhere = await browser.newContext();
  const other = await elsewhere.newPage();
  await open(other, main, "Lobby");
  const start = await drawn(other, (await drawn(page, 1, "the page draws")) + 1, "both pages draw");
  // A dialog halts the page's code exactly as long as it is open. The other page receives two seconds of messages
  // during that time.
  const dialog = page.waitForEvent("dialog");
  const hung = page.evaluate(() => alert("halted"));
  const standing = await dialog;
  const later = await drawn(other, start + 60, "the pipeline continues while a page hangs");
  await standing.dismiss();
  await hung;
  await drawn(page, later, "the page is at the newest again");
  await shot("pipeline-live");
  await elsewhere.close();
});

test("a recording that is deleted while open: the page reports it, and the rest continues", async ({ page }) => {
  await open(page, main, "doomed.0000");
  rmSync(`${site.folder}/doomed.0000`, { recursive: true });
  await page.waitForTimeout(1100);
  await dispatch(page, { type: "cursor", t: 10 * S });
  await page.evaluate(() => window.situStudio.client.pump(true));
  await until(page, () => document.body?.dataset.connection === "gone", "the page reports that it is gone");
  await until(
    page,
    () => document.getElementById("banner").textContent.includes("deleted or moved"),
    "the text explains it",
  );
  await open(page, main, "minute.0000");
});

test("a server that restarts: the page reports its absence, and is restored afterwards", async ({ page, shot }) => {
  await open(page, site.mortal, "minute.0000");
  await page.click(".panel-box [title='Remove'] >> nth=0");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "the layout has changed");
  await dispatch(page, { type: "select", from: 12 * S, to: 18 * S });
  await dispatch(page, { type: "nudge", by: 15 * S });
  await until(page, () => new URLSearchParams(location.search).get("sel"), "the address includes the selection");
  const panels = await page.$$eval("[data-panel]", (p) => p.length);
  writeFileSync(site.away, "");
  await until(
    page,
    () => document.getElementById("banner").textContent.includes("is not responding"),
    "the page reports that the server is away",
  );
  await until(page, () => document.getElementById("connection").textContent === "reconnecting", "the status line");
  await shot("server-away");
  rmSync(site.away);
  await until(
    page,
    () =>
      document.body?.dataset.connection === "open" &&
      document.getElementById("toast")?.textContent === "Connected again",
    "the page reports that it is connected again",
  );
  await until(
    page,
    () => document.body?.dataset.ready === "1" && document.querySelector("[data-phx-main].phx-connected"),
    "everything is restored",
  );
  await until(page, () => document.getElementById("banner").textContent === "", "the banner disappears");
  const s = await state(page);
  equal([s.sel, s.cursor], [[12 * S, 18 * S], 15 * S], "selection and cursor are restored");
  equal(await page.$$eval("[data-panel]", (p) => p.length), panels, "the layout is restored");
});
