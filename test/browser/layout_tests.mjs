// Layouts and links, and pages that outlive their server process.
import { writeFileSync } from "node:fs";
import { test, ok, until } from "./harness.mjs";
import { open, settled, dispatch } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

test("8 layouts: saved, switched and deleted; a link gives the same picture", async ({ page, context, shot }) => {
  await open(page, main, "minute.0000");
  await page.dblclick("#tree .node[data-stream='Robot.State']");
  await page.click("button[title='Save the layout']");
  await page.fill("#layout-save input[name=name]", "Tuned & <b>bold</b>");
  await page.keyboard.press("Enter");
  await until(page, () => document.getElementById("studio").dataset.layout === "Tuned & <b>bold</b>", "the layout is saved");
  const rows = await page.$$eval(".row-box", (r) => r.length);
  await page.selectOption("#layout-pick select", "Automatic");
  await until(page, () => document.getElementById("studio").dataset.layout === "Automatic", "another layout");
  await page.selectOption("#layout-pick select", "Tuned & <b>bold</b>");
  await until(page, (n) => document.querySelectorAll(".row-box").length === n, "the saved layout is back", rows);
  await page.dblclick("#tree .node[data-stream='Mic.Level']");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "it was changed since");
  await dispatch(page, { type: "select", from: 12 * S, to: 18 * S });
  await dispatch(page, { type: "zoomSel" });
  await dispatch(page, { type: "nudge", by: 15 * S });
  await settled(page);
  await page.waitForTimeout(400);
  const still = async (p) => {
    await p.evaluate(() => document.getElementById("toast").remove());
    await p.evaluate(() => (document.querySelector(".stack").scrollTop = 0));
    await p.mouse.move(5, 5);
    await settled(p);
    await p.waitForTimeout(1200);
    return p.screenshot({ clip: { x: 248, y: 44, width: 785, height: 650 } });
  };
  const before = await still(page);
  await page.goto(page.url());
  await until(page, () => document.body?.dataset.ready === "1", "reloaded");
  const after = await still(page);
  if (process.env.SHOTS) for (const [n, b] of [["before", before], ["after", after]]) writeFileSync(`${process.env.SHOTS}/${n}.png`, b);
  ok(before.equals(after), "the reloaded page is the same picture");
});

test("8 layouts: the page survives its server process", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.dblclick("#tree .node[data-stream='Robot.State']");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "the layout is changed");
  const rows = await page.$$eval(".row-box", (r) => r.length);
  await page.evaluate(() => window.liveSocket.disconnect());
  await page.evaluate(() => window.liveSocket.connect());
  await until(page, () => !document.querySelector(".phx-loading, .phx-client-error"), "connected again");
  await until(page, (n) => document.querySelectorAll(".row-box").length === n, "the layout is as it was", rows);
});
