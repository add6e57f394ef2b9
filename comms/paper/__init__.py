"""The paper's map codec in parts: quadtree by entropy, and four lossless compressors.

Here to be measured against (Sujan & Meggiolaro, sections 2.3 and 2.4); `comms.papercode` puts the
parts together, and `comms.codec` is what the robots send.
"""
