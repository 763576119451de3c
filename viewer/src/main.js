// The splat of a run in a browser: orbit, fly, jump between the input cameras, compare with their
// photos.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { SparkRenderer } from "@sparkjsdev/spark";
import { applyIntrinsics, poseOf, worldOf } from "./cameras.js";
import { cameraLines, pointCloud } from "./overlays.js";
import { loadSplat } from "./splat.js";
import { buildPanel } from "./panel.js";
import { Flight } from "./flight.js";

const data = JSON.parse(document.getElementById("scene").textContent);
const state = { view: -1, dirty: true, ready: false, errors: [] };
window.satRecon = state; // what tests wait for

window.addEventListener("error", (e) => state.errors.push(String(e.message)));
window.addEventListener("unhandledrejection", (e) => fail(e.reason));

const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setClearColor(0x000000, 1);
document.getElementById("canvas").append(renderer.domElement);

const scene = new THREE.Scene();
// The low-pass of 0.3 px² and the order by depth that the splat was trained with; after
// `blurAmount` Spark scales the opacity.
const [preBlurAmount, blurAmount] = data.antialias ? [0.0, 0.3] : [0.3, 0.0];
const spark = new SparkRenderer({
  renderer, preBlurAmount, blurAmount, sortRadial: false, maxStdDev: 3.33, minAlpha: 1 / 255,
  onDirty: () => { state.dirty = true; },
});
scene.add(spark);

const FIELD = 50; // degrees, of the narrow side
const camera = new THREE.PerspectiveCamera(FIELD, 1, 0.01, 1000);
const centre = new THREE.Vector3(); // of what the cameras look at
camera.up.set(...data.up);
camera.near = data.radius * 1e-3;
camera.far = data.radius * 100;
const controls = new OrbitControls(camera, renderer.domElement);
controls.enableDamping = !window.matchMedia("(prefers-reduced-motion: reduce)").matches;
controls.addEventListener("change", () => { state.dirty = true; });
controls.addEventListener("start", () => leaveView());
const flight = new Flight(camera, controls, data.radius, () => { leaveView(); state.dirty = true; });

const points = pointCloud(data.points);
const frusta = cameraLines(data.cameras, data.radius);
scene.add(points, frusta);

const photo = document.getElementById("photo");
const panel = buildPanel(data, {
  view: (i) => goTo(i),
  toggle: (name, on) => { parts[name]((state.dirty = true) && on); },
  opacity: (value) => { photo.style.opacity = value; },
  background: (colour) => { renderer.setClearColor(colour, 1); state.dirty = true; },
  exposure: (stops) => { splat?.setExposure(stops); state.dirty = true; },
  fullScreen,
  screenshot,
  reset: () => start(),
});
let splat = null;
const parts = {
  splat: (on) => { if (splat) splat.mesh.visible = on; },
  points: (on) => { points.visible = on; },
  cameras: (on) => { frusta.visible = on; },
  depth: (on) => { splat?.showDepth(on); },
  turn: (on) => { if (on) leaveView(); controls.autoRotate = on; },
};

function fail(reason) {
  const text = String(reason?.message ?? reason);
  state.errors.push(text);
  document.getElementById("status").textContent = `Cannot show the splat: ${text}`;
}

function resize() {
  const [w, h] = [window.innerWidth, window.innerHeight];
  renderer.setPixelRatio(state.view < 0 ? window.devicePixelRatio : 1);
  const shown = state.view < 0 ? { width: w, height: h } : fit(data.cameras[state.view], w, h);
  renderer.setSize(shown.width, shown.height);
  photo.style.width = `${shown.width}px`;
  photo.style.height = `${shown.height}px`;
  camera.aspect = w / h;
  // The narrow side sees as much on a phone held upright as on a desktop.
  const half = Math.tan((FIELD / 2) * (Math.PI / 180)) / Math.min(1, camera.aspect);
  camera.fov = 2 * Math.atan(half) * (180 / Math.PI);
  if (state.view < 0) camera.updateProjectionMatrix();
  else applyIntrinsics(camera, data.cameras[state.view]);
  state.dirty = true;
}

// An input camera is shown in its own shape, at its own size where the window allows.
function fit(view, width, height) {
  const scale = Math.min(1, width / view.width, height / view.height);
  return { width: Math.round(view.width * scale), height: Math.round(view.height * scale) };
}

function start() {
  leaveView();
  const first = worldOf(data.cameras[0]);
  camera.position.copy(first.position);
  controls.target.copy(centre);
  controls.update();
  resize();
}

function goTo(index) {
  const count = data.cameras.length;
  state.view = ((index % count) + count) % count;
  const view = data.cameras[state.view];
  poseOf(view, camera);
  const forward = new THREE.Vector3(0, 0, -1).applyQuaternion(camera.quaternion);
  controls.target.copy(camera.position).addScaledVector(forward, camera.position.distanceTo(centre));
  photo.src = view.photo ?? "";
  photo.hidden = !view.photo;
  panel.showView(state.view);
  resize();
}

function leaveView() {
  if (state.view < 0) return;
  state.view = -1;
  photo.hidden = true;
  panel.showView(-1);
  resize();
}

// A phone may refuse it; then everything stays as it is.
function fullScreen() {
  const asked = document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen?.();
  asked?.catch(() => {});
}

function screenshot() {
  draw();
  const link = document.createElement("a");
  link.download = `${data.title}.png`;
  link.href = renderer.domElement.toDataURL("image/png");
  link.click();
}

function draw() {
  renderer.render(scene, camera);
}

// At rest the controls still move the camera by their rounding, and every new pose is sorted and
// drawn anew, for ever.
function follow(seconds) {
  const [position, quaternion] = [camera.position.clone(), camera.quaternion.clone()];
  if (controls.update(seconds)) return;
  camera.position.copy(position);
  camera.quaternion.copy(quaternion);
}

let previous = performance.now();
function loop(now) {
  const seconds = Math.min(0.1, (now - previous) / 1000);
  previous = now;
  flight.step(seconds);
  if (state.view < 0) follow(seconds);
  if (splat?.follow(camera)) state.dirty = true;
  if (state.dirty) {
    state.dirty = false;
    draw();
  }
  requestAnimationFrame(loop);
}

// Nothing is left to be sorted or drawn.
state.isAtRest = () => !state.dirty && !spark.sorting && !spark.sortDirty;
state.pose = () => ({ position: camera.position.toArray(), target: controls.target.toArray() });
window.addEventListener("resize", resize);
start();
requestAnimationFrame(loop);
loadSplat(data, camera).then((loaded) => {
  splat = loaded;
  scene.add(splat.mesh);
  state.loadMs = performance.now(); // since the address was opened
  state.ready = true;
  state.dirty = true;
  document.getElementById("status").textContent = "";
}).catch(fail);
