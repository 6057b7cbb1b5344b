// The page as a unit: tree, search, themes and size.
import { test, equal, ok, until } from "./harness.mjs";
import { open, settled, dispatch } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

test("2 the page: tree, search, keyboard and themes work", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await page.mouse.move(640, 600);
  await settled(page);
  await shot("studio-dark");
  equal(await page.$$eval("#tree .node", (n) => n.length), 22, "rows of the tree");
  await page.keyboard.press("/");
  await page.keyboard.type("acc");
  await until(page, () => document.querySelectorAll("#tree .node").length === 4, "the search has narrowed the tree");
  await page.fill("#search", "");
  await until(page, () => document.querySelectorAll("#tree .node").length === 22, "the tree is complete again");
  await page.focus("#tree .node");
  for (let i = 0; i < 4; i++) await page.keyboard.press("ArrowDown");
  await page.keyboard.press("ArrowLeft");
  await until(
    page,
    () => [...document.querySelectorAll("#tree .node")].some((n) => n.getAttribute("aria-expanded") === "false"),
    "a key folds a group",
  );
  const before = await page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  await page.evaluate(() => document.activeElement.blur());
  await page.keyboard.press("t");
  const after = await page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  ok(before !== after, "the theme changes");
  await settled(page);
  await shot("studio-light");
});

test("2 the page: nothing moves after it is shown, and everything fits 1280 x 720", async ({ page }) => {
  await page.addInitScript(() => {
    window.shift = 0;
    new PerformanceObserver((list) => {
      for (const e of list.getEntries()) window.shift += e.value;
    }).observe({ type: "layout-shift", buffered: true });
  });
  await open(page, main, "minute.0000");
  // The browser paints nothing before the end of the page, however slowly the page arrives.
  const blocked = await page.evaluate(() => {
    const { href, blocking } = document.querySelector('link[rel="expect"]');
    const { pathname, hash } = new URL(href);
    return blocking.contains("render") && pathname === location.pathname && document.querySelector(hash) !== null;
  });
  ok(blocked, "the first paint waits for the end of the page");
  await dispatch(page, { type: "select", from: 10 * S, to: 20 * S });
  await dispatch(page, { type: "zoomSel" });
  await settled(page);
  ok((await page.evaluate(() => window.shift)) < 0.01, `layout shift is ${await page.evaluate(() => window.shift)}`);
  equal(
    await page.evaluate(() => [document.documentElement.scrollWidth, document.documentElement.scrollHeight]),
    [1280, 720],
    "size of the page",
  );
  const over = await page.$$eval(".topbar > *", (els) =>
    els
      .filter((e) => e.getBoundingClientRect().right > 1280)
      .map((e) => `${e.className} ${e.getBoundingClientRect().right}`),
  );
  equal(over, [], "the toolbar fits");
});

test("2 the page: a window of 900 px shows the entire toolbar, and the properties on request", async ({
  page,
  shot,
}) => {
  await page.setViewportSize({ width: 900, height: 600 });
  await open(page, main, "minute.0000");
  equal(await page.evaluate(() => document.documentElement.scrollWidth), 900, "nothing is wider than the window");
  const over = await page.$$eval(".topbar button, .topbar select, .topbar a", (els) =>
    els
      .filter(
        (e) => e.offsetParent && (e.getBoundingClientRect().right > 900 || e.getBoundingClientRect().width < 20),
      )
      .map((e) => e.title),
  );
  equal(over, [], "tools that do not fit the toolbar");
  equal(await page.isVisible(".right"), false, "the properties are hidden");
  await page.click("#tree .node[data-stream='Imu.Acc.X'] .name");
  await until(
    page,
    () => document.querySelector(".right h2")?.textContent === "Imu.Acc.X",
    "the properties are announced",
  );
  ok(await page.isVisible(".right h2"), "the properties are shown");
  await shot("narrow");
  await page.click("button[aria-label='Hide the properties']");
  equal(await page.isVisible(".right"), false, "hidden again");
  await page.keyboard.press("p");
  ok(await page.isVisible(".right"), "a key shows them");
  const wide = await page.$eval(".stack", (e) => e.clientWidth);
  await page.keyboard.press("s");
  ok((await page.$eval(".stack", (e) => e.clientWidth)) >= wide + 190, "without the streams there is more room");
});

test("2 the page: at 480 px every tool is in the row, or in the menu of its last button", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  const tools = () => page.$$eval(".topbar button:not(#more), .topbar a.tool", (els) => els.map((e) => e.title));
  const all = await tools();
  await page.setViewportSize({ width: 480, height: 800 });
  equal(await page.evaluate(() => document.documentElement.scrollWidth), 480, "nothing is wider than the window");
  equal(await tools(), all, "no tool is lost");
  const unreachable = await page.$$eval(".topbar button, .topbar a.tool", (els) =>
    els.filter((e) => e.offsetParent && e.getBoundingClientRect().right > 480).map((e) => e.title),
  );
  equal(unreachable, [], "visible tools are within the window");
  const shown = await page.$$eval(".topbar button:not(#more), .topbar a.tool", (els) =>
    els.filter((e) => e.getClientRects().length > 0).map((e) => e.title),
  );
  await page.click("#more");
  await until(page, () => document.querySelectorAll("#menu [role=menuitem]").length > 0, "the menu");
  const items = await page.$$eval("#menu [role=menuitem]", (els) => els.length);
  equal(items, all.length - shown.length, "the menu has the hidden tools");
  await shot("small");
  await page.click("#menu [role=menuitem]:has-text('Keys')");
  await until(page, () => document.querySelector("dialog[open]"), "a tool of the menu works");
});

test("2 the page: two hundred streams are searched and navigated with keys", async ({ page, shot }) => {
  await open(page, main, "many.0000");
  await page.keyboard.press("/");
  await page.keyboard.type("joint7 robot");
  await until(
    page,
    () => document.querySelector(".found")?.textContent.trim() === "10 of 200 streams",
    "it shows the number of results",
  );
  await page.keyboard.press("ArrowDown");
  await until(page, () => document.activeElement?.id === "node-Robot1", "the focus moves into the tree");
  await page.keyboard.press("ArrowDown");
  await page.keyboard.press("ArrowDown");
  const panels = await page.$$eval(".panel-box", (r) => r.length);
  await page.keyboard.press("Enter");
  await until(page, (n) => document.querySelectorAll(".panel-box").length === n + 1, "the stream is shown", panels);
  await shot("many");
  await page.focus("#search");
  await page.keyboard.press("Escape");
  await until(
    page,
    () => !document.querySelector(".found") && document.querySelectorAll("#tree .node").length === 400,
    "all again, as many rows as are listed",
  );
});
