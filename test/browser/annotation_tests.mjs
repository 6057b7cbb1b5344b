// Annotating in the page: by keys alone, by the mouse, and through the end of a server.
import { rmSync, writeFileSync } from "node:fs";
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, state, dispatch, pointAt, settled } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const S = 1e9;

const items = (page) =>
  page.evaluate(() =>
    window.situStudio.annotation.told.items.map((a) => [a.from, a.to, a.track, Object.values(a.values)[0]]),
  );

// From the keyboard: the dialog, a name, two values with keys.
async function begin(page, name) {
  await page.keyboard.press("a");
  await until(page, () => document.activeElement?.closest("#annotation-new"), "the dialog has the focus");
  await page.keyboard.type(name);
  await page.keyboard.press("Tab");
  await page.keyboard.type("speaks 1 #ff00ff");
  await page.keyboard.press("Enter");
  await page.keyboard.type("laughs 2");
  await page.keyboard.press("Tab");
  await page.keyboard.press("Enter");
  await until(page, () => window.situStudio.annotation?.told.attributes.length === 1, "the panel is there");
}

test("10 annotation: twenty segments by keys alone, undone and saved", async ({ page, shot }) => {
  await open(page, site.main, "minute.0000");
  await page.keyboard.press("Home");
  await begin(page, "Speech");
  for (let i = 0; i < 20; i++) {
    const key = String(1 + (i % 2));
    await page.keyboard.press(key);
    for (let k = 0; k < 3; k++) await page.keyboard.press("Control+Shift+.");
    await page.keyboard.press(key);
    await page.keyboard.press("ArrowRight");
    await until(page, (n) => window.situStudio.annotation.told.items.length === n, `segment ${i + 1}`, i + 1);
  }
  const made = await items(page);
  for (const [i, [from, to, , value]] of made.entries()) {
    near(to - from, S / 2, 1e3, "three steps long");
    equal(value, i % 2 ? "laughs" : "speaks", "its value");
  }
  await shot("annotation");
  await page.focus("#annotation-body");
  await page.keyboard.press("Control+z");
  await until(page, () => window.situStudio.annotation.told.items.length === 19, "undone");
  await page.keyboard.press("Control+Shift+z");
  await until(page, () => window.situStudio.annotation.told.items.length === 20, "redone");
  equal(await page.$$eval("[data-panel]", (p) => p.length > 3), true, "the layout is as it was");
  await page.click(".annotation-tools button:text('Save')");
  await until(page, () => document.getElementById("toast").textContent === "Annotations saved", "saved");
  equal(
    await page.$eval(".annotation-tools button:has-text('Saved')", (b) => b.disabled),
    true,
    "there is nothing to save",
  );
});

test("10 annotation: a key held while playing lasts as long as it is held", async ({ page }) => {
  await open(page, site.main, "uneven.0000");
  await begin(page, "Held");
  await dispatch(page, { type: "nudge", by: 10 * S });
  await page.keyboard.press("Space");
  await until(page, () => window.situStudio.time.get().mode === "play", "plays");
  const cursor = async () => (await state(page)).cursor;
  const before = await cursor();
  await page.keyboard.down("1");
  const pressed = await cursor();
  await until(page, (t) => window.situStudio.time.get().cursor > t + 1e9, "a second is played", pressed);
  const late = await cursor();
  await page.keyboard.up("1");
  const released = await cursor();
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "one annotation");
  const [[a, b]] = await items(page);
  ok(before <= a && a <= pressed, `from where it was pressed: ${a} is between ${before} and ${pressed}`);
  ok(late <= b && b <= released, `to where it was released: ${b} is between ${late} and ${released}`);
});

test("10 annotation: edges are dragged, neighbours that touch go along; proposals are taken", async ({
  page,
  shot,
}) => {
  await open(page, site.main, "minute.0000");
  await begin(page, "Edges");
  for (const [from, to, key] of [
    [10, 20, "1"],
    [20, 30, "2"],
  ]) {
    await dispatch(page, { type: "nudge", by: from * S - (await state(page)).cursor });
    await page.keyboard.press(key);
    await dispatch(page, { type: "nudge", by: to * S - (await state(page)).cursor });
    await page.keyboard.press(key);
  }
  await until(page, () => window.situStudio.annotation.told.items.length === 2, "two that touch");
  await settled(page);
  const row = await page.$eval("#annotation-body", (e) => e.getBoundingClientRect().top + 26 + 13);
  const start = await pointAt(page, "annotation-body", 20 * S);
  await page.mouse.move(start.x, row);
  await page.mouse.down();
  const end = await page.evaluate(() => {
    const s = window.situStudio,
      box = document.getElementById("annotation-body").getBoundingClientRect();
    const [a, b] = s.time.get().view;
    return box.left + s.gutter.left + ((24.3e9 - a) / (b - a)) * (box.width - s.gutter.left - 14);
  });
  await page.keyboard.down("Shift");
  await page.mouse.move(end, row, { steps: 6 });
  await page.mouse.up();
  await page.keyboard.up("Shift");
  await until(page, () => window.situStudio.annotation.told.items[0].to > 23e9, "the edge has moved");
  const [first, second] = await items(page);
  near(first[1], 24.3 * S, 0.3 * S, "to the mouse");
  equal(first[1], second[0], "and the neighbour's with it");
  await page.click("#tree .node[data-stream='Vad.Speaking']", { button: "right" });
  await page.click("#menu button:has-text('Propose annotations')");
  await until(
    page,
    () => window.situStudio.annotation.told.items.filter((a) => a.proposed).length === 6,
    "six proposals",
  );
  await shot("proposals");
  page.once("dialog", (d) => d.accept("0"));
  await page.click(".annotation-tools button:has-text('Accept')");
  await until(page, () => window.situStudio.annotation.told.items.every((a) => !a.proposed), "all are taken");
});

test("10 annotation: a server that is started again has every edit", async ({ page }) => {
  await open(page, site.mortal, "many.0000");
  await begin(page, "Lasting");
  await page.keyboard.press("1");
  await page.keyboard.press("ArrowRight");
  await page.keyboard.press("1");
  await until(page, () => window.situStudio.annotation.told.items.length === 1, "one annotation");
  await until(page, () => new URLSearchParams(location.search).get("annotate") === "Lasting", "the address names it");
  writeFileSync(site.away, "");
  await until(page, () => document.body?.dataset.connection === "closed", "the server is away");
  rmSync(site.away);
  await until(
    page,
    () => window.situStudio?.annotation?.told.items.length === 1 && document.body?.dataset.connection === "open",
    "it is back",
  );
});
