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

// Its messages come from there: they go on beyond the moment at which the studio looks whether they are still wanted.
test("and its streams are drawn", async ({ page: tab, shot }) => {
  await tab.goto(`${page.replace(/cluster$/, "")}s/${part}`);
  await until(tab, () => document.body?.dataset.ready === "1", "it is opened");
  await tab.dblclick("#tree .node >> nth=0");
  const drawn = () => {
    const layers = [...window.situStudio.views].filter((v) => v.plot).flatMap((v) => v.layers);
    const s = layers[0]?.channel?.series;
    return s ? Array.from(s.last).filter(Number.isFinite).length : 0;
  };
  await until(tab, drawn, "messages are drawn");
  const { cursor } = await tab.evaluate(() => window.situStudio.time.get());
  await until(tab, (c) => window.situStudio.time.get().cursor > c + 4e9, "time goes on", cursor);
  await until(tab, drawn, "and messages are drawn still");
  await shot("stream");
});

const good = await runAll({ shots: process.env.SHOTS });
process.exit(good ? 0 : 1);
