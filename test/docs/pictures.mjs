// Takes the pictures of the guides from the studio of pictures.exs: node pictures.mjs ADDRESS FOLDER.
import { chromium } from "../browser/node_modules/playwright-core/index.mjs";
import { hideHints } from "../browser/harness.mjs";

const [address, folder] = process.argv.slice(2);
const PICTURES = {
  recording: async (page) => {
    await page.goto(`${address}s/walk.0000`);
    await page.waitForFunction(() => document.body.dataset.ready === "1");
    await page.mouse.move(700, 300);
  },
  file: async (page) => {
    await page.goto(`${address}s/talk1.mp4`);
    await page.waitForFunction(() => document.body.dataset.ready === "1");
    await page.waitForTimeout(4000);
    await page.mouse.move(700, 450);
  },
  pipeline: async (page) => {
    await page.goto(`${address}p/Heartbeat`);
    await page.waitForSelector('.graph .node[data-path="Count"]');
    await page.click('.graph .node[data-path="Count"]');
    await page.waitForTimeout(3000);
  },
  errors: async (page) => {
    await page.goto(`${address}p/Division`);
    await page.waitForSelector('.graph .node[data-path="Divide"]');
    await page.click('.graph .node[data-path="Divide"]');
    await page.waitForTimeout(3000);
  },
};

const browser = await chromium.launch({
  executablePath: "/usr/bin/chromium",
  args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
});
for (const [name, show] of Object.entries(PICTURES)) {
  if (!name.includes(process.argv[4] ?? "")) continue;
  const page = await browser.newPage({ viewport: { width: 1100, height: 620 }, colorScheme: "dark" });
  await hideHints(page);
  await show(page);
  await page.waitForTimeout(1500);
  await page.screenshot({ path: `${folder}/guide-${name}.png` });
  await page.close();
}
await browser.close();
