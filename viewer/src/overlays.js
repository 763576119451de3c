// The sparse cloud and the input cameras.
import * as THREE from "three";
import { worldOf } from "./cameras.js";

export function pointCloud(points) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(points.positions, 3));
  geometry.setAttribute("color", new THREE.Uint8BufferAttribute(points.colors, 3, true));
  const cloud = new THREE.Points(geometry, new THREE.PointsMaterial({ size: 2, sizeAttenuation: false, vertexColors: true }));
  cloud.visible = false;
  return cloud;
}

export function cameraLines(cameras, radius) {
  const depth = radius * 0.06;
  const vertices = [];
  for (const view of cameras) {
    const { position, quaternion } = worldOf(view);
    const corner = (x, y) => new THREE.Vector3(
      ((x - view.cx) / view.fx) * depth, (-(y - view.cy) / view.fy) * depth, -depth,
    ).applyQuaternion(quaternion).add(position);
    const corners = [corner(0, 0), corner(view.width, 0), corner(view.width, view.height), corner(0, view.height)];
    corners.forEach((c, i) => vertices.push(...position, ...c, ...c, ...corners[(i + 1) % 4]));
  }
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(vertices, 3));
  const lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: 0x4da3ff }));
  lines.visible = false;
  return lines;
}
