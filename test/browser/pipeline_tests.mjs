// The graph page of a running and of a recorded pipeline.
import { objections } from "./axe.mjs";
import { test, equal, ok, until } from "./harness.mjs";

const { main } = JSON.parse(process.argv[2]);

async function graph(page, path) {
  await page.goto(`${main}/p/${path}`);
  await until(
    page,
    () => document.querySelector("#graph svg")?.dataset.drawn >= 1 && document.querySelector(".graph .node"),
    "the graph is drawn",
  );
}

const nodes = (page) => page.$$eval(".graph .node", (n) => n.map((e) => e.dataset.path).sort());
const number = (page, key) => page.$eval(`.graph .edge[data-key="${key}"] .number`, (e) => e.textContent);

test("7 pipeline: the graph shows composites, policies and states, and folds and unfolds", async ({ page, shot }) => {
  await graph(page, "Factory");
  equal(await nodes(page), ["Belt.Double", "Belt.Source", "Fast", "Join", "Screen", "Slow.Heavy"], "components");
  equal(await page.$$eval(".graph .box", (b) => b.map((e) => e.dataset.path).sort()), ["Belt", "Slow"], "composites");
  ok(
    await page.$eval(".graph .edge.lossy .policy", (e) => e.textContent === "latest"),
    "a lossy connection names its policy",
  );
  const inside = await page.evaluate(() => {
    const box = document.querySelector('.graph .box[data-path="Belt"] rect').getBoundingClientRect();
    return ["Belt.Double", "Belt.Source"].every((p) => {
      const n = document.querySelector(`.graph .node[data-path="${p}"] rect`).getBoundingClientRect();
      return n.left > box.left && n.right < box.right && n.top > box.top && n.bottom < box.bottom;
    });
  });
  ok(inside, "a composite's components are inside its box");
  await page.mouse.move(5, 5);
  await shot("pipeline-graph");
  await page.dblclick('.graph .box[data-path="Belt"] rect', { position: { x: 4, y: 30 } });
  await until(page, () => document.querySelector(".graph .node.composite"), "Belt is folded");
  equal(await nodes(page), ["Belt", "Fast", "Join", "Screen", "Slow.Heavy"], "folded");
  await until(page, () => location.search.includes("fold=Belt"), "the address includes it");
  await page.reload();
  await until(page, () => document.querySelector(".graph .node.composite"), "a reload shows the same");
  await page.dblclick(".graph .node.composite");
  await until(page, () => document.querySelectorAll(".graph .node").length === 6, "unfolded again");
  await page.click("text=Fold all");
  await until(page, () => document.querySelectorAll(".graph .node.composite").length === 2, "all folded");
  await until(
    page,
    () =>
      [...document.querySelectorAll(".graph .edge")].every((e) =>
        (e.querySelector(".line").getAttribute("d") ?? "").slice(5),
      ),
    "connections end at the boxes",
  );
});

test("7 pipeline: any statistic colors the graph, and the numbers change", async ({ page, shot }) => {
  await graph(page, "Factory");
  await page.selectOption("#heat select", "busy");
  await until(
    page,
    () => [...document.querySelectorAll(".graph .number")].some((e) => parseFloat(e.textContent) > 30),
    "the slow part is busy",
  );
  const fill = (path) => getComputedStyle(document.querySelector(`.graph .node[data-path="${path}"] rect`)).fill;
  await until(page, `(${fill})("Slow.Heavy") !== (${fill})("Belt.Double")`, "hot and cold differ");
  await page.selectOption("#heat select", "processed");
  const key = await page.$eval(".graph .edge", (e) => e.dataset.key);
  await until(
    page,
    (k) => parseFloat(document.querySelector(`.graph .edge[data-key="${k}"] .number`).textContent) > 0,
    "messages are counted",
    key,
  );
  const drawn = await page.$eval("#graph svg", (e) => e.dataset.drawn);
  const before = await number(page, key);
  await until(
    page,
    ([k, b]) => document.querySelector(`.graph .edge[data-key="${k}"] .number`).textContent !== b,
    "the count grows",
    [key, before],
  );
  equal(await page.$eval("#graph svg", (e) => e.dataset.drawn), drawn, "the layout stays the same");
  await page.selectOption("#heat select", "memory");
  await until(
    page,
    () => [...document.querySelectorAll(".graph .node .sub")].every((e) => /B$/.test(e.textContent)),
    "components show their memory",
  );
  await shot("pipeline-memory");
  await page.selectOption("#heat select", "none");
  await until(
    page,
    () => [...document.querySelectorAll(".graph .node")].every((e) => e.style.getPropertyValue("--heat") === "0"),
    "no colour",
  );
});

test("7 pipeline: a component shows its state, process and history", async ({ page, shot }) => {
  await graph(page, "Factory?heat=busy");
  await page.click('.graph .node[data-path="Slow.Heavy"]');
  await until(page, () => document.querySelector(".right h2")?.textContent === "Slow.Heavy", "details");
  for (const word of ["Mailbox", "Memory", "Reductions per second", "Errors", "Process"])
    await until(page, (w) => document.querySelector(".right").textContent.includes(w), `it shows ${word}`, word);
  await until(
    page,
    () =>
      document.querySelectorAll(".spark output").length === 3 &&
      /max/.test(document.querySelector("#plot-memory output").textContent),
    "its history is plotted",
  );
  const ink = () =>
    page.$eval("#plot-memory canvas", (c) => {
      const d = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
      let n = 0;
      for (let i = 3; i < d.length; i += 4) if (d[i] > 0) n++;
      return n;
    });
  ok((await ink()) > 200, "there is a line");
  await page.click(".numbers .plot-it[phx-value-stat=errors]");
  await until(page, () => document.querySelector("#plot-errors canvas"), "another statistic is plotted");
  await until(page, () => location.search.includes("plots="), "the address includes it");
  await until(
    page,
    () => document.querySelector("#plot-errors output").textContent.startsWith("0"),
    "with its values",
  );
  await shot("pipeline-component");
  await page.click('.graph .node[data-path="Slow.Heavy"]');
  await until(
    page,
    () => document.querySelector(".right .side-title").textContent === "Pipeline",
    "a second click releases it",
  );
});

test("7 pipeline: a connection shows its numbers and last messages", async ({ page, shot }) => {
  await graph(page, "Factory");
  await page.click(".graph .edge.lossy .number");
  await until(page, () => document.querySelector(".right .side-title").textContent === "Connection", "details");
  ok((await page.textContent(".right .sub")).includes("latest"), "its policy");
  await until(page, () => document.querySelectorAll(".messages li").length === 8, "its last messages");
  const newest = () => page.textContent(".messages li code");
  const first = await newest();
  await until(page, (f) => document.querySelector(".messages li code").textContent !== f, "they continue", first);
  ok(/^\d+$/.test(await newest()), "they are its values");
  await until(page, () => document.querySelector(".graph .edge.picked"), "it is marked");
  await shot("pipeline-connection");
});

test("7 pipeline: recorded diagnostics are shown at any time", async ({ page, shot }) => {
  await graph(page, "factory-log?sel=e1&heat=processed");
  await until(page, () => document.querySelector("#moments input")?.max === "59", "the recorded times are loaded");
  ok((await page.textContent(".status")).includes("recorded"), "it is reported");
  await until(
    page,
    () =>
      document.querySelectorAll(".spark").length === 3 &&
      /max/.test(document.querySelector("#plot-processed_rate output").textContent),
    "the entire history is plotted",
  );
  const told = (n, what) =>
    until(page, (t) => document.querySelector('.graph .edge[data-key="e1"] .number')?.textContent === t, what, n);
  await told("6000", "the last moment");
  await page.$eval("#moments input", (e) => {
    e.value = "9";
    e.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await told("1000", "an earlier one");
  await until(page, () => /at=\d+/.test(location.search), "the address includes the time");
  await page.reload();
  await told("1000", "a reload shows the same");
  await shot("pipeline-recorded");
});

test("7 pipeline: missing pipelines are reported; streams link to the graph and back", async ({ page }) => {
  await page.goto(`${main}/p/memory`);
  ok((await page.textContent(".message")).includes("diagnostics: true"), "a recording without diagnostics");
  await page.goto(`${main}/s/Factory`);
  await page.click('a[title="The pipeline\'s graph"]');
  await until(page, () => document.querySelector(".graph .node"), "the graph");
  await page.click("a[title='Streams of this pipeline']");
  await until(page, () => document.getElementById("studio"), "the streams");
});

test("4 pipeline: waiting components are shown with the cause", async ({ page, shot }) => {
  await graph(page, "Mill");
  await until(
    page,
    () => /Grain waits for Stones.*Stones is busy \d/.test(document.querySelector(".waits")?.textContent ?? ""),
    "the source waits for the slow sink",
  );
  await shot("pipeline-waits");
  // It waits almost all the time, and the connection's page shows this, too.
  await page.click(".waits .row-button");
  await until(page, () => /Stones is busy/.test(document.querySelector(".right .wait")?.textContent ?? ""), "there");
  // Connections with other policies are faded, and the graph can change its direction.
  await page.selectOption("#mark select[name='mark']", "latest");
  await until(page, () => document.querySelector(".graph .edge.faded"), "a throttled connection is faded");
  await page.selectOption("#mark select[name='mark']", "waits");
  await until(page, () => document.querySelector(".graph .edge:not(.faded)"), "a waiting connection is not faded");
  await page.selectOption("#mark select[name='way']", "TB");
  await until(
    page,
    () => {
      const [a, b] = [...document.querySelectorAll(".graph .node")].map((n) => n.getBoundingClientRect());
      return Math.abs(a.left + a.width / 2 - b.left - b.width / 2) < 2 && a.top !== b.top;
    },
    "from top to bottom",
  );
  ok(page.url().includes("mark=waits") && page.url().includes("way=TB"), "the address includes both");
});

test("4 pipeline: one originating time is followed through the graph", async ({ page, shot }) => {
  await graph(page, "Factory");
  await page.click(".graph .edge.lossy .number");
  await until(page, () => document.querySelectorAll(".messages button.linkish").length === 8, "its last messages");
  // The list changes continuously, so the test clicks a position, not a message.
  await page.evaluate(() => document.querySelector(".messages button.linkish").click());
  await until(
    page,
    () => document.querySelectorAll("#trace .hops li").length >= 3,
    "the path of its originating time",
  );
  const hops = await page.$$eval("#trace .hops li span", (s) => s.map((e) => e.textContent));
  ok(!hops.some((h) => h.includes("Studio: ")), `the path excludes the studio's own taps: ${hops}`);
  await until(
    page,
    () => [...document.querySelectorAll("#trace .hops li")].some((e) => e.className === "passed"),
    "the components it has passed",
  );
  await shot("pipeline-trace");
  await page.click("#trace button[aria-label='Close the trace']");
  await until(page, () => !document.querySelector("#trace"), "closed");
  await page.fill("#trace-time input", "2200-01-01T12:34:56.789Z");
  await page.keyboard.press("Enter");
  await until(
    page,
    () => document.querySelector("#trace h2")?.textContent.includes("12:34:56.789"),
    "a typed time is traced",
  );
});

test("4 alerts: a rule of the settings raises an alert on the page and in the list, until it is removed", async ({
  page,
  context,
  shot,
}) => {
  const keep = async (text, said) => {
    await page.goto(`${main}/settings`);
    await page.fill("#setting-alerts", text);
    await page.click("#alert-settings button");
    await until(page, (t) => document.getElementById("toast").textContent.includes(t), said, said);
  };
  await keep("grinding: `busy(Stones)` >", "line 1 is not an alert rule");
  await keep("grinding: `busy(Stones)` > 20 or `Nothing` > 1", "Settings saved");
  await shot("alerts-settings");
  const list = await context.newPage();
  await list.goto(main);
  await until(list, () => /1 alert/.test(document.querySelector(".item .alerts")?.textContent ?? ""), "in the list");
  const other = await context.newPage();
  await other.goto(`${main}/p/Mill`);
  await until(
    other,
    () => /grinding since \d\d:\d\d:\d\d UTC/.test(document.querySelector("#alerts .raised")?.textContent ?? ""),
    "on the page of the graph",
  );
  for (const raised of [list, other]) equal(await objections(raised), [], "axe over a raised alert");
  await keep("", "Settings saved");
  await until(list, () => !document.querySelector(".item .alerts"), "the alert disappears from the list");
  await until(other, () => !document.querySelector("#alerts"), "the alert disappears from the page");
});
