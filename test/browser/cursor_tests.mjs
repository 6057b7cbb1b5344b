// Cursor, view, selection, playback, and going to a time.
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, state, dispatch, lengthIs, panelOf, pointAt } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

test("5 cursor: follows the mouse, drives every panel, and can be locked", async ({ page }) => {
  await open(page, main, "minute.0000");
  const lanes = await panelOf(page, "Vad.Speaking"),
    image = await panelOf(page, "Camera.Image");
  await pointAt(page, lanes, 42.5 * S);
  await until(
    page,
    (i) => document.querySelector(`#${i} canvas`).dataset.at === "42000000000",
    "the image follows the mouse",
    image,
  );
  near((await state(page)).cursor, 42.5 * S, 0.1 * S, "cursor");
  await page.keyboard.press("Alt+f");
  await pointAt(page, lanes, 10 * S);
  near((await state(page)).cursor, 42.5 * S, 0.1 * S, "held cursor");
});

test("5 cursor: its line stays at its time when the panels become wider", async ({ page }) => {
  await open(page, main, "minute.0000");
  const lanes = await panelOf(page, "Vad.Speaking");
  await page.keyboard.press("p");
  await page.waitForSelector(".right", { state: "visible" });
  await page.keyboard.press("Alt+f");
  await dispatch(page, { type: "cursor", t: 45 * S });
  const gap = (i) => {
    const el = document.getElementById(i);
    const line = el.querySelector(".cursor-line").getBoundingClientRect();
    const box = el.querySelector(".overlay").getBoundingClientRect();
    const { view, cursor } = window.situStudio.time.get();
    const x = box.left + ((cursor - view[0]) / (view[1] - view[0])) * box.width;
    return [Math.abs(line.left - x), el.clientWidth];
  };
  const [, before] = await page.evaluate(gap, lanes);
  await page.click("button.tool[title^='Show or hide the properties']");
  await until(page, ([i, w]) => document.getElementById(i).clientWidth > w + 50, "wider", [lanes, before]);
  await page.waitForTimeout(300);
  const [off] = await page.evaluate(gap, lanes);
  ok(off < 3, `the line is ${off} pixels from the cursor's time`);
});

test("5 cursor: snaps to the messages of a stream, and steps from one to the next", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.click("#tree .node[data-stream='Camera.Image'] .name");
  await page.click("text=Snap the cursor to this stream");
  await until(page, () => window.situStudio.client.snap === "Camera.Image", "the cursor snaps");
  const lanes = await panelOf(page, "Vad.Speaking");
  await pointAt(page, lanes, 20.4 * S);
  await until(page, () => window.situStudio.time.get().cursor === 20e9, "the cursor is on the nearest image");
  await page.keyboard.press("ArrowRight");
  await until(page, () => window.situStudio.time.get().cursor === 21e9, "the next image");
  await page.keyboard.press("ArrowLeft");
  await page.keyboard.press("ArrowLeft");
  await until(
    page,
    () => window.situStudio.time.get().cursor === 19e9 || window.situStudio.time.get().cursor === 20e9,
    "the previous images",
  );
});

test("5 view: the wheel zooms around the mouse, dragging pans, and keys do both", async ({ page }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Vad.Speaking");
  await pointAt(page, id, 30 * S);
  const wide = (await state(page)).view;
  for (let i = 0; i < 5; i++) await page.mouse.wheel(0, -120);
  await until(
    page,
    (w) => {
      const [a, b] = window.situStudio.time.get().view;
      return Math.abs((b - a) / w - 1) < 0.01;
    },
    "each step of the wheel narrows the view by a fifth",
    (wide[1] - wide[0]) * 0.8 ** 5,
  );
  const zoomed = (await state(page)).view;
  near((30 * S - zoomed[0]) / (zoomed[1] - zoomed[0]), 0.5, 0.02, "position of the time under the mouse");
  const at = await pointAt(page, id, 30 * S);
  await page.mouse.down();
  await page.mouse.move(at.x - 100, at.y, { steps: 4 });
  await page.mouse.up();
  const panned = (await state(page)).view;
  ok(
    panned[0] > zoomed[0] && Math.abs(panned[1] - panned[0] - (zoomed[1] - zoomed[0])) < 1e3,
    "dragged to the left shows later times",
  );
  await page.keyboard.press("Control+a");
  const data = (await state(page)).data;
  equal((await state(page)).view, data, "everything is in view");
  await page.keyboard.press("PageDown");
  ok((await state(page)).view[0] > 20 * S, "the keys moved the view");
});

test("5 selection: both ends are set with mouse and keys; zoom, shift and clear", async ({ page }) => {
  await open(page, main, "minute.0000");
  const id = await panelOf(page, "Vad.Speaking");
  let at = await pointAt(page, id, 10 * S);
  await page.keyboard.down("Shift");
  await page.mouse.click(at.x, at.y);
  at = await pointAt(page, id, 25 * S);
  await page.mouse.click(at.x, at.y, { button: "right" });
  await page.keyboard.up("Shift");
  let s = await state(page);
  near(s.sel[0], 10 * S, 0.2 * S, "start");
  near(s.sel[1], 25 * S, 0.2 * S, "end");
  await until(page, (i) => !document.querySelector(`#${i} .sel-shade`).hidden, "the selection is shaded", id);
  await lengthIs(page, 15, 0.25);
  await page.keyboard.press("Control+s");
  s = await state(page);
  near(s.view[1] - s.view[0], 15 * S * 1.1, 0.2 * S, "the view is the selection, padded");
  await page.keyboard.press("Alt+ArrowRight");
  near((await state(page)).sel[0], 25 * S, 0.2 * S, "shifted by its length");
  await page.keyboard.press("Alt+c");
  equal((await state(page)).sel, [null, null], "cleared");
});

test("5 playback: is in sync with audio, repeats a selection, and changes speed", async ({ page }) => {
  await open(page, main, "minute.0000");
  await dispatch(page, { type: "cursor", t: 4 * S });
  await page.keyboard.press("Space");
  await until(page, () => window.situStudio.playback.run?.heard > 16000, "audio is scheduled");
  const step = await page.evaluate(async () => {
    const { playback, time } = window.situStudio;
    // Reads both clocks in the same step in which the cursor moves.
    const moved = () =>
      new Promise((resolve) => {
        const stop = time.subscribe((s, old) => {
          if (s.cursor === old.cursor) return;
          stop();
          resolve([playback.context.currentTime, s.cursor / 1e9]);
        });
      });
    const [sound, cursor] = await moved();
    for (;;) {
      const [t, c] = await moved();
      if (t > sound + 1.2) return { sound: t - sound, cursor: c - cursor };
    }
  });
  near(step.cursor, step.sound, 0.1, "cursor and audio are in sync");
  await page.keyboard.press("Space");
  equal((await state(page)).mode, "manual", "stopped");
  await dispatch(page, { type: "select", from: 20 * S, to: 20.5 * S });
  await page.keyboard.press("r");
  await page.keyboard.press(".");
  await page.keyboard.press("Control+Space");
  const seen = await page.evaluate(async () => {
    let wraps = 0,
      last = 0,
      outside = 0;
    const end = performance.now() + 30_000;
    while (wraps < 3 && performance.now() < end) {
      const c = window.situStudio.time.get().cursor;
      if (c < last) wraps++;
      if (c < 20e9 || c > 20.5e9) outside++;
      last = c;
      await new Promise((r) => requestAnimationFrame(r));
    }
    return { wraps, outside, speed: window.situStudio.time.get().speed };
  });
  ok(seen.wraps >= 3 && seen.outside === 0, `the selection repeats: ${JSON.stringify(seen)}`);
  equal(seen.speed, 2, "double speed");
});

test("5 go to time: accepts a time, rejects invalid times and times outside the recording", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.keyboard.press("Control+g");
  await page.keyboard.type("tomorrow");
  await page.keyboard.press("Enter");
  const said = (words) =>
    until(page, (w) => document.querySelector("#goto .error").textContent.startsWith(w), `it says ${words}`, words);
  await said("Not a time");
  await page.fill("#goto input", "5:00");
  await page.keyboard.press("Enter");
  await said("Outside");
  await page.fill("#goto input", "0:42.5");
  await page.keyboard.press("Enter");
  equal((await state(page)).cursor, 42.5 * S, "cursor");
});

test("5 cursor: a link includes the snapped stream, and the copied time is accepted by 'go to'", async ({
  page,
  context,
}) => {
  await context.grantPermissions(["clipboard-read", "clipboard-write"]);
  await open(page, main, "minute.0000");
  await page.click("#tree .node[data-stream='Camera.Image'] .name");
  await page.click("text=Snap the cursor to this stream");
  await until(
    page,
    () => new URLSearchParams(location.search).get("snap") === "Camera.Image",
    "the address includes it",
  );
  await page.goto(page.url());
  await until(
    page,
    () => document.body?.dataset.ready === "1" && window.situStudio.client.snap === "Camera.Image",
    "a reload preserves it",
  );
  await page.click(".snapped");
  await until(page, () => window.situStudio.client.snap === null && !document.querySelector(".snapped"), "released");
  await dispatch(page, { type: "nudge", by: 12_345_678_901 - (await state(page)).cursor });
  await page.keyboard.press("c");
  await until(page, () => document.getElementById("toast").textContent === "Time of the cursor copied", "copied");
  const text = await page.evaluate(() => navigator.clipboard.readText());
  equal(text, "2026-01-01T00:00:12.345678901Z", "the time of the cursor");
  await page.keyboard.press("Home");
  await page.keyboard.press("Control+g");
  await page.fill("#goto input", text);
  await page.keyboard.press("Enter");
  equal((await state(page)).cursor, 12_345_678_901, "back at that time");
});

test("5 selection: a click on an interval selects it, and the menu shows its statistics", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  const lanes = await panelOf(page, "Vad.Speaking");
  const at = await pointAt(page, lanes, 7 * S);
  await page.mouse.click(at.x, await page.$eval(`#${lanes}`, (e) => e.getBoundingClientRect().top + 4 + 13));
  equal((await state(page)).sel, [5 * S, 10 * S], "the interval of Speaking is selected");
  const level = await panelOf(page, "Mic.Level");
  await page.click(`#${level}`, { button: "right" });
  await page.click("#menu button:has-text('Statistics')");
  await until(page, () => document.getElementById("statistics"), "the table is shown");
  const table = await page.$$eval("#statistics tr", (rows) =>
    Object.fromEntries(rows.map((r) => [...r.children].map((c) => c.textContent))),
  );
  equal(table.messages, "501", "messages of five seconds, both ends");
  equal(table.rate, "100 /s", "rate");
  near(Number(table.greatest), 1, 1e-4, "the maximum");
  await shot("statistics");
});
