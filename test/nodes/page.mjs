// Tests the studio's cluster page in a real browser: `page.mjs PAGE NAME PART FIRST SECOND`. Opens a recording that
// is on node SECOND only, and the pipeline of PART, from the page's lists. Watches PART's streams while it moves to
// FIRST and back.
import { execFile } from "node:child_process";
import { promisify } from "node:util";
import { ok, runAll, test, until } from "../browser/harness.mjs";

const [page, name, part, first, second] = process.argv.slice(2);
const situ = (...args) => promisify(execFile)(`${process.env.ROOT}/bin/situ`, [...args, "--node", first]);
const move = (to) => situ("cluster", "move", ...part.split("/"), to);

test("a recording on another node opens from the cluster page", async ({ page: tab, shot }) => {
  await tab.goto(page);
  await until(tab, (n) => document.querySelector("#recordings")?.innerText.includes(n), "it is listed", name);
  const row = await tab.textContent(`#recordings tr:has(a:text-is("${name}"))`);
  ok(row.includes(second), "with its node");
  await shot("cluster");
  await tab.click(`#recordings a:text-is("${name}")`);
  await until(tab, () => document.body?.dataset.ready === "1", "it is opened");
  await until(tab, () => document.body?.innerText.includes("level"), "its stream is shown");
  await tab.dblclick("#tree .node[data-stream='level']");
  await until(tab, () => document.querySelector("[data-kind] canvas"), "and drawn");
  await shot("recording");
});

test("the pipeline of a part opens from the cluster page", async ({ page: tab, shot }) => {
  await tab.goto(page);
  await until(tab, (p) => document.querySelector("#parts")?.innerText.includes(p), "it is listed", part);
  await tab.click(`#parts a:text-is("${part}")`);
  await until(tab, () => location.pathname.includes("/p/"), "its page is opened");
  await until(tab, (p) => document.body?.innerText.includes(p.split("/")[1]), "and shows it", part);
  await shot("pipeline");
});

// Returns the time of the newest drawn message of a live page, or 0 if none is newer than `t`.
const newer = (t) => {
  const layers = [...window.situStudio.views].filter((v) => v.plot).flatMap((v) => v.layers);
  const s = layers[0]?.channel?.series;
  if (!s || window.situStudio.time.get().mode !== "live") return 0;
  const times = Array.from(s.t.slice(0, s.length)).filter((_, i) => Number.isFinite(s.last[i]));
  return times.length && times.at(-1) > t ? times.at(-1) : 0;
};

// Waits until messages are drawn that are some seconds newer than the present ones.
async function goesOn(tab, after, seconds = 2) {
  const last = await tab.evaluate(newer, 0);
  await until(tab, newer, `messages are drawn ${after}`, last + seconds * 1e9);
}

// The messages continue beyond the time at which the studio checks whether they are still needed, and then come
// from the other node once the part runs there.
test("its streams are drawn, whichever node runs it", async ({ page: tab, shot }) => {
  await tab.goto(`${page.replace(/cluster$/, "")}s/${part}`);
  await until(tab, () => document.body?.dataset.ready === "1", "it is opened");
  // The studio does not know the type of the streams, so the first messages determine it.
  await until(tab, newer, "lines are drawn", 0);
  await goesOn(tab, "when it is opened", 4);
  await move(first);
  await goesOn(tab, `when it has moved to ${first}`);
  await shot("moved");
  await move(second);
  await goesOn(tab, `when it is back on ${second}`);
  await shot("stream");
});

test("a page that is opened later follows it, too", async ({ page: tab }) => {
  await tab.goto(`${page.replace(/cluster$/, "")}s/${part}`);
  await until(tab, () => document.body?.dataset.ready === "1", "it is opened");
  await tab.dblclick("#tree .node >> nth=0");
  await goesOn(tab, "when it is opened");
});

const good = await runAll({ shots: process.env.SHOTS });
process.exit(good ? 0 : 1);
