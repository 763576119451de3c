#!/usr/bin/env python3
"""Makes a weights file for --lpips-weights from the files that torchvision and the lpips package
use.

    lpips_weights.py BACKBONE.pth LINEAR.pth OUT.safetensors

BACKBONE.pth: torchvision's AlexNet or VGG-16 (alexnet-owt-7be5be79.pth, vgg16-397923af.pth).
LINEAR.pth: the matching lpips/weights/v0.1/{alex,vgg}.pth of the lpips package.
Needs torch and safetensors (pip install torch safetensors).
"""
import sys

import torch
from safetensors.torch import save_file


def main():
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    backbone, linear = (torch.load(path, map_location="cpu", weights_only=True) for path in sys.argv[1:3])
    tensors = {k: v for k, v in backbone.items() if k.startswith("features.")}
    tensors |= {k: v for k, v in linear.items() if k.startswith("lin")}
    if len(tensors) not in (15, 31):
        sys.exit(f"{len(tensors)} tensors found; AlexNet has 15, VGG-16 31 with the five linear layers")
    save_file({k: v.float().contiguous() for k, v in tensors.items()}, sys.argv[3])
    print(f"{sys.argv[3]}: {len(tensors)} tensors")


main()
