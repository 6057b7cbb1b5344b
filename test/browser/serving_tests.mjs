// Tokens, malicious requests, and the other kinds of sources.
import { cpSync, rmSync } from "node:fs";
import { test, equal, ok, until } from "./harness.mjs";
import { open, settled, state, dispatch, panelOf } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const { main, guarded } = site;
const guardedBase = guarded.replace(/\/\?.*/, "");
const S = 1e9;

test("9 serving: a token is requested and kept in a cookie; a read-only studio hides editing tools", async ({
  page,
}) => {
  const bare = await page.request.get(`${guardedBase}/`);
  equal(bare.status(), 401, "without a token");
  equal(
    (await page.request.get(`${guardedBase}/?token=wrong-wrong-wrong-12345`)).status(),
    401,
    "with a wrong token",
  );
  equal(
    (await page.request.get(`${guardedBase}/data/window?source=minute.0000&stream=Mic.Level`)).status(),
    401,
    "data without a token",
  );
  await page.goto(guarded);
  ok(!page.url().includes("token"), "the token leaves the address");
  await open(page, guardedBase, "memory");
  equal(await page.$$eval("button[title='Save the layout']", (b) => b.length), 0, "buttons that write");
  ok((await page.textContent(".status")).includes("read-only"), "it is reported");
});

test("9 serving: the list shows all sources and opens one", async ({ page, shot }) => {
  await page.goto(main);
  await until(page, () => document.querySelectorAll(".home .item").length >= 3, "all sources are listed");
  await shot("home");
  // A person would read the list first, and the page is connected by then.
  await until(page, () => document.querySelector("[data-phx-main].phx-connected"), "the page is connected");
  await page.click("text=minute.0000");
  await until(page, () => document.body?.dataset.ready === "1", "one is opened");
});

test("9 serving: a row of the list keeps its target when a new row appears above it", async ({ page }) => {
  await page.goto(main);
  await until(page, () => document.querySelector("[data-phx-main].phx-connected"), "the page is connected");
  const row = await page.waitForSelector(".home .item[href='s/minute.0000']");
  const before = (await row.boundingBox()).y;
  const added = `${site.folder}/aaa.0000`;
  cpSync(`${site.folder}/uneven.0000`, added, { recursive: true });
  try {
    await until(page, () => document.querySelector(".home .item[href='s/aaa.0000']"), "the new recording is listed");
    ok((await row.boundingBox()).y > before, "the row has moved");
    equal(await row.getAttribute("href"), "s/minute.0000", "the target under a pressing finger");
    ok((await row.textContent()).includes("minute.0000"), "its name");
  } finally {
    rmSync(added, { recursive: true, force: true });
  }
});

test("security: names, texts and values are displayed, never executed", async ({ page }) => {
  await open(page, main, "minute.0000");
  await page.click("#tree .node >> nth=0 >> .name");
  await page.dblclick("#tree .node >> nth=0");
  await settled(page);
  await dispatch(page, { type: "cursor", t: 20 * S });
  await settled(page);
  await page.waitForTimeout(300);
  equal(await page.evaluate(() => window.hacked ?? 0), 0, "nothing ran");
  ok(
    await page.evaluate(() =>
      [...document.querySelectorAll("#tree .name")].some((e) => e.textContent === "<script>hacked=1</script>"),
    ),
    "the name is shown unchanged",
  );
  ok(
    await page.evaluate(() =>
      [...document.querySelectorAll(".value-tree .v")].some((e) => e.textContent.includes("<img src=x")),
    ),
    "the value is shown unchanged",
  );
  equal(
    await page.evaluate(() => document.querySelectorAll(".value-tree img, .value-tree b:not([class])").length),
    0,
    "elements made from values",
  );
});

test("security: paths, origins and malformed requests are rejected", async ({ page }) => {
  for (const path of ["/assets/../../../mix.exs", "/assets/%2e%2e/%2e%2e/mix.exs", "/assets/..%2f..%2fmix.exs"]) {
    ok(
      [400, 404].includes((await page.request.get(main + path, { maxRedirects: 0 })).status()),
      `${path} is refused`,
    );
  }
  const missing = await page.goto(`${main}/s/..%2f..%2fetc`);
  ok(
    [200, 400, 404].includes(missing.status()) && !(await page.content()).includes("root:"),
    "no path leaves the folder",
  );
  await page.goto(`${main}/s/nothing`);
  ok((await page.textContent("body")).includes("There is no recording"), "an unknown recording is named");
  for (const q of ["from=x", "from=5&to=1", "px=0", "px=99999999", "path=%5B", "stream=none"]) {
    const r = await page.request.get(`${main}/data/window?source=minute.0000&stream=Mic.Level&${q}`);
    ok(r.status() < 500, `${q} is answered with ${r.status()}`);
  }
  const closed = await page.evaluate(
    async (url) => {
      const tries = ["", "{", "[]", '{"req":-1}', '{"req":1e99}', "x".repeat(300000)];
      const out = [];
      for (const t of tries) {
        const ws = new WebSocket(url);
        await new Promise((r) => (ws.onopen = r));
        ws.send(t);
        out.push(
          await new Promise((r) => {
            ws.onclose = () => r("closed");
            ws.onmessage = () => r("answered");
            setTimeout(() => r("silent"), 30000);
          }),
        );
      }
      return out;
    },
    main.replace("http", "ws") + "/data/socket?source=minute.0000",
  );
  ok(
    closed.every((c) => c === "closed"),
    `malformed requests close the socket: ${closed}`,
  );
  await open(page, main, "minute.0000");
});

test("security: a socket from a foreign page is rejected", async ({ page }) => {
  const { connect } = await import("node:net");
  const { port } = new URL(main);
  const status = await new Promise((resolve) => {
    const s = connect(Number(port), "localhost", () =>
      s.write(
        `GET /data/socket?source=minute.0000 HTTP/1.1\r\nHost: localhost:${port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\nOrigin: http://evil.example\r\n\r\n`,
      ),
    );
    s.once("data", (d) => {
      resolve(d.toString().split(" ")[1]);
      s.destroy();
    });
  });
  equal(status, "403", "status");
  await open(page, main, "minute.0000");
});

test("security: a browser that stops reading does not slow the server", async ({ page }) => {
  const { connect } = await import("node:net");
  const { port } = new URL(main);
  const s = connect(Number(port), "localhost");
  s.pause();
  s.write(
    [
      "GET /data/socket?source=big.0000 HTTP/1.1",
      `Host: localhost:${port}`,
      "Upgrade: websocket",
      "Connection: Upgrade",
      "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
      "Sec-WebSocket-Version: 13",
      "\r\n",
    ].join("\r\n"),
  );
  await page.waitForTimeout(300);
  const t0 = BigInt(site.t0);
  for (let i = 0; i < 400; i++) {
    const request = {
      req: i,
      open: [[1, { stream: "Signal", viz: "line" }]],
      series: [[1, String(t0), String(t0 + 1000000000000n), 2 ** 26]],
    };
    const text = Buffer.from(JSON.stringify(request));
    const head = Buffer.from([0x81, 0x80 | 126, text.length >> 8, text.length & 255, 0, 0, 0, 0]);
    s.write(Buffer.concat([head, text]));
  }
  await page.waitForTimeout(500);
  // Another page is served during that time.
  await open(page, main, "minute.0000");
  ok(!s.destroyed, "the other is still there");
  s.destroy();
});

test("memory: a source in memory is shown like a recording", async ({ page }) => {
  await open(page, main, "memory");
  const id = await panelOf(page, "Camera.Image");
  await dispatch(page, { type: "cursor", t: 33.2 * S });
  await until(
    page,
    (i) => document.querySelector(`#${i} canvas`).dataset.at === "33000000000",
    "the image is shown",
    id,
  );
  await open(page, main, "empty");
  ok((await page.textContent(".stack")).includes("No streams yet"), "an empty source says so");
  const { view } = await state(page);
  equal(view[1] - view[0], S, "a second is shown of a source without duration");
});
