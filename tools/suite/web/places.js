// Where the object is filmed, and its light. World: metres, z up, the object about the origin.
import * as THREE from "three";
import { box, group, lathe, matt, paint, rod, sheet } from "./parts.js";
import { mottled, patches, random } from "./textures.js";

const AMBIENT = 0.16; // radiance of the surroundings, mean over directions

/** A screen behind and below the object, bent where wall meets floor, not quite even. */
function green(_seed, ambient) {
  const profile = [];
  for (let k = 0; k <= 24; k++) {
    const a = (k / 24) * (Math.PI / 2);
    profile.push([1.0 + 0.7 * Math.sin(a), -1.1 + 0.7 * (1 - Math.cos(a))]);
  }
  const cloth = matt(mottled(201, [0.1, 0.62, 0.16], [0.13, 0.7, 0.2], { cells: 3, contrast: 1 }), 4 * AMBIENT * ambient);
  const points = [[-6, -1.1], ...profile, [1.7, 4]];
  const shape = new THREE.BufferGeometry(), p = [], uv = [], index = [];
  points.forEach(([y, z], k) => { for (const x of [-5, 5]) { p.push(x, y, z); uv.push(x / 10, k / points.length); } });
  for (let k = 0; k + 1 < points.length; k++) index.push(2 * k, 2 * k + 1, 2 * k + 3, 2 * k, 2 * k + 3, 2 * k + 2);
  shape.setAttribute("position", new THREE.Float32BufferAttribute(p, 3));
  shape.setAttribute("uv", new THREE.Float32BufferAttribute(uv, 2));
  shape.setIndex(index);
  shape.computeVertexNormals();
  const screen = new THREE.Mesh(shape, cloth);
  screen.receiveShadow = true;
  return group(screen);
}

/** A room with carpet, walls, posters, a table and blocks on it; every surface has texture. */
function room(seed, ambient) {
  const next = random(seed), parts = [], surface = (map) => matt(map, AMBIENT * ambient);
  parts.push(sheet(7, 7, surface(mottled(211, [0.33, 0.28, 0.26], [0.66, 0.57, 0.5], { repeat: [3, 3] })), [0, 0, -1.2]));
  const wall = surface(mottled(212, [0.6, 0.6, 0.57], [0.84, 0.82, 0.77], { cells: 5, repeat: [2, 1] }));
  for (let k = 0; k < 4; k++) {
    const side = group(sheet(7, 4, wall, [0, 0, 0]));
    for (let j = 0; j < 5; j++) {
      const poster = surface(patches(220 + 10 * k + j + 100 * seed, [0.2 + 0.6 * next(), 0.2 + 0.6 * next(), 0.2 + 0.6 * next()]));
      side.add(sheet(0.5 + 0.6 * next(), 0.4 + 0.6 * next(), poster, [-2.6 + 1.3 * j + 0.3 * next(), -0.6 + 0.9 * next(), 0.01]));
    }
    side.rotation.set(Math.PI / 2, 0, 0);
    const turned = group(side);
    side.position.set(0, 3.4, 0.8);
    turned.rotation.z = (k * Math.PI) / 2;
    parts.push(turned);
  }
  const wood = surface(mottled(213, [0.4, 0.25, 0.13], [0.72, 0.53, 0.33], { cells: 6, repeat: [1, 2] }));
  parts.push(lathe([[0.001, -0.62], [0.75, -0.62], [0.76, -0.65], [0.001, -0.66]], wood), rod([0, 0, -1.2], [0, 0, -0.65], 0.06, paint(0.2, 0.2, 0.2)));
  for (let k = 0; k < 9; k++) {
    const a = (2 * Math.PI * (k + 0.4 * next())) / 9, size = [0.05 + 0.07 * next(), 0.05 + 0.07 * next(), 0.04 + 0.06 * next()];
    const block = surface(patches(260 + k + 100 * seed, [0.2 + 0.7 * next(), 0.2 + 0.7 * next(), 0.2 + 0.7 * next()], { count: 30 }));
    parts.push(box(size, block, [0.6 * Math.sin(a), 0.6 * Math.cos(a), -0.62 + size[2] / 2], [0, 0, 90 * next()]));
  }
  return group(parts);
}

export const PLACES = { green, room, black: () => new THREE.Group() };

/** Soft boxes and walls that only reflections and indirect light see. */
export function surroundings(place, sun) {
  const scene = new THREE.Scene(), glow = (r, g, b) => new THREE.MeshBasicMaterial({ color: new THREE.Color().setRGB(r, g, b), side: THREE.DoubleSide });
  const panel = (colour, w, h, at) => {
    const m = new THREE.Mesh(new THREE.PlaneGeometry(w, h), glow(...colour));
    m.position.set(...at);
    m.lookAt(0, 0, 0);
    scene.add(m);
  };
  if (sun) {
    panel([0.25, 0.32, 0.45], 14, 14, [0, 3, -9]); // the planet below
    return scene;
  }
  const wall = place === "green" ? [0.05, 0.13, 0.06] : [0.12, 0.115, 0.105];
  scene.add(new THREE.Mesh(new THREE.BoxGeometry(8, 8, 6), glow(...wall)));
  panel([1.6, 1.65, 1.8], 2.2, 1.4, [-2.4, 1.2, 2.2]);
  panel([1.2, 1.15, 1.05], 1.6, 1.6, [1.8, -2.6, 1.9]);
  panel([0.5, 0.48, 0.42], 3.0, 0.8, [2.8, 1.6, -0.5]);
  panel([0.9, 0.9, 0.95], 0.5, 2.0, [-3.0, -1.6, 0.4]);
  return scene;
}

/** Lamp (a spot whose edge is soft) or sun (hard edges); `strength` 1 is 100 %. */
export function lamp(sun, strength, direction) {
  const at = new THREE.Vector3(...direction).normalize().multiplyScalar(2.2);
  const light = sun
    ? new THREE.DirectionalLight(0xffffff, 3.0 * strength)
    : new THREE.SpotLight(new THREE.Color().setRGB(1, 0.95, 0.86), 15 * strength, 0, 0.55, 0.6, 2);
  light.position.copy(at);
  light.castShadow = true;
  light.shadow.mapSize.set(1024, 1024);
  light.shadow.bias = -0.001;
  light.shadow.normalBias = 0.012;
  light.shadow.radius = sun ? 1 : 3;
  light.shadow.camera.near = 0.5;
  light.shadow.camera.far = sun ? 4 : 6;
  if (sun) Object.assign(light.shadow.camera, { left: -0.8, right: 0.8, top: 0.8, bottom: -0.8 });
  return light;
}
