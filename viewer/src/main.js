// The splat of a run in a browser: orbit, fly, jump between the input cameras, compare with their
// photos.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { SparkRenderer } from "@sparkjsdev/spark";
import { applyIntrinsics, poseOf, worldOf } from "./cameras.js";
import { cameraLines, pointCloud } from "./overlays.js";
import { SplatLook } from "./splat.js";
import { buildPanel, make } from "./panel.js";
import { Cut } from "./cut.js";
import { Live } from "./live.js";
import { Flight } from "./flight.js";
import { Joints } from "./joints.js";

let data = JSON.parse(document.getElementById("scene").textContent);
const { served, live } = document.currentScript.dataset;
const state = { view: -1, dirty: true, ready: false, splats: 0, errors: [] };
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
controls.addEventListener("start", () => { moved = true; leaveView(); });
const flight = new Flight(camera, controls, data.radius, () => { leaveView(); state.dirty = true; });

let look; // made once there is something that moves it
const photo = document.getElementById("photo");
const joints = new Joints(data.parts, () => {
  look?.mesh?.updateVersion();
  state.dirty = true;
});
look = new SplatLook(joints);
const shown = { splat: true, points: false, cameras: false };
let [points, frusta] = [new THREE.Group(), new THREE.Group()];
let moved = false; // by a person
let splatUrl; // of the whole splat; the page's own has none
const parts = {
  splat: () => { if (look.mesh) look.mesh.visible = shown.splat; },
  points: () => { points.visible = shown.points; },
  cameras: () => { frusta.visible = shown.cameras; },
  depth: (on) => look.showDepth(on),
  turn: (on) => { if (on) leaveView(); controls.autoRotate = on; },
};
const cut = new Cut({
  scene, camera, canvas: renderer.domElement, served: served !== undefined, fail,
  changed: (box) => { look.crop(box); state.dirty = true; },
  showFloaters: (url) => showSplat(url ?? splatUrl),
});
const panel = buildPanel({
  view: (i) => goTo(i),
  toggle,
  opacity: (value) => { photo.style.opacity = value; },
  background: (colour) => { renderer.setClearColor(colour, 1); state.dirty = true; },
  exposure: (stops) => { look.setExposure(stops); state.dirty = true; },
  cutControls: cut.controls,
  jointControls: joints.controls(),
  fullScreen,
  screenshot,
  reset: () => start(),
});

function toggle(name, on) {
  if (name in shown) shown[name] = on;
  parts[name](on);
  state.dirty = true;
}

// Shows a part without being asked to.
function show(name, on) {
  panel.showPart(name, on);
  toggle(name, on);
}

// Cameras and points, at the beginning or anew.
function setScene(next) {
  data = next;
  for (const part of [points, frusta]) {
    scene.remove(part);
    part.geometry?.dispose();
    part.material?.dispose();
  }
  points = pointCloud(data.points);
  frusta = cameraLines(data.cameras, data.radius);
  scene.add(points, frusta);
  for (const name of ["points", "cameras"]) parts[name]();
  camera.up.set(...data.up);
  look.setRange(data.near, data.far);
  if (state.view >= data.cameras.length) leaveView();
  panel.setCameras(data.cameras, state.view);
  if (state.view >= 0) photo.src = data.cameras[state.view].photo ?? "";
  cut.setScene(data);
  state.dirty = true;
}

// The splat at an address (the page's own without one) in place of the one before.
async function showSplat(url) {
  const mesh = await look.load(url);
  const before = look.mesh;
  look.mesh = mesh;
  scene.add(mesh);
  if (before) {
    scene.remove(before);
    before.dispose();
  }
  parts.splat();
  state.splats += 1;
  state.dirty = true;
}

// From above the first camera, far enough back to see all of them.
function overview() {
  const first = worldOf(data.cameras[0]).position;
  const up = new THREE.Vector3(...data.up);
  const far = Math.max(...data.cameras.map((view) => worldOf(view).position.length()));
  const away = first.clone().projectOnPlane(up).normalize();
  camera.position.copy(away.multiplyScalar(2.1 * far).addScaledVector(up, 1.1 * far));
  controls.target.copy(centre);
  controls.update();
}

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
  moved = false;
  if (data.cameras.length === 0) return;
  const first = worldOf(data.cameras[0]);
  camera.position.copy(first.position);
  controls.target.copy(centre);
  controls.update();
  resize();
}

function goTo(index) {
  const count = data.cameras.length;
  if (count === 0) return;
  moved = true;
  state.view = ((index % count) + count) % count;
  const view = data.cameras[state.view];
  poseOf(view, camera);
  const forward = new THREE.Vector3(0, 0, -1).applyQuaternion(camera.quaternion);
  controls.target.copy(camera.position).addScaledVector(forward, camera.position.distanceTo(centre));
  joints.setFrame(view.time_frame ?? -1);
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
  if (look.follow(camera)) state.dirty = true;
  if (state.dirty) {
    state.dirty = false;
    draw();
  }
  requestAnimationFrame(loop);
}

// Nothing is left to be sorted or drawn.
state.isAtRest = () => !state.dirty && !spark.sorting && !spark.sortDirty;
state.cameras = () => data.cameras.length;
state.joints = joints;
state.handle = (axis, end) => cut.handle(axis, end);
state.pose = () => ({ position: camera.position.toArray(), target: controls.target.toArray() });
window.addEventListener("resize", resize);
const head = document.getElementById("head");
head.firstElementChild.textContent = data.title;
head.firstElementChild.title = data.title;
if (data.report) head.append(make("a", { id: "report", href: data.report, textContent: "report" }));
resize();
setScene(data);
start();
requestAnimationFrame(loop);

// The first splat is seen from where the first photo was taken.
async function firstSplat(url) {
  const first = !look.mesh;
  splatUrl = url;
  await showSplat(url);
  if (!first) return;
  document.getElementById("status").textContent = "";
  if (Number(live) === 1) {
    for (const name of ["points", "cameras"]) show(name, false);
    if (!moved) start();
  }
  state.loadMs = performance.now(); // since the address was opened
  state.ready = true;
}

if (Number(live) === 1) {
  const status = document.getElementById("status");
  status.textContent = data.cameras.length ? "" : "Cameras and points appear here as they are found.";
  const run = new Live({
    goTo,
    newSplat: firstSplat,
    newScene: (next) => {
      setScene(next);
      if (!next.cameras.length) return;
      status.textContent = "";
      if (look.mesh) return;
      for (const name of ["points", "cameras"]) show(name, true);
      if (!moved) overview();
    },
  });
  state.run = run;
} else {
  firstSplat(data.splat?.url).catch(fail);
}
