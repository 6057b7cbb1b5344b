// The page of experiments: the table, the charts, comments, and the session where a set and the baseline differ.
import { test, equal, ok, until } from "./harness.mjs";
import { state, settled } from "./studio_page.mjs";

const { tuned } = JSON.parse(process.argv[2]);

const shownSets = (page) =>
  page.$$eval("#sets tbody tr", (rows) => rows.map((r) => Number(r.id.replace("set-", ""))));

async function openSets(page, query = "") {
  await page.goto(`${tuned}/x/study.json${query}`);
  await until(page, () => document.querySelectorAll("#sets tbody tr").length > 0, "the sets are shown");
}

// Drags along an axis, between two shares of its height.
async function brush(page, axis, from, to) {
  const box = await (await page.$(`#parallel [data-axis="${axis}"] .grip`)).boundingBox();
  const [top, height] = [box.y + 8, box.height - 16];
  const x = box.x + box.width / 2;
  await page.mouse.move(x, top + height * (1 - from));
  await page.mouse.down();
  await page.mouse.move(x, top + height * (1 - to), { steps: 4 });
  await page.mouse.up();
}

const setCount = (page, n) =>
  until(page, (k) => document.querySelectorAll("#sets tbody tr").length === k, `${n} sets`, n);

test("6 experiments: the dataset's page leads to them; sets are sorted, filtered and commented", async ({
  page,
  shot,
}) => {
  await page.goto(`${tuned}/d/study.json`);
  await page.click("#experiments-link");
  await until(page, () => document.querySelectorAll("#sets tbody tr").length === 8, "all sets");
  await shot("experiments");
  await page.click("#sets thead button:has-text('Set')");
  await until(page, () => document.querySelector("#sets tbody tr").id === "set-1", "sorted by number");
  equal(await shownSets(page), [1, 2, 3, 4, 5, 6, 7, 8], "in order");
  await brush(page, "p.limit", 0.9, 1);
  await setCount(page, 2);
  equal(await shownSets(page), [7, 8], "the sets with the highest limit");
  // The address has everything, and a click on the axis shows all sets again.
  await page.reload();
  await setCount(page, 2);
  await brush(page, "p.limit", 0.5, 0.5);
  await setCount(page, 8);
  await page.click("#set-5 th button");
  await until(page, () => document.querySelector(".set-details h2")?.textContent === "Set 5", "its details");
  await page.selectOption("#choose-curve select[name=metric]", "segments");
  await until(
    page,
    () => document.getElementById("curves").getAttribute("aria-label").startsWith("segments"),
    "curves",
  );
  await page.fill(".comment input[name=by]", "Ada");
  await page.fill(".comment textarea", "Right in the loud session");
  await page.click(".comment button");
  await until(page, () => document.querySelector(".comments li")?.textContent.includes("Right in"), "the comment");
  equal(await page.inputValue(".comment textarea"), "", "the field is empty again");
  await page.click("#set-3 th button");
  await until(page, () => document.querySelector(".set-details h2")?.textContent === "Set 3", "another set");
  equal(await page.inputValue(".comment input[name=by]"), "Ada", "the name is remembered");
});

test("6 experiments: a value opens the session at the differences from the baseline", async ({ page, shot }) => {
  await openSets(page, "?set=5");
  await page.click(".set-details button:has-text('Make it the baseline')");
  await until(page, () => document.querySelector("#set-5 .tag")?.textContent === "baseline", "the baseline");
  await page.click("#set-1 .cell");
  await until(
    page,
    () => document.body?.dataset.ready === "1" && document.body?.dataset.connection === "open",
    "the session is shown",
  );
  await settled(page);
  ok(decodeURIComponent(page.url()).includes("/study.json/"), "a session of the study");
  ok((await page.textContent("h1.where")).includes("set 1 and the baseline, set 5"), "its title");
  const lanes = await page.$$eval(".lane-name", (names) => names.map((n) => n.title.split("  ").pop()));
  equal(lanes, ["baseline", "set", "truth", "Speaking"], "both outputs, the truth and the differences");
  const first = (await state(page)).cursor;
  await shot("difference");
  const cursors = [first];
  for (const key of ["n", "n", "ArrowRight", "N"]) {
    const before = (await state(page)).cursor;
    await page.keyboard.press(key);
    await until(page, (t) => window.situStudio.time.get().cursor !== t, `${key} goes to another difference`, before);
    cursors.push((await state(page)).cursor);
  }
  ok(cursors[0] < cursors[1] && cursors[1] < cursors[2] && cursors[2] < cursors[3], "forward");
  equal(cursors[4], cursors[2], "and back");
});
