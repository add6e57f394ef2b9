"""The radio: frames, map codec, link emulation, Zenoh."""
