// The crop box with its handles, and the search for floaters: both are done for good by the program
// (the server, or `sat-recon export`), here they are shown.
import * as THREE from "three";
import { make, slider } from "./panel.js";

const AXES = ["x", "y", "z"];

// The smallest box that holds nearly all points, and how far it can be drawn out.
function bounds(points, radius) {
  const count = points.positions.length / 3;
  if (count < 8) return { low: [-radius, -radius, -radius], high: [radius, radius, radius] };
  const [low, high] = [[], []];
  for (let axis = 0; axis < 3; axis++) {
    const values = Float32Array.from({ length: count }, (_, i) => points.positions[3 * i + axis]).sort();
    const [a, b] = [values[Math.floor(0.01 * count)], values[Math.floor(0.99 * (count - 1))]];
    const margin = 0.5 * (b - a) + 0.02 * radius;
    [low[axis], high[axis]] = [a - margin, b + margin];
  }
  return { low, high };
}

export class Cut {
  constructor({ scene, camera, canvas, served, changed, showFloaters, fail }) {
    Object.assign(this, { camera, canvas, served, changed, showFloaters, fail, on: false, floaters: 0, drawn: new THREE.Group() });
    this.drawn.visible = false;
    scene.add(this.drawn);
    this.box = make("input", { type: "checkbox", title: "Crop box" });
    this.box.onchange = () => { this.on = this.box.checked; this.update(); };
    this.sliders = make("div", { hidden: true });
    this.command = make("code", { hidden: true });
    const save = make("button", { textContent: "save .ply", title: "Save what is left", className: "wide" });
    save.onclick = () => this.save();
    this.controls = [make("label", { className: "check" }, this.box, "crop box"), this.sliders];
    if (served) {
      const share = slider("Floaters below, %", 0, 5, 0, () => {}, 0.1);
      share.onchange = () => this.setFloaters(Number(share.value));
      this.controls.push(make("label", {}, make("span", { textContent: "floaters" }), share), make("div", { className: "row" }, save));
    }
    this.controls.push(this.command);
    canvas.addEventListener("pointerdown", (e) => this.grab(e), true);
  }

  // Another run, or another model of it: the box holds all again.
  setScene(data) {
    this.data = data;
    this.range = bounds(data.points, data.radius);
    this.low = [...this.range.low];
    this.high = [...this.range.high];
    this.inputs = [];
    this.sliders.replaceChildren(...AXES.flatMap((name, axis) => ["low", "high"].map((end) => {
      const input = slider(`${name} ${end}`, this.range.low[axis], this.range.high[axis], this[end][axis], (v) => this.move(axis, end, v), "any");
      this.inputs.push({ input, axis, end });
      return make("label", {}, make("span", { textContent: `${name} ${end === "low" ? "from" : "to"}` }), input);
    })));
    this.update();
  }

  move(axis, end, value) {
    const least = 1e-3 * this.data.radius;
    this[end][axis] = end === "low" ? Math.min(value, this.high[axis] - least) : Math.max(value, this.low[axis] + least);
    this.update();
  }

  // In the numbers of the run's world, to six digits.
  world() {
    const { units_of_page: scale, origin_of_page: origin } = this.data;
    return [...this.low, ...this.high].map((v, i) => Number((scale * v + origin[i % 3]).toPrecision(6)));
  }

  query() {
    const parts = [];
    if (this.on) parts.push(`box=${this.world().join(",")}`);
    if (this.floaters > 0) parts.push(`floaters=${this.floaters}`);
    return parts.join("&");
  }

  update() {
    this.sliders.hidden = !this.on;
    this.drawn.visible = this.on;
    for (const { input, axis, end } of this.inputs ?? []) input.value = this[end][axis];
    this.command.hidden = this.served || !this.on;
    if (this.on) {
      this.command.textContent = `sat-recon export ${this.data.title} --crop ${this.world().join(",")} -o cut.ply`;
      this.draw();
    }
    this.changed(this.on ? { low: this.low, high: this.high } : null);
  }

  draw() {
    this.drawn.traverse((part) => part.geometry?.dispose());
    this.drawn.clear();
    const box = new THREE.Box3(new THREE.Vector3(...this.low), new THREE.Vector3(...this.high));
    this.drawn.add(new THREE.Box3Helper(box, 0xffffff));
    const size = 0.02 * this.data.radius;
    for (let axis = 0; axis < 3; axis++) {
      for (const end of ["low", "high"]) {
        const handle = new THREE.Mesh(new THREE.SphereGeometry(size, 16, 12), new THREE.MeshBasicMaterial({ color: [0xff5b5b, 0x5bd75b, 0x5b9bff][axis], depthTest: false }));
        box.getCenter(handle.position).setComponent(axis, this[end][axis]);
        handle.renderOrder = 2;
        handle.userData = { axis, end };
        this.drawn.add(handle);
      }
    }
  }

  // Where a place of the scene is on the canvas, in its own pixels.
  project(place) {
    const p = place.clone().project(this.camera);
    const box = this.canvas.getBoundingClientRect();
    return new THREE.Vector2(((p.x + 1) / 2) * box.width + box.left, ((1 - p.y) / 2) * box.height + box.top);
  }

  // Where a handle is on the page.
  handle(axis, end) {
    const found = this.drawn.children.find((c) => c.userData.axis === axis && c.userData.end === end);
    const { x, y } = this.project(found.position);
    return { x, y };
  }

  // A handle follows the pointer along its axis.
  grab(event) {
    if (!this.on) return;
    const at = new THREE.Vector2(event.clientX, event.clientY);
    const handles = this.drawn.children.filter((c) => c.userData.end).map((handle) => ({ handle, distance: this.project(handle.position).distanceTo(at) }));
    const nearest = handles.sort((a, b) => a.distance - b.distance)[0];
    if (!nearest || nearest.distance > 22) return;
    event.stopPropagation();
    event.preventDefault();
    const { axis, end } = nearest.handle.userData;
    const from = nearest.handle.position.clone();
    const beside = from.clone().setComponent(axis, from.getComponent(axis) + 0.05 * this.data.radius);
    const along = this.project(beside).sub(this.project(from));
    const perPixel = (0.05 * this.data.radius) / Math.max(1, along.lengthSq());
    const start = this[end][axis];
    const follow = (e) => this.move(axis, end, start + new THREE.Vector2(e.clientX, e.clientY).sub(at).dot(along) * perPixel);
    const release = () => {
      window.removeEventListener("pointermove", follow);
      window.removeEventListener("pointerup", release);
      window.removeEventListener("pointercancel", release);
    };
    window.addEventListener("pointermove", follow);
    window.addEventListener("pointerup", release);
    window.addEventListener("pointercancel", release);
  }

  async setFloaters(share) {
    this.floaters = share;
    try {
      await this.showFloaters(share > 0 ? `cut.spz?floaters=${share}` : null);
    } catch (error) {
      this.fail(error);
    }
  }

  async save() {
    try {
      const answer = await fetch(`cut.ply?${this.query()}`);
      if (!answer.ok) throw new Error(await answer.text());
      const link = make("a", { download: "cut.ply", href: URL.createObjectURL(await answer.blob()) });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    } catch (error) {
      this.fail(error);
    }
  }
}
