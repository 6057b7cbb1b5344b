// Takes the pictures of the guides from the studio of pictures.exs: node pictures.mjs ADDRESS FOLDER.
import { chromium } from "../browser/node_modules/playwright-core/index.mjs";
import { hideHints } from "../browser/harness.mjs";

const [json, folder, only = ""] = process.argv.slice(2);
const { main, linked, guarded, counter, failure, notebook } = JSON.parse(json);

const ready = (page) => page.waitForFunction(() => document.body.dataset.ready === "1");

/**
 * Opens a recording and moves the mouse to a position of the window.
 * @param {import("playwright-core").Page} page
 */
async function openRecording(page, name, x = 700, y = 450) {
  await page.goto(`${main}s/${name}`);
  await ready(page);
  await page.waitForTimeout(3000);
  await page.mouse.move(x, y);
}

// Opens the graph of a pipeline and selects a component.
async function openGraph(page, name, component) {
  await page.goto(`${main}p/${name}`);
  const node = `.graph .node[data-path="${component}"]`;
  await page.waitForSelector(node);
  await page.click(node);
  await page.waitForTimeout(4000);
}

// Shows text that a program has printed.
async function showText(page, text) {
  await page.setContent("<pre></pre>");
  await page.evaluate((lines) => {
    const pre = document.querySelector("pre");
    if (!pre) return;
    pre.textContent = lines;
    document.body.style.cssText = "margin:0;background:#0e1217;color:#dbe1e9";
    pre.style.cssText = "margin:24px;font:13px/1.5 'DejaVu Sans Mono',monospace;white-space:pre-wrap";
  }, text);
}

const PICTURES = {
  recording: (page) => openRecording(page, "walk.0000", 700, 300),
  file: (page) => openRecording(page, "talk1.mp4"),
  pipeline: (page) => openGraph(page, "Heartbeat", "Count"),
  errors: (page) => openGraph(page, "Division", "Divide"),
  component: (page) => openGraph(page, "Turns", "Turns"),
  genstage: (page) => openGraph(page, "Queue", "Orders"),
  operators: (page) => openRecording(page, "operators.0000", 700, 300),
  colours: (page) => openRecording(page, "colours.0000", 700, 450),
  python: (page) => openRecording(page, "detector.0000", 620, 450),
  chat: async (page) => {
    await page.setViewportSize({ width: 1100, height: 300 });
    await openRecording(page, "chat.0000", 700, 110);
  },
  bag: (page) => openRecording(page, "drive.bag", 700, 450),
  heat: async (page) => {
    await openRecording(page, "gaze");
    await page.evaluate(() => document.querySelector('[data-stream="Gaze.Point"] .name')?.click());
    await page.click('.props button[phx-value-viz="gaze-heat-map/heat"]');
    await page.waitForTimeout(1000);
    await page.evaluate(() => window.situStudio.time.dispatch({ type: "cursor", t: 8e9 }));
    await page.waitForTimeout(2000);
  },
  experiments: async (page) => {
    await page.setViewportSize({ width: 1400, height: 860 });
    await page.goto(`${main}x/experiment/study.json?set=7&over=min_silence`);
    await page.waitForSelector("#sets tbody tr");
  },
  difference: async (page) => {
    await page.setViewportSize({ width: 1400, height: 760 });
    await page.goto(`${main}x/experiment/study.json`);
    await page.click("#set-7 .cell");
    await ready(page);
    await page.waitForTimeout(4000);
    await page.keyboard.press("n");
    await page.waitForTimeout(500);
    await page.keyboard.press("n");
  },
  notebook: async (page) => {
    await page.setViewportSize({ width: 900, height: 180 });
    await page.emulateMedia({ colorScheme: "light" });
    await page.setContent(`<body style="margin:24px;font:13px sans-serif">${notebook}</body>`);
  },
  links: async (page) => {
    await page.setViewportSize({ width: 1100, height: 340 });
    await page.goto(linked);
    await page.waitForTimeout(4000);
  },
  token: async (page) => {
    await page.setViewportSize({ width: 700, height: 400 });
    await page.goto(guarded);
  },
  view: async (page) => {
    await page.setViewportSize({ width: 700, height: 300 });
    await page.goto(counter);
    await page.waitForSelector("[data-phx-main].phx-connected");
    for (const id of ["#add10", "#add1", "#add1"]) await page.click(id);
  },
  cluster: async (page) => {
    await page.setViewportSize({ width: 1100, height: 380 });
    await page.goto(`${main}cluster`);
    await page.waitForTimeout(8000);
  },
  metrics: async (page) => {
    const text = await (await page.request.get(`${main}metrics`)).text();
    const lines = text.split("\n").filter((line) => /situ_(queue|latency)/.test(line) && !line.includes("Hall"));
    await showText(
      page,
      ["$ curl http://localhost:4040/metrics | grep 'situ_queue\\|situ_latency'", ...lines.slice(0, 26)].join("\n"),
    );
  },
  simulation: (page) => showText(page, failure),
};

const annotate = async (page, layer) => {
  await page.goto(`${main}s/study.json/p01?annotate=${layer}`);
  await page.waitForFunction(() => window.situStudio?.annotation?.state.items.length > 0);
  await page.waitForTimeout(3000);
};
Object.assign(PICTURES, {
  transcription: async (page) => {
    await annotate(page, "Talk");
    await page.evaluate(() => (window.situStudio.annotation.track = "English"));
    await page.focus("#annotation-body");
    await page.keyboard.press("T");
    await page.waitForSelector(".transcription li.now");
    await page.keyboard.press("Enter");
    await page.keyboard.type("I think that it works");
  },
  agreement: async (page) => {
    await annotate(page, "Turn.Ada");
    await page.click(".annotation-tools button:text('All annotators')");
    await page.waitForFunction(() => window.situStudio.annotation.merged.data.segments.length > 0);
    await page.focus("#annotation-body");
    await page.keyboard.press("d");
  },
  search: async (page) => {
    await page.goto(`${main}d/study.json`);
    await page.click(".topbar button:text('Find times')");
    await page.fill("#session-search textarea", "'A' in `Turn.Ada` and not 'A' in `Turn.Ben`");
    await page.fill("#session-search input[name=least]", "50ms");
    await page.click("#session-search .primary");
    await page.waitForSelector("#session-search a.hit");
  },
});

const browser = await chromium.launch({
  executablePath: "/usr/bin/chromium",
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
for (const [name, show] of Object.entries(PICTURES)) {
  if (!only.split("|").some((word) => name.includes(word))) continue;
  const page = await browser.newPage({ viewport: { width: 1100, height: 620 }, colorScheme: "dark" });
  await hideHints(page);
  await show(page);
  await page.waitForTimeout(1500);
  await page.screenshot({ path: `${folder}/guide-${name}.png` });
  await page.close();
}
await browser.close();
