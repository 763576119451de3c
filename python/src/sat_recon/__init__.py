"""sat-recon: camera poses, a sparse cloud and a 3D Gaussian splat from a video or photos.

>>> import sat_recon
>>> result = sat_recon.reconstruct("video.mp4", "out", quality="draft")  # doctest: +SKIP
>>> result.verdict, result.world_from_camera.shape, len(result.splat)  # doctest: +SKIP
('good', (100, 4, 4), 15234)
"""

from ._files import Camera, Splat
from ._run import Progress, Reconstruction, SatReconError, load, reconstruct

__all__ = ["Camera", "Progress", "Reconstruction", "SatReconError", "Splat", "load", "reconstruct"]
