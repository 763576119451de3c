// Shapes that the objects are made of, and materials. Metres, z up.
import * as THREE from "three";

export const material = (settings) => new THREE.MeshStandardMaterial({ roughness: 0.6, metalness: 0, ...settings });

/** A surface of the place: it glows instead of being lit from all sides, which is cheap to draw. */
export const matt = (map, glow) =>
  new THREE.MeshLambertMaterial({ map, emissiveMap: map, emissive: new THREE.Color(glow, glow, glow), side: THREE.DoubleSide });
export const paint = (r, g, b, roughness = 0.6, metalness = 0) =>
  material({ color: new THREE.Color().setRGB(r, g, b), roughness, metalness });

function mesh(geometry, surface, at = [0, 0, 0], turn = [0, 0, 0]) {
  const m = new THREE.Mesh(geometry, surface);
  m.position.set(...at);
  m.rotation.set(...turn.map((a) => (a * Math.PI) / 180));
  m.castShadow = m.receiveShadow = true;
  return m;
}

export const box = (size, surface, at, turn) => mesh(new THREE.BoxGeometry(...size), surface, at, turn);
export const ball = (radius, surface, at, parts = 48) =>
  mesh(new THREE.SphereGeometry(radius, parts, parts / 2).rotateX(Math.PI / 2), surface, at);

/** A sheet in its own xy plane, seen from +z. */
export const sheet = (width, height, surface, at, turn) => mesh(new THREE.PlaneGeometry(width, height), surface, at, turn);

/** A profile [[radius, z], ...] turned about z; `shape(angle, z)` scales the radius. */
export function lathe(profile, surface, at, turn, { sides = 64, shape = null } = {}) {
  const points = profile.map(([r, z]) => new THREE.Vector2(r, z));
  const geometry = new THREE.LatheGeometry(points, sides).rotateX(Math.PI / 2);
  if (shape) {
    const p = geometry.attributes.position;
    for (let i = 0; i < p.count; i++) {
      const s = shape(Math.atan2(p.getY(i), p.getX(i)), p.getZ(i));
      p.setXY(i, p.getX(i) * s, p.getY(i) * s);
    }
    geometry.computeVertexNormals();
    closeSeam(geometry, profile.length);
  }
  const m = mesh(geometry, surface, at, turn);
  m.material.side = THREE.DoubleSide;
  return m;
}

/** Gives first and last column of a lathe, which are one line of the surface, the same normals. */
function closeSeam(geometry, rows) {
  const n = geometry.attributes.normal, last = n.count - rows;
  for (let k = 0; k < rows; k++) {
    const sum = new THREE.Vector3().fromBufferAttribute(n, k);
    sum.add(new THREE.Vector3().fromBufferAttribute(n, last + k)).normalize();
    n.setXYZ(k, sum.x, sum.y, sum.z);
    n.setXYZ(last + k, sum.x, sum.y, sum.z);
  }
}

/** A closed cylinder from one point to another. */
export function rod(from, to, radius, surface, sides = 12) {
  const a = new THREE.Vector3(...from), b = new THREE.Vector3(...to);
  const m = mesh(new THREE.CylinderGeometry(radius, radius, a.distanceTo(b), sides), surface);
  m.position.copy(a).add(b).multiplyScalar(0.5);
  m.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), b.sub(a).normalize());
  return m;
}

export function ring(radius, thickness, surface, at, turn) {
  return mesh(new THREE.TorusGeometry(radius, thickness, 8, 64), surface, at, turn);
}

export function group(...things) {
  const g = new THREE.Group();
  g.add(...things.flat(Infinity));
  return g;
}

/** A part that turns about an axis through a place (default: its own origin), both in its parent's frame. */
export function joint(name, thing, axis = [1, 0, 0], place = thing.position.toArray()) {
  const hinge = group(thing);
  hinge.name = name;
  hinge.position.set(...place);
  thing.position.sub(hinge.position);
  hinge.userData.axis = new THREE.Vector3(...axis).normalize();
  return hinge;
}
