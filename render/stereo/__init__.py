"""How a stereo depth camera departs from the true depth,
one effect a file, in the order of the camera.
"""
