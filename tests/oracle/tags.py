"""Codes of AprilTag 36h11 and ArUco 4x4_50 (sfm/src/metric/tags/*.txt), and a picture of tags whose
corners are known (sfm/tests/fixtures/tags/).

python3 tests/oracle/tags.py   (from the repository's root; needs numpy and opencv-python-headless)

36h11: E. Olson, "AprilTag: A robust and flexible visual fiducial system", ICRA 2011. 4x4_50: the
first 50 of the dictionary of 4x4 markers of OpenCV's ArUco module. A code is the cells inside the
black border, row by row, the first cell in the highest bit, 1 = white.
"""

import json
import pathlib

import cv2
import numpy as np

FAMILIES = {
    "apriltag_36h11": (cv2.aruco.DICT_APRILTAG_36h11, 6),
    "aruco_4x4_50": (cv2.aruco.DICT_4X4_50, 4),
}
TAGS = pathlib.Path("sfm/src/metric/tags")
OUT = pathlib.Path("sfm/tests/fixtures/tags")


def codes(name):
    dictionary, cells = cv2.aruco.getPredefinedDictionary(FAMILIES[name][0]), FAMILIES[name][1]
    for tag in range(len(dictionary.bytesList)):
        image = dictionary.generateImageMarker(tag, cells + 2)
        inner = (image[1:-1, 1:-1] > 127).astype(int).flatten()
        yield int("".join(map(str, inner)), 2)


def picture(rng):
    """Four tags of each family, seen askew; corners in pixels from the upper left edge."""
    cell, side = 480, 320
    sheet = np.full((2 * cell, 4 * cell), 235, np.uint8)
    wanted = []
    for row, (name, (kind, _)) in enumerate(FAMILIES.items()):
        dictionary = cv2.aruco.getPredefinedDictionary(kind)
        for column, tag in enumerate([0, 7, 23, 49]):
            turned = np.rot90(dictionary.generateImageMarker(tag, side), column)
            y, x = row * cell + (cell - side) // 2, column * cell + (cell - side) // 2
            sheet[y:y + side, x:x + side] = turned
            corners = np.array([[x, y], [x + side, y], [x + side, y + side], [x, y + side]], float)
            # A quarter turn to the left takes the upper left corner down, and so on.
            wanted.append((name, tag, np.roll(corners, column, axis=0)))
    size, factor = (640, 360), 4
    seen = np.array([[30, 40], [600, 15], [560, 335], [70, 300]], float)
    held = np.array([[0, 0], [sheet.shape[1], 0], [sheet.shape[1], sheet.shape[0]], [0, sheet.shape[0]]])
    homography = cv2.getPerspectiveTransform(held.astype(np.float32), seen.astype(np.float32))
    # Continuous pixels: OpenCV's lie half a pixel to the left and above.
    half = lambda s: np.array([[1, 0, s], [0, 1, s], [0, 0, 1.0]])
    large = half(-0.5) @ np.diag([factor, factor, 1.0]) @ homography @ half(0.5)
    image = cv2.warpPerspective(sheet, large, (size[0] * factor, size[1] * factor), borderValue=150)
    image = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(float)
    light = np.linspace(0.75, 1.05, size[0])[None, :]
    image = cv2.GaussianBlur(image * light, (0, 0), 0.6) + rng.normal(0, 2, image.shape)
    found = []
    for name, tag, corners in wanted:
        at = cv2.perspectiveTransform(corners[None], homography)[0]
        found.append({"family": name, "id": tag, "corners": np.round(at, 4).tolist()})
    return np.clip(image, 0, 255).round().astype(np.uint8), found


def main():
    for name, (_, cells) in FAMILIES.items():
        digits = cells * cells // 4
        lines = [f"{code:0{digits}x}\n" for code in codes(name)]
        (TAGS / f"{name}.txt").write_text("".join(lines))
        print(name, len(lines), "codes")
    OUT.mkdir(parents=True, exist_ok=True)
    image, truth = picture(np.random.default_rng(1))
    cv2.imwrite(str(OUT / "sheet.png"), image)
    (OUT / "sheet.json").write_text(json.dumps(truth, indent=1) + "\n")
    for name, (kind, _) in FAMILIES.items():
        detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(kind))
        detector_found = detector.detectMarkers(image)
        for corners, tag in zip(detector_found[0], detector_found[1].flatten()):
            true = next(t for t in truth if t["family"] == name and t["id"] == tag)
            off = corners[0] + 0.5 - np.array(true["corners"])
            print(name, tag, "OpenCV's corners are off by", np.abs(off).max().round(2), "px")


if __name__ == "__main__":
    main()
