// The report's moving parts: cameras and points to turn, and photo against render. No other script
// is needed.
"use strict";

// Bytes of a base64 text.
const bytesOf = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

// Cameras and points on a canvas: drag turns, wheel or two fingers zoom, a tap names a camera, a
// double tap starts anew.
function poseView(canvas, data) {
  const points = new Int16Array(bytesOf(data.points).buffer);
  const colours = bytesOf(data.colours);
  const count = points.length / 3;
  const start = { yaw: 0.6, pitch: 0.45, zoom: 1.35 };
  const view = { ...start, picked: -1 };
  const context = canvas.getContext("2d");
  const label = canvas.parentElement.querySelector("output");
  let size = [1, 1];
  let pending = false;

  // Screen x, y and depth of a point: a turntable about the vertical axis, seen from a little
  // above.
  function project(x, y, z) {
    const [cy, sy, cp, sp] = [Math.cos(view.yaw), Math.sin(view.yaw), Math.cos(view.pitch), Math.sin(view.pitch)];
    const [right, back] = [cy * x - sy * y, sy * x + cy * y];
    const [up, depth] = [cp * z - sp * back, sp * z + cp * back];
    const scale = (0.46 * Math.min(...size) * view.zoom * 4) / (4 - depth);
    return [size[0] / 2 + right * scale, size[1] / 2 - up * scale, depth];
  }

  function draw() {
    pending = false;
    const ratio = window.devicePixelRatio || 1;
    size = [canvas.clientWidth * ratio, canvas.clientHeight * ratio].map(Math.round);
    if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
    context.fillStyle = "#101418";
    context.fillRect(0, 0, ...size);
    const order = new Array(count);
    for (let i = 0; i < count; i++) {
      const p = project(points[3 * i] / 16383, points[3 * i + 1] / 16383, points[3 * i + 2] / 16383);
      order[i] = [p[2], p[0], p[1], i];
    }
    order.sort((a, b) => a[0] - b[0]);
    const dot = Math.max(1, Math.round(1.6 * ratio));
    for (const [, x, y, i] of order) {
      // Dark objects stay visible on the dark ground.
      const lift = (c) => 60 + Math.round((c * 195) / 255);
      context.fillStyle = `rgb(${lift(colours[3 * i])},${lift(colours[3 * i + 1])},${lift(colours[3 * i + 2])})`;
      context.fillRect(x, y, dot, dot);
    }
    data.cameras.forEach((camera, i) => drawCamera(camera, i === view.picked, ratio));
  }

  function drawCamera(camera, picked, ratio) {
    const corners = [];
    for (let k = 0; k < 5; k++) corners.push(project(...camera.corners.slice(3 * k, 3 * k + 3)));
    camera.at = corners[0];
    context.strokeStyle = picked ? "#fff" : { held: "#ff9f1c", weak: "#ff4d4d" }[camera.kind] || "#4da3ff";
    context.lineWidth = (picked ? 2 : 1) * ratio;
    context.beginPath();
    for (let k = 1; k < 5; k++) {
      context.moveTo(corners[0][0], corners[0][1]);
      context.lineTo(corners[k][0], corners[k][1]);
      context.lineTo(corners[(k % 4) + 1][0], corners[(k % 4) + 1][1]);
    }
    context.stroke();
  }

  function redraw() {
    if (!pending) requestAnimationFrame(draw);
    pending = true;
  }

  function pick(event) {
    const box = canvas.getBoundingClientRect();
    const ratio = size[0] / box.width;
    const [x, y] = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
    const distance = (c) => Math.hypot(c.at[0] - x, c.at[1] - y);
    let best = -1;
    data.cameras.forEach((c, i) => { if (best < 0 || distance(c) < distance(data.cameras[best])) best = i; });
    view.picked = best >= 0 && distance(data.cameras[best]) < 24 * ratio ? best : -1;
    label.textContent = view.picked < 0 ? "" : data.cameras[view.picked].text;
    redraw();
  }

  const fingers = new Map();
  let moved = 0;
  canvas.addEventListener("pointerdown", (e) => {
    canvas.setPointerCapture(e.pointerId);
    fingers.set(e.pointerId, e);
    if (fingers.size === 1) moved = 0;
  });
  canvas.addEventListener("pointermove", (e) => {
    const before = fingers.get(e.pointerId);
    if (!before) return;
    const other = [...fingers.values()].find((f) => f.pointerId !== e.pointerId);
    const [dx, dy] = [e.clientX - before.clientX, e.clientY - before.clientY];
    if (other) {
      const apart = (f) => Math.hypot(f.clientX - other.clientX, f.clientY - other.clientY);
      zoom(apart(e) / Math.max(1, apart(before)));
    } else {
      view.yaw += dx * 0.01;
      view.pitch = Math.max(-1.57, Math.min(1.57, view.pitch + dy * 0.01));
    }
    moved += Math.abs(dx) + Math.abs(dy);
    fingers.set(e.pointerId, e);
    redraw();
  });
  const lift = (e) => { if (fingers.delete(e.pointerId) && e.type === "pointerup" && moved < 6) pick(e); };
  canvas.addEventListener("pointerup", lift);
  canvas.addEventListener("pointercancel", lift);
  canvas.addEventListener("dblclick", () => { Object.assign(view, start); redraw(); });
  canvas.addEventListener("wheel", (e) => { e.preventDefault(); zoom(Math.exp(-e.deltaY * 0.001)); }, { passive: false });
  canvas.addEventListener("keydown", (e) => {
    const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[e.key];
    if (!turn) return;
    e.preventDefault();
    view.yaw += turn[0];
    view.pitch = Math.max(-1.57, Math.min(1.57, view.pitch + turn[1]));
    redraw();
  });
  function zoom(factor) {
    view.zoom = Math.max(0.2, Math.min(20, view.zoom * factor));
    redraw();
  }
  new ResizeObserver(redraw).observe(canvas);
  redraw();
  return view;
}

// The border between two pictures follows the slider and a finger on the picture.
function pictureSlider(figure) {
  const pair = figure.querySelector(".pair");
  const range = figure.querySelector("input");
  const set = (percent) => {
    range.value = percent;
    pair.style.setProperty("--at", `${range.value}%`);
  };
  range.addEventListener("input", () => set(range.value));
  const follow = (e) => {
    const box = pair.getBoundingClientRect();
    set((100 * (e.clientX - box.left)) / box.width);
  };
  pair.addEventListener("pointerdown", (e) => { pair.setPointerCapture(e.pointerId); follow(e); });
  pair.addEventListener("pointermove", (e) => { if (pair.hasPointerCapture(e.pointerId)) follow(e); });
  set(50);
}

document.querySelectorAll("figure.slider").forEach(pictureSlider);
for (const box of document.querySelectorAll("input.difference")) {
  box.addEventListener("change", () => document.body.classList.toggle("difference", box.checked));
}
const poses = document.getElementById("poses-data");
if (poses) window.poseView = poseView(document.getElementById("poses"), JSON.parse(poses.textContent));
