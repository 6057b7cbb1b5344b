// View-only links.
import { readdirSync } from "node:fs";
import { test, equal, ok, until } from "./harness.mjs";
import { open, dispatch, panelOf, state, panelIn } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const base = site.shared.replace(/\/\?.*/, "");
const S = 1e9;

const files = () => readdirSync(site.folder).sort();

test("4 viewers: a view-only link changes nothing, whatever its page sends", async ({ page, shot }) => {
  await page.goto(site.viewed);
  await open(page, base, "minute.0000");
  ok((await page.textContent(".status")).includes("view only"), "the page says so");
  for (const title of ["Save the layout", "Save the selection as a recording (Ctrl+E)", "Annotate (a)"])
    equal(await page.$$eval(`button[title='${title}']`, (b) => b.length), 0, title);
  const before = files();
  // Sends events that a manipulated page could send.
  const sent = await page.evaluate(
    async (id) => {
      const push = (event, payload) => window.situStudio.options.push(event, payload);
      const { client } = window.situStudio;
      const [from, to] = [client.toAbsolute(1e9), client.toAbsolute(2e9)];
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
  ok(sent, "a panel with images");
  // Events are handled in order, so all of them are handled after this one.
  await page.dblclick("#tree .node[data-stream='Robot.State']");
  await until(page, () => document.getElementById("studio").dataset.edit !== "", "its own view still works");
  equal(await page.$$eval("#film, #annotations", (e) => e.length), 0, "nothing was started");
  equal(files(), before, "nothing was written");
  await page.goto(`${base}/settings`);
  ok(await page.isDisabled("#setting-layout"), "settings cannot be changed");
  await page.goto(`${base}/s/minute.0000`);
  const names = await page.$$eval("#layout-pick option", (o) => o.map((e) => e.value));
  ok(!names.includes("Sneaky"), `no layout was saved: ${names}`);
  await shot("viewer");
});

test("4 viewers: the owner's page copies a view-only link, which shows the same", async ({
  page,
  context,
  browser,
}) => {
  await context.grantPermissions(["clipboard-read", "clipboard-write"]);
  await page.goto(site.shared);
  await open(page, base, "minute.0000");
  await dispatch(page, { type: "view", from: 10 * S, to: 20 * S });
  await page.keyboard.press("Control+k");
  await page.keyboard.type("view-only");
  await page.keyboard.press("Enter");
  await until(page, () => document.getElementById("toast").textContent.startsWith("View-only link copied"), "copied");
  const link = await page.evaluate(() => navigator.clipboard.readText());
  const other = await browser.newContext();
  try {
    const guest = await other.newPage();
    await guest.goto(link);
    await until(guest, () => document.body?.dataset.ready === "1", "the page");
    ok(!guest.url().includes("token"), "the token leaves the address");
    ok((await guest.textContent(".status")).includes("view only"), "looking only");
    equal((await state(guest)).view, [10 * S, 20 * S], "the same view");
    // The owner's token removes the restriction.
    await guest.goto(site.shared);
    await open(guest, base, "minute.0000");
    ok(!(await guest.textContent(".status")).includes("view only"), "an owner now");
  } finally {
    await other.close();
  }
});
