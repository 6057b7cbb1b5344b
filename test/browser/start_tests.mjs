// The start page of an empty folder: four ways to a first recording, and the hints of the first visit.
import { test, equal, ok, until } from "./harness.mjs";

const { start, linked } = JSON.parse(process.argv[2]);

const connected = (page) =>
  until(page, () => document.querySelector("[data-phx-main].phx-connected"), "the page is connected");

const ready = (page) => until(page, () => document.body?.dataset.ready === "1", "the recording is shown");

async function openStart(page) {
  await page.goto(start);
  await connected(page);
  if (!(await page.$("#start[open]"))) await page.click("#start > summary");
}

const CSV = Buffer.from("time,x\n2026-01-01T00:00:00Z,1\n2026-01-01T00:00:01Z,2\n");

test("start: files that are chosen or dropped are added and opened, others are refused with a reason", async ({
  page,
  shot,
}) => {
  await openStart(page);
  await shot("start");
  await page.setInputFiles("#upload-file", { name: "notes.txt", mimeType: "text/plain", buffer: Buffer.from("?") });
  await until(
    page,
    () => document.getElementById("upload-state").textContent.includes("the studio cannot open notes.txt"),
    "the refusal",
  );
  await page.setInputFiles("#upload-file", { name: "walk.csv", mimeType: "text/csv", buffer: CSV });
  await ready(page);
  ok(page.url().includes("/s/walk.csv"), "the recording's page");

  await openStart(page);
  await page.evaluate((text) => {
    const transfer = new DataTransfer();
    transfer.items.add(new File([text], "dropped.csv"));
    for (const type of ["dragover", "drop"])
      document.dispatchEvent(new DragEvent(type, { dataTransfer: transfer, bubbles: true, cancelable: true }));
  }, CSV.toString());
  await until(page, () => location.pathname.endsWith("/s/dropped.csv"), "the dropped file's page");
  await ready(page);
});

test("start: the sample is recorded with its progress, and shown", async ({ page, shot }) => {
  await openStart(page);
  await page.click("text=Make the sample");
  await until(page, () => document.querySelector("#start progress"), "its progress");
  await until(page, () => location.pathname.endsWith("/s/Talk.0000"), "its page");
  await ready(page);
  await until(page, () => document.querySelector(".tree")?.textContent.includes("Speaking"), "its streams");
  await shot("sample");
});

test("start: this browser's camera is recorded until its page is closed", async ({ page, context }) => {
  await context.grantPermissions(["camera", "microphone"], { origin: start });
  await openStart(page);
  await page.click("text=Open the camera page");
  await until(page, () => location.pathname.endsWith("/sensor"), "the sensor page");
  await page.click("#start");
  await until(page, () => window.situSensor.sent > 5, "it sends");
  const link = await page.getAttribute("#recording a", "href");
  const other = await context.newPage();
  await other.goto(`${start}/${link}`);
  await ready(other);
  ok(await other.isVisible("[data-act='live'], .live"), "it is shown live");
  await page.close();
  await other.goto(start);
  await connected(other);
  const row = `.home .item[href='${link}']`;
  const closed = (found) => {
    const text = document.querySelector(found)?.textContent ?? "";
    return text.includes("2 streams") && !document.querySelector(`${found} .badge.live`);
  };
  await until(other, closed, "it has images and sound, and has ended", row);
});

test("start: another machine's recordings need its token, and are shown", async ({ page }) => {
  await openStart(page);
  await page.fill("#connect-form [name=address]", linked);
  await page.click("#connect-form button");
  await until(page, () => document.querySelector("#start .problem")?.textContent.includes("token"), "it is refused");
  await page.fill("#connect-form [name=token]", "the-token-of-the-link");
  await page.click("#connect-form button");
  await until(page, () => location.pathname.includes("/s/"), "its page");
  await ready(page);
  ok(!page.url().includes("token-of"), "the token is in no address");
  await until(page, () => document.querySelector(".tree")?.textContent.includes("Level"), "its streams");
  await page.goto(start);
  const row = ".home .item[href*='/hall']";
  await until(page, (found) => / streams/.test(document.querySelector(found)?.textContent ?? ""), "its facts", row);
  equal(await page.$(`${row} .badge.damaged`), null, "it can be opened from the list");
});

test("start: hints appear on the first recording, and not again", async ({ browser }) => {
  const context = await browser.newContext({ viewport: { width: 1280, height: 720 } });
  const page = await context.newPage();
  try {
    await page.addInitScript(() => {
      if (!sessionStorage.getItem("begun")) localStorage.removeItem("situ:hints-seen");
      sessionStorage.setItem("begun", "yes");
    });
    await page.goto(`${start}/s/walk.csv`);
    await ready(page);
    equal(await page.$$eval("#hints li", (lines) => lines.length), 5, "five hints");
    await page.click("#hints button");
    equal(await page.$("#hints"), null, "they are closed");
    await page.reload();
    await ready(page);
    equal(await page.$("#hints"), null, "they stay closed");
  } finally {
    await context.close();
  }
});
