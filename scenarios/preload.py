"""What the fork server imports once, so that a robot's process starts in milliseconds.

No Zenoh session may be open here, and no thread may run: neither survives a fork.
"""

import cv2

import scenarios.processes  # noqa: F401  (imported for what it imports)
from comms.kernels import warm_all

cv2.setNumThreads(1)
warm_all()
