"""What the fork server imports once, so that a robot's process starts in milliseconds.

No Zenoh session may be open here, and no thread may run: neither survives a fork.
"""

import gc
import importlib

import cv2

from comms.kernels import warm_all

importlib.import_module("scenarios.crews.processes")
cv2.setNumThreads(1)
warm_all()
# What is loaded here is never let go: a robot's collector need not walk over it, and so write to
# pages that all robots share.
gc.collect()
gc.freeze()
