// Makes the images of the guide "The studio" from the demo's recording: `test/browser/run --pictures RECORDINGS`,
// where RECORDINGS is the folder that `bin/demo --out` has written. Writes them to docs/images.
import { chromium } from "playwright-core";
import { spawn } from "node:child_process";
import { join } from "node:path";
import { answer, dispatch, open, settled, state } from "./studio_page.mjs";
import { hideHints, until } from "./harness.mjs";

const [site, to, only = ""] = process.argv.slice(2);
const { demo, main, shown, start: emptyFolder } = JSON.parse(site);
const S = 1e9;

const recording = async (page) => {
  await open(page, demo, "Talk.0000");
};

// The view, the selection and the cursor, in seconds.
async function look(page, view, sel, at) {
  await dispatch(page, { type: "view", from: view[0] * S, to: view[1] * S });
  if (sel) await dispatch(page, { type: "select", from: sel[0] * S, to: sel[1] * S });
  await dispatch(page, { type: "nudge", by: at * S - (await state(page)).cursor });
  await settled(page);
}

const PICTURES = {
  // The image of the README shows the entire clip.
  studio: async (page) => {
    await recording(page);
    await look(page, [0, 14], null, 5.35);
  },
  timelines: async (page) => {
    await recording(page);
    await look(page, [3.5, 9.5], [4.9, 6.9], 5.35);
  },
  split: async (page) => {
    await open(page, main, "minute.0000");
    for (const [id, side, target] of [
      ["p2", "tab", "p1"],
      ["p5", "right", "p6"],
    ]) {
      await page.evaluate((place) => window.situStudio.options.push("place_panel", place), { id, side, target });
      await until(page, (i) => document.querySelector(`#panel-${i}`), "the panel is there", id);
    }
    await page.click("#tab-p1");
    await look(page, [0, 60], null, 21.5);
    await page.waitForTimeout(1000);
  },
  bookmarks: async (page) => {
    await open(page, main, "minute.0000");
    for (const [at, text] of [
      [8.5, "Ada begins to speak #turns"],
      [21.5, "The robot turns too early"],
      [42, "Ada begins again #turns"],
    ]) {
      await dispatch(page, { type: "nudge", by: at * S - (await state(page)).cursor });
      await page.keyboard.press("B");
      await answer(page, text);
      await page.waitForTimeout(500);
    }
    await page.keyboard.press("M");
    await until(page, () => document.querySelectorAll(".bookmark-items li").length === 3, "the bookmarks");
    await page.keyboard.press("J");
    await settled(page);
  },
  values: async (page) => {
    await recording(page);
    await look(page, [0, 14], null, 5.35);
    await page.click("#tree .node[data-stream='Talk.Faces'] .name");
    await page.click("button[phx-value-viz='value']");
    await until(page, () => document.querySelector(".value-tree .row"), "the value");
    const row = page.locator(".value-tree .row", { has: page.locator(".k", { hasText: /^x$/ }) }).first();
    await row.hover();
    await row.locator(".plot-path").click();
    await until(
      page,
      () =>
        [...window.situStudio.views].some((v) => v.layers?.some((l) => l.vis.path && l.channel.series.length > 9)),
      "its plot",
    );
  },
  derived: async (page) => {
    await recording(page);
    await look(page, [3.5, 9.5], null, 5.35);
    await page.click("#tree .node[data-stream='Talk.Sound']", { button: "right" });
    await page.click("#menu button:has-text('Show as spectrogram')");
    await until(
      page,
      () => [...window.situStudio.views].some((v) => v.layers?.some((l) => l.spectra?.length > 50)),
      "the spectrogram",
    );
    await page.keyboard.press("e");
    await answer(page, "`Talk.Voice.Probability` > 0.5");
    await until(page, () => document.querySelector("#tree [data-stream^='= ']"), "the derived stream");
  },
  annotation: async (page) => {
    await recording(page);
    await look(page, [0, 14], null, 5.35);
    await page.keyboard.press("a");
    await page.fill("#annotation-new [name=name]", "Turns");
    await page.fill("#annotation-new textarea", "speaks 1 #4cc38a\nlaughs 2 #e0b93c");
    await page.click("#annotation-new button[type=submit]");
    await until(page, () => window.situStudio.annotation?.state.attributes.length === 1, "the annotations");
    for (const [start, end, value] of [
      [0.4, 3.6, "speaks"],
      [4.9, 6.9, "speaks"],
      [6.9, 7.6, "laughs"],
    ])
      await page.evaluate(
        ([a, b, v]) => {
          const { annotation, client } = window.situStudio;
          annotation.pushEdit("add", {
            from: client.toAbsolute(a),
            to: client.toAbsolute(b),
            track: "1",
            values: { Turns: v },
          });
        },
        [start * S, end * S, value],
      );
    await until(page, () => window.situStudio.annotation.state.items.length === 3, "three");
    await page.click("#tree .node[data-stream='Talk.Voice.Probability']", { button: "right" });
    await page.click("#menu button:has-text('Propose annotations')");
    await answer(page, "0.5");
    await until(page, () => window.situStudio.annotation.state.items.some((a) => a.proposed), "proposals");
    await page.focus(".annotation-tools input[type=range]");
    await page.evaluate(() => {
      const slider = document.activeElement;
      slider.value = 0.95;
      slider.dispatchEvent(new Event("input"));
      slider.blur();
    });
    await page.mouse.move(5, 700);
    await settled(page);
    await page.waitForTimeout(4000);
  },
  // The batch run has three sessions, one of which has lost its recording.
  dataset: async (page) => {
    await page.goto(`${main}/d/study.json`);
    await until(page, () => document.querySelectorAll("#tree .session img").length === 2, "its recordings are known");
    await page.click("#tree .node.dataset .name", { button: "right" });
    await page.click("#menu button:has-text('Run loudness…')");
    await page.check("#task input[name=overwrite]");
    await page.click("#task button[type=submit]");
    await until(page, () => document.querySelector(".run.failed"), "the run is over");
    for (const row of ["session >> nth=1", "partition >> nth=0"]) await page.click(`#tree .node.${row} >> .fold`);
    await page.selectOption(".pick select", "size");
    await page.mouse.move(5, 700);
    await page.waitForTimeout(1000);
  },
  find: async (page) => {
    await recording(page);
    await look(page, [0, 14], null, 5.35);
    await page.keyboard.press("f");
    await until(page, () => document.activeElement?.id === "query-text", "the field has the focus");
    await page.keyboard.type("`Talk.Voice.Probability` > 0.9");
    await page.keyboard.press("Enter");
    await until(page, () => document.querySelectorAll(".found-times button").length > 3, "times");
    await page.click(".query button:text('As annotations')");
    await until(page, () => window.situStudio.annotation?.state.items.length > 3, "proposals");
    await page.waitForTimeout(4000);
    await settled(page);
  },
  compare: async (page) => {
    await page.goto(`${main}/s/minute.0000?with=memory`);
    await until(page, () => document.body?.dataset.ready === "1" && window.situStudio.compare, "the comparison");
    await page.fill("#compare input", "2.5 s");
    await page.keyboard.press("Enter");
    await look(page, [0, 40], null, 22.3);
  },
  waits: async (page) => {
    await page.goto(`${main}/p/Mill?heat=busy`);
    await until(page, () => document.querySelector(".waits .row-button"), "waiting components");
  },
  masks: async (page) => {
    await open(page, main, "masked");
    await page.evaluate(() => window.situStudio.options.push("add_viz", { stream: "Find.Masks", viz: "masks" }));
    await settled(page);
  },
  keys: async (page) => {
    await recording(page);
    await page.keyboard.press("?");
  },
  start: async (page) => {
    await page.setViewportSize({ width: 1100, height: 560 });
    await page.goto(emptyFolder);
    await page.waitForSelector("#start[open]");
  },
  settings: async (page) => {
    await page.goto(`${demo}/settings`);
    await until(page, () => document.querySelectorAll(".keys .btn").length > 40, "the keys");
  },
  // The demo runs again in real time and is shown while it is recorded.
  live: async (page) => {
    const child = spawn("bin/demo", ["--headless", "--json", "--realtime", "--out", shown], { stdio: "ignore" });
    const ended = new Promise((done) => child.on("exit", done));
    await page.goto(demo);
    await page.waitForSelector(".home .item[href='s/Talk.0001']", { timeout: 120_000 });
    await open(page, demo, "Talk.0001");
    await until(page, () => window.situStudio.time.get().data[1] > 9e9, "nine seconds");
    await page.screenshot({ path: join(to, "studio-live.png") });
    await ended;
  },
  pipeline: async (page) => {
    await page.goto(`${demo}/p/Factory?heat=busy`);
    await until(page, () => document.querySelector(".graph .node"), "the graph");
    await page.click('.graph .node[data-path="Slow.Heavy"]');
    await until(
      page,
      () => /max/.test(document.querySelector("#plot-memory output")?.textContent ?? ""),
      "its history is plotted",
    );
    await page.waitForTimeout(3000);
  },
};

const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
for (const [name, show] of Object.entries(PICTURES)) {
  if (!name.includes(only)) continue;
  const context = await browser.newContext({ viewport: { width: 1440, height: 810 }, colorScheme: "dark" });
  await hideHints(context);
  const page = await context.newPage();
  await show(page);
  await page.evaluate(() => document.getElementById("toast")?.classList.remove("on"));
  await page.waitForTimeout(500);
  const file = name === "studio" ? "studio.png" : `studio-${name}.png`;
  if (name !== "live") await page.screenshot({ path: join(to, file) });
  console.log(file);
  await context.close();
}
await browser.close();
