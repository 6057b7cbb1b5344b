// Opens pages of the API site from its folder: axe finds no violations, in light and dark colours, wide and narrow; the
// search finds a function; the colours can be chosen by hand; a page without JavaScript shows its text.
import fs from "node:fs";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { chromium } from "../browser/node_modules/playwright-core/index.mjs";

const here = path.dirname(fileURLToPath(import.meta.url));
const axe = fs.readFileSync(path.join(here, "../browser/node_modules/axe-core/axe.min.js"), "utf8");
const folder = path.resolve(process.argv[2]);
const names = ["index.html", "api/Situ.html", "guides/operators.html", "commands.html", "search.html?q=join"];
const address = (name) => `file://${folder}/${name}`;
const problems = [];
const browser = await chromium.launch({ executablePath: "/usr/bin/chromium", args: ["--no-sandbox"] });

async function checkPage(page, name, look) {
  await page.goto(address(name));
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => window.axe.run());
  for (const { id, nodes } of violations) problems.push(`${name} ${look}: ${id}: ${nodes[0].html.slice(0, 200)}`);
  const wide = await page.evaluate(() => document.documentElement.scrollWidth > document.documentElement.clientWidth);
  if (wide) problems.push(`${name} ${look}: wider than the window`);
}

for (const [colorScheme, width] of [
  ["light", 1280],
  ["dark", 390],
]) {
  const page = await browser.newPage({ colorScheme, viewport: { width, height: 800 } });
  for (const name of names) await checkPage(page, name, `${colorScheme} ${width}`);
  await page.close();
}

const page = await browser.newPage({ colorScheme: "light" });
await page.goto(address("search.html?q=from_enumerable"));
const found = page.locator("#search-results a[href*='api/Situ.html']").first();
await found.waitFor({ timeout: 20000 }).catch(() => problems.push("the search does not find from_enumerable"));
await page.goto(address("index.html"));
for (let clicks = 0; clicks < 3; clicks += 1) {
  if ((await page.evaluate(() => document.body.dataset.theme)) === "dark") break;
  await page.locator(".theme-toggle:visible").first().click();
}
const background = await page.evaluate(() => getComputedStyle(document.body).backgroundColor);
if (Math.max(...background.match(/\d+/g).map(Number)) > 80) problems.push(`dark by hand: ${background}`);

const plain = await browser.newContext({ javaScriptEnabled: false });
const still = await plain.newPage();
await still.goto(address("api/Situ.Store.html"));
const shown = await still.locator("h1").first().isVisible();
const links = await still.locator(".situ-navigation a").count();
if (!shown || links < 200) problems.push(`without JavaScript: heading ${shown}, ${links} links`);

await browser.close();
for (const problem of problems) console.log(problem);
process.exit(problems.length > 0 ? 1 : 0);
