// Flying with W A S D, Q and E for down and up, shift for speed.
import * as THREE from "three";

const DIRECTIONS = { KeyW: [0, 0, -1], KeyS: [0, 0, 1], KeyA: [-1, 0, 0], KeyD: [1, 0, 0], KeyQ: [0, -1, 0], KeyE: [0, 1, 0] };

export class Flight {
  constructor(camera, controls, radius, moved) {
    Object.assign(this, { camera, controls, moved, speed: radius * 0.5, held: new Set() });
    // In the panel, letters choose and sliders move.
    const flies = (e) => DIRECTIONS[e.code] && !(e.ctrlKey || e.metaKey || e.altKey) && !/^(SELECT|INPUT)$/.test(e.target.tagName);
    window.addEventListener("keydown", (e) => { if (flies(e)) this.held.add(e.code); this.fast = e.shiftKey; });
    window.addEventListener("keyup", (e) => { this.held.delete(e.code); this.fast = e.shiftKey; });
    window.addEventListener("blur", () => this.held.clear());
  }

  step(seconds) {
    if (this.held.size === 0) return;
    const step = new THREE.Vector3();
    for (const key of this.held) step.add(new THREE.Vector3(...DIRECTIONS[key]));
    step.applyQuaternion(this.camera.quaternion).multiplyScalar(this.speed * seconds * (this.fast ? 4 : 1));
    this.camera.position.add(step);
    this.controls.target.add(step);
    this.moved();
  }
}
