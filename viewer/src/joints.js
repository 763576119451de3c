// Parts of the object that turn on joints: where the sliders for time and for each joint put them.
import * as THREE from "three";
import { dyno } from "@sparkjsdev/spark";
import { make, slider } from "./panel.js";

const RADIANS = Math.PI / 180;

export class Joints {
  // `parts`: the number of the first Gaussian of each part, its axis and place in the page's
  // world, its angles by frame; `changed` is called when a part moved.
  constructor(parts, changed) {
    this.parts = parts ?? [];
    this.changed = changed;
    this.angles = this.parts.map(() => 0);
    this.turns = this.parts.map(() => dyno.dynoVec4(new THREE.Quaternion()));
    this.shifts = this.parts.map(() => dyno.dynoVec3(new THREE.Vector3()));
    this.sliders = [];
    this.setTime(0);
  }

  // Sliders for the panel, if anything moves.
  controls() {
    if (this.parts.length === 0) return [];
    const named = (name, input) => make("label", {}, make("span", { textContent: name }), input);
    this.time = slider("Time", 0, 1, 0, (value) => this.setTime(value), 0.001);
    this.sliders = this.parts.map((part, k) => {
      const [low, high] = [Math.min(...part.angles), Math.max(...part.angles)];
      const room = Math.max(30, high - low);
      return slider(`Angle of ${part.name}, degrees`, low - room, high + room, this.angles[k], (value) => this.turn(k, value), 0.1);
    });
    return [named("time", this.time), ...this.parts.map((part, k) => named(part.name, this.sliders[k]))];
  }

  // All as they were at a time, 0 (the first frame) to 1 (the last).
  setTime(time) {
    this.parts.forEach((part, k) => {
      const at = Math.min(Math.max(time, 0), 1) * (part.angles.length - 1);
      const before = Math.floor(at);
      const after = Math.min(before + 1, part.angles.length - 1);
      this.turn(k, part.angles[before] + (part.angles[after] - part.angles[before]) * (at - before));
    });
    if (this.time) this.time.value = time;
  }

  // As a photo shows them.
  setFrame(frame) {
    if (frame >= 0 && this.parts.length > 0) this.setTime(frame / Math.max(1, this.parts[0].angles.length - 1));
  }

  // One part at an angle, degrees.
  turn(k, angle) {
    const { axis, place } = this.parts[k];
    this.angles[k] = angle;
    const centre = new THREE.Vector3(...place);
    this.turns[k].value.setFromAxisAngle(new THREE.Vector3(...axis), angle * RADIANS);
    this.shifts[k].value.copy(centre).sub(centre.clone().applyQuaternion(this.turns[k].value));
    if (this.sliders[k]) this.sliders[k].value = angle;
    this.changed();
  }

  // Gaussians where the joints put them.
  moved({ index, center, quaternion }) {
    let at = { center, quaternion };
    this.parts.forEach((part, k) => {
      const move = new dyno.Dyno({
        inTypes: { index: "int", center: "vec3", quaternion: "vec4", turn: "vec4", shift: "vec3" },
        outTypes: { center: "vec3", quaternion: "vec4" },
        statements: ({ inputs: i, outputs: o }) => [
          `bool own = ${i.index} >= ${part.first} && ${i.index} < ${part.end};`,
          `${o.center} = own ? quatVec(${i.turn}, ${i.center}) + ${i.shift} : ${i.center};`,
          `${o.quaternion} = own ? quatQuat(${i.turn}, ${i.quaternion}) : ${i.quaternion};`,
        ],
      });
      at = move.apply({ index, ...at, turn: this.turns[k], shift: this.shifts[k] });
    });
    return at;
  }
}
