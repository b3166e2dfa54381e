"""Numerics for inertial and satellite data: rotations, quadrature, geodesy and signals in pure NumPy.

Public for plugin authors. Nothing here knows tables, pipelines or files, and nothing here imports the rest of recon.
Arrays of vectors are (n, 3) and arrays of quaternions (n, 4), scalar first; SI and radians, except that latitude and
longitude are in degrees, as in the streams.
"""
