// How a splat stands in the viewers of others: node test_upright.mjs CHROMIUM SPLAT FOLDER. SuperSplat's
// viewer (@playcanvas/supersplat-viewer) and a bare page of Spark (@sparkjsdev/spark) as its examples
// load a file. Pictures go to FOLDER/supersplat.png and FOLDER/spark.png; prints JSON: where in them
// red and blue are, as a share of the height from the top.
import fs from "node:fs";
import http from "node:http";
import path from "node:path";
import { fileURLToPath } from "node:url";
import { openPage, sleep } from "./browser.mjs";

const [chromium, splat, folder] = process.argv.slice(2);
const modules = path.join(path.dirname(fileURLToPath(import.meta.url)), "node_modules");
const KINDS = { ".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".json": "application/json" };
// As Spark's own examples show a file of a 3DGS trainer: turned half round x, for three has y up.
const SPARK = `<!doctype html><style>body { margin: 0 }</style>
<script type="importmap">{"imports": {"three": "/modules/three/build/three.module.js", "three/addons/": "/modules/three/examples/jsm/", "@sparkjsdev/spark": "/modules/@sparkjsdev/spark/dist/spark.module.js"}}</script>
<script type="module">
  import * as THREE from "three";
  import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
  const renderer = new THREE.WebGLRenderer();
  renderer.setSize(innerWidth, innerHeight);
  document.body.append(renderer.domElement);
  const [scene, camera] = [new THREE.Scene(), new THREE.PerspectiveCamera(50, innerWidth / innerHeight, 0.01, 100)];
  camera.position.set(0, 1, 4);
  camera.lookAt(0, 0, 0);
  scene.add(new SparkRenderer({ renderer }));
  const mesh = new SplatMesh({ url: "/splat.ply" });
  mesh.quaternion.set(1, 0, 0, 0);
  scene.add(mesh);
  mesh.initialized.then(() => { window.loaded = true; });
  renderer.setAnimationLoop(() => renderer.render(scene, camera));
</script>`;
const SETTINGS = { camera: { fov: 50, position: null, target: null, startAnim: "none" }, background: { color: [0, 0, 0] }, animTracks: [] };

function find(url) {
  if (url === "/spark.html") return [SPARK, ".html"];
  if (url === "/settings.json") return [JSON.stringify(SETTINGS), ".json"];
  const file = url === "/splat.ply" ? splat
    : url.startsWith("/modules/") ? path.join(modules, url.slice(9))
      : path.join(modules, "@playcanvas/supersplat-viewer/public", url === "/" ? "index.html" : url);
  return [fs.readFileSync(file), path.extname(file)];
}

const server = http.createServer((request, response) => {
  try {
    const [body, kind] = find(decodeURIComponent(request.url.split("?")[0]));
    response.writeHead(200, { "Content-Type": KINDS[kind] ?? "application/octet-stream" }).end(body);
  } catch {
    response.writeHead(404).end();
  }
});
await new Promise((ready) => server.listen(0, "127.0.0.1", ready));
const origin = `http://127.0.0.1:${server.address().port}`;

// Mean heights of red and of blue pixels, and how many there are.
const heights = (page, picture) => page.evaluate(async (url) => {
  const image = new Image();
  image.src = url;
  await image.decode();
  const flat = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height }).getContext("2d");
  flat.drawImage(image, 0, 0);
  const { data } = flat.getImageData(0, 0, image.width, image.height);
  const sums = { red: [0, 0], blue: [0, 0] };
  for (let i = 0; i < data.length; i += 4) {
    const [r, g, b] = [data[i], data[i + 1], data[i + 2]];
    const sum = r > g + 60 && r > b + 60 ? sums.red : b > g + 60 && b > r + 60 ? sums.blue : null;
    if (sum) { sum[0] += Math.floor(i / 4 / image.width) / image.height; sum[1] += 1; }
  }
  return { red: sums.red[0] / sums.red[1], blue: sums.blue[0] / sums.blue[1], pixels: sums.red[1] + sums.blue[1] };
}, `data:image/png;base64,${picture}`);

const report = {};
for (const [name, address] of [["supersplat", `${origin}/?content=/splat.ply&webgl&noui&noanim`], ["spark", `${origin}/spark.html`]]) {
  const { browser, page, errors } = await openPage(chromium, address, { width: 640, height: 480 });
  let found = { pixels: 0 };
  // Loading, sorting and the first frames take seconds where a processor draws them.
  for (let last = -1, i = 0; i < 60 && (found.pixels < 100 || found.pixels !== last); i++) {
    await sleep(1500);
    last = found.pixels;
    const picture = await page.screenshot({ encoding: "base64" });
    found = await heights(page, picture);
    fs.writeFileSync(path.join(folder, `${name}.png`), Buffer.from(picture, "base64"));
    if (i > 8 && found.pixels === last) break;
  }
  report[name] = { ...found, errors };
  await browser.close();
}
server.close();
console.log(JSON.stringify(report));
