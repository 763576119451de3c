// Uses the viewer in headless Chromium as a person would: node test.mjs CHROMIUM ADDRESS FOLDER
// [CAMERA | load] Prints JSON: what worked, how long loading took, what the console said. The
// canvas seen from the camera goes to FOLDER/view.png. With `load` it only loads. `puppeteer-core`
// drives the browser.
import fs from "node:fs";
import path from "node:path";
import { openPage, sleep } from "./browser.mjs";

const [chromium, address, folder, what = "0"] = process.argv.slice(2);
const { browser, page, errors, until } = await openPage(chromium, address, { width: 400, height: 320 });
const client = await page.createCDPSession();
await client.send("Browser.setDownloadBehavior", { behavior: "allow", downloadPath: folder });
await until("!!window.satRecon && (satRecon.ready || satRecon.errors.length > 0)", 120);

const state = (key) => page.evaluate(`satRecon.${key}`);
const shot = () => page.evaluate("document.querySelector('canvas').toDataURL('image/png')");

const frames = async (n) => { for (let i = 0; i < n; i++) await page.evaluate("new Promise(requestAnimationFrame)"); };

// What arrived of what the test did: on a busy machine a wheel turns seconds after it was asked to.
await page.evaluate(() => {
  window.arrived = { wheel: 0, pointerup: 0, keydown: 0, keyup: 0 };
  for (const kind of Object.keys(window.arrived)) window.addEventListener(kind, () => { window.arrived[kind]++; }, true);
});
async function arrives(kind, act) {
  const before = await page.evaluate(`arrived.${kind}`);
  await act();
  await until(`arrived.${kind} > ${before}`, 60);
}

// Sorting and drawing follow each other for a few frames: waits until they are done and pictures
// are equal.
async function settled() {
  let [last, equal] = ["", 0];
  for (let i = 0; i < 200 && equal < 2; i++) {
    await frames(3);
    await sleep(100);
    const now = (await state("isAtRest()")) ? await shot() : "";
    equal = now !== "" && now === last ? equal + 1 : 0;
    last = now;
  }
  return last;
}

// Share of pixels that are not black, and of those that are not grey.
const colours = () => page.evaluate(() => {
  const gl = document.querySelector("canvas");
  const flat = Object.assign(document.createElement("canvas"), { width: gl.width, height: gl.height }).getContext("2d");
  flat.drawImage(gl, 0, 0);
  const data = flat.getImageData(0, 0, gl.width, gl.height).data;
  let [lit, coloured] = [0, 0];
  for (let i = 0; i < data.length; i += 4) {
    const [r, g, b] = [data[i], data[i + 1], data[i + 2]];
    if (r + g + b > 24) lit++;
    if (Math.max(r, g, b) - Math.min(r, g, b) > 8) coloured++;
  }
  return { lit: lit / (data.length / 4), coloured: coloured / (data.length / 4) };
});

// Mean value of the pixels, 0 to 255.
const brightness = () => page.evaluate(() => {
  const gl = document.querySelector("canvas");
  const flat = Object.assign(document.createElement("canvas"), { width: gl.width, height: gl.height }).getContext("2d");
  flat.drawImage(gl, 0, 0);
  const data = flat.getImageData(0, 0, gl.width, gl.height).data;
  let sum = 0;
  for (let i = 0; i < data.length; i += 4) sum += data[i] + data[i + 1] + data[i + 2];
  return sum / (data.length / 4) / 3;
});

async function drag(button, dx, dy) {
  await page.mouse.move(150, 250);
  await page.mouse.down({ button });
  await page.mouse.move(150 + dx, 250 + dy, { steps: 5 });
  await arrives("pointerup", () => page.mouse.up({ button }));
}

const apart = (a, b) => Math.hypot(...a.map((v, i) => v - b[i]));
const distance = (p) => apart(p.position, p.target);

// The pose once the view has come to rest, however slowly frames are drawn.
async function rest() {
  let last = await state("pose()");
  for (let i = 0; i < 300; i++) {
    await frames(1);
    await sleep(20);
    const now = await state("pose()");
    const moved = Math.max(apart(now.position, last.position), apart(now.target, last.target)) / distance(now);
    last = now;
    if (i >= 8 && moved < 1e-3) break; // what was asked for takes a few frames to begin
  }
  return last;
}

// What moves when a person acts: the position, the point looked at, how far it is.
async function movement(act) {
  const before = await rest();
  await act();
  const after = await rest();
  const size = distance(before);
  return {
    position: apart(before.position, after.position) / size,
    target: apart(before.target, after.target) / size,
    distance: distance(after) / size,
  };
}

async function navigation() {
  const orbit = await movement(() => drag("left", 90, 10));
  const pan = await movement(() => drag("right", 60, 20));
  const zoom = await movement(() => arrives("wheel", () => page.mouse.wheel({ deltaY: -240 })));
  const fly = await movement(async () => {
    await arrives("keydown", () => page.keyboard.down("KeyW"));
    await frames(10);
    await arrives("keyup", () => page.keyboard.up("KeyW"));
  });
  return {
    orbit: orbit.position > 0.1 && orbit.target < 1e-3 && Math.abs(orbit.distance - 1) < 1e-2,
    pan: pan.target > 0.02 && Math.abs(pan.position - pan.target) < 1e-2,
    zoom: zoom.distance < 0.97 && zoom.target < 1e-3,
    fly: fly.position > 0.02 && Math.abs(fly.position - fly.target) < 1e-2,
  };
}

async function set(selector, value, event) {
  await page.$eval(selector, (e, v, kind) => {
    e[e.type === "checkbox" ? "checked" : "value"] = v;
    e.dispatchEvent(new Event(kind, { bubbles: true }));
  }, value, event);
}

// The panel of a narrow page lies over the canvas: it is opened for what needs it.
async function withPanel(act) {
  const isHidden = await page.evaluate("document.getElementById('panel').hidden");
  if (isHidden) await page.click("#menu");
  const result = await act();
  if (isHidden) await page.click("#menu");
  return result;
}

async function inputCamera(index) {
  await page.select("#panel select", String(index));
  const view = await settled();
  fs.writeFileSync(path.join(folder, "view.png"), Buffer.from(view.split(",")[1], "base64"));
  await set("#panel input[type=range]", 1, "input");
  await until("document.getElementById('photo').complete", 20);
  const photo = await page.evaluate(() => {
    const [p, c] = ["#photo", "canvas"].map((s) => document.querySelector(s).getBoundingClientRect());
    const image = document.getElementById("photo");
    return !image.hidden && image.naturalWidth > 0 && image.style.opacity === "1" && p.width === c.width && p.height === c.height;
  });
  await set("#panel input[type=range]", 0, "input");
  await withPanel(() => page.click("#panel button[title='Next camera']"));
  const next = await state("view");
  return { jump: next === index + 1, photo };
}

async function toggles() {
  const box = (name) => `#panel input[data-part=${name}]`;
  const switched = async (...changes) => {
    for (const [name, on] of changes) await set(box(name), on, "change");
    await settled();
    return colours();
  };
  const all = await colours();
  const depth = await switched(["depth", true]);
  const none = await switched(["depth", false], ["splat", false]);
  const points = await switched(["points", true]);
  const cameras = await switched(["points", false], ["cameras", true]);
  const again = await switched(["cameras", false], ["splat", true]);
  await set("#panel select[title=Background]", String(0xffffff), "change");
  await settled();
  const white = await colours();
  await set("#panel select[title=Background]", "0", "change");
  await set("#panel input[title^=Exposure]", -3, "input");
  await settled();
  const dark = await brightness();
  await set("#panel input[title^=Exposure]", 0, "input");
  await settled();
  const bright = await brightness();
  const before = await state("pose()");
  await set(box("turn"), true, "change");
  await frames(20);
  const turned = await state("pose()");
  await set(box("turn"), false, "change");
  return {
    background: white.lit > 0.99,
    exposure: dark > 0 && dark < 0.4 * bright,
    turn: apart(before.position, turned.position) > 1e-3 * distance(before) && apart(before.target, turned.target) < 1e-6 * distance(before),
    depth: depth.lit > 0.05 && depth.coloured < 0.2 * all.coloured,
    splat: all.lit > 0.05 && none.lit === 0 && again.coloured > 0.8 * all.coloured,
    points: points.lit > 0,
    cameras: cameras.lit > 0,
  };
}

async function screenshot() {
  const before = new Set(fs.readdirSync(folder));
  await withPanel(() => page.click("#panel button[title='Save a PNG']"));
  return (await downloaded(before, ".png")).subarray(1, 4).toString() === "PNG";
}

// What was saved since there were these files; empty if nothing was.
async function downloaded(before, ending) {
  for (let i = 0; i < 120; i++) {
    await sleep(250);
    const name = fs.readdirSync(folder).find((n) => !before.has(n) && n.endsWith(ending));
    if (name) return fs.readFileSync(path.join(folder, name));
  }
  return Buffer.alloc(0);
}

// Gaussians in a .ply.
const vertices = (ply) => Number(/element vertex (\d+)/.exec(ply.subarray(0, 4096).toString("latin1"))?.[1]);

// The crop box hides what is outside, and a handle moves its side; what is left is saved by the
// server, or said as a command.
async function cutting() {
  await withPanel(() => page.click("#panel button[title='Back to the start']"));
  await settled();
  const all = await colours();
  await set("#panel input[title='Crop box']", true, "change");
  await settled();
  const half = "[title='y high']";
  const [low, high] = await page.evaluate((s) => { const i = document.querySelector(s); return [Number(i.min), Number(i.max)]; }, half);
  await set(half, low + 0.4 * (high - low), "input");
  await settled();
  const some = await colours();
  const before = await page.evaluate((s) => document.querySelector(s).value, half);
  const at = await state("handle(1, 'high')");
  await page.mouse.move(at.x, at.y);
  await page.mouse.down();
  await page.mouse.move(at.x + 25, at.y + 25, { steps: 4 });
  await arrives("pointerup", () => page.mouse.up());
  const after = await page.evaluate((s) => document.querySelector(s).value, half);
  const report = { crop: some.coloured < 0.9 * all.coloured, handle: before !== after };
  if (await page.evaluate("!!document.querySelector(\"[title='Save what is left']\")")) {
    const files = new Set(fs.readdirSync(folder));
    await withPanel(() => page.click("[title='Save what is left']"));
    report.left = vertices(await downloaded(files, ".ply"));
    const shown = await state("splats");
    await set("#panel input[title^=Floaters]", 1, "change");
    await until(`satRecon.splats > ${shown}`, 60);
    await set("#panel input[title^=Floaters]", 0, "change");
    await until(`satRecon.splats > ${shown + 1}`, 60);
  } else {
    report.command = await page.evaluate("document.querySelector('#panel code').textContent");
  }
  await set("#panel input[title='Crop box']", false, "change");
  await settled();
  return report;
}

// Elements and code that no page of ours has: a name out of a file would have made them.
const foreign = await page.evaluate("document.querySelectorAll('[onerror], [onload], script[src*=\"//\"], iframe').length + (window.hacked ? 1 : 0)");
const report = { loadMs: await state("loadMs"), foreign };
if (what !== "load" && (await state("ready"))) {
  await settled();
  Object.assign(report, await navigation(), await inputCamera(Number(what)), await toggles(), await cutting(), { screenshot: await screenshot() });
}
report.errors = [...errors, ...(await state("errors"))];
console.log(JSON.stringify(report));
await browser.close();
