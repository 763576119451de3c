// Pictures of the report and the viewer: node tutorial_pages.mjs CHROMIUM REPORT.html VIEW.html
// FOLDER
import path from "node:path";
import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const viewer = process.env.VIEWER ?? path.join(import.meta.dirname, "../viewer");
const puppeteer = createRequire(path.join(path.resolve(viewer), "package.json"))("puppeteer-core");
const [chromium, report, view, folder] = process.argv.slice(2);
const browser = await (puppeteer.default ?? puppeteer).launch({
  executablePath: chromium,
  args: ["--no-sandbox", "--disable-dev-shm-usage", "--no-first-run", "--enable-unsafe-swiftshader"],
});
const page = await browser.newPage();
await page.emulateMediaFeatures([{ name: "prefers-reduced-motion", value: "reduce" }]);

// Parts of the report, each from one heading to the next.
await page.setViewport({ width: 960, height: 900 });
await page.goto(pathToFileURL(report).href);
await new Promise((r) => setTimeout(r, 3000));
const tops = await page.evaluate(() =>
  [...document.querySelectorAll("h2")].map((h) => [h.textContent, h.getBoundingClientRect().top + scrollY]));
const top = (text) => tops.find(([name]) => name.startsWith(text))?.[1] ?? 0;
const parts = [
  ["verdict", 0, top("What was")],
  ["decisions", top("What was"), top("Frames")],
  ["poses", top("Poses"), top("Poses") + 1000],
];
for (const [name, from, to] of parts) {
  const clip = { x: 0, y: from, width: 960, height: to - from };
  await page.screenshot({ path: path.join(folder, `${name}.png`), clip, captureBeyondViewport: true });
}

// The viewer, once the splat is loaded and drawn.
await page.setViewport({ width: 900, height: 560 });
await page.goto(pathToFileURL(view).href);
const ready = "window.satRecon && (satRecon.ready || satRecon.errors.length > 0)";
await page.waitForFunction(ready, { timeout: 120000 });
for (let i = 0; i < 100 && !(await page.evaluate("satRecon.isAtRest()")); i++) await new Promise((r) => setTimeout(r, 300));
await page.screenshot({ path: path.join(folder, "viewer.png") });
await browser.close();
