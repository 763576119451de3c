// Looks on while a run works: node test_live.mjs CHROMIUM ADDRESS FOLDER. Prints JSON: what was seen
// of the run, in which order. Pictures of the page on a desktop and on a phone go to FOLDER.
import path from "node:path";
import { openPage, sleep } from "./browser.mjs";

const [chromium, address, folder] = process.argv.slice(2);
const SIZES = { desktop: { width: 1280, height: 800 }, phone: { width: 390, height: 844 } };
const LONGEST = 600_000; // ms
const { browser, page, errors } = await openPage(chromium, address, SIZES.desktop);

async function picture(name) {
  for (const [device, size] of Object.entries(SIZES)) {
    await page.setViewport(size);
    await sleep(1500);
    await page.screenshot({ path: path.join(folder, `${name}_${device}.png`) });
  }
  await page.setViewport(SIZES.desktop);
}

const look = () => page.evaluate(() => {
  const { run, splats, cameras } = window.satRecon; // the page is never loaded again
  const loaded = (kind) => [...document.querySelectorAll(`#strip img[src^=${kind}]`)].filter((i) => i.complete && i.naturalWidth > 0).length;
  return {
    status: run?.status ?? {}, splats, cameras: cameras(), frames: loaded("frame"), mattes: loaded("matte"),
    posed: document.querySelectorAll("#strip .posed").length, stage: document.getElementById("stage").textContent,
    verdict: document.getElementById("verdict").textContent, report: document.getElementById("report")?.getAttribute("href"),
  };
});

const seen = { stages: [], frames: 0, mattes: 0, camerasBeforeSplat: 0, fewestCameras: 0, posed: 0, splatsWhileTraining: 0 };
const taken = new Set();
const once = async (name) => { if (!taken.has(name)) { taken.add(name); await picture(name); } };
let now = await look();
for (const end = Date.now() + LONGEST; Date.now() < end && !now.status.end; await sleep(300)) {
  now = await look();
  const stage = now.status.place?.number ?? 0;
  if (stage > 0 && !seen.stages.includes(stage)) seen.stages.push(stage);
  for (const kind of ["frames", "mattes", "posed"]) seen[kind] = Math.max(seen[kind], now[kind]);
  if (now.cameras > 0 && now.splats === 0) {
    seen.camerasBeforeSplat = Math.max(seen.camerasBeforeSplat, now.cameras);
    seen.fewestCameras = Math.min(seen.fewestCameras || now.cameras, now.cameras);
    if (stage >= 3 || now.cameras < now.status.frames) await once("poses");
  }
  if (now.status.what === "train" && now.status.done < now.status.total) seen.splatsWhileTraining = Math.max(seen.splatsWhileTraining, now.splats);
  if (now.mattes > 3) await once("mattes");
  if (now.splats > 0) await once("training");
}
for (let i = 0; i < 60 && (await look()).splats <= seen.splatsWhileTraining; i++) await sleep(500);
now = await look();
await picture("end");
const report = await page.evaluate(async () => (await fetch("report.html")).status);
console.log(JSON.stringify({ ...seen, ended: Boolean(now.status.end), verdict: now.verdict, splats: now.splats, report, link: now.report, errors: [...errors, ...(await page.evaluate("satRecon.errors"))] }));
await browser.close();
