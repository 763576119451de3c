// Headless Chromium for the tests of the viewer: launches it, collects what goes wrong, waits.
import puppeteer from "puppeteer-core";

export const sleep = (ms) => new Promise((r) => setTimeout(r, ms));

// A page at an address that fetches nothing from elsewhere; errors are collected.
export async function openPage(chromium, address, viewport) {
  const browser = await puppeteer.launch({
    executablePath: chromium,
    args: ["--no-sandbox", "--disable-dev-shm-usage", "--disable-background-networking", "--disable-component-update",
      "--disable-sync", "--no-first-run", "--enable-unsafe-swiftshader"],
  });
  const page = await browser.newPage();
  const errors = [];
  page.on("console", (m) => { if (m.type() === "error") errors.push(m.text()); });
  page.on("pageerror", (e) => errors.push(String(e)));
  page.on("request", (r) => { if (/^https?:/.test(r.url()) && !r.url().startsWith(new URL(address).origin)) errors.push(`fetches ${r.url()}`); });
  await page.setViewport(viewport);
  // Without the glide after every movement, whose hundred frames take minutes where a processor
  // draws them.
  await page.emulateMediaFeatures([{ name: "prefers-reduced-motion", value: "reduce" }]);
  await page.goto(address, { timeout: 120000 });
  // Asked by the debugger: the page's policy forbids the strings that `waitForFunction` compiles.
  const until = async (expression, seconds) => {
    for (const end = Date.now() + 1000 * seconds; Date.now() < end; await sleep(50)) {
      if (await page.evaluate(expression)) return;
    }
    throw new Error(`not true within ${seconds} s: ${expression}`);
  };
  return { browser, page, errors, until };
}
