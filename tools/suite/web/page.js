// Films one capture: reads /plan.json, renders every frame in linear light, posts it to /frame.
import * as THREE from "three";
import { DRACOLoader } from "three/addons/loaders/DRACOLoader.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { OBJECTS } from "./objects.js";
import { paint, rod } from "./parts.js";
import { lamp, PLACES, surroundings } from "./places.js";

const post = (path, body) => fetch(path, { method: "POST", body });

/** Shadows by four comparisons, weighted by place, instead of seventeen: they cost the most. */
function cheapShadows() {
  const chunk = THREE.ShaderChunk.shadowmap_pars_fragment, from = chunk.indexOf("#if defined( SHADOWMAP_TYPE_PCF )");
  const to = chunk.indexOf("#elif defined( SHADOWMAP_TYPE_PCF_SOFT )"), at = (x, y) =>
    `texture2DCompare(shadowMap, (cell + vec2(${x}, ${y})) / shadowMapSize, shadowCoord.z)`;
  THREE.ShaderChunk.shadowmap_pars_fragment = `${chunk.slice(0, from)}#if defined( SHADOWMAP_TYPE_PCF )
    vec2 place = shadowCoord.xy * shadowMapSize - 0.5, cell = floor(place) + 0.5, part = fract(place);
    shadow = mix(mix(${at("0.0", "0.0")}, ${at("1.0", "0.0")}, part.x), mix(${at("0.0", "1.0")}, ${at("1.0", "1.0")}, part.x), part.y);
    ${chunk.slice(to)}`;
}

/** The object inside a sphere of radius 0.5 about the origin of its body frame, moved by `mount`. */
async function body(plan) {
  let thing;
  if (OBJECTS[plan.object]) thing = OBJECTS[plan.object]();
  else {
    const loader = new GLTFLoader(), draco = new DRACOLoader().setDecoderPath("/three/examples/jsm/libs/draco/gltf/");
    thing = (await loader.setDRACOLoader(draco).loadAsync("/object.glb")).scene;
    thing.rotation.x = Math.PI / 2; // glTF is y up
  }
  const group = new THREE.Group().add(thing);
  group.updateMatrixWorld(true);
  const box = new THREE.Box3().setFromObject(group, true), middle = box.getCenter(new THREE.Vector3());
  let radius = 0, flat = 0, height = 0;
  const p = new THREE.Vector3();
  group.traverse((o) => {
    if (!o.isMesh) return;
    o.castShadow = o.receiveShadow = true;
    for (const m of [o.material].flat()) if (m.map) m.map.anisotropy = 1;
    const v = o.geometry.attributes.position;
    for (let i = 0; i < v.count; i++) {
      p.fromBufferAttribute(v, i).applyMatrix4(o.matrixWorld).sub(middle);
      [radius, flat, height] = [Math.max(radius, p.length()), Math.max(flat, Math.hypot(p.x, p.y)), Math.max(height, Math.abs(p.z))];
    }
  });
  const scale = 0.5 / radius;
  thing.position.sub(middle);
  group.scale.setScalar(scale);
  const mount = new THREE.Group().add(group);
  mount.matrixAutoUpdate = false;
  mount.matrix.fromArray(plan.mount);
  const root = new THREE.Group().add(mount);
  root.matrixAutoUpdate = false;
  root.userData = { flat: flat * scale, height: height * scale };
  return root;
}

/** Axes of the joints and places on them, by name, in the object's body frame. */
function joints(root, names) {
  root.matrix.identity();
  root.updateMatrixWorld(true);
  return Object.fromEntries(names.map((name) => {
    const hinge = root.getObjectByName(name);
    return [name, { axis: hinge.userData.axis.clone().transformDirection(hinge.parent.matrixWorld).toArray(),
      place: hinge.getWorldPosition(new THREE.Vector3()).toArray() }];
  }));
}

/** Where the axis comes out of the object's underside: there the pole ends. */
function underside(root) {
  root.matrix.identity();
  root.updateMatrixWorld(true);
  const ray = new THREE.Raycaster(new THREE.Vector3(0, 0, -2), new THREE.Vector3(0, 0, 1));
  root.traverse((o) => { if (o.isMesh) for (const m of [o.material].flat()) m.side = THREE.DoubleSide; });
  const hit = ray.intersectObject(root, true)[0];
  return hit ? hit.point.z : new THREE.Box3().setFromObject(root, true).min.z;
}

/** A full-screen pass. */
class Pass {
  constructor(fragment, uniforms) {
    const surface = new THREE.RawShaderMaterial({
      glslVersion: THREE.GLSL3, uniforms, depthTest: false, depthWrite: false,
      vertexShader: "in vec3 position; out vec2 at; void main() { at = position.xy * 0.5 + 0.5; gl_Position = vec4(position.xy, 0.0, 1.0); }",
      fragmentShader: `precision highp float; in vec2 at; out vec4 colour;\n${fragment}`,
    });
    const corners = new THREE.BufferGeometry().setAttribute("position", new THREE.Float32BufferAttribute([-1, -1, 0, 3, -1, 0, -1, 3, 0], 3));
    this.mesh = new THREE.Mesh(corners, surface);
    this.mesh.frustumCulled = false;
    this.camera = new THREE.Camera();
  }
  run(renderer, target) {
    renderer.setRenderTarget(target);
    renderer.render(this.mesh, this.camera);
  }
}

/** The picture through the lens, x_d = x (1 + k1 r^2 + k2 r^4): four points a pixel, top row first. */
const LENS = `
uniform sampler2D wide; uniform vec2 size, wide_size, centre, k; uniform float f, wide_f;
vec4 seen(vec2 pixel) {
  vec2 d = (pixel - centre) / f, x = d;
  for (int i = 0; i < 4; i++) { float r2 = dot(x, x); x = d / (1.0 + k.x * r2 + k.y * r2 * r2); }
  vec2 p = wide_f * x + 0.5 * wide_size;
  return texture(wide, vec2(p.x, wide_size.y - p.y) / wide_size);
}
void main() {
  vec2 pixel = at * size;
  vec4 sum = seen(pixel + vec2(-0.25, -0.25)) + seen(pixel + vec2(0.25, -0.25)) + seen(pixel + vec2(-0.25, 0.25)) + seen(pixel + vec2(0.25, 0.25));
  colour = min(0.25 * sum, vec4(60000.0));
}`;

class Film {
  constructor(plan) {
    const { width, height, lens, density, margin } = plan;
    Object.assign(this, { plan, width, height });
    cheapShadows();
    this.renderer = new THREE.WebGLRenderer({ antialias: false });
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    const half = { type: THREE.HalfFloatType, minFilter: THREE.LinearFilter, magFilter: THREE.LinearFilter, generateMipmaps: false };
    const [w, h] = [width, height].map((n) => 2 * Math.ceil((n * density * margin) / 2));
    this.wide = new THREE.WebGLRenderTarget(w, h, { ...half, samples: 4 });
    this.final = new THREE.WebGLRenderTarget(width, height, { ...half, depthBuffer: false });
    const f = lens.f * density, near = 0.05, far = 30, v = (value) => ({ value });
    this.lens = new Pass(LENS, {
      wide: v(this.wide.texture), size: v(new THREE.Vector2(width, height)), wide_size: v(new THREE.Vector2(w, h)),
      centre: v(new THREE.Vector2(lens.cx, lens.cy)), k: v(new THREE.Vector2(lens.k1, lens.k2)), f: v(lens.f), wide_f: v(f),
    });
    this.camera = new THREE.Camera();
    this.camera.matrixAutoUpdate = false;
    this.camera.projectionMatrix.set((2 * f) / w, 0, 0, 0, 0, (2 * f) / h, 0, 0, 0, 0, -(far + near) / (far - near), (-2 * far * near) / (far - near), 0, 0, -1, 0);
    this.camera.projectionMatrixInverse.copy(this.camera.projectionMatrix).invert();
  }

  async stage() {
    const { plan, renderer } = this, sun = plan.light.sun;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(0, 0, 0);
    this.body = await body(plan);
    this.place = PLACES[plan.ground](plan.room_seed, plan.light.room);
    if (plan.pole) {
      const bottom = plan.ground === "room" ? -0.62 : -1.1;
      this.place.add(rod([0, 0, bottom], [0, 0, underside(this.body) + 0.01], 0.013, paint(0.1, 0.1, 0.11, 0.5)));
    }
    const pmrem = new THREE.PMREMGenerator(renderer);
    this.scene.environment = pmrem.fromScene(surroundings(plan.ground, sun), 0.01, 0.1, 30).texture;
    this.scene.environmentIntensity = plan.light.room;
    const light = lamp(sun, plan.light.lamp, plan.light.direction);
    this.scene.add(light, light.target, this.body, this.place);
  }

  /** Frame `i` in linear light as half floats, RGBA, top row first. */
  picture(i) {
    const frame = this.plan.frames[i];
    this.body.matrix.fromArray(frame.body);
    for (const [name, angle] of Object.entries(frame.joints)) {
      const hinge = this.body.getObjectByName(name);
      hinge.quaternion.setFromAxisAngle(hinge.userData.axis, angle);
    }
    this.camera.matrix.fromArray(frame.camera);
    this.camera.updateMatrixWorld(true);
    this.renderer.shadowMap.needsUpdate = true;
    this.renderer.setRenderTarget(this.wide);
    this.renderer.clear();
    this.renderer.render(this.scene, this.camera);
    this.lens.run(this.renderer, this.final);
    const pixels = new Uint16Array(4 * this.width * this.height);
    this.renderer.readRenderTargetPixels(this.final, 0, 0, this.width, this.height, pixels);
    return pixels;
  }
}

/** Corners of the object's triangles in its body frame, three by three. */
function triangles(root) {
  root.matrix.identity();
  root.updateMatrixWorld(true);
  const corners = [], p = new THREE.Vector3();
  root.traverse((o) => {
    if (!o.isMesh) return;
    const v = o.geometry.attributes.position, order = o.geometry.index;
    const count = order ? order.count : v.count;
    for (let i = 0; i < count; i++) {
      p.fromBufferAttribute(v, order ? order.getX(i) : i).applyMatrix4(o.matrixWorld);
      corners.push(p.x, p.y, p.z);
    }
  });
  return new Float32Array(corners);
}

async function main() {
  const plan = await (await fetch("/plan.json")).json();
  if (plan.mesh) {
    await post("/mesh", triangles(await body(plan)));
    return post("/done", "");
  }
  const film = new Film(plan);
  await film.stage();
  await post("/size", JSON.stringify(film.body.userData));
  await post("/joints", JSON.stringify(joints(film.body, Object.keys(plan.frames[0].joints))));
  film.place.visible = false;
  for (const i of plan.samples) await post(`/sample?i=${i}`, film.picture(i));
  film.place.visible = true;
  let sent = Promise.resolve();
  for (let i = plan.first; i < plan.frames.length; i++) {
    const pixels = film.picture(i);
    await sent; // at most one frame is on its way while the next is drawn
    sent = post(`/frame?i=${i}`, pixels);
  }
  await sent;
  await post("/done", "");
}

const failed = (what) => post("/failed", String(what)).catch(() => {});
addEventListener("error", (event) => failed(event.message));
main().catch((error) => failed(error.stack ?? error));
