// Input cameras: `cam_from_world` with x right, y down, z forward, as COLMAP has it; three looks
// along -z, y up.
import * as THREE from "three";

// Position and orientation in the world.
export function worldOf(view) {
  const r = view.rotation; // row-major cam_from_world
  const t = view.translation;
  const position = new THREE.Vector3(
    -(r[0] * t[0] + r[3] * t[1] + r[6] * t[2]),
    -(r[1] * t[0] + r[4] * t[1] + r[7] * t[2]),
    -(r[2] * t[0] + r[5] * t[1] + r[8] * t[2]),
  );
  const right = new THREE.Vector3(r[0], r[1], r[2]);
  const up = new THREE.Vector3(-r[3], -r[4], -r[5]);
  const back = new THREE.Vector3(-r[6], -r[7], -r[8]);
  const quaternion = new THREE.Quaternion().setFromRotationMatrix(new THREE.Matrix4().makeBasis(right, up, back));
  return { position, quaternion };
}

export function poseOf(view, camera) {
  const { position, quaternion } = worldOf(view);
  camera.position.copy(position);
  camera.quaternion.copy(quaternion);
  camera.updateMatrixWorld();
}

// The projection of focal lengths and principal point in pixels (the image corner is 0, 0).
export function applyIntrinsics(camera, view) {
  const { near, far } = camera;
  const [w, h] = [view.width, view.height];
  const left = (-view.cx / view.fx) * near;
  const right = ((w - view.cx) / view.fx) * near;
  const top = (view.cy / view.fy) * near;
  const bottom = (-(h - view.cy) / view.fy) * near;
  camera.projectionMatrix.makePerspective(left, right, top, bottom, near, far);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
}
