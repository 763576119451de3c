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
async function bytesOf(splat) {
  if (splat.url) {
    const answer = await fetch(splat.url);
    if (!answer.ok) throw new Error(`${splat.url}: ${answer.status} ${answer.statusText}`);
    return new Uint8Array(await answer.arrayBuffer());
  }
  const text = document.getElementById("splat").textContent.trim();
  return decoded(text);
}

export async function loadSplat(data) {
  const eye = dyno.dynoVec3(new THREE.Vector3());
  const range = dyno.dynoVec2(new THREE.Vector2(data.near, data.far));
  const shown = dyno.dynoFloat(0);
  const gain = dyno.dynoFloat(1);
  const byDepth = dyno.dynoBlock({ gsplat: dyno.Gsplat }, { gsplat: dyno.Gsplat }, ({ gsplat }) => {
    const { center, rgb } = dyno.splitGsplat(gsplat).outputs;
    const shade = new dyno.Dyno({
      inTypes: { center: "vec3", rgb: "vec3", eye: "vec3", range: "vec2", shown: "float", gain: "float" },
      outTypes: { rgb: "vec3" },
      statements: ({ inputs, outputs }) => [
        `float near = 1.0 - clamp((distance(${inputs.center}, ${inputs.eye}) - ${inputs.range}.x) / (${inputs.range}.y - ${inputs.range}.x), 0.0, 1.0);`,
        `${outputs.rgb} = mix(${inputs.rgb} * ${inputs.gain}, vec3(near), ${inputs.shown});`,
      ],
    });
    const coloured = shade.apply({ center, rgb, eye, range, shown, gain }).rgb;
    return { gsplat: dyno.combineGsplat({ gsplat, rgb: coloured }) };
  });
  const mesh = new SplatMesh({ fileBytes: await bytesOf(data.splat), fileName: "splat.spz", worldModifier: byDepth });
  mesh.quaternion.set(1, 0, 0, 0); // spz has y up and z back, the scene y down and z forward
  await mesh.initialized;
  const showDepth = (on) => {
    shown.value = on ? 1 : 0;
    mesh.updateVersion();
  };
  const setExposure = (stops) => {
    gain.value = 2 ** stops;
    mesh.updateVersion();
  };
  // While depth is shown, the colours follow the camera; says whether they changed.
  const follow = (camera) => {
    if (!shown.value || eye.value.equals(camera.position)) return false;
    eye.value.copy(camera.position);
    mesh.updateVersion();
    return true;
  };
  return { mesh, showDepth, setExposure, follow };
}
