// What grows, what runs, and what goes away.
import { rmSync, writeFileSync } from "node:fs";
import { test, equal, ok, near, until } from "./harness.mjs";
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
  await page.waitForTimeout(1500);
  const second = await state(page);
  near(second.cursor - first.cursor, 1.5 * S, 0.5 * S, "the cursor goes with the time");
  const image = await panelOf(page, "Live.Image");
  await until(page, (i) => document.querySelector(`#${i} canvas`).dataset.at, "a picture", image);
  const behind = await page.evaluate(
    (i) => window.situStudio.time.get().cursor - Number(document.querySelector(`#${i} canvas`).dataset.at),
    image,
  );
  near(behind, 0, 0.6 * S, "the newest picture is shown");
  await shot("live");
  await page.keyboard.press("l");
  const left = await state(page);
  equal(left.mode, "manual", "left");
  await page.waitForTimeout(1300);
  ok(
    (await state(page)).cursor === left.cursor && (await state(page)).data[1] > left.data[1],
    "the cursor stays, the data grows",
  );
  await page.keyboard.press("l");
  equal((await state(page)).mode, "live", "back");
});

test("6 live: a running pipeline is looked into; a page that hangs does not slow it", async ({ page, shot }) => {
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
  const newest = () =>
    page.evaluate(() => {
      const l = [...window.situStudio.views]
        .filter((v) => v.plot)
        .flatMap((v) => v.layers)
        .find((k) => k.vis.stream === "Clock.Count");
      const s = l.channel.series;
      // The newest bins may hold nothing yet.
      let i = s.length - 1;
      while (i > 0 && !Number.isFinite(s.last[i])) i--;
      return [s.last[i], s.t[i] / 1e9, performance.now() / 1e3];
    });
  const a = await newest();
  await page.evaluate(() => {
    const end = performance.now() + 2500;
    while (performance.now() < end);
  });
  await page.waitForTimeout(400);
  const b = await newest();
  // 30 on an idle machine; a busy one ticks slower, but never as slowly as a page that hangs for most of the time.
  near((b[0] - a[0]) / (b[1] - a[1]), 24, 12, "messages a second while the page hung");
  near(b[1] - a[1], b[2] - a[2], 1, "the page is at the newest again");
  await shot("pipeline-live");
});

test("a recording that is deleted while open: said, and the rest goes on", async ({ page }) => {
  await open(page, main, "doomed.0000");
  rmSync(`${site.folder}/doomed.0000`, { recursive: true });
  await page.waitForTimeout(1100);
  await dispatch(page, { type: "cursor", t: 10 * S });
  await page.evaluate(() => window.situStudio.client.pump(true));
  await until(page, () => document.body?.dataset.connection === "gone", "the page says that it is gone");
  ok((await page.textContent("#banner")).includes("deleted or moved"), "in words");
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
  writeFileSync(site.restart, "4");
  await until(
    page,
    () => document.getElementById("banner").textContent.includes("does not answer"),
    "the page says that the server is away",
  );
  equal(await page.textContent("#connection"), "reconnecting", "the status line");
  await shot("server-away");
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
  equal(await page.textContent("#banner"), "", "no banner any more");
  const s = await state(page);
  equal([s.sel, s.cursor], [[12 * S, 18 * S], 15 * S], "selection and cursor are kept");
  equal(await page.$$eval("[data-panel]", (p) => p.length), panels, "and the layout");
});
