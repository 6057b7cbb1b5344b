// The studio's page of a cluster in a real browser: `page.mjs PAGE NODE NAME PART`. Opens a recording that lies on
// NODE alone, and the pipeline of PART, from the page's lists.
import { ok, runAll, test, until } from "../browser/harness.mjs";

const [page, node, name, part] = process.argv.slice(2);

test("a recording of another node opens from the page of the cluster", async ({ page: tab, shot }) => {
  await tab.goto(page);
  await until(tab, (n) => document.querySelector("#recordings")?.innerText.includes(n), "it is listed", name);
  const row = await tab.textContent(`#recordings tr:has(a:text-is("${name}"))`);
  ok(row.includes(node), "with its node");
  await shot("cluster");
  await tab.click(`#recordings a:text-is("${name}")`);
  await until(tab, () => document.body?.dataset.ready === "1", "it is opened");
  await until(tab, () => document.body.innerText.includes("level"), "its stream is there");
  await tab.dblclick("#tree .node[data-stream='level']");
  await until(tab, () => document.querySelector("[data-kind] canvas"), "and drawn");
  await shot("recording");
});

test("so does the pipeline of a part", async ({ page: tab, shot }) => {
  await tab.goto(page);
  await until(tab, (p) => document.querySelector("#parts")?.innerText.includes(p), "it is listed", part);
  await tab.click(`#parts a:text-is("${part}")`);
  await until(tab, () => location.pathname.includes("/p/"), "its page is opened");
  await until(tab, (p) => document.body.innerText.includes(p.split("/")[1]), "and shows it", part);
  await shot("pipeline");
});

const good = await runAll({ shots: process.env.SHOTS });
process.exit(good ? 0 : 1);
