// Layouts and links, and pages that survive their server process.
import { writeFileSync } from "node:fs";
import { objections } from "./axe.mjs";
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
  const rows = await page.$$eval(".panel-box", (r) => r.length);
  await page.selectOption("#layout-pick select", "Automatic");
  await until(page, () => document.getElementById("studio").dataset.layout === "Automatic", "another layout");
  await page.selectOption("#layout-pick select", "Tuned & <b>bold</b>");
  await until(page, (n) => document.querySelectorAll(".panel-box").length === n, "the saved layout is back", rows);
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
  const rows = await page.$$eval(".panel-box", (r) => r.length);
  await page.evaluate(() => window.liveSocket.disconnect());
  await page.evaluate(() => window.liveSocket.connect());
  await until(page, () => !document.querySelector(".phx-loading, .phx-client-error"), "connected again");
  await until(page, (n) => document.querySelectorAll(".panel-box").length === n, "the layout is restored", rows);
});

// The layout as nested lists: ["row", ["column", "p1", "p2"], "p3"].
const tree = (page) =>
  page.evaluate(() => {
    const read = (el) => {
      if (el.matches(".panel-box")) return el.dataset.panel;
      if (el.matches(".part-tabs"))
        return ["tabs", ...[...el.querySelectorAll("[role='tab']")].map((t) => t.dataset.drag)];
      const parts = [...el.children].filter((c) => c.dataset.part).map(read);
      return parts.length === 1 ? parts[0] : [el.matches(".part-row") ? "row" : "column", ...parts];
    };
    return read(document.querySelector("#stack > [data-part]"));
  });

const becomes = async (page, wanted, what) => {
  for (let i = 0; i < 200 && JSON.stringify(await tree(page)) !== JSON.stringify(wanted); i++)
    await page.waitForTimeout(30);
  equal(await tree(page), wanted, what);
};

// Drags an element to a share of the width and height of another one.
async function drag(page, from, to, [x, y], look) {
  const middle = await page.locator(from).boundingBox();
  const box = await page.locator(to).boundingBox();
  await page.mouse.move(middle.x + middle.width / 2, middle.y + middle.height / 2);
  await page.mouse.down();
  await page.mouse.move(middle.x + middle.width / 2 + 8, middle.y + middle.height / 2 + 8);
  await page.mouse.move(box.x + box.width * x, box.y + box.height * y, { steps: 4 });
  // The browser tells of the last place with the next move.
  await page.mouse.move(box.x + box.width * x + 1, box.y + box.height * y);
  await look?.();
  await page.mouse.up();
}

const AUTOMATIC = ["row", ["column", "p1", "p2"], ["column", "p3", "p4", "p5", "p6", "p7"]];

test("8 layouts: panels are split in both directions and put in tabs by dragging", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  equal(await tree(page), AUTOMATIC, "the automatic layout");
  await page.evaluate(() => (document.querySelector("#body-p1-image").kept = true));
  // An image goes to the right of a plot, by its title; the place is shown before.
  await drag(page, "#panel-p1 .title", "#panel-p5", [0.9, 0.5], async () => {
    await until(page, () => document.querySelector("#panel-p5").dataset.drop === "right", "the place is marked");
    await shot("drop-right");
  });
  await becomes(page, ["row", "p2", ["column", "p3", "p4", ["row", "p5", "p1"], "p6", "p7"]], "side by side");
  ok(await page.evaluate(() => document.querySelector("#body-p1-image").kept), "the panel was moved, not made again");
  await until(
    page,
    () => document.querySelector("#panel-p5 .own-ruler span"),
    "narrow timelines have their own times",
  );
  // A plot becomes a tab of another one, and a tab is shown by a click and by keys.
  await drag(page, "#grip-p7", "#panel-p6", [0.5, 0.5]);
  await becomes(page, ["row", "p2", ["column", "p3", "p4", ["row", "p5", "p1"], ["tabs", "p6", "p7"]]], "in tabs");
  await until(page, () => document.querySelector("#panel-p7 canvas"), "the moved panel is in front");
  await page.click("#tab-p6");
  await until(
    page,
    () => document.querySelector("#panel-p6 canvas") && !document.querySelector("#panel-p7"),
    "a tab",
  );
  await page.keyboard.press("ArrowRight");
  await until(page, () => document.querySelector("#panel-p7 canvas"), "the next tab");
  equal((await state(page)).cursor, 0, "the keys did not move the cursor");
  // At the edge of all panels, a panel goes to this side of all.
  await drag(page, "#panel-p2 .title", "#stack", [0.5, 0.995]);
  const below = ["column", "p3", "p4", ["row", "p5", "p1"], ["tabs", "p6", "p7"], "p2"];
  await becomes(page, below, "below all others");
  await until(page, () => !document.querySelector("[data-drop]"), "no mark remains");
  await shot("split");
  equal(await objections(page), [], "axe");
  // The address includes the layout.
  await until(page, () => new URLSearchParams(location.search).get("edit"), "the address includes the layout");
  await page.goto(page.url());
  await until(page, () => document.body?.dataset.ready === "1", "reloaded");
  equal(await tree(page), below, "a reload shows the same layout");
});

test("8 layouts: panels are moved and resized with keys, and changes are undone", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.focus("#grip-p4");
  await page.keyboard.press("ArrowUp");
  await becomes(page, ["row", ["column", "p1", "p2"], ["column", "p4", "p3", "p5", "p6", "p7"]], "one row up");
  await until(page, () => document.activeElement.id === "grip-p4", "the focus stays");
  await page.keyboard.press("ArrowRight");
  const right = ["row", ["column", "p1", "p2"], ["column", "p3", "p5", "p6", "p7"], "p4"];
  await becomes(page, right, "to the right of all");
  // The palette puts the selected panel next to another one.
  await page.click("#panel-p1 .title");
  await until(page, () => document.querySelector("#panel-p1.selected"), "it is selected");
  await page.keyboard.press("Control+k");
  await page.keyboard.type("put camera as a tab with kinect");
  await page.keyboard.press("Enter");
  await becomes(page, ["row", ["tabs", "p2", "p1"], ["column", "p3", "p5", "p6", "p7"], "p4"], "in tabs by keyboard");
  // A border is moved with the arrow keys.
  const width = () => page.$eval("#panel-p4", (e) => e.getBoundingClientRect().width);
  const before = await width();
  await page.focus("#stack .part-row > .split >> nth=1");
  await page.keyboard.press("ArrowLeft");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "changed");
  await page.waitForTimeout(200);
  ok((await width()) > before + 10, "the last part is wider");
  for (let i = 0; i < 4; i++) await page.keyboard.press("Control+z");
  await becomes(page, AUTOMATIC, "everything is undone");
  await until(page, () => document.getElementById("studio").dataset.edit === "", "and nothing has changed");
});

test("8 layouts: a phone shows all panels one below the other", async ({ page }) => {
  await page.setViewportSize({ width: 390, height: 800 });
  await open(page, main, "minute.0000");
  const boxes = await page.$$eval("#navigator, .panel-box", (all) =>
    all.map((e) => e.getBoundingClientRect()).map((r) => [r.left, r.right, r.top, r.bottom].map(Math.round)),
  );
  ok(
    boxes.every(([left, right]) => left === 0 && right >= 375 && right <= 390),
    "every panel has the full width",
  );
  const sorted = boxes.toSorted((a, b) => a[2] - b[2]);
  ok(
    sorted.every((box, i) => i === 0 || box[2] >= sorted[i - 1][3] - 1),
    "no panel covers another one",
  );
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
