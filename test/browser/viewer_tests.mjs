// Links for those who may look and not change.
import { readdirSync } from "node:fs";
import { test, equal, ok, until } from "./harness.mjs";
import { open, dispatch, panelOf, state, panelIn } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const base = site.shared.replace(/\/\?.*/, "");
const S = 1e9;

const files = () => readdirSync(site.folder).sort();

test("4 viewers: a link may look and not change, whatever its page sends", async ({ page, shot }) => {
  await page.goto(site.viewed);
  await open(page, base, "minute.0000");
  ok((await page.textContent(".status")).includes("looking only"), "the page says so");
  for (const title of ["Save the layout", "Save the selection as a recording (Ctrl+E)", "Annotate (a)"])
    equal(await page.$$eval(`button[title='${title}']`, (b) => b.length), 0, title);
  const before = files();
  // what a page of its own making would send
  const sent = await page.evaluate(
    async (id) => {
      const push = (event, payload) => window.situStudio.options.push(event, payload);
      const { client } = window.situStudio;
      const [from, to] = [client.abs(1e9), client.abs(2e9)];
      push("layout_dialog", {});
      push("layout_save", { name: "Sneaky" });
      push("export_dialog", { from, to, of: "selection" });
      push("export_save", { name: "sneaky", streams: "all" });
      push("annotation_new", { name: "Sneaky", values: "a 1 #ffffff" });
      push("annotation_marker", { from, to, text: "sneaky", by: "me" });
      push("film_begin", { panel: id, from, to });
      return id;
    },
    panelIn(await panelOf(page, "Camera.Image")),
  );
  ok(sent, "a panel with pictures");
  // answered in order: after this one all of them are
  await page.dblclick("#tree .node[data-stream='Robot.State']");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "what it looks at is its own");
  equal(await page.$$eval("#film, #annotations", (e) => e.length), 0, "nothing was begun");
  equal(files(), before, "nothing was written");
  await page.goto(`${base}/settings`);
  ok(await page.isDisabled("#setting-layout"), "settings cannot be changed");
  await page.goto(`${base}/s/minute.0000`);
  const names = await page.$$eval("#layout-pick option", (o) => o.map((e) => e.value));
  ok(!names.includes("Sneaky"), `no layout was saved: ${names}`);
  await shot("viewer");
});

test("4 viewers: the owner's page copies such a link, which shows the same", async ({ page, context, browser }) => {
  await context.grantPermissions(["clipboard-read", "clipboard-write"]);
  await page.goto(site.shared);
  await open(page, base, "minute.0000");
  await dispatch(page, { type: "view", from: 10 * S, to: 20 * S });
  await page.keyboard.press("Control+k");
  await page.keyboard.type("may look");
  await page.keyboard.press("Enter");
  await until(page, () => document.getElementById("toast").textContent.startsWith("Link copied"), "copied");
  const link = await page.evaluate(() => navigator.clipboard.readText());
  const other = await browser.newContext();
  try {
    const guest = await other.newPage();
    await guest.goto(link);
    await until(guest, () => document.body?.dataset.ready === "1", "the page");
    ok(!guest.url().includes("token"), "the token leaves the address");
    ok((await guest.textContent(".status")).includes("looking only"), "looking only");
    equal((await state(guest)).view, [10 * S, 20 * S], "the same view");
    // the owner's token makes more of it
    await guest.goto(site.shared);
    await open(guest, base, "minute.0000");
    ok(!(await guest.textContent(".status")).includes("looking only"), "an owner now");
  } finally {
    await other.close();
  }
});
