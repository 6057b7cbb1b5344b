// Several browsers on one recording: shared cursors, and pages that follow.
import { test, equal, ok, near, until } from "./harness.mjs";
import { open, settled, state, dispatch } from "./studio_page.mjs";

const { main } = JSON.parse(process.argv[2]);
const S = 1e9;

test("6 together: others see a shared cursor, and follow it until they move on their own", async ({
  page,
  browser,
  shot,
}) => {
  const context = await browser.newContext({ viewport: { width: 1280, height: 720 } });
  const other = await context.newPage();
  try {
    for (const p of [page, other]) await open(p, main, "minute.0000");
    const elsewhere = await context.newPage();
    await open(elsewhere, main, "uneven.0000");
    await other.evaluate(() => localStorage.setItem("situ:annotator", "Ada <b>"));
    await dispatch(other, { type: "nudge", by: 20 * S });
    await settled(page);
    equal(await page.$$eval("#together button", (b) => b.length), 0, "nobody is shown who does not share");
    await other.keyboard.press("g");
    await until(page, () => document.querySelector("#together button")?.textContent === "Ada <b>", "Ada is listed");
    await until(page, () => document.querySelector(".cursor-line.other:not([hidden])"), "with her cursor");
    equal(await elsewhere.$$eval("#together button", (b) => b.length), 0, "not at another recording");
    // A click on the name follows the cursor.
    await page.click("#together button");
    await dispatch(other, { type: "view", from: 30 * S, to: 40 * S });
    await dispatch(other, { type: "nudge", by: 33 * S - (await state(other)).cursor });
    await until(page, () => Math.abs(window.situStudio.time.get().cursor - 33e9) < 2, "the cursor follows hers");
    near((await state(page)).view[0], 30 * S, 2, "and the view");
    await shot("together");
    // A viewer who moves on their own no longer follows.
    await page.keyboard.press("PageDown");
    await until(page, () => document.querySelector("#together button[aria-pressed='false']"), "on one's own again");
    const { view } = await state(page);
    await dispatch(other, { type: "nudge", by: S });
    await until(page, () => [...window.situStudio.together.peers.values()][0].cursor > 33.9e9, "she has gone on");
    equal((await state(page)).view, view, "this page has not");
    await other.keyboard.press("g");
    await until(page, () => !document.querySelector("#together button, .cursor-line.other"), "she no longer shares");
    ok(await page.evaluate(() => window.situStudio.together.peers.size === 0), "and is forgotten");
  } finally {
    await context.close();
  }
});
