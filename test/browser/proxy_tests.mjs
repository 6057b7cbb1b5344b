// The studio behind Debian's nginx, under a path and with TLS terminated by the proxy, and on a slow link.
import { execFileSync, spawn } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { connect, createServer } from "node:net";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { test, equal, ok, until } from "./harness.mjs";
import { open, state, panelOf, pointAt, settled } from "./studio_page.mjs";

const site = JSON.parse(process.argv[2]);
const S = 1e9;

// This is the configuration in the guide.
const conf = (folder, port, to) => `
daemon off;
master_process off;
pid ${folder}/pid;
error_log ${folder}/error.log;
events {}
http {
  access_log off;
  client_body_temp_path ${folder}/body;
  proxy_temp_path ${folder}/proxy;
  fastcgi_temp_path ${folder}/f;
  uwsgi_temp_path ${folder}/u;
  scgi_temp_path ${folder}/s;
  map $http_upgrade $connection_upgrade { default upgrade; '' close; }
  server {
    listen 127.0.0.1:${port} ssl;
    ssl_certificate ${folder}/cert.pem;
    ssl_certificate_key ${folder}/key.pem;
    location /lab/studio/ {
      proxy_pass http://127.0.0.1:${to};
      proxy_http_version 1.1;
      proxy_set_header Host $host;
      proxy_set_header Upgrade $http_upgrade;
      proxy_set_header Connection $connection_upgrade;
      proxy_read_timeout 1h;
    }
  }
}
`;

async function nginx(run) {
  const folder = mkdtempSync(join(tmpdir(), "situ-nginx-"));
  const { port } = new URL(site.behind);
  const subject = ["-subj", "/CN=localhost", "-days", "2"];
  const files = ["-keyout", `${folder}/key.pem`, "-out", `${folder}/cert.pem`];
  execFileSync("openssl", ["req", "-x509", "-newkey", "rsa:2048", "-nodes", ...files, ...subject], {
    stdio: "ignore",
  });
  writeFileSync(`${folder}/nginx.conf`, conf(folder, port, site.behind_port));
  const child = spawn("nginx", ["-c", `${folder}/nginx.conf`, "-e", `${folder}/error.log`], {
    stdio: "ignore",
    env: { ...process.env, PATH: `${process.env.PATH}:/usr/sbin` },
  });
  const ended = new Promise((done) => child.on("exit", done).on("error", done));
  try {
    await answers(port);
    await run();
  } finally {
    child.kill("SIGKILL");
    await ended;
    rmSync(folder, { recursive: true, force: true });
  }
}

async function answers(port) {
  for (const end = Date.now() + 30_000; Date.now() < end; await new Promise((r) => setTimeout(r, 50))) {
    const there = await new Promise((done) => {
      const s = connect(Number(port), "127.0.0.1", () => (s.destroy(), done(true)));
      s.on("error", () => done(false));
    });
    if (there) return;
  }
  throw new Error("nginx does not start");
}

test("9 proxy: under a path of nginx with TLS, every page works and stays below the path", async ({
  browser,
  shot,
}) => {
  await nginx(async () => {
    const context = await browser.newContext({ ignoreHTTPSErrors: true, viewport: { width: 1280, height: 720 } });
    try {
      const page = await context.newPage();
      const asked = [];
      page.on("request", (r) => asked.push(r.url()));
      page.on("websocket", (w) => asked.push(w.url().replace("wss:", "https:")));
      await page.goto(site.behind);
      const base = site.behind.replace(/\/\?.*/, "");
      equal(page.url().replace(/\/$/, ""), base, "the token leaves the address, the path stays");
      await Promise.all([page.waitForURL(/\/s\//), page.click(".home .item[href='s/minute.0000']")]);
      await until(
        page,
        () => document.body?.dataset.ready === "1" && document.body?.dataset.connection === "open",
        "the recording",
      );
      await settled(page);
      const id = await panelOf(page, "Camera.Image");
      const lanes = await panelOf(page, "Vad.Speaking");
      await pointAt(page, lanes, 30 * S);
      await until(
        page,
        (i) => document.querySelector(`#${i} canvas`).dataset.at?.length > 9,
        "its images follow the mouse",
        id,
      );
      await page.dblclick("#tree .node[data-stream='Robot.State']");
      await until(page, () => document.getElementById("studio").dataset.edit !== "", "the page's own changes");
      await page.keyboard.press("o");
      await until(page, () => document.querySelectorAll(".keys .btn").length > 40, "the settings");
      await page.click("h1 a");
      await until(page, () => document.querySelector("main.home .item"), "and back to the list");
      await page.goto(`${base}/p/Factory`);
      await until(page, () => document.querySelector(".graph .node"), "the graph of a pipeline");
      await page.click("text=Fold all");
      await until(page, () => location.pathname.endsWith("/lab/studio/p/Factory") && location.search, "its address");
      await page.goto(`${base}/d/study.json`);
      await until(page, () => document.querySelectorAll("#tree .session").length >= 3, "a dataset");
      equal(
        asked.filter((u) => !u.startsWith(base) && !u.startsWith("blob:") && !u.startsWith("data:")),
        [],
        "nothing is requested outside the path",
      );
      await shot("behind-nginx");
    } finally {
      await context.close();
    }
  });
});

// Forwards bytes with a delay: half of the round trip in each direction, and a limited rate towards the browser.
function slow(to, { delay, rate }) {
  const server = createServer((near) => {
    const far = connect(to, "localhost");
    let free = 0;
    near.on("data", (d) => setTimeout(() => far.writable && far.write(d), delay / 2));
    far.on("data", (d) => {
      const now = Date.now();
      free = Math.max(free, now) + (1000 * d.length) / rate;
      setTimeout(() => near.writable && near.write(d), free - now + delay / 2);
    });
    for (const [a, b] of [
      [near, far],
      [far, near],
    ])
      a.on("close", () => setTimeout(() => b.destroy(), delay)).on("error", () => {});
  });
  return new Promise((ready) => server.listen(0, "127.0.0.1", () => ready(server)));
}

test("speed: on a link with 300 ms and 1 MB/s the page appears and shows what is loading", async ({ page }) => {
  const { port } = new URL(site.main);
  const server = await slow(Number(port), { delay: 300, rate: 1e6 });
  try {
    const base = `http://localhost:${server.address().port}`;
    let bytes = 0;
    page.on("response", async (r) => (bytes += Number(r.headers()["content-length"] ?? 0)));
    const started = Date.now();
    await page.goto(`${base}/s/minute.0000`, { waitUntil: "domcontentloaded" });
    await until(page, () => document.querySelector("#tree .node"), "the page");
    const shown = Date.now() - started;
    await open(page, base, "minute.0000");
    await page.goto(`${base}/s/minute.0000`);
    const again = Date.now();
    await until(page, () => document.querySelector(".image-cell canvas")?.dataset.at, "the first image");
    console.log(
      `300 ms, 1 MB/s: page after ${shown} ms, first picture of a page that was there before ` +
        `${Date.now() - again} ms after its HTML, ${(bytes / 1e3).toFixed(0)} kB in all`,
    );
    ok(bytes < 1.5e6, `${bytes} bytes for two pages`);
    equal((await state(page)).mode, "manual", "the page is responsive");
  } finally {
    server.close();
  }
});
