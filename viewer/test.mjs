// Opens the viewer in headless Chromium and looks at it: node test.mjs CHROMIUM ADDRESS OUT.png [CAMERA]
// Prints JSON: load time, errors, and where the canvas was saved. `puppeteer-core` drives the browser.
import fs from "node:fs";
import puppeteer from "puppeteer-core";

const [chromium, address, out, camera = "0"] = process.argv.slice(2);
const browser = await puppeteer.launch({
  executablePath: chromium,
  args: ["--no-sandbox", "--disable-dev-shm-usage", "--disable-background-networking",
    "--enable-unsafe-swiftshader"],
});
const page = await browser.newPage();
const errors = [];
page.on("console", (m) => { if (m.type() === "error") errors.push(m.text()); });
page.on("pageerror", (e) => errors.push(String(e)));
const { width, height } = { width: 400, height: 320 };
await page.setViewport({ width, height });
await page.goto(address, { timeout: 120000 });
await page.waitForFunction("window.satRecon && (satRecon.ready || satRecon.errors.length > 0)", { timeout: 120000 });
const shot = async () => {
  // Sorting and drawing follow each other for a few frames.
  await new Promise((r) => setTimeout(r, 1500));
  return page.evaluate("document.querySelector('canvas').toDataURL('image/png')");
};
const free = await shot();
await page.evaluate(`satRecon.goTo(${Number(camera)})`);
const view = await shot();
fs.writeFileSync(out, Buffer.from(view.split(",")[1], "base64"));
await page.evaluate("satRecon.orbit(0.5)");
const turned = await shot();
const state = await page.evaluate("({ loadMs: satRecon.loadMs, errors: satRecon.errors })");
console.log(JSON.stringify({ loadMs: state.loadMs, errors: [...errors, ...state.errors], turns: turned !== view, free: free.length }));
await browser.close();
