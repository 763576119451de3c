"""From linear light to the bytes a phone would store: fall-off, blur, noise, clipping, sRGB."""

import numpy as np

VIGNETTING = 0.22  # light falls as 1 / (1 + this r^2); Source: the test bed's phone (data/testbed)
LAMP, ROOM = 0.95, 0.16  # radiance of a white surface in the light of each; Source: web/places.js
DARKEST = 0.3  # reflectance; Source: chosen by hand
BLUR = 0.06  # share of a pixel's light that each neighbour gets; Source: chosen by hand


class Sensor:
    """One camera: `exposure` is the gain on linear light, electrons as in `captures.light_of`."""

    def __init__(self, width, height, lens, light, exposure, seed):
        x, y = np.meshgrid(np.arange(width) + 0.5 - lens["cx"], np.arange(height) + 0.5 - lens["cy"])
        self.gain = (exposure / (1 + VIGNETTING * (x * x + y * y) / lens["f"] ** 2)).astype(np.float32)[..., None]
        self.full_well, self.read = light["full_well"], light["read_noise"] / light["full_well"]
        self.seed = seed
        steps = np.arange(65536) / 65535
        curve = np.where(steps <= 0.0031308, 12.92 * steps, 1.055 * steps ** (1 / 2.4) - 0.055)
        self.curve = np.round(255 * curve).astype(np.uint8)

    def picture(self, light, index):
        """[H, W, 3] linear light to sRGB bytes; noise depends on the seed and the index alone."""
        signal = blurred(light.astype(np.float32)) * self.gain
        rng = np.random.default_rng([*self.seed, index])
        deviation = np.sqrt(np.maximum(signal, 0) / self.full_well + self.read**2)
        signal = signal + deviation * rng.standard_normal(signal.shape, dtype=np.float32)
        return self.curve[(np.clip(signal, 0, 1) * 65535).astype(np.uint16)]


def blurred(image):
    """Each pixel gives a share `BLUR` to each of its neighbours, along rows and along columns."""
    for axis in (0, 1):
        wide = np.pad(image, [(1, 1) if a == axis else (0, 0) for a in range(3)], mode="edge")
        n = image.shape[axis]
        before, after = (np.take(wide, range(k, k + n), axis) for k in (0, 2))
        image = (1 - 2 * BLUR) * image + BLUR * (before + after)
    return image


def exposure_for(samples, light):
    """Gain on linear light, as an automatic exposure that a dark object does not mislead.

    It brings the brightest thirtieth of what is lit in the samples to `white`, but never what a
    surface of reflectance `DARKEST` would need.
    """
    luminance = np.concatenate([(s.astype(np.float32) @ [0.2126, 0.7152, 0.0722]).ravel() for s in samples])
    lit = luminance[luminance > 1e-3 * np.median(luminance[luminance > 0])]
    most = light["white"] / (DARKEST * (LAMP * light["lamp"] + ROOM * light["room"]))
    return float(min(light["white"] / np.percentile(lit, 97), most))
