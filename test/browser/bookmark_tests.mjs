// Bookmarks, which all browsers see, and lists of messages that are filtered.
import { test, equal, ok, until } from "./harness.mjs";
import { answer, dispatch, open, state } from "./studio_page.mjs";
import { objections } from "./axe.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

const listed = (page) => page.$$eval(".bookmark-items .go span", (all) => all.map((e) => e.textContent));

async function mark(page, at, text) {
  await dispatch(page, { type: "nudge", by: at * S - (await state(page)).cursor });
  await page.keyboard.press("B");
  await answer(page, text);
  const words = text.split(" #")[0];
  await until(page, (t) => document.getElementById("bookmarks").dataset.items.includes(t), "it is stored", words);
}

test("10 bookmarks: are seen by other browsers, visited by keys and clicks, changed and deleted", async (t) => {
  const { page, context, shot } = t;
  await open(page, main, "uneven.0000");
  const other = await context.newPage();
  await open(other, main, "uneven.0000");
  // An attempt before may have left some.
  for (const { id } of await page.$eval("#bookmarks", (e) => JSON.parse(e.dataset.items)))
    await page.evaluate((i) => window.situStudio.options.push("bookmark_delete", { id: i }), id);
  await until(page, () => document.getElementById("bookmarks").dataset.items === "[]", "there are none");
  await mark(page, 20, "the end");
  await mark(page, 5, "slow #best");
  await other.keyboard.press("M");
  await until(
    other,
    () => document.querySelectorAll(".bookmark-items li").length === 2,
    "the other browser has both",
  );
  equal(await listed(other), ["slow", "the end"], "they are listed by time");
  await until(other, () => document.querySelector(".bookmark-items time").textContent !== "", "with their times");
  await shot("bookmarks-first");
  equal(await objections(other), [], "axe");
  // Keys go from one to the next, a click goes to one.
  await other.keyboard.press("Home");
  await other.keyboard.press("j");
  equal((await state(other)).cursor, 5 * S, "the first");
  await other.keyboard.press("j");
  equal((await state(other)).cursor, 20 * S, "the next");
  await other.keyboard.press("J");
  equal((await state(other)).cursor, 5 * S, "the previous");
  await other.click(".bookmark-items .go >> nth=1");
  equal((await state(other)).cursor, 20 * S, "the one that was clicked");
  // A list has only some of them.
  await other.selectOption("#bookmark-lists select", "best");
  await until(other, () => document.querySelectorAll(".bookmark-items li").length === 1, "the list");
  await other.click("[data-change]");
  await until(other, () => document.activeElement?.closest("#question"), "the question");
  equal(await other.inputValue("#question input"), "slow #best", "the comment and its list");
  await other.fill("#question input", "very slow #best");
  await other.keyboard.press("Enter");
  await page.keyboard.press("M");
  await until(
    page,
    () => document.querySelector(".bookmark-items span")?.textContent === "very slow",
    "it was changed",
  );
  await page.click(".bookmark-items [title='Delete'] >> nth=0");
  await until(page, () => document.querySelectorAll(".bookmark-items li").length === 1, "it was deleted");
  equal(await listed(page), ["the end"], "the other one remains");
  await page.reload();
  await until(
    page,
    () => document.getElementById("bookmarks").dataset.items.includes("the end"),
    "after a reload, too",
  );
});

test("10 bookmarks: a list of messages is filtered, and values name the message before", async ({ page, shot }) => {
  await open(page, main, "minute.0000");
  await dispatch(page, { type: "cursor", t: 30.5 * S });
  await page.evaluate(() =>
    window.situStudio.options.push("add_viz", { stream: "Speech.Text", viz: "log", panel: "" }),
  );
  await until(
    page,
    () => document.querySelector(".log-cell [aria-current] .v")?.textContent === "word 30",
    "the list",
  );
  await page.fill(".log-filter input", "WORD 5");
  const reads = (text) => [...document.querySelectorAll(".log-cell .v")].map((e) => e.textContent).join() === text;
  const numbers = Array.from({ length: 60 }, (_, i) => String(i)).filter((n) => n.includes("5"));
  const wanted = numbers.map((n) => `word ${n}`).join();
  await until(page, reads, "the lines with these words", wanted);
  await page.selectOption(".log-filter select", "4");
  await until(page, reads, "and no error", "No message passes the filter.");
  await shot("filter");
  await page.evaluate(() =>
    window.situStudio.options.push("add_viz", { stream: "Speech.Scores", viz: "value", panel: "" }),
  );
  await until(
    page,
    () => document.querySelectorAll(".value-tree .row.changed").length === 2,
    "both scores have changed",
  );
  const was = await page.$$eval(".value-tree .changed .was", (all) => all.map((e) => Number(e.textContent)));
  const now = await page.$$eval(".value-tree .changed .v", (all) => all.map((e) => Number(e.textContent)));
  ok(was[0] < now[0] && was[1] > now[1], `go rises and stop falls: ${was} to ${now}`);
  await shot("differences");
});
