// node browser.mjs URL: drives the demo view in Chromium, prints one line per check, and exits with 1 if one fails.
import { chromium } from "playwright-core";

const base = process.argv[2];
const browser = await chromium.launch({
  executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium",
  args: [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
  ],
});
const page = await browser.newPage();
page.setDefaultTimeout(60_000);
const noise = [];
page.on("console", (m) => ["error", "warning"].includes(m.type()) && noise.push(m.text()));
page.on("pageerror", (e) => noise.push(String(e)));
// The last frames, to find out why a wait timed out.
const frames = [];
page.on("websocket", (ws) => {
  const recordFrame = (way) => (payload) => frames.push(`${way} ${String(payload).slice(0, 160)}`);
  ws.on("framesent", (f) => recordFrame(">")(f.payload));
  ws.on("framereceived", (f) => recordFrame("<")(f.payload));
  ws.on("close", recordFrame("closed"));
});

let failed = 0;
const check = (name, ok, detail = "") => {
  if (!ok) failed++;
  console.log(ok ? "ok  " : "FAIL", name, detail);
};
const readText = (selector) => page.textContent(selector);
const waitUntil = (fun, arg) => page.waitForFunction(fun, arg);
const waitForText = (selector, value) =>
  waitUntil(([s, v]) => document.querySelector(s)?.textContent === v, [selector, value]);

try {
  await page.goto(base + "/");
  await page.waitForSelector(".phx-connected");
  check("joined", true);
  await waitUntil(() => window.seen.points.length === 1);
  check("push_event after mount reaches the hook", true);
  await page.click("#inc");
  await waitForText("#count", "1");
  await page.click("#inc");
  await waitForText("#count", "2");
  check("click", true);
  await page.click("#toggle");
  await page.waitForSelector("#open em");
  check("branch", (await readText("#open")).includes("even"));
  check("the island changes with it", (await page.$$("#t th")).length === 2);
  await page.click("#inc");
  await page.waitForSelector("#open b");
  await page.click("#toggle");
  await page.waitForSelector("#closed");
  check("nested branches", true);
  await page.evaluate(() => document.querySelectorAll("#list li").forEach((li) => (li.mark = li.id)));
  await page.click("#rev");
  await waitUntil(() => document.querySelector("#list li").id === "r5");
  check(
    "keyed list keeps its nodes",
    await page.evaluate(() => [...document.querySelectorAll("#list li")].every((li) => li.mark === li.id)),
  );
  check(
    "the island follows the list",
    (await page.$$eval("#t tbody tr", (rows) => rows.map((r) => r.id).join())) === "t-5,t-4,t-3",
  );
  await page.click("#add");
  await page.waitForSelector("#r6");
  await page.click("#r3 button[phx-click=bump]");
  await waitUntil(() => document.querySelector("#r3").textContent.includes("=103"));
  check("one row changes", (await page.getAttribute("#r3", "class")) === "hot");
  await page.click("#r5 button[phx-click=del]");
  await waitUntil(() => !document.querySelector("#r5"));
  check("a row is removed", (await page.$$eval("#list li", (l) => l.map((x) => x.id).join())) === "r4,r3,r2,r1,r6");
  check("text is escaped", (await readText("#nasty")) === `<b>&"'</b>` && (await page.$("#nasty b")) === null);
  await page.click("#dis");
  await page.waitForSelector("#inc[disabled]");
  await page.click("#dis");
  await page.waitForSelector("#inc:not([disabled])");
  check("attributes are added and removed", true);
  await page.click("#js");
  await waitForText("#count", "4");
  check("JS commands", await page.isVisible("#menu"));

  await page.click("#q");
  await page.keyboard.type("hello world", { delay: 10 });
  await waitForText("#note", "len 11");
  check(
    "a form keeps focus, caret and text",
    await page.evaluate(() => document.activeElement.id === "q" && document.activeElement.selectionStart === 11),
  );
  await page.keyboard.press("Enter");
  await waitForText("#note", "saved hello world");
  check("submit", true);

  const readEntries = () =>
    page.$$eval("#entries [name]", (fields) =>
      fields.map((f) => (f.type === "checkbox" ? f.checked : f.value)).join(),
    );
  await page.fill("#entries [name=name]", "bob");
  await page.check("#entries [name=on]");
  await page.fill("#entries [name=text]", "more");
  await page.selectOption("#entries [name=kind]", "a");
  await page.fill("#entries [name=count]", "99");
  await page.click("#inc");
  await waitForText("#count", "5");
  const entries = [await readEntries()];
  await page.click("#inc");
  await waitForText("#count", "6");
  entries.push(await readEntries());
  check(
    "a form without phx-change keeps its entries until the server changes a value",
    entries.join(" ") === "bob,true,more,a,5 bob,true,more,a,6",
    entries.join(" "),
  );
  await page.evaluate(() => document.querySelector("#entries").reset());
  check(
    "and the server's values when it is reset",
    (await readEntries()) === "ann,false,some,b,6",
    await readEntries(),
  );

  const reply = await page.evaluate(
    () => new Promise((done) => window.hook.pushEvent("ask", { a: [1, "é<"] }, (r) => done(JSON.stringify(r)))),
  );
  check("a hook's event gets a reply", reply === '{"echo":{"a":[1,"é<"]}}', reply);
  await page.evaluate(() => new Promise((done) => window.hook.pushEvent("draw", { n: 7 }, done)));
  check("push_event with a reply", (await page.evaluate(() => window.seen.points.at(-1))) === 7);

  await page.click("#line");
  await page.waitForSelector("#lines-3");
  await page.click("#unline");
  await waitUntil(() => !document.querySelector("#lines-1"));
  check(
    "stream: insert and delete",
    (await page.$$eval("#lines li", (l) => l.map((x) => x.id).join())) === "lines-3,lines-2",
  );
  await page.click("#relines");
  await page.waitForSelector("#lines-9");
  check("stream: reset", (await page.$$eval("#lines li", (l) => l.length)) === 1);

  await page.click("#lp");
  await waitForText("#tab", "b");
  check("patch link", page.url().endsWith("/?tab=b"));
  await page.click("#patch");
  await waitForText("#tab", "c");
  await waitUntil(() => location.search === "?tab=c");
  check("push_patch", true);
  await page.goBack();
  await waitForText("#tab", "b");
  check("history back", true);

  await page.evaluate(() => new Promise((done) => window.hook.pushEvent("ticks", { n: 100 }, done)));
  await waitUntil(() => window.seen.ticked === 1);
  check(
    "100 ticks in fewer diffs, none lost",
    await page.evaluate(
      () =>
        window.seen.ticks === 100 &&
        document.querySelector("#tick").textContent === "100" &&
        window.seen.acks > 2 &&
        window.seen.acks < 100,
    ),
    await page.evaluate(() => window.seen.acks),
  );

  const count = await readText("#count");
  await page.fill("#q", "typed before crash");
  await waitForText("#note", "len 18");
  await page.click("#crash");
  await waitUntil(() => window.seen.reconnected >= 1);
  check("an exception remounts the view", count === "6" && (await readText("#count")) === "0");
  await waitForText("#note", "len 18");
  check("and keeps the text of the form", (await page.inputValue("#q")) === "typed before crash");
  await page.click("#inc");
  await waitForText("#count", "1");

  await page.click("#lr");
  await page.waitForSelector("#other");
  check("navigate to another view", page.url().endsWith("/other") && (await page.title()) === "other");
  // Leaving a page while its socket connects makes the browser log a warning.
  await page.waitForSelector(".phx-connected");
  await page.click("#home");
  await page.waitForSelector("#count");
  // The two views have different sessions, so this was a page load: wait for the server.
  await page.waitForSelector(".phx-connected");
  await page.click("#go");
  await page.waitForSelector("#other");
  check("push_navigate", true);

  const unexpected = noise.filter((n) => !/error: unable|phx-error|view crashed/i.test(n));
  check("nothing in the console", unexpected.length === 0, unexpected.slice(0, 5).join("\n"));
} catch (error) {
  check("all checks ran", false, `${error}\n${noise.slice(0, 10).join("\n")}\n${frames.slice(-12).join("\n")}`);
}
await browser.close();
process.exit(failed ? 1 : 0);
