// Procedural textures from a seed: noise, patches, solar cells, print, crumpled foil.
import * as THREE from "three";

/** Deterministic random numbers in [0, 1) (mulberry32). */
export function random(seed) {
  let a = (seed * 2654435761) >>> 0;
  return () => {
    a = (a + 0x6d2b79f5) >>> 0;
    let t = Math.imul(a ^ (a >>> 15), 1 | a);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 4294967296;
  };
}

const smooth = (t) => t * t * (3 - 2 * t);

/** Tileable fractal noise in about [0, 1], `size` squared values; `cells` in the first octave. */
export function noiseField(seed, size, cells, octaves = 4) {
  const out = new Float32Array(size * size);
  let weight = 0.5, total = 0;
  for (let o = 0; o < octaves; o++) {
    const n = cells << o, next = random(seed * 31 + o), grid = Float32Array.from({ length: n * n }, next);
    for (let y = 0; y < size; y++) {
      const v = (y * n) / size, j = Math.floor(v), b = smooth(v - j);
      for (let x = 0; x < size; x++) {
        const u = (x * n) / size, i = Math.floor(u), a = smooth(u - i), i1 = (i + 1) % n, j1 = (j + 1) % n;
        const top = grid[j * n + i] * (1 - a) + grid[j * n + i1] * a;
        const low = grid[j1 * n + i] * (1 - a) + grid[j1 * n + i1] * a;
        out[y * size + x] += weight * (top * (1 - b) + low * b);
      }
    }
    total += weight;
    weight *= 0.6;
  }
  return out.map((v) => v / total);
}

function texture(data, size, colour, repeat) {
  const t = new THREE.DataTexture(data, size, size, THREE.RGBAFormat);
  t.colorSpace = colour ? THREE.SRGBColorSpace : THREE.NoColorSpace;
  t.wrapS = t.wrapT = THREE.RepeatWrapping;
  t.repeat.set(repeat[0], repeat[1]);
  t.magFilter = THREE.LinearFilter;
  t.minFilter = THREE.LinearMipmapLinearFilter;
  t.generateMipmaps = true;
  t.anisotropy = 1;
  t.needsUpdate = true;
  return t;
}

/** Two sRGB colours mixed by noise; `contrast` steepens the mixture. */
export function mottled(seed, a, b, { size = 512, cells = 8, octaves = 5, contrast = 2.2, repeat = [1, 1] } = {}) {
  const noise = noiseField(seed, size, cells, octaves), data = new Uint8Array(4 * size * size);
  noise.forEach((v, k) => {
    const m = Math.min(1, Math.max(0, 0.5 + contrast * (v - 0.5)));
    for (let c = 0; c < 3; c++) data[4 * k + c] = 255 * (a[c] * (1 - m) + b[c] * m);
    data[4 * k + 3] = 255;
  });
  return texture(data, size, true, repeat);
}

/** Normals of a crumpled sheet: flat facets, each tilted at random (nearest of scattered points). */
export function crumpled(seed, { size = 256, facets = 260, tilt = 0.35, repeat = [1, 1] } = {}) {
  const next = random(seed), data = new Uint8Array(4 * size * size);
  const points = Array.from({ length: facets }, () => [next() * size, next() * size, next() - 0.5, next() - 0.5]);
  for (let y = 0; y < size; y++) {
    for (let x = 0; x < size; x++) {
      let best = 1e9, mine = points[0];
      for (const p of points) {
        const dx = Math.abs(x - p[0]), dy = Math.abs(y - p[1]);
        const d = Math.min(dx, size - dx) ** 2 + Math.min(dy, size - dy) ** 2;
        if (d < best) [best, mine] = [d, p];
      }
      const n = new THREE.Vector3(mine[2] * 2 * tilt, mine[3] * 2 * tilt, 1).normalize(), k = 4 * (y * size + x);
      data.set([127.5 + 127.5 * n.x, 127.5 + 127.5 * n.y, 127.5 + 127.5 * n.z, 255], k);
    }
  }
  return texture(data, size, false, repeat);
}

/** A canvas as texture; `draw(context, width, height, next)`. */
export function drawn(seed, width, height, draw) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  draw(canvas.getContext("2d"), width, height, random(seed));
  const t = new THREE.CanvasTexture(canvas);
  t.colorSpace = THREE.SRGBColorSpace;
  t.anisotropy = 1;
  return t;
}

const rgb = (r, g, b) => `rgb(${Math.round(255 * r)},${Math.round(255 * g)},${Math.round(255 * b)})`;

/** Random rectangles and discs of many colours about `tone`: a poster, a painted block. */
export function patches(seed, tone, { width = 256, height = 256, count = 70 } = {}) {
  return drawn(seed, width, height, (g, w, h, next) => {
    g.fillStyle = rgb(...tone);
    g.fillRect(0, 0, w, h);
    for (let k = 0; k < count; k++) {
      g.fillStyle = rgb(...tone.map((c) => Math.min(1, Math.max(0, c + 1.1 * (next() - 0.5)))));
      const x = next() * w, y = next() * h, s = (0.03 + 0.12 * next()) * w;
      if (next() < 0.5) g.fillRect(x - s / 2, y - s / 2, s, s * (0.3 + next()));
      else { g.beginPath(); g.arc(x, y, s / 2, 0, 2 * Math.PI); g.fill(); }
    }
  });
}

/** Rows of solar cells with slightly different blues, silver lines between; every wing alike. */
export function solarCells(seed, columns, rows) {
  return drawn(seed, 64 * columns, 64 * rows, (g, w, h, next) => {
    g.fillStyle = rgb(0.55, 0.56, 0.6);
    g.fillRect(0, 0, w, h);
    for (let j = 0; j < rows; j++) {
      for (let i = 0; i < columns; i++) {
        const s = 0.7 + 0.5 * next();
        g.fillStyle = rgb(0.07 * s, 0.1 * s, 0.3 * s);
        g.fillRect(64 * i + 3, 64 * j + 3, 58, 58);
        g.fillStyle = rgb(0.35, 0.37, 0.45);
        g.fillRect(64 * i + 20, 64 * j + 3, 2, 58);
        g.fillRect(64 * i + 42, 64 * j + 3, 2, 58);
      }
    }
  });
}

/** A printed sheet: ground colour, shapes, large and small words, a bar code. */
export function print(seed, ground, ink, words, { width = 512, height = 512 } = {}) {
  return drawn(seed, width, height, (g, w, h, next) => {
    g.fillStyle = rgb(...ground);
    g.fillRect(0, 0, w, h);
    for (let k = 0; k < 14; k++) {
      g.fillStyle = rgb(next(), next(), next());
      g.globalAlpha = 0.55;
      g.beginPath();
      g.arc(next() * w, h * (0.3 + 0.4 * next()), w * (0.03 + 0.1 * next()), 0, 2 * Math.PI);
      g.fill();
    }
    g.globalAlpha = 1;
    g.fillStyle = rgb(...ink);
    g.textAlign = "center";
    words.forEach((word, k) => {
      g.font = `bold ${Math.round(h * (k === 0 ? 0.13 : 0.05))}px sans-serif`;
      g.fillText(word, w * 0.5, h * (k === 0 ? 0.2 : 0.74 + 0.065 * k), w * 0.9);
    });
    for (let x = w * 0.62; x < w * 0.93; x += 2 + 6 * next()) g.fillRect(x, h * 0.66, 1 + 3 * next(), h * 0.09);
    for (let k = 0; k < 10; k++) g.fillRect(w * 0.06, h * (0.58 + 0.018 * k), w * (0.2 + 0.3 * next()), 2);
  });
}
