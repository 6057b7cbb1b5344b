// Layouts and links, and pages that survive their server process.
import { writeFileSync } from "node:fs";
import { test, equal, ok, until } from "./harness.mjs";
import { open, settled, state, dispatch } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

test("8 layouts: saved, switched and deleted; a link shows the same image", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.dblclick("#tree .node[data-stream='Robot.State']");
  await page.click("button[title='Save the layout']");
  await page.fill("#layout-save input[name=name]", "Tuned & <b>bold</b>");
  await page.keyboard.press("Enter");
  await until(
    page,
    () => document.getElementById("studio").dataset.layout === "Tuned & <b>bold</b>",
    "the layout is saved",
  );
  const rows = await page.$$eval(".row-box", (r) => r.length);
  await page.selectOption("#layout-pick select", "Automatic");
  await until(page, () => document.getElementById("studio").dataset.layout === "Automatic", "another layout");
  await page.selectOption("#layout-pick select", "Tuned & <b>bold</b>");
  await until(page, (n) => document.querySelectorAll(".row-box").length === n, "the saved layout is back", rows);
  await page.dblclick("#tree .node[data-stream='Mic.Level']");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "the layout has changed since");
  await dispatch(page, { type: "select", from: 12 * S, to: 18 * S });
  await dispatch(page, { type: "zoomSel" });
  await dispatch(page, { type: "nudge", by: 15 * S });
  await settled(page);
  await page.waitForTimeout(400);
  const still = async (p) => {
    await p.evaluate(() => document.getElementById("toast")?.remove());
    await p.evaluate(() => (document.querySelector(".times").scrollTop = 0));
    // A link includes neither the selection nor the sidebars.
    await p.evaluate(() => (document.documentElement.dataset.right = "closed"));
    await p.evaluate(() => document.querySelectorAll(".selected").forEach((e) => e.classList.remove("selected")));
    await p.mouse.move(5, 5);
    await settled(p);
    await p.waitForTimeout(1200);
    return p.screenshot({ clip: { x: 248, y: 44, width: 785, height: 650 } });
  };
  const before = await still(page);
  await page.goto(page.url());
  await until(page, () => document.body?.dataset.ready === "1", "reloaded");
  let after = await still(page);
  for (let i = 0; i < 10 && !before.equals(after); i++) after = await still(page);
  if (process.env.SHOTS)
    for (const [n, b] of [
      ["before", before],
      ["after", after],
    ])
      writeFileSync(`${process.env.SHOTS}/${n}.png`, b);
  ok(before.equals(after), "the reloaded page looks the same");
});

test("8 layouts: the page survives its server process", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.dblclick("#tree .node[data-stream='Robot.State']");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "the layout has changed");
  const rows = await page.$$eval(".row-box", (r) => r.length);
  await page.evaluate(() => window.liveSocket.disconnect());
  await page.evaluate(() => window.liveSocket.connect());
  await until(page, () => !document.querySelector(".phx-loading, .phx-client-error"), "connected again");
  await until(page, (n) => document.querySelectorAll(".row-box").length === n, "the layout is restored", rows);
});

const rows = (page) => page.$$eval("[data-row]", (r) => r.map((e) => e.dataset.row));
const cells = (page) =>
  page.$$eval(".row-box.cells", (r) =>
    r.map((e) => [...e.querySelectorAll("[data-panel]")].map((c) => c.dataset.panel)),
  );

// Returns the image cells above the timelines.
async function stacked(page) {
  await page.keyboard.press("b");
  await until(page, () => !document.querySelector(".stack.beside"), "images are above");
  await page.evaluate(() => window.situStudio.options.push("place_panel", { id: "p2", side: "right", target: "p1" }));
  await until(page, () => document.querySelectorAll(".row-box.cells").length === 1, "images are side by side");
}

test("8 layouts: panels are moved by dragging", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await stacked(page);
  const [pictures, sound, lanes] = await rows(page);
  // Moves a timeline to the top.
  await page.dragAndDrop(`#grip-${lanes}`, `#row-${pictures}`, { targetPosition: { x: 300, y: 20 } });
  await until(
    page,
    (id) => document.querySelector("[data-row]").dataset.row === id,
    "the lanes are the first row",
    lanes,
  );
  equal((await rows(page)).slice(0, 3), [lanes, pictures, sound], "rows");
  // Moves one image to the other side of the other, and then below the audio.
  equal(await cells(page), [["p1", "p2"]], "images side by side");
  await page.dragAndDrop("#grip-p1", "#cell-p2", { targetPosition: { x: 350, y: 110 } });
  await until(
    page,
    () => document.querySelector(".row-box.cells .cell").dataset.panel === "p2",
    "the images change positions",
  );
  await page.dragAndDrop("#grip-p1", `#row-${sound}`, { targetPosition: { x: 300, y: 80 } });
  await until(page, () => document.querySelectorAll(".row-box.cells").length === 2, "an image has its own row");
  equal(await cells(page), [["p2"], ["p1"]], "images in separate rows");
  await page.$eval("#cell-p1", (e) => e.scrollIntoView());
  await settled(page);
  await until(page, () => document.querySelector("#body-p1-image canvas").dataset.at, "the moved image is shown");
  await until(page, () => !document.querySelector("[data-drop]"), "no drop mark remains");
  await shot("moved");
  // The address includes the layout.
  const before = await rows(page);
  await until(page, () => new URLSearchParams(location.search).get("edit"), "the address includes the layout");
  await page.goto(page.url());
  await until(page, () => document.body?.dataset.ready === "1", "reloaded");
  equal(await rows(page), before, "a reload shows the same order");
});

test("8 layouts: panels are moved with keys, and keep the focus", async ({ page }) => {
  await open(page, main, "minute.0000");
  await stacked(page);
  const before = await rows(page);
  await page.focus(`#grip-${before[2]}`);
  await page.keyboard.press("ArrowUp");
  await until(page, (id) => document.querySelectorAll("[data-row]")[1].dataset.row === id, "one row up", before[2]);
  await until(page, (id) => document.activeElement.id === `grip-${id}`, "the focus stays", before[2]);
  await page.keyboard.press("ArrowUp");
  await until(page, (id) => document.querySelector("[data-row]").dataset.row === id, "and another", before[2]);
  await page.focus("#grip-p1");
  await page.keyboard.press("ArrowRight");
  await until(
    page,
    () => document.querySelector(".row-box.cells .cell").dataset.panel === "p2",
    "the images change positions",
  );
  equal((await state(page)).cursor, 0, "the keys did not move the cursor");
});

test("9 export: the selection is saved as a recording that opens", async ({ page, shot }) => {
  await open(page, main, "uneven.0000");
  await dispatch(page, { type: "select", from: 10 * S, to: 25 * S });
  await page.keyboard.press("Control+e");
  await until(page, () => document.activeElement?.closest("#export-save"), "the dialog has the focus");
  ok((await page.textContent("#export-save")).includes("The selection: 15.0 s"), "it describes the selection");
  await shot("export");
  await page.keyboard.press("Escape");
  await until(page, () => !document.getElementById("export-save"), "closed by Escape");
  await page.click("button[data-act='export']");
  await until(page, () => document.getElementById("export-save"), "open again");
  const name = `part ${Date.now()}`;
  await page.fill("#export-save input[name=name]", name);
  await page.keyboard.press("Enter");
  await until(page, () => document.getElementById("toast").textContent.startsWith("Saved as"), "it shows the path");
  await until(
    page,
    (n) => [...document.querySelectorAll(".store")].some((e) => e.title === `${n}.0000`),
    "it is listed",
    name,
  );
  await page.click(`.store[title="${name}.0000"]`);
  await until(page, () => document.body?.dataset.ready === "1" && location.pathname.includes("part"), "it opens");
  const { data } = await state(page);
  equal(data[1] - data[0], 15 * S, "its duration is that of the selection");
});
