// The Gaussians, and their colouring by depth.
import * as THREE from "three";
import { SplatMesh, dyno } from "@sparkjsdev/spark";

// The browser's own decoder where it has one: a callback for each of 60 million letters takes
// seconds.
function decoded(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const letters = atob(text);
  const bytes = new Uint8Array(letters.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = letters.charCodeAt(i);
  return bytes;
}

// From a run's server, or from the page itself.
async function bytesOf(url) {
  if (url) {
    const answer = await fetch(url);
    if (!answer.ok) throw new Error(`${url}: ${answer.status} ${await answer.text()}`);
    return new Uint8Array(await answer.arrayBuffer());
  }
  const text = document.getElementById("splat").textContent.trim();
  return decoded(text);
}

// What a person has chosen; the same for every splat that is shown one after the other.
export class SplatLook {
  // `joints` put parts of the splat where they belong.
  constructor(joints) {
    this.joints = joints;
    this.eye = dyno.dynoVec3(new THREE.Vector3());
    this.range = dyno.dynoVec2(new THREE.Vector2(0, 1));
    this.depth = dyno.dynoFloat(0);
    this.gain = dyno.dynoFloat(1);
    this.low = dyno.dynoVec3(new THREE.Vector3());
    this.high = dyno.dynoVec3(new THREE.Vector3());
    this.cropped = dyno.dynoFloat(0);
    this.mesh = null;
  }

  setRange(near, far) { this.range.value.set(near, far); }

  showDepth(on) {
    this.depth.value = on ? 1 : 0;
    this.mesh?.updateVersion();
  }

  setExposure(stops) {
    this.gain.value = 2 ** stops;
    this.mesh?.updateVersion();
  }

  // A box with two corners, or none.
  crop(box) {
    this.cropped.value = box ? 1 : 0;
    if (box) {
      this.low.value.set(...box.low);
      this.high.value.set(...box.high);
    }
    this.mesh?.updateVersion();
  }

  // While depth is shown, the colours follow the camera; says whether they changed.
  follow(camera) {
    if (!this.mesh || !this.depth.value || this.eye.value.equals(camera.position)) return false;
    this.eye.value.copy(camera.position);
    this.mesh.updateVersion();
    return true;
  }

  modifier() {
    return dyno.dynoBlock({ gsplat: dyno.Gsplat }, { gsplat: dyno.Gsplat }, ({ gsplat }) => {
      const { index, center: rest, quaternion: upright, rgb, opacity } = dyno.splitGsplat(gsplat).outputs;
      const { center, quaternion } = this.joints.moved({ index, center: rest, quaternion: upright });
      const shade = new dyno.Dyno({
        inTypes: { center: "vec3", rgb: "vec3", opacity: "float", eye: "vec3", range: "vec2", depth: "float", gain: "float", low: "vec3", high: "vec3", cropped: "float" },
        outTypes: { rgb: "vec3", opacity: "float" },
        statements: ({ inputs: i, outputs: o }) => [
          `float near = 1.0 - clamp((distance(${i.center}, ${i.eye}) - ${i.range}.x) / (${i.range}.y - ${i.range}.x), 0.0, 1.0);`,
          `${o.rgb} = mix(${i.rgb} * ${i.gain}, vec3(near), ${i.depth});`,
          `bool outside = any(lessThan(${i.center}, ${i.low})) || any(greaterThan(${i.center}, ${i.high}));`,
          `${o.opacity} = outside && ${i.cropped} > 0.5 ? 0.0 : ${i.opacity};`,
        ],
      });
      const { eye, range, depth, gain, low, high, cropped } = this;
      const shown = shade.apply({ center, rgb, opacity, eye, range, depth, gain, low, high, cropped });
      return { gsplat: dyno.combineGsplat({ gsplat, center, quaternion, rgb: shown.rgb, opacity: shown.opacity }) };
    });
  }

  // The splat at an address, or the page's own.
  async load(url) {
    const mesh = new SplatMesh({ fileBytes: await bytesOf(url), fileName: "splat.spz", worldModifier: this.modifier() });
    mesh.quaternion.set(1, 0, 0, 0); // spz has y up and z back, the scene y down and z forward
    await mesh.initialized;
    return mesh;
  }
}
