// The seven objects that are made here, z up; the spacecraft are glTF files.
import { ball, box, group, joint, lathe, material, paint, ring, rod, sheet } from "./parts.js";
import { crumpled, drawn, mottled, noiseField, patches, print, random, solarCells } from "./textures.js";

const foil = (r, g, b, seed) =>
  material({ color: paint(r, g, b).color, roughness: 0.38, metalness: 0.75, normalMap: crumpled(seed), map: mottled(seed, [0.75, 0.75, 0.75], [1, 1, 1]) });

/** A satellite mock-up: foil body, two solar arrays that look alike, dish, rods, labels. */
function mockup() {
  const gold = foil(1.0, 0.66, 0.24, 3), silver = foil(0.85, 0.85, 0.87, 5), grey = paint(0.6, 0.6, 0.58, 0.45);
  const frame = paint(0.05, 0.05, 0.055, 0.4, 0.3), steel = paint(0.6, 0.6, 0.62, 0.35, 0.8);
  const parts = [
    box([0.3, 0.26, 0.34], gold), box([0.2, 0.01, 0.24], grey, [0, -0.135, 0.015]),
    box([0.12, 0.09, 0.05], silver, [-0.05, 0.05, 0.195], [0, 0, 12]), box([0.09, 0.09, 0.03], grey, [0.08, -0.05, 0.185], [0, 0, -20]),
    joint("dish", lathe([[0.001, 0], [0.05, 0.008], [0.085, 0.024], [0.105, 0.036]], paint(0.78, 0.78, 0.75, 0.5), [0.02, 0.165, 0.05], [-78, 0, 14])),
    lathe([[0.015, 0], [0.018, 0.018], [0.033, 0.052], [0.042, 0.087]], paint(0.3, 0.27, 0.25, 0.3, 0.9), [-0.148, -0.03, -0.09], [0, -90, 0]),
    rod([0.13, 0.1, 0.17], [0.2, 0.17, 0.39], 0.004, steel), rod([-0.13, 0.1, 0.17], [-0.21, 0.16, 0.37], 0.004, frame),
    rod([-0.12, -0.1, 0.17], [-0.12, -0.1, 0.34], 0.004, steel), box([0.03, 0.03, 0.04], frame, [-0.12, -0.1, 0.355]),
    sheet(0.19, 0.22, material({ map: print(21, [0.78, 0.78, 0.74], [0.05, 0.05, 0.08], ["TESTBED", "TB-03 A7", "HANDLE BY FRAME ONLY"]) }), [0, -0.1405, 0.015], [90, 0, 0]),
    sheet(0.11, 0.09, material({ map: patches(8, [0.7, 0.7, 0.65]) }), [0.151, 0.03, -0.02], [90, 0, 90]),
    sheet(0.09, 0.09, material({ map: patches(9, [0.6, 0.65, 0.7]) }), [-0.151, 0.05, 0.06], [90, 0, -90]),
    sheet(0.12, 0.06, material({ map: print(22, [0.8, 0.8, 0.76], [0.5, 0.05, 0.05], ["REMOVE", "COVER"]) }), [-0.06, 0.131, -0.11], [90, 0, 180]),
  ];
  for (const i of [-1, 1]) for (const j of [-1, 1]) parts.push(box([0.014, 0.014, 0.35], frame, [0.15 * i, 0.13 * j, 0]));
  const cells = material({ map: solarCells(4, 4, 6), roughness: 0.3, metalness: 0.2 });
  const back = material({ map: mottled(6, [0.2, 0.18, 0.16], [0.5, 0.47, 0.43]) });
  for (const side of [-1, 1]) {
    parts.push(rod([0.15 * side, 0, 0.03], [0.22 * side, 0, 0.03], 0.009, steel));
    const wing = group([0.084, 0.26].map((x) => [box([0.168, 0.24, 0.008], back, [side * x, 0, 0]), sheet(0.16, 0.232, cells, [side * x, 0, 0.0045])]));
    wing.position.set(0.22 * side, 0, 0.03);
    wing.rotation.x = (55 * Math.PI) / 180;
    parts.push(joint(side < 0 ? "left array" : "right array", wing));
  }
  return group(parts);
}

/** Radius over height of a head on shoulders on a pedestal. */
const BUST = [[0.001, 0], [0.2, 0], [0.2, 0.06], [0.14, 0.09], [0.13, 0.16], [0.24, 0.26], [0.3, 0.36], [0.28, 0.44], [0.15, 0.5],
  [0.1, 0.55], [0.11, 0.6], [0.15, 0.66], [0.17, 0.74], [0.16, 0.82], [0.11, 0.89], [0.05, 0.92], [0.001, 0.925]];

function dense(profile, steps = 8) {
  const out = [], at = (k) => profile[Math.min(profile.length - 1, Math.max(0, k))];
  for (let k = 0; k + 1 < profile.length; k++) {
    for (let s = 0; s < steps; s++) {
      const t = s / steps, [p0, p1, p2, p3] = [at(k - 1), at(k), at(k + 1), at(k + 2)];
      out.push([0, 1].map((c) => 0.5 * (2 * p1[c] + (p2[c] - p0[c]) * t + (2 * p0[c] - 5 * p1[c] + 4 * p2[c] - p3[c]) * t * t
        + (3 * p1[c] - p0[c] - 3 * p2[c] + p3[c]) * t * t * t)));
    }
  }
  return [...out, at(profile.length)].map(([r, z]) => [Math.max(r, 0.001), z]);
}

/** Face, shoulders and folds on the turned profile. */
function sculpted(seed, rough) {
  const field = noiseField(seed, 128, 6, 4);
  const lobe = (a, a0, z, z0, wa, wz) => Math.exp(-(((Math.atan2(Math.sin(a - a0), Math.cos(a - a0))) / wa) ** 2) - ((z - z0) / wz) ** 2);
  return (a, z) => {
    const i = Math.floor(((a / (2 * Math.PI) + 1) % 1) * 128) % 128, j = Math.min(127, Math.floor(z * 127));
    const shoulders = z > 0.2 && z < 0.5 ? 1 - 0.32 * Math.cos(2 * a) * Math.sin(((z - 0.2) / 0.3) * Math.PI) * -1 : 1;
    const face = 0.3 * lobe(a, -1.57, z, 0.72, 0.16, 0.045) + 0.12 * lobe(a, -1.57, z, 0.63, 0.3, 0.03)
      - 0.1 * lobe(a, -1.2, z, 0.76, 0.15, 0.02) - 0.1 * lobe(a, -1.94, z, 0.76, 0.15, 0.02) + 0.25 * lobe(a, 1.3, z, 0.8, 0.5, 0.06);
    return shoulders * (1 + face + (z > 0.1 ? rough * (field[j * 128 + i] - 0.5) : 0));
  };
}

function statue() {
  const stone = material({ map: mottled(31, [0.42, 0.38, 0.33], [0.86, 0.82, 0.74], { size: 1024, cells: 10, octaves: 6 }), roughness: 0.85 });
  return lathe(dense(BUST), stone, [0, 0, 0], [0, 0, 0], { sides: 160, shape: sculpted(32, 0.3) });
}

/** A dark bust: hardly any texture. */
function bust() {
  const bronze = paint(0.06, 0.055, 0.05, 0.42, 0.1);
  return lathe(dense(BUST), bronze, [0, 0, 0], [0, 0, 0], { sides: 160, shape: sculpted(47, 0.12) });
}

/** A microphone on a stand: thin parts, and a mesh that repeats. */
function microphone() {
  const mesh = drawn(51, 512, 512, (g, w, h) => {
    g.fillStyle = "rgb(40,40,44)";
    g.fillRect(0, 0, w, h);
    g.strokeStyle = "rgb(190,190,196)";
    g.lineWidth = 3;
    for (let k = 0; k <= 32; k++) {
      for (const line of [[k * 16, 0, k * 16, h], [0, k * 16, w, k * 16]]) {
        g.beginPath(); g.moveTo(line[0], line[1]); g.lineTo(line[2], line[3]); g.stroke();
      }
    }
  });
  const black = paint(0.03, 0.03, 0.032, 0.45), chrome = paint(0.7, 0.7, 0.72, 0.25, 0.85);
  const head = group(
    ball(0.085, material({ map: mesh, roughness: 0.45, metalness: 0.4 }), [0, 0, 0.2]), ring(0.086, 0.006, chrome, [0, 0, 0.2], [0, 0, 0]),
    lathe([[0.03, -0.16], [0.034, -0.1], [0.044, 0.05], [0.06, 0.13]], black), rod([0, 0, -0.16], [0, 0, -0.19], 0.024, chrome, 24),
    box([0.016, 0.012, 0.04], paint(0.6, 0.6, 0.6), [0, -0.043, 0.03]), rod([0, 0, -0.02], [0.06, 0, -0.08], 0.012, black),
  );
  head.position.set(0.12, 0, 0.62);
  head.rotation.y = (38 * Math.PI) / 180;
  return group(
    lathe([[0.001, 0.03], [0.12, 0.028], [0.15, 0.012], [0.15, 0], [0.001, 0]], material({ map: mottled(52, [0.08, 0.08, 0.09], [0.16, 0.16, 0.17]) })),
    rod([0, 0, 0.02], [0, 0, 0.5], 0.011, chrome, 20), rod([0, 0, 0.5], [0.14, 0, 0.6], 0.008, black), lathe([[0.018, 0.3], [0.02, 0.32], [0.02, 0.36], [0.018, 0.38]], black),
    rod([0.14, 0, 0.55], [0.02, 0.03, 0.02], 0.005, paint(0.02, 0.02, 0.02)), head,
  );
}

/** A carton with six printed faces. */
function product() {
  const tones = [[0.85, 0.3, 0.15], [0.15, 0.35, 0.75], [0.92, 0.9, 0.84], [0.95, 0.75, 0.2], [0.2, 0.5, 0.3], [0.7, 0.7, 0.72]];
  const faces = tones.map((tone, k) =>
    material({ map: print(60 + k, tone, k === 2 ? [0.1, 0.1, 0.3] : [0.98, 0.98, 0.94], [`CRISP ${k + 1}`, "net weight 375 g", `store dry, lot ${4711 + 37 * k}`]), roughness: 0.35 }));
  const b = box([0.42, 0.2, 0.6], faces);
  return group(b, rod([-0.05, 0, 0.3], [0.05, 0, 0.3], 0.012, paint(0.1, 0.1, 0.1)));
}

/** A carton whose four sides show the same print. */
function twins() {
  const side = material({ map: print(61, [0.15, 0.35, 0.75], [0.98, 0.98, 0.94], ["CRISP", "net weight 375 g", "store dry"]), roughness: 0.35 });
  const sides = [0, 1, 2, 3].map((k) => {
    const turned = group(sheet(0.42, 0.6, side, [0, -0.21, 0], [90, 0, 0]));
    turned.rotation.z = (k * Math.PI) / 2;
    return turned;
  });
  return group(box([0.415, 0.415, 0.6], paint(0.7, 0.7, 0.68)), sides);
}

/** A wooden chair with a latticed back. */
function chair() {
  const wood = (seed) => material({ map: mottled(seed, [0.34, 0.2, 0.1], [0.72, 0.5, 0.3], { cells: 6, octaves: 6, repeat: [1, 0.35] }), roughness: 0.5 });
  const parts = [box([0.42, 0.4, 0.03], wood(71), [0, 0, 0.42])];
  for (const i of [-1, 1]) {
    parts.push(rod([0.18 * i, -0.17, 0], [0.18 * i, -0.17, 0.42], 0.018, wood(72 + i)), rod([0.19 * i, 0.22, 0], [0.18 * i, 0.18, 0.43], 0.018, wood(75 + i)));
    parts.push(rod([0.18 * i, 0.18, 0.43], [0.19 * i, 0.26, 0.92], 0.016, wood(78 + i)), rod([0.18 * i, -0.17, 0.16], [0.185 * i, 0.2, 0.2], 0.01, wood(80 + i)));
  }
  for (let k = 0; k < 6; k++) parts.push(rod([-0.15 + 0.06 * k, 0.185, 0.44], [-0.16 + 0.064 * k, 0.255, 0.88], 0.009, wood(90)));
  for (let k = 0; k < 3; k++) parts.push(box([0.38, 0.015, 0.05], wood(95 + k), [0, 0.2 + 0.025 * k, 0.56 + 0.17 * k], [-9, 0, 0]));
  parts.push(box([0.3, 0.28, 0.03], material({ map: patches(99, [0.5, 0.2, 0.25]), roughness: 0.9 }), [0, -0.01, 0.45], [0, 0, 5]));
  return group(parts);
}

/** A bottle: glossy dark glass, a label all round, a cap like a mirror. */
function bottle() {
  const profile = dense([[0.001, 0], [0.13, 0], [0.14, 0.03], [0.14, 0.5], [0.13, 0.56], [0.06, 0.68], [0.045, 0.74], [0.045, 0.82]], 4);
  const label = drawn(101, 1024, 384, (g, w, h, next) => {
    g.fillStyle = "rgb(226,216,190)";
    g.fillRect(0, 0, w, h);
    for (let k = 0; k < 160; k++) {
      g.fillStyle = `hsl(${Math.floor(next() * 360)} 45% ${25 + 40 * next()}%)`;
      g.fillRect(next() * w, h * (0.55 + 0.35 * next()), 4 + 30 * next(), 3 + 16 * next());
    }
    g.fillStyle = "rgb(70,20,25)";
    g.font = "bold 96px serif";
    ["OLD HARBOUR", "No. 7"].forEach((word, k) => g.fillText(word, 40 + 620 * k, 140));
    g.font = "30px serif";
    for (let k = 0; k < 4; k++) g.fillText("distilled and bottled by the sea, batch " + (113 + k * 29), 30 + 250 * k, 190, 230);
  });
  const side = lathe([[0.1415, 0.1], [0.1415, 0.42]], material({ map: label, roughness: 0.7 }), [0, 0, 0], [0, 0, 0], { sides: 96 });
  return group(
    lathe(profile, paint(0.02, 0.07, 0.035, 0.08), [0, 0, 0], [0, 0, 0], { sides: 96 }), side,
    lathe([[0.05, 0.79], [0.052, 0.8], [0.052, 0.89], [0.045, 0.9], [0.001, 0.9]], paint(0.8, 0.8, 0.82, 0.05, 1.0)),
    sheet(0.06, 0.05, material({ map: patches(103, [0.5, 0.4, 0.2]) }), [0, -0.1, 0.62], [60, 0, 0]),
  );
}

export const OBJECTS = { mockup, statue, bust, microphone, product, chair, bottle, twins };
