// Settings that are saved in this browser, and settings that the studio saves for all browsers.
import { test, equal, ok, near, until } from "./harness.mjs";
import { answer, open, settled, state, dispatch } from "./studio_page.mjs";

const { main, guarded } = JSON.parse(process.argv[2]);

async function settings(page) {
  await page.goto(`${main}/settings`);
  await until(
    page,
    () => document.querySelectorAll(".keys .btn").length > 40 && document.querySelector(".phx-connected"),
    "the settings",
  );
}

test("1 settings: a browser's settings apply to every page, and after a reload", async ({ page, shot }) => {
  await settings(page);
  await shot("settings");
  await page.selectOption("#setting-theme", "light");
  await page.selectOption("#setting-palette", "safe");
  await page.selectOption("#setting-step", "1 s");
  await page.selectOption("#setting-clock", "utc");
  await page.uncheck("#setting-follow");
  equal(await page.evaluate(() => document.documentElement.dataset.theme), "light", "immediately");
  await open(page, main, "minute.0000");
  equal(
    await page.evaluate(() => [document.documentElement.dataset.theme, document.documentElement.dataset.palette]),
    ["light", "safe"],
    "on another page",
  );
  equal((await state(page)).follow, false, "the cursor does not follow");
  await page.keyboard.press("ArrowRight");
  near((await state(page)).cursor, 1e9, 1, "a step is a second");
  await until(page, () => /^\d\d:\d\d:\d\d/.test(document.getElementById("t-cursor").textContent), "times in UTC");
});

test("1 settings: a key can be assigned only if it is free", async ({ page }) => {
  await settings(page);
  const key = "[data-usual='m']";
  await page.click(key);
  await page.keyboard.press("t");
  await until(
    page,
    () => document.getElementById("toast").textContent.startsWith("t is taken"),
    "a conflicting key is reported",
  );
  await page.click(key);
  await page.keyboard.press("F8");
  await until(page, (k) => document.querySelector(k).textContent === "F8", "its new key", key);
  await open(page, main, "minute.0000");
  await page.hover("[data-panel] .panel-body");
  await page.keyboard.press("m");
  await page.keyboard.press("F8");
  await until(page, () => document.querySelector(".maxed[data-panel]"), "the new key does it, the old one does not");
  await page.keyboard.press("F8");
  await until(page, () => !document.querySelector(".maxed[data-panel]"), "and back");
  await page.keyboard.press("?");
  ok((await page.textContent("#help")).includes("F8"), "the sheet of keys says so");
  await settings(page);
  await page.click("text=Restore default keys");
  equal(await page.textContent(key), "m", "as usual again");
});

test("1 settings: the studio's settings apply to every browser; a named layout saves itself", async ({
  page,
  browser,
}) => {
  await open(page, main, "uneven.0000");
  await page.click("button[title='Save the layout']");
  await page.fill("#layout-save input[name=name]", "Kept");
  await page.keyboard.press("Enter");
  await until(page, () => document.getElementById("studio").dataset.layout === "Kept", "a named layout");
  await settings(page);
  await page.selectOption("#setting-layout", "Kept");
  await page.selectOption("#setting-keep", "at_once");
  await page.selectOption("#setting-info", "count");
  await until(page, () => document.getElementById("toast").textContent === "Settings saved", "kept");
  const other = await (await browser.newContext()).newPage();
  await open(other, main, "uneven.0000");
  equal(await other.getAttribute("#studio", "data-layout"), "Kept", "another browser opens with it");
  equal(await other.textContent("#tree .node[data-stream='Late'] .info"), "401", "counts are shown");
  const before = await other.$$eval("[data-panel]", (p) => p.length);
  await other.dblclick("#tree .node[data-stream='Late']");
  await until(other, (n) => document.querySelectorAll("[data-panel]").length === n + 1, "a panel more", before);
  await until(other, () => document.getElementById("studio").dataset.edit === "", "is saved by itself");
  await open(page, main, "uneven.0000");
  equal(await page.$$eval("[data-panel]", (p) => p.length), before + 1, "for all");
  await other.context().close();
  await settings(page);
  for (const [id, usual] of [
    ["layout", "Automatic"],
    ["keep", "by_hand"],
    ["info", "rate"],
  ]) {
    await page.selectOption(`#setting-${id}`, usual);
    await until(page, ([i, u]) => document.querySelector(`#setting-${i}`).value === u, "as usual", [id, usual]);
  }
  await settled0(page);
  await page.goto(guarded);
  await page.goto(guarded.replace(/\/\?.*/, "/settings"));
  ok(await page.isDisabled("#setting-layout"), "a studio that is read only keeps nothing");
});

// The last change has been acknowledged.
const settled0 = (page) =>
  until(page, () => !document.querySelector(".phx-change-loading"), "the server has taken the settings");

test("1 settings: a question of the page is answered with keys, and Escape cancels it", async ({ page }) => {
  await open(page, main, "changing.0000");
  await dispatch(page, { type: "select", from: 1e9, to: 2e9 });
  await page.keyboard.press("k");
  await until(page, () => document.activeElement?.closest("#question"), "it has the focus");
  await page.keyboard.type("r t");
  equal((await state(page)).repeat, false, "keys go into it alone");
  await page.keyboard.press("Escape");
  await until(page, () => !document.querySelector("#question"), "closed");
  ok(!(await page.$("#annotation-body")), "nothing was kept");
  await page.keyboard.press("k");
  await answer(page, "here");
  await until(page, () => window.situStudio.annotation?.state.items.length === 1, "a comment");
  await settled(page);
});

test("1 settings: the list shows recent recordings, and the studio can start with the last one", async ({
  page,
  context,
}) => {
  await open(page, main, "uneven.0000");
  await page.goto(`${main}/d/study.json`);
  await page.goto(main);
  await until(page, () => document.querySelectorAll("#recent a").length === 2, "both are listed");
  equal(
    await page.$$eval("#recent a", (a) => a.map((e) => [new URL(e.href).pathname, e.textContent])),
    [
      ["/d/study.json", "study.json"],
      ["/s/uneven.0000", "uneven.0000"],
    ],
    "the most recent is first",
  );
  await page.evaluate(() => localStorage.setItem("situ:settings", JSON.stringify({ first: "last" })));
  const fresh = await context.newPage();
  await fresh.goto(main);
  await until(fresh, () => location.pathname === "/d/study.json", "a new tab opens it");
  await fresh.goto(main);
  await until(fresh, () => document.querySelector("#recent a"), "the list is still available");
});

test("1 settings: leaving a changed layout asks for confirmation if the setting is on", async ({ page }) => {
  await page.goto(`${main}/settings`);
  await page.selectOption("#setting-keep", "ask");
  await until(page, () => document.getElementById("toast").textContent === "Settings saved", "kept");
  await open(page, main, "uneven.0000");
  await page.click("[phx-click='layout_dialog']");
  await page.fill("#layout-save input", "Asked");
  await page.keyboard.press("Enter");
  await until(page, () => document.querySelector("#studio").dataset.layout === "Asked", "a named layout");
  const asked = [];
  page.on("dialog", (d) => (asked.push(d.type()), d.accept()));
  await page.dblclick("#tree .node[data-stream]");
  await until(page, () => document.querySelector("#studio").dataset.edit, "a change");
  await page.goto(`${main}/settings`);
  equal(asked, ["beforeunload"], "the page asks");
  await page.selectOption("#setting-keep", "by_hand");
  await until(page, () => document.getElementById("toast").textContent === "Settings saved", "as before");
});
