// The studio's page of a cluster in a real browser: `page.mjs PAGE NAME PART FIRST SECOND`. Opens a recording that lies
// on node SECOND alone, and the pipeline of PART, from the page's lists; looks at PART's streams while it moves to
// FIRST and back.
import { execFile } from "node:child_process";
import { promisify } from "node:util";
import { ok, runAll, test, until } from "../browser/harness.mjs";

const [page, name, part, first, second] = process.argv.slice(2);
const situ = (...args) => promisify(execFile)(`${process.env.ROOT}/bin/situ`, [...args, "--node", first]);
const move = (to) => situ("cluster", "move", ...part.split("/"), to);

test("a recording of another node opens from the page of the cluster", async ({ page: tab, shot }) => {
  await tab.goto(page);
  await until(tab, (n) => document.querySelector("#recordings")?.innerText.includes(n), "it is listed", name);
  const row = await tab.textContent(`#recordings tr:has(a:text-is("${name}"))`);
  ok(row.includes(second), "with its node");
  await shot("cluster");
  await tab.click(`#recordings a:text-is("${name}")`);
  await until(tab, () => document.body?.dataset.ready === "1", "it is opened");
  await until(tab, () => document.body?.innerText.includes("level"), "its stream is there");
  await tab.dblclick("#tree .node[data-stream='level']");
  await until(tab, () => document.querySelector("[data-kind] canvas"), "and drawn");
  await shot("recording");
});

test("so does the pipeline of a part", async ({ page: tab, shot }) => {
  await tab.goto(page);
  await until(tab, (p) => document.querySelector("#parts")?.innerText.includes(p), "it is listed", part);
  await tab.click(`#parts a:text-is("${part}")`);
  await until(tab, () => location.pathname.includes("/p/"), "its page is opened");
  await until(tab, (p) => document.body?.innerText.includes(p.split("/")[1]), "and shows it", part);
  await shot("pipeline");
});

// The time of the newest message drawn, of a page that follows it live; 0 where none is newer than `t`.
const newer = (t) => {
  const layers = [...window.situStudio.views].filter((v) => v.plot).flatMap((v) => v.layers);
  const s = layers[0]?.channel?.series;
  if (!s || window.situStudio.time.get().mode !== "live") return 0;
  const times = Array.from(s.t.slice(0, s.length)).filter((_, i) => Number.isFinite(s.last[i]));
  return times.length && times.at(-1) > t ? times.at(-1) : 0;
};

// Messages are drawn that are newer by some seconds than those there now.
async function goesOn(tab, after, seconds = 2) {
  const last = await tab.evaluate(newer, 0);
  await until(tab, newer, `messages are drawn ${after}`, last + seconds * 1e9);
}

// Its messages come from there: they go on beyond the moment at which the studio looks whether they are still wanted,
// and from the other node as soon as that runs it.
test("and its streams are drawn, on whichever node it runs", async ({ page: tab, shot }) => {
  await tab.goto(`${page.replace(/cluster$/, "")}s/${part}`);
  await until(tab, () => document.body?.dataset.ready === "1", "it is opened");
  // nobody has told the studio that these are numbers: the first of them do
  await until(tab, newer, "lines are drawn", 0);
  await goesOn(tab, "when it is opened", 4);
  await move(first);
  await goesOn(tab, `when it has moved to ${first}`);
  await shot("moved");
  await move(second);
  await goesOn(tab, `when it is back on ${second}`);
  await shot("stream");
});

test("a page opened later follows it too", async ({ page: tab }) => {
  await tab.goto(`${page.replace(/cluster$/, "")}s/${part}`);
  await until(tab, () => document.body?.dataset.ready === "1", "it is opened");
  await tab.dblclick("#tree .node >> nth=0");
  await goesOn(tab, "when it is opened");
});

const good = await runAll({ shots: process.env.SHOTS });
process.exit(good ? 0 : 1);
